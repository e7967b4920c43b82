#include "server/exchange.h"
#include "server/handlers.h"
#include "server/metrics.h"
#include "server/server.h"

void handle_metrics(struct exchange *x)
{
	size_t length;
	char *text = metrics_print(x->server->metrics, x->server, &length);

	if (text == NULL) {
		exchange_reply_problem(x, PROBLEM_MEMORY, NULL,
		    "There was no memory for the answer.");
		return;
	}
	exchange_reply_data(x, 200, MEDIA_METRICS, text, length);
	exchange_add_header(x, "Cache-Control", "no-store");
}
