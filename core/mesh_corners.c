#include "core/mesh_corners.h"

#include <float.h>
#include <stdlib.h>

#include "core/mesh_work.h"
#include "core/output.h"

#define SIDE CELLS_SIDE
#define CORNERS MESH_CORNERS

/* Which block corner (x, y, z) of a block is the lowest ones of. */
static inline unsigned owner_of(unsigned x, unsigned y, unsigned z)
{
	return x / SIDE | y / SIDE << 1 | z / SIDE << 2;
}

static inline unsigned local_of(unsigned x, unsigned y, unsigned z)
{
	return x % SIDE + y % SIDE * 4 + z % SIDE * 16;
}

/* Corners from first to first + 2 step in steps, along each axis. */
static void set_masks(const unsigned first[static 3], unsigned step,
    uint64_t masks[static 8])
{
	for (unsigned i = 0; i < 27; i++) {
		unsigned x = first[0] + i % 3 * step;
		unsigned y = first[1] + i / 3 % 3 * step;
		unsigned z = first[2] + i / 9 * step;

		masks[owner_of(x, y, z)] |= (uint64_t)1 << local_of(x, y, z);
	}
}

enum err mesh_corners_init(const struct cells_grid *grid,
    struct mesh_corners *out)
{
	const size_t *n = grid->blocks;

	*out = (struct mesh_corners){0};
	for (unsigned i = 0; i < 8; i++)
		set_masks((unsigned[3]){2 * (i & 1), i & 2, i >> 1 & 2}, 1,
		    out->parts[i]);
	set_masks((unsigned[3]){0, 0, 0}, 2, out->ends);
	out->index = calloc(n[0] * n[1] * n[2], sizeof *out->index);
	return out->index == NULL ? ERR_MEMORY : ERR_OK;
}

void mesh_corners_fini(struct mesh_corners *corners)
{
	free(corners->index);
	free(corners->blocks);
	*corners = (struct mesh_corners){0};
}

/* ---- blocks ---- */

/* The outer ones are known. */
static void set_outer(const struct cells_grid *grid,
    struct mesh_corners_block *b)
{
	bool is_outer[3][SIDE], any = false;

	for (int a = 0; a < 3; a++)
		for (size_t i = 0; i < SIDE; i++) {
			is_outer[a][i] = cells_is_outer(grid, a,
			    b->at[a] * (size_t)SIDE + i);
			any |= is_outer[a][i];
		}
	for (unsigned i = 0; i < 64 && any; i++)
		if (is_outer[0][i & 3] || is_outer[1][i >> 2 & 3] ||
		    is_outer[2][i >> 4]) {
			b->values[i] = -FLT_MAX;
			b->known |= (uint64_t)1 << i;
		}
}

/* The place in index of the block that is beyond by owner's bits, or NULL: all
 * of its corners are outer ones. */
static uint32_t *place_of(const struct mesh_corners *c,
    const struct cells_grid *grid, const struct cells_block *block,
    unsigned owner)
{
	const size_t *n = grid->blocks;
	size_t x = block->at[0] + (owner & 1u);
	size_t y = block->at[1] + (owner >> 1 & 1u);
	size_t z = block->at[2] + (owner >> 2);

	return x >= n[0] || y >= n[1] || z >= n[2] ? NULL :
	    c->index + (z * n[1] + y) * n[0] + x;
}

static enum err add_block(struct mesh_corners *c,
    const struct cells_grid *grid, const struct cells_block *block,
    unsigned owner)
{
	struct mesh_corners_block *blocks = mesh_room(c->blocks, &c->max,
	    c->count + 1, sizeof *blocks);
	struct mesh_corners_block *b;

	if (blocks == NULL)
		return ERR_MEMORY;
	c->blocks = blocks;
	b = blocks + c->count++;
	b->wanted = b->known = 0;
	for (unsigned a = 0; a < 3; a++)
		b->at[a] = (uint16_t)(block->at[a] + (owner >> a & 1u));
	set_outer(grid, b);
	return ERR_OK;
}

/* Wants of each block further on these corners. */
static enum err want(struct mesh_corners *c, const struct cells_grid *grid,
    const struct cells_block *block, const uint64_t masks[static 8])
{
	for (unsigned k = 0; k < 8; k++) {
		uint32_t *place = place_of(c, grid, block, k);

		if (masks[k] == 0 || place == NULL)
			continue;
		if (*place == 0) {
			enum err err = add_block(c, grid, block, k);

			if (err != ERR_OK)
				return err;
			*place = (uint32_t)c->count;
		}
		c->blocks[*place - 1].wanted |= masks[k];
	}
	return ERR_OK;
}

enum err mesh_corners_want_ends(struct mesh_corners *corners,
    const struct cells_grid *grid, const struct cells_block *block)
{
	return want(corners, grid, block, corners->ends);
}

enum err mesh_corners_want(struct mesh_corners *corners,
    const struct cells_grid *grid, const struct cells_block *block)
{
	uint64_t masks[8] = {0};

	for (unsigned i = 0; i < 8; i++)
		for (unsigned k = 0; k < 8 && block->parts >> i & 1; k++)
			masks[k] |= corners->parts[i][k];
	return want(corners, grid, block, masks);
}

/* ---- sampling ---- */

struct batch {
	struct mesh_work *w;
	float **values; /* where they go */
	size_t count;
};

static enum err flush(struct batch *b)
{
	enum err err = mesh_sample(b->w, b->count, OUTPUT_VALUE);

	for (size_t i = 0; i < b->count && err == ERR_OK; i++)
		*b->values[i] = b->w->rows[i];
	b->count = 0;
	return err;
}

static void put_block(struct batch *batch, struct mesh_corners_block *b)
{
	const struct cells_grid *grid = &batch->w->grid;
	const float *at[3];

	for (int a = 0; a < 3; a++)
		at[a] = grid->at[a] + b->at[a] * (size_t)SIDE;
	for (uint64_t bits = b->wanted & ~b->known; bits != 0;
	    bits &= bits - 1) {
		unsigned i = (unsigned)__builtin_ctzll(bits);
		float *p = batch->w->points + 3 * batch->count;

		p[0] = at[0][i & 3];
		p[1] = at[1][i >> 2 & 3];
		p[2] = at[2][i >> 4];
		batch->values[batch->count++] = b->values + i;
	}
	b->known |= b->wanted;
}

enum err mesh_corners_sample(struct mesh_corners *corners,
    struct mesh_work *w, double first, double last)
{
	struct batch batch = {w, malloc(MESH_BATCH * sizeof *batch.values), 0};
	enum err err = batch.values == NULL ? ERR_MEMORY : ERR_OK;

	for (size_t i = 0; i < corners->count && err == ERR_OK; i++) {
		if (batch.count + 64 > MESH_BATCH)
			err = sampler_goes_on(w->sampler, "cells", first +
			    (last - first) * (double)i /
			    (double)corners->count) ?
			    flush(&batch) : ERR_CANCELLED;
		if (err == ERR_OK)
			put_block(&batch, corners->blocks + i);
	}
	if (err == ERR_OK)
		err = flush(&batch);
	free(batch.values);
	return err;
}

/* ---- values ---- */

/* A block and those further on; NULL: all outer corners. */
struct around {
	struct mesh_corners_block *blocks[8];
};

static struct around look_around(const struct mesh_corners *corners,
    const struct cells_grid *grid, const struct cells_block *block)
{
	struct around around;

	for (unsigned k = 0; k < 8; k++) {
		const uint32_t *place = place_of(corners, grid, block, k);

		around.blocks[k] = place == NULL || *place == 0 ? NULL :
		    corners->blocks + (*place - 1);
	}
	return around;
}

void mesh_corners_ends(const struct mesh_corners *corners,
    const struct cells_grid *grid, const struct cells_block *block,
    float values[static MESH_BLOCK_CORNERS])
{
	struct around around = look_around(corners, grid, block);

	for (unsigned i = 0; i < 27; i++) {
		unsigned x = i % 3 * 2, y = i / 3 % 3 * 2, z = i / 9 * 2;
		const struct mesh_corners_block *b =
		    around.blocks[owner_of(x, y, z)];

		values[x + CORNERS * (y + CORNERS * z)] = b == NULL ?
		    -FLT_MAX : b->values[local_of(x, y, z)];
	}
}

/* The value of corner i of b, which becomes instead where it is not known. */
static inline float take(struct mesh_corners_block *b, unsigned i,
    float instead)
{
	if (b == NULL)
		return -FLT_MAX;
	if (!(b->known >> i & 1)) {
		b->values[i] = instead;
		b->known |= (uint64_t)1 << i;
	}
	return b->values[i];
}

void mesh_corners_get(struct mesh_corners *corners,
    const struct cells_grid *grid, const struct cells_block *block,
    float values[static MESH_BLOCK_CORNERS])
{
	struct around around = look_around(corners, grid, block);
	unsigned place = 0;

	mesh_corners_ends(corners, grid, block, values);
	for (unsigned z = 0; z < CORNERS; z++)
		for (unsigned y = 0; y < CORNERS; y++)
			for (unsigned x = 0; x < CORNERS; x++, place++)
				values[place] = take(
				    around.blocks[owner_of(x, y, z)],
				    local_of(x, y, z), values[(x & ~1u) +
				    CORNERS * ((y & ~1u) +
				    CORNERS * (z & ~1u))]);
}
