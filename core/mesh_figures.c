/*
 * What a mesh is like, and whether it is a closed 2-manifold.
 */
#include <float.h>
#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "core/mesh_work.h"

static struct vec3 position(const struct mesh *m, uint32_t i)
{
	const float *p = m->positions + 3 * (size_t)i;

	return vec3(p[0], p[1], p[2]);
}

/* ---- figures ---- */

/* The representative of i; paths are halved on the way. */
static uint32_t root_of(uint32_t *parents, uint32_t i)
{
	while (parents[i] != i) {
		parents[i] = parents[parents[i]];
		i = parents[i];
	}
	return i;
}

/* Triangles between two questions whether to go on: some milliseconds. */
#define TRIANGLES_A_LOOK 65536

static bool goes_on(struct sampler *sampler, size_t triangle)
{
	return triangle % TRIANGLES_A_LOOK != 0 ||
	    sampler_goes_on(sampler, "normals", 1.0);
}

static enum err count_components(const struct mesh *m,
    struct sampler *sampler, size_t *components)
{
	size_t n = m->figures.vertices;
	uint32_t *parents = malloc((n + 1) * sizeof *parents);
	enum err err = ERR_OK;

	if (parents == NULL)
		return ERR_MEMORY;
	for (size_t i = 0; i < n; i++)
		parents[i] = (uint32_t)i;
	*components = n;
	for (size_t i = 0; i < 3 * m->figures.triangles && err == ERR_OK; i++) {
		size_t next = i % 3 == 2 ? i - 2 : i + 1;
		uint32_t a = root_of(parents, m->triangles[i]);
		uint32_t b = root_of(parents, m->triangles[next]);

		if (a != b) {
			parents[a < b ? b : a] = a < b ? a : b;
			--*components;
		}
		if (!goes_on(sampler, i))
			err = ERR_CANCELLED;
	}
	free(parents);
	return err;
}

/* Area and volume, by the divergence theorem about the first vertex. */
static enum err sum_triangles(struct mesh *m, struct sampler *sampler)
{
	struct vec3 origin = position(m, 0);
	double area = 0.0, volume = 0.0;

	for (size_t i = 0; i < m->figures.triangles; i++) {
		const uint32_t *t = m->triangles + 3 * i;
		struct vec3 a = vec3_sub(position(m, t[0]), origin);
		struct vec3 b = vec3_sub(position(m, t[1]), origin);
		struct vec3 c = vec3_sub(position(m, t[2]), origin);
		struct vec3 n = vec3_cross(vec3_sub(b, a), vec3_sub(c, a));

		area += 0.5 * vec3_norm(n);
		volume += vec3_dot(a, n) / 6.0;
		if (!goes_on(sampler, i))
			return ERR_CANCELLED;
	}
	m->figures.area = area;
	m->figures.volume = volume;
	return ERR_OK;
}

static void find_box(struct mesh *m)
{
	struct vec3 min = position(m, 0), max = min;

	for (size_t i = 1; i < m->figures.vertices; i++) {
		struct vec3 p = position(m, (uint32_t)i);

		min = vec3(fmin(min.x, p.x), fmin(min.y, p.y),
		    fmin(min.z, p.z));
		max = vec3(fmax(max.x, p.x), fmax(max.y, p.y),
		    fmax(max.z, p.z));
	}
	m->figures.min = min;
	m->figures.max = max;
}

enum err mesh_measure(struct mesh *m, struct sampler *sampler)
{
	struct mesh_figures *f = &m->figures;
	enum err err;

	if (f->vertices == 0)
		return ERR_OK;
	err = count_components(m, sampler, &f->components);
	if (err != ERR_OK)
		return err;
	/* Every edge has two triangles: E = 3 F / 2. */
	f->euler = (long)f->vertices - (long)(f->triangles / 2);
	f->genus = (long)f->components - f->euler / 2;
	find_box(m);
	return sum_triangles(m, sampler);
}

/* ---- check ---- */

/* Corners of triangles by vertex: those of vertex v are from begin[v] to
 * begin[v + 1]; each is the two other vertices, in order. */
struct links {
	size_t *begin;
	uint32_t (*ends)[2];
};

static void links_free(struct links *l)
{
	free(l->begin);
	free(l->ends);
}

static bool in_range(const struct mesh *m, const uint32_t *t)
{
	size_t n = m->figures.vertices;

	return t[0] < n && t[1] < n && t[2] < n;
}

static enum err links_make(const struct mesh *m, struct links *l)
{
	size_t n = m->figures.vertices, count = m->figures.triangles;

	l->begin = calloc(n + 2, sizeof *l->begin);
	l->ends = malloc((3 * count + 1) * sizeof *l->ends);
	if (l->begin == NULL || l->ends == NULL) {
		links_free(l);
		return ERR_MEMORY;
	}
	for (size_t i = 0; i < 3 * count; i++)
		if (in_range(m, m->triangles + i / 3 * 3))
			l->begin[m->triangles[i] + 2]++;
	for (size_t i = 2; i < n + 2; i++)
		l->begin[i] += l->begin[i - 1];
	for (size_t i = 0; i < 3 * count; i++) {
		const uint32_t *t = m->triangles + i / 3 * 3;
		uint32_t *ends;

		if (!in_range(m, t))
			continue;
		ends = l->ends[l->begin[t[i % 3] + 1]++];
		ends[0] = t[(i + 1) % 3];
		ends[1] = t[(i + 2) % 3];
	}
	return ERR_OK;
}

/* Edges from v to greater vertices that have other than one triangle on either
 * side; and those of a triangle from v to itself. */
static size_t edges_at(const struct links *l, uint32_t v)
{
	size_t faults = 0;

	for (size_t i = l->begin[v]; i < l->begin[v + 1]; i++)
		for (int k = 0; k < 2; k++) {
			uint32_t to = l->ends[i][k];
			size_t out = 0, in = 0, before = 0;

			for (size_t j = l->begin[v]; j < l->begin[v + 1]; j++) {
				bool a = l->ends[j][0] == to;
				bool b = l->ends[j][1] == to;

				out += a;
				in += b;
				before += j < i && (a || b);
			}
			if (k == 1)
				before += l->ends[i][0] == to;
			if (before == 0 && (to == v ||
			    (to > v && (out != 1 || in != 1))))
				faults++;
		}
	return faults;
}

/* Whether the triangles about v are one ring. */
static bool is_fan(const struct links *l, uint32_t v)
{
	size_t first = l->begin[v], count = l->begin[v + 1] - first;
	size_t at = first, seen = 0;

	if (count == 0)
		return false;
	do {
		size_t next = first;

		while (next < first + count &&
		    l->ends[next][0] != l->ends[at][1])
			next++;
		if (next == first + count)
			return false;
		at = next;
		seen++;
	} while (at != first && seen <= count);
	return seen == count;
}

enum err mesh_check(const struct mesh *m, size_t *edge_faults,
    size_t *vertex_faults)
{
	struct links links;
	size_t edges = 0, vertices = 0;
	enum err err = links_make(m, &links);

	if (err != ERR_OK)
		return err;
	for (size_t i = 0; i < m->figures.triangles; i++)
		edges += !in_range(m, m->triangles + 3 * i);
	for (size_t v = 0; v < m->figures.vertices; v++) {
		edges += edges_at(&links, (uint32_t)v);
		vertices += !is_fan(&links, (uint32_t)v);
	}
	links_free(&links);
	*edge_faults = edges;
	*vertex_faults = vertices;
	return ERR_OK;
}
