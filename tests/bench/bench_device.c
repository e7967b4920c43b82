/*
 * The device's speed, on batches of every size. A table on stdout, one line a
 * figure, in 10^6 points/s, beside ratios to three yardsticks measured in the same
 * repetitions:
 *
 *   /copy    a copy of the request's and the answer's bytes, one thread
 *   /native  50 points under sum, value and gradient, in straight C for two
 *            threads: the same work as the first scene's, no tape, no device
 *   /f64     the float64 evaluator, on the same scene, points and outputs, one
 *            thread
 *
 * Medians of interleaved repetitions. Coherent points are those of a grid, x
 * fastest; random ones the same grid's, shuffled.
 */
#include <pthread.h>
#include <stdarg.h>
#include <stdbool.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <time.h>

#include "core/evaluate.h"
#include "core/output.h"
#include "core/table.h"
#include "core/tape.h"
#include "kernels/device.h"
#include "proto/document.h"
#include "proto/fault.h"
#include "tests/support/random_tree.h"

#define THREADS 2
#define BALLS 50
#define BALL_FLOATS 4 /* centre, 1/R^2 */
#define TEXT_MAX 32768
#define TABLES_MAX 16
#define POINTS_MAX 1000000
#define ROW_MAX 10
#define REPETITIONS_MAX 9
/* R of a soft object of radius 1 and exponent 3. */
#define REACH 2.2017

struct scene {
	const char *name;
	char *text;
	struct document *document;
	struct device_tape *tape;
	double low[3], high[3]; /* the box of its points */
};

struct bench {
	struct device *device;
	struct operator operators[TABLES_MAX];
	int slots[TABLES_MAX], tables;
	float *points, *rows, *other_points, *other_rows;
	float balls[BALLS * BALL_FLOATS];
};

/* One line of the table. */
struct figure {
	size_t count;
	unsigned outputs;
	bool coherent;
	int repetitions;
	double seconds[4][REPETITIONS_MAX]; /* a point: device, copy, native,
	                                     * float64 */
};

static double now(void)
{
	struct timespec t;

	clock_gettime(CLOCK_MONOTONIC, &t);
	return (double)t.tv_sec + 1e-9 * (double)t.tv_nsec;
}

static void *allocate(size_t size)
{
	void *p = calloc(1, size);

	if (!p)
		abort();
	return p;
}

/* --- scenes ----------------------------------------------------------------- */

__attribute__((format(printf, 2, 3)))
static void append(char *text, const char *format, ...)
{
	size_t length = strlen(text);
	va_list list;

	va_start(list, format);
	vsnprintf(text + length, TEXT_MAX - length, format, list);
	va_end(list);
}

static void begin_text(char *text, const char *type)
{
	append(text, "{\"format\":\"blobfield/1\",\"root\":{%s,\"children\":[",
	    type);
}

/* Radii of about 0.25 over [-1, 1]^3: about four fields are not 0 at a point. */
static void write_balls(struct bench *b, char *text, const char *type)
{
	struct random_stream r = {1};

	begin_text(text, type);
	for (int i = 0; i < BALLS; i++) {
		float *ball = b->balls + i * BALL_FLOATS;
		double radius = random_in(&r, 0.2, 0.3);

		for (int k = 0; k < 3; k++)
			ball[k] = (float)random_in(&r, -1.0, 1.0);
		ball[3] = (float)(1.0 / (radius * radius * REACH * REACH));
		append(text, "%s{\"type\":\"point\",\"center\":[%.9g,%.9g,%.9g],"
		    "\"radius\":%.9g}", i > 0 ? "," : "", (double)ball[0],
		    (double)ball[1], (double)ball[2], radius);
	}
	append(text, "]}}");
}

static void write_vector(char *text, const char *name,
    struct random_stream *r, double most)
{
	append(text, ",\"%s\":[%.4f,%.4f,%.4f]", name, random_in(r, -most, most),
	    random_in(r, -most, most), random_in(r, -most, most));
}

/* Every primitive but the plane, in turn, about a random point. */
static void write_primitive(char *text, struct random_stream *r, int which)
{
	static const char *const rest[] = {"\"point\",\"radius\":0.25",
		"\"segment\",\"b\":[0.3,0,0],\"radius\":0.2",
		"\"triangle\",\"b\":[0.3,0,0],\"c\":[0,0.3,0],\"radius\":0.15",
		"\"disc\",\"normal\":[0,0.6,0.8],\"disc_radius\":0.2,\"radius\":0.15",
		"\"circle\",\"normal\":[0.6,0,0.8],\"ring_radius\":0.3,\"radius\":0.1",
		"\"sphere\",\"radius\":0.3,\"falloff\":0.3",
		"\"box\",\"half_size\":[0.3,0.2,0.2],\"rounding\":0.05,"
		"\"falloff\":0.3",
		"\"cylinder\",\"b\":[0,0,0.4],\"radius\":0.2,\"falloff\":0.3",
		"\"capsule\",\"b\":[0,0.4,0],\"radius\":0.2,\"falloff\":0.3",
		"\"cone\",\"b\":[0,0,0.4],\"radii\":[0.3,0.1],\"falloff\":0.3",
		"\"torus\",\"axis\":[0,0,1],\"major\":0.3,\"minor\":0.1,"
		"\"falloff\":0.2"};
	static const char *const place[] = {"center", "a", "a", "center",
		"center", "center", "center", "a", "a", "a", "center"};
	int kind = which % 11;

	append(text, "{\"type\":%s", rest[kind]);
	if (strcmp(place[kind], "a") == 0) {
		/* Ends are given about the origin. */
		append(text, ",\"a\":[0,0,0],\"translation\":[%.4f,%.4f,%.4f]}",
		    random_in(r, -1.0, 1.0), random_in(r, -1.0, 1.0),
		    random_in(r, -1.0, 1.0));
		return;
	}
	write_vector(text, place[kind], r, 1.0);
	append(text, "}");
}

/* A balanced binary tree over primitives first..first + count - 1. */
static void write_mixed(char *text, struct random_stream *r, int first,
    int count)
{
	static const char *const types[] = {
		"\"union\",\"operator\":\"camel\"", "\"sum\"",
		"\"union\",\"operator\":\"clean\"", "\"ricci\",\"n\":2",
		"\"union\",\"operator\":\"contact\"",
		"\"difference\",\"operator\":\"clean\"",
		"\"union\",\"operator\":\"sharp\"",
		"\"union\",\"operator\":\"organic\""};

	if (count == 1) {
		write_primitive(text, r, first);
		return;
	}
	append(text, "{\"type\":%s,\"children\":[", types[random_below(r, 8)]);
	write_mixed(text, r, first, count / 2);
	append(text, ",");
	write_mixed(text, r, first + count / 2, count - count / 2);
	append(text, "]}");
}

static void write_letter(char *text)
{
	begin_text(text, "\"type\":\"union\",\"operator\":\"camel\"");
	append(text,
	    "{\"type\":\"segment\",\"a\":[-1,0,0],\"b\":[0,0,2.6],\"radius\":0.2},"
	    "{\"type\":\"segment\",\"a\":[1,0,0],\"b\":[0,0,2.6],\"radius\":0.2},"
	    "{\"type\":\"segment\",\"a\":[-0.69,0,0.8],\"b\":[0.69,0,0.8],"
	    "\"radius\":0.16}]}}");
}

static int slot_of(struct bench *b, const struct operator *op)
{
	struct table *table;
	int i;

	for (i = 0; i < b->tables; i++)
		if (b->operators[i].family == op->family &&
		    b->operators[i].layout == op->layout &&
		    profile_equal(&b->operators[i].profile, &op->profile))
			return b->slots[i];
	if (i == TABLES_MAX || table_create(op->family, &op->profile,
	    op->layout, op->resolution, &table))
		abort();
	table_build(table, 0, op->resolution);
	if (device_load_table(b->device, table, b->slots + i))
		abort();
	table_free(table);
	b->operators[i] = *op;
	return b->slots[b->tables++];
}

static void load_scene(struct bench *b, struct scene *s)
{
	const struct document_limits limits = {.max_nodes = 1000,
	    .layout = LAYOUT_WARPED};
	struct faults faults = {0};
	const struct tape *tape;
	int slots[TABLES_MAX];

	if (document_parse(s->text, strlen(s->text), &limits, &s->document,
	    &faults)) {
		fprintf(stderr, "%s: %s %s\n", s->name, faults.list[0].pointer,
		    faults.list[0].detail);
		abort();
	}
	tape = document_tape(s->document);
	for (size_t i = 0; i < tape->operator_count; i++)
		slots[i] = slot_of(b, tape->operators + i);
	if (device_load_tape(b->device, tape, slots, &s->tape))
		abort();
}

static void begin_scene(struct scene *s, const char *name)
{
	*s = (struct scene){.name = name, .text = allocate(TEXT_MAX),
		.low = {-1.2, -1.2, -1.2}, .high = {1.2, 1.2, 1.2}};
}

#define SCENES 4

static void make_scenes(struct bench *b, struct scene s[static SCENES])
{
	struct random_stream r = {7};

	begin_scene(s, "50 points, sum");
	write_balls(b, s[0].text, "\"type\":\"sum\"");
	begin_scene(s + 1, "50 points, camel");
	write_balls(b, s[1].text, "\"type\":\"union\",\"operator\":\"camel\"");
	begin_scene(s + 2, "50 mixed");
	append(s[2].text, "{\"format\":\"blobfield/1\",\"root\":");
	write_mixed(s[2].text, &r, 0, BALLS);
	append(s[2].text, "}");
	begin_scene(s + 3, "letter A");
	write_letter(s[3].text);
	memcpy(s[3].low, (double[]){-1.5, -0.5, -0.5}, sizeof(s[3].low));
	memcpy(s[3].high, (double[]){1.5, 0.5, 3.1}, sizeof(s[3].high));
	for (int i = 0; i < SCENES; i++)
		load_scene(b, s + i);
}

static void free_scenes(struct bench *b, struct scene s[static SCENES])
{
	for (int i = 0; i < SCENES; i++) {
		device_drop_tape(b->device, s[i].tape);
		document_free(s[i].document);
		free(s[i].text);
	}
}

/* The grid of at least count points with the fewest along x. */
static void make_points(const struct scene *s, size_t count, bool coherent,
    float *xyz)
{
	size_t n = 1;
	struct random_stream r = {3};

	while (n * n * n < count)
		n++;
	for (size_t i = 0; i < count; i++) {
		const size_t at[] = {i % n, i / n % n, i / n / n};

		for (int k = 0; k < 3; k++)
			xyz[3 * i + (size_t)k] = (float)(s->low[k] +
			    (s->high[k] - s->low[k]) *
			    (double)at[k] / (double)(n - 1));
	}
	for (size_t i = count; !coherent && i-- > 1;) {
		size_t j = (size_t)random_below(&r, (int)i + 1);
		float swap[3];

		memcpy(swap, xyz + 3 * i, sizeof(swap));
		memcpy(xyz + 3 * i, xyz + 3 * j, sizeof(swap));
		memcpy(xyz + 3 * j, swap, sizeof(swap));
	}
}

/* --- yardsticks ------------------------------------------------------------- */

/* Points evaluated side by side: enough for any processor's vectors. */
#define TILE 32

struct share {
	const float *points, *balls;
	float *rows;
	size_t count;
};

#if defined(__x86_64__) && defined(__GNUC__) && !defined(__clang__)
#define EACH_PROCESSOR __attribute__((target_clones("avx512f", "avx2", \
	"default"), optimize("O3", "fp-contract=fast", "no-trapping-math")))
#else
#define EACH_PROCESSOR
#endif

/* f = sum (1 - S)^3, grad f = -6/R^2 sum (1 - S)^2 (x - c), S = |x - c|^2/R^2 */
EACH_PROCESSOR
static void evaluate_tile(const float x[static TILE],
    const float y[static TILE], const float z[static TILE],
    const float *balls, float out[static 4 * TILE])
{
	float f[TILE] = {0}, fx[TILE] = {0}, fy[TILE] = {0}, fz[TILE] = {0};

	for (int k = 0; k < BALLS; k++) {
		const float *ball = balls + k * BALL_FLOATS;

		for (int l = 0; l < TILE; l++) {
			float u = x[l] - ball[0], v = y[l] - ball[1];
			float w = z[l] - ball[2];
			float b = 1.0f - (u * u + v * v + w * w) * ball[3], c;

			b = b > 0.0f ? b : 0.0f;
			c = b * b;
			f[l] += c * b;
			c *= -6.0f * ball[3];
			fx[l] += c * u;
			fy[l] += c * v;
			fz[l] += c * w;
		}
	}
	for (int l = 0; l < TILE; l++) {
		out[4 * l] = f[l];
		out[4 * l + 1] = fx[l];
		out[4 * l + 2] = fy[l];
		out[4 * l + 3] = fz[l];
	}
}

static void evaluate_balls(const struct share *s)
{
	float x[TILE], y[TILE], z[TILE];

	for (size_t i = 0; i < s->count; i += TILE) {
		for (int l = 0; l < TILE; l++) {
			const float *p = s->points + 3 * (i + (size_t)l);

			x[l] = p[0];
			y[l] = p[1];
			z[l] = p[2];
		}
		evaluate_tile(x, y, z, s->balls, s->rows + 4 * i);
	}
}

static void *evaluate_share(void *share)
{
	evaluate_balls(share);
	return NULL;
}

/* Over whole tiles of the points; seconds a point. */
static double time_native(struct bench *b, size_t count)
{
	size_t each = count / THREADS / TILE * TILE;
	struct share shares[THREADS];
	pthread_t thread;
	double begin = now();

	for (size_t i = 0; i < THREADS; i++)
		shares[i] = (struct share){b->points + 3 * each * i, b->balls,
			b->other_rows + 4 * each * i, each};
	/* A thread is not worth its start for few points. */
	if (count < 100000) {
		for (int i = 0; i < THREADS; i++)
			evaluate_balls(shares + i);
		return (now() - begin) / (double)(THREADS * each) / THREADS;
	}
	if (pthread_create(&thread, NULL, evaluate_share, shares))
		abort();
	evaluate_balls(shares + 1);
	pthread_join(thread, NULL);
	return (now() - begin) / (double)(THREADS * each);
}

static double time_copy(struct bench *b, size_t count, size_t row)
{
	void *(*volatile copy)(void *, const void *, size_t) = memcpy;
	double begin = now();

	copy(b->other_points, b->points, count * 3 * sizeof(float));
	copy(b->other_rows, b->rows, count * row * sizeof(float));
	return (now() - begin) / (double)count;
}

/* 200 points from all over the batch; seconds a point. */
static double time_float64(struct bench *b, const struct scene *s,
    const struct figure *f)
{
	size_t most = 200, done = 0;
	double begin = now();
	struct jet jet;

	for (size_t i = 0; i < f->count && done < most; done++) {
		const float *p = b->points + 3 * i;

		evaluate(document_tape(s->document), vec3((double)p[0],
		    (double)p[1], (double)p[2]), output_order(f->outputs), &jet);
		i += f->count < most ? 1 : f->count / most;
	}
	return (now() - begin) / (double)done;
}

/* Small batches are repeated, so that the clock's own time is none of it. */
static double time_device(struct bench *b, const struct scene *s,
    const struct figure *f)
{
	size_t times = f->count < 100000 ? 40000 / f->count + 1 : 1;
	double begin = now();

	for (size_t i = 0; i < times; i++)
		if (device_evaluate(b->device, s->tape, b->points, f->count,
		    f->outputs, b->rows, NULL, NULL))
			abort();
	return (now() - begin) / (double)(f->count * times);
}

/* --- the table -------------------------------------------------------------- */

static int by_size(const void *a, const void *b)
{
	double x = *(const double *)a, y = *(const double *)b;

	return (x > y) - (x < y);
}

static double median(double *seconds, int count)
{
	qsort(seconds, (size_t)count, sizeof(*seconds), by_size);
	return seconds[count / 2];
}

static void measure(struct bench *b, const struct scene *s, struct figure *f)
{
	size_t row = (size_t)output_row_floats(f->outputs);

	make_points(s, f->count, f->coherent, b->points);
	time_device(b, s, f);
	time_copy(b, f->count, row);
	for (int i = 0; i < f->repetitions; i++) {
		f->seconds[0][i] = time_device(b, s, f);
		f->seconds[1][i] = time_copy(b, f->count, row);
		f->seconds[2][i] = time_native(b, f->count);
		f->seconds[3][i] = time_float64(b, s, f);
	}
}

static void report(const struct scene *s, struct figure *f)
{
	static const char *const outputs[] = {"", "value", "", "value gradient",
		"", "", "", "with Hessian"};
	double took[4];

	for (int k = 0; k < 4; k++)
		took[k] = median(f->seconds[k], f->repetitions);
	printf("%-17s %-9s %-14s %8zu %9.3f %7.3f %8.3f %8.1f\n", s->name,
	    f->coherent ? "coherent" : "random", outputs[f->outputs], f->count,
	    1e-6 / took[0], took[1] / took[0], took[2] / took[0],
	    took[3] / took[0]);
	fflush(stdout);
}

static void report_scene(struct bench *b, const struct scene *s)
{
	static const unsigned both = OUTPUT_VALUE | OUTPUT_GRADIENT;
	static const struct figure figures[] = {
		{.count = 256, .outputs = both, .repetitions = 9},
		{.count = 4096, .outputs = both, .repetitions = 9},
		{.count = 1000000, .outputs = both, .repetitions = 3},
		{.count = 1000000, .outputs = OUTPUT_VALUE, .repetitions = 3},
		{.count = 1000000, .outputs = both | OUTPUT_HESSIAN,
			.repetitions = 3},
	};

	for (size_t i = 0; i < 2 * sizeof(figures) / sizeof(*figures); i++) {
		struct figure f = figures[i / 2];

		f.coherent = i % 2 == 0;
		measure(b, s, &f);
		report(s, &f);
	}
}

static void open_bench(struct bench *b)
{
	struct device_options options = {0};
	struct device_failure failure = {0};
	const struct device_info *info;

	if (device_open(&options, &b->device, &failure)) {
		fprintf(stderr, "%s\n", failure.message);
		exit(1);
	}
	info = device_get_info(b->device);
	printf("device: %s, width %d\n", info->name, info->width);
	b->points = allocate(POINTS_MAX * 3 * sizeof(float));
	b->rows = allocate(POINTS_MAX * ROW_MAX * sizeof(float));
	b->other_points = allocate(POINTS_MAX * 3 * sizeof(float));
	b->other_rows = allocate(POINTS_MAX * ROW_MAX * sizeof(float));
}

int main(void)
{
	struct scene scenes[SCENES];
	struct bench *b = allocate(sizeof(*b));

	open_bench(b);
	make_scenes(b, scenes);
	printf("scene             points    outputs           batch   10^6/s   "
	    "/copy  /native     /f64\n");
	for (int i = 0; i < SCENES; i++)
		report_scene(b, scenes + i);
	free_scenes(b, scenes);
	device_close(b->device);
	free(b->points);
	free(b->rows);
	free(b->other_points);
	free(b->other_rows);
	free(b);
	return 0;
}
