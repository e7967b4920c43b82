/*
 * Meshes of level sets f = iso: closed, orientable 2-manifolds, whatever the
 * field. Only cells that may hold some of the surface, by ranges (core/range.h),
 * are looked at.
 *
 * Method: dual contouring on a regular grid (Ju, Losasso, Schaefer, Warren
 * 2002), one vertex for every closed curve in which the surface meets a cell's
 * faces rather than one a cell, so that it is manifold (as Nielson 2004, Schaefer,
 * Ju, Warren 2007), vertices by quadric error from the edges' points and
 * normals, which keeps sharp edges and corners, then drawn to the surface.
 *
 * No two vertices are at the same place, so that programs that know them by
 * their coordinates see the same mesh. Parts thinner than a cell may be missed
 * or broken, as with any grid; the mesh is closed all the same. Surfaces of
 * different parts of it may pass through each other within a cell.
 */
#ifndef CORE_MESH_H
#define CORE_MESH_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#include "core/err.h"
#include "core/sampler.h"
#include "core/vec3.h"

struct range_tape;

/* Cells along an axis at most, and vertices. */
#define MESH_CELLS_MAX 1024
#define MESH_VERTICES_MAX 4000000

struct mesh_options {
	struct vec3 min, max; /* the box that is meshed, finite, min < max. The
	                       * surface is capped where it leaves it */
	double edge;          /* of cells, world units: the longest they may be;
	                       * along each axis the box is cut evenly */
	size_t counts_least;  /* cells along each axis at least; 0: 1 */
	double iso;           /* > 0 */
	bool features;        /* keep sharp edges and corners */
	bool normals, colors; /* want them */
};

/* What a mesh is like. Lengths in world units. */
struct mesh_figures {
	size_t vertices, triangles;
	size_t components;    /* connected */
	long euler;           /* vertices - edges + triangles */
	long genus;           /* components - euler / 2: handles of all together */
	double area, volume;  /* volume by the divergence theorem */
	struct vec3 min, max; /* of vertices; 0 without any */
	size_t counts[3];     /* cells along the axes */
	double edge;          /* as asked for */
	size_t cells;         /* of the whole grid */
	size_t cells_evaluated; /* whose corners were sampled */
	size_t points;        /* sampled in all */
	size_t full_points;   /* corners of the whole grid */
	size_t sharp_vertices;  /* on edges, corners and rims of caps */
	double largest_error; /* of |f - iso| at vertices but those of caps */
};

struct mesh {
	float *positions;     /* xyz each, world units */
	float *normals;       /* unit, outward; NULL if not wanted */
	float *colors;        /* linear RGB; NULL if not wanted */
	uint32_t *triangles;  /* three indices each, counter-clockwise from outside */
	struct mesh_figures figures;
};

/*
 * Meshes the level set. *out is the caller's, for mesh_free; it may be empty.
 * ERR_LIMIT: more than MESH_CELLS_MAX cells along an axis, or more than
 * MESH_VERTICES_MAX vertices. ERR_INVALID: cells that float32 cannot tell apart
 * (CELLS_LEAST_EDGE of core/cells.h). ERR_MEMORY, ERR_CANCELLED, or what
 * sampling ends with; a sampler that gives a point other values each time does no harm but to
 * where vertices are. Stages:
 * "cells", "edges", "vertices", "normals"; asked at least every 65536 points.
 * Memory follows the surface (about 200 bytes a vertex), but for 8 bytes a
 * block of 4^3 cells of the box.
 */
enum err mesh_build(const struct range_tape *tape,
    const struct mesh_options *options, struct sampler *sampler,
    struct mesh **out);

/* Frees m; NULL does nothing. */
void mesh_free(struct mesh *m);

/* Whether every edge has two triangles, in opposite directions, and every
 * vertex one fan: for tests. *edge_faults and *vertex_faults count. ERR_MEMORY. */
enum err mesh_check(const struct mesh *m, size_t *edge_faults,
    size_t *vertex_faults);

#endif
