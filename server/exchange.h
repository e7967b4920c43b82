/*
 * One request and the answer it gets: what handlers work on.
 *
 * Threads: an exchange belongs to the thread that calls the handler, an HTTP
 * thread or a reader (server/readers.h), until exchange_wait; then to nobody,
 * until exchange_resume, which any thread may call once; then to an HTTP thread.
 * It is not resumed before the handler has returned.
 */
#ifndef SERVER_EXCHANGE_H
#define SERVER_EXCHANGE_H

#include <stdatomic.h>
#include <stdbool.h>
#include <stddef.h>

#include "core/err.h"
#include "proto/request.h"
#include "server/problem.h"
#include "server/trace.h"

struct MHD_Connection;
struct MHD_Response;
struct cJSON;
struct faults;
struct route;
struct server;
struct token;

#define EXCHANGE_ID_MAX 128
#define EXCHANGE_TARGET_MAX 256
#define EXCHANGE_JOINED_MAX 8

/*
 * Where a body goes as it arrives, instead of to memory as a whole: the first
 * member of what it is of.
 */
struct sink {
	/* False: nothing that follows matters; the handler will say why. */
	bool (*feed)(struct sink *sink, const char *data, size_t length);
	size_t (*bytes)(const struct sink *sink); /* of memory held */
	/* Bytes that are kept for the handler to parse; NULL: hardly any. */
	size_t (*left)(const struct sink *sink);
	void (*free)(struct sink *sink);
};

/*
 * An answer that is written as it leaves: read puts the next bytes, at most
 * size of them, and returns how many; or EXCHANGE_PAUSED after exchange_pause,
 * EXCHANGE_END behind the last, or EXCHANGE_CUT: the connection is cut, for the
 * client to see that something is missing. It runs on the HTTP thread. ctx
 * lives until x->state_free.
 */
enum exchange_read {
	EXCHANGE_PAUSED = 0,
	EXCHANGE_END = -1,
	EXCHANGE_CUT = -2
};

struct exchange_stream {
	ptrdiff_t (*read)(void *ctx, char *out, size_t size);
	void *ctx;
	bool has_length;  /* length is what there will be, else about that */
	size_t length;
};

struct exchange {
	struct server *server;
	const struct route *route;
	const char *method;
	char id[EXCHANGE_ID_MAX + 1]; /* what stands for {id} in the path */

	/* The body, complete when the handler is called, which may free it with
	 * exchange_release_body. */
	char *body;
	size_t body_length;
	struct sink *sink; /* what it went to instead, if route->open said so */
	size_t promised;   /* its length by Content-Length, or 0 */

	/* A handler that waits sets these; state_free is called at the end. */
	void *state;
	void (*state_free)(void *state, struct server *server);
	void (*resumed)(struct exchange *x); /* answers after exchange_resume */

	/* who asks */
	const struct token *token; /* access.h; NULL: nobody in particular */
	char peer[48];             /* address, of the connection */
	char request_id[TRACE_ID_MAX + 1];
	char trace_id[33], parent_id[17]; /* of traceparent, or "" */
	char forwarded_for[TRACE_FORWARDED_MAX + 1]; /* not to be trusted */

	/* http.c's own */
	struct MHD_Connection *connection;
	int socket;
	struct MHD_Response *response;
	unsigned status;
	enum problem problem; /* PROBLEM_COUNT: it was not answered with one */
	size_t answer_length;
	bool checked;        /* the first callback has seen it */
	bool owed;           /* counted by http_owed */
	bool waiting;
	bool is_away;        /* a reader calls its handler */
	bool waits_again;    /* which has called exchange_wait */
	bool is_read;        /* libmicrohttpd waits for no more of it */
	atomic_int parties;  /* that have to let go of it for it to go on */
	bool hung_up;        /* answer nothing, close */
	bool is_cut;         /* its answer ended before its end */
	bool refused_midway; /* answered while the body was arriving */
	bool discard;        /* the body is of no interest */
	bool is_fed_up;      /* sink->feed has said so */
	size_t body_size;    /* memory accounted for */
	size_t text_size;    /* the same by http_take_text */
	size_t body_seen;    /* bytes that have arrived */
	struct exchange_stream stream;
	double begun;        /* when the request line came, clock_seconds */
	double arrived;      /* when its body was complete, or 0 */
	double sending;      /* since when the answer leaves, clock_seconds,
	                      * later by all pauses */
	double paused;       /* when exchange_pause was called, or 0 */
	char target[EXCHANGE_TARGET_MAX]; /* path and query as sent, for the log */
	size_t target_length;             /* uncut */
	const char *target_end;           /* in libmicrohttpd's memory */
	bool path_has_nul, target_has_nul; /* as %00 */
	bool target_is_odd;                /* has blanks, control characters */
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

/* Whether x arrived after the drain began, so that no work may be begun for it. */
bool exchange_is_late(const struct exchange *x);

/* Takes the connection out of HTTP's hands until exchange_resume. */
void exchange_wait(struct exchange *x);
void exchange_resume(struct exchange *x);

/*
 * For another thread than HTTP's to call the handler of x, which waits: takes x
 * over, and gives it back behind the handler, to be answered or to go on
 * waiting.
 */
void exchange_take_over(struct exchange *x);
void exchange_hand_back(struct exchange *x);

/*
 * Whether the client's connection still stands; any thread, as long as x is not
 * over.
 */
bool exchange_is_connected(const struct exchange *x);

/*
 * For exchange_stream.read: takes the connection out of HTTP's hands until
 * exchange_resume, which is not to come before this returns. The answer's
 * deadline stands still.
 */
void exchange_pause(struct exchange *x);

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

void exchange_reply_stream(struct exchange *x, enum media_type type,
    const struct exchange_stream *stream);

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
