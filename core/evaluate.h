/*
 * The float64 evaluator: the truth that every device is compared with.
 */
#ifndef CORE_EVALUATE_H
#define CORE_EVALUATE_H

#include "core/jet.h"
#include "core/operator.h"

struct tape;

/*
 * The field of tape at p (finite; world units), with derivatives up to order
 * (0, 1, 2; those beyond are 0). Values, gradients and Hessians are finite.
 * The Hessian leaves out the third-derivative part of gradient-based
 * compositions (SPEC section 1). Reentrant; no allocation.
 */
void evaluate(const struct tape *tape, struct vec3 p, int order,
    struct jet *out);

/*
 * One gradient-based composition (Eq. 29, all three terms): op on the jets a
 * and b, whose derivatives are known to one order more than asked for unless
 * that is more than 2 or the opening is constant. null_gradient is in 1/length of the frame: under it
 * a gradient counts as null.
 */
void evaluate_compose(const struct operator *op, double null_gradient,
    const struct jet *a, const struct jet *b, int order, struct jet *out);

#endif
