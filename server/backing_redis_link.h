/*
 * One connection to a Redis, made when it is needed, with times that nothing
 * exceeds. For one thread at a time.
 */
#ifndef SERVER_BACKING_REDIS_LINK_H
#define SERVER_BACKING_REDIS_LINK_H

#include <pthread.h>
#include <stdbool.h>
#include <stddef.h>

#include "core/err.h"
#include "server/backing_redis_script.h"
#include "server/backing_redis_url.h"

struct backing_redis_tls;
struct redisContext;
struct redisReply;

/* Seconds for an answer; and for a change to be made, of Redis' clock, so that one
 * which has had no answer is not made later. */
#define BACKING_REDIS_WAIT_SECONDS 2.0
#define BACKING_REDIS_ACT_SECONDS 1.5

/* A command being put together. Strings are borrowed. */
#define BACKING_REDIS_ARGUMENTS_MAX 80

struct backing_redis_call {
	int count;
	const char *argv[BACKING_REDIS_ARGUMENTS_MAX];
	size_t lengths[BACKING_REDIS_ARGUMENTS_MAX];
	int script;              /* or -1 */
	char keys[8];
};

struct backing_redis_link {
	const struct backing_redis_url *url;
	struct redisContext *context; /* NULL: there is none */
	struct backing_redis_tls *tls; /* on it, or NULL */
	pthread_mutex_t lock;    /* guards fd */
	int fd;                  /* of it, for backing_redis_link_break; or -1 */
	char sha[SCRIPT_COUNT][48];
	double clock_read;       /* clock_seconds, when it was */
	double offset;           /* Redis' seconds since 1970 less ours since
	                          * boot */
	bool is_slow;            /* it was lost by waiting in vain */
	char message[200];       /* why the last thing failed */
};

void backing_redis_link_init(struct backing_redis_link *link,
    const struct backing_redis_url *url);
void backing_redis_link_close(struct backing_redis_link *link);
void backing_redis_link_fini(struct backing_redis_link *link);

/* Has a connection, its scripts loaded. ERR_UNAVAILABLE, with message. */
enum err backing_redis_link_open(struct backing_redis_link *link);

/* Any thread: what waits for an answer gets none. */
void backing_redis_link_break(struct backing_redis_link *link);

/* A command; one that runs a script of so many keys, which come next. */
void backing_redis_call_init(struct backing_redis_call *call,
    const char *command);
void backing_redis_call_script(struct backing_redis_call *call,
    enum backing_redis_script script, int keys);
void backing_redis_call_add(struct backing_redis_call *call, const void *data,
    size_t length);
void backing_redis_call_text(struct backing_redis_call *call,
    const char *text);

/* Sends call, and returns its answer, for freeReplyObject: NULL with message: the
 * connection is lost, or it was an error, and nothing has been done. */
struct redisReply *backing_redis_link_do(struct backing_redis_link *link,
    struct backing_redis_call *call);

/* The same in two steps, for several at once. Answers may be errors; NULL: the
 * connection is lost, and closed. */
bool backing_redis_link_send(struct backing_redis_link *link,
    struct backing_redis_call *call);
struct redisReply *backing_redis_link_get(struct backing_redis_link *link);

/* Whether reply says that the script is not known (any more). */
bool backing_redis_is_forgotten(const struct redisReply *reply);
enum err backing_redis_link_load_scripts(struct backing_redis_link *link);

/* Asks what time it is there: clocks are set. As backing_redis_link_open. */
enum err backing_redis_link_read_clock(struct backing_redis_link *link);

/* Milliseconds since 1970 by Redis' clock, so many seconds from now. */
double backing_redis_link_time(const struct backing_redis_link *link,
    double seconds);

#endif
