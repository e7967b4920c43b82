/*
 * Bodies about rays, projections, pictures and slices: whatever comes, what is
 * taken keeps its promises. The first byte says which it is.
 */
#include <math.h>
#include <stddef.h>
#include <stdint.h>
#include <stdlib.h>
#include <string.h>

#include "core/project.h"
#include "core/tree.h"
#include "proto/fault.h"
#include "proto/geometry_answer.h"
#include "proto/geometry_request.h"

#define MOST 20

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size);

static void demand(int fine)
{
	if (!fine)
		abort();
}

/* Failures tell why; except for lack of memory, which there is not. */
static void demand_result(enum err err, const struct faults *faults)
{
	demand(err == ERR_OK || err == ERR_SYNTAX || err == ERR_INVALID ||
	    err == ERR_LIMIT);
	demand((err == ERR_OK) == (faults->count == 0));
}

static void demand_iso(double iso)
{
	demand(iso >= GEOMETRY_ISO_MIN && iso <= GEOMETRY_ISO_MAX);
}

static void demand_terms(const struct geometry_terms *terms)
{
	demand_iso(terms->iso);
	demand(terms->max_distance >= TREE_LENGTH_MIN);
	demand(terms->tolerance >= 0.0 && isfinite(terms->tolerance));
}

/* Prints an answer of as many misses. */
static void print(size_t count, bool is_flat)
{
	static const float rows[MOST * RAY_COLUMNS];
	static const char *const nodes[MOST];
	size_t length;
	char *text;

	demand(raycast_answer_json(rows, count, nodes, is_flat, &text,
	    &length) == ERR_OK);
	demand(length > 0 && text[length - 1] == '}');
	free(text);
}

static void try_rays(const char *text, size_t length, enum media_type type)
{
	struct raycast_request r = {.terms = geometry_defaults()};
	struct faults faults = {0};
	enum err err = raycast_request_parse(text, length, type, MOST, &r,
	    &faults);

	demand_result(err, &faults);
	if (err != ERR_OK)
		return;
	demand(r.rays.count <= MOST);
	for (size_t i = 0; i < r.rays.count; i++) {
		const float *ray = r.rays.numbers + RAY_FLOATS * i;

		for (int k = 0; k < RAY_FLOATS; k++)
			demand(isfinite(ray[k]));
		demand(ray[3] != 0.0f || ray[4] != 0.0f || ray[5] != 0.0f);
	}
	demand_terms(&r.terms);
	print(r.rays.count, r.rays.flat);
	raycast_request_fini(&r);
}

static void try_points(const char *text, size_t length, enum media_type type)
{
	struct project_request r = {.terms = geometry_defaults()};
	struct faults faults = {0};
	enum err err = project_request_parse(text, length, type, MOST, &r,
	    &faults);

	demand_result(err, &faults);
	if (err != ERR_OK)
		return;
	demand(r.points.count <= MOST);
	for (size_t i = 0; i < 3 * r.points.count; i++)
		demand(fabsf(r.points.xyz[i]) <= 1e9f);
	demand_terms(&r.terms);
	project_request_fini(&r);
}

static void try_render(const char *text, size_t length)
{
	struct render_request r;
	struct faults faults = {0};
	enum err err = render_request_parse(text, length, 1000000, &r,
	    &faults);

	demand_result(err, &faults);
	if (err != ERR_OK)
		return;
	demand(r.picture.width >= 1 && r.picture.width <= PICTURE_SIZE_MAX);
	demand(r.picture.width * r.picture.height *
	    (size_t)r.picture.samples <= 1000000);
	demand(r.picture.shading < SHADING_COUNT);
	demand_iso(r.picture.iso);
	if (r.has_camera)
		demand(r.picture.camera.view_height > 0.0 &&
		    isfinite(r.picture.camera.view_height));
}

static void try_slice(const char *text, size_t length)
{
	struct slice_request r;
	struct faults faults = {0};
	enum err err = slice_request_parse(text, length, 1000000, &r, &faults);

	demand_result(err, &faults);
	if (err != ERR_OK)
		return;
	demand(r.width * r.height <= 1000000);
	demand(vec3_norm(vec3_cross(r.up, r.normal)) > 0.0);
	demand(r.level_count <= PICTURE_LEVELS_MAX);
	for (size_t i = 0; i < r.level_count; i++)
		demand(isfinite(r.levels[i]));
	demand_iso(r.iso);
	demand(!r.has_extent || r.extent > 0.0);
}

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size)
{
	const char *text = (const char *)data + 1;
	char query[16] = "";
	struct geometry_terms terms = geometry_defaults();
	struct faults faults = {0};

	if (size < 1)
		return 0;
	memcpy(query, text, size - 1 < sizeof query - 1 ? size - 1 :
	    sizeof query - 1);
	if (geometry_query(query, query, query, &terms, &faults))
		demand_terms(&terms);
	switch (data[0] % 8) {
	case 0:
	case 1:
	case 2:
		try_rays(text, size - 1, (enum media_type)(data[0] % 8));
		break;
	case 3:
	case 4:
	case 5:
		try_points(text, size - 1,
		    (enum media_type)(data[0] % 8 - 3));
		break;
	case 6:
		try_render(text, size - 1);
		break;
	default:
		try_slice(text, size - 1);
	}
	return 0;
}
