// Normals at creases. A mesh has one normal a vertex, which at a sharp edge is
// that of neither side; there the vertex is made one for each side.

const STEEP = Math.cos(Math.PI / 6);

/* Corners whose vertex's normal is more than 30 degrees off their triangle's
 * are given the mean normal (by area) of the triangles around the vertex that
 * are less than that off, at a vertex of their own:
 *   {index, from: the old vertex of each new one, normals: of the new ones}
 * positions and normals: 3 floats a vertex. */
export function creases(index, positions, normals) {
	const faces = faceNormals(index, positions);
	const cosine = (a, i, b, j) => a[i] * b[j] + a[i + 1] * b[j + 1] +
		a[i + 2] * b[j + 2];
	const length = (a, i) => Math.sqrt(cosine(a, i, a, i)) || 1;
	const off = (c) => cosine(faces, c - c % 3, normals, 3 * index[c]) <
		STEEP * length(faces, c - c % 3);
	const around = new Map();
	for (let c = 0; c < index.length; c++)
		if (off(c))
			around.set(index[c], []);
	for (let c = 0; around.size && c < index.length; c++)
		around.get(index[c])?.push(c);
	const out = { index: Uint32Array.from(index), from: [], normals: [] };
	const count = positions.length / 3;
	for (const [vertex, corners] of around) {
		const made = [];
		for (const c of corners.filter(off)) {
			const f = c - c % 3;
			const sum = [0, 0, 0];
			for (const d of corners.map((x) => x - x % 3))
				if (cosine(faces, f, faces, d) >= STEEP * length(faces, f) *
				    length(faces, d))
					for (let i = 0; i < 3; i++)
						sum[i] += faces[d + i];
			const n = length(sum, 0);
			const normal = sum.map((x) => x / n);
			let same = made.find((m) => cosine(m.normal, 0, normal, 0) > 0.9999);
			if (!same) {
				same = { normal, vertex: count + out.from.length };
				made.push(same);
				out.from.push(vertex);
				out.normals.push(...normal);
			}
			out.index[c] = same.vertex;
		}
	}
	return out;
}

/* Of each triangle, as long as twice its area. */
function faceNormals(index, p) {
	const out = new Float32Array(index.length);
	for (let t = 0; t < index.length; t += 3) {
		const [a, b, c] = [3 * index[t], 3 * index[t + 1], 3 * index[t + 2]];
		const u = [p[b] - p[a], p[b + 1] - p[a + 1], p[b + 2] - p[a + 2]];
		const v = [p[c] - p[a], p[c + 1] - p[a + 1], p[c + 2] - p[a + 2]];
		out[t] = u[1] * v[2] - u[2] * v[1];
		out[t + 1] = u[2] * v[0] - u[0] * v[2];
		out[t + 2] = u[0] * v[1] - u[1] * v[0];
	}
	return out;
}
