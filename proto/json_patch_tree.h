/*
 * Trees that a patch works on: bounded in values, depth and work. Internal to
 * proto/json_patch*.c.
 */
#ifndef PROTO_JSON_PATCH_TREE_H
#define PROTO_JSON_PATCH_TREE_H

#include <stdbool.h>
#include <stddef.h>

#include "core/err.h"

struct arena;
struct cJSON;
struct faults;
struct json_place;

/* Its arrays and objects hold how many children they have, in valueint. */
struct patch_tree {
	struct arena *arena;
	struct cJSON *root;
	size_t values, values_most;
	size_t steps;        /* that may yet be taken */
	struct cJSON *spare; /* values removed, to be used again, by next */
	enum {
		PATCH_IN_BOUNDS, PATCH_VALUES, PATCH_DEPTH, PATCH_STEPS
	} exceeded;          /* why ERR_LIMIT was returned */
};

/* Copies target to tree->root; tree's bounds and arena are set. ERR_LIMIT,
 * ERR_MEMORY. */
enum err patch_tree_begin(struct patch_tree *tree,
    const struct cJSON *target);

/* Adds to faults, at place, which bound ERR_LIMIT was about; returns err. */
enum err patch_tree_fault(const struct patch_tree *tree, enum err err,
    const struct json_place *place, struct faults *faults);

/* Takes so many steps. ERR_LIMIT. */
enum err patch_tree_step(struct patch_tree *tree, size_t count);

/* An empty object. ERR_LIMIT, ERR_MEMORY. */
enum err patch_tree_object(struct patch_tree *tree, struct cJSON **out);

/* A copy of value, without a name, to be put in at level: 0 is the root.
 * ERR_LIMIT, ERR_MEMORY. */
enum err patch_tree_copy(struct patch_tree *tree, const struct cJSON *value,
    size_t level, struct cJSON **out);

/* Whether value may stand at level. ERR_LIMIT. */
enum err patch_tree_fits(struct patch_tree *tree, const struct cJSON *value,
    size_t level);

/* Takes a value that is in no parent out of the count, for use again. */
void patch_tree_drop(struct patch_tree *tree, struct cJSON *value);

/* Puts value into parent before next; NULL: at its end. */
void patch_tree_insert(struct cJSON *parent, struct cJSON *next,
    struct cJSON *value);

/* Takes value out of parent. */
void patch_tree_detach(struct cJSON *parent, struct cJSON *value);

/* How many children an array or an object of the tree has. */
size_t patch_tree_count(const struct cJSON *parent);

/* The member of object (of any tree) of that name, or NULL; hint, if not NULL,
 * is looked at first. ERR_LIMIT. */
enum err patch_tree_member(struct patch_tree *tree,
    const struct cJSON *object, const char *name, struct cJSON *hint,
    struct cJSON **out);

/* The element of array, of the tree, at index < its count. ERR_LIMIT. */
enum err patch_tree_element(struct patch_tree *tree,
    const struct cJSON *array, size_t index, struct cJSON **out);

/* Whether two values of any trees are equal (RFC 6902, 4.6). ERR_LIMIT. */
enum err patch_tree_equal(struct patch_tree *tree, const struct cJSON *a,
    const struct cJSON *b, bool *out);

#endif
