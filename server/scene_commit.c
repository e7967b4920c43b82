/*
 * What the writer does with the changes that wait together: each is judged by
 * what will be there when its turn comes (the table, with what this group has
 * decided before it), all are committed at once, then applied.
 */
#include <stdint.h>
#include <stdlib.h>
#include <string.h>

#include "server/clock.h"
#include "server/scene_store_internal.h"
#include "server/server.h"
#include "server/volume_store.h"

/* Attempts where other daemons change the same scene again and again. */
#define ATTEMPTS_MAX 32

/* What patches that are made anew may take of a batch's time. */
#define REBASE_SECONDS 0.02

/* A change decided, and what it waits for: the commit. */
struct decided {
	struct scene_change *change;
	struct scene *before;    /* a reference, or NULL */
	struct scene *after;     /* the change's own; NULL: none */
	bool is_written;         /* else only true if what is before it is */
	size_t write;            /* is_written: its index */
	char expected[ETAG_SIZE];
};

struct group {
	struct scene_store *store;
	size_t count, write_count;
	double rebase_seconds;   /* that patches made anew took */
	struct decided list[SCENE_GROUP_MAX];
	struct backing_write writes[SCENE_GROUP_MAX];
};

/* ---- judging ---- */

/* What is there once the group is kept; borrowed, or NULL. */
static struct scene *present(const struct group *g, const char *id)
{
	const struct scene_slot *slot;

	for (size_t i = g->count; i-- > 0;)
		if (g->list[i].is_written &&
		    strcmp(g->list[i].change->id, id) == 0)
			return g->list[i].after;
	slot = scene_table_find(&g->store->table, id);
	return slot != NULL ? slot->scene : NULL;
}

static bool fulfilled(const struct precondition *precondition,
    const char *etag)
{
	return precondition_match(precondition, etag) &&
	    precondition_none_match(precondition, etag);
}

/* Whether the writer may make change anew from now: it keeps others waiting
 * meanwhile. */
static bool may_rebase(const struct group *g, const struct scene_change *change,
    const struct scene *now)
{
	return change->rebase_most == SIZE_MAX ||
	    (now->length <= change->rebase_most &&
	    g->rebase_seconds < REBASE_SECONDS);
}

/* A patch that was made from something else is made anew from now; or goes back,
 * to be made anew where nobody waits. */
static enum err rebase(struct group *g, struct scene_change *change,
    const struct scene *now)
{
	double begin;
	struct scene *scene;
	enum err err;

	if (change->base[0] == '\0')
		return ERR_OK;
	if (now == NULL)
		return ERR_NOT_FOUND;
	if (strcmp(change->base, now->etag) == 0)
		return ERR_OK;
	change->is_outdated = !may_rebase(g, change, now);
	if (change->is_outdated)
		return ERR_CONFLICT;
	begin = clock_seconds();
	err = change->rebase(change->rebase_ctx, now, &scene);
	g->rebase_seconds += clock_seconds() - begin;
	if (err != ERR_OK)
		return err;
	scene_release(change->scene);
	change->scene = scene;
	strcpy(change->base, now->etag);
	return ERR_OK;
}

/* How the group changes a sum over scenes. */
struct balance {
	size_t more, less;
};

static struct balance balance_of(const struct group *g, const char *owner,
    size_t (*measure)(const struct scene *scene))
{
	struct balance b = {0, 0};

	for (size_t i = 0; i < g->count; i++) {
		const struct decided *d = g->list + i;

		if (!d->is_written)
			continue;
		if (d->after != NULL && (owner == NULL ||
		    strcmp(d->after->owner, owner) == 0))
			b.more += measure(d->after);
		if (d->before != NULL && (owner == NULL ||
		    strcmp(d->before->owner, owner) == 0))
			b.less += measure(d->before);
	}
	return b;
}

static size_t one(const struct scene *scene)
{
	(void)scene;
	return 1;
}

static size_t bytes_of(const struct scene *scene)
{
	return scene->bytes;
}

/* Whether there is room for one more scene, and for its owner to have it. */
static enum err check_count(const struct group *g, struct scene_change *c)
{
	struct scene_store *store = g->store;
	struct balance b = balance_of(g, NULL, one);
	size_t count = store->table.count + b.more - b.less;

	if (count >= store->most)
		return ERR_LIMIT;
	if (c->scenes_most == SIZE_MAX)
		return ERR_OK;
	b = balance_of(g, c->scene->owner, one);
	count = scene_store_count_of(store, c->scene->owner) + b.more - b.less;
	if (count < c->scenes_most)
		return ERR_OK;
	c->is_owners = true;
	return ERR_LIMIT;
}

/* Whether scene fits in, now (or NULL) gone. What is kept may be beyond limits
 * that were lowered since. */
static enum err check_bytes(const struct group *g, const struct scene *scene,
    const struct scene *now)
{
	const struct scene_store *store = g->store;
	struct balance b = balance_of(g, NULL, bytes_of);
	size_t others = store->table.bytes + b.more - b.less -
	    (now != NULL ? now->bytes : 0);

	return scene->bytes <= store->bytes_most &&
	    others <= store->bytes_most - scene->bytes ? ERR_OK : ERR_LIMIT;
}

/* Whether change can be made; change->unchanged: there is nothing to do. */
static enum err judge(struct group *g, struct scene_change *change)
{
	const struct scene *now = present(g, change->id);
	enum err err;

	change->replaced = now != NULL;
	change->unchanged = change->is_outdated = false;
	if (change->kind == SCENE_DELETE && now == NULL)
		return ERR_NOT_FOUND;
	if (!fulfilled(&change->precondition, now != NULL ? now->etag : NULL))
		return ERR_CONFLICT;
	if (change->kind == SCENE_DELETE)
		return ERR_OK;
	err = rebase(g, change, now);
	if (err != ERR_OK)
		return err;
	if (now != NULL && strcmp(now->etag, change->scene->etag) == 0) {
		change->unchanged = true;
		return ERR_OK;
	}
	if (now != NULL)
		strcpy(change->scene->owner, now->owner);
	else
		err = check_count(g, change);
	return err == ERR_OK ? check_bytes(g, change->scene, now) : err;
}

/* ---- deciding ---- */

static void add(struct group *g, struct scene_change *change,
    bool is_written)
{
	struct scene *before = present(g, change->id);
	struct decided *d = g->list + g->count++;

	*d = (struct decided){.change = change, .is_written = is_written,
	    .write = g->write_count};
	d->before = before != NULL ? scene_hold(before) : NULL;
	if (before != NULL)
		strcpy(d->expected, before->etag);
	if (is_written && change->kind == SCENE_PUT)
		d->after = change->scene;
	g->write_count += is_written;
}

static void write_down(struct group *g, const struct decided *d)
{
	const struct scene_change *c = d->change;
	const struct scene *scene = d->after;
	struct backing_write *w = g->writes + d->write;

	*w = (struct backing_write){
		.revision = {.id = c->id, .etag = "", .owner = ""},
		.expected = d->before != NULL ? d->expected : NULL,
		/* What is there does not matter to one that asks for
		 * nothing of it. */
		.is_any = scene != NULL && c->base[0] == '\0' &&
		    c->precondition.match == NULL &&
		    c->precondition.none_match == NULL,
		.result = ERR_OK,
	};
	if (scene == NULL)
		return;
	w->revision.etag = scene->etag;
	w->revision.text = scene->text;
	w->revision.length = scene->length;
	w->revision.owner = scene->owner;
	w->revision.nodes = scene->nodes;
}

/* What another daemon has had there, of which nothing was known here. */
static void note_found(const struct decided *d, const struct backing_write *w)
{
	if (!w->has_found)
		return;
	d->change->replaced = w->was_there;
	strcpy(d->after->owner, w->owner);
}

/* What is not kept any more is not listed. */
static void forget_before(struct scene_store *store, const char *id,
    struct scene_seq oldest)
{
	struct scene_slot *slot = scene_table_find(&store->table, id);

	pthread_rwlock_wrlock(&store->lock);
	if (slot != NULL)
		scene_table_forget_before(slot, oldest);
	pthread_rwlock_unlock(&store->lock);
}

/* It is kept: now everybody may see it. ERR_MEMORY: not yet, though it will be;
 * so who made it is not told that it has been. */
static enum err apply(struct scene_store *store, const struct decided *d,
    const struct backing_write *w)
{
	bool has_missed = store->is_shared && scene_apply_is_behind(store,
	    d->change->id, w->revision.before);
	enum err err;

	if (d->after != NULL) {
		d->after->seq = w->revision.seq;
		d->after->time = w->revision.time;
		note_found(d, w);
		err = scene_apply_put(store, d->after, has_missed);
		d->change->now = scene_hold(d->after);
	} else {
		err = scene_apply_delete(store, d->change->id,
		    w->revision.seq, w->revision.time, has_missed);
	}
	/* What another daemon's lower bounds would leave of it, too. */
	if (err == ERR_OK && w->oldest.major != 0)
		forget_before(store, d->change->id, w->oldest);
	/* No memory to have it here: it is to be read. */
	if (err != ERR_OK)
		atomic_store(&store->must_load, true);
	return err;
}

static void complete(struct group *g, struct decided *d, enum err err)
{
	struct scene_change *c = d->change;

	if (d->is_written && err == ERR_OK)
		err = g->writes[d->write].result;
	if (d->is_written && err == ERR_OK)
		err = apply(g->store, d, g->writes + d->write);
	else if (d->before != NULL)
		c->now = scene_hold(d->before);
	if (d->is_written || err != ERR_OK)
		c->result = err;
	if (d->before != NULL)
		scene_release(d->before);
}

/* What a client is told of a commit that failed. */
static enum err told(enum err err)
{
	return err == ERR_OK || err == ERR_MEMORY ? err : ERR_UNAVAILABLE;
}

/* Commits, applies and completes what the group has. */
static void commit(struct group *g)
{
	const struct backing_ops *ops = g->store->backing->ops;
	enum err err = ERR_OK;

	for (size_t i = 0; i < g->count; i++)
		if (g->list[i].is_written)
			write_down(g, g->list + i);
	if (g->write_count > 0)
		err = told(ops->commit(g->store->backing, g->writes,
		    g->write_count));
	for (size_t i = 0; i < g->count; i++)
		complete(g, g->list + i, err);
}

/* ---- where several daemons write ---- */

static void drop_now(struct scene_change *change)
{
	if (change->now != NULL)
		scene_release(change->now);
	change->now = NULL;
}

/* One change, decided by what is there now. ERR_CONFLICT, though *is_over is
 * false: somebody has come between. */
static enum err attempt(struct scene_store *store,
    struct scene_change *change, bool *is_over)
{
	struct group *g = malloc(sizeof *g);
	enum err err;

	*is_over = true;
	if (g == NULL)
		return ERR_MEMORY;
	g->store = store;
	g->count = g->write_count = 0;
	g->rebase_seconds = 0.0;
	drop_now(change);
	err = scene_load_refresh(store, change->id);
	if (err != ERR_OK) {
		free(g);
		return told(err);
	}
	change->result = judge(g, change);
	*is_over = change->result != ERR_OK || change->unchanged;
	add(g, change, !*is_over);
	commit(g);
	if (change->result != ERR_CONFLICT)
		*is_over = true;
	free(g);
	return change->result;
}

static void settle(struct scene_store *store, struct scene_change *change)
{
	bool is_over = false;
	enum err err = ERR_BUSY;

	for (int i = 0; i < ATTEMPTS_MAX && !is_over; i++)
		err = attempt(store, change, &is_over);
	change->result = is_over ? err : ERR_BUSY;
}

/* Whether what was decided may be otherwise since another daemon's change. */
static bool is_doubtful(const struct scene_store *store, enum err err,
    const struct scene_change *change)
{
	return store->is_shared && (change->unchanged || err == ERR_CONFLICT ||
	    err == ERR_NOT_FOUND);
}

/* ---- the batch ---- */

/* Commits and empties the group. */
static void flush(struct group *g)
{
	commit(g);
	for (size_t i = 0; g->store->is_shared && i < g->count; i++)
		if (g->list[i].is_written &&
		    g->list[i].change->result == ERR_CONFLICT)
			settle(g->store, g->list[i].change);
	g->count = g->write_count = 0;
}

static void decide(struct group *g, struct scene_change *change)
{
	enum err err = judge(g, change);

	if (is_doubtful(g->store, err, change)) {
		flush(g);
		settle(g->store, change);
		return;
	}
	change->result = err;
	add(g, change, err == ERR_OK && !change->unchanged);
}

/* Volumes change in memory as they are kept: in this order, and before anybody tells
 * of later changes made elsewhere. */
static enum err keep_volume(struct scene_store *store,
    struct scene_change *change)
{
	struct backing_volume v = *change->volume;
	enum err err;

	v.kept_owner = change->owner;
	err = store->backing->ops->put_volume(store->backing, &v);
	if (err == ERR_OK)
		change->replaced = volume_store_settle(store->server->volumes,
		    v.id, change->owner);
	return told(err);
}

static enum err forget_volume(struct scene_store *store,
    const struct scene_change *change)
{
	const struct backing_volume *v = change->volume;
	enum err err = store->backing->ops->forget_volume(store->backing,
	    v->id, !v->is_forgotten);

	if (err == ERR_OK)
		volume_store_delete(store->server->volumes, v->id);
	return told(err);
}

/* What is no change of a scene. */
static enum err do_other(struct scene_store *store,
    struct scene_change *change)
{
	const struct scene_slot *slot;
	enum err err = ERR_OK;

	switch (change->kind) {
	case VOLUME_KEEP:
		return keep_volume(store, change);
	case VOLUME_FORGET:
		return forget_volume(store, change);
	default:
		break;
	}
	if (store->is_shared)
		err = told(scene_load_refresh(store, change->id));
	slot = scene_table_find(&store->table, change->id);
	if (slot != NULL)
		change->now = scene_hold(slot->scene);
	return err;
}

static void do_change(struct group *g, struct scene_change *change)
{
	struct scene_store *store = g->store;

	if (!atomic_load(&store->is_loaded) || atomic_load(&store->must_load)) {
		change->result = ERR_UNAVAILABLE;
	} else if (change->kind == SCENE_PUT || change->kind == SCENE_DELETE) {
		decide(g, change);
	} else {
		flush(g);
		change->result = do_other(store, change);
	}
}

void scene_commit_batch(struct scene_store *store,
    struct scene_change *const *batch, size_t count)
{
	struct group g;

	g.store = store;
	g.count = g.write_count = 0;
	g.rebase_seconds = 0.0;
	for (size_t i = 0; i < count; i++)
		do_change(&g, batch[i]);
	flush(&g);
	for (size_t i = 0; i < count; i++)
		if (batch[i]->scene != NULL)
			scene_release(batch[i]->scene);
}
