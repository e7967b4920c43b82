#include "kernels/device_internal.h"

#include <stdlib.h>

/* The compiler's log, malloc'd, or NULL if there is none to be had. */
static char *build_log(cl_program program, cl_device_id id)
{
	size_t size = 0;
	char *log;

	if (clGetProgramBuildInfo(program, id, CL_PROGRAM_BUILD_LOG, 0, NULL,
	    &size) != CL_SUCCESS)
		return NULL;
	log = calloc(1, size + 1);
	if (log && clGetProgramBuildInfo(program, id, CL_PROGRAM_BUILD_LOG,
	    size, log, NULL) != CL_SUCCESS) {
		free(log);
		return NULL;
	}
	return log;
}

enum err device_build(cl_context context, cl_device_id id, const char *source,
    const char *options, cl_program *out, struct device_failure *failure)
{
	cl_int code;
	cl_program program = clCreateProgramWithSource(context, 1, &source,
	    NULL, &code);
	enum err err;

	if (!program)
		return device_fail(failure, "clCreateProgramWithSource", code);
	code = clBuildProgram(program, 1, &id, options, NULL, NULL);
	if (code == CL_SUCCESS) {
		*out = program;
		return ERR_OK;
	}
	err = device_fail(failure, "clBuildProgram", code);
	if (err == ERR_DEVICE)
		err = ERR_DEVICE_BUILD;
	free(failure->build_log);
	failure->build_log = build_log(program, id);
	clReleaseProgram(program);
	return err;
}
