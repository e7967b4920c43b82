/*
 * Points onto the level set f = iso, along the gradient.
 */
#ifndef CORE_PROJECT_H
#define CORE_PROJECT_H

#include <stdbool.h>
#include <stddef.h>

#include "core/err.h"
#include "core/sampler.h"

struct projection {
	bool converged;
	float position[3];
	float distance;   /* from the point, positive where f < iso there */
	float value;      /* f at position */
	float normal[3];  /* unit, outward; 0 where there is none */
};

/* Floats of a projection in a row of numbers: converged (0 or 1), position,
 * distance, value, normal. */
#define PROJECTION_FLOATS 9

/*
 * Projects count points (xyz): Newton's steps along the gradient, each no
 * longer than half of what is left of max_distance (world units, may be
 * infinite), halved while they do not bring f nearer to iso, bracketed once f - iso has
 * changed its sign. Converged: |f - iso| <= 1e-5 + 1e-5 iso, or as near as
 * float32 has it. A point where f has no gradient stays. Stage "points".
 * ERR_CANCELLED, ERR_MEMORY, or what sampling ends with.
 *
 * Below iso the steps are those for the cube root of f: fields fall off as the
 * third power of the distance to the rim of their support or faster, so that
 * Newton's own steps for f would be without bound there.
 */
enum err project(double iso, double max_distance, const float *points,
    size_t count, struct sampler *sampler, struct projection *out);

#endif
