#include "server/scene_refresh.h"

#include <stdio.h>
#include <stdlib.h>

#include "server/exchange.h"
#include "server/readers.h"
#include "server/scene_reply.h"
#include "server/scene_store.h"
#include "server/server.h"

/* x->state while the store is asked, */
struct refreshing {
	struct scene_change change;
	struct exchange *x;
};

/* ... and when the handler begins anew: handlers may put their own instead. */
static char refreshed;

static void free_refreshing(void *state, struct server *server)
{
	struct refreshing *r = state;

	(void)server;
	if (r->change.now != NULL)
		scene_release(r->change.now);
	free(r);
}

static void free_nothing(void *state, struct server *server)
{
	(void)state, (void)server;
}

static void on_done(void *ctx)
{
	struct refreshing *r = ctx;

	exchange_resume(r->x);
}

static void reply_unknown(struct exchange *x, enum err err)
{
	exchange_reply_problem(x, problem_from_err(err), NULL,
	    "This daemon does not have scene '%s' as it is asked for, and "
	    "cannot look whether others have it: %s.", x->id,
	    err_message(err));
}

static void begin_anew(struct exchange *x)
{
	struct refreshing *r = x->state;
	enum err err = r->change.result;

	free_refreshing(r, x->server);
	x->state = &refreshed;
	x->state_free = free_nothing;
	if (err == ERR_OK || err == ERR_NOT_FOUND)
		readers_handle(x);
	else
		reply_unknown(x, err);
}

/* Has x wait for what others have of its scene. */
static void ask(struct exchange *x)
{
	struct refreshing *r = calloc(1, sizeof *r);

	if (r == NULL) {
		exchange_reply_problem(x, PROBLEM_MEMORY, NULL,
		    "There was no memory to look for the scene.");
		return;
	}
	r->x = x;
	r->change = (struct scene_change){.kind = SCENE_REFRESH,
	    .done = on_done, .ctx = r};
	/* It is valid, so not too long. */
	snprintf(r->change.id, sizeof r->change.id, "%.*s", SCENE_ID_MAX,
	    x->id);
	x->state = r;
	x->state_free = free_refreshing;
	scene_reply_wait(x, &r->change, begin_anew);
}

/* Whether others may have what this daemon has not, which is not asked yet. */
static bool may_ask(const struct exchange *x)
{
	return x->state != &refreshed &&
	    scene_store_is_shared(x->server->scenes) &&
	    scene_store_is_ready(x->server->scenes) &&
	    scene_id_is_valid(x->id);
}

struct scene *scene_refresh_get(struct exchange *x,
    const struct precondition *precondition)
{
	struct scene *scene = scene_store_get(x->server->scenes, x->id);

	if (scene != NULL && precondition_match(precondition, scene->etag))
		return scene;
	if (may_ask(x))
		ask(x);
	else if (scene == NULL)
		scene_reply_absent(x);
	else
		scene_reply_changed(x);
	if (scene != NULL)
		scene_release(scene);
	return NULL;
}

struct scene *scene_refresh_find(struct exchange *x)
{
	struct scene *scene = scene_store_find(x->server->scenes, x->id);

	if (scene != NULL)
		return scene;
	if (may_ask(x))
		ask(x);
	else
		scene_reply_absent(x);
	return NULL;
}
