/*
 * What size costs. 100, 1,000 and 10,000 small primitives with the same density
 * of overlap, in 10^6 points/s:
 *
 *   /whole  the device with every point walking the whole tape, on as many
 *           points as it does in about a second
 *   /100    the scene of 100 primitives, culled, in the same repetitions: 0.25
 *           says that a point costs four times as much
 *
 * And what it takes to get the largest scene from its text onto the device, in
 * ms, beside a copy of that text.
 */
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "core/output.h"
#include "core/tape.h"
#include "kernels/device.h"
#include "proto/document.h"
#include "proto/fault.h"
#include "tests/bench/bench.h"
#include "tests/bench/report.h"

#define BOTH (OUTPUT_VALUE | OUTPUT_GRADIENT)

/* About what one run may take. */
#define SECONDS 0.8
#define QUICK_SECONDS 0.1

struct run {
	struct bench_devices *devices;
	struct bench_loaded loaded, small;
	size_t count, whole_count;
};

static double run_device(struct bench_devices *d, struct bench_loaded *l,
    enum bench_mode mode, size_t count)
{
	double begin = bench_now();

	if (device_evaluate(d->device[mode], l->tape[mode], d->points, count,
	    BOTH, d->rows, NULL, NULL))
		abort();
	return (bench_now() - begin) / (double)count;
}

static double run_culled(void *ctx)
{
	struct run *r = ctx;

	return run_device(r->devices, &r->loaded, BENCH_CULLED, r->count);
}

static double run_whole(void *ctx)
{
	struct run *r = ctx;

	return run_device(r->devices, &r->loaded, BENCH_WHOLE, r->whole_count);
}

static double run_small(void *ctx)
{
	struct run *r = ctx;

	return run_device(r->devices, &r->small, BENCH_CULLED, r->count);
}

/* As many of the batch's points as a run may take, from one of a few. */
static size_t affordable(struct run *r, enum bench_mode mode, size_t most,
    double seconds)
{
	size_t count = 4096;
	double each, n;

	do {
		each = run_device(r->devices, &r->loaded, mode, count);
		n = seconds / each;
		count *= 8;
	} while (n > 4.0 * (double)count && count <= most);
	if (n >= (double)most)
		return most;
	return n < 4096.0 ? 4096 : (size_t)n;
}

static void report_points(struct run *r, const struct scene *scene,
    enum scene_order order, bool quick)
{
	struct race_runner list[] = {
		{.name = "culled", .run = run_culled},
		{.name = "whole", .run = run_whole, .cpu_name = "whole-cpu"},
		{.name = "100", .run = run_small, .cpu_name = "100-cpu"},
	};
	size_t most = quick ? 200000 : BENCH_POINTS_MAX;
	double seconds = quick ? QUICK_SECONDS : SECONDS;
	char name[96];
	int n;

	scene_place(scene, order, most, r->devices->points);
	r->count = most;
	r->whole_count = affordable(r, BENCH_WHOLE, most, seconds);
	n = run_culled(r) * (double)most < 4.0 * seconds ? 3 : 1;
	race(list, 3, n, r);
	snprintf(name, sizeof(name), "%.48s; %s; %zu", scene->name,
	    scene_order_name(order), r->count);
	race_report(list, 3, n, "scale, points", name, "10^6/s", true, 1e-6);
}

static void report_kind(const char *kind, bool quick)
{
	static const int counts[] = {100, 1000, 10000};
	struct run r = {.devices = bench_devices()};
	struct scene small, scene;

	scene_points(&small, kind, counts[0]);
	bench_load(&small, &r.small);
	for (size_t i = 0; i < sizeof(counts) / sizeof(*counts); i++) {
		scene_points(&scene, kind, counts[i]);
		bench_load(&scene, &r.loaded);
		report_points(&r, &scene, SCENE_RANDOM, quick);
		if (!quick)
			report_points(&r, &scene, SCENE_GRID, quick);
		bench_unload(&r.loaded);
		scene_fini(&scene);
	}
	bench_unload(&r.small);
	scene_fini(&small);
}

/* --- preparation ---------------------------------------------------------- */

struct preparation {
	struct bench_devices *devices;
	const struct scene *scene;
	char *copy;
};

static double run_compile(void *ctx)
{
	struct preparation *p = ctx;
	struct tape_error error;
	struct tape *tape;
	double begin = bench_now();

	if (tape_compile(document_tree(p->scene->document), 100000, &tape,
	    &error))
		abort();
	begin = bench_now() - begin;
	tape_free(tape);
	return begin;
}

static double run_load(void *ctx)
{
	struct preparation *p = ctx;
	struct device *device = p->devices->device[BENCH_CULLED];
	int slots[BENCH_OPERATORS_MAX];
	struct device_tape *tape;
	double begin;

	bench_slots(p->scene->tape, BENCH_CULLED, slots);
	begin = bench_now();
	if (device_load_tape(device, p->scene->tape, slots, &tape))
		abort();
	begin = bench_now() - begin;
	device_drop_tape(device, tape);
	return begin;
}

/* Compiling is part of it. */
static double run_parse(void *ctx)
{
	const struct document_limits limits = {.max_nodes = 100000,
	    .layout = LAYOUT_WARPED};
	struct preparation *p = ctx;
	struct faults faults = {0};
	struct document *document;
	double begin = bench_now();

	if (document_parse(p->scene->text, p->scene->length, &limits,
	    &document, &faults))
		abort();
	begin = bench_now() - begin;
	document_free(document);
	return begin;
}

static double run_copy(void *ctx)
{
	void *(*volatile copy)(void *, const void *, size_t) = memcpy;
	struct preparation *p = ctx;
	double begin = bench_now();

	copy(p->copy, p->scene->text, p->scene->length);
	return bench_now() - begin;
}

static void report_preparation(bool quick)
{
	struct race_runner compile[] = {
		{.name = "compile", .run = run_compile},
		{.name = "copy", .run = run_copy}};
	struct race_runner load[] = {
		{.name = "load", .run = run_load},
		{.name = "copy", .run = run_copy}};
	struct race_runner parse[] = {
		{.name = "parse", .run = run_parse},
		{.name = "copy", .run = run_copy}};
	struct preparation p = {.devices = bench_devices()};
	int n = quick ? 3 : 9;
	struct scene scene;

	scene_points(&scene, "camel", 10000);
	p.scene = &scene;
	p.copy = bench_allocate(scene.length);
	race(compile, 2, n, &p);
	race(load, 2, n, &p);
	race(parse, 2, n, &p);
	race_report(compile, 2, n, "scale, preparation",
	    "10000 points, camel; tape_compile", "ms", false, 1e3);
	race_report(load, 2, n, "scale, preparation",
	    "10000 points, camel; device_load_tape", "ms", false, 1e3);
	race_report(parse, 2, n, "scale, preparation",
	    "10000 points, camel; document_parse", "ms", false, 1e3);
	free(p.copy);
	scene_fini(&scene);
}

void bench_scale(bool quick)
{
	report_preparation(quick);
	report_kind("sum", quick);
	report_kind("camel", quick);
}
