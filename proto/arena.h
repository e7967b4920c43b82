/*
 * Memory that is freed all at once: what a parsed request is made of.
 */
#ifndef PROTO_ARENA_H
#define PROTO_ARENA_H

#include <stddef.h>

struct arena_block;

/* Start with {0}; arena_fini frees. */
struct arena {
	struct arena_block *blocks; /* newest first */
	size_t used, size;          /* of the newest */
};

/* size bytes, zeroed, aligned for anything. NULL: out of memory. */
void *arena_alloc(struct arena *arena, size_t size);

/* The same for count elements of size bytes; NULL also if that overflows. */
void *arena_array(struct arena *arena, size_t count, size_t size);

/* A copy of text with its NUL. */
char *arena_string(struct arena *arena, const char *text);

/* Frees all that was allocated; arena is as at the start. */
void arena_fini(struct arena *arena);

#endif
