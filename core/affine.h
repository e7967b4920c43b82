/*
 * Affine maps of space, x -> A x + t, in float64.
 */
#ifndef CORE_AFFINE_H
#define CORE_AFFINE_H

#include <stdbool.h>

#include "core/sym3.h"
#include "core/vec3.h"

struct affine {
	double a[3][3]; /* linear part, a[row][column] */
	double t[3];    /* translation */
};

/* The identity. */
struct affine affine_identity(void);

/*
 * glTF's T R S: first the scale s (each component non-zero), then the rotation
 * by the unit quaternion q (x y z w), then the translation t. A q off its unit
 * length, but not null, gives the rotation of q/|q|.
 */
struct affine affine_from_trs(const double t[static 3],
    const double q[static 4], const double s[static 3]);

/* x -> outer(inner(x)) */
struct affine affine_compose(const struct affine *outer,
    const struct affine *inner);

/*
 * The inverse of m into *out. False, and *out untouched, if m's linear part is
 * singular: |det| under 1e-12 times the product of its column norms, or any
 * number in the result is not finite.
 */
bool affine_invert(const struct affine *m, struct affine *out);

/* A p + t */
struct vec3 affine_point(const struct affine *m, struct vec3 p);

/*
 * The derivatives of f(p) = h(A p + t) from those of h: A^T g and A^T H A.
 */
struct vec3 affine_pull_gradient(const double a[static 3][3], struct vec3 g);
struct sym3 affine_pull_hessian(const double a[static 3][3], struct sym3 h);

/*
 * The least and the largest singular value of m's linear part, to about 1e-12:
 * exact enough that nested rotations stay 1. *least is 0 if m is singular; NaN
 * or infinity where a square overflows.
 */
void affine_stretch(const struct affine *m, double *least, double *most);

#endif
