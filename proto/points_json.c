/*
 * A JSON array of points, scanned as it stands and in whatever pieces: a tree
 * of a million values would take ten times as long and 300 bytes a point.
 *
 * Points that lie whole in a piece, and are right, take one call each; every
 * other one is read token by token, and that is what tells what is wrong.
 */
#include <math.h>
#include <stdint.h>
#include <stdlib.h>

#include "proto/json.h"
#include "proto/number.h"
#include "proto/points.h"
#include "proto/points_scan.h"

/* A point and its comma take at least 8 characters, mostly more than 30. */
#define CHARACTERS_PER_POINT 30

/* The place of number i of the array. */
struct spot {
	struct json_place point, number;
};

/* Fills where, and gives the place that names the number being read. */
static const struct json_place *spot(const struct points_scan *s,
    struct spot *where)
{
	const size_t point = s->points.count;

	if (s->points.flat) {
		where->number = json_element(&s->root,
		    3 * point + s->coordinate);
	} else {
		where->point = json_element(&s->root, point);
		where->number = json_element(&where->point, s->coordinate);
	}
	return &where->number;
}

static bool starts_number(const struct json_text *text)
{
	return text->cursor < text->end && (*text->cursor == '-' ||
	    (*text->cursor >= '0' && *text->cursor <= '9'));
}

static bool starts_value(const struct json_text *text)
{
	const char c = text->cursor < text->end ? *text->cursor : ' ';

	return c == '"' || c == '[' || c == '{' || c == 't' || c == 'f' ||
	    c == 'n' || starts_number(text);
}

/* Not what was expected here: JSON of another kind, or no JSON. */
static enum err unexpected(const struct points_scan *s,
    const struct json_text *text, const struct json_place *place,
    const char *invalid, const char *expected)
{
	if (starts_value(text)) {
		json_fault(s->faults, place, "%s", invalid);
		return ERR_INVALID;
	}
	return json_expected(text, place, expected, s->faults);
}

static enum err grow(struct points_scan *s, const struct json_text *text)
{
	const size_t guess = (size_t)(text->end - text->cursor) /
	    CHARACTERS_PER_POINT + 16;
	size_t room = s->room ? s->room + s->room / 2 : guess;
	float *xyz;

	if (room > s->max_points)
		room = s->max_points;
	if (room > SIZE_MAX / (3 * sizeof *xyz))
		return ERR_MEMORY;
	xyz = realloc(s->points.xyz, room * 3 * sizeof *xyz);
	if (!xyz)
		return ERR_MEMORY;
	s->points.xyz = xyz;
	s->room = room;
	return ERR_OK;
}

/* Makes room for one more point. */
static enum err begin_point(struct points_scan *s,
    const struct json_text *text)
{
	if (s->points.count == s->max_points) {
		json_fault(s->faults, &s->root, "more than %zu points",
		    s->max_points);
		return ERR_LIMIT;
	}
	s->coordinate = 0;
	return s->points.count == s->room ? grow(s, text) : ERR_OK;
}

static enum err wrong_arity(const struct points_scan *s, const char *how)
{
	const struct json_place place = json_element(&s->root,
	    s->points.count);

	json_fault(s->faults, &place, "point %zu has %s than 3 coordinates",
	    s->points.count, how);
	return ERR_INVALID;
}

static enum err read_begin(struct points_scan *s, struct json_text *text)
{
	s->state = POINTS_FIRST;
	if (json_take(text, '['))
		return ERR_OK;
	return unexpected(s, text, &s->root, "must be an array of points",
	    "expected '['");
}

static enum err read_first(struct points_scan *s, struct json_text *text)
{
	if (json_take(text, ']')) {
		s->state = POINTS_DONE;
		return ERR_OK;
	}
	if (text->cursor < text->end && *text->cursor == '[') {
		s->state = POINTS_POINT;
		return ERR_OK;
	}
	if (starts_number(text)) {
		s->points.flat = true;
		s->state = POINTS_NUMBER;
		return begin_point(s, text);
	}
	return unexpected(s, text, &s->root,
	    "must hold points [x, y, z], or numbers",
	    "expected a point or a number");
}

static enum err read_point(struct points_scan *s, struct json_text *text)
{
	const struct json_place place = json_element(&s->root,
	    s->points.count);

	if (!json_take(text, '['))
		return unexpected(s, text, &place, "a point must be an array "
		    "of 3 numbers, as the first one is", "expected '['");
	s->state = POINTS_OPENED;
	return begin_point(s, text);
}

static enum err read_opened(struct points_scan *s, struct json_text *text)
{
	s->state = POINTS_NUMBER;
	if (!json_take(text, ']'))
		return ERR_OK;
	s->state = POINTS_BEHIND;
	return wrong_arity(s, "fewer");
}

static enum err read_number(struct points_scan *s, struct json_text *text)
{
	float *const to = &s->points.xyz[3 * s->points.count + s->coordinate];
	struct spot where;
	double value;

	if (!starts_number(text))
		return unexpected(s, text, spot(s, &where),
		    "a coordinate must be a number", "expected a number");
	if (number_parse(&text->cursor, text->end, &value))
		return json_expected(text, spot(s, &where),
		    "not a JSON number", s->faults);
	s->state = POINTS_SEPARATOR;
	*to = (float)value;
	if (!isfinite(*to)) {
		json_fault(s->faults, spot(s, &where),
		    "point %zu: %c is not finite as float32", s->points.count,
		    "xyz"[s->coordinate]);
		return ERR_INVALID;
	}
	return ERR_OK;
}

/* Behind an element of the array. */
static enum err read_behind(struct points_scan *s, struct json_text *text)
{
	if (json_take(text, ',')) {
		s->state = POINTS_POINT;
		return ERR_OK;
	}
	if (json_take(text, ']')) {
		s->state = POINTS_DONE;
		return ERR_OK;
	}
	return json_expected(text, &s->root, "expected ',' or ']'", s->faults);
}

/* Behind a number of a point. */
static enum err read_in_point(struct points_scan *s, struct json_text *text)
{
	const struct json_place place = json_element(&s->root,
	    s->points.count);
	const bool is_last = s->coordinate == 2;

	if (json_take(text, is_last ? ']' : ',')) {
		s->state = is_last ? POINTS_BEHIND : POINTS_NUMBER;
		s->points.count += is_last;
		s->coordinate++;
		return ERR_OK;
	}
	if (json_take(text, is_last ? ',' : ']')) {
		s->state = is_last ? POINTS_NUMBER : POINTS_BEHIND;
		return wrong_arity(s, is_last ? "more" : "fewer");
	}
	return json_expected(text, &place, "expected ',' or ']'", s->faults);
}

/* Behind a number of a flat array. */
static enum err read_flat(struct points_scan *s, struct json_text *text)
{
	const bool more = json_take(text, ',');

	if (!more && !json_take(text, ']'))
		return json_expected(text, &s->root, "expected ',' or ']'",
		    s->faults);
	s->state = more ? POINTS_NUMBER : POINTS_DONE;
	s->points.count += s->coordinate == 2;
	s->coordinate = (s->coordinate + 1) % 3;
	if (more)
		return s->coordinate ? ERR_OK : begin_point(s, text);
	if (s->coordinate == 0)
		return ERR_OK;
	json_fault(s->faults, &s->root, "a flat array's length must be a "
	    "multiple of 3, not %zu", 3 * s->points.count + s->coordinate);
	return ERR_INVALID;
}

/* One token; the cursor is behind white space. */
static enum err step(struct points_scan *s, struct json_text *text)
{
	switch (s->state) {
	case POINTS_BEGIN:
		return read_begin(s, text);
	case POINTS_FIRST:
		return read_first(s, text);
	case POINTS_POINT:
		return read_point(s, text);
	case POINTS_OPENED:
		return read_opened(s, text);
	case POINTS_NUMBER:
		return read_number(s, text);
	case POINTS_BEHIND:
		return read_behind(s, text);
	default:
		return s->points.flat ? read_flat(s, text) :
		    read_in_point(s, text);
	}
}

/* Whether the number at the cursor, if there is one, is all there. */
static bool has_number(const struct json_text *text)
{
	bool unused = false;

	return json_token_end(text->cursor, text->end, false, &unused) != NULL;
}

static inline const char *pass_space(const char *p, const char *end)
{
	while (p < end && (*p == ' ' || *p == '\n' || *p == '\r' ||
	    *p == '\t'))
		p++;
	return p;
}

/* Behind c, or NULL if it is not what comes. */
static inline const char *pass(const char *p, const char *end, char c)
{
	if (p < end && *p == c)
		return p + 1;
	p = pass_space(p, end);
	return p < end && *p == c ? p + 1 : NULL;
}

/* A point and the comma behind it, whole and right, to xyz; behind it, or
 * NULL. */
static inline const char *whole_point(const char *p, const char *end,
    bool flat, float xyz[static 3])
{
	const char *behind;
	double value;
	int i;

	if (!flat)
		p = pass(p, end, '[');
	for (i = 0; i < 3 && p; i++) {
		p = pass_space(p, end);
		behind = number_parse_plain(p, end, &value);
		if (!behind)
			return NULL;
		xyz[i] = (float)value;
		p = pass(behind, end, i == 2 && !flat ? ']' : ',');
	}
	return p && !flat ? pass(p, end, ',') : p;
}

/* As many such points as there are and fit; between two of them. */
static void whole_points(struct points_scan *s, struct json_text *text)
{
	const bool flat = s->points.flat;
	const char *p = text->cursor, *behind;
	size_t i;

	/* The last point of the room is read token by token: a flat array's
	 * next one begins with making room. */
	for (i = s->points.count; i + 1 < s->room; i++) {
		behind = flat ?
		    whole_point(p, text->end, true, s->points.xyz + 3 * i) :
		    whole_point(p, text->end, false, s->points.xyz + 3 * i);
		if (!behind)
			break;
		p = behind;
	}
	text->cursor = p;
	s->points.count = i;
}

struct points_scan points_scan_init(const char *prefix, size_t max_points,
    struct faults *faults)
{
	return (struct points_scan){.root = json_root(prefix),
	    .max_points = max_points, .faults = faults};
}

enum err points_scan_on(struct points_scan *s, struct json_text *text,
    bool last)
{
	enum err err = ERR_OK;

	while (s->state != POINTS_DONE && !err) {
		if (s->state == POINTS_POINT || (s->state == POINTS_NUMBER &&
		    s->points.flat && s->coordinate == 0))
			whole_points(s, text);
		json_space(text);
		if (!last && (text->cursor == text->end ||
		    (s->state == POINTS_NUMBER && !has_number(text))))
			break;
		err = step(s, text);
	}
	if (err) {
		free(s->points.xyz);
		s->points.xyz = NULL;
		s->room = 0;
	}
	return err;
}

struct json_skipper points_scan_rest(const struct points_scan *s)
{
	const bool in_point = !s->points.flat && (s->state == POINTS_NUMBER ||
	    s->state == POINTS_SEPARATOR);
	const bool begins_value = s->state == POINTS_FIRST ||
	    s->state == POINTS_POINT || s->state == POINTS_NUMBER;

	return (struct json_skipper){begins_value ? JSON_SKIP_VALUE :
	    JSON_SKIP_BEHIND, s->state == POINTS_DONE ? 0 : 1 + in_point,
	    {false}};
}

void points_trim(struct points *points)
{
	float *xyz;

	if (!points->count)
		return;
	xyz = realloc(points->xyz, points->count * 3 * sizeof *xyz);
	if (xyz)
		points->xyz = xyz;
}

enum err points_read(struct json_text *text, const char *prefix,
    size_t max_points, struct points *out, struct faults *faults)
{
	struct points_scan s = points_scan_init(prefix, max_points, faults);
	enum err err;

	err = points_scan_on(&s, text, true);
	if (err)
		return err;
	points_trim(&s.points);
	*out = s.points;
	return ERR_OK;
}

enum err points_from_json(const char **cursor, const char *end,
    const char *prefix, size_t max_points, struct points *out,
    struct faults *faults)
{
	struct json_text text = json_text(*cursor, (size_t)(end - *cursor),
	    SIZE_MAX, NULL);
	enum err err;

	err = points_read(&text, prefix, max_points, out, faults);
	*cursor = text.cursor;
	return err;
}
