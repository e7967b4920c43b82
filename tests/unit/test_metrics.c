/*
 * What is counted, and how it is printed; with a route table and gauges of the
 * test's own.
 */
#include <stdarg.h>
#include <stddef.h>
#include <setjmp.h>
#include <stdint.h>
#include <cmocka.h>

#include <math.h>
#include <pthread.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <time.h>

#include "kernels/device.h"
#include "server/exchange.h"
#include "server/metrics.h"
#include "server/metrics_internal.h"
#include "server/routes.h"
#include "tests/support/exposition.h"
#include "tests/support/near.h"

#define COUNT(array) (sizeof(array) / sizeof *(array))
#define THREADS 4
#define REQUESTS 20000

#define EVAL "endpoint=\"/v1/eval\",method=\"POST\""
#define DURATION "blobfield_http_request_duration_seconds"
#define STAGE "blobfield_stage_duration_seconds"

static const struct route routes[] = {
	{.method = "GET", .pattern = "/v1/scenes/{id}"},
	{.method = "PUT", .pattern = "/v1/scenes/{id}"},
	{.method = "POST", .pattern = "/v1/eval"},
};

const struct route *route_list(size_t *count)
{
	*count = COUNT(routes);
	return routes;
}

/* Values that a device might give, for the gauges' turn. */
static const char *label = "plain";

void metrics_print_gauges(struct metrics_page *p, struct server *server)
{
	(void)server;
	metrics_page_family(p, "test_info", "gauge", "two\nlines, a \\ and a "
	    "\"");
	metrics_page_sample(p, "", (struct metrics_label[]){{"name", label},
	    {NULL, NULL}}, 1.0);
}

static int setup(void **state)
{
	struct metrics *m;

	if (metrics_create(&m) != ERR_OK)
		return -1;
	*state = m;
	return 0;
}

static int teardown(void **state)
{
	metrics_free(*state);
	return 0;
}

/* What m says; for exposition_free. */
static struct exposition *read_page(struct metrics *m)
{
	size_t length;
	char *text = metrics_print(m, NULL, &length);
	struct exposition *e;

	assert_non_null(text);
	e = exposition_read(text, length);
	free(text);
	return e;
}

static struct exchange exchange_of(const struct route *route,
    const char *method, unsigned status)
{
	return (struct exchange){.route = route, .method = method,
	    .status = status, .problem = PROBLEM_COUNT, .body_seen = 10,
	    .answer_length = 100};
}

static double value_of(struct metrics *m, const char *series)
{
	struct exposition *e = read_page(m);
	double value = exposition_value(e, series);

	exposition_free(e);
	return value;
}

static void assert_value(struct metrics *m, const char *series, double value)
{
	assert_near(value_of(m, series), value, 0.0);
}

/* ---- requests ---- */

static void test_metrics_fresh_page_is_well_formed(void **state)
{
	struct exposition *e = read_page(*state);

	assert_near(exposition_value(e,
	    "blobfield_problems_total{reason=\"queue-full\"}"), 0.0, 0.0);
	assert_int_equal(exposition_count(e), PROBLEM_COUNT);
	exposition_free(e);
}

static void test_metrics_count_requests_by_route_method_status(void **state)
{
	struct exchange get = exchange_of(&routes[0], "GET", 200);
	struct exchange head = exchange_of(&routes[0], "HEAD", 200);
	struct exchange put = exchange_of(&routes[1], "PUT", 201);

	metrics_count_exchange(*state, &get, 1e-3);
	metrics_count_exchange(*state, &get, 1e-3);
	metrics_count_exchange(*state, &head, 1e-3);
	metrics_count_exchange(*state, &put, 1e-3);
	get.status = 304;
	metrics_count_exchange(*state, &get, 1e-3);
#define REQUEST(method, status) "blobfield_http_requests_total{" \
	"endpoint=\"/v1/scenes/{id}\",method=\"" method "\",status=\"" \
	status "\"}"
	assert_value(*state, REQUEST("GET", "200"), 2.0);
	assert_value(*state, REQUEST("HEAD", "200"), 1.0);
	assert_value(*state, REQUEST("PUT", "201"), 1.0);
	assert_value(*state, REQUEST("GET", "304"), 1.0);
	assert_value(*state, "blobfield_http_request_bytes_total{endpoint="
	    "\"/v1/scenes/{id}\",method=\"GET\"}", 40.0);
	assert_value(*state, "blobfield_http_response_bytes_total{endpoint="
	    "\"/v1/scenes/{id}\",method=\"PUT\"}", 100.0);
}

/* However many paths, methods and statuses clients think of. */
static void test_metrics_strangers_share_series(void **state)
{
	size_t count;
	struct exposition *e;

	for (unsigned i = 0; i < 1000; i++) {
		char method[16];
		struct exchange x = exchange_of(NULL, method, 1000 + i);

		snprintf(method, sizeof method, "M%u", i);
		snprintf(x.target, sizeof x.target, "/%u", i);
		metrics_count_exchange(*state, &x, 1e-3);
	}
	e = read_page(*state);
	count = exposition_count(e);
	exposition_free(e);
	/* One of requests, a histogram, two of bytes, the problems. */
	assert_int_equal(count, 1 + METRICS_BOUNDS + 1 + 2 + 2 +
	    PROBLEM_COUNT);
	assert_value(*state, "blobfield_http_requests_total{endpoint="
	    "\"other\",method=\"other\",status=\"other\"}", 1000.0);
}

static void test_metrics_request_without_an_answer(void **state)
{
	struct exchange x = exchange_of(&routes[2], "POST", 0);
	struct exchange none = exchange_of(NULL, NULL, 0);

	metrics_count_exchange(*state, &x, 1e-3);
	metrics_count_exchange(*state, &none, 1e-3);
	assert_value(*state, "blobfield_http_requests_total{" EVAL
	    ",status=\"none\"}", 1.0);
	assert_value(*state, "blobfield_http_requests_total{endpoint="
	    "\"other\",method=\"other\",status=\"none\"}", 1.0);
}

static void test_metrics_count_problems(void **state)
{
	struct exchange x = exchange_of(&routes[2], "POST", 503);

	x.problem = PROBLEM_QUEUE_FULL;
	metrics_count_exchange(*state, &x, 1e-3);
	metrics_count_refusal(*state, PROBLEM_QUEUE_FULL);
	metrics_count_refusal(*state, PROBLEM_COUNT); /* none */
	assert_value(*state, "blobfield_problems_total{reason=\"queue-full\"}",
	    2.0);
	assert_value(*state, "blobfield_problems_total{reason=\"draining\"}",
	    0.0);
}

/* ---- histograms ---- */

static void test_metrics_buckets_hold_their_bounds(void **state)
{
	struct exchange x = exchange_of(&routes[2], "POST", 200);
	static const double seconds[] = {0.0, 1e-5, 1.0001e-5, 100.0, 100.1};

	for (size_t i = 0; i < COUNT(seconds); i++)
		metrics_count_exchange(*state, &x, seconds[i]);
	assert_value(*state, DURATION "_bucket{" EVAL ",le=\"1e-05\"}", 2.0);
	assert_value(*state, DURATION "_bucket{" EVAL ",le=\"2e-05\"}", 3.0);
	assert_value(*state, DURATION "_bucket{" EVAL ",le=\"50\"}", 3.0);
	assert_value(*state, DURATION "_bucket{" EVAL ",le=\"100\"}", 4.0);
	assert_value(*state, DURATION "_bucket{" EVAL ",le=\"+Inf\"}", 5.0);
	assert_value(*state, DURATION "_count{" EVAL "}", 5.0);
	/* Each is cut to a whole nanosecond. */
	assert_near(value_of(*state, DURATION "_sum{" EVAL "}"),
	    200.1 + 2.0001e-5, 5e-9);
}

static void test_metrics_bounds_are_1_2_5(void **state)
{
	static const double first[] = {1.0, 2.0, 5.0};

	(void)state;
	for (int i = 0; i < METRICS_BOUNDS; i++)
		assert_near(metrics_bounds[i] / (first[i % 3] *
		    pow(10.0, i / 3 - 5)), 1.0, 1e-12);
}

static void test_metrics_odd_seconds_do_no_harm(void **state)
{
	struct exchange x = exchange_of(&routes[2], "POST", 200);

	metrics_count_exchange(*state, &x, -1.0);
	metrics_count_exchange(*state, &x, (double)NAN);
	metrics_count_exchange(*state, &x, (double)INFINITY);
	assert_value(*state, DURATION "_bucket{" EVAL ",le=\"1e-05\"}", 2.0);
	assert_value(*state, DURATION "_count{" EVAL "}", 3.0);
	assert_true(value_of(*state, DURATION "_sum{" EVAL "}") <= 1e6);
}

static void test_metrics_stages_are_apart(void **state)
{
	struct exchange x = exchange_of(&routes[2], "POST", 200);
	const struct device_times times = {1e-4, 2e-3, 3e-5};

	metrics_observe(*state, &x, METRICS_QUEUE, 0.25);
	metrics_observe_device(*state, &x, &times);
	metrics_observe(*state, NULL, METRICS_COMMIT, 0.5);
	metrics_observe(NULL, &x, METRICS_QUEUE, 0.25);
	assert_near(value_of(*state, STAGE "_sum{" EVAL ",stage=\"queue\"}"),
	    0.25, 1e-9);
	assert_near(value_of(*state, STAGE "_sum{" EVAL ",stage=\"upload\"}"),
	    1e-4, 1e-9);
	assert_near(value_of(*state, STAGE "_sum{" EVAL ",stage=\"kernel\"}"),
	    2e-3, 1e-9);
	assert_near(value_of(*state, STAGE "_sum{" EVAL
	    ",stage=\"download\"}"), 3e-5, 1e-9);
	assert_near(value_of(*state, STAGE "_sum{endpoint=\"other\","
	    "method=\"other\",stage=\"commit\"}"), 0.5, 1e-9);
	assert_value(*state, STAGE "_count{" EVAL ",stage=\"queue\"}", 1.0);
}

/* ---- the text ---- */

static void test_metrics_labels_and_helps_are_escaped(void **state)
{
	struct server *any = (struct server *)state; /* the gauges' own */
	size_t length;
	char *text;

	label = "a \"b\" \\ c\nd";
	text = metrics_print(*state, any, &length);
	label = "plain";
	assert_non_null(text);
	exposition_free(exposition_read(text, length));
	assert_non_null(memmem(text, length, "{name=\"a \\\"b\\\" \\\\ "
	    "c\\nd\"} 1\n", 26));
	assert_non_null(memmem(text, length,
	    "# HELP test_info two\\nlines, a \\\\ and a \"\n", 40));
	free(text);
}

static void test_metrics_numbers_are_exact(void **state)
{
	static const struct {
		double value;
		const char *text;
	} cases[] = {{0.0, " 0\n"}, {1e15, " 1000000000000000\n"},
	    {0.1, " 0.1\n"}, {1e300, " 1e+300\n"}, {-3.0, " -3\n"},
	    {(double)NAN, " NaN\n"}, {(double)INFINITY, " +Inf\n"},
	    {-(double)INFINITY, " -Inf\n"}, {1.5e-9, " 1.5e-09\n"}};

	(void)state;
	for (size_t i = 0; i < COUNT(cases); i++) {
		struct metrics_page p = {.family = "x"};

		metrics_page_sample(&p, "", NULL, cases[i].value);
		assert_int_equal(p.length, 1 + strlen(cases[i].text));
		assert_memory_equal(p.text + 1, cases[i].text, p.length - 1);
		free(p.text);
	}
}

/* ---- threads, and what it costs ---- */

static double now(void)
{
	struct timespec t;

	clock_gettime(CLOCK_PROCESS_CPUTIME_ID, &t);
	return (double)t.tv_sec + 1e-9 * (double)t.tv_nsec;
}

/* All that the daemon counts of one evaluation. */
static void count_one(struct metrics *m, const struct exchange *x)
{
	static const struct device_times times = {1e-5, 3e-5, 1e-6};

	metrics_observe(m, x, METRICS_PARSE, 2e-5);
	metrics_observe(m, x, METRICS_QUEUE, 1e-5);
	metrics_observe_device(m, x, &times);
	metrics_observe(m, x, METRICS_PRINT, 2e-5);
	metrics_count_exchange(m, x, 2e-4);
}

static void *count_many(void *arg)
{
	struct exchange x = exchange_of(&routes[2], "POST", 200);

	for (int i = 0; i < REQUESTS; i++)
		count_one(arg, &x);
	return NULL;
}

static void test_metrics_threads_lose_nothing(void **state)
{
	pthread_t threads[THREADS];
	struct exposition *e;

	for (int i = 0; i < THREADS; i++)
		assert_int_equal(pthread_create(&threads[i], NULL, count_many,
		    *state), 0);
	/* What is read meanwhile is well-formed. */
	for (int i = 0; i < 10; i++)
		exposition_free(read_page(*state));
	for (int i = 0; i < THREADS; i++)
		pthread_join(threads[i], NULL);
	e = read_page(*state);
	assert_near(exposition_value(e, DURATION "_count{" EVAL "}"),
	    THREADS * REQUESTS, 0.0);
	assert_near(exposition_value(e, STAGE "_sum{" EVAL
	    ",stage=\"kernel\"}"), THREADS * REQUESTS * 3e-5, 1e-6);
	exposition_free(e);
}

static void test_metrics_counting_costs_little(void **state)
{
	double begin = now(), seconds;

	count_many(*state);
	seconds = (now() - begin) / REQUESTS;
	printf("measured: counting one evaluation: %.0f ns\n", 1e9 * seconds);
	/* 166 ns on a core of a server; sanitizers and busy neighbours too. */
	assert_true(seconds < 2e-5);
}

int main(void)
{
#define CASE(name) cmocka_unit_test_setup_teardown(name, setup, teardown)
	const struct CMUnitTest tests[] = {
		CASE(test_metrics_fresh_page_is_well_formed),
		CASE(test_metrics_count_requests_by_route_method_status),
		CASE(test_metrics_strangers_share_series),
		CASE(test_metrics_request_without_an_answer),
		CASE(test_metrics_count_problems),
		CASE(test_metrics_buckets_hold_their_bounds),
		CASE(test_metrics_bounds_are_1_2_5),
		CASE(test_metrics_odd_seconds_do_no_harm),
		CASE(test_metrics_stages_are_apart),
		CASE(test_metrics_labels_and_helps_are_escaped),
		CASE(test_metrics_numbers_are_exact),
		CASE(test_metrics_threads_lose_nothing),
		CASE(test_metrics_counting_costs_little),
	};

	return cmocka_run_group_tests(tests, NULL, NULL);
}
