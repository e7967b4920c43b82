/*
 * The scheduler before a device that is played here: what goes in one launch,
 * in which order, and that each job is completed once, with its own rows.
 *
 * The device takes fake.pace seconds a point, 5e-6 at first: 4096 points, the
 * least a job is cut into, are 20 ms, so that all pieces of programs that are
 * known to have that pace have that many. It can be held in a launch.
 */
#include <stdarg.h>
#include <stddef.h>
#include <limits.h>
#include <setjmp.h>
#include <stdint.h>
#include <cmocka.h>

#include <pthread.h>
#include <stdatomic.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <unistd.h>

#include "core/opcode.h"
#include "core/output.h"
#include "core/tape.h"
#include "server/clock.h"
#include "server/log.h"
#include "server/program.h"
#include "server/scheduler.h"
#include "tests/support/fail_alloc.h"
#include "tests/support/load.h"
#include "tests/support/random_tree.h"

#define PIECE 4096
#define PACE 5e-6
#define LAUNCHES_MAX 20000

/* ---- the device ---- */

struct device {
	int tapes, tables; /* loaded into it */
};

struct device_tape {
	struct device *device;
	float mark; /* of the tape, and of its first table's slot */
};

struct launch {
	int job; /* that its first point names */
	size_t parts, points;
};

static struct {
	pthread_mutex_t lock;
	pthread_cond_t changed;
	bool held;
	bool inside;      /* a launch waits to be let go */
	bool may_pass;    /* that one may */
	double pace;
	enum err failure; /* of every launch */
	struct launch launches[LAUNCHES_MAX];
	size_t count;
	int slots;        /* given so far */
	atomic_int tables;
	int most;         /* tables there may be */
	atomic_int opens, rebuilt;
	enum err reopen_failure;
	atomic_int reopen_failures; /* of so many attempts to come */
	/* enum err, of the next one: */
	atomic_int tape_failure, table_failure, launch_failure;
	atomic_int every; /* of so many launches one loses the device; 0 */
	atomic_int launched;
} fake = {.lock = PTHREAD_MUTEX_INITIALIZER,
    .changed = PTHREAD_COND_INITIALIZER};

enum err device_open(const struct device_options *options, struct device **out,
    struct device_failure *failure)
{
	(void)options;
	(void)failure;
	fake.opens++;
	if (fake.reopen_failures > 0) {
		fake.reopen_failures--;
		return fake.reopen_failure;
	}
	*out = calloc(1, sizeof **out);
	return ERR_OK;
}

/* What is to fail the next time; it will no more. */
static enum err take_failure(atomic_int *failure)
{
	return (enum err)atomic_exchange(failure, ERR_OK);
}

static enum err launch_result(void)
{
	enum err err = take_failure(&fake.launch_failure);

	fake.launched++;
	if (fake.every > 0 && fake.launched % fake.every == 0)
		return ERR_DEVICE;
	return err != ERR_OK ? err : fake.failure;
}

void device_failure_fini(struct device_failure *failure)
{
	(void)failure;
}

/* Tables go with it, tapes do not. */
void device_close(struct device *d)
{
	assert_true(d == NULL || d->tapes == 0);
	if (d != NULL)
		fake.tables -= d->tables;
	free(d);
}

const struct device_info *device_get_info(const struct device *d)
{
	static const struct device_info info = {.name = "fake"};

	(void)d;
	return &info;
}

const struct device_times *device_get_times(const struct device *d)
{
	static const struct device_times times = {1e-6, 1e-3, 1e-6};

	(void)d;
	return &times;
}

const char *device_message(const struct device *d)
{
	(void)d;
	return "as told";
}

size_t device_table_bytes(const struct device *d, size_t *most)
{
	(void)d;
	*most = (size_t)1 << 30;
	return 0;
}

enum err device_load_table(struct device *d, const struct table *table,
    int *slot)
{
	enum err err = take_failure(&fake.table_failure);

	(void)table;
	if (err != ERR_OK)
		return err;
	if (fake.tables == fake.most)
		return ERR_DEVICE_MEMORY;
	fake.tables++;
	d->tables++;
	*slot = ++fake.slots;
	return ERR_OK;
}

void device_drop_table(struct device *d, int slot)
{
	(void)slot;
	fake.tables--;
	d->tables--;
}

enum err device_load_tape(struct device *d, const struct tape *tape,
    const int *slots, struct device_tape **out)
{
	enum err err = take_failure(&fake.tape_failure);

	if (err != ERR_OK)
		return err;
	*out = malloc(sizeof **out);
	if (*out == NULL)
		return ERR_MEMORY;
	(*out)->device = d;
	d->tapes++;
	(*out)->mark = (float)tape->node_count;
	if (tape->operator_count > 0)
		(*out)->mark += 1000.0f * (float)slots[0];
	return ERR_OK;
}

void device_drop_tape(struct device *d, struct device_tape *t)
{
	assert_ptr_equal(t->device, d);
	d->tapes--;
	free(t);
}

size_t device_tape_bytes(const struct device_tape *t)
{
	return sizeof(*t);
}

static void note(const float *points, size_t parts, size_t count)
{
	pthread_mutex_lock(&fake.lock);
	if (fake.count < LAUNCHES_MAX)
		fake.launches[fake.count++] = (struct launch){
			count > 0 ? (int)points[0] : -1, parts, count};
	pthread_mutex_unlock(&fake.lock);
}

/* Waits while held, asking go_on as a device does now and then. */
static bool pass(bool (*go_on)(void *ctx), void *ctx)
{
	bool held = true;

	while (held) {
		if (go_on != NULL && !go_on(ctx))
			return false;
		pthread_mutex_lock(&fake.lock);
		held = fake.inside = fake.held && !fake.may_pass;
		fake.may_pass = false;
		pthread_cond_broadcast(&fake.changed);
		pthread_mutex_unlock(&fake.lock);
		if (held)
			usleep(500);
	}
	return true;
}

static float row_value(const float *point, float mark, int column)
{
	return point[0] + 3.0f * point[1] + 7.0f * mark + (float)column;
}

static void fill(const struct device_tape *t, const float *points,
    size_t count, unsigned outputs, float *rows)
{
	int columns = output_row_floats(outputs);

	for (size_t i = 0; i < count; i++) {
		for (int k = 0; k < columns; k++)
			*rows++ = row_value(points + 3 * i, t->mark, k);
	}
}

enum err device_evaluate(struct device *d, struct device_tape *t,
    const float *points, size_t count, unsigned outputs, float *rows,
    bool (*go_on)(void *ctx), void *ctx)
{
	assert_ptr_equal(t->device, d);
	note(points, 1, count);
	if (!pass(go_on, ctx))
		return ERR_CANCELLED;
	if (fake.pace > 0.0)
		usleep((useconds_t)(1e6 * fake.pace * (double)count));
	fill(t, points, count, outputs, rows);
	return launch_result();
}

enum err device_evaluate_parts(struct device *d, struct device_tape *t,
    const struct device_part *parts, size_t part_count, unsigned outputs)
{
	size_t count = 0;

	assert_ptr_equal(t->device, d);
	for (size_t i = 0; i < part_count; i++)
		count += parts[i].count;
	assert_true(count <= DEVICE_PARTS_POINTS);
	note(parts[0].points, part_count, count);
	pass(NULL, NULL);
	if (fake.pace > 0.0)
		usleep((useconds_t)(1e6 * fake.pace * (double)count));
	for (size_t i = 0; i < part_count; i++)
		fill(t, parts[i].points, parts[i].count, outputs,
		    parts[i].rows);
	return launch_result();
}

static void hold(void)
{
	pthread_mutex_lock(&fake.lock);
	fake.held = true;
	pthread_mutex_unlock(&fake.lock);
}

static void await_inside(void)
{
	pthread_mutex_lock(&fake.lock);
	while (!fake.inside)
		pthread_cond_wait(&fake.changed, &fake.lock);
	pthread_mutex_unlock(&fake.lock);
}

static void let_go(void)
{
	pthread_mutex_lock(&fake.lock);
	fake.held = false;
	fake.inside = false;
	pthread_mutex_unlock(&fake.lock);
}

/* Lets the launch that is held go, and holds the next one. */
static void let_one_go(void)
{
	size_t count;
	bool came = false;

	pthread_mutex_lock(&fake.lock);
	fake.may_pass = true;
	count = fake.count;
	pthread_mutex_unlock(&fake.lock);
	for (; !came; usleep(100)) {
		pthread_mutex_lock(&fake.lock);
		came = fake.count > count && fake.inside;
		pthread_mutex_unlock(&fake.lock);
	}
}

/* ---- the daemon's part ---- */

struct bed {
	struct tables *tables;
	struct scheduler *s;
	struct program *programs[8];
};

/* A job and its client. */
struct client {
	struct job job;
	struct bed *bed;
	int id;
	atomic_bool gone, is_full;
	atomic_int parked, done;
	float *rows;       /* of pieces */
	size_t got;        /* rows of them */
	size_t pieces;
	size_t room;       /* pieces before is_full; 0: any number */
	long fail;         /* the allocation to fail after being asked for */
};

static void on_ready(void *ctx)
{
	(void)ctx;
}

static void on_rebuilt(void *ctx)
{
	(void)ctx;
	fake.rebuilt++;
}

static void on_changed(void *ctx)
{
	struct bed *bed = ctx;

	scheduler_tables_changed(bed->s);
}

/* A tape that is nothing but its length. */
static struct tape *make_tape(size_t number, size_t insns)
{
	struct tape *tape = calloc(1, sizeof *tape);

	tape->insns = calloc(insns, sizeof *tape->insns);
	tape->insn_count = insns;
	tape->node_count = number;
	return tape;
}

static void teach_pace(struct program *program)
{
	size_t orders = sizeof program->pace / sizeof *program->pace;

	for (size_t i = 0; i < orders; i++)
		pace_learn(&program->pace[i], PIECE, PACE * PIECE, false);
}

static void set_up(struct bed *bed, size_t queue)
{
	struct scheduler_options options = {.queue = queue, .ready = on_ready,
	    .failed = on_ready, .rebuilt = on_rebuilt, .patience = 1.0,
	    .hang = 0.2};

	*bed = (struct bed){0};
	fake.held = fake.inside = fake.may_pass = false;
	fake.pace = PACE;
	fake.failure = ERR_OK;
	fake.opens = fake.rebuilt = fake.reopen_failures = 0;
	fake.tape_failure = fake.table_failure = fake.launch_failure = ERR_OK;
	fake.every = fake.launched = 0;
	fake.count = 0;
	fake.tables = 0;
	fake.most = 100;
	assert_int_equal(tables_create(LAYOUT_WARPED, &bed->tables), ERR_OK);
	options.tables = bed->tables;
	assert_int_equal(scheduler_create(&options, &bed->s), ERR_OK);
	for (size_t i = 0; i < 8; i++) {
		assert_int_equal(program_create(bed->tables,
		    make_tape(i + 1, 1), 1, &bed->programs[i]), ERR_OK);
		teach_pace(bed->programs[i]);
	}
}

static void tear_down(struct bed *bed)
{
	for (size_t i = 0; i < 8; i++)
		scheduler_release(bed->s, bed->programs[i]);
	scheduler_stop(bed->s);
	tables_stop(bed->tables);
	tables_free(bed->tables);
	scheduler_free(bed->s);
}

static void park(void *ctx)
{
	struct client *c = ctx;

	atomic_fetch_add(&c->parked, 1);
}

static void done(void *ctx)
{
	struct client *c = ctx;

	/* It may be gone at once. */
	atomic_fetch_add(&c->done, 1);
}

static bool wanted(void *ctx)
{
	struct client *c = ctx;

	if (c->fail > 0)
		fail_alloc_set(c->fail);
	return !atomic_load(&c->gone);
}

static void piece(void *ctx, float *rows, size_t first, size_t count)
{
	struct client *c = ctx;
	size_t columns = (size_t)output_row_floats(c->job.outputs);

	assert_int_equal(first, c->got);
	assert_true(count > 0 && first + count <= c->job.count);
	assert_true(count * columns * sizeof(float) <= SCHEDULER_PIECE_BYTES);
	memcpy(c->rows + first * columns, rows,
	    count * columns * sizeof(float));
	free(rows);
	c->got += count;
	c->pieces++;
	if (c->room > 0 && c->pieces % c->room == 0)
		atomic_store(&c->is_full, true);
}

static bool has_room(void *ctx)
{
	struct client *c = ctx;

	return !atomic_load(&c->is_full);
}

static void prepare(struct bed *bed, struct client *c, int id, int program,
    size_t count, enum job_priority priority)
{
	float *points = calloc(3 * count + 1, sizeof *points);

	for (size_t i = 0; i < count; i++) {
		points[3 * i] = (float)id;
		points[3 * i + 1] = (float)i;
	}
	*c = (struct client){.bed = bed, .id = id};
	c->job = (struct job){
		.program = program_hold(bed->programs[program]),
		.points = points,
		.count = count,
		.outputs = OUTPUT_VALUE | OUTPUT_GRADIENT,
		.priority = priority,
		.park = park,
		.done = done,
		.wanted = wanted,
		.ctx = c,
	};
}

/* Has the rows come in pieces. */
static void prepare_pieces(struct client *c)
{
	c->rows = calloc(c->job.count * 4 + 1, sizeof *c->rows);
	c->job.piece = piece;
	c->job.has_room = has_room;
}

static void submit(struct client *c)
{
	assert_int_equal(scheduler_submit(c->bed->s, &c->job), ERR_OK);
	assert_int_equal(atomic_load(&c->parked), 1);
}

static void start(struct bed *bed, struct client *c, int id, int program,
    size_t count, enum job_priority priority)
{
	prepare(bed, c, id, program, count, priority);
	submit(c);
}

static void await(struct client *c)
{
	while (atomic_load(&c->done) == 0)
		usleep(200);
}

/* Also that it was completed once. */
static void release(struct client *c)
{
	assert_int_equal(atomic_load(&c->done), 1);
	scheduler_return(c->bed->s, &c->job);
	scheduler_release(c->bed->s, c->job.program);
	free((void *)(uintptr_t)c->job.points);
	free(c->job.rows);
	free(c->rows);
}

static bool rows_are_right(const struct client *c, float mark)
{
	const float *rows = c->job.piece != NULL ? c->rows : c->job.rows;
	int columns = output_row_floats(c->job.outputs);

	for (size_t i = 0; i < c->job.count; i++) {
		for (int k = 0; k < columns; k++) {
			if (*rows++ != row_value(c->job.points + 3 * i, mark,
			    k))
				return false;
		}
	}
	return c->job.piece == NULL || c->got == c->job.count;
}

static void finish(struct client *c, enum err err, int program)
{
	await(c);
	assert_int_equal(c->job.result, err);
	if (err == ERR_OK)
		assert_true(rows_are_right(c, (float)(program + 1)));
	else
		assert_null(c->job.rows);
	release(c);
}

static struct scheduler_stats stats_of(struct bed *bed)
{
	struct scheduler_stats stats;

	scheduler_get_stats(bed->s, &stats);
	return stats;
}

/* Once all is done: the queue is empty, and all has been counted. */
static void await_idle(struct bed *bed, unsigned long completed)
{
	struct scheduler_stats stats;

	while (!scheduler_is_idle(bed->s))
		usleep(200);
	stats = stats_of(bed);
	assert_int_equal(stats.completed, completed);
	assert_int_equal(stats.stalled, 0);
	assert_int_equal(stats.held_bytes, 0);
}

/* A small job of program 7 that is in its launch, held there. */
static void plug(struct bed *bed, struct client *c)
{
	hold();
	start(bed, c, 0, 7, 100, JOB_INTERACTIVE);
	await_inside();
}

static void assert_launch(size_t i, int job, size_t parts, size_t points)
{
	assert_true(i < fake.count);
	assert_int_equal(fake.launches[i].job, job);
	assert_int_equal(fake.launches[i].parts, parts);
	assert_int_equal(fake.launches[i].points, points);
}

/* ---- one launch for several ---- */

static void test_jobs_that_wait_together_go_in_one_launch(void **state)
{
	struct client first, c[20];
	struct bed bed;

	(void)state;
	set_up(&bed, 100);
	plug(&bed, &first);
	for (int i = 0; i < 20; i++)
		start(&bed, &c[i], i + 1, 0, (size_t)(50 + i),
		    JOB_INTERACTIVE);
	let_go();
	finish(&first, ERR_OK, 7);
	for (int i = 0; i < 20; i++) {
		await(&c[i]);
		assert_true(c[i].job.seconds > 0.0);
		finish(&c[i], ERR_OK, 0);
	}
	await_idle(&bed, 21);
	assert_int_equal(fake.count, 2);
	assert_launch(1, 1, 20, 20 * 50 + 190);
	assert_int_equal(stats_of(&bed).launches, 2);
	assert_int_equal(stats_of(&bed).batched, 20);
	assert_int_equal(stats_of(&bed).points, 100 + 20 * 50 + 190);
	tear_down(&bed);
}

static void test_a_launch_takes_no_longer_than_a_piece(void **state)
{
	struct client first, c[8];
	struct bed bed;

	(void)state;
	set_up(&bed, 100);
	plug(&bed, &first);
	for (int i = 0; i < 8; i++)
		start(&bed, &c[i], i + 1, 0, 1024, JOB_INTERACTIVE);
	let_go();
	finish(&first, ERR_OK, 7);
	for (int i = 0; i < 8; i++)
		finish(&c[i], ERR_OK, 0);
	assert_launch(1, 1, 4, 4096);
	assert_launch(2, 5, 4, 4096);
	tear_down(&bed);
}

static void test_other_outputs_and_bulk_jobs_go_by_themselves(void **state)
{
	struct client first, c[4];
	struct bed bed;

	(void)state;
	set_up(&bed, 100);
	plug(&bed, &first);
	for (int i = 0; i < 4; i++) {
		prepare(&bed, &c[i], i + 1, 0, 100,
		    i == 3 ? JOB_BULK : JOB_INTERACTIVE);
		c[i].job.outputs = i == 1 ? OUTPUT_VALUE : OUTPUT_HESSIAN;
		submit(&c[i]);
	}
	let_go();
	finish(&first, ERR_OK, 7);
	for (int i = 0; i < 4; i++)
		finish(&c[i], ERR_OK, 0);
	assert_int_equal(fake.count, 4);
	assert_launch(1, 1, 2, 200);
	assert_launch(2, 2, 1, 100);
	assert_launch(3, 4, 1, 100);
	tear_down(&bed);
}

static void test_an_empty_batch_is_completed(void **state)
{
	struct client first, c[3];
	struct bed bed;

	(void)state;
	set_up(&bed, 100);
	plug(&bed, &first);
	for (int i = 0; i < 3; i++) {
		prepare(&bed, &c[i], i + 1, 0, i == 1 ? 10 : 0,
		    JOB_INTERACTIVE);
		if (i == 2)
			prepare_pieces(&c[i]);
		submit(&c[i]);
	}
	let_go();
	finish(&first, ERR_OK, 7);
	for (int i = 0; i < 3; i++)
		finish(&c[i], ERR_OK, 0);
	tear_down(&bed);
}

/* ---- turns ---- */

static void test_programs_take_turns(void **state)
{
	struct client first, flood[40], other[2];
	struct bed bed;

	(void)state;
	set_up(&bed, 100);
	plug(&bed, &first);
	for (int i = 0; i < 40; i++)
		start(&bed, &flood[i], i + 1, 0, 1024, JOB_INTERACTIVE);
	start(&bed, &other[0], 100, 1, 10, JOB_INTERACTIVE);
	start(&bed, &other[1], 200, 2, 10, JOB_INTERACTIVE);
	let_go();
	finish(&first, ERR_OK, 7);
	for (int i = 0; i < 40; i++)
		finish(&flood[i], ERR_OK, 0);
	finish(&other[0], ERR_OK, 1);
	finish(&other[1], ERR_OK, 2);
	assert_launch(1, 1, 4, 4096);
	assert_launch(2, 100, 1, 10);
	assert_launch(3, 200, 1, 10);
	assert_launch(4, 5, 4, 4096);
	tear_down(&bed);
}

static void test_small_jobs_pass_between_the_pieces_of_a_large_one(
    void **state)
{
	struct client bulk, small;
	struct bed bed;

	(void)state;
	set_up(&bed, 100);
	hold();
	start(&bed, &bulk, 1, 0, 5 * PIECE, JOB_BULK);
	await_inside();
	let_one_go();
	assert_int_equal(stats_of(&bed).running, 1);
	assert_int_equal(stats_of(&bed).waiting, 0);
	start(&bed, &small, 2, 1, 10, JOB_INTERACTIVE);
	let_go();
	finish(&small, ERR_OK, 1);
	assert_int_equal(atomic_load(&bulk.done), 0);
	finish(&bulk, ERR_OK, 0);
	for (size_t i = 0; i < 6; i++)
		assert_launch(i, i == 2 ? 2 : 1, 1, i == 2 ? 10 : PIECE);
	assert_int_equal(fake.count, 6);
	tear_down(&bed);
}

static void test_large_interactive_jobs_are_cut_too(void **state)
{
	struct client first, large, small;
	struct bed bed;

	(void)state;
	set_up(&bed, 100);
	plug(&bed, &first);
	start(&bed, &large, 1, 0, 2 * PIECE + PIECE / 16, JOB_INTERACTIVE);
	start(&bed, &small, 2, 0, 10, JOB_INTERACTIVE);
	let_go();
	finish(&first, ERR_OK, 7);
	finish(&large, ERR_OK, 0);
	finish(&small, ERR_OK, 0);
	assert_launch(1, 1, 1, PIECE);
	assert_launch(2, 2, 1, 10);
	assert_launch(3, 1, 1, PIECE + PIECE / 16);
	tear_down(&bed);
}

static void test_bulk_jobs_take_turns(void **state)
{
	struct client c[3];
	struct bed bed;

	(void)state;
	set_up(&bed, 100);
	hold();
	start(&bed, &c[0], 0, 0, 3 * PIECE, JOB_BULK);
	await_inside();
	start(&bed, &c[1], 1, 0, 3 * PIECE, JOB_BULK);
	start(&bed, &c[2], 2, 1, 3 * PIECE, JOB_BULK);
	let_go();
	for (int i = 0; i < 3; i++)
		finish(&c[i], ERR_OK, i == 2);
	assert_int_equal(fake.count, 9);
	assert_launch(0, 0, 1, PIECE);
	/* The others lay in the queue before the first came back to it. */
	for (size_t i = 0; i < 8; i++)
		assert_launch(i + 1, (int)((i + 1) % 3), 1, PIECE);
	tear_down(&bed);
}

static void test_bulk_jobs_have_their_share_while_others_keep_coming(
    void **state)
{
	enum { COUNT = 40 };
	static struct client c[COUNT];
	struct client first, bulk;
	size_t last = 0, pieces = 0;
	struct bed bed;

	(void)state;
	set_up(&bed, COUNT + 2);
	plug(&bed, &first);
	start(&bed, &bulk, COUNT, 0, COUNT * PIECE, JOB_BULK);
	for (int i = 0; i < COUNT; i++)
		start(&bed, &c[i], i + 1000, 1 + i % 5, PIECE,
		    JOB_INTERACTIVE);
	let_go();
	finish(&first, ERR_OK, 7);
	for (int i = 0; i < COUNT; i++)
		finish(&c[i], ERR_OK, 1 + i % 5);
	pthread_mutex_lock(&fake.lock);
	for (size_t i = 0; i < fake.count; i++) {
		if (fake.launches[i].job >= 1000)
			last = i;
	}
	for (size_t i = 0; i < last; i++)
		pieces += fake.launches[i].job == COUNT;
	pthread_mutex_unlock(&fake.lock);
	/* One for four others, 9, by the times that are measured, which a busy
	 * machine stretches. */
	assert_in_range(pieces, COUNT / 8, COUNT / 2);
	assert_true(stats_of(&bed).seconds[JOB_BULK] > 0.0);
	atomic_store(&bulk.gone, true);
	finish(&bulk, ERR_CANCELLED, 0);
	tear_down(&bed);
}

/* ---- deadlines ---- */

static void test_a_deadline_is_kept_while_the_device_is_busy(void **state)
{
	struct client first, late, later;
	struct bed bed;

	(void)state;
	set_up(&bed, 100);
	plug(&bed, &first);
	prepare(&bed, &late, 1, 0, 10, JOB_INTERACTIVE);
	late.job.deadline = clock_seconds() + 0.01;
	submit(&late);
	prepare(&bed, &later, 2, 0, 10, JOB_INTERACTIVE);
	later.job.deadline = clock_seconds() + 1000.0;
	submit(&later);
	finish(&late, ERR_DEADLINE, 0);
	assert_int_equal(atomic_load(&first.done), 0);
	let_go();
	finish(&first, ERR_OK, 7);
	finish(&later, ERR_OK, 0);
	assert_int_equal(stats_of(&bed).expired, 1);
	tear_down(&bed);
}

static void test_a_deadline_is_kept_between_pieces(void **state)
{
	struct client c;
	struct bed bed;

	(void)state;
	set_up(&bed, 100);
	prepare(&bed, &c, 1, 0, 1000 * PIECE, JOB_BULK);
	prepare_pieces(&c);
	c.job.deadline = clock_seconds() + 0.05;
	submit(&c);
	await(&c);
	assert_true(c.got > 0 && c.got < c.job.count);
	finish(&c, ERR_DEADLINE, 0);
	tear_down(&bed);
}

/* However long it waits: only the device's time counts. */
static void test_what_takes_too_long_ends_between_pieces(void **state)
{
	struct client c, other;
	struct bed bed;

	(void)state;
	set_up(&bed, 100);
	prepare(&bed, &c, 1, 0, 1000 * PIECE, JOB_BULK);
	prepare_pieces(&c);
	c.job.seconds_most = 0.05;
	prepare(&bed, &other, 2, 0, 10 * PIECE, JOB_BULK);
	other.job.seconds_most = 1000.0;
	submit(&c);
	submit(&other);
	await(&c);
	assert_true(c.got > 0 && c.got < c.job.count);
	assert_true(c.job.seconds >= 0.05);
	finish(&c, ERR_OVERTIME, 0);
	finish(&other, ERR_OK, 0);
	assert_int_equal(stats_of(&bed).held_bytes, 0);
	tear_down(&bed);
}

/* A program whose table, a small one or one that has a draft, nobody builds
 * until tables_start: its jobs wait. */
static struct program *make_waiting_program(struct bed *bed, double k,
    bool draft)
{
	struct tape *tape = make_tape(1, 1);
	struct program *program;

	tape->operators = calloc(1, sizeof *tape->operators);
	tape->operators[0] = (struct operator){.family = FAMILY_UNION,
	    .profile = profile_bulge(k), .layout = LAYOUT_WARPED,
	    .resolution = TABLES_DRAFT_RESOLUTION + (draft ? 8 : 0),
	    .draft = draft};
	tape->operator_count = 1;
	assert_int_equal(program_create(bed->tables, tape, (size_t)1 << 30,
	    &program), ERR_OK);
	teach_pace(program);
	return program;
}

static void replace_program(struct bed *bed, bool draft)
{
	scheduler_release(bed->s, bed->programs[0]);
	bed->programs[0] = make_waiting_program(bed, 0.35, draft);
}

static void test_a_deadline_is_kept_while_tables_are_awaited(void **state)
{
	struct client c;
	struct bed bed;

	(void)state;
	set_up(&bed, 100);
	replace_program(&bed, false);
	prepare(&bed, &c, 1, 0, 10, JOB_INTERACTIVE);
	c.job.deadline = clock_seconds() + 0.02;
	submit(&c);
	finish(&c, ERR_DEADLINE, 0);
	assert_int_equal(fake.count, 0);
	tear_down(&bed);
}

/* ---- clients that hang up ---- */

static void test_who_hangs_up_is_dropped_before_the_launch(void **state)
{
	struct client first, c[3], waiting;
	struct bed bed;

	(void)state;
	set_up(&bed, 100);
	replace_program(&bed, false);
	plug(&bed, &first);
	for (int i = 0; i < 3; i++)
		start(&bed, &c[i], i + 1, 1, 10, JOB_INTERACTIVE);
	start(&bed, &waiting, 9, 0, 10, JOB_INTERACTIVE);
	atomic_store(&c[1].gone, true);
	atomic_store(&waiting.gone, true);
	let_go();
	finish(&first, ERR_OK, 7);
	finish(&c[0], ERR_OK, 1);
	finish(&c[1], ERR_CANCELLED, 1);
	finish(&c[2], ERR_OK, 1);
	finish(&waiting, ERR_CANCELLED, 0);
	assert_launch(1, 1, 2, 20);
	assert_int_equal(stats_of(&bed).abandoned, 2);
	tear_down(&bed);
}

static void test_who_hangs_up_is_dropped_while_the_device_is_busy(
    void **state)
{
	enum { COUNT = 300 };
	static struct client c[COUNT];
	struct client first;
	struct bed bed;

	(void)state;
	set_up(&bed, COUNT + 1);
	plug(&bed, &first);
	for (int i = 0; i < COUNT; i++)
		start(&bed, &c[i], i + 1, i % 3, 10, JOB_INTERACTIVE);
	for (int i = 0; i < COUNT; i += 2)
		atomic_store(&c[i].gone, true);
	for (int i = 0; i < COUNT; i += 2)
		finish(&c[i], ERR_CANCELLED, 0);
	assert_int_equal(atomic_load(&first.done), 0);
	let_go();
	for (int i = 1; i < COUNT; i += 2)
		finish(&c[i], ERR_OK, i % 3);
	finish(&first, ERR_OK, 7);
	tear_down(&bed);
}

static void test_who_hangs_up_is_dropped_between_pieces(void **state)
{
	struct client bulk, small;
	struct bed bed;

	(void)state;
	set_up(&bed, 100);
	hold();
	start(&bed, &bulk, 1, 0, 5 * PIECE, JOB_BULK);
	await_inside();
	start(&bed, &small, 2, 1, 10, JOB_INTERACTIVE);
	let_one_go();
	atomic_store(&bulk.gone, true);
	let_go();
	finish(&bulk, ERR_CANCELLED, 0);
	finish(&small, ERR_OK, 1);
	assert_int_equal(fake.count, 2);
	tear_down(&bed);
}

static void test_who_hangs_up_is_dropped_in_a_launch(void **state)
{
	struct client c;
	struct bed bed;

	(void)state;
	set_up(&bed, 100);
	hold();
	start(&bed, &c, 1, 0, 100, JOB_INTERACTIVE);
	await_inside();
	atomic_store(&c.gone, true);
	finish(&c, ERR_CANCELLED, 0);
	let_go();
	tear_down(&bed);
}

/* ---- pieces and room for them ---- */

static void test_a_slow_client_does_not_hold_the_device(void **state)
{
	struct client slow, other;
	struct bed bed;

	(void)state;
	set_up(&bed, 100);
	prepare(&bed, &slow, 1, 0, 6 * PIECE, JOB_BULK);
	prepare_pieces(&slow);
	slow.room = 2;
	submit(&slow);
	while (!atomic_load(&slow.is_full))
		usleep(200);
	start(&bed, &other, 2, 1, 3 * PIECE, JOB_BULK);
	finish(&other, ERR_OK, 1);
	assert_int_equal(atomic_load(&slow.done), 0);
	assert_int_equal(slow.got, 2 * PIECE);
	for (int i = 0; i < 2; i++) {
		while (!atomic_load(&slow.is_full))
			usleep(200);
		atomic_store(&slow.is_full, false);
		scheduler_continue(bed.s);
	}
	finish(&slow, ERR_OK, 0);
	tear_down(&bed);
}

static void test_a_stalled_job_is_looked_after(void **state)
{
	struct client c[3];
	struct bed bed;

	(void)state;
	set_up(&bed, 100);
	for (int i = 0; i < 3; i++) {
		prepare(&bed, &c[i], i, 0, 6 * PIECE,
		    i == 0 ? JOB_BULK : JOB_INTERACTIVE);
		prepare_pieces(&c[i]);
		c[i].room = 1;
		if (i == 0)
			c[i].job.deadline = clock_seconds() + 0.1;
		submit(&c[i]);
	}
	finish(&c[0], ERR_DEADLINE, 0);
	while (!atomic_load(&c[1].is_full))
		usleep(200);
	atomic_store(&c[1].gone, true);
	finish(&c[1], ERR_CANCELLED, 0);
	while (!atomic_load(&c[2].is_full))
		usleep(200);
	assert_int_equal(atomic_load(&c[2].done), 0);
	for (size_t i = 0; i < 6; i++)
		scheduler_continue(bed.s); /* though it has no room */
	c[2].room = 0;
	atomic_store(&c[2].is_full, false);
	scheduler_continue(bed.s);
	finish(&c[2], ERR_OK, 0);
	tear_down(&bed);
}

static void test_small_jobs_share_a_launch_in_pieces_too(void **state)
{
	struct client first, c[3];
	struct bed bed;

	(void)state;
	set_up(&bed, 100);
	plug(&bed, &first);
	for (int i = 0; i < 3; i++) {
		prepare(&bed, &c[i], i + 1, 0, 10, JOB_INTERACTIVE);
		prepare_pieces(&c[i]);
		atomic_store(&c[i].is_full, i == 1);
		submit(&c[i]);
	}
	let_go();
	finish(&first, ERR_OK, 7);
	finish(&c[0], ERR_OK, 0);
	finish(&c[2], ERR_OK, 0);
	assert_int_equal(atomic_load(&c[1].done), 0);
	atomic_store(&c[1].is_full, false);
	scheduler_continue(bed.s);
	finish(&c[1], ERR_OK, 0);
	assert_launch(1, 1, 2, 20);
	assert_launch(2, 2, 1, 10);
	tear_down(&bed);
}

/* ---- failures ---- */

static void test_a_failure_of_the_device_is_everybodys(void **state)
{
	struct client first, c[3], bulk;
	struct bed bed;

	(void)state;
	set_up(&bed, 100);
	plug(&bed, &first);
	for (int i = 0; i < 3; i++)
		start(&bed, &c[i], i + 1, 0, 10, JOB_INTERACTIVE);
	prepare(&bed, &bulk, 4, 0, 3 * PIECE, JOB_BULK);
	prepare_pieces(&bulk);
	submit(&bulk);
	fake.failure = ERR_DEVICE;
	let_go();
	await(&c[2]);
	assert_string_equal(c[2].job.message, "as told");
	finish(&first, ERR_DEVICE, 7);
	for (int i = 0; i < 3; i++)
		finish(&c[i], ERR_DEVICE, 0);
	finish(&bulk, ERR_DEVICE, 0);
	tear_down(&bed);
}

/* Waits for the device to have been opened that often, and be there. */
static void await_opens(struct bed *bed, int opens, unsigned long rebuilds)
{
	while (stats_of(bed).rebuilds < rebuilds)
		usleep(200);
	assert_int_equal(fake.opens, opens);
	assert_int_equal(fake.rebuilt, rebuilds);
}

static void test_a_device_lost_in_a_batch_fails_that_batch(void **state)
{
	struct client first, c[3], others[2], bulk;
	struct bed bed;

	(void)state;
	set_up(&bed, 100);
	plug(&bed, &first);
	for (int i = 0; i < 3; i++)
		start(&bed, &c[i], i + 1, 0, 10, JOB_INTERACTIVE);
	for (int i = 0; i < 2; i++)
		start(&bed, &others[i], i + 4, 1, 10, JOB_INTERACTIVE);
	start(&bed, &bulk, 6, 0, 2 * PIECE, JOB_BULK);
	let_one_go(); /* the batch is held now */
	fake.launch_failure = ERR_DEVICE;
	let_go();
	finish(&first, ERR_OK, 7);
	for (int i = 0; i < 3; i++)
		finish(&c[i], ERR_DEVICE, 0);
	for (int i = 0; i < 2; i++)
		finish(&others[i], ERR_OK, 1);
	finish(&bulk, ERR_OK, 0);
	await_opens(&bed, 2, 1);
	await_idle(&bed, 7);
	tear_down(&bed);
}

/* The pieces before it are kept, those after it follow. */
static void test_a_job_goes_on_after_the_device_was_lost(void **state)
{
	struct client bulk, small;
	struct bed bed;

	(void)state;
	set_up(&bed, 100);
	hold();
	prepare(&bed, &bulk, 1, 0, 4 * PIECE, JOB_BULK);
	prepare_pieces(&bulk);
	submit(&bulk);
	await_inside();
	start(&bed, &small, 2, 1, 10, JOB_INTERACTIVE);
	let_one_go(); /* the bulk job's first piece is through */
	fake.launch_failure = ERR_DEVICE;
	let_go();
	finish(&small, ERR_DEVICE, 1);
	finish(&bulk, ERR_OK, 0);
	await_opens(&bed, 2, 1);
	tear_down(&bed);
}

static void test_a_device_lost_at_a_tape_fails_who_needs_it(void **state)
{
	struct client first, c[2], other;
	struct bed bed;

	(void)state;
	set_up(&bed, 100);
	plug(&bed, &first);
	fake.tape_failure = ERR_DEVICE;
	for (int i = 0; i < 2; i++)
		start(&bed, &c[i], i + 1, 0, 10, JOB_INTERACTIVE);
	start(&bed, &other, 3, 1, 10, JOB_INTERACTIVE);
	let_go();
	finish(&first, ERR_OK, 7);
	for (int i = 0; i < 2; i++)
		finish(&c[i], ERR_DEVICE, 0);
	finish(&other, ERR_OK, 1);
	await_opens(&bed, 2, 1);
	tear_down(&bed);
}

static void await_ready(struct bed *bed)
{
	while (!stats_of(bed).ready)
		usleep(1000);
}

static void test_a_device_lost_at_a_table_fails_who_needs_it(void **state)
{
	struct client c[2], other;
	struct bed bed;

	(void)state;
	set_up(&bed, 100);
	assert_int_equal(tables_start(bed.tables, false, NULL, on_changed,
	    &bed), ERR_OK);
	await_ready(&bed);
	assert_int_equal(fake.tables, 4);
	replace_program(&bed, false);
	fake.table_failure = ERR_DEVICE;
	for (int i = 0; i < 2; i++)
		start(&bed, &c[i], i + 1, 0, 10, JOB_INTERACTIVE);
	for (int i = 0; i < 2; i++)
		finish(&c[i], ERR_DEVICE, 0);
	start(&bed, &other, 3, 1, 10, JOB_INTERACTIVE);
	finish(&other, ERR_OK, 1);
	await_opens(&bed, 2, 1);
	await_ready(&bed);
	/* Asked for again, it is built again; the built-in ones in any case. */
	start(&bed, &other, 4, 0, 10, JOB_INTERACTIVE);
	await(&other);
	assert_int_equal(other.job.result, ERR_OK);
	release(&other);
	for (int i = 0; i < 60000 && fake.tables < 5; i++)
		usleep(1000);
	assert_int_equal(fake.tables, 5);
	tear_down(&bed);
}

/* Jobs whose tables were lost with it wait for them. */
static void test_tables_lost_with_the_device_come_back(void **state)
{
	struct client c, other;
	struct bed bed;

	(void)state;
	set_up(&bed, 100);
	replace_program(&bed, false);
	assert_int_equal(tables_start(bed.tables, false, NULL, on_changed,
	    &bed), ERR_OK);
	start(&bed, &c, 1, 0, 10, JOB_INTERACTIVE);
	await(&c);
	assert_int_equal(c.job.result, ERR_OK);
	release(&c);
	fake.launch_failure = ERR_DEVICE;
	start(&bed, &other, 2, 1, 10, JOB_INTERACTIVE);
	start(&bed, &c, 3, 0, 10, JOB_INTERACTIVE);
	finish(&other, ERR_DEVICE, 1);
	await(&c);
	assert_int_equal(c.job.result, ERR_OK);
	release(&c);
	tear_down(&bed);
}

/* Attempts follow at once, and after 0.1, 0.2, ... seconds. */
static void test_jobs_wait_while_the_device_is_away(void **state)
{
	struct client lost, c;
	double begin;
	struct bed bed;

	(void)state;
	set_up(&bed, 100);
	fake.reopen_failure = ERR_NOT_FOUND;
	fake.launch_failure = ERR_DEVICE;
	plug(&bed, &lost);
	fake.reopen_failures = 3;
	begin = clock_seconds();
	let_go();
	finish(&lost, ERR_DEVICE, 7);
	start(&bed, &c, 1, 0, 10, JOB_INTERACTIVE);
	assert_false(stats_of(&bed).ready);
	finish(&c, ERR_OK, 0);
	/* 0.7 s, and the time it takes to wake up */
	assert_true(clock_seconds() - begin > 0.69);
	assert_true(load_is_soon(clock_seconds() - begin, 1.0));
	await_opens(&bed, 5, 1);
	tear_down(&bed);
}

static void test_jobs_do_not_wait_for_ever_for_the_device(void **state)
{
	struct client lost, c, timed, gone;
	double begin;
	struct bed bed;

	(void)state;
	set_up(&bed, 100);
	fake.reopen_failure = ERR_NOT_FOUND;
	fake.launch_failure = ERR_DEVICE;
	plug(&bed, &lost);
	fake.reopen_failures = 1000;
	begin = clock_seconds();
	let_go();
	finish(&lost, ERR_DEVICE, 7);
	start(&bed, &c, 1, 0, 10, JOB_INTERACTIVE);
	start(&bed, &gone, 2, 0, 10, JOB_INTERACTIVE);
	atomic_store(&gone.gone, true);
	prepare(&bed, &timed, 3, 0, 10, JOB_INTERACTIVE);
	timed.job.deadline = begin + 0.3;
	submit(&timed);
	finish(&timed, ERR_DEADLINE, 0);
	finish(&gone, ERR_CANCELLED, 0);
	finish(&c, ERR_DEVICE, 0);
	assert_true(clock_seconds() - begin > 0.99);
	assert_true(load_is_soon(clock_seconds() - begin, 1.7));
	/* From now on they are told at once. */
	start(&bed, &c, 4, 0, 10, JOB_INTERACTIVE);
	finish(&c, ERR_DEVICE, 0);
	fake.reopen_failures = 0;
	await_opens(&bed, fake.opens + 1, 1);
	start(&bed, &c, 5, 0, 10, JOB_INTERACTIVE);
	finish(&c, ERR_OK, 0);
	tear_down(&bed);
}

static void test_stopping_while_the_device_is_away(void **state)
{
	struct client lost, c;
	struct bed bed;

	(void)state;
	set_up(&bed, 100);
	fake.launch_failure = ERR_DEVICE;
	fake.reopen_failure = ERR_DEVICE;
	plug(&bed, &lost);
	fake.reopen_failures = 1000;
	let_go();
	finish(&lost, ERR_DEVICE, 7);
	start(&bed, &c, 1, 0, 10, JOB_INTERACTIVE);
	scheduler_stop(bed.s);
	finish(&c, ERR_CANCELLED, 0);
	for (size_t i = 0; i < 8; i++)
		scheduler_release(bed.s, bed.programs[i]);
	tables_stop(bed.tables);
	tables_free(bed.tables);
	scheduler_free(bed.s);
}

/* What others have on the device makes room; the device is none the worse. */
static void test_a_launch_without_device_memory_is_tried_again(void **state)
{
	struct client c;
	struct bed bed;

	(void)state;
	set_up(&bed, 100);
	start(&bed, &c, 1, 0, 10, JOB_INTERACTIVE);
	finish(&c, ERR_OK, 0);
	fake.launch_failure = ERR_DEVICE_MEMORY;
	start(&bed, &c, 2, 1, 10, JOB_INTERACTIVE);
	finish(&c, ERR_OK, 1);
	fake.launch_failure = ERR_DEVICE_MEMORY; /* no others are left */
	start(&bed, &c, 3, 1, 10, JOB_INTERACTIVE);
	finish(&c, ERR_DEVICE_MEMORY, 1);
	start(&bed, &c, 4, 1, 10, JOB_INTERACTIVE);
	finish(&c, ERR_OK, 1);
	assert_int_equal(fake.opens, 1);
	tear_down(&bed);
}

static void test_a_device_without_memory_for_long_is_opened_anew(void **state)
{
	struct client c;
	struct bed bed;

	(void)state;
	set_up(&bed, 100);
	for (int i = 0; i < 7; i++) {
		fake.launch_failure = ERR_MEMORY;
		start(&bed, &c, i, 0, 10, JOB_INTERACTIVE);
		finish(&c, ERR_MEMORY, 0);
	}
	assert_int_equal(fake.opens, 1);
	fake.launch_failure = ERR_MEMORY;
	start(&bed, &c, 8, 0, 10, JOB_INTERACTIVE);
	finish(&c, ERR_MEMORY, 0);
	await_opens(&bed, 2, 1);
	start(&bed, &c, 9, 0, 10, JOB_INTERACTIVE);
	finish(&c, ERR_OK, 0);
	tear_down(&bed);
}

static void test_a_launch_that_hangs_is_noticed(void **state)
{
	struct client c;
	struct bed bed;

	(void)state;
	set_up(&bed, 100);
	assert_true(scheduler_watch(bed.s));
	hold();
	start(&bed, &c, 1, 0, 10, JOB_INTERACTIVE);
	await_inside();
	/* It asks whether to go on, which shows that it does not hang. */
	usleep(300000);
	assert_true(scheduler_watch(bed.s));
	let_go();
	finish(&c, ERR_OK, 0);
	fake.pace = 0.1; /* 10 points: 1 s without asking */
	start(&bed, &c, 2, 0, 10, JOB_INTERACTIVE);
	for (int i = 0; i < 30000 && scheduler_watch(bed.s); i++)
		usleep(1000);
	assert_false(scheduler_watch(bed.s));
	assert_false(stats_of(&bed).ready);
	finish(&c, ERR_OK, 0);
	assert_true(scheduler_watch(bed.s));
	tear_down(&bed);
}

static void test_one_without_memory_does_not_fail_the_others(void **state)
{
	struct client first, c[3];
	struct bed bed;

	(void)state;
	if (!fail_alloc_available())
		skip();
	set_up(&bed, 100);
	start(&bed, &c[0], 1, 0, 10, JOB_INTERACTIVE); /* loads the tape */
	finish(&c[0], ERR_OK, 0);
	plug(&bed, &first);
	for (int i = 0; i < 3; i++) {
		prepare(&bed, &c[i], i + 1, 0, 10, JOB_INTERACTIVE);
		c[i].fail = i == 2 ? 2 : 0;
		submit(&c[i]);
	}
	let_go();
	finish(&first, ERR_OK, 7);
	finish(&c[0], ERR_OK, 0);
	finish(&c[1], ERR_MEMORY, 0);
	finish(&c[2], ERR_OK, 0);
	assert_int_equal(fake.launches[fake.count - 1].parts, 2);
	tear_down(&bed);
}

static void test_no_memory_is_an_error_at_each_step(void **state)
{
	struct client c;
	struct bed bed;
	bool failed = true;

	(void)state;
	if (!fail_alloc_available())
		skip();
	set_up(&bed, 100);
	for (long n = 1; failed; n++) {
		prepare(&bed, &c, 1, 0, 10, JOB_INTERACTIVE);
		c.fail = n;
		if (n % 2 == 0)
			prepare_pieces(&c);
		submit(&c);
		await(&c);
		failed = c.job.result == ERR_MEMORY;
		assert_true(failed || c.job.result == ERR_OK);
		assert_true(n > 2 || failed);
		release(&c);
	}
	replace_program(&bed, true);
	prepare(&bed, &c, 1, 0, 10, JOB_INTERACTIVE);
	fail_alloc_set(1);
	assert_int_equal(scheduler_submit(bed.s, &c.job), ERR_MEMORY);
	fail_alloc_set(0);
	assert_int_equal(atomic_load(&c.parked), 0);
	atomic_store(&c.done, 1);
	release(&c);
	tear_down(&bed);
}

static void test_a_full_queue_refuses(void **state)
{
	struct client first, c[2], more;
	struct bed bed;

	(void)state;
	set_up(&bed, 2);
	plug(&bed, &first);
	for (int i = 0; i < 2; i++)
		start(&bed, &c[i], i + 1, 0, 10, JOB_INTERACTIVE);
	prepare(&bed, &more, 3, 0, 10, JOB_INTERACTIVE);
	assert_int_equal(scheduler_submit(bed.s, &more.job), ERR_BUSY);
	assert_int_equal(atomic_load(&more.parked), 0);
	let_go();
	finish(&first, ERR_OK, 7);
	finish(&c[0], ERR_OK, 0);
	finish(&c[1], ERR_OK, 0);
	await_idle(&bed, 3);
	submit(&more);
	finish(&more, ERR_OK, 0);
	tear_down(&bed);
}

/* Else any number of them would be under way. */
static void test_jobs_begun_take_places_in_the_queue(void **state)
{
	struct client c[2], more;
	struct bed bed;

	(void)state;
	set_up(&bed, 1);
	start(&bed, &c[0], 0, 0, 1000 * PIECE, JOB_BULK);
	while (stats_of(&bed).running < 1)
		usleep(200);
	start(&bed, &c[1], 1, 0, 1000 * PIECE, JOB_BULK);
	while (stats_of(&bed).running < 2)
		usleep(200);
	prepare(&bed, &more, 3, 0, 10, JOB_INTERACTIVE);
	assert_int_equal(scheduler_submit(bed.s, &more.job), ERR_BUSY);
	atomic_store(&c[0].gone, true);
	finish(&c[0], ERR_CANCELLED, 0);
	while (stats_of(&bed).running > 1)
		usleep(200);
	submit(&more);
	finish(&more, ERR_OK, 0);
	atomic_store(&c[1].gone, true);
	finish(&c[1], ERR_CANCELLED, 0);
	tear_down(&bed);
}

static void test_the_last_places_are_for_small_jobs(void **state)
{
	struct client first, c[4], more;
	struct bed bed;

	(void)state;
	set_up(&bed, 4);
	plug(&bed, &first);
	for (int i = 0; i < 3; i++)
		start(&bed, &c[i], i + 1, 0, 10, JOB_BULK);
	prepare(&bed, &more, 5, 0, 10, JOB_BULK);
	assert_int_equal(scheduler_submit(bed.s, &more.job), ERR_BUSY);
	more.job.priority = JOB_INTERACTIVE;
	more.job.count = SCHEDULER_SMALL_POINTS + 1; /* of which none is read */
	assert_int_equal(scheduler_submit(bed.s, &more.job), ERR_BUSY);
	more.job.count = 10;
	start(&bed, &c[3], 4, 0, 10, JOB_INTERACTIVE);
	assert_int_equal(scheduler_submit(bed.s, &more.job), ERR_BUSY);
	let_go();
	finish(&first, ERR_OK, 7);
	for (int i = 0; i < 4; i++)
		finish(&c[i], ERR_OK, 0);
	await_idle(&bed, 5);
	submit(&more);
	finish(&more, ERR_OK, 0);
	tear_down(&bed);
}

static void await_stalled(struct bed *bed, size_t count)
{
	while (stats_of(bed).stalled != count)
		usleep(200);
}

/* Of the one place, each time one more has stalled. */
static void test_stalled_jobs_take_no_places(void **state)
{
	struct client c[8], other;
	struct bed bed;

	(void)state;
	set_up(&bed, 1);
	for (int i = 0; i < 8; i++) {
		prepare(&bed, &c[i], i, 0, 4 * PIECE,
		    i % 2 == 0 ? JOB_BULK : JOB_INTERACTIVE);
		prepare_pieces(&c[i]);
		c[i].room = 1;
		submit(&c[i]);
		await_stalled(&bed, (size_t)i + 1);
	}
	assert_int_equal(stats_of(&bed).running, 8);
	scheduler_continue(bed.s); /* though they have no room */
	for (int i = 0; i < 4; i++) {
		start(&bed, &other, 9, 1, 10,
		    i % 2 == 0 ? JOB_BULK : JOB_INTERACTIVE);
		finish(&other, ERR_OK, 1);
		while (stats_of(&bed).running > 8)
			usleep(200);
		assert_int_equal(stats_of(&bed).stalled, 8);
	}
	atomic_store(&c[0].gone, true); /* stalled when it is completed */
	finish(&c[0], ERR_CANCELLED, 0);
	await_stalled(&bed, 7);
	for (int i = 1; i < 8; i++) {
		c[i].room = 0;
		atomic_store(&c[i].is_full, false);
	}
	scheduler_continue(bed.s);
	for (int i = 1; i < 8; i++)
		finish(&c[i], ERR_OK, 0);
	await_idle(&bed, 12);
	tear_down(&bed);
}

/* ---- bytes ---- */

/* A job of so many points as there is no memory for: none of them is read. */
static void start_giant(struct bed *bed, struct client *c, size_t count)
{
	prepare(bed, c, 1, 0, 0, JOB_BULK);
	c->job.count = count;
	submit(c);
}

/* Also once it has been completed. Small ones pass all the time. */
static void test_answers_count_until_they_have_left(void **state)
{
	const size_t count = (size_t)1 << 26; /* 28 bytes each: 1.75 GiB */
	struct client first, giant, small, more;
	struct bed bed;

	(void)state;
	set_up(&bed, 100);
	plug(&bed, &first);
	start_giant(&bed, &giant, count); /* the only large one: it may */
	assert_int_equal(stats_of(&bed).held_bytes, 28 * (count + 100));
	prepare(&bed, &more, 2, 0, 10, JOB_BULK);
	assert_int_equal(scheduler_submit(bed.s, &more.job), ERR_BUSY);
	start(&bed, &small, 3, 0, 10, JOB_INTERACTIVE);
	atomic_store(&giant.gone, true);
	let_go();
	finish(&first, ERR_OK, 7);
	finish(&small, ERR_OK, 0);
	await(&giant);
	while (!scheduler_is_idle(bed.s))
		usleep(200);
	assert_int_equal(stats_of(&bed).held_bytes, 16 * count);
	scheduler_return(bed.s, &giant.job);
	scheduler_return(bed.s, &giant.job); /* once is enough */
	assert_int_equal(stats_of(&bed).held_bytes, 0);
	submit(&more);
	finish(&more, ERR_OK, 0);
	finish(&giant, ERR_CANCELLED, 0);
	await_idle(&bed, 4);
	tear_down(&bed);
}

/* They come to no more than the pieces there may be at a time. */
static void test_rows_in_pieces_count_as_pieces(void **state)
{
	const size_t most = SCHEDULER_PIECES * SCHEDULER_PIECE_BYTES;
	struct client large, small;
	struct bed bed;

	(void)state;
	set_up(&bed, 100);
	hold();
	prepare(&bed, &large, 1, 0, 500000, JOB_BULK);
	prepare_pieces(&large);
	submit(&large);
	await_inside();
	assert_int_equal(stats_of(&bed).held_bytes, 12 * 500000 + most);
	prepare(&bed, &small, 2, 0, 10, JOB_INTERACTIVE);
	prepare_pieces(&small);
	small.job.text = 1000;
	submit(&small);
	assert_int_equal(stats_of(&bed).held_bytes, 12 * 500000 + most +
	    28 * 10 + 1000);
	fake.pace = 1e-9; /* pieces get as large as they may */
	let_go();
	finish(&small, ERR_OK, 0);
	finish(&large, ERR_OK, 0);
	await_idle(&bed, 2);
	tear_down(&bed);
}

/* When small ones have all that is theirs, the smallest still pass. */
static void test_no_small_job_takes_all_that_is_left(void **state)
{
	struct client first, c[200], tiny;
	struct bed bed;
	size_t n = 0;
	enum err err;

	(void)state;
	set_up(&bed, 1000);
	plug(&bed, &first);
	do {
		prepare(&bed, &c[n], (int)n, 0, 0, JOB_INTERACTIVE);
		c[n].job.count = 1000;
		c[n].job.text = (size_t)20 << 20;
		err = scheduler_submit(bed.s, &c[n].job);
	} while (err == ERR_OK && ++n < 199);
	assert_int_equal(err, ERR_BUSY);
	/* 1.25 GiB less seven times what one takes. */
	assert_int_equal(n, 56);
	start(&bed, &tiny, 1, 1, 10, JOB_INTERACTIVE);
	for (size_t i = 0; i < n; i++)
		atomic_store(&c[i].gone, true);
	let_go();
	finish(&first, ERR_OK, 7);
	finish(&tiny, ERR_OK, 1);
	for (size_t i = 0; i < n; i++)
		finish(&c[i], ERR_CANCELLED, 0);
	atomic_store(&c[n].done, 1); /* refused */
	release(&c[n]);
	await_idle(&bed, n + 2);
	tear_down(&bed);
}

/* ---- stopping ---- */

static void test_stopping_completes_all_there_is(void **state)
{
	struct client c[6];
	struct bed bed;

	(void)state;
	set_up(&bed, 100);
	replace_program(&bed, false);
	prepare(&bed, &c[0], 0, 1, 100 * PIECE, JOB_BULK);
	prepare_pieces(&c[0]);
	c[0].room = 1; /* stalls */
	submit(&c[0]);
	while (!atomic_load(&c[0].is_full))
		usleep(200);
	start(&bed, &c[1], 1, 0, 10, JOB_INTERACTIVE); /* awaits its table */
	hold();
	start(&bed, &c[2], 2, 1, 100 * PIECE, JOB_BULK);
	await_inside();
	let_one_go(); /* between pieces */
	start(&bed, &c[3], 3, 1, 10, JOB_INTERACTIVE);
	start(&bed, &c[4], 4, 2, 100 * PIECE, JOB_BULK);
	scheduler_drain(bed.s);
	prepare(&bed, &c[5], 5, 1, 10, JOB_INTERACTIVE);
	assert_int_equal(scheduler_submit(bed.s, &c[5].job), ERR_CANCELLED);
	assert_false(scheduler_is_idle(bed.s));
	for (size_t i = 0; i < 8; i++)
		scheduler_release(bed.s, bed.programs[i]);
	scheduler_stop(bed.s);
	assert_true(scheduler_is_idle(bed.s));
	let_go();
	atomic_store(&c[5].done, 1);
	for (int i = 0; i < 6; i++) {
		if (i < 5)
			assert_int_equal(c[i].job.result, ERR_CANCELLED);
		release(&c[i]);
	}
	tables_free(bed.tables);
	scheduler_free(bed.s);
}

static void test_draining_finishes_what_is_cut(void **state)
{
	struct client c;
	struct bed bed;

	(void)state;
	set_up(&bed, 100);
	start(&bed, &c, 1, 0, 5 * PIECE, JOB_BULK);
	scheduler_drain(bed.s);
	finish(&c, ERR_OK, 0);
	await_idle(&bed, 1);
	tear_down(&bed);
}

/* ---- drafts ---- */

/* Evaluates until the full table serves; its mark. */
static float await_full_table(struct bed *bed)
{
	struct client c;
	bool is_draft = true;
	float mark = 0.0f;

	while (is_draft) {
		start(bed, &c, 5, 0, 1, JOB_INTERACTIVE);
		await(&c);
		assert_int_equal(c.job.result, ERR_OK);
		is_draft = c.job.is_draft;
		mark = (c.job.rows[0] - c.job.points[0]) / 7.0f;
		release(&c);
	}
	return mark;
}

static void test_all_pieces_are_of_the_same_tables(void **state)
{
	struct client c;
	float full, draft;
	struct bed bed;

	(void)state;
	set_up(&bed, 100);
	replace_program(&bed, true);
	assert_int_equal(tables_start(bed.tables, false, NULL, on_changed,
	    &bed), ERR_OK);
	prepare(&bed, &c, 1, 0, 100000 * PIECE / 1000, JOB_BULK);
	prepare_pieces(&c);
	c.room = 1;
	submit(&c);
	while (!atomic_load(&c.is_full))
		usleep(200);
	full = await_full_table(&bed);
	c.room = 0;
	fake.pace = 0.0;
	atomic_store(&c.is_full, false);
	scheduler_continue(bed.s);
	await(&c);
	assert_int_equal(c.job.result, ERR_OK);
	assert_true(c.job.is_draft);
	draft = (c.rows[0] - c.job.points[0]) / 7.0f;
	assert_true(draft != full);
	assert_true(rows_are_right(&c, draft));
	release(&c);
	tear_down(&bed);
}

/* There is room for one table. A job that is cut yields its own for a while,
 * and has it again. */
static void test_jobs_take_turns_with_tables_too(void **state)
{
	struct client bulk, small;
	struct bed bed;

	(void)state;
	set_up(&bed, 100);
	fake.most = 1;
	replace_program(&bed, false);
	scheduler_release(bed.s, bed.programs[1]);
	bed.programs[1] = make_waiting_program(&bed, 0.45, false);
	assert_int_equal(tables_start(bed.tables, false, NULL, on_changed,
	    &bed), ERR_OK);
	prepare(&bed, &bulk, 1, 0, 40 * PIECE, JOB_BULK);
	prepare_pieces(&bulk);
	submit(&bulk);
	while (stats_of(&bed).running == 0)
		usleep(200);
	start(&bed, &small, 2, 1, 10, JOB_INTERACTIVE);
	await(&small);
	assert_int_equal(small.job.result, ERR_OK);
	assert_int_equal(atomic_load(&bulk.done), 0);
	release(&small);
	await(&bulk);
	assert_int_equal(bulk.job.result, ERR_OK);
	assert_int_equal(bulk.got, bulk.job.count);
	release(&bulk);
	tear_down(&bed);
}

/* ---- all at once ---- */

struct stormer {
	pthread_t thread;
	struct bed *bed;
	uint64_t seed;
	int count;
	int wrong;
	atomic_bool stop;
};

/* Frees stalled clients' room, at random. */
static void drain_client(struct client *c, struct random_stream *r)
{
	if (random_below(r, 3) == 0)
		atomic_store(&c->gone, true);
	atomic_store(&c->is_full, false);
	scheduler_continue(c->bed->s);
}

static int storm_once(struct stormer *s, struct random_stream *r)
{
	int count = 1 + random_below(r, 12), wrong = 0;
	struct client c[12];
	enum err err[12];

	for (int i = 0; i < count; i++) {
		int program = random_below(r, 7);
		size_t size = (size_t)random_below(r, random_below(r, 8) == 0 ?
		    10 * PIECE : 300);

		prepare(s->bed, &c[i], i, program, size,
		    random_below(r, 4) == 0 ? JOB_BULK : JOB_INTERACTIVE);
		if (random_below(r, 2) == 0)
			prepare_pieces(&c[i]);
		c[i].room = (size_t)random_below(r, 3);
		if (random_below(r, 4) == 0)
			c[i].job.deadline = clock_seconds() +
			    random_in(r, 0.0, 0.01);
		err[i] = scheduler_submit(s->bed->s, &c[i].job);
		if (random_below(r, 6) == 0)
			atomic_store(&c[i].gone, true);
	}
	for (int i = 0; i < count; i++) {
		while (err[i] == ERR_OK && atomic_load(&c[i].done) == 0) {
			for (int k = i; k < count; k++)
				drain_client(&c[k], r);
			usleep(300);
		}
	}
	for (int i = 0; i < count; i++) {
		int program = (int)(c[i].job.program->tape->node_count - 1);

		if (err[i] == ERR_OK && c[i].job.result == ERR_OK)
			wrong += !rows_are_right(&c[i], (float)(program + 1));
		else if (err[i] == ERR_OK)
			wrong += c[i].job.result != ERR_CANCELLED &&
			    c[i].job.result != ERR_DEADLINE &&
			    (c[i].job.result != ERR_DEVICE || fake.every == 0);
		else
			wrong += err[i] != ERR_BUSY && err[i] != ERR_CANCELLED;
		wrong += atomic_load(&c[i].done) != (err[i] == ERR_OK);
		atomic_store(&c[i].done, 1);
		release(&c[i]);
	}
	return wrong;
}

static void *storm(void *arg)
{
	struct stormer *s = arg;
	struct random_stream r = {s->seed};

	for (int i = 0; i < s->count && !atomic_load(&s->stop); i++)
		s->wrong += storm_once(s, &r);
	return NULL;
}

static void start_storm(struct stormer *s, struct bed *bed, int count)
{
	fake.pace = 1e-8;
	for (int i = 0; i < 4; i++) {
		s[i] = (struct stormer){.bed = bed, .seed = (uint64_t)i + 1,
		    .count = count};
		assert_int_equal(pthread_create(&s[i].thread, NULL, storm,
		    &s[i]), 0);
	}
}

static void end_storm(struct stormer *s)
{
	for (int i = 0; i < 4; i++) {
		pthread_join(s[i].thread, NULL);
		assert_int_equal(s[i].wrong, 0);
	}
}

static void test_each_job_of_a_storm_is_completed_once(void **state)
{
	struct stormer s[4];
	struct bed bed;

	(void)state;
	set_up(&bed, 30);
	start_storm(s, &bed, 150);
	end_storm(s);
	while (!scheduler_is_idle(bed.s))
		usleep(200);
	assert_true(stats_of(&bed).batched > 0);
	tear_down(&bed);
}

/* ... also where every 20th launch is the device's end. */
static void test_each_job_of_a_storm_with_losses_is_completed_once(
    void **state)
{
	struct stormer s[4];
	struct bed bed;

	(void)state;
	set_up(&bed, 30);
	fake.every = 20;
	start_storm(s, &bed, INT_MAX);
	while (stats_of(&bed).rebuilds < 4)
		usleep(200);
	for (int i = 0; i < 4; i++)
		atomic_store(&s[i].stop, true);
	end_storm(s);
	while (!scheduler_is_idle(bed.s))
		usleep(200);
	printf("measured: the device was lost %d times in %d launches\n",
	    fake.rebuilt, fake.launched);
	tear_down(&bed);
}

static void test_each_job_of_a_storm_that_is_stopped_is_completed_once(
    void **state)
{
	struct stormer s[4];
	struct bed bed;

	(void)state;
	set_up(&bed, 30);
	start_storm(s, &bed, 1000000);
	usleep(300000);
	scheduler_stop(bed.s);
	for (int i = 0; i < 4; i++)
		atomic_store(&s[i].stop, true);
	end_storm(s);
	for (size_t i = 0; i < 8; i++)
		scheduler_release(bed.s, bed.programs[i]);
	tables_free(bed.tables);
	scheduler_free(bed.s);
}

int main(void)
{
	const struct CMUnitTest tests[] = {
		cmocka_unit_test(test_jobs_that_wait_together_go_in_one_launch),
		cmocka_unit_test(test_a_launch_takes_no_longer_than_a_piece),
		cmocka_unit_test(
		test_other_outputs_and_bulk_jobs_go_by_themselves),
		cmocka_unit_test(test_an_empty_batch_is_completed),
		cmocka_unit_test(test_programs_take_turns),
		cmocka_unit_test(
		test_small_jobs_pass_between_the_pieces_of_a_large_one),
		cmocka_unit_test(test_large_interactive_jobs_are_cut_too),
		cmocka_unit_test(test_bulk_jobs_take_turns),
		cmocka_unit_test(
		test_bulk_jobs_have_their_share_while_others_keep_coming),
		cmocka_unit_test(
		test_a_deadline_is_kept_while_the_device_is_busy),
		cmocka_unit_test(test_a_deadline_is_kept_between_pieces),
		cmocka_unit_test(test_what_takes_too_long_ends_between_pieces),
		cmocka_unit_test(
		test_a_deadline_is_kept_while_tables_are_awaited),
		cmocka_unit_test(
		test_who_hangs_up_is_dropped_before_the_launch),
		cmocka_unit_test(
		test_who_hangs_up_is_dropped_while_the_device_is_busy),
		cmocka_unit_test(test_who_hangs_up_is_dropped_between_pieces),
		cmocka_unit_test(test_who_hangs_up_is_dropped_in_a_launch),
		cmocka_unit_test(test_a_slow_client_does_not_hold_the_device),
		cmocka_unit_test(test_a_stalled_job_is_looked_after),
		cmocka_unit_test(test_small_jobs_share_a_launch_in_pieces_too),
		cmocka_unit_test(test_a_failure_of_the_device_is_everybodys),
		cmocka_unit_test(
		test_one_without_memory_does_not_fail_the_others),
		cmocka_unit_test(
		    test_a_device_lost_in_a_batch_fails_that_batch),
		cmocka_unit_test(test_a_job_goes_on_after_the_device_was_lost),
		cmocka_unit_test(
		    test_a_device_lost_at_a_tape_fails_who_needs_it),
		cmocka_unit_test(
		    test_a_device_lost_at_a_table_fails_who_needs_it),
		cmocka_unit_test(test_tables_lost_with_the_device_come_back),
		cmocka_unit_test(test_jobs_wait_while_the_device_is_away),
		cmocka_unit_test(
		    test_jobs_do_not_wait_for_ever_for_the_device),
		cmocka_unit_test(test_stopping_while_the_device_is_away),
		cmocka_unit_test(
		    test_a_launch_without_device_memory_is_tried_again),
		cmocka_unit_test(
		    test_a_device_without_memory_for_long_is_opened_anew),
		cmocka_unit_test(test_a_launch_that_hangs_is_noticed),
		cmocka_unit_test(
		    test_each_job_of_a_storm_with_losses_is_completed_once),
		cmocka_unit_test(test_no_memory_is_an_error_at_each_step),
		cmocka_unit_test(test_a_full_queue_refuses),
		cmocka_unit_test(test_jobs_begun_take_places_in_the_queue),
		cmocka_unit_test(test_the_last_places_are_for_small_jobs),
		cmocka_unit_test(test_stalled_jobs_take_no_places),
		cmocka_unit_test(test_answers_count_until_they_have_left),
		cmocka_unit_test(test_rows_in_pieces_count_as_pieces),
		cmocka_unit_test(test_no_small_job_takes_all_that_is_left),
		cmocka_unit_test(test_stopping_completes_all_there_is),
		cmocka_unit_test(test_draining_finishes_what_is_cut),
		cmocka_unit_test(test_all_pieces_are_of_the_same_tables),
		cmocka_unit_test(test_jobs_take_turns_with_tables_too),
		cmocka_unit_test(test_each_job_of_a_storm_is_completed_once),
		cmocka_unit_test(
		test_each_job_of_a_storm_that_is_stopped_is_completed_once),
	};

	log_set_level(LOG_ERROR);
	return cmocka_run_group_tests(tests, NULL, NULL);
}
