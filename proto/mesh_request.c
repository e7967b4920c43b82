#include "proto/mesh_request.h"

#include <math.h>

#include <cjson/cJSON.h>

#include "core/mesh.h"
#include "proto/document_reader.h"
#include "proto/fault.h"
#include "proto/text.h"

/* The most JSON values of a body, of what does not belong, too. */
#define VALUES_MAX 256

#define ISO_MIN 1e-3
#define ISO_MAX 1e3
#define RESOLUTION_MIN 2

/* What the body is read into. */
struct draft {
	struct mesh_request request;
	double resolution;
	bool has_resolution, has_edge;
};

struct corners {
	struct vec3 min, max;
};

bool mesh_request_format(const char *name, enum media_type *out)
{
	static const struct {
		const char *name;
		enum media_type type;
	} formats[] = {
		{"glb", MEDIA_GLB}, {"ply", MEDIA_PLY}, {"stl", MEDIA_STL},
		{"obj", MEDIA_OBJ}, {"json", MEDIA_JSON},
	};

	for (size_t i = 0; i < sizeof formats / sizeof *formats; i++) {
		if (!text_equal(formats[i].name, name))
			continue;
		*out = formats[i].type;
		return true;
	}
	return false;
}

/* max above min along every axis. */
static void check_corners(struct reader *r, const struct json_place *at,
    const struct corners *corners)
{
	const struct json_place max = json_member(at, "max");
	struct json_place place = json_element(&max, 0);
	double from[3], to[3];

	vec3_put(from, corners->min);
	vec3_put(to, corners->max);
	for (; place.index < 3; place.index++) {
		if (!(to[place.index] - from[place.index] >= TREE_LENGTH_MIN))
			reader_fault(r, &place, "must be above min's %.9g",
			    from[place.index]);
	}
}

static const struct field corner_fields[] = {
	{.name = "min", .read = field_vec3,
	    .offset = offsetof(struct corners, min), .required = true,
	    .least = -TREE_COORDINATE_MAX, .most = TREE_COORDINATE_MAX},
	{.name = "max", .read = field_vec3,
	    .offset = offsetof(struct corners, max), .required = true,
	    .least = -TREE_COORDINATE_MAX, .most = TREE_COORDINATE_MAX},
};

static void read_bounds(struct reader *r, const struct json_place *at,
    const struct cJSON *value, const struct field *field, void *base)
{
	static const struct field_set set = FIELD_SET(corner_fields);
	const struct vec3 none = vec3(NAN, NAN, NAN);
	struct corners corners = {none, none};
	struct draft *draft = base;

	(void)field;
	if (!cJSON_IsObject(value)) {
		reader_fault(r, at, "must be an object {min, max}, not %s",
		    json_kind(value));
		return;
	}
	field_read_object(r, at, value, &set, 1, &corners);
	if (isnan(corners.min.x) || isnan(corners.max.x))
		return;
	check_corners(r, at, &corners);
	draft->request.has_bounds = true;
	draft->request.min = corners.min;
	draft->request.max = corners.max;
}

static void read_resolution(struct reader *r, const struct json_place *at,
    const struct cJSON *value, const struct field *field, void *base)
{
	struct draft *draft = base;

	draft->has_resolution = true;
	field_number(r, at, value, field, base);
	if (draft->resolution != floor(draft->resolution))
		reader_fault(r, at, "must be a whole number");
}

static void read_edge(struct reader *r, const struct json_place *at,
    const struct cJSON *value, const struct field *field, void *base)
{
	struct draft *draft = base;

	draft->has_edge = true;
	field_number(r, at, value, field, base);
}

static void read_flag(struct reader *r, const struct json_place *at,
    const struct cJSON *value, const struct field *field, void *base)
{
	bool *out = (bool *)((char *)base + field->offset);

	if (cJSON_IsBool(value))
		*out = cJSON_IsTrue(value);
	else
		reader_fault(r, at, "must be true or false, not %s",
		    json_kind(value));
}

static void read_format(struct reader *r, const struct json_place *at,
    const struct cJSON *value, const struct field *field, void *base)
{
	struct draft *draft = base;

	(void)field;
	if (!cJSON_IsString(value))
		reader_fault(r, at, "must be a string, not %s",
		    json_kind(value));
	else if (mesh_request_format(value->valuestring,
	    &draft->request.format))
		draft->request.has_format = true;
	else
		reader_fault(r, at, "must be glb, ply, stl, obj or json");
}

static const struct field fields[] = {
	{.name = "bounds", .read = read_bounds},
	{.name = "resolution", .read = read_resolution,
	    .offset = offsetof(struct draft, resolution),
	    .least = RESOLUTION_MIN, .most = MESH_CELLS_MAX,
	    .has_fallback = true, .fallback = MESH_RESOLUTION_DEFAULT},
	{.name = "edge_length", .read = read_edge,
	    .offset = offsetof(struct draft, request.edge_length),
	    .least = TREE_LENGTH_MIN, .most = TREE_LENGTH_MAX},
	{.name = "iso", .read = field_number,
	    .offset = offsetof(struct draft, request.iso), .least = ISO_MIN,
	    .most = ISO_MAX, .has_fallback = true,
	    .fallback = MESH_ISO_DEFAULT},
	{.name = "features", .read = read_flag,
	    .offset = offsetof(struct draft, request.features)},
	{.name = "normals", .read = read_flag,
	    .offset = offsetof(struct draft, request.normals)},
	{.name = "colors", .read = read_flag,
	    .offset = offsetof(struct draft, request.colors)},
	{.name = "format", .read = read_format},
};

static void read_body(struct reader *r, const cJSON *json,
    struct mesh_request *out)
{
	static const struct field_set set = FIELD_SET(fields);
	const struct json_place at = json_root("");
	const struct json_place edge = json_member(&at, "edge_length");
	struct draft draft = {.request = {.features = true, .normals = true,
	    .colors = true}};

	if (!cJSON_IsObject(json)) {
		reader_fault(r, &at, "must be an object, not %s",
		    json_kind(json));
		return;
	}
	field_read_object(r, &at, json, &set, 1, &draft);
	if (draft.has_resolution && draft.has_edge)
		reader_fault(r, &edge, "give this or resolution, not both");
	if (r->err != ERR_OK)
		return;
	draft.request.resolution = draft.has_edge ? 0 :
	    (size_t)draft.resolution;
	*out = draft.request;
}

enum err mesh_request_parse(const char *text, size_t length,
    struct mesh_request *out, struct faults *faults)
{
	struct arena arena = {0};
	struct reader r = {.arena = &arena, .faults = faults};
	cJSON *json;

	r.err = json_parse(text, length, VALUES_MAX, &arena, &json, faults);
	if (r.err == ERR_OK)
		read_body(&r, json, out);
	arena_fini(&arena);
	return r.err;
}
