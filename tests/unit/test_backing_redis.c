/*
 * Scenes in a Redis: two backings on one redis-server, as two daemons have them,
 * some behind a man in the middle that loses requests or answers.
 */
#include <stdarg.h>
#include <stddef.h>
#include <setjmp.h>
#include <stdint.h>
#include <cmocka.h>

#include <errno.h>
#include <poll.h>
#include <pthread.h>
#include <signal.h>
#include <stdatomic.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/socket.h>
#include <sys/un.h>
#include <unistd.h>

#include "server/backing.h"
#include "server/backing_redis_url.h"
#include "server/clock.h"
#include "server/log.h"
#include "tests/support/load.h"
#include "tests/support/redis.h"

#define HISTORY 3
#define TOLD_MAX 300 /* the last of which stays unused */

/* ---- a store, as far as a backing sees it ---- */

struct told {
	char id[80], etag[40], text[80], owner[40];
	bool is_deleted, is_volume, is_forgotten, is_past, is_oldest;
	struct scene_seq seq, before;
	double time;
	size_t nodes, length;
};

struct daemon {
	struct backing *backing;
	pthread_mutex_t lock;       /* guards the rest */
	struct told list[TOLD_MAX]; /* by load, or changed */
	size_t count;
	atomic_int lost;
	pthread_mutex_t guard;
};

static enum err on_revision(void *ctx, const struct backing_revision *r)
{
	struct daemon *d = ctx;
	struct told *t;

	pthread_mutex_lock(&d->lock);
	t = &d->list[d->count];
	d->count += d->count < TOLD_MAX - 1;
	*t = (struct told){.is_deleted = r->text == NULL, .seq = r->seq,
	    .time = r->time, .nodes = r->nodes, .length = r->length,
	    .is_past = r->is_past, .is_oldest = r->is_oldest,
	    .before = r->before};
	snprintf(t->id, sizeof t->id, "%s", r->id);
	snprintf(t->etag, sizeof t->etag, "%s", r->etag);
	snprintf(t->owner, sizeof t->owner, "%s", r->owner);
	if (r->text != NULL)
		snprintf(t->text, sizeof t->text, "%s", r->text);
	pthread_mutex_unlock(&d->lock);
	return ERR_OK;
}

static enum err on_volume(void *ctx, const struct backing_volume *v)
{
	struct daemon *d = ctx;
	struct told *t;

	pthread_mutex_lock(&d->lock);
	t = &d->list[d->count];
	d->count += d->count < TOLD_MAX - 1;
	*t = (struct told){.is_volume = true, .is_forgotten = v->is_forgotten,
	    .length = v->length};
	snprintf(t->id, sizeof t->id, "%s", v->id);
	if (v->owner != NULL)
		snprintf(t->owner, sizeof t->owner, "%s", v->owner);
	if (v->data != NULL)
		memcpy(t->text, v->data, v->length);
	pthread_mutex_unlock(&d->lock);
	return ERR_OK;
}

static void on_guard(void *ctx, bool is_begun)
{
	struct daemon *d = ctx;

	if (is_begun)
		pthread_mutex_lock(&d->guard);
	else
		pthread_mutex_unlock(&d->guard);
}

static void on_lost(void *ctx)
{
	struct daemon *d = ctx;

	atomic_fetch_add(&d->lost, 1);
}

static struct backing_reader reader_of(struct daemon *d)
{
	return (struct backing_reader){on_revision, on_volume, d};
}

static enum err load(struct daemon *d)
{
	struct backing_reader reader = reader_of(d);

	pthread_mutex_lock(&d->lock);
	d->count = 0;
	pthread_mutex_unlock(&d->lock);
	return d->backing->ops->load(d->backing, &reader);
}

/* bytes 0: any */
static struct daemon *begin_with(const char *url, size_t history, size_t bytes)
{
	struct daemon *d = calloc(1, sizeof *d);
	struct backing_options options = {.history = history,
	    .history_bytes = bytes, .guard = on_guard, .lost = on_lost};

	assert_non_null(d);
	pthread_mutex_init(&d->lock, NULL);
	pthread_mutex_init(&d->guard, NULL);
	options.changed = reader_of(d);
	assert_int_equal(backing_open_redis(url, &options, &d->backing),
	    ERR_OK);
	return d;
}

static struct daemon *begin_at(const char *url)
{
	return begin_with(url, HISTORY, 0);
}

static struct daemon *begin(const char *url)
{
	struct daemon *d = begin_at(url);

	assert_int_equal(load(d), ERR_OK);
	return d;
}

static void end(struct daemon *d)
{
	d->backing->ops->free(d->backing);
	pthread_mutex_destroy(&d->lock);
	pthread_mutex_destroy(&d->guard);
	free(d);
}

/* A tag that has text in it. */
static void tag_of(const char *text, char out[static 40])
{
	snprintf(out, 40, "\"%s\"", text);
}

static struct backing_write write_of(const char *id, const char *text,
    const char *expected, bool is_any, char tag[static 40])
{
	struct backing_write w = {.expected = expected, .is_any = is_any};

	tag_of(text != NULL ? text : "", tag);
	w.revision = (struct backing_revision){.id = id, .etag = tag,
	    .text = text, .length = text != NULL ? strlen(text) : 0,
	    .owner = "ann", .nodes = 4};
	return w;
}

/* Like the store's writer: not while the follower tells something. */
static enum err change(struct daemon *d, const char *id, const char *text,
    const char *expected, bool is_any, struct scene_seq *seq)
{
	char tag[40];
	struct backing_write w = write_of(id, text, expected, is_any, tag);
	enum err err;

	on_guard(d, true);
	err = d->backing->ops->commit(d->backing, &w, 1);
	on_guard(d, false);
	if (err == ERR_OK && w.result == ERR_OK && seq != NULL)
		*seq = w.revision.seq;
	return err != ERR_OK ? err : w.result;
}

static enum err put(struct daemon *d, const char *id, const char *text)
{
	return change(d, id, text, NULL, true, NULL);
}

/* Whether t is of id, and present: not for the history, unless text is "". */
static bool counts(const struct told *t, const char *id, const char *text)
{
	return strcmp(t->id, id) == 0 && (t->is_deleted ||
	    t->text[0] != '\0' || (text != NULL && text[0] == '\0'));
}

/* What was told of id last, waiting until it has that text (NULL: deleted). */
static bool await_told(struct daemon *d, const char *id, const char *text)
{
	for (int i = 0; i < 3000; i++) {
		bool there = false;

		pthread_mutex_lock(&d->lock);
		for (size_t j = 0; j < d->count; j++)
			if (counts(&d->list[j], id, text))
				there = text != NULL ? strcmp(d->list[j].text,
				    text) == 0 : d->list[j].is_deleted;
		pthread_mutex_unlock(&d->lock);
		if (there)
			return true;
		usleep(10000);
	}
	return false;
}

static bool await_well(struct daemon *d, bool is_well)
{
	for (int i = 0; i < 3000; i++) {
		if (d->backing->ops->is_well(d->backing) == is_well)
			return true;
		usleep(10000);
	}
	return false;
}

static bool await_lost(struct daemon *d)
{
	for (int i = 0; i < 3000; i++) {
		if (atomic_load(&d->lost) > 0)
			return true;
		usleep(10000);
	}
	return false;
}

/* ---- the tests' Redis ---- */

static struct redis redis;

static int start_redis(void **state)
{
	(void)state;
	log_set_level(LOG_ERROR);
	signal(SIGPIPE, SIG_IGN); /* as the daemon has it */
	if (redis_is_installed())
		redis_start(&redis);
	return 0;
}

static int stop_redis(void **state)
{
	(void)state;
	if (redis.pid > 0)
		redis_stop(&redis);
	return 0;
}

static int clean(void **state)
{
	(void)state;
	if (redis.pid > 0)
		redis_cli(&redis, "flushall", NULL, 0);
	return 0;
}

static void need_redis(void)
{
	if (redis.pid > 0)
		return;
	print_message("skipped: there is no redis-server\n");
	skip();
}

/* ---- addresses ---- */

static void test_redis_url_forms(void **state)
{
	struct backing_redis_url url;
	const char *why = NULL;

	(void)state;
	assert_int_equal(backing_redis_url_parse("redis://localhost", &url,
	    &why), ERR_OK);
	assert_string_equal(url.host, "localhost");
	assert_int_equal(url.port, 6379);
	assert_string_equal(url.prefix, "{blobfield}:");
	assert_int_equal(backing_redis_url_parse(
	    "redis://me:p%40ss%3a@[::1]:7000/12?prefix=a.b", &url, &why),
	    ERR_OK);
	assert_string_equal(url.host, "::1");
	assert_int_equal(url.port, 7000);
	assert_int_equal(url.database, 12);
	assert_string_equal(url.user, "me");
	assert_string_equal(url.password, "p@ss:");
	assert_string_equal(url.prefix, "{a.b}:");
	assert_null(strstr(url.shown, "ss"));
	assert_int_equal(backing_redis_url_parse(
	    "redis+unix://:x@/run/r.sock?database=3", &url, &why), ERR_OK);
	assert_string_equal(url.host, "/run/r.sock");
	assert_int_equal(url.port, 0);
	assert_int_equal(url.database, 3);
	assert_string_equal(url.password, "x");
	assert_false(url.is_tls);
}

static void test_redis_url_of_tls(void **state)
{
	struct backing_redis_url url;
	const char *why = NULL;

	(void)state;
	assert_int_equal(backing_redis_url_parse("rediss://a", &url, &why),
	    ERR_OK);
	assert_true(url.is_tls);
	assert_string_equal(url.host, "a");
	assert_int_equal(url.port, 6379);
	assert_string_equal(url.ca, "");
	assert_int_equal(backing_redis_url_parse("rediss://:x@a:7/2?"
	    "ca=/etc/my%20ca.pem&prefix=p&key=k&cert=c", &url, &why), ERR_OK);
	assert_string_equal(url.ca, "/etc/my ca.pem");
	assert_string_equal(url.cert, "c");
	assert_string_equal(url.key, "k");
	assert_string_equal(url.prefix, "{p}:");
	assert_int_equal(url.database, 2);
}

static void test_redis_url_refused(void **state)
{
	static const char *const bad[] = {"", "http://a", "redis://",
	    "redis://a:0", "redis://a:65536", "redis://a:x", "redis://a/x",
	    "redis://a?b=1", "redis://a?prefix=", "redis://a?prefix={x}",
	    "redis://[::1", "redis://[::1]x", "redis://a@b", "redis://u:@b",
	    "redis://:%0@b", "redis://:%00@b", "redis://:a%2", "redis+unix://a",
	    "redis://a:1:2", "rediss://", "rediss://a?ca=", "rediss://a?ca=%0",
	    "rediss://a?cert=c", "rediss://a?key=k", "redis://a?ca=x",
	    "redis+unix:///a?ca=x", "rediss:/a", "redisss://a"};

	(void)state;
	for (size_t i = 0; i < sizeof bad / sizeof *bad; i++) {
		struct backing_redis_url url;
		const char *why = NULL;

		if (backing_redis_url_parse(bad[i], &url, &why) !=
		    ERR_INVALID)
			fail_msg("'%s' is taken", bad[i]);
		assert_non_null(why);
	}
}

/* ---- keeping ---- */

static void test_redis_kept_is_loaded_elsewhere(void **state)
{
	struct daemon *a, *b;
	struct scene_seq seq = {0, 0};

	(void)state;
	need_redis();
	a = begin(redis.url);
	assert_int_equal(change(a, "s", "one", NULL, false, &seq), ERR_OK);
	b = begin(redis.url);
	assert_int_equal(b->count, 1);
	assert_string_equal(b->list[0].id, "s");
	assert_string_equal(b->list[0].etag, "\"one\"");
	assert_string_equal(b->list[0].text, "one");
	assert_string_equal(b->list[0].owner, "ann");
	assert_int_equal(b->list[0].nodes, 4);
	assert_int_equal(b->list[0].length, 3);
	assert_int_equal(scene_seq_compare(b->list[0].seq, seq), 0);
	assert_true(b->list[0].time > 1.7e9);
	end(b);
	end(a);
}

static void test_redis_history_is_cut_and_read(void **state)
{
	static const char *const texts[] = {"t0", "t1", "t2", "t3", "t4"};
	struct backing_reader reader;
	struct daemon *a;

	(void)state;
	need_redis();
	a = begin(redis.url);
	for (int i = 0; i < 5; i++)
		assert_int_equal(put(a, "s", texts[i]), ERR_OK);
	assert_int_equal(load(a), ERR_OK);
	/* Older ones have no text, the oldest comes first. */
	assert_int_equal(a->count, HISTORY);
	assert_string_equal(a->list[0].etag, "\"t2\"");
	assert_string_equal(a->list[0].text, "");
	assert_int_equal(a->list[0].length, 2);
	assert_string_equal(a->list[1].etag, "\"t3\"");
	assert_string_equal(a->list[2].text, "t4");
	assert_true(scene_seq_compare(a->list[0].seq, a->list[1].seq) < 0);
	reader = reader_of(a);
	a->count = 0;
	assert_int_equal(a->backing->ops->read(a->backing, "s", "\"t2\"",
	    &reader), ERR_OK);
	assert_string_equal(a->list[0].text, "t2");
	assert_int_equal(a->backing->ops->read(a->backing, "s", "\"t1\"",
	    &reader), ERR_NOT_FOUND);
	end(a);
}

/* ---- what the past may take ---- */

/* Whether the revision of s with that text can be read. */
static bool has(struct daemon *d, const char *text)
{
	struct backing_reader reader = reader_of(d);
	char tag[40];
	enum err err;

	tag_of(text, tag);
	err = d->backing->ops->read(d->backing, "s", tag, &reader);
	if (err != ERR_OK && err != ERR_NOT_FOUND)
		fail_msg("reading: %s", err_message(err));
	return err == ERR_OK;
}

/* Puts text as s; gives the tag of the oldest that the store is told is kept. */
static void put_and_see(struct daemon *d, const char *text,
    struct scene_seq *seq, struct scene_seq *oldest)
{
	char tag[40];
	struct backing_write w = write_of("s", text, NULL, true, tag);

	on_guard(d, true);
	assert_int_equal(d->backing->ops->commit(d->backing, &w, 1), ERR_OK);
	on_guard(d, false);
	assert_int_equal(w.result, ERR_OK);
	*seq = w.revision.seq;
	*oldest = w.oldest;
}

static void test_redis_history_bytes_at_below_and_above_the_bound(void **state)
{
	static const char *const texts[] = {"aaaa", "bbbbb", "c", "dd",
	    "eeeeeeeeeeeeeeeeeeee", "fff"};
	/* of past ones at most 9: the oldest that is left after each */
	static const int oldest[] = {0, 0, 0 /* 9 */, 1 /* 8; 10, one more */,
	    1 /* 8 */, 5 /* 20: alone beyond it */};
	struct scene_seq seqs[6], first;
	struct daemon *a;

	(void)state;
	need_redis();
	a = begin_with(redis.url, 100, 9);
	assert_int_equal(load(a), ERR_OK);
	for (int i = 0; i < 6; i++) {
		assert_int_equal(put(a, "other", texts[i]), ERR_OK);
		put_and_see(a, texts[i], &seqs[i], &first);
		assert_int_equal(scene_seq_compare(first, seqs[oldest[i]]), 0);
		for (int j = 0; j <= i; j++)
			assert_int_equal(has(a, texts[j]), j >= oldest[i]);
	}
	/* what is listed is what can be read */
	assert_int_equal(load(a), ERR_OK);
	assert_int_equal(a->count, 2);
	end(a);
}

/* Each daemon's own bounds hold after its changes, and the others hear of it. */
static void test_redis_history_bytes_of_two_daemons(void **state)
{
	struct scene_seq seq, oldest;
	struct daemon *a, *b;
	char bytes[64];

	(void)state;
	need_redis();
	a = begin_with(redis.url, 100, 1000);
	b = begin_with(redis.url, 100, 5);
	assert_int_equal(load(a), ERR_OK);
	assert_int_equal(load(b), ERR_OK);
	put_and_see(a, "aaaa", &seq, &oldest);
	put_and_see(a, "bbbb", &seq, &oldest);
	put_and_see(a, "c", &seq, &oldest);
	assert_true(has(b, "aaaa"));
	put_and_see(b, "dd", &seq, &oldest); /* bbbb and c: 5 */
	assert_true(await_told(a, "s", "dd"));
	pthread_mutex_lock(&a->lock);
	assert_string_equal(a->list[a->count - 1].etag, "\"c\"");
	for (size_t i = 0; i < a->count; i++)
		assert_int_equal(a->list[i].is_oldest,
		    strcmp(a->list[i].etag, "\"bbbb\"") == 0);
	pthread_mutex_unlock(&a->lock);
	assert_false(has(a, "aaaa"));
	assert_true(has(a, "bbbb"));
	put_and_see(a, "ee", &seq, &oldest);
	put_and_see(a, "ff", &seq, &oldest);
	assert_true(has(a, "bbbb"));
	/* as a daemon leaves it that does not know of the sum */
	redis_cli(&redis, "hdel '{blobfield}:scene:s' past", NULL, 0);
	put_and_see(b, "g", &seq, &oldest); /* ee and ff: 4; dd: 6 */
	assert_false(has(b, "dd"));
	assert_true(has(b, "ee") && has(b, "ff"));
	redis_cli(&redis, "hget '{blobfield}:scene:s' past", bytes,
	    sizeof bytes);
	assert_string_equal(strchr(bytes, ' '), " 5\n");
	end(b);
	end(a);
}

static void test_redis_deleted_is_gone_with_its_past(void **state)
{
	struct daemon *a;

	(void)state;
	need_redis();
	a = begin(redis.url);
	assert_int_equal(put(a, "s", "x"), ERR_OK);
	assert_int_equal(change(a, "s", NULL, "\"x\"", false, NULL), ERR_OK);
	assert_int_equal(change(a, "s", NULL, NULL, true, NULL),
	    ERR_NOT_FOUND);
	assert_int_equal(load(a), ERR_OK);
	assert_int_equal(a->count, 0);
	end(a);
}

static void test_redis_expected_tag_decides(void **state)
{
	struct daemon *a, *b;

	(void)state;
	need_redis();
	a = begin(redis.url);
	b = begin(redis.url);
	assert_int_equal(change(a, "s", "1", NULL, false, NULL), ERR_OK);
	assert_int_equal(change(b, "s", "2", NULL, false, NULL),
	    ERR_CONFLICT);
	assert_int_equal(change(b, "s", "2", "\"1\"", false, NULL), ERR_OK);
	assert_int_equal(change(a, "s", "3", "\"1\"", false, NULL),
	    ERR_CONFLICT);
	assert_int_equal(change(a, "s", NULL, "\"1\"", false, NULL),
	    ERR_CONFLICT);
	end(b);
	end(a);
}

static void test_redis_batch_has_a_result_each(void **state)
{
	static const enum err want[3] = {ERR_OK, ERR_CONFLICT, ERR_OK};
	struct backing_write writes[3];
	struct daemon *a;
	char tags[3][40];

	(void)state;
	need_redis();
	a = begin(redis.url);
	writes[0] = write_of("s", "1", NULL, false, tags[0]);
	writes[1] = write_of("s", "2", NULL, false, tags[1]);
	writes[2] = write_of("s", "3", "\"1\"", false, tags[2]);
	assert_int_equal(a->backing->ops->commit(a->backing, writes, 3),
	    ERR_OK);
	for (int i = 0; i < 3; i++)
		assert_int_equal(writes[i].result, want[i]);
	assert_true(scene_seq_compare(writes[0].revision.seq,
	    writes[2].revision.seq) < 0);
	end(a);
}

static void test_redis_large_batch(void **state)
{
	enum { COUNT = 100 };
	struct backing_write writes[COUNT];
	char tags[COUNT][40], ids[COUNT][16];
	struct daemon *a;

	(void)state;
	need_redis();
	a = begin(redis.url);
	for (int i = 0; i < COUNT; i++) {
		snprintf(ids[i], sizeof ids[i], "s%d", i);
		writes[i] = write_of(ids[i], ids[i], NULL, false, tags[i]);
	}
	on_guard(a, true);
	assert_int_equal(a->backing->ops->commit(a->backing, writes, COUNT),
	    ERR_OK);
	on_guard(a, false);
	for (int i = 0; i < COUNT; i++)
		assert_int_equal(writes[i].result, ERR_OK);
	assert_int_equal(load(a), ERR_OK);
	assert_int_equal(a->count, COUNT);
	end(a);
}

static void test_redis_bytes_are_kept_as_they_are(void **state)
{
	static const char text[] = "a\0b\r\n\xff$3";
	struct backing_write w;
	struct daemon *a;
	char tag[40];

	(void)state;
	need_redis();
	a = begin(redis.url);
	w = write_of("s", text, NULL, true, tag);
	w.revision.length = sizeof text;
	on_guard(a, true);
	assert_int_equal(a->backing->ops->commit(a->backing, &w, 1), ERR_OK);
	on_guard(a, false);
	assert_int_equal(load(a), ERR_OK);
	assert_int_equal(a->list[0].length, sizeof text);
	end(a);
}

static void test_redis_forgotten_scripts_are_sent_again(void **state)
{
	struct backing_reader reader;
	struct daemon *a;

	(void)state;
	need_redis();
	a = begin(redis.url);
	redis_cli(&redis, "script flush", NULL, 0);
	assert_int_equal(put(a, "s", "1"), ERR_OK);
	redis_cli(&redis, "script flush", NULL, 0);
	reader = reader_of(a);
	assert_int_equal(a->backing->ops->refresh(a->backing, "s", &reader),
	    ERR_OK);
	assert_true(await_told(a, "s", "1"));
	end(a);
}

/* What is read anew needs them, too. */
static void test_redis_forgotten_scripts_do_not_stop_a_load(void **state)
{
	struct daemon *a;

	(void)state;
	need_redis();
	a = begin(redis.url);
	assert_int_equal(put(a, "s", "1"), ERR_OK);
	redis_cli(&redis, "script flush", NULL, 0);
	assert_int_equal(load(a), ERR_OK);
	assert_string_equal(a->list[0].text, "1");
	end(a);
}

/* The owner of what is there stays, and is told; so is what was there. */
static void test_redis_owner_of_what_is_there_stays(void **state)
{
	struct backing_write w[2];
	struct daemon *a;
	char tags[2][40];

	(void)state;
	need_redis();
	a = begin(redis.url);
	w[0] = write_of("s", "1", NULL, true, tags[0]);
	w[1] = write_of("s", "2", NULL, true, tags[1]);
	w[1].revision.owner = "bob";
	assert_int_equal(a->backing->ops->commit(a->backing, w, 2), ERR_OK);
	assert_true(w[0].has_found && !w[0].was_there);
	assert_true(w[1].has_found && w[1].was_there);
	assert_string_equal(w[1].owner, "ann");
	assert_int_equal(scene_seq_compare(w[1].revision.before,
	    w[0].revision.seq), 0);
	assert_int_equal(load(a), ERR_OK);
	assert_string_equal(a->list[1].owner, "ann");
	end(a);
}

static void test_redis_refresh_tells_what_is_there(void **state)
{
	struct backing_reader reader;
	struct daemon *a;

	(void)state;
	need_redis();
	a = begin(redis.url);
	reader = reader_of(a);
	assert_int_equal(a->backing->ops->refresh(a->backing, "s", &reader),
	    ERR_OK);
	assert_int_equal(a->count, 1);
	assert_true(a->list[0].is_deleted);
	assert_int_equal(put(a, "s", "1"), ERR_OK);
	assert_int_equal(a->backing->ops->refresh(a->backing, "s", &reader),
	    ERR_OK);
	assert_string_equal(a->list[1].text, "1");
	end(a);
}

/* ---- volumes ---- */

static void test_redis_volumes(void **state)
{
	static const struct backing_volume v = {"0123", "abc", 3, false,
	    "me", NULL};
	struct backing_reader reader;
	struct daemon *a, *b;

	(void)state;
	need_redis();
	a = begin(redis.url);
	b = begin(redis.url);
	reader = reader_of(b);
	assert_int_equal(b->backing->ops->get_volume(b->backing, "0123",
	    &reader), ERR_NOT_FOUND);
	assert_int_equal(a->backing->ops->put_volume(a->backing, &v), ERR_OK);
	assert_true(await_told(b, "0123", "abc"));
	assert_int_equal(a->backing->ops->forget_volume(a->backing, "0123",
	    false), ERR_OK);
	end(b);
	b = begin(redis.url);
	assert_true(b->count == 1 && b->list[0].is_volume &&
	    b->list[0].is_forgotten);
	assert_string_equal(b->list[0].text, "abc");
	assert_int_equal(a->backing->ops->forget_volume(a->backing, "0123",
	    true), ERR_BUSY); /* another daemon may be about to use it */
	redis_cli(&redis, "hset '{blobfield}:volume:0123' since 1", NULL, 0);
	assert_int_equal(a->backing->ops->forget_volume(a->backing, "0123",
	    true), ERR_OK);
	assert_int_equal(a->backing->ops->forget_volume(a->backing, "0123",
	    true), ERR_NOT_FOUND);
	end(b);
	b = begin(redis.url);
	assert_int_equal(b->count, 0);
	end(b);
	end(a);
}

/* What a new daemon is told of whose volume 0123 is. */
static void assert_owner(const char *owner)
{
	struct daemon *d = begin(redis.url);

	assert_int_equal(d->count, 1);
	assert_string_equal(d->list[0].owner, owner);
	end(d);
}

static void test_redis_volumes_have_owners(void **state)
{
	char kept[TOKEN_NAME_MAX + 1] = "";
	struct backing_volume v = {"0123", "abc", 3, false, "me", kept};
	struct daemon *a;

	(void)state;
	need_redis();
	a = begin(redis.url);
	assert_int_equal(a->backing->ops->put_volume(a->backing, &v), ERR_OK);
	assert_string_equal(kept, "me");
	assert_owner("me");
	/* Of two daemons at once, the first one's stays. */
	v.owner = "you";
	assert_int_equal(a->backing->ops->put_volume(a->backing, &v), ERR_OK);
	assert_string_equal(kept, "me");
	assert_owner("me");
	for (int i = 0; i < 2; i++) {
		assert_int_equal(a->backing->ops->forget_volume(a->backing,
		    "0123", false), ERR_OK);
		assert_owner("me");
	}
	assert_int_equal(a->backing->ops->put_volume(a->backing, &v), ERR_OK);
	assert_string_equal(kept, "you");
	assert_owner("you");
	/* Kept again by a daemon that knows of none, it is not of before. */
	assert_int_equal(a->backing->ops->forget_volume(a->backing, "0123",
	    false), ERR_OK);
	redis_cli(&redis, "hset '{blobfield}:volume:0123' data abc forgotten 0",
	    NULL, 0);
	assert_owner("");
	assert_int_equal(a->backing->ops->forget_volume(a->backing, "0123",
	    false), ERR_OK);
	assert_owner("");
	assert_int_equal(a->backing->ops->put_volume(a->backing, &v), ERR_OK);
	assert_owner("you");
	/* As daemons that know of none have kept it. */
	redis_cli(&redis, "hdel '{blobfield}:volume:0123' owner", NULL, 0);
	assert_owner("");
	end(a);
}

/* ---- following ---- */

/* What is told of it is what Redis has, and what this daemon has done last may have
 * come before it was heard of. */
static void test_redis_volume_of_two_daemons_is_told(void **state)
{
	struct backing_volume v = {"0123", "abc", 3, false, "me", NULL};
	struct daemon *a, *b;

	(void)state;
	need_redis();
	a = begin(redis.url);
	b = begin(redis.url);
	on_guard(b, true);
	assert_int_equal(put(a, "s", "1"), ERR_OK);
	usleep(100000); /* b's follower waits with that, most likely */
	assert_int_equal(a->backing->ops->put_volume(a->backing, &v), ERR_OK);
	v.owner = "you";
	assert_int_equal(b->backing->ops->put_volume(b->backing, &v), ERR_OK);
	on_guard(b, false);
	assert_true(await_told(b, "0123", "abc"));
	assert_string_equal(b->list[b->count - 1].owner, "me");
	end(b);
	end(a);
}

static void test_redis_follower_tells_of_others_only(void **state)
{
	struct daemon *a, *b;

	(void)state;
	need_redis();
	a = begin(redis.url);
	b = begin(redis.url);
	for (int i = 0; i < 20; i++) {
		char text[16];

		snprintf(text, sizeof text, "%d", i);
		assert_int_equal(put(a, "s", text), ERR_OK);
	}
	assert_true(await_told(b, "s", "19"));
	assert_int_equal(change(b, "s", NULL, NULL, true, NULL), ERR_OK);
	assert_true(await_told(a, "s", NULL));
	/* None of a's own. */
	assert_int_equal(a->count, 1);
	assert_int_equal(atomic_load(&a->lost) + atomic_load(&b->lost), 0);
	end(b);
	end(a);
}

/* What is overtaken before it can be told comes without its text, before what is
 * present, and again behind it. */
static void test_redis_overtaken_revisions_are_told_for_the_history(
    void **state)
{
	static const char *const texts[] = {"0", "1", "2", "3"};
	struct daemon *a, *b;

	(void)state;
	need_redis();
	a = begin(redis.url);
	b = begin(redis.url);
	on_guard(b, true);
	for (int i = 0; i < 4; i++) {
		assert_int_equal(put(a, "s", texts[i]), ERR_OK);
		usleep(20000);
	}
	on_guard(b, false);
	assert_true(await_told(b, "s", "3"));
	assert_int_equal(put(a, "t", "end"), ERR_OK);
	assert_true(await_told(b, "t", "end"));
	for (int i = 0; i < 2; i++) {
		const struct told *t = &b->list[i];

		assert_int_equal(t->etag[1], texts[1 + i][0]);
		assert_true(t->is_past && t->length == 1 && t->nodes == 4);
		assert_int_equal(t->is_oldest, i == 0);
	}
	assert_string_equal(b->list[2].text, "3");
	assert_true(!b->list[2].is_past && !b->list[2].is_oldest);
	assert_true(b->list[3].is_past && b->list[4].is_past);
	end(b);
	end(a);
}

static void test_redis_hole_in_the_stream_is_seen(void **state)
{
	struct daemon *a;

	(void)state;
	need_redis();
	a = begin(redis.url);
	assert_int_equal(put(a, "s", "1"), ERR_OK);
	usleep(50000);
	assert_int_equal(atomic_load(&a->lost), 0);
	redis_cli(&redis, "xadd '{blobfield}:changes' '*' kind put id s etag "
	    "x token x prev 9-9", NULL, 0);
	assert_true(await_lost(a));
	/* Loaded, it is followed again. */
	assert_int_equal(load(a), ERR_OK);
	end(a);
}

/* Whether or not the follower has read of it before. */
static void test_redis_lost_data_is_seen(void **state)
{
	struct daemon *a, *b;

	(void)state;
	need_redis();
	a = begin(redis.url);
	assert_int_equal(put(a, "s", "1"), ERR_OK);
	redis_cli(&redis, "flushall", NULL, 0);
	assert_true(await_lost(a));
	assert_int_equal(load(a), ERR_OK);
	assert_int_equal(a->count, 0);
	b = begin(redis.url);
	assert_int_equal(put(b, "s", "2"), ERR_OK);
	assert_true(await_told(a, "s", "2"));
	end(b);
	end(a);
}

/* ... if the stream goes on from where the follower is, as far as another's entry
 * says, */
static void test_redis_lost_change_is_missed_by_the_next(void **state)
{
	struct daemon *a, *b;

	(void)state;
	need_redis();
	for (int i = 0; i < 10; i++) {
		redis_cli(&redis, "flushall", NULL, 0);
		a = begin(redis.url);
		b = begin(redis.url);
		assert_int_equal(put(a, "s", "1"), ERR_OK);
		redis_cli(&redis, "flushall", NULL, 0);
		assert_int_equal(put(b, "t", "2"), ERR_OK);
		assert_true(await_lost(a));
		end(b);
		end(a);
	}
}

/* ... and if the next is of the same daemon, which then knows at once. */
static void test_redis_lost_change_is_missed_by_ones_own(void **state)
{
	struct daemon *a;
	int lost;

	(void)state;
	need_redis();
	a = begin(redis.url);
	assert_int_equal(put(a, "s", "1"), ERR_OK);
	redis_cli(&redis, "flushall", NULL, 0);
	assert_int_equal(put(a, "t", "2"), ERR_OK);
	assert_true(await_lost(a));
	assert_int_equal(load(a), ERR_OK);
	assert_int_equal(a->count, 1);
	assert_int_equal(put(a, "t", "3"), ERR_OK);
	/* It is followed again, and nothing is missed any more. */
	lost = atomic_load(&a->lost);
	usleep(50000);
	assert_int_equal(atomic_load(&a->lost), lost);
	end(a);
}

/* ---- away ---- */

static void test_redis_killed_and_back(void **state)
{
	struct daemon *a, *b;
	double begun;

	(void)state;
	need_redis();
	a = begin(redis.url);
	b = begin(redis.url);
	assert_int_equal(put(a, "s", "1"), ERR_OK);
	redis_signal(&redis, SIGKILL);
	begun = clock_seconds();
	assert_int_equal(put(a, "s", "2"), ERR_UNAVAILABLE);
	assert_true(load_is_soon(clock_seconds() - begun, 0.4));
	assert_false(a->backing->ops->is_well(a->backing));
	assert_true(await_well(b, false));
	redis_start_again(&redis);
	assert_true(await_well(a, true));
	assert_true(await_well(b, true));
	assert_int_equal(change(a, "s", "3", "\"1\"", false, NULL), ERR_OK);
	assert_true(await_told(b, "s", "3"));
	assert_int_equal(atomic_load(&a->lost) + atomic_load(&b->lost), 0);
	end(b);
	end(a);
}

/* What was sent to a Redis that stood still is not made when it goes on. */
static void test_redis_stopped_makes_nothing_later(void **state)
{
	struct daemon *a;
	double begun;

	(void)state;
	need_redis();
	a = begin(redis.url);
	assert_int_equal(put(a, "s", "1"), ERR_OK);
	redis_signal(&redis, SIGSTOP);
	begun = clock_seconds();
	assert_int_equal(put(a, "s", "2"), ERR_UNAVAILABLE);
	assert_true(load_is_soon(clock_seconds() - begun, 2.5));
	begun = clock_seconds();
	assert_int_equal(put(a, "s", "3"), ERR_UNAVAILABLE);
	assert_true(load_is_soon(clock_seconds() - begun, 0.1));
	redis_signal(&redis, SIGCONT);
	assert_true(await_well(a, true));
	assert_int_equal(change(a, "s", "4", "\"1\"", false, NULL), ERR_OK);
	end(a);
}

static void test_redis_without_memory_refuses(void **state)
{
	struct daemon *a;

	(void)state;
	need_redis();
	a = begin(redis.url);
	assert_int_equal(put(a, "s", "1"), ERR_OK);
	redis_cli(&redis, "config set maxmemory 1", NULL, 0);
	assert_int_equal(put(a, "s", "2"), ERR_UNAVAILABLE);
	assert_false(a->backing->ops->is_well(a->backing));
	redis_cli(&redis, "config set maxmemory 0", NULL, 0);
	assert_true(await_well(a, true));
	assert_int_equal(change(a, "s", "3", "\"1\"", false, NULL), ERR_OK);
	end(a);
}

static void test_redis_password(void **state)
{
	char url[PATH_MAX + 64];
	struct daemon *a;

	(void)state;
	need_redis();
	redis_cli(&redis, "acl setuser me on '>secret:1' '~*' '+@all'", NULL,
	    0);
	snprintf(url, sizeof url, "redis+unix://me:wrong@%s", redis.path);
	a = begin_at(url);
	assert_int_equal(load(a), ERR_UNAVAILABLE);
	end(a);
	snprintf(url, sizeof url, "redis+unix://me:secret%%3a1@%s"
	    "?database=2&prefix=p", redis.path);
	a = begin(url);
	assert_int_equal(put(a, "s", "1"), ERR_OK);
	assert_int_equal(redis_cli(&redis, "-n 2 exists '{p}:scene:s' | grep "
	    "-q 1", NULL, 0), 0);
	end(a);
}

static void test_redis_that_comes_late_is_asked_to_be_loaded(void **state)
{
	struct daemon *a;

	(void)state;
	need_redis();
	redis_signal(&redis, SIGKILL);
	a = begin_at(redis.url);
	assert_int_equal(load(a), ERR_UNAVAILABLE);
	assert_int_equal(put(a, "s", "1"), ERR_UNAVAILABLE);
	redis_start_again(&redis);
	assert_true(await_lost(a));
	assert_int_equal(load(a), ERR_OK);
	assert_int_equal(put(a, "s", "1"), ERR_OK);
	end(a);
}

/* ---- a man in the middle ---- */

enum middle_mode {
	MIDDLE_PASS,
	MIDDLE_OLD_CLOCK,    /* Redis tells a time of an hour ago */
	MIDDLE_LOSE_REQUEST, /* of a change, and the connection with it */
	MIDDLE_LATE_REQUEST, /* ... and then delivers it */
	MIDDLE_LOSE_ANSWER,
	MIDDLE_LOSE_ALL,     /* the answer, and then nothing connects */
	MIDDLE_HOLD_READS,   /* of older revisions: nothing is answered */
	MIDDLE_DRIP_READS    /* ... but a byte now and then, without an end */
};

struct middle {
	int listener;
	char path[PATH_MAX + 32], url[PATH_MAX + 64];
	atomic_int mode;
	atomic_bool is_ending;
	atomic_int held;         /* reads */
	pthread_t thread;
};

struct middle_pair {
	struct middle *m;
	int client, server;
};

static int connect_to(const char *path)
{
	struct sockaddr_un address = {.sun_family = AF_UNIX};
	int fd = socket(AF_UNIX, SOCK_STREAM, 0);

	assert_true(strlen(path) < sizeof address.sun_path);
	strcpy(address.sun_path, path);
	if (connect(fd, (struct sockaddr *)&address, sizeof address) == 0)
		return fd;
	close(fd);
	return -1;
}

/* Whether it is a change of the scene s. */
static bool is_change(const char *data, size_t length)
{
	return memmem(data, length, "\r\nput\r\n", 7) != NULL;
}

/* Whether it is for an older revision: the one script of two keys. */
static bool is_read(const char *data, size_t length)
{
	return memmem(data, length, "\r\nEVALSHA\r\n", 11) != NULL &&
	    memmem(data, length, "\r\n$1\r\n2\r\n", 9) != NULL;
}

/* Of an answer to TIME, seconds and microseconds. */
static void set_back(char *data, size_t length)
{
	static const char head[] = "*2\r\n$10\r\n";
	char *at = memmem(data, length, head, sizeof head - 1);
	char number[11] = "", text[32];

	if (at == NULL)
		return;
	at += sizeof head - 1;
	memcpy(number, at, 10);
	snprintf(text, sizeof text, "%ld", atol(number) - 3600);
	memcpy(at, text, 10);
}

static void *pass(void *ctx)
{
	struct middle_pair pair = *(struct middle_pair *)ctx;
	struct pollfd fds[2] = {{pair.client, POLLIN, 0},
	    {pair.server, POLLIN, 0}};
	static const char endless[] = "*4\r\n$1000000\r\n";
	bool is_lossy = false, is_dripping = false;
	char data[65536];
	ssize_t n;

	free(ctx);
	while (poll(fds, 2, 20) >= 0 && !atomic_load(&pair.m->is_ending)) {
		int mode = atomic_load(&pair.m->mode);

		if (is_dripping && fds[0].revents == 0)
			send(pair.client, "x", 1, MSG_NOSIGNAL);
		if (fds[0].revents != 0) {
			n = recv(pair.client, data, sizeof data, 0);
			if (n <= 0)
				break;
			if (mode >= MIDDLE_HOLD_READS &&
			    is_read(data, (size_t)n)) {
				atomic_fetch_add(&pair.m->held, 1);
				is_dripping = mode == MIDDLE_DRIP_READS &&
				    send(pair.client, endless, sizeof endless -
				    1, MSG_NOSIGNAL) > 0;
				continue;
			}
			is_lossy = mode > MIDDLE_OLD_CLOCK &&
			    mode < MIDDLE_HOLD_READS &&
			    is_change(data, (size_t)n);
			if (is_lossy && mode == MIDDLE_LOSE_REQUEST)
				break;
			if (is_lossy && mode == MIDDLE_LATE_REQUEST) {
				shutdown(pair.client, SHUT_RDWR);
				atomic_store(&pair.m->mode, MIDDLE_PASS);
				usleep(200000);
			}
			send(pair.server, data, (size_t)n, MSG_NOSIGNAL);
		}
		if (fds[1].revents != 0) {
			n = recv(pair.server, data, sizeof data, 0);
			if (n <= 0 || is_lossy)
				break;
			if (mode == MIDDLE_OLD_CLOCK)
				set_back(data, (size_t)n);
			send(pair.client, data, (size_t)n, MSG_NOSIGNAL);
		}
	}
	if (is_lossy && atomic_load(&pair.m->mode) != MIDDLE_LOSE_ALL)
		atomic_store(&pair.m->mode, MIDDLE_PASS);
	close(pair.client);
	close(pair.server);
	return NULL;
}

static void *accept_all(void *ctx)
{
	struct middle *m = ctx;
	struct pollfd fd = {m->listener, POLLIN, 0};

	while (!atomic_load(&m->is_ending)) {
		struct middle_pair *pair;
		pthread_t thread;

		if (poll(&fd, 1, 20) <= 0)
			continue;
		pair = malloc(sizeof *pair);
		*pair = (struct middle_pair){m, accept(m->listener, NULL,
		    NULL), -1};
		if (atomic_load(&m->mode) != MIDDLE_LOSE_ALL)
			pair->server = connect_to(redis.path);
		if (pair->server < 0) {
			close(pair->client);
			free(pair);
			continue;
		}
		pthread_create(&thread, NULL, pass, pair);
		pthread_detach(thread);
	}
	return NULL;
}

static void start_middle(struct middle *m)
{
	struct sockaddr_un address = {.sun_family = AF_UNIX};

	snprintf(m->path, sizeof m->path, "%s/middle", redis.folder);
	snprintf(m->url, sizeof m->url, "redis+unix://%s", m->path);
	unlink(m->path);
	assert_true(strlen(m->path) < sizeof address.sun_path);
	strcpy(address.sun_path, m->path);
	m->listener = socket(AF_UNIX, SOCK_STREAM, 0);
	assert_int_equal(bind(m->listener, (struct sockaddr *)&address,
	    sizeof address), 0);
	assert_int_equal(listen(m->listener, 8), 0);
	atomic_store(&m->mode, MIDDLE_PASS);
	atomic_store(&m->held, 0);
	atomic_store(&m->is_ending, false);
	assert_int_equal(pthread_create(&m->thread, NULL, accept_all, m), 0);
}

static void stop_middle(struct middle *m)
{
	atomic_store(&m->is_ending, true);
	pthread_join(m->thread, NULL);
	close(m->listener);
	usleep(50000); /* for those that pass */
}

/* The connection ends after the change was made: it is known to be made. */
static void test_redis_lost_answer_is_looked_up(void **state)
{
	static struct middle m;
	struct scene_seq seq = {0, 0};
	struct daemon *a, *b;

	(void)state;
	need_redis();
	start_middle(&m);
	a = begin(m.url);
	assert_int_equal(put(a, "s", "1"), ERR_OK);
	atomic_store(&m.mode, MIDDLE_LOSE_ANSWER);
	assert_int_equal(change(a, "s", "2", "\"1\"", false, &seq), ERR_OK);
	b = begin(redis.url);
	assert_string_equal(b->list[b->count - 1].text, "2");
	assert_int_equal(scene_seq_compare(b->list[b->count - 1].seq, seq), 0);
	end(b);
	end(a);
	stop_middle(&m);
}

struct old_read {
	struct daemon *d;
	pthread_t thread;
	atomic_int made, made_before; /* changes, and when it had ended */
	atomic_bool is_over;
	enum err err;
};

static void *read_first(void *ctx)
{
	struct old_read *r = ctx;
	struct backing_reader reader = reader_of(r->d);

	r->err = r->d->backing->ops->read(r->d->backing, "s", "\"first\"",
	    &reader);
	atomic_store(&r->made_before, atomic_load(&r->made));
	atomic_store(&r->is_over, true);
	return NULL;
}

static void test_redis_read_without_answer_delays_no_change(void **state)
{
	static struct middle m;
	struct old_read r = {.made = 0};
	struct daemon *a;

	(void)state;
	need_redis();
	start_middle(&m);
	a = begin(m.url);
	assert_int_equal(put(a, "s", "first"), ERR_OK);
	assert_int_equal(put(a, "s", "second"), ERR_OK);
	assert_true(has(a, "first"));
	atomic_store(&m.mode, MIDDLE_HOLD_READS);
	r.d = a;
	pthread_create(&r.thread, NULL, read_first, &r);
	for (int i = 0; i < 2000 && atomic_load(&m.held) == 0; i++)
		usleep(10000);
	assert_int_equal(atomic_load(&m.held), 1);
	for (int i = 0; i < 64; i++) {
		char text[16];

		snprintf(text, sizeof text, "text %d", i);
		assert_int_equal(put(a, "t", text), ERR_OK);
		atomic_fetch_add(&r.made, 1);
	}
	pthread_join(r.thread, NULL);
	print_message("measured: %d changes of 64 made while a read waited\n",
	    atomic_load(&r.made_before));
	/* 64 measured; on a machine that is busy at least one within the 2 s
	 * that the read waits */
	assert_true(atomic_load(&r.made_before) > 0);
	assert_int_equal(r.err, ERR_UNAVAILABLE);
	/* It says nothing of what the writer can do; and the next read does not
	 * wait as long, nor is it asked. */
	assert_true(a->backing->ops->is_well(a->backing));
	read_first(&r);
	assert_int_equal(r.err, ERR_UNAVAILABLE);
	assert_int_equal(atomic_load(&m.held), 1);
	atomic_store(&m.mode, MIDDLE_PASS);
	for (int i = 0; i < 500 && r.err == ERR_UNAVAILABLE; i++) {
		usleep(20000);
		read_first(&r);
	}
	assert_int_equal(r.err, ERR_OK);
	end(a);
	stop_middle(&m);
}

/* As the daemon does that stops. */
static void test_redis_read_without_an_end_is_stopped(void **state)
{
	static struct middle m;
	struct old_read r = {.made = 0};
	struct daemon *a;

	(void)state;
	need_redis();
	start_middle(&m);
	a = begin(m.url);
	assert_int_equal(put(a, "s", "first"), ERR_OK);
	assert_int_equal(put(a, "s", "second"), ERR_OK);
	assert_true(has(a, "first"));
	atomic_store(&m.mode, MIDDLE_DRIP_READS);
	r.d = a;
	pthread_create(&r.thread, NULL, read_first, &r);
	for (int i = 0; i < 2000 && atomic_load(&m.held) == 0; i++)
		usleep(10000);
	assert_int_equal(atomic_load(&m.held), 1);
	assert_false(atomic_load(&r.is_over));
	a->backing->ops->stop_reading(a->backing);
	for (int i = 0; i < 2000 && !atomic_load(&r.is_over); i++)
		usleep(10000);
	assert_true(atomic_load(&r.is_over));
	pthread_join(r.thread, NULL);
	assert_int_equal(r.err, ERR_UNAVAILABLE);
	atomic_store(&m.mode, MIDDLE_PASS);
	read_first(&r);
	assert_int_equal(r.err, ERR_UNAVAILABLE);
	assert_int_equal(put(a, "s", "third"), ERR_OK);
	end(a);
	stop_middle(&m);
}

/* ... and before: it is not made, then or later. */
static void test_redis_lost_request_is_not_made(void **state)
{
	static struct middle m;
	struct daemon *a;

	(void)state;
	need_redis();
	start_middle(&m);
	a = begin(m.url);
	assert_int_equal(put(a, "s", "1"), ERR_OK);
	atomic_store(&m.mode, MIDDLE_LOSE_REQUEST);
	assert_int_equal(put(a, "s", "2"), ERR_UNAVAILABLE);
	assert_true(await_well(a, true));
	assert_int_equal(change(a, "s", "3", "\"1\"", false, NULL), ERR_OK);
	end(a);
	stop_middle(&m);
}

/* ... and before, and it comes to Redis when it has been looked up. */
static void test_redis_late_request_is_not_made(void **state)
{
	static struct middle m;
	struct daemon *a;

	(void)state;
	need_redis();
	start_middle(&m);
	a = begin(m.url);
	assert_int_equal(put(a, "s", "1"), ERR_OK);
	atomic_store(&m.mode, MIDDLE_LATE_REQUEST);
	assert_int_equal(put(a, "s", "2"), ERR_UNAVAILABLE);
	usleep(400000);
	assert_true(await_well(a, true));
	assert_int_equal(change(a, "s", "3", "\"1\"", false, NULL), ERR_OK);
	end(a);
	stop_middle(&m);
}

/* ... after, and Redis is away from then on: it cannot be known, and the
 * follower tells when it is back. */
static void test_redis_change_in_doubt_is_told_later(void **state)
{
	static struct middle m;
	struct daemon *a;

	(void)state;
	need_redis();
	start_middle(&m);
	a = begin(m.url);
	assert_int_equal(put(a, "s", "1"), ERR_OK);
	atomic_store(&m.mode, MIDDLE_LOSE_ALL);
	assert_int_equal(put(a, "s", "2"), ERR_UNAVAILABLE);
	atomic_store(&m.mode, MIDDLE_PASS);
	assert_true(await_told(a, "s", "2"));
	assert_true(await_well(a, true));
	end(a);
	stop_middle(&m);
}

/* Redis' clock goes on by an hour while the connection holds. */
static void test_redis_clock_that_is_set_does_not_stop_changes(void **state)
{
	static const struct backing_volume v = {"0123", "abc", 3, false,
	    "me", NULL};
	static struct middle m;
	struct daemon *a;

	(void)state;
	need_redis();
	start_middle(&m);
	for (int i = 0; i < 2; i++) {
		atomic_store(&m.mode, MIDDLE_OLD_CLOCK);
		a = begin(m.url);
		atomic_store(&m.mode, MIDDLE_PASS);
		assert_int_equal(i == 0 ? put(a, "s", "1") :
		    a->backing->ops->put_volume(a->backing, &v), ERR_OK);
		assert_true(a->backing->ops->is_well(a->backing));
		end(a);
	}
	stop_middle(&m);
}

/* ---- two at once ---- */

#define RACE_CHANGES 200

static void *race(void *ctx)
{
	struct daemon *d = ctx;
	char expected[40] = "";
	intptr_t made = 0;

	/* Whoever has the present tag changes it; else refresh, try again. */
	while (made < RACE_CHANGES) {
		struct backing_reader reader = reader_of(d);
		char text[32];

		snprintf(text, sizeof text, "%p-%d", ctx, (int)made);
		if (change(d, "race", text, expected[0] != '\0' ? expected :
		    NULL, false, NULL) == ERR_OK) {
			made++;
			tag_of(text, expected);
			continue;
		}
		on_guard(d, true);
		pthread_mutex_lock(&d->lock);
		d->count = 0;
		pthread_mutex_unlock(&d->lock);
		d->backing->ops->refresh(d->backing, "race", &reader);
		expected[0] = '\0';
		for (size_t i = 0; i < d->count; i++)
			if (!d->list[i].is_past)
				strcpy(expected, d->list[i].etag);
		on_guard(d, false);
	}
	return (void *)made;
}

/* Chains of two daemons are one chain: as many entries as changes. */
static void test_redis_two_writers_lose_nothing(void **state)
{
	struct daemon *a, *b;
	char count[64] = "";
	pthread_t thread;

	(void)state;
	need_redis();
	a = begin(redis.url);
	b = begin(redis.url);
	pthread_create(&thread, NULL, race, a);
	race(b);
	pthread_join(thread, NULL);
	redis_cli(&redis, "xlen '{blobfield}:changes'", count, sizeof count);
	assert_int_equal(atoi(count), 2 * RACE_CHANGES);
	assert_int_equal(atomic_load(&a->lost) + atomic_load(&b->lost), 0);
	end(b);
	end(a);
}

int main(void)
{
	const struct CMUnitTest tests[] = {
		cmocka_unit_test(test_redis_url_forms),
		cmocka_unit_test(test_redis_url_of_tls),
		cmocka_unit_test(test_redis_url_refused),
#define TEST(name) cmocka_unit_test_setup(name, clean)
		TEST(test_redis_kept_is_loaded_elsewhere),
		TEST(test_redis_history_is_cut_and_read),
		TEST(test_redis_history_bytes_at_below_and_above_the_bound),
		TEST(test_redis_history_bytes_of_two_daemons),
		TEST(test_redis_deleted_is_gone_with_its_past),
		TEST(test_redis_expected_tag_decides),
		TEST(test_redis_batch_has_a_result_each),
		TEST(test_redis_large_batch),
		TEST(test_redis_bytes_are_kept_as_they_are),
		TEST(test_redis_forgotten_scripts_are_sent_again),
		TEST(test_redis_forgotten_scripts_do_not_stop_a_load),
		TEST(test_redis_owner_of_what_is_there_stays),
		TEST(test_redis_refresh_tells_what_is_there),
		TEST(test_redis_volumes),
		TEST(test_redis_volumes_have_owners),
		TEST(test_redis_volume_of_two_daemons_is_told),
		TEST(test_redis_follower_tells_of_others_only),
		TEST(test_redis_overtaken_revisions_are_told_for_the_history),
		TEST(test_redis_hole_in_the_stream_is_seen),
		TEST(test_redis_lost_data_is_seen),
		TEST(test_redis_lost_change_is_missed_by_the_next),
		TEST(test_redis_lost_change_is_missed_by_ones_own),
		TEST(test_redis_killed_and_back),
		TEST(test_redis_stopped_makes_nothing_later),
		TEST(test_redis_without_memory_refuses),
		TEST(test_redis_password),
		TEST(test_redis_that_comes_late_is_asked_to_be_loaded),
		TEST(test_redis_lost_answer_is_looked_up),
		TEST(test_redis_read_without_answer_delays_no_change),
		TEST(test_redis_lost_request_is_not_made),
		TEST(test_redis_read_without_an_end_is_stopped),
		TEST(test_redis_late_request_is_not_made),
		TEST(test_redis_clock_that_is_set_does_not_stop_changes),
		TEST(test_redis_change_in_doubt_is_told_later),
		TEST(test_redis_two_writers_lose_nothing),
#undef TEST
	};

	return cmocka_run_group_tests(tests, start_redis, stop_redis);
}
