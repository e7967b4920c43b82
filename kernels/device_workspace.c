#include "kernels/device_internal.h"

#include <stdlib.h>
#include <string.h>

#include "core/tiles.h"

/* Areas grow by powers of two from here, so that they seldom do. */
#define AREA_LEAST 4096

/* Of the host's part of an area: a processor's cache line, or more. */
#define ALIGNMENT 64

static size_t rounded(size_t size)
{
	size_t most = AREA_LEAST;

	while (most < size)
		most *= 2;
	return most;
}

static enum err create(struct device *d, size_t size, struct device_area *area)
{
	cl_int code;

	if (d->has_shared) {
		area->at = clSVMAlloc(d->context, CL_MEM_READ_WRITE |
		    CL_MEM_SVM_FINE_GRAIN_BUFFER, size, ALIGNMENT);
		return area->at ? ERR_OK : device_fail(&d->failure,
		    "clSVMAlloc", CL_MEM_OBJECT_ALLOCATION_FAILURE);
	}
	area->at = aligned_alloc(ALIGNMENT, size);
	if (!area->at)
		return device_out_of_memory(&d->failure);
	area->buffer = clCreateBuffer(d->context, CL_MEM_READ_WRITE, size, NULL,
	    &code);
	if (area->buffer)
		return ERR_OK;
	free(area->at);
	area->at = NULL;
	return device_fail(&d->failure, "clCreateBuffer for a batch", code);
}

enum err device_area_reserve(struct device *d, struct device_area *area,
    size_t size)
{
	struct device_area larger = {.size = rounded(size)};
	enum err err;

	if (size <= area->size)
		return ERR_OK;
	device_area_fini(d, area);
	err = create(d, larger.size, &larger);
	if (!err)
		*area = larger;
	return err;
}

void device_area_fini(struct device *d, struct device_area *area)
{
	if (area->buffer) {
		clReleaseMemObject(area->buffer);
		free(area->at);
	} else if (area->at) {
		clSVMFree(d->context, area->at);
	}
	memset(area, 0, sizeof(*area));
}

enum err device_area_send(struct device *d, const struct device_area *area,
    size_t size)
{
	cl_int code;

	if (!area->buffer || size == 0)
		return ERR_OK;
	code = clEnqueueWriteBuffer(d->queue, area->buffer, CL_FALSE, 0, size,
	    area->at, 0, NULL, NULL);
	if (code != CL_SUCCESS)
		return device_fail(&d->failure, "clEnqueueWriteBuffer", code);
	return ERR_OK;
}

void device_area_set(cl_kernel kernel, cl_uint *index,
    const struct device_area *area, cl_int *code)
{
	cl_uint at = (*index)++;
	cl_int failed = area->buffer ? clSetKernelArg(kernel, at,
	    sizeof(area->buffer), &area->buffer) :
	    clSetKernelArgSVMPointer(kernel, at, area->at);

	if (*code == CL_SUCCESS)
		*code = failed;
}

void device_workspace_fini(struct device *d, struct device_workspace *w)
{
	device_area_fini(d, &w->order);
	device_area_fini(d, &w->tiles);
	device_area_fini(d, &w->insns);
	device_area_fini(d, &w->points);
	device_area_fini(d, &w->rows);
	tiles_work_free(w->tiling);
}

size_t device_workspace_bytes(const struct device_workspace *w)
{
	return w->order.size + w->tiles.size + w->insns.size + w->points.size +
	    w->rows.size;
}
