/*
 * Documents of other programs: three-js-blobtree's JSON (what its RootNode's
 * toJSON writes) to blobfield/1. README.md has the table of what becomes what.
 *
 * Its iso-value is 1, ours 1/2: f here = f there / (2 iso). What is imported
 * has that field exactly, but for rounding and for what a warning says; what
 * has no exact equal is refused by name.
 */
#ifndef PROTO_IMPORT_H
#define PROTO_IMPORT_H

#include <stddef.h>

#include "core/err.h"
#include "proto/fault.h"

struct document_limits;

/* An imported document. */
struct imported {
	char *document;         /* blobfield/1, malloc'd, with a NUL */
	size_t length;
	struct faults warnings; /* what was left out, or is taken otherwise
	                         * than by the library; pointers into the
	                         * original */
};

/*
 * Reads length bytes of three-js-blobtree JSON. On success *out is the
 * caller's (import_fini), and its document is one that document_parse takes
 * with these limits; its numbers read back exactly. ERR_SYNTAX: not JSON.
 * ERR_INVALID: not such a document, or a part of it has no exact equal here.
 * ERR_LIMIT. All three fill faults, with pointers into the original.
 * ERR_MEMORY. Reentrant.
 */
enum err import_blobtree(const char *text, size_t length,
    const struct document_limits *limits, struct imported *out,
    struct faults *faults);

void import_fini(struct imported *imported);

/*
 * {"document": ..., "warnings": [{pointer, detail}, ...]}, and "warning_count"
 * if there are more than were kept, as a malloc'd string of *length bytes
 * without a NUL. ERR_MEMORY.
 */
enum err import_answer(const struct imported *imported, char **out,
    size_t *length);

#endif
