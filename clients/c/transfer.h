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
	const void *body;   /* NULL: none */
	size_t size;
	bool is_long;       /* the daemon knows how far it is */

	/* Where an answer of a status below 400 goes: to into, which must be as
	 * long as it is, or to file, or, if both are NULL, to the answer's
	 * bytes. Others always go to those. */
	void *into;
	size_t into_size;
	FILE *file;
};

struct transfer {
	CURLM *multi;
	CURL *main, *side;
	char url[512];
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

/* OK once an answer is there whole, whatever its status; UNREACHABLE, with
 * t->reason; CANCELLED; STRANGE: longer than into, or shorter; FILE; MEMORY. */
enum blobfield_outcome transfer_do(struct transfer *t,
    const struct transfer_request *request);

#endif
