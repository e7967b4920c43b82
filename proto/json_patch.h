/*
 * JSON Patch (RFC 6902), JSON Pointer (RFC 6901) and JSON Merge Patch (RFC
 * 7396) on parsed JSON. Debian's cJSON comes without its own (cJSON_Utils).
 *
 * Trees are as json_parse makes them: no name twice in an object, at most
 * JSON_DEPTH_MAX deep. A result shares strings with what it is made of, and
 * nothing here frees: all live as long as their arenas.
 */
#ifndef PROTO_JSON_PATCH_H
#define PROTO_JSON_PATCH_H

#include <stdbool.h>
#include <stddef.h>

#include "core/err.h"

struct arena;
struct cJSON;
struct faults;

/* Operations of one patch; more are ERR_LIMIT. */
#define JSON_PATCH_OPERATIONS_MAX 4096

/*
 * Steps of one patch: elements and members passed by on the way to a place,
 * values copied (4 each), removed and compared; more are ERR_LIMIT. Elements
 * are found from an array's nearer end: 4096 operations in the middle of an
 * array of 30,000 just pass. All of it takes 0.2 s.
 */
#define JSON_PATCH_STEPS_MAX ((size_t)1 << 26)

/*
 * Applies patch, an array of operations, to *target, which becomes a new tree
 * in arena. values_most: the most JSON values there may be at any time, so that a
 * patch of copies of copies ends soon. All of the patch is checked and done, or
 * *target is left as it was.
 * ERR_INVALID: no patch, or a place that is not there; ERR_CONFLICT: a "test"
 * failed; ERR_LIMIT: too many operations, values or steps, or too deep; all
 * fill faults with the operation's place in patch ("/3/path"). ERR_MEMORY.
 * Members of an operation that it does not know are ignored (RFC 6902, appendix A.11).
 * Numbers are equal if they are the same double; beyond a double's range, if
 * they are spelt alike.
 */
enum err json_patch_apply(struct cJSON **target, const struct cJSON *patch,
    size_t values_most, struct arena *arena, struct faults *faults);

/* The same of a merge patch, which is any JSON and always applies: null removes
 * members. ERR_LIMIT, ERR_MEMORY. */
enum err json_merge_apply(struct cJSON **target, const struct cJSON *patch,
    size_t values_most, struct arena *arena, struct faults *faults);

/* A patch that has been read, to be applied to any number of texts. */
struct json_patch {
	const struct cJSON *patch;
	bool is_merge;
	size_t values_most; /* of text and result */
	size_t bytes_most;  /* of the result */
};

/*
 * Reads a patch for json_patch_text, in arena, its numbers as they are spelt.
 * Errors as json_parse.
 */
enum err json_patch_read(const char *text, size_t length, size_t values_max,
    struct arena *arena, struct cJSON **out, struct faults *faults);

/*
 * Applies patch to a JSON text: *out is the result's, without white space, for
 * free, not ended by NUL. Numbers that the patch leaves alone, and those it
 * brings, stay as they are spelt. If the result equals the text's value, it is
 * the text, byte for byte. Errors as json_patch_apply; ERR_SYNTAX: text is no
 * JSON. Any thread.
 */
enum err json_patch_text(const struct json_patch *patch, const char *text,
    size_t length, char **out, size_t *out_length, struct faults *faults);

#endif
