/*
 * Log lines on stderr: one write each, so that lines of several threads never
 * mix. Safe from any thread.
 */
#ifndef SERVER_LOG_H
#define SERVER_LOG_H

#include <stdbool.h>

enum log_level {
	LOG_ERROR,
	LOG_WARNING,
	LOG_INFO, /* start, stop, one line a request */
	LOG_DEBUG,
	LOG_LEVEL_COUNT
};

/* The most characters of one line; what is longer is cut. */
#define LOG_LINE_MAX 1024

/* Lines above level are dropped. Call before threads start; LOG_INFO at first. */
void log_set_level(enum log_level level);

/* "error", "warning", "info", "debug"; false if name is none of them. */
bool log_level_named(const char *name, enum log_level *out);

void log_write(enum log_level level, const char *format, ...)
    __attribute__((format(printf, 2, 3)));

/* text of any length and several lines (a build log), as it is. */
void log_text(enum log_level level, const char *text);

#endif
