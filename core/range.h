/*
 * Between which values a field lies throughout a box: interval arithmetic
 * (Moore 1966; for implicit surfaces Duff 1992) over a tape, for what must not
 * miss any of the surface, or wants to skip where there is none.
 *
 * Ranges hold for what the float64 evaluator and a device give: they are
 * widened by RANGE_MARGIN, above what a device was measured to err (tables
 * included). They need no gradients: unions and intersections are monotone in
 * both operands and bounded for every angle by their opening's least and most
 * theta. An operator with a coarser table than the default adds what that errs.
 */
#ifndef CORE_RANGE_H
#define CORE_RANGE_H

#include <stddef.h>

#include "core/err.h"
#include "core/prune.h"
#include "core/vec3.h"

struct range_tape;
struct sampler;
struct tape;
struct tape_box;

struct range {
	double least, most; /* most may be infinite */
};

/* What ranges are widened by, absolute below 1, relative above. */
#define RANGE_MARGIN 4e-3

/*
 * What ranges of tape need to know of its operators; tape must outlive it.
 * *out is the caller's; any number of threads may use it. ERR_MEMORY.
 */
enum err range_tape_create(const struct tape *tape, struct range_tape **out);

/* Frees r; NULL does nothing. */
void range_tape_free(struct range_tape *r);

/* The whole tape as a list, for prune() (core/prune.h) and range_eval. */
struct prune_list range_whole(const struct range_tape *r);

/* A list with room for what prune() leaves of from. range_list_free. ERR_MEMORY. */
enum err range_list_create(const struct prune_list *from,
    struct prune_list *out);
void range_list_free(struct prune_list *list);

/* prune() of from to box into out; range_list_create(from) made out. */
void range_prune(const struct range_tape *r, const struct prune_list *from,
    const struct tape_box *box, struct prune_list *out);

/*
 * The field's range over box (finite, within POINT_REACH; a point is a box,
 * too) of list: range_whole's, or what pruning to a box about this one left of
 * it. No allocation; never NaN.
 */
struct range range_eval(const struct range_tape *r,
    const struct prune_list *list, const struct tape_box *box);

/*
 * A box about the level set f = iso within domain (finite), or all of it that
 * is not shown to be free of it: by halving, until the box's faces are within
 * slack (a part of its longest edge, 0.02 say) of boxes that may hold some, or
 * for as many instructions' ranges as a tenth of a second or two allow; what is
 * known then. domain may be much larger than the surface: once is enough. Empty
 * (min > max) where there is none. Tells sampler (NULL: nobody) how it goes as
 * stage "extent", every millisecond or range. ERR_CANCELLED, ERR_MEMORY.
 */
enum err range_extent(const struct range_tape *r, double iso,
    const struct tape_box *domain, double slack, struct sampler *sampler,
    struct tape_box *out);

#endif
