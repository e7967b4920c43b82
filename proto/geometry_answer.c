#include "proto/geometry_answer.h"

#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "core/project.h"
#include "core/vec3.h"
#include "proto/number.h"

/* Room that a row's part of a column takes at most, but for a node's. */
#define PART_MOST (3 * (NUMBER_FLOAT_MAX + 1) + 2 + NUMBER_FLOAT_ROOM)

/* A text that grows. */
struct text {
	char *data;
	size_t length, room;
	bool is_full; /* out of memory: nothing more is written */
};

/* Where to write up to size bytes, or NULL. */
static char *text_room(struct text *t, size_t size)
{
	size_t room = t->room;
	char *data;

	if (t->is_full)
		return NULL;
	if (t->room - t->length >= size)
		return t->data + t->length;
	room += room / 2 + size + 4096;
	data = realloc(t->data, room);
	if (data == NULL) {
		t->is_full = true;
		return NULL;
	}
	t->data = data;
	t->room = room;
	return data + t->length;
}

static void put(struct text *t, const char *string)
{
	const size_t n = strlen(string);
	char *to = text_room(t, n);

	if (to == NULL)
		return;
	memcpy(to, string, n);
	t->length += n;
}

static enum err finish(struct text *t, char **out, size_t *length)
{
	if (t->is_full) {
		free(t->data);
		return ERR_MEMORY;
	}
	*out = t->data;
	*length = t->length;
	return ERR_OK;
}

/* ---- columns ---- */

struct column {
	const char *name;
	size_t first, floats; /* of a row */
	bool is_flag;         /* 0 or 1, as false or true */
	bool is_normal;       /* -v / |v| instead of v */
	bool has_nulls;       /* where the row's first number is 0 */
};

static char *print_numbers(char *to, const float *numbers, size_t n)
{
	for (size_t i = 0; i < n; i++) {
		to += number_print_float(numbers[i], to);
		*to++ = ',';
	}
	return to;
}

static char *print_word(char *to, const char *word)
{
	const size_t n = strlen(word);

	memcpy(to, word, n);
	to[n] = ',';
	return to + n + 1;
}

static void normal_of(const float gradient[static 3], float out[static 3])
{
	const struct vec3 g = {gradient[0], gradient[1], gradient[2]};
	struct vec3 n = {0.0, 0.0, 0.0};

	if (g.x != 0.0 || g.y != 0.0 || g.z != 0.0)
		n = vec3_scale(-1.0, vec3_unit(g));
	out[0] = (float)n.x;
	out[1] = (float)n.y;
	out[2] = (float)n.z;
}

/* What column c has of row, and a comma. */
static char *print_part(char *to, const struct column *c, const float *row,
    bool is_flat)
{
	const bool nested = c->floats > 1 && !is_flat;
	const float *numbers = row + c->first;
	float normal[3];

	if (c->is_flag)
		return print_word(to, *numbers != 0.0f ? "true" : "false");
	if (c->has_nulls && row[0] == 0.0f) {
		for (size_t i = 0; i < (nested ? 1 : c->floats); i++)
			to = print_word(to, "null");
		return to;
	}
	if (c->is_normal) {
		normal_of(numbers, normal);
		numbers = normal;
	}
	if (nested)
		*to++ = '[';
	to = print_numbers(to, numbers, c->floats);
	if (nested) {
		to[-1] = ']';
		*to++ = ',';
	}
	return to;
}

static void begin_column(struct text *t, const char *name)
{
	put(t, ",\"");
	put(t, name);
	put(t, "\":[");
}

/* count: of parts, each of which has put a comma behind it. */
static void end_column(struct text *t, size_t count)
{
	if (count > 0 && !t->is_full)
		t->length--;
	put(t, "]");
}

static void put_column(struct text *t, const struct column *c,
    const float *rows, size_t stride, size_t count, bool is_flat)
{
	begin_column(t, c->name);
	for (size_t i = 0; i < count; i++) {
		char *to = text_room(t, PART_MOST);

		if (to == NULL)
			return;
		t->length += (size_t)(print_part(to, c, rows + stride * i,
		    is_flat) - to);
	}
	end_column(t, count);
}

static void put_count(struct text *t, size_t count)
{
	char digits[24];
	size_t n = sizeof digits - 1;

	digits[n] = '\0';
	do
		digits[--n] = (char)('0' + count % 10);
	while ((count /= 10) > 0);
	put(t, "{\"count\":");
	put(t, digits + n);
}

/* ---- answers ---- */

static void put_nodes(struct text *t, const char *const *nodes, size_t count)
{
	begin_column(t, "node");
	for (size_t i = 0; i < count; i++) {
		if (nodes[i] != NULL) {
			put(t, "\"");
			put(t, nodes[i]);
			put(t, "\",");
		} else {
			put(t, "null,");
		}
	}
	end_column(t, count);
}

enum err raycast_answer_json(const float *rows, size_t count,
    const char *const *nodes, bool is_flat, char **out, size_t *length)
{
	static const struct column columns[] = {
		{.name = "hit", .first = RAY_HIT, .floats = 1,
		    .is_flag = true},
		{.name = "distance", .first = RAY_DISTANCE, .floats = 1,
		    .has_nulls = true},
		{.name = "position", .first = RAY_POSITION, .floats = 3,
		    .has_nulls = true},
		{.name = "value", .first = RAY_VALUE, .floats = 1,
		    .has_nulls = true},
		{.name = "gradient", .first = RAY_GRADIENT, .floats = 3,
		    .has_nulls = true},
		{.name = "normal", .first = RAY_GRADIENT, .floats = 3,
		    .is_normal = true, .has_nulls = true},
		{.name = "color", .first = RAY_COLOR, .floats = 3,
		    .has_nulls = true},
	};
	struct text t = {0};

	put_count(&t, count);
	for (size_t i = 0; i < sizeof columns / sizeof *columns; i++)
		put_column(&t, &columns[i], rows, RAY_COLUMNS, count, is_flat);
	put_nodes(&t, nodes, count);
	put(&t, "}");
	return finish(&t, out, length);
}

enum err project_answer_json(const float *rows, size_t count, bool is_flat,
    char **out, size_t *length)
{
	static const struct column columns[] = {
		{.name = "converged", .first = 0, .floats = 1,
		    .is_flag = true},
		{.name = "position", .first = 1, .floats = 3},
		{.name = "distance", .first = 4, .floats = 1},
		{.name = "value", .first = 5, .floats = 1},
		{.name = "normal", .first = 6, .floats = 3},
	};
	struct text t = {0};

	put_count(&t, count);
	for (size_t i = 0; i < sizeof columns / sizeof *columns; i++)
		put_column(&t, &columns[i], rows, PROJECTION_FLOATS, count,
		    is_flat);
	put(&t, "}");
	return finish(&t, out, length);
}

size_t slice_npy_header(size_t height, size_t width, int columns,
    char out[static SLICE_NPY_HEADER_MAX])
{
	static const char magic[] = "\x93NUMPY\x01\x00";
	const size_t length = SLICE_NPY_HEADER_MAX, before = 10;
	char last[16] = "";
	int n;

	if (columns > 1)
		snprintf(last, sizeof last, ", %d", columns);
	memset(out, ' ', length);
	memcpy(out, magic, 8);
	out[8] = (char)(length - before);
	out[9] = 0;
	n = snprintf(out + before, length - before, "{'descr': '<f4', "
	    "'fortran_order': False, 'shape': (%zu, %zu%s), }", height, width,
	    last);
	out[before + (size_t)n] = ' ';
	out[length - 1] = '\n';
	return length;
}
