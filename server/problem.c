#include "server/problem.h"

#include <stdio.h>

static const struct problem_kind kinds[PROBLEM_COUNT] = {
	[PROBLEM_MALFORMED] = {400, "malformed", "Malformed request", 0},
	[PROBLEM_UNAUTHORIZED] = {401, "unauthorized", "Unauthorized", 0},
	[PROBLEM_FORBIDDEN] = {403, "forbidden", "Forbidden", 0},
	[PROBLEM_NOT_FOUND] = {404, "not-found", "Not found", 0},
	[PROBLEM_METHOD] = {405, "method-not-allowed", "Method not allowed", 0},
	[PROBLEM_NOT_ACCEPTABLE] = {406, "not-acceptable",
	    "No acceptable representation", 0},
	[PROBLEM_CONFLICT] = {409, "conflict", "Conflict", 0},
	[PROBLEM_PRECONDITION] = {412, "precondition-failed",
	    "Precondition failed", 0},
	[PROBLEM_TOO_LARGE] = {413, "too-large", "Request body too large", 0},
	[PROBLEM_URI_TOO_LONG] = {414, "uri-too-long", "URI too long", 0},
	[PROBLEM_MEDIA_TYPE] = {415, "unsupported-media-type",
	    "Unsupported media type", 0},
	[PROBLEM_MISDIRECTED] = {421, "misdirected", "Misdirected request", 0},
	[PROBLEM_INVALID] = {422, "invalid", "Invalid content", 0},
	[PROBLEM_LIMIT] = {422, "limit", "Limit exceeded", 0},
	[PROBLEM_WORK_TIME] = {422, "work-time", "Too much work", 0},
	[PROBLEM_TOO_MANY] = {429, "too-many-requests", "Too many requests", 1},
	[PROBLEM_INTERNAL] = {500, "internal", "Internal error", 0},
	[PROBLEM_NOT_IMPLEMENTED] = {501, "not-implemented",
	    "Not implemented", 0},
	[PROBLEM_QUEUE_FULL] = {503, "queue-full", "Queue full", 1},
	[PROBLEM_DRAINING] = {503, "draining", "Shutting down", 5},
	[PROBLEM_NOT_READY] = {503, "not-ready", "Not ready", 1},
	[PROBLEM_MEMORY] = {503, "out-of-memory", "Out of memory", 2},
	[PROBLEM_UNAVAILABLE] = {503, "store-unavailable",
	    "Store unavailable", 2},
	[PROBLEM_DEVICE] = {503, "device-lost", "Device lost", 2},
	[PROBLEM_DEADLINE] = {504, "deadline", "Deadline passed", 0},
	[PROBLEM_VERSION] = {505, "http-version",
	    "HTTP version not supported", 0},
	[PROBLEM_STORE_FULL] = {507, "store-full", "Store full", 0},
};

static const enum problem from_err[ERR_COUNT] = {
	[ERR_OK] = PROBLEM_INTERNAL,
	[ERR_MEMORY] = PROBLEM_MEMORY,
	[ERR_SYNTAX] = PROBLEM_MALFORMED,
	[ERR_INVALID] = PROBLEM_INVALID,
	[ERR_LIMIT] = PROBLEM_LIMIT,
	[ERR_NOT_FOUND] = PROBLEM_NOT_FOUND,
	[ERR_CONFLICT] = PROBLEM_PRECONDITION,
	[ERR_BUSY] = PROBLEM_QUEUE_FULL,
	[ERR_CANCELLED] = PROBLEM_DRAINING,
	[ERR_DEADLINE] = PROBLEM_DEADLINE,
	[ERR_OVERTIME] = PROBLEM_WORK_TIME,
	[ERR_DEVICE] = PROBLEM_DEVICE,
	[ERR_DEVICE_BUILD] = PROBLEM_INTERNAL,
	[ERR_DEVICE_MEMORY] = PROBLEM_MEMORY,
	[ERR_IO] = PROBLEM_INTERNAL,
	[ERR_UNAVAILABLE] = PROBLEM_UNAVAILABLE,
};

const struct problem_kind *problem_kind(enum problem problem)
{
	return &kinds[problem];
}

size_t problem_print(const struct problem_kind *kind,
    char out[static PROBLEM_TEXT_MAX])
{
	return (size_t)snprintf(out, PROBLEM_TEXT_MAX, "{\"type\":"
	    "\"/problems/%s\",\"title\":\"%s\",\"status\":%d}\n",
	    kind->slug, kind->title, kind->status);
}

enum problem problem_from_err(enum err err)
{
	return (unsigned)err < ERR_COUNT ? from_err[err] : PROBLEM_INTERNAL;
}
