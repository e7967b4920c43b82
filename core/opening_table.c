#include "core/opening_table.h"

#include <assert.h>
#include <stddef.h>

#include "core/curve.h"

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
	*out = (struct opening_jet){at[0], at[1], at[2]};
}
