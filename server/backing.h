/*
 * What keeps scenes beyond the daemon's end: SQLite in a folder, or Redis among
 * several daemons. The store (server/scene_store.h) has everything that is
 * present in memory and is the only one to call this.
 *
 * Threads: all functions are called by the store's writer thread, but open and
 * the first load (before it is started), free (after it has ended), is_well, and
 * read: that is called by another one, after the first load, whatever the writer
 * does meanwhile; one at a time. Neither waits for the other for longer than a
 * text takes to be copied, or a file to be opened again after a failure. A
 * backing that hears of changes made elsewhere calls changed(), on a thread of
 * its own, and not from within a function called by the store: the store's turn
 * is held there. It may not hold a lock that such a function takes.
 */
#ifndef SERVER_BACKING_H
#define SERVER_BACKING_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#include "core/err.h"
#include "server/access.h"
#include "server/scene_seq.h"

struct backing;

/* One revision, or the deletion of a scene (text NULL). Borrowed. */
struct backing_revision {
	const char *id;
	const char *etag;        /* quoted */
	const char *text;        /* the document; NULL: deleted */
	size_t length;
	const char *owner;       /* a token's name, or "" */
	struct scene_seq seq;    /* given by commit */
	double time;             /* seconds since 1970 */
	size_t nodes;
	bool is_past;            /* an older one, without its text: that is "" */
	bool is_oldest;          /* nothing older of it is kept */
	/* Where several write, of a deletion and by commit: seq of the revision
	 * that it follows; 0: none, or not known. */
	struct scene_seq before;
};

/* A volume, as volume_store makes its id from it. Borrowed. */
struct backing_volume {
	const char *id;
	const void *data;        /* as volume_store encodes it */
	size_t length;
	bool is_forgotten;
	const char *owner;       /* a token's name, or ""; NULL: not told */
	char *kept_owner;        /* set by put_volume, unless NULL: whose it is
	                          * now; room for TOKEN_NAME_MAX + 1 */
};

/* Who is told what a backing has. Non-OK ends the loading, with that. */
struct backing_reader {
	enum err (*revision)(void *ctx, const struct backing_revision *r);
	enum err (*volume)(void *ctx, const struct backing_volume *v);
	void *ctx;
};

/* One change to be kept. */
struct backing_write {
	struct backing_revision revision; /* seq, time: filled in */
	/* Where several write: the tag it must now have for this to count, NULL:
	 * none; is_any: whatever it has. */
	const char *expected;
	bool is_any;
	enum err result;         /* ERR_CONFLICT: it has another one now */
	/* Filled in where several write, if has_found: whether there was one
	 * when it was kept, and whose the scene is. */
	bool has_found, was_there;
	char owner[TOKEN_NAME_MAX + 1];
	struct scene_seq oldest; /* that is kept of it now; 0: not known */
};

struct backing_ops {
	/* Tells reader every volume, then, of every scene, the newest revision
	 * with its text and, before it, those older without (is_past, for the
	 * history's list), by rising seq. ERR_UNAVAILABLE: away (it may come);
	 * ERR_INVALID: damaged, logged with what to do. */
	enum err (*load)(struct backing *b, const struct backing_reader *reader);
	/* Keeps all writes together, durably, or none (then each has the
	 * result returned); where several write, each by itself. ERR_OK if
	 * each has a result of its own. count 0, when it is not well: sees
	 * whether it can be written again. */
	enum err (*commit)(struct backing *b, struct backing_write *writes,
	    size_t count);
	/* The scene's present revision as it is elsewhere, the older ones before
	 * it (and after it again, for who has not known of the scene), told to
	 * reader, or its deletion; for stores that several daemons share. So tells
	 * changed(), too. ERR_NOT_FOUND: there
	 * is no such scene. NULL: nobody else writes. */
	enum err (*refresh)(struct backing *b, const char *id,
	    const struct backing_reader *reader);
	/* An older revision's text, on the reader's thread, no lock held while
	 * it is told. ERR_NOT_FOUND. */
	enum err (*read)(struct backing *b, const char *id, const char *etag,
	    const struct backing_reader *reader);
	/* Not forgotten. If it is there and not forgotten it stays whose it is,
	 * else it is v->owner's. */
	enum err (*put_volume)(struct backing *b,
	    const struct backing_volume *v);
	/* Marked as forgotten, or, is_gone, removed, if it is marked. ERR_BUSY:
	 * not yet, since another daemon may be about to use it. */
	enum err (*forget_volume)(struct backing *b, const char *id,
	    bool is_gone);
	/* A volume kept elsewhere. ERR_NOT_FOUND. NULL: nobody else writes. */
	enum err (*get_volume)(struct backing *b, const char *id,
	    const struct backing_reader *reader);
	/* Has read() come to its end, and refuse from now on. Any thread. NULL:
	 * it does not take long. */
	void (*stop_reading)(struct backing *b);
	/* Whether it can be written now; for /readyz, metrics. Any thread. */
	bool (*is_well)(struct backing *b);
	void (*free)(struct backing *b);
};

struct backing {
	const struct backing_ops *ops;
};

struct backing_options {
	size_t history;          /* revisions of a scene that are kept, > 0 */
	size_t history_bytes;    /* of those but the present one, at most: the
	                          * oldest go first; 0: any. Lowered, it holds
	                          * after load, or a scene's next change. */
	/* Told of changes made elsewhere, on the backing's own thread, between
	 * the two calls of guard: no write is made meanwhile. */
	struct backing_reader changed;
	void (*guard)(void *ctx, bool is_begun);
	/* What is known may have holes: load() is to be called again. Any
	 * thread. */
	void (*lost)(void *ctx);
};

/* A folder, made if missing (for its user alone), or ":memory:". ERR_INVALID: a
 * damaged file, or of a newer version; ERR_BUSY: another daemon has it; ERR_IO:
 * the log says what to do, each time. backing_sqlite.c */
enum err backing_open_sqlite(const char *folder,
    const struct backing_options *options, struct backing **out);

/* redis://[user:password@]host[:port][/database], rediss:// or redis+unix:///path:
 * backing_redis_url.h. Does not wait for the server. ERR_INVALID: no such address,
 * or a file of it cannot be used. backing_redis.c */
enum err backing_open_redis(const char *url,
    const struct backing_options *options, struct backing **out);

#endif
