#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "core/output.h"
#include "core/raycast.h"
#include "core/tape.h"
#include "proto/fault.h"
#include "proto/geometry_answer.h"
#include "proto/geometry_request.h"
#include "server/config.h"
#include "server/evaluation.h"
#include "server/exchange.h"
#include "server/handlers.h"
#include "server/scene_store.h"
#include "server/server.h"
#include "server/task.h"
#include "server/task_pick.h"
#include "server/task_request.h"

#define TYPES (1u << MEDIA_JSON | 1u << MEDIA_OCTETS | 1u << MEDIA_NPY)

/* Rays up to which a request is small. */
#define SMALL_RAYS 4096

/* The default tolerance, times the surface's diagonal. */
#define TOLERANCE 1e-5

#define OUTPUTS (OUTPUT_VALUE | OUTPUT_GRADIENT | OUTPUT_COLOR)
#define OUTPUT_FLOATS 7

/* The part of a task that its rays take, and up to which its colours do. */
#define RAYS_DONE 0.8
#define SHADING_DONE 0.85

struct raycast_work {
	struct raycast_request request;
	enum media_type accept;
	float *rows;   /* RAY_COLUMNS each */
	const char **nodes; /* into picks */
	struct task_picks *picks;
	char *text;    /* JSON instead, of rows that are gone */
	size_t length;
};

static void free_work(void *ctx)
{
	struct raycast_work *w = ctx;

	raycast_request_fini(&w->request);
	task_picks_free(w->picks);
	free(w->nodes);
	free(w->rows);
	free(w->text);
	free(w);
}

static size_t bytes(const void *ctx)
{
	const struct raycast_work *w = ctx;
	const size_t count = w->request.rays.count;

	return w->text != NULL ? w->length : w->rows != NULL ?
	    count * RAY_COLUMNS * sizeof *w->rows :
	    count * RAY_FLOATS * sizeof(float);
}

static bool is_small(const void *ctx)
{
	const struct raycast_work *w = ctx;

	return w->request.rays.count <= SMALL_RAYS;
}

/* What the answer no longer needs. */
static void drop_sources(struct raycast_work *w)
{
	task_picks_free(w->picks);
	w->picks = NULL;
	free(w->nodes);
	w->nodes = NULL;
	free(w->request.rays.numbers);
	w->request.rays.numbers = NULL;
	if (w->text != NULL) {
		free(w->rows);
		w->rows = NULL;
	}
}

/* ---- the work ---- */

static double diagonal(const struct tape_box *box)
{
	double sum = 0.0;

	for (int i = 0; i < 3; i++) {
		double edge = (double)box->max[i] - (double)box->min[i];

		/* What has no end is as long as what has. */
		sum += isfinite(edge) ? edge * edge : 0.0;
	}
	return sum > 0.0 ? sqrt(sum) : 1.0;
}

/* Fills w's rows with hits; how many there are. */
static size_t put_hits(struct raycast_work *w, const struct ray_hit *hits)
{
	const size_t count = w->request.rays.count;
	size_t hit_count = 0;

	memset(w->rows, 0, count * RAY_COLUMNS * sizeof *w->rows);
	for (size_t i = 0; i < count; i++) {
		float *row = w->rows + RAY_COLUMNS * i;

		row[RAY_LEAF] = -1.0f;
		if (!hits[i].hit)
			continue;
		row[RAY_HIT] = 1.0f;
		row[RAY_DISTANCE] = hits[i].distance;
		memcpy(row + RAY_POSITION, hits[i].position,
		    sizeof hits[i].position);
		hit_count++;
	}
	return hit_count;
}

static enum err cast(struct task *task, struct raycast_work *w,
    size_t *hit_count)
{
	const struct rays *rays = &w->request.rays;
	const struct geometry_terms *terms = &w->request.terms;
	struct ray_hit *hits = calloc(rays->count + 1, sizeof *hits);
	const struct range_tape *ranges;
	struct tape_box extent;
	enum err err = hits != NULL ? task_ranges(task, &ranges) : ERR_MEMORY;

	if (err == ERR_OK)
		err = task_extent(task, terms->iso, &extent);
	if (err == ERR_OK)
		err = raycast(ranges, &(struct raycast_options){
			.iso = terms->iso,
			.tolerance = terms->tolerance > 0.0 ?
			    terms->tolerance : TOLERANCE * diagonal(&extent),
			.max_distance = terms->max_distance,
			.extent = &extent,
		}, rays->numbers, rays->count, task_sampler(task), hits);
	if (err == ERR_OK)
		*hit_count = put_hits(w, hits);
	free(hits);
	return err;
}

/* Positions of all hits, 3 floats each, to out. */
static void gather(const struct raycast_work *w, float *out)
{
	for (size_t i = 0; i < w->request.rays.count; i++) {
		const float *row = w->rows + RAY_COLUMNS * i;

		if (row[RAY_HIT] == 0.0f)
			continue;
		memcpy(out, row + RAY_POSITION, 3 * sizeof *out);
		out += 3;
	}
}

/* The field at the hits, from found into rows. */
static void scatter(struct raycast_work *w, const float *found)
{
	for (size_t i = 0; i < w->request.rays.count; i++) {
		float *row = w->rows + RAY_COLUMNS * i;

		if (row[RAY_HIT] == 0.0f)
			continue;
		memcpy(row + RAY_VALUE, found, OUTPUT_FLOATS * sizeof *found);
		found += OUTPUT_FLOATS;
	}
}

static enum err look(struct task *task, struct raycast_work *w,
    size_t hit_count)
{
	struct sampler *sampler = task_sampler(task);
	float *places = malloc((hit_count + 1) * 3 * sizeof *places);
	float *found = malloc((hit_count + 1) * OUTPUT_FLOATS * sizeof *found);
	enum err err = ERR_MEMORY;

	if (places != NULL && found != NULL) {
		gather(w, places);
		err = sampler->sample(sampler, places, hit_count, OUTPUTS,
		    found);
	}
	if (err == ERR_OK)
		scatter(w, found);
	free(found);
	free(places);
	return err;
}

static enum err pick(struct task *task, struct raycast_work *w)
{
	struct sampler *sampler = task_sampler(task);
	const size_t count = w->request.rays.count;
	enum err err = task_picks_create(task, &w->picks);

	for (size_t i = 0; i < count && err == ERR_OK; i++) {
		float *row = w->rows + RAY_COLUMNS * i;

		if (row[RAY_HIT] == 0.0f)
			continue;
		if (!sampler_goes_on(sampler, "points", (double)i /
		    (double)count))
			return ERR_CANCELLED;
		err = task_pick(w->picks, row + RAY_POSITION, &row[RAY_LEAF],
		    &w->nodes[i]);
	}
	return err;
}

static enum err run(struct task *task, struct raycast_work *w)
{
	size_t hit_count = 0;
	enum err err;

	task_set_part(task, 0.0, RAYS_DONE);
	err = cast(task, w, &hit_count);
	task_set_part(task, RAYS_DONE, SHADING_DONE);
	if (err == ERR_OK && hit_count > 0)
		err = look(task, w, hit_count);
	task_set_part(task, SHADING_DONE, 1.0);
	if (err == ERR_OK && hit_count > 0)
		err = pick(task, w);
	return err;
}

static enum err work(struct task *task, void *ctx)
{
	struct raycast_work *w = ctx;
	const struct rays *rays = &w->request.rays;
	enum err err = ERR_MEMORY;

	w->rows = malloc((rays->count + 1) * RAY_COLUMNS * sizeof *w->rows);
	w->nodes = calloc(rays->count + 1, sizeof *w->nodes);
	if (w->rows != NULL && w->nodes != NULL)
		err = run(task, w);
	if (err == ERR_OK && w->accept == MEDIA_JSON)
		err = raycast_answer_json(w->rows, rays->count, w->nodes,
		    rays->flat, &w->text, &w->length);
	drop_sources(w);
	return err;
}

static void answer(struct exchange *x, void *ctx)
{
	struct raycast_work *w = ctx;

	if (w->text == NULL) {
		task_reply_rows(x, w->accept, &w->rows,
		    w->request.rays.count, RAY_COLUMNS);
		return;
	}
	exchange_reply_data(x, 200, MEDIA_JSON, w->text, w->length);
	w->text = NULL;
}

/* ---- the request ---- */

/* Takes scene over. */
static void begin(struct exchange *x, struct scene *scene,
    enum media_type type, enum media_type accept)
{
	static const struct task_kind kind = {work, answer, free_work, bytes,
	    is_small};
	struct faults faults = {0};
	struct raycast_work *w = calloc(1, sizeof *w);
	enum err err = w != NULL ? ERR_OK : ERR_MEMORY;

	if (err == ERR_OK)
		err = task_request_terms(x, &w->request.terms, &faults);
	if (err == ERR_OK)
		err = raycast_request_parse(x->body != NULL ? x->body : "",
		    x->body_length, type, x->server->config->max_points,
		    &w->request, &faults);
	if (err == ERR_OK) {
		w->accept = accept;
		task_begin(x, scene, &kind, w);
		return;
	}
	free(w);
	scene_release(scene);
	evaluation_reply_faults(x, err, &faults);
}

void handle_raycast(struct exchange *x)
{
	enum media_type type, accept;
	struct scene *scene;

	if (!exchange_check_content_type(x, TYPES, &type) ||
	    !task_request_accept(x, TYPES, MEDIA_JSON, &accept))
		return;
	scene = task_request_scene(x);
	if (scene != NULL)
		begin(x, scene, type, accept);
}
