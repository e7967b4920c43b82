/*
 * The device's table lookups against the same lookups in float64
 * (core/table.c): both layouts and families, tables of several sizes side by
 * side, in buffers and in images, every derivative. And what they may not depend
 * on: operands of 0, and the other points of a work-item.
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
#include "kernels/device.h"
#include "proto/document.h"
#include "proto/fault.h"
#include "tests/support/random_tree.h"
#include "tests/support/widest.h"

#define POINTS 4000
#define ROW 10
#define CASES 16

/* Two crossing bars, whose fields exceed 1, under one operator. */
static const char bars[] =
	"{\"type\":\"segment\",\"a\":[-1,0,0],\"b\":[1,0,0],\"radius\":0.5,"
	"\"weight\":1.3},"
	"{\"type\":\"segment\",\"a\":[0,-1,0.3],\"b\":[0,1,0.3],\"radius\":0.5,"
	"\"weight\":1.3}";

struct fixture {
	struct document *document;
	struct table *table;
	struct device_tape *tape;
	int slot;
};

static struct document *parse(const char *root)
{
	struct document_limits limits = {.max_nodes = 100,
	    .layout = LAYOUT_WARPED};
	struct faults faults = {0};
	struct document *d;
	char text[1024];

	snprintf(text, sizeof(text), "{\"format\":\"blobfield/1\",\"root\":%s}",
	    root);
	if (document_parse(text, strlen(text), &limits, &d, &faults))
		fail_msg("%s: %s", faults.list[0].pointer, faults.list[0].detail);
	return d;
}

/* Case i: bit 0 the family, 1 the profile, 2 the layout, 3 which theta. */
static void load(struct device *device, int i, struct fixture *out)
{
	const struct operator *op;
	char root[1024];

	snprintf(root, sizeof(root), "{\"type\":\"%s\",\"operator\":{\"profile\":"
	    "{\"type\":\"%s\"},\"opening\":{\"theta\":%g},\"layout\":\"%s\","
	    "\"resolution\":%d},\"children\":[%s]}",
	    i & 1 ? "intersection" : "union", i & 2 ? "bulge" : "smooth",
	    i & 8 ? 0.5 : 0.2, i & 4 ? "uniform" : "warped", i & 8 ? 33 : 20,
	    bars);
	out->document = parse(root);
	op = document_tape(out->document)->operators;
	assert_int_equal(table_create(op->family, &op->profile, op->layout,
	    op->resolution, &out->table), ERR_OK);
	table_build(out->table, 0, op->resolution);
	assert_int_equal(device_load_table(device, out->table, &out->slot),
	    ERR_OK);
	assert_int_equal(device_load_tape(device, document_tape(out->document),
	    &out->slot, &out->tape), ERR_OK);
}

static void unload(struct device *device, struct fixture *f)
{
	device_drop_tape(device, f->tape);
	device_drop_table(device, f->slot);
	table_free(f->table);
	document_free(f->document);
}

/* The composition of two jets at a constant theta, by table_lookup. */
static void compose(const struct table *t, double theta, const struct jet *a,
    const struct jet *b, struct jet *out)
{
	struct operator_jet j;
	struct sym3 h;

	table_lookup(t, a->value, b->value, theta, 2, &j);
	h = sym3_axpy(j.g2, b->hessian, sym3_scale(j.g1, a->hessian));
	h = sym3_axpy(j.g11, sym3_square(a->gradient), h);
	h = sym3_axpy(j.g22, sym3_square(b->gradient), h);
	out->hessian = sym3_axpy(j.g12, sym3_product(a->gradient, b->gradient),
	    h);
	out->value = j.g;
	out->gradient = vec3_axpy(j.g2, b->gradient,
	    vec3_scale(j.g1, a->gradient));
}

static int by_size(const void *a, const void *b)
{
	double x = *(const double *)a, y = *(const double *)b;

	return (x > y) - (x < y);
}

/* Largest |value|, and 99th percentiles of gradient and Hessian, each relative
 * to 1 + its own size. */
static void compare(struct device *device, const struct fixture *f,
    const float *xyz, double out[static 3])
{
	static double gradients[POINTS], hessians[POINTS];
	static float rows[POINTS * ROW];
	const struct tape *tape = document_tape(f->document);
	double theta = tape->operators->opening.theta[0];
	struct document *bar[2] = {parse("{\"type\":\"segment\",\"a\":[-1,0,0],"
	    "\"b\":[1,0,0],\"radius\":0.5,\"weight\":1.3}"),
	    parse("{\"type\":\"segment\",\"a\":[0,-1,0.3],\"b\":[0,1,0.3],"
	    "\"radius\":0.5,\"weight\":1.3}")};
	size_t count = 0;

	assert_int_equal(device_evaluate(device, f->tape, xyz, POINTS,
	    OUTPUT_VALUE | OUTPUT_GRADIENT | OUTPUT_HESSIAN, rows, NULL, NULL),
	    ERR_OK);
	out[0] = 0.0;
	for (size_t i = 0; i < POINTS; i++) {
		struct vec3 p = vec3(xyz[3 * i], xyz[3 * i + 1], xyz[3 * i + 2]);
		const float *row = rows + ROW * i;
		struct jet a, b, want;
		double size[2] = {1.0, 1.0}, off[2] = {0.0, 0.0};

		evaluate(document_tape(bar[0]), p, 2, &a);
		evaluate(document_tape(bar[1]), p, 2, &b);
		if (!(a.value > 0.0 && b.value > 0.0))
			continue;
		compose(f->table, theta, &a, &b, &want);
		out[0] = fmax(out[0], fabs(want.value - row[0]));
		for (int k = 0; k < 9; k++) {
			double exact = k < 3 ? (&want.gradient.x)[k] :
			    (&want.hessian.xx)[k - 3];

			size[k >= 3] += fabs(exact);
			off[k >= 3] += fabs(exact - row[1 + k]);
		}
		gradients[count] = off[0] / size[0];
		hessians[count++] = off[1] / size[1];
	}
	assert_true(count > POINTS / 4);
	qsort(gradients, count, sizeof(*gradients), by_size);
	qsort(hessians, count, sizeof(*hessians), by_size);
	out[1] = gradients[count * 99 / 100];
	out[2] = hessians[count * 99 / 100];
	document_free(bar[0]);
	document_free(bar[1]);
}

/* All cases resident at once, so that tables lie beside each other. */
static void check_lookups(const struct device_options *options,
    const char *what)
{
	static float xyz[3 * POINTS];
	static struct fixture fixtures[CASES];
	struct random_stream random = {7};
	struct device_failure failure = {0};
	double worst[3] = {0.0};
	struct device *device;
	bool is_coarse;

	if (device_open(options, &device, &failure) == ERR_INVALID) {
		print_message("%s: %s\n", what, failure.message);
		device_failure_fini(&failure);
		skip();
	}
	is_coarse = device_get_info(device)->is_gpu &&
	    options->tables == DEVICE_TABLES_IMAGE;
	for (int i = 0; i < 3 * POINTS; i++)
		xyz[i] = (float)random_in(&random, -1.2, 1.2);
	for (int i = 0; i < CASES; i++)
		load(device, i, &fixtures[i]);
	for (int i = 0; i < CASES; i++) {
		double off[3];

		compare(device, &fixtures[i], xyz, off);
		for (int k = 0; k < 3; k++)
			worst[k] = fmax(worst[k], off[k]);
	}
	for (int i = 0; i < CASES; i++)
		unload(device, &fixtures[i]);
	device_close(device);
	print_message("measured: lookups in %s against float64: value %.1e, "
	    "gradient p99 %.1e, Hessian p99 %.1e\n", what, worst[0], worst[1],
	    worst[2]);
	/* Weights of 8 bits, NVIDIA H100: 2.7e-4, 3.7e-3, 0.4. */
	if (is_coarse) {
		assert_true(worst[0] < 1e-3);
		assert_true(worst[1] < 1e-2);
		return;
	}
	/* Measured: 8e-7, 7e-6, 1.3e-4 at most. */
	assert_true(worst[0] < 1e-5);
	assert_true(worst[1] < 1e-4);
	assert_true(worst[2] < 2e-3);
}

static void test_lookup_in_buffers(void **state)
{
	(void)state;
	check_lookups(&(struct device_options){.width = widest(),
	    .tables = DEVICE_TABLES_BUFFER}, "buffers, widest");
}

static void test_lookup_in_buffers_one_by_one(void **state)
{
	(void)state;
	check_lookups(&(struct device_options){.width = 1,
	    .tables = DEVICE_TABLES_BUFFER}, "buffers, width 1");
}

static void test_lookup_in_images(void **state)
{
	(void)state;
	check_lookups(&(struct device_options){.width = widest(),
	    .tables = DEVICE_TABLES_IMAGE}, "images, widest");
}

/* --- operands of 0 ---------------------------------------------------------- */

/* One ball, and another far beyond the reach of every point below. */
#define BALL "{\"type\":\"point\",\"center\":[0,0,0],\"radius\":0.5}"
#define FAR "{\"type\":\"point\",\"center\":[50,0,0],\"radius\":0.5}"
/* One whose field underflows to 0 well within its support. */
#define FAINT "{\"type\":\"point\",\"center\":[0,0,0],\"radius\":0.2," \
	"\"exponent\":90}"
/* And one that meets the ball in a part of the points. */
#define NEAR "{\"type\":\"point\",\"center\":[0.5,0,0],\"radius\":0.5}"

/* The tables so far: each is built once, for all pairs and widths. */
#define BUILT_MAX 16

static struct {
	struct operator op;
	struct table *table;
} built[BUILT_MAX];

static int built_count;

static const struct table *table_of(const struct operator *op)
{
	struct table *table;

	for (int i = 0; i < built_count; i++)
		if (built[i].op.family == op->family &&
		    built[i].op.layout == op->layout &&
		    built[i].op.resolution == op->resolution &&
		    profile_equal(&built[i].op.profile, &op->profile))
			return built[i].table;
	assert_true(built_count < BUILT_MAX);
	assert_int_equal(table_create(op->family, &op->profile, op->layout,
	    op->resolution, &table), ERR_OK);
	table_build(table, 0, op->resolution);
	built[built_count].op = *op;
	built[built_count++].table = table;
	return table;
}

static void free_tables(void)
{
	while (built_count > 0)
		table_free(built[--built_count].table);
}

static struct device_tape *load_root(struct device *device, const char *root,
    int *slot)
{
	struct document *d = parse(root);
	const struct tape *tape = document_tape(d);
	struct device_tape *out;

	if (tape->operator_count > 0)
		assert_int_equal(device_load_table(device,
		    table_of(tape->operators), slot), ERR_OK);
	assert_int_equal(device_load_tape(device, tape, slot, &out), ERR_OK);
	document_free(d);
	return out;
}

/* The rows of root at xyz. */
static void rows_of(struct device *device, const char *root, const float *xyz,
    float *rows)
{
	int slot = -1;
	struct device_tape *tape = load_root(device, root, &slot);

	assert_int_equal(device_evaluate(device, tape, xyz, POINTS,
	    OUTPUT_VALUE | OUTPUT_GRADIENT | OUTPUT_HESSIAN, rows, NULL, NULL),
	    ERR_OK);
	device_drop_tape(device, tape);
	if (slot >= 0)
		device_drop_table(device, slot);
}

static const char *const openings[] = {"\"camel\"",
	"{\"profile\":{\"type\":\"smooth\"},\"opening\":{\"theta\":0.3},"
	"\"layout\":\"uniform\",\"resolution\":20}",
	"{\"profile\":{\"type\":\"bulge\"},\"opening\":{\"theta\":0.3},"
	"\"resolution\":20}",
	"\"clean\"", "\"sharp\""};

#define OPENINGS (sizeof(openings) / sizeof(*openings))

static void expect_rows(struct device *device, const char *root,
    const float *xyz, const float *want)
{
	static float rows[POINTS * ROW];

	rows_of(device, root, xyz, rows);
	for (int i = 0; i < POINTS * ROW; i++)
		if (memcmp(rows + i, want + i, sizeof(float)) != 0)
			fail_msg("%s: column %d is %.9g, not %.9g", root,
			    i % ROW, (double)rows[i], (double)want[i]);
}

/* A pair either way round, of which the second's field is 0 everywhere. */
static void check_zero(struct device *device, const char *type,
    const char *first, const char *second, const float *xyz,
    const float *want)
{
	char root[1024];

	snprintf(root, sizeof(root), "{%s,\"children\":[%s,%s]}", type, first,
	    second);
	expect_rows(device, root, xyz, want);
	snprintf(root, sizeof(root), "{%s,\"children\":[%s,%s]}", type, second,
	    first);
	expect_rows(device, root, xyz, want);
}

static void check_zeros(int width)
{
	static float xyz[3 * POINTS], ball[POINTS * ROW], faint[POINTS * ROW];
	static const float nothing[POINTS * ROW];
	static const char *const plain[] = {"\"type\":\"sum\"",
		"\"type\":\"ricci\",\"n\":1", "\"type\":\"ricci\",\"n\":1.25",
		"\"type\":\"ricci\",\"n\":2", "\"type\":\"ricci\",\"n\":1000"};
	struct random_stream random = {11};
	struct device_failure failure = {0};
	struct device *device;
	char type[512];

	assert_int_equal(device_open(&(struct device_options){.width = width,
	    .tables = DEVICE_TABLES_BUFFER}, &device, &failure), ERR_OK);
	for (int i = 0; i < 3 * POINTS; i++)
		xyz[i] = (float)random_in(&random, -1.2, 1.2);
	rows_of(device, BALL, xyz, ball);
	rows_of(device, FAINT, xyz, faint);
	for (size_t i = 0; i < sizeof(plain) / sizeof(*plain); i++) {
		check_zero(device, plain[i], BALL, FAR, xyz, ball);
		check_zero(device, plain[i], FAINT, FAR, xyz, faint);
	}
	for (size_t i = 0; i < OPENINGS; i++) {
		snprintf(type, sizeof(type), "\"type\":\"union\","
		    "\"operator\":%s", openings[i]);
		check_zero(device, type, BALL, FAR, xyz, ball);
		check_zero(device, type, FAINT, FAR, xyz, faint);
		if (i == 0)
			continue; /* camel is a union only */
		snprintf(type, sizeof(type), "\"type\":\"intersection\","
		    "\"operator\":%s", openings[i]);
		check_zero(device, type, BALL, FAR, xyz, nothing);
	}
	device_close(device);
}

static void test_operand_of_zero_leaves_the_other_or_zero(void **state)
{
	(void)state;
	check_zeros(widest());
}

static void test_operand_of_zero_one_by_one(void **state)
{
	(void)state;
	check_zeros(1);
}

static int teardown(void **state)
{
	(void)state;
	free_tables();
	return 0;
}

/*
 * The points in two orders: at random, so that every work-item has lanes that
 * blend, lanes that do not and lanes of 0, and sorted by x, so that many have
 * lanes of one kind alone.
 */
static void check_neighbours(struct device *device, const char *root)
{
	static float xyz[3 * POINTS], sorted[3 * POINTS];
	static float rows[POINTS * ROW], again[POINTS * ROW];
	struct random_stream random = {13};

	for (int i = 0; i < POINTS; i++) {
		sorted[3 * i] = (float)(i * (2.4 / POINTS) - 1.2);
		sorted[3 * i + 1] = (float)random_in(&random, -0.6, 0.6);
		sorted[3 * i + 2] = (float)random_in(&random, -0.6, 0.6);
	}
	/* 1409 is prime to POINTS. */
	for (int i = 0; i < POINTS; i++)
		memcpy(xyz + 3 * (i * 1409 % POINTS), sorted + 3 * i,
		    3 * sizeof(*xyz));
	rows_of(device, root, sorted, rows);
	rows_of(device, root, xyz, again);
	for (int i = 0; i < POINTS; i++)
		assert_memory_equal(rows + ROW * i, again + ROW *
		    (i * 1409 % POINTS), ROW * sizeof(*rows));
}

static void test_lanes_do_not_depend_on_their_neighbours(void **state)
{
	struct device_failure failure = {0};
	struct device *device;
	char root[1024];

	(void)state;
	assert_int_equal(device_open(&(struct device_options){.width = widest(),
	    .tables = DEVICE_TABLES_BUFFER}, &device, &failure), ERR_OK);
	for (size_t i = 0; i < OPENINGS; i++)
		for (int k = i == 0 ? 2 : 0; k < 3; k++) {
			static const char *const types[] = {"intersection",
				"difference", "union"};

			snprintf(root, sizeof(root), "{\"type\":\"%s\","
			    "\"operator\":%s,\"children\":[%s,%s]}", types[k],
			    openings[i], BALL, NEAR);
			check_neighbours(device, root);
		}
	check_neighbours(device, "{\"type\":\"ricci\",\"n\":3,\"children\":["
	    BALL "," NEAR "]}");
	device_close(device);
}

int main(void)
{
	const struct CMUnitTest tests[] = {
		cmocka_unit_test(test_lookup_in_buffers),
		cmocka_unit_test(test_lookup_in_buffers_one_by_one),
		cmocka_unit_test(test_lookup_in_images),
		cmocka_unit_test(test_operand_of_zero_leaves_the_other_or_zero),
		cmocka_unit_test(test_operand_of_zero_one_by_one),
		cmocka_unit_test(test_lanes_do_not_depend_on_their_neighbours),
	};

	return cmocka_run_group_tests_name("lookup", tests, NULL, teardown);
}
