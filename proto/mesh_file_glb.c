/*
 * glTF 2.0, binary (Khronos 2021, sections 3 and 4): a header, the scene as
 * JSON, and one buffer: positions, normals, colours, indices.
 */
#include "proto/mesh_file.h"

#include <math.h>
#include <stdbool.h>
#include <stdlib.h>

#include <cjson/cJSON.h>

#include "core/mesh.h"
#include "proto/mesh_file_internal.h"

#define MAGIC 0x46546c67u      /* "glTF" */
#define CHUNK_JSON 0x4e4f534au /* "JSON" */
#define CHUNK_BIN 0x004e4942u  /* "BIN" */

#define FLOAT 5126
#define UNSIGNED_INT 5125
#define ARRAY_BUFFER 34962
#define ELEMENT_ARRAY_BUFFER 34963

/* ---- JSON: each returns NULL, or false, without memory ---- */

/* Takes child over, in any case. */
static bool give(cJSON *parent, const char *name, cJSON *child)
{
	if (parent != NULL && child != NULL && (name != NULL ?
	    cJSON_AddItemToObject(parent, name, child) :
	    cJSON_AddItemToArray(parent, child)))
		return true;
	cJSON_Delete(child);
	return false;
}

/* A new array, or object, in parent: under name, or as its last element. */
static cJSON *list_in(cJSON *parent, const char *name)
{
	cJSON *list = cJSON_CreateArray();

	return give(parent, name, list) ? list : NULL;
}

static cJSON *object_in(cJSON *parent, const char *name)
{
	cJSON *object = cJSON_CreateObject();

	return give(parent, name, object) ? object : NULL;
}

static bool number_in(cJSON *parent, const char *name, double value)
{
	return give(parent, name, cJSON_CreateNumber(value));
}

static bool text_in(cJSON *parent, const char *name, const char *text)
{
	return give(parent, name, cJSON_CreateString(text));
}

/* ---- the scene ---- */

/* What of a vertex is one accessor, in the buffer's order. */
struct part {
	const char *attribute; /* NULL: indices */
	const void *data;
	size_t count;          /* of elements */
	size_t words;          /* of an element */
};

#define PARTS_MAX 4

static size_t list_parts(const struct mesh *m,
    struct part parts[static PARTS_MAX])
{
	const struct mesh_figures *f = &m->figures;
	size_t n = 0;

	if (f->vertices == 0 || f->triangles == 0)
		return 0;
	parts[n++] = (struct part){"POSITION", m->positions, f->vertices, 3};
	if (m->normals != NULL)
		parts[n++] = (struct part){"NORMAL", m->normals, f->vertices,
		    3};
	if (m->colors != NULL)
		parts[n++] = (struct part){"COLOR_0", m->colors, f->vertices,
		    3};
	parts[n++] = (struct part){NULL, m->triangles, 3 * f->triangles, 1};
	return n;
}

static size_t part_bytes(const struct part *part)
{
	return part->count * part->words * sizeof(uint32_t);
}

/* The least and the most of every coordinate, which a reader may compare. */
static bool add_extent(cJSON *accessor, const struct part *part)
{
	const float *p = part->data;
	double least[3] = {INFINITY, INFINITY, INFINITY};
	double most[3] = {-INFINITY, -INFINITY, -INFINITY};

	for (size_t i = 0; i < 3 * part->count; i++) {
		least[i % 3] = fmin(least[i % 3], p[i]);
		most[i % 3] = fmax(most[i % 3], p[i]);
	}
	return give(accessor, "min", cJSON_CreateDoubleArray(least, 3)) &&
	    give(accessor, "max", cJSON_CreateDoubleArray(most, 3));
}

static bool add_view(cJSON *views, const struct part *part, size_t offset)
{
	cJSON *view = object_in(views, NULL);

	return view != NULL && number_in(view, "buffer", 0) &&
	    number_in(view, "byteOffset", (double)offset) &&
	    number_in(view, "byteLength", (double)part_bytes(part)) &&
	    number_in(view, "target", part->attribute != NULL ? ARRAY_BUFFER :
	    ELEMENT_ARRAY_BUFFER);
}

static bool add_accessor(cJSON *accessors, const struct part *part,
    size_t view)
{
	cJSON *accessor = object_in(accessors, NULL);

	return accessor != NULL &&
	    number_in(accessor, "bufferView", (double)view) &&
	    number_in(accessor, "componentType", part->attribute != NULL ?
	    FLOAT : UNSIGNED_INT) &&
	    number_in(accessor, "count", (double)part->count) &&
	    text_in(accessor, "type", part->words == 3 ? "VEC3" : "SCALAR") &&
	    (view != 0 || add_extent(accessor, part));
}

static bool add_buffers(cJSON *gltf, const struct part *parts, size_t count)
{
	cJSON *accessors = list_in(gltf, "accessors");
	cJSON *views = list_in(gltf, "bufferViews");
	cJSON *buffer = object_in(list_in(gltf, "buffers"), NULL);
	size_t offset = 0;

	if (accessors == NULL || views == NULL || buffer == NULL)
		return false;
	for (size_t i = 0; i < count; i++) {
		if (!add_view(views, parts + i, offset) ||
		    !add_accessor(accessors, parts + i, i))
			return false;
		offset += part_bytes(parts + i);
	}
	return number_in(buffer, "byteLength", (double)offset);
}

static bool add_primitive(cJSON *primitives, const struct part *parts,
    size_t count)
{
	cJSON *primitive = object_in(primitives, NULL);
	cJSON *attributes = object_in(primitive, "attributes");

	if (attributes == NULL)
		return false;
	for (size_t i = 0; i + 1 < count; i++) {
		if (!number_in(attributes, parts[i].attribute, (double)i))
			return false;
	}
	return number_in(primitive, "indices", (double)(count - 1)) &&
	    number_in(primitive, "material", 0) &&
	    number_in(primitive, "mode", 4);
}

/* Colours are the vertices'; no metal, moderately rough, one-sided. */
static bool add_material(cJSON *gltf)
{
	cJSON *material = object_in(list_in(gltf, "materials"), NULL);
	cJSON *pbr = object_in(material, "pbrMetallicRoughness");

	return pbr != NULL && number_in(pbr, "metallicFactor", 0) &&
	    number_in(pbr, "roughnessFactor", 0.5) &&
	    give(material, "doubleSided", cJSON_CreateFalse());
}

static bool add_node(cJSON *gltf, const char *name)
{
	/* A quarter turn about X takes Z to Y. */
	static const double turn[4] = {-0.70710678118654752, 0.0, 0.0,
	    0.70710678118654752};
	cJSON *node = object_in(list_in(gltf, "nodes"), NULL);

	return node != NULL &&
	    (name[0] == '\0' || text_in(node, "name", name)) &&
	    give(node, "rotation", cJSON_CreateDoubleArray(turn, 4)) &&
	    number_in(node, "mesh", 0);
}

static bool add_geometry(cJSON *gltf, cJSON *scene, const char *name,
    const struct part *parts, size_t count)
{
	cJSON *nodes = list_in(scene, "nodes");
	cJSON *mesh = object_in(list_in(gltf, "meshes"), NULL);

	return nodes != NULL && number_in(nodes, NULL, 0) &&
	    add_node(gltf, name) &&
	    (name[0] == '\0' || text_in(mesh, "name", name)) &&
	    add_primitive(list_in(mesh, "primitives"), parts, count) &&
	    add_material(gltf) && add_buffers(gltf, parts, count);
}

static bool add_asset(cJSON *gltf, const struct mesh_figures *figures)
{
	cJSON *asset = object_in(gltf, "asset");
	cJSON *extras;

	if (asset == NULL || !text_in(asset, "version", "2.0") ||
	    !text_in(asset, "generator", "blobfield"))
		return false;
	extras = object_in(asset, "extras");
	return extras != NULL &&
	    give(extras, "blobfield", mesh_figures_json(figures));
}

/* The scene as text, for free; or NULL. */
static char *describe(const struct mesh *m, const char *name,
    const struct part *parts, size_t count)
{
	cJSON *gltf = cJSON_CreateObject();
	cJSON *scene = NULL;
	char *text = NULL;

	if (gltf != NULL && add_asset(gltf, &m->figures) &&
	    number_in(gltf, "scene", 0))
		scene = object_in(list_in(gltf, "scenes"), NULL);
	if (scene != NULL &&
	    (name[0] == '\0' || text_in(scene, "name", name)) &&
	    (count == 0 || add_geometry(gltf, scene, name, parts, count)))
		text = cJSON_PrintUnformatted(gltf);
	cJSON_Delete(gltf);
	return text;
}

/* ---- the file ---- */

static void put_chunk(struct mesh_out *out, uint32_t type, size_t length)
{
	char *at = mesh_out_take(out, 8);

	if (at != NULL)
		mesh_put_u32(mesh_put_u32(at, (uint32_t)length), type);
}

static void put_file(struct mesh_out *out, const char *text,
    const struct part *parts, size_t count)
{
	const size_t length = strlen(text), padded = (length + 3) / 4 * 4;
	size_t binary = 0, whole = 12 + 8 + padded;
	char *at;

	for (size_t i = 0; i < count; i++)
		binary += part_bytes(parts + i);
	whole += count > 0 ? 8 + binary : 0;
	if (whole > UINT32_MAX) {
		out->err = ERR_LIMIT;
		return;
	}
	mesh_out_reserve(out, whole);
	at = mesh_out_take(out, 12);
	if (at != NULL)
		mesh_put_u32(mesh_put_u32(mesh_put_u32(at, MAGIC), 2),
		    (uint32_t)whole);
	put_chunk(out, CHUNK_JSON, padded);
	mesh_out_bytes(out, text, length);
	mesh_out_bytes(out, "   ", padded - length);
	if (count > 0)
		put_chunk(out, CHUNK_BIN, binary);
	for (size_t i = 0; i < count; i++)
		mesh_out_words(out, parts[i].data, parts[i].count *
		    parts[i].words);
}

enum err mesh_file_glb(const struct mesh *m, const char *name, char **data,
    size_t *length)
{
	struct part parts[PARTS_MAX];
	const size_t count = list_parts(m, parts);
	struct mesh_out out = {0};
	char *text = describe(m, name, parts, count);

	if (text == NULL)
		return ERR_MEMORY;
	put_file(&out, text, parts, count);
	free(text);
	return mesh_out_finish(&out, data, length);
}
