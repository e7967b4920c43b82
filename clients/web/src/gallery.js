// The examples, each with a picture that the daemon makes of it when the
// gallery is first opened.
import examples from "gallery:examples";

import * as api from "./api.js";
import { h, icon } from "./dom.js";

export const EXAMPLES = examples;

const PICTURE = { width: 264, height: 198, samples: 4 };

export class Gallery {
	#pictures = new Map();
	#drawing = null;       // the scene that pictures are made of

	/* chosen(example) */
	constructor(chosen) {
		this.cards = new Map();
		const card = (e) => {
			const made = h("button", { class: "card", "data-file": e.file,
				onclick: () => {
					this.close();
					chosen(e);
				} },
			h("span", { class: "picture" }, icon("blob")),
			h("span", { class: "card-title" }, e.title),
			h("span", { class: "card-note" }, e.note));
			this.cards.set(e.file, made);
			return made;
		};
		this.element = h("dialog", { class: "gallery", "aria-label": "Examples",
			onclick: (event) => event.target === this.element && this.close() },
		h("div", { class: "gallery-in" },
			h("header", {}, h("h2", {}, "Examples"), h("p", { class: "soft" },
				"Each opens as a scene of your own."),
			h("button", { class: "icon-button", "aria-label": "Close",
				onclick: () => this.close() }, icon("close"))),
			h("div", { class: "cards" }, ...EXAMPLES.map(card))));
		window.addEventListener("pagehide", () => this.#drawing &&
			api.remove(this.#drawing, { keepalive: true }).catch(() => {}));
	}

	open() {
		this.element.showModal();
		this.#draw();
	}

	close() {
		this.element.close();
	}

	/* One after another, while it is open: they share the device with whatever
	 * else is going on. */
	async #draw() {
		if (this.#drawing)
			return;
		const id = `gallery-${Math.random().toString(36).slice(2, 10)}`;
		this.#drawing = id;
		try {
			for (const e of EXAMPLES) {
				if (!this.element.open)
					break;
				if (this.#pictures.has(e.file))
					continue;
				if (!await this.#picture(id, e))
					break;
			}
		} finally {
			this.#drawing = null;
			api.remove(id).catch(() => {});
		}
	}

	/* A card without a picture will do; false if the daemon is away. */
	async #picture(id, e) {
		try {
			await api.put(id, e.text, {});
			const png = await api.file(id, "render", PICTURE,
				{ accept: "image/png" });
			this.#pictures.set(e.file, png);
			const image = h("img", { alt: "", src: URL.createObjectURL(png) });
			this.cards.get(e.file).querySelector(".picture").replaceChildren(image);
		} catch (error) {
			if (error instanceof api.Offline)
				return false;
			if (!(error instanceof api.Problem))
				throw error;
		}
		return true;
	}
}
