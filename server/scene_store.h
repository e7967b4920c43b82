/*
 * The scenes kept, in memory. Safe from any thread.
 *
 * A struct scene is one revision: immutable, reference counted. Replacing or
 * deleting a scene leaves revisions alone that somebody holds.
 */
#ifndef SERVER_SCENE_STORE_H
#define SERVER_SCENE_STORE_H

#include <stdatomic.h>
#include <stdbool.h>
#include <stddef.h>

#include "core/err.h"
#include "server/etag.h"

#define SCENE_ID_MAX 64

struct program;
struct scene_store;
struct scheduler;

struct scene {
	atomic_size_t refs;
	struct scheduler *scheduler;
	char id[SCENE_ID_MAX + 1];
	char etag[ETAG_SIZE];
	char *name;
	char *text;              /* the document's bytes, as they came */
	size_t length;
	size_t nodes;
	size_t bytes;            /* of memory: text and tape */
	struct program *program; /* one reference */
};

/*
 * A revision of one reference, for scene_release. Copies id, name and text; takes
 * the reference to program over, also on failure. ERR_MEMORY.
 */
enum err scene_create(struct scheduler *scheduler, const char *id,
    const char *name, const char *text, size_t length,
    struct program *program, struct scene **out);

/* Gives up a reference; any thread. */
void scene_release(struct scene *scene);

/* [A-Za-z0-9_.-]{1,64}, but neither "." nor "..", which URLs lose. */
bool scene_id_is_valid(const char *id);

/* An id that nobody guesses. ERR_IO. */
enum err scene_id_random(char out[static SCENE_ID_MAX + 1]);

/* Of max_scenes at most, which take max_bytes of memory at most. */
enum err scene_store_create(size_t max_scenes, size_t max_bytes,
    struct scene_store **out);

/* Releases every scene. NULL does nothing. */
void scene_store_free(struct scene_store *store);

size_t scene_store_count(struct scene_store *store);

/* The memory that the scenes kept take. */
size_t scene_store_bytes(struct scene_store *store);

/* The scene's present revision, for scene_release; NULL if there is none. */
struct scene *scene_store_get(struct scene_store *store, const char *id);

/*
 * Makes scene (of which it takes one reference more) the revision under its
 * id; *replaced tells whether there was one. ERR_CONFLICT: precondition fails;
 * ERR_LIMIT: too many scenes, or too many bytes of them; ERR_MEMORY.
 */
enum err scene_store_put(struct scene_store *store, struct scene *scene,
    const struct precondition *precondition, bool *replaced);

/* ERR_NOT_FOUND, ERR_CONFLICT. */
enum err scene_store_delete(struct scene_store *store, const char *id,
    const struct precondition *precondition);

/*
 * Up to limit scenes whose ids sort after after ("": from the first), in
 * order, each for scene_release, to list. Returns how many; *more tells
 * whether others follow.
 */
size_t scene_store_list(struct scene_store *store, const char *after,
    size_t limit, struct scene **list, bool *more);

#endif
