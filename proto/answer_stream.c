#include "proto/answer_stream.h"

#include <stdlib.h>

#include "core/output.h"
#include "proto/answer_print.h"

_Static_assert(ANSWER_STREAM_LEAST >= ANSWER_PRINT_LEAST, "a step must fit");

struct answer_stream {
	struct answer_print print;
};

enum err answer_stream_create(const float *rows, size_t count,
    unsigned outputs, unsigned flags, struct answer_stream **out)
{
	struct answer_stream *s = malloc(sizeof *s);

	if (!s)
		return ERR_MEMORY;
	s->print = (struct answer_print){.rows = rows, .count = count,
	    .outputs = outputs, .flags = flags,
	    .stride = (size_t)output_row_floats(outputs)};
	*out = s;
	return ERR_OK;
}

void answer_stream_set_counts(struct answer_stream *s,
    const size_t counts[static 3])
{
	s->print.counts = counts;
}

void answer_stream_free(struct answer_stream *s)
{
	free(s);
}

size_t answer_stream_read(struct answer_stream *s, char *to, size_t size)
{
	return answer_print(&s->print, to, size);
}
