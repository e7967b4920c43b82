/*
 * libmicrohttpd's side: listening, framing checks, bodies, deadlines.
 */
#ifndef SERVER_HTTP_H
#define SERVER_HTTP_H

#include <stdbool.h>
#include <stddef.h>

#include "core/err.h"

struct exchange;
struct http;
struct server;

#define HTTP_URL_MAX 300
#define HTTP_NO_DEADLINE 1e300

/* What is read at a time of an answer that leaves as it is made: large enough
 * for few system calls, small enough to stay in a core's cache on its way. */
#define HTTP_STREAM_BLOCK ((size_t)128 << 10)

/*
 * Listens where the service manager does, else as server->config says, as
 * server->http, for http_stop; nothing is answered yet. Raises the limit of
 * open files to what --max-connections needs. url gets "http://HOST:PORT" with
 * the real port; https if there is server->tls. ERR_IO, ERR_INVALID (the log
 * says why), ERR_MEMORY.
 */
enum err http_listen(struct server *server, char url[static HTTP_URL_MAX]);

/* Begins to serve. ERR_IO: the log says why. */
enum err http_start(struct http *h);

/* Takes no more connections, and closes the listener, before it returns; the
 * connections that there are stay. */
void http_quiesce(struct http *h);

/* Requests that have arrived and whose answer has not gone out, and requests
 * begun in all. */
size_t http_owed(struct http *h);
size_t http_active(struct http *h);

/* Connections that are open. */
size_t http_connections(struct http *h);

/* Connections that were refused, since the start: too many of one address. */
size_t http_refused(struct http *h);

/* Shuts connections whose deadline has passed, or whose client hung up in the
 * middle of a request. Call about once a second. */
void http_reap(struct http *h);

/* Shuts connections whose answers leave as they are made, but of which the
 * client has taken nothing for so many seconds. */
void http_cut_stalled(struct http *h, double seconds);

/* Closes everything. No exchange may be waiting. NULL does nothing. */
void http_stop(struct http *h);

/*
 * For exchanges whose request has arrived: when (clock_seconds) the connection
 * is shut if the answer has not left by then. Before that the deadline is
 * --request-time behind the request line, and a second more for every 16 KiB of
 * the body that have arrived.
 */
void http_set_deadline(struct exchange *x, double when);

/* When an answer of so many bytes that begins to leave now must have left: 60 s
 * and one for every 16 KiB. */
double http_answer_deadline(size_t bytes);

/*
 * Whether the client is seen to have hung up. Of a plain connection: it has
 * ended its side, and there is nothing unread; of TLS: it has ended its side.
 * Any thread, as long as x is not over.
 */
bool http_client_has_gone(const struct exchange *x);

/*
 * Of an answer that leaves as it is made, so many bytes have been taken. It has
 * 60 s, and a second for every 16 KiB of what has been taken, since x->sending;
 * and 68 s for the next 128 KiB.
 */
void http_note_progress(struct exchange *x, size_t taken);

/* Accounts for body memory; false when all bodies together are too much. */
bool http_take_bytes(struct http *h, size_t bytes);
void http_return_bytes(struct http *h, size_t bytes);

/* The same for a text that was read for an answer and is in memory until that has
 * left, which slow readers decide: apart from bodies, so that those are not refused.
 * Given back at the exchange's end. */
bool http_take_text(struct exchange *x, size_t bytes);
void http_return_text(struct exchange *x);

#endif
