/*
 * Builders: a thread a lane.
 */
#include "server/tables_internal.h"

#include <sys/resource.h>

#include "server/clock.h"
#include "server/crew.h"
#include "server/log.h"
#include "server/table_cache.h"

/* Tables of a claim, or a larger one, that may wait for the device thread at
 * once: it can be busy for long, and a table takes up to 100 MB. */
#define BUILT_MAX 2

/* Of the wishes' builder: about a tenth of a busy core. */
#define WISHES_NICE 10

struct build {
	struct lane *lane;
	struct table *table;
};

static bool fill_slice(void *ctx, size_t slice)
{
	const struct build *build = ctx;

	if (atomic_load(&build->lane->tables->stop) ||
	    atomic_load(&build->lane->abandon))
		return false;
	table_build(build->table, (int)slice, (int)slice + 1);
	return true;
}

/* Fills table on every core. False: told to leave it unfinished. */
static bool fill(struct lane *lane, struct table *table)
{
	struct build build = {lane, table};

	return crew_run((size_t)table->resolution, fill_slice, &build);
}

static void log_built(const struct table_entry *entry, bool is_loaded,
    double seconds)
{
	log_write(LOG_INFO, "table %s %s %s %d: %.1f MB%s in %.0f ms",
	    operator_family_name(entry->key.family),
	    profile_name(entry->key.profile.type),
	    operator_layout_name(entry->key.layout), entry->key.resolution,
	    1e-6 * (double)entry->bytes,
	    is_loaded ? " from the cache" : "", 1e3 * seconds);
}

static enum err make(struct lane *lane, const struct operator *key,
    struct table **out)
{
	struct table *table;
	enum err err = table_create(key->family, &key->profile, key->layout,
	    key->resolution, &table);

	if (err != ERR_OK)
		return err;
	if (!fill(lane, table)) {
		table_free(table);
		return ERR_CANCELLED;
	}
	*out = table;
	return ERR_OK;
}

/* The table of key from the cache; false if it is not there. One as small as a
 * draft is built as soon. */
static bool load(struct tables *t, const struct operator *key,
    struct table **out, struct table_figures *figures)
{
	return t->cache != NULL && key->resolution > TABLES_DRAFT_RESOLUTION &&
	    table_cache_load(t->cache, key, out, figures) == ERR_OK;
}

/* Puts down what has been made of entry. Locked. */
static void finish(struct tables *t, struct table_entry *entry,
    struct table *table, const struct table_figures *figures)
{
	tables_entry_set_state(t, entry, TABLE_BUILT);
	entry->table = table;
	entry->bytes = table_bytes(table);
	entry->build_seconds = figures->build_seconds;
	if (figures->is_measured) {
		entry->measured = true;
		entry->error = figures->error;
	}
}

/*
 * Builds one entry. Locked on entry and return, not while it builds. False: it
 * was taken away meanwhile, and may be gone.
 */
static bool build(struct lane *lane, struct table_entry *entry)
{
	struct tables *t = lane->tables;
	double begin = clock_seconds();
	struct table_figures figures = {0};
	struct operator key = entry->key;
	struct table *table = NULL;
	enum err err = ERR_OK;
	double seconds;
	bool loaded;

	tables_entry_set_state(t, entry, TABLE_BUILDING);
	entry->lane = lane;
	lane->entry = entry;
	atomic_store(&lane->abandon, false);
	pthread_mutex_unlock(&t->lock);
	loaded = load(t, &key, &table, &figures);
	if (!loaded)
		err = make(lane, &key, &table);
	seconds = clock_seconds() - begin;
	pthread_mutex_lock(&t->lock);
	if (lane->entry == NULL) {
		table_free(table);
		return false;
	}
	lane->entry = NULL;
	entry->lane = NULL;
	if (err != ERR_OK) {
		/* One asked for again meanwhile starts afresh. */
		tables_entry_set_state(t, entry, err != ERR_CANCELLED ?
		    TABLE_FAILED : TABLE_WAITING);
		if (err != ERR_CANCELLED)
			tables_entry_drop_wish(t, entry);
		entry->err = err;
		return true;
	}
	entry->is_kept = loaded;
	if (!loaded)
		figures.build_seconds = seconds;
	finish(t, entry, table, &figures);
	log_built(entry, loaded, seconds);
	return true;
}

/* Whether one more table with that claim may be built. Small ones may. */
static bool may_build(const struct tables *t, enum table_claim claim)
{
	int built = 0;

	for (const struct table_entry *e = t->lists[TABLE_BUILT][false].first;
	    e != NULL; e = e->next)
		built += tables_entry_claim(t, e) >= claim;
	return built < BUILT_MAX;
}

/* The entry for lane to build now, or NULL. */
static struct table_entry *next_to_build(struct tables *t,
    enum lane_kind kind)
{
	const bool small = kind == LANE_DRAFTS;
	struct table_entry *entry = NULL;

	for (struct table_entry *e = t->lists[TABLE_WAITING][small].first;
	    e != NULL; e = e->next) {
		if (tables_entry_lane(t, e) == kind &&
		    (entry == NULL || tables_entry_precedes(t, e, entry)))
			entry = e;
	}
	if (entry == NULL || small)
		return entry;
	return may_build(t, tables_entry_claim(t, entry)) ? entry : NULL;
}

void *tables_build_main(void *arg)
{
	struct lane *lane = arg;
	struct tables *t = lane->tables;

	/* Linux has a nice value for each thread. */
	if (lane->kind == LANE_WISHED)
		setpriority(PRIO_PROCESS, 0, WISHES_NICE);
	pthread_mutex_lock(&t->lock);
	while (!atomic_load(&t->stop)) {
		struct table_entry *entry = next_to_build(t, lane->kind);

		if (entry == NULL) {
			pthread_cond_wait(&t->wake, &t->lock);
			continue;
		}
		if (!build(lane, entry))
			continue;
		tables_entry_settle(t, entry);
		pthread_mutex_unlock(&t->lock);
		t->changed(t->ctx);
		pthread_mutex_lock(&t->lock);
	}
	pthread_mutex_unlock(&t->lock);
	return NULL;
}
