#include "proto/eval_stream.h"

#include <stdint.h>
#include <stdlib.h>

#include "proto/eval_text.h"
#include "proto/fault.h"
#include "proto/npy.h"
#include "proto/points_binary.h"

struct eval_stream {
	struct eval_stream_options options;
	struct eval_text text;         /* JSON */
	struct points_arrival numbers; /* the others */
	struct eval_bytes header;      /* of npy, until it is all there; or all
	                                * of one that says too little */
	bool has_header;
	struct npy npy;
	enum err err;          /* that is sure already */
	struct faults faults;  /* for it, or of the points */
};

/* Bytes of npy's header that are taken at a time before its length is known. */
#define NPY_FIRST 12

static void promised(struct eval_stream *s)
{
	const size_t promise = s->options.promise;

	points_arrival_init(&s->numbers, false, s->options.max_points,
	    promise / (3 * sizeof(float)), &s->faults);
	if (promise)
		s->err = points_octets_check(promise, s->options.max_points,
		    &s->faults);
}

enum err eval_stream_create(const struct eval_stream_options *options,
    struct eval_stream **out)
{
	struct eval_stream *s = calloc(1, sizeof(*s));

	if (!s)
		return ERR_MEMORY;
	s->options = *options;
	if (options->type == MEDIA_OCTETS)
		promised(s);
	else if (options->type != MEDIA_NPY)
		eval_text_init(&s->text, options->max_points, &s->faults);
	*out = s;
	return ERR_OK;
}

void eval_stream_free(struct eval_stream *s)
{
	if (!s)
		return;
	eval_text_fini(&s->text);
	points_arrival_fini(&s->numbers);
	free(s->header.data);
	free(s);
}

/* The header is all there, or what there is is none. */
static void read_header(struct eval_stream *s)
{
	s->has_header = true;
	s->err = npy_read(s->header.data ? s->header.data : "",
	    s->header.length, &s->npy, &s->faults);
	if (!s->err)
		s->err = points_npy_check(&s->npy, s->options.max_points,
		    &s->faults);
	free(s->header.data);
	s->header = (struct eval_bytes){0};
	if (!s->err)
		points_arrival_init(&s->numbers, s->npy.is_double,
		    (size_t)s->npy.shape[0], (size_t)s->npy.shape[0],
		    &s->faults);
}

/* Takes of an npy file's header what data has of it, and moves on. */
static enum err feed_header(struct eval_stream *s, const char **data,
    size_t *length)
{
	const size_t have = s->header.length;
	size_t size = SIZE_MAX, n;
	enum err err;

	if (have)
		size = points_npy_header((unsigned char *)s->header.data,
		    have);
	n = (size == SIZE_MAX ? have < NPY_FIRST - 2 ? NPY_FIRST - 2 :
	    NPY_FIRST : size) - have;
	if (n > *length)
		n = *length;
	err = eval_bytes_add(&s->header, *data, n);
	if (err)
		return err;
	*data += n;
	*length -= n;
	size = points_npy_header((unsigned char *)s->header.data,
	    s->header.length);
	if (size <= s->header.length)
		read_header(s);
	return s->err;
}

static enum err feed_npy(struct eval_stream *s, const char *data,
    size_t length)
{
	enum err err = ERR_OK;

	while (!err && !s->has_header && length)
		err = feed_header(s, &data, &length);
	return err ? err : points_arrival_feed(&s->numbers, data, length);
}

enum err eval_stream_feed(struct eval_stream *s, const char *data,
    size_t length)
{
	if (s->err)
		return s->err;
	if (s->options.type == MEDIA_OCTETS)
		s->err = points_arrival_feed(&s->numbers, data, length);
	else if (s->options.type == MEDIA_NPY)
		s->err = feed_npy(s, data, length);
	else
		return eval_text_feed(&s->text, data, length);
	return s->err;
}

size_t eval_stream_bytes(const struct eval_stream *s)
{
	return sizeof *s + eval_text_bytes(&s->text) + s->header.size +
	    s->numbers.room * sizeof *s->numbers.xyz;
}

size_t eval_stream_text(const struct eval_stream *s)
{
	return s->text.kept.length;
}

/* Tells the faults found so far. */
static void tell(const struct eval_stream *s, struct faults *faults)
{
	const struct fault none = {"", ""}, *fault;
	size_t i;

	for (i = 0; i < s->faults.count; i++) {
		fault = i < FAULT_MAX ? &s->faults.list[i] : &none;
		faults_add(faults, fault->pointer, "%s", fault->detail);
	}
}

static enum err finish_numbers(struct eval_stream *s,
    unsigned default_outputs, struct eval_request *out, struct faults *faults)
{
	struct points points;
	enum err err;

	if (!s->err && s->options.type == MEDIA_NPY && !s->has_header)
		read_header(s);
	if (s->err) {
		tell(s, faults);
		return s->err;
	}
	err = s->options.type == MEDIA_NPY ?
	    points_npy_check_length(&s->npy, s->numbers.length, faults) :
	    points_octets_check(s->numbers.length, s->options.max_points,
	    faults);
	if (err)
		return err;
	err = points_arrival_finish(&s->numbers, &points);
	if (err)
		tell(s, faults);
	else
		*out = (struct eval_request){NULL, points, default_outputs};
	return err;
}

enum err eval_stream_finish(struct eval_stream *s, unsigned default_outputs,
    const struct document_limits *limits, struct eval_request *out,
    struct faults *faults)
{
	if (s->options.type == MEDIA_OCTETS || s->options.type == MEDIA_NPY)
		return finish_numbers(s, default_outputs, out, faults);
	return eval_text_finish(&s->text, s->options.with_scene,
	    default_outputs, limits, out, faults);
}
