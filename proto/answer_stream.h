/*
 * answer_json, printed piece by piece as it leaves: the same bytes.
 */
#ifndef PROTO_ANSWER_STREAM_H
#define PROTO_ANSWER_STREAM_H

#include <stddef.h>

#include "core/err.h"

struct answer_stream;

/* Borrows rows until it is freed. Arguments as answer_json. ERR_MEMORY. */
enum err answer_stream_create(const float *rows, size_t count,
    unsigned outputs, unsigned flags, struct answer_stream **out);

/* The answer is a grid's, as answer_grid_json; before anything is read. Borrows
 * counts. */
void answer_stream_set_counts(struct answer_stream *s,
    const size_t counts[static 3]);

/* Frees s; NULL does nothing. */
void answer_stream_free(struct answer_stream *s);

/* Writes the next bytes, at most size (>= ANSWER_STREAM_LEAST); 0: the end. */
#define ANSWER_STREAM_LEAST 256
size_t answer_stream_read(struct answer_stream *s, char *to, size_t size);

#endif
