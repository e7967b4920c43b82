#include <stdlib.h>
#include <string.h>

#include <cjson/cJSON.h>

#include "core/table.h"
#include "proto/answer.h"
#include "proto/fault.h"
#include "proto/order.h"
#include "server/access.h"
#include "server/config.h"
#include "server/evaluation.h"
#include "server/exchange.h"
#include "server/handlers.h"
#include "server/orders.h"
#include "server/server.h"
#include "server/table_reply.h"

/* What documents may say to have this table. */
static cJSON *operator_json(const struct order_job *job)
{
	const struct operator *op = &job->order.op;
	cJSON *json = cJSON_CreateObject();

	cJSON_AddItemToObject(json, "profile",
	    table_reply_profile(&op->profile));
	cJSON_AddStringToObject(json, "layout",
	    operator_layout_name(op->layout));
	cJSON_AddNumberToObject(json, "resolution", job->resolution);
	return json;
}

static void reply_table(struct exchange *x, const struct order_job *job)
{
	cJSON *json = table_reply_json(&job->report), *measured;

	measured = cJSON_AddObjectToObject(json, "measured");
	cJSON_AddNumberToObject(measured, "count", TABLE_SAMPLE);
	table_reply_add_figure(measured, "max", job->max);
	table_reply_add_figure(measured, "mean", job->mean);
	cJSON_AddItemToObject(json, "operator", operator_json(job));
	exchange_reply_json(x, 200, json);
}

/* 422 with one member more than exchange_reply_problem has. */
static void reply_best(struct exchange *x, const struct order_job *job)
{
	const struct problem_kind *kind = problem_kind(PROBLEM_LIMIT);
	struct faults faults = {0};
	cJSON *json, *best;
	size_t length;
	char *text;

	faults_add(&faults, "/max_error", "no table holds it: with %d nodes "
	    "an axis, the most there may be, g is off by up to %.3g",
	    job->resolution, job->max);
	text = answer_problem(kind->status, kind->slug, kind->title,
	    faults.list[0].detail, &faults, &length);
	json = text != NULL ? cJSON_ParseWithLength(text, length) : NULL;
	free(text);
	best = cJSON_AddObjectToObject(json, "best");
	cJSON_AddNumberToObject(best, "resolution", job->resolution);
	table_reply_add_figure(best, "max_error", job->max);
	table_reply_add_figure(best, "mean_error", job->mean);
	text = cJSON_PrintUnformatted(json);
	cJSON_Delete(json);
	if (text == NULL)
		exchange_reply_problem(x, PROBLEM_LIMIT, &faults, "%s",
		    faults.list[0].detail);
	else
		exchange_reply_data(x, (unsigned)kind->status, MEDIA_PROBLEM,
		    text, strlen(text));
}

static void reply_failure(struct exchange *x, enum err err)
{
	if (err == ERR_CANCELLED && !exchange_is_connected(x))
		exchange_reply_nothing(x);
	else if (err == ERR_CANCELLED)
		exchange_reply_problem(x, PROBLEM_DRAINING, NULL,
		    "The server is shutting down and orders no tables.");
	else
		exchange_reply_problem(x, problem_from_err(err), NULL,
		    "The table could not be built: %s.", err_message(err));
}

static void answer(struct exchange *x)
{
	const struct order_job *job = x->state;

	if (job->result == ERR_OK)
		reply_table(x, job);
	else if (job->result == ERR_LIMIT)
		reply_best(x, job);
	else
		reply_failure(x, job->result);
}

static void free_job(void *state, struct server *server)
{
	(void)server;
	free(state);
}

/* ---- the searcher's calls ---- */

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
		    "%d orders of tables are waiting; try again soon.",
		    ORDERS_MAX);
	else
		reply_failure(x, err);
}

static void begin(struct exchange *x, const struct order *order)
{
	const size_t n = order->op.resolution > 0 ?
	    (size_t)order->op.resolution : TABLE_RESOLUTION_MAX;
	struct order_job *job;
	enum err err;

	if (!access_take_points(x, NULL, ACCESS_NODE_POINTS * n * n * n))
		return;
	job = calloc(1, sizeof *job);
	if (job == NULL) {
		reply_failure(x, ERR_MEMORY);
		return;
	}
	*job = (struct order_job){
		.order = *order,
		.park = park,
		.done = done,
		.wanted = wanted,
		.ctx = x,
	};
	x->state = job;
	x->state_free = free_job;
	x->resumed = answer;
	exchange_release_body(x);
	err = exchange_is_late(x) ? ERR_CANCELLED :
	    orders_submit(x->server->orders, job);
	if (err != ERR_OK)
		reply_refusal(x, err);
}

/* A table that --table-memory cannot hold is of no use. */
static bool check_size(struct exchange *x, const struct order *order)
{
	size_t bytes = x->server->config->device.table_bytes;
	int most = orders_resolution_most(bytes);
	struct faults faults = {0};

	if (order->op.resolution <= most)
		return true;
	faults_add(&faults, "/resolution", "a table of %d nodes an axis needs "
	    "more than the %zu bytes that --table-memory gives; %d is the most",
	    order->op.resolution, bytes, most);
	evaluation_reply_faults(x, ERR_LIMIT, &faults);
	return false;
}

void handle_operator_order(struct exchange *x)
{
	struct faults faults = {0};
	enum media_type type;
	struct order order;
	enum err err;

	if (!exchange_check_content_type(x, 1u << MEDIA_JSON, &type))
		return;
	err = order_parse(x->body != NULL ? x->body : "", x->body_length,
	    x->server->config->layout, &order, &faults);
	if (err != ERR_OK)
		evaluation_reply_faults(x, err, &faults);
	else if (check_size(x, &order))
		begin(x, &order);
}
