#include <math.h>
#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>
#include <stdio.h>

#include <cmocka.h>

#include "core/boundary.h"
#include "core/operator.h"
#include "tests/support/golden.h"
#include "tests/support/near.h"

#define QUARTER_PI 0.78539816339744830962

/* Angles that stand for the range, both ends included. */
static const double thetas[] = {0.0, 1e-9, 0.1, 0.3, 0.5, 0.7, 0.785,
    QUARTER_PI};
#define THETAS (sizeof(thetas) / sizeof(thetas[0]))

/* eta(0) = 2.6e-7 instead of 0 leaves seams of that height. */
#define SEAM 3e-7

static struct profile sampled(void)
{
	static const double xy[][2] = {{0, 1}, {0.3, 0.99}, {0.6, 0.9},
	    {0.8, 0.8}};
	struct profile p;
	const char *why;
	int index;

	assert_int_equal(profile_from_samples(xy, 4, &p, &why, &index), ERR_OK);
	return p;
}

struct kind {
	enum operator_family family;
	struct profile profile;
};

static int all_kinds(struct kind out[static 10])
{
	struct profile profiles[] = {profile_smooth(), profile_bulge(0.3),
	    profile_bulge(0.8), profile_circle(), sampled()};
	int n = 0;

	for (int f = 0; f < FAMILY_COUNT; f++)
		for (int i = 0; i < 5; i++)
			out[n++] = (struct kind){f, profiles[i]};
	return n;
}

static double value(const struct kind *k, double f1, double f2, double theta)
{
	struct operator_jet j;

	operator_eval(k->family, &k->profile, f1, f2, theta, 0, &j);
	return j.g;
}

/* Small deterministic numbers in [0, 1). */
static double draw(uint64_t *state)
{
	*state = *state * 6364136223846793005u + 1442695040888963407u;
	return (double)(*state >> 11) / 9007199254740992.0;
}

static void operator_row(void *ctx, const double *v)
{
	const struct kind *k = ctx;
	struct operator_jet j;

	operator_eval(k->family, &k->profile, v[0], v[1], v[2], 2, &j);
	assert_near(j.g, v[3], 1e-9);
	assert_near(j.g1, v[4], 1e-5);
	assert_near(j.g2, v[5], 1e-5);
	assert_near(j.gt, v[6], 1e-5);
}

static void test_operator_golden(void **state)
{
	static const char *const names[] = {"smooth", "bulge03", "bulge08",
	    "circle"};
	struct profile profiles[] = {profile_smooth(), profile_bulge(0.3),
	    profile_bulge(0.8), profile_circle()};

	(void)state;
	for (int f = 0; f < FAMILY_COUNT; f++) {
		for (int i = 0; i < 4; i++) {
			struct kind k = {f, profiles[i]};
			char name[64];

			snprintf(name, sizeof(name), "%s_%s",
			    operator_family_name(f), names[i]);
			assert_int_equal(golden_each(name, 7, operator_row, &k),
			    400);
		}
	}
}

/*
 * The root is a root: independently of the solver, the point drawn from C
 * lies on the silhouette to 1e-12 (of C; in y, that over C - k).
 */
static void test_operator_root_lies_on_the_silhouette(void **state)
{
	struct kind kinds[10];
	int n = all_kinds(kinds), inside = 0;
	uint64_t seed = 1;

	(void)state;
	for (int i = 0; i < 20000; i++) {
		const struct kind *k = &kinds[i % n];
		double a = draw(&seed), b = draw(&seed);
		double theta = draw(&seed) * QUARTER_PI;
		bool is_union = k->family == FAMILY_UNION;
		double near = is_union ? fmax(a, b) : fmin(a, b);
		double far = is_union ? fmin(a, b) : fmax(a, b), x, y, d;
		double C = value(k, a, b, theta);
		struct boundary_jet m;
		struct profile_jet curve;

		if (C == near)
			continue;
		if (is_union)
			boundary_union(C, tan(theta), &m);
		else
			boundary_intersection(C, tan(theta), &m);
		d = C - m.k;
		if (fabs(d) < 1e-6)
			continue;
		x = (far - m.k) / d;
		y = (near - m.k) / d;
		profile_eval(&k->profile, x, &curve);
		assert_near(y * d, curve.y * d, 1e-12);
		inside++;
	}
	assert_true(inside > 4000);
}

static void test_operator_of_one_field_is_that_field(void **state)
{
	struct kind kinds[10];
	int n = all_kinds(kinds);

	(void)state;
	for (int i = 0; i < n; i++) {
		for (double f = 0.0; f < 2.0; f += 0.0371) {
			for (size_t t = 0; t < THETAS; t++) {
				double want = kinds[i].family == FAMILY_UNION ? f : 0;

				assert_near(value(&kinds[i], f, 0, thetas[t]), want,
				    0.0);
				assert_near(value(&kinds[i], 0, f, thetas[t]), want,
				    0.0);
			}
		}
	}
}

static void test_operator_is_symmetric(void **state)
{
	struct kind kinds[10];
	int n = all_kinds(kinds);
	uint64_t seed = 2;

	(void)state;
	for (int i = 0; i < 5000; i++) {
		const struct kind *k = &kinds[i % n];
		double a = draw(&seed) * 1.3, b = draw(&seed) * 1.3;
		double theta = draw(&seed) * QUARTER_PI;
		struct operator_jet p, q;

		operator_eval(k->family, &k->profile, a, b, theta, 2, &p);
		operator_eval(k->family, &k->profile, b, a, theta, 2, &q);
		assert_near(p.g, q.g, 0.0);
		assert_near(p.g1, q.g2, 0.0);
		assert_near(p.g11, q.g22, 0.0);
		assert_near(p.g1t, q.g2t, 0.0);
		assert_near(p.gtt, q.gtt, 0.0);
	}
}

static void test_operator_smooth_is_monotone(void **state)
{
	(void)state;
	for (int f = 0; f < FAMILY_COUNT; f++) {
		struct kind k = {f, profile_smooth()};

		for (size_t t = 0; t < THETAS; t++) {
			for (double b = 0.01; b < 1.3; b += 0.0417) {
				double last = -1.0;

				for (double a = 0.0; a < 1.3; a += 0.0013) {
					double g = value(&k, a, b, thetas[t]);

					assert_true(g >= last - 1e-12);
					last = g;
				}
			}
		}
	}
}

/* The union is at least the maximum, the intersection at most the minimum. */
static void test_operator_keeps_its_side(void **state)
{
	struct kind kinds[10];
	int n = all_kinds(kinds);
	uint64_t seed = 3;

	(void)state;
	for (int i = 0; i < 20000; i++) {
		const struct kind *k = &kinds[i % n];
		double a = draw(&seed) * 1.5, b = draw(&seed) * 1.5;
		double g = value(k, a, b, draw(&seed) * QUARTER_PI);

		if (k->family == FAMILY_UNION)
			assert_true(g >= fmax(a, b) && g <= a + b + 1e-12);
		else
			assert_true(g <= fmin(a, b) && g >= 0.0);
	}
}

/* Both sides of a point in each variable, gap apart, agree to tolerance. */
static void check_continuous(const struct kind *k, double a, double b,
    double theta)
{
	const double gap = 1e-10;
	/* |dg/df| stays under 6 even on the fold of a bulge. */
	const double tolerance = SEAM + 12 * gap;
	double g = value(k, a, b, theta);

	assert_near(value(k, a + gap, b, theta), g, tolerance);
	assert_near(value(k, a, b + gap, theta), g, tolerance);
	assert_near(value(k, fmax(a - gap, 0), b, theta), g, tolerance);
	assert_near(value(k, a, fmax(b - gap, 0), theta), g, tolerance);
	assert_near(value(k, a, b, theta + gap), g, tolerance);
	assert_near(value(k, a, b, theta - gap), g, tolerance);
}

static void test_operator_is_continuous_across_the_boundary(void **state)
{
	struct kind kinds[10];
	int n = all_kinds(kinds);

	(void)state;
	for (int i = 0; i < n; i++) {
		for (size_t t = 0; t < THETAS; t++) {
			for (double f = 0.003; f < 1.0; f += 0.0173) {
				double T = tan(thetas[t]);
				struct boundary_jet m;

				if (kinds[i].family == FAMILY_UNION)
					boundary_union(f, T, &m);
				else
					boundary_intersection(f, T, &m);
				check_continuous(&kinds[i], f, m.k, thetas[t]);
			}
		}
	}
}

static void test_operator_is_continuous_at_one_half_and_above_one(void **state)
{
	static const double at[] = {0.5, 1.0};
	struct kind kinds[10];
	int n = all_kinds(kinds);

	(void)state;
	for (int i = 0; i < n; i++)
		for (size_t t = 0; t < THETAS; t++)
			for (int s = 0; s < 2; s++)
				for (double f = 0.0; f < 1.5; f += 0.0191)
					check_continuous(&kinds[i], at[s], f,
					    thetas[t]);
}

/* Along a ray from (0, 0) g rises through C = 1/2, found by bisection. */
static void test_operator_is_continuous_where_g_is_one_half(void **state)
{
	struct kind kinds[10];
	int n = all_kinds(kinds);

	(void)state;
	for (int i = 0; i < n; i++) {
		for (size_t t = 0; t < THETAS; t++) {
			for (double r = 0.05; r <= 1.0; r += 0.0475) {
				double low = 0.0, high = 20.0;

				while (high - low > 1e-14) {
					double s = 0.5 * (low + high);

					if (value(&kinds[i], s, r * s, thetas[t])
					    < 0.5)
						low = s;
					else
						high = s;
				}
				check_continuous(&kinds[i], low, r * low,
				    thetas[t]);
			}
		}
	}
}

/* theta = pi/4: sharp on the iso-surface. theta = 0: the silhouette itself. */
static void test_operator_limits_of_theta(void **state)
{
	struct kind kinds[10];
	int n = all_kinds(kinds);

	(void)state;
	for (int i = 0; i < n; i++) {
		for (double f = 0.0; f <= 0.5; f += 0.01) {
			bool is_union = kinds[i].family == FAMILY_UNION;
			double a = is_union ? 0.5 : 1 - f, b = is_union ? f : 0.5;

			assert_near(value(&kinds[i], a, b, QUARTER_PI), 0.5, 1e-12);
		}
	}
	for (double f = 0.1; f < 1.0; f += 0.1) {
		struct kind circle = {FAMILY_UNION, profile_circle()};

		assert_near(value(&circle, f, 0.3, 0.0), hypot(f, 0.3), 1e-12);
	}
}

/* Above 1/2 the union is homogeneous about (T/2, T/2), also above 1. */
static void test_union_closed_form_above_one(void **state)
{
	struct profile p = profile_circle();
	struct kind k = {FAMILY_UNION, p};

	(void)state;
	for (size_t t = 0; t < THETAS; t++) {
		double h = fmin(tan(thetas[t]), 1.0) / 2;

		for (double a = 0.6; a < 5.0; a += 0.3)
			for (double b = 0.6; b < 5.0; b += 0.3)
				assert_near(value(&k, a, b, thetas[t]),
				    h + hypot(a - h, b - h), 1e-12 * (a + b));
	}
}

static void compare_second(double got, double high, double low, double h,
    double scale)
{
	/* Central differences of first derivatives: truncation h^2 g''' with
	 * g''' up to (1 + |g''|)^2, and rounding 1e-11/h. */
	assert_near(got, (high - low) / (2 * h), 1e-4 * scale * scale);
}

static void test_operator_derivatives_agree_with_differences(void **state)
{
	const double h = 2e-6;
	struct kind kinds[10];
	int n = all_kinds(kinds), checked = 0;
	uint64_t seed = 4;

	(void)state;
	for (int i = 0; i < 20000; i++) {
		const struct kind *k = &kinds[i % n];
		double a = 0.02 + draw(&seed), b = 0.02 + draw(&seed);
		double t = 0.01 + draw(&seed) * 0.77, s;
		struct operator_jet j, p[6];

		for (int c = 0; c < 6; c++) {
			double step = c % 2 ? h : -h;

			operator_eval(k->family, &k->profile,
			    a + (c / 2 == 0) * step, b + (c / 2 == 1) * step,
			    t + (c / 2 == 2) * step, 1, &p[c]);
		}
		operator_eval(k->family, &k->profile, a, b, t, 2, &j);
		s = 1 + fabs(j.g11) + fabs(j.g12) + fabs(j.g22) + fabs(j.gtt);
		/* Not across folds, samples of a curve, or onto a branch's seam. */
		if (fabs(a - b) < 1e-3 || s > 300 ||
		    k->profile.type == PROFILE_SAMPLES ||
		    k->profile.type == PROFILE_CIRCLE)
			continue;
		assert_near(j.g1, (p[1].g - p[0].g) / (2 * h), 1e-6 * s);
		assert_near(j.g2, (p[3].g - p[2].g) / (2 * h), 1e-6 * s);
		assert_near(j.gt, (p[5].g - p[4].g) / (2 * h), 1e-6 * s);
		compare_second(j.g11, p[1].g1, p[0].g1, h, s);
		compare_second(j.g12, p[1].g2, p[0].g2, h, s);
		compare_second(j.g1t, p[1].gt, p[0].gt, h, s);
		compare_second(j.g22, p[3].g2, p[2].g2, h, s);
		compare_second(j.g2t, p[3].gt, p[2].gt, h, s);
		compare_second(j.gtt, p[5].gt, p[4].gt, h, s);
		checked++;
	}
	assert_true(checked > 8000);
}

static void test_operator_is_finite_everywhere(void **state)
{
	static const double odd[] = {0.0, 1e-300, 1e-30, 1e-12, 1e-7, 1e-3, 0.25,
	    0.5 - 1e-16, 0.5, 0.5 + 1e-16, 0.75, 1 - 1e-16, 1.0, 1 + 1e-15, 2.0,
	    1e3, 1e6};
	const int count = sizeof(odd) / sizeof(odd[0]);
	struct kind kinds[10];
	int n = all_kinds(kinds);

	(void)state;
	for (int i = 0; i < n * count * count * (int)THETAS; i++) {
		const struct kind *k = &kinds[i % n];
		struct operator_jet j;
		const double *all = &j.g;

		operator_eval(k->family, &k->profile, odd[i / n % count],
		    odd[i / n / count % count],
		    thetas[i / n / count / count], 2, &j);
		for (int c = 0; c < 10; c++)
			if (!isfinite(all[c]))
				fail_msg("quantity %d at (%g, %g, %g)", c,
				    odd[i / n % count],
				    odd[i / n / count % count],
				    thetas[i / n / count / count]);
	}
}

int main(void)
{
	const struct CMUnitTest tests[] = {
		cmocka_unit_test(test_operator_golden),
		cmocka_unit_test(test_operator_root_lies_on_the_silhouette),
		cmocka_unit_test(test_operator_of_one_field_is_that_field),
		cmocka_unit_test(test_operator_is_symmetric),
		cmocka_unit_test(test_operator_smooth_is_monotone),
		cmocka_unit_test(test_operator_keeps_its_side),
		cmocka_unit_test(test_operator_is_continuous_across_the_boundary),
		cmocka_unit_test(
		    test_operator_is_continuous_at_one_half_and_above_one),
		cmocka_unit_test(test_operator_is_continuous_where_g_is_one_half),
		cmocka_unit_test(test_operator_limits_of_theta),
		cmocka_unit_test(test_union_closed_form_above_one),
		cmocka_unit_test(test_operator_derivatives_agree_with_differences),
		cmocka_unit_test(test_operator_is_finite_everywhere),
	};

	return cmocka_run_group_tests_name("operator", tests, NULL, NULL);
}
