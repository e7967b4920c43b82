// The document as a tree of nodes. One is selected at most.
import { h, s } from "./dom.js";
import { children, label, TYPES, walk } from "./nodes.js";

const MANY = 300;

const glyphs = {
	soft: "M8 2.5a5.5 5.5 0 1 1 0 11 5.5 5.5 0 0 1 0-11z",
	solid: "M8 1.5l6 3.3v6.4l-6 3.3-6-3.3V4.8zM2 4.8l6 3.2 6-3.2M8 8v6.5",
	blend: "M6 3.5a4.5 4.5 0 1 0 0 9 4.5 4.5 0 0 0 0-9zM10 3.5a4.5 4.5 0 1 1 0 9 4.5 4.5 0 0 1 0-9z",
	warp: "M4 2c5 3 3 9 8 12M9 2c5 3-1 9 4 12",
	ref: "M5 11l6-6M6.5 5H11v4.5",
};

const linear = (x) => Math.round(255 * (x <= 0.0031308 ? 12.92 * x
	: 1.055 * x ** (1 / 2.4) - 0.055));
export const toHex = (color) => "#" + color.slice(0, 3).map((x) =>
	linear(Math.min(1, Math.max(0, Number(x) || 0))).toString(16)
		.padStart(2, "0")).join("");
export const fromHex = (hex) => [1, 3, 5].map((i) => {
	const x = parseInt(hex.slice(i, i + 2), 16) / 255;
	return Number((x <= 0.04045 ? x / 12.92 : ((x + 0.055) / 1.055) ** 2.4)
		.toFixed(4));
});

export class Tree {
	selected = null;
	#open = new Map();
	#rows = new Map();

	/* chosen(pointer): the user has selected a node. */
	constructor(host, chosen) {
		this.host = host;
		this.chosen = chosen;
		host.setAttribute("role", "tree");
		host.setAttribute("aria-label", "Nodes");
		host.tabIndex = 0;
		host.addEventListener("keydown", (event) => this.#key(event));
	}

	render(doc) {
		this.doc = doc;
		const list = [];
		if (doc?.root && typeof doc.root === "object") {
			let count = 0;
			for (const n of walk(doc.root))
				count += n ? 1 : 0;
			this.many = count > MANY;
			this.#list(list, doc.root, "/root", 0, null);
		}
		// While numbers change, rows do not.
		const shown = JSON.stringify(list);
		if (shown === this.shown)
			return;
		this.shown = shown;
		this.#rows.clear();
		this.host.replaceChildren(...list.map((row) => this.#row(row)));
		this.mark(false);
	}

	#expanded(pointer, depth) {
		return this.#open.get(pointer) ?? (!this.many || depth < 1);
	}

	/* What its row says of each node that has one. */
	#list(out, node, pointer, depth, color) {
		const kids = children(node, pointer);
		const own = node?.material?.color;
		color = Array.isArray(own) ? own : color;
		const expanded = this.#expanded(pointer, depth);
		out.push({ pointer, depth, expanded, parent: kids.length > 0,
			name: label(node), type: node?.id ? node.type : null,
			kind: TYPES[node?.type]?.kind, note: this.#note(node, kids),
			color: color && !kids.length ? toHex(color) : null });
		if (expanded)
			for (const [p, child] of kids)
				this.#list(out, child, p, depth + 1, color);
	}

	#row({ pointer, depth, expanded, parent, name, type, kind, note, color }) {
		const row = h("div", { class: "row", role: "treeitem",
			"data-pointer": pointer, "aria-level": depth + 1,
			id: `node${pointer.replaceAll("/", "-")}`,
			"aria-expanded": parent ? String(expanded) : undefined,
			onclick: () => this.select(pointer, true) },
		h("button", { class: "twist", tabindex: "-1", "aria-hidden": "true",
			onclick: (event) => {
				event.stopPropagation();
				this.#toggle(pointer, depth);
			} }, parent ? (expanded ? "▾" : "▸") : ""),
		s("svg", { class: `glyph ${kind ?? "none"}`, viewBox: "0 0 16 16",
			"aria-hidden": "true" }, s("path", { d: glyphs[kind ?? "ref"] })),
		h("span", { class: "name" }, name),
		type ? h("span", { class: "type" }, type) : null,
		h("span", { class: "space" }),
		note ? h("span", { class: "note" }, note) : null,
		color ? this.#swatch(color) : null);
		row.style.setProperty("--depth", depth);
		this.#rows.set(pointer, row);
		return row;
	}

	#note(node, kids) {
		const operator = node?.operator;
		const text = typeof operator === "string" ? operator
			: operator?.type ?? (operator ? "custom" : "");
		return text || (node?.type === "ref" ? `→ ${node.ref}`
			: kids.length > 8 ? String(kids.length) : null);
	}

	#swatch(color) {
		const dot = h("span", { class: "swatch" });
		dot.style.backgroundColor = color;
		return dot;
	}

	#toggle(pointer, depth) {
		this.#open.set(pointer, !this.#expanded(pointer, depth));
		this.render(this.doc);
	}

	/* Selects a node, with all above it open; by the user, who is told on. */
	select(pointer, told = false) {
		this.selected = pointer;
		if (pointer && !this.#rows.has(pointer)) {
			for (let p = pointer; p.length > 5; p = p.replace(
				/(\/children\/\d+|\/child)$/, ""))
				this.#open.set(p.replace(/(\/children\/\d+|\/child)$/, ""), true);
			this.render(this.doc);
		}
		this.mark();
		if (told)
			this.chosen(pointer);
	}

	mark(scroll = true) {
		for (const [pointer, row] of this.#rows) {
			const here = pointer === this.selected;
			row.setAttribute("aria-selected", String(here));
			if (!here)
				continue;
			this.host.setAttribute("aria-activedescendant", row.id);
			// Of this list, not of the page.
			if (scroll) {
				const top = row.offsetTop - this.host.offsetTop;
				this.host.scrollTop = Math.min(top, Math.max(this.host.scrollTop,
					top + row.offsetHeight - this.host.clientHeight));
			}
		}
	}

	#key(event) {
		const rows = [...this.#rows.keys()];
		const i = rows.indexOf(this.selected);
		const row = this.#rows.get(this.selected);
		const depth = Number(row?.getAttribute("aria-level") ?? 1) - 1;
		const open = row?.getAttribute("aria-expanded");
		const up = this.selected?.replace(/(\/children\/\d+|\/child)$/, "");
		const moves = {
			ArrowDown: () => this.select(rows[Math.min(i + 1, rows.length - 1)], true),
			ArrowUp: () => this.select(rows[Math.max(i - 1, 0)], true),
			Home: () => this.select(rows[0], true),
			End: () => this.select(rows[rows.length - 1], true),
			ArrowRight: () => open === "false" ? this.#toggle(this.selected, depth)
				: open === "true" && this.select(rows[i + 1], true),
			ArrowLeft: () => open === "true" ? this.#toggle(this.selected, depth)
				: up && this.select(up, true),
		};
		if (rows.length && moves[event.key]) {
			event.preventDefault();
			moves[event.key]();
		}
	}
}
