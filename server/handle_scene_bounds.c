#include <math.h>
#include <stdlib.h>

#include <cjson/cJSON.h>

#include "core/bounds.h"
#include "core/tape.h"
#include "core/tree.h"
#include "proto/document.h"
#include "server/exchange.h"
#include "server/handlers.h"
#include "server/program.h"
#include "server/scene_document.h"
#include "server/scene_refresh.h"
#include "server/scene_reply.h"
#include "server/scene_store.h"
#include "server/surface.h"
#include "server/task.h"

/* The value whose level set is the surface. */
#define ISO 0.5

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

/* null where there is no surface, or it is not shown to end. */
static cJSON *surface_json(const struct tape_box *box)
{
	const struct bounds b = {
		{box->min[0], box->min[1], box->min[2]},
		{box->max[0], box->max[1], box->max[2]},
	};
	cJSON *json;

	if (bounds_is_empty(&b) || !bounds_is_finite(&b))
		return cJSON_CreateNull();
	json = cJSON_CreateObject();
	cJSON_AddItemToObject(json, "min", corner_json(b.min));
	cJSON_AddItemToObject(json, "max", corner_json(b.max));
	return json;
}

static void reply_bounds(struct exchange *x, const struct bounds *support,
    const struct tape_box *surface)
{
	cJSON *json = bounds_json(support);

	cJSON_AddItemToObject(json, "surface", surface_json(surface));
	exchange_reply_json(x, 200, json);
}

/* ---- as a task: the surface is looked for ---- */

struct bounds_work {
	struct bounds support;
	struct tape_box surface;
};

static enum err work(struct task *task, void *ctx)
{
	struct bounds_work *w = ctx;

	return task_extent(task, ISO, &w->surface);
}

static void answer(struct exchange *x, void *ctx)
{
	struct bounds_work *w = ctx;

	reply_bounds(x, &w->support, &w->surface);
}

static bool is_small(const void *ctx)
{
	(void)ctx;
	return true;
}

/* Takes scene over. */
static void begin_task(struct exchange *x, struct scene *scene,
    const struct bounds *support)
{
	static const struct task_kind kind = {work, answer, free, NULL,
	    is_small};
	struct bounds_work *w = malloc(sizeof *w);

	if (w == NULL) {
		scene_release(scene);
		exchange_reply_problem(x, PROBLEM_MEMORY, NULL,
		    "There was no memory for the scene's bounds.");
		return;
	}
	w->support = *support;
	task_begin(x, scene, &kind, w);
}

/* Takes scene over. */
static void answer_bounds(struct exchange *x, struct scene *scene)
{
	struct document *document;
	struct tape_box surface;
	struct bounds support;

	if (!scene_document_read(x, scene, &document)) {
		scene_release(scene);
		return;
	}
	support = bounds_of_node(document_tree(document)->root);
	document_free(document);
	if (!surface_knows(scene->program->surface, ISO, &surface)) {
		begin_task(x, scene, &support);
		return;
	}
	reply_bounds(x, &support, &surface);
	exchange_add_header(x, "ETag", scene->etag);
	scene_release(scene);
}

void handle_scene_bounds(struct exchange *x)
{
	struct precondition precondition;
	struct scene *scene;

	if (!scene_reply_preconditions(x, &precondition))
		return;
	scene = scene_refresh_get(x, &precondition);
	if (scene == NULL)
		return;
	if (precondition_none_match(&precondition, scene->etag)) {
		answer_bounds(x, scene);
		return;
	}
	exchange_reply_empty(x, 304);
	exchange_add_header(x, "ETag", scene->etag);
	scene_release(scene);
}
