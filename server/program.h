/*
 * A compiled scene as the scheduler runs it: its tape, the operator tables it
 * needs, and, once the device thread has uploaded it, its copy on the device.
 *
 * Reference counted: a scene revision holds one reference, every evaluation in
 * flight another. The last one is given up through the scheduler, since the
 * device's copy is the device thread's to drop.
 */
#ifndef SERVER_PROGRAM_H
#define SERVER_PROGRAM_H

#include <stdatomic.h>
#include <stddef.h>

#include "core/err.h"
#include "server/job_list.h"
#include "server/pace.h"

/* Derivative orders of the root: 0 to 2. */
#define PROGRAM_ORDERS 3

struct device_tape;
struct surface;
struct table_entry;
struct tables;
struct tape;

struct program {
	atomic_size_t refs;
	struct tape *tape;
	struct table_entry **entries; /* of tape->operators, in order */
	/* Those that may stand in for entries, NULL where none may; or NULL: for
	 * none. */
	struct table_entry **drafts;
	size_t entry_count;
	struct surface *surface;      /* the tape's: any thread */
	size_t bytes;                 /* see program_bytes */
	struct program *dead_next;    /* the scheduler's */
	/* device thread only: */
	struct device_tape *loaded;
	struct table_entry **loaded_entries; /* entries, or of each that or its
	                                      * draft: what loaded refers to */
	struct program *newer, *older; /* loaded ones, by last use */
	struct job_list jobs;          /* interactive ones that wait, by turn */
	struct program *turn_prev, *turn_next; /* others with such */
	struct pace pace[PROGRAM_ORDERS];
};

/*
 * Takes tape over, also on failure. The one reference is the caller's.
 * ERR_LIMIT: its operator tables need more than table_bytes_most together.
 * ERR_MEMORY.
 */
enum err program_create(struct tables *tables, struct tape *tape,
    size_t table_bytes_most, struct program **out);

/* One reference more. */
struct program *program_hold(struct program *program);

/* Frees a program without references or device copy. */
void program_free(struct tables *tables, struct program *program);

/* Bytes its copy on the device takes, about, without tables and volumes. */
size_t program_bytes(const struct program *program);

#endif
