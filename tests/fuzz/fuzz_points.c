/*
 * Points, by the first byte: raw, npy, or JSON. What is accepted is finite and
 * within the limit; as JSON, printed and read again it is the same.
 */
#include <math.h>
#include <stddef.h>
#include <stdint.h>
#include <stdlib.h>
#include <string.h>

#include "core/output.h"
#include "proto/answer.h"
#include "proto/fault.h"
#include "proto/number.h"
#include "proto/points.h"

#define POINTS_MAX 1000

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size);

static void demand(int fine)
{
	if (!fine)
		abort();
}

static enum err read_points(int kind, const char *data, size_t size,
    struct points *points, struct faults *faults)
{
	const char *cursor = data;
	enum err err;

	if (kind == 0)
		return points_from_octets(data, size, POINTS_MAX, points,
		    faults);
	if (kind == 1)
		return points_from_npy(data, size, POINTS_MAX, points, faults);
	err = points_from_json(&cursor, data + size, "/points", POINTS_MAX,
	    points, faults);
	demand(cursor >= data && cursor <= data + size);
	return err;
}

/* Written as the answer's gradients, numbers come back as they were. */
static void check_round_trip(const struct points *points)
{
	struct points again = {0};
	struct faults faults = {0};
	const char *cursor;
	char *text;
	size_t length;

	demand(answer_json(points->xyz, points->count, OUTPUT_GRADIENT,
	    points->flat, &text, &length) == ERR_OK);
	cursor = memchr(text, '[', length);
	demand(cursor != NULL);
	demand(points_from_json(&cursor, text + length, "", POINTS_MAX, &again,
	    &faults) == ERR_OK);
	demand(cursor == text + length - 1);
	demand(again.count == points->count && again.flat == points->flat);
	/* By value: -0 is printed as 0. */
	for (size_t i = 0; i < 3 * points->count; i++)
		demand(again.xyz[i] == points->xyz[i]);
	free(text);
	points_fini(&again);
}

static void check_number(const char *data, size_t size)
{
	const char *cursor = data;
	char *copy = malloc(size + 1);
	double value;

	demand(copy != NULL);
	memcpy(copy, data, size);
	copy[size] = '\0';
	if (number_parse(&cursor, data + size, &value) == 0)
		demand(value == strtod(copy, NULL) ||
		    memchr(copy, 'x', size) || memchr(copy, 'X', size));
	free(copy);
}

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size)
{
	struct points points = {0};
	struct faults faults = {0};
	enum err err;
	size_t i;

	if (size == 0)
		return 0;
	err = read_points(data[0] % 4, (const char *)data + 1, size - 1,
	    &points, &faults);
	demand((err == ERR_OK) == (faults.count == 0));
	demand(err == ERR_OK || !points.xyz);
	demand(points.count <= POINTS_MAX);
	for (i = 0; i < 3 * points.count; i++)
		demand(isfinite(points.xyz[i]));
	if (err == ERR_OK)
		check_round_trip(&points);
	points_fini(&points);
	check_number((const char *)data + 1, size - 1);
	return 0;
}
