#include <stdarg.h>
#include <stddef.h>
#include <setjmp.h>
#include <stdint.h>
#include <cmocka.h>

#include <math.h>
#include <stdbool.h>

#include "core/warp.h"
#include "tests/support/near.h"
#include "tests/support/random_tree.h"

#define PI 3.14159265358979323846

static const struct vec3 up = {0.0, 0.0, 1.0};
static const struct vec3 right = {1.0, 0.0, 0.0};

static void assert_vec3(struct vec3 value, struct vec3 expected,
    double tolerance)
{
	assert_near(value.x, expected.x, tolerance);
	assert_near(value.y, expected.y, tolerance);
	assert_near(value.z, expected.z, tolerance);
}

static struct warp_jet eval(const struct warp *w, struct vec3 x, int order)
{
	double params[WARP_PARAMS_MAX];
	struct warp_jet out;

	warp_prepare(w, params);
	warp_eval(w->type, params, x, order, &out);
	return out;
}

static struct warp twist(double rate)
{
	return (struct warp){.type = WARP_TWIST, .axis = up, .rate = rate};
}

static struct warp taper(double from, double to, double scale)
{
	return (struct warp){.type = WARP_TAPER, .axis = up, .has_range = true,
	    .from = from, .to = to, .scale = scale};
}

static struct warp bend(double from, double to, double rate)
{
	return (struct warp){.type = WARP_BEND, .axis = up, .direction = right,
	    .rate = rate, .has_range = true, .from = from, .to = to};
}

static struct vec3 random_vec3(struct random_stream *r, double reach)
{
	double x = random_in(r, -reach, reach), y = random_in(r, -reach, reach);

	return vec3(x, y, random_in(r, -reach, reach));
}

/* Any axis and direction; a range 0.5 to 2 long that begins about 0, and a
 * bend of at most 5 radians. */
static struct warp random_warp(struct random_stream *r, unsigned type)
{
	struct warp w = {.type = type, .axis = random_vec3(r, 3.0),
	    .center = random_vec3(r, 1.0), .direction = random_vec3(r, 2.0),
	    .rate = random_in(r, -2.5, 2.5), .has_range = true,
	    .from = random_in(r, -1.0, 0.5), .scale = random_in(r, 0.3, 3.0)};

	w.to = w.from + random_in(r, 0.5, 2.0);
	if (type == WARP_TWIST)
		w.has_range = random_below(r, 2) == 0;
	return w;
}

/* The warp's own coordinates in its frame, right-handed: e1, e2, u. */
struct basis {
	struct vec3 e1, e2, u;
};

static struct basis basis_of(const struct warp *w)
{
	struct basis b;

	b.u = vec3_scale(1.0 / vec3_norm(w->axis), w->axis);
	b.e1 = vec3_axpy(-vec3_dot(b.u, w->direction), b.u, w->direction);
	b.e1 = vec3_scale(1.0 / vec3_norm(b.e1), b.e1);
	b.e2 = vec3_cross(b.u, b.e1);
	return b;
}

static struct vec3 place(const struct warp *w, const struct basis *b,
    struct vec3 x)
{
	return vec3_add(w->center, vec3_axpy(x.x, b->e1, vec3_axpy(x.y, b->e2,
	    vec3_scale(x.z, b->u))));
}

/* Barr 1984, section 3: twist, taper, and bend with his x, y, z named e2, u, e1
 * and his y0 and y_min the range's begin. */
static struct vec3 barr(const struct warp *w, struct vec3 x)
{
	double q, c, s, k, z, held;

	if (w->type == WARP_TWIST) {
		q = w->rate * (w->has_range ? x.z - w->from : x.z);
		return vec3(x.x * cos(q) - x.y * sin(q),
		    x.x * sin(q) + x.y * cos(q), x.z);
	}
	if (w->type == WARP_TAPER) {
		k = 1.0 + (w->scale - 1.0) * (x.z - w->from) /
		    (w->to - w->from);
		return vec3(k * x.x, k * x.y, x.z);
	}
	held = fmin(fmax(x.z, w->from), w->to);
	q = w->rate * (held - w->from);
	c = cos(q);
	s = sin(q);
	z = x.x - 1.0 / w->rate;
	return vec3(c * z + 1.0 / w->rate + s * (x.z - held), x.y,
	    -s * z + w->from + c * (x.z - held));
}

/* z away from the rounded ends, within the range or beyond it. */
static double clear_of_ends(struct random_stream *r, const struct warp *w,
    bool within)
{
	double z, length = w->to - w->from;

	if (within)
		return w->from + length * random_in(r, 0.126, 0.874);
	/* a bend's ends are rounded in the angle about its centre */
	z = length * random_in(r, 0.3, 0.5);
	return random_below(r, 2) ? w->from - z : w->to + z;
}

/* W undoes Barr's deformations. Measured: 3e-15. */
static void test_warp_is_the_inverse_of_barr(void **state)
{
	struct random_stream r = {1};

	(void)state;
	for (unsigned type = 0; type < WARP_TYPE_COUNT; type++)
		for (int i = 0; i < 300; i++) {
			struct warp w = random_warp(&r, type);
			struct basis b = basis_of(&w);
			bool within = type != WARP_BEND || random_below(&r, 2);
			struct vec3 x = random_vec3(&r, 0.35);

			if (type == WARP_BEND) {
				w.rate = random_in(&r, -2.0, 2.0) /
				    (w.to - w.from);
				x.x *= 0.7 / fabs(w.rate);
			}
			x.z = clear_of_ends(&r, &w, within);
			assert_vec3(eval(&w, place(&w, &b, barr(&w, x)),
			    0).point, place(&w, &b, x), 1e-13);
		}
}

static void test_warp_endless_twist_turns_everywhere(void **state)
{
	struct warp w = twist(PI / 2.0);

	(void)state;
	/* at height 1 a quarter turn is undone, at -100 25 turns */
	assert_vec3(eval(&w, vec3(0.0, 1.0, 1.0), 0).point,
	    vec3(1.0, 0.0, 1.0), 1e-15);
	assert_vec3(eval(&w, vec3(0.0, 1.0, -101.0), 0).point,
	    vec3(-1.0, 0.0, -101.0), 1e-12);
}

static void test_warp_twist_turns_rigidly_beyond_its_range(void **state)
{
	struct warp w = twist(PI / 2.0);
	struct warp_jet j;

	(void)state;
	w.has_range = true;
	w.from = 1.0;
	w.to = 2.0;
	for (int i = 0; i < 10; i++) {
		j = eval(&w, vec3(0.0, 1.0, 0.87 - i), 2);
		assert_vec3(j.point, vec3(0.0, 1.0, 0.87 - i), 1e-15);
		assert_near(j.second[0].zz, 0.0, 0.0);
		assert_near(j.jacobian[0][2], 0.0, 0.0);
		j = eval(&w, vec3(0.0, 1.0, 2.13 + i), 2);
		assert_vec3(j.point, vec3(1.0, 0.0, 2.13 + i), 1e-15);
	}
}

static void test_warp_taper_scales_evenly_beyond_its_range(void **state)
{
	struct warp w = taper(1.0, 2.0, 0.25);

	(void)state;
	assert_vec3(eval(&w, vec3(0.5, -1.0, 0.8), 0).point,
	    vec3(0.5, -1.0, 0.8), 1e-15);
	assert_vec3(eval(&w, vec3(0.5, -1.0, 1.5), 0).point,
	    vec3(0.8, -1.6, 1.5), 1e-15);
	assert_vec3(eval(&w, vec3(0.5, -1.0, 2.2), 0).point,
	    vec3(2.0, -4.0, 2.2), 1e-15);
	assert_vec3(eval(&w, vec3(0.5, -1.0, 1e9), 0).point,
	    vec3(2.0, -4.0, 1e9), 1e-15);
}

/* A quarter circle of radius 2 towards x, from the origin upwards. */
static void test_warp_bend_at_known_points(void **state)
{
	struct warp w = bend(0.0, PI, 0.5);
	double s = 2.0 * sqrt(0.5);

	(void)state;
	assert_vec3(eval(&w, vec3(0.3, 0.7, -1.0), 0).point,
	    vec3(0.3, 0.7, -1.0), 1e-15);
	assert_vec3(eval(&w, vec3(2.0 - s, 0.7, s), 0).point,
	    vec3(0.0, 0.7, PI / 2.0), 1e-15);
	/* half of the way to the centre */
	assert_vec3(eval(&w, vec3(2.0 - s / 2.0, 0.0, s / 2.0), 0).point,
	    vec3(1.0, 0.0, PI / 2.0), 1e-15);
	/* on along x after the arc */
	assert_vec3(eval(&w, vec3(3.0, 0.0, 2.0), 0).point,
	    vec3(0.0, 0.0, PI + 1.0), 1e-15);
	assert_vec3(eval(&w, vec3(3.0, 0.0, 2.25), 0).point,
	    vec3(-0.25, 0.0, PI + 1.0), 1e-15);
}

static void test_warp_bend_of_negative_rate_is_the_mirror_image(void **state)
{
	struct warp one = bend(-0.5, 1.0, 1.7), other = bend(-0.5, 1.0, -1.7);
	struct random_stream r = {2};

	(void)state;
	for (int i = 0; i < 200; i++) {
		struct vec3 p = random_vec3(&r, 2.0), q = p;
		struct warp_jet a, b;

		q.x = -q.x;
		a = eval(&one, p, 2);
		b = eval(&other, q, 2);
		b.point.x = -b.point.x;
		assert_vec3(a.point, b.point, 1e-14);
		assert_near(a.second[2].zz, b.second[2].zz, 1e-12);
		assert_near(a.second[2].xz, -b.second[2].xz, 1e-12);
	}
}

/* Rates down to 0 go to the identity without loss. */
static void test_warp_bend_that_is_nearly_straight(void **state)
{
	const struct vec3 p = {0.3, -0.2, 0.9};

	(void)state;
	for (double rate = 1e-2; rate > 1e-320; rate *= 1e-3) {
		struct warp w = bend(0.0, 1.0, rate);
		struct warp_jet j = eval(&w, p, 2);

		/* the straight line deviates by rate/2 or so */
		assert_vec3(j.point, p, 0.7 * rate + 1e-15);
		assert_near(j.jacobian[0][0], 1.0, rate + 1e-15);
		assert_near(j.second[0].zz, -rate, 0.3 * rate + 1e-300);
	}
	assert_vec3(eval(&(struct warp){.type = WARP_BEND, .axis = up,
	    .direction = right, .from = 0.0, .to = 1.0}, p, 0).point, p, 1e-15);
}

/*
 * About the middle of an arc, where atan gives way to its series, the angle
 * about the centre, which is at x = 100, z = -10. Measured: 3.5e-15.
 */
static void test_warp_bend_has_no_step_at_its_series(void **state)
{
	struct warp w = bend(-10.0, 10.0, 0.01);

	(void)state;
	for (int i = 0; i < 1000; i++) {
		struct vec3 p = vec3(0.05, 0.0, 1e-4 * i);

		assert_near(eval(&w, p, 0).point.z,
		    atan2(p.z + 10.0, 100.0 - p.x) / 0.01 - 10.0, 1e-13);
	}
}

static void axes_step(struct vec3 p, int j, double h, struct vec3 *more,
    struct vec3 *less)
{
	const struct vec3 d = vec3(j == 0 ? h : 0.0, j == 1 ? h : 0.0,
	    j == 2 ? h : 0.0);

	*more = vec3_add(p, d);
	*less = vec3_sub(p, d);
}

static double component(struct vec3 v, int i)
{
	return i == 0 ? v.x : i == 1 ? v.y : v.z;
}

static double entry(const struct sym3 *h, int i, int j)
{
	const double all[3][3] = {{h->xx, h->xy, h->xz}, {h->xy, h->yy, h->yz},
	    {h->xz, h->yz, h->zz}};

	return all[i][j];
}

/* Whether the values and slopes about p do not agree with each other: there is
 * the cut of a bend. */
static bool is_cut(const struct warp_jet *more, const struct warp_jet *less)
{
	return vec3_norm(vec3_sub(more->point, less->point)) > 0.01;
}

/* First and second derivatives of every type, everywhere, against differences.
 * Measured: 3.6e-7 and 8.1e-5, near the centres of bends. */
static void test_warp_derivatives_are_those_of_differences(void **state)
{
	const double h = 1e-5;
	struct random_stream r = {3};
	int compared = 0;

	(void)state;
	for (int n = 0; n < 3000; n++) {
		struct warp w = random_warp(&r, (unsigned)n % WARP_TYPE_COUNT);
		struct vec3 more, less, p = random_vec3(&r, 1.5);
		struct warp_jet at = eval(&w, p, 2);
		struct basis b = basis_of(&w);
		struct vec3 o = place(&w, &b, vec3(1.0 / w.rate, 0.0, w.from));
		struct vec3 d = vec3_sub(p, o);

		/* not beside the centre, where the guard acts */
		if (w.type == WARP_BEND && hypot(vec3_dot(d, b.e1),
		    vec3_dot(d, b.u)) < 0.05)
			continue;
		for (int j = 0; j < 3; j++) {
			struct warp_jet f, g;

			axes_step(p, j, h, &more, &less);
			f = eval(&w, more, 1);
			g = eval(&w, less, 1);
			if (is_cut(&f, &g))
				continue;
			compared++;
			for (int i = 0; i < 3; i++) {
				assert_near(at.jacobian[i][j],
				    (component(f.point, i) -
				    component(g.point, i)) / (2.0 * h), 2e-6);
				for (int k = 0; k < 3; k++)
					assert_near(entry(at.second + i, j, k),
					    (f.jacobian[i][k] -
					    g.jacobian[i][k]) / (2.0 * h),
					    3e-4);
			}
		}
	}
	assert_true(compared > 8500);
}

static void test_warp_orders_beyond_are_null(void **state)
{
	struct random_stream r = {4};

	(void)state;
	for (unsigned type = 0; type < WARP_TYPE_COUNT; type++) {
		struct warp w = random_warp(&r, type);
		struct vec3 p = random_vec3(&r, 0.3);
		struct warp_jet full = eval(&w, p, 2), first = eval(&w, p, 1);
		struct warp_jet zeroth = eval(&w, p, 0);

		assert_vec3(zeroth.point, full.point, 0.0);
		assert_vec3(first.point, full.point, 0.0);
		for (int i = 0; i < 3; i++) {
			assert_near(first.jacobian[i][i], full.jacobian[i][i],
			    0.0);
			assert_near(zeroth.jacobian[i][i], 0.0, 0.0);
			assert_near(first.second[i].xz, 0.0, 0.0);
			assert_near(first.second[i].zz, 0.0, 0.0);
		}
	}
}

/* The greatest difference of any second derivative. */
static double bend_step(const struct warp_jet *a, const struct warp_jet *b)
{
	double most = 0.0;

	for (int i = 0; i < 3; i++)
		for (int j = 0; j < 3; j++)
			for (int k = 0; k < 3; k++)
				most = fmax(most, fabs(
				    entry(a->second + i, j, k) -
				    entry(b->second + i, j, k)));
	return most;
}

/*
 * Along a line through the whole range, where second derivatives reach 5 and
 * third ones 200: in steps of 1e-4 none jumps. Measured: 0.020.
 */
static void test_warp_second_derivatives_have_no_jumps(void **state)
{
	struct warp warps[3] = {twist(2.0), taper(0.0, 1.0, 0.4),
	    bend(0.0, 1.0, 1.1)};
	double steepest = 0.0, widest = 0.0;

	(void)state;
	warps[0].has_range = true;
	warps[0].to = 1.0;
	for (int n = 0; n < 3; n++) {
		struct warp_jet last = eval(warps + n, vec3(0.2, 0.3, -0.5), 2);

		for (int i = 1; i < 20000; i++) {
			struct warp_jet next = eval(warps + n,
			    vec3(0.2, 0.3, -0.5 + 1e-4 * i), 2);

			steepest = fmax(steepest, bend_step(&last, &next));
			widest = fmax(widest, fabs(next.second[0].zz));
			last = next;
		}
	}
	print_message("measured: steps of second derivatives %.2g, which reach "
	    "%.2g\n", steepest, widest);
	assert_true(steepest < 0.05);
	assert_true(widest > 1.0);
}

static bool is_finite(const struct warp_jet *w)
{
	bool all = isfinite(w->point.x) && isfinite(w->point.y) &&
	    isfinite(w->point.z);

	for (int i = 0; i < 3; i++)
		for (int j = 0; j < 3; j++) {
			all = all && isfinite(w->jacobian[i][j]);
			for (int k = 0; k < 3; k++)
				all = all && isfinite(entry(w->second + i, j,
				    k));
		}
	return all;
}

/* At and about a bend's centre; the derivatives stay below what the guard
 * lets through. */
static void test_warp_bend_at_its_centre(void **state)
{
	const double steps[] = {0.0, 5e-324, 1e-170, 1e-12, 1e-6, 1e-4};
	struct warp w = bend(0.0, 3.0, 0.5);

	(void)state;
	for (size_t i = 0; i < sizeof(steps) / sizeof(*steps); i++)
		for (int side = -1; side <= 1; side += 2) {
			struct vec3 p = vec3(2.0 + side * steps[i], 0.3,
			    0.5 * steps[i]);
			struct warp_jet j = eval(&w, p, 2);

			assert_true(is_finite(&j));
			assert_true(fabs(j.jacobian[2][2]) <= 1e3 + 1e-9);
			assert_true(fabs(j.second[2].zz) <= 1e6);
		}
}

/* Beyond all that a document may hold, to the reach of points. */
static void test_warp_stays_finite(void **state)
{
	const double far[] = {0.0, 1e-300, 1e-9, 1.0, 1e9, 1e12};
	struct random_stream r = {5};

	(void)state;
	for (int n = 0; n < 20000; n++) {
		struct warp w = random_warp(&r, (unsigned)n % WARP_TYPE_COUNT);
		double length = pow(10.0, random_in(&r, -9.0, 9.0));
		struct warp_jet j;

		w.to = w.from + length;
		w.rate = random_in(&r, -2.0 * PI, 2.0 * PI) / length;
		w.scale = pow(10.0, random_in(&r, -9.0, 9.0));
		w.axis = vec3_scale(pow(10.0, random_in(&r, -200.0, 200.0)),
		    w.axis);
		j = eval(&w, vec3_scale(far[random_below(&r, 6)],
		    random_vec3(&r, 1.0)), 2);
		if (!is_finite(&j))
			fail_msg("type %u, length %g, rate %g, scale %g",
			    w.type, length, w.rate, w.scale);
	}
}

static void test_warp_of_the_largest_doubles_is_finite(void **state)
{
	struct warp warps[3] = {twist(1.0), taper(0.0, 1.0, 0.5),
	    bend(0.0, 1.0, 1.0)};

	(void)state;
	for (int n = 0; n < 3; n++)
		for (int i = 0; i < 8; i++) {
			const double most = 1e150;
			struct warp_jet j = eval(warps + n, vec3(
			    i & 1 ? most : -most, i & 2 ? most : 0.0,
			    i & 4 ? most : -most), 2);

			assert_true(is_finite(&j));
		}
}

static void test_warp_stretch_is_that_of_the_taper(void **state)
{
	struct warp w = taper(0.0, 1.0, 0.25);
	double least, most;

	(void)state;
	warp_stretch(&w, &least, &most);
	assert_near(least, 1.0, 0.0);
	assert_near(most, 4.0, 0.0);
	w.scale = 5.0;
	warp_stretch(&w, &least, &most);
	assert_near(least, 0.2, 1e-16);
	assert_near(most, 1.0, 0.0);
	w = bend(0.0, 1.0, 1.0);
	w.scale = 7.0; /* not a bend's */
	warp_stretch(&w, &least, &most);
	assert_near(least, 1.0, 0.0);
	assert_near(most, 1.0, 0.0);
}

int main(void)
{
	const struct CMUnitTest tests[] = {
		cmocka_unit_test(test_warp_is_the_inverse_of_barr),
		cmocka_unit_test(test_warp_endless_twist_turns_everywhere),
		cmocka_unit_test(
		    test_warp_twist_turns_rigidly_beyond_its_range),
		cmocka_unit_test(
		    test_warp_taper_scales_evenly_beyond_its_range),
		cmocka_unit_test(test_warp_bend_at_known_points),
		cmocka_unit_test(
		    test_warp_bend_of_negative_rate_is_the_mirror_image),
		cmocka_unit_test(test_warp_bend_that_is_nearly_straight),
		cmocka_unit_test(test_warp_bend_has_no_step_at_its_series),
		cmocka_unit_test(
		    test_warp_derivatives_are_those_of_differences),
		cmocka_unit_test(test_warp_orders_beyond_are_null),
		cmocka_unit_test(test_warp_second_derivatives_have_no_jumps),
		cmocka_unit_test(test_warp_bend_at_its_centre),
		cmocka_unit_test(test_warp_stays_finite),
		cmocka_unit_test(test_warp_of_the_largest_doubles_is_finite),
		cmocka_unit_test(test_warp_stretch_is_that_of_the_taper),
	};

	return cmocka_run_group_tests_name("warp", tests, NULL, NULL);
}
