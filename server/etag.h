/*
 * Entity tags of scene revisions, and preconditions (RFC 9110 section 13).
 */
#ifndef SERVER_ETAG_H
#define SERVER_ETAG_H

#include <stdbool.h>
#include <stddef.h>

#define ETAG_DIGITS 32
#define ETAG_SIZE (ETAG_DIGITS + 3) /* quotes and NUL */

/* The strong tag of a document's bytes: its SHA-256, cut to 128 bits. */
void etag_of(const void *data, size_t length, char out[static ETAG_SIZE]);

/* If-Match and If-None-Match; NULL where the request has none. */
struct precondition {
	const char *match, *none_match;
};

/* Whether both are lists of quoted tags, or "*". */
bool precondition_is_valid(const struct precondition *precondition);

/*
 * Whether each is fulfilled when the resource's tag is now etag, NULL if there
 * is no resource. If-Match compares strongly, If-None-Match weakly.
 */
bool precondition_match(const struct precondition *precondition,
    const char *etag);
bool precondition_none_match(const struct precondition *precondition,
    const char *etag);

#endif
