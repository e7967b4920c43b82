// Elements without templates: nothing here writes a style attribute, which the
// Content-Security-Policy would refuse.

const SVG = "http://www.w3.org/2000/svg";

function fill(element, properties, children) {
	for (const [name, value] of Object.entries(properties ?? {})) {
		if (value === undefined || value === null || value === false)
			continue;
		if (name.startsWith("on"))
			element.addEventListener(name.slice(2), value);
		else if (name === "value" || name === "checked")
			element[name] = value;
		else
			element.setAttribute(name, value === true ? "" : value);
	}
	element.append(...children.flat().filter((c) => c !== null &&
		c !== undefined && c !== false));
	return element;
}

export function h(tag, properties, ...children) {
	return fill(document.createElement(tag), properties, children);
}

export function s(tag, properties, ...children) {
	return fill(document.createElementNS(SVG, tag), properties, children);
}

const paths = {
	blob: "M8 3a6 6 0 0 1 6 5c.7 2.3 7 1.5 7 6a4.5 4.5 0 0 1-8.3 2.3C11 14 2 16.5 2 9a6 6 0 0 1 6-6z",
	gallery: "M4 4h7v7H4zM13 4h7v7h-7zM4 13h7v7H4zM13 13h7v7h-7z",
	share: "M10 14a4 4 0 0 0 6 .5l3-3a4 4 0 0 0-6-6l-1 1M14 10a4 4 0 0 0-6-.5l-3 3a4 4 0 0 0 6 6l1-1",
	download: "M12 4v11M7 11l5 5 5-5M5 20h14",
	open: "M3 7a2 2 0 0 1 2-2h4l2 2h8a2 2 0 0 1 2 2v8a2 2 0 0 1-2 2H5a2 2 0 0 1-2-2z",
	fit: "M4 9V4h5M15 4h5v5M20 15v5h-5M9 20H4v-5",
	wire: "M12 3l9 16H3zM7.5 11h9L12 19z",
	slice: "M3 14l9-4 9 4-9 5zM12 10V3M9.5 5.5L12 3l2.5 2.5",
	play: "M7 4l13 8-13 8z",
	pause: "M7 4v16M17 4v16",
	close: "M6 6l12 12M18 6L6 18",
};

export function icon(name) {
	return s("svg", { viewBox: "0 0 24 24", class: `icon icon-${name}`,
		"aria-hidden": "true" }, s("path", { d: paths[name] }));
}

/* A number as people write it: n significant digits, no trailing zeros. */
export function digits(x, n = 4) {
	if (!Number.isFinite(x))
		return "–";
	if (x === 0)
		return "0";
	const size = Math.abs(x);
	if (size >= 1e6 || size < 1e-4)
		return x.toExponential(Math.max(0, n - 2)).replace("e+", "e");
	return String(Number(x.toPrecision(n)));
}

/* Dragging with the pointer captured: move(event) until it is let go. */
export function drag(element, begin) {
	element.addEventListener("pointerdown", (down) => {
		if (down.button !== 0)
			return;
		const { move, end } = begin(down) ?? {};
		if (!move)
			return;
		down.preventDefault();
		element.setPointerCapture(down.pointerId);
		const finish = (up) => {
			element.removeEventListener("pointermove", move);
			element.removeEventListener("pointerup", finish);
			element.removeEventListener("pointercancel", finish);
			end?.(up);
		};
		element.addEventListener("pointermove", move);
		element.addEventListener("pointerup", finish);
		element.addEventListener("pointercancel", finish);
	});
}

/* Whether all stands in one column, where scrolling to a part would take the
 * picture away. */
export const narrow = () => matchMedia("(max-width: 820px)").matches;
