/*
 * Bodies of mesh requests.
 */
#ifndef PROTO_MESH_REQUEST_H
#define PROTO_MESH_REQUEST_H

#include <stdbool.h>
#include <stddef.h>

#include "core/err.h"
#include "core/vec3.h"
#include "proto/request.h"

struct faults;

#define MESH_RESOLUTION_DEFAULT 64
#define MESH_ISO_DEFAULT 0.5

/* The files a mesh may be, and what is known of it: 1u << MEDIA_*. */
#define MESH_FILES (1u << MEDIA_GLB | 1u << MEDIA_PLY | 1u << MEDIA_STL | \
	1u << MEDIA_OBJ)

struct mesh_request {
	bool has_bounds;
	struct vec3 min, max;   /* min < max, coordinates within
	                         * TREE_COORDINATE_MAX */
	size_t resolution;      /* cells along the longest side, 2 to
	                         * MESH_CELLS_MAX; 0: edge_length instead */
	double edge_length;     /* at least TREE_LENGTH_MIN */
	double iso;             /* 1e-3 to 1e3 */
	bool features, normals, colors;
	bool has_format;
	enum media_type format; /* of MESH_FILES, or MEDIA_JSON: figures alone */
};

/*
 * Parses {"bounds": {"min", "max"}, "resolution" | "edge_length", "iso",
 * "features", "normals", "colors", "format"}, all of which may be missing. text
 * need not end in NUL. ERR_SYNTAX, ERR_LIMIT: as json_parse; ERR_INVALID: JSON
 * that is not this; each fills faults, the last with every place. ERR_MEMORY.
 */
enum err mesh_request_parse(const char *text, size_t length,
    struct mesh_request *out, struct faults *faults);

/* "glb", "ply", "stl", "obj", "json" to a media type. False: none of them. */
bool mesh_request_format(const char *name, enum media_type *out);

#endif
