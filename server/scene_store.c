#include "server/scene_store_internal.h"

#include <stdlib.h>
#include <string.h>

#include "server/config.h"
#include "server/log.h"
#include "server/scene_worker.h"
#include "server/server.h"

/* ---- what a backing tells ---- */

static void guard(void *ctx, bool is_begun)
{
	struct scene_store *store = ctx;

	if (is_begun)
		pthread_mutex_lock(&store->turn);
	else
		pthread_mutex_unlock(&store->turn);
}

static void on_lost(void *ctx)
{
	struct scene_store *store = ctx;

	atomic_store(&store->must_load, true);
	scene_writer_wake(store);
}

/* ---- life ---- */

static enum err open_backing(struct scene_store *store)
{
	const struct config *config = store->server->config;
	const struct backing_options options = {
		.history = config->history,
		.history_bytes = config->history_bytes,
		.changed = {scene_load_revision, scene_load_volume, store},
		.guard = guard,
		.lost = on_lost,
	};

	if (config->store[0] == '\0')
		return backing_open_sqlite(config->data, &options,
		    &store->backing);
	store->is_shared = true;
	return backing_open_redis(config->store, &options, &store->backing);
}

/* The first time. Where daemons share what is away, it is tried again. */
static enum err load(struct scene_store *store)
{
	enum err err = scene_load_all(store);

	if (err == ERR_OK) {
		atomic_store(&store->is_loaded, true);
	} else if (err == ERR_UNAVAILABLE && store->is_shared) {
		log_write(LOG_WARNING, "scenes: %s is away; waiting for it",
		    "the shared store");
		atomic_store(&store->must_load, true);
		err = ERR_OK;
	}
	return err;
}

static void init_locks(struct scene_store *store)
{
	pthread_condattr_t attr;

	pthread_rwlock_init(&store->lock, NULL);
	pthread_mutex_init(&store->turn, NULL);
	pthread_mutex_init(&store->queue_lock, NULL);
	pthread_condattr_init(&attr);
	pthread_condattr_setclock(&attr, CLOCK_MONOTONIC);
	pthread_cond_init(&store->queue_wake, &attr);
	pthread_condattr_destroy(&attr);
}

enum err scene_store_create(struct server *server, struct scene_store **out)
{
	struct scene_store *store = calloc(1, sizeof *store);
	enum err err;

	if (store == NULL)
		return ERR_MEMORY;
	store->server = server;
	store->most = server->config->max_scenes;
	store->bytes_most = server->config->scene_memory;
	store->table.history = server->config->history > 0 ?
	    server->config->history : 1;
	store->table.history_bytes = server->config->history_bytes;
	init_locks(store);
	err = open_backing(store);
	if (err == ERR_BUSY)
		err = ERR_CONFLICT; /* no queue is full */
	if (err == ERR_OK)
		err = load(store);
	if (err == ERR_OK)
		err = scene_writer_start(store);
	if (err != ERR_OK) {
		scene_store_free(store);
		return err;
	}
	*out = store;
	return ERR_OK;
}

void scene_store_stop(struct scene_store *store)
{
	scene_writer_stop(store);
	pthread_mutex_lock(&store->turn);
	store->is_ended = true;
	pthread_mutex_unlock(&store->turn);
}

void scene_store_free(struct scene_store *store)
{
	if (store == NULL)
		return;
	if (store->backing != NULL)
		store->backing->ops->free(store->backing);
	scene_worker_free(store->worker);
	scene_worker_free(store->reader);
	scene_table_fini(&store->table);
	pthread_rwlock_destroy(&store->lock);
	pthread_mutex_destroy(&store->turn);
	pthread_mutex_destroy(&store->queue_lock);
	pthread_cond_destroy(&store->queue_wake);
	free(store);
}

/* ---- asking ---- */

bool scene_store_is_ready(struct scene_store *store)
{
	return atomic_load(&store->is_loaded);
}

bool scene_store_is_well(struct scene_store *store)
{
	return atomic_load(&store->is_loaded) &&
	    !atomic_load(&store->must_load) &&
	    store->backing->ops->is_well(store->backing);
}

bool scene_store_is_shared(const struct scene_store *store)
{
	return store->is_shared;
}

size_t scene_store_count(struct scene_store *store)
{
	size_t count;

	pthread_rwlock_rdlock(&store->lock);
	count = store->table.count;
	pthread_rwlock_unlock(&store->lock);
	return count;
}

size_t scene_store_count_of(struct scene_store *store, const char *owner)
{
	size_t count = 0;

	pthread_rwlock_rdlock(&store->lock);
	for (size_t i = 0; i < store->table.count; i++)
		count += strcmp(store->table.slots[i]->scene->owner, owner) ==
		    0;
	pthread_rwlock_unlock(&store->lock);
	return count;
}

size_t scene_store_bytes(struct scene_store *store)
{
	size_t bytes;

	pthread_rwlock_rdlock(&store->lock);
	bytes = store->table.bytes;
	pthread_rwlock_unlock(&store->lock);
	return bytes;
}

size_t scene_store_history_bytes(struct scene_store *store)
{
	size_t bytes;

	pthread_rwlock_rdlock(&store->lock);
	bytes = scene_table_past_bytes(&store->table);
	pthread_rwlock_unlock(&store->lock);
	return bytes;
}

struct scene *scene_store_find(struct scene_store *store, const char *id)
{
	struct scene *scene = NULL;
	const struct scene_slot *slot;

	pthread_rwlock_rdlock(&store->lock);
	slot = scene_table_find(&store->table, id);
	if (slot != NULL)
		scene = scene_hold(slot->scene);
	pthread_rwlock_unlock(&store->lock);
	return scene;
}

struct scene *scene_store_get(struct scene_store *store, const char *id)
{
	struct scene *scene = scene_store_find(store, id);

	if (scene == NULL || scene->program != NULL)
		return scene;
	scene_release(scene);
	return NULL;
}

size_t scene_store_list(struct scene_store *store, const char *after,
    size_t limit, struct scene **list, bool *more)
{
	size_t at, count = 0;
	bool there;

	pthread_rwlock_rdlock(&store->lock);
	at = scene_table_place(&store->table, after, &there);
	at += there ? 1 : 0;
	while (count < limit && at < store->table.count)
		list[count++] = scene_hold(store->table.slots[at++]->scene);
	*more = at < store->table.count;
	pthread_rwlock_unlock(&store->lock);
	return count;
}
