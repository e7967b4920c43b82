/*
 * Requests that no client library would send: raw bytes.
 */
#include <stdarg.h>
#include <stddef.h>
#include <setjmp.h>
#include <stdint.h>
#include <cmocka.h>

#include <dirent.h>
#include <errno.h>
#include <stdbool.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/socket.h>
#include <sys/time.h>
#include <unistd.h>

#include "tests/support/daemon.h"
#include "tests/support/http.h"

#define HOST "Host: localhost\r\n"
#define POST_EVAL "POST /v1/eval HTTP/1.1\r\n"
#define COMPLETED "\"completed\":"
#define POINTS "\"points\":"
#define LARGE_POINTS 400000
#define TYPE "Content-Type: application/json\r\n"

static int send_text(void **state, const char *text, char *reply, size_t size)
{
	const struct daemon *d = *state;

	return http_raw(d->port, text, strlen(text), reply, size);
}

/* text gets status, and a problem that says says. */
static void assert_refused(void **state, const char *text, int status,
    const char *says)
{
	char reply[4096];

	assert_int_equal(send_text(state, text, reply, sizeof reply), status);
	assert_non_null(strstr(reply, "application/problem+json"));
	if (strstr(reply, says) == NULL)
		fail_msg("'%s' is not in %s", says, reply);
}

/* The daemon still answers. */
static void assert_alive(void **state)
{
	const struct daemon *d = *state;
	struct http_reply reply;

	http_get(d->url, "/healthz", &reply);
	http_reply_fini(&reply);
	assert_int_equal(reply.status, 200);
}

static void test_missing_host(void **state)
{
	assert_refused(state, "GET /healthz HTTP/1.1\r\n\r\n", 400, "Host");
}

static void test_two_hosts(void **state)
{
	assert_refused(state, "GET /healthz HTTP/1.1\r\n" HOST HOST "\r\n",
	    400, "Host");
}

static void test_http_1_0_needs_no_host(void **state)
{
	char reply[1024];

	assert_int_equal(send_text(state, "GET /healthz HTTP/1.0\r\n\r\n",
	    reply, sizeof reply), 200);
}

static void test_http_2_by_version(void **state)
{
	char reply[4096];
	int status = send_text(state, "GET /healthz HTTP/2.0\r\n" HOST "\r\n",
	    reply, sizeof reply);

	assert_true(status == 505 || status == 400);
}

static void test_two_content_lengths(void **state)
{
	assert_refused(state, POST_EVAL HOST TYPE "Content-Length: 2\r\n"
	    "Content-Length: 2\r\n\r\n{}", 400, "Content-Length");
	assert_refused(state, POST_EVAL HOST TYPE "Content-Length: 2\r\n"
	    "Content-Length: 40\r\n\r\n{}", 400, "Content-Length");
}

static void test_length_and_transfer_encoding(void **state)
{
	assert_refused(state, POST_EVAL HOST TYPE "Content-Length: 2\r\n"
	    "Transfer-Encoding: chunked\r\n\r\n0\r\n\r\n", 400,
	    "exclude each other");
}

static void test_unknown_transfer_encoding(void **state)
{
	assert_refused(state, POST_EVAL HOST TYPE
	    "Transfer-Encoding: gzip\r\n\r\n", 501, "chunked");
}

/* Whether the server closes the connection within 5 s of text. */
static bool closes_after(void **state, const char *text)
{
	const struct timeval patience = {.tv_sec = 5};
	const struct daemon *d = *state;
	int fd = http_connect(d->port);
	char reply[4096];
	bool closed;
	ssize_t n;

	setsockopt(fd, SOL_SOCKET, SO_RCVTIMEO, &patience, sizeof patience);
	send(fd, text, strlen(text), MSG_NOSIGNAL);
	do
		n = recv(fd, reply, sizeof reply, 0);
	while (n > 0);
	/* What it has not read makes it a reset. */
	closed = n == 0 || errno == ECONNRESET;
	close(fd);
	return closed;
}

/* libmicrohttpd's own page, its head twice; nothing behind is taken for a
 * request. */
static void test_content_length_that_is_no_number(void **state)
{
	static const char *const lengths[] = {"many", "-2", "2x", "", "0x2"};
	char text[512], reply[4096];

	for (size_t i = 0; i < sizeof lengths / sizeof *lengths; i++) {
		snprintf(text, sizeof text, POST_EVAL HOST TYPE
		    "Content-Length: %s\r\n\r\nGET /healthz HTTP/1.1\r\n"
		    HOST "\r\n", lengths[i]);
		assert_int_equal(send_text(state, text, reply, sizeof reply),
		    400);
		assert_non_null(strstr(reply, "Connection: close"));
		assert_null(strstr(reply, "200 OK"));
		assert_true(closes_after(state, text));
	}
	assert_alive(state);
}

static void test_length_over_the_limit_is_refused_unread(void **state)
{
	/* No body follows: the answer does not wait for it. */
	assert_refused(state, POST_EVAL HOST TYPE
	    "Content-Length: 140000000\r\n\r\n", 413, "134217728");
}

static void test_long_uri(void **state)
{
	char text[8192] = "GET /";

	memset(text + 5, 'a', 5000);
	strcpy(text + 5005, " HTTP/1.1\r\n" HOST "\r\n");
	assert_refused(state, text, 414, "4096");
}

static void test_huge_head_is_refused(void **state)
{
	size_t length = 100000;
	char *text = malloc(length + 64), reply[4096];
	int status;

	/* libmicrohttpd's own page: it never gets as far as this program. */
	memset(text, 'a', length);
	memcpy(text, "GET /healthz HTTP/1.1\r\n" HOST "X-Long: ", 48);
	memcpy(text + length, "\r\n\r\n", 5);
	status = send_text(state, text, reply, sizeof reply);
	assert_true(status == 431 || status == 413 || status == 414 ||
	    status == 0);
	free(text);
	assert_alive(state);
}

static void test_garbage(void **state)
{
	char reply[4096];

	send_text(state, "\x16\x03\x01\x02\r\n\r\n", reply, sizeof reply);
	send_text(state, "\r\n\r\n\r\n", reply, sizeof reply);
	send_text(state, "GET\r\n\r\n", reply, sizeof reply);
	assert_alive(state);
}

static void test_half_a_body(void **state)
{
	const struct daemon *d = *state;
	static const char text[] = POST_EVAL HOST TYPE
	    "Content-Length: 1000\r\n\r\n{\"points\":[";

	for (int i = 0; i < 20; i++) {
		int fd = http_connect(d->port);

		assert_true(send(fd, text, sizeof text - 1, MSG_NOSIGNAL) > 0);
		close(fd);
	}
	assert_alive(state);
}

static int count_descriptors(const struct daemon *d)
{
	char path[64];
	DIR *folder;
	int count = 0;

	snprintf(path, sizeof path, "/proc/%d/fd", (int)d->pid);
	folder = opendir(path);
	assert_non_null(folder);
	while (readdir(folder) != NULL)
		count++;
	closedir(folder);
	return count;
}

/* The last bytes and the end of the stream come together. */
static void test_uploads_hung_up_are_closed_soon(void **state)
{
	static const char text[] = POST_EVAL HOST TYPE
	    "Content-Length: 60000000\r\n\r\n{";
	const struct daemon *d = *state;
	int before;

	/* Those of the tests before go first. */
	usleep(2500000);
	before = count_descriptors(d);
	for (int i = 0; i < 50; i++) {
		int fd = http_connect(d->port);

		assert_true(send(fd, text, sizeof text - 1, MSG_NOSIGNAL) > 0);
		close(fd);
	}
	/* Two looks, a second apart. */
	for (int i = 0; i < 30 && count_descriptors(d) > before; i++)
		usleep(100000);
	assert_true(count_descriptors(d) <= before);
	assert_alive(state);
}

/* Complete requests are answered though the client has ended its side. */
static void test_half_closed_get_is_answered(void **state)
{
	static const char text[] = "GET /healthz HTTP/1.1\r\n" HOST "\r\n"
	    "GET /nowhere HTTP/1.1\r\n" HOST "\r\n";
	const struct timeval patience = {.tv_sec = 5};
	const struct daemon *d = *state;
	int fd = http_connect(d->port);
	char reply[4096];
	size_t got = 0;
	ssize_t n;

	setsockopt(fd, SOL_SOCKET, SO_RCVTIMEO, &patience, sizeof patience);
	send(fd, text, sizeof text - 1, MSG_NOSIGNAL);
	shutdown(fd, SHUT_WR);
	while ((n = recv(fd, reply + got, sizeof reply - 1 - got, 0)) > 0)
		got += (size_t)n;
	reply[got] = '\0';
	close(fd);
	assert_int_equal(n, 0);
	assert_non_null(strstr(reply, "HTTP/1.1 200"));
	assert_non_null(strstr(reply, "HTTP/1.1 404"));
}

static void test_promised_gigabytes_take_no_memory(void **state)
{
	static const char text[] = POST_EVAL HOST TYPE
	    "Content-Length: 134217728\r\n\r\n{";
	const struct daemon *d = *state;
	char path[64], line[128] = "";
	int fds[50];
	long kilobytes = 0;
	FILE *file;

	for (int i = 0; i < 50; i++) {
		fds[i] = http_connect(d->port);
		send(fds[i], text, sizeof text - 1, MSG_NOSIGNAL);
	}
	assert_alive(state);
	snprintf(path, sizeof path, "/proc/%d/statm", (int)d->pid);
	file = fopen(path, "r");
	assert_non_null(fgets(line, sizeof line, file));
	fclose(file);
	/* Resident pages; 50 bodies as promised would be 3.2 GB. */
	sscanf(line, "%*s %ld", &kilobytes);
	kilobytes *= sysconf(_SC_PAGESIZE) / 1024;
	assert_true(kilobytes > 0 && kilobytes < 2000000);
	for (int i = 0; i < 50; i++)
		close(fds[i]);
}

static void test_expect_100_continue(void **state)
{
	const struct daemon *d = *state;
	static const char head[] = POST_EVAL HOST TYPE "Content-Length: 2\r\n"
	    "Expect: 100-continue\r\nConnection: close\r\n\r\n";
	int fd = http_connect(d->port);
	char reply[4096];
	ssize_t n;

	send(fd, head, sizeof head - 1, MSG_NOSIGNAL);
	n = recv(fd, reply, sizeof reply - 1, 0);
	assert_true(n > 0);
	reply[n] = '\0';
	assert_int_equal(strncmp(reply, "HTTP/1.1 100", 12), 0);
	send(fd, "{}", 2, MSG_NOSIGNAL);
	n = recv(fd, reply, sizeof reply - 1, 0);
	assert_true(n > 0);
	reply[n] = '\0';
	assert_int_equal(strncmp(reply, "HTTP/1.1 422", 12), 0);
	close(fd);
}

static void test_expect_100_with_too_much_gets_413_at_once(void **state)
{
	assert_refused(state, POST_EVAL HOST TYPE "Content-Length: 199999999\r\n"
	    "Expect: 100-continue\r\n\r\n", 413, "134217728");
}

/* Sends chunks of 64 KiB over the limit of a daemon of its own. */
static void test_chunked_body_over_the_limit(void **state)
{
	static const char *const arguments[] = {"--no-measure", "--max-body",
	    "256k", NULL};
	static const char head[] = POST_EVAL HOST TYPE
	    "Transfer-Encoding: chunked\r\n\r\n";
	size_t chunk = 65536, length = sizeof head - 1;
	char *text = malloc(20 * (chunk + 16)), reply[4096];
	struct daemon d;

	(void)state;
	memcpy(text, head, length);
	for (int i = 0; i < 6; i++) {
		length += (size_t)sprintf(text + length, "10000\r\n");
		memset(text + length, ' ', chunk);
		length += chunk;
		length += (size_t)sprintf(text + length, "\r\n");
	}
	daemon_start(&d, arguments);
	/* The last chunk never comes: the answer does not wait for it. */
	assert_int_equal(http_raw(d.port, text, length, reply, sizeof reply),
	    413);
	assert_non_null(strstr(reply, "application/problem+json"));
	assert_non_null(strstr(reply, "262144"));
	/* Nor is it read for ever. */
	for (int i = 6; i < 18; i++) {
		length += (size_t)sprintf(text + length, "10000\r\n");
		memset(text + length, ' ', chunk);
		length += chunk;
		length += (size_t)sprintf(text + length, "\r\n");
	}
	http_raw(d.port, text, length, reply, sizeof reply);
	free(text);
	assert_int_equal(daemon_stop(&d, 15), 0);
}

static void test_pipelined_requests_are_answered_in_order(void **state)
{
	char reply[4096];
	const char *first, *second;

	assert_int_equal(send_text(state, "GET /healthz HTTP/1.1\r\n" HOST
	    "\r\nGET /nowhere HTTP/1.1\r\n" HOST "Connection: close\r\n\r\n",
	    reply, sizeof reply), 200);
	first = strstr(reply, "HTTP/1.1 200");
	second = strstr(reply, "HTTP/1.1 404");
	assert_non_null(first);
	assert_non_null(second);
	assert_true(first < second);
}

/* Without a body to skip, the connection goes on. */
static void test_refused_requests_without_body_keep_the_connection(
    void **state)
{
	static const char *const first[] = {
		"GET /nowhere HTTP/1.1\r\n",
		"DELETE /v1/info HTTP/1.1\r\n",
		"GET /v1/info?a=1 HTTP/1.1\r\n",
		"OPTIONS /v1/info HTTP/1.1\r\n",
	};
	char text[512], reply[4096];

	for (size_t i = 0; i < sizeof first / sizeof *first; i++) {
		snprintf(text, sizeof text, "%s" HOST "\r\n"
		    "GET /healthz HTTP/1.1\r\n" HOST
		    "Connection: close\r\n\r\n", first[i]);
		assert_true(send_text(state, text, reply, sizeof reply) !=
		    200);
		if (strstr(reply, "HTTP/1.1 200") == NULL)
			fail_msg("only one answer: %s", reply);
	}
}

/* One with a body is refused unread, and nothing of it taken for a request. */
static void test_refused_requests_with_body_close(void **state)
{
	char reply[4096];

	assert_int_equal(send_text(state, "POST /nowhere HTTP/1.1\r\n" HOST
	    "Content-Length: 40\r\n\r\nGET /healthz HTTP/1.1\r\n" HOST
	    "\r\n", reply, sizeof reply), 404);
	assert_non_null(strstr(reply, "Connection: close"));
	assert_null(strstr(reply, "HTTP/1.1 200"));
}

static void test_absolute_form(void **state)
{
	char reply[4096];

	assert_int_equal(send_text(state, "GET http://localhost/healthz "
	    "HTTP/1.1\r\n" HOST "Connection: close\r\n\r\n", reply,
	    sizeof reply), 200);
	assert_int_equal(send_text(state, "GET HTTP://localhost:1?a=1 "
	    "HTTP/1.1\r\n" HOST "Connection: close\r\n\r\n", reply,
	    sizeof reply), 400);
	assert_int_equal(send_text(state, "GET http://localhost HTTP/1.1\r\n"
	    HOST "Connection: close\r\n\r\n", reply, sizeof reply), 200);
	assert_non_null(strstr(reply, "endpoints"));
	assert_int_equal(send_text(state, "GET ftp://localhost/healthz "
	    "HTTP/1.1\r\n" HOST "Connection: close\r\n\r\n", reply,
	    sizeof reply), 404);
}

static void test_options_of_everything(void **state)
{
	char reply[4096];

	assert_int_equal(send_text(state, "OPTIONS * HTTP/1.1\r\n" HOST
	    "Connection: close\r\n\r\n", reply, sizeof reply), 204);
	assert_non_null(strstr(reply, "Allow: GET, HEAD, POST, PUT, "));
	assert_int_equal(send_text(state, "GET * HTTP/1.1\r\n" HOST
	    "Connection: close\r\n\r\n", reply, sizeof reply), 404);
}

static void test_nul_bytes_in_the_request_line(void **state)
{
	static const char path[] = "DELETE /v1/scenes/a\0b HTTP/1.1\r\n" HOST
	    "Connection: close\r\n\r\n";
	static const char query[] = "GET /v1/info?\0a=1 HTTP/1.1\r\n" HOST
	    "Connection: close\r\n\r\n";
	const struct daemon *d = *state;
	char reply[4096];

	assert_int_equal(http_raw(d->port, path, sizeof path - 1, reply,
	    sizeof reply), 400);
	assert_non_null(strstr(reply, "NUL"));
	assert_int_equal(http_raw(d->port, query, sizeof query - 1, reply,
	    sizeof reply), 400);
	/* More blanks than need be are not one. */
	assert_int_equal(send_text(state, "GET  /healthz HTTP/1.1\r\n" HOST
	    "Connection: close\r\n\r\n", reply, sizeof reply), 200);
}

/* A body for an evaluation that takes a while. */
static char *make_large(size_t *length)
{
	static const char scene[] = "{\"scene\":{\"format\":\"blobfield/1\","
	    "\"root\":{\"type\":\"union\",\"operator\":\"camel\","
	    "\"children\":[";
	size_t size = 32u << 20, at;
	char *body = malloc(size);

	at = (size_t)sprintf(body, "%s", scene);
	for (int i = 0; i < 100; i++)
		at += (size_t)sprintf(body + at, "%s{\"type\":\"point\","
		    "\"center\":[%g,0,0],\"radius\":3}", i > 0 ? "," : "",
		    0.01 * i);
	at += (size_t)sprintf(body + at, "]}},\"outputs\":[\"hessian\"],"
	    "\"points\":[0,0,0");
	for (int i = 1; i < LARGE_POINTS; i++)
		at += (size_t)sprintf(body + at, ",%d.5,%d,1", i % 3, i % 2);
	at += (size_t)sprintf(body + at, "]}");
	*length = at;
	return body;
}

/* A figure of /v1/info. */
static long figure(void **state, const char *name)
{
	const struct daemon *d = *state;
	struct http_reply reply;
	const char *at;
	long n = -1;

	http_get(d->url, "/v1/info", &reply);
	at = strstr(reply.body, name);
	if (at != NULL)
		n = strtol(at + strlen(name), NULL, 10);
	http_reply_fini(&reply);
	return n;
}

static void test_hang_up_during_evaluation(void **state)
{
	const struct daemon *d = *state;
	char head[256];
	size_t length;
	char *body = make_large(&length);
	long before = figure(state, COMPLETED);
	long points = figure(state, POINTS);

	snprintf(head, sizeof head, "%s%s%sContent-Length: %zu\r\n\r\n",
	    POST_EVAL, HOST, TYPE, length);
	for (int i = 0; i < 3; i++) {
		int fd = http_connect(d->port);

		send(fd, head, strlen(head), MSG_NOSIGNAL);
		for (size_t at = 0; at < length;) {
			ssize_t n = send(fd, body + at, length - at,
			    MSG_NOSIGNAL);

			assert_true(n > 0);
			at += (size_t)n;
		}
		usleep(20000);
		close(fd);
	}
	free(body);
	for (int i = 0; i < 1200 && figure(state, COMPLETED) < before + 3; i++)
		usleep(100000);
	assert_int_equal(figure(state, COMPLETED), before + 3);
	/* A fast device may have got to the end of some, not of all. */
	assert_true(figure(state, POINTS) < points + 3 * LARGE_POINTS);
	assert_alive(state);
}

int main(void)
{
	const struct CMUnitTest tests[] = {
		cmocka_unit_test(test_missing_host),
		cmocka_unit_test(test_two_hosts),
		cmocka_unit_test(test_http_1_0_needs_no_host),
		cmocka_unit_test(test_http_2_by_version),
		cmocka_unit_test(test_two_content_lengths),
		cmocka_unit_test(test_length_and_transfer_encoding),
		cmocka_unit_test(test_unknown_transfer_encoding),
		cmocka_unit_test(test_content_length_that_is_no_number),
		cmocka_unit_test(test_length_over_the_limit_is_refused_unread),
		cmocka_unit_test(test_long_uri),
		cmocka_unit_test(test_huge_head_is_refused),
		cmocka_unit_test(test_garbage),
		cmocka_unit_test(test_half_a_body),
		cmocka_unit_test(test_uploads_hung_up_are_closed_soon),
		cmocka_unit_test(test_half_closed_get_is_answered),
		cmocka_unit_test(test_promised_gigabytes_take_no_memory),
		cmocka_unit_test(test_expect_100_continue),
		cmocka_unit_test(
		    test_expect_100_with_too_much_gets_413_at_once),
		cmocka_unit_test(test_chunked_body_over_the_limit),
		cmocka_unit_test(test_pipelined_requests_are_answered_in_order),
		cmocka_unit_test(
		    test_refused_requests_without_body_keep_the_connection),
		cmocka_unit_test(test_refused_requests_with_body_close),
		cmocka_unit_test(test_absolute_form),
		cmocka_unit_test(test_options_of_everything),
		cmocka_unit_test(test_nul_bytes_in_the_request_line),
		cmocka_unit_test(test_hang_up_during_evaluation),
	};

	return cmocka_run_group_tests(tests, daemon_setup, daemon_teardown);
}
