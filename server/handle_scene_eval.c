#include "proto/fault.h"
#include "proto/request.h"
#include "server/evaluation.h"
#include "server/evaluation_body.h"
#include "server/exchange.h"
#include "server/handlers.h"
#include "server/program.h"
#include "server/scene_refresh.h"
#include "server/scene_reply.h"
#include "server/scene_store.h"

static void evaluate_scene(struct exchange *x, struct scene *scene)
{
	struct eval_request body = {0};
	struct faults faults = {0};
	enum err err = evaluation_body_finish(x, &body, &faults);

	if (err == ERR_OK)
		evaluation_begin(x, &(struct evaluation_request){
			.program = program_hold(scene->program),
			.points = &body.points,
			.outputs = body.outputs,
			.terms = evaluation_body_terms(x),
			.etag = scene->etag,
		});
	else
		evaluation_reply_faults(x, err, &faults);
	eval_request_fini(&body);
}

void handle_scene_eval(struct exchange *x)
{
	struct precondition precondition;
	struct scene *scene;

	if (!scene_reply_preconditions(x, &precondition))
		return;
	scene = scene_refresh_get(x, &precondition);
	if (scene == NULL)
		return;
	evaluate_scene(x, scene);
	scene_release(scene);
}
