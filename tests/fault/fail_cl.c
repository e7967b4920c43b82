/*
 * Preloaded into the daemon: OpenCL calls that fail when told to. A call that
 * fails is not made, but for those that wait: a device that is gone writes
 * nothing any more, so these wait for what runs, and fail then.
 */
#include "tests/fault/inside.h"

#undef CL_TARGET_OPENCL_VERSION
#define CL_TARGET_OPENCL_VERSION 200
#define CL_USE_DEPRECATED_OPENCL_1_2_APIS
#include <CL/cl.h>

#define CODE atomic_load(&control->code)

/* Of name, a function of that type in OpenCL's library. */
#define REAL(name) \
	static _Atomic(void *) real; \
	FIND(real, #name)
#define CALL(name, ...) \
	((__typeof__(&name))(uintptr_t)atomic_load(&real))(__VA_ARGS__)

/* A function that returns a code. */
#define RETURNS_CODE(name, parameters, ...) \
cl_int name parameters \
{ \
	REAL(name); \
	if (fails(FAULT_CL, #name, HERE)) \
		return CODE; \
	return CALL(name, __VA_ARGS__); \
}

/* One that returns something, and its code in *code. */
#define RETURNS_THING(type, name, parameters, ...) \
type name parameters \
{ \
	REAL(name); \
	if (!fails(FAULT_CL, #name, HERE)) \
		return CALL(name, __VA_ARGS__); \
	if (code != NULL) \
		*code = CODE; \
	return NULL; \
}

RETURNS_CODE(clGetPlatformIDs, (cl_uint room, cl_platform_id *ids,
    cl_uint *count), room, ids, count)
RETURNS_CODE(clGetPlatformInfo, (cl_platform_id id, cl_platform_info what,
    size_t room, void *value, size_t *size), id, what, room, value, size)
RETURNS_CODE(clGetDeviceIDs, (cl_platform_id id, cl_device_type type,
    cl_uint room, cl_device_id *ids, cl_uint *count), id, type, room, ids,
    count)
RETURNS_CODE(clGetDeviceInfo, (cl_device_id id, cl_device_info what,
    size_t room, void *value, size_t *size), id, what, room, value, size)
RETURNS_CODE(clBuildProgram, (cl_program program, cl_uint count,
    const cl_device_id *ids, const char *options,
    void (CL_CALLBACK *notify)(cl_program, void *), void *ctx), program, count,
    ids, options, notify, ctx)
RETURNS_CODE(clGetProgramBuildInfo, (cl_program program, cl_device_id id,
    cl_program_build_info what, size_t room, void *value, size_t *size),
    program, id, what, room, value, size)
RETURNS_CODE(clGetProgramInfo, (cl_program program, cl_program_info what,
    size_t room, void *value, size_t *size), program, what, room, value, size)
RETURNS_CODE(clSetKernelArg, (cl_kernel kernel, cl_uint index, size_t size,
    const void *value), kernel, index, size, value)
RETURNS_CODE(clSetKernelArgSVMPointer, (cl_kernel kernel, cl_uint index,
    const void *value), kernel, index, value)
RETURNS_CODE(clEnqueueNDRangeKernel, (cl_command_queue queue,
    cl_kernel kernel, cl_uint axes, const size_t *offset, const size_t *global,
    const size_t *local, cl_uint count, const cl_event *list,
    cl_event *event), queue, kernel, axes, offset, global, local, count, list,
    event)
RETURNS_CODE(clEnqueueWriteBuffer, (cl_command_queue queue, cl_mem buffer,
    cl_bool blocks, size_t offset, size_t size, const void *from,
    cl_uint count, const cl_event *list, cl_event *event), queue, buffer,
    blocks, offset, size, from, count, list, event)
RETURNS_CODE(clEnqueueWriteImage, (cl_command_queue queue, cl_mem image,
    cl_bool blocks, const size_t *origin, const size_t *region, size_t row,
    size_t slice, const void *from, cl_uint count, const cl_event *list,
    cl_event *event), queue, image, blocks, origin, region, row, slice, from,
    count, list, event)
RETURNS_CODE(clEnqueueFillImage, (cl_command_queue queue, cl_mem image,
    const void *color, const size_t *origin, const size_t *region,
    cl_uint count, const cl_event *list, cl_event *event), queue, image, color,
    origin, region, count, list, event)

RETURNS_THING(cl_context, clCreateContext,
    (const cl_context_properties *properties, cl_uint count,
    const cl_device_id *ids, void (CL_CALLBACK *notify)(const char *,
    const void *, size_t, void *), void *ctx, cl_int *code), properties, count,
    ids, notify, ctx, code)
RETURNS_THING(cl_command_queue, clCreateCommandQueue, (cl_context context,
    cl_device_id id, cl_command_queue_properties properties, cl_int *code),
    context, id, properties, code)
RETURNS_THING(cl_program, clCreateProgramWithSource, (cl_context context,
    cl_uint count, const char **texts, const size_t *lengths, cl_int *code),
    context, count, texts, lengths, code)
RETURNS_THING(cl_program, clCreateProgramWithBinary, (cl_context context,
    cl_uint count, const cl_device_id *ids, const size_t *lengths,
    const unsigned char **binaries, cl_int *status, cl_int *code), context,
    count, ids, lengths, binaries, status, code)
RETURNS_THING(cl_kernel, clCreateKernel, (cl_program program,
    const char *kernel, cl_int *code), program, kernel, code)
RETURNS_THING(cl_mem, clCreateBuffer, (cl_context context, cl_mem_flags flags,
    size_t size, void *host, cl_int *code), context, flags, size, host, code)
RETURNS_THING(cl_mem, clCreateImage, (cl_context context, cl_mem_flags flags,
    const cl_image_format *format, const cl_image_desc *desc, void *host,
    cl_int *code), context, flags, format, desc, host, code)

void *clSVMAlloc(cl_context context, cl_svm_mem_flags flags, size_t size,
    cl_uint alignment)
{
	REAL(clSVMAlloc);
	return fails(FAULT_CL, "clSVMAlloc", HERE) ? NULL :
	    CALL(clSVMAlloc, context, flags, size, alignment);
}

/* ---- those that wait ---- */

static void wait_for(cl_command_queue queue)
{
	REAL(clFinish);
	CALL(clFinish, queue);
}

cl_int clFinish(cl_command_queue queue)
{
	wait_for(queue);
	return fails(FAULT_CL, "clFinish", HERE) ? CODE : CL_SUCCESS;
}

cl_int clEnqueueReadBuffer(cl_command_queue queue, cl_mem buffer,
    cl_bool blocks, size_t offset, size_t size, void *to, cl_uint count,
    const cl_event *list, cl_event *event)
{
	REAL(clEnqueueReadBuffer);
	if (fails(FAULT_CL, "clEnqueueReadBuffer", HERE)) {
		wait_for(queue);
		return CODE;
	}
	return CALL(clEnqueueReadBuffer, queue, buffer, blocks, offset, size,
	    to, count, list, event);
}

void *clEnqueueMapBuffer(cl_command_queue queue, cl_mem buffer, cl_bool blocks,
    cl_map_flags flags, size_t offset, size_t size, cl_uint count,
    const cl_event *list, cl_event *event, cl_int *code)
{
	REAL(clEnqueueMapBuffer);
	if (fails(FAULT_CL, "clEnqueueMapBuffer", HERE)) {
		wait_for(queue);
		*code = CODE;
		return NULL;
	}
	return CALL(clEnqueueMapBuffer, queue, buffer, blocks, flags, offset,
	    size, count, list, event, code);
}

/* Else the buffer would stay mapped. */
cl_int clEnqueueUnmapMemObject(cl_command_queue queue, cl_mem buffer, void *at,
    cl_uint count, const cl_event *list, cl_event *event)
{
	cl_int code;

	REAL(clEnqueueUnmapMemObject);
	code = CALL(clEnqueueUnmapMemObject, queue, buffer, at, count, list,
	    event);
	return fails(FAULT_CL, "clEnqueueUnmapMemObject", HERE) ? CODE : code;
}
