// The lava lamp: a document as a function of time. Points below the node with
// the id "lava" rise, sink and swell, each at its own pace.
import { walk } from "./nodes.js";

/* [pointer, node] whose points move, or null: not every document is a lamp. */
export function lamp(doc) {
	for (const found of doc?.root ? walk(doc.root) : [])
		if (found[1]?.id === "lava")
			return found;
	return null;
}

/* What changes of the document t seconds on: [{pointer, value}]. */
export function at(doc, t) {
	const [under, lava] = lamp(doc) ?? [];
	const points = (lava?.children ?? []).map((node, i) =>
		({ node, pointer: `${under}/children/${i}` }))
		.filter(({ node }) => node.type === "point");
	const heights = points.map(({ node }) => node.center[2]);
	const low = Math.min(...heights) - 0.25;
	const high = Math.max(...heights) + 0.02;
	return points.flatMap(({ node, pointer }, i) => {
		const pace = 0.34 + 0.11 * ((i * 0.618) % 1);
		const begun = (node.center[2] - low) / (high - low);
		const angle = Math.acos(1 - 2 * begun) + pace * t;
		const height = 0.5 - 0.5 * Math.cos(angle);
		// Off to one side and back, from where it begins.
		const drift = [Math.sin(0.7 * pace * t), 1 - Math.cos(0.9 * pace * t)]
			.map((s) => 0.09 * s * (i % 2 ? 1 : -1));
		const round = (x) => Number(x.toFixed(4));
		return [
			{ pointer: `${pointer}/center`, value: [node.center[0] + drift[0],
				node.center[1] + drift[1], low + (high - low) * height].map(round) },
			{ pointer: `${pointer}/radius`, value: round(node.radius *
				(1 + 0.12 * Math.sin(1.3 * pace * t))) },
			...node.material?.color ? [{ pointer: `${pointer}/material/color`,
				value: [0.92, round(0.1 + 0.42 * height), 0.04] }] : [],
		];
	});
}
