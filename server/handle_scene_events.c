#include <stdlib.h>
#include <string.h>

#include "server/config.h"
#include "server/events.h"
#include "server/exchange.h"
#include "server/handlers.h"
#include "server/scene_refresh.h"
#include "server/scene_reply.h"
#include "server/scene_store.h"
#include "server/server.h"
#include "server/token.h"

/* A client that reconnects says what it has had: browsers by the header, others
 * by the query. NULL: nothing. */
static const char *last_id(struct exchange *x)
{
	const char *text = exchange_header(x, "Last-Event-ID");

	if (text == NULL || text[0] == '\0')
		text = exchange_query(x, "last_event_id");
	return text != NULL && text[0] != '\0' ? text : NULL;
}

static void reply_err(struct exchange *x, enum err err)
{
	const size_t most = x->server->config->max_listeners;
	const bool has_token = x->token != NULL &&
	    !token_is_anonymous(x->token);

	if (err == ERR_LIMIT)
		exchange_reply_problem(x, PROBLEM_TOO_MANY, NULL,
		    "%s '%s' has %zu listeners to scenes, as many as one may: "
		    "a quarter of --max-listeners.", has_token ? "The token" :
		    "The address", has_token ? x->token->name : x->peer,
		    events_share(most));
	else if (err == ERR_BUSY)
		exchange_reply_problem(x, PROBLEM_QUEUE_FULL, NULL,
		    "%zu clients listen to scenes, as many as may "
		    "(--max-listeners).", most);
	else
		exchange_reply_problem(x, problem_from_err(err), NULL,
		    "The events cannot be sent: %s.", err_message(err));
}

static void describe(const struct scene *scene, struct scene_event *out)
{
	*out = (struct scene_event){.seq = scene->seq, .time = scene->time,
	    .nodes = scene->nodes, .length = scene->length};
	strcpy(out->id, scene->id);
	strcpy(out->etag, scene->etag);
}

/* Events of the past at most; who has missed more gets the present one. */
#define PAST_MAX 1024

/* What has happened since after, in list. *missed: not all of it is known. */
static size_t read_past(struct server *server, const char *id,
    struct scene_seq after, size_t most, struct scene_event *list,
    bool *missed)
{
	size_t count = scene_store_since(server->scenes, id, after, most, list,
	    missed);

	/* There may be more; or the scene is a new one under an old id, and
	 * whoever has had an event of the old one has missed its end. 0 is the
	 * id of none. */
	if (count == most || (count > 0 && list[0].is_first &&
	    after.major != 0))
		*missed = true;
	return count;
}

/* Answers x with the stream, from after on, NULL: from the present. */
static void begin(struct exchange *x, struct listener *l,
    const struct scene *scene, const struct scene_seq *after)
{
	const size_t kept = x->server->config->history;
	const size_t most = 1 + (kept < PAST_MAX ? kept : PAST_MAX);
	struct scene_event *past = calloc(most, sizeof *past);
	bool missed = false;
	size_t count = 0;

	if (past == NULL) {
		reply_err(x, ERR_MEMORY);
		return;
	}
	if (after != NULL)
		count = read_past(x->server, x->id, *after, most, past,
		    &missed);
	if (after == NULL || missed) {
		describe(scene, &past[0]);
		count = 1;
	}
	events_begin(l, past, count, missed, after != NULL && !missed ?
	    *after : scene->seq);
}

void handle_scene_events(struct exchange *x)
{
	const char *text = last_id(x);
	struct scene_seq after;
	struct listener *l;
	struct scene *scene;
	enum err err;

	if (text != NULL && !scene_seq_parse(text, &after)) {
		exchange_reply_problem(x, PROBLEM_MALFORMED, NULL,
		    "Last-Event-ID is the id of an event, such as 12 or "
		    "1700000000000-1, not '%.60s'.", text);
		return;
	}
	/* Another daemon may have it; then this handler begins anew. */
	scene = scene_refresh_find(x);
	if (scene == NULL)
		return;
	scene_release(scene);
	err = events_listen(x->server->events, x, x->id, &l);
	if (err != ERR_OK) {
		reply_err(x, err);
		return;
	}
	/* From here on nothing is missed: now to what has been. */
	scene = scene_store_find(x->server->scenes, x->id);
	if (scene == NULL) {
		scene_reply_absent(x);
		return;
	}
	begin(x, l, scene, text != NULL ? &after : NULL);
	scene_release(scene);
}
