#include "core/err.h"

static const char *const messages[ERR_COUNT] = {
	[ERR_OK] = "success",
	[ERR_MEMORY] = "out of memory",
	[ERR_SYNTAX] = "malformed input",
	[ERR_INVALID] = "invalid input",
	[ERR_LIMIT] = "limit exceeded",
	[ERR_NOT_FOUND] = "not found",
	[ERR_CONFLICT] = "conflict",
	[ERR_BUSY] = "queue full",
	[ERR_CANCELLED] = "cancelled",
	[ERR_DEADLINE] = "deadline passed",
	[ERR_OVERTIME] = "took too long",
	[ERR_DEVICE] = "device failure",
	[ERR_DEVICE_BUILD] = "device compiler failure",
	[ERR_DEVICE_MEMORY] = "out of device memory",
	[ERR_IO] = "input/output failure",
	[ERR_UNAVAILABLE] = "the store is away",
};

const char *err_message(enum err err)
{
	if ((unsigned)err >= ERR_COUNT)
		return "unknown error";
	return messages[err];
}
