#include "core/convolution.h"

#include <math.h>
#include <stdbool.h>

#include "core/primitive.h"

/* What values and second derivatives are held under, over the greatest of each
 * in an element's unit, which is less than 100. */
#define PEAK 1e30

/* A triangle smaller than this in its unit is a point, whose area is 0. */
#define SPOT 1e-15

#define PI 3.14159265358979323846

/* Nodes and weights of Gauss and Legendre on [0, 1]. */
struct node1 {
	double x, weight;
};

#define ACROSS 6
static const struct node1 across[ACROSS] = {
	{0.033765242898423975, 0.085662246189585248},
	{0.1693953067668677, 0.1803807865240693},
	{0.38069040695840151, 0.23395696728634563},
	{0.61930959304159849, 0.23395696728634563},
	{0.83060469323313235, 0.1803807865240693},
	{0.96623475710157603, 0.085662246189585248}};

#define ALONG 16
static const struct node1 along[ALONG] = {
	{0.0052995325041750307, 0.013576229705877029},
	{0.0277124884633837, 0.031126761969323888},
	{0.067184398806084122, 0.047579255841246448},
	{0.1222977958224985, 0.062314485627766973},
	{0.19106187779867811, 0.07479799440828841},
	{0.27099161117138632, 0.084578259697501282},
	{0.35919822461037054, 0.091301707522461806},
	{0.45249374508118129, 0.094725305227534237},
	{0.54750625491881877, 0.094725305227534237},
	{0.64080177538962946, 0.091301707522461806},
	{0.72900838882861363, 0.084578259697501282},
	{0.80893812220132189, 0.07479799440828841},
	{0.87770220417750155, 0.062314485627766973},
	{0.93281560119391593, 0.047579255841246448},
	{0.9722875115366163, 0.031126761969323888},
	{0.99470046749582497, 0.013576229705877029}};

double cauchy_default_s(double radius)
{
	return sqrt(cbrt(4.0) - 1.0) / radius;
}

static double square(double x)
{
	return x * x;
}

static double dmin(double a, double b)
{
	return a < b ? a : b;
}

static double dmax(double a, double b)
{
	return a > b ? a : b;
}

/* v / |v|, or otherwise where v is null. */
static struct vec3 unit_or(struct vec3 v, struct vec3 otherwise)
{
	double norm = vec3_norm(v);

	return norm > 0.0 ? vec3_scale(1.0 / norm, v) : otherwise;
}

/* A unit vector at right angles to the unit vector u. */
static struct vec3 perpendicular(struct vec3 u)
{
	struct vec3 axis = fabs(u.x) < 0.6 ? vec3(1.0, 0.0, 0.0) :
	    vec3(0.0, 1.0, 0.0);

	return unit_or(vec3_cross(u, axis), axis);
}

/* a, s, scale. unit: of the element's integral. */
static void put_kernel(const struct primitive *p, double unit, double *params)
{
	double s = p->s, reach = 1.0 + square(s * p->radius[0]);
	double scale = p->weight * unit * s * reach * sqrt(reach) / PI;

	params[3] = s;
	params[4] = dmin(scale, PEAK / dmax(1.0, s * s));
}

/* The triangle with its longest side first, from a to b. */
static void put_triangle(struct vec3 a, struct vec3 b, struct vec3 c, double s,
    double *params)
{
	struct vec3 ab = vec3_sub(b, a), ac = vec3_sub(c, a);
	struct vec3 u = unit_or(ab, vec3(1.0, 0.0, 0.0));
	struct vec3 normal = vec3_cross(u, ac);
	double base = vec3_norm(ab), foot = vec3_dot(u, ac);

	vec3_put(params, a);
	vec3_put(params + 5, u);
	vec3_put(params + 8, vec3_cross(unit_or(normal, perpendicular(u)), u));
	params[11] = s * base;
	params[12] = s * dmin(dmax(foot, 0.0), base);
	params[13] = s * base < SPOT ? 0.0 : s * vec3_norm(normal);
}

static int prepare_triangle(const struct primitive *p, double *params)
{
	double ab = vec3_norm(vec3_sub(p->b, p->a));
	double bc = vec3_norm(vec3_sub(p->c, p->b));
	double ca = vec3_norm(vec3_sub(p->a, p->c));

	put_kernel(p, 1.0 / square(p->s), params);
	if (ab >= bc && ab >= ca)
		put_triangle(p->a, p->b, p->c, p->s, params);
	else if (bc >= ca)
		put_triangle(p->b, p->c, p->a, p->s, params);
	else
		put_triangle(p->c, p->a, p->b, p->s, params);
	return CAUCHY_TRIANGLE_PARAMS;
}

int cauchy_prepare(const struct primitive *p, double *params)
{
	struct vec3 ab = vec3_sub(p->b, p->a);

	if (p->type == PRIMITIVE_CAUCHY_TRIANGLE)
		return prepare_triangle(p, params);
	vec3_put(params, p->a);
	if (p->type == PRIMITIVE_CAUCHY_POINT) {
		put_kernel(p, 1.0, params);
		return 5;
	}
	put_kernel(p, 1.0 / p->s, params);
	vec3_put(params + 5, unit_or(ab, vec3(1.0, 0.0, 0.0)));
	params[8] = p->s * vec3_norm(ab);
	return 9;
}

/*
 * Everything below is in an element's unit, where the kernel is R^-4 with
 * R^2 = 1 + distance^2.
 */

/* From a to x. */
static struct vec3 offset(const double *params, struct vec3 x)
{
	const double reach = CAUCHY_REACH;
	struct vec3 e = vec3_scale(params[3], vec3_sub(x, vec3_get(params)));
	double far = dmax(fabs(e.x), dmax(fabs(e.y), fabs(e.z)));

	return far > reach ? vec3_scale(reach / far, e) : e;
}

/* To world units. */
static void finish(const double *params, int order, struct jet *f)
{
	double s = params[3], scale = params[4];

	f->value *= scale;
	f->gradient = order < 1 ? vec3(0.0, 0.0, 0.0) :
	    vec3_scale(scale * s, f->gradient);
	f->hessian = order < 2 ? sym3_identity(0.0) :
	    sym3_scale(scale * s * s, f->hessian);
}

static void point(const double *params, struct vec3 x, struct jet *out)
{
	struct vec3 e = offset(params, x);
	double b = 1.0 / (1.0 + vec3_dot(e, e));
	struct vec3 be = vec3_scale(b, e);

	out->value = b * b;
	out->gradient = vec3_scale(-4.0 * b * b, be);
	out->hessian = sym3_axpy(24.0 * b * b, sym3_square(be),
	    sym3_identity(-4.0 * b * b * b));
}

/*
 * A stretch of a line, t0 to t1 from the foot of x on it, seen from x at R =
 * sqrt(q^2 + t^2), through the angle delta = phi1 - phi0 with t = q tan phi.
 */
struct stretch {
	double q, t0, t1, length;
	double cos0, cos1; /* of phi */
	double delta, sine; /* of delta */
};

static struct stretch stretch(double q, double t0, double length)
{
	double t1 = t0 + length;
	double r0 = sqrt(q * q + t0 * t0), r1 = sqrt(q * q + t1 * t1);
	double sine = q / r0 * (length / r1);
	double cosine = q / r0 * (q / r1) + t0 / r0 * (t1 / r1);

	return (struct stretch){q, t0, t1, length, q / r0, q / r1,
	    atan2(sine, cosine), sine};
}

/* Its integrals of R^-2, R^-4, R^-6 and R^-8. */
struct powers {
	double j1, j2, j3, j4;
};

/*
 * E2k = integral of sin^2k from -delta/2 to delta/2, from s = sin(delta/2) and
 * c = cos(delta/2): 2k E2k = (2k - 1) E2k-2 - 2 s^(2k-1) c. Upwards it cancels
 * where delta is small; there E6 is the series of 2 t^6 / sqrt(1 - t^2), t = 0
 * to s, and the recurrence goes downwards, in positive terms.
 */
static void sines(double delta, double s, double c, double e[static 4])
{
	double s2 = s * s, sum = 0.0, term = 1.0;

	if (s2 > 0.25) {
		e[0] = delta;
		e[1] = (e[0] - 2.0 * s * c) / 2.0;
		e[2] = (3.0 * e[1] - 2.0 * s * s2 * c) / 4.0;
		e[3] = (5.0 * e[2] - 2.0 * s * s2 * s2 * c) / 6.0;
		return;
	}
	for (int k = 0; k < 26; k++) {
		sum += term / (2 * k + 7);
		term *= s2 * (2 * k + 1) / (2 * k + 2);
	}
	e[3] = 2.0 * s * s2 * s2 * s2 * sum;
	e[2] = (6.0 * e[3] + 2.0 * s * s2 * s2 * c) / 5.0;
	e[1] = (4.0 * e[2] + 2.0 * s * s2 * c) / 3.0;
	e[0] = 2.0 * e[1] + 2.0 * s * c;
}

/*
 * R^-2k dt = q^(1-2k) cos^(2k-2) phi dphi. With m the middle of phi0 and phi1,
 * C = cos m, S = sin m, the odd terms of cos(m + y) = C cos y - S sin y
 * vanish and those left are all positive: no distance or length cancels.
 */
static struct powers powers_of(const struct stretch *l)
{
	double x = l->cos0 + l->cos1;
	double y = l->t0 / l->q * l->cos0 + l->t1 / l->q * l->cos1;
	double norm2 = dmax(x * x + y * y, 1e-300);
	double c = dmin(sqrt(norm2) / 2.0, 1.0); /* cos(delta/2) */
	double s = c * c < 0.5 ? sqrt(1.0 - c * c) : l->sine / (2.0 * c);
	double cc = dmin(x * x / norm2, 1.0), ss = 1.0 - cc;
	double inv = 1.0 / l->q, inv2 = inv * inv;
	double e[4], c2, c4, c6, c2s2, c4s2, c2s4;

	sines(l->delta, s, c, e);
	c2 = e[0] - e[1];
	c2s2 = e[1] - e[2];
	c2s4 = e[2] - e[3];
	c4 = c2 - c2s2;
	c4s2 = c2s2 - c2s4;
	c6 = c4 - c4s2;
	return (struct powers){
	    .j1 = inv * e[0],
	    .j2 = inv * inv2 * (cc * c2 + ss * e[1]),
	    .j3 = inv * inv2 * inv2 * (cc * cc * c4 + 6.0 * cc * ss * c2s2 +
		ss * ss * e[2]),
	    .j4 = inv * inv2 * inv2 * inv2 * (cc * cc * cc * c6 +
		15.0 * cc * ss * (cc * c4s2 + ss * c2s4) +
		ss * ss * ss * e[3])};
}

/*
 * The stretch's field, integral of R^-4, when x moves along it: first and
 * second derivative, differences of R^-4 and of its derivative between the
 * ends, and the difference of R^-6, in forms that keep what is small.
 */
struct ends {
	double z, zz, cube;
};

static struct ends ends_of(const struct stretch *l)
{
	double a0 = square(l->cos0 / l->q), a1 = square(l->cos1 / l->q);
	double less = l->length * a0 * ((l->t0 + l->t1) * a1); /* a0 - a1 */
	double cube = less * (a0 * a0 + a0 * a1 + a1 * a1);
	bool near0 = fabs(l->t0) <= fabs(l->t1);
	double t = near0 ? l->t0 : l->t1, a = near0 ? a1 : a0;

	/* t0 a0^3 - t1 a1^3 = t (a0^3 - a1^3) - length a^3 */
	return (struct ends){.z = less * (a0 + a1),
	    .zz = 4.0 * (t * cube - l->length * a * a * a), .cube = cube};
}

static void segment(const double *params, struct vec3 x, struct jet *out)
{
	struct vec3 e = offset(params, x), u = vec3_get(params + 5), p;
	double z = vec3_dot(u, e);
	struct stretch l;
	struct powers j;
	struct ends d;

	p = vec3_axpy(-z, u, e);
	l = stretch(sqrt(1.0 + vec3_dot(p, p)), -z, params[8]);
	j = powers_of(&l);
	d = ends_of(&l);
	out->value = j.j2;
	out->gradient = vec3_axpy(d.z, u, vec3_scale(-4.0 * j.j3, p));
	out->hessian = sym3_axpy(d.zz + 4.0 * j.j3, sym3_square(u),
	    sym3_identity(-4.0 * j.j3));
	out->hessian = sym3_axpy(24.0 * j.j4, sym3_square(p), out->hessian);
	out->hessian = sym3_axpy(-4.0 * d.cube, sym3_product(u, p),
	    out->hessian);
}

/* A triangle in its plane: x, y along u, v; h above it; c^2 = 1 + h^2. */
struct flat {
	double base, foot, height;
	double x, y, h, c2;
};

/* One side: its direction and length, from its start to x. */
struct side {
	double ux, uy, length;
	double t0;    /* from the foot of x to the start */
	double d;     /* of x, positive inside */
};

static struct side side(const struct flat *f, double ax, double ay, double bx,
    double by)
{
	double dx = bx - ax, dy = by - ay, length = sqrt(dx * dx + dy * dy);
	double ux = dx / length, uy = dy / length;
	double ex = f->x - ax, ey = f->y - ay;

	return (struct side){ux, uy, length, -(ux * ex + uy * ey),
	    ux * ey - uy * ex};
}

/* The square of the distance of x to the side, in the plane. */
static double side_distance2(const struct side *s)
{
	double off = dmax(0.0, dmax(s->t0, -s->t0 - s->length));

	return s->d * s->d + off * off;
}

/* A jet along x, y and the normal. */
struct flat_jet {
	double value, x, y, n;
	double xx, yy, nn, xy, xn, yn;
};

/* Integrals of R^-4, R^-6 and R^-8 over the triangle: what is left of the jet
 * when its sides have given the derivatives in the plane. */
struct areas {
	double i2, i3, i4;
};

/*
 * By the divergence theorem in the plane, about the foot of x: the integral of
 * R^-2k is that of (c^(2-2k) - R^(2-2k)) / (2k - 2) over the angle swept by
 * the boundary, dangle = d dt / (R^2 - c^2); nothing is singular.
 */
static void add_inside(const struct side *s, double c2,
    const struct powers *j, struct areas *sum)
{
	double i = 1.0 / c2, d = s->d;

	sum->i2 += d * i * j->j1 / 2.0;
	sum->i3 += d * i * (i * j->j1 + j->j2) / 4.0;
	sum->i4 += d * i * (i * (i * j->j1 + j->j2) + j->j3) / 6.0;
}

/*
 * Outside the triangle the whole angle is 0 and so is the first term's part,
 * which far away is nearly all. 1/distance is (sin((1 - x) delta)/rho0 + sin(x
 * delta)/rho1) / sin(delta) at the share x of the angle delta.
 */
static void add_outside(const struct side *s, double c2, struct areas *sum)
{
	double far = fabs(s->d), t1 = s->t0 + s->length;
	double rho0 = sqrt(far * far + s->t0 * s->t0);
	double rho1 = sqrt(far * far + t1 * t1);
	double sine = far / rho0 * (s->length / rho1);
	double delta = atan2(sine, far / rho0 * (far / rho1) +
	    s->t0 / rho0 * (t1 / rho1));
	double turn = s->d > 0.0 ? -delta : delta;

	if (!(sine > 0.0))
		return;
	for (int i = 0; i < ALONG; i++) {
		double x = along[i].x;
		double g = (sin((1.0 - x) * delta) / rho0 +
		    sin(x * delta) / rho1) / sine;
		double b = g * g / (1.0 + c2 * g * g);
		double w = turn * along[i].weight * b;

		sum->i2 += w / 2.0;
		sum->i3 += w * b / 4.0;
		sum->i4 += w * b * b / 6.0;
	}
}

/*
 * In the plane, grad of the integral of R^-4 over the triangle is the sum of n
 * times that over each side, n its inward normal; the Hessian is that of n
 * times the sides' gradients.
 */
static void add_side(const struct side *s, const struct flat *f,
    const struct stretch *l, const struct powers *j, struct flat_jet *out)
{
	double nx = -s->uy, ny = s->ux, z = ends_of(l).z;
	double across2 = -4.0 * s->d * j->j3;

	out->x += nx * j->j2;
	out->y += ny * j->j2;
	out->xx += nx * s->ux * z + nx * nx * across2;
	out->yy += ny * s->uy * z + ny * ny * across2;
	out->xy += (nx * s->uy + ny * s->ux) * z / 2.0 + nx * ny * across2;
	out->xn -= 4.0 * f->h * nx * j->j3;
	out->yn -= 4.0 * f->h * ny * j->j3;
}

static void whole_triangle(const struct flat *f,
    const struct side sides[static 3], bool outside, struct flat_jet *out)
{
	struct areas sum = {0.0, 0.0, 0.0};

	for (int i = 0; i < 3; i++) {
		const struct side *s = sides + i;
		struct stretch l = stretch(sqrt(f->c2 + s->d * s->d), s->t0,
		    s->length);
		struct powers j = powers_of(&l);

		if (outside)
			add_outside(s, f->c2, &sum);
		else
			add_inside(s, f->c2, &j, &sum);
		add_side(s, f, &l, &j, out);
	}
	out->value = sum.i2;
	out->n = -4.0 * f->h * sum.i3;
	out->nn = 24.0 * f->h * (f->h * sum.i4) - 4.0 * sum.i3;
}

/* One place of the triangle, at (ex, ey, h) from x, R^-2 = b, weight wb / b. */
static void add_place(double wb, double b, double ex, double ey, double h,
    struct flat_jet *out)
{
	double w3 = -4.0 * wb * b * b, w4 = 24.0 * wb * b;
	double x = b * ex, y = b * ey, n = b * h;

	out->value += wb * b;
	out->x += w3 * ex;
	out->y += w3 * ey;
	out->n += w3 * h;
	out->xx += w3 + w4 * x * x;
	out->yy += w3 + w4 * y * y;
	out->nn += w3 + w4 * n * n;
	out->xy += w4 * x * y;
	out->xn += w4 * x * n;
	out->yn += w4 * y * n;
}

/*
 * A line from (ax, 0) to (foot, y): the sum over it of width times the share
 * tau of its length, which is r0 sin(share of delta) / (length cos phi). In
 * phi everything is a polynomial of sines and cosines.
 */
static void add_line(const struct flat *f, double ax, double y, double width,
    struct flat_jet *out)
{
	struct side s = side(f, ax, 0.0, f->foot, y);
	struct stretch l = stretch(sqrt(f->c2 + s.d * s.d), s.t0, s.length);

	if (!(l.sine > 0.0))
		return;
	for (int i = 0; i < ALONG; i++) {
		double x = along[i].x, up = sin(x * l.delta);
		double cosine = (sin((1.0 - x) * l.delta) * l.cos0 +
		    up * l.cos1) / l.sine;
		double tau = l.q / l.cos0 * up / (s.length * cosine);
		double t = s.t0 + tau * s.length, b = square(cosine / l.q);

		/* dt/R^2 = dphi/q */
		add_place(width * along[i].weight * tau * (l.delta / l.q), b,
		    -t * s.ux - s.d * s.uy, -t * s.uy + s.d * s.ux, f->h, out);
	}
}

/*
 * A thin triangle, as the two on either side of its height. Each is a fan of
 * lines from its sharp corner to the height; eta along it, tau along the line:
 * dA = width height tau dtau deta.
 */
static void thin_triangle(const struct flat *f, struct flat_jet *out)
{
	for (int i = 0; i < 2; i++) {
		double ax = i == 0 ? 0.0 : f->base, width = fabs(f->foot - ax);

		for (int k = 0; width > 0.0 && k < ACROSS; k++) {
			double y = across[k].x * f->height;
			double length = sqrt(width * width + y * y);

			add_line(f, ax, y, across[k].weight * f->height *
			    (width / length), out);
		}
	}
}

static void flat_triangle(const struct flat *f, struct flat_jet *out)
{
	const struct side sides[3] = {
	    side(f, 0.0, 0.0, f->base, 0.0),
	    side(f, f->base, 0.0, f->foot, f->height),
	    side(f, f->foot, f->height, 0.0, 0.0)};
	bool outside = sides[0].d < 0.0 || sides[1].d < 0.0 ||
	    sides[2].d < 0.0;
	double rho2 = !outside ? 0.0 : dmin(side_distance2(sides),
	    dmin(side_distance2(sides + 1), side_distance2(sides + 2)));

	if (square(f->height / CAUCHY_THIN) <= f->c2 + rho2)
		thin_triangle(f, out);
	else
		whole_triangle(f, sides,
		    rho2 > square(CAUCHY_BEYOND) * f->c2, out);
}

static void triangle(const double *params, struct vec3 x, struct jet *out)
{
	struct vec3 e = offset(params, x);
	struct vec3 u = vec3_get(params + 5), v = vec3_get(params + 8);
	struct vec3 n = vec3_cross(u, v);
	struct flat f = {params[11], params[12], params[13], vec3_dot(u, e),
	    vec3_dot(v, e), vec3_dot(n, e), 0.0};
	struct flat_jet j = {0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0};

	if (!(f.height > 0.0))
		return;
	f.c2 = 1.0 + f.h * f.h;
	flat_triangle(&f, &j);
	out->value = j.value;
	out->gradient = vec3_axpy(j.x, u, vec3_axpy(j.y, v,
	    vec3_scale(j.n, n)));
	out->hessian = sym3_axpy(j.xx, sym3_square(u), sym3_axpy(j.yy,
	    sym3_square(v), sym3_scale(j.nn, sym3_square(n))));
	out->hessian = sym3_axpy(j.xy, sym3_product(u, v), out->hessian);
	out->hessian = sym3_axpy(j.xn, sym3_product(u, n), out->hessian);
	out->hessian = sym3_axpy(j.yn, sym3_product(v, n), out->hessian);
}

void cauchy_eval(OPCODE_UINT op, const double *params, struct vec3 x,
    int order, struct jet *out)
{
	*out = (struct jet){0};
	if (op == OP_CAUCHY_POINT)
		point(params, x, out);
	else if (op == OP_CAUCHY_SEGMENT)
		segment(params, x, out);
	else
		triangle(params, x, out);
	finish(params, order, out);
}
