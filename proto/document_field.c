#include <assert.h>
#include <math.h>
#include <stdarg.h>
#include <stdio.h>
#include <string.h>

#include <cjson/cJSON.h>

#include "proto/document_reader.h"
#include "proto/fault.h"
#include "proto/text.h"

/* More slips than this and a name is not meant. */
#define SLIPS_MAX 2

/* There may be a million faults, and only the first are told. */
static bool is_told(const struct reader *r)
{
	return r->faults->count < FAULT_MAX;
}

static void add_fault(struct reader *r, const struct json_place *at,
    const char *detail, va_list ap)
{
	char sentence[FAULT_DETAIL_MAX + 64];

	if (!is_told(r)) {
		r->faults->count++;
		return;
	}
	if (vsnprintf(sentence, sizeof sentence, detail, ap) < 0)
		sentence[0] = '\0';
	json_fault(r->faults, at, "%s", sentence);
}

void reader_fault(struct reader *r, const struct json_place *at,
    const char *detail, ...)
{
	va_list ap;

	va_start(ap, detail);
	add_fault(r, at, detail, ap);
	va_end(ap);
	if (r->err == ERR_OK)
		r->err = ERR_INVALID;
}

void reader_limit(struct reader *r, const struct json_place *at,
    const char *detail, ...)
{
	va_list ap;

	va_start(ap, detail);
	add_fault(r, at, detail, ap);
	va_end(ap);
	r->err = ERR_LIMIT;
}

void *reader_alloc(struct reader *r, size_t count, size_t size)
{
	void *memory = arena_array(r->arena, count, size);

	if (!memory)
		r->err = ERR_MEMORY;
	return memory;
}

/* The field called name, counted through all sets in *index; or NULL. */
static const struct field *find_field(const struct field_set *sets,
    size_t set_count, const char *name, size_t *index)
{
	size_t s, i;

	*index = 0;
	for (s = 0; s < set_count; s++) {
		for (i = 0; i < sets[s].count; i++, (*index)++) {
			if (text_equal(sets[s].fields[i].name, name))
				return &sets[s].fields[i];
		}
	}
	return NULL;
}

static void consider(const char *given, const char *candidate,
    const char **best, int *least)
{
	const int slips = text_distance(given, candidate);

	if (slips < *least && slips < (int)strlen(candidate)) {
		*least = slips;
		*best = candidate;
	}
}

static void unknown_field(struct reader *r, const struct json_place *at,
    const char *name, const struct field_set *sets, size_t set_count)
{
	const char *best = NULL;
	int least = SLIPS_MAX + 1;
	size_t s, i;

	for (s = 0; s < set_count && is_told(r); s++) {
		for (i = 0; i < sets[s].count; i++)
			consider(name, sets[s].fields[i].name, &best, &least);
	}
	if (best)
		reader_fault(r, at, "unknown field '%.64s'; did you mean '%s'?",
		    name, best);
	else
		reader_fault(r, at, "unknown field '%.64s'", name);
}

static void set_fallbacks(const struct field_set *set, void *base)
{
	const struct field *f;

	for (f = set->fields; f < set->fields + set->count; f++) {
		if (f->has_fallback)
			memcpy((char *)base + f->offset, &f->fallback,
			    sizeof f->fallback);
	}
}

static void missing_fields(struct reader *r, const struct json_place *at,
    const struct field_set *sets, size_t set_count, unsigned long seen)
{
	size_t s, i, index = 0;

	for (s = 0; s < set_count; s++) {
		for (i = 0; i < sets[s].count; i++, index++) {
			if (sets[s].fields[i].required && !(seen >> index & 1))
				reader_fault(r, at, "required field '%s' is missing",
				    sets[s].fields[i].name);
		}
	}
}

unsigned field_read_object(struct reader *r, const struct json_place *at,
    const struct cJSON *object, const struct field_set *sets,
    size_t set_count, void *base)
{
	const struct field *field;
	const cJSON *member;
	struct json_place place;
	unsigned long seen = 0;
	size_t index, s;

	for (s = 0; s < set_count; s++)
		set_fallbacks(&sets[s], base);
	cJSON_ArrayForEach(member, object) {
		place = json_member(at, member->string);
		field = find_field(sets, set_count, member->string, &index);
		assert(index < 32);
		if (!field)
			unknown_field(r, &place, member->string, sets,
			    set_count);
		else if (seen >> index & 1)
			reader_fault(r, &place, "given twice");
		else if (field->read)
			field->read(r, &place, member, field, base);
		if (field)
			seen |= 1ul << index;
		if (!reader_goes_on(r))
			return 0;
	}
	missing_fields(r, at, sets, set_count, seen);
	return (unsigned)(seen & ((1ul << sets[0].count) - 1));
}

static void unknown_type(struct reader *r, const struct json_place *at,
    const char *type, const struct variant *variants, size_t count,
    const char *what)
{
	const char *best = NULL;
	int least = SLIPS_MAX + 1;
	size_t i;

	for (i = 0; i < count && is_told(r); i++)
		consider(type, variants[i].name, &best, &least);
	if (best)
		reader_fault(r, at,
		    "unknown %s type '%.64s'; did you mean '%s'?", what, type,
		    best);
	else
		reader_fault(r, at, "unknown %s type '%.64s'", what, type);
}

const struct variant *field_variant(struct reader *r,
    const struct json_place *at, const struct cJSON *object,
    const struct variant *variants, size_t count, const char *what)
{
	const struct json_place place = json_member(at, "type");
	const cJSON *type = cJSON_GetObjectItemCaseSensitive(object, "type");
	size_t i;

	if (!cJSON_IsObject(object)) {
		reader_fault(r, at, "a %s must be an object, not %s", what,
		    json_kind(object));
		return NULL;
	}
	if (!type) {
		reader_fault(r, at, "required field 'type' is missing");
		return NULL;
	}
	if (!cJSON_IsString(type)) {
		reader_fault(r, &place, "must be a string, not %s",
		    json_kind(type));
		return NULL;
	}
	for (i = 0; i < count; i++) {
		if (text_equal(variants[i].name, type->valuestring))
			return &variants[i];
	}
	unknown_type(r, &place, type->valuestring, variants, count, what);
	return NULL;
}

bool field_is_number(struct reader *r, const struct json_place *at,
    const struct cJSON *value, double least, double most)
{
	if (!cJSON_IsNumber(value)) {
		reader_fault(r, at, "must be a number, not %s",
		    json_kind(value));
		return false;
	}
	if (!isfinite(value->valuedouble)) {
		reader_fault(r, at, "too large a number");
		return false;
	}
	if (value->valuedouble < least || value->valuedouble > most) {
		reader_fault(r, at, "must be between %.10g and %.10g, not %.10g",
		    least, most, value->valuedouble);
		return false;
	}
	return true;
}

/* How many elements array has, or one more than most if it has more. */
static size_t count_elements(const cJSON *array, size_t most)
{
	const cJSON *element;
	size_t n = 0;

	for (element = array->child; element && n <= most;
	    element = element->next)
		n++;
	return n;
}

bool field_numbers(struct reader *r, const struct json_place *at,
    const struct cJSON *value, size_t count, double least, double most,
    double *out)
{
	struct json_place place = json_element(at, 0);
	const cJSON *element;
	bool fine = true;

	if (!cJSON_IsArray(value)) {
		reader_fault(r, at, "must be an array of %zu numbers, not %s",
		    count, json_kind(value));
		return false;
	}
	if (count_elements(value, count) != count) {
		reader_fault(r, at, "must have %zu numbers, not %d", count,
		    cJSON_GetArraySize(value));
		return false;
	}
	cJSON_ArrayForEach(element, value) {
		if (field_is_number(r, &place, element, least, most))
			out[place.index] = element->valuedouble;
		else
			fine = false;
		place.index++;
	}
	return fine;
}

bool field_is_id(const char *text)
{
	const size_t length = strlen(text);

	return length >= 1 && length <= NODE_ID_MAX &&
	    strspn(text, "ABCDEFGHIJKLMNOPQRSTUVWXYZabcdefghijklmnopqrstuvwxyz"
	    "0123456789_.-") == length;
}

void field_keep(struct reader *r, const struct json_place *at,
    const struct cJSON *value, const struct field *field, void *base)
{
	(void)r;
	(void)at;
	memcpy((char *)base + field->offset, &value, sizeof value);
}

void field_number(struct reader *r, const struct json_place *at,
    const struct cJSON *value, const struct field *field, void *base)
{
	double *out = (double *)((char *)base + field->offset);

	if (field_is_number(r, at, value, field->least, field->most))
		*out = value->valuedouble;
}

void field_pair(struct reader *r, const struct json_place *at,
    const struct cJSON *value, const struct field *field, void *base)
{
	double *out = (double *)((char *)base + field->offset);

	field_numbers(r, at, value, 2, field->least, field->most, out);
}

void field_vec3(struct reader *r, const struct json_place *at,
    const struct cJSON *value, const struct field *field, void *base)
{
	struct vec3 *out = (struct vec3 *)((char *)base + field->offset);
	double v[3];

	if (field_numbers(r, at, value, 3, field->least, field->most, v))
		*out = vec3(v[0], v[1], v[2]);
}

void field_direction(struct reader *r, const struct json_place *at,
    const struct cJSON *value, const struct field *field, void *base)
{
	struct vec3 *out = (struct vec3 *)((char *)base + field->offset);
	struct vec3 u;
	double v[3], largest;

	if (!field_numbers(r, at, value, 3, field->least, field->most, v))
		return;
	largest = fmax(fabs(v[0]), fmax(fabs(v[1]), fabs(v[2])));
	if (largest == 0.0) {
		reader_fault(r, at, "must not be the null vector");
		return;
	}
	/* By the largest first, so that no square leaves the range. */
	u = vec3(v[0] / largest, v[1] / largest, v[2] / largest);
	*out = vec3_scale(1.0 / vec3_norm(u), u);
}

void field_id(struct reader *r, const struct json_place *at,
    const struct cJSON *value, const struct field *field, void *base)
{
	const char **out = (const char **)((char *)base + field->offset);

	if (!cJSON_IsString(value)) {
		reader_fault(r, at, "must be a string, not %s",
		    json_kind(value));
		return;
	}
	if (!field_is_id(value->valuestring)) {
		reader_fault(r, at,
		    "must be 1 to %d of the characters A-Z a-z 0-9 _ . -",
		    NODE_ID_MAX);
		return;
	}
	*out = arena_string(r->arena, value->valuestring);
	if (!*out)
		r->err = ERR_MEMORY;
}
