/*
 * By which names the daemon may be asked. A page whose host name is made to
 * resolve to 127.0.0.1 (DNS rebinding) is of the daemon's origin to its browser,
 * and may do what anybody on this machine may; but its requests have that name
 * in their Host header.
 *
 * Always allowed: addresses, which nobody makes resolve to others; "localhost"
 * and names that end with ".localhost" (RFC 6761, section 6.3); --listen's host.
 * Further ones are --hosts'. Case, a port, and one dot at the end do not matter.
 */
#ifndef SERVER_HOST_H
#define SERVER_HOST_H

#include <stdbool.h>

struct config;
struct exchange;

/* Whether names, as --hosts has them, are host names by commas, without ports;
 * or "*", or "". Logs what is none. */
bool host_names_are_valid(const char *names);

/*
 * Whether host, as a Host header has it, is allowed where --hosts and --listen
 * are config's. What is none at all is not.
 */
bool host_is_allowed(const struct config *config, const char *host);

/*
 * Whether x, whose route is known unless it has none, may be asked by its Host
 * and, of a target in absolute form, by that. Any name will do with --hosts *,
 * and, without --hosts, where there are tokens (a page has none) or --insecure;
 * for /healthz and /readyz; and without the header, which HTTP/1.0 may have and no
 * browser. False: answered with 421.
 */
bool host_check(struct exchange *x, const char *target);

#endif
