#include <float.h>
#include <math.h>
#include <setjmp.h>
#include <stdarg.h>
#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>
#include <stdlib.h>

#include <cmocka.h>

#include "core/affine.h"
#include "core/primitive.h"

static double uniform(double least, double most)
{
	return least + (most - least) * drand48();
}

/* Evenly over the orders of magnitude. */
static double magnitude(double least, double most)
{
	return exp(uniform(log(least), log(most)));
}

static struct vec3 random_vector(double most)
{
	return vec3(uniform(-most, most), uniform(-most, most),
	    uniform(-most, most));
}

/* cmocka's own assertion compares as float. */
static void assert_near(const char *what, double value, double expected,
    double tolerance)
{
	if (!(fabs(value - expected) <= tolerance))
		fail_msg("%s: %.17g, not %.17g, beyond %g", what, value,
		    expected, tolerance);
}

static void assert_vec3(const char *what, struct vec3 value,
    struct vec3 expected, double tolerance)
{
	assert_near(what, value.x, expected.x, tolerance);
	assert_near(what, value.y, expected.y, tolerance);
	assert_near(what, value.z, expected.z, tolerance);
}

static struct jet eval(const struct primitive *p, struct vec3 x, int order)
{
	double params[PRIMITIVE_PARAMS_MAX];
	struct jet out;

	primitive_prepare(p, params);
	primitive_eval(primitive_opcode(p->type), params, x, order, &out);
	return out;
}

static double value(const struct primitive *p, struct vec3 x)
{
	return eval(p, x, 0).value;
}

static bool is_flat(const struct jet *j)
{
	const struct vec3 g = j->gradient;
	const struct sym3 h = j->hessian;

	return g.x == 0.0 && g.y == 0.0 && g.z == 0.0 && h.xx == 0.0 &&
	    h.yy == 0.0 && h.zz == 0.0 && h.xy == 0.0 && h.xz == 0.0 &&
	    h.yz == 0.0;
}

static bool is_finite(const struct jet *j)
{
	const struct vec3 g = j->gradient;
	const struct sym3 h = j->hessian;

	return isfinite(j->value) && isfinite(g.x) && isfinite(g.y) &&
	    isfinite(g.z) && isfinite(h.xx) && isfinite(h.yy) &&
	    isfinite(h.zz) && isfinite(h.xy) && isfinite(h.xz) &&
	    isfinite(h.yz);
}

static double largest(const struct sym3 *h)
{
	return fmax(fmax(fmax(fabs(h->xx), fabs(h->yy)), fabs(h->zz)),
	    fmax(fmax(fabs(h->xy), fabs(h->xz)), fabs(h->yz)));
}

/* Soft objects and solids; the elements of convolutions, and volumes, have
 * tests of their own. */
#define SHAPE_COUNT PRIMITIVE_CAUCHY_POINT

/* One of each, by the origin. */
static const struct primitive sample[SHAPE_COUNT] = {
	[PRIMITIVE_POINT] = {.type = PRIMITIVE_POINT, .radius = {0.5},
	    .exponent = 3.0, .weight = 1.0},
	[PRIMITIVE_SEGMENT] = {.type = PRIMITIVE_SEGMENT, .b = {0.0, 0.0, 1.0},
	    .radius = {0.5, 0.8}, .exponent = 3.0, .weight = 1.5},
	[PRIMITIVE_TRIANGLE] = {.type = PRIMITIVE_TRIANGLE,
	    .b = {1.0, 0.0, 0.0}, .c = {0.0, 1.0, 0.0}, .radius = {0.5},
	    .exponent = 4.0, .weight = 1.0},
	[PRIMITIVE_DISC] = {.type = PRIMITIVE_DISC, .normal = {0.0, 0.0, 2.0},
	    .major = 0.6, .radius = {0.4}, .exponent = 3.0, .weight = 0.7},
	[PRIMITIVE_CIRCLE] = {.type = PRIMITIVE_CIRCLE,
	    .normal = {0.0, 0.0, 1.0}, .major = 0.6, .radius = {0.3},
	    .exponent = 3.5, .weight = 1.0},
	[PRIMITIVE_SPHERE] = {.type = PRIMITIVE_SPHERE, .radius = {0.6},
	    .falloff = 0.5},
	[PRIMITIVE_BOX] = {.type = PRIMITIVE_BOX, .half_size = {0.5, 0.6, 0.7},
	    .rounding = 0.1, .falloff = 0.4},
	[PRIMITIVE_CYLINDER] = {.type = PRIMITIVE_CYLINDER,
	    .a = {0.0, 0.0, -0.5}, .b = {0.0, 0.0, 0.5}, .radius = {0.5},
	    .falloff = 0.4},
	[PRIMITIVE_CAPSULE] = {.type = PRIMITIVE_CAPSULE,
	    .b = {0.0, 0.0, 1.0}, .radius = {0.4}, .falloff = 0.5},
	[PRIMITIVE_CONE] = {.type = PRIMITIVE_CONE, .b = {0.0, 0.0, 0.8},
	    .radius = {0.8, 0.2}, .falloff = 0.3},
	[PRIMITIVE_TORUS] = {.type = PRIMITIVE_TORUS,
	    .normal = {0.0, 0.0, 1.0}, .major = 0.7, .minor = 0.25,
	    .falloff = 0.2},
	[PRIMITIVE_PLANE] = {.type = PRIMITIVE_PLANE,
	    .normal = {0.0, 0.0, 3.0}, .falloff = 0.5},
};

/*
 * A place in every region that a formula has a case for, at least 0.03 from
 * the next. distance: to the skeleton, or signed to the solid. radius: where a
 * soft object's value is half its weight.
 */
static const struct spot {
	enum primitive_type type;
	const char *region;
	struct vec3 at;
	double distance, radius;
} spots[] = {
	{PRIMITIVE_POINT, "point", {0.3, 0.0, 0.4}, 0.5, 0.5},
	{PRIMITIVE_SEGMENT, "segment, side", {0.3, 0.4, 0.4}, 0.5, 0.62},
	{PRIMITIVE_SEGMENT, "segment, start", {0.0, 0.3, -0.4}, 0.5, 0.5},
	{PRIMITIVE_SEGMENT, "segment, end", {0.6, 0.0, 1.8}, 1.0, 0.8},
	{PRIMITIVE_TRIANGLE, "triangle, face", {0.2, 0.3, -0.4}, 0.4, 0.5},
	{PRIMITIVE_TRIANGLE, "triangle, ab", {0.5, -0.3, 0.4}, 0.5, 0.5},
	{PRIMITIVE_TRIANGLE, "triangle, bc", {0.8, 0.8, 0.0},
	    0.42426406871192851, 0.5},
	{PRIMITIVE_TRIANGLE, "triangle, ca", {-0.3, 0.5, 0.4}, 0.5, 0.5},
	{PRIMITIVE_TRIANGLE, "triangle, a", {-0.2, -0.3, 0.6}, 0.7, 0.5},
	{PRIMITIVE_TRIANGLE, "triangle, b", {1.6, -0.2, 0.3}, 0.7, 0.5},
	{PRIMITIVE_TRIANGLE, "triangle, c", {-0.3, 1.2, 0.6}, 0.7, 0.5},
	{PRIMITIVE_DISC, "disc, face", {0.2, 0.1, -0.3}, 0.3, 0.4},
	{PRIMITIVE_DISC, "disc, rim", {0.0, -0.9, 0.4}, 0.5, 0.4},
	{PRIMITIVE_CIRCLE, "circle, within", {0.2, 0.0, 0.3}, 0.5, 0.3},
	{PRIMITIVE_CIRCLE, "circle, without", {0.72, 0.96, 0.1},
	    0.60827625302982191, 0.3},
	{PRIMITIVE_SPHERE, "sphere, in", {0.0, 0.3, 0.0}, -0.3, 0.0},
	{PRIMITIVE_SPHERE, "sphere, out", {0.2, 0.3, 0.6}, 0.1, 0.0},
	{PRIMITIVE_BOX, "box, in, x", {-0.45, 0.0, 0.1}, -0.05, 0.0},
	{PRIMITIVE_BOX, "box, in, y", {0.1, 0.5, -0.1}, -0.1, 0.0},
	{PRIMITIVE_BOX, "box, in, z", {0.1, 0.1, -0.55}, -0.15, 0.0},
	{PRIMITIVE_BOX, "box, face", {0.1, 0.2, 0.8}, 0.1, 0.0},
	{PRIMITIVE_BOX, "box, edge", {0.7, -0.1, -1.0}, 0.4, 0.0},
	{PRIMITIVE_BOX, "box, corner", {0.5, -0.7, 0.8}, 0.2, 0.0},
	{PRIMITIVE_CYLINDER, "cylinder, in, side", {0.3, 0.0, 0.1}, -0.2, 0.0},
	{PRIMITIVE_CYLINDER, "cylinder, in, cap", {0.1, 0.0, -0.4}, -0.1, 0.0},
	{PRIMITIVE_CYLINDER, "cylinder, side", {0.0, 0.7, 0.2}, 0.2, 0.0},
	{PRIMITIVE_CYLINDER, "cylinder, cap", {0.1, 0.3, 0.7}, 0.2, 0.0},
	{PRIMITIVE_CYLINDER, "cylinder, rim", {0.62, 0.0, -0.66}, 0.2, 0.0},
	{PRIMITIVE_CAPSULE, "capsule, in", {0.0, 0.2, 0.5}, -0.2, 0.0},
	{PRIMITIVE_CAPSULE, "capsule, side", {-0.3, 0.4, 0.7}, 0.1, 0.0},
	{PRIMITIVE_CAPSULE, "capsule, start", {0.0, 0.3, -0.4}, 0.1, 0.0},
	{PRIMITIVE_CAPSULE, "capsule, end", {0.3, 0.0, 1.4}, 0.1, 0.0},
	/* The side runs from (0.8, 0) to (0.2, 0.8): normal (0.8, 0.6). */
	{PRIMITIVE_CONE, "cone, in, side", {0.3, 0.0, 0.5}, -0.1, 0.0},
	{PRIMITIVE_CONE, "cone, in, base", {0.1, 0.2, 0.15}, -0.15, 0.0},
	{PRIMITIVE_CONE, "cone, in, top", {0.0, 0.06, 0.74}, -0.06, 0.0},
	{PRIMITIVE_CONE, "cone, side", {0.66, 0.0, 0.52}, 0.2, 0.0},
	{PRIMITIVE_CONE, "cone, base", {0.3, -0.4, -0.1}, 0.1, 0.0},
	{PRIMITIVE_CONE, "cone, top", {0.1, 0.0, 0.9}, 0.1, 0.0},
	{PRIMITIVE_CONE, "cone, base rim", {0.0, 0.86, -0.08}, 0.1, 0.0},
	{PRIMITIVE_CONE, "cone, top rim", {0.26, 0.0, 0.96},
	    0.17088007490635063, 0.0},
	{PRIMITIVE_TORUS, "torus, in", {0.0, 0.8, 0.05},
	    0.11180339887498948 - 0.25, 0.0},
	{PRIMITIVE_TORUS, "torus, out", {0.6, 0.8, 0.05},
	    0.30413812651491101 - 0.25, 0.0},
	{PRIMITIVE_TORUS, "torus, hole", {0.3, 0.0, 0.1},
	    0.41231056256176607 - 0.25, 0.0},
	{PRIMITIVE_PLANE, "plane, in", {5.0, -3.0, -0.2}, -0.2, 0.0},
	{PRIMITIVE_PLANE, "plane, out", {0.3, 0.1, 0.2}, 0.2, 0.0},
};
#define SPOT_COUNT (sizeof(spots) / sizeof(spots[0]))

/* SPEC section 2, as it prints them. */
static double closed_form(const struct primitive *p, const struct spot *s)
{
	double t = fmax(-1.0, fmin(1.0, s->distance / p->falloff)), q;

	if (p->type > PRIMITIVE_CIRCLE)
		return 0.5 - 15.0 / 16.0 * t + 5.0 / 8.0 * pow(t, 3.0) -
		    3.0 / 16.0 * pow(t, 5.0);
	/* R = r / sqrt(1 - 2^(-1/n)) */
	q = s->distance / s->radius;
	q = 1.0 - q * q * (1.0 - pow(2.0, -1.0 / p->exponent));
	return q > 0.0 ? p->weight * pow(q, p->exponent) : 0.0;
}

static void test_value_is_closed_form_in_every_region(void **state)
{
	(void)state;
	for (size_t i = 0; i < SPOT_COUNT; i++) {
		const struct spot *s = &spots[i];
		const struct primitive *p = &sample[s->type];

		assert_near(s->region, value(p, s->at), closed_form(p, s),
		    1e-14);
	}
}

static void test_every_type_has_a_spot(void **state)
{
	bool seen[SHAPE_COUNT] = {false};

	(void)state;
	for (size_t i = 0; i < SPOT_COUNT; i++)
		seen[spots[i].type] = true;
	for (int i = 0; i < SHAPE_COUNT; i++)
		assert_true(seen[i]);
}

/* A rotation, but for a box a translation only: it has no axes to turn. */
static struct affine random_frame(enum primitive_type type)
{
	const double one[3] = {1.0, 1.0, 1.0};
	double t[3], q[4] = {0.0, 0.0, 0.0, 1.0};

	for (int i = 0; i < 3; i++)
		t[i] = uniform(-2.0, 2.0);
	for (int i = 0; i < 4 && type != PRIMITIVE_BOX; i++)
		q[i] = uniform(-1.0, 1.0);
	return affine_from_trs(t, q, one);
}

static struct primitive moved(const struct primitive *p,
    const struct affine *frame)
{
	struct primitive out = *p;
	struct affine turn = *frame;

	turn.t[0] = turn.t[1] = turn.t[2] = 0.0;
	out.a = affine_point(frame, p->a);
	out.b = affine_point(frame, p->b);
	out.c = affine_point(frame, p->c);
	out.normal = affine_point(&turn, p->normal);
	return out;
}

static void check_gradient(const char *what, const struct primitive *p,
    struct vec3 x)
{
	const double h = 1e-4;
	struct jet j = eval(p, x, 1);
	struct vec3 d[3] = {{h, 0.0, 0.0}, {0.0, h, 0.0}, {0.0, 0.0, h}};
	double difference[3];

	/* Fourth order: (8 (f(h) - f(-h)) - (f(2h) - f(-2h))) / 12h. */
	for (int k = 0; k < 3; k++)
		difference[k] = (8.0 * (value(p, vec3_add(x, d[k])) -
		    value(p, vec3_sub(x, d[k]))) -
		    value(p, vec3_axpy(2.0, d[k], x)) +
		    value(p, vec3_axpy(-2.0, d[k], x))) / (12.0 * h);
	/* Measured 1.1e-11 at most; gradients are up to 4. */
	assert_vec3(what, j.gradient,
	    vec3(difference[0], difference[1], difference[2]), 1e-10);
}

static void check_hessian(const char *what, const struct primitive *p,
    struct vec3 x)
{
	const double h = 1e-4;
	struct jet j = eval(p, x, 2);
	struct vec3 d[3] = {{h, 0.0, 0.0}, {0.0, h, 0.0}, {0.0, 0.0, h}};

	for (int k = 0; k < 3; k++) {
		struct vec3 near = vec3_sub(
		    eval(p, vec3_add(x, d[k]), 1).gradient,
		    eval(p, vec3_sub(x, d[k]), 1).gradient);
		struct vec3 far = vec3_sub(
		    eval(p, vec3_axpy(2.0, d[k], x), 1).gradient,
		    eval(p, vec3_axpy(-2.0, d[k], x), 1).gradient);

		/* Measured 9.1e-11 at most; the second derivatives are up to
		 * 35. */
		assert_vec3(what, sym3_apply(j.hessian,
		    vec3_scale(1.0 / h, d[k])), vec3_scale(1.0 / (12.0 * h),
		    vec3_axpy(8.0, near, vec3_scale(-1.0, far))), 1e-9);
	}
}

/* Runs check at every spot, moved a little, in random frames. */
static void at_every_spot(void (*check)(const char *what,
    const struct primitive *p, struct vec3 x))
{
	srand48(1);
	for (size_t i = 0; i < SPOT_COUNT; i++) {
		const struct spot *s = &spots[i];

		for (int k = 0; k < 20; k++) {
			struct affine frame = random_frame(s->type);
			struct primitive p = moved(&sample[s->type], &frame);
			struct vec3 x = vec3_add(s->at, random_vector(0.01));

			check(s->region, &p, affine_point(&frame, x));
		}
	}
}

static void test_gradient_matches_differences_in_every_region(void **state)
{
	(void)state;
	at_every_spot(check_gradient);
}

static void test_hessian_matches_differences_in_every_region(void **state)
{
	(void)state;
	at_every_spot(check_hessian);
}

static void test_order_leaves_higher_derivatives_null(void **state)
{
	(void)state;
	for (size_t i = 0; i < SPOT_COUNT; i++) {
		const struct primitive *p = &sample[spots[i].type];
		struct jet two = eval(p, spots[i].at, 2);
		struct jet one = eval(p, spots[i].at, 1);
		struct jet none = eval(p, spots[i].at, 0);

		assert_true(none.value == two.value && one.value == two.value);
		assert_true(one.gradient.x == two.gradient.x);
		assert_true(is_flat(&none));
		assert_true(largest(&one.hessian) == 0.0);
	}
}

/* A solid's distance has a unit gradient: |grad f| is |f'(t)|/falloff. */
static void test_solids_have_unit_distance_gradient(void **state)
{
	(void)state;
	for (size_t i = 0; i < SPOT_COUNT; i++) {
		const struct spot *s = &spots[i];
		const struct primitive *p = &sample[s->type];
		double t = s->distance / p->falloff, u = 1.0 - t * t;

		if (p->type <= PRIMITIVE_CIRCLE || fabs(t) > 1.0)
			continue;
		assert_near(s->region, vec3_norm(eval(p, s->at, 1).gradient),
		    15.0 / 16.0 * u * u / p->falloff, 1e-13);
	}
}

static void test_surface_is_half(void **state)
{
	static const struct {
		enum primitive_type type;
		struct vec3 at;
	} surface[] = {
		{PRIMITIVE_POINT, {0.0, 0.5, 0.0}},
		{PRIMITIVE_TRIANGLE, {0.3, 0.3, 0.5}},
		{PRIMITIVE_CIRCLE, {0.9, 0.0, 0.0}},
		{PRIMITIVE_SPHERE, {0.0, 0.0, -0.6}},
		{PRIMITIVE_BOX, {0.5, 0.2, 0.1}},
		{PRIMITIVE_CYLINDER, {0.1, 0.1, 0.5}},
		{PRIMITIVE_CYLINDER, {0.0, 0.5, 0.1}},
		{PRIMITIVE_CAPSULE, {0.0, 0.0, 1.4}},
		{PRIMITIVE_CONE, {0.5, 0.0, 0.4}},
		{PRIMITIVE_TORUS, {0.7, 0.0, 0.25}},
		{PRIMITIVE_PLANE, {9.0, 9.0, 0.0}},
	};

	(void)state;
	for (size_t i = 0; i < sizeof(surface) / sizeof(surface[0]); i++)
		assert_near("surface", value(&sample[surface[i].type],
		    surface[i].at), 0.5, 1e-14);
}

static void test_skeleton_has_the_weight_and_no_gradient(void **state)
{
	static const struct vec3 on[] = {
		[PRIMITIVE_POINT] = {0.0, 0.0, 0.0},
		[PRIMITIVE_SEGMENT] = {0.0, 0.0, 0.7},
		[PRIMITIVE_TRIANGLE] = {0.2, 0.2, 0.0},
		[PRIMITIVE_DISC] = {0.1, 0.3, 0.0},
		[PRIMITIVE_CIRCLE] = {0.0, -0.6, 0.0},
	};

	(void)state;
	for (int i = PRIMITIVE_POINT; i <= PRIMITIVE_CIRCLE; i++) {
		struct jet j = eval(&sample[i], on[i], 2);

		assert_true(j.value == sample[i].weight);
		assert_true(vec3_norm(j.gradient) == 0.0);
		assert_true(j.hessian.xx + j.hessian.yy + j.hessian.zz < 0.0);
	}
}

static void test_outside_support_everything_is_exactly_zero(void **state)
{
	const double reach[] = {1.0, 1.0 + 1e-9, 2.0, 1e6, 1e12};

	(void)state;
	srand48(2);
	for (int i = 0; i < SHAPE_COUNT; i++)
		for (size_t k = 0; k < 5 * 50; k++) {
			/* No sample reaches 4 from the origin; the plane's
			 * inside is below. */
			struct vec3 x = random_vector(1.0);
			double far = 4.0 * reach[k % 5] / vec3_norm(x);
			struct jet j;

			x = vec3_scale(fmin(far, 1e12), x);
			if (i == PRIMITIVE_PLANE)
				x.z = 0.5 + fabs(x.z);
			j = eval(&sample[i], x, 2);
			assert_true(j.value == 0.0);
			assert_true(is_flat(&j));
		}
}

static void test_field_joins_zero_at_support_boundary(void **state)
{
	const struct primitive *p = &sample[PRIMITIVE_POINT];
	double R = primitive_size(p);
	struct jet in = eval(p, vec3(R * (1.0 - 1e-6), 0.0, 0.0), 2);
	struct jet on = eval(p, vec3(0.0, 0.0, R * (1.0 + 1e-15)), 2);

	(void)state;
	/* (1 - d^2/R^2)^3 with 1 - d/R = 1e-6 */
	assert_near("value", in.value * 1e18, 8.0, 1e-4);
	assert_near("slope", in.gradient.x * R * 1e12, -24.0, 1e-4);
	assert_true(on.value == 0.0);
	assert_true(is_flat(&on));
}

static void test_deep_inside_solids_is_one_and_flat(void **state)
{
	(void)state;
	for (int i = PRIMITIVE_SPHERE; i < SHAPE_COUNT; i++) {
		struct primitive p = sample[i];
		struct vec3 x = i == PRIMITIVE_TORUS ? vec3(0.7, 0.0, 0.0) :
		    i == PRIMITIVE_PLANE ? vec3(3.0, 0.0, -0.1) :
		    vec3(0.0, 0.0, 0.1);
		struct jet j;

		p.falloff = 0.1;
		j = eval(&p, x, 2);
		assert_near("depth", j.value, 1.0, 1e-15);
		/* At the depth itself rounding may leave 1 - t^2 at 1e-16. */
		assert_true(vec3_norm(j.gradient) <= 1e-29);
		p.falloff = 0.05;
		j = eval(&p, x, 2);
		assert_true(j.value == 1.0);
		assert_true(is_flat(&j));
	}
}

static void test_size_is_support_or_falloff(void **state)
{
	(void)state;
	/* 1/sqrt(1 - 2^(-1/n)): n = 3, 3.5, 4 */
	assert_near("point", primitive_size(&sample[PRIMITIVE_POINT]),
	    0.5 * 2.201663485154594, 1e-15);
	assert_near("circle", primitive_size(&sample[PRIMITIVE_CIRCLE]),
	    0.3 * 2.35922134813672, 1e-15);
	assert_near("triangle", primitive_size(&sample[PRIMITIVE_TRIANGLE]),
	    0.5 * 2.507032809494771, 1e-15);
	assert_near("segment", primitive_size(&sample[PRIMITIVE_SEGMENT]),
	    0.5 * 2.201663485154594, 1e-15);
	for (int i = PRIMITIVE_SPHERE; i < SHAPE_COUNT; i++)
		assert_true(primitive_size(&sample[i]) == sample[i].falloff);
}

static void test_preparing_follows_the_tape_order(void **state)
{
	static const struct {
		OPCODE_UINT op;
		int count;
	} expected[SHAPE_COUNT] = {{OP_POINT, 6}, {OP_SEGMENT, 11},
	    {OP_TRIANGLE, 12}, {OP_DISC, 10}, {OP_CIRCLE, 10}, {OP_SPHERE, 5},
	    {OP_BOX, 8}, {OP_CYLINDER, 9}, {OP_CAPSULE, 9}, {OP_CONE, 10},
	    {OP_TORUS, 9}, {OP_PLANE, 7}};
	double params[PRIMITIVE_PARAMS_MAX];

	(void)state;
	for (int i = 0; i < SHAPE_COUNT; i++) {
		assert_int_equal(primitive_opcode(sample[i].type),
		    expected[i].op);
		assert_int_equal(primitive_prepare(&sample[i], params),
		    expected[i].count);
	}
	primitive_prepare(&sample[PRIMITIVE_SEGMENT], params);
	assert_near("u", params[5], 1.0, 0.0);
	assert_near("length", params[6], 1.0, 0.0);
	assert_near("Ra", params[7], 0.5 * 2.201663485154594, 1e-15);
	assert_near("slope", params[8], 0.3 * 2.201663485154594, 1e-15);
	primitive_prepare(&sample[PRIMITIVE_CYLINDER], params);
	assert_near("middle", params[2], 0.0, 0.0);
	assert_near("half", params[6], 0.5, 0.0);
}

/* Compares the values of two primitives around the origin. */
static void assert_same_field(const char *what, const struct primitive *p,
    const struct primitive *q, double tolerance)
{
	srand48(3);
	for (int i = 0; i < 500; i++) {
		struct vec3 x = random_vector(1.5);

		assert_near(what, value(p, x), value(q, x), tolerance);
	}
}

static void test_degenerate_soft_objects_are_simpler_ones(void **state)
{
	struct primitive point = sample[PRIMITIVE_POINT], p = point, q = point;

	(void)state;
	p.type = PRIMITIVE_SEGMENT;
	p.radius[1] = p.radius[0];
	assert_same_field("segment of length 0", &p, &point, 1e-14);
	p.type = PRIMITIVE_TRIANGLE;
	assert_same_field("triangle of one point", &p, &point, 1e-14);
	p.type = PRIMITIVE_DISC;
	p.normal = vec3(1.0, 1.0, 0.0);
	p.major = 1e-9;
	assert_same_field("tiny disc", &p, &point, 1e-8);
	p.type = PRIMITIVE_CIRCLE;
	assert_same_field("tiny ring", &p, &point, 1e-8);
	q.type = PRIMITIVE_SEGMENT;
	q.radius[1] = q.radius[0];
	q.a = p.a = vec3(-0.4, 0.2, 0.1);
	q.b = p.c = vec3(0.6, -0.4, 0.5);
	p.type = PRIMITIVE_TRIANGLE;
	p.b = vec3_scale(0.5, vec3_add(q.a, q.b));
	assert_same_field("collinear triangle", &p, &q, 1e-14);
	p.b = p.a;
	assert_same_field("triangle of two points", &p, &q, 1e-14);
}

static void test_sliver_triangle_is_its_edges(void **state)
{
	struct primitive p = sample[PRIMITIVE_TRIANGLE], q = p;
	struct vec3 along = vec3(1.0, -0.6, 0.4);

	(void)state;
	q.type = PRIMITIVE_SEGMENT;
	q.radius[1] = q.radius[0];
	srand48(7);
	for (int i = 0; i < 1000; i++) {
		struct vec3 off = vec3_cross(along, random_vector(1.0)), x;

		/* Rounding turns such a thin triangle's normal by 1e-6. */
		q.a = p.a = random_vector(1.0);
		q.b = p.c = vec3_add(p.a, along);
		p.b = vec3_axpy(1e-10, off, vec3_axpy(0.9, along, p.a));
		/* Over its middle, seen along any normal. */
		x = vec3_axpy(0.6, along, vec3_axpy(3e-11, off, p.a));
		x = vec3_add(x, vec3_scale(0.5, vec3_cross(along, off)));
		/* The edges are within 1e-10 of q, slopes under 4. */
		assert_near("sliver", value(&p, x), value(&q, x), 1e-9);
	}
}

static void test_degenerate_solids_are_simpler_ones(void **state)
{
	struct primitive p = sample[PRIMITIVE_CAPSULE];
	struct primitive q = sample[PRIMITIVE_SPHERE];

	(void)state;
	p.b = p.a;
	p.radius[0] = q.radius[0];
	assert_same_field("capsule of length 0", &p, &q, 1e-14);
	p = sample[PRIMITIVE_BOX];
	p.half_size = vec3(0.6, 0.6, 0.6);
	p.rounding = 0.6;
	p.falloff = q.falloff;
	assert_same_field("wholly rounded box", &p, &q, 1e-14);
	p = q = sample[PRIMITIVE_CYLINDER];
	p.type = PRIMITIVE_CONE;
	p.radius[1] = p.radius[0];
	assert_same_field("cone of one radius", &p, &q, 1e-14);
	p.a = p.b = q.a = q.b = vec3(0.1, 0.2, 0.3);
	assert_same_field("cone and cylinder of length 0", &p, &q, 1e-14);
	p.radius[1] = 0.1;
	assert_same_field("cone of length 0", &p, &q, 1e-14);
	p.radius[1] = p.radius[0];
	p.radius[0] = 0.0;
	assert_same_field("flared cone of length 0", &p, &q, 1e-14);
}

/* The distance to corner[0..2] from x, from many samples of the triangle. */
static double sampled_distance(const struct vec3 corner[static 3],
    struct vec3 x)
{
	const int n = 150;
	double least = HUGE_VAL;

	for (int i = 0; i <= n; i++)
		for (int j = 0; j <= n - i; j++) {
			struct vec3 y = vec3_axpy((double)i / n,
			    vec3_sub(corner[1], corner[0]), corner[0]);

			y = vec3_axpy((double)j / n,
			    vec3_sub(corner[2], corner[0]), y);
			least = fmin(least, vec3_norm(vec3_sub(x, y)));
		}
	return least;
}

static void test_triangle_distance_is_the_least(void **state)
{
	(void)state;
	srand48(4);
	for (int i = 0; i < 200; i++) {
		struct vec3 corner[3] = {random_vector(1.0), random_vector(1.0),
		    random_vector(1.0)};
		struct primitive p = {.type = PRIMITIVE_TRIANGLE,
		    .a = corner[0], .b = corner[1], .c = corner[2],
		    .radius = {4.0}, .exponent = 3.0, .weight = 1.0};
		struct vec3 x = random_vector(2.0);
		double d = primitive_size(&p) *
		    sqrt(1.0 - cbrt(value(&p, x)));
		double sampled = sampled_distance(corner, x);

		/* Samples lie up to 2 sqrt(3)/150 from any point of it. */
		assert_true(d <= sampled + 1e-9);
		assert_true(d >= sampled - 0.024);
	}
}

/* The signed distance to a cone about z in (rho, z), from samples. */
static double sampled_cone(double length, double ra, double rb, double rho,
    double z)
{
	const int n = 2000;
	double least = HUGE_VAL;

	for (int i = 0; i <= n; i++) {
		double s = (double)i / n;

		least = fmin(least, hypot(rho - s * ra, z));
		least = fmin(least, hypot(rho - s * rb, z - length));
		least = fmin(least, hypot(rho - ra - s * (rb - ra),
		    z - s * length));
	}
	if (z > 0.0 && z < length && rho < ra + (rb - ra) * z / length)
		return -least;
	return least;
}

static void test_cone_distance_is_the_least(void **state)
{
	(void)state;
	srand48(5);
	for (int i = 0; i < 500; i++) {
		double ra = i % 7 == 0 ? 0.0 : uniform(0.1, 1.0);
		double rb = i % 7 == 1 ? 0.0 : uniform(0.1, 1.0);
		double length = uniform(0.1, 1.0);
		struct primitive p = {.type = PRIMITIVE_CONE,
		    .b = {0.0, 0.0, length}, .radius = {ra, rb},
		    .falloff = 4.0};
		double rho = uniform(0.0, 1.5), z = uniform(-1.0, 2.0);
		double f = value(&p, vec3(0.6 * rho, 0.8 * rho, z));
		double t = sampled_cone(length, ra, rb, rho, z) / 4.0;

		/* Samples are 1.5/2000 apart; f' is 15/64 at most. */
		assert_near("cone", f, 0.5 - 15.0 / 16.0 * t +
		    5.0 / 8.0 * pow(t, 3.0) - 3.0 / 16.0 * pow(t, 5.0), 1e-4);
	}
}

static void test_hessian_on_the_axis_beyond_an_apex_is_of_a_sphere(void **state)
{
	struct primitive cone = sample[PRIMITIVE_CONE];
	struct primitive sphere = sample[PRIMITIVE_SPHERE];
	struct vec3 x = vec3(0.0, 0.0, 0.9);
	struct jet j, k;

	(void)state;
	/* Near the apex at 0.8 the cone's distance is that to the apex. */
	cone.radius[1] = 0.0;
	sphere.a = cone.b;
	sphere.radius[0] = 1e-9;
	sphere.falloff = cone.falloff;
	j = eval(&cone, x, 2);
	k = eval(&sphere, x, 2);
	assert_near("value", j.value, k.value, 1e-8);
	assert_near("z", j.gradient.z, k.gradient.z, 1e-7);
	assert_near("xx", j.hessian.xx, k.hessian.xx, 1e-6);
	assert_near("yy", j.hessian.yy, k.hessian.yy, 1e-6);
	assert_near("zz", j.hessian.zz, k.hessian.zz, 1e-6);
}

static void test_hessian_stays_bounded_by_the_guard(void **state)
{
	static const struct {
		enum primitive_type type;
		struct vec3 at;
	} singular[] = {
		{PRIMITIVE_CIRCLE, {0.0, 0.0, 0.0}},
		{PRIMITIVE_CIRCLE, {1e-12, 0.0, 0.1}},
		{PRIMITIVE_SPHERE, {0.0, 0.0, 0.0}},
		{PRIMITIVE_SPHERE, {0.0, 1e-12, 0.0}},
		{PRIMITIVE_BOX, {0.5 + 1e-13, 0.6 + 1e-13, 0.1}},
		{PRIMITIVE_CYLINDER, {0.5 + 1e-13, 0.0, 0.5 + 1e-13}},
		{PRIMITIVE_CYLINDER, {0.0, 1e-12, 0.0}},
		{PRIMITIVE_CAPSULE, {0.0, 1e-12, 0.5}},
		{PRIMITIVE_CONE, {0.2 + 1e-13, 0.0, 0.8 + 1e-13}},
		{PRIMITIVE_CONE, {0.0, 1e-12, 0.4}},
		{PRIMITIVE_TORUS, {0.7 + 1e-12, 0.0, 0.0}},
	};

	(void)state;
	for (size_t i = 0; i < sizeof(singular) / sizeof(singular[0]); i++) {
		struct primitive p = sample[singular[i].type];
		double size;
		struct jet j;

		p.falloff = 1.5;
		p.rounding = 0.0;
		size = primitive_size(&p);
		j = eval(&p, singular[i].at, 2);
		assert_true(is_finite(&j));
		/* 1/(AXIS_GUARD * length) times a slope of order 1/size, with
		 * lengths and sizes of order 1: measured 5.4e6 at most. */
		assert_true(largest(&j.hessian) * size * size < 2e7);
	}
}

/* Sizes and places over every magnitude that a tree may hold. */
static struct vec3 wild_vector(void)
{
	double m[3];

	for (int i = 0; i < 3; i++)
		m[i] = drand48() < 0.3 ? 0.0 :
		    copysign(magnitude(1e-12, 1e9), drand48() - 0.5);
	return vec3(m[0], m[1], m[2]);
}

static struct primitive wild_primitive(enum primitive_type type)
{
	struct primitive p = {.type = type, .a = wild_vector(),
	    .b = wild_vector(), .c = wild_vector(),
	    .normal = random_vector(1.0), .radius = {magnitude(1e-9, 1e9),
	    magnitude(1e-9, 1e9)}, .major = magnitude(1e-9, 1e9),
	    .minor = magnitude(1e-9, 1e9), .weight = magnitude(1e-6, 1e6),
	    .exponent = drand48() < 0.5 ? 3.0 : uniform(3.0, 40.0),
	    .falloff = magnitude(1e-9, 1e9)};

	if (drand48() < 0.2)
		p.b = p.a;
	if (drand48() < 0.2)
		p.c = vec3_scale(0.5, vec3_add(p.a, p.b));
	if (type == PRIMITIVE_CONE && drand48() < 0.3)
		p.radius[drand48() < 0.5] = 0.0;
	p.rounding = drand48() < 0.5 ? 0.0 : magnitude(1e-9, 1e9);
	p.half_size = vec3_add(vec3(p.rounding, p.rounding, p.rounding),
	    vec3(magnitude(1e-9, 1e9), magnitude(1e-9, 1e9),
	    magnitude(1e-9, 1e9)));
	return p;
}

/* By one of the primitive's own points, at any distance from it. */
static struct vec3 wild_point(const struct primitive *p, int i)
{
	const struct vec3 anchors[] = {p->a, p->b, p->c, {0.0, 0.0, 0.0},
	    vec3_scale(0.5, vec3_add(p->a, p->b)),
	    vec3_add(p->a, p->half_size)};
	double reach = i % 5 == 0 ? 0.0 : magnitude(1e-12, 1e12);
	struct vec3 x = vec3_add(anchors[i % 6], random_vector(reach));

	return vec3(fmax(-1e12, fmin(1e12, x.x)),
	    fmax(-1e12, fmin(1e12, x.y)), fmax(-1e12, fmin(1e12, x.z)));
}

static void test_wild_points_and_sizes_give_finite_jets(void **state)
{
	(void)state;
	srand48(6);
	for (int i = 0; i < 240000; i++) {
		struct primitive p = wild_primitive(
		    (enum primitive_type)(i % SHAPE_COUNT));
		struct vec3 x = wild_point(&p, i / SHAPE_COUNT);
		struct jet j = eval(&p, x, 2);

		if (!is_finite(&j) || j.value < 0.0)
			fail_msg("type %d at %g %g %g: value %g", p.type, x.x,
			    x.y, x.z, j.value);
		/* From there on the device rounds to float32. */
		assert_true(largest(&j.hessian) < FLT_MAX);
	}
}

int main(void)
{
	const struct CMUnitTest tests[] = {
		cmocka_unit_test(test_every_type_has_a_spot),
		cmocka_unit_test(test_value_is_closed_form_in_every_region),
		cmocka_unit_test(test_gradient_matches_differences_in_every_region),
		cmocka_unit_test(test_hessian_matches_differences_in_every_region),
		cmocka_unit_test(test_order_leaves_higher_derivatives_null),
		cmocka_unit_test(test_solids_have_unit_distance_gradient),
		cmocka_unit_test(test_surface_is_half),
		cmocka_unit_test(test_skeleton_has_the_weight_and_no_gradient),
		cmocka_unit_test(test_outside_support_everything_is_exactly_zero),
		cmocka_unit_test(test_field_joins_zero_at_support_boundary),
		cmocka_unit_test(test_deep_inside_solids_is_one_and_flat),
		cmocka_unit_test(test_size_is_support_or_falloff),
		cmocka_unit_test(test_preparing_follows_the_tape_order),
		cmocka_unit_test(test_degenerate_soft_objects_are_simpler_ones),
		cmocka_unit_test(test_sliver_triangle_is_its_edges),
		cmocka_unit_test(test_degenerate_solids_are_simpler_ones),
		cmocka_unit_test(test_triangle_distance_is_the_least),
		cmocka_unit_test(test_cone_distance_is_the_least),
		cmocka_unit_test(
		    test_hessian_on_the_axis_beyond_an_apex_is_of_a_sphere),
		cmocka_unit_test(test_hessian_stays_bounded_by_the_guard),
		cmocka_unit_test(test_wild_points_and_sizes_give_finite_jets),
	};

	return cmocka_run_group_tests_name("primitive", tests, NULL, NULL);
}
