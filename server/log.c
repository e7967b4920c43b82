#include "server/log.h"

#include <stdarg.h>
#include <stdio.h>
#include <string.h>
#include <time.h>
#include <unistd.h>

static const char *const names[LOG_LEVEL_COUNT] = {
	[LOG_ERROR] = "error",
	[LOG_WARNING] = "warning",
	[LOG_INFO] = "info",
	[LOG_DEBUG] = "debug",
};

static enum log_level most = LOG_INFO;

void log_set_level(enum log_level level)
{
	most = level;
}

bool log_level_named(const char *name, enum log_level *out)
{
	for (int i = 0; i < LOG_LEVEL_COUNT; i++) {
		if (strcmp(name, names[i]) == 0) {
			*out = (enum log_level)i;
			return true;
		}
	}
	return false;
}

static void put(const char *text, size_t length)
{
	while (length > 0) {
		ssize_t n = write(STDERR_FILENO, text, length);

		if (n <= 0)
			return; /* nobody reads the log: nothing to be done */
		text += n;
		length -= (size_t)n;
	}
}

/* "2024-05-01T12:00:00.123Z info: " */
static size_t print_prefix(enum log_level level, char *out, size_t size)
{
	struct timespec now;
	struct tm tm;
	size_t length;

	clock_gettime(CLOCK_REALTIME, &now);
	gmtime_r(&now.tv_sec, &tm);
	length = strftime(out, size, "%Y-%m-%dT%H:%M:%S", &tm);
	return length + (size_t)snprintf(out + length, size - length,
	    ".%03ldZ %s: ", now.tv_nsec / 1000000, names[level]);
}

void log_write(enum log_level level, const char *format, ...)
{
	char line[LOG_LINE_MAX];
	size_t length;
	va_list args;
	int n;

	if (level > most)
		return;
	length = print_prefix(level, line, sizeof line - 1);
	va_start(args, format);
	n = vsnprintf(line + length, sizeof line - 1 - length, format, args);
	va_end(args);
	if (n < 0)
		return;
	length += (size_t)n;
	if (length > sizeof line - 2)
		length = sizeof line - 2;
	line[length++] = '\n';
	put(line, length);
}

void log_text(enum log_level level, const char *text)
{
	size_t length = strlen(text);

	if (level > most || length == 0)
		return;
	put(text, length);
	if (text[length - 1] != '\n')
		put("\n", 1);
}
