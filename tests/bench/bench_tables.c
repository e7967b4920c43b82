/*
 * Operator tables: how long they take to build, on two threads, and how far they
 * are from the exact operator over the fixed sample that the daemon reports
 * too.
 *
 *   /copy  a copy of the table's own bytes, in the same repetitions
 *
 * The part tables-sweep goes through sizes from 8 to 128 nodes an axis;
 * tables-orders finds the coarsest table for given errors in g.
 */
#include <pthread.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "core/table.h"
#include "tests/bench/bench.h"
#include "tests/bench/report.h"

#define THREADS 2

struct share {
	struct table *table;
	float *errors; /* NULL: build */
	int index;
	double *exact; /* of errors in g alone; NULL: other work */
	double max, sum;
};

/* Whose exact values are sampled. */
static struct operator sampled;

static void *work(void *arg)
{
	struct share *s = arg;
	size_t first = TABLE_SAMPLE / THREADS * (size_t)s->index;

	if (s->exact && !s->table) {
		table_sample(sampled.family, &sampled.profile, first,
		    first + TABLE_SAMPLE / THREADS, s->exact);
		return NULL;
	}
	if (s->exact) {
		s->max = table_measure_g(s->table, first,
		    first + TABLE_SAMPLE / THREADS, s->exact, &s->sum);
		return NULL;
	}
	if (s->errors) {
		table_measure(s->table, first, first + TABLE_SAMPLE / THREADS,
		    s->errors, TABLE_SAMPLE);
		return NULL;
	}
	for (int i = s->index; i < s->table->resolution; i += THREADS)
		table_build(s->table, i, i + 1);
	return NULL;
}

static void share_out(struct share shares[static THREADS])
{
	pthread_t threads[THREADS];

	for (int i = 0; i < THREADS; i++) {
		shares[i].index = i;
		if (pthread_create(&threads[i], NULL, work, &shares[i]))
			abort();
	}
	for (int i = 0; i < THREADS; i++)
		pthread_join(threads[i], NULL);
}

static double in_threads(struct table *table, float *errors)
{
	struct share shares[THREADS];
	double begin = bench_now();

	for (int i = 0; i < THREADS; i++)
		shares[i] = (struct share){.table = table, .errors = errors};
	share_out(shares);
	return bench_now() - begin;
}

static double copy_seconds(const struct table *t)
{
	size_t bytes = t->node_count * TABLE_SECOND * sizeof(float);
	void *(*volatile copy)(void *, const void *, size_t) = memcpy;
	double begin;
	char *to = malloc(bytes);

	if (!to)
		abort();
	/* Once to touch the pages, once for the clock; the call through a volatile
	 * pointer stays. */
	copy(to, t->second, bytes);
	begin = bench_now();
	copy(to, t->second, bytes);
	begin = bench_now() - begin;
	free(to);
	return begin * (double)table_bytes(t) / (double)bytes;
}

static void name_profile(const struct profile *profile, char *name,
    size_t size)
{
	if (profile->type == PROFILE_BULGE)
		snprintf(name, size, "bulge %.2g", profile->k);
	else
		snprintf(name, size, "%s", profile_name(profile->type));
}

/* The error of a built table over the sample. */
static void measure(struct table *t, struct table_error *out)
{
	float *errors = malloc(sizeof(*errors) * TABLE_SAMPLE * TABLE_QUANTITIES);

	if (!errors)
		abort();
	in_threads(t, errors);
	table_error_summarise(errors, TABLE_SAMPLE, TABLE_SAMPLE, out);
	free(errors);
}

/* ---- the usual run ---- */

static double run_build(void *ctx)
{
	return in_threads(ctx, NULL);
}

static double run_copy(void *ctx)
{
	return copy_seconds(ctx);
}

static void report_error(const char *table, const char *of, double value)
{
	char name[128];
	struct report_figure f = {"tables", name, "", value, value, value, {{NULL, 0.0}}};

	snprintf(name, sizeof(name), "%s; %s", table, of);
	report_add(&f);
}

static void report(enum operator_family family, const struct profile *profile,
    enum table_layout layout, bool quick)
{
	struct race_runner list[] = {{.name = "build", .run = run_build},
		{.name = "copy", .run = run_copy}};
	int resolution = table_resolution(layout);
	int n = quick || layout == LAYOUT_UNIFORM ? 1 : 3;
	char profile_text[32], name[80];
	struct table_error e;
	struct table *t;

	if (table_create(family, profile, layout, resolution, &t))
		abort();
	name_profile(profile, profile_text, sizeof(profile_text));
	snprintf(name, sizeof(name), "%s, %s; %s %d; %.0f MiB",
	    operator_family_name(family), profile_text,
	    operator_layout_name(layout), resolution,
	    (double)table_bytes(t) / (1 << 20));
	race(list, 2, n, t);
	race_report(list, 2, n, "tables", name, "ms", false, 1e3);
	if (!quick) {
		measure(t, &e);
		report_error(name, "g, most", e.max[0]);
		report_error(name, "g, mean", e.mean[0]);
		report_error(name, "g1, 99th percentile", e.p99[1]);
		report_error(name, "gt, 99th percentile", e.p99[3]);
		report_error(name, "g11, 99th percentile", e.p99[4]);
	}
	table_free(t);
}

void bench_tables(bool quick)
{
	const struct profile profiles[] = {profile_smooth(),
		profile_bulge(0.8)};

	for (int f = 0; f < FAMILY_COUNT; f++)
		for (int p = 0; p < (quick ? 1 : 2); p++)
			for (int l = 0; l < (quick ? 1 : LAYOUT_COUNT); l++)
				report((enum operator_family)f, profiles + p,
				    (enum table_layout)l, quick);
}

/* ---- tables-sweep ---- */

static void report_size(enum operator_family family,
    const struct profile *profile, enum table_layout layout, int resolution)
{
	struct table_error e;
	struct table *t;
	double seconds, copy;
	char name[32];

	if (table_create(family, profile, layout, resolution, &t))
		abort();
	seconds = in_threads(t, NULL);
	copy = copy_seconds(t);
	measure(t, &e);
	name_profile(profile, name, sizeof(name));
	printf("%-12s %-9s %-7s %4d %6.2f %6.2f %5.0f %6.0f  %.1e %.1e  "
	    "%.1e %.1e %.1e  %.1e %.1e %.1e\n", operator_family_name(family),
	    name, operator_layout_name(layout), resolution,
	    (double)table_bytes_first(t) / (1 << 20),
	    (double)table_bytes(t) / (1 << 20), seconds * 1e3, seconds / copy,
	    e.max[0], e.mean[0], e.p99[1], e.p99[2], e.p99[3],
	    e.p99[4], e.p99[5], e.p99[9]);
	fflush(stdout);
	table_free(t);
}

void bench_tables_sweep(void)
{
	static const int sizes[] = {8, 16, 24, 32, 48, 64, 96, 128};
	const struct profile profiles[] = {profile_smooth(),
		profile_bulge(0.8)};

	printf("family       profile   layout     N  MiB-1  MiB-2    ms /copy  "
	    "g max   g mean   p99 of g1, g2, gt        p99 of g11, g12, gtt\n");
	for (int f = 0; f < FAMILY_COUNT; f++)
		for (int p = 0; p < 2; p++)
			for (size_t i = 0; i < sizeof(sizes) / sizeof(*sizes); i++)
				for (int l = 0; l < LAYOUT_COUNT; l++)
					report_size((enum operator_family)f,
					    profiles + p, (enum table_layout)l,
					    sizes[i]);
}

/* ---- tables-orders ---- */

/* What was found of one family, profile and layout: resolutions are tried
 * once. */
struct known {
	double max[TABLE_RESOLUTION_MAX + 1]; /* 0: not tried */
	double mean[TABLE_RESOLUTION_MAX + 1];
	double build[TABLE_RESOLUTION_MAX + 1];
};

static void try(const struct operator *op, int resolution, double *exact,
    struct known *known)
{
	struct share shares[THREADS];
	struct table *t;

	if (known->max[resolution] > 0.0)
		return;
	if (table_create(op->family, &op->profile, op->layout, resolution, &t))
		abort();
	known->build[resolution] = in_threads(t, NULL);
	for (int i = 0; i < THREADS; i++)
		shares[i] = (struct share){.table = t, .exact = exact};
	share_out(shares);
	for (int i = 0; i < THREADS; i++) {
		known->max[resolution] = shares[i].max > known->max[resolution] ?
		    shares[i].max : known->max[resolution];
		known->mean[resolution] += shares[i].sum / TABLE_SAMPLE;
	}
	table_free(t);
}

/* The coarsest resolution that holds bound, or the finest. */
static int bisect(const struct operator *op, double bound, double *exact,
    struct known *known)
{
	int low = TABLE_RESOLUTION_MIN, high = TABLE_RESOLUTION_MAX;

	try(op, high, exact, known);
	if (known->max[high] > bound)
		return high;
	while (low < high) {
		int middle = (low + high) / 2;

		try(op, middle, exact, known);
		if (known->max[middle] <= bound)
			high = middle;
		else
			low = middle + 1;
	}
	return high;
}

static void report_order(const struct operator *op, double bound, int n,
    const struct known *known)
{
	char name[32], goal[16];
	size_t nodes = (size_t)n * (size_t)n * (size_t)n;

	snprintf(name, sizeof(name), op->profile.type == PROFILE_BULGE ?
	    "bulge %.2g" : "smooth", op->profile.k);
	snprintf(goal, sizeof(goal), bound > 0.0 ? "%.0e" : "draft", bound);
	printf("%-12s %-9s %-7s %6s %4d %7.2f %6.0f  %.2e %.1e%s\n",
	    operator_family_name(op->family), name,
	    operator_layout_name(op->layout), goal, n,
	    (double)(nodes * (TABLE_FIRST + TABLE_SECOND) * sizeof(float)) /
	    (1 << 20), 1e3 * known->build[n], known->max[n], known->mean[n],
	    bound > 0.0 && known->max[n] > bound ? "  not held" : "");
	fflush(stdout);
}

static void report_orders(enum operator_family family,
    const struct profile *profile)
{
	static const double bounds[] = {1e-2, 1e-3, 1e-4, 1e-5, 1e-6};
	double *exact = malloc(sizeof(*exact) * TABLE_SAMPLE);
	struct operator op = {.family = family, .profile = *profile};
	struct share shares[THREADS];

	if (!exact)
		abort();
	sampled = op;
	for (int i = 0; i < THREADS; i++)
		shares[i] = (struct share){.exact = exact};
	share_out(shares);
	for (int l = 0; l < LAYOUT_COUNT; l++) {
		struct known known = {.max = {0.0}};

		op.layout = (enum table_layout)l;
		for (size_t i = 0; i < sizeof(bounds) / sizeof(*bounds); i++)
			report_order(&op, bounds[i], bisect(&op, bounds[i],
			    exact, &known), &known);
		try(&op, 16, exact, &known);
		report_order(&op, 0.0, 16, &known);
	}
	free(exact);
}

void bench_tables_orders(void)
{
	const struct profile profiles[] = {profile_smooth(),
	    profile_bulge(0.8)};

	printf("family       profile   layout   max_error  N     MiB     ms  "
	    "g max    g mean\n");
	for (int f = 0; f < FAMILY_COUNT; f++)
		for (int p = 0; p < 2; p++)
			report_orders((enum operator_family)f, &profiles[p]);
}
