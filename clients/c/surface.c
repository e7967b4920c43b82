/*
 * Meshes and pictures of the C client: options to JSON, answers to memory or
 * to files.
 */
#include <errno.h>
#include <stdlib.h>
#include <string.h>
#include <unistd.h>

#include <cjson/cJSON.h>

#include "clients/c/client.h"

static void add_number(cJSON *json, const char *name, double number)
{
	if (number != 0.0)
		cJSON_AddNumberToObject(json, name, number);
}

static void add_vector(cJSON *json, const char *name, const double *v)
{
	if (v != NULL)
		cJSON_AddItemToObject(json, name,
		    cJSON_CreateDoubleArray(v, 3));
}

static void add_text(cJSON *json, const char *name, const char *text)
{
	if (text != NULL)
		cJSON_AddStringToObject(json, name, text);
}

/* POST …/tail of json, which is taken over; file may be NULL. */
static enum blobfield_outcome post(struct blobfield *b, const char *id,
    const char *tail, cJSON *json, const char *accept, FILE *file)
{
	char path[CLIENT_PATH_MAX];
	enum blobfield_outcome outcome = client_path(b, path, id, tail);
	char *body = cJSON_PrintUnformatted(json);

	cJSON_Delete(json);
	if (outcome == BLOBFIELD_OK && body == NULL)
		outcome = client_fail(b, BLOBFIELD_MEMORY, "out of memory");
	if (outcome == BLOBFIELD_OK)
		outcome = client_do(b, &(struct transfer_request){
			.method = "POST",
			.path = path,
			.type = CLIENT_JSON,
			.accept = accept,
			.body = body,
			.size = strlen(body),
			.is_long = true,
			.file = file
		});
	cJSON_free(body);
	return outcome;
}

static enum blobfield_outcome post_to_memory(struct blobfield *b,
    const char *id, const char *tail, cJSON *json, const char *accept,
    struct blobfield_bytes *out)
{
	enum blobfield_outcome outcome = post(b, id, tail, json, accept, NULL);

	if (outcome == BLOBFIELD_OK)
		client_take(b, out);
	return outcome;
}

/* ---- meshes ---- */

static cJSON *mesh_json(const struct blobfield_mesh_options *o,
    const char *format)
{
	cJSON *json = cJSON_CreateObject(), *box;

	add_text(json, "format", format);
	if (o == NULL)
		return json;
	add_number(json, "resolution", o->resolution);
	add_number(json, "edge_length", o->edge_length);
	add_number(json, "iso", o->iso);
	if (o->box != NULL) {
		box = cJSON_AddObjectToObject(json, "bounds");
		add_vector(box, "min", o->box->min);
		add_vector(box, "max", o->box->max);
	}
	if (o->no_features)
		cJSON_AddFalseToObject(json, "features");
	if (o->no_normals)
		cJSON_AddFalseToObject(json, "normals");
	if (o->no_colors)
		cJSON_AddFalseToObject(json, "colors");
	return json;
}

enum blobfield_outcome blobfield_mesh(struct blobfield *b, const char *id,
    const struct blobfield_mesh_options *options, struct blobfield_bytes *out)
{
	const char *format = options != NULL && options->format != NULL ?
	    options->format : "glb";

	return post_to_memory(b, id, "/mesh", mesh_json(options, format),
	    NULL, out);
}

/* NULL: none that is known. */
static const char *format_of(const char *path)
{
	static const char *const formats[] = {"glb", "ply", "stl", "obj",
	    "json"};
	const char *dot = strrchr(path, '.');

	for (size_t i = 0; dot != NULL && i < 5; i++)
		if (strcasecmp(dot + 1, formats[i]) == 0)
			return formats[i];
	return NULL;
}

/* Beside path, and then in its place. */
static enum blobfield_outcome mesh_by_part(struct blobfield *b,
    const char *id, cJSON *json, const char *path, const char *part)
{
	FILE *file = fopen(part, "wb");
	enum blobfield_outcome outcome;

	if (file == NULL) {
		cJSON_Delete(json);
		return client_fail(b, BLOBFIELD_FILE, "%s: %s", part,
		    strerror(errno));
	}
	outcome = post(b, id, "/mesh", json, NULL, file);
	/* Both: the file is closed whatever came. */
	if (fclose(file) != 0 && outcome == BLOBFIELD_OK)
		outcome = client_fail(b, BLOBFIELD_FILE, "%s: %s", part,
		    strerror(errno));
	if (outcome == BLOBFIELD_OK && rename(part, path) != 0)
		outcome = client_fail(b, BLOBFIELD_FILE, "%s: %s", path,
		    strerror(errno));
	if (outcome != BLOBFIELD_OK)
		unlink(part);
	return outcome;
}

enum blobfield_outcome blobfield_mesh_file(struct blobfield *b, const char *id,
    const struct blobfield_mesh_options *options, const char *path)
{
	const char *format = options != NULL && options->format != NULL ?
	    options->format : format_of(path);
	enum blobfield_outcome outcome;
	char *part;

	b->transfer.status = 0;
	if (format == NULL)
		return client_fail(b, BLOBFIELD_ARGUMENT, "%s: the extension "
		    "is not .glb, .ply, .stl, .obj or .json", path);
	part = malloc(strlen(path) + 6);
	if (part == NULL)
		return client_fail(b, BLOBFIELD_MEMORY, "out of memory");
	strcat(strcpy(part, path), ".part");
	outcome = mesh_by_part(b, id, mesh_json(options, format), path, part);
	free(part);
	return outcome;
}

/* ---- pictures ---- */

static void add_camera(cJSON *json, const struct blobfield_render_options *o)
{
	cJSON *camera;

	if (o->eye == NULL && o->target == NULL && o->up == NULL &&
	    o->fov == 0.0 && o->view_height == 0.0)
		return;
	camera = cJSON_AddObjectToObject(json, "camera");
	add_vector(camera, "eye", o->eye);
	add_vector(camera, "target", o->target);
	add_vector(camera, "up", o->up);
	add_number(camera, "fov", o->fov);
	add_number(camera, "view_height", o->view_height);
	if (o->view_height != 0.0)
		add_text(camera, "projection", "orthographic");
}

static cJSON *render_json(const struct blobfield_render_options *o)
{
	cJSON *json = cJSON_CreateObject();

	if (o == NULL)
		return json;
	add_number(json, "width", o->width);
	add_number(json, "height", o->height);
	add_text(json, "shading", o->shading);
	add_number(json, "samples", o->samples);
	add_number(json, "iso", o->iso);
	add_vector(json, "background", o->background);
	add_camera(json, o);
	return json;
}

enum blobfield_outcome blobfield_render(struct blobfield *b, const char *id,
    const struct blobfield_render_options *options,
    struct blobfield_bytes *out)
{
	return post_to_memory(b, id, "/render", render_json(options),
	    "image/png", out);
}

static cJSON *slice_json(const struct blobfield_slice_options *o)
{
	cJSON *json = cJSON_CreateObject();

	if (o == NULL)
		return json;
	add_number(json, "width", o->width);
	add_number(json, "height", o->height);
	add_vector(json, "center", o->center);
	add_vector(json, "normal", o->normal);
	add_vector(json, "up", o->up);
	add_number(json, "extent", o->extent);
	if (o->step != 0.0)
		add_number(cJSON_AddObjectToObject(json, "levels"), "step",
		    o->step);
	add_number(json, "iso", o->iso);
	return json;
}

enum blobfield_outcome blobfield_slice(struct blobfield *b, const char *id,
    const struct blobfield_slice_options *options, bool npy,
    struct blobfield_bytes *out)
{
	return post_to_memory(b, id, "/slice", slice_json(options),
	    npy ? "application/x-npy" : "image/png", out);
}
