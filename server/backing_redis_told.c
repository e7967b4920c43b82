/*
 * From Redis' answers to what a reader is told.
 */
#include "server/backing_redis_internal.h"

#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include <hiredis/hiredis.h>

#include "server/etag.h"

/* Longer than any line of a history: SEQ, a tag, two numbers. */
#define LINE_MAX_BYTES 160

/* What SCRIPT_FETCH gives: where the history begins. */
#define PAST_AT 5

/* A stream's id is the time in ms, and a count within it. */
static double time_of(struct scene_seq seq)
{
	return 1e-3 * (double)seq.major;
}

struct redisReply *backing_redis_fetch(struct backing_redis *b,
    struct backing_redis_link *link, const char *id)
{
	char scene[BACKING_REDIS_KEY_MAX], history[BACKING_REDIS_KEY_MAX];
	struct backing_redis_call call;

	backing_redis_key(b, "scene:", id, scene);
	backing_redis_key(b, "history:", id, history);
	backing_redis_call_script(&call, SCRIPT_FETCH, 3);
	backing_redis_call_text(&call, scene);
	backing_redis_call_text(&call, history);
	backing_redis_call_text(&call, b->last);
	return backing_redis_link_do(link, &call);
}

/* One line of a history, "SEQ ETAG NODES BYTES", without its text. What is none
 * is left out. */
static enum err tell_older(const redisReply *reply, const char *id,
    bool is_oldest, const struct backing_reader *reader)
{
	const char *line = reply->type == REDIS_REPLY_STRING ? reply->str : "";
	char seq[LINE_MAX_BYTES], etag[LINE_MAX_BYTES];
	struct backing_revision r = {.id = id, .etag = etag, .text = "",
	    .owner = "", .is_past = true, .is_oldest = is_oldest};

	if (strlen(line) >= LINE_MAX_BYTES || sscanf(line, "%s %s %zu %zu",
	    seq, etag, &r.nodes, &r.length) != 4 ||
	    !scene_seq_parse(seq, &r.seq))
		return ERR_OK;
	r.time = time_of(r.seq);
	return reader->revision(reader->ctx, &r);
}

static enum err tell_absent(const redisReply *reply, const char *id,
    const struct backing_revision *absence,
    const struct backing_reader *reader)
{
	struct backing_revision r = {.id = id, .etag = "", .owner = "",
	    .seq = absence->seq, .before = absence->before};

	if (r.seq.major == 0 &&
	    !scene_seq_parse(reply->element[0]->str, &r.seq))
		return ERR_INVALID;
	r.time = time_of(r.seq);
	return reader->revision(reader->ctx, &r);
}

bool backing_redis_has_strings(const struct redisReply *reply, size_t count)
{
	if (reply->type != REDIS_REPLY_ARRAY || reply->elements < count)
		return false;
	for (size_t i = 0; i < count; i++)
		if (reply->element[i]->type != REDIS_REPLY_STRING)
			return false;
	return true;
}

enum err backing_redis_tell_past(const struct redisReply *reply,
    const char *id, const struct backing_reader *reader)
{
	enum err err = ERR_OK;

	for (size_t i = reply->elements; err == ERR_OK && i > PAST_AT; i--)
		err = tell_older(reply->element[i - 1], id,
		    i == reply->elements, reader);
	return err;
}

enum err backing_redis_tell(const struct redisReply *reply, const char *id,
    const struct backing_revision *absence,
    const struct backing_reader *reader)
{
	struct backing_revision r = {.id = id,
	    .is_oldest = reply->elements == PAST_AT};
	enum err err;

	if (backing_redis_has_strings(reply, 1) && reply->elements == 1)
		return absence != NULL ? tell_absent(reply, id, absence,
		    reader) : ERR_OK;
	if (!backing_redis_has_strings(reply, PAST_AT) ||
	    !scene_seq_parse(reply->element[0]->str, &r.seq))
		return ERR_INVALID;
	err = backing_redis_tell_past(reply, id, reader);
	if (err != ERR_OK)
		return err;
	r.etag = reply->element[1]->str;
	r.owner = reply->element[2]->str;
	r.nodes = strtoull(reply->element[3]->str, NULL, 10);
	r.text = reply->element[4]->str;
	r.length = (size_t)reply->element[4]->len;
	r.time = time_of(r.seq);
	return reader->revision(reader->ctx, &r);
}

struct redisReply *backing_redis_fetch_volume(struct backing_redis *b,
    struct backing_redis_link *link, const char *id)
{
	char key[BACKING_REDIS_KEY_MAX];
	struct backing_redis_call call;

	backing_redis_key(b, "volume:", id, key);
	backing_redis_call_init(&call, "HMGET");
	backing_redis_call_text(&call, key);
	backing_redis_call_text(&call, "data");
	backing_redis_call_text(&call, "forgotten");
	backing_redis_call_text(&call, "owner");
	backing_redis_call_text(&call, "was");
	return backing_redis_link_do(link, &call);
}

/* Kept by daemons that knew of no owners, it has none. */
static const char *owner_of(const redisReply *reply, bool is_forgotten)
{
	if (reply->elements > 2 &&
	    reply->element[2]->type == REDIS_REPLY_STRING)
		return reply->element[2]->str;
	if (is_forgotten && reply->elements > 3 &&
	    reply->element[3]->type == REDIS_REPLY_STRING)
		return reply->element[3]->str;
	return "";
}

enum err backing_redis_tell_volume(const struct redisReply *reply,
    const char *id, const struct backing_reader *reader)
{
	struct backing_volume v = {.id = id};

	if (reply == NULL)
		return ERR_UNAVAILABLE;
	if (!backing_redis_has_strings(reply, 2))
		return ERR_NOT_FOUND;
	v.data = reply->element[0]->str;
	v.length = (size_t)reply->element[0]->len;
	v.is_forgotten = reply->element[1]->str[0] == '1';
	v.owner = owner_of(reply, v.is_forgotten);
	return reader->volume(reader->ctx, &v);
}
