#include <math.h>
#include <stdlib.h>

#include "core/project.h"
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
#include "server/task_request.h"

#define TYPES (1u << MEDIA_JSON | 1u << MEDIA_OCTETS | 1u << MEDIA_NPY)

/* Points up to which a request is small. */
#define SMALL_POINTS 4096

struct project_work {
	struct project_request request;
	enum media_type accept;
	float *rows;   /* PROJECTION_FLOATS each */
	char *text;    /* JSON instead */
	size_t length;
};

static void free_work(void *ctx)
{
	struct project_work *w = ctx;

	project_request_fini(&w->request);
	free(w->rows);
	free(w->text);
	free(w);
}

static size_t bytes(const void *ctx)
{
	const struct project_work *w = ctx;
	const size_t count = w->request.points.count;

	return w->text != NULL ? w->length : count * sizeof(float) *
	    (w->rows != NULL ? PROJECTION_FLOATS : 3);
}

static bool is_small(const void *ctx)
{
	const struct project_work *w = ctx;

	return w->request.points.count <= SMALL_POINTS;
}

static void put_row(const struct projection *p, float *row)
{
	row[0] = p->converged ? 1.0f : 0.0f;
	row[4] = p->distance;
	row[5] = p->value;
	for (int i = 0; i < 3; i++) {
		row[1 + i] = p->position[i];
		row[6 + i] = p->normal[i];
	}
}

static enum err run(struct task *task, struct project_work *w,
    struct projection *found)
{
	const struct points *points = &w->request.points;
	enum err err = project(w->request.terms.iso,
	    w->request.terms.max_distance, points->xyz, points->count,
	    task_sampler(task), found);

	for (size_t i = 0; err == ERR_OK && i < points->count; i++)
		put_row(&found[i], w->rows + PROJECTION_FLOATS * i);
	return err;
}

static enum err work(struct task *task, void *ctx)
{
	struct project_work *w = ctx;
	const size_t count = w->request.points.count;
	struct projection *found = malloc((count + 1) * sizeof *found);
	enum err err = ERR_MEMORY;

	w->rows = malloc((count + 1) * PROJECTION_FLOATS * sizeof *w->rows);
	if (found != NULL && w->rows != NULL)
		err = run(task, w, found);
	free(found);
	if (err == ERR_OK && w->accept == MEDIA_JSON)
		err = project_answer_json(w->rows, count,
		    w->request.points.flat, &w->text, &w->length);
	free(w->request.points.xyz);
	w->request.points.xyz = NULL;
	if (w->text != NULL) {
		free(w->rows);
		w->rows = NULL;
	}
	return err;
}

static void answer(struct exchange *x, void *ctx)
{
	struct project_work *w = ctx;

	if (w->text == NULL) {
		task_reply_rows(x, w->accept, &w->rows,
		    w->request.points.count, PROJECTION_FLOATS);
		return;
	}
	exchange_reply_data(x, 200, MEDIA_JSON, w->text, w->length);
	w->text = NULL;
}

/* Takes scene over. */
static void begin(struct exchange *x, struct scene *scene,
    enum media_type type, enum media_type accept)
{
	static const struct task_kind kind = {work, answer, free_work, bytes,
	    is_small};
	struct faults faults = {0};
	struct project_work *w = calloc(1, sizeof *w);
	enum err err = w != NULL ? ERR_OK : ERR_MEMORY;

	if (err == ERR_OK)
		err = task_request_terms(x, &w->request.terms, &faults);
	if (err == ERR_OK)
		err = project_request_parse(x->body != NULL ? x->body : "",
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

void handle_project(struct exchange *x)
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
