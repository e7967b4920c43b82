/*
 * What is kept: scenes, their histories and volumes over kills and restarts; a
 * folder or file that cannot be used; a disk that takes nothing more.
 */
#include <stdarg.h>
#include <stddef.h>
#include <setjmp.h>
#include <stdint.h>
#include <cmocka.h>

#include <fcntl.h>
#include <pthread.h>
#include <signal.h>
#include <stdatomic.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/resource.h>
#include <sys/stat.h>
#include <unistd.h>

#include <cjson/cJSON.h>

#include "core/volume.h"
#include "tests/support/daemon.h"
#include "tests/support/folder.h"
#include "tests/support/http.h"
#include "tests/support/near.h"
#include "tests/support/npy.h"

#define TAG_MAX 64
#define THREADS 4
#define DOCUMENT_MAX 1024

static const char two_nodes[] = "{\"format\":\"blobfield/1\",\"root\":"
    "{\"type\":\"sum\",\"children\":["
    "{\"type\":\"point\",\"center\":[0,0,0],\"radius\":1}]}}";

struct place {
	char folder[PATH_MAX];
	struct daemon d;
};

/* Kernels, of all daemons here: a start takes a second without. */
static char cache[PATH_MAX];

static void start(struct place *p, const char *option, const char *value)
{
	const char *const arguments[] = {"--data", p->folder, "--cache", cache,
	    "--no-measure", option, value, NULL};

	daemon_start(&p->d, arguments);
}

static int make_cache(void **state)
{
	(void)state;
	folder_make(cache);
	return 0;
}

static int remove_cache(void **state)
{
	(void)state;
	folder_remove(cache);
	return 0;
}

static int setup(void **state)
{
	struct place *p = calloc(1, sizeof *p);

	assert_non_null(p);
	folder_make(p->folder);
	*state = p;
	return 0;
}

static int teardown(void **state)
{
	struct place *p = *state;

	folder_remove(p->folder);
	free(p);
	return 0;
}

/* A sphere of that radius. */
static const char *sphere(double radius, char out[static DOCUMENT_MAX])
{
	snprintf(out, DOCUMENT_MAX, "{\"format\":\"blobfield/1\",\"name\":"
	    "\"%g\",\"root\":{\"type\":\"point\",\"center\":[0,0,0],"
	    "\"radius\":%g}}", radius, radius);
	return out;
}

static long put(const struct place *p, const char *path, const char *text,
    struct http_reply *reply)
{
	struct http_reply own;
	long status;

	http_json(p->d.url, "PUT", path, text, &own);
	status = own.status;
	if (reply != NULL)
		*reply = own;
	else
		http_reply_fini(&own);
	return status;
}

static long status_of(const struct place *p, const char *method,
    const char *path)
{
	struct http_reply reply;
	long status;

	http_do(p->d.url, &(struct http_request){.method = method,
	    .path = path}, &reply);
	status = reply.status;
	http_reply_fini(&reply);
	return status;
}

static cJSON *get_json(const struct place *p, const char *path)
{
	struct http_reply reply;
	cJSON *json;

	http_get(p->d.url, path, &reply);
	assert_int_equal(reply.status, 200);
	json = cJSON_Parse(reply.body);
	assert_non_null(json);
	http_reply_fini(&reply);
	return json;
}

static const char *text_of(const cJSON *json, const char *name)
{
	const char *text = cJSON_GetStringValue(cJSON_GetObjectItem(json,
	    name));

	assert_non_null(text);
	return text;
}

/* ---- histories ---- */

static void test_history_is_read_over_a_restart(void **state)
{
	struct place *p = *state;
	char text[DOCUMENT_MAX], path[128], tag[TAG_MAX], condition[128];
	struct http_reply reply;
	cJSON *json, *list, *item;

	start(p, "--history", "3");
	for (int i = 1; i <= 5; i++)
		put(p, "/v1/scenes/h", sphere(i, text), NULL);
	assert_int_equal(put(p, "/v1/scenes/h", sphere(5, text), &reply),
	    200);
	assert_non_null(strstr(reply.body, "\"sequence\":\"5\""));
	http_reply_fini(&reply);
	assert_int_equal(daemon_stop(&p->d, SIGTERM), 0);
	start(p, "--history", "3");
	json = get_json(p, "/v1/scenes/h/revisions");
	list = cJSON_GetObjectItem(json, "revisions");
	assert_int_equal(cJSON_GetArraySize(list), 3);
	assert_null(cJSON_GetObjectItem(json, "next"));
	assert_string_equal(text_of(cJSON_GetArrayItem(list, 0), "sequence"),
	    "5");
	item = cJSON_GetArrayItem(list, 2);
	assert_string_equal(text_of(item, "sequence"), "3");
	assert_int_equal(strlen(text_of(item, "time")), 24);
	snprintf(path, sizeof path, "/v1/scenes/h?revision=%s",
	    text_of(item, "revision"));
	snprintf(tag, sizeof tag, "\"%s\"", text_of(item, "revision"));
	cJSON_Delete(json);
	http_get(p->d.url, path, &reply);
	assert_int_equal(reply.status, 200);
	assert_string_equal(reply.body, sphere(3, text));
	http_header(&reply, "ETag", condition, sizeof condition);
	assert_string_equal(condition, tag);
	http_reply_fini(&reply);
	snprintf(condition, sizeof condition, "If-None-Match: %s", tag);
	http_do(p->d.url, &(struct http_request){.path = path,
	    .headers = {condition}}, &reply);
	assert_int_equal(reply.status, 304);
	http_reply_fini(&reply);
	/* pages */
	json = get_json(p, "/v1/scenes/h/revisions?limit=2");
	assert_int_equal(cJSON_GetArraySize(cJSON_GetObjectItem(json,
	    "revisions")), 2);
	assert_string_equal(text_of(json, "next"), "4");
	cJSON_Delete(json);
	json = get_json(p, "/v1/scenes/h/revisions?limit=2&before=4");
	assert_int_equal(cJSON_GetArraySize(cJSON_GetObjectItem(json,
	    "revisions")), 1);
	cJSON_Delete(json);
	assert_int_equal(status_of(p, NULL, "/v1/scenes/none/revisions"),
	    404);
	assert_int_equal(status_of(p, NULL,
	    "/v1/scenes/h/revisions?before=x"), 400);
	assert_int_equal(status_of(p, NULL, "/v1/scenes/h?revision=1"), 400);
	assert_int_equal(status_of(p, NULL, "/v1/scenes/h?revision="
	    "00000000000000000000000000000000"), 404);
	/* A deletion ends them; what follows comes later. */
	assert_int_equal(status_of(p, "DELETE", "/v1/scenes/h"), 204);
	assert_int_equal(status_of(p, NULL, path), 404);
	assert_int_equal(daemon_stop(&p->d, SIGTERM), 0);
	start(p, NULL, NULL);
	put(p, "/v1/scenes/h", sphere(1, text), &reply);
	assert_int_equal(reply.status, 201);
	assert_non_null(strstr(reply.body, "\"sequence\":\"7\""));
	http_reply_fini(&reply);
	daemon_stop(&p->d, SIGKILL);
}

/* Every revision that is listed can be read, as it was; and of all that were
 * made, no other. Returns how many. */
static int assert_listed_are_readable(const struct place *p, int made)
{
	char text[DOCUMENT_MAX], path[128];
	cJSON *json = get_json(p, "/v1/scenes/h/revisions");
	cJSON *list = cJSON_GetObjectItem(json, "revisions");
	int count = cJSON_GetArraySize(list), place = 0;
	const cJSON *item;

	cJSON_ArrayForEach(item, list) {
		struct http_reply reply;

		snprintf(path, sizeof path, "/v1/scenes/h?revision=%s",
		    text_of(item, "revision"));
		http_get(p->d.url, path, &reply);
		assert_int_equal(reply.status, 200);
		assert_string_equal(reply.body, sphere(made - place++, text));
		http_reply_fini(&reply);
	}
	cJSON_Delete(json);
	return count;
}

static void test_history_bytes_bound_what_is_listed_and_read(void **state)
{
	struct place *p = *state;
	char text[DOCUMENT_MAX], path[128], bound[32];
	/* all are as long, to 9 */
	size_t length = strlen(sphere(1, text));
	struct http_reply reply;
	cJSON *json;

	snprintf(bound, sizeof bound, "%zu", 3 * length);
	start(p, "--history-bytes", bound);
	put(p, "/v1/scenes/h", sphere(1, text), &reply);
	json = cJSON_Parse(reply.body);
	snprintf(path, sizeof path, "/v1/scenes/h?revision=%s",
	    text_of(json, "revision"));
	cJSON_Delete(json);
	http_reply_fini(&reply);
	for (int i = 2; i <= 4; i++)
		put(p, "/v1/scenes/h", sphere(i, text), NULL);
	/* exactly what may be, and the present one */
	assert_int_equal(assert_listed_are_readable(p, 4), 4);
	put(p, "/v1/scenes/h", sphere(5, text), NULL);
	assert_int_equal(assert_listed_are_readable(p, 5), 4);
	http_get(p->d.url, path, &reply);
	assert_int_equal(reply.status, 404);
	assert_non_null(strstr(reply.body, "not kept (any more)"));
	http_reply_fini(&reply);
	json = get_json(p, "/v1/info");
	assert_int_equal(cJSON_GetObjectItem(cJSON_GetObjectItem(json,
	    "store"), "history_bytes")->valueint, 3 * length);
	cJSON_Delete(json);
	http_get(p->d.url, "/metrics", &reply);
	snprintf(path, sizeof path, "\nblobfield_scene_history_bytes %zu\n",
	    3 * length);
	assert_non_null(strstr(reply.body, path));
	http_reply_fini(&reply);
	assert_int_equal(daemon_stop(&p->d, SIGTERM), 0);
	/* One byte less: from the start on. */
	snprintf(bound, sizeof bound, "%zu", 3 * length - 1);
	start(p, "--history-bytes", bound);
	assert_int_equal(assert_listed_are_readable(p, 5), 3);
	assert_int_equal(daemon_stop(&p->d, SIGTERM), 0);
	start(p, NULL, NULL);
	assert_int_equal(assert_listed_are_readable(p, 5), 3);
	daemon_stop(&p->d, SIGKILL);
	start(p, "--history-bytes", "1");
	assert_int_equal(assert_listed_are_readable(p, 5), 1);
	daemon_stop(&p->d, SIGKILL);
}

/* ---- kill -9 ---- */

struct writer {
	pthread_t thread;
	const struct place *p;
	int number;
	int acknowledged, deleted_at; /* the last radius; -1: none */
};

/* Until the daemon has gone: every fifth change is a deletion. */
static void *write_on(void *arg)
{
	struct writer *w = arg;
	char path[64], text[DOCUMENT_MAX];

	snprintf(path, sizeof path, "/v1/scenes/w%d", w->number);
	for (int i = 1;; i++) {
		long status = i % 5 == 0 ? status_of(w->p, "DELETE", path) :
		    put(w->p, path, sphere(i, text), NULL);

		if (status == 0)
			return NULL;
		assert_true(status >= 200 && status < 300);
		w->acknowledged = i;
	}
}

/* The radius that is there; 0: none. */
static int radius_at(const struct place *p, int number)
{
	struct http_reply reply;
	char path[64];
	int radius = 0;

	snprintf(path, sizeof path, "/v1/scenes/w%d", number);
	http_get(p->d.url, path, &reply);
	if (reply.status == 200)
		radius = atoi(strstr(reply.body, "\"name\":\"") + 8);
	http_reply_fini(&reply);
	return radius;
}

static void test_killed_daemon_has_what_it_acknowledged(void **state)
{
	struct writer writers[THREADS];
	struct place *p = *state;
	int changes = 0;

	start(p, NULL, NULL);
	for (int i = 0; i < THREADS; i++) {
		writers[i] = (struct writer){.p = p, .number = i};
		pthread_create(&writers[i].thread, NULL, write_on,
		    writers + i);
	}
	usleep(700000);
	assert_int_equal(daemon_stop(&p->d, SIGKILL), -1);
	for (int i = 0; i < THREADS; i++)
		pthread_join(writers[i].thread, NULL);
	start(p, NULL, NULL);
	for (int i = 0; i < THREADS; i++) {
		int last = writers[i].acknowledged, there = radius_at(p, i);
		int next = last + 1;

		changes += last;
		/* the one in flight may be there, too */
		assert_true(there == (last % 5 == 0 ? 0 : last) ||
		    there == (next % 5 == 0 ? 0 : next));
	}
	print_message("measured: %d changes before the kill\n", changes);
	/* A proxy may take all of that time. */
	assert_true(getenv("BLOBFIELD_PROXY") != NULL || changes > THREADS);
	daemon_stop(&p->d, SIGKILL);
}

/* ---- what cannot be used ---- */

/* Status 2: it would not start another time either. */
static void assert_refuses(const struct place *p, int status,
    const char *words)
{
	const char *const arguments[] = {"--data", p->folder, "--listen",
	    "127.0.0.1:0", "--cache", cache, NULL};
	char output[8192];

	assert_int_equal(daemon_run(arguments, output, sizeof output),
	    status);
	if (strstr(output, words) == NULL || strstr(output, p->folder) == NULL)
		print_error("%s\n", output);
	assert_non_null(strstr(output, words));
	assert_non_null(strstr(output, p->folder));
}

static void test_second_daemon_refuses_the_folder(void **state)
{
	struct place *p = *state;

	start(p, NULL, NULL);
	assert_refuses(p, 1, "another daemon");
	assert_int_equal(status_of(p, NULL, "/v1/scenes"), 200);
	daemon_stop(&p->d, SIGKILL);
}

static void test_damaged_file_is_refused_with_what_to_do(void **state)
{
	static const char garbage[4096] = "garbage";
	struct place *p = *state;
	char path[PATH_MAX + 32];
	int fd;

	start(p, NULL, NULL);
	/* by SIGTERM: no log is left that would mend it */
	assert_int_equal(daemon_stop(&p->d, SIGTERM), 0);
	snprintf(path, sizeof path, "%s/scenes.sqlite", p->folder);
	fd = open(path, O_WRONLY);
	assert_int_equal(write(fd, garbage, sizeof garbage), sizeof garbage);
	close(fd);
	assert_refuses(p, 2, ".recover");
	unlink(path);
	assert_refuses(p, 2, "missing");
}

static void test_scene_beyond_lowered_limits_is_not_lost(void **state)
{
	static const char ask[] = "{\"points\":[[0,0,0]]}";
	struct place *p = *state;
	char text[DOCUMENT_MAX];
	struct http_reply reply;

	start(p, NULL, NULL);
	assert_int_equal(put(p, "/v1/scenes/big", two_nodes, NULL), 201);
	assert_int_equal(put(p, "/v1/scenes/big2", two_nodes, NULL), 201);
	put(p, "/v1/scenes/small", sphere(1, text), NULL);
	daemon_stop(&p->d, SIGKILL);
	start(p, "--max-nodes", "1");
	http_get(p->d.url, "/v1/scenes/big", &reply);
	assert_int_equal(reply.status, 200);
	assert_string_equal(reply.body, two_nodes);
	http_reply_fini(&reply);
	http_json(p->d.url, NULL, "/v1/scenes/big/eval", ask, &reply);
	assert_int_equal(reply.status, 422);
	assert_non_null(strstr(reply.body, "is kept, but cannot be used"));
	http_reply_fini(&reply);
	assert_int_equal(status_of(p, NULL, "/v1/scenes/big/revisions"), 200);
	http_get(p->d.url, "/v1/scenes", &reply);
	assert_non_null(strstr(reply.body, "\"id\":\"big\""));
	http_reply_fini(&reply);
	assert_int_equal(put(p, "/v1/scenes/big", sphere(1, text), NULL),
	    200);
	daemon_await_ready(&p->d);
	http_json(p->d.url, NULL, "/v1/scenes/big/eval", ask, &reply);
	assert_int_equal(reply.status, 200);
	http_reply_fini(&reply);
	assert_int_equal(status_of(p, "DELETE", "/v1/scenes/big2"), 204);
	daemon_stop(&p->d, SIGKILL);
}

static void limit_files(const struct place *p, rlim_t most)
{
	const struct rlimit limit = {most, RLIM_INFINITY};

	assert_int_equal(prlimit(p->d.pid, RLIMIT_FSIZE, &limit, NULL), 0);
}

static void test_full_disk_changes_nothing_and_passes(void **state)
{
	struct place *p = *state;
	char text[DOCUMENT_MAX], retry[16], path[32];
	struct http_reply reply;
	long status = 0;

	signal(SIGXFSZ, SIG_IGN); /* the daemon has that from here */
	start(p, NULL, NULL);
	daemon_await_ready(&p->d); /* compilers write files, too */
	assert_int_equal(put(p, "/v1/scenes/a", sphere(1, text), NULL), 201);
	limit_files(p, 1);
	assert_int_equal(put(p, "/v1/scenes/a", sphere(2, text), &reply),
	    503);
	assert_non_null(strstr(reply.body, "store-unavailable"));
	http_header(&reply, "Retry-After", retry, sizeof retry);
	assert_true(atoi(retry) > 0);
	http_reply_fini(&reply);
	assert_int_equal(status_of(p, "DELETE", "/v1/scenes/a"), 503);
	http_get(p->d.url, "/v1/scenes/a", &reply);
	assert_string_equal(reply.body, sphere(1, text));
	http_reply_fini(&reply);
	limit_files(p, RLIM_INFINITY);
	for (int i = 0; i < 300 && status != 201; i++) {
		snprintf(path, sizeof path, "/v1/scenes/n%d", i);
		status = put(p, path, sphere(3, text), NULL);
		usleep(100000);
	}
	assert_int_equal(status, 201);
	assert_int_equal(daemon_stop(&p->d, SIGKILL), -1);
	start(p, NULL, NULL);
	http_get(p->d.url, "/v1/scenes/a", &reply);
	assert_string_equal(reply.body, sphere(1, text));
	http_reply_fini(&reply);
	daemon_stop(&p->d, SIGKILL);
}

/* ---- volumes ---- */

static double evaluate(const struct place *p, const char *path)
{
	struct http_reply reply;
	double value = -1.0;
	cJSON *json;

	http_json(p->d.url, NULL, path, "{\"points\":[[0.1,0.2,0.3]],"
	    "\"outputs\":[\"value\"]}", &reply);
	json = cJSON_Parse(reply.body);
	if (reply.status == 200)
		value = cJSON_GetNumberValue(cJSON_GetArrayItem(
		    cJSON_GetObjectItem(json, "value"), 0));
	cJSON_Delete(json);
	http_reply_fini(&reply);
	return value;
}

#define N 65

/* Within a second the daemon forgets volumes that nothing uses. */
#define LOOK_US 1500000

static float *make_samples(void)
{
	size_t total = (size_t)N * N * N;
	float *samples = malloc(total * sizeof *samples);

	assert_non_null(samples);
	for (size_t i = 0; i < total; i++)
		samples[i] = (float)(i % 1000) * 1e-3f;
	return samples;
}

/* What evaluate is to give. */
static double expected(void)
{
	static const size_t count[3] = {N, N, N};
	float *samples = make_samples();
	double params[64];
	struct volume *volume;
	struct jet jet;

	assert_int_equal(volume_create(samples, count, vec3(-1.0, -1.0, -1.0),
	    vec3(1.0, 1.0, 1.0), false, &volume), ERR_OK);
	assert_true(volume_prepare(volume, 0.0, params) <= 64);
	volume_eval(volume, params, vec3(0.1, 0.2, 0.3), 0, &jet);
	volume_release(volume);
	free(samples);
	return jet.value;
}

/* Its id to out. */
static void post_volume(const struct place *p, const char *head,
    char out[static 40])
{
	size_t total = (size_t)N * N * N, length;
	float *samples = make_samples();
	struct http_reply reply;
	char shape[64], *file;
	cJSON *json;

	snprintf(shape, sizeof shape, "(%d, %d, %d)", N, N, N);
	file = npy_file("<f4", "False", shape, samples,
	    total * sizeof *samples, &length);
	http_do(p->d.url, &(struct http_request){.method = "POST",
	    .path = head, .body = file, .length = length,
	    .headers = {"Content-Type: application/x-npy"}}, &reply);
	assert_int_equal(reply.status, 201);
	json = cJSON_Parse(reply.body);
	snprintf(out, 40, "%s", text_of(json, "id"));
	cJSON_Delete(json);
	http_reply_fini(&reply);
	free(file);
	free(samples);
}

static void test_volumes_outlive_the_daemon(void **state)
{
	static const char path[] = "/v1/volumes?min=-1,-1,-1&max=1,1,1"
	    "&kind=field";
	struct place *p = *state;
	char id[40], text[DOCUMENT_MAX], one[80];
	int bytes = -1;
	cJSON *json;

	start(p, NULL, NULL);
	post_volume(p, path, id);
	snprintf(text, sizeof text, "{\"format\":\"blobfield/1\",\"root\":"
	    "{\"type\":\"sum\",\"children\":[{\"type\":\"volume\","
	    "\"volume\":\"%s\"}]}}", id);
	assert_int_equal(put(p, "/v1/scenes/v", text, NULL), 201);
	snprintf(one, sizeof one, "/v1/volumes/%s", id);
	daemon_stop(&p->d, SIGKILL);
	start(p, NULL, NULL);
	assert_int_equal(status_of(p, NULL, one), 200);
	assert_int_equal(put(p, "/v1/scenes/w", text, NULL), 201);
	assert_int_equal(status_of(p, "DELETE", "/v1/scenes/w"), 204);
	/* forgotten, it stays for the scene that uses it */
	assert_int_equal(status_of(p, "DELETE", one), 204);
	daemon_stop(&p->d, SIGKILL);
	/* even while that cannot be used */
	start(p, "--max-nodes", "1");
	usleep(LOOK_US);
	daemon_stop(&p->d, SIGKILL);
	start(p, NULL, NULL);
	daemon_await_ready(&p->d);
	assert_int_equal(status_of(p, NULL, one), 404);
	/* the float32 of a value of about 0.5: 3e-8 measured */
	assert_near(evaluate(p, "/v1/scenes/v/eval"), expected(), 1e-6);
	assert_int_equal(put(p, "/v1/scenes/w", text, NULL), 422);
	/* and goes with it */
	assert_int_equal(status_of(p, "DELETE", "/v1/scenes/v"), 204);
	for (int i = 0; i < 10 && bytes != 0; i++) {
		usleep(LOOK_US);
		daemon_stop(&p->d, SIGKILL);
		start(p, NULL, NULL);
		json = get_json(p, "/v1/volumes");
		bytes = cJSON_GetObjectItem(json, "bytes")->valueint;
		cJSON_Delete(json);
	}
	assert_int_equal(bytes, 0);
	daemon_stop(&p->d, SIGKILL);
}

#define CASE(f) cmocka_unit_test_setup_teardown(f, setup, teardown)

int main(void)
{
	const struct CMUnitTest tests[] = {
		CASE(test_history_is_read_over_a_restart),
		CASE(test_history_bytes_bound_what_is_listed_and_read),
		CASE(test_killed_daemon_has_what_it_acknowledged),
		CASE(test_second_daemon_refuses_the_folder),
		CASE(test_damaged_file_is_refused_with_what_to_do),
		CASE(test_scene_beyond_lowered_limits_is_not_lost),
		CASE(test_full_disk_changes_nothing_and_passes),
		CASE(test_volumes_outlive_the_daemon),
	};

	return cmocka_run_group_tests(tests, make_cache, remove_cache);
}
