#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include <cjson/cJSON.h>

#include "core/tree.h"
#include "core/volume.h"
#include "proto/fault.h"
#include "proto/grid_npy.h"
#include "proto/number.h"
#include "server/backing.h"
#include "server/config.h"
#include "server/evaluation.h"
#include "server/exchange.h"
#include "server/handlers.h"
#include "server/scene_reply.h"
#include "server/scene_store.h"
#include "server/server.h"
#include "server/volume_store.h"

/* What the query says. */
struct wanted {
	double min[3], max[3];
	bool is_distance;
};

/* ---- answers ---- */

static cJSON *triple(struct vec3 v)
{
	return cJSON_CreateDoubleArray((const double[]){v.x, v.y, v.z}, 3);
}

static cJSON *describe(const struct volume_entry *entry)
{
	cJSON *json = cJSON_CreateObject();
	cJSON *shape;

	cJSON_AddStringToObject(json, "id", entry->id);
	cJSON_AddStringToObject(json, "kind", entry->is_distance ? "distance" :
	    "field");
	shape = cJSON_AddArrayToObject(json, "shape");
	for (int i = 0; i < 3; i++)
		cJSON_AddItemToArray(shape,
		    cJSON_CreateNumber((double)entry->count[i]));
	cJSON_AddItemToObject(json, "min", triple(entry->min));
	cJSON_AddItemToObject(json, "max", triple(entry->max));
	cJSON_AddNumberToObject(json, "bytes", (double)entry->bytes);
	cJSON_AddNumberToObject(json, "least", (double)entry->least);
	cJSON_AddNumberToObject(json, "most", (double)entry->most);
	if (entry->is_distance)
		cJSON_AddNumberToObject(json, "max_falloff",
		    fmax(entry->least_edge, 0.0));
	if (entry->owner[0] != '\0')
		cJSON_AddStringToObject(json, "owner", entry->owner);
	return json;
}

static void reply_kept(struct exchange *x, const struct volume_entry *entry,
    bool is_new)
{
	char location[sizeof "/v1/volumes/" + VOLUME_ID_DIGITS];

	exchange_reply_json(x, is_new ? 201 : 200, describe(entry));
	snprintf(location, sizeof location, "/v1/volumes/%s", entry->id);
	exchange_add_header(x, "Location", location);
}

static void reply_full(struct exchange *x, size_t need, bool is_owners)
{
	struct volume_store_stats stats;

	if (is_owners) {
		exchange_reply_problem(x, PROBLEM_STORE_FULL, NULL,
		    "The token '%s' may have %zu bytes of volumes (volume_bytes) "
		    "and has %zu, deleted ones that scenes still use included; "
		    "this one needs %zu. Delete some, and the scenes that use "
		    "them.", access_owner(x), access_volume_bytes_most(x),
		    volume_store_bytes_of(x->server->volumes, access_owner(x)),
		    need);
		return;
	}
	volume_store_get_stats(x->server->volumes, &stats);
	exchange_reply_problem(x, PROBLEM_STORE_FULL, NULL,
	    "Volumes, deleted ones that scenes still use included, take %zu "
	    "of at most %zu bytes (--volume-memory); this one needs %zu, and "
	    "there may be %d. "
	    "Delete some, and the scenes that use them.", stats.bytes,
	    x->server->config->device.volume_bytes, need, VOLUME_STORE_MAX);
}

static void reply_absent(struct exchange *x)
{
	exchange_reply_problem(x, PROBLEM_NOT_FOUND, NULL,
	    "There is no volume '%s'.", x->id);
}

/* ---- the query ---- */

/* "x,y,z" to out. */
static bool parse_triple(const char *text, double out[static 3])
{
	const char *end = text + strlen(text);

	for (int i = 0; i < 3; i++) {
		if (i > 0 && (text == end || *text++ != ','))
			return false;
		if (number_parse(&text, end, out + i) != 0)
			return false;
	}
	return text == end;
}

/* The corner that query parameter name gives. */
static bool read_corner(struct exchange *x, const char *name,
    double out[static 3], struct faults *faults)
{
	const char *text = exchange_query(x, name);
	char pointer[8];

	snprintf(pointer, sizeof pointer, "?%s", name);
	if (text == NULL || !parse_triple(text, out)) {
		faults_add(faults, pointer, "must be x,y,z: the coordinates of "
		    "the %s sample, three numbers separated by commas",
		    strcmp(name, "min") == 0 ? "first" : "last");
		return false;
	}
	for (int i = 0; i < 3; i++)
		if (!(fabs(out[i]) <= TREE_COORDINATE_MAX)) {
			faults_add(faults, pointer, "%c is %g; its size must "
			    "be at most %g", "xyz"[i], out[i],
			    TREE_COORDINATE_MAX);
			return false;
		}
	return true;
}

static void check_box(const struct wanted *w, struct faults *faults)
{
	for (int i = 0; i < 3; i++)
		if (!(w->min[i] < w->max[i]))
			faults_add(faults, "?max", "%c is %.9g, not above "
			    "min's %.9g", "xyz"[i], w->max[i], w->min[i]);
}

static void read_kind(struct exchange *x, struct wanted *out,
    struct faults *faults)
{
	const char *kind = exchange_query(x, "kind");

	out->is_distance = kind != NULL && strcmp(kind, "distance") == 0;
	if (kind == NULL || (!out->is_distance && strcmp(kind, "field") != 0))
		faults_add(faults, "?kind", "must be field (values, 0 or more) "
		    "or distance (signed, negative inside)");
}

/* Tells all that is wrong; false if anything is. */
static bool read_query(struct exchange *x, struct wanted *out,
    struct faults *faults)
{
	bool has_min = read_corner(x, "min", out->min, faults);
	bool has_max = read_corner(x, "max", out->max, faults);

	if (has_min && has_max)
		check_box(out, faults);
	read_kind(x, out, faults);
	return faults->count == 0;
}

/* Whether the samples are far enough apart. */
static bool check_spacing(const struct wanted *w, const struct grid *grid,
    struct faults *faults)
{
	for (int i = 0; i < 3; i++) {
		double h = (w->max[i] - w->min[i]) /
		    (double)(grid->count[i] - 1);

		if (h < TREE_LENGTH_MIN)
			faults_add(faults, "?max", "samples along %c are %g "
			    "apart, not at least %g", "xyz"[i], h,
			    TREE_LENGTH_MIN);
	}
	return faults->count == 0;
}

/* ---- requests ---- */

/* A volume that arrives, or goes, and x that waits for it: x->state. */
struct waiting {
	struct scene_change change;
	struct backing_volume volume;
	struct volume_entry entry;
	void *data;       /* of volume */
	char payer[TOKEN_NAME_MAX + 1];
	struct exchange *x;
};

static void free_waiting(void *state, struct server *server)
{
	struct waiting *w = state;

	(void)server;
	free(w->data);
	free(w);
}

/* Kept, it has been settled, and is whose it was kept as. */
static void settle(struct waiting *w)
{
	if (w->change.kind == VOLUME_KEEP && w->change.result != ERR_OK)
		volume_store_settle(w->x->server->volumes, w->entry.id, NULL);
	else if (w->change.kind == VOLUME_KEEP)
		strcpy(w->entry.owner, w->change.owner);
	free(w->data);
	w->data = NULL;
}

static void on_done(void *ctx)
{
	struct waiting *w = ctx;

	settle(w);
	exchange_resume(w->x);
}

static void answer(struct exchange *x)
{
	struct waiting *w = x->state;

	if (w->change.result != ERR_OK)
		exchange_reply_problem(x, problem_from_err(w->change.result),
		    NULL, "The volume could not be %s: %s; nothing has "
		    "changed.", w->change.kind == VOLUME_KEEP ? "kept" :
		    "deleted", err_message(w->change.result));
	else if (w->change.kind == VOLUME_KEEP)
		reply_kept(x, &w->entry, !w->change.replaced);
	else
		exchange_reply_empty(x, 204);
}

/* Has x wait until what w says is on disk. */
static void submit(struct exchange *x, struct waiting *w,
    enum scene_change_kind kind)
{
	w->x = x;
	w->volume.id = w->entry.id;
	w->volume.owner = w->payer;
	w->change.kind = kind;
	w->change.volume = &w->volume;
	w->change.done = on_done;
	w->change.ctx = w;
	x->state = w;
	x->state_free = free_waiting;
	scene_reply_wait(x, &w->change, answer);
}

static struct waiting *make_waiting(struct exchange *x)
{
	struct waiting *w = calloc(1, sizeof *w);

	if (w == NULL)
		exchange_reply_problem(x, PROBLEM_MEMORY, NULL,
		    "There was no memory for the volume.");
	return w;
}

/* grid's samples go to the bytes that are to be kept, and are read there. */
static enum err encode(struct waiting *w, const struct wanted *wanted,
    struct grid *grid, struct volume_payer *payer)
{
	struct vec3 min = vec3(wanted->min[0], wanted->min[1], wanted->min[2]);
	struct vec3 max = vec3(wanted->max[0], wanted->max[1], wanted->max[2]);
	struct grid kept = *grid;
	bool is_new;
	enum err err = volume_store_encode(grid, min, max, wanted->is_distance,
	    &w->data, &w->volume.length);

	if (err != ERR_OK)
		return err;
	grid_fini(grid);
	w->volume.data = w->data;
	kept.samples = volume_store_samples(w->data);
	return volume_store_add(w->x->server->volumes, &kept, min, max,
	    wanted->is_distance, payer, &w->entry, &is_new);
}

static void keep(struct exchange *x, const struct wanted *wanted,
    struct grid *grid)
{
	struct volume_payer payer = {.owner = access_owner(x),
	    .bytes_most = access_volume_bytes_most(x)};
	struct waiting *w = make_waiting(x);
	size_t need = volume_store_need(grid);
	enum err err;

	if (w == NULL)
		return;
	w->x = x;
	snprintf(w->payer, sizeof w->payer, "%s", payer.owner);
	err = encode(w, wanted, grid, &payer);
	if (err == ERR_OK) {
		submit(x, w, VOLUME_KEEP);
		return;
	}
	free_waiting(w, x->server);
	if (err == ERR_LIMIT)
		reply_full(x, need, payer.is_owners);
	else
		exchange_reply_problem(x, problem_from_err(err), NULL,
		    "The volume could not be kept: %s.", err_message(err));
}

void handle_volumes_post(struct exchange *x)
{
	struct faults faults = {0};
	struct grid grid = {0};
	enum media_type type;
	struct wanted w;
	enum err err;

	if (!exchange_check_content_type(x, 1u << MEDIA_NPY, &type))
		return;
	if (!read_query(x, &w, &faults)) {
		evaluation_reply_faults(x, ERR_INVALID, &faults);
		return;
	}
	err = grid_from_npy(x->body != NULL ? x->body : "", x->body_length,
	    &grid, &faults);
	if (err == ERR_OK && !check_spacing(&w, &grid, &faults))
		err = ERR_INVALID;
	if (err == ERR_OK) {
		exchange_release_body(x);
		keep(x, &w, &grid);
	} else {
		evaluation_reply_faults(x, err, &faults);
	}
	grid_fini(&grid);
}

void handle_volumes_list(struct exchange *x)
{
	struct volume_store_stats stats;
	struct volume_entry *entries;
	cJSON *json, *list;
	size_t count;

	if (volume_store_list(x->server->volumes, &entries, &count) !=
	    ERR_OK) {
		exchange_reply_problem(x, PROBLEM_MEMORY, NULL,
		    "There was no memory for the answer.");
		return;
	}
	volume_store_get_stats(x->server->volumes, &stats);
	json = cJSON_CreateObject();
	list = cJSON_AddArrayToObject(json, "volumes");
	for (size_t i = 0; i < count; i++)
		cJSON_AddItemToArray(list, describe(entries + i));
	free(entries);
	cJSON_AddNumberToObject(json, "bytes", (double)stats.bytes);
	cJSON_AddNumberToObject(json, "max_bytes",
	    (double)x->server->config->device.volume_bytes);
	exchange_reply_json(x, 200, json);
}

void handle_volume_get(struct exchange *x)
{
	struct volume_entry entry;

	if (volume_store_get(x->server->volumes, x->id, &entry) == ERR_OK)
		exchange_reply_json(x, 200, describe(&entry));
	else
		reply_absent(x);
}

/* Marked as forgotten; what no scene uses is then removed by and by. */
void handle_volume_delete(struct exchange *x)
{
	struct waiting *w = make_waiting(x);

	if (w == NULL)
		return;
	if (volume_store_get(x->server->volumes, x->id, &w->entry) != ERR_OK) {
		free_waiting(w, x->server);
		reply_absent(x);
		return;
	}
	w->volume.is_forgotten = true;
	submit(x, w, VOLUME_FORGET);
}
