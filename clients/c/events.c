/*
 * Changes of a scene: making them by patches, and hearing of them by
 * server-sent events (WHATWG HTML, 9.2).
 */
#include <stdlib.h>
#include <string.h>

#include <cjson/cJSON.h>

#include "clients/c/client.h"

/* ---- patches ---- */

/* By its first character that is no white space (RFC 8259, 2). */
static const char *type_of(const char *patch, size_t size)
{
	size_t i = 0;

	while (i < size && patch[i] != '\0' &&
	    strchr(" \t\r\n", patch[i]) != NULL)
		i++;
	return i < size && patch[i] == '[' ? "application/json-patch+json" :
	    "application/merge-patch+json";
}

/* name, which ends with what is before text; false: text can stand in no
 * header. */
static bool make_line(char *out, size_t size, const char *name,
    const char *text)
{
	int length;

	for (const char *at = text; *at != '\0'; at++)
		if (*at <= ' ' || *at > '~' || *at == '"')
			return false;
	length = snprintf(out, size, "%s%s", name, text);
	return length >= 0 && (size_t)length < size;
}

enum blobfield_outcome blobfield_patch(struct blobfield *b, const char *id,
    const char *patch, size_t size, const char *if_match,
    char tag[BLOBFIELD_TAG_MAX])
{
	char path[CLIENT_PATH_MAX], line[BLOBFIELD_TAG_MAX + 32];
	enum blobfield_outcome outcome = client_path(b, path, id, "");

	if (outcome == BLOBFIELD_OK && if_match != NULL) {
		if (!make_line(line, sizeof line - 1, "If-Match: \"",
		    if_match)) {
			b->transfer.status = 0;
			return client_fail(b, BLOBFIELD_ARGUMENT,
			    "'%.80s' is no revision", if_match);
		}
		strcat(line, "\"");
	}
	if (outcome == BLOBFIELD_OK)
		outcome = client_do(b, &(struct transfer_request){
			.method = "PATCH",
			.path = path,
			.type = type_of(patch, size),
			.line = if_match != NULL ? line : NULL,
			.body = patch,
			.size = size
		});
	if (outcome == BLOBFIELD_OK && tag != NULL)
		outcome = client_read_summary(b, "revision", tag,
		    BLOBFIELD_TAG_MAX);
	return outcome;
}

/* ---- events ---- */

/* Seconds without a line after which a connection is broken: the daemon sends
 * one every 15 s. And those before the next one, unless it says how many. */
#define SILENCE_SECONDS 40.0
#define PAUSE_SECONDS 2.0
#define PAUSE_SECONDS_MAX 60.0

#define LINE_MAX_SIZE 4096

struct listener {
	int (*event)(void *ctx, const struct blobfield_event *event);
	void *ctx;
	char last[BLOBFIELD_SEQUENCE_MAX];
	double pause;
	bool has_begun, is_over;

	/* of the present connection */
	char line[LINE_MAX_SIZE];
	size_t length;
	char kind[16], id[BLOBFIELD_SEQUENCE_MAX];
	char data[LINE_MAX_SIZE];
};

/* seconds, but not less than least, nor more than there may be. */
static double within(double seconds, double least)
{
	if (!(seconds > least))
		return least;
	return seconds < PAUSE_SECONDS_MAX ? seconds : PAUSE_SECONDS_MAX;
}

static void copy_text(const cJSON *json, const char *name, char *out,
    size_t size)
{
	const char *text = cJSON_GetStringValue(cJSON_GetObjectItem(json,
	    name));

	snprintf(out, size, "%s", text != NULL ? text : "");
}

static size_t size_of(const cJSON *json, const char *name)
{
	const cJSON *item = cJSON_GetObjectItem(json, name);

	return cJSON_IsNumber(item) && item->valuedouble >= 0.0 &&
	    item->valuedouble < 0x1p53 ? (size_t)item->valuedouble : 0;
}

/* What an empty line ends. */
static enum blobfield_outcome tell(struct listener *l)
{
	struct blobfield_event event = {.is_deletion =
	    strcmp(l->kind, "deleted") == 0};
	cJSON *json = NULL;

	if (!event.is_deletion && strcmp(l->kind, "revision") != 0)
		return BLOBFIELD_OK;
	json = cJSON_Parse(l->data);
	if (!cJSON_IsObject(json)) {
		cJSON_Delete(json);
		return BLOBFIELD_STRANGE;
	}
	event.has_missed = cJSON_IsTrue(cJSON_GetObjectItem(json, "missed"));
	copy_text(json, "sequence", event.sequence, sizeof event.sequence);
	copy_text(json, "revision", event.revision, sizeof event.revision);
	copy_text(json, "time", event.time, sizeof event.time);
	event.nodes = size_of(json, "nodes");
	event.bytes = size_of(json, "bytes");
	cJSON_Delete(json);
	snprintf(l->last, sizeof l->last, "%s",
	    l->id[0] != '\0' ? l->id : event.sequence);
	l->is_over = l->event(l->ctx, &event) != 0 || event.is_deletion;
	return l->is_over ? BLOBFIELD_CANCELLED : BLOBFIELD_OK;
}

/* "name: value", a comment, which has no name, or nothing. */
static enum blobfield_outcome read_line(struct listener *l)
{
	enum blobfield_outcome outcome = BLOBFIELD_OK;
	char *value = l->line + strcspn(l->line, ":");

	if (l->line[0] == '\0') {
		outcome = tell(l);
		l->kind[0] = l->id[0] = l->data[0] = '\0';
		return outcome;
	}
	if (*value == ':')
		*value++ = '\0';
	value += *value == ' ';
	if (strcmp(l->line, "event") == 0)
		snprintf(l->kind, sizeof l->kind, "%s", value);
	else if (strcmp(l->line, "id") == 0)
		snprintf(l->id, sizeof l->id, "%s", value);
	else if (strcmp(l->line, "retry") == 0)
		l->pause = within(atof(value) / 1000.0, 0.05);
	else if (strcmp(l->line, "data") == 0) {
		/* Lines of it may be joined by anything that is white space to
		 * JSON. */
		const size_t had = strlen(l->data);

		if (had + strlen(value) + 2 > sizeof l->data)
			return BLOBFIELD_STRANGE;
		snprintf(l->data + had, sizeof l->data - had, "%s\n", value);
	}
	return outcome;
}

static enum blobfield_outcome take(void *ctx, const char *data, size_t n)
{
	struct listener *l = ctx;
	enum blobfield_outcome outcome = BLOBFIELD_OK;

	l->has_begun = true;
	for (size_t i = 0; i < n && outcome == BLOBFIELD_OK; i++) {
		if (data[i] != '\n') {
			if (l->length == sizeof l->line - 1)
				return BLOBFIELD_STRANGE;
			l->line[l->length++] = data[i];
			continue;
		}
		l->length -= l->length > 0 && l->line[l->length - 1] == '\r';
		l->line[l->length] = '\0';
		l->length = 0;
		outcome = read_line(l);
	}
	return outcome;
}

static enum blobfield_outcome listen_once(struct blobfield *b,
    struct listener *l, const char *path)
{
	char line[BLOBFIELD_SEQUENCE_MAX + 32];

	l->length = 0;
	l->kind[0] = l->id[0] = l->data[0] = '\0';
	if (l->last[0] != '\0' && !make_line(line, sizeof line,
	    "Last-Event-ID: ", l->last)) {
		b->transfer.status = 0;
		return client_fail(b, BLOBFIELD_ARGUMENT, "'%.40s' is no "
		    "sequence", l->last);
	}
	return client_do(b, &(struct transfer_request){
		.method = "GET",
		.path = path,
		.accept = "text/event-stream",
		.line = l->last[0] != '\0' ? line : NULL,
		.take = take,
		.ctx = l,
		.silence = SILENCE_SECONDS
	});
}

/* Whether, after that, there is another connection to be tried. */
static bool is_passing(const struct blobfield *b, const struct listener *l,
    enum blobfield_outcome outcome)
{
	const long status = b->error.status;

	return l->has_begun && (outcome == BLOBFIELD_OK ||
	    outcome == BLOBFIELD_UNREACHABLE || (outcome == BLOBFIELD_REFUSED &&
	    (status == 429 || status >= 500)));
}

enum blobfield_outcome blobfield_events(struct blobfield *b, const char *id,
    const char *last,
    int (*event)(void *ctx, const struct blobfield_event *event), void *ctx)
{
	struct listener l = {.event = event, .ctx = ctx,
	    .pause = PAUSE_SECONDS};
	char path[CLIENT_PATH_MAX];
	double pause;
	enum blobfield_outcome outcome = client_path(b, path, id, "/events");

	if (outcome != BLOBFIELD_OK)
		return outcome;
	if (last != NULL && strlen(last) >= sizeof l.last) {
		b->transfer.status = 0;
		return client_fail(b, BLOBFIELD_ARGUMENT, "'%.40s' is no "
		    "sequence", last);
	}
	snprintf(l.last, sizeof l.last, "%s", last != NULL ? last : "");
	for (;;) {
		outcome = listen_once(b, &l, path);
		if (l.is_over || (l.has_begun &&
		    outcome == BLOBFIELD_REFUSED && b->error.status == 404))
			return client_fail(b, BLOBFIELD_OK, "%s", "");
		if (!is_passing(b, &l, outcome))
			return outcome;
		/* 0 if there is no such header. */
		pause = within(atof(blobfield_header(b, "retry-after")),
		    l.pause);
		if (transfer_wait(&b->transfer, pause) != BLOBFIELD_OK)
			return client_fail(b, BLOBFIELD_CANCELLED, "given up");
	}
}
