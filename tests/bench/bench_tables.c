/*
 * Operator tables: what they weigh, how long they take to build, how far they
 * are from the exact operator. A table on stdout, one line a table; the error
 * is over the fixed sample that the daemon reports too.
 *
 *   bench_tables          the built-in tables, and the paper's grid beside them
 *   bench_tables --sweep  size against error, from 8 to 128 nodes an axis
 *   bench_tables --orders the coarsest table for given errors in g, and a draft
 *
 * Build times are on two threads, as the daemon builds on two cores, also as a
 * ratio to a copy of the table's own bytes made in the same call.
 */
#include <pthread.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <time.h>

#include "core/table.h"

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

static double now(void)
{
	struct timespec t;

	clock_gettime(CLOCK_MONOTONIC, &t);
	return (double)t.tv_sec + 1e-9 * (double)t.tv_nsec;
}

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
	double begin = now();

	for (int i = 0; i < THREADS; i++)
		shares[i] = (struct share){.table = table, .errors = errors};
	share_out(shares);
	return now() - begin;
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
	begin = now();
	copy(to, t->second, bytes);
	begin = now() - begin;
	free(to);
	return begin * (double)table_bytes(t) / (double)bytes;
}

static void report(enum operator_family family, const struct profile *profile,
    enum table_layout layout, int resolution)
{
	float *errors = malloc(sizeof(*errors) * TABLE_SAMPLE * TABLE_QUANTITIES);
	struct table_error e;
	struct table *t;
	double seconds, copy;
	char name[32];

	if (!errors || table_create(family, profile, layout, resolution, &t))
		abort();
	seconds = in_threads(t, NULL);
	copy = copy_seconds(t);
	in_threads(t, errors);
	table_error_summarise(errors, TABLE_SAMPLE, TABLE_SAMPLE, &e);
	if (profile->type == PROFILE_BULGE)
		snprintf(name, sizeof(name), "bulge %.2g", profile->k);
	else
		snprintf(name, sizeof(name), "%s", profile_name(profile->type));
	printf("%-12s %-9s %-7s %4d %6.2f %6.2f %5.0f %6.0f  %.1e %.1e  "
	    "%.1e %.1e %.1e  %.1e %.1e %.1e\n", operator_family_name(family),
	    name, operator_layout_name(layout), resolution,
	    (double)table_bytes_first(t) / (1 << 20),
	    (double)table_bytes(t) / (1 << 20), seconds * 1e3, seconds / copy,
	    e.max[0], e.mean[0], e.p99[1], e.p99[2], e.p99[3],
	    e.p99[4], e.p99[5], e.p99[9]);
	fflush(stdout);
	free(errors);
	table_free(t);
}

/* ---- --orders ---- */

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

static void orders(void)
{
	const struct profile profiles[] = {profile_smooth(),
	    profile_bulge(0.8)};

	printf("family       profile   layout   max_error  N     MiB     ms  "
	    "g max    g mean\n");
	for (int f = 0; f < FAMILY_COUNT; f++)
		for (int p = 0; p < 2; p++)
			report_orders((enum operator_family)f, &profiles[p]);
}

int main(int argc, char **argv)
{
	static const int sizes[] = {8, 16, 24, 32, 48, 64, 96, 128};
	struct profile profiles[] = {profile_smooth(), profile_bulge(0.8)};
	bool sweep = argc > 1 && strcmp(argv[1], "--sweep") == 0;

	if (argc > 1 && strcmp(argv[1], "--orders") == 0) {
		orders();
		return 0;
	}
	printf("family       profile   layout     N  MiB-1  MiB-2    ms /copy  "
	    "g max   g mean   p99 of g1, g2, gt        p99 of g11, g12, gtt\n");
	for (int f = 0; f < FAMILY_COUNT; f++) {
		for (int p = 0; p < 2; p++) {
			if (!sweep) {
				report(f, &profiles[p], LAYOUT_WARPED, 64);
				report(f, &profiles[p], LAYOUT_UNIFORM, 128);
				continue;
			}
			for (size_t i = 0; i < sizeof(sizes) / sizeof(*sizes); i++)
				for (int l = 0; l < LAYOUT_COUNT; l++)
					report(f, &profiles[p], l, sizes[i]);
		}
	}
	return 0;
}
