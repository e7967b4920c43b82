/*
 * Sampled fields on the device: against float64, and where they reside.
 */
#include <math.h>
#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include <cmocka.h>

#include "core/evaluate.h"
#include "core/output.h"
#include "core/tape.h"
#include "core/tree.h"
#include "core/volume.h"
#include "kernels/device_internal.h"
#include "tests/support/near.h"
#include "tests/support/sampled.h"

#define POINTS 20000
#define ALL_OUTPUTS (OUTPUT_VALUE | OUTPUT_GRADIENT | OUTPUT_HESSIAN)
#define ROW 10

static struct device *device;
static float points[POINTS * 3], rows[POINTS * ROW];

static struct device *open_device(int width, size_t volume_bytes)
{
	struct device_options options = {.width = width,
		.volume_bytes = volume_bytes};
	struct device_failure failure = {0};
	struct device *d = NULL;
	enum err err = device_open(&options, &d, &failure);

	if (err)
		printf("%s\n%s\n", failure.message,
		    failure.build_log ? failure.build_log : "");
	assert_int_equal(err, ERR_OK);
	device_failure_fini(&failure);
	return d;
}

/* All over [-half, half]^3, the same at every run. */
static void make_points(float half)
{
	uint32_t state = 1;

	for (size_t i = 0; i < POINTS * 3; i++) {
		state = state * 1664525u + 1013904223u;
		points[i] = ((float)(state >> 8) / 8388608.0f - 1.0f) * half;
	}
}

static int setup(void **state)
{
	(void)state;
	device = open_device(0, 1 << 20);
	return 0;
}

static int teardown(void **state)
{
	(void)state;
	device_close(device);
	return 0;
}

static struct node volume_node(struct volume *v, double falloff)
{
	return (struct node){.type = NODE_PRIMITIVE, .primitive = {
		.type = PRIMITIVE_VOLUME, .volume = v, .falloff = falloff}};
}

static struct tape *compile(const struct node *root)
{
	struct tree tree = {root, TREE_NULL_GRADIENT};
	struct tape_error error;
	struct tape *tape;

	assert_int_equal(tape_compile(&tree, 100, &tape, &error), ERR_OK);
	return tape;
}

/* The largest differences between float32 and float64. */
struct errors {
	double value, gradient, hessian;
};

static double most(double a, double b)
{
	return a > b ? a : b;
}

static struct errors compare(struct device *d, const struct tape *tape)
{
	struct errors e = {0.0, 0.0, 0.0};
	struct device_tape *t;

	assert_int_equal(device_load_tape(d, tape, NULL, &t), ERR_OK);
	assert_int_equal(device_evaluate(d, t, points, POINTS, ALL_OUTPUTS,
	    rows, NULL, NULL), ERR_OK);
	device_drop_tape(d, t);
	for (size_t i = 0; i < POINTS; i++) {
		const float *p = points + 3 * i, *r = rows + ROW * i;
		struct jet f;

		evaluate(tape, vec3(p[0], p[1], p[2]), 2, &f);
		e.value = most(e.value, fabs(r[0] - f.value));
		e.gradient = most(e.gradient, vec3_norm(vec3_sub(
		    vec3(r[1], r[2], r[3]), f.gradient)));
		e.hessian = most(e.hessian, most(
		    vec3_norm(vec3(r[4] - f.hessian.xx, r[5] - f.hessian.yy,
		    r[6] - f.hessian.zz)), vec3_norm(vec3(
		    r[7] - f.hessian.xy, r[8] - f.hessian.xz,
		    r[9] - f.hessian.yz))));
	}
	return e;
}

static void check(const char *name, struct errors e, double value,
    double gradient, double hessian)
{
	print_message("measured: %s: device off by %.1e, gradient %.1e, "
	    "Hessian %.1e\n", name, e.value, e.gradient, e.hessian);
	assert_near(e.value, 0.0, value);
	assert_near(e.gradient, 0.0, gradient);
	assert_near(e.hessian, 0.0, hessian);
}

/* Values up to 1, gradients up to 2, Hessians up to 15. */
static void test_fields_agree_with_float64(void **state)
{
	struct volume *v = sampled_cube(sampled_bump, 33, false);
	struct node node = volume_node(v, 0.0);
	struct tape *tape = compile(&node);

	(void)state;
	make_points(1.2f);
	check("a field of 33^3", compare(device, tape), 1e-6, 6e-6,
	    2e-4); /* 2.4e-7 1.6e-6 4.7e-5 */
	tape_free(tape);
	volume_release(v);
}

static void test_distances_agree_with_float64(void **state)
{
	struct volume *v = sampled_volume(sampled_sphere,
	    (const size_t[3]){40, 50, 60}, vec3(-1.0, -1.1, -1.2),
	    vec3(1.0, 1.1, 1.2), true);
	struct node node = volume_node(v, 0.3);
	struct tape *tape = compile(&node);

	(void)state;
	make_points(1.3f);
	check("distances of 40 x 50 x 60", compare(device, tape), 3e-6, 2e-5,
	    2e-4); /* 7.7e-7 4.1e-6 4.9e-5 */
	tape_free(tape);
	volume_release(v);
}

/* The narrowest samples, so that most cells are at an end of each axis. */
static void test_ends_agree_at_either_width(void **state)
{
	struct volume *field = sampled_cube(sampled_bump, 4, false);
	struct volume *distance = sampled_cube(sampled_sphere, 5, true);
	struct node a = volume_node(field, 0.0);
	struct node b = volume_node(distance, 0.3);
	struct tape *tapes[2] = {compile(&a), compile(&b)};
	const int widths[] = {1, 0};

	(void)state;
	make_points(2.5f);
	for (size_t i = 0; i < sizeof(widths) / sizeof(*widths); i++) {
		struct device *d = widths[i] ?
		    open_device(widths[i], 1 << 16) : device;
		char name[32];

		snprintf(name, sizeof(name), "4^3, width %d", widths[i]);
		check(name, compare(d, tapes[0]), 3e-7, 5e-7,
		    2e-6); /* 7.1e-8 1.1e-7 4.1e-7 */
		snprintf(name, sizeof(name), "5^3, width %d", widths[i]);
		check(name, compare(d, tapes[1]), 2e-6, 1e-5,
		    1e-4); /* 3.2e-7 2.1e-6 2.4e-5 */
		if (widths[i])
			device_close(d);
	}
	tape_free(tapes[0]);
	tape_free(tapes[1]);
	volume_release(field);
	volume_release(distance);
}

static void test_one_tape_uses_several_volumes(void **state)
{
	struct volume *v[2] = {sampled_cube(sampled_bump, 16, false),
		sampled_cube(sampled_sphere, 20, true)};
	struct node leaf[3] = {volume_node(v[0], 0.0), volume_node(v[1], 0.25),
		volume_node(v[0], 0.0)};
	struct node *children[3] = {leaf, leaf + 1, leaf + 2};
	struct node sum = {.type = NODE_SUM, .children = children,
		.child_count = 3};
	struct tape *tape;

	(void)state;
	leaf[2].has_transform = true;
	leaf[2].transform = affine_identity();
	leaf[2].transform.t[0] = 0.5;
	tape = compile(&sum);
	assert_int_equal(tape->volume_count, 2);
	make_points(1.5f);
	check("three volumes", compare(device, tape), 3e-6, 2e-5,
	    2e-4); /* 6.7e-7 3.8e-6 5.4e-5 */
	assert_int_equal(device->volumes.count, 0);
	tape_free(tape);
	volume_release(v[0]);
	volume_release(v[1]);
}

static void test_far_points_and_extreme_samples_give_finite_rows(void **state)
{
	float samples[64];
	struct device_tape *t;

	(void)state;
	for (int i = 0; i < 64; i++)
		samples[i] = (i + i / 4 + i / 16) % 2 ? VOLUME_SAMPLE_MAX :
		    -VOLUME_SAMPLE_MAX;
	for (int is_distance = 0; is_distance < 2; is_distance++) {
		struct insn insn = {OP_VOLUME, 0, 0, 0};
		double params[PRIMITIVE_PARAMS_MAX] = {0.0};
		struct tape tape = {.insns = &insn, .insn_count = 1,
			.params = params, .volume_count = 1};
		struct volume *v;

		assert_int_equal(volume_create(samples, (size_t[3]){4, 4, 4},
		    vec3(0.0, 0.0, 0.0), vec3(3e-9, 3e-9, 3e-9), is_distance,
		    &v), ERR_OK);
		tape.volumes = &v;
		tape.param_count = (size_t)volume_prepare(v, 1e-9, params);
		make_points(5e-9f);
		for (int i = 0; i < 3; i++) {
			points[6 + i] = i == 1 ? 3e38f : -1e20f;
			points[9 + i] = 1e12f;
		}
		assert_int_equal(device_load_tape(device, &tape, NULL, &t),
		    ERR_OK);
		assert_int_equal(device_evaluate(device, t, points, POINTS,
		    ALL_OUTPUTS, rows, NULL, NULL), ERR_OK);
		device_drop_tape(device, t);
		for (size_t i = 0; i < POINTS * ROW; i++)
			assert_true(fabsf(rows[i]) < 1e38f); /* nor a NaN */
		for (size_t i = 2 * ROW; i < 4 * ROW; i++)
			assert_near(rows[i], 0.0, 0.0);
		volume_release(v);
	}
}

/* ---- where they reside ---- */

static struct device_tape *load(struct device *d, struct volume *v,
    enum err expected)
{
	struct node node = volume_node(v, 0.0);
	struct tape *tape = compile(&node);
	struct device_tape *t = NULL;

	assert_int_equal(device_load_tape(d, tape, NULL, &t), expected);
	tape_free(tape);
	return t;
}

static void test_tapes_share_a_volume_and_the_last_one_frees_it(void **state)
{
	struct volume *v = sampled_cube(sampled_bump, 10, false);
	struct device_tape *a = load(device, v, ERR_OK);
	struct device_tape *b = load(device, v, ERR_OK);

	(void)state;
	assert_int_equal(device->volumes.count, 1);
	assert_int_equal(device->volumes.list[0].holds, 2);
	assert_int_equal(device->volumes.arena.count, 1);
	device_drop_tape(device, a);
	assert_int_equal(device->volumes.count, 1);
	device_drop_tape(device, b);
	assert_int_equal(device->volumes.count, 0);
	assert_int_equal(device->volumes.arena.count, 0);
	volume_release(v);
}

static void test_volumes_beyond_the_memory_are_refused(void **state)
{
	struct volume *v[4];
	struct device_tape *t[4];

	(void)state;
	/* 157 KiB each, of 512. */
	struct device *d = open_device(0, 512 << 10);
	for (int i = 0; i < 4; i++) {
		v[i] = sampled_cube(sampled_bump, 34, false);
		t[i] = load(d, v[i], i < 3 ? ERR_OK : ERR_DEVICE_MEMORY);
	}
	assert_non_null(strstr(device_message(d), "no room for a volume"));
	assert_int_equal(d->volumes.count, 3);
	device_drop_tape(d, t[1]);
	t[3] = load(d, v[3], ERR_OK);
	assert_int_equal(d->volumes.count, 3);
	for (int i = 0; i < 4; i++) {
		if (i != 1)
			device_drop_tape(d, t[i]);
		volume_release(v[i]);
	}
	assert_int_equal(d->volumes.count, 0);
	device_close(d);
}

static void test_a_device_without_volumes_has_no_buffer_for_them(void **state)
{
	struct device *d = open_device(0, (size_t)1 << 40);
	struct volume *v = sampled_cube(sampled_bump, 4, false);
	cl_ulong largest;

	(void)state;
	assert_int_equal(clGetDeviceInfo(d->id, CL_DEVICE_MAX_MEM_ALLOC_SIZE,
	    sizeof(largest), &largest, NULL), CL_SUCCESS);
	assert_true(d->volumes.arena.size <= largest / sizeof(float));
	assert_false(d->volumes.is_made);
	assert_non_null(d->volumes.arena.buffer);
	device_close(d);
	volume_release(v);
}

int main(void)
{
	const struct CMUnitTest tests[] = {
		cmocka_unit_test(test_fields_agree_with_float64),
		cmocka_unit_test(test_distances_agree_with_float64),
		cmocka_unit_test(test_ends_agree_at_either_width),
		cmocka_unit_test(test_one_tape_uses_several_volumes),
		cmocka_unit_test(
		    test_far_points_and_extreme_samples_give_finite_rows),
		cmocka_unit_test(
		    test_tapes_share_a_volume_and_the_last_one_frees_it),
		cmocka_unit_test(test_volumes_beyond_the_memory_are_refused),
		cmocka_unit_test(
		    test_a_device_without_volumes_has_no_buffer_for_them),
	};

	return cmocka_run_group_tests_name("volume", tests, setup, teardown);
}
