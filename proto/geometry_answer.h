/*
 * Answers about rays and projections as JSON; as rows of float32 they are what
 * is printed here.
 */
#ifndef PROTO_GEOMETRY_ANSWER_H
#define PROTO_GEOMETRY_ANSWER_H

#include <stdbool.h>
#include <stddef.h>

#include "core/err.h"

/*
 * A ray's row: hit (0 or 1), distance, position xyz, value, gradient xyz,
 * colour rgb, the leaf's ordinal. All 0 but the leaf, -1, where it misses.
 */
enum ray_column {
	RAY_HIT = 0,
	RAY_DISTANCE = 1,
	RAY_POSITION = 2,
	RAY_VALUE = 5,
	RAY_GRADIENT = 6,
	RAY_COLOR = 9,
	RAY_LEAF = 12,
	RAY_COLUMNS = 13
};

/*
 * {"count", "hit", "distance", "position", "value", "gradient", "normal",
 * "color", "node"}: count rows (RAY_COLUMNS each, finite) as a malloc'd string
 * of *length bytes without a NUL. Where a ray misses, all but hit is null.
 * nodes: a JSON pointer a ray, NULL for null. is_flat: vectors are not nested.
 * ERR_MEMORY.
 */
enum err raycast_answer_json(const float *rows, size_t count,
    const char *const *nodes, bool is_flat, char **out, size_t *length);

/* {"count", "converged", "position", "distance", "value", "normal"} of rows of
 * PROJECTION_FLOATS (core/project.h), likewise. */
enum err project_answer_json(const float *rows, size_t count, bool is_flat,
    char **out, size_t *length);

/* The header of an npy 1.0 file of shape (height, width), or (height, width,
 * columns) where columns > 1, '<f4', C order, to out; returns its length. */
#define SLICE_NPY_HEADER_MAX 128
size_t slice_npy_header(size_t height, size_t width, int columns,
    char out[static SLICE_NPY_HEADER_MAX]);

#endif
