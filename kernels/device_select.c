#include "kernels/device_internal.h"

#include <ctype.h>
#include <errno.h>
#include <limits.h>
#include <stdlib.h>
#include <string.h>
#include <strings.h>

#define PLATFORMS_MAX 16
#define DEVICES_MAX 64

#define NOTHING_FOUND "no OpenCL device. Install one's driver " \
	"(Debian: pocl-opencl-icd runs on any CPU); if PoCL is installed, its " \
	"cache directory (POCL_CACHE_DIR, else XDG_CACHE_HOME/pocl, else " \
	"~/.cache/pocl) must be writable, or it shows no device"

/* CL_PLATFORM_NOT_FOUND_KHR of cl_khr_icd. */
#define NO_PLATFORM (-1001)

/* Every device of every platform, in order. */
struct found {
	cl_device_id ids[DEVICES_MAX];
	int count;
};

static void find_on_platform(cl_platform_id platform, struct found *found)
{
	cl_uint room = (cl_uint)(DEVICES_MAX - found->count), count = 0;

	if (room == 0 || clGetDeviceIDs(platform, CL_DEVICE_TYPE_ALL, room,
	    found->ids + found->count, &count) != CL_SUCCESS)
		return;
	found->count += (int)(count < room ? count : room);
}

static enum err find(struct found *found, struct device_failure *failure)
{
	cl_platform_id platforms[PLATFORMS_MAX];
	cl_uint count = 0;
	cl_int code = clGetPlatformIDs(PLATFORMS_MAX, platforms, &count);

	found->count = 0;
	if (code == CL_SUCCESS)
		for (cl_uint i = 0; i < count && i < PLATFORMS_MAX; i++)
			find_on_platform(platforms[i], found);
	if (found->count == 0 && code != CL_SUCCESS && code != NO_PLATFORM)
		return device_fail(failure, "clGetPlatformIDs", code);
	if (found->count == 0)
		return device_refuse(failure, ERR_NOT_FOUND, NOTHING_FOUND);
	return ERR_OK;
}

/* A string that the device tells, blanks around it cut off. */
static void tell(cl_device_id id, cl_device_info what, char *out, size_t size)
{
	char text[1024] = "";
	size_t first = 0, length;

	if (clGetDeviceInfo(id, what, sizeof(text), text, NULL) != CL_SUCCESS)
		text[0] = '\0';
	text[sizeof(text) - 1] = '\0';
	while (isspace((unsigned char)text[first]))
		first++;
	length = strlen(text + first);
	while (length > 0 && isspace((unsigned char)text[first + length - 1]))
		length--;
	if (length > size - 1)
		length = size - 1;
	memcpy(out, text + first, length);
	out[length] = '\0';
}

static void describe(cl_device_id id, struct device_info *info)
{
	cl_device_type type = 0;
	cl_bool images = CL_FALSE;
	cl_uint units = 0;
	cl_ulong memory = 0;

	memset(info, 0, sizeof(*info));
	tell(id, CL_DEVICE_NAME, info->name, sizeof(info->name));
	tell(id, CL_DEVICE_VENDOR, info->vendor, sizeof(info->vendor));
	tell(id, CL_DEVICE_VERSION, info->version, sizeof(info->version));
	tell(id, CL_DRIVER_VERSION, info->driver, sizeof(info->driver));
	clGetDeviceInfo(id, CL_DEVICE_TYPE, sizeof(type), &type, NULL);
	clGetDeviceInfo(id, CL_DEVICE_IMAGE_SUPPORT, sizeof(images), &images,
	    NULL);
	clGetDeviceInfo(id, CL_DEVICE_MAX_COMPUTE_UNITS, sizeof(units), &units,
	    NULL);
	clGetDeviceInfo(id, CL_DEVICE_GLOBAL_MEM_SIZE, sizeof(memory), &memory,
	    NULL);
	info->is_gpu = (type & CL_DEVICE_TYPE_GPU) != 0;
	info->has_images = images == CL_TRUE;
	info->compute_units = units;
	info->memory_bytes = memory > SIZE_MAX ? SIZE_MAX : (size_t)memory;
}

enum err device_list(void (*each)(void *ctx, int index,
    const struct device_info *info), void *ctx, struct device_failure *failure)
{
	struct device_info info;
	struct found found;
	enum err err = find(&found, failure);

	if (err)
		return err;
	for (int i = 0; i < found.count; i++) {
		describe(found.ids[i], &info);
		each(ctx, i, &info);
	}
	return ERR_OK;
}

static bool contains(const char *text, const char *part)
{
	size_t length = strlen(part);

	for (; *text; text++)
		if (strncasecmp(text, part, length) == 0)
			return true;
	return false;
}

/* The index that select writes out, or -1 if it is no number. */
static int index_of(const char *select)
{
	char *end;
	long index;

	if (!isdigit((unsigned char)select[0]))
		return -1;
	errno = 0;
	index = strtol(select, &end, 10);
	if (*end != '\0')
		return -1;
	return errno || index > INT_MAX ? INT_MAX : (int)index;
}

/* Which device select means by its name, or -1. */
static int named(const struct found *found, const char *select)
{
	struct device_info info;

	for (int i = 0; i < found->count; i++) {
		describe(found->ids[i], &info);
		if (contains(info.name, select) ||
		    contains(info.vendor, select) ||
		    contains(info.version, select))
			return i;
	}
	return -1;
}

static int first_gpu(const struct found *found)
{
	struct device_info info;

	for (int i = 0; i < found->count; i++) {
		describe(found->ids[i], &info);
		if (info.is_gpu)
			return i;
	}
	return 0;
}

enum err device_select(const char *select, cl_device_id *id,
    struct device_info *info, struct device_failure *failure)
{
	struct found found;
	enum err err = find(&found, failure);
	int i;

	if (err)
		return err;
	if (!select || !select[0]) {
		i = first_gpu(&found);
	} else {
		i = index_of(select);
		if (i < 0)
			i = named(&found, select);
		if (i < 0 || i >= found.count)
			return device_refuse(failure, ERR_NOT_FOUND,
			    "no OpenCL device \"%.100s\" among the %d there are",
			    select, found.count);
	}
	*id = found.ids[i];
	describe(found.ids[i], info);
	return ERR_OK;
}
