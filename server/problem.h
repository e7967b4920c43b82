/*
 * The kinds of problem the daemon answers with (RFC 9457), and their status.
 */
#ifndef SERVER_PROBLEM_H
#define SERVER_PROBLEM_H

#include <stddef.h>

#include "core/err.h"

enum problem {
	PROBLEM_MALFORMED,
	PROBLEM_UNAUTHORIZED,
	PROBLEM_FORBIDDEN,
	PROBLEM_NOT_FOUND,
	PROBLEM_METHOD,
	PROBLEM_NOT_ACCEPTABLE,
	PROBLEM_CONFLICT,
	PROBLEM_PRECONDITION,
	PROBLEM_TOO_LARGE,
	PROBLEM_URI_TOO_LONG,
	PROBLEM_MEDIA_TYPE,
	PROBLEM_MISDIRECTED,
	PROBLEM_INVALID,
	PROBLEM_LIMIT,
	PROBLEM_WORK_TIME,
	PROBLEM_TOO_MANY,
	PROBLEM_INTERNAL,
	PROBLEM_NOT_IMPLEMENTED,
	PROBLEM_QUEUE_FULL,
	PROBLEM_DRAINING,
	PROBLEM_NOT_READY,
	PROBLEM_MEMORY,
	PROBLEM_UNAVAILABLE,
	PROBLEM_DEVICE,
	PROBLEM_DEADLINE,
	PROBLEM_VERSION,
	PROBLEM_STORE_FULL,
	PROBLEM_COUNT
};

struct problem_kind {
	int status;
	const char *slug;  /* last part of the type's URI reference */
	const char *title;
	int retry_after;   /* seconds; 0: no Retry-After */
};

const struct problem_kind *problem_kind(enum problem problem);

/* Prints a problem document that says no more than its kind, for where there is
 * no memory for more; its length. */
#define PROBLEM_TEXT_MAX 256
size_t problem_print(const struct problem_kind *kind,
    char out[static PROBLEM_TEXT_MAX]);

/* What a failure is to a client; err is not ERR_OK. */
enum problem problem_from_err(enum err err);

#endif
