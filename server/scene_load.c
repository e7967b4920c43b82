#include <string.h>

#include "core/volume.h"
#include "proto/document.h"
#include "proto/fault.h"
#include "server/events.h"
#include "server/limits.h"
#include "server/log.h"
#include "server/scene_build.h"
#include "server/scene_store_internal.h"
#include "server/server.h"
#include "server/volume_store.h"

/* So many of those that cannot be used are named, when all are read. */
#define NAMED_MAX 3

/* ---- from what is kept to a scene ---- */

/* A volume from memory, else from where other daemons have kept it. */
static struct volume *fetch_volume(void *ctx, const char *id)
{
	struct scene_store *store = ctx;
	const struct backing_ops *ops = store->backing->ops;
	const struct backing_reader reader = {scene_load_revision,
	    scene_load_volume, store};
	struct volume *volume = volume_store_recall(store->server->volumes,
	    id);

	if (volume != NULL || ops->get_volume == NULL)
		return volume;
	if (ops->get_volume(store->backing, id, &reader) != ERR_OK)
		return NULL;
	return volume_store_recall(store->server->volumes, id);
}

static void warn(enum log_level level, const char *id, enum err err,
    const struct faults *faults)
{
	const struct fault *first = &faults->list[0];

	if (faults->count > 0)
		log_write(level, "scene '%s' is kept, but cannot be used now: "
		    "%s%s%s", id, first->pointer,
		    first->pointer[0] != '\0' ? ": " : "", first->detail);
	else
		log_write(level, "scene '%s' is kept, but cannot be used now: "
		    "%s", id, err_message(err));
}

/* What others, or damage, have put there under a name that no scene can have is
 * left alone. */
static bool is_scene(const struct backing_revision *r)
{
	if (scene_id_is_valid(r->id))
		return true;
	log_write(LOG_WARNING, "a scene is kept under '%.80s', which is no "
	    "scene's id: it is left out", r->id);
	return false;
}

/* A scene, without a program if the document cannot be compiled (now): what is
 * kept is not lost because limits have changed. warned counts those; NULL: this
 * is one by itself. */
static enum err make(struct scene_store *store,
    const struct backing_revision *r, bool may_fetch, size_t *warned,
    struct scene **out)
{
	struct document_limits limits = limits_kept(store->server);
	struct faults faults = {0};
	enum err err;

	if (may_fetch) {
		limits.volume = fetch_volume;
		limits.volume_ctx = store;
	}
	err = scene_build(store->server, &limits, r->id, r->text, r->length,
	    out, &faults);
	if (err != ERR_OK) {
		warn(warned != NULL && (*warned)++ >= NAMED_MAX ? LOG_DEBUG :
		    LOG_WARNING, r->id, err, &faults);
		err = scene_create(store->server->scheduler, r->id, "",
		    r->text, r->length, NULL, out);
		if (err != ERR_OK)
			return err;
		(*out)->nodes = r->nodes;
		/* Whatever volumes it uses are to be there when it can be. */
		volume_store_hold_still(store->server->volumes, true);
		if (store->is_shared && !may_fetch) {
			atomic_store(&store->must_mend, true);
			scene_writer_wake(store);
		}
	}
	strncpy((*out)->owner, r->owner, TOKEN_NAME_MAX);
	(*out)->seq = r->seq;
	(*out)->time = r->time;
	return ERR_OK;
}

/* ---- changes made elsewhere ---- */

enum err scene_load_volume(void *ctx, const struct backing_volume *v)
{
	struct scene_store *store = ctx;
	enum err err = volume_store_load(store->server->volumes, v);

	if (err == ERR_MEMORY)
		return err;
	if (err != ERR_OK)
		log_write(LOG_WARNING, "volume %s is kept, but cannot be used: "
		    "%s", v->id, err_message(err));
	return ERR_OK;
}

/* Something that was overtaken: for the history, and for listeners, if they have
 * heard of nothing later. */
static enum err remember(struct scene_store *store, struct scene_slot *slot,
    const struct backing_revision *r)
{
	struct scene_past past = {.seq = r->seq, .time = r->time,
	    .nodes = r->nodes, .length = r->length,
	    .has_gap = r->is_oldest};
	struct scene_event event = {.seq = r->seq, .time = r->time,
	    .nodes = r->nodes, .length = r->length,
	    .has_missed = r->is_oldest};
	bool is_news;
	enum err err;

	if (r->text == NULL || scene_seq_compare(r->seq, slot->trimmed) <= 0)
		return ERR_OK;
	strncpy(past.etag, r->etag, ETAG_SIZE - 1);
	is_news = scene_seq_compare(slot->past[slot->past_count - 1].seq,
	    r->seq) < 0;
	pthread_rwlock_wrlock(&store->lock);
	err = scene_table_remember(&store->table, slot, &past);
	if (err == ERR_OK && r->is_oldest)
		scene_table_forget_before(slot, r->seq);
	pthread_rwlock_unlock(&store->lock);
	strcpy(event.id, slot->id);
	strcpy(event.etag, past.etag);
	if (err == ERR_OK && is_news)
		events_publish(store->server->events, &event);
	return err;
}

static enum err receive(struct scene_store *store,
    const struct backing_revision *r, bool may_fetch)
{
	struct scene_slot *slot;
	struct scene *scene;
	enum err err;

	if (!is_scene(r))
		return ERR_OK;
	slot = scene_table_find(&store->table, r->id);
	if (slot != NULL && (r->is_past ||
	    scene_seq_compare(r->seq, slot->scene->seq) <= 0))
		return remember(store, slot, r);
	if (r->is_past || scene_apply_is_buried(store, r->id, r->seq))
		return ERR_OK;
	if (r->text == NULL)
		return scene_apply_delete(store, r->id, r->seq, r->time,
		    scene_apply_is_behind(store, r->id, r->before));
	err = make(store, r, may_fetch, NULL, &scene);
	if (err == ERR_OK) {
		err = scene_apply_put(store, scene, slot != NULL &&
		    r->is_oldest);
		scene_release(scene);
	}
	return err;
}

enum err scene_load_revision(void *ctx, const struct backing_revision *r)
{
	struct scene_store *store = ctx;

	/* What comes before everything has been read is in it. */
	return atomic_load(&store->is_loaded) && !store->is_ended ?
	    receive(store, r, false) : ERR_OK;
}

static enum err receive_fetching(void *ctx, const struct backing_revision *r)
{
	struct scene_store *store = ctx;

	/* Asked for what has never been, as far as is known. */
	if (r->text == NULL &&
	    scene_table_find(&store->table, r->id) == NULL)
		return ERR_OK;
	return receive(store, r, true);
}

enum err scene_load_refresh(struct scene_store *store, const char *id)
{
	const struct backing_reader reader = {receive_fetching,
	    scene_load_volume, store};
	struct scene_slot *slot;
	enum err err;

	err = store->backing->ops->refresh(store->backing, id, &reader);
	if (err != ERR_NOT_FOUND)
		return err;
	slot = scene_table_find(&store->table, id);
	if (slot != NULL)
		return scene_apply_delete(store, id, slot->scene->seq,
		    slot->scene->time, true);
	return ERR_OK;
}

/* ---- mending ---- */

/* Has scene, which is slot's and has no program, be one that has. */
static void mend(struct scene_store *store, struct scene_slot *slot,
    struct scene *made)
{
	const struct scene *scene = slot->scene;

	memcpy(made->owner, scene->owner, sizeof made->owner);
	made->seq = scene->seq;
	made->time = scene->time;
	pthread_rwlock_wrlock(&store->lock);
	scene_table_set(&store->table, slot, made);
	pthread_rwlock_unlock(&store->lock);
}

void scene_load_mend(struct scene_store *store)
{
	struct document_limits limits = limits_kept(store->server);

	limits.volume = fetch_volume;
	limits.volume_ctx = store;
	for (size_t i = 0; i < store->table.count; i++) {
		struct scene_slot *slot = store->table.slots[i];
		struct faults faults = {0};
		struct scene *made;

		if (slot->scene->program != NULL ||
		    scene_build(store->server, &limits, slot->id,
		    slot->scene->text, slot->scene->length, &made, &faults) !=
		    ERR_OK)
			continue;
		mend(store, slot, made);
		scene_release(made);
	}
}

enum err scene_store_mend(struct scene_store *store, const char *id,
    struct faults *faults)
{
	const struct document_limits limits = limits_kept(store->server);
	struct scene *scene = scene_store_find(store, id), *made;
	struct scene_slot *slot;
	enum err err;

	if (scene == NULL)
		return ERR_NOT_FOUND;
	err = scene_build(store->server, &limits, id, scene->text,
	    scene->length, &made, faults);
	if (err == ERR_OK) {
		pthread_mutex_lock(&store->turn);
		slot = scene_table_find(&store->table, id);
		if (slot != NULL && slot->scene == scene &&
		    scene->program == NULL)
			mend(store, slot, made);
		pthread_mutex_unlock(&store->turn);
		scene_release(made);
	}
	scene_release(scene);
	return err;
}

/* ---- everything ---- */

struct loading {
	struct scene_store *store;
	struct scene_table table;
	struct scene_seq newest;
	size_t warned; /* scenes that cannot be used */
};

/* Its newest revision: r, or what there is of that already. */
static enum err load_scene(struct loading *l, struct scene_slot *slot,
    const struct backing_revision *r)
{
	const struct scene_slot *old = scene_table_find(&l->store->table,
	    r->id);
	struct scene *scene;
	enum err err = ERR_OK;

	if (old != NULL && old->scene->program != NULL &&
	    scene_seq_compare(old->scene->seq, r->seq) == 0)
		scene = scene_hold(old->scene);
	else
		err = make(l->store, r, true, &l->warned, &scene);
	if (err != ERR_OK)
		return err;
	scene_table_set(&l->table, slot, scene);
	scene_release(scene);
	return ERR_OK;
}

static enum err load_revision(void *ctx, const struct backing_revision *r)
{
	struct loading *l = ctx;
	struct scene_past past = {.seq = r->seq, .time = r->time,
	    .nodes = r->nodes, .length = r->length};
	struct scene_slot *slot;
	enum err err;

	if (scene_seq_compare(l->newest, r->seq) < 0)
		l->newest = r->seq;
	if (r->text == NULL || !is_scene(r))
		return ERR_OK;
	err = scene_table_add(&l->table, r->id, &slot);
	if (err != ERR_OK)
		return err;
	strncpy(past.etag, r->etag, ETAG_SIZE - 1);
	err = scene_table_remember(&l->table, slot, &past);
	if (err == ERR_OK && !r->is_past)
		err = load_scene(l, slot, r);
	return err;
}

/* A file that only this daemon writes is not to have what is no volume. */
static enum err load_volume(void *ctx, const struct backing_volume *v)
{
	struct loading *l = ctx;
	enum err err;

	if (l->store->is_shared)
		return scene_load_volume(l->store, v);
	err = volume_store_load(l->store->server->volumes, v);
	return err == ERR_INVALID || err == ERR_MEMORY ? err :
	    scene_load_volume(l->store, v);
}

/* What was before the oldest that is kept is not known: it may have been
 * trimmed by an earlier daemon. A scene that has nothing but a past has lost what
 * was present. */
static void settle_past(struct scene_table *table)
{
	for (size_t i = table->count; i-- > 0;) {
		struct scene_slot *slot = table->slots[i];
		struct scene_seq oldest = slot->past[0].seq;

		if (slot->scene == NULL) {
			log_write(LOG_WARNING, "scene '%s' is kept, but its "
			    "present revision is not there", slot->id);
			scene_table_remove(table, slot->id);
			continue;
		}
		if (oldest.minor > 0)
			oldest.minor--;
		else
			oldest.major--;
		if (scene_seq_compare(slot->trimmed, oldest) < 0)
			slot->trimmed = oldest;
	}
}

/* What a reader of the log would not see in the table. */
static void sum_up(const struct loading *l)
{
	if (l->warned > NAMED_MAX)
		log_write(LOG_WARNING, "%zu scenes of %zu are kept, but cannot "
		    "be used now; not all are named (--log-level debug)",
		    l->warned, l->table.count);
	if (l->table.count > l->store->most)
		log_write(LOG_WARNING, "%zu scenes are kept, and at most %zu "
		    "may be (--max-scenes): there is no room for new ones",
		    l->table.count, l->store->most);
	else if (l->table.bytes > l->store->bytes_most)
		log_write(LOG_WARNING, "the scenes that are kept take %zu "
		    "bytes, and at most %zu may be (--scene-memory): there is "
		    "no room for new ones", l->table.bytes,
		    l->store->bytes_most);
}

/* What listeners have not heard of: the table is the new one, old what it was. */
static void publish_differences(struct scene_store *store,
    const struct scene_table *old)
{
	struct events *events = store->server->events;
	size_t count;
	bool there;

	for (size_t i = 0; i < old->count; i++) {
		struct scene_event event = {.seq = store->newest,
		    .time = old->slots[i]->scene->time, .is_deleted = true,
		    .has_missed = true};

		strcpy(event.id, old->slots[i]->id);
		scene_table_place(&store->table, event.id, &there);
		if (!there)
			events_publish(events, &event);
	}
	for (size_t i = 0; i < store->table.count; i++) {
		const struct scene_slot *slot = store->table.slots[i];
		const struct scene_slot *was = scene_table_find(old, slot->id);
		struct scene_event list[2];

		if (was != NULL && scene_seq_compare(was->scene->seq,
		    slot->scene->seq) == 0)
			continue;
		count = scene_store_history(store, slot->id, NULL, 2, list);
		if (count == 0)
			continue;
		list[0].has_missed = was != NULL && (count == 1 ||
		    scene_seq_compare(list[1].seq, was->scene->seq) != 0);
		list[0].is_anew = was != NULL && scene_seq_compare(
		    list[0].seq, was->scene->seq) < 0;
		events_publish(events, list);
	}
}

enum err scene_load_all(struct scene_store *store)
{
	struct loading l = {.store = store,
	    .table = {.history = store->table.history,
	    .history_bytes = store->table.history_bytes}};
	const struct backing_reader reader = {load_revision, load_volume, &l};
	struct scene_table old;
	enum err err;

	pthread_mutex_lock(&store->turn);
	volume_store_hold_still(store->server->volumes, true);
	err = store->backing->ops->load(store->backing, &reader);
	if (err == ERR_OK) {
		settle_past(&l.table);
		sum_up(&l);
		pthread_rwlock_wrlock(&store->lock);
		old = store->table;
		store->table = l.table;
		store->newest = l.newest;
		pthread_rwlock_unlock(&store->lock);
		memset(store->graves, 0, sizeof store->graves);
		l.table = old;
		if (atomic_load(&store->is_loaded))
			publish_differences(store, &old);
	}
	scene_table_fini(&l.table);
	volume_store_hold_still(store->server->volumes,
	    store->table.unusable > 0);
	pthread_mutex_unlock(&store->turn);
	return err;
}
