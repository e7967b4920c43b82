#include <stdio.h>
#include <stdlib.h>
#include <time.h>

#include "core/table.h"
#include "core/tape.h"
#include "kernels/device.h"
#include "tests/bench/bench.h"
#include "tests/bench/native.h"
#include "tests/bench/report.h"

/* Tables that scenes have asked for, and where they lie on each device. */
static struct {
	struct operator op;
	struct table *table;
	int slots[BENCH_MODES];
} tables[BENCH_OPERATORS_MAX];
static int table_count;

static struct bench_devices devices;

double bench_now(void)
{
	struct timespec t;

	clock_gettime(CLOCK_MONOTONIC, &t);
	return (double)t.tv_sec + 1e-9 * (double)t.tv_nsec;
}

void *bench_allocate(size_t size)
{
	void *p = calloc(1, size);

	if (!p)
		abort();
	return p;
}

static void open_device(enum bench_mode mode)
{
	struct device_options options = {.no_culling = mode == BENCH_WHOLE};
	struct device_failure failure = {0};

	if (device_open(&options, devices.device + mode, &failure)) {
		fprintf(stderr, "%s\n", failure.message);
		exit(1);
	}
}

struct bench_devices *bench_devices(void)
{
	const struct device_info *info;
	char text[320];

	if (devices.points)
		return &devices;
	for (int i = 0; i < BENCH_MODES; i++)
		open_device((enum bench_mode)i);
	info = device_get_info(devices.device[BENCH_CULLED]);
	snprintf(text, sizeof(text), "%s, %u compute units, driver %s, width "
	    "%d", info->name, info->compute_units, info->driver, info->width);
	report_note("device", text);
	report_note("native", native_name());
	devices.points = bench_allocate(BENCH_POINTS_MAX * 3 * sizeof(float));
	devices.rows = bench_allocate(BENCH_POINTS_MAX * BENCH_ROW_MAX *
	    sizeof(float));
	devices.other_points = bench_allocate(BENCH_POINTS_MAX * 3 *
	    sizeof(float));
	devices.other_rows = bench_allocate(BENCH_POINTS_MAX * BENCH_ROW_MAX *
	    sizeof(float));
	return &devices;
}

void bench_devices_close(void)
{
	for (int i = 0; i < BENCH_MODES; i++)
		device_close(devices.device[i]);
	for (int i = 0; i < table_count; i++)
		table_free(tables[i].table);
	free(devices.points);
	free(devices.rows);
	free(devices.other_points);
	free(devices.other_rows);
}

static int table_of(const struct operator *op)
{
	int i;

	for (i = 0; i < table_count; i++)
		if (tables[i].op.family == op->family &&
		    tables[i].op.layout == op->layout &&
		    profile_equal(&tables[i].op.profile, &op->profile))
			return i;
	if (i == BENCH_OPERATORS_MAX || table_create(op->family, &op->profile,
	    op->layout, op->resolution, &tables[i].table))
		abort();
	table_build(tables[i].table, 0, op->resolution);
	for (int k = 0; k < BENCH_MODES; k++)
		if (device_load_table(devices.device[k], tables[i].table,
		    tables[i].slots + k))
			abort();
	tables[i].op = *op;
	return table_count++;
}

void bench_slots(const struct tape *tape, enum bench_mode mode, int *slots)
{
	for (size_t i = 0; i < tape->operator_count; i++)
		slots[i] = tables[table_of(tape->operators + i)].slots[mode];
}

void bench_load(const struct scene *s, struct bench_loaded *out)
{
	const struct table *list[BENCH_OPERATORS_MAX];
	int slots[BENCH_OPERATORS_MAX];

	if (s->tape->operator_count > BENCH_OPERATORS_MAX)
		abort();
	for (int k = 0; k < BENCH_MODES; k++) {
		bench_slots(s->tape, (enum bench_mode)k, slots);
		if (device_load_tape(devices.device[k], s->tape, slots,
		    out->tape + k)) {
			fprintf(stderr, "%s\n",
			    device_message(devices.device[k]));
			abort();
		}
	}
	for (size_t i = 0; i < s->tape->operator_count; i++)
		list[i] = tables[table_of(s->tape->operators + i)].table;
	out->native = native_create(s->tape, list);
	if (!out->native)
		abort();
}

void bench_unload(struct bench_loaded *l)
{
	for (int k = 0; k < BENCH_MODES; k++)
		device_drop_tape(devices.device[k], l->tape[k]);
	native_free(l->native);
}

static double cpu_now(void)
{
	struct timespec t;

	clock_gettime(CLOCK_PROCESS_CPUTIME_ID, &t);
	return (double)t.tv_sec + 1e-9 * (double)t.tv_nsec;
}

/* The processor's time is of the whole run: its share of a unit is the same as
 * that of the clock's. */
static void run_once(struct race_runner *r, int i, void *ctx)
{
	double begin = bench_now(), cpu = cpu_now();

	r->seconds[i] = r->run(ctx);
	cpu = cpu_now() - cpu;
	r->cpu[i] = cpu * r->seconds[i] / (bench_now() - begin);
}

void race(struct race_runner *runners, int count, int repetitions, void *ctx)
{
	for (int k = 0; k < count && repetitions > 1; k++)
		runners[k].run(ctx);
	for (int i = 0; i < repetitions; i++)
		for (int k = 0; k < count; k++)
			run_once(runners + k, i, ctx);
	for (int k = 0; k < count; k++) {
		runners[k].median = report_median(runners[k].seconds,
		    (size_t)repetitions);
		runners[k].cpu_median = report_median(runners[k].cpu,
		    (size_t)repetitions);
	}
}

void race_report(const struct race_runner *runners, int count,
    int repetitions, const char *group, const char *name, const char *unit,
    bool per_second, double scale)
{
	const double *s = runners->seconds;
	double first = s[0], last = s[repetitions - 1];
	int used = 0;
	struct report_figure f = {group, name, unit, scale * runners->median,
	    scale * first, scale * last, {{NULL, 0.0}}};

	if (per_second) {
		f.value = scale / runners->median;
		f.least = scale / last;
		f.most = scale / first;
	}
	for (int k = 1; k < count; k++)
		f.ratios[used++] = (struct report_ratio){runners[k].name,
			runners[k].median / runners->median};
	for (int k = 1; k < count; k++)
		if (runners[k].cpu_name)
			f.ratios[used++] = (struct report_ratio){
				runners[k].cpu_name, runners[k].cpu_median /
				runners->cpu_median};
	report_add(&f);
}
