/*
 * The tape's instruction set: opcodes, instruction layout and the order of
 * each opcode's parameters. Compiles as C11 and as OpenCL C; the float64
 * evaluator and the device's interpreter walk the same instructions.
 *
 * A tape is a postfix program over a stack of jets. FRAME sets the point that
 * following primitives see, to A x + t of the request's point x (never of the
 * previous frame's). Every primitive pushes one jet. CARRY rewrites the top
 * jet from a node's own frame to its parent's. Every composition pops two jets
 * and pushes one. Parameters are a flat array of numbers, float64 on the host
 * and float32 on the device.
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
/* soft objects: f = weight (1 - d^2/R^2)^n */
#define OP_POINT 2        /* c[3], inv_r2, n, weight */
#define OP_SEGMENT 3      /* a[3], u[3], length, Ra, (Rb-Ra)/length, n, weight */
#define OP_TRIANGLE 4     /* a[3], b[3], c[3], inv_r2, n, weight */
#define OP_DISC 5         /* c[3], u[3], disc_radius, inv_r2, n, weight */
#define OP_CIRCLE 6       /* c[3], u[3], ring_radius, inv_r2, n, weight */
/* solids: f = falloff polynomial of the exact signed distance */
#define OP_SPHERE 7       /* c[3], radius, inv_fall */
#define OP_BOX 8          /* c[3], half_size-rounding [3], rounding, inv_fall */
#define OP_CYLINDER 9     /* c[3] (middle), u[3], half_length, radius, inv_fall */
#define OP_CAPSULE 10     /* a[3], u[3], length, radius, inv_fall */
#define OP_CONE 11        /* a[3], u[3], length, ra, rb, inv_fall */
#define OP_TORUS 12       /* c[3], u[3], major, minor, inv_fall */
#define OP_PLANE 13       /* p[3], u[3] (outward), inv_fall */
/* compositions; "first" is the jet pushed first unless the name says SWAPPED */
#define OP_MAX 14         /* sharp union */
#define OP_MIN 15         /* sharp intersection */
#define OP_MINUS 16       /* sharp difference: min(first, max(0, 1 - second)) */
#define OP_MINUS_SWAPPED 17
#define OP_SUM 18
#define OP_RICCI 19       /* n; (f1^n + f2^n)^(1/n) */
#define OP_UNION 20       /* null_gradient; index: operator */
#define OP_INTERSECTION 21
#define OP_DIFFERENCE 22  /* intersection(first, max(0, 1 - second)) */
#define OP_DIFFERENCE_SWAPPED 23
#define OP_COUNT 24

/*
 * The most jets a tape may need at once. tape_compile evaluates the deeper of
 * two operands first, so that this suffices for 2^(TAPE_STACK_MAX-1) leaves.
 */
#define TAPE_STACK_MAX 16

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
	OPCODE_UINT index; /* OP_UNION ...: which operator of the tape; else 0 */
};

#ifndef __OPENCL_C_VERSION__
static_assert(sizeof(struct insn) == 16, "struct insn is shared with the device");
#endif

#endif
