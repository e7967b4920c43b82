#include <string.h>

#include "server/events.h"
#include "server/scene_store_internal.h"
#include "server/server.h"

static void bury(struct scene_store *store, const char *id,
    struct scene_seq seq)
{
	struct scene_grave *grave = store->graves +
	    store->grave_next++ % SCENE_GRAVES;

	strcpy(grave->id, id);
	grave->seq = seq;
}

bool scene_apply_is_buried(const struct scene_store *store, const char *id,
    struct scene_seq seq)
{
	for (size_t i = 0; i < SCENE_GRAVES; i++)
		if (strcmp(store->graves[i].id, id) == 0 &&
		    scene_seq_compare(store->graves[i].seq, seq) >= 0)
			return true;
	return false;
}

bool scene_apply_is_behind(const struct scene_store *store, const char *id,
    struct scene_seq seq)
{
	const struct scene_slot *slot = scene_table_find(&store->table, id);

	return slot != NULL && scene_seq_compare(
	    slot->past[slot->past_count - 1].seq, seq) != 0;
}

static void advance(struct scene_store *store, struct scene_seq seq)
{
	if (scene_seq_compare(store->newest, seq) < 0)
		store->newest = seq;
}

/* Under the lock. */
static enum err put(struct scene_store *store, struct scene *scene,
    bool has_gap, bool *is_first)
{
	struct scene_slot *slot;
	struct scene_past past;
	enum err err = scene_table_add(&store->table, scene->id, &slot);

	if (err != ERR_OK)
		return err;
	*is_first = slot->scene == NULL;
	past = scene_table_past_of(scene, *is_first);
	past.has_gap = has_gap;
	err = scene_table_remember(&store->table, slot, &past);
	if (err == ERR_OK) {
		scene_table_set(&store->table, slot, scene);
		advance(store, scene->seq);
	} else if (*is_first) {
		scene_table_remove(&store->table, scene->id);
	}
	return err;
}

/* Whether a later revision is there already. */
static bool is_overtaken(const struct scene_store *store,
    const struct scene *scene)
{
	const struct scene_slot *slot = scene_table_find(&store->table,
	    scene->id);

	return slot != NULL &&
	    scene_seq_compare(scene->seq, slot->scene->seq) < 0;
}

/* It is of the past from the first. */
static enum err remember(struct scene_store *store,
    const struct scene *scene)
{
	struct scene_past past = scene_table_past_of(scene, false);
	struct scene_slot *slot;
	enum err err;

	pthread_rwlock_wrlock(&store->lock);
	slot = scene_table_find(&store->table, scene->id);
	err = scene_table_remember(&store->table, slot, &past);
	pthread_rwlock_unlock(&store->lock);
	return err;
}

enum err scene_apply_put(struct scene_store *store, struct scene *scene,
    bool has_missed)
{
	struct scene_event event = {.seq = scene->seq, .time = scene->time,
	    .nodes = scene->nodes, .length = scene->length,
	    .has_missed = has_missed};
	enum err err;

	strcpy(event.id, scene->id);
	strcpy(event.etag, scene->etag);
	if (is_overtaken(store, scene))
		return remember(store, scene);
	pthread_rwlock_wrlock(&store->lock);
	err = put(store, scene, has_missed, &event.is_first);
	pthread_rwlock_unlock(&store->lock);
	if (err == ERR_OK)
		events_publish(store->server->events, &event);
	return err;
}

enum err scene_apply_delete(struct scene_store *store, const char *id,
    struct scene_seq seq, double time, bool has_missed)
{
	struct scene_event event = {.seq = seq, .time = time,
	    .is_deleted = true, .has_missed = has_missed};

	strcpy(event.id, id);
	if (store->is_shared)
		bury(store, event.id, seq);
	pthread_rwlock_wrlock(&store->lock);
	scene_table_remove(&store->table, event.id);
	advance(store, seq);
	pthread_rwlock_unlock(&store->lock);
	events_publish(store->server->events, &event);
	return ERR_OK;
}
