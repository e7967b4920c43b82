#include "server/exchange.h"

#include <microhttpd.h>
#include <stdarg.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <strings.h>

#include <cjson/cJSON.h>

#include "proto/answer.h"
#include "server/clock.h"
#include "server/http.h"
#include "server/json_memory.h"
#include "server/server.h"

/* ---- the request ---- */

struct lookup {
	const char *name;
	const char *first;
	char *joined; /* once there are two */
	size_t count;
};

static char *join(const char *a, const char *b)
{
	char *both;

	return asprintf(&both, "%s, %s", a, b) < 0 ? NULL : both;
}

static enum MHD_Result look_at(void *ctx, enum MHD_ValueKind kind,
    const char *key, const char *value)
{
	struct lookup *lookup = ctx;
	char *joined;

	(void)kind;
	if (strcasecmp(key, lookup->name) != 0 || value == NULL)
		return MHD_YES;
	if (lookup->count++ == 0) {
		lookup->first = value;
		return MHD_YES;
	}
	joined = join(lookup->joined ? lookup->joined : lookup->first, value);
	if (joined != NULL) {
		free(lookup->joined);
		lookup->joined = joined;
	}
	return MHD_YES;
}

const char *exchange_header(struct exchange *x, const char *name)
{
	struct lookup lookup = {name, NULL, NULL, 0};

	MHD_get_connection_values(x->connection, MHD_HEADER_KIND, look_at,
	    &lookup);
	if (lookup.joined == NULL)
		return lookup.first;
	for (int i = 0; i < EXCHANGE_JOINED_MAX; i++) {
		if (x->joined[i] == NULL)
			return x->joined[i] = lookup.joined;
	}
	free(lookup.joined);
	return lookup.first;
}

const char *exchange_query(struct exchange *x, const char *name)
{
	const char *value = NULL;
	size_t length;

	if (MHD_lookup_connection_value_n(x->connection,
	    MHD_GET_ARGUMENT_KIND, name, strlen(name), &value, &length) !=
	    MHD_YES)
		return NULL;
	return value != NULL ? value : "";
}

void exchange_release_body(struct exchange *x)
{
	http_return_bytes(x->server->http, x->body_size);
	if (x->sink != NULL)
		x->sink->free(x->sink);
	x->sink = NULL;
	free(x->body);
	x->body = NULL;
	x->body_length = x->body_size = 0;
}

/* 415; known: the types that would do. */
static void refuse_type(struct exchange *x, const char *type,
    const char *known)
{
	static const char form[] = "application/x-www-form-urlencoded";

	if (type == NULL || type[strspn(type, " \t")] == '\0')
		exchange_reply_problem(x, PROBLEM_MEDIA_TYPE, NULL,
		    "There is no Content-Type: say what the body is; this "
		    "resource takes %s.", known);
	else if (strncasecmp(type, form, sizeof form - 1) == 0)
		exchange_reply_problem(x, PROBLEM_MEDIA_TYPE, NULL,
		    "Content-Type is '%.100s'; this resource takes %s. With "
		    "curl, use --json, or add -H 'Content-Type: "
		    "application/json'.", type, known);
	else
		exchange_reply_problem(x, PROBLEM_MEDIA_TYPE, NULL,
		    "Content-Type is '%.100s'; this resource takes %s.", type,
		    known);
}

bool exchange_check_content_type(struct exchange *x, unsigned mask,
    enum media_type *out)
{
	const char *value = exchange_header(x, "Content-Type");
	enum media_type type;
	char known[128] = "";

	if (media_from_content_type(value, &type) && (mask & 1u << type)) {
		*out = type;
		return true;
	}
	for (int i = 0; i < MEDIA_COUNT; i++) {
		size_t length = strlen(known);

		if (mask & 1u << i)
			snprintf(known + length, sizeof known - length, "%s%s",
			    length > 0 ? ", " : "",
			    media_name((enum media_type)i));
	}
	refuse_type(x, value, known);
	exchange_add_header(x, "Accept", known);
	return false;
}

/* ---- waiting ---- */

/* Has x, whose connection is not suspended yet, wait for exchange_resume. */
static void suspend(struct exchange *x)
{
	atomic_store(&x->parties, 1);
	http_set_deadline(x, HTTP_NO_DEADLINE);
	MHD_suspend_connection(x->connection);
}

bool exchange_is_late(const struct exchange *x)
{
	const double closed = atomic_load(&x->server->closed);

	return closed > 0.0 && x->arrived > closed;
}

void exchange_wait(struct exchange *x)
{
	if (x->is_away) {
		x->waits_again = true;
		atomic_fetch_add(&x->parties, 1);
		return;
	}
	x->waiting = true;
	suspend(x);
}

void exchange_resume(struct exchange *x)
{
	/* Else its handler has not returned yet. */
	if (atomic_fetch_sub(&x->parties, 1) == 1)
		MHD_resume_connection(x->connection);
}

void exchange_take_over(struct exchange *x)
{
	x->is_away = true;
	x->waits_again = false;
}

static void resumed_with_answer(struct exchange *x)
{
	(void)x;
}

void exchange_hand_back(struct exchange *x)
{
	x->is_away = false;
	if (!x->waits_again)
		x->resumed = resumed_with_answer;
	exchange_resume(x);
}

void exchange_pause(struct exchange *x)
{
	x->paused = clock_seconds();
	suspend(x);
}

bool exchange_is_connected(const struct exchange *x)
{
	return !http_client_has_gone(x);
}

/* ---- the answer ---- */

static void reply(struct exchange *x, unsigned status,
    struct MHD_Response *response, size_t length)
{
	if (x->response != NULL)
		MHD_destroy_response(x->response);
	x->response = response;
	x->status = status;
	x->problem = PROBLEM_COUNT;
	x->answer_length = length;
}

void exchange_add_header(struct exchange *x, const char *name,
    const char *value)
{
	if (x->response != NULL)
		MHD_add_response_header(x->response, name, value);
}

void exchange_reply_data(struct exchange *x, unsigned status,
    enum media_type type, void *data, size_t length)
{
	struct MHD_Response *response =
	    MHD_create_response_from_buffer_with_free_callback(length, data,
	    free);

	if (response == NULL)
		free(data);
	reply(x, status, response, length);
	exchange_add_header(x, "Content-Type", media_content_type(type));
}

void exchange_reply_json(struct exchange *x, unsigned status,
    struct cJSON *json)
{
	char *text = cJSON_PrintUnformatted(json);
	size_t length;
	char *line;

	cJSON_Delete(json);
	/* Without memory the tree may lack members. */
	if (json_memory_was_short() || text == NULL) {
		free(text);
		exchange_reply_problem(x, PROBLEM_MEMORY, NULL,
		    "There was no memory for the answer.");
		return;
	}
	/* A newline at the end is kind to terminals. */
	length = strlen(text);
	line = realloc(text, length + 2);
	if (line != NULL) {
		text = line;
		text[length++] = '\n';
	}
	exchange_reply_data(x, status, MEDIA_JSON, text, length);
}

struct two {
	void *header, *data;
};

static void free_two(void *ctx)
{
	struct two *two = ctx;

	free(two->header);
	free(two->data);
	free(two);
}

void exchange_reply_two(struct exchange *x, enum media_type type,
    const void *header, size_t header_length, void *data, size_t length)
{
	struct two *two = malloc(sizeof *two);
	void *copy = malloc(header_length);
	struct MHD_Response *response = NULL;
	struct MHD_IoVec parts[2] = {{copy, header_length}, {data, length}};

	if (two != NULL && copy != NULL) {
		memcpy(copy, header, header_length);
		*two = (struct two){copy, data};
		response = MHD_create_response_from_iovec(parts,
		    length > 0 ? 2 : 1, free_two, two);
	}
	if (response == NULL) {
		free(copy);
		free(two);
		free(data);
	}
	reply(x, MHD_HTTP_OK, response, header_length + length);
	exchange_add_header(x, "Content-Type", media_content_type(type));
}

void exchange_reply_borrowed(struct exchange *x, unsigned status,
    enum media_type type, const void *data, size_t length,
    void (*release)(void *owner), void *owner)
{
	/* MHD wants a void * but only reads through it. */
	struct MHD_Response *response =
	    MHD_create_response_from_buffer_with_free_callback_cls(length,
	    (void *)(size_t)data, release, owner);

	if (response == NULL)
		release(owner);
	reply(x, status, response, length);
	exchange_add_header(x, "Content-Type", media_content_type(type));
}

/* The time that it waited is not the client's. */
static void end_pause(struct exchange *x)
{
	if (x->paused == 0.0)
		return;
	x->sending += clock_seconds() - x->paused;
	x->paused = 0.0;
}

static ssize_t read_stream(void *ctx, uint64_t at, char *out, size_t size)
{
	struct exchange *x = ctx;
	ptrdiff_t n;

	end_pause(x);
	http_note_progress(x, (size_t)at);
	n = x->stream.read(x->stream.ctx, out, size);
	x->is_cut = n == EXCHANGE_CUT;
	x->answer_length = (size_t)at + (n > 0 ? (size_t)n : 0);
	return n == EXCHANGE_END ? MHD_CONTENT_READER_END_OF_STREAM :
	    n == EXCHANGE_CUT ? MHD_CONTENT_READER_END_WITH_ERROR : n;
}

void exchange_reply_stream(struct exchange *x, enum media_type type,
    const struct exchange_stream *stream)
{
	x->stream = *stream;
	reply(x, MHD_HTTP_OK, MHD_create_response_from_callback(
	    stream->has_length ? stream->length : MHD_SIZE_UNKNOWN,
	    HTTP_STREAM_BLOCK, read_stream, x, NULL), stream->length);
	exchange_add_header(x, "Content-Type", media_content_type(type));
}

void exchange_reply_empty(struct exchange *x, unsigned status)
{
	static char nothing[1];

	reply(x, status, MHD_create_response_from_buffer(0, nothing,
	    MHD_RESPMEM_PERSISTENT), 0);
}

/* Says no more than which kind it is: there is no memory for that. Nothing of
 * it is allocated but by libmicrohttpd. */
static void reply_kind(struct exchange *x, const struct problem_kind *kind)
{
	char text[PROBLEM_TEXT_MAX];
	size_t length = problem_print(kind, text);

	reply(x, (unsigned)kind->status, MHD_create_response_from_buffer(
	    length, text, MHD_RESPMEM_MUST_COPY), length);
	exchange_add_header(x, "Content-Type",
	    media_content_type(MEDIA_PROBLEM));
}

void exchange_reply_problem(struct exchange *x, enum problem problem,
    const struct faults *faults, const char *detail, ...)
{
	const struct problem_kind *kind = problem_kind(problem);
	char text[512], seconds[16];
	size_t length;
	char *json;
	va_list args;

	va_start(args, detail);
	vsnprintf(text, sizeof text, detail, args);
	va_end(args);
	json_memory_was_short(); /* it may be why this is answered */
	json = answer_problem(kind->status, kind->slug, kind->title, text,
	    faults, &length);
	if (json_memory_was_short() || json == NULL) {
		free(json);
		reply_kind(x, kind);
	} else {
		exchange_reply_data(x, (unsigned)kind->status, MEDIA_PROBLEM,
		    json, length);
	}
	x->problem = problem;
	if (kind->retry_after > 0) {
		snprintf(seconds, sizeof seconds, "%d", kind->retry_after);
		exchange_add_header(x, "Retry-After", seconds);
	}
}

void exchange_reply_nothing(struct exchange *x)
{
	x->hung_up = true;
}
