/*
 * Meshes of a scene's surface. The file is written on the task's thread, too:
 * what waits for the client is its bytes alone.
 */
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include <cjson/cJSON.h>

#include "core/cells.h"
#include "core/mesh.h"
#include "core/range.h"
#include "core/sampler.h"
#include "core/tape.h"
#include "core/tree.h"
#include "proto/fault.h"
#include "proto/mesh_file.h"
#include "proto/mesh_request.h"
#include "server/clock.h"
#include "server/evaluation.h"
#include "server/exchange.h"
#include "server/handlers.h"
#include "server/scene_store.h"
#include "server/server.h"
#include "server/task.h"
#include "server/task_request.h"

/* Room about the surface's own box, a part of its longest side: nothing there
 * is to be cut. */
#define MARGIN 1e-3

/* Into so many cells at least each side of the surface's own box is cut: what is
 * in it, corners in its midst see, however flat it is. */
#define COUNTS_LEAST 4

/* Of all the work, how far it is when the mesh is there. */
#define MESH_DONE 0.95

/* Cells up to which a mesh is small. */
#define SMALL_RESOLUTION 32

#define STAGES_MAX 8

/* What was done, for how long. */
struct stage {
	char name[16];
	double seconds;
};

struct mesh_work {
	struct mesh_request request;
	struct mesh_figures figures;
	char *data;
	size_t length;
	struct stage stages[STAGES_MAX];
	size_t stage_count;
};

/* ---- work: on a thread of the pool ---- */

/* The task's sampler, which notes the stages that it is told of. */
struct watch {
	struct sampler sampler; /* first */
	struct sampler *inner;
	struct mesh_work *work;
	double since;           /* the last stage was begun or looked at */
};

/* The time since then was stage's. */
static void note(struct watch *w, const char *stage)
{
	struct mesh_work *work = w->work;
	const double now = clock_seconds();
	size_t i;

	for (i = 0; i < work->stage_count; i++)
		if (strcmp(work->stages[i].name, stage) == 0)
			break;
	if (i == STAGES_MAX)
		return;
	if (i == work->stage_count) {
		snprintf(work->stages[i].name, sizeof work->stages[i].name,
		    "%s", stage);
		work->stage_count++;
	}
	work->stages[i].seconds += now - w->since;
	w->since = now;
}

static enum err watch_sample(struct sampler *s, const float *points,
    size_t count, unsigned outputs, float *rows)
{
	struct watch *w = (struct watch *)s;

	return w->inner->sample(w->inner, points, count, outputs, rows);
}

static bool watch_go_on(struct sampler *s, const char *stage, double done)
{
	struct watch *w = (struct watch *)s;

	note(w, stage);
	return sampler_goes_on(w->inner, stage, MESH_DONE * done);
}

/* About the surface, with a margin. *is_empty: there is none. */
static enum err surface_box(struct task *task, struct mesh_options *o,
    bool *is_empty)
{
	struct tape_box box;
	enum err err = task_extent(task, o->iso, &box);
	double longest = 0.0;

	if (err != ERR_OK)
		return err;
	*is_empty = false;
	for (int i = 0; i < 3; i++) {
		*is_empty = *is_empty || !(box.min[i] <= box.max[i]);
		longest = fmax(longest, (double)box.max[i] - box.min[i]);
	}
	if (*is_empty)
		return ERR_OK;
	if (!(longest <= 2.0 * TREE_COORDINATE_MAX)) {
		task_fault(task, "/bounds", "the surface has no end: say which "
		    "part of it, {\"min\": [x, y, z], \"max\": [x, y, z]}");
		return ERR_INVALID;
	}
	longest *= MARGIN;
	o->min = vec3(box.min[0] - longest, box.min[1] - longest,
	    box.min[2] - longest);
	o->max = vec3(box.max[0] + longest, box.max[1] + longest,
	    box.max[2] + longest);
	return ERR_OK;
}

/* What mesh_build found too short for float32. */
static void tell_too_short(struct task *task, const struct mesh_request *r,
    const struct mesh_options *o)
{
	const double min[3] = {o->min.x, o->min.y, o->min.z};
	const double max[3] = {o->max.x, o->max.y, o->max.z};
	const char *place = r->resolution > 0 ? "/resolution" : "/edge_length";

	for (int i = 0; i < 3; i++) {
		const double side = max[i] - min[i];
		const double reach = fmax(fabs(min[i]), fabs(max[i]));
		const double least = CELLS_LEAST_EDGE * reach;
		const double n = fmax(1.0, ceil(side / o->edge - 1e-6));

		if (side / n >= least && i < 2)
			continue;
		task_fault(task, place, "gives cells of %.3g along %c; at coordinates of up "
		    "to %.3g they must be %.3g or longer, for float32 to tell "
		    "their corners apart", side / n, "xyz"[i], reach, least);
		return;
	}
}

static double largest(struct vec3 a)
{
	return fmax(fabs(a.x), fmax(fabs(a.y), fabs(a.z)));
}

static enum err choose_edge(struct task *task, const struct mesh_request *r,
    struct mesh_options *o)
{
	const double longest = largest(vec3_sub(o->max, o->min));
	const char *place = r->resolution > 0 ? "/resolution" : "/edge_length";

	o->edge = r->resolution > 0 ? longest / (double)r->resolution :
	    r->edge_length;
	if (longest > o->edge * MESH_CELLS_MAX * (1.0 + 1e-9)) {
		task_fault(task, place, "gives %.0f cells along the longest "
		    "side of %.9g; at most %d", ceil(longest / o->edge),
		    longest, MESH_CELLS_MAX);
		return ERR_LIMIT;
	}
	if (!r->has_bounds && o->edge > longest) {
		task_fault(task, place, "is longer than the surface's box, whose "
		    "longest side is %.9g: what is in it would be missed",
		    longest);
		return ERR_INVALID;
	}
	return ERR_OK;
}

static bool has_vertices(enum media_type format)
{
	return format == MEDIA_GLB || format == MEDIA_PLY ||
	    format == MEDIA_OBJ;
}

/* What is meshed. *is_empty: nothing. */
static enum err choose_options(struct task *task,
    const struct mesh_request *r, struct mesh_options *o, bool *is_empty)
{
	enum err err = ERR_OK;

	*is_empty = false;
	*o = (struct mesh_options){
		.min = r->min,
		.max = r->max,
		.counts_least = r->has_bounds ? 1 : COUNTS_LEAST,
		.iso = r->iso,
		.features = r->features,
		.normals = r->normals && has_vertices(r->format),
		.colors = r->colors && has_vertices(r->format),
	};
	if (!r->has_bounds)
		err = surface_box(task, o, is_empty);
	if (err != ERR_OK || *is_empty)
		return err;
	return choose_edge(task, r, o);
}

static enum err build(struct task *task, struct mesh_work *work,
    struct watch *watch, struct mesh **out)
{
	struct mesh_options options;
	const struct range_tape *ranges;
	bool is_empty;
	enum err err;

	if (!sampler_goes_on(watch->inner, "extent", 0.0))
		return ERR_CANCELLED;
	err = choose_options(task, &work->request, &options, &is_empty);
	note(watch, "extent");
	if (err != ERR_OK)
		return err;
	if (is_empty) {
		*out = calloc(1, sizeof **out);
		return *out != NULL ? ERR_OK : ERR_MEMORY;
	}
	err = task_ranges(task, &ranges);
	if (err != ERR_OK)
		return err;
	err = mesh_build(ranges, &options, &watch->sampler, out);
	if (err == ERR_LIMIT)
		task_fault(task, work->request.resolution > 0 ? "/resolution" :
		    "/edge_length", "gives more than %d vertices",
		    MESH_VERTICES_MAX);
	if (err == ERR_INVALID)
		tell_too_short(task, &work->request, &options);
	return err;
}

static enum err write_file(const struct mesh *m, const char *name,
    struct mesh_work *work)
{
	switch (work->request.format) {
	case MEDIA_PLY:
		return mesh_file_ply(m, name, &work->data, &work->length);
	case MEDIA_STL:
		return mesh_file_stl(m, name, &work->data, &work->length);
	case MEDIA_OBJ:
		return mesh_file_obj(m, name, &work->data, &work->length);
	case MEDIA_JSON:
		return ERR_OK;
	default:
		return mesh_file_glb(m, name, &work->data, &work->length);
	}
}

static enum err mesh_work(struct task *task, void *ctx)
{
	struct mesh_work *work = ctx;
	struct watch watch = {{watch_sample, watch_go_on},
	    task_sampler(task), work, clock_seconds()};
	struct mesh *m;
	enum err err = build(task, work, &watch, &m);

	if (err != ERR_OK)
		return err;
	work->figures = m->figures;
	if (!sampler_goes_on(watch.inner, "writing", MESH_DONE))
		err = ERR_CANCELLED;
	else
		err = write_file(m, task_scene(task)->name, work);
	note(&watch, "writing");
	mesh_free(m);
	if (err == ERR_OK && !sampler_goes_on(watch.inner, "writing", 1.0))
		return ERR_CANCELLED;
	return err;
}

/* ---- the answer ---- */

static cJSON *seconds_json(const struct mesh_work *work)
{
	cJSON *json = cJSON_CreateObject();

	for (size_t i = 0; i < work->stage_count; i++)
		cJSON_AddNumberToObject(json, work->stages[i].name,
		    1e-6 * round(1e6 * work->stages[i].seconds));
	return json;
}

static void reply_file(struct exchange *x, struct mesh_work *work)
{
	cJSON *json;

	if (work->request.format != MEDIA_JSON) {
		exchange_reply_data(x, 200, work->request.format, work->data,
		    work->length);
		work->data = NULL;
		return;
	}
	json = mesh_figures_json(&work->figures);
	cJSON_AddItemToObject(json, "seconds", seconds_json(work));
	exchange_reply_json(x, 200, json);
}

static void add_headers(struct exchange *x, const struct mesh_work *work)
{
	char text[128];

	snprintf(text, sizeof text, "vertices=%zu, triangles=%zu, genus=%ld",
	    work->figures.vertices, work->figures.triangles,
	    work->figures.genus);
	exchange_add_header(x, "Blobfield-Mesh", text);
}

static void mesh_answer(struct exchange *x, void *ctx)
{
	reply_file(x, ctx);
	add_headers(x, ctx);
}

static void mesh_work_free(void *ctx)
{
	struct mesh_work *work = ctx;

	free(work->data);
	free(work);
}

static size_t mesh_work_bytes(const void *ctx)
{
	const struct mesh_work *work = ctx;

	return work->length;
}

/* The coarse one, which an editor asks for at each key. */
static bool mesh_work_is_small(const void *ctx)
{
	const struct mesh_work *work = ctx;

	return work->request.edge_length == 0.0 &&
	    work->request.resolution <= SMALL_RESOLUTION;
}

/* ---- the request ---- */

/* Which file, unless the body says so: ?format, else Accept; or answers:
 * false. */
static bool choose_format(struct exchange *x, struct mesh_request *request)
{
	const char *query = exchange_query(x, "format");
	struct faults faults = {0};

	if (request->has_format)
		return true;
	if (query != NULL) {
		if (mesh_request_format(query, &request->format))
			return true;
		faults_add(&faults, "?format",
		    "must be glb, ply, stl, obj or json");
		evaluation_reply_faults(x, ERR_INVALID, &faults);
		return false;
	}
	request->format = task_request_file(x, MESH_FILES, MEDIA_GLB);
	return true;
}

static bool read_request(struct exchange *x, struct mesh_request *out)
{
	struct faults faults = {0};
	enum err err = mesh_request_parse(x->body != NULL ? x->body : "",
	    x->body_length, out, &faults);

	if (err != ERR_OK) {
		evaluation_reply_faults(x, err, &faults);
		return false;
	}
	return choose_format(x, out);
}

/* Takes the reference to scene over. */
static void begin(struct exchange *x, struct scene *scene)
{
	static const struct task_kind kind = {mesh_work, mesh_answer,
	    mesh_work_free, mesh_work_bytes, mesh_work_is_small};
	struct mesh_work *work = calloc(1, sizeof *work);

	if (work == NULL) {
		exchange_reply_problem(x, PROBLEM_MEMORY, NULL,
		    "There was no memory for the request.");
	} else if (read_request(x, &work->request)) {
		exchange_release_body(x);
		task_begin(x, scene, &kind, work);
		return;
	}
	free(work);
	scene_release(scene);
}

void handle_mesh(struct exchange *x)
{
	enum media_type type;
	struct scene *scene;

	if (!exchange_check_content_type(x, 1u << MEDIA_JSON, &type))
		return;
	scene = task_request_scene(x);
	if (scene != NULL)
		begin(x, scene);
}
