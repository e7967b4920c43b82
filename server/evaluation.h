/*
 * What both evaluation handlers share: from a program and points to an answer.
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

/* The media type that x's Accept asks for, in *out; or answers 406: false. */
bool evaluation_check_accept(struct exchange *x, enum media_type *out);

/* The outputs that x's query asks for, in *out; or answers 422: false. */
bool evaluation_check_outputs(struct exchange *x, unsigned *out);

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
	enum media_type accept;
	const char *etag;        /* of the revision; NULL: none */
};

/* Queues the evaluation and has x wait for it; or answers x at once. */
void evaluation_begin(struct exchange *x,
    const struct evaluation_request *request);

#endif
