/*
 * Whose turn it is, and launches.
 *
 * Turns: programs with interactive jobs go round; what a client floods one
 * program with goes in few launches, and others pass between them. Bulk jobs go
 * round, a piece each. While bulk jobs wait, each second of interactive
 * launches gives them a quarter of one in credit, and a piece is due when there
 * is enough for it: one part in five of the device's time is theirs.
 *
 * Pieces: as many points as take PIECE_SHORT at the program's pace (server/
 * pace.h), PIECE_LONG where no interactive job has come by lately; more where
 * they hardly take longer, for the more points are sorted together, the more of
 * a long tape can be left out.
 */
#include "server/scheduler_internal.h"

#include <math.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>

#include "core/output.h"
#include "core/tape.h"
#include "server/clock.h"
#include "server/log.h"
#include "server/pace.h"
#include "server/program.h"

/* Seconds on the device: what an interactive job may have to wait for. A launch
 * costs 12 to 25 us, 0.4 % of it. */
#define PIECE_SHORT 0.006
#define PIECE_LONG 0.02
#define PIECE_LONGEST 0.1

/* Seconds since the last interactive job, after which none is expected. */
#define QUIET 1.0

/* Of a piece of a program whose pace is not known: points at most, and
 * instructions times points. */
#define PIECE_FIRST ((size_t)65536)
#define PIECE_WORK ((size_t)16777216)

/* Instructions of a tape of which larger pieces leave out more: 1,000
 * primitives under camel gain 2 times from 4,096 points to 65,536, 100 hardly
 * anything. */
#define PIECE_LONG_TAPE 512

/* Jobs looked at for one batch: most of those that fit no more are seen. */
#define BATCH_LOOKS 1024

static size_t min_size(size_t a, size_t b)
{
	return a < b ? a : b;
}

/* ---- pace ---- */

static struct pace *pace_of(const struct job *job)
{
	return &job->program->pace[output_order(job->outputs)];
}

static bool is_long(const struct job *job)
{
	return job->program->tape->insn_count > PIECE_LONG_TAPE;
}

/* Points of job's program that take about so many seconds, or of a long tape up
 * to `longest` if it gains by that. */
static size_t points_in(const struct job *job, double seconds, double longest)
{
	size_t insns = job->program->tape->insn_count;

	return pace_points(pace_of(job), seconds,
	    is_long(job) ? longest : 0.0,
	    min_size(PIECE_FIRST, PIECE_WORK / (insns + 1)));
}

/* Points of a piece whose rows the submitter takes over: its memory is not to
 * grow with the device's speed. */
static size_t piece_room(const struct job *job)
{
	size_t n = SCHEDULER_PIECE_BYTES / (sizeof(float) *
	    (size_t)output_row_floats(job->outputs));

	return n - n % PACE_LEAST;
}

/* Points of job's next piece. */
static size_t piece_points(const struct scheduler *s, const struct job *job)
{
	size_t left = job->count - job->finished, most;
	bool is_quiet = job->priority == JOB_BULK &&
	    clock_seconds() - s->interactive_at > QUIET;

	most = is_quiet ? points_in(job, PIECE_LONG, PIECE_LONGEST) :
	    points_in(job, PIECE_SHORT, PIECE_LONG);
	/* Rather one that is a little longer than a short one after it. */
	if (left <= most + most / 8)
		most = left;
	return job->piece != NULL ? min_size(most, piece_room(job)) : most;
}

/* ---- whose turn it is ---- */

/*
 * Whether job can be completed now, in *ready, and if that is without running
 * it, why.
 */
static enum err check(struct scheduler *s, struct job *job, bool *ready)
{
	enum err err = ERR_LIMIT;

	*ready = true;
	if (!job->is_too_large)
		err = scheduler_tables_check(s, job, ready);
	if (err == ERR_OK && *ready)
		err = scheduler_queue_check(job);
	return err;
}

static bool has_room(const struct job *job)
{
	return job->has_room == NULL || job->has_room(job->ctx);
}

/* The first of list that can be run, or completed with *err. */
static struct job *first_able(struct scheduler *s, struct job_list *list,
    enum err *err)
{
	struct job *next;

	for (struct job *job = list->first; job != NULL; job = next) {
		bool ready;

		next = job->links[JOB_BY_TURN].next;
		*err = check(s, job, &ready);
		if (*err != ERR_OK || (ready && has_room(job)))
			return job;
		if (ready)
			scheduler_queue_stall(s, job);
	}
	return NULL;
}

static struct job *next_interactive(struct scheduler *s, enum err *err)
{
	struct job *job = NULL;
	struct program *next;

	for (struct program *p = s->programs.first; p != NULL && job == NULL;
	    p = next) {
		next = p->turn_next;
		job = first_able(s, &p->jobs, err);
	}
	return job;
}

/* What a piece of a bulk job costs: as much as the last one. */
static double piece_credit(const struct scheduler *s)
{
	return fmax(s->bulk_seconds, PIECE_SHORT);
}

static struct job *next_job(struct scheduler *s, enum err *err)
{
	struct job *job;

	if (s->credit >= piece_credit(s)) {
		job = first_able(s, &s->bulk, err);
		if (job != NULL)
			return job;
		s->credit = 0.0;
	}
	job = next_interactive(s, err);
	return job != NULL ? job : first_able(s, &s->bulk, err);
}

/* Interactive launches earn bulk jobs that wait their share, a piece at a time;
 * what these get beyond it is not held against them. */
static void account(struct scheduler *s, enum job_priority priority,
    double seconds)
{
	if (priority == JOB_BULK) {
		s->credit = fmax(s->credit - seconds, 0.0);
		s->bulk_seconds = seconds;
	} else if (s->bulk.first != NULL) {
		s->credit = fmin(s->credit + seconds /
		    (SCHEDULER_BULK_SHARE - 1), piece_credit(s));
	}
}

/* ---- launches ---- */

static bool go_on(void *ctx)
{
	struct job *job = ctx;
	struct scheduler *s = job->scheduler;

	/* It has not hung yet. */
	scheduler_device_begin(s);
	scheduler_queue_gather(s);
	scheduler_queue_sweep(s, false);
	return !atomic_load(&s->cancel) && job->wanted(job->ctx);
}

/* After a launch that succeeded, of points of count jobs. */
static void note_launch(struct scheduler *s, struct job *const *jobs,
    size_t count, size_t points, double seconds)
{
	enum job_priority priority = jobs[0]->priority;

	pace_learn(pace_of(jobs[0]), points, seconds, is_long(jobs[0]));
	account(s, priority, seconds);
	pthread_mutex_lock(&s->lock);
	s->stats.launches++;
	s->stats.launched += count;
	s->stats.batched += count > 1 ? count : 0;
	s->stats.points += points;
	s->stats.seconds[priority] += seconds;
	pthread_mutex_unlock(&s->lock);
}

/* Says in job what a failure of the device was. */
static void explain_device(const struct scheduler *s, struct job *job,
    enum err err)
{
	if (err == ERR_DEVICE || err == ERR_DEVICE_MEMORY)
		snprintf(job->message, sizeof job->message, "%s",
		    device_message(s->device));
}

static void log_failure(const struct scheduler *s, enum err err)
{
	if (err == ERR_DEVICE || err == ERR_DEVICE_MEMORY)
		log_write(LOG_ERROR, "evaluation: %s: %s", err_message(err),
		    device_message(s->device));
}

/* Room for count rows of job; NULL: none. One byte more: an empty batch is no
 * failure to allocate. */
static float *make_rows(const struct job *job, size_t count)
{
	return malloc(count * sizeof(float) *
	    (size_t)output_row_floats(job->outputs) + 1);
}

/* Where the rows of job's next piece, count of them, go; NULL: no memory. */
static float *piece_rows(struct job *job, size_t count)
{
	size_t stride = (size_t)output_row_floats(job->outputs);

	if (job->piece != NULL)
		return make_rows(job, count);
	if (job->rows == NULL)
		job->rows = make_rows(job, job->count);
	return job->rows == NULL ? NULL : job->rows + job->finished * stride;
}

/* Hands over the rows of a piece, or frees them. */
static void deliver(struct job *job, float *rows, size_t count, enum err err)
{
	if (err == ERR_OK && count > 0)
		job->piece(job->ctx, rows, job->finished, count);
	else
		free(rows);
}

/* What a launch took: loading its program, and its parts' evaluation. */
struct launch {
	double begun, loaded, seconds; /* clock_seconds; its evaluation's */
	size_t points;
};

/* Adds to job what its share of a launch that succeeded went to. */
static void add_times(const struct scheduler *s, struct job *job,
    const struct launch *l, double share)
{
	const struct device_times *times = device_get_times(s->device);

	if (job->begun == 0.0)
		job->begun = l->begun;
	job->times.upload += share * (times->upload + l->loaded - l->begun);
	job->times.kernel += share * times->kernel;
	job->times.download += share * times->download;
}

/* Of a job whose program is loaded; once more where others' copies took the
 * device's memory. */
static enum err evaluate(struct scheduler *s, struct job *job, size_t count,
    float *rows)
{
	enum err err;

	do
		err = device_evaluate(s->device, job->program->loaded,
		    job->points + 3 * job->finished, count, job->outputs, rows,
		    go_on, job);
	while (err == ERR_DEVICE_MEMORY &&
	    scheduler_tables_unload_others(s, job->program));
	return err;
}

/* The same of the first n of s->parts. */
static enum err evaluate_parts(struct scheduler *s, struct program *program,
    size_t n, unsigned outputs)
{
	enum err err;

	do
		err = device_evaluate_parts(s->device, program->loaded,
		    s->parts, n, outputs);
	while (err == ERR_DEVICE_MEMORY &&
	    scheduler_tables_unload_others(s, program));
	return err;
}

/* Of a job that has been taken. */
static enum err run_piece(struct scheduler *s, struct job *job, size_t count)
{
	struct launch l = {.begun = clock_seconds(), .points = count};
	enum err err = scheduler_tables_load(s, job);
	float *rows = NULL;

	if (err == ERR_OK) {
		rows = piece_rows(job, count);
		err = rows == NULL ? ERR_MEMORY : ERR_OK;
	}
	l.loaded = clock_seconds();
	if (err == ERR_OK)
		err = evaluate(s, job, count, rows);
	l.seconds = clock_seconds() - l.loaded;
	job->seconds += l.seconds;
	explain_device(s, job, err);
	log_failure(s, err);
	if (err == ERR_OK) {
		note_launch(s, &job, 1, count, l.seconds);
		add_times(s, job, &l, 1.0);
	}
	if (job->piece != NULL)
		deliver(job, rows, count, err);
	return err;
}

/* Runs job's next piece; the last one completes it. */
static void serve_alone(struct scheduler *s, struct job *job)
{
	size_t count = piece_points(s, job);
	enum err err;

	scheduler_queue_take(s, &job, 1);
	scheduler_queue_rotate(s, job->program);
	if (job->finished == 0)
		scheduler_tables_settle(job);
	scheduler_device_begin(s);
	err = run_piece(s, job, count);
	scheduler_device_end(s);
	if (err == ERR_OK)
		job->finished += count;
	if (err != ERR_OK || job->finished == job->count)
		scheduler_queue_end(s, job, err);
	else
		scheduler_queue_add(s, job);
	scheduler_device_check(s, err);
}

/* Whether job can go with first, which has been found able to go. */
static bool can_join(struct scheduler *s, const struct job *first,
    struct job *job, size_t room)
{
	bool ready = false;

	return job->outputs == first->outputs && job->count > 0 &&
	    job->count <= room && !job->is_begun && !job->is_too_large &&
	    scheduler_tables_check(s, job, &ready) == ERR_OK && ready &&
	    scheduler_tables_agree(first, job) && has_room(job);
}

/* Collects in s->batch what can go with first; how many. Completes those that
 * would, but that nobody waits for any more. */
static size_t collect(struct scheduler *s, struct job *first)
{
	size_t room = min_size(DEVICE_PARTS_POINTS,
	    points_in(first, PIECE_SHORT, PIECE_LONG)), n = 1;
	struct job *job = first->program->jobs.first, *next;

	s->batch[0] = first;
	if (first->priority != JOB_INTERACTIVE || first->is_begun ||
	    first->count == 0 || first->count > room)
		return 1;
	room -= first->count;
	for (size_t looks = 0; job != NULL && n < SCHEDULER_BATCH_MAX &&
	    room > 0 && looks < BATCH_LOOKS; job = next, looks++) {
		enum err err;

		next = job->links[JOB_BY_TURN].next;
		if (job == first || !can_join(s, first, job, room))
			continue;
		err = scheduler_queue_check(job);
		if (err != ERR_OK) {
			scheduler_queue_end(s, job, err);
			continue;
		}
		s->batch[n++] = job;
		room -= job->count;
	}
	return n;
}

/* Makes parts of the jobs in s->batch, those that there is memory for; how
 * many. */
static size_t make_parts(struct scheduler *s, size_t count)
{
	size_t n = 0;

	for (size_t i = 0; i < count; i++) {
		struct job *job = s->batch[i];

		job->rows = make_rows(job, job->count);
		job->result = job->rows != NULL ? ERR_OK : ERR_MEMORY;
		if (job->rows != NULL)
			s->parts[n++] = (struct device_part){job->points,
				job->count, job->rows};
	}
	return n;
}

/* The batch has been launched, with the result err. */
static void share_out(struct scheduler *s, size_t count,
    const struct launch *l, enum err err)
{
	for (size_t i = 0; i < count; i++) {
		struct job *job = s->batch[i];
		double share = (double)job->count / (double)l->points;

		if (job->result != ERR_OK)
			continue;
		job->result = err;
		job->seconds = l->seconds * share;
		if (err == ERR_OK)
			add_times(s, job, l, share);
		explain_device(s, job, err);
		if (job->piece == NULL)
			continue;
		deliver(job, job->rows, job->count, err);
		job->rows = NULL;
	}
}

/* Runs and completes the count jobs in s->batch. */
static void serve_together(struct scheduler *s, size_t count)
{
	struct job *first = s->batch[0];
	struct launch l = {.begun = clock_seconds()};
	size_t n;
	enum err err;

	scheduler_queue_take(s, s->batch, count);
	scheduler_queue_rotate(s, first->program);
	for (size_t i = 0; i < count; i++)
		scheduler_tables_settle(s->batch[i]);
	scheduler_device_begin(s);
	err = scheduler_tables_load(s, first);
	n = make_parts(s, count);
	for (size_t i = 0; i < n; i++)
		l.points += s->parts[i].count;
	l.loaded = clock_seconds();
	if (err == ERR_OK && n > 0)
		err = evaluate_parts(s, first->program, n, first->outputs);
	l.seconds = clock_seconds() - l.loaded;
	scheduler_device_end(s);
	log_failure(s, err);
	if (err == ERR_OK && n > 0)
		note_launch(s, s->batch, n, l.points, l.seconds);
	share_out(s, count, &l, err);
	scheduler_queue_finish(s, s->batch, count);
	scheduler_device_check(s, err);
}

/* Says in job what err alone does not, where no job can be run. */
static void explain(const struct scheduler *s, struct job *job)
{
	if (s->broken != ERR_OK || s->device == NULL)
		snprintf(job->message, sizeof job->message, "%.*s",
		    (int)sizeof job->message - 1, s->why);
	else if (job->is_too_large)
		snprintf(job->message, sizeof job->message, "its operator "
		    "tables together are larger than --table-memory");
}

void scheduler_run_fail_waiting(struct scheduler *s)
{
	struct job *next;

	for (struct job *job = s->waiting.first; job != NULL; job = next) {
		bool ready;
		enum err err = scheduler_tables_check(s, job, &ready);

		next = job->links[JOB_BY_AGE].next;
		if (err != ERR_OK)
			scheduler_queue_end(s, job, err);
	}
}

/* A job to be run, or, with *err, to be completed; or NULL. */
static struct job *choose(struct scheduler *s, enum err *err)
{
	*err = ERR_OK;
	if (s->broken != ERR_OK || scheduler_device_is_given_up(s))
		*err = ERR_DEVICE;
	else if (atomic_load(&s->cancel))
		*err = ERR_CANCELLED;
	if (*err != ERR_OK)
		return s->waiting.first;
	return s->device != NULL ? next_job(s, err) : NULL;
}

bool scheduler_run_next(struct scheduler *s)
{
	enum err err;
	struct job *job = choose(s, &err);
	size_t count;

	if (job == NULL)
		return false;
	if (err != ERR_OK) {
		explain(s, job);
		scheduler_queue_end(s, job, err);
		return true;
	}
	count = collect(s, job);
	if (count == 1)
		serve_alone(s, job);
	else
		serve_together(s, count);
	return true;
}
