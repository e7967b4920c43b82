/*
 * Bodies of evaluations in pieces: whatever the pieces, the answer is that for
 * the whole body. The first two bytes say what kind it is and how it is cut.
 */
#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>
#include <stdlib.h>
#include <string.h>

#include "core/output.h"
#include "proto/document.h"
#include "proto/eval_stream.h"
#include "proto/fault.h"

#define POINTS_MAX 20

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size);

static const struct document_limits limits = {.max_nodes = 64,
    .layout = LAYOUT_WARPED};

static void demand(int fine)
{
	if (!fine)
		abort();
}

struct result {
	enum err err;
	struct eval_request request;
	struct faults faults;
};

static void whole(const struct eval_stream_options *options, const char *body,
    size_t length, struct result *r)
{
	r->request.outputs = OUTPUT_VALUE;
	if (options->type == MEDIA_OCTETS)
		r->err = points_from_octets(body, length, POINTS_MAX,
		    &r->request.points, &r->faults);
	else if (options->type == MEDIA_NPY)
		r->err = points_from_npy(body, length, POINTS_MAX,
		    &r->request.points, &r->faults);
	else
		r->err = eval_request_parse(body, length, options->with_scene,
		    OUTPUT_VALUE, &limits, POINTS_MAX, &r->request,
		    &r->faults);
}

/* Pieces of 1 to 1 + cut % 64 bytes, each in memory of its own. */
static void in_pieces(const struct eval_stream_options *options,
    const char *body, size_t length, unsigned cut, struct result *r)
{
	struct eval_stream *s;
	uint32_t random = cut + 1;
	enum err err = ERR_OK;
	size_t n;
	char *piece;

	r->request.outputs = OUTPUT_VALUE;
	demand(eval_stream_create(options, &s) == ERR_OK);
	for (; length; length -= n, body += n) {
		random = random * 1664525u + 1013904223u;
		n = 1 + (random >> 16) % (1 + cut % 64);
		n = n < length ? n : length;
		piece = malloc(n);
		demand(piece != NULL);
		memcpy(piece, body, n);
		err = eval_stream_feed(s, piece, n);
		free(piece);
	}
	r->err = eval_stream_finish(s, OUTPUT_VALUE, &limits, &r->request,
	    &r->faults);
	demand(err == ERR_OK || err == r->err);
	eval_stream_free(s);
}

static void compare(const struct result *a, const struct result *b)
{
	const struct points *p = &a->request.points, *q = &b->request.points;
	size_t i;

	demand(a->err == b->err && a->faults.count == b->faults.count);
	for (i = 0; i < a->faults.count && i < FAULT_MAX; i++) {
		demand(strcmp(a->faults.list[i].pointer,
		    b->faults.list[i].pointer) == 0);
		demand(strcmp(a->faults.list[i].detail,
		    b->faults.list[i].detail) == 0);
	}
	demand(a->request.outputs == b->request.outputs);
	demand(!a->request.document == !b->request.document);
	demand(p->count == q->count && p->flat == q->flat);
	demand(p->count == 0 || memcmp(p->xyz, q->xyz,
	    3 * p->count * sizeof *p->xyz) == 0);
}

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size)
{
	static const enum media_type types[] = {MEDIA_JSON, MEDIA_JSON,
	    MEDIA_OCTETS, MEDIA_NPY};
	struct eval_stream_options options = {.max_points = POINTS_MAX};
	struct result a = {0}, b = {0};

	if (size < 2)
		return 0;
	options.type = types[data[0] % 4];
	options.with_scene = data[0] % 4 == 1;
	options.promise = data[0] & 4 ? size - 2 : 0;
	whole(&options, (const char *)data + 2, size - 2, &a);
	in_pieces(&options, (const char *)data + 2, size - 2, data[1], &b);
	compare(&a, &b);
	eval_request_fini(&a.request);
	eval_request_fini(&b.request);
	return 0;
}
