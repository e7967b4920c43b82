/*
 * What the files server/metrics*.c share: metrics.c counts, metrics_print.c
 * prints what has been counted, metrics_gauges.c what the daemon's parts say,
 * metrics_page.c has the text's form.
 */
#ifndef SERVER_METRICS_INTERNAL_H
#define SERVER_METRICS_INTERNAL_H

#include <stdatomic.h>
#include <stdbool.h>
#include <stddef.h>

#include "server/metrics.h"

struct route;

/* ---- what is counted ---- */

/* Bounds of the histograms' buckets, seconds: 1, 2 and 5 in each decade from 10
 * microseconds to 100 seconds; beyond the last there is one more bucket. */
#define METRICS_BOUNDS 22
extern const double metrics_bounds[METRICS_BOUNDS];

struct metrics_histogram {
	atomic_ulong buckets[METRICS_BOUNDS + 1]; /* not cumulative */
	atomic_ulong nanoseconds;                 /* all together */
};

/* Methods and statuses that are told apart; the last of each is all others. */
#define METRICS_METHODS 8
#define METRICS_STATUSES 32
extern const char *const metrics_methods[METRICS_METHODS];
extern const unsigned metrics_statuses[METRICS_STATUSES]; /* 0: there was none */

/* A route's, or, the last one, that of requests of none. */
struct metrics_endpoint {
	atomic_ulong requests[METRICS_METHODS][METRICS_STATUSES];
	atomic_ulong bytes_in, bytes_out; /* of bodies */
	struct metrics_histogram duration;
	struct metrics_histogram stages[METRICS_STAGE_COUNT];
};

struct metrics {
	const struct route *routes;
	size_t route_count;
	struct metrics_endpoint *endpoints; /* one more than routes */
	double started; /* seconds since 1970 */
	atomic_ulong problems[PROBLEM_COUNT];
};

/* ---- metrics_page.c: Prometheus's text exposition format 0.0.4 ---- */

struct metrics_page {
	char *text; /* malloc'd */
	size_t length, size;
	bool has_failed; /* there was no memory: nothing is added any more */
	const char *family;
};

struct metrics_label {
	const char *name, *value;
};

/* The most labels of a sample. */
#define METRICS_LABELS 6

/* Begins a family; its samples follow. type is "counter", "gauge" or
 * "histogram". */
void metrics_page_family(struct metrics_page *p, const char *name,
    const char *type, const char *help);

/* A sample of the family, its name with suffix behind it. labels end with a name
 * that is NULL; NULL: none. */
void metrics_page_sample(struct metrics_page *p, const char *suffix,
    const struct metrics_label *labels, double value);

/* A family of one sample without labels. */
void metrics_page_one(struct metrics_page *p, const char *name,
    const char *type, const char *help, double value);

/* ---- metrics_gauges.c ---- */

/* What server's parts say, and the process's own. */
void metrics_print_gauges(struct metrics_page *p, struct server *server);

#endif
