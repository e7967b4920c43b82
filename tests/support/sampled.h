/*
 * Volumes made of functions, for tests.
 */
#ifndef TESTS_SUPPORT_SAMPLED_H
#define TESTS_SUPPORT_SAMPLED_H

#include <stdbool.h>
#include <stddef.h>

#include "core/jet.h"

struct volume;

/* A field of space with its derivatives. */
typedef void sampled_field(struct vec3 x, struct jet *out);

/* b(x) b(y) b(z), b(x) = (1 - x^2)^6 in [-1, 1], else 0. */
sampled_field sampled_bump;

/* The distance to a sphere of radius 0.6 about 0. Not at 0. */
sampled_field sampled_sphere;

/* f on counts samples over the box from min to max; for volume_release. */
struct volume *sampled_volume(sampled_field *f, const size_t count[static 3],
    struct vec3 min, struct vec3 max, bool is_distance);

/* n^3 samples over [-1, 1]^3. */
struct volume *sampled_cube(sampled_field *f, size_t n, bool is_distance);

#endif
