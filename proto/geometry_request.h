/*
 * Bodies of requests about a scene's surface: rays, projections, pictures,
 * slices.
 */
#ifndef PROTO_GEOMETRY_REQUEST_H
#define PROTO_GEOMETRY_REQUEST_H

#include <stdbool.h>
#include <stddef.h>

#include "core/err.h"
#include "core/picture.h"
#include "core/vec3.h"
#include "proto/points.h"
#include "proto/rays.h"
#include "proto/request.h"

struct faults;

#define GEOMETRY_ISO_DEFAULT 0.5
#define GEOMETRY_ISO_MIN 1e-3
#define GEOMETRY_ISO_MAX 1e3

/* Of levels' step, if a slice says none. */
#define GEOMETRY_STEP_DEFAULT 0.1

/* What the query of rays and projections says, where the body does not. */
struct geometry_terms {
	double iso;
	double max_distance; /* world units; INFINITY: none */
	double tolerance;    /* world units; 0: the default */
};

/* What rays and projections mean without a word about it. */
struct geometry_terms geometry_defaults(void);

/*
 * A query parameter's number (NULL: not there, *out stays) in least..most, both
 * included, into *out; or a fault at pointer and false.
 */
bool geometry_query_number(const char *value, const char *pointer,
    double least, double most, double *out, struct faults *faults);

/* ?iso, ?max_distance and ?tolerance, each NULL if it is not there, into
 * *terms; false after faults. */
bool geometry_query(const char *iso, const char *max_distance,
    const char *tolerance, struct geometry_terms *terms,
    struct faults *faults);

/* Start with {0} but for terms, which are those of the query;
 * raycast_request_fini. */
struct raycast_request {
	struct rays rays;
	struct geometry_terms terms;
};
void raycast_request_fini(struct raycast_request *request);

/*
 * Parses {"rays": [...], "iso", "max_distance", "tolerance"}, or rays alone as
 * octets or npy, by type. text need not end in NUL. ERR_SYNTAX, ERR_INVALID,
 * ERR_LIMIT fill faults; ERR_MEMORY.
 */
enum err raycast_request_parse(const char *text, size_t length,
    enum media_type type, size_t max_rays, struct raycast_request *out,
    struct faults *faults);

/* The same for {"points": [...], "iso", "max_distance"}. */
struct project_request {
	struct points points;
	struct geometry_terms terms;
};
void project_request_fini(struct project_request *request);
enum err project_request_parse(const char *text, size_t length,
    enum media_type type, size_t max_points, struct project_request *out,
    struct faults *faults);

struct render_request {
	/* but for extent, and for camera where there is none */
	struct picture_render picture;
	bool has_camera;
};

/* Parses a JSON object; {} gives all defaults. max_rays: of width * height *
 * samples, else ERR_LIMIT. */
enum err render_request_parse(const char *text, size_t length,
    size_t max_rays, struct render_request *out, struct faults *faults);

struct slice_request {
	size_t width, height;
	bool has_center, has_extent;
	struct vec3 center, normal, up; /* normal, up: unit, not parallel */
	double extent;                  /* world units of the width */
	double iso;
	double levels[PICTURE_LEVELS_MAX];
	size_t level_count;
	unsigned output;                /* one of OUTPUT_*; 0: not said */
};

/* The same; max_points: of width * height. */
enum err slice_request_parse(const char *text, size_t length,
    size_t max_points, struct slice_request *out, struct faults *faults);

#endif
