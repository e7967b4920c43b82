#include "server/routes.h"

#include <ctype.h>
#include <stdio.h>
#include <string.h>
#include <strings.h>

#include "server/evaluation_body.h"
#include "server/handlers.h"

static const struct route routes[] = {
	{"GET", "/", ROLE_NONE, "", false, NULL, false, handle_index,
	    "this list"},
	{"GET", "/healthz", ROLE_NONE, "", false, NULL, true, handle_healthz,
	    "is it alive"},
	{"GET", "/readyz", ROLE_NONE, "", false, NULL, true, handle_readyz,
	    "is it ready for evaluations"},
	{"GET", "/metrics", ROLE_READ, "", false, NULL, true, handle_metrics,
	    "counters, gauges and histograms, as Prometheus reads them"},
	{"GET", "/v1/info", ROLE_READ, "", false, NULL, false, handle_info,
	    "version, device, limits, queue"},
	{"GET", "/v1/operators", ROLE_READ, "", false, NULL, false,
	    handle_operators_list, "named operators, and the tables of "
	    "operators there are"},
	{"POST", "/v1/operators", ROLE_WRITE, "", true, NULL, false,
	    handle_operator_order, "build a table, of a resolution or to an "
	    "error: {profile, layout, family, resolution | max_error}"},
	{"GET", "/v1/operators/{id}", ROLE_READ, "", false, NULL, false,
	    handle_operator_get, "one named operator"},
	{"POST", "/v1/eval", ROLE_EVALUATE, " outputs priority deadline", true,
	    evaluation_body_open_eval, false, handle_eval, "evaluate a "
	    "document at points: {scene, points, outputs}"},
	{"POST", "/v1/import", ROLE_EVALUATE, "", true, NULL, false,
	    handle_import, "a three-js-blobtree document as one of ours: "
	    "{document, warnings}"},
	{"GET", "/v1/scenes", ROLE_READ, " limit after", false, NULL, false,
	    handle_scenes_list, "the scenes kept"},
	{"POST", "/v1/scenes", ROLE_WRITE, "", true, NULL, false,
	    handle_scenes_post, "keep a document under a new id"},
	{"GET", "/v1/scenes/{id}", ROLE_READ, " revision", false, NULL, false,
	    handle_scene_get, "the document"},
	{"PUT", "/v1/scenes/{id}", ROLE_WRITE, "", true, NULL, false,
	    handle_scene_put, "keep a document under this id, new or instead "
	    "of the old one"},
	{"PATCH", "/v1/scenes/{id}", ROLE_WRITE, "", true, NULL, false,
	    handle_scene_patch, "change it by a JSON Patch or a Merge Patch"},
	{"DELETE", "/v1/scenes/{id}", ROLE_WRITE, "", false, NULL, false,
	    handle_scene_delete, "forget it"},
	{"GET", "/v1/scenes/{id}/revisions", ROLE_READ, " limit before", false,
	    NULL, false, handle_scene_revisions, "its last revisions"},
	{"GET", "/v1/scenes/{id}/events", ROLE_READ, " last_event_id", false,
	    NULL, false, handle_scene_events, "its revisions as they come, "
	    "Server-Sent Events"},
	{"POST", "/v1/scenes/{id}/eval", ROLE_EVALUATE,
	    " outputs priority deadline", true, evaluation_body_open_scene_eval,
	    false, handle_scene_eval, "evaluate it at points: {points, "
	    "outputs}, raw float32 or npy"},
	{"POST", "/v1/scenes/{id}/grid", ROLE_EVALUATE,
	    " outputs priority deadline", true, NULL, false, handle_grid,
	    "evaluate it on a regular grid: {min, max, counts, outputs}"},
	{"GET", "/v1/scenes/{id}/bounds", ROLE_READ, "", false, NULL, false,
	    handle_scene_bounds, "a box that its field is 0 outside of"},
	{"POST", "/v1/scenes/{id}/opening-angle", ROLE_EVALUATE, "", true, NULL,
	    false, handle_opening_angle, "how far a union is to open for its "
	    "blend to end at a point: {node, point, children}"},
	{"POST", "/v1/scenes/{id}/raycast", ROLE_EVALUATE,
	    " deadline progress iso max_distance tolerance", true, NULL, false,
	    handle_raycast, "where rays meet its surface: {rays, iso, "
	    "max_distance}"},
	{"POST", "/v1/scenes/{id}/project", ROLE_EVALUATE,
	    " deadline progress iso max_distance", true, NULL, false,
	    handle_project, "points onto its surface, along the gradient: "
	    "{points, iso}"},
	{"POST", "/v1/scenes/{id}/render", ROLE_EVALUATE, " deadline progress",
	    true, NULL, false, handle_render, "a picture of its surface, PNG: "
	    "{width, height, camera, shading}"},
	{"POST", "/v1/scenes/{id}/slice", ROLE_EVALUATE,
	    " deadline progress outputs", true, NULL, false, handle_slice,
	    "its field in a plane, PNG or npy: {center, normal, width, height, "
	    "levels}"},
	{"POST", "/v1/scenes/{id}/mesh", ROLE_EVALUATE,
	    " deadline progress format", true, NULL, false, handle_mesh,
	    "its surface as triangles, GLB, PLY, STL, OBJ: {resolution, "
	    "bounds, iso}"},
	{"GET", "/v1/progress/{id}", ROLE_READ, "", false, NULL, true,
	    handle_progress, "how far the request with that ?progress= is"},
	{"GET", "/web/{id}", ROLE_NONE, "", false, NULL, false, handle_web,
	    "the previewer's files"},
	{"GET", "/openapi.json", ROLE_NONE, "", false, NULL, false,
	    handle_contract, "this protocol as OpenAPI 3.1"},
	{"GET", "/v1/volumes", ROLE_READ, "", false, NULL, false,
	    handle_volumes_list, "the sampled fields that documents may name"},
	{"POST", "/v1/volumes", ROLE_WRITE, " min max kind", true, NULL, false,
	    handle_volumes_post, "keep a grid of samples, an npy array of "
	    "shape (nx, ny, nz): ?min=x,y,z&max=x,y,z&kind=field|distance"},
	{"GET", "/v1/volumes/{id}", ROLE_READ, "", false, NULL, false,
	    handle_volume_get, "what is known of it"},
	{"DELETE", "/v1/volumes/{id}", ROLE_WRITE, "", false, NULL, false,
	    handle_volume_delete, "forget it, but for the scenes that use it"},
	{"GET", "/v1/tokens", ROLE_ADMIN, "", false, NULL, false,
	    handle_tokens, "who may do what, and what each has used"},
};

#define ROUTE_COUNT (sizeof routes / sizeof *routes)

const struct route *route_list(size_t *count)
{
	*count = ROUTE_COUNT;
	return routes;
}

/* Whether path is of pattern; the segment that stands for {id} into *id. */
static bool match(const char *pattern, const char *path, const char **id,
    size_t *id_length)
{
	const char *hole = strstr(pattern, "{id}");
	size_t before, length;

	*id = "";
	*id_length = 0;
	if (hole == NULL)
		return strcmp(pattern, path) == 0;
	before = (size_t)(hole - pattern);
	if (strncmp(pattern, path, before) != 0)
		return false;
	length = strcspn(path + before, "/");
	if (length == 0 || strcmp(hole + 4, path + before + length) != 0)
		return false;
	*id = path + before;
	*id_length = length;
	return true;
}

static void allow_method(char allow[static ROUTE_ALLOW_MAX],
    const char *method)
{
	size_t length = strlen(allow);

	snprintf(allow + length, ROUTE_ALLOW_MAX - length, "%s%s%s",
	    length > 0 ? ", " : "", method,
	    strcmp(method, "GET") == 0 ? ", HEAD" : "");
}

static bool serves(const struct route *route, const char *method)
{
	return strcmp(route->method, method) == 0 ||
	    (strcmp(method, "HEAD") == 0 && strcmp(route->method, "GET") == 0);
}

/* The path of a target in absolute form, http://host/path, which servers of
 * HTTPS take as well; or target itself. */
static const char *skip_authority(const char *target)
{
	size_t scheme = 0;
	const char *path;

	if (strncasecmp(target, "http://", 7) == 0)
		scheme = 7;
	else if (strncasecmp(target, "https://", 8) == 0)
		scheme = 8;
	if (scheme == 0)
		return target;
	path = strchr(target + scheme, '/');
	return path != NULL ? path : "/";
}

/* OPTIONS *: what is possible somewhere. */
static enum route_outcome find_any(char allow[static ROUTE_ALLOW_MAX])
{
	strcpy(allow, "GET, HEAD, POST, PUT, PATCH, DELETE, OPTIONS");
	return ROUTE_OPTIONS;
}

enum route_outcome route_find(const char *method, const char *path,
    const struct route **out, char *id, size_t id_size,
    char allow[static ROUTE_ALLOW_MAX])
{
	const struct route *found = NULL;

	id[0] = allow[0] = '\0';
	if (strcmp(path, "*") == 0 && strcmp(method, "OPTIONS") == 0)
		return find_any(allow);
	path = skip_authority(path);
	for (size_t i = 0; i < ROUTE_COUNT; i++) {
		const char *at;
		size_t length;

		if (!match(routes[i].pattern, path, &at, &length))
			continue;
		length = length < id_size ? length : id_size - 1;
		memcpy(id, at, length);
		id[length] = '\0';
		allow_method(allow, routes[i].method);
		if (serves(&routes[i], method))
			found = &routes[i];
	}
	if (allow[0] == '\0')
		return ROUTE_NO_PATH;
	allow_method(allow, "OPTIONS");
	if (strcmp(method, "OPTIONS") == 0)
		return ROUTE_OPTIONS;
	if (found == NULL)
		return ROUTE_NO_METHOD;
	*out = found;
	return ROUTE_FOUND;
}

static int hex_value(char c)
{
	static const char digits[] = "0123456789abcdef";
	const char *at = c != '\0' ? strchr(digits, tolower((unsigned char)c)) :
	    NULL;

	return at != NULL ? (int)(at - digits) : -1;
}

bool route_has_odd_escape(const char *path, size_t length)
{
	for (size_t i = 0; i + 2 < length; i++) {
		const int high = hex_value(path[i + 1]);
		const int low = hex_value(path[i + 2]);
		const int c = 16 * high + low;

		if (path[i] == '%' && high >= 0 && low >= 0 && c < 128 &&
		    (isalnum(c) || (c != 0 && strchr("-._~/", c) != NULL)))
			return true;
	}
	return false;
}

int route_query_index(const struct route *route, const char *name)
{
	size_t length = strlen(name);
	int index = 0;

	for (const char *at = route->query; *at != '\0'; index++) {
		size_t n = strcspn(++at, " ");

		if (n == length && memcmp(at, name, n) == 0)
			return index;
		at += n;
	}
	return -1;
}
