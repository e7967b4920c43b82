/*
 * Warps in coordinates of their own: X along e1, Y along e2 = u x e1, Z along
 * the axis u, from the point o that warp_prepare chose. Each type finds W's
 * three coordinates as jets in (X, Y, Z); warp_eval turns them into the frame.
 *
 * Departures from Barr 1984: the ends of the range are rounded (struct warp
 * says how far). A bend is seen from the middle of its arc, where its formulas
 * have no 1/rate; and it has an inverse everywhere but at its centre and
 * opposite its arc's middle, where Barr's has many.
 */
#include "core/warp.h"

#include <string.h>

#include "core/affine.h"
#include "core/jet.h"

/*
 * A bend's distance from its centre counts as at least this times its radius,
 * so that derivatives stay bounded: what lies nearer the centre is folded
 * there anyway.
 */
#define CENTER_GUARD 1e-3

/* t under which atan(t)/t is 1 - t^2/3, to t^4/5 < 1e-17. */
#define STRAIGHT 8e-5

/* A function of one variable, with two derivatives. */
struct curve1 {
	double value, slope, bend;
};

/* A unit vector across the unit vector u: from the axis furthest from it. */
static struct vec3 any_across(struct vec3 u)
{
	double x = fabs(u.x), y = fabs(u.y), z = fabs(u.z);
	struct vec3 v = x <= y && x <= z ? vec3(1.0, 0.0, 0.0)
	    : y <= z ? vec3(0.0, 1.0, 0.0) : vec3(0.0, 0.0, 1.0);

	return vec3_unit(vec3_cross(u, v));
}

/* The unit part of v across the unit vector u; twice, against rounding. */
static struct vec3 part_across(struct vec3 u, struct vec3 v)
{
	v = vec3_unit(v);
	v = vec3_unit(vec3_axpy(-vec3_dot(u, v), u, v));
	return vec3_unit(vec3_axpy(-vec3_dot(u, v), u, v));
}

/* sin(x)/x */
static double sinc(double x)
{
	return fabs(x) < 1e-4 ? 1.0 - x * x / 6.0 : sin(x) / x;
}

/*
 * Seen from the arc's middle its ends are at +-sin(h)/k along the tangent and
 * (1 - cos h)/k towards the centre.
 */
static void prepare_bend(const struct warp *w, double *p)
{
	double half = 0.5 * (w->to - w->from), h = w->rate * half;
	double quarter = sinc(0.5 * h);

	p[9] = w->rate;
	p[10] = half;
	p[11] = cos(h);
	p[12] = sin(h);
	p[13] = half * sinc(h);
	/* 1 - cos h = 2 sin^2(h/2) */
	p[14] = 0.5 * half * h * quarter * quarter;
}

void warp_prepare(const struct warp *w, double params[static WARP_PARAMS_MAX])
{
	struct vec3 u = vec3_unit(w->axis);
	double length = w->to - w->from;
	double start = w->type == WARP_BEND ? w->from + 0.5 * length : w->from;

	memset(params, 0, WARP_PARAMS_MAX * sizeof(*params));
	if (w->type == WARP_TWIST && !w->has_range)
		start = length = 0.0;
	vec3_put(params, vec3_axpy(start, u, w->center));
	vec3_put(params + 3, u);
	vec3_put(params + 6, w->type == WARP_BEND ? part_across(u, w->direction)
	    : any_across(u));
	if (w->type == WARP_BEND) {
		prepare_bend(w, params);
		return;
	}
	params[9] = w->type == WARP_TWIST ? w->rate : (w->scale - 1.0) / length;
	params[10] = length;
	params[11] = w->type == WARP_TWIST ? 0.0 : 1.0;
}

/*
 * From 0 for x < -m/2 to x for x > m/2: m P(x/m + 1/2), P(t) = t^6 - 3 t^5 +
 * 5/2 t^4 the integral of smootherstep. C3.
 */
static struct curve1 ramp(double x, double m)
{
	double t = x / m + 0.5;

	if (t <= 0.0)
		return (struct curve1){0.0, 0.0, 0.0};
	if (t >= 1.0)
		return (struct curve1){x, 1.0, 0.0};
	return (struct curve1){
	    m * t * t * t * t * (t * (t - 3.0) + 2.5),
	    t * t * t * (t * (6.0 * t - 15.0) + 10.0),
	    30.0 * t * t * (1.0 - t) * (1.0 - t) / m};
}

/* z held within [0, length], with rounded ends; all of z where length is 0. */
static struct curve1 hold(double z, double length)
{
	struct curve1 end;

	if (length == 0.0)
		return (struct curve1){z, 1.0, 0.0};
	if (z < 0.5 * length)
		return ramp(z, WARP_ROUNDED * length);
	/* ramp(z) - ramp(z - L) = L - ramp(L - z) here */
	end = ramp(length - z, WARP_ROUNDED * length);
	return (struct curve1){length - end.value, end.slope, -end.bend};
}

static struct jet coordinate(double value, double x, double y, double z)
{
	return (struct jet){.value = value, .gradient = {x, y, z}};
}

/* By -q about the axis, q(Z): X' = X cos q + Y sin q, Y' = Y cos q - X sin q,
 * so that X'_q = Y' and Y'_q = -X'. */
static void twist(const double *p, struct vec3 x, struct jet out[static 3])
{
	struct curve1 s = hold(x.z, p[10]);
	double q = p[11] + p[9] * s.value, c = cos(q), d = sin(q);
	double q1 = p[9] * s.slope, q2 = p[9] * s.bend;
	double xx = c * x.x + d * x.y, yy = c * x.y - d * x.x;

	out[0] = coordinate(xx, c, d, q1 * yy);
	out[0].hessian = (struct sym3){.xz = -q1 * d, .yz = q1 * c,
	    .zz = q2 * yy - q1 * q1 * xx};
	out[1] = coordinate(yy, -d, c, -q1 * xx);
	out[1].hessian = (struct sym3){.xz = -q1 * c, .yz = -q1 * d,
	    .zz = -q2 * xx - q1 * q1 * yy};
	out[2] = coordinate(x.z, 0.0, 0.0, 1.0);
}

/* X' = X v, Y' = Y v with v(Z) = 1/k, k the taper's factor at Z. */
static void taper(const double *p, struct vec3 x, struct jet out[static 3])
{
	struct curve1 s = hold(x.z, p[10]);
	double v = 1.0 / (p[11] + p[9] * s.value);
	double v1 = -v * v * p[9] * s.slope;
	double v2 = 2.0 * v1 * v1 / v - v * v * p[9] * s.bend;

	out[0] = coordinate(v * x.x, v, 0.0, v1 * x.x);
	out[0].hessian = (struct sym3){.xz = v1, .zz = v2 * x.x};
	out[1] = coordinate(v * x.y, 0.0, v, v1 * x.y);
	out[1].hessian = (struct sym3){.yz = v1, .zz = v2 * x.y};
	out[2] = coordinate(x.z, 0.0, 0.0, 1.0);
}

/* A jet in (s, t), s along the arc's middle and t towards the centre. */
struct planar {
	double value;
	double s, t;
	double ss, st, tt;
};

/* Where an arc or a straight end takes a point: along the axis, and off it. */
struct image {
	struct planar along, off;
};

/*
 * Barr's inverse bend seen from the arc's middle, a = k s, c = 1 - k t:
 * along = atan2(a, c)/k, off = (1 - r)/k = (2t - k (s^2 + t^2))/(1 + r), r^2 =
 * a^2 + c^2. With (e, f) = (a, c)/r: along_s = f/r, along_t = e/r, off_s =
 * -e, off_t = f.
 */
static void bend_arc(double k, double s, double t, struct image *out)
{
	double a = k * s, c = 1.0 - k * t, r = hypot(a, c);
	double g = 1.0 / fmax(r, CENTER_GUARD), m = k * g, mm = m * g;
	double e = r > 0.0 ? a / r : 0.0, f = r > 0.0 ? c / r : 1.0;
	bool straight = c > 0.0 && fabs(a) < STRAIGHT * c;

	out->along = (struct planar){
	    straight ? s / c * (1.0 - a / c * (a / c) / 3.0) : atan2(a, c) / k,
	    f * g, e * g, -2.0 * mm * e * f, mm * (f - e) * (f + e),
	    2.0 * mm * e * f};
	out->off = (struct planar){(2.0 * t - k * (s * s + t * t)) / (1.0 + r),
	    -e, f, -m * f * f, -m * e * f, -m * e * e};
}

/* The tangent at the end of the arc that side says, undone: the straight line
 * that goes on from it. */
static void bend_end(const double *p, double side, double s, double t,
    struct image *out)
{
	double ds = s - side * p[13], dt = t - p[14];
	double c = p[11], d = side * p[12];

	out->along = (struct planar){.value = side * p[10] + c * ds + d * dt,
	    .s = c, .t = d};
	out->off = (struct planar){.value = c * dt - d * ds, .s = -d, .t = c};
}

/* smootherstep of t = (|y| - half)/m + 1/2, y the arc's own coordinate: the
 * share of the straight end that y is nearer to. */
static struct planar end_share(const struct planar *y, double side,
    double half)
{
	double m = WARP_ROUNDED * 2.0 * half;
	struct curve1 r = ramp(side * y->value - half, m);
	double t = fmin(fmax((side * y->value - half) / m + 0.5, 0.0), 1.0);
	double w1 = side * r.bend;
	double w2 = 60.0 * t * (1.0 - t) * (1.0 - 2.0 * t) / (m * m);

	return (struct planar){r.slope, w1 * y->s, w1 * y->t,
	    w2 * y->s * y->s + w1 * y->ss, w2 * y->s * y->t + w1 * y->st,
	    w2 * y->t * y->t + w1 * y->tt};
}

/* a + w (b - a), b affine */
static struct planar mix(const struct planar *a, const struct planar *b,
    const struct planar *w)
{
	double d = b->value - a->value, ds = b->s - a->s, dt = b->t - a->t;
	double rest = 1.0 - w->value;

	return (struct planar){a->value + w->value * d,
	    a->s + w->value * ds + w->s * d, a->t + w->value * dt + w->t * d,
	    rest * a->ss + 2.0 * w->s * ds + w->ss * d,
	    rest * a->st + w->s * dt + w->t * ds + w->st * d,
	    rest * a->tt + 2.0 * w->t * dt + w->tt * d};
}

/* f(s, t) as one of (X, Z): s = Z c + X d + ..., t = X c - Z d + ... */
static struct jet unfold(const struct planar *f, double c, double d)
{
	struct vec3 s = vec3(d, 0.0, c), t = vec3(c, 0.0, -d);
	struct jet out = {f->value, vec3_axpy(f->t, t, vec3_scale(f->s, s)),
	    sym3_scale(f->ss, sym3_square(s))};

	out.hessian = sym3_axpy(f->tt, sym3_square(t), out.hessian);
	out.hessian = sym3_axpy(f->st, sym3_product(s, t), out.hessian);
	return out;
}

/*
 * The arc begins at Z = -half, on the axis, and turns from there towards e1 by
 * 2h. Its middle is (sin(h)/k, (1 - cos h)/k) from there, its tangent there
 * (c, d) in (Z, X): c = cos h, d = sin h.
 */
static void bend(const double *p, struct vec3 x, struct jet out[static 3])
{
	double half = p[10], c = p[11], d = p[12];
	double z = x.z + half;
	double s = c * z + d * x.x - p[13], t = c * x.x - d * z + p[14];
	struct image arc, end;
	struct planar w;
	double side;

	bend_arc(p[9], s, t, &arc);
	side = arc.along.value < 0.0 ? -1.0 : 1.0;
	w = end_share(&arc.along, side, half);
	if (w.value > 0.0) {
		bend_end(p, side, s, t, &end);
		arc.along = mix(&arc.along, &end.along, &w);
		arc.off = mix(&arc.off, &end.off, &w);
	}
	out[0] = unfold(&arc.off, c, d);
	out[1] = coordinate(x.y, 0.0, 1.0, 0.0);
	out[2] = unfold(&arc.along, c, d);
}

void warp_eval(unsigned type, const double *params, struct vec3 x, int order,
    struct warp_jet *out)
{
	static void (*const types[WARP_TYPE_COUNT])(const double *p,
	    struct vec3 x, struct jet out[static 3]) = {
		[WARP_TWIST] = twist, [WARP_TAPER] = taper, [WARP_BEND] = bend,
	};
	struct vec3 o = vec3_get(params), u = vec3_get(params + 3);
	struct vec3 e1 = vec3_get(params + 6), e2 = vec3_cross(u, e1);
	const struct vec3 axes[3] = {e1, e2, u};
	const double a[3][3] = {{e1.x, e1.y, e1.z}, {e2.x, e2.y, e2.z},
	    {u.x, u.y, u.z}};
	struct vec3 d = vec3_sub(x, o);
	struct jet w[3];

	types[type](params, vec3(vec3_dot(e1, d), vec3_dot(e2, d),
	    vec3_dot(u, d)), w);
	*out = (struct warp_jet){.point = o};
	for (int k = 0; k < 3; k++) {
		const double *axis = a[k];
		struct vec3 g = affine_pull_gradient(a, w[k].gradient);
		struct sym3 h = affine_pull_hessian(a, w[k].hessian);

		out->point = vec3_axpy(w[k].value, axes[k], out->point);
		for (int i = 0; i < 3 && order > 0; i++) {
			out->jacobian[i][0] += axis[i] * g.x;
			out->jacobian[i][1] += axis[i] * g.y;
			out->jacobian[i][2] += axis[i] * g.z;
		}
		for (int i = 0; i < 3 && order > 1; i++)
			out->second[i] = sym3_axpy(axis[i], h, out->second[i]);
	}
}

void warp_stretch(const struct warp *w, double *least, double *most)
{
	double narrowed = w->type == WARP_TAPER ? 1.0 / w->scale : 1.0;

	*least = fmin(1.0, narrowed);
	*most = fmax(1.0, narrowed);
}
