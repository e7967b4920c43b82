/*
 * An entry is kept until nobody refers to it and it holds nothing; its members
 * are guarded by the one lock, which is released while a table is built,
 * measured or uploaded. state says who works on the entry: a builder (WAITING,
 * BUILDING), the device thread (BUILT, RESIDENT), nobody (ABSENT, FAILED). slot
 * is the device thread's alone. An entry with claim TABLE_SPARE is not WAITING,
 * nor BUILT unless it is being uploaded, and, if BUILDING, is being abandoned.
 *
 * Clients make as many entries as they like: an entry is found by its hash, and
 * lies in a list of those with its state and size, so that no function but
 * tables_report looks at all of them.
 *
 * Each builder has a lane: drafts, what is asked for, wishes. A wish is one's
 * until its table is resident or has failed, or too many newer ones were made;
 * if it is then asked for while being built, the builder of what is asked for
 * begins anew, at its own priority, and the other one gives up.
 */
#include "server/tables.h"

#include <assert.h>
#include <pthread.h>
#include <sched.h>
#include <stdatomic.h>
#include <stdint.h>
#include <stdlib.h>
#include <sys/resource.h>

#include "server/clock.h"
#include "server/config.h"
#include "server/crew.h"
#include "server/log.h"
#include "server/table_cache.h"

#define BUILTIN_COUNT 4

/* Tables of a claim, or a larger one, that may wait for the device thread at
 * once: it can be busy for long, and a table takes up to 100 MB. */
#define BUILT_MAX 2

/* Wishes remembered, unless the latest evaluation has more: of an animated
 * profile all but the last few have moved on. */
#define WISHES_MAX 4

/* Wishes of one evaluation; repeated, it wishes for others, once it has these.
 * A thousand times as many would be dropped by the next one. */
#define WISHES_EACH_MAX 32

/* Of 16 entries each when 8 evaluations of 1000 drafted operators wait. */
#define BUCKET_COUNT 1024

/* Drafts that stay resident though nobody waits for them, 0.2 MB each. */
#define DRAFTS_MAX 64

/* Of the wishes' builder: about a tenth of a busy core. */
#define WISHES_NICE 10

/* Points measured in one step: about 10 ms, so that a shutdown does not wait. */
#define MEASURE_STEP 2000
#define MEASURE_QUANTITIES 10

static_assert(TABLE_SAMPLE % MEASURE_STEP == 0, "steps fill the sample");

enum lane_kind {
	LANE_DRAFTS,
	LANE_ASKED,
	LANE_WISHED,
	LANE_COUNT
};

/* A builder. */
struct lane {
	struct tables *tables;
	enum lane_kind kind;
	pthread_t thread;
	bool is_started;
	struct table_entry *entry; /* being built; NULL: none, or no more */
	atomic_bool abandon;       /* that build */
};

struct table_entry {
	struct table_entry *prev, *next; /* of its list, see list_of */
	struct table_entry *chain;       /* the next with its hash */
	size_t bucket;
	unsigned long number;     /* order of creation */
	enum table_state state;
	enum err err;             /* FAILED */
	size_t refs, asks;
	unsigned long reserved;   /* equals that of tables: it is */
	bool is_builtin;
	bool is_draft;
	unsigned long turn;       /* order of asking, then of last use */
	unsigned long wish;       /* likewise of wishing; 0: no wish */
	struct table_entry *wish_older, *wish_newer;
	bool is_loading;          /* BUILT: the device thread reads table */
	unsigned long refused;    /* equals room of tables: no room for it, with
	                           * a claim of at most refused_claim */
	enum table_claim refused_claim;
	struct lane *lane;        /* BUILDING: whose */
	struct table *table;      /* host copy; NULL once nobody needs it */
	bool measuring;           /* the measuring thread reads table */
	bool is_steady;           /* somebody allows no draft for it, so it is
	                           * not one of a profile that moves */
	bool is_kept;             /* in the cache, or it has been tried */
	bool was_resident;
	int slot;
	size_t bytes;
	double build_seconds;
	bool measured;
	struct table_error error;
	struct operator key;      /* its opening does not count */
};

struct list {
	struct table_entry *first, *last;
};

struct tables {
	enum table_layout layout; /* of the built-in tables */
	bool measure;
	struct table_cache *cache; /* or NULL */
	void (*changed)(void *ctx);
	void *ctx;
	pthread_mutex_t lock;     /* guards what follows and all entries */
	pthread_cond_t wake;      /* builders and measurer */
	struct table_entry *buckets[BUCKET_COUNT];
	struct list lists[TABLE_STATE_COUNT][2]; /* all entries; see list_of */
	struct table_entry *wish_oldest, *wish_newest;
	size_t wish_count;
	unsigned long number; /* entries made so far */
	unsigned long turn;
	unsigned long reserved;   /* counts calls of tables_reserve */
	unsigned long room;       /* counts what may have made room; from 1 */
	bool may_measure;
	atomic_bool stop;
	struct lane lanes[LANE_COUNT];
	pthread_t measurer;
	bool has_measurer;
	struct table_entry *builtin[BUILTIN_COUNT];
};

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

static bool same_key(const struct operator *a, const struct operator *b)
{
	return a->family == b->family && a->layout == b->layout &&
	    a->resolution == b->resolution &&
	    profile_equal(&a->profile, &b->profile);
}

/* Locked. */
static enum table_claim claim_of(const struct tables *t,
    const struct table_entry *entry)
{
	if (entry->is_builtin && !entry->was_resident)
		return TABLE_BUILTIN;
	if (entry->asks == 0)
		return entry->wish > 0 ? TABLE_WISHED : TABLE_SPARE;
	return entry->reserved == t->reserved ? TABLE_RESERVED : TABLE_ASKED;
}

/* ---- lists, locked ---- */

/* As small as a draft, whether it is one or not. */
static bool is_small(const struct table_entry *entry)
{
	return entry->key.resolution <= TABLES_DRAFT_RESOLUTION;
}

static struct list *list_of(struct tables *t, const struct table_entry *entry)
{
	return &t->lists[entry->state][is_small(entry)];
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

static void set_state(struct tables *t, struct table_entry *entry,
    enum table_state state)
{
	unlink_entry(t, entry);
	entry->state = state;
	link_last(t, entry);
}

/* Does nothing to one without a wish. */
static void drop_wish(struct tables *t, struct table_entry *entry)
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

static void add_wish(struct tables *t, struct table_entry *entry)
{
	drop_wish(t, entry);
	entry->wish_older = t->wish_newest;
	entry->wish_newer = NULL;
	*(t->wish_newest ? &t->wish_newest->wish_newer : &t->wish_oldest) =
	    entry;
	t->wish_newest = entry;
	entry->wish = ++t->turn;
	t->wish_count++;
}

/* ---- what becomes of an entry ---- */

/* Whether it is to be put in the cache; to be measured. Locked. */
static bool is_to_keep(const struct tables *t, const struct table_entry *entry)
{
	return t->cache != NULL && entry->is_steady && !entry->is_kept &&
	    !is_small(entry);
}

static bool is_to_measure(const struct tables *t,
    const struct table_entry *entry)
{
	return t->measure && !entry->measured && !entry->is_draft;
}

/* Frees the host copy where nobody will read it again. Locked. */
static void trim(struct tables *t, struct table_entry *entry)
{
	bool wanted = entry->state == TABLE_BUILT ||
	    (entry->state == TABLE_RESIDENT && (is_to_keep(t, entry) ||
	    is_to_measure(t, entry)));

	if (entry->measuring || wanted)
		return;
	table_free(entry->table);
	entry->table = NULL;
}

/* Forgets an entry that holds nothing and that nobody refers to. Locked. */
static void forget(struct tables *t, struct table_entry *entry)
{
	struct table_entry **link = &t->buckets[entry->bucket];

	trim(t, entry);
	if (entry->refs > 0 || entry->measuring ||
	    (entry->state != TABLE_ABSENT && entry->state != TABLE_FAILED))
		return;
	while (*link != entry)
		link = &(*link)->chain;
	*link = entry->chain;
	drop_wish(t, entry);
	unlink_entry(t, entry);
	free(entry);
}

/* Takes an entry that nobody waits for off its way to the device, but not out
 * of the device thread's hands. Locked. */
static void settle(struct tables *t, struct table_entry *entry)
{
	/* Another builder may be the one for it now, or no longer held back. */
	if (entry->state == TABLE_WAITING || entry->state == TABLE_BUILT)
		pthread_cond_broadcast(&t->wake);
	if (claim_of(t, entry) == TABLE_SPARE) {
		if (entry->state == TABLE_BUILDING)
			atomic_store(&entry->lane->abandon, true);
		if (entry->state == TABLE_WAITING ||
		    (entry->state == TABLE_BUILT && !entry->is_loading))
			set_state(t, entry, TABLE_ABSENT);
	}
	forget(t, entry);
}

/* Which builder builds it. Locked. */
static enum lane_kind lane_of(const struct tables *t,
    const struct table_entry *entry)
{
	if (is_small(entry))
		return LANE_DRAFTS;
	return claim_of(t, entry) > TABLE_WISHED ? LANE_ASKED : LANE_WISHED;
}

/* Takes an entry away from the builder that builds it. Locked. */
static void disown(struct tables *t, struct table_entry *entry)
{
	atomic_store(&entry->lane->abandon, true);
	entry->lane->entry = NULL;
	entry->lane = NULL;
	set_state(t, entry, TABLE_WAITING);
}

/*
 * Has an entry built unless it is already on its way. One evicted while it was
 * being measured still has its host copy. Locked.
 */
static void want(struct tables *t, struct table_entry *entry)
{
	if (entry->state == TABLE_ABSENT || entry->state == TABLE_FAILED) {
		set_state(t, entry, entry->table != NULL ? TABLE_BUILT :
		    TABLE_WAITING);
		entry->turn = ++t->turn;
	} else if (entry->state == TABLE_BUILDING &&
	    entry->lane->kind == LANE_WISHED &&
	    lane_of(t, entry) != LANE_WISHED) {
		disown(t, entry);
		entry->turn = ++t->turn;
	} else if (entry->state == TABLE_BUILDING) {
		atomic_store(&entry->lane->abandon, false);
	}
	if (entry->state == TABLE_WAITING)
		pthread_cond_broadcast(&t->wake);
}

/*
 * Drops the oldest wishes if there are too many, but none from first on, nor
 * what is being built or uploaded: of clients whose wishes displace each other
 * before any is built, none would ever come true. Locked.
 */
static void limit_wishes(struct tables *t, unsigned long first)
{
	struct table_entry *newer;

	for (struct table_entry *e = t->wish_oldest;
	    e != NULL && e->wish < first && t->wish_count > WISHES_MAX;
	    e = newer) {
		newer = e->wish_newer;
		if (e->state == TABLE_BUILDING || e->is_loading)
			continue;
		drop_wish(t, e);
		settle(t, e);
	}
}

/* Locked; limit_wishes should follow. */
static void wish(struct tables *t, struct table_entry *entry)
{
	if (entry->state == TABLE_RESIDENT)
		return;
	add_wish(t, entry);
	want(t, entry);
}

/* ---- building ---- */

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
	set_state(t, entry, TABLE_BUILT);
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

	set_state(t, entry, TABLE_BUILDING);
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
		set_state(t, entry, err != ERR_CANCELLED ? TABLE_FAILED :
		    TABLE_WAITING);
		if (err != ERR_CANCELLED)
			drop_wish(t, entry);
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

/* Whether a goes before b: the larger claim; of wishes the last made, else
 * the first asked for. Locked. */
static bool precedes(const struct tables *t, const struct table_entry *a,
    const struct table_entry *b)
{
	enum table_claim claim = claim_of(t, a);

	if (claim != claim_of(t, b))
		return claim > claim_of(t, b);
	return claim == TABLE_WISHED ? a->wish > b->wish : a->turn < b->turn;
}

/* Whether one more table with that claim may be built. Small ones may. */
static bool may_build(const struct tables *t, enum table_claim claim)
{
	int built = 0;

	for (const struct table_entry *e = t->lists[TABLE_BUILT][false].first;
	    e != NULL; e = e->next)
		built += claim_of(t, e) >= claim;
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
		if (lane_of(t, e) == kind &&
		    (entry == NULL || precedes(t, e, entry)))
			entry = e;
	}
	if (entry == NULL || small)
		return entry;
	return may_build(t, claim_of(t, entry)) ? entry : NULL;
}

static void *builder_main(void *arg)
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
		settle(t, entry);
		pthread_mutex_unlock(&t->lock);
		t->changed(t->ctx);
		pthread_mutex_lock(&t->lock);
	}
	pthread_mutex_unlock(&t->lock);
	return NULL;
}

/* ---- measuring ---- */

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
			if (e->table != NULL && is_to_keep(t, e))
				return e;
			if (e->table != NULL && is_to_measure(t, e) &&
			    found == NULL)
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
	if (!done || t->cache == NULL || is_small(entry))
		return;
	pthread_mutex_unlock(&t->lock);
	table_cache_store_figures(t->cache, &entry->key, &figures);
	pthread_mutex_lock(&t->lock);
}

static void *measurer_main(void *arg)
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
		if (is_to_keep(t, entry))
			keep_entry(t, entry);
		else
			measure_entry(t, entry);
		entry->measuring = false;
		forget(t, entry);
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
		want(t, t->builtin[i]);
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
		if (pthread_create(&lane->thread, NULL, builder_main, lane) != 0)
			return ERR_IO;
		lane->is_started = true;
	}
	t->has_measurer = (measure_them || cache != NULL) &&
	    pthread_create(&t->measurer, NULL, measurer_main, t) == 0;
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

/* ---- entries ---- */

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

/* The entry for op, a new one if need be; NULL: no memory. Locked. */
static struct table_entry *find(struct tables *t, const struct operator *op)
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

static enum err acquire(struct tables *t, const struct operator *op,
    bool as_draft, struct table_entry **out)
{
	struct table_entry *entry;

	pthread_mutex_lock(&t->lock);
	entry = find(t, op);
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
	forget(t, entry);
	pthread_mutex_unlock(&t->lock);
}

/* Locked. */
static void ask(struct tables *t, struct table_entry *entry)
{
	entry->asks++;
	want(t, entry);
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
		settle(t, entry);
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
		wish(t, entry);
		wishes++;
	}
	limit_wishes(t, first);
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
		wish(t, c->entries[i]);
		limit_wishes(t, c->entries[i]->wish);
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

/* ---- the device thread's side ---- */

/* Whether there is no room for it, as far as known. One that the evaluation
 * that has waited longest needs is tried each time. Locked. */
static bool is_refused(const struct tables *t, const struct table_entry *e)
{
	return e->refused == t->room && claim_of(t, e) <= e->refused_claim &&
	    claim_of(t, e) < TABLE_RESERVED;
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
			if (claim_of(t, e) >= least && !is_refused(t, e) &&
			    (entry == NULL || precedes(t, e, entry)))
				entry = e;
		}
	}
	if (entry != NULL) {
		entry->is_loading = true;
		*table = entry->table;
		*claim = claim_of(t, entry);
	}
	pthread_mutex_unlock(&t->lock);
	return entry;
}

void tables_loaded(struct tables *t, struct table_entry *entry, int slot)
{
	pthread_mutex_lock(&t->lock);
	entry->is_loading = false;
	entry->slot = slot;
	set_state(t, entry, TABLE_RESIDENT);
	drop_wish(t, entry);
	entry->was_resident = true;
	entry->turn = ++t->turn;
	trim(t, entry);
	pthread_cond_broadcast(&t->wake);
	pthread_mutex_unlock(&t->lock);
}

void tables_failed(struct tables *t, struct table_entry *entry, enum err err)
{
	pthread_mutex_lock(&t->lock);
	entry->is_loading = false;
	set_state(t, entry, TABLE_FAILED);
	drop_wish(t, entry);
	entry->err = err;
	forget(t, entry);
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
	settle(t, entry);
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
	if (claim_of(t, a) != claim_of(t, b))
		return claim_of(t, a) < claim_of(t, b);
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
			if (claim_of(t, e) < claim &&
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
	set_state(t, entry, TABLE_ABSENT);
	if (claim_of(t, entry) > TABLE_SPARE)
		want(t, entry);
	forget(t, entry);
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
			bytes += claim_of(t, e) < claim ? e->bytes : 0;
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
			add_wish(t, entry);
	}
	for (int small = 0; small < 2; small++) {
		const struct list *list = &t->lists[TABLE_RESIDENT][small];
		const struct table_entry *out;
		int slot;

		while (give_up(t, list->first, &out, &slot))
			;
	}
	limit_wishes(t, first);
	pthread_mutex_unlock(&t->lock);
}

/* ---- for people ---- */

static struct table_report report(const struct table_entry *entry)
{
	return (struct table_report){
		.number = entry->number,
		.family = entry->key.family,
		.profile = entry->key.profile,
		.layout = entry->key.layout,
		.resolution = entry->key.resolution,
		.draft = entry->is_draft,
		.state = entry->state,
		.bytes = entry->bytes,
		.build_seconds = entry->build_seconds,
		.measured = entry->measured && entry->error.count > 0,
		.error = entry->error,
	};
}

/* Reports every entry to out (NULL: none); how many there are. Locked. */
static size_t report_all(const struct tables *t, struct table_report *out)
{
	size_t n = 0;

	for (size_t i = 0; i < BUCKET_COUNT; i++) {
		for (const struct table_entry *e = t->buckets[i]; e != NULL;
		    e = e->chain, n++) {
			if (out != NULL)
				out[n] = report(e);
		}
	}
	return n;
}

static int compare_reports(const void *a, const void *b)
{
	const struct table_report *x = a, *y = b;

	return x->number < y->number ? -1 : x->number > y->number;
}

enum err tables_report(struct tables *t, struct table_report **out,
    size_t *count)
{
	struct table_report *list;
	size_t n;

	pthread_mutex_lock(&t->lock);
	n = report_all(t, NULL);
	list = malloc(sizeof *list * (n > 0 ? n : 1));
	if (list != NULL)
		report_all(t, list);
	pthread_mutex_unlock(&t->lock);
	if (list == NULL)
		return ERR_MEMORY;
	qsort(list, n, sizeof *list, compare_reports);
	*out = list;
	*count = n;
	return ERR_OK;
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
	set_state(t, entry, TABLE_BUILT);
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
	entry = find(t, op);
	if (entry != NULL) {
		entry->is_draft = false;
		entry->is_steady = true;
		taken = is_lacking(entry);
		if (taken)
			take(t, entry, table, seconds);
		/* Wished for, a host copy left after eviction is loaded. */
		entry->turn = ++t->turn;
		wish(t, entry);
		*out = report(entry);
		limit_wishes(t, entry->wish);
	}
	pthread_mutex_unlock(&t->lock);
	if (!taken)
		table_free(table);
	if (entry == NULL)
		return ERR_MEMORY;
	t->changed(t->ctx);
	return ERR_OK;
}
