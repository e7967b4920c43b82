/*
 * Projections onto level sets (core/project.h), by the float64 evaluator.
 */
#include <stdarg.h>
#include <stddef.h>
#include <setjmp.h>
#include <stdint.h>
#include <cmocka.h>

#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "core/evaluate.h"
#include "core/output.h"
#include "core/project.h"
#include "core/tape.h"
#include "core/tree.h"
#include "proto/document.h"
#include "proto/fault.h"
#include "tests/support/fail_alloc.h"
#include "tests/support/near.h"
#include "tests/support/random_tree.h"

/* Of (1 - d^2/R^2)^3, whose value at d = 1 is 1/2: R. */
#define REACH 2.2016634851546026

#define POINT "{\"format\":\"blobfield/1\",\"root\":{\"type\":\"point\"," \
	"\"center\":[1,2,3],\"radius\":1}}"

struct truth {
	struct sampler sampler; /* the first member */
	const struct tape *tape;
	size_t calls, calls_most; /* after which it is cancelled; 0: never */
};

static enum err sample(struct sampler *s, const float *points, size_t count,
    unsigned outputs, float *rows)
{
	struct truth *t = (struct truth *)s;

	assert_int_equal(outputs, OUTPUT_VALUE | OUTPUT_GRADIENT);
	if (t->calls++ == t->calls_most && t->calls_most > 0)
		return ERR_CANCELLED;
	for (size_t i = 0; i < count; i++) {
		struct jet f;

		evaluate(t->tape, (struct vec3){points[3 * i],
		    points[3 * i + 1], points[3 * i + 2]}, 1, &f);
		rows[4 * i] = (float)f.value;
		rows[4 * i + 1] = (float)f.gradient.x;
		rows[4 * i + 2] = (float)f.gradient.y;
		rows[4 * i + 3] = (float)f.gradient.z;
	}
	return ERR_OK;
}

static struct document *parse(const char *text)
{
	const struct document_limits limits = {.max_nodes = 100};
	struct faults faults = {0};
	struct document *d;

	assert_int_equal(document_parse(text, strlen(text), &limits, &d,
	    &faults), ERR_OK);
	return d;
}

static void run(const char *text, double iso, double max_distance,
    const float *points, size_t count, struct projection *out)
{
	struct document *d = parse(text);
	struct truth t = {{sample, NULL}, document_tape(d), 0, 0};

	assert_int_equal(project(iso, max_distance, points, count, &t.sampler,
	    out), ERR_OK);
	document_free(d);
}

/* Along the radius, from both sides, down to the rim and the middle. */
static void test_project_onto_a_sphere(void **state)
{
	static const double from[] = {2.19, 2.0, 1.5, 1.1, 1.0, 0.9, 0.5, 0.1,
	    0.01, 1e-4};
	const struct vec3 u = {0.6, -0.64, 0.48};

	(void)state;
	for (size_t i = 0; i < sizeof from / sizeof *from; i++) {
		const float p[3] = {(float)(1.0 + from[i] * u.x),
		    (float)(2.0 + from[i] * u.y), (float)(3.0 + from[i] * u.z)};
		struct projection r;

		run(POINT, 0.5, INFINITY, p, 1, &r);
		assert_true(r.converged);
		/* |f - iso| may be 1.5e-5, and the slope is 0.78 */
		assert_near(r.distance, from[i] - 1.0, 3e-5);
		assert_near(r.value, 0.5, 1.5e-5);
		/* The middle's gradient turns by float32 of the point. */
		assert_near(r.normal[0], u.x, from[i] < 1e-3 ? 5e-3 : 2e-5);
		assert_near(r.normal[1], u.y, from[i] < 1e-3 ? 5e-3 : 2e-5);
		assert_near(r.position[2], 3.0 + u.z, from[i] < 1e-3 ? 5e-3 :
		    3e-5);
	}
}

static void test_project_onto_another_level(void **state)
{
	const float p[3] = {1.0f, 2.0f, 4.5f};
	struct projection r;

	(void)state;
	run(POINT, 0.1, INFINITY, p, 1, &r);
	assert_true(r.converged);
	assert_near(r.position[2], 3.0 + REACH * sqrt(1.0 - cbrt(0.1)), 1e-4);
}

static void test_project_stays_without_gradient(void **state)
{
	const float p[6] = {9.0f, 9.0f, 9.0f, 1.0f, 2.0f, 3.0f};
	struct projection r[2];

	(void)state;
	run(POINT, 0.5, INFINITY, p, 2, r);
	for (int i = 0; i < 2; i++) {
		assert_false(r[i].converged);
		assert_memory_equal(r[i].position, p + 3 * i,
		    sizeof r[i].position);
		assert_near(r[i].distance, 0.0, 0.0);
		assert_near(r[i].normal[0], 0.0, 0.0);
	}
	assert_near(r[0].value, 0.0, 0.0);
	assert_near(r[1].value, 1.0, 0.0);
}

static void test_project_goes_no_further_than_it_may(void **state)
{
	const float p[3] = {1.0f, 2.0f, 4.9f};
	struct projection r;

	(void)state;
	run(POINT, 0.5, 0.5, p, 1, &r);
	assert_false(r.converged);
	assert_true(r.distance <= 0.5f);
	assert_true(r.distance > 0.4f);
	run(POINT, 0.5, 0.95, p, 1, &r);
	assert_true(r.converged);
	assert_near(r.distance, 0.9, 3e-5);
}

static void test_project_nothing(void **state)
{
	struct projection r;

	(void)state;
	run(POINT, 0.5, INFINITY, NULL, 0, &r);
}

struct tally {
	size_t moved, converged, off;
	double worst;
};

static void count_tree(const struct random_tree_options *options,
    struct tally *tally)
{
	enum { POINTS = 200 };
	struct random_tree *tree = random_tree_create(options);
	struct truth t = {{sample, NULL}, NULL, 0, 0};
	struct projection r[POINTS];
	struct tape_error error;
	struct tape *tape;
	float xyz[3 * POINTS];

	assert_int_equal(tape_compile(random_tree_get(tree), 1000, &tape,
	    &error), ERR_OK);
	random_tree_points(tree, tape, 5, POINTS, xyz);
	t.tape = tape;
	assert_int_equal(project(0.5, INFINITY, xyz, POINTS, &t.sampler, r),
	    ERR_OK);
	for (int k = 0; k < POINTS; k++) {
		const double over = fabs(r[k].value - 0.5);

		assert_true(isfinite(r[k].distance) && isfinite(r[k].value));
		tally->moved += r[k].distance != 0.0f;
		tally->converged += r[k].converged;
		if (!r[k].converged)
			continue;
		tally->off += over > 1e-4;
		if (over <= 1e-4)
			tally->worst = fmax(tally->worst, over);
	}
	tape_free(tape);
	random_tree_free(tree);
}

/* What is said to have converged is on the surface, or where the field jumps
 * across it. */
static void test_project_about_random_trees(void **state)
{
	struct tally any = {0}, smooth = {0};

	(void)state;
	for (uint64_t i = 0; i < 30; i++) {
		count_tree(&(struct random_tree_options){.seed = 77 + i,
		    .whole = true}, &any);
		count_tree(&(struct random_tree_options){.seed = 77 + i,
		    .no_sharp = true, .only_soft = true}, &smooth);
	}
	print_message("measured: any: %zu moved, %zu converged, %zu off; "
	    "smooth: %zu moved, %zu converged, %zu off, others by %.1e\n",
	    any.moved, any.converged, any.off, smooth.moved, smooth.converged,
	    smooth.off, smooth.worst);
	assert_true(any.off <= any.converged / 100);
	/* Others reach tops under 0.5, or come to rest on a crease. */
	assert_true(smooth.converged > smooth.moved * 8 / 10);
	assert_true(smooth.off <= smooth.converged / 500);
}

static void test_project_is_cancelled(void **state)
{
	struct document *d = parse(POINT);
	struct truth t = {{sample, NULL}, document_tape(d), 0, 2};
	const float p[3] = {1.0f, 2.0f, 4.5f};
	struct projection r;

	(void)state;
	assert_int_equal(project(0.5, INFINITY, p, 1, &t.sampler, &r),
	    ERR_CANCELLED);
	document_free(d);
}

static void test_project_without_memory(void **state)
{
	const float p[3] = {1.0f, 2.0f, 4.5f};
	struct truth t = {{sample, NULL}, NULL, 0, 0};
	struct projection r;
	struct document *d;
	enum err err = ERR_MEMORY;

	(void)state;
	if (!fail_alloc_available())
		skip();
	d = parse(POINT);
	t.tape = document_tape(d);
	for (long n = 1; err != ERR_OK; n++) {
		fail_alloc_set(n);
		err = project(0.5, INFINITY, p, 1, &t.sampler, &r);
		assert_int_equal(fail_alloc_live(), 0);
		assert_int_equal(err, fail_alloc_happened() ? ERR_MEMORY :
		    ERR_OK);
	}
	fail_alloc_set(0);
	document_free(d);
}

int main(void)
{
	const struct CMUnitTest tests[] = {
		cmocka_unit_test(test_project_onto_a_sphere),
		cmocka_unit_test(test_project_onto_another_level),
		cmocka_unit_test(test_project_stays_without_gradient),
		cmocka_unit_test(test_project_goes_no_further_than_it_may),
		cmocka_unit_test(test_project_nothing),
		cmocka_unit_test(test_project_about_random_trees),
		cmocka_unit_test(test_project_is_cancelled),
		cmocka_unit_test(test_project_without_memory),
	};

	return cmocka_run_group_tests(tests, NULL, NULL);
}
