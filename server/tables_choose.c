/*
 * The evaluations' side: which tables they hold, ask for and use.
 */
#include "server/tables_internal.h"

/* Wishes of one evaluation; repeated, it wishes for others, once it has these.
 * A thousand times as many would be dropped by the next one. */
#define WISHES_EACH_MAX 32

static enum err acquire(struct tables *t, const struct operator *op,
    bool as_draft, struct table_entry **out)
{
	struct table_entry *entry;

	pthread_mutex_lock(&t->lock);
	entry = tables_entry_find(t, op);
	if (entry != NULL) {
		entry->refs++;
		/* One that is somebody's own table is no draft. */
		entry->is_draft = entry->is_draft && as_draft;
		entry->is_steady = entry->is_steady || !op->draft;
	}
	pthread_mutex_unlock(&t->lock);
	if (entry == NULL)
		return ERR_MEMORY;
	*out = entry;
	return ERR_OK;
}

enum err tables_acquire(struct tables *t, const struct operator *op,
    struct table_entry **out)
{
	return acquire(t, op, false, out);
}

enum err tables_acquire_draft(struct tables *t, const struct operator *op,
    struct table_entry **out)
{
	struct operator draft = *op;

	draft.resolution = TABLES_DRAFT_RESOLUTION;
	return acquire(t, &draft, true, out);
}

bool tables_has_draft(const struct operator *op)
{
	return op->draft && op->resolution > TABLES_DRAFT_RESOLUTION;
}

void tables_release(struct tables *t, struct table_entry *entry)
{
	pthread_mutex_lock(&t->lock);
	entry->refs--;
	tables_entry_forget(t, entry);
	pthread_mutex_unlock(&t->lock);
}

/* Locked. */
static void ask(struct tables *t, struct table_entry *entry)
{
	entry->asks++;
	tables_entry_want(t, entry);
}

/* Locked. */
static void unask(struct tables *t, struct table_entry *entry)
{
	entry->asks--;
	if (entry->state == TABLE_RESIDENT) {
		entry->turn = ++t->turn;
		t->room += entry->asks == 0;
	}
	if (entry->asks == 0)
		tables_entry_settle(t, entry);
}

void tables_unask(struct tables *t, struct table_entry *const *entries,
    size_t count)
{
	pthread_mutex_lock(&t->lock);
	for (size_t i = 0; i < count; i++)
		unask(t, entries[i]);
	pthread_mutex_unlock(&t->lock);
}

/* Of pair i the one to use now. Locked. */
static struct table_entry *pick(const struct table_choice *c, size_t i)
{
	return c->drafts == NULL || c->drafts[i] == NULL ||
	    c->entries[i]->state == TABLE_RESIDENT ? c->entries[i] :
	    c->drafts[i];
}

void tables_choose(struct tables *t, struct table_choice *c)
{
	size_t wishes = 0;
	unsigned long first;

	pthread_mutex_lock(&t->lock);
	first = t->turn + 1;
	for (size_t i = 0; i < c->count; i++) {
		struct table_entry *entry = c->entries[i], *now = pick(c, i);

		if (c->chosen[i] != now) /* else others may read it */
			c->chosen[i] = now;
		ask(t, now);
		if (now == entry || entry->wish >= first ||
		    wishes == WISHES_EACH_MAX)
			continue;
		tables_entry_wish(t, entry);
		wishes++;
	}
	tables_entry_limit_wishes(t, first);
	pthread_mutex_unlock(&t->lock);
	c->at = 0;
}

size_t tables_nodes_unbuilt(struct tables *t,
    struct table_entry *const *entries, size_t count)
{
	size_t nodes = 0;

	pthread_mutex_lock(&t->lock);
	for (size_t i = 0; i < count; i++) {
		const size_t n = (size_t)entries[i]->key.resolution;

		if (entries[i]->state == TABLE_ABSENT ||
		    entries[i]->state == TABLE_FAILED)
			nodes += n * n * n;
	}
	pthread_mutex_unlock(&t->lock);
	return nodes;
}

/* Chooses anew of pair i, whose full table has come or been displaced: an
 * older wish stays as old as it is. Locked. */
static void choose_again(struct tables *t, struct table_choice *c, size_t i)
{
	struct table_entry *old = c->chosen[i], *now = pick(c, i);

	if (now == old)
		return;
	c->chosen[i] = now;
	ask(t, now);
	if (now != c->entries[i] && c->entries[i]->wish == 0) {
		tables_entry_wish(t, c->entries[i]);
		tables_entry_limit_wishes(t, c->entries[i]->wish);
	}
	unask(t, old);
}

enum err tables_check(struct tables *t, struct table_choice *c, bool *ready)
{
	enum err err = ERR_OK;
	bool is_draft = false;
	size_t seen = 0;

	pthread_mutex_lock(&t->lock);
	for (; seen < c->count; seen++) {
		choose_again(t, c, c->at);
		if (c->chosen[c->at]->state != TABLE_RESIDENT)
			break;
		is_draft = is_draft || c->chosen[c->at] != c->entries[c->at];
		c->at = (c->at + 1) % c->count;
	}
	if (seen < c->count && c->chosen[c->at]->state == TABLE_FAILED)
		err = c->chosen[c->at]->err;
	pthread_mutex_unlock(&t->lock);
	if (err != ERR_OK)
		return err;
	c->is_draft = is_draft;
	*ready = seen == c->count;
	return ERR_OK;
}

void tables_reserve(struct tables *t, struct table_entry *const *entries,
    size_t count)
{
	pthread_mutex_lock(&t->lock);
	t->reserved++;
	for (size_t i = 0; i < count; i++) {
		entries[i]->reserved = t->reserved;
		/* The builder may have held back. */
		if (entries[i]->state == TABLE_WAITING)
			pthread_cond_broadcast(&t->wake);
	}
	pthread_mutex_unlock(&t->lock);
}
