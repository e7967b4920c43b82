/*
 * An entry belongs to the list until nobody refers to it and it holds nothing;
 * its members are guarded by the one lock, which is released while a table is
 * built, measured or uploaded. state says who works on the entry: the builder
 * (WAITING, BUILDING), the device thread (BUILT, RESIDENT), nobody (ABSENT,
 * FAILED). slot is the device thread's alone. An entry with claim TABLE_SPARE
 * is not WAITING or BUILT, and, if BUILDING, is being abandoned.
 */
#include "server/tables.h"

#include <assert.h>
#include <pthread.h>
#include <sched.h>
#include <stdatomic.h>
#include <stdlib.h>
#include <unistd.h>

#include "server/clock.h"
#include "server/config.h"
#include "server/log.h"

#define BUILDERS_MAX 64
#define BUILTIN_COUNT 4

/* Tables of a claim, or a larger one, that may wait for the device thread at
 * once: it can be busy for long, and a table takes up to 100 MB. */
#define BUILT_MAX 2

/* Points measured in one step: about 10 ms, so that a shutdown does not wait. */
#define MEASURE_STEP 2000
#define MEASURE_QUANTITIES 10

static_assert(TABLE_SAMPLE % MEASURE_STEP == 0, "steps fill the sample");

struct table_entry {
	struct table_entry *next;
	struct operator key;      /* its opening does not count */
	enum table_state state;
	enum err err;             /* FAILED */
	size_t refs, asks;
	bool is_reserved;
	bool is_builtin;
	unsigned long turn;       /* order of asking, then of last use */
	struct table *table;      /* host copy; NULL once nobody needs it */
	bool measuring;           /* the measuring thread reads table */
	bool was_resident;
	int slot;
	size_t bytes;
	double build_seconds;
	bool measured;
	struct table_error error;
};

struct tables {
	enum table_layout layout; /* of the built-in tables */
	bool measure;
	void (*changed)(void *ctx);
	void *ctx;
	pthread_mutex_t lock;     /* guards the list and all entries */
	pthread_cond_t wake;      /* builder and measurer */
	struct table_entry *list;
	unsigned long turn;
	bool may_measure;
	atomic_bool stop;
	atomic_bool abandon;      /* what the builder builds now */
	pthread_t builder, measurer;
	bool has_builder, has_measurer;
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
static enum table_claim claim_of(const struct table_entry *entry)
{
	if (entry->is_builtin && !entry->was_resident)
		return TABLE_BUILTIN;
	if (entry->asks == 0)
		return TABLE_SPARE;
	return entry->is_reserved ? TABLE_RESERVED : TABLE_ASKED;
}

/* Frees the host copy where nobody will read it again. Locked. */
static void trim(struct tables *t, struct table_entry *entry)
{
	bool wanted = entry->state == TABLE_BUILT ||
	    (entry->state == TABLE_RESIDENT && t->measure &&
	    !entry->measured);

	if (entry->measuring || wanted)
		return;
	table_free(entry->table);
	entry->table = NULL;
}

/* Forgets an entry that holds nothing and that nobody refers to. Locked. */
static void forget(struct tables *t, struct table_entry *entry)
{
	struct table_entry **link = &t->list;

	trim(t, entry);
	if (entry->refs > 0 || entry->measuring ||
	    (entry->state != TABLE_ABSENT && entry->state != TABLE_FAILED))
		return;
	while (*link != entry)
		link = &(*link)->next;
	*link = entry->next;
	free(entry);
}

/* Takes an entry that nobody waits for off its way to the device. Locked. */
static void settle(struct tables *t, struct table_entry *entry)
{
	if (claim_of(entry) == TABLE_SPARE) {
		if (entry->state == TABLE_BUILDING)
			atomic_store(&t->abandon, true);
		if (entry->state == TABLE_WAITING ||
		    entry->state == TABLE_BUILT)
			entry->state = TABLE_ABSENT;
		pthread_cond_broadcast(&t->wake);
	}
	forget(t, entry);
}

/*
 * Has an entry built unless it is already on its way. One evicted while it was
 * being measured still has its host copy. Locked.
 */
static void want(struct tables *t, struct table_entry *entry)
{
	if (entry->state == TABLE_BUILDING)
		atomic_store(&t->abandon, false);
	if (entry->state != TABLE_ABSENT && entry->state != TABLE_FAILED)
		return;
	entry->state = entry->table != NULL ? TABLE_BUILT : TABLE_WAITING;
	entry->turn = ++t->turn;
	pthread_cond_broadcast(&t->wake);
}

/* ---- building ---- */

struct build {
	struct table *table;
	atomic_int next; /* slice to fill */
	atomic_int filled;
	const atomic_bool *stop, *abandon;
};

static void *fill_slices(void *arg)
{
	struct build *build = arg;

	while (!atomic_load(build->stop) && !atomic_load(build->abandon)) {
		int slice = atomic_fetch_add(&build->next, 1);

		if (slice >= build->table->resolution)
			break;
		table_build(build->table, slice, slice + 1);
		atomic_fetch_add(&build->filled, 1);
	}
	return NULL;
}

/* Fills table on every core; the calling thread takes part. False: told to
 * leave it unfinished. */
static bool fill(struct tables *t, struct table *table)
{
	struct build build = {table, 0, 0, &t->stop, &t->abandon};
	pthread_t threads[BUILDERS_MAX];
	long cores = sysconf(_SC_NPROCESSORS_ONLN);
	int count = 0;

	while (count < BUILDERS_MAX && count + 1 < cores &&
	    pthread_create(&threads[count], NULL, fill_slices, &build) == 0)
		count++;
	fill_slices(&build);
	while (count > 0)
		pthread_join(threads[--count], NULL);
	return atomic_load(&build.filled) == table->resolution;
}

static void log_built(const struct table_entry *entry)
{
	log_write(LOG_INFO, "table %s %s %s %d: %.1f MB in %.0f ms",
	    operator_family_name(entry->key.family),
	    profile_name(entry->key.profile.type),
	    operator_layout_name(entry->key.layout), entry->key.resolution,
	    1e-6 * (double)entry->bytes, 1e3 * entry->build_seconds);
}

/* Builds one entry. Locked on entry and return, not while it builds. */
static void build(struct tables *t, struct table_entry *entry)
{
	double begin = clock_seconds();
	struct operator key = entry->key;
	struct table *table = NULL;
	enum err err;

	entry->state = TABLE_BUILDING;
	atomic_store(&t->abandon, false);
	pthread_mutex_unlock(&t->lock);
	err = table_create(key.family, &key.profile, key.layout,
	    key.resolution, &table);
	if (err == ERR_OK && !fill(t, table))
		err = ERR_CANCELLED;
	pthread_mutex_lock(&t->lock);
	if (err != ERR_OK) {
		table_free(table);
		/* One asked for again meanwhile starts afresh. */
		entry->state = err != ERR_CANCELLED ? TABLE_FAILED :
		    TABLE_WAITING;
		entry->err = err;
		return;
	}
	entry->state = TABLE_BUILT;
	entry->table = table;
	entry->bytes = table_bytes(table);
	entry->build_seconds = clock_seconds() - begin;
	log_built(entry);
}

/* The one in state with the largest claim; of several, the first asked for. */
static struct table_entry *next_in(struct tables *t, enum table_state state)
{
	struct table_entry *best = NULL;

	for (struct table_entry *e = t->list; e != NULL; e = e->next) {
		if (e->state != state)
			continue;
		if (best == NULL || claim_of(e) > claim_of(best) ||
		    (claim_of(e) == claim_of(best) && e->turn < best->turn))
			best = e;
	}
	return best;
}

/* The entry to build now, or NULL. */
static struct table_entry *next_to_build(struct tables *t)
{
	struct table_entry *entry = next_in(t, TABLE_WAITING);
	int built = 0;

	for (struct table_entry *e = t->list; entry != NULL && e != NULL;
	    e = e->next)
		built += e->state == TABLE_BUILT &&
		    claim_of(e) >= claim_of(entry);
	return built < BUILT_MAX ? entry : NULL;
}

static void *builder_main(void *arg)
{
	struct tables *t = arg;

	pthread_mutex_lock(&t->lock);
	while (!atomic_load(&t->stop)) {
		struct table_entry *entry = next_to_build(t);

		if (entry == NULL) {
			pthread_cond_wait(&t->wake, &t->lock);
			continue;
		}
		build(t, entry);
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

static struct table_entry *next_to_measure(struct tables *t)
{
	if (!t->may_measure)
		return NULL;
	for (struct table_entry *e = t->list; e != NULL; e = e->next) {
		if (e->state == TABLE_RESIDENT && e->table != NULL &&
		    !e->measured)
			return e;
	}
	return NULL;
}

static void *measurer_main(void *arg)
{
	struct tables *t = arg;
	struct sched_param param = {0};
	struct table_error error;

	pthread_setschedparam(pthread_self(), SCHED_IDLE, &param);
	pthread_mutex_lock(&t->lock);
	while (!atomic_load(&t->stop)) {
		struct table_entry *entry = next_to_measure(t);
		bool done;

		if (entry == NULL) {
			pthread_cond_wait(&t->wake, &t->lock);
			continue;
		}
		entry->measuring = true;
		pthread_mutex_unlock(&t->lock);
		done = measure(entry->table, &t->stop, &error);
		pthread_mutex_lock(&t->lock);
		entry->measuring = false;
		entry->measured = true; /* not again, even if it failed */
		entry->error = done ? error : (struct table_error){0};
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

	op.resolution = config_resolution(op.layout);
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
	while (t->list != NULL) {
		struct table_entry *entry = t->list;

		t->list = entry->next;
		table_free(entry->table);
		free(entry);
	}
}

enum err tables_create(enum table_layout layout, struct tables **out)
{
	struct tables *t = calloc(1, sizeof *t);
	enum err err;

	if (t == NULL)
		return ERR_MEMORY;
	t->layout = layout;
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
    void (*changed)(void *ctx), void *ctx)
{
	t->changed = changed;
	t->ctx = ctx;
	t->measure = measure_them;
	if (pthread_create(&t->builder, NULL, builder_main, t) != 0)
		return ERR_IO;
	t->has_builder = true;
	t->has_measurer = measure_them &&
	    pthread_create(&t->measurer, NULL, measurer_main, t) == 0;
	return ERR_OK;
}

void tables_stop(struct tables *t)
{
	pthread_mutex_lock(&t->lock);
	atomic_store(&t->stop, true);
	pthread_cond_broadcast(&t->wake);
	pthread_mutex_unlock(&t->lock);
	if (t->has_builder)
		pthread_join(t->builder, NULL);
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

enum err tables_acquire(struct tables *t, const struct operator *op,
    struct table_entry **out)
{
	struct table_entry **link = &t->list;
	struct table_entry *entry;

	pthread_mutex_lock(&t->lock);
	while (*link != NULL && !same_key(&(*link)->key, op))
		link = &(*link)->next;
	entry = *link;
	if (entry == NULL) {
		entry = *link = calloc(1, sizeof *entry);
		if (entry != NULL)
			entry->key = *op;
	}
	if (entry != NULL)
		entry->refs++;
	pthread_mutex_unlock(&t->lock);
	if (entry == NULL)
		return ERR_MEMORY;
	*out = entry;
	return ERR_OK;
}

void tables_release(struct tables *t, struct table_entry *entry)
{
	pthread_mutex_lock(&t->lock);
	entry->refs--;
	forget(t, entry);
	pthread_mutex_unlock(&t->lock);
}

void tables_ask(struct tables *t, struct table_entry *const *entries,
    size_t count)
{
	pthread_mutex_lock(&t->lock);
	for (size_t i = 0; i < count; i++) {
		entries[i]->asks++;
		want(t, entries[i]);
	}
	pthread_mutex_unlock(&t->lock);
}

void tables_unask(struct tables *t, struct table_entry *const *entries,
    size_t count)
{
	pthread_mutex_lock(&t->lock);
	for (size_t i = 0; i < count; i++) {
		if (entries[i]->state == TABLE_RESIDENT)
			entries[i]->turn = ++t->turn;
		if (--entries[i]->asks == 0)
			settle(t, entries[i]);
	}
	pthread_mutex_unlock(&t->lock);
}

void tables_reserve(struct tables *t, struct table_entry *const *entries,
    size_t count)
{
	pthread_mutex_lock(&t->lock);
	for (struct table_entry *e = t->list; e != NULL; e = e->next)
		e->is_reserved = false;
	for (size_t i = 0; i < count; i++) {
		entries[i]->is_reserved = true;
		/* The builder may have held back. */
		if (entries[i]->state == TABLE_WAITING)
			pthread_cond_broadcast(&t->wake);
	}
	pthread_mutex_unlock(&t->lock);
}

enum err tables_check(struct tables *t, struct table_entry *const *entries,
    size_t count, bool *ready)
{
	enum err err = ERR_OK;
	bool all = true;

	pthread_mutex_lock(&t->lock);
	for (size_t i = 0; i < count; i++) {
		if (entries[i]->state == TABLE_FAILED)
			err = entries[i]->err;
		all = all && entries[i]->state == TABLE_RESIDENT;
	}
	pthread_mutex_unlock(&t->lock);
	if (err == ERR_OK)
		*ready = all;
	return err;
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

struct table_entry *tables_next_built(struct tables *t,
    const struct table **table, enum table_claim *claim)
{
	struct table_entry *entry;

	pthread_mutex_lock(&t->lock);
	entry = next_in(t, TABLE_BUILT);
	if (entry != NULL) {
		*table = entry->table;
		*claim = claim_of(entry);
	}
	pthread_mutex_unlock(&t->lock);
	return entry;
}

void tables_loaded(struct tables *t, struct table_entry *entry, int slot)
{
	pthread_mutex_lock(&t->lock);
	entry->slot = slot;
	entry->state = TABLE_RESIDENT;
	entry->was_resident = true;
	entry->turn = ++t->turn;
	trim(t, entry);
	pthread_cond_broadcast(&t->wake);
	pthread_mutex_unlock(&t->lock);
}

void tables_failed(struct tables *t, struct table_entry *entry, enum err err)
{
	pthread_mutex_lock(&t->lock);
	entry->state = TABLE_FAILED;
	entry->err = err;
	forget(t, entry);
	pthread_mutex_unlock(&t->lock);
}

int tables_slot(const struct table_entry *entry)
{
	return entry->slot;
}

/* The resident entry to give up first for one with that claim, or NULL. */
static struct table_entry *least_needed(struct tables *t,
    enum table_claim claim)
{
	struct table_entry *best = NULL;

	for (struct table_entry *e = t->list; e != NULL; e = e->next) {
		if (e->state != TABLE_RESIDENT || claim_of(e) >= claim)
			continue;
		if (best == NULL || claim_of(e) < claim_of(best) ||
		    (claim_of(e) == claim_of(best) && e->turn < best->turn))
			best = e;
	}
	return best;
}

bool tables_evict(struct tables *t, enum table_claim claim,
    const struct table_entry **out, int *slot)
{
	struct table_entry *entry;

	pthread_mutex_lock(&t->lock);
	entry = least_needed(t, claim);
	if (entry != NULL) {
		*out = entry;
		*slot = entry->slot;
		entry->state = TABLE_ABSENT;
		if (claim_of(entry) > TABLE_SPARE)
			want(t, entry);
		forget(t, entry);
	}
	pthread_mutex_unlock(&t->lock);
	return entry != NULL;
}

/* ---- for people ---- */

static struct table_report report(const struct table_entry *entry)
{
	return (struct table_report){
		.family = entry->key.family,
		.profile = entry->key.profile,
		.layout = entry->key.layout,
		.resolution = entry->key.resolution,
		.state = entry->state,
		.bytes = entry->bytes,
		.build_seconds = entry->build_seconds,
		.measured = entry->measured && entry->error.count > 0,
		.error = entry->error,
	};
}

enum err tables_report(struct tables *t, struct table_report **out,
    size_t *count)
{
	struct table_report *list;
	size_t n = 0;

	pthread_mutex_lock(&t->lock);
	for (const struct table_entry *e = t->list; e != NULL; e = e->next)
		n++;
	list = malloc(sizeof *list * (n > 0 ? n : 1));
	n = 0;
	for (const struct table_entry *e = t->list; list != NULL && e != NULL;
	    e = e->next)
		list[n++] = report(e);
	pthread_mutex_unlock(&t->lock);
	if (list == NULL)
		return ERR_MEMORY;
	*out = list;
	*count = n;
	return ERR_OK;
}
