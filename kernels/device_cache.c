#include "kernels/device_cache.h"

#include <assert.h>
#include <errno.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <unistd.h>

#include "kernels/cache_file.h"
#include "kernels/source.h"

#define KIND "kernels"

static_assert(sizeof ((struct device *)0)->cache == CACHE_FOLDER_MAX,
    "one size for the cache's name");

/* Ours take 0.5 to 0.8 MB each. */
#define BINARY_MAX ((size_t)64 << 20)

static void add_device_text(struct cache_key *key, cl_device_id id,
    cl_device_info what)
{
	char text[512] = "";

	clGetDeviceInfo(id, what, sizeof(text), text, NULL);
	text[sizeof(text) - 1] = '\0';
	cache_key_add_text(key, text);
}

static void add_platform_text(struct cache_key *key, cl_platform_id id,
    cl_platform_info what)
{
	char text[512] = "";

	clGetPlatformInfo(id, what, sizeof(text), text, NULL);
	text[sizeof(text) - 1] = '\0';
	cache_key_add_text(key, text);
}

static void make_key(struct cache_key *key, cl_device_id id,
    const char *source, const char *options)
{
	cl_platform_id platform = NULL;
	cl_uint vendor = 0, bits = 0;

	key->size = 0;
	cache_key_add_text(key, KIND);
	cache_key_add_int(key, (int64_t)sizeof(void *));
	cache_key_add_hash(key, source, strlen(source));
	cache_key_add_hash(key, options, strlen(options));
	clGetDeviceInfo(id, CL_DEVICE_PLATFORM, sizeof(platform), &platform,
	    NULL);
	add_platform_text(key, platform, CL_PLATFORM_NAME);
	add_platform_text(key, platform, CL_PLATFORM_VERSION);
	add_device_text(key, id, CL_DEVICE_NAME);
	add_device_text(key, id, CL_DEVICE_VERSION);
	add_device_text(key, id, CL_DRIVER_VERSION);
	clGetDeviceInfo(id, CL_DEVICE_VENDOR_ID, sizeof(vendor), &vendor, NULL);
	clGetDeviceInfo(id, CL_DEVICE_ADDRESS_BITS, sizeof(bits), &bits, NULL);
	cache_key_add_int(key, vendor);
	cache_key_add_int(key, bits);
}

/* The program's binary, malloc'd, or NULL. */
static unsigned char *read_binary(const char *folder,
    const struct cache_key *key, size_t *size)
{
	unsigned char *binary = NULL;
	struct cache_file file;

	if (cache_file_open(folder, KIND, key, &file) != ERR_OK)
		return NULL;
	if (file.size > 0 && file.size <= BINARY_MAX)
		binary = malloc(file.size);
	if (!binary) {
		cache_file_close(&file);
		return NULL;
	}
	*size = file.size;
	if (cache_file_read(&file, binary) == ERR_OK)
		return binary;
	free(binary);
	return NULL;
}

/* The program of a binary, built, or NULL. */
static cl_program build_binary(cl_context context, cl_device_id id,
    const unsigned char *binary, size_t size, const char *options)
{
	cl_int status = CL_SUCCESS, code;
	cl_program program = clCreateProgramWithBinary(context, 1, &id, &size,
	    &binary, &status, &code);

	if (!program)
		return NULL;
	if (code == CL_SUCCESS && status == CL_SUCCESS &&
	    clBuildProgram(program, 1, &id, options, NULL, NULL) == CL_SUCCESS)
		return program;
	clReleaseProgram(program);
	return NULL;
}

enum err device_cache_build(const char *folder, cl_context context,
    cl_device_id id, const char *source, const char *options,
    cl_program *out, bool *is_cached, struct device_failure *failure)
{
	unsigned char *binary = NULL;
	cl_program program = NULL;
	struct cache_key key;
	size_t size = 0;

	*is_cached = false;
	if (folder) {
		make_key(&key, id, source, options);
		binary = read_binary(folder, &key, &size);
	}
	if (binary)
		program = build_binary(context, id, binary, size, options);
	free(binary);
	if (!program)
		return device_build(context, id, source, options, out, failure);
	*is_cached = true;
	*out = program;
	return ERR_OK;
}

enum err device_cache_store(const char *folder, cl_device_id id,
    const char *source, const char *options, cl_program program,
    struct device_failure *failure)
{
	unsigned char *binary;
	struct cache_key key;
	size_t size = 0;
	cl_int code = clGetProgramInfo(program, CL_PROGRAM_BINARY_SIZES,
	    sizeof(size), &size, NULL);
	enum err err;

	if (code != CL_SUCCESS)
		return device_fail(failure, "clGetProgramInfo", code);
	if (size == 0 || size > BINARY_MAX)
		return device_refuse(failure, ERR_DEVICE, "the device gives no "
		    "program binary");
	binary = malloc(size);
	if (!binary)
		return device_out_of_memory(failure);
	code = clGetProgramInfo(program, CL_PROGRAM_BINARIES, sizeof(binary),
	    &binary, NULL);
	make_key(&key, id, source, options);
	err = code != CL_SUCCESS ?
	    device_fail(failure, "clGetProgramInfo", code) :
	    cache_file_write(folder, KIND, &key, binary, size);
	if (err == ERR_IO)
		device_refuse(failure, ERR_IO, "cannot write to %s: %s", folder,
		    strerror(errno));
	free(binary);
	return err;
}

bool device_cache_forget(struct device *d)
{
	bool any = false;

	for (int i = 0; i < DEVICE_KERNEL_COUNT; i++) {
		struct cache_key key;
		char path[PATH_MAX];

		if (!d->is_cached[i])
			continue;
		any = true;
		make_key(&key, d->id, kernels_source, d->build_options[i]);
		if (!d->cache_is_read_only &&
		    cache_file_path(d->cache, KIND, &key, path))
			unlink(path);
	}
	return any;
}

enum err device_keep_kernels(struct device *d)
{
	if (!d->cache[0])
		return device_refuse(&d->failure, ERR_INVALID, "no cache");
	for (int i = 0; i < DEVICE_KERNEL_COUNT; i++) {
		enum err err = d->is_cached[i] ? ERR_OK : device_cache_store(
		    d->cache, d->id, kernels_source, d->build_options[i],
		    d->programs[i], &d->failure);

		if (err)
			return err;
		d->is_cached[i] = true;
	}
	return ERR_OK;
}
