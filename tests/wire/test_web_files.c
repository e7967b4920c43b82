/*
 * The previewer's files and the contract, as the daemon serves them.
 */
#include <stdarg.h>
#include <stddef.h>
#include <setjmp.h>
#include <stdint.h>
#include <cmocka.h>

#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include <cjson/cJSON.h>

#include "tests/support/daemon.h"
#include "tests/support/http.h"

/* What Firefox and Chromium send for a page. */
#define BROWSER "Accept: text/html,application/xhtml+xml,application/xml;" \
	"q=0.9,*/*;q=0.8"

#define VALUE_MAX 512

static void get(const struct daemon *d, const char *method, const char *path,
    const char *header, struct http_reply *reply)
{
	http_do(d->url, &(struct http_request){
		.method = method,
		.path = path,
		.headers = {header},
	}, reply);
}

static void assert_header(const struct http_reply *reply, const char *name,
    const char *expected)
{
	char value[VALUE_MAX];

	assert_string_equal(http_header(reply, name, value, sizeof value),
	    expected);
}

static void assert_header_has(const struct http_reply *reply,
    const char *name, const char *part)
{
	char value[VALUE_MAX];

	if (strstr(http_header(reply, name, value, sizeof value), part) == NULL)
		fail_msg("%s: no '%s' in '%s'", name, part, value);
}

/* The file of the working tree, for free. */
static char *read_file(const char *path, size_t *length)
{
	FILE *f = fopen(path, "rb");
	char *data;

	if (f == NULL)
		fail_msg("no %s", path);
	fseek(f, 0, SEEK_END);
	*length = (size_t)ftell(f);
	rewind(f);
	data = malloc(*length + 1);
	assert_non_null(data);
	assert_int_equal(fread(data, 1, *length, f), *length);
	fclose(f);
	return data;
}

static void assert_same_as_file(const struct http_reply *reply,
    const char *path)
{
	size_t length;
	char *data = read_file(path, &length);

	assert_int_equal(reply->length, length);
	assert_memory_equal(reply->body, data, length);
	free(data);
}

static void assert_is_page(const struct http_reply *reply)
{
	assert_int_equal(reply->status, 200);
	assert_header(reply, "Content-Type", "text/html; charset=utf-8");
	assert_same_as_file(reply, "clients/web/dist/index.html");
}

static void test_browsers_get_the_page(void **state)
{
	const struct daemon *d = *state;
	struct http_reply reply;

	get(d, "GET", "/", BROWSER, &reply);
	assert_is_page(&reply);
	assert_header(&reply, "Vary", "Accept");
	http_reply_fini(&reply);
}

static void assert_is_index(const struct http_reply *reply)
{
	cJSON *json;

	assert_int_equal(reply->status, 200);
	assert_header(reply, "Content-Type", "application/json");
	assert_header(reply, "Vary", "Accept");
	assert_header(reply, "Content-Security-Policy", "");
	json = cJSON_Parse(reply->body);
	assert_true(cJSON_IsArray(cJSON_GetObjectItem(json, "endpoints")));
	cJSON_Delete(json);
}

static void test_others_get_the_list(void **state)
{
	/* curl; nobody in particular; JSON rather; neither. */
	static const char *const accepts[] = {"Accept: */*", "Accept:",
	    "Accept: application/json", "Accept: text/html;q=0.5, "
	    "application/json", "Accept: text/html;q=0, */*",
	    "Accept: image/png"};
	const struct daemon *d = *state;
	struct http_reply reply;

	for (size_t i = 0; i < sizeof accepts / sizeof *accepts; i++) {
		get(d, "GET", "/", accepts[i], &reply);
		assert_is_index(&reply);
		http_reply_fini(&reply);
	}
}

static void test_the_page_may_load_only_what_is_here(void **state)
{
	static const char *const paths[] = {"/", "/web/index.html"};
	const struct daemon *d = *state;
	struct http_reply reply;

	for (size_t i = 0; i < 2; i++) {
		get(d, "GET", paths[i], BROWSER, &reply);
		assert_header_has(&reply, "Content-Security-Policy",
		    "default-src 'none'");
		assert_header_has(&reply, "Content-Security-Policy",
		    "script-src 'self'");
		assert_header_has(&reply, "Content-Security-Policy",
		    "frame-ancestors 'none'");
		assert_null(strstr(reply.headers, "unsafe"));
		assert_header(&reply, "X-Content-Type-Options", "nosniff");
		assert_header(&reply, "Referrer-Policy", "no-referrer");
		http_reply_fini(&reply);
	}
}

static const struct {
	const char *path, *type, *file;
} files[] = {
	{"/web/index.html", "text/html; charset=utf-8",
	    "clients/web/dist/index.html"},
	{"/web/app.js", "text/javascript; charset=utf-8",
	    "clients/web/dist/app.js"},
	{"/web/app.css", "text/css; charset=utf-8",
	    "clients/web/dist/app.css"},
	{"/openapi.json", "application/json", "proto/openapi.json"},
};

#define FILE_COUNT (sizeof files / sizeof *files)

static void test_files_are_as_committed(void **state)
{
	const struct daemon *d = *state;
	struct http_reply reply;

	for (size_t i = 0; i < FILE_COUNT; i++) {
		get(d, "GET", files[i].path, NULL, &reply);
		assert_int_equal(reply.status, 200);
		assert_header(&reply, "Content-Type", files[i].type);
		assert_header(&reply, "Cache-Control", "no-cache");
		assert_header(&reply, "X-Content-Type-Options", "nosniff");
		assert_same_as_file(&reply, files[i].file);
		http_reply_fini(&reply);
	}
}

static void test_what_a_browser_has_is_not_sent_again(void **state)
{
	const struct daemon *d = *state;
	char tag[64], header[128], again[64];
	struct http_reply reply;

	for (size_t i = 0; i < FILE_COUNT; i++) {
		get(d, "GET", files[i].path, NULL, &reply);
		http_header(&reply, "ETag", tag, sizeof tag);
		http_reply_fini(&reply);
		assert_int_equal(tag[0], '"');
		snprintf(header, sizeof header, "If-None-Match: W/%s", tag);
		get(d, "GET", files[i].path, header, &reply);
		assert_int_equal(reply.status, 304);
		assert_int_equal(reply.length, 0);
		assert_string_equal(http_header(&reply, "ETag", again,
		    sizeof again), tag);
		http_reply_fini(&reply);
		get(d, "GET", files[i].path, "If-None-Match: \"other\"",
		    &reply);
		assert_int_equal(reply.status, 200);
		http_reply_fini(&reply);
	}
}

static void test_the_page_at_the_root_has_its_tag(void **state)
{
	const struct daemon *d = *state;
	struct http_reply reply;
	char tag[64], condition[128];

	get(d, "GET", "/", BROWSER, &reply);
	http_header(&reply, "ETag", tag, sizeof tag);
	http_reply_fini(&reply);
	snprintf(condition, sizeof condition, "If-None-Match: %s", tag);
	http_do(d->url, &(struct http_request){
		.path = "/",
		.headers = {BROWSER, condition},
	}, &reply);
	assert_int_equal(reply.status, 304);
	assert_header(&reply, "Vary", "Accept");
	http_reply_fini(&reply);
	/* Of the list there is none. */
	get(d, "GET", "/", condition, &reply);
	assert_is_index(&reply);
	http_reply_fini(&reply);
}

static void assert_head_of(const struct daemon *d, const char *path,
    const char *accept)
{
	struct http_reply whole, head;
	char length[32], expected[32];

	get(d, "GET", path, accept, &whole);
	get(d, "HEAD", path, accept, &head);
	assert_int_equal(head.status, 200);
	assert_int_equal(head.length, 0);
	snprintf(expected, sizeof expected, "%zu", whole.length);
	assert_string_equal(http_header(&head, "Content-Length", length,
	    sizeof length), expected);
	http_reply_fini(&whole);
	http_reply_fini(&head);
}

static void test_heads_have_lengths_and_no_bodies(void **state)
{
	assert_head_of(*state, "/", BROWSER);
	assert_head_of(*state, "/", "Accept: */*");
	for (size_t i = 0; i < FILE_COUNT; i++)
		assert_head_of(*state, files[i].path, NULL);
}

static void test_there_are_no_other_files(void **state)
{
	static const char *const paths[] = {"/web/nothing.js", "/web/",
	    "/web", "/web/openapi.json", "/web/..%2Findex.html",
	    "/web/app.js/", "/app.js", "/web/APP.JS"};
	const struct daemon *d = *state;
	struct http_reply reply;

	for (size_t i = 0; i < sizeof paths / sizeof *paths; i++) {
		get(d, "GET", paths[i], NULL, &reply);
		if (reply.status != 404)
			fail_msg("%s: %ld", paths[i], reply.status);
		assert_header(&reply, "Content-Type",
		    "application/problem+json");
		http_reply_fini(&reply);
	}
	get(d, "PUT", "/web/app.js", NULL, &reply);
	assert_int_equal(reply.status, 405);
	http_reply_fini(&reply);
}

static void test_the_contract_is_json(void **state)
{
	const struct daemon *d = *state;
	struct http_reply reply;
	cJSON *json;

	get(d, "GET", "/openapi.json", NULL, &reply);
	json = cJSON_Parse(reply.body);
	assert_non_null(json);
	assert_memory_equal(cJSON_GetStringValue(cJSON_GetObjectItem(json,
	    "openapi")), "3.1", 3);
	cJSON_Delete(json);
	http_reply_fini(&reply);
}

int main(void)
{
	const struct CMUnitTest tests[] = {
		cmocka_unit_test(test_browsers_get_the_page),
		cmocka_unit_test(test_others_get_the_list),
		cmocka_unit_test(test_the_page_may_load_only_what_is_here),
		cmocka_unit_test(test_files_are_as_committed),
		cmocka_unit_test(test_what_a_browser_has_is_not_sent_again),
		cmocka_unit_test(test_the_page_at_the_root_has_its_tag),
		cmocka_unit_test(test_heads_have_lengths_and_no_bodies),
		cmocka_unit_test(test_there_are_no_other_files),
		cmocka_unit_test(test_the_contract_is_json),
	};

	return cmocka_run_group_tests(tests, daemon_setup, daemon_teardown);
}
