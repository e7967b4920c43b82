/*
 * Who owns: the lock guards the list; a reading is its list's until one thread
 * takes it out, and that thread's then, which frees it.
 */
#include "server/readers.h"

#include <pthread.h>
#include <stddef.h>
#include <stdlib.h>
#include <string.h>

#include "server/exchange.h"
#include "server/routes.h"
#include "server/server.h"
#include "server/turns.h"

/* Bytes of a body up to which it is handled at once. A document of 32 KB takes
 * about 1 ms. */
#define AT_ONCE_BYTES ((size_t)32 << 10)

/* Bytes up to which it is for the thread of the smaller ones, too: 30 ms. */
#define SMALLER_BYTES ((size_t)1 << 20)

/* As many as HTTP has, and one for the smaller ones alone. */
#define THREADS 3

/* An exchange that waits for a reader. */
struct reading {
	struct turn turn; /* the first member */
	struct exchange *x;
	size_t bytes;
};

struct readers {
	pthread_t threads[THREADS];
	size_t thread_count;
	pthread_mutex_t lock; /* guards: */
	pthread_cond_t wake;
	struct turns turns;
	size_t busy;          /* threads that are at one */
	bool has_smaller;     /* a thread has taken to the smaller ones */
	bool is_stopping;
};

static struct reading *reading_of(struct turn *turn)
{
	return (struct reading *)turn;
}

/* ---- the threads ---- */

/* What comes next, or the end of the list. Locked. */
static struct turn **next_turn(struct readers *r, bool smaller_only)
{
	struct turn **at = &r->turns.first;

	while (smaller_only && *at != NULL &&
	    reading_of(*at)->bytes > SMALLER_BYTES)
		at = &(*at)->next;
	return at;
}

/* NULL: none is left, and none will come. Locked. */
static struct reading *await(struct readers *r, bool smaller_only)
{
	struct turn **at = next_turn(r, smaller_only);

	while (*at == NULL && !r->is_stopping) {
		pthread_cond_wait(&r->wake, &r->lock);
		at = next_turn(r, smaller_only);
	}
	if (*at == NULL)
		return NULL;
	r->busy++;
	return reading_of(turns_serve(&r->turns, at));
}

/* Also where the client has sent the end of its stream: whether it has gone, or
 * only has no more to say, is not to be seen, and a change is made all the same. */
static void handle(struct exchange *x, bool is_stopping)
{
	if (is_stopping)
		exchange_reply_problem(x, PROBLEM_DRAINING, NULL,
		    "The server is shutting down and takes no new work.");
	else
		x->route->handle(x);
}

static void *thread_main(void *arg)
{
	struct readers *r = arg;
	struct reading *reading;
	bool smaller_only;

	pthread_mutex_lock(&r->lock);
	smaller_only = !r->has_smaller;
	r->has_smaller = true;
	while ((reading = await(r, smaller_only)) != NULL) {
		struct exchange *x = reading->x;
		bool is_stopping = r->is_stopping;

		pthread_mutex_unlock(&r->lock);
		free(reading);
		exchange_take_over(x);
		handle(x, is_stopping);
		exchange_hand_back(x);
		pthread_mutex_lock(&r->lock);
		r->busy--;
	}
	pthread_mutex_unlock(&r->lock);
	return NULL;
}

/* ---- HTTP's side ---- */

/* Bytes of x's body that its handler is still to parse. */
static size_t bytes_left(const struct exchange *x)
{
	if (x->sink != NULL)
		return x->sink->left != NULL ? x->sink->left(x->sink) : 0;
	return x->body_length;
}

/* Whether x is better handled elsewhere. Patches are: they have a thread of their
 * own, where they stay in order. */
static bool is_large(const struct exchange *x)
{
	return bytes_left(x) > AT_ONCE_BYTES &&
	    strcmp(x->route->method, "PATCH") != 0;
}

bool readers_want(const struct exchange *x)
{
	return x->server->readers != NULL && is_large(x);
}

/* False: there are no threads any more. */
static bool enqueue(struct readers *r, struct reading *reading)
{
	bool can;

	pthread_mutex_lock(&r->lock);
	can = !r->is_stopping;
	if (can) {
		exchange_wait(reading->x);
		turns_add(&r->turns, &reading->turn, reading->bytes);
		/* It may be none for the one that a signal would wake. */
		pthread_cond_broadcast(&r->wake);
	}
	pthread_mutex_unlock(&r->lock);
	return can;
}

void readers_handle(struct exchange *x)
{
	struct readers *r = x->server->readers;
	struct reading *reading = NULL;

	if (readers_want(x))
		reading = calloc(1, sizeof *reading);
	if (reading != NULL) {
		reading->x = x;
		reading->bytes = bytes_left(x);
		access_asker(x, reading->turn.asker);
		if (enqueue(r, reading))
			return;
	}
	free(reading);
	x->route->handle(x);
}

/* ---- life ---- */

enum err readers_create(struct readers **out)
{
	struct readers *r = calloc(1, sizeof *r);

	if (r == NULL)
		return ERR_MEMORY;
	pthread_mutex_init(&r->lock, NULL);
	pthread_cond_init(&r->wake, NULL);
	for (; r->thread_count < THREADS; r->thread_count++) {
		if (pthread_create(&r->threads[r->thread_count], NULL,
		    thread_main, r) != 0) {
			readers_stop(r);
			readers_free(r);
			return ERR_IO;
		}
	}
	*out = r;
	return ERR_OK;
}

bool readers_are_idle(struct readers *r)
{
	bool are;

	pthread_mutex_lock(&r->lock);
	are = r->turns.first == NULL && r->busy == 0;
	pthread_mutex_unlock(&r->lock);
	return are;
}

void readers_stop(struct readers *r)
{
	if (r == NULL)
		return;
	pthread_mutex_lock(&r->lock);
	r->is_stopping = true;
	pthread_cond_broadcast(&r->wake);
	pthread_mutex_unlock(&r->lock);
	while (r->thread_count > 0)
		pthread_join(r->threads[--r->thread_count], NULL);
}

void readers_free(struct readers *r)
{
	if (r == NULL)
		return;
	pthread_cond_destroy(&r->wake);
	pthread_mutex_destroy(&r->lock);
	free(r);
}
