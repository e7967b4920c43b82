/*
 * The field on a regular grid over the wire: what /eval says of its points.
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
#include "tests/support/near.h"

#define BLEND "{\"format\":\"blobfield/1\",\"root\":{\"type\":\"union\"," \
	"\"operator\":\"blend\",\"children\":[" \
	"{\"type\":\"segment\",\"a\":[-2,0,0],\"b\":[2,0,0],\"radius\":0.4}," \
	"{\"type\":\"point\",\"center\":[0,0.1,0.5],\"radius\":0.9}]}}"
#define EVAL "/v1/scenes/blend/eval"
#define GRID "/v1/scenes/blend/grid"
#define NPY "Accept: application/x-npy"
#define OCTETS "Accept: application/octet-stream"
#define JSON "Accept: application/json"
#define SMALL "\"min\":[-1.5,-1,-0.7],\"max\":[2.5,1,1.1]," \
	"\"counts\":[6,5,4]"

struct grid {
	double min[3], max[3];
	size_t counts[3];
};

static const struct grid small = {{-1.5, -1.0, -0.7}, {2.5, 1.0, 1.1},
	{6, 5, 4}};

static size_t total(const struct grid *g)
{
	return g->counts[0] * g->counts[1] * g->counts[2];
}

static float place(const struct grid *g, int axis, size_t i)
{
	const size_t n = g->counts[axis];

	return n == 1 ? (float)g->min[axis] : i + 1 == n ?
	    (float)g->max[axis] : (float)(g->min[axis] + (g->max[axis] -
	    g->min[axis]) * (double)i / (double)(n - 1));
}

/* The points, in the order of volumes. */
static float *points_of(const struct grid *g)
{
	float *xyz = malloc(3 * total(g) * sizeof *xyz);

	assert_non_null(xyz);
	for (size_t i = 0; i < g->counts[0]; i++)
		for (size_t j = 0; j < g->counts[1]; j++)
			for (size_t k = 0; k < g->counts[2]; k++) {
				float *p = xyz + 3 * ((i * g->counts[1] + j) *
				    g->counts[2] + k);

				p[0] = place(g, 0, i);
				p[1] = place(g, 1, j);
				p[2] = place(g, 2, k);
			}
	return xyz;
}

static void put(const char *url)
{
	struct http_reply reply;

	http_json(url, "PUT", "/v1/scenes/blend", BLEND, &reply);
	assert_true(reply.status == 200 || reply.status == 201);
	http_reply_fini(&reply);
}

static void ask(const char *url, const char *path, const char *body,
    const char *header, struct http_reply *reply)
{
	http_do(url, &(struct http_request){
		.method = "POST",
		.path = path,
		.body = body,
		.length = strlen(body),
		.headers = {"Content-Type: application/json", header},
	}, reply);
}

/* The same points by /eval; query: "?outputs=...". */
static void ask_eval(const char *url, const char *query, const char *accept,
    const struct grid *g, struct http_reply *reply)
{
	float *xyz = points_of(g);
	char path[128];

	snprintf(path, sizeof path, EVAL "%s", query);
	http_do(url, &(struct http_request){
		.path = path,
		.body = xyz,
		.length = 3 * total(g) * sizeof *xyz,
		.headers = {"Content-Type: application/octet-stream", accept},
	}, reply);
	assert_int_equal(reply->status, 200);
	free(xyz);
}

static void assert_same_octets(const char *url, const char *body,
    const char *query, const struct grid *g, size_t columns)
{
	struct http_reply grid, eval;
	char path[128];

	snprintf(path, sizeof path, GRID "%s", query);
	ask(url, path, body, OCTETS, &grid);
	assert_int_equal(grid.status, 200);
	ask_eval(url, query, OCTETS, g, &eval);
	assert_int_equal(grid.length, total(g) * columns * sizeof(float));
	assert_int_equal(grid.length, eval.length);
	assert_memory_equal(grid.body, eval.body, grid.length);
	http_reply_fini(&grid);
	http_reply_fini(&eval);
}

static void test_octets_are_those_of_eval(void **state)
{
	const struct daemon *d = *state;

	put(d->url);
	assert_same_octets(d->url, "{" SMALL "}", "", &small, 4);
	assert_same_octets(d->url, "{" SMALL "}", "?outputs=value", &small, 1);
	assert_same_octets(d->url, "{" SMALL "}",
	    "?outputs=value,gradient,hessian,color,normal,curvature&priority="
	    "bulk&deadline=60", &small, 18);
}

/* 150,000 points and 2.4 MB whole, 274,625 and 4.4 MB in pieces. */
static void test_large_grids_are_those_of_eval(void **state)
{
	const struct grid flat = {{-2.0, -1.0, 0.25}, {2.0, 1.0, 9.0},
	    {500, 300, 1}};
	const struct grid cube = {{-2.0, -1.0, -1.0}, {2.0, 1.0, 1.0},
	    {65, 65, 65}};
	const struct daemon *d = *state;

	put(d->url);
	assert_same_octets(d->url, "{\"min\":[-2,-1,0.25],\"max\":[2,1,9],"
	    "\"counts\":[500,300,1]}", "", &flat, 4);
	assert_same_octets(d->url, "{\"min\":[-2,-1,-1],\"max\":[2,1,1],"
	    "\"counts\":[65,65,65]}", "", &cube, 4);
}

/* The header says shape; the numbers behind it are eval's. */
static void assert_npy(const char *url, const char *body, const char *query,
    const struct grid *g, const char *shape)
{
	struct http_reply grid, eval;
	char path[128], expected[160];
	size_t head;

	snprintf(path, sizeof path, GRID "%s", query);
	snprintf(expected, sizeof expected, "{'descr': '<f4', "
	    "'fortran_order': False, 'shape': %s, }", shape);
	ask(url, path, body, NPY, &grid);
	assert_int_equal(grid.status, 200);
	assert_memory_equal(grid.body, "\x93NUMPY\x01\x00", 8);
	assert_memory_equal(grid.body + 10, expected, strlen(expected));
	head = 10 + (unsigned char)grid.body[8] +
	    256 * (size_t)(unsigned char)grid.body[9];
	assert_int_equal(head % 64, 0);
	ask_eval(url, query, OCTETS, g, &eval);
	assert_int_equal(grid.length, head + eval.length);
	assert_memory_equal(grid.body + head, eval.body, eval.length);
	http_reply_fini(&grid);
	http_reply_fini(&eval);
}

static void test_npy_has_the_shape_of_the_grid(void **state)
{
	const struct grid cube = {{-2.0, -1.0, -1.0}, {2.0, 1.0, 1.0},
	    {65, 65, 65}};
	const struct daemon *d = *state;

	put(d->url);
	assert_npy(d->url, "{" SMALL "}", "?outputs=value", &small,
	    "(6, 5, 4)");
	assert_npy(d->url, "{" SMALL "}", "", &small, "(6, 5, 4, 4)");
	assert_npy(d->url, "{" SMALL "}", "?outputs=gradient", &small,
	    "(6, 5, 4, 3)");
	/* in pieces */
	assert_npy(d->url, "{\"min\":[-2,-1,-1],\"max\":[2,1,1],"
	    "\"counts\":[65,65,65]}", "", &cube, "(65, 65, 65, 4)");
}

/* Numbers of name in json as those of rows, from the first-th of columns on. */
static void assert_array(const cJSON *json, const char *name,
    const float *rows, size_t columns, size_t first, size_t floats)
{
	const cJSON *item;
	size_t i = 0;

	cJSON_ArrayForEach(item, cJSON_GetObjectItem(json, name)) {
		const float expected = rows[i / floats * columns + first +
		    i % floats];

		/* -0 is printed as 0 */
		assert_true((float)item->valuedouble == expected);
		i++;
	}
	assert_int_equal(i, total(&small) * floats);
}

static void test_json_is_flat_and_says_the_counts(void **state)
{
	const struct daemon *d = *state;
	struct http_reply grid, eval;
	cJSON *json;

	put(d->url);
	ask(d->url, GRID, "{" SMALL "}", JSON, &grid);
	assert_int_equal(grid.status, 200);
	assert_ptr_equal(strstr(grid.body, "{\"count\":120,\"counts\":"
	    "[6,5,4],\"value\":["), grid.body);
	ask_eval(d->url, "", OCTETS, &small, &eval);
	json = cJSON_Parse(grid.body);
	assert_non_null(json);
	assert_array(json, "value", (const float *)(void *)eval.body, 4, 0, 1);
	assert_array(json, "gradient", (const float *)(void *)eval.body, 4, 1,
	    3);
	assert_int_equal(cJSON_GetArraySize(json), 4);
	cJSON_Delete(json);
	http_reply_fini(&grid);
	http_reply_fini(&eval);
	/* the body's outputs go before the query's */
	ask(d->url, GRID "?outputs=hessian", "{" SMALL ",\"outputs\":"
	    "[\"value\"]}", NULL, &grid);
	assert_non_null(strstr(grid.body, "\"value\""));
	assert_null(strstr(grid.body, "\"hessian\""));
	http_reply_fini(&grid);
}

/* Printed as it leaves. */
static void test_large_json_says_the_counts(void **state)
{
	const struct daemon *d = *state;
	struct http_reply reply;
	cJSON *json;

	put(d->url);
	ask(d->url, GRID, "{\"min\":[-2,-1,-1],\"max\":[2,1,1],"
	    "\"counts\":[65,65,65]}", NULL, &reply);
	assert_int_equal(reply.status, 200);
	json = cJSON_Parse(reply.body);
	assert_non_null(strstr(reply.body, "{\"count\":274625,\"counts\":"
	    "[65,65,65],\"value\":["));
	assert_int_equal(cJSON_GetArraySize(cJSON_GetObjectItem(json,
	    "gradient")), 3 * 274625);
	cJSON_Delete(json);
	http_reply_fini(&reply);
}

/* One point is min's. */
static void test_one_of_each_is_the_point_min(void **state)
{
	const struct grid one = {{0.25, 0.125, 0.5}, {2.0, 2.0, 2.0},
	    {1, 1, 1}};
	const struct daemon *d = *state;

	put(d->url);
	assert_same_octets(d->url, "{\"min\":[0.25,0.125,0.5],"
	    "\"max\":[2,2,2],\"counts\":[1,1,1]}", "", &one, 4);
}

/* Far corners, of 4096 points. */
static void test_the_ends_are_what_was_asked(void **state)
{
	const struct grid far = {{-1e9, 0.1, 0.3}, {1e9, 0.1, 0.3},
	    {4096, 1, 2}};
	const struct daemon *d = *state;

	put(d->url);
	assert_same_octets(d->url, "{\"min\":[-1e9,0.1,0.3],"
	    "\"max\":[1e9,0.1,0.3],\"counts\":[4096,1,2]}", "", &far, 4);
}

/* ---- what is refused ---- */

static void refused(const char *url, const char *path, const char *body,
    const char *header, long status, const char *what)
{
	struct http_reply reply;
	char type[64];

	ask(url, path, body, header, &reply);
	if (reply.status != status || strstr(reply.body, what) == NULL)
		fail_msg("%s: %ld %s", body, reply.status, reply.body);
	assert_string_equal(http_header(&reply, "Content-Type", type,
	    sizeof type), "application/problem+json");
	http_reply_fini(&reply);
}

static void test_errors_name_their_places(void **state)
{
	static const char *const cases[][2] = {
		{"[]", "must be an object"},
		{"{}", "required field 'counts' is missing"},
		{"{" SMALL ",\"points\":[]}", "\"/points\""},
		{"{" SMALL ",\"outputs\":[\"value\",\"frob\"]}",
		    "\"/outputs/1\""},
		{"{" SMALL ",\"outputs\":[]}", "\"/outputs\""},
		{"{\"min\":[0,0,0],\"max\":[1,1,1],\"counts\":[2,0,2]}",
		    "\"/counts/1\""},
		{"{\"min\":[0,0,0],\"max\":[1,1,1],\"counts\":[2,2,4097]}",
		    "\"/counts/2\""},
		{"{\"min\":[0,0,0],\"max\":[1,1,1],\"counts\":[2.5,2,2]}",
		    "\"/counts/0\""},
		{"{\"min\":[0,0,0],\"max\":[1,1,1],\"counts\":[2,2]}",
		    "\"/counts\""},
		{"{\"min\":[0,0,0],\"max\":[1,-1,1],\"counts\":[2,2,2]}",
		    "\"/max/1\""},
		{"{\"min\":[0,-1.1e9,0],\"max\":[1,1,1],\"counts\":[2,2,2]}",
		    "\"/min/1\""},
		{"{\"min\":[0,\"a\",0],\"max\":[1,1,1],\"counts\":[2,2,2]}",
		    "\"/min/1\""},
	};
	const struct daemon *d = *state;

	put(d->url);
	for (size_t i = 0; i < sizeof cases / sizeof *cases; i++)
		refused(d->url, GRID, cases[i][0], NULL, 422, cases[i][1]);
	refused(d->url, GRID, "{" SMALL, NULL, 400, "/problems/");
	refused(d->url, GRID, "", NULL, 400, "/problems/");
	refused(d->url, GRID "?outputs=frob", "{" SMALL "}", NULL, 422,
	    "\"?outputs\"");
	refused(d->url, GRID "?priority=last&deadline=-1", "{" SMALL "}", NULL,
	    422, "\"?deadline\"");
	refused(d->url, GRID "?iso=1", "{" SMALL "}", NULL, 400, "iso");
}

static void test_more_points_than_allowed_are_a_limit(void **state)
{
	const struct daemon *d = *state;

	put(d->url);
	refused(d->url, GRID, "{\"min\":[0,0,0],\"max\":[1,1,1],"
	    "\"counts\":[201,200,200]}", NULL, 422, "\"/counts\"");
	refused(d->url, GRID, "{\"min\":[0,0,0],\"max\":[1,1,1],"
	    "\"counts\":[4096,4096,4096]}", NULL, 422, "/problems/limit");
}

static void test_heads_are_checked_as_those_of_eval(void **state)
{
	const struct daemon *d = *state;
	struct http_reply reply;
	char tag[64], header[96];

	put(d->url);
	refused(d->url, "/v1/scenes/nobody/grid", "{" SMALL "}", NULL, 404,
	    "/problems/not-found");
	refused(d->url, GRID, "{" SMALL "}", "If-Match: \"0123\"", 412,
	    "/problems/");
	refused(d->url, GRID, "{" SMALL "}", "Accept: image/png", 406,
	    "/problems/");
	http_do(d->url, &(struct http_request){.path = GRID, .body = "abcd",
	    .length = 4, .headers = {"Content-Type: "
	    "application/octet-stream"}}, &reply);
	assert_int_equal(reply.status, 415);
	http_reply_fini(&reply);
	http_do(d->url, &(struct http_request){.method = "HEAD", .path = GRID},
	    &reply);
	assert_int_equal(reply.status, 405);
	assert_int_equal(reply.length, 0);
	http_reply_fini(&reply);
	http_do(d->url, &(struct http_request){.method = "GET", .path = GRID},
	    &reply);
	assert_int_equal(reply.status, 405);
	assert_string_equal(http_header(&reply, "Allow", tag, sizeof tag),
	    "POST, OPTIONS");
	http_reply_fini(&reply);
	ask(d->url, GRID, "{" SMALL "}", NULL, &reply);
	http_header(&reply, "ETag", tag, sizeof tag);
	assert_int_equal(strlen(tag), 34);
	http_reply_fini(&reply);
	snprintf(header, sizeof header, "If-Match: %s", tag);
	ask(d->url, GRID, "{" SMALL "}", header, &reply);
	assert_int_equal(reply.status, 200);
	http_reply_fini(&reply);
}

/* ---- as a volume ---- */

static void upload(const char *url, const struct http_reply *file,
    char id[static 40])
{
	struct http_reply reply;
	cJSON *json;

	http_do(url, &(struct http_request){
		.path = "/v1/volumes?min=-3,-2,-2&max=3,2,2&kind=field",
		.body = file->body,
		.length = file->length,
		.headers = {"Content-Type: application/x-npy"},
	}, &reply);
	assert_int_equal(reply.status, 201);
	assert_non_null(strstr(reply.body, "\"shape\":[31,21,25]"));
	json = cJSON_Parse(reply.body);
	snprintf(id, 40, "%s", cJSON_GetStringValue(cJSON_GetObjectItem(json,
	    "id")));
	cJSON_Delete(json);
	http_reply_fini(&reply);
}

/* A grid goes up as the volume that it came from, and has its values. */
static void test_npy_is_a_volume(void **state)
{
	static const char body[] = "{\"min\":[-3,-2,-2],\"max\":[3,2,2],"
	    "\"counts\":[31,21,25],\"outputs\":[\"value\"]}";
	const struct daemon *d = *state;
	struct http_reply file, before, after;
	char id[40], scene[256];
	double error = 0.0, most = 0.0;

	put(d->url);
	ask(d->url, GRID, body, NPY, &file);
	assert_int_equal(file.status, 200);
	upload(d->url, &file, id);
	snprintf(scene, sizeof scene, "{\"format\":\"blobfield/1\",\"root\":{"
	    "\"type\":\"volume\",\"volume\":\"%s\"}}", id);
	http_json(d->url, "PUT", "/v1/scenes/again", scene, &after);
	assert_int_equal(after.status, 201);
	http_reply_fini(&after);
	ask(d->url, GRID, body, OCTETS, &before);
	ask(d->url, "/v1/scenes/again/grid", body, OCTETS, &after);
	assert_int_equal(after.status, 200);
	assert_int_equal(after.length, before.length);
	for (size_t i = 0; i < before.length / sizeof(float); i++) {
		const float a = ((const float *)(void *)before.body)[i];
		const float b = ((const float *)(void *)after.body)[i];
		const double off = a > b ? (double)(a - b) : (double)(b - a);

		error = off > error ? off : error;
		most = (double)a > most ? (double)a : most;
	}
	printf("measured: %.2g\n", error);
	assert_true(most > 0.9);
	assert_near(error, 0.0, 2e-6); /* measured: 2.4e-7 */
	http_reply_fini(&file);
	http_reply_fini(&before);
	http_reply_fini(&after);
}

int main(void)
{
	const struct CMUnitTest tests[] = {
		cmocka_unit_test(test_octets_are_those_of_eval),
		cmocka_unit_test(test_large_grids_are_those_of_eval),
		cmocka_unit_test(test_npy_has_the_shape_of_the_grid),
		cmocka_unit_test(test_json_is_flat_and_says_the_counts),
		cmocka_unit_test(test_large_json_says_the_counts),
		cmocka_unit_test(test_one_of_each_is_the_point_min),
		cmocka_unit_test(test_the_ends_are_what_was_asked),
		cmocka_unit_test(test_errors_name_their_places),
		cmocka_unit_test(test_more_points_than_allowed_are_a_limit),
		cmocka_unit_test(test_heads_are_checked_as_those_of_eval),
		cmocka_unit_test(test_npy_is_a_volume),
	};

	return cmocka_run_group_tests(tests, daemon_setup, daemon_teardown);
}
