// A number: its name, a slider, a field to type it in.
import { digits, h } from "./dom.js";

/* {element, set(value), range(min, max)}; changed(value, last) while it moves, and last when it
 * rests. log: the slider's steps are ratios. */
export function slider({ name, value, min, max, step, log, title, unit, changed,
	compact }) {
	const steps = 1000;
	let [low, high] = [min, max].map((x) => log ? Math.log(x) : x);
	const toBar = (v) => steps * ((log ? Math.log(Math.max(v, 1e-12)) : v) - low) /
		(high - low || 1);
	const fromBar = (b) => {
		const x = low + (high - low) * b / steps;
		return tidy(log ? Math.exp(x) : x, (max - min) / 500, step);
	};
	const bar = h("input", { type: "range", min: 0, max: steps, step: 1,
		"aria-label": title ?? name });
	const field = h("input", { type: "text", inputmode: "decimal",
		class: "number", "aria-label": `${title ?? name}, number`,
		spellcheck: "false" });
	const element = h("div", { class: compact ? "slider compact" : "slider",
		"data-name": title ?? name },
	h("label", {}, name), bar, field, unit ? h("span", { class: "unit" }, unit)
		: null);
	const show = (v, all = true) => {
		// Rounding does not move it back.
		if (all && fromBar(Number(bar.value)) !== v)
			bar.value = String(toBar(v));
		bar.style.setProperty("--at", `${Math.min(100, Math.max(0, toBar(v) / 10))}%`);
		if (document.activeElement !== field)
			field.value = digits(v, 4);
	};
	bar.addEventListener("input", () => {
		const v = fromBar(Number(bar.value));
		show(v, false);
		changed(v, false);
	});
	bar.addEventListener("change", () => changed(fromBar(Number(bar.value)), true));
	const typed = () => {
		const v = Number(field.value.replace(",", "."));
		if (field.value.trim() === "" || !Number.isFinite(v)) {
			field.value = digits(fromBar(Number(bar.value)), 4);
		} else {
			show(v);
			changed(v, true);
		}
	};
	field.addEventListener("change", typed);
	field.addEventListener("keydown", (event) => {
		if (event.key === "Enter")
			typed();
		const way = { ArrowUp: 1, ArrowDown: -1 }[event.key];
		if (way) {
			event.preventDefault();
			const v = tidy(Number(field.value) + way * (event.shiftKey ? 10 : 1) *
				(max - min) / 200, (max - min) / 500, step);
			field.value = digits(v);
			bar.value = String(toBar(v));
			changed(v, false);
		}
	});
	show(value);
	/* Other ends, where what it is of has grown. */
	const range = (least, most) => {
		[min, max] = [least, most];
		[low, high] = [min, max].map((x) => log ? Math.log(x) : x);
	};
	return { element, set: show, range };
}

/* A number to about a given fineness, in few decimals. */
export function tidy(v, fineness, step) {
	if (step)
		return Math.round(v / step) * step;
	const decimals = Math.max(0, Math.min(8, Math.ceil(-Math.log10(fineness))));
	return Number(v.toFixed(decimals));
}
