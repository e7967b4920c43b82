#include "proto/document.h"
#include "proto/fault.h"
#include "proto/request.h"
#include "server/config.h"
#include "server/evaluation.h"
#include "server/exchange.h"
#include "server/handlers.h"
#include "server/limits.h"
#include "server/server.h"

static enum err parse(struct exchange *x, unsigned outputs,
    struct eval_request *out, struct faults *faults)
{
	const struct config *config = x->server->config;
	const struct document_limits limits = limits_new(x->server);

	return eval_request_parse(x->body != NULL ? x->body : "",
	    x->body_length, true, outputs, &limits, config->max_points, out,
	    faults);
}

static void begin(struct exchange *x, struct eval_request *body,
    enum media_type accept)
{
	struct evaluation_request request = {
		.points = &body->points,
		.outputs = body->outputs,
		.accept = accept,
	};

	if (evaluation_compile(x, "/scene", body->document,
	    &request.program))
		evaluation_begin(x, &request);
}

void handle_eval(struct exchange *x)
{
	struct eval_request body = {0};
	struct faults faults = {0};
	enum media_type type, accept;
	unsigned outputs;
	enum err err;

	if (!exchange_check_content_type(x, 1u << MEDIA_JSON, &type) ||
	    !evaluation_check_accept(x, &accept) ||
	    !evaluation_check_outputs(x, &outputs))
		return;
	err = parse(x, outputs, &body, &faults);
	if (err == ERR_OK)
		begin(x, &body, accept);
	else
		evaluation_reply_faults(x, err, &faults);
	eval_request_fini(&body);
}
