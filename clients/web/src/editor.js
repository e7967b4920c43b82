// The document's editor: CodeMirror in a shadow root, where it keeps its
// styles in adoptedStyleSheets, which the Content-Security-Policy allows.
import { autocompletion, closeBrackets, closeBracketsKeymap, completionKeymap }
	from "@codemirror/autocomplete";
import { defaultKeymap, history, historyKeymap, indentWithTab }
	from "@codemirror/commands";
import { json } from "@codemirror/lang-json";
import { bracketMatching, codeFolding, foldGutter, foldKeymap, HighlightStyle,
	indentOnInput, indentUnit, syntaxHighlighting, syntaxTree }
	from "@codemirror/language";
import { lintGutter, setDiagnostics } from "@codemirror/lint";
import { highlightSelectionMatches, search, searchKeymap }
	from "@codemirror/search";
import { Annotation, EditorState, StateEffect, StateField, Transaction }
	from "@codemirror/state";
import { Decoration, drawSelection, EditorView, highlightActiveLine,
	highlightActiveLineGutter, keymap, lineNumbers } from "@codemirror/view";
import { tags } from "@lezer/highlight";

import { pointerAt, read, steps } from "./source.js";
import { narrow } from "./dom.js";
import { COMMON, nodeOf, OPERATORS, TEMPLATES, TYPES } from "./nodes.js";

/* Who made a change: "slider", "remote", … A change without is the user's. */
const origin = Annotation.define();

const highlighting = HighlightStyle.define([
	{ tag: tags.propertyName, color: "var(--code-key)" },
	{ tag: tags.string, color: "var(--code-string)" },
	{ tag: tags.number, color: "var(--code-number)" },
	{ tag: [tags.bool, tags.null], color: "var(--code-word)" },
	{ tag: [tags.punctuation, tags.separator, tags.bracket],
		color: "var(--ink-soft)" },
]);

const theme = EditorView.theme({
	"&": { height: "100%", fontSize: "12.5px", color: "var(--ink)",
		backgroundColor: "transparent" },
	"&.cm-focused": { outline: "none" },
	".cm-scroller": { fontFamily: "var(--mono)", lineHeight: "1.55" },
	".cm-content": { caretColor: "var(--ink)", paddingBottom: "40px" },
	".cm-cursor": { borderLeftColor: "var(--ink)" },
	".cm-gutters": { backgroundColor: "transparent", border: "none",
		color: "var(--ink-faint)" },
	".cm-activeLine": { backgroundColor: "var(--wash)" },
	".cm-activeLineGutter": { backgroundColor: "transparent",
		color: "var(--ink)" },
	".cm-node": { backgroundColor: "var(--accent-wash)",
		boxShadow: "inset 2px 0 var(--accent)" },
	"&.cm-focused > .cm-scroller > .cm-selectionLayer .cm-selectionBackground, .cm-selectionBackground":
		{ backgroundColor: "var(--selection)" },
	".cm-selectionMatch": { backgroundColor: "var(--wash-strong)" },
	"&.cm-focused .cm-matchingBracket": { backgroundColor: "var(--wash-strong)",
		outline: "none" },
	".cm-foldGutter .cm-gutterElement": { color: "var(--ink-faint)" },
	".cm-foldPlaceholder": { backgroundColor: "var(--wash-strong)",
		border: "none", color: "var(--ink-soft)", padding: "0 6px" },
	".cm-tooltip": { backgroundColor: "var(--panel)", color: "var(--ink)",
		border: "1px solid var(--line)", borderRadius: "6px",
		boxShadow: "var(--shadow)", overflow: "hidden" },
	".cm-tooltip-autocomplete > ul": { fontFamily: "var(--mono)",
		fontSize: "12px" },
	".cm-tooltip-autocomplete > ul > li[aria-selected]":
		{ backgroundColor: "var(--accent)", color: "var(--on-accent)" },
	".cm-completionDetail": { color: "var(--ink-faint)", fontStyle: "normal" },
	".cm-diagnostic": { padding: "6px 10px", borderLeft: "3px solid var(--bad)",
		fontFamily: "var(--sans)", fontSize: "12.5px", maxWidth: "360px" },
	".cm-lint-marker": { width: "0.8em", height: "0.8em" },
	".cm-lintRange-error": { backgroundImage: "none",
		textDecoration: "underline wavy var(--bad) 1px",
		textUnderlineOffset: "3px" },
	".cm-panels": { backgroundColor: "var(--panel)", color: "var(--ink)",
		borderTop: "1px solid var(--line)" },
	".cm-textfield": { backgroundColor: "var(--field)",
		border: "1px solid var(--line)", borderRadius: "4px",
		color: "var(--ink)" },
	".cm-button": { backgroundImage: "none", backgroundColor: "var(--field)",
		border: "1px solid var(--line)", borderRadius: "4px",
		color: "var(--ink)" },
});

const showNode = StateEffect.define();

/* The lines of the node that is selected. */
const nodeLines = StateField.define({
	create: () => Decoration.none,
	update(lines, transaction) {
		lines = lines.map(transaction.changes);
		for (const effect of transaction.effects)
			if (effect.is(showNode))
				lines = linesOf(transaction.state.doc, effect.value);
		return lines;
	},
	provide: (field) => EditorView.decorations.from(field),
});

function linesOf(doc, place) {
	if (!place)
		return Decoration.none;
	const marks = [];
	const last = doc.lineAt(Math.min(place.to, doc.length)).number;
	for (let n = doc.lineAt(place.from).number; n <= last; n++)
		marks.push(Decoration.line({ class: "cm-node" }).range(doc.line(n).from));
	return Decoration.set(marks);
}

/* Completions: members of the node, types, operators, ids. */
function complete(context) {
	const { state, pos } = context;
	const inner = syntaxTree(state).resolveInner(pos, -1);
	const token = inner.name === "⚠" ? inner.parent : inner;
	const text = state.doc.toString();
	const { places } = read(text);
	const pointer = pointerAt(places, pos);
	const whole = readLoosely(text, places);
	if (token.name === "String")
		return values(token, pointer, whole);
	if (token.name === "PropertyName" || (token.name === "Object" &&
	    (context.explicit || /[{,]\s*"?$/.test(text.slice(0, pos)))))
		return members(token, pos, text, places,
			token.name === "Object" ? pointer : holder(places, pos), whole);
	return null;
}

function holder(places, pos) {
	let best = "";
	for (const [pointer, place] of places)
		if (place.from < pos && pos < place.to && pointer.length >= best.length)
			best = pointer;
	return best;
}

/* Types of nodes by pointer, also while the text is no JSON. */
function readLoosely(text, places) {
	const words = new Map();
	for (const [pointer, place] of places)
		if (/\/(type|id)$/.test(pointer))
			words.set(pointer, text.slice(place.from + 1, place.to - 1));
	return words;
}

function values(token, pointer, words) {
	const last = steps(pointer).pop();
	const ids = [...words].filter(([p]) => p.endsWith("/id")).map(([, w]) => w);
	const list = { type: Object.keys(TYPES), operator: OPERATORS, ref: ids,
		profile: ["smooth", "bulge", "circle"],
		opening: ["camel", "organic", "contact"] }[last];
	return list && { from: token.from + 1, to: token.to - 1, validFor: /^[\w.-]*$/,
		options: list.map((label) => ({ label, type: "constant",
			detail: last === "type" ? TYPES[label].kind : undefined })) };
}

function members(token, pos, text, places, object, words) {
	if (nodeOf(object) !== object)
		return null;
	const type = words.get(`${object}/type`);
	const all = { ...type ? TYPES[type]?.members : { type: "type" }, ...COMMON };
	const open = token.name === "PropertyName";
	return { from: open ? token.from : pos, to: open ? token.to : pos,
		validFor: /^"?\w*"?$/,
		options: Object.keys(all).filter((m) => !places.has(`${object}/${m}`))
			.map((m) => ({ label: `"${m}"`, type: "property", detail: all[m],
				apply: open && /^\s*:/.test(text.slice(token.to)) ? `"${m}"`
					: `"${m}": ${TEMPLATES[m] ?? "\"\""}` })) };
}

export class Editor {
	/* changed(text, origin) after each change; moved(pointer) where the user
	 * has put the cursor. */
	constructor(host, { changed, moved }) {
		const shadow = host.attachShadow({ mode: "open" });
		this.changed = changed;
		this.extensions = [
			lineNumbers(), foldGutter(), codeFolding(), lintGutter(),
			history(), drawSelection(), indentOnInput(), bracketMatching(),
			closeBrackets(), highlightActiveLine(),
			highlightActiveLineGutter(), highlightSelectionMatches(),
			search(), json(), EditorView.lineWrapping,
			syntaxHighlighting(highlighting), theme,
			indentUnit.of("  "), nodeLines,
			EditorView.contentAttributes.of({ "aria-label": "Document" }),
			autocompletion({ override: [complete], icons: false }),
			keymap.of([...closeBracketsKeymap, ...completionKeymap,
				...defaultKeymap, ...searchKeymap, ...historyKeymap,
				...foldKeymap, indentWithTab]),
			EditorView.updateListener.of((update) => {
				const who = update.transactions.map((t) =>
					t.annotation(origin)).find((o) => o) ?? "user";
				if (update.docChanged)
					changed(this.text, who);
				else if (update.selectionSet && who === "user" &&
				    update.view.hasFocus)
					moved(pointerAt(read(this.text).places,
						update.state.selection.main.head));
			}),
		];
		this.view = new EditorView({ parent: shadow, root: shadow,
			state: this.#state("") });
	}

	#state(doc) {
		return EditorState.create({ doc, extensions: this.extensions });
	}

	/* Another document: from its beginning, and nothing to be undone. */
	open(text) {
		this.view.setState(this.#state(text));
		this.view.scrollDOM.scrollTop = 0;
		this.changed(this.text, "open");
	}

	get text() {
		return this.view.state.doc.toString();
	}

	/* The whole text, changed only where it differs: the cursor stays where it
	 * was, as it were. */
	setText(text, who, { remember = true } = {}) {
		const old = this.text;
		if (text === old)
			return;
		let from = 0;
		const most = Math.min(old.length, text.length);
		while (from < most && old[from] === text[from])
			from++;
		let tail = 0;
		while (tail < most - from &&
		    old[old.length - 1 - tail] === text[text.length - 1 - tail])
			tail++;
		this.change([{ from, to: old.length - tail,
			insert: text.slice(from, text.length - tail) }], who, remember);
	}

	change(changes, who, remember = true) {
		this.view.dispatch({ changes, annotations: [origin.of(who),
			Transaction.addToHistory.of(remember)] });
	}

	/* problems: [{from, to, message}] */
	setProblems(problems) {
		const end = this.view.state.doc.length;
		this.view.dispatch(setDiagnostics(this.view.state, problems.map((p) => ({
			from: Math.min(p.from, end), to: Math.min(p.to, end),
			severity: "error", message: p.message }))));
	}

	/* The node's lines, and there if scroll. */
	showNode(place, scroll) {
		const end = this.view.state.doc.length;
		const effects = [showNode.of(place && place.from <= end ? place : null)];
		if (place && scroll && !narrow())
			effects.push(EditorView.scrollIntoView(Math.min(place.from, end),
				{ y: "start", yMargin: 60 }));
		this.view.dispatch({ effects });
	}

	/* The cursor there, and the keyboard. */
	jump(from) {
		this.view.dispatch({ selection: { anchor:
			Math.min(from, this.view.state.doc.length) },
		effects: EditorView.scrollIntoView(from, { y: "center" }),
		annotations: origin.of("jump") });
		this.view.focus();
	}
}
