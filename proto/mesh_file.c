#include "proto/mesh_file.h"

#include <stdarg.h>
#include <stdbool.h>
#include <stdio.h>
#include <stdlib.h>

#include <cjson/cJSON.h>

#include "core/mesh.h"
#include "proto/mesh_file_internal.h"

/* ---- bytes ---- */

static void fail(struct mesh_out *out, enum err err)
{
	if (out->err == ERR_OK)
		out->err = err;
}

/* Room for length bytes in all. */
static void grow(struct mesh_out *out, size_t length)
{
	char *data;

	if (out->err != ERR_OK || length <= out->room)
		return;
	data = realloc(out->data, length);
	if (data == NULL) {
		fail(out, ERR_MEMORY);
		return;
	}
	out->data = data;
	out->room = length;
}

void mesh_out_reserve(struct mesh_out *out, size_t n)
{
	if (n > SIZE_MAX - out->length)
		fail(out, ERR_LIMIT);
	else
		grow(out, out->length + n);
}

char *mesh_out_take(struct mesh_out *out, size_t n)
{
	char *at;

	if (n > SIZE_MAX / 4 - out->length)
		fail(out, ERR_LIMIT);
	else if (out->length + n > out->room)
		grow(out, (out->length + n) / 2 * 3 + 64);
	if (out->err != ERR_OK)
		return NULL;
	at = out->data + out->length;
	out->length += n;
	return at;
}

void mesh_out_bytes(struct mesh_out *out, const void *bytes, size_t n)
{
	char *at = mesh_out_take(out, n);

	if (at != NULL && n > 0)
		memcpy(at, bytes, n);
}

void mesh_out_text(struct mesh_out *out, const char *format, ...)
{
	char text[256];
	va_list args;
	int n;

	va_start(args, format);
	n = vsnprintf(text, sizeof text, format, args);
	va_end(args);
	if (n > 0)
		mesh_out_bytes(out, text, (size_t)n < sizeof text ? (size_t)n
		    : sizeof text - 1);
}

void mesh_out_words(struct mesh_out *out, const void *words, size_t count)
{
	const char *from = words;
	char *at = mesh_out_take(out, count * sizeof(uint32_t));
	uint32_t word;

	for (size_t i = 0; at != NULL && i < count; i++) {
		memcpy(&word, from + i * sizeof word, sizeof word);
		at = mesh_put_u32(at, word);
	}
}

enum err mesh_out_finish(struct mesh_out *out, char **data, size_t *length)
{
	char *fitted;

	if (out->err != ERR_OK) {
		free(out->data);
		return out->err;
	}
	fitted = realloc(out->data, out->length > 0 ? out->length : 1);
	*data = fitted != NULL ? fitted : out->data;
	*length = out->length;
	return ERR_OK;
}

/* ---- figures ---- */

static bool add(cJSON *json, const char *name, cJSON *value)
{
	if (value != NULL && cJSON_AddItemToObject(json, name, value))
		return true;
	cJSON_Delete(value);
	return false;
}

static bool add_number(cJSON *json, const char *name, double value)
{
	return add(json, name, cJSON_CreateNumber(value));
}

static bool add_triple(cJSON *json, const char *name, double x, double y,
    double z)
{
	const double triple[3] = {x, y, z};

	return add(json, name, cJSON_CreateDoubleArray(triple, 3));
}

static bool add_corner(cJSON *json, const char *name, bool is_empty,
    struct vec3 corner)
{
	return is_empty ? add(json, name, cJSON_CreateNull())
	    : add_triple(json, name, corner.x, corner.y, corner.z);
}

/* What the surface is like. */
static bool add_shape(cJSON *json, const struct mesh_figures *f)
{
	const bool is_empty = f->vertices == 0;

	return add_number(json, "vertices", (double)f->vertices) &&
	    add_number(json, "triangles", (double)f->triangles) &&
	    add_number(json, "components", (double)f->components) &&
	    add_number(json, "euler", (double)f->euler) &&
	    add_number(json, "genus", (double)f->genus) &&
	    add_number(json, "area", f->area) &&
	    add_number(json, "volume", f->volume) &&
	    add_corner(json, "min", is_empty, f->min) &&
	    add_corner(json, "max", is_empty, f->max);
}

/* How it was found. */
static bool add_work(cJSON *json, const struct mesh_figures *f)
{
	return add_triple(json, "resolution", (double)f->counts[0],
	    (double)f->counts[1], (double)f->counts[2]) &&
	    add_number(json, "edge_length", f->edge) &&
	    add_number(json, "cells", (double)f->cells) &&
	    add_number(json, "cells_evaluated", (double)f->cells_evaluated) &&
	    add_number(json, "points", (double)f->points) &&
	    add_number(json, "full_points", (double)f->full_points) &&
	    add_number(json, "largest_error", f->largest_error) &&
	    add_number(json, "sharp_vertices", (double)f->sharp_vertices);
}

struct cJSON *mesh_figures_json(const struct mesh_figures *figures)
{
	cJSON *json = cJSON_CreateObject();

	if (json != NULL && add_shape(json, figures) &&
	    add_work(json, figures))
		return json;
	cJSON_Delete(json);
	return NULL;
}
