// Sliders for the numbers of the selected node, its colour, and its operator:
// profile and opening with their plots.
import { Euler, MathUtils, Quaternion } from "three";

import { operatorOf } from "./curves.js";
import { h } from "./dom.js";
import { label, OPERATORS, range, TEMPLATES, TYPES, COMMON }
	from "./nodes.js";
import { openingPlot, profilePlot } from "./plot.js";
import { slider } from "./slider.js";
import { at } from "./source.js";
import { fromHex, toHex } from "./tree.js";

const AXES = ["x", "y", "z", "w"];
const LEFT_OUT = new Set(["type", "id", "children", "child", "operator",
	"material", "rotation", "matrix"]);
const MOST = 60;
const COMPOSED = new Set(["union", "intersection", "difference"]);

/* Everything of a value but its numbers: sliders can stay while it does. */
function shape(value) {
	if (Array.isArray(value))
		return `[${value.map(shape)}]`;
	if (value !== null && typeof value === "object")
		return `{${Object.entries(value).filter(([k]) => k !== "children" &&
			k !== "child").map(([k, v]) => `${k}:${shape(v)}`)}}`;
	return typeof value === "number" ? "0" : String(value);
}

/* A node's shape; its operator may change its form, not whether it has curves. */
function shapeOf(doc, node, pointer) {
	const { operator, ...rest } = node;
	const now = COMPOSED.has(node.type) ? operatorOf(doc, node, pointer) : null;
	return [pointer, shape(rest), Object.keys(doc.operators ?? {}), now?.profile
		? "curves" : [now?.pointer, shape(at(doc, now?.pointer ?? ""))]].join();
}

export class Inspector {
	/* edit([{pointer, value}]): numbers change; value undefined: takes the
	 * member out. aim(pointer): the user wants to click where the blend of that
	 * node is to end. */
	constructor(host, edit, aim) {
		this.host = host;
		this.edit = edit;
		this.aim = aim;
		this.held = false;
		host.addEventListener("pointerdown", () => { this.held = true; });
		for (const end of ["pointerup", "pointercancel"])
			window.addEventListener(end, () => {
				if (!this.held)
					return;
				this.held = false;
				// The slider's own last word comes first.
				setTimeout(() => !this.held && this.render(...this.latest), 0);
			});
	}

	render(doc, pointer, size) {
		const node = pointer && doc ? at(doc, pointer) : null;
		const shown = node && typeof node === "object"
			? shapeOf(doc, node, pointer) : "";
		const scale = Math.round(Math.log2(size));
		this.doc = doc;
		this.latest = [doc, pointer, size];
		// Ranges follow the model's size, but not under the pointer.
		if (shown === this.shown && (this.held || scale === this.scale)) {
			for (const [p, set] of this.sets ?? [])
				set(at(doc, p));
			this.refresh?.();
			return;
		}
		this.scale = scale;
		const focus = shown && this.shown?.split(",")[0] === pointer
			? this.#focus() : null;
		this.shown = shown;
		this.sets = [];
		this.refresh = null;
		this.host.replaceChildren();
		this.#fill(doc, node, pointer, size);
		focus?.();
	}

	/* What had the keyboard has it again in the panel made anew. */
	#focus() {
		const was = document.activeElement;
		const name = was?.getAttribute("aria-label");
		if (!name || !this.host.contains(was))
			return null;
		const text = was.type === "text" ? was.value : null;
		return () => {
			const now = [...this.host.querySelectorAll("[aria-label]")].find((e) =>
				e.getAttribute("aria-label") === name);
			now?.focus();
			if (now && text !== null)
				now.value = text;
		};
	}

	#fill(doc, node, pointer, size) {
		if (!this.shown) {
			this.host.append(h("p", { class: "hint" },
				"Click the model, or a node of the tree, to change it here."));
			return;
		}
		this.size = size;
		this.count = 0;
		this.host.append(this.#head(node, pointer));
		if (COMPOSED.has(node.type))
			this.host.append(...this.#operator(pointer, node));
		for (const [name, value] of Object.entries(node))
			if (!LEFT_OUT.has(name))
				this.#numbers(this.host, `${pointer}/${name}`, name, value,
					TYPES[node.type]?.members[name] ?? COMMON[name] ?? name);
		if (this.count > MOST)
			this.host.append(h("p", { class: "hint" },
				`${this.count - MOST} more numbers are in the text alone.`));
		if (Array.isArray(node.rotation))
			this.host.append(this.#rotation(`${pointer}/rotation`, node.rotation));
		if (Array.isArray(node.material?.color))
			this.host.append(this.#color(`${pointer}/material/color`,
				node.material.color));
		this.host.append(this.#more(pointer, node));
	}

	#head(node, pointer) {
		return h("div", { class: "node-head" },
			h("strong", {}, label(node)),
			h("span", { class: "type" }, node.type),
			h("code", { class: "pointer" }, pointer));
	}

	/* Sliders of a number, or of all numbers in an array. */
	#numbers(host, pointer, name, value, kind) {
		if (typeof value === "number") {
			if (this.count++ < MOST)
				host.append(this.#slider(pointer, name, value, kind, name));
		} else if (Array.isArray(value) && value.every((v) => typeof v === "number")) {
			const group = h("div", { class: "vector" },
				h("span", { class: "vector-name" }, name));
			value.forEach((v, i) => {
				if (this.count++ < MOST)
					group.append(this.#slider(`${pointer}/${i}`, AXES[i] ?? i, v,
						Array.isArray(value) && kind === "radii" ? "length" : kind,
						`${name} ${AXES[i] ?? i}`));
			});
			host.append(group);
		} else if (value !== null && typeof value === "object") {
			for (const [key, v] of Object.entries(value)) {
				const inner = { point: "position", segment: "position",
					triangle: "position", weight: "weight" }[key] ?? kind;
				this.#numbers(host, `${pointer}/${key}`,
					Array.isArray(value) ? `${name} ${key}` : key, v, inner);
			}
		}
	}

	#slider(pointer, name, value, kind, title) {
		const { min, max } = range(kind, value, this.size);
		const one = slider({ name, value, min, max, title, compact: name.length === 1,
			changed: (v) => this.edit([{ pointer, value: v }]) });
		this.sets.push([pointer, (v) => typeof v === "number" && one.set(v)]);
		return one.element;
	}

	#rotation(pointer, value) {
		const group = h("div", { class: "vector" },
			h("span", { class: "vector-name" }, "rotation, degrees"));
		const angles = (q) => new Euler().setFromQuaternion(
			new Quaternion(...q).normalize(), "ZYX");
		const now = angles(value);
		let written = null;
		const sliders = ["x", "y", "z"].map((axis) => slider({ name: axis,
			value: MathUtils.radToDeg(now[axis]), min: -180, max: 180, step: 0.5,
			title: `rotation ${axis}`, compact: true, changed: (v) => {
				now[axis] = MathUtils.degToRad(v);
				written = new Quaternion().setFromEuler(now).toArray().map((x) =>
					Number(x.toFixed(6)));
				this.edit([{ pointer, value: written }]);
			} }));
		// Other angles may be of the same rotation: one's own stay.
		this.sets.push([pointer, (q) => {
			if (!Array.isArray(q) || String(q) === String(written))
				return;
			written = null;
			now.copy(angles(q));
			sliders.forEach((one, i) =>
				one.set(MathUtils.radToDeg(now["xyz"[i]])));
		}]);
		group.append(...sliders.map((o) => o.element));
		return group;
	}

	#color(pointer, value) {
		const input = h("input", { type: "color", value: toHex(value),
			"aria-label": "colour", oninput: () => this.edit([{ pointer,
				value: fromHex(input.value) }]) });
		this.sets.push([pointer, (v) => {
			if (Array.isArray(v) && document.activeElement !== input)
				input.value = toHex(v);
		}]);
		return h("div", { class: "slider" }, h("label", {}, "colour"), input);
	}

	/* Members that the node may have and has not. */
	#more(pointer, node) {
		const missing = ["id", "material", "translation", "rotation", "scale",
			"exponent", "weight", "rounding"].filter((m) =>
			!(m in node) && (m in COMMON || m in (TYPES[node.type]?.members ?? {})) &&
			!(node.matrix && ["translation", "rotation", "scale"].includes(m)));
		return h("div", { class: "more" }, ...missing.map((m) => h("button", {
			class: "chip", "data-add": m, onclick: () => {
				const value = m === "id" ? this.#freeId(node.type)
					: JSON.parse(TEMPLATES[m]);
				this.edit([{ pointer: `${pointer}/${m}`, value }]);
			} }, `+ ${m}`)));
	}

	#freeId(type) {
		const text = JSON.stringify(this.doc);
		for (let i = 1; ; i++)
			if (!text.includes(`"${type}-${i}"`))
				return `${type}-${i}`;
	}

	#operator(pointer, node) {
		const choice = h("select", { "aria-label": "operator", onchange: () => {
			const to = choice.value;
			const now = this.#now(pointer);
			this.edit([{ pointer: `${pointer}/operator`, value: to === "custom"
				? written(now.profile ?? { type: "smooth" },
					now.opening ?? operatorOf({}, { operator: "camel" }, "").opening)
				: to }]);
		} }, ...OPERATORS.map((o) => h("option", { value: o }, o)),
		...Object.keys(this.doc.operators ?? {}).map((o) =>
			h("option", { value: o }, `${o} (the document's)`)),
		h("option", { value: "custom" }, "custom"));
		const now = operatorOf(this.doc, node, pointer);
		choice.value = now.name ?? "custom";
		this.sets.push([`${pointer}/operator`, (o) => {
			choice.value = typeof o === "string" ? o : o ? "custom" : "clean";
		}]);
		const head = h("div", { class: "slider" }, h("label", {}, "operator"), choice);
		if (!now.profile)
			return [head, now.classic ? h("p", { class: "hint" },
				`“${now.classic}” has no angles: it works on values alone.`) : null,
			...this.#classic(now)].filter((e) => e);
		return [head, ...this.#curves(pointer, now)];
	}

	#now(pointer) {
		return operatorOf(this.doc, at(this.doc, pointer), pointer);
	}

	/* Numbers of operators without angles. */
	#classic(now) {
		const host = h("div");
		const value = at(this.doc, now.pointer);
		if (now.classic)
			for (const [name, v] of Object.entries(value))
				if (name !== "type")
					this.#numbers(host, `${now.pointer}/${name}`, name, v, "weight");
		return [host];
	}

	/* The operator of the node there, with another profile or opening. */
	#write(pointer, profile, opening) {
		const now = this.#now(pointer);
		const edits = [];
		if (!now.full) {
			edits.push({ pointer: now.pointer, value: written(
				profile ?? now.profile, opening ?? now.opening) });
		} else {
			if (opening)
				edits.push({ pointer: `${now.pointer}/opening`, value: opening });
			if (profile)
				edits.push({ pointer: `${now.pointer}/profile`, value: profile },
					...at(this.doc, now.pointer)?.draft ? []
						: [{ pointer: `${now.pointer}/draft`, value: true }]);
		}
		this.edit(edits);
	}

	/* Opens the node's operator to theta, at the angle that parameter is of. */
	open(pointer, parameter, theta) {
		const o = structuredClone(this.#now(pointer).opening);
		const i = Number(parameter.replace("theta", "") || NaN);
		o.theta = o.theta.map((t, j) => Number.isNaN(i) || i === j ? theta : t);
		this.#write(pointer, null, lawful(o, 1));
	}

	/* The id by which requests may name the node; one is given to it if it has
	 * none. */
	named(pointer) {
		const node = at(this.doc, pointer);
		if (node.id)
			return node.id;
		const id = this.#freeId(node.type);
		this.edit([{ pointer: `${pointer}/id`, value: id }]);
		return id;
	}

	#curves(pointer, first) {
		const write = (profile, opening) =>
			this.#write(pointer, profile, opening);
		const plot = openingPlot((i, alpha, theta) => {
			const o = structuredClone(this.#now(pointer).opening);
			o.alpha[i] = round(alpha);
			o.theta[i] = round(Math.min(Math.PI / 4, Math.max(0, theta)));
			write(null, lawful(o, i));
		});
		const sliders = [];
		const one = (name, title, get, put, limits) => {
			const made = slider({ name, title, value: get(first.opening), ...limits,
				compact: true, changed: (v) => {
					const o = structuredClone(this.#now(pointer).opening);
					put(o, round(v));
					write(null, lawful(o, Number(name.slice(1)
						.replace("₀", 0).replace("₁", 1).replace("₂", 2))));
				} });
			sliders.push([made, get]);
			return made.element;
		};
		const rows = h("div", { class: "opening-sliders" },
			...[0, 1, 2].map((i) => one(`α${"₀₁₂"[i]}`, `alpha${i}`, (o) => o.alpha[i],
				(o, v) => { o.alpha[i] = v; }, { min: 0, max: Math.PI })),
			...[0, 1, 2].map((i) => one(`θ${"₀₁₂"[i]}`, `theta${i}`, (o) => o.theta[i],
				(o, v) => { o.theta[i] = v; }, { min: 0, max: Math.PI / 4 })),
			...[0, 1].map((i) => one(`w${"₀₁"[i]}`, `w${i}`, (o) => o.w[i],
				(o, v) => { o.w[i] = v; }, { min: 0.05, max: 20, log: true })));
		const shape_ = profilePlot();
		const kind = h("select", { "aria-label": "profile", onchange: () => write(
			kind.value === "bulge" ? { type: "bulge", k: 0.8 }
				: kind.value === "samples" ? SAMPLES : { type: kind.value }, null) },
		...["smooth", "bulge", "circle", "samples"].map((p) =>
			h("option", { value: p }, p)));
		const k = slider({ name: "K", title: "bulge K", min: 0, max: 1,
			value: first.profile.k ?? 0.8, compact: true, changed: (v) =>
				write({ type: "bulge", k: v }, null) });
		this.refresh = () => {
			const now = this.#now(pointer);
			if (!now.profile)
				return;
			plot.set(now.opening);
			for (const [made, get] of sliders)
				made.set(get(now.opening));
			shape_.set(now.profile);
			kind.value = now.profile.type;
			k.element.hidden = now.profile.type !== "bulge";
			k.set(now.profile.k ?? 0.8);
		};
		this.refresh();
		return [h("div", { class: "block" }, h("h3", {}, "Opening ",
			h("span", { class: "soft" }, "θ by angle of gradients, α")),
		plot.element, rows, h("div", { class: "more" }, h("button", { class: "chip",
			title: "The opening with which the blend ends at a point that you click",
			onclick: () => this.aim(pointer) }, "open to a clicked point"))),
		h("div", { class: "block" }, h("h3", {}, "Profile ",
			h("span", { class: "soft" }, "the blend’s cross-section")),
		h("div", { class: "profile-row" }, shape_.element,
			h("div", {}, kind, k.element)))];
	}
}

const SAMPLES = { type: "samples", points: [[0, 1], [0.3, 0.985], [0.6, 0.9],
	[0.8, 0.8]] };
const round = (x) => Number(x.toFixed(4));

/* An operator in full, as it is written: with drafts, so that a profile may
 * move. */
function written(profile, opening) {
	return { profile, opening: { alpha: opening.alpha.map(round),
		theta: opening.theta.map(round), w: opening.w.map(round) }, draft: true };
}

/* Angles in order, the others giving way to the one that was moved; equal, or
 * at least 0.01 apart. */
function lawful(o, moved) {
	const a = o.alpha;
	a[moved] = Math.min(Math.PI, Math.max(0, a[moved]));
	for (let i = moved + 1; i < 3; i++)
		a[i] = Math.max(a[i], a[i - 1]);
	for (let i = moved - 1; i >= 0; i--)
		a[i] = Math.min(a[i], a[i + 1]);
	for (let i = 1; i < 3; i++)
		if (a[i] !== a[i - 1] && a[i] - a[i - 1] < 0.0101)
			a[i === moved ? i : i - 1] = a[i === moved ? i - 1 : i];
	o.alpha = a.map((x) => Math.min(3.1416, round(x)));
	o.theta = o.theta.map(round);
	return o;
}

