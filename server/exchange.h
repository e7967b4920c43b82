/*
 * One request and the answer it gets: what handlers work on.
 *
 * Threads: an exchange belongs to the HTTP thread that calls the handler,
 * until exchange_wait; then to nobody, until exchange_resume, which any thread
 * may call once; then to the HTTP thread again.
 */
#ifndef SERVER_EXCHANGE_H
#define SERVER_EXCHANGE_H

#include <stdbool.h>
#include <stddef.h>

#include "core/err.h"
#include "proto/request.h"
#include "server/problem.h"

struct MHD_Connection;
struct MHD_Response;
struct cJSON;
struct faults;
struct route;
struct server;

#define EXCHANGE_ID_MAX 128
#define EXCHANGE_TARGET_MAX 256
#define EXCHANGE_JOINED_MAX 8

struct exchange {
	struct server *server;
	const struct route *route;
	const char *method;
	char id[EXCHANGE_ID_MAX + 1]; /* what stands for {id} in the path */

	/* The body, complete when the handler is called; body_release frees. */
	char *body;
	size_t body_length;

	/* A handler that waits sets these; state_free is called at the end. */
	void *state;
	void (*state_free)(void *state, struct server *server);
	void (*resumed)(struct exchange *x); /* answers after exchange_resume */

	/* http.c's own */
	struct MHD_Connection *connection;
	int socket;
	struct MHD_Response *response;
	unsigned status;
	size_t answer_length;
	bool checked;        /* the first callback has seen it */
	bool owed;           /* counted by http_owed */
	bool waiting;
	bool hung_up;        /* answer nothing, close */
	bool refused_midway; /* answered while the body was arriving */
	bool discard;        /* the body is of no interest */
	size_t body_size;    /* allocated */
	size_t body_seen;    /* bytes that have arrived */
	double begun;
	char target[EXCHANGE_TARGET_MAX]; /* path and query as sent, for the log */
	size_t target_length;             /* uncut */
	const char *target_end;           /* in libmicrohttpd's memory */
	bool path_has_nul, target_has_nul; /* as %00 */
	char *joined[EXCHANGE_JOINED_MAX];
};

/* ---- the request ---- */

/*
 * A header's value, several lines of it joined by ", "; NULL if there is none.
 * Valid as long as x.
 */
const char *exchange_header(struct exchange *x, const char *name);

/* A query parameter's value, "" if it has none; NULL if it is not there. */
const char *exchange_query(struct exchange *x, const char *name);

/* Frees the body early, which may be large. */
void exchange_release_body(struct exchange *x);

/*
 * Whether the body is of one of the media types in mask (1u << MEDIA_*), in
 * *out; answers 415 otherwise, also where no type is said.
 */
bool exchange_check_content_type(struct exchange *x, unsigned mask,
    enum media_type *out);

/* ---- waiting ---- */

/* Takes the connection out of HTTP's hands until exchange_resume. */
void exchange_wait(struct exchange *x);
void exchange_resume(struct exchange *x);

/* Whether the client's connection still stands; any thread, while waiting. */
bool exchange_is_connected(const struct exchange *x);

/* ---- the answer: exactly one of these, then headers ---- */

/* Takes json over. */
void exchange_reply_json(struct exchange *x, unsigned status,
    struct cJSON *json);

/* Takes data (malloc'd) over. */
void exchange_reply_data(struct exchange *x, unsigned status,
    enum media_type type, void *data, size_t length);

/* header is copied; data (malloc'd) is taken over and not copied. */
void exchange_reply_two(struct exchange *x, enum media_type type,
    const void *header, size_t header_length, void *data, size_t length);

/* Borrows data until release(owner) is called. */
void exchange_reply_borrowed(struct exchange *x, unsigned status,
    enum media_type type, const void *data, size_t length,
    void (*release)(void *owner), void *owner);

void exchange_reply_empty(struct exchange *x, unsigned status);

/* problem+json, with Retry-After where its kind has one; faults may be NULL. */
void exchange_reply_problem(struct exchange *x, enum problem problem,
    const struct faults *faults, const char *detail, ...)
    __attribute__((format(printf, 4, 5)));

/* The client has gone: close without an answer. */
void exchange_reply_nothing(struct exchange *x);

void exchange_add_header(struct exchange *x, const char *name,
    const char *value);

#endif
