#include <math.h>
#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>

#include <cmocka.h>

#include "core/curve.h"
#include "core/table.h"
#include "tests/support/near.h"

#define QUARTER_PI 0.78539816339744830962

/* The whole sample takes minutes with sanitizers; its first points will do. */
#define SAMPLE 50000

static struct table *build(enum operator_family family, struct profile profile,
    enum table_layout layout, int resolution)
{
	struct table *t;

	assert_int_equal(table_create(family, &profile, layout, resolution, &t),
	    ERR_OK);
	table_build(t, 0, resolution);
	return t;
}

static void measure(const struct table *t, struct table_error *out)
{
	float *errors = malloc(SAMPLE * TABLE_QUANTITIES * sizeof(*errors));

	assert_non_null(errors);
	table_measure(t, 0, SAMPLE, errors, SAMPLE);
	table_error_summarise(errors, SAMPLE, SAMPLE, out);
	free(errors);
}

/*
 * Bounds for the default layout at 64 nodes, from `make bench` (10^6 points):
 * max and mean of g, 99th percentile of the first derivatives.
 */
static void test_warped_tables_keep_their_error(void **state)
{
	static const struct {
		enum operator_family family;
		double k; /* < 0: smooth */
		double max, mean, p99;
	} bounds[] = {
		{FAMILY_UNION, -1, 6e-5, 2e-7, 5e-4},         /* 3.8e-5 1.0e-7 2.3e-4 */
		{FAMILY_UNION, 0.8, 6e-5, 4e-7, 5e-3},        /* 3.8e-5 2.0e-7 1.6e-3 */
		{FAMILY_INTERSECTION, -1, 2e-4, 4e-6, 2e-3},  /* 9.7e-5 1.6e-6 5.0e-4 */
		{FAMILY_INTERSECTION, 0.8, 2e-4, 8e-6, 5e-3}, /* 9.9e-5 3.2e-6 3.2e-3 */
	};

	(void)state;
	for (size_t i = 0; i < sizeof(bounds) / sizeof(bounds[0]); i++) {
		struct table *t = build(bounds[i].family, bounds[i].k < 0 ?
		    profile_smooth() : profile_bulge(bounds[i].k),
		    LAYOUT_WARPED, 64);
		struct table_error e;

		measure(t, &e);
		assert_true(e.max[0] <= bounds[i].max);
		assert_true(e.mean[0] <= bounds[i].mean);
		for (int k = 1; k <= 3; k++)
			assert_true(e.p99[k] <= bounds[i].p99);
		assert_int_equal(table_bytes_first(t), 4 << 20);
		table_free(t);
	}
}

/*
 * With K near 1 the fold is a root, of unbounded slope. Half of the points lie
 * within 1e-6 to 1 of it. Measured: 1.4e-3 with K = 1, 2.8e-4 with 0.99, 1.2e-4
 * with 0.95.
 */
static void test_steep_bulges_keep_their_values(void **state)
{
	static const double steep[] = {0.95, 0.99, 0.999, 1.0};

	(void)state;
	for (int i = 0; i < 8; i++) {
		struct table *t = build(i & 1, profile_bulge(steep[i / 2]),
		    LAYOUT_WARPED, 64);

		for (int k = 0; k < 20000; k++) {
			double a = fmod(k * 0.754877666, 1.2);
			double gap = pow(10.0, -6.0 * fmod(k * 0.569840291, 1.0));
			double theta = fmod(k * 0.324717957, 1.0) * QUARTER_PI;
			struct operator_jet got, want;

			table_lookup(t, a, a * (1.0 - gap), theta, 2, &got);
			operator_eval(t->family, &t->profile, a, a * (1.0 - gap),
			    theta, 2, &want);
			assert_near(got.g, want.g, 2e-3);
			/* Derivatives keep the evaluator's own bound. */
			assert_true(fabs(got.g1) <= 110 && fabs(got.g2) <= 110);
		}
		table_free(t);
	}
}

/* The paper's grid at N = 32: Fig. 11 has 2.90e-2 and 1.43e-3; measured 1.2e-2
 * and 1.2e-4, and 4 times less in the mean with twice the nodes. */
static void test_uniform_error_falls_with_resolution(void **state)
{
	struct table *a = build(FAMILY_UNION, profile_smooth(), LAYOUT_UNIFORM,
	    16);
	struct table *b = build(FAMILY_UNION, profile_smooth(), LAYOUT_UNIFORM,
	    32);
	struct table_error ea, eb;

	(void)state;
	measure(a, &ea);
	measure(b, &eb);
	assert_true(eb.max[0] < 2.9e-2 && eb.mean[0] < 2e-4);
	assert_true(eb.mean[0] < 0.35 * ea.mean[0]);
	table_free(a);
	table_free(b);
}

static void check_close(const struct table *t, double a, double b, double theta,
    double tolerance)
{
	struct operator_jet got, want;

	table_lookup(t, a, b, theta, 1, &got);
	operator_eval(t->family, &t->profile, a, b, theta, 1, &want);
	assert_near(got.g, want.g, tolerance);
}

static void test_lookup_above_one_and_at_the_ends(void **state)
{
	static const double at[] = {0.0, 1e-9, 0.2, 0.5, 0.8, 1.0, 1.0001, 1.7, 30.0};
	struct table *tables[] = {
	    build(FAMILY_UNION, profile_smooth(), LAYOUT_WARPED, 24),
	    build(FAMILY_INTERSECTION, profile_smooth(), LAYOUT_WARPED, 24),
	    build(FAMILY_UNION, profile_smooth(), LAYOUT_UNIFORM, 24),
	    build(FAMILY_INTERSECTION, profile_smooth(), LAYOUT_UNIFORM, 24)};

	(void)state;
	for (int i = 0; i < 4; i++) {
		for (int k = 0; k < 9 * 9 * 3; k++) {
			double theta = (k / 81) * QUARTER_PI / 2;

			/* warped 24^3 measures 7e-4, uniform 3e-2 */
			check_close(tables[i], at[k % 9], at[k / 9 % 9], theta,
			    i < 2 ? 2e-3 : 4e-2);
		}
		table_free(tables[i]);
	}
}

static void test_lookup_is_symmetric_and_ordered(void **state)
{
	struct table *t = build(FAMILY_INTERSECTION, profile_bulge(0.8),
	    LAYOUT_WARPED, 16);
	struct operator_jet p, q;

	(void)state;
	table_lookup(t, 0.4, 0.55, 0.3, 2, &p);
	table_lookup(t, 0.55, 0.4, 0.3, 2, &q);
	assert_near(p.g, q.g, 0.0);
	assert_near(p.g1, q.g2, 0.0);
	assert_near(p.g22, q.g11, 0.0);
	assert_near(p.g1t, q.g2t, 0.0);
	table_lookup(t, 0.4, 0.55, 0.3, 0, &q);
	assert_near(q.g, p.g, 0.0);
	assert_near(q.g1, 0.0, 0.0);
	table_free(t);
}

static void test_slices_may_be_built_in_any_order(void **state)
{
	struct profile p = profile_smooth();
	struct table *a = build(FAMILY_UNION, p, LAYOUT_WARPED, 16), *b;

	(void)state;
	assert_int_equal(table_create(FAMILY_UNION, &p, LAYOUT_WARPED, 16, &b),
	    ERR_OK);
	for (int i = 15; i >= 0; i--)
		table_build(b, i, i + 1);
	assert_memory_equal(a->first, b->first, table_bytes_first(a));
	assert_memory_equal(a->second, b->second,
	    a->node_count * TABLE_SECOND * sizeof(float));
	assert_memory_equal(a->curves, b->curves,
	    2 * TABLE_CURVE_NODES * CURVE_NODE * sizeof(float));
	table_free(a);
	table_free(b);
	table_free(NULL);
}

static void test_every_sample_of_every_table_is_finite(void **state)
{
	struct profile profiles[] = {profile_smooth(), profile_bulge(0.0),
	    profile_bulge(1.0), profile_circle()};

	(void)state;
	for (int i = 0; i < 16; i++) {
		struct table *t = build(i & 1, profiles[i >> 2], i >> 1 & 1, 17);

		for (size_t k = 0; k < t->node_count * TABLE_FIRST; k++)
			assert_true(isfinite(t->first[k]));
		for (size_t k = 0; k < t->node_count * TABLE_SECOND; k++)
			assert_true(isfinite(t->second[k]));
		for (int k = 0; k < 2 * TABLE_CURVE_NODES * CURVE_NODE; k++)
			assert_true(isfinite(t->curves[k]));
		table_free(t);
	}
}

/* To what float32 leaves of a difference of up to 1e-3. */
static void test_the_error_in_g_alone_is_that_of_all(void **state)
{
	double *exact = malloc(SAMPLE * sizeof(*exact));
	struct profile profile = profile_bulge(0.8);

	(void)state;
	assert_non_null(exact);
	for (int i = 0; i < 4; i++) {
		struct table *t = build(i & 1, profile, i >> 1, 12);
		double max, half, sum = 0.0;
		struct table_error e;

		measure(t, &e);
		table_sample(t->family, &profile, 0, SAMPLE / 2, exact);
		table_sample(t->family, &profile, SAMPLE / 2, SAMPLE, exact);
		half = table_measure_g(t, 0, SAMPLE / 2, exact, &sum);
		max = fmax(half, table_measure_g(t, SAMPLE / 2, SAMPLE, exact,
		    &sum));
		assert_near(max, e.max[0], 1e-7 * e.max[0]);
		assert_near(sum / SAMPLE, e.mean[0], 1e-7 * e.mean[0]);
		/* A part shows most of it. */
		assert_true(half > 0.5 * max);
		table_free(t);
	}
	free(exact);
}

static void test_summary_of_known_errors(void **state)
{
	float errors[TABLE_QUANTITIES * 200];
	struct table_error e;

	(void)state;
	for (int k = 0; k < TABLE_QUANTITIES; k++)
		for (int i = 0; i < 200; i++)
			errors[k * 200 + i] = (float)((i * 77 % 200) * (k + 1));
	table_error_summarise(errors, 200, 200, &e);
	for (int k = 0; k < TABLE_QUANTITIES; k++) {
		assert_near(e.max[k], 199.0 * (k + 1), 0.0);
		assert_near(e.mean[k], 99.5 * (k + 1), 1e-9);
		assert_near(e.p99[k], 197.0 * (k + 1), 0.0);
	}
}

int main(void)
{
	const struct CMUnitTest tests[] = {
		cmocka_unit_test(test_warped_tables_keep_their_error),
		cmocka_unit_test(test_steep_bulges_keep_their_values),
		cmocka_unit_test(test_uniform_error_falls_with_resolution),
		cmocka_unit_test(test_lookup_above_one_and_at_the_ends),
		cmocka_unit_test(test_lookup_is_symmetric_and_ordered),
		cmocka_unit_test(test_slices_may_be_built_in_any_order),
		cmocka_unit_test(test_every_sample_of_every_table_is_finite),
		cmocka_unit_test(test_the_error_in_g_alone_is_that_of_all),
		cmocka_unit_test(test_summary_of_known_errors),
	};

	return cmocka_run_group_tests_name("table", tests, NULL, NULL);
}
