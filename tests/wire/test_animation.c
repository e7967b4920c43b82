/*
 * What may change from request to request: openings and nodes with no table
 * built, profiles with a draft while theirs is. Each test but the first has a
 * daemon of its own.
 */
#include <stdarg.h>
#include <stddef.h>
#include <setjmp.h>
#include <stdint.h>
#include <cmocka.h>

#include <math.h>
#include <pthread.h>
#include <signal.h>
#include <stdbool.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <time.h>
#include <unistd.h>

#include <cjson/cJSON.h>

#include "core/evaluate.h"
#include "core/tape.h"
#include "proto/document.h"
#include "proto/fault.h"
#include "tests/support/daemon.h"
#include "tests/support/http.h"
#include "tests/support/near.h"
#include "tests/support/sanitized.h"

#define POINT_COUNT 120

/* The stated error in g of drafts of K up to 0.8 (server/tables.h); measured
 * here at most 7.2e-4. Of full tables 1e-4 (core/table.h's sample); measured
 * 4.7e-5. */
#define DRAFT_TOLERANCE 9e-4
#define FULL_TOLERANCE 1e-4

/* A union of segments, some cut away by a sphere: both families of one
 * operator. */
struct move {
	double k, theta, x; /* profile; opening; a node's place */
	int resolution;
	bool draft;
};

static const char scene_format[] = "{\"format\":\"blobfield/1\","
    "\"operators\":{\"joint\":{\"profile\":{\"type\":\"bulge\",\"k\":%.17g},"
    "\"opening\":{\"alpha\":[0,1.5708,3.1416],\"theta\":[0.7854,%.17g,"
    "0.7854]},\"resolution\":%d%s}},\"root\":{\"type\":\"difference\","
    "\"operator\":\"joint\",\"children\":[{\"type\":\"union\",\"operator\":"
    "\"joint\",\"children\":["
    "{\"type\":\"segment\",\"a\":[-1,0,0],\"b\":[0,0,2.6],\"radius\":0.2},"
    "{\"type\":\"segment\",\"a\":[1,0,0],\"b\":[0,0,2.6],\"radius\":0.2}]},"
    "{\"type\":\"sphere\",\"center\":[%.17g,0,1.3],\"radius\":0.3,"
    "\"falloff\":0.4}]}}";

static const char *scene_of(const struct move *move, char *out, size_t size)
{
	snprintf(out, size, scene_format, move->k, move->theta,
	    move->resolution, move->draft ? ",\"draft\":true" : "", move->x);
	return out;
}

static struct vec3 point(int i)
{
	double s = (double)i / (POINT_COUNT - 1);

	return vec3((double)(float)(-0.8 + 1.6 * s),
	    (double)(float)(0.2 * sin(9.0 * s)), (double)(float)(2.6 * s));
}

/* "[[x,y,z],...]" */
static const char *points_text(void)
{
	static char text[100 * POINT_COUNT];
	size_t length = 0;

	for (int i = 0; i < POINT_COUNT; i++) {
		struct vec3 p = point(i);

		length += (size_t)snprintf(text + length, sizeof text - length,
		    "%c[%.9g,%.9g,%.9g]", i > 0 ? ',' : '[', p.x, p.y, p.z);
	}
	strcpy(text + length, "]");
	return text;
}

/* Posts move's scene; its values to out. Returns whether they are a draft's,
 * as header and body say. */
static bool evaluate_move(const char *url, const struct move *move,
    double out[static POINT_COUNT])
{
	static char body[1 << 16];
	char scene[2048], header[16];
	struct http_reply reply;
	const cJSON *values;
	cJSON *json;
	bool draft;

	snprintf(body, sizeof body, "{\"scene\":%s,\"points\":%s}",
	    scene_of(move, scene, sizeof scene), points_text());
	http_json(url, NULL, "/v1/eval", body, &reply);
	if (reply.status != 200)
		print_error("%.300s\n", reply.body);
	assert_int_equal(reply.status, 200);
	json = cJSON_Parse(reply.body);
	values = cJSON_GetObjectItem(json, "value");
	assert_int_equal(cJSON_GetArraySize(values), POINT_COUNT);
	for (int i = 0; i < POINT_COUNT; i++)
		out[i] = cJSON_GetNumberValue(cJSON_GetArrayItem(values, i));
	http_header(&reply, "Blobfield-Draft", header, sizeof header);
	draft = strcmp(header, "true") == 0;
	assert_int_equal(cJSON_IsTrue(cJSON_GetObjectItem(json, "draft")),
	    draft);
	assert_true(draft || header[0] == '\0');
	cJSON_Delete(json);
	http_reply_fini(&reply);
	return draft;
}

/* Largest difference of values from the float64 evaluator. */
static double error_of(const struct move *move,
    const double values[static POINT_COUNT])
{
	const struct document_limits limits = {.max_nodes = 100,
	    .layout = LAYOUT_WARPED};
	struct faults faults = {0};
	struct document *document;
	double most = 0.0;
	char scene[2048];

	scene_of(move, scene, sizeof scene);
	assert_int_equal(document_parse(scene, strlen(scene), &limits,
	    &document, &faults), ERR_OK);
	for (int i = 0; i < POINT_COUNT; i++) {
		struct jet exact;

		evaluate(document_tape(document), point(i), 0, &exact);
		most = fmax(most, fabs(values[i] - exact.value));
	}
	document_free(document);
	return most;
}

static cJSON *get_tables(const char *url)
{
	struct http_reply reply;
	cJSON *json, *tables;

	http_get(url, "/v1/operators", &reply);
	assert_int_equal(reply.status, 200);
	json = cJSON_Parse(reply.body);
	tables = cJSON_DetachItemFromObject(json, "tables");
	http_reply_fini(&reply);
	cJSON_Delete(json);
	assert_non_null(tables);
	return tables;
}

static const char *state_of(const cJSON *table)
{
	return cJSON_GetStringValue(cJSON_GetObjectItem(table, "state"));
}

static double figure(const cJSON *table, const char *name)
{
	return cJSON_GetNumberValue(cJSON_GetObjectItem(table, name));
}

/* How many tables there are of resolution, or of that and K, in one of the
 * states ("": any). */
static int count_tables(const char *url, int resolution, double k,
    const char *states)
{
	cJSON *tables = get_tables(url), *table;
	int count = 0;

	cJSON_ArrayForEach(table, tables) {
		const cJSON *own = cJSON_GetObjectItem(cJSON_GetObjectItem(
		    table, "profile"), "k");

		count += figure(table, "resolution") == resolution &&
		    (states[0] == '\0' || strstr(states, state_of(table))) &&
		    (k < 0.0 || (own != NULL &&
		    cJSON_GetNumberValue(own) == k));
	}
	cJSON_Delete(tables);
	return count;
}

/* ---- openings and nodes ---- */

/* All tables but those that were never built: a document that was answered
 * lets go of its own a little later. */
static cJSON *get_built(const char *url)
{
	cJSON *tables = get_tables(url);

	for (int i = cJSON_GetArraySize(tables) - 1; i >= 0; i--) {
		if (figure(cJSON_GetArrayItem(tables, i), "bytes") == 0.0)
			cJSON_DeleteItemFromArray(tables, i);
	}
	return tables;
}

static void test_openings_and_nodes_move_with_no_table_built(void **state)
{
	const struct daemon *d = *state;
	struct move move = {.k = 0.8, .resolution = 64};
	double values[POINT_COUNT];
	cJSON *before = get_built(d->url);

	for (int i = 0; i < 20; i++) {
		cJSON *after;

		move.theta = 0.035 * i;
		move.x = -0.5 + 0.05 * i;
		move.draft = i % 2 == 0;
		assert_false(evaluate_move(d->url, &move, values));
		assert_true(error_of(&move, values) < FULL_TOLERANCE);
		after = get_built(d->url);
		/* Build times and all. */
		assert_true(cJSON_Compare(before, after, true));
		cJSON_Delete(after);
	}
	cJSON_Delete(before);
}

/* ---- profiles ---- */

static void test_a_moving_profile_is_answered_at_once_by_drafts(void **state)
{
	static const char *const arguments[] = {"--no-measure", NULL};
	const int count = SANITIZED ? 6 : 16;
	struct move move = {.resolution = 128, .draft = true, .theta = 0.1};
	double values[POINT_COUNT];
	struct daemon d;

	(void)state;
	daemon_start(&d, arguments);
	daemon_await_ready(&d);
	for (int i = 0; i < count; i++) {
		double error;

		move.k = 0.3 + 0.03125 * i;
		move.x = 0.02 * i;
		assert_true(evaluate_move(d.url, &move, values));
		error = error_of(&move, values);
		assert_true(error < DRAFT_TOLERANCE);
		/* What would be the answer's tables, of seconds, are not there; but
		 * drafts of both families, and on their way the full tables of
		 * this and the last K, and one that is being given up. */
		assert_int_equal(count_tables(d.url, 128, -1.0, "resident"), 0);
		assert_int_equal(count_tables(d.url, 16, move.k, "resident"),
		    2);
		assert_true(count_tables(d.url, 128, -1.0,
		    "waiting building loading") <= 5);
		assert_int_equal(count_tables(d.url, 128, move.k,
		    "waiting building loading"), 2);
	}
	assert_int_equal(daemon_stop(&d, SIGTERM), 0);
}

/* Repeats move until it is answered without a draft. */
static void await_full(const char *url, const struct move *move,
    double values[static POINT_COUNT])
{
	for (int i = 0; i < 1200; i++) {
		if (!evaluate_move(url, move, values))
			return;
		usleep(50000);
	}
	fail_msg("no full table comes");
}

static void test_a_profile_at_rest_is_answered_in_full(void **state)
{
	static const char *const arguments[] = {"--no-measure", NULL};
	struct move move = {.k = 0.41, .resolution = 64, .draft = true};
	double drafts[POINT_COUNT], full[POINT_COUNT], same[POINT_COUNT];
	struct daemon d;

	(void)state;
	daemon_start(&d, arguments);
	daemon_await_ready(&d);
	assert_true(evaluate_move(d.url, &move, drafts));
	await_full(d.url, &move, full);
	assert_int_equal(count_tables(d.url, 64, move.k, "resident"), 2);
	assert_true(error_of(&move, full) < FULL_TOLERANCE);
	assert_true(memcmp(drafts, full, sizeof full) != 0);
	/* The same to the bit as what never was a draft. */
	move.draft = false;
	assert_false(evaluate_move(d.url, &move, same));
	assert_memory_equal(same, full, sizeof full);
	assert_int_equal(daemon_stop(&d, SIGTERM), 0);
}

/* A kept scene: its program was loaded with drafts, and must not stay so. */
static void test_a_kept_scene_loses_its_drafts(void **state)
{
	static const char *const arguments[] = {"--no-measure", NULL};
	struct move move = {.k = 0.43, .resolution = 48, .draft = true};
	struct http_reply first, reply;
	char scene[2048], body[1 << 14], header[16];
	struct daemon d;
	bool draft = true;

	(void)state;
	daemon_start(&d, arguments);
	daemon_await_ready(&d);
	http_json(d.url, "PUT", "/v1/scenes/a", scene_of(&move, scene,
	    sizeof scene), &reply);
	assert_int_equal(reply.status, 201);
	http_reply_fini(&reply);
	snprintf(body, sizeof body, "{\"points\":%s}", points_text());
	for (int i = 0; i < 1200 && draft; i++) {
		const struct http_request request = {NULL,
		    "/v1/scenes/a/eval?outputs=value", body, strlen(body),
		    {"Content-Type: application/json", i % 2 ?
		    "Accept: application/x-npy" :
		    "Accept: application/octet-stream"}};

		http_do(d.url, &request, i == 0 ? &first : &reply);
		assert_int_equal((i == 0 ? &first : &reply)->status, 200);
		http_header(i == 0 ? &first : &reply, "Blobfield-Draft",
		    header, sizeof header);
		draft = strcmp(header, "true") == 0;
		assert_true(i > 0 || draft);
		if (i > 0 && !draft && i % 2 == 0)
			assert_memory_not_equal(first.body, reply.body,
			    POINT_COUNT * sizeof(float));
		if (i > 0)
			http_reply_fini(&reply);
		usleep(50000);
	}
	assert_false(draft);
	http_reply_fini(&first);
	assert_int_equal(daemon_stop(&d, SIGTERM), 0);
}

static void test_without_draft_the_table_is_waited_for(void **state)
{
	const struct daemon *d = *state;
	struct move move = {.k = 0.47, .resolution = 40};
	double values[POINT_COUNT];

	assert_false(evaluate_move(d->url, &move, values));
	assert_true(error_of(&move, values) < FULL_TOLERANCE);
	assert_int_equal(count_tables(d->url, 40, move.k, "resident"), 2);
	assert_int_equal(count_tables(d->url, 16, move.k, ""), 0);
}

/* A table of no more nodes than a draft is its own. */
static void test_small_tables_have_no_drafts(void **state)
{
	const struct daemon *d = *state;
	struct move move = {.k = 0.49, .resolution = 16, .draft = true};
	double values[POINT_COUNT];

	assert_false(evaluate_move(d->url, &move, values));
	assert_true(error_of(&move, values) < DRAFT_TOLERANCE);
}

/* One that asks for the table that another wishes for has it built anew, at
 * once. */
struct asker {
	pthread_t thread;
	const char *url;
	struct move move;
	double values[POINT_COUNT];
	bool draft;
};

static void *ask(void *arg)
{
	struct asker *asker = arg;
	char body[1 << 14], scene[2048], header[16];
	struct http_reply reply;

	snprintf(body, sizeof body, "{\"scene\":%s,\"points\":[[0,0,1]]}",
	    scene_of(&asker->move, scene, sizeof scene));
	http_json(asker->url, NULL, "/v1/eval", body, &reply);
	http_header(&reply, "Blobfield-Draft", header, sizeof header);
	asker->draft = reply.status != 200 || header[0] != '\0';
	http_reply_fini(&reply);
	return NULL;
}

static void test_who_asks_for_a_wished_table_gets_it(void **state)
{
	const struct daemon *d = *state;
	struct move move = {.k = 0.53, .resolution = SANITIZED ? 40 : 72,
	    .draft = true};
	struct asker asker = {.url = d->url, .move = move};
	double values[POINT_COUNT];

	assert_true(evaluate_move(d->url, &move, values));
	asker.move.draft = false;
	assert_int_equal(pthread_create(&asker.thread, NULL, ask, &asker), 0);
	/* Others move on meanwhile: its table is not dropped with theirs. */
	for (int i = 0; i < 8; i++) {
		move.k = 0.55 + 0.01 * i;
		evaluate_move(d->url, &move, values);
	}
	pthread_join(asker.thread, NULL);
	assert_false(asker.draft);
	assert_int_equal(count_tables(d->url, move.resolution, asker.move.k,
	    "resident"), 2);
}

/* Drafts count as tables, and are the first to go. */
static void test_drafts_go_first_where_room_is_short(void **state)
{
	/* Room for two tables of 64 nodes and some drafts. */
	static const char *const arguments[] = {"--no-measure",
	    "--table-memory", "26M", NULL};
	struct move kept = {.k = 0.8, .resolution = 64};
	struct move move = {.resolution = 64, .draft = true};
	double values[POINT_COUNT];
	struct daemon d;

	(void)state;
	daemon_start(&d, arguments);
	daemon_await_ready(&d);
	assert_false(evaluate_move(d.url, &kept, values));
	for (int i = 0; i < 12; i++) {
		move.k = 0.2 + 0.01 * i;
		evaluate_move(d.url, &move, values);
		assert_true(error_of(&move, values) < DRAFT_TOLERANCE);
	}
	/* 24 drafts for room of 9 have displaced each other, and no full one. */
	assert_int_equal(count_tables(d.url, 64, kept.k, "resident"), 2);
	assert_true(count_tables(d.url, 16, -1.0, "resident") <= 9);
	await_full(d.url, &move, values);
	assert_int_equal(count_tables(d.url, 64, -1.0, "resident"), 2);
	assert_false(evaluate_move(d.url, &kept, values));
	assert_true(error_of(&kept, values) < FULL_TOLERANCE);
	assert_int_equal(daemon_stop(&d, SIGTERM), 0);
}

/* ---- many clients, many operators ---- */

#define CLIENTS 4
#define CLIENT_SECONDS 5.0

static double seconds(void)
{
	struct timespec now;

	clock_gettime(CLOCK_MONOTONIC, &now);
	return (double)now.tv_sec + 1e-9 * (double)now.tv_nsec;
}

/* A request for one point of a sum of count unions, each with its own K, from
 * *k on; malloc'd. */
static char *request_of(int count, int resolution, double *k)
{
	static const char format[] = "%s{\"type\":\"union\",\"operator\":{"
	    "\"profile\":{\"type\":\"bulge\",\"k\":%.17g},\"resolution\":%d,"
	    "\"draft\":true},\"children\":[{\"type\":\"point\",\"center\":"
	    "[0,0,0],\"radius\":1},{\"type\":\"point\",\"center\":[0,0,1],"
	    "\"radius\":1}]}";
	size_t size = 400 * (size_t)count + 200, length;
	char *out = malloc(size);

	assert_non_null(out);
	length = (size_t)snprintf(out, size, "{\"scene\":{\"format\":"
	    "\"blobfield/1\",\"root\":{\"type\":\"sum\",\"children\":[");
	for (int i = 0; i < count; i++) {
		length += (size_t)snprintf(out + length, size - length, format,
		    i > 0 ? "," : "", *k, resolution);
		*k += 1e-5;
	}
	snprintf(out + length, size - length,
	    "]}},\"points\":[[0,0,0.5]]}");
	return out;
}

/* Posts such requests until some time has passed; each wants other tables. */
struct mover {
	pthread_t thread;
	const char *url;
	unsigned seed;
	double k;
	int failures;
};

static void *move_on(void *arg)
{
	struct mover *mover = arg;
	double end = seconds() + CLIENT_SECONDS;

	while (seconds() < end && mover->failures == 0) {
		int count = 1 + rand_r(&mover->seed) % 6;
		struct http_reply reply;
		char *body = request_of(count,
		    17 + rand_r(&mover->seed) % 8, &mover->k);

		http_json(mover->url, NULL, "/v1/eval", body, &reply);
		mover->failures += reply.status != 200;
		http_reply_fini(&reply);
		free(body);
		usleep(rand_r(&mover->seed) % 2 ? 0 : 30000);
	}
	return NULL;
}

/* Wishes are dropped while their tables are uploaded. */
static void test_tables_that_many_clients_drop_are_uploaded_whole(
    void **state)
{
	static const char *const arguments[] = {"--no-measure", NULL};
	struct mover movers[CLIENTS];
	struct daemon d;

	(void)state;
	daemon_start(&d, arguments);
	daemon_await_ready(&d);
	for (int i = 0; i < CLIENTS; i++) {
		movers[i] = (struct mover){.url = d.url,
		    .seed = (unsigned)i + 1, .k = 0.1 + 0.2 * i};
		assert_int_equal(pthread_create(&movers[i].thread, NULL,
		    move_on, &movers[i]), 0);
	}
	for (int i = 0; i < CLIENTS; i++) {
		pthread_join(movers[i].thread, NULL);
		assert_int_equal(movers[i].failures, 0);
	}
	assert_int_equal(daemon_stop(&d, SIGTERM), 0);
}

/* Evaluations of many operators, each with a draft of its own. */
struct crowd {
	pthread_t thread;
	const char *url;
	char *body;
	struct http_reply reply;
};

static void *evaluate_crowd(void *arg)
{
	struct crowd *crowd = arg;

	http_json(crowd->url, NULL, "/v1/eval", crowd->body, &crowd->reply);
	return NULL;
}

static int count_waiting(const char *url)
{
	struct http_reply reply;
	const char *at;
	int count;

	http_get(url, "/v1/info", &reply);
	at = strstr(reply.body, "\"waiting\":");
	assert_non_null(at);
	count = atoi(at + strlen("\"waiting\":"));
	http_reply_fini(&reply);
	return count;
}

static void await_waiting(const char *url, int count)
{
	for (int i = 0; i < 15000 && count_waiting(url) != count; i++)
		usleep(2000);
	assert_int_equal(count_waiting(url), count);
}

/* While those wait, others are answered, and then they are too. */
static void test_many_operators_stall_nobody(void **state)
{
	enum { COUNT = 4, OPERATORS = SANITIZED ? 40 : 100 };
	const struct daemon *d = *state;
	struct crowd crowds[COUNT];
	double k = 0.55;

	for (int i = 0; i < COUNT; i++) {
		crowds[i] = (struct crowd){.url = d->url,
		    .body = request_of(OPERATORS, 17, &k)};
		assert_int_equal(pthread_create(&crowds[i].thread, NULL,
		    evaluate_crowd, &crowds[i]), 0);
	}
	await_waiting(d->url, COUNT);
	for (int i = 0; i < 10; i++) {
		struct move move = {.k = 0.8, .resolution = 64};
		double values[POINT_COUNT];

		assert_false(evaluate_move(d->url, &move, values));
	}
	/* One may have got its hundred drafts. */
	assert_true(count_waiting(d->url) >= COUNT - 1);
	for (int i = 0; i < COUNT; i++) {
		pthread_join(crowds[i].thread, NULL);
		assert_int_equal(crowds[i].reply.status, 200);
		http_reply_fini(&crowds[i].reply);
		free(crowds[i].body);
	}
	/* Few of the full ones are built after all. */
	assert_true(count_tables(d->url, 17, -1.0,
	    "waiting building loading") <= 4 + 32);
}

int main(void)
{
	const struct CMUnitTest tests[] = {
		cmocka_unit_test(
		    test_openings_and_nodes_move_with_no_table_built),
		cmocka_unit_test(
		    test_a_moving_profile_is_answered_at_once_by_drafts),
		cmocka_unit_test(test_a_profile_at_rest_is_answered_in_full),
		cmocka_unit_test(test_a_kept_scene_loses_its_drafts),
		cmocka_unit_test(test_without_draft_the_table_is_waited_for),
		cmocka_unit_test(test_small_tables_have_no_drafts),
		cmocka_unit_test(test_who_asks_for_a_wished_table_gets_it),
		cmocka_unit_test(test_drafts_go_first_where_room_is_short),
		cmocka_unit_test(test_many_operators_stall_nobody),
		cmocka_unit_test(
		    test_tables_that_many_clients_drop_are_uploaded_whole),
	};

	return cmocka_run_group_tests(tests, daemon_setup, daemon_teardown);
}
