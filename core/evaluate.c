/*
 * Walks a tape with a stack of second-order jets. Departures from Gourmel et
 * al. 2013: the gradient has all three terms of Eq. 29, and a null gradient's
 * opening (their section 7) is reached by a smootherstep.
 */
#include "core/evaluate.h"

#include <assert.h>
#include <stdbool.h>
#include <stddef.h>

#include "core/affine.h"
#include "core/classic.h"
#include "core/primitive.h"
#include "core/tape.h"
#include "core/tree.h"
#include "core/volume.h"
#include "core/warp.h"

/* Fields under this are 0 to ricci, so that its quotients stay finite. */
#define RICCI_LEAST 1e-100

/* Of evaluate_color: e, ricci's greatest exponent, and what no value exceeds
 * in powers. */
#define COLOR_NOTHING 1e-6
#define COLOR_EXPONENT_MAX 8.0
#define COLOR_VALUE_MAX 1e30

/* Derivatives carried through a warp are held within this: far out, each of
 * several nested twists stretches by rate times distance. */
#define WARPED_MAX 1e100

static const struct jet zero_jet;

/* A gradient's norm, with derivatives as far as they are known. */
struct slope {
	double norm;
	struct vec3 unit;
	struct vec3 norm_gradient; /* H n */
};

/* The opening that a composition uses, as a field of its own. */
struct opened {
	double theta;
	struct vec3 gradient;
	struct sym3 hessian; /* without the third derivatives of the fields */
};

/* 6 s^5 - 15 s^4 + 10 s^3 over [0, 1] (Perlin 2002), with its derivative. */
static double smootherstep(double s, double *slope)
{
	*slope = 0.0;
	if (s >= 1.0)
		return 1.0;
	*slope = 30.0 * s * s * (s - 1.0) * (s - 1.0);
	return s * s * s * (s * (6.0 * s - 15.0) + 10.0);
}

static struct slope slope_of(const struct jet *f)
{
	struct slope s = {.norm = vec3_norm(f->gradient)};

	if (s.norm > 0.0) {
		s.unit = vec3_scale(1.0 / s.norm, f->gradient);
		s.norm_gradient = sym3_apply(f->hessian, s.unit);
	}
	return s;
}

/* h k + k h */
static struct sym3 anticommutator(struct sym3 h, struct sym3 k)
{
	struct vec3 hx = vec3(h.xx, h.xy, h.xz), kx = vec3(k.xx, k.xy, k.xz);
	struct vec3 hy = vec3(h.xy, h.yy, h.yz), ky = vec3(k.xy, k.yy, k.yz);
	struct vec3 hz = vec3(h.xz, h.yz, h.zz), kz = vec3(k.xz, k.yz, k.zz);

	return (struct sym3){2.0 * vec3_dot(hx, kx), 2.0 * vec3_dot(hy, ky),
	    2.0 * vec3_dot(hz, kz), vec3_dot(hx, ky) + vec3_dot(kx, hy),
	    vec3_dot(hx, kz) + vec3_dot(kx, hz),
	    vec3_dot(hy, kz) + vec3_dot(ky, hz)};
}

/*
 * The Hessian of c = n1.n2 but for the fields' third derivatives. With h =
 * H/|grad f| and u = h n of each field it is h1 h2 + h2 h1 - c (h1^2 + h2^2) -
 * sym(u1 + u2, grad c) + c (u1 - u2)(u1 - u2)^T.
 */
static struct sym3 cosine_hessian(const struct jet *f1, const struct jet *f2,
    const struct slope *s1, const struct slope *s2, double c,
    struct vec3 grad_c)
{
	struct sym3 h1 = sym3_scale(1.0 / s1->norm, f1->hessian);
	struct sym3 h2 = sym3_scale(1.0 / s2->norm, f2->hessian);
	struct vec3 u1 = vec3_scale(1.0 / s1->norm, s1->norm_gradient);
	struct vec3 u2 = vec3_scale(1.0 / s2->norm, s2->norm_gradient);
	/* h1 h2 + h2 h1 - c (h1^2 + h2^2), in two products */
	struct sym3 r = anticommutator(h1, sym3_axpy(-0.5 * c, h1, h2));

	r = sym3_axpy(-0.5 * c, anticommutator(h2, h2), r);
	r = sym3_axpy(-1.0, sym3_product(vec3_add(u1, u2), grad_c), r);
	return sym3_axpy(c, sym3_square(vec3_sub(u1, u2)), r);
}

/*
 * theta_least + (theta(c) - theta_least) b, c the cosine of the gradients'
 * angle and b = S(|grad f1|/eps) S(|grad f2|/eps), S the smootherstep.
 * grad c = H1 (n2 - c n1)/|grad f1| + H2 (n1 - c n2)/|grad f2|.
 */
static void open_angle(const struct operator *op, double eps,
    const struct jet *f1, const struct jet *f2, int order, struct opened *out)
{
	struct slope s1 = slope_of(f1), s2 = slope_of(f2);
	double least = opening_least(&op->opening), d1, d2, c;
	double b1 = smootherstep(s1.norm / eps, &d1);
	double b2 = smootherstep(s2.norm / eps, &d2);
	double b = b1 * b2;
	struct opening_jet o;
	struct vec3 grad_c, grad_b;

	*out = (struct opened){.theta = least};
	if (!(b > 0.0))
		return;
	c = vec3_dot(s1.unit, s2.unit);
	opening_eval(&op->opening, c, &o);
	out->theta = least + (o.theta - least) * b;
	if (order == 0)
		return;
	grad_c = vec3_add(
	    vec3_scale(1.0 / s1.norm, sym3_apply(f1->hessian,
	    vec3_axpy(-c, s1.unit, s2.unit))),
	    vec3_scale(1.0 / s2.norm, sym3_apply(f2->hessian,
	    vec3_axpy(-c, s2.unit, s1.unit))));
	grad_b = vec3_add(vec3_scale(d1 * b2 / eps, s1.norm_gradient),
	    vec3_scale(b1 * d2 / eps, s2.norm_gradient));
	out->gradient = vec3_axpy(o.theta - least, grad_b,
	    vec3_scale(b * o.slope, grad_c));
	if (order > 1)
		out->hessian = sym3_axpy(b * o.bend, sym3_square(grad_c),
		    sym3_scale(b * o.slope, cosine_hessian(f1, f2, &s1, &s2,
		    c, grad_c)));
}

/* g1 H1 + g2 H2 + gt Ht, and the second derivatives of g on the gradients. */
static struct sym3 compose_hessian(const struct operator_jet *g,
    const struct jet *f1, const struct jet *f2, const struct opened *t)
{
	struct sym3 h = sym3_scale(g->g1, f1->hessian);

	h = sym3_axpy(g->g2, f2->hessian, h);
	h = sym3_axpy(g->gt, t->hessian, h);
	h = sym3_axpy(g->g11, sym3_square(f1->gradient), h);
	h = sym3_axpy(g->g22, sym3_square(f2->gradient), h);
	h = sym3_axpy(g->gtt, sym3_square(t->gradient), h);
	h = sym3_axpy(g->g12, sym3_product(f1->gradient, f2->gradient), h);
	h = sym3_axpy(g->g1t, sym3_product(f1->gradient, t->gradient), h);
	return sym3_axpy(g->g2t, sym3_product(f2->gradient, t->gradient), h);
}

void evaluate_compose(const struct operator *op, double null_gradient,
    const struct jet *a, const struct jet *b, int order, struct jet *out)
{
	struct opened t = {.theta = op->opening.theta[0]};
	struct operator_jet g;
	struct jet r = zero_jet;

	/* g(f, 0) is f for a union, 0 for an intersection. */
	if (a->value <= 0.0 || b->value <= 0.0) {
		if (op->family == FAMILY_UNION)
			r = a->value > 0.0 ? *a : *b;
		*out = r;
		return;
	}
	if (!opening_is_constant(&op->opening))
		open_angle(op, null_gradient, a, b, order, &t);
	operator_eval(op->family, &op->profile, a->value, b->value, t.theta,
	    order, &g);
	r.value = g.g;
	if (order > 0)
		r.gradient = vec3_axpy(g.gt, t.gradient, vec3_axpy(g.g2,
		    b->gradient, vec3_scale(g.g1, a->gradient)));
	if (order > 1)
		r.hessian = compose_hessian(&g, a, b, &t);
	*out = r;
}

/* max(0, 1 - f) */
static struct jet complement(const struct jet *f)
{
	if (!(1.0 - f->value > 0.0))
		return zero_jet;
	return (struct jet){1.0 - f->value, vec3_scale(-1.0, f->gradient),
	    sym3_scale(-1.0, f->hessian)};
}

/*
 * M q, q = (1 + r^n)^(1/n), r = m/M, M the larger field (Eq. 11). With t = r^n
 * the gradient is q/(1 + t) (M' + t (M/m) m'); the Hessian repeats that form
 * in the Hessians and adds (n-1) t M q/(1+t)^2 d d^T, d = M'/M - m'/m.
 */
static struct jet ricci(double n, const struct jet *a, const struct jet *b)
{
	const struct jet *M = a->value >= b->value ? a : b;
	const struct jet *m = M == a ? b : a;
	double r, t, q, g1, g2;
	struct vec3 d;

	if (m->value < RICCI_LEAST)
		return *M;
	r = m->value / M->value;
	t = pow(r, n);
	q = pow(1.0 + t, 1.0 / n);
	g1 = q / (1.0 + t);
	g2 = g1 * t / r;
	d = vec3_axpy(-1.0 / m->value, m->gradient,
	    vec3_scale(1.0 / M->value, M->gradient));
	return (struct jet){M->value * q,
	    vec3_axpy(g2, m->gradient, vec3_scale(g1, M->gradient)),
	    sym3_axpy((n - 1.0) * t * M->value * g1 / (1.0 + t),
	    sym3_square(d),
	    sym3_axpy(g2, m->hessian, sym3_scale(g1, M->hessian)))};
}

static struct jet sum(const struct jet *a, const struct jet *b)
{
	return (struct jet){a->value + b->value,
	    vec3_add(a->gradient, b->gradient),
	    sym3_axpy(1.0, b->hessian, a->hessian)};
}

static struct jet carry(const double *params, const struct jet *f)
{
	const double (*a)[3] = (const double (*)[3])params;

	return (struct jet){f->value, affine_pull_gradient(a, f->gradient),
	    affine_pull_hessian(a, f->hessian)};
}

/* The chain rule alone: some of these are not 0 where a field is. */
static struct jet classic(const struct insn *insn, const double *params,
    const struct jet *a, const struct jet *b, int order)
{
	const struct opened none = {.theta = 0.0};
	struct operator_jet g;
	struct jet out = zero_jet;

	classic_eval(insn->index, params, a->value, b->value, order, &g);
	out.value = g.g;
	if (order > 0)
		out.gradient = vec3_axpy(g.g2, b->gradient,
		    vec3_scale(g.g1, a->gradient));
	if (order > 1)
		out.hessian = compose_hessian(&g, a, b, &none);
	return out;
}

static bool is_swapped(OPCODE_UINT op)
{
	return op == OP_MINUS_SWAPPED || op == OP_CLASSIC_SWAPPED ||
	    op == OP_DIFFERENCE_SWAPPED;
}

/* Composes two jets, a the one that comes first in the tree. */
static struct jet compose(const struct tape *tape, const struct insn *insn,
    const struct jet *a, const struct jet *b, int order)
{
	const double *params = tape->params + insn->param;
	struct jet inverse, out;

	switch (insn->op) {
	case OP_MAX:
		return a->value >= b->value ? *a : *b;
	case OP_MIN:
		return a->value <= b->value ? *a : *b;
	case OP_MINUS:
	case OP_MINUS_SWAPPED:
		inverse = complement(b);
		return a->value <= inverse.value ? *a : inverse;
	case OP_SUM:
		return sum(a, b);
	case OP_RICCI:
		return ricci(params[0], a, b);
	case OP_CLASSIC:
	case OP_CLASSIC_SWAPPED:
		return classic(insn, params, a, b, order);
	case OP_DIFFERENCE:
	case OP_DIFFERENCE_SWAPPED:
		inverse = complement(b);
		b = &inverse;
		break;
	}
	evaluate_compose(tape->operators + insn->index, params[0], a, b, order,
	    &out);
	return out;
}

enum rule {
	RULE_SUM,
	RULE_UNION,
	RULE_INTERSECTION,
	RULE_DIFFERENCE
};

/* By which rule the composition insn mixes colours; its exponent. */
static enum rule color_rule(const struct insn *insn, const double *params,
    double *exponent)
{
	static const enum rule of_family[] = {
		[CLASSIC_UNION] = RULE_UNION,
		[CLASSIC_INTERSECTION] = RULE_INTERSECTION,
		[CLASSIC_DIFFERENCE] = RULE_DIFFERENCE,
	};

	*exponent = 2.0;
	switch (insn->op) {
	case OP_SUM:
		return RULE_SUM;
	case OP_RICCI:
		*exponent = fmin(params[0], COLOR_EXPONENT_MAX);
		return RULE_UNION;
	case OP_CLASSIC:
	case OP_CLASSIC_SWAPPED:
		return of_family[(int)params[0]];
	case OP_MAX:
	case OP_UNION:
		return RULE_UNION;
	case OP_MIN:
	case OP_INTERSECTION:
		return RULE_INTERSECTION;
	default:
		return RULE_DIFFERENCE;
	}
}

/* The first operand's share, of its value a and the other's b. */
static double color_share(enum rule rule, double exponent, double a, double b)
{
	const double e = COLOR_NOTHING;
	double A = fmax(0.0, 1.0 - a), B = fmax(0.0, 1.0 - b);
	/* so that no power overflows */
	double pa = pow(fmin(a, COLOR_VALUE_MAX), exponent);
	double pb = pow(fmin(b, COLOR_VALUE_MAX), exponent);

	switch (rule) {
	case RULE_SUM:
		return (a + e) / (a + b + 2.0 * e);
	case RULE_UNION:
		return (pa + e) / (pa + pb + 2.0 * e);
	case RULE_INTERSECTION:
		return (A * A + e) / (A * A + B * B + 2.0 * e);
	default:
		return (A * A + e) / (A * A + pb + e);
	}
}

/* Of two operands that come in this order in the tree. */
static struct vec3 mix_colors(const struct tape *tape, const struct insn *insn,
    const struct jet *a, const struct jet *b, struct vec3 color_a,
    struct vec3 color_b)
{
	double exponent;
	enum rule rule = color_rule(insn, tape->params + insn->param,
	    &exponent);
	double w = color_share(rule, exponent, a->value, b->value);

	return vec3_add(vec3_scale(w, color_a), vec3_scale(1.0 - w, color_b));
}

/* p, or if it is out of reach the point on its ray that is not. */
static struct vec3 draw_in(struct vec3 p)
{
	double far = fmax(fabs(p.x), fmax(fabs(p.y), fabs(p.z)));
	const double reach = POINT_REACH;

	if (far <= reach)
		return p;
	return vec3(reach * (p.x / far), reach * (p.y / far),
	    reach * (p.z / far));
}

/* The point p of the base in the frame of these parameters. */
static struct vec3 enter_frame(const double *m, struct vec3 p)
{
	return draw_in(vec3(m[0] * p.x + m[1] * p.y + m[2] * p.z + m[9],
	    m[3] * p.x + m[4] * p.y + m[5] * p.z + m[10],
	    m[6] * p.x + m[7] * p.y + m[8] * p.z + m[11]));
}

static void cut_derivatives(struct jet *f, int order)
{
	if (order < 2)
		f->hessian = zero_jet.hessian;
	if (order < 1)
		f->gradient = zero_jet.gradient;
}

static double clamp(double x)
{
	return fmax(-WARPED_MAX, fmin(WARPED_MAX, x));
}

static void limit(struct jet *f)
{
	struct vec3 *g = &f->gradient;
	struct sym3 *h = &f->hessian;

	*g = vec3(clamp(g->x), clamp(g->y), clamp(g->z));
	*h = (struct sym3){clamp(h->xx), clamp(h->yy), clamp(h->zz),
	    clamp(h->xy), clamp(h->xz), clamp(h->yz)};
}

/* f(W(x)) of f at W(x): J^T g, and J^T H J + sum of g_i times W_i's second
 * derivatives. */
static struct jet unwarp(const struct warp_jet *w, const struct jet *f)
{
	struct jet out = {f->value,
	    affine_pull_gradient(w->jacobian, f->gradient),
	    affine_pull_hessian(w->jacobian, f->hessian)};

	out.hessian = sym3_axpy(f->gradient.x, w->second[0], out.hessian);
	out.hessian = sym3_axpy(f->gradient.y, w->second[1], out.hessian);
	out.hessian = sym3_axpy(f->gradient.z, w->second[2], out.hessian);
	limit(&out);
	return out;
}

/* Where a walk along a tape is. */
struct walk {
	const struct tape *tape;
	struct jet stack[TAPE_STACK_MAX], *end;
	struct vec3 bases[TAPE_WARPS_MAX + 1], *base;
	struct vec3 x;                      /* the primitives' point */
	struct vec3 colors[TAPE_STACK_MAX]; /* of the jets */
	struct vec3 color;                  /* of the primitives to come */
};

#define FRAME_PARAMS 12

/* W(A b + t) of the base b, with derivatives. */
static void warp_base(const struct insn *insn, const double *params,
    struct vec3 base, int order, struct warp_jet *out)
{
	warp_eval(insn->index, params + FRAME_PARAMS,
	    enter_frame(params, base), order, out);
}

static void enter_warp(struct walk *w, const struct insn *insn,
    const double *params)
{
	struct warp_jet warp;

	assert(w->base < w->bases + TAPE_WARPS_MAX);
	warp_base(insn, params, *w->base, 0, &warp);
	w->x = *++w->base = draw_in(warp.point);
}

static void leave_warp(struct walk *w, const struct insn *insn,
    const double *params, int order)
{
	struct warp_jet warp;

	w->base--;
	if (order == 0)
		return;
	warp_base(insn, params, *w->base, order, &warp);
	w->end[-1] = unwarp(&warp, w->end - 1);
}

static void push_primitive(struct walk *w, const struct insn *insn,
    const double *params, int order)
{
	w->colors[w->end - w->stack] = w->color;
	if (insn->op == OP_ZERO)
		*w->end++ = (struct jet){0};
	else if (insn->op == OP_VOLUME)
		volume_eval(w->tape->volumes[insn->index], params, w->x, order,
		    w->end++);
	else
		primitive_eval(insn->op, params, w->x, order, w->end++);
}

static void compose_top(struct walk *w, const struct insn *insn, int order,
    bool colored)
{
	struct jet *top = --w->end - 1;
	struct vec3 *colors = w->colors + (top - w->stack);
	int a = is_swapped(insn->op) ? 1 : 0;

	if (colored)
		colors[0] = mix_colors(w->tape, insn, top + a, top + 1 - a,
		    colors[a], colors[1 - a]);
	*top = compose(w->tape, insn, top + a, top + 1 - a, order);
}

static void step(struct walk *w, const struct insn *insn, int order,
    bool colored)
{
	const double *params = w->tape->params + insn->param;

	switch (insn->op) {
	case OP_FRAME:
		w->x = enter_frame(params, *w->base);
		return;
	case OP_CARRY:
		w->end[-1] = carry(params, w->end - 1);
		return;
	case OP_COLOR:
		w->color = vec3(params[0], params[1], params[2]);
		return;
	case OP_ENTER:
		enter_warp(w, insn, params);
		return;
	case OP_LEAVE:
		leave_warp(w, insn, params, order);
		return;
	}
	if (insn->op < OP_MAX)
		push_primitive(w, insn, params, order);
	else
		compose_top(w, insn, order, colored);
}

static void walk_tape(struct walk *w, const struct tape *tape, struct vec3 p,
    int order, bool colored)
{
	const double gray = TREE_COLOR_DEFAULT;

	assert(tape->stack_depth >= 1 && tape->stack_depth <= TAPE_STACK_MAX);
	w->tape = tape;
	w->end = w->stack;
	w->base = w->bases;
	w->x = *w->base = draw_in(p);
	w->color = vec3(gray, gray, gray);
	for (size_t i = 0; i < tape->insn_count; i++)
		step(w, tape->insns + i, tape_order(tape->insns + i, order),
		    colored);
}

void evaluate(const struct tape *tape, struct vec3 p, int order,
    struct jet *out)
{
	struct walk w;

	walk_tape(&w, tape, p, order, false);
	*out = w.stack[0];
	cut_derivatives(out, order);
}

void evaluate_color(const struct tape *tape, struct vec3 p, struct vec3 *out)
{
	struct walk w;

	walk_tape(&w, tape, p, 0, true);
	*out = w.colors[0];
}
