/*
 * The scenes kept: all that are present in memory, for whoever asks, and a
 * backing (server/backing.h) that has them beyond the daemon's end. Safe from any
 * thread.
 *
 * A struct scene is one revision: immutable, reference counted. Replacing or
 * deleting a scene leaves revisions alone that somebody holds.
 *
 * Changes are made by one thread, the writer: handlers submit them and wait.
 * What waits together is committed together, so that many writers share one
 * fsync. A change is seen by readers, published to listeners and done() only once
 * it is kept; one that could not be kept has never been.
 */
#ifndef SERVER_SCENE_STORE_H
#define SERVER_SCENE_STORE_H

#include <stdatomic.h>
#include <stdbool.h>
#include <stddef.h>

#include "core/err.h"
#include "server/access.h"
#include "server/etag.h"
#include "server/scene_seq.h"

#define SCENE_ID_MAX 64

struct backing;
struct backing_volume;
struct config;
struct events;
struct faults;
struct metrics;
struct program;
struct scene_store;
struct scheduler;
struct server;

struct scene {
	atomic_size_t refs;
	struct scheduler *scheduler;
	char id[SCENE_ID_MAX + 1];
	char etag[ETAG_SIZE];
	char *name;
	char *text;              /* the document's bytes, as they came */
	size_t length;
	size_t nodes;
	size_t bytes;            /* of memory: text and tape */
	struct program *program; /* one reference; NULL: it cannot be used now,
	                          * see scene_store_find */
	char owner[TOKEN_NAME_MAX + 1]; /* the token that made the scene, or "" */
	/* once it is kept: */
	struct scene_seq seq;
	double time;             /* seconds since 1970 */
};

/* What listeners and histories are told of a revision. */
struct scene_event {
	char id[SCENE_ID_MAX + 1];
	char etag[ETAG_SIZE];    /* "" of a deletion */
	struct scene_seq seq;
	double time;
	size_t nodes, length;
	bool is_deleted;
	bool is_first;           /* the scene was not there before */
	bool has_missed;         /* others right before it may be unknown */
	bool is_anew;            /* what was told before is not kept any more:
	                          * seq may be lower */
};

/*
 * A revision of one reference, for scene_release. Copies id, name and text; takes
 * the reference to program (or NULL) over, also on failure. ERR_MEMORY.
 */
enum err scene_create(struct scheduler *scheduler, const char *id,
    const char *name, const char *text, size_t length,
    struct program *program, struct scene **out);

/* One reference more. */
struct scene *scene_hold(struct scene *scene);

/* Gives up a reference; any thread. */
void scene_release(struct scene *scene);

/* [A-Za-z0-9_.-]{1,64}, but neither "." nor "..", which URLs lose. */
bool scene_id_is_valid(const char *id);

/* An id that nobody guesses. ERR_IO. */
enum err scene_id_random(char out[static SCENE_ID_MAX + 1]);

/*
 * Opens what server->config says: --store, else --data; reads all that is kept,
 * and starts the writer. Volumes go to server->volumes, which is there. Where
 * several daemons share a store that is away, it is loaded when it comes:
 * scene_store_is_ready tells. ERR_INVALID, ERR_CONFLICT (another daemon has it),
 * ERR_IO: the log says what to do; ERR_MEMORY.
 */
enum err scene_store_create(struct server *server, struct scene_store **out);

/* Does what has been submitted, then ends the writer. New changes are refused. */
void scene_store_stop(struct scene_store *store);

/* After scene_store_stop: releases every scene. NULL does nothing. */
void scene_store_free(struct scene_store *store);

/* Whether what is kept has been read; and whether changes can be made now. */
bool scene_store_is_ready(struct scene_store *store);
bool scene_store_is_well(struct scene_store *store);

/* Whether other daemons change the same scenes. */
bool scene_store_is_shared(const struct scene_store *store);

size_t scene_store_count(struct scene_store *store);

/* How many of them are of owner. */
size_t scene_store_count_of(struct scene_store *store, const char *owner);

/* The memory that the scenes kept take. */
size_t scene_store_bytes(struct scene_store *store);

/* The scene's present revision, for scene_release; NULL if there is none, or none
 * that can be used. */
struct scene *scene_store_get(struct scene_store *store, const char *id);

/*
 * The same; also one that is kept, but cannot be used now: its program is NULL,
 * its name "". So it is if a kept document does not compile, since limits are
 * lower than they were, or its volume is missing. It can be read, replaced,
 * patched and deleted.
 */
struct scene *scene_store_find(struct scene_store *store, const char *id);

/*
 * Tries to have such a scene be usable; any thread but the writer. ERR_OK: it is;
 * ERR_NOT_FOUND: there is none; else as scene_build, with what is wrong in
 * faults.
 */
enum err scene_store_mend(struct scene_store *store, const char *id,
    struct faults *faults);

/* The texts of scenes' older revisions, which are kept, but not in memory. */
size_t scene_store_history_bytes(struct scene_store *store);

/* ---- large revisions ---- */

/*
 * A piece of work on large documents, which would have others wait for HTTP's
 * threads or the writer. It is done on a thread for such work, one piece after
 * another, in the order in which they came; exactly once. is_cancelled: the
 * daemon stops, and there is no time for it.
 */
struct scene_work {
	void (*work)(void *ctx, bool is_cancelled);
	void *ctx;
	struct scene_work *next; /* the store's own */
};

/* ERR_BUSY: too much waits; ERR_CANCELLED: shutting down; then work() is not
 * called. work is the caller's again when work() is called. */
enum err scene_store_work(struct scene_store *store, struct scene_work *work);

/* ---- changes ---- */

enum scene_change_kind {
	SCENE_PUT,
	SCENE_DELETE,
	SCENE_REFRESH,  /* have what other daemons have kept of it */
	SCENE_READ,     /* an older revision's text, by etag: no change, and not
	                 * in the way of any */
	VOLUME_KEEP,    /* volume, beside the scenes */
	VOLUME_FORGET   /* the one of that id; volume.is_forgotten: while scenes
	                 * use it, else wholly */
};

/*
 * One change. Zeroed by the caller, then filled, and the caller's again when
 * done() is called, on the writer's thread (of SCENE_READ: on the reader's),
 * exactly once.
 */
struct scene_change {
	enum scene_change_kind kind;
	char id[SCENE_ID_MAX + 1];
	struct scene *scene;     /* SCENE_PUT: one reference, the change's */
	/* Checked against what is there when its turn comes. The strings are the
	 * caller's until done(). */
	struct precondition precondition;
	/* Of a patch: etag of what it was made from, "" for none. If that is not
	 * there any more, but something of at most rebase_most bytes, rebase
	 * makes, on the writer's thread, a new scene from it, in *out; its ctx is
	 * rebase_ctx, since ctx is that of whoever waits. Errors end the change.
	 * Else, and where that took the writer long of late, it ends with
	 * ERR_CONFLICT and is_outdated: for the caller to make it again, from
	 * `now`. */
	char base[ETAG_SIZE];
	size_t rebase_most;      /* SIZE_MAX: whatever it takes */
	enum err (*rebase)(void *ctx, const struct scene *now,
	    struct scene **out);
	void *rebase_ctx;
	char etag[ETAG_SIZE];    /* SCENE_READ: which */
	/* The caller's until done(). Kept or forgotten, it is so in server->volumes
	 * as well; one that could not be is the caller's to settle there. */
	const struct backing_volume *volume;
	/* Scenes that the owner may have, itself included (SIZE_MAX: any). */
	size_t scenes_most;
	void (*done)(void *ctx);
	void *ctx;
	/* set before done(): ERR_OK; ERR_NOT_FOUND; ERR_CONFLICT: precondition
	 * fails; ERR_LIMIT: too many scenes, too many bytes of them, or of the
	 * owner's (is_owners); ERR_UNAVAILABLE: it could not be kept; ERR_MEMORY;
	 * ERR_CANCELLED: shutting down; or rebase's. */
	enum err result;
	bool is_owners;
	bool is_outdated;
	bool replaced;           /* there was one */
	char owner[TOKEN_NAME_MAX + 1]; /* VOLUME_KEEP: whose it is */
	bool unchanged;          /* the very same bytes were there: nothing is new */
	struct scene *now;       /* what is there then, for scene_release; or NULL */
	char *text;              /* SCENE_READ: malloc'd, the caller's */
	size_t length;
	double seconds;          /* from submitted to done */
	/* the store's own */
	struct scene_change *next;
	struct scene_store *store;
	struct scene_work work;
	double submitted;
};

/* Queues change. ERR_BUSY: too many wait; ERR_CANCELLED: shutting down; then
 * done() is not called. */
enum err scene_store_submit(struct scene_store *store,
    struct scene_change *change);

/* The same, and waits for it: change->result is ERR_BUSY, ERR_CANCELLED, too.
 * done and ctx are overwritten; change->scene is given up in any case. Neither
 * the writer nor HTTP's threads. */
void scene_store_change(struct scene_store *store, struct scene_change *change);

/* Changes waiting, for metrics. */
size_t scene_store_waiting(struct scene_store *store);

/* ---- the past ---- */

/*
 * Revisions of id that are kept, newest first: those before the seq `before`
 * (NULL: all), limit at most, to list. Returns how many. Of a scene that is not
 * there: 0.
 */
size_t scene_store_history(struct scene_store *store, const char *id,
    const struct scene_seq *before, size_t limit, struct scene_event *list);

/*
 * What has happened to id after the seq `after`, oldest first, limit at most;
 * *missed: not all of it is known any more, and list has only what is.
 */
size_t scene_store_since(struct scene_store *store, const char *id,
    struct scene_seq after, size_t limit, struct scene_event *list,
    bool *missed);

/* ---- reading ---- */

/*
 * Up to limit scenes whose ids sort after after ("": from the first), in
 * order, each for scene_release, to list. Returns how many; *more tells
 * whether others follow.
 */
size_t scene_store_list(struct scene_store *store, const char *after,
    size_t limit, struct scene **list, bool *more);

#endif
