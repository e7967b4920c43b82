#include "proto/answer.h"

#include <assert.h>
#include <math.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include <cjson/cJSON.h>

#include "core/output.h"
#include "proto/fault.h"
#include "proto/number.h"
#include "proto/text.h"

/* A number and its comma; a row's brackets and comma. */
#define NUMBER_ROOM (NUMBER_FLOAT_MAX + 1)
#define ROW_ROOM 3
/* {"count":N,"draft":true and the names of all outputs, with brackets, and what printing
 * writes behind the last number. */
#define FRAME_ROOM 256

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

/* Bytes that no answer exceeds, or 0 if that overflows. */
static size_t room_for(size_t count, unsigned outputs)
{
	const size_t row = (size_t)output_row_floats(outputs) * NUMBER_ROOM +
	    PARTS * ROW_ROOM;

	return count > (SIZE_MAX - FRAME_ROOM) / row ? 0 :
	    FRAME_ROOM + count * row;
}

static char *put_text(char *out, const char *text)
{
	const size_t n = strlen(text);

	memcpy(out, text, n);
	return out + n;
}

/* What is printed; floats may be NULL if count is 0. */
struct rows {
	const float *floats;
	size_t count, stride;
};

static char *put_numbers(char *out, const float *numbers, int n)
{
	int i;

	for (i = 0; i < n; i++) {
		out += number_print_float(numbers[i], out);
		*out++ = ',';
	}
	return out;
}

/* One part of all rows, as an array: columns floats of each row from first. */
static char *put_part(char *out, const struct rows *rows, int first,
    int columns, bool nested)
{
	size_t i;

	*out++ = '[';
	for (i = 0; i < rows->count; i++) {
		if (nested)
			*out++ = '[';
		out = put_numbers(out,
		    rows->floats + i * rows->stride + first, columns);
		if (nested) {
			out[-1] = ']';
			*out++ = ',';
		}
	}
	if (rows->count)
		out--;
	*out++ = ']';
	return out;
}

enum err answer_json(const float *rows, size_t count, unsigned outputs,
    unsigned flags, char **out, size_t *length)
{
	const struct rows all = {rows, count,
	    (size_t)output_row_floats(outputs)};
	const size_t room = room_for(count, outputs);
	char *text, *p, *trimmed;
	int first = 0;
	size_t i;

	text = room ? malloc(room) : NULL;
	if (!text)
		return ERR_MEMORY;
	p = text + sprintf(text, "{\"count\":%zu%s", count,
	    flags & ANSWER_DRAFT ? ",\"draft\":true" : "");
	for (i = 0; i < PARTS; i++) {
		if (!(outputs & parts[i].bit))
			continue;
		p = put_text(p, ",\"");
		p = put_text(p, parts[i].name);
		p = put_text(p, "\":");
		p = put_part(p, &all, first, parts[i].floats,
		    parts[i].floats > 1 && !(flags & ANSWER_FLAT));
		first += parts[i].floats;
	}
	*p++ = '}';
	assert((size_t)(p - text) <= room);
	trimmed = realloc(text, (size_t)(p - text));
	*out = trimmed ? trimmed : text;
	*length = (size_t)(p - text);
	return ERR_OK;
}

size_t answer_npy_header(size_t count, int columns,
    char out[static ANSWER_NPY_HEADER_MAX])
{
	/* Magic, version 1.0, and two bytes for the length of the rest. */
	const size_t start = 10;
	size_t n, total;

	memcpy(out, "\x93NUMPY\x01\x00", 8);
	n = start + (size_t)snprintf(out + start,
	    ANSWER_NPY_HEADER_MAX - start, "{'descr': '<f4', "
	    "'fortran_order': False, 'shape': (%zu, %d), }", count, columns);
	total = (n + 1 + 63) / 64 * 64;
	assert(total <= ANSWER_NPY_HEADER_MAX);
	memset(out + n, ' ', total - n - 1);
	out[total - 1] = '\n';
	out[8] = (char)((total - start) & 0xff);
	out[9] = (char)((total - start) >> 8);
	return total;
}

/* Adds text as clean UTF-8. */
static bool add_text(cJSON *object, const char *name, const char *text)
{
	const size_t size = strlen(text) + 16;
	char *clean = malloc(size);
	bool added;

	if (!clean)
		return false;
	text_clean(text, 0, clean, size);
	added = cJSON_AddStringToObject(object, name, clean) != NULL;
	free(clean);
	return added;
}

static bool add_fault(cJSON *errors, const struct fault *fault)
{
	cJSON *entry = cJSON_CreateObject();

	if (!entry)
		return false;
	cJSON_AddItemToArray(errors, entry);
	return cJSON_AddStringToObject(entry, "pointer", fault->pointer) &&
	    cJSON_AddStringToObject(entry, "detail", fault->detail);
}

static bool add_faults(cJSON *problem, const struct faults *faults)
{
	cJSON *errors = cJSON_AddArrayToObject(problem, "errors");
	size_t i;

	if (!errors)
		return false;
	for (i = 0; i < faults->count && i < FAULT_MAX; i++) {
		if (!add_fault(errors, &faults->list[i]))
			return false;
	}
	return faults->count <= FAULT_MAX || cJSON_AddNumberToObject(problem,
	    "error_count", (double)faults->count);
}

char *answer_problem(int status, const char *slug, const char *title,
    const char *detail, const struct faults *faults, size_t *length)
{
	cJSON *problem = cJSON_CreateObject();
	char type[80], *text = NULL;
	bool fine;

	snprintf(type, sizeof type, "/problems/%s", slug);
	fine = problem && add_text(problem, "type", type) &&
	    add_text(problem, "title", title) &&
	    cJSON_AddNumberToObject(problem, "status", status) &&
	    (!detail || add_text(problem, "detail", detail));
	if (fine && faults && faults->count)
		fine = add_faults(problem, faults);
	if (fine)
		text = cJSON_PrintUnformatted(problem);
	cJSON_Delete(problem);
	if (text)
		*length = strlen(text);
	return text;
}
