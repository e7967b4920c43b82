#include "proto/answer_print.h"

#include <assert.h>
#include <stdio.h>
#include <string.h>

#include "core/output.h"
#include "proto/answer.h"
#include "proto/number.h"

static const struct {
	const char *name;
	unsigned bit;
	int floats;
} parts[] = {
	{"value", OUTPUT_VALUE, 1},
	{"gradient", OUTPUT_GRADIENT, 3},
	{"hessian", OUTPUT_HESSIAN, 6},
	{"color", OUTPUT_COLOR, 3},
	{"normal", OUTPUT_NORMAL, 3},
	{"curvature", OUTPUT_CURVATURE, 2},
};

#define PARTS (sizeof parts / sizeof *parts)

/* Most bytes of a row and its comma, and what printing writes behind a number
 * that will be something else, or nothing. */
#define ROW_MOST (6 * (NUMBER_FLOAT_MAX + 1) + 3 + NUMBER_FLOAT_ROOM - \
	NUMBER_FLOAT_MAX - 1)

_Static_assert(ROW_MOST + 1 <= ANSWER_PRINT_LEAST, "a row must fit");

/* Numbers, each with a comma. */
static inline char *put_numbers(char *out, const float *numbers, int n)
{
	int i;

	for (i = 0; i < n; i++) {
		out += number_print_float(numbers[i], out);
		*out++ = ',';
	}
	return out;
}

/* Rows from p->row on, each with a comma, while there is room. */
static char *put_rows(struct answer_print *p, char *out, const char *end)
{
	const int columns = parts[p->part].floats;
	const bool nested = columns > 1 && !(p->flags & ANSWER_FLAT);
	const float *row = p->rows + p->row * p->stride + p->first;
	const size_t room = (size_t)columns * (NUMBER_FLOAT_MAX + 1) +
	    ROW_MOST - 6 * (NUMBER_FLOAT_MAX + 1);

	for (; p->row < p->count && (size_t)(end - out) >= room; p->row++) {
		if (nested)
			*out++ = '[';
		out = put_numbers(out, row, columns);
		if (nested) {
			out[-1] = ']';
			*out++ = ',';
		}
		row += p->stride;
	}
	/* Nothing follows the last one. */
	return p->row == p->count ? out - 1 : out;
}

static char *put_text(char *out, const char *text)
{
	const size_t n = strlen(text);

	memcpy(out, text, n);
	return out + n;
}

/* The next part that was asked for begins, or the answer ends. */
static char *put_name(struct answer_print *p, char *out)
{
	while (p->part < PARTS && !(p->outputs & parts[p->part].bit))
		p->part++;
	if (p->part == PARTS) {
		p->is_done = true;
		*out++ = '}';
		return out;
	}
	out = put_text(out, ",\"");
	out = put_text(out, parts[p->part].name);
	out = put_text(out, "\":[");
	p->is_open = true;
	p->row = 0;
	return out;
}

static char *put_head(struct answer_print *p, char *out)
{
	const size_t *n = p->counts;

	p->is_begun = true;
	out += sprintf(out, "{\"count\":%zu%s", p->count,
	    p->flags & ANSWER_DRAFT ? ",\"draft\":true" : "");
	if (n != NULL)
		out += sprintf(out, ",\"counts\":[%zu,%zu,%zu]", n[0], n[1],
		    n[2]);
	return out;
}

static char *put_end_of_part(struct answer_print *p, char *out)
{
	p->is_open = false;
	p->first += (size_t)parts[p->part].floats;
	p->part++;
	*out++ = ']';
	return out;
}

size_t answer_print(struct answer_print *p, char *to, size_t size)
{
	const char *const end = to + size;
	char *out = to;

	assert(size >= ANSWER_PRINT_LEAST);
	while (!p->is_done && end - out >= ANSWER_PRINT_LEAST) {
		if (!p->is_begun)
			out = put_head(p, out);
		else if (!p->is_open)
			out = put_name(p, out);
		else if (p->row < p->count)
			out = put_rows(p, out, end);
		else
			out = put_end_of_part(p, out);
	}
	return (size_t)(out - to);
}
