#include "proto/json_print.h"

#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include <cjson/cJSON.h>

#include "proto/arena.h"
#include "proto/json.h"

#define FIRST_BYTES ((size_t)1 << 10)

/* ---- how numbers are spelt ---- */

struct source {
	const char *at, *end;
	struct arena *arena;
};

/* Moves to the next number, past strings and whatever else. */
static void find_number(struct source *s)
{
	bool escaped;

	while (s->at < s->end && *s->at != '-' &&
	    (*s->at < '0' || *s->at > '9')) {
		if (*s->at++ != '"')
			continue;
		escaped = false;
		s->at = json_token_end(s->at, s->end, true, &escaped);
		if (!s->at)
			s->at = s->end;
	}
}

static enum err keep_number(struct source *s, cJSON *number)
{
	const char *end;
	bool escaped = false;
	size_t n;

	find_number(s);
	end = json_token_end(s->at, s->end, false, &escaped);
	n = (size_t)((end ? end : s->end) - s->at);
	number->valuestring = arena_alloc(s->arena, n + 1);
	if (!number->valuestring)
		return ERR_MEMORY;
	memcpy(number->valuestring, s->at, n);
	s->at += n;
	return ERR_OK;
}

/* Depth first, members and elements in their order, is the text's. */
static enum err keep_numbers(struct source *s, cJSON *value)
{
	enum err err = ERR_OK;
	cJSON *child;

	if (cJSON_IsNumber(value))
		return keep_number(s, value);
	for (child = value->child; child && !err; child = child->next)
		err = keep_numbers(s, child);
	return err;
}

enum err json_print_keep_numbers(struct cJSON *tree, const char *text,
    size_t length, struct arena *arena)
{
	struct source s = {text, text + length, arena};

	return keep_numbers(&s, tree);
}

/* ---- printing ---- */

struct page {
	char *text;
	size_t length, size, most;
	enum err err; /* the first; nothing is put after it */
};

/* Room for n more, or NULL. */
static char *make_room(struct page *page, size_t n)
{
	size_t size;
	char *text;

	if (page->err)
		return NULL;
	if (n > page->most - page->length) {
		page->err = ERR_LIMIT;
		return NULL;
	}
	if (n > page->size - page->length) {
		size = page->size ? 2 * page->size : FIRST_BYTES;
		if (size < page->length + n)
			size = page->length + n;
		text = realloc(page->text, size);
		if (!text) {
			page->err = ERR_MEMORY;
			return NULL;
		}
		page->text = text;
		page->size = size;
	}
	return page->text + page->length;
}

static void put(struct page *page, const char *bytes, size_t n)
{
	char *room = make_room(page, n);

	if (!room)
		return;
	memcpy(room, bytes, n);
	page->length += n;
}

static void put_text(struct page *page, const char *text)
{
	put(page, text, strlen(text));
}

/* A character that does not stand for itself (RFC 8259, 7). */
static void put_escape(struct page *page, unsigned char c)
{
	static const char meanings[] = "\"\\\b\f\n\r\t", names[] = "\"\\bfnrt";
	const char *meaning = strchr(meanings, c);
	char text[8];

	if (meaning)
		snprintf(text, sizeof text, "\\%c", names[meaning - meanings]);
	else
		snprintf(text, sizeof text, "\\u%04x", c);
	put_text(page, text);
}

static void put_string(struct page *page, const char *text)
{
	size_t n;

	put(page, "\"", 1);
	while (*text && !page->err) {
		for (n = 0; (unsigned char)text[n] >= 0x20 &&
		    text[n] != '"' && text[n] != '\\';)
			n++;
		put(page, text, n);
		text += n;
		if (*text)
			put_escape(page, (unsigned char)*text++);
	}
	put(page, "\"", 1);
}

static void put_number(struct page *page, const cJSON *number)
{
	const double value = number->valuedouble;
	char text[32];
	int digits;

	if (number->valuestring) {
		put_text(page, number->valuestring);
		return;
	}
	if (!isfinite(value)) {
		put_text(page, isnan(value) ? "null" : value < 0 ? "-1e999" :
		    "1e999");
		return;
	}
	for (digits = 15; digits <= 17; digits++) {
		snprintf(text, sizeof text, "%.*g", digits, value);
		if (strtod(text, NULL) == value)
			break;
	}
	put_text(page, text);
}

static void put_value(struct page *page, const cJSON *value)
{
	const bool is_object = cJSON_IsObject(value);
	const cJSON *child;

	if (cJSON_IsString(value)) {
		put_string(page, value->valuestring);
	} else if (cJSON_IsNumber(value)) {
		put_number(page, value);
	} else if (!is_object && !cJSON_IsArray(value)) {
		put_text(page, cJSON_IsTrue(value) ? "true" :
		    cJSON_IsFalse(value) ? "false" : "null");
	} else {
		put(page, is_object ? "{" : "[", 1);
		for (child = value->child; child && !page->err;
		    child = child->next) {
			if (child != value->child)
				put(page, ",", 1);
			if (is_object) {
				put_string(page, child->string);
				put(page, ":", 1);
			}
			put_value(page, child);
		}
		put(page, is_object ? "}" : "]", 1);
	}
}

enum err json_print(const struct cJSON *tree, size_t bytes_most, char **out,
    size_t *length)
{
	struct page page = {.most = bytes_most};

	put_value(&page, tree);
	if (page.err) {
		free(page.text);
		return page.err;
	}
	*out = page.text;
	*length = page.length;
	return ERR_OK;
}
