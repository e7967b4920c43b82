/*
 * Tapes: a Blob-tree compiled to a linear program (core/opcode.h), with for
 * each instruction the derivative orders its ancestors need.
 */
#ifndef CORE_TAPE_H
#define CORE_TAPE_H

#include <stddef.h>

#include "core/err.h"
#include "core/opcode.h"
#include "core/operator.h"

struct node;
struct tree;
struct volume;

/* The deepest a tree may nest, following refs (a document of its own nests 64
 * deep): bounds the recursion of compiling. */
#define TAPE_NESTING_MAX 256

/*
 * A box in world units outside of which an instruction's jet is 0, in float64
 * and as a device rounds it: widened by what float32 may err. Coordinates may be
 * infinite; empty where some min exceeds its max.
 */
struct tape_box {
	float min[3], max[3];
};

/* Immutable once compiled; may be read by any number of threads. */
struct tape {
	struct insn *insns;
	struct tape_box *boxes;     /* one an instruction; those of FRAME, COLOR
	                             * and ENTER are not read; NULL: not known */
	size_t insn_count;
	double *params;
	size_t param_count;
	struct operator *operators; /* distinct ones; insn.index points here */
	size_t operator_count;
	struct volume **volumes;    /* distinct ones, each held; OP_VOLUME's
	                             * index points here */
	size_t volume_count;
	size_t node_count;          /* nodes after expanding refs */
	size_t primitive_count;
	size_t stack_depth;         /* jets held at once, <= TAPE_STACK_MAX */
};

/* Where and why a tree could not be compiled. */
struct tape_error {
	const struct node *node; /* NULL: the whole of it */
	char detail[160];
};

/*
 * Compiles tree. Every composition is folded left to right in pairs; refs are
 * expanded in place; the deeper of two operands goes first.
 *
 * max_nodes bounds the nodes after expansion (> 0), and also the work of
 * compiling. On success *out is the caller's, to be freed with tape_free.
 * ERR_LIMIT: more nodes than max_nodes, nested deeper than TAPE_NESTING_MAX,
 * or more than TAPE_WARPS_MAX warps within each other. ERR_INVALID: a ref that
 * reaches itself, a singular transform, a length (primitive_size) outside
 * TREE_LENGTH_MIN..MAX in some frame, or a volume whose falloff does not fit
 * what it samples (struct volume's least_edge).
 * Both fill *error. ERR_MEMORY does not.
 */
enum err tape_compile(const struct tree *tree, size_t max_nodes,
    struct tape **out, struct tape_error *error);

/* Frees t; NULL does nothing. */
void tape_free(struct tape *t);

/*
 * Sets the index of every OP_POINT of a whole tape: of those of exponent 3 that
 * OP_SUM follows, how many such pairs there are in a row from it on, so that an
 * interpreter may take them in one loop; of others 0. params: of the tape.
 */
void tape_mark_runs(struct insn *insns, size_t count, const double *params);

/* Counts the pairs in a row anew in what pruning has left of a tape that was
 * marked: no pair is one that was none in the tape. */
void tape_count_runs(struct insn *insns, size_t count);

/* The derivative order that instruction i delivers when the root is asked for
 * order root_order (0 value, 1 gradient, 2 Hessian). */
static inline int tape_order(const struct insn *i, int root_order)
{
	int order = root_order + (int)i->extra;

	return order > 2 ? 2 : order;
}

#endif
