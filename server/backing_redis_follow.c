/*
 * The follower: reads the stream of changes from the last one that it has told
 * the store of, asks for what it is about, and tells the store.
 *
 * Each entry names the one before it. If that is not the last one read, some are
 * missing - the stream was cut, or Redis has lost its newest data - and the store
 * is to load anew. So is it if the newest is older than the last one read, or than
 * one that this daemon has made.
 */
#include "server/backing_redis_internal.h"

#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <time.h>

#include <hiredis/hiredis.h>

#include "server/clock.h"
#include "server/log.h"

/* Entries in one answer, and how long to wait for the first. */
#define ENTRIES "64"
#define BLOCK_MS "1000"

/* Seconds between attempts to connect: from the first to the second number,
 * doubled each time, less up to half of it at random, so that daemons do not all
 * come at once. */
#define BACKOFF_LEAST 0.1
#define BACKOFF_MOST 1.0

/* Seconds between attempts to write while all is well. */
#define PROBE_SECONDS 5.0

/* Seconds between calls of lost(). */
#define LOST_SECONDS 0.5

/* An entry of the stream. */
struct entry {
	const char *seq, *kind, *id, *etag, *token, *prev;
	struct scene_seq number, before;
};

struct follower {
	struct backing_redis *b;
	struct backing_redis_link *link;
	char position[BACKING_REDIS_ID_MAX];
	unsigned generation;     /* of it */
	double backoff, probed, loaded;
	unsigned seed;
};

static bool is_ending(struct backing_redis *b)
{
	bool ending;

	pthread_mutex_lock(&b->lock);
	ending = b->is_ending;
	pthread_mutex_unlock(&b->lock);
	return ending;
}

/* The newest change of this daemon's, which may not have been read yet. */
static struct scene_seq made_by(struct backing_redis *b)
{
	struct scene_seq made;

	pthread_mutex_lock(&b->lock);
	made = b->made;
	pthread_mutex_unlock(&b->lock);
	return made;
}

/* Waits for so long, or for a change of b. */
static void wait_for(struct backing_redis *b, double seconds)
{
	struct timespec at;
	double end;

	clock_gettime(CLOCK_MONOTONIC, &at);
	end = 1e-9 * (double)at.tv_nsec + seconds;
	at.tv_sec += (time_t)end;
	at.tv_nsec = (long)(1e9 * (end - (double)(time_t)end));
	pthread_mutex_lock(&b->lock);
	if (!b->is_ending)
		pthread_cond_timedwait(&b->changed, &b->lock, &at);
	pthread_mutex_unlock(&b->lock);
}

static void back_off(struct follower *f)
{
	double random = (double)rand_r(&f->seed) / RAND_MAX;

	wait_for(f->b, f->backoff * (1.0 - 0.5 * random));
	f->backoff = 2.0 * f->backoff < BACKOFF_MOST ? 2.0 * f->backoff :
	    BACKOFF_MOST;
}

/* ---- holes ---- */

/* What the store knows may have holes, unless it has been loaded meanwhile. */
static void note_hole(struct follower *f, const char *why)
{
	struct backing_redis *b = f->b;

	pthread_mutex_lock(&b->lock);
	if (b->state == STATE_LOADED && b->generation == f->generation) {
		b->state = STATE_STALE;
		log_write(LOG_WARNING, "redis %s: %s; loading all anew",
		    b->url.shown, why);
	}
	pthread_mutex_unlock(&b->lock);
}

/* Whether the store has loaded; then from where to go on. */
static bool is_loaded(struct follower *f)
{
	struct backing_redis *b = f->b;
	enum backing_redis_state state;

	pthread_mutex_lock(&b->lock);
	state = b->state;
	if (state == STATE_LOADED && f->generation != b->generation) {
		f->generation = b->generation;
		strcpy(f->position, b->position);
	}
	pthread_mutex_unlock(&b->lock);
	if (state == STATE_STALE &&
	    clock_seconds() - f->loaded > LOST_SECONDS) {
		f->loaded = clock_seconds();
		b->options.lost(b->options.changed.ctx);
	}
	return state == STATE_LOADED;
}

/* ---- entries ---- */

static bool read_entry(const redisReply *reply, struct entry *out)
{
	const redisReply *fields;

	if (reply->type != REDIS_REPLY_ARRAY || reply->elements != 2 ||
	    reply->element[1]->type != REDIS_REPLY_ARRAY ||
	    reply->element[0]->type != REDIS_REPLY_STRING)
		return false;
	*out = (struct entry){.seq = reply->element[0]->str};
	fields = reply->element[1];
	if (!backing_redis_has_strings(fields, fields->elements))
		return false;
	for (size_t i = 0; i + 1 < fields->elements; i += 2) {
		const char *name = fields->element[i]->str;
		const char *value = fields->element[i + 1]->str;

		if (strcmp(name, "kind") == 0)
			out->kind = value;
		else if (strcmp(name, "id") == 0)
			out->id = value;
		else if (strcmp(name, "etag") == 0)
			out->etag = value;
		else if (strcmp(name, "token") == 0)
			out->token = value;
		else if (strcmp(name, "prev") == 0)
			out->prev = value;
		else if (strcmp(name, "before") == 0 &&
		    !scene_seq_parse(value, &out->before))
			out->before = (struct scene_seq){0, 0};
	}
	return out->kind != NULL && out->id != NULL && out->etag != NULL &&
	    out->token != NULL && out->prev != NULL &&
	    scene_seq_parse(out->seq, &out->number);
}

/* Whether this daemon has made the change, and knows that it has. */
static bool is_known(struct follower *f, const struct entry *entry)
{
	struct backing_redis *b = f->b;
	size_t length = strlen(b->instance);
	bool known;
	uint64_t number;

	if (strncmp(entry->token, b->instance, length) != 0 ||
	    entry->token[length] != ':')
		return false;
	number = strtoull(entry->token + length + 1, NULL, 10);
	pthread_mutex_lock(&b->lock);
	known = number <= b->settled;
	for (int i = 0; i < BACKING_REDIS_DOUBTS; i++)
		known = known && b->doubts[i] != number;
	pthread_mutex_unlock(&b->lock);
	return known;
}

static bool is_of_scene(const struct entry *entry)
{
	return strcmp(entry->kind, "put") == 0 ||
	    strcmp(entry->kind, "delete") == 0;
}

/* An absent scene has been deleted since, if not by entry: that comes. */
static enum err tell_scene(struct follower *f, const struct entry *entry)
{
	const struct backing_reader *reader = &f->b->options.changed;
	const struct backing_revision absence = {.seq = entry->number,
	    .before = entry->before};
	redisReply *reply = backing_redis_fetch(f->b, f->link, entry->id);
	enum err err;

	if (reply == NULL)
		return ERR_UNAVAILABLE;
	err = backing_redis_tell(reply, entry->id, strcmp(entry->kind,
	    "delete") == 0 ? &absence : NULL, reader);
	if (err == ERR_OK)
		err = backing_redis_tell_past(reply, entry->id, reader);
	freeReplyObject(reply);
	return err;
}

static enum err tell_volume(struct follower *f, const struct entry *entry)
{
	struct backing_redis *b = f->b;
	redisReply *reply = backing_redis_fetch_volume(b, f->link, entry->id);
	enum err err = backing_redis_tell_volume(reply, entry->id,
	    &b->options.changed);

	freeReplyObject(reply);
	if (err == ERR_NOT_FOUND) /* gone, unless it is there no longer */
		err = b->options.changed.volume(b->options.changed.ctx,
		    &(struct backing_volume){.id = entry->id,
		    .is_forgotten = true});
	return err;
}

/* It is told: a change in doubt is known now. */
static void settle_doubt(struct backing_redis *b, const struct entry *entry)
{
	size_t length = strlen(b->instance);
	uint64_t number;

	if (strncmp(entry->token, b->instance, length) != 0 ||
	    entry->token[length] != ':')
		return;
	number = strtoull(entry->token + length + 1, NULL, 10);
	pthread_mutex_lock(&b->lock);
	for (int i = 0; i < BACKING_REDIS_DOUBTS; i++)
		if (b->doubts[i] == number)
			b->doubts[i] = 0;
	pthread_mutex_unlock(&b->lock);
}

/* Tells the store what entry is about, if it does not know. */
static enum err tell(struct follower *f, const struct entry *entry)
{
	struct backing_redis *b = f->b;
	enum err err = ERR_OK;

	if (is_known(f, entry))
		return ERR_OK;
	b->options.guard(b->options.changed.ctx, true);
	/* No write is made now: all of ours are settled. */
	if (!is_known(f, entry))
		err = is_of_scene(entry) ? tell_scene(f, entry) :
		    tell_volume(f, entry);
	b->options.guard(b->options.changed.ctx, false);
	if (err == ERR_OK)
		settle_doubt(b, entry);
	if (err == ERR_MEMORY) {
		note_hole(f, "there was no memory for a change");
		err = ERR_UNAVAILABLE;
	} else if (err != ERR_OK && err != ERR_UNAVAILABLE) {
		log_write(LOG_ERROR, "redis %s: '%s' as another daemon has "
		    "changed it: %s", b->url.shown, entry->id,
		    err_message(err));
		err = ERR_OK;
	}
	return err;
}

/* Whether a later entry is about the same: then that one tells it; of a volume not
 * if this daemon has made that one, which is not told. */
static bool is_outdated(struct follower *f, const redisReply *entries,
    size_t at, const struct entry *entry)
{
	struct entry other;

	for (size_t i = at + 1; i < entries->elements; i++)
		if (read_entry(entries->element[i], &other) &&
		    is_of_scene(&other) == is_of_scene(entry) &&
		    strcmp(other.id, entry->id) == 0 &&
		    (is_of_scene(entry) || !is_known(f, &other)))
			return true;
	return false;
}

/* Whether entry is what has come after the last one read. One that this daemon has
 * made in between is missing as any other is, though entry does not know. */
static bool is_next(struct follower *f, const struct entry *entry)
{
	struct scene_seq made = made_by(f->b), here;

	return strcmp(entry->prev, f->position) == 0 &&
	    scene_seq_parse(f->position, &here) &&
	    (scene_seq_compare(made, here) <= 0 ||
	    scene_seq_compare(made, entry->number) >= 0);
}

/* ERR_UNAVAILABLE: the rest is to be read again. */
static enum err tell_all(struct follower *f, const redisReply *entries)
{
	enum err err = ERR_OK;

	for (size_t i = 0; err == ERR_OK && i < entries->elements; i++) {
		struct entry entry;

		if (!read_entry(entries->element[i], &entry) ||
		    !is_next(f, &entry)) {
			note_hole(f, "changes are missing in the stream");
			return ERR_OK;
		}
		if (!is_outdated(f, entries, i, &entry))
			err = tell(f, &entry);
		if (err == ERR_OK)
			snprintf(f->position, sizeof f->position, "%s",
			    entry.seq);
	}
	return err;
}

/* ---- the stream ---- */

/* What has come after the position; NULL: nothing, or the connection is lost. */
static redisReply *read_stream(struct follower *f, const char *milliseconds)
{
	struct backing_redis_call call;

	backing_redis_call_init(&call, "XREAD");
	backing_redis_call_text(&call, "COUNT");
	backing_redis_call_text(&call, ENTRIES);
	backing_redis_call_text(&call, "BLOCK");
	backing_redis_call_text(&call, milliseconds);
	backing_redis_call_text(&call, "STREAMS");
	backing_redis_call_text(&call, f->b->changes);
	backing_redis_call_text(&call, f->position);
	return backing_redis_link_do(f->link, &call);
}

/* The entries of its one stream, or NULL. */
static const redisReply *entries_of(const redisReply *reply)
{
	const redisReply *stream;

	if (reply->type != REDIS_REPLY_ARRAY || reply->elements != 1)
		return NULL;
	stream = reply->element[0];
	return stream->type == REDIS_REPLY_ARRAY && stream->elements == 2 &&
	    stream->element[1]->type == REDIS_REPLY_ARRAY ?
	    stream->element[1] : NULL;
}

/* Nothing has come: is the newest change the one that was read last? A later one
 * comes with the next answer, or, of a stream that was cut to nothing, does not:
 * then the newest stays the same for two looks. */
static void check_newest(struct follower *f, char newest[static
    BACKING_REDIS_ID_MAX])
{
	struct scene_seq here, there, made = made_by(f->b);
	struct backing_redis_call call;
	redisReply *reply;
	const char *last;

	backing_redis_call_init(&call, "GET");
	backing_redis_call_text(&call, f->b->last);
	reply = backing_redis_link_do(f->link, &call);
	if (reply == NULL)
		return;
	last = reply->type == REDIS_REPLY_STRING ? reply->str : "0-0";
	if (!scene_seq_parse(last, &there) ||
	    !scene_seq_parse(f->position, &here) ||
	    scene_seq_compare(there, here) < 0 ||
	    scene_seq_compare(there, made) < 0)
		note_hole(f, BACKING_REDIS_NEWEST_LOST);
	else if (scene_seq_compare(there, here) > 0 &&
	    strcmp(last, newest) == 0)
		note_hole(f, "the stream is empty");
	snprintf(newest, BACKING_REDIS_ID_MAX, "%s", last);
	freeReplyObject(reply);
}

/* Whether it can be written, too: asked now and then. */
static void probe(struct follower *f)
{
	bool is_well = atomic_load(&f->b->is_well);
	struct backing_redis_call call;
	redisReply *reply;

	if (is_well && clock_seconds() - f->probed < PROBE_SECONDS)
		return;
	f->probed = clock_seconds();
	backing_redis_call_init(&call, "SET");
	backing_redis_call_text(&call, f->b->alive);
	backing_redis_call_text(&call, f->b->instance);
	reply = backing_redis_link_do(f->link, &call);
	backing_redis_note(f->b, reply != NULL, f->link->message);
	freeReplyObject(reply);
}

/* Follows as long as the connection holds. */
static void follow(struct follower *f)
{
	char newest[BACKING_REDIS_ID_MAX] = "";

	while (!is_ending(f->b) && f->link->context != NULL) {
		const redisReply *entries;
		redisReply *reply;

		probe(f);
		if (f->link->context == NULL)
			return;
		if (!is_loaded(f)) {
			wait_for(f->b, LOST_SECONDS);
			continue;
		}
		reply = read_stream(f, BLOCK_MS);
		if (reply == NULL) {
			wait_for(f->b, BACKOFF_LEAST);
			continue;
		}
		entries = entries_of(reply);
		if (entries == NULL)
			check_newest(f, newest);
		else if (tell_all(f, entries) != ERR_OK)
			wait_for(f->b, BACKOFF_LEAST);
		freeReplyObject(reply);
	}
}

void *backing_redis_follow(void *ctx)
{
	struct backing_redis *b = ctx;
	struct follower f = {.b = b, .link = &b->follower,
	    .backoff = BACKOFF_LEAST,
	    .seed = (unsigned)strtoul(b->instance + 8, NULL, 16)};

	while (!is_ending(b)) {
		if (backing_redis_link_open(f.link) == ERR_OK) {
			f.backoff = BACKOFF_LEAST;
			follow(&f);
			if (is_ending(b))
				break;
		}
		backing_redis_note(b, false, f.link->message);
		back_off(&f);
	}
	backing_redis_link_close(f.link);
	return NULL;
}
