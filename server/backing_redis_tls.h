/*
 * TLS on a connection to Redis, by GnuTLS, as the daemon's own HTTPS: Debian's
 * hiredis (0.14) has none. The server's certificate has to be of an authority that
 * is trusted, in its time, and for the host that the URL names. For one thread at
 * a time; what waits ends when the socket is shut down by another.
 */
#ifndef SERVER_BACKING_REDIS_TLS_H
#define SERVER_BACKING_REDIS_TLS_H

#include <stdbool.h>
#include <stddef.h>
#include <sys/types.h>

#include "core/err.h"

struct backing_redis_tls;
struct backing_redis_url;

#define BACKING_REDIS_TLS_WHY_MAX 200

/* Whether the files that url names can be used; else ERR_INVALID or ERR_MEMORY,
 * with why. */
enum err backing_redis_tls_check(const struct backing_redis_url *url,
    char why[static BACKING_REDIS_TLS_WHY_MAX]);

/*
 * Shakes hands over fd, a connected socket that stays the caller's, with url's
 * host, within about so many milliseconds. Files are read anew each time.
 * ERR_UNAVAILABLE, with why.
 */
enum err backing_redis_tls_open(const struct backing_redis_url *url, int fd,
    unsigned milliseconds, struct backing_redis_tls **out,
    char why[static BACKING_REDIS_TLS_WHY_MAX]);

/* NULL does nothing. */
void backing_redis_tls_close(struct backing_redis_tls *tls);

/* All of data; and what has come, at least a byte, 0 at the end. -1 or false:
 * the connection is lost; errno is EAGAIN where the socket's time limit has passed,
 * and backing_redis_tls_why says more. */
bool backing_redis_tls_send(struct backing_redis_tls *tls, const void *data,
    size_t length);
ssize_t backing_redis_tls_receive(struct backing_redis_tls *tls, void *out,
    size_t size);

const char *backing_redis_tls_why(struct backing_redis_tls *tls);

/* Whether the other end has closed a connection on which nothing was asked. */
bool backing_redis_tls_is_hung_up(struct backing_redis_tls *tls);

#endif
