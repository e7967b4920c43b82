/*
 * The device against the float64 evaluator, on random trees of every node
 * type and operator, at every output order, however batches go through it.
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
#include "core/surface.h"
#include "core/table.h"
#include "core/tape.h"
#include "core/tree.h"
#include "kernels/device_internal.h"
#include "tests/support/random_tree.h"
#include "tests/support/sanitized.h"

/* 200 take the address sanitizer 38 s, the thread sanitizer 128 s. */
#define TREES (SANITIZED ? 40 : 200)
#define POINTS 1000
#define TABLES_MAX 64
#define JET (OUTPUT_VALUE | OUTPUT_GRADIENT | OUTPUT_HESSIAN)

/* Tables loaded so far; every kind of operator is built once, for both devices:
 * one whose memory is as suits it, one that is sent copies. */
struct loaded {
	struct device *device, *copied;
	struct operator ops[TABLES_MAX];
	int slots[TABLES_MAX], copied_slots[TABLES_MAX];
	int count;
};

static struct loaded loaded;

static bool same_table(const struct operator *a, const struct operator *b)
{
	return a->family == b->family && a->layout == b->layout &&
	    a->resolution == b->resolution &&
	    profile_equal(&a->profile, &b->profile);
}

static int loaded_of(const struct operator *op)
{
	struct table *table;

	for (int i = 0; i < loaded.count; i++)
		if (same_table(loaded.ops + i, op))
			return i;
	assert_true(loaded.count < TABLES_MAX);
	assert_int_equal(table_create(op->family, &op->profile, op->layout,
	    op->resolution, &table), ERR_OK);
	table_build(table, 0, op->resolution);
	assert_int_equal(device_load_table(loaded.device, table,
	    loaded.slots + loaded.count), ERR_OK);
	assert_int_equal(device_load_table(loaded.copied, table,
	    loaded.copied_slots + loaded.count), ERR_OK);
	table_free(table);
	loaded.ops[loaded.count] = *op;
	return loaded.count++;
}

static struct device_tape *load(struct device *d, const struct tape *tape)
{
	int *slots = calloc(tape->operator_count + 1, sizeof(*slots));
	struct device_tape *t = NULL;

	assert_non_null(slots);
	for (size_t i = 0; i < tape->operator_count; i++)
		slots[i] = (d == loaded.device ? loaded.slots :
		    loaded.copied_slots)[loaded_of(tape->operators + i)];
	assert_int_equal(device_load_tape(d, tape, slots, &t), ERR_OK);
	free(slots);
	return t;
}

/* A tree with its tape, points and the device's rows. */
struct sample {
	struct random_tree *tree;
	struct tape *tape;
	struct device_tape *device_tape, *copied_tape;
	float *xyz, *rows, *others;
};

static struct sample sample_create(const struct random_tree_options *o)
{
	struct sample s = {.tree = random_tree_create(o)};
	struct tape_error error;

	assert_int_equal(tape_compile(random_tree_get(s.tree), 1000, &s.tape,
	    &error), ERR_OK);
	s.xyz = malloc(POINTS * 3 * sizeof(*s.xyz));
	s.rows = malloc(POINTS * OUTPUT_ROW_MAX * sizeof(*s.rows));
	s.others = malloc(POINTS * OUTPUT_ROW_MAX * sizeof(*s.others));
	assert_non_null(s.xyz);
	assert_non_null(s.rows);
	assert_non_null(s.others);
	random_tree_points(s.tree, s.tape, o->seed, POINTS, s.xyz);
	s.device_tape = load(loaded.device, s.tape);
	s.copied_tape = load(loaded.copied, s.tape);
	return s;
}

static void sample_free(struct sample *s)
{
	device_drop_tape(loaded.device, s->device_tape);
	device_drop_tape(loaded.copied, s->copied_tape);
	free(s->others);
	free(s->rows);
	free(s->xyz);
	tape_free(s->tape);
	random_tree_free(s->tree);
}

static void run_on(struct device *d, struct device_tape *t,
    enum device_culling culling, const struct sample *s, unsigned outputs,
    float *rows)
{
	d->culling = culling;
	assert_int_equal(device_evaluate(d, t, s->xyz, POINTS, outputs, rows,
	    NULL, NULL), ERR_OK);
	d->culling = DEVICE_CULLING_PAYS;
}

/* In four parts that go together, culled. */
static void run_parts(struct sample *s, unsigned outputs)
{
	static const size_t counts[] = {70, 1, 600, POINTS - 671};
	size_t stride = (size_t)output_row_floats(outputs), done = 0;
	struct device_part parts[4];

	for (int i = 0; i < 4; i++) {
		parts[i] = (struct device_part){s->xyz + 3 * done, counts[i],
			s->others + stride * done};
		done += counts[i];
	}
	loaded.device->culling = DEVICE_CULLING_ALWAYS;
	assert_int_equal(device_evaluate_parts(loaded.device, s->device_tape,
	    parts, 4, outputs), ERR_OK);
	loaded.device->culling = DEVICE_CULLING_PAYS;
}

static void check_others(const struct sample *s, unsigned outputs)
{
	assert_memory_equal(s->others, s->rows, POINTS *
	    (size_t)output_row_floats(outputs) * sizeof(*s->rows));
}

/* Every way through a device: all give the same bits, so that what is measured
 * of one holds for all. */
static void run(struct sample *s, unsigned outputs)
{
	run_on(loaded.device, s->device_tape, DEVICE_CULLING_NEVER, s, outputs,
	    s->rows);
	run_on(loaded.device, s->device_tape, DEVICE_CULLING_ALWAYS, s, outputs,
	    s->others);
	check_others(s, outputs);
	run_parts(s, outputs);
	check_others(s, outputs);
	run_on(loaded.copied, s->copied_tape, DEVICE_CULLING_ALWAYS, s, outputs,
	    s->others);
	check_others(s, outputs);
}

static void exact(const struct sample *s, size_t i, int order, struct jet *out)
{
	const float *p = s->xyz + 3 * i;

	evaluate(s->tape, vec3(p[0], p[1], p[2]), order, out);
}

static int setup(void **state)
{
	struct device_options options = {0};
	struct device_failure failure = {0};

	(void)state;
	if (device_open(&options, &loaded.device, &failure) != ERR_OK ||
	    device_open_as(&options, DEVICE_MEMORY_COPIED, &loaded.copied,
	    &failure) != ERR_OK) {
		printf("%s\n%s\n", failure.message,
		    failure.build_log ? failure.build_log : "");
		device_failure_fini(&failure);
		return -1;
	}
	return 0;
}

static int teardown(void **state)
{
	(void)state;
	device_close(loaded.device);
	device_close(loaded.copied);
	return 0;
}

/* Errors in the value. */
struct totals {
	double max, sum;
	size_t count, over;
	uint64_t worst;
};

#define VALUE_MAX 2e-3
#define VALUE_MEAN 2e-5

/*
 * Absolute errors, or relative ones of values over 1: super-elliptic operators
 * raise fields to powers, to 1e8 in these trees, and errors with them.
 */
static void add_values(const struct sample *s, const double *want,
    size_t stride, uint64_t seed, bool relative, struct totals *t)
{
	for (size_t i = 0; i < POINTS; i++) {
		double e = fabs(want[i] - (double)s->rows[i * stride]) /
		    (relative ? fmax(1.0, want[i]) : 1.0);

		if (e > t->max) {
			t->max = e;
			t->worst = seed;
		}
		t->over += e > VALUE_MAX;
		t->sum += e;
		t->count++;
	}
}

/* The values that come alone, with gradients and with Hessians: the
 * interpreter's order differs. */
static void check_values(bool whole)
{
	static const unsigned outputs[] = {OUTPUT_VALUE,
		OUTPUT_VALUE | OUTPUT_GRADIENT, JET};
	static double want[POINTS];
	struct totals t[3] = {{0}};
	struct jet jet;

	for (uint64_t seed = 1; seed <= TREES; seed++) {
		struct random_tree_options o = {.seed = seed, .whole = whole};
		struct sample s = sample_create(&o);

		for (size_t i = 0; i < POINTS; i++) {
			exact(&s, i, 0, &jet);
			want[i] = jet.value;
		}
		for (int k = 0; k < 3; k++) {
			run(&s, outputs[k]);
			add_values(&s, want, (size_t)output_row_floats(
			    outputs[k]), seed, whole, t + k);
		}
		sample_free(&s);
	}
	for (int k = 0; k < 3; k++)
		printf("measured: outputs %u: %zu values, max error %.2e (tree %d), "
		    "mean %.2e, %zu over %g\n", outputs[k], t[k].count,
		    t[k].max, (int)t[k].worst, t[k].sum / (double)t[k].count,
		    t[k].over, VALUE_MAX);
	for (int k = 0; k < 3; k++) {
		assert_true(t[k].max <= VALUE_MAX);
		assert_true(t[k].sum / (double)t[k].count <= VALUE_MEAN);
	}
}

static void test_accuracy_values_at_every_order(void **state)
{
	(void)state;
	check_values(false);
}

static void test_accuracy_values_of_the_whole_language(void **state)
{
	(void)state;
	check_values(true);
}

static int by_size(const void *a, const void *b)
{
	double x = *(const double *)a, y = *(const double *)b;

	return (x > y) - (x < y);
}

/*
 * |device - exact| / (|exact| + least), over `size` numbers, where least keeps
 * what is 0 to rounding from counting.
 */
static double relative_error(const double *want, const float *got, int size,
    double least)
{
	double off = 0.0, norm = 0.0;

	for (int k = 0; k < size; k++) {
		off += (want[k] - got[k]) * (want[k] - got[k]);
		norm += want[k] * want[k];
	}
	return sqrt(off) / (sqrt(norm) + least);
}

/* Sorts errors, prints and returns their 99th percentile. */
static double percentile(const char *what, double *errors, size_t count)
{
	double p99;

	qsort(errors, count, sizeof(*errors), by_size);
	p99 = errors[count * 99 / 100];
	printf("measured: %s: %zu, median %.1e, p99 %.1e, p99.9 %.1e, max %.1e\n", what,
	    count, errors[count / 2], p99, errors[count * 999 / 1000],
	    errors[count - 1]);
	return p99;
}

/* Of trees with `nested` angle-dependent compositions, the p99 error of the
 * gradient (order 1) or the Hessian (2). */
static double nested_error(const char *what, int nested, int order)
{
	double *errors = malloc(TREES * POINTS * sizeof(*errors)), p99;
	unsigned outputs = order == 1 ? OUTPUT_GRADIENT : OUTPUT_HESSIAN;
	int size = order == 1 ? 3 : 6;
	size_t count = 0;

	assert_non_null(errors);
	for (uint64_t seed = 1; seed <= TREES; seed++) {
		struct random_tree_options o = {.seed = 1000 + seed,
			.nested = nested};
		struct sample s = sample_create(&o);
		struct jet jet;

		run(&s, outputs);
		for (int i = 0; i < POINTS; i++) {
			exact(&s, (size_t)i, order, &jet);
			errors[count++] = relative_error(order == 1 ?
			    &jet.gradient.x : &jet.hessian.xx,
			    s.rows + i * size, size, 1e-3);
		}
		sample_free(&s);
	}
	p99 = percentile(what, errors, count);
	free(errors);
	return p99;
}

static void test_accuracy_gradients_of_one_composition(void **state)
{
	(void)state;
	assert_true(nested_error("gradient, one composition", 1, 1) <= 0.01);
}

static void test_accuracy_gradients_of_two_nested(void **state)
{
	(void)state;
	assert_true(nested_error("gradient, two nested", 2, 1) <= 0.05);
}

static void test_accuracy_hessians_of_one_composition(void **state)
{
	(void)state;
	assert_true(nested_error("Hessian, one composition", 1, 2) <= 0.1);
}

/*
 * Columns of the whole language's rows: where each begins, its length, what
 * keeps 0 from counting, and what its relative error's median and p99 are held
 * within: four times what was measured, or more.
 */
static const struct column {
	const char *name;
	int at, size;
	double least, median, p99;
} columns[] = {
	/* measured 2.1e-7, 1.1e-3 */
	{"whole language: gradient", 1, 3, 1e-3, 2e-6, 5e-3},
	/* 3.5e-7, 9.0e-3 */
	{"whole language: Hessian", 4, 6, 1e-3, 3e-6, 4e-2},
	/* 2.1e-7, 6.0e-4 */
	{"whole language: normal", 13, 3, 0.0, 2e-6, 3e-3},
	/* 9.2e-7, 1.4e-2 */
	{"whole language: mean curvature", 16, 1, 1e-1, 1e-5, 6e-2},
	/* 1.8e-6, 1.9e-2 */
	{"whole language: Gaussian curvature", 17, 1, 1e-1, 2e-5, 8e-2},
};

#define COLUMNS (sizeof(columns) / sizeof(columns[0]))

struct errors {
	double *list;
	size_t count;
};

/*
 * Whether jet's level set has a normal and a curvature in float32: the field
 * falls over its size (that of these trees is about 1) and is no fold, whose
 * Hessian may be anything.
 */
static bool is_conditioned(const struct jet *jet)
{
	const struct sym3 *h = &jet->hessian;
	double bend = fabs(h->xx) + fabs(h->yy) + fabs(h->zz) +
	    fabs(h->xy) + fabs(h->xz) + fabs(h->yz);

	return jet->value > 0.05 && vec3_norm(jet->gradient) > 0.05 &&
	    bend < 100.0 * vec3_norm(jet->gradient);
}

/* Trees for rows and colours, whose errors are percentiles. */
#define ROW_TREES (TREES / 8)

/* The row of OUTPUT_ALL in float64. */
static void exact_row(const struct sample *s, size_t i, struct jet *jet,
    double row[static OUTPUT_ROW_MAX])
{
	struct vec3 normal;

	exact(s, i, 2, jet);
	normal = surface_normal(jet);
	row[0] = jet->value;
	memcpy(row + 1, &jet->gradient, 3 * sizeof(*row));
	memcpy(row + 4, &jet->hessian, 6 * sizeof(*row));
	memcpy(row + 13, &normal, 3 * sizeof(*row));
	surface_curvature(jet, row + 16, row + 17);
}

static void add_row(const struct sample *s, size_t i,
    struct errors errors[static COLUMNS])
{
	const float *got = s->rows + i * OUTPUT_ROW_MAX;
	double want[OUTPUT_ROW_MAX];
	struct jet jet;

	exact_row(s, i, &jet, want);
	for (size_t k = 0; k < COLUMNS; k++) {
		const struct column *c = columns + k;

		if (c->at < 10 || is_conditioned(&jet))
			errors[k].list[errors[k].count++] = relative_error(
			    want + c->at, got + c->at, c->size, c->least);
	}
}

static void test_accuracy_rows_of_the_whole_language(void **state)
{
	struct errors errors[COLUMNS] = {{0}};

	(void)state;
	for (size_t k = 0; k < COLUMNS; k++) {
		errors[k].list = malloc(ROW_TREES * POINTS * sizeof(double));
		assert_non_null(errors[k].list);
	}
	for (uint64_t seed = 1; seed <= ROW_TREES; seed++) {
		struct random_tree_options o = {.seed = 2000 + seed,
			.whole = true};
		struct sample s = sample_create(&o);

		run(&s, OUTPUT_ALL);
		for (size_t i = 0; i < POINTS; i++)
			add_row(&s, i, errors);
		sample_free(&s);
	}
	for (size_t k = 0; k < COLUMNS; k++) {
		struct errors *e = errors + k;

		assert_true(percentile(columns[k].name, e->list, e->count) <=
		    columns[k].p99);
		assert_true(e->list[e->count / 2] <= columns[k].median);
		free(e->list);
	}
}

static void test_accuracy_colors(void **state)
{
	double *errors = malloc(ROW_TREES * POINTS * sizeof(*errors));
	size_t count = 0;

	(void)state;
	assert_non_null(errors);
	for (uint64_t seed = 1; seed <= ROW_TREES; seed++) {
		struct random_tree_options o = {.seed = 3000 + seed,
			.whole = true};
		struct sample s = sample_create(&o);

		run(&s, OUTPUT_COLOR);
		for (size_t i = 0; i < POINTS; i++) {
			const float *p = s.xyz + 3 * i, *got = s.rows + 3 * i;
			struct vec3 want;

			evaluate_color(s.tape, vec3(p[0], p[1], p[2]), &want);
			errors[count++] = vec3_norm(vec3_sub(want,
			    vec3(got[0], got[1], got[2])));
		}
		sample_free(&s);
	}
	/* Measured p99 5.3e-6. The largest, 6e-3, is where both operands are
	 * nearly as 0 as the rule's 1e-6: there a share turns from 0 to 1 within
	 * 1e-3 of a value. */
	assert_true(percentile("whole language: color", errors, count) <= 3e-5);
	assert_true(errors[count - 1] <= 3e-2);
	free(errors);
}

int main(void)
{
	const struct CMUnitTest tests[] = {
		cmocka_unit_test(test_accuracy_values_at_every_order),
		cmocka_unit_test(test_accuracy_values_of_the_whole_language),
		cmocka_unit_test(test_accuracy_rows_of_the_whole_language),
		cmocka_unit_test(test_accuracy_colors),
		cmocka_unit_test(test_accuracy_gradients_of_one_composition),
		cmocka_unit_test(test_accuracy_gradients_of_two_nested),
		cmocka_unit_test(test_accuracy_hessians_of_one_composition),
	};

	return cmocka_run_group_tests(tests, setup, teardown);
}
