/*
 * Who owns what: the listener is the thread's; the lock guards the places. A
 * place is a descriptor's, from its accept until libmicrohttpd says that the
 * connection ends, which is before it closes it. Of a connection that it gives up
 * without a word (no memory, no room in an epoll set) the place is free when the
 * same descriptor is accepted again.
 */
#include "server/http_accept.h"

#include <errno.h>
#include <netdb.h>
#include <poll.h>
#include <pthread.h>
#include <search.h>
#include <stdatomic.h>
#include <stdlib.h>
#include <string.h>
#include <sys/eventfd.h>
#include <sys/socket.h>
#include <unistd.h>

#include "server/clock.h"
#include "server/config.h"
#include "server/http_internal.h"
#include "server/log.h"
#include "server/server.h"

/* Taken in a row, before it is looked whether to end. */
#define BURST 64

/* Milliseconds without taking any: there are as many as there may be; the
 * system has no descriptor or no memory for one more. */
#define FULL_NAP 10
#define TROUBLE_NAP 100

/* What is wrong is logged so often, in seconds, at most. */
#define TELL_EVERY 60.0

/* Connections of one key. */
struct host {
	struct accept_key key;
	size_t count;
};

struct place {
	bool is_taken;
	struct host *host;       /* NULL: not counted by address */
};

struct acceptor {
	struct http *http;
	pthread_t thread;
	bool is_running;
	int wake;                /* an event: end */
	size_t most, most_per_host;
	atomic_size_t refused;
	double told_refused, told_trouble, told_full;
	pthread_mutex_t lock;    /* guards: */
	struct place *places;    /* by descriptor */
	size_t place_count;
	size_t taken;
	void *hosts;             /* a tree: tsearch */
};

/* ---- hosts ---- */

static int compare_hosts(const void *a, const void *b)
{
	return memcmp(a, b, sizeof(struct accept_key));
}

/* The host of key, made if there is none; NULL: no memory. Locked. */
static struct host *find_host(struct acceptor *a, const struct accept_key *key)
{
	struct host *made, **found = tfind(key, &a->hosts, compare_hosts);

	if (found != NULL)
		return *found;
	made = calloc(1, sizeof *made);
	if (made == NULL)
		return NULL;
	made->key = *key;
	if (tsearch(made, &a->hosts, compare_hosts) != NULL)
		return made;
	free(made);
	return NULL;
}

/* Locked. */
static void leave_host(struct acceptor *a, struct host *host)
{
	if (host == NULL || --host->count > 0)
		return;
	tdelete(host, &a->hosts, compare_hosts);
	free(host);
}

/* Whether there is room for one more of address, in *out; NULL: it is not
 * counted. Locked. */
static bool enter_host(struct acceptor *a, const struct sockaddr *address,
    struct host **out)
{
	struct accept_key key;

	*out = NULL;
	if (a->most_per_host == 0 || !accept_key_of(address, &key))
		return true;
	*out = find_host(a, &key);
	if (*out == NULL)
		return true; /* no memory to count by */
	if ((*out)->count == a->most_per_host)
		return false;
	(*out)->count++;
	return true;
}

/* ---- places ---- */

/* Locked. */
static void leave(struct acceptor *a, int socket)
{
	struct place *place = a->places + socket;

	if (!place->is_taken)
		return;
	leave_host(a, place->host);
	*place = (struct place){false, NULL};
	a->taken--;
}

/* So that few connections need no memory. */
#define PLACES_FIRST 127

/* There is a place for each descriptor up to that one. Locked. */
static bool make_places(struct acceptor *a, int socket)
{
	size_t need = (size_t)socket + 1, count = 2 * need;
	struct place *places;

	if (need <= a->place_count)
		return true;
	places = realloc(a->places, count * sizeof *places);
	if (places == NULL)
		return false;
	memset(places + a->place_count, 0,
	    (count - a->place_count) * sizeof *places);
	a->places = places;
	a->place_count = count;
	return true;
}

static bool enter(struct acceptor *a, int socket,
    const struct sockaddr *address)
{
	struct host *host;
	bool is_in = false;

	pthread_mutex_lock(&a->lock);
	if (make_places(a, socket)) {
		leave(a, socket);
		is_in = enter_host(a, address, &host);
	}
	if (is_in) {
		a->places[socket] = (struct place){true, host};
		a->taken++;
	}
	pthread_mutex_unlock(&a->lock);
	return is_in;
}

void acceptor_release(struct acceptor *a, int socket)
{
	pthread_mutex_lock(&a->lock);
	if ((size_t)socket < a->place_count)
		leave(a, socket);
	pthread_mutex_unlock(&a->lock);
}

static bool is_full(struct acceptor *a)
{
	bool is_full;

	pthread_mutex_lock(&a->lock);
	is_full = a->taken >= a->most;
	pthread_mutex_unlock(&a->lock);
	return is_full;
}

size_t acceptor_refused(const struct acceptor *a)
{
	return atomic_load(&a->refused);
}

/* ---- what goes wrong ---- */

/* Whether it is time to say it again. */
static bool is_time(double *told)
{
	double now = clock_seconds();

	if (now - *told < TELL_EVERY && *told > 0.0)
		return false;
	*told = now;
	return true;
}

/* Closed without a word: whoever is refused at full speed is not to cost more
 * than that. */
static void refuse(struct acceptor *a, int socket,
    const struct sockaddr *address, socklen_t size)
{
	char peer[PEER_MAX] = "?";

	close(socket);
	atomic_fetch_add(&a->refused, 1);
	if (!is_time(&a->told_refused))
		return;
	getnameinfo(address, size, peer, sizeof peer, NULL, 0, NI_NUMERICHOST);
	log_write(LOG_WARNING, "a connection of %s is refused: there are %zu "
	    "of that address, and no more may be "
	    "(--max-connections-per-address); %zu were refused so far", peer,
	    a->most_per_host, acceptor_refused(a));
}

/* accept says no. Returns the milliseconds until it is asked again. */
static int judge_failure(struct acceptor *a, int error)
{
	if (error == EAGAIN || error == EWOULDBLOCK || error == EINTR ||
	    error == ECONNABORTED)
		return 0;
	if (is_time(&a->told_trouble))
		log_write(LOG_WARNING, "connections cannot be taken, and wait: "
		    "%s", strerror(error));
	return TROUBLE_NAP;
}

/* ---- the thread ---- */

/* Takes those that wait. Returns the milliseconds until more may be taken. */
static int take_burst(struct acceptor *a)
{
	for (int i = 0; i < BURST; i++) {
		struct sockaddr_storage storage = {0};
		struct sockaddr *address = (struct sockaddr *)&storage;
		socklen_t size = sizeof storage;
		int socket;

		if (is_full(a)) {
			connections_make_place(a->http);
			if (is_time(&a->told_full))
				log_write(LOG_WARNING, "there are %zu "
				    "connections (--max-connections): new ones "
				    "wait", a->most);
			return FULL_NAP;
		}
		socket = accept4(a->http->listener, address, &size,
		    SOCK_NONBLOCK | SOCK_CLOEXEC);
		if (socket < 0)
			return judge_failure(a, errno);
		if (!enter(a, socket, address))
			refuse(a, socket, address, size);
		else if (MHD_add_connection(a->http->daemon, socket, address,
		    size) != MHD_YES)
			acceptor_release(a, socket); /* it has closed it */
	}
	return 0;
}

static void *take_connections(void *arg)
{
	struct acceptor *a = arg;
	struct http *h = a->http;
	int nap = 0;

	for (;;) {
		struct pollfd fds[2] = {
			{.fd = a->wake, .events = POLLIN},
			{.fd = nap > 0 ? -1 : h->listener, .events = POLLIN},
		};

		poll(fds, 2, nap > 0 ? nap : -1);
		if (fds[0].revents != 0)
			break;
		nap = take_burst(a);
	}
	if (!h->is_passed)
		take_burst(a);
	close(h->listener);
	h->listener = -1;
	return NULL;
}

/* ---- life ---- */

enum err acceptor_start(struct http *h, struct acceptor **out)
{
	struct acceptor *a = calloc(1, sizeof *a);

	if (a == NULL)
		return ERR_MEMORY;
	a->http = h;
	a->most = h->most;
	a->most_per_host = h->server->config->max_connections_per_address;
	pthread_mutex_init(&a->lock, NULL);
	a->wake = eventfd(0, EFD_CLOEXEC | EFD_NONBLOCK);
	/* Connections end there as soon as there are any. */
	*out = a;
	a->is_running = a->wake >= 0 && make_places(a, PLACES_FIRST) &&
	    pthread_create(&a->thread, NULL, take_connections, a) == 0;
	if (a->is_running)
		return ERR_OK;
	*out = NULL;
	acceptor_free(a);
	return ERR_IO;
}

void acceptor_quiesce(struct acceptor *a)
{
	if (!a->is_running)
		return;
	eventfd_write(a->wake, 1);
	pthread_join(a->thread, NULL);
	a->is_running = false;
}

void acceptor_free(struct acceptor *a)
{
	if (a == NULL)
		return;
	acceptor_quiesce(a);
	tdestroy(a->hosts, free);
	if (a->wake >= 0)
		close(a->wake);
	pthread_mutex_destroy(&a->lock);
	free(a->places);
	free(a);
}
