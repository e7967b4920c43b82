/*
 * Operators without angles (core/classic.h), as core/classic.c has them in
 * float64, where the identities are. p: the parameters that classic_prepare
 * gives, after the family. Members with t are neither read nor written.
 */

/* Newton steps of the clean union: the third is under 3e-7 of the root. */
#define CLASSIC_STEPS 4

static inline void classic_max(real x, real y, struct opjet *u)
{
	mask first = x >= y;

	u->g = real_max(x, y);
	u->g1 = SELECT(REAL(0.0f), REAL(1.0f), first);
	u->g2 = SELECT(REAL(1.0f), REAL(0.0f), first);
	u->g11 = u->g12 = u->g22 = REAL(0.0f);
}

/* b^e, not followed past any field. */
static inline real classic_power(real b, float e)
{
	return exp2(real_min(e * log2(real_max(b, REAL(CLASSIC_TINY))),
	    REAL(CLASSIC_POWER_MAX)));
}

/* out: value, first and second derivative. */
static inline void classic_super_term(real x, float s, float t,
    real out[3])
{
	real base = 1.0f + (2.0f * x - 1.0f) * s;
	real b = real_clamp(base, REAL(0.0f), REAL(1.0f + s));
	mask some = b > REAL(0.0f), beyond = base > REAL(1.0f + s);
	real value = SELECT(REAL(0.0f), classic_power(b, t), some);
	real inverse = 2.0f * s / real_max(b, REAL(CLASSIC_TINY));

	out[0] = value;
	out[1] = t * value * inverse;
	out[2] = SELECT((t - 1.0f) * out[1] * inverse, REAL(0.0f), beyond);
	out[0] += SELECT(REAL(0.0f), out[1] * (x - 1.0f), beyond);
}

static void classic_super_elliptic(__global const float *p, real x, real y,
    struct opjet *u)
{
	real a[3], b[3];

	classic_super_term(x, p[0], p[2], a);
	classic_super_term(y, p[1], p[2], b);
	u->g = 0.5f * (a[0] + b[0]);
	u->g1 = 0.5f * a[1];
	u->g2 = 0.5f * b[1];
	u->g11 = 0.5f * a[2];
	u->g12 = REAL(0.0f);
	u->g22 = 0.5f * b[2];
}

static void classic_r_clean(real x, real y, struct opjet *u)
{
	real a = 2.0f * x - 1.0f, b = 2.0f * y - 1.0f;
	real r = sqrt(a * a + b * b);
	real inverse = 1.0f / real_max(r, REAL(1e-10f));
	real n1 = a * inverse, n2 = b * inverse;

	u->g = 0.5f * (a + b + r + 1.0f);
	u->g1 = 1.0f + n1;
	u->g2 = 1.0f + n2;
	u->g11 = 2.0f * n2 * n2 * inverse;
	u->g12 = -2.0f * n1 * n2 * inverse;
	u->g22 = 2.0f * n1 * n1 * inverse;
}

static void classic_r_blend(__global const float *p, real x, real y,
    struct opjet *u)
{
	real a = real_clamp((2.0f * x - 1.0f) * p[1], REAL(-CLASSIC_FAR),
	    REAL(CLASSIC_FAR));
	real b = real_clamp((2.0f * y - 1.0f) * p[2], REAL(-CLASSIC_FAR),
	    REAL(CLASSIC_FAR));
	real w = 1.0f / (1.0f + a * a + b * b), d = p[0] * w, e = d * w;

	classic_r_clean(x, y, u);
	u->g += 0.5f * d;
	u->g1 -= 2.0f * e * a * p[1];
	u->g2 -= 2.0f * e * b * p[2];
	u->g11 += 4.0f * e * (4.0f * a * a * w - 1.0f) * p[1] * p[1];
	u->g12 += 16.0f * e * w * a * b * p[1] * p[2];
	u->g22 += 4.0f * e * (4.0f * b * b * w - 1.0f) * p[2] * p[2];
}

static void classic_functional(float d, real x, real y, struct opjet *u)
{
	real rise = 2.0f * (x - y), s, bend;
	mask arc = fabs(rise) < REAL(d);

	classic_max(x, y, u);
	if (!ANY(arc))
		return;
	rise = SELECT(REAL(0.0f), rise, arc);
	s = sqrt(2.0f * d * d - rise * rise);
	bend = SELECT(REAL(0.0f), 2.0f * d * d / (s * s * s), arc);
	u->g = SELECT(u->g, 0.5f * (x + y + d) - 0.25f * s, arc);
	u->g1 = SELECT(u->g1, 0.5f + 0.5f * rise / s, arc);
	u->g2 = SELECT(u->g2, 0.5f - 0.5f * rise / s, arc);
	u->g11 = u->g22 = bend;
	u->g12 = -bend;
}

/* Both fields over 1/2. */
static inline void classic_inside(real x, real y, mask m, struct opjet *u)
{
	real a = SELECT(REAL(0.0f), x - 0.5f, m);
	real b = SELECT(REAL(0.0f), y - 0.5f, m);
	real r = sqrt(a * a + b * b);
	real inverse = 1.0f / real_max(r, REAL(CLASSIC_TINY));
	real n1 = a * inverse, n2 = b * inverse;

	u->g = SELECT(u->g, 0.5f + r, m);
	u->g1 = SELECT(u->g1, n1, m);
	u->g2 = SELECT(u->g2, n2, m);
	u->g11 = n2 * n2 * inverse;
	u->g12 = -n1 * n2 * inverse;
	u->g22 = n1 * n1 * inverse;
}

/* t, a1 and a2 of the arc through (x, y), from t that of max. */
static inline void classic_arc(real b1, real b2, real rise, real *t, real *a1,
    real *a2)
{
	for (int i = 0; i < CLASSIC_STEPS; i++) {
		real k = *t * (rise - 2.0f * *t), n;

		*a1 = b1 + k;
		*a2 = b2 + k;
		n = real_max(sqrt(*a1 * *a1 + *a2 * *a2),
		    REAL(CLASSIC_TINY));
		*t -= (*t * (1.0f - 2.0f * *t) - n) / (1.0f - 4.0f * *t -
		    (*a1 + *a2) / n * (rise - 4.0f * *t));
	}
	*a1 = b1 + *t * (rise - 2.0f * *t);
	*a2 = b2 + *t * (rise - 2.0f * *t);
}

static void classic_barthe_clean(real x, real y, struct opjet *u)
{
	const real zero = REAL(0.0f);
	real most = real_max(x, y), least = real_min(x, y);
	mask inside = least > REAL(0.5f), low = most < REAL(0.25f);
	real rise = SELECT(REAL(2.0f), zero, low);
	real from = SELECT(REAL(0.5f), zero, low);
	real t = SELECT(0.5f - most, most, low), a1, a2, r, k, d, bend;
	mask arc = (most < REAL(0.5f)) & (most > REAL(CLASSIC_LEAST)) &
	    (least > zero) & (least - from + t * (rise - 2.0f * t) > zero);

	classic_max(x, y, u);
	if (ANY(inside))
		classic_inside(x, y, inside, u);
	if (!ANY(arc))
		return;
	/* Elsewhere the arc of two equal fields, whose numbers are tame. */
	t = SELECT(REAL(0.125f), t, arc);
	rise = SELECT(zero, rise, arc);
	a1 = SELECT(t, x - from, arc);
	a2 = SELECT(t, y - from, arc);
	classic_arc(a1, a2, rise, &t, &a1, &a2);
	r = t * (1.0f - 2.0f * t);
	k = 4.0f * SELECT(0.5f - t, t, rise == zero);
	bend = a1 + a2 - r;
	d = 1.0f / real_max(r + k * bend, REAL(CLASSIC_TINY));
	bend = (1.0f - k) * (1.0f - k) - 2.0f * k * k + 4.0f * bend;
	a1 *= d;
	a2 *= d;
	u->g = SELECT(u->g, SELECT(0.5f - t, t, low), arc);
	u->g1 = SELECT(u->g1, a1, arc);
	u->g2 = SELECT(u->g2, a2, arc);
	u->g11 = SELECT(u->g11, (1.0f - 2.0f * k * a1 - bend * a1 * a1) * d,
	    arc);
	u->g12 = SELECT(u->g12, (-k * (a1 + a2) - bend * a1 * a2) * d, arc);
	u->g22 = SELECT(u->g22, (1.0f - 2.0f * k * a2 - bend * a2 * a2) * d,
	    arc);
}

static inline void classic_swap(real *a, real *b, mask m)
{
	real x = *a;

	*a = SELECT(*a, *b, m);
	*b = SELECT(*b, x, m);
}

static void classic_ricci(float n, real x, real y, struct opjet *u)
{
	real most = real_max(x, y), least = real_min(x, y);
	real over = real_max(most, REAL(CLASSIC_TINY));
	real r = real_max(least / over, REAL(1e-12f));
	real t = classic_power(r, n), slope = t / r;
	real q = exp2(log2(1.0f + t) * (1.0f / n));
	real bend = (n - 1.0f) * q / ((1.0f + t) * (1.0f + t)) / over;
	mask both = least >= REAL(0.0f), swapped = x < y;

	/* Where a field is negative r is 1e-12, and this is max but for the
	 * derivatives of the larger power. */
	u->g = most * q;
	u->g1 = q / (1.0f + t);
	u->g2 = u->g1 * slope;
	u->g11 = bend * t;
	u->g12 = -bend * slope;
	u->g22 = bend * slope / r;
	u->g = SELECT(most, u->g, both);
	u->g1 = SELECT(REAL(1.0f), u->g1, both);
	u->g2 = SELECT(REAL(0.0f), u->g2, both);
	u->g11 = SELECT(REAL(0.0f), u->g11, both);
	u->g12 = SELECT(REAL(0.0f), u->g12, both);
	u->g22 = SELECT(REAL(0.0f), u->g22, both);
	classic_swap(&u->g1, &u->g2, swapped);
	classic_swap(&u->g11, &u->g22, swapped);
}

static void classic_barthe_opening(__global const float *p, real x, real y,
    struct opjet *u)
{
	float t1 = p[0], t2 = p[1], A = p[2], B = p[3];
	real most = real_max(x, y), s, cross, C, P, Q, D, E, g1, g2;
	mask arc = (x > t1 * y) & (y > t2 * x) & (most > REAL(CLASSIC_TINY));

	classic_max(x, y, u);
	if (!ANY(arc))
		return;
	x = SELECT(REAL(1.0f), x / most, arc);
	y = SELECT(REAL(1.0f), y / most, arc);
	cross = t1 * y - t2 * x;
	s = A * x * x + B * y * y;
	C = s / (A * t1 * x + B * t2 * y +
	    sqrt(real_max(s - A * B * cross * cross, REAL(0.0f))));
	P = A * (x - t1 * C);
	Q = B * (y - t2 * C);
	D = 1.0f / (t1 * P + t2 * Q + C);
	g1 = P * D;
	g2 = Q * D;
	E = D / SELECT(REAL(1.0f), most, arc);
	x = 1.0f - t1 * g1;
	y = 1.0f - t2 * g2;
	u->g = SELECT(u->g, most * C, arc);
	u->g1 = SELECT(u->g1, g1, arc);
	u->g2 = SELECT(u->g2, g2, arc);
	u->g11 = SELECT(u->g11,
	    (A * x * x + g1 * g1 * (B * t2 * t2 - 1.0f)) * E, arc);
	u->g12 = SELECT(u->g12,
	    -(A * t1 * g2 * x + B * t2 * g1 * y + g1 * g2) * E, arc);
	u->g22 = SELECT(u->g22,
	    (B * y * y + g2 * g2 * (A * t1 * t1 - 1.0f)) * E, arc);
}

static void classic_interpolation(float share, real x, real y,
    struct opjet *u)
{
	real h = SELECT(REAL(share), REAL(0.0f),
	    real_min(x, y) < REAL(0.0f));

	classic_barthe_clean(x, y, u);
	u->g += h * (x + y - u->g);
	u->g1 += h * (1.0f - u->g1);
	u->g2 += h * (1.0f - u->g2);
	u->g11 -= h * u->g11;
	u->g12 -= h * u->g12;
	u->g22 -= h * u->g22;
}

static void classic_power_difference(float alpha, real f1, real f2,
    struct opjet *u)
{
	real b = real_max(2.0f * f2, REAL(CLASSIC_TINY));
	real value = classic_power(b, alpha);

	u->g = f1 - SELECT(REAL(0.0f), 0.5f * value, f2 > REAL(0.0f));
	u->g1 = REAL(1.0f);
	u->g2 = -alpha * value / b;
	u->g11 = u->g12 = REAL(0.0f);
	u->g22 = 2.0f * (alpha - 1.0f) * u->g2 / b;
}

static void classic_union(uint type, __global const float *p, real x, real y,
    struct opjet *u)
{
	switch (type) {
	case CLASSIC_SUPER_ELLIPTIC:
		classic_super_elliptic(p, x, y, u);
		break;
	case CLASSIC_R_BLEND:
		classic_r_blend(p, x, y, u);
		break;
	case CLASSIC_FUNCTIONAL:
		classic_functional(p[0], x, y, u);
		break;
	case CLASSIC_R_CLEAN:
		classic_r_clean(x, y, u);
		break;
	case CLASSIC_BARTHE_CLEAN:
		classic_barthe_clean(x, y, u);
		break;
	case CLASSIC_RICCI:
		classic_ricci(p[0], x, y, u);
		break;
	case CLASSIC_BARTHE_OPENING:
		classic_barthe_opening(p, x, y, u);
		break;
	case CLASSIC_INTERPOLATION:
		classic_interpolation(p[0], x, y, u);
		break;
	default:
		classic_power_difference(p[0], x, y, u);
	}
}

static inline real classic_held(real x, float most, mask m)
{
	return SELECT(REAL(0.0f), real_clamp(x, REAL(-most), REAL(most)), m);
}

/* u is U(1 - f1, y(f2)) and becomes 1 - U; slope: dy/df2, of size 1 or 0. */
static inline void classic_complement(real slope, struct opjet *u)
{
	u->g = 1.0f - u->g;
	u->g2 *= -slope;
	u->g11 = -u->g11;
	u->g12 *= slope;
	u->g22 *= -slope * slope;
}

/* Fills g, and as order says g1 g2, g11 g12 g22. */
static void classic_eval(uint type, __global const float *p, real f1, real f2,
    int order, struct opjet *out)
{
	int family = (int)p[0];
	int plain = family == CLASSIC_UNION ||
	    type == CLASSIC_POWER_DIFFERENCE;
	int minus = !plain && family == CLASSIC_DIFFERENCE;
	real x = plain ? f1 : 1.0f - f1, y = f2;
	mask some;

	if (minus)
		y = real_min(f2, REAL(1.0f));
	else if (!plain)
		y = 1.0f - f2;
	classic_union(type, p + 1, x, y, out);
	if (minus)
		classic_complement(SELECT(REAL(0.0f), REAL(1.0f),
		    f2 < REAL(1.0f)), out);
	else if (!plain)
		classic_complement(REAL(-1.0f), out);
	some = out->g >= REAL(0.0f);
	out->g = real_max(out->g, REAL(0.0f));
	if (order >= 1) {
		out->g1 = classic_held(out->g1, CLASSIC_SLOPE_MAX, some);
		out->g2 = classic_held(out->g2, CLASSIC_SLOPE_MAX, some);
	}
	if (order >= 2) {
		out->g11 = classic_held(out->g11, CLASSIC_BEND_MAX, some);
		out->g12 = classic_held(out->g12, CLASSIC_BEND_MAX, some);
		out->g22 = classic_held(out->g22, CLASSIC_BEND_MAX, some);
	}
}
