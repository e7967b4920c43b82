#include <math.h>

#include <cjson/cJSON.h>

#include "core/bounds.h"
#include "core/tree.h"
#include "proto/document.h"
#include "server/exchange.h"
#include "server/handlers.h"
#include "server/scene_document.h"
#include "server/scene_reply.h"
#include "server/scene_store.h"
#include "server/server.h"

/* null where a coordinate is infinite. */
static cJSON *corner_json(struct vec3 corner)
{
	const double c[3] = {corner.x, corner.y, corner.z};
	cJSON *json = cJSON_CreateArray();

	for (int i = 0; i < 3; i++)
		cJSON_AddItemToArray(json, isfinite(c[i]) ?
		    cJSON_CreateNumber(c[i]) : cJSON_CreateNull());
	return json;
}

static cJSON *bounds_json(const struct bounds *b)
{
	const bool empty = bounds_is_empty(b);
	cJSON *json = cJSON_CreateObject();

	cJSON_AddItemToObject(json, "min", empty ? cJSON_CreateNull()
	    : corner_json(b->min));
	cJSON_AddItemToObject(json, "max", empty ? cJSON_CreateNull()
	    : corner_json(b->max));
	cJSON_AddBoolToObject(json, "bounded", empty || bounds_is_finite(b));
	cJSON_AddBoolToObject(json, "empty", empty);
	return json;
}

static void reply_bounds(struct exchange *x, const struct scene *scene)
{
	struct document *document;
	struct bounds b;

	if (!scene_document_read(x, scene, &document))
		return;
	b = bounds_of_node(document_tree(document)->root);
	document_free(document);
	exchange_reply_json(x, 200, bounds_json(&b));
	exchange_add_header(x, "ETag", scene->etag);
}

void handle_scene_bounds(struct exchange *x)
{
	struct precondition precondition;
	struct scene *scene;

	if (!scene_reply_preconditions(x, &precondition))
		return;
	scene = scene_store_get(x->server->scenes, x->id);
	if (scene == NULL) {
		scene_reply_absent(x);
		return;
	}
	if (!precondition_match(&precondition, scene->etag)) {
		scene_reply_changed(x);
	} else if (!precondition_none_match(&precondition, scene->etag)) {
		exchange_reply_empty(x, 304);
		exchange_add_header(x, "ETag", scene->etag);
	} else {
		reply_bounds(x, scene);
	}
	scene_release(scene);
}
