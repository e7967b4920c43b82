#include "core/curve.h"

#include <math.h>
#include <stddef.h>

void curve_lookup(const float *nodes, int count, double length, double x,
    double out[static 3])
{
	double at = fmin(fmax(x, 0.0), 1.0) * (count - 1);
	double step = length / (count - 1);
	int i = (int)fmin(at, count - 2);
	const float *a = nodes + (size_t)i * CURVE_NODE, *b = a + CURVE_NODE;
	double t = at - i;

	out[0] = curve_hermite(a[0], b[0], step * a[1], step * b[1], t);
	out[1] = curve_hermite(a[1], b[1], step * a[2], step * b[2], t);
	out[2] = a[2] + t * (b[2] - a[2]);
}
