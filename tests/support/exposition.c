#include "tests/support/exposition.h"

#include <stdarg.h>
#include <stddef.h>
#include <setjmp.h>
#include <stdint.h>
#include <cmocka.h>

#include <ctype.h>
#include <math.h>
#include <stdbool.h>
#include <stdlib.h>
#include <string.h>

#define NAME_MAX_LENGTH 128

struct series {
	const char *text; /* name and labels */
	double value;
};

struct exposition {
	char *text;
	struct series *list;
	size_t count;
	/* while it is read */
	char families[256][NAME_MAX_LENGTH];
	size_t family_count;
	char family[NAME_MAX_LENGTH], type[16];
	bool has_type;
	/* of the histogram that the last line was of, "" if of none */
	char histogram[512];
	double bound, buckets;
};

/* ---- words ---- */

static bool is_name(const char *text, size_t length, bool is_label)
{
	for (size_t i = 0; i < length; i++) {
		char c = text[i];

		if (!isalpha((unsigned char)c) && c != '_' &&
		    (i == 0 || !isdigit((unsigned char)c)) &&
		    (is_label || c != ':'))
			return false;
	}
	return length > 0;
}

/* Behind a quoted value with no other escapes than there are; or NULL. */
static const char *skip_value(const char *at)
{
	if (*at++ != '"')
		return NULL;
	for (; *at != '"'; at++) {
		if (*at == '\0')
			return NULL;
		if (*at == '\\' && strchr("\\\"n", *++at) == NULL)
			return NULL;
		if (*at == '\0')
			return NULL;
	}
	return at + 1;
}

/* Behind {a="b",c="d"}, or `at` if there is none; or NULL. */
static const char *skip_labels(const char *at)
{
	if (*at != '{')
		return at;
	do {
		size_t length = strcspn(++at, "=");

		if (!is_name(at, length, true) || at[length] != '=')
			return NULL;
		at = skip_value(at + length + 1);
		if (at == NULL)
			return NULL;
	} while (*at == ',');
	return *at == '}' ? at + 1 : NULL;
}

static bool ends_with(const char *text, const char *end)
{
	size_t length = strlen(text), n = strlen(end);

	return length >= n && strcmp(text + length - n, end) == 0;
}

/* ---- lines that begin with # ---- */

static void read_help(struct exposition *e, const char *line)
{
	size_t length = strcspn(line, " ");

	if (!is_name(line, length, false) || length >= NAME_MAX_LENGTH ||
	    line[length] != ' ' || line[length + 1] == '\0')
		fail_msg("a HELP without a name or a text: %s", line);
	memcpy(e->family, line, length);
	e->family[length] = '\0';
	for (size_t i = 0; i < e->family_count; i++)
		if (strcmp(e->families[i], e->family) == 0)
			fail_msg("a second HELP: %s", line);
	assert_in_range(e->family_count, 0, 255);
	strcpy(e->families[e->family_count++], e->family);
	e->has_type = false;
}

static void read_type(struct exposition *e, const char *line)
{
	size_t length = strlen(e->family);
	const char *type = line + length + 1;

	if (e->has_type || strncmp(line, e->family, length) != 0 ||
	    line[length] != ' ' || (strcmp(type, "counter") != 0 &&
	    strcmp(type, "gauge") != 0 && strcmp(type, "histogram") != 0))
		fail_msg("a TYPE that is none, or not its HELP's: %s", line);
	strcpy(e->type, type);
	e->has_type = true;
	if (ends_with(e->family, "_total") != (strcmp(type, "counter") == 0))
		fail_msg("counters end in _total: %s", line);
}

/* ---- samples ---- */

/* What is behind the family's name in a sample's name of so many bytes. */
static const char *suffix_of(const struct exposition *e, const char *line,
    size_t length)
{
	size_t family = strlen(e->family);
	static char suffix[NAME_MAX_LENGTH];

	if (!e->has_type || length < family || length - family >=
	    sizeof suffix || strncmp(line, e->family, family) != 0)
		fail_msg("a sample of no family, or of another: %s", line);
	memcpy(suffix, line + family, length - family);
	suffix[length - family] = '\0';
	return suffix;
}

static void read_bucket(struct exposition *e, const char *series,
    double value)
{
	const char *le = strstr(series, "le=\"");
	size_t length;
	double bound;

	if (le == NULL || (le[-1] != ',' && le[-1] != '{'))
		fail_msg("a bucket without a bound: %s", series);
	length = (size_t)(le - series);
	bound = strtod(le + 4, NULL);
	if (strncmp(e->histogram, series, length) != 0 ||
	    e->histogram[length] != '\0') {
		assert_in_range(length, 1, sizeof e->histogram - 1);
		memcpy(e->histogram, series, length);
		e->histogram[length] = '\0';
		e->bound = -INFINITY;
		e->buckets = 0.0;
	}
	if (!(bound > e->bound) || value < e->buckets)
		fail_msg("buckets do not rise: %s", series);
	e->bound = bound;
	e->buckets = value;
}

static void check_sample(struct exposition *e, const char *suffix,
    const char *series, double value)
{
	if (strcmp(e->type, "histogram") != 0) {
		if (suffix[0] != '\0')
			fail_msg("another name than its family's: %s", series);
		if (strcmp(e->type, "counter") == 0 && !(value >= 0.0))
			fail_msg("a counter below 0: %s", series);
	} else if (strcmp(suffix, "_bucket") == 0) {
		read_bucket(e, series, value);
	} else if (strcmp(suffix, "_count") == 0) {
		if (e->bound != INFINITY || e->buckets != value)
			fail_msg("+Inf is not what it counts: %s", series);
	} else if (strcmp(suffix, "_sum") != 0) {
		fail_msg("not a histogram's name: %s", series);
	}
}

static void read_sample(struct exposition *e, char *line)
{
	size_t length = strcspn(line, "{ ");
	const char *suffix, *end = skip_labels(line + length);
	char *rest;
	double value;

	if (!is_name(line, length, false) || end == NULL || *end != ' ')
		fail_msg("not a sample: %s", line);
	suffix = suffix_of(e, line, length);
	value = strtod(end + 1, &rest);
	if (rest == end + 1 || *rest != '\0')
		fail_msg("not a value: %s", line);
	line[end - line] = '\0';
	check_sample(e, suffix, line, value);
	e->list[e->count++] = (struct series){line, value};
}

/* ---- all ---- */

static int compare(const void *a, const void *b)
{
	return strcmp(((const struct series *)a)->text,
	    ((const struct series *)b)->text);
}

static void read_line(struct exposition *e, char *line)
{
	if (strncmp(line, "# HELP ", 7) == 0)
		read_help(e, line + 7);
	else if (strncmp(line, "# TYPE ", 7) == 0)
		read_type(e, line + 7);
	else
		read_sample(e, line);
}

struct exposition *exposition_read(const char *text, size_t length)
{
	struct exposition *e = calloc(1, sizeof *e);
	size_t lines = 1;
	char *next;

	assert_non_null(e);
	e->text = strndup(text, length);
	assert_non_null(e->text);
	assert_int_equal(strlen(e->text), length);
	assert_true(length > 0 && text[length - 1] == '\n');
	for (size_t i = 0; i < length; i++)
		lines += text[i] == '\n';
	e->list = calloc(lines, sizeof *e->list);
	assert_non_null(e->list);
	for (char *line = e->text; *line != '\0'; line = next) {
		next = strchr(line, '\n');
		*next++ = '\0';
		read_line(e, line);
	}
	qsort(e->list, e->count, sizeof *e->list, compare);
	for (size_t i = 1; i < e->count; i++)
		if (compare(e->list + i - 1, e->list + i) == 0)
			fail_msg("twice: %s", e->list[i].text);
	return e;
}

void exposition_free(struct exposition *e)
{
	if (e == NULL)
		return;
	free(e->list);
	free(e->text);
	free(e);
}

double exposition_value(const struct exposition *e, const char *series)
{
	const struct series key = {series, 0.0};
	const struct series *found = bsearch(&key, e->list, e->count,
	    sizeof *e->list, compare);

	return found != NULL ? found->value : (double)NAN;
}

size_t exposition_count(const struct exposition *e)
{
	return e->count;
}
