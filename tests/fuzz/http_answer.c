#include "tests/fuzz/http_answer.h"

#include <ctype.h>
#include <math.h>
#include <stdlib.h>
#include <string.h>
#include <strings.h>

#include <cjson/cJSON.h>

#include "proto/arena.h"
#include "proto/fault.h"
#include "proto/json.h"

#define VALUES_MOST 10000000
#define NPY_HEAD 10

static void demand(int fine)
{
	if (!fine)
		abort();
}

struct head {
	const char *type; /* or NULL */
	size_t type_length;
	bool has_length, is_chunked, closes;
	size_t length;
};

static bool is_named(const char *line, size_t length, const char *name)
{
	return length == strlen(name) && strncasecmp(line, name, length) == 0;
}

static size_t read_length(const char *text, size_t length)
{
	size_t n = 0;

	demand(length > 0 && length < 12);
	for (size_t i = 0; i < length; i++) {
		demand(isdigit((unsigned char)text[i]));
		n = 10 * n + (size_t)(text[i] - '0');
	}
	return n;
}

static void take_header(struct head *head, const char *name, size_t n,
    const char *value, size_t length)
{
	if (is_named(name, n, "Content-Length")) {
		demand(!head->has_length);
		head->has_length = true;
		head->length = read_length(value, length);
	} else if (is_named(name, n, "Transfer-Encoding")) {
		demand(!head->is_chunked && is_named(value, length, "chunked"));
		head->is_chunked = true;
	} else if (is_named(name, n, "Content-Type")) {
		demand(head->type == NULL);
		head->type = value;
		head->type_length = length;
	} else if (is_named(name, n, "Connection")) {
		head->closes |= is_named(value, length, "close");
	}
}

/* Lines up to end, each with its CR LF. */
static void read_headers(const char *at, const char *end, struct head *head)
{
	while (at < end) {
		const char *line_end = memmem(at, (size_t)(end - at), "\r\n", 2);
		const char *colon = memchr(at, ':', (size_t)(line_end - at));
		const char *value;

		demand(colon != NULL && colon > at);
		value = colon + 1;
		while (value < line_end && *value == ' ')
			value++;
		for (const char *p = at; p < line_end; p++)
			demand((unsigned char)*p >= ' ' && *p != 127);
		take_header(head, at, (size_t)(colon - at), value,
		    (size_t)(line_end - value));
		at = line_end + 2;
	}
	demand(!head->has_length || !head->is_chunked);
}

static bool is_status(int status)
{
	static const int all[] = {100, 200, 201, 202, 204, 304, 400, 401, 403,
	    404, 405, 406, 409, 411, 412, 413, 414, 415, 417, 421, 422, 429,
	    431, 501, 503, 504, 505, 507};

	for (size_t i = 0; i < sizeof all / sizeof *all; i++)
		if (all[i] == status)
			return true;
	return false;
}

/* ---- bodies ---- */

/* One chunk's size; false: not all of its line is there. */
static bool read_chunk_size(const char **at, const char *end, size_t *size)
{
	const char *line_end = memmem(*at, (size_t)(end - *at), "\r\n", 2);
	size_t digits = 0;

	if (line_end == NULL)
		return false;
	*size = 0;
	for (const char *p = *at; p < line_end; p++, digits++) {
		int c = tolower((unsigned char)*p);

		demand(isxdigit(c) && digits < 8);
		*size = 16 * *size + (size_t)(c <= '9' ? c - '0' : c - 'a' + 10);
	}
	demand(digits > 0);
	*at = line_end + 2;
	return true;
}

static bool join_chunks(const char *at, const char *end,
    struct http_answer *out, const char **behind)
{
	size_t size;

	while (read_chunk_size(&at, end, &size)) {
		if ((size_t)(end - at) < size + 2)
			return false;
		demand(memcmp(at + size, "\r\n", 2) == 0);
		memcpy(out->body + out->body_length, at, size);
		out->body_length += size;
		at += size + 2;
		if (size == 0) {
			*behind = at;
			return true;
		}
	}
	return false;
}

/* False: there is not all of it. */
static bool read_body(const char *at, const char *end,
    const struct head *head, bool is_over, struct http_answer *out,
    const char **behind)
{
	out->body = malloc((size_t)(end - at) + 1);
	demand(out->body != NULL);
	if (head->is_chunked)
		return join_chunks(at, end, out, behind);
	if (head->has_length && (size_t)(end - at) < head->length)
		return false;
	if (!head->has_length && !is_over)
		return false;
	out->body_length = head->has_length ? head->length :
	    (size_t)(end - at);
	memcpy(out->body, at, out->body_length);
	*behind = at + out->body_length;
	return true;
}

/* ---- what is in them ---- */

static void check_json(const struct http_answer *a, bool is_problem)
{
	struct arena arena = {0};
	struct faults faults = {0};
	const cJSON *status;
	cJSON *json;

	demand(json_parse(a->body, a->body_length, VALUES_MOST, &arena, &json,
	    &faults) == ERR_OK);
	status = cJSON_GetObjectItemCaseSensitive(json, "status");
	if (is_problem)
		demand(cJSON_IsNumber(status) &&
		    status->valuedouble == a->status);
	arena_fini(&arena);
}

static void check_floats(const char *at, size_t length)
{
	float value;

	demand(length % sizeof value == 0);
	for (; length > 0; length -= sizeof value, at += sizeof value) {
		memcpy(&value, at, sizeof value);
		demand(isfinite(value));
	}
}

static void check_npy(const char *at, size_t length)
{
	size_t head;

	demand(length >= NPY_HEAD && memcmp(at, "\x93NUMPY\1", 7) == 0);
	head = NPY_HEAD + (unsigned char)at[8] +
	    ((size_t)(unsigned char)at[9] << 8);
	demand(head <= length && head % 64 == 0);
	check_floats(at + head, length - head);
}

static bool is_type(const struct head *head, const char *type)
{
	return head->type != NULL && head->type_length >= strlen(type) &&
	    strncmp(head->type, type, strlen(type)) == 0;
}

static void check_body(const struct head *head, const struct http_answer *a)
{
	bool is_problem = is_type(head, "application/problem+json");

	if (is_problem || is_type(head, "application/json"))
		check_json(a, is_problem);
	else if (is_type(head, "application/octet-stream"))
		check_floats(a->body, a->body_length);
	else if (is_type(head, "application/x-npy"))
		check_npy(a->body, a->body_length);
	else if (is_type(head, "image/png"))
		demand(a->body_length > 8 &&
		    memcmp(a->body, "\x89PNG\r\n\x1a\n", 8) == 0);
}

bool http_answer_read(const char *bytes, size_t length, bool is_head,
    bool is_over, struct http_answer *out)
{
	const char *end = bytes + length, *body, *behind = NULL;
	const char *line_end = memmem(bytes, length, "\r\n", 2);
	const char *head_end = memmem(bytes, length, "\r\n\r\n", 4);
	struct head head = {0};

	if (head_end == NULL)
		return false;
	*out = (struct http_answer){0};
	demand(length > 13 && memcmp(bytes, "HTTP/1.1 ", 9) == 0);
	for (int i = 9; i < 12; i++) {
		demand(isdigit((unsigned char)bytes[i]));
		out->status = 10 * out->status + (bytes[i] - '0');
	}
	demand(bytes[12] == ' ' && is_status(out->status));
	read_headers(line_end + 2, head_end + 2, &head);
	body = behind = head_end + 4;
	out->closes = head.closes;
	out->is_stream = is_type(&head, "text/event-stream") && !is_head;
	if (!is_head && !out->is_stream && out->status >= 200 &&
	    out->status != 204 && out->status != 304) {
		if (!read_body(body, end, &head, is_over, out, &behind)) {
			free(out->body);
			out->body = NULL;
			return false;
		}
		check_body(&head, out);
	}
	out->length = (size_t)(behind - bytes);
	return true;
}
