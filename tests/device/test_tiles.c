/*
 * One tape, many ways through the device: culled, whole, in parts, in one go,
 * through shared memory, through buffers. All give the same bits.
 */
#include <math.h>
#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include <cmocka.h>

#include "core/evaluate.h"
#include "core/output.h"
#include "core/table.h"
#include "core/tape.h"
#include "core/tree.h"
#include "kernels/device_internal.h"
#include "tests/support/random_tree.h"
#include "tests/support/sanitized.h"

#define TREES (SANITIZED ? 8 : 40)
#define POINTS 100003 /* whole tiles, and a part of one */
#define SMALL 4096
#define TABLES_MAX 64
#define TABLE_NODES 16
#define JET (OUTPUT_VALUE | OUTPUT_GRADIENT | OUTPUT_HESSIAN)

/* A device with the tables loaded so far. */
struct place {
	struct device *device;
	struct operator ops[TABLES_MAX];
	int slots[TABLES_MAX];
	int count;
};

/* With memory as it suits the device, and with buffers. */
static struct place best, copied;
static float xyz[POINTS * 3];
static float want[POINTS * OUTPUT_ROW_MAX], got[POINTS * OUTPUT_ROW_MAX];

static bool same_table(const struct operator *a, const struct operator *b)
{
	return a->family == b->family && a->layout == b->layout &&
	    profile_equal(&a->profile, &b->profile);
}

static int slot_of(struct place *at, const struct operator *op)
{
	struct table *table;

	for (int i = 0; i < at->count; i++)
		if (same_table(at->ops + i, op))
			return at->slots[i];
	assert_true(at->count < TABLES_MAX);
	assert_int_equal(table_create(op->family, &op->profile, op->layout,
	    TABLE_NODES, &table), ERR_OK);
	table_build(table, 0, TABLE_NODES);
	assert_int_equal(device_load_table(at->device, table,
	    at->slots + at->count), ERR_OK);
	table_free(table);
	at->ops[at->count] = *op;
	return at->slots[at->count++];
}

static struct device_tape *load(struct place *at, const struct tape *tape)
{
	int *slots = calloc(tape->operator_count + 1, sizeof(*slots));
	struct device_tape *t = NULL;

	assert_non_null(slots);
	for (size_t i = 0; i < tape->operator_count; i++)
		slots[i] = slot_of(at, tape->operators + i);
	assert_int_equal(device_load_tape(at->device, tape, slots, &t),
	    ERR_OK);
	free(slots);
	return t;
}

static struct device *open_device(enum device_memory memory)
{
	struct device_options options = {0};
	struct device_failure failure = {0};
	struct device *d = NULL;

	if (device_open_as(&options, memory, &d, &failure) != ERR_OK)
		printf("%s\n%s\n", failure.message,
		    failure.build_log ? failure.build_log : "");
	device_failure_fini(&failure);
	assert_non_null(d);
	return d;
}

static int setup(void **state)
{
	(void)state;
	best.device = open_device(DEVICE_MEMORY_AUTO);
	copied.device = open_device(DEVICE_MEMORY_COPIED);
	return 0;
}

static int teardown(void **state)
{
	(void)state;
	device_close(best.device);
	device_close(copied.device);
	return 0;
}

static void run(struct place *at, struct device_tape *t,
    enum device_culling culling, size_t count, unsigned outputs, float *rows)
{
	at->device->culling = culling;
	assert_int_equal(device_evaluate(at->device, t, xyz, count, outputs,
	    rows, NULL, NULL), ERR_OK);
	at->device->culling = DEVICE_CULLING_PAYS;
}

/* How many of count rows differ between want and got. */
static size_t differing(size_t count, unsigned outputs)
{
	size_t size = (size_t)output_row_floats(outputs), n = 0;

	for (size_t i = 0; i < count; i++)
		n += memcmp(want + i * size, got + i * size,
		    size * sizeof(float)) != 0;
	return n;
}

static void print_first(size_t count, unsigned outputs)
{
	size_t size = (size_t)output_row_floats(outputs);

	for (size_t i = 0; i < count; i++)
		for (size_t k = 0; k < size; k++)
			if (want[i * size + k] != got[i * size + k]) {
				printf("point %zu (%.9g %.9g %.9g), column %zu:"
				    " %.9g, not %.9g\n", i,
				    (double)xyz[3 * i], (double)xyz[3 * i + 1],
				    (double)xyz[3 * i + 2], k,
				    (double)got[i * size + k],
				    (double)want[i * size + k]);
				return;
			}
}

/* Culled against whole, for every size of batch. */
static size_t check_sizes(struct place *at, struct device_tape *t,
    size_t most, unsigned outputs)
{
	static const size_t counts[] = {1, 63, 64, 65, 255, 4096, POINTS};
	size_t off = 0;

	run(at, t, DEVICE_CULLING_NEVER, most, outputs, want);
	for (size_t i = 0; i < sizeof(counts) / sizeof(*counts); i++) {
		size_t n;

		if (counts[i] > most)
			break;
		memset(got, 0xff, counts[i] * (size_t)output_row_floats(
		    outputs) * sizeof(*got));
		run(at, t, DEVICE_CULLING_ALWAYS, counts[i], outputs, got);
		n = differing(counts[i], outputs);
		if (n > 0)
			print_first(counts[i], outputs);
		off += n;
	}
	return off;
}

/* A cube of points, x fastest, in place of the random ones. */
static void make_grid(size_t count)
{
	size_t n = 1;

	while (n * n * n < count)
		n++;
	for (size_t i = 0; i < count; i++) {
		const size_t at[] = {i % n, i / n % n, i / n / n};

		for (int k = 0; k < 3; k++)
			xyz[3 * i + (size_t)k] = (float)(3.0 *
			    (double)at[k] / (double)n - 1.5);
	}
}

static struct tape *compile(const struct tree *tree)
{
	struct tape_error error;
	struct tape *tape = NULL;

	assert_int_equal(tape_compile(tree, 30000, &tape, &error), ERR_OK);
	return tape;
}

/* Random trees, random and grid points; rows that differ. */
static void check_trees(bool whole, const unsigned *outputs, int kinds)
{
	size_t off = 0, trees = 0, shorter = 0;

	for (uint64_t seed = 1; seed <= TREES; seed++) {
		struct random_tree_options o = {.seed = seed, .whole = whole};
		struct random_tree *tree = random_tree_create(&o);
		struct tape *tape = compile(random_tree_get(tree));
		struct device_tape *t = load(&best, tape);
		size_t most = seed % 8 == 0 ? POINTS : SMALL, found = 0;

		random_tree_points(tree, tape, seed, SMALL, xyz);
		if (most > SMALL)
			make_grid(most);
		for (int k = 0; k < kinds; k++)
			found += check_sizes(&best, t, most, outputs[k]);
		if (found > 0)
			printf("tree %d: %zu rows differ\n", (int)seed, found);
		off += found;
		trees++;
		shorter += t->tiles != NULL;
		device_drop_tape(best.device, t);
		tape_free(tape);
		random_tree_free(tree);
	}
	printf("measured: %zu trees, %zu of them culled: %zu rows differ\n",
	    trees, shorter, off);
	assert_int_equal(shorter, trees);
	assert_int_equal(off, 0);
}

static void test_tiles_culled_is_whole(void **state)
{
	static const unsigned outputs[] = {OUTPUT_VALUE,
		OUTPUT_VALUE | OUTPUT_GRADIENT, JET};

	(void)state;
	check_trees(false, outputs, 3);
}

static void test_tiles_culled_is_whole_in_the_whole_language(void **state)
{
	static const unsigned outputs[] = {OUTPUT_VALUE | OUTPUT_GRADIENT,
		OUTPUT_ALL & ~OUTPUT_COLOR, OUTPUT_ALL, OUTPUT_COLOR};

	(void)state;
	check_trees(true, outputs, 4);
}

static void test_tiles_buffers_agree_with_shared_memory(void **state)
{
	(void)state;
	assert_false(copied.device->has_shared || copied.device->reads_host);
	for (uint64_t seed = 1; seed <= 8; seed++) {
		struct random_tree_options o = {.seed = seed,
			.whole = seed % 2 == 0};
		struct random_tree *tree = random_tree_create(&o);
		struct tape *tape = compile(random_tree_get(tree));
		struct device_tape *t = load(&best, tape);
		struct device_tape *u = load(&copied, tape);

		make_grid(POINTS);
		run(&best, t, DEVICE_CULLING_NEVER, POINTS, JET, want);
		run(&copied, u, DEVICE_CULLING_NEVER, POINTS, JET, got);
		if (differing(POINTS, JET) > 0)
			print_first(POINTS, JET);
		assert_int_equal(differing(POINTS, JET), 0);
		assert_int_equal(check_sizes(&copied, u, POINTS, JET), 0);
		device_drop_tape(best.device, t);
		device_drop_tape(copied.device, u);
		tape_free(tape);
		random_tree_free(tree);
	}
}

/* Parts of the first points against the whole batch's rows. */
static void check_parts(struct place *at, struct device_tape *t,
    enum device_culling culling)
{
	static const size_t counts[] = {1, 63, 0, 64, 65, 255, 7000, 12};
	enum { N = sizeof(counts) / sizeof(*counts) };
	unsigned outputs = OUTPUT_VALUE | OUTPUT_GRADIENT;
	struct device_part parts[N];
	size_t done = 0;

	for (int i = 0; i < N; i++) {
		parts[i] = (struct device_part){xyz + 3 * done, counts[i],
			got + 4 * done};
		done += counts[i];
	}
	got[4 * done] = -77.0f;
	at->device->culling = culling;
	assert_int_equal(device_evaluate_parts(at->device, t, parts, N,
	    outputs), ERR_OK);
	at->device->culling = DEVICE_CULLING_PAYS;
	run(at, t, DEVICE_CULLING_NEVER, done, outputs, want);
	assert_memory_equal(got, want, done * 4 * sizeof(*got));
	assert_true(got[4 * done] == -77.0f);
}

static void test_tiles_parts_agree_with_single_batches(void **state)
{
	struct random_tree_options o = {.seed = 5};
	struct random_tree *tree = random_tree_create(&o);
	struct tape *tape = compile(random_tree_get(tree));
	struct device_tape *t = load(&best, tape), *u = load(&copied, tape);

	(void)state;
	random_tree_points(tree, tape, 5, 8000, xyz);
	check_parts(&best, t, DEVICE_CULLING_NEVER);
	check_parts(&best, t, DEVICE_CULLING_ALWAYS);
	check_parts(&copied, u, DEVICE_CULLING_NEVER);
	check_parts(&copied, u, DEVICE_CULLING_ALWAYS);
	device_drop_tape(best.device, t);
	device_drop_tape(copied.device, u);
	tape_free(tape);
	random_tree_free(tree);
}

static void test_tiles_parts_are_bounded(void **state)
{
	struct random_tree_options o = {.seed = 5};
	struct random_tree *tree = random_tree_create(&o);
	struct tape *tape = compile(random_tree_get(tree));
	struct device_tape *t = load(&best, tape);
	struct device_part parts[2] = {{xyz, DEVICE_PARTS_POINTS, got},
		{xyz, 1, want}};

	(void)state;
	make_grid(DEVICE_PARTS_POINTS);
	want[0] = -77.0f;
	assert_int_equal(device_evaluate_parts(best.device, t, parts, 2,
	    OUTPUT_VALUE), ERR_INVALID);
	parts[1].count = SIZE_MAX;
	assert_int_equal(device_evaluate_parts(best.device, t, parts, 2,
	    OUTPUT_VALUE), ERR_INVALID);
	assert_int_equal(device_evaluate_parts(best.device, t, parts, 1,
	    OUTPUT_ALL + 1), ERR_INVALID);
	assert_int_equal(device_evaluate_parts(best.device, t, parts, 0,
	    OUTPUT_VALUE), ERR_OK);
	assert_int_equal(device_evaluate_parts(best.device, t, parts, 1,
	    OUTPUT_VALUE), ERR_OK);
	assert_true(want[0] == -77.0f);
	device_drop_tape(best.device, t);
	tape_free(tape);
	random_tree_free(tree);
}

/* --- a tape of very many primitives ----------------------------------------- */

#define CROWD 10000

/* As many points in [-1, 1]^3, about four of them felt at each place. */
static struct tape *crowd(enum node_type type, const struct operator *op)
{
	struct node *nodes = calloc(CROWD + 1, sizeof(*nodes));
	struct node **children = calloc(CROWD, sizeof(*children));
	struct random_stream r = {9};
	struct tree tree = {nodes, TREE_NULL_GRADIENT};
	struct tape *tape;

	assert_non_null(nodes);
	assert_non_null(children);
	nodes[0].type = type;
	nodes[0].op = op;
	nodes[0].children = children;
	nodes[0].child_count = CROWD;
	for (size_t i = 0; i < CROWD; i++) {
		struct node *n = nodes + i + 1;
		double x = random_in(&r, -1.0, 1.0), y = random_in(&r, -1.0, 1.0);

		*n = (struct node){.type = NODE_PRIMITIVE, .parent = nodes,
			.index = i};
		n->primitive = (struct primitive){.type = PRIMITIVE_POINT,
			.a = vec3(x, y, random_in(&r, -1.0, 1.0)),
			.radius = {0.042, 0.042}, .exponent = 3.0,
			.weight = 1.0};
		children[i] = n;
	}
	tape = compile(&tree);
	free(children);
	free(nodes);
	return tape;
}

static void make_random_points(size_t count)
{
	struct random_stream r = {21};

	for (size_t i = 0; i < count * 3; i++)
		xyz[i] = (float)random_in(&r, -1.05, 1.05);
}

/* The largest error of value and gradient at 100 of count points. */
static void sample_errors(const struct tape *tape, size_t count,
    double *value, double *gradient)
{
	*value = *gradient = 0.0;
	for (size_t i = 0; i < count; i += count / 100) {
		const float *p = xyz + 3 * i, *row = got + 4 * i;
		struct jet jet;

		evaluate(tape, vec3(p[0], p[1], p[2]), 1, &jet);
		*value = fmax(*value, fabs(jet.value - (double)row[0]));
		*gradient = fmax(*gradient, vec3_norm(vec3_sub(jet.gradient,
		    vec3(row[1], row[2], row[3]))));
	}
}

static void test_tiles_sum_of_ten_thousand(void **state)
{
	struct tape *tape = crowd(NODE_SUM, NULL);
	struct device_tape *t = load(&best, tape);
	unsigned outputs = OUTPUT_VALUE | OUTPUT_GRADIENT;
	double value, gradient;

	(void)state;
	make_random_points(POINTS);
	run(&best, t, DEVICE_CULLING_PAYS, POINTS, outputs, got);
	sample_errors(tape, POINTS, &value, &gradient);
	printf("measured: %d primitives: value %.1e, gradient %.1e\n", CROWD,
	    value, gradient);
	/* 7.2e-7, 2.9e-5 (of gradients up to 30) */
	assert_true(value < 2e-6);
	assert_true(gradient < 1e-4);
	memcpy(want, got, SMALL * 4 * sizeof(*want));
	run(&best, t, DEVICE_CULLING_NEVER, SMALL, outputs, got);
	assert_memory_equal(got, want, SMALL * 4 * sizeof(*want));
	printf("measured: %zu bytes of tape, %zu of workspace\n",
	    device_tape_bytes(t), device_workspace_bytes(&best.device->work));
	assert_true(device_tape_bytes(t) > CROWD * 2 * sizeof(struct insn));
	device_drop_tape(best.device, t);
	tape_free(tape);
}

static void test_tiles_blends_of_ten_thousand(void **state)
{
	struct operator op = {.family = FAMILY_UNION, .layout = LAYOUT_WARPED,
		.resolution = TABLE_NODES, .profile = profile_smooth()};
	unsigned outputs = OUTPUT_VALUE | OUTPUT_GRADIENT;
	struct device_tape *t;
	struct tape *tape;

	(void)state;
	assert_true(opening_named("camel", &op.opening));
	tape = crowd(NODE_UNION, &op);
	t = load(&best, tape);
	make_random_points(SMALL);
	run(&best, t, DEVICE_CULLING_PAYS, SMALL, outputs, got);
	run(&best, t, DEVICE_CULLING_NEVER, 512, outputs, want);
	assert_int_equal(differing(512, outputs), 0);
	device_drop_tape(best.device, t);
	tape_free(tape);
}

/* However large the batch, the workspace is bounded. */
static void test_tiles_workspace_is_bounded(void **state)
{
	(void)state;
	assert_in_range(device_workspace_bytes(&best.device->work), 1,
	    (size_t)64 << 20);
	assert_in_range(device_workspace_bytes(&copied.device->work), 1,
	    (size_t)128 << 20);
}

int main(void)
{
	const struct CMUnitTest tests[] = {
		cmocka_unit_test(test_tiles_culled_is_whole),
		cmocka_unit_test(
		    test_tiles_culled_is_whole_in_the_whole_language),
		cmocka_unit_test(test_tiles_buffers_agree_with_shared_memory),
		cmocka_unit_test(test_tiles_parts_agree_with_single_batches),
		cmocka_unit_test(test_tiles_parts_are_bounded),
		cmocka_unit_test(test_tiles_sum_of_ten_thousand),
		cmocka_unit_test(test_tiles_blends_of_ten_thousand),
		cmocka_unit_test(test_tiles_workspace_is_bounded),
	};

	return cmocka_run_group_tests(tests, setup, teardown);
}
