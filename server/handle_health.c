#include <cjson/cJSON.h>

#include "server/exchange.h"
#include "server/handlers.h"
#include "server/scene_store.h"
#include "server/scheduler.h"
#include "server/server.h"

static void reply_status(struct exchange *x, const char *status)
{
	cJSON *json = cJSON_CreateObject();

	cJSON_AddStringToObject(json, "status", status);
	exchange_reply_json(x, 200, json);
}

void handle_healthz(struct exchange *x)
{
	reply_status(x, "ok");
	exchange_add_header(x, "Cache-Control", "no-store");
}

/* Says which parts are not ready. */
static void reply_not_ready(struct exchange *x, bool device, bool store)
{
	const char *parts = "The device and its operator tables are";

	if (!device && !store)
		parts = "The device and its operator tables, and the scene "
		    "store, are";
	else if (!store)
		parts = "The scene store is";
	exchange_reply_problem(x, PROBLEM_NOT_READY, NULL,
	    "%s being made ready.", parts);
}

void handle_readyz(struct exchange *x)
{
	const struct server *server = x->server;
	struct scheduler_stats stats;
	bool has_store = scene_store_is_ready(server->scenes);

	scheduler_get_stats(server->scheduler, &stats);
	if (atomic_load(&server->draining))
		exchange_reply_problem(x, PROBLEM_DRAINING, NULL,
		    "The server is shutting down.");
	else if (!stats.ready || !has_store)
		reply_not_ready(x, stats.ready, has_store);
	else
		reply_status(x, "ready");
	exchange_add_header(x, "Cache-Control", "no-store");
}
