#include "server/scene_document.h"

#include "proto/document.h"
#include "proto/fault.h"
#include "server/evaluation.h"
#include "server/exchange.h"
#include "server/limits.h"
#include "server/scene_store.h"
#include "server/server.h"

bool scene_document_read(struct exchange *x, const struct scene *scene,
    struct document **out)
{
	const struct document_limits limits = limits_kept(x->server);
	struct faults faults = {0};
	enum err err = document_parse(scene->text, scene->length, &limits,
	    out, &faults);

	if (err == ERR_OK)
		return true;
	evaluation_reply_faults(x, err, &faults);
	return false;
}
