#include <stdarg.h>
#include <stddef.h>
#include <setjmp.h>
#include <stdint.h>
#include <cmocka.h>

#include <math.h>
#include <pthread.h>
#include <stdatomic.h>
#include <stdbool.h>
#include <stdlib.h>
#include <string.h>

#include "core/evaluate.h"
#include "core/prune.h"
#include "core/tape.h"
#include "core/tiles.h"
#include "core/tree.h"
#include "tests/support/fail_alloc.h"
#include "tests/support/near.h"
#include "tests/support/random_tree.h"
#include "tests/support/sanitized.h"

#define MAX_NODES 100000

/* ---- a crew of threads ---- */

enum { HANDS = 3 };

struct shift {
	void (*task)(void *ctx, size_t i);
	void *ctx;
	size_t count;
	atomic_size_t next;
};

static void *work(void *arg)
{
	struct shift *s = arg;

	for (size_t i; (i = atomic_fetch_add(&s->next, 1)) < s->count;)
		s->task(s->ctx, i);
	return NULL;
}

static void run_threads(void *self, void (*task)(void *ctx, size_t i),
    void *ctx, size_t count)
{
	struct shift s = {task, ctx, count, 0};
	pthread_t threads[HANDS];

	(void)self;
	for (int i = 0; i < HANDS; i++)
		assert_int_equal(pthread_create(threads + i, NULL, work, &s),
		    0);
	for (int i = 0; i < HANDS; i++)
		pthread_join(threads[i], NULL);
}

static const struct tiles_crew crew = {run_threads, NULL, HANDS};

/* ---- models ---- */

/* Soft points in [0, 1]^3 under one sum, or one union of random_operator's. */
struct cloud {
	struct node root, *nodes, **children;
	struct operator op;
	struct tape *tape;
	struct tiles *tiles;
	struct tiles_work *work;
};

static struct cloud *cloud_create(size_t count, double radius,
    enum node_type type)
{
	struct cloud *c = calloc(1, sizeof(*c));
	struct random_stream r = {count};
	struct tape_error error;
	struct tree tree = {&c->root, TREE_NULL_GRADIENT};

	c->nodes = calloc(count, sizeof(*c->nodes));
	c->children = calloc(count, sizeof(struct node *));
	for (size_t i = 0; i < count; i++) {
		struct vec3 a = vec3(random_in(&r, 0.0, 1.0),
		    random_in(&r, 0.0, 1.0), random_in(&r, 0.0, 1.0));

		c->nodes[i] = (struct node){.type = NODE_PRIMITIVE,
		    .primitive = {.type = PRIMITIVE_POINT, .a = a,
		    .radius = {radius}, .exponent = 3.0, .weight = 1.0}};
		c->children[i] = c->nodes + i;
	}
	c->op.profile = profile_smooth();
	assert_true(opening_named("camel", &c->op.opening));
	c->root = (struct node){.type = type, .children = c->children,
	    .child_count = count, .op = type == NODE_UNION ? &c->op : NULL};
	assert_int_equal(tape_compile(&tree, MAX_NODES, &c->tape, &error),
	    ERR_OK);
	assert_int_equal(tiles_create(c->tape, 1.0, &c->tiles), ERR_OK);
	assert_int_equal(tiles_work_create(&c->work), ERR_OK);
	return c;
}

static void cloud_free(struct cloud *c)
{
	tiles_free(c->tiles);
	tiles_work_free(c->work);
	tape_free(c->tape);
	free(c->nodes);
	free(c->children);
	free(c);
}

static float *random_points(uint64_t seed, size_t count)
{
	struct random_stream r = {seed};
	float *p = malloc(3 * count * sizeof(*p));

	for (size_t i = 0; i < 3 * count; i++)
		p[i] = (float)random_in(&r, 0.0, 1.0);
	return p;
}

static struct tiles_out out_create(size_t count, size_t insns_max)
{
	size_t n = tiles_count(count);

	return (struct tiles_out){
	    .order = malloc(n * TILE_POINTS * sizeof(uint32_t)),
	    .tiles = malloc(n * sizeof(struct tile)),
	    .insns = malloc((insns_max + 1) * sizeof(struct insn)),
	    .insns_max = insns_max};
}

static void out_free(struct tiles_out *out)
{
	free(out->order);
	free(out->tiles);
	free(out->insns);
}

/* ---- what must hold ---- */

/* Every point once, and padding that repeats one of the last tile's. */
static void assert_order(const struct tiles_out *out, size_t count)
{
	bool *seen = calloc(count, sizeof(*seen));

	assert_int_equal(out->tile_count, tiles_count(count));
	for (size_t i = 0; i < out->tile_count * TILE_POINTS; i++) {
		assert_true(out->order[i] < count);
		assert_true(i < count ? !seen[out->order[i]]
		    : seen[out->order[i]]);
		seen[out->order[i]] = true;
	}
	free(seen);
}

static bool same(double a, double b)
{
	return a == b;
}

static bool same_vectors(struct vec3 a, struct vec3 b)
{
	return same(a.x, b.x) && same(a.y, b.y) && same(a.z, b.z);
}

/* Some points of every tile, walked with its part of the tape. */
static void assert_values(const struct tape *tape, const float *points,
    const struct tiles_out *out)
{
	size_t step = out->tile_count / 64 + 1;

	for (size_t i = 0; i < out->tile_count; i += step) {
		struct tile tile = out->tiles[i];
		struct tape part = *tape;

		assert_true(tile.first + tile.count <= out->insn_count);
		if (tile.count > 0) {
			part.insns = out->insns + tile.first;
			part.insn_count = tile.count;
		}
		for (size_t k = 0; k < TILE_POINTS; k += 13) {
			const float *p = points + 3 *
			    (size_t)out->order[TILE_POINTS * i + k];
			struct vec3 x = vec3(p[0], p[1], p[2]);
			struct jet a, b;

			evaluate(tape, x, 1, &a);
			evaluate(&part, x, 1, &b);
			assert_true(same(a.value, b.value));
			assert_true(same_vectors(a.gradient, b.gradient));
		}
	}
}

/* Mean of tiles' instructions. */
static double mean_count(const struct tape *tape, const struct tiles_out *out)
{
	double sum = 0.0;

	for (size_t i = 0; i < out->tile_count; i++)
		sum += out->tiles[i].count ? out->tiles[i].count
		    : tape->insn_count;
	return sum / (double)out->tile_count;
}

static double build(struct cloud *c, const float *points, size_t count,
    const struct tiles_crew *by, size_t room)
{
	struct tiles_out out = out_create(count, room);
	double mean;

	assert_int_equal(tiles_build(c->tiles, c->work, points, count, true, by, &out),
	    ERR_OK);
	assert_true(out.insn_count <= room);
	assert_order(&out, count);
	assert_values(c->tape, points, &out);
	mean = mean_count(c->tape, &out);
	out_free(&out);
	return mean;
}

static void test_tiles_of_any_count_hold_every_point(void **state)
{
	static const size_t counts[] = {1, 2, 63, 64, 65, 127, 128, 129, 1000,
	    4096, 20001};
	struct cloud *c = cloud_create(400, 0.05, NODE_SUM);

	(void)state;
	for (size_t i = 0; i < sizeof(counts) / sizeof(*counts); i++) {
		float *points = random_points(i, counts[i]);

		build(c, points, counts[i], NULL, 100000);
		build(c, points, counts[i], &crew, 100000);
		free(points);
	}
	cloud_free(c);
}

static void test_tiles_are_pruned(void **state)
{
	enum { COUNT = 100000 };
	struct cloud *c = cloud_create(1000, 0.05, NODE_SUM);
	float *points = random_points(1, COUNT);

	(void)state;
	/* of 1999 instructions; 70 are left */
	assert_true(build(c, points, COUNT, NULL, 1000000) < 100.0);
	free(points);
	cloud_free(c);
}

/* A tile's instructions, the whole tape's if it has none. */
static const struct insn *insns_of(const struct tape *tape,
    const struct tiles_out *out, size_t i, size_t *count)
{
	struct tile tile = out->tiles[i];

	*count = tile.count ? tile.count : tape->insn_count;
	return tile.count ? out->insns + tile.first : tape->insns;
}

static void test_tiles_do_not_depend_on_the_crew(void **state)
{
	enum { COUNT = 70001, ROOM = 1000000 };
	struct cloud *c = cloud_create(500, 0.05, NODE_UNION);
	float *points = random_points(3, COUNT);
	struct tiles_out one = out_create(COUNT, ROOM);
	struct tiles_out many = out_create(COUNT, ROOM);

	(void)state;
	assert_int_equal(tiles_build(c->tiles, c->work, points, COUNT, true, NULL, &one),
	    ERR_OK);
	assert_int_equal(tiles_build(c->tiles, c->work, points, COUNT, true, &crew,
	    &many), ERR_OK);
	assert_int_equal(one.tile_count, many.tile_count);
	assert_int_equal(one.insn_count, many.insn_count);
	assert_memory_equal(one.order, many.order,
	    one.tile_count * TILE_POINTS * sizeof(*one.order));
	for (size_t i = 0; i < one.tile_count; i++) {
		size_t a, b;
		const struct insn *p = insns_of(c->tape, &one, i, &a);
		const struct insn *q = insns_of(c->tape, &many, i, &b);

		assert_int_equal(a, b);
		assert_memory_equal(p, q, a * sizeof(*p));
	}
	out_free(&one);
	out_free(&many);
	free(points);
	cloud_free(c);
}

/* Every tile has what pruning to its box leaves. */
static void test_tiles_hold_what_their_boxes_need(void **state)
{
	enum { COUNT = 5000, ROOM = 1000000 };
	const bool is_constant[] = {false};
	struct cloud *c = cloud_create(300, 0.08, NODE_UNION);
	float *points = random_points(3, COUNT);
	struct tiles_out out = out_create(COUNT, ROOM);
	size_t most = c->tape->insn_count + PRUNE_ROOM;
	struct prune_list whole = {.insns = c->tape->insns,
	    .boxes = c->tape->boxes, .count = c->tape->insn_count};
	struct prune_list left = {
	    .insns = malloc(most * sizeof(struct insn)),
	    .boxes = malloc(most * sizeof(struct tape_box))};

	(void)state;
	assert_int_equal(tiles_build(c->tiles, c->work, points, COUNT, true, NULL, &out),
	    ERR_OK);
	for (size_t i = 0; i < out.tile_count; i++) {
		struct tape_box box = {{2.0f, 2.0f, 2.0f},
		    {-1.0f, -1.0f, -1.0f}};
		size_t count;
		const struct insn *insns = insns_of(c->tape, &out, i, &count);

		for (size_t k = 0; k < TILE_POINTS; k++) {
			const float *p = points +
			    3 * out.order[TILE_POINTS * i + k];

			for (int a = 0; a < 3; a++) {
				box.min[a] = fminf(box.min[a], p[a]);
				box.max[a] = fmaxf(box.max[a], p[a]);
			}
		}
		prune(&whole, &box, is_constant, &left);
		assert_int_equal(count, left.count);
		for (size_t k = 0; k < count; k++) {
			assert_int_equal(insns[k].op, left.insns[k].op);
			assert_int_equal(insns[k].param, left.insns[k].param);
			assert_int_equal(insns[k].extra, left.insns[k].extra);
		}
	}
	free(left.insns);
	free(left.boxes);
	out_free(&out);
	free(points);
	cloud_free(c);
}

static void test_tiles_without_room_get_the_whole_tape(void **state)
{
	static const size_t rooms[] = {0, 1, 100, 3000};
	enum { COUNT = 10000 };
	struct cloud *c = cloud_create(300, 0.05, NODE_SUM);
	float *points = random_points(7, COUNT);
	double last = 1e9;

	(void)state;
	for (size_t i = 0; i < sizeof(rooms) / sizeof(*rooms); i++) {
		double mean = build(c, points, COUNT, &crew, rooms[i]);

		assert_true(mean <= last);
		assert_true(rooms[i] > 0 || mean == c->tape->insn_count);
		last = mean;
	}
	free(points);
	cloud_free(c);
}

static void test_tiles_not_culled_are_as_given(void **state)
{
	enum { COUNT = 130 };
	struct cloud *c = cloud_create(300, 0.05, NODE_SUM);
	float *points = random_points(7, COUNT);
	struct tiles_out out = out_create(COUNT, 10);

	(void)state;
	assert_int_equal(tiles_build(c->tiles, c->work, points, COUNT, false, &crew,
	    &out), ERR_OK);
	assert_order(&out, COUNT);
	for (size_t i = 0; i < COUNT; i++)
		assert_int_equal(out.order[i], i);
	for (size_t i = 0; i < out.tile_count; i++)
		assert_int_equal(out.tiles[i].count, 0);
	assert_int_equal(out.insn_count, 0);
	out_free(&out);
	free(points);
	cloud_free(c);
}

/* All at one place, along a line, far away, some of them, all of them. */
static void test_tiles_of_odd_points(void **state)
{
	enum { COUNT = 3000, KINDS = 6 };
	struct cloud *c = cloud_create(300, 0.08, NODE_SUM);

	(void)state;
	for (int kind = 0; kind < KINDS; kind++) {
		float *p = random_points(9, COUNT);

		for (size_t i = 0; i < COUNT; i++) {
			for (int a = 0; a < 3 && kind == 0; a++)
				p[3 * i + a] = 0.5f;
			if (kind == 1)
				p[3 * i] = p[3 * i + 1] = 0.25f;
			if (kind == 2)
				p[3 * i] += 1e12f;
			if (kind == 3 && i % 1000 == 1)
				p[3 * i + 1] = -3e38f;
			if (kind == 4)
				p[3 * i + 2] *= 3e38f;
			if (kind == 5 && i % 2)
				p[3 * i + 2] += 7.0f;
		}
		build(c, p, COUNT, NULL, 100000);
		build(c, p, COUNT, &crew, 100000);
		free(p);
	}
	cloud_free(c);
}

/* Rows of a grid are as good as cubes where primitives are much larger. */
static void test_tiles_leave_an_order_that_serves(void **state)
{
	enum { SIDE = 64, COUNT = SIDE * SIDE * 4 };
	struct cloud *c = cloud_create(40, 0.2, NODE_SUM);
	float *p = malloc(3 * COUNT * sizeof(*p));
	struct tiles_out out = out_create(COUNT, 100000);

	(void)state;
	for (size_t i = 0; i < COUNT; i++) {
		p[3 * i] = (float)(i % SIDE) / (16.0f * SIDE);
		p[3 * i + 1] = (float)(i / SIDE % SIDE) / (16.0f * SIDE);
		p[3 * i + 2] = (float)(i / SIDE / SIDE) / (16.0f * SIDE);
	}
	assert_int_equal(tiles_build(c->tiles, c->work, p, COUNT, true, NULL, &out),
	    ERR_OK);
	for (size_t i = 0; i < COUNT; i++)
		assert_int_equal(out.order[i], i);
	assert_values(c->tape, p, &out);
	out_free(&out);
	free(p);
	cloud_free(c);
}

static void test_tiles_pay_for_long_bounded_tapes(void **state)
{
	struct cloud *few = cloud_create(4, 0.05, NODE_SUM);
	struct cloud *many = cloud_create(400, 0.05, NODE_SUM);

	(void)state;
	assert_false(tiles_pay(few->tiles, 100000));
	assert_true(tiles_pay(many->tiles, 100000));
	assert_true(tiles_bytes(many->tiles) > tiles_bytes(few->tiles));
	cloud_free(few);
	cloud_free(many);
}

static void test_tiles_survive_every_failing_allocation(void **state)
{
	enum { COUNT = 2000 };
	struct cloud *c;
	float *points;
	struct tiles_out out;
	enum err err;
	long n = 0;

	(void)state;
	if (!fail_alloc_available())
		skip();
	c = cloud_create(200, 0.05, NODE_SUM);
	points = random_points(7, COUNT);
	out = out_create(COUNT, 1000);
	do {
		struct tiles *t = NULL;
		struct tiles_work *work = NULL;

		fail_alloc_set(++n);
		err = tiles_create(c->tape, 1.0, &t);
		if (err == ERR_OK)
			err = tiles_work_create(&work);
		if (err == ERR_OK)
			err = tiles_build(t, work, points, COUNT, true, NULL,
			    &out);
		tiles_free(t);
		tiles_work_free(work);
		assert_int_equal(fail_alloc_live(), 0);
		assert_int_equal(err, fail_alloc_happened() ? ERR_MEMORY
		    : ERR_OK);
	} while (err != ERR_OK);
	fail_alloc_set(0);
	/* the copy, a hand, boxes, three arrays to sort with */
	assert_true(n > 11);
	out_free(&out);
	free(points);
	cloud_free(c);
}

int main(void)
{
	const struct CMUnitTest tests[] = {
		cmocka_unit_test(test_tiles_do_not_depend_on_the_crew),
		cmocka_unit_test(test_tiles_hold_what_their_boxes_need),
		cmocka_unit_test(test_tiles_without_room_get_the_whole_tape),
		cmocka_unit_test(test_tiles_not_culled_are_as_given),
		cmocka_unit_test(test_tiles_of_odd_points),
		cmocka_unit_test(test_tiles_leave_an_order_that_serves),
		cmocka_unit_test(test_tiles_pay_for_long_bounded_tapes),
		cmocka_unit_test(test_tiles_survive_every_failing_allocation),
		cmocka_unit_test(test_tiles_of_any_count_hold_every_point),
		cmocka_unit_test(test_tiles_are_pruned),
	};

	return cmocka_run_group_tests(tests, NULL, NULL);
}
