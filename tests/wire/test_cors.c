/*
 * CORS: which answers say that which pages may read them; and that pages which
 * may not cannot change anything by requests that browsers send unasked.
 */
#include <stdarg.h>
#include <stddef.h>
#include <setjmp.h>
#include <stdint.h>
#include <cmocka.h>

#include <signal.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "tests/support/daemon.h"
#include "tests/support/http.h"

#define LISTED "https://a.example"
#define OTHER "https://b.example"
#define BALL "{\"format\":\"blobfield/1\",\"root\":{\"type\":\"point\"," \
	"\"center\":[0,0,0],\"radius\":1}}"

/* One daemon without origins, one with two and null, one with all. */
struct place {
	struct daemon closed, some, all;
};

static void start(struct daemon *d, const char *origins)
{
	const char *const arguments[] = {"--no-measure", "--cors-origin",
	    origins, NULL};
	static const char *const none[] = {"--no-measure", NULL};

	daemon_start(d, origins != NULL ? arguments : none);
}

static int setup(void **state)
{
	struct place *p = calloc(1, sizeof *p);

	assert_non_null(p);
	start(&p->closed, NULL);
	start(&p->some, LISTED ", http://localhost:5173,null");
	start(&p->all, "*");
	*state = p;
	return 0;
}

static int teardown(void **state)
{
	struct place *p = *state;
	int status = daemon_stop(&p->closed, SIGTERM);

	status |= daemon_stop(&p->some, SIGTERM);
	status |= daemon_stop(&p->all, SIGTERM);
	free(p);
	return status;
}

/* One request from origin (NULL: no header); its Access-Control-Allow-Origin
 * must be allow, and its Vary must have Origin or not. */
static void assert_origin(const struct daemon *d, const char *path,
    const char *origin, const char *allow, int varies)
{
	char line[128], value[512];
	struct http_request request = {.path = path};
	struct http_reply reply;

	if (origin != NULL) {
		snprintf(line, sizeof line, "Origin: %s", origin);
		request.headers[0] = line;
	}
	http_do(d->url, &request, &reply);
	assert_true(reply.status > 0);
	assert_string_equal(http_header(&reply, "Access-Control-Allow-Origin",
	    value, sizeof value), allow);
	assert_int_equal(strstr(reply.headers, "Vary: Origin") != NULL,
	    varies);
	http_header(&reply, "Access-Control-Expose-Headers", value,
	    sizeof value);
	assert_int_equal(strstr(value, "ETag") != NULL, allow[0] != '\0');
	assert_null(strstr(reply.headers, "Access-Control-Allow-Credentials"));
	http_reply_fini(&reply);
}

static void test_without_origins_nothing_is_said(void **state)
{
	struct place *p = *state;

	assert_origin(&p->closed, "/v1/info", LISTED, "", 0);
	assert_origin(&p->closed, "/v1/info", "null", "", 0);
}

static void test_listed_origins_are_allowed(void **state)
{
	struct place *p = *state;

	assert_origin(&p->some, "/v1/info", LISTED, LISTED, 1);
	assert_origin(&p->some, "/v1/info", "http://localhost:5173",
	    "http://localhost:5173", 1);
}

static void test_others_are_not(void **state)
{
	static const char *const others[] = {OTHER, "https://a.example.org",
	    "https://a.exampl", "http://a.example", "https://a.example:443",
	    "https://A.example", "https://x.a.example", "http://localhost",
	    "https://a.example, https://b.example", "*", ""};
	struct place *p = *state;

	for (size_t i = 0; i < sizeof others / sizeof *others; i++)
		assert_origin(&p->some, "/v1/info", others[i], "", 1);
	/* Caches must not give this one's answer to a page. */
	assert_origin(&p->some, "/v1/info", NULL, "", 1);
}

static void test_null_is_allowed_where_listed(void **state)
{
	struct place *p = *state;

	assert_origin(&p->some, "/v1/info", "null", "null", 1);
}

static void test_star_allows_all(void **state)
{
	struct place *p = *state;

	assert_origin(&p->all, "/v1/info", OTHER, "*", 0);
	assert_origin(&p->all, "/v1/info", "null", "*", 0);
	assert_origin(&p->all, "/v1/info", NULL, "", 0);
}

static void test_errors_can_be_read_by_pages(void **state)
{
	struct place *p = *state;

	assert_origin(&p->some, "/none", LISTED, LISTED, 1);
	assert_origin(&p->some, "/v1/scenes/none", LISTED, LISTED, 1);
}

/* The answer to a preflight: its Allow-Methods, which may be "". */
static void preflight(const struct daemon *d, const char *path,
    const char *origin, char *methods, size_t size)
{
	char line[128], value[512];
	struct http_reply reply;
	struct http_request request = {.method = "OPTIONS", .path = path,
	    .headers = {line, "Access-Control-Request-Method: PUT",
	    "Access-Control-Request-Headers: authorization,content-type"}};

	snprintf(line, sizeof line, "Origin: %s", origin);
	http_do(d->url, &request, &reply);
	assert_int_equal(reply.status, 204);
	http_header(&reply, "Access-Control-Allow-Methods", methods, size);
	http_header(&reply, "Access-Control-Allow-Headers", value,
	    sizeof value);
	if (methods[0] != '\0') {
		assert_non_null(strstr(value, "Authorization"));
		assert_non_null(strstr(value, "Content-Type"));
		assert_non_null(strstr(value, "If-Match"));
		assert_non_null(strstr(value, "Last-Event-ID"));
		assert_string_equal(http_header(&reply,
		    "Access-Control-Max-Age", value, sizeof value), "600");
		assert_true(http_header(&reply, "Access-Control-Allow-Origin",
		    value, sizeof value)[0] != '\0');
	}
	http_reply_fini(&reply);
}

static void test_preflight(void **state)
{
	struct place *p = *state;
	char methods[256];

	preflight(&p->some, "/v1/scenes/a", LISTED, methods, sizeof methods);
	assert_string_equal(methods, "GET, HEAD, PUT, PATCH, DELETE, OPTIONS");
	preflight(&p->all, "/v1/eval", OTHER, methods, sizeof methods);
	assert_string_equal(methods, "POST, OPTIONS");
	preflight(&p->some, "/v1/scenes/a", OTHER, methods, sizeof methods);
	assert_string_equal(methods, "");
	preflight(&p->closed, "/v1/scenes/a", LISTED, methods,
	    sizeof methods);
	assert_string_equal(methods, "");
}

/*
 * What a page may send anywhere without a preflight: POST with no type or one
 * of three. Nothing is kept or evaluated for these.
 */
static void test_simple_requests_change_nothing(void **state)
{
	static const char *const types[] = {"Content-Type: text/plain",
	    "Content-Type: application/x-www-form-urlencoded",
	    "Content-Type: multipart/form-data; boundary=x",
	    "Content-Type:"};
	static const char *const paths[] = {"/v1/scenes", "/v1/eval",
	    "/v1/operators", "/v1/import", "/v1/volumes?min=0,0,0&max=1,1,1"};
	struct place *p = *state;
	struct http_reply reply;

	for (size_t i = 0; i < sizeof paths / sizeof *paths; i++) {
		for (size_t k = 0; k < sizeof types / sizeof *types; k++) {
			struct http_request request = {.method = "POST",
			    .path = paths[i], .body = BALL,
			    .length = sizeof BALL - 1,
			    .headers = {types[k], "Origin: " OTHER}};

			http_do(p->closed.url, &request, &reply);
			http_reply_fini(&reply);
			if (reply.status != 415)
				fail_msg("%s, %s: %ld", paths[i], types[k],
				    reply.status);
		}
	}
	http_get(p->closed.url, "/v1/scenes", &reply);
	assert_non_null(strstr(reply.body, "\"scenes\":[]"));
	http_reply_fini(&reply);
}

static void test_wrong_origins_are_told_at_the_start(void **state)
{
	static const char *const wrong[] = {"a.example", "https://a.example/",
	    "https://a.example,*", "https://A.example", "https://",
	    "https://a b", "://a"};
	char output[4096];

	(void)state;
	for (size_t i = 0; i < sizeof wrong / sizeof *wrong; i++) {
		const char *const arguments[] = {"--listen", "127.0.0.1:0",
		    "--cors-origin", wrong[i], NULL};

		assert_int_equal(daemon_run(arguments, output,
		    sizeof output), 2);
		assert_non_null(strstr(output, "is no origin"));
	}
}

int main(void)
{
	const struct CMUnitTest tests[] = {
		cmocka_unit_test(test_without_origins_nothing_is_said),
		cmocka_unit_test(test_listed_origins_are_allowed),
		cmocka_unit_test(test_others_are_not),
		cmocka_unit_test(test_null_is_allowed_where_listed),
		cmocka_unit_test(test_star_allows_all),
		cmocka_unit_test(test_errors_can_be_read_by_pages),
		cmocka_unit_test(test_preflight),
		cmocka_unit_test(test_simple_requests_change_nothing),
		cmocka_unit_test(test_wrong_origins_are_told_at_the_start),
	};

	return cmocka_run_group_tests(tests, setup, teardown);
}
