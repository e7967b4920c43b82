/*
 * What the device says its time went to: in memory that it shares with the host,
 * and in memory of its own; few points, many, and of several parts.
 */
#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <time.h>

#include <cmocka.h>

#include "core/opcode.h"
#include "core/output.h"
#include "core/tape.h"
#include "kernels/device_internal.h"

#define POINTS ((size_t)200000)

static float points[3 * POINTS], rows[4 * POINTS];

/* A unit ball. */
static struct device_tape *load(struct device *d)
{
	struct insn insn = {OP_SPHERE, 0, 0, 0};
	double params[5] = {0.0, 0.0, 0.0, 1.0, 1.0};
	const struct tape tape = {.insns = &insn, .insn_count = 1,
		.params = params, .param_count = 5, .primitive_count = 1,
		.node_count = 1, .stack_depth = 1};
	struct device_tape *t;

	assert_int_equal(device_load_tape(d, &tape, NULL, &t), ERR_OK);
	return t;
}

static double now(void)
{
	struct timespec t;

	clock_gettime(CLOCK_MONOTONIC, &t);
	return (double)t.tv_sec + 1e-9 * (double)t.tv_nsec;
}

/* What d says of a call that took so many seconds. */
static void assert_times(const struct device *d, const char *name,
    double seconds)
{
	const struct device_times *t = device_get_times(d);
	double sum = t->upload + t->kernel + t->download;

	printf("measured: %s: upload %.0f, kernel %.0f, download %.0f us: "
	    "%.0f %%\n", name, 1e6 * t->upload, 1e6 * t->kernel,
	    1e6 * t->download, 100.0 * sum / seconds);
	assert_true(t->upload >= 0.0);
	assert_true(t->kernel > 0.0);
	assert_true(t->download >= 0.0);
	/* Nothing is counted twice; what is left is setting arguments, 10 % of
	 * few points' time, none of many's. */
	assert_true(sum <= seconds);
	assert_true(seconds < 5e-3 || sum >= 0.5 * seconds);
}

static void time_all(enum device_memory memory)
{
	static const struct device_options options = {0};
	struct device_part parts[2] = {{points, 500, rows},
		{points + 1500, 500, rows + 2000}};
	const unsigned outputs = OUTPUT_VALUE | OUTPUT_GRADIENT;
	struct device_failure failure = {0};
	struct device_tape *t;
	struct device *d;
	double begin;

	assert_int_equal(device_open_as(&options, memory, &d, &failure),
	    ERR_OK);
	t = load(d);
	begin = now();
	assert_int_equal(device_evaluate(d, t, points, POINTS, outputs, rows,
	    NULL, NULL), ERR_OK);
	assert_times(d, "200,000 points", now() - begin);
	begin = now();
	assert_int_equal(device_evaluate(d, t, points, 256, outputs, rows,
	    NULL, NULL), ERR_OK);
	assert_times(d, "256 points", now() - begin);
	begin = now();
	assert_int_equal(device_evaluate_parts(d, t, parts, 2, outputs),
	    ERR_OK);
	assert_times(d, "two parts", now() - begin);
	assert_int_equal(device_evaluate(d, t, points, 0, outputs, rows, NULL,
	    NULL), ERR_OK);
	assert_true(device_get_times(d)->kernel == 0.0);
	device_drop_tape(d, t);
	device_close(d);
}

static void test_times_of_shared_memory(void **state)
{
	(void)state;
	time_all(DEVICE_MEMORY_AUTO);
}

static void test_times_of_memory_of_its_own(void **state)
{
	(void)state;
	time_all(DEVICE_MEMORY_COPIED);
}

int main(void)
{
	const struct CMUnitTest tests[] = {
		cmocka_unit_test(test_times_of_shared_memory),
		cmocka_unit_test(test_times_of_memory_of_its_own),
	};

	return cmocka_run_group_tests(tests, NULL, NULL);
}
