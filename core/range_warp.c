/*
 * Boxes about what a warp makes of a patch, by interval arithmetic of the
 * formulas in core/warp.c, in the warp's own coordinates X, Y, Z.
 */
#include "core/range_parts.h"

#include <math.h>

#include "core/warp.h"

#define PI 3.14159265358979323846

static double dmax(double a, double b)
{
	return a > b ? a : b;
}

static double dmin(double a, double b)
{
	return a < b ? a : b;
}

static struct range hull(struct range a, struct range b)
{
	return (struct range){dmin(a.least, b.least), dmax(a.most, b.most)};
}

static struct range product(struct range a, struct range b)
{
	double p = a.least * b.least, q = a.least * b.most;
	double r = a.most * b.least, s = a.most * b.most;

	return (struct range){dmin(dmin(p, q), dmin(r, s)),
	    dmax(dmax(p, q), dmax(r, s))};
}

/* a x + b y */
static struct range combine(double a, struct range x, double b,
    struct range y)
{
	struct range p = product((struct range){a, a}, x);
	struct range q = product((struct range){b, b}, y);

	return (struct range){p.least + q.least, p.most + q.most};
}

static struct range moved(struct range r, double by)
{
	return (struct range){r.least + by, r.most + by};
}

static struct range difference(struct range a, struct range b)
{
	return (struct range){a.least - b.most, a.most - b.least};
}

static double size_of(struct range r)
{
	return dmax(fabs(r.least), fabs(r.most));
}

/* sin and 1 - cos of a half turn are the most that a turn does. */
static double turned(double angle)
{
	return 2.0 * sin(0.5 * dmin(angle, PI));
}

/* As warp.c's ramp and hold, which rise: values alone. */
static double ramp(double x, double m)
{
	double t = x / m + 0.5;

	if (t <= 0.0)
		return 0.0;
	return t >= 1.0 ? x : m * t * t * t * t * (t * (t - 3.0) + 2.5);
}

static double hold(double z, double length)
{
	if (length == 0.0)
		return z;
	return z < 0.5 * length ? ramp(z, WARP_ROUNDED * length) :
	    length - ramp(length - z, WARP_ROUNDED * length);
}

/* Each returns how much faster than in x the point moves at most. */

/* A turn by q back about the axis: that of the middle's q, and a step of at
 * most the distance from the axis times what is left of the angle. */
static double twist(const double *p, const struct range x[static 3],
    struct range out[static 3])
{
	double q1 = p[11] + p[9] * hold(x[2].least, p[10]);
	double q2 = p[11] + p[9] * hold(x[2].most, p[10]);
	double q = 0.5 * (q1 + q2), left = 0.5 * fabs(q2 - q1);
	double rho = hypot(size_of(x[0]), size_of(x[1]));
	double step = rho * turned(left), c = cos(q), s = sin(q);

	out[0] = combine(c, x[0], s, x[1]);
	out[1] = combine(c, x[1], -s, x[0]);
	for (int i = 0; i < 2; i++) {
		out[i].least = dmax(out[i].least - step, -rho);
		out[i].most = dmin(out[i].most + step, rho);
	}
	out[2] = x[2];
	return 1.0 + fabs(p[9]) * rho;
}

static double taper(const double *p, const struct range x[static 3],
    struct range out[static 3])
{
	double v1 = 1.0 / (p[11] + p[9] * hold(x[2].least, p[10]));
	double v2 = 1.0 / (p[11] + p[9] * hold(x[2].most, p[10]));
	struct range v = {dmin(v1, v2), dmax(v1, v2)};

	out[0] = product(x[0], v);
	out[1] = product(x[1], v);
	out[2] = x[2];
	return dmax(1.0, v.most) + v.most * v.most * fabs(p[9]) *
	    hypot(size_of(x[0]), size_of(x[1]));
}

/* The slope where W jumps. */
#define UNKNOWN 1e30

/* As in core/warp.c. */
#define CENTER_GUARD 1e-3

/* t under which atan(t)/t is taken for 1 - t^2/3 .. 1. */
#define STRAIGHT 1e-4

/* The arc's coordinates of (s, t): along it and off it. The slope of along is
 * 1 over the distance from the centre. */
static double bend_arc(double k, struct range s, struct range t,
    struct range *along, struct range *off)
{
	struct range a = product((struct range){k, k}, s);
	struct range c = moved(product((struct range){-k, -k}, t), 1.0);
	double near = hypot(a.least > 0.0 ? a.least : a.most < 0.0 ? a.most :
	    0.0, c.least > 0.0 ? c.least : c.most < 0.0 ? c.most : 0.0);
	double far = hypot(size_of(a), size_of(c));
	double st = dmax(size_of(s), size_of(t)), most = PI / fabs(k);
	double angle[4] = {atan2(a.least, c.least), atan2(a.least, c.most),
	    atan2(a.most, c.least), atan2(a.most, c.most)};
	struct range tt = {t.least >= 0.0 || t.most <= 0.0 ?
	    dmin(t.least * t.least, t.most * t.most) : 0.0,
	    size_of(t) * size_of(t)};
	struct range ss = {s.least >= 0.0 || s.most <= 0.0 ?
	    dmin(s.least * s.least, s.most * s.most) : 0.0,
	    size_of(s) * size_of(s)};
	struct range up, down = {1.0 / (1.0 + far), 1.0 / (1.0 + near)};

	/* (2t - k (s^2 + t^2)) / (1 + r), and (1 - r)/k: the tighter one */
	up = (struct range){2.0 * t.least, 2.0 * t.most};
	tt = product((struct range){-k, -k},
	    (struct range){ss.least + tt.least, ss.most + tt.most});
	up = (struct range){up.least + tt.least, up.most + tt.most};
	*off = product(up, down);
	if (fabs(k) * st > 1e-12) {
		struct range r = {dmin((1.0 - far) / k, (1.0 - near) / k),
		    dmax((1.0 - far) / k, (1.0 - near) / k)};

		off->least = dmax(off->least, r.least - 1e-9 * st);
		off->most = dmin(off->most, r.most + 1e-9 * st);
	}
	if (c.least > 0.0 && size_of(a) < STRAIGHT * c.least) {
		double x = size_of(a) / c.least;

		*along = product(product(s,
		    (struct range){1.0 / c.most, 1.0 / c.least}),
		    (struct range){1.0 - x * x / 3.0, 1.0});
		return dmax(1.0, 1.0 / dmax(near, CENTER_GUARD));
	}
	if (c.least <= 0.0 && a.least <= 0.0 && a.most >= 0.0) {
		*along = (struct range){-most, most};
		return UNKNOWN;
	}
	*along = (struct range){angle[0] / k, angle[0] / k};
	for (int i = 1; i < 4; i++)
		*along = hull(*along, (struct range){angle[i] / k,
		    angle[i] / k});
	return dmax(1.0, 1.0 / dmax(near, CENTER_GUARD));
}

/* (1 - w) a + w b, which is linear in each. */
static struct range mixed(struct range a, struct range b, struct range w)
{
	return (struct range){
	    dmin(a.least + w.least * (b.least - a.least),
	    a.least + w.most * (b.least - a.least)),
	    dmax(a.most + w.least * (b.most - a.most),
	    a.most + w.most * (b.most - a.most))};
}

/* 6 t^5 - 15 t^4 + 10 t^3: the slope of ramp. */
static double share(double y, double half)
{
	double t = dmin(dmax((y - half) / (WARP_ROUNDED * 2.0 * half) + 0.5,
	    0.0), 1.0);

	return t * t * t * (t * (6.0 * t - 15.0) + 10.0);
}

static double bend(const double *p, const struct range x[static 3],
    struct range out[static 3])
{
	double half = p[10], c = p[11], d = p[12];
	struct range z = moved(x[2], half);
	struct range s = moved(combine(c, z, d, x[0]), -p[13]);
	struct range t = moved(combine(c, x[0], -d, z), p[14]);
	struct range arc_along, arc_off, along, off;
	double slope, apart, steepest;
	bool any = false;

	slope = steepest = bend_arc(p[9], s, t, &arc_along, &arc_off);
	along = arc_along;
	off = arc_off;
	for (int i = 0; i < 2; i++) {
		double side = i == 0 ? -1.0 : 1.0;
		double y1 = side * arc_along.least;
		double y2 = side * arc_along.most;
		struct range w = {share(dmin(y1, y2), half),
		    share(dmax(y1, y2), half)};
		struct range ds = moved(s, -side * p[13]);
		struct range dt = moved(t, -p[14]), end_along, end_off;

		/* this side has none of it */
		if (dmax(y1, y2) < 0.0)
			continue;
		end_along = moved(combine(c, ds, side * d, dt), side * half);
		end_off = combine(c, dt, -side * d, ds);
		/* share's slope is 15/8 over the mixed piece's length */
		apart = hypot(size_of(difference(end_along, arc_along)),
		    size_of(difference(end_off, arc_off)));
		if (w.least < 1.0 && w.most > 0.0)
			steepest = dmax(steepest, slope * (1.0 +
			    apart * 1.875 / (WARP_ROUNDED * 2.0 * half)));
		end_along = mixed(arc_along, end_along, w);
		end_off = mixed(arc_off, end_off, w);
		along = any ? hull(along, end_along) : end_along;
		off = any ? hull(off, end_off) : end_off;
		any = true;
	}
	out[0] = off;
	out[1] = x[1];
	out[2] = along;
	return steepest;
}

void range_warp(OPCODE_UINT type, const double *params, const struct patch *s,
    struct patch *out)
{
	static double (*const types[WARP_TYPE_COUNT])(const double *p,
	    const struct range x[static 3], struct range out[static 3]) = {
		[WARP_TWIST] = twist, [WARP_TAPER] = taper, [WARP_BEND] = bend,
	};
	struct vec3 o = vec3_get(params), u = vec3_get(params + 3);
	struct vec3 e1 = vec3_get(params + 6), d = vec3_sub(s->c, o);
	const struct vec3 axes[3] = {e1, vec3_cross(u, e1), u};
	struct range x[3], w[3];

	for (int i = 0; i < 3; i++) {
		double at = vec3_dot(axes[i], d);
		double reach = patch_across(s, axes[i]);

		x[i] = (struct range){at - reach, at + reach};
	}
	*out = (struct patch){.c = o, .n = 3};
	out->speed = s->speed * types[type](params, x, w);
	for (int i = 0; i < 3; i++) {
		out->c = vec3_axpy(0.5 * (w[i].least + w[i].most), axes[i],
		    out->c);
		out->v[i] = vec3_scale(0.5 * (w[i].most - w[i].least), axes[i]);
	}
	patch_finish(out);
}
