/*
 * Walks a tape with a stack of second-order jets. Departures from Gourmel et
 * al. 2013: the gradient has all three terms of Eq. 29, and a null gradient's
 * opening (their section 7) is reached by a smootherstep.
 */
#include "core/evaluate.h"

#include <assert.h>
#include <stddef.h>

#include "core/affine.h"
#include "core/primitive.h"
#include "core/tape.h"

/* Fields under this are 0 to ricci, so that its quotients stay finite. */
#define RICCI_LEAST 1e-100

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

/* Composes the jets pushed first and second. */
static struct jet compose(const struct tape *tape, const struct insn *insn,
    const struct jet *first, const struct jet *second, int order)
{
	const double *params = tape->params + insn->param;
	const struct jet *a = first, *b = second;
	struct jet inverse, out;

	if (insn->op == OP_MINUS_SWAPPED || insn->op == OP_DIFFERENCE_SWAPPED) {
		a = second;
		b = first;
	}
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

/* The point p of the world in the frame of these parameters. */
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

void evaluate(const struct tape *tape, struct vec3 p, int order,
    struct jet *out)
{
	struct jet stack[TAPE_STACK_MAX], *end = stack;
	struct vec3 world = draw_in(p), x = world;

	assert(tape->stack_depth >= 1 && tape->stack_depth <= TAPE_STACK_MAX);
	for (size_t i = 0; i < tape->insn_count; i++) {
		const struct insn *insn = tape->insns + i;
		const double *params = tape->params + insn->param;
		int wanted = tape_order(insn, order);

		if (insn->op == OP_FRAME) {
			x = enter_frame(params, world);
		} else if (insn->op == OP_CARRY) {
			end[-1] = carry(params, end - 1);
		} else if (insn->op < OP_MAX) {
			primitive_eval(insn->op, params, x, wanted, end++);
		} else {
			end--;
			end[-1] = compose(tape, insn, end - 1, end, wanted);
		}
	}
	*out = stack[0];
	cut_derivatives(out, order);
}
