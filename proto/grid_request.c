#include "proto/grid_request.h"

#include <math.h>
#include <stdlib.h>

#include <cjson/cJSON.h>

#include "core/tree.h"
#include "proto/document_reader.h"
#include "proto/fault.h"
#include "proto/request.h"

/* The most JSON values of a body, of what does not belong, too. */
#define VALUES_MAX 256

static void read_counts(struct reader *r, const struct json_place *at,
    const struct cJSON *value, const struct field *field, void *base)
{
	struct grid_request *request = base;
	double counts[3];

	if (!field_numbers(r, at, value, 3, field->least, field->most, counts))
		return;
	for (size_t i = 0; i < 3; i++) {
		const struct json_place place = json_element(at, i);

		if (counts[i] != floor(counts[i]))
			reader_fault(r, &place, "must be a whole number");
		request->counts[i] = (size_t)counts[i];
	}
}

static void read_outputs(struct reader *r, const struct json_place *at,
    const struct cJSON *value, const struct field *field, void *base)
{
	struct grid_request *request = base;

	(void)field;
	if (outputs_from_json(value, at, &request->outputs, r->faults) !=
	    ERR_OK && r->err == ERR_OK)
		r->err = ERR_INVALID;
}

#define CORNER_FIELD(label) {.name = #label, .read = field_vec3, \
	.offset = offsetof(struct grid_request, label), .required = true, \
	.least = -TREE_COORDINATE_MAX, .most = TREE_COORDINATE_MAX}

static const struct field grid_fields[] = {
	CORNER_FIELD(min),
	CORNER_FIELD(max),
	{.name = "counts", .read = read_counts, .required = true,
	    .least = 1.0, .most = GRID_COUNT_MAX},
	{.name = "outputs", .read = read_outputs},
};

static void read_body(struct reader *r, const char *text, size_t length,
    struct grid_request *request)
{
	static const struct field_set set = FIELD_SET(grid_fields);
	const struct json_place root = json_root("");
	cJSON *json;

	r->err = json_parse(text, length, VALUES_MAX, r->arena, &json,
	    r->faults);
	if (r->err != ERR_OK)
		return;
	if (cJSON_IsObject(json))
		field_read_object(r, &root, json, &set, 1, request);
	else
		reader_fault(r, &root, "must be an object, not %s",
		    json_kind(json));
}

static void check_corners(struct reader *r, const struct grid_request *g)
{
	const double min[] = {g->min.x, g->min.y, g->min.z};
	const double max[] = {g->max.x, g->max.y, g->max.z};
	const struct json_place root = json_root("");
	const struct json_place at = json_member(&root, "max");

	for (size_t i = 0; i < 3; i++) {
		const struct json_place place = json_element(&at, i);

		if (max[i] < min[i])
			reader_fault(r, &place, "must be at least %.10g, which "
			    "min has", min[i]);
	}
}

static size_t grid_points(const struct grid_request *g)
{
	return g->counts[0] * g->counts[1] * g->counts[2];
}

static void check_counts(struct reader *r, const struct grid_request *g,
    size_t max_points)
{
	const struct json_place root = json_root("");
	const struct json_place at = json_member(&root, "counts");

	if (grid_points(g) > max_points)
		reader_limit(r, &at, "there are %zu points, more than the %zu "
		    "that are allowed (--max-points)", grid_points(g),
		    max_points);
}

enum err grid_request_parse(const char *text, size_t length,
    unsigned default_outputs, size_t max_points, struct grid_request *out,
    struct faults *faults)
{
	struct arena arena = {0};
	struct reader r = {.arena = &arena, .faults = faults};
	struct grid_request request = {.outputs = default_outputs};

	read_body(&r, text, length, &request);
	if (r.err == ERR_OK) {
		check_corners(&r, &request);
		check_counts(&r, &request, max_points);
	}
	arena_fini(&arena);
	if (r.err == ERR_OK)
		*out = request;
	return r.err;
}

/* Where point i of count between min and max is. */
static float coordinate(double min, double max, size_t i, size_t count)
{
	if (i == 0)
		return (float)min;
	if (i + 1 == count)
		return (float)max;
	return (float)(min + (max - min) * (double)i / (double)(count - 1));
}

/* Those of one x, from out on. */
static float *put_layer(const struct grid_request *g, float x, float *out)
{
	for (size_t j = 0; j < g->counts[1]; j++) {
		const float y = coordinate(g->min.y, g->max.y, j,
		    g->counts[1]);

		for (size_t k = 0; k < g->counts[2]; k++) {
			*out++ = x;
			*out++ = y;
			*out++ = coordinate(g->min.z, g->max.z, k,
			    g->counts[2]);
		}
	}
	return out;
}

enum err grid_request_points(const struct grid_request *request,
    struct points *out)
{
	const size_t count = grid_points(request);
	float *to, *xyz = malloc(3 * count * sizeof *xyz);

	if (xyz == NULL)
		return ERR_MEMORY;
	to = xyz;
	for (size_t i = 0; i < request->counts[0]; i++)
		to = put_layer(request, coordinate(request->min.x,
		    request->max.x, i, request->counts[0]), to);
	*out = (struct points){.xyz = xyz, .count = count, .flat = true};
	return ERR_OK;
}
