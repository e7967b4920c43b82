/*
 * Projections over the wire.
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
#include "core/project.h"
#include "core/tape.h"
#include "proto/document.h"
#include "proto/fault.h"
#include "tests/support/daemon.h"
#include "tests/support/http.h"
#include "tests/support/near.h"
#include "tests/support/npy.h"
#include "tests/support/random_tree.h"

#define POINT "{\"format\":\"blobfield/1\",\"root\":{\"type\":\"point\"," \
	"\"center\":[0,0,0],\"radius\":1}}"
#define BLEND "{\"format\":\"blobfield/1\",\"root\":{\"type\":\"union\"," \
	"\"operator\":\"camel\",\"children\":[" \
	"{\"type\":\"segment\",\"a\":[-2,0,0],\"b\":[2,0,0],\"radius\":0.4}," \
	"{\"type\":\"point\",\"center\":[0,0.3,0],\"radius\":0.9}]}}"

#define JSON "Content-Type: application/json"
#define OCTETS "Content-Type: application/octet-stream"
#define NPY "Content-Type: application/x-npy"

static void put(const char *url, const char *path, const char *document)
{
	struct http_reply reply;

	http_json(url, "PUT", path, document, &reply);
	assert_true(reply.status == 200 || reply.status == 201);
	http_reply_fini(&reply);
}

static long ask(const char *url, const char *path, const void *body,
    size_t length, const char *type, const char *accept,
    struct http_reply *reply)
{
	http_do(url, &(struct http_request){
		.path = path,
		.body = body,
		.length = length,
		.headers = {type, accept},
	}, reply);
	return reply->status;
}

static double element(const cJSON *json, const char *name, int point, int i)
{
	return cJSON_GetNumberValue(cJSON_GetArrayItem(cJSON_GetArrayItem(
	    cJSON_GetObjectItem(json, name), point), i));
}

static double number(const cJSON *json, const char *name, int point)
{
	return cJSON_GetNumberValue(cJSON_GetArrayItem(
	    cJSON_GetObjectItem(json, name), point));
}

static void test_points_go_to_a_sphere(void **state)
{
	static const char body[] = "{\"points\":[[0,0,2],[0.3,0,-0.4],[9,9,9]]"
	    "}";
	const struct daemon *d = *state;
	struct http_reply reply;
	const cJSON *converged;
	cJSON *json;

	put(d->url, "/v1/scenes/point", POINT);
	assert_int_equal(ask(d->url, "/v1/scenes/point/project", body,
	    strlen(body), JSON, NULL, &reply), 200);
	json = cJSON_Parse(reply.body);
	http_reply_fini(&reply);
	converged = cJSON_GetObjectItem(json, "converged");
	assert_true(cJSON_IsTrue(cJSON_GetArrayItem(converged, 0)));
	assert_true(cJSON_IsTrue(cJSON_GetArrayItem(converged, 1)));
	assert_true(cJSON_IsFalse(cJSON_GetArrayItem(converged, 2)));
	/* |f - iso| may be 1.5e-5, the slope is 0.78 */
	assert_near(number(json, "distance", 0), 1.0, 3e-5);
	assert_near(number(json, "distance", 1), -0.5, 3e-5);
	assert_near(element(json, "position", 1, 0), 0.6, 3e-5);
	assert_near(element(json, "position", 1, 2), -0.8, 3e-5);
	assert_near(element(json, "normal", 1, 0), 0.6, 3e-5);
	assert_near(number(json, "value", 1), 0.5, 1.6e-5);
	assert_near(element(json, "position", 2, 1), 9.0, 0.0);
	cJSON_Delete(json);
}

static void check_row(const float *row)
{
	assert_near(row[0], 1.0, 0.0);
	assert_near(row[3], 1.0, 3e-5);
	assert_near(row[4], 1.0, 3e-5);
	assert_near(row[5], 0.5, 1.6e-5);
	assert_near(row[8], 1.0, 3e-5);
}

static void test_numbers_both_ways(void **state)
{
	static const float points[3] = {0, 0, 2};
	static const char path[] = "/v1/scenes/point/project";
	const struct daemon *d = *state;
	struct http_reply reply;
	size_t length;
	char *file;

	put(d->url, "/v1/scenes/point", POINT);
	assert_int_equal(ask(d->url, path, points, sizeof points, OCTETS,
	    "Accept: application/octet-stream", &reply), 200);
	assert_int_equal(reply.length, PROJECTION_FLOATS * sizeof(float));
	check_row((const float *)(const void *)reply.body);
	http_reply_fini(&reply);
	file = npy_file("<f4", "False", "(1, 3)", points, sizeof points,
	    &length);
	assert_int_equal(ask(d->url, path, file, length, NPY,
	    "Accept: application/x-npy", &reply), 200);
	free(file);
	assert_non_null(strstr(reply.body + 10, "(1, 9)"));
	check_row((const float *)(const void *)(reply.body + reply.length -
	    PROJECTION_FLOATS * sizeof(float)));
	http_reply_fini(&reply);
	assert_int_equal(ask(d->url, "/v1/scenes/point/project?"
	    "max_distance=0.5", points, sizeof points, OCTETS,
	    "Accept: application/octet-stream", &reply), 200);
	assert_near(*(const float *)(const void *)reply.body, 0.0, 0.0);
	http_reply_fini(&reply);
}

/* What has converged is on the surface by the float64 evaluator, too, as far as
 * the device's own error goes. */
static void test_points_go_to_a_blend(void **state)
{
	enum { POINTS = 5000 };
	const struct daemon *d = *state;
	const struct document_limits limits = {.max_nodes = 100};
	struct random_stream random = {9};
	static float points[POINTS][3];
	struct faults faults = {0};
	struct document *document;
	struct http_reply reply;
	const float *row;
	double worst = 0.0;
	int converged = 0;

	put(d->url, "/v1/scenes/blend", BLEND);
	assert_int_equal(document_parse(BLEND, strlen(BLEND), &limits,
	    &document, &faults), ERR_OK);
	for (int i = 0; i < POINTS; i++) {
		points[i][0] = (float)random_in(&random, -2.3, 2.3);
		points[i][1] = (float)random_in(&random, -0.7, 0.7);
		points[i][2] = (float)random_in(&random, -0.7, 0.7);
	}
	assert_int_equal(ask(d->url, "/v1/scenes/blend/project", points,
	    sizeof points, OCTETS, "Accept: application/octet-stream",
	    &reply), 200);
	row = (const float *)(const void *)reply.body;
	for (int i = 0; i < POINTS; i++, row += PROJECTION_FLOATS) {
		struct jet f;

		if (row[0] == 0.0f)
			continue;
		converged++;
		evaluate(document_tape(document), (struct vec3){row[1],
		    row[2], row[3]}, 0, &f);
		worst = fmax(worst, fabs(f.value - 0.5));
	}
	print_message("measured: %d of %d converged, f there off by %.1e\n",
	    converged, POINTS, worst);
	assert_true(converged > POINTS * 99 / 100);
	assert_true(worst < 1e-4);
	http_reply_fini(&reply);
	document_free(document);
}

int main(void)
{
	const struct CMUnitTest tests[] = {
		cmocka_unit_test(test_points_go_to_a_sphere),
		cmocka_unit_test(test_numbers_both_ways),
		cmocka_unit_test(test_points_go_to_a_blend),
	};

	return cmocka_run_group_tests(tests, daemon_setup, daemon_teardown);
}
