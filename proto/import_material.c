/*
 * The library's materials: of their members, documents here have the colour.
 */
#include <math.h>
#include <stdlib.h>
#include <string.h>

#include <cjson/cJSON.h>

#include "proto/import_internal.h"

/* Of a primitive without materials, as early versions wrote SDFRootNode. */
#define COLOR_DEFAULT 0xaaaaaa
#define COLOR_MAX 0xffffff

#define AT(member) offsetof(struct material, member)

struct material {
	unsigned color, emissive; /* 0xrrggbb, sRGB */
	double roughness, metalness;
};

/* The value of one of Three.js's hexadecimal colours, or -1. */
static long parse_hex(const char *text)
{
	const size_t length = strlen(text);
	long c;

	if (text[0] != '#' || (length != 4 && length != 7) ||
	    strspn(text + 1, "0123456789abcdefABCDEF") != length - 1)
		return -1;
	c = strtol(text + 1, NULL, 16);
	if (length == 7)
		return c;
	/* #rgb is #rrggbb */
	return (c >> 8) * 0x110000 + (c >> 4 & 15) * 0x1100 + (c & 15) * 0x11;
}

static void read_color(struct reader *r, const struct json_place *at,
    const struct cJSON *value, const struct field *field, void *base)
{
	unsigned *out = (unsigned *)((char *)base + field->offset);
	double c = -1.0;

	if (cJSON_IsString(value))
		c = (double)parse_hex(value->valuestring);
	else if (cJSON_IsNumber(value))
		c = value->valuedouble;
	if (c >= 0.0 && c <= COLOR_MAX && c == floor(c))
		*out = (unsigned)c;
	else
		reader_fault(r, at, "must be \"#rrggbb\" or a whole number "
		    "from 0 to %d", COLOR_MAX);
}

static const struct field material_fields[] = {
	{.name = "color", .read = read_color, .offset = AT(color),
	    .required = true},
	{.name = "roughness", .read = field_number, .offset = AT(roughness),
	    .least = -HUGE_VAL, .most = HUGE_VAL},
	{.name = "metalness", .read = field_number, .offset = AT(metalness),
	    .least = -HUGE_VAL, .most = HUGE_VAL},
	{.name = "emissive", .read = read_color, .offset = AT(emissive)},
};

static void warn_dropped(struct importing *m, const struct json_place *at,
    const char *name, bool dropped)
{
	const struct json_place place = json_member(at, name);

	if (dropped)
		import_warn(m, &place, "'%s' is left out: materials have a "
		    "color alone here", name);
}

static void read_material(struct importing *m, const struct json_place *at,
    const struct cJSON *value, struct material *out)
{
	static const struct field_set set = FIELD_SET(material_fields);

	if (!cJSON_IsObject(value)) {
		reader_fault(&m->r, at, "a material must be an object, not %s",
		    json_kind(value));
		return;
	}
	field_read_object(&m->r, at, value, &set, 1, out);
	warn_dropped(m, at, "roughness", out->roughness != 0.0);
	warn_dropped(m, at, "metalness", out->metalness != 0.0);
	warn_dropped(m, at, "emissive", out->emissive != 0);
}

/* One component, 0 to 255, as a linear number (IEC 61966-2-1). */
static double linear(unsigned component)
{
	const double s = (component & 255) / 255.0;

	return s <= 0.04045 ? s / 12.92 : pow((s + 0.055) / 1.055, 2.4);
}

static struct vec3 linear_rgb(unsigned color)
{
	return vec3(linear(color >> 16), linear(color >> 8), linear(color));
}

/* The middle of count colours, or the one they all are. */
static struct vec3 mean_rgb(const unsigned *colors, int count, bool *differ)
{
	struct vec3 sum = vec3(0.0, 0.0, 0.0);
	int i;

	*differ = false;
	for (i = 0; i < count; i++) {
		sum = vec3_add(sum, linear_rgb(colors[i]));
		*differ = *differ || colors[i] != colors[0];
	}
	return *differ ? vec3_scale(1.0 / count, sum) : linear_rgb(colors[0]);
}

void import_material(struct importing *m, const struct json_place *at,
    const struct cJSON *materials, int count)
{
	struct json_place place = json_element(at, 0);
	unsigned colors[IMPORT_VERTICES_MAX] = {COLOR_DEFAULT};
	const cJSON *value;
	bool differ;

	if (materials && !import_is_array(&m->r, at, materials, count,
	    "materials"))
		return;
	cJSON_ArrayForEach(value, materials) {
		struct material material = {0};

		read_material(m, &place, value, &material);
		colors[place.index++] = material.color;
	}
	import_put(&m->text, ",\"material\":{\"color\":");
	import_put_vec3(&m->text, mean_rgb(colors, materials ? count : 1,
	    &differ));
	import_put(&m->text, "}");
	if (differ)
		import_warn(m, at, "a primitive has one color here: the mean "
		    "of those of its vertices");
}
