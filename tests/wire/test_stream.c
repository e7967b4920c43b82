/*
 * Bodies that arrive bit by bit, answers that leave as they are made, and what
 * the head of an evaluation may ask for beside.
 */
#include <stdarg.h>
#include <stddef.h>
#include <setjmp.h>
#include <stdint.h>
#include <cmocka.h>

#include <poll.h>
#include <pthread.h>
#include <signal.h>
#include <stdbool.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/socket.h>
#include <sys/time.h>
#include <unistd.h>

#include "tests/support/daemon.h"
#include "tests/support/http.h"
#include "tests/support/npy.h"

#define EVAL "/v1/scenes/s/eval"
#define OCTETS_IN "Content-Type: application/octet-stream\r\n"
#define OCTETS_OUT "Accept: application/octet-stream\r\n"
#define NPY_OUT "Accept: application/x-npy\r\n"
#define JSON_IN "Content-Type: application/json\r\n"

/* So many that rows of value and gradient are more than leave whole, and the
 * part of them that leaves so. */
#define LARGE 300000
#define PART 50000
#define ROW 4

/* So many that rows of all derivatives are more than all buffers on the way. */
#define HUGE_COUNT 1000000
#define HUGE_ROW 10
#define HUGE_BYTES ((size_t)HUGE_COUNT * HUGE_ROW * sizeof(float))
#define HUGE_PATH EVAL "?outputs=value,gradient,hessian"

#define STREAMS 20

/* Clients that do not read, and places in the queue. */
#define STALLED 12
#define PLACES "4"

static const char scene[] = "{\"format\":\"blobfield/1\",\"root\":"
    "{\"type\":\"union\",\"operator\":\"camel\",\"children\":["
    "{\"type\":\"point\",\"center\":[0,0,0],\"radius\":1},"
    "{\"type\":\"segment\",\"a\":[0.5,0,0],\"b\":[0.5,1,0.5],"
    "\"radius\":0.6}]}}";

static float *points; /* HUGE_COUNT of them */
static float *rows;   /* of LARGE of them, from answers that left whole */

/* A request and how it is sent. */
struct sending {
	const char *path, *headers;
	const void *body;
	size_t length;
	size_t step;        /* bytes at a time; 0: all */
	bool is_chunked;
	bool is_1_0;
};

/* An answer as it came, chunks put together; for free(bytes). */
struct answer {
	int status;
	char *bytes;
	const char *body;   /* in bytes, which end in NUL */
	size_t length;
	bool is_chunked, is_whole;
};

static void put_scene(const char *url)
{
	struct http_reply reply;

	http_json(url, "PUT", "/v1/scenes/s", scene, &reply);
	http_reply_fini(&reply);
	assert_true(reply.status == 201 || reply.status == 200);
}

static int teardown(void **state)
{
	free(points);
	free(rows);
	return daemon_teardown(state);
}

/* ---- sending ---- */

static void send_all(int fd, const void *data, size_t length)
{
	const char *at = data;

	while (length > 0) {
		ssize_t n = send(fd, at, length, MSG_NOSIGNAL);

		assert_true(n > 0);
		at += n;
		length -= (size_t)n;
	}
}

static void send_chunk(int fd, const void *data, size_t length)
{
	char line[32];

	send_all(fd, line, (size_t)sprintf(line, "%zx\r\n", length));
	send_all(fd, data, length);
	send_all(fd, "\r\n", 2);
}

static void send_head(int fd, const struct sending *s)
{
	char head[1024], framing[64] = "Transfer-Encoding: chunked\r\n";

	if (!s->is_chunked)
		sprintf(framing, "Content-Length: %zu\r\n", s->length);
	send_all(fd, head, (size_t)snprintf(head, sizeof head,
	    "POST %s HTTP/1.%d\r\nHost: localhost\r\nConnection: close\r\n%s%s\r\n",
	    s->path, !s->is_1_0, s->headers, framing));
}

/* Steps grow and shrink, so that they end anywhere in a number. */
static void send_body(int fd, const struct sending *s)
{
	const char *body = s->body;
	size_t n;

	for (size_t at = 0, i = 0; at < s->length; at += n, i++) {
		n = s->step > 0 ? 1 + s->step * (i % 7) / 3 : s->length;
		n = n < s->length - at ? n : s->length - at;
		if (s->is_chunked)
			send_chunk(fd, body + at, n);
		else
			send_all(fd, body + at, n);
		if (s->step > 0 && i % 16 == 0)
			usleep(500);
	}
	if (s->is_chunked)
		send_all(fd, "0\r\n\r\n", 5);
}

/* ---- receiving ---- */

/* Until the server closes. */
static char *read_all(int fd, size_t *length)
{
	size_t size = 1u << 20, got = 0;
	char *bytes = malloc(size + 1);
	ssize_t n;

	assert_non_null(bytes);
	while ((n = recv(fd, bytes + got, size - got, 0)) > 0) {
		got += (size_t)n;
		if (got < size)
			continue;
		bytes = realloc(bytes, 2 * size + 1);
		assert_non_null(bytes);
		size *= 2;
	}
	bytes[got] = '\0';
	*length = got;
	return bytes;
}

/* Puts the chunks at text together, in place; whether the last one is there. */
static bool join_chunks(char *text, size_t *length)
{
	char *out = text, *end = text + *length, *at = text;

	while (at < end) {
		char *line;
		size_t n = strtoul(at, &line, 16);

		if (line + 2 + n > end)
			break;
		if (n == 0) {
			*length = (size_t)(out - text);
			*out = '\0';
			return true;
		}
		memmove(out, line + 2, n);
		out += n;
		at = line + 2 + n + 2;
	}
	*length = (size_t)(out - text);
	return false;
}

static void parse_answer(struct answer *a, size_t length)
{
	const char *line;
	char *body = strstr(a->bytes, "\r\n\r\n");

	if (sscanf(a->bytes, "HTTP/1.1 %d", &a->status) != 1 &&
	    sscanf(a->bytes, "HTTP/1.0 %d", &a->status) != 1)
		fail_msg("no answer: %.200s", a->bytes);
	assert_non_null(body);
	body += 4;
	body[-1] = '\0';
	a->body = body;
	a->length = length - (size_t)(body - a->bytes);
	a->is_chunked = strstr(a->bytes, "Transfer-Encoding: chunked") != NULL;
	line = strstr(a->bytes, "Content-Length: ");
	a->is_whole = a->is_chunked ? join_chunks(body, &a->length) :
	    line == NULL || strtoul(line + 16, NULL, 10) == a->length;
}

static struct answer receive(int fd)
{
	struct answer a = {0};
	size_t length;

	a.bytes = read_all(fd, &length);
	close(fd);
	parse_answer(&a, length);
	return a;
}

/* With patience that ends, should the server's answer not. */
static int begin_head(void **state, const struct sending *s)
{
	const struct timeval patience = {.tv_sec = 60};
	int fd = http_connect(((const struct daemon *)*state)->port);

	assert_int_equal(setsockopt(fd, SOL_SOCKET, SO_RCVTIMEO, &patience,
	    sizeof patience), 0);
	send_head(fd, s);
	return fd;
}

static int begin(void **state, const struct sending *s)
{
	int fd = begin_head(state, s);

	send_body(fd, s);
	return fd;
}

static struct answer ask(void **state, const struct sending *s)
{
	return receive(begin(state, s));
}

/* Both are the same, and there is something to them. */
static void assert_same(struct answer *a, struct answer *b, int status)
{
	assert_int_equal(a->status, status);
	assert_int_equal(b->status, status);
	assert_true(a->is_whole && b->is_whole);
	assert_true(a->length > 20);
	assert_int_equal(a->length, b->length);
	assert_memory_equal(a->body, b->body, a->length);
	free(a->bytes);
	free(b->bytes);
}

/* What s gets whole, it gets in odd steps, and in odd chunks, too. */
static void check_steps(void **state, struct sending s, int status)
{
	static const size_t steps[] = {1, 5, 1000};

	for (size_t i = 0; i < 6; i++) {
		struct answer whole, other;

		s.step = 0;
		s.is_chunked = false;
		whole = ask(state, &s);
		s.step = steps[i / 2];
		s.is_chunked = i % 2 != 0;
		other = ask(state, &s);
		assert_same(&other, &whole, status);
	}
}

/* ---- bodies ---- */

/* {"points": [...]} of the first count points, for free. */
static char *points_json(size_t count, bool flat)
{
	char *text = malloc(64 * count + 64);
	size_t at = (size_t)sprintf(text, "{\"points\":[");

	for (size_t i = 0; i < count; i++)
		at += (size_t)sprintf(text + at, flat ? "%s%.9g,%.9g,%.9g" :
		    "%s[%.9g,%.9g,%.9g]", i > 0 ? "," : "",
		    (double)points[3 * i], (double)points[3 * i + 1],
		    (double)points[3 * i + 2]);
	strcpy(text + at, "]}");
	return text;
}

static void test_raw_points_in_odd_steps(void **state)
{
	check_steps(state, (struct sending){EVAL, OCTETS_IN OCTETS_OUT,
	    points, 12 * 101, 0, false, false}, 200);
}

static void test_npy_points_in_odd_steps(void **state)
{
	double wide[3 * 100];
	size_t length;
	char *file;

	for (int i = 0; i < 300; i++)
		wide[i] = (double)points[i];
	file = npy_file("<f8", "False", "(100, 3)", wide, sizeof wide,
	    &length);
	check_steps(state, (struct sending){EVAL, "Content-Type: "
	    "application/x-npy\r\n" NPY_OUT, file, length, 0, false, false},
	    200);
	free(file);
}

static void test_json_points_in_odd_steps(void **state)
{
	for (int flat = 0; flat < 2; flat++) {
		char *text = points_json(100, flat != 0);

		check_steps(state, (struct sending){EVAL, JSON_IN, text,
		    strlen(text), 0, false, false}, 200);
		free(text);
	}
}

static void test_scene_and_points_in_odd_steps(void **state)
{
	char text[2048];

	snprintf(text, sizeof text, "{\"outputs\" : [\"value\", \"normal\"], "
	    "\"points\":[[0.1,2e-1,3], [1,-0,0.25]],\n\"scene\":%s}", scene);
	check_steps(state, (struct sending){"/v1/eval", JSON_IN, text,
	    strlen(text), 0, false, false}, 200);
}

static void test_faults_in_odd_steps(void **state)
{
	static const char syntax[] = "{\"points\":[[1,2,3],[4,5,,6]]}";
	static const char range[] = "{\"points\":[[1,2,3],[4,5,1e39]],"
	    "\"outputs\":[\"nothing\"]}";
	float wrong[6] = {0, 0, 0, 0, 0, 0};

	check_steps(state, (struct sending){EVAL, JSON_IN, syntax,
	    sizeof syntax - 1, 0, false, false}, 400);
	check_steps(state, (struct sending){EVAL, JSON_IN, range,
	    sizeof range - 1, 0, false, false}, 422);
	check_steps(state, (struct sending){EVAL, OCTETS_IN, wrong, 23, 0,
	    false, false}, 400);
	((unsigned char *)wrong)[18] = 0x80; /* infinity */
	((unsigned char *)wrong)[19] = 0x7f;
	check_steps(state, (struct sending){EVAL, OCTETS_IN, wrong, 24, 0,
	    false, false}, 422);
}

/* The answer waits for the end of the body, of which nothing is kept. */
static void test_a_fault_early_in_a_long_body(void **state)
{
	char *text = points_json(LARGE, true);
	struct answer a;

	text[100] = 'x';
	a = ask(state, &(struct sending){EVAL, JSON_IN, text, strlen(text), 0,
	    false, false});
	assert_int_equal(a.status, 400);
	assert_true(a.is_whole);
	free(a.bytes);
	free(text);
}

/* So does that to a head that is refused. */
static void test_a_refused_head_of_a_long_body(void **state)
{
	static const struct {
		const char *path, *headers;
		int status;
	} cases[] = {
		{EVAL, "Content-Type: text/plain\r\n", 415},
		{EVAL, "", 415},
		{"/v1/eval", OCTETS_IN, 415},
		{EVAL, OCTETS_IN "Accept: text/html\r\n", 406},
		{EVAL "?outputs=nothing", OCTETS_IN, 422},
		{EVAL "?outputs=nothing", OCTETS_IN "Accept: text/html\r\n",
		    406},
		{"/v1/scenes/absent/eval", OCTETS_IN, 404},
		{EVAL, OCTETS_IN "If-Match: \"x\"\r\n", 412},
	};

	for (size_t i = 0; i < sizeof cases / sizeof *cases; i++) {
		struct answer a = ask(state, &(struct sending){cases[i].path,
		    cases[i].headers, points, 1200000, 0, i % 2 != 0, false});

		assert_int_equal(a.status, cases[i].status);
		assert_true(a.is_whole);
		free(a.bytes);
	}
}

/* ---- answers ---- */

static struct answer ask_large(void **state, const char *headers)
{
	return ask(state, &(struct sending){EVAL, headers, points,
	    12 * (size_t)LARGE, 0, false, false});
}

/* Fills rows: value and gradient, in parts that leave whole. */
static void make_rows(void **state)
{
	size_t part = (size_t)PART * ROW;

	rows = malloc(LARGE / PART * part * sizeof *rows);
	assert_non_null(rows);
	for (size_t i = 0; i < LARGE / PART; i++) {
		struct answer a = ask(state, &(struct sending){EVAL,
		    OCTETS_IN OCTETS_OUT, points + 3 * PART * i,
		    12 * (size_t)PART, 0, false, false});

		assert_int_equal(a.status, 200);
		assert_int_equal(a.length, part * sizeof *rows);
		memcpy(rows + part * i, a.body, a.length);
		free(a.bytes);
	}
}

static void test_large_raw_answer_is_that_of_its_parts(void **state)
{
	struct answer a = ask_large(state, OCTETS_IN OCTETS_OUT);

	assert_int_equal(a.status, 200);
	assert_false(a.is_chunked);
	assert_int_equal(a.length, LARGE * ROW * sizeof *rows);
	assert_memory_equal(a.body, rows, a.length);
	free(a.bytes);
}

static void test_large_npy_answer_is_that_of_its_parts(void **state)
{
	struct answer a = ask_large(state, OCTETS_IN NPY_OUT);
	size_t head;

	assert_int_equal(a.status, 200);
	head = 10 + (size_t)(unsigned char)a.body[8];
	assert_non_null(strstr(a.body + 10, "'shape': (300000, 4)"));
	assert_int_equal(a.length, head + LARGE * ROW * sizeof *rows);
	assert_memory_equal(a.body + head, rows, a.length - head);
	free(a.bytes);
}

/* Reads the next number of *text. */
static float next_number(const char **text)
{
	float number;
	char *end;

	*text += strcspn(*text, "-0123456789");
	number = strtof(*text, &end);

	assert_true(end > *text);
	*text = end;
	return number;
}

static void check_large_json(const struct answer *a)
{
	const char *value = strstr(a->body, "\"value\":[");
	const char *gradient = strstr(a->body, "\"gradient\":[[");

	assert_int_equal(a->status, 200);
	assert_true(a->is_whole);
	assert_true(strncmp(a->body, "{\"count\":300000,", 16) == 0);
	assert_string_equal(a->body + a->length - 3, "]]}");
	assert_non_null(value);
	assert_non_null(gradient);
	for (size_t i = 0; i < LARGE; i++) {
		assert_true(next_number(&value) == rows[ROW * i]);
		for (size_t j = 1; j < ROW; j++)
			assert_true(next_number(&gradient) ==
			    rows[ROW * i + j]);
	}
}

static void test_large_json_answer_is_that_of_its_parts(void **state)
{
	struct answer a = ask_large(state, OCTETS_IN);

	assert_true(a.is_chunked);
	check_large_json(&a);
	free(a.bytes);
}

static void test_large_answers_by_http_1_0(void **state)
{
	struct sending s = {EVAL, OCTETS_IN OCTETS_OUT, points,
	    12 * (size_t)LARGE, 0, false, true};
	struct answer raw = ask(state, &s), json;

	s.headers = OCTETS_IN;
	json = ask(state, &s);
	assert_int_equal(raw.length, LARGE * ROW * sizeof *rows);
	assert_memory_equal(raw.body, rows, raw.length);
	assert_false(json.is_chunked);
	check_large_json(&json);
	free(raw.bytes);
	free(json.bytes);
}

/* A connection goes on after a streamed answer. */
static void test_keep_alive_after_a_stream(void **state)
{
	const struct daemon *d = *state;
	size_t length = 12 * (size_t)LARGE;
	int fd = http_connect(d->port);
	char head[512];
	struct answer a;

	send_all(fd, head, (size_t)sprintf(head, "POST " EVAL " HTTP/1.1\r\n"
	    "Host: localhost\r\n" OCTETS_IN OCTETS_OUT "Content-Length: %zu\r\n\r\n",
	    length));
	send_all(fd, points, length);
	send_all(fd, head, (size_t)sprintf(head, "GET /healthz HTTP/1.1\r\n"
	    "Host: localhost\r\nConnection: close\r\n\r\n"));
	a = receive(fd);
	assert_int_equal(a.status, 200);
	assert_true(a.length > LARGE * ROW * sizeof(float));
	assert_memory_equal(a.body + LARGE * ROW * sizeof(float),
	    "HTTP/1.1 200", 12);
	free(a.bytes);
}

static void test_other_methods_of_the_evaluation_routes(void **state)
{
	const struct daemon *d = *state;
	static const char *const methods[] = {"GET", "HEAD", "PUT", "DELETE"};

	for (size_t i = 0; i < 4; i++) {
		struct http_reply reply;

		http_do(d->url, &(struct http_request){.method = methods[i],
		    .path = EVAL}, &reply);
		http_reply_fini(&reply);
		assert_int_equal(reply.status, 405);
	}
}

/* ---- readers ---- */

/* Processor time of the daemon, in ticks. */
static long ticks(const struct daemon *d)
{
	char path[64], line[1024] = "";
	long user = 0, kernel = 0;
	FILE *file;

	snprintf(path, sizeof path, "/proc/%d/stat", (int)d->pid);
	file = fopen(path, "r");
	assert_non_null(file);
	assert_non_null(fgets(line, sizeof line, file));
	fclose(file);
	assert_int_equal(sscanf(strrchr(line, ')'), ") %*c %*d %*d %*d %*d "
	    "%*d %*u %*u %*u %*u %*u %ld %ld", &user, &kernel), 2);
	return user + kernel;
}

static int begin_huge(void **state, const char *path)
{
	return begin(state, &(struct sending){path, OCTETS_IN OCTETS_OUT,
	    points, 12 * (size_t)HUGE_COUNT, 0, false, false});
}

static void await_input(int fd)
{
	struct pollfd poll_fd = {.fd = fd, .events = POLLIN};

	assert_int_equal(poll(&poll_fd, 1, 60000), 1);
}

/* The device waits for the reader, and nobody spins meanwhile. */
static void test_slow_reader(void **state)
{
	const struct daemon *d = *state;
	int fd = begin_huge(state, HUGE_PATH);
	struct answer a;
	long before, taken;
	int looks = 0;

	await_input(fd);
	/* Once the device has done what it may do ahead. */
	do {
		before = ticks(d);
		sleep(1);
		taken = ticks(d) - before;
	} while (taken >= sysconf(_SC_CLK_TCK) / 2 && ++looks < 30);
	assert_true(taken < sysconf(_SC_CLK_TCK) / 2);
	a = receive(fd);
	assert_int_equal(a.status, 200);
	assert_int_equal(a.length, HUGE_BYTES);
	free(a.bytes);
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

static void await_idle(void **state)
{
	for (int i = 0; i < 3000; i++) {
		if (figure(state, "\"waiting\":") == 0 &&
		    figure(state, "\"running\":") == 0)
			return;
		usleep(10000);
	}
	fail_msg("the queue does not get empty");
}

static void test_reader_that_hangs_up(void **state)
{
	long completed = figure(state, "\"completed\":");
	long evaluated = figure(state, "\"points\":");
	char some[1000];

	for (int i = 0; i < 3; i++) {
		int fd = begin_huge(state, HUGE_PATH);

		assert_true(recv(fd, some, sizeof some, 0) > 0);
		if (i % 2 == 0)
			usleep(200000);
		close(fd);
	}
	await_idle(state);
	assert_int_equal(figure(state, "\"completed\":"), completed + 3);
	assert_true(figure(state, "\"points\":") < evaluated +
	    3 * (long)HUGE_COUNT);
}

/* What began well ends short, for the client to see. */
static void test_deadline_in_the_middle_of_a_stream(void **state)
{
	int fd = begin_huge(state, HUGE_PATH "&deadline=2");
	struct answer a;

	await_input(fd);
	sleep(3);
	a = receive(fd);
	if (a.status != 504) { /* a machine so slow that it did not begin */
		assert_int_equal(a.status, 200);
		assert_false(a.is_whole);
		assert_true(a.length < HUGE_BYTES);
	}
	free(a.bytes);
	await_idle(state);
}

struct reader {
	pthread_t thread;
	void **state;
	size_t number;
	struct answer answer;
};

static void *read_large(void *arg)
{
	static const char *const headers[] = {OCTETS_IN OCTETS_OUT, OCTETS_IN};
	struct reader *r = arg;

	r->answer = ask_large(r->state, headers[r->number % 4 == 3]);
	return NULL;
}

static void test_many_streams_at_once(void **state)
{
	struct reader readers[STREAMS];

	for (size_t i = 0; i < STREAMS; i++) {
		readers[i] = (struct reader){.state = state, .number = i};
		assert_int_equal(pthread_create(&readers[i].thread, NULL,
		    read_large, &readers[i]), 0);
	}
	for (size_t i = 0; i < STREAMS; i++) {
		struct answer *a = &readers[i].answer;

		pthread_join(readers[i].thread, NULL);
		assert_int_equal(a->status, 200);
		if (i % 4 == 3)
			check_large_json(a);
		else
			assert_memory_equal(a->body, rows,
			    LARGE * ROW * sizeof *rows);
		free(a->bytes);
	}
}

static struct answer ask_with(void **state, const char *query)
{
	char path[256];

	snprintf(path, sizeof path, EVAL "%s", query);
	return ask(state, &(struct sending){path, OCTETS_IN, points, 120, 0,
	    false, false});
}

static void check_query(void **state, const char *query, int status,
    const char *says)
{
	struct answer a = ask_with(state, query);

	assert_int_equal(a.status, status);
	if (strstr(a.body, says) == NULL)
		fail_msg("'%s' is not in %s", says, a.body);
	free(a.bytes);
}

/* Waits until a figure of /v1/info is as given. */
static void await_figure(void **state, const char *name, long want)
{
	for (int i = 0; i < 3000; i++) {
		if (figure(state, name) == want)
			return;
		usleep(10000);
	}
	fail_msg("%s does not get to be %ld", name, want);
}

static void read_huge(int fd)
{
	struct answer a = receive(fd);

	assert_int_equal(a.status, 200);
	assert_int_equal(a.length, HUGE_BYTES);
	free(a.bytes);
}

/* Clients that do not read, more of them than there are places in the queue,
 * keep nobody from being served; what was held for them is given back. */
static void check_stalled(void **mine)
{
	int fds[STALLED];

	for (int i = 0; i < STALLED; i++) {
		fds[i] = begin_huge(mine, HUGE_PATH);
		await_input(fds[i]);
		await_figure(mine, "\"stalled\":", i + 1);
	}
	assert_int_equal(figure(mine, "\"running\":"), STALLED);
	/* Their points, and three pieces of 2 MiB each. */
	assert_int_equal(figure(mine, "\"held_bytes\":"), STALLED *
	    (12 * (long)HUGE_COUNT + (6 << 20)));
	for (int i = 0; i < 20; i++)
		check_query(mine, i % 2 == 0 ? "?priority=bulk" : "", 200,
		    "\"count\":10");
	assert_int_equal(figure(mine, "\"stalled\":"), STALLED);
	for (int i = 0; i < STALLED; i++) {
		if (i % 4 == 0)
			read_huge(fds[i]);
		else
			close(fds[i]);
	}
	await_figure(mine, "\"held_bytes\":", 0);
	assert_int_equal(figure(mine, "\"stalled\":"), 0);
	assert_int_equal(figure(mine, "\"running\":"), 0);
}

static void test_clients_that_do_not_read_keep_nobody_waiting(void **state)
{
	static const char *const arguments[] = {"--no-measure", "--queue",
	    PLACES, NULL};
	struct daemon *own = malloc(sizeof *own);
	void *mine = own;

	(void)state;
	daemon_start(own, arguments);
	daemon_await_ready(own);
	put_scene(own->url);
	check_stalled(&mine);
	assert_int_equal(daemon_stop(own, SIGTERM), 0);
	free(own);
}

/* Also JSON's, whose rows are there until the last of it has been read. */
static void test_answers_are_counted_until_they_have_left(void **state)
{
	int fd;

	await_figure(state, "\"held_bytes\":", 0);
	fd = begin(state, &(struct sending){HUGE_PATH, OCTETS_IN, points,
	    12 * (size_t)HUGE_COUNT, 0, false, false});
	await_input(fd);
	await_figure(state, "\"running\":", 0);
	assert_int_equal(figure(state, "\"held_bytes\":"), HUGE_BYTES);
	close(fd);
	await_figure(state, "\"held_bytes\":", 0);
	check_query(state, "", 200, "\"count\":10");
	await_figure(state, "\"held_bytes\":", 0);
}

/* ---- stopping ---- */

static void test_stopping_finishes_a_stream(void **state)
{
	static const char *const arguments[] = {"--no-measure", NULL};
	struct daemon *own = malloc(sizeof *own);
	void *mine = own;
	struct answer a;
	int fd;

	(void)state;
	daemon_start(own, arguments);
	daemon_await_ready(own);
	put_scene(own->url);
	fd = begin_huge(&mine, HUGE_PATH);
	await_input(fd);
	kill(own->pid, SIGTERM);
	usleep(300000);
	a = receive(fd);
	assert_int_equal(a.status, 200);
	assert_int_equal(a.length, HUGE_BYTES);
	free(a.bytes);
	assert_int_equal(daemon_stop(own, 0), 0);
	free(own);
}

/* ---- priority, deadline, timing ---- */

static void test_priorities(void **state)
{
	check_query(state, "?priority=bulk", 200, "\"count\":10");
	check_query(state, "?priority=interactive&outputs=value", 200,
	    "\"count\":10");
	check_query(state, "?priority=urgent", 422, "\"?priority\"");
	check_query(state, "?priority=", 422, "interactive or bulk");
	check_query(state, "?priority=bulk&priority=bulk", 400,
	    "more than one");
	check_query(state, "?prio=bulk", 400,
	    "known here: outputs priority deadline");
}

static void test_deadlines(void **state)
{
	check_query(state, "?deadline=60", 200, "\"count\":10");
	check_query(state, "?deadline=59.5", 200, "\"count\":10");
	check_query(state, "?deadline=1e-9", 504, "/problems/deadline");
	check_query(state, "?deadline=0", 422, "\"?deadline\"");
	check_query(state, "?deadline=-1", 422, "seconds above 0");
	check_query(state, "?deadline=", 422, "seconds above 0");
	check_query(state, "?deadline=soon", 422, "'soon'");
	check_query(state, "?deadline=1e999", 422, "seconds above 0");
	check_query(state, "?deadline=x&priority=y&outputs=z", 422,
	    "3 places are wrong");
}

/* It counts from the first byte. */
static void test_a_deadline_that_passes_while_the_body_arrives(void **state)
{
	struct sending s = {EVAL "?deadline=0.2", OCTETS_IN, points, 120, 0,
	    false, false};
	int fd = begin_head(state, &s);
	struct answer a;

	send_all(fd, points, 60);
	usleep(400000);
	send_all(fd, points, 60);
	a = receive(fd);
	assert_int_equal(a.status, 504);
	assert_non_null(strstr(a.body, "/problems/deadline"));
	free(a.bytes);
}

/* Behind others, which take longer than it has. */
static void test_a_deadline_that_passes_in_the_queue(void **state)
{
	int fd = begin_huge(state, HUGE_PATH "&priority=bulk");
	struct answer a = ask_with(state, "?deadline=0.00002&priority=bulk");

	assert_int_equal(a.status, 504);
	free(a.bytes);
	close(fd);
	await_idle(state);
}

static void test_answers_say_what_they_took(void **state)
{
	struct answer a = ask_with(state, "");
	const char *line = strstr(a.bytes, "Server-Timing: ");
	double queue = -1.0, device = -1.0;

	assert_non_null(line);
	assert_int_equal(sscanf(line, "Server-Timing: queue;dur=%lf, "
	    "device;dur=%lf", &queue, &device), 2);
	assert_true(queue >= 0.0 && device > 0.0);
	free(a.bytes);
}

static void test_info_has_limits_and_counters(void **state)
{
	assert_int_equal(figure(state, "\"interactive_points\":"), 65536);
	assert_int_equal(figure(state, "\"whole_answer\":"), 4 << 20);
	assert_true(figure(state, "\"launches\":") > 0);
	assert_true(figure(state, "\"batched\":") >= 0);
	assert_true(figure(state, "\"abandoned\":") >= 0);
}

static int setup(void **state)
{
	int failed = daemon_setup(state);

	points = malloc(3 * sizeof(float) * HUGE_COUNT);
	if (failed != 0 || points == NULL)
		return 1;
	for (size_t i = 0; i < 3 * (size_t)HUGE_COUNT; i++)
		points[i] = (float)(i * 7919 % 65536) / 32768.0f - 1.0f;
	put_scene(((const struct daemon *)*state)->url);
	make_rows(state);
	return 0;
}

int main(void)
{
	const struct CMUnitTest tests[] = {
		cmocka_unit_test(test_raw_points_in_odd_steps),
		cmocka_unit_test(test_npy_points_in_odd_steps),
		cmocka_unit_test(test_json_points_in_odd_steps),
		cmocka_unit_test(test_scene_and_points_in_odd_steps),
		cmocka_unit_test(test_faults_in_odd_steps),
		cmocka_unit_test(test_a_fault_early_in_a_long_body),
		cmocka_unit_test(test_a_refused_head_of_a_long_body),
		cmocka_unit_test(test_large_raw_answer_is_that_of_its_parts),
		cmocka_unit_test(test_large_npy_answer_is_that_of_its_parts),
		cmocka_unit_test(test_large_json_answer_is_that_of_its_parts),
		cmocka_unit_test(test_large_answers_by_http_1_0),
		cmocka_unit_test(test_keep_alive_after_a_stream),
		cmocka_unit_test(test_other_methods_of_the_evaluation_routes),
		cmocka_unit_test(test_slow_reader),
		cmocka_unit_test(test_reader_that_hangs_up),
		cmocka_unit_test(test_deadline_in_the_middle_of_a_stream),
		cmocka_unit_test(test_many_streams_at_once),
		cmocka_unit_test(
		    test_clients_that_do_not_read_keep_nobody_waiting),
		cmocka_unit_test(
		    test_answers_are_counted_until_they_have_left),
		cmocka_unit_test(test_stopping_finishes_a_stream),
		cmocka_unit_test(test_priorities),
		cmocka_unit_test(test_deadlines),
		cmocka_unit_test(
		    test_a_deadline_that_passes_while_the_body_arrives),
		cmocka_unit_test(test_a_deadline_that_passes_in_the_queue),
		cmocka_unit_test(test_answers_say_what_they_took),
		cmocka_unit_test(test_info_has_limits_and_counters),
	};

	return cmocka_run_group_tests(tests, setup, teardown);
}
