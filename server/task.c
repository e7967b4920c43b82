#include "server/task.h"

#include <math.h>
#include <stdarg.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "proto/number.h"
#include "server/access.h"
#include "server/clock.h"
#include "server/config.h"
#include "server/evaluation.h"
#include "server/exchange.h"
#include "server/metrics.h"
#include "server/program.h"
#include "server/scene_store.h"
#include "server/server.h"
#include "server/surface.h"
#include "server/task_internal.h"

/* ---- life ---- */

static void let_go(struct task *task)
{
	if (atomic_fetch_sub(&task->holders, 1) != 1)
		return;
	task->kind->free(task->ctx);
	if (task->is_queued)
		task_holds(task, 0);
	scene_release(task->scene);
	access_let_go(task->payer);
	pthread_mutex_destroy(&task->lock);
	free(task);
}

/* The exchange is over, perhaps before the work. */
static void leave(void *state, struct server *server)
{
	struct task *task = state;

	(void)server;
	pthread_mutex_lock(&task->lock);
	task->x = NULL;
	pthread_mutex_unlock(&task->lock);
	let_go(task);
}

double task_time_left(struct task *task)
{
	const size_t most = task->server->config->work_time;

	task->own_seconds = clock_thread_seconds() - task->thread_started +
	    task->device_seconds;
	return most > 0 ? (double)most - task->own_seconds : INFINITY;
}

bool task_is_wanted(struct task *task)
{
	bool is_wanted;

	if (task_pool_is_stopping(task->pool))
		return false;
	pthread_mutex_lock(&task->lock);
	is_wanted = task->x != NULL && exchange_is_connected(task->x);
	pthread_mutex_unlock(&task->lock);
	return is_wanted;
}

enum err task_verdict(struct task *task)
{
	if (task->deadline > 0.0 && clock_seconds() > task->deadline)
		return ERR_DEADLINE;
	if (task->started > 0.0 && task_time_left(task) <= 0.0)
		return ERR_OVERTIME;
	return task_is_wanted(task) ? ERR_OK : ERR_CANCELLED;
}

static size_t bytes_of(const struct task *task)
{
	return task->kind->bytes != NULL ? task->kind->bytes(task->ctx) : 0;
}

void task_end(struct task *task, enum err result)
{
	task->result = result;
	task->finished = clock_seconds();
	task_holds(task, bytes_of(task));
	pthread_mutex_lock(&task->lock);
	if (task->x != NULL)
		exchange_resume(task->x);
	pthread_mutex_unlock(&task->lock);
	let_go(task);
}

/* ---- the answer ---- */

static double run_seconds(const struct task *task)
{
	return task->started > 0.0 ? task->finished - task->started : 0.0;
}

static double wait_seconds(const struct task *task)
{
	return (task->started > 0.0 ? task->started : task->finished) -
	    task->queued;
}

static void reply_failure(struct exchange *x, const struct task *task)
{
	enum err err = task->result;

	if (err == ERR_CANCELLED && !exchange_is_connected(x))
		exchange_reply_nothing(x);
	else if (err == ERR_CANCELLED)
		exchange_reply_problem(x, PROBLEM_DRAINING, NULL,
		    "The server is shutting down; the work was given up.");
	else if (err == ERR_DEADLINE)
		exchange_reply_problem(x, PROBLEM_DEADLINE, NULL,
		    "The deadline was %.3f s after the request began; the "
		    "work waited %.3f s and ran for %.3f s.",
		    task->deadline - task->begun, wait_seconds(task),
		    run_seconds(task));
	else if (err == ERR_OVERTIME)
		exchange_reply_problem(x, PROBLEM_WORK_TIME, NULL,
		    "After %.3f s of its thread and the device the work was "
		    "given up; %zu s (--work-time) are the most. Ask for less "
		    "at a time, or of a smaller document.", task->own_seconds,
		    x->server->config->work_time);
	else if (task->faults.count > 0)
		evaluation_reply_faults(x, err, &task->faults);
	else
		exchange_reply_problem(x, problem_from_err(err), NULL,
		    "The work failed: %s%s%s.", err_message(err),
		    task->message[0] != '\0' ? ": " : "", task->message);
}

static void add_timing(struct exchange *x, const struct task *task)
{
	char text[120];

	snprintf(text, sizeof text, "queue;dur=%.3f, work;dur=%.3f, "
	    "device;dur=%.3f", 1e3 * wait_seconds(task),
	    1e3 * run_seconds(task), 1e3 * task->device_seconds);
	exchange_add_header(x, "Server-Timing", text);
}

/* What the work has taken, of a task that has asked the device. */
static void observe(const struct exchange *x, const struct task *task)
{
	struct metrics *m = x->server->metrics;

	metrics_observe(m, x, METRICS_QUEUE, wait_seconds(task) +
	    task->queue_seconds);
	if (task->device_seconds > 0.0)
		metrics_observe_device(m, x, &task->times);
}

static void answer(struct exchange *x)
{
	struct task *task = x->state;

	if (task->result != ERR_OK) {
		reply_failure(x, task);
	} else {
		observe(x, task);
		task->kind->answer(x, task->ctx);
		add_timing(x, task);
		if (task->is_draft)
			exchange_add_header(x, "Blobfield-Draft", "true");
	}
	exchange_add_header(x, "ETag", task->scene->etag);
}

/* ---- the beginning ---- */

static bool read_deadline(const char *value, double *out,
    struct faults *faults)
{
	const char *end, *at = value;

	*out = 0.0;
	if (value == NULL)
		return true;
	end = value + strlen(value);
	if (number_parse(&at, end, out) == 0 && at == end && *out > 0.0 &&
	    isfinite(*out))
		return true;
	faults_add(faults, "?deadline", "'%.60s' is no number of seconds "
	    "above 0", value);
	return false;
}

static bool read_token(const char *value, char out[static TASK_TOKEN_MAX + 1],
    struct faults *faults)
{
	if (value == NULL)
		return true;
	if (strlen(value) <= TASK_TOKEN_MAX && scene_id_is_valid(value)) {
		strcpy(out, value);
		return true;
	}
	faults_add(faults, "?progress", "must be 1 to %d of A-Z, a-z, 0-9, "
	    "'_', '.' and '-', and neither '.' nor '..'", TASK_TOKEN_MAX);
	return false;
}

/* Whether task's own query parameters are right; or answers x. */
static bool read_query(struct exchange *x, struct task *task)
{
	struct faults faults = {0};
	double seconds;
	bool is_right = read_deadline(exchange_query(x, "deadline"), &seconds,
	    &faults);

	is_right &= read_token(exchange_query(x, "progress"), task->token,
	    &faults);
	if (!is_right) {
		evaluation_reply_faults(x, ERR_INVALID, &faults);
		return false;
	}
	if (seconds > 0.0)
		task->deadline = x->begun + seconds;
	return true;
}

static void reply_refusal(struct exchange *x, enum err err)
{
	if (err == ERR_BUSY)
		exchange_reply_problem(x, PROBLEM_QUEUE_FULL, NULL,
		    "Requests for such work are waiting, %d at most and %d of "
		    "one client, or too much of their answers has not been "
		    "read yet; try again soon.", TASKS_WAITING,
		    TASKS_WAITING_OF_ONE);
	else if (err == ERR_DEADLINE)
		exchange_reply_problem(x, PROBLEM_DEADLINE, NULL,
		    "The deadline passed while the request arrived, which "
		    "took %.3f s.", clock_seconds() - x->begun);
	else if (err == ERR_MEMORY)
		exchange_reply_problem(x, PROBLEM_MEMORY, NULL,
		    "There was no memory for the work.");
	else
		exchange_reply_problem(x, PROBLEM_DRAINING, NULL,
		    "The server is shutting down and takes no new work.");
}

static struct task *create(struct exchange *x, struct scene *scene,
    const struct task_kind *kind, void *ctx)
{
	struct task *task = calloc(1, sizeof *task);

	if (task == NULL)
		return NULL;
	pthread_mutex_init(&task->lock, NULL);
	atomic_init(&task->holders, 1);
	task->pool = x->server->tasks;
	task->server = x->server;
	task->kind = kind;
	task->ctx = ctx;
	task->scene = scene;
	task->payer = access_keep(x);
	access_asker(x, task->turn.asker);
	task->begun = x->begun;
	task->x = x;
	strcpy(task->stage, "waiting");
	task_init_sampler(task);
	return task;
}

static enum err submit(struct task *task)
{
	enum err err;

	task->queued = clock_seconds();
	if (exchange_is_late(task->x))
		return ERR_CANCELLED;
	if (task->deadline > 0.0 && task->queued > task->deadline)
		return ERR_DEADLINE;
	atomic_fetch_add(&task->holders, 1);
	task->held = bytes_of(task);
	task->is_queued = true;
	task->is_small = task->kind->is_small != NULL &&
	    task->kind->is_small(task->ctx);
	err = task_submit(task);
	if (err == ERR_OK)
		return ERR_OK;
	task->held = 0;
	atomic_fetch_sub(&task->holders, 1);
	return err;
}

void task_begin(struct exchange *x, struct scene *scene,
    const struct task_kind *kind, void *ctx)
{
	struct task *task = create(x, scene, kind, ctx);
	enum err err;

	if (task == NULL) {
		kind->free(ctx);
		scene_release(scene);
		reply_refusal(x, ERR_MEMORY);
		return;
	}
	x->state = task;
	x->state_free = leave;
	x->resumed = answer;
	/* What it will evaluate is counted as it does: nothing is known yet. */
	if (!read_query(x, task) ||
	    !access_take_points(x, scene->program, 0))
		return;
	exchange_release_body(x);
	err = submit(task);
	if (err != ERR_OK)
		reply_refusal(x, err);
}

/* ---- for work() ---- */

const struct scene *task_scene(const struct task *task)
{
	return task->scene;
}

struct server *task_server(const struct task *task)
{
	return task->server;
}

struct sampler *task_sampler(struct task *task)
{
	return &task->sampler;
}

enum err task_ranges(struct task *task, const struct range_tape **out)
{
	return surface_ranges(task->scene->program->surface, out);
}

enum err task_extent(struct task *task, double iso, struct tape_box *out)
{
	return surface_extent(task->scene->program->surface, iso,
	    &task->sampler, out);
}

void task_fault(struct task *task, const char *pointer, const char *detail,
    ...)
{
	char text[FAULT_DETAIL_MAX];
	va_list args;

	va_start(args, detail);
	vsnprintf(text, sizeof text, detail, args);
	va_end(args);
	faults_add(&task->faults, pointer, "%s", text);
}
