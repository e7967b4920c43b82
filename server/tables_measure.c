/*
 * The measuring thread: errors of tables, and tables to the cache.
 */
#include "server/tables_internal.h"

#include <assert.h>
#include <sched.h>
#include <stdlib.h>

#include "server/table_cache.h"

/* Points measured in one step: about 10 ms, so that a shutdown does not wait. */
#define MEASURE_STEP 2000
#define MEASURE_QUANTITIES 10

static_assert(TABLE_SAMPLE % MEASURE_STEP == 0, "steps fill the sample");

static bool measure(const struct table *table, const atomic_bool *stop,
    struct table_error *out)
{
	float *errors = malloc(sizeof *errors * TABLE_SAMPLE *
	    MEASURE_QUANTITIES);
	size_t at = 0;

	while (errors != NULL && at < TABLE_SAMPLE && !atomic_load(stop)) {
		table_measure(table, at, at + MEASURE_STEP, errors,
		    TABLE_SAMPLE);
		at += MEASURE_STEP;
	}
	if (at == TABLE_SAMPLE)
		table_error_summarise(errors, TABLE_SAMPLE, TABLE_SAMPLE, out);
	free(errors);
	return at == TABLE_SAMPLE;
}

/* A table to be kept, else one to be measured, or NULL. Locked. */
static struct table_entry *next_to_study(struct tables *t)
{
	struct table_entry *found = NULL;

	for (int small = 0; small < 2 && t->may_measure; small++) {
		for (struct table_entry *e =
		    t->lists[TABLE_RESIDENT][small].first; e != NULL;
		    e = e->next) {
			if (e->table != NULL && tables_entry_is_to_keep(t, e))
				return e;
			if (e->table != NULL && found == NULL &&
			    tables_entry_is_to_measure(t, e))
				found = e;
		}
	}
	return found;
}

static struct table_figures figures_of(const struct table_entry *entry)
{
	return (struct table_figures){
		.build_seconds = entry->build_seconds,
		.is_measured = entry->measured && entry->error.count > 0,
		.error = entry->error,
	};
}

/* Locked on entry and return, not while it writes. Others come and go; what
 * every start needs is to stay, so it counts as used now. */
static void keep_entry(struct tables *t, struct table_entry *entry)
{
	struct table_figures figures = figures_of(entry);

	pthread_mutex_unlock(&t->lock);
	for (int i = 0; i < BUILTIN_COUNT; i++)
		table_cache_touch(t->cache, &t->builtin[i]->key);
	table_cache_store(t->cache, entry->table, &figures);
	pthread_mutex_lock(&t->lock);
	entry->is_kept = true; /* not again, even if it failed */
}

/* The same. */
static void measure_entry(struct tables *t, struct table_entry *entry)
{
	struct table_error error = {0};
	struct table_figures figures;
	bool done;

	pthread_mutex_unlock(&t->lock);
	done = measure(entry->table, &t->stop, &error);
	pthread_mutex_lock(&t->lock);
	entry->measured = true; /* not again, even if it failed */
	entry->error = error;
	figures = figures_of(entry);
	if (!done || t->cache == NULL || tables_entry_is_small(entry))
		return;
	pthread_mutex_unlock(&t->lock);
	table_cache_store_figures(t->cache, &entry->key, &figures);
	pthread_mutex_lock(&t->lock);
}

void *tables_measure_main(void *arg)
{
	struct tables *t = arg;
	struct sched_param param = {0};

	pthread_setschedparam(pthread_self(), SCHED_IDLE, &param);
	pthread_mutex_lock(&t->lock);
	while (!atomic_load(&t->stop)) {
		struct table_entry *entry = next_to_study(t);

		if (entry == NULL) {
			pthread_cond_wait(&t->wake, &t->lock);
			continue;
		}
		entry->measuring = true;
		if (tables_entry_is_to_keep(t, entry))
			keep_entry(t, entry);
		else
			measure_entry(t, entry);
		entry->measuring = false;
		tables_entry_forget(t, entry);
	}
	pthread_mutex_unlock(&t->lock);
	return NULL;
}

void tables_measure(struct tables *t)
{
	pthread_mutex_lock(&t->lock);
	t->may_measure = true;
	pthread_cond_broadcast(&t->wake);
	pthread_mutex_unlock(&t->lock);
}
