#include "server/trace.h"

#include <pthread.h>
#include <stdatomic.h>
#include <stdbool.h>
#include <stdint.h>
#include <string.h>
#include <sys/random.h>
#include <time.h>
#include <unistd.h>

#include "server/exchange.h"

#define LETTERS "ABCDEFGHIJKLMNOPQRSTUVWXYZabcdefghijklmnopqrstuvwxyz"
#define DIGITS "0123456789"
#define LOWER_HEX DIGITS "abcdef"

/* Digits of a made id: of the process's random number, and of the count. */
#define SEED_DIGITS 16
#define COUNT_DIGITS 8

/* "00-<trace id>-<parent id>-01" */
#define TRACE_DIGITS 32
#define PARENT_DIGITS 16
#define TRACE_AT 3
#define PARENT_AT (TRACE_AT + TRACE_DIGITS + 1)
#define FLAGS_AT (PARENT_AT + PARENT_DIGITS + 1)
#define TRACEPARENT_LENGTH (FLAGS_AT + 2)

static pthread_once_t once = PTHREAD_ONCE_INIT;
static uint64_t seed; /* made once */
static atomic_ulong count;

/* ---- request ids ---- */

static void make_seed(void)
{
	struct timespec now;

	if (getrandom(&seed, sizeof seed, GRND_NONBLOCK) == sizeof seed)
		return;
	/* Ids need to differ, not to be secret. */
	clock_gettime(CLOCK_REALTIME, &now);
	seed = (uint64_t)now.tv_nsec << 34 ^ (uint64_t)now.tv_sec << 8 ^
	    (uint64_t)getpid();
}

/* The last so many hexadecimal digits of number. */
static char *put_hex(char *out, uint64_t number, int digits)
{
	for (int i = digits - 1; i >= 0; i--, number >>= 4)
		out[i] = LOWER_HEX[number & 15];
	return out + digits;
}

static void make_id(char out[static TRACE_ID_MAX + 1])
{
	char *at;

	pthread_once(&once, make_seed);
	at = put_hex(out, seed, SEED_DIGITS);
	*at++ = '-';
	at = put_hex(at, atomic_fetch_add(&count, 1), COUNT_DIGITS);
	*at = '\0';
}

static bool is_id(const char *text)
{
	size_t length = text != NULL ? strlen(text) : 0;

	return length >= 1 && length <= TRACE_ID_MAX &&
	    strspn(text, LETTERS DIGITS "._:-") == length;
}

/* ---- W3C Trace Context, section 3.2 ---- */

/* Whether text has so many lowercase hexadecimal digits, then `after`. */
static bool is_hex(const char *text, size_t digits, char after)
{
	return strspn(text, LOWER_HEX) == digits && text[digits] == after;
}

/* ... of which not all are 0. */
static bool is_number(const char *text, size_t digits)
{
	return is_hex(text, digits, '-') && strspn(text, "0") < digits;
}

/*
 * Version 00 has four fields and ends there; a later one may have more behind
 * them, and is read as far as 00 goes; ff is none. Two headers, joined by a
 * comma, are none either.
 */
static bool is_traceparent(const char *text)
{
	bool is_first;
	const char *end;

	if (text == NULL || !is_hex(text, 2, '-') || memcmp(text, "ff", 2) == 0 ||
	    !is_number(text + TRACE_AT, TRACE_DIGITS) ||
	    !is_number(text + PARENT_AT, PARENT_DIGITS) ||
	    strspn(text + FLAGS_AT, LOWER_HEX) != 2)
		return false;
	is_first = memcmp(text, "00", 2) == 0;
	end = text + TRACEPARENT_LENGTH;
	return *end == '\0' || (!is_first && *end == '-');
}

/* ---- X-Forwarded-For: "client, proxy1, proxy2" ---- */

/* The end of text that fits, from the beginning of an entry if one begins
 * there. */
static void copy_end(const char *text, char out[static TRACE_FORWARDED_MAX + 1])
{
	size_t length = strlen(text);

	if (length > TRACE_FORWARDED_MAX) {
		const char *comma;

		text += length - TRACE_FORWARDED_MAX;
		comma = strchr(text, ',');
		if (comma != NULL && comma[1] != '\0')
			text = comma + 1 + strspn(comma + 1, " \t");
	}
	strcpy(out, text);
}

/* ---- all ---- */

void trace_begin(struct exchange *x)
{
	const char *forwarded = exchange_header(x, "X-Forwarded-For");
	const char *id = exchange_header(x, "X-Request-Id");
	const char *parent = exchange_header(x, "traceparent");

	if (is_id(id))
		strcpy(x->request_id, id);
	else
		make_id(x->request_id);
	if (forwarded != NULL)
		copy_end(forwarded, x->forwarded_for);
	if (!is_traceparent(parent))
		return;
	memcpy(x->trace_id, parent + TRACE_AT, TRACE_DIGITS);
	x->trace_id[TRACE_DIGITS] = '\0';
	memcpy(x->parent_id, parent + PARENT_AT, PARENT_DIGITS);
	x->parent_id[PARENT_DIGITS] = '\0';
}

void trace_add_headers(struct exchange *x)
{
	if (x->request_id[0] != '\0')
		exchange_add_header(x, "X-Request-Id", x->request_id);
}
