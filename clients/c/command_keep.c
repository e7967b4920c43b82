/*
 * blobfield put, get, list, delete, bounds, info: scenes, and the daemon.
 */
#include <stdlib.h>
#include <string.h>

#include <cjson/cJSON.h>

#include "clients/c/command.h"

int command_put(struct session *s, const struct command *self, int argc,
    char **argv)
{
	char tag[BLOBFIELD_TAG_MAX];
	const char *path;
	int count, status;

	if (!command_start(s, self, NULL, argc, argv, 1, 2, &count, &status))
		return status;
	path = count > 1 ? argv[1] : "-";
	if (!command_read(s, path, &s->text))
		return COMMAND_FILE;
	s->source = strcmp(path, "-") == 0 ? "stdin" : path;
	if (blobfield_put(s->client, argv[0], (const char *)s->text.data,
	    s->text.size, tag) != BLOBFIELD_OK)
		status = command_fail(s, true);
	else if (!s->quiet)
		printf("%s\n", tag);
	blobfield_bytes_fini(&s->text);
	return status;
}

/* revision: NULL: the present one. */
static enum blobfield_outcome get(struct session *s, const char *id,
    const char *revision, struct blobfield_bytes *out)
{
	char path[2 * BLOBFIELD_ID_MAX + 64];

	snprintf(path, sizeof path, "/v1/scenes/%s%s%s", id,
	    revision != NULL ? "?revision=" : "",
	    revision != NULL ? revision : "");
	return blobfield_request(s->client, "GET", path, NULL, NULL, 0,
	    "application/json", out);
}

int command_get(struct session *s, const struct command *self, int argc,
    char **argv)
{
	struct blobfield_bytes bytes = {0};
	const char *path = NULL, *revision = NULL;
	const struct options_rule rules[] = {
		{"output", 'o', OPTIONS_TEXT, &path, "FILE", "(stdout)"},
		{"revision", 0, OPTIONS_TEXT, &revision, "REVISION",
		    "as it was then"},
		{0}
	};
	int count, status;

	if (!command_start(s, self, rules, argc, argv, 1, 1, &count, &status))
		return status;
	if (!command_is_id(s, argv[0]) ||
	    (revision != NULL && !command_is_id(s, revision)))
		return COMMAND_USAGE;
	if (get(s, argv[0], revision, &bytes) != BLOBFIELD_OK)
		return command_fail(s, false);
	if (!command_write(s, path, bytes.data, bytes.size))
		status = COMMAND_FILE;
	blobfield_bytes_fini(&bytes);
	return status;
}

int command_delete(struct session *s, const struct command *self, int argc,
    char **argv)
{
	int count, status;

	if (!command_start(s, self, NULL, argc, argv, 1, 1000, &count,
	    &status))
		return status;
	for (int i = 0; i < count; i++)
		if (blobfield_delete(s->client, argv[i]) != BLOBFIELD_OK) {
			const int failed = command_fail(s, false);

			status = failed > status ? failed : status;
		}
	return status;
}

/* ---- list ---- */

static const char *text_of(const cJSON *json, const char *name)
{
	const char *text = cJSON_GetStringValue(cJSON_GetObjectItem(json,
	    name));

	return text != NULL ? text : "";
}

/* One page; the id to go on after to after, "" at the end. */
static void print_page(const cJSON *page, char after[BLOBFIELD_ID_MAX])
{
	const cJSON *item;

	cJSON_ArrayForEach(item, cJSON_GetObjectItem(page, "scenes")) {
		const cJSON *nodes = cJSON_GetObjectItem(item, "nodes");

		printf("%-32s %7.0f  %s\n", text_of(item, "id"),
		    cJSON_IsNumber(nodes) ? nodes->valuedouble : 0.0,
		    text_of(item, "name"));
	}
	snprintf(after, BLOBFIELD_ID_MAX, "%s", text_of(page, "next"));
}

int command_scenes(struct session *s, const struct command *self, int argc,
    char **argv)
{
	char after[BLOBFIELD_ID_MAX] = "";
	char path[BLOBFIELD_ID_MAX + 32] = "/v1/scenes";
	int count, status;

	if (!command_start(s, self, NULL, argc, argv, 0, 0, &count, &status))
		return status;
	do {
		struct blobfield_bytes bytes = {0};
		cJSON *page;

		if (blobfield_request(s->client, "GET", path, NULL, NULL, 0,
		    "application/json", &bytes) != BLOBFIELD_OK)
			return command_fail(s, false);
		page = cJSON_Parse((const char *)bytes.data);
		print_page(page, after);
		snprintf(path, sizeof path, "/v1/scenes?after=%s", after);
		cJSON_Delete(page);
		blobfield_bytes_fini(&bytes);
	} while (*after != '\0');
	return status;
}

/* ---- bounds ---- */

static void print_box(const char *name, const struct blobfield_box *box)
{
	printf("%-8s %.9g,%.9g,%.9g  %.9g,%.9g,%.9g\n", name, box->min[0],
	    box->min[1], box->min[2], box->max[0], box->max[1], box->max[2]);
}

static int print_bounds(struct session *s)
{
	struct blobfield_bounds bounds;

	if (blobfield_bounds(s->client, s->id, &bounds) != BLOBFIELD_OK)
		return command_fail(s, false);
	if (bounds.is_empty)
		printf("%-8s none\n", "field");
	else
		print_box("field", &bounds.field);
	if (bounds.has_surface)
		print_box("surface", &bounds.surface);
	else
		printf("%-8s none, or unbounded\n", "surface");
	return COMMAND_DONE;
}

int command_bounds(struct session *s, const struct command *self, int argc,
    char **argv)
{
	int count, status;

	if (!command_start(s, self, NULL, argc, argv, 1, 1, &count, &status))
		return status;
	status = command_open_scene(s, argv[0]);
	if (status == COMMAND_DONE)
		status = print_bounds(s);
	command_close_scene(s);
	return status;
}

/* ---- info ---- */

int command_info(struct session *s, const struct command *self, int argc,
    char **argv)
{
	struct blobfield_bytes bytes = {0};
	cJSON *json;
	char *text;
	int count, status;

	if (!command_start(s, self, NULL, argc, argv, 0, 0, &count, &status))
		return status;
	if (blobfield_request(s->client, "GET", "/v1/info", NULL, NULL, 0,
	    "application/json", &bytes) != BLOBFIELD_OK)
		return command_fail(s, false);
	json = cJSON_Parse((const char *)bytes.data);
	text = cJSON_Print(json);
	printf("%s\n", text != NULL ? text : (const char *)bytes.data);
	cJSON_free(text);
	cJSON_Delete(json);
	blobfield_bytes_fini(&bytes);
	return status;
}
