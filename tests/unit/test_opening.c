#include <math.h>
#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>

#include <cmocka.h>

#include "core/opening.h"
#include "tests/support/golden.h"
#include "tests/support/near.h"

#define PI 3.14159265358979323846

static void kappa_row(void *ctx, const double *v)
{
	(void)ctx;
	assert_near(opening_kappa(v[0]), v[1], 1e-9);
}

static void test_kappa_golden(void **state)
{
	(void)state;
	assert_int_equal(golden_each("kappa", 2, kappa_row, NULL), 41);
}

static void opening_row(void *ctx, const double *v)
{
	assert_near(opening_theta(ctx, v[0]), v[1], 1e-9);
}

static void test_opening_golden(void **state)
{
	static const char *const names[] = {"camel", "organic", "contact"};

	(void)state;
	for (int i = 0; i < 3; i++) {
		char file[32] = "opening_";
		struct opening o;
		size_t n = 0;

		assert_true(opening_named(names[i], &o));
		while (names[i][n]) {
			file[8 + n] = names[i][n];
			n++;
		}
		assert_int_equal(golden_each(file, 2, opening_row, &o), 73);
	}
	assert_false(opening_named("dromedary", &(struct opening){{0}, {0}, {0}}));
}

/* kappa is flat at 0 and 1, so both sides of every seam agree. */
static void test_opening_is_continuous_at_its_angles(void **state)
{
	struct opening o = {{0.4, 1.1, 2.3}, {0.7, 0.1, 0.5}, {2.0, 0.5}};

	(void)state;
	for (int i = 0; i < 3; i++) {
		double at = o.alpha[i];

		assert_near(opening_theta(&o, at - 1e-9), o.theta[i], 1e-7);
		assert_near(opening_theta(&o, at + 1e-9), o.theta[i], 1e-7);
	}
}

/* Central differences with h = 1e-6 of functions of size 1: 1e-4 relative. */
static void test_opening_jet_agrees_with_differences(void **state)
{
	struct opening o = {{0.0, 1.1, 2.9}, {0.7, 0.1, 0.5}, {3.0, 0.7}};
	const double h = 1e-5;

	(void)state;
	for (double a = 0.05; a < PI; a += 0.05) {
		struct opening_jet j;
		double t0 = opening_theta(&o, a - h), t1 = opening_theta(&o, a);
		double t2 = opening_theta(&o, a + h), s = sin(a);
		double first = (t2 - t0) / (2 * h);
		double second = (t2 - 2 * t1 + t0) / (h * h);

		opening_eval(&o, cos(a), &j);
		assert_near(j.theta, t1, 1e-12);
		assert_near(j.slope, -first / s, 1e-5 * (1 + fabs(j.slope)));
		/* With c = cos(alpha): theta_cc = (theta'' + c theta_c)/sin^2 */
		assert_near(j.bend, (second + cos(a) * j.slope) / (s * s),
		    2e-3 * (1 + fabs(j.bend)) / (s * s));
	}
}

static void test_opening_jet_is_finite_at_the_ends(void **state)
{
	struct opening o;
	struct opening_jet j;

	(void)state;
	opening_named("camel", &o);
	for (int i = -1; i <= 1; i++) {
		for (double gap = 0.0; gap < 1e-3; gap = gap * 10 + 1e-18) {
			opening_eval(&o, i * (1.0 - gap), &j);
			assert_true(isfinite(j.theta) && isfinite(j.slope) &&
			    isfinite(j.bend));
		}
	}
	opening_eval(&o, 1.5, &j);
	assert_near(j.theta, PI / 4, 1e-12);
	assert_near(j.slope, 0.0, 0.0);
}

static void test_opening_empty_interval_is_a_jump(void **state)
{
	struct opening o = {{0.0, 0.0, 1.0}, {0.5, 0.2, 0.6}, {1.0, 1.0}};
	struct opening_jet j;

	(void)state;
	assert_near(opening_theta(&o, 0.0), 0.5, 0.0);
	assert_near(opening_theta(&o, 1e-3), 0.2, 1e-12);
	opening_eval(&o, 1.0, &j);
	assert_near(j.slope, 0.0, 0.0);
	o.alpha[2] = 0.0;
	assert_near(opening_theta(&o, 1e-3), 0.6, 0.0);
}

static void test_opening_check_names_the_number(void **state)
{
	static const struct {
		struct opening opening;
		const char *field;
		int index;
	} bad[] = {
		{{{-0.1, 1, 2}, {0, 0, 0}, {1, 1}}, "alpha", 0},
		{{{0, 1, 0.5}, {0, 0, 0}, {1, 1}}, "alpha", 2},
		{{{0, 1, 4}, {0, 0, 0}, {1, 1}}, "alpha", 2},
		{{{0, 1, 2}, {0, 0.8, 0}, {1, 1}}, "theta", 1},
		{{{0, 1, 2}, {0, 0, NAN}, {1, 1}}, "theta", 2},
		{{{0, 1, 2}, {0, 0, 0}, {1, 0}}, "w", 1},
		{{{0, 1, 2}, {0, 0, 0}, {INFINITY, 1}}, "w", 0},
	};
	struct opening good;
	const char *field = NULL;
	int index = -1;

	(void)state;
	for (size_t i = 0; i < sizeof(bad) / sizeof(bad[0]); i++) {
		assert_int_equal(opening_check(&bad[i].opening, &field, &index),
		    ERR_INVALID);
		assert_string_equal(field, bad[i].field);
		assert_int_equal(index, bad[i].index);
	}
	opening_named("organic", &good);
	assert_int_equal(opening_check(&good, &field, &index), ERR_OK);
}

static void test_opening_constant_and_least(void **state)
{
	struct opening o = opening_constant(0.3), camel;

	(void)state;
	opening_named("camel", &camel);
	assert_true(opening_is_constant(&o));
	assert_false(opening_is_constant(&camel));
	assert_near(opening_theta(&o, 1.0), 0.3, 1e-15);
	assert_near(opening_least(&camel), 0.0, 0.0);
	assert_true(opening_equal(&o, &o));
	assert_false(opening_equal(&o, &camel));
}

int main(void)
{
	const struct CMUnitTest tests[] = {
		cmocka_unit_test(test_kappa_golden),
		cmocka_unit_test(test_opening_golden),
		cmocka_unit_test(test_opening_is_continuous_at_its_angles),
		cmocka_unit_test(test_opening_jet_agrees_with_differences),
		cmocka_unit_test(test_opening_jet_is_finite_at_the_ends),
		cmocka_unit_test(test_opening_empty_interval_is_a_jump),
		cmocka_unit_test(test_opening_check_names_the_number),
		cmocka_unit_test(test_opening_constant_and_least),
	};

	return cmocka_run_group_tests_name("opening", tests, NULL, NULL);
}
