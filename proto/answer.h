/*
 * Answers out (SPEC section 3, "Answers"): rows of float32 as JSON or npy, and
 * problem details.
 */
#ifndef PROTO_ANSWER_H
#define PROTO_ANSWER_H

#include <stdbool.h>
#include <stddef.h>

#include "core/err.h"

struct faults;

/* Of answer_json. */
enum answer_flag {
	ANSWER_FLAT = 1, /* vectors are not nested */
	ANSWER_DRAFT = 2 /* "draft": true, behind the count */
};

/*
 * {"count": N, "value": [...], "gradient": [[x,y,z], ...], "hessian": [...]}:
 * rows of output_row_floats(outputs) floats, all finite (NULL if there are
 * none), as a malloc'd string of *length bytes without a NUL. flags:
 * ANSWER_*. Numbers are the shortest decimal that reads
 * back as the same float32. ERR_MEMORY.
 */
enum err answer_json(const float *rows, size_t count, unsigned outputs,
    unsigned flags, char **out, size_t *length);

/* The same for a regular grid of counts[0] * counts[1] * counts[2] rows, the
 * last axis fastest: "counts": [nx,ny,nz] stands before the arrays. */
enum err answer_grid_json(const float *rows, const size_t counts[static 3],
    unsigned outputs, unsigned flags, char **out, size_t *length);

/* The header of an npy 1.0 file of shape (count, columns), '<f4', C order, to
 * out; returns its length, a multiple of 64. */
#define ANSWER_NPY_HEADER_MAX 128
size_t answer_npy_header(size_t count, int columns,
    char out[static ANSWER_NPY_HEADER_MAX]);

/* The same of a grid, counts up to 10^8 each: shape (nx, ny, nz, columns), or
 * (nx, ny, nz) of one column. */
size_t answer_grid_npy_header(const size_t counts[static 3], int columns,
    char out[static ANSWER_NPY_HEADER_MAX]);

/*
 * application/problem+json (RFC 9457). slug is the last part of the type's
 * URI reference, "/problems/<slug>"; detail and faults may be NULL. Faults
 * become "errors", and "error_count" if there are more than were kept. A
 * malloc'd string, or NULL: out of memory.
 */
char *answer_problem(int status, const char *slug, const char *title,
    const char *detail, const struct faults *faults, size_t *length);

#endif
