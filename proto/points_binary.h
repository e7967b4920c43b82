/*
 * What raw and npy batches share. Internal to points*.c.
 */
#ifndef PROTO_POINTS_BINARY_H
#define PROTO_POINTS_BINARY_H

#include <stdbool.h>
#include <stddef.h>

#include "core/err.h"

struct faults;
struct points;

/* count points of little-endian float32, or float64, to *out. ERR_INVALID: one
 * is not finite as float32; ERR_MEMORY. */
enum err points_load(const unsigned char *data, size_t count, bool is_double,
    struct points *out, struct faults *faults);

/* Adds the fault; ERR_LIMIT. */
enum err points_too_many(size_t max_points, struct faults *faults);

#endif
