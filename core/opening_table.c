#include "core/opening_table.h"

#include <assert.h>
#include <math.h>
#include <stddef.h>

#include "core/curve.h"

#define QUARTER_PI 0.78539816339744830962

void opening_table_build(const struct opening *opening, int count, float *out)
{
	struct opening_jet jet;

	assert(count >= 2);
	for (int i = 0; i < count; i++) {
		float *node = out + (size_t)i * CURVE_NODE;

		opening_eval(opening, 2.0 * i / (count - 1) - 1.0, &jet);
		node[0] = (float)jet.theta;
		node[1] = (float)jet.slope;
		node[2] = (float)jet.bend;
		node[3] = 0.0f;
	}
}

void opening_table_lookup(const float *table, int count, double cosine,
    struct opening_jet *out)
{
	double at[3];

	curve_lookup(table, count, 2.0, 0.5 * (cosine + 1.0), at);
	/* Between nodes on either side of a steep rise the cubic overshoots. */
	*out = (struct opening_jet){fmin(fmax(at[0], 0.0), QUARTER_PI), at[1],
	    at[2]};
}
