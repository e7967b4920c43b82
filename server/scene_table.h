/*
 * Scenes by id, each with its present revision and what is known of its past.
 * No locks: whose table it is, guards it.
 */
#ifndef SERVER_SCENE_TABLE_H
#define SERVER_SCENE_TABLE_H

#include <stdbool.h>
#include <stddef.h>

#include "server/scene_store.h"

/* A revision that is past, or present: what histories tell of it. */
struct scene_past {
	char etag[ETAG_SIZE];
	bool is_first;
	bool has_gap;             /* some right before it may be unknown */
	struct scene_seq seq;
	double time;
	size_t nodes, length;
};

struct scene_slot {
	char id[SCENE_ID_MAX + 1];
	struct scene *scene;      /* one reference; NULL only while loading */
	struct scene_past *past;  /* by rising seq; the last is scene's */
	size_t past_count;
	size_t past_bytes;        /* their lengths, scene's too */
	struct scene_seq trimmed; /* of the newest revision no more in past; all
	                           * 0: none was ever trimmed */
};

struct scene_table {
	struct scene_slot **slots; /* sorted by id */
	size_t count, size;
	size_t bytes;              /* of the scenes' memory */
	size_t unusable;           /* scenes without a program */
	size_t history;            /* most of past, > 0 */
	size_t history_bytes;      /* most lengths of past but the last; 0: any */
};

/* Empties it. */
void scene_table_fini(struct scene_table *table);

/* Where id is, or would be. */
size_t scene_table_place(const struct scene_table *table, const char *id,
    bool *there);

/* NULL: none. */
struct scene_slot *scene_table_find(const struct scene_table *table,
    const char *id);

/* A slot for id, which may be there, without a scene if it is new. ERR_MEMORY. */
enum err scene_table_add(struct scene_table *table, const char *id,
    struct scene_slot **out);

/* One revision more of slot's past, at its place; the oldest are trimmed, but
 * never the last. What is there is left alone, but that it has no gap any more.
 * ERR_MEMORY. */
enum err scene_table_remember(struct scene_table *table,
    struct scene_slot *slot, const struct scene_past *past);

/* What was before seq is not kept any more. */
void scene_table_forget_before(struct scene_slot *slot, struct scene_seq seq);

/* Has slot's scene be that one, of which it takes a reference; what was is
 * released. */
void scene_table_set(struct scene_table *table, struct scene_slot *slot,
    struct scene *scene);

/* The lengths of all scenes' past, without what is present. */
size_t scene_table_past_bytes(const struct scene_table *table);

/* Ends the scene. */
void scene_table_remove(struct scene_table *table, const char *id);

/* scene's own. */
struct scene_past scene_table_past_of(const struct scene *scene,
    bool is_first);

#endif
