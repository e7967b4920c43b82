/*
 * What the files of the C client share: a struct blobfield, and how calls are
 * made.
 */
#ifndef CLIENTS_C_CLIENT_H
#define CLIENTS_C_CLIENT_H

#include "clients/c/blobfield.h"
#include "clients/c/transfer.h"

#define CLIENT_PATH_MAX 512

#define CLIENT_JSON "application/json"
#define CLIENT_OCTETS "application/octet-stream"

struct blobfield {
	struct transfer transfer;
	struct blobfield_error error;
	char header[1024]; /* blobfield_header's */
};

/* Fails a call that has sent nothing. */
enum blobfield_outcome client_fail(struct blobfield *b,
    enum blobfield_outcome outcome, const char *detail, ...)
    __attribute__((format(printf, 3, 4)));

/* Sends, and fills b->error by what comes of it. */
enum blobfield_outcome client_do(struct blobfield *b,
    const struct transfer_request *request);

/* "/v1/scenes/{id}" and tail; ARGUMENT if id is none. */
enum blobfield_outcome client_path(struct blobfield *b,
    char path[CLIENT_PATH_MAX], const char *id, const char *tail);

/* A text of the summary that keeping a scene answers with; STRANGE if it has
 * none of that name. */
enum blobfield_outcome client_read_summary(struct blobfield *b,
    const char *name, char *out, size_t size);

/* The last answer's bytes to *out, which the caller frees. */
void client_take(struct blobfield *b, struct blobfield_bytes *out);

#endif
