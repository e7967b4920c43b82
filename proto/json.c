#include "proto/json.h"

#include <stdlib.h>
#include <string.h>

#include <cjson/cJSON.h>

#include "proto/arena.h"
#include "proto/fault.h"
#include "proto/number.h"
#include "proto/text.h"

/* Up to here, comparing all pairs of names beats sorting them. */
#define MEMBERS_COMPARED 16

struct json_text json_text(const char *text, size_t length,
    size_t values_max, struct arena *arena)
{
	return (struct json_text){.arena = arena, .start = text,
	    .cursor = text, .end = text + length, .values_left = values_max,
	    .origin = {text, 0, 1, 1}};
}

struct json_mark json_mark_moved(struct json_mark mark, const char *at)
{
	const char *p = mark.at, *newline;

	mark.byte += (size_t)(at - p);
	while ((newline = memchr(p, '\n', (size_t)(at - p)))) {
		mark.line++;
		mark.column = 1;
		p = newline + 1;
	}
	mark.column += (size_t)(at - p);
	mark.at = at;
	return mark;
}

/* Adds what, where the cursor is, and behind it more; ERR_SYNTAX. */
static enum err refuse(const struct json_text *text,
    const struct json_place *place, const char *what, const char *more,
    struct faults *faults)
{
	const bool resumed = text->resumed.at &&
	    text->cursor >= text->resumed.at;
	const struct json_mark mark = json_mark_moved(resumed ? text->resumed :
	    text->origin, text->cursor);

	json_fault(faults, place, "line %zu, column %zu (byte %zu): %s%s",
	    mark.line, mark.column, mark.byte, what, more);
	return ERR_SYNTAX;
}

enum err json_expected(const struct json_text *text,
    const struct json_place *place, const char *what, struct faults *faults)
{
	return refuse(text, place, what, text->cursor == text->end ?
	    ", but the text ends" : "", faults);
}

enum err json_wrong(const struct json_text *text,
    const struct json_place *place, const char *what, struct faults *faults)
{
	return refuse(text, place, what, "", faults);
}

static int hex_digit(char c)
{
	if (c >= '0' && c <= '9')
		return c - '0';
	c |= 0x20;
	return c >= 'a' && c <= 'f' ? c - 'a' + 10 : -1;
}

/* The four hexadecimal digits at p, or -1. */
static long hex4(const char *p, const char *end)
{
	long value = 0;
	int i, digit;

	if (end - p < 4)
		return -1;
	for (i = 0; i < 4; i++) {
		digit = hex_digit(p[i]);
		if (digit < 0)
			return -1;
		value = 16 * value + digit;
	}
	return value;
}

/* The code point of the escape at p ("\uXXXX", or a surrogate pair), or -1;
 * *length is how many characters it takes. */
static long unicode_escape(const char *p, const char *end, size_t *length)
{
	const long high = hex4(p + 2, end);
	long low;

	*length = 6;
	if (high < 0xd800 || high > 0xdfff)
		return high;
	*length = 12;
	if (high > 0xdbff || end - p < 12 || p[6] != '\\' || p[7] != 'u')
		return -1;
	low = hex4(p + 8, end);
	if (low < 0xdc00 || low > 0xdfff)
		return -1;
	return 0x10000 + ((high - 0xd800) << 10) + (low - 0xdc00);
}

static char *put_utf8(char *out, long c)
{
	if (c < 0x80) {
		*out++ = (char)c;
		return out;
	}
	if (c < 0x800) {
		*out++ = (char)(0xc0 | c >> 6);
	} else {
		if (c < 0x10000) {
			*out++ = (char)(0xe0 | c >> 12);
		} else {
			*out++ = (char)(0xf0 | c >> 18);
			*out++ = (char)(0x80 | (c >> 12 & 0x3f));
		}
		*out++ = (char)(0x80 | (c >> 6 & 0x3f));
	}
	*out++ = (char)(0x80 | (c & 0x3f));
	return out;
}

/* Moves past the escape at the cursor; what is wrong with it, or NULL. */
static const char *check_escape(struct json_text *text)
{
	const char *p = text->cursor;
	size_t length = 2;
	long c;

	if (text->end - p < 2 || !strchr("\"\\/bfnrtu", p[1]) || !p[1])
		return "unknown escape in a string";
	if (p[1] == 'u') {
		c = unicode_escape(p, text->end, &length);
		if (c < 0)
			return "wrong \\u escape in a string";
		if (c == 0)
			return "the character NUL is not allowed";
	}
	text->cursor += length;
	return NULL;
}

/* Behind the characters at p that stand for themselves, those of ASCII. */
static const char *plain_end(const char *p, const char *end)
{
	while (p < end && *p >= 0x20 && *p < 0x7f && *p != '"' && *p != '\\')
		p++;
	return p;
}

/* Moves from behind the opening quote to the closing one; what is wrong, or
 * NULL. */
static const char *check_string(struct json_text *text)
{
	const char *what;
	size_t n;

	for (;;) {
		text->cursor = plain_end(text->cursor, text->end);
		if (text->cursor == text->end || *text->cursor == '"')
			break;
		if ((unsigned char)*text->cursor < 0x20)
			return "control character in a string";
		if (*text->cursor == '\\') {
			what = check_escape(text);
			if (what)
				return what;
			continue;
		}
		n = text_sequence(text->cursor, text->end);
		if (n == 0)
			return "a string is not UTF-8";
		text->cursor += n;
	}
	return text->cursor < text->end ? NULL : "expected '\"'";
}

/* Decodes the checked string from p to end. */
static void decode(const char *p, const char *end, char *out)
{
	static const char names[] = "bfnrt", meanings[] = "\b\f\n\r\t";
	const char *name;
	size_t length;

	while (p < end) {
		if (*p != '\\') {
			*out++ = *p++;
		} else if (p[1] == 'u') {
			out = put_utf8(out, unicode_escape(p, end, &length));
			p += length;
		} else {
			name = strchr(names, p[1]);
			*out++ = name ? meanings[name - names] : p[1];
			p += 2;
		}
	}
	*out = '\0';
}

/* Moves past a string, after white space; *start is behind its first quote. */
static enum err pass_string(struct json_text *text,
    const struct json_place *place, const char **start, struct faults *faults)
{
	const char *what;

	if (!json_take(text, '"'))
		return json_expected(text, place, "expected a string", faults);
	*start = text->cursor;
	what = check_string(text);
	if (what)
		return json_expected(text, place, what, faults);
	text->cursor++;
	return ERR_OK;
}

enum err json_string(struct json_text *text, const struct json_place *place,
    char **out, struct faults *faults)
{
	const char *start;
	char *string;
	enum err err;

	err = pass_string(text, place, &start, faults);
	if (err)
		return err;
	string = arena_alloc(text->arena, (size_t)(text->cursor - start));
	if (!string)
		return ERR_MEMORY;
	decode(start, text->cursor - 1, string);
	*out = string;
	return ERR_OK;
}

static enum err read_string(struct json_text *text,
    const struct json_place *place, cJSON *value, struct faults *faults)
{
	value->type = cJSON_String;
	return json_string(text, place, &value->valuestring, faults);
}

static enum err read_number(struct json_text *text,
    const struct json_place *place, cJSON *value, struct faults *faults)
{
	double number;

	if (number_parse(&text->cursor, text->end, &number))
		return json_expected(text, place, "not a JSON number", faults);
	value->type = cJSON_Number;
	cJSON_SetNumberHelper(value, number);
	return ERR_OK;
}

static enum err read_word(struct json_text *text,
    const struct json_place *place, cJSON *value, struct faults *faults)
{
	static const struct {
		const char *word;
		int type;
	} words[] = {
		{"null", cJSON_NULL},
		{"true", cJSON_True},
		{"false", cJSON_False},
	};
	size_t i, n;

	for (i = 0; i < sizeof words / sizeof *words; i++) {
		n = strlen(words[i].word);
		if ((size_t)(text->end - text->cursor) >= n &&
		    memcmp(text->cursor, words[i].word, n) == 0) {
			text->cursor += n;
			value->type = words[i].type;
			return ERR_OK;
		}
	}
	return json_expected(text, place, "expected a value", faults);
}

static enum err read_array(struct json_text *text,
    const struct json_place *place, cJSON *array, struct faults *faults)
{
	struct json_place at = json_element(place, 0);
	cJSON *element;
	enum err err;

	array->type = cJSON_Array;
	text->cursor++;
	if (json_take(text, ']'))
		return ERR_OK;
	for (;; at.index++) {
		err = json_value(text, &at, &element, faults);
		if (err)
			return err;
		cJSON_AddItemToArray(array, element);
		if (json_take(text, ']'))
			return ERR_OK;
		if (!json_take(text, ','))
			return json_expected(text, place,
			    "expected ',' or ']'", faults);
	}
}

static int compare_names(const void *a, const void *b)
{
	const cJSON *const *x = a, *const *y = b;

	return strcmp((*x)->string, (*y)->string);
}

/* A member whose name another one has, in *out, or NULL. */
static enum err find_duplicate(const cJSON *object, size_t count,
    const cJSON **out)
{
	const cJSON **members, *m, *other;
	size_t i = 0;

	*out = NULL;
	if (count <= MEMBERS_COMPARED) {
		for (m = object->child; m; m = m->next) {
			for (other = object->child; other != m;
			    other = other->next) {
				if (text_equal(other->string, m->string))
					*out = m;
			}
		}
		return ERR_OK;
	}
	members = malloc(count * sizeof *members);
	if (!members)
		return ERR_MEMORY;
	for (m = object->child; m; m = m->next)
		members[i++] = m;
	qsort(members, count, sizeof *members, compare_names);
	for (i = 1; i < count; i++) {
		if (strcmp(members[i - 1]->string, members[i]->string) == 0)
			*out = members[i];
	}
	free(members);
	return ERR_OK;
}

static enum err check_names(const struct json_text *text,
    const struct json_place *place, const cJSON *object, size_t count,
    struct faults *faults)
{
	struct json_place at;
	const cJSON *duplicate;
	enum err err;

	err = find_duplicate(object, count, &duplicate);
	if (err || !duplicate)
		return err;
	at = json_member(place, duplicate->string);
	return json_wrong(text, &at,
	    "the object that ends here has this member twice", faults);
}

static enum err read_member(struct json_text *text,
    const struct json_place *place, cJSON *object, struct faults *faults)
{
	struct json_place at;
	cJSON *value;
	char *name;
	enum err err;

	err = json_string(text, place, &name, faults);
	if (err)
		return err;
	at = json_member(place, name);
	if (!json_take(text, ':'))
		return json_expected(text, &at, "expected ':'", faults);
	err = json_value(text, &at, &value, faults);
	if (err)
		return err;
	value->string = name;
	cJSON_AddItemToArray(object, value);
	return ERR_OK;
}

static enum err read_object(struct json_text *text,
    const struct json_place *place, cJSON *object, struct faults *faults)
{
	size_t count = 0;
	enum err err;

	object->type = cJSON_Object;
	text->cursor++;
	if (json_take(text, '}'))
		return ERR_OK;
	for (;;) {
		err = read_member(text, place, object, faults);
		if (err)
			return err;
		count++;
		if (json_take(text, '}'))
			return check_names(text, place, object, count, faults);
		if (!json_take(text, ','))
			return json_expected(text, place,
			    "expected ',' or '}'", faults);
	}
}

static enum err read_any(struct json_text *text,
    const struct json_place *place, cJSON *value, struct faults *faults)
{
	switch (*text->cursor) {
	case '{':
		return read_object(text, place, value, faults);
	case '[':
		return read_array(text, place, value, faults);
	case '"':
		return read_string(text, place, value, faults);
	case 't':
	case 'f':
	case 'n':
		return read_word(text, place, value, faults);
	default:
		if (*text->cursor == '-' ||
		    (*text->cursor >= '0' && *text->cursor <= '9'))
			return read_number(text, place, value, faults);
		return json_expected(text, place, "expected a value", faults);
	}
}

/* Whether a value may begin here, after white space. */
static enum err begin_value(struct json_text *text,
    const struct json_place *place, struct faults *faults)
{
	json_space(text);
	if (text->cursor == text->end)
		return json_expected(text, place, "expected a value", faults);
	if (text->depth < JSON_DEPTH_MAX)
		return ERR_OK;
	json_fault(faults, place, "nested more than %d deep", JSON_DEPTH_MAX);
	return ERR_LIMIT;
}

enum err json_value(struct json_text *text, const struct json_place *place,
    struct cJSON **out, struct faults *faults)
{
	cJSON *value;
	enum err err;

	err = begin_value(text, place, faults);
	if (err)
		return err;
	if (text->values_left == 0) {
		json_fault(faults, place, "too many JSON values");
		return ERR_LIMIT;
	}
	text->values_left--;
	value = arena_alloc(text->arena, sizeof *value);
	if (!value)
		return ERR_MEMORY;
	text->depth++;
	err = read_any(text, place, value, faults);
	text->depth--;
	if (!err)
		*out = value;
	return err;
}

enum err json_skip(struct json_text *text, const struct json_place *place,
    struct faults *faults)
{
	struct json_skipper inside = {.state = JSON_SKIP_OPENED, .depth = 1};
	cJSON unused = {0};
	const char *start;
	enum err err;

	err = begin_value(text, place, faults);
	if (err)
		return err;
	if (*text->cursor == '"')
		return pass_string(text, place, &start, faults);
	if (*text->cursor != '{' && *text->cursor != '[')
		return read_any(text, place, &unused, faults);
	inside.is_object[0] = *text->cursor++ == '{';
	return json_skip_on(&inside, text, true, place, faults);
}

const char *json_token_end(const char *p, const char *end, bool is_string,
    bool *escaped)
{
	if (!is_string) {
		while (p < end && ((*p >= '0' && *p <= '9') || *p == '-' ||
		    *p == '+' || *p == '.' ||
		    ((*p | 0x20) >= 'a' && (*p | 0x20) <= 'z')))
			p++;
		return p < end ? p : NULL;
	}
	for (; p < end; p++) {
		if (*escaped)
			*escaped = false;
		else if (*p == '\\')
			*escaped = true;
		else if (*p == '"')
			return p + 1;
	}
	return NULL;
}

/* Whether the number, word or string at the cursor is all there, if one may
 * be. */
static bool has_token(const struct json_skipper *s,
    const struct json_text *text)
{
	const bool is_string = *text->cursor == '"';
	bool escaped = false;

	if (s->state != JSON_SKIP_VALUE && s->state != JSON_SKIP_NAME)
		return true;
	return json_token_end(text->cursor + is_string, text->end, is_string,
	    &escaped) != NULL;
}

/* A value is behind the cursor, or the skipper's array or object ends. */
static void skip_close(struct json_skipper *s)
{
	s->depth--;
	s->state = JSON_SKIP_BEHIND;
}

/* At the beginning of a value, behind white space. */
static enum err skip_value(struct json_skipper *s, struct json_text *text,
    const struct json_place *place, struct faults *faults)
{
	const char c = text->cursor < text->end ? *text->cursor : ' ';

	if (s->depth == JSON_DEPTH_MAX && c != ' ') {
		json_fault(faults, place, "nested more than %d deep",
		    JSON_DEPTH_MAX);
		return ERR_LIMIT;
	}
	if (c != '[' && c != '{') {
		s->state = JSON_SKIP_BEHIND;
		return json_skip(text, place, faults);
	}
	text->cursor++;
	s->is_object[s->depth++] = c == '{';
	s->state = JSON_SKIP_OPENED;
	return ERR_OK;
}

/* Behind a value. */
static enum err skip_separator(struct json_skipper *s, struct json_text *text,
    const struct json_place *place, struct faults *faults)
{
	const bool is_object = s->is_object[s->depth - 1];

	if (json_take(text, ',')) {
		s->state = is_object ? JSON_SKIP_NAME : JSON_SKIP_VALUE;
		return ERR_OK;
	}
	if (json_take(text, is_object ? '}' : ']')) {
		skip_close(s);
		return ERR_OK;
	}
	return json_expected(text, place, is_object ? "expected ',' or '}'" :
	    "expected ',' or ']'", faults);
}

/* One step; the cursor is behind white space. */
static enum err skip_step(struct json_skipper *s, struct json_text *text,
    const struct json_place *place, struct faults *faults)
{
	const bool is_object = s->is_object[s->depth - 1];

	switch (s->state) {
	case JSON_SKIP_OPENED:
		s->state = is_object ? JSON_SKIP_NAME : JSON_SKIP_VALUE;
		if (json_take(text, is_object ? '}' : ']'))
			skip_close(s);
		return ERR_OK;
	case JSON_SKIP_VALUE:
		return skip_value(s, text, place, faults);
	case JSON_SKIP_NAME:
		s->state = JSON_SKIP_COLON;
		if (text->cursor == text->end || *text->cursor != '"')
			return json_expected(text, place, "expected a string",
			    faults);
		return json_skip(text, place, faults);
	case JSON_SKIP_COLON:
		s->state = JSON_SKIP_VALUE;
		return json_take(text, ':') ? ERR_OK : json_expected(text,
		    place, "expected ':'", faults);
	default:
		return skip_separator(s, text, place, faults);
	}
}

enum err json_skip_on(struct json_skipper *s, struct json_text *text,
    bool last, const struct json_place *place, struct faults *faults)
{
	enum err err = ERR_OK;

	while (s->depth && !err) {
		json_space(text);
		if (!last && (text->cursor == text->end || !has_token(s, text)))
			break;
		err = skip_step(s, text, place, faults);
	}
	return err;
}

bool json_spells(const char *start, const char *end, const char *name)
{
	enum { LONGEST = 8 * 6 };
	struct json_text text = json_text(start, (size_t)(end - start) + 1, 0,
	    NULL);
	char meaning[LONGEST + 1];

	if (end - start > LONGEST || check_string(&text) != NULL ||
	    text.cursor != end)
		return false;
	decode(start, end, meaning);
	return strcmp(meaning, name) == 0;
}

enum err json_finish(struct json_text *text, struct faults *faults)
{
	const struct json_place root = json_root("");

	json_space(text);
	if (text->cursor == text->end)
		return ERR_OK;
	return json_expected(text, &root, "something follows the value",
	    faults);
}

enum err json_parse(const char *text, size_t length, size_t values_max,
    struct arena *arena, struct cJSON **out, struct faults *faults)
{
	const struct json_place root = json_root("");
	struct json_text t = json_text(text, length, values_max, arena);
	cJSON *value;
	enum err err;

	err = json_value(&t, &root, &value, faults);
	if (err)
		return err;
	err = json_finish(&t, faults);
	if (!err)
		*out = value;
	return err;
}
