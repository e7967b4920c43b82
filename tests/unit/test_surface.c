#include <stdarg.h>
#include <stddef.h>
#include <setjmp.h>
#include <stdint.h>
#include <cmocka.h>

#include <float.h>
#include <math.h>

#include "core/primitive.h"
#include "core/surface.h"
#include "tests/support/near.h"
#include "tests/support/random_tree.h"

#define PI 3.14159265358979323846

static struct jet field(const struct primitive *p, struct vec3 x)
{
	double params[PRIMITIVE_PARAMS_MAX];
	struct jet f;

	primitive_prepare(p, params);
	primitive_eval(primitive_opcode(p->type), params, x, 2, &f);
	return f;
}

static void assert_curvature(const struct jet *f, double mean,
    double gaussian, double tolerance)
{
	double m, g;

	surface_curvature(f, &m, &g);
	assert_near(m, mean, tolerance);
	assert_near(g, gaussian, tolerance);
}

static struct vec3 random_unit(struct random_stream *r)
{
	for (;;) {
		struct vec3 v = vec3(random_in(r, -1.0, 1.0),
		    random_in(r, -1.0, 1.0), random_in(r, -1.0, 1.0));
		double norm = vec3_norm(v);

		if (norm > 0.1 && norm < 1.0)
			return vec3_scale(1.0 / norm, v);
	}
}

static void test_surface_normal_points_outwards(void **state)
{
	struct primitive sphere = {.type = PRIMITIVE_SPHERE,
	    .a = {1.0, 2.0, 3.0}, .radius = {0.7, 0.0}, .falloff = 0.3};
	struct random_stream r = {1};

	(void)state;
	for (int i = 0; i < 100; i++) {
		struct vec3 u = random_unit(&r), n;
		struct jet f = field(&sphere, vec3_axpy(0.75, u, sphere.a));

		n = surface_normal(&f);
		assert_near(vec3_norm(vec3_sub(n, u)), 0.0, 1e-14);
		assert_near(vec3_norm(n), 1.0, 4e-16);
	}
}

/* Of the level set through any point of the shell: a sphere of that radius,
 * whose curvature is positive. */
static void test_surface_of_a_sphere(void **state)
{
	struct primitive sphere = {.type = PRIMITIVE_SPHERE,
	    .radius = {0.7, 0.0}, .falloff = 0.3};
	struct primitive soft = {.type = PRIMITIVE_POINT, .radius = {0.7, 0.0},
	    .exponent = 3.0, .weight = 2.0};
	struct random_stream r = {2};

	(void)state;
	for (int i = 0; i < 100; i++) {
		double at = random_in(&r, 0.45, 0.95);
		struct vec3 x = vec3_scale(at, random_unit(&r));
		struct jet f = field(&sphere, x), g = field(&soft, x);

		/* measured: 1.2e-14 */
		assert_curvature(&f, 1.0 / at, 1.0 / (at * at), 1e-13);
		assert_curvature(&g, 1.0 / at, 1.0 / (at * at), 1e-13);
	}
}

static void test_surface_of_a_cylinder(void **state)
{
	struct primitive p = {.type = PRIMITIVE_CAPSULE,
	    .b = {3.0, 4.0, 0.0}, .radius = {0.5, 0.0}, .falloff = 0.2};
	/* 0.6 off the middle */
	struct jet f = field(&p, vec3(1.5, 2.0, 0.6));

	(void)state;
	assert_curvature(&f, 0.5 / 0.6, 0.0, 1e-14);
}

/* Curvatures 1/b of the tube and cos v/(a + b cos v) about the axis. */
static void test_surface_of_a_torus(void **state)
{
	const double a = 2.0, b = 0.5;
	struct primitive p = {.type = PRIMITIVE_TORUS,
	    .normal = {0.0, 0.0, 1.0}, .major = a, .minor = b, .falloff = 0.2};

	(void)state;
	for (int i = 0; i < 48; i++) {
		double v = i * PI / 24.0, u = 0.3 + i;
		double rho = a + b * cos(v), around = cos(v) / rho;
		struct jet f = field(&p, vec3(rho * cos(u), rho * sin(u),
		    b * sin(v)));

		/* measured: 3.6e-15 */
		assert_curvature(&f, 0.5 * (1.0 / b + around), around / b,
		    1e-13);
	}
}

/* f = z - x^2/2 + y^2/2 at 0, with the solid above: 1 and -1 cancel. */
static void test_surface_of_a_saddle(void **state)
{
	struct jet f = {.gradient = {0.0, 0.0, 1.0},
	    .hessian = {.xx = -1.0, .yy = 1.0}};

	(void)state;
	assert_curvature(&f, 0.0, -1.0, 1e-15);
	f.hessian.yy = 3.0;
	assert_curvature(&f, -1.0, -3.0, 1e-15);
	/* inside out: 1 - f */
	f.gradient.z = -1.0;
	f.hessian = sym3_scale(-1.0, f.hessian);
	assert_curvature(&f, 1.0, -3.0, 1e-15);
}

/* What a field does along its normal, and any factor, is nothing to its level
 * sets. */
static void test_surface_is_that_of_the_level_set_alone(void **state)
{
	struct random_stream r = {3};

	(void)state;
	for (int i = 0; i < 100; i++) {
		struct vec3 n = random_unit(&r), v = random_unit(&r);
		double c = random_in(&r, 0.1, 10.0), mean, gaussian;
		struct jet f = {.gradient = n, .hessian = sym3_axpy(2.0,
		    sym3_square(random_unit(&r)), sym3_square(v))};

		surface_curvature(&f, &mean, &gaussian);
		f.gradient = vec3_scale(c, f.gradient);
		/* c H + n w^T + w n^T, any w */
		f.hessian = sym3_axpy(5.0, sym3_product(n, random_unit(&r)),
		    sym3_scale(c, f.hessian));
		assert_curvature(&f, mean, gaussian, 1e-13);
	}
}

static void test_surface_of_a_null_gradient_is_nothing(void **state)
{
	struct jet f = {.value = 1.0, .hessian = {1.0, 2.0, 3.0, 4.0, 5.0, 6.0}};
	struct vec3 n = surface_normal(&f);

	(void)state;
	assert_true(n.x == 0.0 && n.y == 0.0 && n.z == 0.0);
	assert_curvature(&f, 0.0, 0.0, 0.0);
}

/* Lengths whose squares are beyond doubles. */
static void test_surface_at_any_scale(void **state)
{
	(void)state;
	for (double scale = 1e-140; scale < 2e140; scale *= 1e20) {
		struct jet f = {.gradient = {0.0, 3.0 / scale, 4.0 / scale},
		    .hessian = sym3_identity(-5.0 / scale / scale)};
		struct vec3 n = surface_normal(&f);
		double mean, gaussian;

		assert_near(n.y, -0.6, 1e-15);
		assert_near(n.z, -0.8, 1e-15);
		surface_curvature(&f, &mean, &gaussian);
		assert_near(mean * scale, 1.0, 1e-14);
		assert_near(gaussian * scale * scale, 1.0, 1e-14);
	}
}

static void test_surface_of_extreme_jets_is_finite(void **state)
{
	const double sizes[] = {0.0, 5e-324, 1e-300, 1.0, 1e300, DBL_MAX};

	(void)state;
	for (int i = 0; i < 36; i++)
		for (int side = -1; side <= 1; side += 2) {
			double g = sizes[i / 6], h = sizes[i % 6];
			struct jet f = {.gradient = {g, -g, side * g},
			    .hessian = {h, -h, side * h, h, h, -h}};
			struct vec3 n = surface_normal(&f);
			double mean, gaussian;

			surface_curvature(&f, &mean, &gaussian);
			assert_true(isfinite(mean) && isfinite(gaussian));
			assert_near(vec3_norm(n), g > 0.0 ? 1.0 : 0.0, 1e-15);
		}
}

int main(void)
{
	const struct CMUnitTest tests[] = {
		cmocka_unit_test(test_surface_normal_points_outwards),
		cmocka_unit_test(test_surface_of_a_sphere),
		cmocka_unit_test(test_surface_of_a_cylinder),
		cmocka_unit_test(test_surface_of_a_torus),
		cmocka_unit_test(test_surface_of_a_saddle),
		cmocka_unit_test(test_surface_is_that_of_the_level_set_alone),
		cmocka_unit_test(test_surface_of_a_null_gradient_is_nothing),
		cmocka_unit_test(test_surface_at_any_scale),
		cmocka_unit_test(test_surface_of_extreme_jets_is_finite),
	};

	return cmocka_run_group_tests_name("surface", tests, NULL, NULL);
}
