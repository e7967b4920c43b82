/*
 * Where the daemon listens: at an address, or where the service manager does;
 * and how many connections its open files allow.
 */
#include "server/http_internal.h"

#include <errno.h>
#include <fcntl.h>
#include <netdb.h>
#include <stdio.h>
#include <string.h>
#include <sys/resource.h>
#include <sys/socket.h>
#include <sys/un.h>
#include <unistd.h>

#include "server/access.h"
#include "server/config.h"
#include "server/log.h"
#include "server/notify.h"
#include "server/server.h"

/* Open files besides connections: measured 60 with PoCL, SQLite, listeners. */
#define FILES_BESIDES 256

/* The address the listener has, as a URL. */
static void print_url(const struct http *h, char url[static HTTP_URL_MAX])
{
	struct sockaddr_storage address = {0};
	const struct sockaddr_un *un = (const struct sockaddr_un *)&address;
	socklen_t size = sizeof address;
	const char *scheme = h->server->tls != NULL ? "https" : "http";
	char host[256] = "", port[16] = "";
	bool is_v6;

	getsockname(h->listener, (struct sockaddr *)&address, &size);
	if (address.ss_family == AF_UNIX) {
		snprintf(url, HTTP_URL_MAX, "%s+unix:%s", scheme,
		    un->sun_path);
		return;
	}
	getnameinfo((struct sockaddr *)&address, size, host, sizeof host, port,
	    sizeof port, NI_NUMERICHOST | NI_NUMERICSERV);
	is_v6 = address.ss_family == AF_INET6;
	snprintf(url, HTTP_URL_MAX, "%s://%s%s%s:%s", scheme,
	    is_v6 ? "[" : "", host, is_v6 ? "]" : "", port);
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
static int open_own(const struct config *config)
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

/* The one that the service manager has passed, as libmicrohttpd wants it. */
static int take_passed(int fd)
{
	int flags = fcntl(fd, F_GETFL);

	fcntl(fd, F_SETFD, FD_CLOEXEC);
	if (flags >= 0 && fcntl(fd, F_SETFL, flags | O_NONBLOCK) == 0)
		return fd;
	log_write(LOG_ERROR, "the socket that was passed: %s",
	    strerror(errno));
	return -1;
}

enum err listener_open(struct http *h, char url[static HTTP_URL_MAX])
{
	const struct config *config = h->server->config;
	int passed;

	/* Whoever has given a key does not want plain HTTP. */
	if (h->server->tls == NULL && config->tls_key[0] != '\0') {
		log_write(LOG_ERROR, "--tls-key is there, but no --tls-cert: "
		    "HTTPS needs both");
		return ERR_INVALID;
	}
	passed = notify_listener();
	if (passed < -1)
		return ERR_INVALID;
	h->is_passed = passed >= 0;
	h->listener = h->is_passed ? take_passed(passed) : open_own(config);
	if (h->listener < 0)
		return ERR_IO;
	h->listener = access_check_listener(h->server, h->listener);
	if (h->listener < 0)
		return ERR_INVALID;
	print_url(h, url);
	return ERR_OK;
}

void listener_make_room(struct http *h)
{
	rlim_t need = (rlim_t)h->most + FILES_BESIDES;
	struct rlimit limit;

	if (getrlimit(RLIMIT_NOFILE, &limit) != 0 ||
	    limit.rlim_cur == RLIM_INFINITY || limit.rlim_cur >= need)
		return;
	limit.rlim_cur = limit.rlim_max < need ? limit.rlim_max : need;
	if (setrlimit(RLIMIT_NOFILE, &limit) != 0)
		getrlimit(RLIMIT_NOFILE, &limit);
	if (limit.rlim_cur >= need)
		return;
	h->most = limit.rlim_cur > 2 * FILES_BESIDES ?
	    (size_t)limit.rlim_cur - FILES_BESIDES :
	    (size_t)limit.rlim_cur / 2;
	log_write(LOG_WARNING, "only %llu files may be open at a time: there "
	    "will be %zu connections at most, not %zu (ulimit -n)",
	    (unsigned long long)limit.rlim_cur, h->most,
	    h->server->config->max_connections);
}
