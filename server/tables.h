/*
 * The operator tables the daemon keeps: built in the background on all cores,
 * made resident by the device thread, evicted least recently used first.
 *
 * Drafts: an operator may allow that a coarse table of its profile, family and
 * layout, built in milliseconds, stands in while its own is not resident. Its
 * own is then wished for: built when nothing else is, unless newer wishes have
 * displaced it.
 *
 * Threads: functions are safe from any thread unless they say "device thread".
 * Three builder threads fill tables, for drafts, for what is asked for, and, at
 * lesser priority, for wishes, so that none waits for a lesser one; one more at
 * idle priority measures their error and keeps them in the cache, if there is
 * one. None touches the device.
 */
#ifndef SERVER_TABLES_H
#define SERVER_TABLES_H

#include <stdbool.h>
#include <stddef.h>

#include "core/err.h"
#include "core/operator.h"
#include "core/table.h"

struct table_cache;
struct table_entry;
struct tables;

/*
 * How much a table is needed. One being loaded may displace those resident
 * with a lesser claim; one displaced that is still asked for is built anew.
 */
enum table_claim {
	TABLE_SPARE,    /* nobody waits for it */
	TABLE_WISHED,   /* nobody waits for it, but it would be of use */
	TABLE_ASKED,    /* some evaluation does */
	TABLE_RESERVED, /* the evaluation that has waited longest does */
	TABLE_BUILTIN   /* a built-in one that has never been resident */
};

enum table_state {
	TABLE_ABSENT,   /* nobody asks for it */
	TABLE_WAITING,  /* for the builder */
	TABLE_BUILDING,
	TABLE_BUILT,    /* waiting for the device thread */
	TABLE_RESIDENT,
	TABLE_FAILED,   /* built anew when asked for again */
	TABLE_STATE_COUNT
};

/*
 * Nodes an axis of a draft. One core builds it in 6 to 11 ms; over the sample
 * of core/table.h g is off by at most (on average) 4.1e-4 (1.6e-6) for unions
 * and 8.2e-4 (2.5e-5) for intersections of the smooth profile, 3.7e-4 (4.4e-6)
 * and 8.7e-4 (5.3e-5) of bulge 0.8, 4.3e-3 (7.2e-6) and 5.9e-3 (7.5e-5) of bulge
 * 1; the paper's layout: 1.9e-2, 1.9e-2, 7.7e-2, 5.9e-2, 1.1e-1, 6.7e-2. With
 * 12 nodes errors are twice as large in 4 ms, with 24 0.6 times in 20 to 35.
 */
#define TABLES_DRAFT_RESOLUTION 16

/* One table, for people: a copy. */
struct table_report {
	unsigned long number; /* in the order in which they were first named */
	enum operator_family family;
	struct profile profile;
	enum table_layout layout;
	int resolution;
	bool draft;           /* stands in for a finer one */
	enum table_state state;
	size_t bytes;         /* 0 until built once */
	double build_seconds; /* also if it then came out of the cache */
	bool measured;        /* error is filled */
	struct table_error error;
};

/*
 * Asks for the built-in tables, in layout: unions and intersections of the
 * smooth profile and of bulge 0.8. ERR_MEMORY.
 */
enum err tables_create(enum table_layout layout, struct tables **out);

/*
 * Starts the threads. changed(ctx) is called from the builder when a table has
 * been built, or has failed, and by tables_give. measure: tables' errors will
 * be measured. cache, NULL for none, is the caller's: tables are looked for
 * there before they are built, drafts aside, and put there when they are
 * resident, unless all that use them allow drafts. ERR_IO.
 */
enum err tables_start(struct tables *t, bool measure,
    struct table_cache *cache, void (*changed)(void *ctx), void *ctx);

/* Ends the threads soon, leaving tables unbuilt. Calls nothing back after. */
void tables_stop(struct tables *t);

/* After tables_stop if it was started, and with every entry released. NULL
 * does nothing. */
void tables_free(struct tables *t);

/*
 * The entry for op's family, profile, layout and resolution, for
 * tables_release. ERR_MEMORY.
 */
enum err tables_acquire(struct tables *t, const struct operator *op,
    struct table_entry **out);
void tables_release(struct tables *t, struct table_entry *entry);

/* The same for the draft that may stand in for that one, which must be finer
 * (tables_has_draft). */
enum err tables_acquire_draft(struct tables *t, const struct operator *op,
    struct table_entry **out);

/* Whether op allows a draft, and its table is finer than one. */
bool tables_has_draft(const struct operator *op);

/* Tables one evaluation needs, or those that stand in for them. */
struct table_choice {
	struct table_entry *const *entries; /* what it needs */
	struct table_entry *const *drafts;  /* what may stand in; NULLs: none */
	size_t count;
	struct table_entry **chosen; /* count of them: what is asked for */
	size_t at;                   /* where the next look begins */
	bool is_draft;               /* found ready: with drafts */
};

/*
 * Chooses one table of each pair, entries[i] if that is resident or drafts[i]
 * is NULL, else drafts[i], and asks for it; for entries[i] it then wishes,
 * unless there are very many. entries, drafts (NULL: there are none) and count
 * are set; chosen has room, or, if drafts is NULL, may be entries.
 *
 * Who has chosen calls tables_unask for what is chosen in the end. A table that
 * is no longer asked for is not built; a resident one may stay.
 */
void tables_choose(struct tables *t, struct table_choice *choice);
void tables_unask(struct tables *t, struct table_entry *const *entries,
    size_t count);

/* Nodes of those of entries that nobody has asked for yet, and are not there:
 * what asking for them would have built. */
size_t tables_nodes_unbuilt(struct tables *t,
    struct table_entry *const *entries, size_t count);

/*
 * Whether what is chosen is all resident, in *ready. An entry that failed gives
 * its error. Where a full table has come or been displaced it is chosen anew,
 * at the latest when all else is there. Takes time for what has become
 * resident since the last look, not for all.
 */
enum err tables_check(struct tables *t, struct table_choice *choice,
    bool *ready);

/*
 * Hands over a table for op that was built, in seconds, elsewhere: if it was
 * not there, it becomes resident as soon as there is room that nobody needs.
 * What is said of it then, in *out. Takes table over, also on failure.
 * ERR_MEMORY.
 */
enum err tables_give(struct tables *t, const struct operator *op,
    struct table *table, double seconds, struct table_report *out);

/* Device thread: reserves what entries, asked for, have, and nothing else. */
void tables_reserve(struct tables *t, struct table_entry *const *entries,
    size_t count);

/*
 * Whether every built-in table has been resident once, in *ready; the error of
 * one that failed.
 */
enum err tables_check_builtin(struct tables *t, bool *ready);

/* Lets the thread that measures and keeps tables begin. */
void tables_measure(struct tables *t);

/*
 * Device thread: of the entries in TABLE_BUILT with claim least or more one
 * with the largest, and its table; or NULL. Those put back are passed over
 * until there may be room for them. Entry and table stay, whatever others do,
 * until one of the next three is called.
 */
struct table_entry *tables_next_built(struct tables *t,
    enum table_claim least, const struct table **table,
    enum table_claim *claim);

/* Device thread: that entry has been loaded to slot; has failed; or there is
 * no room for it, with that claim. It may be gone then. */
void tables_loaded(struct tables *t, struct table_entry *entry, int slot);
void tables_failed(struct tables *t, struct table_entry *entry, enum err err);
void tables_put_back(struct tables *t, struct table_entry *entry,
    enum table_claim claim);

/* Device thread: a resident entry's slot. */
int tables_slot(const struct table_entry *entry);

/*
 * Device thread: gives up the resident table with the least claim below the
 * given one; of several, a draft before others, and that used longest ago.
 * *out serves comparison only; the caller drops *slot. False: there is none.
 */
bool tables_evict(struct tables *t, enum table_claim claim,
    const struct table_entry **out, int *slot);

/* Device thread: the bytes that tables_evict would give up, all told. */
size_t tables_evictable(struct tables *t, enum table_claim claim);

/* Device thread: the same of a draft nobody waits for, where there are too
 * many. */
bool tables_evict_draft(struct tables *t, const struct table_entry **out,
    int *slot);

/*
 * Device thread: the device is gone, and with it all resident tables. Those
 * that are asked or wished for are built again, and the built-in ones are
 * wished for.
 */
void tables_lose(struct tables *t);

/* Every table known, by number, malloc'd. ERR_MEMORY. */
enum err tables_report(struct tables *t, struct table_report **out,
    size_t *count);

/* "resident" and so on. */
const char *tables_state_name(enum table_state state);

#endif
