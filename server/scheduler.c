/*
 * Who owns: the device thread owns the device, every uploaded tape and slot,
 * and the list of loaded programs; the lock guards the queue, the list of dead
 * programs and the published figures, and is released while the device works.
 * Who completes: finish(), called by the device thread alone, after it has
 * taken the job off the queue; so each job is completed exactly once.
 * Who gets on: the first job of the queue has a claim on all room for tables,
 * so its turn comes whatever the others need; they run if theirs are resident.
 */
#include "server/scheduler.h"

#include <pthread.h>
#include <stdatomic.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <time.h>

#include "core/output.h"
#include "core/tape.h"
#include "server/clock.h"
#include "server/log.h"
#include "server/program.h"
#include "server/tables.h"

/* Points and rows of all jobs waiting: more is refused as a full queue, since
 * memory that does not exist ends the process. */
#define QUEUE_BYTES_MAX ((size_t)1 << 30)

/* Tapes kept on the device for scenes that may be asked again. */
#define LOADED_BYTES_MAX ((size_t)64 << 20)

/* Seconds between looks at which waiting clients are gone: at least, since
 * each is a system call for every job; and at most. */
#define SWEEP_LEAST 0.05
#define SWEEP_MOST 0.5

struct scheduler {
	struct scheduler_options options;
	pthread_t thread;
	pthread_mutex_t lock;
	pthread_cond_t wake;  /* the device thread: events has changed */
	unsigned long events; /* counts what the device thread should look at */
	struct job *first, **last;
	size_t bytes;         /* of all jobs waiting */
	struct program *dead;
	bool draining;
	bool stopping;
	bool stopped;         /* the device is closed */
	struct scheduler_stats stats;
	atomic_bool cancel;
	/* device thread only: */
	struct device *device;
	struct program *newest, *oldest; /* loaded programs */
	size_t loaded_bytes;
	struct job *head;     /* whose tables are reserved, or NULL */
	double swept;         /* clock_seconds */
	enum err broken;      /* why there is no device */
	char why[256];        /* the same, for people */
};

static void signal_event(struct scheduler *s)
{
	s->events++;
	pthread_cond_signal(&s->wake);
}

static size_t job_bytes(const struct job *job)
{
	return job->count * sizeof(float) *
	    (3 + (size_t)output_row_floats(job->outputs));
}

/* ---- loaded programs, device thread ---- */

static void unlink_loaded(struct scheduler *s, struct program *p)
{
	*(p->newer ? &p->newer->older : &s->newest) = p->older;
	*(p->older ? &p->older->newer : &s->oldest) = p->newer;
	p->newer = p->older = NULL;
}

static void link_newest(struct scheduler *s, struct program *p)
{
	p->older = s->newest;
	p->newer = NULL;
	*(s->newest ? &s->newest->newer : &s->oldest) = p;
	s->newest = p;
}

static void unload(struct scheduler *s, struct program *p)
{
	if (p->loaded == NULL)
		return;
	unlink_loaded(s, p);
	s->loaded_bytes -= program_bytes(p);
	device_drop_tape(s->device, p->loaded);
	p->loaded = NULL;
}

static bool uses(const struct program *p, const struct table_entry *entry)
{
	for (size_t i = 0; i < p->entry_count; i++) {
		if (p->loaded_entries[i] == entry)
			return true;
	}
	return false;
}

/* Drops the table of entry, which has been given up, from slot. */
static void drop(struct scheduler *s, const struct table_entry *entry,
    int slot)
{
	struct program *older;

	for (struct program *p = s->newest; p != NULL; p = older) {
		older = p->older;
		if (uses(p, entry))
			unload(s, p);
	}
	device_drop_table(s->device, slot);
}

/* Drops drafts of which there are too many. */
static void thin_drafts(struct scheduler *s)
{
	const struct table_entry *entry;
	int slot;

	while (tables_evict_draft(s->options.tables, &entry, &slot))
		drop(s, entry, slot);
}

/* Makes room among the tables for one with that claim; false if there is
 * none to be made. */
static bool evict(struct scheduler *s, enum table_claim claim)
{
	const struct table_entry *entry;
	int slot;

	if (!tables_evict(s->options.tables, claim, &entry, &slot))
		return false;
	drop(s, entry, slot);
	return true;
}

/* With the tables in p->loaded_entries. */
static enum err load_tape(struct scheduler *s, struct program *p)
{
	int *slots = malloc(sizeof *slots * (p->entry_count + 1));
	enum err err;

	if (slots == NULL)
		return ERR_MEMORY;
	for (size_t i = 0; i < p->entry_count; i++)
		slots[i] = tables_slot(p->loaded_entries[i]);
	err = device_load_tape(s->device, p->tape, slots, &p->loaded);
	free(slots);
	return err;
}

/* Has p refer to tables, which are resident. */
static void refer(struct scheduler *s, struct program *p,
    struct table_entry *const *tables)
{
	size_t size = p->entry_count * sizeof *tables;

	if (p->drafts == NULL || memcmp(p->loaded_entries, tables, size) == 0)
		return;
	unload(s, p);
	memcpy(p->loaded_entries, tables, size);
}

/* Has p on the device, with these tables, as the one used last. */
static enum err load(struct scheduler *s, struct program *p,
    struct table_entry *const *tables)
{
	enum err err;

	refer(s, p, tables);
	if (p->loaded != NULL) {
		unlink_loaded(s, p);
		link_newest(s, p);
		return ERR_OK;
	}
	while (s->oldest != NULL &&
	    s->loaded_bytes + program_bytes(p) > LOADED_BYTES_MAX)
		unload(s, s->oldest);
	while ((err = load_tape(s, p)) == ERR_DEVICE_MEMORY &&
	    s->oldest != NULL)
		unload(s, s->oldest);
	if (err != ERR_OK)
		return err;
	s->loaded_bytes += program_bytes(p);
	link_newest(s, p);
	return ERR_OK;
}

static void bury_dead(struct scheduler *s)
{
	struct program *p, *next;

	pthread_mutex_lock(&s->lock);
	p = s->dead;
	s->dead = NULL;
	pthread_mutex_unlock(&s->lock);
	for (; p != NULL; p = next) {
		next = p->dead_next;
		unload(s, p);
		program_free(s->options.tables, p);
	}
}

/* ---- jobs, device thread ---- */

/* Without drafts there is nothing to choose: the program's own entries are. */
static enum err init_choice(struct job *job)
{
	const struct program *program = job->program;

	job->choice = (struct table_choice){
		.entries = program->entries,
		.drafts = program->drafts,
		.count = program->entry_count,
		.chosen = program->drafts == NULL ? program->entries :
		    calloc(program->entry_count, sizeof *program->entries),
	};
	return job->choice.chosen != NULL ? ERR_OK : ERR_MEMORY;
}

static void free_choice(struct job *job)
{
	if (job->program->drafts != NULL)
		free(job->choice.chosen);
	job->choice.chosen = NULL;
}

/* Hands job back. It may be gone as soon as done() has been called; only then
 * is it no longer counted in *count. */
static void finish(struct scheduler *s, struct job *job, enum err err,
    size_t *count)
{
	job->result = err;
	if (err != ERR_OK) {
		free(job->rows);
		job->rows = NULL;
	}
	tables_unask(s->options.tables, job->choice.chosen,
	    job->choice.count);
	free_choice(job);
	pthread_mutex_lock(&s->lock);
	s->stats.completed++;
	s->stats.points += err == ERR_OK ? job->count : 0;
	pthread_mutex_unlock(&s->lock);
	job->done(job->ctx);
	pthread_mutex_lock(&s->lock);
	--*count;
	pthread_mutex_unlock(&s->lock);
}

/* Takes *link off the queue. Locked. */
static struct job *unlink_job(struct scheduler *s, struct job **link)
{
	struct job *job = *link;

	*link = job->next;
	if (*link == NULL)
		s->last = link;
	s->bytes -= job_bytes(job);
	job->next = NULL;
	return job;
}

/* Takes all jobs that nobody waits for off the queue. */
static struct job *take_unwanted(struct scheduler *s)
{
	struct job **link = &s->first, *list = NULL;

	pthread_mutex_lock(&s->lock);
	while (*link != NULL) {
		struct job *job = *link;

		if (job->wanted(job->ctx)) {
			link = &job->next;
			continue;
		}
		unlink_job(s, link);
		job->next = list;
		list = job;
	}
	pthread_mutex_unlock(&s->lock);
	return list;
}

/* Completes the jobs whose clients have hung up: they take places in the queue
 * and have tables built. */
static void sweep(struct scheduler *s)
{
	double now = clock_seconds();
	struct job *job, *next;

	if (now - s->swept < SWEEP_LEAST)
		return;
	s->swept = now;
	for (job = take_unwanted(s); job != NULL; job = next) {
		next = job->next;
		finish(s, job, ERR_CANCELLED, &s->stats.waiting);
	}
}

static bool go_on(void *ctx)
{
	struct job *job = ctx;

	sweep(job->scheduler);
	return !atomic_load(&job->scheduler->cancel) && job->wanted(job->ctx);
}

static enum err run(struct scheduler *s, struct job *job)
{
	size_t floats = (size_t)output_row_floats(job->outputs);
	double begin = clock_seconds();
	enum err err;

	job->is_draft = job->choice.is_draft;
	err = load(s, job->program, job->choice.chosen);
	if (err == ERR_OK) {
		/* One byte more: an empty batch is no failure to allocate. */
		job->rows = malloc(job->count * floats * sizeof(float) + 1);
		err = job->rows == NULL ? ERR_MEMORY : device_evaluate(
		    s->device, job->program->loaded, job->points, job->count,
		    job->outputs, job->rows, go_on, job);
	}
	job->seconds = clock_seconds() - begin;
	if (err == ERR_DEVICE || err == ERR_DEVICE_MEMORY) {
		snprintf(job->message, sizeof job->message, "%s",
		    device_message(s->device));
		log_write(LOG_ERROR, "evaluation: %s: %s", err_message(err),
		    job->message);
	}
	return err;
}

/*
 * Whether job can be completed now, in *ready, and if that is without running
 * it, why.
 */
static enum err check(struct scheduler *s, struct job *job, bool *ready)
{
	*ready = true;
	if (s->broken != ERR_OK)
		return ERR_DEVICE;
	if (atomic_load(&s->cancel))
		return ERR_CANCELLED;
	if (job->is_too_large)
		return ERR_LIMIT;
	return tables_check(s->options.tables, &job->choice, ready);
}

/* Takes the first job that can be completed off the queue. */
static struct job *take(struct scheduler *s, enum err *err)
{
	struct job *job = NULL;

	pthread_mutex_lock(&s->lock);
	for (struct job **link = &s->first; *link != NULL;
	    link = &(*link)->next) {
		bool ready;

		*err = check(s, *link, &ready);
		if (!ready)
			continue;
		job = unlink_job(s, link);
		s->stats.waiting--;
		s->stats.running = 1;
		break;
	}
	pthread_mutex_unlock(&s->lock);
	return job;
}

/* Says in job what err alone does not. */
static void explain(const struct scheduler *s, struct job *job)
{
	if (s->broken != ERR_OK)
		snprintf(job->message, sizeof job->message, "%s", s->why);
	else if (job->is_too_large)
		snprintf(job->message, sizeof job->message, "its operator "
		    "tables together are larger than --table-memory");
}

/* Completes one job, if one can be. */
static bool serve(struct scheduler *s)
{
	enum err err;
	struct job *job = take(s, &err);

	if (job == NULL)
		return false;
	if (err != ERR_OK)
		explain(s, job);
	else if (!job->wanted(job->ctx))
		err = ERR_CANCELLED;
	else
		err = run(s, job);
	finish(s, job, err, &s->stats.running);
	return true;
}

/* ---- tables, device thread ---- */

static void fail_table(struct scheduler *s, struct table_entry *entry,
    enum err err)
{
	log_write(LOG_ERROR, "operator table: %s: %s", err_message(err),
	    device_message(s->device));
	tables_failed(s->options.tables, entry, err);
}

/* Reserves what the first job of the queue needs. */
static void reserve(struct scheduler *s)
{
	struct job *job;

	pthread_mutex_lock(&s->lock);
	job = s->first;
	pthread_mutex_unlock(&s->lock);
	if (job == NULL && s->head == NULL)
		return;
	s->head = job;
	tables_reserve(s->options.tables,
	    job != NULL ? job->choice.chosen : NULL,
	    job != NULL ? job->choice.count : 0);
}

/*
 * No room for a table that the head needs, nor any to be made. The head's may
 * lie so that they leave gaps: all are loaded again, alone.
 */
static void lack_room(struct scheduler *s)
{
	if (s->head->is_alone) {
		s->head->is_too_large = true;
		return;
	}
	s->head->is_alone = true;
	while (evict(s, TABLE_BUILTIN))
		;
}

/*
 * Whether giving up all tables of lesser claims would make room: none is given
 * up for nothing, but for the head's and the built-in ones, which must have it.
 */
static bool may_fit(struct scheduler *s, const struct table *table,
    enum table_claim claim)
{
	size_t most, used = device_table_bytes(s->device, &most);

	return claim >= TABLE_RESERVED || used + table_bytes(table) <=
	    most + tables_evictable(s->options.tables, claim);
}

/* Loads one built table, if there is one. Returns whether there was. */
static bool load_table(struct scheduler *s)
{
	bool is_alone = s->head != NULL && s->head->is_alone;
	const struct table *table;
	struct table_entry *entry;
	enum table_claim claim;
	enum err err;
	int slot;

	if (s->device == NULL || s->broken != ERR_OK)
		return false;
	entry = tables_next_built(s->options.tables,
	    is_alone ? TABLE_RESERVED : TABLE_SPARE, &table, &claim);
	if (entry == NULL)
		return false;
	do
		err = device_load_table(s->device, table, &slot);
	while (err == ERR_DEVICE_MEMORY && may_fit(s, table, claim) &&
	    evict(s, claim));
	if (err == ERR_DEVICE_MEMORY && claim != TABLE_BUILTIN) {
		tables_put_back(s->options.tables, entry, claim);
		if (claim == TABLE_RESERVED)
			lack_room(s);
		return true;
	}
	if (err == ERR_OK)
		tables_loaded(s->options.tables, entry, slot);
	else
		fail_table(s, entry, err);
	thin_drafts(s);
	pthread_mutex_lock(&s->lock);
	s->stats.table_bytes = device_table_bytes(s->device,
	    &s->stats.table_bytes_most);
	pthread_mutex_unlock(&s->lock);
	return true;
}

/* ---- the device thread ---- */

static void break_down(struct scheduler *s, enum err err, const char *what,
    const char *message)
{
	s->broken = err;
	snprintf(s->why, sizeof s->why, "%s: %s%s%s", what, err_message(err),
	    message[0] != '\0' ? ": " : "", message);
	log_write(LOG_ERROR, "%s: %s%s%s", what, err_message(err),
	    message[0] != '\0' ? ": " : "", message);
}

static void open_device(struct scheduler *s)
{
	struct device_failure failure = {0};
	double begin = clock_seconds();
	const struct device_info *info;
	enum err err = device_open(&s->options.device, &s->device, &failure);

	if (err != ERR_OK) {
		break_down(s, err, "device", failure.message);
		if (failure.build_log != NULL)
			log_text(LOG_ERROR, failure.build_log);
		device_failure_fini(&failure);
		s->options.failed(s->options.ctx);
		return;
	}
	info = device_get_info(s->device);
	log_write(LOG_INFO, "device %s: width %d, tables as %s, ready in "
	    "%.0f ms", info->name, info->width,
	    info->tables_are_images ? "images" : "buffers",
	    1e3 * (clock_seconds() - begin));
	pthread_mutex_lock(&s->lock);
	s->stats.device = *info;
	s->stats.table_bytes = device_table_bytes(s->device,
	    &s->stats.table_bytes_most);
	pthread_mutex_unlock(&s->lock);
}

/* Publishes readiness once, or that there never will be any. */
static void check_ready(struct scheduler *s)
{
	bool ready = false;
	enum err err;

	if (s->stats.ready || s->broken != ERR_OK)
		return;
	err = tables_check_builtin(s->options.tables, &ready);
	if (err != ERR_OK && !atomic_load(&s->cancel)) {
		break_down(s, err, "built-in operator tables",
		    err == ERR_MEMORY ? "" : device_message(s->device));
		s->options.failed(s->options.ctx);
	}
	if (err != ERR_OK || !ready)
		return;
	pthread_mutex_lock(&s->lock);
	s->stats.ready = true;
	pthread_mutex_unlock(&s->lock);
	s->options.ready(s->options.ctx);
}

/* Waits for a signal of s->wake; not for ever while jobs wait. False if none
 * came in time. Locked. */
static bool await_wake(struct scheduler *s)
{
	struct timespec until;

	if (s->first == NULL)
		return pthread_cond_wait(&s->wake, &s->lock) == 0;
	clock_gettime(CLOCK_MONOTONIC, &until);
	until.tv_nsec += (long)(1e9 * SWEEP_MOST);
	until.tv_sec += until.tv_nsec / 1000000000;
	until.tv_nsec %= 1000000000;
	return pthread_cond_timedwait(&s->wake, &s->lock, &until) == 0;
}

/* Waits until something happens after event, or it is time to look who still
 * waits; false once stopping. */
static bool await_event(struct scheduler *s, unsigned long *event)
{
	bool stopping;

	pthread_mutex_lock(&s->lock);
	while (s->events == *event && !s->stopping && await_wake(s))
		;
	*event = s->events;
	stopping = s->stopping;
	pthread_mutex_unlock(&s->lock);
	return !stopping;
}

static void close_device(struct scheduler *s)
{
	while (s->oldest != NULL)
		unload(s, s->oldest);
	device_close(s->device);
	s->device = NULL;
}

static void *device_main(void *arg)
{
	struct scheduler *s = arg;
	unsigned long event = 0;

	open_device(s);
	do {
		bool busy;

		do {
			bury_dead(s);
			sweep(s);
			reserve(s);
			busy = load_table(s);
			check_ready(s);
			busy = serve(s) || busy;
		} while (busy);
	} while (await_event(s, &event));
	while (serve(s))
		; /* cancelled, every one */
	close_device(s);
	return NULL;
}

/* ---- other threads ---- */

static void init_wake(pthread_cond_t *wake)
{
	pthread_condattr_t attributes;

	pthread_condattr_init(&attributes);
	pthread_condattr_setclock(&attributes, CLOCK_MONOTONIC);
	pthread_cond_init(wake, &attributes);
	pthread_condattr_destroy(&attributes);
}

enum err scheduler_create(const struct scheduler_options *options,
    struct scheduler **out)
{
	struct scheduler *s = calloc(1, sizeof *s);

	if (s == NULL)
		return ERR_MEMORY;
	s->options = *options;
	s->last = &s->first;
	pthread_mutex_init(&s->lock, NULL);
	init_wake(&s->wake);
	if (pthread_create(&s->thread, NULL, device_main, s) != 0) {
		s->stopped = true;
		scheduler_free(s);
		return ERR_IO;
	}
	*out = s;
	return ERR_OK;
}

enum err scheduler_submit(struct scheduler *s, struct job *job)
{
	size_t bytes = job_bytes(job);
	enum err err = init_choice(job);

	if (err != ERR_OK)
		return err;
	pthread_mutex_lock(&s->lock);
	if (s->draining)
		err = ERR_CANCELLED;
	else if (s->stats.waiting >= s->options.queue || (s->bytes > 0 &&
	    s->bytes + bytes > QUEUE_BYTES_MAX))
		err = ERR_BUSY;
	if (err == ERR_OK) {
		tables_choose(s->options.tables, &job->choice);
		job->scheduler = s;
		job->next = NULL;
		*s->last = job;
		s->last = &job->next;
		s->bytes += bytes;
		s->stats.waiting++;
		job->park(job->ctx);
		signal_event(s);
	}
	pthread_mutex_unlock(&s->lock);
	if (err != ERR_OK)
		free_choice(job);
	return err;
}

void scheduler_release(struct scheduler *s, struct program *program)
{
	bool stopped;

	if (atomic_fetch_sub(&program->refs, 1) != 1)
		return;
	pthread_mutex_lock(&s->lock);
	stopped = s->stopped;
	if (!stopped) {
		program->dead_next = s->dead;
		s->dead = program;
		signal_event(s);
	}
	pthread_mutex_unlock(&s->lock);
	if (stopped)
		program_free(s->options.tables, program);
}

void scheduler_tables_changed(struct scheduler *s)
{
	pthread_mutex_lock(&s->lock);
	signal_event(s);
	pthread_mutex_unlock(&s->lock);
}

void scheduler_drain(struct scheduler *s)
{
	pthread_mutex_lock(&s->lock);
	s->draining = true;
	pthread_mutex_unlock(&s->lock);
}

bool scheduler_is_idle(struct scheduler *s)
{
	bool idle;

	pthread_mutex_lock(&s->lock);
	idle = s->stats.waiting + s->stats.running == 0;
	pthread_mutex_unlock(&s->lock);
	return idle;
}

void scheduler_stop(struct scheduler *s)
{
	atomic_store(&s->cancel, true);
	pthread_mutex_lock(&s->lock);
	s->draining = true;
	s->stopping = true;
	signal_event(s);
	pthread_mutex_unlock(&s->lock);
	pthread_join(s->thread, NULL);
	pthread_mutex_lock(&s->lock);
	s->stopped = true;
	pthread_mutex_unlock(&s->lock);
	bury_dead(s);
}

void scheduler_free(struct scheduler *s)
{
	if (s == NULL)
		return;
	pthread_cond_destroy(&s->wake);
	pthread_mutex_destroy(&s->lock);
	free(s);
}

void scheduler_get_stats(struct scheduler *s, struct scheduler_stats *out)
{
	pthread_mutex_lock(&s->lock);
	*out = s->stats;
	pthread_mutex_unlock(&s->lock);
}
