#include "tests/bench/report.h"

#include <errno.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#define RATIOS_MAX 8

/* Figures and notes are kept until the process ends. */
static struct report_figure *figures;
static size_t figure_count;

struct note {
	const char *key, *value;
};
static struct note *notes;
static size_t note_count;

static void *grow(void *list, size_t count, size_t size)
{
	list = realloc(list, (count + 1) * size);
	if (!list)
		abort();
	return list;
}

static const char *copy(const char *text)
{
	char *s = strdup(text);

	if (!s)
		abort();
	return s;
}

void report_note(const char *key, const char *value)
{
	notes = grow(notes, note_count, sizeof(*notes));
	notes[note_count++] = (struct note){copy(key), copy(value)};
	printf("%s: %s\n", key, value);
	fflush(stdout);
}

static void print(const struct report_figure *f)
{
	printf("  %-58s %9.4g %-7s", f->name, f->value, f->unit);
	if (f->least < f->most)
		printf("[%.4g .. %.4g]", f->least, f->most);
	for (int i = 0; i < RATIOS_MAX && f->ratios[i].beside; i++)
		printf("  /%s %.3g", f->ratios[i].beside, f->ratios[i].value);
	printf("\n");
	fflush(stdout);
}

void report_add(const struct report_figure *f)
{
	struct report_figure *kept;

	if (figure_count == 0 ||
	    strcmp(figures[figure_count - 1].group, f->group) != 0)
		printf("\n%s\n", f->group);
	print(f);
	figures = grow(figures, figure_count, sizeof(*figures));
	kept = figures + figure_count++;
	*kept = *f;
	kept->group = copy(f->group);
	kept->name = copy(f->name);
	kept->unit = copy(f->unit);
	for (int i = 0; i < RATIOS_MAX && f->ratios[i].beside; i++)
		kept->ratios[i].beside = copy(f->ratios[i].beside);
}

/* Text as JSON has it; the bench's own is ASCII, a device's name may not be. */
static void write_text(FILE *file, const char *text)
{
	putc('"', file);
	for (; *text; text++) {
		unsigned char c = (unsigned char)*text;

		if (c == '"' || c == '\\')
			fprintf(file, "\\%c", c);
		else if (c < 0x20 || c > 0x7e)
			putc('?', file);
		else
			putc(c, file);
	}
	putc('"', file);
}

static void write_figure(FILE *file, const struct report_figure *f)
{
	fprintf(file, "    {\"group\": ");
	write_text(file, f->group);
	fprintf(file, ", \"name\": ");
	write_text(file, f->name);
	fprintf(file, ", \"unit\": ");
	write_text(file, f->unit);
	fprintf(file, ", \"median\": %.6g, \"least\": %.6g, \"most\": %.6g, "
	    "\"ratios\": {", f->value, f->least, f->most);
	for (int i = 0; i < RATIOS_MAX && f->ratios[i].beside; i++) {
		fputs(i > 0 ? ", " : "", file);
		write_text(file, f->ratios[i].beside);
		fprintf(file, ": %.6g", f->ratios[i].value);
	}
	fprintf(file, "}}");
}

int report_write(const char *path)
{
	FILE *file = fopen(path, "w");
	int failed;

	if (!file)
		return -1;
	fprintf(file, "{\n");
	for (size_t i = 0; i < note_count; i++) {
		fprintf(file, "  ");
		write_text(file, notes[i].key);
		fprintf(file, ": ");
		write_text(file, notes[i].value);
		fprintf(file, ",\n");
	}
	fprintf(file, "  \"figures\": [\n");
	for (size_t i = 0; i < figure_count; i++) {
		write_figure(file, figures + i);
		fputs(i + 1 < figure_count ? ",\n" : "\n", file);
	}
	fprintf(file, "  ]\n}\n");
	failed = ferror(file);
	return fclose(file) || failed ? -1 : 0;
}

static int by_size(const void *a, const void *b)
{
	double x = *(const double *)a, y = *(const double *)b;

	return (x > y) - (x < y);
}

double report_median(double *values, size_t count)
{
	qsort(values, count, sizeof(*values), by_size);
	return values[count / 2];
}
