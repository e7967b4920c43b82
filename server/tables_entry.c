#include "server/tables_internal.h"

#include <stdint.h>
#include <stdlib.h>

/* Wishes remembered, unless the latest evaluation has more: of an animated
 * profile all but the last few have moved on. */
#define WISHES_MAX 4

enum table_claim tables_entry_claim(const struct tables *t,
    const struct table_entry *entry)
{
	if (entry->is_builtin && !entry->was_resident)
		return TABLE_BUILTIN;
	if (entry->asks == 0)
		return entry->wish > 0 ? TABLE_WISHED : TABLE_SPARE;
	return entry->reserved == t->reserved ? TABLE_RESERVED : TABLE_ASKED;
}

/* ---- lists ---- */

bool tables_entry_is_small(const struct table_entry *entry)
{
	return entry->key.resolution <= TABLES_DRAFT_RESOLUTION;
}

static struct list *list_of(struct tables *t, const struct table_entry *entry)
{
	return &t->lists[entry->state][tables_entry_is_small(entry)];
}

static void link_last(struct tables *t, struct table_entry *entry)
{
	struct list *list = list_of(t, entry);

	entry->prev = list->last;
	entry->next = NULL;
	*(list->last ? &list->last->next : &list->first) = entry;
	list->last = entry;
}

static void unlink_entry(struct tables *t, struct table_entry *entry)
{
	struct list *list = list_of(t, entry);

	*(entry->prev ? &entry->prev->next : &list->first) = entry->next;
	*(entry->next ? &entry->next->prev : &list->last) = entry->prev;
}

void tables_entry_set_state(struct tables *t, struct table_entry *entry,
    enum table_state state)
{
	unlink_entry(t, entry);
	entry->state = state;
	link_last(t, entry);
}

void tables_entry_drop_wish(struct tables *t, struct table_entry *entry)
{
	if (entry->wish == 0)
		return;
	*(entry->wish_older ? &entry->wish_older->wish_newer :
	    &t->wish_oldest) = entry->wish_newer;
	*(entry->wish_newer ? &entry->wish_newer->wish_older :
	    &t->wish_newest) = entry->wish_older;
	entry->wish = 0;
	t->wish_count--;
}

void tables_entry_add_wish(struct tables *t, struct table_entry *entry)
{
	tables_entry_drop_wish(t, entry);
	entry->wish_older = t->wish_newest;
	entry->wish_newer = NULL;
	*(t->wish_newest ? &t->wish_newest->wish_newer : &t->wish_oldest) =
	    entry;
	t->wish_newest = entry;
	entry->wish = ++t->turn;
	t->wish_count++;
}

/* ---- finding one ---- */

static bool same_key(const struct operator *a, const struct operator *b)
{
	return a->family == b->family && a->layout == b->layout &&
	    a->resolution == b->resolution &&
	    profile_equal(&a->profile, &b->profile);
}

/* FNV-1a. */
static uint64_t hash_more(uint64_t hash, const void *bytes, size_t count)
{
	const unsigned char *byte = bytes;

	for (size_t i = 0; i < count; i++)
		hash = (hash ^ byte[i]) * 0x100000001b3;
	return hash;
}

/* The same for all with the same key (same_key). */
static size_t bucket_of(const struct operator *op)
{
	const struct profile *profile = &op->profile;
	const int words[] = {op->family, op->layout, op->resolution,
	    profile->type};
	uint64_t hash = hash_more(0xcbf29ce484222325, words, sizeof words);

	/* Plus 0: one hash for both zeros. */
	if (profile->type == PROFILE_BULGE)
		hash = hash_more(hash, &(double){profile->k + 0.0},
		    sizeof(double));
	for (int i = 0; profile->type == PROFILE_SAMPLES &&
	    i < profile->count; i++)
		hash = hash_more(hash, &(double[2]){profile->x[i] + 0.0,
		    profile->y[i] + 0.0}, 2 * sizeof(double));
	return (size_t)(hash ^ hash >> 32) % BUCKET_COUNT;
}

struct table_entry *tables_entry_find(struct tables *t,
    const struct operator *op)
{
	size_t bucket = bucket_of(op);
	struct table_entry *entry = t->buckets[bucket];

	while (entry != NULL && !same_key(&entry->key, op))
		entry = entry->chain;
	if (entry != NULL)
		return entry;
	entry = calloc(1, sizeof *entry);
	if (entry == NULL)
		return NULL;
	entry->key = *op;
	entry->number = ++t->number;
	entry->is_draft = true;
	entry->bucket = bucket;
	entry->chain = t->buckets[bucket];
	t->buckets[bucket] = entry;
	link_last(t, entry);
	return entry;
}

/* ---- what becomes of an entry ---- */

bool tables_entry_is_to_keep(const struct tables *t,
    const struct table_entry *entry)
{
	return t->cache != NULL && entry->is_steady && !entry->is_kept &&
	    !tables_entry_is_small(entry);
}

bool tables_entry_is_to_measure(const struct tables *t,
    const struct table_entry *entry)
{
	return t->measure && !entry->measured && !entry->is_draft;
}

void tables_entry_trim(struct tables *t, struct table_entry *entry)
{
	bool wanted = entry->state == TABLE_BUILT ||
	    (entry->state == TABLE_RESIDENT &&
	    (tables_entry_is_to_keep(t, entry) ||
	    tables_entry_is_to_measure(t, entry)));

	if (entry->measuring || wanted)
		return;
	table_free(entry->table);
	entry->table = NULL;
}

void tables_entry_forget(struct tables *t, struct table_entry *entry)
{
	struct table_entry **link = &t->buckets[entry->bucket];

	tables_entry_trim(t, entry);
	if (entry->refs > 0 || entry->measuring ||
	    (entry->state != TABLE_ABSENT && entry->state != TABLE_FAILED))
		return;
	while (*link != entry)
		link = &(*link)->chain;
	*link = entry->chain;
	tables_entry_drop_wish(t, entry);
	unlink_entry(t, entry);
	free(entry);
}

void tables_entry_settle(struct tables *t, struct table_entry *entry)
{
	/* Another builder may be the one for it now, or no longer held back. */
	if (entry->state == TABLE_WAITING || entry->state == TABLE_BUILT)
		pthread_cond_broadcast(&t->wake);
	if (tables_entry_claim(t, entry) == TABLE_SPARE) {
		if (entry->state == TABLE_BUILDING)
			atomic_store(&entry->lane->abandon, true);
		if (entry->state == TABLE_WAITING ||
		    (entry->state == TABLE_BUILT && !entry->is_loading))
			tables_entry_set_state(t, entry, TABLE_ABSENT);
	}
	tables_entry_forget(t, entry);
}

enum lane_kind tables_entry_lane(const struct tables *t,
    const struct table_entry *entry)
{
	if (tables_entry_is_small(entry))
		return LANE_DRAFTS;
	return tables_entry_claim(t, entry) > TABLE_WISHED ? LANE_ASKED :
	    LANE_WISHED;
}

bool tables_entry_precedes(const struct tables *t, const struct table_entry *a,
    const struct table_entry *b)
{
	enum table_claim claim = tables_entry_claim(t, a);

	if (claim != tables_entry_claim(t, b))
		return claim > tables_entry_claim(t, b);
	return claim == TABLE_WISHED ? a->wish > b->wish : a->turn < b->turn;
}

/* Takes an entry away from the builder that builds it. Locked. */
static void disown(struct tables *t, struct table_entry *entry)
{
	atomic_store(&entry->lane->abandon, true);
	entry->lane->entry = NULL;
	entry->lane = NULL;
	tables_entry_set_state(t, entry, TABLE_WAITING);
}

void tables_entry_want(struct tables *t, struct table_entry *entry)
{
	if (entry->state == TABLE_ABSENT || entry->state == TABLE_FAILED) {
		tables_entry_set_state(t, entry, entry->table != NULL ?
		    TABLE_BUILT : TABLE_WAITING);
		entry->turn = ++t->turn;
	} else if (entry->state == TABLE_BUILDING &&
	    entry->lane->kind == LANE_WISHED &&
	    tables_entry_lane(t, entry) != LANE_WISHED) {
		disown(t, entry);
		entry->turn = ++t->turn;
	} else if (entry->state == TABLE_BUILDING) {
		atomic_store(&entry->lane->abandon, false);
	}
	if (entry->state == TABLE_WAITING)
		pthread_cond_broadcast(&t->wake);
}

void tables_entry_limit_wishes(struct tables *t, unsigned long first)
{
	struct table_entry *newer;

	for (struct table_entry *e = t->wish_oldest;
	    e != NULL && e->wish < first && t->wish_count > WISHES_MAX;
	    e = newer) {
		newer = e->wish_newer;
		if (e->state == TABLE_BUILDING || e->is_loading)
			continue;
		tables_entry_drop_wish(t, e);
		tables_entry_settle(t, e);
	}
}

void tables_entry_wish(struct tables *t, struct table_entry *entry)
{
	if (entry->state == TABLE_RESIDENT)
		return;
	tables_entry_add_wish(t, entry);
	tables_entry_want(t, entry);
}
