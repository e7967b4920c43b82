#include <math.h>
#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>

#include <cmocka.h>

#include "core/boundary.h"
#include "core/profile.h"
#include "tests/support/golden.h"
#include "tests/support/near.h"

static void phi_row(void *ctx, const double *v)
{
	double phi[3];

	(void)ctx;
	boundary_phi(v[0], phi);
	assert_near(phi[0], v[1], 1e-9);
}

static void test_phi_golden(void **state)
{
	(void)state;
	assert_int_equal(golden_each("phi", 2, phi_row, NULL), 50);
}

static void boundary_row(void *ctx, const double *v)
{
	struct boundary_jet k;

	(void)ctx;
	boundary_union(v[0], tan(v[1]), &k);
	assert_near(k.k, v[2], 1e-9);
}

static void test_boundary_golden(void **state)
{
	(void)state;
	assert_int_equal(golden_each("boundary", 3, boundary_row, NULL), 120);
}

static void test_phi_inverts_x_plus_eta(void **state)
{
	(void)state;
	for (double u = 0.001; u < 2.0; u += 0.001) {
		double phi[3], eta[3];

		boundary_phi(u, phi);
		profile_eta(phi[0], eta);
		/* eta' grows to 1e6 towards u = 2. */
		assert_near(phi[0] + eta[0], u, 1e-15 * (1 + eta[1]));
	}
}

/* Central differences, h = 1e-5: errors of h^2 and 1e-16/h^2 */
static void compare_derivatives(void (*f)(double, double,
    struct boundary_jet *), double x, double T)
{
	const double h = 1e-5;
	struct boundary_jet k, a, b, c, d;
	double scale;

	f(x, T, &k);
	f(x - h, T, &a);
	f(x + h, T, &b);
	f(x, T - h, &c);
	f(x, T + h, &d);
	scale = 1e-4 * (1 + fabs(k.kff) + fabs(k.ktt));
	assert_near(k.kf, (b.k - a.k) / (2 * h), scale);
	assert_near(k.kt, (d.k - c.k) / (2 * h), scale);
	assert_near(k.kff, (b.kf - a.kf) / (2 * h), scale * 100);
	assert_near(k.kft, (d.kf - c.kf) / (2 * h), scale * 100);
	assert_near(k.ktt, (d.kt - c.kt) / (2 * h), scale * 100);
}

static void test_boundary_derivatives_agree_with_differences(void **state)
{
	(void)state;
	for (double x = 0.0213; x < 1.0; x += 0.0317) {
		for (double T = 0.0171; T < 0.99; T += 0.0393) {
			compare_derivatives(boundary_union, x, T);
			compare_derivatives(boundary_intersection, x, T);
		}
	}
}

/* eta(0) = 2.6e-7 rather than 0 makes seams of that size. */
static void test_boundary_is_continuous_at_its_seams(void **state)
{
	(void)state;
	for (double T = 0.0; T <= 1.0; T += 0.05) {
		double seams[] = {T / 2, 0.5};

		for (int i = 0; i < 2; i++) {
			struct boundary_jet a, b;

			boundary_union(seams[i] - 1e-10, T, &a);
			boundary_union(seams[i] + 1e-10, T, &b);
			assert_near(a.k, b.k, 3e-7);
			boundary_intersection(seams[i] - 1e-10, T, &a);
			boundary_intersection(seams[i] + 1e-10, T, &b);
			assert_near(a.k, b.k, 3e-7);
		}
	}
}

static void test_boundary_limits(void **state)
{
	struct boundary_jet k;

	(void)state;
	boundary_union(0.3, 0.0, &k);
	assert_near(k.k, 0.0, 0.0);
	boundary_union(0.5, 1.0, &k);
	assert_near(k.k, 0.5, 0.0);
	boundary_union(7.0, 0.4, &k);
	assert_near(k.k, 0.2, 0.0);
	boundary_intersection(0.0, 0.4, &k);
	assert_near(k.k, 0.0, 1e-12);
	boundary_intersection(3.0, 0.4, &k);
	assert_near(k.k, 1.0, 1e-12);
}

int main(void)
{
	const struct CMUnitTest tests[] = {
		cmocka_unit_test(test_phi_golden),
		cmocka_unit_test(test_boundary_golden),
		cmocka_unit_test(test_phi_inverts_x_plus_eta),
		cmocka_unit_test(test_boundary_derivatives_agree_with_differences),
		cmocka_unit_test(test_boundary_is_continuous_at_its_seams),
		cmocka_unit_test(test_boundary_limits),
	};

	return cmocka_run_group_tests_name("boundary", tests, NULL, NULL);
}
