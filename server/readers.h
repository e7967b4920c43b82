/*
 * Threads on which requests with large bodies are handled, so that HTTP's two
 * threads serve others meanwhile: to parse a document of 16 MB takes up to half
 * a second. Those who wait are given turns by who asks (server/turns.h), by
 * bytes; one thread is for the smaller ones alone.
 *
 * Threads: an exchange that is handed over is a reader's until its handler has
 * returned, and HTTP's again once, if the handler had it wait, that is over, too
 * (server/exchange.h).
 */
#ifndef SERVER_READERS_H
#define SERVER_READERS_H

#include <stdbool.h>

#include "core/err.h"

struct exchange;
struct readers;

/* ERR_MEMORY, ERR_IO. */
enum err readers_create(struct readers **out);

/* Whether none is at work and nothing waits for one. */
bool readers_are_idle(struct readers *r);

/* Answers what waits with 503 and ends the threads, behind what they are at:
 * what comes later is handled where it is. NULL does nothing. */
void readers_stop(struct readers *r);

/* After readers_stop, and once no exchange is left. NULL does nothing. */
void readers_free(struct readers *r);

/* Whether readers_handle() has a reader handle x. */
bool readers_want(const struct exchange *x);

/*
 * Has x, whose body is complete, be handled: at once, or, if there is much of it
 * to be parsed, by a reader, for which x then waits. HTTP's threads.
 */
void readers_handle(struct exchange *x);

#endif
