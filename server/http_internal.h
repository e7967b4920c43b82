/*
 * What the files of http.h share: the daemon's connections, and bodies.
 */
#ifndef SERVER_HTTP_INTERNAL_H
#define SERVER_HTTP_INTERNAL_H

#include <gnutls/abstract.h>
#include <gnutls/gnutls.h>
#include <microhttpd.h>
#include <pthread.h>
#include <stdatomic.h>
#include <stdbool.h>
#include <stddef.h>

#include "server/http.h"

struct acceptor;
struct exchange;
struct server;
struct tls_pair;

/* A request that has arrived may wait so long for its answer to leave, and
 * longer the larger the answer is; the same rate holds for bodies. */
#define DEADLINE_SECONDS 60.0
#define LEAST_BYTES_PER_SECOND 16384.0

/* How long a connection may be idle between two requests. */
#define INACTIVITY_SECONDS 60

#define PEER_MAX 48

/* What a connection is about; also the order in which they are given up where
 * there are too many. */
enum stage {
	STAGE_IDLE,  /* no request line has come: handshake, or between two */
	STAGE_HEAD,  /* the rest of a head is waited for */
	STAGE_BODY,
	STAGE_ANSWER /* the request has arrived */
};

struct connection {
	struct connection *next, **link;
	struct http *http;
	int socket;
	enum stage stage;
	double since;    /* when that began, clock_seconds */
	double deadline;
	double progress; /* when the client last took some of an answer that
	                  * leaves as it is made; 0: there is none */
	bool is_over;    /* its stream had ended when http_reap last looked */
	int unread;      /* ... and so many bytes were before the end */
	bool is_shut;    /* by us: its end is on its way */
	struct tls_pair *pair; /* that its handshake began with, or NULL */
	unsigned dry;    /* reads in a row that found nothing (TLS) */
	char peer[PEER_MAX];   /* address */
};

struct http {
	struct server *server;
	struct MHD_Daemon *daemon;
	struct acceptor *acceptor;
	int listener;         /* the acceptor's, once there is one; -1: closed */
	bool is_passed;       /* the listener is the service manager's, too */
	size_t most;          /* connections */
	atomic_size_t active; /* requests begun and not yet answered */
	atomic_size_t owed;   /* those of them that have arrived */
	atomic_size_t bytes;  /* of bodies */
	atomic_size_t texts;  /* bytes of texts read for answers */
	pthread_mutex_t lock; /* guards connections, with what is below */
	struct connection *connections;
	size_t count;         /* of those that are not shut */
	double told;          /* when it was last logged that they are many */
};

/* ---- http_connection.c ---- */

/* For MHD_OPTION_NOTIFY_CONNECTION; ctx is the struct http. */
void connection_notify(void *ctx, struct MHD_Connection *connection,
    void **socket_context, enum MHD_ConnectionNotificationCode code);

/* NULL: there was no memory for it when it came. */
struct connection *connection_find(struct MHD_Connection *connection);

/* It is at stage now, with a deadline (clock_seconds). */
void connection_set(struct http *h, struct MHD_Connection *connection,
    enum stage stage, double deadline);

/* They are as many as there may be: gives up the idlest one. Any thread. */
void connections_make_place(struct http *h);

/* ---- http_tls.c ---- */

/* c has come: what its handshake needs, if it is of TLS. */
void handshake_open(struct http *h, struct MHD_Connection *connection,
    struct connection *c);

/* For MHD_OPTION_HTTPS_CERT_CALLBACK. */
gnutls_certificate_retrieve_function2 handshake_show;

/* ---- http_listen.c ---- */

/* h->listener, of the service manager or one's own, and its URL. ERR_IO,
 * ERR_INVALID: the log says why. */
enum err listener_open(struct http *h, char url[static HTTP_URL_MAX]);

/* Raises the limit of open files to what h->most needs, or lowers that. */
void listener_make_room(struct http *h);

/* ---- http_body.c ---- */

/* So much of x's body has arrived; for the access callback to return. */
enum MHD_Result body_take(struct exchange *x, const char *data, size_t length);

#endif
