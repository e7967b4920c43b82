/*
 * What the stages of meshing (core/mesh.h) hand on to each other. Everything is
 * kept by blocks of cells that the surface passes through, so that memory
 * follows the surface: of a block, which of its cells and edges are crossed, as
 * bits, and where they begin in arrays of all.
 */
#ifndef CORE_MESH_WORK_H
#define CORE_MESH_WORK_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#include "core/cells.h"
#include "core/err.h"
#include "core/mesh.h"
#include "core/mesh_loops.h"

/* Points of a call of the sampler at most: between two, it is asked whether to
 * go on. */
#define MESH_BATCH 65536

#define MESH_NONE UINT32_MAX

/* Cells of a block: bit x + 4 y + 16 z. */
struct mesh_block {
	uint16_t at[3];
	uint64_t cells;    /* which the surface passes through */
	uint64_t edges[3]; /* which it crosses: along each axis, from the cell's
	                    * lowest corner on */
	uint32_t first_cell;
	uint32_t first_crossing[3]; /* along each axis */
	uint32_t faces[6]; /* 2 a + s: which corners of it are inside: bit
	                    * u + 5 v, u and v along the axes that follow a */
};

/* All corners of a face. */
#define MESH_FACE_ALL 0x1ffffffu

/* Whether the surface leaves b through face f. */
static inline bool mesh_is_open(const struct mesh_block *b, unsigned f)
{
	return b->faces[f] != 0 && b->faces[f] != MESH_FACE_ALL;
}

struct mesh_cell {
	uint32_t block;
	uint32_t vertex;   /* the first; one a curve */
	uint8_t local;     /* x + 4 y + 16 z */
	uint8_t inside, joined; /* core/mesh_loops.h */
	uint8_t loops;
};

/* Where the surface crosses an edge. */
struct mesh_crossing {
	float at;        /* 0 to 1 along it */
	float normal[3]; /* unit, outward; across a cap the edge's */
	float ends[2];   /* values */
};

/* Two vertices more, on the segments of a face that would be doubled. */
struct mesh_bridge {
	uint32_t cell;   /* the face is its upper one */
	uint32_t axis;   /* across this */
	uint32_t vertex; /* of the segment with the lesser edge; then the other */
};

struct mesh_work {
	struct cells_grid grid;
	const struct mesh_options *options;
	struct sampler *sampler;
	struct mesh_cases cases;
	uint32_t *index; /* of each block of the grid: of blocks, or MESH_NONE
	                  * less: 0: none, else one more */
	struct mesh_block *blocks;
	size_t block_count, block_max;
	struct mesh_cell *cells;
	size_t cell_count, cell_max;
	struct mesh_crossing *crossings;
	size_t crossing_count, crossing_max;
	struct mesh_bridge *bridges; /* by cell, then axis */
	size_t bridge_count, bridge_max;
	size_t vertex_count;   /* of the cells, then of bridges */
	float *points, *rows;  /* of a batch */
	float *positions, *normals; /* of vertices */
	uint8_t *is_sharp;
	size_t points_sampled, cells_sampled;
	double largest_error;
};

/* array, which has room for *max items of size, with room for count, moved if
 * need be; NULL: no memory, and array stays. */
void *mesh_room(void *array, size_t *max, size_t count, size_t size);

/* Samples count (<= MESH_BATCH) of w->points to w->rows. */
enum err mesh_sample(struct mesh_work *w, size_t count, unsigned outputs);

/* The stages, in order. */
enum err mesh_find_cells(struct mesh_work *w, const struct range_tape *tape);
enum err mesh_find_crossings(struct mesh_work *w);
enum err mesh_find_bridges(struct mesh_work *w);
enum err mesh_place_vertices(struct mesh_work *w);
enum err mesh_make_triangles(const struct mesh_work *w, struct mesh *m);

/* Sets the figures that follow from positions and triangles, whose counts are
 * set. ERR_MEMORY, ERR_CANCELLED. */
enum err mesh_measure(struct mesh *m, struct sampler *sampler);

/* Where vertices of a cell may be: the cell, less a margin, so that no two of
 * different cells are at the same place. */
struct mesh_limits {
	float low[3], high[3];
};

void mesh_limits_set(const struct cells_grid *grid,
    const size_t cell[static 3], struct mesh_limits *out);

/* The same with the least margin. */
void mesh_limits_set_wide(const struct cells_grid *grid,
    const size_t cell[static 3], struct mesh_limits *out);

/* Once vertices of cells are placed: keeps those of one cell apart; places those
 * of bridges. ERR_MEMORY, ERR_CANCELLED, or what sampling ends with. */
enum err mesh_part_vertices(struct mesh_work *w);
enum err mesh_place_bridges(struct mesh_work *w);

/* ---- where things are ---- */

/* Number of set bits: in place, the builtin is a call on a plain x86-64. */
static inline uint32_t mesh_bits(uint64_t x)
{
	x -= x >> 1 & 0x5555555555555555;
	x = (x & 0x3333333333333333) + (x >> 2 & 0x3333333333333333);
	x = (x + (x >> 4)) & 0x0f0f0f0f0f0f0f0f;
	return (uint32_t)(x * 0x0101010101010101 >> 56);
}

/* The block at (x, y, z), or NULL. */
static inline const struct mesh_block *mesh_block_at(
    const struct mesh_work *w, size_t x, size_t y, size_t z)
{
	const size_t *n = w->grid.blocks;
	uint32_t i;

	if (x >= n[0] || y >= n[1] || z >= n[2])
		return NULL;
	i = w->index[(z * n[1] + y) * n[0] + x];
	return i == 0 ? NULL : w->blocks + (i - 1);
}

/* The cell of b at bit local, which is set. */
static inline uint32_t mesh_cell_of(const struct mesh_block *b, unsigned local)
{
	return b->first_cell +
	    mesh_bits(b->cells & (((uint64_t)1 << local) - 1));
}

/* The cell at these coordinates, or NULL if the surface does not pass it. */
static inline const struct mesh_cell *mesh_cell_at(const struct mesh_work *w,
    const size_t at[static 3])
{
	const struct mesh_block *b = mesh_block_at(w, at[0] / CELLS_SIDE,
	    at[1] / CELLS_SIDE, at[2] / CELLS_SIDE);
	unsigned local = (unsigned)(at[0] % CELLS_SIDE +
	    at[1] % CELLS_SIDE * 4 + at[2] % CELLS_SIDE * 16);

	return b == NULL || !(b->cells >> local & 1) ? NULL :
	    w->cells + mesh_cell_of(b, local);
}

/* The crossing of b's edge along axis a at bit local, which is set. */
static inline uint32_t mesh_crossing_of(const struct mesh_block *b,
    unsigned a, unsigned local)
{
	return b->first_crossing[a] +
	    mesh_bits(b->edges[a] & (((uint64_t)1 << local) - 1));
}

/* A block with those about it that its cells' upper edges (or its edges' lower
 * cells) belong to: [1 + dx][1 + dy][1 + dz] in 0 or +1 (-1): index dx + 2 dy +
 * 4 dz of how many steps. */
struct mesh_near {
	const struct mesh_block *blocks[8];
};

void mesh_near_init(const struct mesh_work *w, const struct mesh_block *b,
    int step, struct mesh_near *out);

/* The crossing of edge (core/mesh_loops.h) of the cell at bit local of near's
 * block, near's steps upward. */
uint32_t mesh_cell_crossing(const struct mesh_near *near, unsigned local,
    unsigned edge);

/* The cell that lies across steps of -1 (bit a of down: along axis a) from the
 * one at bit local of near's block, near's steps downward. */
uint32_t mesh_cell_below(const struct mesh_near *near, unsigned local,
    unsigned down);

/* The cell above that at bit local of near's block along axis a. */
uint32_t mesh_cell_above(const struct mesh_near *near, unsigned local,
    unsigned a);

/* The lowest corner of a cell, or of an edge. */
static inline void mesh_corner_of(const struct mesh_block *b, unsigned local,
    size_t corner[static 3])
{
	for (int a = 0; a < 3; a++)
		corner[a] = (size_t)b->at[a] * CELLS_SIDE +
		    (local >> 2 * a & 3);
}

/* Whether the edge along a from corner on leads out of the box. */
static inline bool mesh_is_cap(const struct cells_grid *grid,
    const size_t corner[static 3], unsigned a)
{
	return corner[a] == 0 || corner[a] == grid->counts[a] + 1;
}

/* Where the crossing at part t of the edge along a from corner on is. */
static inline void mesh_on_edge(const struct cells_grid *grid,
    const size_t corner[static 3], unsigned a, double t, double p[static 3])
{
	for (int k = 0; k < 3; k++)
		p[k] = cells_corner(grid, k, corner[k]);
	p[a] += t * ((double)cells_corner(grid, (int)a, corner[a] + 1) - p[a]);
}

#endif
