/*
 * A list of what waits, in an order that gives its askers turns: who brings much
 * is not served before others who bring something later, but for one piece.
 * Start-time fair queueing (Goyal, Vin and Cheng 1996, section 2): each piece
 * starts where its asker's last one that waits ends, or now; the least start is
 * next, of equal ones the one that came first.
 *
 * Threads: none of its own; the caller has a lock.
 */
#ifndef SERVER_TURNS_H
#define SERVER_TURNS_H

#include <stddef.h>

#include "server/access.h"

/* One that waits: embedded in what it is. */
struct turn {
	char asker[ACCESS_ASKER_SIZE]; /* set before turns_add */
	struct turn *next;
	unsigned long start, end;
};

/* Zeroed: empty. */
struct turns {
	struct turn *first; /* whose turn is next, and so on */
	size_t count;
	unsigned long now;
};

/* turn waits from now on, for something of that cost (> 0). */
void turns_add(struct turns *t, struct turn *turn, unsigned long cost);

/* *at, which is in t, is served now. Others before it may be passed by. */
struct turn *turns_serve(struct turns *t, struct turn **at);

/* *at, which is in t, is not to be served. */
struct turn *turns_drop(struct turns *t, struct turn **at);

/* How many of that asker's wait. */
size_t turns_count_of(const struct turns *t, const char *asker);

#endif
