/*
 * Symmetric 3x3 matrices (Hessians) by value, and the products the evaluator
 * needs. Component order is that of the wire: xx yy zz xy xz yz.
 */
#ifndef CORE_SYM3_H
#define CORE_SYM3_H

#include "core/vec3.h"

struct sym3 {
	double xx, yy, zz, xy, xz, yz;
};

static inline struct sym3 sym3_scale(double s, struct sym3 a)
{
	return (struct sym3){s * a.xx, s * a.yy, s * a.zz, s * a.xy, s * a.xz,
	    s * a.yz};
}

/* a + s b */
static inline struct sym3 sym3_axpy(double s, struct sym3 b, struct sym3 a)
{
	return (struct sym3){a.xx + s * b.xx, a.yy + s * b.yy, a.zz + s * b.zz,
	    a.xy + s * b.xy, a.xz + s * b.xz, a.yz + s * b.yz};
}

/* The identity times s. */
static inline struct sym3 sym3_identity(double s)
{
	return (struct sym3){s, s, s, 0.0, 0.0, 0.0};
}

/* u u^T */
static inline struct sym3 sym3_square(struct vec3 u)
{
	return (struct sym3){u.x * u.x, u.y * u.y, u.z * u.z, u.x * u.y,
	    u.x * u.z, u.y * u.z};
}

/* u v^T + v u^T */
static inline struct sym3 sym3_product(struct vec3 u, struct vec3 v)
{
	return (struct sym3){2.0 * u.x * v.x, 2.0 * u.y * v.y, 2.0 * u.z * v.z,
	    u.x * v.y + u.y * v.x, u.x * v.z + u.z * v.x,
	    u.y * v.z + u.z * v.y};
}

static inline struct vec3 sym3_apply(struct sym3 a, struct vec3 u)
{
	return vec3(a.xx * u.x + a.xy * u.y + a.xz * u.z,
	    a.xy * u.x + a.yy * u.y + a.yz * u.z,
	    a.xz * u.x + a.yz * u.y + a.zz * u.z);
}

#endif
