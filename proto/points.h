/*
 * Batches of points in (SPEC section 3, "Points"): JSON, raw float32, npy.
 */
#ifndef PROTO_POINTS_H
#define PROTO_POINTS_H

#include <stdbool.h>
#include <stddef.h>

#include "core/err.h"

struct faults;
struct json_text;

/* A batch: xyz float32, all finite. Start with {0}; points_fini frees. */
struct points {
	float *xyz;    /* 3 * count, malloc'd; NULL if count is 0 */
	size_t count;
	bool flat;     /* JSON gave [x,y,z,x,...], so the answer is flat too */
};
void points_fini(struct points *points);

/*
 * Scans a JSON array of points, nested or flat, from *cursor (at '[', before
 * end) and leaves *cursor after its ']', or at what is wrong. prefix
 * ("/points") begins pointers, which name the element; details name the point.
 * ERR_SYNTAX: not JSON; ERR_INVALID: not points: not an array of triples, a
 * number that is not finite or overflows float32; ERR_LIMIT: more than
 * max_points; ERR_MEMORY. Each but the last adds a fault.
 */
enum err points_from_json(const char **cursor, const char *end,
    const char *prefix, size_t max_points, struct points *out,
    struct faults *faults);

/* The same within a longer text (proto/json.h), after white space; the lines
 * and columns that faults name count from its start. */
enum err points_read(struct json_text *text, const char *prefix,
    size_t max_points, struct points *out, struct faults *faults);

/*
 * Little-endian float32 xyz...; length a multiple of 12, else ERR_SYNTAX.
 * Otherwise the same errors; pointers are "".
 */
enum err points_from_octets(const void *data, size_t length,
    size_t max_points, struct points *out, struct faults *faults);

/*
 * NumPy .npy, format 1.0 to 3.0: (N,3), '<f4' or '<f8', C order. ERR_SYNTAX
 * when it is no npy file, or shorter or longer than it says; ERR_INVALID when
 * it holds something else. Otherwise the same errors; pointers are "".
 */
enum err points_from_npy(const void *data, size_t length, size_t max_points,
    struct points *out, struct faults *faults);

#endif
