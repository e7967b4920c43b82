/*
 * What the scheduler's files share. Functions are the device thread's unless
 * they say otherwise.
 *
 * scheduler.c: threads, submitting, starting and stopping. scheduler_device.c:
 * the device, when it is lost and when it is back. scheduler_queue.c:
 * the jobs that wait, and how they leave. scheduler_run.c: whose turn it is,
 * and launches. scheduler_tables.c: what is resident on the device.
 */
#ifndef SERVER_SCHEDULER_INTERNAL_H
#define SERVER_SCHEDULER_INTERNAL_H

#include <pthread.h>
#include <stdatomic.h>
#include <stdbool.h>
#include <stddef.h>

#include "server/scheduler.h"

/* Jobs in one launch at most. */
#define SCHEDULER_BATCH_MAX 256

/* Programs with interactive jobs, in turn. */
struct program_list {
	struct program *first, *last;
};

struct scheduler {
	struct scheduler_options options;
	pthread_t thread;
	pthread_mutex_t lock; /* guards what follows up to cancel */
	pthread_cond_t wake;  /* the device thread: events has changed */
	unsigned long events; /* counts what the device thread should look at */
	struct job *inbox, **inbox_last; /* submitted, not looked at yet */
	size_t bytes[2];      /* of points and answers; [true]: of small jobs */
	struct program *dead;
	bool tables_changed;
	bool continued;       /* jobs may have room again */
	bool draining;
	bool stopping;
	bool stopped;         /* the device is closed */
	struct scheduler_stats stats;
	bool hang_logged;
	atomic_bool cancel;
	/* device thread only: */
	struct device *device;
	enum err broken;      /* why there is no device */
	char why[640];        /* the same, or why it is away, for people */
	unsigned long changes; /* counts what may have made tables ready, or
	                        * jobs choose others; from 1 */
	bool was_ready;
	/* scheduler_device.c */
	double lost_at;           /* clock_seconds */
	double reopen_at;         /* when to try */
	double pause;             /* before the attempt after that; 0: none */
	double loss_pause;        /* the same, after the next loss */
	int shortages;            /* failures in a row for want of memory */
	/* scheduler_queue.c */
	struct job_list waiting;  /* all, by age */
	size_t waiting_count;
	struct program_list programs;
	struct job_list bulk;     /* by turn */
	struct job_list stalled;
	struct job *cursor;       /* whose client is looked after next */
	double swept;             /* clock_seconds */
	double deadline;          /* none is earlier; or infinite */
	/* scheduler_run.c */
	double interactive_at;    /* when such a job last came */
	double credit;            /* seconds that bulk jobs are owed */
	double bulk_seconds;      /* of their last piece */
	struct job *batch[SCHEDULER_BATCH_MAX];
	struct device_part parts[SCHEDULER_BATCH_MAX];
	/* scheduler_tables.c */
	struct program *newest, *oldest; /* loaded programs */
	size_t loaded_bytes;
	struct job *head;         /* whose tables are reserved, or NULL */
	bool has_reserved;        /* some tables are reserved */
	unsigned long reserved;   /* changes then */
	double tenure;            /* until when the head stays; 0: until it
	                           * has run */
};

/* ---- scheduler_device.c ---- */

/* Opens the device for the first time; or tells of failure. */
void scheduler_device_open(struct scheduler *s);

/* There is no use in going on. */
void scheduler_device_break(struct scheduler *s, enum err err,
    const char *what, const char *message);

/* What has come of something that the device was asked for, when all that it
 * concerns has its result: closes a device that is lost. */
void scheduler_device_check(struct scheduler *s, enum err err);

/* Tries to open a lost device, if it is time to. Whether it is back. */
bool scheduler_device_reopen(struct scheduler *s);

/* Whether it has been away for longer than jobs wait. */
bool scheduler_device_is_given_up(const struct scheduler *s);

/* When to look after the device, or infinite. */
double scheduler_device_next_look(const struct scheduler *s);

/* The device is about to do something that is to end within the time of a
 * piece; it has ended. */
void scheduler_device_begin(struct scheduler *s);
void scheduler_device_end(struct scheduler *s);

/* Whether that takes too long. Any thread; locked. */
bool scheduler_device_hangs(const struct scheduler *s);

/* ---- scheduler_queue.c ---- */

void scheduler_queue_init(struct scheduler *s);

/* Whether job is one that places and bytes are kept for. Any thread. */
bool scheduler_queue_is_small(const struct job *job);

/* Bytes that count while job is not completed, and, the most that they may be,
 * while its answer has not left. Any thread. */
size_t scheduler_queue_points_bytes(const struct job *job);
size_t scheduler_queue_answer_bytes(const struct job *job);

/* Takes in what other threads have left. */
void scheduler_queue_gather(struct scheduler *s);

/* Puts job, which lies in no list, last in its turn. */
void scheduler_queue_add(struct scheduler *s, struct job *job);

/* Takes count jobs out of their lists, to be run. */
void scheduler_queue_take(struct scheduler *s, struct job *const *jobs,
    size_t count);

/* Has job, which lies in the queue, wait for scheduler_continue: it takes no
 * place there meanwhile. */
void scheduler_queue_stall(struct scheduler *s, struct job *job);

/* Has the next program's turn come. */
void scheduler_queue_rotate(struct scheduler *s, struct program *program);

/*
 * Completes jobs past their deadline, and those whose clients have hung up:
 * they take places in the queue and have tables built. Looks at few clients at
 * a time, unless all is set.
 */
void scheduler_queue_sweep(struct scheduler *s, bool all);

/*
 * Hands count jobs back, with their result set; those in the queue are taken
 * off it. Each may be gone as soon as its done() has been called; only then is
 * it no longer counted.
 */
void scheduler_queue_finish(struct scheduler *s, struct job *const *jobs,
    size_t count);

/* One job. */
void scheduler_queue_end(struct scheduler *s, struct job *job, enum err err);

/* Why job must not run: its deadline has passed, it has had its time, or nobody
 * waits for it. */
enum err scheduler_queue_check(const struct job *job);

/* ---- scheduler_run.c ---- */

/* Runs one launch, or completes a job otherwise; false: there is nothing to
 * do. */
bool scheduler_run_next(struct scheduler *s);

/* Completes the jobs that can do nothing but fail. */
void scheduler_run_fail_waiting(struct scheduler *s);

/* ---- scheduler_tables.c ---- */

/* Has job's program on the device, with the tables it has chosen. */
enum err scheduler_tables_load(struct scheduler *s, const struct job *job);

/* Drops what is loaded of p. */
void scheduler_tables_unload(struct scheduler *s, struct program *p);
void scheduler_tables_unload_all(struct scheduler *s);

/* Drops what is loaded of all others; false if there is nothing. */
bool scheduler_tables_unload_others(struct scheduler *s,
    const struct program *p);

/* Makes room for job's choice of tables; frees it. Any thread. ERR_MEMORY. */
enum err scheduler_tables_init_choice(struct job *job);
void scheduler_tables_free_choice(struct job *job);

/* Whether what job has chosen is resident, in *ready. The error of a table that
 * has failed. */
enum err scheduler_tables_check(struct scheduler *s, struct job *job,
    bool *ready);

/* Has all pieces of job use the tables that its first one does. */
void scheduler_tables_settle(struct job *job);

/* Whether two jobs of one program have chosen the same. */
bool scheduler_tables_agree(const struct job *a, const struct job *b);

/* That job is taken to run; and that it does not wait for its turn now. */
void scheduler_tables_took(struct scheduler *s, struct job *job);
void scheduler_tables_forget(struct scheduler *s, struct job *job);

/* Reserves what the job served longest ago needs. */
void scheduler_tables_reserve(struct scheduler *s);

/* Loads one built table, if there is one. Returns whether there was. */
bool scheduler_tables_load_next(struct scheduler *s);

/* Publishes how much the resident tables take. */
void scheduler_tables_publish(struct scheduler *s);

#endif
