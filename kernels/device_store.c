#include "kernels/device_internal.h"

#include <assert.h>
#include <stdlib.h>
#include <string.h>

#include "core/curve.h"
#include "core/table.h"

static_assert(DESCRIPTOR_UNION == FAMILY_UNION &&
    DESCRIPTOR_INTERSECTION == FAMILY_INTERSECTION, "families");
static_assert(DESCRIPTOR_SMOOTH == PROFILE_SMOOTH &&
    DESCRIPTOR_BULGE == PROFILE_BULGE && DESCRIPTOR_CIRCLE == PROFILE_CIRCLE &&
    DESCRIPTOR_SAMPLES == PROFILE_SAMPLES, "profiles");
static_assert(DESCRIPTOR_WARPED == LAYOUT_WARPED &&
    DESCRIPTOR_UNIFORM == LAYOUT_UNIFORM, "layouts");

/* Nodes along x and y of a slice of the atlases. */
#define SLICE (2 * DESCRIPTOR_TILE)
#define SLICE_BYTES (SLICE * SLICE * (TABLE_FIRST + TABLE_SECOND) * \
	sizeof(float))
#define ALL_TILES 15u

/* The floats of both curves of a table. */
#define CURVE_FLOATS (2 * TABLE_CURVE_NODES * CURVE_NODE)

/* Of the bytes for images, this share more for curves: 16 KB of at least
 * 1.5 MB, which is what the smallest table takes. */
#define CURVE_SHARE 64

bool device_arena_take(struct device_arena *arena, size_t size,
    struct device_span *out)
{
	size_t at = 0, i;

	for (i = 0; i < arena->count; i++) {
		if (arena->spans[i].at - at >= size)
			break;
		at = arena->spans[i].at + arena->spans[i].size;
	}
	if (arena->size - at < size)
		return false;
	if (arena->count == arena->capacity) {
		size_t capacity = 2 * arena->capacity + 8;
		struct device_span *spans = realloc(arena->spans,
		    capacity * sizeof(*spans));

		if (!spans)
			return false;
		arena->spans = spans;
		arena->capacity = capacity;
	}
	memmove(arena->spans + i + 1, arena->spans + i,
	    (arena->count - i) * sizeof(*arena->spans));
	arena->spans[i] = (struct device_span){at, size};
	arena->count++;
	*out = arena->spans[i];
	return true;
}

void device_arena_give(struct device_arena *arena, struct device_span span)
{
	size_t i = 0;

	while (i < arena->count && arena->spans[i].at != span.at)
		i++;
	assert(i < arena->count);
	arena->count--;
	memmove(arena->spans + i, arena->spans + i + 1,
	    (arena->count - i) * sizeof(*arena->spans));
}

/* A limit of the device, and at least `least`. */
static enum err get_limit(struct device *d, cl_device_info what, size_t least,
    size_t *out)
{
	cl_ulong value = 0; /* wide enough for size_t as well */
	cl_int code = clGetDeviceInfo(d->id, what, sizeof(value), &value, NULL);

	if (code != CL_SUCCESS)
		return device_fail(&d->failure, "clGetDeviceInfo", code);
	*out = value < least ? least : (size_t)value;
	return ERR_OK;
}

static enum err create_arena(struct device *d, size_t bytes)
{
	struct device_arena *arena = &d->tables.arena;
	cl_int code;

	arena->size = bytes / sizeof(float);
	if (arena->size > UINT32_MAX)
		arena->size = UINT32_MAX;
	arena->buffer = clCreateBuffer(d->context, CL_MEM_READ_ONLY,
	    arena->size * sizeof(float), NULL, &code);
	if (!arena->buffer)
		return device_fail(&d->failure, "clCreateBuffer for tables",
		    code);
	return ERR_OK;
}

/* Cleared, so that the sampler's zero weights never meet a NaN. */
static enum err create_atlas(struct device *d, size_t depth, cl_mem *out)
{
	const cl_image_format format = {CL_RGBA, CL_FLOAT};
	const cl_image_desc desc = {
		.image_type = CL_MEM_OBJECT_IMAGE3D,
		.image_width = SLICE,
		.image_height = SLICE,
		.image_depth = depth,
	};
	const size_t origin[3] = {0, 0, 0};
	const size_t region[3] = {SLICE, SLICE, depth};
	const float zero[4] = {0.0f, 0.0f, 0.0f, 0.0f};
	cl_int code;

	*out = clCreateImage(d->context, CL_MEM_READ_ONLY, &format, &desc,
	    NULL, &code);
	if (!*out)
		return device_fail(&d->failure, "clCreateImage for tables",
		    code);
	code = clEnqueueFillImage(d->queue, *out, zero, origin, region, 0,
	    NULL, NULL);
	if (code == CL_SUCCESS)
		code = clFinish(d->queue);
	if (code != CL_SUCCESS)
		return device_fail(&d->failure, "clEnqueueFillImage", code);
	return ERR_OK;
}

static enum err create_atlases(struct device *d, size_t bytes)
{
	struct device_store *t = &d->tables;
	size_t deepest = 0;
	enum err err = get_limit(d, CL_DEVICE_IMAGE3D_MAX_DEPTH, 2, &deepest);

	if (err)
		return err;
	t->depth = bytes / SLICE_BYTES;
	if (t->depth > deepest / 2)
		t->depth = deepest / 2;
	if (t->depth < 2)
		t->depth = 2;
	t->most = t->depth * SLICE_BYTES;
	t->taken = calloc(t->depth, 1);
	if (!t->taken)
		return ERR_MEMORY;
	err = create_atlas(d, t->depth, &t->first);
	if (err)
		return err;
	return create_atlas(d, 2 * t->depth, &t->second);
}

enum err device_store_init(struct device *d, size_t bytes)
{
	struct device_store *t = &d->tables;
	size_t most = 0;
	enum err err = get_limit(d, CL_DEVICE_MAX_MEM_ALLOC_SIZE, 1 << 20,
	    &most);

	if (err)
		return err;
	if (bytes > most)
		bytes = most;
	if (bytes < CURVE_SHARE * sizeof(float))
		bytes = CURVE_SHARE * sizeof(float);
	t->are_images = d->info.tables_are_images;
	if (!t->are_images) {
		err = create_arena(d, bytes);
		t->most = t->arena.size * sizeof(float);
		return err;
	}
	err = create_atlases(d, bytes);
	return err ? err : create_arena(d, t->most / CURVE_SHARE);
}

void device_store_fini(struct device_store *t)
{
	if (t->arena.buffer)
		clReleaseMemObject(t->arena.buffer);
	if (t->first)
		clReleaseMemObject(t->first);
	if (t->second)
		clReleaseMemObject(t->second);
	free(t->arena.spans);
	free(t->taken);
	free(t->slots);
	memset(t, 0, sizeof(*t));
}

static bool slices_free(const struct device_store *t, size_t first,
    size_t count, unsigned tiles)
{
	for (size_t i = first; i < first + count; i++)
		if (t->taken[i] & tiles)
			return false;
	return true;
}

/* Tiles for a table of resolution n: its first slice into *first. */
static bool take_tiles(struct device_store *t, size_t n, size_t *first,
    unsigned *tiles)
{
	int choices = n > DESCRIPTOR_TILE ? 1 : 4;

	for (int i = 0; i < choices; i++) {
		unsigned mask = choices == 1 ? ALL_TILES : 1u << i;

		for (size_t z = 0; z + n <= t->depth; z++) {
			if (!slices_free(t, z, n, mask))
				continue;
			for (size_t k = z; k < z + n; k++)
				t->taken[k] |= (unsigned char)mask;
			*first = z;
			*tiles = mask;
			return true;
		}
	}
	return false;
}

static void give_tiles(struct device_store *t, const struct device_slot *slot)
{
	for (size_t i = 0; i < slot->desc.resolution; i++)
		t->taken[slot->desc.first + i] &= (unsigned char)~slot->tiles;
}

static enum err write_image(struct device *d, cl_mem image, size_t slice,
    const struct operator_desc *desc, const float *texels)
{
	const size_t n = desc->resolution;
	const size_t origin[3] = {
		desc->second & 1u ? DESCRIPTOR_TILE : 0,
		desc->second & 2u ? DESCRIPTOR_TILE : 0,
		slice,
	};
	const size_t region[3] = {n, n, n};
	cl_int code = clEnqueueWriteImage(d->queue, image, CL_TRUE, origin,
	    region, 0, 0, texels, 0, NULL, NULL);

	if (code != CL_SUCCESS)
		return device_fail(&d->failure, "clEnqueueWriteImage", code);
	return ERR_OK;
}

/* The half of each node's second part that begins at float `from`. */
static void copy_half(const struct table *table, int from, float *out)
{
	for (size_t i = 0; i < table->node_count; i++)
		memcpy(out + 4 * i, table->second + TABLE_SECOND * i + from,
		    4 * sizeof(float));
}

static enum err write_nodes_image(struct device *d, const struct table *table,
    const struct operator_desc *desc)
{
	float *half = malloc(table->node_count * 4 * sizeof(*half));
	enum err err = ERR_MEMORY;

	if (!half)
		return ERR_MEMORY;
	err = write_image(d, d->tables.first, desc->first, desc, table->first);
	if (err)
		goto out;
	copy_half(table, 0, half);
	err = write_image(d, d->tables.second, desc->first, desc, half);
	if (err)
		goto out;
	copy_half(table, 4, half);
	err = write_image(d, d->tables.second, desc->first + d->tables.depth,
	    desc, half);
out:
	free(half);
	return err;
}

static enum err write_floats(struct device *d, size_t at, const float *from,
    size_t count)
{
	cl_int code = clEnqueueWriteBuffer(d->queue, d->tables.arena.buffer,
	    CL_TRUE, at * sizeof(float), count * sizeof(float), from, 0, NULL,
	    NULL);

	if (code != CL_SUCCESS)
		return device_fail(&d->failure, "clEnqueueWriteBuffer", code);
	return ERR_OK;
}

/* Finds room for table and fills in slot. */
static bool place(struct device_store *t, const struct table *table,
    struct device_slot *slot)
{
	size_t nodes = t->are_images ? 0 :
	    table->node_count * (TABLE_FIRST + TABLE_SECOND);
	size_t slice = 0;

	if (!device_arena_take(&t->arena, nodes + CURVE_FLOATS, &slot->span))
		return false;
	slot->desc = (struct operator_desc){
		.family = (uint32_t)table->family,
		.profile = (uint32_t)table->profile.type,
		.layout = (uint32_t)table->layout,
		.resolution = (uint32_t)table->resolution,
		.silhouette = (uint32_t)(slot->span.at + nodes),
		.silhouette_count = CURVE_FLOATS / CURVE_NODE,
	};
	slot->bytes = slot->span.size * sizeof(float);
	if (!t->are_images) {
		slot->desc.first = (uint32_t)slot->span.at;
		slot->desc.second = (uint32_t)(slot->span.at +
		    table->node_count * TABLE_FIRST);
		return true;
	}
	if (!take_tiles(t, (size_t)table->resolution, &slice, &slot->tiles)) {
		device_arena_give(&t->arena, slot->span);
		return false;
	}
	slot->desc.first = (uint32_t)slice;
	/* Tile i is at (i & 1, i >> 1); all four begin at the first. */
	slot->desc.second = slot->tiles == ALL_TILES ? 0 :
	    (uint32_t)__builtin_ctz(slot->tiles);
	slot->bytes += (size_t)table->resolution * SLICE_BYTES /
	    (slot->tiles == ALL_TILES ? 1 : 4);
	return true;
}

static void unplace(struct device_store *t, struct device_slot *slot)
{
	if (t->are_images)
		give_tiles(t, slot);
	device_arena_give(&t->arena, slot->span);
	slot->used = false;
}

static enum err upload(struct device *d, const struct table *table,
    const struct operator_desc *desc)
{
	enum err err = write_floats(d, desc->silhouette, table->curves,
	    CURVE_FLOATS);

	if (err)
		return err;
	if (d->tables.are_images)
		return write_nodes_image(d, table, desc);
	err = write_floats(d, desc->first, table->first,
	    table->node_count * TABLE_FIRST);
	if (err)
		return err;
	return write_floats(d, desc->second, table->second,
	    table->node_count * TABLE_SECOND);
}

/* A slot that is not used, or NULL if the host has no memory. */
static struct device_slot *unused_slot(struct device_store *t)
{
	struct device_slot *slots;

	for (size_t i = 0; i < t->slot_count; i++)
		if (!t->slots[i].used)
			return t->slots + i;
	slots = realloc(t->slots, (t->slot_count + 1) * sizeof(*slots));
	if (!slots)
		return NULL;
	t->slots = slots;
	memset(slots + t->slot_count, 0, sizeof(*slots));
	return slots + t->slot_count++;
}

enum err device_load_table(struct device *d, const struct table *table,
    int *slot)
{
	struct device_store *t = &d->tables;
	struct device_slot *s = unused_slot(t);
	enum err err;

	if (!s)
		return device_out_of_memory(&d->failure);
	if (!place(t, table, s))
		return device_refuse(&d->failure, ERR_DEVICE_MEMORY,
		    "no room for an operator table of %zu bytes: %zu of %zu "
		    "are in use", table_bytes(table), t->bytes, t->most);
	err = upload(d, table, &s->desc);
	if (err) {
		unplace(t, s);
		return err;
	}
	s->used = true;
	s->profile = table->profile;
	t->bytes += s->bytes;
	*slot = (int)(s - t->slots);
	return ERR_OK;
}

void device_drop_table(struct device *d, int slot)
{
	struct device_store *t = &d->tables;
	struct device_slot *s;

	assert(slot >= 0 && (size_t)slot < t->slot_count);
	s = t->slots + slot;
	assert(s->used);
	t->bytes -= s->bytes;
	unplace(t, s);
}

size_t device_table_bytes(const struct device *d, size_t *most)
{
	if (most)
		*most = d->tables.most;
	return d->tables.bytes;
}
