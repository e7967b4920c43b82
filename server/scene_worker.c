#include "server/scene_worker.h"

#include <pthread.h>
#include <stdbool.h>
#include <stddef.h>
#include <stdlib.h>

#include "server/scene_store_internal.h"

/* Pieces of work that wait at most: each has a body in memory, or will. */
#define WAITING_MAX 256

struct scene_worker {
	pthread_t thread;
	pthread_mutex_t lock;    /* guards: */
	pthread_cond_t wake;
	struct scene_work *first, **last;
	size_t waiting;
	bool is_stopping;
};

/* NULL: none is left, and none will come. *is_cancelled: it is too late. */
static struct scene_work *take(struct scene_worker *w, bool *is_cancelled)
{
	struct scene_work *work;

	pthread_mutex_lock(&w->lock);
	while (w->first == NULL && !w->is_stopping)
		pthread_cond_wait(&w->wake, &w->lock);
	work = w->first;
	if (work != NULL) {
		w->first = work->next;
		w->waiting--;
	}
	if (w->first == NULL)
		w->last = &w->first;
	*is_cancelled = w->is_stopping;
	pthread_mutex_unlock(&w->lock);
	return work;
}

static void *do_work(void *arg)
{
	struct scene_worker *w = arg;
	struct scene_work *work;
	bool is_cancelled;

	while ((work = take(w, &is_cancelled)) != NULL)
		work->work(work->ctx, is_cancelled);
	return NULL;
}

enum err scene_worker_create(struct scene_worker **out)
{
	struct scene_worker *w = calloc(1, sizeof *w);

	if (w == NULL)
		return ERR_MEMORY;
	w->last = &w->first;
	pthread_mutex_init(&w->lock, NULL);
	pthread_cond_init(&w->wake, NULL);
	if (pthread_create(&w->thread, NULL, do_work, w) == 0) {
		*out = w;
		return ERR_OK;
	}
	pthread_cond_destroy(&w->wake);
	pthread_mutex_destroy(&w->lock);
	free(w);
	return ERR_IO;
}

void scene_worker_stop(struct scene_worker *w)
{
	bool was_stopping;

	if (w == NULL)
		return;
	pthread_mutex_lock(&w->lock);
	was_stopping = w->is_stopping;
	w->is_stopping = true;
	pthread_cond_signal(&w->wake);
	pthread_mutex_unlock(&w->lock);
	if (!was_stopping)
		pthread_join(w->thread, NULL);
}

void scene_worker_free(struct scene_worker *w)
{
	if (w == NULL)
		return;
	pthread_cond_destroy(&w->wake);
	pthread_mutex_destroy(&w->lock);
	free(w);
}

enum err scene_worker_add(struct scene_worker *w, struct scene_work *work)
{
	enum err err = ERR_OK;

	work->next = NULL;
	pthread_mutex_lock(&w->lock);
	if (w->is_stopping) {
		err = ERR_CANCELLED;
	} else if (w->waiting == WAITING_MAX) {
		err = ERR_BUSY;
	} else {
		*w->last = work;
		w->last = &work->next;
		w->waiting++;
		pthread_cond_signal(&w->wake);
	}
	pthread_mutex_unlock(&w->lock);
	return err;
}

enum err scene_store_work(struct scene_store *store, struct scene_work *work)
{
	return scene_worker_add(store->worker, work);
}

/* ---- waiting for the writer ---- */

struct awaited {
	pthread_mutex_t lock;
	pthread_cond_t wake;
	bool is_done;
};

static void on_done(void *ctx)
{
	struct awaited *a = ctx;

	pthread_mutex_lock(&a->lock);
	a->is_done = true;
	pthread_cond_signal(&a->wake);
	pthread_mutex_unlock(&a->lock);
}

void scene_store_change(struct scene_store *store, struct scene_change *change)
{
	struct awaited a = {PTHREAD_MUTEX_INITIALIZER,
	    PTHREAD_COND_INITIALIZER, false};
	enum err err;

	change->done = on_done;
	change->ctx = &a;
	err = scene_store_submit(store, change);
	if (err != ERR_OK) {
		change->result = err;
		if (change->scene != NULL)
			scene_release(change->scene);
		return;
	}
	pthread_mutex_lock(&a.lock);
	while (!a.is_done)
		pthread_cond_wait(&a.wake, &a.lock);
	pthread_mutex_unlock(&a.lock);
	pthread_cond_destroy(&a.wake);
	pthread_mutex_destroy(&a.lock);
}
