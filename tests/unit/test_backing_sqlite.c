/*
 * Scenes in an SQLite file: what comes back after a restart, what is done about a
 * file that is damaged, missing, newer or in use, and that a write or an fsync
 * that fails, at any place, leaves what was acknowledged and nothing else.
 */
#include <stdarg.h>
#include <stddef.h>
#include <setjmp.h>
#include <stdint.h>
#include <cmocka.h>

#include <errno.h>
#include <fcntl.h>
#include <pthread.h>
#include <signal.h>
#include <stdatomic.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/stat.h>
#include <sys/syscall.h>
#include <sys/wait.h>
#include <time.h>
#include <unistd.h>

#include <sqlite3.h>

#include "server/backing.h"
#include "server/clock.h"
#include "server/etag.h"
#include "server/log.h"
#include "server/sqlite_file.h"
#include "tests/support/folder.h"
#include "tests/support/load.h"

#define HISTORY 3
#define SCENES 4

/* ---- system calls that fail: SQLite calls these ---- */

/* The call with that number, from 1, and so many behind it fail; 0: none. */
static struct {
	long from, count, calls;
	const char *replaced, *by; /* by its first failure; NULL: none */
} sync_failure, write_failure;

static bool fails(long from, long count, long *calls)
{
	++*calls;
	return from > 0 && *calls >= from && *calls < from + count;
}

int fdatasync(int fd)
{
	if (fails(sync_failure.from, sync_failure.count,
	    &sync_failure.calls)) {
		if (sync_failure.replaced != NULL)
			rename(sync_failure.by, sync_failure.replaced);
		errno = EIO;
		return -1;
	}
	return (int)syscall(SYS_fdatasync, fd);
}

int fsync(int fd)
{
	if (fails(sync_failure.from, sync_failure.count,
	    &sync_failure.calls)) {
		errno = EIO;
		return -1;
	}
	return (int)syscall(SYS_fsync, fd);
}

ssize_t pwrite64(int fd, const void *data, size_t size, off64_t offset)
{
	if (fails(write_failure.from, write_failure.count,
	    &write_failure.calls)) {
		errno = ENOSPC;
		return -1;
	}
	return syscall(SYS_pwrite64, fd, data, size, offset);
}

static void fail_nothing(void)
{
	memset(&sync_failure, 0, sizeof sync_failure);
	memset(&write_failure, 0, sizeof write_failure);
}

/* ---- a backing, and what it has ---- */

/* The present text of scene "0", "1"…; or "". */
struct found {
	char text[SCENES][32];
	char owner[SCENES][32];
	size_t revisions, volumes, forgotten;
	uint64_t seq;
	size_t volume_length;
	unsigned volume_sum;
	char volume_owner[32];
};

static enum err on_revision(void *ctx, const struct backing_revision *r)
{
	struct found *f = ctx;
	int i = atoi(r->id);

	f->revisions++;
	f->seq = r->seq.major > f->seq ? r->seq.major : f->seq;
	if (r->text[0] != '\0') {
		snprintf(f->text[i], 32, "%.*s", (int)r->length, r->text);
		snprintf(f->owner[i], 32, "%s", r->owner);
	}
	return ERR_OK;
}

static enum err on_volume(void *ctx, const struct backing_volume *v)
{
	struct found *f = ctx;
	const unsigned char *data = v->data;

	f->volumes++;
	f->forgotten += v->is_forgotten;
	f->volume_length = v->length;
	snprintf(f->volume_owner, sizeof f->volume_owner, "%s", v->owner);
	for (size_t i = 0; i < v->length; i++)
		f->volume_sum = 31 * f->volume_sum + data[i];
	return ERR_OK;
}

static void look(struct backing *b, struct found *out)
{
	const struct backing_reader reader = {on_revision, on_volume, out};

	memset(out, 0, sizeof *out);
	assert_int_equal(b->ops->load(b, &reader), ERR_OK);
}

static int lost_count;

static void on_lost(void *ctx)
{
	(void)ctx;
	lost_count++;
}

/* history_bytes 0: any */
static enum err open_with(const char *folder, size_t history,
    size_t history_bytes, struct backing **out)
{
	const struct backing_options options = {.history = history,
	    .history_bytes = history_bytes, .lost = on_lost};

	return backing_open_sqlite(folder, &options, out);
}

static enum err open_at(const char *folder, struct backing **out)
{
	return open_with(folder, HISTORY, 0, out);
}

static struct backing *must_open(const char *folder)
{
	struct backing *b;

	assert_int_equal(open_at(folder, &b), ERR_OK);
	return b;
}

/* text NULL: deletes. */
static enum err keep(struct backing *b, const char *id, const char *text,
    uint64_t *seq)
{
	char etag[ETAG_SIZE] = "";
	struct backing_write w = {.revision = {.id = id, .etag = etag,
	    .text = text, .length = text != NULL ? strlen(text) : 0,
	    .owner = "me", .nodes = 1}};
	enum err err;

	if (text != NULL)
		etag_of(text, strlen(text), etag);
	err = b->ops->commit(b, &w, 1);
	if (err == ERR_OK && seq != NULL)
		*seq = w.revision.seq.major;
	return err;
}

static void must_keep(struct backing *b, const char *id, const char *text)
{
	assert_int_equal(keep(b, id, text, NULL), ERR_OK);
}

static char *path_of(const char *folder, const char *name)
{
	static char path[PATH_MAX + 32];

	snprintf(path, sizeof path, "%s/%s", folder, name);
	return path;
}

static int setup(void **state)
{
	char *folder = malloc(PATH_MAX);

	assert_non_null(folder);
	log_set_level(LOG_ERROR);
	fail_nothing();
	lost_count = 0;
	folder_make(folder);
	strcat(folder, "/data");
	*state = folder;
	return 0;
}

static int teardown(void **state)
{
	char *folder = *state;

	fail_nothing();
	*strrchr(folder, '/') = '\0';
	folder_remove(folder);
	free(folder);
	return 0;
}

/* Nothing but what the error says is changed by being refused. */
static void assert_refused(const char *folder, enum err err)
{
	struct backing *b;

	/* What the log says is for people: seen by eye. */
	assert_int_equal(open_at(folder, &b), err);
}

/* ---- what is kept ---- */

static void test_restart_finds_what_was_kept(void **state)
{
	struct backing *b = must_open(*state);
	struct found f;
	uint64_t seq;

	must_keep(b, "0", "one");
	must_keep(b, "0", "two");
	must_keep(b, "1", "three");
	b->ops->free(b);
	b = must_open(*state);
	look(b, &f);
	assert_string_equal(f.text[0], "two");
	assert_string_equal(f.text[1], "three");
	assert_string_equal(f.owner[1], "me");
	assert_int_equal(f.revisions, 3);
	assert_int_equal(keep(b, "2", "four", &seq), ERR_OK);
	assert_int_equal(seq, 4);
	b->ops->free(b);
}

static void test_group_is_one_transaction(void **state)
{
	struct backing *b = must_open(*state);
	char tags[2][ETAG_SIZE];
	struct backing_write w[3] = {
		{.revision = {.id = "0", .etag = tags[0], .text = "a",
		    .length = 1, .owner = ""}},
		{.revision = {.id = "0", .etag = "", .owner = ""}},
		{.revision = {.id = "1", .etag = tags[1], .text = "b",
		    .length = 1, .owner = ""}},
	};
	struct found f;
	long calls;

	etag_of("a", 1, tags[0]);
	etag_of("b", 1, tags[1]);
	must_keep(b, "3", "first");
	calls = sync_failure.calls;
	assert_int_equal(b->ops->commit(b, w, 3), ERR_OK);
	assert_int_equal(sync_failure.calls - calls, 1);
	look(b, &f);
	assert_string_equal(f.text[0], "");
	assert_string_equal(f.text[1], "b");
	assert_int_equal(w[2].revision.seq.major,
	    w[0].revision.seq.major + 2);
	b->ops->free(b);
}

static void test_seq_never_goes_back(void **state)
{
	struct backing *b = must_open(*state);
	uint64_t seq;

	must_keep(b, "0", "one");
	must_keep(b, "0", NULL);
	b->ops->free(b);
	b = must_open(*state);
	assert_int_equal(keep(b, "0", "two", &seq), ERR_OK);
	assert_int_equal(seq, 3);
	b->ops->free(b);
}

static enum err take_text(void *ctx, const struct backing_revision *r)
{
	memcpy(ctx, r->text, r->length);
	((char *)ctx)[r->length] = '\0';
	return ERR_OK;
}

static void test_history_is_trimmed_and_read(void **state)
{
	struct backing *b = must_open(*state);
	char text[32], etag[ETAG_SIZE];
	const struct backing_reader reader = {take_text, NULL, text};
	struct found f;

	for (int i = 0; i < 6; i++) {
		snprintf(text, sizeof text, "text %d", i);
		must_keep(b, "0", text);
	}
	look(b, &f);
	assert_int_equal(f.revisions, HISTORY);
	assert_string_equal(f.text[0], "text 5");
	etag_of("text 3", 6, etag);
	assert_int_equal(b->ops->read(b, "0", etag, &reader), ERR_OK);
	assert_string_equal(text, "text 3");
	etag_of("text 2", 6, etag);
	assert_int_equal(b->ops->read(b, "0", etag, &reader), ERR_NOT_FOUND);
	must_keep(b, "0", NULL);
	etag_of("text 3", 6, etag);
	assert_int_equal(b->ops->read(b, "0", etag, &reader), ERR_NOT_FOUND);
	b->ops->free(b);
}

/* ---- what the past may take ---- */

static enum err ignore(void *ctx, const struct backing_revision *r)
{
	(void)ctx, (void)r;
	return ERR_OK;
}

/* Texts that can be told from one another, of that length. */
static const char *text_of(int number, size_t length)
{
	static char text[64];

	assert_true(length < sizeof text);
	memset(text, 'a' + number % 26, length);
	text[length] = '\0';
	return text;
}

/* Whether the revision of that text is there. */
static bool has(struct backing *b, const char *id, const char *text)
{
	const struct backing_reader reader = {ignore, NULL, NULL};
	char etag[ETAG_SIZE];
	enum err err;

	etag_of(text, strlen(text), etag);
	err = b->ops->read(b, id, etag, &reader);
	if (err != ERR_OK && err != ERR_NOT_FOUND)
		fail_msg("reading: %s", err_message(err));
	return err == ERR_OK;
}

/* Of id's texts of the lengths in list, as numbered from 0, the first `gone` are
 * not there, the others are. */
static void assert_kept(struct backing *b, const char *id,
    const size_t *lengths, int count, int gone)
{
	for (int i = 0; i < count; i++)
		assert_int_equal(has(b, id, text_of(i, lengths[i])),
		    i >= gone);
}

static void test_history_bytes_at_below_and_above_the_bound(void **state)
{
	static const size_t lengths[] = {4, 5, 1, 2, 20, 3};
	/* of past ones at most 9: how many are gone after each */
	static const int gone[] = {0, 0, 0 /* 9 */, 1 /* 8; 10, one more */,
	    1 /* 8 */, 5 /* 20: alone beyond it */};
	const char *places[] = {*state, ":memory:"};

	for (int k = 0; k < 2; k++) {
		struct backing *b;

		assert_int_equal(open_with(places[k], 100, 9, &b), ERR_OK);
		for (int i = 0; i < 6; i++) {
			must_keep(b, "0", text_of(i, lengths[i]));
			must_keep(b, "1", text_of(i, 1)); /* its own 9 */
			assert_kept(b, "0", lengths, i + 1, gone[i]);
			assert_true(has(b, "1", "a"));
		}
		b->ops->free(b);
	}
}

static void test_history_bytes_lowered_hold_after_load(void **state)
{
	static const size_t lengths[] = {4, 5, 1, 2, 3};
	struct backing *b;
	struct found f;

	assert_int_equal(open_with(*state, 100, 0, &b), ERR_OK);
	for (int i = 0; i < 5; i++)
		must_keep(b, "0", text_of(i, lengths[i]));
	must_keep(b, "1", "other");
	assert_kept(b, "0", lengths, 5, 0);
	b->ops->free(b);
	assert_int_equal(open_with(*state, 100, 8, &b), ERR_OK);
	look(b, &f);
	assert_string_equal(f.text[0], "eee");
	assert_kept(b, "0", lengths, 5, 1);
	b->ops->free(b);
	/* and so does a lowered number; the sum is still right */
	assert_int_equal(open_with(*state, 3, 8, &b), ERR_OK);
	look(b, &f);
	assert_kept(b, "0", lengths, 5, 2);
	must_keep(b, "0", text_of(5, 6));
	assert_kept(b, "0", lengths, 5, 3);
	b->ops->free(b);
	assert_int_equal(open_with(*state, 3, 1, &b), ERR_OK);
	/* without a load: at the next change */
	must_keep(b, "0", "last");
	assert_kept(b, "0", lengths, 5, 5);
	assert_false(has(b, "0", text_of(5, 6)));
	assert_true(has(b, "1", "other"));
	b->ops->free(b);
}

/* What the model of test_history_bytes_as_a_model_has_them knows of a scene. */
struct model {
	size_t lengths[2000];
	int first, count; /* those kept: from first to count */
};

static void model_put(struct model *m, size_t length, int history,
    size_t most)
{
	size_t bytes = 0;

	for (int i = m->first; i < m->count; i++)
		bytes += m->lengths[i];
	m->lengths[m->count++] = length;
	while (m->count - m->first > history || (bytes > most &&
	    m->count - m->first > 1))
		bytes -= m->lengths[m->first++];
}

/* Texts are their numbers, filled up. */
static const char *numbered(int number, size_t length, char out[static 64])
{
	snprintf(out, 64, "%0*d", (int)length, number);
	return out;
}

static void model_check(struct backing *b, const struct model models[SCENES])
{
	for (int s = 0; s < SCENES; s++)
		for (int i = 0; i < models[s].count; i++) {
			const struct model *m = models + s;
			char id[2] = {(char)('0' + s)}, text[64];

			numbered(i, m->lengths[i], text);
			assert_int_equal(has(b, id, text), i >= m->first);
		}
}

static void test_history_bytes_as_a_model_has_them(void **state)
{
	static struct model models[SCENES];
	size_t most = 100;
	int history = 6;
	struct backing *b;
	struct found f;

	memset(models, 0, sizeof models);
	srand(7);
	assert_int_equal(open_with(*state, (size_t)history, most, &b), ERR_OK);
	for (int i = 0; i < 300; i++) {
		char texts[8][64], tags[8][ETAG_SIZE], ids[8][2];
		struct backing_write w[8];
		int count = 1 + rand() % 8;

		for (int j = 0; j < count; j++) {
			int s = rand() % SCENES;
			size_t length = 4 + (size_t)(rand() % 50);

			memcpy(ids[j], (char[2]){(char)('0' + s)}, 2);
			numbered(models[s].count, length, texts[j]);
			etag_of(texts[j], length, tags[j]);
			w[j] = (struct backing_write){.revision = {
			    .id = ids[j], .etag = tags[j], .text = texts[j],
			    .length = length, .owner = ""}};
			model_put(models + s, length, history, most);
		}
		assert_int_equal(b->ops->commit(b, w, (size_t)count), ERR_OK);
		if (i % 60 == 59) {
			model_check(b, models);
			b->ops->free(b);
			assert_int_equal(open_with(*state, (size_t)history,
			    most, &b), ERR_OK);
			look(b, &f);
		}
	}
	model_check(b, models);
	b->ops->free(b);
}

/* ---- reading beside the writer ---- */

/* A read that is told its text, and waits. */
struct slow_read {
	struct backing *b;
	char etag[ETAG_SIZE], text[32];
	pthread_t thread;
	pthread_mutex_t lock;    /* guards: */
	pthread_cond_t wake;
	bool is_told, is_let_go, is_tired;
	enum err err;
};

static enum err wait_with_text(void *ctx, const struct backing_revision *r)
{
	struct slow_read *s = ctx;
	struct timespec until;

	clock_gettime(CLOCK_REALTIME, &until);
	until.tv_sec += 20;
	snprintf(s->text, sizeof s->text, "%.*s", (int)r->length, r->text);
	pthread_mutex_lock(&s->lock);
	s->is_told = true;
	pthread_cond_broadcast(&s->wake);
	while (!s->is_let_go && !s->is_tired)
		s->is_tired = pthread_cond_timedwait(&s->wake, &s->lock,
		    &until) == ETIMEDOUT;
	pthread_mutex_unlock(&s->lock);
	return ERR_OK;
}

static void *read_slowly(void *ctx)
{
	struct slow_read *s = ctx;
	const struct backing_reader reader = {wait_with_text, NULL, s};

	s->err = s->b->ops->read(s->b, "0", s->etag, &reader);
	return NULL;
}

static void begin_slow_read(struct slow_read *s, struct backing *b,
    const char *text)
{
	*s = (struct slow_read){.b = b, .lock = PTHREAD_MUTEX_INITIALIZER,
	    .wake = PTHREAD_COND_INITIALIZER};
	etag_of(text, strlen(text), s->etag);
	pthread_create(&s->thread, NULL, read_slowly, s);
	pthread_mutex_lock(&s->lock);
	while (!s->is_told)
		pthread_cond_wait(&s->wake, &s->lock);
	pthread_mutex_unlock(&s->lock);
}

static void end_slow_read(struct slow_read *s)
{
	pthread_mutex_lock(&s->lock);
	s->is_let_go = true;
	pthread_cond_broadcast(&s->wake);
	pthread_mutex_unlock(&s->lock);
	pthread_join(s->thread, NULL);
	assert_false(s->is_tired); /* else what it was to delay, waited */
	assert_int_equal(s->err, ERR_OK);
}

static void test_read_that_waits_delays_no_change(void **state)
{
	const char *places[] = {*state, ":memory:"};
	static char data[(1 << 20) + 1];
	const struct backing_volume v = {"id", data, sizeof data, false,
		"me", NULL};

	for (int k = 0; k < 2; k++) {
		struct backing *b = must_open(places[k]);
		struct slow_read s;
		struct found f;
		char text[32];

		must_keep(b, "0", "first");
		must_keep(b, "0", "second");
		begin_slow_read(&s, b, "first");
		for (int i = 0; i < 64; i++) {
			snprintf(text, sizeof text, "text %d", i);
			must_keep(b, i % 2 == 0 ? "0" : "1", text);
		}
		assert_int_equal(b->ops->put_volume(b, &v), ERR_OK);
		look(b, &f);
		assert_string_equal(f.text[1], "text 63");
		end_slow_read(&s);
		assert_string_equal(s.text, "first");
		assert_false(has(b, "0", "first")); /* cut meanwhile */
		b->ops->free(b);
	}
}

/* Reads one text again and again. */
struct reading {
	struct backing *b;
	char etag[ETAG_SIZE];
	atomic_bool is_over;
	atomic_int reads, wrong;
};

static enum err compare_text(void *ctx, const struct backing_revision *r)
{
	struct reading *reading = ctx;

	if (r->length != 5 || memcmp(r->text, "first", 5) != 0)
		atomic_fetch_add(&reading->wrong, 1);
	return ERR_OK;
}

static void *read_on(void *ctx)
{
	struct reading *reading = ctx;
	const struct backing_reader reader = {compare_text, NULL, reading};

	while (!atomic_load(&reading->is_over)) {
		enum err err = reading->b->ops->read(reading->b, "3",
		    reading->etag, &reader);

		atomic_fetch_add(&reading->reads, err == ERR_OK);
		if (err != ERR_OK && err != ERR_UNAVAILABLE)
			atomic_fetch_add(&reading->wrong, 1);
	}
	return NULL;
}

static pthread_t begin_reading(struct reading *reading, struct backing *b)
{
	pthread_t thread;

	*reading = (struct reading){.b = b};
	etag_of("first", 5, reading->etag);
	must_keep(b, "3", "first");
	must_keep(b, "3", "second");
	pthread_create(&thread, NULL, read_on, reading);
	return thread;
}

static void end_reading(struct reading *reading, pthread_t thread)
{
	for (int i = 0; i < 2000 && reading->reads == 0; i++)
		usleep(10000);
	atomic_store(&reading->is_over, true);
	pthread_join(thread, NULL);
	assert_true(reading->reads > 0);
	assert_int_equal(reading->wrong, 0);
}

static void test_reads_while_the_file_is_opened_anew(void **state)
{
	struct backing *b = must_open(*state);
	struct reading reading;
	pthread_t thread;
	int log = dup(STDERR_FILENO), nowhere = open("/dev/null", O_WRONLY);
	int refused = 0;

	thread = begin_reading(&reading, b);
	dup2(nowhere, STDERR_FILENO);
	close(nowhere);
	for (int i = 0; i < 40; i++) {
		sync_failure.calls = 0;
		sync_failure.from = 1;
		sync_failure.count = 1 + i % 3;
		refused += keep(b, "0", i % 2 == 0 ? "x" : "y", NULL) !=
		    ERR_OK;
		sync_failure.from = 0;
		/* as the store does */
		for (int j = 0; j < 3 && !b->ops->is_well(b); j++)
			b->ops->commit(b, NULL, 0);
	}
	dup2(log, STDERR_FILENO);
	close(log);
	end_reading(&reading, thread);
	print_message("measured: %d reads, %d changes refused of 40\n",
	    reading.reads, refused);
	assert_true(refused > 0);
	assert_true(has(b, "3", "first"));
	b->ops->free(b);
}

/* The log is cut by who closes the file last. */
static void test_reader_leaves_no_log_behind(void **state)
{
	struct backing *b = must_open(*state);
	struct stat info;

	must_keep(b, "0", "one");
	must_keep(b, "0", "two");
	assert_true(has(b, "0", "one"));
	b->ops->free(b);
	assert_int_equal(stat(path_of(*state, "scenes.sqlite-wal"), &info),
	    -1);
}

static void test_volume_of_several_pieces(void **state)
{
	struct backing *b = must_open(*state);
	size_t length = ((size_t)5 << 19) + 17;
	unsigned char *data = malloc(length);
	struct backing_volume v = {"id", data, length, false, "me", NULL};
	unsigned sum = 0;
	struct found f;

	for (size_t i = 0; i < length; i++) {
		data[i] = (unsigned char)(i * 7 + i / 1000);
		sum = 31 * sum + data[i];
	}
	assert_int_equal(b->ops->put_volume(b, &v), ERR_OK);
	assert_int_equal(b->ops->put_volume(b, &v), ERR_OK);
	b->ops->free(b);
	b = must_open(*state);
	look(b, &f);
	assert_int_equal(f.volumes, 1);
	assert_int_equal(f.volume_length, length);
	assert_int_equal(f.volume_sum, sum);
	assert_int_equal(b->ops->forget_volume(b, "id", false), ERR_OK);
	look(b, &f);
	assert_int_equal(f.forgotten, 1);
	assert_int_equal(b->ops->forget_volume(b, "id", true), ERR_OK);
	look(b, &f);
	assert_int_equal(f.volumes, 0);
	b->ops->free(b);
	free(data);
}

static void test_volumes_have_owners(void **state)
{
	char kept[TOKEN_NAME_MAX + 1] = "";
	struct backing_volume v = {"id", "data", 4, false, "me", kept};
	struct backing *b = must_open(*state);
	struct found f;

	assert_int_equal(b->ops->put_volume(b, &v), ERR_OK);
	assert_string_equal(kept, "me");
	/* It is there: it stays whose it is. */
	v.owner = "you";
	assert_int_equal(b->ops->put_volume(b, &v), ERR_OK);
	assert_string_equal(kept, "me");
	b->ops->free(b);
	b = must_open(*state);
	look(b, &f);
	assert_string_equal(f.volume_owner, "me");
	/* Forgotten, it is still whose it was, until somebody else has it. */
	assert_int_equal(b->ops->forget_volume(b, "id", false), ERR_OK);
	look(b, &f);
	assert_string_equal(f.volume_owner, "me");
	assert_int_equal(b->ops->put_volume(b, &v), ERR_OK);
	assert_string_equal(kept, "you");
	b->ops->free(b);
	b = must_open(*state);
	look(b, &f);
	assert_int_equal(f.forgotten, 0);
	assert_string_equal(f.volume_owner, "you");
	b->ops->free(b);
}

static void test_memory_keeps_nothing(void **state)
{
	struct backing *b = must_open(":memory:");
	struct found f;

	(void)state;
	must_keep(b, "0", "one");
	look(b, &f);
	assert_string_equal(f.text[0], "one");
	b->ops->free(b);
	b = must_open(":memory:");
	look(b, &f);
	assert_int_equal(f.revisions, 0);
	b->ops->free(b);
}

static void test_files_are_for_their_owner_alone(void **state)
{
	struct backing *b = must_open(*state);
	struct stat info;

	must_keep(b, "0", "one");
	assert_int_equal(stat(*state, &info), 0);
	assert_int_equal(info.st_mode & 0777, 0700);
	assert_int_equal(stat(path_of(*state, "scenes.sqlite"), &info), 0);
	assert_int_equal(info.st_mode & 0777, 0600);
	assert_int_equal(stat(path_of(*state, "scenes.sqlite-wal"), &info),
	    0);
	assert_int_equal(info.st_mode & 0777, 0600);
	b->ops->free(b);
}

static void test_log_is_cut(void **state)
{
	struct backing *b = must_open(*state);
	char *text = malloc(100001);
	struct stat info;

	memset(text, 'x', 100000);
	text[100000] = '\0';
	for (int i = 0; i < 300; i++) {
		text[i] = 'y';
		must_keep(b, "0", text);
	}
	assert_int_equal(stat(path_of(*state, "scenes.sqlite-wal"), &info),
	    0);
	print_message("measured: 30 MB written, the log has %ld bytes\n",
	    (long)info.st_size);
	/* 1000 pages of 4 KiB, and what one transaction adds: 4.5 MB */
	assert_true(info.st_size < 6000000);
	b->ops->free(b);
	free(text);
}

/* ---- other files ---- */

static void run_sql(const char *path, const char *sql)
{
	sqlite3 *db;

	assert_int_equal(sqlite3_open(path, &db), SQLITE_OK);
	assert_int_equal(sqlite3_exec(db, sql, NULL, NULL, NULL), SQLITE_OK);
	sqlite3_close(db);
}

static void test_file_of_version_1_is_brought_up(void **state)
{
	struct backing *b;
	struct backing_volume v = {"id", "data", 4, false, "", NULL};
	struct found f;
	char sql[1200], etag[ETAG_SIZE];
	uint64_t seq;

	assert_int_equal(mkdir(*state, 0700), 0);
	etag_of("one", 3, etag);
	snprintf(sql, sizeof sql, "PRAGMA application_id=1651270246;"
	    "CREATE TABLE scene (id TEXT PRIMARY KEY NOT NULL,"
	    " owner TEXT NOT NULL) WITHOUT ROWID;"
	    "CREATE TABLE revision (seq INTEGER PRIMARY KEY AUTOINCREMENT,"
	    " scene TEXT NOT NULL REFERENCES scene (id) ON DELETE CASCADE,"
	    " etag TEXT NOT NULL, time REAL NOT NULL, nodes INTEGER NOT NULL,"
	    " text BLOB NOT NULL);"
	    "CREATE INDEX revision_of_scene ON revision (scene, seq);"
	    "INSERT INTO scene VALUES ('1', 'you');"
	    "INSERT INTO revision VALUES (41, '1', '%s', 1e9, 3, "
	    "CAST('one' AS BLOB)); PRAGMA user_version=1", etag);
	run_sql(path_of(*state, "scenes.sqlite"), sql);
	b = must_open(*state);
	look(b, &f);
	assert_string_equal(f.text[1], "one");
	assert_string_equal(f.owner[1], "you");
	assert_int_equal(b->ops->put_volume(b, &v), ERR_OK);
	assert_int_equal(keep(b, "1", "two", &seq), ERR_OK);
	assert_int_equal(seq, 42);
	b->ops->free(b);
	/* of one and two, as it was brought up */
	assert_int_equal(open_with(*state, 100, 6, &b), ERR_OK);
	must_keep(b, "1", "three");
	assert_true(has(b, "1", "one"));
	must_keep(b, "1", "four");
	assert_false(has(b, "1", "two"));
	b->ops->free(b);
}

/* Volumes of then have no owner. */
static void test_file_of_version_2_is_brought_up(void **state)
{
	struct backing *b = must_open(*state);
	struct backing_volume v = {"id", "data", 4, false, "me", NULL};
	struct found f;

	assert_int_equal(b->ops->put_volume(b, &v), ERR_OK);
	b->ops->free(b);
	run_sql(path_of(*state, "scenes.sqlite"),
	    "ALTER TABLE volume DROP COLUMN owner; "
	    "ALTER TABLE scene DROP COLUMN bytes; PRAGMA user_version=2");
	b = must_open(*state);
	look(b, &f);
	assert_int_equal(f.volumes, 1);
	assert_int_equal(f.volume_length, 4);
	assert_string_equal(f.volume_owner, "");
	b->ops->free(b);
}

static void keep_one(const char *folder)
{
	struct backing *b = must_open(folder);

	must_keep(b, "0", "one");
	b->ops->free(b);
}

static void test_newer_file_is_refused(void **state)
{
	keep_one(*state);
	run_sql(path_of(*state, "scenes.sqlite"), "PRAGMA user_version=99");
	assert_refused(*state, ERR_INVALID);
}

static void test_file_of_another_program_is_refused(void **state)
{
	assert_int_equal(mkdir(*state, 0700), 0);
	run_sql(path_of(*state, "scenes.sqlite"), "CREATE TABLE t (a)");
	assert_refused(*state, ERR_INVALID);
}

static void damage(const char *folder, off_t at, const void *data,
    size_t size)
{
	int fd = open(path_of(folder, "scenes.sqlite"), O_RDWR);

	assert_true(fd >= 0);
	assert_int_equal(pwrite(fd, data, size, at), size);
	close(fd);
}

static off_t size_of(const char *path)
{
	struct stat info;

	return stat(path, &info) == 0 ? info.st_size : -1;
}

static void test_damaged_file_is_refused_and_left(void **state)
{
	static const char garbage[8192] = "garbage";
	off_t size;

	keep_one(*state);
	size = size_of(path_of(*state, "scenes.sqlite"));
	damage(*state, 4096, garbage, sizeof garbage);
	assert_refused(*state, ERR_INVALID);
	assert_int_equal(size_of(path_of(*state, "scenes.sqlite")), size);
	damage(*state, 0, garbage, 4096);
	assert_refused(*state, ERR_INVALID);
	assert_int_equal(size_of(path_of(*state, "scenes.sqlite")), size);
}

static void test_truncated_file_is_refused(void **state)
{
	struct backing *b = must_open(*state);
	off_t size;

	for (int i = 0; i < 40; i++)
		must_keep(b, "0", i % 2 == 0 ? "one" : "two");
	b->ops->free(b);
	size = size_of(path_of(*state, "scenes.sqlite"));
	for (off_t cut = size - 1; cut >= 0; cut -= 1237) {
		assert_int_equal(truncate(path_of(*state, "scenes.sqlite"),
		    cut), 0);
		assert_refused(*state, ERR_INVALID);
	}
	assert_int_equal(truncate(path_of(*state, "scenes.sqlite"), 0), 0);
	assert_refused(*state, ERR_INVALID);
}

/* Damage that SQLite does not see. */
static void test_changed_text_is_found(void **state)
{
	static const char *const damage[] = {
		"UPDATE revision SET text = CAST('ome' AS BLOB)",
		"UPDATE revision SET text = x'00' || substr(text, 2)",
		"UPDATE revision SET text = x''",
		"DELETE FROM scene",
		"DELETE FROM revision",
	};
	const struct backing_reader reader = {ignore, on_volume, NULL};

	for (size_t i = 0; i < sizeof damage / sizeof *damage; i++) {
		struct backing *b;

		keep_one(*state);
		run_sql(path_of(*state, "scenes.sqlite"), damage[i]);
		b = must_open(*state);
		if (b->ops->load(b, &reader) != ERR_INVALID)
			fail_msg("not found: %s", damage[i]);
		b->ops->free(b);
		run_sql(path_of(*state, "scenes.sqlite"),
		    "DELETE FROM revision; DELETE FROM scene");
	}
}

/* An older one is not looked at before it is asked for. */
static void test_changed_older_text_is_found(void **state)
{
	const struct backing_reader reader = {ignore, NULL, NULL};
	struct backing *b = must_open(*state);
	char etag[ETAG_SIZE];
	struct found f;

	must_keep(b, "0", "one");
	must_keep(b, "0", "two");
	must_keep(b, "0", "three");
	b->ops->free(b);
	run_sql(path_of(*state, "scenes.sqlite"),
	    "UPDATE revision SET text = x'00' WHERE seq = 1");
	b = must_open(*state);
	look(b, &f);
	etag_of("one", 3, etag);
	assert_int_equal(b->ops->read(b, "0", etag, &reader), ERR_INVALID);
	assert_true(has(b, "0", "two"));
	must_keep(b, "0", "four");
	b->ops->free(b);
}

static void test_sum_that_is_not_what_is_kept_is_made_anew(void **state)
{
	struct backing *b;
	struct found f;

	assert_int_equal(open_with(*state, 100, 9, &b), ERR_OK);
	must_keep(b, "0", "four");
	must_keep(b, "0", "five5");
	b->ops->free(b);
	run_sql(path_of(*state, "scenes.sqlite"),
	    "UPDATE scene SET bytes = 1000");
	assert_int_equal(open_with(*state, 100, 9, &b), ERR_OK);
	look(b, &f);
	must_keep(b, "0", "x");
	assert_true(has(b, "0", "four")); /* 9 of 9 */
	must_keep(b, "0", "y");
	assert_false(has(b, "0", "four"));
	assert_true(has(b, "0", "five5"));
	b->ops->free(b);
}

/* Who has no volume of that id in memory is not told that it is kept. */
static enum err no_volume(void *ctx, const struct backing_volume *v)
{
	(void)ctx, (void)v;
	return ERR_INVALID;
}

static void test_what_is_no_volume_is_refused(void **state)
{
	const struct backing_reader reader = {ignore, no_volume, NULL};
	const struct backing_volume v = {"id", "data", 4, false, "", NULL};
	struct backing *b = must_open(*state);

	assert_int_equal(b->ops->put_volume(b, &v), ERR_OK);
	assert_int_equal(b->ops->load(b, &reader), ERR_INVALID);
	b->ops->free(b);
}

/* A large volume is not to wait for whoever makes a copy of the file. */
static void test_reader_does_not_stop_a_volume(void **state)
{
	static char data[(1 << 20) + 1];
	const struct backing_volume v = {"id", data, sizeof data, false,
	    "", NULL};
	sqlite3_stmt *q;
	struct backing *b;
	sqlite3 *other;
	double begun;

	keep_one(*state);
	b = must_open(*state);
	assert_int_equal(sqlite3_open(path_of(*state, "scenes.sqlite"),
	    &other), SQLITE_OK);
	assert_int_equal(sqlite3_prepare_v2(other, "SELECT * FROM revision",
	    -1, &q, NULL), SQLITE_OK);
	assert_int_equal(sqlite3_step(q), SQLITE_ROW);
	begun = clock_seconds();
	assert_int_equal(b->ops->put_volume(b, &v), ERR_OK);
	/* less than the time that SQLite would wait; 0.05 s here */
	assert_true(load_is_soon(clock_seconds() - begun,
	    0.2e-3 * SQLITE_FILE_BUSY_MS));
	sqlite3_finalize(q);
	sqlite3_close(other);
	b->ops->free(b);
}

/* What is written to a file that is not there any more would not be kept. */
static void test_file_removed_or_replaced_is_not_written(void **state)
{
	const struct backing_options options = {.history = 3,
	    .lost = on_lost};
	const struct backing_reader reader = {ignore, NULL, NULL};
	char path[PATH_MAX + 32], copy[PATH_MAX + 64];
	struct backing *b;

	snprintf(path, sizeof path, "%s", path_of(*state, "scenes.sqlite"));
	snprintf(copy, sizeof copy, "%s.copy", path);
	keep_one(*state);
	assert_int_equal(backing_open_sqlite(*state, &options, &b), ERR_OK);
	assert_false(has(b, "0", "none"));
	assert_int_equal(rename(path, copy), 0);
	/* who reads finds it, too, and the writer is to look */
	assert_int_equal(b->ops->read(b, "0", "\"none\"", &reader),
	    ERR_UNAVAILABLE);
	assert_false(b->ops->is_well(b));
	lost_count = 0;
	assert_int_equal(b->ops->commit(b, NULL, 0), ERR_UNAVAILABLE);
	assert_false(b->ops->is_well(b));
	assert_int_equal(rename(copy, path), 0);
	/* back, as it was or another: all is to be read anew */
	assert_int_equal(b->ops->commit(b, NULL, 0), ERR_UNAVAILABLE);
	assert_int_equal(lost_count, 1);
	assert_int_equal(b->ops->commit(b, NULL, 0), ERR_OK);
	assert_true(b->ops->is_well(b));
	assert_false(has(b, "0", "none"));
	b->ops->free(b);
}

/* What was kept under larger bounds is trimmed when it is loaded; if the file is
 * another one by then, what was loaded is not what is there. */
static void test_file_replaced_while_it_is_loaded(void **state)
{
	char path[PATH_MAX + 32], copy[PATH_MAX + 64], command[2 * PATH_MAX +
	    128];
	struct backing *b;
	struct found f;

	snprintf(path, sizeof path, "%s", path_of(*state, "scenes.sqlite"));
	snprintf(copy, sizeof copy, "%s.copy", path);
	b = must_open(*state);
	must_keep(b, "0", "one");
	must_keep(b, "0", "two");
	b->ops->free(b);
	snprintf(command, sizeof command, "cp '%s' '%s'", path, copy);
	assert_int_equal(system(command), 0);
	assert_int_equal(open_with(*state, 1, 0, &b), ERR_OK);
	lost_count = 0;
	sync_failure.from = sync_failure.calls + 1;
	sync_failure.count = 1;
	sync_failure.by = copy;
	sync_failure.replaced = path;
	look(b, &f);
	assert_true(sync_failure.calls >= sync_failure.from);
	fail_nothing();
	assert_int_equal(lost_count, 1);
	look(b, &f);
	assert_string_equal(f.text[0], "two");
	assert_int_equal(lost_count, 1);
	b->ops->free(b);
}

static void test_missing_file_is_not_made_again(void **state)
{
	keep_one(*state);
	assert_int_equal(unlink(path_of(*state, "scenes.sqlite")), 0);
	assert_refused(*state, ERR_INVALID);
	assert_int_equal(size_of(path_of(*state, "scenes.sqlite")), -1);
	/* as the message says */
	assert_int_equal(unlink(path_of(*state, "lock")), 0);
	keep_one(*state);
}

static void test_log_without_its_file_is_refused(void **state)
{
	struct backing *b = must_open(*state);
	char from[PATH_MAX + 32];

	must_keep(b, "0", "one");
	strcpy(from, path_of(*state, "scenes.sqlite-wal"));
	assert_int_equal(link(from, path_of(*state, "copy")), 0);
	b->ops->free(b);
	strcpy(from, path_of(*state, "copy"));
	assert_int_equal(rename(from, path_of(*state, "scenes.sqlite-wal")),
	    0);
	/* freeing it has cut it to nothing: it is to have something */
	assert_int_equal(truncate(path_of(*state, "scenes.sqlite-wal"), 100),
	    0);
	unlink(path_of(*state, "scenes.sqlite"));
	unlink(path_of(*state, "lock"));
	assert_refused(*state, ERR_INVALID);
	assert_int_equal(size_of(path_of(*state, "scenes.sqlite-wal")), 100);
}

static void test_folder_is_one_daemons(void **state)
{
	struct backing *b = must_open(*state);

	assert_refused(*state, ERR_BUSY);
	b->ops->free(b);
	b = must_open(*state);
	b->ops->free(b);
}

static void test_folder_that_cannot_be_is_refused(void **state)
{
	char *folder = *state;
	FILE *file = fopen(folder, "w");

	fclose(file);
	assert_refused(folder, ERR_IO);
	assert_refused("/proc/nowhere", ERR_IO);
}

static void test_read_only_folder_is_refused(void **state)
{
	if (geteuid() == 0)
		skip(); /* may write there */
	keep_one(*state);
	chmod(*state, 0500);
	chmod(path_of(*state, "lock"), 0400);
	assert_refused(*state, ERR_IO);
	chmod(*state, 0700);
}

/* ---- failures ---- */

/* Changes with one failing call; what was acknowledged, and nothing else, is
 * there, now and after a restart. */
static int change_under_failure(const char *folder, long *from, long *count,
    long n, long run)
{
	const struct backing_reader reader = {ignore, NULL, NULL};
	char model[SCENES][32] = {""}, text[32];
	struct backing *b = must_open(folder);
	int refused = 0;
	struct found f;

	sync_failure.calls = write_failure.calls = 0;
	*from = n;
	*count = run;
	for (int i = 0; i < 12; i++) {
		char id[4] = {(char)('0' + i % SCENES)};
		bool deletes = i % 5 == 4 && model[i % SCENES][0] != '\0';

		snprintf(text, sizeof text, "text %d", i);
		if (keep(b, id, deletes ? NULL : text, NULL) == ERR_OK)
			strcpy(model[i % SCENES], deletes ? "" : text);
		else
			refused++;
		/* by a connection that is open while others fail */
		b->ops->read(b, id, "\"none\"", &reader);
		if (b->ops->is_well(b))
			continue;
		/* as the store does */
		b->ops->commit(b, NULL, 0);
	}
	sync_failure.from = write_failure.from = 0;
	b->ops->commit(b, NULL, 0);
	if (lost_count > 0)
		b->ops->commit(b, NULL, 0);
	assert_true(b->ops->is_well(b));
	look(b, &f);
	for (int i = 0; i < SCENES && lost_count == 0; i++)
		assert_string_equal(f.text[i], model[i]);
	b->ops->free(b);
	b = must_open(folder);
	look(b, &f);
	for (int i = 0; i < SCENES && lost_count == 0; i++)
		assert_string_equal(f.text[i], model[i]);
	must_keep(b, "0", "last");
	b->ops->free(b);
	return refused;
}

static void fail_each(const char *folder, long *from, long *count, long most,
    long run)
{
	char place[PATH_MAX + 32];
	int refused = 0, lost = 0, log = dup(STDERR_FILENO);
	int nowhere = open("/dev/null", O_WRONLY);

	dup2(nowhere, STDERR_FILENO);
	close(nowhere);
	for (long n = 1; n <= most; n++) {
		snprintf(place, sizeof place, "%s-%ld-%ld", folder, run, n);
		lost_count = 0;
		fail_nothing();
		refused += change_under_failure(place, from, count, n, run);
		lost += lost_count;
	}
	dup2(log, STDERR_FILENO);
	close(log);
	print_message("measured: %ld places, %ld calls each: %d changes "
	    "refused, %d read anew\n", most, run, refused, lost);
	assert_true(refused > 0);
}

static void test_fsync_that_fails_anywhere(void **state)
{
	fail_each(*state, &sync_failure.from, &sync_failure.count, 14, 1);
	fail_each(*state, &sync_failure.from, &sync_failure.count, 14, 5);
}

static void test_write_that_fails_anywhere(void **state)
{
	fail_each(*state, &write_failure.from, &write_failure.count, 40, 1);
	fail_each(*state, &write_failure.from, &write_failure.count, 40, 30);
}

/* Says each acknowledged number, until it is killed. */
static void write_until_killed(const char *folder, int out)
{
	struct backing *b;
	char text[32];

	if (open_at(folder, &b) != ERR_OK)
		_exit(1);
	for (int i = 0;; i++) {
		snprintf(text, sizeof text, "%d", i);
		if (keep(b, "0", text, NULL) != ERR_OK ||
		    write(out, &i, sizeof i) != sizeof i)
			_exit(1);
	}
}

static void test_killed_writer_loses_nothing(void **state)
{
	int most = 0;

	for (int round = 0; round < 10; round++) {
		int fds[2], told = -1, last;
		struct backing *b;
		struct found f;
		pid_t pid;

		assert_int_equal(pipe(fds), 0);
		pid = fork();
		if (pid == 0)
			write_until_killed(*state, fds[1]);
		close(fds[1]);
		usleep((useconds_t)(20000 + 5000 * round));
		kill(pid, SIGKILL);
		waitpid(pid, NULL, 0);
		while (read(fds[0], &last, sizeof last) == sizeof last)
			told = last;
		close(fds[0]);
		b = must_open(*state);
		look(b, &f);
		b->ops->free(b);
		/* the one in flight may be there, too */
		if (told >= 0)
			assert_true(atoi(f.text[0]) == told ||
			    atoi(f.text[0]) == told + 1);
		most = told > most ? told : most;
	}
	print_message("measured: up to %d changes before the kill\n", most);
	assert_true(most > 0);
}

#define CASE(f) cmocka_unit_test_setup_teardown(f, setup, teardown)

int main(void)
{
	const struct CMUnitTest tests[] = {
		CASE(test_restart_finds_what_was_kept),
		CASE(test_group_is_one_transaction),
		CASE(test_seq_never_goes_back),
		CASE(test_history_is_trimmed_and_read),
		CASE(test_history_bytes_at_below_and_above_the_bound),
		CASE(test_history_bytes_lowered_hold_after_load),
		CASE(test_history_bytes_as_a_model_has_them),
		CASE(test_read_that_waits_delays_no_change),
		CASE(test_reads_while_the_file_is_opened_anew),
		CASE(test_reader_leaves_no_log_behind),
		CASE(test_volume_of_several_pieces),
		CASE(test_memory_keeps_nothing),
		CASE(test_files_are_for_their_owner_alone),
		CASE(test_log_is_cut),
		CASE(test_file_of_version_1_is_brought_up),
		CASE(test_file_of_version_2_is_brought_up),
		CASE(test_volumes_have_owners),
		CASE(test_newer_file_is_refused),
		CASE(test_file_of_another_program_is_refused),
		CASE(test_damaged_file_is_refused_and_left),
		CASE(test_truncated_file_is_refused),
		CASE(test_changed_text_is_found),
		CASE(test_changed_older_text_is_found),
		CASE(test_sum_that_is_not_what_is_kept_is_made_anew),
		CASE(test_what_is_no_volume_is_refused),
		CASE(test_reader_does_not_stop_a_volume),
		CASE(test_file_removed_or_replaced_is_not_written),
		CASE(test_file_replaced_while_it_is_loaded),
		CASE(test_missing_file_is_not_made_again),
		CASE(test_log_without_its_file_is_refused),
		CASE(test_folder_is_one_daemons),
		CASE(test_folder_that_cannot_be_is_refused),
		CASE(test_read_only_folder_is_refused),
		CASE(test_fsync_that_fails_anywhere),
		CASE(test_write_that_fails_anywhere),
		CASE(test_killed_writer_loses_nothing),
	};

	return cmocka_run_group_tests(tests, NULL, NULL);
}
