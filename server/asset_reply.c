#include "server/asset_reply.h"

#include "server/asset.h"
#include "server/etag.h"
#include "server/exchange.h"
#include "server/scene_reply.h"

/* The page's scripts, styles and requests are this daemon's own; pictures and
 * downloads may be made in the page. */
static const char policy[] = "default-src 'none'; script-src 'self'; "
    "style-src 'self'; connect-src 'self'; img-src 'self' data: blob:; "
    "base-uri 'none'; form-action 'none'; frame-ancestors 'none'";

static void release_nothing(void *owner)
{
	(void)owner;
}

static void add_headers(struct exchange *x, const struct asset *asset)
{
	exchange_add_header(x, "ETag", asset->etag);
	exchange_add_header(x, "Cache-Control", "no-cache");
	exchange_add_header(x, "X-Content-Type-Options", "nosniff");
	exchange_add_header(x, "Referrer-Policy", "no-referrer");
	if (asset->type == MEDIA_HTML)
		exchange_add_header(x, "Content-Security-Policy", policy);
}

void asset_reply(struct exchange *x, const struct asset *asset)
{
	struct precondition precondition;

	if (!scene_reply_preconditions(x, &precondition))
		return;
	if (!precondition_match(&precondition, asset->etag)) {
		exchange_reply_problem(x, PROBLEM_PRECONDITION, NULL,
		    "The file is not the one that If-Match asks for.");
		return;
	}
	if (precondition_none_match(&precondition, asset->etag)) {
		exchange_reply_borrowed(x, 200, asset->type, asset->data,
		    asset->length, release_nothing, NULL);
	} else {
		exchange_reply_empty(x, 304);
	}
	add_headers(x, asset);
}
