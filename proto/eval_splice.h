/*
 * A JSON body whose points were scanned and left out of its text. Internal to
 * request.c and eval_text.c.
 */
#ifndef PROTO_EVAL_SPLICE_H
#define PROTO_EVAL_SPLICE_H

#include <stdbool.h>
#include <stddef.h>

#include "core/err.h"
#include "proto/json.h"
#include "proto/request.h"

struct eval_splice {
	const char *at;          /* the points' '['; what follows it in the text
	                          * follows their ']' in the body */
	struct json_mark behind; /* that ']' */
	enum err err;            /* of the points' JSON: it ends there */
	bool invalid;            /* they are JSON, but not points */
	const struct faults *faults; /* for either */
	struct points *points;   /* moved from here */
};

/* eval_request_parse; splice may be NULL. */
enum err eval_splice_parse(const char *text, size_t length,
    const struct eval_splice *splice, bool with_scene,
    unsigned default_outputs, const struct document_limits *limits,
    size_t max_points, struct eval_request *out, struct faults *faults);

#endif
