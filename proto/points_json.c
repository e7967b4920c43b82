/*
 * A JSON array of points, scanned as it stands: a tree of a million values
 * would take ten times as long and 300 bytes a point.
 */
#include <math.h>
#include <stdint.h>
#include <stdlib.h>

#include "proto/json.h"
#include "proto/number.h"
#include "proto/points.h"

/* A point and its comma take at least 8 characters, mostly more than 30. */
#define CHARACTERS_PER_POINT 30

/* One array being scanned. */
struct scan {
	struct json_text *text;
	struct json_place root;
	size_t max_points;
	struct points points;
	size_t room;          /* for points */
	struct faults *faults;
};

/* The place of number i of the array. */
struct spot {
	struct json_place point, number;
};

/* Fills where, and gives the place that names number i. */
static const struct json_place *spot(const struct scan *s, size_t i,
    struct spot *where)
{
	if (s->points.flat) {
		where->number = json_element(&s->root, i);
	} else {
		where->point = json_element(&s->root, i / 3);
		where->number = json_element(&where->point, i % 3);
	}
	return &where->number;
}

static bool starts_value(const struct json_text *text)
{
	const char c = text->cursor < text->end ? *text->cursor : ' ';

	return c == '"' || c == '[' || c == '{' || c == 't' || c == 'f' ||
	    c == 'n' || c == '-' || (c >= '0' && c <= '9');
}

/* Not what was expected here: JSON of another kind, or no JSON. */
static enum err unexpected(const struct scan *s,
    const struct json_place *place, const char *invalid, const char *expected)
{
	if (starts_value(s->text)) {
		json_fault(s->faults, place, "%s", invalid);
		return ERR_INVALID;
	}
	return json_expected(s->text, place, expected, s->faults);
}

static enum err grow(struct scan *s)
{
	const size_t guess = (size_t)(s->text->end - s->text->cursor) /
	    CHARACTERS_PER_POINT + 16;
	const size_t room = s->room ? s->room + s->room / 2 : guess;
	float *xyz;

	if (room > SIZE_MAX / (3 * sizeof *xyz))
		return ERR_MEMORY;
	xyz = realloc(s->points.xyz, room * 3 * sizeof *xyz);
	if (!xyz)
		return ERR_MEMORY;
	s->points.xyz = xyz;
	s->room = room;
	return ERR_OK;
}

/* Number i, after white space. */
static enum err read_coordinate(struct scan *s, size_t i)
{
	struct json_text *text = s->text;
	struct spot where;
	double value;

	json_space(text);
	if (text->cursor == text->end || (*text->cursor != '-' &&
	    (*text->cursor < '0' || *text->cursor > '9')))
		return unexpected(s, spot(s, i, &where),
		    "a coordinate must be a number", "expected a number");
	if (number_parse(&text->cursor, text->end, &value))
		return json_expected(text, spot(s, i, &where),
		    "not a JSON number", s->faults);
	s->points.xyz[i] = (float)value;
	if (!isfinite(s->points.xyz[i])) {
		json_fault(s->faults, spot(s, i, &where),
		    "point %zu: %c is not finite as float32", i / 3,
		    "xyz"[i % 3]);
		return ERR_INVALID;
	}
	return ERR_OK;
}

/* Makes room for one more point. */
static enum err begin_point(struct scan *s)
{
	if (s->points.count == s->max_points) {
		json_fault(s->faults, &s->root, "more than %zu points",
		    s->max_points);
		return ERR_LIMIT;
	}
	return s->points.count == s->room ? grow(s) : ERR_OK;
}

static enum err wrong_arity(const struct scan *s, const char *how)
{
	const struct json_place place = json_element(&s->root,
	    s->points.count);

	json_fault(s->faults, &place, "point %zu has %s than 3 coordinates",
	    s->points.count, how);
	return ERR_INVALID;
}

/* "x, y, z]", behind its '['. */
static enum err read_triple(struct scan *s)
{
	const struct json_place place = json_element(&s->root,
	    s->points.count);
	enum err err;
	size_t i;

	if (json_take(s->text, ']'))
		return wrong_arity(s, "fewer");
	for (i = 0; i < 3; i++) {
		err = read_coordinate(s, 3 * s->points.count + i);
		if (err)
			return err;
		if (json_take(s->text, i < 2 ? ',' : ']'))
			continue;
		if (json_take(s->text, i < 2 ? ']' : ','))
			return wrong_arity(s, i < 2 ? "fewer" : "more");
		return json_expected(s->text, &place, "expected ',' or ']'",
		    s->faults);
	}
	return ERR_OK;
}

/* Behind an element: *more says whether another comes. */
static enum err next(struct scan *s, bool *more)
{
	*more = json_take(s->text, ',');
	if (*more || json_take(s->text, ']'))
		return ERR_OK;
	return json_expected(s->text, &s->root, "expected ',' or ']'",
	    s->faults);
}

static enum err read_nested(struct scan *s)
{
	struct json_place place = json_element(&s->root, 0);
	bool more = true;
	enum err err;

	while (more) {
		place.index = s->points.count;
		if (!json_take(s->text, '['))
			return unexpected(s, &place, "a point must be an array "
			    "of 3 numbers, as the first one is",
			    "expected '['");
		err = begin_point(s);
		if (!err)
			err = read_triple(s);
		if (err)
			return err;
		s->points.count++;
		err = next(s, &more);
		if (err)
			return err;
	}
	return ERR_OK;
}

static enum err read_flat(struct scan *s)
{
	size_t i;
	bool more = true;
	enum err err;

	s->points.flat = true;
	for (i = 0; more; i++) {
		err = i % 3 ? ERR_OK : begin_point(s);
		if (!err)
			err = read_coordinate(s, i);
		if (!err)
			err = next(s, &more);
		if (err)
			return err;
		s->points.count += i % 3 == 2;
	}
	if (i % 3 == 0)
		return ERR_OK;
	json_fault(s->faults, &s->root, "a flat array's length must be a "
	    "multiple of 3, not %zu", i);
	return ERR_INVALID;
}

static enum err read_points(struct scan *s)
{
	if (!json_take(s->text, '['))
		return unexpected(s, &s->root,
		    "must be an array of points", "expected '['");
	if (json_take(s->text, ']'))
		return ERR_OK;
	json_space(s->text);
	if (s->text->cursor < s->text->end && *s->text->cursor == '[')
		return read_nested(s);
	if (s->text->cursor < s->text->end && (*s->text->cursor == '-' ||
	    (*s->text->cursor >= '0' && *s->text->cursor <= '9')))
		return read_flat(s);
	return unexpected(s, &s->root, "must hold points [x, y, z], or numbers",
	    "expected a point or a number");
}

/* Gives back what growing took too much. */
static void trim(struct points *points)
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
	struct scan s = {.text = text, .root = json_root(prefix),
	    .max_points = max_points, .faults = faults};
	enum err err;

	err = read_points(&s);
	if (err) {
		points_fini(&s.points);
		return err;
	}
	trim(&s.points);
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
