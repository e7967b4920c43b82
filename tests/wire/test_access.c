/*
 * Tokens on the wire: who is let in, to what, how much of it; reading the file
 * anew; public addresses.
 */
#include <stdarg.h>
#include <stddef.h>
#include <setjmp.h>
#include <stdint.h>
#include <cmocka.h>

#include <fcntl.h>
#include <limits.h>
#include <pthread.h>
#include <signal.h>
#include <stdatomic.h>
#include <stdbool.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <arpa/inet.h>
#include <sys/socket.h>
#include <sys/stat.h>
#include <sys/time.h>
#include <time.h>
#include <unistd.h>

#include "tests/support/daemon.h"
#include "tests/support/folder.h"
#include "tests/support/http.h"
#include "tests/support/sse.h"

#define BALL "{\"format\":\"blobfield/1\",\"root\":{\"type\":\"point\"," \
	"\"center\":[0,0,0],\"radius\":1}}"
#define EVAL "{\"scene\":" BALL ",\"points\":[[1,0,0]]}"

enum who {
	NOBODY,
	READER,
	EVALUATOR,
	WRITER,
	ADMIN,
	HASTY,  /* 2 requests a second */
	BUSY,   /* 1000 points a second */
	FAT,    /* 10000 bytes a second */
	HOARDER, /* 2 scenes */
	LARGE,   /* 100 points a second */
	BUILDER, /* 10000 points a second */
	DEEP,    /* 100 points a second */
	UPLOADER, /* 10000 bytes a second */
	WHO_COUNT
};

static const struct {
	const char *spec, *limits;
} people[WHO_COUNT] = {
	[READER] = {"reader:read", ""},
	[EVALUATOR] = {"evaluator:evaluate", ""},
	[WRITER] = {"writer:write", ""},
	[ADMIN] = {"admin:admin", ""},
	[HASTY] = {"hasty:admin", "\"requests_per_second\": 2"},
	[BUSY] = {"busy:write", "\"points_per_second\": 1000"},
	[FAT] = {"fat:write", "\"bytes_per_second\": 10000"},
	[HOARDER] = {"hoarder:write", "\"scenes\": 2"},
	[LARGE] = {"large:evaluate", "\"points_per_second\": 100"},
	[DEEP] = {"deep:evaluate", "\"points_per_second\": 100"},
	[UPLOADER] = {"uploader:write", "\"bytes_per_second\": 10000"},
	[BUILDER] = {"builder:write", "\"points_per_second\": 10000"},
};

struct place {
	struct daemon daemon;
	char folder[PATH_MAX], file[PATH_MAX + 8];
	char headers[WHO_COUNT][80]; /* Authorization */
	char entries[WHO_COUNT][400];
};

static void write_text(const char *path, const char *text, mode_t mode)
{
	FILE *file = fopen(path, "w");

	assert_non_null(file);
	fputs(text, file);
	assert_int_equal(fclose(file), 0);
	assert_int_equal(chmod(path, mode), 0);
}

/* --make-token's two lines. */
static void make_token(struct place *p, enum who who)
{
	char output[1024], option[100];
	const char *const arguments[] = {"--make-token", people[who].spec,
	    NULL};
	char *entry;

	assert_int_equal(daemon_run(arguments, output, sizeof output), 0);
	/* stdout and stderr are one here. */
	entry = strstr(output, "bf_");
	assert_non_null(entry);
	assert_int_equal(strspn(entry + 3, "abcdefghijklmnopqrstuvwxyz234567"),
	    32);
	snprintf(p->headers[who], sizeof p->headers[who],
	    "Authorization: Bearer %.35s", entry);
	entry = strchr(entry, '{');
	assert_non_null(entry);
	*strchr(entry, '}') = '\0';
	snprintf(option, sizeof option, people[who].limits[0] != '\0' ?
	    ", \"limits\": {%s}}" : "}", people[who].limits);
	snprintf(p->entries[who], sizeof p->entries[who], "%.300s%s", entry,
	    option);
}

/* A file of all but NOBODY, with more entries. */
static void write_file(struct place *p, const char *more)
{
	char text[WHO_COUNT * 420 + 400] = "{\"tokens\": [";

	for (int i = READER; i < WHO_COUNT; i++) {
		strcat(text, i > READER ? ",\n" : "");
		strcat(text, p->entries[i]);
	}
	strcat(text, more);
	strcat(text, "]}");
	write_text(p->file, text, 0600);
}

static int setup(void **state)
{
	struct place *p = calloc(1, sizeof *p);
	const char *arguments[] = {"--no-measure", "--max-listeners", "8",
	    "--tokens", NULL, NULL};

	assert_non_null(p);
	folder_make(p->folder);
	snprintf(p->file, sizeof p->file, "%s/tokens", p->folder);
	for (int i = READER; i < WHO_COUNT; i++)
		make_token(p, (enum who)i);
	write_file(p, "");
	arguments[4] = p->file;
	daemon_start(&p->daemon, arguments);
	daemon_await_ready(&p->daemon);
	*state = p;
	return 0;
}

static int teardown(void **state)
{
	struct place *p = *state;
	int status = daemon_stop(&p->daemon, SIGTERM);

	folder_remove(p->folder);
	free(p);
	return status;
}

/* One request of who's; type NULL: JSON. The status. */
static long ask(struct place *p, enum who who, const char *method,
    const char *path, const char *body, struct http_reply *reply)
{
	struct http_request request = {.method = method, .path = path,
	    .body = body, .length = body != NULL ? strlen(body) : 0};
	struct http_reply own;
	long status;
	int n = 0;

	if (body != NULL)
		request.headers[n++] = "Content-Type: application/json";
	if (who != NOBODY)
		request.headers[n++] = p->headers[who];
	http_do(p->daemon.url, &request, reply != NULL ? reply : &own);
	status = reply != NULL ? reply->status : own.status;
	if (reply == NULL)
		http_reply_fini(&own);
	return status;
}

static void assert_header(const struct http_reply *reply, const char *name,
    const char *expected)
{
	char value[256];

	assert_string_equal(http_header(reply, name, value, sizeof value),
	    expected);
}

static void assert_says(const struct http_reply *reply, const char *says)
{
	if (strstr(reply->body, says) == NULL)
		fail_msg("'%s' is not in %s", says, reply->body);
}

/* ---- who ---- */

static void test_open_paths_need_no_token(void **state)
{
	static const char *const paths[] = {"/", "/healthz", "/readyz",
	    "/openapi.json", "/web/app.js"};

	for (size_t i = 0; i < sizeof paths / sizeof *paths; i++)
		assert_int_equal(ask(*state, NOBODY, "GET", paths[i], NULL,
		    NULL), 200);
	assert_int_equal(ask(*state, NOBODY, "OPTIONS", "/v1/scenes", NULL,
	    NULL), 204);
}

static void test_unknown_path_is_404_without_token(void **state)
{
	/* The routes are public; what is behind them is not. */
	assert_int_equal(ask(*state, NOBODY, "GET", "/v2", NULL, NULL), 404);
	assert_int_equal(ask(*state, NOBODY, "PUT", "/v1/info", BALL, NULL),
	    405);
	assert_int_equal(ask(*state, NOBODY, "GET", "/v1/scenes/none", NULL,
	    NULL), 401);
}

static void test_without_token_401_with_challenge(void **state)
{
	struct http_reply reply;

	assert_int_equal(ask(*state, NOBODY, "GET", "/v1/info", NULL, &reply),
	    401);
	assert_header(&reply, "WWW-Authenticate",
	    "Bearer realm=\"blobfield\"");
	assert_says(&reply, "/problems/unauthorized");
	assert_says(&reply, "'read'");
	http_reply_fini(&reply);
}

static void assert_invalid(struct place *p, const char *header,
    const char *challenge)
{
	const struct http_request request = {.path = "/v1/info",
	    .headers = {header}};
	struct http_reply reply;

	http_do(p->daemon.url, &request, &reply);
	assert_int_equal(reply.status, 401);
	assert_header(&reply, "WWW-Authenticate", challenge);
	http_reply_fini(&reply);
}

static void test_wrong_tokens_are_401(void **state)
{
	static const char unknown[] =
	    "Bearer realm=\"blobfield\", error=\"invalid_token\"";
	static const char broken[] =
	    "Bearer realm=\"blobfield\", error=\"invalid_request\"";
	struct place *p = *state;
	char longer[100];

	assert_invalid(p, "Authorization: Bearer x", unknown);
	snprintf(longer, sizeof longer, "%sa", p->headers[ADMIN]);
	assert_invalid(p, longer, unknown);
	longer[strlen(longer) - 2] = '\0';
	assert_invalid(p, longer, unknown);
	assert_invalid(p, "Authorization: Basic YTpi", broken);
	assert_invalid(p, "Authorization: Bearer", broken);
	assert_invalid(p, "Authorization: Bearer a b", broken);
	assert_invalid(p, "Authorization: Bearera", broken);
}

static void test_two_authorizations_are_401(void **state)
{
	struct place *p = *state;
	char text[400], reply[4096];

	snprintf(text, sizeof text, "GET /v1/info HTTP/1.1\r\nHost: localhost\r\n"
	    "%s\r\n%s\r\nConnection: close\r\n\r\n", p->headers[ADMIN],
	    p->headers[READER]);
	assert_int_equal(http_raw(p->daemon.port, text, strlen(text), reply,
	    sizeof reply), 401);
}

static void test_scheme_is_of_any_case(void **state)
{
	struct place *p = *state;
	char header[100];
	const struct http_request request = {.path = "/v1/info",
	    .headers = {header}};
	struct http_reply reply;

	snprintf(header, sizeof header, "authorization: bEARER %s",
	    strstr(p->headers[READER], "bf_"));
	http_do(p->daemon.url, &request, &reply);
	assert_int_equal(reply.status, 200);
	http_reply_fini(&reply);
}

/* ---- roles ---- */

static void test_each_role_may_what_it_says(void **state)
{
	static const struct {
		const char *method, *path, *body;
		enum who least;
		long status;
	} cases[] = {
		{"PUT", "/v1/scenes/roles", BALL, WRITER, 201},
		{"GET", "/v1/scenes/roles", NULL, READER, 200},
		{"HEAD", "/v1/scenes/roles", NULL, READER, 200},
		{"GET", "/v1/scenes", NULL, READER, 200},
		{"GET", "/metrics", NULL, READER, 0},
		{"POST", "/v1/eval", EVAL, EVALUATOR, 200},
		{"POST", "/v1/scenes/roles/eval", "{\"points\":[[0,0,0]]}",
		    EVALUATOR, 200},
		{"POST", "/v1/scenes/roles/mesh", "{\"resolution\":8}",
		    EVALUATOR, 200},
		{"GET", "/v1/tokens", NULL, ADMIN, 200},
		{"DELETE", "/v1/scenes/roles", NULL, WRITER, 204},
	};

	for (size_t i = 0; i < sizeof cases / sizeof *cases; i++) {
		for (int who = NOBODY; who <= (int)cases[i].least; who++) {
			long status = ask(*state, (enum who)who,
			    cases[i].method, cases[i].path, cases[i].body,
			    NULL);
			long expected = who == NOBODY ? 401 :
			    who < (int)cases[i].least ? 403 : cases[i].status;

			if (expected > 0 && status != expected)
				fail_msg("%s %s by %d: %ld, not %ld",
				    cases[i].method, cases[i].path, who,
				    status, expected);
		}
	}
}

static void test_forbidden_names_the_roles(void **state)
{
	struct http_reply reply;

	assert_int_equal(ask(*state, READER, "DELETE", "/v1/scenes/a", NULL,
	    &reply), 403);
	assert_says(&reply, "/problems/forbidden");
	assert_says(&reply, "'reader' has the role 'read'; this needs "
	    "'write'");
	assert_header(&reply, "WWW-Authenticate", "Bearer realm=\"blobfield\""
	    ", error=\"insufficient_scope\", scope=\"write\"");
	http_reply_fini(&reply);
}

static void test_refused_before_the_body_is_sent(void **state)
{
	/* 100 MB are promised, nothing comes: answered all the same. */
	static const char text[] = "PUT /v1/scenes/a HTTP/1.1\r\nHost: localhost\r\n"
	    "Content-Type: application/json\r\nContent-Length: 100000000\r\n"
	    "\r\n{";
	struct place *p = *state;
	char reply[4096];

	assert_int_equal(http_raw(p->daemon.port, text, sizeof text - 1,
	    reply, sizeof reply), 401);
}

/* ---- limits ---- */

/* The whole seconds of Retry-After. */
static int retry_after(const struct http_reply *reply)
{
	char value[64], *end;
	long seconds = strtol(http_header(reply, "Retry-After", value,
	    sizeof value), &end, 10);

	if (*end != '\0' || end == value || seconds < 1)
		fail_msg("Retry-After is '%s'", value);
	return (int)seconds;
}

static void sleep_for(double seconds)
{
	const struct timespec time = {(time_t)seconds,
	    (long)(1e9 * (seconds - (double)(time_t)seconds))};

	nanosleep(&time, NULL);
}

/* Requests in one breath, so that hardly any time passes between them; how many
 * are answered with 200, and not 429. */
static int count_at_once(struct place *p, enum who who)
{
	enum { COUNT = 40, SIZE = 1 << 18 };
	char *text = malloc(COUNT * 256), *reply = malloc(SIZE), *at = text;
	int good = 0, refused = 0;

	for (int i = 0; i < COUNT; i++)
		at += snprintf(at, 256, "GET /v1/info HTTP/1.1\r\nHost: h\r\n"
		    "%s\r\n%s\r\n", p->headers[who], i == COUNT - 1 ?
		    "Connection: close\r\n" : "");
	http_raw(p->daemon.port, text, (size_t)(at - text), reply, SIZE);
	for (at = reply; (at = strstr(at, "HTTP/1.1 ")) != NULL; at += 9) {
		good += strncmp(at + 9, "200", 3) == 0;
		refused += strncmp(at + 9, "429", 3) == 0;
	}
	assert_int_equal(good + refused, COUNT);
	free(text);
	free(reply);
	return good;
}

static void test_requests_a_second(void **state)
{
	struct http_reply reply;
	int good = count_at_once(*state, HASTY);

	while (ask(*state, HASTY, "GET", "/v1/info", NULL, &reply) == 200)
		http_reply_fini(&reply);
	print_message("measured: %d requests at once of 2 a second\n", good);
	assert_in_range(good, 2, 10);
	assert_int_equal(reply.status, 429);
	assert_says(&reply, "/problems/too-many-requests");
	assert_says(&reply, "requests_per_second 2");
	assert_int_equal(retry_after(&reply), 1);
	http_reply_fini(&reply);
	/* Others are not held up, and what it says is true. */
	assert_int_equal(ask(*state, READER, "GET", "/v1/info", NULL, NULL),
	    200);
	sleep_for(1.0);
	assert_int_equal(ask(*state, HASTY, "GET", "/v1/info", NULL, NULL),
	    200);
}

static void test_points_a_second_are_a_debt(void **state)
{
	enum {POINTS = 5000};
	struct place *p = *state;
	float *points = calloc(POINTS, 12);
	const struct http_request request = {
		.path = "/v1/scenes/debt/eval?outputs=value", .body = points,
		.length = POINTS * 12,
		.headers = {"Content-Type: application/octet-stream",
		    p->headers[BUSY]}};
	struct http_reply reply;
	int seconds;

	assert_int_equal(ask(p, WRITER, "PUT", "/v1/scenes/debt", BALL, NULL),
	    201);
	/* Five seconds' worth, on credit. */
	http_do(p->daemon.url, &request, &reply);
	assert_int_equal(reply.status, 200);
	http_reply_fini(&reply);
	http_do(p->daemon.url, &request, &reply);
	assert_int_equal(reply.status, 429);
	assert_says(&reply, "points_per_second 1000");
	seconds = retry_after(&reply);
	assert_in_range(seconds, 1, 4);
	http_reply_fini(&reply);
	/* What takes no points goes on; tasks do not. */
	assert_int_equal(ask(p, BUSY, "GET", "/v1/info", NULL, NULL), 200);
	assert_int_equal(ask(p, BUSY, "POST", "/v1/scenes/debt/mesh",
	    "{\"resolution\":8}", NULL), 429);
	sleep_for(seconds);
	/* A mesh is charged what was evaluated for it, after. */
	assert_int_equal(ask(p, BUSY, "POST", "/v1/scenes/debt/mesh",
	    "{\"resolution\":64}", NULL), 200);
	assert_int_equal(ask(p, BUSY, "POST", "/v1/scenes/debt/mesh",
	    "{\"resolution\":8}", &reply), 429);
	print_message("measured: a mesh of 64 cells is %d s of 1000 points a "
	    "second\n", retry_after(&reply));
	assert_true(retry_after(&reply) > 3);
	http_reply_fini(&reply);
	free(points);
}

/* The answer to so many points of a point, raw. */
static void evaluate_raw(struct place *p, enum who who, size_t count,
    struct http_reply *reply)
{
	float *points = calloc(count, 12);
	const struct http_request request = {
		.path = "/v1/scenes/raw/eval?outputs=value", .body = points,
		.length = count * 12,
		.headers = {"Content-Type: application/octet-stream",
		    p->headers[who]}};

	assert_non_null(points);
	http_do(p->daemon.url, &request, reply);
	free(points);
}

static void test_debt_is_a_minute_at_most(void **state)
{
	struct place *p = *state;
	struct http_reply reply;

	assert_int_equal(ask(p, WRITER, "PUT", "/v1/scenes/raw", BALL, NULL),
	    201);
	/* More than an hour of 100 a second: no matter of waiting. */
	evaluate_raw(p, DEEP, 360001, &reply);
	assert_int_equal(reply.status, 422);
	assert_says(&reply, "/problems/limit");
	assert_says(&reply, "more than 'deep' may take in an hour");
	http_reply_fini(&reply);
	/* 500 s' worth, on credit. */
	evaluate_raw(p, DEEP, 50000, &reply);
	assert_int_equal(reply.status, 200);
	http_reply_fini(&reply);
	evaluate_raw(p, DEEP, 1, &reply);
	assert_int_equal(reply.status, 429);
	assert_in_range(retry_after(&reply), 50, 60);
	http_reply_fini(&reply);
}

static void test_points_of_large_documents_count_more(void **state)
{
	char *text = malloc(200 * 90 + 400);
	struct http_reply reply;
	int n = sprintf(text, "{\"scene\":{\"format\":\"blobfield/1\","
	    "\"root\":{\"type\":\"sum\",\"children\":[");

	for (int i = 0; i < 200; i++)
		n += sprintf(text + n, "%s{\"type\":\"point\",\"center\":"
		    "[0,0,%d],\"radius\":1}", i > 0 ? "," : "", i);
	n += sprintf(text + n, "]}},\"points\":[");
	for (int i = 0; i < 200; i++)
		n += sprintf(text + n, "%s[0,0,0]", i > 0 ? "," : "");
	sprintf(text + n, "]}");
	/* 201 nodes: each point is 1 + 3; 200 points 800 of 100 a second. */
	assert_int_equal(ask(*state, LARGE, "POST", "/v1/eval", text, NULL),
	    200);
	assert_int_equal(ask(*state, LARGE, "POST", "/v1/eval", text, &reply),
	    429);
	assert_true(retry_after(&reply) == 7);
	http_reply_fini(&reply);
	free(text);
}

static void test_tables_to_be_built_are_points_too(void **state)
{
	static const char text[] = "{\"scene\":{\"format\":\"blobfield/1\","
	    "\"root\":{\"type\":\"union\",\"operator\":{\"resolution\":24,"
	    "\"profile\":{\"type\":\"bulge\",\"k\":0.3456}},\"children\":["
	    "{\"type\":\"point\",\"center\":[0,0,0],\"radius\":1},"
	    "{\"type\":\"point\",\"center\":[1,0,0],\"radius\":1}]}},"
	    "\"points\":[[1,0,0]]}";
	struct http_reply reply;
	int seconds;

	assert_int_equal(ask(*state, BUILDER, "POST", "/v1/eval", text, NULL),
	    200);
	assert_int_equal(ask(*state, BUILDER, "POST", "/v1/eval", text,
	    &reply), 429);
	seconds = retry_after(&reply);
	print_message("measured: a table of 24 nodes is %d s of 10000 points "
	    "a second\n", seconds);
	/* 16 * 24^3 points, less a second's and what has passed. */
	assert_in_range(seconds, 2, 22);
	http_reply_fini(&reply);
	/* For others it is there now. */
	assert_int_equal(ask(*state, EVALUATOR, "POST", "/v1/eval", text,
	    NULL), 200);
	/* An order is charged as well. */
	assert_int_equal(ask(*state, BUILDER, "POST", "/v1/operators",
	    "{\"resolution\": 8}", NULL), 429);
}

static void test_bytes_a_second_count_both_ways(void **state)
{
	static const char text[] = "{\"points\":[[0,0,0]]}";
	struct http_reply reply;
	char *body = malloc(30001);
	int status = 0;

	/* 30000 bytes of a document: 3 s. */
	memset(body, ' ', 30000);
	body[30000] = '\0';
	memcpy(body, BALL, sizeof BALL - 1);
	assert_int_equal(ask(*state, FAT, "PUT", "/v1/scenes/fat", body,
	    NULL), 201);
	assert_int_equal(ask(*state, FAT, "POST", "/v1/scenes/fat/eval", text,
	    &reply), 429);
	assert_says(&reply, "bytes_per_second 10000");
	/* Less what has passed since. */
	assert_in_range(retry_after(&reply), 1, 3);
	http_reply_fini(&reply);
	sleep_for(3.0);
	/* Now the answer is as large. */
	assert_int_equal(ask(*state, FAT, "GET", "/v1/scenes/fat", NULL,
	    NULL), 200);
	/* Charged when it has left. */
	for (int i = 0; i < 100 && status != 429; i++) {
		status = ask(*state, FAT, "GET", "/v1/info", NULL, NULL);
		usleep(10000);
	}
	assert_int_equal(status, 429);
	free(body);
}

static void test_scenes_of_an_owner(void **state)
{
	struct place *p = *state;
	struct http_reply reply;

	assert_int_equal(ask(p, HOARDER, "PUT", "/v1/scenes/h1", BALL, NULL),
	    201);
	assert_int_equal(ask(p, HOARDER, "PUT", "/v1/scenes/h2", BALL, NULL),
	    201);
	assert_int_equal(ask(p, HOARDER, "PUT", "/v1/scenes/h3", BALL,
	    &reply), 507);
	assert_says(&reply, "/problems/store-full");
	http_reply_fini(&reply);
	assert_int_equal(ask(p, HOARDER, "PUT", "/v1/scenes/h2", BALL " ",
	    NULL), 200);
	assert_int_equal(ask(p, WRITER, "PUT", "/v1/scenes/h3", BALL, NULL),
	    201);
	assert_int_equal(ask(p, HOARDER, "DELETE", "/v1/scenes/h1", NULL,
	    NULL), 204);
	assert_int_equal(ask(p, HOARDER, "PUT", "/v1/scenes/h4", BALL, NULL),
	    201);
}

static void test_tokens_are_listed_without_secrets(void **state)
{
	struct place *p = *state;
	struct http_reply reply;

	assert_int_equal(ask(p, ADMIN, "GET", "/v1/tokens", NULL, &reply),
	    200);
	assert_says(&reply, "{\"name\":\"busy\",\"role\":\"write\","
	    "\"limits\":{\"points_per_second\":1000},\"used\":{\"requests\":");
	assert_null(strstr(reply.body, "bf_"));
	assert_null(strstr(reply.body, "sha256"));
	for (int i = READER; i < WHO_COUNT; i++)
		assert_null(strstr(reply.body, strstr(p->headers[i], "bf_") +
		    3));
	http_reply_fini(&reply);
}

/* ---- reading the file anew ---- */

/* Until who gets status, for some seconds. */
static void await_status(struct place *p, enum who who, const char *path,
    long status)
{
	for (int i = 0; i < 300; i++) {
		if (ask(p, who, "GET", path, NULL, NULL) == status)
			return;
		sleep_for(0.02);
	}
	fail_msg("%s does not get %ld", path, status);
}

static void test_reload(void **state)
{
	struct place *p = *state;

	write_file(p, ",{\"name\": \"anonymous\", \"role\": \"read\"}");
	kill(p->daemon.pid, SIGHUP);
	await_status(p, NOBODY, "/v1/info", 200);
	/* More than it may: a token would help. */
	assert_int_equal(ask(p, NOBODY, "POST", "/v1/eval", EVAL, NULL), 401);
	/* A wrong token is not nobody. */
	assert_invalid(p, "Authorization: Bearer x",
	    "Bearer realm=\"blobfield\", error=\"invalid_token\"");
	/* A wrong file changes nothing. */
	write_text(p->file, "{\"tokens\": 1}", 0600);
	kill(p->daemon.pid, SIGHUP);
	sleep_for(0.3);
	assert_int_equal(ask(p, ADMIN, "GET", "/v1/tokens", NULL, NULL), 200);
	/* One that others may write is not believed. */
	write_file(p, "");
	assert_int_equal(chmod(p->file, 0620), 0);
	kill(p->daemon.pid, SIGHUP);
	sleep_for(0.3);
	assert_int_equal(ask(p, NOBODY, "GET", "/v1/info", NULL, NULL), 200);
	assert_int_equal(chmod(p->file, 0600), 0);
	kill(p->daemon.pid, SIGHUP);
	await_status(p, NOBODY, "/v1/info", 401);
	assert_int_equal(ask(p, READER, "GET", "/v1/info", NULL, NULL), 200);
}

struct asker {
	pthread_t thread;
	struct place *place;
	atomic_bool *is_over;
	long asked, refused;
};

static void *ask_on(void *ctx)
{
	struct asker *a = ctx;

	while (!atomic_load(a->is_over)) {
		a->refused += ask(a->place, READER, "GET", "/v1/info", NULL,
		    NULL) != 200;
		a->asked++;
	}
	return NULL;
}

static void test_reload_amid_requests(void **state)
{
	enum {ASKERS = 4, RELOADS = 60};
	struct place *p = *state;
	struct asker askers[ASKERS];
	atomic_bool is_over = false;
	long asked = 0, refused = 0;

	for (int i = 0; i < ASKERS; i++) {
		askers[i] = (struct asker){.place = p, .is_over = &is_over};
		assert_int_equal(pthread_create(&askers[i].thread, NULL,
		    ask_on, &askers[i]), 0);
	}
	for (int i = 0; i < RELOADS; i++) {
		write_file(p, i % 2 == 0 ?
		    ",{\"name\": \"anonymous\", \"role\": \"read\"}" : "");
		kill(p->daemon.pid, SIGHUP);
		sleep_for(0.02);
	}
	atomic_store(&is_over, true);
	for (int i = 0; i < ASKERS; i++) {
		pthread_join(askers[i].thread, NULL);
		asked += askers[i].asked;
		refused += askers[i].refused;
	}
	print_message("measured: %ld requests amid %d reloads, %ld refused\n",
	    asked, RELOADS, refused);
	assert_int_equal(refused, 0);
	assert_true(asked > ASKERS);
}

/* ---- addresses, listeners ---- */

/* A connection from 127.0.0.host. */
static int connect_from(const struct daemon *d, int host)
{
	struct sockaddr_in address = {.sin_family = AF_INET,
	    .sin_addr.s_addr = htonl(INADDR_LOOPBACK - 1 + (uint32_t)host)};
	const struct timeval patience = {.tv_sec = 10};
	const int s = socket(AF_INET, SOCK_STREAM, 0);

	assert_int_equal(bind(s, (void *)&address, sizeof address), 0);
	address.sin_addr.s_addr = htonl(INADDR_LOOPBACK);
	address.sin_port = htons((uint16_t)d->port);
	setsockopt(s, SOL_SOCKET, SO_RCVTIMEO, &patience, sizeof patience);
	assert_int_equal(connect(s, (void *)&address, sizeof address), 0);
	return s;
}

/* The status of a request without token that comes from there; 0: it is not
 * answered. */
static int ask_from(const struct daemon *d, int host, const char *head)
{
	const int s = connect_from(d, host);
	char text[512];
	ssize_t n;
	int status = 0;

	n = snprintf(text, sizeof text, "%s HTTP/1.1\r\nHost: localhost\r\n"
	    "Connection: close\r\n\r\n", head);
	assert_int_equal(send(s, text, (size_t)n, 0), n);
	n = recv(s, text, sizeof text - 1, 0);
	text[n > 0 ? n : 0] = '\0';
	sscanf(text, "HTTP/1.1 %d", &status);
	close(s);
	return status;
}

static void test_strangers_are_limited_by_address(void **state)
{
	struct place *p = *state;
	int refused = 0;

	if (getenv("BLOBFIELD_PROXY") != NULL) {
		printf("skipped: behind a proxy all have its address\n");
		skip();
	}
	write_file(p, ",{\"name\": \"anonymous\", \"role\": \"read\", "
	    "\"limits\": {\"requests_per_second\": 0.01}}");
	kill(p->daemon.pid, SIGHUP);
	await_status(p, NOBODY, "/v1/info", 200);
	await_status(p, NOBODY, "/v1/info", 429);
	for (int host = 2; host < 12; host++)
		refused += ask_from(&p->daemon, host, "GET /v1/info") != 200;
	/* Two that share a place of 1024: at most one of ten, but by a chance of
	 * 1e-3 there are more. */
	assert_true(refused <= 2);
	/* As long as anything is left, one more can be had. */
	ask_from(&p->daemon, 2, "GET /v1/info");
	assert_int_equal(ask_from(&p->daemon, 2, "GET /v1/info"), 429);
	assert_int_equal(ask(p, READER, "GET", "/v1/info", NULL, NULL), 200);
	write_file(p, "");
	kill(p->daemon.pid, SIGHUP);
	await_status(p, NOBODY, "/v1/info", 401);
}

static void test_paths_with_odd_escapes_are_404(void **state)
{
	static const char *const paths[] = {"GET /%68ealthz", "GET /v1%2finfo",
	    "GET /v1%2Finfo", "GET /web/app%2ejs", "GET /healthz%7E"};
	struct place *p = *state;

	for (size_t i = 0; i < sizeof paths / sizeof *paths; i++)
		if (ask_from(&p->daemon, 1, paths[i]) != 404)
			fail_msg("%s is not 404", paths[i]);
	/* In a query they are as ever. */
	assert_int_equal(ask_from(&p->daemon, 1, "GET /healthz?%61=%2f"), 400);
	assert_int_equal(ask_from(&p->daemon, 1,
	    "GET https://x.example/healthz"), 200);
}

static void test_an_upload_that_does_not_end_counts(void **state)
{
	enum {LENGTH = 300000};
	struct place *p = *state;
	char *text = calloc(1, LENGTH);
	const int s = connect_from(&p->daemon, 1);
	long status = 0;

	assert_non_null(text);
	memset(text, ' ', LENGTH);
	text[snprintf(text, LENGTH, "PUT /v1/scenes/u HTTP/1.1\r\nHost: localhost\r\n"
	    "%s\r\nContent-Type: application/json\r\n"
	    "Content-Length: 10000000\r\n\r\n", p->headers[UPLOADER])] = ' ';
	assert_int_equal(send(s, text, LENGTH, 0), LENGTH);
	sleep_for(0.2);
	close(s);
	/* 404s have 200 bytes. */
	for (int i = 0; i < 10 && status != 429; i++) {
		status = ask(p, UPLOADER, "GET", "/v1/scenes/none", NULL,
		    NULL);
		sleep_for(0.1);
	}
	assert_int_equal(status, 429);
	free(text);
}

static void test_a_token_has_a_quarter_of_the_listeners(void **state)
{
	struct place *p = *state;
	const struct daemon d = p->daemon;
	struct sse s[4];
	struct sse_event event;
	char header[100], text[100], *digit, was;
	enum sse_outcome outcome;

	/* Of 8, two. */
	assert_int_equal(ask(p, WRITER, "PUT", "/v1/scenes/heard", BALL, NULL),
	    201);
	snprintf(header, sizeof header, "%s\r\n", p->headers[READER]);
	assert_true(sse_open(&s[0], d.port, "/v1/scenes/heard/events", header));
	assert_true(sse_open(&s[1], d.port, "/v1/scenes/heard/events", header));
	assert_false(sse_open(&s[2], d.port, "/v1/scenes/heard/events", header));
	assert_int_equal(s[2].status, 429);
	snprintf(text, sizeof text, "%s\r\n", p->headers[EVALUATOR]);
	assert_true(sse_open(&s[3], d.port, "/v1/scenes/heard/events", text));
	/* A token that is taken away has its streams end. */
	digit = strrchr(p->entries[READER], '"') - 1;
	was = *digit;
	*digit = was == '0' ? '1' : '0';
	write_file(p, "");
	kill(d.pid, SIGHUP);
	while ((outcome = sse_next(&s[0], &event, 5000)) == SSE_EVENT)
		;
	assert_int_equal(outcome, SSE_END);
	while ((outcome = sse_next(&s[3], &event, 100)) == SSE_EVENT)
		;
	assert_int_equal(outcome, SSE_NOTHING);
	*digit = was;
	write_file(p, "");
	kill(d.pid, SIGHUP);
	await_status(p, READER, "/v1/info", 200);
	for (int i = 0; i < 4; i++)
		sse_close(&s[i]);
}

/* ---- starting ---- */

static void assert_refuses(const char *const *arguments, const char *says)
{
	char output[8192];

	/* A restart mends nothing. */
	assert_int_equal(daemon_run(arguments, output, sizeof output), 2);
	if (strstr(output, says) == NULL)
		fail_msg("'%s' is not in: %s", says, output);
}

static void test_public_address_without_tokens_is_refused(void **state)
{
	static const char *const hosts[] = {"0.0.0.0:0", "[::]:0"};

	(void)state;
	for (int i = 0; i < 2; i++)
		assert_refuses((const char *const[]){"--listen", hosts[i],
		    NULL}, "is a public address, and there are no tokens");
}

static void test_public_address_with_strangers_who_write_is_refused(
    void **state)
{
	struct place *p = *state;
	const char *arguments[] = {"--listen", "0.0.0.0:0", "--tokens", p->file,
	    "--device", "none such", NULL, NULL};
	char output[8192];

	write_file(p, ",{\"name\": \"anonymous\", \"role\": \"write\"}");
	assert_refuses(arguments, "\"anonymous\" has the role \"write\"");
	/* Else it is the device that is missing. */
	arguments[6] = "--insecure";
	assert_int_not_equal(daemon_run(arguments, output, sizeof output), 0);
	assert_non_null(strstr(output, "none such"));
	arguments[6] = NULL;
	write_file(p, ",{\"name\": \"anonymous\", \"role\": \"evaluate\"}");
	daemon_run(arguments, output, sizeof output);
	assert_non_null(strstr(output, "none such"));
	write_file(p, "");
}

static void test_public_address_goes_with_tokens_or_insecure(void **state)
{
	struct place *p = *state;
	const char *arguments[] = {"--listen", "0.0.0.0:0", "--tokens",
	    p->file, NULL};
	struct daemon d;
	char line[256];

	if (getenv("BLOBFIELDD") == NULL)
		skip();
	for (int i = 0; i < 2; i++) {
		int ends[2];
		pid_t pid;
		ssize_t n;

		if (i == 1) {
			arguments[2] = "--insecure";
			arguments[3] = NULL;
		}
		assert_int_equal(pipe(ends), 0);
		pid = fork();
		if (pid == 0) {
			dup2(ends[1], 1);
			execl(getenv("BLOBFIELDD"), "blobfieldd", "--no-cache",
			    "--quiet", "--data", ":memory:", "--listen",
			    "0.0.0.0:0", arguments[2], arguments[3],
			    (char *)NULL);
			_exit(127);
		}
		close(ends[1]);
		n = read(ends[0], line, sizeof line - 1);
		close(ends[0]);
		d = (struct daemon){.pid = pid, .out = open("/dev/null",
		    O_RDONLY)};
		daemon_stop(&d, SIGTERM);
		assert_true(n > 0);
		line[n] = '\0';
		assert_non_null(strstr(line, "listening on http://0.0.0.0:"));
	}
}

static void test_wrong_files_are_told(void **state)
{
	struct place *p = *state;
	char path[PATH_MAX + 16];
	const char *arguments[] = {"--listen", "127.0.0.1:0", "--tokens",
	    path, NULL};

	snprintf(path, sizeof path, "%s/none", p->folder);
	assert_refuses(arguments, "No such file");
	write_text(path, "bf_x\n{\"name\": \"a\"}\n", 0600);
	assert_refuses(arguments, "must be of the form {\"tokens\": [ENTRY");
	write_text(path, "{\"tokens\": [{\"name\": \"a\", \"role\": \"rot\", "
	    "\"sha256\": \"00\"}]}", 0600);
	assert_refuses(arguments, "/tokens/0/role: must be \"read\"");
	assert_refuses(arguments, "/tokens/0/sha256: must be 64");
	write_text(path, "{\"tokens\": []}", 0602);
	assert_refuses(arguments, "others may write");
	snprintf(path, sizeof path, "%s", p->folder);
	assert_refuses(arguments, "is not a file");
}

static void test_make_token_refuses(void **state)
{
	char output[4096];

	(void)state;
	for (int i = 0; i < 4; i++) {
		static const char *const specs[] = {"a:root", "a b:read",
		    ":read", "anonymous:read"};
		const char *const arguments[] = {"--make-token", specs[i],
		    NULL};

		assert_int_not_equal(daemon_run(arguments, output,
		    sizeof output), 0);
		assert_non_null(strstr(output, "--make-token"));
	}
}

int main(void)
{
	const struct CMUnitTest tests[] = {
		cmocka_unit_test(test_open_paths_need_no_token),
		cmocka_unit_test(test_unknown_path_is_404_without_token),
		cmocka_unit_test(test_without_token_401_with_challenge),
		cmocka_unit_test(test_wrong_tokens_are_401),
		cmocka_unit_test(test_two_authorizations_are_401),
		cmocka_unit_test(test_scheme_is_of_any_case),
		cmocka_unit_test(test_each_role_may_what_it_says),
		cmocka_unit_test(test_forbidden_names_the_roles),
		cmocka_unit_test(test_refused_before_the_body_is_sent),
		cmocka_unit_test(test_requests_a_second),
		cmocka_unit_test(test_points_a_second_are_a_debt),
		cmocka_unit_test(test_debt_is_a_minute_at_most),
		cmocka_unit_test(test_points_of_large_documents_count_more),
		cmocka_unit_test(test_tables_to_be_built_are_points_too),
		cmocka_unit_test(test_bytes_a_second_count_both_ways),
		cmocka_unit_test(test_scenes_of_an_owner),
		cmocka_unit_test(test_tokens_are_listed_without_secrets),
		cmocka_unit_test(test_reload),
		cmocka_unit_test(test_reload_amid_requests),
		cmocka_unit_test(test_strangers_are_limited_by_address),
		cmocka_unit_test(test_paths_with_odd_escapes_are_404),
		cmocka_unit_test(test_an_upload_that_does_not_end_counts),
		cmocka_unit_test(test_a_token_has_a_quarter_of_the_listeners),
		cmocka_unit_test(test_public_address_without_tokens_is_refused),
		cmocka_unit_test(
		    test_public_address_with_strangers_who_write_is_refused),
		cmocka_unit_test(
		    test_public_address_goes_with_tokens_or_insecure),
		cmocka_unit_test(test_wrong_files_are_told),
		cmocka_unit_test(test_make_token_refuses),
	};

	return cmocka_run_group_tests(tests, setup, teardown);
}
