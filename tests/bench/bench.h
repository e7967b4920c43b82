/*
 * What the parts of the bench share: devices opened both ways, operators'
 * tables, buffers, and races, whose runners take turns.
 */
#ifndef TESTS_BENCH_BENCH_H
#define TESTS_BENCH_BENCH_H

#include <stdbool.h>
#include <stddef.h>

#include "tests/bench/scenes.h"

struct device;
struct device_tape;
struct native;
struct tape;

#define BENCH_POINTS_MAX 1000000
#define BENCH_ROW_MAX 10

/* Monotonic seconds. */
double bench_now(void);

/* Zeroed memory; aborts where there is none. */
void *bench_allocate(size_t size);

/* --- races ---------------------------------------------------------------- */

#define RACE_REPETITIONS_MAX 15
#define RACE_RUNNERS_MAX 6

/* One of several ways of doing the same work. */
struct race_runner {
	const char *name;
	double (*run)(void *ctx);  /* does it; seconds a unit of work */
	const char *cpu_name;      /* NULL, or the name of the ratio of the
	                            * processor's time, which what else the
	                            * machine does disturbs less */
	double seconds[RACE_REPETITIONS_MAX]; /* sorted once raced */
	double cpu[RACE_REPETITIONS_MAX];     /* of all threads, likewise */
	double median, cpu_median;
};

/* Every runner in turn, repetitions times; if that is more than once, after one
 * untimed turn of each. */
void race(struct race_runner *runners, int count, int repetitions, void *ctx);

/*
 * Reports the first runner beside all others; per_second: as work a second,
 * times scale, else as seconds times scale.
 */
void race_report(const struct race_runner *runners, int count,
    int repetitions, const char *group, const char *name, const char *unit,
    bool per_second, double scale);

/* --- devices -------------------------------------------------------------- */

enum bench_mode {
	BENCH_CULLED, /* as the daemon opens it */
	BENCH_WHOLE,  /* every point walks the whole tape */
	BENCH_MODES
};

struct bench_devices {
	struct device *device[BENCH_MODES];
	float *points, *rows, *other_points, *other_rows;
};

/* Opened once, on first use; the process ends where there is no device. */
struct bench_devices *bench_devices(void);
void bench_devices_close(void);

/* A scene made ready for both devices and for the native evaluator. */
struct bench_loaded {
	struct device_tape *tape[BENCH_MODES];
	struct native *native;
};
void bench_load(const struct scene *s, struct bench_loaded *out);
void bench_unload(struct bench_loaded *l);

/* The slots of tape's operators on one device, whose tables are made resident. */
void bench_slots(const struct tape *tape, enum bench_mode mode, int *slots);
#define BENCH_OPERATORS_MAX 16

/* --- parts ---------------------------------------------------------------- */

/* quick: fewer figures and repetitions. */
void bench_device(bool quick);
void bench_scale(bool quick);
void bench_tables(bool quick);
void bench_mesh(bool quick);
void bench_start(bool quick);

/* Kernels generated for a scene, and tables of other sizes, as parts of their own: not part of a usual run. */
void bench_specialised(bool quick);
void bench_tables_sweep(void);
void bench_tables_orders(void);

#endif
