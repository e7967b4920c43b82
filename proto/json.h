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

/* Where a character stands: bytes before it, its line and column from 1. */
struct json_mark {
	const char *at;
	size_t byte, line, column;
};

/* mark, moved on to at, which may not lie before it. */
struct json_mark json_mark_moved(struct json_mark mark, const char *at);

/* A text being read: all of one, or a piece of a longer one. */
struct json_text {
	struct arena *arena; /* what values and strings are made in */
	const char *start, *cursor, *end;
	size_t values_left; /* how many values may yet be read */
	size_t depth;
	/* Where the longer text has what stands at start; and, unless its at is
	 * NULL, what stands behind a part that was left out. */
	struct json_mark origin, resumed;
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

/*
 * json_skip in pieces: of an array or an object whose beginning was read
 * already.
 */
enum json_skip_state {
	JSON_SKIP_VALUE,
	JSON_SKIP_OPENED, /* behind '[' or '{' */
	JSON_SKIP_NAME,
	JSON_SKIP_COLON,
	JSON_SKIP_BEHIND  /* a value */
};
struct json_skipper {
	enum json_skip_state state;
	size_t depth;                    /* open arrays and objects; 0: done */
	bool is_object[JSON_DEPTH_MAX];
};

/*
 * Moves as far as text goes; with last, faults if that is not the end of the
 * value. What is left, without last, is the beginning of a number, a word or a
 * string. Errors as json_value, at place.
 */
enum err json_skip_on(struct json_skipper *skipper, struct json_text *text,
    bool last, const struct json_place *place, struct faults *faults);

/*
 * Numbers, words and strings in pieces: behind the one that began before p, or
 * NULL if it may go on at end. Of a string *escaped, false at its beginning,
 * remembers a backslash; p is then behind its first quote.
 */
const char *json_token_end(const char *p, const char *end, bool is_string,
    bool *escaped);

/* Whether the string from start to its closing quote, at end, means name, of
 * at most 8 characters. Nothing is allocated. */
bool json_spells(const char *start, const char *end, const char *name);

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
