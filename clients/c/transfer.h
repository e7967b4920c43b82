/*
 * One request of the C client and its answer: libcurl's side of it. While an
 * answer is awaited, a second connection asks how far the work is.
 */
#ifndef CLIENTS_C_TRANSFER_H
#define CLIENTS_C_TRANSFER_H

#include <stdatomic.h>
#include <stdbool.h>
#include <stdio.h>

#include <curl/curl.h>

#include "clients/c/blobfield.h"

#define TRANSFER_TOKEN_MAX 40

struct transfer_request {
	const char *method;
	const char *path;   /* and query */
	const char *type;   /* of body; NULL: none */
	const char *accept; /* NULL: any */
	const char *line;   /* one more header, "Name: value"; NULL: none */
	const void *body;   /* NULL: none */
	size_t size;
	bool is_long;       /* the daemon knows how far it is */

	/* Where an answer of a status below 400 goes: to into, which must be as
	 * long as it is, or to file, or piece by piece to take, or, if all are
	 * NULL, to the answer's bytes. Others always go to those. What take
	 * returns ends the transfer, unless it is OK. */
	void *into;
	size_t into_size;
	FILE *file;
	enum blobfield_outcome (*take)(void *ctx, const char *data, size_t n);
	void *ctx;

	double silence;     /* s without a byte: UNREACHABLE; 0: for ever */
};

struct transfer {
	CURLM *multi;
	CURL *main, *side;
	char url[512];
	char authorization[288];    /* a header's line; "": none */
	char *ca_file, *ca_folder;  /* libcurl's own; it frees them */
	double deadline;
	int (*progress)(void *ctx, const char *stage, double done);
	void *ctx;
	atomic_bool cancelled;

	/* of the last answer */
	long status;
	struct blobfield_bytes bytes;
	size_t arrived;             /* in into or file */
	char reason[CURL_ERROR_SIZE];
};

/* false: libcurl does not start. */
bool transfer_init(struct transfer *t, const char *url);
void transfer_fini(struct transfer *t);

/* The file of certificates to trust; NULL: the system's. */
enum blobfield_outcome transfer_set_ca(struct transfer *t, const char *path);

/* Sleeps; CANCELLED as in transfer_do. */
enum blobfield_outcome transfer_wait(struct transfer *t, double seconds);

/* OK once an answer is there whole, whatever its status; UNREACHABLE, with
 * t->reason; CANCELLED; STRANGE: longer than into, or shorter; FILE; MEMORY. */
enum blobfield_outcome transfer_do(struct transfer *t,
    const struct transfer_request *request);

#endif
