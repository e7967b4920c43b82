/*
 * What documents may hold, by the daemon's configuration and its volumes.
 */
#ifndef SERVER_LIMITS_H
#define SERVER_LIMITS_H

#include "proto/document.h"

struct server;

/* For a document that a client sends. */
struct document_limits limits_new(const struct server *server);

/* For the document of a scene that is kept: it may use volumes that have been
 * forgotten since. */
struct document_limits limits_kept(const struct server *server);

#endif
