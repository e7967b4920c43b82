/*
 * What ties a request's log line to its client's: request ids (X-Request-Id),
 * W3C Trace Context (traceparent), and what proxies say of clients
 * (X-Forwarded-For).
 */
#ifndef SERVER_TRACE_H
#define SERVER_TRACE_H

struct exchange;

#define TRACE_ID_MAX 64
#define TRACE_FORWARDED_MAX 200

/* Fills x->request_id, from X-Request-Id if that is of 1 to 64 of
 * A-Z a-z 0-9 . _ : - , else made; and x->trace_id and x->parent_id from a valid
 * traceparent, else ""; and x->forwarded_for with what X-Forwarded-For says, its
 * end where that is longer: the last address is that which the nearest proxy has
 * seen. Any client can say anything there: it is for the log, and decides
 * nothing. */
void trace_begin(struct exchange *x);

/* Adds X-Request-Id to x's answer. */
void trace_add_headers(struct exchange *x);

#endif
