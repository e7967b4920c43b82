#include "server/log.h"

#include <errno.h>
#include <limits.h>
#include <poll.h>
#include <pthread.h>
#include <stdarg.h>
#include <stdatomic.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <strings.h>
#include <sys/stat.h>
#include <time.h>
#include <unistd.h>

#include "proto/text.h"

/* A character takes so many in JSON at most: \u001f, or \ufffd for a byte. */
#define ESCAPE_MAX 6

/* Of a line in JSON, besides its message. */
#define FRAME_MAX 128

/* Strings of a request, in JSON, are cut to so many bytes each; all of them and
 * their names then fit. */
#define FIELD_MAX 320
#define REQUEST_MAX (8 * 32 + 4 * 24 + FIELD_MAX * ESCAPE_MAX * 8)

#define NAME_MAX_LENGTH 32

static const char *const names[LOG_LEVEL_COUNT] = {
	[LOG_ERROR] = "error",
	[LOG_WARNING] = "warning",
	[LOG_INFO] = "info",
	[LOG_DEBUG] = "debug",
};

static enum log_level most = LOG_INFO;
static enum log_format form = LOG_TEXT;

static pthread_mutex_t lock = PTHREAD_MUTEX_INITIALIZER; /* guards: */
static bool is_stuck;          /* the last line found no room */
static unsigned long untold;   /* lines lost since the last that was written */

static atomic_ulong lost;

/* ---- what is chosen ---- */

void log_set_level(enum log_level level)
{
	most = level;
}

void log_set_format(enum log_format format)
{
	form = format;
}

/* ---- writing ---- */

/* Whether a write of up to PIPE_BUF bytes would not wait: poll(2) says that a
 * pipe can be written if it has room for as many. Locked. */
static bool has_room(void)
{
	struct pollfd out = {.fd = STDERR_FILENO, .events = POLLOUT};

	is_stuck = poll(&out, 1, is_stuck ? 0 : LOG_PATIENCE_MS) == 0;
	return !is_stuck;
}

/* What may be written at once: all of it where writing does not wait. */
static size_t at_once(size_t length)
{
	struct stat about;

	if (length <= PIPE_BUF || (fstat(STDERR_FILENO, &about) == 0 &&
	    S_ISREG(about.st_mode)))
		return length;
	return PIPE_BUF;
}

/* False: not all of it could be. Locked. */
static bool put(const char *text, size_t length)
{
	size_t chunk = at_once(length);

	while (length > 0) {
		ssize_t n;

		if (!has_room())
			return false;
		n = write(STDERR_FILENO, text, length < chunk ? length :
		    chunk);
		if (n < 0 && errno == EINTR)
			continue;
		if (n <= 0)
			return false;
		text += n;
		length -= (size_t)n;
	}
	return true;
}

/* "2024-05-01T12:00:00.123Z" */
static size_t print_time(char *out, size_t size)
{
	struct timespec now;
	struct tm tm;
	size_t length;

	clock_gettime(CLOCK_REALTIME, &now);
	gmtime_r(&now.tv_sec, &tm);
	length = strftime(out, size, "%Y-%m-%dT%H:%M:%S", &tm);
	return length + (size_t)snprintf(out + length, size - length,
	    ".%03ldZ", now.tv_nsec / 1000000);
}

/* "TIME info: ", or {"time":"…","level":"info" */
static size_t print_prefix(enum log_level level, char *out, size_t size)
{
	char when[40];

	print_time(when, sizeof when);
	return (size_t)snprintf(out, size, form == LOG_JSON ?
	    "{\"time\":\"%s\",\"level\":\"%s\"" : "%s %s: ", when,
	    names[level]);
}

/* Says how many lines are missing. Locked. */
static bool tell_lost(void)
{
	char line[FRAME_MAX + 100];
	size_t length = print_prefix(LOG_WARNING, line, sizeof line);

	length += (size_t)snprintf(line + length, sizeof line - length,
	    form == LOG_JSON ? ",\"message\":\"%lu lines of this log could not "
	    "be written\"}\n" : "%lu lines of this log could not be written\n",
	    untold);
	if (!put(line, length))
		return false;
	untold = 0;
	return true;
}

static void put_line(const char *line, size_t length)
{
	pthread_mutex_lock(&lock);
	if ((untold > 0 && !tell_lost()) || !put(line, length)) {
		untold++;
		atomic_fetch_add(&lost, 1);
	}
	pthread_mutex_unlock(&lock);
}

unsigned long log_lost(void)
{
	return atomic_load(&lost);
}

/* ---- JSON (RFC 8259, section 7) ---- */

/* Puts the character of length bytes at `from` as it is in a string; returns how
 * many it takes there, ESCAPE_MAX at most. length 0: a byte that is none. */
static size_t escape(const char *from, size_t length, char *out)
{
	static const char digits[] = "0123456789abcdef";
	unsigned char c = (unsigned char)*from;

	if (length == 0) {
		memcpy(out, "\\ufffd", 6);
		return 6;
	}
	if (c == '"' || c == '\\') {
		out[0] = '\\';
		out[1] = (char)c;
		return 2;
	}
	if (c == '\n' || c == '\t') {
		out[0] = '\\';
		out[1] = c == '\n' ? 'n' : 't';
		return 2;
	}
	if (c < ' ' || c == 127) {
		memcpy(out, "\\u00", 4);
		out[4] = digits[c >> 4];
		out[5] = digits[c & 15];
		return 6;
	}
	memcpy(out, from, length);
	return length;
}

/* The first `longest` bytes of text as a string; out has room for ESCAPE_MAX
 * times as many and two. Returns its length. */
static size_t print_string(const char *text, size_t longest, char *out)
{
	size_t length = strnlen(text, longest);
	const char *end = text + length;
	char *at = out;

	*at++ = '"';
	while (text < end) {
		size_t n = text_sequence(text, end);

		at += escape(text, n, at);
		text += n > 0 ? n : 1;
	}
	*at++ = '"';
	return (size_t)(at - out);
}

/* ,"name":"text", unless that is "" */
static size_t print_member(const char *name, const char *text, char *out)
{
	size_t length;

	if (text == NULL || text[0] == '\0')
		return 0;
	length = (size_t)sprintf(out, ",\"%s\":", name);
	return length + print_string(text, FIELD_MAX, out + length);
}

static void write_json(enum log_level level, const char *text, size_t length,
    char *line)
{
	size_t at = print_prefix(level, line, FRAME_MAX);

	at += (size_t)sprintf(line + at, ",\"message\":");
	at += print_string(text, length, line + at);
	memcpy(line + at, "}\n", 2);
	put_line(line, at + 2);
}

/* ---- messages ---- */

/* A line stays one: control characters become blanks. */
static void write_text(enum log_level level, const char *text, size_t length)
{
	char line[FRAME_MAX + LOG_LINE_MAX];
	size_t at = print_prefix(level, line, FRAME_MAX);

	for (size_t i = 0; i < length; i++)
		line[at++] = (unsigned char)text[i] < ' ' ? ' ' : text[i];
	line[at++] = '\n';
	put_line(line, at);
}

static void write_message(enum log_level level, const char *text)
{
	char line[FRAME_MAX + ESCAPE_MAX * LOG_LINE_MAX];
	size_t length = strnlen(text, LOG_LINE_MAX - 1);

	if (form == LOG_JSON)
		write_json(level, text, length, line);
	else
		write_text(level, text, length);
}

void log_write(enum log_level level, const char *format, ...)
{
	char text[LOG_LINE_MAX];
	va_list args;
	int n;

	if (level > most)
		return;
	va_start(args, format);
	n = vsnprintf(text, sizeof text, format, args);
	va_end(args);
	if (n >= 0)
		write_message(level, text);
}

/* A text that ends without a newline gets one, in the same write. */
static void write_lines(const char *text, size_t length, char *copy)
{
	memcpy(copy, text, length);
	copy[length] = '\n';
	put_line(copy, length + (text[length - 1] != '\n'));
}

void log_text(enum log_level level, const char *text)
{
	size_t length = strlen(text);
	char *line;

	if (level > most || length == 0)
		return;
	line = malloc(FRAME_MAX + ESCAPE_MAX * length);
	if (line == NULL)
		write_message(level, text); /* better than nothing */
	else if (form == LOG_JSON)
		write_json(level, text, length, line);
	else
		write_lines(text, length, line);
	free(line);
}

/* ---- secrets ---- */

static int hex(char c)
{
	if (c >= '0' && c <= '9')
		return c - '0';
	c = (char)(c | 32);
	return c >= 'a' && c <= 'f' ? c - 'a' + 10 : -1;
}

/* The name at text, up to '=' , '&' or the end, with %-escapes undone and cut to
 * fit. Returns how long it is as it stands. */
static size_t read_name(const char *text, char out[static NAME_MAX_LENGTH])
{
	size_t length = strcspn(text, "=&"), n = 0;

	for (size_t i = 0; i < length && n < NAME_MAX_LENGTH - 1; i++) {
		char c = text[i];

		if (c == '%' && i + 2 < length && hex(text[i + 1]) >= 0 &&
		    hex(text[i + 2]) >= 0) {
			c = (char)(hex(text[i + 1]) << 4 | hex(text[i + 2]));
			i += 2;
		}
		out[n++] = c;
	}
	out[n] = '\0';
	return length;
}

static bool is_secret(const char *name)
{
	static const char *const secrets[] = {"access_token", "token",
	    "id_token", "refresh_token", "api_key", "apikey", "key",
	    "password", "secret", "authorization"};

	for (size_t i = 0; i < sizeof secrets / sizeof *secrets; i++)
		if (strcasecmp(name, secrets[i]) == 0)
			return true;
	return false;
}

/* A piece of a text that is put together, cut at its end. */
struct copy {
	char *at, *end;
};

static void add(struct copy *out, const char *text, size_t length)
{
	size_t room = (size_t)(out->end - out->at);

	length = length < room ? length : room;
	memcpy(out->at, text, length);
	out->at += length;
}

/* scheme://user:secret@host: the length of what is before the path, 0 if there is
 * no authority. */
static size_t add_authority(struct copy *out, const char *target)
{
	const char *host = strstr(target, "://"), *name;
	size_t length;

	if (host == NULL || target[0] == '/' ||
	    host > target + strcspn(target, "?"))
		return 0;
	host += 3;
	length = strcspn(host, "/?");
	name = memrchr(host, '@', length);
	add(out, target, (size_t)(host - target));
	if (name != NULL) {
		add(out, "***", 3);
		length -= (size_t)(name - host);
		host = name;
	}
	add(out, host, length);
	return (size_t)(host - target) + length;
}

void log_mask_target(const char *target, char *out, size_t size)
{
	struct copy copy = {out, out + size - 1};
	char name[NAME_MAX_LENGTH];
	size_t length;

	target += add_authority(&copy, target);
	length = strcspn(target, "?");
	add(&copy, target, length);
	target += length;
	while (*target != '\0') {
		size_t n = 1 + read_name(target + 1, name);

		add(&copy, target, n); /* with the ? or & before it */
		target += n;
		n = strcspn(target, "&");
		if (n > 1 && is_secret(name))
			add(&copy, "=***", 4);
		else
			add(&copy, target, n);
		target += n;
	}
	*copy.at = '\0';
}

/* ---- requests ---- */

static void write_request(enum log_level level, const struct log_request *r,
    const char *target)
{
	char line[FRAME_MAX + REQUEST_MAX];
	char *at = line + print_prefix(level, line, FRAME_MAX);

	at += sprintf(at, ",\"message\":\"request\"");
	at += print_member("method", r->method, at);
	at += print_member("target", target, at);
	at += sprintf(at, ",\"status\":%u,\"bytes_in\":%zu,\"bytes_out\":%zu,"
	    "\"milliseconds\":%.3f", r->status, r->bytes_in, r->bytes_out,
	    1e3 * r->seconds);
	if (r->is_cut)
		at += sprintf(at, ",\"cut\":true");
	at += print_member("peer", r->peer, at);
	at += print_member("token", r->token, at);
	at += print_member("request_id", r->request_id, at);
	at += print_member("trace_id", r->trace_id, at);
	at += print_member("parent_id", r->parent_id, at);
	at += print_member("forwarded_for", r->forwarded_for, at);
	memcpy(at, "}\n", 2);
	put_line(line, (size_t)(at - line) + 2);
}

/* " before" and text, unless that is "". */
static size_t print_word(const char *before, const char *text, char *out)
{
	return text[0] != '\0' ? (size_t)sprintf(out, " %s%.*s", before,
	    FIELD_MAX, text) : 0;
}

static void write_request_text(enum log_level level,
    const struct log_request *r, const char *target)
{
	char line[FRAME_MAX + REQUEST_MAX];
	char *at = line + sprintf(line, "%.*s %s %u %zu %.1f ms", FIELD_MAX,
	    r->method, target, r->status, r->bytes_out, 1e3 * r->seconds);

	at += print_word("", r->is_cut ? "cut" : "", at);
	at += print_word("", r->request_id, at);
	at += print_word("from ", r->peer, at);
	at += print_word("as ", r->token, at);
	if (r->forwarded_for != NULL && r->forwarded_for[0] != '\0') {
		at += sprintf(at, " forwarded for ");
		at += print_string(r->forwarded_for, FIELD_MAX, at);
	}
	*at = '\0';
	write_message(level, line);
}

void log_request(enum log_level level, const struct log_request *request)
{
	char target[FIELD_MAX];

	if (level > most)
		return;
	log_mask_target(request->target, target, sizeof target);
	if (form == LOG_JSON)
		write_request(level, request, target);
	else
		write_request_text(level, request, target);
}
