#include <cjson/cJSON.h>

#include "core/locate.h"
#include "core/tree.h"
#include "proto/document.h"
#include "proto/fault.h"
#include "proto/opening_request.h"
#include "server/config.h"
#include "server/evaluation.h"
#include "server/exchange.h"
#include "server/handlers.h"
#include "server/scene_document.h"
#include "server/scene_refresh.h"
#include "server/scene_reply.h"
#include "server/scene_store.h"
#include "server/server.h"

/* The union that request names, with the children that it does; else a fault
 * and NULL. */
static const struct node *find_union(const struct tree *tree,
    const struct opening_request *request, struct faults *faults)
{
	static const char *const places[2] = {"/children/0", "/children/1"};
	const struct node *node = locate_node(tree, request->node);

	if (node == NULL) {
		faults_add(faults, "/node", "the scene has no node '%s'",
		    request->node);
		return NULL;
	}
	if (node->type != NODE_UNION || node->child_count < 2) {
		faults_add(faults, "/node", "'%s' is not a union of 2 or more "
		    "children", request->node);
		return NULL;
	}
	for (int i = 0; i < 2 && request->has_children; i++) {
		if (request->children[i] < node->child_count)
			continue;
		faults_add(faults, places[i], "'%s' has %zu children, counted "
		    "from 0", request->node, node->child_count);
		return NULL;
	}
	return node;
}

static cJSON *blend_json(const struct locate_blend *blend)
{
	static const char *const parameters[] = {"theta0", "theta1", "theta2",
	    [LOCATE_CONSTANT] = "theta"};
	const double children[2] = {(double)blend->children[0],
	    (double)blend->children[1]};
	cJSON *json = cJSON_CreateObject();

	cJSON_AddNumberToObject(json, "theta", blend->theta);
	cJSON_AddItemToObject(json, "alpha", blend->has_alpha ?
	    cJSON_CreateNumber(blend->alpha) : cJSON_CreateNull());
	cJSON_AddItemToObject(json, "values",
	    cJSON_CreateDoubleArray(blend->values, 2));
	cJSON_AddItemToObject(json, "children",
	    cJSON_CreateDoubleArray(children, 2));
	cJSON_AddItemToObject(json, "parameter", blend->parameter >= 0 ?
	    cJSON_CreateString(parameters[blend->parameter])
	    : cJSON_CreateNull());
	return json;
}

static enum err find_blend(struct exchange *x, const struct tree *tree,
    const struct opening_request *request, struct locate_blend *out,
    struct faults *faults)
{
	const struct node *node = find_union(tree, request, faults);

	if (node == NULL)
		return ERR_INVALID;
	return locate_blend(node, request->has_children ? request->children
	    : NULL, tree->null_gradient, x->server->config->max_nodes,
	    request->point, out);
}

static void reply_blend(struct exchange *x, const struct scene *scene,
    const struct opening_request *request)
{
	struct faults faults = {0};
	struct locate_blend blend;
	struct document *document;
	enum err err;

	if (!scene_document_read(x, scene, &document))
		return;
	err = find_blend(x, document_tree(document), request, &blend, &faults);
	document_free(document);
	if (err != ERR_OK) {
		evaluation_reply_faults(x, err, &faults);
		return;
	}
	exchange_reply_json(x, 200, blend_json(&blend));
	exchange_add_header(x, "ETag", scene->etag);
}

static void answer_scene(struct exchange *x, const struct scene *scene)
{
	struct opening_request request;
	struct faults faults = {0};
	enum err err;

	err = opening_request_parse(x->body != NULL ? x->body : "",
	    x->body_length, &request, &faults);
	if (err == ERR_OK)
		reply_blend(x, scene, &request);
	else
		evaluation_reply_faults(x, err, &faults);
}

void handle_opening_angle(struct exchange *x)
{
	struct precondition precondition;
	enum media_type type;
	struct scene *scene;

	if (!exchange_check_content_type(x, 1u << MEDIA_JSON, &type) ||
	    !scene_reply_preconditions(x, &precondition))
		return;
	scene = scene_refresh_get(x, &precondition);
	if (scene == NULL)
		return;
	answer_scene(x, scene);
	scene_release(scene);
}
