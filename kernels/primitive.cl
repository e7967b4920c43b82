/*
 * Primitive fields and their derivatives: core/primitive.c in float32, WIDTH
 * points at a time. core/opcode.h has the order of the parameters.
 *
 * Members of a jet beyond the order asked for are left unset. For points within
 * POINT_REACH and parameters within the limits of a tree no intermediate
 * overflows, in the order of evaluation written here: build without
 * -cl-fast-relaxed-math and its parts.
 */

/* Squares of lengths from this up are normal float32 numbers. */
#define TINY 1e-18f

/* As in core/primitive.c. */
#define STEEPEST 1e12f
#define LEAST_SIZE 1e-9f

/* Below this ratio of |ab x ac| to |ab| |ac| a triangle is its three edges.
 * Above it the direction of its normal is good to 1e-3. */
#define SLIVER 1e-4f

/* Exponents up to this, if whole, are multiplications. */
#define WHOLE_MAX 16.0f

/* 1/x, or 0 where x is not above TINY. */
static inline real inverse(real x)
{
	mask m = x > TINY;

	return SELECT(REAL(0.0f), lanes_inverse(SELECT(REAL(1.0f), x, m)), m);
}

/* v / |v|, or 0; |v| in *norm. */
static inline struct vec3r unit(struct vec3r v, real *norm)
{
	*norm = sqrt(vec3r_dot(v, v));
	return vec3r_scale(inverse(*norm), v);
}

/* (1 - s)^k for k > 0, 0 where s >= 1. */
static inline real power(real s, float k)
{
	real b = real_max(1.0f - s, REAL(0.0f));
	mask in = b > 0.0f;
	real u, p;

	if (k <= WHOLE_MAX && k == (float)(int)k) {
		p = b;
		for (float i = 1.0f; i < k; i += 1.0f)
			p *= b;
		return p;
	}
	/* log1p(-s) = log(u) (-s)/(u - 1), u = 1 - s as rounded */
	u = SELECT(REAL(1.0f), b, in);
	s = SELECT(REAL(0.0f), s, in);
	in = u < 1.0f;
	p = SELECT(-s * M_LOG2E_F,
	    log2(u) * (s / SELECT(REAL(1.0f), 1.0f - u, in)), in);
	return SELECT(REAL(0.0f), exp2(k * p), b > 0.0f);
}

/*
 * Whether no lane of t is under 1, where a support ends: the jet is 0 then, and
 * is not written. Most primitives are out of reach at most points.
 */
static inline int out_of_reach(real t)
{
	return !ANY(t < REAL(1.0f));
}

/*
 * f = weight (1 - S)^n from S = d^2/R^2 and its derivatives, which end where f
 * underflows.
 */
static void soft(const struct jetr *s, float n, float weight, int order,
    struct jetr *out)
{
	real b = real_max(1.0f - s->value, REAL(0.0f));
	real p = weight * power(s->value, n - 2.0f);
	real zero = REAL(0.0f), f1;
	struct vec3r g;

	mask some;

	out->value = p * b * b;
	if (order < 1)
		return;
	some = out->value > zero;
	p = SELECT(zero, p, some);
	f1 = -n * p * b;
	/* The products of a far point's gradient would overflow. */
	g = vec3r_select(vec3r(zero, zero, zero), s->gradient, some);
	out->gradient = vec3r_scale(f1, g);
	if (order < 2)
		return;
	out->hessian = sym3r_axpy(n * (n - 1.0f) * p, sym3r_square(g),
	    sym3r_scale(f1, s->hessian));
}

/* S from d^2, held where it is a little beyond the support. */
static inline real support(real d2, float inv_r2)
{
	return real_min(d2, REAL(4.0f / inv_r2)) * inv_r2;
}

static int point(__global const float *p, struct vec3r x, int order,
    struct jetr *out)
{
	struct vec3r e = vec3r_sub(x, vec3r_load(p));
	float inv_r2 = p[3];
	struct jetr s;

	s.value = support(vec3r_dot(e, e), inv_r2);
	if (out_of_reach(s.value))
		return 0;
	s.gradient = vec3r_scale(REAL(2.0f * inv_r2), e);
	s.hessian = sym3r_identity(REAL(2.0f * inv_r2));
	soft(&s, p[4], p[5], order, out);
	return 1;
}

static int segment(__global const float *p, struct vec3r x, int order,
    struct jetr *out)
{
	struct vec3r u = vec3r_load(p + 3), e = vec3r_sub(x, vec3r_load(p));
	real along = vec3r_dot(u, e), zero = REAL(0.0f);
	mask between = along > 0.0f && along < p[6];
	real t = real_clamp(along, zero, REAL(p[6]));
	/* The far end's radius may be lost in rounding, but not to 0. */
	real r = real_max(p[7] + p[8] * t, REAL(1e-7f * p[7]));
	real r2 = r * r, inv_r2 = lanes_inverse(r2), k, sk;
	struct jetr s;

	e = vec3r_axpy(-t, u, e);
	s.value = real_min(vec3r_dot(e, e), 4.0f * r2) * inv_r2;
	if (out_of_reach(s.value))
		return 0;
	if (order >= 1) {
		k = real_clamp(p[8] * (r * inv_r2), REAL(-STEEPEST),
		    REAL(STEEPEST));
		k = SELECT(zero, k, between);
		sk = s.value * k;
		s.gradient = vec3r_axpy(-2.0f * sk, u,
		    vec3r_scale(2.0f * inv_r2, e));
	}
	if (order >= 2) {
		/* S = |e|^2/R^2 with de/dx = I - u u^T, dR/dx = R k u; the
		 * cross term is bounded by |e| <= 2R. */
		s.hessian = sym3r_identity(2.0f * inv_r2);
		s.hessian = sym3r_axpy(6.0f * sk * k -
		    SELECT(zero, 2.0f * inv_r2, between), sym3r_square(u),
		    s.hessian);
		k = SELECT(zero, k, s.value < 1.0f);
		s.hessian = sym3r_axpy(-4.0f * k, sym3r_product(
		    vec3r_scale(inv_r2, e), u), s.hessian);
	}
	soft(&s, p[9], p[10], order, out);
	return 1;
}

/*
 * From a triangle's nearest point to x: e. The Hessian of |e|^2/2 is
 * along v v^T + isotropic I.
 */
struct foot {
	struct vec3r e, v;
	real along, isotropic;
};

static struct foot foot_select(struct foot no, struct foot yes, mask m)
{
	struct foot f = {vec3r_select(no.e, yes.e, m),
	    vec3r_select(no.v, yes.v, m), SELECT(no.along, yes.along, m),
	    SELECT(no.isotropic, yes.isotropic, m)};

	return f;
}

/* v / |v|, or 0, the same for every lane; |v| in *norm. */
static inline float3 unit_uniform(float3 v, float *norm)
{
	*norm = sqrt(dot(v, v));
	return v * (*norm > TINY ? 1.0f / *norm : 0.0f);
}

static inline struct vec3r splat(float3 v)
{
	return vec3r(REAL(v.x), REAL(v.y), REAL(v.z));
}

/* One edge: e from its start to x, its unit vector (or 0) and length. */
static struct foot edge_foot(struct vec3r e, float3 direction, float length)
{
	struct vec3r u = splat(direction);
	real along = vec3r_dot(u, e), zero = REAL(0.0f);
	mask between = along > 0.0f && along < length;
	struct foot f = {vec3r_axpy(-real_clamp(along, zero, REAL(length)), u, e),
	    u, SELECT(zero, REAL(-1.0f), between), REAL(1.0f)};

	return f;
}

static struct foot nearer(struct foot f, struct foot g)
{
	return foot_select(f, g, vec3r_dot(g.e, g.e) < vec3r_dot(f.e, f.e));
}

static struct foot face_foot(struct vec3r e, float3 normal)
{
	struct vec3r n = splat(normal);
	struct foot f = {vec3r_scale(vec3r_dot(n, e), n), n, REAL(1.0f),
	    REAL(0.0f)};

	return f;
}

/* Whether e, from the start of an edge along u, is on its inner side. */
static mask beside(float3 n, float3 u, struct vec3r e)
{
	return vec3r_dot(splat(cross(n, u)), e) > 0.0f;
}

static struct foot triangle_foot(float3 a, float3 b, float3 c, struct vec3r x)
{
	float lab, lbc, lca, sine, norm;
	float3 ab = unit_uniform(b - a, &lab);
	float3 bc = unit_uniform(c - b, &lbc);
	float3 ca = unit_uniform(a - c, &lca);
	float3 n = unit_uniform(cross(ca, ab), &sine);
	struct vec3r ea = vec3r_sub(x, splat(a)), eb = vec3r_sub(x, splat(b));
	struct vec3r ec = vec3r_sub(x, splat(c));
	struct foot f = nearer(edge_foot(ea, ab, lab), edge_foot(eb, bc, lbc));

	f = nearer(f, edge_foot(ec, ca, lca));
	if (!(sine > SLIVER))
		return f;
	/* What rounding left of n along the edge would be lengthened by it. */
	n = unit_uniform(n - dot(n, ab) * ab, &norm);
	return foot_select(f, face_foot(ea, n), beside(n, ab, ea) &&
	    beside(n, bc, eb) && beside(n, ca, ec));
}

static int triangle(__global const float *p, struct vec3r x, int order,
    struct jetr *out)
{
	struct foot f = triangle_foot(vload3(0, p), vload3(1, p),
	    vload3(2, p), x);
	float inv_r2 = p[9];
	struct jetr s;

	s.value = support(vec3r_dot(f.e, f.e), inv_r2);
	if (out_of_reach(s.value))
		return 0;
	s.gradient = vec3r_scale(REAL(2.0f * inv_r2), f.e);
	if (order >= 2)
		s.hessian = sym3r_scale(REAL(2.0f * inv_r2), sym3r_axpy(f.along,
		    sym3r_square(f.v), sym3r_identity(f.isotropic)));
	soft(&s, p[10], p[11], order, out);
	return 1;
}

/*
 * A point's coordinates about an axis: z along u, rho away from it along the
 * unit vector e (0 on the axis itself).
 */
struct cylindrical {
	real rho, z;
	real inv_rho; /* bounded: AXIS_GUARD */
	struct vec3r e, u;
};

static struct cylindrical about_axis(__global const float *centre,
    __global const float *axis, struct vec3r x, float size)
{
	struct vec3r d = vec3r_sub(x, vec3r_load(centre));
	struct cylindrical c;
	float guard = AXIS_GUARD * (size > LEAST_SIZE ? size : LEAST_SIZE);

	c.u = vec3r_load(axis);
	c.z = vec3r_dot(c.u, d);
	c.e = unit(vec3r_axpy(-c.z, c.u, d), &c.rho);
	c.inv_rho = 1.0f / real_max(c.rho, REAL(guard));
	return c;
}

/* A function of (rho, z) with its derivatives, and d/drho over rho. */
struct planar {
	real value;
	real r, z;
	real rr, rz, zz;
	real r_over_rho;
};

static struct planar planar_select(struct planar no, struct planar yes, mask m)
{
	struct planar f = {SELECT(no.value, yes.value, m),
	    SELECT(no.r, yes.r, m), SELECT(no.z, yes.z, m),
	    SELECT(no.rr, yes.rr, m), SELECT(no.rz, yes.rz, m),
	    SELECT(no.zz, yes.zz, m),
	    SELECT(no.r_over_rho, yes.r_over_rho, m)};

	return f;
}

/*
 * The function in space: grad = f_r e + f_z u,
 * H = f_rr ee^T + f_rz (ue^T + eu^T) + f_zz uu^T + f_r/rho (I - uu^T - ee^T).
 */
static void revolve(const struct planar *f, const struct cylindrical *c,
    int order, struct jetr *out)
{
	out->value = f->value;
	if (order < 1)
		return;
	out->gradient = vec3r_axpy(f->r, c->e, vec3r_scale(f->z, c->u));
	if (order < 2)
		return;
	out->hessian = sym3r_identity(f->r_over_rho);
	out->hessian = sym3r_axpy(f->rr - f->r_over_rho, sym3r_square(c->e),
	    out->hessian);
	out->hessian = sym3r_axpy(f->zz - f->r_over_rho, sym3r_square(c->u),
	    out->hessian);
	out->hessian = sym3r_axpy(f->rz, sym3r_product(c->e, c->u),
	    out->hessian);
}

/*
 * A soft object whose skeleton is at distance a from the axis' ring, as seen in
 * (rho, z). p: inv_r2, n, weight.
 */
static int ring(__global const float *p, real a, mask radial,
    const struct cylindrical *c, int order, struct jetr *out)
{
	float inv_r2 = p[0];
	real two = REAL(2.0f * inv_r2), zero = REAL(0.0f);
	struct planar f = {support(a * a + c->z * c->z, inv_r2), two * a,
	    two * c->z, SELECT(zero, two, radial), zero, two,
	    two * (a * c->inv_rho)};
	struct jetr s;

	if (out_of_reach(f.value))
		return 0;
	revolve(&f, c, order, &s);
	soft(&s, p[1], p[2], order, out);
	return 1;
}

static int disc(__global const float *p, struct vec3r x, int order,
    struct jetr *out)
{
	struct cylindrical c = about_axis(p, p + 3, x, p[6]);
	mask beyond = c.rho > p[6];

	return ring(p + 7, SELECT(REAL(0.0f), c.rho - p[6], beyond), beyond, &c,
	    order, out);
}

static int circle(__global const float *p, struct vec3r x, int order,
    struct jetr *out)
{
	struct cylindrical c = about_axis(p, p + 3, x, p[6]);

	return ring(p + 7, c.rho - p[6], INT(-1), &c, order, out);
}

/*
 * f(t) = 1/2 - 15/16 t + 5/8 t^3 - 3/16 t^5 of a signed distance and its
 * derivatives, t = distance/falloff, as (1-t)^3 (8 + 9t + 3t^2) / 16.
 */
static void solid(const struct jetr *d, float inv_fall, int order,
    struct jetr *out)
{
	real t = real_clamp(d->value * inv_fall, REAL(-1.0f), REAL(1.0f));
	real w = 1.0f - t, flat = w * (1.0f + t);
	real f1, f2;

	out->value = w * w * w * (8.0f + t * (9.0f + 3.0f * t)) * 0.0625f;
	if (order < 1)
		return;
	f1 = -0.9375f * flat * flat * inv_fall;
	out->gradient = vec3r_scale(f1, d->gradient);
	if (order < 2)
		return;
	f2 = 3.75f * t * flat * inv_fall * inv_fall;
	out->hessian = sym3r_axpy(f2, sym3r_square(d->gradient),
	    sym3r_scale(f1, d->hessian));
}

/* Distance |e| less radius. */
static inline real round_value(struct vec3r e, float radius, real *length)
{
	*length = sqrt(vec3r_dot(e, e));
	return *length - radius;
}

/*
 * Its derivatives; of the Hessian but for the part
 * along an axis u that e is measured from: (I - gg^T - axial uu^T)/|e|.
 */
static void round_distance(struct vec3r e, real length, float radius,
    struct vec3r u, real axial, int order, struct jetr *out)
{
	struct sym3r flat;

	if (order < 1)
		return;
	out->gradient = vec3r_scale(inverse(length), e);
	if (order < 2)
		return;
	flat = sym3r_axpy(REAL(-1.0f), sym3r_square(out->gradient),
	    sym3r_identity(REAL(1.0f)));
	flat = sym3r_axpy(-axial, sym3r_square(u), flat);
	out->hessian = sym3r_scale(
	    1.0f / real_max(length, REAL(AXIS_GUARD * radius)), flat);
}

static int sphere(__global const float *p, struct vec3r x, int order,
    struct jetr *out)
{
	struct vec3r e = vec3r_sub(x, vec3r_load(p));
	struct jetr d;
	real length;

	d.value = round_value(e, p[3], &length);
	if (out_of_reach(d.value * p[4]))
		return 0;
	round_distance(e, length, p[3], e, REAL(0.0f), order, &d);
	solid(&d, p[4], order, out);
	return 1;
}

static int capsule(__global const float *p, struct vec3r x, int order,
    struct jetr *out)
{
	struct vec3r u = vec3r_load(p + 3), e = vec3r_sub(x, vec3r_load(p));
	real along = vec3r_dot(u, e), zero = REAL(0.0f);
	mask between = along > 0.0f && along < p[6];
	struct jetr d;
	real length;

	e = vec3r_axpy(-real_clamp(along, zero, REAL(p[6])), u, e);
	d.value = round_value(e, p[7], &length);
	if (out_of_reach(d.value * p[8]))
		return 0;
	round_distance(e, length, p[7], u, SELECT(zero, REAL(1.0f), between),
	    order, &d);
	solid(&d, p[8], order, out);
	return 1;
}

static inline real sign_of(real x)
{
	return SELECT(REAL(1.0f), REAL(-1.0f), x < 0.0f);
}

/* From inside a box: the nearest face's distance, the largest of q. */
static void box_inside(struct vec3r q, struct vec3r side, struct jetr *d)
{
	real most = real_max(q.x, real_max(q.y, q.z)), zero = REAL(0.0f);
	mask mx = q.x >= most;
	mask my = !mx && q.y >= most;

	d->value = most;
	d->gradient = vec3r(SELECT(zero, side.x, mx), SELECT(zero, side.y, my),
	    SELECT(side.z, zero, mx || my));
}

/*
 * From outside: |o|, o the positive parts of q. With g = o/|o| and k the third
 * axis, H_ii = (g_j^2 + g_k^2)/|o|, or 0 where o_i = 0; H_ij = -g_i g_j/|o|.
 * This form is exactly 0 off a face.
 */
static struct sym3r box_hessian(struct vec3r o, struct vec3r g, real inv,
    struct vec3r side)
{
	real xx = g.x * g.x, yy = g.y * g.y, zz = g.z * g.z;
	real zero = REAL(0.0f);

	return sym3r(SELECT(zero, inv * (yy + zz), o.x > 0.0f),
	    SELECT(zero, inv * (xx + zz), o.y > 0.0f),
	    SELECT(zero, inv * (xx + yy), o.z > 0.0f),
	    -inv * g.x * g.y * side.x * side.y,
	    -inv * g.x * g.z * side.x * side.z,
	    -inv * g.y * g.z * side.y * side.z);
}

static int box(__global const float *p, struct vec3r x, int order,
    struct jetr *out)
{
	struct vec3r d = vec3r_sub(x, vec3r_load(p));
	struct vec3r side = vec3r(sign_of(d.x), sign_of(d.y), sign_of(d.z));
	struct vec3r q = vec3r(d.x * side.x - p[3], d.y * side.y - p[4],
	    d.z * side.z - p[5]);
	real zero = REAL(0.0f), length;
	struct vec3r o = vec3r(real_max(q.x, zero), real_max(q.y, zero),
	    real_max(q.z, zero));
	struct vec3r g = unit(o, &length);
	mask outside = length > TINY;
	struct jetr jet;

	box_inside(q, side, &jet);
	jet.value = SELECT(jet.value, length, outside) - p[6];
	if (out_of_reach(jet.value * p[7]))
		return 0;
	jet.gradient = vec3r_select(jet.gradient,
	    vec3r(g.x * side.x, g.y * side.y, g.z * side.z), outside);
	if (order >= 2)
		jet.hessian = box_hessian(o, g, 1.0f /
		    real_max(length, REAL(AXIS_GUARD / p[7])), side);
	solid(&jet, p[7], order, out);
	return 1;
}

/*
 * Distance to a point of the half-plane at radius v from the axis, from (a, z)
 * beside it. guard bounds 1/distance in the second derivatives.
 */
static struct planar corner_distance(real a, real z, real v, float guard,
    const struct cylindrical *c)
{
	real length = sqrt(a * a + z * z);
	real unguarded = inverse(length);
	real inv = 1.0f / real_max(length, REAL(guard));
	real r = a * unguarded, s = z * unguarded;
	/* f_r/rho = (rho - v)/(rho length), also right at v = 0 on the axis */
	struct planar f = {length, r, s, inv * s * s, -inv * r * s, inv * r * r,
	    inv * (1.0f - v * c->inv_rho)};

	return f;
}

/* Distance to a straight line of the half-plane, outward normal (r, z). */
static struct planar line_distance(real distance, real r, real z,
    const struct cylindrical *c)
{
	real zero = REAL(0.0f);
	struct planar f = {distance, r, z, zero, zero, zero, r * c->inv_rho};

	return f;
}

static int solid_of_revolution(const struct planar *distance,
    const struct cylindrical *c, float inv_fall, int order, struct jetr *out)
{
	struct jetr d;

	if (out_of_reach(distance->value * inv_fall))
		return 0;
	revolve(distance, c, order, &d);
	solid(&d, inv_fall, order, out);
	return 1;
}

static int cylinder(__global const float *p, struct vec3r x, int order,
    struct jetr *out)
{
	struct cylindrical c = about_axis(p, p + 3, x, p[7]);
	real side = sign_of(c.z), zero = REAL(0.0f), one = REAL(1.0f);
	real q = c.rho - p[7], w = c.z * side - p[6];
	mask lateral = q >= w;
	struct planar f = line_distance(SELECT(w, q, lateral),
	    SELECT(zero, one, lateral), SELECT(side, zero, lateral), &c);

	f = planar_select(f, corner_distance(q, w * side, REAL(p[7]),
	    AXIS_GUARD / p[8], &c), q > 0.0f && w > 0.0f);
	return solid_of_revolution(&f, &c, p[8], order, out);
}

/*
 * Signed distance to the cone's profile: a convex polygon with corners (0,0),
 * (ra,0), (rb,length), (0,length), of which the edge on the axis is no border.
 */
static struct planar cone_profile(float length, float ra, float rb,
    float guard, const struct cylindrical *c)
{
	float wide = ra - rb, slant = sqrt(length * length + wide * wide);
	/* The side's direction (m, h); its outward normal is (h, -m). */
	float m = slant > 0.0f ? -wide / slant : 0.0f;
	float h = slant > 0.0f ? length / slant : 1.0f;
	real a = c->rho - ra, under = -c->z, over_top = c->z - length;
	real off = h * a - m * c->z, along = m * a + h * c->z;
	real zero = REAL(0.0f), one = REAL(1.0f);
	mask inside = off <= 0.0f && under <= 0.0f && over_top <= 0.0f;
	mask side = SELECT(
	    off > 0.0f && along >= 0.0f && along <= slant,
	    off >= under && off >= over_top, inside);
	mask bottom = !side && SELECT(under > 0.0f && c->rho < ra,
	    under >= over_top, inside);
	mask top = !side && !bottom &&
	    (inside || (over_top > 0.0f && c->rho < rb));
	mask low = along < 0.5f * slant;
	struct planar corner = corner_distance(
	    SELECT(c->rho - rb, a, low), SELECT(over_top, c->z, low),
	    SELECT(REAL(rb), REAL(ra), low), guard, c);
	struct planar line = line_distance(
	    SELECT(SELECT(over_top, under, bottom), off, side),
	    SELECT(zero, REAL(h), side),
	    SELECT(SELECT(one, -one, bottom), REAL(-m), side), c);

	return planar_select(corner, line, side || bottom || top);
}

static int cone(__global const float *p, struct vec3r x, int order,
    struct jetr *out)
{
	struct cylindrical c = about_axis(p, p + 3, x,
	    p[7] > p[8] ? p[7] : p[8]);
	struct planar f = cone_profile(p[6], p[7], p[8], AXIS_GUARD / p[9], &c);

	return solid_of_revolution(&f, &c, p[9], order, out);
}

static int torus(__global const float *p, struct vec3r x, int order,
    struct jetr *out)
{
	struct cylindrical c = about_axis(p, p + 3, x, p[6]);
	struct planar f = corner_distance(c.rho - p[6], c.z, REAL(p[6]),
	    AXIS_GUARD * p[7], &c);

	f.value -= p[7];
	return solid_of_revolution(&f, &c, p[8], order, out);
}

static int plane(__global const float *p, struct vec3r x, int order,
    struct jetr *out)
{
	struct vec3r u = vec3r_load(p + 3);
	struct jetr d;

	d.value = vec3r_dot(u, vec3r_sub(x, vec3r_load(p)));
	if (out_of_reach(d.value * p[6]))
		return 0;
	d.gradient = u;
	d.hessian = sym3r_identity(REAL(0.0f));
	solid(&d, p[6], order, out);
	return 1;
}

/*
 * The field of a primitive opcode at x, with derivatives up to order. 0: it is
 * 0 in all lanes, and *out is not written.
 */
static int primitive_eval(uint op, __global const float *params,
    struct vec3r x, int order, struct jetr *out)
{
	switch (op) {
	case OP_POINT:
		return point(params, x, order, out);
	case OP_SEGMENT:
		return segment(params, x, order, out);
	case OP_TRIANGLE:
		return triangle(params, x, order, out);
	case OP_DISC:
		return disc(params, x, order, out);
	case OP_CIRCLE:
		return circle(params, x, order, out);
	case OP_SPHERE:
		return sphere(params, x, order, out);
	case OP_BOX:
		return box(params, x, order, out);
	case OP_CYLINDER:
		return cylinder(params, x, order, out);
	case OP_CAPSULE:
		return capsule(params, x, order, out);
	case OP_CONE:
		return cone(params, x, order, out);
	case OP_TORUS:
		return torus(params, x, order, out);
	case OP_PLANE:
		return plane(params, x, order, out);
	}
	return 0;
}
