/*
 * The device's table lookups against the same lookups in float64
 * (core/table.c): both layouts and families, tables of several sizes side by
 * side, in buffers and in images, every derivative.
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

	if (device_open(options, &device, &failure) == ERR_INVALID) {
		print_message("%s: %s\n", what, failure.message);
		device_failure_fini(&failure);
		skip();
	}
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
	/* Measured: 8e-7, 7e-6, 1.3e-4 at most. */
	assert_true(worst[0] < 1e-5);
	assert_true(worst[1] < 1e-4);
	assert_true(worst[2] < 2e-3);
}

static void test_lookup_in_buffers(void **state)
{
	(void)state;
	check_lookups(&(struct device_options){.width = 16,
	    .tables = DEVICE_TABLES_BUFFER}, "buffers, width 16");
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
	check_lookups(&(struct device_options){.width = 16,
	    .tables = DEVICE_TABLES_IMAGE}, "images, width 16");
}

int main(void)
{
	const struct CMUnitTest tests[] = {
		cmocka_unit_test(test_lookup_in_buffers),
		cmocka_unit_test(test_lookup_in_buffers_one_by_one),
		cmocka_unit_test(test_lookup_in_images),
	};

	return cmocka_run_group_tests_name("lookup", tests, NULL, NULL);
}
