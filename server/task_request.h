/*
 * What handlers of tasks ask of a request first. Each function answers the
 * exchange where it says no.
 */
#ifndef SERVER_TASK_REQUEST_H
#define SERVER_TASK_REQUEST_H

#include <stdbool.h>

#include "proto/request.h"

struct exchange;
struct faults;
struct geometry_terms;
struct scene;

/* The scene that x names, of the revision that its preconditions ask for, for
 * scene_release; or NULL: 400, 404, 412, or the handler is called again: see
 * scene_refresh_get. */
struct scene *task_request_scene(struct exchange *x);

/* The best for x's Accept of the types in mask, first if nothing is preferred,
 * in *out; else 406. */
bool task_request_accept(struct exchange *x, unsigned mask,
    enum media_type first, enum media_type *out);

/* The same for files, which have a type of their own whatever Accept says: first
 * instead of 406, so that curl --json, whose Accept is JSON, gets one. */
enum media_type task_request_file(struct exchange *x, unsigned mask,
    enum media_type first);

/* The query's ?iso, ?max_distance and ?tolerance, or their defaults; ERR_INVALID
 * with faults. */
enum err task_request_terms(struct exchange *x, struct geometry_terms *out,
    struct faults *faults);

/* Rows of so many columns in *rows (malloc'd, taken over, left NULL) as the
 * whole answer: octets, or npy. */
void task_reply_rows(struct exchange *x, enum media_type type, float **rows,
    size_t count, int columns);

#endif
