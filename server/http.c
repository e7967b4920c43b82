/*
 * Who owns what: an exchange is made when its request line has arrived and
 * freed only in the completion callback. An exchange that waits is suspended:
 * libmicrohttpd leaves it alone until exchange_resume, then calls the access
 * handler again; or, for one that is paused in the middle of its answer, the
 * answer's reader. A connection is in the list from its start to its close;
 * the list's lock is what makes shutting its socket from http_reap safe.
 */
#include "server/http.h"

#include <errno.h>
#include <microhttpd.h>
#include <netdb.h>
#include <pthread.h>
#include <stdarg.h>
#include <stdatomic.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/socket.h>
#include <unistd.h>

#include "proto/answer.h"
#include "server/clock.h"
#include "server/config.h"
#include "server/exchange.h"
#include "server/framing.h"
#include "server/log.h"
#include "server/routes.h"
#include "server/server.h"

#define CONNECTIONS_MAX 1000
#define THREADS 2

/* The pool a connection keeps its head in. It is cleared for every request:
 * 32 KB cost 4.6 microseconds, 1 MB 64. */
#define CONNECTION_MEMORY ((size_t)32 << 10)

#define INACTIVITY_SECONDS 60
#define URI_MAX 4096

/* A request or an answer may take so long, and longer the larger it is. */
#define DEADLINE_SECONDS 60.0
#define LEAST_BYTES_PER_SECOND 16384.0

/* A body's first allocation, whatever its length is said to be. */
#define BODY_FIRST ((size_t)1 << 20)

/* All bodies together, but at least two of the largest. */
#define BODIES_MAX ((size_t)1 << 30)

struct connection {
	struct connection *next, **link;
	int socket;
	double deadline;
	double progress; /* when the client last took some of an answer that
	                  * leaves as it is made; 0: there is none */
	bool arriving; /* a request is waited for, or the rest of one */
	bool is_over;  /* ... but its end had come when http_reap last looked */
};

struct http {
	struct server *server;
	struct MHD_Daemon *daemon;
	int listener;
	bool is_quiesced;     /* the listener is no longer the daemon's */
	atomic_size_t active; /* requests begun and not yet answered */
	atomic_size_t owed;   /* those of them that have arrived */
	atomic_size_t bytes; /* of bodies */
	pthread_mutex_t lock; /* guards connections */
	struct connection *connections;
};

/* ---- connections and their deadlines ---- */

static void connection_open(struct http *h, struct MHD_Connection *connection,
    void **socket_context)
{
	const union MHD_ConnectionInfo *info = MHD_get_connection_info(
	    connection, MHD_CONNECTION_INFO_CONNECTION_FD);
	struct connection *c = malloc(sizeof *c);

	*socket_context = c;
	if (c == NULL)
		return;
	c->socket = info->connect_fd;
	c->deadline = clock_seconds() + DEADLINE_SECONDS;
	c->progress = 0.0;
	c->arriving = true;
	c->is_over = false;
	pthread_mutex_lock(&h->lock);
	c->next = h->connections;
	c->link = &h->connections;
	if (c->next != NULL)
		c->next->link = &c->next;
	h->connections = c;
	pthread_mutex_unlock(&h->lock);
}

static void connection_close(struct http *h, struct connection *c)
{
	if (c == NULL)
		return;
	pthread_mutex_lock(&h->lock);
	*c->link = c->next;
	if (c->next != NULL)
		c->next->link = c->link;
	pthread_mutex_unlock(&h->lock);
	free(c);
}

static void on_connection(void *ctx, struct MHD_Connection *connection,
    void **socket_context, enum MHD_ConnectionNotificationCode code)
{
	if (code == MHD_CONNECTION_NOTIFY_STARTED)
		connection_open(ctx, connection, socket_context);
	else
		connection_close(ctx, *socket_context);
}

static struct connection *find_connection(struct MHD_Connection *connection)
{
	const union MHD_ConnectionInfo *info = MHD_get_connection_info(
	    connection, MHD_CONNECTION_INFO_SOCKET_CONTEXT);

	return info != NULL ? info->socket_context : NULL;
}

static void set_deadline(struct http *h, struct MHD_Connection *connection,
    double when, bool arriving)
{
	struct connection *c = find_connection(connection);

	if (c == NULL)
		return;
	pthread_mutex_lock(&h->lock);
	c->deadline = when;
	c->progress = 0.0;
	c->arriving = arriving;
	c->is_over = false;
	pthread_mutex_unlock(&h->lock);
}

/* The request has arrived: only its answer is still waited for. */
void http_set_deadline(struct exchange *x, double when)
{
	set_deadline(x->server->http, x->connection, when, false);
}

/* A deadline for something of so many bytes that begins now. */
static double deadline_for(size_t bytes)
{
	return clock_seconds() + DEADLINE_SECONDS +
	    (double)bytes / LEAST_BYTES_PER_SECOND;
}

void http_note_progress(struct exchange *x, size_t taken)
{
	struct connection *c = find_connection(x->connection);
	struct http *h = x->server->http;
	double next = deadline_for(HTTP_STREAM_BLOCK);
	double all = x->sending + DEADLINE_SECONDS +
	    (double)taken / LEAST_BYTES_PER_SECOND;

	if (c == NULL)
		return;
	pthread_mutex_lock(&h->lock);
	c->deadline = next < all ? next : all;
	c->progress = clock_seconds();
	pthread_mutex_unlock(&h->lock);
}

/*
 * Whether the client hung up in the middle of a request, and all it sent has
 * been read. libmicrohttpd misses the end of a stream that comes together with
 * the last bytes. True the second time only: the first time it may be about
 * to answer them.
 */
static bool is_hung_up(struct connection *c)
{
	bool was_over = c->is_over;
	char byte;

	c->is_over = c->arriving &&
	    recv(c->socket, &byte, 1, MSG_PEEK | MSG_DONTWAIT) == 0;
	return was_over && c->is_over;
}

void http_reap(struct http *h)
{
	double now = clock_seconds();

	pthread_mutex_lock(&h->lock);
	for (struct connection *c = h->connections; c != NULL; c = c->next) {
		if (now > c->deadline || is_hung_up(c)) {
			shutdown(c->socket, SHUT_RDWR);
			c->deadline = HTTP_NO_DEADLINE;
			c->arriving = false;
		}
	}
	pthread_mutex_unlock(&h->lock);
}

void http_cut_stalled(struct http *h, double seconds)
{
	double now = clock_seconds();

	pthread_mutex_lock(&h->lock);
	for (struct connection *c = h->connections; c != NULL; c = c->next) {
		if (c->progress > 0.0 && now - c->progress > seconds) {
			shutdown(c->socket, SHUT_RDWR);
			c->progress = 0.0;
		}
	}
	pthread_mutex_unlock(&h->lock);
}

/* ---- body memory ---- */

bool http_take_bytes(struct http *h, size_t bytes)
{
	size_t most = h->server->config->max_body;

	most = most > BODIES_MAX / 2 ? 2 * most : BODIES_MAX;
	if (atomic_fetch_add(&h->bytes, bytes) + bytes <= most)
		return true;
	atomic_fetch_sub(&h->bytes, bytes);
	return false;
}

void http_return_bytes(struct http *h, size_t bytes)
{
	atomic_fetch_sub(&h->bytes, bytes);
}

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

	if (x == NULL)
		return NULL;
	x->server = h->server;
	x->connection = connection;
	x->socket = MHD_get_connection_info(connection,
	    MHD_CONNECTION_INFO_CONNECTION_FD)->connect_fd;
	x->begun = clock_seconds();
	x->target_length = length;
	x->target_end = uri + length;
	x->path_has_nul = has_escaped_nul(uri, strcspn(uri, "?"));
	x->target_has_nul = has_escaped_nul(uri, length);
	for (size_t i = 0; i < length && i < EXCHANGE_TARGET_MAX - 1; i++)
		x->target[i] = uri[i] > ' ' && uri[i] < 127 ? uri[i] : '?';
	atomic_fetch_add(&h->active, 1);
	set_deadline(h, connection, deadline_for(0), true);
	return x;
}

static void log_exchange(const struct exchange *x)
{
	bool is_probe = x->route != NULL && x->route->is_probe;

	log_write(is_probe ? LOG_DEBUG : LOG_INFO, "%s %s %u %zu %.1f ms",
	    x->method != NULL ? x->method : "-", x->target, x->status,
	    x->answer_length, 1e3 * (clock_seconds() - x->begun));
}

static void on_complete(void *ctx, struct MHD_Connection *connection,
    void **request, enum MHD_RequestTerminationCode code)
{
	struct http *h = ctx;
	struct exchange *x = *request;

	bool owed;

	(void)code;
	if (x == NULL)
		return;
	owed = x->owed;
	*request = NULL;
	log_exchange(x);
	if (x->state != NULL)
		x->state_free(x->state, x->server);
	exchange_release_body(x);
	if (x->response != NULL)
		MHD_destroy_response(x->response);
	for (int i = 0; i < EXCHANGE_JOINED_MAX; i++)
		free(x->joined[i]);
	free(x);
	/* For the next request line, or to find the connection idle. */
	set_deadline(h, connection, deadline_for(0), true);
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
	x->sending = clock_seconds();
	http_set_deadline(x, deadline_for(x->stream.read != NULL ? 0 :
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
	if (!framing_check(x, version) || !check_nul(x, version))
		return send_answer(x);
	if (check_target(x, path)) {
		x->discard = !x->route->has_body;
		if (x->route->open != NULL)
			x->route->open(x);
		return MHD_YES;
	}
	/* What is queued now closes the connection; without a body the next
	 * call is soon enough. */
	return has_body(x) ? send_answer(x) : MHD_YES;
}

/* ---- bodies ---- */

/*
 * Answers in the middle of a body, which libmicrohttpd cannot: the answer goes
 * straight to the socket, and the rest of the body is read and dropped, for a
 * while, so that the answer is not lost to a reset.
 */
static void refuse_midway(struct exchange *x, enum problem problem,
    const char *detail)
{
	const struct problem_kind *kind = problem_kind(problem);
	char retry[40] = "", *message = NULL, *json;
	size_t length;
	int n = -1;

	x->refused_midway = true;
	x->status = (unsigned)kind->status;
	exchange_release_body(x);
	if (kind->retry_after > 0)
		snprintf(retry, sizeof retry, "Retry-After: %d\r\n",
		    kind->retry_after);
	json = answer_problem(kind->status, kind->slug, kind->title, detail,
	    NULL, &length);
	if (json != NULL)
		n = asprintf(&message, "HTTP/1.1 %d %s\r\nContent-Type: %s\r\n"
		    "Content-Length: %zu\r\n%sConnection: close\r\n\r\n%.*s",
		    kind->status, kind->title, media_name(MEDIA_PROBLEM),
		    length, retry, (int)length, json);
	if (n > 0 && send(x->socket, message, (size_t)n, MSG_NOSIGNAL |
	    MSG_DONTWAIT) == n)
		x->answer_length = length;
	shutdown(x->socket, SHUT_WR);
	if (n > 0)
		free(message);
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

static enum MHD_Result take_body(struct exchange *x, const char *data,
    size_t length)
{
	size_t most = x->server->config->max_body;
	char detail[100];

	x->body_seen += length;
	if (x->refused_midway || x->discard)
		return x->body_seen > 2 * most ? MHD_NO : MHD_YES;
	set_deadline(x->server->http, x->connection, x->begun +
	    DEADLINE_SECONDS + (double)x->body_seen / LEAST_BYTES_PER_SECOND,
	    true);
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

/* The request is complete. */
static enum MHD_Result dispatch(struct exchange *x)
{
	if (x->refused_midway)
		return MHD_NO;
	if (x->response != NULL)
		return send_answer(x);
	owe(x);
	http_set_deadline(x, HTTP_NO_DEADLINE);
	x->route->handle(x);
	return x->waiting ? MHD_YES : send_answer(x);
}

static enum MHD_Result on_access(void *ctx, struct MHD_Connection *connection,
    const char *path, const char *method, const char *version,
    const char *data, size_t *length, void **request)
{
	struct exchange *x = *request;

	(void)ctx, (void)connection;
	if (x == NULL)
		return MHD_NO;
	if (!x->checked)
		return begin(x, method, path, version);
	if (*length > 0) {
		size_t n = *length;

		*length = 0;
		return take_body(x, data, n);
	}
	if (!x->waiting)
		return dispatch(x);
	x->waiting = false;
	x->resumed(x);
	return send_answer(x);
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

/* The address the listener has, as a URL. */
static void print_url(int listener, char url[static HTTP_URL_MAX])
{
	struct sockaddr_storage address;
	socklen_t size = sizeof address;
	char host[256] = "", port[16] = "";
	bool is_v6;

	getsockname(listener, (struct sockaddr *)&address, &size);
	getnameinfo((struct sockaddr *)&address, size, host, sizeof host, port,
	    sizeof port, NI_NUMERICHOST | NI_NUMERICSERV);
	is_v6 = address.ss_family == AF_INET6;
	snprintf(url, HTTP_URL_MAX, "http://%s%s%s:%s", is_v6 ? "[" : "", host,
	    is_v6 ? "]" : "", port);
}

static int listen_at(const struct addrinfo *address)
{
	int yes = 1;
	int fd = socket(address->ai_family, SOCK_STREAM | SOCK_NONBLOCK |
	    SOCK_CLOEXEC, 0);

	if (fd < 0)
		return -1;
	setsockopt(fd, SOL_SOCKET, SO_REUSEADDR, &yes, sizeof yes);
	if (bind(fd, address->ai_addr, address->ai_addrlen) == 0 &&
	    listen(fd, 511) == 0)
		return fd;
	close(fd);
	return -1;
}

/* A listening socket, or -1, logged. */
static int open_listener(const struct config *config)
{
	struct addrinfo hints = {.ai_socktype = SOCK_STREAM,
	    .ai_flags = AI_PASSIVE};
	struct addrinfo *list = NULL;
	const char *why;
	int fd = -1;
	int code = getaddrinfo(config->host, config->port, &hints, &list);

	why = code != 0 ? gai_strerror(code) : "";
	for (struct addrinfo *a = list; a != NULL && fd < 0; a = a->ai_next) {
		fd = listen_at(a);
		if (fd < 0)
			why = strerror(errno);
	}
	if (list != NULL)
		freeaddrinfo(list);
	if (fd < 0)
		log_write(LOG_ERROR, "cannot listen at %s port %s: %s",
		    config->host, config->port, why);
	return fd;
}

static struct MHD_Daemon *start_daemon(struct http *h)
{
	unsigned flags = MHD_USE_EPOLL | MHD_USE_INTERNAL_POLLING_THREAD |
	    MHD_ALLOW_SUSPEND_RESUME | MHD_USE_ERROR_LOG;

	return MHD_start_daemon(flags, 0, NULL, NULL, on_access, h,
	    MHD_OPTION_EXTERNAL_LOGGER, on_mhd_log, NULL,
	    MHD_OPTION_LISTEN_SOCKET, h->listener,
	    MHD_OPTION_THREAD_POOL_SIZE, (unsigned)THREADS,
	    MHD_OPTION_CONNECTION_LIMIT, (unsigned)CONNECTIONS_MAX,
	    MHD_OPTION_CONNECTION_TIMEOUT, (unsigned)INACTIVITY_SECONDS,
	    MHD_OPTION_CONNECTION_MEMORY_LIMIT, CONNECTION_MEMORY,
	    MHD_OPTION_NOTIFY_COMPLETED, on_complete, h,
	    MHD_OPTION_NOTIFY_CONNECTION, on_connection, h,
	    MHD_OPTION_URI_LOG_CALLBACK, on_request_line, h,
	    MHD_OPTION_END);
}

enum err http_listen(struct server *server, char url[static HTTP_URL_MAX])
{
	struct http *h = calloc(1, sizeof *h);

	if (h == NULL)
		return ERR_MEMORY;
	h->server = server;
	pthread_mutex_init(&h->lock, NULL);
	h->listener = open_listener(server->config);
	if (h->listener < 0) {
		pthread_mutex_destroy(&h->lock);
		free(h);
		return ERR_IO;
	}
	print_url(h->listener, url);
	server->http = h;
	return ERR_OK;
}

enum err http_start(struct http *h)
{
	h->daemon = start_daemon(h);
	if (h->daemon != NULL)
		return ERR_OK;
	log_write(LOG_ERROR, "cannot start the HTTP server");
	return ERR_IO;
}

void http_quiesce(struct http *h)
{
	MHD_quiesce_daemon(h->daemon);
	/* Refuses connections; the descriptor is still in the pollers' sets. */
	shutdown(h->listener, SHUT_RDWR);
	h->is_quiesced = true;
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
	if (h->daemon != NULL)
		MHD_stop_daemon(h->daemon);
	if (h->daemon == NULL || h->is_quiesced)
		close(h->listener);
	pthread_mutex_destroy(&h->lock);
	free(h);
}
