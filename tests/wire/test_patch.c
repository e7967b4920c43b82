/*
 * PATCH of scenes: both kinds of patch, what is refused and where it says so,
 * conditions, and many clients patching one scene at once.
 */
#include <stdarg.h>
#include <stddef.h>
#include <setjmp.h>
#include <stdint.h>
#include <cmocka.h>

#include <pthread.h>
#include <stdatomic.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <time.h>
#include <unistd.h>

#include <cjson/cJSON.h>

#include "tests/support/daemon.h"
#include "tests/support/http.h"
#include "tests/support/load.h"
#include "tests/support/sanitized.h"

#define TAG_MAX 64
#define WRITERS 16
#define CHILDREN (SANITIZED ? 5 : 25) /* that each writer adds */

#define JSON_PATCH "Content-Type: application/json-patch+json"
#define MERGE_PATCH "Content-Type: application/merge-patch+json"

/* White space and spellings that a patch must leave alone, or do without. */
static const char document[] = "{\"format\":\"blobfield/1\", \"name\":\"u\",\n"
    " \"root\":{\"type\":\"union\",\"children\":[{\"type\":\"point\","
    "\"center\":[0.10,1e0,-0.0],\"radius\":0.30000000000000004},"
    "{\"type\":\"point\",\"center\":[1,0,0],\"radius\":1}]}}\n";

static long patch(const char *url, const char *path, const char *type,
    const char *body, const char *condition, struct http_reply *reply)
{
	http_do(url, &(struct http_request){
		.method = "PATCH",
		.path = path,
		.body = body,
		.length = strlen(body),
		.headers = {type, condition},
	}, reply);
	return reply->status;
}

static void put(const char *url, const char *path, char tag[static TAG_MAX])
{
	struct http_reply reply;

	http_json(url, "PUT", path, document, &reply);
	assert_true(reply.status == 200 || reply.status == 201);
	http_header(&reply, "ETag", tag, TAG_MAX);
	http_reply_fini(&reply);
}

static void assert_text(const char *url, const char *path, const char *text)
{
	struct http_reply reply;

	http_get(url, path, &reply);
	assert_string_equal(reply.body, text);
	http_reply_fini(&reply);
}

static void test_json_patch(void **state)
{
	struct daemon *d = *state;
	struct http_reply reply;
	char tag[TAG_MAX], next[TAG_MAX];

	put(d->url, "/v1/scenes/p", tag);
	assert_int_equal(patch(d->url, "/v1/scenes/p", JSON_PATCH,
	    "[{\"op\":\"test\",\"path\":\"/root/children/1/radius\","
	    "\"value\":1.0},"
	    "{\"op\":\"replace\",\"path\":\"/root/children/1/radius\","
	    "\"value\":1.250}]", NULL, &reply), 200);
	http_header(&reply, "ETag", next, TAG_MAX);
	assert_string_not_equal(tag, next);
	assert_non_null(strstr(reply.body, "\"id\":\"p\""));
	assert_non_null(strstr(reply.body, "\"sequence\":\""));
	http_reply_fini(&reply);
	assert_text(d->url, "/v1/scenes/p", "{\"format\":\"blobfield/1\","
	    "\"name\":\"u\",\"root\":{\"type\":\"union\",\"children\":["
	    "{\"type\":\"point\",\"center\":[0.10,1e0,-0.0],"
	    "\"radius\":0.30000000000000004},{\"type\":\"point\","
	    "\"center\":[1,0,0],\"radius\":1.250}]}}");
}

static void test_merge_patch(void **state)
{
	struct daemon *d = *state;
	struct http_reply reply;
	char tag[TAG_MAX];

	put(d->url, "/v1/scenes/m", tag);
	assert_int_equal(patch(d->url, "/v1/scenes/m",
	    MERGE_PATCH "; charset=utf-8", "{\"name\":null,\"root\":"
	    "{\"children\":[{\"type\":\"sphere\",\"center\":[0,0,0],"
	    "\"radius\":1,\"falloff\":0.5}]}}", NULL, &reply), 200);
	http_reply_fini(&reply);
	assert_text(d->url, "/v1/scenes/m", "{\"format\":\"blobfield/1\","
	    "\"root\":{\"type\":\"union\",\"children\":[{\"type\":\"sphere\","
	    "\"center\":[0,0,0],\"radius\":1,\"falloff\":0.5}]}}");
}

/* The same bytes, revision and sequence. */
static void test_what_changes_nothing(void **state)
{
	struct daemon *d = *state;
	struct http_reply before, after;
	char tag[TAG_MAX], same[TAG_MAX];

	put(d->url, "/v1/scenes/n", tag);
	http_json(d->url, "PUT", "/v1/scenes/n", document, &before);
	assert_int_equal(patch(d->url, "/v1/scenes/n", JSON_PATCH,
	    "[{\"op\":\"replace\",\"path\":\"/name\",\"value\":\"u\"}]", NULL,
	    &after), 200);
	assert_string_equal(http_header(&after, "ETag", same, TAG_MAX), tag);
	assert_string_equal(after.body, before.body);
	http_reply_fini(&before);
	http_reply_fini(&after);
	assert_text(d->url, "/v1/scenes/n", document);
}

/* A refusal and what its body says; nothing has changed. */
static void assert_refused(const struct daemon *d, const char *type,
    const char *body, long status, const char *slug, const char *says)
{
	struct http_reply reply;

	assert_int_equal(patch(d->url, "/v1/scenes/r", type, body, NULL,
	    &reply), status);
	if (!strstr(reply.body, slug) || !strstr(reply.body, says))
		fail_msg("'%s' does not say '%s', '%s'", reply.body, slug,
		    says);
	http_reply_fini(&reply);
	assert_text(d->url, "/v1/scenes/r", document);
}

static void test_refusals(void **state)
{
	struct daemon *d = *state;
	char tag[TAG_MAX];

	put(d->url, "/v1/scenes/r", tag);
	assert_refused(d, JSON_PATCH, "[{\"op\"", 400, "malformed",
	    "line 1, column");
	assert_refused(d, JSON_PATCH, "", 400, "malformed", "text ends");
	assert_refused(d, JSON_PATCH, "{\"name\":\"x\"}", 422, "invalid",
	    "merge-patch");
	assert_refused(d, JSON_PATCH, "[{\"op\":\"test\",\"path\":\"/name\","
	    "\"value\":\"v\"}]", 409, "conflict", "/0/value");
	assert_refused(d, JSON_PATCH, "[{\"op\":\"add\",\"path\":\"/name\","
	    "\"value\":\"v\"},{\"op\":\"remove\",\"path\":\"/root/nodes\"}]",
	    422, "invalid", "/1/path: there is no 'nodes' in '/root'");
	/* wrong only as a document: the place is the document's */
	assert_refused(d, JSON_PATCH, "[{\"op\":\"replace\",\"path\":"
	    "\"/root/children/0/radius\",\"value\":-1}]", 422, "invalid",
	    "The document after the patch: /root/children/0/radius");
	assert_refused(d, MERGE_PATCH, "{\"root\":null}", 422, "invalid",
	    "after the patch");
	assert_refused(d, MERGE_PATCH, "[]", 422, "invalid",
	    "after the patch");
	assert_refused(d, JSON_PATCH, "[{\"op\":\"replace\",\"path\":"
	    "\"/root/children/0/radius\",\"value\":1e400}]", 422, "invalid",
	    "after the patch: /root/children/0/radius");
	assert_refused(d, "Content-Type: application/x-www-form-urlencoded",
	    "{}", 415, "unsupported", "With curl, add -H 'Content-Type: "
	    "application/merge-patch+json'");
	assert_refused(d, "Content-Type: application/json", "[]", 415,
	    "unsupported", "json-patch+json");
	assert_refused(d, JSON_PATCH "; charset=latin1", "[]", 415,
	    "unsupported", "json-patch+json");
	assert_refused(d, "Content-Type:", "[]", 415, "unsupported",
	    "json-patch+json");
}

static void test_accept_patch_is_told(void **state)
{
	struct daemon *d = *state;
	struct http_reply reply;
	char types[128], tag[TAG_MAX];

	put(d->url, "/v1/scenes/a", tag);
	patch(d->url, "/v1/scenes/a", "Content-Type: text/plain", "[]", NULL,
	    &reply);
	assert_string_equal(http_header(&reply, "Accept-Patch", types,
	    sizeof types), "application/json-patch+json, "
	    "application/merge-patch+json");
	http_reply_fini(&reply);
}

static void test_conditions(void **state)
{
	struct daemon *d = *state;
	static const char body[] = "{\"name\":\"changed\"}";
	char tag[TAG_MAX], condition[TAG_MAX + 20];
	struct http_reply reply;

	put(d->url, "/v1/scenes/c", tag);
	snprintf(condition, sizeof condition, "If-Match: %s", tag);
	assert_int_equal(patch(d->url, "/v1/scenes/c", MERGE_PATCH, body,
	    condition, &reply), 200);
	http_reply_fini(&reply);
	assert_int_equal(patch(d->url, "/v1/scenes/c", MERGE_PATCH, body,
	    condition, &reply), 412);
	http_reply_fini(&reply);
	assert_int_equal(patch(d->url, "/v1/scenes/c", MERGE_PATCH, body,
	    "If-None-Match: *", &reply), 412);
	http_reply_fini(&reply);
	assert_int_equal(patch(d->url, "/v1/scenes/c", MERGE_PATCH, body,
	    "If-Match: nonsense", &reply), 400);
	http_reply_fini(&reply);
	assert_int_equal(patch(d->url, "/v1/scenes/nobody", MERGE_PATCH, body,
	    NULL, &reply), 404);
	http_reply_fini(&reply);
}

/* ---- many at once ---- */

struct writer {
	const struct daemon *d;
	const char *path;
	int index;
	bool is_conditional;
	int retries;
	int wrong; /* answers: assertions are for the first thread only */
};

static void add_child(const struct writer *w, int n, const char *condition,
    struct http_reply *reply)
{
	char body[256];

	snprintf(body, sizeof body, "[{\"op\":\"add\",\"path\":"
	    "\"/root/children/-\",\"value\":{\"type\":\"point\",\"id\":"
	    "\"w%d-%d\",\"center\":[%d,%d,0],\"radius\":1}}]", w->index, n,
	    w->index, n);
	patch(w->d->url, w->path, JSON_PATCH, body, condition, reply);
}

/* Until what it was made from is still there. */
static void add_if_same(struct writer *w, int n)
{
	char tag[TAG_MAX], condition[TAG_MAX + 20];
	struct http_reply reply;
	long status;

	do {
		http_get(w->d->url, w->path, &reply);
		http_header(&reply, "ETag", tag, TAG_MAX);
		http_reply_fini(&reply);
		snprintf(condition, sizeof condition, "If-Match: %s", tag);
		add_child(w, n, condition, &reply);
		status = reply.status;
		http_reply_fini(&reply);
		w->retries += status == 412;
	} while (status == 412);
	w->wrong += status != 200;
}

static void *write_children(void *arg)
{
	struct writer *w = arg;
	struct http_reply reply;

	for (int n = 0; n < CHILDREN; n++) {
		if (w->is_conditional) {
			add_if_same(w, n);
			continue;
		}
		add_child(w, n, NULL, &reply);
		if (reply.status != 200)
			print_message("%ld: %s\n", reply.status, reply.body);
		w->wrong += reply.status != 200;
		http_reply_fini(&reply);
	}
	return NULL;
}

/* Every child that was acknowledged is there, once, each writer's in order. */
static void assert_children(const struct daemon *d, const char *path,
    int count)
{
	int next[WRITERS] = {0};
	struct http_reply reply;
	cJSON *json, *children, *child;

	http_get(d->url, path, &reply);
	json = cJSON_Parse(reply.body);
	children = cJSON_GetObjectItem(cJSON_GetObjectItem(json, "root"),
	    "children");
	assert_int_equal(cJSON_GetArraySize(children), 2 + count);
	cJSON_ArrayForEach(child, children) {
		const char *id = cJSON_GetStringValue(cJSON_GetObjectItem(
		    child, "id"));
		int index, n;

		if (id == NULL)
			continue;
		assert_int_equal(sscanf(id, "w%d-%d", &index, &n), 2);
		assert_int_equal(n, next[index]++);
	}
	cJSON_Delete(json);
	http_reply_fini(&reply);
}

static void write_at_once(const struct daemon *d, const char *path,
    bool is_conditional, const char *what)
{
	struct writer writers[WRITERS];
	pthread_t threads[WRITERS];
	char tag[TAG_MAX];
	double begin, seconds;
	int retries = 0, wrong = 0;
	struct timespec t;

	put(d->url, path, tag);
	clock_gettime(CLOCK_MONOTONIC, &t);
	begin = (double)t.tv_sec + 1e-9 * (double)t.tv_nsec;
	for (int i = 0; i < WRITERS; i++) {
		writers[i] = (struct writer){d, path, i, is_conditional, 0, 0};
		pthread_create(&threads[i], NULL, write_children, &writers[i]);
	}
	for (int i = 0; i < WRITERS; i++) {
		pthread_join(threads[i], NULL);
		wrong += writers[i].wrong;
		retries += writers[i].retries;
	}
	clock_gettime(CLOCK_MONOTONIC, &t);
	seconds = (double)t.tv_sec + 1e-9 * (double)t.tv_nsec - begin;
	assert_int_equal(wrong, 0);
	assert_children(d, path, WRITERS * CHILDREN);
	printf("measured: %s: %d patches by %d clients at once in %.2f s, "
	    "%d tried again\n", what, WRITERS * CHILDREN, WRITERS, seconds,
	    retries);
}

static void test_patches_at_once_all_apply(void **state)
{
	write_at_once(*state, "/v1/scenes/many", false, "without If-Match");
}

static void test_patches_at_once_by_compare_and_swap(void **state)
{
	write_at_once(*state, "/v1/scenes/swap", true, "with If-Match");
}

/* ---- large scenes ---- */

#define LARGE_NODES (SANITIZED ? 2000 : 20000)
#define LARGE_WRITERS 6
#define LARGE_PATCHES 3
#define OTHERS_MOST 2000

/* Seconds of a PUT of another scene meanwhile. The worst of them took 6 to 26 ms
 * (two cores, with other work for ten), and 1036 ms when the writer made patches
 * anew, however large. */
#define OTHER_SECONDS 0.15

static atomic_int patching;

static double now_seconds(void)
{
	struct timespec t;

	clock_gettime(CLOCK_MONOTONIC, &t);
	return (double)t.tv_sec + 1e-9 * (double)t.tv_nsec;
}

static void put_large(const char *url)
{
	char *text = malloc(100 + 100 * (size_t)LARGE_NODES), *at = text;
	struct http_reply reply;

	at += sprintf(at, "{\"format\":\"blobfield/1\",\"root\":{\"type\":"
	    "\"sum\",\"children\":[");
	for (int i = 0; i < LARGE_NODES; i++)
		at += sprintf(at, "%s{\"type\":\"point\",\"center\":[%d,0,"
		    "0.123456789],\"radius\":1}", i > 0 ? "," : "", i);
	strcpy(at, "]}}");
	http_json(url, "PUT", "/v1/scenes/large", text, &reply);
	assert_int_equal(reply.status, 201);
	http_reply_fini(&reply);
	free(text);
}

static void *patch_large(void *arg)
{
	struct writer *w = arg;

	for (int n = 0; n < LARGE_PATCHES; n++) {
		struct http_reply reply;
		char body[160];

		snprintf(body, sizeof body, "[{\"op\":\"replace\",\"path\":"
		    "\"/root/children/%d/radius\",\"value\":3}]",
		    w->index * LARGE_PATCHES + n);
		w->retries += patch(w->d->url, w->path, JSON_PATCH, body, NULL,
		    &reply) != 200;
		http_reply_fini(&reply);
	}
	atomic_fetch_sub(&patching, 1);
	return NULL;
}

static void assert_all_large(const char *url)
{
	struct http_reply reply;
	cJSON *json, *child;
	int patched = 0;

	http_get(url, "/v1/scenes/large", &reply);
	json = cJSON_Parse(reply.body);
	cJSON_ArrayForEach(child, cJSON_GetObjectItem(cJSON_GetObjectItem(json,
	    "root"), "children"))
		patched += cJSON_GetNumberValue(cJSON_GetObjectItem(child,
		    "radius")) == 3.0;
	assert_int_equal(patched, LARGE_WRITERS * LARGE_PATCHES);
	cJSON_Delete(json);
	http_reply_fini(&reply);
}

static void test_large_patches_keep_nobody_waiting(void **state)
{
	struct daemon *d = *state;
	struct writer writers[LARGE_WRITERS];
	pthread_t threads[LARGE_WRITERS];
	static double seconds[OTHERS_MOST];
	const struct timespec pause = {0, 5000000};
	char tag[TAG_MAX];
	size_t others;

	put_large(d->url);
	atomic_store(&patching, LARGE_WRITERS);
	for (int i = 0; i < LARGE_WRITERS; i++) {
		writers[i] = (struct writer){d, "/v1/scenes/large", i, false,
		    0, 0};
		pthread_create(&threads[i], NULL, patch_large, &writers[i]);
	}
	for (others = 0; others < OTHERS_MOST &&
	    (others < 10 || atomic_load(&patching) > 0); others++) {
		double begin = now_seconds();
		char path[40];

		snprintf(path, sizeof path, "/v1/scenes/o%zu", others % 100);
		put(d->url, path, tag);
		seconds[others] = now_seconds() - begin;
		nanosleep(&pause, NULL);
	}
	for (int i = 0; i < LARGE_WRITERS; i++) {
		pthread_join(threads[i], NULL);
		assert_int_equal(writers[i].retries, 0);
	}
	assert_all_large(d->url);
	printf("measured: %zu PUTs beside %d clients that patch a scene of %d "
	    "nodes: median %.1f ms, worst %.1f ms\n", others, LARGE_WRITERS,
	    LARGE_NODES, 1e3 * load_quantile(seconds, others, 0.5),
	    1e3 * load_quantile(seconds, others, 1.0));
	assert_true(load_is_soon(load_quantile(seconds, others, 1.0),
	    OTHER_SECONDS * (SANITIZED ? 4 : 1)));
}

/* Clients that hang up before the answer: the daemon minds nothing. */
static void test_clients_that_hang_up(void **state)
{
	struct daemon *d = *state;
	static const char body[] = "[{\"op\":\"add\",\"path\":\"/name\","
	    "\"value\":\"hung up\"}]";
	struct load_request request = load_request_make("PATCH",
	    "/v1/scenes/h", JSON_PATCH "\r\n", body, strlen(body));
	char tag[TAG_MAX];
	struct http_reply reply;

	put(d->url, "/v1/scenes/h", tag);
	for (int i = 0; i < 200; i++) {
		int fd = load_connect(d->port);

		assert_true(fd >= 0);
		assert_int_equal(write(fd, request.bytes, request.length),
		    (ssize_t)request.length);
		close(fd);
	}
	load_request_fini(&request);
	assert_int_equal(patch(d->url, "/v1/scenes/h", MERGE_PATCH,
	    "{\"name\":\"there\"}", NULL, &reply), 200);
	http_reply_fini(&reply);
}

int main(void)
{
	const struct CMUnitTest tests[] = {
		cmocka_unit_test(test_json_patch),
		cmocka_unit_test(test_merge_patch),
		cmocka_unit_test(test_what_changes_nothing),
		cmocka_unit_test(test_refusals),
		cmocka_unit_test(test_accept_patch_is_told),
		cmocka_unit_test(test_conditions),
		cmocka_unit_test(test_patches_at_once_all_apply),
		cmocka_unit_test(test_patches_at_once_by_compare_and_swap),
		cmocka_unit_test(test_large_patches_keep_nobody_waiting),
		cmocka_unit_test(test_clients_that_hang_up),
	};

	return cmocka_run_group_tests(tests, daemon_setup, daemon_teardown);
}
