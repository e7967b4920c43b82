/*
 * By which names the daemon may be asked: DNS rebinding makes a page's name
 * resolve to 127.0.0.1, and its browser sends that name as the Host.
 */
#include <stdarg.h>
#include <stddef.h>
#include <setjmp.h>
#include <stdint.h>
#include <cmocka.h>

#include <limits.h>
#include <signal.h>
#include <stdbool.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/stat.h>

#include "tests/support/daemon.h"
#include "tests/support/folder.h"
#include "tests/support/http.h"

#define BALL "{\"format\":\"blobfield/1\",\"root\":{\"type\":\"point\"," \
	"\"center\":[0,0,0],\"radius\":1}}"

enum which {
	PLAIN,    /* nothing said */
	LISTED,   /* --hosts with names */
	ANY,      /* --hosts * */
	INSECURE, /* --insecure */
	CLOSED,   /* --tokens */
	GUARDED,  /* --tokens, and --hosts with names */
	WHICH_COUNT
};

struct place {
	struct daemon daemons[WHICH_COUNT];
	char folder[PATH_MAX], file[PATH_MAX + 8];
};

/* One entry, for requests without a token: what they may is not asked here. */
static void write_tokens(const char *path)
{
	FILE *file = fopen(path, "w");

	assert_non_null(file);
	fputs("{\"tokens\": [{\"name\": \"anonymous\", \"role\": \"read\"}]}",
	    file);
	assert_int_equal(fclose(file), 0);
	assert_int_equal(chmod(path, 0600), 0);
}

static int setup(void **state)
{
	static const char names[] = "blob.example, OTHER.example.,under_score";
	struct place *p = calloc(1, sizeof *p);
	const char *more[WHICH_COUNT][5] = {
		[LISTED] = {"--hosts", names},
		[ANY] = {"--hosts", "*"},
		[INSECURE] = {"--insecure"},
		[CLOSED] = {"--tokens", p->file},
		[GUARDED] = {"--tokens", p->file, "--hosts", names},
	};

	assert_non_null(p);
	folder_make(p->folder);
	snprintf(p->file, sizeof p->file, "%s/tokens", p->folder);
	write_tokens(p->file);
	for (int i = 0; i < WHICH_COUNT; i++) {
		const char *arguments[8] = {"--no-measure"};

		for (int k = 0; k < 5 && more[i][k] != NULL; k++)
			arguments[k + 1] = more[i][k];
		daemon_start(&p->daemons[i], arguments);
	}
	*state = p;
	return 0;
}

static int teardown(void **state)
{
	struct place *p = *state;
	int status = 0;

	for (int i = 0; i < WHICH_COUNT; i++)
		status |= daemon_stop(&p->daemons[i], SIGTERM);
	folder_remove(p->folder);
	free(p);
	return status;
}

/* The answer to a request for target with these header lines. */
static int ask(struct place *p, enum which which, const char *target,
    const char *lines, char *reply, size_t size)
{
	char text[1024];
	int n = snprintf(text, sizeof text, "GET %s HTTP/1.1\r\n%s"
	    "Connection: close\r\n\r\n", target, lines);

	assert_true(n < (int)sizeof text);
	return http_raw(p->daemons[which].port, text, (size_t)n, reply, size);
}

static int ask_as(struct place *p, enum which which, const char *host)
{
	char line[400], reply[4096];

	snprintf(line, sizeof line, "Host: %s\r\n", host);
	return ask(p, which, "/v1/info", line, reply, sizeof reply);
}

static void assert_all(struct place *p, enum which which,
    const char *const *hosts, int status)
{
	for (; *hosts != NULL; hosts++) {
		int got = ask_as(p, which, *hosts);

		if (got != status)
			fail_msg("%d: Host: %s: %d", which, *hosts, got);
	}
}

static const char *const local[] = {"localhost", "localhost:1", "LocalHost",
	"localhost.", "localhost.:7878", "a.localhost", "A.b.LOCALHOST:80",
	"127.0.0.1", "127.0.0.1:7878", "127.0.0.1.", "10.1.2.3", "[::1]",
	"[::1]:7878", "[2001:DB8::1]", "[::ffff:127.0.0.1]:1", NULL};

static const char *const foreign[] = {"evil.example", "evil.example:7878",
	"localhost.evil.example", "evillocalhost", ".localhost", "localhos",
	"127.0.0.1.evil.example", "1.2.3", "1.2.3.4.5", "0x7f.0.0.1",
	"2130706433", "[::1", "localhost..", "..localhost", "%6cocalhost",
	"[:::]", "[1.2.3.4]", "*", "-", "blob.example.evil.example", NULL};

static const char *const listed[] = {"blob.example", "BLOB.EXAMPLE",
	"blob.example.", "blob.example:443", "other.example", "Under_Score",
	NULL};

static void test_hosts_local_ones_are_always_allowed(void **state)
{
	for (int i = 0; i < WHICH_COUNT; i++)
		assert_all(*state, (enum which)i, local, 200);
}

/* "[::1" is no host at all. */
static void test_hosts_others_are_refused_without_tokens(void **state)
{
	for (size_t i = 0; foreign[i] != NULL; i++)
		assert_int_equal(ask_as(*state, PLAIN, foreign[i]),
		    strcmp(foreign[i], "[::1") == 0 ? 400 : 421);
	assert_all(*state, PLAIN, listed, 421);
}

static void test_hosts_listed_ones_are_allowed(void **state)
{
	assert_all(*state, LISTED, listed, 200);
	assert_all(*state, GUARDED, listed, 200);
	for (size_t i = 0; foreign[i] != NULL; i++) {
		int status = strcmp(foreign[i], "[::1") == 0 ? 400 : 421;

		assert_int_equal(ask_as(*state, LISTED, foreign[i]), status);
		assert_int_equal(ask_as(*state, GUARDED, foreign[i]), status);
	}
}

static void test_hosts_any_with_star_tokens_or_insecure(void **state)
{
	static const char *const names[] = {"evil.example", "a:1", NULL};

	assert_all(*state, ANY, names, 200);
	assert_all(*state, INSECURE, names, 200);
	assert_all(*state, CLOSED, names, 200);
}

static void test_hosts_the_refusal_names_the_flag(void **state)
{
	char reply[4096];

	assert_int_equal(ask(*state, PLAIN, "/v1/scenes",
	    "Host: evil.example:7878\r\n", reply, sizeof reply), 421);
	assert_non_null(strstr(reply, "application/problem+json"));
	assert_non_null(strstr(reply, "/problems/misdirected"));
	assert_non_null(strstr(reply, "'evil.example'"));
	assert_non_null(strstr(reply, "--hosts"));
	assert_int_equal(ask(*state, LISTED, "/v1/scenes",
	    "Host: evil.example\r\n", reply, sizeof reply), 421);
	assert_non_null(strstr(reply, "names of --hosts"));
}

/* Load balancers' checks have all sorts of names. */
static void test_hosts_probes_may_have_any(void **state)
{
	char reply[4096];
	int status;

	assert_int_equal(ask(*state, PLAIN, "/healthz", "Host: evil.example\r\n",
	    reply, sizeof reply), 200);
	status = ask(*state, PLAIN, "/readyz", "Host: evil.example\r\n", reply,
	    sizeof reply);
	assert_true(status == 200 || status == 503);
	/* Figures are for who may know them. */
	assert_int_equal(ask(*state, PLAIN, "/metrics", "Host: evil.example\r\n",
	    reply, sizeof reply), 421);
	assert_int_equal(ask(*state, PLAIN, "/", "Host: evil.example\r\n",
	    reply, sizeof reply), 421);
	assert_int_equal(ask(*state, PLAIN, "/none", "Host: evil.example\r\n",
	    reply, sizeof reply), 421);
}

static void test_hosts_missing_and_several(void **state)
{
	struct place *p = *state;
	static const char old[] = "GET /v1/info HTTP/1.0\r\n\r\n";
	char reply[4096];

	assert_int_equal(ask(p, PLAIN, "/v1/info", "", reply, sizeof reply),
	    400);
	assert_int_equal(ask(p, PLAIN, "/v1/info", "Host: localhost\r\n"
	    "Host: evil.example\r\n", reply, sizeof reply), 400);
	/* No browser sends such. */
	assert_int_equal(http_raw(p->daemons[PLAIN].port, old, sizeof old - 1,
	    reply, sizeof reply), 200);
}

/* Its host is what counts there; both have to be allowed. */
static void test_hosts_targets_in_absolute_form(void **state)
{
	static const struct {
		const char *target, *host;
		int status;
	} cases[] = {
		{"http://localhost/v1/info", "Host: localhost\r\n", 200},
		{"http://127.0.0.1:80/v1/info", "Host: localhost\r\n", 200},
		{"http://evil.example/v1/info", "Host: localhost\r\n", 421},
		{"http://localhost/v1/info", "Host: evil.example\r\n", 421},
		{"http://localhost:x@evil.example/v1/info",
		    "Host: localhost\r\n", 421},
		{"http://me@localhost/v1/info", "Host: localhost\r\n", 421},
		{"HTTP://EVIL.example/v1/info", "Host: localhost\r\n", 421},
	};
	char reply[4096];

	for (size_t i = 0; i < sizeof cases / sizeof *cases; i++) {
		int status = ask(*state, PLAIN, cases[i].target, cases[i].host,
		    reply, sizeof reply);

		if (status != cases[i].status)
			fail_msg("%s: %d", cases[i].target, status);
	}
}

/* As a rebound page would do it. */
static void test_hosts_nothing_is_changed_or_evaluated(void **state)
{
	struct place *p = *state;
	static const struct {
		const char *method, *path;
	} cases[] = {{"PUT", "/v1/scenes/rebound"}, {"POST", "/v1/scenes"},
	    {"POST", "/v1/eval"}, {"DELETE", "/v1/scenes/kept"},
	    {"OPTIONS", "/v1/scenes"}};
	const char *url = p->daemons[PLAIN].url;
	struct http_reply reply;

	http_json(url, "PUT", "/v1/scenes/kept", BALL, &reply);
	http_reply_fini(&reply);
	assert_int_equal(reply.status, 201);
	for (size_t i = 0; i < sizeof cases / sizeof *cases; i++) {
		struct http_request request = {.method = cases[i].method,
		    .path = cases[i].path, .body = BALL,
		    .length = sizeof BALL - 1,
		    .headers = {"Content-Type: application/json",
		    "Host: evil.example", "Origin: http://evil.example"}};

		http_do(url, &request, &reply);
		http_reply_fini(&reply);
		if (reply.status != 421)
			fail_msg("%s: %ld", cases[i].path, reply.status);
	}
	http_get(url, "/v1/scenes", &reply);
	assert_non_null(strstr(reply.body, "\"kept\""));
	assert_null(strstr(reply.body, "rebound"));
	http_reply_fini(&reply);
}

static void test_hosts_wrong_names_are_told_at_the_start(void **state)
{
	static const char *const wrong[] = {"http://a.example", "a.example:80",
	    "a.example/", "*,a.example", "*.a.example", ",", "::1", "a..b",
	    ".a"};
	char output[4096];

	(void)state;
	for (size_t i = 0; i < sizeof wrong / sizeof *wrong; i++) {
		const char *const arguments[] = {"--listen", "127.0.0.1:0",
		    "--hosts", wrong[i], NULL};

		assert_int_equal(daemon_run(arguments, output,
		    sizeof output), 2);
		assert_non_null(strstr(output, "error: --hosts: "));
	}
}

int main(void)
{
	const struct CMUnitTest tests[] = {
		cmocka_unit_test(test_hosts_local_ones_are_always_allowed),
		cmocka_unit_test(test_hosts_others_are_refused_without_tokens),
		cmocka_unit_test(test_hosts_listed_ones_are_allowed),
		cmocka_unit_test(test_hosts_any_with_star_tokens_or_insecure),
		cmocka_unit_test(test_hosts_the_refusal_names_the_flag),
		cmocka_unit_test(test_hosts_probes_may_have_any),
		cmocka_unit_test(test_hosts_missing_and_several),
		cmocka_unit_test(test_hosts_targets_in_absolute_form),
		cmocka_unit_test(test_hosts_nothing_is_changed_or_evaluated),
		cmocka_unit_test(test_hosts_wrong_names_are_told_at_the_start),
	};

	return cmocka_run_group_tests(tests, setup, teardown);
}
