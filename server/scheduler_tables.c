/*
 * Who gets on: one job, the head, has a claim on all room for tables, so its
 * turn comes whatever the others need; they run if theirs are resident. It is
 * the one served longest ago, and stays until it has run; one that is cut into
 * pieces for TENURE longer, since tables that displace each other are built
 * anew each time.
 */
#include "server/scheduler_internal.h"

#include <stdlib.h>
#include <string.h>

#include "core/tape.h"
#include "server/clock.h"
#include "server/log.h"
#include "server/program.h"

/* Tapes kept on the device for scenes that may be asked again. */
#define LOADED_BYTES_MAX ((size_t)64 << 20)

/* Seconds: about what building a table takes. */
#define TENURE 0.25

/* ---- loaded programs ---- */

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

void scheduler_tables_unload(struct scheduler *s, struct program *p)
{
	if (p->loaded == NULL)
		return;
	unlink_loaded(s, p);
	s->loaded_bytes -= device_tape_bytes(p->loaded);
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
			scheduler_tables_unload(s, p);
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
	scheduler_tables_unload(s, p);
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
		scheduler_tables_unload(s, s->oldest);
	while ((err = load_tape(s, p)) == ERR_DEVICE_MEMORY &&
	    s->oldest != NULL)
		scheduler_tables_unload(s, s->oldest);
	if (err != ERR_OK)
		return err;
	s->loaded_bytes += device_tape_bytes(p->loaded);
	link_newest(s, p);
	return ERR_OK;
}

enum err scheduler_tables_load(struct scheduler *s, const struct job *job)
{
	return load(s, job->program, job->choice.chosen);
}

void scheduler_tables_unload_all(struct scheduler *s)
{
	while (s->oldest != NULL)
		scheduler_tables_unload(s, s->oldest);
}

bool scheduler_tables_unload_others(struct scheduler *s,
    const struct program *p)
{
	struct program *newer;
	bool any = false;

	for (struct program *other = s->oldest; other != NULL; other = newer) {
		newer = other->newer;
		if (other == p)
			continue;
		scheduler_tables_unload(s, other);
		any = true;
	}
	return any;
}

/* ---- what jobs have chosen ---- */

/* Without drafts there is nothing to choose: the program's own entries are. */
enum err scheduler_tables_init_choice(struct job *job)
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

void scheduler_tables_free_choice(struct job *job)
{
	if (job->program->drafts != NULL)
		free(job->choice.chosen);
	job->choice.chosen = NULL;
}

enum err scheduler_tables_check(struct scheduler *s, struct job *job,
    bool *ready)
{
	enum err err;

	*ready = job->choice.count == 0;
	if (*ready || job->unready == s->changes)
		return ERR_OK;
	err = tables_check(s->options.tables, &job->choice, ready);
	if (err == ERR_OK && !*ready)
		job->unready = s->changes;
	return err;
}

void scheduler_tables_settle(struct job *job)
{
	job->is_draft = job->choice.is_draft;
	job->choice.entries = job->choice.chosen;
	job->choice.drafts = NULL;
}

bool scheduler_tables_agree(const struct job *a, const struct job *b)
{
	return a->program->drafts == NULL || memcmp(a->choice.chosen,
	    b->choice.chosen, a->choice.count * sizeof *a->choice.chosen) == 0;
}

/* ---- the head ---- */

void scheduler_tables_took(struct scheduler *s, struct job *job)
{
	if (s->head == job && s->tenure == 0.0)
		s->tenure = clock_seconds() + TENURE;
	/* Should it need all room again, it is to have it again. */
	job->is_alone = false;
}

void scheduler_tables_forget(struct scheduler *s, struct job *job)
{
	if (s->head != job)
		return;
	s->head = NULL;
	job->is_alone = false;
}

/* The one served longest ago, or NULL. */
static struct job *oldest(const struct scheduler *s)
{
	struct job *job = s->waiting.first;

	while (job != NULL && job->is_stalled)
		job = job->links[JOB_BY_AGE].next;
	return job;
}

void scheduler_tables_reserve(struct scheduler *s)
{
	struct job *head = s->head;

	if (head == NULL || (s->tenure > 0.0 && clock_seconds() >= s->tenure))
		head = oldest(s);
	if (head == s->head && s->reserved == s->changes)
		return;
	if (head != s->head)
		s->tenure = 0.0;
	s->head = head;
	s->reserved = s->changes;
	if ((head != NULL && head->choice.count > 0) || s->has_reserved)
		tables_reserve(s->options.tables,
		    head != NULL ? head->choice.chosen : NULL,
		    head != NULL ? head->choice.count : 0);
	s->has_reserved = head != NULL && head->choice.count > 0;
}

/* ---- tables ---- */

static void fail_table(struct scheduler *s, struct table_entry *entry,
    enum err err)
{
	log_write(LOG_ERROR, "operator table: %s: %s", err_message(err),
	    device_message(s->device));
	tables_failed(s->options.tables, entry, err);
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

void scheduler_tables_publish(struct scheduler *s)
{
	size_t most = 0, bytes = s->device == NULL ? 0 :
	    device_table_bytes(s->device, &most);

	pthread_mutex_lock(&s->lock);
	s->stats.table_bytes = bytes;
	if (s->device != NULL)
		s->stats.table_bytes_most = most;
	pthread_mutex_unlock(&s->lock);
}

bool scheduler_tables_load_next(struct scheduler *s)
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
	s->changes++;
	scheduler_device_begin(s);
	do
		err = device_load_table(s->device, table, &slot);
	while (err == ERR_DEVICE_MEMORY && may_fit(s, table, claim) &&
	    evict(s, claim));
	scheduler_device_end(s);
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
	scheduler_tables_publish(s);
	/* At the start it is rather the device's fault than its end. */
	if (s->was_ready)
		scheduler_device_check(s, err);
	return true;
}
