#include "tests/support/sse.h"

#include <errno.h>
#include <poll.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/socket.h>
#include <time.h>
#include <unistd.h>

#include "tests/support/load.h"

static double now(void)
{
	struct timespec t;

	clock_gettime(CLOCK_MONOTONIC, &t);
	return (double)t.tv_sec + 1e-9 * (double)t.tv_nsec;
}

static void append(char **to, size_t *length, size_t *size, const char *data,
    size_t n)
{
	if (*length + n + 1 > *size) {
		*size = 2 * (*length + n + 1);
		*to = realloc(*to, *size);
		if (*to == NULL)
			abort();
	}
	memcpy(*to + *length, data, n);
	*length += n;
	(*to)[*length] = '\0';
}

static void drop(char *text, size_t *length, size_t n)
{
	*length -= n;
	memmove(text, text + n, *length + 1);
}

/* Reads what the socket has, waiting for it until end. False: nothing came. */
static bool fill(struct sse *s, double end)
{
	struct pollfd p = {.fd = s->fd, .events = POLLIN};
	double left = 1e3 * (end - now());
	char data[16384];
	ssize_t n;

	if (s->is_over || s->is_cut || poll(&p, 1, left > 0.0 ? (int)left + 1 :
	    0) != 1)
		return false;
	n = recv(s->fd, data, sizeof data, MSG_DONTWAIT);
	if (n > 0)
		append(&s->raw, &s->raw_length, &s->raw_size, data, (size_t)n);
	else if (n == 0 || errno != EAGAIN)
		s->is_cut = true;
	return n > 0;
}

/* Takes the next piece of a chunk, or its head, off raw. False: raw has none. */
static bool take_chunk(struct sse *s)
{
	char *line;
	size_t n;

	if (s->is_over || s->raw_length == 0)
		return false;
	if (s->chunk > 0) {
		n = s->chunk < s->raw_length ? s->chunk : s->raw_length;
		append(&s->text, &s->text_length, &s->text_size, s->raw, n);
		drop(s->raw, &s->raw_length, n);
		s->chunk -= n;
		return true;
	}
	/* Behind a chunk comes an empty line. */
	line = strstr(s->raw + (s->is_inside && s->raw_length >= 2 ? 2 : 0),
	    "\r\n");
	if (line == NULL || (s->is_inside && s->raw_length < 3))
		return false;
	s->chunk = strtoul(s->raw + (s->is_inside ? 2 : 0), NULL, 16);
	s->is_inside = true;
	s->is_over = s->chunk == 0;
	drop(s->raw, &s->raw_length, (size_t)(line + 2 - s->raw));
	return true;
}

static void read_field(struct sse *s, const char *line, struct sse_event *out)
{
	const char *value = strchr(line, ':');
	const size_t n = value != NULL ? (size_t)(value - line) : strlen(line);

	value = value != NULL ? value + 1 + (value[1] == ' ') : "";
	if (n == 0) {
		out->is_comment = true;
		snprintf(out->data, sizeof out->data, "%s", value);
	} else if (strncmp(line, "id", n) == 0) {
		snprintf(out->id, sizeof out->id, "%s", value);
	} else if (strncmp(line, "event", n) == 0) {
		snprintf(out->event, sizeof out->event, "%s", value);
	} else if (strncmp(line, "data", n) == 0) {
		snprintf(out->data, sizeof out->data, "%s", value);
	} else if (strncmp(line, "retry", n) == 0) {
		s->retry = atoi(value);
	}
}

/* Reads the block of lines at text's beginning up to end into *out; false: it
 * is neither an event nor a comment. */
static bool read_block(struct sse *s, char *end, struct sse_event *out)
{
	char *line = s->text, *next;

	memset(out, 0, sizeof *out);
	strcpy(out->event, "message");
	for (; line < end; line = next + 1) {
		next = strchr(line, '\n');
		*next = '\0';
		read_field(s, line, out);
	}
	drop(s->text, &s->text_length, (size_t)(end + 1 - s->text));
	return out->data[0] != '\0';
}

enum sse_outcome sse_next(struct sse *s, struct sse_event *out,
    int milliseconds)
{
	double end = now() + 1e-3 * milliseconds;

	for (;;) {
		char *blank;

		while (take_chunk(s))
			;
		blank = s->text != NULL ? strstr(s->text, "\n\n") : NULL;
		if (blank != NULL) {
			if (read_block(s, blank + 1, out))
				return SSE_EVENT;
		} else if (!fill(s, end)) {
			return s->is_over ? SSE_END : s->is_cut ? SSE_CUT :
			    SSE_NOTHING;
		}
	}
}

bool sse_open(struct sse *s, int port, const char *path, const char *headers)
{
	double end = now() + 5.0;
	char request[1024], *blank = NULL;
	size_t n;

	memset(s, 0, sizeof *s);
	s->fd = load_connect(port);
	if (s->fd < 0)
		return false;
	n = (size_t)snprintf(request, sizeof request, "GET %s HTTP/1.1\r\n"
	    "Host: 127.0.0.1\r\nAccept: text/event-stream\r\n%s\r\n", path,
	    headers);
	if (send(s->fd, request, n, MSG_NOSIGNAL) != (ssize_t)n)
		return false;
	while (blank == NULL && fill(s, end))
		blank = strstr(s->raw, "\r\n\r\n");
	if (blank == NULL)
		return false;
	sscanf(s->raw, "HTTP/1.1 %d", &s->status);
	n = s->status == 200 ? (size_t)(blank + 4 - s->raw) : s->raw_length;
	snprintf(s->head, sizeof s->head, "%.*s", (int)n, s->raw);
	drop(s->raw, &s->raw_length, n);
	return s->status == 200;
}

void sse_close(struct sse *s)
{
	if (s->fd >= 0)
		close(s->fd);
	s->fd = -1;
	free(s->raw);
	free(s->text);
	s->raw = s->text = NULL;
}
