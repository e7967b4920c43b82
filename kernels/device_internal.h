/*
 * What the files kernels/device_*.c share. Nobody else includes this, but for
 * the device's own tests.
 */
#ifndef KERNELS_DEVICE_INTERNAL_H
#define KERNELS_DEVICE_INTERNAL_H

#include <stdint.h>

/* Shared virtual memory is OpenCL 2's; all else is within 1.2. */
#undef CL_TARGET_OPENCL_VERSION
#define CL_TARGET_OPENCL_VERSION 200
#define CL_USE_DEPRECATED_OPENCL_1_2_APIS
#include <CL/cl.h>

#include "core/descriptor.h"
#include "core/profile.h"
#include "kernels/cache_file.h"
#include "kernels/device.h"

struct device_crew;
struct tiles;
struct tiles_crew;
struct tiles_work;
struct volume;

/* A stretch of an arena, in floats. */
struct device_span {
	size_t at, size;
};

/* One device buffer, shared out first-fit. Spans are those in use, in order. */
struct device_arena {
	cl_mem buffer;
	size_t size;
	struct device_span *spans;
	size_t count, capacity;
};

/* A resident table. */
struct device_slot {
	bool used;
	struct operator_desc desc; /* but for the opening's members */
	struct profile profile;
	struct device_span span;   /* in the arena */
	unsigned tiles;            /* images: bit i for tile i of each slice */
	size_t bytes;
};

/*
 * Operator tables. Buffers: everything is in the arena. Images: only the
 * curves are, nodes are in two atlases of `depth` slices of four tiles.
 */
struct device_store {
	bool are_images;
	struct device_arena arena;
	cl_mem first, second;
	size_t depth;
	unsigned char *taken; /* per slice: the tiles in use */
	struct device_slot *slots;
	size_t slot_count;
	size_t bytes, most;
};

/* A volume on the device, while tapes use it. */
struct device_volume {
	uint64_t serial;          /* struct volume's */
	size_t holds;             /* tapes that use it */
	struct device_span span;
};

/* The coefficients of volumes, one after the other in one buffer. */
struct device_volumes {
	struct device_arena arena;
	bool is_made; /* the arena's buffer; one of a few bytes stands in */
	struct device_volume *list;
	size_t count, capacity;
};

/* The most characters of a program's build options. */
#define DEVICE_OPTIONS_MAX 96

/* What kernels/interpreter.cl is built as. */
enum device_kernel {
	DEVICE_PLAIN, /* the faster: without what its WHOLE names */
	DEVICE_WHOLE,
	DEVICE_KERNEL_COUNT
};

/*
 * Memory that the host writes or reads and kernels read or write: in one place
 * (shared virtual memory), or in two, with copies between them.
 */
struct device_area {
	void *at;      /* the host's */
	cl_mem buffer; /* the device's; NULL: `at` is that too */
	size_t size;
};

/* What a piece of a batch needs besides its points and rows. */
struct device_workspace {
	struct device_area order, tiles, insns; /* struct tiles_out's */
	struct device_area points, rows; /* of pieces that lie elsewhere, or
	                                  * anywhere but in the host's memory */
	struct tiles_work *tiling; /* NULL until used */
	size_t plain_points; /* order and tiles are on the device, for so many
	                      * points in the order given, whole tapes */
};

/* Which batches are culled. */
enum device_culling {
	DEVICE_CULLING_PAYS, /* those for which it may pay (tiles_pay) */
	DEVICE_CULLING_ALWAYS,
	DEVICE_CULLING_NEVER
};

struct device {
	struct device_info info;
	struct device_failure failure;
	cl_device_id id;
	cl_context context;
	cl_command_queue queue;
	cl_program programs[DEVICE_KERNEL_COUNT];
	cl_kernel kernels[DEVICE_KERNEL_COUNT];
	char build_options[DEVICE_KERNEL_COUNT][DEVICE_OPTIONS_MAX];
	bool is_cached[DEVICE_KERNEL_COUNT]; /* came out of the cache */
	char cache[CACHE_FOLDER_MAX]; /* a folder; "": none */
	bool cache_is_read_only;
	size_t group;          /* work-items of a work-group */
	int block;             /* vectors of points of a work-item */
	bool has_shared;       /* areas are shared virtual memory */
	bool reads_host;       /* kernels read and write the host's arrays */
	enum device_culling culling; /* tests change it */
	struct device_workspace work;
	struct device_crew *crew; /* NULL until used */
	struct device_store tables;
	struct device_volumes volumes;
	struct device_times times; /* of the last call */
	double mark;           /* what they are measured from, seconds */
	cl_event ran;          /* the kernel queued, or NULL */
};

struct device_tape {
	cl_mem insns, params, descs, openings;
	cl_mem volumes;           /* uint: where in the arena each begins */
	uint64_t *volume_serials; /* of the volumes it holds */
	size_t volume_count;
	uint32_t insn_count;
	bool is_plain; /* of instructions that DEVICE_PLAIN knows */
	struct tiles *tiles;      /* NULL: every tile walks the whole */
	size_t bytes;             /* of the buffers */
};

/* device_failure.c */

/* The name of an OpenCL error code, never NULL. */
const char *device_code_name(cl_int code);

/*
 * Puts "call: name" into failure and returns the err of code: out of memory is
 * ERR_DEVICE_MEMORY or ERR_MEMORY, all else ERR_DEVICE; CL_OUT_OF_RESOURCES,
 * too, which NVIDIA's driver says of a kernel that it had to stop.
 */
enum err device_fail(struct device_failure *failure, const char *call,
    cl_int code);

/* Puts text (as printf) into failure and returns err. */
__attribute__((format(printf, 3, 4)))
enum err device_refuse(struct device_failure *failure, enum err err,
    const char *format, ...);

/* ERR_MEMORY, with a message that says so. */
enum err device_out_of_memory(struct device_failure *failure);

/* device_select.c */

/* The device that select names, and what is known of it. */
enum err device_select(const char *select, cl_device_id *id,
    struct device_info *info, struct device_failure *failure);

/* device_build.c */

/*
 * Builds source for id. ERR_DEVICE_BUILD leaves the compiler's log in
 * failure->build_log. *out is the caller's.
 */
enum err device_build(cl_context context, cl_device_id id, const char *source,
    const char *options, cl_program *out, struct device_failure *failure);

/* device.c */

/* How device_open_as may depart from what suits the device best. */
enum device_memory {
	DEVICE_MEMORY_AUTO,
	DEVICE_MEMORY_COPIED /* buffers, written and read, as on a GPU */
};

/* device_open, told how memory is to be shared: for tests. */
enum err device_open_as(const struct device_options *options,
    enum device_memory memory, struct device **out,
    struct device_failure *failure);

/* device_workspace.c */

/* Has room for size bytes in area, of a batch's; what was in it is lost. */
enum err device_area_reserve(struct device *d, struct device_area *area,
    size_t size);
void device_area_fini(struct device *d, struct device_area *area);

/* Copies the first size bytes to the device, if that is elsewhere. Queued: they
 * must stay as they are until the queue is finished. */
enum err device_area_send(struct device *d, const struct device_area *area,
    size_t size);

/* Has area be the next argument; *code keeps the first failure. */
void device_area_set(cl_kernel kernel, cl_uint *index,
    const struct device_area *area, cl_int *code);

void device_workspace_fini(struct device *d, struct device_workspace *w);

/* Bytes of all of it, on the host or the device. */
size_t device_workspace_bytes(const struct device_workspace *w);

/* device_crew.c */

/* Threads that work for the calling one. *out is the caller's; with as few
 * as none if there can be no more. ERR_MEMORY. */
enum err device_crew_create(struct device_crew **out);
void device_crew_free(struct device_crew *crew);
const struct tiles_crew *device_crew_get(const struct device_crew *crew);

/* device_store.c */

enum err device_store_init(struct device *d, size_t bytes);
void device_store_fini(struct device_store *t);

/* First-fit; false if there is no gap of that size or the host has no memory. */
bool device_arena_take(struct device_arena *arena, size_t size,
    struct device_span *out);
void device_arena_give(struct device_arena *arena, struct device_span span);


/* device_volume.c */

/* A buffer of that many bytes for volumes. */
enum err device_volumes_init(struct device *d, size_t bytes);
void device_volumes_fini(struct device_volumes *v);

/* Makes v resident, if it is not, and counts one more tape that uses it; *first
 * is where its coefficients begin, in floats. ERR_DEVICE_MEMORY: no room. */
enum err device_volume_hold(struct device *d, const struct volume *v,
    uint32_t *first);
void device_volume_release(struct device *d, uint64_t serial);

#endif
