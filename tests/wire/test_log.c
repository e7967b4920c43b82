/*
 * The daemon's own log: a line for each request, in both formats, without
 * secrets; and a daemon whose log cannot be written.
 */
#include <stdarg.h>
#include <stddef.h>
#include <setjmp.h>
#include <stdint.h>
#include <cmocka.h>

#include <fcntl.h>
#include <signal.h>
#include <stdbool.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/stat.h>
#include <unistd.h>

#include <cjson/cJSON.h>

#include "tests/support/daemon.h"
#include "tests/support/folder.h"
#include "tests/support/http.h"

#define COUNT(array) (sizeof(array) / sizeof *(array))

#define TRACE "4bf92f3577b34da6a3ce929d0e0e4736"
#define PARENT "00f067aa0ba902b7"

/* A daemon whose standard error is fd. */
static void start(struct daemon *d, int fd, const char *format,
    const char *level)
{
	const char *const arguments[] = {"--no-measure", "--log-format",
	    format, "--log-level", level, NULL};
	int saved = dup(STDERR_FILENO);

	dup2(fd, STDERR_FILENO);
	daemon_start(d, arguments);
	dup2(saved, STDERR_FILENO);
	close(saved);
}

/* A file that is nowhere. */
static int open_file(void)
{
	char path[] = "/tmp/test_log.XXXXXX";
	int fd = mkostemp(path, O_APPEND);

	assert_true(fd >= 0);
	unlink(path);
	return fd;
}

/* What is in the file; for free. */
static char *read_file(int fd)
{
	struct stat about;
	char *text;

	assert_int_equal(fstat(fd, &about), 0);
	text = calloc(1, (size_t)about.st_size + 1);
	assert_non_null(text);
	assert_int_equal(pread(fd, text, (size_t)about.st_size, 0),
	    about.st_size);
	return text;
}

static void ask(const struct daemon *d, const char *path, const char *a,
    const char *b)
{
	struct http_reply reply;

	http_do(d->url, &(struct http_request){.path = path,
	    .headers = {a, b}}, &reply);
	assert_true(reply.status > 0);
	http_reply_fini(&reply);
}

static const char *string_of(const cJSON *json, const char *name)
{
	const char *text = cJSON_GetStringValue(cJSON_GetObjectItem(json,
	    name));

	return text != NULL ? text : "";
}

/* The line about the request with that id among lines, each of which must be an
 * object; for cJSON_Delete. NULL: there is none. */
static cJSON *find_request(const char *lines, const char *id)
{
	cJSON *found = NULL;

	while (*lines != '\0') {
		const char *end;
		cJSON *json = cJSON_ParseWithOpts(lines, &end, 0);

		if (json == NULL || *end != '\n')
			fail_msg("not one object: %.200s", lines);
		assert_int_equal(strlen(string_of(json, "time")), 24);
		assert_true(string_of(json, "level")[0] != '\0');
		assert_true(string_of(json, "message")[0] != '\0');
		if (found == NULL && strcmp(string_of(json, "request_id"),
		    id) == 0)
			found = json;
		else
			cJSON_Delete(json);
		lines = end + 1;
	}
	return found;
}

/* ---- lines ---- */

static void test_log_json_line_of_a_request(void **state)
{
	int fd = open_file();
	struct daemon d;
	char *text;
	cJSON *json;

	(void)state;
	start(&d, fd, "json", "info");
	ask(&d, "/v1/info", "X-Request-Id: one", "traceparent: 00-" TRACE "-"
	    PARENT "-01");
	assert_int_equal(daemon_stop(&d, SIGTERM), 0);
	text = read_file(fd);
	json = find_request(text, "one");
	assert_non_null(json);
	assert_string_equal(string_of(json, "message"), "request");
	assert_string_equal(string_of(json, "method"), "GET");
	assert_string_equal(string_of(json, "target"), "/v1/info");
	assert_string_equal(string_of(json, "peer"), "127.0.0.1");
	assert_string_equal(string_of(json, "trace_id"), TRACE);
	assert_string_equal(string_of(json, "parent_id"), PARENT);
	assert_int_equal(cJSON_GetObjectItem(json, "status")->valueint, 200);
	assert_int_equal(cJSON_GetObjectItem(json, "bytes_in")->valueint, 0);
	assert_true(cJSON_GetObjectItem(json, "bytes_out")->valueint > 100);
	assert_true(cJSON_GetObjectItem(json, "milliseconds")->valuedouble >
	    0.0);
	cJSON_Delete(json);
	free(text);
	close(fd);
}

/* W3C Trace Context, 3.2.2. */
static void test_log_traceparent_is_read_strictly(void **state)
{
	static const struct {
		const char *value;
		bool is_right;
	} cases[] = {
		{"00-" TRACE "-" PARENT "-00", true},
		{"00-" TRACE "-" PARENT "-ff", true},
		{"cc-" TRACE "-" PARENT "-01", true}, /* a later version */
		{"cc-" TRACE "-" PARENT "-01-what", true},
		{"cc-" TRACE "-" PARENT "-01.what", false},
		{"00-" TRACE "-" PARENT "-01-what", false},
		{"00-" TRACE "-" PARENT "-1", false},
		{"00-" TRACE "-" PARENT "-0g", false},
		{"00-" TRACE "-" PARENT "", false},
		{"00-" TRACE "-" PARENT "-011", false},
		{"ff-" TRACE "-" PARENT "-01", false},
		{"0-" TRACE "-" PARENT "-01", false},
		{"00-4BF92F3577B34DA6A3CE929D0E0E4736-" PARENT "-01", false},
		{"00-00000000000000000000000000000000-" PARENT "-01", false},
		{"00-" TRACE "-0000000000000000-01", false},
		{"00-" TRACE "0-" PARENT "-01", false},
		{"00-4bf92f3577b34da6a3ce929d0e0e473-" PARENT "-01", false},
		{"00_" TRACE "-" PARENT "-01", false},
		{"", false},
		{"00", false},
	};
	int fd = open_file();
	struct daemon d;
	char *text;

	(void)state;
	start(&d, fd, "json", "debug");
	for (size_t i = 0; i < COUNT(cases); i++) {
		char id[40], parent[200];

		snprintf(id, sizeof id, "X-Request-Id: case-%zu", i);
		snprintf(parent, sizeof parent, "traceparent: %s",
		    cases[i].value);
		ask(&d, "/healthz", id, parent);
	}
	assert_int_equal(daemon_stop(&d, SIGTERM), 0);
	text = read_file(fd);
	for (size_t i = 0; i < COUNT(cases); i++) {
		char id[40];
		cJSON *json;

		snprintf(id, sizeof id, "case-%zu", i);
		json = find_request(text, id);
		assert_non_null(json);
		if (strcmp(string_of(json, "trace_id"), cases[i].is_right ?
		    TRACE : "") != 0 || strcmp(string_of(json, "parent_id"),
		    cases[i].is_right ? PARENT : "") != 0)
			fail_msg("'%s' was read as '%s' '%s'", cases[i].value,
			    string_of(json, "trace_id"),
			    string_of(json, "parent_id"));
		cJSON_Delete(json);
	}
	free(text);
	close(fd);
}

static void test_log_has_no_secrets(void **state)
{
	static const char *const formats[] = {"json", "text"};

	(void)state;
	for (size_t i = 0; i < COUNT(formats); i++) {
		int fd = open_file();
		struct daemon d;
		char *text;

		start(&d, fd, formats[i], "debug");
		ask(&d, "/v1/info?access_token=s3cret",
		    "Authorization: Bearer bf_s3cret",
		    "X-Request-Id: one");
		ask(&d, "/v1/scenes/a/events?Access%5FToken=s3cret&limit=1",
		    "Cookie: token=s3cret", NULL);
		ask(&d, "/nothing?x=1&token=s3cret",
		    "Authorization: Basic czNjcmV0", NULL);
		assert_int_equal(daemon_stop(&d, SIGTERM), 0);
		text = read_file(fd);
		assert_null(strstr(text, "s3cret"));
		assert_null(strstr(text, "czNjcmV0"));
		assert_non_null(strstr(text, "/v1/info?access_token=***"));
		assert_non_null(strstr(text, "/nothing?x=1&token=***"));
		free(text);
		close(fd);
	}
}

/* The end of a long one: the nearest proxy's word is the last. */
static void test_log_says_what_was_forwarded(void **state)
{
	static const char *const formats[] = {"json", "text"};
	static const char *const words[] = {
		"\"forwarded_for\":\"2001:db8::7, \\\"x\\\\\"}\n",
		" as-sent from 127.0.0.1 forwarded for "
		    "\"2001:db8::7, \\\"x\\\\\"\n",
	};
	char header[400] = "X-Forwarded-For: ";

	(void)state;
	for (int i = 0; i < 20; i++)
		strcat(header, "192.0.2.1, ");
	strcat(header, "2001:db8::7, \"x\\");
	for (size_t i = 0; i < COUNT(formats); i++) {
		int fd = open_file();
		struct daemon d;
		char *text, *at;

		start(&d, fd, formats[i], "info");
		ask(&d, "/v1/info", "X-Request-Id: as-sent",
		    "X-Forwarded-For: 2001:db8::7, \"x\\");
		ask(&d, "/v1/info?long", "X-Request-Id: long", header);
		assert_int_equal(daemon_stop(&d, SIGTERM), 0);
		text = read_file(fd);
		assert_non_null(strstr(text, words[i]));
		at = strstr(strstr(text, "/v1/info?long"), "192.0.2.1, ");
		assert_non_null(at);
		assert_int_equal(at[-1], '"');
		assert_in_range(strcspn(at, "\n"), 180, 210);
		assert_true(strstr(at, ", 2001:db8::7, \\\"x\\\\\"") <
		    strchr(at, '\n'));
		free(text);
		close(fd);
	}
}

static void test_log_text_line_has_the_request_id(void **state)
{
	int fd = open_file();
	struct daemon d;
	char *text, *at;

	(void)state;
	start(&d, fd, "text", "info");
	ask(&d, "/v1/scenes", "X-Request-Id: my-own", NULL);
	assert_int_equal(daemon_stop(&d, SIGTERM), 0);
	text = read_file(fd);
	at = strstr(text, " info: GET /v1/scenes 200 ");
	assert_non_null(at);
	*strchr(at, '\n') = '\0';
	assert_non_null(strstr(at, " ms my-own"));
	free(text);
	close(fd);
}

/* Three are named, the rest is counted; and so are those that are too many. */
static void test_log_sums_up_scenes_that_cannot_be_used(void **state)
{
	static const char two[] = "{\"format\":\"blobfield/1\",\"root\":{"
	    "\"type\":\"union\",\"operator\":\"camel\",\"children\":[{"
	    "\"type\":\"segment\",\"a\":[0,0,0],\"b\":[1,0,0],\"radius\":1},"
	    "{\"type\":\"segment\",\"a\":[0,0,0],\"b\":[0,1,0],"
	    "\"radius\":1}]}}";
	char folder[PATH_MAX];
	const char *arguments[] = {"--no-measure", "--data", folder,
	    "--max-nodes", "3", "--max-scenes", "5", NULL};
	int fd = open_file(), saved = dup(STDERR_FILENO), named = 0;
	struct daemon d;
	char *text;

	(void)state;
	folder_make(folder);
	daemon_start(&d, arguments);
	daemon_await_ready(&d);
	for (int i = 0; i < 6; i++) {
		char path[32];
		struct http_reply reply;

		snprintf(path, sizeof path, "/v1/scenes/s%d", i);
		http_json(d.url, "PUT", path, two, &reply);
		assert_int_equal(reply.status, i < 5 ? 201 : 507);
		if (i == 5)
			assert_non_null(strstr(reply.body, "5 of at most 5 "
			    "scenes (--max-scenes)"));
		http_reply_fini(&reply);
	}
	assert_int_equal(daemon_stop(&d, SIGTERM), 0);
	arguments[4] = "2";
	arguments[6] = "4";
	dup2(fd, STDERR_FILENO);
	daemon_start(&d, arguments);
	dup2(saved, STDERR_FILENO);
	close(saved);
	daemon_await_ready(&d);
	assert_int_equal(daemon_stop(&d, SIGTERM), 0);
	text = read_file(fd);
	for (const char *at = text; (at = strstr(at, "' is kept, but")) != NULL;
	    at++)
		named++;
	assert_int_equal(named, 3);
	assert_non_null(strstr(text, "warning: 5 scenes of 5 are kept, but "
	    "cannot be used now"));
	assert_non_null(strstr(text, "warning: 5 scenes are kept, and at most 4 "
	    "may be (--max-scenes)"));
	free(text);
	close(fd);
	folder_remove(folder);
}

/* ---- nobody takes them ---- */

/* Answers, and ends as it should. */
static void assert_goes_on(struct daemon *d, int requests)
{
	for (int i = 0; i < requests; i++)
		ask(d, "/healthz?a=nobody-reads-this", NULL, NULL);
	assert_int_equal(daemon_stop(d, SIGTERM), 0);
}

static void test_log_closed_pipe_stops_nothing(void **state)
{
	struct daemon d;
	int ends[2];

	(void)state;
	assert_int_equal(pipe(ends), 0);
	start(&d, ends[1], "text", "debug");
	close(ends[1]);
	close(ends[0]);
	assert_goes_on(&d, 20);
}

/* 64 KiB are full after some 250 requests. */
static void test_log_pipe_that_nobody_reads_stops_nothing(void **state)
{
	struct daemon d;
	int ends[2];

	(void)state;
	assert_int_equal(pipe(ends), 0);
	start(&d, ends[1], "json", "debug");
	close(ends[1]);
	assert_goes_on(&d, 600);
	close(ends[0]);
}

static void test_log_full_disk_stops_nothing(void **state)
{
	int fd = open("/dev/full", O_WRONLY);
	struct daemon d;

	(void)state;
	assert_true(fd >= 0);
	start(&d, fd, "json", "debug");
	assert_goes_on(&d, 20);
	close(fd);
}

int main(void)
{
	const struct CMUnitTest tests[] = {
		cmocka_unit_test(test_log_json_line_of_a_request),
		cmocka_unit_test(test_log_traceparent_is_read_strictly),
		cmocka_unit_test(test_log_has_no_secrets),
		cmocka_unit_test(test_log_text_line_has_the_request_id),
		cmocka_unit_test(test_log_says_what_was_forwarded),
		cmocka_unit_test(test_log_sums_up_scenes_that_cannot_be_used),
		cmocka_unit_test(test_log_closed_pipe_stops_nothing),
		cmocka_unit_test(test_log_pipe_that_nobody_reads_stops_nothing),
		cmocka_unit_test(test_log_full_disk_stops_nothing),
	};

	return cmocka_run_group_tests(tests, NULL, NULL);
}
