/*
 * The tape's instruction set: opcodes, instruction layout and the order of
 * each opcode's parameters. Compiles as C11 and as OpenCL C; the float64
 * evaluator and the device's interpreter walk the same instructions.
 *
 * A tape is a postfix program over a stack of jets. FRAME sets the point that
 * following primitives see, to A b + t of the base point b: the request's
 * point, or within a warp the warped one (never the previous frame's). ENTER
 * pushes a new base, W(A b + t) of the present one with W the warp; LEAVE, with
 * the same parameters, pops it and carries the top jet through W; both leave
 * the frame's point to be set anew. COLOR sets the colour that following
 * primitives have. Every primitive pushes one jet. CARRY rewrites the top jet
 * from a node's own frame to its parent's. Every composition pops two jets and
 * pushes one. Parameters are a flat array of numbers, float64 on the host and
 * float32 on the device.
 */
#ifndef CORE_OPCODE_H
#define CORE_OPCODE_H

#ifdef __OPENCL_C_VERSION__
#define OPCODE_UINT uint
#else
#include <assert.h>
#include <stdint.h>
#define OPCODE_UINT uint32_t
#endif

/*
 * Opcodes, with their parameters in order. "inv_r2" is 1/R^2 with R the radius
 * of the support; "inv_fall" is 1/falloff; u is a unit vector.
 */
#define OP_FRAME 0        /* a[9] row-major, t[3] */
#define OP_CARRY 1        /* a[9] row-major: the linear part of M^-1 */
#define OP_COLOR 2        /* rgb[3], linear */
#define OP_ENTER 3        /* a[9], t[3], warp_prepare's; index: WARP_TWIST ... */
#define OP_LEAVE 4        /* the parameters and index of its OP_ENTER */
/* soft objects: f = weight (1 - d^2/R^2)^n */
#define OP_POINT 5        /* c[3], inv_r2, n, weight; index: 0, or the count of
                           * pairs in a row from here on: of a point of n 3
                           * that OP_SUM follows in the whole tape, and that
                           * OP_SUM. Pruned lists have the same pairs, but for
                           * those of which a part is dropped, so that a pair
                           * may be rounded once where it is one (fused): a
                           * point whose OP_SUM is dropped is added to 0,
                           * which rounds alike, and so has index 0 */
#define OP_SEGMENT 6      /* a[3], u[3], length, Ra, (Rb-Ra)/length, n, weight */
#define OP_TRIANGLE 7     /* a[3], b[3], c[3], inv_r2, n, weight */
#define OP_DISC 8         /* c[3], u[3], disc_radius, inv_r2, n, weight */
#define OP_CIRCLE 9       /* c[3], u[3], ring_radius, inv_r2, n, weight */
/* solids: f = falloff polynomial of the exact signed distance */
#define OP_SPHERE 10      /* c[3], radius, inv_fall */
#define OP_BOX 11         /* c[3], half_size-rounding [3], rounding, inv_fall */
#define OP_CYLINDER 12    /* c[3] (middle), u[3], half_length, radius, inv_fall */
#define OP_CAPSULE 13     /* a[3], u[3], length, radius, inv_fall */
#define OP_CONE 14        /* a[3], u[3], length, ra, rb, inv_fall */
#define OP_TORUS 15       /* c[3], u[3], major, minor, inv_fall */
#define OP_PLANE 16       /* p[3], u[3] (outward), inv_fall */
/* convolutions with the Cauchy kernel: core/convolution.h */
#define OP_CAUCHY_POINT 17
#define OP_CAUCHY_SEGMENT 18
#define OP_CAUCHY_TRIANGLE 19
/* a sampled field: core/volume.h */
#define OP_VOLUME 20      /* min[3], inv_spacing[3], count[3], inv_fall or 0;
                           * index: which of the tape's volumes */
/* 0 everywhere, without parameters: what core/prune.h leaves of an operand */
#define OP_ZERO 21
/* compositions; "first" is the jet pushed first unless the name says SWAPPED */
#define OP_MAX 22         /* sharp union */
#define OP_MIN 23         /* sharp intersection */
#define OP_MINUS 24       /* sharp difference: min(first, max(0, 1 - second)) */
#define OP_MINUS_SWAPPED 25
#define OP_SUM 26
#define OP_RICCI 27       /* n; (f1^n + f2^n)^(1/n) */
/* operators without angles, core/classic.h: classic_prepare's parameters;
 * index: CLASSIC_SUPER_ELLIPTIC ... */
#define OP_CLASSIC 28
#define OP_CLASSIC_SWAPPED 29
#define OP_UNION 30       /* null_gradient; index: operator */
#define OP_INTERSECTION 31
#define OP_DIFFERENCE 32  /* intersection(first, max(0, 1 - second)) */
#define OP_DIFFERENCE_SWAPPED 33
#define OP_COUNT 34

/* Instructions before this one push no jet, those before OP_MAX push one. */
#define OP_PRIMITIVES OP_POINT

/*
 * The most jets a tape may need at once. tape_compile evaluates the deeper of
 * two operands first, so that this suffices for 2^(TAPE_STACK_MAX-1) leaves.
 */
#define TAPE_STACK_MAX 16

/* The most warps within each other. */
#define TAPE_WARPS_MAX 8

/*
 * A point further than this from the origin of its frame (largest coordinate)
 * is drawn in along its ray, so that no square overflows float32: beyond the
 * reach of every bounded field that lies within TREE_COORDINATE_MAX of that
 * origin, and on the same side of every plane there.
 */
#define POINT_REACH 1e12f

/* rho is held above this times the ring's radius on a ring's or solid's axis,
 * where 1/rho appears in the Hessian. */
#define AXIS_GUARD 1e-6f

struct insn {
	OPCODE_UINT op;    /* OP_* */
	OPCODE_UINT extra; /* derivative orders needed beyond the root's: the
	                    * angle-dependent compositions above, at most 2 */
	OPCODE_UINT param; /* first parameter's index */
	OPCODE_UINT index; /* OP_UNION ...: which operator of the tape; as said
	                    * above for others; else 0 */
};

#ifndef __OPENCL_C_VERSION__
static_assert(sizeof(struct insn) == 16, "struct insn is shared with the device");
#endif

#endif
