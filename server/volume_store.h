/*
 * The volumes that documents may name, in memory. Safe from any thread.
 *
 * A volume's id is made of its content, so the same upload is the same volume.
 * One that has been forgotten stays, out of sight of new documents, while
 * scenes use it; what is still in use counts in the memory that volumes take.
 */
#ifndef SERVER_VOLUME_STORE_H
#define SERVER_VOLUME_STORE_H

#include <stdbool.h>
#include <stddef.h>

#include "core/err.h"
#include "core/vec3.h"

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
 * made unless it is there, which *is_new tells. ERR_LIMIT: too many bytes, or
 * volumes; ERR_MEMORY.
 */
enum err volume_store_add(struct volume_store *store, const struct grid *grid,
    struct vec3 min, struct vec3 max, bool is_distance,
    struct volume_entry *out, bool *is_new);

/* The memory that a volume of that grid takes. */
size_t volume_store_need(const struct grid *grid);

/* ERR_NOT_FOUND. */
enum err volume_store_get(struct volume_store *store, const char *id,
    struct volume_entry *out);
enum err volume_store_delete(struct volume_store *store, const char *id);

/* All, sorted by id, to *list, for free. ERR_MEMORY. */
enum err volume_store_list(struct volume_store *store,
    struct volume_entry **list, size_t *count);

void volume_store_get_stats(struct volume_store *store,
    struct volume_store_stats *out);

/* For documents (struct document_limits): the volume of that id, for
 * volume_release, or NULL. */
struct volume *volume_store_find(void *store, const char *id);

/* The same; also one that has been forgotten and is in use. */
struct volume *volume_store_recall(void *store, const char *id);

#endif
