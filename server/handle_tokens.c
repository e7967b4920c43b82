/*
 * GET /v1/tokens: {"tokens": [{name, role, limits, used}]}; none without a file
 * of them.
 */
#include "server/access.h"
#include "server/exchange.h"
#include "server/handlers.h"
#include "server/server.h"

void handle_tokens(struct exchange *x)
{
	exchange_reply_json(x, 200, access_describe(x->server->access));
}
