/*
 * Files being written: bytes in one block that grows. Internal to mesh_file*.c.
 */
#ifndef PROTO_MESH_FILE_INTERNAL_H
#define PROTO_MESH_FILE_INTERNAL_H

#include <endian.h>
#include <stddef.h>
#include <stdint.h>
#include <string.h>

#include "core/err.h"

/* Start with {0}. After a failure writing goes on without effect. */
struct mesh_out {
	char *data;
	size_t length, room;
	enum err err;
};

/* Makes room for exactly n bytes more. */
void mesh_out_reserve(struct mesh_out *out, size_t n);

/* n bytes more, for the caller to fill; NULL after a failure. */
char *mesh_out_take(struct mesh_out *out, size_t n);

void mesh_out_bytes(struct mesh_out *out, const void *bytes, size_t n);

/* printf, of at most 255 characters. */
void mesh_out_text(struct mesh_out *out, const char *format, ...)
    __attribute__((format(printf, 2, 3)));

/* count 32-bit words, floats or integers, little-endian. */
void mesh_out_words(struct mesh_out *out, const void *words, size_t count);

/* What was written to *data, or why it was not. */
enum err mesh_out_finish(struct mesh_out *out, char **data, size_t *length);

/* Little-endian, to any place; behind it. */
static inline char *mesh_put_u32(char *at, uint32_t value)
{
	value = htole32(value);
	memcpy(at, &value, sizeof value);
	return at + sizeof value;
}

static inline char *mesh_put_floats(char *at, const float *values, size_t n)
{
	uint32_t bits;

	for (size_t i = 0; i < n; i++) {
		memcpy(&bits, values + i, sizeof bits);
		at = mesh_put_u32(at, bits);
	}
	return at;
}

#endif
