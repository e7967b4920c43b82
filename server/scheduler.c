/*
 * Who owns: the device thread owns the device, every uploaded tape and slot,
 * the lists of waiting jobs and of loaded programs; the lock guards the inbox,
 * the list of dead programs and the published figures. It is never held while
 * the device works or a client is asked after, so that submitting is quick.
 */
#include "server/scheduler_internal.h"

#include <math.h>
#include <stdlib.h>
#include <time.h>

#include "server/clock.h"
#include "server/program.h"

/* Points and answers of all jobs in hand: more is refused as a full queue,
 * since memory that does not exist ends the process. And what small jobs have
 * beyond it. */
#define QUEUE_BYTES_MAX ((size_t)1 << 30)
#define SMALL_BYTES_MAX ((size_t)256 << 20)

/* A small job takes at most one part in so many of the room that is left, so
 * that the smallest ones pass for longest. 65,536 points with all outputs as
 * JSON need 20 MiB. */
#define SMALL_PART 8

/* One place in so many is kept for small jobs. */
#define SMALL_PLACES 4

/* Seconds between looks at which waiting clients are gone, at most. */
#define SWEEP_MOST 0.5

/* Gives up the lock and has the device thread look at what has changed: it is
 * woken without it, or it would run into it at once. */
static void unlock_and_wake(struct scheduler *s)
{
	s->events++;
	pthread_mutex_unlock(&s->lock);
	pthread_cond_signal(&s->wake);
}

/* ---- the device thread ---- */

static void bury_dead(struct scheduler *s)
{
	struct program *p, *next;

	pthread_mutex_lock(&s->lock);
	p = s->dead;
	s->dead = NULL;
	pthread_mutex_unlock(&s->lock);
	for (; p != NULL; p = next) {
		next = p->dead_next;
		scheduler_tables_unload(s, p);
		program_free(s->options.tables, p);
	}
}

/* Whether the built-in tables are there; or that they never will be, which is
 * the end, but not of a daemon that has been ready. */
static bool has_builtin(struct scheduler *s)
{
	bool ready = s->was_ready;
	enum err err = ready ? ERR_OK :
	    tables_check_builtin(s->options.tables, &ready);

	if (err != ERR_OK && !atomic_load(&s->cancel)) {
		scheduler_device_break(s, err, "built-in operator tables",
		    err == ERR_MEMORY ? "" : device_message(s->device));
		s->options.failed(s->options.ctx);
	}
	return err == ERR_OK && ready;
}

/* Publishes readiness; tells of it once. */
static void check_ready(struct scheduler *s)
{
	bool is_first = !s->was_ready;

	if (s->stats.ready || s->broken != ERR_OK || s->device == NULL ||
	    !has_builtin(s))
		return;
	s->was_ready = true;
	pthread_mutex_lock(&s->lock);
	s->stats.ready = true;
	pthread_mutex_unlock(&s->lock);
	if (is_first)
		s->options.ready(s->options.ctx);
}

/* When to look at waiting jobs though nothing has happened. */
static struct timespec next_look(const struct scheduler *s)
{
	double now = clock_seconds();
	double seconds = fmin(SWEEP_MOST, fmin(s->deadline,
	    scheduler_device_next_look(s)) - now);
	struct timespec until;

	clock_gettime(CLOCK_MONOTONIC, &until);
	/* Rather after a deadline than before it. */
	until.tv_nsec += (long)(1e9 * fmax(seconds, 0.0)) + 1000;
	until.tv_sec += until.tv_nsec / 1000000000;
	until.tv_nsec %= 1000000000;
	return until;
}

/* Waits for a signal of s->wake; not for ever while jobs wait, or the device is
 * away. False if none came in time. Locked. */
static bool await_wake(struct scheduler *s)
{
	struct timespec until;

	if (s->waiting.first == NULL &&
	    isinf(scheduler_device_next_look(s)))
		return pthread_cond_wait(&s->wake, &s->lock) == 0;
	until = next_look(s);
	return pthread_cond_timedwait(&s->wake, &s->lock, &until) == 0;
}

/* Waits until something happens after event, or it is time to look who still
 * waits; false once stopping. */
static bool await_event(struct scheduler *s, unsigned long *event)
{
	bool stopping, came = true;

	pthread_mutex_lock(&s->lock);
	while (s->events == *event && !s->stopping && came)
		came = await_wake(s);
	*event = s->events;
	stopping = s->stopping;
	pthread_mutex_unlock(&s->lock);
	if (!came)
		scheduler_queue_sweep(s, true);
	return !stopping;
}

/* Does what there is to do. */
static void work(struct scheduler *s)
{
	bool busy;

	do {
		scheduler_queue_gather(s);
		bury_dead(s);
		scheduler_queue_sweep(s, false);
		scheduler_tables_reserve(s);
		busy = scheduler_device_reopen(s);
		busy = scheduler_tables_load_next(s) || busy;
		check_ready(s);
		busy = scheduler_run_next(s) || busy;
	} while (busy);
}

static void *device_main(void *arg)
{
	struct scheduler *s = arg;
	unsigned long event = 0;

	scheduler_device_open(s);
	do
		work(s);
	while (await_event(s, &event));
	work(s); /* all jobs are cancelled, every one */
	scheduler_tables_unload_all(s);
	device_close(s->device);
	s->device = NULL;
	return NULL;
}

/* ---- other threads ---- */

static void init_wake(pthread_cond_t *wake)
{
	pthread_condattr_t attributes;

	pthread_condattr_init(&attributes);
	pthread_condattr_setclock(&attributes, CLOCK_MONOTONIC);
	pthread_cond_init(wake, &attributes);
	pthread_condattr_destroy(&attributes);
}

enum err scheduler_create(const struct scheduler_options *options,
    struct scheduler **out)
{
	struct scheduler *s = calloc(1, sizeof *s);

	if (s == NULL)
		return ERR_MEMORY;
	s->options = *options;
	s->changes = 1;
	scheduler_queue_init(s);
	pthread_mutex_init(&s->lock, NULL);
	init_wake(&s->wake);
	if (pthread_create(&s->thread, NULL, device_main, s) != 0) {
		s->stopped = true;
		scheduler_free(s);
		return ERR_IO;
	}
	*out = s;
	return ERR_OK;
}

/* Whether there is a place for one more. Locked. */
static bool has_place(const struct scheduler *s, bool is_small)
{
	size_t places = s->options.queue;
	size_t running = s->stats.running - s->stats.stalled;

	if (!is_small)
		places -= places / SMALL_PLACES;
	/* One that runs keeps none from waiting. */
	if (running > 0)
		running--;
	return s->stats.waiting + running < places;
}

/* Whether there is room for so many bytes more. Locked. */
static bool has_bytes(const struct scheduler *s, bool is_small, size_t bytes)
{
	size_t large = s->bytes[false], small = s->bytes[true];

	if (!is_small)
		return large == 0 || large + small + bytes <= QUEUE_BYTES_MAX;
	if (large > QUEUE_BYTES_MAX)
		large = QUEUE_BYTES_MAX;
	return large + small + SMALL_PART * bytes <=
	    QUEUE_BYTES_MAX + SMALL_BYTES_MAX;
}

/* Why a job of so many bytes is refused. Locked. */
static enum err refuse(const struct scheduler *s, bool is_small, size_t bytes)
{
	if (s->draining)
		return ERR_CANCELLED;
	return has_place(s, is_small) && has_bytes(s, is_small, bytes) ?
	    ERR_OK : ERR_BUSY;
}

enum err scheduler_submit(struct scheduler *s, struct job *job)
{
	bool is_small = scheduler_queue_is_small(job);
	size_t held = scheduler_queue_answer_bytes(job);
	size_t bytes = scheduler_queue_points_bytes(job) + held;
	enum err err = scheduler_tables_init_choice(job);

	if (err != ERR_OK)
		return err;
	pthread_mutex_lock(&s->lock);
	err = refuse(s, is_small, bytes);
	if (err == ERR_OK) {
		if (job->choice.count > 0)
			tables_choose(s->options.tables, &job->choice);
		job->scheduler = s;
		job->next = NULL;
		*s->inbox_last = job;
		s->inbox_last = &job->next;
		s->bytes[is_small] += bytes;
		job->held = held;
		s->stats.waiting++;
		job->park(job->ctx);
		unlock_and_wake(s);
		return ERR_OK;
	}
	pthread_mutex_unlock(&s->lock);
	scheduler_tables_free_choice(job);
	return err;
}

void scheduler_return(struct scheduler *s, struct job *job)
{
	if (job->held == 0)
		return;
	pthread_mutex_lock(&s->lock);
	s->bytes[scheduler_queue_is_small(job)] -= job->held;
	pthread_mutex_unlock(&s->lock);
	job->held = 0;
}

void scheduler_release(struct scheduler *s, struct program *program)
{
	bool stopped;

	if (atomic_fetch_sub(&program->refs, 1) != 1)
		return;
	pthread_mutex_lock(&s->lock);
	stopped = s->stopped;
	if (!stopped) {
		program->dead_next = s->dead;
		s->dead = program;
		unlock_and_wake(s);
		return;
	}
	pthread_mutex_unlock(&s->lock);
	program_free(s->options.tables, program);
}

void scheduler_continue(struct scheduler *s)
{
	pthread_mutex_lock(&s->lock);
	s->continued = true;
	unlock_and_wake(s);
}

void scheduler_tables_changed(struct scheduler *s)
{
	pthread_mutex_lock(&s->lock);
	s->tables_changed = true;
	unlock_and_wake(s);
}

void scheduler_drain(struct scheduler *s)
{
	pthread_mutex_lock(&s->lock);
	s->draining = true;
	pthread_mutex_unlock(&s->lock);
}

bool scheduler_is_idle(struct scheduler *s)
{
	bool idle;

	pthread_mutex_lock(&s->lock);
	idle = s->stats.waiting + s->stats.running == 0;
	pthread_mutex_unlock(&s->lock);
	return idle;
}

void scheduler_stop(struct scheduler *s)
{
	atomic_store(&s->cancel, true);
	pthread_mutex_lock(&s->lock);
	s->draining = true;
	s->stopping = true;
	unlock_and_wake(s);
	pthread_join(s->thread, NULL);
	pthread_mutex_lock(&s->lock);
	s->stopped = true;
	pthread_mutex_unlock(&s->lock);
	bury_dead(s);
}

void scheduler_free(struct scheduler *s)
{
	if (s == NULL)
		return;
	pthread_cond_destroy(&s->wake);
	pthread_mutex_destroy(&s->lock);
	free(s);
}

void scheduler_get_stats(struct scheduler *s, struct scheduler_stats *out)
{
	pthread_mutex_lock(&s->lock);
	*out = s->stats;
	out->ready = out->ready && !scheduler_device_hangs(s);
	out->held_bytes = s->bytes[false] + s->bytes[true];
	pthread_mutex_unlock(&s->lock);
}
