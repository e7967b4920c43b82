/*
 * Warps: global deformations of space along an axis (Barr 1984, "Global and
 * local deformations of solid primitives"). A warp node's field is its child's
 * at W(p), W the inverse of Barr's deformation. Compiles as C11 and, for the
 * types and counts, as OpenCL C.
 */
#ifndef CORE_WARP_H
#define CORE_WARP_H

/* Values of an instruction's index. */
#define WARP_TWIST 0u
#define WARP_TAPER 1u
#define WARP_BEND 2u
#define WARP_TYPE_COUNT 3u

/*
 * Parameters that every warp has on a tape, those it does not need 0. With
 * L = to - from, u the unit axis, e1 a unit vector across it (bend: the part
 * of direction across the axis):
 * all:   o[3], u[3], e1[3]; o is center + from u (twist without a range:
 *        center; bend: center + (from + L/2) u)
 * twist: rate, L (0: endless), 0; its angle is p[11] + p[9] s(z)
 * taper: (scale - 1)/L, L, 1; its divisor is p[11] + p[9] s(z)
 * bend:  rate, L/2, cos h, sin h, sin(h)/rate, (1 - cos h)/rate, h = rate L/2
 */
#define WARP_PARAMS_MAX 16

/* The width of a rounded end over the range's length. */
#define WARP_ROUNDED 0.25f

#ifndef __OPENCL_C_VERSION__

#include <stdbool.h>

#include "core/sym3.h"
#include "core/vec3.h"

/*
 * A warp as a document writes it, in the warp node's own frame. z stands for
 * the coordinate along axis, 0 at center.
 *
 * The range [from, to] is where the deformation acts. A twist turns by rate
 * (z - from), or without a range by rate z; a taper scales the cross-section
 * from 1 to scale; a bend turns the axis itself, which is an arc of radius
 * 1/|rate| there. Below `from` nothing changes; beyond `to` space moves rigidly
 * (twist), is scaled evenly (taper), or goes on straight (bend). The change is
 * spread over a quarter of the range's length about either end (bend: in the
 * angle about the arc's centre), so that W is C2 and a gradient continuous, and
 * also one that needs its operands' second derivatives; elsewhere W is Barr's.
 *
 * A bend has one inverse only where the child keeps within 1/|rate| of the axis
 * on the inner side, and its straight ends do not pass the opposite of the
 * arc's middle, seen from the centre: the half-plane there is a cut, on whose
 * sides W differs, so that a child that reaches it is cut off. About the centre
 * derivatives are held as core/warp.c says.
 */
struct warp {
	unsigned type;      /* WARP_TWIST ... */
	struct vec3 axis;   /* not null */
	struct vec3 center;
	/* bend: towards where the axis bends; not parallel to axis */
	struct vec3 direction;
	double rate;        /* twist, bend: radians per length; either sign;
	                     * bend: |rate (to - from)| <= 2 pi */
	bool has_range;     /* twist: else endless. Others always have one. */
	double from, to;    /* along z; from < to */
	double scale;       /* taper: of the cross-section at `to`, 1 at `from`;
	                     * > 0 */
};

/* W at a point: its value, derivatives and second derivatives. */
struct warp_jet {
	struct vec3 point;
	double jacobian[3][3];  /* [i][j]: dW_i/dx_j */
	struct sym3 second[3];  /* second derivatives of W_i */
};

/* w's parameters on a tape, WARP_PARAMS_MAX of them. w has been checked. */
void warp_prepare(const struct warp *w, double params[static WARP_PARAMS_MAX]);

/* W(x), and to order 1 and 2 its derivatives; those beyond are 0. Every number
 * is finite for every finite x. */
void warp_eval(unsigned type, const double *params, struct vec3 x, int order,
    struct warp_jet *out);

/*
 * The stretch of W within its range, for sizes: the least and the largest
 * factor by which it may change a length near the axis (taper: 1/scale; others
 * 1). Greater than 0.
 */
void warp_stretch(const struct warp *w, double *least, double *most);

#endif

#endif
