/*
 * Rays against the level set f = iso of a tape: the first place where f crosses
 * iso, from either side. Conservative: boxes along the ray whose range
 * (core/range.h) does not hold iso are passed over, all others halved down to
 * tolerance, so that what a ray is inside of (or outside of) for longer than
 * tolerance is not missed; nothing is reported but sign changes of the sampler's
 * values. Of blends whose opening depends on the angle the slopes that decide
 * this leave out how fast the angle changes, and are widened by what the samples
 * show (core/raycast.c): there it is no proof.
 */
#ifndef CORE_RAYCAST_H
#define CORE_RAYCAST_H

#include <stdbool.h>
#include <stddef.h>

#include "core/err.h"
#include "core/sampler.h"

struct range_tape;
struct tape_box;

/* Floats of a ray: origin xyz, direction xyz (any length but 0). */
#define RAY_FLOATS 6

struct raycast_options {
	double iso;
	double tolerance;     /* world units, > 0 */
	double max_distance;  /* world units; may be infinite */
	const struct tape_box *extent; /* of the surface, range_extent's: nothing
	                       * outside of it is looked at; infinite
	                       * coordinates are cut at RAYCAST_REACH */
};

/* How far is looked at all where extent has no end: coordinates so many times
 * the largest finite one (1 at least) of extent and that ray's origin. */
#define RAYCAST_REACH 1e3

struct ray_hit {
	bool hit;
	float distance;    /* from the origin, world units; 0 without a hit */
	float position[3]; /* where |f - iso| is as small as float32 has it */
};

/*
 * Casts rays of one model batch by batch, and keeps what it learns of it, in at
 * most 128 MiB and what it takes for the rays that are on their way (20 MiB).
 * What a ray meets does not depend on others, nor on how they are put in
 * batches. One thread at a time.
 */
struct raycaster;

/* tape must outlive it; options' extent is copied. *out is the caller's.
 * ERR_MEMORY. */
enum err raycaster_create(const struct range_tape *tape,
    const struct raycast_options *options, struct raycaster **out);

/* Frees c; NULL does nothing. */
void raycaster_free(struct raycaster *c);

/*
 * count rays (RAY_FLOATS each, finite) to hits[count]. Tells sampler how it goes
 * as stage "rays". ERR_CANCELLED, ERR_MEMORY, or what sampling ends with; then
 * it may go on with other rays.
 */
enum err raycaster_run(struct raycaster *c, const float *rays, size_t count,
    struct sampler *sampler, struct ray_hit *hits);

/* The same with a raycaster of its own. */
enum err raycast(const struct range_tape *tape,
    const struct raycast_options *options, const float *rays, size_t count,
    struct sampler *sampler, struct ray_hit *hits);

#endif
