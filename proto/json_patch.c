#include "proto/json_patch.h"

#include <stdarg.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include <cjson/cJSON.h>

#include "proto/arena.h"
#include "proto/fault.h"
#include "proto/json.h"
#include "proto/json_patch_tree.h"
#include "proto/json_print.h"
#include "proto/text.h"

/* Most of a pointer, or of a name, that a sentence shows. */
#define SHOWN 48

/* One operation under way. */
struct operation {
	struct patch_tree *tree;
	const cJSON *json;
	struct json_place place; /* in the patch */
	struct faults *faults;
};

/* Where a pointer leads: into parent, to what is there, if anything is. */
struct spot {
	const char *pointer;
	cJSON *parent;     /* NULL: the whole document */
	cJSON *value;      /* NULL: nothing is there */
	const char *at;    /* where in pointer the last token begins */
	const char *token; /* that one, decoded */
	size_t index;      /* of an array; its count for "-" and beyond */
	bool is_end;       /* of an array: where add may append */
	size_t level;      /* how many tokens lead there */
};

/* Adds what is wrong with the operation's member; ERR_INVALID. */
__attribute__((format(printf, 3, 4)))
static enum err refuse(const struct operation *o, const char *member,
    const char *detail, ...)
{
	const struct json_place at = json_member(&o->place, member);
	char sentence[FAULT_DETAIL_MAX];
	va_list args;

	va_start(args, detail);
	vsnprintf(sentence, sizeof sentence, detail, args);
	va_end(args);
	json_fault(o->faults, *member ? &at : &o->place, "%s", sentence);
	return ERR_INVALID;
}

/* err of the tree, whose bound is told. */
static enum err bounded(const struct operation *o, enum err err)
{
	return patch_tree_fault(o->tree, err, &o->place, o->faults);
}

/* ---- pointers ---- */

/* Decodes the token from p to end: ~1 is '/', ~0 is '~' (RFC 6901, 4). */
static char *decode_token(struct arena *arena, const char *p, const char *end)
{
	char *token = arena_alloc(arena, (size_t)(end - p) + 1), *out = token;

	while (token && p < end) {
		if (*p == '~')
			*out++ = *++p == '1' ? '/' : '~';
		else
			*out++ = *p;
		p++;
	}
	return token;
}

static const char *pointer_fault(const char *pointer)
{
	const char *p;

	if (*pointer && *pointer != '/')
		return "a JSON pointer is empty or begins with '/'";
	for (p = strchr(pointer, '~'); p; p = strchr(p + 1, '~')) {
		if (p[1] != '0' && p[1] != '1')
			return "in a JSON pointer only 0 (for ~) or 1 (for /) "
			    "follows a '~'";
	}
	return NULL;
}

/* The pointer in the operation's member of that name. */
static enum err read_pointer(const struct operation *o, const char *name,
    const char **out)
{
	const cJSON *member = cJSON_GetObjectItemCaseSensitive(o->json, name);
	const char *fault;

	if (!member)
		return refuse(o, "", "there is no \"%s\"", name);
	if (!cJSON_IsString(member))
		return refuse(o, name, "a JSON pointer is a string, not %s",
		    json_kind(member));
	fault = pointer_fault(member->valuestring);
	if (fault)
		return refuse(o, name, "%s", fault);
	*out = member->valuestring;
	return ERR_OK;
}

/* What spot's last token looks into, for a sentence. */
struct shown {
	char text[SHOWN + 8];
};
static struct shown show(const struct spot *spot)
{
	struct shown shown = {"the document"};
	const size_t n = (size_t)(spot->at - spot->pointer);
	char cut[4 * SHOWN] = "", clean[SHOWN];

	/* Of a long one, where it ends. */
	strncat(cut, n < sizeof cut ? spot->pointer : spot->at -
	    (sizeof cut - 1), n < sizeof cut ? n : sizeof cut - 1);
	text_clean(cut, 1, clean, sizeof clean);
	if (n)
		snprintf(shown.text, sizeof shown.text, "'%s'", clean);
	return shown;
}

/* An array's index without leading zeros (RFC 6901, 4). False: it is none. */
static bool read_index(const char *token, size_t *out)
{
	const size_t n = strspn(token, "0123456789");

	if (n == 0 || token[n] || (token[0] == '0' && n > 1))
		return false;
	*out = n > 9 ? SIZE_MAX : (size_t)strtoul(token, NULL, 10);
	return true;
}

/* What is at spot->token of the array spot->parent. */
static enum err find_element(const struct operation *o, const char *name,
    struct spot *spot)
{
	const size_t count = patch_tree_count(spot->parent);
	size_t index = count;

	if (strcmp(spot->token, "-") != 0 && !read_index(spot->token, &index))
		return refuse(o, name, "'%.48s' is no index of the array %s",
		    spot->token, show(spot).text);
	spot->is_end = index == count;
	spot->index = index < count ? index : count;
	if (index >= count)
		return ERR_OK;
	return bounded(o, patch_tree_element(o->tree, spot->parent, index,
	    &spot->value));
}

/* What is at spot->token of spot->parent. */
static enum err find_child(const struct operation *o, const char *name,
    struct spot *spot)
{
	if (cJSON_IsArray(spot->parent))
		return find_element(o, name, spot);
	if (cJSON_IsObject(spot->parent))
		return bounded(o, patch_tree_member(o->tree, spot->parent,
		    spot->token, NULL, &spot->value));
	return refuse(o, name, "%s is %s: nothing can be in it",
	    show(spot).text, json_kind(spot->parent));
}

/* Nothing is at spot. */
static enum err refuse_absent(const struct operation *o, const char *name,
    const struct spot *spot)
{
	const struct shown in = show(spot);
	char token[SHOWN];

	text_clean(spot->token, 1, token, sizeof token);
	if (cJSON_IsArray(spot->parent))
		return refuse(o, name, "there is no element %s in %s, which "
		    "has %zu%s", token, in.text, patch_tree_count(spot->parent),
		    strcmp(token, "-") == 0 ? "; - is for \"add\" and the "
		    "like, behind the last" : "");
	return refuse(o, name, "there is no '%s' in %s", token, in.text);
}

/* Follows the pointer in the operation's member of that name to where its last
 * token may or may not have something. */
static enum err walk(const struct operation *o, const char *name,
    struct spot *out)
{
	struct spot spot = {.value = o->tree->root};
	const char *p, *end;
	enum err err;

	err = read_pointer(o, name, &spot.pointer);
	if (err)
		return err;
	for (p = spot.pointer; !err && *p; p = end) {
		if (!spot.value)
			return refuse_absent(o, name, &spot);
		end = p + 1 + strcspn(p + 1, "/");
		spot.at = p;
		spot.token = decode_token(o->tree->arena, p + 1, end);
		if (!spot.token)
			return ERR_MEMORY;
		spot.parent = spot.value;
		spot.value = NULL;
		spot.level++;
		err = find_child(o, name, &spot);
	}
	if (!err)
		*out = spot;
	return err;
}

/* The same, and something has to be there. */
static enum err walk_to_value(const struct operation *o, const char *name,
    struct spot *out)
{
	enum err err = walk(o, name, out);

	if (!err && !out->value)
		err = refuse_absent(o, name, out);
	return err;
}

/* ---- operations ---- */

static enum err get_value(const struct operation *o, const cJSON **out)
{
	*out = cJSON_GetObjectItemCaseSensitive(o->json, "value");
	return *out ? ERR_OK : refuse(o, "", "there is no \"value\"");
}

/* Puts value where spot's value is, which is dropped. */
static void put_instead(const struct operation *o, const struct spot *spot,
    cJSON *value)
{
	cJSON *old = spot->value;

	if (spot->parent) {
		value->string = old->string;
		patch_tree_insert(spot->parent, old, value);
		patch_tree_detach(spot->parent, old);
	} else {
		value->string = NULL;
		o->tree->root = value;
	}
	patch_tree_drop(o->tree, old);
}

/* Whether something may be added at spot; an array has room between any two
 * elements and at its end. */
static enum err check_room(const struct operation *o, const struct spot *spot)
{
	const bool is_array = spot->parent && cJSON_IsArray(spot->parent);
	char token[SHOWN];

	if (!is_array || spot->value || spot->is_end)
		return ERR_OK;
	text_clean(spot->token, 1, token, sizeof token);
	return refuse(o, "path", "%s has %zu elements: nothing can be added "
	    "at %s, only before one of them or at the end, as -",
	    show(spot).text, patch_tree_count(spot->parent), token);
}

/* Adds value, which belongs nowhere yet, at spot. */
static void put_in(const struct operation *o, const struct spot *spot,
    cJSON *value)
{
	if (spot->parent && cJSON_IsArray(spot->parent)) {
		value->string = NULL;
		patch_tree_insert(spot->parent, spot->value, value);
	} else if (spot->value) {
		put_instead(o, spot, value);
	} else {
		value->string = (char *)(uintptr_t)spot->token;
		patch_tree_insert(spot->parent, NULL, value);
	}
}

static enum err do_add(const struct operation *o)
{
	const cJSON *value;
	struct spot spot;
	cJSON *copy;
	enum err err;

	err = walk(o, "path", &spot);
	if (!err)
		err = check_room(o, &spot);
	if (!err)
		err = get_value(o, &value);
	if (!err)
		err = bounded(o, patch_tree_copy(o->tree, value, spot.level,
		    &copy));
	if (!err)
		put_in(o, &spot, copy);
	return err;
}

static enum err do_remove(const struct operation *o)
{
	struct spot spot;
	enum err err;

	err = walk_to_value(o, "path", &spot);
	if (err)
		return err;
	if (!spot.parent)
		return refuse(o, "path", "the whole document cannot be "
		    "removed");
	patch_tree_detach(spot.parent, spot.value);
	patch_tree_drop(o->tree, spot.value);
	return ERR_OK;
}

static enum err do_replace(const struct operation *o)
{
	const cJSON *value;
	struct spot spot;
	cJSON *copy;
	enum err err;

	err = walk_to_value(o, "path", &spot);
	if (!err)
		err = get_value(o, &value);
	if (!err)
		err = bounded(o, patch_tree_copy(o->tree, value, spot.level,
		    &copy));
	if (!err)
		put_instead(o, &spot, copy);
	return err;
}

/* Whether the pointer b leads into what a leads to. There is one way only to
 * write a pointer. */
static bool is_within(const char *a, const char *b)
{
	const size_t n = strlen(a);

	return strncmp(a, b, n) == 0 && b[n] == '/';
}

/* As remove, then add. */
static enum err do_move(const struct operation *o)
{
	struct spot from, to;
	const char *path;
	enum err err;

	err = walk_to_value(o, "from", &from);
	if (!err)
		err = read_pointer(o, "path", &path);
	if (err)
		return err;
	if (is_within(from.pointer, path))
		return refuse(o, "path", "a value cannot be moved into "
		    "itself");
	if (strcmp(from.pointer, path) == 0)
		return ERR_OK;
	patch_tree_detach(from.parent, from.value);
	err = walk(o, "path", &to);
	if (!err)
		err = check_room(o, &to);
	if (!err && to.level > from.level)
		err = bounded(o, patch_tree_fits(o->tree, from.value,
		    to.level));
	if (!err)
		put_in(o, &to, from.value);
	return err;
}

static enum err do_copy(const struct operation *o)
{
	struct spot from, to;
	cJSON *copy;
	enum err err;

	err = walk_to_value(o, "from", &from);
	if (!err)
		err = walk(o, "path", &to);
	if (!err)
		err = check_room(o, &to);
	if (!err)
		err = bounded(o, patch_tree_copy(o->tree, from.value, to.level,
		    &copy));
	if (!err)
		put_in(o, &to, copy);
	return err;
}

/* A value for a sentence: what it is, if it is short. */
static struct shown show_value(const cJSON *value)
{
	struct shown shown = {""};
	char *text, clean[SHOWN];
	size_t length;

	snprintf(shown.text, sizeof shown.text, "%s", json_kind(value));
	if (json_print(value, SHOWN - 8, &text, &length))
		return shown;
	snprintf(shown.text, sizeof shown.text, "%.*s", (int)length, text);
	text_clean(shown.text, 0, clean, sizeof clean);
	strcpy(shown.text, clean);
	free(text);
	return shown;
}

/* What is not there fails the test, too. */
static enum err do_test(const struct operation *o)
{
	const cJSON *value;
	struct spot spot;
	bool is_equal;
	enum err err;

	err = walk(o, "path", &spot);
	if (!err)
		err = get_value(o, &value);
	if (err)
		return err;
	if (!spot.value) {
		refuse_absent(o, "path", &spot);
		return ERR_CONFLICT;
	}
	err = bounded(o, patch_tree_equal(o->tree, spot.value, value,
	    &is_equal));
	if (err || is_equal)
		return err;
	refuse(o, "value", "the test failed: there is %s, not %s",
	    show_value(spot.value).text, show_value(value).text);
	return ERR_CONFLICT;
}

static const struct {
	const char *name;
	enum err (*apply)(const struct operation *o);
} operations[] = {
	{"add", do_add},
	{"remove", do_remove},
	{"replace", do_replace},
	{"move", do_move},
	{"copy", do_copy},
	{"test", do_test},
};

#define OPERATION_COUNT (sizeof operations / sizeof *operations)

static enum err refuse_name(const struct operation *o, const char *name)
{
	const char *nearest = NULL;
	char shown[SHOWN];
	size_t i;

	text_clean(name, 1, shown, sizeof shown);
	for (i = 0; i < OPERATION_COUNT; i++) {
		if (text_distance(name, operations[i].name) <= 2)
			nearest = operations[i].name;
	}
	if (nearest)
		return refuse(o, "op", "unknown operation '%s'; did you mean "
		    "'%s'?", shown, nearest);
	return refuse(o, "op", "unknown operation '%s'; there are add, "
	    "remove, replace, move, copy and test", shown);
}

static enum err apply(const struct operation *o)
{
	const cJSON *op;
	size_t i;

	if (!cJSON_IsObject(o->json))
		return refuse(o, "", "an operation is an object, not %s",
		    json_kind(o->json));
	op = cJSON_GetObjectItemCaseSensitive(o->json, "op");
	if (!op)
		return refuse(o, "", "there is no \"op\"");
	if (!cJSON_IsString(op))
		return refuse(o, "op", "an operation's name is a string, not "
		    "%s", json_kind(op));
	for (i = 0; i < OPERATION_COUNT; i++) {
		if (text_equal(op->valuestring, operations[i].name))
			return operations[i].apply(o);
	}
	return refuse_name(o, op->valuestring);
}

/* ---- patches ---- */

static enum err check_patch(const struct cJSON *patch, struct faults *faults)
{
	const struct json_place root = json_root("");

	if (!cJSON_IsArray(patch)) {
		json_fault(faults, &root, "a JSON Patch is an array of "
		    "operations, not %s%s", json_kind(patch),
		    cJSON_IsObject(patch) ? ", as a Merge Patch "
		    "(application/merge-patch+json) is" : "");
		return ERR_INVALID;
	}
	if (cJSON_GetArraySize(patch) > JSON_PATCH_OPERATIONS_MAX) {
		json_fault(faults, &root, "%d operations are more than %d: "
		    "send them in parts", cJSON_GetArraySize(patch),
		    JSON_PATCH_OPERATIONS_MAX);
		return ERR_LIMIT;
	}
	return ERR_OK;
}

enum err json_patch_apply(struct cJSON **target, const struct cJSON *patch,
    size_t values_most, struct arena *arena, struct faults *faults)
{
	const struct json_place root = json_root("");
	struct patch_tree tree = {.arena = arena, .values_most = values_most,
	    .steps = JSON_PATCH_STEPS_MAX};
	struct operation o = {.tree = &tree, .faults = faults,
	    .place = json_element(&root, 0)};
	enum err err;

	err = check_patch(patch, faults);
	if (!err)
		err = patch_tree_fault(&tree, patch_tree_begin(&tree, *target),
		    &root, faults);
	for (o.json = err ? NULL : patch->child; o.json && !err;
	    o.json = o.json->next, o.place.index++)
		err = apply(&o);
	if (!err)
		*target = tree.root;
	return err;
}

enum err json_patch_read(const char *text, size_t length, size_t values_max,
    struct arena *arena, struct cJSON **out, struct faults *faults)
{
	cJSON *patch;
	enum err err;

	err = json_parse(text, length, values_max, arena, &patch, faults);
	if (!err)
		err = json_print_keep_numbers(patch, text, length, arena);
	if (!err)
		*out = patch;
	return err;
}

/* Whether a patch has changed nothing. Where telling takes too long, it has. */
static bool is_unchanged(const struct cJSON *before, const struct cJSON *after)
{
	struct patch_tree tree = {.steps = JSON_PATCH_STEPS_MAX};
	bool is_equal;

	return !patch_tree_equal(&tree, before, after, &is_equal) && is_equal;
}

static enum err copy_text(const char *text, size_t length, char **out,
    size_t *out_length)
{
	char *copy = malloc(length);

	if (!copy)
		return ERR_MEMORY;
	memcpy(copy, text, length);
	*out = copy;
	*out_length = length;
	return ERR_OK;
}

static enum err print(const struct cJSON *tree, size_t bytes_most, char **out,
    size_t *length, struct faults *faults)
{
	const struct json_place root = json_root("");
	enum err err = json_print(tree, bytes_most, out, length);

	if (err == ERR_LIMIT)
		json_fault(faults, &root, "the result would have more than "
		    "%zu bytes", bytes_most);
	return err;
}

enum err json_patch_text(const struct json_patch *patch, const char *text,
    size_t length, char **out, size_t *out_length, struct faults *faults)
{
	struct arena arena = {0};
	cJSON *before, *tree;
	enum err err;

	err = json_patch_read(text, length, patch->values_most, &arena,
	    &before, faults);
	tree = err ? NULL : before;
	if (!err)
		err = (patch->is_merge ? json_merge_apply : json_patch_apply)
		    (&tree, patch->patch, patch->values_most, &arena, faults);
	if (!err)
		err = is_unchanged(before, tree) ?
		    copy_text(text, length, out, out_length) :
		    print(tree, patch->bytes_most, out, out_length, faults);
	arena_fini(&arena);
	return err;
}
