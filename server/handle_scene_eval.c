#include "proto/document.h"
#include "proto/fault.h"
#include "proto/request.h"
#include "server/config.h"
#include "server/evaluation.h"
#include "server/exchange.h"
#include "server/handlers.h"
#include "server/limits.h"
#include "server/program.h"
#include "server/scene_reply.h"
#include "server/scene_store.h"
#include "server/server.h"

#define BODY_TYPES (1u << MEDIA_JSON | 1u << MEDIA_OCTETS | 1u << MEDIA_NPY)

/* The points and outputs that the body asks for. */
static enum err parse(struct exchange *x, enum media_type type,
    struct eval_request *out, struct faults *faults)
{
	const struct config *config = x->server->config;
	const struct document_limits limits = limits_new(x->server);
	const char *body = x->body != NULL ? x->body : "";

	if (type == MEDIA_OCTETS)
		return points_from_octets(body, x->body_length,
		    config->max_points, &out->points, faults);
	if (type == MEDIA_NPY)
		return points_from_npy(body, x->body_length,
		    config->max_points, &out->points, faults);
	return eval_request_parse(body, x->body_length, false, out->outputs,
	    &limits, config->max_points, out, faults);
}

static void evaluate_scene(struct exchange *x, struct scene *scene,
    enum media_type type, enum media_type accept, unsigned outputs)
{
	struct eval_request body = {.outputs = outputs};
	struct faults faults = {0};
	enum err err = parse(x, type, &body, &faults);

	if (err == ERR_OK)
		evaluation_begin(x, &(struct evaluation_request){
			.program = program_hold(scene->program),
			.points = &body.points,
			.outputs = body.outputs,
			.accept = accept,
			.etag = scene->etag,
		});
	else
		evaluation_reply_faults(x, err, &faults);
	eval_request_fini(&body);
}

void handle_scene_eval(struct exchange *x)
{
	struct precondition precondition;
	enum media_type type, accept;
	struct scene *scene;
	unsigned outputs;

	if (!exchange_check_content_type(x, BODY_TYPES, &type) ||
	    !evaluation_check_accept(x, &accept) ||
	    !evaluation_check_outputs(x, &outputs) ||
	    !scene_reply_preconditions(x, &precondition))
		return;
	scene = scene_store_get(x->server->scenes, x->id);
	if (scene == NULL) {
		scene_reply_absent(x);
		return;
	}
	if (precondition_match(&precondition, scene->etag))
		evaluate_scene(x, scene, type, accept, outputs);
	else
		scene_reply_changed(x);
	scene_release(scene);
}
