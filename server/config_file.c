/*
 * Configuration files: lines of the form option = value.
 */
#include <errno.h>
#include <stdarg.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "server/config_internal.h"

static const char blanks[] = " \t\r\n";

/* Where the parser is. */
struct place {
	struct config_reading *reading;
	int line;
	int lines[CONFIG_OPTIONS_MAX]; /* by option: where it is given, or 0 */
};

__attribute__((format(printf, 2, 3)))
static bool complain(const struct place *at, const char *format, ...)
{
	va_list args;

	fprintf(stderr, "blobfieldd: %s:%d: ", at->reading->path, at->line);
	va_start(args, format);
	vfprintf(stderr, format, args);
	va_end(args);
	fputc('\n', stderr);
	return false;
}

/* Cuts off a comment, which a # at the beginning or after a blank starts, and
 * blanks before it. */
static void strip(char *text)
{
	size_t length;

	for (char *p = text; (p = strchr(p, '#')) != NULL; p++) {
		if (p == text || strchr(blanks, p[-1]) != NULL) {
			*p = '\0';
			break;
		}
	}
	length = strlen(text);
	while (length > 0 && strchr(blanks, text[length - 1]) != NULL)
		text[--length] = '\0';
}

/* text begins after a quote; what is quoted takes its place. */
static bool unquote(const struct place *at, char *text)
{
	char *out = text, *in = text;

	for (; *in != '"'; in++) {
		if (*in == '\\' && (in[1] == '"' || in[1] == '\\'))
			in++;
		else if (*in == '\\')
			return complain(at, "after \\ in quotes must come \" "
			    "or \\");
		if (*in == '\0' || *in == '\n')
			return complain(at, "the quote is not closed");
		*out++ = *in;
	}
	in++;
	strip(in);
	if (in[strspn(in, blanks)] != '\0')
		return complain(at, "after the closing quote may only come a "
		    "comment");
	*out = '\0';
	return true;
}

/* The value that begins in text, in its place. */
static bool clean(const struct place *at, char **text)
{
	char *value = *text + strspn(*text, blanks);

	*text = value;
	if (value[0] == '"') {
		(*text)++;
		return unquote(at, value + 1);
	}
	/* value[0] is after a blank, or '='. */
	strip(value);
	return true;
}

static bool complain_of_name(const struct place *at, const char *name)
{
	const struct config_option *like = config_option_like(name);

	if (like != NULL)
		return complain(at, "unknown option '%.64s'; did you mean "
		    "'%s'?", name, like->name);
	return complain(at, "unknown option '%.64s'", name);
}

static bool set(struct place *at, const char *name, const char *value)
{
	const struct config_option *option = config_option_find(name,
	    strlen(name));
	struct config_origin origin = {CONFIG_OF_FILE, at->line, option};
	char why[CONFIG_WHY_MAX];
	int *line;

	if (option == NULL)
		return complain_of_name(at, name);
	if (!config_option_is_kept(option))
		return complain(at, "'%s' is for the command line", name);
	line = &at->lines[option - config_options];
	if (*line > 0)
		return complain(at, "'%s' is also in line %d", name, *line);
	*line = at->line;
	if (!config_set(at->reading, origin, value, why))
		return complain(at, "%s must be %s, not '%.64s'", name, why,
		    value);
	return true;
}

static bool read_line(struct place *at, char *text, size_t length)
{
	char *name, *value, *end;

	if (strlen(text) != length)
		return complain(at, "a byte of value 0");
	/* A byte-order mark, which some editors put at the beginning. */
	if (at->line == 1 && strncmp(text, "\xef\xbb\xbf", 3) == 0)
		text += 3;
	name = text + strspn(text, blanks);
	if (name[0] == '\0' || name[0] == '#')
		return true;
	end = name + strcspn(name, "= \t\r\n");
	value = end + strspn(end, " \t");
	if (end == name || *value != '=')
		return complain(at, "must be of the form option = value, or "
		    "begin with #");
	value++;
	*end = '\0';
	return clean(at, &value) && set(at, name, value);
}

static bool read_lines(struct place *at, FILE *file)
{
	char *text = NULL;
	size_t room = 0;
	ssize_t length;
	bool is_good = true;

	while (is_good && (length = getline(&text, &room, file)) >= 0) {
		at->line++;
		is_good = read_line(at, text, (size_t)length);
	}
	free(text);
	return is_good;
}

bool config_file_read(struct config_reading *reading)
{
	struct place at = {.reading = reading};
	FILE *file = fopen(reading->path, "re");
	bool is_good;

	if (file == NULL) {
		fprintf(stderr, "blobfieldd: cannot read %s: %s\n",
		    reading->path, strerror(errno));
		return false;
	}
	is_good = read_lines(&at, file);
	/* Also of a folder, which opens. */
	if (is_good && ferror(file)) {
		fprintf(stderr, "blobfieldd: cannot read %s: %s\n",
		    reading->path, strerror(errno));
		is_good = false;
	}
	fclose(file);
	return is_good;
}
