#include "server/scene_reply.h"

#include <cjson/cJSON.h>

#include "server/exchange.h"
#include "server/scene_store.h"

bool scene_reply_preconditions(struct exchange *x, struct precondition *out)
{
	out->match = exchange_header(x, "If-Match");
	out->none_match = exchange_header(x, "If-None-Match");
	if (precondition_is_valid(out))
		return true;
	exchange_reply_problem(x, PROBLEM_MALFORMED, NULL,
	    "If-Match and If-None-Match take * or entity tags in double "
	    "quotes, such as the ETag header has.");
	return false;
}

void scene_reply_absent(struct exchange *x)
{
	exchange_reply_problem(x, PROBLEM_NOT_FOUND, NULL,
	    "There is no scene '%s'.", x->id);
}

void scene_reply_changed(struct exchange *x)
{
	exchange_reply_problem(x, PROBLEM_PRECONDITION, NULL,
	    "Scene '%s' is not in the state that If-Match or If-None-Match "
	    "asks for; GET it for its present ETag.", x->id);
}

struct cJSON *scene_reply_summary(const struct scene *scene)
{
	cJSON *json = cJSON_CreateObject();
	char revision[ETAG_SIZE];

	for (int i = 0; i < ETAG_DIGITS; i++)
		revision[i] = scene->etag[i + 1];
	revision[ETAG_DIGITS] = '\0';
	cJSON_AddStringToObject(json, "id", scene->id);
	cJSON_AddStringToObject(json, "name", scene->name);
	cJSON_AddStringToObject(json, "revision", revision);
	cJSON_AddNumberToObject(json, "nodes", (double)scene->nodes);
	cJSON_AddNumberToObject(json, "bytes", (double)scene->length);
	return json;
}
