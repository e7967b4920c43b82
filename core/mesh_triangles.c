/*
 * Triangles: for every crossed edge the polygon of the four curves about it.
 *
 * Polygons' sides are the segments in which the surface meets cells' faces. Each
 * segment lies on two crossed edges and each curve is one ring of segments, so
 * that polygons close up to a 2-manifold. The four cells about an edge differ,
 * and no other edge has two opposite ones of them: diagonals are each polygon's
 * own. Sides may not be: where both segments of a face join the same two curves,
 * vertices are put on them ("bridges").
 */
#include <math.h>
#include <stdlib.h>

#include "core/mesh_work.h"

/* ---- bridges ---- */

static int compare_bridges(const void *a, const void *b)
{
	const struct mesh_bridge *x = a, *y = b;

	if (x->cell != y->cell)
		return x->cell < y->cell ? -1 : 1;
	return x->axis < y->axis ? -1 : x->axis > y->axis;
}

/* The vertex on the segment that ends at a cell's edge, within its upper face
 * across axis a; MESH_NONE if there is none. */
static uint32_t bridge_at(const struct mesh_work *w, uint32_t i, unsigned a,
    unsigned edge)
{
	const struct mesh_cell *cell = w->cells + i;
	const struct mesh_bridge key = {i, a, 0};
	const struct mesh_bridge *found;
	unsigned e[2];

	if (!(w->cases.ambiguous[cell->inside] >> (2 * a + 1) & 1) ||
	    w->bridge_count == 0)
		return MESH_NONE;
	found = bsearch(&key, w->bridges, w->bridge_count, sizeof key,
	    compare_bridges);
	if (found == NULL)
		return MESH_NONE;
	mesh_loops_segment(cell->inside, cell->joined, 2 * a + 1, 0, e);
	return found->vertex + (edge == e[0] || edge == e[1] ? 0 : 1);
}

/* ---- polygons ---- */

struct polygon {
	uint32_t corners[8];
	unsigned count;
	int bridge;       /* a corner that is a bridge's, or -1 */
	double p[3], n[3]; /* the crossing */
};

/* The cells about an edge, in order about it: steps down along the two axes
 * after its own. From each to the next, across which of them, and which of the
 * two is the lower one. */
static const struct {
	unsigned char u, v, across, lower;
} about[4] = {{1, 1, 0, 0}, {0, 1, 1, 1}, {0, 0, 0, 3}, {1, 0, 1, 0}};

static unsigned edge_about(unsigned a, unsigned k)
{
	return 4 * a + about[k].u + 2u * about[k].v;
}

static void add_corner(struct polygon *p, uint32_t vertex)
{
	p->corners[p->count++] = vertex;
}

static void make_polygon(const struct mesh_work *w,
    const struct mesh_near *near, unsigned local, unsigned a,
    struct polygon *out)
{
	uint32_t cells[4];
	struct mesh_loops room;

	out->count = 0;
	out->bridge = -1;
	for (unsigned k = 0; k < 4; k++)
		cells[k] = mesh_cell_below(near, local,
		    (unsigned)about[k].u << (a + 1) % 3 |
		    (unsigned)about[k].v << (a + 2) % 3);
	for (unsigned k = 0; k < 4; k++) {
		const struct mesh_cell *cell = w->cells + cells[k];
		unsigned lower = about[k].lower;
		uint32_t bridge = bridge_at(w, cells[lower],
		    (a + 1 + about[k].across) % 3, edge_about(a, lower));

		add_corner(out, cell->vertex + mesh_loops_get(&w->cases,
		    cell->inside, cell->joined, &room)->of[edge_about(a, k)]);
		if (bridge != MESH_NONE) {
			out->bridge = (int)out->count;
			add_corner(out, bridge);
		}
	}
}

static void turn(struct polygon *p)
{
	for (unsigned i = 0; i < p->count / 2; i++) {
		uint32_t corner = p->corners[i];

		p->corners[i] = p->corners[p->count - 1 - i];
		p->corners[p->count - 1 - i] = corner;
	}
	if (p->bridge >= 0)
		p->bridge = (int)p->count - 1 - p->bridge;
}

/* ---- triangles ---- */

static struct vec3 position(const struct mesh_work *w, uint32_t i)
{
	const float *p = w->positions + 3 * (size_t)i;

	return vec3(p[0], p[1], p[2]);
}

static void add_triangle(struct mesh *m, uint32_t a, uint32_t b, uint32_t c)
{
	uint32_t *t = m->triangles + 3 * m->figures.triangles++;

	t[0] = a;
	t[1] = b;
	t[2] = c;
}

/* How ill the diagonal from corner k fits: triangles that face inward, and
 * far of it from the crossing's tangent plane. */
static double misfit(const struct mesh_work *w, const struct polygon *q,
    unsigned k)
{
	struct vec3 n = vec3_get(q->n);
	struct vec3 a = position(w, q->corners[k]);
	struct vec3 b = position(w, q->corners[k + 1]);
	struct vec3 c = position(w, q->corners[k + 2]);
	struct vec3 d = position(w, q->corners[(k + 3) % 4]);
	struct vec3 ac = vec3_sub(c, a);
	struct vec3 mid = vec3_scale(0.5, vec3_add(a, c));
	double first = vec3_dot(n, vec3_cross(vec3_sub(b, a), ac));
	double second = vec3_dot(n, vec3_cross(ac, vec3_sub(d, a)));
	double off = fabs(vec3_dot(n, vec3_sub(mid, vec3_get(q->p))));

	return off + w->grid.edge * (1e-3 * vec3_norm(ac) / w->grid.edge +
	    (first > 0.0 ? 0.0 : 10.0) + (second > 0.0 ? 0.0 : 10.0));
}

static void cut(const struct mesh_work *w, const struct polygon *q,
    struct mesh *m)
{
	const uint32_t *c = q->corners;

	if (q->bridge >= 0) {
		/* Only two polygons have a bridge's vertex, and they share
		 * two neighbours of it: any diagonal from it is new. */
		for (unsigned i = 1; i + 1 < q->count; i++)
			add_triangle(m, c[q->bridge],
			    c[((unsigned)q->bridge + i) % q->count],
			    c[((unsigned)q->bridge + i + 1) % q->count]);
	} else if (misfit(w, q, 0) <= misfit(w, q, 1)) {
		add_triangle(m, c[0], c[1], c[2]);
		add_triangle(m, c[0], c[2], c[3]);
	} else {
		add_triangle(m, c[1], c[2], c[3]);
		add_triangle(m, c[1], c[3], c[0]);
	}
}

static void cut_block(const struct mesh_work *w, const struct mesh_block *b,
    struct mesh *m)
{
	const struct mesh_crossing *crossing = w->crossings +
	    b->first_crossing[0];
	struct mesh_near near;
	struct polygon q;
	size_t corner[3];

	mesh_near_init(w, b, -1, &near);
	for (unsigned a = 0; a < 3; a++)
		for (uint64_t bits = b->edges[a]; bits != 0;
		    bits &= bits - 1, crossing++) {
			unsigned local = (unsigned)__builtin_ctzll(bits);

			make_polygon(w, &near, local, a, &q);
			if (!((double)crossing->ends[0] >= w->grid.iso))
				turn(&q);
			mesh_corner_of(b, local, corner);
			mesh_on_edge(&w->grid, corner, a, crossing->at, q.p);
			for (int k = 0; k < 3; k++)
				q.n[k] = crossing->normal[k];
			cut(w, &q, m);
		}
}

enum err mesh_make_triangles(const struct mesh_work *w, struct mesh *m)
{
	/* A bridge's vertex makes one triangle more in each of two polygons. */
	size_t count = 2 * w->crossing_count + 4 * w->bridge_count;

	m->triangles = malloc((3 * count + 1) * sizeof *m->triangles);
	if (m->triangles == NULL)
		return ERR_MEMORY;
	m->figures.triangles = 0;
	for (size_t i = 0; i < w->block_count; i++) {
		if (i % 1024 == 0 && !sampler_goes_on(w->sampler, "vertices",
		    0.9))
			return ERR_CANCELLED;
		cut_block(w, w->blocks + i, m);
	}
	return ERR_OK;
}
