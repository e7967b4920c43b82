/*
 * Which cells of a regular grid may hold some of a level set: ranges
 * (core/range.h) of ever smaller blocks of cells, each over the part of the tape
 * that is alive in the block about it.
 *
 * About the cells there is a ring of one more cell on every side, of no
 * thickness: its outer corners count as outside, which caps what leaves the
 * box. Cells and corners are counted from the ring's first: real cells from 1
 * to counts, real corners from 1 to counts + 1.
 */
#ifndef CORE_CELLS_H
#define CORE_CELLS_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#include "core/err.h"
#include "core/vec3.h"

struct range_tape;
struct sampler;

/* Cells of a block along an axis. */
#define CELLS_SIDE 4

/* One of float32's steps, of the largest coordinate, at most. */
#define CELLS_STEP 0x1p-23

/* Cells shorter along an axis than this part of the largest coordinate along it
 * are too short for float32: eight steps of it, or more. */
#define CELLS_LEAST_EDGE 0x1p-20

struct cells_grid {
	size_t counts[3];    /* of cells along the axes, without the ring */
	size_t blocks[3];    /* of blocks that hold cells and ring */
	double edge;         /* of cells, world units, at most */
	double steps[3];     /* their sides along the axes */
	double least;        /* the shortest of them */
	double grains[3];    /* CELLS_STEP of the largest coordinate, of a step */
	double iso;
	float *at[3];        /* coordinates of corners 0 to counts + 2 */
};

/* A block: its first cell is CELLS_SIDE times this. Its parts are the eight of
 * half its side. */
struct cells_block {
	uint16_t at[3];
	uint8_t parts; /* bit dx + 2 dy + 4 dz: may hold some of the surface */
};

struct cells_list {
	struct cells_block *blocks;
	size_t count, max;
};

/*
 * Cells of this edge, or a little less, over the box from min to max (finite,
 * min < max): along each axis the least number of equal ones, but counts_least
 * (>= 1) where float32 can tell so many apart. cells_grid_fini. ERR_LIMIT: more
 * than counts_max along an axis. ERR_INVALID: shorter than CELLS_LEAST_EDGE
 * allows. ERR_MEMORY.
 */
enum err cells_grid_init(struct cells_grid *grid, struct vec3 min,
    struct vec3 max, double edge, double iso, size_t counts_least,
    size_t counts_max);
void cells_grid_fini(struct cells_grid *grid);

/* Coordinate i of corners along axis a: the ring's are the box's. */
static inline float cells_corner(const struct cells_grid *grid, int a, size_t i)
{
	return grid->at[a][i];
}

/* Whether corner i along axis a is the ring's outer one, or beyond. */
static inline bool cells_is_outer(const struct cells_grid *grid, int a,
    size_t i)
{
	return i == 0 || i > grid->counts[a] + 1;
}

/*
 * The blocks that may hold some of f = grid->iso, or of its caps, along a
 * Z-curve, with all their parts. *out is the caller's, for cells_list_fini. Tells
 * sampler how far it is. ERR_MEMORY, ERR_CANCELLED.
 */
enum err cells_find(const struct range_tape *tape,
    const struct cells_grid *grid, struct sampler *sampler,
    struct cells_list *out);

/*
 * Looks at parts of cells_find's blocks by themselves: of those in doubts (one
 * for each block) it takes out what holds none. Fastest along a Z-curve.
 * ERR_MEMORY, ERR_CANCELLED.
 */
enum err cells_thin_out(const struct range_tape *tape,
    const struct cells_grid *grid, struct sampler *sampler,
    const uint8_t *doubts, struct cells_list *list);

/* ERR_MEMORY. */
enum err cells_list_add(struct cells_list *list, struct cells_block block);
void cells_list_fini(struct cells_list *list);

#endif
