/*
 * The tables' life: those built in, the threads, tables built elsewhere.
 */
#include "server/tables_internal.h"

#include <stdlib.h>

static const char *const state_names[TABLE_STATE_COUNT] = {
	[TABLE_ABSENT] = "absent",
	[TABLE_WAITING] = "waiting",
	[TABLE_BUILDING] = "building",
	[TABLE_BUILT] = "loading",
	[TABLE_RESIDENT] = "resident",
	[TABLE_FAILED] = "failed",
};

const char *tables_state_name(enum table_state state)
{
	return state_names[state];
}

/* ---- life ---- */

static enum err acquire_builtin(struct tables *t)
{
	const struct profile profiles[2] = {profile_smooth(),
	    profile_bulge(0.8)};
	struct operator op = {.layout = t->layout};

	op.resolution = table_resolution(op.layout);
	for (int i = 0; i < BUILTIN_COUNT; i++) {
		enum err err;

		op.family = (enum operator_family)(i % 2);
		op.profile = profiles[i / 2];
		err = tables_acquire(t, &op, &t->builtin[i]);
		if (err != ERR_OK)
			return err;
		t->builtin[i]->is_builtin = true;
		tables_entry_want(t, t->builtin[i]);
	}
	return ERR_OK;
}

static void free_entries(struct tables *t)
{
	for (size_t i = 0; i < BUCKET_COUNT; i++) {
		while (t->buckets[i] != NULL) {
			struct table_entry *entry = t->buckets[i];

			t->buckets[i] = entry->chain;
			table_free(entry->table);
			free(entry);
		}
	}
}

enum err tables_create(enum table_layout layout, struct tables **out)
{
	struct tables *t = calloc(1, sizeof *t);
	enum err err;

	if (t == NULL)
		return ERR_MEMORY;
	t->layout = layout;
	t->room = t->reserved = 1;
	pthread_mutex_init(&t->lock, NULL);
	pthread_cond_init(&t->wake, NULL);
	err = acquire_builtin(t);
	if (err != ERR_OK) {
		tables_free(t);
		return err;
	}
	*out = t;
	return ERR_OK;
}

enum err tables_start(struct tables *t, bool measure_them,
    struct table_cache *cache, void (*changed)(void *ctx), void *ctx)
{
	t->cache = cache;
	t->changed = changed;
	t->ctx = ctx;
	t->measure = measure_them;
	for (int i = 0; i < LANE_COUNT; i++) {
		struct lane *lane = &t->lanes[i];

		lane->tables = t;
		lane->kind = (enum lane_kind)i;
		if (pthread_create(&lane->thread, NULL, tables_build_main,
		    lane) != 0)
			return ERR_IO;
		lane->is_started = true;
	}
	t->has_measurer = (measure_them || cache != NULL) &&
	    pthread_create(&t->measurer, NULL, tables_measure_main, t) == 0;
	return ERR_OK;
}

void tables_stop(struct tables *t)
{
	pthread_mutex_lock(&t->lock);
	atomic_store(&t->stop, true);
	pthread_cond_broadcast(&t->wake);
	pthread_mutex_unlock(&t->lock);
	for (int i = 0; i < LANE_COUNT; i++) {
		if (t->lanes[i].is_started)
			pthread_join(t->lanes[i].thread, NULL);
	}
	if (t->has_measurer)
		pthread_join(t->measurer, NULL);
}

void tables_free(struct tables *t)
{
	if (t == NULL)
		return;
	free_entries(t);
	pthread_cond_destroy(&t->wake);
	pthread_mutex_destroy(&t->lock);
	free(t);
}

enum err tables_check_builtin(struct tables *t, bool *ready)
{
	enum err err = ERR_OK;
	bool all = true;

	pthread_mutex_lock(&t->lock);
	for (int i = 0; i < BUILTIN_COUNT; i++) {
		if (t->builtin[i]->state == TABLE_FAILED)
			err = t->builtin[i]->err;
		all = all && t->builtin[i]->was_resident;
	}
	pthread_mutex_unlock(&t->lock);
	if (err == ERR_OK)
		*ready = all;
	return err;
}

/* ---- tables built elsewhere ---- */

/* Whether entry has no table, nor is one being made or uploaded. One that was
 * evicted while it was being measured has. Locked. */
static bool is_lacking(const struct table_entry *entry)
{
	return entry->table == NULL && (entry->state == TABLE_ABSENT ||
	    entry->state == TABLE_FAILED || entry->state == TABLE_WAITING);
}

/* Takes table over for entry. Locked. */
static void take(struct tables *t, struct table_entry *entry,
    struct table *table, double seconds)
{
	tables_entry_set_state(t, entry, TABLE_BUILT);
	entry->table = table;
	entry->bytes = table_bytes(table);
	entry->build_seconds = seconds;
}

enum err tables_give(struct tables *t, const struct operator *op,
    struct table *table, double seconds, struct table_report *out)
{
	struct table_entry *entry;
	bool taken = false;

	pthread_mutex_lock(&t->lock);
	entry = tables_entry_find(t, op);
	if (entry != NULL) {
		entry->is_draft = false;
		entry->is_steady = true;
		taken = is_lacking(entry);
		if (taken)
			take(t, entry, table, seconds);
		/* Wished for, a host copy left after eviction is loaded. */
		entry->turn = ++t->turn;
		tables_entry_wish(t, entry);
		*out = tables_report_entry(entry);
		tables_entry_limit_wishes(t, entry->wish);
	}
	pthread_mutex_unlock(&t->lock);
	if (!taken)
		table_free(table);
	if (entry == NULL)
		return ERR_MEMORY;
	t->changed(t->ctx);
	return ERR_OK;
}
