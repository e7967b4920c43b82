/*
 * Every kind of wrong request gets its status, and a problem that helps.
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

#define JSON "Content-Type: application/json"
#define OCTETS "Content-Type: application/octet-stream"
#define NPY "Content-Type: application/x-npy"
#define EVAL "/v1/eval"
#define POINT "{\"format\":\"blobfield/1\",\"root\":{\"type\":\"point\"," \
	"\"center\":[0,0,0],\"radius\":1}}"

/* A request, the status it must get, and words its problem must have. */
struct wrong {
	const char *method, *path, *body, *header, *other_header;
	long status;
	const char *says, *also;
};

static void check_problem(const struct http_reply *reply, long status)
{
	cJSON *json = cJSON_Parse(reply->body);
	char type[64];

	http_header(reply, "Content-Type", type, sizeof type);
	assert_string_equal(type, "application/problem+json");
	assert_non_null(json);
	assert_int_equal((long)cJSON_GetNumberValue(cJSON_GetObjectItem(json,
	    "status")), status);
	assert_int_equal(strncmp(cJSON_GetStringValue(cJSON_GetObjectItem(
	    json, "type")), "/problems/", 10), 0);
	assert_true(strlen(cJSON_GetStringValue(cJSON_GetObjectItem(json,
	    "title"))) > 0);
	assert_true(strlen(cJSON_GetStringValue(cJSON_GetObjectItem(json,
	    "detail"))) > 10);
	cJSON_Delete(json);
}

static void check_one(const char *url, const struct wrong *w)
{
	struct http_reply reply;

	http_do(url, &(struct http_request){
		.method = w->method,
		.path = w->path,
		.body = w->body,
		.length = w->body != NULL ? strlen(w->body) : 0,
		.headers = {w->header, w->header ? w->other_header : NULL},
	}, &reply);
	if (reply.status != w->status)
		fail_msg("%s %s %s: %ld, not %ld: %s", w->method ? w->method :
		    "", w->path, w->body ? w->body : "", reply.status,
		    w->status, reply.body);
	check_problem(&reply, w->status);
	if (strstr(reply.body, w->says) == NULL ||
	    (w->also != NULL && strstr(reply.body, w->also) == NULL))
		fail_msg("%s %s: '%s' not in %s", w->path, w->body ? w->body :
		    "", w->says, reply.body);
	http_reply_fini(&reply);
}

static void check_all(void **state, const struct wrong *list, size_t count)
{
	const struct daemon *d = *state;

	for (size_t i = 0; i < count; i++)
		check_one(d->url, &list[i]);
}

#define COUNT(list) (sizeof(list) / sizeof *(list))

static void test_400_malformed_json(void **state)
{
	static const struct wrong list[] = {
		{"POST", EVAL, "", JSON, NULL, 400, "malformed", "\"errors\""},
		{"POST", EVAL, "{", JSON, NULL, 400, "column", NULL},
		{"POST", EVAL, "{\"points\":[1,2,}", JSON, NULL, 400, "column",
		    NULL},
		{"POST", EVAL, "{\"points\":[],\"points\":[]}", JSON, NULL, 400,
		    "points", NULL},
		{"PUT", "/v1/scenes/x", "not json", JSON, NULL, 400, "line 1",
		    NULL},
		{"PUT", "/v1/scenes/x", POINT "x", JSON, NULL, 400, "malformed",
		    NULL},
	};

	check_all(state, list, COUNT(list));
}

static void test_400_malformed_binary(void **state)
{
	static const struct wrong list[] = {
		{"POST", "/v1/scenes/here/eval", "ten bytes.", OCTETS, NULL,
		    400, "12 bytes", NULL},
		{"POST", "/v1/scenes/here/eval", "not numpy at all", NPY, NULL,
		    400, "npy", NULL},
	};
	const struct daemon *d = *state;
	const float nan_point[3] = {0.0f, NAN, 0.0f};
	struct http_reply reply;

	check_all(state, list, COUNT(list));
	http_do(d->url, &(struct http_request){
		.path = "/v1/scenes/here/eval",
		.body = nan_point,
		.length = sizeof nan_point,
		.headers = {OCTETS},
	}, &reply);
	assert_int_equal(reply.status, 422);
	check_problem(&reply, 422);
	http_reply_fini(&reply);
}

static void test_400_unknown_query(void **state)
{
	static const struct wrong list[] = {
		{NULL, "/v1/info?a=1", NULL, NULL, NULL, 400, "'a'", "none"},
		{"POST", EVAL "?output=value", "{}", JSON, NULL, 400,
		    "'output'", "outputs"},
		{"POST", EVAL "?outputs=value&outputs=gradient", "{}", JSON,
		    NULL, 400, "more than one", "outputs"},
		{NULL, "/v1/scenes?limit&limit", NULL, NULL, NULL, 400,
		    "more than one", "limit"},
		{NULL, "/v1/scenes?after=a%00b", NULL, NULL, NULL, 400, "NUL",
		    NULL},
		{NULL, "/v1/scenes?limit=many", NULL, NULL, NULL, 400, "limit",
		    NULL},
	};

	check_all(state, list, COUNT(list));
}

static void test_404_unknown_things(void **state)
{
	static const struct wrong list[] = {
		{NULL, "/nowhere", NULL, NULL, NULL, 404, "/nowhere", "GET /"},
		{NULL, "/v1/scenes/none", NULL, NULL, NULL, 404, "none", NULL},
		{"POST", "/v1/scenes/none/eval", "{\"points\":[]}", JSON, NULL,
		    404, "none", NULL},
		{"DELETE", "/v1/scenes/none", NULL, NULL, NULL, 404, "none",
		    NULL},
		{NULL, "/v1/operators/none", NULL, NULL, NULL, 404, "camel",
		    NULL},
		{NULL, "/v1/scenes/", NULL, NULL, NULL, 404, "not-found", NULL},
	};

	check_all(state, list, COUNT(list));
}

static void test_405_with_allow(void **state)
{
	static const struct wrong list[] = {
		{NULL, EVAL, NULL, NULL, NULL, 405, "POST", NULL},
		{"DELETE", "/v1/scenes", NULL, NULL, NULL, 405, "GET", NULL},
		{"PATCH", "/v1/info", NULL, NULL, NULL, 405, "PATCH", NULL},
		{"BREW", "/v1/info", NULL, NULL, NULL, 405, "BREW", NULL},
	};
	const struct daemon *d = *state;
	struct http_reply reply;
	char allow[128];

	check_all(state, list, COUNT(list));
	http_do(d->url, &(struct http_request){.method = "POST",
	    .path = "/v1/scenes/x", .body = "{}", .length = 2,
	    .headers = {JSON}}, &reply);
	assert_int_equal(reply.status, 405);
	assert_string_equal(http_header(&reply, "Allow", allow, sizeof allow),
	    "GET, HEAD, PUT, PATCH, DELETE, OPTIONS");
	http_reply_fini(&reply);
	http_do(d->url, &(struct http_request){.method = "OPTIONS",
	    .path = EVAL}, &reply);
	assert_int_equal(reply.status, 204);
	assert_string_equal(http_header(&reply, "Allow", allow, sizeof allow),
	    "POST, OPTIONS");
	http_reply_fini(&reply);
}

static void test_406_and_415(void **state)
{
	static const struct wrong list[] = {
		{"POST", EVAL, "{}", JSON, "Accept: text/html", 406,
		    "application/json", "x-npy"},
		{"POST", "/v1/scenes/here/eval", "{}", JSON,
		    "Accept: application/json;q=0", 406, "not-acceptable", NULL},
		{"POST", EVAL, "<a/>", "Content-Type: text/xml", NULL, 415,
		    "text/xml", "application/json"},
		{"POST", EVAL, "123456789012", OCTETS, NULL, 415,
		    "octet-stream", NULL},
		{"PUT", "/v1/scenes/x", POINT, OCTETS, NULL, 415,
		    "application/json", NULL},
		{"POST", EVAL, "{}", JSON, "Content-Encoding: gzip", 415,
		    "gzip", NULL},
		{"POST", EVAL, "{}",
		    "Content-Type: application/json; charset=latin1", NULL, 415,
		    "latin1", NULL},
	};

	check_all(state, list, COUNT(list));
}

/* What a web page may send anywhere without asking. */
static void test_415_for_forms_and_bodies_without_a_type(void **state)
{
	static const struct wrong list[] = {
		/* libcurl calls it a form, if nothing is said ... */
		{"POST", EVAL, "{}", NULL, NULL, 415, "form-urlencoded",
		    "--json, or add -H 'Content-Type: application/json'"},
		{"POST", EVAL, "{}", "Content-Type: text/plain", NULL, 415,
		    "'text/plain'; this resource takes application/json.",
		    NULL},
		{"POST", EVAL, "{}", "Content-Type: multipart/form-data", NULL,
		    415, "takes application/json.", NULL},
		/* ... ":" is none, ";" an empty one. */
		{"POST", EVAL, "{}", "Content-Type:", NULL, 415,
		    "no Content-Type", "takes application/json."},
		{"POST", EVAL, "{}", "Content-Type;", NULL, 415,
		    "no Content-Type", NULL},
		{"POST", EVAL, "", "Content-Type:", NULL, 415,
		    "no Content-Type", NULL},
		{"POST", "/v1/scenes", POINT, "Content-Type:", NULL, 415,
		    "no Content-Type", NULL},
		{"PUT", "/v1/scenes/x", POINT, "Content-Type:", NULL, 415,
		    "no Content-Type", NULL},
		{"POST", "/v1/scenes/here/eval", "{\"points\":[]}",
		    "Content-Type:", NULL, 415, "no Content-Type",
		    "takes application/json, application/octet-stream, "
		    "application/x-npy."},
	};

	check_all(state, list, COUNT(list));
}

static void test_412_preconditions(void **state)
{
	static const struct wrong list[] = {
		{"PUT", "/v1/scenes/here", POINT, JSON, "If-Match: \"old\"",
		    412, "ETag", NULL},
		{"PUT", "/v1/scenes/here", POINT, JSON, "If-None-Match: *",
		    412, "here", NULL},
		{"DELETE", "/v1/scenes/here", NULL, "If-Match: \"old\"", NULL,
		    412, "here", NULL},
	};

	check_all(state, list, COUNT(list));
}

static void test_422_wrong_documents(void **state)
{
	static const struct wrong list[] = {
		{"PUT", "/v1/scenes/x", "[]", JSON, NULL, 422, "invalid", NULL},
		{"PUT", "/v1/scenes/x", "{\"format\":\"blobfield/1\"}", JSON,
		    NULL, 422, "root", NULL},
		{"PUT", "/v1/scenes/x", "{\"format\":\"blobfield/2\",\"root\":"
		    "{\"type\":\"point\",\"center\":[0,0,0],\"radius\":1}}",
		    JSON, NULL, 422, "/format", NULL},
		{"PUT", "/v1/scenes/x", "{\"format\":\"blobfield/1\",\"root\":"
		    "{\"type\":\"union\",\"children\":[{\"type\":\"point\","
		    "\"center\":[0,0,0],\"raduis\":1}]}}", JSON, NULL, 422,
		    "/root/children/0/raduis", "\"pointer\""},
		{"PUT", "/v1/scenes/x", "{\"format\":\"blobfield/1\",\"root\":"
		    "{\"type\":\"cube\"}}", JSON, NULL, 422, "cube", NULL},
		{"POST", EVAL, "{\"scene\":{\"format\":\"blobfield/1\",\"root\":"
		    "{\"type\":\"point\",\"center\":[0,0,0],\"radius\":-1}},"
		    "\"points\":[]}", JSON, NULL, 422, "/scene/root/radius",
		    NULL},
		{"POST", EVAL, "{\"points\":[]}", JSON, NULL, 422, "scene",
		    NULL},
		{"POST", "/v1/scenes/here/eval", "{\"scene\":{},\"points\":[]}",
		    JSON, NULL, 422, "scene", NULL},
	};

	check_all(state, list, COUNT(list));
}

static void test_422_wrong_points_and_outputs(void **state)
{
	static const struct wrong list[] = {
		{"POST", EVAL, "{\"scene\":" POINT ",\"points\":[[0,0,0],"
		    "[1,2]]}", JSON, NULL, 422, "/points/1", NULL},
		{"POST", EVAL, "{\"scene\":" POINT ",\"points\":[0,0,0,1]}",
		    JSON, NULL, 422, "/points", NULL},
		{"POST", EVAL, "{\"scene\":" POINT ",\"points\":[[0,0,0],"
		    "[0,1e39,0]]}", JSON, NULL, 422, "/points/1", NULL},
		{"POST", EVAL, "{\"scene\":" POINT ",\"points\":\"many\"}",
		    JSON, NULL, 422, "/points", NULL},
		{"POST", EVAL, "{\"scene\":" POINT "}", JSON, NULL, 422,
		    "points", NULL},
		{"POST", EVAL, "{\"scene\":" POINT ",\"points\":[],"
		    "\"outputs\":[\"value\",\"normals\"]}", JSON, NULL, 422,
		    "/outputs/1", "normals"},
		{"POST", EVAL, "{\"scene\":" POINT ",\"points\":[],"
		    "\"outputs\":[\"colour\"]}", JSON, NULL, 422, "colour", NULL},
		{"POST", EVAL "?outputs=value,value", "{}", JSON, NULL, 422,
		    "value", NULL},
		{"POST", EVAL, "{\"scene\":" POINT ",\"points\":[],"
		    "\"extra\":1}", JSON, NULL, 422, "/extra", NULL},
		{"POST", EVAL, "{\"points\":[[0,1e39,0]],\"scene\":"
		    "{\"format\":\"blobfield/1\",\"root\":{}}}", JSON, NULL,
		    422, "\"/points/0/1\"", "\"/scene/root\""},
	};

	check_all(state, list, COUNT(list));
}

static void test_limits_are_the_configured_ones(void **state)
{
	static const char *const arguments[] = {"--no-measure",
	    "--max-points=2", "--max-nodes", "3", "--max-body", "1k", NULL};
	static const struct wrong list[] = {
		{"POST", EVAL, "{\"scene\":" POINT ",\"points\":[[0,0,0],"
		    "[0,0,0],[0,0,0]]}", JSON, NULL, 422, "/points", "limit"},
		{"PUT", "/v1/scenes/x", "{\"format\":\"blobfield/1\",\"root\":"
		    "{\"type\":\"sum\",\"children\":["
		    "{\"type\":\"point\",\"center\":[0,0,0],\"radius\":1},"
		    "{\"type\":\"point\",\"center\":[0,0,0],\"radius\":1},"
		    "{\"type\":\"point\",\"center\":[0,0,0],\"radius\":1}]}}",
		    JSON, NULL, 422, "limit", "3"},
	};
	char large[1200];
	const struct wrong too_large = {"PUT", "/v1/scenes/x", large, JSON,
	    NULL, 413, "1024", "1199"};
	struct daemon d;

	(void)state;
	daemon_start(&d, arguments);
	for (size_t i = 0; i < COUNT(list); i++)
		check_one(d.url, &list[i]);
	memset(large, ' ', sizeof large);
	large[sizeof large - 1] = '\0';
	check_one(d.url, &too_large);
	assert_int_equal(daemon_stop(&d, 15), 0);
}

static void test_422_names_the_operators_that_table_memory_cannot_hold(
    void **state)
{
	static const char *const arguments[] = {"--no-measure",
	    "--table-memory", "30M", NULL};
#define UNION(operator) "\"root\":{\"type\":\"union\",\"operator\":" \
	operator ",\"children\":[{\"type\":\"point\",\"center\":[0,0,0]," \
	"\"radius\":1},{\"type\":\"point\",\"center\":[1,0,0]," \
	"\"radius\":1}]}}"
#define FINE "{\"resolution\":128}" /* 101 MB */
#define NAMED "{\"format\":\"blobfield/1\",\"operators\":{\"fine\":" FINE \
	"}," UNION("\"fine\"")
	static const struct wrong list[] = {
		{"PUT", "/v1/scenes/x", NAMED, JSON, NULL, 422,
		    "\"pointer\":\"/operators\"", "31457280 bytes that "
		    "--table-memory gives"},
		{"POST", EVAL, "{\"scene\":" NAMED ",\"points\":[]}", JSON,
		    NULL, 422, "\"pointer\":\"/scene/operators\"",
		    "/problems/limit"},
		{"PUT", "/v1/scenes/x", "{\"format\":\"blobfield/1\","
		    UNION(FINE), JSON, NULL, 422, "\"pointer\":\"\"",
		    "--table-memory"},
	};
	struct daemon d;

	(void)state;
	daemon_start(&d, arguments);
	for (size_t i = 0; i < COUNT(list); i++)
		check_one(d.url, &list[i]);
	assert_int_equal(daemon_stop(&d, 15), 0);
}

static void test_bad_flags_exit_with_2(void **state)
{
	static const char *const bad[][3] = {
		{"--frobnicate", NULL, NULL},
		{"--listen", "nonsense", NULL},
		{"--listen", NULL, NULL},
		{"--listen=127.0.0.1:65536", NULL, NULL},
		{"--max-body", "-1", NULL},
		{"--max-body", "1T", NULL},
		{"--width=3", NULL, NULL},
		{"--layout", "twisted", NULL},
		{"--quiet=perhaps", NULL, NULL},
		{"stray", NULL, NULL},
	};
	char output[4096];

	(void)state;
	for (size_t i = 0; i < COUNT(bad); i++) {
		assert_int_equal(daemon_run(bad[i], output, sizeof output), 2);
		assert_non_null(strstr(output, "--help"));
		assert_true(strstr(output, "blobfieldd: ") == output);
	}
}

static void test_help_version_and_devices_exit_with_0(void **state)
{
	static const char *const help[] = {"--help", NULL};
	static const char *const version[] = {"--version", NULL};
	static const char *const devices[] = {"--list-devices", NULL};
	char output[8192];

	(void)state;
	assert_int_equal(daemon_run(help, output, sizeof output), 0);
	assert_non_null(strstr(output, "--table-memory"));
	assert_int_equal(daemon_run(version, output, sizeof output), 0);
	assert_int_equal(strncmp(output, "blobfieldd ", 11), 0);
	assert_int_equal(daemon_run(devices, output, sizeof output), 0);
	assert_int_equal(strncmp(output, "0: ", 3), 0);
}

static void test_no_such_device_exits_with_1(void **state)
{
	static const char *const arguments[] = {"--listen", "127.0.0.1:0",
	    "--device", "no device is called so", NULL};
	char output[4096];

	(void)state;
	assert_int_equal(daemon_run(arguments, output, sizeof output), 1);
	assert_non_null(strstr(output, "error: device: "));
}

static void test_address_in_use_exits_with_1(void **state)
{
	const struct daemon *d = *state;
	char address[32], output[4096];
	const char *const arguments[] = {"--listen", address, NULL};

	snprintf(address, sizeof address, "127.0.0.1:%d", d->port);
	assert_int_equal(daemon_run(arguments, output, sizeof output), 1);
	assert_non_null(strstr(output, "in use"));
}

static int setup(void **state)
{
	struct http_reply reply;
	int failed = daemon_setup(state);

	http_json(((struct daemon *)*state)->url, "PUT", "/v1/scenes/here",
	    POINT, &reply);
	http_reply_fini(&reply);
	return failed != 0 || reply.status != 201;
}

int main(void)
{
	const struct CMUnitTest tests[] = {
		cmocka_unit_test(test_400_malformed_json),
		cmocka_unit_test(test_400_malformed_binary),
		cmocka_unit_test(test_400_unknown_query),
		cmocka_unit_test(test_404_unknown_things),
		cmocka_unit_test(test_405_with_allow),
		cmocka_unit_test(test_406_and_415),
		cmocka_unit_test(test_415_for_forms_and_bodies_without_a_type),
		cmocka_unit_test(test_412_preconditions),
		cmocka_unit_test(test_422_wrong_documents),
		cmocka_unit_test(test_422_wrong_points_and_outputs),
		cmocka_unit_test(test_limits_are_the_configured_ones),
		cmocka_unit_test(
		    test_422_names_the_operators_that_table_memory_cannot_hold),
		cmocka_unit_test(test_bad_flags_exit_with_2),
		cmocka_unit_test(test_help_version_and_devices_exit_with_0),
		cmocka_unit_test(test_no_such_device_exits_with_1),
		cmocka_unit_test(test_address_in_use_exits_with_1),
	};

	return cmocka_run_group_tests(tests, setup, daemon_teardown);
}
