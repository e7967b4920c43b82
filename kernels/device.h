/*
 * An OpenCL device that evaluates tapes. The only module that calls cl*.
 *
 * Thread contract: a struct device and everything made from it belong to one
 * thread at a time; the caller serialises. Different devices are independent.
 */
#ifndef KERNELS_DEVICE_H
#define KERNELS_DEVICE_H

#include <stdbool.h>
#include <stddef.h>

#include "core/err.h"

struct device;
struct device_tape;
struct table;
struct tape;

/* Where operator tables lie on the device. Samplers of GPUs interpolate images with
 * weights of 8 bits: on an H100 lookups are off by 2.7e-4 of the greatest value,
 * not 8e-7, and no more than a tenth faster. */
enum device_tables {
	DEVICE_TABLES_AUTO,   /* buffers */
	DEVICE_TABLES_BUFFER,
	DEVICE_TABLES_IMAGE
};

struct device_options {
	/* NULL or "": the first GPU, else the first device of any kind. Else an
	 * index of device_list, or part of a name ("pocl", "NVIDIA"), case
	 * ignored. */
	const char *select;
	int width;                 /* points a work-item: 1 2 4 8 16; 0 chooses */
	enum device_tables tables;
	size_t table_bytes;        /* most for operator tables; 0: 256 MiB */
	size_t volume_bytes;       /* most for volumes; 0: 256 MiB */
	/* Where built kernels are kept from one start to the next: an existing
	 * folder, or NULL for none. */
	const char *cache;
	bool cache_is_read_only;   /* ... of which none is deleted either */
	bool no_culling;           /* every point walks the whole tape */
};

struct device_info {
	char name[128], vendor[128], version[128], driver[64];
	bool is_gpu;
	bool has_images;
	int width;                /* chosen; 0 in device_list */
	bool tables_are_images;   /* chosen */
	bool is_cached;           /* all kernels came out of the cache */
	unsigned compute_units;
	size_t memory_bytes;
};

/*
 * Text of what went wrong, for a person: the call, the OpenCL error's name, a
 * build log. Owned by the caller; start with {0}.
 */
struct device_failure {
	char message[512];
	char *build_log; /* malloc'd, or NULL */
};
void device_failure_fini(struct device_failure *failure);

/*
 * Calls each once for every device of every platform, with its index.
 * ERR_NOT_FOUND: no platform, or none with a device; the message says what to
 * install or mend (an unwritable PoCL cache directory hides its device).
 */
enum err device_list(void (*each)(void *ctx, int index,
    const struct device_info *info), void *ctx, struct device_failure *failure);

/*
 * Whether device_open would find its device, and the device have what options
 * ask for: the errors of device_open before anything is built.
 */
enum err device_check(const struct device_options *options,
    struct device_failure *failure);

/*
 * Opens a device, builds the kernels and launches each once, so that nothing
 * compiles later. ERR_NOT_FOUND, ERR_DEVICE, ERR_DEVICE_BUILD (with the log),
 * ERR_MEMORY; ERR_INVALID: a width that is none, or images where there are
 * none. On success *out is the caller's.
 */
enum err device_open(const struct device_options *options, struct device **out,
    struct device_failure *failure);

/* Releases everything; what was loaded into it goes with it. NULL does nothing. */
void device_close(struct device *d);

const struct device_info *device_get_info(const struct device *d);

/*
 * Writes the kernels that did not come out of the options' cache into it. PoCL 3.1 compiles a general form of each
 * first, which nobody uses: 16 s for ours. ERR_INVALID: there is no cache;
 * ERR_DEVICE, ERR_MEMORY, ERR_IO.
 */
enum err device_keep_kernels(struct device *d);

/* The text of the last call that failed. */
const char *device_message(const struct device *d);

/* Bytes of operator tables resident, and the most there may be. */
size_t device_table_bytes(const struct device *d, size_t *most);

/*
 * Makes a complete table resident; *slot names it until device_drop_table.
 * ERR_DEVICE_MEMORY: no room; drop another first. ERR_DEVICE.
 */
enum err device_load_table(struct device *d, const struct table *table,
    int *slot);

/* Frees a slot that device_load_table gave. No tape may still use it. */
void device_drop_table(struct device *d, int slot);

/*
 * Uploads a tape. slots[i] is the resident table of tape->operators[i]; its
 * profile, family and layout are the operator's, its resolution may differ.
 * They stay resident while the result lives; so do the tape's volumes, which
 * are made resident. The tape may be freed afterwards.
 * ERR_DEVICE_MEMORY, ERR_DEVICE, ERR_MEMORY. ERR_INVALID: a tape that
 * tape_compile would not make, or a slot that does not suit its operator.
 */
enum err device_load_tape(struct device *d, const struct tape *tape,
    const int *slots, struct device_tape **out);

/* Frees a tape that device_load_tape gave; NULL does nothing. */
void device_drop_tape(struct device *d, struct device_tape *t);

/* Bytes that t takes on the device and, for culling, on the host. */
size_t device_tape_bytes(const struct device_tape *t);

/*
 * Seconds of the last device_evaluate or
 * device_evaluate_parts, all its pieces together. A device that shares the host's
 * memory has its points and rows copied only where they are few, or are of
 * several parts.
 */
struct device_times {
	double upload;   /* tiles made, points copied */
	double kernel;   /* from there to its end, queueing it included; where
	                  * points are copied, by the device's clock */
	double download; /* rows copied to the caller's */
};
const struct device_times *device_get_times(const struct device *d);

/* One of several batches that go through the device together; see
 * device_evaluate. */
struct device_part {
	const float *points;
	size_t count;
	float *rows;
};

/*
 * As device_evaluate, for several small batches in as few launches as can be:
 * DEVICE_PARTS_POINTS points together at most (else ERR_INVALID), not
 * interrupted.
 */
#define DEVICE_PARTS_POINTS 65536
enum err device_evaluate_parts(struct device *d, struct device_tape *t,
    const struct device_part *parts, size_t part_count, unsigned outputs);

/*
 * Evaluates t at count points (xyz, finite, world units) and writes a row of
 * output_row_floats(outputs) floats each to rows (core/output.h). Any count;
 * pieces of bounded size go through the device. go_on, if not NULL, is asked
 * before each piece; false ends with ERR_CANCELLED. ERR_INVALID, ERR_DEVICE,
 * ERR_DEVICE_MEMORY. Every number written is finite.
 */
enum err device_evaluate(struct device *d, struct device_tape *t,
    const float *points, size_t count, unsigned outputs, float *rows,
    bool (*go_on)(void *ctx), void *ctx);

#endif
