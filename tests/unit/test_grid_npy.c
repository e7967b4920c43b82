/* Grids of samples as npy: what is read, and what is refused, where. */
#include <math.h>
#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>
#include <stdlib.h>
#include <string.h>

#include <cmocka.h>

#include "proto/fault.h"
#include "proto/grid_npy.h"
#include "tests/support/fail_alloc.h"
#include "tests/support/near.h"
#include "tests/support/npy.h"

#define COUNT(a) (sizeof(a) / sizeof *(a))

/* 4 x 5 x 6 samples that tell their indices. */
#define SAMPLES 120
#define SHAPE "(4, 5, 6)"

static float sample(size_t i, size_t j, size_t k)
{
	return (float)(100 * i + 10 * j + k) + 0.5f;
}

static void fill(bool fortran, float *out)
{
	for (size_t i = 0; i < 4; i++)
		for (size_t j = 0; j < 5; j++)
			for (size_t k = 0; k < 6; k++)
				out[fortran ? i + 4 * (j + 5 * k) :
				    (i * 5 + j) * 6 + k] = sample(i, j, k);
}

/* Reads a copy as long as the file, so that sanitizers see its end. */
static enum err read_file(char *file, size_t length, struct grid *grid,
    struct faults *faults)
{
	enum err err;

	*grid = (struct grid){0};
	*faults = (struct faults){0};
	file = realloc(file, length);
	assert_non_null(file);
	err = grid_from_npy(file, length, grid, faults);
	assert_int_equal(err == ERR_OK || err == ERR_MEMORY,
	    faults->count == 0);
	assert_int_equal(err == ERR_OK, grid->samples != NULL);
	free(file);
	return err;
}

static void check(const struct grid *grid)
{
	assert_int_equal(grid->count[0], 4);
	assert_int_equal(grid->count[1], 5);
	assert_int_equal(grid->count[2], 6);
	for (size_t i = 0; i < 4; i++)
		for (size_t j = 0; j < 5; j++)
			for (size_t k = 0; k < 6; k++)
				assert_near(grid->samples[(i * 5 + j) * 6 + k],
				    sample(i, j, k), 0.0);
}

static void test_either_order_of_either_number_is_the_same_grid(void **state)
{
	float samples[SAMPLES];
	double doubles[SAMPLES];
	struct faults faults;
	struct grid grid;
	size_t length;
	char *file;

	(void)state;
	for (int fortran = 0; fortran < 2; fortran++) {
		const char *order = fortran ? "True" : "False";

		fill(fortran, samples);
		for (int i = 0; i < SAMPLES; i++)
			doubles[i] = (double)samples[i];
		file = npy_file("<f4", order, SHAPE, samples, sizeof samples,
		    &length);
		assert_int_equal(read_file(file, length, &grid, &faults),
		    ERR_OK);
		check(&grid);
		grid_fini(&grid);
		file = npy_file("<f8", order, SHAPE, doubles, sizeof doubles,
		    &length);
		assert_int_equal(read_file(file, length, &grid, &faults),
		    ERR_OK);
		check(&grid);
		grid_fini(&grid);
		assert_null(grid.samples);
	}
}

static const struct {
	const char *descr, *shape;
	size_t bytes;
	enum err err;
	const char *words;
} bad[] = {
	{"<i4", SHAPE, 480, ERR_INVALID, "descr"},
	{"<f4", "(120,)", 480, ERR_INVALID, "3 axes, not 1"},
	{"<f4", "(4, 30)", 480, ERR_INVALID, "3 axes, not 2"},
	{"<f4", "(4, 5, 6, 1)", 480, ERR_INVALID, "3 axes, not 4"},
	{"<f4", "(1, 2, 3, 4, 5)", 480, ERR_INVALID, "3 axes, not 5"},
	{"<f4", "()", 4, ERR_INVALID, "3 axes, not 0"},
	{"<f4", "(3, 8, 5)", 480, ERR_INVALID, "axis x has 3 samples"},
	{"<f4", "(4, 0, 5)", 0, ERR_INVALID, "axis y has 0 samples"},
	{"<f4", "(4, 4, 4097)", 480, ERR_INVALID, "axis z has 4097 samples"},
	{"<f4", "(4, 18446744073709551616000, 4)", 480, ERR_SYNTAX, "header"},
	{"<f4", "(4, 18446744073709551600, 4)", 480, ERR_INVALID, "axis y"},
	{"<f4", "(4096, 4096, 9)", 480, ERR_LIMIT, "more than 134217728"},
	{"<f4", "(4096, 4096, 8)", 480, ERR_SYNTAX, "134217728 samples"},
	{"<f4", SHAPE, 476, ERR_SYNTAX, "476 bytes"},
	{"<f4", SHAPE, 479, ERR_SYNTAX, "479 bytes"},
	{"<f8", SHAPE, 480, ERR_SYNTAX, "120 samples of 8 bytes"},
	{"<f4", "(4, 5", 480, ERR_SYNTAX, "header"},
};

static void test_what_is_no_grid_is_refused(void **state)
{
	float samples[SAMPLES];
	struct faults faults;
	struct grid grid;
	size_t length;

	(void)state;
	fill(false, samples);
	for (size_t i = 0; i < COUNT(bad); i++) {
		char *file = npy_file(bad[i].descr, "False", bad[i].shape,
		    samples, bad[i].bytes, &length);
		enum err err = read_file(file, length, &grid, &faults);

		if (err != bad[i].err || faults.count != 1 ||
		    faults.list[0].pointer[0] != '\0' ||
		    !strstr(faults.list[0].detail, bad[i].words))
			fail_msg("%s %s: %s, %s", bad[i].descr, bad[i].shape,
			    err_message(err), faults.list[0].detail);
	}
}

static void test_wrong_samples_are_named_by_their_indices(void **state)
{
	float samples[SAMPLES];
	struct faults faults;
	struct grid grid;
	size_t length;
	char *file;

	(void)state;
	for (int fortran = 0; fortran < 2; fortran++) {
		fill(fortran, samples);
		samples[fortran ? 3 + 4 * (2 + 5 * 1) : (3 * 5 + 2) * 6 + 1] =
		    NAN;
		samples[SAMPLES - 1] = 2e9f; /* the last in both orders */
		file = npy_file("<f4", fortran ? "True" : "False", SHAPE,
		    samples, sizeof samples, &length);
		assert_int_equal(read_file(file, length, &grid, &faults),
		    ERR_INVALID);
		assert_int_equal(faults.count, 2);
		assert_string_equal(faults.list[0].pointer, "/3/2/1");
		assert_string_equal(faults.list[0].detail,
		    "sample [3, 2, 1] is not finite as float32");
		assert_string_equal(faults.list[1].pointer, "/3/4/5");
		assert_string_equal(faults.list[1].detail, "sample [3, 4, 5] "
		    "is 2e+09; its size must be at most 1e+09");
	}
}

static void test_a_double_beyond_float32_is_not_finite(void **state)
{
	double samples[SAMPLES] = {0.0};
	struct faults faults;
	struct grid grid;
	size_t length;
	char *file;

	(void)state;
	samples[0] = 1e300;
	file = npy_file("<f8", "False", SHAPE, samples, sizeof samples,
	    &length);
	assert_int_equal(read_file(file, length, &grid, &faults), ERR_INVALID);
	assert_string_equal(faults.list[0].pointer, "/0/0/0");
}

static void test_a_failed_allocation_is_told(void **state)
{
	float samples[SAMPLES];
	struct faults faults = {0};
	struct grid grid = {0};
	size_t length;
	char *file;

	(void)state;
	if (!fail_alloc_available())
		skip();
	fill(false, samples);
	file = npy_file("<f4", "False", SHAPE, samples, sizeof samples,
	    &length);
	fail_alloc_set(1);
	assert_int_equal(grid_from_npy(file, length, &grid, &faults),
	    ERR_MEMORY);
	assert_null(grid.samples);
	fail_alloc_set(0);
	assert_int_equal(grid_from_npy(file, length, &grid, &faults), ERR_OK);
	grid_fini(&grid);
	assert_int_equal(fail_alloc_live(), 0);
	free(file);
}

int main(void)
{
	const struct CMUnitTest tests[] = {
		cmocka_unit_test(
		    test_either_order_of_either_number_is_the_same_grid),
		cmocka_unit_test(test_what_is_no_grid_is_refused),
		cmocka_unit_test(test_wrong_samples_are_named_by_their_indices),
		cmocka_unit_test(test_a_double_beyond_float32_is_not_finite),
		cmocka_unit_test(test_a_failed_allocation_is_told),
	};

	return cmocka_run_group_tests_name("grid_npy", tests, NULL, NULL);
}
