#include "core/opening.h"

#include <math.h>
#include <string.h>

#define PI 3.14159265358979323846

/* Below this exponent exp() is 0 for every purpose here. */
#define EXPONENT_LEAST -700.0

struct kappa_jet {
	double value;
	double log_slope; /* kappa' / kappa, finite where kappa underflows */
	double log_bend;  /* kappa'' / kappa */
};

static const struct {
	const char *name;
	struct opening opening;
} named[] = {
	{"camel", {{0.0, PI / 2, PI}, {PI / 4, 0.0, PI / 4}, {1.0, 1.0}}},
	{"organic", {{0.0, PI / 3, 3 * PI / 4}, {PI / 6, 0.0, PI / 4}, {3.0, 1.0}}},
	{"contact", {{0.0, PI / 2, PI}, {0.0, PI / 10, PI / 4}, {1.0, 0.7}}},
};

/*
 * With a = exp(1 - 1/x), b = 1 - a and h = 1 - 1/b = -a/b, kappa = 1 - e^h.
 * h' = -a'/b^2, h'' = -a''/b^2 - 2 a'^2/b^3.
 */
static void kappa_eval(double x, struct kappa_jet *out)
{
	double a, a1, a2, b, h, h1, h2, e;

	*out = (struct kappa_jet){0.0, 0.0, 0.0};
	if (!(x > 0.0) || 1.0 - 1.0 / x < EXPONENT_LEAST)
		return;
	out->value = 1.0;
	if (x >= 1.0)
		return;
	b = -expm1(1.0 - 1.0 / x);
	a = 1.0 - b;
	if (a <= 0.5)
		a = exp(1.0 - 1.0 / x);
	h = -a / b;
	if (h < EXPONENT_LEAST)
		return;
	a1 = a / (x * x);
	a2 = a * (1.0 - 2.0 * x) / (x * x * x * x);
	h1 = -a1 / (b * b);
	h2 = -a2 / (b * b) - 2.0 * a1 * a1 / (b * b * b);
	e = exp(h);
	out->value = -expm1(h);
	out->log_slope = -e * h1 / out->value;
	out->log_bend = -e * (h2 + h1 * h1) / out->value;
}

double opening_kappa(double x)
{
	struct kappa_jet kappa;

	kappa_eval(x, &kappa);
	return kappa.value;
}

static enum err refuse(const char *name, int i, const char **field, int *index)
{
	*field = name;
	*index = i;
	return ERR_INVALID;
}

enum err opening_check(const struct opening *opening, const char **field,
    int *index)
{
	double least = 0.0;

	for (int i = 0; i < 3; i++) {
		if (!(opening->alpha[i] >= least && opening->alpha[i] <= PI))
			return refuse("alpha", i, field, index);
		least = opening->alpha[i];
	}
	for (int i = 0; i < 3; i++)
		if (!(opening->theta[i] >= 0.0 && opening->theta[i] <= PI / 4))
			return refuse("theta", i, field, index);
	for (int i = 0; i < 2; i++)
		if (!(opening->w[i] > 0.0 && isfinite(opening->w[i])))
			return refuse("w", i, field, index);
	return ERR_OK;
}

/*
 * theta and its first two derivatives in alpha. On the side of index i (0
 * below alpha1, 2 above) x = (alpha - alpha1)/(alpha_i - alpha1) and
 * theta = kappa(x)^w (theta_i - theta1) + theta1.
 */
static void theta_eval(const struct opening *o, double alpha,
    double out[static 3])
{
	int i = alpha <= o->alpha[1] ? 0 : 2;
	double span = o->alpha[i] - o->alpha[1], rise = o->theta[i] - o->theta[1];
	double w = o->w[i / 2], power;
	struct kappa_jet kappa;

	out[1] = out[2] = 0.0;
	if (alpha <= o->alpha[0] || alpha >= o->alpha[2]) {
		out[0] = o->theta[alpha <= o->alpha[0] ? 0 : 2];
		return;
	}
	kappa_eval((alpha - o->alpha[1]) / span, &kappa);
	power = pow(kappa.value, w);
	out[0] = power * rise + o->theta[1];
	out[1] = rise * w * power * kappa.log_slope / span;
	out[2] = rise * w * power * (kappa.log_bend +
	    (w - 1.0) * kappa.log_slope * kappa.log_slope) / (span * span);
}

double opening_theta(const struct opening *opening, double alpha)
{
	double theta[3];

	theta_eval(opening, alpha, theta);
	return theta[0];
}

void opening_eval(const struct opening *opening, double cosine,
    struct opening_jet *out)
{
	double c = cosine > 1.0 ? 1.0 : cosine < -1.0 ? -1.0 : cosine;
	double square = (1.0 - c) * (1.0 + c), theta[3];

	theta_eval(opening, acos(c), theta);
	*out = (struct opening_jet){theta[0], 0.0, 0.0};
	/* theta is flat at 0 and pi, since kappa is flat at both its ends. */
	if (square < 1e-12)
		return;
	out->slope = -theta[1] / sqrt(square);
	out->bend = (theta[2] + c * out->slope) / square;
}

bool opening_is_constant(const struct opening *opening)
{
	return opening->theta[0] == opening->theta[1] &&
	    opening->theta[1] == opening->theta[2];
}

double opening_least(const struct opening *opening)
{
	return fmin(opening->theta[0], fmin(opening->theta[1],
	    opening->theta[2]));
}

bool opening_named(const char *name, struct opening *out)
{
	for (size_t i = 0; i < sizeof(named) / sizeof(named[0]); i++) {
		if (strcmp(name, named[i].name) == 0) {
			*out = named[i].opening;
			return true;
		}
	}
	return false;
}

struct opening opening_constant(double theta)
{
	return (struct opening){{0.0, PI / 2, PI}, {theta, theta, theta},
	    {1.0, 1.0}};
}

static int compare_numbers(const double *a, const double *b, int count)
{
	for (int i = 0; i < count; i++)
		if (a[i] != b[i])
			return a[i] < b[i] ? -1 : 1;
	return 0;
}

int opening_compare(const struct opening *a, const struct opening *b)
{
	int order = compare_numbers(a->alpha, b->alpha, 3);

	if (order == 0)
		order = compare_numbers(a->theta, b->theta, 3);
	return order != 0 ? order : compare_numbers(a->w, b->w, 2);
}

bool opening_equal(const struct opening *a, const struct opening *b)
{
	return opening_compare(a, b) == 0;
}
