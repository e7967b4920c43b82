/*
 * Scenes as trees, for handlers that ask about them rather than evaluate them:
 * a scene keeps its text and its tape, so the text is read again.
 */
#ifndef SERVER_SCENE_DOCUMENT_H
#define SERVER_SCENE_DOCUMENT_H

#include <stdbool.h>

struct document;
struct exchange;
struct scene;

/* scene's document in *out, for document_free; or answers x: false. */
bool scene_document_read(struct exchange *x, const struct scene *scene,
    struct document **out);

#endif
