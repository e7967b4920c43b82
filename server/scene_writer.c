#include <errno.h>
#include <string.h>
#include <time.h>

#include "server/clock.h"
#include "server/log.h"
#include "server/metrics.h"
#include "server/scene_store_internal.h"
#include "server/scene_worker.h"
#include "server/server.h"
#include "server/volume_store.h"

/* Volumes that are forgotten wholly, at a time. */
#define GONE_MAX 16

/* ---- the queue ---- */

enum err scene_store_submit(struct scene_store *store,
    struct scene_change *change)
{
	enum err err = ERR_OK;

	if (change->kind == SCENE_READ)
		return scene_reader_submit(store, change);
	change->next = NULL;
	change->submitted = clock_seconds();
	pthread_mutex_lock(&store->queue_lock);
	if (store->is_stopping) {
		err = ERR_CANCELLED;
	} else if (store->waiting == SCENE_WAITING_MAX) {
		err = ERR_BUSY;
	} else {
		if (store->last != NULL)
			store->last->next = change;
		else
			store->first = change;
		store->last = change;
		store->waiting++;
		pthread_cond_signal(&store->queue_wake);
	}
	pthread_mutex_unlock(&store->queue_lock);
	return err;
}

size_t scene_store_waiting(struct scene_store *store)
{
	size_t waiting;

	pthread_mutex_lock(&store->queue_lock);
	waiting = store->waiting;
	pthread_mutex_unlock(&store->queue_lock);
	return waiting;
}

void scene_writer_wake(struct scene_store *store)
{
	pthread_mutex_lock(&store->queue_lock);
	pthread_cond_signal(&store->queue_wake);
	pthread_mutex_unlock(&store->queue_lock);
}

/* What waits, within a second; 0 if nothing does. *is_over: nor ever will. */
static size_t take(struct scene_store *store,
    struct scene_change *batch[static SCENE_GROUP_MAX], bool *is_over)
{
	struct timespec until;
	size_t count = 0;

	clock_gettime(CLOCK_MONOTONIC, &until);
	until.tv_sec++;
	pthread_mutex_lock(&store->queue_lock);
	if (store->first == NULL && !store->is_stopping)
		pthread_cond_timedwait(&store->queue_wake, &store->queue_lock,
		    &until);
	while (store->first != NULL && count < SCENE_GROUP_MAX) {
		batch[count++] = store->first;
		store->first = store->first->next;
	}
	if (store->first == NULL)
		store->last = NULL;
	store->waiting -= count;
	*is_over = store->is_stopping && count == 0;
	pthread_mutex_unlock(&store->queue_lock);
	return count;
}

/* ---- the thread ---- */

static void reload(struct scene_store *store)
{
	atomic_store(&store->must_load, false);
	if (scene_load_all(store) != ERR_OK) {
		atomic_store(&store->must_load, true);
		return;
	}
	if (!atomic_exchange(&store->is_loaded, true))
		log_write(LOG_INFO, "scenes: %zu are kept",
		    scene_store_count(store));
	else
		log_write(LOG_INFO, "scenes: read again");
}

/* Whether the text may name volume id: it does not, unless the id is there, or a
 * character that is spelt otherwise. */
static bool may_name(const struct scene *scene, const char *id)
{
	return memchr(scene->text, '\\', scene->length) != NULL ||
	    memmem(scene->text, scene->length, id, strlen(id)) != NULL;
}

/* Whether a scene without a program, which would hold it, may use volume id. */
static bool is_named(void *ctx, const char *id)
{
	const struct scene_store *store = ctx;

	for (size_t i = 0; i < store->table.count; i++) {
		const struct scene *scene = store->table.slots[i]->scene;

		if (scene->program == NULL && may_name(scene, id))
			return true;
	}
	return false;
}

/* Has the backing forget volumes that nothing uses any more. */
static void forget_volumes(struct scene_store *store)
{
	struct volume_store *volumes = store->server->volumes;
	char ids[GONE_MAX][VOLUME_ID_DIGITS + 1];
	size_t count = volume_store_take_gone(volumes, GONE_MAX,
	    store->table.unusable > 0 ? is_named : NULL, store, ids);

	for (size_t i = 0; i < count; i++) {
		enum err err = store->backing->ops->forget_volume(
		    store->backing, ids[i], true);

		if (err != ERR_OK && err != ERR_NOT_FOUND)
			volume_store_put_back_gone(volumes, ids[i]);
	}
}

/* What is to be done besides changes. */
static void tend(struct scene_store *store)
{
	const struct backing_ops *ops = store->backing->ops;

	if (atomic_load(&store->must_load))
		reload(store);
	pthread_mutex_lock(&store->turn);
	if (!ops->is_well(store->backing))
		ops->commit(store->backing, NULL, 0);
	if (atomic_exchange(&store->must_mend, false))
		scene_load_mend(store);
	/* Which volumes a scene uses is known by its program only. */
	volume_store_hold_still(store->server->volumes,
	    store->table.unusable > 0 || atomic_load(&store->must_load));
	if (!atomic_load(&store->must_load))
		forget_volumes(store);
	pthread_mutex_unlock(&store->turn);
}

static void finish(struct scene_store *store, struct scene_change *change)
{
	change->seconds = clock_seconds() - change->submitted;
	if (change->kind == SCENE_PUT || change->kind == SCENE_DELETE)
		metrics_observe(store->server->metrics, NULL, METRICS_COMMIT,
		    change->seconds);
	change->done(change->ctx);
}

static void *write_changes(void *arg)
{
	struct scene_change *batch[SCENE_GROUP_MAX];
	struct scene_store *store = arg;
	double tended = 0.0;
	bool is_over = false;

	while (!is_over) {
		size_t count = take(store, batch, &is_over);

		if (count == 0 || clock_seconds() - tended > 1.0 ||
		    atomic_load(&store->must_load)) {
			tend(store);
			tended = clock_seconds();
		}
		pthread_mutex_lock(&store->turn);
		scene_commit_batch(store, batch, count);
		pthread_mutex_unlock(&store->turn);
		for (size_t i = 0; i < count; i++)
			finish(store, batch[i]);
	}
	return NULL;
}

enum err scene_writer_start(struct scene_store *store)
{
	enum err err;

	if (pthread_create(&store->writer, NULL, write_changes, store) != 0)
		return ERR_MEMORY;
	store->has_writer = true;
	err = scene_worker_create(&store->worker);
	if (err == ERR_OK)
		err = scene_worker_create(&store->reader);
	if (err != ERR_OK)
		scene_writer_stop(store);
	return err;
}

void scene_writer_stop(struct scene_store *store)
{
	const struct backing_ops *ops = store->backing->ops;

	if (ops->stop_reading != NULL)
		ops->stop_reading(store->backing);
	scene_worker_stop(store->worker);
	scene_worker_stop(store->reader);
	pthread_mutex_lock(&store->queue_lock);
	store->is_stopping = true;
	pthread_cond_signal(&store->queue_wake);
	pthread_mutex_unlock(&store->queue_lock);
	if (store->has_writer)
		pthread_join(store->writer, NULL);
	store->has_writer = false;
}
