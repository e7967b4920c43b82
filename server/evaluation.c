#include "server/evaluation.h"

#include <assert.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "core/output.h"
#include "proto/document.h"
#include "proto/fault.h"
#include "server/access.h"
#include "server/clock.h"
#include "server/config.h"
#include "server/evaluation_internal.h"
#include "server/exchange.h"
#include "server/metrics.h"
#include "server/program.h"
#include "server/scheduler.h"
#include "server/server.h"

static_assert(EVALUATION_SMALL_POINTS == SCHEDULER_SMALL_POINTS,
    "what is interactive by its size is small to the scheduler");

void evaluation_reply_faults(struct exchange *x, enum err err,
    const struct faults *faults)
{
	enum problem problem = problem_from_err(err);
	const struct fault *first = &faults->list[0];
	const char *where = first->pointer;
	const char *colon = where[0] != '\0' ? ": " : "";

	if (faults->count == 0)
		exchange_reply_problem(x, problem, NULL, "The request failed: "
		    "%s.", err_message(err));
	else if (faults->count == 1)
		exchange_reply_problem(x, problem, faults, "%s%s%s", where,
		    colon, first->detail);
	else
		exchange_reply_problem(x, problem, faults,
		    "%zu places are wrong; the first: %s%s%s", faults->count,
		    where, colon, first->detail);
}

/* Which of the operators is one too many is not to be said: those named, if
 * there are any, or the document has them in its nodes. */
static void add_too_large(struct faults *faults, const char *pointer,
    const struct document *document, size_t most)
{
	char place[FAULT_POINTER_MAX];

	snprintf(place, sizeof place, "%s%s", pointer,
	    document_has_operators(document) ? "/operators" : "");
	faults_add(faults, place, "the tables of all operators together need "
	    "more than the %zu bytes that --table-memory gives", most);
}

enum err evaluation_program(struct server *server, const char *pointer,
    struct document *document, struct program **out, struct faults *faults)
{
	size_t most = server->config->device.table_bytes;
	enum err err = program_create(server->tables,
	    document_take_tape(document), most, out);

	if (err == ERR_LIMIT)
		add_too_large(faults, pointer, document, most);
	return err;
}

bool evaluation_compile(struct exchange *x, const char *pointer,
    struct document *document, struct program **out)
{
	struct faults faults = {0};
	enum err err = evaluation_program(x->server, pointer, document, out,
	    &faults);

	if (err != ERR_OK)
		evaluation_reply_faults(x, err, &faults);
	return err == ERR_OK;
}

/* ---- life ---- */

static void let_go(struct evaluation *e)
{
	if (atomic_fetch_sub(&e->holders, 1) != 1)
		return;
	evaluation_answer_fini(e);
	points_fini(&e->points);
	free(e->job.rows);
	scheduler_return(e->server->scheduler, &e->job);
	scheduler_release(e->server->scheduler, e->job.program);
	pthread_mutex_destroy(&e->lock);
	free(e);
}

/* What a job that is done has taken. */
static void observe(const struct evaluation *e, const struct exchange *x)
{
	struct metrics *m = e->server->metrics;

	if (e->job.result != ERR_OK || e->job.begun == 0.0)
		return;
	metrics_observe(m, x, METRICS_QUEUE, e->job.begun - e->submitted);
	metrics_observe_device(m, x, &e->job.times);
	if (e->printing > 0.0)
		metrics_observe(m, x, METRICS_PRINT, e->printing);
}

/* The exchange is over, perhaps before the job. */
static void leave(void *state, struct server *server)
{
	struct evaluation *e = state;
	const struct exchange *x;
	bool is_done;

	pthread_mutex_lock(&e->lock);
	x = e->x;
	e->x = NULL;
	is_done = e->is_done;
	pthread_mutex_unlock(&e->lock);
	if (is_done)
		observe(e, x);
	else
		scheduler_continue(server->scheduler);
	let_go(e);
}

/* Has the exchange go on, if it waits. Locked. */
static void wake(struct evaluation *e)
{
	if (!e->is_suspended || e->x == NULL)
		return;
	e->is_suspended = false;
	exchange_resume(e->x);
}

/* ---- the scheduler's calls ---- */

static void park(void *ctx)
{
	struct evaluation *e = ctx;

	pthread_mutex_lock(&e->lock);
	e->is_suspended = true;
	exchange_wait(e->x);
	pthread_mutex_unlock(&e->lock);
}

static bool wanted(void *ctx)
{
	struct evaluation *e = ctx;
	bool is_wanted;

	pthread_mutex_lock(&e->lock);
	is_wanted = e->x != NULL && exchange_is_connected(e->x);
	pthread_mutex_unlock(&e->lock);
	return is_wanted;
}

/* Takes rows over. Locked. */
static void hold_piece(struct evaluation *e, float *rows, size_t count)
{
	size_t columns = (size_t)output_row_floats(e->job.outputs);

	if (e->x == NULL || e->held == PIECES_ROOM) {
		e->overrun = e->held == PIECES_ROOM;
		free(rows);
		return;
	}
	e->pieces[(e->first + e->held++) % PIECES_ROOM] = (struct piece){
		rows, count * columns * sizeof *rows};
	e->is_draft = e->job.is_draft;
}

static void take_piece(void *ctx, float *rows, size_t first, size_t count)
{
	struct evaluation *e = ctx;

	(void)first;
	pthread_mutex_lock(&e->lock);
	hold_piece(e, rows, count);
	wake(e);
	pthread_mutex_unlock(&e->lock);
}

static bool has_room(void *ctx)
{
	struct evaluation *e = ctx;
	bool has;

	pthread_mutex_lock(&e->lock);
	has = e->x == NULL || e->held < SCHEDULER_PIECES;
	pthread_mutex_unlock(&e->lock);
	return has;
}

static void done(void *ctx)
{
	struct evaluation *e = ctx;

	points_fini(&e->points);
	e->finished = clock_seconds();
	pthread_mutex_lock(&e->lock);
	e->is_draft = e->job.is_draft;
	e->is_done = true;
	wake(e);
	pthread_mutex_unlock(&e->lock);
	let_go(e);
}

/* ---- the beginning ---- */

static void reply_refusal(struct exchange *x, enum err err)
{
	if (err == ERR_BUSY)
		exchange_reply_problem(x, PROBLEM_QUEUE_FULL, NULL,
		    "Too many evaluations are waiting, or too much of their "
		    "answers has not been read yet; try again soon.");
	else if (err == ERR_MEMORY)
		exchange_reply_problem(x, PROBLEM_MEMORY, NULL,
		    "There was no memory for the evaluation.");
	else if (err == ERR_DEADLINE)
		exchange_reply_problem(x, PROBLEM_DEADLINE, NULL,
		    "The deadline passed while the request arrived, which "
		    "took %.3f s.", clock_seconds() - x->begun);
	else
		exchange_reply_problem(x, PROBLEM_DRAINING, NULL,
		    "The server is shutting down and takes no new work.");
}

static enum job_priority job_priority(enum evaluation_priority priority,
    size_t count)
{
	if (priority == EVALUATION_BY_SIZE)
		priority = count <= EVALUATION_SMALL_POINTS ?
		    EVALUATION_INTERACTIVE : EVALUATION_BULK;
	return priority == EVALUATION_BULK ? JOB_BULK : JOB_INTERACTIVE;
}

static bool is_large(size_t count, unsigned outputs)
{
	return count > EVALUATION_SMALL_POINTS && count * sizeof(float) *
	    (size_t)output_row_floats(outputs) > EVALUATION_SMALL_BYTES;
}

/* Bytes of the answer beside its rows: a text that leaves whole. */
static size_t text_bytes(const struct evaluation *e, size_t count,
    unsigned outputs)
{
	if (e->is_large || e->accept != MEDIA_JSON)
		return 0;
	return count * (size_t)output_row_floats(outputs) * NUMBER_BYTES;
}

static struct evaluation *create(struct exchange *x,
    const struct evaluation_request *request)
{
	const struct evaluation_terms *terms = request->terms;
	size_t count = request->points->count;
	struct evaluation *e = calloc(1, sizeof *e);

	if (e == NULL)
		return NULL;
	pthread_mutex_init(&e->lock, NULL);
	atomic_init(&e->holders, 1);
	e->server = x->server;
	e->x = x;
	e->points = *request->points;
	*request->points = (struct points){0};
	e->flat = e->points.flat;
	e->is_grid = request->counts != NULL;
	if (e->is_grid)
		memcpy(e->counts, request->counts, sizeof e->counts);
	e->accept = terms->accept;
	e->is_large = is_large(count, request->outputs);
	e->in_pieces = e->is_large && e->accept != MEDIA_JSON;
	e->begun = x->begun;
	if (request->etag != NULL)
		strcpy(e->etag, request->etag);
	e->job = (struct job){
		.program = request->program,
		.points = e->points.xyz,
		.count = count,
		.outputs = request->outputs,
		.priority = job_priority(terms->priority, count),
		.deadline = terms->deadline > 0.0 ?
		    x->begun + terms->deadline : 0.0,
		.seconds_most = (double)x->server->config->work_time,
		.piece = e->in_pieces ? take_piece : NULL,
		.has_room = e->in_pieces ? has_room : NULL,
		.park = park,
		.done = done,
		.wanted = wanted,
		.ctx = e,
		.text = text_bytes(e, count, request->outputs),
	};
	return e;
}

/* As scheduler_submit. */
static enum err submit(struct evaluation *e)
{
	enum err err;

	e->submitted = clock_seconds();
	if (exchange_is_late(e->x))
		return ERR_CANCELLED;
	if (e->job.deadline > 0.0 && e->submitted > e->job.deadline)
		return ERR_DEADLINE;
	atomic_fetch_add(&e->holders, 1);
	err = scheduler_submit(e->server->scheduler, &e->job);
	if (err != ERR_OK)
		atomic_fetch_sub(&e->holders, 1);
	return err;
}

void evaluation_begin(struct exchange *x,
    const struct evaluation_request *request)
{
	struct evaluation *e;
	enum err err;

	if (!access_take_points(x, request->program,
	    request->points->count)) {
		scheduler_release(x->server->scheduler, request->program);
		return;
	}
	e = create(x, request);
	if (e == NULL) {
		scheduler_release(x->server->scheduler, request->program);
		reply_refusal(x, ERR_MEMORY);
		return;
	}
	x->state = e;
	x->state_free = leave;
	x->resumed = evaluation_answer;
	exchange_release_body(x);
	err = submit(e);
	if (err == ERR_OK)
		return;
	e->is_done = true; /* nobody else has it */
	reply_refusal(x, err);
}
