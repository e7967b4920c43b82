/*
 * The blocks that the surface passes through: values at corners, which cells
 * and edges it crosses.
 *
 * Blocks come from ranges; one whose face the surface crosses brings in the one
 * beyond, whatever its range was, so that no curve ends anywhere.
 */
#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "core/mesh_corners.h"
#include "core/mesh_work.h"
#include "core/output.h"

#define SIDE CELLS_SIDE
#define CORNERS MESH_CORNERS

/* Parts are not worth a range whose ends come nearer to iso than this part of
 * what they differ by: most of those hold some of the surface, or may. */
#define LIKELY 0.1

_Static_assert(SIDE == 4, "cells of a block are bits of 64");

void *mesh_room(void *array, size_t *max, size_t count, size_t size)
{
	size_t grown = *max ? *max : 1024;
	void *moved;

	if (count <= *max && array != NULL)
		return array;
	while (grown < count)
		grown *= 2;
	moved = realloc(array, grown * size);
	if (moved != NULL)
		*max = grown;
	return moved;
}

enum err mesh_sample(struct mesh_work *w, size_t count, unsigned outputs)
{
	w->points_sampled += count;
	return count == 0 ? ERR_OK : w->sampler->sample(w->sampler, w->points,
	    count, outputs, w->rows);
}

/* ---- what is crossed ---- */

struct scan {
	const float *values;
	double iso;
	uint8_t rows[CORNERS][CORNERS]; /* [z][y]: bit x: inside */
};

static void scan_rows(struct scan *s)
{
	const float *v = s->values;

	for (int z = 0; z < CORNERS; z++)
		for (int y = 0; y < CORNERS; y++, v += CORNERS) {
			unsigned bits = 0;

			for (int x = 0; x < CORNERS; x++)
				bits |= (unsigned)((double)v[x] >= s->iso) << x;
			s->rows[z][y] = (uint8_t)bits;
		}
}

/* Of corners' bits, those of cells that have both kinds. */
static unsigned mixed(unsigned any, unsigned all)
{
	return (any | any >> 1) & ~(all & all >> 1) & 15u;
}

static void find_mixed(const struct scan *s, struct mesh_block *b)
{
	for (int z = 0; z < SIDE; z++)
		for (int y = 0; y < SIDE; y++) {
			const uint8_t *r = s->rows[z] + y;
			const uint8_t *q = s->rows[z + 1] + y;
			int shift = 4 * y + 16 * z;

			b->cells |= (uint64_t)mixed(
			    (unsigned)(r[0] | r[1] | q[0] | q[1]),
			    (unsigned)(r[0] & r[1] & q[0] & q[1])) << shift;
			b->edges[0] |= (uint64_t)((r[0] ^ r[0] >> 1) & 15)
			    << shift;
			b->edges[1] |= (uint64_t)((r[0] ^ r[1]) & 15) << shift;
			b->edges[2] |= (uint64_t)((r[0] ^ q[0]) & 15) << shift;
		}
}

static void find_faces(const struct scan *s, struct mesh_block *b)
{
	for (int i = 0; i < CORNERS; i++)
		for (int k = 0; k < CORNERS; k++) {
			unsigned x = s->rows[i][k]; /* at y = k, z = i */

			b->faces[0] |= (x & 1) << (k + CORNERS * i);
			b->faces[1] |= (x >> SIDE) << (k + CORNERS * i);
			b->faces[2] |= (s->rows[i][0] >> k & 1u)
			    << (i + CORNERS * k);
			b->faces[3] |= (s->rows[i][SIDE] >> k & 1u)
			    << (i + CORNERS * k);
		}
	for (int k = 0; k < CORNERS; k++) {
		b->faces[4] |= (uint32_t)s->rows[0][k] << CORNERS * k;
		b->faces[5] |= (uint32_t)s->rows[SIDE][k] << CORNERS * k;
	}
}

static const unsigned char strides[3] = {1, CORNERS, CORNERS * CORNERS};

/* A corner's place among a block's values. */
static size_t place_of(unsigned local)
{
	return (local & 3) + (local >> 2 & 3) * (size_t)CORNERS +
	    (local >> 4) * (size_t)(CORNERS * CORNERS);
}

/* Place of a cell's corner c, from its lowest one. */
static size_t step_to(unsigned c)
{
	return (c & 1) + (c >> 1 & 1) * (size_t)CORNERS +
	    (c >> 2) * (size_t)(CORNERS * CORNERS);
}

/*
 * Whether, of a face with diagonal corners inside, these are joined: where the
 * bilinear function of the four values is inside at its saddle (Nielson, Hamann
 * 1991, the asymptotic decider), which is a comparison of products.
 */
static bool is_joined(const struct scan *s, const float *v, unsigned f)
{
	double w[4], even, odd;

	for (unsigned k = 0; k < 4; k++)
		w[k] = (double)v[step_to(mesh_loops_corner(f, k))] - s->iso;
	even = fabs(w[0] * w[2]);
	odd = fabs(w[1] * w[3]);
	return w[0] >= 0.0 ? even >= odd : odd >= even;
}

static struct mesh_cell cell_of(const struct mesh_work *w,
    const struct scan *s, unsigned local)
{
	const float *v = s->values + place_of(local);
	struct mesh_cell cell = {.local = (uint8_t)local};
	struct mesh_loops room;
	unsigned ambiguous;

	for (unsigned c = 0; c < 8; c++)
		cell.inside |= (uint8_t)(((double)v[step_to(c)] >= s->iso)
		    << c);
	ambiguous = w->cases.ambiguous[cell.inside];
	for (unsigned f = 0; ambiguous >> f != 0; f++)
		if (ambiguous >> f & 1 && is_joined(s, v, f))
			cell.joined |= (uint8_t)(1 << f);
	cell.loops = mesh_loops_get(&w->cases, cell.inside, cell.joined,
	    &room)->count;
	return cell;
}

static enum err add_cells(struct mesh_work *w, const struct scan *s,
    const struct mesh_block *b)
{
	size_t count = w->cell_count + mesh_bits(b->cells);
	struct mesh_cell *cells = mesh_room(w->cells, &w->cell_max, count,
	    sizeof *cells);

	if (cells == NULL)
		return ERR_MEMORY;
	w->cells = cells;
	for (uint64_t bits = b->cells; bits != 0; bits &= bits - 1) {
		struct mesh_cell cell = cell_of(w, s,
		    (unsigned)__builtin_ctzll(bits));

		cell.block = (uint32_t)w->block_count;
		cell.vertex = (uint32_t)w->vertex_count;
		w->vertex_count += cell.loops;
		w->cells[w->cell_count++] = cell;
	}
	return w->vertex_count > MESH_VERTICES_MAX ? ERR_LIMIT : ERR_OK;
}

static enum err add_crossings(struct mesh_work *w, const struct scan *s,
    struct mesh_block *b)
{
	size_t count = w->crossing_count + mesh_bits(b->edges[0]) +
	    mesh_bits(b->edges[1]) + mesh_bits(b->edges[2]);
	struct mesh_crossing *crossings = mesh_room(w->crossings,
	    &w->crossing_max, count, sizeof *crossings);

	if (crossings == NULL)
		return ERR_MEMORY;
	w->crossings = crossings;
	for (unsigned a = 0; a < 3; a++) {
		b->first_crossing[a] = (uint32_t)w->crossing_count;
		for (uint64_t bits = b->edges[a]; bits != 0; bits &= bits - 1) {
			const float *v = s->values +
			    place_of((unsigned)__builtin_ctzll(bits));

			w->crossings[w->crossing_count++] =
			    (struct mesh_crossing){
			    .ends = {v[0], v[strides[a]]}};
		}
	}
	return ERR_OK;
}

/* Takes a block in, if the surface passes through any cell of it. */
static enum err add_block(struct mesh_work *w, const struct cells_block *at,
    const float values[static MESH_BLOCK_CORNERS])
{
	const size_t *n = w->grid.blocks;
	struct scan s = {.values = values, .iso = w->grid.iso};
	struct mesh_block b = {.at = {at->at[0], at->at[1], at->at[2]},
	    .first_cell = (uint32_t)w->cell_count};
	struct mesh_block *blocks;
	enum err err;

	scan_rows(&s);
	find_mixed(&s, &b);
	if (b.cells == 0)
		return ERR_OK;
	find_faces(&s, &b);
	err = add_cells(w, &s, &b);
	if (err == ERR_OK)
		err = add_crossings(w, &s, &b);
	if (err != ERR_OK)
		return err;
	blocks = mesh_room(w->blocks, &w->block_max, w->block_count + 1,
	    sizeof *blocks);
	if (blocks == NULL)
		return ERR_MEMORY;
	w->blocks = blocks;
	w->blocks[w->block_count++] = b;
	w->index[(b.at[2] * n[1] + b.at[1]) * n[0] + b.at[0]] =
	    (uint32_t)w->block_count;
	return ERR_OK;
}

/* ---- which corners are sampled ---- */

/* Cells of a block's parts that are the grid's. */
static size_t cells_in(const struct cells_grid *grid,
    const struct cells_block *block)
{
	size_t sum = 0;

	for (unsigned i = 0; i < 8; i++) {
		size_t n = block->parts >> i & 1;

		for (int a = 0; a < 3; a++) {
			size_t first = block->at[a] * (size_t)SIDE +
			    2 * (i >> a & 1);

			n *= (size_t)(first >= 1 && first <= grid->counts[a]) +
			    (first + 1 <= grid->counts[a]);
		}
		sum += n;
	}
	return sum;
}

/*
 * The parts whose ends are all on the same side, and not so near the surface that
 * a range would hardly tell: those that ranges are to look at.
 */
static unsigned doubtful(const struct mesh_work *w,
    const float values[static MESH_BLOCK_CORNERS])
{
	unsigned doubts = 0;

	for (unsigned i = 0; i < 8; i++) {
		const float *v = values + 2 * step_to(i);
		double least = INFINITY, most = -INFINITY, near;

		for (unsigned c = 0; c < 8; c++) {
			double f = (double)v[2 * step_to(c)] - w->grid.iso;

			least = fmin(least, f);
			most = fmax(most, f);
		}
		if (least < 0.0 && most >= 0.0)
			continue;
		near = fmin(fabs(least), fabs(most));
		if (near >= LIKELY * (most - least))
			doubts |= 1u << i;
	}
	return doubts;
}

/* Takes parts that hold none of the surface out of the list. */
static enum err thin_out(struct mesh_work *w, const struct range_tape *tape,
    struct mesh_corners *corners, struct cells_list *list)
{
	uint8_t *doubts = malloc(list->count + 1);
	enum err err = doubts == NULL ? ERR_MEMORY : ERR_OK;

	for (size_t i = 0; i < list->count && err == ERR_OK; i++)
		err = mesh_corners_want_ends(corners, &w->grid,
		    list->blocks + i);
	if (err == ERR_OK)
		err = mesh_corners_sample(corners, w, 0.1, 0.15);
	for (size_t i = 0; i < list->count && err == ERR_OK; i++) {
		float ends[MESH_BLOCK_CORNERS];

		mesh_corners_ends(corners, &w->grid, list->blocks + i, ends);
		doubts[i] = (uint8_t)doubtful(w, ends);
	}
	if (err == ERR_OK)
		err = cells_thin_out(tape, &w->grid, w->sampler, doubts, list);
	free(doubts);
	return err;
}

/* Samples what is to be looked at in these blocks, and takes them in. */
static enum err take_list(struct mesh_work *w, struct mesh_corners *corners,
    const struct cells_list *list, double begun)
{
	float values[MESH_BLOCK_CORNERS];
	enum err err = ERR_OK;

	for (size_t i = 0; i < list->count && err == ERR_OK; i++) {
		w->cells_sampled += cells_in(&w->grid, list->blocks + i);
		err = mesh_corners_want(corners, &w->grid, list->blocks + i);
	}
	if (err == ERR_OK)
		err = mesh_corners_sample(corners, w, begun, 0.4);
	for (size_t i = 0; i < list->count && err == ERR_OK; i++) {
		mesh_corners_get(corners, &w->grid, list->blocks + i, values);
		err = add_block(w, list->blocks + i, values);
	}
	return err;
}

/* ---- what ranges have left out ---- */

/* The place in index of the block beyond face f of b. */
static uint32_t *index_beyond(const struct mesh_work *w,
    const struct mesh_block *b, unsigned f)
{
	const size_t *n = w->grid.blocks;
	size_t at[3] = {b->at[0], b->at[1], b->at[2]};

	at[f / 2] += f & 1 ? 1 : SIZE_MAX;
	return w->index + (at[2] * n[1] + at[1]) * n[0] + at[0];
}

/* Blocks beyond b's open faces that are not there, marked as wanted. */
static enum err want_beyond(struct mesh_work *w, const struct mesh_block *b,
    struct cells_list *list)
{
	enum err err = ERR_OK;

	for (unsigned f = 0; f < 6 && err == ERR_OK; f++) {
		struct cells_block beyond = {{b->at[0], b->at[1], b->at[2]},
		    0xff};
		uint32_t *index;

		if (!mesh_is_open(b, f))
			continue;
		index = index_beyond(w, b, f);
		if (*index != 0)
			continue;
		*index = MESH_NONE;
		beyond.at[f / 2] = (uint16_t)(beyond.at[f / 2] +
		    (f & 1 ? 1 : -1));
		err = cells_list_add(list, beyond);
	}
	return err;
}

/* Those beyond that are missing, until none is. */
static enum err complete(struct mesh_work *w, struct mesh_corners *corners)
{
	enum err err = ERR_OK;

	for (size_t first = 0; first < w->block_count && err == ERR_OK;) {
		struct cells_list list = {0};
		size_t count = w->block_count;

		for (; first < count && err == ERR_OK; first++)
			err = want_beyond(w, w->blocks + first, &list);
		if (err == ERR_OK && list.count > 0)
			err = sampler_goes_on(w->sampler, "cells", 0.4) ?
			    take_list(w, corners, &list, 0.4) : ERR_CANCELLED;
		cells_list_fini(&list);
	}
	return err;
}

static enum err find(struct mesh_work *w, const struct range_tape *tape,
    struct mesh_corners *corners)
{
	struct cells_list list = {0};
	enum err err = cells_find(tape, &w->grid, w->sampler, &list);

	if (err == ERR_OK)
		err = thin_out(w, tape, corners, &list);
	if (err == ERR_OK)
		err = take_list(w, corners, &list, 0.2);
	cells_list_fini(&list);
	return err == ERR_OK ? complete(w, corners) : err;
}

enum err mesh_find_cells(struct mesh_work *w, const struct range_tape *tape)
{
	const size_t *n = w->grid.blocks;
	struct mesh_corners corners = {0};
	enum err err;

	w->index = calloc(n[0] * n[1] * n[2], sizeof *w->index);
	if (w->index == NULL)
		return ERR_MEMORY;
	mesh_cases_init(&w->cases);
	err = mesh_corners_init(&w->grid, &corners);
	if (err == ERR_OK)
		err = find(w, tape, &corners);
	mesh_corners_fini(&corners);
	return err;
}
