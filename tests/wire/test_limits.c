/*
 * Small documents that ask for much work, and large ones that ask for none:
 * each is refused with its place, or done, soon, with little memory; and the
 * daemon answers others meanwhile. Beside each case stands what it took on one
 * of two cores: wall-clock ms, and MB of memory at its peak.
 */
#include <stdarg.h>
#include <stddef.h>
#include <setjmp.h>
#include <stdint.h>
#include <cmocka.h>

#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <unistd.h>

#include "server/clock.h"
#include "tests/support/daemon.h"
#include "tests/support/http.h"
#include "tests/support/sanitized.h"

/* The slowest took 0.3 s; of others' work on the same cores there may be much,
 * and sanitizers are slow. */
#define SECONDS_MOST 8.0

/* The most took 138 MB. */
#define MEGABYTES_MOST 300

#define HEAD "{\"format\":\"blobfield/1\","
#define POINT "{\"type\":\"point\",\"center\":[0,0,0],\"radius\":1}"

/* A text that grows. */
struct text {
	char *at;
	size_t length, size;
};

static void add(struct text *t, const char *piece, size_t times)
{
	const size_t n = strlen(piece), need = t->length + n * times + 1;

	if (need > t->size) {
		t->size = 2 * need;
		t->at = realloc(t->at, t->size);
		assert_non_null(t->at);
	}
	for (size_t i = 0; i < times; i++) {
		memcpy(t->at + t->length, piece, n);
		t->length += n;
	}
	t->at[t->length] = '\0';
}

static long megabytes(const struct daemon *d, const char *field)
{
	char path[64], line[256];
	long kilobytes = 0;
	FILE *file;

	snprintf(path, sizeof path, "/proc/%d/status", (int)d->pid);
	file = fopen(path, "r");
	assert_non_null(file);
	while (fgets(line, sizeof line, file) != NULL)
		if (strncmp(line, field, strlen(field)) == 0)
			kilobytes = strtol(line + strlen(field) + 1, NULL, 10);
	fclose(file);
	return kilobytes >> 10;
}

/* That it has taken of its processors: others' work is none of it. */
static double cpu_seconds(const struct daemon *d)
{
	unsigned long user, kernel;
	char path[64], line[1024];
	FILE *file;

	snprintf(path, sizeof path, "/proc/%d/stat", (int)d->pid);
	file = fopen(path, "r");
	assert_non_null(file);
	assert_non_null(fgets(line, sizeof line, file));
	fclose(file);
	assert_int_equal(sscanf(strrchr(line, ')'), ") %*c %*d %*d %*d %*d "
	    "%*d %*u %*u %*u %*u %*u %lu %lu", &user, &kernel), 2);
	return (double)(user + kernel) / (double)sysconf(_SC_CLK_TCK);
}

/* Has the kernel forget the peak of memory. */
static void forget_peak(const struct daemon *d)
{
	char path[64];
	FILE *file;

	snprintf(path, sizeof path, "/proc/%d/clear_refs", (int)d->pid);
	file = fopen(path, "w");
	if (file != NULL) {
		fputs("5", file);
		fclose(file);
	}
}

/* Sends t, which is freed, by PUT of a document or POST of an evaluation: it
 * must get status, and say says. */
static void assert_answer(void **state, const char *name, const char *path,
    struct text *t, long status, const char *says)
{
	const struct daemon *d = *state;
	const struct http_request request = {
		.method = strcmp(path, "/v1/eval") == 0 ? "POST" : "PUT",
		.path = path, .body = t->at, .length = t->length,
		.headers = {"Content-Type: application/json"}};
	struct http_reply reply;
	double begin, seconds, cpu;
	long before, peak;

	before = megabytes(d, "VmRSS");
	forget_peak(d);
	begin = clock_seconds();
	cpu = cpu_seconds(d);
	http_do(d->url, &request, &reply);
	cpu = cpu_seconds(d) - cpu;
	seconds = clock_seconds() - begin;
	peak = megabytes(d, "VmHWM") - before;
	print_message("measured: %s: %zu bytes, %.1f ms, +%ld MB, %ld\n", name,
	    t->length, 1e3 * seconds, peak, reply.status);
	if (reply.status != status || strstr(reply.body, says) == NULL)
		fail_msg("%s: %ld, %.300s", name, reply.status, reply.body);
	assert_true(cpu < SECONDS_MOST);
	if (!SANITIZED)
		assert_true(peak < MEGABYTES_MOST);
	http_reply_fini(&reply);
	free(t->at);
	*t = (struct text){0};
}

/* A union of levels children, each of the one before, twice: 2^levels of
 * leaf. */
static void add_bomb(struct text *t, const char *leaf, int levels)
{
	char piece[200];

	add(t, HEAD "\"root\":{\"type\":\"union\",\"children\":[", 1);
	add(t, leaf, 1);
	for (int i = 1; i < levels; i++) {
		snprintf(piece, sizeof piece, ",{\"type\":\"union\",\"id\":"
		    "\"n%d\",\"children\":[{\"type\":\"ref\",\"ref\":\"n%d\"},"
		    "{\"type\":\"ref\",\"ref\":\"n%d\"}]}", i, i - 1, i - 1);
		add(t, piece, 1);
	}
	add(t, "]}}", 1);
}

#define LEAF "{\"type\":\"point\",\"center\":[0,0,0],\"radius\":1,\"id\":" \
	"\"n0\"}"

static void test_refs_that_double(void **state)
{
	struct text t = {0};

	add(&t, "{\"points\":[[0,0,0]],\"scene\":", 1);
	add_bomb(&t, LEAF, 13);
	add(&t, "}", 1);
	/* 15 ms, 2 MB: 32726 nodes of 1.3 kB */
	assert_answer(state, "refs, 32726 nodes", "/v1/eval", &t, 200,
	    "value");
	add_bomb(&t, LEAF, 14);
	/* 3 ms, 1 MB */
	assert_answer(state, "refs, 65494 nodes", "/v1/scenes/a", &t, 422,
	    "/root/children/0: more than 32768 nodes");
	add_bomb(&t, LEAF, 60);
	/* 2 ms: 2^60 nodes take no longer */
	assert_answer(state, "refs, 2^60 nodes", "/v1/scenes/a", &t, 422,
	    "more than 32768 nodes");
}

static void test_refs_to_many_elements(void **state)
{
	struct text t = {0}, leaf = {0};

	add(&leaf, "{\"type\":\"convolution\",\"radius\":1,\"id\":\"n0\","
	    "\"elements\":[", 1);
	add(&leaf, "{\"point\":[0,0,0]},", 999);
	add(&leaf, "{\"point\":[0,0,0]}]}", 1);
	add_bomb(&t, leaf.at, 7);
	/* Elements are nodes: 127 times 1000. */
	assert_answer(state, "refs to 1000 elements", "/v1/scenes/a", &t, 422,
	    "more than 32768 nodes");
	free(leaf.at);
}

static void test_wide_documents(void **state)
{
	struct text t = {0};

	add(&t, HEAD "\"root\":{\"type\":\"union\",\"children\":[", 1);
	add(&t, POINT ",", 99999);
	add(&t, POINT "]}}", 1);
	/* 111 ms, 51 MB */
	assert_answer(state, "100000 children", "/v1/scenes/a", &t, 422,
	    "/root/children: more than 32768 nodes");
	add(&t, HEAD "\"root\":{\"type\":\"union\",\"children\":[", 1);
	add(&t, "{\"type\":\"x\"},", 29999);
	add(&t, "{\"type\":\"x\"}]}}", 1);
	/* 55 ms, 3 MB: 16 of the faults are told, the others counted */
	assert_answer(state, "30000 wrong children", "/v1/scenes/a", &t, 422,
	    "30000 places are wrong");
	add(&t, HEAD "\"root\":{\"type\":\"convolution\",\"radius\":1,"
	    "\"elements\":[", 1);
	add(&t, "{\"point\":[0,0,0]},", 40000);
	add(&t, "{\"point\":[0,0,0]}]}}", 1);
	assert_answer(state, "40001 elements", "/v1/scenes/a", &t, 422,
	    "/root/elements: more than 32768 nodes");
}

static void test_members_without_end(void **state)
{
	struct text t = {0};
	char piece[32];

	add(&t, HEAD "\"root\":{}", 1);
	for (int i = 0; i < 200000; i++) {
		snprintf(piece, sizeof piece, ",\"o%d\":0", i);
		add(&t, piece, 1);
	}
	add(&t, "}", 1);
	/* 50 ms, 20 MB (110 ms and 50 MB for 500000) */
	assert_answer(state, "200000 members", "/v1/scenes/a", &t, 422,
	    "places are wrong");
	add(&t, HEAD "\"root\":{},\"operators\":{\"o\":{}", 1);
	for (int i = 0; i < 256; i++) {
		snprintf(piece, sizeof piece, ",\"o%d\":{}", i);
		add(&t, piece, 1);
	}
	add(&t, "}}", 1);
	assert_answer(state, "257 operators", "/v1/scenes/a", &t, 422,
	    "/operators: more than 256 operators");
}

static void test_values_without_end(void **state)
{
	struct text t = {0};

	add(&t, HEAD "\"operators\":[", 1);
	add(&t, "0,", 2100000);
	add(&t, "0]}", 1);
	/* 153 ms, 131 MB: the most that JSON of two bytes a value can take */
	assert_answer(state, "2100000 values", "/v1/scenes/a", &t, 422,
	    "/operators");
	add(&t, HEAD "\"operators\":[", 1);
	add(&t, "0,", 3000000);
	add(&t, "0]}", 1);
	assert_answer(state, "3000000 values", "/v1/scenes/a", &t, 422,
	    "/problems/limit");
}

static void test_depth(void **state)
{
	struct text t = {0};

	add(&t, HEAD "\"root\":", 1);
	add(&t, "[", 10000000);
	/* 10 ms, 10 MB: that of the body */
	assert_answer(state, "1e7 brackets", "/v1/scenes/a", &t, 422,
	    "/problems/limit");
	add(&t, HEAD "\"root\":", 1);
	add(&t, "{\"type\":\"union\",\"children\":[", 65);
	add(&t, POINT, 1);
	add(&t, "]}", 65);
	add(&t, "}", 1);
	assert_answer(state, "65 unions deep", "/v1/scenes/a", &t, 422,
	    "/problems/limit");
	add(&t, HEAD "\"root\":", 1);
	add(&t, "{\"type\":\"twist\",\"axis\":[0,0,1],\"rate\":1,"
	    "\"child\":", 40);
	add(&t, POINT, 1);
	add(&t, "}", 41);
	assert_answer(state, "40 warps", "/v1/scenes/a", &t, 422,
	    "/problems/limit");
}

static void test_long_numbers_and_strings(void **state)
{
	struct text t = {0};

	add(&t, HEAD "\"root\":{},\"null_gradient\":0.", 1);
	add(&t, "1", 10000000);
	add(&t, "}", 1);
	/* 40 ms, 9 MB */
	assert_answer(state, "1e7 digits", "/v1/scenes/a", &t, 422, "/root");
	add(&t, HEAD "\"root\":{},\"null_gradient\":1e", 1);
	add(&t, "9", 10000000);
	add(&t, "}", 1);
	assert_answer(state, "1e7 digits of an exponent", "/v1/scenes/a", &t,
	    422, "/null_gradient: too large a number");
	add(&t, HEAD "\"root\":{},\"name\":\"", 1);
	add(&t, "\\u0041", 2000000);
	add(&t, "\"}", 1);
	assert_answer(state, "a name of 1.2e7 bytes", "/v1/scenes/a", &t, 422,
	    "/name: must have at most 256 bytes");
	add(&t, HEAD "\"root\":{},\"", 1);
	add(&t, "k", 10000000);
	add(&t, "\":1}", 1);
	/* The answer is short all the same. */
	assert_answer(state, "a key of 1e7 bytes", "/v1/scenes/a", &t, 422,
	    "kkk...kkk");
	add(&t, " ", 10000000);
	add(&t, "{}", 1);
	assert_answer(state, "1e7 spaces", "/v1/scenes/a", &t, 422,
	    "'format' is missing");
}

static void test_documents_of_too_many_bytes(void **state)
{
	struct text t = {0};

	add(&t, HEAD "\"root\":" POINT, 1);
	add(&t, " ", (16 << 20) - t.length - 1);
	add(&t, "}", 1);
	/* 60 ms, 33 MB: the body, and the text that is kept */
	assert_answer(state, "a document of 16 MiB", "/v1/scenes/a", &t, 201,
	    "revision");
	add(&t, HEAD "\"root\":" POINT, 1);
	add(&t, " ", (16 << 20) - t.length);
	add(&t, "}", 1);
	/* Not parsed. */
	assert_answer(state, "one byte more", "/v1/scenes/a", &t, 422,
	    "the document has 16777217 bytes; 16777216 are the most");
	add(&t, "{\"points\":[[0,0,0]],\"scene\":[", 1);
	add(&t, "0,", 12000000);
	add(&t, "0]}", 1);
	assert_answer(state, "24 MB besides points", "/v1/eval", &t, 422,
	    "bytes besides the points; 16777216 are the most");
	/* Points may be as many bytes as there are. */
	add(&t, "{\"scene\":" HEAD "\"root\":" POINT "},\"points\":[", 1);
	add(&t, "[0,0,0],                                ", 499999);
	add(&t, "[0,0,0]]}", 1);
	assert_answer(state, "20 MB of points", "/v1/eval", &t, 200,
	    "\"count\":500000");
}

static void test_tables_beyond_their_memory(void **state)
{
	struct text t = {0};
	char piece[200];

	add(&t, "{\"points\":[[0,0,0]],\"scene\":" HEAD "\"operators\":{", 1);
	for (int i = 0; i < 3; i++) {
		snprintf(piece, sizeof piece, "%s\"o%d\":{\"resolution\":128,"
		    "\"profile\":{\"type\":\"bulge\",\"k\":0.4%d}}",
		    i > 0 ? "," : "", i, i);
		add(&t, piece, 1);
	}
	add(&t, "},\"root\":{\"type\":\"union\",\"children\":[", 1);
	for (int i = 0; i < 3; i++) {
		snprintf(piece, sizeof piece, "%s{\"type\":\"union\","
		    "\"operator\":\"o%d\",\"children\":[" POINT "," POINT "]}",
		    i > 0 ? "," : "", i);
		add(&t, piece, 1);
	}
	add(&t, "]}}}", 1);
	/* 0.6 ms; two such operators would take 6.7 s of a core */
	assert_answer(state, "3 tables of 101 MB", "/v1/eval", &t, 422,
	    "/scene/operators: the tables of all operators together");
}

static void test_others_are_answered_meanwhile(void **state)
{
	/* After all that the daemon is as it was. */
	const struct daemon *d = *state;
	struct http_reply reply;

	http_json(d->url, "POST", "/v1/eval", "{\"scene\":" HEAD "\"root\":"
	    POINT "},\"points\":[[1,0,0]]}", &reply);
	assert_int_equal(reply.status, 200);
	http_reply_fini(&reply);
	print_message("measured: %ld MB after all\n", megabytes(d, "VmRSS"));
}

int main(void)
{
	const struct CMUnitTest tests[] = {
		cmocka_unit_test(test_refs_that_double),
		cmocka_unit_test(test_refs_to_many_elements),
		cmocka_unit_test(test_wide_documents),
		cmocka_unit_test(test_members_without_end),
		cmocka_unit_test(test_values_without_end),
		cmocka_unit_test(test_depth),
		cmocka_unit_test(test_long_numbers_and_strings),
		cmocka_unit_test(test_documents_of_too_many_bytes),
		cmocka_unit_test(test_tables_beyond_their_memory),
		cmocka_unit_test(test_others_are_answered_meanwhile),
	};

	return cmocka_run_group_tests(tests, daemon_setup, daemon_teardown);
}
