/*
 * A primitive's box goes out through its frame, the nearest warp, the frame
 * outside of that, and so on; before each step it is widened by what a device may
 * err in the step's coordinates, taken inwards.
 */
#include "core/support.h"

#include <float.h>
#include <math.h>
#include <stdbool.h>
#include <stddef.h>

#include "core/bounds.h"
#include "core/classic.h"
#include "core/operator.h"
#include "core/primitive.h"
#include "core/tape.h"
#include "core/warp.h"

/* A box with a number over this is taken for endless: beyond POINT_REACH points
 * are drawn in, and may end in it. */
#define REACH (0.9 * (double)POINT_REACH)

static const struct bounds everything = {
	{-INFINITY, -INFINITY, -INFINITY}, {INFINITY, INFINITY, INFINITY}};

static const struct tape_box none = {
	{INFINITY, INFINITY, INFINITY}, {-INFINITY, -INFINITY, -INFINITY}};

static const struct tape_box all = {
	{-INFINITY, -INFINITY, -INFINITY}, {INFINITY, INFINITY, INFINITY}};

/* The larger number of a and b that is finite, else other. */
static double size_of(double a, double b, double other)
{
	a = fabs(a);
	b = fabs(b);
	if (isinf(a) && isinf(b))
		return other;
	return isinf(a) ? b : isinf(b) || a > b ? a : b;
}

/* Of b's finite numbers the largest. */
static double extent(const struct bounds *b)
{
	return fmax(size_of(b->min.x, b->max.x, 0.0),
	    fmax(size_of(b->min.y, b->max.y, 0.0),
	    size_of(b->min.z, b->max.z, 0.0)));
}

static void widen(struct bounds *b, struct vec3 by)
{
	b->min = vec3_sub(b->min, by);
	b->max = vec3_add(b->max, by);
}

static void widen_evenly(struct bounds *b, double by)
{
	widen(b, vec3(by, by, by));
}

/* Row i of |A| times v, and |t|. */
static double reach_of(const struct affine *m, int i, const double v[static 3])
{
	double sum = fabs(m->t[i]);

	for (int j = 0; j < 3; j++)
		if (m->a[i][j] != 0.0)
			sum += fabs(m->a[i][j]) * v[j];
	return sum;
}

/*
 * A half-space's bound, for points that are drawn in after inward has taken
 * them out of reach: towards the origin, and so perhaps across a bound that has
 * the origin beyond it.
 */
static void admit_drawn(struct bounds *b, const struct affine *inward)
{
	const double base[3] = {POINT_REACH, POINT_REACH, POINT_REACH};
	double far = 1.0;

	if (bounds_is_finite(b) || bounds_is_empty(b))
		return;
	for (int i = 0; i < 3; i++)
		far = fmax(far, reach_of(inward, i, base) / POINT_REACH);
	b->min = vec3(b->min.x * (b->min.x < 0.0 ? far : 1.0),
	    b->min.y * (b->min.y < 0.0 ? far : 1.0),
	    b->min.z * (b->min.z < 0.0 ? far : 1.0));
	b->max = vec3(b->max.x * (b->max.x > 0.0 ? far : 1.0),
	    b->max.y * (b->max.y > 0.0 ? far : 1.0),
	    b->max.z * (b->max.z > 0.0 ? far : 1.0));
}

/*
 * b, in a frame, to its base. A device errs by roundings of |A| |p| + |t| in the
 * frame's coordinates; p is taken from the box itself. Where that is endless on
 * both sides, p is anything in reach.
 */
static struct bounds leave_frame(const struct affine *inward,
    const struct affine *outward, struct bounds b)
{
	struct bounds out;
	double size[3];

	admit_drawn(&b, inward);
	out = bounds_map(outward, &b);
	size[0] = size_of(out.min.x, out.max.x, POINT_REACH);
	size[1] = size_of(out.min.y, out.max.y, POINT_REACH);
	size[2] = size_of(out.min.z, out.max.z, POINT_REACH);
	widen(&b, vec3_scale(SUPPORT_ROUNDING, vec3(
	    reach_of(inward, 0, size), reach_of(inward, 1, size),
	    reach_of(inward, 2, size))));
	return bounds_map(outward, &b);
}

/*
 * b, within w, to w's frame. A device errs by roundings of the coordinates in w's
 * frame and of those that W gives, a taper's over its least factor.
 */
static struct bounds leave_warp(const struct warp *w, struct bounds b)
{
	double factor = w->type == WARP_TAPER ? fmax(1.0, 1.0 / w->scale) : 1.0;
	double own = fabs(w->center.x) + fabs(w->center.y) +
	    fabs(w->center.z) + fabs(w->from) + fabs(w->to);
	struct bounds out;

	if (bounds_is_empty(&b))
		return b;
	if (!bounds_is_finite(&b) || extent(&b) > REACH)
		return everything;
	widen_evenly(&b, SUPPORT_ROUNDING * factor * (own + extent(&b)));
	out = bounds_unwarp(w, &b);
	widen_evenly(&out, SUPPORT_ROUNDING * (own + extent(&out)));
	return out;
}

/* To float32, outwards: what is widened by has room for the rounding. */
static float outer(double x)
{
	return fabs(x) > REACH ? copysignf(INFINITY, (float)x) : (float)x;
}

struct tape_box support_box(const struct primitive *p,
    const struct affine *inward, const struct affine *outward,
    const struct support_warp *warp)
{
	struct bounds b = bounds_of_primitive(p);

	widen_evenly(&b, SUPPORT_ROUNDING * extent(&b));
	b = leave_frame(inward, outward, b);
	for (; warp; warp = warp->up) {
		b = leave_warp(warp->warp, b);
		b = leave_frame(&warp->inward, &warp->outward, b);
	}
	if (bounds_is_empty(&b))
		return none;
	if (extent(&b) > REACH)
		return all;
	widen_evenly(&b, SUPPORT_ROUNDING * extent(&b));
	return (struct tape_box){
	    {outer(b.min.x), outer(b.min.y), outer(b.min.z)},
	    {outer(b.max.x), outer(b.max.y), outer(b.max.z)}};
}

static void hull(struct tape_box *a, const struct tape_box *b)
{
	for (int i = 0; i < 3; i++) {
		a->min[i] = b->min[i] < a->min[i] ? b->min[i] : a->min[i];
		a->max[i] = b->max[i] > a->max[i] ? b->max[i] : a->max[i];
	}
}

static void meet(struct tape_box *a, const struct tape_box *b)
{
	for (int i = 0; i < 3; i++) {
		a->min[i] = b->min[i] > a->min[i] ? b->min[i] : a->min[i];
		a->max[i] = b->max[i] < a->max[i] ? b->max[i] : a->max[i];
	}
	if (!(a->min[0] <= a->max[0] && a->min[1] <= a->max[1] &&
	    a->min[2] <= a->max[2]))
		*a = none;
}

/* Whether a classic operator is 0 where both of its operands are. */
static bool keeps_zero(const struct tape *tape, const struct insn *insn)
{
	struct operator_jet g;

	classic_eval(insn->index, tape->params + insn->param, 0.0, 0.0, 0, &g);
	return !(g.g > 0.0);
}

/* a: that of the jet pushed first, and the result. */
static void compose(const struct tape *tape, const struct insn *insn,
    struct tape_box *a, const struct tape_box *b)
{
	switch (insn->op) {
	case OP_MIN:
	case OP_INTERSECTION:
		meet(a, b);
		return;
	case OP_MINUS:
	case OP_DIFFERENCE:
		return;
	case OP_MINUS_SWAPPED:
	case OP_DIFFERENCE_SWAPPED:
		*a = *b;
		return;
	case OP_CLASSIC:
	case OP_CLASSIC_SWAPPED:
		if (!keeps_zero(tape, insn)) {
			*a = all;
			return;
		}
		break;
	}
	hull(a, b);
}

void support_compose(struct tape *tape)
{
	struct tape_box stack[TAPE_STACK_MAX], *end = stack;

	for (size_t i = 0; i < tape->insn_count; i++) {
		const struct insn *insn = tape->insns + i;

		if (insn->op == OP_FRAME || insn->op == OP_COLOR ||
		    insn->op == OP_ENTER) {
			tape->boxes[i] = all;
			continue;
		}
		if (insn->op >= OP_MAX) {
			end--;
			compose(tape, insn, end - 1, end);
		} else if (insn->op >= OP_PRIMITIVES) {
			*end++ = tape->boxes[i];
		}
		tape->boxes[i] = end[-1];
	}
}
