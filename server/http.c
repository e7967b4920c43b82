/*
 * Who owns what: an exchange is made when its request line has arrived and
 * freed only in the completion callback. An exchange that waits is suspended:
 * libmicrohttpd leaves it alone until exchange_resume, then calls the access
 * handler again; or, for one that is paused in the middle of its answer, the
 * answer's reader.
 */
#include "server/http.h"

#include <microhttpd.h>
#include <pthread.h>
#include <stdarg.h>
#include <stdatomic.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <unistd.h>

#include "server/access.h"
#include "server/clock.h"
#include "server/config.h"
#include "server/cors.h"
#include "server/exchange.h"
#include "server/framing.h"
#include "server/handlers.h"
#include "server/host.h"
#include "server/http_accept.h"
#include "server/http_internal.h"
#include "server/json_memory.h"
#include "server/log.h"
#include "server/metrics.h"
#include "server/readers.h"
#include "server/routes.h"
#include "server/server.h"
#include "server/tls.h"

#define THREADS 2

/* The pool a connection keeps its head in. It is cleared for every request:
 * 32 KB cost 4.6 microseconds, 1 MB 64. */
#define CONNECTION_MEMORY ((size_t)32 << 10)

#define URI_MAX 4096

/* Connections that have ended and are not closed yet, at most. */
#define CLOSING_MOST 256

/* ---- exchanges ---- */

static bool has_escaped_nul(const char *text, size_t length)
{
	const char *at = strstr(text, "%00");

	return at != NULL && at < text + length;
}

static void *on_request_line(void *ctx, const char *uri,
    struct MHD_Connection *connection)
{
	struct http *h = ctx;
	struct exchange *x = calloc(1, sizeof *x);
	size_t length = strlen(uri);
	struct connection *c;

	if (x == NULL)
		return NULL;
	x->server = h->server;
	x->connection = connection;
	x->socket = MHD_get_connection_info(connection,
	    MHD_CONNECTION_INFO_CONNECTION_FD)->connect_fd;
	x->begun = clock_seconds();
	x->problem = PROBLEM_COUNT;
	c = connection_find(connection);
	if (c != NULL)
		memcpy(x->peer, c->peer, sizeof c->peer);
	x->target_length = length;
	x->target_end = uri + length;
	x->path_has_nul = has_escaped_nul(uri, strcspn(uri, "?")) ||
	    route_has_odd_escape(uri, strcspn(uri, "?"));
	x->target_has_nul = has_escaped_nul(uri, length);
	for (size_t i = 0; i < length && i < EXCHANGE_TARGET_MAX - 1; i++)
		x->target[i] = uri[i] > ' ' && uri[i] < 127 ? uri[i] : '?';
	for (size_t i = 0; i < length; i++)
		x->target_is_odd |= (unsigned char)uri[i] <= ' ' ||
		    uri[i] == 127;
	atomic_fetch_add(&h->active, 1);
	connection_set(h, connection, STAGE_HEAD, x->begun +
	    (double)h->server->config->request_time);
	return x;
}

static void log_exchange(const struct exchange *x)
{
	bool is_probe = x->route != NULL && x->route->is_probe;
	const struct log_request request = {
		.method = x->method != NULL ? x->method : "-",
		.target = x->target,
		.peer = x->peer,
		.token = access_owner(x),
		.request_id = x->request_id,
		.trace_id = x->trace_id,
		.parent_id = x->parent_id,
		.forwarded_for = x->forwarded_for,
		.status = x->status,
		.bytes_in = x->body_seen,
		.bytes_out = x->answer_length,
		.seconds = clock_seconds() - x->begun,
		.is_cut = x->is_cut,
	};

	log_request(is_probe ? LOG_DEBUG : LOG_INFO, &request);
	metrics_count_exchange(x->server->metrics, x, request.seconds);
}

static void on_complete(void *ctx, struct MHD_Connection *connection,
    void **request, enum MHD_RequestTerminationCode code)
{
	struct http *h = ctx;
	struct exchange *x = *request;
	const union MHD_ConnectionInfo *info;
	bool owed;

	(void)code;
	if (x == NULL)
		return;
	owed = x->owed;
	*request = NULL;
	/* Of a head that libmicrohttpd has refused by itself. */
	info = MHD_get_connection_info(connection,
	    MHD_CONNECTION_INFO_HTTP_STATUS);
	if (x->status == 0 && info != NULL)
		x->status = info->http_status;
	/* The body of a request that is complete was counted then. */
	access_count_bytes(x, x->answer_length +
	    (x->arrived == 0.0 ? x->body_seen : 0));
	log_exchange(x);
	access_release(x);
	if (x->state != NULL)
		x->state_free(x->state, x->server);
	exchange_release_body(x);
	http_return_text(x);
	if (x->response != NULL)
		MHD_destroy_response(x->response);
	for (int i = 0; i < EXCHANGE_JOINED_MAX; i++)
		free(x->joined[i]);
	free(x);
	/* For the next request line, or to find the connection idle. */
	connection_set(h, connection, STAGE_IDLE, clock_seconds() +
	    INACTIVITY_SECONDS);
	if (owed)
		atomic_fetch_sub(&h->owed, 1);
	atomic_fetch_sub(&h->active, 1);
}

/* From here on the client is owed an answer. */
static void owe(struct exchange *x)
{
	if (!x->owed)
		atomic_fetch_add(&x->server->http->owed, 1);
	x->owed = true;
}

/* Sends the answer that x has. */
static enum MHD_Result send_answer(struct exchange *x)
{
	enum MHD_Result result;

	if (x->hung_up || x->response == NULL)
		return MHD_NO;
	owe(x);
	if (atomic_load(&x->server->draining))
		exchange_add_header(x, "Connection", "close");
	cors_add_headers(x);
	trace_add_headers(x);
	x->sending = clock_seconds();
	http_set_deadline(x, http_answer_deadline(x->stream.read != NULL ? 0 :
	    x->answer_length));
	result = MHD_queue_response(x->connection, x->status, x->response);
	MHD_destroy_response(x->response);
	x->response = NULL;
	return result;
}

/* ---- the first callback ---- */

struct query_check {
	struct exchange *x;
	unsigned seen; /* a bit for each parameter of the route */
	bool good;
};

static enum MHD_Result check_parameter(void *ctx, enum MHD_ValueKind kind,
    const char *key, const char *value)
{
	struct query_check *check = ctx;
	const struct route *route = check->x->route;
	int index = route_query_index(route, key);

	(void)kind, (void)value;
	if (index >= 0 && !(check->seen & 1u << index)) {
		check->seen |= 1u << index;
		return MHD_YES;
	}
	check->good = false;
	if (index >= 0)
		exchange_reply_problem(check->x, PROBLEM_MALFORMED, NULL,
		    "There is more than one query parameter '%s'.", key);
	else
		exchange_reply_problem(check->x, PROBLEM_MALFORMED, NULL,
		    "Unknown query parameter '%.60s'; known here:%s.", key,
		    route->query[0] != '\0' ? route->query : " none");
	return MHD_NO;
}

static bool check_query(struct exchange *x)
{
	struct query_check check = {x, 0, true};

	if (x->target_has_nul) {
		exchange_reply_problem(x, PROBLEM_MALFORMED, NULL,
		    "There is a NUL (%%00) in the query.");
		return false;
	}
	MHD_get_connection_values(x->connection, MHD_GET_ARGUMENT_KIND,
	    check_parameter, &check);
	return check.good;
}

/*
 * Whether the target is as long as it is to this program. libmicrohttpd ends
 * it with a NUL, in place, just before the version: one further to the left
 * was sent by the client, and what comes behind it would be ignored.
 */
static bool check_nul(struct exchange *x, const char *version)
{
	if (version == x->target_end + 1)
		return true;
	exchange_reply_problem(x, PROBLEM_MALFORMED, NULL,
	    "There is a NUL byte in the request line.");
	return false;
}

static bool check_target(struct exchange *x, const char *path)
{
	char allow[ROUTE_ALLOW_MAX];
	enum route_outcome outcome;

	if (x->target_length > URI_MAX) {
		exchange_reply_problem(x, PROBLEM_URI_TOO_LONG, NULL,
		    "The URI has %zu bytes; this server takes %d at most.",
		    x->target_length, URI_MAX);
		return false;
	}
	outcome = x->path_has_nul ? ROUTE_NO_PATH : route_find(x->method,
	    path, &x->route, x->id, sizeof x->id, allow);
	if (!host_check(x, path))
		return false;
	switch (outcome) {
	case ROUTE_FOUND:
		return check_query(x);
	case ROUTE_NO_PATH:
		exchange_reply_problem(x, PROBLEM_NOT_FOUND, NULL,
		    "There is nothing at %.100s; GET / lists what there is.",
		    x->target);
		return false;
	case ROUTE_NO_METHOD:
		exchange_reply_problem(x, PROBLEM_METHOD, NULL,
		    "%.20s is not possible at %.100s; these are: %s.",
		    x->method, x->target, allow);
		break;
	case ROUTE_OPTIONS:
		exchange_reply_empty(x, MHD_HTTP_NO_CONTENT);
		cors_preflight(x, allow);
		if (strstr(allow, "PATCH") != NULL)
			exchange_add_header(x, "Accept-Patch",
			    HANDLERS_PATCH_TYPES);
		break;
	}
	exchange_add_header(x, "Allow", allow);
	return false;
}

static bool has_body(struct exchange *x)
{
	const char *length = exchange_header(x, "Content-Length");

	return exchange_header(x, "Transfer-Encoding") != NULL ||
	    (length != NULL && strcmp(length, "0") != 0);
}

static enum MHD_Result begin(struct exchange *x, const char *method,
    const char *path, const char *version)
{
	x->checked = true;
	x->method = method;
	trace_begin(x);
	if (!framing_check(x, version) || !check_nul(x, version))
		return send_answer(x);
	if (check_target(x, path) && access_check(x)) {
		x->discard = !x->route->has_body;
		if (x->route->open != NULL)
			x->route->open(x);
		return MHD_YES;
	}
	/* What is queued now closes the connection; without a body the next
	 * call is soon enough. */
	return has_body(x) ? send_answer(x) : MHD_YES;
}

/* ---- the other callbacks ---- */

/* The request is complete. */
static enum MHD_Result dispatch(struct exchange *x)
{
	if (x->refused_midway)
		return MHD_NO;
	if (x->response != NULL)
		return send_answer(x);
	/* libmicrohttpd goes on, when x goes on, with what it was at when it was
	 * suspended: if that was reading, it finds the end of a stream whose
	 * client has no more to say, and drops the answer. Let it be done. */
	if (readers_want(x) && !x->is_read) {
		x->is_read = true;
		return MHD_YES;
	}
	owe(x);
	access_count_bytes(x, x->body_seen);
	http_set_deadline(x, HTTP_NO_DEADLINE);
	x->arrived = clock_seconds();
	readers_handle(x);
	return x->waiting ? MHD_YES : send_answer(x);
}

/* There was none for the exchange, so all of this is libmicrohttpd's. */
static enum MHD_Result answer_without_memory(struct MHD_Connection *connection)
{
	char text[PROBLEM_TEXT_MAX];
	size_t length = problem_print(problem_kind(PROBLEM_MEMORY), text);
	struct MHD_Response *response = MHD_create_response_from_buffer(
	    length, text, MHD_RESPMEM_MUST_COPY);
	enum MHD_Result result;

	if (response == NULL)
		return MHD_NO;
	MHD_add_response_header(response, "Content-Type",
	    "application/problem+json");
	MHD_add_response_header(response, "Retry-After", "2");
	MHD_add_response_header(response, "Connection", "close");
	result = MHD_queue_response(connection, 503, response);
	MHD_destroy_response(response);
	return result;
}

static enum MHD_Result on_access(void *ctx, struct MHD_Connection *connection,
    const char *path, const char *method, const char *version,
    const char *data, size_t *length, void **request)
{
	struct exchange *x = *request;

	(void)ctx;
	if (x == NULL)
		return answer_without_memory(connection);
	if (!x->checked)
		return begin(x, method, path, version);
	if (*length > 0) {
		size_t n = *length;

		*length = 0;
		return body_take(x, data, n);
	}
	if (!x->waiting)
		return dispatch(x);
	x->waiting = false;
	x->resumed(x);
	return x->waiting ? MHD_YES : send_answer(x);
}

/* ---- life ---- */

static void on_mhd_log(void *ctx, const char *format, va_list args)
    __attribute__((format(printf, 2, 0)));

static void on_mhd_log(void *ctx, const char *format, va_list args)
{
	char text[256];

	(void)ctx;
	vsnprintf(text, sizeof text, format, args);
	text[strcspn(text, "\n")] = '\0';
	log_write(LOG_DEBUG, "http: %s", text);
}

static struct MHD_Daemon *start_daemon(struct http *h)
{
	bool is_tls = h->server->tls != NULL;
	unsigned flags = MHD_USE_EPOLL | MHD_USE_INTERNAL_POLLING_THREAD |
	    MHD_USE_NO_LISTEN_SOCKET | MHD_USE_ITC | MHD_ALLOW_SUSPEND_RESUME | MHD_USE_ERROR_LOG |
	    (is_tls ? MHD_USE_TLS : 0u);

	return MHD_start_daemon(flags, 0, NULL, NULL, on_access, h,
	    MHD_OPTION_EXTERNAL_LOGGER, on_mhd_log, NULL,
	    MHD_OPTION_THREAD_POOL_SIZE, (unsigned)THREADS,
	    /* The acceptor counts; here those that are about to be closed
	     * count, too. */
	    MHD_OPTION_CONNECTION_LIMIT, (unsigned)h->most + CLOSING_MOST,
	    MHD_OPTION_CONNECTION_TIMEOUT, (unsigned)INACTIVITY_SECONDS,
	    MHD_OPTION_CONNECTION_MEMORY_LIMIT, CONNECTION_MEMORY,
	    MHD_OPTION_NOTIFY_COMPLETED, on_complete, h,
	    MHD_OPTION_NOTIFY_CONNECTION, connection_notify, h,
	    MHD_OPTION_URI_LOG_CALLBACK, on_request_line, h,
	    /* Nothing behind an END is read. */
	    is_tls ? MHD_OPTION_HTTPS_CERT_CALLBACK : MHD_OPTION_END,
	    handshake_show,
	    MHD_OPTION_HTTPS_PRIORITIES, TLS_PRIORITIES,
	    MHD_OPTION_END);
}

enum err http_listen(struct server *server, char url[static HTTP_URL_MAX])
{
	struct http *h = calloc(1, sizeof *h);
	enum err err;

	if (h == NULL)
		return ERR_MEMORY;
	json_memory_watch();
	h->server = server;
	h->most = server->config->max_connections;
	/* libmicrohttpd wants one a thread. */
	if (h->most < THREADS)
		h->most = THREADS;
	pthread_mutex_init(&h->lock, NULL);
	err = listener_open(h, url);
	if (err != ERR_OK) {
		pthread_mutex_destroy(&h->lock);
		free(h);
		return err;
	}
	listener_make_room(h);
	server->http = h;
	return ERR_OK;
}

enum err http_start(struct http *h)
{
	h->daemon = start_daemon(h);
	if (h->daemon != NULL && acceptor_start(h, &h->acceptor) == ERR_OK)
		return ERR_OK;
	log_write(LOG_ERROR, "cannot start the HTTP server");
	return ERR_IO;
}

void http_quiesce(struct http *h)
{
	acceptor_quiesce(h->acceptor);
}

size_t http_refused(struct http *h)
{
	return h->acceptor != NULL ? acceptor_refused(h->acceptor) : 0;
}

size_t http_owed(struct http *h)
{
	return atomic_load(&h->owed);
}

size_t http_active(struct http *h)
{
	return atomic_load(&h->active);
}

void http_stop(struct http *h)
{
	if (h == NULL)
		return;
	if (h->acceptor != NULL)
		acceptor_quiesce(h->acceptor);
	if (h->daemon != NULL)
		MHD_stop_daemon(h->daemon);
	acceptor_free(h->acceptor);
	if (h->listener >= 0)
		close(h->listener);
	pthread_mutex_destroy(&h->lock);
	free(h);
}
