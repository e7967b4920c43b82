/*
 * JSON Merge Patch: RFC 7396, section 2.
 */
#include <cjson/cJSON.h>

#include "proto/json.h"
#include "proto/json_patch.h"
#include "proto/json_patch_tree.h"

static enum err merge(struct patch_tree *tree, cJSON *target,
    const cJSON *patch, size_t level);

/* What patch makes of nothing. */
static enum err make(struct patch_tree *tree, const cJSON *patch,
    size_t level, cJSON **out)
{
	enum err err;

	if (!cJSON_IsObject(patch))
		return patch_tree_copy(tree, patch, level, out);
	err = patch_tree_object(tree, out);
	if (!err)
		err = patch_tree_fits(tree, *out, level);
	if (!err)
		err = merge(tree, *out, patch, level);
	return err;
}

/* Puts what patch makes of nothing into target, for old or at the end. */
static enum err put(struct patch_tree *tree, cJSON *target, cJSON *old,
    const cJSON *patch, size_t level)
{
	cJSON *value;
	enum err err;

	err = make(tree, patch, level, &value);
	if (err)
		return err;
	value->string = patch->string;
	patch_tree_insert(target, old, value);
	if (old) {
		patch_tree_detach(target, old);
		patch_tree_drop(tree, old);
	}
	return ERR_OK;
}

/* Merges patch, a member, into target, whose member of that name is old. */
static enum err merge_member(struct patch_tree *tree, cJSON *target,
    cJSON *old, const cJSON *patch, size_t level)
{
	if (!cJSON_IsNull(patch)) {
		if (old && cJSON_IsObject(old) && cJSON_IsObject(patch))
			return merge(tree, old, patch, level);
		return put(tree, target, old, patch, level);
	}
	if (old) {
		patch_tree_detach(target, old);
		patch_tree_drop(tree, old);
	}
	return ERR_OK;
}

/* Merges the object patch into the object target, which stands at level. */
static enum err merge(struct patch_tree *tree, cJSON *target,
    const cJSON *patch, size_t level)
{
	cJSON *hint = target->child, *old;
	const cJSON *m;
	enum err err;

	for (m = patch->child; m; m = m->next) {
		err = patch_tree_member(tree, target, m->string, hint, &old);
		if (err)
			return err;
		if (old)
			hint = old->next;
		err = merge_member(tree, target, old, m, level + 1);
		if (err)
			return err;
	}
	return ERR_OK;
}

enum err json_merge_apply(struct cJSON **target, const struct cJSON *patch,
    size_t values_most, struct arena *arena, struct faults *faults)
{
	const struct json_place root = json_root("");
	struct patch_tree tree = {.arena = arena, .values_most = values_most,
	    .steps = JSON_PATCH_STEPS_MAX};
	enum err err;

	if (cJSON_IsObject(*target) && cJSON_IsObject(patch)) {
		err = patch_tree_begin(&tree, *target);
		if (!err)
			err = merge(&tree, tree.root, patch, 0);
	} else {
		err = make(&tree, patch, 0, &tree.root);
	}
	if (!err)
		*target = tree.root;
	return patch_tree_fault(&tree, err, &root, faults);
}
