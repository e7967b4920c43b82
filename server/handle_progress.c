#include <cjson/cJSON.h>

#include "server/exchange.h"
#include "server/handlers.h"
#include "server/server.h"
#include "server/task.h"

void handle_progress(struct exchange *x)
{
	cJSON *json = tasks_progress(x->server->tasks, x->id);

	if (json != NULL)
		exchange_reply_json(x, 200, json);
	else
		exchange_reply_problem(x, PROBLEM_NOT_FOUND, NULL,
		    "No request with ?progress=%.64s waits or runs.", x->id);
}
