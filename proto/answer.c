#include "proto/answer.h"

#include <assert.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include <cjson/cJSON.h>

#include "core/output.h"
#include "proto/answer_print.h"
#include "proto/fault.h"
#include "proto/number.h"
#include "proto/text.h"

/* A number and its comma; a row's brackets and comma. */
#define NUMBER_ROOM (NUMBER_FLOAT_MAX + 1)
#define ROW_ROOM 3
/* {"count":N,"draft":true and the names of all outputs, with brackets, and the
 * room that printing wants beyond. */
#define FRAME_ROOM (256 + ANSWER_PRINT_LEAST)

/* Outputs there are. */
#define PARTS 6

/* Bytes that no answer exceeds, or 0 if that overflows. */
static size_t room_for(size_t count, unsigned outputs)
{
	const size_t row = (size_t)output_row_floats(outputs) * NUMBER_ROOM +
	    PARTS * ROW_ROOM;

	return count > (SIZE_MAX - FRAME_ROOM) / row ? 0 :
	    FRAME_ROOM + count * row;
}

/* Prints all of print, which has not begun. */
static enum err print_whole(struct answer_print print, char **out,
    size_t *length)
{
	const size_t room = room_for(print.count, print.outputs);
	char *text, *trimmed;

	text = room ? malloc(room) : NULL;
	if (!text)
		return ERR_MEMORY;
	*length = answer_print(&print, text, room);
	assert(print.is_done);
	trimmed = realloc(text, *length);
	*out = trimmed ? trimmed : text;
	return ERR_OK;
}

enum err answer_json(const float *rows, size_t count, unsigned outputs,
    unsigned flags, char **out, size_t *length)
{
	return print_whole((struct answer_print){.rows = rows, .count = count,
	    .outputs = outputs, .flags = flags,
	    .stride = (size_t)output_row_floats(outputs)}, out, length);
}

enum err answer_grid_json(const float *rows, const size_t counts[static 3],
    unsigned outputs, unsigned flags, char **out, size_t *length)
{
	return print_whole((struct answer_print){.rows = rows,
	    .count = counts[0] * counts[1] * counts[2], .outputs = outputs,
	    .flags = flags, .stride = (size_t)output_row_floats(outputs),
	    .counts = counts}, out, length);
}

/* The header of an array of that shape, a Python tuple. */
static size_t npy_header(const char *shape,
    char out[static ANSWER_NPY_HEADER_MAX])
{
	/* Magic, version 1.0, and two bytes for the length of the rest. */
	const size_t start = 10;
	size_t n, total;

	memcpy(out, "\x93NUMPY\x01\x00", 8);
	n = start + (size_t)snprintf(out + start,
	    ANSWER_NPY_HEADER_MAX - start, "{'descr': '<f4', "
	    "'fortran_order': False, 'shape': %s, }", shape);
	total = (n + 1 + 63) / 64 * 64;
	assert(total <= ANSWER_NPY_HEADER_MAX);
	memset(out + n, ' ', total - n - 1);
	out[total - 1] = '\n';
	out[8] = (char)((total - start) & 0xff);
	out[9] = (char)((total - start) >> 8);
	return total;
}

size_t answer_npy_header(size_t count, int columns,
    char out[static ANSWER_NPY_HEADER_MAX])
{
	char shape[40];

	snprintf(shape, sizeof shape, "(%zu, %d)", count, columns);
	return npy_header(shape, out);
}

size_t answer_grid_npy_header(const size_t counts[static 3], int columns,
    char out[static ANSWER_NPY_HEADER_MAX])
{
	char shape[48], last[16] = "";

	if (columns > 1)
		snprintf(last, sizeof last, ", %d", columns);
	snprintf(shape, sizeof shape, "(%zu, %zu, %zu%s)", counts[0],
	    counts[1], counts[2], last);
	return npy_header(shape, out);
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
