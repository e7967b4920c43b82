/*
 * Convolution surfaces with the Cauchy kernel against adaptive quadrature of
 * the kernel and its derivatives, and degenerate, tiny, huge and far elements.
 */
#include <float.h>
#include <math.h>
#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>
#include <stdio.h>

#include <cmocka.h>

#include "core/convolution.h"
#include "core/primitive.h"
#include "tests/support/near.h"
#include "tests/support/random_tree.h"

#define PI 3.14159265358979323846

/* value, gradient, Hessian */
#define PARTS 10

/*
 * Adaptive quadrature after Gauss and Kronrod (7, 15 nodes) of PARTS functions
 * at once.
 */
struct integrand {
	void (*at)(const struct integrand *f, double t, double out[PARTS]);
	const struct primitive *p;
	struct vec3 x;
	double across; /* a triangle's outer variable */
};

static const double kronrod_x[8] = {
	0.99145537112081263, 0.94910791234275852,
	0.86486442335976907, 0.74153118559939443,
	0.58608723546769113, 0.40584515137739716,
	0.20778495500789846, 0.0};
static const double kronrod_w[8] = {
	0.02293532201052922, 0.06309209262997855,
	0.10479001032225018, 0.14065325971552591,
	0.16900472663926790, 0.19035057806478540,
	0.20443294007529889, 0.20948214108472782};
static const double gauss_w[4] = {
	0.12948496616886969, 0.27970539148927666,
	0.38183005050511894, 0.41795918367346938};

/*
 * The largest difference of value, gradient and Hessian, each relative to its
 * size; a gradient counts as at least 1e-6 of s times the value, since between
 * the ends it is what is left of two sides.
 */
static double part_error(const double a[PARTS], const double b[PARTS], double s)
{
	static const int first[] = {0, 1, 4, PARTS};
	double most = 0.0;

	for (int group = 0; group < 3; group++) {
		double off = 0.0, size = group == 1 ? 1e-6 * s * a[0] : 0.0;

		for (int i = first[group]; i < first[group + 1]; i++) {
			off += fabs(a[i] - b[i]);
			size += fabs(a[i]);
		}
		most = off > most * size ? off / size : most;
	}
	return most;
}

static void rule(const struct integrand *f, double a, double b,
    double kronrod[PARTS], double gauss[PARTS])
{
	double half = (b - a) / 2.0, middle = (a + b) / 2.0, at[PARTS];

	for (int i = 0; i < PARTS; i++)
		kronrod[i] = gauss[i] = 0.0;
	for (int k = 0; k < 15; k++) {
		int node = k < 8 ? k : 14 - k;
		double x = k < 8 ? -kronrod_x[node] : kronrod_x[node];

		f->at(f, middle + half * x, at);
		for (int i = 0; i < PARTS; i++) {
			kronrod[i] += half * kronrod_w[node] * at[i];
			if (node % 2 == 1)
				gauss[i] += half * gauss_w[node / 2] * at[i];
		}
	}
}

/* tolerance: of each group of parts, relative to whole, what all is about. */
static void refine(const struct integrand *f, double a, double b,
    double tolerance, const double whole[3], int depth, double out[PARTS])
{
	double kronrod[PARTS], gauss[PARTS], off[3] = {0.0, 0.0, 0.0};

	rule(f, a, b, kronrod, gauss);
	for (int i = 0; i < PARTS; i++)
		off[i == 0 ? 0 : i < 4 ? 1 : 2] += fabs(kronrod[i] - gauss[i]);
	if (depth == 0 || (off[0] <= tolerance * whole[0] &&
	    off[1] <= tolerance * whole[1] && off[2] <= tolerance * whole[2])) {
		for (int i = 0; i < PARTS; i++)
			out[i] += kronrod[i];
		return;
	}
	refine(f, a, (a + b) / 2.0, tolerance, whole, depth - 1, out);
	refine(f, (a + b) / 2.0, b, tolerance, whole, depth - 1, out);
}

/* No peak is so narrow that all nodes of as many pieces miss it. */
#define PIECES 8

static void integrate(const struct integrand *f, double tolerance,
    double out[PARTS])
{
	/* About how large each group is. */
	double whole[3] = {0.0, 0.0, 0.0};

	for (int k = 0; k < PIECES; k++) {
		double kronrod[PARTS], gauss[PARTS];

		rule(f, (double)k / PIECES, (k + 1.0) / PIECES, kronrod, gauss);
		for (int i = 0; i < PARTS; i++)
			whole[i == 0 ? 0 : i < 4 ? 1 : 2] += fabs(kronrod[i]);
	}
	for (int i = 0; i < PARTS; i++)
		out[i] = 0.0;
	for (int k = 0; k < PIECES; k++)
		refine(f, (double)k / PIECES, (k + 1.0) / PIECES, tolerance,
		    whole, 40, out);
}

/* The kernel's jet at x for its centre q, times weight. */
static void kernel(double s, struct vec3 x, struct vec3 q, double weight,
    double out[PARTS])
{
	struct vec3 e = vec3_sub(x, q);
	double s2 = s * s, b = 1.0 / (1.0 + s2 * vec3_dot(e, e));
	double g = -4.0 * s2 * b * b * b * weight;
	double h = 24.0 * s2 * s2 * b * b * b * b * weight;

	out[0] = weight * b * b;
	out[1] = g * e.x;
	out[2] = g * e.y;
	out[3] = g * e.z;
	out[4] = g + h * e.x * e.x;
	out[5] = g + h * e.y * e.y;
	out[6] = g + h * e.z * e.z;
	out[7] = h * e.x * e.y;
	out[8] = h * e.x * e.z;
	out[9] = h * e.y * e.z;
}

static void on_segment(const struct integrand *f, double t, double out[PARTS])
{
	struct vec3 ab = vec3_sub(f->p->b, f->p->a);

	kernel(f->p->s, f->x, vec3_axpy(t, ab, f->p->a), vec3_norm(ab), out);
}

/* A triangle as a fan from a: t across it towards bc, then along bc. */
static void on_strip(const struct integrand *f, double t, double out[PARTS])
{
	struct vec3 ab = vec3_sub(f->p->b, f->p->a);
	struct vec3 bc = vec3_sub(f->p->c, f->p->b);
	double area = vec3_norm(vec3_cross(ab, bc));
	struct vec3 q = vec3_axpy(f->across, vec3_axpy(t, bc, ab), f->p->a);

	kernel(f->p->s, f->x, q, area * f->across, out);
}

#define REFERENCE 1e-11

static void on_triangle(const struct integrand *f, double t, double out[PARTS])
{
	struct integrand strip = *f;

	strip.at = on_strip;
	strip.across = t;
	integrate(&strip, REFERENCE, out);
}

static void reference(const struct primitive *p, struct vec3 x,
    double out[PARTS])
{
	struct integrand f = {.p = p, .x = x};
	double q = 1.0 + p->s * p->s * p->radius[0] * p->radius[0];
	double scale = p->weight * p->s * q * sqrt(q) / PI;

	if (p->type == PRIMITIVE_CAUCHY_POINT) {
		kernel(p->s, x, p->a, 1.0, out);
	} else {
		f.at = p->type == PRIMITIVE_CAUCHY_SEGMENT ? on_segment :
		    on_triangle;
		integrate(&f, REFERENCE, out);
	}
	for (int i = 0; i < PARTS; i++)
		out[i] *= scale;
}

static void field(const struct primitive *p, struct vec3 x, int order,
    double out[PARTS])
{
	double params[PRIMITIVE_PARAMS_MAX];
	struct jet j;

	assert_in_range(primitive_prepare(p, params), 1, PRIMITIVE_PARAMS_MAX);
	primitive_eval(primitive_opcode(p->type), params, x, order, &j);
	out[0] = j.value;
	out[1] = j.gradient.x;
	out[2] = j.gradient.y;
	out[3] = j.gradient.z;
	out[4] = j.hessian.xx;
	out[5] = j.hessian.yy;
	out[6] = j.hessian.zz;
	out[7] = j.hessian.xy;
	out[8] = j.hessian.xz;
	out[9] = j.hessian.yz;
}

static struct primitive element(enum primitive_type type, struct vec3 a,
    struct vec3 b, struct vec3 c)
{
	struct primitive p = {.type = type, .a = a, .b = b, .c = c,
	    .radius = {0.7}, .weight = 1.3};

	p.s = cauchy_default_s(p.radius[0]);
	return p;
}

static struct primitive segment(struct vec3 a, struct vec3 b)
{
	return element(PRIMITIVE_CAUCHY_SEGMENT, a, b, a);
}

static struct primitive triangle(struct vec3 a, struct vec3 b, struct vec3 c)
{
	return element(PRIMITIVE_CAUCHY_TRIANGLE, a, b, c);
}

/* The largest error of value, gradient and Hessian, each by its own size. */
static double error_at(const struct primitive *p, struct vec3 x)
{
	double want[PARTS], got[PARTS];

	reference(p, x, want);
	field(p, x, 2, got);
	return part_error(want, got, p->s);
}

static double worst;

static void check(const struct primitive *p, double x, double y, double z,
    double tolerance)
{
	double off = error_at(p, vec3(x, y, z));

	if (!(off <= tolerance))
		printf("off by %.2e at %g %g %g\n", off, x, y, z);
	worst = off > worst ? off : worst;
	assert_true(off <= tolerance);
}

static struct vec3 random_vec3(struct random_stream *r, double size)
{
	double x = random_in(r, -size, size), y = random_in(r, -size, size);

	return vec3(x, y, random_in(r, -size, size));
}

static void test_cauchy_default_s_halves_the_endless_segment(void **state)
{
	struct primitive p = segment(vec3(-1e7, 0.0, 0.0), vec3(1e7, 0.0, 0.0));
	double f[PARTS];

	(void)state;
	p.weight = 1.0;
	field(&p, vec3(0.0, 0.7, 0.0), 0, f);
	assert_near(f[0], 0.5, 1e-14);
	/* F0 s = pi/4 */
	assert_near(1.0 + p.s * p.s * 0.7 * 0.7, cbrt(4.0), 1e-15);
	p.s = 4.0;
	field(&p, vec3(0.0, 0.0, -0.7), 0, f);
	assert_near(f[0], 0.5, 1e-14);
}

static void test_cauchy_point_is_the_kernel(void **state)
{
	struct primitive p = element(PRIMITIVE_CAUCHY_POINT,
	    vec3(0.3, -1.0, 2.0), vec3(0, 0, 0), vec3(0, 0, 0));
	struct random_stream r = {1};

	(void)state;
	check(&p, 0.3, -1.0, 2.0, 1e-14);
	for (int i = 0; i < 100; i++) {
		struct vec3 x = random_vec3(&r, i < 50 ? 3.0 : 1e4);

		check(&p, x.x, x.y, x.z, 1e-14);
	}
}

static void test_cauchy_segment_is_its_integral(void **state)
{
	struct random_stream r = {2};

	(void)state;
	worst = 0.0;
	for (int i = 0; i < 400; i++) {
		double size = pow(10.0, random_in(&r, -4.0, 1.5));
		double away = pow(10.0, random_in(&r, -1.0, 3.0));
		struct primitive p = segment(random_vec3(&r, size),
		    random_vec3(&r, size));
		struct vec3 x = random_vec3(&r, away);

		check(&p, x.x, x.y, x.z, 1e-12); /* 4e-15 */
	}
	printf("measured: segments within %.1e\n", worst);
}

/* On it, at its ends, on its line beyond both, above its middle, and all along
 * from on the line to far above it. */
static void test_cauchy_segment_at_special_points(void **state)
{
	static const double length[] = {1e-6, 0.1, 2.0, 40.0};
	static const double along[] = {-1e4, -30.0, -2.0, -0.1, 0.0, 0.3, 0.5,
		1.0, 1.2, 8.0, 1e3};
	static const double above[] = {0.0, 1e-9, 1e-3, 1.0, 20.0, 3e3};

	(void)state;
	worst = 0.0;
	for (int i = 0; i < 4; i++)
		for (int j = 0; j < 11; j++)
			for (int k = 0; k < 6; k++) {
				struct primitive p = segment(vec3(1, 2, 3),
				    vec3(1.0 + length[i], 2, 3));

				/* 3e-10: coordinates of the shortest are
				 * rounded by as much of its length */
				check(&p, 1.0 + along[j] * length[i], 2.0,
				    3.0 + above[k], 1e-9);
			}
	printf("measured: segments within %.1e\n", worst);
}

static void test_cauchy_triangle_is_its_integral(void **state)
{
	struct random_stream r = {3};

	(void)state;
	worst = 0.0;
	for (int i = 0; i < 150; i++) {
		double size = pow(10.0, random_in(&r, -4.0, 1.0));
		double away = pow(10.0, random_in(&r, -1.0, 2.5));
		struct primitive p = triangle(random_vec3(&r, size),
		    random_vec3(&r, size), random_vec3(&r, size));
		struct vec3 x = random_vec3(&r, away);

		check(&p, x.x, x.y, x.z, 1e-11); /* 5e-15 */
	}
	printf("measured: triangles within %.1e\n", worst);
}

/* Points about a triangle's plane at x, y, from within to far above it. */
static void check_above(const struct primitive *p, double x, double y,
    double tolerance)
{
	static const double above[] = {0.0, 1e-12, 1e-4, 0.3, -2.0, 30.0, 2e3};

	for (size_t i = 0; i < sizeof(above) / sizeof(above[0]); i++)
		check(p, x, y, above[i], tolerance);
}

/* Inside, on sides and their lines, on and beyond corners, near and far. */
static void check_places(const struct primitive *p, double tolerance)
{
	static const double share[][2] = {{0.3, 0.3}, {0.5, 0.0}, {0.0, 0.2},
		{0.6, 0.4}, {0.0, 0.0}, {1.0, 0.0}, {0.0, 1.0}, {-0.5, 0.0},
		{3.0, 0.0}, {0.0, -7.0}, {2.0, -1.0}, {0.4, 1.5}, {0.4, -0.01},
		{300.0, 100.0}, {0.5, -2000.0}};

	for (size_t i = 0; i < sizeof(share) / sizeof(share[0]); i++) {
		struct vec3 ab = vec3_sub(p->b, p->a);
		struct vec3 ac = vec3_sub(p->c, p->a);
		struct vec3 x = vec3_axpy(share[i][0], ab,
		    vec3_axpy(share[i][1], ac, p->a));

		check_above(p, x.x, x.y, tolerance);
	}
}

static void test_cauchy_triangle_at_special_points(void **state)
{
	static const double size[] = {1e-4, 0.3, 2.0, 30.0};

	(void)state;
	worst = 0.0;
	for (int i = 0; i < 4; i++) {
		double h = size[i];
		struct primitive p = triangle(vec3(0, 0, 0), vec3(h, 0, 0),
		    vec3(0.2 * h, 0.8 * h, 0));

		check_places(&p, 1e-10); /* 4e-13 */
	}
	printf("measured: triangles within %.1e\n", worst);
}

static void test_cauchy_triangle_slivers(void **state)
{
	static const double height[] = {1e-9, 1e-5, 1e-2, 0.1, 0.5};
	static const double foot[] = {-2.0, 0.0, 0.01, 2.5, 5.0, 6.0};

	(void)state;
	worst = 0.0;
	for (int i = 0; i < 5; i++)
		for (int k = 0; k < 6; k++) {
			struct primitive p = triangle(vec3(0, 0, 0),
			    vec3(5, 0, 0), vec3(foot[k], height[i], 0));

			/* 9e-11 */
			check(&p, 2.5, height[i] / 3.0, 0.0, 1e-9);
			check(&p, foot[k], 0.3, 0.2, 1e-9);
			check(&p, -1.0, 0.0, 0.0, 1e-9);
			check(&p, 30.0, -1.0, 2.0, 1e-9);
			check(&p, 1.0, 200.0, -100.0, 1e-9);
		}
	printf("measured: slivers within %.1e\n", worst);
}

/* Points a billionth apart, from the triangle outwards through every change of
 * the way it is integrated: the field has no step. */
static void test_cauchy_triangle_ways_meet(void **state)
{
	struct primitive p = triangle(vec3(0, 0, 0), vec3(8, 0, 0),
	    vec3(2, 6, 0));
	double before[PARTS], after[PARTS];

	(void)state;
	worst = 0.0;
	for (int i = 1; i < 40000; i++) {
		double t = i * 1e-3;

		field(&p, vec3(2.0, -t, t * 0.5), 2, before);
		field(&p, vec3(2.0, -t * (1.0 + 1e-9), t * 0.5), 2, after);
		worst = fmax(worst, part_error(before, after, p.s));
	}
	printf("measured: steps of %.1e\n", worst);
	assert_true(worst <= 1e-7); /* 5e-9, the field's own change */
}

static void check_zero(const struct primitive *p, struct vec3 x)
{
	double f[PARTS];

	field(p, x, 2, f);
	for (int i = 0; i < PARTS; i++)
		assert_true(f[i] == 0.0);
}

static void test_cauchy_degenerate_elements_are_zero(void **state)
{
	struct vec3 a = vec3(0.1, 0.2, 0.3), b = vec3(1.1, 0.2, 0.3);
	struct primitive none = segment(a, a), spot = triangle(a, a, a);
	struct primitive line = triangle(a, b, vec3(0.6, 0.2, 0.3));
	struct primitive twice = triangle(a, b, b);

	(void)state;
	check_zero(&none, a);
	check_zero(&none, b);
	check_zero(&spot, a);
	check_zero(&spot, b);
	check_zero(&line, a);
	check_zero(&line, vec3(0.6, 0.3, 0.3));
	check_zero(&twice, b);
	check_zero(&twice, vec3(9.0, 0.3, 0.3));
}

/* A triangle's field goes to 0 with its height, as height. */
static void test_cauchy_triangle_goes_to_zero_with_its_area(void **state)
{
	double f[PARTS], before = 0.0;

	(void)state;
	for (double h = 1e-3; h > 1e-14; h *= 0.1) {
		struct primitive p = triangle(vec3(0, 0, 0), vec3(4, 0, 0),
		    vec3(3, h, 0));

		field(&p, vec3(2.0, 0.5, 0.1), 0, f);
		if (before > 0.0)
			assert_near(f[0] / before, 0.1, 1e-4);
		before = f[0];
	}
	assert_true(before > 0.0);
}

/* Corners, in any order and either way round, make the same triangle. */
static void test_cauchy_triangle_does_not_care_for_order(void **state)
{
	struct vec3 a = vec3(0, 0.1, 0), b = vec3(2, 0, 1), c = vec3(1, 1, -1);
	struct primitive p[] = {triangle(a, b, c), triangle(b, c, a),
		triangle(c, a, b), triangle(b, a, c), triangle(a, c, b)};
	struct vec3 x = vec3(0.7, -0.4, 0.9);
	double f[PARTS], g[PARTS];

	(void)state;
	field(p, x, 2, f);
	for (int i = 1; i < 5; i++) {
		field(p + i, x, 2, g);
		for (int k = 0; k < PARTS; k++)
			assert_near(g[k], f[k], 1e-13);
	}
}

static void test_cauchy_orders_leave_the_rest_zero(void **state)
{
	struct primitive p = triangle(vec3(0, 0, 0), vec3(1, 0, 0),
	    vec3(0, 1, 0));

	(void)state;
	for (int order = 0; order <= 2; order++) {
		double all[PARTS], f[PARTS];

		field(&p, vec3(0.4, 0.2, 0.3), 2, all);
		field(&p, vec3(0.4, 0.2, 0.3), order, f);
		for (int i = 0; i < PARTS; i++)
			assert_true(f[i] == (i < (order == 0 ? 1 :
			    order == 1 ? 4 : PARTS) ? all[i] : 0.0));
	}
}

static struct primitive extreme_element(struct random_stream *r)
{
	static const double sizes[] = {0.0, 1e-9, 1e-3, 1.0, 1e5, 1e9};
	struct primitive p = element(PRIMITIVE_CAUCHY_POINT +
	    (enum primitive_type)random_below(r, 3),
	    random_vec3(r, sizes[random_below(r, 6)]),
	    random_vec3(r, sizes[random_below(r, 6)]),
	    random_vec3(r, sizes[random_below(r, 6)]));

	p.radius[0] = pow(10.0, random_in(r, -9.0, 9.0));
	p.s = pow(10.0, random_in(r, -2.0, 2.0)) / p.radius[0];
	p.s = p.s > 1e9 ? 1e9 : p.s < 1e-9 ? 1e-9 : p.s;
	p.weight = 1e6;
	if (random_below(r, 3) == 0)
		p.b = p.a;
	if (random_below(r, 3) == 0)
		p.c = random_below(r, 2) ? p.b : p.a;
	return p;
}

static void test_cauchy_is_finite_everywhere(void **state)
{
	static const double away[] = {0.0, 1e-12, 1e-3, 1.0, 1e4, 1e9, 1e12};
	struct random_stream r = {4};

	(void)state;
	for (int i = 0; i < 20000; i++) {
		struct primitive p = extreme_element(&r);
		struct vec3 x = random_vec3(&r, away[random_below(&r, 7)]);
		double f[PARTS];

		if (random_below(&r, 2))
			x = vec3_axpy(random_in(&r, 0.0, 1.0),
			    vec3_sub(p.b, p.a), p.a);
		field(&p, x, 2, f);
		for (int k = 0; k < PARTS; k++)
			assert_true(isfinite(f[k]));
		assert_true(f[0] >= 0.0);
	}
}

static void test_cauchy_far_values_go_to_zero(void **state)
{
	struct primitive t = triangle(vec3(0, 0, 0), vec3(1, 0, 0),
	    vec3(0, 1, 0));
	struct primitive s = segment(vec3(0, 0, 0), vec3(1, 0, 0));
	double q = cbrt(4.0), scale = t.weight * t.s * q * sqrt(q) / PI;
	double f[PARTS];

	(void)state;
	field(&t, vec3(0.0, 1e12, 0.0), 2, f);
	/* area and length times (s 1e12)^-4 */
	assert_near(f[0] * 1e48 * pow(t.s, 4.0) / scale, 0.5, 1e-11);
	field(&s, vec3(1e12, 0.0, 0.0), 2, f);
	assert_near(f[0] * 1e48 * pow(s.s, 4.0) / scale, 1.0, 1e-11);
}

static void test_cauchy_size_is_the_kernels_width(void **state)
{
	struct primitive p = segment(vec3(0, 0, 0), vec3(1, 0, 0));

	(void)state;
	p.s = 8.0;
	assert_near(primitive_size(&p), 0.125, 1e-15);
}

int main(void)
{
	const struct CMUnitTest tests[] = {
		cmocka_unit_test(
		    test_cauchy_default_s_halves_the_endless_segment),
		cmocka_unit_test(test_cauchy_point_is_the_kernel),
		cmocka_unit_test(test_cauchy_segment_is_its_integral),
		cmocka_unit_test(test_cauchy_segment_at_special_points),
		cmocka_unit_test(test_cauchy_triangle_is_its_integral),
		cmocka_unit_test(test_cauchy_triangle_at_special_points),
		cmocka_unit_test(test_cauchy_triangle_slivers),
		cmocka_unit_test(test_cauchy_triangle_ways_meet),
		cmocka_unit_test(test_cauchy_degenerate_elements_are_zero),
		cmocka_unit_test(
		    test_cauchy_triangle_goes_to_zero_with_its_area),
		cmocka_unit_test(test_cauchy_triangle_does_not_care_for_order),
		cmocka_unit_test(test_cauchy_orders_leave_the_rest_zero),
		cmocka_unit_test(test_cauchy_is_finite_everywhere),
		cmocka_unit_test(test_cauchy_far_values_go_to_zero),
		cmocka_unit_test(test_cauchy_size_is_the_kernels_width),
	};

	return cmocka_run_group_tests(tests, NULL, NULL);
}
