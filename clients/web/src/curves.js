// The curves that the page plots: openings θ(α) (Gourmel et al. 2013, Eq. 15,
// 16) and profiles' silhouettes (Eq. 19, 20, 30, 31).

/* Eq. 16; 0 and 1 at the ends. */
export function kappa(x) {
	if (x <= 0)
		return 0;
	if (x >= 1)
		return 1;
	return 1 - Math.exp(1 - 1 / (1 - Math.exp(1 - 1 / x)));
}

export const OPENINGS = {
	camel: { alpha: [0, Math.PI / 2, Math.PI], theta: [Math.PI / 4, 0, Math.PI / 4], w: [1, 1] },
	organic: { alpha: [0, Math.PI / 3, 3 * Math.PI / 4], theta: [Math.PI / 6, 0, Math.PI / 4], w: [3, 1] },
	contact: { alpha: [0, Math.PI / 2, Math.PI], theta: [0, Math.PI / 10, Math.PI / 4], w: [1, 0.7] },
};
const constant = (theta) =>
	({ alpha: [0, Math.PI / 2, Math.PI], theta: [theta, theta, theta], w: [1, 1] });

/* Eq. 15. */
export function opening({ alpha, theta, w }, a) {
	if (a <= alpha[0])
		return theta[0];
	if (a <= alpha[1])
		return kappa((a - alpha[1]) / (alpha[0] - alpha[1])) ** w[0] *
			(theta[0] - theta[1]) + theta[1];
	if (a < alpha[2])
		return kappa((a - alpha[1]) / (alpha[2] - alpha[1])) ** w[1] *
			(theta[2] - theta[1]) + theta[1];
	return theta[2];
}

/* ν and η, Eq. 20 and 19: ν(x)·ν(1 − η(x)) = 1. */
export function eta(x) {
	const nu = Math.expm1(Math.exp(Math.E - Math.E * x) - 1);
	if (nu <= 0)
		return Infinity;
	return Math.log(Math.log(1 / nu + 1) + 1) / Math.E;
}

/* The silhouette from (0,1) to (1,0): [[x, y], …]. */
export function silhouette(profile, n = 48) {
	const t = Array.from({ length: n + 1 }, (_, i) => i / n);
	switch (profile.type) {
	case "bulge": {
		const k = profile.k ?? 0.8;
		const half = t.map((x) => [x, x <= 0 ? 1 : 1 - k * Math.exp(1 - 1 / x) * (1 - x)]);
		const all = half.filter(([x, y]) => x <= y);
		return [...all, ...all.map(([x, y]) => [y, x]).reverse()];
	}
	case "circle":
		return t.map((x) => [Math.sin(x * Math.PI / 2), Math.cos(x * Math.PI / 2)]);
	case "samples":
		return mirrored(Array.isArray(profile.points) ? profile.points : []);
	default: {
		// To the diagonal, where x = y, and back.
		const half = t.map((x) => [0.8062787204 * x, 1 - eta(0.8062787204 * x)]);
		return mirrored(half);
	}
	}
}

function mirrored(points) {
	const last = points[points.length - 1];
	if (!last || Math.abs(last[0] - last[1]) > 1e-3)
		return points;
	return [...points, ...points.slice(0, -1).map(([x, y]) => [y, x]).reverse()];
}

const PROFILES = { smooth: { type: "smooth" }, bulge: { type: "bulge", k: 0.8 },
	circle: { type: "circle" } };

/* An operator as the page edits it:
 *   {pointer, name, profile, opening, full, classic}
 * pointer: where it is written; full: false where it is only a name of a
 * built-in one; classic: the type of one without angles; profile null where
 * there is none (sharp). */
export function operatorOf(doc, node, pointer) {
	const written = node.operator ?? "clean";
	const at = `${pointer}/operator`;
	if (typeof written === "string") {
		const own = doc.operators?.[written];
		if (own && typeof own === "object")
			return { ...expand(own), name: written, full: true,
				pointer: `/operators/${written.replaceAll("~", "~0").replaceAll("/", "~1")}` };
		return { ...builtIn(written), name: written, full: false, pointer: at };
	}
	return { ...expand(written), name: null, full: true, pointer: at };
}

function builtIn(name) {
	switch (name) {
	case "clean": return { profile: PROFILES.smooth, opening: constant(Math.PI / 4) };
	case "blend": return { profile: PROFILES.smooth, opening: constant(0) };
	case "camel": return { profile: PROFILES.smooth, opening: OPENINGS.camel };
	case "organic": return { profile: PROFILES.smooth, opening: OPENINGS.organic };
	case "contact": return { profile: PROFILES.bulge, opening: OPENINGS.contact };
	default: return { profile: null, opening: null };
	}
}

/* What is written if that will do: it may be half a document. */
function numbers(written, otherwise) {
	return Array.isArray(written) && written.length === otherwise.length &&
		written.every((x) => Number.isFinite(x)) ? written : otherwise;
}

function expand(operator) {
	if (operator.type && operator.type !== "gradient")
		return { classic: String(operator.type), profile: null, opening: null };
	const p = operator.profile ?? "smooth";
	const o = operator.opening ?? constant(Math.PI / 4);
	return {
		profile: typeof p === "string" ? PROFILES[p] ?? PROFILES.smooth
			: p.type === "bulge" ? { ...p, k: Number.isFinite(p.k) ? p.k : 0.8 } : p,
		opening: typeof o === "string" ? OPENINGS[o] ?? constant(Math.PI / 4)
			: Number.isFinite(o.theta) ? constant(o.theta)
				: { alpha: numbers(o.alpha, [0, Math.PI / 2, Math.PI]),
					theta: numbers(o.theta, [0, 0, 0]), w: numbers(o.w, [1, 1]) },
	};
}
