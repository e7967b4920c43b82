/*
 * Functions of one variable, sampled at regular nodes for a device: openings
 * over the cosine of the angle, and the curves of operator tables. CURVE_NODE
 * is for OpenCL C too.
 */
#ifndef CORE_CURVE_H
#define CORE_CURVE_H

/* Floats of a node: value, first and second derivative, 0. */
#define CURVE_NODE 4

#ifndef __OPENCL_C_VERSION__

/* The cubic on [0, 1] with values a, b and slopes a1, b1 at its ends. */
static inline double curve_hermite(double a, double b, double a1, double b1,
    double x)
{
	double rise = b - a, s = 1.0 - x;

	return a + x * (rise + s * (s * (a1 - rise) - x * (b1 - rise)));
}

/*
 * What a device's lookup gives, in float64 arithmetic on the float32 samples:
 * value and two derivatives at x in [0, 1], clamped, of a function sampled at
 * count >= 2 nodes over an interval of the given length. The value is the cubic
 * through both nodes' values and slopes; the slope, the cubic through their
 * slopes and second derivatives rather than the first cubic's own, which would
 * magnify the samples' rounding by count; the second derivative is linear.
 */
void curve_lookup(const float *nodes, int count, double length, double x,
    double out[static 3]);

#endif

#endif
