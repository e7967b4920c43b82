/*
 * What the parts of the Redis backing share: backing_redis.c, on the store's
 * writer thread (and, of older revisions, on its reader's, by a link of its own),
 * and backing_redis_follow.c, on its own.
 *
 * Changes carry a token, "INSTANCE:NUMBER". A change whose answer was lost is in
 * doubt: the follower tells the store of it as if another daemon had made it.
 */
#ifndef SERVER_BACKING_REDIS_INTERNAL_H
#define SERVER_BACKING_REDIS_INTERNAL_H

#include <pthread.h>
#include <stdatomic.h>
#include <stdint.h>

#include "server/backing.h"
#include "server/backing_redis_link.h"
#include "server/backing_redis_tls.h"

struct redisReply;

/* Keys: prefix, kind, id. */
#define BACKING_REDIS_KEY_MAX 224
#define BACKING_REDIS_INSTANCE_MAX 24
#define BACKING_REDIS_TOKEN_MAX 48
/* An id of the stream, "MS-N". */
#define BACKING_REDIS_ID_MAX 48
/* Entries of the stream that are kept, about: what a daemon may lag behind. */
#define BACKING_REDIS_ENTRIES "10000"
#define BACKING_REDIS_DOUBTS 256
/* What is said then. */
#define BACKING_REDIS_NEWEST_LOST \
	"the newest changes are not there any more"
/* A forgotten volume stays for so many milliseconds: another daemon may have kept
 * a scene that uses it, and this one not have heard of either yet. */
#define BACKING_REDIS_GRACE "60000"

/* Whether the present scenes are known. */
enum backing_redis_state {
	STATE_NEW,     /* load has not been called yet */
	STATE_LOADING,
	STATE_STALE,   /* it is to be called again */
	STATE_LOADED
};

struct backing_redis {
	struct backing backing;
	struct backing_redis_url url;
	struct backing_options options;
	char instance[BACKING_REDIS_INSTANCE_MAX];
	/* "scenes", "volumes", "changes", "last", "alive", with the prefix */
	char scenes[BACKING_REDIS_KEY_MAX], volumes[BACKING_REDIS_KEY_MAX],
	    changes[BACKING_REDIS_KEY_MAX], last[BACKING_REDIS_KEY_MAX],
	    alive[BACKING_REDIS_KEY_MAX];

	/* Guards link, which is used by the writer's thread, and by the
	 * follower's where changed() asks for a volume. */
	pthread_mutex_t writing;
	struct backing_redis_link link;
	bool is_load_failing;    /* and it has been said; the writer's */

	atomic_bool is_well;
	pthread_mutex_t lock;    /* guards the rest */
	char refusal[BACKING_REDIS_TLS_WHY_MAX]; /* by TLS, the last one said */
	pthread_cond_t changed;
	bool is_ending;
	enum backing_redis_state state;
	unsigned generation;     /* of position: loads so far */
	char position[BACKING_REDIS_ID_MAX]; /* what has been told of */
	struct scene_seq made;   /* since the load, the newest change of ours */
	uint64_t begun, settled; /* changes: the last sent, the last decided */
	uint64_t doubts[BACKING_REDIS_DOUBTS]; /* in doubt; 0: none */
	size_t doubt_next;

	struct backing_redis_link follower; /* its thread's */
	pthread_t thread;

	/* The reader's, of older revisions. */
	atomic_bool is_read_over; /* it is to end */
	struct backing_redis_link reader;
	double failed;           /* clock_seconds, when it did last; or 0 */
};

void backing_redis_key(const struct backing_redis *b, const char *kind,
    const char *id, char out[static BACKING_REDIS_KEY_MAX]);

void backing_redis_token(const struct backing_redis *b, uint64_t number,
    char out[static BACKING_REDIS_TOKEN_MAX]);

/* Redis has made change seq of ours, after change prev (NULL: unknown): what it has
 * made before has to be there, else the store is to load anew. */
void backing_redis_note_made(struct backing_redis *b, struct scene_seq seq,
    const char *prev);

/* Whether it can be written; logs when that changes, with why. */
void backing_redis_note(struct backing_redis *b, bool is_well,
    const char *why);

/* Whether reply is an array of count elements or more, the first count of which
 * are strings: what others write is not trusted. */
bool backing_redis_has_strings(const struct redisReply *reply, size_t count);

/* Asks link for scene id. NULL: message says why. */
struct redisReply *backing_redis_fetch(struct backing_redis *b,
    struct backing_redis_link *link, const char *id);

/*
 * Tells reader of what SCRIPT_FETCH has answered about id: older revisions, then
 * the present one; or, if there is none, of its absence (NULL: nothing; seq 0: as
 * of the answer). ERR_INVALID: it is damaged.
 */
enum err backing_redis_tell(const struct redisReply *reply, const char *id,
    const struct backing_revision *absence,
    const struct backing_reader *reader);

/* The older ones only. */
enum err backing_redis_tell_past(const struct redisReply *reply,
    const char *id, const struct backing_reader *reader);

/* The same of a volume. reply NULL: ERR_UNAVAILABLE; ERR_NOT_FOUND. */
struct redisReply *backing_redis_fetch_volume(struct backing_redis *b,
    struct backing_redis_link *link, const char *id);
enum err backing_redis_tell_volume(const struct redisReply *reply,
    const char *id, const struct backing_reader *reader);

/* Follows the stream until is_ending. */
void *backing_redis_follow(void *b);

#endif
