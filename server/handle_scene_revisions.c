#include <stdlib.h>

#include <cjson/cJSON.h>

#include "server/config.h"
#include "server/exchange.h"
#include "server/handlers.h"
#include "server/scene_refresh.h"
#include "server/scene_reply.h"
#include "server/scene_store.h"
#include "server/server.h"

/* Revisions in one answer. */
#define LIST_MAX 1000

/* ?limit and ?before; or answers 400: false. */
static bool read_query(struct exchange *x, size_t *limit,
    struct scene_seq *before, bool *has_before)
{
	const char *text = exchange_query(x, "before");

	*has_before = text != NULL;
	if (text != NULL && !scene_seq_parse(text, before)) {
		exchange_reply_problem(x, PROBLEM_MALFORMED, NULL,
		    "before is a revision's sequence, such as next has it.");
		return false;
	}
	return scene_reply_limit(x, LIST_MAX, limit);
}

static cJSON *describe(const struct scene_event *event)
{
	cJSON *json = cJSON_CreateObject();

	scene_reply_add_revision(json, event->etag, event->seq, event->time);
	cJSON_AddNumberToObject(json, "nodes", (double)event->nodes);
	cJSON_AddNumberToObject(json, "bytes", (double)event->length);
	return json;
}

/* There is one more than limit if others follow. */
static void reply(struct exchange *x, const struct scene_event *list,
    size_t count, size_t limit)
{
	cJSON *json = cJSON_CreateObject();
	cJSON *revisions = cJSON_AddArrayToObject(json, "revisions");
	char next[SCENE_SEQ_SIZE];

	for (size_t i = 0; i < count && i < limit; i++)
		cJSON_AddItemToArray(revisions, describe(list + i));
	if (count > limit) {
		scene_seq_print(list[limit - 1].seq, next);
		cJSON_AddStringToObject(json, "next", next);
	}
	exchange_reply_json(x, 200, json);
}

void handle_scene_revisions(struct exchange *x)
{
	struct scene_event *list;
	struct scene_seq before;
	struct scene *scene;
	size_t limit, count;
	bool has_before;

	if (!read_query(x, &limit, &before, &has_before))
		return;
	scene = scene_refresh_find(x);
	if (scene == NULL)
		return;
	scene_release(scene);
	list = malloc((limit + 1) * sizeof *list);
	if (list == NULL) {
		exchange_reply_problem(x, PROBLEM_MEMORY, NULL,
		    "There was no memory for the answer.");
		return;
	}
	count = scene_store_history(x->server->scenes, x->id,
	    has_before ? &before : NULL, limit + 1, list);
	reply(x, list, count, limit);
	free(list);
}
