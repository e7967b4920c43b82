/*
 * PATCH: the patch is read and applied to the present revision. Where somebody
 * else is faster, it is applied again, to what is there then. x waits, and with
 * it what this file keeps of it.
 *
 * Which thread that is: of small patches of small scenes the HTTP thread, then
 * the store's writer. What is large goes to the store's worker, which does one
 * after another, and has each kept before the next one begins: so that nobody
 * waits for it but other large ones, and it is seldom done in vain. Who loses to
 * others (PUT, other daemons) again and again is made anew by the writer at last.
 * Neither writer nor worker touches the exchange, but for its body, and to see
 * whether its client is there.
 */
#include <stdint.h>
#include <stdlib.h>
#include <string.h>
#include <strings.h>

#include <cjson/cJSON.h>

#include "proto/arena.h"
#include "proto/fault.h"
#include "proto/json_patch.h"
#include "server/access.h"
#include "server/config.h"
#include "server/evaluation.h"
#include "server/exchange.h"
#include "server/handlers.h"
#include "server/limits.h"
#include "server/scene_build.h"
#include "server/scene_refresh.h"
#include "server/scene_reply.h"
#include "server/scene_store.h"
#include "server/server.h"

/* Values that an operation has, besides the one it brings. */
#define OPERATION_VALUES 5

/* Bytes of a scene or of a patch above which it is large. To patch a scene of
 * 8 KB takes 0.3 ms, of 32 KB 1.05 ms, of 2.4 MB 0.1 s. */
#define SMALL_BYTES 16384

/* Times that a large one is made in vain before it is the writer's. */
#define LOSSES_MAX 3

/* A patch that x waits for: x->state. */
struct patching {
	struct scene_change change;
	struct scene_work work;
	struct exchange *x;
	struct server *server;
	struct arena arena;      /* of the patch */
	struct json_patch patch;
	bool is_read;
	struct scene *now;       /* what it is made from next, or NULL */
	bool is_newest;          /* the writer has said so */
	bool is_over;            /* the worker had it */
	/* why there is no new revision */
	enum err err;
	bool is_document;        /* what the patch makes is wrong, not it */
	struct faults faults;
};

static void free_patching(void *state, struct server *server)
{
	struct patching *p = state;

	(void)server;
	if (p->change.now != NULL)
		scene_release(p->change.now);
	if (p->now != NULL)
		scene_release(p->now);
	arena_fini(&p->arena);
	free(p);
}

/* ---- from a revision to the next ---- */

/*
 * What the patch makes of now, in *out. It may use volumes that have been
 * forgotten, as what it is made of may. Any thread.
 */
static enum err make(struct patching *p, const struct scene *now,
    struct scene **out)
{
	const struct document_limits limits = limits_kept(p->server);
	struct scene *scene;
	size_t length;
	char *text;

	p->is_document = false;
	p->faults.count = 0;
	p->err = json_patch_text(&p->patch, now->text, now->length, &text,
	    &length, &p->faults);
	if (p->err != ERR_OK)
		return p->err;
	p->is_document = true;
	p->err = scene_build(p->server, &limits, now->id, text, length, &scene,
	    &p->faults);
	free(text);
	if (p->err != ERR_OK)
		return p->err;
	strcpy(scene->owner, now->owner);
	*out = scene;
	return ERR_OK;
}

/* struct scene_change, rebase: on the writer's thread. */
static enum err rebase(void *ctx, const struct scene *now,
    struct scene **out)
{
	return now != NULL ? make(ctx, now, out) : ERR_NOT_FOUND;
}

/* Reads the patch of the request's body, which is no JSON, or none that can be
 * applied: p->err, p->faults. Any thread. */
static enum err read_patch(struct patching *p)
{
	const struct document_limits limits = limits_kept(p->server);
	struct exchange *x = p->x;
	struct cJSON *patch;

	p->patch.values_most = document_values_max(&limits);
	if (p->patch.values_most > SIZE_MAX / 2)
		p->patch.values_most = SIZE_MAX / 2;
	p->patch.bytes_most = p->server->config->max_body;
	p->err = json_patch_read(x->body != NULL ? x->body : "",
	    x->body_length, p->patch.values_most + OPERATION_VALUES *
	    JSON_PATCH_OPERATIONS_MAX, &p->arena, &patch, &p->faults);
	if (p->err != ERR_OK)
		return p->err;
	exchange_release_body(x);
	p->patch.patch = patch;
	p->is_read = true;
	return ERR_OK;
}

/* ---- the worker's ---- */

/*
 * The change, made of p->now. Where others write, too, that may not be what they
 * have: then what seems wrong is for the writer to judge, who asks. It is told
 * that the change is made of nothing that is there. False: p->err.
 */
static bool fill_change(struct patching *p)
{
	struct scene_change *change = &p->change;
	struct scene *scene;

	strcpy(change->base, p->now->etag);
	if (make(p, p->now, &scene) == ERR_OK) {
		change->scene = scene;
	} else if (scene_store_is_shared(p->server->scenes) && !p->is_newest) {
		strcpy(change->base, "\"\"");
		change->scene = scene_hold(p->now);
	} else {
		return false;
	}
	p->err = ERR_OK;
	return true;
}

/* Has the writer keep it. False: it was outdated, and p->now is what is there. */
static bool keep(struct patching *p)
{
	struct scene_change *change = &p->change;

	scene_store_change(p->server->scenes, change);
	if (change->result != ERR_CONFLICT || !change->is_outdated ||
	    change->now == NULL)
		return true;
	scene_release(p->now);
	p->now = change->now;
	p->is_newest = true;
	change->now = NULL;
	return false;
}

/* Whether it is in vain: the writer would say the same. */
static bool is_refused(const struct patching *p)
{
	const struct precondition *asked = &p->change.precondition;
	const char *etag = p->now->etag;

	return !scene_store_is_shared(p->server->scenes) &&
	    (!precondition_match(asked, etag) ||
	    !precondition_none_match(asked, etag));
}

/* Until it is kept, or cannot be. Returns the change's result. */
static enum err make_and_keep(struct patching *p)
{
	for (int losses = 0;; losses++) {
		if (!exchange_is_connected(p->x))
			return ERR_CANCELLED;
		if (is_refused(p))
			return ERR_CONFLICT;
		if (!fill_change(p))
			return p->err;
		p->change.rebase_most = losses >= LOSSES_MAX ? SIZE_MAX : 0;
		if (keep(p))
			return p->change.result;
	}
}

/* scene_work. */
static void work(void *ctx, bool is_cancelled)
{
	struct patching *p = ctx;
	enum err err = ERR_CANCELLED;

	p->is_over = true;
	/* What has been kept while it waited. */
	if (!is_cancelled && !p->is_newest) {
		struct scene *now = scene_store_get(p->server->scenes,
		    p->change.id);

		if (now != NULL) {
			scene_release(p->now);
			p->now = now;
		}
	}
	if (!is_cancelled)
		err = p->is_read ? ERR_OK : read_patch(p);
	if (err == ERR_OK)
		err = make_and_keep(p);
	p->change.result = err;
	exchange_resume(p->x);
}

/* ---- answers ---- */

static void reply_faults(struct exchange *x, const struct patching *p)
{
	const struct fault *first = &p->faults.list[0];
	const char *colon = first->pointer[0] != '\0' ? ": " : "";

	if (p->err == ERR_CONFLICT)
		exchange_reply_problem(x, PROBLEM_CONFLICT, &p->faults,
		    "%s%s%s", first->pointer, colon, first->detail);
	else if (!p->is_document || p->faults.count == 0)
		evaluation_reply_faults(x, p->err, &p->faults);
	else
		exchange_reply_problem(x, p->err == ERR_LIMIT ? PROBLEM_LIMIT :
		    PROBLEM_INVALID, &p->faults, "The document after the "
		    "patch: %s%s%s", first->pointer, colon, first->detail);
}

static void reply_kept(struct exchange *x, const struct scene *scene)
{
	exchange_reply_json(x, 200, scene_reply_summary(scene));
	exchange_add_header(x, "ETag", scene->etag);
}

static void hand_over(struct exchange *x, struct patching *p);

static void answer(struct exchange *x)
{
	struct patching *p = x->state;
	enum err err = p->change.result;

	if (err == ERR_CONFLICT && p->change.is_outdated && !p->is_over)
		hand_over(x, p);
	else if (err == ERR_OK)
		reply_kept(x, p->change.now);
	else if (err == p->err)
		reply_faults(x, p);
	else if (err == ERR_CONFLICT)
		scene_reply_changed(x);
	else if (err == ERR_NOT_FOUND)
		scene_reply_missing(x);
	else if (err == ERR_LIMIT)
		exchange_reply_problem(x, PROBLEM_STORE_FULL, NULL,
		    "There is no room for what the patch makes of it: %zu "
		    "bytes are kept, of at most %zu (--scene-memory). Delete "
		    "some scenes.",
		    scene_store_bytes(x->server->scenes),
		    x->server->config->scene_memory);
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

static void on_done(void *ctx)
{
	struct patching *p = ctx;

	exchange_resume(p->x);
}

/* ---- the request ---- */

/* Whether value says type; its parameters are judged as those of JSON are. */
static bool is_type(const char *value, enum media_type type)
{
	const char *name = media_name(type), *at;
	char json[128] = "application/json";
	enum media_type found;

	if (value == NULL)
		return false;
	at = value + strspn(value, " \t");
	if (strncasecmp(at, name, strlen(name)) != 0 ||
	    strlen(at + strlen(name)) > sizeof json - 32)
		return false;
	strcat(json, at + strlen(name));
	return media_from_content_type(json, &found) && found == MEDIA_JSON;
}

/* Which kind of patch the body is; or answers 415: false. */
static bool read_type(struct exchange *x, bool *is_merge)
{
	static const char form[] = "application/x-www-form-urlencoded";
	const char *value = exchange_header(x, "Content-Type");
	/* What curl says of -d. */
	bool is_form = value != NULL && strncasecmp(value, form,
	    sizeof form - 1) == 0;

	*is_merge = is_type(value, MEDIA_MERGE_PATCH);
	if (*is_merge || is_type(value, MEDIA_JSON_PATCH))
		return true;
	exchange_reply_problem(x, PROBLEM_MEDIA_TYPE, NULL,
	    "Content-Type is '%.100s'; a scene is changed by "
	    "application/json-patch+json, an array of operations, or "
	    "application/merge-patch+json, the members that are to change.%s",
	    value != NULL ? value : "", is_form ? " With curl, add -H "
	    "'Content-Type: application/merge-patch+json'." : "");
	exchange_add_header(x, "Accept-Patch", HANDLERS_PATCH_TYPES);
	return false;
}

/* Has x wait for the worker, which makes it of p->now, or what is there then. */
static void hand_over(struct exchange *x, struct patching *p)
{
	enum err err;

	if (p->change.now != NULL) {
		scene_release(p->now);
		p->now = p->change.now;
		p->change.now = NULL;
	}
	p->work = (struct scene_work){.work = work, .ctx = p};
	x->resumed = answer;
	exchange_wait(x);
	err = scene_store_work(x->server->scenes, &p->work);
	if (err == ERR_OK)
		return;
	p->is_over = true;
	p->change.result = err;
	exchange_resume(x);
}

/* Has x wait for the change as it is filled in. */
static void submit(struct exchange *x, struct patching *p)
{
	struct scene_change *change = &p->change;

	change->rebase_most = SMALL_BYTES;
	change->done = on_done;
	change->ctx = p;
	scene_reply_wait(x, change, answer);
}

/* Reads and applies a small one at once. */
static void patch_small(struct exchange *x, struct patching *p)
{
	if (read_patch(p) != ERR_OK) {
		reply_faults(x, p);
		return;
	}
	if (fill_change(p))
		submit(x, p);
	else
		reply_faults(x, p);
}

/* Patches p->now, or what is there instead when it comes to it. */
static void patch_scene(struct exchange *x, struct patching *p)
{
	if (is_refused(p))
		scene_reply_changed(x);
	else if (x->body_length > SMALL_BYTES || p->now->length > SMALL_BYTES)
		hand_over(x, p);
	else
		patch_small(x, p);
}

/* Takes now over. */
static void patch_now(struct exchange *x, struct scene *now,
    const struct precondition *precondition, bool is_merge)
{
	struct patching *p = calloc(1, sizeof *p);

	if (p == NULL) {
		scene_release(now);
		exchange_reply_problem(x, PROBLEM_MEMORY, NULL,
		    "There was no memory for the patch.");
		return;
	}
	p->x = x;
	p->server = x->server;
	p->now = now;
	p->patch.is_merge = is_merge;
	p->change.kind = SCENE_PUT;
	p->change.precondition = *precondition;
	p->change.scenes_most = access_scenes_most(x);
	p->change.rebase = rebase;
	p->change.rebase_ctx = p;
	strcpy(p->change.id, now->id);
	x->state = p;
	x->state_free = free_patching;
	patch_scene(x, p);
}

void handle_scene_patch(struct exchange *x)
{
	static const struct precondition none = {NULL, NULL};
	struct precondition precondition;
	struct scene *now;
	bool is_merge;

	if (!scene_reply_preconditions(x, &precondition) ||
	    !read_type(x, &is_merge))
		return;
	now = scene_refresh_get(x, &none);
	if (now != NULL)
		patch_now(x, now, &precondition, is_merge);
}
