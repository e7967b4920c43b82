/*
 * Bodies of opening-angle requests.
 */
#ifndef PROTO_OPENING_REQUEST_H
#define PROTO_OPENING_REQUEST_H

#include <stdbool.h>
#include <stddef.h>

#include "core/err.h"
#include "core/tree.h"
#include "core/vec3.h"

struct faults;

struct opening_request {
	char node[NODE_ID_MAX + 1]; /* an id */
	struct vec3 point;          /* coordinates within TREE_COORDINATE_MAX */
	bool has_children;
	size_t children[2];         /* of that node; two different ones */
};

/*
 * Parses {"node": id, "point": [x, y, z], "children": [i, j]}, of which
 * "children" may be missing. text need not end in NUL. ERR_SYNTAX, ERR_LIMIT:
 * as json_parse; ERR_INVALID: JSON that is not this; each fills faults, the
 * last with every place. ERR_MEMORY.
 */
enum err opening_request_parse(const char *text, size_t length,
    struct opening_request *out, struct faults *faults);

#endif
