/*
 * Large batches run while small ones keep coming: all are answered, as if they
 * were alone, and small ones pass between the pieces of large ones.
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

#include "tests/support/daemon.h"
#include "tests/support/http.h"
#include "tests/support/random_tree.h"

#define SCENES 2
#define PRIMITIVES 150
#define LARGE 80000
#define SMALL 256
#define LARGE_CLIENTS 3
#define SMALL_CLIENTS 4

/* Small batches are the first SMALL points of the large one. */
static float (*points)[3];
static struct http_reply large_alone[SCENES], small_alone[SCENES];

struct client {
	pthread_t thread;
	const struct daemon *daemon;
	int scene;
	size_t count;
	atomic_int *large_left; /* large batches not answered yet */
	int rounds;
	const char *failure;    /* NULL: all was well */
};

/* Primitives that all overlap: none can be left out anywhere. */
static void put_scene(const char *url, int scene)
{
	struct random_stream r = {(uint64_t)scene + 1};
	size_t size = PRIMITIVES * 100 + 1000, at;
	char *text = malloc(size), path[64];
	struct http_reply reply;

	at = (size_t)snprintf(text, size, "{\"format\":\"blobfield/1\","
	    "\"root\":{\"type\":%s,\"children\":[", scene == 0 ? "\"sum\"" :
	    "\"union\",\"operator\":\"camel\"");
	for (int i = 0; i < PRIMITIVES; i++)
		at += (size_t)snprintf(text + at, size - at, "%s{\"type\":"
		    "\"point\",\"center\":[%.4f,%.4f,%.4f],\"radius\":3}",
		    i > 0 ? "," : "", random_in(&r, -1, 1),
		    random_in(&r, -1, 1), random_in(&r, -1, 1));
	snprintf(text + at, size - at, "]}}");
	snprintf(path, sizeof path, "/v1/scenes/f%d", scene);
	http_json(url, "PUT", path, text, &reply);
	assert_int_equal(reply.status, 201);
	http_reply_fini(&reply);
	free(text);
}

static void evaluate(const char *url, int scene, size_t count,
    struct http_reply *reply)
{
	char path[80];

	snprintf(path, sizeof path,
	    "/v1/scenes/f%d/eval?outputs=value,gradient", scene);
	http_do(url, &(struct http_request){
		.path = path,
		.body = points,
		.length = count * sizeof *points,
		.headers = {"Content-Type: application/octet-stream",
		    "Accept: application/octet-stream"},
	}, reply);
}

/* What each scene gives, with nobody else about. */
static void learn(const char *url)
{
	struct random_stream r = {7};

	points = malloc(LARGE * sizeof *points);
	for (size_t i = 0; i < LARGE; i++) {
		for (int k = 0; k < 3; k++)
			points[i][k] = (float)random_in(&r, -3, 3);
	}
	for (int i = 0; i < SCENES; i++) {
		put_scene(url, i);
		evaluate(url, i, LARGE, &large_alone[i]);
		assert_int_equal(large_alone[i].status, 200);
		assert_int_equal(large_alone[i].length, LARGE * 16);
		evaluate(url, i, SMALL, &small_alone[i]);
		assert_int_equal(small_alone[i].status, 200);
	}
}

static int forget(void **state)
{
	for (int i = 0; i < SCENES; i++) {
		http_reply_fini(&large_alone[i]);
		http_reply_fini(&small_alone[i]);
	}
	free(points);
	return daemon_teardown(state);
}

static const char *ask(const struct client *client)
{
	const struct http_reply *alone = client->count == SMALL ?
	    &small_alone[client->scene] : &large_alone[client->scene];
	const char *failure = NULL;
	struct http_reply reply;

	evaluate(client->daemon->url, client->scene, client->count, &reply);
	if (reply.status != 200)
		failure = "an evaluation failed";
	else if (reply.length != alone->length ||
	    memcmp(reply.body, alone->body, reply.length) != 0)
		failure = "an answer is not what it is alone";
	http_reply_fini(&reply);
	return failure;
}

static void *ask_once(void *arg)
{
	struct client *client = arg;

	client->failure = ask(client);
	atomic_fetch_sub(client->large_left, 1);
	return NULL;
}

/* Whether some large batch has begun, of which small ones are none. */
static bool is_large_running(const char *url)
{
	struct http_reply reply;
	const char *found;
	bool is_running;

	http_get(url, "/v1/info", &reply);
	found = strstr(reply.body, "\"running\":");
	is_running = found != NULL && found[10] > '0';
	http_reply_fini(&reply);
	return is_running;
}

/* Small batches as long as there is a large one. */
static void *ask_often(void *arg)
{
	struct client *client = arg;

	while (client->failure == NULL &&
	    atomic_load(client->large_left) > 0) {
		client->failure = ask(client);
		client->rounds += atomic_load(client->large_left) > 0;
	}
	return NULL;
}

static void start(struct client *client, void *(*work)(void *arg))
{
	assert_int_equal(pthread_create(&client->thread, NULL, work, client),
	    0);
}

static void finish(struct client *client)
{
	pthread_join(client->thread, NULL);
	if (client->failure != NULL)
		fail_msg("%s", client->failure);
}

static void test_small_batches_pass_between_pieces_of_large_ones(
    void **state)
{
	const struct daemon *daemon = *state;
	struct client large[LARGE_CLIENTS], small[SMALL_CLIENTS];
	atomic_int left = LARGE_CLIENTS;
	int rounds = 0;

	learn(daemon->url);
	for (int i = 0; i < LARGE_CLIENTS; i++) {
		large[i] = (struct client){.daemon = daemon,
		    .scene = i % SCENES, .count = LARGE, .large_left = &left};
		start(&large[i], ask_once);
	}
	while (atomic_load(&left) > 0 && !is_large_running(daemon->url))
		;
	for (int i = 0; i < SMALL_CLIENTS; i++) {
		small[i] = (struct client){.daemon = daemon,
		    .scene = i % SCENES, .count = SMALL, .large_left = &left};
		start(&small[i], ask_often);
	}
	for (int i = 0; i < LARGE_CLIENTS; i++)
		finish(&large[i]);
	for (int i = 0; i < SMALL_CLIENTS; i++) {
		finish(&small[i]);
		rounds += small[i].rounds;
	}
	/* Were a large batch one launch, each small client would be answered
	 * after the last of them, or once after each. Measured: 300 to 570. */
	assert_true(rounds > 2 * SMALL_CLIENTS * LARGE_CLIENTS);
}

int main(void)
{
	const struct CMUnitTest tests[] = {
		cmocka_unit_test(
		test_small_batches_pass_between_pieces_of_large_ones),
	};

	return cmocka_run_group_tests(tests, daemon_setup, forget);
}
