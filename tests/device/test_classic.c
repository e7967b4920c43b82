/*
 * The device's operators without angles against those in float64
 * (core/classic.c), over a grid of field values: two bars that cross at right
 * angles, whose fields depend on x and y alone.
 */
#include <float.h>
#include <math.h>
#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>

#include <cmocka.h>

#include "core/classic.h"
#include "core/evaluate.h"
#include "core/output.h"
#include "core/tape.h"
#include "core/tree.h"
#include "kernels/device.h"
#include "tests/support/widest.h"

#define COUNT(array) (sizeof(array) / sizeof(*(array)))
#define QUARTER_PI 0.78539816339744830962
#define STEPS 64
#define POINTS (STEPS * STEPS)
#define ROW 10
/* Fields of the grid: from 0 to this. */
#define FIELD_MAX 1.5

static const struct classic cases[] = {
	{CLASSIC_SUPER_ELLIPTIC, {0.5, 0.8, 2.5}},
	{CLASSIC_SUPER_ELLIPTIC, {0.2, 0.2, 8.0}},
	{CLASSIC_R_BLEND, {0.4, 0.5, 0.9}},
	{CLASSIC_FUNCTIONAL, {0.3}},
	{CLASSIC_FUNCTIONAL, {2.0}},
	{CLASSIC_R_CLEAN, {0}},
	{CLASSIC_BARTHE_CLEAN, {0}},
	{CLASSIC_RICCI, {1.0}},
	{CLASSIC_RICCI, {2.5}},
	{CLASSIC_RICCI, {1000.0}},
	{CLASSIC_BARTHE_OPENING, {0.0, 0.0}},
	{CLASSIC_BARTHE_OPENING, {0.6, 0.2}},
	{CLASSIC_BARTHE_OPENING, {0.3, QUARTER_PI}},
	{CLASSIC_INTERPOLATION, {0.4}},
	{CLASSIC_POWER_DIFFERENCE, {1.0}},
	{CLASSIC_POWER_DIFFERENCE, {3.5}},
};

static const enum node_type nodes[] = {NODE_UNION, NODE_INTERSECTION,
	NODE_DIFFERENCE};

static struct node bar(bool along_x, double weight)
{
	struct node n = {.type = NODE_PRIMITIVE};

	n.primitive = (struct primitive){.type = PRIMITIVE_SEGMENT,
	    .a = vec3(along_x ? -9 : 0, along_x ? 0 : -9, 0),
	    .b = vec3(along_x ? 9 : 0, along_x ? 0 : 9, 0),
	    .radius = {0.5, 0.5}, .exponent = 3.0, .weight = weight};
	return n;
}

/* The distance at which a bar's field is f. */
static double distance(double f, double weight)
{
	const double support = 0.5 / sqrt(1.0 - cbrt(0.5));

	return support * sqrt(fmax(0.0, 1.0 - cbrt(f / weight)));
}

/* If deep, the second bar is a sum (with nothing), which goes first. */
static struct tape *compile(const struct classic *c, enum node_type type,
    double weight, bool deep)
{
	struct node first = bar(false, weight), second = bar(true, weight);
	struct node nothing = bar(true, 0.0), *terms[] = {&second, &nothing};
	struct node sum = {.type = NODE_SUM, .children = terms,
	    .child_count = 2};
	struct node *children[] = {&first, deep ? &sum : &second};
	struct node root = {.type = type, .classic = c, .children = children,
	    .child_count = 2};
	struct tree tree = {.root = &root, .null_gradient = TREE_NULL_GRADIENT};
	struct tape_error error = {0};
	struct tape *tape;

	if (tape_compile(&tree, 10, &tape, &error) != ERR_OK)
		fail_msg("%s", error.detail);
	assert_int_equal(tape->insns[tape->insn_count - 1].op,
	    deep ? OP_CLASSIC_SWAPPED : OP_CLASSIC);
	return tape;
}

static void evaluate_on(struct device *device, const struct tape *tape,
    const float *xyz, size_t count, float *rows)
{
	struct device_tape *loaded;

	assert_int_equal(device_load_tape(device, tape, NULL, &loaded), ERR_OK);
	if (device_evaluate(device, loaded, xyz, count, OUTPUT_VALUE |
	    OUTPUT_GRADIENT | OUTPUT_HESSIAN, rows, NULL, NULL) != ERR_OK)
		fail_msg("%s", device_message(device));
	device_drop_tape(device, loaded);
}

static int by_size(const void *a, const void *b)
{
	double x = *(const double *)a, y = *(const double *)b;

	return (x > y) - (x < y);
}

/* Largest difference of values, 99th percentiles of gradients' and Hessians',
 * each relative to 1 + its own size. Grows out. */
static void compare(const struct tape *tape, const float *xyz,
    const float *rows, double out[static 3])
{
	static double gradients[POINTS], hessians[POINTS];

	for (size_t i = 0; i < POINTS; i++) {
		struct vec3 p = vec3(xyz[3 * i], xyz[3 * i + 1],
		    xyz[3 * i + 2]);
		double size[2] = {1.0, 1.0}, off[2] = {0.0, 0.0};
		const float *row = rows + ROW * i;
		struct jet want;

		evaluate(tape, p, 2, &want);
		out[0] = fmax(out[0], fabs(want.value - row[0]) /
		    (1.0 + want.value));
		for (int k = 0; k < 9; k++) {
			double exact = k < 3 ? (&want.gradient.x)[k] :
			    (&want.hessian.xx)[k - 3];

			size[k >= 3] += fabs(exact);
			off[k >= 3] += fabs(exact - row[1 + k]);
		}
		gradients[i] = off[0] / size[0];
		hessians[i] = off[1] / size[1];
	}
	qsort(gradients, POINTS, sizeof(*gradients), by_size);
	qsort(hessians, POINTS, sizeof(*hessians), by_size);
	out[1] = fmax(out[1], gradients[POINTS * 99 / 100]);
	out[2] = fmax(out[2], hessians[POINTS * 99 / 100]);
}

/* From 0 on, but not on f = 1, f1 = f2 or f1 = 1 - f2, where branches meet with
 * other derivatives. */
static void make_grid(float *xyz)
{
	for (int i = 0; i < POINTS; i++) {
		double f1 = FIELD_MAX / (STEPS - 0.9) * (i % STEPS);
		double f2 = FIELD_MAX / (STEPS - 0.7) * (i / STEPS);

		xyz[3 * i] = (float)distance(f1, FIELD_MAX);
		xyz[3 * i + 1] = (float)distance(f2, FIELD_MAX);
		xyz[3 * i + 2] = 0.0f;
	}
}

static struct device *open_device(int width)
{
	struct device_options options = {.width = width};
	struct device_failure failure = {0};
	struct device *device;

	if (device_open(&options, &device, &failure) != ERR_OK)
		fail_msg("%s", failure.message);
	return device;
}

/* Runs each on the device for every case in each of its families. */
static void for_each_case(struct device *device, double weight,
    void (*each)(struct device *device, const struct tape *tape,
    const struct tape *deep, void *ctx), void *ctx)
{
	for (size_t i = 0; i < COUNT(cases) * COUNT(nodes); i++) {
		const struct classic *c = &cases[i / COUNT(nodes)];
		const int family = (int)(i % COUNT(nodes));
		struct tape *tape, *deep;

		if (!classic_has_family(c->type, family))
			continue;
		tape = compile(c, nodes[family], weight, false);
		deep = compile(c, nodes[family], weight, true);
		each(device, tape, deep, ctx);
		tape_free(deep);
		tape_free(tape);
	}
}

static void check_grid(struct device *device, const struct tape *tape,
    const struct tape *deep, void *ctx)
{
	static float xyz[3 * POINTS], rows[POINTS * ROW];

	make_grid(xyz);
	evaluate_on(device, tape, xyz, POINTS, rows);
	compare(tape, xyz, rows, ctx);
	evaluate_on(device, deep, xyz, POINTS, rows);
	compare(tape, xyz, rows, ctx);
}

static void check_width(int width)
{
	struct device *device = open_device(width);
	double worst[3] = {0.0};

	for_each_case(device, FIELD_MAX, check_grid, worst);
	device_close(device);
	print_message("measured: width %d against float64: value %.1e, "
	    "gradient p99 %.1e, Hessian p99 %.1e\n", width, worst[0], worst[1],
	    worst[2]);
	/* Measured: 4.9e-6 (of the eighth power; else 6e-7), 5.6e-6, 7.3e-5. */
	assert_true(worst[0] < 1e-5);
	assert_true(worst[1] < 3e-5);
	assert_true(worst[2] < 4e-4);
}

static void test_classic_over_a_grid(void **state)
{
	(void)state;
	check_width(widest());
}

static void test_classic_over_a_grid_one_by_one(void **state)
{
	(void)state;
	check_width(1);
}

/* What was NaN is written as -FLT_MAX. */
static void check_finite(struct device *device, const struct tape *tape,
    const struct tape *deep, void *ctx)
{
	static float rows[POINTS * ROW];

	(void)deep;
	evaluate_on(device, tape, ctx, POINTS, rows);
	for (int k = 0; k < POINTS * ROW; k++)
		assert_true(rows[k] > -FLT_MAX && rows[k] <= FLT_MAX);
}

static void test_no_field_gives_a_nan(void **state)
{
	static const double weights[] = {1e18, 1e6, 1.0, 1e-6, 1e-18};
	struct device *device = open_device(16);
	static float xyz[3 * POINTS];

	(void)state;
	for (int i = 0; i < POINTS; i++) {
		/* The support ends at 1.1; every other is on the diagonal. */
		xyz[3 * i] = 1.2f * (float)(i % STEPS) / STEPS;
		xyz[3 * i + 1] = i % 2 ? xyz[3 * i] :
		    1.2f * (float)(i / STEPS) / STEPS;
		xyz[3 * i + 2] = 0.0f;
	}
	for (size_t w = 0; w < COUNT(weights); w++)
		for_each_case(device, weights[w], check_finite, xyz);
	device_close(device);
}

int main(void)
{
	const struct CMUnitTest tests[] = {
		cmocka_unit_test(test_classic_over_a_grid),
		cmocka_unit_test(test_classic_over_a_grid_one_by_one),
		cmocka_unit_test(test_no_field_gives_a_nan),
	};

	return cmocka_run_group_tests_name("classic", tests, NULL, NULL);
}
