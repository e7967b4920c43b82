/*
 * What skipping saves: surfaces of models at 256 cells along their longest side,
 * with normals and colours, beside the values of a full grid of such cells.
 *
 *   /cube   257^3 values, culled, as the daemon evaluates them
 *   /box    the values of the grid in the surface's own box, culled
 *   /whole  the same as /cube, every point walking the whole tape: of as many
 *           points as it does in about a second, the rest reckoned
 *
 * And, without ratio, how many points the mesh has asked for of those of the
 * cube and of the box; and what a ray of a picture takes.
 */
#include <math.h>
#include <stdio.h>
#include <stdlib.h>

#include "core/mesh.h"
#include "core/output.h"
#include "core/picture.h"
#include "core/range.h"
#include "core/sampler.h"
#include "core/tape.h"
#include "kernels/device.h"
#include "tests/bench/bench.h"
#include "tests/bench/report.h"

#define CELLS 256
#define CUBE ((size_t)(CELLS + 1) * (CELLS + 1) * (CELLS + 1))

/* Points of the grid at a time: whole layers of the cube. */
#define LAYERS 8
#define BATCH ((size_t)LAYERS * (CELLS + 1) * (CELLS + 1))

#define PICTURE_WIDTH 320
#define PICTURE_HEIGHT 240

struct run {
	struct sampler sampler; /* first */
	struct bench_devices *devices;
	struct bench_loaded loaded;
	struct range_tape *ranges;
	struct tape_box extent;
	struct mesh_options options;
	struct mesh_figures figures;
	float *points, *rows;
	uint8_t *rgba;
};

static enum err sample(struct sampler *sampler, const float *points,
    size_t count, unsigned outputs, float *rows)
{
	struct run *r = (struct run *)sampler;

	return device_evaluate(r->devices->device[BENCH_CULLED],
	    r->loaded.tape[BENCH_CULLED], points, count, outputs, rows, NULL,
	    NULL);
}

/* Seconds for the mesh. */
static double run_mesh(void *ctx)
{
	struct run *r = ctx;
	double begin = bench_now();
	struct mesh *mesh;

	if (mesh_build(r->ranges, &r->options, &r->sampler, &mesh))
		abort();
	begin = bench_now() - begin;
	r->figures = mesh->figures;
	mesh_free(mesh);
	return begin;
}

/* Seconds for values at layers of counts[0] x counts[1] corners, from the
 * grid's lowest on: of count layers, which the first is where. */
static double layers(struct run *r, enum bench_mode mode,
    const size_t counts[static 3], size_t first, size_t count)
{
	const double edge = r->options.edge;
	const double low[3] = {r->options.min.x, r->options.min.y,
	    r->options.min.z};
	size_t n = 0;
	double begin;

	for (size_t z = first; z < first + count; z++)
		for (size_t y = 0; y < counts[1]; y++)
			for (size_t x = 0; x < counts[0]; x++, n++) {
				const size_t at[3] = {x, y, z};

				for (int k = 0; k < 3; k++)
					r->points[3 * n + (size_t)k] =
					    (float)(low[k] + edge *
					    (double)at[k]);
			}
	begin = bench_now();
	if (device_evaluate(r->devices->device[mode], r->loaded.tape[mode],
	    r->points, n, OUTPUT_VALUE, r->rows, NULL, NULL))
		abort();
	return bench_now() - begin;
}

static double grid(struct run *r, const size_t counts[static 3])
{
	double seconds = 0.0;

	for (size_t z = 0; z < counts[2]; z += LAYERS)
		seconds += layers(r, BENCH_CULLED, counts, z,
		    counts[2] - z < LAYERS ? counts[2] - z : LAYERS);
	return seconds;
}

static double run_cube(void *ctx)
{
	static const size_t counts[3] = {CELLS + 1, CELLS + 1, CELLS + 1};

	return grid(ctx, counts);
}

static double run_box(void *ctx)
{
	struct run *r = ctx;
	size_t counts[3];

	for (int k = 0; k < 3; k++)
		counts[k] = r->figures.counts[k] + 1;
	return grid(r, counts);
}

/* A fraction of a layer in the middle, reckoned to the cube. */
static double run_whole(void *ctx)
{
	static const size_t counts[3] = {CELLS + 1, (CELLS + 1) / 8, CELLS + 1};

	return layers(ctx, BENCH_WHOLE, counts, CELLS / 2, 1) *
	    (double)CUBE / (double)(counts[0] * counts[1]);
}

/* Seconds a ray. */
static double run_picture(void *ctx)
{
	struct run *r = ctx;
	const struct picture_render options = {
		.width = PICTURE_WIDTH,
		.height = PICTURE_HEIGHT,
		.camera = picture_frame(&r->extent, PICTURE_WIDTH,
		    PICTURE_HEIGHT),
		.samples = 1,
		.iso = 0.5,
		.extent = &r->extent,
	};
	double begin = bench_now();

	if (picture_render(r->ranges, &options, &r->sampler, r->rgba))
		abort();
	return (bench_now() - begin) / (PICTURE_WIDTH * PICTURE_HEIGHT);
}

static void prepare(struct run *r, const struct scene *s)
{
	const struct tape_box *box = s->tape->boxes + s->tape->insn_count - 1;
	double longest = 0.0;

	bench_load(s, &r->loaded);
	if (range_tape_create(s->tape, &r->ranges) ||
	    range_extent(r->ranges, 0.5, box, 0.02, NULL,
	    &r->extent))
		abort();
	for (int k = 0; k < 3; k++)
		longest = fmax(longest, (double)r->extent.max[k] -
		    (double)r->extent.min[k]);
	r->options = (struct mesh_options){
		.min = {r->extent.min[0], r->extent.min[1], r->extent.min[2]},
		.max = {r->extent.max[0], r->extent.max[1], r->extent.max[2]},
		.edge = longest / CELLS,
		.iso = 0.5,
		.features = true,
		.normals = true,
		.colors = true,
	};
}

static void report_points(const struct run *r, const char *name)
{
	const double points = (double)r->figures.points;
	char line[96];

	snprintf(line, sizeof(line), "%s: points of the cube to those asked for",
	    name);
	report_add(&(struct report_figure){.group = "mesh", .name = line,
	    .unit = "", .value = CUBE / points, .least = CUBE / points,
	    .most = CUBE / points});
	snprintf(line, sizeof(line), "%s: points of the box to those asked for",
	    name);
	report_add(&(struct report_figure){.group = "mesh", .name = line,
	    .unit = "", .value = (double)r->figures.full_points / points,
	    .least = (double)r->figures.full_points / points,
	    .most = (double)r->figures.full_points / points});
}

static void bench_model(struct run *r, const char *path, bool quick)
{
	struct race_runner meshes[] = {
		{"", run_mesh, NULL, {0}, {0}, 0.0, 0.0},
		{"cube", run_cube, NULL, {0}, {0}, 0.0, 0.0},
		{"box", run_box, NULL, {0}, {0}, 0.0, 0.0},
		{"whole", run_whole, NULL, {0}, {0}, 0.0, 0.0},
	};
	struct race_runner pictures[] = {
		{"", run_picture, NULL, {0}, {0}, 0.0, 0.0},
	};
	const int repetitions = quick ? 1 : 5;
	char name[96];
	struct scene s;

	scene_file(&s, path);
	prepare(r, &s);
	run_mesh(r); /* run_box needs its figures */
	race(meshes, 4, repetitions, r);
	snprintf(name, sizeof(name), "%s at 256 cells: %zu triangles", s.name,
	    r->figures.triangles);
	race_report(meshes, 4, repetitions, "mesh", name, "ms", false, 1e3);
	report_points(r, s.name);
	race(pictures, 1, repetitions, r);
	snprintf(name, sizeof(name), "%s, 320 x 240: a ray", s.name);
	race_report(pictures, 1, repetitions, "mesh", name, "us", false, 1e6);
	range_tape_free(r->ranges);
	bench_unload(&r->loaded);
	scene_fini(&s);
}

void bench_mesh(bool quick)
{
	struct run r = {
		.sampler.sample = sample,
		.devices = bench_devices(),
		.points = bench_allocate(3 * BATCH * sizeof(float)),
		.rows = bench_allocate(BATCH * sizeof(float)),
		.rgba = bench_allocate(4 * PICTURE_WIDTH * PICTURE_HEIGHT),
	};

	bench_model(&r, "clients/models/letter-a.json", quick);
	bench_model(&r, "clients/models/thousand.json", quick);
	free(r.points);
	free(r.rows);
	free(r.rgba);
}
