/*
 * What the tables' files share.
 *
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
 *
 * tables.c: life, tables built elsewhere. tables_entry.c: an entry's lists,
 * wishes and states. tables_choose.c: the evaluations' side. tables_build.c,
 * tables_measure.c: threads. tables_device.c: the device thread's side.
 * tables_report.c: for people.
 */
#ifndef SERVER_TABLES_INTERNAL_H
#define SERVER_TABLES_INTERNAL_H

#include <pthread.h>
#include <stdatomic.h>
#include <stdbool.h>
#include <stddef.h>

#include "server/tables.h"

#define BUILTIN_COUNT 4

/* Of 16 entries each when 8 evaluations of 1000 drafted operators wait. */
#define BUCKET_COUNT 1024

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

/* ---- tables_entry.c; all locked ---- */

/* How much an entry is needed. */
enum table_claim tables_entry_claim(const struct tables *t,
    const struct table_entry *entry);

/* As small as a draft, whether it is one or not. */
bool tables_entry_is_small(const struct table_entry *entry);

void tables_entry_set_state(struct tables *t, struct table_entry *entry,
    enum table_state state);

/* Does nothing to one without a wish. */
void tables_entry_drop_wish(struct tables *t, struct table_entry *entry);
void tables_entry_add_wish(struct tables *t, struct table_entry *entry);

/* The entry for op, a new one if need be; NULL: no memory. */
struct table_entry *tables_entry_find(struct tables *t,
    const struct operator *op);

/* Whether it is to be put in the cache; to be measured. */
bool tables_entry_is_to_keep(const struct tables *t,
    const struct table_entry *entry);
bool tables_entry_is_to_measure(const struct tables *t,
    const struct table_entry *entry);

/* Frees the host copy where nobody will read it again. */
void tables_entry_trim(struct tables *t, struct table_entry *entry);

/* Forgets an entry that holds nothing and that nobody refers to. */
void tables_entry_forget(struct tables *t, struct table_entry *entry);

/* Takes an entry that nobody waits for off its way to the device, but not out
 * of the device thread's hands. */
void tables_entry_settle(struct tables *t, struct table_entry *entry);

/* Which builder builds it. */
enum lane_kind tables_entry_lane(const struct tables *t,
    const struct table_entry *entry);

/* Whether a goes before b: the larger claim; of wishes the last made, else
 * the first asked for. */
bool tables_entry_precedes(const struct tables *t, const struct table_entry *a,
    const struct table_entry *b);

/*
 * Has an entry built unless it is already on its way. One evicted while it was
 * being measured still has its host copy.
 */
void tables_entry_want(struct tables *t, struct table_entry *entry);

/*
 * Drops the oldest wishes if there are too many, but none from first on, nor
 * what is being built or uploaded: of clients whose wishes displace each other
 * before any is built, none would ever come true.
 */
void tables_entry_limit_wishes(struct tables *t, unsigned long first);

/* tables_entry_limit_wishes should follow. */
void tables_entry_wish(struct tables *t, struct table_entry *entry);

/* ---- tables_build.c ---- */

/* A builder's thread; arg: its struct lane. */
void *tables_build_main(void *arg);

/* ---- tables_measure.c ---- */

/* The measuring thread; arg: the struct tables. */
void *tables_measure_main(void *arg);

/* ---- tables_report.c ---- */

/* Locked. */
struct table_report tables_report_entry(const struct table_entry *entry);

#endif
