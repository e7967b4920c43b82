/*
 * From a document's text to a revision of a scene: what handlers, patches and
 * stores share. Any thread.
 */
#ifndef SERVER_SCENE_BUILD_H
#define SERVER_SCENE_BUILD_H

#include <stddef.h>

#include "core/err.h"

struct document_limits;
struct faults;
struct scene;
struct server;

/*
 * Parses, checks and compiles text into a revision for id, for scene_release.
 * ERR_SYNTAX, ERR_INVALID, ERR_LIMIT, with the places in faults; ERR_MEMORY.
 */
enum err scene_build(struct server *server,
    const struct document_limits *limits, const char *id, const char *text,
    size_t length, struct scene **out, struct faults *faults);

#endif
