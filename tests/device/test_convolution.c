/*
 * Convolution surfaces: the device's elements against the float64 ones, near,
 * far, degenerate and extreme.
 */
#include <math.h>
#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>
#include <stdio.h>

#include <cmocka.h>

#include "core/convolution.h"
#include "core/output.h"
#include "core/primitive.h"
#include "core/tape.h"
#include "kernels/device.h"
#include "tests/support/random_tree.h"
#include "tests/support/sanitized.h"

#define POINTS 512
#define ELEMENTS (SANITIZED ? 20 : 100)
#define ROW 10
#define ALL_OUTPUTS (OUTPUT_VALUE | OUTPUT_GRADIENT | OUTPUT_HESSIAN)

static struct device *device;
static float points[POINTS * 3], rows[POINTS * ROW];

static int setup(void **state)
{
	struct device_options options = {0};
	struct device_failure failure = {0};
	enum err err = device_open(&options, &device, &failure);

	(void)state;
	if (err)
		printf("%s\n%s\n", failure.message,
		    failure.build_log ? failure.build_log : "");
	device_failure_fini(&failure);
	return err == ERR_OK ? 0 : -1;
}

static int teardown(void **state)
{
	(void)state;
	device_close(device);
	return 0;
}

/* Rows of p alone at all points. Its parameters, rounded as the device has
 * them, stay in params. */
static void evaluate_element(const struct primitive *p, unsigned outputs,
    double params[PRIMITIVE_PARAMS_MAX])
{
	struct insn insn = {primitive_opcode(p->type), 0, 0, 0};
	struct tape tape = {.insns = &insn, .insn_count = 1, .params = params,
		.param_count = (size_t)primitive_prepare(p, params)};
	struct device_tape *t = NULL;

	for (size_t i = 0; i < tape.param_count; i++)
		params[i] = (double)(float)params[i];
	assert_int_equal(device_load_tape(device, &tape, NULL, &t), ERR_OK);
	assert_int_equal(device_evaluate(device, t, points, POINTS, outputs,
	    rows, NULL, NULL), ERR_OK);
	device_drop_tape(device, t);
}

static struct vec3 get_point(size_t i)
{
	return vec3((double)points[3 * i], (double)points[3 * i + 1],
	    (double)points[3 * i + 2]);
}

static void put_point(size_t i, struct vec3 x)
{
	points[3 * i] = (float)x.x;
	points[3 * i + 1] = (float)x.y;
	points[3 * i + 2] = (float)x.z;
}

static double largest(const double *v, int count)
{
	double most = 0.0;

	for (int i = 0; i < count; i++)
		most = fmax(most, fabs(v[i]));
	return most;
}

/* Errors of value, gradient and Hessian in units of f, s f and s^2 f, or where
 * f < 1e-6 of 1e-6: what they may add to a sum of elements. */
struct errors {
	double value, gradient, hessian;
};

static void compare(const struct primitive *p, const double *params, size_t i,
    struct errors *worst)
{
	const float *row = rows + i * ROW;
	struct jet j;
	double d[ROW], f;

	primitive_eval(primitive_opcode(p->type), params, get_point(i), 2, &j);
	f = fmax(j.value, 1e-6);
	d[0] = (double)row[0] - j.value;
	d[1] = (double)row[1] - j.gradient.x;
	d[2] = (double)row[2] - j.gradient.y;
	d[3] = (double)row[3] - j.gradient.z;
	d[4] = (double)row[4] - j.hessian.xx;
	d[5] = (double)row[5] - j.hessian.yy;
	d[6] = (double)row[6] - j.hessian.zz;
	d[7] = (double)row[7] - j.hessian.xy;
	d[8] = (double)row[8] - j.hessian.xz;
	d[9] = (double)row[9] - j.hessian.yz;
	worst->value = fmax(worst->value, fabs(d[0]) / f);
	worst->gradient = fmax(worst->gradient,
	    largest(d + 1, 3) / (f * p->s));
	worst->hessian = fmax(worst->hessian,
	    largest(d + 4, 6) / (f * p->s * p->s));
}

static struct vec3 random_vec3(struct random_stream *r, double size)
{
	double x = random_in(r, -size, size), y = random_in(r, -size, size);

	return vec3(x, y, random_in(r, -size, size));
}

/* A point on the element, or all about it up to away from it. */
static struct vec3 random_place(struct random_stream *r,
    const struct primitive *p, double away)
{
	double u = random_in(r, 0.0, 1.0), v = random_in(r, 0.0, 1.0 - u);
	struct vec3 x = p->a;

	if (p->type != PRIMITIVE_CAUCHY_POINT)
		x = vec3_axpy(u, vec3_sub(p->b, p->a), x);
	if (p->type == PRIMITIVE_CAUCHY_TRIANGLE)
		x = vec3_axpy(v, vec3_sub(p->c, p->a), x);
	if (random_below(r, 4) == 0)
		return x;
	return vec3_add(x, random_vec3(r, away *
	    pow(10.0, random_in(r, -2.0, 0.0))));
}

/* Compares p at the points that are set; adds to worst. */
static void compare_all(const struct primitive *p, struct errors *worst)
{
	double params[PRIMITIVE_PARAMS_MAX];

	evaluate_element(p, ALL_OUTPUTS, params);
	for (size_t i = 0; i < POINTS; i++)
		compare(p, params, i, worst);
}

static void check_errors(const struct errors *worst,
    const struct errors *most)
{
	printf("measured: %.1e %.1e %.1e\n", worst->value, worst->gradient,
	    worst->hessian);
	assert_true(worst->value <= most->value);
	assert_true(worst->gradient <= most->gradient);
	assert_true(worst->hessian <= most->hessian);
}

/* Random elements within [-size, size]^3 of radius 1, points up to 40 away. */
static void check_elements(enum primitive_type type, double size,
    const struct errors *most)
{
	struct random_stream r = {(uint64_t)type};
	struct errors worst = {0.0, 0.0, 0.0};

	for (int i = 0; i < ELEMENTS; i++) {
		struct primitive p = {.type = type, .radius = {1.0},
		    .s = cauchy_default_s(1.0), .weight = 1.0,
		    .a = random_vec3(&r, size), .b = random_vec3(&r, size),
		    .c = random_vec3(&r, size)};

		for (size_t k = 0; k < POINTS; k++)
			put_point(k, random_place(&r, &p, 40.0));
		compare_all(&p, &worst);
	}
	check_errors(&worst, most);
}

static void test_device_cauchy_points(void **state)
{
	(void)state;
	/* 5e-7 1e-6 3e-6 */
	check_elements(PRIMITIVE_CAUCHY_POINT, 1.0,
	    &(struct errors){2e-6, 4e-6, 1e-5});
}

static void test_device_cauchy_segments(void **state)
{
	static const double sizes[] = {0.01, 0.3, 1.0, 4.0};

	(void)state;
	/* 1.3e-6 2.4e-6 5.6e-6 */
	for (int i = 0; i < 4; i++)
		check_elements(PRIMITIVE_CAUCHY_SEGMENT, sizes[i],
		    &(struct errors){5e-6, 1e-5, 2e-5});
	/* 5e-6 1.1e-5 2.6e-5: coordinates of 20 are rounded by 2e-6 */
	check_elements(PRIMITIVE_CAUCHY_SEGMENT, 20.0,
	    &(struct errors){2e-5, 4e-5, 1e-4});
}

static void test_device_cauchy_triangles(void **state)
{
	static const double sizes[] = {0.01, 0.3, 1.0, 4.0};

	(void)state;
	/* 6e-6 9e-6 1.6e-5 */
	for (int i = 0; i < 4; i++)
		check_elements(PRIMITIVE_CAUCHY_TRIANGLE, sizes[i],
		    &(struct errors){2e-5, 3e-5, 5e-5});
	/* 1.2e-5 1.7e-5 1.6e-5, for the same reason */
	check_elements(PRIMITIVE_CAUCHY_TRIANGLE, 20.0,
	    &(struct errors){4e-5, 6e-5, 6e-5});
}

/* Long ones of every thinness, the apex over the base or beside it; their
 * field is compared with one as strong as a triangle's of height 1. */
static void test_device_cauchy_slivers(void **state)
{
	struct random_stream r = {7};
	struct errors worst = {0.0, 0.0, 0.0};

	(void)state;
	for (int i = 0; i < ELEMENTS; i++) {
		double height = pow(10.0, random_in(&r, -7.0, 0.0));
		struct primitive p = {.type = PRIMITIVE_CAUCHY_TRIANGLE,
		    .radius = {1.0}, .s = cauchy_default_s(1.0),
		    .weight = 1.0 / height, .b = {4.0, 0.0, 0.0},
		    .c = {random_in(&r, -2.0, 6.0), 0.0, height}};

		for (size_t k = 0; k < POINTS; k++)
			put_point(k, random_place(&r, &p, 40.0));
		compare_all(&p, &worst);
	}
	/* 6e-6 1.3e-5 2.1e-5 */
	check_errors(&worst, &(struct errors){2e-5, 4e-5, 6e-5});
}

/* Inside, on sides and their lines, at corners and beyond; above them too. */
static void test_device_cauchy_special_points(void **state)
{
	static const double share[] = {-3.0, -0.5, 0.0, 0.25, 0.5, 1.0, 2.0,
		8.0};
	static const double above[] = {0.0, 1e-20, 1e-6, 0.01, -0.5, 1.0, 7.0,
		-50.0};
	struct primitive p = {.type = PRIMITIVE_CAUCHY_TRIANGLE,
	    .radius = {1.0}, .s = cauchy_default_s(1.0), .weight = 1.0};
	struct errors worst = {0.0, 0.0, 0.0};

	(void)state;
	for (double size = 0.125; size < 5.0; size *= 2.0) {
		p.b = vec3(size, 0.0, 0.0);
		p.c = vec3(0.25 * size, size, 0.0);
		for (size_t i = 0; i < POINTS; i++)
			put_point(i, vec3_add(vec3(0.0, 0.0, above[i / 64]),
			    vec3_axpy(share[i % 8], p.b,
			    vec3_scale(share[i / 8 % 8], p.c))));
		p.type = PRIMITIVE_CAUCHY_SEGMENT;
		compare_all(&p, &worst);
		p.type = PRIMITIVE_CAUCHY_TRIANGLE;
		compare_all(&p, &worst);
	}
	/* 4e-6 5e-6 9e-6 */
	check_errors(&worst, &(struct errors){1e-5, 2e-5, 3e-5});
}

static struct primitive extreme_element(struct random_stream *r)
{
	static const double sizes[] = {0.0, 1e-9, 1e-3, 1.0, 1e5, 1e9};
	struct primitive p = {.type = PRIMITIVE_CAUCHY_POINT +
	    (enum primitive_type)random_below(r, 3), .weight = 1e6};

	p.a = random_vec3(r, sizes[random_below(r, 6)]);
	p.b = random_vec3(r, sizes[random_below(r, 6)]);
	p.c = random_vec3(r, sizes[random_below(r, 6)]);
	p.radius[0] = pow(10.0, random_in(r, -9.0, 9.0));
	p.s = pow(10.0, random_in(r, -2.0, 2.0)) / p.radius[0];
	p.s = p.s > 1e9 ? 1e9 : p.s < 1e-9 ? 1e-9 : p.s;
	if (random_below(r, 3) == 0)
		p.b = p.a;
	if (random_below(r, 3) == 0)
		p.c = random_below(r, 2) ? p.b : p.a;
	return p;
}

static void test_device_cauchy_is_finite_everywhere(void **state)
{
	static const double away[] = {0.0, 1e-12, 1e-3, 1.0, 1e4, 1e9, 1e12,
		3e38};
	struct random_stream r = {8};
	double params[PRIMITIVE_PARAMS_MAX];

	(void)state;
	for (int i = 0; i < 3 * ELEMENTS; i++) {
		struct primitive p = extreme_element(&r);

		for (size_t k = 0; k < POINTS; k++)
			put_point(k, random_below(&r, 2) ?
			    random_vec3(&r, away[random_below(&r, 8)]) :
			    random_place(&r, &p, 1.0 / p.s));
		evaluate_element(&p, ALL_OUTPUTS, params);
		for (size_t k = 0; k < POINTS * ROW; k++)
			assert_true(isfinite(rows[k]));
		for (size_t k = 0; k < POINTS; k++)
			assert_true(rows[k * ROW] >= 0.0f);
	}
}

/* Fewer outputs are the same numbers. */
static void test_device_cauchy_orders_agree(void **state)
{
	struct random_stream r = {9};
	struct primitive p = {.type = PRIMITIVE_CAUCHY_TRIANGLE,
	    .radius = {1.0}, .s = cauchy_default_s(1.0), .weight = 1.0,
	    .b = {4.0, 0.0, 1.0}, .c = {1.0, 3.0, 0.0}};
	double params[PRIMITIVE_PARAMS_MAX];
	static float values[POINTS];

	(void)state;
	for (size_t k = 0; k < POINTS; k++)
		put_point(k, random_place(&r, &p, 40.0));
	evaluate_element(&p, OUTPUT_VALUE, params);
	for (size_t k = 0; k < POINTS; k++)
		values[k] = rows[k];
	evaluate_element(&p, ALL_OUTPUTS, params);
	for (size_t k = 0; k < POINTS; k++)
		assert_true(fabsf(values[k] - rows[k * ROW]) <=
		    1e-6f * rows[k * ROW]);
}

int main(void)
{
	const struct CMUnitTest tests[] = {
		cmocka_unit_test(test_device_cauchy_points),
		cmocka_unit_test(test_device_cauchy_segments),
		cmocka_unit_test(test_device_cauchy_triangles),
		cmocka_unit_test(test_device_cauchy_slivers),
		cmocka_unit_test(test_device_cauchy_special_points),
		cmocka_unit_test(test_device_cauchy_is_finite_everywhere),
		cmocka_unit_test(test_device_cauchy_orders_agree),
	};

	return cmocka_run_group_tests(tests, setup, teardown);
}
