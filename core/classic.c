#include "core/classic.h"

#include <math.h>
#include <string.h>

#include "core/operator.h"

/* Nearer to 1, tan(theta) counts as 1: 1/(1 - t)^2 is to stay float32. */
#define OPENING_LEAST 1e-3

/* Newton steps of BARTHE_CLEAN: the fourth is under 1e-12 of the root. */
#define CLEAN_STEPS 5

bool classic_has_family(unsigned type, int family)
{
	return type != CLASSIC_POWER_DIFFERENCE ||
	    family == CLASSIC_DIFFERENCE;
}

/* t1, t2, 1/(1 - t1)^2, 1/(1 - t2)^2; 1, 1, 1, 1 leaves no room for arcs. */
static void prepare_opening(const double theta[static 2],
    double out[static 4])
{
	for (int i = 0; i < 2; i++) {
		const double t = tan(theta[i]);

		if (1.0 - t < OPENING_LEAST) {
			out[0] = out[1] = out[2] = out[3] = 1.0;
			return;
		}
		out[i] = t;
		out[2 + i] = 1.0 / ((1.0 - t) * (1.0 - t));
	}
}

void classic_prepare(const struct classic *c, int family,
    double params[static CLASSIC_PARAMS_MAX])
{
	double *own = params + 1;

	params[0] = family;
	memcpy(own, c->p, sizeof c->p);
	switch (c->type) {
	case CLASSIC_SUPER_ELLIPTIC: /* 1/r1, 1/r2, t */
		own[0] = 1.0 / c->p[0];
		own[1] = 1.0 / c->p[1];
		break;
	case CLASSIC_R_BLEND: /* a0, 1/a1, 1/a2 */
		own[1] = 1.0 / c->p[1];
		own[2] = 1.0 / c->p[2];
		break;
	case CLASSIC_BARTHE_OPENING:
		prepare_opening(c->p, own);
		break;
	}
}

static void set_max(double x, double y, struct operator_jet *u)
{
	*u = (struct operator_jet){.g = fmax(x, y), .g1 = x >= y,
	    .g2 = x < y};
}

/* [1 + (2x - 1)/r]_+^t and its derivatives in x; s = 1/r. */
static void super_term(double x, double s, double t, double out[static 3])
{
	const double base = 1.0 + (2.0 * x - 1.0) * s, most = 1.0 + s;
	const double b = fmin(fmax(base, 0.0), most);

	out[0] = pow(b, t);
	out[1] = b > 0.0 ? 2.0 * s * t * pow(b, t - 1.0) : 0.0;
	out[2] = 0.0;
	if (base > most)
		out[0] += out[1] * (x - 1.0);
	else if (b > 0.0)
		out[2] = 4.0 * s * s * t * (t - 1.0) * pow(b, t - 2.0);
}

static void super_elliptic(const double *p, double x, double y,
    struct operator_jet *u)
{
	double a[3], b[3];

	super_term(x, p[0], p[2], a);
	super_term(y, p[1], p[2], b);
	u->g = 0.5 * (a[0] + b[0]);
	u->g1 = 0.5 * a[1];
	u->g2 = 0.5 * b[1];
	u->g11 = 0.5 * a[2];
	u->g22 = 0.5 * b[2];
}

/* With n = F/|F|: dG/dF = 1 + n, and its second derivatives are those of |F|,
 * (I - n n^T)/|F|. dF = 2 dx, and the result is half of G. */
static void r_clean(const double *p, double x, double y,
    struct operator_jet *u)
{
	const double a = 2.0 * x - 1.0, b = 2.0 * y - 1.0;
	const double r = sqrt(a * a + b * b);
	const double inverse = 1.0 / fmax(r, 1e-10);
	const double n1 = a * inverse, n2 = b * inverse;

	(void)p;
	u->g = 0.5 * (a + b + r + 1.0);
	u->g1 = 1.0 + n1;
	u->g2 = 1.0 + n2;
	u->g11 = 2.0 * n2 * n2 * inverse;
	u->g12 = -2.0 * n1 * n2 * inverse;
	u->g22 = 2.0 * n1 * n1 * inverse;
}

/* F/a and 1/a, for a displacement that goes no further than CLASSIC_FAR. */
static double reach(double x, double inverse)
{
	return fmin(fmax((2.0 * x - 1.0) * inverse, -CLASSIC_FAR),
	    CLASSIC_FAR);
}

static void r_blend(const double *p, double x, double y,
    struct operator_jet *u)
{
	const double a = reach(x, p[1]), b = reach(y, p[2]);
	const double w = 1.0 / (1.0 + a * a + b * b), d = p[0] * w;

	r_clean(p, x, y, u);
	u->g += 0.5 * d;
	u->g1 -= 2.0 * d * w * a * p[1];
	u->g2 -= 2.0 * d * w * b * p[2];
	u->g11 += 4.0 * d * w * (4.0 * a * a * w - 1.0) * p[1] * p[1];
	u->g12 += 16.0 * d * w * w * a * b * p[1] * p[2];
	u->g22 += 4.0 * d * w * (4.0 * b * b * w - 1.0) * p[2] * p[2];
}

static void functional(const double *p, double x, double y,
    struct operator_jet *u)
{
	const double d = p[0], rise = 2.0 * (x - y);
	double s;

	set_max(x, y, u);
	if (fabs(rise) >= d)
		return;
	s = sqrt(2.0 * d * d - rise * rise);
	u->g = 0.5 * (x + y + d) - 0.25 * s;
	u->g1 = 0.5 + 0.5 * rise / s;
	u->g2 = 0.5 - 0.5 * rise / s;
	u->g11 = u->g22 = 2.0 * d * d / (s * s * s);
	u->g12 = -u->g11;
}

/* Both fields over 1/2: 1/2 plus the distance from (1/2, 1/2). */
static void clean_inside(double x, double y, struct operator_jet *u)
{
	const double r = hypot(x - 0.5, y - 0.5);
	const double inverse = 1.0 / fmax(r, CLASSIC_TINY);
	const double n1 = (x - 0.5) * inverse, n2 = (y - 0.5) * inverse;

	u->g = 0.5 + r;
	u->g1 = n1;
	u->g2 = n2;
	u->g11 = n2 * n2 * inverse;
	u->g12 = -n1 * n2 * inverse;
	u->g22 = n1 * n1 * inverse;
}

/*
 * The arc through (x, y) as numbers that keep their digits towards both ends:
 * t is g below 1/4, 1/2 - g above; a = f - k(g) of each field.
 */
struct arc {
	double t, a1, a2;
	double slope; /* k'(g) = 4g */
};

/*
 * Newton's iteration for r - |a| = 0, r = g - k = t - 2t^2. From t0, that of
 * g = max, it converges without a bracket: the residual is monotone, its slope
 * in 1..3 in size.
 */
static void clean_solve(double b1, double b2, double rise, struct arc *arc)
{
	double t = arc->t;

	for (int i = 0; i < CLEAN_STEPS; i++) {
		const double k = t * (rise - 2.0 * t);
		const double a1 = b1 + k, a2 = b2 + k, n = hypot(a1, a2);

		t -= (t * (1.0 - 2.0 * t) - n) /
		    (1.0 - 4.0 * t - (a1 + a2) / n * (rise - 4.0 * t));
	}
	arc->t = t;
	arc->a1 = b1 + t * (rise - 2.0 * t);
	arc->a2 = b2 + t * (rise - 2.0 * t);
}

/* Whether (x, y), the larger under 1/2, is between the boundary curves. */
static bool clean_arc(double x, double y, struct arc *arc)
{
	const double most = fmax(x, y);
	const bool low = most < 0.25;
	const double rise = low ? 0.0 : 2.0, from = low ? 0.0 : 0.5;
	const double b1 = x - from, b2 = y - from;

	arc->t = low ? most : 0.5 - most;
	if (!(fmin(b1, b2) + arc->t * (rise - 2.0 * arc->t) > 0.0))
		return false;
	clean_solve(b1, b2, rise, arc);
	arc->slope = low ? 4.0 * arc->t : 2.0 - 4.0 * arc->t;
	return true;
}

/*
 * E = r^2 - a1^2 - a2^2 = 0, halved: E_g = D = r + k'(a1 + a2 - r),
 * E_i = -a_i, E_ij = -delta_ij, E_ig = k', and E_gg as below.
 */
static void barthe_clean(const double *p, double x, double y,
    struct operator_jet *u)
{
	struct arc arc;
	double r, d, k, bend;

	(void)p;
	set_max(x, y, u);
	if (fmin(x, y) > 0.5)
		clean_inside(x, y, u);
	if (!(fmax(x, y) < 0.5 && fmax(x, y) > CLASSIC_LEAST &&
	    fmin(x, y) > 0.0 && clean_arc(x, y, &arc)))
		return;
	k = arc.slope;
	r = arc.t * (1.0 - 2.0 * arc.t);
	d = 1.0 / fmax(r + k * (arc.a1 + arc.a2 - r), CLASSIC_TINY);
	bend = (1.0 - k) * (1.0 - k) - 2.0 * k * k +
	    4.0 * (arc.a1 + arc.a2 - r);
	u->g = fmax(x, y) < 0.25 ? arc.t : 0.5 - arc.t;
	u->g1 = arc.a1 * d;
	u->g2 = arc.a2 * d;
	u->g11 = (1.0 - 2.0 * k * u->g1 - bend * u->g1 * u->g1) * d;
	u->g12 = (-k * (u->g1 + u->g2) - bend * u->g1 * u->g2) * d;
	u->g22 = (1.0 - 2.0 * k * u->g2 - bend * u->g2 * u->g2) * d;
}

static void swap(struct operator_jet *u)
{
	const struct operator_jet j = *u;

	u->g1 = j.g2;
	u->g2 = j.g1;
	u->g11 = j.g22;
	u->g22 = j.g11;
}

/*
 * Of the larger field M and the smaller m: M q with q = (1 + r^n)^(1/n),
 * r = m/M, which neither over- nor underflows.
 */
static void ricci(const double *p, double x, double y, struct operator_jet *u)
{
	const double n = p[0], most = fmax(fmax(x, y), CLASSIC_TINY);
	const double r = fmax(fmin(x, y) / most, CLASSIC_TINY);
	const double t = pow(r, n), q = pow(1.0 + t, 1.0 / n);
	const double bend = (n - 1.0) * q / ((1.0 + t) * (1.0 + t)) / most;

	if (fmin(x, y) < 0.0) {
		set_max(x, y, u);
		return;
	}
	u->g = fmax(x, y) * q;
	u->g1 = q / (1.0 + t);
	u->g2 = u->g1 * pow(r, n - 1.0);
	u->g11 = bend * t;
	u->g12 = -bend * pow(r, n - 1.0);
	u->g22 = bend * pow(r, n - 2.0);
	if (x < y)
		swap(u);
}

/*
 * In units of the larger field, since U is homogeneous. With A, B = 1/(1 - t)^2
 * the quadratic's discriminant is A x^2 + B y^2 - A B (t1 y - t2 x)^2, by
 * Lagrange's identity. E = A (x - t1 C)^2 + B (y - t2 C)^2 - C^2, halved:
 * E_x = P, E_y = Q, -E_C = D = t1 P + t2 Q + C.
 */
static void barthe_opening(const double *p, double x, double y,
    struct operator_jet *u)
{
	const double t1 = p[0], t2 = p[1], A = p[2], B = p[3];
	const double most = fmax(x, y);
	double s, cross, C, P, Q, D;

	set_max(x, y, u);
	if (!(x > t1 * y && y > t2 * x && most > CLASSIC_TINY))
		return;
	x /= most;
	y /= most;
	s = A * x * x + B * y * y;
	cross = t1 * y - t2 * x;
	C = s / (A * t1 * x + B * t2 * y +
	    sqrt(fmax(s - A * B * cross * cross, 0.0)));
	P = A * (x - t1 * C);
	Q = B * (y - t2 * C);
	D = 1.0 / (t1 * P + t2 * Q + C);
	u->g = most * C;
	u->g1 = P * D;
	u->g2 = Q * D;
	x = 1.0 - t1 * u->g1;
	y = 1.0 - t2 * u->g2;
	D /= most;
	u->g11 = (A * x * x + u->g1 * u->g1 * (B * t2 * t2 - 1.0)) * D;
	u->g12 = -(A * t1 * u->g2 * x + B * t2 * u->g1 * y +
	    u->g1 * u->g2) * D;
	u->g22 = (B * y * y + u->g2 * u->g2 * (A * t1 * t1 - 1.0)) * D;
}

static void interpolation(const double *p, double x, double y,
    struct operator_jet *u)
{
	const double h = fmin(x, y) < 0.0 ? 0.0 : p[0];

	barthe_clean(p, x, y, u);
	u->g += h * (x + y - u->g);
	u->g1 += h * (1.0 - u->g1);
	u->g2 += h * (1.0 - u->g2);
	u->g11 -= h * u->g11;
	u->g12 -= h * u->g12;
	u->g22 -= h * u->g22;
}

/* b^e, not followed past any field. */
static double power(double b, double e)
{
	return exp2(fmin(e * log2(fmax(b, CLASSIC_TINY)), CLASSIC_POWER_MAX));
}

static void power_difference(const double *p, double f1, double f2,
    struct operator_jet *u)
{
	const double alpha = p[0], b = 2.0 * f2;

	u->g = f1 - (f2 > 0.0 ? 0.5 * power(b, alpha) : 0.0);
	u->g1 = 1.0;
	u->g2 = -alpha * power(b, alpha - 1.0);
	u->g22 = -2.0 * alpha * (alpha - 1.0) * power(b, alpha - 2.0);
}

/* By type. */
static void (*const unions[CLASSIC_TYPE_COUNT])(const double *p, double x,
    double y, struct operator_jet *u) = {super_elliptic, r_blend, functional,
	r_clean, barthe_clean, ricci, barthe_opening, interpolation,
	power_difference};

/* u is U(1 - f1, y(f2)) and becomes 1 - U; slope: dy/df2, of size 1 or 0. */
static void complement(double slope, struct operator_jet *u)
{
	u->g = 1.0 - u->g;
	u->g2 *= -slope;
	u->g11 = -u->g11;
	u->g12 *= slope;
	u->g22 *= -slope * slope;
}

static double held(double x, double most)
{
	return fmin(fmax(x, -most), most);
}

void classic_eval(unsigned type, const double *params, double f1, double f2,
    int order, struct operator_jet *out)
{
	struct operator_jet u = {0};

	if (params[0] == CLASSIC_UNION || type == CLASSIC_POWER_DIFFERENCE) {
		unions[type](params + 1, f1, f2, &u);
	} else if (params[0] == CLASSIC_INTERSECTION) {
		unions[type](params + 1, 1.0 - f1, 1.0 - f2, &u);
		complement(-1.0, &u);
	} else {
		unions[type](params + 1, 1.0 - f1, fmin(f2, 1.0), &u);
		complement(f2 < 1.0, &u);
	}
	*out = (struct operator_jet){.g = fmax(u.g, 0.0)};
	if (u.g < 0.0)
		return;
	if (order >= 1) {
		out->g1 = held(u.g1, CLASSIC_SLOPE_MAX);
		out->g2 = held(u.g2, CLASSIC_SLOPE_MAX);
	}
	if (order >= 2) {
		out->g11 = held(u.g11, CLASSIC_BEND_MAX);
		out->g12 = held(u.g12, CLASSIC_BEND_MAX);
		out->g22 = held(u.g22, CLASSIC_BEND_MAX);
	}
}
