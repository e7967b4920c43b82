/*
 * What an evaluation delivers, and how a row of it is laid out.
 */
#ifndef CORE_OUTPUT_H
#define CORE_OUTPUT_H

/* Bits of a mask, at least one of which is set. A row holds them in the order
 * value, gradient xyz, hessian xx yy zz xy xz yz, color rgb (linear; by the
 * rule of evaluate_color), normal xyz (unit, outward, or 0 0 0), curvature mean
 * and Gaussian (core/surface.h). */
#define OUTPUT_VALUE 1u
#define OUTPUT_GRADIENT 2u
#define OUTPUT_HESSIAN 4u
#define OUTPUT_COLOR 8u
#define OUTPUT_NORMAL 16u
#define OUTPUT_CURVATURE 32u
#define OUTPUT_ALL 63u

#define OUTPUT_ROW_MAX 18

/* Floats a point has in a row: 1 + 3 + 6 + 3 + 3 + 2. */
static inline int output_row_floats(unsigned outputs)
{
	return (outputs & OUTPUT_VALUE ? 1 : 0) +
	    (outputs & OUTPUT_GRADIENT ? 3 : 0) +
	    (outputs & OUTPUT_HESSIAN ? 6 : 0) +
	    (outputs & OUTPUT_COLOR ? 3 : 0) +
	    (outputs & OUTPUT_NORMAL ? 3 : 0) +
	    (outputs & OUTPUT_CURVATURE ? 2 : 0);
}

/* The derivative order these outputs ask of the root. */
static inline int output_order(unsigned outputs)
{
	if (outputs & (OUTPUT_HESSIAN | OUTPUT_CURVATURE))
		return 2;
	return outputs & (OUTPUT_GRADIENT | OUTPUT_NORMAL) ? 1 : 0;
}

#endif
