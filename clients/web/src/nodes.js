// The language of documents: which nodes there are, their members, and what
// kind of number each member is.

const soft = { exponent: "exponent", weight: "weight" };
const composition = { operator: "operator", children: "nodes" };
const warp = { axis: "direction", center: "position", child: "node" };

export const TYPES = {
	point: { kind: "soft", members: { center: "position", radius: "length", ...soft } },
	segment: { kind: "soft", members: { a: "position", b: "position", radius: "length", radii: "lengths", ...soft } },
	triangle: { kind: "soft", members: { a: "position", b: "position", c: "position", radius: "length", ...soft } },
	disc: { kind: "soft", members: { center: "position", normal: "direction", disc_radius: "length", radius: "length", ...soft } },
	circle: { kind: "soft", members: { center: "position", normal: "direction", ring_radius: "length", radius: "length", ...soft } },
	sphere: { kind: "solid", members: { center: "position", radius: "length", falloff: "length" } },
	box: { kind: "solid", members: { center: "position", half_size: "lengths", rounding: "rounding", falloff: "length" } },
	cylinder: { kind: "solid", members: { a: "position", b: "position", radius: "length", falloff: "length" } },
	capsule: { kind: "solid", members: { a: "position", b: "position", radius: "length", falloff: "length" } },
	cone: { kind: "solid", members: { a: "position", b: "position", radii: "lengths", falloff: "length" } },
	torus: { kind: "solid", members: { center: "position", axis: "direction", major: "length", minor: "length", falloff: "length" } },
	plane: { kind: "solid", members: { point: "position", normal: "direction", falloff: "length" } },
	convolution: { kind: "soft", members: { elements: "elements", radius: "length", s: "length", kernel: "word" } },
	volume: { kind: "solid", members: { volume: "word", falloff: "length" } },
	union: { kind: "blend", members: composition },
	intersection: { kind: "blend", members: composition },
	difference: { kind: "blend", members: composition },
	sum: { kind: "blend", members: { children: "nodes" } },
	ricci: { kind: "blend", members: { n: "power", children: "nodes" } },
	twist: { kind: "warp", members: { ...warp, rate: "rate", from: "coordinate", to: "coordinate" } },
	taper: { kind: "warp", members: { ...warp, factor: "factor", from: "coordinate", to: "coordinate" } },
	bend: { kind: "warp", members: { ...warp, direction: "direction", rate: "rate", from: "coordinate", to: "coordinate" } },
	ref: { kind: "ref", members: { ref: "word" } },
};

export const COMMON = { id: "word", material: "material",
	translation: "position", rotation: "rotation", scale: "scale",
	matrix: "matrix" };

export const OPERATORS = ["sharp", "clean", "blend", "camel", "organic",
	"contact"];

/* What a node is called in lists. */
export function label(node) {
	return node?.id ?? node?.type ?? "?";
}

/* A node's children: [pointer, node], in the document's order. */
export function children(node, pointer) {
	if (Array.isArray(node?.children))
		return node.children.map((c, i) => [`${pointer}/children/${i}`, c]);
	return node?.child && typeof node.child === "object"
		? [[`${pointer}/child`, node.child]] : [];
}

export function* walk(node, pointer = "/root") {
	yield [pointer, node];
	for (const [p, c] of children(node, pointer))
		yield* walk(c, p);
}

/* The pointer of the node that a pointer is within. */
export function nodeOf(pointer) {
	const m = /^\/root(\/children\/\d+|\/child)*/.exec(pointer);
	return m ? m[0] : "/root";
}

/* A slider's range for a number of that kind; size is the model's. */
export function range(kind, value, size) {
	const reach = Math.max(size, 1.5 * Math.abs(value));
	switch (kind) {
	case "position": case "coordinate":
		return { min: -reach, max: reach };
	case "length": case "lengths":
		return { min: 1e-3 * Math.max(value, 1e-3 * size),
			max: Math.max(3 * value, 0.1 * size) };
	case "rounding":
		return { min: 0, max: Math.max(2 * value, 0.1 * size) };
	case "direction": return { min: -1, max: 1 };
	case "rate": return { min: -Math.max(3.2, 2 * Math.abs(value)),
		max: Math.max(3.2, 2 * Math.abs(value)) };
	case "factor": return { min: 0.05, max: Math.max(3, 2 * value) };
	case "scale": return { min: value < 0 ? -Math.max(3, -2 * value) : 0.05,
		max: value < 0 ? -0.05 : Math.max(3, 2 * value) };
	case "exponent": return { min: 3, max: Math.max(16, 1.5 * value) };
	case "power": return { min: 1, max: Math.max(16, 1.5 * value) };
	case "weight": return { min: 0, max: Math.max(4, 2 * value) };
	default: return { min: Math.min(-reach, 2 * value),
		max: Math.max(reach, 2 * value) };
	}
}

/* What a new composition's or warp's numbers may look like in a completion. */
export const TEMPLATES = {
	center: "[0, 0, 0]", a: "[0, 0, 0]", b: "[1, 0, 0]", c: "[0, 1, 0]",
	normal: "[0, 0, 1]", axis: "[0, 0, 1]", direction: "[1, 0, 0]",
	point: "[0, 0, 0]", half_size: "[0.5, 0.5, 0.5]", radii: "[0.5, 0.25]",
	radius: "0.5", falloff: "0.25", disc_radius: "1", ring_radius: "1",
	major: "1", minor: "0.25", rounding: "0.1", exponent: "3", weight: "1",
	n: "4", rate: "1", from: "0", to: "1", factor: "0.5", s: "1",
	operator: "\"camel\"", children: "[]", child: "{}", ref: "\"\"",
	id: "\"\"", translation: "[0, 0, 0]", rotation: "[0, 0, 0, 1]",
	scale: "1", matrix: "[1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1]",
	material: "{\"color\": [0.8, 0.3, 0.2]}", volume: "\"\"",
	kernel: "\"cauchy\"", elements: "[]",
};
