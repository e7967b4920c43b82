/*
 * The device's thread and the bounded queue before it.
 *
 * Threads: the device thread owns struct device and all that is made from it.
 * HTTP threads submit jobs; each job is completed exactly once, by a call of
 * its done() on the device thread, after which the job is the submitter's
 * again.
 *
 * Order: small interactive jobs of one program that wait together go in one
 * launch. What is larger is cut into pieces of some milliseconds. Programs with
 * interactive jobs take turns, one launch each; so do bulk jobs, one piece
 * each, when no interactive job can go on. While bulk jobs could, at least one
 * part in SCHEDULER_BULK_SHARE of the device's time is theirs. Turns are jobs',
 * not clients': one client's N bulk jobs have N of them.
 *
 * Bounds: jobs that wait, or that have begun and could go on, are options.queue
 * at most, not counting one that runs. One whose client has no room for rows is
 * stalled and takes no place. The points of all jobs, until done(), and their
 * answers, until scheduler_return(), are 1 GiB at most; but a large job alone
 * always may. Interactive jobs of up to SCHEDULER_SMALL_POINTS are small: the
 * last quarter of the places is theirs alone, and 256 MiB more.
 *
 * A job whose operator tables are not resident waits for them while later ones,
 * whose are, go ahead; the one that was served longest ago has its tables
 * loaded before all others'. Where its operators allow drafts, it waits for
 * those only; the tables of its first piece serve all of it.
 *
 * A device that is lost is opened anew, for ever, and what was loaded loaded
 * again; jobs that it was busy with fail with ERR_DEVICE, others wait for it,
 * for 30 s, after which all fail so until it is back.
 */
#ifndef SERVER_SCHEDULER_H
#define SERVER_SCHEDULER_H

#include <stdbool.h>
#include <stddef.h>

#include "core/err.h"
#include "kernels/device.h"
#include "server/job_list.h"
#include "server/tables.h"

struct program;
struct scheduler;
struct tape;

/* Who goes first. Jobs of one priority take turns. */
enum job_priority {
	JOB_INTERACTIVE, /* somebody waits for it */
	JOB_BULK,        /* goes on when no interactive job can */
	JOB_PRIORITY_COUNT
};

/* What bulk jobs have of the device's time, at least, while interactive jobs
 * keep coming: one part in so many. */
#define SCHEDULER_BULK_SHARE 5

/* Interactive jobs of up to so many points are small. */
#define SCHEDULER_SMALL_POINTS 65536

/* Rows of a piece at most, in bytes; and how many pieces there may be at a
 * time: has_room() is to say no where a submitter has all of them. */
#define SCHEDULER_PIECE_BYTES ((size_t)2 << 20)
#define SCHEDULER_PIECES 3

/* One evaluation. Zeroed by the caller, then: */
struct job {
	/* set before scheduler_submit */
	struct program *program; /* the caller holds it until done() */
	const float *points;     /* 3 * count, the caller's until done() */
	size_t count;
	unsigned outputs;        /* OUTPUT_* */
	enum job_priority priority;
	double deadline;         /* clock_seconds; 0: none. ERR_DEADLINE if it
	                          * has not begun its last piece by then */
	double seconds_most;     /* of the device's time; 0: any. ERR_OVERTIME
	                          * if it has had them and needs more */
	/*
	 * NULL: the rows come whole, in `rows`. Else they come in pieces, from
	 * the first to the last, before done(): count > 0 rows, those from
	 * first on, malloc'd, now the submitter's; also where a later piece
	 * then fails. Device thread.
	 */
	void (*piece)(void *ctx, float *rows, size_t first, size_t count);
	/* Whether piece() may be called again yet; if not, the job waits until
	 * scheduler_continue. NULL: always. Device thread. */
	bool (*has_room)(void *ctx);
	void (*park)(void *ctx); /* accepted: called before all others may be */
	void (*done)(void *ctx); /* device thread */
	bool (*wanted)(void *ctx); /* device thread: is anybody still waiting?
	                            * Asked before each launch, and often. */
	void *ctx;
	size_t text;             /* bytes of its answer beside the rows */
	/* set before done() */
	enum err result;
	char message[256];       /* of a failure, for a person; or "" */
	bool is_draft;           /* ... with drafts of operator tables */
	float *rows;             /* malloc'd, the submitter's; or NULL */
	double seconds;          /* on the device; of a launch shared with
	                          * others, its share by points */
	struct device_times times; /* what they went to, and loading its tape */
	double begun;            /* clock_seconds; 0: it never has */
	/* the scheduler's own */
	struct job *next;        /* submitted after it */
	struct scheduler *scheduler;
	struct table_choice choice; /* of the program's tables and drafts */
	struct job_link links[JOB_ORDER_COUNT];
	size_t held;             /* bytes of its answer, for scheduler_return */
	size_t finished;         /* of count */
	bool is_begun;           /* counted as running */
	bool is_stalled;         /* has_room() said no */
	unsigned long unready;   /* equals the scheduler's changes: so are its
	                          * tables */
	bool is_alone;           /* its tables have had all room once */
	bool is_too_large;       /* ... and it was not enough */
};

struct scheduler_options {
	struct device_options device;
	struct tables *tables;
	size_t queue;             /* jobs waiting at most, or begun but one */
	void (*ready)(void *ctx); /* device and built-in tables are there */
	void (*failed)(void *ctx); /* there is no device: the log says why */
	/* A lost device has been opened anew, device thread; or NULL. */
	void (*rebuilt)(void *ctx);
	void *ctx;
	double patience; /* seconds that jobs wait for a lost device; 0: 30 */
	double hang;     /* after so many a launch hangs; 0: 60 */
};

struct scheduler_stats {
	bool ready;              /* and neither lost nor hanging */
	size_t waiting;          /* jobs not begun */
	size_t running;          /* jobs begun: between their pieces, too */
	size_t stalled;          /* those of them whose clients have no room */
	size_t held_bytes;       /* of points and answers */
	/* since the start: */
	unsigned long completed; /* jobs done, failed ones too */
	unsigned long points;    /* evaluated */
	unsigned long launches;  /* of one piece, or of several jobs */
	unsigned long launched;  /* jobs in them, all told */
	unsigned long batched;   /* jobs that shared theirs with others */
	unsigned long expired;   /* jobs past their deadline */
	unsigned long abandoned; /* jobs whose clients had gone */
	unsigned long rebuilds;  /* of a device that was lost */
	double seconds[JOB_PRIORITY_COUNT]; /* of the device's time */
	size_t table_bytes, table_bytes_most;
	double busy_since;       /* clock_seconds when the device last began
	                          * something, which goes on; 0: it is idle */
	struct device_info device; /* zeroed until open */
};

/* Starts the device thread, which opens the device. ERR_MEMORY, ERR_IO. */
enum err scheduler_create(const struct scheduler_options *options,
    struct scheduler **out);

/*
 * Queues job. ERR_BUSY: the queue is full, or there is no room for its points
 * and its answer; ERR_CANCELLED: draining; ERR_MEMORY. Either way nothing of
 * job's has been called.
 */
enum err scheduler_submit(struct scheduler *s, struct job *job);

/*
 * The answer of job, which has been completed, has left: its rows are freed.
 * Any thread. Does nothing the second time, nor where job was refused.
 */
void scheduler_return(struct scheduler *s, struct job *job);

/* A job whose has_room() said no has room again; any thread. */
void scheduler_continue(struct scheduler *s);

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
 * thread. scheduler_release and scheduler_return remain valid.
 */
void scheduler_stop(struct scheduler *s);

/* After scheduler_stop, and once no program is held. NULL does nothing. */
void scheduler_free(struct scheduler *s);

void scheduler_get_stats(struct scheduler *s, struct scheduler_stats *out);

/* False while a launch hangs, which is logged once: nothing can end it but the
 * process's end. To be called every few seconds. */
bool scheduler_watch(struct scheduler *s);

#endif
