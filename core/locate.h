/*
 * Points and fields as one node of a tree sees them, for who asks about a node
 * rather than about the whole: in float64, on the host.
 */
#ifndef CORE_LOCATE_H
#define CORE_LOCATE_H

#include <stdbool.h>
#include <stddef.h>

#include "core/err.h"
#include "core/vec3.h"

struct jet;
struct node;
struct tree;

/*
 * p (world units) in node's own frame: down from the root, through node's
 * parents' inverse transforms and warps, and through its own transform; for a
 * warp node, before its warp. The node is taken where it stands in the tree,
 * not where refs instance it. The tree is one that tape_compile takes.
 */
struct vec3 locate_point(const struct node *node, struct vec3 p);

/*
 * The field of node's child i, at p in node's own frame, with derivatives up to
 * order (0, 1, 2) in that frame. A warp's child is seen before the warp.
 * null_gradient is the tree's. ERR_MEMORY; ERR_LIMIT: more than max_nodes nodes
 * below it.
 */
enum err locate_child(const struct node *node, size_t i, double null_gradient,
    size_t max_nodes, struct vec3 p, int order, struct jet *out);

/* The node of tree whose id is id, NULL if there is none. */
const struct node *locate_node(const struct tree *tree, const char *id);

/* Of an opening that does not depend on the angle. */
#define LOCATE_CONSTANT 3

/* What a click on a surface says of a blend that is to end there. */
struct locate_blend {
	size_t children[2]; /* the one with the larger value first */
	double values[2];   /* theirs, f1 >= f2 */
	double theta;       /* in [0, pi/4] */
	bool has_alpha;
	double alpha;       /* between their gradients, in [0, pi] */
	int parameter;      /* of the node's opening: theta 0 to 2, or the
	                     * LOCATE_CONSTANT one; -1: none */
};

/*
 * The opening angle with which node, a union of two children or more, blends
 * two of them as far as p (world units), which lies on the surface of one (f1 =
 * 1/2) and within the other's support: theta = arctan(2 f2), held under pi/4
 * (Gourmel et al. 2013, section 2), since the boundary k(f) = tan(theta)/2 for
 * f >= 1/2 (Eq. 18). parameter tells which alpha of the node's opening is
 * nearest to the angle between the gradients in its frame, and so which theta
 * to set; there is no alpha where a gradient is 0, and no parameter without
 * alpha, unless the opening is constant, or without a gradient-based operator.
 *
 * children: two different ones; NULL: the two with the largest values at p, of
 * equal ones the first. Errors as locate_child.
 */
enum err locate_blend(const struct node *node, const size_t *children,
    double null_gradient, size_t max_nodes, struct vec3 p,
    struct locate_blend *out);

#endif
