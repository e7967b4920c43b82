/*
 * https://prometheus.io/docs/instrumenting/exposition_formats/, "Text-based
 * format".
 */
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "server/metrics_internal.h"

#define PAGE_FIRST 16384

static void add(struct metrics_page *p, const char *text, size_t length)
{
	size_t size = p->size > 0 ? p->size : PAGE_FIRST;
	char *larger;

	while (size < p->length + length)
		size *= 2;
	if (size > p->size && !p->has_failed) {
		larger = realloc(p->text, size);
		p->has_failed = larger == NULL;
		if (larger != NULL) {
			p->text = larger;
			p->size = size;
		}
	}
	if (p->has_failed)
		return;
	memcpy(p->text + p->length, text, length);
	p->length += length;
}

static void add_text(struct metrics_page *p, const char *text)
{
	add(p, text, strlen(text));
}

/* Backslashes and newlines escaped, and quotes, which help has as they are. */
static void add_escaped(struct metrics_page *p, const char *text,
    bool is_label)
{
	for (const char *stop = is_label ? "\\\n\"" : "\\\n"; *text != '\0';) {
		size_t plain = strcspn(text, stop);

		add(p, text, plain);
		text += plain;
		if (*text == '\0')
			return;
		add_text(p, *text == '\n' ? "\\n" : *text == '"' ? "\\\"" :
		    "\\\\");
		text++;
	}
}

/* Integers as they are; others with as many digits as are needed. */
static void add_number(struct metrics_page *p, double value)
{
	char text[40];

	if (isnan(value))
		strcpy(text, "NaN");
	else if (isinf(value))
		strcpy(text, value > 0.0 ? "+Inf" : "-Inf");
	else if (value == floor(value) && fabs(value) < 9007199254740992.0)
		snprintf(text, sizeof text, "%.0f", value);
	else
		snprintf(text, sizeof text, "%.15g", value);
	add_text(p, text);
}

void metrics_page_family(struct metrics_page *p, const char *name,
    const char *type, const char *help)
{
	p->family = name;
	add_text(p, "# HELP ");
	add_text(p, name);
	add_text(p, " ");
	add_escaped(p, help, false);
	add_text(p, "\n# TYPE ");
	add_text(p, name);
	add_text(p, " ");
	add_text(p, type);
	add_text(p, "\n");
}

void metrics_page_sample(struct metrics_page *p, const char *suffix,
    const struct metrics_label *labels, double value)
{
	const struct metrics_label *at = labels;

	add_text(p, p->family);
	add_text(p, suffix);
	for (; at != NULL && at->name != NULL; at++) {
		add_text(p, at == labels ? "{" : ",");
		add_text(p, at->name);
		add_text(p, "=\"");
		add_escaped(p, at->value, true);
		add_text(p, "\"");
	}
	add_text(p, at != labels ? "} " : " ");
	add_number(p, value);
	add_text(p, "\n");
}

void metrics_page_one(struct metrics_page *p, const char *name,
    const char *type, const char *help, double value)
{
	metrics_page_family(p, name, type, help);
	metrics_page_sample(p, "", NULL, value);
}
