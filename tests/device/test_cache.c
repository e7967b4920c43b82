/*
 * Program binaries on disk: one that is whole is used, whatever else there is
 * never reaches the device. Folders are the test's own, PoCL's cache too.
 */
#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/stat.h>
#include <unistd.h>

#include <cmocka.h>

#include "kernels/cache_file.h"
#include "kernels/device_cache.h"
#include "tests/support/folder.h"

#define OPTIONS "-cl-std=CL1.2 -DFACTOR=2"

static const char source[] = "__kernel void scale(__global float *x)\n"
    "{ x[get_global_id(0)] *= FACTOR; }\n";

static char folder[PATH_MAX], pocl[PATH_MAX];
static cl_device_id id;
static cl_context context;
static cl_command_queue queue;
static struct device_failure failure;

static int setup(void **state)
{
	struct device_info info;
	cl_int code;

	(void)state;
	folder_make(folder);
	folder_make(pocl);
	setenv("POCL_CACHE_DIR", pocl, 1);
	assert_int_equal(device_select(NULL, &id, &info, &failure), ERR_OK);
	context = clCreateContext(NULL, 1, &id, NULL, NULL, &code);
	assert_non_null(context);
	queue = clCreateCommandQueue(context, id, 0, &code);
	assert_non_null(queue);
	return 0;
}

static int teardown(void **state)
{
	(void)state;
	clReleaseCommandQueue(queue);
	clReleaseContext(context);
	device_failure_fini(&failure);
	folder_remove(folder);
	folder_remove(pocl);
	return 0;
}

/* What the program's kernel makes of 3. */
static float launch(cl_program program)
{
	float x = 3.0f;
	size_t one = 1;
	cl_int code;
	cl_kernel kernel = clCreateKernel(program, "scale", &code);
	cl_mem buffer = clCreateBuffer(context, CL_MEM_COPY_HOST_PTR, sizeof(x),
	    &x, &code);

	assert_non_null(kernel);
	assert_non_null(buffer);
	clSetKernelArg(kernel, 0, sizeof(buffer), &buffer);
	assert_int_equal(clEnqueueNDRangeKernel(queue, kernel, 1, NULL, &one,
	    &one, 0, NULL, NULL), CL_SUCCESS);
	assert_int_equal(clEnqueueReadBuffer(queue, buffer, CL_TRUE, 0,
	    sizeof(x), &x, 0, NULL, NULL), CL_SUCCESS);
	clReleaseMemObject(buffer);
	clReleaseKernel(kernel);
	return x;
}

/* Builds with folder as the cache, and launches; whether it came from there. */
static bool is_cached(const char *text, const char *options, float want)
{
	bool cached;
	cl_program program;

	assert_int_equal(device_cache_build(folder, context, id, text, options,
	    &program, &cached, &failure), ERR_OK);
	assert_true(launch(program) == want);
	clReleaseProgram(program);
	return cached;
}

/* Stores the program; the path of its file. */
static void store(char path[static PATH_MAX])
{
	cl_program program;
	bool cached;

	assert_int_equal(device_cache_build(NULL, context, id, source, OPTIONS,
	    &program, &cached, &failure), ERR_OK);
	assert_false(cached);
	assert_true(launch(program) == 6.0f);
	assert_int_equal(device_cache_store(folder, id, source, OPTIONS,
	    program, &failure), ERR_OK);
	clReleaseProgram(program);
	folder_find(folder, "kernels-", path);
	assert_true(is_cached(source, OPTIONS, 6.0f));
}

static unsigned char *slurp(const char *path, size_t *size)
{
	FILE *file = fopen(path, "rb");
	unsigned char *bytes;

	assert_non_null(file);
	fseek(file, 0, SEEK_END);
	*size = (size_t)ftell(file);
	rewind(file);
	bytes = malloc(*size + 1);
	assert_non_null(bytes);
	assert_int_equal(fread(bytes, 1, *size, file), *size);
	fclose(file);
	return bytes;
}

static void spill(const char *path, const void *bytes, size_t size)
{
	FILE *file = fopen(path, "wb");

	assert_non_null(file);
	assert_int_equal(fwrite(bytes, 1, size, file), size);
	assert_int_equal(fclose(file), 0);
}

static void test_a_stored_program_is_used(void **state)
{
	char path[PATH_MAX];

	(void)state;
	assert_false(is_cached(source, OPTIONS, 6.0f));
	store(path);
	assert_int_equal(folder_count(folder, "kernels-"), 1);
}

/* ... and is whole: PoCL's own cache need not have it. */
static void test_a_stored_program_needs_nothing_else(void **state)
{
	char path[PATH_MAX];

	(void)state;
	store(path);
	folder_remove(pocl);
	assert_int_equal(mkdir(pocl, 0700), 0);
	assert_true(is_cached(source, OPTIONS, 6.0f));
}

static void test_another_source_or_option_is_built(void **state)
{
	static const char other[] = "__kernel void scale(__global float *x)\n"
	    "{ x[get_global_id(0)] *= FACTOR + 1; }\n";
	char path[PATH_MAX];

	(void)state;
	store(path);
	assert_false(is_cached(other, OPTIONS, 9.0f));
	assert_false(is_cached(source, "-DFACTOR=5", 15.0f));
	assert_false(is_cached(source, OPTIONS " ", 6.0f));
}

static void test_a_damaged_program_is_built_anew(void **state)
{
	unsigned char *bytes;
	char path[PATH_MAX];
	size_t size;

	(void)state;
	store(path);
	bytes = slurp(path, &size);
	/* Magic, order, version, sizes, checksum, key, content. */
	for (size_t i = 0; i < size; i += i < 48 ? 4 : i < 400 ? 50 : size / 16) {
		bytes[i] ^= 0x10;
		spill(path, bytes, size);
		assert_false(is_cached(source, OPTIONS, 6.0f));
		bytes[i] ^= 0x10;
	}
	spill(path, bytes, size);
	assert_true(is_cached(source, OPTIONS, 6.0f));
	free(bytes);
}

static void test_a_program_of_another_length_is_built_anew(void **state)
{
	unsigned char *bytes;
	char path[PATH_MAX];
	size_t size;

	(void)state;
	store(path);
	bytes = slurp(path, &size);
	bytes[size] = 0;
	for (size_t i = 0; i < size; i += 1 + size / 24) {
		spill(path, bytes, i);
		assert_false(is_cached(source, OPTIONS, 6.0f));
	}
	spill(path, bytes, size - 1);
	assert_false(is_cached(source, OPTIONS, 6.0f));
	spill(path, bytes, size + 1);
	assert_false(is_cached(source, OPTIONS, 6.0f));
	spill(path, "foreign", 7);
	assert_false(is_cached(source, OPTIONS, 6.0f));
	free(bytes);
	store(path);
}

static void test_a_program_that_others_may_write_is_built_anew(void **state)
{
	char path[PATH_MAX];

	(void)state;
	store(path);
	assert_int_equal(chmod(path, 0666), 0);
	assert_false(is_cached(source, OPTIONS, 6.0f));
	assert_int_equal(chmod(path, 0600), 0);
	assert_true(is_cached(source, OPTIONS, 6.0f));
}

/* A file whose checksum holds, of what is no program. */
static void test_what_the_device_refuses_is_built(void **state)
{
	static const unsigned char text[256] = "no program";
	struct cache_key key;
	unsigned char *bytes;
	char path[PATH_MAX];
	uint64_t key_size;
	size_t size;

	(void)state;
	store(path);
	bytes = slurp(path, &size);
	memcpy(&key_size, bytes + 16, sizeof(key_size));
	assert_true(key_size <= sizeof(key.bytes));
	key.size = (size_t)key_size;
	memcpy(key.bytes, bytes + 48, key.size);
	free(bytes);
	assert_int_equal(cache_file_write(folder, "kernels", &key, text,
	    sizeof(text)), ERR_OK);
	assert_int_equal(folder_count(folder, "kernels-"), 1);
	assert_false(is_cached(source, OPTIONS, 6.0f));
	store(path);
}

static void test_a_folder_that_is_none_is_no_failure(void **state)
{
	char path[PATH_MAX];
	cl_program program;
	bool cached;

	(void)state;
	store(path);
	assert_int_equal(device_cache_build(path, context, id, source, OPTIONS,
	    &program, &cached, &failure), ERR_OK);
	assert_false(cached);
	assert_int_equal(device_cache_store(path, id, source, OPTIONS, program,
	    &failure), ERR_IO);
	assert_non_null(strstr(failure.message, path));
	clReleaseProgram(program);
}

int main(void)
{
	const struct CMUnitTest tests[] = {
		cmocka_unit_test(test_a_stored_program_is_used),
		cmocka_unit_test(test_a_stored_program_needs_nothing_else),
		cmocka_unit_test(test_another_source_or_option_is_built),
		cmocka_unit_test(test_a_damaged_program_is_built_anew),
		cmocka_unit_test(
		    test_a_program_of_another_length_is_built_anew),
		cmocka_unit_test(
		    test_a_program_that_others_may_write_is_built_anew),
		cmocka_unit_test(test_what_the_device_refuses_is_built),
		cmocka_unit_test(test_a_folder_that_is_none_is_no_failure),
	};

	return cmocka_run_group_tests(tests, setup, teardown);
}
