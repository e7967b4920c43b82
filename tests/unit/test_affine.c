#include <math.h>
#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>
#include <stdlib.h>
#include <string.h>

#include <cmocka.h>

#include "core/affine.h"

static double uniform(double least, double most)
{
	return least + (most - least) * drand48();
}

static struct affine random_affine(void)
{
	struct affine m;

	for (int i = 0; i < 3; i++) {
		for (int j = 0; j < 3; j++)
			m.a[i][j] = uniform(-2.0, 2.0);
		m.t[i] = uniform(-5.0, 5.0);
	}
	return m;
}

/* cmocka's own assertion compares as float. */
static void assert_near(double value, double expected, double tolerance)
{
	if (!(fabs(value - expected) <= tolerance))
		fail_msg("%.17g, not %.17g, beyond %g", value, expected,
		    tolerance);
}

static void assert_vec3(struct vec3 value, struct vec3 expected,
    double tolerance)
{
	assert_near(value.x, expected.x, tolerance);
	assert_near(value.y, expected.y, tolerance);
	assert_near(value.z, expected.z, tolerance);
}

static void test_trs_scales_then_rotates_then_translates(void **state)
{
	/* A quarter turn about z: x to y. */
	const double q[4] = {0.0, 0.0, sqrt(0.5), sqrt(0.5)};
	const double t[3] = {10.0, 20.0, 30.0}, s[3] = {2.0, 3.0, -4.0};
	struct affine m = affine_from_trs(t, q, s);

	(void)state;
	assert_vec3(affine_point(&m, vec3(1.0, 0.0, 0.0)),
	    vec3(10.0, 22.0, 30.0), 1e-14);
	assert_vec3(affine_point(&m, vec3(0.0, 1.0, 0.0)),
	    vec3(7.0, 20.0, 30.0), 1e-14);
	assert_vec3(affine_point(&m, vec3(0.0, 0.0, 1.0)),
	    vec3(10.0, 20.0, 26.0), 1e-14);
}

static void test_trs_turns_cycle_axes(void **state)
{
	/* A third of a turn about (1,1,1): x to y to z. */
	const double q[4] = {0.5, 0.5, 0.5, 0.5};
	const double t[3] = {0.0, 0.0, 0.0}, s[3] = {1.0, 1.0, 1.0};
	struct affine m = affine_from_trs(t, q, s);

	(void)state;
	assert_vec3(affine_point(&m, vec3(1.0, 2.0, 3.0)), vec3(3.0, 1.0, 2.0),
	    1e-15);
}

static void test_trs_of_unnormalised_quaternion_is_rotation(void **state)
{
	const double q[4] = {0.3, -0.2, 0.4, 0.87};
	const double t[3] = {0.0, 0.0, 0.0}, s[3] = {1.0, 1.0, 1.0};
	struct affine m = affine_from_trs(t, q, s);

	(void)state;
	for (int i = 0; i < 3; i++)
		for (int j = 0; j < 3; j++) {
			double dot = m.a[0][i] * m.a[0][j] +
			    m.a[1][i] * m.a[1][j] + m.a[2][i] * m.a[2][j];

			assert_near(dot, i == j ? 1.0 : 0.0, 1e-14);
		}
}

static void test_identity_keeps_points(void **state)
{
	struct affine m = affine_identity();

	(void)state;
	assert_vec3(affine_point(&m, vec3(1.0, -2.0, 3.0)),
	    vec3(1.0, -2.0, 3.0), 0.0);
}

static void test_compose_is_outer_after_inner(void **state)
{
	(void)state;
	srand48(1);
	for (int i = 0; i < 100; i++) {
		struct affine f = random_affine(), g = random_affine();
		struct affine fg = affine_compose(&f, &g);
		struct vec3 p = vec3(uniform(-1, 1), uniform(-1, 1),
		    uniform(-1, 1));

		/* Numbers are up to 50: rounding stays under 1e-13. */
		assert_vec3(affine_point(&fg, p),
		    affine_point(&f, affine_point(&g, p)), 1e-12);
	}
}

static void test_inverse_undoes(void **state)
{
	(void)state;
	srand48(2);
	for (int i = 0; i < 100; i++) {
		struct affine m = random_affine(), inverse, both;

		assert_true(affine_invert(&m, &inverse));
		both = affine_compose(&inverse, &m);
		/* The worst condition number of these is under 1e3. */
		assert_vec3(affine_point(&both, vec3(1.0, 2.0, 3.0)),
		    vec3(1.0, 2.0, 3.0), 1e-10);
	}
}

static void test_inverse_of_tiny_and_huge_scales(void **state)
{
	struct affine m = affine_identity(), inverse;

	(void)state;
	m.a[0][0] = 1e-9;
	m.a[1][1] = 1e9;
	m.a[2][2] = 1e-120;
	m.t[0] = 1.0;
	assert_true(affine_invert(&m, &inverse));
	assert_near(inverse.a[0][0] * 1e-9, 1.0, 1e-14);
	assert_near(inverse.a[1][1] * 1e9, 1.0, 1e-14);
	assert_near(inverse.a[2][2] * 1e-120, 1.0, 1e-14);
	assert_near(inverse.t[0] * 1e-9, -1.0, 1e-14);
}

static void test_singular_has_no_inverse_and_leaves_output(void **state)
{
	struct affine flat = affine_identity(), null = {{{0}}, {0}};
	struct affine near = affine_identity(), out, before;

	(void)state;
	memset(&out, 0x5a, sizeof(out));
	before = out;
	flat.a[2][0] = flat.a[0][2] = 1.0; /* columns 0 and 2 alike */
	near.a[0][1] = 1.0;
	near.a[1][1] = 1e-13;              /* det / norms = 1e-13 */
	assert_false(affine_invert(&flat, &out));
	assert_false(affine_invert(&null, &out));
	assert_false(affine_invert(&near, &out));
	near.a[1][1] = 1e-11;
	assert_memory_equal(&out, &before, sizeof(out));
	assert_true(affine_invert(&near, &out));
}

static void test_overflowing_inverse_is_refused(void **state)
{
	struct affine m = affine_identity(), out;

	(void)state;
	m.a[0][0] = 1e-200;
	m.t[0] = 1e200;
	assert_false(affine_invert(&m, &out));
}

/* h, a cubic, and its derivatives. */
static double cubic(struct vec3 p)
{
	return p.x * p.x * p.y + 2.0 * p.y * p.z - p.z * p.z * p.x + p.y;
}

static struct vec3 cubic_gradient(struct vec3 p)
{
	return vec3(2.0 * p.x * p.y - p.z * p.z, p.x * p.x + 2.0 * p.z + 1.0,
	    2.0 * p.y - 2.0 * p.z * p.x);
}

static struct sym3 cubic_hessian(struct vec3 p)
{
	return (struct sym3){2.0 * p.y, 0.0, -2.0 * p.x, 2.0 * p.x,
	    -2.0 * p.z, 2.0};
}

static struct vec3 pulled_gradient(const struct affine *m, struct vec3 p)
{
	return affine_pull_gradient(m->a, cubic_gradient(affine_point(m, p)));
}

static void test_pulled_gradient_matches_differences(void **state)
{
	const double h = 1e-5;
	const struct vec3 axes[3] = {{1, 0, 0}, {0, 1, 0}, {0, 0, 1}};

	(void)state;
	srand48(3);
	for (int i = 0; i < 100; i++) {
		const struct affine m = random_affine();
		struct vec3 p = vec3(uniform(-1, 1), uniform(-1, 1), 0.3);
		struct vec3 g = pulled_gradient(&m, p);

		for (int k = 0; k < 3; k++) {
			struct vec3 u = axes[k];
			struct vec3 up = affine_point(&m, vec3_axpy(h, u, p));
			struct vec3 dn = affine_point(&m, vec3_axpy(-h, u, p));

			/* Values up to 2e3 and h = 1e-5: rounding 4e-8. */
			assert_near(vec3_dot(g, u),
			    (cubic(up) - cubic(dn)) / (2.0 * h), 2e-7);
		}
	}
}

static void test_pulled_hessian_matches_differences(void **state)
{
	const double h = 1e-5;
	const struct vec3 axes[3] = {{1, 0, 0}, {0, 1, 0}, {0, 0, 1}};

	(void)state;
	srand48(4);
	for (int i = 0; i < 100; i++) {
		const struct affine m = random_affine();
		struct vec3 p = vec3(uniform(-1, 1), uniform(-1, 1), 0.3);
		struct sym3 full = affine_pull_hessian(m.a,
		    cubic_hessian(affine_point(&m, p)));

		for (int k = 0; k < 3; k++) {
			struct vec3 up = pulled_gradient(&m,
			    vec3_axpy(h, axes[k], p));
			struct vec3 dn = pulled_gradient(&m,
			    vec3_axpy(-h, axes[k], p));

			/* Gradients up to 1e3: rounding 2e-8. */
			assert_vec3(sym3_apply(full, axes[k]),
			    vec3_scale(0.5 / h, vec3_sub(up, dn)), 2e-7);
		}
	}
}

static void test_stretch_is_extreme_singular_values(void **state)
{
	const double q[4] = {0.1, 0.7, -0.1, 0.7}, t[3] = {1e9, 0.0, 0.0};
	const double s[3] = {0.5, -2.0, 7.0};
	struct affine m = affine_from_trs(t, q, s);
	double least, most;

	(void)state;
	affine_stretch(&m, &least, &most);
	assert_near(most, 7.0, 1e-12);
	assert_near(least, 0.5, 1e-12);
}

static void test_stretch_of_rotation_is_one(void **state)
{
	const double q[4] = {0.3, -0.2, 0.4, 0.87}, t[3] = {1.0, 2.0, 3.0};
	const double s[3] = {1.0, 1.0, -1.0};
	struct affine m = affine_from_trs(t, q, s);
	double least, most;

	(void)state;
	affine_stretch(&m, &least, &most);
	assert_near(most, 1.0, 1e-12);
	assert_near(least, 1.0, 1e-12);
}

static void test_stretch_of_singular_map_is_null(void **state)
{
	struct affine m = affine_identity();
	double least, most;

	(void)state;
	m.a[2][2] = 0.0;
	affine_stretch(&m, &least, &most);
	assert_true(least == 0.0);
	assert_near(most, 1.0, 1e-12);
}

int main(void)
{
	const struct CMUnitTest tests[] = {
		cmocka_unit_test(test_trs_scales_then_rotates_then_translates),
		cmocka_unit_test(test_trs_turns_cycle_axes),
		cmocka_unit_test(test_trs_of_unnormalised_quaternion_is_rotation),
		cmocka_unit_test(test_identity_keeps_points),
		cmocka_unit_test(test_compose_is_outer_after_inner),
		cmocka_unit_test(test_inverse_undoes),
		cmocka_unit_test(test_inverse_of_tiny_and_huge_scales),
		cmocka_unit_test(test_singular_has_no_inverse_and_leaves_output),
		cmocka_unit_test(test_overflowing_inverse_is_refused),
		cmocka_unit_test(test_pulled_gradient_matches_differences),
		cmocka_unit_test(test_pulled_hessian_matches_differences),
		cmocka_unit_test(test_stretch_is_extreme_singular_values),
		cmocka_unit_test(test_stretch_of_rotation_is_one),
		cmocka_unit_test(test_stretch_of_singular_map_is_null),
	};

	return cmocka_run_group_tests_name("affine", tests, NULL, NULL);
}
