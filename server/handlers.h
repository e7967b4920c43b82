/*
 * Handlers, one for each route (server/routes.c). Each answers the exchange,
 * or has it wait and answers later.
 */
#ifndef SERVER_HANDLERS_H
#define SERVER_HANDLERS_H

struct exchange;

/* handle_eval.c */
void handle_eval(struct exchange *x);

/* handle_import.c */
void handle_import(struct exchange *x);

/* handle_scenes.c */
void handle_scenes_list(struct exchange *x);
void handle_scenes_post(struct exchange *x);
void handle_scene_get(struct exchange *x);
void handle_scene_put(struct exchange *x);
void handle_scene_delete(struct exchange *x);

/* handle_scene_patch.c; what it takes, for Accept-Patch */
#define HANDLERS_PATCH_TYPES \
	"application/json-patch+json, application/merge-patch+json"
void handle_scene_patch(struct exchange *x);

/* handle_scene_revisions.c */
void handle_scene_revisions(struct exchange *x);

/* handle_scene_events.c */
void handle_scene_events(struct exchange *x);

/* handle_tokens.c */
void handle_tokens(struct exchange *x);

/* handle_metrics.c */
void handle_metrics(struct exchange *x);

/* handle_scene_eval.c */
void handle_scene_eval(struct exchange *x);

/* handle_grid.c */
void handle_grid(struct exchange *x);

/* handle_scene_bounds.c */
void handle_scene_bounds(struct exchange *x);

/* handle_raycast.c */
void handle_raycast(struct exchange *x);

/* handle_project.c */
void handle_project(struct exchange *x);

/* handle_picture.c */
void handle_render(struct exchange *x);
void handle_slice(struct exchange *x);

/* handle_mesh.c */
void handle_mesh(struct exchange *x);

/* handle_progress.c */
void handle_progress(struct exchange *x);

/* handle_asset.c */
void handle_web(struct exchange *x);
void handle_contract(struct exchange *x);

/* handle_opening_angle.c */
void handle_opening_angle(struct exchange *x);

/* handle_operators.c */
void handle_operators_list(struct exchange *x);
void handle_operator_get(struct exchange *x);

/* handle_operator_order.c */
void handle_operator_order(struct exchange *x);

/* handle_volumes.c */
void handle_volumes_list(struct exchange *x);
void handle_volumes_post(struct exchange *x);
void handle_volume_get(struct exchange *x);
void handle_volume_delete(struct exchange *x);

/* handle_info.c */
void handle_index(struct exchange *x);
void handle_info(struct exchange *x);

/* handle_health.c */
void handle_healthz(struct exchange *x);
void handle_readyz(struct exchange *x);

#endif
