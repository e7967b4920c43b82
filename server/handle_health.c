#include <cjson/cJSON.h>

#include "server/exchange.h"
#include "server/handlers.h"
#include "server/scheduler.h"
#include "server/server.h"

static void reply_status(struct exchange *x, const char *status)
{
	cJSON *json = cJSON_CreateObject();

	cJSON_AddStringToObject(json, "status", status);
	exchange_reply_json(x, 200, json);
	exchange_add_header(x, "Cache-Control", "no-store");
}

void handle_healthz(struct exchange *x)
{
	reply_status(x, "ok");
}

void handle_readyz(struct exchange *x)
{
	struct scheduler_stats stats;

	scheduler_get_stats(x->server->scheduler, &stats);
	if (atomic_load(&x->server->draining))
		exchange_reply_problem(x, PROBLEM_DRAINING, NULL,
		    "The server is shutting down.");
	else if (!stats.ready)
		exchange_reply_problem(x, PROBLEM_NOT_READY, NULL,
		    "The device and its operator tables are being made "
		    "ready.");
	else
		reply_status(x, "ready");
}
