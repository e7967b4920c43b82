/*
 * The device thread's side: what it loads next, and what makes room.
 */
#include "server/tables_internal.h"

/* Drafts that stay resident though nobody waits for them, 0.2 MB each. */
#define DRAFTS_MAX 64

/* Whether there is no room for it, as far as known. One that the evaluation
 * that has waited longest needs is tried each time. Locked. */
static bool is_refused(const struct tables *t, const struct table_entry *e)
{
	return e->refused == t->room &&
	    tables_entry_claim(t, e) <= e->refused_claim &&
	    tables_entry_claim(t, e) < TABLE_RESERVED;
}

struct table_entry *tables_next_built(struct tables *t,
    enum table_claim least, const struct table **table,
    enum table_claim *claim)
{
	struct table_entry *entry = NULL;

	pthread_mutex_lock(&t->lock);
	for (int small = 0; small < 2; small++) {
		for (struct table_entry *e =
		    t->lists[TABLE_BUILT][small].first; e != NULL;
		    e = e->next) {
			if (tables_entry_claim(t, e) >= least &&
			    !is_refused(t, e) && (entry == NULL ||
			    tables_entry_precedes(t, e, entry)))
				entry = e;
		}
	}
	if (entry != NULL) {
		entry->is_loading = true;
		*table = entry->table;
		*claim = tables_entry_claim(t, entry);
	}
	pthread_mutex_unlock(&t->lock);
	return entry;
}

void tables_loaded(struct tables *t, struct table_entry *entry, int slot)
{
	pthread_mutex_lock(&t->lock);
	entry->is_loading = false;
	entry->slot = slot;
	tables_entry_set_state(t, entry, TABLE_RESIDENT);
	tables_entry_drop_wish(t, entry);
	entry->was_resident = true;
	entry->turn = ++t->turn;
	tables_entry_trim(t, entry);
	pthread_cond_broadcast(&t->wake);
	pthread_mutex_unlock(&t->lock);
}

void tables_failed(struct tables *t, struct table_entry *entry, enum err err)
{
	pthread_mutex_lock(&t->lock);
	entry->is_loading = false;
	tables_entry_set_state(t, entry, TABLE_FAILED);
	tables_entry_drop_wish(t, entry);
	entry->err = err;
	tables_entry_forget(t, entry);
	pthread_cond_broadcast(&t->wake);
	pthread_mutex_unlock(&t->lock);
}

void tables_put_back(struct tables *t, struct table_entry *entry,
    enum table_claim claim)
{
	pthread_mutex_lock(&t->lock);
	entry->is_loading = false;
	entry->refused = t->room;
	entry->refused_claim = claim;
	tables_entry_settle(t, entry);
	pthread_mutex_unlock(&t->lock);
}

int tables_slot(const struct table_entry *entry)
{
	return entry->slot;
}

/* Whether resident a is given up before b. Locked. */
static bool yields(const struct tables *t, const struct table_entry *a,
    const struct table_entry *b)
{
	if (tables_entry_claim(t, a) != tables_entry_claim(t, b))
		return tables_entry_claim(t, a) < tables_entry_claim(t, b);
	if (a->is_draft != b->is_draft)
		return a->is_draft;
	return a->turn < b->turn;
}

/* The resident entry to give up first for one with that claim, or NULL. */
static struct table_entry *least_needed(struct tables *t,
    enum table_claim claim)
{
	struct table_entry *best = NULL;

	for (int small = 0; small < 2; small++) {
		for (struct table_entry *e =
		    t->lists[TABLE_RESIDENT][small].first; e != NULL;
		    e = e->next) {
			if (tables_entry_claim(t, e) < claim &&
			    (best == NULL || yields(t, e, best)))
				best = e;
		}
	}
	return best;
}

/* Locked; entry may be NULL: false. */
static bool give_up(struct tables *t, struct table_entry *entry,
    const struct table_entry **out, int *slot)
{
	if (entry == NULL)
		return false;
	*out = entry;
	*slot = entry->slot;
	t->room++;
	tables_entry_set_state(t, entry, TABLE_ABSENT);
	if (tables_entry_claim(t, entry) > TABLE_SPARE)
		tables_entry_want(t, entry);
	tables_entry_forget(t, entry);
	return true;
}

bool tables_evict(struct tables *t, enum table_claim claim,
    const struct table_entry **out, int *slot)
{
	bool found;

	pthread_mutex_lock(&t->lock);
	found = give_up(t, least_needed(t, claim), out, slot);
	pthread_mutex_unlock(&t->lock);
	return found;
}

size_t tables_evictable(struct tables *t, enum table_claim claim)
{
	size_t bytes = 0;

	pthread_mutex_lock(&t->lock);
	for (int i = 0; i < 2; i++)
		for (const struct table_entry *e =
		    t->lists[TABLE_RESIDENT][i].first; e != NULL; e = e->next)
			bytes += tables_entry_claim(t, e) < claim ?
			    e->bytes : 0;
	pthread_mutex_unlock(&t->lock);
	return bytes;
}

bool tables_evict_draft(struct tables *t, const struct table_entry **out,
    int *slot)
{
	struct table_entry *spare;
	size_t count = 0;
	bool found;

	pthread_mutex_lock(&t->lock);
	for (const struct table_entry *e =
	    t->lists[TABLE_RESIDENT][true].first; e != NULL; e = e->next)
		count += e->is_draft;
	spare = count > DRAFTS_MAX ? least_needed(t, TABLE_WISHED) : NULL;
	found = spare != NULL && spare->is_draft &&
	    give_up(t, spare, out, slot);
	pthread_mutex_unlock(&t->lock);
	return found;
}

void tables_lose(struct tables *t)
{
	unsigned long first;

	pthread_mutex_lock(&t->lock);
	first = t->turn + 1;
	for (int i = 0; i < BUILTIN_COUNT; i++) {
		struct table_entry *entry = t->builtin[i];

		/* What was never there is built in any case. */
		if (entry->was_resident && entry->state == TABLE_RESIDENT)
			tables_entry_add_wish(t, entry);
	}
	for (int small = 0; small < 2; small++) {
		const struct list *list = &t->lists[TABLE_RESIDENT][small];
		const struct table_entry *out;
		int slot;

		while (give_up(t, list->first, &out, &slot))
			;
	}
	tables_entry_limit_wishes(t, first);
	pthread_mutex_unlock(&t->lock);
}
