/*
 * The scene store before a backing that is played here: what is committed
 * together, what is refused, and that what could not be kept has never been.
 * The documents are words; "bad…" does not compile.
 */
#include <stdarg.h>
#include <stddef.h>
#include <setjmp.h>
#include <stdint.h>
#include <cmocka.h>

#include <errno.h>
#include <pthread.h>
#include <stdatomic.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <time.h>
#include <unistd.h>

#include "core/tape.h"
#include "core/volume.h"
#include "proto/document.h"
#include "proto/fault.h"
#include "proto/grid_npy.h"
#include "server/backing.h"
#include "server/config.h"
#include "server/events.h"
#include "server/limits.h"
#include "server/log.h"
#include "server/metrics.h"
#include "server/program.h"
#include "server/scene_build.h"
#include "server/scene_store.h"
#include "server/scheduler.h"
#include "server/server.h"
#include "server/volume_store.h"

#define KEPT_MAX 4096
#define EVENTS_MAX 4096
#define THREADS 8
#define ROUNDS 50
#define TIRED_SECONDS 20

/* Reads that wait at most, as scene_worker.c has it. */
#define READS_MAX 256

/* ---- the rest of the daemon ---- */

static struct scene_event events[EVENTS_MAX];
static atomic_size_t event_count;
static atomic_bool is_bad_good; /* "bad…" compiles now */

void events_publish(struct events *e, const struct scene_event *event)
{
	const size_t n = atomic_load(&event_count);

	(void)e;
	/* One at a time: under the store's turn. Who counts it may read it. */
	events[n % EVENTS_MAX] = *event;
	atomic_store(&event_count, n + 1);
}

void metrics_observe(struct metrics *m, const struct exchange *x,
    enum metrics_stage stage, double seconds)
{
	(void)m, (void)x, (void)stage;
	assert_true(seconds >= 0.0);
}

struct document_limits limits_kept(const struct server *server)
{
	(void)server;
	return (struct document_limits){0};
}

void scheduler_release(struct scheduler *scheduler, struct program *program)
{
	(void)scheduler;
	free(program->tape);
	free(program);
}

enum err scene_build(struct server *server,
    const struct document_limits *limits, const char *id, const char *text,
    size_t length, struct scene **out, struct faults *faults)
{
	struct program *program;

	(void)server, (void)limits;
	if (strncmp(text, "bad", 3) == 0 && !atomic_load(&is_bad_good)) {
		faults_add(faults, "/root", "is bad");
		return ERR_INVALID;
	}
	program = calloc(1, sizeof *program);
	program->tape = calloc(1, sizeof *program->tape);
	return scene_create(NULL, id, "name", text, length, program, out);
}

/* ---- the backing ---- */

struct kept {
	char id[SCENE_ID_MAX + 1], etag[ETAG_SIZE], owner[8], text[64];
	bool is_dead;
	uint64_t seq;
};

static struct {
	struct kept list[KEPT_MAX];
	size_t count;
	uint64_t seq;
	struct backing_options options;
	bool is_shared;
	bool has_damage;      /* in a volume */
	pthread_mutex_t lock; /* guards: */
	pthread_cond_t wake;
	bool is_held;         /* commits wait */
	bool is_read_held;    /* reads do */
	atomic_bool is_within, is_reading; /* one does */
	atomic_bool is_tired; /* a read has waited for too long */
	atomic_int commits, writes, fail_every, conflicts, away;
	atomic_int refreshes, gone;
	bool is_volume_there; /* the one volume, not forgotten */
	char volume_owner[TOKEN_NAME_MAX + 1];
	atomic_int volume_failures;
} fake = {.lock = PTHREAD_MUTEX_INITIALIZER, .wake = PTHREAD_COND_INITIALIZER};

static struct kept *newest(const char *id)
{
	struct kept *found = NULL;

	for (size_t i = 0; i < fake.count; i++)
		if (!fake.list[i].is_dead && strcmp(fake.list[i].id, id) == 0)
			found = fake.list + i;
	return found;
}

static struct backing_revision revision_of(const struct kept *k,
    bool with_text)
{
	return (struct backing_revision){.id = k->id, .etag = k->etag,
	    .text = with_text ? k->text : "", .length = strlen(k->text),
	    .owner = k->owner, .seq = {k->seq, 0}, .time = 1e9,
	    .nodes = 1, .is_past = !with_text};
}

static enum err fake_load(struct backing *b,
    const struct backing_reader *reader)
{
	(void)b;
	if (atomic_load(&fake.away) > 0)
		return ERR_UNAVAILABLE;
	if (fake.has_damage) {
		static const struct backing_volume v = {"id", "x", 1, false,
		    "", NULL};

		return reader->volume(reader->ctx, &v);
	}
	for (size_t i = 0; i < fake.count; i++) {
		const struct kept *k = fake.list + i;
		struct backing_revision r = revision_of(k, k == newest(k->id));
		enum err err = k->is_dead ? ERR_OK :
		    reader->revision(reader->ctx, &r);

		if (err != ERR_OK)
			return err;
	}
	return ERR_OK;
}

/* What another daemon, or this one, keeps. */
static uint64_t keep(const char *id, const char *text)
{
	struct kept *k = fake.list + fake.count;

	fake.seq++;
	if (text == NULL) {
		for (size_t i = 0; i < fake.count; i++)
			if (strcmp(fake.list[i].id, id) == 0)
				fake.list[i].is_dead = true;
		return fake.seq;
	}
	assert_true(fake.count++ < KEPT_MAX);
	*k = (struct kept){.seq = fake.seq};
	snprintf(k->id, sizeof k->id, "%s", id);
	snprintf(k->text, sizeof k->text, "%s", text);
	etag_of(text, strlen(text), k->etag);
	return fake.seq;
}

static void write_one(struct backing_write *w)
{
	const struct kept *now = newest(w->revision.id);
	const char *etag = now != NULL ? now->etag : NULL;

	if (fake.options.guard != NULL && !w->is_any &&
	    (etag == NULL) != (w->expected == NULL)) {
		w->result = ERR_CONFLICT;
	} else if (!w->is_any && etag != NULL &&
	    strcmp(etag, w->expected) != 0) {
		w->result = ERR_CONFLICT;
	} else {
		w->result = ERR_OK;
		w->has_found = fake.is_shared;
		w->was_there = now != NULL;
		w->revision.before.major = now != NULL ? now->seq : 0;
		snprintf(w->owner, sizeof w->owner, "%s", now != NULL ?
		    now->owner : w->revision.owner);
		w->revision.seq.major = keep(w->revision.id,
		    w->revision.text);
		w->revision.time = 1e9 + (double)fake.seq;
		snprintf(fake.list[fake.count - 1].owner, 8, "%s",
		    w->has_found ? w->owner : w->revision.owner);
	}
}

static enum err fake_commit(struct backing *b, struct backing_write *writes,
    size_t count)
{
	int n;

	(void)b;
	if (count == 0)
		return ERR_OK;
	pthread_mutex_lock(&fake.lock);
	atomic_store(&fake.is_within, true);
	while (fake.is_held)
		pthread_cond_wait(&fake.wake, &fake.lock);
	atomic_store(&fake.is_within, false);
	pthread_mutex_unlock(&fake.lock);
	n = atomic_fetch_add(&fake.commits, 1) + 1;
	if (fake.fail_every > 0 && n % fake.fail_every == 0)
		return ERR_IO;
	for (size_t i = 0; i < count; i++)
		if (atomic_load(&fake.conflicts) > 0) {
			atomic_fetch_sub(&fake.conflicts, 1);
			writes[i].result = ERR_CONFLICT;
		} else {
			write_one(writes + i);
			atomic_fetch_add(&fake.writes, 1);
		}
	return ERR_OK;
}

static enum err fake_refresh(struct backing *b, const char *id,
    const struct backing_reader *reader)
{
	const struct kept *k = newest(id);
	struct backing_revision r;

	(void)b;
	atomic_fetch_add(&fake.refreshes, 1);
	if (k == NULL)
		return ERR_NOT_FOUND;
	r = revision_of(k, true);
	return reader->revision(reader->ctx, &r);
}

static enum err fake_read(struct backing *b, const char *id, const char *etag,
    const struct backing_reader *reader)
{
	struct timespec until;

	(void)b;
	clock_gettime(CLOCK_REALTIME, &until);
	until.tv_sec += TIRED_SECONDS;
	pthread_mutex_lock(&fake.lock);
	atomic_store(&fake.is_reading, true);
	while (fake.is_read_held && !atomic_load(&fake.is_tired))
		atomic_store(&fake.is_tired, pthread_cond_timedwait(
		    &fake.wake, &fake.lock, &until) == ETIMEDOUT);
	atomic_store(&fake.is_reading, false);
	pthread_mutex_unlock(&fake.lock);
	for (size_t i = 0; i < fake.count; i++)
		if (!fake.list[i].is_dead &&
		    strcmp(fake.list[i].id, id) == 0 &&
		    strcmp(fake.list[i].etag, etag) == 0) {
			struct backing_revision r = revision_of(
			    fake.list + i, true);

			return reader->revision(reader->ctx, &r);
		}
	return ERR_NOT_FOUND;
}

static bool fake_is_well(struct backing *b)
{
	(void)b;
	return true;
}

static enum err fake_forget(struct backing *b, const char *id, bool is_gone)
{
	(void)b, (void)id;
	if (is_gone)
		atomic_fetch_add(&fake.gone, 1);
	else
		fake.is_volume_there = false;
	return ERR_OK;
}

static enum err fake_put_volume(struct backing *b,
    const struct backing_volume *v)
{
	(void)b;
	if (atomic_load(&fake.volume_failures) > 0) {
		atomic_fetch_sub(&fake.volume_failures, 1);
		return ERR_IO;
	}
	if (!fake.is_volume_there)
		strcpy(fake.volume_owner, v->owner);
	fake.is_volume_there = true;
	strcpy(v->kept_owner, fake.volume_owner);
	return ERR_OK;
}

static void fake_free(struct backing *b)
{
	(void)b;
}

static const struct backing_ops plain_ops = {.load = fake_load,
	.commit = fake_commit, .read = fake_read, .is_well = fake_is_well,
	.put_volume = fake_put_volume, .forget_volume = fake_forget,
	.free = fake_free};
static const struct backing_ops shared_ops = {.load = fake_load,
	.commit = fake_commit, .read = fake_read, .refresh = fake_refresh,
	.is_well = fake_is_well, .put_volume = fake_put_volume,
	.forget_volume = fake_forget, .free = fake_free};

enum err backing_open_sqlite(const char *folder,
    const struct backing_options *options, struct backing **out)
{
	static struct backing plain = {&plain_ops};

	(void)folder;
	fake.options = *options;
	fake.is_shared = false;
	*out = &plain;
	return ERR_OK;
}

enum err backing_open_redis(const char *url,
    const struct backing_options *options, struct backing **out)
{
	static struct backing shared = {&shared_ops};

	(void)url;
	fake.options = *options;
	fake.is_shared = true;
	*out = &shared;
	return ERR_OK;
}

/* ---- changes ---- */

static struct config config;
static struct server server = {.config = &config};

/* A change, and the wait for it. */
struct asked {
	struct scene_change change;
	atomic_bool is_done;
};

static void on_done(void *ctx)
{
	struct asked *a = ctx;

	atomic_store(&a->is_done, true);
}

static void submit(struct asked *a, enum scene_change_kind kind,
    const char *id, const char *text, const char *match,
    const char *none_match)
{
	struct faults faults = {0};

	memset(&a->change, 0, sizeof a->change);
	atomic_store(&a->is_done, false);
	a->change.kind = kind;
	snprintf(a->change.id, sizeof a->change.id, "%s", id);
	a->change.precondition = (struct precondition){match, none_match};
	a->change.scenes_most = SIZE_MAX;
	a->change.done = on_done;
	a->change.ctx = a;
	if (text != NULL)
		assert_int_equal(scene_build(&server, NULL, id, text,
		    strlen(text), &a->change.scene, &faults), ERR_OK);
	assert_int_equal(scene_store_submit(server.scenes, &a->change),
	    ERR_OK);
}

static enum err await(struct asked *a)
{
	while (!atomic_load(&a->is_done))
		usleep(100);
	if (a->change.now != NULL)
		scene_release(a->change.now);
	return a->change.result;
}

static enum err put(const char *id, const char *text)
{
	struct asked a;

	submit(&a, SCENE_PUT, id, text, NULL, NULL);
	return await(&a);
}

static enum err delete(const char *id)
{
	struct asked a;

	submit(&a, SCENE_DELETE, id, NULL, NULL, NULL);
	return await(&a);
}

static void assert_text(const char *id, const char *text)
{
	struct scene *scene = scene_store_find(server.scenes, id);

	if (text == NULL) {
		assert_null(scene);
		return;
	}
	assert_non_null(scene);
	assert_string_equal(scene->text, text);
	scene_release(scene);
}

static void hold(bool is_held)
{
	pthread_mutex_lock(&fake.lock);
	fake.is_held = is_held;
	pthread_cond_broadcast(&fake.wake);
	pthread_mutex_unlock(&fake.lock);
}

static void hold_reads(bool is_held)
{
	pthread_mutex_lock(&fake.lock);
	fake.is_read_held = is_held;
	pthread_cond_broadcast(&fake.wake);
	pthread_mutex_unlock(&fake.lock);
}

/* Asks for the revision of a that had that text. */
static enum err submit_read(struct asked *a, const char *text)
{
	memset(&a->change, 0, sizeof a->change);
	atomic_store(&a->is_done, false);
	a->change = (struct scene_change){.kind = SCENE_READ, .id = "a",
	    .done = on_done, .ctx = a};
	etag_of(text, strlen(text), a->change.etag);
	return scene_store_submit(server.scenes, &a->change);
}

static void await_reading(void)
{
	while (!atomic_load(&fake.is_reading))
		usleep(100);
}

/* Has the writer wait in a commit, of scene "held". */
static void hold_with(struct asked *a)
{
	hold(true);
	submit(a, SCENE_PUT, "held", "held", NULL, NULL);
	while (!atomic_load(&fake.is_within))
		usleep(100);
}

static void stop(void)
{
	scene_store_stop(server.scenes);
	scene_store_free(server.scenes);
	server.scenes = NULL;
}

static void start(void)
{
	assert_int_equal(scene_store_create(&server, &server.scenes), ERR_OK);
}

static void reset(void)
{
	fake.count = 0;
	fake.seq = 0;
	fake.is_held = fake.is_read_held = false;
	atomic_store(&fake.is_tired, false);
	fake.commits = fake.writes = fake.fail_every = fake.conflicts = 0;
	fake.away = fake.refreshes = fake.gone = 0;
	fake.is_volume_there = false;
	fake.volume_failures = 0;
	atomic_store(&event_count, 0);
	atomic_store(&is_bad_good, false);
	config = (struct config){.max_scenes = 1000,
	    .scene_memory = (size_t)1 << 30, .history = 3};
	assert_int_equal(volume_store_create(1 << 20, &server.volumes), ERR_OK);
}

static int setup(void **state)
{
	(void)state;
	log_set_level(LOG_ERROR);
	reset();
	start();
	return 0;
}

static int setup_shared(void **state)
{
	(void)state;
	log_set_level(LOG_ERROR);
	reset();
	strcpy(config.store, "redis://");
	start();
	return 0;
}

static int teardown(void **state)
{
	(void)state;
	hold(false);
	hold_reads(false);
	stop();
	volume_store_free(server.volumes);
	return 0;
}

/* ---- one daemon ---- */

static void test_put_is_kept_seen_and_told(void **state)
{
	struct scene *scene;

	(void)state;
	assert_int_equal(put("a", "one"), ERR_OK);
	assert_int_equal(put("a", "two"), ERR_OK);
	scene = scene_store_get(server.scenes, "a");
	assert_string_equal(scene->text, "two");
	assert_int_equal(scene->seq.major, 2);
	assert_true(scene->time == 1e9 + 2.0);
	scene_release(scene);
	assert_int_equal(event_count, 2);
	assert_true(events[0].is_first && !events[1].is_first);
	assert_int_equal(events[1].seq.major, 2);
	assert_int_equal(fake.writes, 2);
}

static void test_same_bytes_write_nothing(void **state)
{
	struct asked a;

	(void)state;
	put("a", "one");
	submit(&a, SCENE_PUT, "a", "one", NULL, NULL);
	assert_int_equal(await(&a), ERR_OK);
	assert_true(a.change.unchanged && a.change.replaced);
	assert_int_equal(fake.commits, 1);
	assert_int_equal(event_count, 1);
}

static void test_preconditions_are_of_what_is_there(void **state)
{
	struct asked a;
	char tag[ETAG_SIZE];

	(void)state;
	assert_int_equal(delete("a"), ERR_NOT_FOUND);
	submit(&a, SCENE_PUT, "a", "one", "*", NULL);
	assert_int_equal(await(&a), ERR_CONFLICT);
	put("a", "one");
	submit(&a, SCENE_PUT, "a", "two", NULL, "*");
	assert_int_equal(await(&a), ERR_CONFLICT);
	etag_of("one", 3, tag);
	submit(&a, SCENE_PUT, "a", "two", tag, NULL);
	assert_int_equal(await(&a), ERR_OK);
	submit(&a, SCENE_DELETE, "a", NULL, tag, NULL);
	assert_int_equal(await(&a), ERR_CONFLICT);
	assert_text("a", "two");
}

static void test_what_waits_together_is_committed_together(void **state)
{
	struct asked first, others[64];
	char id[8];

	(void)state;
	hold_with(&first);
	for (int i = 0; i < 64; i++) {
		snprintf(id, sizeof id, "s%d", i);
		submit(others + i, SCENE_PUT, id, "text", NULL, NULL);
	}
	assert_int_equal(scene_store_waiting(server.scenes), 64);
	assert_text("held", NULL);
	hold(false);
	await(&first);
	for (int i = 0; i < 64; i++)
		assert_int_equal(await(others + i), ERR_OK);
	assert_int_equal(fake.commits, 2);
	assert_int_equal(fake.writes, 65);
	for (int i = 1; i < 65; i++)
		assert_true(events[i - 1].seq.major < events[i].seq.major);
}

static void test_later_changes_of_a_group_see_earlier_ones(void **state)
{
	struct asked held, a[6];

	(void)state;
	config.max_scenes = 2;
	stop();
	start();
	hold_with(&held);
	submit(a + 0, SCENE_PUT, "x", "one", NULL, "*");
	submit(a + 1, SCENE_PUT, "x", "two", NULL, "*");
	submit(a + 2, SCENE_PUT, "y", "one", NULL, NULL);
	submit(a + 3, SCENE_DELETE, "x", NULL, NULL, NULL);
	submit(a + 4, SCENE_PUT, "y", "two", NULL, NULL);
	submit(a + 5, SCENE_PUT, "y", "two", NULL, NULL);
	hold(false);
	await(&held);
	assert_int_equal(await(a + 0), ERR_OK);
	assert_int_equal(await(a + 1), ERR_CONFLICT);
	assert_int_equal(await(a + 2), ERR_LIMIT); /* held, x are there */
	assert_int_equal(await(a + 3), ERR_OK);
	assert_int_equal(await(a + 4), ERR_OK);
	assert_int_equal(await(a + 5), ERR_OK);
	assert_true(a[5].change.unchanged);
	assert_int_equal(fake.commits, 2);
	assert_int_equal(scene_store_count(server.scenes), 2);
	assert_text("x", NULL);
	assert_text("y", "two");
}

static void test_commit_that_fails_has_never_been(void **state)
{
	struct asked held, a[3];

	(void)state;
	put("a", "one");
	hold_with(&held);
	submit(a + 0, SCENE_PUT, "a", "two", NULL, NULL);
	submit(a + 1, SCENE_PUT, "a", "two", NULL, NULL); /* by the first */
	submit(a + 2, SCENE_DELETE, "b", NULL, NULL, NULL);
	fake.fail_every = 3;
	hold(false);
	assert_int_equal(await(&held), ERR_OK);
	assert_int_equal(await(a + 0), ERR_UNAVAILABLE);
	assert_int_equal(await(a + 1), ERR_UNAVAILABLE);
	await(a + 2);
	assert_text("a", "one");
	assert_int_equal(event_count, 2);
	assert_int_equal(put("a", "two"), ERR_OK);
	assert_text("a", "two");
}

struct client {
	pthread_t thread;
	int number;
	int acknowledged; /* the last round that was */
	bool is_wrong;
};

static void *edit(void *arg)
{
	struct client *c = arg;
	char id[8], text[16];

	snprintf(id, sizeof id, "c%d", c->number);
	c->acknowledged = -1;
	for (int i = 0; i < ROUNDS; i++) {
		enum err err;

		snprintf(text, sizeof text, "%d", i);
		err = put(id, text);
		if (err == ERR_OK)
			c->acknowledged = i;
		c->is_wrong |= err != ERR_OK && err != ERR_UNAVAILABLE;
	}
	return NULL;
}

static void test_memory_is_what_is_kept_when_commits_fail(void **state)
{
	struct client clients[THREADS];
	char id[8], text[16];

	(void)state;
	fake.fail_every = 3;
	for (int i = 0; i < THREADS; i++) {
		clients[i] = (struct client){.number = i};
		pthread_create(&clients[i].thread, NULL, edit, clients + i);
	}
	for (int i = 0; i < THREADS; i++)
		pthread_join(clients[i].thread, NULL);
	for (int i = 0; i < THREADS; i++) {
		assert_false(clients[i].is_wrong);
		assert_true(clients[i].acknowledged >= 0);
		snprintf(id, sizeof id, "c%d", i);
		snprintf(text, sizeof text, "%d", clients[i].acknowledged);
		assert_text(id, text);
		assert_string_equal(newest(id)->text, text);
	}
	assert_int_equal(event_count, fake.writes);
	print_message("measured: %d commits for %d changes\n", fake.commits,
	    THREADS * ROUNDS);
}

/* Adds the letter that ctx is. */
static enum err append(void *ctx, const struct scene *now, struct scene **out)
{
	struct faults faults = {0};
	char text[64];

	snprintf(text, sizeof text, "%s%s", now->text, (const char *)ctx);
	return scene_build(&server, NULL, now->id, text, strlen(text), out,
	    &faults);
}

static void submit_patch(struct asked *a, const char *base)
{
	static char letter[] = "x";
	struct faults faults = {0};
	char text[64];

	memset(&a->change, 0, sizeof a->change);
	atomic_store(&a->is_done, false);
	snprintf(text, sizeof text, "%sx", base);
	a->change = (struct scene_change){.kind = SCENE_PUT, .id = "a",
	    .scenes_most = SIZE_MAX, .done = on_done, .ctx = a,
	    .rebase = append, .rebase_ctx = letter,
	    .rebase_most = SIZE_MAX};
	etag_of(base, strlen(base), a->change.base);
	assert_int_equal(scene_build(&server, NULL, "a", text, strlen(text),
	    &a->change.scene, &faults), ERR_OK);
	assert_int_equal(scene_store_submit(server.scenes, &a->change),
	    ERR_OK);
}

static void test_patches_of_one_base_are_all_there(void **state)
{
	struct asked held, a[8];

	(void)state;
	put("a", "p");
	hold_with(&held);
	for (int i = 0; i < 8; i++)
		submit_patch(a + i, "p");
	hold(false);
	await(&held);
	for (int i = 0; i < 8; i++)
		assert_int_equal(await(a + i), ERR_OK);
	assert_text("a", "pxxxxxxxx");
	delete("a");
	submit_patch(a, "p");
	assert_int_equal(await(a), ERR_NOT_FOUND);
}

/* As the worker does with one that others have outrun. */
static void test_a_patch_that_is_waited_for_is_rebased(void **state)
{
	char letter[] = "y";
	struct scene_change change = {.kind = SCENE_PUT, .id = "a",
	    .scenes_most = SIZE_MAX, .rebase = append, .rebase_ctx = letter,
	    .rebase_most = SIZE_MAX};
	struct faults faults = {0};

	(void)state;
	put("a", "p");
	etag_of("o", 1, change.base);
	assert_int_equal(scene_build(&server, NULL, "a", "oy", 2,
	    &change.scene, &faults), ERR_OK);
	scene_store_change(server.scenes, &change);
	assert_int_equal(change.result, ERR_OK);
	scene_release(change.now);
	assert_text("a", "py");
}

static void test_history_is_trimmed(void **state)
{
	struct scene_event list[8];
	struct scene_seq before = {4, 0};
	struct asked a;
	bool missed;
	char text[8];

	(void)state;
	for (int i = 1; i <= 5; i++) {
		snprintf(text, sizeof text, "%d", i);
		put("a", text);
	}
	assert_int_equal(scene_store_history(server.scenes, "a", NULL, 8,
	    list), 3);
	assert_int_equal(list[0].seq.major, 5);
	assert_int_equal(list[2].seq.major, 3);
	assert_int_equal(scene_store_history(server.scenes, "a", &before, 8,
	    list), 1);
	assert_int_equal(list[0].seq.major, 3);
	assert_int_equal(scene_store_since(server.scenes, "a",
	    (struct scene_seq){2, 0}, 8, list, &missed), 3);
	assert_false(missed);
	assert_int_equal(list[0].seq.major, 3);
	scene_store_since(server.scenes, "a", (struct scene_seq){1, 0}, 8,
	    list, &missed);
	assert_true(missed);
	/* another store's */
	assert_int_equal(scene_store_since(server.scenes, "a",
	    (struct scene_seq){99, 0}, 8, list, &missed), 3);
	assert_true(missed);
	assert_int_equal(submit_read(&a, "4"), ERR_OK);
	assert_int_equal(await(&a), ERR_OK);
	assert_string_equal(a.change.text, "4");
	free(a.change.text);
	delete("a");
	assert_int_equal(scene_store_history(server.scenes, "a", NULL, 8,
	    list), 0);
}

/* ---- what the past may take ---- */

static void start_with(size_t history, size_t history_bytes)
{
	stop();
	config.history = history;
	config.history_bytes = history_bytes;
	start();
}

/* The lengths of what is listed of id, newest first, as "4,3,". */
static void assert_listed(const char *id, const char *lengths)
{
	struct scene_event list[16];
	size_t count = scene_store_history(server.scenes, id, NULL, 16, list);
	char text[128] = "";

	for (size_t i = 0; i < count; i++)
		snprintf(text + strlen(text), sizeof text - strlen(text),
		    "%zu,", list[i].length);
	assert_string_equal(text, lengths);
}

static void test_history_bytes_exactly_at_and_around_the_bound(void **state)
{
	(void)state;
	start_with(16, 9);
	put("a", "4444");
	put("a", "55555");
	assert_listed("a", "5,4,");
	put("a", "1");
	assert_listed("a", "1,5,4,"); /* 9 of 9 */
	put("a", "22");
	assert_listed("a", "2,1,5,"); /* 10 would be */
	put("a", "333");
	assert_listed("a", "3,2,1,5,"); /* 8 */
	assert_int_equal(scene_store_history_bytes(server.scenes), 8);
}

static void test_history_bytes_one_revision_beyond_them(void **state)
{
	(void)state;
	start_with(16, 4);
	put("a", "1");
	put("a", "55555");
	assert_listed("a", "5,1,"); /* the present one does not count */
	put("a", "22");
	assert_listed("a", "2,");   /* nor stays, nor what is before it */
	put("a", "333");
	assert_listed("a", "3,2,");
	assert_int_equal(scene_store_history_bytes(server.scenes), 2);
}

static void test_history_bytes_are_each_scenes_own(void **state)
{
	(void)state;
	start_with(3, 4);
	for (int i = 0; i < 8; i++) {
		char id[8];

		snprintf(id, sizeof id, "s%d", i);
		put(id, "4444");
		put(id, "333");
		assert_listed(id, "3,4,");
	}
	assert_int_equal(scene_store_history_bytes(server.scenes), 32);
	delete("s0");
	assert_int_equal(scene_store_history_bytes(server.scenes), 28);
	put("s1", "1");
	put("s1", "");
	put("s1", "22");
	put("s1", "1");
	assert_listed("s1", "1,2,0,"); /* --history, too */
}

static void test_history_bytes_lowered_hold_from_the_start(void **state)
{
	struct scene_event list[8];
	bool missed;

	(void)state;
	start_with(16, 0);
	put("a", "4444");
	put("a", "333");
	put("a", "22");
	put("a", "1");
	put("b", "55555");
	assert_listed("a", "1,2,3,4,");
	start_with(16, 5);
	assert_listed("a", "1,2,3,");
	assert_listed("b", "5,");
	start_with(16, 1);
	assert_listed("a", "1,");
	scene_store_since(server.scenes, "a", (struct scene_seq){1, 0}, 8,
	    list, &missed);
	assert_true(missed);
	assert_int_equal(scene_store_history_bytes(server.scenes), 0);
}

/* ---- reading what is past ---- */

static void test_read_delays_no_change(void **state)
{
	struct asked read;
	char text[16];

	(void)state;
	put("a", "first");
	put("a", "second");
	hold_reads(true);
	assert_int_equal(submit_read(&read, "first"), ERR_OK);
	await_reading();
	for (int i = 0; i < 64; i++) {
		snprintf(text, sizeof text, "%d", i);
		assert_int_equal(put("b", text), ERR_OK);
	}
	/* all are kept, and the read is not done */
	assert_true(atomic_load(&fake.is_reading));
	assert_false(atomic_load(&read.is_done));
	hold_reads(false);
	assert_int_equal(await(&read), ERR_OK);
	assert_string_equal(read.change.text, "first");
	free(read.change.text);
	assert_false(atomic_load(&fake.is_tired));
}

static void test_reads_do_not_wait_for_a_commit(void **state)
{
	struct asked held, read;

	(void)state;
	put("a", "first");
	put("a", "second");
	hold_with(&held);
	assert_int_equal(submit_read(&read, "first"), ERR_OK);
	assert_int_equal(await(&read), ERR_OK);
	free(read.change.text);
	assert_int_equal(submit_read(&read, "never"), ERR_OK);
	assert_int_equal(await(&read), ERR_NOT_FOUND);
	assert_false(atomic_load(&held.is_done));
	hold(false);
	assert_int_equal(await(&held), ERR_OK);
}

static void test_too_many_reads_are_refused(void **state)
{
	static struct asked reads[READS_MAX + 1];
	struct asked more;

	(void)state;
	put("a", "first");
	hold_reads(true);
	assert_int_equal(submit_read(&reads[0], "first"), ERR_OK);
	await_reading();
	for (int i = 1; i <= READS_MAX; i++)
		assert_int_equal(submit_read(&reads[i], "first"), ERR_OK);
	assert_int_equal(submit_read(&more, "first"), ERR_BUSY);
	assert_int_equal(put("b", "x"), ERR_OK);
	hold_reads(false);
	for (int i = 0; i <= READS_MAX; i++) {
		assert_int_equal(await(&reads[i]), ERR_OK);
		free(reads[i].change.text);
	}
}

static void *stop_store(void *ctx)
{
	scene_store_stop(server.scenes);
	return ctx;
}

static void test_stopping_cancels_reads_that_wait(void **state)
{
	static struct asked reads[READS_MAX];
	int count = 0, ok = 0, cancelled = 0;
	enum err err = ERR_OK;
	pthread_t thread;

	(void)state;
	put("a", "first");
	hold_reads(true);
	assert_int_equal(submit_read(&reads[count++], "first"), ERR_OK);
	await_reading();
	assert_int_equal(submit_read(&reads[count++], "first"), ERR_OK);
	pthread_create(&thread, NULL, stop_store, NULL);
	while (err == ERR_OK && count < READS_MAX) {
		usleep(1000);
		err = submit_read(&reads[count], "first");
		count += err == ERR_OK;
	}
	hold_reads(false);
	pthread_join(thread, NULL);
	for (int i = 0; i < count; i++) {
		err = await(&reads[i]);
		ok += err == ERR_OK;
		cancelled += err == ERR_CANCELLED;
		free(reads[i].change.text);
	}
	assert_int_equal(ok + cancelled, count);
	assert_true(ok >= 1 && cancelled >= 1);
	assert_int_equal(submit_read(&reads[0], "first"), ERR_CANCELLED);
}

static void test_owner_stays_and_is_counted(void **state)
{
	struct asked a;

	(void)state;
	for (int i = 0; i < 3; i++) {
		struct faults faults = {0};

		memset(&a.change, 0, sizeof a.change);
		atomic_store(&a.is_done, false);
		a.change = (struct scene_change){.kind = SCENE_PUT,
		    .scenes_most = 2, .done = on_done, .ctx = &a};
		snprintf(a.change.id, sizeof a.change.id, "o%d", i);
		scene_build(&server, NULL, a.change.id, "t", 1,
		    &a.change.scene, &faults);
		strcpy(a.change.scene->owner, "me");
		scene_store_submit(server.scenes, &a.change);
		assert_int_equal(await(&a), i < 2 ? ERR_OK : ERR_LIMIT);
		assert_int_equal(a.change.is_owners, i == 2);
	}
	put("o0", "by another");
	assert_int_equal(scene_store_count_of(server.scenes, "me"), 2);
}

static void test_restart_reads_what_is_kept(void **state)
{
	struct faults faults = {0};
	struct scene_event list[8];
	struct scene *scene;

	(void)state;
	put("a", "one");
	put("a", "two");
	put("b", "three");
	stop();
	keep("c", "bad one");
	atomic_store(&event_count, 0);
	start();
	assert_int_equal(event_count, 0);
	assert_int_equal(scene_store_count(server.scenes), 3);
	assert_text("a", "two");
	assert_int_equal(scene_store_history(server.scenes, "a", NULL, 8,
	    list), 2);
	/* what cannot be used is not lost, and not in the way */
	assert_null(scene_store_get(server.scenes, "c"));
	assert_text("c", "bad one");
	assert_int_equal(scene_store_mend(server.scenes, "c", &faults),
	    ERR_INVALID);
	assert_int_equal(faults.count, 1);
	atomic_store(&is_bad_good, true);
	assert_int_equal(scene_store_mend(server.scenes, "c", &faults),
	    ERR_OK);
	scene = scene_store_get(server.scenes, "c");
	assert_non_null(scene);
	scene_release(scene);
	assert_int_equal(put("c", "good"), ERR_OK);
	assert_int_equal(delete("c"), ERR_OK);
}

/* A volume that is forgotten. */
static void forget_one(float sample, char id[static VOLUME_ID_DIGITS + 1])
{
	float samples[64] = {sample};
	struct grid grid = {.samples = samples, .count = {4, 4, 4}};
	struct volume_payer payer = {.owner = "", .bytes_most = SIZE_MAX};
	struct volume_entry entry;
	bool is_new;

	assert_int_equal(volume_store_add(server.volumes, &grid,
	    vec3(0.0, 0.0, 0.0), vec3(1.0, 1.0, 1.0), false, &payer, &entry,
	    &is_new), ERR_OK);
	volume_store_settle(server.volumes, entry.id, "");
	volume_store_delete(server.volumes, entry.id);
	strcpy(id, entry.id);
}

/* Uploads a volume of 4 x 4 x 4, told apart by its first sample, as owner who may
 * have room for so many of them; it is to be settled. */
static enum err begin_upload(float sample, const char *owner, size_t most,
    struct volume_entry *out)
{
	float samples[64] = {sample};
	struct grid grid = {.samples = samples, .count = {4, 4, 4}};
	struct volume_payer payer = {.owner = owner,
	    .bytes_most = most * volume_store_need(&grid)};
	bool is_new;
	enum err err = volume_store_add(server.volumes, &grid,
	    vec3(0.0, 0.0, 0.0), vec3(1.0, 1.0, 1.0), false, &payer, out,
	    &is_new);

	assert_int_equal(payer.is_owners, err == ERR_LIMIT);
	return err;
}

/* The same, kept if it can be. */
static enum err upload(float sample, const char *owner, size_t most,
    bool is_kept, struct volume_entry *out)
{
	enum err err = begin_upload(sample, owner, most, out);

	if (err == ERR_OK)
		volume_store_settle(server.volumes, out->id, is_kept ?
		    out->owner : NULL);
	return err;
}

/* How many volumes' memory counts as owner's. */
static size_t volumes_of(const char *owner)
{
	float samples[64] = {0.0f};
	struct grid grid = {.samples = samples, .count = {4, 4, 4}};
	size_t bytes = volume_store_bytes_of(server.volumes, owner);

	assert_int_equal(bytes % volume_store_need(&grid), 0);
	return bytes / volume_store_need(&grid);
}

static void test_volumes_count_as_their_owners(void **state)
{
	struct volume_entry first, e;

	(void)state;
	assert_int_equal(upload(11.0f, "me", 2, true, &first), ERR_OK);
	assert_int_equal(upload(12.0f, "me", 2, true, &e), ERR_OK);
	assert_int_equal(volumes_of("me"), 2);
	assert_int_equal(upload(13.0f, "me", 2, true, &e), ERR_LIMIT);
	/* The same once more, or as somebody else, costs nothing. */
	assert_int_equal(upload(11.0f, "me", 2, true, &e), ERR_OK);
	assert_int_equal(upload(11.0f, "you", 0, true, &e), ERR_OK);
	assert_string_equal(e.owner, "me");
	assert_int_equal(volumes_of("you"), 0);
	/* Gone, it is given back. */
	assert_int_equal(volume_store_delete(server.volumes, first.id),
	    ERR_OK);
	assert_int_equal(volumes_of("me"), 1);
	assert_int_equal(upload(13.0f, "me", 2, true, &e), ERR_OK);
	/* What could not be kept does not count. */
	assert_int_equal(upload(14.0f, "you", 1, false, &e), ERR_OK);
	assert_int_equal(volumes_of("you"), 0);
	assert_int_equal(upload(15.0f, "none", 0, true, &e), ERR_LIMIT);
}

static void test_forgotten_volumes_count_while_they_are_used(void **state)
{
	struct volume_entry first, e;
	struct volume *used;

	(void)state;
	assert_int_equal(upload(21.0f, "a", 1, true, &first), ERR_OK);
	used = volume_store_find(server.volumes, first.id);
	assert_non_null(used);
	assert_int_equal(volume_store_delete(server.volumes, first.id),
	    ERR_OK);
	assert_int_equal(volumes_of("a"), 1);
	assert_int_equal(upload(22.0f, "a", 1, true, &e), ERR_LIMIT);
	/* Uploaded anew it is who does that's, if that may and it is kept. */
	assert_int_equal(upload(21.0f, "b", 0, true, &e), ERR_LIMIT);
	assert_int_equal(upload(21.0f, "b", 1, false, &e), ERR_OK);
	assert_int_equal(volumes_of("a"), 1);
	assert_int_equal(volumes_of("b"), 0);
	assert_int_equal(upload(21.0f, "b", 1, true, &e), ERR_OK);
	assert_int_equal(volumes_of("a"), 0);
	assert_int_equal(volumes_of("b"), 1);
	/* One's own is not paid twice. */
	assert_int_equal(volume_store_delete(server.volumes, first.id),
	    ERR_OK);
	assert_int_equal(upload(21.0f, "b", 1, true, &e), ERR_OK);
	assert_int_equal(volumes_of("b"), 1);
	volume_release(used);
}

/* Of two who bring the same, the one whose upload is kept pays. */
static void test_volume_is_whose_upload_was_kept(void **state)
{
	struct volume_entry e;

	(void)state;
	assert_int_equal(begin_upload(31.0f, "a", 1, &e), ERR_OK);
	assert_int_equal(begin_upload(31.0f, "none", 0, &e), ERR_LIMIT);
	assert_int_equal(begin_upload(31.0f, "b", 1, &e), ERR_OK);
	assert_false(volume_store_settle(server.volumes, e.id, NULL));
	assert_false(volume_store_settle(server.volumes, e.id, "b"));
	assert_int_equal(volumes_of("a"), 0);
	assert_int_equal(volumes_of("b"), 1);
	/* Of two that are kept the second one is nothing new. */
	assert_int_equal(begin_upload(32.0f, "a", 1, &e), ERR_OK);
	assert_int_equal(begin_upload(32.0f, "b", 2, &e), ERR_OK);
	assert_false(volume_store_settle(server.volumes, e.id, "b"));
	assert_true(volume_store_settle(server.volumes, e.id, "b"));
	assert_int_equal(volumes_of("a"), 0);
	assert_int_equal(volumes_of("b"), 2);
	/* Deleted while the same is on its way, which is kept then. */
	assert_int_equal(begin_upload(32.0f, "a", 0, &e), ERR_OK);
	assert_int_equal(volume_store_delete(server.volumes, e.id), ERR_OK);
	assert_false(volume_store_settle(server.volumes, e.id, "a"));
	assert_int_equal(volumes_of("a"), 1);
	assert_int_equal(volumes_of("b"), 1);
}

/* What a backing tells meanwhile is older than what is kept then. */
static void test_volume_told_of_while_it_arrives(void **state)
{
	struct volume_entry e;
	struct backing_volume v = {.id = e.id, .is_forgotten = true,
	    .owner = "a"};
	struct volume *used;

	(void)state;
	assert_int_equal(upload(41.0f, "a", 1, true, &e), ERR_OK);
	used = volume_store_find(server.volumes, e.id);
	assert_int_equal(volume_store_delete(server.volumes, e.id), ERR_OK);
	for (int is_kept = 0; is_kept < 2; is_kept++) {
		assert_int_equal(begin_upload(41.0f, "b", 1, &e), ERR_OK);
		assert_int_equal(volume_store_load(server.volumes, &v),
		    ERR_OK);
		assert_int_equal(volumes_of("b"), 1); /* until then */
		volume_store_settle(server.volumes, e.id, is_kept ? "b" :
		    NULL);
		assert_int_equal(volumes_of("a"), !is_kept);
		assert_int_equal(volumes_of("b"), is_kept);
	}
	/* Another daemon has made it somebody's, and this one's fails. */
	assert_int_equal(volume_store_delete(server.volumes, e.id), ERR_OK);
	assert_int_equal(begin_upload(41.0f, "d", 1, &e), ERR_OK);
	v.owner = "c";
	assert_int_equal(volume_store_load(server.volumes, &v), ERR_OK);
	volume_store_settle(server.volumes, e.id, NULL);
	assert_int_equal(volumes_of("c"), 1);
	volume_release(used);
}

static void submit_volume(struct asked *a, enum scene_change_kind kind,
    const struct backing_volume *v)
{
	memset(&a->change, 0, sizeof a->change);
	atomic_store(&a->is_done, false);
	a->change.kind = kind;
	a->change.volume = v;
	a->change.done = on_done;
	a->change.ctx = a;
	assert_int_equal(scene_store_submit(server.scenes, &a->change),
	    ERR_OK);
}

/* In the order in which they are kept, and by what has been kept. */
static void test_writer_settles_volumes(void **state)
{
	struct asked held, first, second, gone, third;
	struct volume_entry e;
	struct backing_volume a = {.id = e.id, .owner = "a"},
	    b = {.id = e.id, .owner = "b"},
	    forgotten = {.id = e.id, .is_forgotten = true};

	(void)state;
	atomic_store(&fake.volume_failures, 1);
	hold_with(&held);
	assert_int_equal(begin_upload(51.0f, "a", 1, &e), ERR_OK);
	assert_int_equal(begin_upload(51.0f, "b", 1, &e), ERR_OK);
	assert_int_equal(begin_upload(51.0f, "a", 1, &e), ERR_OK);
	submit_volume(&first, VOLUME_KEEP, &a);
	submit_volume(&second, VOLUME_KEEP, &b);
	submit_volume(&gone, VOLUME_FORGET, &forgotten);
	submit_volume(&third, VOLUME_KEEP, &a);
	hold(false);
	assert_int_equal(await(&held), ERR_OK);
	assert_int_equal(await(&first), ERR_UNAVAILABLE);
	volume_store_settle(server.volumes, e.id, NULL);
	assert_int_equal(await(&second), ERR_OK);
	assert_false(second.change.replaced);
	assert_string_equal(second.change.owner, "b");
	assert_int_equal(await(&gone), ERR_OK);
	assert_int_equal(await(&third), ERR_OK);
	assert_false(third.change.replaced);
	assert_string_equal(third.change.owner, "a");
	assert_int_equal(volume_store_get(server.volumes, e.id, &e), ERR_OK);
	assert_string_equal(e.owner, "a");
	assert_int_equal(begin_upload(51.0f, "b", 0, &e), ERR_OK);
	submit_volume(&first, VOLUME_KEEP, &b);
	assert_int_equal(await(&first), ERR_OK);
	assert_true(first.change.replaced);
	assert_string_equal(first.change.owner, "a");
}

static bool has_volume(const char *id)
{
	struct volume *volume = volume_store_recall(server.volumes, id);

	if (volume != NULL)
		volume_release(volume);
	return volume != NULL;
}

static void await_gone(int count)
{
	for (int i = 0; i < 3000 && fake.gone < count; i++)
		usleep(10000); /* the writer looks once a second */
	assert_int_equal(fake.gone, count);
}

/* A scene without a program holds no volume: what its text names stays. */
static void test_volumes_of_a_scene_that_cannot_be_used_stay(void **state)
{
	char first[VOLUME_ID_DIGITS + 1], named[VOLUME_ID_DIGITS + 1],
	    other[VOLUME_ID_DIGITS + 1], text[64];
	struct faults faults = {0};

	(void)state;
	forget_one(1.0f, first);
	await_gone(1);
	stop();
	keep("c", "bad, and says it in another way: \\u0031");
	start();
	forget_one(2.0f, named);
	forget_one(3.0f, other);
	usleep(1200000);
	assert_true(has_volume(named) && has_volume(other));
	snprintf(text, sizeof text, "bad %s", named);
	stop();
	keep("c", text);
	start();
	await_gone(2);
	assert_true(has_volume(named) && !has_volume(other));
	atomic_store(&is_bad_good, true);
	assert_int_equal(scene_store_mend(server.scenes, "c", &faults),
	    ERR_OK);
	await_gone(3);
}

static void test_damaged_volume_is_refused(void **state)
{
	(void)state;
	stop();
	fake.has_damage = true;
	assert_int_equal(scene_store_create(&server, &server.scenes),
	    ERR_INVALID);
	fake.has_damage = false;
	start();
}

static void test_stopped_store_refuses(void **state)
{
	struct asked a = {0};

	(void)state;
	scene_store_stop(server.scenes);
	assert_int_equal(scene_store_submit(server.scenes, &a.change),
	    ERR_CANCELLED);
}

static void test_queue_is_bounded(void **state)
{
	static struct asked a[1025];
	struct asked held;

	(void)state;
	hold_with(&held);
	for (int i = 0; i < 1024; i++)
		submit(a + i, SCENE_DELETE, "none", NULL, NULL, NULL);
	assert_int_equal(scene_store_submit(server.scenes, &a[1024].change),
	    ERR_BUSY);
	hold(false);
	await(&held);
	for (int i = 0; i < 1024; i++)
		assert_int_equal(await(a + i), ERR_NOT_FOUND);
}

/* ---- several ---- */

static void tell(const char *id, const char *text, uint64_t seq)
{
	struct backing_revision r = {.id = id, .text = text, .owner = "",
	    .length = text != NULL ? strlen(text) : 0, .seq = {seq, 0},
	    .time = 1e9, .etag = "\"\""};

	fake.options.guard(fake.options.changed.ctx, true);
	assert_int_equal(fake.options.changed.revision(
	    fake.options.changed.ctx, &r), ERR_OK);
	fake.options.guard(fake.options.changed.ctx, false);
}

static void test_shared_conflict_is_tried_again(void **state)
{
	(void)state;
	put("a", "one");
	keep("a", "theirs");
	/* what is known here is old: it is not "unchanged" */
	assert_int_equal(put("a", "one"), ERR_OK);
	assert_string_equal(newest("a")->text, "one");
	fake.conflicts = 5;
	assert_int_equal(delete("a"), ERR_OK);
	assert_null(newest("a"));
	fake.conflicts = 1000;
	assert_int_equal(put("b", "one"), ERR_BUSY);
	assert_text("b", NULL);
}

static void test_shared_precondition_is_of_what_is_there(void **state)
{
	struct asked a;
	char tag[ETAG_SIZE];

	(void)state;
	put("a", "one");
	keep("a", "theirs");
	etag_of("theirs", 6, tag);
	submit(&a, SCENE_PUT, "a", "two", tag, NULL);
	assert_int_equal(await(&a), ERR_OK);
	keep("a", "theirs again");
	etag_of("two", 3, tag);
	submit(&a, SCENE_PUT, "a", "three", tag, NULL);
	assert_int_equal(await(&a), ERR_CONFLICT);
	assert_text("a", "theirs again");
	keep("n", "new");
	assert_int_equal(delete("n"), ERR_OK);
}

static void test_shared_patches_are_rebased(void **state)
{
	struct asked a;

	(void)state;
	put("a", "p");
	keep("a", "pq");
	submit_patch(&a, "p");
	assert_int_equal(await(&a), ERR_OK);
	assert_text("a", "pqx");
}

static void test_shared_changes_come_in_any_order(void **state)
{
	struct scene_event list[8];

	(void)state;
	put("a", "one");
	tell("a", "five", 5);
	assert_text("a", "five");
	tell("a", "four", 4); /* late: of the past */
	assert_text("a", "five");
	assert_int_equal(scene_store_history(server.scenes, "a", NULL, 8,
	    list), 3);
	assert_int_equal(list[1].seq.major, 4);
	tell("a", NULL, 7);
	assert_text("a", NULL);
	tell("a", "six", 6); /* was before its end */
	assert_text("a", NULL);
	tell("a", "eight", 8);
	assert_text("a", "eight");
	assert_int_equal(event_count, 4);
}

/* As Redis does: what is older first, then what is present. */
static void tell_past(const char *id, uint64_t seq, bool is_oldest)
{
	struct backing_revision r = {.id = id, .text = "", .owner = "",
	    .length = 4, .seq = {seq, 0}, .time = 1e9, .etag = "\"\"",
	    .is_past = true, .is_oldest = is_oldest};

	fake.options.guard(fake.options.changed.ctx, true);
	assert_int_equal(fake.options.changed.revision(
	    fake.options.changed.ctx, &r), ERR_OK);
	fake.options.guard(fake.options.changed.ctx, false);
}

static void assert_event(size_t at, uint64_t seq, bool has_missed)
{
	assert_int_equal(events[at].seq.major, seq);
	assert_int_equal(events[at].has_missed, has_missed);
}

static void test_shared_listeners_hear_all_or_that_some_are_missing(
    void **state)
{
	struct scene_event list[8];
	bool missed;

	(void)state;
	put("a", "one");
	/* 2, 3 were overtaken: they are told before 4 */
	tell_past("a", 1, true);
	tell_past("a", 2, false);
	tell_past("a", 3, false);
	tell("a", "four", 4);
	assert_event(1, 2, false);
	assert_event(2, 3, false);
	assert_event(3, 4, false);
	/* of what is kept, 7 is the oldest: 5, 6 are not known */
	tell_past("a", 7, true);
	tell("a", "eight", 8);
	assert_event(4, 7, true);
	assert_event(5, 8, false);
	assert_int_equal(scene_store_history(server.scenes, "a", NULL, 8,
	    list), 2);
	/* 9 was made elsewhere, and not told before this daemon's own 10 */
	fake.seq = 7;
	keep("a", "eight");
	keep("a", "nine");
	put("a", "ten");
	assert_event(6, 10, true);
	assert_int_equal(scene_store_since(server.scenes, "a",
	    (struct scene_seq){8, 0}, 8, list, &missed), 1);
	assert_true(list[0].has_missed);
	/* late, for the history: whoever resumes now has all */
	tell_past("a", 9, false);
	assert_int_equal(event_count, 7);
	tell("a", "ten", 10);
	assert_int_equal(scene_store_since(server.scenes, "a",
	    (struct scene_seq){8, 0}, 8, list, &missed), 2);
	assert_false(missed || list[0].has_missed || list[1].has_missed);
	assert_int_equal(event_count, 7);
}

static void test_shared_owner_is_who_made_it_elsewhere(void **state)
{
	struct faults faults = {0};
	struct asked a;

	(void)state;
	keep("a", "theirs");
	strcpy(fake.list[fake.count - 1].owner, "ann");
	memset(&a.change, 0, sizeof a.change);
	atomic_store(&a.is_done, false);
	a.change = (struct scene_change){.kind = SCENE_PUT, .id = "a",
	    .scenes_most = SIZE_MAX, .done = on_done, .ctx = &a};
	scene_build(&server, NULL, "a", "t", 1, &a.change.scene, &faults);
	strcpy(a.change.scene->owner, "bob");
	scene_store_submit(server.scenes, &a.change);
	assert_int_equal(await(&a), ERR_OK);
	assert_true(a.change.replaced);
	assert_int_equal(scene_store_count_of(server.scenes, "ann"), 1);
	assert_string_equal(newest("a")->owner, "ann");
}

/* Ids are times, in ms. Those of this minute may be another daemon's. */
static void test_shared_ids_of_the_future_are_not_believed(void **state)
{
	const uint64_t now = 1000 * (uint64_t)time(NULL);
	struct scene_event list[8];
	bool missed;

	(void)state;
	put("a", "one");
	scene_store_since(server.scenes, "a", (struct scene_seq){now, 0}, 8,
	    list, &missed);
	assert_false(missed);
	assert_int_equal(scene_store_since(server.scenes, "a",
	    (struct scene_seq){now + 3600000, 0}, 8, list, &missed), 1);
	assert_true(missed);
	scene_store_since(server.scenes, "a",
	    (struct scene_seq){now - 3600000, 0}, 8, list, &missed);
	assert_true(missed);
}

/* The older state that a restored store has is told though its seq is lower. */
static void test_rollback_is_told(void **state)
{
	struct scene_event list[8];
	bool missed;

	(void)state;
	put("a", "one");
	put("a", "two");
	fake.list[1].is_dead = true;
	fake.options.lost(fake.options.changed.ctx);
	for (int i = 0; i < 3000 && event_count < 3; i++)
		usleep(10000);
	assert_text("a", "one");
	assert_event(2, 1, true);
	assert_true(events[2].is_anew);
	scene_store_since(server.scenes, "a", (struct scene_seq){2, 0}, 8,
	    list, &missed);
	assert_true(missed);
}

static void test_shared_store_is_read_when_it_comes(void **state)
{
	(void)state;
	stop();
	keep("a", "theirs");
	fake.away = 1;
	start();
	assert_false(scene_store_is_ready(server.scenes));
	assert_int_equal(put("b", "one"), ERR_UNAVAILABLE);
	fake.away = 0;
	for (int i = 0; i < 3000 && !scene_store_is_ready(server.scenes); i++)
		usleep(10000);
	assert_true(scene_store_is_ready(server.scenes));
	assert_text("a", "theirs");
	assert_int_equal(put("b", "one"), ERR_OK);
	/* a hole: what others did meanwhile is found, and told */
	atomic_store(&event_count, 0);
	keep("a", "changed");
	keep("b", NULL);
	fake.options.lost(fake.options.changed.ctx);
	for (int i = 0; i < 3000 && event_count < 2; i++)
		usleep(10000);
	assert_text("a", "changed");
	assert_text("b", NULL);
	assert_int_equal(event_count, 2);
}

#define CASE(f) cmocka_unit_test_setup_teardown(f, setup, teardown)
#define SHARED(f) cmocka_unit_test_setup_teardown(f, setup_shared, teardown)

int main(void)
{
	const struct CMUnitTest tests[] = {
		CASE(test_volumes_count_as_their_owners),
		CASE(test_forgotten_volumes_count_while_they_are_used),
		CASE(test_volume_is_whose_upload_was_kept),
		CASE(test_volume_told_of_while_it_arrives),
		CASE(test_writer_settles_volumes),
		CASE(test_put_is_kept_seen_and_told),
		CASE(test_same_bytes_write_nothing),
		CASE(test_preconditions_are_of_what_is_there),
		CASE(test_what_waits_together_is_committed_together),
		CASE(test_later_changes_of_a_group_see_earlier_ones),
		CASE(test_commit_that_fails_has_never_been),
		CASE(test_memory_is_what_is_kept_when_commits_fail),
		CASE(test_patches_of_one_base_are_all_there),
		CASE(test_a_patch_that_is_waited_for_is_rebased),
		CASE(test_history_is_trimmed),
		CASE(test_history_bytes_exactly_at_and_around_the_bound),
		CASE(test_history_bytes_one_revision_beyond_them),
		CASE(test_history_bytes_are_each_scenes_own),
		CASE(test_history_bytes_lowered_hold_from_the_start),
		CASE(test_read_delays_no_change),
		CASE(test_reads_do_not_wait_for_a_commit),
		CASE(test_too_many_reads_are_refused),
		CASE(test_stopping_cancels_reads_that_wait),
		CASE(test_owner_stays_and_is_counted),
		CASE(test_restart_reads_what_is_kept),
		CASE(test_volumes_of_a_scene_that_cannot_be_used_stay),
		CASE(test_damaged_volume_is_refused),
		CASE(test_stopped_store_refuses),
		CASE(test_queue_is_bounded),
		SHARED(test_shared_conflict_is_tried_again),
		SHARED(test_shared_precondition_is_of_what_is_there),
		SHARED(test_shared_patches_are_rebased),
		SHARED(test_shared_changes_come_in_any_order),
		SHARED(test_shared_listeners_hear_all_or_that_some_are_missing),
		SHARED(test_shared_owner_is_who_made_it_elsewhere),
		SHARED(test_shared_ids_of_the_future_are_not_believed),
		SHARED(test_shared_store_is_read_when_it_comes),
		CASE(test_rollback_is_told),
	};

	return cmocka_run_group_tests(tests, NULL, NULL);
}
