/*
 * Rays over the wire.
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
#include "core/raycast.h"
#include "core/tape.h"
#include "proto/document.h"
#include "proto/fault.h"
#include "proto/geometry_answer.h"
#include "tests/support/daemon.h"
#include "tests/support/http.h"
#include "tests/support/near.h"
#include "tests/support/npy.h"
#include "tests/support/random_tree.h"

#define POINT "{\"format\":\"blobfield/1\",\"root\":{\"type\":\"point\"," \
	"\"center\":[0,0,0],\"radius\":1,\"material\":{\"color\":[1,0.5,0]}}}"

/* A tube with a ball, a hole through both, and a thin shell. */
#define PARTS "{\"format\":\"blobfield/1\",\"root\":{\"type\":\"union\"," \
	"\"operator\":\"sharp\",\"children\":[" \
	"{\"type\":\"difference\",\"children\":[" \
	"{\"type\":\"union\",\"operator\":\"blend\",\"children\":[" \
	"{\"type\":\"segment\",\"a\":[-2,0,0],\"b\":[2,0,0],\"radius\":0.4}," \
	"{\"type\":\"point\",\"center\":[0,0,0],\"radius\":0.9}]}," \
	"{\"type\":\"segment\",\"a\":[0,0,-2],\"b\":[0,0,2]," \
	"\"radius\":0.2}]}," \
	"{\"type\":\"difference\",\"operator\":\"sharp\",\"children\":[" \
	"{\"type\":\"sphere\",\"center\":[0,0,3],\"radius\":0.5," \
	"\"falloff\":0.25}," \
	"{\"type\":\"sphere\",\"center\":[0,0,3],\"radius\":0.49," \
	"\"falloff\":0.25}]}]}}"

#define JSON "Content-Type: application/json"
#define OCTETS "Content-Type: application/octet-stream"
#define NPY "Content-Type: application/x-npy"

static void put(const char *url, const char *id, const char *document)
{
	struct http_reply reply;
	char path[64];

	snprintf(path, sizeof path, "/v1/scenes/%s", id);
	http_json(url, "PUT", path, document, &reply);
	assert_true(reply.status == 200 || reply.status == 201);
	http_reply_fini(&reply);
}

static long cast(const char *url, const char *path, const void *body,
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

static cJSON *cast_json(const char *url, const char *path, const char *body)
{
	struct http_reply reply;
	cJSON *json;

	assert_int_equal(cast(url, path, body, strlen(body), JSON, NULL,
	    &reply), 200);
	json = cJSON_Parse(reply.body);
	assert_non_null(json);
	http_reply_fini(&reply);
	return json;
}

static const cJSON *part(const cJSON *json, const char *name, int ray)
{
	return cJSON_GetArrayItem(cJSON_GetObjectItem(json, name), ray);
}

static double number(const cJSON *json, const char *name, int ray)
{
	return cJSON_GetNumberValue(part(json, name, ray));
}

static double element(const cJSON *json, const char *name, int ray, int i)
{
	return cJSON_GetNumberValue(cJSON_GetArrayItem(part(json, name, ray),
	    i));
}

static void test_rays_meet_a_sphere(void **state)
{
	const struct daemon *d = *state;
	cJSON *json;

	put(d->url, "point", POINT);
	json = cast_json(d->url, "/v1/scenes/point/raycast", "{\"rays\":["
	    "[0,0,5,0,0,-2],[0.6,-3,0,0,1,0],[0,0,5,0,0,1],[1.1,0,5,0,0,-1],"
	    "[0,0,0,0,3,0]]}");
	assert_int_equal(cJSON_GetNumberValue(cJSON_GetObjectItem(json,
	    "count")), 5);
	assert_true(cJSON_IsTrue(part(json, "hit", 0)));
	/* float32's spacing is 4.8e-7 at 4 */
	assert_near(number(json, "distance", 0), 4.0, 2e-6);
	assert_near(element(json, "position", 0, 2), 1.0, 2e-6);
	assert_near(number(json, "value", 0), 0.5, 2e-6);
	assert_near(element(json, "normal", 0, 2), 1.0, 1e-6);
	assert_near(element(json, "color", 0, 1), 0.5, 1e-6);
	/* d/dr (1 - r^2/R^2)^3 at r = 1: -6 / R^2 (1/2)^(2/3) */
	assert_near(element(json, "gradient", 0, 2), -6.0 * (1.0 -
	    cbrt(0.5)) * pow(0.5, 2.0 / 3.0), 2e-6);
	assert_string_equal(cJSON_GetStringValue(part(json, "node", 0)),
	    "/root");
	assert_near(number(json, "distance", 1), 3.0 - 0.8, 3e-6);
	assert_near(element(json, "normal", 1, 0), 0.6, 3e-6);
	assert_true(cJSON_IsFalse(part(json, "hit", 2)));
	assert_true(cJSON_IsNull(part(json, "distance", 2)));
	assert_true(cJSON_IsNull(part(json, "position", 2)));
	assert_true(cJSON_IsNull(part(json, "node", 2)));
	assert_true(cJSON_IsFalse(part(json, "hit", 3)));
	/* from inside: where it leaves */
	assert_near(number(json, "distance", 4), 1.0, 2e-6);
	cJSON_Delete(json);
}

static void test_iso_and_distance_are_said_in_two_ways(void **state)
{
	const struct daemon *d = *state;
	const double at = sqrt((1.0 - cbrt(0.25)) / (1.0 - cbrt(0.5)));
	cJSON *json;

	put(d->url, "point", POINT);
	json = cast_json(d->url, "/v1/scenes/point/raycast?iso=0.25",
	    "{\"rays\":[[0,0,5,0,0,-1]]}");
	assert_near(element(json, "position", 0, 2), at, 3e-6);
	cJSON_Delete(json);
	json = cast_json(d->url, "/v1/scenes/point/raycast?iso=0.125&"
	    "max_distance=1", "{\"rays\":[0,0,5,0,0,-1],\"iso\":0.25,"
	    "\"max_distance\":4.5}");
	assert_near(number(json, "position", 2), at, 3e-6);
	cJSON_Delete(json);
	json = cast_json(d->url, "/v1/scenes/point/raycast",
	    "{\"rays\":[[0,0,5,0,0,-1]],\"max_distance\":3.9}");
	assert_true(cJSON_IsFalse(part(json, "hit", 0)));
	cJSON_Delete(json);
	json = cast_json(d->url, "/v1/scenes/point/raycast",
	    "{\"rays\":[]}");
	assert_int_equal(cJSON_GetArraySize(cJSON_GetObjectItem(json,
	    "hit")), 0);
	cJSON_Delete(json);
}

static void check_rows(const float *rows)
{
	assert_near(rows[RAY_HIT], 1.0, 0.0);
	assert_near(rows[RAY_DISTANCE], 4.0, 2e-6);
	assert_near(rows[RAY_POSITION + 2], 1.0, 2e-6);
	assert_near(rows[RAY_VALUE], 0.5, 2e-6);
	assert_near(rows[RAY_COLOR], 1.0, 1e-6);
	assert_near(rows[RAY_LEAF], 0.0, 0.0);
	for (int i = 0; i < RAY_COLUMNS; i++)
		assert_near(rows[RAY_COLUMNS + i], i == RAY_LEAF ? -1.0 : 0.0,
		    0.0);
}

static void test_numbers_both_ways(void **state)
{
	static const float rays[12] = {0, 0, 5, 0, 0, -1, 0, 0, 5, 0, 0, 1};
	static const char path[] = "/v1/scenes/point/raycast?tolerance=1e-3";
	const struct daemon *d = *state;
	struct http_reply reply;
	size_t length;
	char *file;

	put(d->url, "point", POINT);
	assert_int_equal(cast(d->url, path, rays, sizeof rays, OCTETS,
	    "Accept: application/octet-stream", &reply), 200);
	assert_int_equal(reply.length, 2 * RAY_COLUMNS * sizeof(float));
	check_rows((const float *)(const void *)reply.body);
	http_reply_fini(&reply);
	file = npy_file("<f4", "False", "(2, 6)", rays, sizeof rays, &length);
	assert_int_equal(cast(d->url, path, file, length, NPY,
	    "Accept: application/x-npy", &reply), 200);
	free(file);
	assert_non_null(strstr(reply.body + 10, "(2, 13)"));
	check_rows((const float *)(const void *)(reply.body + reply.length -
	    2 * RAY_COLUMNS * sizeof(float)));
	http_reply_fini(&reply);
	assert_int_equal(cast(d->url, path, rays, 23, OCTETS, NULL, &reply),
	    400);
	http_reply_fini(&reply);
	assert_int_equal(cast(d->url, "/v1/scenes/point/raycast?iso=-1", rays,
	    sizeof rays, OCTETS, NULL, &reply), 422);
	assert_non_null(strstr(reply.body, "\"?iso\""));
	http_reply_fini(&reply);
}

static void test_wrong_rays_are_named(void **state)
{
	static const char body[] = "{\"rays\":[[0,0,5,0,0,-1],[0,0,0,0,0,0],"
	    "[1e39,0,0,0,0,1]],\"max_distance\":-1}";
	const struct daemon *d = *state;
	struct http_reply reply;

	put(d->url, "point", POINT);
	assert_int_equal(cast(d->url, "/v1/scenes/point/raycast", body,
	    strlen(body), JSON, NULL, &reply), 422);
	assert_non_null(strstr(reply.body, "\"/rays/1\""));
	assert_non_null(strstr(reply.body, "\"/rays/2\""));
	assert_non_null(strstr(reply.body, "\"/max_distance\""));
	http_reply_fini(&reply);
}

static double value_at(const struct tape *tape, const float *ray, double t)
{
	struct jet f;

	evaluate(tape, (struct vec3){ray[0] + t * ray[3], ray[1] + t * ray[4],
	    ray[2] + t * ray[5]}, 0, &f);
	return f.value;
}

/*
 * Against steps of 1e-3 by the float64 evaluator: the first change of side is
 * where the ray hits, as far as the device's own error goes, and no ray misses
 * what such steps find.
 */
static void test_rays_meet_what_small_steps_find(void **state)
{
	enum { RAYS = 200 };
	const struct daemon *d = *state;
	const struct document_limits limits = {.max_nodes = 100};
	struct random_stream random = {5};
	float rays[RAYS][RAY_FLOATS];
	struct faults faults = {0};
	struct document *document;
	struct http_reply reply;
	const float *row;
	double worst = 0.0;
	int hits = 0;

	put(d->url, "parts", PARTS);
	assert_int_equal(document_parse(PARTS, strlen(PARTS), &limits,
	    &document, &faults), ERR_OK);
	for (int i = 0; i < RAYS; i++) {
		/* from a sphere to near the middle, half of them the shell's */
		const double z = random_in(&random, -1.0, 1.0);
		const double phi = random_in(&random, 0.0, 6.28318);
		const double r = 6.0 * sqrt(1.0 - z * z);
		struct vec3 from = {r * cos(phi), r * sin(phi), 6.0 * z};
		struct vec3 to = {random_in(&random, -0.8, 0.8),
		    random_in(&random, -0.8, 0.8),
		    random_in(&random, -0.8, 0.8) + (i % 2 ? 3.0 : 0.0)};
		struct vec3 u = vec3_unit(vec3_sub(to, from));
		const double numbers[6] = {from.x, from.y, from.z, u.x, u.y,
		    u.z};

		for (int k = 0; k < RAY_FLOATS; k++)
			rays[i][k] = (float)numbers[k];
	}
	assert_int_equal(cast(d->url, "/v1/scenes/parts/raycast", rays,
	    sizeof rays, OCTETS, "Accept: application/octet-stream", &reply),
	    200);
	row = (const float *)(const void *)reply.body;
	for (int i = 0; i < RAYS; i++, row += RAY_COLUMNS) {
		const double end = row[RAY_HIT] != 0.0f ?
		    row[RAY_DISTANCE] - 2e-3 : 12.0;

		for (double t = 0.0; t < end; t += 1e-3)
			assert_true(value_at(document_tape(document), rays[i],
			    t) < 0.502);
		if (row[RAY_HIT] == 0.0f)
			continue;
		hits++;
		worst = fmax(worst, fabs(value_at(document_tape(document),
		    rays[i], row[RAY_DISTANCE]) - 0.5));
		assert_true(row[RAY_LEAF] >= 0.0f && row[RAY_LEAF] < 5.0f);
	}
	print_message("measured: %d of %d hit, f there off by %.1e\n", hits,
	    RAYS, worst);
	assert_true(hits > 100);
	assert_true(worst < 1e-4);
	http_reply_fini(&reply);
	document_free(document);
}

static void test_rays_name_the_node(void **state)
{
	const struct daemon *d = *state;
	cJSON *json;

	put(d->url, "parts", PARTS);
	json = cast_json(d->url, "/v1/scenes/parts/raycast", "{\"rays\":["
	    "[-1.9,-5,0,0,1,0],[0,-5,0.3,0,1,0],[0,0,1,0.3,0,0],"
	    "[0,0,9,0,0,-1],[0,0,3,0,0,1]]}");
	assert_string_equal(cJSON_GetStringValue(part(json, "node", 0)),
	    "/root/children/0/children/0/children/0");
	assert_string_equal(cJSON_GetStringValue(part(json, "node", 1)),
	    "/root/children/0/children/0/children/1");
	assert_string_equal(cJSON_GetStringValue(part(json, "node", 3)),
	    "/root/children/1/children/0");
	assert_near(number(json, "distance", 3), 5.5, 1e-5);
	assert_string_equal(cJSON_GetStringValue(part(json, "node", 4)),
	    "/root/children/1/children/1");
	assert_near(number(json, "distance", 4), 0.49, 1e-5);
	cJSON_Delete(json);
}

int main(void)
{
	const struct CMUnitTest tests[] = {
		cmocka_unit_test(test_rays_meet_a_sphere),
		cmocka_unit_test(test_iso_and_distance_are_said_in_two_ways),
		cmocka_unit_test(test_numbers_both_ways),
		cmocka_unit_test(test_wrong_rays_are_named),
		cmocka_unit_test(test_rays_meet_what_small_steps_find),
		cmocka_unit_test(test_rays_name_the_node),
	};

	return cmocka_run_group_tests(tests, daemon_setup, daemon_teardown);
}
