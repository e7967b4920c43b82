#include <math.h>
#include <stdlib.h>

#include "core/output.h"
#include "core/picture.h"
#include "core/tape.h"
#include "proto/fault.h"
#include "proto/geometry_answer.h"
#include "proto/geometry_request.h"
#include "proto/png_file.h"
#include "server/config.h"
#include "server/evaluation.h"
#include "server/exchange.h"
#include "server/handlers.h"
#include "server/scene_store.h"
#include "server/server.h"
#include "server/task.h"
#include "server/task_request.h"

/* Of a slice that is not said how wide: what is shown about the surface. */
#define MARGIN 1.15

/* Points of a slice between looks at who waits for it. */
#define SLICE_POINTS ((size_t)1 << 18)

/* The part of a task that comes before its file is written. */
#define PAINTED 0.9

/* Points up to which a slice is small. */
#define SMALL_POINTS ((size_t)1 << 18)

struct picture_work {
	enum media_type accept;
	struct render_request render;
	struct tape_box extent; /* of render's surface */
	struct slice_request slice;
	unsigned outputs; /* of a slice as numbers */
	uint8_t *rgba;
	float *points, *rows;
	size_t row_bytes; /* of all rows, while they are there */
	char *file;
	size_t length;
};

static void free_work(void *ctx)
{
	struct picture_work *w = ctx;

	free(w->rgba);
	free(w->points);
	free(w->rows);
	free(w->file);
	free(w);
}

static size_t bytes(const void *ctx)
{
	const struct picture_work *w = ctx;

	return w->length + w->row_bytes;
}

static bool slice_is_small(const void *ctx)
{
	const struct picture_work *w = ctx;

	return w->slice.width * w->slice.height <= SMALL_POINTS;
}

/* Answers with the picture. */
static void answer_file(struct exchange *x, void *ctx)
{
	struct picture_work *w = ctx;

	exchange_reply_data(x, 200, w->accept, w->file, w->length);
	w->file = NULL;
}

static enum err write_file(struct task *task, struct picture_work *w,
    size_t width, size_t height)
{
	if (!sampler_goes_on(task_sampler(task), "writing", 0.0))
		return ERR_CANCELLED;
	return png_write(w->rgba, width, height, &w->file, &w->length);
}

static bool is_empty(const struct tape_box *box)
{
	return box->min[0] > box->max[0] || box->min[1] > box->max[1] ||
	    box->min[2] > box->max[2];
}

static bool is_finite(const struct tape_box *box)
{
	for (int i = 0; i < 3; i++) {
		if (!isfinite(box->min[i]) || !isfinite(box->max[i]))
			return false;
	}
	return true;
}

/* ---- render ---- */

static enum err frame(struct task *task, struct picture_render *picture)
{
	if (!is_empty(picture->extent) && !is_finite(picture->extent)) {
		task_fault(task, "/camera", "the surface has no end: say where "
		    "the camera is");
		return ERR_INVALID;
	}
	picture->camera = picture_frame(picture->extent, picture->width,
	    picture->height);
	return ERR_OK;
}

static enum err work_render(struct task *task, void *ctx)
{
	struct picture_work *w = ctx;
	struct picture_render *picture = &w->render.picture;
	const struct range_tape *ranges;
	enum err err = task_ranges(task, &ranges);

	if (err == ERR_OK)
		err = task_extent(task, picture->iso, &w->extent);
	picture->extent = &w->extent;
	if (err == ERR_OK && !w->render.has_camera)
		err = frame(task, picture);
	if (err != ERR_OK)
		return err;
	w->rgba = malloc(4 * picture->width * picture->height);
	if (w->rgba == NULL)
		return ERR_MEMORY;
	task_set_part(task, 0.0, PAINTED);
	err = picture_render(ranges, picture, task_sampler(task), w->rgba);
	task_set_part(task, PAINTED, 1.0);
	return err != ERR_OK ? err : write_file(task, w, picture->width,
	    picture->height);
}

/* ---- slice ---- */

/* Fills in what the body does not say. */
static enum err place_slice(struct task *task, struct slice_request *request,
    struct vec3 right, struct vec3 up)
{
	const struct vec3 nowhere = {0.0, 0.0, 0.0};
	struct vec3 least = {-1.0, -1.0, -1.0}, most = {1.0, 1.0, 1.0}, half;
	struct tape_box box;
	double across, along;
	enum err err;

	if (request->has_center && request->has_extent)
		return ERR_OK;
	err = task_extent(task, request->iso, &box);
	if (err != ERR_OK)
		return err;
	if (!is_empty(&box) && !is_finite(&box)) {
		task_fault(task, request->has_center ? "/extent" : "/center",
		    "the surface has no end: say what to show of it");
		return ERR_INVALID;
	}
	if (!is_empty(&box)) {
		least = vec3(box.min[0], box.min[1], box.min[2]);
		most = vec3(box.max[0], box.max[1], box.max[2]);
	}
	half = vec3_scale(0.5, vec3_sub(most, least));
	if (!request->has_center)
		request->center = vec3_add(is_empty(&box) ? nowhere : least,
		    is_empty(&box) ? nowhere : half);
	across = fabs(right.x) * half.x + fabs(right.y) * half.y +
	    fabs(right.z) * half.z;
	along = fabs(up.x) * half.x + fabs(up.y) * half.y +
	    fabs(up.z) * half.z;
	if (!request->has_extent)
		request->extent = fmax(2.0 * MARGIN * fmax(across, along *
		    (double)request->width / (double)request->height), 1e-9);
	return ERR_OK;
}

/* The field at all places, in pieces. */
static enum err sample_slice(struct task *task, struct picture_work *w,
    unsigned outputs)
{
	struct sampler *sampler = task_sampler(task);
	const size_t columns = (size_t)output_row_floats(outputs);
	const size_t count = w->slice.width * w->slice.height;
	enum err err = ERR_OK;

	for (size_t first = 0; first < count && err == ERR_OK;
	    first += SLICE_POINTS) {
		const size_t left = count - first;

		if (!sampler_goes_on(sampler, "points", (double)first /
		    (double)count))
			return ERR_CANCELLED;
		err = sampler->sample(sampler, w->points + 3 * first,
		    left < SLICE_POINTS ? left : SLICE_POINTS, outputs,
		    w->rows + columns * first);
	}
	return err;
}

static enum err paint(struct task *task, struct picture_work *w,
    const struct picture_slice *slice)
{
	w->rgba = malloc(4 * slice->width * slice->height);
	if (w->rgba == NULL)
		return ERR_MEMORY;
	picture_slice_paint(slice, w->rows, w->rgba);
	free(w->rows);
	w->rows = NULL;
	w->row_bytes = 0;
	return write_file(task, w, slice->width, slice->height);
}

static struct picture_slice slice_of(const struct slice_request *request,
    struct vec3 right, struct vec3 up)
{
	struct picture_slice slice = {
		.width = request->width,
		.height = request->height,
		.center = request->center,
		.right = right,
		.up = up,
		.pixel = request->extent / (double)request->width,
		.iso = request->iso,
		.level_count = request->level_count,
	};

	for (size_t i = 0; i < request->level_count; i++)
		slice.levels[i] = request->levels[i];
	return slice;
}

static enum err work_slice(struct task *task, void *ctx)
{
	struct picture_work *w = ctx;
	const size_t count = w->slice.width * w->slice.height;
	const unsigned outputs = w->accept == MEDIA_PNG ?
	    OUTPUT_VALUE | OUTPUT_GRADIENT : w->outputs;
	const struct vec3 right = vec3_unit(vec3_cross(w->slice.up,
	    w->slice.normal));
	const struct vec3 up = vec3_cross(w->slice.normal, right);
	struct picture_slice slice;
	enum err err = place_slice(task, &w->slice, right, up);

	if (err != ERR_OK)
		return err;
	slice = slice_of(&w->slice, right, up);
	w->points = malloc(3 * count * sizeof *w->points);
	w->rows = malloc((size_t)output_row_floats(outputs) * count *
	    sizeof *w->rows);
	if (w->points == NULL || w->rows == NULL)
		return ERR_MEMORY;
	picture_slice_points(&slice, w->points);
	task_set_part(task, 0.0, PAINTED);
	err = sample_slice(task, w, outputs);
	free(w->points);
	w->points = NULL;
	w->row_bytes = (size_t)output_row_floats(outputs) * count *
	    sizeof *w->rows;
	task_set_part(task, PAINTED, 1.0);
	return err == ERR_OK && w->accept == MEDIA_PNG ?
	    paint(task, w, &slice) : err;
}

static void answer_slice(struct exchange *x, void *ctx)
{
	struct picture_work *w = ctx;
	const int columns = output_row_floats(w->outputs);
	char header[SLICE_NPY_HEADER_MAX];
	size_t header_length;

	if (w->accept == MEDIA_PNG) {
		answer_file(x, w);
		return;
	}
	header_length = slice_npy_header(w->slice.height, w->slice.width,
	    columns, header);
	exchange_reply_two(x, MEDIA_NPY, header, header_length, w->rows,
	    w->slice.width * w->slice.height * (size_t)columns *
	    sizeof *w->rows);
	w->rows = NULL;
}

/* What a slice as numbers has: the body's word goes before the query's. */
static enum err read_outputs(struct exchange *x, struct picture_work *w,
    struct faults *faults)
{
	const char *list = exchange_query(x, "outputs");
	enum err err = ERR_OK;

	w->outputs = OUTPUT_VALUE;
	if (list != NULL)
		err = outputs_from_list(list, "?outputs", &w->outputs, faults);
	if (w->slice.output != 0)
		w->outputs = w->slice.output;
	if (err != ERR_OK || w->accept != MEDIA_PNG ||
	    w->outputs == OUTPUT_VALUE)
		return err;
	faults_add(faults, w->slice.output != 0 ? "/output" : "?outputs",
	    "a picture shows the value; with Accept: %s there are other "
	    "outputs", media_name(MEDIA_NPY));
	return ERR_INVALID;
}

/* ---- requests ---- */

static enum err parse_render(struct exchange *x, struct picture_work *w,
    struct faults *faults)
{
	return render_request_parse(x->body != NULL ? x->body : "",
	    x->body_length, PICTURE_RAYS_MAX, &w->render, faults);
}

static enum err parse_slice(struct exchange *x, struct picture_work *w,
    struct faults *faults)
{
	enum err err = slice_request_parse(x->body != NULL ? x->body : "",
	    x->body_length, x->server->config->max_points, &w->slice, faults);

	return err != ERR_OK ? err : read_outputs(x, w, faults);
}

static void handle(struct exchange *x, unsigned accepts,
    enum err (*parse)(struct exchange *x, struct picture_work *w,
    struct faults *faults), const struct task_kind *kind)
{
	struct faults faults = {0};
	enum media_type type;
	struct picture_work *w;
	struct scene *scene;
	enum err err;

	if (!exchange_check_content_type(x, 1u << MEDIA_JSON, &type))
		return;
	scene = task_request_scene(x);
	if (scene == NULL)
		return;
	w = calloc(1, sizeof *w);
	err = w != NULL ? ERR_OK : ERR_MEMORY;
	if (err == ERR_OK) {
		w->accept = task_request_file(x, accepts, MEDIA_PNG);
		err = parse(x, w, &faults);
	}
	if (err == ERR_OK) {
		task_begin(x, scene, kind, w);
		return;
	}
	free(w);
	scene_release(scene);
	evaluation_reply_faults(x, err, &faults);
}

void handle_render(struct exchange *x)
{
	static const struct task_kind kind = {work_render, answer_file,
	    free_work, bytes, NULL};

	handle(x, 1u << MEDIA_PNG, parse_render, &kind);
}

void handle_slice(struct exchange *x)
{
	static const struct task_kind kind = {work_slice, answer_slice,
	    free_work, bytes, slice_is_small};

	handle(x, 1u << MEDIA_PNG | 1u << MEDIA_NPY, parse_slice, &kind);
}
