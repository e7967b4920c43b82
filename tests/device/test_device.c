/* Devices: listing, opening, refusing, batches of every size, tables. */
#include <math.h>
#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include <cmocka.h>

#include "core/classic.h"
#include "core/output.h"
#include "core/table.h"
#include "core/tape.h"
#include "core/tree.h"
#include "core/warp.h"
#include "kernels/device_internal.h"
#include "tests/support/widest.h"

#define POINTS 65793 /* a whole piece, a whole group and one more */
#define ROW OUTPUT_ROW_MAX
#define JET (OUTPUT_VALUE | OUTPUT_GRADIENT | OUTPUT_HESSIAN)
#define JET_ROW 10
#define TABLE_NODES 16 /* an axis; small tables are built soon */

static struct device *device;
static float points[POINTS * 3], whole[POINTS * ROW], rows[POINTS * ROW + 1];

static struct device *open_device(const struct device_options *options)
{
	struct device_failure failure = {0};
	struct device *d = NULL;
	enum err err = device_open(options, &d, &failure);

	if (err)
		printf("%s\n%s\n", failure.message,
		    failure.build_log ? failure.build_log : "");
	assert_int_equal(err, ERR_OK);
	device_failure_fini(&failure);
	return d;
}

/* Points all over [-1.5, 1.5]^3, the same at every run. */
static void make_points(void)
{
	uint32_t state = 1;

	for (size_t i = 0; i < POINTS * 3; i++) {
		state = state * 1664525u + 1013904223u;
		points[i] = (float)(state >> 8) / 16777216.0f * 3.0f - 1.5f;
	}
}

static int setup(void **state)
{
	struct device_options options = {0};

	(void)state;
	make_points();
	device = open_device(&options);
	return 0;
}

static int teardown(void **state)
{
	(void)state;
	device_close(device);
	return 0;
}

/* A tape by hand, its arrays within. */
struct small {
	struct insn insns[3 * TAPE_WARPS_MAX];
	double params[1024];
	struct operator op;
	struct tape tape;
};

static void add(struct small *s, uint32_t op, uint32_t extra, size_t count,
    const double *params)
{
	s->insns[s->tape.insn_count++] = (struct insn){op, extra,
		count ? (uint32_t)s->tape.param_count : 0, 0};
	if (count)
		memcpy(s->params + s->tape.param_count, params,
		    count * sizeof(*params));
	s->tape.param_count += count;
}

/* Two balls and a box, joined by op of one operator, then by a sum. */
static void make_tape(struct small *s, uint32_t op, const char *opening)
{
	uint32_t extra = 1;

	memset(s, 0, sizeof(*s));
	s->op.family = op == OP_UNION ? FAMILY_UNION : FAMILY_INTERSECTION;
	s->op.profile = profile_smooth();
	s->op.layout = LAYOUT_WARPED;
	s->op.resolution = TABLE_NODES;
	s->tape = (struct tape){.insns = s->insns, .params = s->params};
	if (op >= OP_UNION) {
		s->tape.operators = &s->op;
		s->tape.operator_count = 1;
		assert_true(opening_named(opening, &s->op.opening));
	} else {
		extra = 0;
	}
	add(s, OP_POINT, extra, 6,
	    (const double[]){-0.4, 0.1, 0.0, 1.0, 3.0, 1.0});
	add(s, OP_POINT, extra, 6,
	    (const double[]){0.4, -0.1, 0.2, 1.2, 4.0, 0.9});
	add(s, op, 0, 1, (const double[]){1e-3});
	add(s, OP_BOX, 0, 8,
	    (const double[]){0.0, 0.0, 0.8, 0.3, 0.2, 0.1, 0.05, 2.0});
	add(s, OP_SUM, 0, 0, NULL);
}

static int load_table(struct device *d, const struct operator *op)
{
	struct table *table;
	int slot = -1;

	assert_int_equal(table_create(op->family, &op->profile, op->layout,
	    op->resolution, &table), ERR_OK);
	table_build(table, 0, op->resolution);
	assert_int_equal(device_load_table(d, table, &slot), ERR_OK);
	table_free(table);
	return slot;
}

/* Loads s, with its operator's table if it has one. */
static struct device_tape *load(struct device *d, struct small *s, int *slot)
{
	struct device_tape *t = NULL;

	*slot = s->tape.operator_count ? load_table(d, &s->op) : -1;
	assert_int_equal(device_load_tape(d, &s->tape, slot, &t), ERR_OK);
	return t;
}

static void unload(struct device *d, struct device_tape *t, int slot)
{
	device_drop_tape(d, t);
	if (slot >= 0)
		device_drop_table(d, slot);
}

static void count_device(void *ctx, int index, const struct device_info *info)
{
	int *count = ctx;

	assert_int_equal(index, *count);
	assert_true(info->name[0] != '\0');
	assert_true(info->compute_units > 0);
	assert_true(info->memory_bytes > 0);
	assert_int_equal(info->width, 0);
	++*count;
}

static void test_device_list_has_the_open_one(void **state)
{
	struct device_failure failure = {0};
	int count = 0;

	(void)state;
	assert_int_equal(device_list(count_device, &count, &failure), ERR_OK);
	assert_true(count >= 1);
	device_failure_fini(&failure);
}

static void test_device_opens_by_index_and_name(void **state)
{
	const struct device_info *info = device_get_info(device);
	char part[16];
	const char *selects[] = {"0", part, "OPENCL"};

	(void)state;
	snprintf(part, sizeof(part), "%.10s", info->name);
	for (size_t i = 0; i < sizeof(selects) / sizeof(selects[0]); i++) {
		struct device_options options = {.select = selects[i]};
		struct device *d = open_device(&options);

		assert_true(device_get_info(d)->name[0] != '\0');
		device_close(d);
	}
}

static void check_refused(const struct device_options *options, enum err want,
    const char *word)
{
	struct device_failure failure = {0};
	struct device *d = NULL;

	assert_int_equal(device_open(options, &d, &failure), want);
	assert_null(d);
	assert_non_null(strstr(failure.message, word));
	device_failure_fini(&failure);
}

static void test_device_refuses_unknown_name_and_index(void **state)
{
	(void)state;
	check_refused(&(struct device_options){.select = "no such device"},
	    ERR_NOT_FOUND, "no such device");
	check_refused(&(struct device_options){.select = "99"}, ERR_NOT_FOUND,
	    "99");
	check_refused(&(struct device_options){
	    .select = "99999999999999999999"}, ERR_NOT_FOUND, "9999");
}

static void test_device_refuses_a_width_that_is_none(void **state)
{
	(void)state;
	check_refused(&(struct device_options){.width = 3}, ERR_INVALID,
	    "width 3");
	check_refused(&(struct device_options){.width = -1}, ERR_INVALID,
	    "width -1");
}

static void test_device_build_failure_brings_the_log(void **state)
{
	struct device_failure failure = {0};
	cl_program program = NULL;

	(void)state;
	assert_int_equal(device_build(device->context, device->id,
	    "#line 7 \"kernels/broken.cl\"\n__kernel void f(__global int *p)"
	    " { *p = undeclared_name; }\n", "-cl-std=CL1.2", &program,
	    &failure), ERR_DEVICE_BUILD);
	assert_null(program);
	assert_non_null(strstr(failure.message, "CL_BUILD_PROGRAM_FAILURE"));
	assert_non_null(failure.build_log);
	assert_non_null(strstr(failure.build_log, "undeclared_name"));
	/* NVIDIA's compiler says "<kernel>" and a line of its own. */
	if (!device_get_info(device)->is_gpu)
		assert_non_null(strstr(failure.build_log,
		    "kernels/broken.cl"));
	device_failure_fini(&failure);
	assert_null(failure.build_log);
}

static void test_device_names_error_codes(void **state)
{
	(void)state;
	assert_string_equal(device_code_name(CL_OUT_OF_RESOURCES),
	    "CL_OUT_OF_RESOURCES");
	assert_string_equal(device_code_name(-1001),
	    "CL_PLATFORM_NOT_FOUND_KHR");
	assert_string_equal(device_code_name(-9999), "an unknown error");
}

/* Breaks a good tape at one place and expects it refused. */
static void check_bad_tape(void (*spoil)(struct small *s), const char *word)
{
	struct device_tape *t = NULL;
	struct small s;
	int slot;

	make_tape(&s, OP_UNION, "camel");
	slot = load_table(device, &s.op);
	spoil(&s);
	assert_int_equal(device_load_tape(device, &s.tape, &slot, &t),
	    ERR_INVALID);
	assert_null(t);
	assert_non_null(strstr(device_message(device), word));
	device_drop_table(device, slot);
}

static void spoil_opcode(struct small *s)
{
	s->insns[0].op = OP_COUNT;
}

static void spoil_extra(struct small *s)
{
	s->insns[0].extra = 3;
}

static void spoil_param(struct small *s)
{
	s->insns[3].param = (uint32_t)s->tape.param_count - 7;
}

static void spoil_param_wraps(struct small *s)
{
	s->insns[3].param = UINT32_MAX;
}

/* A sum has no parameters, but its place for them must be there. */
static void spoil_last_param(struct small *s)
{
	s->insns[4].param = (uint32_t)s->tape.param_count;
}

/* An opening by the angle needs its operands' gradients. */
static void spoil_order(struct small *s)
{
	s->insns[1].extra = 0;
}

/* What only pruning leaves. */
static void spoil_zero(struct small *s)
{
	s->insns[0].op = OP_ZERO;
}

/* A run of more points than follow, of none that is followed by a sum. */
static void spoil_run_length(struct small *s)
{
	s->insns[0].index = 3;
}

static void spoil_run(struct small *s)
{
	s->insns[0].index = 1;
}

static void spoil_index(struct small *s)
{
	s->insns[2].index = 1;
}

static void spoil_underflow(struct small *s)
{
	s->insns[1].op = OP_SUM;
}

static void spoil_leftover(struct small *s)
{
	s->tape.insn_count--;
}

static void spoil_empty(struct small *s)
{
	s->tape.insn_count = 0;
}

static void test_device_refuses_bad_tapes(void **state)
{
	(void)state;
	check_bad_tape(spoil_opcode, "instruction 0 of the tape has an unknown");
	check_bad_tape(spoil_extra, "order");
	check_bad_tape(spoil_param, "instruction 3");
	check_bad_tape(spoil_param_wraps, "beyond the last");
	check_bad_tape(spoil_last_param, "instruction 4");
	check_bad_tape(spoil_order, "more derivatives");
	check_bad_tape(spoil_index, "operator");
	check_bad_tape(spoil_zero, "by pruning only");
	check_bad_tape(spoil_run_length, "a run beyond the last");
	check_bad_tape(spoil_run, "a run of other things");
	check_bad_tape(spoil_underflow, "too few jets");
	check_bad_tape(spoil_leftover, "leaves 2 jets");
	check_bad_tape(spoil_empty, "leaves 0 jets");
}

/* A ball within as many warps of a type as wanted, in colour. */
static void make_warped(struct small *s, uint32_t type, int warps)
{
	const struct warp warp = {.type = type, .axis = {0.0, 0.0, 1.0},
		.direction = {1.0, 0.0, 0.0}, .has_range = true, .from = -1.0,
		.to = 1.0, .rate = 0.7, .scale = 0.5};
	double params[12 + WARP_PARAMS_MAX] = {1.0, 0.0, 0.0, 0.0, 1.0, 0.0,
		0.0, 0.0, 1.0, 0.0, 0.0, 0.0};

	memset(s, 0, sizeof(*s));
	s->tape = (struct tape){.insns = s->insns, .params = s->params};
	warp_prepare(&warp, params + 12);
	add(s, OP_COLOR, 0, 3, (const double[]){0.25, 0.5, 0.75});
	for (int i = 0; i < warps; i++)
		add(s, OP_ENTER, 0, 12 + WARP_PARAMS_MAX, params);
	add(s, OP_FRAME, 0, 12, params);
	add(s, OP_POINT, 0, 6,
	    (const double[]){-0.4, 0.1, 0.0, 1.0, 3.0, 1.0});
	for (int i = 0; i < warps; i++)
		add(s, OP_LEAVE, 0, 12 + WARP_PARAMS_MAX, params);
	for (size_t i = 0; i < s->tape.insn_count; i++)
		if (s->insns[i].op == OP_ENTER || s->insns[i].op == OP_LEAVE)
			s->insns[i].index = type;
}

static void check_bad_warped(int warps, void (*spoil)(struct small *s),
    const char *word)
{
	struct device_tape *t = NULL;
	struct small s;

	make_warped(&s, WARP_TWIST, warps);
	if (spoil)
		spoil(&s);
	assert_int_equal(device_load_tape(device, &s.tape, NULL, &t),
	    ERR_INVALID);
	assert_null(t);
	assert_non_null(strstr(device_message(device), word));
}

static void spoil_warp_type(struct small *s)
{
	s->insns[1].index = WARP_TYPE_COUNT;
}

static void spoil_other_warp(struct small *s)
{
	s->insns[4].index = WARP_BEND;
}

static void spoil_never_entered(struct small *s)
{
	s->insns[1].op = OP_FRAME;
}

static void spoil_never_left(struct small *s)
{
	s->insns[4].op = OP_CARRY;
}

static void spoil_left_first(struct small *s)
{
	s->insns[3].op = OP_FRAME;
}

static void spoil_warp_params(struct small *s)
{
	s->insns[4].param++;
}

static void spoil_color_params(struct small *s)
{
	s->insns[0].param = (uint32_t)s->tape.param_count - 2;
}

static void spoil_volume(struct small *s)
{
	s->insns[3].op = OP_VOLUME;
	s->insns[3].param = 0;
}

static void test_device_refuses_bad_warps(void **state)
{
	(void)state;
	check_bad_warped(1, spoil_warp_type, "not there");
	check_bad_warped(1, spoil_other_warp, "is not in");
	check_bad_warped(1, spoil_never_entered, "is not in");
	check_bad_warped(1, spoil_never_left, "in 1 warps");
	check_bad_warped(1, spoil_left_first, "too few jets");
	check_bad_warped(1, spoil_warp_params, "beyond the last");
	check_bad_warped(1, spoil_color_params, "beyond the last");
	check_bad_warped(1, spoil_volume, "not there");
	check_bad_warped(TAPE_WARPS_MAX + 1, NULL, "too many warps");
}

static void spoil_classic(struct small *s)
{
	s->insns[2].op = OP_CLASSIC;
	s->insns[2].index = CLASSIC_TYPE_COUNT;
	s->insns[2].param = 0;
}

static void spoil_classic_params(struct small *s)
{
	s->insns[2].op = OP_CLASSIC_SWAPPED;
	s->insns[2].index = 0;
	s->insns[2].param = (uint32_t)s->tape.param_count -
	    CLASSIC_PARAMS_MAX + 1;
}

static void test_device_refuses_bad_classics(void **state)
{
	(void)state;
	check_bad_tape(spoil_classic, "not there");
	check_bad_tape(spoil_classic_params, "beyond the last");
}

static void test_device_holds_the_deepest_warps(void **state)
{
	struct device_tape *t;
	struct small s;
	float row[4];
	int slot;

	(void)state;
	make_warped(&s, WARP_TWIST, TAPE_WARPS_MAX);
	t = load(device, &s, &slot);
	assert_int_equal(device_evaluate(device, t, (const float[]){0.1f, 0.2f,
	    0.3f}, 1, OUTPUT_VALUE | OUTPUT_COLOR, row, NULL, NULL), ERR_OK);
	assert_true(row[0] > 0.0f);
	assert_true(row[1] == 0.25f && row[2] == 0.5f && row[3] == 0.75f);
	unload(device, t, slot);
}

static void test_device_colors_what_has_none(void **state)
{
	struct device_tape *t;
	struct small s;
	float row[3];
	int slot;

	(void)state;
	make_tape(&s, OP_MAX, NULL);
	t = load(device, &s, &slot);
	assert_int_equal(device_evaluate(device, t, points, 1, OUTPUT_COLOR,
	    row, NULL, NULL), ERR_OK);
	for (int k = 0; k < 3; k++)
		assert_true(fabs((double)row[k] - TREE_COLOR_DEFAULT) < 1e-6);
	unload(device, t, slot);
}

static void test_device_refuses_a_stack_too_deep(void **state)
{
	const double params[] = {0.0, 0.0, 0.0, 1.0, 3.0, 1.0};
	struct insn insns[2 * TAPE_STACK_MAX + 1];
	struct tape tape = {.insns = insns, .params = (double *)params,
		.param_count = 6};
	struct device_tape *t = NULL;
	size_t n = 0;

	(void)state;
	for (int i = 0; i <= TAPE_STACK_MAX; i++)
		insns[n++] = (struct insn){OP_POINT, 0, 0, 0};
	for (int i = 0; i < TAPE_STACK_MAX; i++)
		insns[n++] = (struct insn){OP_SUM, 0, 0, 0};
	tape.insn_count = n;
	assert_int_equal(device_load_tape(device, &tape, NULL, &t),
	    ERR_INVALID);
	assert_non_null(strstr(device_message(device), "full"));
	/* One less fits. */
	tape.insns = insns + 1;
	tape.insn_count = n - 2;
	assert_int_equal(device_load_tape(device, &tape, NULL, &t), ERR_OK);
	device_drop_tape(device, t);
}

/* Points and sums in a row, marked as runs, give what they give one by one but
 * for rounding (a pair of a run is rounded once); and a run with another
 * exponent in it is refused. */
static void test_device_runs_of_points_are_their_sum(void **state)
{
	enum { N = 9 };
	struct device_tape *t;
	double most = 0.0;
	struct small s;
	int slot;

	(void)state;
	memset(&s, 0, sizeof(s));
	s.tape = (struct tape){.insns = s.insns, .params = s.params};
	for (int i = 0; i < N; i++) {
		add(&s, OP_POINT, 0, 6, (const double[]){0.2 * i - 0.8,
		    0.1 * i, 0.0, 1.0 + i, 3.0, 0.7});
		if (i > 0)
			add(&s, OP_SUM, 0, 0, NULL);
	}
	t = load(device, &s, &slot);
	assert_int_equal(device_evaluate(device, t, points, 1000, OUTPUT_ALL,
	    whole, NULL, NULL), ERR_OK);
	unload(device, t, slot);
	tape_mark_runs(s.insns, s.tape.insn_count, s.params);
	assert_int_equal(s.insns[1].index, N - 1);
	t = load(device, &s, &slot);
	assert_int_equal(device_evaluate(device, t, points, 1000, OUTPUT_ALL,
	    rows, NULL, NULL), ERR_OK);
	for (int i = 0; i < 1000 * ROW; i++)
		most = fmax(most, fabs((double)rows[i] - (double)whole[i]) /
		    fmax(1.0, fabs((double)whole[i])));
	printf("measured: %.1e\n", most);
	assert_true(most <= 1e-5); /* measured 1.0e-6 */
	unload(device, t, slot);
	s.params[6 * 5 + 4] = 4.0;
	assert_int_equal(device_load_tape(device, &s.tape, NULL, &t),
	    ERR_INVALID);
	assert_non_null(strstr(device_message(device), "a run of other"));
}

static void test_device_refuses_slots_that_do_not_suit(void **state)
{
	struct device_tape *t = NULL;
	struct small s;
	int slot, none = -1, beyond = 1000;

	(void)state;
	make_tape(&s, OP_UNION, "camel");
	slot = load_table(device, &s.op);
	assert_int_equal(device_load_tape(device, &s.tape, &none, &t),
	    ERR_INVALID);
	assert_int_equal(device_load_tape(device, &s.tape, &beyond, &t),
	    ERR_INVALID);
	s.op.family = FAMILY_INTERSECTION;
	assert_int_equal(device_load_tape(device, &s.tape, &slot, &t),
	    ERR_INVALID);
	s.op.family = FAMILY_UNION;
	s.op.profile = profile_bulge(0.5);
	assert_int_equal(device_load_tape(device, &s.tape, &slot, &t),
	    ERR_INVALID);
	s.op.profile = profile_smooth();
	s.op.layout = LAYOUT_UNIFORM;
	assert_int_equal(device_load_tape(device, &s.tape, &slot, &t),
	    ERR_INVALID);
	s.op.layout = LAYOUT_WARPED;
	/* A draft may stand in for a larger one. */
	s.op.resolution *= 4;
	assert_int_equal(device_load_tape(device, &s.tape, &slot, &t), ERR_OK);
	device_drop_tape(device, t);
	t = NULL;
	device_drop_table(device, slot);
	assert_int_equal(device_load_tape(device, &s.tape, &slot, &t),
	    ERR_INVALID);
}

/* A batch of count points gives the first count rows of the whole one, and
 * writes nothing beyond. */
static void check_batch(struct device_tape *t, size_t count, unsigned outputs)
{
	size_t stride = (size_t)output_row_floats(outputs);

	rows[count * stride] = -77.0f;
	assert_int_equal(device_evaluate(device, t, points, count, outputs,
	    rows, NULL, NULL), ERR_OK);
	assert_memory_equal(rows, whole, count * stride * sizeof(*rows));
	assert_true(rows[count * stride] == -77.0f);
}

static void check_batches(unsigned outputs)
{
	static const size_t counts[] = {1, 2, 15, 16, 17, 63, 64, 65, 255, 256,
		257, 4095, 4096, 4097, 65535, 65536, 65537, POINTS};
	struct device_tape *t;
	struct small s;
	int slot;

	make_tape(&s, OP_UNION, "camel");
	t = load(device, &s, &slot);
	assert_int_equal(device_evaluate(device, t, points, POINTS, outputs,
	    whole, NULL, NULL), ERR_OK);
	for (size_t i = 0; i < sizeof(counts) / sizeof(counts[0]); i++)
		check_batch(t, counts[i], outputs);
	unload(device, t, slot);
}

static void test_device_batches_of_every_size_agree(void **state)
{
	(void)state;
	check_batches(OUTPUT_VALUE);
	check_batches(OUTPUT_VALUE | OUTPUT_GRADIENT);
	check_batches(JET);
	check_batches(OUTPUT_ALL);
}

static void test_device_batch_of_none_writes_nothing(void **state)
{
	struct device_tape *t;
	struct small s;
	int slot;

	(void)state;
	make_tape(&s, OP_MAX, NULL);
	t = load(device, &s, &slot);
	rows[0] = -77.0f;
	assert_int_equal(device_evaluate(device, t, points, 0, OUTPUT_ALL,
	    rows, NULL, NULL), ERR_OK);
	assert_true(rows[0] == -77.0f);
	unload(device, t, slot);
}

/* Every combination of outputs picks columns of the full rows. */
static void test_device_outputs_are_columns_of_the_whole(void **state)
{
	static const int first[] = {0, 1, 4, 10, 13, 16};
	static const int width[] = {1, 3, 6, 3, 3, 2};
	enum { N = 300, KINDS = sizeof(first) / sizeof(first[0]) };
	struct device_tape *t;
	struct small s;
	int slot;

	(void)state;
	make_tape(&s, OP_MAX, NULL);
	t = load(device, &s, &slot);
	assert_int_equal(device_evaluate(device, t, points, N, OUTPUT_ALL,
	    whole, NULL, NULL), ERR_OK);
	for (unsigned mask = 1; mask <= OUTPUT_ALL; mask++) {
		const float *at = rows;

		assert_int_equal(device_evaluate(device, t, points, N, mask,
		    rows, NULL, NULL), ERR_OK);
		for (int i = 0; i < N; i++)
			for (int k = 0; k < KINDS; k++)
				if (mask & 1u << k) {
					assert_memory_equal(at, whole + i * ROW +
					    first[k], (size_t)width[k] *
					    sizeof(*at));
					at += width[k];
				}
	}
	unload(device, t, slot);
}

static bool twice(void *ctx)
{
	int *asked = ctx;

	return ++*asked <= 2;
}

static void test_device_stops_when_told(void **state)
{
	struct device_tape *t;
	struct small s;
	int slot, asked = 0;

	(void)state;
	if (device_get_info(device)->is_gpu) {
		print_message("skipped: a GPU's pieces have more points\n");
		skip();
	}
	make_tape(&s, OP_MAX, NULL);
	t = load(device, &s, &slot);
	assert_int_equal(device_evaluate(device, t, points, POINTS,
	    OUTPUT_VALUE, rows, twice, &asked), ERR_OK);
	assert_int_equal(asked, 2);
	assert_int_equal(device_evaluate(device, t, points, POINTS,
	    OUTPUT_VALUE, rows, twice, &asked), ERR_CANCELLED);
	assert_int_equal(asked, 3);
	unload(device, t, slot);
}

static void test_device_table_memory_is_bounded(void **state)
{
	struct device_options options = {.tables = DEVICE_TABLES_BUFFER};
	struct device *d;
	struct table *table;
	struct small s;
	int slot[3] = {-1, -1, -1}, slots[4];
	size_t most, bytes;

	(void)state;
	make_tape(&s, OP_UNION, "camel");
	assert_int_equal(table_create(s.op.family, &s.op.profile, s.op.layout,
	    s.op.resolution, &table), ERR_OK);
	table_build(table, 0, s.op.resolution);
	options.table_bytes = 2 * table_bytes(table) + 100;
	d = open_device(&options);
	assert_int_equal(device_table_bytes(d, &most), 0);
	assert_in_range(most, 2 * table_bytes(table), options.table_bytes);
	for (int i = 0; i < 2; i++)
		assert_int_equal(device_load_table(d, table, slot + i),
		    ERR_OK);
	bytes = device_table_bytes(d, NULL);
	assert_int_equal(bytes, 2 * table_bytes(table));
	assert_int_equal(device_load_table(d, table, slot + 2),
	    ERR_DEVICE_MEMORY);
	assert_int_equal(slot[2], -1);
	assert_int_equal(device_table_bytes(d, NULL), bytes);
	/* The first's place is found again, below the second. */
	device_drop_table(d, slot[0]);
	assert_int_equal(device_load_table(d, table, slots), ERR_OK);
	assert_int_equal(device_load_table(d, table, slots + 1),
	    ERR_DEVICE_MEMORY);
	table_free(table);
	device_close(d);
}

static void test_device_arena_fills_gaps_first(void **state)
{
	struct device_arena arena = {.size = 100};
	struct device_span a, b, c, none = {1, 2};

	(void)state;
	assert_true(device_arena_take(&arena, 40, &a));
	assert_true(device_arena_take(&arena, 20, &b));
	assert_true(device_arena_take(&arena, 40, &c));
	assert_int_equal(a.at, 0);
	assert_int_equal(b.at, 40);
	assert_int_equal(c.at, 60);
	assert_false(device_arena_take(&arena, 1, &none));
	assert_int_equal(none.at, 1);
	device_arena_give(&arena, b);
	assert_false(device_arena_take(&arena, 21, &none));
	device_arena_give(&arena, a);
	assert_true(device_arena_take(&arena, 60, &a));
	assert_int_equal(a.at, 0);
	device_arena_give(&arena, a);
	device_arena_give(&arena, c);
	assert_int_equal(arena.count, 0);
	free(arena.spans);
}

/* The largest difference between two results, relative to what they are. */
static double difference(const float *a, const float *b, size_t count)
{
	double most = 0.0;

	for (size_t i = 0; i < count; i++) {
		double off = fabs((double)a[i] - (double)b[i]) /
		    (1.0 + fabs((double)a[i]));

		most = off > most ? off : most;
	}
	return most;
}

static void evaluate_on(const struct device_options *options, uint32_t op,
    const char *opening, size_t count, float *out)
{
	struct device *d = open_device(options);
	struct device_tape *t;
	struct small s;
	int slot;

	make_tape(&s, op, opening);
	t = load(d, &s, &slot);
	assert_int_equal(device_evaluate(d, t, points, count, JET, out,
	    NULL, NULL), ERR_OK);
	unload(d, t, slot);
	device_close(d);
}

/* The largest difference in values and gradients; test_lookup compares Hessians
 * too. */
static double compare_rows(size_t count)
{
	double most = 0.0;

	for (size_t i = 0; i < count; i++) {
		double off = difference(whole + i * JET_ROW,
		    rows + i * JET_ROW, 4);

		most = off > most ? off : most;
	}
	return most;
}

static void test_device_widths_agree(void **state)
{
	static const int widths[] = {1, 4};
	struct device_options options = {.width = widest(),
		.tables = DEVICE_TABLES_BUFFER};
	enum { N = 4000 };
	int whole_width = options.width;

	(void)state;
	evaluate_on(&options, OP_UNION, "organic", N, whole);
	for (size_t i = 0; i < sizeof(widths) / sizeof(widths[0]); i++) {
		if (widths[i] >= whole_width)
			continue;
		options.width = widths[i];
		evaluate_on(&options, OP_UNION, "organic", N, rows);
		printf("measured: width %d against %d: %.1e\n", widths[i],
		    whole_width, compare_rows(N));
		assert_true(compare_rows(N) < 1e-4);
	}
}

static bool have_images(void)
{
	if (device_get_info(device)->has_images)
		return true;
	printf("skipped: the device has no images\n");
	return false;
}

static void test_device_images_agree_with_buffers(void **state)
{
	struct device_options options = {.tables = DEVICE_TABLES_BUFFER};
	enum { N = 4000 };

	(void)state;
	if (!have_images())
		skip();
	options.table_bytes = 16 << 20;
	for (uint32_t op = OP_UNION; op <= OP_INTERSECTION; op++) {
		options.tables = DEVICE_TABLES_BUFFER;
		evaluate_on(&options, op, "contact", N, whole);
		options.tables = DEVICE_TABLES_IMAGE;
		evaluate_on(&options, op, "contact", N, rows);
		printf("measured: images against buffers: %.1e\n", compare_rows(N));
		/* Weights of 8 bits, NVIDIA H100: 1.3e-4; PoCL: 1.1e-7. */
		assert_true(compare_rows(N) < (device_get_info(device)->is_gpu
		    ? 4e-4 : 1e-5));
	}
}

/* Tables of two sizes, side by side in the atlases, keep out of each other. */
static void test_device_image_tiles_do_not_overlap(void **state)
{
	struct device_options options = {.tables = DEVICE_TABLES_IMAGE,
		.table_bytes = 128 << 20};
	struct device *d;
	struct operator op = {.family = FAMILY_UNION, .layout = LAYOUT_WARPED};
	const int sizes[] = {16, 65, 16, 64, 8};
	unsigned char taken[4096] = {0};
	int slot;

	(void)state;
	if (!have_images())
		skip();
	d = open_device(&options);
	op.profile = profile_circle();
	for (size_t i = 0; i < sizeof(sizes) / sizeof(sizes[0]); i++) {
		const struct device_slot *s;

		op.resolution = sizes[i];
		slot = load_table(d, &op);
		s = d->tables.slots + slot;
		for (int k = 0; k < sizes[i]; k++) {
			assert_false(taken[s->desc.first + (size_t)k] &
			    s->tiles);
			taken[s->desc.first + (size_t)k] |=
			    (unsigned char)s->tiles;
		}
	}
	device_close(d);
}

int main(void)
{
	const struct CMUnitTest tests[] = {
		cmocka_unit_test(test_device_list_has_the_open_one),
		cmocka_unit_test(test_device_opens_by_index_and_name),
		cmocka_unit_test(test_device_refuses_unknown_name_and_index),
		cmocka_unit_test(test_device_refuses_a_width_that_is_none),
		cmocka_unit_test(test_device_build_failure_brings_the_log),
		cmocka_unit_test(test_device_names_error_codes),
		cmocka_unit_test(test_device_refuses_bad_tapes),
		cmocka_unit_test(test_device_refuses_bad_warps),
		cmocka_unit_test(test_device_refuses_bad_classics),
		cmocka_unit_test(test_device_holds_the_deepest_warps),
		cmocka_unit_test(test_device_colors_what_has_none),
		cmocka_unit_test(test_device_refuses_a_stack_too_deep),
		cmocka_unit_test(test_device_runs_of_points_are_their_sum),
		cmocka_unit_test(test_device_refuses_slots_that_do_not_suit),
		cmocka_unit_test(test_device_batches_of_every_size_agree),
		cmocka_unit_test(test_device_batch_of_none_writes_nothing),
		cmocka_unit_test(test_device_outputs_are_columns_of_the_whole),
		cmocka_unit_test(test_device_stops_when_told),
		cmocka_unit_test(test_device_table_memory_is_bounded),
		cmocka_unit_test(test_device_arena_fills_gaps_first),
		cmocka_unit_test(test_device_widths_agree),
		cmocka_unit_test(test_device_images_agree_with_buffers),
		cmocka_unit_test(test_device_image_tiles_do_not_overlap),
	};

	return cmocka_run_group_tests(tests, setup, teardown);
}
