#include <math.h>
#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>
#include <string.h>

#include <cmocka.h>

#include "core/profile.h"
#include "tests/support/golden.h"
#include "tests/support/near.h"

static const double half_circle[][2] = {{0, 1}, {0.2, 0.98}, {0.4, 0.917},
    {0.6, 0.8}, {0.70710678, 0.70710678}};

static struct profile sampled(void)
{
	struct profile p;
	const char *why;
	int index;

	assert_int_equal(profile_from_samples(half_circle, 5, &p, &why, &index),
	    ERR_OK);
	return p;
}

/* Golden files hold the whole curve; ours the half with y >= x. */
static void silhouette_row(void *ctx, const double *v)
{
	struct profile p = profile_smooth();
	struct profile_jet b;

	(void)ctx;
	profile_eval(&p, fmin(v[0], v[1]), &b);
	assert_near(b.y, fmax(v[0], v[1]), 1e-9);
}

static void test_silhouette_smooth_golden(void **state)
{
	(void)state;
	assert_int_equal(golden_each("silhouette_smooth", 2, silhouette_row,
	    NULL), 80);
}

/* SPEC section 1: s(pi/4) = 1.140250301, so the diagonal is at s/sqrt(2). */
static void test_smooth_meets_the_diagonal(void **state)
{
	struct profile p = profile_smooth();
	double at = 1.140250301 / sqrt(2.0);
	struct profile_jet b;

	(void)state;
	profile_eval(&p, at, &b);
	assert_near(b.y, at, 1e-9);
	assert_near(b.slope, -1.0, 1e-8);
}

/* nu(x) nu(y) = 1 is the same curve. */
static void test_smooth_is_symmetric(void **state)
{
	(void)state;
	for (double x = 0.01; x < 0.8; x += 0.01) {
		double eta[3], back[3];

		profile_eta(x, eta);
		profile_eta(1.0 - eta[0], back);
		/* At y near 1, x = 1 - eta(y) is ill-conditioned by 1/eta'(x). */
		assert_near(1.0 - back[0], x, 1e-15 / eta[1] + 1e-14);
	}
}

/*
 * Erratum: the paper's Eq. 31 prints its two conditions the wrong way round.
 * Read as printed, the curve's half for t >= 1 would run over x = t > 1,
 * outside the unit square; as here it begins at (0, 1), where the union is
 * the maximum, and reaches the diagonal at (1, 1) with slope K.
 */
static void test_bulge_conditions_are_misprinted(void **state)
{
	struct profile p = profile_bulge(0.8);
	struct profile_jet b;

	(void)state;
	profile_eval(&p, 1e-3, &b);
	assert_near(b.y, 1.0, 1e-12);
	profile_eval(&p, 1.0, &b);
	assert_near(b.y, 1.0, 1e-12);
	assert_near(b.slope, 0.8, 1e-12);
	/* As printed, at t = 1.5: (t, 1 - K exp(1 - 1/t)(1 - t)) */
	assert_true(1.0 - 0.8 * exp(1.0 - 1.0 / 1.5) * (1.0 - 1.5) > 1.5);
}

static void test_profile_derivatives_agree_with_differences(void **state)
{
	struct profile all[] = {profile_smooth(), profile_bulge(0.3),
	    profile_bulge(1.0), profile_circle(), sampled()};
	const double h = 1e-5;

	(void)state;
	for (size_t i = 0; i < sizeof(all) / sizeof(all[0]); i++) {
		for (double x = 0.0213; x < 0.70; x += 0.0101) {
			struct profile_jet a, b, c;

			profile_eval(&all[i], x - h, &a);
			profile_eval(&all[i], x, &b);
			profile_eval(&all[i], x + h, &c);
			assert_near(b.slope, (c.y - a.y) / (2 * h), 1e-7);
			assert_near(b.bend, (c.slope - a.slope) / (2 * h),
			    1e-5 * (1 + fabs(b.bend)));
		}
	}
}

static void test_profiles_begin_flat_at_one(void **state)
{
	struct profile all[] = {profile_smooth(), profile_bulge(0.8),
	    profile_circle(), sampled()};

	(void)state;
	for (size_t i = 0; i < sizeof(all) / sizeof(all[0]); i++) {
		struct profile_jet b;

		profile_eval(&all[i], 1e-9, &b);
		/* smooth: eta(0) = 2.6e-7 and eta'(0) = 1.5e-5, not 0 */
		assert_near(b.y, 1.0, 3e-7);
		assert_near(b.slope, 0.0, 2e-5);
		profile_eval(&all[i], -1.0, &b);
		assert_near(b.y, 1.0, 0.0);
	}
}

static void test_samples_follow_their_points(void **state)
{
	struct profile p = sampled();

	(void)state;
	for (int i = 0; i < 5; i++) {
		struct profile_jet b;

		profile_eval(&p, half_circle[i][0], &b);
		assert_near(b.y, half_circle[i][1], 1e-12);
	}
	for (double x = 0.0; x < 0.7; x += 0.001) {
		struct profile_jet a, b;

		profile_eval(&p, x, &a);
		profile_eval(&p, x + 0.001, &b);
		assert_true(b.y <= a.y);
		/* five samples of a circle: within 0.6 % of it */
		assert_near(a.y, sqrt(1 - x * x), 6e-3);
	}
}

static void test_samples_of_the_whole_curve_are_halved(void **state)
{
	static const double odd[][2] = {{0, 1}, {0.4, 0.97}, {0.8, 0.8},
	    {0.97, 0.4}, {1, 0}};
	static const double even[][2] = {{0, 1}, {0.4, 0.97}, {0.97, 0.4},
	    {1, 0}};
	struct profile p;
	const char *why;
	int index;

	(void)state;
	assert_int_equal(profile_from_samples(odd, 5, &p, &why, &index), ERR_OK);
	assert_int_equal(p.count, 3);
	assert_int_equal(profile_from_samples(even, 4, &p, &why, &index), ERR_OK);
	assert_int_equal(p.count, 3);
	assert_near(p.x[2], 0.685, 1e-12);
	assert_near(p.y[2], 0.685, 1e-12);
}

static void test_samples_that_are_no_silhouette_are_refused(void **state)
{
	static const struct {
		double xy[4][2];
		const char *why;
		int index;
	} bad[] = {
		{{{0.1, 1}, {0.3, 1}, {0.5, 0.9}, {0.8, 0.8}}, "begin", 0},
		{{{0, 1}, {0.3, 1}, {0.3, 0.9}, {0.8, 0.8}}, "x must rise", 2},
		{{{0, 1}, {0.3, 0.99}, {0.5, 0.995}, {0.8, 0.8}}, "y must not", 2},
		{{{0, 1}, {0.3, 0.8}, {0.5, 0.7}, {0.6, 0.6}}, "steep", 1},
		{{{0, 1}, {0.3, 1}, {0.5, 0.9}, {0.8, 0.7}}, "diagonal", 3},
		{{{0, 1}, {0.3, 1}, {0.9, 0.4}, {1, 0}}, "mirror", 1},
		{{{0, 1}, {0.3, NAN}, {0.9, 0.4}, {1, 0}}, "square", 1},
		{{{0, 1}, {0.3, 0.98}, {0.35, 0.6}, {0.55, 0.55}}, "line", 2},
	};
	struct profile p;
	const char *why;
	int index;

	(void)state;
	for (size_t i = 0; i < sizeof(bad) / sizeof(bad[0]); i++) {
		assert_int_equal(profile_from_samples(bad[i].xy, 4, &p, &why,
		    &index), ERR_INVALID);
		assert_non_null(strstr(why, bad[i].why));
		assert_int_equal(index, bad[i].index);
	}
	assert_int_equal(profile_from_samples(half_circle, 2, &p, &why, &index),
	    ERR_INVALID);
	assert_int_equal(profile_from_samples(half_circle, 65, &p, &why, &index),
	    ERR_INVALID);
}

static void test_profile_equal(void **state)
{
	struct profile a = profile_bulge(0.3), b = profile_bulge(0.4);
	struct profile c = sampled(), d = sampled();

	(void)state;
	assert_true(profile_equal(&a, &a));
	assert_false(profile_equal(&a, &b));
	assert_false(profile_equal(&a, &c));
	assert_true(profile_equal(&c, &d));
	d.y[1] -= 1e-9;
	assert_false(profile_equal(&c, &d));
	assert_string_equal(profile_name(PROFILE_SAMPLES), "samples");
}

int main(void)
{
	const struct CMUnitTest tests[] = {
		cmocka_unit_test(test_silhouette_smooth_golden),
		cmocka_unit_test(test_smooth_meets_the_diagonal),
		cmocka_unit_test(test_smooth_is_symmetric),
		cmocka_unit_test(test_bulge_conditions_are_misprinted),
		cmocka_unit_test(test_profile_derivatives_agree_with_differences),
		cmocka_unit_test(test_profiles_begin_flat_at_one),
		cmocka_unit_test(test_samples_follow_their_points),
		cmocka_unit_test(test_samples_of_the_whole_curve_are_halved),
		cmocka_unit_test(test_samples_that_are_no_silhouette_are_refused),
		cmocka_unit_test(test_profile_equal),
	};

	return cmocka_run_group_tests_name("profile", tests, NULL, NULL);
}
