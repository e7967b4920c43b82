/*
 * Connections and their deadlines. A connection is in the list from its start
 * to its close; the list's lock is what makes shutting its socket from another
 * thread safe.
 */
#include "server/http_internal.h"

#include <errno.h>
#include <netdb.h>
#include <netinet/in.h>
#include <poll.h>
#include <stdlib.h>
#include <string.h>
#include <sys/ioctl.h>
#include <sys/socket.h>

#include "server/clock.h"
#include "server/config.h"
#include "server/exchange.h"
#include "server/http_accept.h"
#include "server/log.h"
#include "server/server.h"
#include "server/tls.h"

/* Places that are kept free, of so many: when only these are left, connections
 * that wait for nothing are shut, for new ones to come in. */
#define RESERVE_OF 16
#define RESERVE_MOST 64

/* Where there are none of those, heads that take longer than this. */
#define HEAD_SECONDS 5.0

/* ... which is logged so often, in seconds, at most. */
#define TELL_EVERY 60.0

/* ---- the list ---- */

/* The address without what IPv6 puts before IPv4's. */
static void write_peer(struct MHD_Connection *connection,
    char peer[static PEER_MAX])
{
	static const char mapped[] = "::ffff:";
	const union MHD_ConnectionInfo *info = MHD_get_connection_info(
	    connection, MHD_CONNECTION_INFO_CLIENT_ADDRESS);
	const struct sockaddr *address = info != NULL ? info->client_addr :
	    NULL;
	socklen_t size = sizeof(struct sockaddr_in);

	peer[0] = '\0';
	/* Of a socket in the file system there is none. */
	if (address == NULL || (address->sa_family != AF_INET &&
	    address->sa_family != AF_INET6))
		return;
	if (address->sa_family == AF_INET6)
		size = sizeof(struct sockaddr_in6);
	if (getnameinfo(address, size, peer, PEER_MAX, NULL, 0,
	    NI_NUMERICHOST) != 0)
		peer[0] = '\0';
	if (strncmp(peer, mapped, sizeof mapped - 1) == 0 &&
	    strchr(peer, '.') != NULL)
		memmove(peer, peer + sizeof mapped - 1,
		    strlen(peer) - sizeof mapped + 2);
}

/* With h->lock. libmicrohttpd finds the end of the stream, and closes it. */
static void shut(struct http *h, struct connection *c)
{
	shutdown(c->socket, SHUT_RDWR);
	c->deadline = HTTP_NO_DEADLINE;
	c->progress = 0.0;
	if (!c->is_shut)
		h->count--;
	c->is_shut = true;
}

/* Of connections but one, what has waited longest for its client: those without
 * a request first; NULL: none. */
static struct connection *find_idlest(const struct http *h,
    const struct connection *but)
{
	struct connection *best = NULL;

	for (struct connection *c = h->connections; c != NULL; c = c->next) {
		if (c == but || c->is_shut || c->stage > STAGE_HEAD ||
		    (c->stage == STAGE_HEAD &&
		    clock_seconds() - c->since < HEAD_SECONDS))
			continue;
		if (best == NULL || c->stage < best->stage ||
		    (c->stage == best->stage && c->since < best->since))
			best = c;
	}
	return best;
}

/* With h->lock, when c (or NULL) has come: gives up another one if they are
 * many. */
static void make_place(struct http *h, const struct connection *c)
{
	size_t reserve = h->most / RESERVE_OF;
	double now = clock_seconds();
	struct connection *idlest;

	if (reserve > RESERVE_MOST)
		reserve = RESERVE_MOST;
	if (h->count + reserve <= h->most)
		return;
	idlest = find_idlest(h, c);
	if (idlest != NULL)
		shut(h, idlest);
	if (idlest == NULL || now - h->told < TELL_EVERY)
		return;
	h->told = now;
	log_write(LOG_WARNING, "there are %zu connections, of %zu that there "
	    "may be (--max-connections): idle ones are closed",
	    h->count, h->most);
}

void connections_make_place(struct http *h)
{
	pthread_mutex_lock(&h->lock);
	make_place(h, NULL);
	pthread_mutex_unlock(&h->lock);
}

static void open_connection(struct http *h, struct MHD_Connection *connection,
    void **socket_context)
{
	const union MHD_ConnectionInfo *info = MHD_get_connection_info(
	    connection, MHD_CONNECTION_INFO_CONNECTION_FD);
	struct connection *c = calloc(1, sizeof *c);

	*socket_context = c;
	if (c == NULL)
		return;
	c->http = h;
	c->socket = info->connect_fd;
	c->since = clock_seconds();
	/* For a handshake, if there is one, and a request line. */
	c->deadline = c->since + (double)h->server->config->request_time;
	write_peer(connection, c->peer);
	handshake_open(h, connection, c);
	pthread_mutex_lock(&h->lock);
	c->next = h->connections;
	c->link = &h->connections;
	if (c->next != NULL)
		c->next->link = &c->next;
	h->connections = c;
	h->count++;
	make_place(h, c);
	pthread_mutex_unlock(&h->lock);
}

static void close_connection(struct http *h, struct connection *c)
{
	if (c == NULL)
		return;
	pthread_mutex_lock(&h->lock);
	*c->link = c->next;
	if (c->next != NULL)
		c->next->link = c->link;
	if (!c->is_shut)
		h->count--;
	pthread_mutex_unlock(&h->lock);
	tls_release(c->pair);
	free(c);
}

void connection_notify(void *ctx, struct MHD_Connection *connection,
    void **socket_context, enum MHD_ConnectionNotificationCode code)
{
	struct http *h = ctx;

	if (code == MHD_CONNECTION_NOTIFY_STARTED) {
		open_connection(h, connection, socket_context);
		return;
	}
	close_connection(h, *socket_context);
	/* Behind it the descriptor is closed. */
	acceptor_release(h->acceptor, MHD_get_connection_info(connection,
	    MHD_CONNECTION_INFO_CONNECTION_FD)->connect_fd);
}

struct connection *connection_find(struct MHD_Connection *connection)
{
	const union MHD_ConnectionInfo *info = MHD_get_connection_info(
	    connection, MHD_CONNECTION_INFO_SOCKET_CONTEXT);

	return info != NULL ? info->socket_context : NULL;
}

void connection_set(struct http *h, struct MHD_Connection *connection,
    enum stage stage, double deadline)
{
	struct connection *c = connection_find(connection);

	if (c == NULL)
		return;
	pthread_mutex_lock(&h->lock);
	if (c->stage != stage)
		c->since = clock_seconds();
	c->stage = stage;
	if (!c->is_shut)
		c->deadline = deadline;
	c->progress = 0.0;
	c->is_over = false;
	pthread_mutex_unlock(&h->lock);
}

size_t http_connections(struct http *h)
{
	size_t count;

	pthread_mutex_lock(&h->lock);
	count = h->count;
	pthread_mutex_unlock(&h->lock);
	return count;
}

/* ---- deadlines ---- */

/* The request has arrived: only its answer is still waited for. */
void http_set_deadline(struct exchange *x, double when)
{
	connection_set(x->server->http, x->connection, STAGE_ANSWER, when);
}

double http_answer_deadline(size_t bytes)
{
	return clock_seconds() + DEADLINE_SECONDS +
	    (double)bytes / LEAST_BYTES_PER_SECOND;
}

void http_note_progress(struct exchange *x, size_t taken)
{
	struct connection *c = connection_find(x->connection);
	struct http *h = x->server->http;
	double next = http_answer_deadline(HTTP_STREAM_BLOCK);
	double all = x->sending + DEADLINE_SECONDS +
	    (double)taken / LEAST_BYTES_PER_SECOND;

	if (c == NULL)
		return;
	pthread_mutex_lock(&h->lock);
	if (!c->is_shut)
		c->deadline = next < all ? next : all;
	c->progress = clock_seconds();
	pthread_mutex_unlock(&h->lock);
}

/*
 * Whether the stream's end has come, and nothing of what is before it will be
 * read any more. Of TLS that is also the client's good-bye, so that bytes which
 * stay where they are count as none.
 */
static bool is_at_end(struct connection *c, bool is_tls)
{
	struct pollfd fd = {.fd = c->socket, .events = POLLRDHUP};
	int before = c->unread;
	char byte;

	if (!is_tls) {
		ssize_t n = recv(c->socket, &byte, 1, MSG_PEEK |
		    MSG_DONTWAIT);

		/* Nothing more will come, or it has been reset. */
		return n == 0 || (n < 0 && errno != EAGAIN &&
		    errno != EWOULDBLOCK && errno != EINTR);
	}
	if (poll(&fd, 1, 0) <= 0 || ioctl(c->socket, FIONREAD, &c->unread) != 0)
		return false;
	return c->unread == 0 || c->unread == before;
}

/*
 * Whether the client hung up in the middle of a request, and all it sent has
 * been read. libmicrohttpd misses the end of a stream that comes together with
 * the last bytes. True the second time only: the first time it may be about
 * to answer them.
 */
static bool is_hung_up(struct connection *c, bool is_tls)
{
	bool was_over = c->is_over;

	c->is_over = c->stage != STAGE_ANSWER && is_at_end(c, is_tls);
	return was_over && c->is_over;
}

void http_reap(struct http *h)
{
	bool is_tls = h->server->tls != NULL;
	double now = clock_seconds();

	pthread_mutex_lock(&h->lock);
	for (struct connection *c = h->connections; c != NULL; c = c->next) {
		if (!c->is_shut && (now > c->deadline ||
		    is_hung_up(c, is_tls)))
			shut(h, c);
	}
	pthread_mutex_unlock(&h->lock);
}

void http_cut_stalled(struct http *h, double seconds)
{
	double now = clock_seconds();

	pthread_mutex_lock(&h->lock);
	for (struct connection *c = h->connections; c != NULL; c = c->next) {
		if (c->progress > 0.0 && now - c->progress > seconds)
			shut(h, c);
	}
	pthread_mutex_unlock(&h->lock);
}

bool http_client_has_gone(const struct exchange *x)
{
	struct pollfd fd = {.fd = x->socket, .events = POLLRDHUP};
	char byte;
	ssize_t n;

	/* Before the end of a TLS stream is a good-bye that nobody reads. */
	if (x->server->tls != NULL)
		return poll(&fd, 1, 0) > 0;
	do
		n = recv(x->socket, &byte, 1, MSG_PEEK | MSG_DONTWAIT);
	while (n < 0 && errno == EINTR);
	return n == 0 || (n < 0 && errno != EAGAIN && errno != EWOULDBLOCK);
}
