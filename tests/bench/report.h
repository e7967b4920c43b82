/*
 * What every part of the bench reports to: a readable line on stdout, and an
 * entry of the JSON file that the bench writes at its end.
 */
#ifndef TESTS_BENCH_REPORT_H
#define TESTS_BENCH_REPORT_H

#include <stddef.h>

/* A figure, and what it is beside something run in the same repetitions. */
struct report_ratio {
	const char *beside; /* "native", "copy", ... */
	double value;       /* of medians; above 1: ours is the better one */
};

struct report_figure {
	const char *group;  /* "device", "wire", ... */
	const char *name;   /* "50 points, sum; random; value gradient" */
	const char *unit;   /* "10^6/s", "us", ... */
	double value;       /* the median */
	double least, most; /* over the repetitions */
	struct report_ratio ratios[8]; /* up to one without a name */
};

/* Prints f's line, under a heading where its group is new; keeps it. */
void report_add(const struct report_figure *f);

/* Keeps a line of text about the machine or the device: "device", "pthread". */
void report_note(const char *key, const char *value);

/* Writes everything as JSON; 0, or -1 with errno. */
int report_write(const char *path);

/* The median of count numbers, which are sorted. */
double report_median(double *values, size_t count);

#endif
