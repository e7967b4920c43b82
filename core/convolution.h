/*
 * Convolution surfaces with the Cauchy kernel h(d) = (1 + s^2 d^2)^-2: the
 * field of a point, a segment and a triangle (McCormack and Sherstyuk, Creating
 * and Rendering Convolution Surfaces, Computer Graphics Forum 17(2), 1998;
 * SPEC section 2). Compiles as C11 and, for the constants, as OpenCL C.
 */
#ifndef CORE_CONVOLUTION_H
#define CORE_CONVOLUTION_H

/*
 * Parameters on a tape. Lengths and coordinates of an element are in units of
 * the kernel's width 1/s, and `scale` is weight / (2 F0), F0 = pi / (2 s (1 +
 * s^2 r^2)^(3/2)) the integral along an endless line at distance r, times the
 * unit of what is integrated over (1/s, or 1/s^2).
 * OP_CAUCHY_POINT: a[3], s, scale
 * OP_CAUCHY_SEGMENT: a[3], s, scale, u[3], length
 * OP_CAUCHY_TRIANGLE: a[3], s, scale, u[3], v[3], base, foot, height: its
 * longest side is base long, from a along u; the third corner is at foot u +
 * height v from a, with u and v of length 1 and at right angles
 */
#define CAUCHY_TRIANGLE_PARAMS 14

/* Further than this from an element's a, in its unit, a point is drawn in. */
#define CAUCHY_REACH 4e18f

/* A triangle is summed, and not integrated in closed form, while it is at most
 * this times as high as far, with 1 for the kernel's width among the far. */
#define CAUCHY_THIN 0.15f

/* From this distance on, in units of sqrt(1 + h^2) at height h above a
 * triangle's plane, its integral is that over what lies behind each side. */
#define CAUCHY_BEYOND 1.25f

#ifndef __OPENCL_C_VERSION__

#include "core/jet.h"
#include "core/opcode.h"

struct primitive;

/* The default s: the kernel for which F0 s = pi/4. */
double cauchy_default_s(double radius);

/*
 * Writes the parameters of a PRIMITIVE_CAUCHY_* (s, radius[0] > 0) to params;
 * returns how many. `scale` is held under what would bring values, or second
 * derivatives, over 1e32, so that float32 holds them.
 */
int cauchy_prepare(const struct primitive *p, double *params);

/*
 * The field of one element at x (within POINT_REACH), with derivatives up to
 * order. Every number is finite. Degenerate elements have their limits: a
 * segment without length and a triangle without area are 0 (their integrals).
 * Far away values go to 0 as they should; derivatives may reach it sooner.
 */
void cauchy_eval(OPCODE_UINT op, const double *params, struct vec3 x,
    int order, struct jet *out);

#endif

#endif
