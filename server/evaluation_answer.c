#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "core/output.h"
#include "proto/answer.h"
#include "proto/answer_stream.h"
#include "server/clock.h"
#include "server/config.h"
#include "server/evaluation.h"
#include "server/evaluation_internal.h"
#include "server/exchange.h"
#include "server/log.h"
#include "server/scheduler.h"
#include "server/server.h"

static size_t row_bytes(const struct evaluation *e)
{
	return (size_t)output_row_floats(e->job.outputs) * sizeof(float);
}

/* ---- rows in pieces ---- */

static size_t least(size_t a, size_t b)
{
	return a < b ? a : b;
}

/* Whether the answer ends early by the client's own doing. */
static bool is_wished(const struct evaluation *e)
{
	return e->job.result == ERR_DEADLINE ||
	    (e->job.result == ERR_CANCELLED && !exchange_is_connected(e->x));
}

static void log_cut(const struct evaluation *e)
{
	const struct exchange *x = e->x;
	char target[EXCHANGE_TARGET_MAX];

	log_mask_target(x->target, target, sizeof target);
	if (e->overrun)
		log_write(LOG_ERROR, "%s: the answer of %s was cut short: more "
		    "pieces than there is room for", target, x->request_id);
	else if (e->job.result == ERR_OVERTIME)
		log_write(LOG_WARNING, "%s: the answer of %s was cut short: "
		    "after %.3f s of the device's time; %zu s (--work-time) "
		    "are the most", target, x->request_id, e->job.seconds,
		    e->server->config->work_time);
	else
		log_write(is_wished(e) ? LOG_INFO : LOG_WARNING,
		    "%s: the answer of %s was cut short: %s%s%s", target,
		    x->request_id, err_message(e->job.result),
		    e->job.message[0] != '\0' ? ": " : "", e->job.message);
}

/* The end of what e has, for the client to see that it is none. Where there was
 * no overrun the job is done, so that its result may be read. Locked. */
static ptrdiff_t cut(const struct evaluation *e)
{
	log_cut(e);
	/* For the metrics: it is a refusal, though the head said 200. */
	if (!e->overrun && e->job.result == ERR_OVERTIME)
		e->x->problem = PROBLEM_WORK_TIME;
	return EXCHANGE_CUT;
}

/*
 * What to read next in *piece: 1; or nothing, yet (EXCHANGE_PAUSED) or ever
 * again. The first piece stays where it is until it is dropped, so that it can
 * be read without the lock.
 */
static ptrdiff_t next_piece(struct evaluation *e, struct piece *piece)
{
	ptrdiff_t result = 1;

	pthread_mutex_lock(&e->lock);
	if (e->held > 0 && !e->overrun) {
		*piece = e->pieces[e->first];
	} else if (e->is_done || e->overrun) {
		result = cut(e);
	} else {
		e->is_suspended = true;
		exchange_pause(e->x);
		result = EXCHANGE_PAUSED;
	}
	pthread_mutex_unlock(&e->lock);
	return result;
}

/* The first piece has left. */
static void drop_piece(struct evaluation *e)
{
	float *rows = e->pieces[e->first].rows;
	bool is_done;

	pthread_mutex_lock(&e->lock);
	e->first = (e->first + 1) % PIECES_ROOM;
	e->held--;
	is_done = e->is_done;
	pthread_mutex_unlock(&e->lock);
	e->read = 0;
	free(rows);
	if (!is_done)
		scheduler_continue(e->server->scheduler);
}

static size_t read_head(struct evaluation *e, char *out, size_t size)
{
	size_t n = least(size, e->head_length - e->head_read);

	memcpy(out, e->head + e->head_read, n);
	e->head_read += n;
	return n;
}

/* struct exchange_stream, read: up to the end of a piece. */
static ptrdiff_t read_rows(void *ctx, char *out, size_t size)
{
	struct evaluation *e = ctx;
	struct piece piece;
	size_t n = read_head(e, out, size);
	ptrdiff_t next;

	if (n > 0)
		return (ptrdiff_t)n;
	next = next_piece(e, &piece);
	if (next <= 0)
		return next;
	n = least(size, piece.bytes - e->read);
	memcpy(out, (const char *)piece.rows + e->read, n);
	e->read += n;
	if (e->read == piece.bytes)
		drop_piece(e);
	return (ptrdiff_t)n;
}

static size_t npy_header(const struct evaluation *e,
    char out[static ANSWER_NPY_HEADER_MAX])
{
	const int columns = output_row_floats(e->job.outputs);

	return e->is_grid ? answer_grid_npy_header(e->counts, columns, out) :
	    answer_npy_header(e->job.count, columns, out);
}

static void stream_rows(struct exchange *x, struct evaluation *e)
{
	size_t rows = e->job.count * row_bytes(e);

	if (e->accept == MEDIA_NPY)
		e->head_length = npy_header(e, e->head);
	exchange_reply_stream(x, e->accept, &(struct exchange_stream){
		.read = read_rows,
		.ctx = e,
		.has_length = true,
		.length = e->head_length + rows,
	});
}

/* ---- JSON ---- */

static void end_text(struct evaluation *e)
{
	answer_stream_free(e->text);
	e->text = NULL;
	free(e->job.rows);
	e->job.rows = NULL;
}

/* struct exchange_stream, read. */
static ptrdiff_t read_text(void *ctx, char *out, size_t size)
{
	struct evaluation *e = ctx;
	size_t n;

	if (size < ANSWER_STREAM_LEAST) {
		log_write(LOG_WARNING, "%s: the answer was cut short: no room "
		    "beside the request's head", e->x->target);
		return EXCHANGE_CUT;
	}
	e->printing -= clock_seconds();
	n = e->text != NULL ? answer_stream_read(e->text, out, size) : 0;
	e->printing += clock_seconds();
	if (n > 0)
		return (ptrdiff_t)n;
	end_text(e);
	return EXCHANGE_END;
}

static enum err stream_json(struct exchange *x, struct evaluation *e,
    unsigned flags)
{
	enum err err = answer_stream_create(e->job.rows, e->job.count,
	    e->job.outputs, flags, &e->text);

	if (err != ERR_OK)
		return err;
	if (e->is_grid)
		answer_stream_set_counts(e->text, e->counts);
	exchange_reply_stream(x, MEDIA_JSON, &(struct exchange_stream){
		.read = read_text,
		.ctx = e,
		.length = e->job.count * (row_bytes(e) / sizeof(float)) *
		    NUMBER_BYTES,
	});
	return ERR_OK;
}

static enum err print_json(struct exchange *x, struct evaluation *e,
    unsigned flags)
{
	size_t length;
	char *text;
	enum err err = e->is_grid ?
	    answer_grid_json(e->job.rows, e->counts, e->job.outputs, flags,
	    &text, &length) :
	    answer_json(e->job.rows, e->job.count, e->job.outputs, flags,
	    &text, &length);

	if (err != ERR_OK)
		return err;
	free(e->job.rows);
	e->job.rows = NULL;
	exchange_reply_data(x, 200, MEDIA_JSON, text, length);
	return ERR_OK;
}

static void reply_json(struct exchange *x, struct evaluation *e)
{
	unsigned flags = (e->flat ? ANSWER_FLAT : 0) |
	    (e->job.is_draft ? ANSWER_DRAFT : 0);
	double begin = clock_seconds();
	enum err err = e->is_large ? stream_json(x, e, flags) :
	    print_json(x, e, flags);

	e->printing = clock_seconds() - begin;
	if (err != ERR_OK)
		exchange_reply_problem(x, problem_from_err(err), NULL,
		    "The answer could not be written: %s.", err_message(err));
}

/* ---- all answers ---- */

static void reply_rows(struct exchange *x, struct evaluation *e)
{
	size_t length = e->job.count * row_bytes(e);
	char header[ANSWER_NPY_HEADER_MAX];
	size_t header_length;

	if (e->accept == MEDIA_NPY) {
		header_length = npy_header(e, header);
		exchange_reply_two(x, MEDIA_NPY, header, header_length,
		    e->job.rows, length);
	} else {
		exchange_reply_data(x, 200, MEDIA_OCTETS, e->job.rows, length);
	}
	e->job.rows = NULL;
}

/* Seconds for which the job did not run. */
static double waited(const struct evaluation *e)
{
	double seconds = e->finished - e->submitted - e->job.seconds;

	return seconds > 0.0 ? seconds : 0.0;
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
	else if (err == ERR_DEADLINE)
		exchange_reply_problem(x, PROBLEM_DEADLINE, NULL,
		    "The deadline was %.3f s after the request began; the "
		    "evaluation waited %.3f s and ran for %.3f s.",
		    e->job.deadline - e->begun, waited(e), e->job.seconds);
	else if (err == ERR_OVERTIME)
		exchange_reply_problem(x, PROBLEM_WORK_TIME, NULL,
		    "After %.3f s of the device's time the evaluation was "
		    "given up; %zu s (--work-time) are the most. Ask for fewer "
		    "points at a time, or of a smaller document.",
		    e->job.seconds, x->server->config->work_time);
	else
		exchange_reply_problem(x, problem_from_err(err), NULL,
		    "The evaluation failed: %s%s%s.", err_message(err),
		    e->job.message[0] != '\0' ? ": " : "", e->job.message);
}

/* The device's own time, for clients to see. */
static void add_timing(struct exchange *x, const struct evaluation *e)
{
	char text[80];

	snprintf(text, sizeof text, "queue;dur=%.3f, device;dur=%.3f",
	    1e3 * waited(e), 1e3 * e->job.seconds);
	exchange_add_header(x, "Server-Timing", text);
}

static void add_headers(struct exchange *x, const struct evaluation *e,
    bool is_draft)
{
	if (is_draft)
		exchange_add_header(x, "Blobfield-Draft", "true");
	if (e->etag[0] != '\0')
		exchange_add_header(x, "ETag", e->etag);
}

void evaluation_answer(struct exchange *x)
{
	struct evaluation *e = x->state;
	bool is_done, is_draft;

	pthread_mutex_lock(&e->lock);
	is_done = e->is_done;
	is_draft = e->is_draft;
	pthread_mutex_unlock(&e->lock);
	if (is_done && e->job.result != ERR_OK) {
		reply_failure(x, e);
		is_draft = false;
	} else if (e->in_pieces) {
		stream_rows(x, e);
	} else {
		if (e->accept == MEDIA_JSON)
			reply_json(x, e);
		else
			reply_rows(x, e);
		add_timing(x, e);
	}
	add_headers(x, e, is_draft);
}

void evaluation_answer_fini(struct evaluation *e)
{
	answer_stream_free(e->text);
	for (; e->held > 0; e->held--) {
		free(e->pieces[e->first].rows);
		e->first = (e->first + 1) % PIECES_ROOM;
	}
}
