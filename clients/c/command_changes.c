/*
 * blobfield patch, revisions, events: changes of a kept scene.
 */
#include <stdlib.h>
#include <string.h>

#include <cjson/cJSON.h>

#include "clients/c/command.h"

/* Places point into the patch, unless it is what comes of it that is wrong. */
static int fail_patch(struct session *s)
{
	static const char after[] = "The document after the patch";
	const char *detail = blobfield_error(s->client)->detail;

	if (strncmp(detail, after, sizeof after - 1) != 0)
		return command_fail(s, true);
	command_say(s, "%s\n", detail);
	return command_fail(s, false);
}

int command_patch(struct session *s, const struct command *self, int argc,
    char **argv)
{
	char tag[BLOBFIELD_TAG_MAX];
	const char *path, *if_match = NULL;
	const struct options_rule rules[] = {
		{"if-match", 0, OPTIONS_TEXT, &if_match, "REVISION",
		    "only if that is what is there"},
		{0}
	};
	int count, status;

	if (!command_start(s, self, rules, argc, argv, 1, 2, &count, &status))
		return status;
	path = count > 1 ? argv[1] : "-";
	if (!command_read(s, path, &s->text))
		return COMMAND_FILE;
	s->source = strcmp(path, "-") == 0 ? "stdin" : path;
	if (blobfield_patch(s->client, argv[0], (const char *)s->text.data,
	    s->text.size, if_match, tag) != BLOBFIELD_OK)
		status = fail_patch(s);
	else if (!s->quiet)
		printf("%s\n", tag);
	blobfield_bytes_fini(&s->text);
	return status;
}

/* ---- revisions ---- */

static const char *text_of(const cJSON *json, const char *name)
{
	const char *text = cJSON_GetStringValue(cJSON_GetObjectItem(json,
	    name));

	return text != NULL ? text : "";
}

static double number_of(const cJSON *json, const char *name)
{
	const cJSON *item = cJSON_GetObjectItem(json, name);

	return cJSON_IsNumber(item) ? item->valuedouble : 0.0;
}

/* The same columns for both. */
static void print_change(const char *sequence, const char *time,
    const char *what, double nodes, double bytes, const char *note)
{
	printf("%-8s %s  %-32s %7.0f %9.0f%s\n", sequence, time, what, nodes,
	    bytes, note);
}

/* One page; the sequence to go on before to before, "" at the end. */
static void print_page(const cJSON *page, char before[BLOBFIELD_SEQUENCE_MAX])
{
	const cJSON *item;

	cJSON_ArrayForEach(item, cJSON_GetObjectItem(page, "revisions"))
		print_change(text_of(item, "sequence"), text_of(item, "time"),
		    text_of(item, "revision"), number_of(item, "nodes"),
		    number_of(item, "bytes"), "");
	snprintf(before, BLOBFIELD_SEQUENCE_MAX, "%s", text_of(page, "next"));
}

int command_revisions(struct session *s, const struct command *self, int argc,
    char **argv)
{
	char before[BLOBFIELD_SEQUENCE_MAX] = "", path[256];
	int count, status;

	if (!command_start(s, self, NULL, argc, argv, 1, 1, &count, &status))
		return status;
	if (!command_is_id(s, argv[0]))
		return COMMAND_USAGE;
	do {
		struct blobfield_bytes bytes = {0};
		cJSON *page;

		snprintf(path, sizeof path, "/v1/scenes/%s/revisions%s%s",
		    argv[0], *before != '\0' ? "?before=" : "", before);
		if (blobfield_request(s->client, "GET", path, NULL, NULL, 0,
		    "application/json", &bytes) != BLOBFIELD_OK)
			return command_fail(s, false);
		page = cJSON_Parse((const char *)bytes.data);
		print_page(page, before);
		cJSON_Delete(page);
		blobfield_bytes_fini(&bytes);
	} while (*before != '\0');
	return status;
}

/* ---- events ---- */

struct listening {
	int left; /* events to be told; below 0: any number */
};

static int print_event(void *ctx, const struct blobfield_event *event)
{
	struct listening *l = ctx;

	print_change(event->sequence, event->time,
	    event->is_deletion ? "deleted" : event->revision,
	    (double)event->nodes, (double)event->bytes,
	    event->has_missed ? " missed" : "");
	/* Whoever reads has had enough. */
	if (fflush(stdout) != 0)
		return 1;
	return l->left > 0 && --l->left == 0;
}

int command_events(struct session *s, const struct command *self, int argc,
    char **argv)
{
	struct listening l = {.left = -1};
	const char *last = NULL;
	const struct options_rule rules[] = {
		{"last", 0, OPTIONS_TEXT, &last, "SEQUENCE",
		    "those behind that one"},
		{"count", 'n', OPTIONS_WHOLE, &l.left, "N",
		    "end after so many"},
		{0}
	};
	int count, status;

	if (!command_start(s, self, rules, argc, argv, 1, 1, &count, &status))
		return status;
	if (blobfield_events(s->client, argv[0], last, print_event, &l) !=
	    BLOBFIELD_OK)
		status = command_fail(s, false);
	return status;
}
