/*
 * CORS (Fetch Standard, section 3.2): which web pages' scripts may read answers
 * (--cors-origin). It protects users of browsers from pages, not the daemon
 * from anybody.
 *
 * Credentials mode is never allowed: tokens are sent as headers by scripts that
 * have them, not as cookies by browsers.
 */
#ifndef SERVER_CORS_H
#define SERVER_CORS_H

#include <stdbool.h>

struct exchange;

/*
 * Whether a text of --cors-origin is right: "", "*", or origins by commas:
 * scheme://host or scheme://host:port as browsers send them, without a path, in
 * small letters; or "null", which pages from files and sandboxes have, any of
 * them. Else the log says what is wrong.
 */
bool cors_check(const char *origins);

/* Adds Access-Control-Allow-Origin and its like to x's answer where its Origin
 * is allowed; Vary: Origin whenever that depends on the origin. */
void cors_add_headers(struct exchange *x);

/* For OPTIONS with Access-Control-Request-Method: adds what a preflight asks
 * for; allow are the methods of the path. */
void cors_preflight(struct exchange *x, const char *allow);

#endif
