#include "server/evaluation_body.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "proto/eval_stream.h"
#include "proto/fault.h"
#include "proto/number.h"
#include "server/clock.h"
#include "server/config.h"
#include "server/exchange.h"
#include "server/limits.h"
#include "server/metrics.h"
#include "server/server.h"

#define EVAL_TYPES (1u << MEDIA_JSON)
#define SCENE_EVAL_TYPES (1u << MEDIA_JSON | 1u << MEDIA_OCTETS | \
	1u << MEDIA_NPY)

struct evaluation_body {
	struct sink sink;
	struct eval_stream *stream;
	struct evaluation_terms terms;
	double seconds; /* that its parts have taken to parse */
};

/* ---- as a sink ---- */

static bool feed(struct sink *sink, const char *data, size_t length)
{
	struct evaluation_body *b = (struct evaluation_body *)sink;
	double begin = clock_seconds();
	enum err err = eval_stream_feed(b->stream, data, length);

	b->seconds += clock_seconds() - begin;
	return err == ERR_OK;
}

static size_t bytes(const struct sink *sink)
{
	const struct evaluation_body *b = (const struct evaluation_body *)sink;

	return eval_stream_bytes(b->stream);
}

static size_t left(const struct sink *sink)
{
	const struct evaluation_body *b = (const struct evaluation_body *)sink;

	return eval_stream_text(b->stream);
}

static void free_body(struct sink *sink)
{
	struct evaluation_body *b = (struct evaluation_body *)sink;

	eval_stream_free(b->stream);
	free(b);
}

/* ---- the head ---- */

static bool check_accept(struct exchange *x, enum media_type *out)
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

static enum err read_priority(const char *value, enum evaluation_priority *out,
    struct faults *faults)
{
	*out = EVALUATION_BY_SIZE;
	if (value == NULL)
		return ERR_OK;
	if (strcmp(value, "interactive") == 0)
		*out = EVALUATION_INTERACTIVE;
	else if (strcmp(value, "bulk") == 0)
		*out = EVALUATION_BULK;
	if (*out != EVALUATION_BY_SIZE)
		return ERR_OK;
	faults_add(faults, "?priority", "'%.60s' is none: interactive or bulk",
	    value);
	return ERR_INVALID;
}

static enum err read_deadline(const char *value, double *out,
    struct faults *faults)
{
	const char *end, *at = value;

	*out = 0.0;
	if (value == NULL)
		return ERR_OK;
	end = value + strlen(value);
	if (number_parse(&at, end, out) == 0 && at == end && *out > 0.0 &&
	    isfinite(*out))
		return ERR_OK;
	faults_add(faults, "?deadline", "'%.60s' is no number of seconds "
	    "above 0", value);
	return ERR_INVALID;
}

/* All that is wrong with the query is told at once. */
static bool check_query(struct exchange *x, struct evaluation_terms *out)
{
	struct faults faults = {0};
	enum err outputs = outputs_from_list(exchange_query(x, "outputs"),
	    "?outputs", &out->outputs, &faults);
	enum err priority = read_priority(exchange_query(x, "priority"),
	    &out->priority, &faults);
	enum err deadline = read_deadline(exchange_query(x, "deadline"),
	    &out->deadline, &faults);

	if (outputs == ERR_OK && priority == ERR_OK && deadline == ERR_OK)
		return true;
	evaluation_reply_faults(x, ERR_INVALID, &faults);
	return false;
}

bool evaluation_body_head(struct exchange *x, unsigned types,
    enum media_type *type, struct evaluation_terms *out)
{
	return exchange_check_content_type(x, types, type) &&
	    check_accept(x, &out->accept) && check_query(x, out);
}

/* Has x's body go to a stream. */
static void begin_stream(struct exchange *x,
    const struct eval_stream_options *options,
    const struct evaluation_terms *terms)
{
	struct evaluation_body *b = malloc(sizeof *b);

	if (b == NULL || eval_stream_create(options, &b->stream) != ERR_OK) {
		free(b);
		exchange_reply_problem(x, PROBLEM_MEMORY, NULL,
		    "There was no memory for the evaluation.");
		return;
	}
	b->sink = (struct sink){feed, bytes, left, free_body};
	b->terms = *terms;
	b->seconds = 0.0;
	x->sink = &b->sink;
}

static void open_body(struct exchange *x, unsigned types, bool with_scene)
{
	struct eval_stream_options options = {
		.with_scene = with_scene,
		.max_points = x->server->config->max_points,
		.promise = x->promised,
	};
	struct evaluation_terms terms;

	if (evaluation_body_head(x, types, &options.type, &terms))
		begin_stream(x, &options, &terms);
}

void evaluation_body_open_eval(struct exchange *x)
{
	open_body(x, EVAL_TYPES, true);
}

void evaluation_body_open_scene_eval(struct exchange *x)
{
	open_body(x, SCENE_EVAL_TYPES, false);
}

/* ---- its end ---- */

enum err evaluation_body_finish(struct exchange *x, struct eval_request *out,
    struct faults *faults)
{
	struct evaluation_body *b = (struct evaluation_body *)x->sink;
	const struct document_limits limits = limits_new(x->server);
	double begin = clock_seconds();
	enum err err = eval_stream_finish(b->stream, b->terms.outputs, &limits,
	    out, faults);

	metrics_observe(x->server->metrics, x, METRICS_PARSE, b->seconds +
	    clock_seconds() - begin);
	return err;
}

const struct evaluation_terms *evaluation_body_terms(const struct exchange *x)
{
	return &((const struct evaluation_body *)x->sink)->terms;
}
