/*
 * POST /v1/import: a document of three-js-blobtree becomes a scene of ours
 * with its field.
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

#include "tests/support/daemon.h"
#include "tests/support/http.h"
#include "tests/support/near.h"

#define MATERIAL "{\"color\":\"#ff0000\",\"roughness\":0,\"metalness\":0," \
	"\"emissive\":\"#000000\"}"

/* As the library writes two points. */
static const char two_points[] =
    "{\"type\":\"RootNode\",\"children\":["
    "{\"type\":\"RicciNode\",\"children\":["
    "{\"type\":\"ScalisPoint\",\"materials\":[" MATERIAL "],"
    "\"v\":[{\"position\":{\"x\":0,\"y\":0,\"z\":0},\"thickness\":1}],"
    "\"volType\":\"dist\",\"density\":1},"
    "{\"type\":\"ScalisPoint\",\"materials\":[" MATERIAL "],"
    "\"v\":[{\"position\":{\"x\":1.25,\"y\":0,\"z\":0},\"thickness\":0.75}],"
    "\"volType\":\"convol\",\"density\":1}],\"ricci_n\":2}],"
    "\"ricci_n\":64,\"iso\":1}";

static const char refused[] =
    "{\"type\":\"RootNode\",\"children\":[{\"type\":\"SDFRootNode\","
    "\"materials\":[" MATERIAL "],\"f\":{\"type\":\"Poly6DistanceFunctor\","
    "\"scale\":1},\"sdfRoot\":{\"type\":\"SDFPoint\",\"p\":{\"x\":0,\"y\":0,"
    "\"z\":0},\"acc\":1}}],\"ricci_n\":64,\"iso\":1}";

static const char *url(void **state)
{
	return ((struct daemon *)*state)->url;
}

static cJSON *import(void **state, const char *body, long status)
{
	struct http_reply reply;
	cJSON *json;

	http_json(url(state), "POST", "/v1/import", body, &reply);
	if (reply.status != status)
		print_message("%s\n", reply.body);
	assert_int_equal(reply.status, status);
	json = cJSON_Parse(reply.body);
	assert_non_null(json);
	http_reply_fini(&reply);
	return json;
}

/* PUTs the document of an answer. */
static void put(void **state, const cJSON *answer, const char *path)
{
	struct http_reply reply;
	char *text = cJSON_PrintUnformatted(
	    cJSON_GetObjectItem(answer, "document"));

	http_json(url(state), "PUT", path, text, &reply);
	if (reply.status != 201)
		print_message("%s\n", reply.body);
	assert_int_equal(reply.status, 201);
	http_reply_fini(&reply);
	free(text);
}

static double point_field(double r, double thickness)
{
	const double x = 1.0 - 0.25 * r * r / (thickness * thickness);

	return x > 0.0 ? x * x * x / 0.421875 : 0.0;
}

/* Half the library's field of two_points. */
static double expected_at(const double *p)
{
	const double x = p[0] - 1.25, yz = p[1] * p[1] + p[2] * p[2];

	return 0.5 * hypot(point_field(sqrt(p[0] * p[0] + yz), 1.0),
	    point_field(sqrt(x * x + yz), 0.75));
}

static void test_an_imported_scene_has_the_library_s_field(void **state)
{
	static const double points[][3] = {{0.5, 0, 0}, {-1, 0, 0},
	    {0.75, 0.5, 0.25}, {0, 0, 1.75}, {9, 9, 9}};
	cJSON *answer = import(state, two_points, 200), *json;
	struct http_reply reply;
	const cJSON *value;
	int i = 0;

	assert_int_equal(cJSON_GetArraySize(cJSON_GetObjectItem(answer,
	    "warnings")), 0);
	put(state, answer, "/v1/scenes/imported");
	cJSON_Delete(answer);
	http_json(url(state), "POST", "/v1/scenes/imported/eval",
	    "{\"points\":[[0.5,0,0],[-1,0,0],[0.75,0.5,0.25],[0,0,1.75],"
	    "[9,9,9]],\"outputs\":[\"value\"]}", &reply);
	assert_int_equal(reply.status, 200);
	json = cJSON_Parse(reply.body);
	cJSON_ArrayForEach(value, cJSON_GetObjectItem(json, "value")) {
		/* float32: measured 8e-8 */
		assert_near(value->valuedouble, expected_at(points[i]), 2e-6);
		i++;
	}
	assert_int_equal(i, 5);
	cJSON_Delete(json);
	http_reply_fini(&reply);
}

static void test_what_has_no_equal_is_422_with_a_pointer(void **state)
{
	cJSON *problem = import(state, refused, 422);
	const cJSON *error = cJSON_GetArrayItem(
	    cJSON_GetObjectItem(problem, "errors"), 0);

	assert_string_equal(cJSON_GetStringValue(
	    cJSON_GetObjectItem(error, "pointer")), "/children/0/sdfRoot");
	assert_non_null(strstr(cJSON_GetStringValue(
	    cJSON_GetObjectItem(error, "detail")), "SDFPoint"));
	cJSON_Delete(problem);
}

static void test_other_bodies_are_refused(void **state)
{
	struct http_reply reply;

	cJSON_Delete(import(state, "{\"type\":", 400));
	cJSON_Delete(import(state, "[]", 422));
	http_do(url(state), &(struct http_request){
		.method = "POST",
		.path = "/v1/import",
		.body = two_points,
		.length = strlen(two_points),
		.headers = {"Content-Type: text/plain"},
	}, &reply);
	assert_int_equal(reply.status, 415);
	http_reply_fini(&reply);
	http_get(url(state), "/v1/import", &reply);
	assert_int_equal(reply.status, 405);
	http_reply_fini(&reply);
}

int main(void)
{
	static const struct CMUnitTest tests[] = {
		cmocka_unit_test(
		    test_an_imported_scene_has_the_library_s_field),
		cmocka_unit_test(test_what_has_no_equal_is_422_with_a_pointer),
		cmocka_unit_test(test_other_bodies_are_refused),
	};

	return cmocka_run_group_tests(tests, daemon_setup, daemon_teardown);
}
