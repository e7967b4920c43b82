/*
 * Bodies of evaluation requests, read as they arrive: points become float32 at
 * once, whatever the media type, and of JSON only what is not points is kept as
 * text. Says and refuses what eval_request_parse and points_from_* do for the
 * whole body, place for place.
 */
#ifndef PROTO_EVAL_STREAM_H
#define PROTO_EVAL_STREAM_H

#include <stdbool.h>
#include <stddef.h>

#include "core/err.h"
#include "proto/request.h"

struct document_limits;
struct eval_stream;
struct faults;

struct eval_stream_options {
	enum media_type type;    /* JSON, OCTETS or NPY */
	bool with_scene;         /* as eval_request_parse; JSON only */
	size_t max_points;
	size_t promise;          /* bytes of the body, if known, else 0 */
};

/* ERR_MEMORY. */
enum err eval_stream_create(const struct eval_stream_options *options,
    struct eval_stream **out);

/* Frees s; NULL does nothing. */
void eval_stream_free(struct eval_stream *s);

/*
 * Takes the next bytes. Anything but ERR_OK is what eval_stream_finish will
 * return; what follows need not be fed, but may. An error that is not told
 * here yet, because one of what came before or comes later would count first,
 * costs no memory and hardly any time either.
 */
enum err eval_stream_feed(struct eval_stream *s, const char *data,
    size_t length);

/* Bytes of memory that s holds; grows by feeding, by no more than twice what
 * has arrived and a fixed sum. */
size_t eval_stream_bytes(const struct eval_stream *s);

/* Those of them that are text, which eval_stream_finish is to parse. */
size_t eval_stream_text(const struct eval_stream *s);

/*
 * The body is complete. Fills *out and faults as eval_request_parse (with_scene
 * or not), points_from_octets or points_from_npy would. Once only.
 */
enum err eval_stream_finish(struct eval_stream *s, unsigned default_outputs,
    const struct document_limits *limits, struct eval_request *out,
    struct faults *faults);

#endif
