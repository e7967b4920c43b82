/*
 * Ranges against values: none is outside of its box's range.
 */
#include <stdarg.h>
#include <stddef.h>
#include <setjmp.h>
#include <stdint.h>
#include <cmocka.h>

#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <time.h>

#include "core/evaluate.h"
#include "core/range.h"
#include "core/range_parts.h"
#include "core/sampler.h"
#include "core/tape.h"
#include "core/tree.h"
#include "tests/support/fail_alloc.h"
#include "tests/support/near.h"
#include "tests/support/random_tree.h"
#include "tests/support/sanitized.h"

#define MAX_NODES 100000
#define TIMES(n) (SANITIZED ? (n) / 8 : (n))

static struct tape *compile(const struct node *root)
{
	const struct tree tree = {root, TREE_NULL_GRADIENT};
	struct tape_error error;
	struct tape *tape;

	assert_int_equal(tape_compile(&tree, MAX_NODES, &tape, &error), ERR_OK);
	return tape;
}

static double value_at(const struct tape *tape, struct vec3 p)
{
	struct jet f;

	evaluate(tape, p, 0, &f);
	return f.value;
}

static struct vec3 random_vec3(struct random_stream *r, double reach)
{
	double x = random_in(r, -reach, reach), y = random_in(r, -reach, reach);

	return vec3(x, y, random_in(r, -reach, reach));
}

/* A box about c. */
static struct tape_box box_about(struct vec3 c, struct random_stream *r,
    double size)
{
	const double at[3] = {c.x, c.y, c.z};
	struct tape_box box;

	for (int i = 0; i < 3; i++) {
		double h = size * random_in(r, 0.3, 1.0);
		double off = h * random_in(r, -1.0, 1.0);

		box.min[i] = (float)(at[i] + off - h);
		box.max[i] = (float)(at[i] + off + h);
	}
	return box;
}

/* A point of box: often of a face, an edge or a corner of it. */
static struct vec3 point_in(const struct tape_box *box,
    struct random_stream *r)
{
	double x[3];

	for (int i = 0; i < 3; i++) {
		int where = random_below(r, 6);

		x[i] = where == 0 ? box->min[i] : where == 1 ? box->max[i] :
		    random_in(r, box->min[i], box->max[i]);
	}
	return vec3(x[0], x[1], x[2]);
}

/* What was found: how often, and how wide ranges are beside what values span. */
struct tally {
	size_t samples, boxes;
	double ranged, spanned, worst;
};

static void check_box(const struct range_tape *r, const struct tape *tape,
    const struct prune_list *whole, struct prune_list *part,
    const struct tape_box *box, struct random_stream *s, struct tally *tally)
{
	struct range plain = range_eval(r, whole, box), range;
	double least = INFINITY, most = -INFINITY;

	range_prune(r, whole, box, part);
	range = range_eval(r, part, box);
	assert_false(isnan(range.least) || isnan(range.most) ||
	    isnan(plain.least) || isnan(plain.most));
	assert_true(range.least >= 0.0 && range.least <= range.most);
	for (int i = 0; i < 40; i++) {
		struct vec3 p = point_in(box, s);
		double f = value_at(tape, p);
		double margin = RANGE_MARGIN * fmax(1.0, f);
		double over = fmax(range.least + margin * 0.99 - f,
		    f - range.most + margin * 0.99);

		/* The margin is for devices: this evaluator is within it. */
		if (range.least > 0.0 || f > range.most - margin * 0.99)
			tally->worst = fmax(tally->worst, over);
		assert_true(f >= range.least && f <= range.most);
		assert_true(f >= plain.least && f <= plain.most);
		least = fmin(least, f);
		most = fmax(most, f);
		tally->samples++;
	}
	tally->boxes++;
	tally->ranged += fmax(range.most - range.least - 2.0 * RANGE_MARGIN,
	    0.0);
	tally->spanned += most - least;
}

static void check_tree(const struct random_tree_options *options, int boxes,
    double size, struct tally *tally)
{
	struct random_tree *t = random_tree_create(options);
	struct tape *tape = compile(random_tree_get(t)->root);
	struct random_stream s = {options->seed * 77 + 5};
	struct prune_list whole, part;
	struct range_tape *r;
	float *points = malloc((size_t)boxes * 3 * sizeof *points);

	random_tree_points(t, tape, options->seed, (size_t)boxes, points);
	assert_int_equal(range_tape_create(tape, &r), ERR_OK);
	whole = range_whole(r);
	assert_int_equal(range_list_create(&whole, &part), ERR_OK);
	for (int i = 0; i < boxes; i++) {
		const float *p = points + 3 * i;
		struct tape_box box = box_about(vec3(p[0], p[1], p[2]), &s,
		    size * exp2(random_in(&s, -6.0, 2.0)));

		check_box(r, tape, &whole, &part, &box, &s, tally);
	}
	range_list_free(&part);
	range_tape_free(r);
	tape_free(tape);
	random_tree_free(t);
	free(points);
}

static void report(const struct tally *t)
{
	printf("measured: %zu samples of %zu boxes, none outside; ranges %.2f "
	    "times as wide as the values found; beyond by %.1e at most without "
	    "the margin\n", t->samples, t->boxes, t->ranged / t->spanned,
	    fmax(t->worst, 0.0));
}

static void test_values_are_within_ranges_of_random_trees(void **state)
{
	struct tally tally = {0};

	(void)state;
	for (uint64_t seed = 1; seed <= TIMES(220); seed++)
		check_tree(&(struct random_tree_options){.seed = seed,
		    .whole = seed % 2, .max_primitives = 3 + (int)(seed % 14)},
		    60, 1.0, &tally);
	report(&tally);
}

static bool has_angles(const struct tape *tape)
{
	for (size_t i = 0; i < tape->operator_count; i++)
		if (!opening_is_constant(&tape->operators[i].opening))
			return true;
	return false;
}

/* Where no angle is to be known: small boxes' ranges are their values. */
static void test_ranges_of_small_boxes_shrink_to_the_value(void **state)
{
	double worst = 0.0;
	int boxes = 0;

	(void)state;
	for (uint64_t seed = 1; seed <= TIMES(150); seed++) {
		const struct random_tree_options options = {.seed = seed,
		    .max_primitives = 6};
		struct random_tree *t = random_tree_create(&options);
		struct tape *tape = compile(random_tree_get(t)->root);
		struct random_stream s = {seed};
		struct prune_list whole;
		struct range_tape *r;
		float points[60];

		random_tree_points(t, tape, seed, 20, points);
		assert_int_equal(range_tape_create(tape, &r), ERR_OK);
		whole = range_whole(r);
		for (int i = 0; i < 20 && !has_angles(tape); i++) {
			struct vec3 p = {points[3 * i], points[3 * i + 1],
			    points[3 * i + 2]};
			struct tape_box box = box_about(p, &s, 1e-6);
			struct range range = range_eval(r, &whole, &box);

			worst = fmax(worst, (range.most - range.least) /
			    fmax(1.0, range.most) - 2.0 * RANGE_MARGIN);
			boxes++;
		}
		range_tape_free(r);
		tape_free(tape);
		random_tree_free(t);
	}
	printf("measured: %d boxes of 1e-6: ranges wider than their margins by "
	    "%.1e at most\n", boxes, worst);
	assert_true(boxes > TIMES(100));
	/* measured 7.5e-4: two times what tables of phi and silhouettes err */
	assert_true(worst < 5e-3);
}

/* ---- stretches of rays ---- */

struct slopes {
	size_t stretches, steps, straight;
	double sloped, measured; /* the widths of slopes and of what was found */
};

static void check_stretch(const struct range_tape *r, const struct tape *tape,
    struct vec3 a, struct vec3 b, struct slopes *tally)
{
	enum { STEPS = 40 };
	const struct prune_list whole = range_whole(r);
	bool angles = has_angles(tape);
	double last = NAN, least = INFINITY, most = -INFINITY;
	struct held held;

	range_stretch(r, &whole, a, b, &held);
	assert_false(isnan(held.fall) || isnan(held.rise));
	for (int i = 0; i <= STEPS; i++) {
		double t = i / (double)STEPS, slope;
		double f = value_at(tape, vec3_axpy(t, vec3_sub(b, a), a));

		/* without the margin: what tables of phi err is in it */
		assert_true(f >= held.least - 1e-4 && f <= held.most + 1e-4);
		slope = (f - last) * STEPS / 2.0;
		last = f;
		if (i == 0 || angles)
			continue;
		assert_true(slope >= held.fall - 1e-6 * (1.0 - held.fall) &&
		    slope <= held.rise + 1e-6 * (1.0 + held.rise));
		least = fmin(least, slope);
		most = fmax(most, slope);
		tally->steps++;
	}
	tally->stretches++;
	if (angles || held.rise > 1e6)
		return;
	tally->straight += held.fall >= 0.0 || held.rise <= 0.0;
	tally->sloped += held.rise - held.fall;
	tally->measured += most - least;
}

static void test_stretches_hold_values_and_slopes(void **state)
{
	struct slopes tally = {0};

	(void)state;
	for (uint64_t seed = 1; seed <= TIMES(240); seed++) {
		const struct random_tree_options options = {.seed = seed,
		    .whole = seed % 2, .max_primitives = 1 + (int)(seed % 6),
		    .no_refs = true};
		struct random_tree *t = random_tree_create(&options);
		struct tape *tape = compile(random_tree_get(t)->root);
		struct random_stream s = {seed};
		struct range_tape *r;
		float points[60];

		random_tree_points(t, tape, seed, 20, points);
		assert_int_equal(range_tape_create(tape, &r), ERR_OK);
		for (int i = 0; i < 20; i++) {
			struct vec3 p = {points[3 * i], points[3 * i + 1],
			    points[3 * i + 2]};

			check_stretch(r, tape, p, vec3_axpy(
			    exp2(random_in(&s, -10.0, 0.0)),
			    random_vec3(&s, 1.0), p), &tally);
		}
		range_tape_free(r);
		tape_free(tape);
		random_tree_free(t);
	}
	printf("measured: %zu steps of %zu stretches, none steeper; slopes "
	    "%.1f times as wide as those found\n", tally.steps,
	    tally.stretches, tally.sloped / tally.measured);
}

/* ---- extents ---- */

static void test_extents_hold_the_surface_and_little_else(void **state)
{
	const struct tape_box domain = {{-100.0f, -100.0f, -100.0f},
	    {100.0f, 100.0f, 100.0f}};
	struct node node = {.type = NODE_PRIMITIVE, .primitive = {
	    .type = PRIMITIVE_TORUS, .a = {3.0, -20.0, 50.0},
	    .normal = {0.0, 0.0, 1.0}, .major = 2.0, .minor = 0.5,
	    .falloff = 0.25}};
	struct tape *tape = compile(&node);
	struct range_tape *r;
	struct tape_box box;

	(void)state;
	assert_int_equal(range_tape_create(tape, &r), ERR_OK);
	assert_int_equal(range_extent(r, 0.5, &domain, 0.02, NULL, &box), ERR_OK);
	/* 5 long: 0.02 of that, and the margin */
	assert_true(box.min[0] <= 0.5f && box.min[0] > 0.4f);
	assert_true(box.max[0] >= 5.5f && box.max[0] < 5.6f);
	assert_true(box.min[1] <= -22.5f && box.min[1] > -22.6f);
	assert_true(box.min[2] <= 49.5f && box.min[2] > 49.4f);
	assert_true(box.max[2] >= 50.5f && box.max[2] < 50.6f);
	/* nothing is as high, or there */
	assert_int_equal(range_extent(r, 1.5, &domain, 0.02, NULL, &box), ERR_OK);
	assert_true(box.min[0] > box.max[0]);
	assert_int_equal(range_extent(r, 0.5, &(struct tape_box){
	    {-9.0f, -9.0f, -9.0f}, {9.0f, 9.0f, 9.0f}}, 0.02, NULL, &box), ERR_OK);
	assert_true(box.min[0] > box.max[0]);
	range_tape_free(r);
	tape_free(tape);
}

static double seconds(void)
{
	struct timespec t;

	clock_gettime(CLOCK_PROCESS_CPUTIME_ID, &t);
	return (double)t.tv_sec + 1e-9 * (double)t.tv_nsec;
}

/* Every place of random trees' surfaces is within their extents. */
static void test_extents_of_random_trees_hold_their_surfaces(void **state)
{
	enum { POINTS = 400 };
	const struct tape_box domain = {{-20.0f, -20.0f, -20.0f},
	    {20.0f, 20.0f, 20.0f}};
	double time = 0.0;
	int count = 0;

	(void)state;
	for (uint64_t seed = 1; seed <= TIMES(40); seed++) {
		struct random_tree *t = random_tree_create(
		    &(struct random_tree_options){.seed = seed,
		    .whole = seed % 2});
		struct tape *tape = compile(random_tree_get(t)->root);
		float points[3 * POINTS];
		struct range_tape *r;
		struct tape_box box;

		random_tree_points(t, tape, seed, POINTS, points);
		assert_int_equal(range_tape_create(tape, &r), ERR_OK);
		time -= seconds();
		assert_int_equal(range_extent(r, 0.5, &domain, 0.02, NULL, &box),
		    ERR_OK);
		time += seconds();
		for (int i = 0; i < POINTS; i++) {
			const float *p = points + 3 * i;
			double f = value_at(tape, vec3(p[0], p[1], p[2]));

			if (fabs(f - 0.5) > 0.9 * RANGE_MARGIN)
				continue;
			for (int k = 0; k < 3; k++)
				assert_true(fabsf(p[k]) > 20.0f ||
				    (p[k] >= box.min[k] && p[k] <= box.max[k]));
			count++;
		}
		range_tape_free(r);
		tape_free(tape);
		random_tree_free(t);
	}
	printf("measured: %.2f ms an extent; %d places of surfaces, all in "
	    "it\n", 1e3 * time / TIMES(40), count);
	assert_true(count > TIMES(200));
}

/* A sampler that is asked, but never to sample. */
struct patient {
	struct sampler sampler;
	int looks, patience;
};

static bool look(struct sampler *s, const char *stage, double done)
{
	struct patient *p = (struct patient *)s;

	assert_string_equal(stage, "extent");
	assert_true(done >= 0.0 && done <= 1.0);
	return ++p->looks < p->patience;
}

/* Each of COUNT instructions' ranges is many: what is spent has an end, what is
 * found then holds the surface, and it can be stopped. */
static void test_extents_of_many_primitives_end_and_are_stopped(void **state)
{
	enum { COUNT = 20000 };
	static struct node points[COUNT], *children[COUNT];
	struct node node = {.type = NODE_SUM, .children = children,
	    .child_count = COUNT};
	const struct tape_box domain = {{-1e5f, -1e5f, -1e5f},
	    {1e5f, 1e5f, 1e5f}};
	struct patient patient = {{.go_on = look}, 0, 1 << 30};
	struct random_stream s = {3};
	struct tape_box box;
	struct range_tape *r;
	struct tape *tape;
	double time;

	(void)state;
	for (int i = 0; i < COUNT; i++) {
		points[i] = (struct node){.type = NODE_PRIMITIVE,
		    .primitive = {.type = PRIMITIVE_POINT,
		    .a = random_vec3(&s, 1.0), .radius = {0.05},
		    .exponent = 3.0, .weight = 1.0}};
		children[i] = points + i;
	}
	tape = compile(&node);
	assert_int_equal(range_tape_create(tape, &r), ERR_OK);
	time = -seconds();
	assert_int_equal(range_extent(r, 0.5, &domain, 0.02, &patient.sampler,
	    &box), ERR_OK);
	time += seconds();
	printf("measured: %.0f ms, %d looks; to %g, of 1.03\n", 1e3 * time,
	    patient.looks, (double)box.max[0]);
	for (int i = 0; i < COUNT; i += 100)
		assert_true(value_at(tape, points[i].primitive.a) < 0.5 ||
		    (points[i].primitive.a.x >= box.min[0] &&
		    points[i].primitive.a.x <= box.max[0]));
	for (int k = 0; k < 3; k++)
		assert_true(box.min[k] > -1.3f && box.max[k] < 1.3f);
	/* measured 0.1 s; without an end to it, much more */
	assert_true(SANITIZED || time < 1.5);
	assert_true(patient.looks > 20);
	patient = (struct patient){{.go_on = look}, 0, 5};
	assert_int_equal(range_extent(r, 0.5, &domain, 0.02, &patient.sampler,
	    &box), ERR_CANCELLED);
	assert_int_equal(patient.looks, 5);
	range_tape_free(r);
	tape_free(tape);
}

static void test_every_failed_allocation_is_told(void **state)
{
	const struct random_tree_options options = {.seed = 27,
	    .whole = true, .max_primitives = 12};
	const struct tape_box domain = {{-9.0f, -9.0f, -9.0f},
	    {9.0f, 9.0f, 9.0f}};
	struct random_tree *t;
	struct tape *tape;
	int failed = 0;

	(void)state;
	if (!fail_alloc_available())
		skip();
	t = random_tree_create(&options);
	tape = compile(random_tree_get(t)->root);
	for (long n = 1;; n++) {
		struct range_tape *r = NULL;
		struct tape_box box;
		enum err err;

		fail_alloc_set(n);
		err = range_tape_create(tape, &r);
		if (err == ERR_OK)
			err = range_extent(r, 0.5, &domain, 0.2, NULL,
			    &box);
		range_tape_free(r);
		assert_int_equal(fail_alloc_live(), 0);
		if (!fail_alloc_happened())
			break;
		assert_int_equal(err, ERR_MEMORY);
		failed++;
	}
	fail_alloc_set(0);
	assert_true(failed >= 6);
	tape_free(tape);
	random_tree_free(t);
}

int main(void)
{
	const struct CMUnitTest tests[] = {
		cmocka_unit_test(test_values_are_within_ranges_of_random_trees),
		cmocka_unit_test(
		    test_ranges_of_small_boxes_shrink_to_the_value),
		cmocka_unit_test(test_every_failed_allocation_is_told),
		cmocka_unit_test(test_stretches_hold_values_and_slopes),
		cmocka_unit_test(test_extents_hold_the_surface_and_little_else),
		cmocka_unit_test(
		    test_extents_of_random_trees_hold_their_surfaces),
		cmocka_unit_test(
		    test_extents_of_many_primitives_end_and_are_stopped),
	};

	return cmocka_run_group_tests(tests, NULL, NULL);
}
