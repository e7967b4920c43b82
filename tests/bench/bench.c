/*
 * The bench: one program, whose parts measure what the project does beside
 * something that bounds or explains it, run in the same repetitions.
 *
 *   bench [--json FILE] [--quick] [PART ...]
 *
 * Parts: device, scale, tables, wire, start; all if none is named. A line on
 * stdout a figure; all of them, with the machine and the date, to FILE.
 * tables-sweep and tables-orders are parts that are run only by name.
 */
#include <errno.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <time.h>
#include <unistd.h>

#include "tests/bench/bench.h"
#include "tests/bench/report.h"
#include "tests/bench/wire.h"

static void sweep(bool quick)
{
	(void)quick;
	bench_tables_sweep();
}

static void orders(bool quick)
{
	(void)quick;
	bench_tables_orders();
}

struct part {
	const char *name;
	void (*run)(bool quick);
	bool only_by_name;
};

static const struct part parts[] = {
	{"device", bench_device, false},
	{"scale", bench_scale, false},
	{"tables", bench_tables, false},
	{"mesh", bench_mesh, false},
	{"wire", bench_wire, false},
	{"start", bench_start, false},
	{"specialised", bench_specialised, true},
	{"tables-sweep", sweep, true},
	{"tables-orders", orders, true},
};

#define PARTS (sizeof(parts) / sizeof(*parts))

static void usage(void)
{
	fprintf(stderr, "usage: bench [--json FILE] [--quick] [PART ...]\n"
	    "parts:");
	for (size_t i = 0; i < PARTS; i++)
		fprintf(stderr, " %s", parts[i].name);
	fprintf(stderr, "\n");
	exit(2);
}

/* The processor's name, from what Linux tells. */
static void note_processor(void)
{
	FILE *file = fopen("/proc/cpuinfo", "r");
	char line[256], text[320], *at;
	long cores = sysconf(_SC_NPROCESSORS_ONLN);

	while (file && fgets(line, sizeof(line), file)) {
		if (strncmp(line, "model name", 10) != 0)
			continue;
		at = strchr(line, ':');
		line[strcspn(line, "\n")] = '\0';
		snprintf(text, sizeof(text), "%ld cores,%s", cores,
		    at ? at + 1 : "");
		report_note("machine", text);
		break;
	}
	if (file)
		fclose(file);
}

static void note_run(bool quick)
{
	time_t now = time(NULL);
	char text[64];

	strftime(text, sizeof(text), "%Y-%m-%dT%H:%M:%SZ", gmtime(&now));
	report_note("date", text);
	report_note("version", BLOBFIELD_VERSION);
	report_note("kind", quick ? "quick" : "full");
	note_processor();
}

static bool wanted(const struct part *p, char **names, int count)
{
	for (int i = 0; i < count; i++)
		if (strcmp(names[i], p->name) == 0)
			return true;
	return count == 0 && !p->only_by_name;
}

static void check_names(char **names, int count)
{
	for (int i = 0; i < count; i++) {
		bool known = false;

		for (size_t k = 0; k < PARTS; k++)
			known = known || strcmp(names[i], parts[k].name) == 0;
		if (!known)
			usage();
	}
}

int main(int argc, char **argv)
{
	const char *json = NULL;
	bool quick = false;
	int i;

	for (i = 1; i < argc && argv[i][0] == '-'; i++) {
		if (strcmp(argv[i], "--quick") == 0)
			quick = true;
		else if (strcmp(argv[i], "--json") == 0 && i + 1 < argc)
			json = argv[++i];
		else
			usage();
	}
	check_names(argv + i, argc - i);
	note_run(quick);
	for (size_t k = 0; k < PARTS; k++)
		if (wanted(parts + k, argv + i, argc - i))
			parts[k].run(quick);
	bench_devices_close();
	if (json && report_write(json)) {
		fprintf(stderr, "%s: %s\n", json, strerror(errno));
		return 1;
	}
	return 0;
}
