/*
 * The volumes that documents may name, in memory. Safe from any thread. Beside
 * the scenes they are kept on disk, which the scene store's writer does.
 *
 * A volume's id is made of its content, so the same upload is the same volume.
 * One that has been forgotten stays, out of sight of new documents, while
 * scenes use it; what is still in use counts in the memory that volumes take.
 *
 * A volume is the token's that has uploaded it first, until it has gone, or was
 * forgotten and somebody has uploaded it anew: then it is that one's. It counts
 * in its owner's bytes as long as it takes memory, also while it is forgotten and
 * scenes use it; who else uploads the same pays nothing.
 */
#ifndef SERVER_VOLUME_STORE_H
#define SERVER_VOLUME_STORE_H

#include <stdbool.h>
#include <stddef.h>

#include "core/err.h"
#include "core/vec3.h"
#include "server/access.h"

struct backing_volume;
struct grid;
struct volume;
struct volume_store;

#define VOLUME_ID_DIGITS 32

/* The most volumes, forgotten ones in use included. */
#define VOLUME_STORE_MAX 1024

/* What is told of a volume. */
struct volume_entry {
	char id[VOLUME_ID_DIGITS + 1];
	size_t count[3];
	struct vec3 min, max;
	bool is_distance;
	size_t bytes;        /* of memory */
	float least, most;   /* of its samples */
	double least_edge;   /* struct volume's */
	char owner[TOKEN_NAME_MAX + 1]; /* a token's name, or "" */
};

/* Who uploads a volume. */
struct volume_payer {
	const char *owner;   /* a token's name, or "" */
	size_t bytes_most;   /* of all that are that owner's; SIZE_MAX: any */
	bool is_owners;      /* set: it is these that ERR_LIMIT is about */
};

/* What alive volumes come to; count: but for those forgotten. */
struct volume_store_stats {
	size_t count, bytes;
};

/* For bytes_most bytes of volumes alive. */
enum err volume_store_create(size_t bytes_most, struct volume_store **out);

/* Gives up the volumes. NULL does nothing. */
void volume_store_free(struct volume_store *store);

/*
 * The volume of that grid, which is only read, over the box from min to max;
 * made unless it is there, which *is_new tells. It arrives: documents see it from
 * volume_store_settle on, which is to follow. ERR_LIMIT: too many bytes, or
 * volumes, or too many bytes of payer's; ERR_MEMORY.
 */
enum err volume_store_add(struct volume_store *store, const struct grid *grid,
    struct vec3 min, struct vec3 max, bool is_distance,
    struct volume_payer *payer, struct volume_entry *out, bool *is_new);

/*
 * One that arrives is kept, as owner's, and documents may name it; or, owner NULL,
 * it is not, and goes, unless it was there. In the order in which it was kept, and
 * not while volume_store_load tells of the same. Returns whether documents could
 * name it before.
 */
bool volume_store_settle(struct volume_store *store, const char *id,
    const char *owner);

/* The memory that a volume of that grid takes. */
size_t volume_store_need(const struct grid *grid);

/* ---- on disk ---- */

/* A volume's bytes as they are kept, malloc'd; and the samples in them.
 * ERR_MEMORY. */
enum err volume_store_encode(const struct grid *grid, struct vec3 min,
    struct vec3 max, bool is_distance, void **data, size_t *length);
float *volume_store_samples(void *data);

/*
 * Puts in what is kept, also beyond the bytes that there may be; one that is there
 * takes v's is_forgotten and owner. ERR_INVALID: it is not what its id says; ERR_LIMIT: too
 * many volumes; ERR_MEMORY.
 */
enum err volume_store_load(struct volume_store *store,
    const struct backing_volume *v);

/* While scenes are being read, or it is not known what uses a volume: forgotten
 * ones stay, used or not, until volume_store_take_gone is asked with who knows. */
void volume_store_hold_still(struct volume_store *store, bool is_still);

/* Takes ids of forgotten volumes that nothing uses any more, most at a time,
 * which are to be removed from where they are kept; and gives one back. stays
 * (or NULL: none) tells of a volume that it stays, though nothing holds it. */
size_t volume_store_take_gone(struct volume_store *store, size_t most,
    bool (*stays)(void *ctx, const char *id), void *ctx,
    char (*ids)[VOLUME_ID_DIGITS + 1]);
void volume_store_put_back_gone(struct volume_store *store, const char *id);

/* ---- asking ---- */

/* ERR_NOT_FOUND. */
enum err volume_store_get(struct volume_store *store, const char *id,
    struct volume_entry *out);
enum err volume_store_delete(struct volume_store *store, const char *id);

/* All, sorted by id, to *list, for free. ERR_MEMORY. */
enum err volume_store_list(struct volume_store *store,
    struct volume_entry **list, size_t *count);

void volume_store_get_stats(struct volume_store *store,
    struct volume_store_stats *out);

/* The memory that owner's volumes take. */
size_t volume_store_bytes_of(struct volume_store *store, const char *owner);

/* For documents (struct document_limits): the volume of that id, for
 * volume_release, or NULL. */
struct volume *volume_store_find(void *store, const char *id);

/* The same; also one that has been forgotten and is in use. */
struct volume *volume_store_recall(void *store, const char *id);

#endif
