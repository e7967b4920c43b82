/*
 * Where values of a field come from, for what walks over it: meshes, rays,
 * pictures. The daemon's samplers ask its device, tests' the float64 evaluator.
 */
#ifndef CORE_SAMPLER_H
#define CORE_SAMPLER_H

#include <stdbool.h>
#include <stddef.h>

#include "core/err.h"

struct sampler {
	/*
	 * Fills rows with output_row_floats(outputs) floats (core/output.h) for
	 * each of count points (xyz, finite, world units). The same point gives
	 * the same values, bit for bit, whatever batch it comes in. ERR_CANCELLED:
	 * nobody waits any more; or what an evaluation ends with.
	 */
	enum err (*sample)(struct sampler *s, const float *points, size_t count,
	    unsigned outputs, float *rows);
	/*
	 * Told what is being done ("cells", "rays": one word) and how much of
	 * all of it is (0 to 1); false: give up with ERR_CANCELLED. Cheap: may
	 * be called every millisecond. NULL: nobody asks.
	 */
	bool (*go_on)(struct sampler *s, const char *stage, double done);
};

/* go_on, or true where there is none. */
static inline bool sampler_goes_on(struct sampler *s, const char *stage,
    double done)
{
	return s->go_on == NULL || s->go_on(s, stage, done);
}

#endif
