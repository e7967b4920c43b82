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
 * (0, 1, 2; those beyond are 0). Values, gradients and Hessians are finite;
 * derivatives that come through a warp are held within +-1e100.
 * The Hessian leaves out the third-derivative part of gradient-based
 * compositions (SPEC section 1). Reentrant; no allocation.
 */
void evaluate(const struct tape *tape, struct vec3 p, int order,
    struct jet *out);

/*
 * The colour of tape at p (finite; world units): linear RGB, each in [0, 1].
 * A primitive has its material's colour. A composition mixes its operands'
 * colours by shares w and 1 - w that depend continuously on their values a and
 * b alone:
 *   sum                     w = (a + e) / (a + b + 2e)
 *   unions                  w = (a^2 + e) / (a^2 + b^2 + 2e)
 *   ricci                   the same with a^m, b^m, m = min(n, 8)
 *   intersections           w = (A^2 + e) / (A^2 + B^2 + 2e)
 *   differences             w = (A^2 + e) / (A^2 + b^2 + e)
 * with A = max(0, 1 - a), B = max(0, 1 - b) and e = 1e-6, which keeps them
 * continuous where everything is 0. Folded in the tree's order. Operators
 * without angles (core/classic.h) mix as their family does. Reentrant; no
 * allocation.
 */
void evaluate_color(const struct tape *tape, struct vec3 p, struct vec3 *out);

/*
 * One gradient-based composition (Eq. 29, all three terms): op on the jets a
 * and b, whose derivatives are known to one order more than asked for unless
 * that is more than 2 or the opening is constant. null_gradient is in 1/length
 * of the frame: under it a gradient counts as null.
 */
void evaluate_compose(const struct operator *op, double null_gradient,
    const struct jet *a, const struct jet *b, int order, struct jet *out);

#endif
