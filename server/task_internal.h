/*
 * A task between its request and its answer: shared by task.c, which has HTTP's
 * side of it, task_pool.c, which has the threads, and task_sampler.c, which has
 * the device's.
 *
 * Threads: two hold it, the exchange until it is over and the pool until the
 * work has ended or been given up; the last to let go frees it. What is not
 * guarded is the pool's until task_end, HTTP's from then on. Lock order: the
 * pool's before a task's, and a task's before libmicrohttpd's. The device
 * thread takes a task's alone.
 */
#ifndef SERVER_TASK_INTERNAL_H
#define SERVER_TASK_INTERNAL_H

#include <pthread.h>
#include <stdatomic.h>
#include <stdbool.h>
#include <stddef.h>

#include "core/sampler.h"
#include "proto/fault.h"
#include "kernels/device.h"
#include "server/etag.h"
#include "server/task.h"
#include "server/turns.h"

/* Room for the name of a stage. */
#define TASK_STAGE_MAX 24

struct task {
	struct sampler sampler;  /* the first member: see task_of_sampler */
	struct tasks *pool;
	struct server *server;
	const struct task_kind *kind;
	void *ctx;
	struct scene *scene;     /* a reference */
	const struct token *payer; /* whose the points are, or NULL; held */
	char token[TASK_TOKEN_MAX + 1]; /* "": none */
	double begun;            /* when the request's head came */
	double deadline;         /* clock_seconds; 0: none */
	double queued, started, finished;
	double thread_started;   /* clock_thread_seconds of its thread then */
	double own_seconds;      /* the most that task_time_left has seen */
	atomic_int holders;

	enum err result;
	struct faults faults;
	char message[256];       /* of a device's failure, or "" */

	double device_seconds;
	struct device_times times; /* what they went to */
	double queue_seconds;    /* of its evaluations, before the device */
	bool is_draft;           /* some values are of drafts of tables */
	double from, to;         /* what the sampler is told is this part */
	double asked;            /* when its client was last looked for */

	size_t held;             /* bytes that count; the pool's lock */
	bool is_queued;          /* has been */
	bool is_small;           /* for the thread of small ones, too */
	struct turn turn;        /* while it waits; the pool's lock */
	struct task *next_vain;  /* the watch's */
	struct task *newer, *older; /* that live; the pool's lock */

	pthread_mutex_t lock;    /* guards: */
	struct exchange *x;      /* NULL: over */
	char stage[TASK_STAGE_MAX];
	double done;             /* of all of it, 0 to 1 */
};

/* task_sampler.c: makes task->sampler. */
void task_init_sampler(struct task *task);

/* Whether somebody waits for task. Any thread that holds it. */
bool task_is_wanted(struct task *task);

/* Why task is to be given up by now, or ERR_OK: ERR_DEADLINE, ERR_OVERTIME, or
 * ERR_CANCELLED. The thread that works on it, or, before, any that holds it. */
enum err task_verdict(struct task *task);

/* Seconds of --work-time that task, which has been started, has not had yet, 0 or
 * less: it has; infinite where there is no such limit. What counts is its thread's
 * processor time and its launches' on the device, not what it waits for. Its
 * thread. */
double task_time_left(struct task *task);

/* Has the exchange answer: once, after which task may be gone. */
void task_end(struct task *task, enum err result);

/* task_pool.c: queues it and has its exchange wait. ERR_BUSY; ERR_CANCELLED:
 * draining. */
enum err task_submit(struct task *task);

/* From now on task has so many bytes. Once it has been queued. */
void task_holds(struct task *task, size_t bytes);

/* Whether the pool gives everything up. */
bool task_pool_is_stopping(const struct tasks *t);

#endif
