/*
 * Work that takes many evaluations: its progress, its end when nobody waits any
 * more, its bounds, and what its endpoints have in common.
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
#include <sys/socket.h>
#include <time.h>
#include <unistd.h>

#include <cjson/cJSON.h>

#include "tests/support/daemon.h"
#include "tests/support/http.h"
#include "tests/support/load.h"

#define COUNT(array) (sizeof(array) / sizeof *(array))

#define POINT "{\"format\":\"blobfield/1\",\"root\":{\"type\":\"point\"," \
	"\"center\":[0,0,0],\"radius\":1}}"

/* Takes about a second a million pixels. */
#define SLOW_PATH "/v1/scenes/slow/slice?outputs=hessian"
#define SLOW_BODY(width, height) "{\"center\":[0.5,0,0],\"extent\":6," \
	"\"width\":" width ",\"height\":" height "}"
#define SLOW SLOW_BODY("4000", "1900")

static const char *const endpoints[] = {"raycast", "project", "render",
    "slice"};
static const char *const bodies[] = {
	"{\"rays\":[[0,0,5,0,0,-1]]}", "{\"points\":[[0,0,1.5]]}",
	"{\"width\":8,\"height\":8,\"samples\":1}",
	"{\"width\":8,\"height\":8}",
};

static void put_slow(const char *url)
{
	char document[16384];
	size_t at = (size_t)sprintf(document, "{\"format\":\"blobfield/1\","
	    "\"root\":{\"type\":\"union\",\"operator\":\"camel\","
	    "\"children\":[");
	struct http_reply reply;

	for (int i = 0; i < 100; i++)
		at += (size_t)sprintf(document + at, "%s{\"type\":\"point\","
		    "\"center\":[%g,0,0],\"radius\":3}", i > 0 ? "," : "",
		    0.01 * i);
	sprintf(document + at, "]}}");
	http_json(url, "PUT", "/v1/scenes/slow", document, &reply);
	assert_true(reply.status == 201 || reply.status == 200);
	http_reply_fini(&reply);
}

static void put_point(const char *url, char tag[static 64])
{
	struct http_reply reply;

	http_json(url, "PUT", "/v1/scenes/point", POINT, &reply);
	assert_true(reply.status == 201 || reply.status == 200);
	http_header(&reply, "ETag", tag, 64);
	http_reply_fini(&reply);
}

static long post(const char *url, const char *path, const char *body,
    const char *accept, struct http_reply *reply)
{
	http_do(url, &(struct http_request){
		.path = path,
		.body = body,
		.length = strlen(body),
		.headers = {"Content-Type: application/json", accept},
	}, reply);
	return reply->status;
}

/* A figure of /v1/info's tasks. */
static double figure(const char *url, const char *name)
{
	struct http_reply reply;
	double value;
	cJSON *json;

	http_get(url, "/v1/info", &reply);
	json = cJSON_Parse(reply.body);
	http_reply_fini(&reply);
	value = cJSON_GetNumberValue(cJSON_GetObjectItem(
	    cJSON_GetObjectItem(json, "tasks"), name));
	cJSON_Delete(json);
	return value;
}

static void await_figure(const char *url, const char *name, double value)
{
	for (int i = 0; i < 3000 && figure(url, name) != value; i++)
		usleep(10000);
	assert_int_equal(figure(url, name), value);
}

/* Sends the slow request and reads nothing. */
static int send_slow(int port, const char *more, const char *body)
{
	char text[1024];
	int fd = http_connect(port);
	int length = snprintf(text, sizeof text, "POST " SLOW_PATH "%s "
	    "HTTP/1.1\r\nHost: localhost\r\nContent-Type: application/json\r\n"
	    "Accept: application/x-npy\r\nContent-Length: %zu\r\n\r\n%s",
	    more, strlen(body), body);

	assert_true(send(fd, text, (size_t)length, MSG_NOSIGNAL) == length);
	return fd;
}

/* Status of GET /v1/progress/token, with what it says. */
static long progress(const char *url, const char *token, char stage[16],
    double *done)
{
	struct http_reply reply;
	char path[128];
	cJSON *json;
	long status;

	snprintf(path, sizeof path, "/v1/progress/%s", token);
	http_get(url, path, &reply);
	status = reply.status;
	json = cJSON_Parse(reply.body);
	http_reply_fini(&reply);
	if (status == 200) {
		snprintf(stage, 16, "%s", cJSON_GetStringValue(
		    cJSON_GetObjectItem(json, "stage")));
		*done = cJSON_GetNumberValue(cJSON_GetObjectItem(json,
		    "done"));
	}
	cJSON_Delete(json);
	return status;
}

static void test_progress_is_seen_and_hanging_up_ends_it(void **state)
{
	const struct daemon *d = *state;
	double abandoned, done = 0.0, before = 0.0;
	struct timespec nap = {0, 10000000};
	char stage[16] = "";
	int fd;

	put_slow(d->url);
	abandoned = figure(d->url, "abandoned");
	assert_int_equal(progress(d->url, "seen", stage, &done), 404);
	fd = send_slow(d->port, "&progress=seen", SLOW);
	for (int i = 0; i < 2000 && done < 0.1; i++) {
		nanosleep(&nap, NULL);
		progress(d->url, "seen", stage, &done);
		assert_true(done >= before && done <= 1.0);
		before = done;
	}
	assert_true(done >= 0.1 && done < 1.0);
	assert_string_equal(stage, "points");
	assert_int_equal(figure(d->url, "running"), 1);
	close(fd);
	await_figure(d->url, "running", 0);
	assert_int_equal(figure(d->url, "abandoned"), abandoned + 1);
	assert_int_equal(progress(d->url, "seen", stage, &done), 404);
}

static void test_deadline_ends_it(void **state)
{
	const struct daemon *d = *state;
	double expired = figure(d->url, "expired");
	struct http_reply reply;
	time_t begin = time(NULL);

	put_slow(d->url);
	assert_int_equal(post(d->url, SLOW_PATH "&deadline=0.3", SLOW,
	    "Accept: application/x-npy", &reply), 504);
	assert_non_null(strstr(reply.body, "/problems/deadline"));
	http_reply_fini(&reply);
	assert_true(load_is_soon((double)(time(NULL) - begin), 1.0));
	assert_int_equal(figure(d->url, "expired"), expired + 1);
}

static void test_wrong_queries_are_named(void **state)
{
	const struct daemon *d = *state;
	char tag[64], path[160];
	struct http_reply reply;

	put_point(d->url, tag);
	for (size_t i = 0; i < COUNT(endpoints); i++) {
		snprintf(path, sizeof path, "/v1/scenes/point/%s?deadline=0&"
		    "progress=a%%20b", endpoints[i]);
		assert_int_equal(post(d->url, path, bodies[i], "Accept: */*",
		    &reply), 422);
		assert_non_null(strstr(reply.body, "\"?deadline\""));
		assert_non_null(strstr(reply.body, "\"?progress\""));
		http_reply_fini(&reply);
	}
}

static void test_two_may_have_one_name(void **state)
{
	const struct daemon *d = *state;
	struct http_reply reply;
	double done = 0.0;
	char stage[16];
	int fd;

	put_slow(d->url);
	fd = send_slow(d->port, "&progress=twin", SLOW);
	await_figure(d->url, "running", 1);
	assert_int_equal(post(d->url, SLOW_PATH "&progress=twin",
	    SLOW_BODY("64", "64"), "Accept: application/x-npy", &reply), 200);
	http_reply_fini(&reply);
	assert_int_equal(progress(d->url, "twin", stage, &done), 200);
	close(fd);
	await_figure(d->url, "running", 0);
}

/* ---- what the endpoints have in common ---- */

static void test_answers_have_etag_and_timing(void **state)
{
	const struct daemon *d = *state;
	char tag[64], path[160], value[160];
	struct http_reply reply;

	put_point(d->url, tag);
	for (size_t i = 0; i < COUNT(endpoints); i++) {
		snprintf(path, sizeof path, "/v1/scenes/point/%s",
		    endpoints[i]);
		assert_int_equal(post(d->url, path, bodies[i], NULL, &reply),
		    200);
		assert_string_equal(http_header(&reply, "ETag", value,
		    sizeof value), tag);
		assert_non_null(strstr(http_header(&reply, "Server-Timing",
		    value, sizeof value), "work;dur="));
		http_reply_fini(&reply);
	}
}

static long ask(const char *url, const char *path, const char *body,
    const char *one, const char *two)
{
	struct http_reply reply;

	http_do(url, &(struct http_request){
		.path = path,
		.body = body,
		.length = strlen(body),
		.headers = {one, two},
	}, &reply);
	http_reply_fini(&reply);
	return reply.status;
}

/* Whether it answers with a file, whatever Accept says. */
static bool is_file(const char *endpoint)
{
	return strcmp(endpoint, "raycast") != 0 &&
	    strcmp(endpoint, "project") != 0;
}

static void test_errors_are_as_elsewhere(void **state)
{
	static const char json[] = "Content-Type: application/json";
	const struct daemon *d = *state;
	char tag[64], path[160], match[128];

	put_point(d->url, tag);
	snprintf(match, sizeof match, "If-Match: %s", tag);
	for (size_t i = 0; i < COUNT(endpoints); i++) {
		snprintf(path, sizeof path, "/v1/scenes/point/%s",
		    endpoints[i]);
		assert_int_equal(ask(d->url, path, bodies[i], json, match),
		    200);
		assert_int_equal(ask(d->url, path, bodies[i], json,
		    "If-Match: \"no\""), 412);
		assert_int_equal(ask(d->url, path, bodies[i], json,
		    "If-Match: no"), 400);
		assert_int_equal(ask(d->url, path, bodies[i], json,
		    "Accept: text/html"), is_file(endpoints[i]) ? 200 : 406);
		assert_int_equal(ask(d->url, path, bodies[i],
		    "Content-Type: text/plain", NULL), 415);
		assert_int_equal(ask(d->url, path, "", json, NULL), 400);
		assert_int_equal(ask(d->url, path, "[1", json, NULL), 400);
		assert_int_equal(ask(d->url, path, "[]", json, NULL), 422);
		assert_int_equal(ask(d->url, path, "{\"a\":1}", json, NULL),
		    422);
		snprintf(path, sizeof path, "/v1/scenes/none/%s",
		    endpoints[i]);
		assert_int_equal(ask(d->url, path, bodies[i], json, NULL),
		    404);
	}
	assert_int_equal(ask(d->url, "/v1/scenes/point/render", "x",
	    "Content-Type: application/octet-stream", NULL), 415);
}

static void test_info_tells_the_limits(void **state)
{
	const struct daemon *d = *state;
	struct http_reply reply;

	http_get(d->url, "/v1/info", &reply);
	assert_non_null(strstr(reply.body, "\"tasks\":2,"));
	assert_non_null(strstr(reply.body, "\"tasks_waiting\":64"));
	assert_non_null(strstr(reply.body, "\"work_time\":300"));
	http_reply_fini(&reply);
}

/* ---- a daemon that does one at a time ---- */

static struct daemon single;

static int start_single(void **state)
{
	static const char *const arguments[] = {"--no-measure", "--tasks", "1",
	    NULL};

	daemon_start(&single, arguments);
	daemon_await_ready(&single);
	put_slow(single.url);
	*state = &single;
	return 0;
}

static void test_a_deadline_passes_while_waiting(void **state)
{
	const struct daemon *d = *state;
	struct http_reply reply;
	double done = 1.0;
	char stage[16] = "";
	int fd, waits;

	fd = send_slow(d->port, "", SLOW);
	await_figure(d->url, "running", 1);
	waits = send_slow(d->port, "&progress=later", SLOW);
	await_figure(d->url, "waiting", 1);
	assert_int_equal(progress(d->url, "later", stage, &done), 200);
	assert_string_equal(stage, "waiting");
	assert_int_equal(done, 0);
	assert_int_equal(post(d->url, SLOW_PATH "&deadline=0.2", SLOW,
	    "Accept: application/x-npy", &reply), 504);
	assert_non_null(strstr(reply.body, "ran for 0.000 s"));
	http_reply_fini(&reply);
	assert_int_equal(figure(d->url, "running"), 1);
	close(waits);
	await_figure(d->url, "waiting", 0);
	close(fd);
	await_figure(d->url, "running", 0);
}

static void test_too_many_are_refused(void **state)
{
	const struct daemon *d = *state;
	const double abandoned = figure(d->url, "abandoned");
	struct http_reply reply;
	int fds[65];

	fds[0] = send_slow(d->port, "", SLOW);
	await_figure(d->url, "running", 1);
	for (int i = 1; i < 65; i++)
		fds[i] = send_slow(d->port, "", SLOW);
	await_figure(d->url, "waiting", 64);
	assert_int_equal(post(d->url, SLOW_PATH, SLOW,
	    "Accept: application/x-npy", &reply), 503);
	assert_non_null(strstr(reply.body, "/problems/queue-full"));
	assert_non_null(strstr(reply.headers, "Retry-After: "));
	http_reply_fini(&reply);
	for (int i = 0; i < 65; i++)
		close(fds[i]);
	await_figure(d->url, "waiting", 0);
	await_figure(d->url, "running", 0);
	assert_int_equal(figure(d->url, "abandoned"), abandoned + 65);
}

/* One thread is for these alone, and they pass those that wait. */
static void test_small_ones_do_not_wait_for_large_ones(void **state)
{
	const struct daemon *d = *state;
	struct http_reply reply;
	char tag[64];
	int fds[2];

	put_point(d->url, tag);
	for (int i = 0; i < 2; i++)
		fds[i] = send_slow(d->port, "", SLOW);
	await_figure(d->url, "waiting", 1);
	assert_int_equal(post(d->url, "/v1/scenes/point/raycast", bodies[0],
	    NULL, &reply), 200);
	http_reply_fini(&reply);
	http_get(d->url, "/v1/scenes/slow/bounds", &reply);
	assert_int_equal(reply.status, 200);
	http_reply_fini(&reply);
	assert_int_equal(figure(d->url, "running"), 1);
	assert_int_equal(figure(d->url, "waiting"), 1);
	for (int i = 0; i < 2; i++)
		close(fds[i]);
	await_figure(d->url, "waiting", 0);
	await_figure(d->url, "running", 0);
}

static void test_answers_that_nobody_reads_are_counted(void **state)
{
	const struct daemon *d = *state;
	int fd;

	await_figure(d->url, "held_bytes", 0);
	fd = send_slow(d->port, "", SLOW_BODY("700", "700"));
	await_figure(d->url, "held_bytes", 700 * 700 * 24);
	assert_int_equal(figure(d->url, "running"), 0);
	close(fd);
	await_figure(d->url, "held_bytes", 0);
}

/* The status goes to *arg. */
static void *ask_slowly(void *arg)
{
	long *status = arg;
	struct http_reply reply;

	*status = post(single.url, SLOW_PATH, SLOW_BODY("700", "700"),
	    "Accept: application/x-npy", &reply);
	if (*status == 200 && reply.length != 128 + 700 * 700 * 24)
		*status = 0;
	http_reply_fini(&reply);
	return NULL;
}

/* The one that runs and the one that waits. */
static void test_sigterm_finishes_all(void **state)
{
	const struct daemon *d = *state;
	pthread_t threads[2];
	long status[2];

	for (int i = 0; i < 2; i++)
		assert_int_equal(pthread_create(&threads[i], NULL, ask_slowly,
		    &status[i]), 0);
	await_figure(d->url, "waiting", 1);
	assert_int_equal(daemon_stop(&single, SIGTERM), 0);
	for (int i = 0; i < 2; i++) {
		pthread_join(threads[i], NULL);
		assert_int_equal(status[i], 200);
	}
}

static void test_the_flag_is_checked(void **state)
{
	static const char *const wrong[] = {"--tasks", "0", NULL};
	static const char *const many[] = {"--tasks", "65", NULL};
	char output[4096];

	(void)state;
	assert_int_equal(daemon_run(wrong, output, sizeof output), 2);
	assert_non_null(strstr(output, "from 1 to 64"));
	assert_int_equal(daemon_run(many, output, sizeof output), 2);
}

int main(void)
{
	const struct CMUnitTest tests[] = {
		cmocka_unit_test(test_progress_is_seen_and_hanging_up_ends_it),
		cmocka_unit_test(test_deadline_ends_it),
		cmocka_unit_test(test_wrong_queries_are_named),
		cmocka_unit_test(test_two_may_have_one_name),
		cmocka_unit_test(test_answers_have_etag_and_timing),
		cmocka_unit_test(test_errors_are_as_elsewhere),
		cmocka_unit_test(test_info_tells_the_limits),
	};
	const struct CMUnitTest single_tests[] = {
		cmocka_unit_test(test_a_deadline_passes_while_waiting),
		cmocka_unit_test(test_too_many_are_refused),
		cmocka_unit_test(test_small_ones_do_not_wait_for_large_ones),
		cmocka_unit_test(test_answers_that_nobody_reads_are_counted),
		cmocka_unit_test(test_sigterm_finishes_all),
		cmocka_unit_test(test_the_flag_is_checked),
	};
	int failed = cmocka_run_group_tests(tests, daemon_setup,
	    daemon_teardown);

	return failed + cmocka_run_group_tests(single_tests, start_single,
	    NULL);
}
