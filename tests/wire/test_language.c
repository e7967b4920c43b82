/*
 * The whole language over the wire: nodes of every kind in one scene, every
 * output, against the float64 evaluator.
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
#include "core/output.h"
#include "core/surface.h"
#include "core/tape.h"
#include "proto/document.h"
#include "proto/fault.h"
#include "tests/support/daemon.h"
#include "tests/support/http.h"
#include "tests/support/near.h"

static const char scene[] =
    "{\"format\":\"blobfield/1\",\"root\":{\"type\":\"union\","
    "\"operator\":\"organic\",\"material\":{\"color\":[0.1,0.2,0.3]},"
    "\"children\":["
    "{\"type\":\"twist\",\"axis\":[0,0,1],\"rate\":1,\"from\":-1,\"to\":1,"
    "\"material\":{\"color\":[1,0,0]},\"child\":{\"type\":\"box\","
    "\"center\":[0,0,0],\"half_size\":[0.5,0.3,1],\"rounding\":0.1,"
    "\"falloff\":0.3}},"
    "{\"type\":\"taper\",\"axis\":[1,0,0],\"from\":0,\"to\":2,"
    "\"factor\":0.5,\"child\":{\"type\":\"capsule\",\"a\":[0,0,0],"
    "\"b\":[2,0,0],\"radius\":0.3,\"falloff\":0.3}},"
    "{\"type\":\"bend\",\"axis\":[0,1,0],\"direction\":[0,0,1],\"from\":0,"
    "\"to\":2,\"rate\":0.6,\"child\":{\"type\":\"segment\",\"a\":[0,0,0],"
    "\"b\":[0,2,0],\"radius\":0.2,\"material\":{\"color\":[0,1,0]}}},"
    "{\"type\":\"union\",\"operator\":{\"type\":\"ricci\",\"n\":3},"
    "\"children\":[{\"type\":\"convolution\",\"radius\":0.2,\"elements\":["
    "{\"segment\":[[-2,0,0],[0,0,0]]},{\"triangle\":[[-2,0,0],[-3,0,0],"
    "[-2,1,0]]},{\"point\":[0,-1,0],\"weight\":0.3}]},"
    "{\"type\":\"point\",\"center\":[-1,0,0.3],\"radius\":0.3}]}]}}";

#define POINT_COUNT 400
#define COLUMNS OUTPUT_ROW_MAX

static struct vec3 point(int i)
{
	double s = (double)i / (POINT_COUNT - 1);

	return vec3((double)(float)(-3.0 + 5.5 * s),
	    (double)(float)(0.4 * sin(23.0 * s)),
	    (double)(float)(0.5 * cos(17.0 * s)));
}

static struct document *parse(void)
{
	const struct document_limits limits = {.max_nodes = 1000,
	    .layout = LAYOUT_WARPED};
	struct document *document = NULL;
	struct faults faults = {0};

	if (document_parse(scene, strlen(scene), &limits, &document,
	    &faults) != ERR_OK)
		fail_msg("%s: %s", faults.list[0].pointer,
		    faults.list[0].detail);
	return document;
}

/* The rows for all outputs at all points, by raw float32. */
static float *ask_rows(struct daemon *d)
{
	static float points[3 * POINT_COUNT];
	struct http_request request = {.method = "POST",
	    .path = "/v1/scenes/language/eval?outputs=curvature,normal,color,"
	    "hessian,gradient,value", .body = points, .length = sizeof points,
	    .headers = {"Content-Type: application/octet-stream",
	    "Accept: application/octet-stream", NULL}};
	struct http_reply reply;
	float *rows;

	http_json(d->url, "PUT", "/v1/scenes/language", scene, &reply);
	assert_true(reply.status == 200 || reply.status == 201);
	http_reply_fini(&reply);
	for (int i = 0; i < POINT_COUNT; i++) {
		points[3 * i] = (float)point(i).x;
		points[3 * i + 1] = (float)point(i).y;
		points[3 * i + 2] = (float)point(i).z;
	}
	http_do(d->url, &request, &reply);
	if (reply.status != 200)
		fail_msg("%ld: %s", reply.status, reply.body);
	assert_int_equal(reply.length,
	    POINT_COUNT * COLUMNS * sizeof(float));
	rows = malloc(reply.length);
	assert_non_null(rows);
	memcpy(rows, reply.body, reply.length);
	http_reply_fini(&reply);
	return rows;
}

static void check_color(const struct tape *tape, int i, const float *row)
{
	struct vec3 exact;

	evaluate_color(tape, point(i), &exact);
	/* measured 3e-5 */
	assert_near(row[10], exact.x, 1e-3);
	assert_near(row[11], exact.y, 1e-3);
	assert_near(row[12], exact.z, 1e-3);
}

/* Normals and curvatures follow from the row's own derivatives. */
static void check_surface(const float *row)
{
	const struct jet f = {row[0], vec3(row[1], row[2], row[3]),
	    {row[4], row[5], row[6], row[7], row[8], row[9]}};
	double size = vec3_norm(f.gradient), mean, gaussian;
	struct vec3 n = surface_normal(&f);

	if (size < 1e-2)
		return;
	assert_near(row[13], n.x, 1e-5);
	assert_near(row[14], n.y, 1e-5);
	assert_near(row[15], n.z, 1e-5);
	surface_curvature(&f, &mean, &gaussian);
	assert_near(row[16], mean, 1e-4 * (1.0 + fabs(mean)));
	assert_near(row[17], gaussian, 1e-3 * (1.0 + fabs(gaussian) +
	    mean * mean));
}

static void test_every_output_of_the_whole_language(void **state)
{
	struct document *document = parse();
	const struct tape *tape = document_tape(document);
	float *rows = ask_rows(*state);
	int off = 0;

	for (int i = 0; i < POINT_COUNT; i++) {
		const float *row = rows + COLUMNS * i;
		struct jet exact;
		double size;

		evaluate(tape, point(i), 2, &exact);
		size = vec3_norm(exact.gradient);
		/* measured 2e-4 */
		assert_near(row[0], exact.value, 2e-3);
		off += !(vec3_norm(vec3_sub(vec3(row[1], row[2], row[3]),
		    exact.gradient)) <= 0.02 * (size + 1e-2));
		check_color(tape, i, row);
		check_surface(row);
	}
	/* tables' derivatives jump where branches meet */
	assert_in_range(off, 0, POINT_COUNT / 20);
	free(rows);
	document_free(document);
}

static void test_outputs_in_json_are_named(void **state)
{
	struct daemon *d = *state;
	struct http_reply reply;
	cJSON *json;

	http_json(d->url, "POST", "/v1/eval", "{\"scene\":{\"format\":"
	    "\"blobfield/1\",\"root\":{\"type\":\"sphere\",\"center\":[0,0,0],"
	    "\"radius\":2,\"falloff\":1,\"material\":{\"color\":[1,0.5,0]}}},"
	    "\"points\":[[2,0,0]],\"outputs\":[\"curvature\",\"color\","
	    "\"normal\"]}", &reply);
	assert_int_equal(reply.status, 200);
	json = cJSON_Parse(reply.body);
	assert_non_null(json);
	assert_string_equal(json->child->next->string, "color");
	assert_near(cJSON_GetNumberValue(cJSON_GetArrayItem(cJSON_GetArrayItem(
	    cJSON_GetObjectItem(json, "color"), 0), 1)), 0.5, 1e-6);
	assert_near(cJSON_GetNumberValue(cJSON_GetArrayItem(cJSON_GetArrayItem(
	    cJSON_GetObjectItem(json, "normal"), 0), 0)), 1.0, 1e-6);
	assert_near(cJSON_GetNumberValue(cJSON_GetArrayItem(cJSON_GetArrayItem(
	    cJSON_GetObjectItem(json, "curvature"), 0), 0)), 0.5, 1e-5);
	assert_near(cJSON_GetNumberValue(cJSON_GetArrayItem(cJSON_GetArrayItem(
	    cJSON_GetObjectItem(json, "curvature"), 0), 1)), 0.25, 1e-5);
	cJSON_Delete(json);
	http_reply_fini(&reply);
}

int main(void)
{
	const struct CMUnitTest tests[] = {
		cmocka_unit_test(test_every_output_of_the_whole_language),
		cmocka_unit_test(test_outputs_in_json_are_named),
	};

	return cmocka_run_group_tests(tests, daemon_setup, daemon_teardown);
}
