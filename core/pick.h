/*
 * Which primitive makes the surface at a point.
 */
#ifndef CORE_PICK_H
#define CORE_PICK_H

#include <stddef.h>

#include "core/err.h"
#include "core/vec3.h"

struct node;
struct picker;
struct tree;

/*
 * For picking from tree (which must outlive it) many times: what has been
 * compiled for one point is kept for the next. One thread at a time. *out is
 * the caller's. ERR_MEMORY.
 */
enum err picker_create(const struct tree *tree, size_t max_nodes,
    struct picker **out);

/* Frees p; NULL does nothing. */
void picker_free(struct picker *p);

/*
 * The primitive (convolutions: its element) that decides the value at x (world
 * units): down from the root, of each composition the child that has the
 * largest part in it: of unions, sums, Ricci's the largest value; of
 * intersections the least; of differences the first child, or that subtrahend
 * whose 1 - f is least and under the first's value; of equal ones the first.
 * Refs are followed to what they instance. A composition without a value above 0
 * goes to its first child. *leaf is a node of the tree. ERR_MEMORY; ERR_LIMIT:
 * more than max_nodes nodes.
 */
enum err picker_leaf(struct picker *p, struct vec3 x, const struct node **leaf);

/* picker_leaf for one point. */
enum err pick_leaf(const struct tree *tree, size_t max_nodes, struct vec3 p,
    const struct node **leaf);

/* Room for any JSON pointer of a node. */
#define PICK_POINTER_MAX 2048

/* node's JSON pointer in its document: "/root/children/1/child". */
void pick_pointer(const struct node *node, char out[static PICK_POINTER_MAX]);

/* How many primitives the document has before node, in its order, refs not
 * expanded: a number for what has room for a number only. */
size_t pick_ordinal(const struct tree *tree, const struct node *node);

#endif
