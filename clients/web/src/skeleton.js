// Lines that show where a node is: the skeletons and outlines of the primitives
// below it, in world coordinates. What lies under warps is left out.
import { Matrix4, Quaternion, Vector3 } from "three";

import { children, walk } from "./nodes.js";

const vector = (a) => new Vector3(...(Array.isArray(a) && a.length === 3
	? a.map(Number) : [0, 0, 0]));

function transform(node) {
	if (Array.isArray(node.matrix) && node.matrix.length === 16)
		return new Matrix4().fromArray(node.matrix);
	const scale = node.scale ?? 1;
	return new Matrix4().compose(vector(node.translation),
		new Quaternion(...node.rotation ?? [0, 0, 0, 1]).normalize(),
		Array.isArray(scale) ? vector(scale) : new Vector3(scale, scale, scale));
}

/* Two directions across a third. */
function frame(axis) {
	const n = vector(axis).normalize();
	if (n.lengthSq() === 0)
		n.set(0, 0, 1);
	const u = new Vector3(Math.abs(n.x) < 0.9 ? 1 : 0,
		Math.abs(n.x) < 0.9 ? 0 : 1, 0).cross(n).normalize();
	return [u, new Vector3().crossVectors(n, u), n];
}

function ring(out, center, axis, radius) {
	const [u, v] = frame(axis);
	const steps = 48;
	let before = null;
	for (let i = 0; i <= steps; i++) {
		const a = 2 * Math.PI * i / steps;
		const p = center.clone().addScaledVector(u, radius * Math.cos(a))
			.addScaledVector(v, radius * Math.sin(a));
		if (before)
			out.push(before, p);
		before = p;
	}
}

function ball(out, center, radius) {
	for (const axis of [[1, 0, 0], [0, 1, 0], [0, 0, 1]])
		ring(out, center, axis, radius);
}

function cross(out, p, size) {
	for (const axis of [[1, 0, 0], [0, 1, 0], [0, 0, 1]])
		out.push(p.clone().addScaledVector(vector(axis), -size),
			p.clone().addScaledVector(vector(axis), size));
}

function tube(out, a, b, ra, rb) {
	const axis = b.clone().sub(a);
	const [u, v] = frame(axis.toArray());
	ring(out, a, axis.toArray(), ra);
	ring(out, b, axis.toArray(), rb);
	for (let i = 0; i < 4; i++) {
		const d = u.clone().multiplyScalar(Math.cos(i * Math.PI / 2))
			.addScaledVector(v, Math.sin(i * Math.PI / 2));
		out.push(a.clone().addScaledVector(d, ra), b.clone().addScaledVector(d, rb));
	}
}

function loop(out, points) {
	points.forEach((p, i) => out.push(p, points[(i + 1) % points.length]));
}

function box(out, center, half) {
	const corner = (i) => new Vector3(i & 1 ? 1 : -1, i & 2 ? 1 : -1,
		i & 4 ? 1 : -1).multiply(half).add(center);
	for (let i = 0; i < 8; i++)
		for (const bit of [1, 2, 4])
			if (!(i & bit))
				out.push(corner(i), corner(i | bit));
}

const draw = {
	point: (n, out) => { cross(out, vector(n.center), n.radius * 0.35);
		ball(out, vector(n.center), n.radius); },
	segment: (n, out) => {
		const [ra, rb] = n.radii ?? [n.radius, n.radius];
		out.push(vector(n.a), vector(n.b));
		tube(out, vector(n.a), vector(n.b), ra, rb);
	},
	triangle: (n, out) => loop(out, [n.a, n.b, n.c].map(vector)),
	disc: (n, out) => { ring(out, vector(n.center), n.normal, n.disc_radius);
		cross(out, vector(n.center), 0.2 * n.radius); },
	circle: (n, out) => {
		for (const side of [-1, 0, 1])
			ring(out, vector(n.center), n.normal, n.ring_radius + side * n.radius);
	},
	sphere: (n, out) => ball(out, vector(n.center), n.radius),
	box: (n, out) => box(out, vector(n.center), vector(n.half_size)),
	cylinder: (n, out) => tube(out, vector(n.a), vector(n.b), n.radius, n.radius),
	capsule: (n, out) => { out.push(vector(n.a), vector(n.b));
		tube(out, vector(n.a), vector(n.b), n.radius, n.radius); },
	cone: (n, out) => tube(out, vector(n.a), vector(n.b), ...n.radii),
	torus: (n, out) => {
		ring(out, vector(n.center), n.axis, n.major + n.minor);
		ring(out, vector(n.center), n.axis, n.major);
		ring(out, vector(n.center), n.axis, n.major - n.minor);
	},
	plane: (n, out, size) => {
		const [u, v] = frame(n.normal);
		const p = vector(n.point);
		loop(out, [[1, 1], [-1, 1], [-1, -1], [1, -1]].map(([a, b]) =>
			p.clone().addScaledVector(u, a * size / 2)
				.addScaledVector(v, b * size / 2)));
	},
	convolution: (n, out) => {
		for (const e of n.elements ?? []) {
			if (e.segment)
				out.push(...e.segment.map(vector));
			else if (e.triangle)
				loop(out, e.triangle.map(vector));
			else if (e.point)
				cross(out, vector(e.point), n.radius * 0.35);
		}
	},
};

const warps = new Set(["twist", "taper", "bend"]);

/* [x, y, z, …] of line segments; size: of the model, for what is endless. */
export function skeleton(doc, pointer, size) {
	const out = [];
	const ids = new Map();
	try {
		for (const [, node] of walk(doc.root))
			if (node?.id)
				ids.set(node.id, node);
		const visit = (node, matrix, shown, at, depth) => {
			if (depth > 64 || out.length > 20000)
				return;
			const here = matrix.clone().multiply(transform(node));
			shown ||= at === pointer;
			if (warps.has(node.type))
				return;
			if (node.type === "ref" && shown && ids.has(node.ref))
				visit(ids.get(node.ref), here, true, "", depth + 1);
			if (shown && draw[node.type]) {
				const lines = [];
				draw[node.type](node, lines, size);
				out.push(...lines.map((p) => p.applyMatrix4(here)));
			}
			for (const [p, child] of children(node, at)) {
				if (shown || pointer === p || pointer.startsWith(`${p}/`))
					visit(child, here, shown, shown ? "" : p, depth + 1);
			}
		};
		visit(doc.root, new Matrix4(), false, "/root", 0);
	} catch {
		// A document that is being written: no lines.
	}
	const numbers = out.flatMap((p) => p.toArray());
	return numbers.every(Number.isFinite) ? numbers : [];
}
