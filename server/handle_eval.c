#include "proto/document.h"
#include "proto/fault.h"
#include "proto/request.h"
#include "server/evaluation.h"
#include "server/evaluation_body.h"
#include "server/exchange.h"
#include "server/handlers.h"

static void begin(struct exchange *x, struct eval_request *body)
{
	struct evaluation_request request = {
		.points = &body->points,
		.outputs = body->outputs,
		.terms = evaluation_body_terms(x),
	};

	if (evaluation_compile(x, "/scene", body->document,
	    &request.program))
		evaluation_begin(x, &request);
}

void handle_eval(struct exchange *x)
{
	struct eval_request body = {0};
	struct faults faults = {0};
	enum err err = evaluation_body_finish(x, &body, &faults);

	if (err == ERR_OK)
		begin(x, &body);
	else
		evaluation_reply_faults(x, err, &faults);
	eval_request_fini(&body);
}
