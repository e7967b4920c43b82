/* The sampled openings that devices look up, against the exact ones. */
#include <math.h>
#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>
#include <stdio.h>

#include <cmocka.h>

#include "core/curve.h"
#include "core/opening_table.h"

#define SAMPLES 20000
#define NODES_MAX 4096

/* Largest errors and largest values, of theta, slope and bend. */
struct errors {
	double most[3], scale[3];
};

static void compare(const struct opening *opening, const float *table,
    int count, double cosine, struct errors *e)
{
	struct opening_jet exact, sampled;

	opening_eval(opening, cosine, &exact);
	opening_table_lookup(table, count, cosine, &sampled);
	e->most[0] = fmax(e->most[0], fabs(exact.theta - sampled.theta));
	e->most[1] = fmax(e->most[1], fabs(exact.slope - sampled.slope));
	e->most[2] = fmax(e->most[2], fabs(exact.bend - sampled.bend));
	e->scale[0] = fmax(e->scale[0], fabs(exact.theta));
	e->scale[1] = fmax(e->scale[1], fabs(exact.slope));
	e->scale[2] = fmax(e->scale[2], fabs(exact.bend));
}

/* Half of the samples regular in the cosine, half in the angle. */
static struct errors measure(const char *name, int count)
{
	static float table[NODES_MAX * CURVE_NODE];
	struct errors e = {{0.0, 0.0, 0.0}, {0.0, 0.0, 0.0}};
	struct opening opening;

	assert_true(opening_named(name, &opening));
	opening_table_build(&opening, count, table);
	for (int i = 0; i < SAMPLES; i++) {
		double x = (i + 0.5) / SAMPLES;

		compare(&opening, table, count, 2.0 * x - 1.0, &e);
		compare(&opening, table, count, cos(acos(-1.0) * x), &e);
	}
	printf("%-8s %4d nodes: theta %.1e slope %.1e of %.2f "
	    "bend %.1e of %.0f\n", name, count, e.most[0], e.most[1],
	    e.scale[1], e.most[2], e.scale[2]);
	return e;
}

static void check_default(const char *name)
{
	struct errors e = measure(name, OPENING_TABLE_COUNT);

	/* Worst measured, organic: 9.6e-7, 2.4e-4 and 3.4e-2 of the scale. */
	assert_true(e.most[0] < 2e-6);
	assert_true(e.most[1] < 5e-4 * e.scale[1]);
	assert_true(e.most[2] < 5e-2 * e.scale[2]);
}

static void test_opening_table_camel_within_tolerance(void **state)
{
	(void)state;
	check_default("camel");
}

static void test_opening_table_organic_within_tolerance(void **state)
{
	(void)state;
	check_default("organic");
}

static void test_opening_table_contact_within_tolerance(void **state)
{
	(void)state;
	check_default("contact");
}

static void test_opening_table_error_falls_with_the_cube(void **state)
{
	struct errors last = measure("organic", 256);

	(void)state;
	for (int count = 512; count <= 1024; count *= 2) {
		struct errors e = measure("organic", count);

		/* Measured 7.4 and 13 times a doubling. */
		assert_true(e.most[0] * 6.0 < last.most[0]);
		last = e;
	}
	measure("organic", 2048);
	measure("organic", 4096);
}

static void test_opening_table_nodes_are_exact(void **state)
{
	float table[9 * CURVE_NODE];
	struct opening opening;
	struct opening_jet exact, sampled;

	(void)state;
	assert_true(opening_named("contact", &opening));
	opening_table_build(&opening, 9, table);
	for (int i = 0; i < 9; i++) {
		double c = i / 4.0 - 1.0;

		opening_eval(&opening, c, &exact);
		opening_table_lookup(table, 9, c, &sampled);
		/* One rounding to float32. */
		assert_true(fabs(exact.theta - sampled.theta) < 6e-8);
		assert_true(fabs(exact.slope - sampled.slope) < 6e-7);
		assert_true(fabs(exact.bend - sampled.bend) < 6e-6);
	}
}

static void test_opening_table_clamps_the_cosine(void **state)
{
	float table[9 * CURVE_NODE];
	struct opening opening;
	struct opening_jet at, beyond;

	(void)state;
	assert_true(opening_named("organic", &opening));
	opening_table_build(&opening, 9, table);
	opening_table_lookup(table, 9, 1.0, &at);
	opening_table_lookup(table, 9, 1.5, &beyond);
	assert_true(at.theta == beyond.theta);
	opening_table_lookup(table, 9, -1.0, &at);
	opening_table_lookup(table, 9, -1.0000001, &beyond);
	assert_true(at.theta == beyond.theta);
}

int main(void)
{
	const struct CMUnitTest tests[] = {
		cmocka_unit_test(test_opening_table_camel_within_tolerance),
		cmocka_unit_test(test_opening_table_organic_within_tolerance),
		cmocka_unit_test(test_opening_table_contact_within_tolerance),
		cmocka_unit_test(test_opening_table_error_falls_with_the_cube),
		cmocka_unit_test(test_opening_table_nodes_are_exact),
		cmocka_unit_test(test_opening_table_clamps_the_cosine),
	};

	return cmocka_run_group_tests(tests, NULL, NULL);
}
