#include <string.h>
#include <time.h>

#include "server/scene_store_internal.h"

/* Where daemons share a store, one may know of changes of so many milliseconds
 * that another has not heard of. */
#define LAG_MS 60000

static struct scene_event event_of(const struct scene_slot *slot,
    const struct scene_past *past)
{
	struct scene_event event = {.seq = past->seq, .time = past->time,
	    .nodes = past->nodes, .length = past->length,
	    .is_first = past->is_first, .has_missed = past->has_gap};

	strcpy(event.id, slot->id);
	strcpy(event.etag, past->etag);
	return event;
}

size_t scene_store_history(struct scene_store *store, const char *id,
    const struct scene_seq *before, size_t limit, struct scene_event *list)
{
	const struct scene_slot *slot;
	size_t count = 0;

	pthread_rwlock_rdlock(&store->lock);
	slot = scene_table_find(&store->table, id);
	for (size_t i = slot != NULL ? slot->past_count : 0;
	    i-- > 0 && count < limit;) {
		const struct scene_past *past = slot->past + i;

		if (before == NULL || scene_seq_compare(past->seq, *before) < 0)
			list[count++] = event_of(slot, past);
	}
	pthread_rwlock_unlock(&store->lock);
	return count;
}

/* Whether seq is another store's, or of an earlier life of this one: nothing here
 * has it yet, and no other daemon has just made it (seqs are times then). */
static bool is_strange(const struct scene_store *store, struct scene_seq seq)
{
	uint64_t now = 1000 * (uint64_t)time(NULL);

	if (scene_seq_compare(seq, store->newest) <= 0)
		return false;
	return !store->is_shared || seq.major > now + LAG_MS ||
	    seq.major < now - LAG_MS;
}

size_t scene_store_since(struct scene_store *store, const char *id,
    struct scene_seq after, size_t limit, struct scene_event *list,
    bool *missed)
{
	const struct scene_slot *slot;
	size_t count = 0;

	pthread_rwlock_rdlock(&store->lock);
	slot = scene_table_find(&store->table, id);
	*missed = slot == NULL || is_strange(store, after) ||
	    scene_seq_compare(after, slot->trimmed) < 0;
	if (is_strange(store, after))
		after = (struct scene_seq){0, 0};
	for (size_t i = 0; slot != NULL && i < slot->past_count &&
	    count < limit; i++)
		if (scene_seq_compare(slot->past[i].seq, after) > 0)
			list[count++] = event_of(slot, slot->past + i);
	pthread_rwlock_unlock(&store->lock);
	return count;
}
