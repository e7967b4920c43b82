/*
 * Primitives over a patch. Where a skeleton or a solid is convex, so is the
 * distance d from it: with e from the nearest point of it to the middle c, and
 * E the most that e.(x - c) is over the patch,
 *   d - E/d <= distance <= sqrt(d^2 + 2 E + r^2),
 * the first because a convex function lies above its tangent, the second
 * because it is the distance from that nearest point. Along a ray a convex
 * function is between its ends' tangents and the larger end, and its slope
 * between its slopes at the ends.
 */
#include "core/range_parts.h"

#include <math.h>

#include "core/convolution.h"
#include "core/jet.h"
#include "core/primitive.h"

static double dmax(double a, double b)
{
	return a > b ? a : b;
}

static double dmin(double a, double b)
{
	return a < b ? a : b;
}

static double clamp(double x, double least, double most)
{
	return dmin(dmax(x, least), most);
}

static double square(double x)
{
	return x * x;
}

/* Squares of distances from something convex, e away in the middle. */
static struct range squares(struct vec3 e, const struct patch *s)
{
	double dd = vec3_dot(e, e), across = patch_across(s, e);

	return (struct range){
	    across < dd ? dd - 2.0 * across + across * across / dd : 0.0,
	    dd + 2.0 * across + s->r * s->r};
}

/* A number over a patch and its slopes, as struct held. */
struct run {
	double least, most, fall, rise;
};

/* Of a convex function that is f[i] at the ends of a ray's stretch (t = -1 and
 * 1), with slopes df[i]. */
static struct run between(const double f[static 2], const double df[static 2])
{
	struct run out = {0.0, dmax(f[0], f[1]), df[0], dmax(df[0], df[1])};
	double bend = df[1] - df[0];

	if (df[0] >= 0.0)
		out.least = f[0];
	else if (df[1] <= 0.0)
		out.least = f[1];
	else /* where the tangents meet */
		out.least = (df[1] * f[0] - df[0] * f[1] +
		    2.0 * df[0] * df[1]) / bend;
	out.least = dmin(out.least, dmin(f[0], f[1]));
	return out;
}

/* of what is steep at most */
static struct run steep(struct range r, double slope)
{
	return (struct run){r.least, r.most, -slope, slope};
}

static void product(double a1, double a2, double b1, double b2, double *least,
    double *most)
{
	double p = a1 * b1, q = a1 * b2, r = a2 * b1, s = a2 * b2;

	*least = dmin(dmin(p, q), dmin(r, s));
	*most = dmax(dmax(p, q), dmax(r, s));
}

/* The end of a ray's stretch. */
static struct vec3 end_of(const struct patch *s, int i)
{
	return vec3_axpy(i == 0 ? -1.0 : 1.0, s->v[0], s->c);
}

/* Squares of distances from a convex skeleton; from: the nearest place of it
 * to x. */
static struct run squares_run(const double *p,
    struct vec3 (*from)(const double *p, struct vec3 x), const struct patch *s)
{
	double f[2], df[2];
	struct run out;

	if (s->n > 1) {
		struct range dd = squares(from(p, s->c), s);

		return steep(dd, s->speed > 0.0 ?
		    2.0 * sqrt(dd.most) * s->speed : 0.0);
	}
	for (int i = 0; i < 2; i++) {
		struct vec3 e = from(p, end_of(s, i));

		f[i] = vec3_dot(e, e);
		df[i] = 2.0 * vec3_dot(e, s->v[0]);
	}
	out = between(f, df);
	out.least = dmax(out.least, 0.0);
	return out;
}

/* ---- soft objects ---- */

/* (1 - S)^n */
static double power(double s, double n)
{
	double b = 1.0 - s;

	if (!(b > 0.0))
		return 0.0;
	return n == 3.0 ? b * b * b : n == 2.0 ? b * b : pow(b, n);
}

/* weight (1 - S)^n, which falls as S rises, the less the larger S is. */
static void put_soft(const struct run *s, double n, double weight,
    struct held *out)
{
	double flat, steepest;

	*out = (struct held){weight * power(s->most, n),
	    weight * power(s->least, n), 0.0, 0.0, false};
	if (s->fall == 0.0 && s->rise == 0.0)
		return;
	flat = -n * weight * power(s->most, n - 1.0);
	steepest = -n * weight * power(s->least, n - 1.0);
	product(steepest, flat, s->fall, s->rise, &out->fall, &out->rise);
}

static struct run scaled(struct run r, double by)
{
	return (struct run){r.least * by, r.most * by, r.fall * by,
	    r.rise * by};
}

static struct vec3 from_point(const double *p, struct vec3 x)
{
	return vec3_sub(x, vec3_get(p));
}

/* Of a box along the axes: from its nearest place, and from its furthest. */
static struct run box_squares(const double *p, const struct patch *s)
{
	const double x = fabs(s->c.x - p[0]), y = fabs(s->c.y - p[1]);
	const double z = fabs(s->c.z - p[2]);
	struct range dd = {square(dmax(x - s->h[0], 0.0)) +
	    square(dmax(y - s->h[1], 0.0)) + square(dmax(z - s->h[2], 0.0)),
	    square(x + s->h[0]) + square(y + s->h[1]) + square(z + s->h[2])};

	return steep(dd, s->speed > 0.0 ? 2.0 * sqrt(dd.most) * s->speed : 0.0);
}

static void point(const double *p, const struct patch *s, struct held *out)
{
	struct run dd = s->is_box ? box_squares(p, s) :
	    squares_run(p, from_point, s);

	dd = scaled(dd, p[3]);
	put_soft(&dd, p[4], p[5], out);
}

/* From the nearest place of a stretch of a line to x. */
static struct vec3 from_line(struct vec3 a, struct vec3 u, double length,
    struct vec3 x)
{
	struct vec3 e = vec3_sub(x, a);

	return vec3_axpy(-clamp(vec3_dot(u, e), 0.0, length), u, e);
}

static struct vec3 from_segment(const double *p, struct vec3 x)
{
	return from_line(vec3_get(p), vec3_get(p + 3), p[6], x);
}

/* S = d^2 q, q = 1/R^2 with R linear in where the nearest place is. */
static void segment(const double *p, const struct patch *s, struct held *out)
{
	struct vec3 u = vec3_get(p + 3);
	struct run dd = squares_run(p, from_segment, s);
	double along, reach, r1, r2, q1, q2, turn, a1, a2, b1, b2;

	if (p[8] == 0.0) {
		dd = scaled(dd, 1.0 / square(p[7]));
		put_soft(&dd, p[9], p[10], out);
		return;
	}
	along = vec3_dot(u, vec3_sub(s->c, vec3_get(p)));
	reach = patch_across(s, u);
	r1 = p[7] + p[8] * clamp(along - reach, 0.0, p[6]);
	r2 = p[7] + p[8] * clamp(along + reach, 0.0, p[6]);
	q1 = 1.0 / square(dmax(dmax(r1, r2), 1e-15 * p[7]));
	q2 = 1.0 / square(dmax(dmin(r1, r2), 1e-15 * p[7]));
	/* q' = -2 R'/R^3, and R' is p8 u.v or 0 */
	turn = s->n > 1 ? fabs(p[8]) * s->speed : -p[8] * vec3_dot(u, s->v[0]);
	turn *= 2.0 * q2 * sqrt(q2);
	if (r1 == r2)
		turn = 0.0;
	product(dd.fall, dd.rise, q1, q2, &a1, &a2);
	product(dmin(turn, s->n > 1 ? -turn : 0.0), dmax(turn, 0.0), dd.least,
	    dd.most, &b1, &b2);
	dd = (struct run){dd.least * q1, dd.most * q2, a1 + b1, a2 + b2};
	put_soft(&dd, p[9], p[10], out);
}

/* Below this ratio of |ab x ac| to |ab| |ac| a triangle is its three edges. */
#define SLIVER 1e-6

static struct vec3 from_edge(struct vec3 a, struct vec3 b, struct vec3 x)
{
	struct vec3 ab = vec3_sub(b, a);
	double length = vec3_norm(ab);

	return from_line(a, vec3_scale(length > 0.0 ? 1.0 / length : 0.0, ab),
	    length, x);
}

static bool over(const struct vec3 corner[static 3], struct vec3 n,
    struct vec3 x)
{
	for (int i = 0; i < 3; i++) {
		struct vec3 a = corner[i], b = corner[(i + 1) % 3];

		if (!(vec3_dot(vec3_cross(n, vec3_sub(b, a)),
		    vec3_sub(x, a)) > 0.0))
			return false;
	}
	return true;
}

static struct vec3 from_triangle(const double *p, struct vec3 x)
{
	const struct vec3 corner[3] = {vec3_get(p), vec3_get(p + 3),
	    vec3_get(p + 6)};
	struct vec3 ab = vec3_sub(corner[1], corner[0]);
	struct vec3 ac = vec3_sub(corner[2], corner[0]);
	struct vec3 n = vec3_cross(ab, ac), best, e;
	double size = vec3_norm(n);

	if (size > SLIVER * vec3_norm(ab) * vec3_norm(ac)) {
		n = vec3_scale(1.0 / size, n);
		if (over(corner, n, x))
			return vec3_scale(vec3_dot(n, vec3_sub(x, corner[0])),
			    n);
	}
	best = from_edge(corner[0], corner[1], x);
	for (int i = 1; i < 3; i++) {
		e = from_edge(corner[i], corner[(i + 1) % 3], x);
		if (vec3_dot(e, e) < vec3_dot(best, best))
			best = e;
	}
	return best;
}

static void triangle(const double *p, const struct patch *s, struct held *out)
{
	struct run dd = scaled(squares_run(p, from_triangle, s), p[9]);

	put_soft(&dd, p[10], p[11], out);
}

/* The middle about an axis through a, and what its patch spans: rho is convex,
 * too. */
struct about {
	struct vec3 u, radial; /* radial: of length rho */
	double rho, z;
	struct range rhos, zs;
};

static struct about about_axis(const double *p, const struct patch *s)
{
	struct about a = {.u = vec3_get(p + 3)};
	struct vec3 d = vec3_sub(s->c, vec3_get(p));
	double reach = patch_across(s, a.u);
	struct range rr;

	a.z = vec3_dot(a.u, d);
	a.radial = vec3_axpy(-a.z, a.u, d);
	a.rho = vec3_norm(a.radial);
	rr = squares(a.radial, s);
	a.rhos = (struct range){sqrt(rr.least), sqrt(rr.most)};
	a.zs = (struct range){a.z - reach, a.z + reach};
	return a;
}

static double least_size(struct range r)
{
	return r.least > 0.0 ? r.least : r.most < 0.0 ? -r.most : 0.0;
}

static double most_size(struct range r)
{
	return dmax(fabs(r.least), fabs(r.most));
}

static struct vec3 radial_unit(const struct about *a)
{
	return vec3_scale(a->rho > 0.0 ? 1.0 / a->rho : 0.0, a->radial);
}

static struct vec3 from_disc(const double *p, struct vec3 x)
{
	struct vec3 u = vec3_get(p + 3), d = vec3_sub(x, vec3_get(p));
	double z = vec3_dot(u, d), rho;
	struct vec3 radial = vec3_axpy(-z, u, d);

	rho = vec3_norm(radial);
	return vec3_axpy(rho > p[6] ? 1.0 - p[6] / rho : 0.0, radial,
	    vec3_scale(z, u));
}

static void disc(const double *p, const struct patch *s, struct held *out)
{
	struct run dd = scaled(squares_run(p, from_disc, s), p[7]);

	put_soft(&dd, p[8], p[9], out);
}

/* Squares of distances from a ring: no convex shape. */
static struct range ring_squares(const struct about *a, double radius,
    const struct patch *s)
{
	struct range off = {a->rhos.least - radius, a->rhos.most - radius};
	struct range out = {square(least_size(off)) +
	    square(least_size(a->zs)), square(most_size(off)) +
	    square(most_size(a->zs))};
	struct vec3 e = vec3_axpy(a->rho - radius, radial_unit(a),
	    vec3_scale(a->z, a->u));
	double d = vec3_norm(e);

	out.least = dmax(out.least, square(dmax(d - s->r, 0.0)));
	out.most = dmin(out.most, dmin(square(d + s->r),
	    d * d + 2.0 * patch_across(s, e) + s->r * s->r));
	if (a->rho == 0.0) /* any place of the ring is the nearest */
		out.most = square(d + s->r);
	return out;
}

/*
 * A ring's distance d has the slope e.v/d, and bends by no more than 1/d across
 * the ring and 1/rho (where d < rho) around it.
 */
static struct run ring_run(const struct about *a, double radius,
    struct range dd, const struct patch *s)
{
	struct range d = {sqrt(dd.least), sqrt(dd.most)};
	struct run out = {d.least, d.most, -s->speed, s->speed};
	struct vec3 e = vec3_axpy(a->rho - radius, radial_unit(a),
	    vec3_scale(a->z, a->u));
	double size = vec3_norm(e), slope, bend;

	if (s->n > 1 || !(d.least > 0.0) || !(a->rhos.least > 0.0))
		return out;
	slope = vec3_dot(e, s->v[0]) / size;
	bend = square(s->speed) * dmax(1.0 / d.least, 1.0 / a->rhos.least);
	out.fall = dmax(out.fall, slope - bend);
	out.rise = dmin(out.rise, slope + bend);
	return out;
}

static void circle(const double *p, const struct patch *s, struct held *out)
{
	struct about a = about_axis(p, s);
	struct range dd = ring_squares(&a, p[6], s);
	struct run d = ring_run(&a, p[6], dd, s), square_run;

	square_run = (struct run){dd.least, dd.most, 0.0, 0.0};
	product(2.0 * d.least, 2.0 * d.most, d.fall, d.rise, &square_run.fall,
	    &square_run.rise);
	square_run = scaled(square_run, p[7]);
	put_soft(&square_run, p[8], p[9], out);
}

/* ---- solids ---- */

double range_falloff(double d, double inv_fall)
{
	double t = clamp(d * inv_fall, -1.0, 1.0), w = 1.0 - t;

	return w * w * w * (8.0 + t * (9.0 + 3.0 * t)) / 16.0;
}

double range_falloff_slope(double d, double inv_fall)
{
	double t = clamp(d * inv_fall, -1.0, 1.0);

	return -15.0 / 16.0 * square(1.0 - t * t) * inv_fall;
}

static void put_solid(const struct run *d, double inv_fall, struct held *out)
{
	bool across = d->least < 0.0 && d->most > 0.0;
	double s1, s2;

	*out = (struct held){range_falloff(d->most, inv_fall),
	    range_falloff(d->least, inv_fall), 0.0, 0.0, false};
	if (d->fall == 0.0 && d->rise == 0.0)
		return;
	s1 = range_falloff_slope(d->least, inv_fall);
	s2 = range_falloff_slope(d->most, inv_fall);
	product(across ? range_falloff_slope(0.0, inv_fall) : dmin(s1, s2),
	    dmax(s1, s2), d->fall, d->rise, &out->fall, &out->rise);
}

static struct run moved(struct run r, double by)
{
	return (struct run){r.least + by, r.most + by, r.fall, r.rise};
}

/* Signed distance to a convex solid at a point, and its gradient. */
struct pole {
	double d;
	struct vec3 g;
};

/* What such a distance spans. */
static struct run poles(const double *p,
    struct pole (*pole)(const double *p, struct vec3 x), const struct patch *s)
{
	double f[2], df[2], across;
	struct range out;
	struct pole c;

	if (s->n > 1) {
		c = pole(p, s->c);
		across = patch_across(s, c.g);
		out = (struct range){c.d - across, c.d + s->r};
		if (c.d > 0.0)
			out.most = dmin(out.most, sqrt(c.d * c.d +
			    2.0 * c.d * across + s->r * s->r));
		return steep(out, s->speed);
	}
	for (int i = 0; i < 2; i++) {
		c = pole(p, end_of(s, i));
		f[i] = c.d;
		df[i] = vec3_dot(c.g, s->v[0]);
	}
	return between(f, df);
}

static void narrow(struct run *r, double least, double most)
{
	r->least = dmax(r->least, least);
	r->most = dmin(r->most, most);
}

/* |e|, of what is e from its nearest place. */
static struct pole ball(struct vec3 e)
{
	double d = vec3_norm(e);

	return (struct pole){d, vec3_scale(d > 0.0 ? 1.0 / d : 0.0, e)};
}

static struct pole sphere_pole(const double *p, struct vec3 x)
{
	return ball(from_point(p, x));
}

/* The middle of a sphere has no slope: any of its neighbours' is possible. */
static void round_solid(struct run d, double radius, double inv_fall,
    const struct patch *s, struct held *out)
{
	d.least = dmax(d.least, 0.0);
	if (d.least < s->r) {
		d.fall = dmin(d.fall, -s->speed);
		d.rise = dmax(d.rise, s->speed);
	}
	d = moved(d, -radius);
	put_solid(&d, inv_fall, out);
}

static void sphere(const double *p, const struct patch *s, struct held *out)
{
	round_solid(poles(p, sphere_pole, s), p[3], p[4], s, out);
}

static struct pole capsule_pole(const double *p, struct vec3 x)
{
	return ball(from_segment(p, x));
}

static void capsule(const double *p, const struct patch *s, struct held *out)
{
	round_solid(poles(p, capsule_pole, s), p[7], p[8], s, out);
}

/* Of faces at q: below 0 inside. Rises with each. */
static double box_distance(const double q[static 3])
{
	double out = 0.0, in = dmax(q[0], dmax(q[1], q[2]));

	if (!(in > 0.0))
		return in;
	for (int i = 0; i < 3; i++)
		out += square(dmax(q[i], 0.0));
	return sqrt(out);
}

static struct pole box_pole(const double *p, struct vec3 x)
{
	const double c[3] = {x.x - p[0], x.y - p[1], x.z - p[2]};
	const double q[3] = {fabs(c[0]) - p[3], fabs(c[1]) - p[4],
	    fabs(c[2]) - p[5]};
	double d = box_distance(q), g[3] = {0.0, 0.0, 0.0};

	for (int i = 0; i < 3; i++) {
		double side = c[i] < 0.0 ? -1.0 : 1.0;

		if (d > 0.0) {
			g[i] = side * dmax(q[i], 0.0) / d;
		} else if (q[i] == d) {
			g[i] = side;
			break;
		}
	}
	return (struct pole){d, vec3_get(g)};
}

static void box(const double *p, const struct patch *s, struct held *out)
{
	const double c[3] = {s->c.x - p[0], s->c.y - p[1], s->c.z - p[2]};
	struct run d = poles(p, box_pole, s);
	double near[3], far[3];

	for (int i = 0; i < 3; i++) {
		near[i] = dmax(fabs(c[i]) - s->h[i], 0.0) - p[3 + i];
		far[i] = fabs(c[i]) + s->h[i] - p[3 + i];
	}
	narrow(&d, box_distance(near), box_distance(far));
	d = moved(d, -p[6]);
	put_solid(&d, p[7], out);
}

/* Of the side at q and the caps at w; rises with each. */
static double can_distance(double q, double w)
{
	if (q > 0.0 && w > 0.0)
		return sqrt(q * q + w * w);
	return dmax(q, w);
}

/* A point about an axis. */
static void place_about(const double *p, struct vec3 x, struct about *a)
{
	struct vec3 d = vec3_sub(x, vec3_get(p));

	a->u = vec3_get(p + 3);
	a->z = vec3_dot(a->u, d);
	a->radial = vec3_axpy(-a->z, a->u, d);
	a->rho = vec3_norm(a->radial);
}

static struct pole straight(double d, double r, double z,
    const struct about *a)
{
	return (struct pole){d, vec3_axpy(r, radial_unit(a),
	    vec3_scale(z, a->u))};
}

static struct pole can_pole(const double *p, struct vec3 x)
{
	struct about a;
	double q, w, side, d;

	place_about(p, x, &a);
	q = a.rho - p[7];
	w = fabs(a.z) - p[6];
	side = a.z < 0.0 ? -1.0 : 1.0;
	d = can_distance(q, w);
	if (q > 0.0 && w > 0.0)
		return straight(d, q / d, side * w / d, &a);
	return q >= w ? straight(d, 1.0, 0.0, &a) : straight(d, 0.0, side, &a);
}

static void cylinder(const double *p, const struct patch *s, struct held *out)
{
	struct about a = about_axis(p, s);
	struct run d = poles(p, can_pole, s);

	narrow(&d, can_distance(a.rhos.least - p[7],
	    least_size(a.zs) - p[6]), can_distance(a.rhos.most - p[7],
	    most_size(a.zs) - p[6]));
	put_solid(&d, p[8], out);
}

/* To a corner of the cone's profile from (r, z) beside it. */
static struct pole corner(double r, double z, const struct about *a)
{
	double d = sqrt(r * r + z * z), inv = d > 0.0 ? 1.0 / d : 0.0;

	return straight(d, r * inv, z * inv, a);
}

/* As core/primitive.c's cone, without second derivatives. */
static struct pole cone_pole(const double *p, struct vec3 x)
{
	double length = p[6], ra = p[7], rb = p[8];
	double slant = sqrt(length * length + (ra - rb) * (ra - rb));
	double m = slant > 0.0 ? (rb - ra) / slant : 0.0;
	double h = slant > 0.0 ? length / slant : 1.0;
	double r, top, off, along;
	struct about a;
	bool inside;

	place_about(p, x, &a);
	r = a.rho - ra;
	top = a.z - length;
	off = h * r - m * a.z;
	along = m * r + h * a.z;
	inside = off <= 0.0 && a.z >= 0.0 && top <= 0.0;
	if (inside ? off >= -a.z && off >= top :
	    off > 0.0 && along >= 0.0 && along <= slant)
		return straight(off, h, -m, &a);
	if (inside ? -a.z >= top : a.z < 0.0 && a.rho < ra)
		return straight(-a.z, 0.0, -1.0, &a);
	if (inside || (top > 0.0 && a.rho < rb))
		return straight(top, 0.0, 1.0, &a);
	if (along < 0.5 * slant)
		return corner(r, a.z, &a);
	return corner(a.rho - rb, top, &a);
}

static void cone(const double *p, const struct patch *s, struct held *out)
{
	struct run d = poles(p, cone_pole, s);

	put_solid(&d, p[9], out);
}

static void torus(const double *p, const struct patch *s, struct held *out)
{
	struct about a = about_axis(p, s);
	struct run d = ring_run(&a, p[6], ring_squares(&a, p[6], s), s);

	d = moved(d, -p[7]);
	put_solid(&d, p[8], out);
}

static void plane(const double *p, const struct patch *s, struct held *out)
{
	struct vec3 u = vec3_get(p + 3);
	double at = vec3_dot(u, vec3_sub(s->c, vec3_get(p)));
	double reach = patch_across(s, u);
	struct run d = {at - reach, at + reach, -s->speed, s->speed};

	if (s->n == 1)
		d.fall = d.rise = vec3_dot(u, s->v[0]);
	put_solid(&d, p[6], out);
}

/* ---- convolutions ---- */

#define PI 3.14159265358979323846

/* In an element's unit: its measure, and the kernel's integral over all of the
 * line or plane that it is in; squares of the distances from the middle to its
 * nearest and furthest places, or what is nearer and further. */
struct element {
	double measure, total;
	double near, far;
};

/* Of a z that runs from 0 to length. */
static double near_square(double z, double length)
{
	return square(z - clamp(z, 0.0, length));
}

static double far_square(double z, double length)
{
	return square(dmax(fabs(z), fabs(z - length)));
}

static void element(OPCODE_UINT op, const double *p, struct vec3 x,
    struct element *out)
{
	struct vec3 e = vec3_scale(p[3], vec3_sub(x, vec3_get(p)));
	double z, y, off = vec3_dot(e, e);

	*out = (struct element){1.0, 1.0, off, off};
	if (op == OP_CAUCHY_POINT)
		return;
	z = vec3_dot(vec3_get(p + 5), e);
	if (op == OP_CAUCHY_SEGMENT) {
		off = dmax(off - z * z, 0.0);
		*out = (struct element){p[8], PI / 2.0,
		    off + near_square(z, p[8]), off + far_square(z, p[8])};
		return;
	}
	/* of the rectangle about the triangle */
	y = vec3_dot(vec3_get(p + 8), e);
	off = dmax(off - z * z - y * y, 0.0);
	*out = (struct element){0.5 * p[11] * p[13], PI,
	    off + near_square(z, p[11]) + near_square(y, p[13]),
	    off + far_square(z, p[11]) + far_square(y, p[13])};
}

/* No place of the element is nearer to one of s than this: their boxes' gap. */
static double gap(OPCODE_UINT op, const double *p, const struct patch *s)
{
	const double c[3] = {s->c.x, s->c.y, s->c.z};
	double sum = 0.0;

	for (int i = 0; i < 3; i++) {
		double middle = p[i], half = s->h[i];

		/* along u and v, of twice these lengths */
		if (op != OP_CAUCHY_POINT) {
			double u = 0.5 / p[3] * p[5 + i] *
			    (op == OP_CAUCHY_SEGMENT ? p[8] : p[11]);

			middle += u;
			half += fabs(u);
		}
		if (op == OP_CAUCHY_TRIANGLE) {
			double v = 0.5 / p[3] * p[8 + i] * p[13];

			middle += v;
			half += fabs(v);
		}
		sum += square(dmax(fabs(c[i] - middle) - half, 0.0));
	}
	return p[3] * sqrt(sum);
}

static double kernel(double d)
{
	return 1.0 / square(1.0 + d * d);
}

/*
 * With k = (1 + d^2)^-2, |grad k| <= 2 k and |H k| <= 25/6 k, and so for every
 * sum F of them: over rho from its middle F is within exp(+-2 rho) of its value
 * there, and within 25/12 F exp(2 rho) rho^2 of its tangent. It is also at most
 * its measure times k of the nearest, and at least that of the furthest; which
 * is all that is looked at where rho makes the others useless.
 */
#define FAR_ACROSS 1.5

static void cauchy(OPCODE_UINT op, const double *p, const struct patch *s,
    struct held *out)
{
	double rho = p[3] * s->r, spread;
	double across, bend, near, far;
	struct element at;
	struct jet f;

	element(op, p, s->c, &at);
	near = dmax(dmax(sqrt(at.near) - rho, 0.0), gap(op, p, s));
	far = sqrt(at.far) + rho;
	*out = (struct held){p[4] * at.measure * kernel(far),
	    p[4] * dmin(at.measure * kernel(near), at.total), 0.0, 0.0, false};
	if (rho > FAR_ACROSS && s->n > 1) {
		out->rise = 2.0 * p[3] * s->speed * out->most;
		out->fall = -out->rise;
		return;
	}
	spread = exp(dmin(2.0 * rho, 80.0));
	cauchy_eval(op, p, s->c, 1, &f);
	across = patch_across(s, f.gradient);
	bend = 25.0 / 12.0 * f.value * spread * rho * rho;
	out->most = dmin(out->most, dmin(f.value * spread,
	    f.value + across + bend));
	out->least = dmax(out->least, dmax(f.value / spread,
	    f.value - across - bend));
	across = s->n > 1 ? 0.0 : vec3_dot(f.gradient, s->v[0]);
	bend = s->n > 1 ? 2.0 * p[3] * s->speed * out->most : 2.0 * bend;
	out->fall = across - bend;
	out->rise = across + bend;
}

/* ---- all of them ---- */

static void (*const shapes[OP_COUNT])(const double *params,
    const struct patch *s, struct held *out) = {
	[OP_POINT] = point,
	[OP_SEGMENT] = segment,
	[OP_TRIANGLE] = triangle,
	[OP_DISC] = disc,
	[OP_CIRCLE] = circle,
	[OP_SPHERE] = sphere,
	[OP_BOX] = box,
	[OP_CYLINDER] = cylinder,
	[OP_CAPSULE] = capsule,
	[OP_CONE] = cone,
	[OP_TORUS] = torus,
	[OP_PLANE] = plane,
};

void range_primitive(OPCODE_UINT op, const double *params,
    const struct patch *s, struct held *out)
{
	if (op >= OP_CAUCHY_POINT && op <= OP_CAUCHY_TRIANGLE)
		cauchy(op, params, s, out);
	else
		shapes[op](params, s, out);
}
