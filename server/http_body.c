/*
 * Bodies as they arrive: kept, fed to a sink, dropped, or refused midway; and
 * the memory that all of them take.
 */
#include "server/http_internal.h"

#include <gnutls/gnutls.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/socket.h>

#include "proto/answer.h"
#include "server/config.h"
#include "server/exchange.h"
#include "server/server.h"

/* A body's first allocation, whatever its length is said to be. */
#define BODY_FIRST ((size_t)1 << 20)

/* All bodies together, but at least two of the largest. */
#define BODIES_MAX ((size_t)1 << 30)

/* The same of texts read for answers: each was a body. */
#define TEXTS_MAX ((size_t)256 << 20)

/* ---- body memory ---- */

static bool take_of(const struct http *h, atomic_size_t *taken, size_t most,
    size_t bytes)
{
	const size_t body = h->server->config->max_body;

	most = body > most / 2 ? 2 * body : most;
	if (atomic_fetch_add(taken, bytes) + bytes <= most)
		return true;
	atomic_fetch_sub(taken, bytes);
	return false;
}

bool http_take_bytes(struct http *h, size_t bytes)
{
	return take_of(h, &h->bytes, BODIES_MAX, bytes);
}

void http_return_bytes(struct http *h, size_t bytes)
{
	atomic_fetch_sub(&h->bytes, bytes);
}

bool http_take_text(struct exchange *x, size_t bytes)
{
	struct http *h = x->server->http;

	if (!take_of(h, &h->texts, TEXTS_MAX, bytes))
		return false;
	x->text_size += bytes;
	return true;
}

void http_return_text(struct exchange *x)
{
	atomic_fetch_sub(&x->server->http->texts, x->text_size);
	x->text_size = 0;
}

/* ---- bodies ---- */

/*
 * Sends text past libmicrohttpd, and that there is no more. Nothing of it waits
 * to be sent itself, and this is the connection's thread: its TLS session may
 * be used. What does not fit the socket's buffer is lost.
 */
static bool send_last(struct exchange *x, const char *text, size_t length)
{
	const union MHD_ConnectionInfo *info;
	ssize_t n;

	if (x->server->tls == NULL) {
		n = send(x->socket, text, length, MSG_NOSIGNAL | MSG_DONTWAIT);
	} else {
		info = MHD_get_connection_info(x->connection,
		    MHD_CONNECTION_INFO_GNUTLS_SESSION);
		n = gnutls_record_send(info->tls_session, text, length);
		gnutls_bye(info->tls_session, GNUTLS_SHUT_WR);
	}
	shutdown(x->socket, SHUT_WR);
	return n == (ssize_t)length;
}

/*
 * Answers in the middle of a body, which libmicrohttpd cannot: the answer goes
 * straight to the socket, and the rest of the body is read and dropped, for a
 * while, so that the answer is not lost to a reset.
 */
static void refuse_midway(struct exchange *x, enum problem problem,
    const char *detail)
{
	const struct problem_kind *kind = problem_kind(problem);
	char retry[40] = "", message[2048], plain[PROBLEM_TEXT_MAX], *json;
	const char *text;
	size_t length;
	int n;

	x->refused_midway = true;
	x->problem = problem;
	x->status = (unsigned)kind->status;
	exchange_release_body(x);
	if (kind->retry_after > 0)
		snprintf(retry, sizeof retry, "Retry-After: %d\r\n",
		    kind->retry_after);
	json = answer_problem(kind->status, kind->slug, kind->title, detail,
	    NULL, &length);
	text = json;
	if (json == NULL) {
		length = problem_print(kind, plain);
		text = plain;
	}
	n = snprintf(message, sizeof message, "HTTP/1.1 %d %s\r\n"
	    "Content-Type: %s\r\nContent-Length: %zu\r\n%sX-Request-Id: %s\r\n"
	    "Connection: close\r\n\r\n%.*s", kind->status, kind->title,
	    media_name(MEDIA_PROBLEM), length, retry, x->request_id,
	    (int)length, text);
	if (n > 0 && (size_t)n < sizeof message &&
	    send_last(x, message, (size_t)n))
		x->answer_length = length;
	free(json);
}

/* Room for length bytes more, never more than twice what has arrived. */
static bool make_room(struct exchange *x, size_t length)
{
	size_t need = x->body_length + length;
	size_t size = x->body_size > 0 ? 2 * x->body_size : BODY_FIRST;
	size_t most = x->server->config->max_body;
	char *body;

	if (need <= x->body_size)
		return true;
	if (x->promised > 0)
		most = x->promised;
	size = size > most ? most : size;
	size = size < need ? need : size;
	if (!http_take_bytes(x->server->http, size - x->body_size))
		return false;
	body = realloc(x->body, size);
	if (body == NULL) {
		http_return_bytes(x->server->http, size - x->body_size);
		return false;
	}
	x->body = body;
	x->body_size = size;
	return true;
}

/* Keeps what has arrived; false: there is no room. */
static bool keep(struct exchange *x, const char *data, size_t length)
{
	if (!make_room(x, length))
		return false;
	memcpy(x->body + x->body_length, data, length);
	x->body_length += length;
	return true;
}

/* The same with a sink, which has room by itself, but must not have all. */
static bool feed(struct exchange *x, const char *data, size_t length)
{
	struct sink *sink = x->sink;
	size_t size;

	if (x->is_fed_up)
		return true;
	x->is_fed_up = !sink->feed(sink, data, length);
	size = sink->bytes(sink);
	if (size > x->body_size &&
	    !http_take_bytes(x->server->http, size - x->body_size))
		return false;
	if (size < x->body_size)
		http_return_bytes(x->server->http, x->body_size - size);
	x->body_size = size;
	return true;
}

/* Of a body that has its answer already, nothing is kept. */
static bool take(struct exchange *x, const char *data, size_t length)
{
	if (x->response != NULL)
		return true;
	return x->sink != NULL ? feed(x, data, length) :
	    keep(x, data, length);
}

enum MHD_Result body_take(struct exchange *x, const char *data, size_t length)
{
	size_t most = x->server->config->max_body;
	char detail[100];

	x->body_seen += length;
	if (x->refused_midway || x->discard)
		return x->body_seen > 2 * most ? MHD_NO : MHD_YES;
	connection_set(x->server->http, x->connection, STAGE_BODY, x->begun +
	    (double)x->server->config->request_time +
	    (double)x->body_seen / LEAST_BYTES_PER_SECOND);
	if (x->body_seen > most) {
		snprintf(detail, sizeof detail, "The body has more than the "
		    "%zu bytes that this server takes.", most);
		refuse_midway(x, PROBLEM_TOO_LARGE, detail);
	} else if (!take(x, data, length)) {
		refuse_midway(x, PROBLEM_MEMORY,
		    "Too many large bodies are arriving at once.");
	}
	return MHD_YES;
}

