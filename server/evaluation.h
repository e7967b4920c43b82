/*
 * What both evaluation handlers share: from a program and points to an answer.
 * Small answers leave whole. Large ones leave as they are made: rows in the
 * pieces that the device hands over, JSON printed from all rows.
 */
#ifndef SERVER_EVALUATION_H
#define SERVER_EVALUATION_H

#include <stdbool.h>

#include "core/err.h"
#include "proto/request.h"

struct document;
struct exchange;
struct faults;
struct program;
struct server;

/* Batches up to this many points are interactive unless they say otherwise,
 * and their answers leave whole. */
#define EVALUATION_SMALL_POINTS 65536

/* So do answers of up to so many bytes of rows. */
#define EVALUATION_SMALL_BYTES ((size_t)4 << 20)

enum evaluation_priority {
	EVALUATION_BY_SIZE,
	EVALUATION_INTERACTIVE,
	EVALUATION_BULK
};

/* What a request's head asks for. */
struct evaluation_terms {
	enum media_type accept;
	unsigned outputs;        /* OUTPUT_*, if the body says nothing */
	enum evaluation_priority priority;
	double deadline;         /* seconds from its beginning; 0: none */
};

/*
 * Compiles document, of which it takes the tape, into *out, for
 * scheduler_release. ERR_LIMIT: its tables are too large, told in faults below
 * pointer, the document's; ERR_MEMORY. Any thread.
 */
enum err evaluation_program(struct server *server, const char *pointer,
    struct document *document, struct program **out, struct faults *faults);

/*
 * Compiles document, of which it takes the tape, into *out, for
 * scheduler_release; or answers x with what is wrong: false. pointer is the
 * document's in x's body.
 */
bool evaluation_compile(struct exchange *x, const char *pointer,
    struct document *document, struct program **out);

/* Answers x with what is wrong with its content. */
void evaluation_reply_faults(struct exchange *x, enum err err,
    const struct faults *faults);

struct evaluation_request {
	struct program *program; /* a reference, taken over */
	struct points *points;   /* taken over, left empty */
	unsigned outputs;
	const struct evaluation_terms *terms;
	const char *etag;        /* of the revision; NULL: none */
	const size_t *counts;    /* points are a grid of so many along x, y, z,
	                          * z fastest; NULL: a list */
};

/* Queues the evaluation and has x wait for it; or answers x at once. Releases
 * x's body, and the terms with it. */
void evaluation_begin(struct exchange *x,
    const struct evaluation_request *request);

#endif
