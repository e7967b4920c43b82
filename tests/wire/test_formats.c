/*
 * The same points in every form, and the same answer in every form.
 */
#include <stdarg.h>
#include <stddef.h>
#include <setjmp.h>
#include <stdint.h>
#include <cmocka.h>

#include <stdbool.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include <cjson/cJSON.h>

#include "tests/support/daemon.h"
#include "tests/support/http.h"

#define COUNT 100
#define ROW 10 /* value, gradient, hessian */

#define OCTETS "application/octet-stream"
#define NPY "application/x-npy"

static const char scene[] = "{\"format\":\"blobfield/1\",\"root\":"
    "{\"type\":\"union\",\"operator\":\"organic\",\"children\":["
    "{\"type\":\"point\",\"center\":[0,0,0],\"radius\":0.7},"
    "{\"type\":\"segment\",\"a\":[0.5,0,0],\"b\":[0.5,1,0.5],"
    "\"radius\":0.3}]}}";

static float points[COUNT][3];

/* One daemon with the scene under /v1/scenes/f. */
static int setup(void **state)
{
	struct http_reply reply;
	int failed = daemon_setup(state);

	for (int i = 0; i < COUNT; i++) {
		points[i][0] = -0.5f + 0.013f * (float)i;
		points[i][1] = 0.7f - 0.011f * (float)i;
		points[i][2] = 0.003f * (float)i;
	}
	http_json(((struct daemon *)*state)->url, "PUT", "/v1/scenes/f",
	    scene, &reply);
	http_reply_fini(&reply);
	return failed != 0 || reply.status != 201;
}

static void evaluate(void **state, const char *type, const char *accept,
    const void *body, size_t length, struct http_reply *reply)
{
	const struct daemon *d = *state;
	char content_type[80], accepts[80];

	snprintf(content_type, sizeof content_type, "Content-Type: %s", type);
	snprintf(accepts, sizeof accepts, "Accept: %s", accept);
	http_do(d->url, &(struct http_request){
		.path = "/v1/scenes/f/eval?outputs=value,gradient,hessian",
		.body = body,
		.length = length,
		.headers = {content_type, accepts},
	}, reply);
}

/* The reference: raw in, raw out. */
static void reference(void **state, float out[static COUNT * ROW])
{
	struct http_reply reply;
	char type[64];

	evaluate(state, OCTETS, OCTETS, points, sizeof points, &reply);
	assert_int_equal(reply.status, 200);
	assert_int_equal(reply.length, COUNT * ROW * sizeof(float));
	assert_string_equal(http_header(&reply, "Content-Type", type,
	    sizeof type), OCTETS);
	memcpy(out, reply.body, reply.length);
	http_reply_fini(&reply);
}

static char *points_json(bool flat)
{
	char *text = malloc(100 * COUNT + 32);
	size_t length = (size_t)sprintf(text, "{\"points\":[");

	for (int i = 0; i < COUNT; i++)
		length += (size_t)sprintf(text + length,
		    flat ? "%s%.9g,%.9g,%.9g" : "%s[%.9g,%.9g,%.9g]",
		    i > 0 ? "," : "", (double)points[i][0],
		    (double)points[i][1], (double)points[i][2]);
	strcpy(text + length, "]}");
	return text;
}

/* The numbers of list, one level of nesting undone, in order. */
static int flatten(const cJSON *list, float *out)
{
	const cJSON *item, *inner;
	int count = 0;

	cJSON_ArrayForEach(item, list) {
		if (cJSON_IsNumber(item))
			out[count++] = (float)item->valuedouble;
		cJSON_ArrayForEach(inner, item)
			out[count++] = (float)inner->valuedouble;
	}
	return count;
}

/* Every number of a JSON answer is the very float32 of the reference. */
static void check_json(void **state, bool flat)
{
	static const char *const names[] = {"value", "gradient", "hessian"};
	static const int widths[] = {1, 3, 6};
	float expected[COUNT * ROW], got[COUNT * ROW];
	char *body = points_json(flat);
	struct http_reply reply;
	cJSON *json;
	int column = 0;

	reference(state, expected);
	evaluate(state, "application/json", "application/json", body,
	    strlen(body), &reply);
	assert_int_equal(reply.status, 200);
	json = cJSON_Parse(reply.body);
	for (int k = 0; k < 3; k++) {
		const cJSON *list = cJSON_GetObjectItem(json, names[k]);

		assert_int_equal(cJSON_GetArraySize(list),
		    flat ? COUNT * widths[k] : COUNT);
		assert_int_equal(flatten(list, got), COUNT * widths[k]);
		for (int i = 0; i < COUNT * widths[k]; i++)
			assert_true(got[i] == expected[i / widths[k] * ROW +
			    column + i % widths[k]]);
		column += widths[k];
	}
	cJSON_Delete(json);
	http_reply_fini(&reply);
	free(body);
}

static void test_nested_json_agrees_with_raw(void **state)
{
	check_json(state, false);
}

static void test_flat_json_agrees_with_raw(void **state)
{
	check_json(state, true);
}

/* An npy 1.0 file of points in float32 or float64; returns its length. */
static size_t make_npy(bool wide, char *out)
{
	char header[256];
	size_t length = (size_t)snprintf(header, sizeof header,
	    "{'descr': '%s', 'fortran_order': False, 'shape': (%d, 3), }",
	    wide ? "<f8" : "<f4", COUNT);
	size_t padded = (10 + length + 1 + 63) / 64 * 64;

	memcpy(out, "\x93NUMPY\x01\x00", 8);
	out[8] = (char)(padded - 10);
	out[9] = 0;
	memset(out + 10, ' ', padded - 10);
	memcpy(out + 10, header, length);
	out[padded - 1] = '\n';
	for (int i = 0; i < 3 * COUNT; i++) {
		double value = (double)points[i / 3][i % 3];

		if (wide)
			memcpy(out + padded + 8 * i, &value, 8);
		else
			memcpy(out + padded + 4 * i, &points[i / 3][i % 3], 4);
	}
	return padded + (wide ? 8u : 4u) * 3 * COUNT;
}

static void check_npy(void **state, bool wide)
{
	static char npy[256 + 8 * 3 * COUNT];
	float expected[COUNT * ROW];
	struct http_reply reply;

	reference(state, expected);
	evaluate(state, NPY, OCTETS, npy, make_npy(wide, npy), &reply);
	assert_int_equal(reply.status, 200);
	assert_int_equal(reply.length, sizeof expected);
	assert_memory_equal(reply.body, expected, sizeof expected);
	http_reply_fini(&reply);
}

static void test_npy_float32_points_agree_with_raw(void **state)
{
	check_npy(state, false);
}

static void test_npy_float64_points_agree_with_raw(void **state)
{
	check_npy(state, true);
}

static void test_npy_answer_is_a_header_and_the_raw_rows(void **state)
{
	float expected[COUNT * ROW];
	struct http_reply reply;
	size_t header;

	reference(state, expected);
	evaluate(state, OCTETS, NPY, points, sizeof points, &reply);
	assert_int_equal(reply.status, 200);
	assert_memory_equal(reply.body, "\x93NUMPY\x01\x00", 8);
	header = 10 + (size_t)(unsigned char)reply.body[8] +
	    256 * (size_t)(unsigned char)reply.body[9];
	assert_int_equal(header % 64, 0);
	assert_non_null(strstr(reply.body + 10, "'shape': (100, 10)"));
	assert_int_equal(reply.length, header + sizeof expected);
	assert_memory_equal(reply.body + header, expected, sizeof expected);
	http_reply_fini(&reply);
}

static void test_chunked_body_is_as_good_as_any(void **state)
{
	const struct daemon *d = *state;
	char head[] = "POST /v1/scenes/f/eval HTTP/1.1\r\nHost: localhost\r\n"
	    "Content-Type: application/json\r\nConnection: close\r\n"
	    "Transfer-Encoding: chunked\r\n\r\n"
	    "8\r\n{\"points\r\n8\r\n\":[0,0,0\r\n2\r\n]}\r\n0\r\n\r\n";
	char reply[4096];

	assert_int_equal(http_raw(d->port, head, strlen(head), reply,
	    sizeof reply), 200);
	assert_non_null(strstr(reply, "\"count\":1"));
}

static void test_accept_prefers_by_weight(void **state)
{
	struct http_reply reply;
	char type[64];

	evaluate(state, OCTETS, "application/json;q=0.5, " NPY, points, 12,
	    &reply);
	assert_string_equal(http_header(&reply, "Content-Type", type,
	    sizeof type), NPY);
	http_reply_fini(&reply);
	evaluate(state, OCTETS, "*/*", points, 12, &reply);
	assert_string_equal(http_header(&reply, "Content-Type", type,
	    sizeof type), "application/json");
	http_reply_fini(&reply);
}

static void test_no_rows_in_binary(void **state)
{
	struct http_reply reply;

	evaluate(state, OCTETS, OCTETS, "", 0, &reply);
	assert_int_equal(reply.status, 200);
	assert_int_equal(reply.length, 0);
	http_reply_fini(&reply);
	evaluate(state, OCTETS, NPY, "", 0, &reply);
	assert_int_equal(reply.status, 200);
	assert_int_equal(reply.length % 64, 0);
	assert_true(reply.length > 0);
	http_reply_fini(&reply);
}

int main(void)
{
	const struct CMUnitTest tests[] = {
		cmocka_unit_test(test_nested_json_agrees_with_raw),
		cmocka_unit_test(test_flat_json_agrees_with_raw),
		cmocka_unit_test(test_npy_float32_points_agree_with_raw),
		cmocka_unit_test(test_npy_float64_points_agree_with_raw),
		cmocka_unit_test(test_npy_answer_is_a_header_and_the_raw_rows),
		cmocka_unit_test(test_chunked_body_is_as_good_as_any),
		cmocka_unit_test(test_accept_prefers_by_weight),
		cmocka_unit_test(test_no_rows_in_binary),
	};

	return cmocka_run_group_tests(tests, setup, daemon_teardown);
}
