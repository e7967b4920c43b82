// Asks for a token, where the daemon wants one.
import { h } from "./dom.js";

/* The token that the user enters, or null. wrong: the one before was. */
export function askToken(wrong) {
	return new Promise((done) => {
		const field = h("input", { type: "password", autocomplete: "off",
			"aria-label": "Token", required: true, spellcheck: "false" });
		const dialog = h("dialog", { class: "ask", "aria-label": "Token" },
			h("form", { method: "dialog" },
				h("h2", {}, wrong ? "That token does not count"
					: "This daemon asks for a token"),
				h("p", { class: "soft" }, "It is kept until this tab is closed."),
				field,
				h("div", { class: "ask-buttons" },
					h("button", { class: "plain", type: "button",
						onclick: () => dialog.close() }, "Cancel"),
					h("button", { class: "plain primary", type: "submit",
						value: "ok" }, "Go on"))));
		dialog.addEventListener("close", () => {
			const given = dialog.returnValue === "ok" && field.value.trim();
			dialog.remove();
			done(given || null);
		});
		document.body.append(dialog);
		dialog.showModal();
	});
}
