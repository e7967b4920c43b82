#include "server/scene_store.h"

#include <pthread.h>
#include <stdint.h>
#include <stdlib.h>
#include <string.h>
#include <sys/random.h>

#include "core/tape.h"
#include "server/program.h"
#include "server/scheduler.h"

struct scene_store {
	pthread_rwlock_t lock;  /* guards the rest */
	struct scene **scenes;  /* sorted by id */
	size_t count, size, most;
	size_t bytes, bytes_most;
};

/* ---- revisions ---- */

static void scene_free(struct scene *scene)
{
	if (scene->program != NULL)
		scheduler_release(scene->scheduler, scene->program);
	free(scene->name);
	free(scene->text);
	free(scene);
}

static size_t tape_bytes(const struct tape *tape)
{
	return sizeof *tape + tape->insn_count *
	    (sizeof *tape->insns + sizeof *tape->boxes) +
	    tape->param_count * sizeof *tape->params +
	    tape->operator_count * sizeof *tape->operators;
}

enum err scene_create(struct scheduler *scheduler, const char *id,
    const char *name, const char *text, size_t length,
    struct program *program, struct scene **out)
{
	struct scene *scene = calloc(1, sizeof *scene);

	if (scene == NULL) {
		scheduler_release(scheduler, program);
		return ERR_MEMORY;
	}
	atomic_init(&scene->refs, 1);
	scene->scheduler = scheduler;
	scene->program = program;
	strncpy(scene->id, id, SCENE_ID_MAX);
	scene->name = strdup(name);
	scene->text = malloc(length + 1);
	if (scene->name == NULL || scene->text == NULL) {
		scene_free(scene);
		return ERR_MEMORY;
	}
	memcpy(scene->text, text, length);
	scene->length = length;
	scene->bytes = sizeof *scene + length + tape_bytes(program->tape);
	etag_of(text, length, scene->etag);
	*out = scene;
	return ERR_OK;
}

static struct scene *hold(struct scene *scene)
{
	atomic_fetch_add(&scene->refs, 1);
	return scene;
}

void scene_release(struct scene *scene)
{
	if (atomic_fetch_sub(&scene->refs, 1) == 1)
		scene_free(scene);
}

bool scene_id_is_valid(const char *id)
{
	static const char letters[] = "ABCDEFGHIJKLMNOPQRSTUVWXYZ"
	    "abcdefghijklmnopqrstuvwxyz0123456789_.-";
	size_t length = strlen(id);

	return length >= 1 && length <= SCENE_ID_MAX &&
	    strspn(id, letters) == length && strcmp(id, ".") != 0 &&
	    strcmp(id, "..") != 0;
}

enum err scene_id_random(char out[static SCENE_ID_MAX + 1])
{
	static const char digits[] = "0123456789abcdefghijklmnopqrstuv";
	uint8_t bytes[26]; /* 26 digits of 5 bits: 130 bits */

	if (getrandom(bytes, sizeof bytes, 0) != sizeof bytes)
		return ERR_IO;
	for (size_t i = 0; i < sizeof bytes; i++)
		out[i] = digits[bytes[i] & 31];
	out[sizeof bytes] = '\0';
	return ERR_OK;
}

/* ---- the store ---- */

enum err scene_store_create(size_t max_scenes, size_t max_bytes,
    struct scene_store **out)
{
	struct scene_store *store = calloc(1, sizeof *store);

	if (store == NULL)
		return ERR_MEMORY;
	store->most = max_scenes;
	store->bytes_most = max_bytes;
	pthread_rwlock_init(&store->lock, NULL);
	*out = store;
	return ERR_OK;
}

void scene_store_free(struct scene_store *store)
{
	if (store == NULL)
		return;
	for (size_t i = 0; i < store->count; i++)
		scene_release(store->scenes[i]);
	free(store->scenes);
	pthread_rwlock_destroy(&store->lock);
	free(store);
}

/* Where id is, or would be. */
static size_t find(const struct scene_store *store, const char *id,
    bool *there)
{
	size_t low = 0, high = store->count;

	while (low < high) {
		size_t middle = low + (high - low) / 2;

		if (strcmp(store->scenes[middle]->id, id) < 0)
			low = middle + 1;
		else
			high = middle;
	}
	*there = low < store->count &&
	    strcmp(store->scenes[low]->id, id) == 0;
	return low;
}

size_t scene_store_count(struct scene_store *store)
{
	size_t count;

	pthread_rwlock_rdlock(&store->lock);
	count = store->count;
	pthread_rwlock_unlock(&store->lock);
	return count;
}

size_t scene_store_bytes(struct scene_store *store)
{
	size_t bytes;

	pthread_rwlock_rdlock(&store->lock);
	bytes = store->bytes;
	pthread_rwlock_unlock(&store->lock);
	return bytes;
}

struct scene *scene_store_get(struct scene_store *store, const char *id)
{
	struct scene *scene = NULL;
	bool there;
	size_t at;

	pthread_rwlock_rdlock(&store->lock);
	at = find(store, id, &there);
	if (there)
		scene = hold(store->scenes[at]);
	pthread_rwlock_unlock(&store->lock);
	return scene;
}

static bool fulfilled(const struct precondition *precondition,
    const char *etag)
{
	return precondition_match(precondition, etag) &&
	    precondition_none_match(precondition, etag);
}

/* Whether scene fits in, old (NULL: none) gone. Locked. */
static bool fits(const struct scene_store *store, const struct scene *scene,
    const struct scene *old)
{
	size_t others = store->bytes - (old != NULL ? old->bytes : 0);

	return scene->bytes <= store->bytes_most &&
	    others <= store->bytes_most - scene->bytes;
}

/* Puts one more scene in at index at. Locked. */
static enum err insert(struct scene_store *store, size_t at,
    struct scene *scene)
{
	if (store->count >= store->most)
		return ERR_LIMIT;
	if (store->count == store->size) {
		size_t size = store->size > 0 ? 2 * store->size : 16;
		struct scene **scenes = realloc(store->scenes,
		    size * sizeof *scenes);

		if (scenes == NULL)
			return ERR_MEMORY;
		store->scenes = scenes;
		store->size = size;
	}
	memmove(store->scenes + at + 1, store->scenes + at,
	    (store->count - at) * sizeof *store->scenes);
	store->scenes[at] = scene;
	store->count++;
	return ERR_OK;
}

enum err scene_store_put(struct scene_store *store, struct scene *scene,
    const struct precondition *precondition, bool *replaced)
{
	struct scene *old = NULL;
	enum err err = ERR_OK;
	bool there;
	size_t at;

	pthread_rwlock_wrlock(&store->lock);
	at = find(store, scene->id, &there);
	if (!fulfilled(precondition, there ? store->scenes[at]->etag : NULL)) {
		err = ERR_CONFLICT;
	} else if (!fits(store, scene, there ? store->scenes[at] : NULL)) {
		err = ERR_LIMIT;
	} else if (there) {
		old = store->scenes[at];
		store->bytes -= old->bytes;
		store->scenes[at] = scene;
	} else {
		err = insert(store, at, scene);
	}
	if (err == ERR_OK) {
		store->bytes += scene->bytes;
		hold(scene);
	}
	pthread_rwlock_unlock(&store->lock);
	if (old != NULL)
		scene_release(old);
	if (err == ERR_OK)
		*replaced = there;
	return err;
}

enum err scene_store_delete(struct scene_store *store, const char *id,
    const struct precondition *precondition)
{
	struct scene *old = NULL;
	enum err err = ERR_OK;
	bool there;
	size_t at;

	pthread_rwlock_wrlock(&store->lock);
	at = find(store, id, &there);
	if (!there) {
		err = ERR_NOT_FOUND;
	} else if (!fulfilled(precondition, store->scenes[at]->etag)) {
		err = ERR_CONFLICT;
	} else {
		old = store->scenes[at];
		store->bytes -= old->bytes;
		memmove(store->scenes + at, store->scenes + at + 1,
		    (--store->count - at) * sizeof *store->scenes);
	}
	pthread_rwlock_unlock(&store->lock);
	if (old != NULL)
		scene_release(old);
	return err;
}

size_t scene_store_list(struct scene_store *store, const char *after,
    size_t limit, struct scene **list, bool *more)
{
	size_t at, count = 0;
	bool there;

	pthread_rwlock_rdlock(&store->lock);
	at = find(store, after, &there);
	at += there ? 1 : 0;
	while (count < limit && at < store->count)
		list[count++] = hold(store->scenes[at++]);
	*more = at < store->count;
	pthread_rwlock_unlock(&store->lock);
	return count;
}
