/*
 * Where a Redis is:
 *   redis://[[user]:password@]host[:port][/database][?prefix=NAME]
 *   rediss://…, the same by TLS; further in its query: ca=FILE, certificates to
 *     trust instead of the system's; cert=FILE and key=FILE, to show to Redis
 *   redis+unix://[[user]:password@]/path[?database=N&prefix=NAME]
 * User, password and files may have %XX. Keys begin with "{NAME}:", so that a cluster
 * has all of them in one slot; NAME is "blobfield" unless said.
 */
#ifndef SERVER_BACKING_REDIS_URL_H
#define SERVER_BACKING_REDIS_URL_H

#include <stdbool.h>

#include "core/err.h"

#define BACKING_REDIS_PREFIX_MAX 64

struct backing_redis_url {
	char host[256];      /* or a socket's path */
	int port;            /* 0: it is a path */
	int database;
	char user[128], password[256]; /* "": none */
	char prefix[BACKING_REDIS_PREFIX_MAX + 4]; /* "{blobfield}:" */
	bool is_tls;
	char ca[512];        /* files, PEM; "": none said */
	char cert[512], key[512]; /* both or none */
	char shown[300];     /* for the log: no password */
};

/* ERR_INVALID: it is none; *why tells. */
enum err backing_redis_url_parse(const char *text,
    struct backing_redis_url *out, const char **why);

#endif
