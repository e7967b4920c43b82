#include "core/profile.h"

#include <math.h>
#include <stddef.h>

static const double e = 2.71828182845904523536;

struct profile profile_smooth(void)
{
	return (struct profile){.type = PROFILE_SMOOTH};
}

struct profile profile_circle(void)
{
	return (struct profile){.type = PROFILE_CIRCLE};
}

struct profile profile_bulge(double k)
{
	return (struct profile){.type = PROFILE_BULGE, .k = k};
}

/*
 * With A = exp(e - e x) - 1 and nu = exp(A) - 1 (Eq. 19), 1/nu + 1 is
 * 1/(1 - exp(-A)); eta = ln(1 + W)/e with W = ln(1/nu + 1).
 * W' = e (A + 1)/nu; dW/dA = -1/nu; d2W/dA2 = (1 + nu)/nu^2; A' = -e (A + 1).
 */
void profile_eta(double x, double out[static 3])
{
	double a = expm1(e - e * x), nu, w, a1, w1, w2;

	/* From here to x = 1 eta rises without bound; hold it. */
	if (a < 1e-15)
		a = 1e-15;
	nu = expm1(a);
	w = log1p(1.0 / nu);
	a1 = -e * (a + 1.0);
	w1 = -a1 / nu;
	w2 = (1.0 + nu) / (nu * nu) * a1 * a1 - e * e * (a + 1.0) / nu;
	out[0] = log1p(w) / e;
	out[1] = w1 / (1.0 + w) / e;
	out[2] = (w2 - w1 * w1 / (1.0 + w)) / (1.0 + w) / e;
}

static void smooth_eval(double x, struct profile_jet *out)
{
	double eta[3];

	/* There the slope is -1. Beyond, eta' grows without bound; the tangent
	 * serves as well. */
	if (x > PROFILE_DIAGONAL) {
		*out = (struct profile_jet){2.0 * PROFILE_DIAGONAL - x, -1.0, 0.0};
		return;
	}
	profile_eta(x, eta);
	*out = (struct profile_jet){1.0 - eta[0], -eta[1], -eta[2]};
}

/* B = 1 - K s (1 - t) with s = exp(1 - 1/t): s' = s/t^2, s'' = s (1 - 2t)/t^4 */
static void bulge_eval(double k, double t, struct profile_jet *out)
{
	double s, s1, s2;

	*out = (struct profile_jet){1.0, 0.0, 0.0};
	/* On the diagonal t may come out a rounding beyond 1. */
	if (t > 1.0 && t < 1.0 + 1e-9)
		t = 1.0;
	if (t < 1.0 / 700.0 || t > 1.0)
		return;
	s = exp(1.0 - 1.0 / t);
	s1 = s / (t * t);
	s2 = s * (1.0 - 2.0 * t) / (t * t * t * t);
	out->y = 1.0 - k * s * (1.0 - t);
	out->slope = -k * (s1 * (1.0 - t) - s);
	out->bend = -k * (s2 * (1.0 - t) - 2.0 * s1);
}

static void circle_eval(double x, struct profile_jet *out)
{
	/* Only x <= sqrt(1/2) is on this half of the curve. */
	double y = sqrt(1.0 - (x < 0.9 ? x * x : 0.81));

	*out = (struct profile_jet){y, -x / y, -1.0 / (y * y * y)};
}

/* Cubic Hermite between samples; straight on beyond the last. */
static void samples_eval(const struct profile *p, double x,
    struct profile_jet *out)
{
	int i = 0, last = p->count - 1;
	double h, u, rise, c2, c3;

	if (x >= p->x[last]) {
		*out = (struct profile_jet){p->y[last], p->slope[last], 0.0};
		out->y += p->slope[last] * (x - p->x[last]);
		return;
	}
	while (x > p->x[i + 1])
		i++;
	h = p->x[i + 1] - p->x[i];
	u = x - p->x[i];
	rise = (p->y[i + 1] - p->y[i]) / h;
	c2 = (3.0 * rise - 2.0 * p->slope[i] - p->slope[i + 1]) / h;
	c3 = (p->slope[i] + p->slope[i + 1] - 2.0 * rise) / (h * h);
	out->y = p->y[i] + u * (p->slope[i] + u * (c2 + u * c3));
	out->slope = p->slope[i] + u * (2.0 * c2 + u * 3.0 * c3);
	out->bend = 2.0 * c2 + 6.0 * c3 * u;
}

void profile_eval(const struct profile *profile, double x,
    struct profile_jet *out)
{
	*out = (struct profile_jet){1.0, 0.0, 0.0};
	if (!(x > 0.0))
		return;
	switch (profile->type) {
	case PROFILE_SMOOTH:
		smooth_eval(x, out);
		return;
	case PROFILE_BULGE:
		bulge_eval(profile->k, x, out);
		return;
	case PROFILE_CIRCLE:
		circle_eval(x, out);
		return;
	case PROFILE_SAMPLES:
		samples_eval(profile, x, out);
		return;
	case PROFILE_TYPE_COUNT:
		return;
	}
}

static enum err refuse(const char *sentence, int i, const char **why,
    int *index)
{
	*why = sentence;
	*index = i;
	return ERR_INVALID;
}

/* Whether the second half of a whole curve mirrors the first; *bad: where not. */
static bool is_mirrored(const double (*xy)[2], int count, int *bad)
{
	for (int i = 0; i < count; i++) {
		const double *p = xy[i], *q = xy[count - 1 - i];

		if (fabs(p[0] - q[1]) > 1e-6 || fabs(p[1] - q[0]) > 1e-6) {
			*bad = i;
			return false;
		}
	}
	return true;
}

/*
 * How many leading samples make the half with y >= x, the last of them on the
 * diagonal. A whole curve of even count has no sample there: the midpoint of
 * the two nearest, which mirror each other, is put into the half's last place
 * by the caller.
 */
static enum err half_of(const double (*xy)[2], int count, int *half,
    const char **why, int *index)
{
	const double *last = xy[count - 1];
	int bad;

	*half = count;
	if (fabs(last[0] - last[1]) <= 1e-6)
		return ERR_OK;
	if (fabs(last[0] - 1.0) > 1e-6 || fabs(last[1]) > 1e-6)
		return refuse("must end on the diagonal or at (1, 0)", count - 1,
		    why, index);
	if (!is_mirrored(xy, count, &bad))
		return refuse("is not the mirror image of its counterpart", bad,
		    why, index);
	*half = count / 2 + 1;
	return ERR_OK;
}

/* Fritsch and Carlson's monotone slopes, flat at the start. */
static void fit_monotone(struct profile *p)
{
	int n = p->count;

	p->slope[0] = 0.0;
	for (int i = 1; i < n; i++) {
		double h0 = p->x[i] - p->x[i - 1];
		double d0 = (p->y[i] - p->y[i - 1]) / h0, h1, d1;

		if (i == n - 1) {
			/* Parabola through the last interval, kept monotone. */
			double end = 2.0 * d0 - p->slope[i - 1];

			p->slope[i] = end > 0.0 ? 0.0 : fmax(end, 3.0 * d0);
			return;
		}
		h1 = p->x[i + 1] - p->x[i];
		d1 = (p->y[i + 1] - p->y[i]) / h1;
		p->slope[i] = d0 * d1 <= 0.0 ? 0.0 :
		    3.0 * (h0 + h1) / ((2.0 * h1 + h0) / d0 + (h1 + 2.0 * h0) / d1);
	}
}

/*
 * Slopes of the C2 cubic spline, flat at the start and without bend at the
 * end, by elimination of its tridiagonal system: with h and d the width and
 * rise of an interval, h1 s0 + 2 (h0 + h1) s1 + h0 s2 = 3 (h1 d0 + h0 d1).
 */
static void fit_spline(struct profile *p)
{
	double upper[PROFILE_SAMPLES_MAX] = {0.0}, right[PROFILE_SAMPLES_MAX];
	int n = p->count;

	right[0] = 0.0;
	for (int i = 1; i < n; i++) {
		double h0 = p->x[i] - p->x[i - 1];
		double d0 = (p->y[i] - p->y[i - 1]) / h0, h1 = 0.0, d1 = 0.0, pivot;

		if (i < n - 1) {
			h1 = p->x[i + 1] - p->x[i];
			d1 = (p->y[i + 1] - p->y[i]) / h1;
			pivot = 2.0 * (h0 + h1) - h1 * upper[i - 1];
			upper[i] = h0 / pivot;
			right[i] = (3.0 * (h1 * d0 + h0 * d1) -
			    h1 * right[i - 1]) / pivot;
		} else {
			/* s0 + 2 s1 = 3 d0 */
			right[i] = (3.0 * d0 - right[i - 1]) / (2.0 - upper[i - 1]);
		}
	}
	p->slope[n - 1] = right[n - 1];
	for (int i = n - 2; i >= 0; i--)
		p->slope[i] = right[i] - upper[i] * p->slope[i + 1];
}

/* Whether the cubics nowhere rise: Fritsch and Carlson's sufficient circle of
 * radius 3 about the ratios of slopes to rises. */
static bool is_monotone(const struct profile *p)
{
	for (int i = 0; i + 1 < p->count; i++) {
		double d = (p->y[i + 1] - p->y[i]) / (p->x[i + 1] - p->x[i]);
		double a = p->slope[i], b = p->slope[i + 1];

		if (a > 0.0 || b > 0.0 || a * a + b * b > 9.0 * d * d)
			return false;
	}
	return true;
}

/* The spline where it is monotone, else the monotone cubic, which is C1. */
static void fit_slopes(struct profile *p)
{
	fit_spline(p);
	if (!is_monotone(p))
		fit_monotone(p);
}

static enum err check_samples(const struct profile *p, const char **why,
    int *index)
{
	if (fabs(p->x[0]) > 1e-9 || fabs(p->y[0] - 1.0) > 1e-9)
		return refuse("must begin at (0, 1)", 0, why, index);
	for (int i = 1; i < p->count; i++) {
		if (!(p->x[i] > p->x[i - 1] + 1e-6))
			return refuse("x must rise from sample to sample", i, why,
			    index);
		if (!(p->y[i] <= p->y[i - 1]))
			return refuse("y must not rise", i, why, index);
		if (!(p->y[i] >= p->x[i] - 1e-6))
			return refuse("lies beyond the diagonal", i, why, index);
		if (!(p->x[i] + p->y[i] >= 1.0 - 1e-6))
			return refuse("lies inside the line from (0, 1) to (1, 0)",
			    i, why, index);
	}
	if (p->y[0] - p->y[1] > 0.2 * p->x[1])
		return refuse("the first step falls too steeply: the curve must "
		    "end flat", 1, why, index);
	return ERR_OK;
}

enum err profile_from_samples(const double (*xy)[2], int count,
    struct profile *out, const char **why, int *index)
{
	struct profile p = {.type = PROFILE_SAMPLES};
	enum err err;
	int half;

	if (count < 3)
		return refuse("needs at least 3 samples", 0, why, index);
	if (count > PROFILE_SAMPLES_MAX)
		return refuse("has too many samples", PROFILE_SAMPLES_MAX, why,
		    index);
	for (int i = 0; i < count; i++)
		if (!(fabs(xy[i][0]) <= 2.0 && fabs(xy[i][1]) <= 2.0))
			return refuse("is outside the unit square", i, why, index);
	err = half_of(xy, count, &half, why, index);
	if (err)
		return err;
	p.count = half;
	for (int i = 0; i < half; i++) {
		p.x[i] = xy[i][0];
		p.y[i] = xy[i][1];
	}
	if (half < count && count % 2 == 0)
		p.x[half - 1] = p.y[half - 1] =
		    0.5 * (xy[half - 2][0] + xy[half - 2][1]);
	err = check_samples(&p, why, index);
	if (err)
		return err;
	fit_slopes(&p);
	*out = p;
	return ERR_OK;
}

bool profile_equal(const struct profile *a, const struct profile *b)
{
	if (a->type != b->type)
		return false;
	if (a->type == PROFILE_BULGE)
		return a->k == b->k;
	if (a->type != PROFILE_SAMPLES)
		return true;
	if (a->count != b->count)
		return false;
	for (int i = 0; i < a->count; i++)
		if (a->x[i] != b->x[i] || a->y[i] != b->y[i])
			return false;
	return true;
}

const char *profile_name(enum profile_type type)
{
	static const char *const names[PROFILE_TYPE_COUNT] = {"smooth", "bulge",
	    "circle", "samples"};

	return names[type];
}
