/*
 * Finding the points takes no more than knowing strings, depths, and what
 * stands where in the outermost object. It need not see what is wrong with the
 * text: what precedes the points is kept and parsed, and if an error is there,
 * that is what the parser tells, and it never comes to the points.
 */
#include "proto/eval_text.h"

#include <assert.h>
#include <stdint.h>
#include <stdlib.h>
#include <string.h>

#include "proto/eval_splice.h"

#define BYTES_FIRST 1024
/* Text is kept by so much at a time before points are sought in it. */
#define BLOCK 4096

enum err eval_bytes_add(struct eval_bytes *bytes, const char *data,
    size_t length)
{
	size_t size = bytes->size ? bytes->size : BYTES_FIRST;
	char *grown;

	while (size - bytes->length < length) {
		if (size > SIZE_MAX / 2)
			return ERR_MEMORY;
		size *= 2;
	}
	if (size != bytes->size) {
		grown = realloc(bytes->data, size);
		if (!grown)
			return ERR_MEMORY;
		bytes->data = grown;
		bytes->size = size;
	}
	if (length)
		memcpy(bytes->data + bytes->length, data, length);
	bytes->length += length;
	return ERR_OK;
}

static void drop(struct eval_bytes *bytes)
{
	free(bytes->data);
	*bytes = (struct eval_bytes){0};
}

void eval_text_init(struct eval_text *t, size_t max_points,
    struct faults *faults)
{
	*t = (struct eval_text){.here = {NULL, 0, 1, 1}};
	t->scan = points_scan_init("/points", max_points, faults);
}

void eval_text_fini(struct eval_text *t)
{
	drop(&t->kept);
	drop(&t->token);
	points_fini(&t->scan.points);
}

size_t eval_text_bytes(const struct eval_text *t)
{
	return t->kept.size + t->token.size +
	    t->scan.room * 3 * sizeof *t->scan.points.xyz;
}

/* Past one character of a string. */
static void in_string(struct eval_text *t, const char *p)
{
	if (t->escaped) {
		t->escaped = false;
	} else if (*p == '\\') {
		t->escaped = true;
	} else if (*p == '"') {
		t->in_string = false;
		if (t->depth != 1 || t->member != EVAL_MEMBER_NAME)
			return;
		t->member = EVAL_MEMBER_COLON;
		t->is_points = json_spells(t->kept.data + t->name, p,
		    "points");
	}
}

/* Past a colon. False: "points" is there again, which is where parsing will
 * end. */
static bool at_colon(struct eval_text *t)
{
	bool again;

	if (t->depth != 1 || t->member != EVAL_MEMBER_COLON)
		return true;
	t->member = EVAL_MEMBER_VALUE;
	again = t->is_points && t->has_points;
	t->has_points = t->has_points || t->is_points;
	return !again;
}

/* Past '[' or '{'. False: the points begin here. */
static bool at_opening(struct eval_text *t, char c)
{
	const bool is_value = t->depth == 1 && t->member == EVAL_MEMBER_VALUE;

	if (is_value)
		t->member = EVAL_MEMBER_BEHIND;
	if (c == '[' && is_value && t->is_points) {
		t->mode = EVAL_POINTS;
		return false;
	}
	t->depth++;
	return true;
}

/* Before or behind the object. False: what is wrong here ends the parsing. */
static bool outside(struct eval_text *t, char c)
{
	if (t->is_begun)
		return false;
	t->is_begun = true;
	t->is_plain = c != '{';
	t->depth = 1;
	t->member = EVAL_MEMBER_NAME;
	return true;
}

/* Past a character that is no string's. False: stop behind it. */
static bool in_structure(struct eval_text *t, const char *p)
{
	if (*p == ' ' || *p == '\n' || *p == '\r' || *p == '\t')
		return true;
	if (t->depth == 0)
		return outside(t, *p);
	switch (*p) {
	case '[':
	case '{':
		return at_opening(t, *p);
	case ']':
	case '}':
		t->depth--;
		return true;
	case ':':
		return at_colon(t);
	case ',':
		if (t->depth == 1)
			t->member = EVAL_MEMBER_NAME;
		return true;
	case '"':
		t->in_string = true;
		t->name = (size_t)(p + 1 - t->kept.data);
		return true;
	default:
		return true;
	}
}

/* Follows the text from *p to end; false: stop behind *p. */
static bool follow(struct eval_text *t, const char **p, const char *end)
{
	for (; *p < end && !t->is_plain; ++*p) {
		if (t->in_string)
			in_string(t, *p);
		else if (!in_structure(t, *p))
			return false;
	}
	*p = end;
	return true;
}

/* Whether the text kept is '{"points":[' but for white space. */
static bool only_points(const struct eval_bytes *kept)
{
	static const char only[] = "{\"points\":[";
	struct json_text text = json_text(kept->data, kept->length, 0, NULL);
	size_t i;

	for (i = 0; only[i]; i++) {
		if (i > 2 && i < 9 ? text.cursor == text.end ||
		    *text.cursor++ != only[i] : !json_take(&text, only[i]))
			return false;
	}
	return text.cursor == text.end;
}

/* Keeps a block of text, or less; *used is how much. */
static enum err keep(struct eval_text *t, const char *data, size_t length,
    size_t *used)
{
	const size_t old = t->kept.length;
	const char *p;
	enum err err;

	*used = length < BLOCK ? length : BLOCK;
	err = eval_bytes_add(&t->kept, data, *used);
	if (err)
		return err;
	p = t->kept.data + old;
	if (follow(t, &p, t->kept.data + t->kept.length))
		return ERR_OK;
	t->kept.length = (size_t)(p + 1 - t->kept.data);
	*used = t->kept.length - old;
	if (t->mode != EVAL_POINTS) {
		t->mode = EVAL_REST;
		return ERR_OK;
	}
	t->has_array = true;
	t->array = t->kept.length - 1;
	t->is_first = only_points(&t->kept);
	/* The scan begins at '['. */
	t->here.at = t->kept.data;
	t->here = json_mark_moved(t->here, p);
	t->scan.state = POINTS_BEGIN;
	--*used;
	return ERR_OK;
}

/* Behind the array. */
static void resume(struct eval_text *t)
{
	t->mode = EVAL_TEXT;
	if (!t->invalid)
		points_trim(&t->scan.points);
	t->scan.room = t->invalid ? 0 : t->scan.points.count;
}

static enum err skip_on(struct eval_text *t, struct json_text *text, bool last)
{
	enum err err;

	err = json_skip_on(&t->skipper, text, last, &t->scan.root,
	    t->scan.faults);
	if (!err && t->skipper.depth == 0)
		resume(t);
	return err;
}

/* Goes on with the array in a piece of the body; last: it ends there. Returns
 * how much it read. */
static size_t scan_piece(struct eval_text *t, const char *data, size_t length,
    bool last)
{
	struct json_text text = json_text(data, length, 0, NULL);
	enum err err = ERR_OK;

	text.origin = t->here;
	text.origin.at = data;
	if (t->mode == EVAL_POINTS) {
		err = points_scan_on(&t->scan, &text, last);
		if (!err && t->scan.state == POINTS_DONE)
			resume(t);
		if (err == ERR_INVALID) {
			t->invalid = true;
			t->mode = EVAL_SKIPPED;
			t->skipper = points_scan_rest(&t->scan);
			t->scan.points = (struct points){0};
			err = ERR_OK;
		}
	}
	if (!err && t->mode == EVAL_SKIPPED)
		err = skip_on(t, &text, last);
	if (err) {
		t->err = err;
		t->mode = EVAL_REST;
	}
	t->here = json_mark_moved(text.origin, text.cursor);
	return (size_t)(text.cursor - data);
}

/* The token at data goes on behind its length. */
static enum err begin_token(struct eval_text *t, const char *data,
    size_t length)
{
	t->token_is_string = *data == '"';
	t->token_escaped = false;
	json_token_end(data + t->token_is_string, data + length,
	    t->token_is_string, &t->token_escaped);
	t->token.length = 0;
	return eval_bytes_add(&t->token, data, length);
}

/* Goes on with a token that was cut; *used is how much of data it took. */
static enum err end_token(struct eval_text *t, const char *data, size_t length,
    size_t *used)
{
	const char *end = json_token_end(data, data + length,
	    t->token_is_string, &t->token_escaped);
	enum err err;

	/* With the character behind it, by which it is seen to end. */
	*used = end ? (size_t)(end - data) + !t->token_is_string : length;
	err = eval_bytes_add(&t->token, data, *used);
	if (err || !end)
		return err;
	length = scan_piece(t, t->token.data, t->token.length, false);
	assert(t->mode == EVAL_REST || t->mode == EVAL_TEXT ||
	    length == t->token.length);
	t->token.length = 0;
	return ERR_OK;
}

/* Goes on with the array; *used is how much of data was taken. */
static enum err scan(struct eval_text *t, const char *data, size_t length,
    size_t *used)
{
	if (t->token.length)
		return end_token(t, data, length, used);
	*used = scan_piece(t, data, length, false);
	if (*used == length || t->mode == EVAL_TEXT || t->mode == EVAL_REST)
		return ERR_OK;
	data += *used;
	length -= *used;
	*used += length;
	return begin_token(t, data, length);
}

enum err eval_text_feed(struct eval_text *t, const char *data, size_t length)
{
	enum err err = ERR_OK;
	size_t used;

	for (; length && t->mode != EVAL_REST && !err; length -= used) {
		err = t->mode == EVAL_TEXT ? keep(t, data, length, &used) :
		    scan(t, data, length, &used);
		data += used;
	}
	if (err) {
		t->err = err;
		t->mode = EVAL_REST;
	}
	if (t->mode == EVAL_TEXT || t->mode == EVAL_REST)
		drop(&t->token);
	/* Else an error of what precedes the points may come first. */
	return t->is_first || t->err == ERR_MEMORY ? t->err : ERR_OK;
}

enum err eval_text_finish(struct eval_text *t, bool with_scene,
    unsigned default_outputs, const struct document_limits *limits,
    struct eval_request *out, struct faults *faults)
{
	struct eval_splice splice = {.faults = t->scan.faults,
	    .points = &t->scan.points};
	const char *const text = t->kept.data ? t->kept.data : "";

	if (t->mode == EVAL_POINTS || t->mode == EVAL_SKIPPED)
		scan_piece(t, t->token.data ? t->token.data : "",
		    t->token.length, true);
	if (t->err == ERR_MEMORY)
		return ERR_MEMORY;
	splice.at = t->has_array ? text + t->array : NULL;
	splice.behind = t->here;
	splice.err = t->err;
	splice.invalid = t->invalid;
	return eval_splice_parse(text, t->kept.length, &splice, with_scene,
	    default_outputs, limits, t->scan.max_points, out, faults);
}
