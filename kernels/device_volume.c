/*
 * The coefficients of volumes, in one buffer that is made with the first of
 * them; until then a small one stands in, since every kernel argument has to
 * be something.
 */
#include "kernels/device_internal.h"

#include <assert.h>
#include <stdlib.h>
#include <string.h>

#include "core/volume.h"

#define STAND_IN_BYTES 64

/* A volume's coefficients begin at multiples of so many floats. */
#define ALIGNMENT 16

static enum err create(struct device *d, size_t bytes, cl_mem *out)
{
	cl_int code;

	*out = clCreateBuffer(d->context, CL_MEM_READ_ONLY, bytes, NULL, &code);
	if (!*out)
		return device_fail(&d->failure, "clCreateBuffer for volumes",
		    code);
	return ERR_OK;
}

/* The bytes of one buffer, as many as wanted and as the device gives. */
static size_t limited(cl_device_id id, size_t bytes)
{
	cl_ulong most = 0;

	if (clGetDeviceInfo(id, CL_DEVICE_MAX_MEM_ALLOC_SIZE, sizeof(most),
	    &most, NULL) == CL_SUCCESS && bytes > most)
		bytes = (size_t)most;
	if (bytes / sizeof(float) > UINT32_MAX)
		bytes = UINT32_MAX * sizeof(float);
	return bytes < STAND_IN_BYTES ? STAND_IN_BYTES : bytes;
}

enum err device_volumes_init(struct device *d, size_t bytes)
{
	d->volumes.arena.size = limited(d->id, bytes) / sizeof(float);
	return create(d, STAND_IN_BYTES, &d->volumes.arena.buffer);
}

void device_volumes_fini(struct device_volumes *v)
{
	if (v->arena.buffer)
		clReleaseMemObject(v->arena.buffer);
	free(v->arena.spans);
	free(v->list);
	memset(v, 0, sizeof(*v));
}

/* The real buffer, in place of the one that stands in. */
static enum err make_room(struct device *d)
{
	struct device_volumes *v = &d->volumes;
	cl_mem buffer;
	enum err err;

	if (v->is_made)
		return ERR_OK;
	err = create(d, v->arena.size * sizeof(float), &buffer);
	if (err)
		return err;
	clReleaseMemObject(v->arena.buffer);
	v->arena.buffer = buffer;
	v->is_made = true;
	return ERR_OK;
}

static struct device_volume *find(struct device_volumes *v, uint64_t serial)
{
	for (size_t i = 0; i < v->count; i++)
		if (v->list[i].serial == serial)
			return v->list + i;
	return NULL;
}

/* Room for one more in the list. */
static bool grow(struct device_volumes *v)
{
	size_t capacity = 2 * v->capacity + 8;
	struct device_volume *list;

	if (v->count < v->capacity)
		return true;
	list = realloc(v->list, capacity * sizeof(*list));
	if (!list)
		return false;
	v->list = list;
	v->capacity = capacity;
	return true;
}

static enum err upload(struct device *d, const struct volume *v, size_t at,
    size_t count)
{
	cl_int code = clEnqueueWriteBuffer(d->queue, d->volumes.arena.buffer,
	    CL_TRUE, at * sizeof(float), count * sizeof(float),
	    v->coefficients, 0, NULL, NULL);

	if (code != CL_SUCCESS)
		return device_fail(&d->failure, "clEnqueueWriteBuffer", code);
	return ERR_OK;
}

static enum err add(struct device *d, const struct volume *v,
    struct device_volume **out)
{
	struct device_volumes *all = &d->volumes;
	size_t count = v->count[0] * v->count[1] * v->count[2];
	struct device_span span;
	enum err err;

	if (!grow(all))
		return device_out_of_memory(&d->failure);
	err = make_room(d);
	if (err)
		return err;
	if (!device_arena_take(&all->arena, (count + ALIGNMENT - 1) /
	    ALIGNMENT * ALIGNMENT, &span))
		return device_refuse(&d->failure, ERR_DEVICE_MEMORY,
		    "no room for a volume of %zu bytes beside %zu others in "
		    "%zu bytes", count * sizeof(float), all->count,
		    all->arena.size * sizeof(float));
	err = upload(d, v, span.at, count);
	if (err) {
		device_arena_give(&all->arena, span);
		return err;
	}
	*out = all->list + all->count++;
	**out = (struct device_volume){.serial = v->serial, .span = span};
	return ERR_OK;
}

enum err device_volume_hold(struct device *d, const struct volume *v,
    uint32_t *first)
{
	struct device_volume *there = find(&d->volumes, v->serial);
	enum err err = there ? ERR_OK : add(d, v, &there);

	if (err)
		return err;
	there->holds++;
	*first = (uint32_t)there->span.at;
	return ERR_OK;
}

void device_volume_release(struct device *d, uint64_t serial)
{
	struct device_volumes *all = &d->volumes;
	struct device_volume *there = find(all, serial);

	assert(there && there->holds > 0);
	if (--there->holds > 0)
		return;
	device_arena_give(&all->arena, there->span);
	*there = all->list[--all->count];
}
