/*
 * GET /metrics of a daemon that has work to do, read by a strict reader and by
 * Prometheus's own; what /v1/info and /readyz say beside it; and request ids.
 */
#include <stdarg.h>
#include <stddef.h>
#include <setjmp.h>
#include <stdint.h>
#include <cmocka.h>

#include <math.h>
#include <stdbool.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <unistd.h>

#include <cjson/cJSON.h>

#include "tests/support/daemon.h"
#include "tests/support/exposition.h"
#include "tests/support/http.h"
#include "tests/support/near.h"

#define COUNT(array) (sizeof(array) / sizeof *(array))
#define URL(state) (((const struct daemon *)*(state))->url)

#define POINT "{\"format\":\"blobfield/1\",\"root\":{\"type\":\"point\"," \
	"\"center\":[0,0,0],\"radius\":1}}"
#define EVAL "{\"scene\":" POINT ",\"points\":[[0,0,0],[0.5,0,0]]}"
#define EVAL_LABELS "endpoint=\"/v1/eval\",method=\"POST\""

/* Prometheus's own reader, where Debian's python3-prometheus-client is. */
#define READER "/usr/bin/python3 -c 'import sys\n" \
	"from prometheus_client.parser import " \
	"text_string_to_metric_families as read\n" \
	"print(sum(len(f.samples) for f in read(open(sys.argv[1]).read())))' "

static struct exposition *read_page(const char *url)
{
	struct http_reply reply;
	struct exposition *e;

	http_get(url, "/metrics", &reply);
	assert_int_equal(reply.status, 200);
	e = exposition_read(reply.body, reply.length);
	http_reply_fini(&reply);
	return e;
}

static double value_of(const char *url, const char *series)
{
	struct exposition *e = read_page(url);
	double value = exposition_value(e, series);

	exposition_free(e);
	return isnan(value) ? 0.0 : value;
}

static long ask(const char *url, const char *method, const char *path,
    const char *header, struct http_reply *reply)
{
	http_do(url, &(struct http_request){
		.method = method,
		.path = path,
		.headers = {header},
	}, reply);
	return reply->status;
}

static void assert_eval(const char *url)
{
	struct http_reply reply;

	http_json(url, "POST", "/v1/eval", EVAL, &reply);
	assert_int_equal(reply.status, 200);
	http_reply_fini(&reply);
}

/* Counted when the answer has left, which a client may have before. */
static void await_value(const char *url, const char *series, double value)
{
	for (int i = 0; i < 3000 && value_of(url, series) < value; i++)
		usleep(10000);
	assert_near(value_of(url, series), value, 0.0);
}

/* ---- the page ---- */

static void test_metrics_page_is_well_formed(void **state)
{
	char type[80], cache[40];
	struct http_reply reply;
	struct exposition *e;

	http_get(URL(state), "/metrics", &reply);
	assert_int_equal(reply.status, 200);
	assert_string_equal(http_header(&reply, "Content-Type", type,
	    sizeof type), "text/plain; version=0.0.4; charset=utf-8");
	assert_string_equal(http_header(&reply, "Cache-Control", cache,
	    sizeof cache), "no-store");
	e = exposition_read(reply.body, reply.length);
	assert_true(exposition_count(e) > 60);
	exposition_free(e);
	http_reply_fini(&reply);
}

static void test_metrics_prometheus_reads_as_much(void **state)
{
	char path[] = "/tmp/test_metrics.XXXXXX", command[600], line[40] = "";
	int fd = mkstemp(path);
	struct http_reply reply;
	struct exposition *e;
	FILE *pipe;

	assert_true(fd >= 0);
	assert_eval(URL(state));
	http_get(URL(state), "/metrics", &reply);
	assert_int_equal(write(fd, reply.body, reply.length), reply.length);
	close(fd);
	if (system("/usr/bin/python3 -c 'import prometheus_client' "
	    "2>/dev/null") != 0) {
		unlink(path);
		http_reply_fini(&reply);
		skip();
	}
	snprintf(command, sizeof command, READER "%s", path);
	pipe = popen(command, "r");
	assert_non_null(pipe);
	assert_non_null(fgets(line, sizeof line, pipe));
	assert_int_equal(pclose(pipe), 0);
	unlink(path);
	e = exposition_read(reply.body, reply.length);
	assert_int_equal(atoi(line), exposition_count(e));
	exposition_free(e);
	http_reply_fini(&reply);
}

static void test_metrics_evaluation_has_all_stages(void **state)
{
	static const char *const stages[] = {"parse", "queue", "upload",
	    "kernel", "download", "print"};
	double requests = value_of(URL(state), "blobfield_http_requests_total{"
	    EVAL_LABELS ",status=\"200\"}");
	struct exposition *e;

	assert_eval(URL(state));
	await_value(URL(state), "blobfield_http_requests_total{" EVAL_LABELS
	    ",status=\"200\"}", requests + 1.0);
	e = read_page(URL(state));
	for (size_t i = 0; i < COUNT(stages); i++) {
		char series[200];

		snprintf(series, sizeof series, "blobfield_stage_duration_"
		    "seconds_count{" EVAL_LABELS ",stage=\"%s\"}", stages[i]);
		assert_near(exposition_value(e, series), requests + 1.0, 0.0);
	}
	assert_true(exposition_value(e, "blobfield_stage_duration_seconds_sum{"
	    EVAL_LABELS ",stage=\"kernel\"}") > 0.0);
	exposition_free(e);
}

static void test_metrics_stages_are_within_the_whole(void **state)
{
	struct exposition *e;
	double sum = 0.0, all;

	assert_eval(URL(state));
	e = read_page(URL(state));
	all = exposition_value(e, "blobfield_http_request_duration_seconds_sum"
	    "{" EVAL_LABELS "}");
#define STAGE_SUM(stage) exposition_value(e, \
	"blobfield_stage_duration_seconds_sum{" EVAL_LABELS ",stage=\"" stage \
	"\"}")
	sum = STAGE_SUM("parse") + STAGE_SUM("queue") + STAGE_SUM("upload") +
	    STAGE_SUM("kernel") + STAGE_SUM("download") + STAGE_SUM("print");
	printf("measured: stages are %.0f %% of evaluations' time\n",
	    100.0 * sum / all);
	assert_true(sum > 0.0 && sum <= all);
	exposition_free(e);
}

static void test_metrics_batches_and_points_are_counted(void **state)
{
	double points = value_of(URL(state), "blobfield_device_points_total");
	double jobs = value_of(URL(state),
	    "blobfield_device_launch_jobs_total");

	assert_eval(URL(state));
	await_value(URL(state), "blobfield_device_points_total", points + 2.0);
	await_value(URL(state), "blobfield_device_launch_jobs_total",
	    jobs + 1.0);
}

static void test_metrics_task_has_device_stages(void **state)
{
	struct http_reply reply;

	http_json(URL(state), "PUT", "/v1/scenes/point", POINT, &reply);
	http_reply_fini(&reply);
	http_json(URL(state), "POST", "/v1/scenes/point/raycast",
	    "{\"rays\":[[0,0,5,0,0,-1]]}", &reply);
	assert_int_equal(reply.status, 200);
	http_reply_fini(&reply);
	await_value(URL(state), "blobfield_stage_duration_seconds_count{"
	    "endpoint=\"/v1/scenes/{id}/raycast\",method=\"POST\","
	    "stage=\"kernel\"}", 1.0);
	await_value(URL(state), "blobfield_stage_duration_seconds_count{"
	    "endpoint=\"/v1/scenes/{id}/raycast\",method=\"POST\","
	    "stage=\"queue\"}", 1.0);
}

/* How many series there are, once all that has been answered is counted. */
static size_t await_count(const char *url)
{
	size_t count = 0;

	for (int same = 0; same < 10; usleep(20000)) {
		struct exposition *e = read_page(url);

		same = exposition_count(e) == count ? same + 1 : 0;
		count = exposition_count(e);
		exposition_free(e);
	}
	return count;
}

/* What clients make up must make no series. */
static void test_metrics_paths_are_no_labels(void **state)
{
	struct http_reply reply;
	struct exposition *e;
	size_t before;

	assert_int_equal(ask(URL(state), NULL, "/v1/scenes/none", NULL,
	    &reply), 404);
	http_reply_fini(&reply);
	assert_int_equal(ask(URL(state), NULL, "/none", NULL, &reply), 404);
	http_reply_fini(&reply);
	before = await_count(URL(state));
	for (int i = 0; i < 40; i++) {
		char path[64];

		snprintf(path, sizeof path, i % 2 ? "/v1/scenes/none%d" :
		    "/none%d", i);
		assert_int_equal(ask(URL(state), NULL, path, NULL, &reply),
		    404);
		http_reply_fini(&reply);
	}
	e = read_page(URL(state));
	assert_int_equal(exposition_count(e), before);
	exposition_free(e);
}

static void test_metrics_refusals_have_reasons(void **state)
{
	static const char invalid[] = "blobfield_problems_total{reason="
	    "\"invalid\"}";
	double before = value_of(URL(state), invalid);
	struct http_reply reply;

	http_json(URL(state), "POST", "/v1/eval", "{}", &reply);
	assert_int_equal(reply.status, 422);
	http_reply_fini(&reply);
	await_value(URL(state), invalid, before + 1.0);
}

static void test_metrics_process_is_told(void **state)
{
	struct exposition *e = read_page(URL(state));

	assert_true(exposition_value(e, "process_resident_memory_bytes") >
	    1e6);
	assert_true(exposition_value(e, "process_open_fds") > 3.0);
	assert_true(exposition_value(e, "process_cpu_seconds_total") > 0.0);
	assert_true(exposition_value(e, "process_start_time_seconds") > 1.7e9);
	assert_near(exposition_value(e, "blobfield_ready"), 1.0, 0.0);
	assert_near(exposition_value(e, "blobfield_draining"), 0.0, 0.0);
	assert_true(exposition_value(e, "blobfield_table_bytes") > 0.0);
	exposition_free(e);
}

/* ---- request ids ---- */

static void assert_id(const char *url, const char *sent, bool is_kept)
{
	char header[200], id[100];
	struct http_reply reply;

	snprintf(header, sizeof header, "X-Request-Id: %s", sent);
	ask(url, NULL, "/healthz", header, &reply);
	http_header(&reply, "X-Request-Id", id, sizeof id);
	http_reply_fini(&reply);
	if (is_kept)
		assert_string_equal(id, sent);
	else
		assert_true(strcmp(id, sent) != 0 && strlen(id) == 25);
}

static void test_request_id_is_kept_if_it_is_one(void **state)
{
	static const char longest[] = "0123456789abcdefghijklmnopqrstuvwxyz"
	    "ABCDEFGHIJKLMNOPQRSTUVWXYZ.:";

	assert_int_equal(strlen(longest), 64);
	assert_id(URL(state), "a", true);
	assert_id(URL(state), "3f9a-b_c.d:e", true);
	assert_id(URL(state), longest, true);
	assert_id(URL(state), "0123456789abcdefghijklmnopqrstuvwxyz"
	    "ABCDEFGHIJKLMNOPQRSTUVWXYZ.:-", false);
	assert_id(URL(state), "a b", false);
	assert_id(URL(state), "a\"b", false);
	assert_id(URL(state), "a,b", false);
	assert_id(URL(state), "\xc3\xb6", false);
}

static void test_request_ids_differ(void **state)
{
	char ids[20][100];

	for (size_t i = 0; i < COUNT(ids); i++) {
		struct http_reply reply;

		http_get(URL(state), "/healthz", &reply);
		http_header(&reply, "X-Request-Id", ids[i], sizeof ids[i]);
		http_reply_fini(&reply);
		assert_int_equal(strlen(ids[i]), 25);
		for (size_t k = 0; k < i; k++)
			assert_string_not_equal(ids[i], ids[k]);
	}
}

static void test_request_id_is_on_every_answer(void **state)
{
	static const struct {
		const char *method, *path;
		long status;
	} cases[] = {
		{"GET", "/", 200}, {"GET", "/nothing", 404},
		{"DELETE", "/metrics", 405}, {"OPTIONS", "/metrics", 204},
		{"HEAD", "/metrics", 200}, {"GET", "/v1/info?x=1", 400},
		{"GET", "/v1/scenes/none", 404}, {"GET", "/openapi.json", 200},
	};

	for (size_t i = 0; i < COUNT(cases); i++) {
		struct http_reply reply;
		char id[100];

		assert_int_equal(ask(URL(state), cases[i].method,
		    cases[i].path, "X-Request-Id: mine", &reply),
		    cases[i].status);
		assert_string_equal(http_header(&reply, "X-Request-Id", id,
		    sizeof id), "mine");
		http_reply_fini(&reply);
	}
}

/* ---- what else operators read ---- */

static void test_info_tells_store_listeners_and_security(void **state)
{
	struct http_reply reply;
	cJSON *json, *store, *listeners, *security;

	http_get(URL(state), "/v1/info", &reply);
	json = cJSON_Parse(reply.body);
	http_reply_fini(&reply);
	assert_non_null(json);
	store = cJSON_GetObjectItem(json, "store");
	assert_string_equal(cJSON_GetStringValue(cJSON_GetObjectItem(store,
	    "kind")), "memory");
	assert_true(cJSON_IsTrue(cJSON_GetObjectItem(store, "ready")));
	assert_true(cJSON_IsTrue(cJSON_GetObjectItem(store, "well")));
	listeners = cJSON_GetObjectItem(json, "listeners");
	assert_int_equal(cJSON_GetObjectItem(listeners, "count")->valueint,
	    0);
	assert_true(cJSON_GetObjectItem(listeners, "max")->valueint > 0);
	security = cJSON_GetObjectItem(json, "security");
	assert_true(cJSON_IsFalse(cJSON_GetObjectItem(security, "tokens")));
	assert_true(cJSON_IsFalse(cJSON_GetObjectItem(security, "tls")));
	cJSON_Delete(json);
}

static void test_readyz_says_which_part_is_not(void **state)
{
	struct http_reply reply;
	struct daemon d;

	(void)state;
	daemon_start(&d, NULL);
	http_get(d.url, "/readyz", &reply);
	if (reply.status == 503) {
		assert_non_null(strstr(reply.body, "operator tables"));
		assert_non_null(strstr(reply.body, "not-ready"));
	}
	http_reply_fini(&reply);
	daemon_await_ready(&d);
	http_get(d.url, "/readyz", &reply);
	assert_string_equal(reply.body, "{\"status\":\"ready\"}\n");
	http_reply_fini(&reply);
	assert_int_equal(daemon_stop(&d, 15), 0);
}

int main(void)
{
	const struct CMUnitTest tests[] = {
		cmocka_unit_test(test_metrics_page_is_well_formed),
		cmocka_unit_test(test_metrics_evaluation_has_all_stages),
		cmocka_unit_test(test_metrics_stages_are_within_the_whole),
		cmocka_unit_test(test_metrics_batches_and_points_are_counted),
		cmocka_unit_test(test_metrics_task_has_device_stages),
		cmocka_unit_test(test_metrics_paths_are_no_labels),
		cmocka_unit_test(test_metrics_refusals_have_reasons),
		cmocka_unit_test(test_metrics_process_is_told),
		cmocka_unit_test(test_request_id_is_kept_if_it_is_one),
		cmocka_unit_test(test_request_ids_differ),
		cmocka_unit_test(test_request_id_is_on_every_answer),
		cmocka_unit_test(test_info_tells_store_listeners_and_security),
		cmocka_unit_test(test_readyz_says_which_part_is_not),
		cmocka_unit_test(test_metrics_prometheus_reads_as_much),
	};

	return cmocka_run_group_tests(tests, daemon_setup, daemon_teardown);
}
