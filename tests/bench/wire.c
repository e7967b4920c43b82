/*
 * The daemon over the wire, from a client in this process that costs little:
 * small batches, many clients, bulk beside them, and 10^6 points in each form.
 * Beside it a bare libmicrohttpd that is sent and sends the same bytes, copies
 * of memory, the device without a daemon, and cJSON.
 */
#include <pthread.h>
#include <signal.h>
#include <stdbool.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <time.h>
#include <unistd.h>

#include <cjson/cJSON.h>

#include "core/output.h"
#include "core/table.h"
#include "core/tape.h"
#include "kernels/device.h"
#include "proto/document.h"
#include "proto/fault.h"
#include "tests/bench/echo.h"
#include "tests/bench/report.h"
#include "tests/bench/wire.h"
#include "tests/support/daemon.h"
#include "tests/support/load.h"
#include "tests/support/random_tree.h"

#define SMALL 256
#define LARGE 1000000
#define BULK 5000000
#define SCENES 8
#define CLIENTS 64
#define ROW 4
#define TEXT_MAX 16384
#define TABLES_MAX 4

static const char octets[] = "Content-Type: application/octet-stream\r\n"
    "Accept: application/octet-stream\r\n";
static const char json[] = "Content-Type: application/json\r\n";

/* Of the daemons. */
static const char *const arguments[] = {"--no-measure", "--max-points",
	"5000000", "--max-body", "128M", NULL};

struct wire {
	struct daemon daemon;
	struct MHD_Daemon *echo;
	int echo_port;
	float *points;  /* BULK of them, random in [-1.2, 1.2]^3 */
	float *rows, *copy;
	char *texts[SCENES];
	double seconds; /* that a load lasts */
};

static double clock_of(clockid_t id)
{
	struct timespec t;

	clock_gettime(id, &t);
	return (double)t.tv_sec + 1e-9 * (double)t.tv_nsec;
}

static double now(void)
{
	return clock_of(CLOCK_MONOTONIC);
}

/* CPU seconds of a process so far. */
static double cpu_of(pid_t pid)
{
	clockid_t id;

	return clock_getcpuclockid(pid, &id) ? 0.0 : clock_of(id);
}

/* A line of /proc/PID/status in kB. */
static long status_kb(pid_t pid, const char *name)
{
	char path[64], line[256];
	size_t length = strlen(name);
	long kb = -1;
	FILE *file;

	snprintf(path, sizeof(path), "/proc/%d/status", (int)pid);
	file = fopen(path, "r");
	while (file && fgets(line, sizeof(line), file))
		if (strncmp(line, name, length) == 0)
			kb = strtol(line + length + 1, NULL, 10);
	if (file)
		fclose(file);
	return kb;
}

/* --- scenes ------------------------------------------------------------------ */

/* count points of radius 0.2 to 0.3 in [-1, 1]^3. */
static char *write_scene(uint64_t seed, int count, const char *type)
{
	struct random_stream r = {seed};
	char *text = calloc(1, TEXT_MAX);
	int n;

	if (!text)
		abort();
	n = snprintf(text, TEXT_MAX, "{\"format\":\"blobfield/1\",\"root\":{"
	    "\"type\":%s,\"children\":[", type);
	for (int i = 0; i < count; i++)
		n += snprintf(text + n, (size_t)(TEXT_MAX - n),
		    "%s{\"type\":\"point\",\"center\":[%.4f,%.4f,%.4f],"
		    "\"radius\":%.4f}", i ? "," : "",
		    random_in(&r, -1.0, 1.0), random_in(&r, -1.0, 1.0),
		    random_in(&r, -1.0, 1.0), random_in(&r, 0.2, 0.3));
	snprintf(text + n, (size_t)(TEXT_MAX - n), "]}}");
	return text;
}

static const char *const types[SCENES] = {"\"sum\"",
	"\"union\",\"operator\":\"camel\"", "\"sum\"", "\"ricci\",\"n\":2",
	"\"union\",\"operator\":\"sharp\"", "\"sum\"",
	"\"union\",\"operator\":\"camel\"", "\"sum\""};
static const int sizes[SCENES] = {50, 50, 10, 20, 50, 100, 5, 30};

static void put_scenes(struct wire *w)
{
	int fd = load_connect(w->daemon.port);

	for (int i = 0; i < SCENES; i++) {
		struct load_request put;
		struct load_answer answer;
		char path[40];

		w->texts[i] = write_scene((uint64_t)i + 1, sizes[i], types[i]);
		snprintf(path, sizeof(path), "/v1/scenes/s%d", i);
		put = load_request_make("PUT", path, json, w->texts[i],
		    strlen(w->texts[i]));
		if (load_exchange(fd, &put, false, &answer) ||
		    answer.status / 100 != 2)
			abort();
		load_request_fini(&put);
	}
	close(fd);
}

static struct load_request eval_request(int scene, const char *query,
    const float *points, size_t count)
{
	char path[80];

	snprintf(path, sizeof(path), "/v1/scenes/s%d/eval%s", scene, query);
	return load_request_make("POST", path, octets, points, count * 12);
}

static struct load_request echo_request(const float *points, size_t count)
{
	char path[40];

	snprintf(path, sizeof(path), "/%zu", count * ROW * sizeof(float));
	return load_request_make("POST", path, octets, points, count * 12);
}

/* --- small batches ------------------------------------------------------------ */

#define SMALL_TIMES 2000

/* The device's own milliseconds in a Server-Timing header; 0: not said. */
static double device_seconds(const char *timing)
{
	const char *at = strstr(timing, "device;dur=");

	return at ? 1e-3 * strtod(at + 11, NULL) : 0.0;
}

/* One client, in turn with the echo. */
static void measure_one_client(struct wire *w)
{
	struct load_request ours = eval_request(0, "", w->points, SMALL);
	struct load_request echo = echo_request(w->points, SMALL);
	int fd = load_connect(w->daemon.port);
	int echo_fd = load_connect(w->echo_port);
	static double total[SMALL_TIMES], beyond[SMALL_TIMES];
	static double echoed[SMALL_TIMES];
	double p50, echo_p50;

	for (int i = -200; i < SMALL_TIMES; i++) {
		struct load_answer a, e;

		if (load_exchange(fd, &ours, false, &a) || a.status != 200 ||
		    load_exchange(echo_fd, &echo, false, &e))
			abort();
		if (i < 0)
			continue;
		total[i] = a.last;
		beyond[i] = a.last - device_seconds(a.timing);
		echoed[i] = e.last;
	}
	close(fd);
	close(echo_fd);
	load_request_fini(&ours);
	load_request_fini(&echo);
	p50 = load_quantile(total, SMALL_TIMES, 0.5);
	echo_p50 = load_quantile(echoed, SMALL_TIMES, 0.5);
	report_add(&(struct report_figure){.group = "wire",
	    .name = "256 points, 1 client, p50", .unit = "us",
	    .value = 1e6 * p50,
	    .least = 1e6 * load_quantile(total, SMALL_TIMES, 0.01),
	    .most = 1e6 * load_quantile(total, SMALL_TIMES, 0.99),
	    .ratios = {{"echo", echo_p50 / p50}}});
	p50 = load_quantile(beyond, SMALL_TIMES, 0.5);
	report_add(&(struct report_figure){.group = "wire",
	    .name = "256 points, 1 client, beyond the device, p50",
	    .unit = "us", .value = 1e6 * p50,
	    .least = 1e6 * load_quantile(beyond, SMALL_TIMES, 0.01),
	    .most = 1e6 * load_quantile(beyond, SMALL_TIMES, 0.99),
	    .ratios = {{"echo", echo_p50 / p50}, {"150 us", 150e-6 / p50}}});
}

/* --- many clients, and one with bulk ------------------------------------------- */

struct bulk {
	struct wire *w;
	bool stop;       /* atomic */
	size_t batches;  /* whole ones */
	size_t bytes;    /* of answers, parts of one too */
	double elapsed;
	double longest;  /* to an answer's first byte */
};

static void *run_bulk(void *ctx)
{
	struct bulk *b = ctx;
	struct load_request request = eval_request(1, "", b->w->points, BULK);
	int fd = load_connect(b->w->daemon.port);
	double begin = now();

	while (!__atomic_load_n(&b->stop, __ATOMIC_ACQUIRE)) {
		struct load_answer a;

		if (load_exchange(fd, &request, false, &a) ||
		    a.status != 200) {
			fprintf(stderr, "bulk: status %d, %zu bytes\n",
			    a.status, a.length);
			break;
		}
		b->batches++;
		b->bytes += a.length;
		b->longest = a.first > b->longest ? a.first : b->longest;
	}
	b->elapsed = now() - begin;
	close(fd);
	load_request_fini(&request);
	return NULL;
}

/* Points a second of a bulk client. */
static double bulk_rate(const struct bulk *b)
{
	return (double)b->bytes / (ROW * sizeof(float)) / b->elapsed;
}

static double bulk_alone(struct wire *w)
{
	struct bulk b = {.w = w};
	pthread_t thread;

	if (pthread_create(&thread, NULL, run_bulk, &b))
		abort();
	usleep((useconds_t)(1e6 * w->seconds));
	__atomic_store_n(&b.stop, true, __ATOMIC_RELEASE);
	pthread_join(thread, NULL);
	return bulk_rate(&b);
}

static void report_load(const char *name, struct load_result *r, double echo,
    double alone)
{
	double p50 = load_quantile(r->seconds, r->count, 0.5);
	double p99 = load_quantile(r->seconds, r->count, 0.99);
	double rate = (double)r->count / r->elapsed;
	char text[96];

	snprintf(text, sizeof(text), "%s, p50", name);
	report_add(&(struct report_figure){.group = "wire", .name = text,
	    .unit = "us", .value = 1e6 * p50, .least = 1e6 *
	    r->seconds[0], .most = 1e6 * p99,
	    .ratios = {{"p99/p50", p99 / p50}, {"fewest/most of a client",
	    (double)r->fewest / (double)r->most}}});
	snprintf(text, sizeof(text), "%s, answers", name);
	report_add(&(struct report_figure){.group = "wire", .name = text,
	    .unit = "1/s", .value = rate, .least = rate, .most = rate,
	    .ratios = {{"echo", rate / echo},
	    {alone > 0.0 ? "without bulk" : NULL, rate / alone}}});
	if (r->failures > 0)
		fprintf(stderr, "%s: %zu failures\n", name, r->failures);
}

static void measure_many_clients(struct wire *w)
{
	struct load_request requests[SCENES];
	struct load_request echo = echo_request(w->points, SMALL);
	struct load_options options = {.port = w->echo_port,
		.connections = CLIENTS, .requests = &echo,
		.request_count = 1, .seconds = w->seconds};
	double echo_rate, alone, bulk_only = bulk_alone(w), rate;
	struct bulk b = {.w = w};
	struct load_result result;
	pthread_t thread;

	for (int i = 0; i < SCENES; i++)
		requests[i] = eval_request(i, "", w->points +
		    (size_t)i * SMALL * 3, SMALL);
	load_run(&options, &result);
	echo_rate = (double)result.count / result.elapsed;
	load_result_fini(&result);
	options.port = w->daemon.port;
	options.requests = requests;
	options.request_count = SCENES;
	load_run(&options, &result);
	alone = (double)result.count / result.elapsed;
	report_load("256 points, 64 clients, 8 scenes", &result, echo_rate,
	    0.0);
	load_result_fini(&result);
	if (pthread_create(&thread, NULL, run_bulk, &b))
		abort();
	usleep(300000); /* until its first batch is under way */
	options.seconds *= 2.0;
	load_run(&options, &result);
	__atomic_store_n(&b.stop, true, __ATOMIC_RELEASE);
	pthread_join(thread, NULL);
	report_load("the same beside 5e6-point batches", &result, echo_rate,
	    alone);
	load_result_fini(&result);
	rate = bulk_rate(&b);
	report_add(&(struct report_figure){.group = "wire",
	    .name = "5e6-point batches beside 64 clients", .unit = "10^6/s",
	    .value = 1e-6 * rate, .least = 1e-6 * rate, .most = 1e-6 * rate,
	    .ratios = {{"without them", rate / bulk_only}}});
	for (int i = 0; i < SCENES; i++)
		load_request_fini(requests + i);
	load_request_fini(&echo);
}

/* --- a million points ------------------------------------------------------------ */

/* A scene on a device of this process: what its time is without a daemon. */
struct alone {
	struct device *device;
	struct document *document;
	struct device_tape *tape;
};

static void open_alone(struct alone *a, const char *text)
{
	const struct document_limits limits = {.max_nodes = 1000,
	    .layout = LAYOUT_WARPED};
	const struct device_options options = {0};
	struct device_failure failure = {0};
	struct faults faults = {0};
	int slots[TABLES_MAX];
	const struct tape *tape;

	if (device_open(&options, &a->device, &failure) ||
	    document_parse(text, strlen(text), &limits, &a->document, &faults))
		abort();
	tape = document_tape(a->document);
	for (size_t i = 0; i < tape->operator_count; i++) {
		const struct operator *op = tape->operators + i;
		struct table *table;

		if (i == TABLES_MAX || table_create(op->family, &op->profile,
		    op->layout, op->resolution, &table))
			abort();
		table_build(table, 0, op->resolution);
		if (device_load_table(a->device, table, slots + i))
			abort();
		table_free(table);
	}
	if (device_load_tape(a->device, tape, slots, &a->tape))
		abort();
}

static void close_alone(struct alone *a)
{
	device_drop_tape(a->device, a->tape);
	device_close(a->device);
	document_free(a->document);
}

#define TIMES 5

/* Of one way to send and get 10^6 points, TIMES repetitions. */
struct large {
	double whole[TIMES], whole_cpu[TIMES]; /* the request; daemon's CPU */
	double device[TIMES], device_cpu[TIMES];
	double copy[TIMES]; /* of the payload */
	double echo[TIMES];
};

static void time_alone(struct wire *w, struct alone *a, struct large *l, int i)
{
	void *(*volatile copy)(void *, const void *, size_t) = memcpy;
	double cpu = clock_of(CLOCK_PROCESS_CPUTIME_ID), begin = now();

	if (device_evaluate(a->device, a->tape, w->points, LARGE,
	    OUTPUT_VALUE | OUTPUT_GRADIENT, w->rows, NULL, NULL))
		abort();
	l->device[i] = now() - begin;
	l->device_cpu[i] = clock_of(CLOCK_PROCESS_CPUTIME_ID) - cpu;
	begin = now();
	copy(w->copy, w->points, (size_t)LARGE * 12);
	copy(w->copy, w->rows, (size_t)LARGE * ROW * sizeof(float));
	l->copy[i] = now() - begin;
}

static void time_request(struct wire *w, const struct load_request *request,
    struct large *l, int i)
{
	pid_t pid = w->daemon.pid;
	int fd = load_connect(w->daemon.port);
	struct load_answer answer;
	double cpu = cpu_of(pid);

	if (load_exchange(fd, request, false, &answer) ||
	    answer.status != 200) {
		fprintf(stderr, "10^6 points: status %d\n", answer.status);
		abort();
	}
	l->whole[i] = answer.last;
	usleep(20000); /* what the daemon does behind the last byte counts */
	l->whole_cpu[i] = cpu_of(pid) - cpu;
	close(fd);
}

/* Bytes by which one request, the first large one of a daemon, raises its
 * memory at the most. */
static double measure_peak(const char *scene, const struct load_request *large)
{
	const float point[3] = {0.0f, 0.0f, 0.0f};
	struct load_request first[2] = {
		load_request_make("PUT", "/v1/scenes/s0", json, scene,
		    strlen(scene)),
		eval_request(0, "", point, 1)};
	struct load_answer answer;
	struct daemon d;
	long kb;
	int fd;

	daemon_start(&d, arguments);
	daemon_await_ready(&d);
	fd = load_connect(d.port);
	for (int i = 0; i < 2; i++) {
		if (load_exchange(fd, first + i, false, &answer))
			abort();
		load_request_fini(first + i);
	}
	kb = status_kb(d.pid, "VmRSS");
	if (load_exchange(fd, large, false, &answer) || answer.status != 200)
		abort();
	kb = status_kb(d.pid, "VmHWM") - kb;
	close(fd);
	daemon_stop(&d, SIGTERM);
	return 1024.0 * (double)kb;
}

static void report_peak(const char *name, const char *scene,
    const struct load_request *large)
{
	double peak = measure_peak(scene, large);
	char text[96];

	snprintf(text, sizeof(text), "%s, peak memory", name);
	report_add(&(struct report_figure){.group = "wire", .name = text,
	    .unit = "MB", .value = 1e-6 * peak, .least = 1e-6 * peak,
	    .most = 1e-6 * peak, .ratios = {{"3 arrays", 3.0 * LARGE *
	    (12 + 4 * ROW) / peak}}});
}

static void time_echo(struct wire *w, const struct load_request *request,
    struct large *l, int i)
{
	int fd = load_connect(w->echo_port);
	struct load_answer answer;

	if (load_exchange(fd, request, false, &answer))
		abort();
	l->echo[i] = answer.last;
	close(fd);
}

static void report_large(const char *name, const char *what, double *values,
    double scale, const char *unit, struct report_ratio first,
    struct report_ratio second)
{
	char text[96];
	double median = report_median(values, TIMES);

	snprintf(text, sizeof(text), "%s, %s", name, what);
	report_add(&(struct report_figure){.group = "wire", .name = text,
	    .unit = unit, .value = scale * median, .least = scale * values[0],
	    .most = scale * values[TIMES - 1], .ratios = {first, second}});
}

static void measure_binary(struct wire *w, int scene, const char *name)
{
	struct load_request ours = eval_request(scene, "", w->points, LARGE);
	struct load_request echo = echo_request(w->points, LARGE);
	double bound, whole;
	struct alone a = {0};
	struct large l;

	open_alone(&a, w->texts[scene]);
	for (int i = -1; i < TIMES; i++) {
		time_request(w, &ours, &l, i < 0 ? 0 : i);
		time_alone(w, &a, &l, i < 0 ? 0 : i);
		time_echo(w, &echo, &l, i < 0 ? 0 : i);
	}
	bound = 1.25 * report_median(l.device, TIMES) +
	    2.0 * report_median(l.copy, TIMES);
	whole = report_median(l.whole, TIMES);
	report_large(name, "whole request", l.whole, 1e3, "ms",
	    (struct report_ratio){"1.25 device + 2 copies", bound / whole},
	    (struct report_ratio){"echo", report_median(l.echo, TIMES) /
	    whole});
	report_large(name, "device alone", l.device, 1e3, "ms",
	    (struct report_ratio){"whole", report_median(l.device, TIMES) /
	    whole}, (struct report_ratio){"copy",
	    report_median(l.copy, TIMES) / report_median(l.device, TIMES)});
	load_request_fini(&ours);
	ours = eval_request(0, "", w->points, LARGE);
	report_peak(name, w->texts[scene], &ours);
	load_request_fini(&ours);
	close_alone(&a);
	load_request_fini(&echo);
}

/* {"points":[[x,y,z],...]} */
static char *write_points(const float *xyz, size_t count, size_t *length)
{
	char *text = malloc(count * 40 + 64), *at = text;

	if (!text)
		abort();
	at += sprintf(at, "{\"points\":[");
	for (size_t i = 0; i < count; i++)
		at += sprintf(at, "%s[%.7g,%.7g,%.7g]", i ? "," : "",
		    (double)xyz[3 * i], (double)xyz[3 * i + 1],
		    (double)xyz[3 * i + 2]);
	at += sprintf(at, "]}");
	*length = (size_t)(at - text);
	return text;
}

/* CPU seconds of cJSON parsing the points and printing the rows. */
static double time_cjson(const char *text, const float *rows)
{
	double begin = clock_of(CLOCK_THREAD_CPUTIME_ID);
	cJSON *body = cJSON_Parse(text), *answer = cJSON_CreateObject();
	cJSON *values = cJSON_AddArrayToObject(answer, "value");
	cJSON *gradients = cJSON_AddArrayToObject(answer, "gradient");
	char *printed;

	for (size_t i = 0; i < LARGE; i++) {
		cJSON_AddItemToArray(values,
		    cJSON_CreateNumber((double)rows[ROW * i]));
		cJSON_AddItemToArray(gradients,
		    cJSON_CreateFloatArray(rows + ROW * i + 1, 3));
	}
	printed = cJSON_PrintUnformatted(answer);
	free(printed);
	cJSON_Delete(answer);
	cJSON_Delete(body);
	return clock_of(CLOCK_THREAD_CPUTIME_ID) - begin;
}

static void measure_json(struct wire *w)
{
	static const char name[] = "10^6 points, JSON, sum";
	double beyond[TIMES], took, cjson;
	struct load_request ours;
	struct alone a = {0};
	struct large l;
	size_t length;
	char *text = write_points(w->points, LARGE, &length);

	ours = load_request_make("POST", "/v1/scenes/s0/eval", json, text,
	    length);
	open_alone(&a, w->texts[0]);
	for (int i = -1; i < TIMES; i++) {
		int k = i < 0 ? 0 : i;

		time_request(w, &ours, &l, k);
		time_alone(w, &a, &l, k);
		beyond[k] = l.whole_cpu[k] - l.device_cpu[k];
	}
	cjson = time_cjson(text, w->rows);
	took = report_median(beyond, TIMES);
	report_large(name, "CPU beyond the device's", beyond, 1e3, "ms",
	    (struct report_ratio){"250 ms", 0.25 / took},
	    (struct report_ratio){"cJSON", cjson / took});
	report_peak(name, w->texts[0], &ours);
	report_large(name, "whole request", l.whole, 1e3, "ms",
	    (struct report_ratio){0}, (struct report_ratio){0});
	close_alone(&a);
	load_request_fini(&ours);
	free(text);
}

/* --- all of it --------------------------------------------------------------------- */

static void make_points(struct wire *w)
{
	struct random_stream r = {11};

	w->points = malloc((size_t)BULK * 12);
	w->rows = malloc((size_t)LARGE * ROW * sizeof(float));
	w->copy = malloc((size_t)LARGE * ROW * sizeof(float));
	if (!w->points || !w->rows || !w->copy)
		abort();
	for (size_t i = 0; i < (size_t)BULK * 3; i++)
		w->points[i] = (float)random_in(&r, -1.2, 1.2);
}

void bench_wire(bool quick)
{
	struct wire w = {.seconds = quick ? 1.0 : 5.0};

	make_points(&w);
	daemon_start(&w.daemon, arguments);
	daemon_await_ready(&w.daemon);
	w.echo = echo_start(&w.echo_port);
	put_scenes(&w);
	measure_one_client(&w);
	measure_many_clients(&w);
	measure_binary(&w, 0, "10^6 points, binary, sum");
	measure_binary(&w, 1, "10^6 points, binary, camel");
	measure_json(&w);
	echo_stop(w.echo);
	if (daemon_stop(&w.daemon, SIGTERM))
		fprintf(stderr, "the daemon did not end well\n");
	for (int i = 0; i < SCENES; i++)
		free(w.texts[i]);
	free(w.points);
	free(w.rows);
	free(w.copy);
}
