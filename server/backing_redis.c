/*
 * Scenes in a Redis that several daemons share: what the store's writer asks.
 * Each change is one script: the check of the tag, the revision, its history and
 * the entry in the stream, or nothing of them.
 *
 * Of a change whose answer does not come:
 * - no answer in time: the script itself refuses to run later than
 *   BACKING_REDIS_ACT_SECONDS after it was sent, so what waits in a Redis that
 *   stands still is not made when it goes on;
 * - the connection ends: over a new one it is looked up, and if it has not been
 *   made, it never will be (SCRIPT_SETTLE);
 * - there is no new one: ERR_UNAVAILABLE, though it may have been made just
 *   before the end. If so, the follower tells of it when Redis is back.
 */
#include "server/backing_redis_internal.h"

#include <inttypes.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/random.h>

#include <hiredis/hiredis.h>

#include "server/clock.h"
#include "server/log.h"

/* Changes, and scenes, that are sent before the first answer is read. */
#define CHUNK 32

/* After a failure older revisions are not asked for during so many seconds: those
 * that wait behind one do not wait, one after another, as long as it has. */
#define READ_PAUSE_SECONDS 1.0

/* Its clock is read so often, while it is written. */
#define CLOCK_SECONDS 5.0

void backing_redis_key(const struct backing_redis *b, const char *kind,
    const char *id, char out[static BACKING_REDIS_KEY_MAX])
{
	snprintf(out, BACKING_REDIS_KEY_MAX, "%s%s%s", b->url.prefix, kind,
	    id);
}

void backing_redis_token(const struct backing_redis *b, uint64_t number,
    char out[static BACKING_REDIS_TOKEN_MAX])
{
	snprintf(out, BACKING_REDIS_TOKEN_MAX, "%s:%" PRIu64, b->instance,
	    number);
}

/* What is wrong with a certificate, its own or ours, of a Redis that is away
 * already, once: no waiting mends that. */
static void note_refusal(struct backing_redis *b, bool is_well, bool is_said,
    const char *why)
{
	const bool is_one = !is_well && strncmp(why, "TLS: ", 5) == 0 &&
	    strcasestr(why, "certificate") != NULL;
	bool is_new;

	pthread_mutex_lock(&b->lock);
	is_new = is_one && strcmp(b->refusal, why) != 0;
	if (is_one || is_well)
		snprintf(b->refusal, sizeof b->refusal, "%s",
		    is_one ? why : "");
	pthread_mutex_unlock(&b->lock);
	if (is_new && !is_said)
		log_write(LOG_WARNING, "redis %s: %s", b->url.shown, why);
}

void backing_redis_note(struct backing_redis *b, bool is_well,
    const char *why)
{
	const bool is_said = atomic_exchange(&b->is_well, is_well) != is_well;

	if (b->url.is_tls)
		note_refusal(b, is_well, is_said, why);
	if (!is_said)
		return;
	if (is_well)
		log_write(LOG_INFO, "redis %s can be written", b->url.shown);
	else
		log_write(LOG_WARNING, "redis %s: %s; scenes cannot be changed "
		    "until it is back", b->url.shown, why);
}

/* ---- changes ---- */

void backing_redis_note_made(struct backing_redis *b, struct scene_seq seq,
    const char *prev)
{
	struct scene_seq before = seq;

	if (prev != NULL && !scene_seq_parse(prev, &before))
		before = (struct scene_seq){0, 0};
	pthread_mutex_lock(&b->lock);
	if (scene_seq_compare(before, b->made) < 0 &&
	    b->state == STATE_LOADED) {
		b->state = STATE_STALE;
		log_write(LOG_WARNING, "redis %s: %s; loading all anew",
		    b->url.shown, BACKING_REDIS_NEWEST_LOST);
	}
	b->made = seq;
	pthread_mutex_unlock(&b->lock);
}

/* A change on its way. */
struct sent {
	struct backing_write *write;
	uint64_t number;
	char token[BACKING_REDIS_TOKEN_MAX];
	char scene[BACKING_REDIS_KEY_MAX], history[BACKING_REDIS_KEY_MAX];
	char nullified[BACKING_REDIS_KEY_MAX];
	char nodes[24], revisions[24], most[24];
	bool is_open;            /* nothing is known of it yet */
	bool is_forgotten;       /* the script was not there */
	bool is_late;            /* nothing was done, since it was */
};

static void prepare(struct backing_redis *b, struct sent *s,
    struct backing_write *write)
{
	s->write = write;
	s->number = ++b->begun;
	s->is_open = true;
	backing_redis_token(b, s->number, s->token);
	backing_redis_key(b, "scene:", write->revision.id, s->scene);
	backing_redis_key(b, "history:", write->revision.id, s->history);
	backing_redis_key(b, "void:", s->token, s->nullified);
	snprintf(s->nodes, sizeof s->nodes, "%zu", write->revision.nodes);
	snprintf(s->revisions, sizeof s->revisions, "%zu",
	    b->options.history);
	snprintf(s->most, sizeof s->most, "%zu",
	    b->options.history_bytes > 0 ? b->options.history_bytes :
	    SIZE_MAX);
}

static void put_call(struct backing_redis *b, struct sent *s,
    const char *latest, struct backing_redis_call *call)
{
	const struct backing_revision *r = &s->write->revision;
	bool is_deletion = r->text == NULL;

	backing_redis_call_script(call, SCRIPT_COMMIT, 6);
	backing_redis_call_text(call, s->scene);
	backing_redis_call_text(call, s->history);
	backing_redis_call_text(call, b->scenes);
	backing_redis_call_text(call, b->changes);
	backing_redis_call_text(call, b->last);
	backing_redis_call_text(call, s->nullified);
	backing_redis_call_text(call, is_deletion ? "delete" : "put");
	backing_redis_call_text(call, r->id);
	backing_redis_call_text(call, s->write->is_any ? "*" :
	    s->write->expected != NULL ? s->write->expected : "");
	backing_redis_call_text(call, is_deletion ? "" : r->etag);
	backing_redis_call_add(call, is_deletion ? "" : r->text,
	    is_deletion ? 0 : r->length);
	backing_redis_call_text(call, r->owner != NULL ? r->owner : "");
	backing_redis_call_text(call, s->nodes);
	backing_redis_call_text(call, s->token);
	backing_redis_call_text(call, s->revisions);
	backing_redis_call_text(call, BACKING_REDIS_ENTRIES);
	backing_redis_call_text(call, latest);
	backing_redis_call_text(call, s->most);
}

/* It is made, as change seq, after change prev (NULL: unknown). */
static void finish(struct backing_redis *b, struct sent *s, const char *seq,
    const char *prev)
{
	struct backing_revision *r = &s->write->revision;

	s->is_open = false;
	s->write->result = ERR_UNAVAILABLE;
	if (!scene_seq_parse(seq, &r->seq))
		return;
	r->time = 1e-3 * (double)r->seq.major;
	s->write->result = ERR_OK;
	backing_redis_note_made(b, r->seq, prev);
}

/* What was there before. */
static void note_found(struct backing_write *w, const redisReply *reply)
{
	w->was_there = scene_seq_parse(reply->element[2]->str,
	    &w->revision.before);
	w->has_found = true;
	snprintf(w->owner, sizeof w->owner, "%s", reply->element[3]->str);
	if (!scene_seq_parse(reply->element[5]->str, &w->oldest))
		w->oldest = (struct scene_seq){0, 0};
}

/* It is not made. */
static void fail(struct sent *s, enum err err)
{
	s->is_open = false;
	s->write->result = err;
}

static void read_result(struct backing_redis *b, struct sent *s,
    const redisReply *reply)
{
	const char *word = backing_redis_has_strings(reply, 1) ?
	    reply->element[0]->str : "";

	if (backing_redis_is_forgotten(reply)) {
		s->is_forgotten = true;
	} else if (reply->type == REDIS_REPLY_ERROR) {
		backing_redis_note(b, false, reply->str);
		fail(s, ERR_UNAVAILABLE);
	} else if (strcmp(word, "ok") == 0 &&
	    backing_redis_has_strings(reply, 6)) {
		finish(b, s, reply->element[1]->str, reply->element[4]->str);
		note_found(s->write, reply);
	} else if (strcmp(word, "conflict") == 0) {
		fail(s, ERR_CONFLICT);
	} else if (strcmp(word, "absent") == 0) {
		fail(s, ERR_NOT_FOUND);
	} else if (strcmp(word, "late") == 0) {
		s->is_late = true;
	} else {
		backing_redis_note(b, false, "it does not make changes");
		fail(s, ERR_UNAVAILABLE);
	}
}

/* Sends those that are open, and reads what becomes of them. False: the
 * connection is lost. The latest time is one for all: none is made once one
 * before it was late. */
static bool exchange(struct backing_redis *b, struct sent *list, size_t count)
{
	struct backing_redis_call call;
	char latest[32];

	snprintf(latest, sizeof latest, "%.0f",
	    backing_redis_link_time(&b->link, BACKING_REDIS_ACT_SECONDS));
	for (size_t i = 0; i < count; i++) {
		list[i].is_forgotten = list[i].is_late = false;
		if (!list[i].is_open)
			continue;
		put_call(b, &list[i], latest, &call);
		if (!backing_redis_link_send(&b->link, &call))
			return false;
	}
	for (size_t i = 0; i < count; i++) {
		redisReply *reply;

		if (!list[i].is_open)
			continue;
		reply = backing_redis_link_get(&b->link);
		if (reply == NULL)
			return false;
		read_result(b, &list[i], reply);
		freeReplyObject(reply);
	}
	return true;
}

/* ---- changes in doubt ---- */

static void note_doubts(struct backing_redis *b, const struct sent *list,
    size_t count)
{
	pthread_mutex_lock(&b->lock);
	for (size_t i = 0; i < count; i++) {
		uint64_t *doubt = &b->doubts[b->doubt_next %
		    BACKING_REDIS_DOUBTS];

		if (!list[i].is_open)
			continue;
		/* One that is overwritten would not be told of any more. */
		if (*doubt != 0 && b->state == STATE_LOADED)
			b->state = STATE_STALE;
		*doubt = list[i].number;
		b->doubt_next++;
	}
	pthread_mutex_unlock(&b->lock);
}

static void read_settled(struct backing_redis *b, struct sent *list,
    size_t count, const redisReply *reply)
{
	size_t at = 0;

	for (size_t i = 0; i < count; i++) {
		const char *seq;

		if (!list[i].is_open)
			continue;
		seq = at < reply->elements ? reply->element[at]->str : "";
		at++;
		if (seq != NULL && seq[0] != '\0')
			finish(b, &list[i], seq, NULL);
		else
			fail(&list[i], ERR_UNAVAILABLE);
	}
}

/* Asks what has become of those that are open, and sees to it that the others
 * will not be made. */
static void look_up(struct backing_redis *b, struct sent *list, size_t count,
    double since)
{
	struct backing_redis_call call;
	redisReply *reply;
	char from[32];
	int open = 0;

	for (size_t i = 0; i < count; i++)
		open += list[i].is_open;
	backing_redis_call_script(&call, SCRIPT_SETTLE, 1 + open);
	backing_redis_call_text(&call, b->changes);
	for (size_t i = 0; i < count; i++)
		if (list[i].is_open)
			backing_redis_call_text(&call, list[i].nullified);
	snprintf(from, sizeof from, "%.0f", since > 0.0 ? since : 0.0);
	backing_redis_call_text(&call, from);
	for (size_t i = 0; i < count; i++)
		if (list[i].is_open)
			backing_redis_call_text(&call, list[i].token);
	reply = backing_redis_link_do(&b->link, &call);
	if (reply == NULL)
		return;
	if (reply->type == REDIS_REPLY_ARRAY)
		read_settled(b, list, count, reply);
	freeReplyObject(reply);
}

/* The connection is lost while some were open. since: some time before they were
 * sent, by Redis' clock, for which another Redis may have another one. */
static void settle(struct backing_redis *b, struct sent *list, size_t count,
    double since)
{
	bool is_slow = b->link.is_slow;

	note_doubts(b, list, count);
	if (!is_slow && backing_redis_link_open(&b->link) == ERR_OK)
		look_up(b, list, count, since - 10e3);
	else
		backing_redis_note(b, false, b->link.message);
	for (size_t i = 0; i < count; i++)
		if (list[i].is_open)
			fail(&list[i], ERR_UNAVAILABLE);
}

/* ---- committing ---- */

/* No script is there (any more): nothing was done. */
static bool has_forgotten(const struct sent *list, size_t count)
{
	for (size_t i = 0; i < count; i++)
		if (list[i].is_open && list[i].is_forgotten)
			return true;
	return false;
}

static bool has_late(const struct sent *list, size_t count)
{
	for (size_t i = 0; i < count; i++)
		if (list[i].is_open && list[i].is_late)
			return true;
	return false;
}

/* Its clock was set, or it stood still: those that were late are sent once more,
 * by what its clock says now. False: the connection is lost. */
static bool try_late(struct backing_redis *b, struct sent *list, size_t count)
{
	if (!has_late(list, count))
		return true;
	if (backing_redis_link_read_clock(&b->link) != ERR_OK ||
	    !exchange(b, list, count))
		return false;
	for (size_t i = 0; i < count; i++)
		if (list[i].is_open && list[i].is_late) {
			backing_redis_note(b, false, "it is too slow");
			fail(&list[i], ERR_UNAVAILABLE);
		}
	return true;
}

static void commit_some(struct backing_redis *b, struct backing_write *writes,
    size_t count)
{
	double since = backing_redis_link_time(&b->link, 0.0);
	struct sent list[CHUNK];
	bool is_sent;

	for (size_t i = 0; i < count; i++)
		prepare(b, &list[i], &writes[i]);
	is_sent = exchange(b, list, count);
	if (is_sent && has_forgotten(list, count))
		is_sent = backing_redis_link_load_scripts(&b->link) ==
		    ERR_OK && exchange(b, list, count);
	if (is_sent)
		is_sent = try_late(b, list, count);
	if (!is_sent || has_forgotten(list, count))
		settle(b, list, count, since);
	pthread_mutex_lock(&b->lock);
	b->settled = b->begun;
	pthread_mutex_unlock(&b->lock);
}

/* A connection, and its clock, not read too long ago: if it was set back, a
 * change would have more time than it may. */
static enum err be_ready(struct backing_redis *b)
{
	enum err err = backing_redis_link_open(&b->link);

	if (err == ERR_OK &&
	    clock_seconds() - b->link.clock_read > CLOCK_SECONDS)
		err = backing_redis_link_read_clock(&b->link);
	return err;
}

static enum err commit(struct backing *backing, struct backing_write *writes,
    size_t count)
{
	struct backing_redis *b = (struct backing_redis *)backing;
	size_t done = 0;

	for (size_t i = 0; i < count; i++) {
		writes[i].result = ERR_UNAVAILABLE;
		writes[i].has_found = false;
		writes[i].revision.before = (struct scene_seq){0, 0};
		writes[i].oldest = (struct scene_seq){0, 0};
	}
	pthread_mutex_lock(&b->writing);
	/* Who is known to be away is asked by the follower only. */
	while (done < count && atomic_load(&b->is_well)) {
		size_t some = count - done < CHUNK ? count - done : CHUNK;

		if (be_ready(b) != ERR_OK) {
			backing_redis_note(b, false, b->link.message);
			break;
		}
		commit_some(b, writes + done, some);
		done += some;
	}
	pthread_mutex_unlock(&b->writing);
	return done > 0 ? ERR_OK : ERR_UNAVAILABLE;
}

/* ---- reading ---- */

/* A connection, with b->writing; else ERR_UNAVAILABLE, without. Readers are
 * called after end(): they may wait for who waits for b->writing. */
static enum err begin(struct backing_redis *b)
{
	pthread_mutex_lock(&b->writing);
	if (atomic_load(&b->is_well) &&
	    backing_redis_link_open(&b->link) == ERR_OK)
		return ERR_OK;
	pthread_mutex_unlock(&b->writing);
	return ERR_UNAVAILABLE;
}

static void end(struct backing_redis *b)
{
	if (b->link.context == NULL)
		backing_redis_note(b, false, b->link.message);
	pthread_mutex_unlock(&b->writing);
}

static enum err refresh(struct backing *backing, const char *id,
    const struct backing_reader *reader)
{
	struct backing_redis *b = (struct backing_redis *)backing;
	enum err err = begin(b);
	redisReply *reply;

	if (err != ERR_OK)
		return err;
	reply = backing_redis_fetch(b, &b->link, id);
	end(b);
	if (reply == NULL)
		return ERR_UNAVAILABLE;
	err = backing_redis_tell(reply, id, &(struct backing_revision){0},
	    reader);
	if (err == ERR_OK)
		err = backing_redis_tell_past(reply, id, reader);
	freeReplyObject(reply);
	return err == ERR_INVALID ? ERR_UNAVAILABLE : err;
}

static enum err tell_read(const redisReply *reply, const char *id,
    const char *etag, const struct backing_reader *reader)
{
	struct backing_revision r = {.id = id, .etag = etag};

	if (!backing_redis_has_strings(reply, 4) ||
	    !scene_seq_parse(reply->element[0]->str, &r.seq))
		return ERR_NOT_FOUND;
	r.owner = reply->element[1]->str;
	r.nodes = strtoull(reply->element[2]->str, NULL, 10);
	r.text = reply->element[3]->str;
	r.length = (size_t)reply->element[3]->len;
	r.time = 1e-3 * (double)r.seq.major;
	return reader->revision(reader->ctx, &r);
}

/* Who is known to be away, or has just not answered, is not waited for. */
static bool may_read(const struct backing_redis *b)
{
	return !atomic_load(&b->is_read_over) && atomic_load(&b->is_well) &&
	    (b->failed == 0.0 ||
	    clock_seconds() - b->failed > READ_PAUSE_SECONDS);
}

static void note_failed_read(struct backing_redis *b)
{
	b->failed = clock_seconds();
	log_write(LOG_WARNING, "redis %s: %s; an older revision could not be "
	    "read", b->url.shown, b->reader.message);
}

/* By the reader's link, so that neither the writer nor the follower waits; that
 * it fails says nothing of theirs. */
static redisReply *ask_for_old(struct backing_redis *b, const char *id,
    const char *etag)
{
	char scene[BACKING_REDIS_KEY_MAX], history[BACKING_REDIS_KEY_MAX];
	struct backing_redis_call call;

	backing_redis_key(b, "scene:", id, scene);
	backing_redis_key(b, "history:", id, history);
	backing_redis_call_script(&call, SCRIPT_READ, 2);
	backing_redis_call_text(&call, scene);
	backing_redis_call_text(&call, history);
	backing_redis_call_text(&call, etag);
	return backing_redis_link_do(&b->reader, &call);
}

static enum err read_old(struct backing *backing, const char *id,
    const char *etag, const struct backing_reader *reader)
{
	struct backing_redis *b = (struct backing_redis *)backing;
	redisReply *reply = NULL;
	enum err err;

	if (!may_read(b))
		return ERR_UNAVAILABLE;
	if (backing_redis_link_open(&b->reader) == ERR_OK &&
	    !atomic_load(&b->is_read_over))
		reply = ask_for_old(b, id, etag);
	if (b->reader.context == NULL && !atomic_load(&b->is_read_over))
		note_failed_read(b);
	err = reply != NULL ? tell_read(reply, id, etag, reader) :
	    ERR_UNAVAILABLE;
	freeReplyObject(reply);
	return err;
}

static void stop_reading(struct backing *backing)
{
	struct backing_redis *b = (struct backing_redis *)backing;

	atomic_store(&b->is_read_over, true);
	backing_redis_link_break(&b->reader);
}

/* ---- volumes ---- */

static redisReply *ask_for_volume(struct backing_redis *b, const char *kind,
    const struct backing_volume *v)
{
	char key[BACKING_REDIS_KEY_MAX], token[BACKING_REDIS_TOKEN_MAX];
	struct backing_redis_call call;
	char latest[32];

	snprintf(latest, sizeof latest, "%.0f",
	    backing_redis_link_time(&b->link, BACKING_REDIS_ACT_SECONDS));
	backing_redis_token(b, ++b->begun, token);
	backing_redis_key(b, "volume:", v->id, key);
	backing_redis_call_script(&call, SCRIPT_VOLUME, 4);
	backing_redis_call_text(&call, key);
	backing_redis_call_text(&call, b->volumes);
	backing_redis_call_text(&call, b->changes);
	backing_redis_call_text(&call, b->last);
	backing_redis_call_text(&call, kind);
	backing_redis_call_text(&call, v->id);
	backing_redis_call_add(&call, v->length > 0 ? v->data : "", v->length);
	backing_redis_call_text(&call, token);
	backing_redis_call_text(&call, BACKING_REDIS_ENTRIES);
	backing_redis_call_text(&call, BACKING_REDIS_GRACE);
	backing_redis_call_text(&call, latest);
	backing_redis_call_text(&call, v->owner != NULL ? v->owner : "");
	return backing_redis_link_do(&b->link, &call);
}

static bool is_word(const redisReply *reply, const char *word)
{
	return reply != NULL && reply->type == REDIS_REPLY_STRING &&
	    strcmp(reply->str, word) == 0;
}

/* As its script says what has become of it, and whose it is. */
static enum err read_volume_result(struct backing_redis *b,
    const redisReply *reply, const struct backing_volume *v)
{
	struct scene_seq seq;

	if (is_word(reply, "early"))
		return ERR_BUSY;
	if (is_word(reply, ""))
		return ERR_NOT_FOUND;
	if (reply == NULL || !backing_redis_has_strings(reply, 2))
		return ERR_UNAVAILABLE; /* "late", too */
	if (scene_seq_parse(reply->element[0]->str, &seq))
		backing_redis_note_made(b, seq, NULL);
	if (v->kept_owner != NULL)
		snprintf(v->kept_owner, TOKEN_NAME_MAX + 1, "%s",
		    reply->element[1]->str);
	return ERR_OK;
}

static enum err change_volume(struct backing_redis *b, const char *kind,
    const struct backing_volume *v)
{
	enum err err = begin(b);
	redisReply *reply;

	if (err != ERR_OK)
		return err;
	reply = ask_for_volume(b, kind, v);
	/* As try_late does. */
	if (is_word(reply, "late") &&
	    backing_redis_link_read_clock(&b->link) == ERR_OK) {
		freeReplyObject(reply);
		reply = ask_for_volume(b, kind, v);
	}
	if (reply == NULL)
		note_doubts(b, &(struct sent){.number = b->begun,
		    .is_open = true}, 1);
	pthread_mutex_lock(&b->lock);
	b->settled = b->begun;
	pthread_mutex_unlock(&b->lock);
	err = read_volume_result(b, reply, v);
	freeReplyObject(reply);
	end(b);
	return err;
}

static enum err put_volume(struct backing *backing,
    const struct backing_volume *v)
{
	return change_volume((struct backing_redis *)backing, "volume", v);
}

static enum err forget_volume(struct backing *backing, const char *id,
    bool is_gone)
{
	return change_volume((struct backing_redis *)backing, is_gone ? "gone" :
	    "forget", &(struct backing_volume){.id = id});
}

static enum err get_volume(struct backing *backing, const char *id,
    const struct backing_reader *reader)
{
	struct backing_redis *b = (struct backing_redis *)backing;
	enum err err = begin(b);

	redisReply *reply;

	if (err != ERR_OK)
		return err;
	reply = backing_redis_fetch_volume(b, &b->link, id);
	end(b);
	err = backing_redis_tell_volume(reply, id, reader);
	freeReplyObject(reply);
	return err;
}

/* ---- loading ---- */

/* As begin, of one that may have been away. */
static enum err begin_loading(struct backing_redis *b)
{
	pthread_mutex_lock(&b->writing);
	if (backing_redis_link_open(&b->link) == ERR_OK)
		return ERR_OK;
	pthread_mutex_unlock(&b->writing);
	return ERR_UNAVAILABLE;
}

static void end_loading(struct backing_redis *b)
{
	pthread_mutex_unlock(&b->writing);
}

/* The members of a set, or NULL. */
static redisReply *members(struct backing_redis *b, const char *key)
{
	struct backing_redis_call call;
	redisReply *reply;

	if (begin_loading(b) != ERR_OK)
		return NULL;
	backing_redis_call_init(&call, "SMEMBERS");
	backing_redis_call_text(&call, key);
	reply = backing_redis_link_do(&b->link, &call);
	end_loading(b);
	if (reply == NULL || backing_redis_has_strings(reply, reply->elements))
		return reply;
	freeReplyObject(reply);
	snprintf(b->link.message, sizeof b->link.message, "%s is no set", key);
	return NULL;
}

static enum err load_volume(struct backing_redis *b, const char *id,
    const struct backing_reader *reader)
{
	redisReply *reply;
	enum err err = begin_loading(b);

	if (err != ERR_OK)
		return err;
	reply = backing_redis_fetch_volume(b, &b->link, id);
	end_loading(b);
	err = backing_redis_tell_volume(reply, id, reader);
	freeReplyObject(reply);
	return err != ERR_NOT_FOUND ? err : ERR_OK; /* gone meanwhile */
}

static enum err load_volumes(struct backing_redis *b,
    const struct backing_reader *reader)
{
	redisReply *ids = members(b, b->volumes);
	enum err err = ids != NULL ? ERR_OK : ERR_UNAVAILABLE;

	for (size_t i = 0; err == ERR_OK && i < ids->elements; i++)
		err = load_volume(b, ids->element[i]->str, reader);
	freeReplyObject(ids);
	return err;
}

static bool ask_for_scene(struct backing_redis *b, const char *id)
{
	char scene[BACKING_REDIS_KEY_MAX], history[BACKING_REDIS_KEY_MAX];
	struct backing_redis_call call;

	backing_redis_key(b, "scene:", id, scene);
	backing_redis_key(b, "history:", id, history);
	backing_redis_call_script(&call, SCRIPT_FETCH, 3);
	backing_redis_call_text(&call, scene);
	backing_redis_call_text(&call, history);
	backing_redis_call_text(&call, b->last);
	return backing_redis_link_send(&b->link, &call);
}

/* What is kept of each; replies have to be freed, also on failure. *error: an
 * answer that is one, or NULL. */
static enum err ask_for_some(struct backing_redis *b, redisReply *const *ids,
    size_t count, redisReply *replies[static CHUNK], redisReply **error)
{
	*error = NULL;
	for (size_t i = 0; i < count; i++) {
		freeReplyObject(replies[i]);
		replies[i] = NULL;
	}
	for (size_t i = 0; i < count; i++)
		if (!ask_for_scene(b, ids[i]->str))
			return ERR_UNAVAILABLE;
	for (size_t i = 0; i < count; i++) {
		replies[i] = backing_redis_link_get(&b->link);
		if (replies[i] == NULL)
			return ERR_UNAVAILABLE;
		if (replies[i]->type == REDIS_REPLY_ERROR)
			*error = replies[i];
	}
	return ERR_OK;
}

/* The same, once more where the script has been forgotten. */
static enum err fetch_some(struct backing_redis *b, redisReply *const *ids,
    size_t count, redisReply *replies[static CHUNK])
{
	redisReply *error;
	enum err err = ask_for_some(b, ids, count, replies, &error);

	if (err == ERR_OK && error != NULL &&
	    backing_redis_is_forgotten(error)) {
		err = backing_redis_link_load_scripts(&b->link);
		if (err == ERR_OK)
			err = ask_for_some(b, ids, count, replies, &error);
	}
	if (err != ERR_OK || error == NULL)
		return err;
	snprintf(b->link.message, sizeof b->link.message, "%s", error->str);
	backing_redis_link_close(&b->link);
	return ERR_UNAVAILABLE;
}

static enum err tell_loaded(struct backing_redis *b, const redisReply *reply,
    const char *id, const struct backing_reader *reader)
{
	enum err err = backing_redis_tell(reply, id, NULL, reader);

	if (err != ERR_INVALID)
		return err;
	snprintf(b->link.message, sizeof b->link.message,
	    "what it has of scene '%.64s' is damaged", id);
	return ERR_UNAVAILABLE;
}

/* All answers are read before any is told of, since readers may ask for more. */
static enum err load_some(struct backing_redis *b, redisReply *const *ids,
    size_t count, const struct backing_reader *reader)
{
	redisReply *replies[CHUNK] = {NULL};
	enum err err = begin_loading(b);

	if (err != ERR_OK)
		return err;
	err = fetch_some(b, ids, count, replies);
	end_loading(b);
	for (size_t i = 0; i < count; i++) {
		if (err == ERR_OK)
			err = tell_loaded(b, replies[i], ids[i]->str, reader);
		freeReplyObject(replies[i]);
	}
	return err;
}

static enum err load_scenes(struct backing_redis *b,
    const struct backing_reader *reader)
{
	redisReply *ids = members(b, b->scenes);
	enum err err = ids != NULL ? ERR_OK : ERR_UNAVAILABLE;

	for (size_t i = 0; err == ERR_OK && i < ids->elements; i += CHUNK) {
		size_t rest = ids->elements - i;

		err = load_some(b, ids->element + i, rest < CHUNK ? rest :
		    CHUNK, reader);
	}
	freeReplyObject(ids);
	return err;
}

/* What has happened before is in what is loaded; some that comes after is, too. */
static enum err read_position(struct backing_redis *b,
    char out[static BACKING_REDIS_ID_MAX])
{
	struct backing_redis_call call;
	redisReply *reply;

	if (begin_loading(b) != ERR_OK)
		return ERR_UNAVAILABLE;
	backing_redis_call_init(&call, "GET");
	backing_redis_call_text(&call, b->last);
	reply = backing_redis_link_do(&b->link, &call);
	end_loading(b);
	if (reply == NULL)
		return ERR_UNAVAILABLE;
	snprintf(out, BACKING_REDIS_ID_MAX, "%s", reply->type ==
	    REDIS_REPLY_STRING ? reply->str : "0-0");
	freeReplyObject(reply);
	return ERR_OK;
}

static void set_state(struct backing_redis *b, enum backing_redis_state state,
    const char *position)
{
	pthread_mutex_lock(&b->lock);
	b->state = state;
	if (position != NULL) {
		strcpy(b->position, position);
		b->generation++;
	}
	pthread_cond_broadcast(&b->changed);
	pthread_mutex_unlock(&b->lock);
}

/* What is made from now on is to be there when it is loaded. */
static void note_loading(struct backing_redis *b)
{
	pthread_mutex_lock(&b->lock);
	b->state = STATE_LOADING;
	b->made = (struct scene_seq){0, 0};
	pthread_mutex_unlock(&b->lock);
}

static enum err load(struct backing *backing,
    const struct backing_reader *reader)
{
	struct backing_redis *b = (struct backing_redis *)backing;
	char position[BACKING_REDIS_ID_MAX];
	enum err err;

	note_loading(b);
	err = read_position(b, position);
	if (err == ERR_OK)
		err = load_volumes(b, reader);
	if (err == ERR_OK)
		err = load_scenes(b, reader);
	/* It is tried again and again: said once. */
	if (err == ERR_UNAVAILABLE && !b->is_load_failing)
		log_write(LOG_WARNING, "redis %s: %s; its scenes cannot be "
		    "read yet", b->url.shown, b->link.message);
	b->is_load_failing = err == ERR_UNAVAILABLE;
	if (err == ERR_OK)
		backing_redis_note(b, true, "");
	set_state(b, err == ERR_OK ? STATE_LOADED : STATE_STALE,
	    err == ERR_OK ? position : NULL);
	return err;
}

/* ---- the rest ---- */

static bool is_well(struct backing *backing)
{
	struct backing_redis *b = (struct backing_redis *)backing;

	return atomic_load(&b->is_well);
}

static void fini(struct backing_redis *b)
{
	backing_redis_link_fini(&b->link);
	backing_redis_link_fini(&b->follower);
	backing_redis_link_fini(&b->reader);
	pthread_mutex_destroy(&b->writing);
	pthread_mutex_destroy(&b->lock);
	pthread_cond_destroy(&b->changed);
	free(b);
}

static void free_redis(struct backing *backing)
{
	struct backing_redis *b = (struct backing_redis *)backing;

	pthread_mutex_lock(&b->lock);
	b->is_ending = true;
	pthread_cond_broadcast(&b->changed);
	pthread_mutex_unlock(&b->lock);
	backing_redis_link_break(&b->follower);
	pthread_join(b->thread, NULL);
	fini(b);
}

static const struct backing_ops ops = {
	.load = load,
	.commit = commit,
	.refresh = refresh,
	.read = read_old,
	.stop_reading = stop_reading,
	.put_volume = put_volume,
	.forget_volume = forget_volume,
	.get_volume = get_volume,
	.is_well = is_well,
	.free = free_redis,
};

static void init(struct backing_redis *b)
{
	pthread_condattr_t monotonic;

	pthread_mutex_init(&b->writing, NULL);
	pthread_condattr_init(&monotonic);
	pthread_condattr_setclock(&monotonic, CLOCK_MONOTONIC);
	pthread_cond_init(&b->changed, &monotonic);
	pthread_condattr_destroy(&monotonic);
	pthread_mutex_init(&b->lock, NULL);
	atomic_init(&b->is_well, false);
	atomic_init(&b->is_read_over, false);
	backing_redis_link_init(&b->link, &b->url);
	backing_redis_link_init(&b->follower, &b->url);
	backing_redis_link_init(&b->reader, &b->url);
	strcpy(b->position, "0-0");
	backing_redis_key(b, "scenes", "", b->scenes);
	backing_redis_key(b, "volumes", "", b->volumes);
	backing_redis_key(b, "changes", "", b->changes);
	backing_redis_key(b, "last", "", b->last);
	backing_redis_key(b, "alive", "", b->alive);
}

/* What tells this run of this daemon from all others. */
static enum err make_instance(char out[static BACKING_REDIS_INSTANCE_MAX])
{
	uint64_t number;

	if (getrandom(&number, sizeof number, 0) != sizeof number)
		return ERR_IO;
	snprintf(out, BACKING_REDIS_INSTANCE_MAX, "%016" PRIx64, number);
	return ERR_OK;
}

enum err backing_open_redis(const char *url,
    const struct backing_options *options, struct backing **out)
{
	struct backing_redis *b;
	struct backing_redis_url parsed;
	char text[BACKING_REDIS_TLS_WHY_MAX];
	const char *why = text;
	enum err err = backing_redis_url_parse(url, &parsed, &why);

	if (err == ERR_OK && parsed.is_tls)
		err = backing_redis_tls_check(&parsed, text);
	if (err != ERR_OK) {
		log_write(LOG_ERROR, "--store: %s", why);
		return err;
	}
	b = calloc(1, sizeof *b);
	if (b == NULL)
		return ERR_MEMORY;
	b->backing.ops = &ops;
	b->url = parsed;
	b->options = *options;
	init(b);
	if (make_instance(b->instance) != ERR_OK ||
	    pthread_create(&b->thread, NULL, backing_redis_follow, b) != 0) {
		fini(b);
		return ERR_IO;
	}
	*out = &b->backing;
	return ERR_OK;
}
