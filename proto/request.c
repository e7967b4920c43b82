#include "proto/request.h"

#include <stdint.h>
#include <string.h>

#include <cjson/cJSON.h>

#include "core/output.h"
#include "proto/arena.h"
#include "proto/document.h"
#include "proto/eval_splice.h"
#include "proto/fault.h"
#include "proto/json.h"

/* JSON values beside the scene's: of outputs, and of what does not belong. */
#define VALUES_BESIDE 1024

static const struct {
	const char *name;
	unsigned bit;
} output_names[] = {
	{"value", OUTPUT_VALUE},
	{"gradient", OUTPUT_GRADIENT},
	{"hessian", OUTPUT_HESSIAN},
	{"color", OUTPUT_COLOR},
	{"normal", OUTPUT_NORMAL},
	{"curvature", OUTPUT_CURVATURE},
};

/* Adds the output called by the n characters at name to *outputs. */
static bool add_output(const char *name, size_t n, unsigned *outputs,
    const struct json_place *place, struct faults *faults)
{
	const int shown = n > 64 ? 64 : (int)n;
	size_t i;

	for (i = 0; i < sizeof output_names / sizeof *output_names; i++) {
		if (strlen(output_names[i].name) != n ||
		    memcmp(output_names[i].name, name, n) != 0)
			continue;
		if (*outputs & output_names[i].bit) {
			json_fault(faults, place, "output '%.*s' is given twice",
			    shown, name);
			return false;
		}
		*outputs |= output_names[i].bit;
		return true;
	}
	json_fault(faults, place, "unknown output '%.*s': value, gradient, "
	    "hessian, color, normal or curvature", shown, name);
	return false;
}

enum err outputs_from_list(const char *value, const char *pointer,
    unsigned *outputs, struct faults *faults)
{
	const struct json_place place = json_root(pointer);
	unsigned found = 0;
	bool fine = true;
	const char *p = value;
	size_t n;

	if (!value) {
		*outputs = OUTPUT_VALUE | OUTPUT_GRADIENT;
		return ERR_OK;
	}
	for (;; p++) {
		p += strspn(p, " ");
		n = strcspn(p, ", ");
		fine = add_output(p, n, &found, &place, faults) && fine;
		p += n;
		p += strspn(p, " ");
		if (*p != ',')
			break;
	}
	if (*p) {
		json_fault(faults, &place, "outputs are separated by commas");
		fine = false;
	}
	if (!fine)
		return ERR_INVALID;
	*outputs = found;
	return ERR_OK;
}

enum err outputs_from_json(const struct cJSON *list,
    const struct json_place *place, unsigned *outputs, struct faults *faults)
{
	struct json_place at = json_element(place, 0);
	const cJSON *name;
	unsigned found = 0;
	bool fine = true;

	if (!cJSON_IsArray(list) || !list->child) {
		json_fault(faults, place, "must be an array of 1 or more names");
		return ERR_INVALID;
	}
	cJSON_ArrayForEach(name, list) {
		if (cJSON_IsString(name)) {
			fine = add_output(name->valuestring,
			    strlen(name->valuestring), &found, &at, faults) &&
			    fine;
		} else {
			json_fault(faults, &at, "must be a string, not %s",
			    json_kind(name));
			fine = false;
		}
		at.index++;
	}
	if (!fine)
		return ERR_INVALID;
	*outputs = found;
	return ERR_OK;
}

void eval_request_fini(struct eval_request *request)
{
	document_free(request->document);
	points_fini(&request->points);
	*request = (struct eval_request){0};
}

/* One body being read; the members found so far. */
struct body {
	struct json_text text;
	struct arena arena; /* of the text's values */
	const struct eval_splice *splice; /* or NULL */
	bool with_scene;
	size_t max_points;
	const struct document_limits *limits;
	struct faults *faults;
	bool has_scene, has_points, has_outputs;
	bool invalid; /* faults were found, and reading went on */
	cJSON *scene;
	struct points points;
	unsigned outputs;
};

static enum err read_outputs(struct body *b, const struct json_place *place)
{
	cJSON *list;
	enum err err;

	err = json_value(&b->text, place, &list, b->faults);
	if (err)
		return err;
	if (outputs_from_json(list, place, &b->outputs, b->faults) != ERR_OK)
		b->invalid = true;
	return ERR_OK;
}

static enum err read_unknown(struct body *b, const struct json_place *place)
{
	cJSON *value;

	if (strcmp(place->name, "scene") == 0)
		json_fault(b->faults, place, "the scene is the one that the "
		    "URL names");
	else
		json_fault(b->faults, place, "unknown field '%.64s'",
		    place->name);
	b->invalid = true;
	return json_value(&b->text, place, &value, b->faults);
}

/* Whether this member came before; marks it. */
static bool again(bool *has)
{
	const bool had = *has;

	*has = true;
	return had;
}

static enum err twice(struct body *b, const struct json_place *place)
{
	return json_wrong(&b->text, place, "this member comes twice",
	    b->faults);
}

/* Takes the points that were scanned before. */
static enum err take_points(struct body *b)
{
	const struct eval_splice *splice = b->splice;
	size_t i;

	for (i = 0; i < splice->faults->count; i++)
		faults_add(b->faults, splice->faults->list[i].pointer, "%s",
		    splice->faults->list[i].detail);
	if (splice->err)
		return splice->err;
	b->invalid = b->invalid || splice->invalid;
	b->points = *splice->points;
	*splice->points = (struct points){0};
	b->text.cursor++;
	b->text.resumed = splice->behind;
	b->text.resumed.at = b->text.cursor;
	return ERR_OK;
}

/* Of wrong points the first fault is told; reading goes on behind them. */
static enum err read_points(struct body *b, const struct json_place *place)
{
	const char *start;
	enum err err;

	json_space(&b->text);
	start = b->text.cursor;
	if (b->splice && b->splice->at == start)
		return take_points(b);
	err = points_read(&b->text, "/points", b->max_points, &b->points,
	    b->faults);
	if (err != ERR_INVALID)
		return err;
	b->invalid = true;
	b->text.cursor = start;
	return json_skip(&b->text, place, b->faults);
}

static enum err read_member(struct body *b, const struct json_place *place)
{
	if (strcmp(place->name, "points") == 0) {
		if (again(&b->has_points))
			return twice(b, place);
		return read_points(b, place);
	}
	if (strcmp(place->name, "outputs") == 0) {
		if (again(&b->has_outputs))
			return twice(b, place);
		return read_outputs(b, place);
	}
	if (strcmp(place->name, "scene") == 0 && b->with_scene) {
		if (again(&b->has_scene))
			return twice(b, place);
		return json_value(&b->text, place, &b->scene, b->faults);
	}
	return read_unknown(b, place);
}

static enum err read_members(struct body *b)
{
	const struct json_place root = json_root("");
	struct json_place place;
	char *name;
	enum err err;

	do {
		err = json_string(&b->text, &root, &name, b->faults);
		if (err)
			return err;
		place = json_member(&root, name);
		if (json_take(&b->text, ':'))
			err = read_member(b, &place);
		else
			err = json_expected(&b->text, &place, "expected ':'",
			    b->faults);
		if (err)
			return err;
	} while (json_take(&b->text, ','));
	if (!json_take(&b->text, '}'))
		return json_expected(&b->text, &root, "expected ',' or '}'",
		    b->faults);
	return ERR_OK;
}

static enum err read_body(struct body *b)
{
	const struct json_place root = json_root("");
	cJSON *other;
	enum err err;

	if (json_take(&b->text, '{'))
		err = json_take(&b->text, '}') ? ERR_OK : read_members(b);
	else {
		err = json_value(&b->text, &root, &other, b->faults);
		if (!err) {
			json_fault(b->faults, &root, "must be an object, not %s",
			    json_kind(other));
			return ERR_INVALID;
		}
	}
	return err ? err : json_finish(&b->text, b->faults);
}

static enum err check_members(const struct body *b)
{
	const struct json_place root = json_root("");
	bool fine = !b->invalid;

	if (b->with_scene && !b->has_scene) {
		json_fault(b->faults, &root, "required field 'scene' is missing");
		fine = false;
	}
	if (!b->has_points) {
		json_fault(b->faults, &root,
		    "required field 'points' is missing");
		fine = false;
	}
	return fine ? ERR_OK : ERR_INVALID;
}

static struct json_text body_text(const char *text, size_t length,
    const struct document_limits *limits, struct arena *arena)
{
	const size_t most = document_values_max(limits);

	return json_text(text, length, most > SIZE_MAX - VALUES_BESIDE ?
	    SIZE_MAX : most + VALUES_BESIDE, arena);
}

/* Of a body without its points: with them it may be any size. */
static enum err check_bytes(const struct body *b,
    const struct eval_splice *splice, size_t length)
{
	const struct json_place root = json_root("");
	const size_t most = b->limits->max_bytes;

	if (splice == NULL || most == 0 || length <= most)
		return ERR_OK;
	json_fault(b->faults, &root, "there are %zu bytes besides the points; "
	    "%zu are the most", length, most);
	return ERR_LIMIT;
}

enum err eval_splice_parse(const char *text, size_t length,
    const struct eval_splice *splice, bool with_scene,
    unsigned default_outputs, const struct document_limits *limits,
    size_t max_points, struct eval_request *out, struct faults *faults)
{
	struct body b = {.text = body_text(text, length, limits, &b.arena),
	    .splice = splice, .with_scene = with_scene, .max_points = max_points,
	    .limits = limits, .faults = faults, .outputs = default_outputs};
	struct document *document = NULL;
	enum err err, members;

	err = check_bytes(&b, splice, length);
	if (!err)
		err = read_body(&b);
	if (err)
		goto fail;
	members = check_members(&b);
	if (b.has_scene)
		err = document_from_json(b.scene, "/scene", limits, &document,
		    faults);
	if (!err)
		err = members;
	if (err)
		goto fail;
	arena_fini(&b.arena);
	*out = (struct eval_request){document, b.points, b.outputs};
	return ERR_OK;

fail:
	document_free(document);
	points_fini(&b.points);
	arena_fini(&b.arena);
	return err;
}

enum err eval_request_parse(const char *text, size_t length, bool with_scene,
    unsigned default_outputs, const struct document_limits *limits,
    size_t max_points, struct eval_request *out, struct faults *faults)
{
	return eval_splice_parse(text, length, NULL, with_scene,
	    default_outputs, limits, max_points, out, faults);
}
