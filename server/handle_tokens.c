/*
 * GET /v1/tokens: {"tokens": [{name, role, limits, used}]}; none without a file
 * of them.
 */
#include <cjson/cJSON.h>

#include "server/access.h"
#include "server/exchange.h"
#include "server/handlers.h"
#include "server/scene_store.h"
#include "server/server.h"
#include "server/volume_store.h"

/* What token has now, by its name, beside what it has used. */
static void add_kept(const struct server *server, const cJSON *token)
{
	const char *name = cJSON_GetStringValue(
	    cJSON_GetObjectItemCaseSensitive(token, "name"));
	cJSON *used = cJSON_GetObjectItemCaseSensitive(token, "used");

	if (name == NULL || used == NULL)
		return; /* for want of memory, which is seen later */
	cJSON_AddNumberToObject(used, "scenes",
	    (double)scene_store_count_of(server->scenes, name));
	cJSON_AddNumberToObject(used, "volume_bytes",
	    (double)volume_store_bytes_of(server->volumes, name));
}

void handle_tokens(struct exchange *x)
{
	cJSON *json = access_describe(x->server->access);
	const cJSON *list = cJSON_GetObjectItemCaseSensitive(json, "tokens");
	const cJSON *token;

	cJSON_ArrayForEach(token, list)
		add_kept(x->server, token);
	exchange_reply_json(x, 200, json);
}
