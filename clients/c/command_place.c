#include <stdint.h>
#include <stdlib.h>
#include <string.h>

#include "clients/c/command.h"
#include "proto/arena.h"
#include "proto/fault.h"
#include "proto/json.h"

/* Room for one name between the pointer's slashes. */
#define TOKEN_MAX 512

/* The next token of *pointer, ~1 and ~0 undone (RFC 6901); false: none. */
static bool next_token(const char **pointer, char token[static TOKEN_MAX])
{
	const char *p = *pointer;
	size_t length = 0;

	if (*p != '/')
		return false;
	for (p++; *p != '\0' && *p != '/' && length < TOKEN_MAX - 1; p++) {
		token[length] = *p;
		if (p[0] == '~' && (p[1] == '0' || p[1] == '1'))
			token[length] = *++p == '1' ? '/' : '~';
		length++;
	}
	token[length] = '\0';
	*pointer = p;
	return true;
}

struct search {
	struct arena arena;
	struct json_text text;
	struct json_place place;
	struct faults faults;
};

/* Past the '{' and on to the value of that name; *at: where the name is. */
static bool enter_object(struct search *s, const char *name, const char **at)
{
	do {
		const char *begin;
		char *found;

		json_space(&s->text);
		begin = s->text.cursor;
		if (json_string(&s->text, &s->place, &found, &s->faults) !=
		    ERR_OK || !json_take(&s->text, ':'))
			return false;
		if (strcmp(found, name) == 0) {
			*at = begin;
			return true;
		}
		if (json_skip(&s->text, &s->place, &s->faults) != ERR_OK)
			return false;
	} while (json_take(&s->text, ','));
	return false;
}

static bool enter_array(struct search *s, const char *token, const char **at)
{
	char *end;
	unsigned long index = strtoul(token, &end, 10);

	if (end == token || *end != '\0')
		return false;
	for (; index > 0; index--)
		if (json_skip(&s->text, &s->place, &s->faults) != ERR_OK ||
		    !json_take(&s->text, ','))
			return false;
	json_space(&s->text);
	*at = s->text.cursor;
	return s->text.cursor < s->text.end && *s->text.cursor != ']';
}

/* As far as it goes. */
static const char *follow(struct search *s, const char *pointer)
{
	char token[TOKEN_MAX];
	const char *at;

	json_space(&s->text);
	at = s->text.cursor;
	while (next_token(&pointer, token)) {
		if (json_take(&s->text, '{')) {
			if (!enter_object(s, token, &at))
				break;
		} else if (!json_take(&s->text, '[') ||
		    !enter_array(s, token, &at)) {
			break;
		}
	}
	return at;
}

bool place_find(const char *text, size_t size, const char *pointer,
    size_t *line, size_t *column)
{
	struct search s = {.place = json_root("")};
	struct json_mark mark = {.at = text, .line = 1, .column = 1};
	const char *at;

	s.text = json_text(text, size, SIZE_MAX, &s.arena);
	at = follow(&s, pointer);
	arena_fini(&s.arena);
	if (at >= text + size)
		return false;
	mark = json_mark_moved(mark, at);
	*line = mark.line;
	*column = mark.column;
	return true;
}
