/*
 * Starting, a full queue, draining and stopping: each test has daemons of its own.
 */
#include <stdarg.h>
#include <stddef.h>
#include <setjmp.h>
#include <stdint.h>
#include <cmocka.h>

#include <fcntl.h>
#include <pthread.h>
#include <signal.h>
#include <stdbool.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/socket.h>
#include <sys/wait.h>
#include <time.h>
#include <unistd.h>

#include "tests/support/daemon.h"
#include "tests/support/http.h"
#include "tests/support/load.h"

static const char *const no_measure[] = {"--no-measure", NULL};

static const char small[] = "{\"scene\":{\"format\":\"blobfield/1\",\"root\":"
    "{\"type\":\"union\",\"operator\":\"camel\",\"children\":["
    "{\"type\":\"point\",\"center\":[0,0,0],\"radius\":1},"
    "{\"type\":\"point\",\"center\":[1,0,0],\"radius\":1}]}},"
    "\"points\":[[0,0,0]]}";

/* An evaluation in the background that takes about a second a million points. */
struct slow {
	pthread_t thread;
	const char *url;
	struct http_reply reply;
	float *points;
	size_t count;
};

static void put_scene(const char *url)
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
	assert_int_equal(reply.status, 201);
	http_reply_fini(&reply);
}

static void *evaluate_slowly(void *arg)
{
	struct slow *slow = arg;

	http_do(slow->url, &(struct http_request){
		.path = "/v1/scenes/slow/eval?outputs=hessian",
		.body = slow->points,
		.length = slow->count * 3 * sizeof(float),
		.headers = {"Content-Type: application/octet-stream",
		    "Accept: application/octet-stream"},
	}, &slow->reply);
	return NULL;
}

static void slow_start(struct slow *slow, const char *url, size_t count)
{
	slow->url = url;
	slow->count = count;
	slow->points = malloc(count * 3 * sizeof(float));
	assert_non_null(slow->points);
	for (size_t i = 0; i < 3 * count; i++)
		slow->points[i] = (float)(i * 7919 % 4096) / 2048.0f - 0.5f;
	assert_int_equal(pthread_create(&slow->thread, NULL, evaluate_slowly,
	    slow), 0);
}

/* Waits for the answer; returns its status. */
static long slow_finish(struct slow *slow)
{
	pthread_join(slow->thread, NULL);
	if (slow->reply.status == 200)
		assert_int_equal(slow->reply.length,
		    slow->count * 6 * sizeof(float));
	http_reply_fini(&slow->reply);
	free(slow->points);
	return slow->reply.status;
}

/* Waits until the queue is as given. */
static void await_queue(const char *url, int waiting, int running)
{
	char want[64];

	snprintf(want, sizeof want, "\"waiting\":%d,\"running\":%d,", waiting,
	    running);
	for (int i = 0; i < 3000; i++) {
		struct http_reply reply;
		int found;

		http_get(url, "/v1/info", &reply);
		found = strstr(reply.body, want) != NULL;
		http_reply_fini(&reply);
		if (found)
			return;
		usleep(10000);
	}
	fail_msg("the queue does not get to be %s", want);
}

static void test_an_idle_daemon_stops_with_0(void **state)
{
	struct daemon d;

	(void)state;
	daemon_start(&d, no_measure);
	daemon_await_ready(&d);
	assert_int_equal(daemon_stop(&d, SIGTERM), 0);
}

static void test_sigint_is_as_good(void **state)
{
	struct daemon d;

	(void)state;
	daemon_start(&d, no_measure);
	daemon_await_ready(&d);
	assert_int_equal(daemon_stop(&d, SIGINT), 0);
}

/* From a terminal it says that the terminal has gone: tests/wire/test_systemd.py
 * has that. */
static void test_sighup_ends_nothing_without_a_terminal(void **state)
{
	int null = open("/dev/null", O_RDONLY), saved = dup(STDIN_FILENO);
	struct http_reply reply;
	struct daemon d;

	(void)state;
	dup2(null, STDIN_FILENO);
	daemon_start(&d, no_measure);
	dup2(saved, STDIN_FILENO);
	close(null);
	close(saved);
	kill(d.pid, SIGHUP);
	usleep(200000);
	http_get(d.url, "/healthz", &reply);
	http_reply_fini(&reply);
	assert_int_equal(reply.status, 200);
	assert_int_equal(daemon_stop(&d, SIGTERM), 0);
}

static void test_stopping_before_ready(void **state)
{
	struct daemon d;

	(void)state;
	daemon_start(&d, NULL);
	assert_int_equal(daemon_stop(&d, SIGTERM), 0);
}

static void test_stopping_while_measuring(void **state)
{
	struct daemon d;

	(void)state;
	daemon_start(&d, NULL);
	daemon_await_ready(&d);
	usleep(200000);
	assert_int_equal(daemon_stop(&d, SIGTERM), 0);
}

static void test_evaluations_before_ready_wait(void **state)
{
	struct http_reply reply;
	struct daemon d;

	(void)state;
	daemon_start(&d, no_measure);
	http_get(d.url, "/healthz", &reply);
	http_reply_fini(&reply);
	assert_int_equal(reply.status, 200);
	http_json(d.url, NULL, "/v1/eval", small, &reply);
	assert_int_equal(reply.status, 200);
	http_reply_fini(&reply);
	assert_int_equal(daemon_stop(&d, SIGTERM), 0);
}

static void test_sigterm_finishes_what_runs_and_what_waits(void **state)
{
	struct slow running, waiting;
	struct daemon d;

	(void)state;
	daemon_start(&d, no_measure);
	daemon_await_ready(&d);
	put_scene(d.url);
	slow_start(&running, d.url, 1000000);
	await_queue(d.url, 0, 1);
	slow_start(&waiting, d.url, 200000);
	await_queue(d.url, 0, 2);
	assert_int_equal(daemon_stop(&d, SIGTERM), 0);
	assert_int_equal(slow_finish(&running), 200);
	assert_int_equal(slow_finish(&waiting), 200);
}

/* Longer than requests that are still arriving are given. */
/* The head of an evaluation of so many points, both ways in octets. */
static void send_head(int fd, size_t points)
{
	char head[256];
	int length = snprintf(head, sizeof head, "POST /v1/scenes/slow/eval"
	    "?outputs=hessian HTTP/1.1\r\nHost: localhost\r\n"
	    "Content-Type: application/octet-stream\r\n"
	    "Accept: application/octet-stream\r\n"
	    "Content-Length: %zu\r\n\r\n", points * 12);

	assert_true(send(fd, head, (size_t)length, MSG_NOSIGNAL) == length);
}

static void send_zeros(int fd, size_t length)
{
	static const char zeros[65536];

	while (length > 0) {
		ssize_t n = send(fd, zeros, length < sizeof zeros ? length :
		    sizeof zeros, MSG_NOSIGNAL);

		assert_true(n > 0);
		length -= (size_t)n;
	}
}

/* Of so many points, begun; its answer is to be read. */
static int begin_slow(const struct daemon *d, size_t points)
{
	int fd = http_connect(d->port);

	send_head(fd, points);
	send_zeros(fd, points * 12);
	return fd;
}

/* All that comes until the server closes, in bytes. */
static size_t read_slow(int fd)
{
	static char buffer[65536];
	size_t got = 0;
	ssize_t n;

	while ((n = recv(fd, buffer, sizeof buffer, 0)) > 0)
		got += (size_t)n;
	close(fd);
	return got;
}

/*
 * Its evaluation waits for it, too: it is under way until all has been read.
 * Not for one that does not read at all: that is cut off, else it would hold up
 * the end for the whole minute that a drain may take.
 */
static void test_sigterm_waits_for_a_slow_reader(void **state)
{
	const size_t points = 1000000;
	int slow, stalled;
	struct daemon d;
	time_t begin;

	(void)state;
	daemon_start(&d, no_measure);
	daemon_await_ready(&d);
	put_scene(d.url);
	slow = begin_slow(&d, points);
	stalled = begin_slow(&d, points);
	await_queue(d.url, 0, 2);
	kill(d.pid, SIGTERM);
	begin = time(NULL);
	sleep(7);
	assert_true(read_slow(slow) > points * 24);
	assert_int_equal(daemon_stop(&d, 0), 0);
	/* 12, alone */
	assert_true(load_is_soon((double)(time(NULL) - begin), 14.0));
	assert_true(read_slow(stalled) < points * 24);
}

/* Asks over fd, a connection opened before; the answer's status. */
static int ask_over(int fd, const char *text, char *reply, size_t size)
{
	int status = 0;
	ssize_t n;

	assert_true(send(fd, text, strlen(text), MSG_NOSIGNAL) > 0);
	n = recv(fd, reply, size - 1, 0);
	assert_true(n > 0);
	reply[n] = '\0';
	sscanf(reply, "HTTP/1.1 %d", &status);
	return status;
}

static void test_draining_answers_503_over_old_connections(void **state)
{
	static const char ready[] = "GET /readyz HTTP/1.1\r\nHost: localhost\r\n\r\n";
	char eval[1024], reply[4096];
	struct slow running;
	struct daemon d;
	int one, two;

	(void)state;
	snprintf(eval, sizeof eval, "POST /v1/eval HTTP/1.1\r\nHost: localhost\r\n"
	    "Content-Type: application/json\r\nContent-Length: %zu\r\n\r\n%s",
	    strlen(small), small);
	daemon_start(&d, no_measure);
	daemon_await_ready(&d);
	put_scene(d.url);
	one = http_connect(d.port);
	two = http_connect(d.port);
	assert_int_equal(ask_over(one, ready, reply, sizeof reply), 200);
	assert_int_equal(ask_over(two, ready, reply, sizeof reply), 200);
	slow_start(&running, d.url, 2000000);
	await_queue(d.url, 0, 1);
	kill(d.pid, SIGTERM);
	/* What is answered once it drains closes the connection. */
	for (int i = 0; i < 3000 && ask_over(one, ready, reply,
	    sizeof reply) == 200; i++)
		usleep(10000);
	assert_non_null(strstr(reply, "HTTP/1.1 503"));
	assert_non_null(strstr(reply, "draining"));
	usleep(300000); /* the device's queue is closed a little later */
	assert_int_equal(ask_over(two, eval, reply, sizeof reply), 503);
	assert_non_null(strstr(reply, "Retry-After: "));
	assert_non_null(strstr(reply, "Connection: close"));
	close(one);
	close(two);
	assert_int_equal(slow_finish(&running), 200);
	assert_int_equal(daemon_stop(&d, 0), 0);
}

/* As supervisors and terminals do. */
static void test_a_signal_sent_twice_counts_once(void **state)
{
	struct slow running;
	struct daemon d;

	(void)state;
	daemon_start(&d, no_measure);
	daemon_await_ready(&d);
	put_scene(d.url);
	slow_start(&running, d.url, 1000000);
	await_queue(d.url, 0, 1);
	kill(d.pid, SIGTERM);
	usleep(100000);
	assert_int_equal(daemon_stop(&d, SIGTERM), 0);
	assert_int_equal(slow_finish(&running), 200);
}

/* It is still to be waited for. */
static bool has_ended(pid_t pid)
{
	siginfo_t info = {.si_pid = 0};

	assert_int_equal(waitid(P_PID, (id_t)pid, &info, WEXITED | WNOHANG |
	    WNOWAIT), 0);
	return info.si_pid == pid;
}

static void test_a_later_signal_ends_it_at_once(void **state)
{
	struct slow running;
	struct daemon d;

	(void)state;
	daemon_start(&d, no_measure);
	daemon_await_ready(&d);
	put_scene(d.url);
	slow_start(&running, d.url, 4000000);
	await_queue(d.url, 0, 1);
	kill(d.pid, SIGTERM);
	usleep(1200000);
	/* It may have begun to drain later than it was told to. */
	while (!has_ended(d.pid)) {
		kill(d.pid, SIGTERM);
		usleep(50000);
	}
	assert_int_equal(daemon_stop(&d, 0), 1);
	assert_int_equal(slow_finish(&running), 0);
}

static void test_a_full_queue_answers_503_and_when_to_retry(void **state)
{
	static const char *const arguments[] = {"--no-measure", "--queue", "1",
	    NULL};
	struct slow running, waiting;
	struct http_reply reply;
	struct daemon d;
	char seconds[16];

	(void)state;
	daemon_start(&d, arguments);
	daemon_await_ready(&d);
	put_scene(d.url);
	slow_start(&running, d.url, 1000000);
	await_queue(d.url, 0, 1);
	slow_start(&waiting, d.url, 1000000);
	await_queue(d.url, 0, 2);
	http_json(d.url, NULL, "/v1/eval", small, &reply);
	assert_int_equal(reply.status, 503);
	assert_non_null(strstr(reply.body, "/problems/queue-full"));
	http_header(&reply, "Retry-After", seconds, sizeof seconds);
	assert_true(atoi(seconds) >= 1);
	http_reply_fini(&reply);
	assert_int_equal(slow_finish(&running), 200);
	assert_int_equal(slow_finish(&waiting), 200);
	http_json(d.url, NULL, "/v1/eval", small, &reply);
	http_reply_fini(&reply);
	assert_int_equal(reply.status, 200);
	assert_int_equal(daemon_stop(&d, SIGTERM), 0);
}

/* ... also while another evaluation runs for long. */
static void test_who_hangs_up_frees_the_place_in_the_queue(void **state)
{
	static const char *const arguments[] = {"--no-measure", "--queue", "1",
	    NULL};
	const size_t points = 200000;
	struct slow running;
	struct daemon d;
	int fd;

	(void)state;
	daemon_start(&d, arguments);
	daemon_await_ready(&d);
	put_scene(d.url);
	slow_start(&running, d.url, 2000000);
	await_queue(d.url, 0, 1);
	fd = http_connect(d.port);
	send_head(fd, points);
	send_zeros(fd, points * 12);
	await_queue(d.url, 0, 2);
	close(fd);
	await_queue(d.url, 0, 1);
	assert_int_equal(slow_finish(&running), 200);
	assert_int_equal(daemon_stop(&d, SIGTERM), 0);
}

/* Room for two tables of four: they take turns. */
static void test_tables_take_turns_in_little_memory(void **state)
{
	static const char *const arguments[] = {"--no-measure",
	    "--table-memory", "30M", NULL};
	static const char *const kinds[] = {"union", "intersection"};
	static const char *const operators[] = {"camel", "contact"};
	struct daemon d;
	char body[512];

	(void)state;
	daemon_start(&d, arguments);
	daemon_await_ready(&d);
	for (int i = 0; i < 8; i++) {
		struct http_reply reply;

		snprintf(body, sizeof body, "{\"scene\":{\"format\":"
		    "\"blobfield/1\",\"root\":{\"type\":\"%s\",\"operator\":"
		    "\"%s\",\"children\":[{\"type\":\"point\",\"center\":"
		    "[0,0,0],\"radius\":1},{\"type\":\"point\",\"center\":"
		    "[0.5,0,0],\"radius\":1}]}},\"points\":[[0,0,0]]}",
		    kinds[i % 2], operators[i / 2 % 2]);
		http_json(d.url, NULL, "/v1/eval", body, &reply);
		assert_int_equal(reply.status, 200);
		http_reply_fini(&reply);
	}
	assert_int_equal(daemon_stop(&d, SIGTERM), 0);
}

static void test_tables_that_never_fit_are_said_so_at_start(void **state)
{
	static const char *const arguments[] = {"--listen", "127.0.0.1:0",
	    "--table-memory", "1M", NULL};
	char output[4096];

	(void)state;
	assert_int_equal(daemon_run(arguments, output, sizeof output), 1);
	assert_non_null(strstr(output, "operator table"));
}

static void test_a_device_that_is_not_there_is_said_before_listening(
    void **state)
{
	static const char *const arguments[] = {"--listen", "127.0.0.1:0",
	    "--device", "nonsense", NULL};
	char output[4096];

	(void)state;
	assert_int_equal(daemon_run(arguments, output, sizeof output), 1);
	assert_null(strstr(output, "listening"));
	assert_non_null(strstr(output, "nonsense"));
}

static void test_a_port_in_use_is_said_before_listening(void **state)
{
	char address[32], output[4096];
	const char *const arguments[] = {"--listen", address, NULL};
	struct daemon d;

	(void)state;
	daemon_start(&d, no_measure);
	snprintf(address, sizeof address, "127.0.0.1:%d", d.port);
	assert_int_equal(daemon_run(arguments, output, sizeof output), 1);
	assert_null(strstr(output, "listening"));
	assert_non_null(strstr(output, "cannot listen"));
	assert_int_equal(daemon_stop(&d, SIGTERM), 0);
}

int main(void)
{
	const struct CMUnitTest tests[] = {
		cmocka_unit_test(test_an_idle_daemon_stops_with_0),
		cmocka_unit_test(test_sigint_is_as_good),
		cmocka_unit_test(test_sighup_ends_nothing_without_a_terminal),
		cmocka_unit_test(test_stopping_before_ready),
		cmocka_unit_test(test_stopping_while_measuring),
		cmocka_unit_test(test_evaluations_before_ready_wait),
		cmocka_unit_test(
		    test_sigterm_finishes_what_runs_and_what_waits),
		cmocka_unit_test(test_sigterm_waits_for_a_slow_reader),
		cmocka_unit_test(
		    test_draining_answers_503_over_old_connections),
		cmocka_unit_test(test_a_signal_sent_twice_counts_once),
		cmocka_unit_test(test_a_later_signal_ends_it_at_once),
		cmocka_unit_test(
		    test_a_full_queue_answers_503_and_when_to_retry),
		cmocka_unit_test(
		    test_who_hangs_up_frees_the_place_in_the_queue),
		cmocka_unit_test(test_tables_take_turns_in_little_memory),
		cmocka_unit_test(
		    test_tables_that_never_fit_are_said_so_at_start),
		cmocka_unit_test(
		    test_a_device_that_is_not_there_is_said_before_listening),
		cmocka_unit_test(
		    test_a_port_in_use_is_said_before_listening),
	};

	return cmocka_run_group_tests(tests, NULL, NULL);
}
