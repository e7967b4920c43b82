#include "proto/arena.h"

#include <stdint.h>
#include <stdlib.h>
#include <string.h>

/* Of the first block; each is twice as large as the one before, up to the
 * most, for small documents and large ones. */
#define BLOCK_BYTES ((size_t)1 << 10)
#define BLOCK_BYTES_MOST ((size_t)64 << 10)

struct arena_block {
	struct arena_block *next;
	max_align_t data[];
};

static int add_block(struct arena *arena, size_t size)
{
	struct arena_block *block;

	if (size > SIZE_MAX - sizeof *block)
		return -1;
	block = malloc(sizeof *block + size);
	if (!block)
		return -1;
	block->next = arena->blocks;
	arena->blocks = block;
	arena->used = 0;
	arena->size = size;
	return 0;
}

static size_t next_block(const struct arena *arena, size_t size)
{
	size_t next = arena->size ? 2 * arena->size : BLOCK_BYTES;

	if (next > BLOCK_BYTES_MOST)
		next = BLOCK_BYTES_MOST;
	return size > next ? size : next;
}

void *arena_alloc(struct arena *arena, size_t size)
{
	const size_t align = _Alignof(max_align_t);
	char *at;

	if (size > SIZE_MAX - align)
		return NULL;
	size = size ? (size + align - 1) / align * align : align;
	if (size > arena->size - arena->used &&
	    add_block(arena, next_block(arena, size)))
		return NULL;
	at = (char *)arena->blocks->data + arena->used;
	arena->used += size;
	return memset(at, 0, size);
}

void *arena_array(struct arena *arena, size_t count, size_t size)
{
	if (size && count > SIZE_MAX / size)
		return NULL;
	return arena_alloc(arena, count * size);
}

char *arena_string(struct arena *arena, const char *text)
{
	const size_t size = strlen(text) + 1;
	char *copy = arena_alloc(arena, size);

	return copy ? memcpy(copy, text, size) : NULL;
}

void arena_fini(struct arena *arena)
{
	struct arena_block *block, *next;

	for (block = arena->blocks; block; block = next) {
		next = block->next;
		free(block);
	}
	*arena = (struct arena){0};
}
