/*
 * Warps (core/warp.h), as core/warp.c has them in float64. p: the parameters
 * that warp_prepare gives. Like there, each type works in coordinates of its
 * own: X along e1, Y along e2, Z along the axis u.
 */

#define WARP_CENTER_GUARD 1e-3f

/* t under which atan(t)/t is 1 - t^2/3, to t^4/5 < 4e-8. */
#define WARP_STRAIGHT 0.02f

/* What no taper goes under, though float32 rounds its factor. */
#define WARP_TAPER_LEAST 1e-9f

/* What derivatives of W are held within, so that none overflows: only warps by
 * more than 1e6 in all come near. */
#define LIMIT_WARP_FIRST 1e15f
#define LIMIT_WARP_SECOND 1e25f

/* A function of one variable, with two derivatives. */
struct curver {
	real value, slope, bend;
};

/* W's three coordinates as functions of X, Y, Z: jets. */
struct warpr {
	struct jetr x, y, z;
};

/* m P(t), t = x/m + 1/2, P(t) = t^6 - 3 t^5 + 5/2 t^4; from 0 to x. */
static struct curver warp_ramp(real x, float m)
{
	real t = real_clamp(x / m + 0.5f, REAL(0.0f), REAL(1.0f));
	real s = 1.0f - t;
	struct curver r;

	r.value = SELECT(m * (t * t) * (t * t) * (t * (t - 3.0f) + 2.5f), x,
	    t >= REAL(1.0f));
	r.slope = t * t * t * (t * (6.0f * t - 15.0f) + 10.0f);
	r.bend = 30.0f / m * (t * t) * (s * s);
	return r;
}

/* z held within [0, length], with rounded ends; all of z where length is 0. */
static struct curver warp_hold(real z, float length)
{
	struct curver r = {z, REAL(1.0f), REAL(0.0f)};
	mask first;

	if (length == 0.0f)
		return r;
	/* ramp(z) - ramp(z - L) = L - ramp(L - z) beyond the middle */
	first = z < REAL(0.5f * length);
	r = warp_ramp(SELECT(length - z, z, first), WARP_ROUNDED * length);
	r.value = SELECT(length - r.value, r.value, first);
	r.bend = SELECT(-r.bend, r.bend, first);
	return r;
}

static inline struct jetr warp_coordinate(real value, real x, real y, real z)
{
	struct jetr f;

	f.value = value;
	f.gradient = vec3r(x, y, z);
	f.hessian = sym3r_identity(REAL(0.0f));
	return f;
}

#define WARP_TURN 6.28318548f
#define WARP_TURN_REST -1.74845553e-7f

/*
 * An angle less whole turns, in two parts (Cody and Waite 1980): to 1e-7 up to
 * 1e6 turns, beyond which float32 has no angles, and within half a turn and a
 * little whatever it was. PoCL's sine and cosine take another path for all
 * lanes where one's angle is over 125.
 */
static inline real warp_angle(real q)
{
	real turns = rint(q * (1.0f / WARP_TURN));

	q = fma(-turns, REAL(WARP_TURN), q);
	q = fma(-turns, REAL(WARP_TURN_REST), q);
	return real_clamp(q, REAL(-3.2f), REAL(3.2f));
}

/* By -q about the axis, q(Z): X' = X cos q + Y sin q, Y' = Y cos q - X sin q,
 * so that X'_q = Y' and Y'_q = -X'. */
static void warp_twist(__global const float *p, struct vec3r x,
    struct warpr *out)
{
	real zero = REAL(0.0f), one = REAL(1.0f);
	struct curver s = warp_hold(x.z, p[10]);
	real q = warp_angle(p[11] + p[9] * s.value), c = cos(q), d = sin(q);
	real q1 = p[9] * s.slope, q2 = p[9] * s.bend;
	real xx = c * x.x + d * x.y, yy = c * x.y - d * x.x;

	out->x = warp_coordinate(xx, c, d, q1 * yy);
	out->x.hessian = sym3r(zero, zero, q2 * yy - q1 * q1 * xx, zero,
	    -q1 * d, q1 * c);
	out->y = warp_coordinate(yy, -d, c, -q1 * xx);
	out->y.hessian = sym3r(zero, zero, -q2 * xx - q1 * q1 * yy, zero,
	    -q1 * c, -q1 * d);
	out->z = warp_coordinate(x.z, zero, zero, one);
}

/* X' = X v, Y' = Y v with v(Z) = 1/k, k the taper's factor at Z. With r =
 * k'/k: v' = -v r, v'' = v (2 r^2 - k''/k). */
static void warp_taper(__global const float *p, struct vec3r x,
    struct warpr *out)
{
	real zero = REAL(0.0f), one = REAL(1.0f);
	struct curver s = warp_hold(x.z, p[10]);
	real v = 1.0f / real_max(p[11] + p[9] * s.value,
	    REAL(WARP_TAPER_LEAST));
	real r = v * p[9] * s.slope;
	real v1 = -v * r, v2 = v * (2.0f * r * r - v * p[9] * s.bend);

	v1 = real_clamp(v1, REAL(-LIMIT_WARP_FIRST), REAL(LIMIT_WARP_FIRST));
	v2 = real_clamp(v2, REAL(-LIMIT_WARP_SECOND), REAL(LIMIT_WARP_SECOND));
	out->x = warp_coordinate(v * x.x, v, zero, v1 * x.x);
	out->x.hessian = sym3r(zero, zero, v2 * x.x, zero, v1, zero);
	out->y = warp_coordinate(v * x.y, zero, v, v1 * x.y);
	out->y.hessian = sym3r(zero, zero, v2 * x.y, zero, zero, v1);
	out->z = warp_coordinate(x.z, zero, zero, one);
}

/* A jet in (s, t), s along the arc's middle and t towards the centre. */
struct warp_planar {
	real value;
	real s, t;
	real ss, st, tt;
};

/* Where an arc or a straight end takes a point: along the axis, and off it. */
struct warp_image {
	struct warp_planar along, off;
};

/* sqrt(a^2 + c^2), also where a square overflows. */
static inline real warp_hypot(real a, real c)
{
	real most = real_max(fabs(a), fabs(c));
	real scale = real_max(most, REAL(1e-30f));

	a = a / scale;
	c = c / scale;
	return scale * sqrt(a * a + c * c);
}

/*
 * Barr's inverse bend seen from the arc's middle, a = k s, c = 1 - k t:
 * along = atan2(a, c)/k, off = (1 - r)/k = (2t - k (s^2 + t^2))/(1 + r), r^2 =
 * a^2 + c^2. With (e, f) = (a, c)/r: along_s = f/r, along_t = e/r, off_s =
 * -e, off_t = f.
 */
static void warp_arc(float k, real s, real t, struct warp_image *out)
{
	real a = k * s, c = 1.0f - k * t, r = warp_hypot(a, c);
	real g = 1.0f / real_max(r, REAL(WARP_CENTER_GUARD));
	real m = k * g, mm = m * g;
	mask off_center = r > REAL(1e-18f);
	real e = SELECT(REAL(0.0f), a / r, off_center);
	real f = SELECT(REAL(1.0f), c / r, off_center);
	mask straight = (c > REAL(0.0f)) &
	    (fabs(a) < WARP_STRAIGHT * c);
	real slope = a / c;

	out->along.value = SELECT(atan2(a, c) / k,
	    s / c * (1.0f - slope * slope * (1.0f / 3.0f)), straight);
	out->along.s = f * g;
	out->along.t = e * g;
	out->along.ss = -2.0f * mm * e * f;
	out->along.st = mm * (f - e) * (f + e);
	out->along.tt = 2.0f * mm * e * f;
	out->off.value = (2.0f * t - k * (s * s + t * t)) / (1.0f + r);
	out->off.s = -e;
	out->off.t = f;
	out->off.ss = -m * f * f;
	out->off.st = -m * e * f;
	out->off.tt = -m * e * e;
}

/* The tangent at the end of the arc that side says, undone: the straight line
 * that goes on from it. */
static void warp_end(__global const float *p, real side, real s, real t,
    struct warp_image *out)
{
	real ds = s - side * p[13], dt = t - p[14];
	real c = REAL(p[11]), d = side * p[12];
	real zero = REAL(0.0f);

	out->along.value = side * p[10] + c * ds + d * dt;
	out->along.s = c;
	out->along.t = d;
	out->along.ss = out->along.st = out->along.tt = zero;
	out->off.value = c * dt - d * ds;
	out->off.s = -d;
	out->off.t = c;
	out->off.ss = out->off.st = out->off.tt = zero;
}

/* smootherstep of (|y| - half)/m + 1/2, y the arc's own coordinate: the share
 * of the straight end that y is nearer to. */
static struct warp_planar warp_end_share(const struct warp_planar *y,
    real side, float half_length)
{
	float m = WARP_ROUNDED * 2.0f * half_length;
	real x = side * y->value - half_length;
	struct curver r = warp_ramp(x, m);
	real t = real_clamp(x / m + 0.5f, REAL(0.0f), REAL(1.0f));
	real w1 = side * r.bend;
	real w2 = 60.0f / m * t * (1.0f - t) * (1.0f - 2.0f * t) / m;
	struct warp_planar w;

	w.value = r.slope;
	w.s = w1 * y->s;
	w.t = w1 * y->t;
	w.ss = w2 * y->s * y->s + w1 * y->ss;
	w.st = w2 * y->s * y->t + w1 * y->st;
	w.tt = w2 * y->t * y->t + w1 * y->tt;
	return w;
}

/* a + w (b - a), b affine */
static struct warp_planar warp_mix(const struct warp_planar *a,
    const struct warp_planar *b, const struct warp_planar *w)
{
	real d = b->value - a->value, ds = b->s - a->s, dt = b->t - a->t;
	real rest = 1.0f - w->value;
	struct warp_planar f;

	f.value = a->value * rest + w->value * b->value;
	f.s = a->s + w->value * ds + w->s * d;
	f.t = a->t + w->value * dt + w->t * d;
	f.ss = rest * a->ss + 2.0f * w->s * ds + w->ss * d;
	f.st = rest * a->st + w->s * dt + w->t * ds + w->st * d;
	f.tt = rest * a->tt + 2.0f * w->t * dt + w->tt * d;
	return f;
}

/* f(s, t) as one of (X, Z): s = Z c + X d + ..., t = X c - Z d + ... */
static struct jetr warp_unfold(const struct warp_planar *f, float c, float d)
{
	struct vec3r s = vec3r(REAL(d), REAL(0.0f), REAL(c));
	struct vec3r t = vec3r(REAL(c), REAL(0.0f), REAL(-d));
	struct jetr out;

	out.value = f->value;
	out.gradient = vec3r_axpy(f->t, t, vec3r_scale(f->s, s));
	out.hessian = sym3r_axpy(f->tt, sym3r_square(t),
	    sym3r_scale(f->ss, sym3r_square(s)));
	out.hessian = sym3r_axpy(f->st, sym3r_product(s, t), out.hessian);
	return out;
}

/*
 * The arc begins at Z = -half, on the axis, and turns from there towards e1 by
 * 2h. Its middle is (sin(h)/k, (1 - cos h)/k) from there, its tangent there
 * (c, d) in (Z, X): c = cos h, d = sin h.
 */
static void warp_bend(__global const float *p, struct vec3r x,
    struct warpr *out)
{
	float c = p[11], d = p[12];
	real z = x.z + p[10];
	real s = c * z + d * x.x - p[13], t = c * x.x - d * z + p[14];
	struct warp_image arc, end;
	struct warp_planar w;
	real side;

	warp_arc(p[9], s, t, &arc);
	side = SELECT(REAL(1.0f), REAL(-1.0f), arc.along.value < REAL(0.0f));
	w = warp_end_share(&arc.along, side, p[10]);
	if (ANY(w.value > REAL(0.0f))) {
		warp_end(p, side, s, t, &end);
		arc.along = warp_mix(&arc.along, &end.along, &w);
		arc.off = warp_mix(&arc.off, &end.off, &w);
	}
	out->x = warp_unfold(&arc.off, c, d);
	out->y = warp_coordinate(x.y, REAL(0.0f), REAL(1.0f), REAL(0.0f));
	out->z = warp_unfold(&arc.along, c, d);
}

/* The rows of the rotation into a warp's own coordinates. */
struct warp_axes {
	struct vec3r x, y, z;
};

static inline struct warp_axes warp_axes(__global const float *p)
{
	struct warp_axes a;

	a.x = vec3r_load(p + 6);
	a.z = vec3r_load(p + 3);
	a.y = vec3r_cross(a.z, a.x);
	return a;
}

static inline struct warp_axes warp_axes_back(const struct warp_axes *a)
{
	struct warp_axes t;

	t.x = vec3r(a->x.x, a->y.x, a->z.x);
	t.y = vec3r(a->x.y, a->y.y, a->z.y);
	t.z = vec3r(a->x.z, a->y.z, a->z.z);
	return t;
}

static inline struct vec3r warp_turn(const struct warp_axes *a,
    struct vec3r v)
{
	return vec3r(vec3r_dot(a->x, v), vec3r_dot(a->y, v),
	    vec3r_dot(a->z, v));
}

/* a h a^T */
static inline struct sym3r warp_turn_square(const struct warp_axes *a,
    struct sym3r h)
{
	struct vec3r x = sym3r_apply(h, a->x), y = sym3r_apply(h, a->y);
	struct vec3r z = sym3r_apply(h, a->z);

	return sym3r(vec3r_dot(a->x, x), vec3r_dot(a->y, y),
	    vec3r_dot(a->z, z), vec3r_dot(a->x, y), vec3r_dot(a->x, z),
	    vec3r_dot(a->y, z));
}

static void warp_own(uint type, __global const float *p,
    const struct warp_axes *axes, struct vec3r x, struct warpr *w)
{
	x = warp_turn(axes, vec3r_sub(x, vec3r_load(p)));
	switch (type) {
	case WARP_TWIST:
		warp_twist(p, x, w);
		break;
	case WARP_TAPER:
		warp_taper(p, x, w);
		break;
	default:
		warp_bend(p, x, w);
		break;
	}
}

/* W(x) */
static struct vec3r warp_point(uint type, __global const float *p,
    struct vec3r x)
{
	struct warp_axes axes = warp_axes(p), back = warp_axes_back(&axes);
	struct warpr w;

	warp_own(type, p, &axes, x, &w);
	return vec3r_add(vec3r_load(p),
	    warp_turn(&back, vec3r(w.x.value, w.y.value, w.z.value)));
}

/* One coordinate's derivatives within limits. */
static inline void warp_limit(struct jetr *f)
{
	f->gradient = vec3r_limit(f->gradient, LIMIT_WARP_FIRST);
	f->hessian = sym3r_limit(f->hessian, LIMIT_WARP_SECOND);
}

/* The chain rule's second order: J^T H J + sum of g_i W_i''. */
static struct sym3r warp_second(const struct warpr *w, struct vec3r g,
    struct sym3r h)
{
	struct vec3r x = w->x.gradient, y = w->y.gradient, z = w->z.gradient;
	struct sym3r r = sym3r_scale(g.x, w->x.hessian);

	r = sym3r_axpy(g.y, w->y.hessian, r);
	r = sym3r_axpy(g.z, w->z.hessian, r);
	r = sym3r_axpy(h.xx, sym3r_square(x), r);
	r = sym3r_axpy(h.yy, sym3r_square(y), r);
	r = sym3r_axpy(h.zz, sym3r_square(z), r);
	r = sym3r_axpy(h.xy, sym3r_product(x, y), r);
	r = sym3r_axpy(h.xz, sym3r_product(x, z), r);
	return sym3r_axpy(h.yz, sym3r_product(y, z), r);
}

/* Carries f, at W(x), through W: the chain rule to order, at least 1. */
static void warp_carry(uint type, __global const float *p, struct vec3r x,
    struct jetr *f, int order)
{
	struct warp_axes axes = warp_axes(p), back = warp_axes_back(&axes);
	struct warpr w;
	struct vec3r g;

	warp_own(type, p, &axes, x, &w);
	warp_limit(&w.x);
	warp_limit(&w.y);
	warp_limit(&w.z);
	g = warp_turn(&axes, f->gradient);
	if (order >= 2)
		f->hessian = warp_turn_square(&back, warp_second(&w, g,
		    warp_turn_square(&axes, f->hessian)));
	f->gradient = warp_turn(&back, vec3r_axpy(g.z, w.z.gradient,
	    vec3r_axpy(g.y, w.y.gradient, vec3r_scale(g.x, w.x.gradient))));
}
