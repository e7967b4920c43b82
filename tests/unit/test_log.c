/*
 * Log lines: their two formats, what they escape and mask, that each is one
 * write, and that one that cannot be written holds nobody up.
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
#include <time.h>
#include <unistd.h>

#include <cjson/cJSON.h>

#include "server/log.h"
#include "tests/support/load.h"

#define ID "0123456789abcdef-00000001"
#define TRACE "4bf92f3577b34da6a3ce929d0e0e4736"
#define PARENT "00f067aa0ba902b7"

#define THREADS 4
#define LINES 200

/* Standard error, put aside for a pipe. */
struct capture {
	int saved, reader;
};

static struct capture begin_capture(void)
{
	struct capture c;
	int ends[2];

	assert_int_equal(pipe(ends), 0);
	c.saved = dup(STDERR_FILENO);
	c.reader = ends[0];
	assert_true(dup2(ends[1], STDERR_FILENO) >= 0);
	close(ends[1]);
	return c;
}

static void give_back(struct capture *c)
{
	dup2(c->saved, STDERR_FILENO);
	close(c->saved);
}

/* What was written, with a NUL; for free. */
static char *end_capture(struct capture *c)
{
	size_t size = 1 << 20, length = 0;
	char *text = malloc(size);
	ssize_t n;

	give_back(c);
	assert_non_null(text);
	while ((n = read(c->reader, text + length, size - 1 - length)) > 0)
		length += (size_t)n;
	close(c->reader);
	text[length] = '\0';
	return text;
}

/* The one object of the one line written; for cJSON_Delete. */
static cJSON *end_json(struct capture *c)
{
	char *text = end_capture(c);
	const char *end;
	cJSON *json = cJSON_ParseWithOpts(text, &end, 0);

	assert_non_null(json);
	assert_string_equal(end, "\n");
	free(text);
	return json;
}

static const char *string_of(const cJSON *json, const char *name)
{
	return cJSON_GetStringValue(cJSON_GetObjectItem(json, name));
}

static struct log_request request_of(const char *target)
{
	return (struct log_request){.method = "GET", .target = target,
	    .peer = "192.0.2.1", .token = "ci", .request_id = ID,
	    .trace_id = TRACE, .parent_id = PARENT, .status = 200,
	    .bytes_in = 7, .bytes_out = 1234, .seconds = 0.0015};
}

/* ---- formats ---- */

static void test_text_line_of_a_request(void **state)
{
	struct log_request r = request_of("/v1/info");
	struct capture c = begin_capture();
	char *text;

	(void)state;
	log_set_format(LOG_TEXT);
	log_request(LOG_INFO, &r);
	text = end_capture(&c);
	assert_int_equal(strlen(text), strlen("2026-11-22T13:35:32.123Z") +
	    strlen(" info: GET /v1/info 200 1234 1.5 ms " ID
	    " from 192.0.2.1 as ci\n"));
	assert_string_equal(text + strlen("2026-11-22T13:35:32.123Z"),
	    " info: GET /v1/info 200 1234 1.5 ms " ID
	    " from 192.0.2.1 as ci\n");
	free(text);
}

static void test_text_line_quotes_what_was_forwarded(void **state)
{
	struct log_request r = request_of("/");
	struct capture c = begin_capture();
	char *text;

	(void)state;
	r.forwarded_for = "192.0.2.7, \"a\n\\b\x1b\xff token=admin";
	r.token = "";
	log_set_format(LOG_TEXT);
	log_request(LOG_INFO, &r);
	text = end_capture(&c);
	assert_non_null(strstr(text, ID " from 192.0.2.1 forwarded for "
	    "\"192.0.2.7, \\\"a\\n\\\\b\\u001b\\ufffd token=admin\"\n"));
	free(text);
}

static void test_text_line_says_that_the_answer_was_cut(void **state)
{
	struct log_request r = request_of("/v1/info");
	struct capture c = begin_capture();
	char *text;

	(void)state;
	r.is_cut = true;
	log_set_format(LOG_TEXT);
	log_request(LOG_INFO, &r);
	text = end_capture(&c);
	assert_non_null(strstr(text, " 200 1234 1.5 ms cut " ID
	    " from 192.0.2.1 as ci\n"));
	free(text);
}

static void test_json_line_says_that_the_answer_was_cut(void **state)
{
	struct log_request r = request_of("/v1/info");
	struct capture c = begin_capture();
	cJSON *json;

	(void)state;
	r.is_cut = true;
	log_set_format(LOG_JSON);
	log_request(LOG_INFO, &r);
	json = end_json(&c);
	assert_true(cJSON_IsTrue(cJSON_GetObjectItem(json, "cut")));
	assert_string_equal(string_of(json, "peer"), "192.0.2.1");
	cJSON_Delete(json);
}

static void test_json_line_of_a_request(void **state)
{
	struct log_request r = request_of("/v1/info");
	struct capture c = begin_capture();
	cJSON *json;

	(void)state;
	r.forwarded_for = "192.0.2.7, \"\xff";
	log_set_format(LOG_JSON);
	log_request(LOG_INFO, &r);
	json = end_json(&c);
	assert_string_equal(string_of(json, "forwarded_for"),
	    "192.0.2.7, \"\xef\xbf\xbd");
	assert_int_equal(strlen(string_of(json, "time")), 24);
	assert_string_equal(string_of(json, "level"), "info");
	assert_string_equal(string_of(json, "message"), "request");
	assert_string_equal(string_of(json, "method"), "GET");
	assert_string_equal(string_of(json, "target"), "/v1/info");
	assert_string_equal(string_of(json, "peer"), "192.0.2.1");
	assert_string_equal(string_of(json, "token"), "ci");
	assert_string_equal(string_of(json, "request_id"), ID);
	assert_string_equal(string_of(json, "trace_id"), TRACE);
	assert_string_equal(string_of(json, "parent_id"), PARENT);
	assert_int_equal(cJSON_GetObjectItem(json, "status")->valueint, 200);
	assert_int_equal(cJSON_GetObjectItem(json, "bytes_in")->valueint, 7);
	assert_int_equal(cJSON_GetObjectItem(json, "bytes_out")->valueint,
	    1234);
	assert_true(cJSON_GetObjectItem(json, "milliseconds")->valuedouble ==
	    1.5);
	cJSON_Delete(json);
}

static void test_json_leaves_out_what_is_empty(void **state)
{
	struct log_request r = {.method = "GET", .target = "/", .peer = "",
	    .token = "", .request_id = ID, .trace_id = "", .parent_id = ""};
	struct capture c = begin_capture();
	cJSON *json;

	(void)state;
	log_set_format(LOG_JSON);
	log_request(LOG_INFO, &r);
	json = end_json(&c);
	assert_null(cJSON_GetObjectItem(json, "token"));
	assert_null(cJSON_GetObjectItem(json, "trace_id"));
	assert_null(cJSON_GetObjectItem(json, "forwarded_for"));
	assert_null(cJSON_GetObjectItem(json, "parent_id"));
	assert_null(cJSON_GetObjectItem(json, "cut"));
	cJSON_Delete(json);
}

static void test_levels_above_are_dropped(void **state)
{
	struct capture c = begin_capture();
	char *text;

	(void)state;
	log_set_format(LOG_JSON);
	log_write(LOG_DEBUG, "no");
	log_text(LOG_DEBUG, "no");
	text = end_capture(&c);
	assert_string_equal(text, "");
	free(text);
}

/* ---- escapes ---- */

static void test_json_escapes_every_byte(void **state)
{
	char message[256], expected[1024] = "";
	struct capture c = begin_capture();
	cJSON *json;

	(void)state;
	for (int i = 1; i < 256; i++) {
		message[i - 1] = (char)i;
		/* From 0x80 on none is UTF-8 by itself, but those that come in
		 * this order: no lead byte is followed by what it needs. */
		strcat(expected, i < 0x80 ? (char[]){(char)i, '\0'} :
		    "\xef\xbf\xbd");
	}
	message[255] = '\0';
	log_set_format(LOG_JSON);
	log_write(LOG_INFO, "%s", message);
	json = end_json(&c);
	assert_string_equal(string_of(json, "message"), expected);
	cJSON_Delete(json);
}

static void test_json_keeps_utf8(void **state)
{
	static const char text[] = "K\xc3\xb6ln \xe2\x82\xac \xf0\x9f\x90\xab "
	    "\xc0\xaf \xed\xa0\x80 \xf4\x90\x80\x80 \xe2\x82";
	static const char expected[] = "K\xc3\xb6ln \xe2\x82\xac "
	    "\xf0\x9f\x90\xab \xef\xbf\xbd\xef\xbf\xbd "
	    "\xef\xbf\xbd\xef\xbf\xbd\xef\xbf\xbd "
	    "\xef\xbf\xbd\xef\xbf\xbd\xef\xbf\xbd\xef\xbf\xbd "
	    "\xef\xbf\xbd\xef\xbf\xbd";
	struct capture c = begin_capture();
	cJSON *json;

	(void)state;
	log_set_format(LOG_JSON);
	log_write(LOG_INFO, "%s", text);
	json = end_json(&c);
	assert_string_equal(string_of(json, "message"), expected);
	cJSON_Delete(json);
}

static void test_json_build_log_is_one_line(void **state)
{
	static const char built[] = "a.cl:1: error: \"x\"\n\tline\r\n2\n";
	struct capture c = begin_capture();
	cJSON *json;

	(void)state;
	log_set_format(LOG_JSON);
	log_text(LOG_ERROR, built);
	json = end_json(&c);
	assert_string_equal(string_of(json, "message"), built);
	assert_string_equal(string_of(json, "level"), "error");
	cJSON_Delete(json);
}

static void test_text_build_log_is_as_it_is(void **state)
{
	struct capture c = begin_capture();
	char *text;

	(void)state;
	log_set_format(LOG_TEXT);
	log_text(LOG_ERROR, "one\n\ttwo");
	log_text(LOG_ERROR, "");
	text = end_capture(&c);
	assert_string_equal(text, "one\n\ttwo\n");
	free(text);
}

static void test_text_line_stays_one(void **state)
{
	struct capture c = begin_capture();
	char *text;

	(void)state;
	log_set_format(LOG_TEXT);
	log_write(LOG_INFO, "%s", "forged\n2026 info: line\r\x1b[31m");
	text = end_capture(&c);
	assert_ptr_equal(strchr(text, '\n'), text + strlen(text) - 1);
	assert_non_null(strstr(text, "forged 2026 info: line  [31m\n"));
	free(text);
}

static void test_long_message_is_cut(void **state)
{
	char message[3 * LOG_LINE_MAX];
	struct capture c;
	cJSON *json;

	(void)state;
	memset(message, 1, sizeof message); /* the longest escape */
	message[sizeof message - 1] = '\0';
	log_set_format(LOG_JSON);
	c = begin_capture();
	log_write(LOG_INFO, "%s", message);
	json = end_json(&c);
	assert_int_equal(strlen(string_of(json, "message")), LOG_LINE_MAX - 1);
	cJSON_Delete(json);
}

static void test_request_of_the_worst_strings_fits(void **state)
{
	char text[1000];
	struct log_request r = {.method = text, .target = text, .peer = text,
	    .token = text, .request_id = text, .trace_id = text,
	    .parent_id = text, .status = UINT32_MAX, .bytes_in = SIZE_MAX,
	    .bytes_out = SIZE_MAX, .seconds = 1e12};
	struct capture c;
	cJSON *json;

	(void)state;
	memset(text, 0x80, sizeof text);
	text[sizeof text - 1] = '\0';
	log_set_format(LOG_JSON);
	c = begin_capture();
	log_request(LOG_INFO, &r);
	json = end_json(&c);
	assert_non_null(string_of(json, "parent_id"));
	cJSON_Delete(json);
}

/* ---- secrets ---- */

static void assert_masked(const char *target, const char *expected)
{
	char out[128];

	log_mask_target(target, out, sizeof out);
	assert_string_equal(out, expected);
}

static void test_secrets_are_masked(void **state)
{
	(void)state;
	assert_masked("/v1/scenes/a?limit=3", "/v1/scenes/a?limit=3");
	assert_masked("/a?access_token=s3cret", "/a?access_token=***");
	assert_masked("/a?x=1&access_token=s3cret&y=2",
	    "/a?x=1&access_token=***&y=2");
	assert_masked("/a?ACCESS%5fToken=s3cret=1?2", "/a?ACCESS%5fToken=***");
	assert_masked("/a?access_token=", "/a?access_token=");
	assert_masked("/a?access_token", "/a?access_token");
	assert_masked("/a?&&token=b&", "/a?&&token=***&");
	assert_masked("http://u:s3cret@host/a?b=c", "http://***@host/a?b=c");
	assert_masked("/a@b://c@d", "/a@b://c@d");
	assert_masked("", "");
	assert_masked("?", "?");
}

static void test_masked_target_is_cut_to_fit(void **state)
{
	char out[12];

	(void)state;
	log_mask_target("/0123456789abcdef?token=s3cret", out, sizeof out);
	assert_string_equal(out, "/0123456789");
	log_mask_target("/?token=s3cret", out, sizeof out);
	assert_string_equal(out, "/?token=***");
}

static void test_request_lines_have_no_secrets(void **state)
{
	struct log_request r = request_of("/a?access_token=s3cret");

	(void)state;
	for (int format = 0; format < LOG_FORMAT_COUNT; format++) {
		struct capture c = begin_capture();
		char *text;

		log_set_format((enum log_format)format);
		log_request(LOG_INFO, &r);
		text = end_capture(&c);
		assert_null(strstr(text, "s3cret"));
		assert_non_null(strstr(text, "access_token=***"));
		free(text);
	}
}

/* ---- where nobody takes the lines ---- */

static double now(void)
{
	struct timespec t;

	clock_gettime(CLOCK_MONOTONIC, &t);
	return (double)t.tv_sec + 1e-9 * (double)t.tv_nsec;
}

static void test_full_pipe_holds_nobody_up(void **state)
{
	unsigned long before = log_lost();
	struct capture c = begin_capture();
	double begin = now(), seconds;
	char *text;
	unsigned long lost;

	(void)state;
	log_set_format(LOG_JSON);
	for (int i = 0; i < 5000; i++)
		log_write(LOG_INFO, "line %d, which nobody reads", i);
	seconds = now() - begin;
	lost = log_lost() - before;
	/* 64 KiB hold about 700 lines; one wait of 0.1 s. */
	assert_in_range(lost, 3000, 4990);
	assert_true(load_is_soon(seconds, 2.0));
	printf("measured: 5000 lines to a full pipe: %.3f s, %lu lost\n",
	    seconds, lost);
	text = malloc(1 << 17);
	assert_non_null(text);
	assert_true(read(c.reader, text, 1 << 17) > 0);
	free(text);
	log_write(LOG_INFO, "again");
	text = end_capture(&c);
	assert_non_null(strstr(text, "lines of this log could not be written"));
	assert_non_null(strstr(text, "again"));
	free(text);
}

static void test_closed_pipe_is_no_end(void **state)
{
	unsigned long before = log_lost();
	struct capture c = begin_capture();

	(void)state;
	signal(SIGPIPE, SIG_IGN); /* as the daemon has it */
	close(c.reader);
	log_write(LOG_INFO, "for nobody");
	log_text(LOG_INFO, "for nobody");
	give_back(&c);
	assert_int_equal(log_lost(), before + 2);
}

static void test_full_disk_is_no_end(void **state)
{
	unsigned long before = log_lost();
	int saved = dup(STDERR_FILENO), full = open("/dev/full", O_WRONLY);

	(void)state;
	assert_true(full >= 0);
	dup2(full, STDERR_FILENO);
	log_write(LOG_INFO, "no room");
	dup2(saved, STDERR_FILENO);
	close(full);
	close(saved);
	assert_int_equal(log_lost(), before + 1);
}

static void *write_lines(void *arg)
{
	for (int i = 0; i < LINES; i++)
		log_write(LOG_INFO, "%s-%d-%s", (const char *)arg, i,
		    (const char *)arg);
	return NULL;
}

static void test_lines_of_threads_do_not_mix(void **state)
{
	static char names[THREADS][40];
	pthread_t threads[THREADS];
	char path[] = "/tmp/test_log.XXXXXX", line[512];
	int saved = dup(STDERR_FILENO), fd = mkstemp(path), count = 0;
	FILE *file;

	(void)state;
	assert_true(fd >= 0);
	dup2(fd, STDERR_FILENO);
	log_set_format(LOG_JSON);
	for (int i = 0; i < THREADS; i++) {
		memset(names[i], 'a' + i, sizeof names[i] - 1);
		pthread_create(&threads[i], NULL, write_lines, names[i]);
	}
	for (int i = 0; i < THREADS; i++)
		pthread_join(threads[i], NULL);
	dup2(saved, STDERR_FILENO);
	close(saved);
	file = fdopen(fd, "r");
	assert_non_null(file);
	rewind(file);
	while (fgets(line, sizeof line, file) != NULL) {
		const char *end;
		cJSON *json = cJSON_ParseWithOpts(line, &end, 0);

		/* The first may say what the tests before have lost. */
		assert_non_null(json);
		assert_string_equal(end, "\n");
		count += strchr(string_of(json, "message"), '-') != NULL;
		cJSON_Delete(json);
	}
	fclose(file);
	unlink(path);
	assert_int_equal(count, THREADS * LINES);
}

int main(void)
{
	const struct CMUnitTest tests[] = {
		cmocka_unit_test(test_text_line_of_a_request),
		cmocka_unit_test(test_text_line_quotes_what_was_forwarded),
		cmocka_unit_test(test_text_line_says_that_the_answer_was_cut),
		cmocka_unit_test(test_json_line_of_a_request),
		cmocka_unit_test(test_json_line_says_that_the_answer_was_cut),
		cmocka_unit_test(test_json_leaves_out_what_is_empty),
		cmocka_unit_test(test_levels_above_are_dropped),
		cmocka_unit_test(test_json_escapes_every_byte),
		cmocka_unit_test(test_json_keeps_utf8),
		cmocka_unit_test(test_json_build_log_is_one_line),
		cmocka_unit_test(test_text_build_log_is_as_it_is),
		cmocka_unit_test(test_text_line_stays_one),
		cmocka_unit_test(test_long_message_is_cut),
		cmocka_unit_test(test_request_of_the_worst_strings_fits),
		cmocka_unit_test(test_secrets_are_masked),
		cmocka_unit_test(test_masked_target_is_cut_to_fit),
		cmocka_unit_test(test_request_lines_have_no_secrets),
		cmocka_unit_test(test_full_pipe_holds_nobody_up),
		cmocka_unit_test(test_closed_pipe_is_no_end),
		cmocka_unit_test(test_full_disk_is_no_end),
		cmocka_unit_test(test_lines_of_threads_do_not_mix),
	};

	return cmocka_run_group_tests(tests, NULL, NULL);
}
