/*
 * Bodies of evaluation requests, and the media types both ways.
 */
#ifndef PROTO_REQUEST_H
#define PROTO_REQUEST_H

#include <stdbool.h>
#include <stddef.h>

#include "core/err.h"
#include "proto/points.h"

struct cJSON;
struct document;
struct document_limits;
struct faults;
struct json_place;

enum media_type {
	MEDIA_JSON,    /* application/json */
	MEDIA_OCTETS,  /* application/octet-stream */
	MEDIA_NPY,     /* application/x-npy */
	MEDIA_PNG,     /* image/png */
	MEDIA_GLB,     /* model/gltf-binary */
	MEDIA_PLY,     /* application/x-ply */
	MEDIA_STL,     /* model/stl */
	MEDIA_OBJ,     /* model/obj */
	MEDIA_HTML,    /* text/html */
	MEDIA_SCRIPT,  /* text/javascript */
	MEDIA_STYLE,   /* text/css */
	MEDIA_SVG,     /* image/svg+xml */
	MEDIA_PROBLEM, /* application/problem+json: never negotiated, as below */
	MEDIA_JSON_PATCH,  /* application/json-patch+json */
	MEDIA_MERGE_PATCH, /* application/merge-patch+json */
	MEDIA_EVENTS,      /* text/event-stream */
	MEDIA_METRICS,     /* text/plain, of Prometheus */
	MEDIA_COUNT
};

const char *media_name(enum media_type type);

/* The same for Content-Type: texts that browsers read say that they are
 * UTF-8. */
const char *media_content_type(enum media_type type);

/*
 * A Content-Type to a media type; parameters are ignored but for a charset,
 * which must be UTF-8. False if it is none of JSON, OCTETS, NPY; so also NULL
 * and "": a web page may send a body without a type to any site unasked.
 */
bool media_from_content_type(const char *value, enum media_type *out);

/*
 * The best of JSON, OCTETS, NPY for an Accept header (RFC 9110 12.5.1, with
 * q-values and wildcards; ties go to JSON first, then in this order). NULL
 * means any. False: none is acceptable.
 */
bool media_from_accept(const char *value, enum media_type *out);

/*
 * The same among the types of mask (1u << MEDIA_*); ties, NULL and "" go to
 * first, if the mask has it, then in the enum's order.
 */
bool media_choose(const char *value, unsigned mask, enum media_type first,
    enum media_type *out);

/*
 * "value,gradient" to OUTPUT_* bits (core/output.h). NULL means the
 * default, value and gradient. ERR_INVALID fills faults (unknown or repeated
 * names, or none), whose pointer is pointer.
 */
enum err outputs_from_list(const char *value, const char *pointer,
    unsigned *outputs, struct faults *faults);

/* The same for a JSON array of names, which is at place. */
enum err outputs_from_json(const struct cJSON *list,
    const struct json_place *place, unsigned *outputs, struct faults *faults);

/* An evaluation as a JSON body says it. Start with {0}; eval_request_fini. */
struct eval_request {
	struct document *document; /* NULL unless with_scene */
	struct points points;
	unsigned outputs;          /* OUTPUT_* */
};
void eval_request_fini(struct eval_request *request);

/*
 * Parses {"scene": document, "points": [...], "outputs": [...]}; "scene" is
 * required with with_scene, else forbidden; "outputs" may be missing, for
 * default_outputs. text need not end in NUL. Errors as document_parse and
 * points_from_json; ERR_INVALID tells all faults of the scene and the outputs,
 * and the first one of the points.
 */
enum err eval_request_parse(const char *text, size_t length, bool with_scene,
    unsigned default_outputs, const struct document_limits *limits,
    size_t max_points, struct eval_request *out, struct faults *faults);

#endif
