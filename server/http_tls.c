/*
 * Handshakes of libmicrohttpd's TLS connections. Its threads never wait for the
 * rest of one: they ask again and again whether it has come, and one client
 * that says half of what it should keeps a core busy until it is cut (measured
 * with libmicrohttpd 0.9.75: 82 % of a core). What they read through is
 * therefore this program's, and naps.
 */
#include "server/http_internal.h"

#include <errno.h>
#include <poll.h>
#include <sys/socket.h>
#include <time.h>

#include "server/clock.h"
#include "server/server.h"
#include "server/tls.h"

/* Reads in a row that find nothing before it is asking again and again: what
 * is served has two at most. */
#define DRY_MOST 4

/*
 * A thread that was awake for so long naps for a multiple of that: with many
 * such connections, once for some of them. With 0, 1, 50, 500 of them the
 * daemon takes 0.5, 7, 16, 13 % of a core, and a GET of another client's 0.6,
 * 4, 4, 33 ms, on a machine of two cores with more to do than they can.
 */
#define AWAKE_LEAST 5e-4
#define NAP_OF_AWAKE 4.0
#define NAP_MOST 4e-3

static void nap(void)
{
	static _Thread_local double since;
	double awake = clock_seconds() - since;
	double length = NAP_OF_AWAKE * awake;
	struct timespec time = {0, 0};

	if (awake < AWAKE_LEAST)
		return;
	if (length > NAP_MOST)
		length = NAP_MOST;
	time.tv_nsec = (long)(1e9 * length);
	nanosleep(&time, NULL);
	since = clock_seconds();
}

static ssize_t pull(gnutls_transport_ptr_t ctx, void *data, size_t size)
{
	struct connection *c = ctx;
	ssize_t n = recv(c->socket, data, size, MSG_DONTWAIT);

	if (n >= 0 || (errno != EAGAIN && errno != EWOULDBLOCK)) {
		c->dry = 0;
		return n;
	}
	if (++c->dry > DRY_MOST)
		nap();
	errno = EAGAIN;
	return -1;
}

static int pull_timeout(gnutls_transport_ptr_t ctx, unsigned milliseconds)
{
	const struct connection *c = ctx;
	struct pollfd fd = {.fd = c->socket, .events = POLLIN};

	return poll(&fd, 1, milliseconds == GNUTLS_INDEFINITE_TIMEOUT ? -1 :
	    (int)milliseconds);
}

void handshake_open(struct http *h, struct MHD_Connection *connection,
    struct connection *c)
{
	const union MHD_ConnectionInfo *info;
	gnutls_session_t session;

	if (h->server->tls == NULL)
		return;
	info = MHD_get_connection_info(connection,
	    MHD_CONNECTION_INFO_GNUTLS_SESSION);
	if (info == NULL || info->tls_session == NULL)
		return;
	session = info->tls_session;
	/* Sending stays GnuTLS's own, to whom a pointer is a descriptor. */
	gnutls_transport_set_ptr2(session, c,
	    (gnutls_transport_ptr_t)(ptrdiff_t)c->socket);
	gnutls_transport_set_pull_function(session, pull);
	gnutls_transport_set_pull_timeout_function(session, pull_timeout);
}

/*
 * What a handshake shows: the same pair to its end, though there may be a new
 * one by then. libmicrohttpd keeps its connection in the session.
 */
int handshake_show(gnutls_session_t session,
    const gnutls_datum_t *authorities, int authority_count,
    const gnutls_pk_algorithm_t *algorithms, int algorithm_count,
    gnutls_pcert_st **chain, unsigned *length, gnutls_privkey_t *key)
{
	struct MHD_Connection *connection = gnutls_session_get_ptr(session);
	struct connection *c = connection_find(connection);

	(void)authorities, (void)authority_count;
	(void)algorithms, (void)algorithm_count;
	if (c == NULL)
		return -1;
	if (c->pair == NULL)
		c->pair = tls_take(c->http->server->tls);
	tls_show(c->pair, chain, length, key);
	return 0;
}
