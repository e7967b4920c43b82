/*
 * The size of pieces, for programs whose launches take one time or another.
 */
#include <stdarg.h>
#include <stddef.h>
#include <setjmp.h>
#include <stdint.h>
#include <cmocka.h>

#include <math.h>

#include "server/pace.h"

#define TARGET 0.006
#define LONGEST 0.025
#define FIRST ((size_t)65536)

/* The size after count launches of the size asked for, that take what `took`
 * says. */
static size_t settle(struct pace *p, int count,
    double (*took)(double points))
{
	for (int i = 0; i < count; i++) {
		size_t n = pace_points(p, TARGET, LONGEST, FIRST);

		assert_in_range(n, PACE_LEAST, PACE_MOST);
		assert_int_equal(n % PACE_LEAST, 0);
		pace_learn(p, n, took((double)n), true);
	}
	return pace_points(p, TARGET, LONGEST, FIRST);
}

/* 1 us a point. */
static double take_evenly(double points)
{
	return 1e-6 * points;
}

/* A long tape: 20 ms at 4,096 points, twice that at 16 times as many. */
static double take_long(double points)
{
	return 0.02 * pow(points / 4096.0, 0.25);
}

/* Less long: 12 ms, and 1.3 times that at twice as many. */
static double take_less(double points)
{
	return 0.012 * pow(points / 4096.0, 0.4);
}

/* Nothing can be culled: 40 ms at 4,096. */
static double take_heavily(double points)
{
	return 1e-5 * points;
}

static double take_lightly(double points)
{
	return 1e-9 * points;
}

static void test_pace_before_anything_is_known(void **state)
{
	const struct pace p = {{0.0f}, {0}};

	(void)state;
	assert_int_equal(pace_points(&p, TARGET, LONGEST, 10), PACE_LEAST);
	assert_int_equal(pace_points(&p, TARGET, 0.0, 10000), 8192);
	assert_int_equal(pace_points(&p, TARGET, LONGEST, SIZE_MAX), PACE_MOST);
}

/* 6 ms of 1 us are 6,000 points: the size below. */
static void test_pace_of_even_work_meets_the_target(void **state)
{
	struct pace p = {{0.0f}, {0}};

	(void)state;
	assert_int_equal(settle(&p, 20, take_evenly), 4096);
}

static void test_pace_of_light_work_is_all_there_can_be(void **state)
{
	struct pace p = {{0.0f}, {0}};

	(void)state;
	assert_int_equal(settle(&p, 20, take_lightly), PACE_MOST);
}

/* 4,096 points take three times too long, but 16,384 hardly longer. */
static void test_pace_of_long_tapes_is_larger(void **state)
{
	struct pace p = {{0.0f}, {0}};

	(void)state;
	assert_true(settle(&p, 20, take_long) >= 16384);
	assert_true(take_long((double)settle(&p, 5, take_long)) <= 0.031);
}

/* ... also when the times of smaller ones are old, and batches of any size come
 * between. */
static void test_pace_of_long_tapes_stays_large(void **state)
{
	struct pace p = {{0.0f}, {0}};

	(void)state;
	for (int i = 0; i < 500; i++) {
		size_t n = pace_points(&p, 0.02, 0.1, 8192);

		if (i > 20)
			assert_true(n >= 65536);
		pace_learn(&p, n, take_less((double)n), true);
		pace_learn(&p, 7900, take_less(7900.0), true);
	}
}

static void test_pace_of_heavy_work_stays_small(void **state)
{
	struct pace p = {{0.0f}, {0}};

	(void)state;
	assert_int_equal(settle(&p, 3, take_heavily), PACE_LEAST);
}

/* Nothing larger is tried. */
static void test_pace_of_short_tapes_goes_by_the_target(void **state)
{
	struct pace p = {{0.0f}, {0}};

	(void)state;
	pace_learn(&p, PACE_LEAST, 0.02, false);
	assert_int_equal(pace_points(&p, TARGET, LONGEST, FIRST),
	    2 * PACE_LEAST);
	assert_int_equal(pace_points(&p, TARGET, 0.0, FIRST), PACE_LEAST);
}

/* A launch that was held up is forgiven. */
static void test_pace_recovers(void **state)
{
	struct pace p = {{0.0f}, {0}};

	(void)state;
	settle(&p, 20, take_lightly);
	for (int i = 0; i < PACE_SIZES; i++)
		pace_learn(&p, PACE_LEAST << i, 10.0, true);
	assert_int_equal(settle(&p, 200, take_lightly), PACE_MOST);
	pace_learn(&p, 1, 10.0, true); /* says nothing */
	assert_int_equal(pace_points(&p, TARGET, LONGEST, FIRST), PACE_MOST);
}

int main(void)
{
	const struct CMUnitTest tests[] = {
		cmocka_unit_test(test_pace_before_anything_is_known),
		cmocka_unit_test(test_pace_of_even_work_meets_the_target),
		cmocka_unit_test(test_pace_of_light_work_is_all_there_can_be),
		cmocka_unit_test(test_pace_of_long_tapes_is_larger),
		cmocka_unit_test(test_pace_of_long_tapes_stays_large),
		cmocka_unit_test(test_pace_of_heavy_work_stays_small),
		cmocka_unit_test(test_pace_of_short_tapes_goes_by_the_target),
		cmocka_unit_test(test_pace_recovers),
	};

	return cmocka_run_group_tests(tests, NULL, NULL);
}
