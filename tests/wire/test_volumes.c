/*
 * Volumes: uploading, listing, use in documents, deleting, and the bound on
 * their memory.
 */
#include <stdarg.h>
#include <stddef.h>
#include <setjmp.h>
#include <stdint.h>
#include <cmocka.h>

#include <pthread.h>
#include <signal.h>
#include <stdbool.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <unistd.h>

#include <cjson/cJSON.h>

#include "core/volume.h"
#include "tests/support/daemon.h"
#include "tests/support/http.h"
#include "tests/support/near.h"
#include "tests/support/npy.h"
#include "tests/support/sampled.h"

#define N 33
#define TOTAL ((size_t)N * N * N)
#define POINTS 2000
#define ID_SIZE 40
#define BOX "min=-1,-1,-1&max=1,1,1"
#define AS_FIELD "/v1/volumes?" BOX "&kind=field"
#define AS_DISTANCE "/v1/volumes?" BOX "&kind=distance"

/* f at N^3 points of [-1, 1]^3, plus shift; x fastest with fortran. */
static float *sample(sampled_field *f, float shift, bool fortran)
{
	float *samples = malloc(TOTAL * sizeof *samples);
	struct jet jet;

	assert_non_null(samples);
	for (size_t i = 0; i < N; i++)
		for (size_t j = 0; j < N; j++)
			for (size_t k = 0; k < N; k++) {
				f(vec3((double)i / 16.0 - 1.0,
				    (double)j / 16.0 - 1.0,
				    (double)k / 16.0 - 1.0), &jet);
				samples[fortran ? i + N * (j + N * k) :
				    (i * N + j) * N + k] =
				    (float)jet.value + shift;
			}
	return samples;
}

static void post(const char *url, const char *path, const char *type,
    const char *file, size_t length, struct http_reply *reply)
{
	http_do(url, &(struct http_request){
		.method = "POST",
		.path = path,
		.body = file,
		.length = length,
		.headers = {type},
	}, reply);
}

static void post_npy(const char *url, const char *path, const char *descr,
    const char *fortran_order, const char *shape, const void *data,
    size_t bytes, struct http_reply *reply)
{
	size_t length;
	char *file = npy_file(descr, fortran_order, shape, data, bytes,
	    &length);

	post(url, path, "Content-Type: application/x-npy", file, length,
	    reply);
	free(file);
}

static void copy_id(const struct http_reply *reply, char id[static ID_SIZE])
{
	cJSON *json = cJSON_Parse(reply->body);
	const char *text = cJSON_GetStringValue(cJSON_GetObjectItem(json,
	    "id"));

	assert_non_null(text);
	assert_int_equal(strlen(text), 32);
	strcpy(id, text);
	cJSON_Delete(json);
}

/* Uploads f, plus shift; the status, and the id. */
static long upload(const char *url, const char *path, sampled_field *f,
    float shift, char id[static ID_SIZE])
{
	float *samples = sample(f, shift, false);
	struct http_reply reply;

	post_npy(url, path, "<f4", "False", "(33, 33, 33)", samples,
	    TOTAL * sizeof *samples, &reply);
	id[0] = '\0';
	if (reply.status < 300)
		copy_id(&reply, id);
	free(samples);
	http_reply_fini(&reply);
	return reply.status;
}

static long ask(const char *url, const char *method, const char *pattern,
    const char *id, struct http_reply *reply)
{
	char path[128];

	snprintf(path, sizeof path, pattern, id);
	http_do(url, &(struct http_request){.method = method, .path = path},
	    reply);
	return reply->status;
}

static void assert_asked(const char *url, const char *method,
    const char *pattern, const char *id, long status)
{
	struct http_reply reply;

	ask(url, method, pattern, id, &reply);
	http_reply_fini(&reply);
	assert_int_equal(reply.status, status);
}

/* A number of /v1/volumes or /v1/info, by its path of two names. */
static double figure(const char *url, const char *path, const char *name,
    const char *inner)
{
	struct http_reply reply;
	cJSON *json, *item;
	double value;

	http_get(url, path, &reply);
	assert_int_equal(reply.status, 200);
	json = cJSON_Parse(reply.body);
	item = cJSON_GetObjectItem(json, name);
	if (inner != NULL)
		item = cJSON_GetObjectItem(item, inner);
	assert_true(cJSON_IsNumber(item));
	value = item->valuedouble;
	cJSON_Delete(json);
	http_reply_fini(&reply);
	return value;
}

static double bytes_alive(const char *url)
{
	return figure(url, "/v1/volumes", "bytes", NULL);
}

/* Deleted scenes' tapes are freed by another thread, soon. */
static void await_bytes(const char *url, double bytes)
{
	for (int i = 0; i < 3000 && bytes_alive(url) != bytes; i++)
		usleep(10000);
	assert_near(bytes_alive(url), bytes, 0.0);
}

static long put_scene(const char *url, const char *name, const char *node,
    struct http_reply *reply)
{
	char document[512], path[64];

	snprintf(document, sizeof document, "{\"format\":\"blobfield/1\","
	    "\"root\":%s}", node);
	snprintf(path, sizeof path, "/v1/scenes/%s", name);
	http_json(url, "PUT", path, document, reply);
	return reply->status;
}

static void keep_scene(const char *url, const char *name, const char *node)
{
	struct http_reply reply;

	put_scene(url, name, node, &reply);
	if (reply.status >= 300)
		print_error("%s\n", reply.body);
	http_reply_fini(&reply);
	assert_true(reply.status < 300);
}

static void keep_volume_scene(const char *url, const char *name,
    const char *id, const char *falloff)
{
	char node[256];

	snprintf(node, sizeof node, "{\"type\":\"volume\",\"volume\":\"%s\"%s}",
	    id, falloff);
	keep_scene(url, name, node);
}

/* value, gradient of POINTS points; for free. */
static float *evaluate(const char *url, const char *name, const float *points)
{
	char path[64];
	struct http_reply reply;
	float *rows = malloc(POINTS * 4 * sizeof *rows);

	assert_non_null(rows);
	snprintf(path, sizeof path, "/v1/scenes/%s/eval", name);
	http_do(url, &(struct http_request){
		.path = path,
		.body = points,
		.length = POINTS * 3 * sizeof *points,
		.headers = {"Content-Type: application/octet-stream",
		    "Accept: application/octet-stream"},
	}, &reply);
	assert_int_equal(reply.status, 200);
	assert_int_equal(reply.length, POINTS * 4 * sizeof *rows);
	memcpy(rows, reply.body, reply.length);
	http_reply_fini(&reply);
	return rows;
}

/* All over [-1.1, 1.1]^3. */
static float *make_points(void)
{
	float *points = malloc(POINTS * 3 * sizeof *points);
	uint32_t state = 3;

	assert_non_null(points);
	for (size_t i = 0; i < POINTS * 3; i++) {
		state = state * 1664525u + 1013904223u;
		points[i] = ((float)(state >> 8) / 8388608.0f - 1.0f) * 1.1f;
	}
	return points;
}

/* ---- tests ---- */

static void test_an_upload_is_told_listed_and_forgotten(void **state)
{
	const char *url = ((struct daemon *)*state)->url;
	float *samples = sample(sampled_bump, 0.0f, false);
	struct http_reply reply, again;
	char id[ID_SIZE], location[80], expected[80];
	cJSON *json;

	post_npy(url, AS_FIELD, "<f4", "False", "(33, 33, 33)", samples,
	    TOTAL * sizeof *samples, &reply);
	assert_int_equal(reply.status, 201);
	copy_id(&reply, id);
	snprintf(expected, sizeof expected, "/v1/volumes/%s", id);
	assert_string_equal(http_header(&reply, "Location", location,
	    sizeof location), expected);
	json = cJSON_Parse(reply.body);
	assert_string_equal(cJSON_GetObjectItem(json, "kind")->valuestring,
	    "field");
	assert_near(cJSON_GetObjectItem(json, "most")->valuedouble, 1.0, 0.0);
	assert_near(cJSON_GetObjectItem(json, "least")->valuedouble, 0.0, 0.0);
	assert_near(cJSON_GetObjectItem(json, "bytes")->valuedouble,
	    (double)(sizeof(struct volume) + TOTAL * 4), 0.0);
	assert_non_null(strstr(reply.body, "\"shape\":[33,33,33],"
	    "\"min\":[-1,-1,-1],\"max\":[1,1,1]"));
	cJSON_Delete(json);
	assert_int_equal(ask(url, "GET", "/v1/volumes/%s", id, &again), 200);
	assert_string_equal(again.body, reply.body);
	http_reply_fini(&again);
	ask(url, "GET", "/v1/volumes", "", &again);
	assert_non_null(strstr(again.body, id));
	http_reply_fini(&again);
	assert_near(figure(url, "/v1/info", "volumes", "count"), 1.0, 0.0);
	assert_near(figure(url, "/v1/info", "volumes", "bytes"),
	    (double)(sizeof(struct volume) + TOTAL * 4), 0.0);
	assert_near(figure(url, "/v1/info", "limits", "volume_memory"),
	    268435456.0, 0.0);
	assert_asked(url, "DELETE", "/v1/volumes/%s", id, 204);
	assert_asked(url, "DELETE", "/v1/volumes/%s", id, 404);
	assert_asked(url, "GET", "/v1/volumes/%s", id, 404);
	assert_near(bytes_alive(url), 0.0, 0.0);
	http_reply_fini(&reply);
	free(samples);
}

/* The id is that of the content, in whatever order and width it comes. */
static void test_the_same_content_is_the_same_volume(void **state)
{
	const char *url = ((struct daemon *)*state)->url;
	float *samples = sample(sampled_bump, 0.0f, true);
	double *doubles = malloc(TOTAL * sizeof *doubles);
	char id[ID_SIZE], same[ID_SIZE], other[ID_SIZE];
	struct http_reply reply;

	assert_non_null(doubles);
	assert_int_equal(upload(url, AS_FIELD, sampled_bump, 0.0f, id), 201);
	assert_int_equal(upload(url, AS_FIELD, sampled_bump, 0.0f, same), 200);
	assert_string_equal(id, same);
	for (size_t i = 0; i < TOTAL; i++)
		doubles[i] = (double)samples[i];
	post_npy(url, AS_FIELD, "<f8", "True", "(33, 33, 33)", doubles,
	    TOTAL * sizeof *doubles, &reply);
	assert_int_equal(reply.status, 200);
	copy_id(&reply, same);
	assert_string_equal(id, same);
	http_reply_fini(&reply);
	assert_int_equal(upload(url, AS_DISTANCE, sampled_bump, 0.0f, other),
	    201);
	assert_string_not_equal(id, other);
	assert_asked(url, "DELETE", "/v1/volumes/%s", other, 204);
	assert_int_equal(upload(url, "/v1/volumes?kind=field&min=-1,-1,-1&"
	    "max=1,1,1.5", sampled_bump, 0.0f, other), 201);
	assert_string_not_equal(id, other);
	assert_asked(url, "DELETE", "/v1/volumes/%s", other, 204);
	assert_asked(url, "DELETE", "/v1/volumes/%s", id, 204);
	free(doubles);
	free(samples);
}

static void test_a_field_in_a_scene_is_the_sampled_function(void **state)
{
	const char *url = ((struct daemon *)*state)->url;
	struct volume *v = sampled_cube(sampled_bump, N, false);
	double params[16], off = 0.0, device_off = 0.0, slope_off = 0.0;
	float *points = make_points(), *rows;
	char id[ID_SIZE];

	volume_prepare(v, 0.0, params);
	assert_int_equal(upload(url, AS_FIELD, sampled_bump, 0.0f, id), 201);
	keep_volume_scene(url, "bump", id, "");
	rows = evaluate(url, "bump", points);
	for (size_t i = 0; i < POINTS; i++) {
		const float *p = points + 3 * i, *r = rows + 4 * i;
		struct vec3 x = vec3(p[0], p[1], p[2]);
		struct jet exact, spline;

		sampled_bump(x, &exact);
		volume_eval(v, params, x, 1, &spline);
		off = fmax(off, fabs(r[0] - exact.value));
		device_off = fmax(device_off, fabs(r[0] - spline.value));
		slope_off = fmax(slope_off, vec3_norm(vec3_sub(
		    vec3(r[1], r[2], r[3]), exact.gradient)));
	}
	print_message("measured: a served 33^3 bump off by %.1e (%.1e of it "
	    "float32), gradient %.1e\n", off, device_off, slope_off);
	assert_near(off, 0.0, 8e-5);          /* 3.9e-5 */
	assert_near(slope_off, 0.0, 2.5e-3);  /* 1.1e-3 */
	assert_near(device_off, 0.0, 1e-6);   /* 2e-7 */
	assert_asked(url, "DELETE", "/v1/scenes/%s", "bump", 204);
	assert_asked(url, "DELETE", "/v1/volumes/%s", id, 204);
	free(points);
	free(rows);
	volume_release(v);
}

static void test_distances_in_a_scene_are_the_sphere(void **state)
{
	const char *url = ((struct daemon *)*state)->url;
	float *points = make_points(), *a, *b;
	struct http_reply reply;
	double off = 0.0;
	char id[ID_SIZE], node[256];

	assert_int_equal(upload(url, AS_DISTANCE, sampled_sphere, 0.0f, id),
	    201);
	keep_volume_scene(url, "distances", id, ",\"falloff\":0.35");
	keep_scene(url, "sphere", "{\"type\":\"sphere\",\"center\":[0,0,0],"
	    "\"radius\":0.6,\"falloff\":0.35}");
	a = evaluate(url, "distances", points);
	b = evaluate(url, "sphere", points);
	for (size_t i = 0; i < 4 * POINTS; i++)
		off = fmax(off, fabs((double)a[i] - (double)b[i]) /
		    (i % 4 ? 100.0 : 1.0));
	print_message("measured: a served sphere of 33^3 distances off by "
	    "%.1e\n", off);
	assert_near(off, 0.0, 1e-5); /* 4.4e-6 */
	/* beyond the nearest face, which is 0.4 away */
	snprintf(node, sizeof node, "{\"type\":\"volume\",\"volume\":\"%s\","
	    "\"falloff\":0.41}", id);
	assert_int_equal(put_scene(url, "wide", node, &reply), 422);
	assert_non_null(strstr(reply.body, "/root"));
	http_reply_fini(&reply);
	assert_asked(url, "DELETE", "/v1/scenes/%s", "sphere", 204);
	assert_asked(url, "DELETE", "/v1/scenes/%s", "distances", 204);
	assert_asked(url, "DELETE", "/v1/volumes/%s", id, 204);
	await_bytes(url, 0.0);
	free(points);
	free(a);
	free(b);
}

/* Scenes keep what they use; new documents cannot have it; uploaded anew it
 * is the same. */
static void test_deleting_leaves_scenes_what_they_use(void **state)
{
	const char *url = ((struct daemon *)*state)->url;
	float *points = make_points(), *before, *after;
	struct http_reply reply;
	char id[ID_SIZE], again[ID_SIZE], node[256];
	double bytes;

	assert_int_equal(upload(url, AS_FIELD, sampled_bump, 0.5f, id), 201);
	bytes = bytes_alive(url);
	assert_true(bytes > 4.0 * (double)TOTAL);
	keep_volume_scene(url, "user", id, "");
	before = evaluate(url, "user", points);
	assert_asked(url, "DELETE", "/v1/volumes/%s", id, 204);
	assert_asked(url, "GET", "/v1/volumes/%s", id, 404);
	after = evaluate(url, "user", points);
	assert_memory_equal(before, after, POINTS * 4 * sizeof *before);
	assert_asked(url, "GET", "/v1/scenes/%s/bounds", "user", 200);
	assert_near(bytes_alive(url), bytes, 0.0);
	assert_near(figure(url, "/v1/info", "volumes", "count"), 0.0, 0.0);
	snprintf(node, sizeof node, "{\"type\":\"volume\",\"volume\":\"%s\"}",
	    id);
	assert_int_equal(put_scene(url, "late", node, &reply), 422);
	assert_non_null(strstr(reply.body, "/root/volume"));
	http_reply_fini(&reply);
	assert_int_equal(upload(url, AS_FIELD, sampled_bump, 0.5f, again),
	    201);
	assert_string_equal(id, again);
	assert_near(bytes_alive(url), bytes, 0.0);
	keep_volume_scene(url, "late", id, "");
	assert_asked(url, "DELETE", "/v1/scenes/%s", "late", 204);
	assert_asked(url, "DELETE", "/v1/volumes/%s", id, 204);
	assert_asked(url, "DELETE", "/v1/scenes/%s", "user", 204);
	await_bytes(url, 0.0);
	free(points);
	free(before);
	free(after);
}

static void test_the_memory_of_volumes_is_bounded(void **state)
{
	/* 144 KB each */
	static const char *const arguments[] = {"--no-measure",
	    "--volume-memory", "300k", NULL};
	char a[ID_SIZE], b[ID_SIZE], c[ID_SIZE];
	struct daemon d;

	(void)state;
	daemon_start(&d, arguments);
	daemon_await_ready(&d);
	assert_int_equal(upload(d.url, AS_FIELD, sampled_bump, 0.1f, a), 201);
	assert_int_equal(upload(d.url, AS_FIELD, sampled_bump, 0.2f, b), 201);
	assert_int_equal(upload(d.url, AS_FIELD, sampled_bump, 0.3f, c), 507);
	assert_int_equal(upload(d.url, AS_FIELD, sampled_bump, 0.1f, a), 200);
	/* deleted, and in use: its memory is not free */
	keep_volume_scene(d.url, "user", a, "");
	assert_asked(d.url, "DELETE", "/v1/volumes/%s", a, 204);
	assert_int_equal(upload(d.url, AS_FIELD, sampled_bump, 0.3f, c), 507);
	assert_asked(d.url, "DELETE", "/v1/volumes/%s", b, 204);
	assert_int_equal(upload(d.url, AS_FIELD, sampled_bump, 0.3f, c), 201);
	/* both on the device at once, and one after the other */
	keep_volume_scene(d.url, "other", c, "");
	for (int i = 0; i < 4; i++) {
		float *points = make_points();

		free(evaluate(d.url, i % 2 ? "user" : "other", points));
		free(points);
	}
	assert_int_equal(daemon_stop(&d, SIGTERM), 0);
}

/* One of several clients that upload, use and delete the same volumes. */
struct client {
	const char *url;
	int number, wrong;
};

static void *upload_and_delete(void *ctx)
{
	struct client *c = ctx;
	float samples[64] = {1.0f};
	struct http_reply reply;
	char scene[16], path[64], id[ID_SIZE];

	snprintf(scene, sizeof scene, "client%d", c->number);
	for (int i = 0; i < 30; i++) {
		char node[128];

		samples[1] = (float)((i + c->number) % 3);
		post_npy(c->url, AS_FIELD, "<f4", "False", "(4, 4, 4)",
		    samples, sizeof samples, &reply);
		c->wrong += reply.status != 201 && reply.status != 200;
		copy_id(&reply, id);
		http_reply_fini(&reply);
		snprintf(node, sizeof node,
		    "{\"type\":\"volume\",\"volume\":\"%s\"}", id);
		/* 422: another client has deleted it meanwhile */
		put_scene(c->url, scene, node, &reply);
		c->wrong += reply.status >= 300 && reply.status != 422;
		http_reply_fini(&reply);
		snprintf(path, sizeof path, "/v1/scenes/%s/eval", scene);
		http_json(c->url, "POST", path, "{\"points\":[[0,0,0]]}",
		    &reply);
		c->wrong += reply.status != 200 && reply.status != 404;
		http_reply_fini(&reply);
		ask(c->url, "DELETE", "/v1/volumes/%s", id, &reply);
		c->wrong += reply.status != 204 && reply.status != 404;
		http_reply_fini(&reply);
	}
	ask(c->url, "DELETE", "/v1/scenes/%s", scene, &reply);
	http_reply_fini(&reply);
	return NULL;
}

static void test_clients_upload_and_delete_the_same_at_once(void **state)
{
	const char *url = ((struct daemon *)*state)->url;
	struct client clients[4];
	pthread_t threads[4];

	for (int i = 0; i < 4; i++) {
		clients[i] = (struct client){url, i, 0};
		assert_int_equal(pthread_create(&threads[i], NULL,
		    upload_and_delete, &clients[i]), 0);
	}
	for (int i = 0; i < 4; i++) {
		pthread_join(threads[i], NULL);
		assert_int_equal(clients[i].wrong, 0);
	}
	await_bytes(url, 0.0);
}

static const struct {
	const char *path, *descr, *shape;
	size_t bytes;
	long status;
	const char *words[2];
} bad[] = {
	{AS_FIELD, "<f4", "(4, 4, 4)", 255, 400, {"255 bytes"}},
	{AS_FIELD, "<f4", "(4, 4, 4", 256, 400, {"npy header"}},
	{AS_FIELD, "<i8", "(4, 4, 4)", 512, 422, {"descr"}},
	{AS_FIELD, "<f4", "(4, 16)", 256, 422, {"(nx, ny, nz)"}},
	{AS_FIELD, "<f4", "(2, 8, 4)", 256, 422, {"axis x"}},
	{AS_FIELD, "<f4", "(4, 4, 5)", 320, 422,
	    {"/3/3/4", "sample [3, 3, 4] is not finite"}},
	{"/v1/volumes?min=0,0,0&max=1,1,1", "<f4", "(4, 4, 4)", 256, 422,
	    {"?kind", "distance"}},
	{"/v1/volumes?min=0,0,0&max=1,1,1&kind=sdf", "<f4", "(4, 4, 4)", 256,
	    422, {"?kind", "distance"}},
	{"/v1/volumes?max=1,1,1&kind=field", "<f4", "(4, 4, 4)", 256, 422,
	    {"?min", "three numbers"}},
	{"/v1/volumes?min=0,0&max=1,1,1&kind=field", "<f4", "(4, 4, 4)", 256,
	    422, {"?min", "three numbers"}},
	{"/v1/volumes?min=0,0,0&max=1,1,1,&kind=field", "<f4", "(4, 4, 4)",
	    256, 422, {"?max", "three numbers"}},
	{"/v1/volumes?min=0,0,0&max=1,x,1&kind=field", "<f4", "(4, 4, 4)",
	    256, 422, {"?max", "three numbers"}},
	{"/v1/volumes?min=0,0,0&max=1,0,1&kind=field", "<f4", "(4, 4, 4)",
	    256, 422, {"?max", "y is 0, not above"}},
	{"/v1/volumes?min=0,0,0&max=1,1,2e9&kind=field", "<f4", "(4, 4, 4)",
	    256, 422, {"?max", "z is 2e+09"}},
	{"/v1/volumes?min=0,0,0&max=1,1e400,1&kind=field", "<f4", "(4, 4, 4)",
	    256, 422, {"?max", "y is inf"}},
	{"/v1/volumes?min=0,0,0&max=1,2e-9,1&kind=field", "<f4", "(4, 4, 4)",
	    256, 422, {"?max", "apart"}},
	{"/v1/volumes?min=0,0,0&max=1,1,1&kind=field&x=1", "<f4", "(4, 4, 4)",
	    256, 400, {"'x'", "min max kind"}},
};

static void test_bad_uploads_are_told_what_is_wrong(void **state)
{
	const char *url = ((struct daemon *)*state)->url;
	float samples[128] = {0.0f};

	samples[79] = NAN;
	for (size_t i = 0; i < sizeof bad / sizeof *bad; i++) {
		struct http_reply reply;
		bool fine;

		post_npy(url, bad[i].path, bad[i].descr, "False",
		    bad[i].shape, samples, bad[i].bytes, &reply);
		fine = reply.status == bad[i].status;
		for (int k = 0; k < 2 && bad[i].words[k] != NULL; k++)
			fine = fine && strstr(reply.body, bad[i].words[k]);
		if (!fine)
			fail_msg("%s %s: %ld %s", bad[i].path, bad[i].shape,
			    reply.status, reply.body);
		http_reply_fini(&reply);
	}
	assert_near(bytes_alive(url), 0.0, 0.0);
}

static void test_uploads_are_npy(void **state)
{
	const char *url = ((struct daemon *)*state)->url;
	struct http_reply reply;

	post(url, AS_FIELD, "Content-Type: application/json", "{}", 2, &reply);
	assert_int_equal(reply.status, 415);
	assert_non_null(strstr(reply.body, "application/x-npy"));
	http_reply_fini(&reply);
	post(url, AS_FIELD, "Content-Type: application/x-npy", "", 0, &reply);
	assert_int_equal(reply.status, 400);
	http_reply_fini(&reply);
}

int main(void)
{
	const struct CMUnitTest tests[] = {
		cmocka_unit_test(test_an_upload_is_told_listed_and_forgotten),
		cmocka_unit_test(test_the_same_content_is_the_same_volume),
		cmocka_unit_test(
		    test_a_field_in_a_scene_is_the_sampled_function),
		cmocka_unit_test(test_distances_in_a_scene_are_the_sphere),
		cmocka_unit_test(test_deleting_leaves_scenes_what_they_use),
		cmocka_unit_test(test_the_memory_of_volumes_is_bounded),
		cmocka_unit_test(
		    test_clients_upload_and_delete_the_same_at_once),
		cmocka_unit_test(test_bad_uploads_are_told_what_is_wrong),
		cmocka_unit_test(test_uploads_are_npy),
	};

	return cmocka_run_group_tests_name("volumes", tests, daemon_setup,
	    daemon_teardown);
}
