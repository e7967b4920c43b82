#include "proto/document.h"
#include "proto/import.h"
#include "server/evaluation.h"
#include "server/exchange.h"
#include "server/handlers.h"
#include "server/limits.h"
#include "server/problem.h"
#include "server/server.h"

static enum err import(struct exchange *x, struct imported *out,
    struct faults *faults)
{
	const struct document_limits limits = limits_new(x->server);

	if (x->body_length > limits.max_bytes) {
		faults_add(faults, "", "the document has %zu bytes; %zu are "
		    "the most", x->body_length, limits.max_bytes);
		return ERR_LIMIT;
	}
	return import_blobtree(x->body != NULL ? x->body : "", x->body_length,
	    &limits, out, faults);
}

static void reply(struct exchange *x, const struct imported *imported)
{
	char *text;
	size_t length;
	enum err err = import_answer(imported, &text, &length);

	if (err == ERR_OK)
		exchange_reply_data(x, 200, MEDIA_JSON, text, length);
	else
		exchange_reply_problem(x, problem_from_err(err), NULL,
		    "The document could not be answered: %s.",
		    err_message(err));
}

void handle_import(struct exchange *x)
{
	struct imported imported = {0};
	struct faults faults = {0};
	enum media_type type;
	enum err err;

	if (!exchange_check_content_type(x, 1u << MEDIA_JSON, &type))
		return;
	err = import(x, &imported, &faults);
	if (err == ERR_OK)
		reply(x, &imported);
	else
		evaluation_reply_faults(x, err, &faults);
	import_fini(&imported);
}
