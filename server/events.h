/*
 * Who listens to scenes: GET /v1/scenes/{id}/events (Server-Sent Events, WHATWG
 * HTML section 9.2).
 *
 * Threads: the store's threads publish; each listener's stream is read on an
 * HTTP thread. Lock order: the store's, then this one's, then libmicrohttpd's.
 *
 * Nothing is lost or doubled between what has been and what comes: a listener is
 * there, and gathers, before the past is read (events_listen); then the past
 * goes out first, and of what was gathered only what is later
 * (events_begin). This needs a store in which a change is seen by readers before
 * it is published.
 */
#ifndef SERVER_EVENTS_H
#define SERVER_EVENTS_H

#include <stdbool.h>
#include <stddef.h>

#include "core/err.h"
#include "server/scene_seq.h"

struct events;
struct exchange;
struct listener;
struct scene_event;
struct server;

/* Events that wait for a listener; of more, the oldest are left out. */
#define EVENTS_QUEUE 32

struct events_stats {
	size_t listeners;
	unsigned long sent;    /* events */
	unsigned long cut;     /* listeners that were too slow */
};

/* For so many listeners at most. */
enum err events_create(size_t most, struct events **out);

/* Of so many in all, what one may have: a quarter, at least one. */
size_t events_share(size_t most);

/* A scene has changed; the store calls it, in the order of event->seq. */
void events_publish(struct events *e, const struct scene_event *event);

/* Call about once a second: comments keep connections alive, and find those
 * whose clients have gone; those whose tokens have been taken away end. */
void events_tend(struct events *e);

/* Ends every stream, once what waits for it is out; new ones are refused. Those
 * that have taken nothing for a second are cut. Before HTTP stops. */
void events_drain(struct events *e);

/* Once no exchange is left. NULL does nothing. */
void events_free(struct events *e);

void events_get_stats(struct events *e, struct events_stats *out);

/* ---- for handle_scene_events.c ---- */

/*
 * x listens to scene id from now on: x->state, which ends it. ERR_BUSY: there are
 * as many as may be; ERR_LIMIT: there are events_share of x's token, or address
 * (access_asker); ERR_CANCELLED: draining; ERR_MEMORY.
 */
enum err events_listen(struct events *e, struct exchange *x, const char *id,
    struct listener **out);

/*
 * Answers x with l's stream: first past, count events (malloc'd, taken over;
 * has_missed: more were before the first), then what comes after `after`.
 */
void events_begin(struct listener *l, struct scene_event *past, size_t count,
    bool has_missed, struct scene_seq after);

#endif
