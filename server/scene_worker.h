/*
 * Inside of the scene store: a thread that makes large revisions, and one that
 * reads older ones, for HTTP's threads and the writer not to be kept from others
 * meanwhile. One piece of work after another, in the order in which it came: so
 * that patches of one scene do not overtake one another, and none is made in vain.
 */
#ifndef SERVER_SCENE_WORKER_H
#define SERVER_SCENE_WORKER_H

#include "core/err.h"

struct scene_work;
struct scene_worker;

/* ERR_MEMORY, ERR_IO. */
enum err scene_worker_create(struct scene_worker **out);

/* As scene_store_work. */
enum err scene_worker_add(struct scene_worker *w, struct scene_work *work);

/* Tells what waits that it is cancelled, and ends the thread; the writer still
 * writes. NULL does nothing. */
void scene_worker_stop(struct scene_worker *w);

/* After scene_worker_stop, and once nobody brings work. NULL does nothing. */
void scene_worker_free(struct scene_worker *w);

#endif
