/*
 * A task's sampler: evaluations by the scheduler, one job at a time.
 */
#include <math.h>
#include <stdlib.h>
#include <string.h>
#include <time.h>

#include "core/output.h"
#include "server/access.h"
#include "server/clock.h"
#include "server/program.h"
#include "server/scene_store.h"
#include "server/scheduler.h"
#include "server/server.h"
#include "server/task_internal.h"

/* Points of a job at most: 72 MiB of rows with all outputs. */
#define JOB_POINTS ((size_t)1 << 20)

/* How long to wait before a full queue is asked again, seconds. */
#define RETRY_SECONDS 4e-3

/* How seldom a client is looked for, seconds: it takes a system call. */
#define LOOK_SECONDS 5e-3

/* A job, and the thread that waits for it. */
struct errand {
	struct job job;
	struct task *task;
	double submitted;     /* clock_seconds */
	pthread_mutex_t lock; /* guards: */
	pthread_cond_t over;
	bool is_over;
};

/* ---- the scheduler's calls ---- */

static void park(void *ctx)
{
	(void)ctx;
}

static bool wanted(void *ctx)
{
	const struct errand *e = ctx;

	return task_is_wanted(e->task);
}

static void done(void *ctx)
{
	struct errand *e = ctx;

	pthread_mutex_lock(&e->lock);
	e->is_over = true;
	pthread_cond_signal(&e->over);
	pthread_mutex_unlock(&e->lock);
}

/* ---- the task's thread ---- */

static void pause_for(double seconds)
{
	const struct timespec time = {0, (long)(1e9 * seconds)};

	nanosleep(&time, NULL);
}

/* Queues e's job, also where the queue is full, as long as it is wanted. */
static enum err submit(struct errand *e)
{
	struct scheduler *s = e->task->server->scheduler;
	enum err err;

	e->submitted = clock_seconds();
	while ((err = scheduler_submit(s, &e->job)) == ERR_BUSY) {
		err = task_verdict(e->task);
		if (err != ERR_OK)
			return err;
		pause_for(RETRY_SECONDS);
	}
	return err;
}

static void await(struct errand *e)
{
	pthread_mutex_lock(&e->lock);
	while (!e->is_over)
		pthread_cond_wait(&e->over, &e->lock);
	pthread_mutex_unlock(&e->lock);
}

/* What e's job, which has succeeded, has taken. */
static void add_times(const struct errand *e)
{
	const struct device_times *times = &e->job.times;
	struct task *task = e->task;

	task->times.upload += times->upload;
	task->times.kernel += times->kernel;
	task->times.download += times->download;
	if (e->job.begun > 0.0)
		task->queue_seconds += e->job.begun - e->submitted;
}

/* Takes the rows of e's job, which is over. */
static void take(struct errand *e, size_t row_bytes, float *rows)
{
	struct task *task = e->task;

	access_charge_points(task->payer, e->job.program, e->job.count);
	if (e->job.result == ERR_OK)
		memcpy(rows, e->job.rows, e->job.count * row_bytes);
	else if (e->job.message[0] != '\0')
		memcpy(task->message, e->job.message, sizeof task->message);
	task->device_seconds += e->job.seconds;
	if (e->job.result == ERR_OK)
		add_times(e);
	task->is_draft |= e->job.is_draft;
	free(e->job.rows);
	scheduler_return(task->server->scheduler, &e->job);
}

static enum err run(struct errand *e, size_t row_bytes, float *rows)
{
	enum err err;

	pthread_mutex_init(&e->lock, NULL);
	pthread_cond_init(&e->over, NULL);
	err = submit(e);
	if (err == ERR_OK) {
		await(e);
		take(e, row_bytes, rows);
		err = e->job.result;
	}
	pthread_cond_destroy(&e->over);
	pthread_mutex_destroy(&e->lock);
	return err;
}

static enum err sample(struct sampler *s, const float *points, size_t count,
    unsigned outputs, float *rows)
{
	struct task *task = (struct task *)s;
	const size_t columns = (size_t)output_row_floats(outputs);
	enum err err = ERR_OK;

	for (size_t first = 0; first < count && err == ERR_OK;
	    first += JOB_POINTS) {
		const size_t left = count - first;
		const size_t n = left < JOB_POINTS ? left : JOB_POINTS;
		const double seconds = task_time_left(task);
		struct errand e = {.task = task, .job = {
			.program = task->scene->program,
			.points = points + 3 * first,
			.count = n,
			.outputs = outputs,
			.priority = n <= SCHEDULER_SMALL_POINTS ?
			    JOB_INTERACTIVE : JOB_BULK,
			.deadline = task->deadline,
			.seconds_most = isfinite(seconds) ? seconds : 0.0,
			.park = park,
			.done = done,
			.wanted = wanted,
		}};

		e.job.ctx = &e;
		err = seconds <= 0.0 ? ERR_OVERTIME :
		    run(&e, columns * sizeof *rows, rows + columns * first);
	}
	return err;
}

/* Whether it is, as it was found not long ago. */
static bool is_wanted(struct task *task)
{
	const double now = clock_seconds();

	if (now - task->asked < LOOK_SECONDS)
		return true;
	task->asked = now;
	return task_verdict(task) == ERR_OK;
}

static bool go_on(struct sampler *s, const char *stage, double part)
{
	struct task *task = (struct task *)s;

	part = task->from + (task->to - task->from) * part;
	pthread_mutex_lock(&task->lock);
	strncpy(task->stage, stage, sizeof task->stage - 1);
	if (part > task->done)
		task->done = part < 1.0 ? part : 1.0;
	pthread_mutex_unlock(&task->lock);
	return is_wanted(task);
}

void task_set_part(struct task *task, double from, double to)
{
	task->from = from;
	task->to = to;
}

void task_init_sampler(struct task *task)
{
	task->sampler = (struct sampler){sample, go_on};
	task->to = 1.0;
}
