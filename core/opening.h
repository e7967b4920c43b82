/*
 * Openings: how far a composition blends, from the angle between its fields'
 * gradients (SPEC section 1; Gourmel et al. 2013, Eq. 15, 16).
 */
#ifndef CORE_OPENING_H
#define CORE_OPENING_H

#include <stdbool.h>

#include "core/err.h"

/* 0 <= alpha[0] <= alpha[1] <= alpha[2] <= pi; theta in [0, pi/4]; w > 0. */
struct opening {
	double alpha[3];
	double theta[3];
	double w[2];
};

/*
 * theta and its derivatives at one angle alpha, in the forms that stay finite
 * at alpha = 0 and pi.
 */
struct opening_jet {
	double theta;    /* radians, in [0, pi/4] */
	double slope;    /* d theta / d cos(alpha) */
	double bend;     /* d2 theta / d cos(alpha)^2 */
};

/*
 * kappa(x) = 1 - exp(1 - 1/(1 - exp(1 - 1/x))) on [0, 1] (Eq. 16); 0 below and
 * 1 above. Flat to every order at both ends.
 */
double opening_kappa(double x);

/*
 * Checks the ranges above. ERR_INVALID leaves in *field "alpha", "theta" or
 * "w", and in *index which of its numbers is wrong.
 */
enum err opening_check(const struct opening *opening, const char **field,
    int *index);

/* theta at the angle alpha in [0, pi]. */
double opening_theta(const struct opening *opening, double alpha);

/*
 * The jet at cosine = cos(alpha), clamped to [-1, 1]. Empty intervals
 * (alpha[0] == alpha[1], say) are jumps, with derivative 0.
 */
void opening_eval(const struct opening *opening, double cosine,
    struct opening_jet *out);

/* Whether theta is the same at every angle, so that no gradient is needed. */
bool opening_is_constant(const struct opening *opening);

/* min(theta0, theta1, theta2): where a gradient is null. */
double opening_least(const struct opening *opening);

/* The named openings of SPEC section 1; false if there is none of that name. */
bool opening_named(const char *name, struct opening *out);

/* The opening with theta at every angle. */
struct opening opening_constant(double theta);

bool opening_equal(const struct opening *a, const struct opening *b);

/* An order of openings, as of strcmp; 0 where they are equal. */
int opening_compare(const struct opening *a, const struct opening *b);

#endif
