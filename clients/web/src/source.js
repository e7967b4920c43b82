// A document's text: its value, where in the text each part of it is (by JSON
// pointer, RFC 6901), and changes of the text that leave the rest as it is.
import { jsonLanguage } from "@codemirror/lang-json";

export const escape = (name) =>
	String(name).replaceAll("~", "~0").replaceAll("/", "~1");
export const unescape = (name) =>
	name.replaceAll("~1", "/").replaceAll("~0", "~");
export const steps = (pointer) =>
	pointer === "" ? [] : pointer.slice(1).split("/").map(unescape);
export const parent = (pointer) =>
	pointer.slice(0, Math.max(0, pointer.lastIndexOf("/")));

/* What a pointer points at; undefined if nothing is there. */
export function at(value, pointer) {
	for (const step of steps(pointer)) {
		if (value === null || typeof value !== "object")
			return undefined;
		value = value[step];
	}
	return value;
}

const VALUES = new Set(["Object", "Array", "String", "Number", "True", "False",
	"Null"]);

/* Every value's place in what is JSON: {from, to}, and keyFrom where it is a
 * member. */
function scan(text) {
	const places = new Map();
	let i = 0;
	const blank = () => {
		while (" \n\t\r".includes(text[i]))
			i++;
	};
	const string = () => {
		const from = i;
		for (;;) {
			i = text.indexOf("\"", i + 1);
			let escapes = 0;
			while (text[i - 1 - escapes] === "\\")
				escapes++;
			if (escapes % 2 === 0)
				break;
		}
		i++;
		const inner = text.slice(from + 1, i - 1);
		return inner.includes("\\") ? JSON.parse(`"${inner}"`) : inner;
	};
	const visit = (pointer, keyFrom) => {
		const place = { from: i, to: i, keyFrom: keyFrom ?? i };
		const first = text[i];
		places.set(pointer, place);
		if (first === "\"") {
			string();
		} else if (first === "{" || first === "[") {
			i++;
			for (let n = 0; ; n++) {
				blank();
				if (text[i] === ",")
					i++;
				blank();
				if (text[i] === "}" || text[i] === "]")
					break;
				const key = i;
				const name = first === "{" ? escape(string()) : n;
				if (first === "{") {
					blank();
					i++;
					blank();
				}
				visit(`${pointer}/${name}`, first === "{" ? key : undefined);
			}
			i++;
		} else {
			while (i < text.length && !",]} \n\t\r".includes(text[i]))
				i++;
		}
		place.to = i;
	};
	blank();
	visit("");
	return places;
}

/* The same of what is nearly JSON, as far as can be told. */
function locate(tree, text) {
	const places = new Map();
	const visit = (node, pointer, keyFrom) => {
		places.set(pointer, { from: node.from, to: node.to,
			keyFrom: keyFrom ?? node.from });
		let i = 0;
		for (let child = node.firstChild; child; child = child.nextSibling) {
			if (child.name === "Property") {
				const key = child.getChild("PropertyName");
				const value = child.lastChild;
				if (!key || !VALUES.has(value?.name))
					continue;
				let name;
				try {
					name = JSON.parse(text.slice(key.from, key.to));
				} catch {
					continue;
				}
				visit(value, `${pointer}/${escape(name)}`, key.from);
			} else if (node.name === "Array" && VALUES.has(child.name)) {
				visit(child, `${pointer}/${i++}`);
			}
		}
	};
	const top = tree.topNode.firstChild;
	if (top && VALUES.has(top.name))
		visit(top, "");
	return places;
}

function firstFault(tree, text) {
	let from = text.length;
	tree.iterate({ enter: (node) => {
		if (node.type.isError)
			from = Math.min(from, node.from);
	} });
	return from;
}

let latest = null;

/* {value, places, fault}: value is undefined and fault {from, to, message}
 * where the text is no JSON; places are then as good as can be. Of one text
 * after another the same answer: it is asked for in many places. */
export function read(text) {
	if (latest?.text !== text)
		latest = { text, answer: readAnew(text) };
	return latest.answer;
}

function readAnew(text) {
	try {
		return { value: JSON.parse(text), places: scan(text), fault: null };
	} catch (error) {
		if (error instanceof RangeError)
			return { value: undefined, places: new Map(), fault: { from: 0, to: 1,
				message: "Nested too deeply to be edited here." } };
		const tree = jsonLanguage.parser.parse(text);
		const places = locate(tree, text);
		const from = firstFault(tree, text);
		const message = error.message
			.replace(/^JSON\.parse: /, "")
			.replace(/,? (in JSON )?at (position|line) .*$/s, "")
			.replace(/, (\.\.\.)?".*is not valid JSON$/s, "");
		return { value: undefined, places, fault: { from,
			to: Math.min(text.length, from + 1), message: `Not JSON: ${message}` } };
	}
}

/* Where to show what is said of a pointer: its member, key and all; of an
 * object its type, lest all of it be underlined; of what is not there, what it
 * should be in. */
export function mark(places, pointer) {
	let here = pointer.replace(/\.\.\..*$/, "");
	while (here !== "" && !places.has(here))
		here = parent(here);
	const type = places.get(`${here}/type`);
	if (type)
		return { from: type.keyFrom, to: type.to };
	const place = places.get(here);
	return place ? { from: place.keyFrom, to: place.to } : { from: 0, to: 1 };
}

/* The deepest pointer whose value holds that position. */
export function pointerAt(places, position) {
	let best = "";
	for (const [pointer, place] of places)
		if (place.keyFrom <= position && position <= place.to &&
		    pointer.length >= best.length)
			best = pointer;
	return best;
}

/* {from, to, insert} that gives what is at pointer another value; null if it
 * is not there. */
export function replace(places, pointer, value) {
	const place = places.get(pointer);
	return place ? { from: place.from, to: place.to, insert: write(value) }
		: null;
}

/* As replace, or adds the member to its object, on a line of its own if the
 * object's members have such. */
export function assign(text, places, pointer, value) {
	const there = replace(places, pointer, value);
	if (there)
		return there;
	const object = places.get(parent(pointer));
	const name = JSON.stringify(steps(pointer).pop());
	const pair = `${name}: ${write(value)}`;
	let last = null;
	for (const [other, place] of places)
		if (other !== "" && parent(other) === parent(pointer) &&
		    (!last || place.to > last.to))
			last = place;
	if (!last)
		return { from: object.from + 1, to: object.from + 1, insert: pair };
	const line = text.lastIndexOf("\n", last.keyFrom) + 1;
	const indent = text.slice(line, last.keyFrom);
	const separate = /^\s*$/.test(indent) ? `,\n${indent}` : ", ";
	return { from: last.to, to: last.to, insert: separate + pair };
}

/* Takes a member out of its object, with its comma. */
export function erase(text, places, pointer) {
	const place = places.get(pointer);
	if (!place)
		return null;
	const before = /,\s*$/.exec(text.slice(0, place.keyFrom));
	if (before)
		return { from: place.keyFrom - before[0].length, to: place.to,
			insert: "" };
	const after = /^\s*,\s*/.exec(text.slice(place.to));
	return { from: place.keyFrom, to: place.to + (after ? after[0].length : 0),
		insert: "" };
}

/* The text with many values changed: [{pointer, value}], undefined to take it
 * out. What is not there is added. */
export function applyAll(text, edits) {
	let { places } = read(text);
	const there = edits.filter((e) => e.value !== undefined &&
		places.has(e.pointer)).sort((a, b) =>
		places.get(b.pointer).from - places.get(a.pointer).from);
	for (const e of there)
		text = splice(text, replace(places, e.pointer, e.value));
	for (const e of edits.filter((e) => !there.includes(e))) {
		({ places } = read(text));
		text = splice(text, e.value === undefined
			? erase(text, places, e.pointer)
			: assign(text, places, e.pointer, e.value));
	}
	return text;
}

function splice(text, change) {
	return change ? text.slice(0, change.from) + change.insert +
		text.slice(change.to) : text;
}

/* JSON on one line, with spaces. */
export function write(value) {
	if (Array.isArray(value))
		return `[${value.map(write).join(", ")}]`;
	if (value !== null && typeof value === "object")
		return `{${Object.entries(value).map(([k, v]) =>
			`${JSON.stringify(k)}: ${write(v)}`).join(", ")}}`;
	return JSON.stringify(value);
}
