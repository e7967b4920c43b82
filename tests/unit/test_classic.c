#include <math.h>
#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>
#include <stdio.h>

#include <cmocka.h>

#include "core/classic.h"
#include "core/operator.h"
#include "tests/support/near.h"

#define COUNT(array) (sizeof(array) / sizeof(*(array)))
#define QUARTER_PI 0.78539816339744830962
/* Fields of the grids: the iso-value, 0, 1 and more among them. */
#define STEPS 31
#define STEP(i) (0.05 * (i))

/* Every type, with numbers that show its members; the symmetric ones and those
 * that are 0 where both fields are. */
static const struct {
	struct classic classic;
	bool symmetric, compact;
} cases[] = {
	{{CLASSIC_SUPER_ELLIPTIC, {0.5, 0.8, 2.5}}, false, true},
	{{CLASSIC_SUPER_ELLIPTIC, {1.0, 1.0, 1.0}}, true, true},
	{{CLASSIC_SUPER_ELLIPTIC, {0.2, 0.2, 8.0}}, true, true},
	{{CLASSIC_R_BLEND, {0.4, 0.5, 0.9}}, false, false},
	{{CLASSIC_R_BLEND, {-2.0, 0.01, 100.0}}, false, false},
	{{CLASSIC_FUNCTIONAL, {0.3}}, true, false},
	{{CLASSIC_FUNCTIONAL, {2.0}}, true, false},
	{{CLASSIC_R_CLEAN, {0}}, true, false},
	{{CLASSIC_BARTHE_CLEAN, {0}}, true, true},
	{{CLASSIC_RICCI, {1.0}}, true, true},
	{{CLASSIC_RICCI, {2.5}}, true, true},
	{{CLASSIC_RICCI, {1000.0}}, true, true},
	{{CLASSIC_BARTHE_OPENING, {0.0, 0.0}}, true, true},
	{{CLASSIC_BARTHE_OPENING, {0.3, 0.3}}, true, true},
	{{CLASSIC_BARTHE_OPENING, {0.6, 0.2}}, false, true},
	{{CLASSIC_BARTHE_OPENING, {0.78, 0.78}}, true, true},
	{{CLASSIC_BARTHE_OPENING, {0.3, QUARTER_PI}}, false, true},
	{{CLASSIC_INTERPOLATION, {0.4}}, true, true},
	{{CLASSIC_POWER_DIFFERENCE, {1.0}}, false, true},
	{{CLASSIC_POWER_DIFFERENCE, {3.5}}, false, true},
};
#define CASES COUNT(cases)

static void eval(const struct classic *c, int family, double f1, double f2,
    struct operator_jet *out)
{
	double params[CLASSIC_PARAMS_MAX];

	classic_prepare(c, family, params);
	classic_eval(c->type, params, f1, f2, 2, out);
}

static double value(const struct classic *c, int family, double f1, double f2)
{
	struct operator_jet j;

	eval(c, family, f1, f2, &j);
	return j.g;
}

/* --- The formulas, written anew, as they are in core/classic.h. ----------- */

static double plus(double x)
{
	return x > 0.0 ? x : 0.0;
}

static double super_term(double x, double r, double t)
{
	const double top = 1 + 1 / r;

	if (x > 1)
		return pow(top, t) + t / r * pow(top, t - 1) * 2 * (x - 1);
	return pow(plus(1 + (2 * x - 1) / r), t);
}

static double r_blend(const double *p, double x, double y)
{
	const double F1 = 2 * x - 1, F2 = 2 * y - 1;

	return (F1 + F2 + hypot(F1, F2) + p[0] /
	    (1 + F1 * F1 / p[1] / p[1] + F2 * F2 / p[2] / p[2]) + 1) / 2;
}

/* These are negative while C is under the operator's value at (x, y). */

static double extruded(const double *p, double x, double y, double C)
{
	/* C of F; beyond the quarter of a circle, its two lines. */
	const double a = 2 * x - 1 - C + p[0], b = 2 * y - 1 - C + p[0];

	if (a < 0 || b < 0)
		return p[0] - fmax(a, b);
	return p[0] - hypot(a, b);
}

static double clean_arcs(const double *p, double x, double y, double C)
{
	const double k = C > 0.5 ? 0.5 : 2 * C * C;

	(void)p;
	return C - k - hypot(plus(x - k), plus(y - k));
}

static double ellipses(const double *p, double x, double y, double C)
{
	const double a = plus(x - p[0] * C), b = plus(y - p[1] * C);

	/* Flat arcs are the lines x = C, y = C. */
	if (p[0] > 0.999 || p[1] > 0.999)
		return C - fmax(x, y);
	return C - hypot(a / (1 - p[0]), b / (1 - p[1]));
}

static double root(double (*of)(const double *, double, double, double),
    const double *p, double x, double y)
{
	double low = -2, high = 8;

	for (int i = 0; i < 100; i++) {
		const double middle = (low + high) / 2;

		if (of(p, x, y, middle) < 0)
			low = middle;
		else
			high = middle;
	}
	return (low + high) / 2;
}

static double formula(const struct classic *c, double x, double y)
{
	const double none[] = {0, 1, 1}, *p = c->p;
	double t[2];

	switch (c->type) {
	case CLASSIC_SUPER_ELLIPTIC:
		return (super_term(x, p[0], p[2]) +
		    super_term(y, p[1], p[2])) / 2;
	case CLASSIC_R_BLEND:
		return r_blend(p, x, y);
	case CLASSIC_FUNCTIONAL:
		return (root(extruded, p, x, y) + 1) / 2;
	case CLASSIC_R_CLEAN:
		return r_blend(none, x, y);
	case CLASSIC_BARTHE_CLEAN:
		return root(clean_arcs, p, x, y);
	case CLASSIC_RICCI:
		return x == 0 && y == 0 ? 0 : fmax(x, y) *
		    pow(1 + pow(fmin(x, y) / fmax(x, y), p[0]), 1 / p[0]);
	case CLASSIC_BARTHE_OPENING:
		t[0] = tan(p[0]);
		t[1] = tan(p[1]);
		return root(ellipses, t, x, y);
	case CLASSIC_INTERPOLATION:
		return (1 - p[0]) * root(clean_arcs, p, x, y) +
		    p[0] * (x + y);
	}
	return x - pow(2 * y, p[0]) / 2;
}

/* By De Morgan; operators of compact support are min where a field is over
 * 1. */
static double family_formula(const struct classic *c, bool compact, int family,
    double f1, double f2)
{
	const double x = 1 - f1;
	const double y = family == CLASSIC_INTERSECTION ? 1 - f2 : fmin(f2, 1);

	if (family == CLASSIC_UNION || c->type == CLASSIC_POWER_DIFFERENCE)
		return plus(formula(c, f1, f2));
	if (compact && c->type != CLASSIC_SUPER_ELLIPTIC && (x < 0 || y < 0))
		return fmin(f1, 1 - y);
	return plus(1 - formula(c, x, y));
}

static void test_every_operator_is_its_formula_over_a_grid(void **state)
{
	double worst = 0;

	(void)state;
	for (size_t i = 0; i < CASES * 3 * STEPS * STEPS; i++) {
		const double f1 = STEP(i % STEPS);
		const double f2 = STEP(i / STEPS % STEPS);
		const int family = (int)(i / STEPS / STEPS % 3);
		const size_t k = i / STEPS / STEPS / 3;
		const struct classic *c = &cases[k].classic;
		double g, expected;

		if (!classic_has_family(c->type, family))
			continue;
		g = value(c, family, f1, f2);
		expected = family_formula(c, cases[k].compact, family, f1, f2);
		/* Measured: 1.3e-15 of 1 + g. */
		assert_near(g, expected, 1e-14 * (1 + fabs(expected)));
		worst = fmax(worst, fabs(g - expected) / (1 + fabs(expected)));
	}
	print_message("measured: values are off by %.1e of 1 + g\n", worst);
}

/* Small deterministic numbers in [0, 1). */
static double draw(uint64_t *state)
{
	*state = *state * 6364136223846793005u + 1442695040888963407u;
	return (double)(*state >> 11) / 9007199254740992.0;
}

/* Whether derivatives at two points 2e-5 apart are those of one smooth
 * function, roughly. */
static bool is_smooth(const struct operator_jet *a,
    const struct operator_jet *b)
{
	return fabs(a->g1 - b->g1) < 1e-2 * (1 + fabs(a->g1)) &&
	    fabs(a->g2 - b->g2) < 1e-2 * (1 + fabs(a->g2)) &&
	    fabs(a->g11 - b->g11) < 1e-2 * (1 + fabs(a->g11)) &&
	    fabs(a->g12 - b->g12) < 1e-2 * (1 + fabs(a->g12)) &&
	    fabs(a->g22 - b->g22) < 1e-2 * (1 + fabs(a->g22));
}

/* Whether derivatives at (f1, f2) are differences along f1, or (turned) f2;
 * false if a kink is near. */
static bool check_differences(const struct classic *c, int family, double f1,
    double f2, bool turned)
{
	const double h = 1e-5, d1 = turned ? 0 : h, d2 = turned ? h : 0;
	struct operator_jet j, a, b;
	double size;

	eval(c, family, f1, f2, &j);
	eval(c, family, f1 - d1, f2 - d2, &a);
	eval(c, family, f1 + d1, f2 + d2, &b);
	if (!is_smooth(&a, &b))
		return false;
	/* Measured: 1.1e-5 of that at most, mostly 1e-9. */
	size = 1e-4 * (1 + fabs(j.g1) + fabs(j.g2) + fabs(j.g11) +
	    fabs(j.g12) + fabs(j.g22));
	assert_near((b.g - a.g) / (2 * h), turned ? j.g2 : j.g1, size);
	assert_near((b.g1 - a.g1) / (2 * h), turned ? j.g12 : j.g11, size);
	assert_near((b.g2 - a.g2) / (2 * h), turned ? j.g22 : j.g12, size);
	return true;
}

static void test_derivatives_are_differences(void **state)
{
	uint64_t seed = 3;

	(void)state;
	for (size_t k = 0; k < CASES; k++) {
		const struct classic *c = &cases[k].classic;
		int smooth = 0, all = 0;

		for (int i = 0; i < 6000; i++) {
			const int family = i % 3;
			double f1 = 0.01 + 1.4 * draw(&seed);
			double f2 = 0.01 + 1.4 * draw(&seed);

			if (!classic_has_family(c->type, family))
				continue;
			smooth += check_differences(c, family, f1, f2, i % 2);
			all++;
		}
		/* Measured: 99.4 % at least. */
		assert_true(smooth > 0.98 * all);
	}
}

static void test_orders_below_two_leave_derivatives_at_0(void **state)
{
	double params[CLASSIC_PARAMS_MAX];
	struct operator_jet j;

	(void)state;
	for (size_t k = 0; k < CASES; k++) {
		classic_prepare(&cases[k].classic, CLASSIC_DIFFERENCE, params);
		classic_eval(cases[k].classic.type, params, 0.52, 0.4, 0, &j);
		assert_true(j.g > 0 && j.g1 == 0 && j.g2 == 0 && j.g11 == 0);
		classic_eval(cases[k].classic.type, params, 0.52, 0.4, 1, &j);
		assert_true((j.g1 != 0 || j.g2 != 0) && j.g11 == 0 &&
		    j.g12 == 0 && j.g22 == 0 && j.gt == 0 && j.gtt == 0);
	}
}

static void test_symmetric_ones_take_fields_in_any_order(void **state)
{
	uint64_t seed = 4;

	(void)state;
	for (int i = 0; i < 20000; i++) {
		const size_t k = (size_t)i % CASES;
		const struct classic *c = &cases[k].classic;
		const double f1 = 1.5 * draw(&seed), f2 = 1.5 * draw(&seed);
		const int family = i / (int)CASES % 2;
		struct operator_jet a, b;

		if (!cases[k].symmetric)
			continue;
		eval(c, family, f1, f2, &a);
		eval(c, family, f2, f1, &b);
		assert_near(a.g, b.g, 1e-15 * (1 + a.g));
		assert_near(a.g1, b.g2, 1e-12 * (1 + fabs(a.g1)));
		assert_near(a.g22, b.g11, 1e-10 * (1 + fabs(a.g22)));
	}
	for (size_t k = 0; k < CASES; k++) {
		const int family = CLASSIC_DIFFERENCE;

		/* Not even De Morgan's difference is. */
		assert_true(fabs(value(&cases[k].classic, family, 0.9, 0.3) -
		    value(&cases[k].classic, family, 0.3, 0.9)) > 0.1);
	}
}

static void test_clean_ones_have_the_iso_surface_of_max(void **state)
{
	static const struct classic clean[] = {
		{CLASSIC_R_CLEAN, {0}}, {CLASSIC_BARTHE_CLEAN, {0}},
		{CLASSIC_INTERPOLATION, {0}},
		{CLASSIC_BARTHE_OPENING, {QUARTER_PI, QUARTER_PI}},
	};

	(void)state;
	for (size_t k = 0; k < COUNT(clean); k++) {
		for (double f = 0; f <= 0.5; f += 1.0 / 128) {
			assert_near(value(&clean[k], CLASSIC_UNION, 0.5, f),
			    0.5, 1e-15);
			assert_near(value(&clean[k], CLASSIC_UNION, f, 0.5),
			    0.5, 1e-15);
			assert_near(value(&clean[k], CLASSIC_INTERSECTION,
			    1 - f, 0.5), 0.5, 1e-15);
			assert_near(value(&clean[k], CLASSIC_DIFFERENCE,
			    0.5, f), 0.5, 1e-15);
		}
		assert_true(value(&clean[k], CLASSIC_UNION, 0.499, 0.499) <
		    0.5);
		assert_true(value(&clean[k], CLASSIC_UNION, 0.501, 0.1) > 0.5);
		assert_true(value(&clean[k], CLASSIC_INTERSECTION, 0.501,
		    0.501) > 0.5);
	}
}

/* The paper's point about clean unions: off the edge, only max has one. */
static void test_clean_ones_have_one_gradient_on_the_diagonal(void **state)
{
	static const struct classic clean[] = {
		{CLASSIC_R_CLEAN, {0}}, {CLASSIC_BARTHE_CLEAN, {0}}};

	(void)state;
	for (size_t k = 0; k < COUNT(clean); k++) {
		for (double f = 0.05; f < 1.2; f += 0.0937) {
			struct operator_jet a, b;

			eval(&clean[k], CLASSIC_UNION, f + 1e-9, f, &a);
			eval(&clean[k], CLASSIC_UNION, f, f + 1e-9, &b);
			/* Measured: 1.2e-7 beside the edge. */
			assert_near(a.g1, b.g1, 1e-6);
			assert_near(a.g2, b.g2, 1e-6);
		}
	}
}

static void test_blends_only_add_to_unions_and_take_from_intersections(
    void **state)
{
	(void)state;
	for (size_t i = 0; i < CASES * STEPS * STEPS; i++) {
		const double f1 = STEP(i % STEPS);
		const double f2 = STEP(i / STEPS % STEPS);
		const struct classic *c = &cases[i / STEPS / STEPS].classic;

		/* R-functions and Rockwood's have other values off the
		 * iso-surface, but not another sign. */
		if (c->type == CLASSIC_POWER_DIFFERENCE ||
		    (c->type == CLASSIC_R_BLEND && c->p[0] < 0))
			continue;
		if (fmax(f1, f2) > 0.5)
			assert_true(value(c, CLASSIC_UNION, f1, f2) >
			    0.5 - 1e-15);
		if (fmin(f1, f2) < 0.5)
			assert_true(value(c, CLASSIC_INTERSECTION, f1, f2) <
			    0.5 + 1e-15);
		if (f1 < 0.5 || f2 > 0.5)
			assert_true(value(c, CLASSIC_DIFFERENCE, f1, f2) <
			    0.5 + 1e-15);
	}
}

/* Values at 0 and 0 as core/classic.h has them. */
static void test_support(void **state)
{
	const struct classic *blend = &cases[3].classic;
	const double *a = blend->p;

	(void)state;
	for (size_t k = 0; k < CASES; k++) {
		const struct classic *c = &cases[k].classic;
		const bool has_union = classic_has_family(c->type,
		    CLASSIC_UNION);

		if (cases[k].compact && has_union)
			assert_true(value(c, CLASSIC_UNION, 0, 0) == 0);
		/* What is cut off or cut out of stays 0 where it was. */
		if (has_union && cases[k].compact)
			assert_true(value(c, CLASSIC_INTERSECTION, 0, 0.9) ==
			    0);
		if (cases[k].compact)
			assert_true(value(c, CLASSIC_DIFFERENCE, 0, 0.3) == 0);
		/* Where one field is 0 these are the other. */
		for (double f = 0; c->type >= CLASSIC_BARTHE_CLEAN &&
		    has_union && f < 1.5; f += 0.07) {
			assert_near(value(c, CLASSIC_UNION, f, 0), f, 1e-15);
			assert_near(value(c, CLASSIC_DIFFERENCE, f, 0),
			    fmin(f, 1), 1e-15);
		}
	}
	assert_near(value(&cases[7].classic, CLASSIC_UNION, 0, 0),
	    (sqrt(2) - 1) / 2, 1e-15);
	assert_near(value(blend, CLASSIC_UNION, 0, 0), (sqrt(2) - 1 + a[0] /
	    (1 + 1 / a[1] / a[1] + 1 / a[2] / a[2])) / 2, 1e-15);
	assert_near(value(&cases[5].classic, CLASSIC_UNION, 0, 0),
	    (2 - sqrt(2)) * 0.3 / 4, 1e-15);
	/* Rockwood's support ends at (1 - r)/2. */
	assert_true(value(&cases[0].classic, CLASSIC_UNION, 0.25, 0.1) == 0);
	assert_true(value(&cases[0].classic, CLASSIC_UNION, 0.2501, 0.1) > 0);
}

/* Points of iso-curves g = 1/2 known beforehand. */
static void test_iso_curves(void **state)
{
	const struct classic rockwood = {CLASSIC_SUPER_ELLIPTIC, {0.5, 0.8, 2}};
	const struct classic functional = {CLASSIC_FUNCTIONAL, {0.6}};
	const struct classic ricci = {CLASSIC_RICCI, {2}};
	const struct classic arcs = {CLASSIC_BARTHE_OPENING, {0.3, 0.3}};
	const struct classic clean = {CLASSIC_BARTHE_CLEAN, {0}};

	(void)state;
	for (double phi = 0.0; phi <= 1.5708; phi += 1.5707 / 64) {
		const double c = cos(phi), s = sin(phi), t = tan(0.3);
		/* An ellipse about F = (-r1, -r2). */
		double f1 = (1 + 0.5 * (c - 1)) / 2;
		double f2 = (1 + 0.8 * (s - 1)) / 2;

		assert_near(value(&rockwood, CLASSIC_UNION, f1, f2), 0.5,
		    1e-15);
		/* Its mirror image, about F = (r1, r2). */
		assert_near(value(&rockwood, CLASSIC_INTERSECTION, 1 - f1,
		    1 - f2), 0.5, 1e-15);
		f1 = (1 + 0.6 * (c - 1)) / 2;
		f2 = (1 + 0.6 * (s - 1)) / 2;
		assert_near(value(&functional, CLASSIC_UNION, f1, f2), 0.5,
		    1e-15);
		assert_near(value(&ricci, CLASSIC_UNION, c / 2, s / 2), 0.5,
		    1e-15);
		assert_near(value(&ricci, CLASSIC_DIFFERENCE, 1 - c / 2,
		    s / 2), 0.5, 1e-15);
		assert_near(value(&arcs, CLASSIC_UNION,
		    (t + (1 - t) * c) / 2, (t + (1 - t) * s) / 2), 0.5, 2e-15);
		/* BARTHE_CLEAN's curves of 1/4 and 3/4, of radius 1/8, 1/4. */
		assert_near(value(&clean, CLASSIC_UNION, (1 + c) / 8,
		    (1 + s) / 8), 0.25, 1e-15);
		assert_near(value(&clean, CLASSIC_UNION, 0.5 + c / 4,
		    0.5 + s / 4), 0.75, 1e-15);
	}
}

static void test_special_members_make_simpler_operators(void **state)
{
	const struct classic arcs = {CLASSIC_BARTHE_OPENING, {0}};
	const struct classic ricci = {CLASSIC_RICCI, {2}};
	const struct classic sum = {CLASSIC_INTERPOLATION, {1}};
	const struct classic blend = {CLASSIC_R_BLEND, {0, 0.3, 0.3}};
	const struct classic r_clean = {CLASSIC_R_CLEAN, {0}};
	uint64_t seed = 5;

	(void)state;
	for (int i = 0; i < 2000; i++) {
		const double f1 = 1.5 * draw(&seed), f2 = 1.5 * draw(&seed);
		struct operator_jet a, b;

		eval(&arcs, CLASSIC_UNION, f1, f2, &a);
		eval(&ricci, CLASSIC_UNION, f1, f2, &b);
		assert_near(a.g, b.g, 1e-14);
		assert_near(a.g2, b.g2, 1e-14);
		assert_near(a.g11, b.g11, 1e-12 * (1 + b.g11));
		assert_near(value(&sum, CLASSIC_UNION, f1, f2), f1 + f2, 1e-15);
		eval(&blend, CLASSIC_INTERSECTION, f1, f2, &a);
		eval(&r_clean, CLASSIC_INTERSECTION, f1, f2, &b);
		assert_near(a.g, b.g, 0);
		assert_near(a.g11, b.g11, 0);
	}
}

/* A step of 1e-9 moves no value further than the gradients allow. */
static void test_every_operator_is_continuous(void **state)
{
	uint64_t seed = 6;

	(void)state;
	for (int i = 0; i < 200000; i++) {
		const struct classic *c = &cases[(size_t)i % CASES].classic;
		const int family = i / (int)CASES % 3;
		double f1 = 1.5 * draw(&seed), f2 = 1.5 * draw(&seed);
		struct operator_jet a, b;

		if (!classic_has_family(c->type, family))
			continue;
		/* On the lines where branches meet, too. */
		if (i % 5 == 0)
			f2 = f1;
		if (i % 5 == 1)
			f1 = i % 2 ? 0.5 : 1;
		if (i % 5 == 2)
			f2 = f1 < 0.5 ? 2 * f1 * f1 : 0.5;
		eval(c, family, f1, f2, &a);
		eval(c, family, f1 + 1e-9, f2 - 1e-9, &b);
		assert_near(a.g, b.g, 3e-9 * (1 + fabs(a.g1) + fabs(a.g2) +
		    fabs(b.g1) + fabs(b.g2)));
	}
}

static void test_no_input_gives_an_infinite_number(void **state)
{
	static const double fields[] = {0, 5e-324, 1e-300, 1e-40, 1e-20, 1e-9,
	    0.25, 0.4999999999999999, 0.5, 0.5000000000000001, 0.999999, 1,
	    1.0000001, 2, 1e6, 1e18};

	(void)state;
	for (size_t k = 0; k < CASES; k++) {
		for (size_t i = 0; i < COUNT(fields) * COUNT(fields) * 3; i++) {
			const int family = (int)(i % 3);
			struct operator_jet j;

			if (!classic_has_family(cases[k].classic.type, family))
				continue;
			eval(&cases[k].classic, family,
			    fields[i / 3 % COUNT(fields)],
			    fields[i / 3 / COUNT(fields)], &j);
			assert_true(isfinite(j.g) && j.g >= 0);
			assert_true(fabs(j.g1) <= CLASSIC_SLOPE_MAX &&
			    fabs(j.g2) <= CLASSIC_SLOPE_MAX);
			assert_true(fabs(j.g11) <= CLASSIC_BEND_MAX &&
			    fabs(j.g12) <= CLASSIC_BEND_MAX &&
			    fabs(j.g22) <= CLASSIC_BEND_MAX);
		}
	}
}

static void test_singular_points_have_a_gradient(void **state)
{
	struct operator_jet j;

	(void)state;
	for (size_t k = 0; k < CASES; k++) {
		const struct classic *c = &cases[k].classic;

		if (!classic_has_family(c->type, CLASSIC_UNION))
			continue;
		eval(c, CLASSIC_UNION, 0.5, 0.5, &j);
		assert_true(j.g1 + j.g2 > 0.99 || j.g == 0);
		if (c->type == CLASSIC_R_CLEAN)
			assert_true(j.g1 == 1 && j.g2 == 1 && j.g11 == 0);
	}
}

int main(void)
{
	const struct CMUnitTest tests[] = {
		cmocka_unit_test(
		    test_every_operator_is_its_formula_over_a_grid),
		cmocka_unit_test(test_derivatives_are_differences),
		cmocka_unit_test(test_orders_below_two_leave_derivatives_at_0),
		cmocka_unit_test(test_symmetric_ones_take_fields_in_any_order),
		cmocka_unit_test(test_clean_ones_have_the_iso_surface_of_max),
		cmocka_unit_test(
		    test_clean_ones_have_one_gradient_on_the_diagonal),
		cmocka_unit_test(
		    test_blends_only_add_to_unions_and_take_from_intersections),
		cmocka_unit_test(test_support),
		cmocka_unit_test(test_iso_curves),
		cmocka_unit_test(test_special_members_make_simpler_operators),
		cmocka_unit_test(test_every_operator_is_continuous),
		cmocka_unit_test(test_no_input_gives_an_infinite_number),
		cmocka_unit_test(test_singular_points_have_a_gradient),
	};

	return cmocka_run_group_tests_name("classic", tests, NULL, NULL);
}
