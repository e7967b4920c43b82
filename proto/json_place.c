#include <stdarg.h>
#include <stdio.h>
#include <string.h>

#include <cjson/cJSON.h>

#include "proto/fault.h"
#include "proto/json.h"
#include "proto/text.h"

/* Most of a member name that a pointer shows. */
#define NAME_SHOWN 64

struct json_place json_root(const char *pointer)
{
	return (struct json_place){NULL, pointer, 0};
}

struct json_place json_member(const struct json_place *parent,
    const char *name)
{
	return (struct json_place){parent, name, 0};
}

struct json_place json_element(const struct json_place *parent, size_t index)
{
	return (struct json_place){parent, NULL, index};
}

/* "/name" with '~' and '/' escaped. */
static size_t put_name(const char *name, char out[static 2 * NAME_SHOWN + 1])
{
	char shown[NAME_SHOWN];
	size_t n = 0, i;

	text_clean(name, 1, shown, sizeof shown);
	out[n++] = '/';
	for (i = 0; shown[i]; i++) {
		if (shown[i] == '~' || shown[i] == '/') {
			out[n++] = '~';
			out[n++] = shown[i] == '~' ? '0' : '1';
		} else {
			out[n++] = shown[i];
		}
	}
	return n;
}

void json_pointer(const struct json_place *place,
    char out[static JSON_POINTER_MAX])
{
	char part[2 * NAME_SHOWN + 1];
	size_t n, at = JSON_POINTER_MAX - 1, root;

	/* Backwards from the leaf; what does not fit is its beginning. */
	out[at] = '\0';
	for (; place->parent; place = place->parent) {
		n = place->name ? put_name(place->name, part) :
		    (size_t)snprintf(part, sizeof part, "/%zu", place->index);
		if (n > at)
			break;
		at -= n;
		memcpy(out + at, part, n);
	}
	root = place->parent ? 0 : strlen(place->name);
	if (root > at)
		root = at;
	if (root)
		memcpy(out, place->name, root);
	memmove(out + root, out + at, JSON_POINTER_MAX - at);
}

void json_fault(struct faults *faults, const struct json_place *place,
    const char *detail, ...)
{
	char pointer[JSON_POINTER_MAX], sentence[FAULT_DETAIL_MAX + 64];
	va_list ap;

	json_pointer(place, pointer);
	va_start(ap, detail);
	if (vsnprintf(sentence, sizeof sentence, detail, ap) < 0)
		sentence[0] = '\0';
	va_end(ap);
	faults_add(faults, pointer, "%s", sentence);
}

const char *json_kind(const struct cJSON *value)
{
	if (cJSON_IsObject(value))
		return "an object";
	if (cJSON_IsArray(value))
		return "an array";
	if (cJSON_IsString(value))
		return "a string";
	if (cJSON_IsNumber(value))
		return "a number";
	return cJSON_IsBool(value) ? "a boolean" : "null";
}
