/*
 * A tile: TILE_POINTS points that a device evaluates together, and the tape it
 * walks for them. Compiles as C11 and as OpenCL C.
 */
#ifndef CORE_TILE_H
#define CORE_TILE_H

/* Points of a tile: a work-item of the CPU takes one. */
#define TILE_POINTS 64

#ifdef __OPENCL_C_VERSION__
#define TILE_UINT uint
#else
#include <assert.h>
#include <stdint.h>
#define TILE_UINT uint32_t
#endif

struct tile {
	TILE_UINT first; /* instruction of the batch's pruned ones */
	TILE_UINT count; /* 0: the whole tape, of the tape's own instructions */
};

#ifndef __OPENCL_C_VERSION__
static_assert(sizeof(struct tile) == 8, "struct tile is shared with the device");
#endif

#endif
