/*
 * Texts of older revisions, which are not in memory: read on a thread of their
 * own, so that neither the writer's changes nor HTTP's threads wait for a slow
 * disk, a large text or a Redis that does not answer.
 */
#include <stdlib.h>
#include <string.h>

#include "server/clock.h"
#include "server/scene_store_internal.h"
#include "server/scene_worker.h"

static enum err take_text(void *ctx, const struct backing_revision *r)
{
	struct scene_change *change = ctx;

	free(change->text);
	change->text = malloc(r->length + 1);
	if (change->text == NULL)
		return ERR_MEMORY;
	memcpy(change->text, r->text, r->length);
	change->text[r->length] = '\0';
	change->length = r->length;
	return ERR_OK;
}

static enum err read_text(struct scene_store *store,
    struct scene_change *change)
{
	const struct backing_reader reader = {take_text, NULL, change};
	enum err err;

	if (!atomic_load(&store->is_loaded) || atomic_load(&store->must_load))
		return ERR_UNAVAILABLE;
	err = store->backing->ops->read(store->backing, change->id,
	    change->etag, &reader);
	return err == ERR_OK || err == ERR_MEMORY || err == ERR_NOT_FOUND ?
	    err : ERR_UNAVAILABLE;
}

static void do_read(void *ctx, bool is_cancelled)
{
	struct scene_change *change = ctx;

	change->result = is_cancelled ? ERR_CANCELLED :
	    read_text(change->store, change);
	change->seconds = clock_seconds() - change->submitted;
	change->done(change->ctx);
}

enum err scene_reader_submit(struct scene_store *store,
    struct scene_change *change)
{
	change->store = store;
	change->submitted = clock_seconds();
	change->work = (struct scene_work){.work = do_read, .ctx = change};
	return scene_worker_add(store->reader, &change->work);
}
