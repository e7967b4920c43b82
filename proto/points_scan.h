/*
 * Batches of points as they arrive: JSON arrays scanned piece by piece, and
 * little-endian floats. Internal to points*.c and eval_stream.c.
 */
#ifndef PROTO_POINTS_SCAN_H
#define PROTO_POINTS_SCAN_H

#include <stdbool.h>
#include <stddef.h>

#include "core/err.h"
#include "proto/json.h"
#include "proto/points.h"

/* Where a scan of JSON stands. */
enum points_state {
	POINTS_BEGIN,     /* '[' comes */
	POINTS_FIRST,     /* behind it */
	POINTS_POINT,     /* nested: '[' comes */
	POINTS_OPENED,    /* behind that */
	POINTS_NUMBER,
	POINTS_SEPARATOR, /* behind a number */
	POINTS_BEHIND,    /* nested: behind a point */
	POINTS_DONE       /* behind the array */
};

/* An array being scanned; points_scan_init. */
struct points_scan {
	struct json_place root;
	size_t max_points;
	struct faults *faults;
	enum points_state state;
	struct points points;
	size_t room;           /* for points */
	size_t coordinate;     /* of the point being read: 0 to 2 */
};

/* prefix and faults are kept, not copied. */
struct points_scan points_scan_init(const char *prefix, size_t max_points,
    struct faults *faults);

/*
 * Goes on through text as far as it goes; with last, it ends there for good.
 * Without, what is left is the beginning of a number. Numbers at the very end
 * of text, too, count as not all there. Errors as points_from_json, the points
 * are then freed; which stay the scan's until they are taken from it.
 */
enum err points_scan_on(struct points_scan *scan, struct json_text *text,
    bool last);

/* After ERR_INVALID: what of the array is still open, for json_skip_on. */
struct json_skipper points_scan_rest(const struct points_scan *scan);

/* Gives back what growing took too much. */
void points_trim(struct points *points);

#endif
