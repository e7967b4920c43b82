/*
 * Orders of operator tables: POST /v1/operators.
 */
#include <stdarg.h>
#include <stddef.h>
#include <setjmp.h>
#include <stdint.h>
#include <cmocka.h>

#include <math.h>
#include <poll.h>
#include <pthread.h>
#include <signal.h>
#include <stdatomic.h>
#include <stdbool.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/socket.h>
#include <unistd.h>

#include <cjson/cJSON.h>

#include "core/table.h"
#include "tests/support/daemon.h"
#include "tests/support/http.h"
#include "tests/support/near.h"
#include "tests/support/sanitized.h"

/* Reported figures have four digits. */
#define DIGITS 1e-3

static const char scene_format[] = "{\"format\":\"blobfield/1\",\"root\":"
    "{\"type\":\"union\",\"operator\":%s,\"children\":["
    "{\"type\":\"point\",\"center\":[0,0,0],\"radius\":1},"
    "{\"type\":\"point\",\"center\":[0.9,0,0],\"radius\":1}]}}";

/* The JSON that an order is answered with, which must have that status. */
static cJSON *order(const char *url, const char *body, long status)
{
	struct http_reply reply;
	cJSON *json;

	http_json(url, NULL, "/v1/operators", body, &reply);
	if (reply.status != status)
		print_error("%s: %s\n", body, reply.body);
	assert_int_equal(reply.status, status);
	json = cJSON_Parse(reply.body);
	assert_non_null(json);
	http_reply_fini(&reply);
	return json;
}

static double number(const cJSON *json, const char *name)
{
	return cJSON_GetNumberValue(cJSON_GetObjectItem(json, name));
}

static const char *string(const cJSON *json, const char *name)
{
	return cJSON_GetStringValue(cJSON_GetObjectItem(json, name));
}

static cJSON *get(const char *url, const char *path)
{
	struct http_reply reply;
	cJSON *json;

	http_get(url, path, &reply);
	assert_int_equal(reply.status, 200);
	json = cJSON_Parse(reply.body);
	http_reply_fini(&reply);
	return json;
}

/* The table of a union, profile and resolution in json's list, or NULL. */
static cJSON *find_table(const cJSON *json, const cJSON *profile,
    int resolution)
{
	cJSON *table;

	cJSON_ArrayForEach(table, cJSON_GetObjectItem(json, "tables")) {
		if (cJSON_Compare(cJSON_GetObjectItem(table, "profile"),
		    profile, true) && number(table, "resolution") ==
		    resolution && strcmp(string(table, "family"), "union") == 0)
			return table;
	}
	return NULL;
}

/* Waits until that table is resident; fails after 10 s. */
static void await_resident(const char *url, const cJSON *profile,
    int resolution)
{
	for (int i = 0; i < 3000; i++) {
		cJSON *json = get(url, "/v1/operators");
		const cJSON *table = find_table(json, profile, resolution);
		bool there = table != NULL &&
		    strcmp(string(table, "state"), "resident") == 0;

		cJSON_Delete(json);
		if (there)
			return;
		usleep(10000);
	}
	fail_msg("the table does not get to be resident");
}

static void evaluate(const char *url, const char *operator, double *value)
{
	char body[2048], scene[1024];
	struct http_reply reply;
	cJSON *json;

	snprintf(scene, sizeof scene, scene_format, operator);
	snprintf(body, sizeof body, "{\"scene\":%s,\"points\":[[0.4,0.3,0]],"
	    "\"outputs\":[\"value\"]}", scene);
	http_json(url, NULL, "/v1/eval", body, &reply);
	assert_int_equal(reply.status, 200);
	json = cJSON_Parse(reply.body);
	*value = cJSON_GetNumberValue(cJSON_GetArrayItem(cJSON_GetObjectItem(
	    json, "value"), 0));
	cJSON_Delete(json);
	http_reply_fini(&reply);
}

static void test_an_order_makes_the_table_that_documents_name(void **state)
{
	const struct daemon *d = *state;
	cJSON *json = order(d->url, "{\"profile\":{\"type\":\"bulge\","
	    "\"k\":0.3},\"resolution\":24}", 200);
	const cJSON *measured = cJSON_GetObjectItem(json, "measured");
	const cJSON *profile = cJSON_GetObjectItem(json, "profile");
	char *operator = cJSON_PrintUnformatted(cJSON_GetObjectItem(json,
	    "operator"));
	cJSON *before, *after;
	double value;

	assert_string_equal(string(json, "family"), "union");
	assert_string_equal(string(json, "layout"), "warped");
	assert_near(number(json, "resolution"), 24, 0.0);
	assert_near(number(json, "bytes"), 24 * 24 * 24 * 48 + 16416, 0.0);
	assert_true(number(json, "build_ms") > 0.0);
	assert_near(number(measured, "count"), TABLE_SAMPLE, 0.0);
	/* Measured 3.7e-5 and 2.1e-7. */
	assert_near(number(measured, "max"), 3.7e-5, 1e-5);
	assert_near(number(measured, "mean"), 2.1e-7, 1e-7);
	assert_string_equal(operator, "{\"profile\":{\"type\":\"bulge\","
	    "\"k\":0.3},\"layout\":\"warped\",\"resolution\":24}");
	await_resident(d->url, profile, 24);
	before = get(d->url, "/v1/operators");
	evaluate(d->url, operator, &value);
	assert_true(value > 0.5);
	after = get(d->url, "/v1/operators");
	assert_true(cJSON_Compare(before, after, true));
	cJSON_Delete(before);
	cJSON_Delete(after);
	cJSON_free(operator);
	cJSON_Delete(json);
}

/* max and mean of a table made here, given the sample's exact values. */
static void measure(int resolution, const double *exact, double *max,
    double *mean)
{
	const struct profile profile = profile_bulge(0.8);
	struct table *table;

	assert_int_equal(table_create(FAMILY_UNION, &profile, LAYOUT_WARPED,
	    resolution, &table), ERR_OK);
	table_build(table, 0, resolution);
	*mean = 0.0;
	*max = table_measure_g(table, 0, TABLE_SAMPLE, exact, mean);
	*mean /= TABLE_SAMPLE;
	table_free(table);
}

static void test_the_coarsest_table_that_holds_an_error_is_found(void **state)
{
	const struct daemon *d = *state;
	cJSON *json = order(d->url, "{\"profile\":\"bulge\","
	    "\"max_error\":5e-4}", 200);
	const cJSON *measured = cJSON_GetObjectItem(json, "measured");
	const struct profile profile = profile_bulge(0.8);
	double *exact = malloc(sizeof *exact * TABLE_SAMPLE), max, mean;
	int resolution = (int)number(json, "resolution");

	assert_non_null(exact);
	table_sample(FAMILY_UNION, &profile, 0, TABLE_SAMPLE, exact);
	assert_true(resolution > TABLE_RESOLUTION_MIN && resolution < 24);
	measure(resolution, exact, &max, &mean);
	assert_true(max <= 5e-4);
	assert_near(number(measured, "max"), max, DIGITS * max);
	assert_near(number(measured, "mean"), mean, DIGITS * mean);
	measure(resolution - 1, exact, &max, &mean);
	assert_true(max > 5e-4);
	free(exact);
	cJSON_Delete(json);
}

static void test_a_loose_error_gives_the_least_table(void **state)
{
	const struct daemon *d = *state;
	cJSON *json = order(d->url, "{\"profile\":\"bulge\",\"max_error\":1,"
	    "\"layout\":\"uniform\"}", 200);

	assert_near(number(json, "resolution"), TABLE_RESOLUTION_MIN, 0.0);
	assert_string_equal(string(cJSON_GetObjectItem(json, "operator"),
	    "layout"), "uniform");
	cJSON_Delete(json);
}

static void test_wrong_orders_are_refused(void **state)
{
	static const struct {
		const char *body, *pointer;
		long status;
	} cases[] = {
		{"{\"max_error\":-1}", "/max_error", 422},
		{"{\"max_error\":1e-3,\"resolution\":64}", "/max_error", 422},
		{"{\"maxerror\":1e-3}", "/maxerror", 422},
		{"{\"family\":\"sum\"}", "/family", 422},
		{"[]", "", 422},
		{"{", "", 400},
	};
	const struct daemon *d = *state;
	struct http_reply reply;
	char allow[64];

	for (size_t i = 0; i < sizeof cases / sizeof *cases; i++) {
		cJSON *json = order(d->url, cases[i].body, cases[i].status);

		assert_string_equal(string(cJSON_GetArrayItem(
		    cJSON_GetObjectItem(json, "errors"), 0), "pointer"),
		    cases[i].pointer);
		cJSON_Delete(json);
	}
	http_json(d->url, "DELETE", "/v1/operators", "{}", &reply);
	assert_int_equal(reply.status, 405);
	assert_string_equal(http_header(&reply, "Allow", allow, sizeof allow),
	    "GET, HEAD, POST, OPTIONS");
	http_reply_fini(&reply);
}

/* ---- in little memory ---- */

static void check_impossible(const char *url)
{
	/* 82^3 * 48 bytes are the most that 26 MiB hold. Measured: 8.0e-4. */
	cJSON *json = order(url, "{\"profile\":{\"type\":\"bulge\",\"k\":1},"
	    "\"max_error\":1e-5}", 422);
	const cJSON *best = cJSON_GetObjectItem(json, "best");

	assert_string_equal(string(json, "type"), "/problems/limit");
	assert_non_null(strstr(string(json, "detail"), "82 nodes"));
	assert_near(number(best, "resolution"), 82, 0.0);
	assert_true(number(best, "max_error") > 1e-5 &&
	    number(best, "max_error") < 3e-3);
	assert_true(number(best, "mean_error") < number(best, "max_error"));
	cJSON_Delete(json);
	json = order(url, "{\"resolution\":83}", 422);
	assert_string_equal(string(cJSON_GetArrayItem(cJSON_GetObjectItem(
	    json, "errors"), 0), "pointer"), "/resolution");
	cJSON_Delete(json);
}

/* Evaluates a scene that is kept, all the while. */
struct client {
	pthread_t thread;
	const char *url;
	atomic_bool stop;
	int wrong, count;
};

static void *evaluate_scene(void *arg)
{
	static const char points[] = "{\"points\":[[0.4,0.3,0],[0.2,0.9,0]]}";
	struct client *client = arg;
	char first[256] = "";

	while (!atomic_load(&client->stop)) {
		struct http_reply reply;

		http_json(client->url, NULL, "/v1/scenes/kept/eval", points,
		    &reply);
		if (first[0] == '\0')
			snprintf(first, sizeof first, "%s", reply.body);
		client->wrong += reply.status != 200 ||
		    strcmp(first, reply.body) != 0;
		client->count++;
		http_reply_fini(&reply);
		usleep(2000);
	}
	return NULL;
}

/* The table of the scene kept: that of bulge 0.8. */
static cJSON *kept_table(const char *url)
{
	cJSON *json = get(url, "/v1/operators");
	cJSON *profile = cJSON_Parse("{\"type\":\"bulge\",\"k\":0.8}");
	cJSON *table = cJSON_Duplicate(find_table(json, profile, 64), true);

	assert_non_null(table);
	cJSON_Delete(profile);
	cJSON_Delete(json);
	return table;
}

static void order_many(const char *url)
{
	int count = SANITIZED ? 5 : 8;

	for (int i = 0; i < count; i++) {
		char body[128];
		cJSON *json, *info;
		const cJSON *tables;

		snprintf(body, sizeof body, "{\"profile\":\"smooth\","
		    "\"resolution\":%d}", 40 + i % 6);
		json = order(url, body, 200);
		await_resident(url, cJSON_GetObjectItem(json, "profile"),
		    40 + i % 6);
		cJSON_Delete(json);
		info = get(url, "/v1/info");
		tables = cJSON_GetObjectItem(info, "tables");
		assert_true(number(tables, "bytes") <=
		    number(tables, "max_bytes"));
		cJSON_Delete(info);
	}
}

/* Room for two tables of 64 nodes: what is ordered comes and goes, but the
 * table of the scene in use stays. */
static void test_orders_displace_no_table_in_use(void **state)
{
	static const char *const arguments[] = {"--no-measure",
	    "--table-memory", "26M", NULL};
	struct client client = {.url = NULL};
	cJSON *before, *after;
	struct http_reply reply;
	struct daemon d;
	char scene[1024];

	(void)state;
	daemon_start(&d, arguments);
	daemon_await_ready(&d);
	snprintf(scene, sizeof scene, scene_format, "\"contact\"");
	http_json(d.url, "PUT", "/v1/scenes/kept", scene, &reply);
	assert_int_equal(reply.status, 201);
	http_reply_fini(&reply);
	client.url = d.url;
	assert_int_equal(pthread_create(&client.thread, NULL, evaluate_scene,
	    &client), 0);
	/* Once it is resident. */
	for (int i = 0; i < 3000; i++) {
		before = kept_table(d.url);
		if (strcmp(string(before, "state"), "resident") == 0)
			break;
		cJSON_Delete(before);
		usleep(10000);
	}
	order_many(d.url);
	check_impossible(d.url);
	atomic_store(&client.stop, true);
	pthread_join(client.thread, NULL);
	assert_int_equal(client.wrong, 0);
	assert_true(client.count > 10);
	/* Resident, and not built again. */
	after = kept_table(d.url);
	assert_true(cJSON_Compare(before, after, true));
	cJSON_Delete(before);
	cJSON_Delete(after);
	assert_int_equal(daemon_stop(&d, SIGTERM), 0);
}

/* ---- waiting ---- */

/* Sends an order that takes seconds; the connection. */
static int send_order(const struct daemon *d, double k)
{
	char body[256], head[256];
	int fd = http_connect(d->port);

	snprintf(body, sizeof body, "{\"profile\":{\"type\":\"bulge\",\"k\":%g},"
	    "\"layout\":\"uniform\",\"resolution\":128}", k);
	snprintf(head, sizeof head, "POST /v1/operators HTTP/1.1\r\nHost: localhost\r\n"
	    "Content-Type: application/json\r\nContent-Length: %zu\r\n\r\n",
	    strlen(body));
	assert_true(send(fd, head, strlen(head), MSG_NOSIGNAL) > 0);
	assert_true(send(fd, body, strlen(body), MSG_NOSIGNAL) > 0);
	return fd;
}

/* The status that is there to read, or 0. */
static int status_of(int fd)
{
	char text[64] = "";
	struct pollfd poll_fd = {.fd = fd, .events = POLLIN};

	if (poll(&poll_fd, 1, 0) != 1 ||
	    recv(fd, text, sizeof text - 1, MSG_PEEK) <= 12)
		return 0;
	return atoi(text + strlen("HTTP/1.1 "));
}

#define ORDERS 13

/* One is searched for, eight wait: of the others each is refused. */
static void test_orders_beyond_the_queue_are_refused_and_hang_ups_dropped(
    void **state)
{
	const struct daemon *d = *state;
	int fds[ORDERS], refused = 0;
	cJSON *json, *table;

	for (int i = 0; i < ORDERS; i++)
		fds[i] = send_order(d, 0.5 + 0.01 * i);
	for (int tries = 0; tries < 3000 && refused < ORDERS - 9; tries++) {
		refused = 0;
		for (int i = 0; i < ORDERS; i++)
			refused += status_of(fds[i]) == 503;
		usleep(10000);
	}
	/* The searcher may not have taken its first one. */
	assert_true(refused == ORDERS - 9 || refused == ORDERS - 8);
	for (int i = 0; i < ORDERS; i++)
		close(fds[i]);
	/* The next order comes after them, and none of theirs is there: room is
	 * made by looking who is gone. */
	cJSON_Delete(order(d->url, "{\"profile\":\"bulge\",\"resolution\":8}",
	    200));
	json = get(d->url, "/v1/operators");
	cJSON_ArrayForEach(table, cJSON_GetObjectItem(json, "tables"))
		assert_true(number(table, "resolution") < 128);
	cJSON_Delete(json);
}

/* Waits until so many requests are under way besides the one that asks, and
 * their bodies, which came with their heads, have been read. */
static void await_begun(const char *url, int count)
{
	char want[80];
	bool there = false;

	snprintf(want, sizeof want, "blobfield_http_requests_active{"
	    "state=\"arrived\"} %d\n", count + 1);
	for (int i = 0; i < 3000 && !there; i++) {
		struct http_reply reply;

		http_get(url, "/metrics", &reply);
		there = strstr(reply.body, want) != NULL;
		http_reply_fini(&reply);
		usleep(10000);
	}
	assert_true(there);
}

static void test_sigterm_gives_orders_up(void **state)
{
	static const char *const arguments[] = {"--no-measure", NULL};
	struct daemon d;
	int fds[3];

	(void)state;
	daemon_start(&d, arguments);
	daemon_await_ready(&d);
	for (int i = 0; i < 3; i++)
		fds[i] = send_order(&d, 0.5 + 0.1 * i);
	await_begun(d.url, 3);
	assert_int_equal(daemon_stop(&d, SIGTERM), 0);
	for (int i = 0; i < 3; i++) {
		assert_int_equal(status_of(fds[i]), 503);
		close(fds[i]);
	}
}

int main(void)
{
	const struct CMUnitTest tests[] = {
		cmocka_unit_test(
		    test_an_order_makes_the_table_that_documents_name),
		cmocka_unit_test(
		    test_the_coarsest_table_that_holds_an_error_is_found),
		cmocka_unit_test(test_a_loose_error_gives_the_least_table),
		cmocka_unit_test(test_wrong_orders_are_refused),
		cmocka_unit_test(
		    test_orders_beyond_the_queue_are_refused_and_hang_ups_dropped),
		cmocka_unit_test(test_orders_displace_no_table_in_use),
		cmocka_unit_test(test_sigterm_gives_orders_up),
	};

	return cmocka_run_group_tests(tests, daemon_setup, daemon_teardown);
}
