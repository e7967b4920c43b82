#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include <cjson/cJSON.h>

#include "core/tape.h"
#include "proto/document.h"
#include "proto/fault.h"
#include "server/config.h"
#include "server/evaluation.h"
#include "server/exchange.h"
#include "server/handlers.h"
#include "server/limits.h"
#include "server/program.h"
#include "server/scene_reply.h"
#include "server/scene_store.h"
#include "server/server.h"

/* Scenes in one answer of the list, and unless the query says. */
#define LIST_MAX 1000

static enum err parse(struct exchange *x, struct document **out,
    struct faults *faults)
{
	const struct document_limits limits = limits_new(x->server);

	return document_parse(x->body != NULL ? x->body : "", x->body_length,
	    &limits, out, faults);
}

static struct scene *make_scene(struct exchange *x, const char *id,
    struct document *document)
{
	struct program *program;
	struct scene *scene;
	enum err err;

	if (!evaluation_compile(x, "", document, &program))
		return NULL;
	err = scene_create(x->server->scheduler, id, document_name(document),
	    x->body, x->body_length, program, &scene);
	if (err != ERR_OK) {
		exchange_reply_problem(x, problem_from_err(err), NULL,
		    "The scene could not be kept: %s.", err_message(err));
		return NULL;
	}
	scene->nodes = program->tape->node_count;
	return scene;
}

/* A revision under id of the document in x's body; or answers, NULL. */
static struct scene *read_scene(struct exchange *x, const char *id)
{
	struct faults faults = {0};
	struct document *document;
	struct scene *scene;
	enum media_type type;
	enum err err;

	if (!exchange_check_content_type(x, 1u << MEDIA_JSON, &type))
		return NULL;
	err = parse(x, &document, &faults);
	if (err != ERR_OK) {
		evaluation_reply_faults(x, err, &faults);
		return NULL;
	}
	scene = make_scene(x, id, document);
	document_free(document);
	return scene;
}

static void reply_kept(struct exchange *x, const struct scene *scene,
    bool replaced)
{
	char location[sizeof "/v1/scenes/" + SCENE_ID_MAX];

	exchange_reply_json(x, replaced ? 200 : 201,
	    scene_reply_summary(scene));
	exchange_add_header(x, "ETag", scene->etag);
	snprintf(location, sizeof location, "/v1/scenes/%s", scene->id);
	if (!replaced)
		exchange_add_header(x, "Location", location);
}

static void reply_full(struct exchange *x, const struct scene *scene)
{
	const struct config *config = x->server->config;

	exchange_reply_problem(x, PROBLEM_STORE_FULL, NULL,
	    "%zu of at most %zu scenes are kept, in %zu of at most %zu bytes; "
	    "this one needs %zu bytes. Delete some.",
	    scene_store_count(x->server->scenes), config->max_scenes,
	    scene_store_bytes(x->server->scenes), config->scene_memory,
	    scene->bytes);
}

static void keep(struct exchange *x, const char *id,
    const struct precondition *precondition)
{
	struct scene *scene = read_scene(x, id);
	bool replaced;
	enum err err;

	if (scene == NULL)
		return;
	err = scene_store_put(x->server->scenes, scene, precondition,
	    &replaced);
	if (err == ERR_OK)
		reply_kept(x, scene, replaced);
	else if (err == ERR_CONFLICT)
		scene_reply_changed(x);
	else if (err == ERR_LIMIT)
		reply_full(x, scene);
	else
		exchange_reply_problem(x, problem_from_err(err), NULL,
		    "The scene could not be kept: %s.", err_message(err));
	scene_release(scene);
}

void handle_scenes_post(struct exchange *x)
{
	static const struct precondition none = {NULL, NULL};
	char id[SCENE_ID_MAX + 1];

	if (scene_id_random(id) == ERR_OK)
		keep(x, id, &none);
	else
		exchange_reply_problem(x, PROBLEM_INTERNAL, NULL,
		    "No random id could be made.");
}

void handle_scene_put(struct exchange *x)
{
	struct precondition precondition;

	if (!scene_reply_preconditions(x, &precondition))
		return;
	if (!scene_id_is_valid(x->id)) {
		exchange_reply_problem(x, PROBLEM_INVALID, NULL,
		    "A scene's id has 1 to %d of A-Z a-z 0-9 _ . - and is "
		    "neither . nor ..", SCENE_ID_MAX);
		return;
	}
	keep(x, x->id, &precondition);
}

static void release_scene(void *owner)
{
	scene_release(owner);
}

/* Takes scene over. With 304 only the head that 200 would have is sent. */
static void reply_scene(struct exchange *x, unsigned status,
    struct scene *scene)
{
	char etag[ETAG_SIZE];

	strcpy(etag, scene->etag);
	exchange_reply_borrowed(x, status, MEDIA_JSON, scene->text,
	    scene->length, release_scene, scene);
	exchange_add_header(x, "ETag", etag);
}

void handle_scene_get(struct exchange *x)
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
		scene_release(scene);
	} else if (!precondition_none_match(&precondition, scene->etag)) {
		reply_scene(x, 304, scene);
	} else {
		reply_scene(x, 200, scene);
	}
}

void handle_scene_delete(struct exchange *x)
{
	struct precondition precondition;
	enum err err;

	if (!scene_reply_preconditions(x, &precondition))
		return;
	err = scene_store_delete(x->server->scenes, x->id, &precondition);
	if (err == ERR_OK)
		exchange_reply_empty(x, 204);
	else if (err == ERR_CONFLICT)
		scene_reply_changed(x);
	else
		scene_reply_absent(x);
}

/* ?limit, 1 to LIST_MAX; or answers 400: false. */
static bool read_limit(struct exchange *x, size_t *out)
{
	const char *text = exchange_query(x, "limit");
	unsigned long limit;
	char *end;

	*out = LIST_MAX;
	if (text == NULL)
		return true;
	limit = strtoul(text, &end, 10);
	if (text[0] >= '0' && text[0] <= '9' && *end == '\0' && limit >= 1 &&
	    limit <= LIST_MAX) {
		*out = limit;
		return true;
	}
	exchange_reply_problem(x, PROBLEM_MALFORMED, NULL,
	    "limit is a whole number from 1 to %d.", LIST_MAX);
	return false;
}

void handle_scenes_list(struct exchange *x)
{
	const char *after = exchange_query(x, "after");
	struct scene *list[LIST_MAX];
	cJSON *json, *scenes;
	size_t limit, count;
	bool more;

	if (!read_limit(x, &limit))
		return;
	count = scene_store_list(x->server->scenes, after != NULL ? after : "",
	    limit, list, &more);
	json = cJSON_CreateObject();
	scenes = cJSON_AddArrayToObject(json, "scenes");
	for (size_t i = 0; i < count; i++) {
		cJSON_AddItemToArray(scenes, scene_reply_summary(list[i]));
		if (more && i + 1 == count)
			cJSON_AddStringToObject(json, "next", list[i]->id);
		scene_release(list[i]);
	}
	exchange_reply_json(x, 200, json);
}
