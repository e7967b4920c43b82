/*
 * What a Redis answers: whatever it is, the backing tells its reader whole
 * revisions and volumes, or fails.
 *
 * The input is the answers one after another, as Redis writes them (RESP); the
 * first byte says what is asked after loading. When they are used up the
 * connection is lost.
 */
#include <errno.h>
#include <pthread.h>
#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>
#include <stdlib.h>
#include <string.h>

#include <hiredis/hiredis.h>

#include "server/backing_redis_internal.h"
#include "server/backing_redis_link.h"
#include "server/log.h"

/* Where a wait has no end but the daemon's. */
#define WAITS_MOST 20

int LLVMFuzzerInitialize(int *argc, char ***argv);
int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size);

static void demand(int fine)
{
	if (!fine)
		abort();
}

/* ---- played: the connection ---- */

static redisReader *reader;
static struct backing_redis *backing;
static pthread_t self;
static int waits; /* of the follower, so far */

/* The backing's own thread never gets a connection. */
static bool is_self(void)
{
	return pthread_equal(self, pthread_self());
}

static redisReply *next_reply(struct backing_redis_link *link)
{
	void *reply = NULL;

	if (reader == NULL || link->context == NULL ||
	    redisReaderGetReply(reader, &reply) != REDIS_OK || reply == NULL) {
		redisReaderFree(reader);
		reader = NULL;
		link->context = NULL;
	}
	return reply;
}

void backing_redis_link_init(struct backing_redis_link *link,
    const struct backing_redis_url *url)
{
	*link = (struct backing_redis_link){.url = url};
}

void backing_redis_link_close(struct backing_redis_link *link)
{
	link->context = NULL;
}

void backing_redis_link_fini(struct backing_redis_link *link)
{
	(void)link;
}

void backing_redis_link_break(struct backing_redis_link *link)
{
	(void)link;
}

enum err backing_redis_link_open(struct backing_redis_link *link)
{
	static char some;

	if (!is_self())
		return ERR_UNAVAILABLE;
	if (reader == NULL) {
		pthread_mutex_lock(&backing->lock);
		backing->is_ending = true;
		pthread_mutex_unlock(&backing->lock);
		return ERR_UNAVAILABLE;
	}
	link->context = (struct redisContext *)&some;
	return ERR_OK;
}

void backing_redis_call_init(struct backing_redis_call *call,
    const char *command)
{
	(void)command;
	call->count = 0;
}

void backing_redis_call_script(struct backing_redis_call *call,
    enum backing_redis_script script, int keys)
{
	(void)script, (void)keys;
	call->count = 0;
}

void backing_redis_call_add(struct backing_redis_call *call, const void *data,
    size_t length)
{
	(void)data, (void)length;
	demand(call->count < BACKING_REDIS_ARGUMENTS_MAX);
	call->count++;
}

void backing_redis_call_text(struct backing_redis_call *call,
    const char *text)
{
	backing_redis_call_add(call, text, strlen(text));
}

struct redisReply *backing_redis_link_do(struct backing_redis_link *link,
    struct backing_redis_call *call)
{
	redisReply *reply = next_reply(link);

	(void)call;
	if (reply == NULL || reply->type != REDIS_REPLY_ERROR)
		return reply;
	freeReplyObject(reply);
	return NULL;
}

bool backing_redis_link_send(struct backing_redis_link *link,
    struct backing_redis_call *call)
{
	(void)call;
	return link->context != NULL;
}

struct redisReply *backing_redis_link_get(struct backing_redis_link *link)
{
	return next_reply(link);
}

bool backing_redis_is_forgotten(const struct redisReply *reply)
{
	return reply->type == REDIS_REPLY_ERROR &&
	    strncmp(reply->str, "NOSCRIPT", 8) == 0;
}

enum err backing_redis_link_load_scripts(struct backing_redis_link *link)
{
	return link->context != NULL ? ERR_OK : ERR_UNAVAILABLE;
}

enum err backing_redis_link_read_clock(struct backing_redis_link *link)
{
	return link->context != NULL ? ERR_OK : ERR_UNAVAILABLE;
}

double backing_redis_link_time(const struct backing_redis_link *link,
    double seconds)
{
	(void)link;
	return 1e3 * seconds;
}

/* ---- played: time, which passes at once here, and not at all there ---- */

int __real_pthread_cond_timedwait(pthread_cond_t *condition,
    pthread_mutex_t *lock, const struct timespec *end);
int __wrap_pthread_cond_timedwait(pthread_cond_t *condition,
    pthread_mutex_t *lock, const struct timespec *end);

int __wrap_pthread_cond_timedwait(pthread_cond_t *condition,
    pthread_mutex_t *lock, const struct timespec *end)
{
	if (!is_self())
		return __real_pthread_cond_timedwait(condition, lock, end);
	if (++waits > WAITS_MOST)
		backing->is_ending = true;
	return ETIMEDOUT;
}

void log_write(enum log_level level, const char *format, ...)
{
	(void)level, (void)format;
}

/* ---- who is told ---- */

/* All of it can be read. */
static void touch(const char *data, size_t length)
{
	char *copy = malloc(length + 1);

	demand(copy != NULL);
	memcpy(copy, data, length);
	free(copy);
}

static enum err on_revision(void *ctx, const struct backing_revision *r)
{
	(void)ctx;
	demand(r->id != NULL && r->etag != NULL && r->owner != NULL);
	touch(r->id, strlen(r->id));
	touch(r->etag, strlen(r->etag));
	touch(r->owner, strlen(r->owner));
	if (r->text != NULL && r->text[0] != '\0')
		touch(r->text, r->length);
	return ERR_OK;
}

static enum err on_volume(void *ctx, const struct backing_volume *v)
{
	(void)ctx;
	demand(v->id != NULL);
	touch(v->id, strlen(v->id));
	/* Without data: only whether it is forgotten. */
	if (v->data != NULL)
		touch(v->data, v->length);
	return ERR_OK;
}

static void on_guard(void *ctx, bool is_begun)
{
	(void)ctx, (void)is_begun;
}

static const struct backing_reader told = {on_revision, on_volume, NULL};

static void on_lost(void *ctx)
{
	(void)ctx;
	if (is_self())
		backing->backing.ops->load(&backing->backing, &told);
}

/* ---- what is asked ---- */

static void commit_two(struct backing *b)
{
	struct backing_write writes[2] = {
		{.revision = {.id = "a", .etag = "\"x\"", .text = "{}",
		    .length = 2, .owner = ""}, .is_any = true,
		    .result = ERR_COUNT},
		{.revision = {.id = "b", .etag = "", .owner = ""},
		    .expected = "\"y\"", .result = ERR_COUNT},
	};

	if (b->ops->commit(b, writes, 2) == ERR_OK)
		demand(writes[0].result < ERR_COUNT &&
		    writes[1].result < ERR_COUNT);
}

static void ask(struct backing *b, unsigned what)
{
	const struct backing_volume volume = {.id = "v", .data = "x",
	    .length = 1};

	if (what & 1)
		commit_two(b);
	if (what & 2)
		b->ops->refresh(b, "a", &told);
	if (what & 4)
		b->ops->read(b, "a", "\"x\"", &told);
	if (what & 8)
		b->ops->get_volume(b, "v", &told);
	if (what & 16)
		b->ops->put_volume(b, &volume);
	if (what & 32)
		b->ops->forget_volume(b, "v", what & 64);
	if (what & 128)
		b->ops->commit(b, NULL, 0);
}

int LLVMFuzzerInitialize(int *argc, char ***argv)
{
	(void)argc, (void)argv;
	self = pthread_self();
	return 0;
}

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size)
{
	const struct backing_options options = {.history = 4,
	    .changed = told, .guard = on_guard, .lost = on_lost};
	struct backing *b;

	if (size < 2)
		return 0;
	reader = redisReaderCreate();
	demand(reader != NULL);
	redisReaderFeed(reader, (const char *)data + 1, size - 1);
	demand(backing_open_redis("redis://x", &options, &b) == ERR_OK);
	backing = (struct backing_redis *)b;
	waits = 0;
	b->ops->load(b, &told);
	ask(b, data[0]);
	backing_redis_follow(backing);
	b->ops->free(b);
	redisReaderFree(reader);
	reader = NULL;
	return 0;
}
