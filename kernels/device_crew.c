/*
 * A few threads that help the one that evaluates, with work cut into tasks
 * (core/tiles.h's struct tiles_crew).
 *
 * The mutex guards everything of struct device_crew but what threads_crew does
 * not change. Tasks are taken one at a time, by the caller of run too; the
 * mutex is released while one runs. run returns when none is left and none
 * runs, so the task and its ctx need not outlive it. Signals are left to
 * other threads.
 */
#include "kernels/device_internal.h"

#include <pthread.h>
#include <sched.h>
#include <signal.h>
#include <stdlib.h>

#include "core/tiles.h"

/* Preparing tiles is bound by memory from about here on. */
#define HANDS_MAX 8

struct device_crew {
	struct tiles_crew crew;
	pthread_t threads[HANDS_MAX - 1];
	size_t thread_count;
	pthread_mutex_t mutex;
	pthread_cond_t wanted, ended;
	void (*task)(void *ctx, size_t i);
	void *ctx;
	size_t next, count; /* tasks taken, and all */
	size_t running;
	bool closes;
};

/* Does tasks until none is left to take. Called with the mutex held. */
static void work(struct device_crew *c)
{
	while (c->next < c->count) {
		void (*task)(void *, size_t) = c->task;
		void *ctx = c->ctx;
		size_t i = c->next++;

		c->running++;
		pthread_mutex_unlock(&c->mutex);
		task(ctx, i);
		pthread_mutex_lock(&c->mutex);
		c->running--;
	}
}

static void *help(void *self)
{
	struct device_crew *c = self;

	pthread_mutex_lock(&c->mutex);
	while (!c->closes) {
		work(c);
		if (c->running == 0)
			pthread_cond_signal(&c->ended);
		pthread_cond_wait(&c->wanted, &c->mutex);
	}
	pthread_mutex_unlock(&c->mutex);
	return NULL;
}

static void run(void *self, void (*task)(void *ctx, size_t i), void *ctx,
    size_t count)
{
	struct device_crew *c = self;

	if (count <= 1 || c->thread_count == 0) {
		for (size_t i = 0; i < count; i++)
			task(ctx, i);
		return;
	}
	pthread_mutex_lock(&c->mutex);
	c->task = task;
	c->ctx = ctx;
	c->next = 0;
	c->count = count;
	pthread_cond_broadcast(&c->wanted);
	work(c);
	while (c->running > 0)
		pthread_cond_wait(&c->ended, &c->mutex);
	pthread_mutex_unlock(&c->mutex);
}

/* As many threads as there are processors besides the caller's. */
static void start(struct device_crew *c)
{
	sigset_t all, before;
	cpu_set_t ours;
	size_t want = 0;

	if (sched_getaffinity(0, sizeof(ours), &ours) == 0)
		want = (size_t)CPU_COUNT(&ours) - 1;
	if (want > HANDS_MAX - 1)
		want = HANDS_MAX - 1;
	sigfillset(&all);
	if (pthread_sigmask(SIG_SETMASK, &all, &before) != 0)
		return;
	while (c->thread_count < want && pthread_create(c->threads +
	    c->thread_count, NULL, help, c) == 0)
		c->thread_count++;
	pthread_sigmask(SIG_SETMASK, &before, NULL);
}

enum err device_crew_create(struct device_crew **out)
{
	struct device_crew *c = calloc(1, sizeof(*c));

	if (!c)
		return ERR_MEMORY;
	/* With default attributes none of these can fail. */
	pthread_mutex_init(&c->mutex, NULL);
	pthread_cond_init(&c->wanted, NULL);
	pthread_cond_init(&c->ended, NULL);
	start(c);
	c->crew = (struct tiles_crew){.run = run, .self = c,
		.hands = c->thread_count + 1};
	*out = c;
	return ERR_OK;
}

void device_crew_free(struct device_crew *c)
{
	if (!c)
		return;
	pthread_mutex_lock(&c->mutex);
	c->closes = true;
	pthread_cond_broadcast(&c->wanted);
	pthread_mutex_unlock(&c->mutex);
	for (size_t i = 0; i < c->thread_count; i++)
		pthread_join(c->threads[i], NULL);
	pthread_cond_destroy(&c->ended);
	pthread_cond_destroy(&c->wanted);
	pthread_mutex_destroy(&c->mutex);
	free(c);
}

const struct tiles_crew *device_crew_get(const struct device_crew *c)
{
	return &c->crew;
}
