/*
 * Blob-tree documents (SPEC section 2): JSON text to struct tree.
 * document.schema.json says what a document may hold.
 *
 * Numbers: coordinates up to 1e9 and lengths of 1e-9 to 1e9 (core/tree.h);
 * exponent 3 to 100; weight 0 to 1e6; ricci's n 1 to 1000; w of an opening
 * 0.01 to 100; null_gradient 1e-6 to 1. Angles of an opening may exceed their
 * range by 1e-3, so that 0.7854 and 3.1416 mean pi/4 and pi; rotations are
 * unit to 1e-3 and then normalised. Segments, triangles and solids may be
 * degenerate (a = b); a cone may have one radius 0.
 */
#ifndef PROTO_DOCUMENT_H
#define PROTO_DOCUMENT_H

#include <stdbool.h>
#include <stddef.h>

#include "core/err.h"
#include "core/operator.h"
#include "core/tree.h"

struct cJSON;
struct document;
struct faults;
struct tape;
struct volume;

/* Nodes within nodes; deeper is ERR_LIMIT. */
#define DOCUMENT_DEPTH_MAX 64
/* Entries of "operators"; more are ERR_LIMIT. */
#define DOCUMENT_OPERATORS_MAX 256

struct document_limits {
	size_t max_nodes;         /* after expanding refs */
	size_t max_bytes;         /* of its text; 0: any */
	enum table_layout layout; /* for operators that do not say */
	/* The volume of that id, held for the caller, or NULL; may be NULL, for
	 * where there are none. */
	struct volume *(*volume)(void *ctx, const char *id);
	void *volume_ctx;
};

/*
 * Parses and checks a whole document: JSON, every field, references, then
 * compiles it. On success *out is the caller's (document_free).
 * ERR_SYNTAX: not JSON (RFC 8259; duplicate member names, too). ERR_INVALID:
 * JSON that is not a document. ERR_LIMIT: too many nodes or bytes, or nested
 * too deep.
 * All three fill faults with every place found, not only the first.
 * ERR_MEMORY. Reentrant.
 */
enum err document_parse(const char *text, size_t length,
    const struct document_limits *limits, struct document **out,
    struct faults *faults);

/* The same for parsed JSON (best by json_parse: it refuses what cJSON lets
 * pass); prefix ("/scene") goes before every pointer. */
enum err document_from_json(const struct cJSON *json, const char *prefix,
    const struct document_limits *limits, struct document **out,
    struct faults *faults);

/* The most JSON values that the text of a document within limits can have. */
size_t document_values_max(const struct document_limits *limits);

/* Frees d and all that came from it but the tape taken from it; NULL does
 * nothing. */
void document_free(struct document *d);

/* The document's name, or "". */
const char *document_name(const struct document *d);
const struct tree *document_tree(const struct document *d);

/* Whether it has operators under names of its own. */
bool document_has_operators(const struct document *d);

/* The compiled tape: borrowed (NULL once taken), or taken over by the caller. */
const struct tape *document_tape(const struct document *d);
struct tape *document_take_tape(struct document *d);

#endif
