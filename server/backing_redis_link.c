#include "server/backing_redis_link.h"

#include <errno.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/socket.h>

#include <hiredis/hiredis.h>

#include "server/backing_redis_tls.h"

#include "server/clock.h"

#define CONNECT_SECONDS 1

/* Of what comes by TLS, at a time: a record is no longer. */
#define RECORD ((size_t)16 << 10)

static const struct timeval connect_time = {CONNECT_SECONDS, 0};
static const struct timeval wait_time = {
	(time_t)BACKING_REDIS_WAIT_SECONDS, 0};

/* ---- commands ---- */

void backing_redis_call_add(struct backing_redis_call *call, const void *data,
    size_t length)
{
	if (call->count == BACKING_REDIS_ARGUMENTS_MAX)
		abort();
	call->argv[call->count] = data;
	call->lengths[call->count++] = length;
}

void backing_redis_call_text(struct backing_redis_call *call,
    const char *text)
{
	backing_redis_call_add(call, text, strlen(text));
}

void backing_redis_call_init(struct backing_redis_call *call,
    const char *command)
{
	call->count = 0;
	call->script = -1;
	backing_redis_call_text(call, command);
}

void backing_redis_call_script(struct backing_redis_call *call,
    enum backing_redis_script script, int keys)
{
	backing_redis_call_init(call, "EVALSHA");
	call->script = (int)script;
	backing_redis_call_text(call, ""); /* its hash, when it is sent */
	snprintf(call->keys, sizeof call->keys, "%d", keys);
	backing_redis_call_text(call, call->keys);
}

/* ---- the connection ---- */

void backing_redis_link_init(struct backing_redis_link *link,
    const struct backing_redis_url *url)
{
	*link = (struct backing_redis_link){.url = url, .fd = -1};
	pthread_mutex_init(&link->lock, NULL);
}

static void note_fd(struct backing_redis_link *link, int fd)
{
	pthread_mutex_lock(&link->lock);
	link->fd = fd;
	pthread_mutex_unlock(&link->lock);
}

void backing_redis_link_close(struct backing_redis_link *link)
{
	note_fd(link, -1);
	backing_redis_tls_close(link->tls);
	link->tls = NULL;
	if (link->context != NULL)
		redisFree(link->context);
	link->context = NULL;
}

void backing_redis_link_fini(struct backing_redis_link *link)
{
	backing_redis_link_close(link);
	pthread_mutex_destroy(&link->lock);
}

void backing_redis_link_break(struct backing_redis_link *link)
{
	pthread_mutex_lock(&link->lock);
	if (link->fd >= 0)
		shutdown(link->fd, SHUT_RDWR);
	pthread_mutex_unlock(&link->lock);
}

static const char *why_lost(struct backing_redis_link *link)
{
	const redisContext *c = link->context;

	if (link->is_slow)
		return "no answer in time";
	if (c == NULL || (link->tls != NULL && errno == ENOMEM))
		return "out of memory";
	return link->tls != NULL && c->err == 0 ?
	    backing_redis_tls_why(link->tls) : c->errstr;
}

/* Closes, and keeps what it was lost by, which errno says, too. */
static void lose(struct backing_redis_link *link)
{
	const redisContext *c = link->context;
	/* By TLS c knows only of answers that are none. */
	const bool is_of_socket = c != NULL && c->err ==
	    (link->tls != NULL ? 0 : REDIS_ERR_IO);

	link->is_slow = is_of_socket && (errno == EAGAIN ||
	    errno == EWOULDBLOCK || errno == ETIMEDOUT);
	snprintf(link->message, sizeof link->message, "%s", why_lost(link));
	backing_redis_link_close(link);
}

/* ---- by TLS, of which this hiredis knows nothing ---- */

/* As redisAppendCommandArgv and what it leaves to redisGetReply. */
static bool send_tls(struct backing_redis_link *link,
    struct backing_redis_call *call)
{
	char *text;
	int length = redisFormatCommandArgv(&text, call->count, call->argv,
	    call->lengths);
	bool is_sent;

	if (length < 0) {
		errno = ENOMEM;
		return false;
	}
	is_sent = backing_redis_tls_send(link->tls, text, (size_t)length);
	redisFreeCommand(text);
	return is_sent;
}

/* As redisGetReply. */
static bool get_tls(struct backing_redis_link *link, void **reply)
{
	redisContext *c = link->context;
	char bytes[RECORD];

	*reply = NULL;
	for (;;) {
		ssize_t n;

		if (redisGetReplyFromReader(c, reply) != REDIS_OK)
			return false;
		if (*reply != NULL)
			return true;
		n = backing_redis_tls_receive(link->tls, bytes, sizeof bytes);
		if (n <= 0)
			return false;
		if (redisReaderFeed(c->reader, bytes, (size_t)n) !=
		    REDIS_OK) {
			errno = ENOMEM;
			return false;
		}
	}
}

/* ---- one command, one answer ---- */

bool backing_redis_link_send(struct backing_redis_link *link,
    struct backing_redis_call *call)
{
	if (call->script >= 0) {
		call->argv[1] = link->sha[call->script];
		call->lengths[1] = strlen(call->argv[1]);
	}
	errno = 0;
	if (link->tls != NULL ? send_tls(link, call) :
	    redisAppendCommandArgv(link->context, call->count, call->argv,
	    call->lengths) == REDIS_OK)
		return true;
	lose(link);
	return false;
}

struct redisReply *backing_redis_link_get(struct backing_redis_link *link)
{
	void *reply;

	errno = 0;
	if (link->tls != NULL ? get_tls(link, &reply) :
	    redisGetReply(link->context, &reply) == REDIS_OK)
		return reply;
	lose(link);
	return NULL;
}

/* reply; or message and NULL if it is an error. */
static redisReply *check(struct backing_redis_link *link, redisReply *reply)
{
	if (reply == NULL || reply->type != REDIS_REPLY_ERROR)
		return reply;
	snprintf(link->message, sizeof link->message, "%s", reply->str);
	freeReplyObject(reply);
	return NULL;
}

bool backing_redis_is_forgotten(const struct redisReply *reply)
{
	return reply->type == REDIS_REPLY_ERROR &&
	    strncmp(reply->str, "NOSCRIPT", 8) == 0;
}

struct redisReply *backing_redis_link_do(struct backing_redis_link *link,
    struct backing_redis_call *call)
{
	redisReply *reply;

	for (int i = 0; ; i++) {
		reply = backing_redis_link_send(link, call) ?
		    backing_redis_link_get(link) : NULL;
		if (reply == NULL || i > 0 ||
		    !backing_redis_is_forgotten(reply))
			return check(link, reply);
		freeReplyObject(reply);
		if (backing_redis_link_load_scripts(link) != ERR_OK)
			return NULL;
	}
}

/* ---- making it ---- */

enum err backing_redis_link_load_scripts(struct backing_redis_link *link)
{
	for (int i = 0; i < SCRIPT_COUNT; i++) {
		struct backing_redis_call call;
		redisReply *reply;

		backing_redis_call_init(&call, "SCRIPT");
		backing_redis_call_text(&call, "LOAD");
		backing_redis_call_text(&call, backing_redis_scripts[i]);
		reply = backing_redis_link_do(link, &call);
		if (reply == NULL)
			return ERR_UNAVAILABLE;
		snprintf(link->sha[i], sizeof link->sha[i], "%s",
		    reply->type == REDIS_REPLY_STRING ? reply->str : "");
		freeReplyObject(reply);
	}
	return ERR_OK;
}

/* A command whose answer is only to be none of the errors. */
static enum err say(struct backing_redis_link *link,
    struct backing_redis_call *call)
{
	redisReply *reply = backing_redis_link_do(link, call);

	if (reply == NULL)
		return ERR_UNAVAILABLE;
	freeReplyObject(reply);
	return ERR_OK;
}

static enum err authenticate(struct backing_redis_link *link)
{
	const struct backing_redis_url *url = link->url;
	struct backing_redis_call call;

	if (url->password[0] == '\0')
		return ERR_OK;
	backing_redis_call_init(&call, "AUTH");
	if (url->user[0] != '\0')
		backing_redis_call_text(&call, url->user);
	backing_redis_call_text(&call, url->password);
	return say(link, &call);
}

static enum err select_database(struct backing_redis_link *link)
{
	struct backing_redis_call call;
	char number[16];

	if (link->url->database == 0)
		return ERR_OK;
	snprintf(number, sizeof number, "%d", link->url->database);
	backing_redis_call_init(&call, "SELECT");
	backing_redis_call_text(&call, number);
	return say(link, &call);
}

enum err backing_redis_link_read_clock(struct backing_redis_link *link)
{
	struct backing_redis_call call;
	redisReply *reply;
	enum err err = ERR_UNAVAILABLE;

	backing_redis_call_init(&call, "TIME");
	reply = backing_redis_link_do(link, &call);
	if (reply == NULL)
		return ERR_UNAVAILABLE;
	if (reply->type == REDIS_REPLY_ARRAY && reply->elements == 2) {
		link->offset = strtod(reply->element[0]->str, NULL) +
		    1e-6 * strtod(reply->element[1]->str, NULL) -
		    clock_seconds();
		link->clock_read = clock_seconds();
		err = ERR_OK;
	}
	freeReplyObject(reply);
	return err;
}

double backing_redis_link_time(const struct backing_redis_link *link,
    double seconds)
{
	return 1e3 * (link->offset + clock_seconds() + seconds);
}

static enum err shake_hands(struct backing_redis_link *link)
{
	return link->url->is_tls ? backing_redis_tls_open(link->url,
	    link->context->fd, 1000 * CONNECT_SECONDS, &link->tls,
	    link->message) : ERR_OK;
}

static enum err set_up(struct backing_redis_link *link)
{
	enum err err;

	if (redisSetTimeout(link->context, connect_time) != REDIS_OK)
		return ERR_UNAVAILABLE;
	err = shake_hands(link);
	if (err == ERR_OK)
		err = authenticate(link);
	if (err == ERR_OK)
		err = select_database(link);
	if (err == ERR_OK)
		err = backing_redis_link_read_clock(link);
	if (err == ERR_OK)
		err = backing_redis_link_load_scripts(link);
	if (err == ERR_OK && redisSetTimeout(link->context, wait_time) !=
	    REDIS_OK)
		err = ERR_UNAVAILABLE;
	return err;
}

/* Whether the other end has closed an idle connection: nothing is asked. */
static bool is_hung_up(const struct backing_redis_link *link)
{
	char byte;
	ssize_t n;

	if (link->tls != NULL)
		return backing_redis_tls_is_hung_up(link->tls);
	n = recv(link->context->fd, &byte, 1, MSG_PEEK | MSG_DONTWAIT);

	return n == 0 || (n < 0 && errno != EAGAIN && errno != EWOULDBLOCK &&
	    errno != EINTR);
}

enum err backing_redis_link_open(struct backing_redis_link *link)
{
	const struct backing_redis_url *url = link->url;
	enum err err;

	if (link->context != NULL && is_hung_up(link))
		backing_redis_link_close(link);
	if (link->context != NULL)
		return ERR_OK;
	link->context = url->port != 0 ?
	    redisConnectWithTimeout(url->host, url->port, connect_time) :
	    redisConnectUnixWithTimeout(url->host, connect_time);
	if (link->context == NULL || link->context->err != 0) {
		lose(link);
		return ERR_UNAVAILABLE;
	}
	if (url->port != 0)
		redisEnableKeepAlive(link->context);
	note_fd(link, link->context->fd);
	err = set_up(link);
	if (err != ERR_OK)
		backing_redis_link_close(link);
	return err;
}
