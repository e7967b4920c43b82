/*
 * A blocking HTTP client for wire tests: well-formed requests by libcurl, and
 * raw bytes for the others.
 */
#ifndef TESTS_SUPPORT_HTTP_H
#define TESTS_SUPPORT_HTTP_H

#include <stddef.h>

struct http_request {
	const char *method;   /* NULL: GET without, POST with body */
	const char *path;
	const void *body;     /* NULL: none */
	size_t length;
	const char *headers[6]; /* "Name: value", up to a NULL */
};

struct http_reply {
	long status;          /* 0: no answer */
	char *headers;        /* all lines */
	char *body;           /* length bytes and a NUL */
	size_t length;
};

/* May be called by several threads. The reply is for http_reply_fini. */
void http_do(const char *url, const struct http_request *request,
    struct http_reply *out);
void http_get(const char *url, const char *path, struct http_reply *out);

/* Sends body as application/json. */
void http_json(const char *url, const char *method, const char *path,
    const char *body, struct http_reply *out);

/* Frees the contents; status and length stay. */
void http_reply_fini(struct http_reply *reply);

/* The value of a header of reply to out, "" if there is none; returns out. */
char *http_header(const struct http_reply *reply, const char *name, char *out,
    size_t size);

/*
 * Sends length bytes as they are to 127.0.0.1:port and reads until the server
 * closes, or nothing comes for 5 s. Returns the status of the first answer, 0
 * if there is none; its text, cut to size, in out.
 */
int http_raw(int port, const char *bytes, size_t length, char *out,
    size_t size);

/* A connected socket. */
int http_connect(int port);

#endif
