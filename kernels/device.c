#include "kernels/device_internal.h"

#include <assert.h>
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "core/output.h"
#include "core/tape.h"
#include "core/tile.h"
#include "kernels/device_cache.h"
#include "kernels/source.h"

#define TABLE_BYTES ((size_t)256 << 20)
#define VOLUME_BYTES ((size_t)256 << 20)

/*
 * Work-items of a work-group: elsewhere those of a tile, so that groups are
 * whole at any width. A processor's take BLOCK_CPU * width points each,
 * so a group of one is 64 points, in 21 us; groups of 4 and 16 take 30 and 80 us
 * for one point of 50 primitives, and none is faster on many.
 */
#define GROUP_CPU 1

/*
 * Vectors of points that a work-item takes at once. 50 point primitives under
 * sum, width 16, in core-ns a point for 1, 2 and 4 vectors when it was chosen:
 * value 50, 46, 28; value and gradient 64, 52, 40 to 50; camel does not care.
 */
#define BLOCK_CPU 4
#define BLOCK_OTHER 1

/* What a right device's answer may be off by: OpenCL lets a root be off by 3
 * units in the last place, 3.6e-7 of a distance. PoCL's is exact. */
#define WARM_UP_ERROR 1e-5f

static bool is_width(int width)
{
	return width == 1 || width == 2 || width == 4 || width == 8 ||
	    width == 16;
}

static enum err get_type(struct device *d, cl_device_type *out)
{
	cl_int code = clGetDeviceInfo(d->id, CL_DEVICE_TYPE, sizeof(*out), out,
	    NULL);

	return code == CL_SUCCESS ? ERR_OK :
	    device_fail(&d->failure, "clGetDeviceInfo", code);
}

/* Whether kernels and the host may share memory without maps: OpenCL 2's
 * optional fine-grain buffers. */
static bool has_shared(cl_device_id id, const char *version)
{
	cl_device_svm_capabilities can = 0;
	int major = 0;

	return sscanf(version, "OpenCL %d", &major) == 1 && major >= 2 &&
	    clGetDeviceInfo(id, CL_DEVICE_SVM_CAPABILITIES, sizeof(can), &can,
	    NULL) == CL_SUCCESS && (can & CL_DEVICE_SVM_FINE_GRAIN_BUFFER);
}

/* What the options leave to us. */
static enum err choose(struct device *d, const struct device_options *options,
    enum device_memory memory)
{
	cl_device_type type = 0;
	enum err err = get_type(d, &type);
	bool cpu = (type & CL_DEVICE_TYPE_CPU) != 0;

	if (err)
		return err;
	d->info.width = options->width ? options->width : cpu ? 16 : 1;
	if (!is_width(d->info.width))
		return device_refuse(&d->failure, ERR_INVALID,
		    "width %d is not 1, 2, 4, 8 or 16", d->info.width);
	if (options->tables == DEVICE_TABLES_IMAGE && !d->info.has_images)
		return device_refuse(&d->failure, ERR_INVALID,
		    "device \"%s\" has no images", d->info.name);
	d->info.tables_are_images = options->tables == DEVICE_TABLES_IMAGE;
	d->block = cpu ? BLOCK_CPU : BLOCK_OTHER;
	d->group = cpu ? GROUP_CPU :
	    (size_t)(TILE_POINTS / (d->block * d->info.width));
	d->reads_host = cpu && memory == DEVICE_MEMORY_AUTO;
	d->has_shared = d->reads_host && has_shared(d->id, d->info.version);
	d->culling = options->no_culling ? DEVICE_CULLING_NEVER :
	    DEVICE_CULLING_PAYS;
	return ERR_OK;
}

static enum err create_queue(struct device *d)
{
	cl_int code;

	d->context = clCreateContext(NULL, 1, &d->id, NULL, NULL, &code);
	if (!d->context)
		return device_fail(&d->failure, "clCreateContext", code);
	/* Only where copies overlap with what the host does can it not tell
	 * itself when a kernel began. */
	d->queue = clCreateCommandQueue(d->context, d->id, d->has_shared ? 0 :
	    CL_QUEUE_PROFILING_ENABLE, &code);
	if (!d->queue)
		return device_fail(&d->failure, "clCreateCommandQueue", code);
	return ERR_OK;
}

/* The kernel of interpreter.cl, with all or without what it may do without. */
static enum err create_kernel(struct device *d, enum device_kernel which)
{
	char *options = d->build_options[which];
	cl_int code;
	enum err err;

	snprintf(options, DEVICE_OPTIONS_MAX, "-cl-std=CL1.2 -DWIDTH=%d "
	    "-DBLOCK=%d -DWHOLE=%d%s%s", d->info.width, d->block,
	    which == DEVICE_WHOLE,
	    d->info.tables_are_images ? " -DTABLES_IMAGE" : "",
	    d->info.is_gpu ? " -DFUSED" : "");
	err = device_cache_build(d->cache[0] ? d->cache : NULL, d->context,
	    d->id, kernels_source, options, d->programs + which,
	    &d->is_cached[which], &d->failure);
	if (err)
		return err;
	d->kernels[which] = clCreateKernel(d->programs[which], "evaluate",
	    &code);
	if (!d->kernels[which])
		return device_fail(&d->failure, "clCreateKernel", code);
	return ERR_OK;
}

static enum err create_kernels(struct device *d)
{
	enum err err = create_kernel(d, DEVICE_PLAIN);

	if (!err)
		err = create_kernel(d, DEVICE_WHOLE);
	d->info.is_cached = d->is_cached[DEVICE_PLAIN] &&
	    d->is_cached[DEVICE_WHOLE];
	return err;
}

/*
 * PoCL compiles a kernel at its first launch: a unit ball at one point, without
 * and with a colour.
 */
static enum err warm_up(struct device *d)
{
	struct insn insn = {OP_SPHERE, 0, 0, 0};
	double params[5] = {0.0, 0.0, 0.0, 1.0, 1.0};
	const struct tape tape = {.insns = &insn, .insn_count = 1,
		.params = params, .param_count = 5, .primitive_count = 1,
		.node_count = 1, .stack_depth = 1};
	const float point[3] = {1.0f, 0.0f, 0.0f};
	struct device_tape *t;
	float value = 0.0f, row[OUTPUT_ROW_MAX];
	enum err err = device_load_tape(d, &tape, NULL, &t);

	if (err)
		return err;
	err = device_evaluate(d, t, point, 1, OUTPUT_VALUE, &value, NULL, NULL);
	if (!err)
		err = device_evaluate(d, t, point, 1, OUTPUT_COLOR, row, NULL,
		    NULL);
	device_drop_tape(d, t);
	if (!err && !(fabsf(value - 0.5f) <= WARM_UP_ERROR))
		return device_refuse(&d->failure, ERR_DEVICE, "the device "
		    "computes %.9g where the field is 0.5", (double)value);
	return err;
}

static enum err select_device(struct device *d,
    const struct device_options *options, enum device_memory memory)
{
	enum err err = device_select(options->select, &d->id, &d->info,
	    &d->failure);

	return err ? err : choose(d, options, memory);
}

enum err device_check(const struct device_options *options,
    struct device_failure *failure)
{
	struct device d = {0};
	enum err err = select_device(&d, options, DEVICE_MEMORY_AUTO);

	device_failure_fini(failure);
	*failure = d.failure;
	return err;
}

static enum err open_device(struct device *d,
    const struct device_options *options, enum device_memory memory)
{
	enum err err = select_device(d, options, memory);

	if (options->cache)
		snprintf(d->cache, sizeof(d->cache), "%s", options->cache);
	d->cache_is_read_only = options->cache_is_read_only;
	if (!err)
		err = create_queue(d);
	if (!err)
		err = create_kernels(d);
	if (!err)
		err = device_store_init(d, options->table_bytes ?
		    options->table_bytes : TABLE_BYTES);
	if (!err)
		err = device_volumes_init(d, options->volume_bytes ?
		    options->volume_bytes : VOLUME_BYTES);
	if (!err)
		err = warm_up(d);
	return err;
}

enum err device_open_as(const struct device_options *options,
    enum device_memory memory, struct device **out,
    struct device_failure *failure)
{
	struct device_options plain = *options;
	struct device *d = calloc(1, sizeof(*d));
	enum err err;

	if (!d)
		return ERR_MEMORY;
	err = open_device(d, options, memory);
	if (err && device_cache_forget(d)) {
		/* What came out of the cache may be what does not work. */
		device_close(d);
		plain.cache = NULL;
		return device_open_as(&plain, memory, out, failure);
	}
	if (err) {
		device_failure_fini(failure);
		*failure = d->failure;
		memset(&d->failure, 0, sizeof(d->failure));
		device_close(d);
		return err;
	}
	*out = d;
	return ERR_OK;
}

enum err device_open(const struct device_options *options, struct device **out,
    struct device_failure *failure)
{
	return device_open_as(options, DEVICE_MEMORY_AUTO, out, failure);
}

void device_close(struct device *d)
{
	if (!d)
		return;
	/* What runs reads and writes what is freed below. */
	if (d->queue)
		clFinish(d->queue);
	device_store_fini(&d->tables);
	device_volumes_fini(&d->volumes);
	device_workspace_fini(d, &d->work);
	device_crew_free(d->crew);
	for (int i = 0; i < DEVICE_KERNEL_COUNT; i++) {
		if (d->kernels[i])
			clReleaseKernel(d->kernels[i]);
		if (d->programs[i])
			clReleaseProgram(d->programs[i]);
	}
	if (d->queue)
		clReleaseCommandQueue(d->queue);
	if (d->context)
		clReleaseContext(d->context);
	device_failure_fini(&d->failure);
	free(d);
}

const struct device_info *device_get_info(const struct device *d)
{
	return &d->info;
}

const char *device_message(const struct device *d)
{
	return d->failure.message;
}
