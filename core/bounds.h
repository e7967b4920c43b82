/*
 * Boxes that hold the support of a tree's field: f = 0 outside of them.
 */
#ifndef CORE_BOUNDS_H
#define CORE_BOUNDS_H

#include <stdbool.h>

#include "core/vec3.h"

struct affine;
struct node;
struct primitive;
struct warp;

/* Axis-parallel. Coordinates may be infinite: planes, convolutions. Empty
 * where some min exceeds its max. */
struct bounds {
	struct vec3 min, max;
};

/*
 * A box about the support of node, in its parent's frame (the root's: world
 * units). Conservative: the field is 0 outside, also as evaluate() rounds it; a
 * device, in float32, may see a last trace of it a rounding further out.
 * Tight for primitives without transform to 1e-12; transforms, compositions and
 * warps may only widen it. Infinite where a field has no end: planes but for one
 * side of an axis, convolutions, classic operators that are not 0 of two zeros.
 * Empty: no weight, or an intersection of what is apart. node belongs to a tree
 * that tape_compile takes; the time is that of its nodes, refs expanded.
 */
struct bounds bounds_of_node(const struct node *node);

/* The same of one primitive, in its own frame. */
struct bounds bounds_of_primitive(const struct primitive *p);

/* A box about b's image under m. */
struct bounds bounds_map(const struct affine *m, const struct bounds *b);

/* A box, in w's own frame, about the points that W takes into b. */
struct bounds bounds_unwarp(const struct warp *w, const struct bounds *b);

bool bounds_is_empty(const struct bounds *b);

/* Whether every coordinate is finite. */
bool bounds_is_finite(const struct bounds *b);

#endif
