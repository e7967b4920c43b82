#include "proto/geometry_request.h"

#include <math.h>
#include <string.h>

#include <cjson/cJSON.h>

#include "core/output.h"
#include "core/tree.h"
#include "proto/document_reader.h"
#include "proto/fault.h"
#include "proto/number.h"
#include "proto/text.h"

/* The most JSON values of a body beside rays or points, of what does not
 * belong, too. */
#define VALUES_MAX 2048

#define SIZE_DEFAULT_WIDTH 640
#define SIZE_DEFAULT_HEIGHT 480
#define SLICE_SIZE_DEFAULT 512
#define FOV_DEFAULT 0.6

/* sin of the least angle between a slice's normal and its up. */
#define PARALLEL 1e-6

/* ---- the query ---- */

struct geometry_terms geometry_defaults(void)
{
	return (struct geometry_terms){GEOMETRY_ISO_DEFAULT, INFINITY, 0.0};
}

bool geometry_query_number(const char *value, const char *pointer,
    double least, double most, double *out, struct faults *faults)
{
	const char *at = value;
	double number;

	if (value == NULL)
		return true;
	if (number_parse(&at, value + strlen(value), &number) == 0 &&
	    *at == '\0' && number >= least && number <= most) {
		*out = number;
		return true;
	}
	faults_add(faults, pointer, "'%.60s' is no number between %.10g and "
	    "%.10g", value, least, most);
	return false;
}

bool geometry_query(const char *iso, const char *max_distance,
    const char *tolerance, struct geometry_terms *terms,
    struct faults *faults)
{
	bool fine = geometry_query_number(iso, "?iso", GEOMETRY_ISO_MIN,
	    GEOMETRY_ISO_MAX, &terms->iso, faults);

	fine &= geometry_query_number(max_distance, "?max_distance",
	    TREE_LENGTH_MIN, TREE_LENGTH_MAX, &terms->max_distance, faults);
	fine &= geometry_query_number(tolerance, "?tolerance",
	    TREE_LENGTH_MIN, TREE_LENGTH_MAX, &terms->tolerance, faults);
	return fine;
}

/* ---- objects with one large member ---- */

/* A body being read: the large member goes elsewhere, the others to object. */
struct body {
	struct json_text text;
	struct arena arena;
	struct faults *faults;
	const char *large; /* the member's name */
	enum err (*read_large)(struct body *b, const struct json_place *at,
	    void *out);
	void *out;
	bool has_large;
	bool is_invalid;   /* faults were found, and reading went on */
	cJSON object;      /* of the other members */
	cJSON *last;
};

static bool has_member(const struct body *b, const char *name)
{
	const cJSON *member;

	if (text_equal(name, b->large))
		return b->has_large;
	cJSON_ArrayForEach(member, &b->object) {
		if (text_equal(member->string, name))
			return true;
	}
	return false;
}

/* A member other than the large one, to b->object. */
static enum err keep_member(struct body *b, const struct json_place *place,
    char *name)
{
	cJSON *value;
	enum err err = json_value(&b->text, place, &value, b->faults);

	if (err != ERR_OK)
		return err;
	value->string = name;
	value->prev = b->last;
	value->next = NULL;
	if (b->last != NULL)
		b->last->next = value;
	else
		b->object.child = value;
	b->last = value;
	return ERR_OK;
}

static enum err read_member(struct body *b, char *name)
{
	const struct json_place root = json_root("");
	const struct json_place place = json_member(&root, name);
	enum err err;

	if (!json_take(&b->text, ':'))
		return json_expected(&b->text, &place, "expected ':'",
		    b->faults);
	if (has_member(b, name))
		return json_wrong(&b->text, &place, "this member comes twice",
		    b->faults);
	if (!text_equal(name, b->large))
		return keep_member(b, &place, name);
	b->has_large = true;
	err = b->read_large(b, &place, b->out);
	if (err != ERR_INVALID)
		return err;
	b->is_invalid = true;
	return ERR_OK;
}

static enum err read_members(struct body *b)
{
	const struct json_place root = json_root("");
	char *name;
	enum err err;

	do {
		err = json_string(&b->text, &root, &name, b->faults);
		if (err == ERR_OK)
			err = read_member(b, name);
	} while (err == ERR_OK && json_take(&b->text, ','));
	if (err == ERR_OK && !json_take(&b->text, '}'))
		err = json_expected(&b->text, &root, "expected ',' or '}'",
		    b->faults);
	return err;
}

static enum err read_text(struct body *b)
{
	const struct json_place root = json_root("");
	cJSON *other;
	enum err err;

	if (json_take(&b->text, '{'))
		err = json_take(&b->text, '}') ? ERR_OK : read_members(b);
	else {
		err = json_value(&b->text, &root, &other, b->faults);
		if (err == ERR_OK) {
			json_fault(b->faults, &root,
			    "must be an object, not %s", json_kind(other));
			return ERR_INVALID;
		}
	}
	return err != ERR_OK ? err : json_finish(&b->text, b->faults);
}

/* Reads the text, then its small members by set into base. */
static enum err read_body(struct body *b, const struct field_set *set,
    void *base)
{
	const struct json_place root = json_root("");
	struct reader r = {.arena = &b->arena, .faults = b->faults};
	enum err err;

	b->object.type = cJSON_Object;
	err = read_text(b);
	if (err == ERR_OK) {
		field_read_object(&r, &root, &b->object, set, 1, base);
		err = r.err;
	}
	if (err == ERR_OK && !b->has_large) {
		json_fault(b->faults, &root, "required field '%s' is missing",
		    b->large);
		err = ERR_INVALID;
	}
	if (err == ERR_OK && b->is_invalid)
		err = ERR_INVALID;
	arena_fini(&b->arena);
	return err;
}

/* ---- rays ---- */

#define ISO_FIELD(type, member) {.name = "iso", .read = field_number, \
	.offset = offsetof(type, member), .least = GEOMETRY_ISO_MIN, \
	.most = GEOMETRY_ISO_MAX}
#define LENGTH_FIELD(label, type, member) {.name = label, \
	.read = field_number, .offset = offsetof(type, member), \
	.least = TREE_LENGTH_MIN, .most = TREE_LENGTH_MAX}

struct large_limit {
	size_t most;
	void *to;
};

static enum err read_rays(struct body *b, const struct json_place *at,
    void *out)
{
	const struct large_limit *limit = out;

	return rays_read(&b->text, at, limit->most, limit->to, b->faults);
}

void raycast_request_fini(struct raycast_request *request)
{
	rays_fini(&request->rays);
}

static enum err parse_raycast(const char *text, size_t length,
    size_t max_rays, struct raycast_request *request, struct faults *faults)
{
	static const struct field fields[] = {
		ISO_FIELD(struct geometry_terms, iso),
		LENGTH_FIELD("max_distance", struct geometry_terms,
		    max_distance),
		LENGTH_FIELD("tolerance", struct geometry_terms, tolerance),
	};
	static const struct field_set set = FIELD_SET(fields);
	struct large_limit limit = {max_rays, &request->rays};
	struct body b = {.faults = faults, .large = "rays",
	    .read_large = read_rays, .out = &limit};

	b.text = json_text(text, length, VALUES_MAX, &b.arena);
	return read_body(&b, &set, &request->terms);
}

enum err raycast_request_parse(const char *text, size_t length,
    enum media_type type, size_t max_rays, struct raycast_request *out,
    struct faults *faults)
{
	struct raycast_request request = {.terms = out->terms};
	enum err err;

	if (type == MEDIA_OCTETS)
		err = rays_from_octets(text, length, max_rays, &request.rays,
		    faults);
	else if (type == MEDIA_NPY)
		err = rays_from_npy(text, length, max_rays, &request.rays,
		    faults);
	else
		err = parse_raycast(text, length, max_rays, &request, faults);
	if (err == ERR_OK)
		*out = request;
	else
		raycast_request_fini(&request);
	return err;
}

/* ---- points ---- */

/* Points as they come may be further out than surfaces can be. */
static enum err check_points(const struct points *points,
    struct faults *faults)
{
	const struct json_place root = json_root("");
	const struct json_place at = json_member(&root, "points");
	enum err err = ERR_OK;

	for (size_t i = 0; i < 3 * points->count; i++) {
		const struct json_place place = json_element(&at, i / 3);

		if (fabsf(points->xyz[i]) <= (float)TREE_COORDINATE_MAX)
			continue;
		json_fault(faults, &place, "point %zu: %c is not within "
		    "+-1e9", i / 3, "xyz"[i % 3]);
		err = ERR_INVALID;
	}
	return err;
}

static enum err read_points(struct body *b, const struct json_place *at,
    void *out)
{
	const struct large_limit *limit = out;
	const char *start;
	enum err err;

	json_space(&b->text);
	start = b->text.cursor;
	err = points_read(&b->text, "/points", limit->most, limit->to,
	    b->faults);
	if (err != ERR_INVALID)
		return err;
	b->text.cursor = start;
	err = json_skip(&b->text, at, b->faults);
	return err != ERR_OK ? err : ERR_INVALID;
}

void project_request_fini(struct project_request *request)
{
	points_fini(&request->points);
}

static enum err parse_project(const char *text, size_t length,
    size_t max_points, struct project_request *request,
    struct faults *faults)
{
	static const struct field fields[] = {
		ISO_FIELD(struct geometry_terms, iso),
		LENGTH_FIELD("max_distance", struct geometry_terms,
		    max_distance),
	};
	static const struct field_set set = FIELD_SET(fields);
	struct large_limit limit = {max_points, &request->points};
	struct body b = {.faults = faults, .large = "points",
	    .read_large = read_points, .out = &limit};

	b.text = json_text(text, length, VALUES_MAX, &b.arena);
	return read_body(&b, &set, &request->terms);
}

enum err project_request_parse(const char *text, size_t length,
    enum media_type type, size_t max_points, struct project_request *out,
    struct faults *faults)
{
	struct project_request request = {.terms = out->terms};
	enum err err;

	if (type == MEDIA_OCTETS)
		err = points_from_octets(text, length, max_points,
		    &request.points, faults);
	else if (type == MEDIA_NPY)
		err = points_from_npy(text, length, max_points,
		    &request.points, faults);
	else
		err = parse_project(text, length, max_points, &request,
		    faults);
	if (err == ERR_OK)
		err = check_points(&request.points, faults);
	if (err == ERR_OK)
		*out = request;
	else
		project_request_fini(&request);
	return err;
}

/* ---- values of pictures ---- */

/* For struct field.read: a whole number in least..most: size_t. */
static void read_whole(struct reader *r, const struct json_place *at,
    const struct cJSON *value, const struct field *field, void *base)
{
	size_t *out = (size_t *)((char *)base + field->offset);

	if (!field_is_number(r, at, value, field->least, field->most))
		return;
	if (value->valuedouble != floor(value->valuedouble))
		reader_fault(r, at, "must be a whole number");
	else
		*out = (size_t)value->valuedouble;
}

/* The index of value, a string, in names (count of them), or a fault and -1. */
static int read_name(struct reader *r, const struct json_place *at,
    const struct cJSON *value, const char *const *names, int count)
{
	char known[100] = "";

	if (!cJSON_IsString(value)) {
		reader_fault(r, at, "must be a string, not %s",
		    json_kind(value));
		return -1;
	}
	for (int i = 0; i < count; i++) {
		if (text_equal(names[i], value->valuestring))
			return i;
		strcat(known, i == 0 ? "" : i + 1 < count ? ", " : " or ");
		strcat(known, names[i]);
	}
	reader_fault(r, at, "must be %s, not '%.40s'", known,
	    value->valuestring);
	return -1;
}

/* The body as a whole, read by set into base. */
static void read_object(struct reader *r, const char *text, size_t length,
    const struct field_set *set, void *base)
{
	const struct json_place at = json_root("");
	cJSON *json;

	r->err = json_parse(text, length, VALUES_MAX, r->arena, &json,
	    r->faults);
	if (r->err != ERR_OK)
		return;
	if (cJSON_IsObject(json))
		field_read_object(r, &at, json, set, 1, base);
	else
		reader_fault(r, &at, "must be an object, not %s",
		    json_kind(json));
}

static void check_size(struct reader *r, double count, size_t most,
    const char *what)
{
	const struct json_place at = json_root("");

	if (r->err == ERR_OK && count > (double)most)
		reader_limit(r, &at, "%s are %.0f, more than the %zu that are "
		    "allowed (--max-points)", what, count, most);
}

#define SIZE_FIELD(label, type, member) {.name = label, \
	.read = read_whole, .offset = offsetof(type, member), .least = 1, \
	.most = PICTURE_SIZE_MAX}

/* ---- render ---- */

static void read_projection(struct reader *r, const struct json_place *at,
    const struct cJSON *value, const struct field *field, void *base)
{
	static const char *const names[] = {"perspective", "orthographic"};
	struct picture_camera *camera = base;

	(void)field;
	camera->orthographic = read_name(r, at, value, names, 2) == 1;
}

static void read_camera(struct reader *r, const struct json_place *at,
    const struct cJSON *value, const struct field *field, void *base)
{
	static const struct field fields[] = {
		{.name = "eye", .read = field_vec3, .required = true,
		    .offset = offsetof(struct picture_camera, eye),
		    .least = -TREE_COORDINATE_MAX,
		    .most = TREE_COORDINATE_MAX},
		{.name = "target", .read = field_vec3, .required = true,
		    .offset = offsetof(struct picture_camera, target),
		    .least = -TREE_COORDINATE_MAX,
		    .most = TREE_COORDINATE_MAX},
		{.name = "up", .read = field_direction,
		    .offset = offsetof(struct picture_camera, up),
		    .least = -TREE_COORDINATE_MAX,
		    .most = TREE_COORDINATE_MAX},
		{.name = "fov", .read = field_number,
		    .offset = offsetof(struct picture_camera, fov),
		    .least = 0.01, .most = 3.0},
		{.name = "projection", .read = read_projection},
		LENGTH_FIELD("view_height", struct picture_camera,
		    view_height),
	};
	static const struct field_set set = FIELD_SET(fields);
	struct render_request *request = base;
	struct picture_camera *camera = &request->picture.camera;
	const struct json_place target = json_member(at, "target");
	double away;

	(void)field;
	request->has_camera = true;
	if (!cJSON_IsObject(value)) {
		reader_fault(r, at, "must be an object, not %s",
		    json_kind(value));
		return;
	}
	field_read_object(r, at, value, &set, 1, camera);
	if (r->err != ERR_OK)
		return;
	away = vec3_norm(vec3_sub(camera->target, camera->eye));
	if (away < TREE_LENGTH_MIN)
		reader_fault(r, &target, "must not be where the eye is");
	/* At the target an orthographic one sees as much as the other. */
	if (camera->view_height == 0.0)
		camera->view_height = 2.0 * away * tan(0.5 * camera->fov);
}

static void read_shading(struct reader *r, const struct json_place *at,
    const struct cJSON *value, const struct field *field, void *base)
{
	static const char *const names[SHADING_COUNT] = {
		[SHADING_LIT] = "lit",
		[SHADING_NORMAL] = "normal",
		[SHADING_ZEBRA] = "zebra",
		[SHADING_CURVATURE] = "curvature",
		[SHADING_FIELD] = "field",
	};
	struct render_request *request = base;
	int i = read_name(r, at, value, names, SHADING_COUNT);

	(void)field;
	if (i >= 0)
		request->picture.shading = (enum picture_shading)i;
}

static void read_background(struct reader *r, const struct json_place *at,
    const struct cJSON *value, const struct field *field, void *base)
{
	struct render_request *request = base;
	double rgb[3];

	if (cJSON_IsNull(value))
		return;
	if (!field_numbers(r, at, value, 3, field->least, field->most, rgb))
		return;
	request->picture.has_background = true;
	request->picture.background = vec3(rgb[0], rgb[1], rgb[2]);
}

static void read_samples(struct reader *r, const struct json_place *at,
    const struct cJSON *value, const struct field *field, void *base)
{
	struct render_request *request = base;
	double n;

	(void)field;
	if (!field_is_number(r, at, value, 1.0, 16.0))
		return;
	n = value->valuedouble;
	if (n != 1.0 && n != 4.0 && n != 9.0 && n != 16.0)
		reader_fault(r, at, "must be 1, 4, 9 or 16");
	else
		request->picture.samples = (int)n;
}

static const struct field render_fields[] = {
	SIZE_FIELD("width", struct render_request, picture.width),
	SIZE_FIELD("height", struct render_request, picture.height),
	{.name = "camera", .read = read_camera},
	{.name = "shading", .read = read_shading},
	{.name = "background", .read = read_background, .most = 1.0},
	{.name = "samples", .read = read_samples},
	ISO_FIELD(struct render_request, picture.iso),
};

enum err render_request_parse(const char *text, size_t length,
    size_t max_rays, struct render_request *out, struct faults *faults)
{
	static const struct field_set set = FIELD_SET(render_fields);
	struct arena arena = {0};
	struct reader r = {.arena = &arena, .faults = faults};
	struct render_request request = {.picture = {
		.width = SIZE_DEFAULT_WIDTH,
		.height = SIZE_DEFAULT_HEIGHT,
		.camera = {.up = {0.0, 0.0, 1.0}, .fov = FOV_DEFAULT},
		.samples = 4,
		.iso = GEOMETRY_ISO_DEFAULT,
	}};
	const struct picture_render *p = &request.picture;

	read_object(&r, text, length, &set, &request);
	check_size(&r, (double)p->width * (double)p->height * p->samples,
	    max_rays, "width times height times samples, its rays,");
	arena_fini(&arena);
	if (r.err == ERR_OK)
		*out = request;
	return r.err;
}

/* ---- slice ---- */

/* What a slice's body is read into. */
struct slice_draft {
	struct slice_request request;
	double step;
	bool has_up;
};

static void read_center(struct reader *r, const struct json_place *at,
    const struct cJSON *value, const struct field *field, void *base)
{
	struct slice_draft *draft = base;

	draft->request.has_center = true;
	field_vec3(r, at, value, field, base);
}

static void read_extent(struct reader *r, const struct json_place *at,
    const struct cJSON *value, const struct field *field, void *base)
{
	struct slice_draft *draft = base;

	draft->request.has_extent = true;
	field_number(r, at, value, field, base);
}

static void read_up(struct reader *r, const struct json_place *at,
    const struct cJSON *value, const struct field *field, void *base)
{
	struct slice_draft *draft = base;

	draft->has_up = true;
	field_direction(r, at, value, field, base);
}

static void read_level_list(struct reader *r, const struct json_place *at,
    const struct cJSON *value, struct slice_draft *draft)
{
	struct json_place place = json_element(at, 0);
	const cJSON *level;

	draft->step = 0.0;
	if (cJSON_GetArraySize(value) > PICTURE_LEVELS_MAX) {
		reader_fault(r, at, "must have %d numbers at most, not %d",
		    PICTURE_LEVELS_MAX, cJSON_GetArraySize(value));
		return;
	}
	cJSON_ArrayForEach(level, value) {
		if (field_is_number(r, &place, level, -1e9, 1e9))
			draft->request.levels[place.index] =
			    level->valuedouble;
		place.index++;
	}
	draft->request.level_count = place.index;
}

static void read_levels(struct reader *r, const struct json_place *at,
    const struct cJSON *value, const struct field *field, void *base)
{
	static const struct field fields[] = {
		{.name = "step", .read = field_number, .required = true,
		    .offset = offsetof(struct slice_draft, step),
		    .least = 1e-6, .most = 1e6},
	};
	static const struct field_set set = FIELD_SET(fields);

	(void)field;
	if (cJSON_IsArray(value))
		read_level_list(r, at, value, base);
	else if (cJSON_IsObject(value))
		field_read_object(r, at, value, &set, 1, base);
	else
		reader_fault(r, at, "must be an array of numbers or {\"step\": "
		    "number}, not %s", json_kind(value));
}

static void read_output(struct reader *r, const struct json_place *at,
    const struct cJSON *value, const struct field *field, void *base)
{
	static const char *const names[] = {"value", "gradient", "hessian",
	    "color", "normal", "curvature"};
	struct slice_draft *draft = base;
	int i = read_name(r, at, value, names, 6);

	(void)field;
	if (i >= 0)
		draft->request.output = 1u << i;
}

static const struct field slice_fields[] = {
	{.name = "center", .read = read_center,
	    .offset = offsetof(struct slice_draft, request.center),
	    .least = -TREE_COORDINATE_MAX, .most = TREE_COORDINATE_MAX},
	{.name = "normal", .read = field_direction,
	    .offset = offsetof(struct slice_draft, request.normal),
	    .least = -TREE_COORDINATE_MAX, .most = TREE_COORDINATE_MAX},
	{.name = "up", .read = read_up,
	    .offset = offsetof(struct slice_draft, request.up),
	    .least = -TREE_COORDINATE_MAX, .most = TREE_COORDINATE_MAX},
	SIZE_FIELD("width", struct slice_draft, request.width),
	SIZE_FIELD("height", struct slice_draft, request.height),
	{.name = "extent", .read = read_extent,
	    .offset = offsetof(struct slice_draft, request.extent),
	    .least = TREE_LENGTH_MIN, .most = TREE_LENGTH_MAX},
	{.name = "levels", .read = read_levels},
	ISO_FIELD(struct slice_draft, request.iso),
	{.name = "output", .read = read_output},
};

/* An up that is not said goes to another axis where it would not do. */
static void check_up(struct reader *r, struct slice_draft *draft)
{
	const struct json_place root = json_root("");
	const struct json_place at = json_member(&root, "up");
	struct slice_request *request = &draft->request;

	if (r->err != ERR_OK || vec3_norm(vec3_cross(request->up,
	    request->normal)) > PARALLEL)
		return;
	if (draft->has_up)
		reader_fault(r, &at, "must not be along the normal");
	request->up = vec3(0.0, 1.0, 0.0);
}

static void set_levels(struct slice_draft *draft)
{
	struct slice_request *request = &draft->request;

	if (draft->step <= 0.0)
		return;
	request->level_count = PICTURE_LEVELS_MAX;
	for (size_t i = 0; i < PICTURE_LEVELS_MAX; i++)
		request->levels[i] = draft->step * (double)(i + 1);
}

enum err slice_request_parse(const char *text, size_t length,
    size_t max_points, struct slice_request *out, struct faults *faults)
{
	static const struct field_set set = FIELD_SET(slice_fields);
	struct arena arena = {0};
	struct reader r = {.arena = &arena, .faults = faults};
	struct slice_draft draft = {
		.request = {
			.width = SLICE_SIZE_DEFAULT,
			.height = SLICE_SIZE_DEFAULT,
			.normal = {0.0, -1.0, 0.0},
			.up = {0.0, 0.0, 1.0},
			.iso = GEOMETRY_ISO_DEFAULT,
		},
		.step = GEOMETRY_STEP_DEFAULT,
	};

	read_object(&r, text, length, &set, &draft);
	check_up(&r, &draft);
	set_levels(&draft);
	check_size(&r, (double)draft.request.width *
	    (double)draft.request.height, max_points,
	    "width times height, its points,");
	arena_fini(&arena);
	if (r.err == ERR_OK)
		*out = draft.request;
	return r.err;
}
