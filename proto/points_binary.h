/*
 * Raw and npy batches, as they arrive or whole. Internal to points*.c and
 * eval_stream.c.
 */
#ifndef PROTO_POINTS_BINARY_H
#define PROTO_POINTS_BINARY_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#include "core/err.h"
#include "proto/fault.h"
#include "proto/points.h"

struct npy;

/* Numbers arriving; points_arrival_init, points_arrival_fini. */
struct points_arrival {
	bool is_double;
	bool is_refused;        /* for their number: only counted */
	size_t expected;        /* numbers, if known, else 0 */
	size_t most;            /* numbers that are taken */
	size_t length;          /* bytes that arrived */
	unsigned char part[8];  /* the last of them, no whole number yet */
	size_t part_length;
	float *xyz;
	size_t count, room;     /* numbers */
	bool is_wrong;          /* one was not finite; xyz is NULL, room 0 */
	struct faults *faults;  /* tell which */
};

/* faults is kept, not copied. */
void points_arrival_init(struct points_arrival *a, bool is_double,
    size_t max_points, size_t expected_points, struct faults *faults);
void points_arrival_fini(struct points_arrival *a);

/* Takes the next bytes. ERR_MEMORY. */
enum err points_arrival_feed(struct points_arrival *a, const void *data,
    size_t length);

/* All that came are points; moves them to *out. ERR_INVALID: one is not finite
 * as float32, and faults were added for it. */
enum err points_arrival_finish(struct points_arrival *a, struct points *out);

/* count points of little-endian float32, or float64, to *out. ERR_INVALID: one
 * is not finite as float32; ERR_MEMORY. */
enum err points_load(const unsigned char *data, size_t count, bool is_double,
    struct points *out, struct faults *faults);

/* Adds the fault; ERR_LIMIT. */
enum err points_too_many(size_t max_points, struct faults *faults);

/* Whether length bytes are points of float32, and no more than allowed. */
enum err points_octets_check(size_t length, size_t max_points,
    struct faults *faults);

/* What an npy file's header says, and then how much follows it: the errors of
 * points_from_npy. */
enum err points_npy_check(const struct npy *npy, size_t max_points,
    struct faults *faults);
enum err points_npy_check_length(const struct npy *npy, size_t length,
    struct faults *faults);

/*
 * Bytes of an npy file's header, with all before it, as the first of them say;
 * SIZE_MAX: they do not say yet; 0: it is no such file.
 */
size_t points_npy_header(const unsigned char *data, size_t length);

#endif
