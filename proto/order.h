/*
 * Bodies that order an operator table (proto/README.md): {profile, layout,
 * family, resolution | max_error}.
 */
#ifndef PROTO_ORDER_H
#define PROTO_ORDER_H

#include <stddef.h>

#include "core/err.h"
#include "core/operator.h"

struct faults;

/* The least max_error that may be asked for: tables hold float32. */
#define ORDER_ERROR_MIN 1e-7

struct order {
	struct operator op; /* its resolution is 0 where max_error says which;
	                     * its opening is of no interest */
	double max_error;   /* of |g|, in ]0, 1]; 0: op.resolution says */
};

/*
 * Parses an order. Members, all optional: as in a document's operator
 * "profile" (default smooth), "layout" (default the given one) and "resolution"
 * (default the layout's); "family": "union" (default) or "intersection";
 * "max_error": ORDER_ERROR_MIN to 1, not beside "resolution". ERR_SYNTAX,
 * ERR_INVALID, ERR_LIMIT: faults say where. ERR_MEMORY.
 */
enum err order_parse(const char *text, size_t length,
    enum table_layout layout, struct order *out, struct faults *faults);

#endif
