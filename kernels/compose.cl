/*
 * Compositions of two jets (core/evaluate.h says the same in float64). All
 * take and give derivatives up to `order` unless they say otherwise; what lies
 * beyond is neither read nor written. The result replaces the first operand.
 */

/* a where m holds, b elsewhere. */
static inline void compose_pick(struct jetr *a, const struct jetr *b, mask m,
    int order)
{
	a->value = SELECT(b->value, a->value, m);
	if (order >= 1)
		a->gradient = vec3r_select(b->gradient, a->gradient, m);
	if (order >= 2)
		a->hessian = sym3r_select(b->hessian, a->hessian, m);
}

static inline void compose_copy(struct jetr *a, const struct jetr *b,
    int order)
{
	a->value = b->value;
	if (order >= 1)
		a->gradient = b->gradient;
	if (order >= 2)
		a->hessian = b->hessian;
}

static inline void compose_max(struct jetr *a, const struct jetr *b, int order)
{
	compose_pick(a, b, a->value >= b->value, order);
}

static inline void compose_min(struct jetr *a, const struct jetr *b, int order)
{
	compose_pick(a, b, a->value <= b->value, order);
}

static inline void compose_sum(struct jetr *a, const struct jetr *b, int order)
{
	a->value += b->value;
	if (order >= 1)
		a->gradient = vec3r_add(a->gradient, b->gradient);
	if (order >= 2)
		a->hessian = sym3r_axpy(REAL(1.0f), b->hessian, a->hessian);
}

/* a becomes max(0, 1 - a). */
static inline void compose_complement(struct jetr *a, int order)
{
	real value = 1.0f - a->value;
	real sign = SELECT(REAL(0.0f), REAL(-1.0f), value > 0.0f);

	a->value = real_max(value, REAL(0.0f));
	if (order >= 1)
		a->gradient = vec3r_scale(sign, a->gradient);
	if (order >= 2)
		a->hessian = sym3r_scale(sign, a->hessian);
}

/* g(a, b) by the chain rule; the derivatives in theta are left out. */
static inline void compose_chain(struct jetr *a, const struct jetr *b,
    const struct opjet *o, int order)
{
	a->value = real_max(o->g, REAL(0.0f)); /* tables err either way */
	if (order >= 2) {
		struct sym3r h = sym3r_scale(o->g1, a->hessian);

		h = sym3r_axpy(o->g2, b->hessian, h);
		h = sym3r_axpy(o->g11, sym3r_square(a->gradient), h);
		h = sym3r_axpy(o->g12,
		    sym3r_product(a->gradient, b->gradient), h);
		a->hessian = sym3r_axpy(o->g22, sym3r_square(b->gradient), h);
	}
	if (order >= 1)
		a->gradient = vec3r_axpy(o->g2, b->gradient,
		    vec3r_scale(o->g1, a->gradient));
}

/*
 * Ricci's blend (Gourmel et al. 2013, Eq. 11) of the larger field M and the
 * smaller m: M q with q = (1 + t)^(1/n), t = r^n, r = m/M, which neither over-
 * nor underflows. The gradient is q/(1 + t) (M' + (t/r) m'); the Hessian
 * repeats that form and adds (n-1) t M q/(1+t)^2 d d^T, d = M'/M - m'/m.
 */
static void compose_ricci(struct jetr *a, struct jetr *b, float n, int order)
{
	mask both = (a->value > REAL(0.0f)) & (b->value > REAL(0.0f));
	struct jetr least, larger;
	real most, r, t, q, big, small;

	if (!ANY(b->value > REAL(0.0f)))
		return;
	larger = *a;
	compose_max(&larger, b, order);
	if (!ANY(both)) {
		*a = larger;
		return;
	}
	least = *b;

	jetr_limit(a, order);
	jetr_limit(b, order);
	compose_pick(&least, a, a->value >= b->value, order);
	compose_max(a, b, order);
	most = real_max(a->value, REAL(1e-30f));
	r = real_max(least.value / most, REAL(1e-12f));
	t = exp2(n * log2(r));
	q = exp2(log2(1.0f + t) * (1.0f / n));
	big = q / (1.0f + t);
	small = big * t / r;
	if (order >= 2) {
		struct vec3r d = vec3r_limit(vec3r_axpy(
		    -1.0f / real_max(least.value, REAL(1e-30f)),
		    least.gradient, vec3r_scale(1.0f / most, a->gradient)),
		    LIMIT_COSINE);

		a->hessian = sym3r_axpy(small, least.hessian,
		    sym3r_scale(big, a->hessian));
		a->hessian = sym3r_axpy((n - 1.0f) * t * a->value * big /
		    (1.0f + t), sym3r_square(d), a->hessian);
	}
	if (order >= 1)
		a->gradient = vec3r_axpy(small, least.gradient,
		    vec3r_scale(big, a->gradient));
	a->value *= q;
	/* A field of 0 is nothing to add, whatever the powers round to. */
	compose_pick(a, &larger, both, order);
}

/* The derivatives of the opening at the angle between two gradients. */
struct angle {
	struct vec3r gradient;
	struct sym3r hessian;  /* without the operands' third derivatives */
};

/* A gradient's direction, and how far from null it is. */
struct heading {
	struct vec3r n;     /* unit vector, or null */
	real inverse;       /* 1 / norm */
	real share, slope;  /* S(norm / eps), and S' / eps */
};

/*
 * S(s) = 6 s^5 - 15 s^4 + 10 s^3, between 0 and 1. steep: 1/null_gradient.
 */
static inline struct heading heading(struct vec3r gradient, float steep)
{
	struct heading h;
	real square = real_max(vec3r_dot(gradient, gradient), REAL(1e-36f));
	real s;

	h.inverse = lanes_rsqrt(square);
	s = real_min(square * h.inverse * steep, REAL(1.0f));
	h.n = vec3r_scale(h.inverse, gradient);
	h.share = s * s * s * (s * (s * 6.0f - 15.0f) + 10.0f);
	h.slope = 30.0f * steep * s * s * (1.0f - s) * (1.0f - s);
	return h;
}

/* h k + k h */
static inline struct sym3r anticommutator(struct sym3r h, struct sym3r k)
{
	struct vec3r hx = vec3r(h.xx, h.xy, h.xz), kx = vec3r(k.xx, k.xy, k.xz);
	struct vec3r hy = vec3r(h.xy, h.yy, h.yz), ky = vec3r(k.xy, k.yy, k.yz);
	struct vec3r hz = vec3r(h.xz, h.yz, h.zz), kz = vec3r(k.xz, k.yz, k.zz);

	return sym3r(2.0f * vec3r_dot(hx, kx), 2.0f * vec3r_dot(hy, ky),
	    2.0f * vec3r_dot(hz, kz), vec3r_dot(hx, ky) + vec3r_dot(kx, hy),
	    vec3r_dot(hx, kz) + vec3r_dot(kx, hz),
	    vec3r_dot(hy, kz) + vec3r_dot(ky, hz));
}

/*
 * The Hessian of c = n1.n2 but for the operands' third derivatives. With h =
 * H/|grad f| and u = h n of each it is h1 h2 + h2 h1 - c (h1^2 + h2^2) -
 * sym(u1 + u2, grad c) + c (u1 - u2)(u1 - u2)^T.
 */
static struct sym3r compose_bend(const struct jetr *a, const struct jetr *b,
    const struct heading *u, const struct heading *v, real c,
    struct vec3r grad_c)
{
	struct sym3r h = sym3r_limit(sym3r_scale(u->inverse, a->hessian),
	    LIMIT_COSINE);
	struct sym3r k = sym3r_limit(sym3r_scale(v->inverse, b->hessian),
	    LIMIT_COSINE);
	struct vec3r p = sym3r_apply(h, u->n), q = sym3r_apply(k, v->n);
	/* h1 h2 + h2 h1 - c (h1^2 + h2^2), in two products */
	struct sym3r r = anticommutator(h, sym3r_axpy(-0.5f * c, h, k));

	r = sym3r_axpy(-0.5f * c, anticommutator(k, k), r);
	r = sym3r_axpy(REAL(-1.0f), sym3r_product(vec3r_add(p, q), grad_c), r);
	return sym3r_axpy(c, sym3r_square(vec3r_sub(p, q)), r);
}

/* The angle between two gradients, and the opening there. */
struct meeting {
	struct heading u, v;
	real c, share, theta;   /* theta: with its share of null gradients */
	real rise;              /* over the least */
	struct opening_cell cell;
};

/* theta goes to its least as either gradient falls under null_gradient. */
static inline void compose_meet(__global const float *openings,
    __global const struct operator_desc *desc, float null_gradient,
    struct vec3r first, struct vec3r second, struct meeting *m)
{
	m->u = heading(first, 1.0f / null_gradient);
	m->v = heading(second, 1.0f / null_gradient);
	m->share = m->u.share * m->v.share;
	m->c = real_clamp(vec3r_dot(m->u.n, m->v.n), REAL(-1.0f), REAL(1.0f));
	m->rise = opening_theta(openings, desc, m->c, &m->cell) -
	    desc->theta_least;
	m->theta = desc->theta_least + m->rise * m->share;
}

/* theta's derivatives up to order >= 1; the operands' Hessians are read. */
static void compose_angle(__global const float *openings,
    __global const struct operator_desc *desc, const struct jetr *a,
    const struct jetr *b, const struct meeting *m, int order,
    struct angle *out)
{
	const struct heading *u = &m->u, *v = &m->v;
	real share = m->share, c = m->c, slope, bend;
	/* grad c = H1 (n2 - c n1) / |grad f1| + H2 (n1 - c n2) / |grad f2| */
	struct vec3r p = sym3r_apply(a->hessian, vec3r_axpy(-c, u->n, v->n));
	struct vec3r q = sym3r_apply(b->hessian, vec3r_axpy(-c, v->n, u->n));
	struct vec3r cosine = vec3r_limit(vec3r_axpy(u->inverse, p,
	    vec3r_scale(v->inverse, q)), LIMIT_COSINE);

	opening_slope(openings, desc, &m->cell, &slope, &bend);
	if (order >= 2)
		out->hessian = sym3r_axpy(share * bend,
		    sym3r_square(cosine), sym3r_scale(share * slope,
		    compose_bend(a, b, u, v, c, cosine)));

	out->gradient = vec3r_scale(share * slope, cosine);
	/* grad |grad f| = H n, times 0 where neither gradient is nearly null;
	 * by the slopes, since the shares are rounded to 1 before these are 0 */
	if (ANY((u->slope > REAL(0.0f)) | (v->slope > REAL(0.0f)))) {
		p = vec3r_scale(u->slope * v->share,
		    sym3r_apply(a->hessian, u->n));
		q = vec3r_scale(v->slope * u->share,
		    sym3r_apply(b->hessian, v->n));
		out->gradient = vec3r_axpy(m->rise, vec3r_add(p, q),
		    out->gradient);
	}
	out->gradient = vec3r_limit(out->gradient, LIMIT_COSINE);
}

/* Adds what theta brings to the result's derivatives. */
static inline void compose_turn(struct jetr *out, struct vec3r first,
    struct vec3r second, const struct opjet *o, const struct angle *angle,
    int order)
{
	if (order >= 1)
		out->gradient = vec3r_axpy(o->gt, angle->gradient,
		    out->gradient);
	if (order >= 2) {
		struct vec3r mixed = vec3r_axpy(o->g2t, second,
		    vec3r_scale(o->g1t, first));

		out->hessian = sym3r_axpy(REAL(1.0f),
		    sym3r_product(mixed, angle->gradient), out->hessian);
		out->hessian = sym3r_axpy(o->gtt,
		    sym3r_square(angle->gradient), out->hessian);
		out->hessian = sym3r_axpy(o->gt, angle->hessian, out->hessian);
	}
}

static inline void compose_zero(struct jetr *a, int order)
{
	a->value = REAL(0.0f);
	if (order >= 1)
		a->gradient = vec3r(REAL(0.0f), REAL(0.0f), REAL(0.0f));
	if (order >= 2)
		a->hessian = sym3r_identity(REAL(0.0f));
}

/* Where the operands do not blend: the near one; intersections end at 0. */
static inline void compose_apart(__global const struct operator_desc *desc,
    mask both, struct jetr *a, const struct jetr *b, int order)
{
	mask none = !both;

	if (desc->family == DESCRIPTOR_UNION) {
		/* Of a tape's primitives most are 0 at most points. */
		if (ANY(b->value > REAL(0.0f)))
			compose_max(a, b, order);
		return;
	}
	if (ANY(both))
		compose_min(a, b, order);
	if (!ANY(none))
		return;
	a->value = SELECT(a->value, REAL(0.0f), none);
	if (order >= 1) {
		struct vec3r zero = vec3r(REAL(0.0f), REAL(0.0f), REAL(0.0f));

		a->gradient = vec3r_select(a->gradient, zero, none);
	}
	if (order >= 2)
		a->hessian = sym3r_select(a->hessian,
		    sym3r_identity(REAL(0.0f)), none);
}

/* Two operands that may blend, within the limits of jets, and what is found out
 * of them. */
struct blend {
	struct jetr a, b;
	struct meeting meeting;
	struct region region;
};

/* The order that a composition needs of its operands. */
static inline int compose_order(__global const struct operator_desc *desc,
    int order)
{
	return desc->is_constant ? order : min(order + 1, 2);
}

/* The part of it that tells whether they blend. */
static inline int compose_first_order(
    __global const struct operator_desc *desc, int order)
{
	return min(compose_order(desc, order), 1);
}

/* Whether any lane wanted blends; the operands' Hessians are not read. */
static inline int compose_meets(__global const float *curves,
    __global const float *openings,
    __global const struct operator_desc *desc, float null_gradient,
    mask wanted, int order, struct blend *x)
{
	int first = compose_first_order(desc, order);

	jetr_limit(&x->a, first);
	jetr_limit(&x->b, first);
	x->meeting.theta = REAL(desc->theta);
	if (!desc->is_constant)
		compose_meet(openings, desc, null_gradient, x->a.gradient,
		    x->b.gradient, &x->meeting);
	operator_region(curves, desc, wanted, x->a.value, x->b.value,
	    x->meeting.theta, &x->region);
	return ANY(x->region.blend);
}

/*
 * What lanes that blend become, in the first operand's place; the others' are
 * not to be read.
 */
static inline void compose_blended(TABLE_ARGS, __global const float *openings,
    __global const struct operator_desc *desc, int order, struct blend *x)
{
	int turns = !desc->is_constant && order >= 1;
	struct vec3r first = x->a.gradient;
	struct angle angle;
	struct opjet o;

	if (turns || order >= 2) {
		x->a.hessian = sym3r_limit(x->a.hessian, LIMIT_HESSIAN);
		x->b.hessian = sym3r_limit(x->b.hessian, LIMIT_HESSIAN);
	}
	if (turns)
		compose_angle(openings, desc, &x->a, &x->b, &x->meeting,
		    order, &angle);
	operator_lookup(TABLE_PASS, desc, &x->region, order, &o);
	compose_chain(&x->a, &x->b, &o, order);
	if (turns)
		compose_turn(&x->a, first, x->b.gradient, &o, &angle, order);
}

/*
 * A gradient-based composition (Gourmel et al. 2013, Eq. 29, all three terms);
 * the Hessian leaves out the third derivatives. The operands carry one order
 * more than `order`, up to 2, unless the opening is constant.
 *
 * What a lane needs is found out in steps, each for all lanes if one needs it:
 * two fields over 0, the opening, whether they blend, all the rest. A lane's
 * result is that of its own last step, whatever the others need. 0: the result
 * is 0 in all lanes.
 */
static int compose_blend(TABLE_ARGS, __global const float *openings,
    __global const struct operator_desc *desc, uint op, float null_gradient,
    struct jetr *a, struct jetr *b, int order)
{
	int deep = compose_order(desc, order);
	struct blend x;
	mask both;

	/* Operators are symmetric, so the intersection's order is of no
	 * account. */
	if (op == OP_DIFFERENCE)
		compose_complement(b, deep);
	if (op == OP_DIFFERENCE_SWAPPED)
		compose_complement(a, deep);

	/* Where either is 0 so is an intersection, and a union is the other. */
	both = (a->value > REAL(0.0f)) & (b->value > REAL(0.0f));
	if (!ANY(both)) {
		compose_apart(desc, both, a, b, order);
		return desc->family == DESCRIPTOR_UNION;
	}
	x.a = *a;
	x.b = *b;
	if (!compose_meets(curves, openings, desc, null_gradient, both, order,
	    &x)) {
		compose_apart(desc, both, a, b, order);
		return 1;
	}
	compose_apart(desc, both, a, b, order);
	compose_blended(TABLE_PASS, openings, desc, order, &x);
	compose_pick(a, &x.a, !x.region.blend, order);
	return 1;
}

/* An operator without angles (core/classic.h), by the chain rule. */
static void compose_classic(uint op, uint type, __global const float *p,
    struct jetr *a, struct jetr *b, int order)
{
	struct opjet o, swapped;

	jetr_limit(a, order);
	jetr_limit(b, order);
	if (op == OP_CLASSIC) {
		classic_eval(type, p, a->value, b->value, order, &o);
	} else {
		classic_eval(type, p, b->value, a->value, order, &swapped);
		o = swapped;
		o.g1 = swapped.g2;
		o.g2 = swapped.g1;
		o.g11 = swapped.g22;
		o.g22 = swapped.g11;
	}
	compose_chain(a, b, &o, order);
}

/* --- colours: the rule is in core/evaluate.h ------------------------------ */

#define COLOR_LEAST 1e-6f

/* The greatest power of a ricci's shares. */
#define COLOR_POWER_MAX 8.0f

/* (a + e) / (a + b + 2e) */
static inline real color_share(real a, real b, real e)
{
	return (a + e) / (a + b + 2.0f * e);
}

/* With s^n of all three, s = 1 / max(1, a, b), so that none overflows. */
static real color_share_ricci(real a, real b, float n)
{
	real s = 1.0f / real_max(REAL(1.0f), real_max(a, b));
	real A = exp2(n * log2(real_max(a * s, REAL(1e-12f))));
	real B = exp2(n * log2(real_max(b * s, REAL(1e-12f))));

	return color_share(A, B, COLOR_LEAST * exp2(n * log2(s)));
}

/* The first field's share of what an operator of this family gives. */
static real color_share_family(int family, real a, real b)
{
	real A = real_max(1.0f - a, REAL(0.0f));
	real B = real_max(1.0f - b, REAL(0.0f));

	if (family == CLASSIC_UNION)
		return color_share(a * a, b * b, REAL(COLOR_LEAST));
	if (family == CLASSIC_INTERSECTION)
		return color_share(A * A, B * B, REAL(COLOR_LEAST));
	return (A * A + COLOR_LEAST) / (A * A + b * b + COLOR_LEAST);
}

static int color_family(uint op, __global const float *p)
{
	switch (op) {
	case OP_MAX:
	case OP_UNION:
		return CLASSIC_UNION;
	case OP_MIN:
	case OP_INTERSECTION:
		return CLASSIC_INTERSECTION;
	case OP_CLASSIC:
	case OP_CLASSIC_SWAPPED:
		return (int)p[0];
	default:
		return CLASSIC_DIFFERENCE;
	}
}

/*
 * Mixes the colours of two operands, before they are composed, into the first
 * one's place.
 */
static void compose_colors(uint op, __global const float *p,
    real first, real second, struct vec3r *color, const struct vec3r *other)
{
	int swapped = op == OP_MINUS_SWAPPED || op == OP_CLASSIC_SWAPPED ||
	    op == OP_DIFFERENCE_SWAPPED;
	real most = REAL(LIMIT_VALUE), least = REAL(0.0f), w;
	real a = real_clamp(swapped ? second : first, least, most);
	real b = real_clamp(swapped ? first : second, least, most);

	if (op == OP_SUM)
		w = color_share(a, b, REAL(COLOR_LEAST));
	else if (op == OP_RICCI)
		w = color_share_ricci(a, b, min(p[0], COLOR_POWER_MAX));
	else
		w = color_share_family(color_family(op, p), a, b);
	w = real_min(w, REAL(1.0f)); /* quotients err by 2.5 ulp */
	if (swapped)
		w = 1.0f - w;
	*color = vec3r_axpy(1.0f - w, *other, vec3r_scale(w, *color));
}
