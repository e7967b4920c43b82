/*
 * The one table of what the daemon serves.
 */
#ifndef SERVER_ROUTES_H
#define SERVER_ROUTES_H

#include <stdbool.h>
#include <stddef.h>

#include "server/access.h"

struct exchange;

struct route {
	const char *method;   /* GET also serves HEAD */
	const char *pattern;  /* "{id}" stands for one segment */
	enum role role;       /* that a token must have */
	const char *query;    /* parameters it knows: " a b" or "" */
	bool has_body;
	void (*open)(struct exchange *x); /* before its body: may say what
	                                   * becomes of it, or answer; or NULL */
	bool is_probe;        /* asked often: its log lines are LOG_DEBUG */
	void (*handle)(struct exchange *x);
	const char *summary;  /* for the index */
};

/* What a path and a method came to. */
enum route_outcome {
	ROUTE_FOUND,
	ROUTE_NO_PATH,   /* 404 */
	ROUTE_NO_METHOD, /* 405; allow is filled */
	ROUTE_OPTIONS    /* allow is filled */
};

#define ROUTE_ALLOW_MAX 64

/*
 * Finds the route of method and path, which may also be a whole http URL, or *
 * for OPTIONS. id (id_size bytes) gets what stands for {id}, cut to size, "" if
 * nothing does.
 */
enum route_outcome route_find(const char *method, const char *path,
    const struct route **out, char *id, size_t id_size,
    char allow[static ROUTE_ALLOW_MAX]);

/*
 * Whether a path, as sent, of length bytes, has an escape that stands for a '/'
 * (%2F) or for a character that needs none (RFC 3986, section 2.3). No path here
 * needs them, and proxies that decide by the path see another one than the
 * daemon: they are as paths that do not exist.
 */
bool route_has_odd_escape(const char *path, size_t length);

/* Which of the parameters that route knows name is; -1: none. */
int route_query_index(const struct route *route, const char *name);

/* All routes, for the index. */
const struct route *route_list(size_t *count);

#endif
