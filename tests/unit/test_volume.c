/*
 * Interpolation of sampled fields: orders of convergence, smoothness, ends.
 */
#include <math.h>
#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>

#include <cmocka.h>

#include "core/primitive.h"
#include "core/volume.h"
#include "tests/support/fail_alloc.h"
#include "tests/support/near.h"
#include "tests/support/sampled.h"
#include "tests/support/sanitized.h"

#define POINTS (SANITIZED ? 2000 : 20000)

static const size_t odd_count[3] = {5, 7, 9};
static const struct vec3 odd_min = {-1.0, 2.0, 10.0};
static const struct vec3 odd_max = {1.0, 5.0, 10.5};

/* A linear congruential generator (Knuth, MMIX). */
static double uniform(uint64_t *state)
{
	*state = *state * 6364136223846793005u + 1442695040888963407u;
	return (double)(*state >> 11) / 9007199254740992.0;
}

static struct vec3 inside(uint64_t *state, double half)
{
	double x = uniform(state), y = uniform(state), z = uniform(state);

	return vec3(half * (2.0 * x - 1.0), half * (2.0 * y - 1.0),
	    half * (2.0 * z - 1.0));
}

/* Samples in [-1, 1]. */
static struct volume *random_volume(bool is_distance, float *samples)
{
	size_t total = odd_count[0] * odd_count[1] * odd_count[2];
	uint64_t state = 7;
	struct volume *v;

	for (size_t i = 0; i < total; i++)
		samples[i] = (float)(2.0 * uniform(&state) - 1.0);
	assert_int_equal(volume_create(samples, odd_count, odd_min, odd_max,
	    is_distance, &v), ERR_OK);
	return v;
}

static struct vec3 node(size_t i, size_t j, size_t k)
{
	return vec3(odd_min.x + (odd_max.x - odd_min.x) * (double)i / 4.0,
	    odd_min.y + (odd_max.y - odd_min.y) * (double)j / 6.0,
	    odd_min.z + (odd_max.z - odd_min.z) * (double)k / 8.0);
}

static void evaluate(const struct volume *v, double falloff, struct vec3 x,
    struct jet *out)
{
	double params[PRIMITIVE_PARAMS_MAX];

	volume_prepare(v, falloff, params);
	volume_eval(v, params, x, 2, out);
}

static double most(double a, double b)
{
	return a > b ? a : b;
}

static double gradient_error(const struct jet *a, const struct jet *b)
{
	return vec3_norm(vec3_sub(a->gradient, b->gradient));
}

static double hessian_error(const struct jet *a, const struct jet *b)
{
	struct sym3 d = sym3_axpy(-1.0, b->hessian, a->hessian);

	return most(most(most(fabs(d.xx), fabs(d.yy)), most(fabs(d.zz),
	    fabs(d.xy))), most(fabs(d.xz), fabs(d.yz)));
}

/* How far a field of distances is off at a node, through a falloff that makes
 * f = 1/2 - 15/16 t and a little of every t in [-1, 1]. */
static double polynomial(double t)
{
	return 0.5 - t * (15.0 / 16.0 - t * t * (5.0 / 8.0 -
	    t * t * 3.0 / 16.0));
}

static void test_the_spline_goes_through_every_sample(void **state)
{
	float samples[5 * 7 * 9];
	double off = 0.0;

	(void)state;
	for (int is_distance = 0; is_distance < 2; is_distance++) {
		struct volume *v = random_volume(is_distance, samples);

		for (size_t i = 0; i < 5 * 7 * 9; i++) {
			struct vec3 x = node(i / 63, i / 9 % 7, i % 9);
			double s = samples[i], expected = most(s, 0.0);
			struct jet f;

			evaluate(v, 1.0, x, &f);
			if (is_distance)
				expected = polynomial(s);
			off = most(off, fabs(f.value - expected));
		}
		volume_release(v);
	}
	print_message("measured: a volume off its samples, of size 1, by at "
	    "most %.1e\n", off);
	assert_near(off, 0.0, 1e-6); /* 1.2e-7: coefficients are float32 */
}

struct errors {
	double value, gradient, hessian;
};

static struct errors bump_errors(size_t n)
{
	struct volume *v = sampled_cube(sampled_bump, n, false);
	struct errors e = {0.0, 0.0, 0.0};
	uint64_t state = 11;

	for (int i = 0; i < POINTS; i++) {
		struct vec3 x = inside(&state, 1.0);
		struct jet f, exact;

		evaluate(v, 0.0, x, &f);
		sampled_bump(x, &exact);
		e.value = most(e.value, fabs(f.value - exact.value));
		e.gradient = most(e.gradient, gradient_error(&f, &exact));
		e.hessian = most(e.hessian, hessian_error(&f, &exact));
	}
	volume_release(v);
	return e;
}

/*
 * Each doubling divides the errors by about 16, 8 and 4, until float32
 * coefficients end it: in second derivatives at 4e-7/h^2.
 */
static void test_value_gradient_hessian_converge_in_order_4_3_2(void **state)
{
	struct errors before = bump_errors(17);

	(void)state;
	for (size_t n = 33; n <= 129; n = 2 * n - 1) {
		struct errors e = bump_errors(n);
		double value = log2(before.value / e.value);
		double gradient = log2(before.gradient / e.gradient);
		double hessian = log2(before.hessian / e.hessian);

		print_message("measured: %zu^3 bump off by %.1e, gradient "
		    "%.1e, Hessian %.1e; orders %.2f %.2f %.2f\n", n, e.value,
		    e.gradient, e.hessian, value, gradient, hessian);
		assert_near(value, 4.0, 0.5);
		assert_near(gradient, 3.0, 0.5);
		assert_near(hessian, 2.0, 0.5);
		before = e;
	}
}

/* Both sides of x, where anything could jump. */
static void check_smooth(const struct volume *v, double falloff,
    struct vec3 x, struct vec3 step)
{
	struct jet a, b;

	evaluate(v, falloff, vec3_sub(x, step), &a);
	evaluate(v, falloff, vec3_add(x, step), &b);
	/* 2e-10 apart, of Hessians up to 80 and third derivatives up to 600 */
	assert_near(a.value, b.value, 1e-8);
	assert_near(gradient_error(&a, &b), 0.0, 1e-7);
	assert_near(hessian_error(&a, &b), 0.0, 1e-6);
}

/* Nowhere 0 in the box, so that the spline is not held at 0. */
static void hill(struct vec3 x, struct jet *out)
{
	sampled_bump(x, out);
	out->value += 0.2;
}

static void test_cells_meet_with_equal_second_derivatives(void **state)
{
	struct volume *field = sampled_cube(hill, 17, false);
	struct volume *distance = sampled_cube(sampled_sphere, 17, true);
	uint64_t random = 3;
	const double e = 1e-10;

	(void)state;
	for (int i = 0; i < 2000; i++) {
		struct vec3 x = inside(&random, 1.3);
		/* on a cell's face; beyond the box where its influence ends */
		double face = floor(uniform(&random) * 21.0 - 2.0) / 8.0 - 1.0;

		check_smooth(field, 0.0, vec3(face, x.y, x.z), vec3(e, 0, 0));
		check_smooth(field, 0.0, vec3(x.x, face, x.z), vec3(0, e, 0));
		check_smooth(field, 0.0, vec3(x.x, x.y, face), vec3(0, 0, e));
		check_smooth(distance, 0.3, vec3(face, x.y, x.z),
		    vec3(e, 0, 0));
		check_smooth(distance, 0.3, vec3(x.x, x.y, face),
		    vec3(0, 0, e));
	}
	volume_release(distance);
	volume_release(field);
}

/* The gradient by differences of values, the Hessian of gradients. */
static void check_differences(const struct volume *v, double falloff,
    struct vec3 x)
{
	const double e = 1e-5;
	struct jet f, a, b, d;

	evaluate(v, falloff, x, &f);
	evaluate(v, falloff, vec3(x.x - e, x.y, x.z), &a);
	evaluate(v, falloff, vec3(x.x + e, x.y, x.z), &b);
	d.gradient.x = (b.value - a.value) / (2.0 * e);
	d.hessian.xx = (b.gradient.x - a.gradient.x) / (2.0 * e);
	d.hessian.xy = (b.gradient.y - a.gradient.y) / (2.0 * e);
	d.hessian.xz = (b.gradient.z - a.gradient.z) / (2.0 * e);
	evaluate(v, falloff, vec3(x.x, x.y - e, x.z), &a);
	evaluate(v, falloff, vec3(x.x, x.y + e, x.z), &b);
	d.gradient.y = (b.value - a.value) / (2.0 * e);
	d.hessian.yy = (b.gradient.y - a.gradient.y) / (2.0 * e);
	d.hessian.yz = (b.gradient.z - a.gradient.z) / (2.0 * e);
	evaluate(v, falloff, vec3(x.x, x.y, x.z - e), &a);
	evaluate(v, falloff, vec3(x.x, x.y, x.z + e), &b);
	d.gradient.z = (b.value - a.value) / (2.0 * e);
	d.hessian.zz = (b.gradient.z - a.gradient.z) / (2.0 * e);
	/* The third derivatives, up to 1e3, jump between cells: e times them,
	 * and f''' e^2 / 6. */
	assert_near(gradient_error(&f, &d), 0.0, 1e-6);
	assert_near(hessian_error(&f, &d), 0.0, 1e-2);
}

static void test_derivatives_are_those_of_the_value(void **state)
{
	struct volume *field = sampled_volume(sampled_bump, odd_count,
	    vec3(-1.0, -0.7, -0.9), vec3(0.8, 0.9, 1.0), false);
	struct volume *distance = sampled_cube(sampled_sphere, 17, true);
	uint64_t random = 5;

	(void)state;
	for (int i = 0; i < 2000; i++) {
		check_differences(field, 0.0, inside(&random, 1.5));
		check_differences(distance, 0.35, inside(&random, 1.2));
	}
	volume_release(distance);
	volume_release(field);
}

static void test_a_sampled_sphere_is_the_sphere(void **state)
{
	struct volume *v = sampled_cube(sampled_sphere, 64, true);
	const double sphere[5] = {0.0, 0.0, 0.0, 0.6, 1.0 / 0.35};
	struct errors e = {0.0, 0.0, 0.0};
	uint64_t random = 13;

	(void)state;
	assert_near(v->least_edge, 0.4, 1e-3); /* the faces' middles */
	for (int i = 0; i < POINTS; i++) {
		struct vec3 x = inside(&random, 1.2);
		struct jet f, exact;

		evaluate(v, 0.35, x, &f);
		primitive_eval(OP_SPHERE, sphere, x, 2, &exact);
		e.value = most(e.value, fabs(f.value - exact.value));
		e.gradient = most(e.gradient, gradient_error(&f, &exact));
		e.hessian = most(e.hessian, hessian_error(&f, &exact));
	}
	print_message("measured: a sphere of 64^3 distances off by %.1e, "
	    "gradient %.1e, Hessian %.1e\n", e.value, e.gradient, e.hessian);
	assert_near(e.value, 0.0, 1e-6);
	assert_near(e.gradient, 0.0, 6e-5);
	assert_near(e.hessian, 0.0, 1e-2);
	volume_release(v);
}

static void linear(struct vec3 x, struct jet *out)
{
	*out = (struct jet){.value = 0.25 * x.x - 0.5 * x.y + 0.1 * x.z + 0.2};
}

/* Natural ends have no second derivative, and linear functions need none. */
static void test_linear_distances_are_exact_up_to_the_faces(void **state)
{
	struct volume *v = sampled_volume(linear, odd_count,
	    vec3(-1.0, -1.0, -1.0), vec3(1.0, 1.0, 1.0), true);
	uint64_t random = 17;

	(void)state;
	for (int i = 0; i < 2000; i++) {
		struct vec3 x = inside(&random, 1.0);
		struct jet f, d;

		linear(x, &d);
		evaluate(v, 2.0, x, &f);
		assert_near(f.value, polynomial(d.value / 2.0), 1e-7);
	}
	volume_release(v);
}

static void assert_nothing(const struct jet *f)
{
	const struct jet zero = {0};

	assert_near(f->value, 0.0, 0.0);
	assert_near(gradient_error(f, &zero), 0.0, 0.0);
	assert_near(hessian_error(f, &zero), 0.0, 0.0);
}

static void test_far_points_have_no_field(void **state)
{
	static const double at[] = {-POINT_REACH, -1e9, -1.2500001, 1.2500001,
	    2e9, POINT_REACH};
	struct volume *field = sampled_cube(sampled_bump, 17, false);
	struct volume *distance = sampled_cube(sampled_sphere, 17, true);
	struct jet f;

	(void)state;
	for (size_t i = 0; i < sizeof at / sizeof *at; i++) {
		evaluate(field, 0.0, vec3(at[i], 0.0, 0.0), &f);
		assert_nothing(&f);
		evaluate(field, 0.0, vec3(at[i], at[i], -at[i]), &f);
		assert_nothing(&f);
		evaluate(distance, 0.1, vec3(0.0, at[i], 0.0), &f);
		assert_nothing(&f);
	}
	evaluate(distance, 0.1, vec3(0.0, 0.0, 1.0000001), &f);
	assert_nothing(&f);
	volume_release(distance);
	volume_release(field);
}

/* Two spacings around the box everything is continuous and finite. */
static void test_fields_fall_to_0_within_two_spacings(void **state)
{
	float samples[4 * 4 * 4];
	struct volume *v;
	struct jet f;

	(void)state;
	for (int i = 0; i < 64; i++)
		samples[i] = 1.0f;
	assert_int_equal(volume_create(samples, (size_t[3]){4, 4, 4},
	    vec3(0.0, 0.0, 0.0), vec3(3.0, 3.0, 3.0), false, &v), ERR_OK);
	evaluate(v, 0.0, vec3(3.0, 1.0, 1.0), &f);
	assert_near(f.value, 1.0, 1e-6);
	evaluate(v, 0.0, vec3(4.0, 1.0, 1.0), &f);
	assert_true(f.value > 0.0 && f.value < 0.5);
	evaluate(v, 0.0, vec3(4.999, 1.0, 1.0), &f);
	assert_true(f.value > 0.0 && f.value < 1e-9);
	evaluate(v, 0.0, vec3(5.0, 1.0, 1.0), &f);
	assert_nothing(&f);
	evaluate(v, 0.0, vec3(1.0, -2.0, 1.0), &f);
	assert_nothing(&f);
	volume_release(v);
}

static void test_a_field_is_never_negative(void **state)
{
	float samples[5 * 7 * 9];
	struct volume *v = random_volume(false, samples);
	uint64_t random = 19;
	int clamped = 0;

	(void)state;
	for (int i = 0; i < 2000; i++) {
		struct jet f;

		evaluate(v, 0.0, vec3(-1.0 + 2.0 * uniform(&random),
		    2.0 + 3.0 * uniform(&random),
		    10.0 + 0.5 * uniform(&random)), &f);
		assert_true(f.value >= 0.0);
		if (f.value == 0.0) {
			assert_nothing(&f);
			clamped++;
		}
	}
	assert_true(clamped > 500 && clamped < 1500);
	volume_release(v);
}

static void test_orders_leave_out_derivatives(void **state)
{
	double params[PRIMITIVE_PARAMS_MAX];

	(void)state;
	for (int is_distance = 0; is_distance < 2; is_distance++) {
		struct volume *v = sampled_cube(is_distance ? sampled_sphere :
		    sampled_bump, 16, is_distance);
		struct jet f[3];

		assert_int_equal(volume_prepare(v, is_distance ? 0.3 : 0.0,
		    params), 10);
		for (int order = 0; order < 3; order++)
			volume_eval(v, params, vec3(0.3, 0.4, -0.2), order,
			    f + order);
		assert_near(f[0].value, f[2].value, 0.0);
		assert_near(f[1].value, f[2].value, 0.0);
		assert_near(gradient_error(f + 1, f + 2), 0.0, 0.0);
		assert_true(f[0].value > 0.1);
		f[0].value = f[1].value = 0.0;
		assert_nothing(f);
		assert_true(vec3_norm(f[1].gradient) > 0.1);
		f[1].gradient = vec3(0.0, 0.0, 0.0);
		assert_nothing(f + 1);
		volume_release(v);
	}
}

/* The largest samples, alternating, over the smallest spacing. */
static void test_extreme_volumes_stay_finite(void **state)
{
	float samples[4 * 4 * 4];

	(void)state;
	for (int i = 0; i < 64; i++)
		samples[i] = (i + i / 4 + i / 16) % 2 ? VOLUME_SAMPLE_MAX :
		    -VOLUME_SAMPLE_MAX;
	for (int is_distance = 0; is_distance < 2; is_distance++) {
		uint64_t random = 23;
		struct volume *v;

		assert_int_equal(volume_create(samples, (size_t[3]){4, 4, 4},
		    vec3(0.0, 0.0, 0.0), vec3(3e-9, 3e-9, 3e-9), is_distance,
		    &v), ERR_OK);
		assert_near(volume_spacing(v), 1e-9, 1e-20);
		for (int i = 0; i < 1000; i++) {
			struct jet f;

			evaluate(v, 1e-9, inside(&random, 5e-9), &f);
			assert_true(isfinite(f.value));
			assert_true(isfinite(vec3_norm(f.gradient)));
			assert_true(isfinite(f.hessian.xx + f.hessian.yy +
			    f.hessian.zz + f.hessian.xy + f.hessian.xz +
			    f.hessian.yz));
		}
		volume_release(v);
	}
}

static void test_references_and_serials(void **state)
{
	struct volume *a = sampled_cube(sampled_bump, 4, false);
	struct volume *b = sampled_cube(sampled_bump, 4, false);

	(void)state;
	assert_true(a->serial != b->serial && a->serial > 0);
	assert_ptr_equal(volume_hold(a), a);
	volume_release(a);
	assert_int_equal(volume_bytes(a), sizeof *a + 256);
	assert_near(volume_spacing(a), 2.0 / 3.0, 1e-15);
	volume_release(a);
	volume_release(b);
	volume_release(NULL);
}

static void test_every_failed_allocation_is_told(void **state)
{
	float samples[64] = {0.0f};
	enum err err = ERR_MEMORY;
	struct volume *v = NULL;
	long n = 0;

	(void)state;
	if (!fail_alloc_available())
		skip();
	while (err != ERR_OK) {
		fail_alloc_set(++n);
		err = volume_create(samples, (size_t[3]){4, 4, 4},
		    vec3(0.0, 0.0, 0.0), vec3(1.0, 1.0, 1.0), false, &v);
		assert_int_equal(err, fail_alloc_happened() ? ERR_MEMORY :
		    ERR_OK);
		if (err != ERR_OK) {
			assert_null(v);
			assert_int_equal(fail_alloc_live(), 0);
		}
	}
	volume_release(v);
	assert_int_equal(fail_alloc_live(), 0);
	fail_alloc_set(0);
	assert_int_equal(n, 4);
}

int main(void)
{
	const struct CMUnitTest tests[] = {
		cmocka_unit_test(test_the_spline_goes_through_every_sample),
		cmocka_unit_test(
		    test_value_gradient_hessian_converge_in_order_4_3_2),
		cmocka_unit_test(test_cells_meet_with_equal_second_derivatives),
		cmocka_unit_test(test_derivatives_are_those_of_the_value),
		cmocka_unit_test(test_a_sampled_sphere_is_the_sphere),
		cmocka_unit_test(
		    test_linear_distances_are_exact_up_to_the_faces),
		cmocka_unit_test(test_far_points_have_no_field),
		cmocka_unit_test(test_fields_fall_to_0_within_two_spacings),
		cmocka_unit_test(test_a_field_is_never_negative),
		cmocka_unit_test(test_orders_leave_out_derivatives),
		cmocka_unit_test(test_extreme_volumes_stay_finite),
		cmocka_unit_test(test_references_and_serials),
		cmocka_unit_test(test_every_failed_allocation_is_told),
	};

	return cmocka_run_group_tests_name("volume", tests, NULL, NULL);
}
