#include "proto/json_patch_tree.h"

#include <math.h>
#include <string.h>

#include <cjson/cJSON.h>

#include "proto/arena.h"
#include "proto/json.h"
#include "proto/json_patch.h"
#include "proto/text.h"

/* What a copied value costs: it is written, where others are looked at. */
#define COPY_STEPS 4

/* Bytes of a name or a string that are compared in one step. */
#define BYTES_PER_STEP 64

static int kind(const cJSON *value)
{
	return value->type & 0xff;
}

/* ---- bounds ---- */

enum err patch_tree_fault(const struct patch_tree *tree, enum err err,
    const struct json_place *place, struct faults *faults)
{
	if (err != ERR_LIMIT)
		return err;
	if (tree->exceeded == PATCH_VALUES)
		json_fault(faults, place, "there would be more than %zu JSON "
		    "values", tree->values_most);
	else if (tree->exceeded == PATCH_DEPTH)
		json_fault(faults, place, "there would be values nested more "
		    "than %d deep", JSON_DEPTH_MAX);
	else
		json_fault(faults, place, "up to here the patch takes more "
		    "than %zu steps: send it in parts", JSON_PATCH_STEPS_MAX);
	return err;
}

enum err patch_tree_step(struct patch_tree *tree, size_t count)
{
	if (tree->steps < count) {
		tree->exceeded = PATCH_STEPS;
		return ERR_LIMIT;
	}
	tree->steps -= count;
	return ERR_OK;
}

enum err patch_tree_fits(struct patch_tree *tree, const struct cJSON *value,
    size_t level)
{
	enum err err = patch_tree_step(tree, 1);

	if (!err && level >= JSON_DEPTH_MAX) {
		tree->exceeded = PATCH_DEPTH;
		err = ERR_LIMIT;
	}
	for (value = value->child; !err && value; value = value->next)
		err = patch_tree_fits(tree, value, level + 1);
	return err;
}

/* ---- making and dropping ---- */

static enum err new_value(struct patch_tree *tree, cJSON **out)
{
	enum err err = patch_tree_step(tree, COPY_STEPS);
	cJSON *value = tree->spare;

	if (err)
		return err;
	if (tree->values >= tree->values_most) {
		tree->exceeded = PATCH_VALUES;
		return ERR_LIMIT;
	}
	if (value) {
		tree->spare = value->next;
		memset(value, 0, sizeof *value);
	} else {
		value = arena_alloc(tree->arena, sizeof *value);
		if (!value)
			return ERR_MEMORY;
	}
	tree->values++;
	*out = value;
	return ERR_OK;
}

enum err patch_tree_object(struct patch_tree *tree, struct cJSON **out)
{
	enum err err = new_value(tree, out);

	if (!err)
		(*out)->type = cJSON_Object;
	return err;
}

enum err patch_tree_copy(struct patch_tree *tree, const struct cJSON *value,
    size_t level, struct cJSON **out)
{
	const cJSON *child;
	cJSON *copy, *inner;
	enum err err;

	if (level >= JSON_DEPTH_MAX) {
		tree->exceeded = PATCH_DEPTH;
		return ERR_LIMIT;
	}
	err = new_value(tree, &copy);
	if (err)
		return err;
	copy->type = kind(value);
	copy->valuestring = value->valuestring;
	copy->valuedouble = value->valuedouble;
	if (kind(value) == cJSON_Number)
		copy->valueint = value->valueint;
	for (child = value->child; child; child = child->next) {
		err = patch_tree_copy(tree, child, level + 1, &inner);
		if (err)
			return err;
		inner->string = child->string;
		patch_tree_insert(copy, NULL, inner);
	}
	*out = copy;
	return ERR_OK;
}

enum err patch_tree_begin(struct patch_tree *tree,
    const struct cJSON *target)
{
	return patch_tree_copy(tree, target, 0, &tree->root);
}

void patch_tree_drop(struct patch_tree *tree, struct cJSON *value)
{
	cJSON *child, *next;

	for (child = value->child; child; child = next) {
		next = child->next;
		patch_tree_drop(tree, child);
	}
	tree->values--;
	value->next = tree->spare;
	tree->spare = value;
}

/* ---- children ---- */

/* The first child's prev is the last one, as cJSON has it. */
void patch_tree_insert(struct cJSON *parent, struct cJSON *next,
    struct cJSON *value)
{
	parent->valueint++;
	if (!next) {
		cJSON_AddItemToArray(parent, value);
		return;
	}
	value->next = next;
	value->prev = next->prev;
	next->prev = value;
	if (parent->child == next)
		parent->child = value;
	else
		value->prev->next = value;
}

void patch_tree_detach(struct cJSON *parent, struct cJSON *value)
{
	parent->valueint--;
	cJSON_DetachItemViaPointer(parent, value);
}

size_t patch_tree_count(const struct cJSON *parent)
{
	return (size_t)parent->valueint;
}

enum err patch_tree_member(struct patch_tree *tree,
    const struct cJSON *object, const char *name, struct cJSON *hint,
    struct cJSON **out)
{
	const size_t alike = 1 + strlen(name) / BYTES_PER_STEP;
	cJSON *m = object->child;
	enum err err;

	*out = NULL;
	if (hint && text_equal(hint->string, name)) {
		*out = hint;
		return patch_tree_step(tree, alike);
	}
	for (; m; m = m->next) {
		err = patch_tree_step(tree, *m->string == *name ? alike : 1);
		if (err)
			return err;
		if (text_equal(m->string, name)) {
			*out = m;
			break;
		}
	}
	return ERR_OK;
}

enum err patch_tree_element(struct patch_tree *tree,
    const struct cJSON *array, size_t index, struct cJSON **out)
{
	const size_t behind = patch_tree_count(array) - 1 - index;
	cJSON *element = array->child;
	size_t i;
	enum err err;

	err = patch_tree_step(tree, index < behind ? index : behind);
	if (err)
		return err;
	if (index <= behind) {
		for (i = 0; i < index; i++)
			element = element->next;
	} else {
		element = element->prev;
		for (i = 0; i < behind; i++)
			element = element->prev;
	}
	*out = element;
	return ERR_OK;
}

/* ---- comparing ---- */

static bool equal_numbers(const cJSON *a, const cJSON *b)
{
	if (a->valuedouble != b->valuedouble)
		return false;
	return !isinf(a->valuedouble) || (a->valuestring && b->valuestring &&
	    strcmp(a->valuestring, b->valuestring) == 0);
}

static size_t count_children(const cJSON *parent)
{
	const cJSON *child;
	size_t count = 0;

	for (child = parent->child; child; child = child->next)
		count++;
	return count;
}

static enum err equal_objects(struct patch_tree *tree, const cJSON *a,
    const cJSON *b, bool *out)
{
	cJSON *hint = b->child, *other;
	const cJSON *m;
	enum err err;

	for (m = a->child; m && *out; m = m->next) {
		err = patch_tree_member(tree, b, m->string, hint, &other);
		if (err)
			return err;
		if (!other) {
			*out = false;
			break;
		}
		err = patch_tree_equal(tree, m, other, out);
		if (err)
			return err;
		hint = other->next;
	}
	return ERR_OK;
}

static enum err equal_arrays(struct patch_tree *tree, const cJSON *a,
    const cJSON *b, bool *out)
{
	enum err err = ERR_OK;

	a = a->child;
	b = b->child;
	for (; a && *out && !err; a = a->next, b = b->next)
		err = patch_tree_equal(tree, a, b, out);
	return err;
}

static enum err equal_strings(struct patch_tree *tree, const cJSON *a,
    const cJSON *b, bool *out)
{
	*out = text_equal(a->valuestring, b->valuestring);
	return patch_tree_step(tree, strlen(b->valuestring) / BYTES_PER_STEP);
}

enum err patch_tree_equal(struct patch_tree *tree, const struct cJSON *a,
    const struct cJSON *b, bool *out)
{
	const size_t count = count_children(a), other = count_children(b);
	enum err err;

	err = patch_tree_step(tree, 1 + count + other);
	if (err)
		return err;
	*out = kind(a) == kind(b) && count == other;
	if (!*out)
		return ERR_OK;
	switch (kind(a)) {
	case cJSON_Object:
		return equal_objects(tree, a, b, out);
	case cJSON_Array:
		return equal_arrays(tree, a, b, out);
	case cJSON_String:
		return equal_strings(tree, a, b, out);
	case cJSON_Number:
		*out = equal_numbers(a, b);
		return ERR_OK;
	default:
		return ERR_OK;
	}
}
