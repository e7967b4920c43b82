/*
 * The device's speed on batches of every size, in 10^6 points/s, as the daemon
 * has it, and ("whole") with every point walking the whole tape; and how long
 * a small call takes. Beside them, in the same repetitions:
 *
 *   /native    the same tape, points and outputs in hand-written C (native.h);
 *              /native-cpu in processor time rather than the clock's
 *   /straight  the scene of sums as one loop in C, no tape
 *   /copy      a copy of the request's and the answer's bytes, one thread
 *   /float64   core/evaluate.h, one thread
 *   /whole     the device again, with every point walking the whole tape
 *
 * Before it is timed, native's rows are compared with the device's.
 */
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "core/evaluate.h"
#include "core/output.h"
#include "core/tape.h"
#include "kernels/device.h"
#include "tests/bench/bench.h"
#include "tests/bench/native.h"
#include "tests/bench/report.h"

#define BOTH (OUTPUT_VALUE | OUTPUT_GRADIENT)

/* Of a column's greatest number: how far native may be from the device, at all
 * but one of so many points. Those that are further off lie on folds, whose
 * sides rounding chooses. */
#define AGREE 1e-3
#define AGREE_BUT 1000

struct run {
	struct bench_devices *devices;
	struct bench_loaded loaded;
	const struct scene *scene;
	size_t count;
	unsigned outputs;
};

/* Batches of a run, so that the clock's own time is none of it. */
static size_t times(const struct run *r)
{
	return r->count < 100000 ? 20000 / r->count + 1 : 1;
}

static double run_device(struct run *r, enum bench_mode mode)
{
	double begin = bench_now();

	for (size_t i = 0; i < times(r); i++)
		if (device_evaluate(r->devices->device[mode],
		    r->loaded.tape[mode], r->devices->points, r->count,
		    r->outputs, r->devices->rows, NULL, NULL))
			abort();
	return (bench_now() - begin) / (double)(r->count * times(r));
}

static double run_culled(void *ctx)
{
	return run_device(ctx, BENCH_CULLED);
}

static double run_whole(void *ctx)
{
	return run_device(ctx, BENCH_WHOLE);
}

static double run_native(void *ctx)
{
	struct run *r = ctx;
	double begin = bench_now();

	for (size_t i = 0; i < times(r); i++)
		native_evaluate(r->loaded.native, r->devices->points,
		    r->count, r->outputs, r->devices->other_rows);
	return (bench_now() - begin) / (double)(r->count * times(r));
}

static double run_straight(void *ctx)
{
	struct run *r = ctx;
	double begin = bench_now();

	for (size_t i = 0; i < times(r); i++)
		native_straight(r->loaded.native, r->devices->points,
		    r->count, r->devices->other_rows);
	return (bench_now() - begin) / (double)(r->count * times(r));
}

static double run_copy(void *ctx)
{
	void *(*volatile copy)(void *, const void *, size_t) = memcpy;
	struct run *r = ctx;
	size_t row = (size_t)output_row_floats(r->outputs);
	double begin = bench_now();

	for (size_t i = 0; i < times(r); i++) {
		copy(r->devices->other_points, r->devices->points,
		    r->count * 3 * sizeof(float));
		copy(r->devices->other_rows, r->devices->rows,
		    r->count * row * sizeof(float));
	}
	return (bench_now() - begin) / (double)(r->count * times(r));
}

/* 100 points from all over the batch. */
static double run_float64(void *ctx)
{
	struct run *r = ctx;
	size_t most = 100, done = 0;
	size_t step = r->count < most ? 1 : r->count / most;
	double begin = bench_now();
	struct jet jet;

	for (size_t i = 0; i < r->count && done < most; i += step, done++) {
		const float *p = r->devices->points + 3 * i;

		evaluate(r->scene->tape, vec3((double)p[0], (double)p[1],
		    (double)p[2]), output_order(r->outputs), &jet);
	}
	return (bench_now() - begin) / (double)done;
}

/* --- agreement ------------------------------------------------------------ */

/* Values and gradients, or Hessians. */
static int block_of(int column)
{
	return column == 0 ? 0 : column < 4 ? 1 : 2;
}

/* The difference at the count / AGREE_BUT-th worst point, over the greatest
 * number of the column's block. */
static double worst(const float *a, const float *b, size_t count, int row,
    int block)
{
	double *off = bench_allocate(count * sizeof(*off)), most = 1e-30, r;

	for (size_t i = 0; i < count; i++)
		for (int k = 0; k < row; k++) {
			size_t at = i * (size_t)row + (size_t)k;

			if (block_of(k) != block)
				continue;
			most = fmax(most, fabs((double)b[at]));
			off[i] = fmax(off[i], fabs((double)a[at] -
			    (double)b[at]));
		}
	report_median(off, count);
	r = off[count - 1 - count / AGREE_BUT] / most;
	free(off);
	return r;
}

/* Whether native does the same work: aborts where it does not. */
static void compare(struct run *r)
{
	int row = output_row_floats(r->outputs);
	char text[96];
	double off[3];

	run_whole(r);
	run_native(r);
	for (int block = 0; block < 3; block++)
		off[block] = worst(r->devices->other_rows, r->devices->rows,
		    r->count, row, block);
	snprintf(text, sizeof(text), "value %.1e, gradient %.1e, Hessian %.1e",
	    off[0], off[1], off[2]);
	report_note(r->scene->name, text);
	if (off[0] > AGREE || off[1] > AGREE) {
		fprintf(stderr, "%s: the native evaluator is wrong\n",
		    r->scene->name);
		abort();
	}
}

/* --- figures -------------------------------------------------------------- */

static const char *output_names(unsigned outputs)
{
	return outputs == OUTPUT_VALUE ? "value" : outputs == BOTH ?
	    "value gradient" : "with Hessian";
}

static void report_batch(struct run *r, enum scene_order order,
    int repetitions)
{
	struct race_runner list[] = {
		{.name = "culled", .run = run_culled},
		{.name = "whole", .run = run_whole},
		{.name = "native", .run = run_native,
			.cpu_name = "native-cpu"},
		{.name = "copy", .run = run_copy},
		{.name = "float64", .run = run_float64},
		{.name = "straight", .run = run_straight,
			.cpu_name = "straight-cpu"},
	};
	int count = native_is_straight(r->loaded.native) &&
	    r->outputs == BOTH && r->count >= 4096 ? 6 : 5;
	char name[128];

	scene_place(r->scene, order, r->count, r->devices->points);
	race(list, count, repetitions, r);
	snprintf(name, sizeof(name), "%.48s; %s; %s; %zu", r->scene->name,
	    scene_order_name(order), output_names(r->outputs), r->count);
	race_report(list, count, repetitions, "device, points", name, "10^6/s",
	    true, 1e-6);
	strcat(name, "; whole");
	race_report(list + 1, count - 1, repetitions, "device, points", name,
	    "10^6/s", true, 1e-6);
}

/* A batch's size and outputs; the quick bench has the first ones. */
struct batch {
	size_t count;
	unsigned outputs;
};

static void report_scene(struct bench_devices *devices,
    const struct scene *scene, bool quick)
{
	static const struct batch batches[] = {
		{1000000, BOTH}, {4096, BOTH}, {256, BOTH},
		{1000000, OUTPUT_VALUE}, {1000000, BOTH | OUTPUT_HESSIAN}};
	struct run r = {.devices = devices, .scene = scene};
	size_t most = quick ? 1 : sizeof(batches) / sizeof(*batches);

	bench_load(scene, &r.loaded);
	r.count = 65536;
	r.outputs = BOTH | OUTPUT_HESSIAN;
	scene_place(scene, SCENE_SHUFFLED, r.count, devices->points);
	compare(&r);
	r.outputs = BOTH;
	compare(&r);
	for (size_t i = 0; i < 2 * most; i++) {
		r.count = batches[i / 2].count;
		r.outputs = batches[i / 2].outputs;
		report_batch(&r, i % 2 ? SCENE_SHUFFLED : SCENE_GRID,
		    quick ? 3 : r.count <= 100000 ? 9 : i < 2 ? 5 : 3);
	}
	bench_unload(&r.loaded);
}

/* --- a small call's time -------------------------------------------------- */

struct call {
	struct run scene, empty;
};

static double call_scene(void *ctx)
{
	struct call *c = ctx;

	return run_culled(&c->scene) * (double)c->scene.count;
}

static double call_empty(void *ctx)
{
	struct call *c = ctx;

	return run_culled(&c->empty) * (double)c->empty.count;
}

static double call_native(void *ctx)
{
	struct call *c = ctx;

	return run_native(&c->scene) * (double)c->scene.count;
}

/* A call of 256 points beside one of a single primitive, which is what a launch
 * and its wait cost. */
static void report_call(struct bench_devices *devices,
    const struct scene *scene, const struct scene *one, bool quick)
{
	struct race_runner list[] = {
		{.name = "call", .run = call_scene},
		{.name = "empty", .run = call_empty},
		{.name = "native", .run = call_native},
	};
	struct call c = {
		.scene = {.devices = devices, .scene = scene, .count = 256,
			.outputs = BOTH},
		.empty = {.devices = devices, .scene = one, .count = 256,
			.outputs = BOTH}};
	int repetitions = quick ? 5 : RACE_REPETITIONS_MAX;
	char name[128];

	bench_load(scene, &c.scene.loaded);
	bench_load(one, &c.empty.loaded);
	scene_place(scene, SCENE_RANDOM, 256, devices->points);
	race(list, 3, repetitions, &c);
	snprintf(name, sizeof(name), "%.48s; 256 random points",
	    scene->name);
	race_report(list, 3, repetitions, "device, one call", name, "us",
	    false, 1e6);
	bench_unload(&c.scene.loaded);
	bench_unload(&c.empty.loaded);
}

#define SCENES 4

void bench_device(bool quick)
{
	struct bench_devices *devices = bench_devices();
	struct scene scenes[SCENES], one;

	scene_points(scenes, "sum", 50);
	scene_points(scenes + 1, "camel", 50);
	scene_mixed(scenes + 2, 50);
	scene_letter(scenes + 3);
	scene_points(&one, "sum", 1);
	for (int i = 0; i < SCENES; i++)
		report_scene(devices, scenes + i, quick);
	for (int i = 0; i < SCENES; i++)
		report_call(devices, scenes + i, &one, quick);
	for (int i = 0; i < SCENES; i++)
		scene_fini(scenes + i);
	scene_fini(&one);
}
