/*
 * The device's thread and the bounded queue before it.
 *
 * Threads: the device thread owns struct device and all that is made from it.
 * HTTP threads submit jobs; each job is completed exactly once, by a call of
 * its done() on the device thread, after which the job is the submitter's
 * again. A job whose operator tables are not resident waits for them while
 * later ones, whose are, go ahead; the one that has waited longest has its
 * tables loaded before all others'. Where its operators allow drafts, it waits
 * for those only.
 */
#ifndef SERVER_SCHEDULER_H
#define SERVER_SCHEDULER_H

#include <stdbool.h>
#include <stddef.h>

#include "core/err.h"
#include "kernels/device.h"
#include "server/tables.h"

struct program;
struct scheduler;
struct tape;

/* One evaluation. Zeroed by the caller, then: */
struct job {
	/* set before scheduler_submit */
	struct program *program; /* the caller holds it until done() */
	const float *points;     /* 3 * count, the caller's until done() */
	size_t count;
	unsigned outputs;        /* OUTPUT_* */
	void (*park)(void *ctx); /* accepted: called before anything else may be */
	void (*done)(void *ctx); /* device thread */
	bool (*wanted)(void *ctx); /* device thread: is anybody still waiting?
	                            * Called with a lock held, and often. */
	void *ctx;
	/* set before done() */
	enum err result;
	char message[256];       /* of a failure, for a person; or "" */
	bool is_draft;           /* ... with drafts of operator tables */
	float *rows;             /* malloc'd, the submitter's to free; or NULL */
	double seconds;          /* on the device */
	/* the scheduler's own */
	struct job *next;
	struct scheduler *scheduler;
	struct table_choice choice; /* of the program's tables and drafts */
	bool is_alone;           /* its tables have had all room once */
	bool is_too_large;       /* ... and it was not enough */
};

struct scheduler_options {
	struct device_options device;
	struct tables *tables;
	size_t queue;             /* jobs waiting at most */
	void (*ready)(void *ctx); /* device and built-in tables are there */
	void (*failed)(void *ctx); /* there is no device: the log says why */
	void *ctx;
};

struct scheduler_stats {
	bool ready;
	size_t waiting, running;
	unsigned long completed; /* jobs done, failed ones too */
	unsigned long points;    /* evaluated since the start */
	size_t table_bytes, table_bytes_most;
	struct device_info device; /* zeroed until open */
};

/* Starts the device thread, which opens the device. ERR_MEMORY, ERR_IO. */
enum err scheduler_create(const struct scheduler_options *options,
    struct scheduler **out);

/*
 * Queues job. ERR_BUSY: the queue is full; ERR_CANCELLED: draining;
 * ERR_MEMORY. Either way nothing of job's has been called.
 */
enum err scheduler_submit(struct scheduler *s, struct job *job);

/* Gives up one reference to program (server/program.h). */
void scheduler_release(struct scheduler *s, struct program *program);

/* Wakes the device thread to look at the tables again. */
void scheduler_tables_changed(struct scheduler *s);

/* Refuses new jobs from now on. */
void scheduler_drain(struct scheduler *s);

/* Whether no job waits or runs. */
bool scheduler_is_idle(struct scheduler *s);

/*
 * Completes what is left with ERR_CANCELLED, closes the device and ends its
 * thread. scheduler_release remains valid.
 */
void scheduler_stop(struct scheduler *s);

/* After scheduler_stop, and once no program is held. NULL does nothing. */
void scheduler_free(struct scheduler *s);

void scheduler_get_stats(struct scheduler *s, struct scheduler_stats *out);

#endif
