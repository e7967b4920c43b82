/*
 * One-shot evaluation over the wire against the float64 evaluator.
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

#include <cjson/cJSON.h>

#include "core/evaluate.h"
#include "core/tape.h"
#include "proto/document.h"
#include "proto/fault.h"
#include "tests/support/daemon.h"
#include "tests/support/http.h"
#include "tests/support/near.h"

/* The device against float64: at most 2e-3 is asked for; the values of these
 * scenes were measured to differ by less than 2e-4, from the tables. */
#define VALUE_TOLERANCE 2e-3

static const char letter_a[] =
    "{\"format\":\"blobfield/1\",\"root\":{\"type\":\"union\","
    "\"operator\":\"camel\",\"children\":["
    "{\"type\":\"segment\",\"a\":[-1,0,0],\"b\":[0,0,2.6],\"radius\":0.2},"
    "{\"type\":\"segment\",\"a\":[1,0,0],\"b\":[0,0,2.6],\"radius\":0.2},"
    "{\"type\":\"segment\",\"a\":[-0.69,0,0.8],\"b\":[0.69,0,0.8],"
    "\"radius\":0.16}]}}";

static const char mixed[] =
    "{\"format\":\"blobfield/1\",\"root\":{\"type\":\"difference\","
    "\"operator\":\"clean\",\"children\":["
    "{\"type\":\"intersection\",\"operator\":\"contact\",\"children\":["
    "{\"type\":\"sphere\",\"center\":[0,0,0],\"radius\":1,\"falloff\":0.5},"
    "{\"type\":\"box\",\"center\":[0,0,0],\"half_size\":[0.9,0.9,0.9],"
    "\"rounding\":0.05,\"falloff\":0.5}]},"
    "{\"type\":\"cylinder\",\"a\":[0,0,-2],\"b\":[0,0,2],\"radius\":0.4,"
    "\"falloff\":0.3}]}}";

static const char own_operator[] =
    "{\"format\":\"blobfield/1\",\"operators\":{\"joint\":{\"profile\":"
    "{\"type\":\"bulge\",\"k\":0.35},\"opening\":{\"alpha\":"
    "[0,1.5708,3.1416],\"theta\":[0.7854,0,0.7854],\"w\":[1,1]}}},"
    "\"root\":{\"type\":\"union\",\"operator\":\"joint\",\"children\":["
    "{\"type\":\"point\",\"center\":[0,0,0],\"radius\":0.5},"
    "{\"type\":\"point\",\"center\":[0.8,0,0.3],\"radius\":0.4}]}}";

#define POINT_COUNT 300

/* Points on a skew line through the scenes. */
static struct vec3 point(int i)
{
	double s = (double)i / (POINT_COUNT - 1);

	return vec3((double)(float)(-1.2 + 2.4 * s),
	    (double)(float)(0.3 * sin(9.0 * s)), (double)(float)(2.8 * s));
}

/* A body that asks for scene at all points. */
static char *make_body(const char *scene, const char *rest)
{
	size_t size = strlen(scene) + 100 * POINT_COUNT;
	char *body = malloc(size);
	size_t length = (size_t)snprintf(body, size,
	    "{\"scene\":%s,\"points\":[", scene);

	for (int i = 0; i < POINT_COUNT; i++) {
		struct vec3 p = point(i);

		length += (size_t)snprintf(body + length, size - length,
		    "%s[%.9g,%.9g,%.9g]", i > 0 ? "," : "", p.x, p.y, p.z);
	}
	snprintf(body + length, size - length, "]%s}", rest);
	return body;
}

static struct document *parse(const char *scene)
{
	const struct document_limits limits = {.max_nodes = 1000,
	    .layout = LAYOUT_WARPED};
	struct document *document;
	struct faults faults = {0};

	assert_int_equal(document_parse(scene, strlen(scene), &limits,
	    &document, &faults), ERR_OK);
	return document;
}

static double number(const cJSON *list, int i, int j)
{
	const cJSON *item = cJSON_GetArrayItem(list, i);

	return j < 0 ? cJSON_GetNumberValue(item) :
	    cJSON_GetNumberValue(cJSON_GetArrayItem(item, j));
}

static double check_point(const struct tape *tape, const cJSON *values,
    const cJSON *gradients, int i)
{
	struct jet exact;
	double value = number(values, i, -1);
	double off[3], size;

	evaluate(tape, point(i), 1, &exact);
	assert_near(value, exact.value, VALUE_TOLERANCE);
	off[0] = number(gradients, i, 0) - exact.gradient.x;
	off[1] = number(gradients, i, 1) - exact.gradient.y;
	off[2] = number(gradients, i, 2) - exact.gradient.z;
	size = vec3_norm(exact.gradient);
	return vec3_norm(vec3(off[0], off[1], off[2])) / (size + 1e-2);
}

/* Posts scene and compares every value; gradients within 2 % at the 95th
 * percentile: tables' derivatives jump where branches meet. */
static void check_scene(void **state, const char *scene)
{
	const struct daemon *d = *state;
	struct document *document = parse(scene);
	char *body = make_body(scene, "");
	struct http_reply reply;
	const cJSON *values, *gradients;
	cJSON *json;
	int far = 0;

	http_json(d->url, NULL, "/v1/eval", body, &reply);
	assert_int_equal(reply.status, 200);
	json = cJSON_Parse(reply.body);
	values = cJSON_GetObjectItem(json, "value");
	gradients = cJSON_GetObjectItem(json, "gradient");
	assert_int_equal(cJSON_GetArraySize(values), POINT_COUNT);
	assert_int_equal(cJSON_GetArraySize(gradients), POINT_COUNT);
	for (int i = 0; i < POINT_COUNT; i++)
		far += check_point(document_tape(document), values, gradients,
		    i) > 0.02;
	assert_true(far <= POINT_COUNT / 20);
	cJSON_Delete(json);
	http_reply_fini(&reply);
	free(body);
	document_free(document);
}

static void test_letter_a_agrees_with_float64(void **state)
{
	check_scene(state, letter_a);
}

static void test_solids_and_difference_agree_with_float64(void **state)
{
	check_scene(state, mixed);
}

static void test_custom_operator_is_built_on_demand(void **state)
{
	const struct daemon *d = *state;
	struct http_reply reply;

	check_scene(state, own_operator);
	http_get(d->url, "/v1/operators", &reply);
	assert_non_null(strstr(reply.body, "\"k\":0.35"));
	http_reply_fini(&reply);
}

static void test_outputs_choose_what_is_answered(void **state)
{
	const struct daemon *d = *state;
	char *body = make_body(letter_a, ",\"outputs\":[\"hessian\"]");
	struct http_reply reply;
	const cJSON *hessian;
	cJSON *json;

	http_json(d->url, NULL, "/v1/eval", body, &reply);
	assert_int_equal(reply.status, 200);
	json = cJSON_Parse(reply.body);
	hessian = cJSON_GetObjectItem(json, "hessian");
	assert_null(cJSON_GetObjectItem(json, "value"));
	assert_null(cJSON_GetObjectItem(json, "gradient"));
	assert_int_equal(cJSON_GetArraySize(hessian), POINT_COUNT);
	assert_int_equal(cJSON_GetArraySize(cJSON_GetArrayItem(hessian, 0)),
	    6);
	cJSON_Delete(json);
	http_reply_fini(&reply);
	free(body);
}

static void test_hole_of_the_a_is_open(void **state)
{
	const struct daemon *d = *state;
	struct http_reply reply;
	char body[1024];
	cJSON *json;

	snprintf(body, sizeof body, "{\"scene\":%s,\"points\":[[0,0,1.4],"
	    "[0,0,0.8],[0,0,2.6]],\"outputs\":[\"value\"]}", letter_a);
	http_json(d->url, NULL, "/v1/eval", body, &reply);
	json = cJSON_Parse(reply.body);
	assert_true(number(cJSON_GetObjectItem(json, "value"), 0, -1) < 0.5);
	assert_true(number(cJSON_GetObjectItem(json, "value"), 1, -1) > 0.5);
	assert_true(number(cJSON_GetObjectItem(json, "value"), 2, -1) > 0.5);
	cJSON_Delete(json);
	http_reply_fini(&reply);
}

static void test_no_points_is_an_empty_answer(void **state)
{
	const struct daemon *d = *state;
	struct http_reply reply;
	char body[1024];

	snprintf(body, sizeof body, "{\"scene\":%s,\"points\":[]}", letter_a);
	http_json(d->url, NULL, "/v1/eval", body, &reply);
	assert_int_equal(reply.status, 200);
	assert_non_null(strstr(reply.body, "\"count\":0"));
	http_reply_fini(&reply);
}

int main(void)
{
	const struct CMUnitTest tests[] = {
		cmocka_unit_test(test_letter_a_agrees_with_float64),
		cmocka_unit_test(test_solids_and_difference_agree_with_float64),
		cmocka_unit_test(test_custom_operator_is_built_on_demand),
		cmocka_unit_test(test_outputs_choose_what_is_answered),
		cmocka_unit_test(test_hole_of_the_a_is_open),
		cmocka_unit_test(test_no_points_is_an_empty_answer),
	};

	return cmocka_run_group_tests(tests, daemon_setup, daemon_teardown);
}
