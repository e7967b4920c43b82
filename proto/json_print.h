/*
 * Trees of JSON to text, without loss: cJSON's own printer gives a number 15
 * digits where 17 are needed, if the two are within an epsilon, and has no
 * bound.
 */
#ifndef PROTO_JSON_PRINT_H
#define PROTO_JSON_PRINT_H

#include <stddef.h>

#include "core/err.h"

struct arena;
struct cJSON;

/*
 * Has the numbers of tree, which json_parse has made of text, keep how they are
 * spelt there, as their valuestring in arena: "1.50", or more digits than a
 * double has. ERR_MEMORY.
 */
enum err json_print_keep_numbers(struct cJSON *tree, const char *text,
    size_t length, struct arena *arena);

/*
 * Prints tree without white space into *out, for free, not ended by NUL.
 * Numbers as they are spelt, if that is kept; else with as many digits as reading the
 * same double back takes, and infinite ones as 1e999. ERR_LIMIT: more than
 * bytes_most bytes; ERR_MEMORY. Recursive: tree's depth is for its maker to
 * bound.
 */
enum err json_print(const struct cJSON *tree, size_t bytes_most, char **out,
    size_t *length);

#endif
