/*
 * Strict JSON (RFC 8259) into cJSON's tree, in an arena: what cJSON's own
 * reader lets pass (raw control characters, broken UTF-8, duplicate member
 * names, NUL, numbers like 01) is an error here, and every error says where it
 * is.
 */
#ifndef PROTO_JSON_H
#define PROTO_JSON_H

#include <stdbool.h>
#include <stddef.h>

#include "core/err.h"

struct arena;
struct cJSON;
struct faults;

/* Arrays and objects within each other; deeper is ERR_LIMIT. */
#define JSON_DEPTH_MAX 144

/* Room for any place's pointer. */
#define JSON_POINTER_MAX 1024

/* A place in a JSON text, as a chain on the stack: a member of its parent, an
 * element if name is NULL; the root's name is a pointer's beginning. */
struct json_place {
	const struct json_place *parent; /* NULL: the root */
	const char *name;
	size_t index;
};

struct json_place json_root(const char *pointer);
struct json_place json_member(const struct json_place *parent,
    const char *name);
struct json_place json_element(const struct json_place *parent, size_t index);

/* The JSON pointer (RFC 6901) of place; long names and long chains are cut. */
void json_pointer(const struct json_place *place,
    char out[static JSON_POINTER_MAX]);

/* faults_add at a place. */
void json_fault(struct faults *faults, const struct json_place *place,
    const char *detail, ...) __attribute__((format(printf, 3, 4)));

/* "an object", "a number"...: what a value is, for a sentence. */
const char *json_kind(const struct cJSON *value);

/* A text being read. */
struct json_text {
	struct arena *arena; /* what values and strings are made in */
	const char *start, *cursor, *end;
	size_t values_left; /* how many values may yet be read */
	size_t depth;
};

/* arena: may be NULL if neither values nor strings will be read. */
struct json_text json_text(const char *text, size_t length,
    size_t values_max, struct arena *arena);

/* Moves past white space. Inline, as the next: points are read by these. */
static inline void json_space(struct json_text *text)
{
	while (text->cursor < text->end && (*text->cursor == ' ' ||
	    *text->cursor == '\n' || *text->cursor == '\r' ||
	    *text->cursor == '\t'))
		text->cursor++;
}

/* The same; whether c comes next, and if so past it, too. */
static inline bool json_take(struct json_text *text, char c)
{
	json_space(text);
	if (text->cursor == text->end || *text->cursor != c)
		return false;
	text->cursor++;
	return true;
}

/*
 * Reads a string, after white space, as UTF-8 in the arena. Errors as
 * json_value.
 */
enum err json_string(struct json_text *text, const struct json_place *place,
    char **out, struct faults *faults);

/*
 * Reads one value, after white space, into the arena: it is not for
 * cJSON_Delete. Numbers beyond a double's range are infinite. ERR_SYNTAX, with
 * the line and column; ERR_LIMIT: too deep, or too many values; both fill
 * faults. ERR_MEMORY.
 */
enum err json_value(struct json_text *text, const struct json_place *place,
    struct cJSON **out, struct faults *faults);

/* The same, but keeps nothing, and so needs no arena; names that an object has
 * twice pass, and there may be any number of values. */
enum err json_skip(struct json_text *text, const struct json_place *place,
    struct faults *faults);

/* ERR_SYNTAX unless only white space is left. */
enum err json_finish(struct json_text *text, struct faults *faults);

/* A whole text: json_value, then json_finish. */
enum err json_parse(const char *text, size_t length, size_t values_max,
    struct arena *arena, struct cJSON **out, struct faults *faults);

/* Adds what was expected at the cursor, or that the text ends instead, with
 * line and column; ERR_SYNTAX. */
enum err json_expected(const struct json_text *text,
    const struct json_place *place, const char *what, struct faults *faults);

/* Adds what is wrong with that which ends at the cursor; ERR_SYNTAX. */
enum err json_wrong(const struct json_text *text,
    const struct json_place *place, const char *what, struct faults *faults);

#endif
