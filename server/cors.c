#include "server/cors.h"

#include <string.h>

#include "server/config.h"
#include "server/exchange.h"
#include "server/log.h"
#include "server/server.h"

#define MAX_AGE "600"
#define ALLOW_HEADERS "Authorization, Content-Type, If-Match, " \
	"If-None-Match, Last-Event-ID, X-Request-Id, traceparent, tracestate"
#define EXPOSE_HEADERS "ETag, Location, Retry-After, Server-Timing, " \
	"X-Request-Id, Blobfield-Draft, Blobfield-Mesh, WWW-Authenticate"

/* The next of origins, of *length characters, 0 at the end; spaces about it are
 * left out. *rest is moved past it. */
static const char *next_origin(const char **rest, size_t *length)
{
	const char *at = *rest + strspn(*rest, ", \t");
	const char *end = at + strcspn(at, ",");

	*rest = end;
	while (end > at && (end[-1] == ' ' || end[-1] == '\t'))
		end--;
	*length = (size_t)(end - at);
	return at;
}

/* scheme://host or scheme://host:port, or null. */
static bool is_origin(const char *at, size_t length)
{
	static const char letters[] = "abcdefghijklmnopqrstuvwxyz0123456789"
	    "-._:[]";
	const char *host = memmem(at, length, "://", 3);
	const size_t scheme = host != NULL ? (size_t)(host - at) : 0;

	if (length == 4 && memcmp(at, "null", 4) == 0)
		return true;
	if (scheme == 0 || length - scheme - 3 == 0 ||
	    strspn(at, "abcdefghijklmnopqrstuvwxyz0123456789+-.") < scheme)
		return false;
	return strspn(host + 3, letters) >= length - scheme - 3;
}

bool cors_check(const char *origins)
{
	const char *rest = origins, *at;
	size_t length;

	if (strcmp(origins, "*") == 0)
		return true;
	while (at = next_origin(&rest, &length), length > 0) {
		if (is_origin(at, length))
			continue;
		log_write(LOG_ERROR, "--cors-origin: '%.*s' is no origin: "
		    "scheme://host or scheme://host:port, in small letters, "
		    "nothing behind; or * alone", (int)length, at);
		return false;
	}
	return true;
}

/* Compared byte by byte, as the standard says. */
static bool is_listed(const char *origins, const char *origin)
{
	const size_t n = strlen(origin);
	const char *at;
	size_t length;

	while (at = next_origin(&origins, &length), length > 0) {
		if (length == n && memcmp(at, origin, n) == 0)
			return true;
	}
	return false;
}

/* What Access-Control-Allow-Origin says to x, or NULL. */
static const char *allowed(struct exchange *x)
{
	const char *origins = x->server->config->cors;
	const char *origin = exchange_header(x, "Origin");

	if (origins[0] == '\0' || origin == NULL)
		return NULL;
	if (strcmp(origins, "*") == 0)
		return "*";
	return is_listed(origins, origin) ? origin : NULL;
}

void cors_add_headers(struct exchange *x)
{
	const char *origins = x->server->config->cors;
	const char *origin = allowed(x);

	if (origins[0] != '\0' && strcmp(origins, "*") != 0)
		exchange_add_header(x, "Vary", "Origin");
	if (origin == NULL)
		return;
	exchange_add_header(x, "Access-Control-Allow-Origin", origin);
	exchange_add_header(x, "Access-Control-Expose-Headers",
	    EXPOSE_HEADERS);
}

void cors_preflight(struct exchange *x, const char *allow)
{
	if (exchange_header(x, "Access-Control-Request-Method") == NULL ||
	    allowed(x) == NULL)
		return;
	exchange_add_header(x, "Access-Control-Allow-Methods", allow);
	exchange_add_header(x, "Access-Control-Allow-Headers", ALLOW_HEADERS);
	exchange_add_header(x, "Access-Control-Max-Age", MAX_AGE);
}
