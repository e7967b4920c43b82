/*
 * Operator tables ("operator textures"): g and its derivatives sampled once,
 * so that a device looks them up (SPEC section 1, "Tables").
 */
#ifndef CORE_TABLE_H
#define CORE_TABLE_H

#include <stdbool.h>
#include <stddef.h>

#include "core/err.h"
#include "core/operator.h"
#include "core/table_shape.h"

#define TABLE_RESOLUTION_WARPED 64   /* default nodes an axis */
#define TABLE_RESOLUTION_UNIFORM 128 /* the paper's finest, likewise */
#define TABLE_RESOLUTION_MIN 8
#define TABLE_RESOLUTION_MAX 128

/* The default nodes an axis of layout. */
static inline int table_resolution(enum table_layout layout)
{
	return layout == LAYOUT_UNIFORM ? TABLE_RESOLUTION_UNIFORM :
	    TABLE_RESOLUTION_WARPED;
}

/*
 * One operator family and profile, sampled. Filled by table_build; read-only
 * afterwards, by any number of threads.
 */
struct table {
	enum operator_family family;
	struct profile profile;
	enum table_layout layout;
	int resolution;      /* nodes an axis, N */
	size_t node_count;   /* N^3 */
	/* One after the other, table_bytes of them: a copy of these bytes into a
	 * table of the same kind completes it. */
	float *first;        /* node_count * TABLE_FIRST */
	float *second;       /* node_count * TABLE_SECOND */
	float *curves;       /* 2 * TABLE_CURVE_NODES * CURVE_NODE */
};

/* The quantities a table gives: the members of struct operator_jet, in order. */
#define TABLE_QUANTITIES 10

/* Error of a table against the exact operator, over a sample. */
struct table_error {
	size_t count;
	double max[TABLE_QUANTITIES];
	double mean[TABLE_QUANTITIES];
	double p99[TABLE_QUANTITIES]; /* the 99th percentile */
};

/*
 * Allocates a table of the given kind, unfilled. resolution lies in
 * TABLE_RESOLUTION_MIN..MAX. ERR_MEMORY.
 */
enum err table_create(enum operator_family family,
    const struct profile *profile, enum table_layout layout, int resolution,
    struct table **out);

/* Frees t; NULL does nothing. */
void table_free(struct table *t);

/*
 * Fills theta-slices first..last-1 of the table's resolution. Slices are
 * independent: threads may fill different ones at once. When all are filled
 * the table is complete (the curves come with slice 0).
 */
void table_build(struct table *t, int first, int last);

/*
 * Whether t, filled with bytes from elsewhere, may be what table_build gives:
 * every number is finite, and count of its nodes, spread over all, computed
 * anew, agree bit for bit. Finds tables of another version, or built with
 * another mathematical library; a checksum finds damage.
 */
bool table_verify(const struct table *t, int count);

/*
 * What a lookup gives at (f1, f2, theta), in float64 arithmetic on the
 * table's float32 samples: as operator_eval, with the table's error.
 */
void table_lookup(const struct table *t, double f1, double f2, double theta,
    int order, struct operator_jet *out);

/* Points of the fixed sample that a reported error is measured on. */
#define TABLE_SAMPLE 1000000

/*
 * The error of t over points first..last-1 of the fixed sample (a
 * low-discrepancy sequence over [0,1]^2 x [0, pi/4]; the paper's Fig. 11 does
 * this for g). The absolute difference of quantity k at point i goes to
 * errors[k * stride + i]; threads may do different points at once.
 */
void table_measure(const struct table *t, size_t first, size_t last,
    float *errors, size_t stride);

/*
 * The exact g at points first..last-1 of the fixed sample, to g[first] and
 * on: what several tables of one family and profile are measured against.
 */
void table_sample(enum operator_family family, const struct profile *profile,
    size_t first, size_t last, double *g);

/*
 * The error of t in g alone over points first..last-1, of which exact is what
 * table_sample gives: the largest absolute difference; their sum is added to
 * *sum. The sample's beginnings are as evenly spread as the whole, so a bad
 * table shows soon.
 */
double table_measure_g(const struct table *t, size_t first, size_t last,
    const double *exact, double *sum);

/* Sums up the first count points that table_measure wrote; permutes them. */
void table_error_summarise(float *errors, size_t stride, size_t count,
    struct table_error *out);

/* Bytes of the part for g and first derivatives, and of all parts and curves. */
size_t table_bytes_first(const struct table *t);
size_t table_bytes(const struct table *t);

#endif
