/*
 * What documents may hold, by the daemon's configuration and its volumes.
 */
#ifndef SERVER_LIMITS_H
#define SERVER_LIMITS_H

#include "proto/document.h"

struct server;

/*
 * Of a document's text. 32768 nodes with ids, matrices of 17 digits and
 * operators of their own, indented, have 15 MB at most; and HTTP's threads, who
 * parse documents, are to do so in a fraction of a second: 16 MB take a core 0.1
 * to 0.5 s, whatever they are.
 */
#define LIMITS_DOCUMENT_BYTES ((size_t)16 << 20)

/* For a document that a client sends. */
struct document_limits limits_new(const struct server *server);

/* For the document of a scene that is kept: it may use volumes that have been
 * forgotten since. */
struct document_limits limits_kept(const struct server *server);

#endif
