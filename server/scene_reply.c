#include "server/scene_reply.h"

#include <math.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <time.h>

#include <cjson/cJSON.h>

#include "proto/fault.h"
#include "server/exchange.h"
#include "server/scene_store.h"
#include "server/server.h"

bool scene_reply_preconditions(struct exchange *x, struct precondition *out)
{
	out->match = exchange_header(x, "If-Match");
	out->none_match = exchange_header(x, "If-None-Match");
	if (precondition_is_valid(out))
		return true;
	exchange_reply_problem(x, PROBLEM_MALFORMED, NULL,
	    "If-Match and If-None-Match take * or entity tags in double "
	    "quotes, such as the ETag header has.");
	return false;
}

/* It is kept, but cannot be used (any more); or, now, it can. */
static void reply_unusable(struct exchange *x, enum err err,
    const struct faults *faults)
{
	const struct fault *first = &faults->list[0];

	if (err == ERR_OK)
		exchange_reply_problem(x, PROBLEM_NOT_READY, NULL,
		    "Scene '%s' is being made usable: try again.", x->id);
	else if (err == ERR_MEMORY)
		exchange_reply_problem(x, PROBLEM_MEMORY, NULL,
		    "There is no memory for scene '%s' now.", x->id);
	else
		exchange_reply_problem(x, problem_from_err(err), faults,
		    "Scene '%s' is kept, but cannot be used now: %s%s%s. GET "
		    "it, replace it or delete it, or give the daemon what it "
		    "needs.", x->id, first->pointer, first->pointer[0] != '\0' ?
		    ": " : "", faults->count > 0 ? first->detail :
		    err_message(err));
}

void scene_reply_missing(struct exchange *x)
{
	exchange_reply_problem(x, PROBLEM_NOT_FOUND, NULL,
	    "There is no scene '%s'.", x->id);
}

void scene_reply_absent(struct exchange *x)
{
	struct faults faults = {0};
	struct scene_store *store = x->server->scenes;
	enum err err;

	if (!scene_store_is_ready(store)) {
		exchange_reply_problem(x, PROBLEM_UNAVAILABLE, NULL,
		    "Scenes have not been read yet: their store is away.");
		return;
	}
	err = scene_store_mend(store, x->id, &faults);
	if (err == ERR_NOT_FOUND)
		scene_reply_missing(x);
	else
		reply_unusable(x, err, &faults);
}

void scene_reply_changed(struct exchange *x)
{
	exchange_reply_problem(x, PROBLEM_PRECONDITION, NULL,
	    "Scene '%s' is not in the state that If-Match or If-None-Match "
	    "asks for; GET it for its present ETag.", x->id);
}

bool scene_reply_limit(struct exchange *x, size_t most, size_t *out)
{
	const char *text = exchange_query(x, "limit");
	unsigned long limit;
	char *end;

	*out = most;
	if (text == NULL)
		return true;
	limit = strtoul(text, &end, 10);
	if (text[0] >= '0' && text[0] <= '9' && *end == '\0' && limit >= 1 &&
	    limit <= most) {
		*out = limit;
		return true;
	}
	exchange_reply_problem(x, PROBLEM_MALFORMED, NULL,
	    "limit is a whole number from 1 to %zu.", most);
	return false;
}

void scene_reply_time(double time, char out[static SCENE_TIME_SIZE])
{
	/* RFC 3339 has years of four digits. */
	bool is_one = time >= 0.0 && time < 253402300799.0;
	/* Whole milliseconds first: 0.9996 s is the next second. */
	int64_t ms = is_one ? (int64_t)floor(1e3 * time + 0.5) : 0;
	time_t seconds = (time_t)(ms / 1000);
	struct tm tm;
	size_t length;

	gmtime_r(&seconds, &tm);
	length = strftime(out, SCENE_TIME_SIZE, "%Y-%m-%dT%H:%M:%S", &tm);
	snprintf(out + length, SCENE_TIME_SIZE - length, ".%03dZ",
	    (int)(ms % 1000));
}

void scene_reply_add_revision(struct cJSON *json, const char *etag,
    struct scene_seq seq, double time)
{
	char revision[ETAG_SIZE], text[SCENE_SEQ_SIZE], when[SCENE_TIME_SIZE];

	snprintf(revision, sizeof revision, "%.*s", ETAG_DIGITS, etag + 1);
	scene_seq_print(seq, text);
	scene_reply_time(time, when);
	cJSON_AddStringToObject(json, "revision", revision);
	cJSON_AddStringToObject(json, "sequence", text);
	cJSON_AddStringToObject(json, "time", when);
}

struct cJSON *scene_reply_summary(const struct scene *scene)
{
	cJSON *json = cJSON_CreateObject();

	cJSON_AddStringToObject(json, "id", scene->id);
	cJSON_AddStringToObject(json, "name", scene->name);
	scene_reply_add_revision(json, scene->etag, scene->seq, scene->time);
	cJSON_AddNumberToObject(json, "nodes", (double)scene->nodes);
	cJSON_AddNumberToObject(json, "bytes", (double)scene->length);
	if (scene->owner[0] != '\0')
		cJSON_AddStringToObject(json, "owner", scene->owner);
	return json;
}

void scene_reply_wait(struct exchange *x, struct scene_change *change,
    void (*resumed)(struct exchange *x))
{
	enum err err;

	x->resumed = resumed;
	exchange_wait(x);
	/* Once it is submitted, it is x's answer's. */
	err = scene_store_submit(x->server->scenes, change);
	if (err == ERR_OK)
		return;
	if (change->scene != NULL)
		scene_release(change->scene);
	change->result = err;
	change->done(change->ctx);
}
