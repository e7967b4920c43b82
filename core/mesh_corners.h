/*
 * Values at corners of blocks of cells (core/cells.h). Each corner has one value,
 * kept with the block that it is one of the lowest of: it is sampled once, and
 * what is not sampled is given a value once. So no two blocks can disagree,
 * whatever a sampler or ranges say.
 */
#ifndef CORE_MESH_CORNERS_H
#define CORE_MESH_CORNERS_H

#include <stddef.h>
#include <stdint.h>

#include "core/cells.h"
#include "core/err.h"

struct mesh_work;

/* Corners of a block along an axis, and of all of it: x fastest. */
#define MESH_CORNERS (CELLS_SIDE + 1)
#define MESH_BLOCK_CORNERS (MESH_CORNERS * MESH_CORNERS * MESH_CORNERS)

/* A block's lowest corners: bit or value x + 4 y + 16 z. */
struct mesh_corners_block {
	uint16_t at[3];
	uint64_t wanted, known;
	float values[64];
};

struct mesh_corners {
	uint32_t *index; /* of each block of the grid: of blocks, one more */
	struct mesh_corners_block *blocks;
	size_t count, max;
	/* Of the block and those further on (dx + 2 dy + 4 dz): corners of each
	 * part, and those of all parts' ends. */
	uint64_t parts[8][8], ends[8];
};

/* mesh_corners_fini. ERR_MEMORY. */
enum err mesh_corners_init(const struct cells_grid *grid,
    struct mesh_corners *out);
void mesh_corners_fini(struct mesh_corners *corners);

/* Wants the ends of a block's parts; the corners of those parts that are in
 * block->parts. ERR_MEMORY. */
enum err mesh_corners_want_ends(struct mesh_corners *corners,
    const struct cells_grid *grid, const struct cells_block *block);
enum err mesh_corners_want(struct mesh_corners *corners,
    const struct cells_grid *grid, const struct cells_block *block);

/* Samples what is wanted and not known. Progress of the stage "cells" goes from
 * first to last. What sampling ends with; ERR_MEMORY; ERR_CANCELLED. */
enum err mesh_corners_sample(struct mesh_corners *corners,
    struct mesh_work *w, double first, double last);

/* The values of a block's ends, which are known; others are not set. */
void mesh_corners_ends(const struct mesh_corners *corners,
    const struct cells_grid *grid, const struct cells_block *block,
    float values[static MESH_BLOCK_CORNERS]);

/* The values of a block whose ends are known. One that is not known becomes, for
 * good, that of the end of its part which is next below. */
void mesh_corners_get(struct mesh_corners *corners,
    const struct cells_grid *grid, const struct cells_block *block,
    float values[static MESH_BLOCK_CORNERS]);

#endif
