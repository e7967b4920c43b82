#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include <cjson/cJSON.h>

#include "proto/fault.h"
#include "server/config.h"
#include "server/evaluation.h"
#include "server/exchange.h"
#include "server/handlers.h"
#include "server/http.h"
#include "server/limits.h"
#include "server/scene_build.h"
#include "server/scene_refresh.h"
#include "server/scene_reply.h"
#include "server/scene_store.h"
#include "server/server.h"

/* Scenes in one answer of the list, and unless the query says. */
#define LIST_MAX 1000

/* A revision under id of the document in x's body; or answers, NULL. */
static struct scene *read_scene(struct exchange *x, const char *id)
{
	const struct document_limits limits = limits_new(x->server);
	struct faults faults = {0};
	struct scene *scene;
	enum media_type type;
	enum err err;

	if (!exchange_check_content_type(x, 1u << MEDIA_JSON, &type))
		return NULL;
	err = scene_build(x->server, &limits, id, x->body != NULL ? x->body :
	    "", x->body_length, &scene, &faults);
	if (err == ERR_OK)
		return scene;
	evaluation_reply_faults(x, err, &faults);
	return NULL;
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

static void reply_full(struct exchange *x, const struct scene *scene,
    bool is_owners)
{
	const struct config *config = x->server->config;

	if (is_owners) {
		exchange_reply_problem(x, PROBLEM_STORE_FULL, NULL,
		    "The token '%s' may have %zu scenes, and has them. Delete "
		    "some.", access_owner(x), access_scenes_most(x));
		return;
	}
	exchange_reply_problem(x, PROBLEM_STORE_FULL, NULL,
	    "%zu of at most %zu scenes (--max-scenes) are kept, in %zu of at "
	    "most %zu bytes (--scene-memory); this one needs %zu bytes. Delete "
	    "some.",
	    scene_store_count(x->server->scenes), config->max_scenes,
	    scene_store_bytes(x->server->scenes), config->scene_memory,
	    scene->bytes);
}

/* A change that x waits for: x->state. */
struct waiting {
	struct scene_change change;
	struct exchange *x;
	struct scene *scene; /* SCENE_PUT: what was sent */
};

static void free_waiting(void *state, struct server *server)
{
	struct waiting *w = state;

	(void)server;
	if (w->scene != NULL)
		scene_release(w->scene);
	if (w->change.now != NULL)
		scene_release(w->change.now);
	free(w->change.text);
	free(w);
}

static void on_done(void *ctx)
{
	struct waiting *w = ctx;

	exchange_resume(w->x);
}

static void reply_failure(struct exchange *x, const struct waiting *w)
{
	enum err err = w->change.result;

	if (err == ERR_CONFLICT)
		scene_reply_changed(x);
	else if (err == ERR_NOT_FOUND)
		scene_reply_missing(x);
	else if (err == ERR_LIMIT && w->scene != NULL)
		reply_full(x, w->scene, w->change.is_owners);
	else if (err == ERR_UNAVAILABLE)
		exchange_reply_problem(x, PROBLEM_UNAVAILABLE, NULL,
		    "The scene could not be changed: %s. If it was lost in "
		    "this very moment, the change may be found there later: "
		    "look before you make it again.", err_message(err));
	else
		exchange_reply_problem(x, problem_from_err(err), NULL,
		    "The scene could not be changed: %s; nothing has changed.",
		    err_message(err));
}

static void answer(struct exchange *x)
{
	struct waiting *w = x->state;

	if (w->change.result != ERR_OK)
		reply_failure(x, w);
	else if (w->change.kind == SCENE_DELETE)
		exchange_reply_empty(x, 204);
	else
		reply_kept(x, w->change.now != NULL ? w->change.now : w->scene,
		    w->change.replaced);
}

/* A change for x to wait for; or answers: NULL. Takes scene (or NULL) over. */
static struct waiting *make_waiting(struct exchange *x,
    enum scene_change_kind kind, const char *id, struct scene *scene)
{
	struct waiting *w = calloc(1, sizeof *w);

	if (w == NULL) {
		if (scene != NULL)
			scene_release(scene);
		exchange_reply_problem(x, PROBLEM_MEMORY, NULL,
		    "There was no memory for the request.");
		return NULL;
	}
	w->x = x;
	w->scene = scene;
	w->change.kind = kind;
	w->change.scenes_most = access_scenes_most(x);
	w->change.done = on_done;
	w->change.ctx = w;
	strncpy(w->change.id, id, SCENE_ID_MAX);
	return w;
}

static void wait_for(struct exchange *x, struct waiting *w,
    void (*resumed)(struct exchange *x))
{
	if (w->scene != NULL)
		w->change.scene = scene_hold(w->scene);
	x->state = w;
	x->state_free = free_waiting;
	scene_reply_wait(x, &w->change, resumed);
}

/* Has x wait for the change. Takes scene (or NULL) over. */
static void submit(struct exchange *x, enum scene_change_kind kind,
    const char *id, struct scene *scene,
    const struct precondition *precondition)
{
	struct waiting *w = make_waiting(x, kind, id, scene);

	if (w == NULL)
		return;
	w->change.precondition = *precondition;
	wait_for(x, w, answer);
}

static void keep(struct exchange *x, const char *id,
    const struct precondition *precondition)
{
	struct scene *scene = read_scene(x, id);

	if (scene == NULL)
		return;
	/* It may wait; the scene has the text. */
	exchange_release_body(x);
	/* Whose it is: kept when others change it. */
	snprintf(scene->owner, sizeof scene->owner, "%s", access_owner(x));
	submit(x, SCENE_PUT, id, scene, precondition);
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

/* ---- a revision that is past ---- */

static void answer_revision(struct exchange *x)
{
	struct waiting *w = x->state;
	enum err err = w->change.result;
	struct precondition precondition;

	if (err == ERR_NOT_FOUND) {
		exchange_reply_problem(x, PROBLEM_NOT_FOUND, NULL,
		    "That revision of scene '%s' is not kept (any more); GET "
		    "/v1/scenes/%s/revisions lists those that are.", x->id,
		    x->id);
		return;
	}
	if (err != ERR_OK) {
		exchange_reply_problem(x, problem_from_err(err), NULL,
		    "The revision could not be read: %s.", err_message(err));
		return;
	}
	if (!scene_reply_preconditions(x, &precondition))
		return;
	if (!precondition_match(&precondition, w->change.etag)) {
		scene_reply_changed(x);
		return;
	}
	/* Until its reader has taken it. */
	if (!http_take_text(x, w->change.length)) {
		exchange_reply_problem(x, PROBLEM_MEMORY, NULL,
		    "Too many large texts are on their way at once.");
		return;
	}
	exchange_reply_data(x, precondition_none_match(&precondition,
	    w->change.etag) ? 200 : 304, MEDIA_JSON, w->change.text,
	    w->change.length);
	w->change.text = NULL;
	exchange_add_header(x, "ETag", w->change.etag);
}

/* ?revision, whose hash text is. */
static void get_revision(struct exchange *x, const char *text)
{
	struct waiting *w;

	if (strlen(text) != ETAG_DIGITS ||
	    strspn(text, "0123456789abcdef") != ETAG_DIGITS) {
		exchange_reply_problem(x, PROBLEM_MALFORMED, NULL,
		    "revision has %d digits 0-9 a-f, such as a summary's "
		    "revision has.", ETAG_DIGITS);
		return;
	}
	w = make_waiting(x, SCENE_READ, x->id, NULL);
	if (w == NULL)
		return;
	snprintf(w->change.etag, sizeof w->change.etag, "\"%s\"", text);
	wait_for(x, w, answer_revision);
}

void handle_scene_get(struct exchange *x)
{
	static const struct precondition none = {NULL, NULL};
	const char *revision = exchange_query(x, "revision");
	struct precondition precondition;
	struct scene *scene;

	if (!scene_reply_preconditions(x, &precondition))
		return;
	scene = scene_store_find(x->server->scenes, x->id);
	if (scene == NULL)
		scene = scene_refresh_get(x, &none);
	if (scene == NULL)
		return;
	if (revision != NULL && (strlen(revision) != ETAG_DIGITS ||
	    strncmp(scene->etag + 1, revision, ETAG_DIGITS) != 0)) {
		scene_release(scene);
		get_revision(x, revision);
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

	if (scene_reply_preconditions(x, &precondition))
		submit(x, SCENE_DELETE, x->id, NULL, &precondition);
}

void handle_scenes_list(struct exchange *x)
{
	const char *after = exchange_query(x, "after");
	struct scene *list[LIST_MAX];
	cJSON *json, *scenes;
	size_t limit, count;
	bool more;

	if (!scene_reply_limit(x, LIST_MAX, &limit))
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
