/*
 * Inside of the scene store. Who owns what:
 *
 * The table is read by any thread under `lock`. It is changed under `turn` and
 * `lock`, so that who has `turn` may read it without. `turn` is the writer's while
 * it judges, commits and applies changes; a backing's that tells of changes made
 * elsewhere, between its two calls of guard; and whoever mends a scene.
 * Every submitted change is completed by the writer, or by the reader if it only
 * asks for an older revision, exactly once.
 */
#ifndef SERVER_SCENE_STORE_INTERNAL_H
#define SERVER_SCENE_STORE_INTERNAL_H

#include <pthread.h>
#include <stdatomic.h>

#include "server/backing.h"
#include "server/scene_store.h"
#include "server/scene_table.h"

/* Changes waiting at most; and those that are committed together. */
#define SCENE_WAITING_MAX 1024
#define SCENE_GROUP_MAX 256

/* Deletions that are remembered where several daemons write, so that what is
 * told late of a scene does not bring it back: replicas lag by far fewer. */
#define SCENE_GRAVES 1024

struct scene_grave {
	char id[SCENE_ID_MAX + 1];
	struct scene_seq seq;
};

struct scene_store {
	struct server *server;
	struct backing *backing;
	bool is_shared;
	size_t most, bytes_most;

	pthread_rwlock_t lock;   /* guards: */
	struct scene_table table;
	struct scene_seq newest; /* of all that is in the table, or was */

	pthread_mutex_t turn;    /* guards: */
	struct scene_grave graves[SCENE_GRAVES];
	size_t grave_next;
	bool is_ended;           /* listeners may be gone */

	atomic_bool is_loaded;
	atomic_bool must_load;   /* what is known may have holes */
	atomic_bool must_mend;   /* a scene's volume may be found elsewhere */

	pthread_t writer;
	bool has_writer;
	struct scene_worker *worker, *reader; /* reader: older revisions' */
	pthread_mutex_t queue_lock; /* guards: */
	pthread_cond_t queue_wake;
	struct scene_change *first, *last;
	size_t waiting;
	bool is_stopping;
};

/* ---- scene_load.c: what a backing has ---- */

/*
 * Everything anew. Scenes that are not as they were are published, once there
 * were any. As backing_ops.load, or ERR_MEMORY. Takes the turn.
 */
enum err scene_load_all(struct scene_store *store);

/* What a backing tells of changes made elsewhere; ctx is the store, whose turn
 * it is. */
enum err scene_load_revision(void *ctx, const struct backing_revision *r);
enum err scene_load_volume(void *ctx, const struct backing_volume *v);

/*
 * The scene's present revision as it is elsewhere. Writer, whose turn it is.
 * ERR_OK also where there is none (any more).
 */
enum err scene_load_refresh(struct scene_store *store, const char *id);

/* Tries again scenes that could not be used for lack of a volume. Writer. */
void scene_load_mend(struct scene_store *store);

/* ---- scene_apply.c: changes of the table ---- */

/* The turn is the caller's. Publishes; has_missed: others right before it may be
 * unknown. ERR_MEMORY: nothing is changed. */
enum err scene_apply_put(struct scene_store *store, struct scene *scene,
    bool has_missed);
enum err scene_apply_delete(struct scene_store *store, const char *id,
    struct scene_seq seq, double time, bool has_missed);

/* Whether the scene's newest revision here is another than seq: then those in
 * between are not known. The turn is the caller's. */
bool scene_apply_is_behind(const struct scene_store *store, const char *id,
    struct scene_seq seq);

/* Whether id was deleted at seq or later. The turn is the caller's. */
bool scene_apply_is_buried(const struct scene_store *store, const char *id,
    struct scene_seq seq);

/* ---- scene_writer.c ---- */

enum err scene_writer_start(struct scene_store *store);

/* Does what waits. */
void scene_writer_stop(struct scene_store *store);

void scene_writer_wake(struct scene_store *store);

/* ---- scene_reader.c ---- */

/* As scene_store_submit, of a SCENE_READ. */
enum err scene_reader_submit(struct scene_store *store,
    struct scene_change *change);

/* ---- scene_commit.c: what the writer does with a batch; its turn ---- */

/* Does count changes, at most SCENE_GROUP_MAX; each has its result then. */
void scene_commit_batch(struct scene_store *store,
    struct scene_change *const *batch, size_t count);

#endif
