/*
 * Batches go through the device in pieces of whole tiles (core/tile.h), whose
 * points and rows kernels find by their indices. Large pieces on the host's own
 * processor lie in the caller's arrays; all others go through the workspace.
 */
#include "kernels/device_internal.h"

#include <stdint.h>
#include <stdlib.h>
#include <string.h>
#include <time.h>

#include "core/opcode.h"
#include "core/output.h"
#include "core/tiles.h"

/* The most points of a piece: the more points, the smaller the tiles and the
 * fewer the fields in them, and the less often cores wait for the last one. */
#define PIECE_POINTS ((size_t)1 << 20)

/* And of one that may be given up and is not culled. */
#define PLAIN_POINTS ((size_t)65536)

/* ... and about the most instructions times points of such a one. */
#define PIECE_WORK ((size_t)16777216)

/* Both times so much on a GPU, of which 65,536 points are a quarter (an H100): 16
 * ms of it by the rate of tests/bench/RESULTS.md, not timed. */
#define PIECE_GPU 16

/* Points and rows of a piece that are copied into the workspace though the
 * kernel could read and write the caller's. */
#define STAGED_POINTS ((size_t)8192)

/* The most bytes of points and rows that are copied to a device at once. */
#define COPIED_BYTES ((size_t)32 << 20)

/* The most instructions of the tiles' own: 32 MiB, and of one on average where
 * there are more than 4 MiB. */
#define TILE_INSNS ((size_t)1 << 21)
#define TILE_INSNS_MEAN ((size_t)1024)
#define TILE_INSNS_FREE ((size_t)1 << 18)

/* From so many points on, threads help to prepare the tiles. */
#define CREW_POINTS 16384

/* Batches, or a part of one, that go together. */
struct piece {
	const struct device_part *parts;
	size_t part_count;
	size_t count;  /* points of all parts */
	unsigned outputs;
	size_t stride; /* floats of a row */
};

/* A kernel with a tape's arguments set, and which argument is next. */
struct launch {
	cl_kernel kernel;
	cl_uint next;
};

/* Where a piece's points and rows are for the device. */
struct ground {
	struct device_area points, rows;
};

static size_t min_size(size_t a, size_t b)
{
	return a < b ? a : b;
}

/* --- times ------------------------------------------------------------------ */

static double seconds(void)
{
	struct timespec now;

	clock_gettime(CLOCK_MONOTONIC, &now);
	return (double)now.tv_sec + 1e-9 * (double)now.tv_nsec;
}

/* What has passed since the last lap is of that sum. */
static void lap(struct device *d, double *sum)
{
	double now = seconds();

	*sum += now - d->mark;
	d->mark = now;
}

/* Seconds for which the kernel that has ended ran, by the device's clock; or
 * `most`, where it does not say. */
static double kernel_seconds(cl_event ran, double most)
{
	cl_ulong begin = 0, end = 0;
	double nanoseconds;

	if (clGetEventProfilingInfo(ran, CL_PROFILING_COMMAND_START,
	    sizeof(begin), &begin, NULL) != CL_SUCCESS ||
	    clGetEventProfilingInfo(ran, CL_PROFILING_COMMAND_END,
	    sizeof(end), &end, NULL) != CL_SUCCESS || end < begin)
		return most;
	nanoseconds = (double)(end - begin);
	return 1e-9 * nanoseconds < most ? 1e-9 * nanoseconds : most;
}

static void forget_kernel(struct device *d)
{
	if (d->ran)
		clReleaseEvent(d->ran);
	d->ran = NULL;
}

/* The kernel queued has ended. What passed before it began, where points are
 * copied, is of the copies, which may still have been on their way. */
static void lap_kernel(struct device *d)
{
	double begin = d->mark, kernel;

	lap(d, &d->times.kernel);
	if (!d->ran)
		return;
	kernel = kernel_seconds(d->ran, d->mark - begin);
	d->times.kernel += kernel - (d->mark - begin);
	d->times.upload += d->mark - begin - kernel;
	forget_kernel(d);
}

/* --- arguments -------------------------------------------------------------- */

/* Sets the next argument; *code keeps the first failure. */
static void set(cl_kernel kernel, cl_uint *index, size_t size,
    const void *value, cl_int *code)
{
	cl_int failed = clSetKernelArg(kernel, (*index)++, size, value);

	if (*code == CL_SUCCESS)
		*code = failed;
}

static cl_kernel choose(const struct device *d, const struct device_tape *t,
    unsigned outputs)
{
	return d->kernels[t->is_plain && !(outputs & OUTPUT_COLOR) ?
	    DEVICE_PLAIN : DEVICE_WHOLE];
}

/* In the order of the kernel `evaluate`, but for those of a piece. */
static enum err set_tape(struct device *d, const struct device_tape *t,
    unsigned outputs, struct launch *out)
{
	const struct device_store *tables = &d->tables;
	cl_kernel kernel = choose(d, t, outputs);
	cl_uint mask = outputs, *next = &out->next;
	cl_int code = 0;

	*out = (struct launch){.kernel = kernel};
	if (tables->are_images) {
		set(kernel, next, sizeof(cl_mem), &tables->first, &code);
		set(kernel, next, sizeof(cl_mem), &tables->second, &code);
	} else {
		set(kernel, next, sizeof(cl_mem), &tables->arena.buffer,
		    &code);
	}
	set(kernel, next, sizeof(cl_mem), &tables->arena.buffer, &code);
	set(kernel, next, sizeof(cl_mem), &t->openings, &code);
	set(kernel, next, sizeof(cl_mem), &t->descs, &code);
	set(kernel, next, sizeof(cl_mem), &t->insns, &code);
	set(kernel, next, sizeof(t->insn_count), &t->insn_count, &code);
	set(kernel, next, sizeof(cl_mem), &t->params, &code);
	set(kernel, next, sizeof(cl_mem), &d->volumes.arena.buffer, &code);
	set(kernel, next, sizeof(cl_mem), &t->volumes, &code);
	set(kernel, next, sizeof(mask), &mask, &code);
	if (code != CL_SUCCESS)
		return device_fail(&d->failure, "clSetKernelArg", code);
	return ERR_OK;
}

/* Queues l over the tiles prepared. */
static enum err launch(struct device *d, const struct launch *l,
    const struct ground *g, size_t tile_count)
{
	struct device_workspace *w = &d->work;
	cl_uint next = l->next;
	size_t items = tile_count * TILE_POINTS /
	    (size_t)(d->block * d->info.width);
	cl_int code = CL_SUCCESS;

	device_area_set(l->kernel, &next, &w->tiles, &code);
	device_area_set(l->kernel, &next, &w->insns, &code);
	device_area_set(l->kernel, &next, &w->order, &code);
	device_area_set(l->kernel, &next, &g->points, &code);
	device_area_set(l->kernel, &next, &g->rows, &code);
	if (code != CL_SUCCESS)
		return device_fail(&d->failure, "clSetKernelArg", code);
	lap(d, &d->times.upload);
	code = clEnqueueNDRangeKernel(d->queue, l->kernel, 1, NULL, &items,
	    &d->group, 0, NULL, d->has_shared ? NULL : &d->ran);
	if (code != CL_SUCCESS)
		return device_fail(&d->failure, "clEnqueueNDRangeKernel", code);
	return ERR_OK;
}

/* Waits for the kernel queued. */
static enum err finish(struct device *d)
{
	cl_int code = clFinish(d->queue);

	lap_kernel(d);
	if (code != CL_SUCCESS)
		return device_fail(&d->failure, "clFinish", code);
	return ERR_OK;
}

/* --- tiles ------------------------------------------------------------------ */

/* Has room for the tiles of so many points, with insns of their own. */
static enum err reserve(struct device *d, size_t tiles, size_t insns)
{
	struct device_workspace *w = &d->work;
	size_t order_size = w->order.size, tiles_size = w->tiles.size;
	enum err err = device_area_reserve(d, &w->order,
	    tiles * TILE_POINTS * sizeof(uint32_t));

	if (!err)
		err = device_area_reserve(d, &w->tiles,
		    tiles * sizeof(struct tile));
	if (!err)
		err = device_area_reserve(d, &w->insns,
		    insns * sizeof(struct insn));
	if (w->order.size != order_size || w->tiles.size != tiles_size)
		w->plain_points = 0;
	return err;
}

/* Copies what tiles there are to a device with memory of its own. */
static enum err send_tiles(struct device *d, size_t tiles, size_t insns)
{
	const struct device_workspace *w = &d->work;
	enum err err = device_area_send(d, &w->order,
	    tiles * TILE_POINTS * sizeof(uint32_t));

	if (!err)
		err = device_area_send(d, &w->tiles,
		    tiles * sizeof(struct tile));
	if (!err)
		err = device_area_send(d, &w->insns,
		    insns * sizeof(struct insn));
	return err;
}

/* Points in the order given, the last one repeated, over the whole tape. */
static enum err prepare_plain(struct device *d, size_t count)
{
	struct device_workspace *w = &d->work;
	size_t tiles = tiles_count(count), whole = count / TILE_POINTS *
	    TILE_POINTS;
	enum err err = reserve(d, tiles, 1);
	uint32_t *order = w->order.at;

	if (err)
		return err;
	if (whole == count && w->plain_points >= count)
		return ERR_OK;
	for (size_t i = min_size(w->plain_points, whole);
	    i < tiles * TILE_POINTS; i++)
		order[i] = (uint32_t)min_size(i, count - 1);
	memset(w->tiles.at, 0, tiles * sizeof(struct tile));
	w->plain_points = 0;
	err = send_tiles(d, tiles, 0);
	if (!err)
		w->plain_points = whole;
	return err;
}

/* The threads that help with count points, or NULL. */
static const struct tiles_crew *crew(struct device *d, size_t count)
{
	if (count < CREW_POINTS ||
	    (!d->crew && device_crew_create(&d->crew) != ERR_OK))
		return NULL;
	return device_crew_get(d->crew);
}

/* Instructions that so many tiles may have of their own. */
static size_t tile_insns(const struct device_tape *t, size_t tiles)
{
	size_t most = tiles * TILE_INSNS_MEAN;

	most = most > TILE_INSNS_FREE ? most : TILE_INSNS_FREE;
	return min_size(min_size(most, TILE_INSNS),
	    tiles * ((size_t)t->insn_count + 1));
}

static enum err prepare_culled(struct device *d, struct device_tape *t,
    const float *points, size_t count)
{
	size_t tiles = tiles_count(count), room = tile_insns(t, tiles);
	struct device_workspace *w = &d->work;
	enum err err = reserve(d, tiles, room);
	struct tiles_out out;

	if (err)
		return err;
	if (!w->tiling && tiles_work_create(&w->tiling))
		return device_out_of_memory(&d->failure);
	out = (struct tiles_out){.order = w->order.at, .tiles = w->tiles.at,
		.insns = w->insns.at, .insns_max = room};
	w->plain_points = 0;
	if (tiles_build(t->tiles, w->tiling, points, count, true,
	    crew(d, count), &out))
		return device_out_of_memory(&d->failure);
	return send_tiles(d, tiles, out.insn_count);
}

/* Whether a batch of count points may be culled. Not for colours: of what
 * is 0 they take a little too. */
static bool is_culled(const struct device *d, const struct device_tape *t,
    unsigned outputs, size_t count)
{
	if (!t->tiles || (outputs & OUTPUT_COLOR) ||
	    d->culling == DEVICE_CULLING_NEVER)
		return false;
	return d->culling == DEVICE_CULLING_ALWAYS ||
	    tiles_pay(t->tiles, count);
}

/* Tiles, on the device, of a piece whose points the host reads at points. */
static enum err prepare(struct device *d, struct device_tape *t,
    const struct piece *piece, const float *points)
{
	bool culled = is_culled(d, t, piece->outputs, piece->count) &&
	    (d->culling == DEVICE_CULLING_ALWAYS ||
	    tiles_help(t->tiles, points, piece->count));

	return culled ? prepare_culled(d, t, points, piece->count) :
	    prepare_plain(d, piece->count);
}

/* --- a piece in the caller's memory ----------------------------------------- */

/* Mapping a buffer puts its rows into the host's memory. */
static enum err map_rows(struct device *d, cl_mem rows, size_t size)
{
	cl_int code;
	void *at = clEnqueueMapBuffer(d->queue, rows, CL_TRUE, CL_MAP_READ, 0,
	    size, 0, NULL, NULL, &code);

	if (code == CL_SUCCESS)
		code = clEnqueueUnmapMemObject(d->queue, rows, at, 0, NULL,
		    NULL);
	if (code == CL_SUCCESS)
		code = clFinish(d->queue);
	if (code != CL_SUCCESS)
		return device_fail(&d->failure, "clEnqueueMapBuffer", code);
	return ERR_OK;
}

static enum err run_in_place(struct device *d, struct device_tape *t,
    const struct launch *l, const struct piece *piece)
{
	const struct device_part *part = piece->parts;
	size_t row_size = piece->count * piece->stride * sizeof(float);
	struct ground g = {0};
	enum err err = ERR_OK;
	cl_int code;

	/* The points are only read: CL_MEM_READ_ONLY. */
	g.points.buffer = clCreateBuffer(d->context, CL_MEM_READ_ONLY |
	    CL_MEM_USE_HOST_PTR, piece->count * 3 * sizeof(float),
	    (void *)(uintptr_t)part->points, &code);
	if (g.points.buffer)
		g.rows.buffer = clCreateBuffer(d->context, CL_MEM_WRITE_ONLY |
		    CL_MEM_USE_HOST_PTR, row_size, part->rows, &code);
	if (!g.rows.buffer)
		err = device_fail(&d->failure, "clCreateBuffer", code);
	if (!err)
		err = prepare(d, t, piece, part->points);
	if (!err)
		err = launch(d, l, &g, tiles_count(piece->count));
	if (!err)
		err = finish(d);
	if (!err)
		err = map_rows(d, g.rows.buffer, row_size);
	if (err)
		clFinish(d->queue); /* as in run_staged */
	if (g.rows.buffer)
		clReleaseMemObject(g.rows.buffer);
	if (g.points.buffer)
		clReleaseMemObject(g.points.buffer);
	return err;
}

/* --- a piece in the workspace ----------------------------------------------- */

/* Whether points and rows are written and read where the caller has them. */
static bool is_direct(const struct device *d, const struct piece *piece)
{
	return piece->part_count == 1 && d->work.points.buffer;
}

/* Has the points on the device; where the host has all of them. */
static enum err send_points(struct device *d, const struct piece *piece,
    const float **out)
{
	struct device_area area = d->work.points;
	char *at = area.at;

	if (is_direct(d, piece)) {
		area.at = (void *)(uintptr_t)piece->parts[0].points;
	} else {
		for (size_t i = 0; i < piece->part_count; i++) {
			const struct device_part *part = piece->parts + i;
			size_t size = part->count * 3 * sizeof(float);

			if (size > 0)
				memcpy(at, part->points, size);
			at += size;
		}
	}
	*out = area.at;
	return device_area_send(d, &area, piece->count * 3 * sizeof(float));
}

/* Has the rows of a kernel that has ended at `at` on the host. */
static enum err fetch_rows(struct device *d, const struct piece *piece,
    void *at)
{
	const struct device_area *area = &d->work.rows;
	cl_int code = CL_SUCCESS;

	if (area->buffer)
		code = clEnqueueReadBuffer(d->queue, area->buffer, CL_TRUE, 0,
		    piece->count * piece->stride * sizeof(float), at, 0, NULL,
		    NULL);
	if (code == CL_SUCCESS)
		return ERR_OK;
	return device_fail(&d->failure, "clEnqueueReadBuffer", code);
}

/* Gives every part its rows. */
static enum err deliver(struct device *d, const struct piece *piece)
{
	const char *at = d->work.rows.at;
	enum err err = finish(d);

	if (!err)
		err = fetch_rows(d, piece, is_direct(d, piece) ?
		    piece->parts[0].rows : d->work.rows.at);
	if (is_direct(d, piece))
		return err;
	for (size_t i = 0; !err && i < piece->part_count; i++) {
		const struct device_part *part = piece->parts + i;
		size_t size = part->count * piece->stride * sizeof(float);

		if (size > 0)
			memcpy(part->rows, at, size);
		at += size;
	}
	return err;
}

static enum err run_staged(struct device *d, struct device_tape *t,
    const struct launch *l, const struct piece *piece)
{
	struct device_workspace *w = &d->work;
	const float *points = NULL;
	enum err err = device_area_reserve(d, &w->points,
	    piece->count * 3 * sizeof(float));

	if (!err)
		err = device_area_reserve(d, &w->rows,
		    piece->count * piece->stride * sizeof(float));
	if (!err)
		err = send_points(d, piece, &points);
	if (!err)
		err = prepare(d, t, piece, points);
	if (!err)
		err = launch(d, l, &(struct ground){w->points, w->rows},
		    tiles_count(piece->count));
	if (!err)
		err = deliver(d, piece);
	/* What was queued uses what the caller may free, or use again. */
	if (err)
		clFinish(d->queue);
	return err;
}

/* --- batches ---------------------------------------------------------------- */

static enum err run(struct device *d, struct device_tape *t,
    const struct launch *l, const struct piece *piece)
{
	bool in_place = d->reads_host && piece->part_count == 1 &&
	    piece->count > STAGED_POINTS;
	enum err err;

	d->mark = seconds();
	err = in_place ? run_in_place(d, t, l, piece) :
	    run_staged(d, t, l, piece);
	lap(d, &d->times.download);
	forget_kernel(d);
	return err;
}

/* The most points of a piece that is to end in time: who asks for that and knows
 * how fast a culled tape is gives batches that are no longer. */
static size_t timely_points(const struct device *d,
    const struct device_tape *t, unsigned outputs, size_t left)
{
	size_t scale = d->info.is_gpu ? PIECE_GPU : 1;

	if (is_culled(d, t, outputs, left))
		return PIECE_POINTS;
	return min_size(scale * PLAIN_POINTS, scale * PIECE_WORK /
	    t->insn_count);
}

/* Points of the next piece of a batch: whole tiles, or all that are left. */
static size_t piece_points(const struct device *d, const struct device_tape *t,
    unsigned outputs, size_t left, bool timely)
{
	size_t stride = (size_t)output_row_floats(outputs);
	size_t most = timely ? timely_points(d, t, outputs, left) :
	    PIECE_POINTS, pieces;

	if (!d->reads_host)
		most = min_size(most, COPIED_BYTES / ((3 + stride) *
		    sizeof(float)));
	most = most < TILE_POINTS ? TILE_POINTS : most - most % TILE_POINTS;
	/* Pieces of about the same size. */
	pieces = (left + most - 1) / most;
	return min_size(left, tiles_count((left + pieces - 1) / pieces) *
	    TILE_POINTS);
}

static enum err check(struct device *d, unsigned outputs)
{
	if (outputs == 0 || outputs > OUTPUT_ALL)
		return device_refuse(&d->failure, ERR_INVALID,
		    "there are no outputs %#x", outputs);
	return ERR_OK;
}

enum err device_evaluate(struct device *d, struct device_tape *t,
    const float *points, size_t count, unsigned outputs, float *rows,
    bool (*go_on)(void *ctx), void *ctx)
{
	size_t stride = (size_t)output_row_floats(outputs), n;
	enum err err = check(d, outputs);
	struct launch l;

	d->times = (struct device_times){0};
	if (!err)
		err = set_tape(d, t, outputs, &l);
	for (size_t done = 0; !err && done < count; done += n) {
		struct device_part part = {points + done * 3, 0,
			rows + done * stride};

		if (go_on && !go_on(ctx))
			return device_refuse(&d->failure, ERR_CANCELLED,
			    "given up after %zu of %zu points", done, count);
		n = piece_points(d, t, outputs, count - done,
		    go_on != NULL);
		part.count = n;
		err = run(d, t, &l,
		    &(struct piece){&part, 1, n, outputs, stride});
	}
	return err;
}

enum err device_evaluate_parts(struct device *d, struct device_tape *t,
    const struct device_part *parts, size_t part_count, unsigned outputs)
{
	struct piece piece = {parts, part_count, 0, outputs,
		(size_t)output_row_floats(outputs)};
	enum err err = check(d, outputs);
	struct launch l;

	d->times = (struct device_times){0};
	for (size_t i = 0; !err && i < part_count; i++) {
		if (parts[i].count > DEVICE_PARTS_POINTS - piece.count)
			return device_refuse(&d->failure, ERR_INVALID,
			    "parts have more than %d points together",
			    DEVICE_PARTS_POINTS);
		piece.count += parts[i].count;
	}
	if (err || piece.count == 0)
		return err;
	err = set_tape(d, t, outputs, &l);
	return err ? err : run(d, t, &l, &piece);
}

const struct device_times *device_get_times(const struct device *d)
{
	return &d->times;
}
