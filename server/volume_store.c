#include "server/volume_store.h"

#include <pthread.h>
#include <stdint.h>
#include <stdlib.h>
#include <string.h>

#include <nettle/sha2.h>

#include "core/volume.h"
#include "proto/grid_npy.h"

struct stored {
	struct volume *volume; /* a reference */
	struct volume_entry entry;
	bool is_forgotten;     /* and in use, when last looked at */
};

struct volume_store {
	pthread_mutex_t lock; /* guards the rest, but bytes_most */
	struct stored list[VOLUME_STORE_MAX]; /* sorted by id */
	size_t count;
	size_t bytes;         /* of those in the list, and being made */
	size_t bytes_most;
};

enum err volume_store_create(size_t bytes_most, struct volume_store **out)
{
	struct volume_store *store = calloc(1, sizeof *store);

	if (store == NULL)
		return ERR_MEMORY;
	store->bytes_most = bytes_most;
	pthread_mutex_init(&store->lock, NULL);
	*out = store;
	return ERR_OK;
}

void volume_store_free(struct volume_store *store)
{
	if (store == NULL)
		return;
	for (size_t i = 0; i < store->count; i++)
		volume_release(store->list[i].volume);
	pthread_mutex_destroy(&store->lock);
	free(store);
}

/* ---- the list, locked ---- */

/* Where id is, or would be. */
static size_t place(const struct volume_store *store, const char *id,
    bool *there)
{
	size_t low = 0, high = store->count;

	while (low < high) {
		size_t middle = low + (high - low) / 2;

		if (strcmp(store->list[middle].entry.id, id) < 0)
			low = middle + 1;
		else
			high = middle;
	}
	*there = low < store->count &&
	    strcmp(store->list[low].entry.id, id) == 0;
	return low;
}

static struct stored *find(struct volume_store *store, const char *id,
    bool also_forgotten)
{
	bool there;
	size_t at = place(store, id, &there);

	if (!there || (store->list[at].is_forgotten && !also_forgotten))
		return NULL;
	return store->list + at;
}

/*
 * Gives up forgotten volumes that nobody else holds. None can be held anew
 * meanwhile: a first reference comes from here, under the lock, and a further
 * one from somebody who has one.
 */
static void sweep(struct volume_store *store)
{
	size_t kept = 0;

	for (size_t i = 0; i < store->count; i++) {
		struct stored *s = store->list + i;

		if (s->is_forgotten && atomic_load(&s->volume->refs) == 1) {
			store->bytes -= s->entry.bytes;
			volume_release(s->volume);
		} else {
			store->list[kept++] = *s;
		}
	}
	store->count = kept;
}

static enum err insert(struct volume_store *store, struct volume *volume,
    const struct volume_entry *entry)
{
	bool there;
	size_t at = place(store, entry->id, &there);

	if (store->count == VOLUME_STORE_MAX)
		return ERR_LIMIT;
	memmove(store->list + at + 1, store->list + at,
	    (store->count - at) * sizeof *store->list);
	store->list[at] = (struct stored){volume, *entry, false};
	store->count++;
	return ERR_OK;
}

/* ---- adding ---- */

static void put_u64(struct sha256_ctx *sha, uint64_t value)
{
	uint8_t bytes[8];

	for (int i = 0; i < 8; i++)
		bytes[i] = (uint8_t)(value >> 8 * i);
	sha256_update(sha, sizeof bytes, bytes);
}

static void put_double(struct sha256_ctx *sha, double value)
{
	uint64_t bits;

	memcpy(&bits, &value, sizeof bits);
	put_u64(sha, bits);
}

static void put_point(struct sha256_ctx *sha, struct vec3 p)
{
	/* -0 is 0 */
	put_double(sha, p.x + 0.0);
	put_double(sha, p.y + 0.0);
	put_double(sha, p.z + 0.0);
}

/* The first half of the SHA-256 of kind, shape, box and samples. */
static void make_id(const struct grid *grid, struct volume_entry *entry)
{
	static const char hex[] = "0123456789abcdef";
	uint8_t digest[VOLUME_ID_DIGITS / 2];
	struct sha256_ctx sha;
	size_t total = 1;

	sha256_init(&sha);
	put_u64(&sha, entry->is_distance);
	for (int i = 0; i < 3; i++) {
		put_u64(&sha, grid->count[i]);
		total *= grid->count[i];
	}
	put_point(&sha, entry->min);
	put_point(&sha, entry->max);
	sha256_update(&sha, total * sizeof *grid->samples,
	    (const uint8_t *)grid->samples);
	sha256_digest(&sha, sizeof digest, digest);
	for (size_t i = 0; i < sizeof digest; i++) {
		entry->id[2 * i] = hex[digest[i] >> 4];
		entry->id[2 * i + 1] = hex[digest[i] & 15];
	}
}

static void find_extent(const struct grid *grid, struct volume_entry *entry)
{
	size_t total = grid->count[0] * grid->count[1] * grid->count[2];

	entry->least = entry->most = grid->samples[0];
	for (size_t i = 1; i < total; i++) {
		float s = grid->samples[i];

		entry->least = s < entry->least ? s : entry->least;
		entry->most = s > entry->most ? s : entry->most;
	}
}

size_t volume_store_need(const struct grid *grid)
{
	return sizeof(struct volume) + grid->count[0] * grid->count[1] *
	    grid->count[2] * sizeof(float);
}

/*
 * Whether the volume of that id is there, also if it was forgotten, then as if
 * it were new. Else memory for it is set aside.
 */
static enum err reserve(struct volume_store *store,
    struct volume_entry *entry, bool *there, bool *is_new)
{
	struct stored *s;
	enum err err = ERR_OK;

	pthread_mutex_lock(&store->lock);
	sweep(store);
	s = find(store, entry->id, true);
	*there = s != NULL;
	if (s != NULL) {
		*is_new = s->is_forgotten;
		s->is_forgotten = false;
		*entry = s->entry;
	} else if (store->count == VOLUME_STORE_MAX ||
	    entry->bytes > store->bytes_most ||
	    store->bytes > store->bytes_most - entry->bytes) {
		err = ERR_LIMIT;
	} else {
		store->bytes += entry->bytes;
	}
	pthread_mutex_unlock(&store->lock);
	return err;
}

/* Puts volume, of which it takes the reference, where memory was set aside;
 * or finds that somebody else has done the same meanwhile. */
static enum err put(struct volume_store *store, struct volume *volume,
    const struct volume_entry *entry, bool *is_new)
{
	struct stored *s;
	enum err err = ERR_OK;

	pthread_mutex_lock(&store->lock);
	s = find(store, entry->id, true);
	if (s == NULL)
		err = insert(store, volume, entry);
	*is_new = s == NULL || s->is_forgotten;
	if (s != NULL)
		s->is_forgotten = false;
	if (s != NULL || err != ERR_OK) {
		store->bytes -= entry->bytes;
		volume_release(volume);
	}
	pthread_mutex_unlock(&store->lock);
	return err;
}

static void give_back(struct volume_store *store, size_t bytes)
{
	pthread_mutex_lock(&store->lock);
	store->bytes -= bytes;
	pthread_mutex_unlock(&store->lock);
}

enum err volume_store_add(struct volume_store *store, const struct grid *grid,
    struct vec3 min, struct vec3 max, bool is_distance,
    struct volume_entry *out, bool *is_new)
{
	struct volume_entry entry = {.min = min, .max = max,
		.is_distance = is_distance, .bytes = volume_store_need(grid)};
	struct volume *volume;
	bool there;
	enum err err;

	memcpy(entry.count, grid->count, sizeof entry.count);
	make_id(grid, &entry);
	find_extent(grid, &entry);
	err = reserve(store, &entry, &there, is_new);
	if (err == ERR_OK && !there) {
		err = volume_create(grid->samples, grid->count, min, max,
		    is_distance, &volume);
		if (err == ERR_OK) {
			entry.least_edge = volume->least_edge;
			err = put(store, volume, &entry, is_new);
		} else {
			give_back(store, entry.bytes);
		}
	}
	if (err == ERR_OK)
		*out = entry;
	return err;
}

/* ---- asking ---- */

enum err volume_store_get(struct volume_store *store, const char *id,
    struct volume_entry *out)
{
	struct stored *s;

	pthread_mutex_lock(&store->lock);
	s = find(store, id, false);
	if (s != NULL)
		*out = s->entry;
	pthread_mutex_unlock(&store->lock);
	return s != NULL ? ERR_OK : ERR_NOT_FOUND;
}

enum err volume_store_delete(struct volume_store *store, const char *id)
{
	struct stored *s;

	pthread_mutex_lock(&store->lock);
	s = find(store, id, false);
	if (s != NULL) {
		s->is_forgotten = true;
		sweep(store);
	}
	pthread_mutex_unlock(&store->lock);
	return s != NULL ? ERR_OK : ERR_NOT_FOUND;
}

enum err volume_store_list(struct volume_store *store,
    struct volume_entry **list, size_t *count)
{
	struct volume_entry *entries;
	size_t n = 0;

	pthread_mutex_lock(&store->lock);
	sweep(store);
	entries = malloc((store->count + 1) * sizeof *entries);
	for (size_t i = 0; entries != NULL && i < store->count; i++)
		if (!store->list[i].is_forgotten)
			entries[n++] = store->list[i].entry;
	pthread_mutex_unlock(&store->lock);
	if (entries == NULL)
		return ERR_MEMORY;
	*list = entries;
	*count = n;
	return ERR_OK;
}

void volume_store_get_stats(struct volume_store *store,
    struct volume_store_stats *out)
{
	*out = (struct volume_store_stats){0};
	pthread_mutex_lock(&store->lock);
	sweep(store);
	for (size_t i = 0; i < store->count; i++)
		out->count += !store->list[i].is_forgotten;
	out->bytes = store->bytes;
	pthread_mutex_unlock(&store->lock);
}

static struct volume *hold(struct volume_store *store, const char *id,
    bool also_forgotten)
{
	struct volume *volume = NULL;
	struct stored *s;

	pthread_mutex_lock(&store->lock);
	s = find(store, id, also_forgotten);
	if (s != NULL)
		volume = volume_hold(s->volume);
	pthread_mutex_unlock(&store->lock);
	return volume;
}

struct volume *volume_store_find(void *store, const char *id)
{
	return hold(store, id, false);
}

struct volume *volume_store_recall(void *store, const char *id)
{
	return hold(store, id, true);
}
