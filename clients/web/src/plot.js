// Two plots: an opening θ(α), whose three points can be dragged, and a
// profile's silhouette.
import { drag, s } from "./dom.js";
import { opening, silhouette } from "./curves.js";

const W = 272;
const H = 132;
const PAD = { left: 38, right: 10, top: 10, bottom: 22 };
const px = (a) => PAD.left + a / Math.PI * (W - PAD.left - PAD.right);
const py = (t) => H - PAD.bottom - t / (Math.PI / 4) * (H - PAD.top - PAD.bottom);

const path = (points) => points.map(([x, y], i) =>
	`${i ? "L" : "M"}${x.toFixed(2)} ${y.toFixed(2)}`).join("");

/* moved(i, alpha, theta) as point i is dragged, or pushed by the arrow keys. */
export function openingPlot(moved) {
	const curve = s("path", { class: "curve" });
	const area = s("path", { class: "area" });
	const dots = [0, 1, 2].map((i) => s("circle", { class: "dot", r: 5.5,
		tabindex: "0", role: "button", "aria-label": `opening point ${i}, arrow keys`,
		"data-point": i }));
	const guides = [["0", 0], ["π/4", 0.25], ["π/2", 0.5], ["3π/4", 0.75],
		["π", 1]].map(([text, t]) => [
		s("line", { class: "guide", x1: px(t * Math.PI), x2: px(t * Math.PI),
			y1: PAD.top, y2: H - PAD.bottom }),
		s("text", { class: "tick", x: px(t * Math.PI), y: H - 7,
			"text-anchor": "middle" }, text)]);
	const levels = [["blend", 0], ["π/8", 0.5], ["sharp", 1]].map(([text, t]) => [
		s("line", { class: "guide", x1: PAD.left, x2: W - PAD.right,
			y1: py(t * Math.PI / 4), y2: py(t * Math.PI / 4) }),
		s("text", { class: "tick", x: PAD.left - 9, y: py(t * Math.PI / 4) + 3,
			"text-anchor": "end" }, text)]);
	const element = s("svg", { class: "plot opening", viewBox: `0 0 ${W} ${H}`,
		role: "group", "aria-label": "Opening: θ by the angle α between gradients" },
	...guides.flat(), ...levels.flat(), area, curve, ...dots);
	let shown = null;
	dots.forEach((dot, i) => drag(dot, () => {
		const at = (event) => {
			const box = element.getBoundingClientRect();
			const x = (event.clientX - box.left) / box.width * W;
			const y = (event.clientY - box.top) / box.height * H;
			return [Math.PI * (x - PAD.left) / (W - PAD.left - PAD.right),
				Math.PI / 4 * (H - PAD.bottom - y) / (H - PAD.top - PAD.bottom)];
		};
		return { move: (event) => moved(i, ...at(event)) };
	}));
	dots.forEach((dot, i) => dot.addEventListener("keydown", (event) => {
		const [a, t] = { ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, 1],
			ArrowDown: [0, -1] }[event.key] ?? [];
		if (a === undefined)
			return;
		event.preventDefault();
		const step = (event.shiftKey ? 0.1 : 0.01) * Math.PI;
		moved(i, shown.alpha[i] + a * step, shown.theta[i] + t * step / 4);
	}));
	return { element, set(values) {
		shown = values;
		const points = Array.from({ length: 121 }, (_, i) => i / 120 * Math.PI)
			.concat(values.alpha.flatMap((a) => [a, a + 1e-4])).sort((a, b) => a - b)
			.filter((a) => a >= 0 && a <= Math.PI)
			.map((a) => [px(a), py(opening(shown, a))]);
		curve.setAttribute("d", path(points));
		area.setAttribute("d", `${path(points)}L${px(Math.PI)} ${py(0)}L${px(0)} ${py(0)}Z`);
		dots.forEach((dot, i) => {
			dot.setAttribute("cx", px(values.alpha[i]));
			dot.setAttribute("cy", py(values.theta[i]));
		});
	} };
}

/* The silhouette in the square of f1 and f2, from (0,1) to (1,0), beside the
 * sharp union's corner. */
export function profilePlot() {
	const S = 132;
	const x = (v) => 20 + v * (S - 34);
	const y = (v) => S - 20 - v * (S - 34);
	const curve = s("path", { class: "curve" });
	const area = s("path", { class: "area" });
	const element = s("svg", { class: "plot profile", viewBox: `0 0 ${S} ${S}`,
		role: "img", "aria-label": "Profile: the blend's silhouette" },
	s("line", { class: "guide", x1: x(0), y1: y(0), x2: x(1.05), y2: y(1.05) }),
	s("path", { class: "corner", d: path([[x(0), y(1)], [x(1), y(1)], [x(1), y(0)]]) }),
	s("line", { class: "axis", x1: x(0), y1: y(0), x2: x(1.08), y2: y(0) }),
	s("line", { class: "axis", x1: x(0), y1: y(0), x2: x(0), y2: y(1.08) }),
	s("text", { class: "tick", x: x(1.02), y: S - 7, "text-anchor": "end" }, "f₁"),
	s("text", { class: "tick", x: 6, y: y(0.98) }, "f₂"), area, curve);
	return { element, set(profile) {
		let points = [];
		try {
			points = silhouette(profile).map(([a, b]) => [x(a), y(b)]);
		} catch {
			// Samples that are being written.
		}
		if (points.some((p) => !p.every(Number.isFinite)))
			points = [];
		curve.setAttribute("d", path(points));
		area.setAttribute("d", points.length
			? `${path(points)}L${x(0)} ${y(0)}Z` : "");
	} };
}
