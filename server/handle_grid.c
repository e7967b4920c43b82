#include "proto/fault.h"
#include "proto/grid_request.h"
#include "server/config.h"
#include "server/evaluation.h"
#include "server/evaluation_body.h"
#include "server/exchange.h"
#include "server/handlers.h"
#include "server/program.h"
#include "server/scene_refresh.h"
#include "server/scene_reply.h"
#include "server/scene_store.h"
#include "server/server.h"

static void evaluate_grid(struct exchange *x, struct scene *scene,
    const struct evaluation_terms *terms)
{
	struct grid_request grid;
	struct points points = {0};
	struct faults faults = {0};
	enum err err = grid_request_parse(x->body != NULL ? x->body : "",
	    x->body_length, terms->outputs, x->server->config->max_points,
	    &grid, &faults);

	if (err == ERR_OK)
		err = grid_request_points(&grid, &points);
	if (err == ERR_OK)
		evaluation_begin(x, &(struct evaluation_request){
			.program = program_hold(scene->program),
			.points = &points,
			.outputs = grid.outputs,
			.terms = terms,
			.etag = scene->etag,
			.counts = grid.counts,
		});
	else
		evaluation_reply_faults(x, err, &faults);
	points_fini(&points);
}

void handle_grid(struct exchange *x)
{
	struct evaluation_terms terms;
	struct precondition precondition;
	enum media_type type;
	struct scene *scene;

	if (!evaluation_body_head(x, 1u << MEDIA_JSON, &type, &terms) ||
	    !scene_reply_preconditions(x, &precondition))
		return;
	scene = scene_refresh_get(x, &precondition);
	if (scene == NULL)
		return;
	evaluate_grid(x, scene, &terms);
	scene_release(scene);
}
