#include "server/asset.h"
#include "server/asset_reply.h"
#include "server/exchange.h"
#include "server/handlers.h"

void handle_web(struct exchange *x)
{
	struct asset asset;

	/* The contract has a place of its own. */
	if (asset_find(x->id, &asset) && asset.type != MEDIA_JSON)
		asset_reply(x, &asset);
	else
		exchange_reply_problem(x, PROBLEM_NOT_FOUND, NULL,
		    "There is no file '%s'.", x->id);
}

void handle_contract(struct exchange *x)
{
	struct asset asset;

	if (asset_find("openapi.json", &asset))
		asset_reply(x, &asset);
	else
		exchange_reply_problem(x, PROBLEM_NOT_FOUND, NULL,
		    "There is no contract.");
}
