/*
 * Gradient-based composition operators, exact in float64: g(f1, f2, theta) of
 * the union and intersection families with first and second partial
 * derivatives (SPEC section 1; Gourmel et al. 2013, Eq. 17 to 24).
 */
#ifndef CORE_OPERATOR_H
#define CORE_OPERATOR_H

#include <stdbool.h>

#include "core/opening.h"
#include "core/profile.h"

enum operator_family {
	FAMILY_UNION,
	FAMILY_INTERSECTION, /* difference is this one with 1 - f2 */
	FAMILY_COUNT
};

enum table_layout {
	LAYOUT_WARPED,  /* the default: core/table.h */
	LAYOUT_UNIFORM, /* the paper's N^3 grid */
	LAYOUT_COUNT
};

/* What a document says of a composition: plain data, freely copied. */
struct operator {
	enum operator_family family;
	struct profile profile;
	struct opening opening;
	enum table_layout layout; /* of the device's table; the float64
	                           * evaluator has no table and ignores it */
	int resolution;           /* nodes an axis of that table */
	bool draft;               /* a coarser table may stand in for it while
	                           * it is not resident (proto/README.md) */
};

/* g and its partial derivatives; t stands for theta in radians. */
struct operator_jet {
	double g;
	double g1, g2, gt;
	double g11, g12, g22, g1t, g2t, gtt;
};

/*
 * g(f1, f2, theta) with derivatives to order (0, 1 or 2; those beyond are 0).
 * f1, f2 >= 0, also above 1; theta in [0, pi/4], clamped. g is accurate to
 * 1e-12; derivatives come from implicit differentiation at the root. Where
 * branches meet, or on the diagonal of a profile that folds, the derivatives
 * are those of one side (that of the larger f1 on the diagonal).
 */
void operator_eval(enum operator_family family, const struct profile *profile,
    double f1, double f2, double theta, int order, struct operator_jet *out);

/* "union" or "intersection". */
const char *operator_family_name(enum operator_family family);

/* "warped" or "uniform". */
const char *operator_layout_name(enum table_layout layout);

#endif
