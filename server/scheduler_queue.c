/*
 * A job that the device thread has taken in and that is not being run lies in
 * two lists: that of all, by age, and, by turn, that of its program, that of
 * bulk jobs, or that of stalled ones. The lists are the device thread's own, so
 * that clients are asked after, a system call each, with no lock held.
 *
 * Who completes: scheduler_queue_finish(), called by the device thread alone,
 * for jobs that lie in no list from then on; so each is completed exactly once.
 */
#include "server/scheduler_internal.h"

#include <math.h>
#include <stdint.h>
#include <stdlib.h>

#include "core/output.h"
#include "server/clock.h"
#include "server/program.h"

/* Clients looked after in one sweep, and seconds between sweeps: 0.5 % of the
 * time at 0.4 us each, and 1,000 of them are seen to in 80 ms. */
#define SWEEP_JOBS 64
#define SWEEP_SECONDS 0.005

/* ---- lists ---- */

static void append(struct job_list *list, enum job_order order,
    struct job *job)
{
	job->links[order] = (struct job_link){.prev = list->last};
	*(list->last != NULL ? &list->last->links[order].next :
	    &list->first) = job;
	list->last = job;
}

static void detach(struct job_list *list, enum job_order order,
    struct job *job)
{
	struct job *prev = job->links[order].prev;
	struct job *next = job->links[order].next;

	*(prev != NULL ? &prev->links[order].next : &list->first) = next;
	*(next != NULL ? &next->links[order].prev : &list->last) = prev;
	job->links[order] = (struct job_link){0};
}

static void append_program(struct program_list *list, struct program *p)
{
	p->turn_next = NULL;
	p->turn_prev = list->last;
	*(list->last != NULL ? &list->last->turn_next : &list->first) = p;
	list->last = p;
}

static void detach_program(struct program_list *list, struct program *p)
{
	*(p->turn_prev != NULL ? &p->turn_prev->turn_next : &list->first) =
	    p->turn_next;
	*(p->turn_next != NULL ? &p->turn_next->turn_prev : &list->last) =
	    p->turn_prev;
	p->turn_prev = p->turn_next = NULL;
}

/* The list that job takes its turn in. */
static struct job_list *turn_list(struct scheduler *s, struct job *job)
{
	if (job->is_stalled)
		return &s->stalled;
	return job->priority == JOB_BULK ? &s->bulk : &job->program->jobs;
}

static void add_turn(struct scheduler *s, struct job *job)
{
	struct job_list *list = turn_list(s, job);

	if (list->first == NULL && list == &job->program->jobs)
		append_program(&s->programs, job->program);
	append(list, JOB_BY_TURN, job);
}

static void remove_turn(struct scheduler *s, struct job *job)
{
	struct job_list *list = turn_list(s, job);

	detach(list, JOB_BY_TURN, job);
	if (list->first == NULL && list == &job->program->jobs)
		detach_program(&s->programs, job->program);
}

void scheduler_queue_init(struct scheduler *s)
{
	s->inbox_last = &s->inbox;
	s->deadline = INFINITY;
	s->interactive_at = -INFINITY;
}

bool scheduler_queue_is_small(const struct job *job)
{
	return job->priority == JOB_INTERACTIVE &&
	    job->count <= SCHEDULER_SMALL_POINTS;
}

size_t scheduler_queue_points_bytes(const struct job *job)
{
	return job->count * sizeof(float) * 3;
}

size_t scheduler_queue_answer_bytes(const struct job *job)
{
	size_t rows = job->count * sizeof(float) *
	    (size_t)output_row_floats(job->outputs);
	size_t most = SCHEDULER_PIECES * SCHEDULER_PIECE_BYTES;

	return job->text + (job->piece != NULL && rows > most ? most : rows);
}

void scheduler_queue_add(struct scheduler *s, struct job *job)
{
	append(&s->waiting, JOB_BY_AGE, job);
	s->waiting_count++;
	add_turn(s, job);
	if (job->deadline > 0.0 && job->deadline < s->deadline)
		s->deadline = job->deadline;
}

static void remove_job(struct scheduler *s, struct job *job)
{
	if (s->cursor == job)
		s->cursor = job->links[JOB_BY_AGE].next;
	detach(&s->waiting, JOB_BY_AGE, job);
	s->waiting_count--;
	remove_turn(s, job);
}

/* Whether job lies in the queue. */
static bool is_queued(const struct scheduler *s, const struct job *job)
{
	return job->links[JOB_BY_AGE].prev != NULL || s->waiting.first == job;
}

/* Has job lie in the list of those that are stalled, or of those that are not.
 * Who has not begun keeps its place among those that wait. */
static void set_stalled(struct scheduler *s, struct job *job, bool is_stalled)
{
	remove_turn(s, job);
	job->is_stalled = is_stalled;
	add_turn(s, job);
	if (!job->is_begun)
		return;
	pthread_mutex_lock(&s->lock);
	s->stats.stalled += is_stalled ? 1 : (size_t)-1;
	pthread_mutex_unlock(&s->lock);
}

void scheduler_queue_stall(struct scheduler *s, struct job *job)
{
	set_stalled(s, job, true);
	scheduler_tables_forget(s, job);
}

/* Those that still have no room stay where they are: were they to leave for a
 * moment, they would take places for it. */
static void end_stalls(struct scheduler *s)
{
	struct job *next;

	for (struct job *job = s->stalled.first; job != NULL; job = next) {
		next = job->links[JOB_BY_TURN].next;
		if (job->has_room(job->ctx))
			set_stalled(s, job, false);
	}
}

void scheduler_queue_rotate(struct scheduler *s, struct program *program)
{
	if (program->jobs.first == NULL || s->programs.last == program)
		return;
	detach_program(&s->programs, program);
	append_program(&s->programs, program);
}

/* ---- coming ---- */

static void admit(struct scheduler *s, struct job *job)
{
	struct job *next;

	for (; job != NULL; job = next) {
		next = job->next;
		job->next = NULL;
		scheduler_queue_add(s, job);
		if (job->priority == JOB_INTERACTIVE)
			s->interactive_at = clock_seconds();
	}
}

void scheduler_queue_gather(struct scheduler *s)
{
	struct job *list;
	bool continued;

	pthread_mutex_lock(&s->lock);
	list = s->inbox;
	s->inbox = NULL;
	s->inbox_last = &s->inbox;
	continued = s->continued;
	s->continued = false;
	s->changes += s->tables_changed;
	s->tables_changed = false;
	pthread_mutex_unlock(&s->lock);
	if (continued)
		end_stalls(s);
	admit(s, list);
}

/* ---- going ---- */

void scheduler_queue_take(struct scheduler *s, struct job *const *jobs,
    size_t count)
{
	pthread_mutex_lock(&s->lock);
	for (size_t i = 0; i < count; i++) {
		if (jobs[i]->is_begun)
			continue;
		s->stats.waiting--;
		s->stats.running++;
	}
	pthread_mutex_unlock(&s->lock);
	for (size_t i = 0; i < count; i++) {
		jobs[i]->is_begun = true;
		remove_job(s, jobs[i]);
		scheduler_tables_took(s, jobs[i]);
	}
}

/* Locked. */
static void count_completed(struct scheduler *s, const struct job *job)
{
	s->stats.completed++;
	s->stats.expired += job->result == ERR_DEADLINE;
	s->stats.abandoned += job->result == ERR_CANCELLED &&
	    !atomic_load(&s->cancel);
}

/* Takes job away from whatever else knows it. */
static void detach_all(struct scheduler *s, struct job *job)
{
	if (is_queued(s, job))
		remove_job(s, job);
	scheduler_tables_forget(s, job);
	if (job->result != ERR_OK) {
		free(job->rows);
		job->rows = NULL;
	}
	if (job->choice.count > 0)
		tables_unask(s->options.tables, job->choice.chosen,
		    job->choice.count);
	scheduler_tables_free_choice(job);
}

void scheduler_queue_finish(struct scheduler *s, struct job *const *jobs,
    size_t count)
{
	size_t bytes[2] = {0, 0}, begun = 0, stalled = 0;

	for (size_t i = 0; i < count; i++) {
		bytes[scheduler_queue_is_small(jobs[i])] +=
		    scheduler_queue_points_bytes(jobs[i]);
		begun += jobs[i]->is_begun;
		stalled += jobs[i]->is_begun && jobs[i]->is_stalled;
		detach_all(s, jobs[i]);
	}
	pthread_mutex_lock(&s->lock);
	for (size_t i = 0; i < count; i++)
		count_completed(s, jobs[i]);
	pthread_mutex_unlock(&s->lock);
	for (size_t i = 0; i < count; i++)
		jobs[i]->done(jobs[i]->ctx);
	pthread_mutex_lock(&s->lock);
	s->bytes[false] -= bytes[false];
	s->bytes[true] -= bytes[true];
	s->stats.stalled -= stalled;
	s->stats.running -= begun;
	s->stats.waiting -= count - begun;
	pthread_mutex_unlock(&s->lock);
}

void scheduler_queue_end(struct scheduler *s, struct job *job, enum err err)
{
	job->result = err;
	scheduler_queue_finish(s, &job, 1);
}

enum err scheduler_queue_check(const struct job *job)
{
	if (job->deadline > 0.0 && clock_seconds() >= job->deadline)
		return ERR_DEADLINE;
	if (job->seconds_most > 0.0 && job->seconds >= job->seconds_most)
		return ERR_OVERTIME;
	return job->wanted(job->ctx) ? ERR_OK : ERR_CANCELLED;
}

/* ---- sweeping ---- */

/* Completes jobs past their deadline, and finds the next one. */
static void expire(struct scheduler *s, double now)
{
	struct job *next;

	s->deadline = INFINITY;
	for (struct job *job = s->waiting.first; job != NULL; job = next) {
		next = job->links[JOB_BY_AGE].next;
		if (job->deadline <= 0.0)
			continue;
		if (job->deadline <= now)
			scheduler_queue_end(s, job, ERR_DEADLINE);
		else
			s->deadline = fmin(s->deadline, job->deadline);
	}
}

/* Looks after the clients of count jobs, those that come after the last. */
static void drop_unwanted(struct scheduler *s, size_t count)
{
	for (; count > 0 && s->waiting.first != NULL; count--) {
		struct job *job = s->cursor;

		if (job == NULL)
			job = s->waiting.first;
		s->cursor = job->links[JOB_BY_AGE].next;
		if (!job->wanted(job->ctx))
			scheduler_queue_end(s, job, ERR_CANCELLED);
	}
}

void scheduler_queue_sweep(struct scheduler *s, bool all)
{
	double now = clock_seconds();
	size_t count;

	if (now >= s->deadline)
		expire(s, now);
	if (!all && now - s->swept < SWEEP_SECONDS)
		return;
	s->swept = now;
	count = s->waiting_count;
	if (!all && count > SWEEP_JOBS)
		count = SWEEP_JOBS;
	drop_unwanted(s, count);
}
