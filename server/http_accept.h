/*
 * Where connections come in: one thread takes them from the listener, counts
 * them, and hands them to libmicrohttpd's threads. libmicrohttpd's own listening
 * is not used: to end it while connections come aborts the process (0.9.75:
 * MHD_quiesce_daemon and its threads both take the listener out of their sets,
 * and whoever is second calls that fatal).
 *
 * Limits: --max-connections in all, beyond which connections wait in the
 * listener's queue; --max-connections-per-address of one address (of IPv6: of
 * one /64, which is what one customer has; 0: any), beyond which they are closed
 * at once, counted, and logged once a minute.
 */
#ifndef SERVER_HTTP_ACCEPT_H
#define SERVER_HTTP_ACCEPT_H

#include <stdbool.h>
#include <stddef.h>

#include "core/err.h"

struct acceptor;
struct http;
struct sockaddr;

/* What is counted together. */
struct accept_key {
	unsigned char bytes[16]; /* IPv6, of IPv4 the mapped one */
};

/* False: addresses of that family are not counted. */
bool accept_key_of(const struct sockaddr *address, struct accept_key *out);

/* Begins to take connections from h->listener, which is the acceptor's from then
 * on, for h->daemon, which is there. ERR_MEMORY, ERR_IO. */
enum err acceptor_start(struct http *h, struct acceptor **out);

/*
 * Takes no more, and closes the listener, before it returns. Those that are in
 * the queue of one's own listener are taken still, since they would be reset;
 * those in a service manager's wait there for the next daemon. May be called
 * twice.
 */
void acceptor_quiesce(struct acceptor *a);

/* A connection of that descriptor ends; it is not closed yet. Any thread. */
void acceptor_release(struct acceptor *a, int socket);

/* Connections that were refused, since the start. Any thread. */
size_t acceptor_refused(const struct acceptor *a);

/* Once h->daemon has stopped. NULL does nothing. */
void acceptor_free(struct acceptor *a);

#endif
