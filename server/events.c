/*
 * A listener is made by its exchange's handler and freed when the exchange is
 * over (x->state_free), which takes it off the list: while it is on it, under
 * the lock, its exchange and socket are there. Its queue and flags are guarded
 * by the lock; what it has printed, and its past, belong to the HTTP thread
 * that reads the stream.
 *
 * A stream that has nothing to read pauses its exchange under the lock and says
 * so; whoever then has something for it, also under the lock, takes that back
 * and resumes it: once for every pause.
 */
#include "server/events.h"

#include <pthread.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/socket.h>

#include "server/access.h"
#include "server/clock.h"
#include "server/exchange.h"
#include "server/scene_reply.h"
#include "server/scene_store.h"
#include "server/server.h"

/* Of nothing sent, before a comment is. */
#define COMMENT_SECONDS 15.0

/* A listener that has taken nothing for so long has a full socket. */
#define STUCK_SECONDS 1.0

/* What the system may hold of a stream: some hundred events. Left alone, it
 * grows to megabytes, of events that are old when they arrive. */
#define SOCKET_BYTES 32768

/* Room for an event as it is sent: two ids, numbers, and the names of both. */
#define EVENT_TEXT_MAX 512

#define HEAD "retry: 2000\n\n"
#define COMMENT ": alive\n\n"

struct listener {
	struct listener *next, **link;
	struct events *events;
	struct exchange *x;
	char id[SCENE_ID_MAX + 1];
	char asker[ACCESS_ASKER_SIZE];
	const struct token *token; /* kept: x gives its own up before */
	/* guarded by the lock */
	struct scene_event queue[EVENTS_QUEUE]; /* a ring */
	size_t first, count;
	bool has_missed;     /* some were left out before the first */
	struct scene_seq floor; /* the last taken: only later ones are */
	bool is_paused;
	bool is_comment_due;
	bool is_gone;        /* its client */
	bool is_ended;       /* the scene's deletion has been taken, or its
	                      * token is one no more */
	double read;         /* when its stream was last read, clock_seconds */
	/* the HTTP thread's */
	bool is_read;        /* its stream has begun to leave */
	struct scene_event *past;
	size_t past_count, past_read;
	bool past_missed;
	char text[EVENT_TEXT_MAX];
	size_t length, at;   /* of text: what there is, what is sent of it */
};

struct events {
	size_t most;
	pthread_mutex_t lock; /* guards the rest */
	struct listener *list;
	size_t count;
	unsigned long sent, cut;
	bool is_draining;
	unsigned reloads;    /* of tokens, when they were last looked at */
};

enum err events_create(size_t most, struct events **out)
{
	struct events *e = calloc(1, sizeof *e);

	if (e == NULL)
		return ERR_MEMORY;
	e->most = most;
	pthread_mutex_init(&e->lock, NULL);
	*out = e;
	return ERR_OK;
}

void events_free(struct events *e)
{
	if (e == NULL)
		return;
	pthread_mutex_destroy(&e->lock);
	free(e);
}

void events_get_stats(struct events *e, struct events_stats *out)
{
	pthread_mutex_lock(&e->lock);
	*out = (struct events_stats){e->count, e->sent, e->cut};
	pthread_mutex_unlock(&e->lock);
}

/* ---- from the store's side ---- */

/* Has l's stream read again, if it waits. Locked. */
static void wake(struct listener *l)
{
	if (!l->is_paused)
		return;
	l->is_paused = false;
	exchange_resume(l->x);
}

/* Locked. */
static void enqueue(struct listener *l, const struct scene_event *event)
{
	if (l->count == EVENTS_QUEUE) {
		l->first = (l->first + 1) % EVENTS_QUEUE;
		l->count--;
		l->has_missed = true;
	}
	l->queue[(l->first + l->count++) % EVENTS_QUEUE] = *event;
}

void events_publish(struct events *e, const struct scene_event *event)
{
	pthread_mutex_lock(&e->lock);
	for (struct listener *l = e->list; l != NULL; l = l->next) {
		if (strcmp(l->id, event->id) != 0)
			continue;
		enqueue(l, event);
		wake(l);
	}
	pthread_mutex_unlock(&e->lock);
}

/* Locked. */
static void tend(struct listener *l, double now)
{
	if (!l->is_paused)
		return;
	l->is_gone = !exchange_is_connected(l->x);
	l->is_comment_due = now - l->read >= COMMENT_SECONDS;
	if (l->is_gone || l->is_comment_due)
		wake(l);
}

/* If tokens have been read anew, ends those who would not be let in now.
 * Locked. */
static void check_tokens(struct events *e)
{
	unsigned reloads;

	if (e->list == NULL)
		return;
	reloads = access_reloads(e->list->x->server->access);
	if (reloads == e->reloads)
		return;
	e->reloads = reloads;
	for (struct listener *l = e->list; l != NULL; l = l->next) {
		if (access_is_still_allowed(l->x->server->access, l->token,
		    ROLE_READ))
			continue;
		l->is_ended = true;
		wake(l);
	}
}

void events_tend(struct events *e)
{
	double now = clock_seconds();

	pthread_mutex_lock(&e->lock);
	for (struct listener *l = e->list; l != NULL; l = l->next)
		tend(l, now);
	check_tokens(e);
	pthread_mutex_unlock(&e->lock);
}

void events_drain(struct events *e)
{
	double now = clock_seconds();

	pthread_mutex_lock(&e->lock);
	e->is_draining = true;
	for (struct listener *l = e->list; l != NULL; l = l->next) {
		if (!l->is_paused && now - l->read > STUCK_SECONDS)
			shutdown(l->x->socket, SHUT_RDWR);
		wake(l);
	}
	pthread_mutex_unlock(&e->lock);
}

/* ---- printing ---- */

/* ids and tags have no characters that JSON would escape. */
static void print_event(struct listener *l, const struct scene_event *event,
    bool has_missed)
{
	char seq[SCENE_SEQ_SIZE], when[SCENE_TIME_SIZE], rest[160] = "";
	int n;

	scene_seq_print(event->seq, seq);
	scene_reply_time(event->time, when);
	if (!event->is_deleted)
		snprintf(rest, sizeof rest, ",\"revision\":\"%.*s\","
		    "\"nodes\":%zu,\"bytes\":%zu", ETAG_DIGITS,
		    event->etag[0] != '\0' ? event->etag + 1 : "",
		    event->nodes, event->length);
	n = snprintf(l->text, sizeof l->text, "id: %s\nevent: %s\ndata: "
	    "{\"id\":\"%s\",\"sequence\":\"%s\",\"time\":\"%s\"%s%s}\n\n",
	    seq, event->is_deleted ? "deleted" : "revision", event->id, seq,
	    when, rest, has_missed ? ",\"missed\":true" : "");
	l->length = (size_t)n;
	l->at = 0;
}

static void put_text(struct listener *l, const char *text)
{
	strcpy(l->text, text);
	l->length = strlen(text);
	l->at = 0;
}

/* ---- the stream ---- */

/* An event of the queue that is later than what was taken; or false. Locked. */
static bool take(struct listener *l, struct scene_event *event,
    bool *has_missed)
{
	while (l->count > 0) {
		const struct scene_event *first = &l->queue[l->first];

		l->first = (l->first + 1) % EVENTS_QUEUE;
		l->count--;
		if (!first->is_anew &&
		    scene_seq_compare(first->seq, l->floor) <= 0)
			continue;
		*event = *first;
		*has_missed = l->has_missed || first->has_missed;
		l->has_missed = false;
		l->floor = event->seq;
		l->is_ended = event->is_deleted;
		l->events->sent++;
		return true;
	}
	return false;
}

/* Prints the next of the past; false: there is none left. */
static bool next_past(struct listener *l)
{
	if (l->past_read == l->past_count)
		return false;
	print_event(l, &l->past[l->past_read], l->past_missed ||
	    l->past[l->past_read].has_missed);
	l->past_missed = false;
	if (++l->past_read == l->past_count) {
		free(l->past);
		l->past = NULL;
	}
	return true;
}

/*
 * Prints what is to be sent next: 1; or nothing, yet (EXCHANGE_PAUSED) or ever
 * again. may_pause: else only what is there.
 */
static ptrdiff_t next(struct listener *l, bool may_pause)
{
	struct events *e = l->events;
	struct scene_event event;
	bool has_missed, has_event = false;
	ptrdiff_t result = 1;

	if (next_past(l))
		return 1;
	pthread_mutex_lock(&e->lock);
	l->read = clock_seconds();
	if (l->is_gone) {
		result = EXCHANGE_CUT;
	} else if (l->is_ended) {
		result = EXCHANGE_END;
	} else if (take(l, &event, &has_missed)) {
		has_event = true;
	} else if (e->is_draining) {
		result = EXCHANGE_END;
	} else if (l->is_comment_due) {
		put_text(l, COMMENT);
	} else {
		result = EXCHANGE_PAUSED;
		if (may_pause) {
			l->is_paused = true;
			exchange_pause(l->x);
		}
	}
	l->is_comment_due = false;
	pthread_mutex_unlock(&e->lock);
	if (has_event)
		print_event(l, &event, has_missed);
	return result;
}

/* struct exchange_stream, read: as many events as fit. */
static ptrdiff_t read_stream(void *ctx, char *out, size_t size)
{
	struct listener *l = ctx;
	size_t n, length = 0;
	ptrdiff_t result = 1;

	l->is_read = true;
	while (length < size) {
		if (l->at == l->length) {
			result = next(l, length == 0);
			if (result != 1)
				break;
		}
		n = l->length - l->at;
		n = n < size - length ? n : size - length;
		memcpy(out + length, l->text + l->at, n);
		l->at += n;
		length += n;
	}
	return length > 0 ? (ptrdiff_t)length : result;
}

/* ---- life ---- */

/* x->state_free */
static void leave(void *state, struct server *server)
{
	struct listener *l = state;
	struct events *e = l->events;

	(void)server;
	pthread_mutex_lock(&e->lock);
	*l->link = l->next;
	if (l->next != NULL)
		l->next->link = l->link;
	e->count--;
	if (l->is_read && !l->is_gone && !l->is_ended && !e->is_draining)
		e->cut++;
	pthread_mutex_unlock(&e->lock);
	access_let_go(l->token);
	free(l->past);
	free(l);
}

/* Whether l's asker has as many as one may have. Locked. */
static bool has_share(const struct events *e, const struct listener *l)
{
	size_t count = 0;

	if (l->asker[0] == '\0')
		return false;
	for (const struct listener *k = e->list; k != NULL; k = k->next)
		count += strcmp(k->asker, l->asker) == 0;
	return count >= events_share(e->most);
}

size_t events_share(size_t most)
{
	return most >= 4 ? most / 4 : 1;
}

/* Puts l on the list. ERR_BUSY, ERR_LIMIT, ERR_CANCELLED. */
static enum err join(struct events *e, struct listener *l)
{
	enum err err = ERR_OK;

	pthread_mutex_lock(&e->lock);
	if (e->is_draining) {
		err = ERR_CANCELLED;
	} else if (e->count >= e->most) {
		err = ERR_BUSY;
	} else if (has_share(e, l)) {
		err = ERR_LIMIT;
	} else {
		l->next = e->list;
		l->link = &e->list;
		if (l->next != NULL)
			l->next->link = &l->next;
		e->list = l;
		e->count++;
	}
	pthread_mutex_unlock(&e->lock);
	return err;
}

enum err events_listen(struct events *e, struct exchange *x, const char *id,
    struct listener **out)
{
	const int bytes = SOCKET_BYTES;
	struct listener *l = calloc(1, sizeof *l);
	enum err err;

	if (l == NULL)
		return ERR_MEMORY;
	setsockopt(x->socket, SOL_SOCKET, SO_SNDBUF, &bytes, sizeof bytes);
	l->events = e;
	l->x = x;
	l->read = clock_seconds();
	strncpy(l->id, id, SCENE_ID_MAX);
	access_asker(x, l->asker);
	l->token = access_keep(x);
	put_text(l, HEAD);
	err = join(e, l);
	if (err != ERR_OK) {
		access_let_go(l->token);
		free(l);
		return err;
	}
	x->state = l;
	x->state_free = leave;
	*out = l;
	return ERR_OK;
}

void events_begin(struct listener *l, struct scene_event *past, size_t count,
    bool has_missed, struct scene_seq after)
{
	struct events *e = l->events;

	l->past = past;
	l->past_count = count;
	l->past_missed = has_missed;
	if (count == 0) {
		free(past);
		l->past = NULL;
	} else if (scene_seq_compare(past[count - 1].seq, after) > 0) {
		after = past[count - 1].seq;
	}
	pthread_mutex_lock(&e->lock);
	l->floor = after;
	l->is_ended = count > 0 && past[count - 1].is_deleted;
	e->sent += count;
	pthread_mutex_unlock(&e->lock);
	exchange_reply_stream(l->x, MEDIA_EVENTS, &(struct exchange_stream){
		.read = read_stream,
		.ctx = l,
	});
	exchange_add_header(l->x, "Cache-Control", "no-store");
	exchange_add_header(l->x, "X-Accel-Buffering", "no");
}
