/*
 * What a request's head must keep before its body is read: stricter than
 * libmicrohttpd, which accepts ambiguous framing (RFC 9112 section 6.3).
 */
#ifndef SERVER_FRAMING_H
#define SERVER_FRAMING_H

#include <stdbool.h>

struct exchange;

/*
 * Checks the bytes of the head (tokens, line ends, no folding, no control
 * characters), version, Host, Content-Length, Transfer-Encoding,
 * Content-Encoding and the length that the head promises. True: all is well;
 * false: answered with what is wrong, and the connection is closed behind it.
 * Call in the first access callback: the head is where it was read to.
 */
bool framing_check(struct exchange *x, const char *version);

#endif
