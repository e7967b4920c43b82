/*
 * blobfield mesh, render, slice: a file of a scene's surface, or of a plane.
 */
#include <stdlib.h>
#include <string.h>

#include "clients/c/command.h"

/* NULL unless the user has given it. */
static const double *given(const struct options_vector *v)
{
	return v->is_there ? v->v : NULL;
}

/* Writes what a call has made, or says why it has not. */
static int finish(struct session *s, enum blobfield_outcome outcome,
    const char *path, struct blobfield_bytes *bytes)
{
	int status;

	progress_end(s);
	if (outcome != BLOBFIELD_OK)
		return command_fail(s, false);
	status = command_write(s, path, bytes->data, bytes->size) ?
	    COMMAND_DONE : COMMAND_FILE;
	blobfield_bytes_fini(bytes);
	return status;
}

/* ---- mesh ---- */

static int make_mesh(struct session *s, struct blobfield_mesh_options *options,
    const char *path)
{
	struct blobfield_bytes bytes = {0};
	enum blobfield_outcome outcome;
	const char *summary;

	progress_begin(s);
	if (path == NULL || strcmp(path, "-") == 0) {
		if (options->format == NULL)
			options->format = "json";
		outcome = blobfield_mesh(s->client, s->id, options, &bytes);
		return finish(s, outcome, path, &bytes);
	}
	outcome = blobfield_mesh_file(s->client, s->id, options, path);
	progress_end(s);
	if (outcome != BLOBFIELD_OK)
		return command_fail(s, false);
	summary = blobfield_header(s->client, "Blobfield-Mesh");
	if (!s->quiet && *summary != '\0')
		fprintf(stderr, "%s: %s\n", path, summary);
	return COMMAND_DONE;
}

int command_mesh(struct session *s, const struct command *self, int argc,
    char **argv)
{
	struct blobfield_mesh_options options = {0};
	struct options_vector least = {0}, most = {0};
	struct blobfield_box box;
	const char *path = NULL;
	const struct options_rule rules[] = {
		{"output", 'o', OPTIONS_TEXT, &path, "FILE",
		    ".glb, .ply, .stl, .obj, .json"},
		{"format", 'f', OPTIONS_TEXT, &options.format, "FORMAT",
		    "whatever the file's extension"},
		{"resolution", 'r', OPTIONS_WHOLE, &options.resolution, "N",
		    "cells along the longest side, 2 to 1024 (64)"},
		{"edge-length", 'e', OPTIONS_NUMBER, &options.edge_length,
		    "LENGTH", "of cells, instead of --resolution"},
		{"iso", 0, OPTIONS_NUMBER, &options.iso, "F",
		    "the surface's value (0.5)"},
		{"min", 0, OPTIONS_VECTOR, &least, "X,Y,Z",
		    "a box's least corner; the surface is cut"},
		{"max", 0, OPTIONS_VECTOR, &most, "X,Y,Z",
		    "at its faces, and capped"},
		{"no-features", 0, OPTIONS_FLAG, &options.no_features, NULL,
		    "sharp edges need not be kept"},
		{"no-normals", 0, OPTIONS_FLAG, &options.no_normals, NULL,
		    "leave normals out"},
		{"no-colors", 0, OPTIONS_FLAG, &options.no_colors, NULL,
		    "leave colours out"},
		{0}
	};
	int count, status;

	if (!command_start(s, self, rules, argc, argv, 1, 1, &count, &status))
		return status;
	if (least.is_there != most.is_there) {
		command_say(s, "--min and --max go together\n");
		return COMMAND_USAGE;
	}
	memcpy(box.min, least.v, sizeof box.min);
	memcpy(box.max, most.v, sizeof box.max);
	options.box = least.is_there ? &box : NULL;
	status = command_open_scene(s, argv[0]);
	if (status == COMMAND_DONE)
		status = make_mesh(s, &options, path);
	command_close_scene(s);
	return status;
}

/* ---- render ---- */

static int make_picture(struct session *s,
    const struct blobfield_render_options *options, const char *path)
{
	struct blobfield_bytes bytes = {0};

	progress_begin(s);
	return finish(s, blobfield_render(s->client, s->id, options, &bytes),
	    path, &bytes);
}

int command_render(struct session *s, const struct command *self, int argc,
    char **argv)
{
	struct blobfield_render_options options = {0};
	struct options_vector eye = {0}, target = {0}, up = {0}, ground = {0};
	const char *path = NULL;
	const struct options_rule rules[] = {
		{"output", 'o', OPTIONS_TEXT, &path, "FILE", ".png (stdout)"},
		{"width", 'W', OPTIONS_WHOLE, &options.width, "PIXELS",
		    "1 to 4096 (640)"},
		{"height", 'H', OPTIONS_WHOLE, &options.height, "PIXELS",
		    "1 to 4096 (480)"},
		{"shading", 's', OPTIONS_TEXT, &options.shading, "HOW",
		    "lit (default), normal, zebra, curvature, field"},
		{"samples", 0, OPTIONS_WHOLE, &options.samples, "N",
		    "rays a pixel: 1, 4, 9, 16 (4)"},
		{"eye", 0, OPTIONS_VECTOR, &eye, "X,Y,Z",
		    "where the camera is; without: all is in view"},
		{"target", 0, OPTIONS_VECTOR, &target, "X,Y,Z",
		    "where it looks: goes with --eye"},
		{"up", 0, OPTIONS_VECTOR, &up, "X,Y,Z", "(0,0,1)"},
		{"fov", 0, OPTIONS_NUMBER, &options.fov, "RADIANS",
		    "from top to bottom (0.6)"},
		{"view-height", 0, OPTIONS_NUMBER, &options.view_height,
		    "LENGTH", "orthographic, so much from top to bottom"},
		{"background", 0, OPTIONS_VECTOR, &ground, "R,G,B",
		    "linear, 0 to 1 (transparent)"},
		{"iso", 0, OPTIONS_NUMBER, &options.iso, "F",
		    "the surface's value (0.5)"},
		{0}
	};
	int count, status;

	if (!command_start(s, self, rules, argc, argv, 1, 1, &count, &status))
		return status;
	options.eye = given(&eye);
	options.target = given(&target);
	options.up = given(&up);
	options.background = given(&ground);
	status = command_open_scene(s, argv[0]);
	if (status == COMMAND_DONE)
		status = make_picture(s, &options, path);
	command_close_scene(s);
	return status;
}

/* ---- slice ---- */

static int make_slice(struct session *s,
    const struct blobfield_slice_options *options, const char *path)
{
	const bool npy = path != NULL && command_has_extension(path, ".npy");
	struct blobfield_bytes bytes = {0};

	progress_begin(s);
	return finish(s, blobfield_slice(s->client, s->id, options, npy,
	    &bytes), path, &bytes);
}

int command_slice(struct session *s, const struct command *self, int argc,
    char **argv)
{
	struct blobfield_slice_options options = {0};
	struct options_vector center = {0}, normal = {0}, up = {0};
	const char *path = NULL;
	const struct options_rule rules[] = {
		{"output", 'o', OPTIONS_TEXT, &path, "FILE",
		    ".png, or .npy: values (stdout gets PNG)"},
		{"width", 'W', OPTIONS_WHOLE, &options.width, "PIXELS",
		    "(512)"},
		{"height", 'H', OPTIONS_WHOLE, &options.height, "PIXELS",
		    "(512)"},
		{"center", 0, OPTIONS_VECTOR, &center, "X,Y,Z",
		    "of the picture (the middle of the surface)"},
		{"normal", 0, OPTIONS_VECTOR, &normal, "X,Y,Z",
		    "towards who looks at it (0,-1,0)"},
		{"up", 0, OPTIONS_VECTOR, &up, "X,Y,Z", "(0,0,1)"},
		{"extent", 0, OPTIONS_NUMBER, &options.extent, "LENGTH",
		    "from left to right (all of the surface)"},
		{"step", 0, OPTIONS_NUMBER, &options.step, "F",
		    "between iso-lines"},
		{"iso", 0, OPTIONS_NUMBER, &options.iso, "F",
		    "the thick line (0.5)"},
		{0}
	};
	int count, status;

	if (!command_start(s, self, rules, argc, argv, 1, 1, &count, &status))
		return status;
	options.center = given(&center);
	options.normal = given(&normal);
	options.up = given(&up);
	status = command_open_scene(s, argv[0]);
	if (status == COMMAND_DONE)
		status = make_slice(s, &options, path);
	command_close_scene(s);
	return status;
}
