/*
 * Operator tables: what they weigh, how long they take to build, how far they
 * are from the exact operator. A table on stdout, one line a table; the error
 * is over the fixed sample that the daemon reports too.
 *
 *   bench_tables          the built-in tables, and the paper's grid beside them
 *   bench_tables --sweep  size against error, from 8 to 128 nodes an axis
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
};

static double now(void)
{
	struct timespec t;

	clock_gettime(CLOCK_MONOTONIC, &t);
	return (double)t.tv_sec + 1e-9 * (double)t.tv_nsec;
}

static void *work(void *arg)
{
	const struct share *s = arg;
	size_t first = TABLE_SAMPLE / THREADS * (size_t)s->index;

	if (s->errors) {
		table_measure(s->table, first, first + TABLE_SAMPLE / THREADS,
		    s->errors, TABLE_SAMPLE);
		return NULL;
	}
	for (int i = s->index; i < s->table->resolution; i += THREADS)
		table_build(s->table, i, i + 1);
	return NULL;
}

static double in_threads(struct table *table, float *errors)
{
	struct share shares[THREADS];
	pthread_t threads[THREADS];
	double begin = now();

	for (int i = 0; i < THREADS; i++) {
		shares[i] = (struct share){table, errors, i};
		if (pthread_create(&threads[i], NULL, work, &shares[i]))
			abort();
	}
	for (int i = 0; i < THREADS; i++)
		pthread_join(threads[i], NULL);
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

int main(int argc, char **argv)
{
	static const int sizes[] = {8, 16, 24, 32, 48, 64, 96, 128};
	struct profile profiles[] = {profile_smooth(), profile_bulge(0.8)};
	bool sweep = argc > 1 && strcmp(argv[1], "--sweep") == 0;

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
