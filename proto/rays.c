#include "proto/rays.h"

#include <math.h>
#include <stdint.h>
#include <stdlib.h>

#include "core/tree.h"
#include "proto/fault.h"
#include "proto/json.h"
#include "proto/npy.h"
#include "proto/number.h"

#define BYTES (RAY_FLOATS * sizeof(float))

/* Characters that a ray takes in JSON, about. */
#define CHARACTERS_PER_RAY 50

void rays_fini(struct rays *rays)
{
	free(rays->numbers);
	*rays = (struct rays){0};
}

/* ---- what rays must be ---- */

/* What is wrong with the ray, or NULL. */
static const char *ray_fault(const float ray[static RAY_FLOATS])
{
	for (int i = 0; i < RAY_FLOATS; i++) {
		if (!isfinite(ray[i]))
			return "all six numbers must be finite as float32";
	}
	for (int i = 0; i < 3; i++) {
		if (fabsf(ray[i]) > (float)TREE_COORDINATE_MAX)
			return "the origin must lie within +-1e9";
	}
	if (ray[3] == 0.0f && ray[4] == 0.0f && ray[5] == 0.0f)
		return "the direction must not be 0";
	return NULL;
}

/* at: the place of all of them. */
static enum err check(const struct rays *rays, const struct json_place *at,
    struct faults *faults)
{
	enum err err = ERR_OK;

	for (size_t i = 0; i < rays->count; i++) {
		const char *why = ray_fault(rays->numbers + RAY_FLOATS * i);
		const struct json_place place = json_element(at, i);

		if (why == NULL)
			continue;
		json_fault(faults, &place, "%s", why);
		err = ERR_INVALID;
	}
	return err;
}

static enum err too_many(const struct json_place *at, size_t max_rays,
    struct faults *faults)
{
	json_fault(faults, at, "more than %zu rays", max_rays);
	return ERR_LIMIT;
}

/* ---- JSON ---- */

/* An array being read: numbers one after the other. */
struct scan {
	struct json_text *text;
	const struct json_place *at;
	size_t max_rays;
	struct faults *faults;
	float *numbers;
	size_t count, room;   /* of numbers */
	/* What is there instead of what should be: JSON, or none. */
	const char *why;
	size_t ray;           /* which ray is wrong; SIZE_MAX: all of it */
};

static enum err grow(struct scan *s)
{
	const size_t guess = (size_t)(s->text->end - s->text->cursor) /
	    CHARACTERS_PER_RAY * RAY_FLOATS + 8 * RAY_FLOATS;
	size_t room = s->room > 0 ? s->room + s->room / 2 : guess;
	float *numbers;

	if (room > SIZE_MAX / sizeof *numbers)
		return ERR_MEMORY;
	numbers = realloc(s->numbers, room * sizeof *numbers);
	if (numbers == NULL)
		return ERR_MEMORY;
	s->numbers = numbers;
	s->room = room;
	return ERR_OK;
}

static enum err wrong(struct scan *s, const char *why, size_t ray)
{
	s->why = why;
	s->ray = ray;
	return ERR_INVALID;
}

static enum err read_number(struct scan *s)
{
	const size_t ray = s->count / RAY_FLOATS;
	double value;

	if (ray >= s->max_rays)
		return too_many(s->at, s->max_rays, s->faults);
	if (s->count == s->room && grow(s) != ERR_OK)
		return ERR_MEMORY;
	json_space(s->text);
	if (number_parse(&s->text->cursor, s->text->end, &value) != 0)
		return wrong(s, "must be numbers: the origin's three and the "
		    "direction's", ray);
	s->numbers[s->count++] = (float)value;
	return ERR_OK;
}

/* Numbers up to ']', behind '['. */
static enum err read_numbers(struct scan *s)
{
	enum err err;

	do
		err = read_number(s);
	while (err == ERR_OK && json_take(s->text, ','));
	if (err == ERR_OK && !json_take(s->text, ']'))
		err = wrong(s, "must be numbers: the origin's three and the "
		    "direction's", (s->count - 1) / RAY_FLOATS);
	return err;
}

static enum err read_nested(struct scan *s)
{
	enum err err = ERR_OK;

	do {
		const size_t ray = s->count / RAY_FLOATS;
		const size_t before = s->count;

		if (!json_take(s->text, '['))
			return wrong(s, "a ray must be an array of 6 numbers",
			    ray);
		err = read_numbers(s);
		if (err == ERR_OK && s->count - before != RAY_FLOATS)
			err = wrong(s, "a ray has 6 numbers: its origin's "
			    "three and its direction's", ray);
	} while (err == ERR_OK && json_take(s->text, ','));
	if (err == ERR_OK && !json_take(s->text, ']'))
		err = wrong(s, "must be an array of rays", SIZE_MAX);
	return err;
}

static enum err read_array(struct scan *s, bool *flat)
{
	enum err err;

	if (!json_take(s->text, '['))
		return wrong(s, "must be an array of rays", SIZE_MAX);
	if (json_take(s->text, ']'))
		return ERR_OK;
	if (s->text->cursor < s->text->end && *s->text->cursor == '[')
		return read_nested(s);
	*flat = true;
	err = read_numbers(s);
	if (err == ERR_OK && s->count % RAY_FLOATS != 0)
		err = wrong(s, "a flat array's length must be a multiple of 6",
		    SIZE_MAX);
	return err;
}

/* What is not rays may be no JSON: that is told then. */
static enum err tell(const struct scan *s)
{
	const struct json_place place = json_element(s->at, s->ray);
	enum err err = json_skip(s->text, s->at, s->faults);

	if (err != ERR_OK)
		return err;
	json_fault(s->faults, s->ray == SIZE_MAX ? s->at : &place, "%s",
	    s->why);
	return ERR_INVALID;
}

enum err rays_read(struct json_text *text, const struct json_place *at,
    size_t max_rays, struct rays *out, struct faults *faults)
{
	struct scan s = {.text = text, .at = at, .max_rays = max_rays,
	    .faults = faults};
	struct rays rays = {0};
	const char *start;
	enum err err;

	json_space(text);
	start = text->cursor;
	err = read_array(&s, &rays.flat);
	rays.numbers = s.numbers;
	rays.count = s.count / RAY_FLOATS;
	if (err == ERR_INVALID) {
		text->cursor = start;
		err = tell(&s);
	}
	if (err == ERR_OK)
		err = check(&rays, at, faults);
	if (err == ERR_OK)
		*out = rays;
	else
		rays_fini(&rays);
	return err;
}

/* ---- numbers as they are ---- */

static enum err load(const unsigned char *data, size_t count, bool is_double,
    struct rays *out, struct faults *faults)
{
	const struct json_place root = json_root("");
	const struct json_place at = json_member(&root, "rays");
	struct rays rays = {.count = count};
	enum err err;

	rays.numbers = malloc(count * BYTES + 1);
	if (rays.numbers == NULL)
		return ERR_MEMORY;
	npy_floats(data, count * RAY_FLOATS, is_double, rays.numbers);
	err = check(&rays, &at, faults);
	if (err == ERR_OK)
		*out = rays;
	else
		rays_fini(&rays);
	return err;
}

enum err rays_from_octets(const void *data, size_t length, size_t max_rays,
    struct rays *out, struct faults *faults)
{
	const struct json_place root = json_root("");

	if (length % BYTES != 0) {
		faults_add(faults, "", "%zu bytes are no rays of 6 float32, "
		    "24 bytes each", length);
		return ERR_SYNTAX;
	}
	if (length / BYTES > max_rays)
		return too_many(&root, max_rays, faults);
	return load(data, length / BYTES, false, out, faults);
}

/* What npy says it holds, and what follows. */
static enum err check_npy(const struct npy *npy, size_t max_rays,
    struct faults *faults)
{
	const size_t row = RAY_FLOATS * (npy->is_double ? sizeof(double) :
	    sizeof(float));
	const struct json_place root = json_root("");

	if (npy->is_fortran) {
		faults_add(faults, "", "fortran_order must be False: use "
		    "numpy.ascontiguousarray");
		return ERR_INVALID;
	}
	if (npy->axes != 2 || npy->shape[1] != RAY_FLOATS) {
		faults_add(faults, "", "shape must be (N, 6)");
		return ERR_INVALID;
	}
	if (npy->shape[0] > max_rays)
		return too_many(&root, max_rays, faults);
	if (npy->length % row == 0 && npy->length / row == npy->shape[0])
		return ERR_OK;
	faults_add(faults, "", "%zu bytes follow the header, which says %llu "
	    "rays of %zu bytes", npy->length,
	    (unsigned long long)npy->shape[0], row);
	return ERR_SYNTAX;
}

enum err rays_from_npy(const void *data, size_t length, size_t max_rays,
    struct rays *out, struct faults *faults)
{
	struct npy npy;
	enum err err = npy_read(data, length, &npy, faults);

	if (err == ERR_OK)
		err = check_npy(&npy, max_rays, faults);
	return err != ERR_OK ? err : load(npy.data, (size_t)npy.shape[0],
	    npy.is_double, out, faults);
}
