/*
 * Several clients at once evaluate, replace and delete the same scenes. Every
 * evaluation must be of one revision as a whole: the one its ETag names.
 */
#include <stdarg.h>
#include <stddef.h>
#include <setjmp.h>
#include <stdint.h>
#include <cmocka.h>

#include <math.h>
#include <pthread.h>
#include <stdatomic.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "tests/support/daemon.h"
#include "tests/support/http.h"

#define SCENES 3
#define ROUNDS 60
#define POINTS 5000
#define TAG_MAX 64

/* Two revisions, with different values at the point that all batches repeat. */
static const char *const documents[2] = {
	"{\"format\":\"blobfield/1\",\"root\":{\"type\":\"union\","
	"\"operator\":\"camel\",\"children\":[{\"type\":\"point\",\"center\":"
	"[0,0,0],\"radius\":1},{\"type\":\"point\",\"center\":[0.5,0,0],"
	"\"radius\":1}]}}",
	"{\"format\":\"blobfield/1\",\"root\":{\"type\":\"intersection\","
	"\"operator\":\"contact\",\"children\":[{\"type\":\"point\","
	"\"center\":[0,0,0],\"radius\":1},{\"type\":\"point\",\"center\":"
	"[0.5,0,0],\"radius\":1}]}}",
};

struct client {
	pthread_t thread;
	const struct daemon *daemon;
	unsigned seed;
	const char *failure; /* NULL: all was well */
};

static char tags[2][TAG_MAX];
static float values[2];
static float batch[POINTS][3];
static atomic_uint evaluations;

static void put(const char *url, int scene, int revision,
    struct http_reply *reply)
{
	char path[64];

	snprintf(path, sizeof path, "/v1/scenes/c%d", scene);
	http_json(url, "PUT", path, documents[revision], reply);
}

static void evaluate(const char *url, int scene, struct http_reply *reply)
{
	char path[64];

	snprintf(path, sizeof path, "/v1/scenes/c%d/eval?outputs=value",
	    scene);
	http_do(url, &(struct http_request){
		.path = path,
		.body = batch,
		.length = sizeof batch,
		.headers = {"Content-Type: application/octet-stream",
		    "Accept: application/octet-stream"},
	}, reply);
}

/* Whether a batch's answer is whole, and that of the revision it names. */
static const char *check(const struct http_reply *reply)
{
	char tag[TAG_MAX];
	float value;
	int revision;

	if (reply->status == 404)
		return NULL; /* deleted meanwhile */
	if (reply->status != 200)
		return "an evaluation failed";
	http_header(reply, "ETag", tag, sizeof tag);
	revision = strcmp(tag, tags[1]) == 0;
	if (strcmp(tag, tags[revision]) != 0)
		return "an unknown revision";
	if (reply->length != POINTS * sizeof(float))
		return "an answer of the wrong length";
	for (int i = 0; i < POINTS; i++) {
		memcpy(&value, reply->body + 4 * i, sizeof value);
		if (value != values[revision])
			return "a value of another revision";
	}
	atomic_fetch_add(&evaluations, 1);
	return NULL;
}

static void note_failure(struct client *client, const char *what,
    const struct http_reply *reply)
{
	client->failure = what;
	print_message("%s: %ld %.*s\n", what, reply->status,
	    (int)reply->length, reply->body);
}

static void *work(void *arg)
{
	struct client *client = arg;
	const char *url = client->daemon->url;

	for (int i = 0; i < ROUNDS && client->failure == NULL; i++) {
		unsigned dice = (unsigned)rand_r(&client->seed);
		int scene = (int)(dice % SCENES);
		struct http_reply reply;

		if (dice / SCENES % 8 == 0) {
			char path[64];

			snprintf(path, sizeof path, "/v1/scenes/c%d", scene);
			http_do(url, &(struct http_request){
			    .method = "DELETE", .path = path}, &reply);
			if (reply.status != 204 && reply.status != 404)
				note_failure(client, "DELETE", &reply);
		} else if (dice / SCENES % 8 < 3) {
			put(url, scene, (int)(dice >> 10 & 1), &reply);
			if (reply.status != 200 && reply.status != 201)
				note_failure(client, "PUT", &reply);
		} else {
			evaluate(url, scene, &reply);
			client->failure = check(&reply);
		}
		http_reply_fini(&reply);
	}
	return NULL;
}

/* What each revision gives, with nobody else about. */
static void learn(const char *url)
{
	for (int i = 0; i < 2; i++) {
		struct http_reply reply;

		put(url, 0, i, &reply);
		http_header(&reply, "ETag", tags[i], TAG_MAX);
		http_reply_fini(&reply);
		evaluate(url, 0, &reply);
		assert_int_equal(reply.status, 200);
		memcpy(&values[i], reply.body, sizeof values[i]);
		http_reply_fini(&reply);
	}
	assert_true(fabsf(values[0] - values[1]) > 0.1f);
}

static void test_clients_share_scenes(void **state)
{
	struct client clients[6];

	for (int i = 0; i < POINTS; i++)
		batch[i][0] = 0.2f;
	learn(((const struct daemon *)*state)->url);
	for (int i = 0; i < 6; i++) {
		clients[i] = (struct client){.daemon = *state,
		    .seed = (unsigned)i + 1};
		assert_int_equal(pthread_create(&clients[i].thread, NULL, work,
		    &clients[i]), 0);
	}
	for (int i = 0; i < 6; i++)
		pthread_join(clients[i].thread, NULL);
	for (int i = 0; i < 6; i++) {
		if (clients[i].failure != NULL)
			fail_msg("%s", clients[i].failure);
	}
	assert_true(atomic_load(&evaluations) > 50);
}

static void *evaluate_once(void *arg)
{
	struct client *client = arg;
	struct http_reply reply;
	char body[512];

	/* Each with an operator of its own, that has to be built. */
	snprintf(body, sizeof body, "{\"scene\":{\"format\":\"blobfield/1\","
	    "\"root\":{\"type\":\"union\",\"operator\":{\"profile\":{\"type\":"
	    "\"bulge\",\"k\":0.%u},\"opening\":{\"alpha\":[0,1,2],\"theta\":"
	    "[0,0,0],\"w\":[1,1]}},\"children\":[{\"type\":\"point\","
	    "\"center\":[0,0,0],\"radius\":1},{\"type\":\"point\",\"center\":"
	    "[0.5,0,0],\"radius\":1}]}},\"points\":[[0,0,0]]}",
	    1 + client->seed % 3);
	http_json(client->daemon->url, NULL, "/v1/eval", body, &reply);
	if (reply.status != 200)
		client->failure = "an evaluation failed";
	http_reply_fini(&reply);
	return NULL;
}

static void test_clients_wait_for_the_same_tables(void **state)
{
	struct client clients[9];

	for (int i = 0; i < 9; i++) {
		clients[i] = (struct client){.daemon = *state,
		    .seed = (unsigned)i};
		assert_int_equal(pthread_create(&clients[i].thread, NULL,
		    evaluate_once, &clients[i]), 0);
	}
	for (int i = 0; i < 9; i++) {
		pthread_join(clients[i].thread, NULL);
		assert_null(clients[i].failure);
	}
}

int main(void)
{
	const struct CMUnitTest tests[] = {
		cmocka_unit_test(test_clients_share_scenes),
		cmocka_unit_test(test_clients_wait_for_the_same_tables),
	};

	return cmocka_run_group_tests(tests, daemon_setup, daemon_teardown);
}
