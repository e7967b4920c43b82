/*
 * The one printer of answers as JSON, for answer_json and answer_stream: as
 * much as fits at a time. Internal to them.
 */
#ifndef PROTO_ANSWER_PRINT_H
#define PROTO_ANSWER_PRINT_H

#include <stdbool.h>
#include <stddef.h>

/* Room that the next step of printing takes at most: a row of six numbers, or
 * the head. */
#define ANSWER_PRINT_LEAST 128

/* An answer being printed; arguments as answer_json. Start with these six and
 * 0. */
struct answer_print {
	const float *rows; /* borrowed */
	size_t count;
	unsigned outputs, flags;
	size_t stride;     /* floats of a row */
	const size_t *counts; /* of a grid, three; borrowed; NULL: none */
	size_t part;       /* being printed: one of the outputs */
	size_t first;      /* its first float in a row */
	size_t row;
	bool is_begun, is_open, is_done;
};

/* Writes what comes next, at most size >= ANSWER_PRINT_LEAST bytes; how many,
 * 0 at the end. */
size_t answer_print(struct answer_print *print, char *to, size_t size);

#endif
