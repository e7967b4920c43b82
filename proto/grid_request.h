/*
 * Bodies of evaluations on a regular grid, and the grid's points.
 */
#ifndef PROTO_GRID_REQUEST_H
#define PROTO_GRID_REQUEST_H

#include <stddef.h>

#include "core/err.h"
#include "core/vec3.h"
#include "proto/points.h"

struct faults;

/* Along an axis. */
#define GRID_COUNT_MAX 4096

struct grid_request {
	struct vec3 min, max; /* the first and the last point; min <= max */
	size_t counts[3];     /* along x, y, z: 1 to GRID_COUNT_MAX */
	unsigned outputs;     /* OUTPUT_* */
};

/*
 * Parses {"min": [x,y,z], "max": [x,y,z], "counts": [nx,ny,nz], "outputs":
 * [...]}; "outputs" may be missing, for default_outputs. text need not end in
 * NUL. ERR_SYNTAX, ERR_INVALID and, at /counts, ERR_LIMIT: more than max_points
 * in all, fill faults; ERR_MEMORY.
 */
enum err grid_request_parse(const char *text, size_t length,
    unsigned default_outputs, size_t max_points, struct grid_request *out,
    struct faults *faults);

/*
 * The grid's points into *out (start with {0}; points_fini), flat, those along
 * z next to each other, then y: point (i, j, k) is at index (i ny + j) nz + k,
 * and at min + (max - min) i / (nx - 1), and so on, as double, rounded to
 * float32; the last is max itself, the only one of a count of 1 is min.
 * ERR_MEMORY.
 */
enum err grid_request_points(const struct grid_request *request,
    struct points *out);

#endif
