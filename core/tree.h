/*
 * Blob-trees as plain structs (SPEC section 2): what a document says, before
 * it is compiled to a tape. proto/document.h makes them from JSON; tests make
 * them by hand.
 */
#ifndef CORE_TREE_H
#define CORE_TREE_H

#include <stdbool.h>
#include <stddef.h>

#include "core/affine.h"
#include "core/primitive.h"
#include "core/warp.h"

struct classic;
struct operator;

#define NODE_ID_MAX 64

enum node_type {
	NODE_PRIMITIVE,
	NODE_UNION,
	NODE_INTERSECTION,
	NODE_DIFFERENCE,
	NODE_SUM,
	NODE_RICCI,
	NODE_CONVOLUTION, /* a sum, whose children are PRIMITIVE_CAUCHY_* */
	NODE_WARP,        /* of its one child */
	NODE_REF,
	NODE_TYPE_COUNT
};

struct node {
	enum node_type type;
	const char *id;              /* NULL if it has none */
	const struct node *parent;   /* NULL at the root */
	size_t index;                /* which of its parent's children */
	bool has_transform;
	struct affine transform;     /* from this node's frame to its parent's */
	struct primitive primitive;  /* NODE_PRIMITIVE */
	bool sharp;                  /* UNION, INTERSECTION, DIFFERENCE: max, min */
	const struct operator *op;   /* the same three, when not sharp, else NULL;
	                              * nodes may share it: its family is not
	                              * read, but follows from type */
	const struct classic *classic; /* the same three: instead of op, or NULL */
	double n;                    /* RICCI */
	struct warp warp;            /* WARP */
	bool has_color;              /* else its parent's, or the default one */
	struct vec3 color;           /* linear RGB, each in [0, 1] */
	struct node **children;      /* compositions: count >= 1; warps: 1 */
	size_t child_count;
	const struct node *target;   /* REF: the node it instances */
};

/* The colour of what has none and is below nothing that has (linear RGB). */
#define TREE_COLOR_DEFAULT 0.8

/* Default of struct tree's null_gradient. */
#define TREE_NULL_GRADIENT 1e-2

/*
 * A document. Whoever made it owns it; nodes point into each other freely.
 *
 * null_gradient: a gradient counts as null, and its composition's opening goes
 * to its least value, as the gradient's norm times the longest fall-off below
 * that composition (primitive_size, in the composition's frame) falls under
 * this number. In (0, 1]. (The paper's section 7 gives the rule and no number;
 * 1e-2 is 2e-3 of a soft object's radius from its centre, and values under
 * 7e-5 at its rim. Shorter gradients are turned by the tables' own error in
 * first derivatives: with 1e-3 a device's values were off by up to 2e-2.)
 */
struct tree {
	const struct node *root;
	double null_gradient;
};

/* Limits that the numbers of a tree keep, so that float32 holds every
 * derivative: coordinates; lengths and scales, in every frame of the tree. */
#define TREE_COORDINATE_MAX 1e9
#define TREE_LENGTH_MIN 1e-9
#define TREE_LENGTH_MAX 1e9

#endif
