/*
 * The client itself, its errors, scenes and batches; surface.c has meshes and
 * pictures.
 */
#include "clients/c/blobfield.h"

#include <math.h>
#include <stdarg.h>
#include <stdint.h>
#include <stdlib.h>
#include <string.h>
#include <unistd.h>

#include <cjson/cJSON.h>

#include "clients/c/client.h"

#if __BYTE_ORDER__ != __ORDER_LITTLE_ENDIAN__
#error "float32 travels as it is in memory, little-endian"
#endif

_Static_assert(sizeof(struct blobfield_hit) == 13 * sizeof(float), "a row");
_Static_assert(sizeof(struct blobfield_foot) == 9 * sizeof(float), "a row");

static const char *const outcome_details[] = {
	[BLOBFIELD_OK] = "",
	[BLOBFIELD_REFUSED] = "the daemon has refused the request",
	[BLOBFIELD_UNREACHABLE] = "no answer",
	[BLOBFIELD_CANCELLED] = "given up",
	[BLOBFIELD_STRANGE] = "the answer is not of the expected size",
	[BLOBFIELD_FILE] = "the file cannot be written",
	[BLOBFIELD_ARGUMENT] = "wrong argument",
	[BLOBFIELD_MEMORY] = "out of memory"
};

static const struct {
	enum blobfield_output output;
	const char *name;
	size_t columns;
} outputs_known[] = {
	{BLOBFIELD_VALUE, "value", 1}, {BLOBFIELD_GRADIENT, "gradient", 3},
	{BLOBFIELD_HESSIAN, "hessian", 6}, {BLOBFIELD_COLOR, "color", 3},
	{BLOBFIELD_NORMAL, "normal", 3}, {BLOBFIELD_CURVATURE, "curvature", 2}
};

#define OUTPUTS_KNOWN (sizeof outputs_known / sizeof *outputs_known)

struct blobfield *blobfield_create(const char *url)
{
	struct blobfield *b = calloc(1, sizeof *b);
	const char *ca;

	if (url == NULL)
		url = getenv("BLOBFIELD_URL");
	if (url == NULL || *url == '\0')
		url = BLOBFIELD_URL;
	if (b == NULL || !transfer_init(&b->transfer, url)) {
		free(b);
		return NULL;
	}
	blobfield_set_token(b, getenv("BLOBFIELD_TOKEN"));
	/* One that cannot be read shows in the first call by https. */
	ca = getenv("BLOBFIELD_CA");
	if (ca != NULL && *ca != '\0')
		transfer_set_ca(&b->transfer, ca);
	return b;
}

/* Whether it can stand in a header as it is. */
static bool is_token(const char *token)
{
	for (const char *at = token; *at != '\0'; at++)
		if (*at <= ' ' || *at > '~' || at - token >= 255)
			return false;
	return true;
}

enum blobfield_outcome blobfield_set_token(struct blobfield *b,
    const char *token)
{
	char *line = b->transfer.authorization;

	line[0] = '\0';
	if (token == NULL || *token == '\0')
		return BLOBFIELD_OK;
	b->transfer.status = 0;
	if (!is_token(token))
		return client_fail(b, BLOBFIELD_ARGUMENT, "a token is one word "
		    "of up to 255 characters");
	snprintf(line, sizeof b->transfer.authorization, "Bearer %s", token);
	return BLOBFIELD_OK;
}

enum blobfield_outcome blobfield_set_ca(struct blobfield *b,
    const char *path)
{
	if (path != NULL && *path == '\0')
		path = NULL;
	b->transfer.status = 0;
	if (path != NULL && access(path, R_OK) != 0)
		return client_fail(b, BLOBFIELD_ARGUMENT, "'%.400s' cannot be "
		    "read", path);
	return client_fail(b, transfer_set_ca(&b->transfer, path), "%s", "");
}

void blobfield_free(struct blobfield *b)
{
	if (b == NULL)
		return;
	transfer_fini(&b->transfer);
	free(b);
}

const struct blobfield_error *blobfield_error(const struct blobfield *b)
{
	return &b->error;
}

const char *blobfield_url(const struct blobfield *b)
{
	return b->transfer.url;
}

const char *blobfield_header(struct blobfield *b, const char *name)
{
	struct curl_header *header;

	b->header[0] = '\0';
	if (b->transfer.status != 0 && curl_easy_header(b->transfer.main, name,
	    0, CURLH_HEADER, -1, &header) == CURLHE_OK)
		snprintf(b->header, sizeof b->header, "%s", header->value);
	return b->header;
}

void blobfield_set_progress(struct blobfield *b,
    int (*progress)(void *ctx, const char *stage, double done), void *ctx)
{
	b->transfer.progress = progress;
	b->transfer.ctx = ctx;
}

void blobfield_set_deadline(struct blobfield *b, double seconds)
{
	b->transfer.deadline = seconds;
}

void blobfield_cancel(struct blobfield *b)
{
	atomic_store(&b->transfer.cancelled, true);
}

void blobfield_bytes_fini(struct blobfield_bytes *bytes)
{
	free(bytes->data);
	*bytes = (struct blobfield_bytes){0};
}

/* ---- errors ---- */

enum blobfield_outcome client_fail(struct blobfield *b,
    enum blobfield_outcome outcome, const char *detail, ...)
{
	va_list arguments;

	b->error = (struct blobfield_error){.outcome = outcome,
	    .status = b->transfer.status};
	va_start(arguments, detail);
	vsnprintf(b->error.detail, sizeof b->error.detail, detail, arguments);
	va_end(arguments);
	return outcome;
}

static void copy_text(const cJSON *object, const char *name, char *out,
    size_t size)
{
	const cJSON *text = cJSON_GetObjectItem(object, name);

	if (cJSON_IsString(text))
		snprintf(out, size, "%s", text->valuestring);
}

/* {pointer, detail} each, and error_count if there are more. */
static void read_places(struct blobfield_error *error, const cJSON *problem)
{
	const cJSON *count = cJSON_GetObjectItem(problem, "error_count");
	const cJSON *item;

	cJSON_ArrayForEach(item, cJSON_GetObjectItem(problem, "errors")) {
		struct blobfield_place *place = &error->places[error->count];

		if (error->count == BLOBFIELD_PLACES_MAX)
			break;
		copy_text(item, "pointer", place->pointer,
		    sizeof place->pointer);
		copy_text(item, "detail", place->detail, sizeof place->detail);
		error->count++;
	}
	if (cJSON_IsNumber(count) && count->valuedouble > (double)error->count)
		error->count = (size_t)count->valuedouble;
}

/* Problem details (RFC 9457); what is none has its status said alone. */
static enum blobfield_outcome refuse(struct blobfield *b)
{
	static const char prefix[] = "/problems/";
	struct blobfield_error *error = &b->error;
	cJSON *problem = cJSON_Parse((const char *)b->transfer.bytes.data);
	const cJSON *type = cJSON_GetObjectItem(problem, "type");

	client_fail(b, BLOBFIELD_REFUSED, "status %ld", b->transfer.status);
	if (cJSON_IsString(type))
		snprintf(error->type, sizeof error->type, "%s",
		    type->valuestring + (strncmp(type->valuestring, prefix,
		    sizeof prefix - 1) == 0 ? sizeof prefix - 1 : 0));
	copy_text(problem, "title", error->title, sizeof error->title);
	copy_text(problem, "detail", error->detail, sizeof error->detail);
	read_places(error, problem);
	cJSON_Delete(problem);
	return BLOBFIELD_REFUSED;
}

enum blobfield_outcome client_do(struct blobfield *b,
    const struct transfer_request *request)
{
	struct transfer *t = &b->transfer;
	enum blobfield_outcome outcome = transfer_do(t, request);

	if (outcome == BLOBFIELD_UNREACHABLE)
		return client_fail(b, outcome, "%s: %s", t->url, t->reason);
	if (outcome == BLOBFIELD_OK && t->status >= 400)
		return refuse(b);
	return client_fail(b, outcome, "%s", outcome_details[outcome]);
}

void client_take(struct blobfield *b, struct blobfield_bytes *out)
{
	*out = b->transfer.bytes;
	b->transfer.bytes = (struct blobfield_bytes){0};
}

enum blobfield_outcome blobfield_request(struct blobfield *b,
    const char *method, const char *path, const char *type, const void *body,
    size_t size, const char *accept, struct blobfield_bytes *out)
{
	enum blobfield_outcome outcome = client_do(b,
	    &(struct transfer_request){
		.method = method,
		.path = path,
		.type = type,
		.accept = accept,
		.body = body,
		.size = size
	});

	if (outcome == BLOBFIELD_OK)
		client_take(b, out);
	return outcome;
}

/* ---- scenes ---- */

/* What ids are made of needs no escapes in a path. */
static bool is_id(const char *id)
{
	static const char letters[] = "ABCDEFGHIJKLMNOPQRSTUVWXYZ"
	    "abcdefghijklmnopqrstuvwxyz0123456789_.-";
	const size_t length = strlen(id);

	return length > 0 && length < BLOBFIELD_ID_MAX &&
	    strspn(id, letters) == length && strcmp(id, ".") != 0 &&
	    strcmp(id, "..") != 0;
}

enum blobfield_outcome client_path(struct blobfield *b,
    char path[CLIENT_PATH_MAX], const char *id, const char *tail)
{
	if (id == NULL || !is_id(id)) {
		b->transfer.status = 0;
		return client_fail(b, BLOBFIELD_ARGUMENT, "'%.80s' is no id: "
		    "1 to 64 of A-Z a-z 0-9 _ . -", id != NULL ? id : "");
	}
	snprintf(path, CLIENT_PATH_MAX, "/v1/scenes/%s%s", id, tail);
	return BLOBFIELD_OK;
}

enum blobfield_outcome client_read_summary(struct blobfield *b,
    const char *name, char *out, size_t size)
{
	cJSON *json = cJSON_Parse((const char *)b->transfer.bytes.data);
	const bool is_there = cJSON_IsString(cJSON_GetObjectItem(json, name));

	if (is_there)
		copy_text(json, name, out, size);
	cJSON_Delete(json);
	return is_there ? BLOBFIELD_OK : client_fail(b, BLOBFIELD_STRANGE,
	    "the answer has no '%s'", name);
}

enum blobfield_outcome blobfield_put(struct blobfield *b, const char *id,
    const char *document, size_t size, char tag[BLOBFIELD_TAG_MAX])
{
	char path[CLIENT_PATH_MAX];
	enum blobfield_outcome outcome = client_path(b, path, id, "");

	if (outcome == BLOBFIELD_OK)
		outcome = client_do(b, &(struct transfer_request){
			.method = "PUT",
			.path = path,
			.type = CLIENT_JSON,
			.body = document,
			.size = size
		});
	if (outcome == BLOBFIELD_OK && tag != NULL)
		outcome = client_read_summary(b, "revision", tag, BLOBFIELD_TAG_MAX);
	return outcome;
}

enum blobfield_outcome blobfield_post(struct blobfield *b,
    const char *document, size_t size, char id[BLOBFIELD_ID_MAX])
{
	enum blobfield_outcome outcome = client_do(b,
	    &(struct transfer_request){
		.method = "POST",
		.path = "/v1/scenes",
		.type = CLIENT_JSON,
		.body = document,
		.size = size
	});

	if (outcome == BLOBFIELD_OK)
		outcome = client_read_summary(b, "id", id, BLOBFIELD_ID_MAX);
	return outcome;
}

enum blobfield_outcome blobfield_get(struct blobfield *b, const char *id,
    struct blobfield_bytes *out)
{
	char path[CLIENT_PATH_MAX];
	enum blobfield_outcome outcome = client_path(b, path, id, "");

	return outcome != BLOBFIELD_OK ? outcome : blobfield_request(b, "GET",
	    path, NULL, NULL, 0, CLIENT_JSON, out);
}

enum blobfield_outcome blobfield_delete(struct blobfield *b, const char *id)
{
	char path[CLIENT_PATH_MAX];
	enum blobfield_outcome outcome = client_path(b, path, id, "");

	if (outcome == BLOBFIELD_OK)
		outcome = client_do(b, &(struct transfer_request){
			.method = "DELETE",
			.path = path
		});
	return outcome;
}

/* ---- batches ---- */

size_t blobfield_columns(unsigned outputs)
{
	size_t columns = 0;

	for (size_t i = 0; i < OUTPUTS_KNOWN; i++)
		if (outputs & outputs_known[i].output)
			columns += outputs_known[i].columns;
	return columns;
}

/* Sends columns_in floats for each of count, and gets columns_out. */
static enum blobfield_outcome exchange_rows(struct blobfield *b,
    const struct transfer_request *request, size_t columns_in,
    size_t columns_out, size_t count)
{
	struct transfer_request r = *request;

	if (count > SIZE_MAX / sizeof(float) / (columns_in + columns_out)) {
		b->transfer.status = 0;
		return client_fail(b, BLOBFIELD_ARGUMENT, "too many rows");
	}
	r.method = "POST";
	r.type = r.accept = CLIENT_OCTETS;
	r.size = count * columns_in * sizeof(float);
	r.into_size = count * columns_out * sizeof(float);
	/* Nothing is a body, too. */
	if (r.body == NULL)
		r.body = "";
	return client_do(b, &r);
}

/* "/v1/scenes/{id}/WHAT?outputs=…", and the deadline. */
static enum blobfield_outcome outputs_path(struct blobfield *b,
    char path[CLIENT_PATH_MAX], const char *id, const char *what,
    unsigned outputs)
{
	char tail[128];
	enum blobfield_outcome outcome;

	snprintf(tail, sizeof tail, "/%s?outputs=", what);
	for (size_t i = 0; i < OUTPUTS_KNOWN; i++)
		if (outputs & outputs_known[i].output) {
			if (tail[strlen(tail) - 1] != '=')
				strcat(tail, ",");
			strcat(tail, outputs_known[i].name);
		}
	outcome = client_path(b, path, id, tail);
	if (outcome == BLOBFIELD_OK && b->transfer.deadline > 0.0)
		snprintf(path + strlen(path), CLIENT_PATH_MAX - strlen(path),
		    "&deadline=%.9g", b->transfer.deadline);
	return outcome;
}

enum blobfield_outcome blobfield_evaluate(struct blobfield *b, const char *id,
    const float *points, size_t count, unsigned outputs, float *rows)
{
	char path[CLIENT_PATH_MAX];
	enum blobfield_outcome outcome = outputs_path(b, path, id, "eval",
	    outputs);

	if (outcome != BLOBFIELD_OK)
		return outcome;
	return exchange_rows(b, &(struct transfer_request){
		.path = path,
		.body = points,
		.into = rows
	}, 3, blobfield_columns(outputs), count);
}

/* Its points, 0 if the daemon will refuse it anyhow. */
static size_t grid_points(const struct blobfield_grid *grid)
{
	size_t points = 1;

	for (int i = 0; i < 3; i++)
		points *= grid->counts[i] < 1 || grid->counts[i] > 4096 ? 0 :
		    (size_t)grid->counts[i];
	return points;
}

/* What is not finite becomes null, which the daemon names. */
static char *grid_text(const struct blobfield_grid *grid)
{
	cJSON *json = cJSON_CreateObject();
	char *text;

	cJSON_AddItemToObject(json, "min",
	    cJSON_CreateDoubleArray(grid->min, 3));
	cJSON_AddItemToObject(json, "max",
	    cJSON_CreateDoubleArray(grid->max, 3));
	cJSON_AddItemToObject(json, "counts",
	    cJSON_CreateIntArray(grid->counts, 3));
	text = cJSON_PrintUnformatted(json);
	cJSON_Delete(json);
	return text;
}

enum blobfield_outcome blobfield_grid(struct blobfield *b, const char *id,
    const struct blobfield_grid *grid, unsigned outputs, float *rows)
{
	char path[CLIENT_PATH_MAX], *body;
	enum blobfield_outcome outcome = outputs_path(b, path, id, "grid",
	    outputs);

	if (outcome != BLOBFIELD_OK)
		return outcome;
	body = grid_text(grid);
	if (body == NULL) {
		b->transfer.status = 0;
		return client_fail(b, BLOBFIELD_MEMORY, "out of memory");
	}
	outcome = client_do(b, &(struct transfer_request){
		.method = "POST",
		.path = path,
		.type = CLIENT_JSON,
		.accept = CLIENT_OCTETS,
		.body = body,
		.size = strlen(body),
		.into = rows,
		.into_size = grid_points(grid) * blobfield_columns(outputs) *
		    sizeof(float)
	});
	cJSON_free(body);
	return outcome;
}

/* path?name=number, or &name=number; 0 adds nothing. */
static void add_number(char path[CLIENT_PATH_MAX], const char *name,
    double number)
{
	const size_t length = strlen(path);

	if (number != 0.0)
		snprintf(path + length, CLIENT_PATH_MAX - length, "%c%s=%.17g",
		    strchr(path, '?') != NULL ? '&' : '?', name, number);
}

static enum blobfield_outcome ray_path(struct blobfield *b,
    char path[CLIENT_PATH_MAX], const char *id, const char *tail,
    const struct blobfield_ray_options *options)
{
	enum blobfield_outcome outcome = client_path(b, path, id, tail);

	if (outcome == BLOBFIELD_OK && options != NULL) {
		add_number(path, "iso", options->iso);
		add_number(path, "max_distance", options->max_distance);
	}
	return outcome;
}

enum blobfield_outcome blobfield_raycast(struct blobfield *b, const char *id,
    const float *rays, size_t count,
    const struct blobfield_ray_options *options, struct blobfield_hit *hits)
{
	char path[CLIENT_PATH_MAX];
	enum blobfield_outcome outcome = ray_path(b, path, id, "/raycast",
	    options);

	if (outcome != BLOBFIELD_OK)
		return outcome;
	if (options != NULL)
		add_number(path, "tolerance", options->tolerance);
	return exchange_rows(b, &(struct transfer_request){
		.path = path,
		.body = rays,
		.into = hits,
		.is_long = true
	}, 6, 13, count);
}

enum blobfield_outcome blobfield_project(struct blobfield *b, const char *id,
    const float *points, size_t count,
    const struct blobfield_ray_options *options, struct blobfield_foot *feet)
{
	char path[CLIENT_PATH_MAX];
	enum blobfield_outcome outcome = ray_path(b, path, id, "/project",
	    options);

	if (outcome != BLOBFIELD_OK)
		return outcome;
	return exchange_rows(b, &(struct transfer_request){
		.path = path,
		.body = points,
		.into = feet,
		.is_long = true
	}, 3, 9, count);
}

/* null, for a coordinate, is unbounded; false: no corner. */
static bool read_corner(const cJSON *json, const char *name, double unbounded,
    double out[static 3])
{
	const cJSON *corner = cJSON_GetObjectItem(json, name);

	for (int i = 0; i < 3; i++) {
		const cJSON *item = cJSON_GetArrayItem(corner, i);

		if (item == NULL)
			return false;
		out[i] = cJSON_IsNumber(item) ? item->valuedouble : unbounded;
	}
	return true;
}

static bool read_box(const cJSON *json, struct blobfield_box *out)
{
	struct blobfield_box box;

	if (!read_corner(json, "min", -HUGE_VAL, box.min) ||
	    !read_corner(json, "max", HUGE_VAL, box.max))
		return false;
	*out = box;
	return true;
}

enum blobfield_outcome blobfield_bounds(struct blobfield *b, const char *id,
    struct blobfield_bounds *out)
{
	char path[CLIENT_PATH_MAX];
	struct blobfield_bounds bounds = {0};
	enum blobfield_outcome outcome = client_path(b, path, id, "/bounds");
	cJSON *json;

	if (outcome == BLOBFIELD_OK)
		outcome = client_do(b, &(struct transfer_request){
			.method = "GET",
			.path = path
		});
	if (outcome != BLOBFIELD_OK)
		return outcome;
	json = cJSON_Parse((const char *)b->transfer.bytes.data);
	bounds.is_empty = cJSON_IsTrue(cJSON_GetObjectItem(json, "empty"));
	bounds.has_surface = read_box(cJSON_GetObjectItem(json, "surface"),
	    &bounds.surface);
	if (!read_box(json, &bounds.field) && !bounds.is_empty)
		outcome = client_fail(b, BLOBFIELD_STRANGE,
		    "the answer is no box");
	else
		*out = bounds;
	cJSON_Delete(json);
	return outcome;
}
