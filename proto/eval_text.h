/*
 * JSON bodies of evaluations as they arrive: the array of the member "points"
 * is scanned and dropped, all else is kept as text and parsed at the end.
 * Internal to eval_stream.c.
 */
#ifndef PROTO_EVAL_TEXT_H
#define PROTO_EVAL_TEXT_H

#include <stdbool.h>
#include <stddef.h>

#include "core/err.h"
#include "proto/json.h"
#include "proto/points_scan.h"

struct document_limits;
struct eval_request;

/* Bytes that are added to. Start with {0}. */
struct eval_bytes {
	char *data;
	size_t length, size;
};

/* ERR_MEMORY */
enum err eval_bytes_add(struct eval_bytes *bytes, const char *data,
    size_t length);

/* What comes next of the body. */
enum eval_mode {
	EVAL_TEXT,    /* what is kept */
	EVAL_POINTS,
	EVAL_SKIPPED, /* the rest of an array that holds no points */
	EVAL_REST     /* after an error: ignored */
};

/* What comes next in the body's object. */
enum eval_member {
	EVAL_MEMBER_NAME,
	EVAL_MEMBER_COLON,
	EVAL_MEMBER_VALUE,
	EVAL_MEMBER_BEHIND
};

struct eval_text {
	enum eval_mode mode;
	struct eval_bytes kept;
	/* Of what is kept: all that finding the points takes. */
	enum eval_member member;
	size_t depth;
	bool in_string, escaped;
	bool is_begun;            /* the object is */
	bool is_plain;            /* no object: the points are not sought */
	bool is_points;           /* the member is "points" */
	bool has_points;
	size_t name;              /* where its name starts */
	/* The array of points. */
	bool has_array;
	size_t array;             /* where its '[' is kept */
	bool is_first;            /* nothing that could be wrong precedes it */
	struct points_scan scan;
	struct json_skipper skipper;
	enum err err;             /* of its JSON */
	bool invalid;             /* it holds no points */
	struct json_mark here;    /* of what was not scanned yet */
	struct eval_bytes token;  /* that, if it has arrived: cut by a piece's
	                           * end */
	bool token_is_string, token_escaped;
};

/* faults, those of the array, is kept, not copied. */
void eval_text_init(struct eval_text *t, size_t max_points,
    struct faults *faults);
void eval_text_fini(struct eval_text *t);

/* Takes the next bytes. An error is what eval_text_finish will return. */
enum err eval_text_feed(struct eval_text *t, const char *data, size_t length);

size_t eval_text_bytes(const struct eval_text *t);

/* As eval_request_parse. */
enum err eval_text_finish(struct eval_text *t, bool with_scene,
    unsigned default_outputs, const struct document_limits *limits,
    struct eval_request *out, struct faults *faults);

#endif
