#include "server/volume_store.h"

#include <assert.h>
#include <pthread.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include <nettle/sha2.h>

#include "core/volume.h"
#include "proto/grid_npy.h"
#include "server/backing.h"

struct stored {
	struct volume *volume; /* a reference */
	struct volume_entry entry;
	bool is_shown;         /* to new documents */
	unsigned arriving;     /* uploads of it that are not settled */
	/* Of one that arrives: whose it is unless it can be kept. */
	char before[TOKEN_NAME_MAX + 1];
};

/* Neither shown nor arriving: forgotten, and in use, when last looked at. */

struct volume_store {
	pthread_mutex_t lock; /* guards the rest, but bytes_most */
	struct stored list[VOLUME_STORE_MAX]; /* sorted by id */
	size_t count;
	size_t bytes;         /* of those in the list, and being made */
	size_t bytes_most;
	bool is_still;        /* forgotten ones stay */
	/* Forgotten ones that are no more in the list. */
	char gone[VOLUME_STORE_MAX][VOLUME_ID_DIGITS + 1];
	size_t gone_count;
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

	if (!there || !(store->list[at].is_shown || also_forgotten))
		return NULL;
	return store->list + at;
}

/* What does not fit is found again when volumes are loaded the next time. */
static void add_gone(struct volume_store *store, const char *id)
{
	if (store->gone_count < VOLUME_STORE_MAX)
		memcpy(store->gone[store->gone_count++], id,
		    VOLUME_ID_DIGITS + 1);
}

/*
 * Gives up forgotten volumes that nobody else holds. None can be held anew
 * meanwhile: a first reference comes from here, under the lock, and a further
 * one from somebody who has one.
 */
static void sweep_but(struct volume_store *store,
    bool (*stays)(void *ctx, const char *id), void *ctx)
{
	size_t kept = 0;

	for (size_t i = 0; i < store->count; i++) {
		struct stored *s = store->list + i;

		if (!s->is_shown && s->arriving == 0 &&
		    atomic_load(&s->volume->refs) == 1 &&
		    (stays == NULL || !stays(ctx, s->entry.id))) {
			store->bytes -= s->entry.bytes;
			add_gone(store, s->entry.id);
			volume_release(s->volume);
		} else {
			store->list[kept++] = *s;
		}
	}
	store->count = kept;
}

static void sweep(struct volume_store *store)
{
	if (!store->is_still)
		sweep_but(store, NULL, NULL);
}

static enum err insert(struct volume_store *store, struct volume *volume,
    const struct volume_entry *entry, struct stored **out)
{
	bool there;
	size_t at = place(store, entry->id, &there);

	if (store->count == VOLUME_STORE_MAX)
		return ERR_LIMIT;
	memmove(store->list + at + 1, store->list + at,
	    (store->count - at) * sizeof *store->list);
	*out = store->list + at;
	**out = (struct stored){.volume = volume, .entry = *entry};
	strcpy((*out)->before, entry->owner);
	store->count++;
	return ERR_OK;
}

/* ---- who pays ---- */

static size_t bytes_of(const struct volume_store *store, const char *owner)
{
	size_t bytes = 0;

	for (size_t i = 0; i < store->count; i++)
		if (strcmp(store->list[i].entry.owner, owner) == 0)
			bytes += store->list[i].entry.bytes;
	return bytes;
}

/* Whether payer may have so many bytes more. */
static enum err check_payer(const struct volume_store *store,
    struct volume_payer *payer, size_t bytes)
{
	size_t has;

	if (payer->bytes_most == SIZE_MAX)
		return ERR_OK;
	has = bytes_of(store, payer->owner);
	payer->is_owners = has > payer->bytes_most ||
	    bytes > payer->bytes_most - has;
	return payer->is_owners ? ERR_LIMIT : ERR_OK;
}

static void set_owner(struct volume_entry *entry, const char *owner)
{
	snprintf(entry->owner, sizeof entry->owner, "%s", owner);
}

/* Whether s, which was forgotten, or which somebody else brings as well, may be
 * payer's: that is known when one of them is kept. */
static enum err check_taking_over(const struct volume_store *store,
    const struct stored *s, struct volume_payer *payer)
{
	/* What is payer's own already is not to be paid twice. */
	const bool is_own = strcmp(s->entry.owner, payer->owner) == 0;

	return check_payer(store, payer, is_own ? 0 : s->entry.bytes);
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

/* s arrives once more: *entry is as it is. */
static enum err arrive_again(struct volume_store *store, struct stored *s,
    struct volume_payer *payer, struct volume_entry *entry, bool *is_new)
{
	enum err err = ERR_OK;

	if (!s->is_shown)
		err = check_taking_over(store, s, payer);
	if (err != ERR_OK)
		return err;
	if (s->arriving == 0) {
		strcpy(s->before, s->entry.owner);
		if (!s->is_shown)
			set_owner(&s->entry, payer->owner);
	}
	*is_new = !s->is_shown;
	s->arriving++;
	*entry = s->entry;
	return ERR_OK;
}

/*
 * Whether the volume of that id is there, also if it was forgotten; then it
 * arrives once more. Else memory for it is set aside.
 */
static enum err reserve(struct volume_store *store,
    struct volume_payer *payer, struct volume_entry *entry, bool *there,
    bool *is_new)
{
	struct stored *s;
	enum err err;

	pthread_mutex_lock(&store->lock);
	sweep(store);
	s = find(store, entry->id, true);
	*there = s != NULL;
	if (s != NULL)
		err = arrive_again(store, s, payer, entry, is_new);
	else if (store->count == VOLUME_STORE_MAX ||
	    entry->bytes > store->bytes_most ||
	    store->bytes > store->bytes_most - entry->bytes)
		err = ERR_LIMIT;
	else
		err = check_payer(store, payer, entry->bytes);
	if (s == NULL && err == ERR_OK)
		store->bytes += entry->bytes;
	pthread_mutex_unlock(&store->lock);
	return err;
}

/* Puts volume, of which it takes the reference, where memory was set aside;
 * or finds that somebody else has done the same meanwhile, or that payer has got
 * others since. payer NULL: whoever it is may. */
static enum err put(struct volume_store *store, struct volume *volume,
    struct volume_payer *payer, struct volume_entry *entry, bool *is_new)
{
	const size_t bytes = entry->bytes;
	struct stored *s;
	enum err err = ERR_OK;
	bool was_there;

	pthread_mutex_lock(&store->lock);
	s = find(store, entry->id, true);
	was_there = s != NULL;
	if (!was_there && payer != NULL)
		err = check_payer(store, payer, bytes);
	else if (payer != NULL && !s->is_shown)
		err = check_taking_over(store, s, payer);
	if (!was_there && err == ERR_OK)
		err = insert(store, volume, entry, &s);
	if (err == ERR_OK) {
		*is_new = !s->is_shown;
		if (was_there && s->arriving == 0)
			strcpy(s->before, s->entry.owner);
		s->arriving++;
		set_owner(entry, s->entry.owner);
	}
	if (was_there || err != ERR_OK) {
		store->bytes -= bytes;
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
    struct volume_payer *payer, struct volume_entry *out, bool *is_new)
{
	struct volume_entry entry = {.min = min, .max = max,
		.is_distance = is_distance, .bytes = volume_store_need(grid)};
	struct volume *volume;
	bool there;
	enum err err;

	memcpy(entry.count, grid->count, sizeof entry.count);
	make_id(grid, &entry);
	find_extent(grid, &entry);
	set_owner(&entry, payer->owner);
	payer->is_owners = false;
	err = reserve(store, payer, &entry, &there, is_new);
	if (err == ERR_OK && !there) {
		err = volume_create(grid->samples, grid->count, min, max,
		    is_distance, &volume);
		if (err == ERR_OK) {
			entry.least_edge = volume->least_edge;
			err = put(store, volume, payer, &entry, is_new);
		} else {
			give_back(store, entry.bytes);
		}
	}
	if (err == ERR_OK)
		*out = entry;
	return err;
}

bool volume_store_settle(struct volume_store *store, const char *id,
    const char *owner)
{
	struct stored *s;
	bool was_shown = false;

	pthread_mutex_lock(&store->lock);
	s = find(store, id, true);
	if (s != NULL) {
		was_shown = s->is_shown;
		s->arriving--;
		if (owner != NULL) {
			s->is_shown = true;
			set_owner(&s->entry, owner);
			strcpy(s->before, s->entry.owner);
		}
		/* It could not be kept: it is whose it was. */
		if (!s->is_shown && s->arriving == 0)
			set_owner(&s->entry, s->before);
		sweep(store);
	}
	pthread_mutex_unlock(&store->lock);
	return was_shown;
}

/* ---- keeping ---- */

/* What is kept: a head, then the samples, 32 bits each, little-endian. */
#define HEAD_SIZE 128

static const char magic[8] = "BFVOLUM1";

struct head {
	char magic[8];
	uint64_t is_distance;
	uint64_t count[3];
	double min[3], max[3];
};

static_assert(sizeof(struct head) <= HEAD_SIZE, "the head fits");

enum err volume_store_encode(const struct grid *grid, struct vec3 min,
    struct vec3 max, bool is_distance, void **data, size_t *length)
{
	size_t size = grid->count[0] * grid->count[1] * grid->count[2] *
	    sizeof *grid->samples;
	struct head head = {.is_distance = is_distance,
	    .min = {min.x, min.y, min.z}, .max = {max.x, max.y, max.z}};
	char *out = malloc(HEAD_SIZE + size);

	if (out == NULL)
		return ERR_MEMORY;
	memcpy(head.magic, magic, sizeof magic);
	for (int i = 0; i < 3; i++)
		head.count[i] = grid->count[i];
	memset(out, 0, HEAD_SIZE);
	memcpy(out, &head, sizeof head);
	memcpy(out + HEAD_SIZE, grid->samples, size);
	*data = out;
	*length = HEAD_SIZE + size;
	return ERR_OK;
}

float *volume_store_samples(void *data)
{
	return (float *)(void *)((char *)data + HEAD_SIZE);
}

static bool read_head(const struct backing_volume *v, struct head *head)
{
	uint64_t total = 1;

	if (v->length < HEAD_SIZE)
		return false;
	memcpy(head, v->data, sizeof *head);
	if (memcmp(head->magic, magic, sizeof magic) != 0)
		return false;
	for (int i = 0; i < 3; i++) {
		if (head->count[i] < VOLUME_AXIS_MIN ||
		    head->count[i] > VOLUME_AXIS_MAX)
			return false;
		total *= head->count[i];
	}
	return total <= VOLUME_SAMPLES_MAX &&
	    v->length == HEAD_SIZE + total * sizeof(float);
}

/* v's grid; its samples are a copy if they are not where floats may be. */
static enum err read_grid(const struct backing_volume *v,
    const struct head *head, struct grid *out, float **copy)
{
	const char *samples = (const char *)v->data + HEAD_SIZE;

	*copy = NULL;
	for (int i = 0; i < 3; i++)
		out->count[i] = (size_t)head->count[i];
	if ((uintptr_t)samples % sizeof(float) == 0) {
		out->samples = (float *)(void *)(uintptr_t)samples;
		return ERR_OK;
	}
	*copy = malloc(v->length - HEAD_SIZE);
	if (*copy == NULL)
		return ERR_MEMORY;
	memcpy(*copy, samples, v->length - HEAD_SIZE);
	out->samples = *copy;
	return ERR_OK;
}

/* Whether it is there; then it is as v says. */
static bool mark(struct volume_store *store, const struct backing_volume *v)
{
	struct stored *s;

	pthread_mutex_lock(&store->lock);
	s = find(store, v->id, true);
	if (s != NULL)
		s->is_shown = !v->is_forgotten;
	if (s != NULL && v->owner != NULL) {
		snprintf(s->before, sizeof s->before, "%s", v->owner);
		/* Who brings it pays until that is settled. */
		if (s->is_shown || s->arriving == 0)
			set_owner(&s->entry, v->owner);
	}
	pthread_mutex_unlock(&store->lock);
	return s != NULL;
}

/* Also beyond the bytes that there may be: it is kept, and was within. */
static enum err load_grid(struct volume_store *store,
    const struct backing_volume *v, const struct grid *grid,
    const struct head *head)
{
	struct volume_entry entry = {.is_distance = head->is_distance != 0,
	    .min = vec3(head->min[0], head->min[1], head->min[2]),
	    .max = vec3(head->max[0], head->max[1], head->max[2]),
	    .bytes = volume_store_need(grid)};
	struct volume *volume;
	struct stored *s;
	bool is_new;
	enum err err;

	memcpy(entry.count, grid->count, sizeof entry.count);
	make_id(grid, &entry);
	if (strcmp(entry.id, v->id) != 0)
		return ERR_INVALID;
	find_extent(grid, &entry);
	set_owner(&entry, v->owner != NULL ? v->owner : "");
	err = volume_create(grid->samples, grid->count, entry.min, entry.max,
	    entry.is_distance, &volume);
	if (err != ERR_OK)
		return err;
	entry.least_edge = volume->least_edge;
	pthread_mutex_lock(&store->lock);
	store->bytes += entry.bytes;
	pthread_mutex_unlock(&store->lock);
	err = put(store, volume, NULL, &entry, &is_new);
	if (err != ERR_OK)
		return err;
	pthread_mutex_lock(&store->lock);
	s = find(store, v->id, true);
	s->arriving--;
	s->is_shown = !v->is_forgotten;
	pthread_mutex_unlock(&store->lock);
	return ERR_OK;
}

enum err volume_store_load(struct volume_store *store,
    const struct backing_volume *v)
{
	struct grid grid;
	struct head head;
	float *copy;
	enum err err;

	if (mark(store, v) || v->data == NULL)
		return ERR_OK;
	if (!read_head(v, &head))
		return ERR_INVALID;
	err = read_grid(v, &head, &grid, &copy);
	if (err == ERR_OK)
		err = load_grid(store, v, &grid, &head);
	free(copy);
	return err;
}

void volume_store_hold_still(struct volume_store *store, bool is_still)
{
	pthread_mutex_lock(&store->lock);
	store->is_still = is_still;
	pthread_mutex_unlock(&store->lock);
}

size_t volume_store_take_gone(struct volume_store *store, size_t most,
    bool (*stays)(void *ctx, const char *id), void *ctx,
    char (*ids)[VOLUME_ID_DIGITS + 1])
{
	size_t count = 0;

	pthread_mutex_lock(&store->lock);
	sweep_but(store, stays, ctx);
	for (size_t i = store->gone_count; i-- > 0 && count < most;) {
		char *id = store->gone[i];

		if (stays != NULL && stays(ctx, id))
			continue;
		if (find(store, id, true) == NULL)
			memcpy(ids[count++], id, VOLUME_ID_DIGITS + 1);
		memmove(id, store->gone[--store->gone_count],
		    VOLUME_ID_DIGITS + 1);
	}
	pthread_mutex_unlock(&store->lock);
	return count;
}

void volume_store_put_back_gone(struct volume_store *store, const char *id)
{
	pthread_mutex_lock(&store->lock);
	add_gone(store, id);
	pthread_mutex_unlock(&store->lock);
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
		s->is_shown = false;
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
		if (store->list[i].is_shown)
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
		out->count += store->list[i].is_shown;
	out->bytes = store->bytes;
	pthread_mutex_unlock(&store->lock);
}

size_t volume_store_bytes_of(struct volume_store *store, const char *owner)
{
	size_t bytes;

	pthread_mutex_lock(&store->lock);
	sweep(store);
	bytes = bytes_of(store, owner);
	pthread_mutex_unlock(&store->lock);
	return bytes;
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
