/*
 * Where several daemons share scenes, a request may name one, or a revision by
 * If-Match, that this daemon has not heard of yet. It then asks the store once,
 * and the request's handler begins anew.
 */
#ifndef SERVER_SCENE_REFRESH_H
#define SERVER_SCENE_REFRESH_H

#include <stdbool.h>

#include "server/etag.h"

struct exchange;
struct scene;

/*
 * The scene that x names, fulfilling precondition's If-Match, for scene_release.
 * NULL: the handler is to return. Either x has been answered (404, 412, 422; 503:
 * the shared store is away, so that it cannot be said) or it waits, and its
 * route's handler is called again from the start: no side effects before this.
 */
struct scene *scene_refresh_get(struct exchange *x,
    const struct precondition *precondition);

/*
 * The same, whatever its revision is, and also if it cannot be used (see
 * scene_store_find).
 */
struct scene *scene_refresh_find(struct exchange *x);

#endif
