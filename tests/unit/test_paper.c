/*
 * The four problems of classic blends that the paper's Fig. 4 shows, measured
 * on values: each with `camel`, which ends it, and with `blend` (theta = 0 at
 * every angle), which has it, so that the test knows what it looks for.
 */
#include <math.h>
#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>
#include <stdio.h>
#include <string.h>

#include <cmocka.h>

#include "core/evaluate.h"
#include "core/tape.h"
#include "proto/document.h"
#include "proto/fault.h"
#include "tests/support/near.h"

static struct document *model(const char *operator, const char *children)
{
	struct document_limits limits = {.max_nodes = 100,
	    .layout = LAYOUT_WARPED};
	struct faults faults = {0};
	struct document *d;
	char text[2048];

	snprintf(text, sizeof(text), "{\"format\": \"blobfield/1\", \"root\": "
	    "{\"type\": \"union\", \"operator\": \"%s\", \"children\": [%s]}}",
	    operator, children);
	if (document_parse(text, strlen(text), &limits, &d, &faults))
		fail_msg("%s: %s", faults.list[0].pointer, faults.list[0].detail);
	return d;
}

static double field(const struct document *d, double x, double y, double z)
{
	struct jet jet;

	evaluate(document_tape(d), vec3(x, y, z), 0, &jet);
	return jet.value;
}

/* How far from a (inside) towards b (outside) the iso-surface lies. */
static double reach(const struct document *d, struct vec3 a, struct vec3 b)
{
	double low = 0.0, high = 1.0;

	for (int i = 0; i < 50; i++) {
		double t = 0.5 * (low + high);
		struct vec3 p = vec3_axpy(t, vec3_sub(b, a), a);

		if (field(d, p.x, p.y, p.z) > 0.5)
			low = t;
		else
			high = t;
	}
	return low * vec3_norm(vec3_sub(b, a));
}

/* Fig. 4(a): a T of two segments of radius 0.3, the height above its bar. */
static double bulge_above_t(const char *operator)
{
	struct document *d = model(operator,
	    "{\"type\":\"segment\",\"a\":[-1.5,0,0],\"b\":[1.5,0,0],\"radius\":0.3},"
	    "{\"type\":\"segment\",\"a\":[0,0,-2],\"b\":[0,0,0],\"radius\":0.3}");
	double height = reach(d, vec3(0, 0, 0), vec3(0, 0, 2));

	document_free(d);
	return height - 0.3;
}

static void test_t_has_no_bulge_with_camel(void **state)
{
	double camel = bulge_above_t("camel"), blend = bulge_above_t("blend");

	(void)state;
	print_message("measured: bulge over a T of radius 0.3: camel %.1e, "
	    "blend %.3f\n", camel, blend);
	assert_near(camel, 0.0, 1e-9);
	assert_true(blend > 0.03);
}

/* Fig. 4(b): parallel segments of radius 0.3, 0.05 apart. */
static double value_between(const char *operator)
{
	struct document *d = model(operator,
	    "{\"type\":\"segment\",\"a\":[-1,0,0],\"b\":[1,0,0],\"radius\":0.3},"
	    "{\"type\":\"segment\",\"a\":[-1,0.65,0],\"b\":[1,0.65,0],\"radius\":0.3}");
	double most = 0.0;

	/* The whole plane between them. */
	for (double x = -1.5; x <= 1.5; x += 0.05)
		for (double z = -0.5; z <= 0.5; z += 0.05)
			most = fmax(most, field(d, x, 0.325, z));
	document_free(d);
	return most;
}

static void test_near_segments_do_not_merge_with_camel(void **state)
{
	double camel = value_between("camel"), blend = value_between("blend");

	(void)state;
	print_message("measured: largest value between segments 0.05 apart: "
	    "camel %.3f, blend %.3f\n", camel, blend);
	assert_true(camel < 0.46);
	assert_true(blend > 0.53);
}

/* Fig. 4(c): a thread of radius 0.02 along a bar of radius 1: how far it
 * stands out, over its radius. */
static double swelling_of_thread(const char *operator)
{
	struct document *d = model(operator,
	    "{\"type\":\"segment\",\"a\":[-3,0,0],\"b\":[3,0,0],\"radius\":1},"
	    "{\"type\":\"segment\",\"a\":[-1,0,1],\"b\":[1,0,1],\"radius\":0.02}");
	double height = reach(d, vec3(0, 0, 0), vec3(0, 0, 2)) - 1.0;

	document_free(d);
	return height / 0.02;
}

static void test_detail_does_not_blow_up_with_camel(void **state)
{
	double camel = swelling_of_thread("camel");
	double blend = swelling_of_thread("blend");

	(void)state;
	print_message("measured: height of a thread on a bar over its radius: "
	    "camel %.6f, blend %.2f\n", camel, blend);
	assert_near(camel, 1.0, 1e-9);
	assert_true(blend > 1.2);
}

/* Fig. 4(d), 1(a): a letter A with a small hole, the least value along the line
 * from its bar to its top: under 0.5 if there is a hole. */
static double value_in_hole(const char *operator)
{
	struct document *d = model(operator,
	    "{\"type\":\"segment\",\"a\":[-1,0,0],\"b\":[0,0,2.4],\"radius\":0.2},"
	    "{\"type\":\"segment\",\"a\":[1,0,0],\"b\":[0,0,2.4],\"radius\":0.2},"
	    "{\"type\":\"segment\",\"a\":[-0.3125,0,1.65],\"b\":[0.3125,0,1.65],"
	    "\"radius\":0.15}");
	double least = 1.0;

	for (double z = 1.65; z < 2.2; z += 0.005)
		least = fmin(least, field(d, 0, 0, z));
	document_free(d);
	return least;
}

static void test_hole_of_the_a_stays_open_with_camel(void **state)
{
	double camel = value_in_hole("camel"), blend = value_in_hole("blend");
	double sharp = value_in_hole("sharp");

	(void)state;
	print_message("measured: least value in the A's hole: sharp %.3f, "
	    "camel %.3f, blend %.3f\n", sharp, camel, blend);
	assert_true(camel < 0.48);
	assert_true(blend > 0.52);
}

int main(void)
{
	const struct CMUnitTest tests[] = {
		cmocka_unit_test(test_t_has_no_bulge_with_camel),
		cmocka_unit_test(test_near_segments_do_not_merge_with_camel),
		cmocka_unit_test(test_detail_does_not_blow_up_with_camel),
		cmocka_unit_test(test_hole_of_the_a_stays_open_with_camel),
	};

	return cmocka_run_group_tests_name("paper", tests, NULL, NULL);
}
