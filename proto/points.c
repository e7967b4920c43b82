#include "proto/points.h"

#include <endian.h>
#include <math.h>
#include <stdint.h>
#include <stdlib.h>
#include <string.h>

#include "proto/fault.h"
#include "proto/points_binary.h"
#include "proto/points_scan.h"

/* Numbers of a loop that the compiler can make vectors of. */
#define BLOCK 64
/* Numbers that there is room for at first. */
#define ROOM_FIRST 1024

void points_fini(struct points *points)
{
	free(points->xyz);
	*points = (struct points){0};
}

enum err points_too_many(size_t max_points, struct faults *faults)
{
	faults_add(faults, "", "more than %zu points", max_points);
	return ERR_LIMIT;
}

/* The bits of an infinity or of what is no number, without their sign. */
#define EXPONENT_BITS 0x7f800000u

/* 1 if f, as bits, is not finite, else 0; without a branch. */
static inline uint32_t is_wrong(uint32_t bits)
{
	return ((bits & EXPONENT_BITS) + 0x00800000u) >> 31;
}

/* n little-endian float32 to out; not 0 if one is not finite. Inline: n is a
 * constant where it matters. */
static inline uint32_t load_floats(const unsigned char *restrict data,
    size_t n, float *restrict out)
{
	uint32_t wrong = 0, bits;
	size_t i;

	for (i = 0; i < n; i++) {
		memcpy(&bits, data + i * sizeof bits, sizeof bits);
		bits = le32toh(bits);
		wrong |= is_wrong(bits);
		memcpy(&out[i], &bits, sizeof bits);
	}
	return wrong;
}

/* The same for float64. */
static inline uint32_t load_doubles(const unsigned char *restrict data,
    size_t n, float *restrict out)
{
	uint64_t bits;
	uint32_t wrong = 0, single;
	double value;
	size_t i;

	for (i = 0; i < n; i++) {
		memcpy(&bits, data + i * sizeof bits, sizeof bits);
		bits = le64toh(bits);
		memcpy(&value, &bits, sizeof bits);
		out[i] = (float)value;
		memcpy(&single, &out[i], sizeof single);
		wrong |= is_wrong(single);
	}
	return wrong;
}

static uint32_t load(const unsigned char *data, size_t n, bool is_double,
    float *out)
{
	uint32_t wrong = 0;
	size_t i;

	for (i = 0; i + BLOCK <= n; i += BLOCK) {
		wrong |= is_double ? load_doubles(data + 8 * i, BLOCK,
		    out + i) : load_floats(data + 4 * i, BLOCK, out + i);
	}
	return wrong | (is_double ? load_doubles(data + 8 * i, n - i, out + i) :
	    load_floats(data + 4 * i, n - i, out + i));
}

/* Tells those of n numbers that are not finite; they come first'th. */
static void not_finite(const float *xyz, size_t n, size_t first,
    struct faults *faults)
{
	size_t i;

	for (i = 0; i < n; i++) {
		if (!isfinite(xyz[i]))
			faults_add(faults, "",
			    "point %zu: %c is not finite as float32",
			    (first + i) / 3, "xyz"[(first + i) % 3]);
	}
}

void points_arrival_init(struct points_arrival *a, bool is_double,
    size_t max_points, size_t expected_points, struct faults *faults)
{
	const size_t most = SIZE_MAX / (3 * sizeof *a->xyz);

	*a = (struct points_arrival){.is_double = is_double, .faults = faults,
	    .most = 3 * (max_points < most ? max_points : most),
	    .expected = 3 * (expected_points < most ? expected_points : most)};
}

void points_arrival_fini(struct points_arrival *a)
{
	free(a->xyz);
	a->xyz = NULL;
	a->room = 0;
}

/* Room for n more numbers: twice what is needed, or all that will come. */
static enum err make_room(struct points_arrival *a, size_t n)
{
	const size_t need = a->count + n;
	size_t room = need > a->most / 2 ? a->most : 2 * need;
	float *xyz;

	if (need <= a->room)
		return ERR_OK;
	if (room < ROOM_FIRST)
		room = ROOM_FIRST;
	if (a->expected >= need && room > a->expected)
		room = a->expected;
	xyz = realloc(a->xyz, room * sizeof *xyz);
	if (!xyz)
		return ERR_MEMORY;
	a->xyz = xyz;
	a->room = room;
	return ERR_OK;
}

/* Numbers that are only looked at, a few at a time. */
static void look(struct points_arrival *a, const unsigned char *data, size_t n)
{
	const size_t width = a->is_double ? 8 : 4;
	float some[BLOCK];
	size_t step, i;

	for (i = 0; i < n; i += step) {
		step = n - i < BLOCK ? n - i : BLOCK;
		if (load(data + i * width, step, a->is_double, some))
			not_finite(some, step, a->count + i, a->faults);
	}
	a->count += n;
}

/* n whole numbers. */
static enum err take(struct points_arrival *a, const unsigned char *data,
    size_t n)
{
	enum err err;

	if (a->is_refused || n > a->most - a->count) {
		a->is_refused = true;
		points_arrival_fini(a);
		return ERR_OK;
	}
	if (a->is_wrong) {
		look(a, data, n);
		return ERR_OK;
	}
	err = make_room(a, n);
	if (err)
		return err;
	if (load(data, n, a->is_double, a->xyz + a->count)) {
		a->is_wrong = true;
		not_finite(a->xyz + a->count, n, a->count, a->faults);
		points_arrival_fini(a);
	}
	a->count += n;
	return ERR_OK;
}

enum err points_arrival_feed(struct points_arrival *a, const void *data,
    size_t length)
{
	const size_t width = a->is_double ? 8 : 4;
	const unsigned char *p = data;
	const unsigned char *const end = p + length;
	enum err err = ERR_OK;
	size_t n;

	a->length += length;
	while (a->part_length && p < end) {
		a->part[a->part_length++] = *p++;
		if (a->part_length < width)
			continue;
		a->part_length = 0;
		err = take(a, a->part, 1);
		break;
	}
	n = (size_t)(end - p) / width;
	if (!err && n)
		err = take(a, p, n);
	for (p += n * width; p < end; p++)
		a->part[a->part_length++] = *p;
	return err;
}

enum err points_arrival_finish(struct points_arrival *a, struct points *out)
{
	struct points points = {.xyz = a->xyz, .count = a->count / 3};

	if (a->is_wrong)
		return ERR_INVALID;
	if (a->room > a->count)
		points_trim(&points);
	a->xyz = NULL;
	a->room = 0;
	*out = points;
	return ERR_OK;
}

enum err points_load(const unsigned char *data, size_t count, bool is_double,
    struct points *out, struct faults *faults)
{
	struct points_arrival a;
	enum err err;

	if (count > SIZE_MAX / (3 * sizeof(double)))
		return ERR_MEMORY;
	points_arrival_init(&a, is_double, count, count, faults);
	err = points_arrival_feed(&a, data,
	    3 * count * (is_double ? sizeof(double) : sizeof(float)));
	if (!err)
		err = points_arrival_finish(&a, out);
	points_arrival_fini(&a);
	return err;
}

enum err points_octets_check(size_t length, size_t max_points,
    struct faults *faults)
{
	const size_t point = 3 * sizeof(float);

	if (length % point) {
		faults_add(faults, "", "%zu bytes are no whole number of "
		    "points of %zu bytes each", length, point);
		return ERR_SYNTAX;
	}
	if (length / point > max_points)
		return points_too_many(max_points, faults);
	return ERR_OK;
}

enum err points_from_octets(const void *data, size_t length,
    size_t max_points, struct points *out, struct faults *faults)
{
	enum err err = points_octets_check(length, max_points, faults);

	return err ? err : points_load(data, length / (3 * sizeof(float)),
	    false, out, faults);
}
