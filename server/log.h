/*
 * Log lines on stderr: one write each, so that lines of several threads never
 * mix. Safe from any thread.
 *
 * Who logs is never held up: where nobody takes the lines (a full disk, a closed
 * pipe, or one that nobody reads, after LOG_PATIENCE_MS), they are lost, counted,
 * and the first line that can be written again says how many.
 *
 * Nothing here knows secrets; log_request masks what clients put into a query.
 */
#ifndef SERVER_LOG_H
#define SERVER_LOG_H

#include <stdbool.h>
#include <stddef.h>

enum log_level {
	LOG_ERROR,
	LOG_WARNING,
	LOG_INFO, /* start, stop, one line a request */
	LOG_DEBUG,
	LOG_LEVEL_COUNT
};

enum log_format {
	LOG_TEXT, /* TIME LEVEL: MESSAGE */
	LOG_JSON, /* one object a line: {"time", "level", "message", …} */
	LOG_FORMAT_COUNT
};

/* The most characters of one message; what is longer is cut. */
#define LOG_LINE_MAX 1024

/* How long, once, the first line waits that a full pipe has no room for. */
#define LOG_PATIENCE_MS 100

/* Lines above level are dropped. Call before threads start; LOG_INFO at first. */
void log_set_level(enum log_level level);

/* Call before threads start; LOG_TEXT at first. */
void log_set_format(enum log_format format);

/* One line of a request that is over; strings may be "", forwarded_for NULL. */
struct log_request {
	const char *method, *target, *peer, *token;
	const char *request_id, *trace_id, *parent_id;
	const char *forwarded_for; /* whatever the client said */
	unsigned status;
	size_t bytes_in, bytes_out;
	double seconds;
	bool is_cut; /* the answer ended before its end */
};

/*
 * Text: "METHOD TARGET STATUS BYTES_OUT MILLISECONDS ms cut REQUEST_ID from PEER
 * as TOKEN forwarded for "…"", the last quoted as in JSON, less what is "", and
 * "cut" less where it is not. JSON: a member for each, "milliseconds" a number,
 * less what is ""; "cut": true.
 */
void log_request(enum log_level level, const struct log_request *request);

/* Control characters become blanks in text, escapes in JSON; bytes that are no
 * UTF-8 become U+FFFD in JSON. */
void log_write(enum log_level level, const char *format, ...)
    __attribute__((format(printf, 2, 3)));

/* text of any length and several lines (a build log): as it is in text, one
 * object in JSON. */
void log_text(enum log_level level, const char *text);

/*
 * Copies target, a path with or without a query, to out of size > 8 bytes, with
 * *** for the values of parameters that are secrets by their names (access_token
 * of RFC 6750, 2.3, and its like; however escaped), and for what stands before
 * an @ in an authority. What does not fit is cut.
 */
void log_mask_target(const char *target, char *out, size_t size);

/* Lines that could not be written since the start. */
unsigned long log_lost(void);

#endif
