/*
 * The operator tables the daemon keeps: built in the background on all cores,
 * made resident by the device thread, evicted least recently used first.
 *
 * Threads: functions are safe from any thread unless they say "device thread".
 * One builder thread fills tables; one more at idle priority measures their
 * error. Neither touches the device.
 */
#ifndef SERVER_TABLES_H
#define SERVER_TABLES_H

#include <stdbool.h>
#include <stddef.h>

#include "core/err.h"
#include "core/operator.h"
#include "core/table.h"

struct tables;
struct table_entry;

/*
 * How much a table is needed. One being loaded may displace those resident
 * with a lesser claim; one displaced that is still asked for is built anew.
 */
enum table_claim {
	TABLE_SPARE,    /* nobody waits for it */
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

/* One table, for people: a copy. */
struct table_report {
	enum operator_family family;
	struct profile profile;
	enum table_layout layout;
	int resolution;
	enum table_state state;
	size_t bytes;         /* 0 until built once */
	double build_seconds;
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
 * been built, or has failed. measure: tables' errors will be measured. ERR_IO.
 */
enum err tables_start(struct tables *t, bool measure,
    void (*changed)(void *ctx), void *ctx);

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

/*
 * Asks for the tables of entries until as many calls of tables_unask. A table
 * that is no longer asked for is not built; a resident one may stay.
 */
void tables_ask(struct tables *t, struct table_entry *const *entries,
    size_t count);
void tables_unask(struct tables *t, struct table_entry *const *entries,
    size_t count);

/* Device thread: reserves what entries, asked for, have, and nothing else. */
void tables_reserve(struct tables *t, struct table_entry *const *entries,
    size_t count);

/*
 * Whether entries asked for are all resident, in *ready. An entry that failed
 * gives its error.
 */
enum err tables_check(struct tables *t, struct table_entry *const *entries,
    size_t count, bool *ready);

/*
 * Whether every built-in table has been resident once, in *ready; the error of
 * one that failed.
 */
enum err tables_check_builtin(struct tables *t, bool *ready);

/* Lets the measuring thread begin. */
void tables_measure(struct tables *t);

/*
 * Device thread: of the entries in TABLE_BUILT one with the largest claim, and
 * its table; or NULL. The table stays while the device thread unasks nothing.
 */
struct table_entry *tables_next_built(struct tables *t,
    const struct table **table, enum table_claim *claim);

/* Device thread: that entry has been loaded to slot, or has failed. */
void tables_loaded(struct tables *t, struct table_entry *entry, int slot);
void tables_failed(struct tables *t, struct table_entry *entry, enum err err);

/* Device thread: a resident entry's slot. */
int tables_slot(const struct table_entry *entry);

/*
 * Device thread: gives up the resident table with the least claim below the
 * given one; of several, that used longest ago. *out serves comparison only;
 * the caller drops *slot. False: there is none.
 */
bool tables_evict(struct tables *t, enum table_claim claim,
    const struct table_entry **out, int *slot);

/* Every table known, malloc'd. ERR_MEMORY. */
enum err tables_report(struct tables *t, struct table_report **out,
    size_t *count);

/* "resident" and so on. */
const char *tables_state_name(enum table_state state);

#endif
