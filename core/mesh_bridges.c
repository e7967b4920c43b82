/*
 * Vertices that must not be at the same place: those of one cell, and those on
 * segments of faces that would otherwise be doubled sides of polygons
 * (core/mesh_triangles.c).
 */
#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "core/mesh_planes.h"
#include "core/mesh_work.h"
#include "core/output.h"

/* Vertices stay so far from their cell's faces, of its side, and at least one of
 * float32's steps, so that no two of different cells are one. A vertex that
 * should be nearer is off the surface by so much, or, if that is much, nearer
 * all the same: by MARGIN_LEAST. */
#define MARGIN 2e-4
#define MARGIN_LEAST 0x1p-40

static void set_limits(const struct cells_grid *grid,
    const size_t cell[static 3], double margin, struct mesh_limits *out)
{
	for (int k = 0; k < 3; k++) {
		float low = cells_corner(grid, k, cell[k]);
		float high = cells_corner(grid, k, cell[k] + 1);
		float room = (float)margin * (high - low);

		out->low[k] = low;
		out->high[k] = high;
		if (!(low < high))
			continue;
		out->low[k] += fmaxf(room, (float)CELLS_STEP * fabsf(low));
		out->high[k] -= fmaxf(room, (float)CELLS_STEP * fabsf(high));
	}
}

void mesh_limits_set(const struct cells_grid *grid,
    const size_t cell[static 3], struct mesh_limits *out)
{
	set_limits(grid, cell, MARGIN, out);
}

void mesh_limits_set_wide(const struct cells_grid *grid,
    const size_t cell[static 3], struct mesh_limits *out)
{
	set_limits(grid, cell, MARGIN_LEAST, out);
}

static void limits_of(const struct mesh_work *w, const struct mesh_cell *cell,
    struct mesh_limits *out)
{
	size_t corner[3];

	mesh_corner_of(w->blocks + cell->block, cell->local, corner);
	mesh_limits_set(&w->grid, corner, out);
}

/* ---- apart ---- */

/* Vertices of a cell are so far apart along some axis, of its edge. */
#define APART 0.01

static bool is_apart(const float *p, const float *q, const float span[3])
{
	for (int k = 0; k < 3; k++)
		if (fabsf(p[k] - q[k]) > 0.5f * (float)APART * span[k])
			return true;
	return false;
}

/* The axis that the surface is nearest to along, of those the cell has room
 * along. */
static int axis_along(const struct mesh_limits *cell,
    const float normal[static 3])
{
	int a = -1;

	for (int k = 0; k < 3; k++)
		if (cell->low[k] < cell->high[k] && (a < 0 ||
		    fabsf(normal[k]) < fabsf(normal[a])))
			a = k;
	return a < 0 ? 0 : a;
}

/* Moves p by step along axis a, as the tangent plane does; from the other end on
 * where it would leave the cell. */
static void move_along(const struct mesh_limits *cell,
    const float normal[static 3], int a, float step, float p[static 3])
{
	float rest = 1.0f - normal[a] * normal[a];

	for (int k = 0; k < 3; k++)
		if (k != a && rest > 0.1f)
			p[k] = fminf(fmaxf(p[k] - step * normal[a] *
			    normal[k] / rest, cell->low[k]), cell->high[k]);
	p[a] += step;
	if (p[a] > cell->high[a])
		p[a] = cell->low[a];
	else if (p[a] < cell->low[a])
		p[a] = cell->high[a];
}

/* Moves p until it is apart from the count vertices at others, by float32's
 * steps at least: a cell has room for five of them, others take three. Whether it
 * did. */
static bool part_from(const float *others, unsigned count,
    const struct mesh_limits *cell, const float normal[static 3],
    float p[static 3])
{
	int a = axis_along(cell, normal);
	float span[3], step;
	bool moved = false;

	for (int k = 0; k < 3; k++)
		span[k] = cell->high[k] - cell->low[k];
	step = fmaxf((float)APART * span[a], (float)CELLS_STEP *
	    fmaxf(fabsf(cell->low[a]), fabsf(cell->high[a])));
	if (p[a] > 0.5f * (cell->low[a] + cell->high[a]))
		step = -step;
	for (unsigned i = 0; i < count;) {
		if (is_apart(p, others + 3 * i, span)) {
			i++;
			continue;
		}
		move_along(cell, normal, a, step, p);
		moved = true;
		i = 0;
	}
	return moved;
}

/* Samples what has been moved, which is in w->points, for its error. */
static enum err note_errors(struct mesh_work *w, size_t *count)
{
	enum err err = sampler_goes_on(w->sampler, "vertices", 0.9) ?
	    mesh_sample(w, *count, OUTPUT_VALUE) : ERR_CANCELLED;

	for (size_t i = 0; i < *count && err == ERR_OK; i++)
		w->largest_error = fmax(w->largest_error,
		    fabs((double)w->rows[i] - w->grid.iso));
	*count = 0;
	return err;
}

/* Caps' have no error, as they have no normal of the surface. */
static bool is_of_caps(const struct cells_grid *grid,
    const size_t corner[static 3])
{
	for (int k = 0; k < 3; k++)
		if (corner[k] < 1 || corner[k] > grid->counts[k])
			return true;
	return false;
}

static void part_cell(struct mesh_work *w, const struct mesh_cell *cell,
    size_t *count)
{
	float *p = w->positions + 3 * (size_t)cell->vertex;
	const float *normals = w->normals + 3 * (size_t)cell->vertex;
	struct mesh_limits limits;
	size_t corner[3];

	mesh_corner_of(w->blocks + cell->block, cell->local, corner);
	mesh_limits_set_wide(&w->grid, corner, &limits);
	for (unsigned i = 1; i < cell->loops; i++)
		if (part_from(p, i, &limits, normals + 3 * i, p + 3 * i) &&
		    !is_of_caps(&w->grid, corner))
			memcpy(w->points + 3 * (*count)++, p + 3 * i,
			    3 * sizeof *p);
}

enum err mesh_part_vertices(struct mesh_work *w)
{
	size_t count = 0;
	enum err err = ERR_OK;

	for (size_t i = 0; i < w->cell_count && err == ERR_OK; i++) {
		if (w->cells[i].loops > 1)
			part_cell(w, w->cells + i, &count);
		if (count + MESH_LOOPS_MAX > MESH_BATCH)
			err = note_errors(w, &count);
	}
	return err == ERR_OK && count > 0 ? note_errors(w, &count) : err;
}

/* ---- which bridges ---- */

/* Whether both segments of a cell's upper face across axis a join the same
 * curves, here and in the cell above. */
static bool is_doubled(const struct mesh_work *w, const struct mesh_cell *cell,
    const struct mesh_cell *above, unsigned a)
{
	struct mesh_loops rooms[2];
	const struct mesh_loops *here = mesh_loops_get(&w->cases,
	    cell->inside, cell->joined, rooms);
	const struct mesh_loops *there = mesh_loops_get(&w->cases,
	    above->inside, above->joined, rooms + 1);
	unsigned e[2][2], d[2][2];

	for (unsigned k = 0; k < 2; k++) {
		mesh_loops_segment(cell->inside, cell->joined, 2 * a + 1, k,
		    e[k]);
		mesh_loops_segment(above->inside, above->joined, 2 * a, k,
		    d[k]);
	}
	return here->of[e[0][0]] == here->of[e[1][0]] &&
	    there->of[d[0][0]] == there->of[d[1][0]];
}

static enum err add_bridge(struct mesh_work *w, uint32_t cell, unsigned a)
{
	struct mesh_bridge *bridges = mesh_room(w->bridges, &w->bridge_max,
	    w->bridge_count + 1, sizeof *bridges);

	if (bridges == NULL)
		return ERR_MEMORY;
	w->bridges = bridges;
	w->bridges[w->bridge_count++] = (struct mesh_bridge){cell, a,
	    (uint32_t)w->vertex_count};
	w->vertex_count += 2;
	return w->vertex_count > MESH_VERTICES_MAX ? ERR_LIMIT : ERR_OK;
}

static enum err bridge_cell(struct mesh_work *w, uint32_t i)
{
	const struct mesh_cell *cell = w->cells + i;
	unsigned ambiguous = w->cases.ambiguous[cell->inside];
	struct mesh_near near;
	enum err err = ERR_OK;

	if ((ambiguous & 0x2a) == 0)
		return ERR_OK;
	mesh_near_init(w, w->blocks + cell->block, 1, &near);
	for (unsigned a = 0; a < 3 && err == ERR_OK; a++)
		if (ambiguous >> (2 * a + 1) & 1 && is_doubled(w, cell,
		    w->cells + mesh_cell_above(&near, cell->local, a), a))
			err = add_bridge(w, i, a);
	return err;
}

enum err mesh_find_bridges(struct mesh_work *w)
{
	enum err err = ERR_OK;

	for (size_t i = 0; i < w->cell_count && err == ERR_OK; i++)
		err = bridge_cell(w, (uint32_t)i);
	return err;
}

/* ---- where they are ---- */

/* Bridges stay so far from their face's edges, of its own, and those of both
 * segments from the diagonal between them; by one of float32's steps at least. */
#define BRIDGE_MARGIN 0.02

/* A place within a face across axis a of corners from face on: part[i] of its
 * edge along axis a + 1 + i, from its upper end if upper[i]. */
struct place {
	unsigned axis;
	size_t face[3];
	double part[2];
	bool upper[2];
};

/* Keeps the middle of the segment that cuts off a corner, at->part from it, on
 * this side of the other segment. */
static void hold_bridge(const struct mesh_work *w, struct place *at)
{
	double *u = at->part, *v = at->part + 1, excess, margin = BRIDGE_MARGIN;

	for (unsigned i = 1; i < 3; i++)
		margin = fmax(margin, w->grid.grains[(at->axis + i) % 3]);
	*u = fmax(*u, margin);
	*v = fmax(*v, margin);
	excess = *u + *v - (1.0 - 2.0 * margin);
	if (excess > 0.0)
		*(*u > *v ? u : v) -= excess;
}

static void put_place(const struct mesh_work *w, const struct place *at,
    float p[static 3])
{
	for (unsigned i = 0; i < 2; i++) {
		int k = (int)((at->axis + 1 + i) % 3);
		double low = cells_corner(&w->grid, k, at->face[k]);
		double high = cells_corner(&w->grid, k, at->face[k] + 1);

		p[k] = (float)(at->upper[i] ?
		    high - at->part[i] * (high - low) :
		    low + at->part[i] * (high - low));
	}
	p[at->axis] = cells_corner(&w->grid, (int)at->axis,
	    at->face[at->axis]);
}

/* The middle of the segment between two crossings. */
static void find_middle(const struct mesh_work *w, const struct mesh_planes *l,
    struct place *at)
{
	for (unsigned i = 0; i < 2; i++) {
		int k = (int)((at->axis + 1 + i) % 3);
		double low = cells_corner(&w->grid, k, at->face[k]);
		double high = cells_corner(&w->grid, k, at->face[k] + 1);
		double first = (l->p[0][k] - low) / (high - low);
		double second = (l->p[1][k] - low) / (high - low);

		/* One of the two lies on the face's edge. */
		at->upper[i] = (l->axis[0] == k ? second : first) > 0.5;
		at->part[i] = 0.5 * (first + second);
		if (at->upper[i])
			at->part[i] = 1.0 - at->part[i];
	}
	hold_bridge(w, at);
}

/* Whether p is apart from the vertices of a cell: one of the ring may lie all
 * in the face. */
static bool is_clear(const struct mesh_work *w, const struct mesh_cell *cell,
    const float p[static 3])
{
	struct mesh_limits limits;
	float span[3];

	limits_of(w, cell, &limits);
	for (int k = 0; k < 3; k++)
		span[k] = limits.high[k] - limits.low[k];
	for (size_t i = cell->vertex; i < cell->vertex + cell->loops; i++)
		if (!is_apart(p, w->positions + 3 * i, span))
			return false;
	return true;
}

/* Moves at a little: the longer way from the corner shorter, unless both are
 * short. */
static void move_place(const struct mesh_work *w, struct place *at)
{
	unsigned i = at->part[1] > at->part[0];
	double step = fmax(APART, w->grid.grains[(at->axis + 1 + i) % 3]);

	at->part[i] += at->part[i] > 0.2 ? -step : step;
}

/* A bridge's face, and the cells on its sides. */
struct face {
	const struct mesh_bridge *bridge;
	const struct mesh_cell *cell, *above;
	struct mesh_near near;
	struct place at;
};

static void face_init(const struct mesh_work *w,
    const struct mesh_bridge *bridge, struct face *out)
{
	const struct mesh_cell *cell = w->cells + bridge->cell;
	const struct mesh_block *b = w->blocks + cell->block;

	*out = (struct face){.bridge = bridge, .cell = cell,
	    .at = {.axis = bridge->axis}};
	mesh_near_init(w, b, 1, &out->near);
	out->above = w->cells + mesh_cell_above(&out->near, cell->local,
	    bridge->axis);
	mesh_corner_of(b, cell->local, out->at.face);
	out->at.face[bridge->axis]++;
}

/* The crossings that segment k joins. */
static void find_ends(const struct mesh_work *w, const struct face *face,
    unsigned k, struct mesh_planes *out)
{
	unsigned e[2];

	out->count = out->caps = 0;
	mesh_loops_segment(face->cell->inside, face->cell->joined,
	    2 * face->at.axis + 1, k, e);
	mesh_planes_add(w, &face->near, face->cell, e[0], out);
	mesh_planes_add(w, &face->near, face->cell, e[1], out);
}

/* Puts p where face->at is, or beside others that are there. */
static void put_clear(const struct mesh_work *w, struct face *face,
    float p[static 3])
{
	hold_bridge(w, &face->at);
	put_place(w, &face->at, p);
	for (int i = 0; i < 8 && !(is_clear(w, face->cell, p) &&
	    is_clear(w, face->above, p)); i++) {
		move_place(w, &face->at);
		put_place(w, &face->at, p);
	}
}

static void place_bridge(struct mesh_work *w, const struct mesh_bridge *bridge)
{
	struct face face;

	face_init(w, bridge, &face);
	for (unsigned k = 0; k < 2; k++) {
		size_t vertex = (size_t)bridge->vertex + k;
		struct mesh_planes l;

		find_ends(w, &face, k, &l);
		find_middle(w, &l, &face.at);
		put_clear(w, &face, w->positions + 3 * vertex);
		mesh_planes_normal(&l, w->normals + 3 * vertex);
		w->is_sharp[vertex] = 0;
	}
}

/* ---- onto the surface ---- */

/* Whether the surface is what passes through a face: not the box's caps. */
static bool is_within(const struct cells_grid *grid, const struct face *face)
{
	for (int k = 0; k < 3; k++)
		if (face->at.face[k] < 1 ||
		    face->at.face[k] > grid->counts[k])
			return false;
	return true;
}

/* How far from the corner that its segment cuts off a bridge may be drawn, of
 * each edge: the segment's middle is at half of them at most. */
#define DRAWN_PART 0.6

/* Newton's step within the face, as far as it allows. */
static void draw(const struct mesh_work *w, struct face *face, unsigned k,
    const float row[static 4], float p[static 3])
{
	double f = (double)row[0] - w->grid.iso, g2 = 0.0;
	struct place *at = &face->at;
	struct mesh_planes l;

	find_ends(w, face, k, &l);
	find_middle(w, &l, at);
	for (unsigned i = 1; i < 3; i++)
		g2 += (double)row[1 + (at->axis + i) % 3] *
		    row[1 + (at->axis + i) % 3];
	for (unsigned i = 0; i < 2 && g2 > 0.0; i++) {
		int a = (int)((at->axis + 1 + i) % 3);
		double low = cells_corner(&w->grid, a, at->face[a]);
		double high = cells_corner(&w->grid, a, at->face[a] + 1);
		double part = ((double)p[a] - f * (row[1 + a] / g2) - low) /
		    (high - low);

		at->part[i] = fmin(fmax(at->upper[i] ? 1.0 - part : part, 0.0),
		    DRAWN_PART);
	}
	put_clear(w, face, p);
}

/* Bridges that are drawn at a time. */
#define DRAWN_MAX (MESH_BATCH / 2)

static enum err sample_bridges(struct mesh_work *w,
    const struct mesh_bridge *bridges, size_t count)
{
	w->points_sampled += 2 * count;
	return w->sampler->sample(w->sampler, w->positions +
	    3 * (size_t)bridges->vertex, 2 * count,
	    OUTPUT_VALUE | OUTPUT_GRADIENT, w->rows);
}

/* One step for each, which is kept where it comes nearer. errors: room for two
 * a bridge; w->points keeps where they were. */
static enum err draw_bridges(struct mesh_work *w,
    const struct mesh_bridge *bridges, size_t count, double *errors)
{
	float *p = w->positions + 3 * (size_t)bridges->vertex;
	struct face face;
	enum err err = sample_bridges(w, bridges, count);

	if (err != ERR_OK)
		return err;
	memcpy(w->points, p, 6 * count * sizeof *p);
	for (size_t i = 0; i < 2 * count; i++) {
		face_init(w, bridges + i / 2, &face);
		errors[i] = 0.0;
		if (!is_within(&w->grid, &face))
			continue;
		errors[i] = fabs((double)w->rows[4 * i] - w->grid.iso);
		draw(w, &face, i % 2, w->rows + 4 * i, p + 3 * i);
	}
	err = sample_bridges(w, bridges, count);
	for (size_t i = 0; i < 2 * count && err == ERR_OK; i++) {
		double error = fabs((double)w->rows[4 * i] - w->grid.iso);

		if (error < errors[i])
			errors[i] = error;
		else
			memcpy(p + 3 * i, w->points + 3 * i, 3 * sizeof *p);
		w->largest_error = fmax(w->largest_error, errors[i]);
	}
	return err;
}

enum err mesh_place_bridges(struct mesh_work *w)
{
	double *errors;
	enum err err = ERR_OK;

	if (w->bridge_count == 0)
		return ERR_OK;
	for (size_t i = 0; i < w->bridge_count; i++)
		place_bridge(w, w->bridges + i);
	errors = malloc(2 * DRAWN_MAX * sizeof *errors);
	if (errors == NULL)
		return ERR_MEMORY;
	for (size_t i = 0; i < w->bridge_count && err == ERR_OK;
	    i += DRAWN_MAX) {
		size_t left = w->bridge_count - i;

		err = sampler_goes_on(w->sampler, "vertices", 0.9) ?
		    draw_bridges(w, w->bridges + i,
		    left < DRAWN_MAX ? left : DRAWN_MAX, errors) :
		    ERR_CANCELLED;
	}
	free(errors);
	return err;
}
