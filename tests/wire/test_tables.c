/*
 * Operator tables in too little memory, and clients that do not wait for
 * them: each test has a daemon of its own.
 */
#include <stdarg.h>
#include <stddef.h>
#include <setjmp.h>
#include <stdint.h>
#include <cmocka.h>

#include <pthread.h>
#include <signal.h>
#include <stdio.h>
#include <string.h>
#include <sys/socket.h>
#include <time.h>
#include <unistd.h>

#include "tests/support/daemon.h"
#include "tests/support/http.h"
#include "tests/support/load.h"

/* Two spheres and one more: an operator that is built in, and one that is not. */
static const char body_format[] = "{\"scene\":{\"format\":\"blobfield/1\","
    "\"root\":{\"type\":\"union\",\"operator\":{\"profile\":{\"type\":"
    "\"bulge\",\"k\":%g},\"opening\":{\"theta\":0},\"layout\":\"%s\"},"
    "\"children\":[{\"type\":\"%s\",\"operator\":\"clean\",\"children\":["
    "{\"type\":\"point\",\"center\":[0,0,0],\"radius\":1},"
    "{\"type\":\"point\",\"center\":[0.5,0,0],\"radius\":1}]},"
    "{\"type\":\"point\",\"center\":[1,0,0],\"radius\":1}]}},"
    "\"points\":[[0,0,0]]}";

/* An evaluation in the background. */
struct client {
	pthread_t thread;
	const char *url;
	char body[1024];
	struct http_reply reply;
};

static void *evaluate(void *arg)
{
	struct client *client = arg;

	http_json(client->url, NULL, "/v1/eval", client->body, &client->reply);
	return NULL;
}

static void client_start(struct client *client, const char *url, double k,
    const char *type)
{
	client->url = url;
	snprintf(client->body, sizeof client->body, body_format, k, "warped",
	    type);
	assert_int_equal(pthread_create(&client->thread, NULL, evaluate,
	    client), 0);
}

static long client_finish(struct client *client)
{
	pthread_join(client->thread, NULL);
	http_reply_fini(&client->reply);
	return client->reply.status;
}

static double seconds(void)
{
	struct timespec now;

	clock_gettime(CLOCK_MONOTONIC, &now);
	return (double)now.tv_sec + 1e-9 * (double)now.tv_nsec;
}

/* Seconds until so many evaluations wait; fails after 60. */
static double await_waiting(const char *url, int waiting)
{
	double begin = seconds();
	char want[32];

	snprintf(want, sizeof want, "\"queue\":{\"waiting\":%d,", waiting);
	while (seconds() - begin < 60.0) {
		struct http_reply reply;
		int found;

		http_get(url, "/v1/info", &reply);
		found = strstr(reply.body, want) != NULL;
		http_reply_fini(&reply);
		if (found)
			return seconds() - begin;
		usleep(10000);
	}
	fail_msg("the queue does not get to be %s", want);
	return 0.0;
}

/* Asks for an evaluation that needs a table of seconds; the connection. */
static int ask(const struct daemon *d, double k)
{
	char body[1024], head[256];
	int fd = http_connect(d->port);

	snprintf(body, sizeof body, body_format, k, "uniform", "union");
	snprintf(head, sizeof head, "POST /v1/eval HTTP/1.1\r\nHost: localhost\r\n"
	    "Content-Type: application/json\r\nContent-Length: %zu\r\n\r\n",
	    strlen(body));
	assert_true(send(fd, head, strlen(head), MSG_NOSIGNAL) > 0);
	assert_true(send(fd, body, strlen(body), MSG_NOSIGNAL) > 0);
	return fd;
}

/* Room for two: each evaluation needs a built-in table and one more. */
static void test_early_evaluations_do_not_keep_built_in_tables_out(
    void **state)
{
	static const char *const arguments[] = {"--no-measure",
	    "--table-memory", "26M", NULL};
	struct client one = {0}, two = {0};
	struct daemon d;

	(void)state;
	daemon_start(&d, arguments);
	client_start(&one, d.url, 0.5, "union");
	usleep(30000);
	client_start(&two, d.url, 0.6, "intersection");
	assert_int_equal(client_finish(&one), 200);
	assert_int_equal(client_finish(&two), 200);
	daemon_await_ready(&d);
	/* The same once it is ready. */
	client_start(&one, d.url, 0.5, "intersection");
	client_start(&two, d.url, 0.6, "union");
	assert_int_equal(client_finish(&one), 200);
	assert_int_equal(client_finish(&two), 200);
	assert_int_equal(daemon_stop(&d, SIGTERM), 0);
}

static void test_who_hangs_up_frees_the_place_in_the_queue(void **state)
{
	static const char *const arguments[] = {"--no-measure", "--queue", "1",
	    NULL};
	struct client next = {0};
	struct daemon d;
	int fd;

	(void)state;
	daemon_start(&d, arguments);
	daemon_await_ready(&d);
	fd = ask(&d, 0.5);
	await_waiting(d.url, 1);
	client_start(&next, d.url, 0.8, "union");
	assert_int_equal(client_finish(&next), 503);
	close(fd);
	assert_true(load_is_soon(await_waiting(d.url, 0), 0.5));
	/* Its table, of seconds, is not built. */
	client_start(&next, d.url, 0.8, "union");
	assert_int_equal(client_finish(&next), 200);
	assert_int_equal(daemon_stop(&d, SIGTERM), 0);
}

static void test_sigterm_builds_nothing_for_those_who_hung_up(void **state)
{
	static const char *const arguments[] = {"--no-measure", NULL};
	struct daemon d;
	double begin;
	int fds[4];

	(void)state;
	daemon_start(&d, arguments);
	daemon_await_ready(&d);
	for (int i = 0; i < 4; i++)
		fds[i] = ask(&d, 0.5 + 0.05 * i);
	await_waiting(d.url, 4);
	for (int i = 0; i < 4; i++)
		close(fds[i]);
	begin = seconds();
	assert_int_equal(daemon_stop(&d, SIGTERM), 0);
	assert_true(load_is_soon(seconds() - begin, 0.5));
}

int main(void)
{
	const struct CMUnitTest tests[] = {
		cmocka_unit_test(
		    test_early_evaluations_do_not_keep_built_in_tables_out),
		cmocka_unit_test(
		    test_who_hangs_up_frees_the_place_in_the_queue),
		cmocka_unit_test(
		    test_sigterm_builds_nothing_for_those_who_hung_up),
	};

	return cmocka_run_group_tests(tests, NULL, NULL);
}
