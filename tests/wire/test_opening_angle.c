/*
 * What is asked about a scene rather than evaluated: its bounds, and the
 * opening with which a union blends as far as a point.
 */
#include <stdarg.h>
#include <stddef.h>
#include <setjmp.h>
#include <stdint.h>
#include <cmocka.h>

#include <math.h>
#include <stdio.h>
#include <string.h>

#include <cjson/cJSON.h>

#include "tests/support/daemon.h"
#include "tests/support/http.h"
#include "tests/support/near.h"

#define PI 3.14159265358979323846
#define TAG_MAX 64

#define DOCUMENT(root) "{\"format\":\"blobfield/1\",\"root\":" root "}"
#define BALL(x, more) "{\"type\":\"sphere\",\"center\":[" x ",0,0]," \
	"\"radius\":1,\"falloff\":0.5" more "}"
#define BLOB(x, y) "{\"type\":\"point\",\"center\":[" x "," y ",0]," \
	"\"radius\":1}"

/* Two blobs that meet at a right angle in (0, 0, 0), moved by (1, 2, 3); and
 * one far away. */
static const char corner[] = DOCUMENT("{\"type\":\"union\",\"id\":\"root\","
    "\"children\":[{\"type\":\"union\",\"id\":\"joint\","
    "\"operator\":\"camel\",\"translation\":[1,2,3],\"children\":["
    BLOB("9", "0") "," BLOB("0", "1.2") "," BLOB("1", "0") "]},"
    "{\"type\":\"point\",\"id\":\"dot\",\"center\":[0,0,0],\"radius\":1}]}");

static void put(const char *url, const char *path, const char *document,
    char tag[static TAG_MAX])
{
	struct http_reply reply;

	http_json(url, "PUT", path, document, &reply);
	assert_true(reply.status == 201 || reply.status == 200);
	http_header(&reply, "ETag", tag, TAG_MAX);
	http_reply_fini(&reply);
}

static long ask(const char *url, const char *path, const char *header,
    struct http_reply *reply)
{
	http_do(url, &(struct http_request){
		.path = path,
		.headers = {header},
	}, reply);
	return reply->status;
}

/* The answer to a request without fault, for cJSON_Delete. */
static cJSON *angle(const char *url, const char *body)
{
	struct http_reply reply;
	cJSON *json;

	http_json(url, "POST", "/v1/scenes/corner/opening-angle", body,
	    &reply);
	assert_int_equal(reply.status, 200);
	json = cJSON_Parse(reply.body);
	assert_non_null(json);
	http_reply_fini(&reply);
	return json;
}

static double number(const cJSON *json, const char *name)
{
	const cJSON *value = cJSON_GetObjectItem(json, name);

	assert_true(cJSON_IsNumber(value));
	return value->valuedouble;
}

static double element(const cJSON *json, const char *name, int i)
{
	const cJSON *value = cJSON_GetArrayItem(cJSON_GetObjectItem(json,
	    name), i);

	assert_true(cJSON_IsNumber(value));
	return value->valuedouble;
}

/* (1 - d^2/R^2)^3 of radius 1. */
static double soft(double d)
{
	const double b = 1.0 - d * d * (1.0 - cbrt(0.5));

	return b * b * b;
}

static void test_a_click_gives_the_angle_and_the_parameter(void **state)
{
	const struct daemon *d = *state;
	char tag[TAG_MAX];
	cJSON *json;

	put(d->url, "/v1/scenes/corner", corner, tag);
	json = angle(d->url, "{\"node\":\"joint\",\"point\":[1,2,3]}");
	/* Child 2 is at 1: its surface. */
	assert_near(element(json, "values", 0), 0.5, 1e-12);
	assert_near(element(json, "values", 1), soft(1.2), 1e-12);
	assert_near(element(json, "children", 0), 2.0, 0.0);
	assert_near(element(json, "children", 1), 1.0, 0.0);
	assert_near(number(json, "theta"), atan(2.0 * soft(1.2)), 1e-12);
	assert_near(number(json, "alpha"), PI / 2, 1e-12);
	assert_string_equal(cJSON_GetStringValue(cJSON_GetObjectItem(json,
	    "parameter")), "theta1");
	cJSON_Delete(json);
}

static void test_children_may_be_given(void **state)
{
	const struct daemon *d = *state;
	char tag[TAG_MAX];
	cJSON *json;

	put(d->url, "/v1/scenes/corner", corner, tag);
	json = angle(d->url, "{\"children\":[0,1],\"node\":\"joint\","
	    "\"point\":[1,2,3]}");
	assert_near(element(json, "values", 0), soft(1.2), 1e-12);
	assert_near(element(json, "values", 1), 0.0, 0.0);
	assert_near(element(json, "children", 0), 1.0, 0.0);
	assert_near(element(json, "children", 1), 0.0, 0.0);
	assert_near(number(json, "theta"), 0.0, 0.0);
	assert_true(cJSON_IsNull(cJSON_GetObjectItem(json, "alpha")));
	assert_true(cJSON_IsNull(cJSON_GetObjectItem(json, "parameter")));
	cJSON_Delete(json);
}

/* Answers status, and names pointer in its errors. */
static void assert_refused(const char *url, const char *path, const char *body,
    long status, const char *pointer)
{
	struct http_reply reply;
	char named[128];

	http_json(url, "POST", path, body, &reply);
	if (reply.status != status)
		fail_msg("%s: %ld, not %ld: %s", body, reply.status, status,
		    reply.body);
	snprintf(named, sizeof named, "\"pointer\":\"%s\"", pointer);
	if (strstr(reply.body, named) == NULL)
		fail_msg("%s: no %s in %s", body, named, reply.body);
	http_reply_fini(&reply);
}

static void test_bad_requests_are_told_where(void **state)
{
	static const struct {
		const char *body;
		long status;
		const char *pointer;
	} cases[] = {
		{"{\"node\":\"nobody\",\"point\":[0,0,0]}", 422, "/node"},
		{"{\"node\":\"dot\",\"point\":[0,0,0]}", 422, "/node"},
		{"{\"node\":7,\"point\":[0,0,0]}", 422, "/node"},
		{"{\"node\":\"\",\"point\":[0,0,0]}", 422, "/node"},
		{"{\"node\":\"joint\",\"point\":[0,0]}", 422, "/point"},
		{"{\"node\":\"joint\",\"point\":[0,0,\"1\"]}", 422,
		    "/point/2"},
		{"{\"node\":\"joint\",\"point\":{}}", 422, "/point"},
		{"{\"node\":\"joint\",\"point\":[0,0,1e10]}", 422, "/point/2"},
		{"{\"node\":\"joint\",\"point\":[1e999,0,0]}", 422,
		    "/point/0"},
		{"{\"node\":\"joint\",\"point\":[0,0,0],\"children\":[0]}", 422,
		    "/children"},
		{"{\"node\":\"joint\",\"point\":[0,0,0],\"children\":[1,1]}",
		    422, "/children"},
		{"{\"node\":\"joint\",\"point\":[0,0,0],\"children\":[0,3]}",
		    422, "/children/1"},
		{"{\"node\":\"joint\",\"point\":[0,0,0],\"children\":[-1,0]}",
		    422, "/children/0"},
		{"{\"node\":\"joint\",\"point\":[0,0,0],\"children\":[0,0.5]}",
		    422, "/children/1"},
		{"{\"node\":\"joint\",\"point\":[0,0,0],\"children\":[0,1e99]}",
		    422, "/children/1"},
		{"{\"node\":\"joint\",\"point\":[0,0,0],\"child\":[0,1]}", 422,
		    "/child"},
		{"{\"node\":\"joint\"}", 422, ""},
		{"{\"point\":[0,0,0]}", 422, ""},
		{"[]", 422, ""},
		{"{\"node\":\"joint\",\"node\":\"joint\",\"point\":[0,0,0]}",
		    400, "/node"},
		{"{\"node\":\"joint\",", 400, ""},
		{"", 400, ""},
	};
	const struct daemon *d = *state;
	char tag[TAG_MAX];

	put(d->url, "/v1/scenes/corner", corner, tag);
	for (size_t i = 0; i < sizeof cases / sizeof *cases; i++)
		assert_refused(d->url, "/v1/scenes/corner/opening-angle",
		    cases[i].body, cases[i].status, cases[i].pointer);
}

static void test_angles_are_of_a_scene_and_its_revision(void **state)
{
	static const char body[] = "{\"node\":\"joint\",\"point\":[1,2,3]}";
	const struct daemon *d = *state;
	struct http_request request = {
		.path = "/v1/scenes/corner/opening-angle",
		.body = body,
		.length = sizeof body - 1,
		.headers = {"Content-Type: application/json",
		    "If-Match: \"other\""},
	};
	char tag[TAG_MAX], used[TAG_MAX], condition[128];
	struct http_reply reply;

	put(d->url, "/v1/scenes/corner", corner, tag);
	http_json(d->url, "POST", "/v1/scenes/nothing/opening-angle", body,
	    &reply);
	http_reply_fini(&reply);
	assert_int_equal(reply.status, 404);
	http_do(d->url, &request, &reply);
	http_reply_fini(&reply);
	assert_int_equal(reply.status, 412);
	snprintf(condition, sizeof condition, "If-Match: %s", tag);
	request.headers[1] = condition;
	http_do(d->url, &request, &reply);
	assert_string_equal(http_header(&reply, "ETag", used, sizeof used),
	    tag);
	http_reply_fini(&reply);
	assert_int_equal(reply.status, 200);
	request.headers[0] = "Content-Type: text/plain";
	http_do(d->url, &request, &reply);
	http_reply_fini(&reply);
	assert_int_equal(reply.status, 415);
	assert_int_equal(ask(d->url, "/v1/scenes/corner/opening-angle", NULL,
	    &reply), 405);
	http_reply_fini(&reply);
}

/* The bounds of a scene made of document, for cJSON_Delete. */
static cJSON *bounds(const char *url, const char *document)
{
	struct http_reply reply;
	char tag[TAG_MAX], used[TAG_MAX];
	cJSON *json;

	put(url, "/v1/scenes/box", document, tag);
	assert_int_equal(ask(url, "/v1/scenes/box/bounds", NULL, &reply), 200);
	assert_string_equal(http_header(&reply, "ETag", used, sizeof used),
	    tag);
	json = cJSON_Parse(reply.body);
	assert_non_null(json);
	http_reply_fini(&reply);
	return json;
}

static int is_true(const cJSON *json, const char *name)
{
	const cJSON *value = cJSON_GetObjectItem(json, name);

	assert_true(cJSON_IsBool(value));
	return cJSON_IsTrue(value);
}

static void test_bounds_hold_the_field(void **state)
{
	const struct daemon *d = *state;
	cJSON *json = bounds(d->url, DOCUMENT("{\"type\":\"union\","
	    "\"children\":[" BALL("0", "") "," BALL("3", ",\"scale\":2") "]}"));

	assert_near(element(json, "min", 0), -1.5, 1e-12);
	assert_near(element(json, "max", 0), 9.0, 1e-12);
	assert_near(element(json, "min", 1), -3.0, 1e-12);
	assert_near(element(json, "max", 2), 3.0, 1e-12);
	assert_true(is_true(json, "bounded"));
	assert_false(is_true(json, "empty"));
	cJSON_Delete(json);
}

static void test_infinite_bounds_are_null(void **state)
{
	const struct daemon *d = *state;
	cJSON *json = bounds(d->url, DOCUMENT("{\"type\":\"plane\",\"point\":"
	    "[0,0,1],\"normal\":[0,0,1],\"falloff\":0.25}"));
	const cJSON *max = cJSON_GetObjectItem(json, "max");

	assert_near(element(json, "max", 2), 1.25, 1e-12);
	assert_true(cJSON_IsNull(cJSON_GetArrayItem(max, 0)));
	assert_true(cJSON_IsNull(cJSON_GetArrayItem(cJSON_GetObjectItem(json,
	    "min"), 2)));
	assert_false(is_true(json, "bounded"));
	assert_false(is_true(json, "empty"));
	cJSON_Delete(json);
}

static void test_bounds_of_nothing_are_empty(void **state)
{
	const struct daemon *d = *state;
	cJSON *json = bounds(d->url, DOCUMENT("{\"type\":\"intersection\","
	    "\"children\":[" BALL("0", "") "," BALL("7", "") "]}"));

	assert_true(is_true(json, "empty"));
	assert_true(is_true(json, "bounded"));
	assert_true(cJSON_IsNull(cJSON_GetObjectItem(json, "min")));
	assert_true(cJSON_IsNull(cJSON_GetObjectItem(json, "max")));
	cJSON_Delete(json);
}

static void test_bounds_keep_preconditions(void **state)
{
	const struct daemon *d = *state;
	struct http_reply reply;
	char tag[TAG_MAX], condition[128], used[TAG_MAX];

	put(d->url, "/v1/scenes/box", DOCUMENT(BALL("0", "")), tag);
	snprintf(condition, sizeof condition, "If-None-Match: %s", tag);
	assert_int_equal(ask(d->url, "/v1/scenes/box/bounds", condition,
	    &reply), 304);
	assert_int_equal(reply.length, 0);
	assert_string_equal(http_header(&reply, "ETag", used, sizeof used),
	    tag);
	http_reply_fini(&reply);
	assert_int_equal(ask(d->url, "/v1/scenes/box/bounds",
	    "If-Match: \"other\"", &reply), 412);
	http_reply_fini(&reply);
	assert_int_equal(ask(d->url, "/v1/scenes/box/bounds",
	    "If-Match: bare", &reply), 400);
	http_reply_fini(&reply);
	assert_int_equal(ask(d->url, "/v1/scenes/nothing/bounds", NULL,
	    &reply), 404);
	http_reply_fini(&reply);
}

int main(void)
{
	const struct CMUnitTest tests[] = {
		cmocka_unit_test(
		    test_a_click_gives_the_angle_and_the_parameter),
		cmocka_unit_test(test_children_may_be_given),
		cmocka_unit_test(test_bad_requests_are_told_where),
		cmocka_unit_test(test_angles_are_of_a_scene_and_its_revision),
		cmocka_unit_test(test_bounds_hold_the_field),
		cmocka_unit_test(test_infinite_bounds_are_null),
		cmocka_unit_test(test_bounds_of_nothing_are_empty),
		cmocka_unit_test(test_bounds_keep_preconditions),
	};

	return cmocka_run_group_tests(tests, daemon_setup, daemon_teardown);
}
