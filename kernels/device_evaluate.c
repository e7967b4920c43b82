/*
 * Batches go through the device in pieces. Where the device is the host's own
 * processor, kernels read and write the caller's arrays, in whole work-groups;
 * what is left, and everything on other devices, goes through two buffers that
 * the device owns, padded with copies of the last point.
 */
#include "kernels/device_internal.h"

#include <stdint.h>
#include <string.h>

#include "core/output.h"

/* The most points of a piece, and about the most instructions times points, so
 * that a long tape's pieces stay short enough to be given up between. */
#define PIECE_POINTS 65536u
#define PIECE_WORK 16777216u

/* Part of a batch: count points and the rows to write. */
struct piece {
	const float *points;
	float *rows;
	size_t count;
};

/* A kernel with a tape's arguments set, and which argument is next. */
struct launch {
	cl_kernel kernel;
	cl_uint next;
};

static size_t min_size(size_t a, size_t b)
{
	return a < b ? a : b;
}

/* Points of a piece: whole work-groups. */
static size_t piece_points(const struct device *d, const struct device_tape *t)
{
	size_t points = min_size(PIECE_POINTS, PIECE_WORK / t->insn_count);

	if (points < d->group_points)
		return d->group_points;
	return points - points % d->group_points;
}

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

/* In the order of the kernel `evaluate`, but for its last two. */
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

/* Queues l over count points, whole work-groups, of two buffers. */
static enum err launch(struct device *d, const struct launch *l,
    cl_mem points, cl_mem rows, size_t count)
{
	cl_uint next = l->next;
	size_t items = count / d->item_points;
	cl_int code = CL_SUCCESS;

	set(l->kernel, &next, sizeof(points), &points, &code);
	set(l->kernel, &next, sizeof(rows), &rows, &code);
	if (code != CL_SUCCESS)
		return device_fail(&d->failure, "clSetKernelArg", code);
	code = clEnqueueNDRangeKernel(d->queue, l->kernel, 1, NULL, &items,
	    &d->group, 0, NULL, NULL);
	if (code != CL_SUCCESS)
		return device_fail(&d->failure, "clEnqueueNDRangeKernel", code);
	return ERR_OK;
}

/*
 * Waits until a buffer's rows are in the host's memory, which mapping makes
 * them; copies them to another place if that is not NULL.
 */
static enum err await_rows(struct device *d, cl_mem rows, size_t size,
    float *to)
{
	cl_int code;
	void *at = clEnqueueMapBuffer(d->queue, rows, CL_TRUE, CL_MAP_READ, 0,
	    size, 0, NULL, NULL, &code);

	if (code == CL_SUCCESS) {
		if (to)
			memcpy(to, at, size);
		code = clEnqueueUnmapMemObject(d->queue, rows, at, 0, NULL,
		    NULL);
	}
	if (code == CL_SUCCESS)
		code = clFinish(d->queue);
	if (code != CL_SUCCESS)
		return device_fail(&d->failure, "clEnqueueMapBuffer", code);
	return ERR_OK;
}

/* A piece of whole work-groups in the caller's own memory. */
static enum err run_shared(struct device *d, const struct launch *l,
    const struct piece *piece, size_t stride)
{
	size_t row_size = piece->count * stride * sizeof(float);
	cl_mem points, rows = NULL;
	enum err err = ERR_OK;
	cl_int code;

	/* The points are only read: CL_MEM_READ_ONLY. */
	points = clCreateBuffer(d->context, CL_MEM_READ_ONLY |
	    CL_MEM_USE_HOST_PTR, piece->count * 3 * sizeof(float),
	    (void *)(uintptr_t)piece->points, &code);
	if (points)
		rows = clCreateBuffer(d->context, CL_MEM_WRITE_ONLY |
		    CL_MEM_USE_HOST_PTR, row_size, piece->rows, &code);
	if (!rows)
		err = device_fail(&d->failure, "clCreateBuffer", code);
	if (!err)
		err = launch(d, l, points, rows, piece->count);
	if (!err)
		err = await_rows(d, rows, row_size, NULL);
	if (rows)
		clReleaseMemObject(rows);
	if (points)
		clReleaseMemObject(points);
	return err;
}

/* Copies the points into the device's buffer, the last one repeated. */
static enum err write_points(struct device *d, const struct piece *piece,
    size_t padded)
{
	const float *last = piece->points + (piece->count - 1) * 3;
	cl_int code;
	float *at = clEnqueueMapBuffer(d->queue, d->points, CL_TRUE,
	    CL_MAP_WRITE_INVALIDATE_REGION, 0, padded * 3 * sizeof(float), 0,
	    NULL, NULL, &code);

	if (code == CL_SUCCESS) {
		memcpy(at, piece->points, piece->count * 3 * sizeof(float));
		for (size_t i = piece->count; i < padded; i++)
			memcpy(at + i * 3, last, 3 * sizeof(float));
		code = clEnqueueUnmapMemObject(d->queue, d->points, at, 0, NULL,
		    NULL);
	}
	if (code != CL_SUCCESS)
		return device_fail(&d->failure, "clEnqueueMapBuffer", code);
	return ERR_OK;
}

/* A piece of at most d->staged_points, by way of the device's buffers. */
static enum err run_staged(struct device *d, const struct launch *l,
    const struct piece *piece, size_t stride)
{
	size_t group = d->group_points;
	size_t padded = (piece->count + group - 1) / group * group;
	enum err err = write_points(d, piece, padded);

	if (!err)
		err = launch(d, l, d->points, d->rows, padded);
	if (!err)
		err = await_rows(d, d->rows,
		    piece->count * stride * sizeof(float), piece->rows);
	return err;
}

enum err device_evaluate(struct device *d, struct device_tape *t,
    const float *points, size_t count, unsigned outputs, float *rows,
    bool (*go_on)(void *ctx), void *ctx)
{
	size_t stride = (size_t)output_row_floats(outputs);
	size_t most = piece_points(d, t), whole;
	struct launch l;
	enum err err;

	if (outputs == 0 || outputs > OUTPUT_ALL)
		return device_refuse(&d->failure, ERR_INVALID,
		    "there are no outputs %#x", outputs);
	err = set_tape(d, t, outputs, &l);
	for (size_t done = 0; !err && done < count;) {
		struct piece piece = {points + done * 3, rows + done * stride,
			min_size(most, count - done)};

		if (go_on && !go_on(ctx))
			return device_refuse(&d->failure, ERR_CANCELLED,
			    "given up after %zu of %zu points", done, count);
		whole = piece.count - piece.count % d->group_points;
		if (d->shares_memory && piece.count > d->staged_points) {
			piece.count = whole;
			err = run_shared(d, &l, &piece, stride);
		} else {
			piece.count = min_size(piece.count, d->staged_points);
			err = run_staged(d, &l, &piece, stride);
		}
		done += piece.count;
	}
	return err;
}
