/*
 * Sampled fields: a regular grid of samples, interpolated by a tensor product
 * of cubic B-splines (C2, fourth order; M. Unser, A. Aldroubi, M. Eden,
 * B-Spline Signal Processing: Part II, IEEE Trans. Signal Processing 41(2),
 * 1993), whose coefficients are found once. It goes through every sample.
 *
 * Fields (f >= 0): coefficients beyond the grid are 0, so the spline falls to 0
 * within two spacings outside the box, and its value is held at 0 or above.
 * Signed distances (negative inside): natural ends (second derivatives across
 * a face are 0 there); beyond the box the field is 0, and what is used with a
 * falloff must be at least that far from the surface on all of the box's faces.
 */
#ifndef CORE_VOLUME_H
#define CORE_VOLUME_H

#include <stdatomic.h>
#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#include "core/err.h"
#include "core/jet.h"

/* Samples along one axis, and of a volume: 512 MiB of float32. */
#define VOLUME_AXIS_MIN 4
#define VOLUME_AXIS_MAX 4096
#define VOLUME_SAMPLES_MAX ((size_t)1 << 27)

/* No sample may be larger, nor smaller than minus that. */
#define VOLUME_SAMPLE_MAX 1e9f

/* Immutable once made, but for refs. */
struct volume {
	atomic_size_t refs;
	uint64_t serial;       /* no two volumes of a process have the same */
	size_t count[3];       /* samples along x, y, z */
	struct vec3 min, max;  /* of the first and the last sample */
	bool is_distance;
	float *coefficients;   /* count[0]*count[1]*count[2], z fastest */
	double least_edge;     /* distances: nowhere on the box's faces is the
	                        * spline less; fields: 0 */
};

/*
 * A volume of one reference from samples (z fastest; finite, within
 * VOLUME_SAMPLE_MAX), which are not kept. min < max in each coordinate, count
 * within VOLUME_AXIS_* and VOLUME_SAMPLES_MAX. ERR_MEMORY.
 */
enum err volume_create(const float *samples, const size_t count[static 3],
    struct vec3 min, struct vec3 max, bool is_distance, struct volume **out);

struct volume *volume_hold(struct volume *v);

/* Gives up a reference; NULL does nothing. Any thread. */
void volume_release(struct volume *v);

/* The host's memory that v takes. */
size_t volume_bytes(const struct volume *v);

/* The least spacing of v's samples. */
double volume_spacing(const struct volume *v);

/* OP_VOLUME's parameters: how many. falloff: 0 for fields. */
int volume_prepare(const struct volume *v, double falloff, double *params);

/*
 * The field at x (within POINT_REACH) with derivatives up to order (0, 1, 2;
 * those beyond are 0); params as volume_prepare gives. Every number is finite.
 * Where a field's spline is below 0 its value and derivatives are 0.
 */
void volume_eval(const struct volume *v, const double *params, struct vec3 x,
    int order, struct jet *out);

#endif
