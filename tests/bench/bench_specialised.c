/*
 * Whether kernels generated for one scene would pay: the tape written out as
 * straight OpenCL C, its operations and orders known to the compiler, beside the
 * interpreter, on whole tapes and as it is. Also what the compiler takes. They
 * do not pay (RESULTS.md), so this is all there is of them. Points are taken to
 * have the exponent 3, as those of the scenes have.
 */
#include <stdarg.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "core/output.h"
#include "core/tape.h"
#include "kernels/device_internal.h"
#include "kernels/source.h"
#include "tests/bench/bench.h"
#include "tests/bench/report.h"

#define POINTS 999936 /* whole work-items */
#define TIMES 5
#define OUTPUTS (OUTPUT_VALUE | OUTPUT_GRADIENT)
#define ROOM ((size_t)1 << 20) /* of what is generated */

struct text {
	char *at;
	size_t length, size;
};

__attribute__((format(printf, 2, 3)))
static void put(struct text *t, const char *format, ...)
{
	va_list args;

	va_start(args, format);
	t->length += (size_t)vsnprintf(t->at + t->length,
	    t->size - t->length, format, args);
	va_end(args);
	if (t->length >= t->size)
		abort();
}

/* A point with the sum that takes it. */
static void put_pair(struct text *t, const struct insn *i, unsigned top)
{
	put(t, "cubic_add(params + %u, x, %d, &s%u);\n", i->param,
	    tape_order(i, output_order(OUTPUTS)), top - 1);
}

/* Instruction i, with top jets in s0, s1 ...; returns how many then. */
static unsigned put_insn(struct text *t, const struct insn *i, unsigned top)
{
	int order = tape_order(i, output_order(OUTPUTS));
	unsigned a = top - 2, b = top - 1;

	if (i->op == OP_FRAME)
		put(t, "x = enter_frame(params + %u, base);\n", i->param);
	else if (i->op == OP_CARRY)
		put(t, "carry(params + %u, &s%u, %d);\n", i->param, b, order);
	else if (i->op == OP_POINT)
		put(t, "compose_zero(&s%u, %d);\n"
		    "cubic_add(params + %u, x, %d, &s%u);\n", top, order,
		    i->param, order, top);
	else if (i->op >= OP_PRIMITIVES && i->op < OP_MAX)
		put(t, "primitive_eval(%u, params + %u, x, %d, &s%u);\n",
		    i->op, i->param, order, top);
	else if (i->op >= OP_MAX && i->op < OP_CLASSIC)
		put(t, "compose_plain(%u, params[%u], &s%u, &s%u, %d);\n",
		    i->op, i->param, a, b, order);
	else if (i->op >= OP_UNION)
		put(t, "blend(TABLE_PASS, openings, descs + %u, %u, "
		    "params[%u], &s%u, &s%u, %d);\n", i->index, i->op,
		    i->param, a, b, order);
	if (i->op < OP_PRIMITIVES)
		return top;
	return i->op < OP_MAX ? top + 1 : top - 1;
}

/* The kernels' source and one kernel more; blends are calls, since a program of
 * 50 of them in place would take minutes to build. */
static char *generate(const struct tape *tape)
{
	struct text t = {.size = ROOM + strlen(kernels_source)};
	unsigned top = 0;

	t.at = bench_allocate(t.size);
	put(&t, "%s\n#line 1 \"specialised.cl\"\n"
	    "static __attribute__((noinline)) void blend(TABLE_ARGS,\n"
	    "    __global const float *openings,\n"
	    "    __global const struct operator_desc *desc, uint op,\n"
	    "    float e, struct jetr *a, struct jetr *b, int order)\n{\n"
	    "compose_blend(TABLE_PASS, openings, desc, op, e, a, b, order);\n"
	    "}\n__kernel void specialised(TABLE_ARGS,\n"
	    "    __global const float *openings,\n"
	    "    __global const struct operator_desc *descs,\n"
	    "    __global const float *params, __global const uint *order,\n"
	    "    __global const float *points, __global float *rows)\n{\n"
	    "__global const uint *at = order + get_global_id(0) * WIDTH;\n"
	    "struct vec3r base = draw_in(load_points(points, at)), x = base;\n"
	    "struct vec3r none = vec3r(REAL(0.0f), REAL(0.0f), REAL(0.0f));\n"
	    "struct jetr s0", kernels_source);
	for (unsigned i = 1; i < tape->stack_depth; i++)
		put(&t, ", s%u", i);
	put(&t, ";\n");
	for (size_t i = 0; i < tape->insn_count; i++) {
		const struct insn *insn = tape->insns + i;

		if (insn->op == OP_POINT && insn->index > 0) {
			put_pair(&t, insn, top);
			i++;
		} else {
			top = put_insn(&t, insn, top);
		}
	}
	put(&t, "store_rows(&s0, &none, %u, at, rows);\n}\n", OUTPUTS);
	return t.at;
}

/* What the runners of a race share. */
struct contest {
	struct bench_devices *devices;
	struct bench_loaded loaded;
	cl_program program;
	cl_kernel kernel;
	cl_mem order, points, rows;
};

static cl_mem wrap(struct device *d, void *at, size_t size)
{
	cl_int code;
	cl_mem buffer = clCreateBuffer(d->context, CL_MEM_READ_WRITE |
	    CL_MEM_USE_HOST_PTR, size, at, &code);

	if (!buffer)
		abort();
	return buffer;
}

static void set_arguments(struct contest *c)
{
	struct device *d = c->devices->device[BENCH_WHOLE];
	struct device_tape *t = c->loaded.tape[BENCH_WHOLE];
	const cl_mem arguments[] = {d->tables.arena.buffer,
		d->tables.arena.buffer, t->openings, t->descs, t->params,
		c->order, c->points, c->rows};

	for (cl_uint i = 0; i < sizeof(arguments) / sizeof(*arguments); i++)
		if (clSetKernelArg(c->kernel, i, sizeof(cl_mem),
		    arguments + i))
			abort();
}

static double run_specialised(void *ctx)
{
	struct contest *c = ctx;
	struct device *d = c->devices->device[BENCH_WHOLE];
	size_t items = POINTS / (size_t)d->info.width, group = 4;
	double begin = bench_now();

	if (clEnqueueNDRangeKernel(d->queue, c->kernel, 1, NULL, &items,
	    &group, 0, NULL, NULL) || clFinish(d->queue))
		abort();
	return (bench_now() - begin) / POINTS;
}

static double run_mode(struct contest *c, enum bench_mode mode)
{
	struct bench_devices *d = c->devices;
	double begin = bench_now();

	if (device_evaluate(d->device[mode], c->loaded.tape[mode], d->points,
	    POINTS, OUTPUTS, d->rows, NULL, NULL))
		abort();
	return (bench_now() - begin) / POINTS;
}

static double run_whole(void *ctx)
{
	return run_mode(ctx, BENCH_WHOLE);
}

static double run_culled(void *ctx)
{
	return run_mode(ctx, BENCH_CULLED);
}

static void build(struct contest *c, const struct scene *s)
{
	struct device *d = c->devices->device[BENCH_WHOLE];
	struct device_failure failure = {0};
	char *source = generate(s->tape), name[96];
	double begin = bench_now();
	cl_int code;

	if (device_build(d->context, d->id, source,
	    d->build_options[DEVICE_PLAIN], &c->program, &failure)) {
		fprintf(stderr, "%s\n%s\n", failure.message,
		    failure.build_log ? failure.build_log : "");
		abort();
	}
	c->kernel = clCreateKernel(c->program, "specialised", &code);
	if (!c->kernel)
		abort();
	set_arguments(c);
	run_specialised(c);
	begin = bench_now() - begin;
	snprintf(name, sizeof(name), "%s; build and first launch", s->name);
	report_add(&(struct report_figure){.group = "specialised",
	    .name = name, .unit = "s", .value = begin, .least = begin,
	    .most = begin});
	free(source);
}

static void compete(struct contest *c, const struct scene *s)
{
	struct bench_devices *d = c->devices;

	for (int i = 0; i < 2; i++) {
		struct race_runner runners[] = {
			{.name = "specialised", .run = run_specialised},
			{.name = "whole", .run = run_whole,
				.cpu_name = "whole-cpu"},
			{.name = "culled", .run = run_culled,
				.cpu_name = "culled-cpu"}};
		enum scene_order order = i ? SCENE_SHUFFLED : SCENE_GRID;
		char name[96];

		scene_place(s, order, BENCH_POINTS_MAX, d->points);
		race(runners, 3, TIMES, c);
		snprintf(name, sizeof(name), "%s; %s", s->name,
		    scene_order_name(order));
		race_report(runners, 3, TIMES, "specialised", name, "10^6/s",
		    true, 1e-6);
	}
}

static void measure(struct scene *s)
{
	struct contest c = {.devices = bench_devices()};
	struct device *d = c.devices->device[BENCH_WHOLE];
	uint32_t *order = bench_allocate(POINTS * sizeof(*order));

	for (uint32_t i = 0; i < POINTS; i++)
		order[i] = i;
	bench_load(s, &c.loaded);
	scene_place(s, SCENE_GRID, BENCH_POINTS_MAX, c.devices->points);
	c.order = wrap(d, order, POINTS * sizeof(*order));
	c.points = wrap(d, c.devices->points, POINTS * 3 * sizeof(float));
	c.rows = wrap(d, c.devices->other_rows, POINTS * 4 * sizeof(float));
	build(&c, s);
	compete(&c, s);
	clReleaseKernel(c.kernel);
	clReleaseProgram(c.program);
	clReleaseMemObject(c.order);
	clReleaseMemObject(c.points);
	clReleaseMemObject(c.rows);
	bench_unload(&c.loaded);
	free(order);
	scene_fini(s);
}

void bench_specialised(bool quick)
{
	struct scene s;

	(void)quick;
	scene_points(&s, "sum", 50);
	measure(&s);
	scene_points(&s, "camel", 50);
	measure(&s);
	scene_mixed(&s, 50);
	measure(&s);
	scene_letter(&s);
	measure(&s);
}
