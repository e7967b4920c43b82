/*
 * An evaluation between its request and its answer: shared by evaluation.c,
 * which has the scheduler's side of it, and evaluation_answer.c, which has
 * HTTP's.
 *
 * Threads: two hold it, the exchange until it is over and the scheduler until
 * done(); the last to let go frees it. What the lock guards is said below; the
 * job is the device's until is_done, HTTP's from then on. Lock order: the
 * scheduler's before this one, this one before libmicrohttpd's.
 */
#ifndef SERVER_EVALUATION_INTERNAL_H
#define SERVER_EVALUATION_INTERNAL_H

#include <pthread.h>
#include <stdatomic.h>
#include <stdbool.h>
#include <stddef.h>

#include "proto/answer.h"
#include "proto/points.h"
#include "proto/request.h"
#include "server/etag.h"
#include "server/scheduler.h"

struct answer_stream;
struct exchange;
struct server;

/* Room for pieces: of SCHEDULER_PIECES, and of one that is handed over all the
 * same. */
#define PIECES_ROOM (SCHEDULER_PIECES + 1)

/* Bytes of JSON that a number takes, about. */
#define NUMBER_BYTES 12

struct piece {
	float *rows;
	size_t bytes;
};

struct evaluation {
	struct server *server;
	struct job job;
	struct points points; /* freed when the job is done */
	enum media_type accept;
	bool flat;            /* as points.flat */
	bool is_grid;
	size_t counts[3];     /* of the grid */
	bool is_large;        /* its answer leaves as it is made */
	bool in_pieces;       /* ... and its rows come in pieces */
	char etag[ETAG_SIZE]; /* "": none */
	double begun;         /* when the request's head came, clock_seconds */
	double submitted, finished;
	atomic_int holders;

	pthread_mutex_t lock; /* guards: */
	struct exchange *x;   /* NULL: over */
	bool is_suspended;    /* x is, until somebody wakes it */
	bool is_done;
	bool is_draft;        /* what has come is of drafts */
	bool overrun;         /* a piece came that there was no room for */
	struct piece pieces[PIECES_ROOM]; /* a ring */
	size_t first, held;

	/* HTTP's alone */
	char head[ANSWER_NPY_HEADER_MAX]; /* before the rows */
	size_t head_length, head_read;
	size_t read;          /* bytes of the first piece that have left */
	struct answer_stream *text;
	double printing;      /* seconds */
};

/* What the exchange does when it is resumed for the first time: answers. */
void evaluation_answer(struct exchange *x);

/* Frees what the answer holds. */
void evaluation_answer_fini(struct evaluation *e);

#endif
