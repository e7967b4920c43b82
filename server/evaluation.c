#include "server/evaluation.h"

#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "core/output.h"
#include "proto/answer.h"
#include "proto/document.h"
#include "proto/fault.h"
#include "server/config.h"
#include "server/etag.h"
#include "server/exchange.h"
#include "server/program.h"
#include "server/scheduler.h"
#include "server/server.h"

/* An exchange's state while it waits. */
struct evaluation {
	struct job job;
	struct points points;
	enum media_type accept;
	char etag[ETAG_SIZE]; /* "": none */
};

bool evaluation_check_accept(struct exchange *x, enum media_type *out)
{
	const char *accept = exchange_header(x, "Accept");

	if (media_from_accept(accept, out))
		return true;
	exchange_reply_problem(x, PROBLEM_NOT_ACCEPTABLE, NULL,
	    "Accept is '%.100s'; this resource answers %s, %s or %s.", accept,
	    media_name(MEDIA_JSON), media_name(MEDIA_OCTETS),
	    media_name(MEDIA_NPY));
	return false;
}

bool evaluation_check_outputs(struct exchange *x, unsigned *out)
{
	struct faults faults = {0};
	enum err err = outputs_from_list(exchange_query(x, "outputs"),
	    "?outputs", out, &faults);

	if (err == ERR_OK)
		return true;
	evaluation_reply_faults(x, err, &faults);
	return false;
}

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
static void reply_tables_too_large(struct exchange *x, const char *pointer,
    const struct document *document, size_t most)
{
	struct faults faults = {0};
	char place[FAULT_POINTER_MAX];

	snprintf(place, sizeof place, "%s%s", pointer,
	    document_has_operators(document) ? "/operators" : "");
	faults_add(&faults, place, "the tables of all operators together need "
	    "more than the %zu bytes that --table-memory gives", most);
	evaluation_reply_faults(x, ERR_LIMIT, &faults);
}

bool evaluation_compile(struct exchange *x, const char *pointer,
    struct document *document, struct program **out)
{
	struct server *server = x->server;
	size_t most = server->config->device.table_bytes;
	enum err err = program_create(server->tables,
	    document_take_tape(document), most, out);

	if (err == ERR_OK)
		return true;
	if (err == ERR_LIMIT)
		reply_tables_too_large(x, pointer, document, most);
	else
		exchange_reply_problem(x, problem_from_err(err), NULL,
		    "The document could not be compiled: %s.",
		    err_message(err));
	return false;
}

static void evaluation_free(void *state, struct server *server)
{
	struct evaluation *e = state;

	scheduler_release(server->scheduler, e->job.program);
	points_fini(&e->points);
	free(e->job.rows);
	free(e);
}

/* ---- the answer ---- */

static void reply_json(struct exchange *x, struct evaluation *e)
{
	size_t length;
	char *text;
	unsigned flags = (e->points.flat ? ANSWER_FLAT : 0) |
	    (e->job.is_draft ? ANSWER_DRAFT : 0);
	enum err err = answer_json(e->job.rows, e->job.count, e->job.outputs,
	    flags, &text, &length);

	if (err == ERR_OK)
		exchange_reply_data(x, 200, MEDIA_JSON, text, length);
	else
		exchange_reply_problem(x, problem_from_err(err), NULL,
		    "The answer could not be written: %s.", err_message(err));
}

static void reply_rows(struct exchange *x, struct evaluation *e)
{
	int columns = output_row_floats(e->job.outputs);
	size_t length = e->job.count * (size_t)columns * sizeof(float);
	char header[ANSWER_NPY_HEADER_MAX];
	size_t header_length;

	if (e->accept == MEDIA_NPY) {
		header_length = answer_npy_header(e->job.count, columns,
		    header);
		exchange_reply_two(x, MEDIA_NPY, header, header_length,
		    e->job.rows, length);
	} else {
		exchange_reply_data(x, 200, MEDIA_OCTETS, e->job.rows, length);
	}
	e->job.rows = NULL;
}

static void reply_failure(struct exchange *x, const struct evaluation *e)
{
	enum err err = e->job.result;

	if (err == ERR_CANCELLED && !exchange_is_connected(x))
		exchange_reply_nothing(x);
	else if (err == ERR_CANCELLED)
		exchange_reply_problem(x, PROBLEM_DRAINING, NULL,
		    "The server is shutting down; the evaluation was given "
		    "up.");
	else
		exchange_reply_problem(x, problem_from_err(err), NULL,
		    "The evaluation failed: %s%s%s.", err_message(err),
		    e->job.message[0] != '\0' ? ": " : "", e->job.message);
}

static void answer(struct exchange *x)
{
	struct evaluation *e = x->state;

	if (e->job.result != ERR_OK)
		reply_failure(x, e);
	else if (e->accept == MEDIA_JSON)
		reply_json(x, e);
	else
		reply_rows(x, e);
	if (e->job.result == ERR_OK && e->job.is_draft)
		exchange_add_header(x, "Blobfield-Draft", "true");
	if (e->etag[0] != '\0')
		exchange_add_header(x, "ETag", e->etag);
}

/* ---- the scheduler's calls ---- */

static void park(void *ctx)
{
	exchange_wait(ctx);
}

static void done(void *ctx)
{
	exchange_resume(ctx);
}

static bool wanted(void *ctx)
{
	return exchange_is_connected(ctx);
}

static void reply_refusal(struct exchange *x, enum err err)
{
	if (err == ERR_BUSY)
		exchange_reply_problem(x, PROBLEM_QUEUE_FULL, NULL,
		    "Too many evaluations are waiting; try again soon.");
	else if (err == ERR_MEMORY)
		exchange_reply_problem(x, PROBLEM_MEMORY, NULL,
		    "There was no memory for the evaluation.");
	else
		exchange_reply_problem(x, PROBLEM_DRAINING, NULL,
		    "The server is shutting down and takes no new work.");
}

void evaluation_begin(struct exchange *x,
    const struct evaluation_request *request)
{
	struct evaluation *e = calloc(1, sizeof *e);
	enum err err;

	if (e == NULL) {
		scheduler_release(x->server->scheduler, request->program);
		exchange_reply_problem(x, PROBLEM_MEMORY, NULL,
		    "There was no memory for the evaluation.");
		return;
	}
	e->points = *request->points;
	*request->points = (struct points){0};
	e->accept = request->accept;
	if (request->etag != NULL)
		strcpy(e->etag, request->etag);
	e->job = (struct job){
		.program = request->program,
		.points = e->points.xyz,
		.count = e->points.count,
		.outputs = request->outputs,
		.park = park,
		.done = done,
		.wanted = wanted,
		.ctx = x,
	};
	x->state = e;
	x->state_free = evaluation_free;
	x->resumed = answer;
	exchange_release_body(x);
	err = scheduler_submit(x->server->scheduler, &e->job);
	if (err != ERR_OK)
		reply_refusal(x, err);
}
