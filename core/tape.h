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

/* The deepest a tree may nest, following refs (a document of its own nests 64
 * deep): bounds the recursion of compiling. */
#define TAPE_NESTING_MAX 256

/* Immutable once compiled; may be read by any number of threads. */
struct tape {
	struct insn *insns;
	size_t insn_count;
	double *params;
	size_t param_count;
	struct operator *operators; /* distinct ones; insn.index points here */
	size_t operator_count;
	size_t node_count;          /* nodes after expanding refs */
	size_t primitive_count;
	size_t stack_depth;         /* jets held at once, <= TAPE_STACK_MAX */
};

/* Where and why a tree could not be compiled. */
struct tape_error {
	const struct node *node;
	char detail[160];
};

/*
 * Compiles tree. Every composition is folded left to right in pairs; refs are
 * expanded in place; the deeper of two operands goes first.
 *
 * max_nodes bounds the nodes after expansion (> 0), and also the work of
 * compiling. On success *out is the caller's, to be freed with tape_free.
 * ERR_LIMIT: more nodes than max_nodes, or nested deeper than TAPE_NESTING_MAX.
 * ERR_INVALID: a ref that reaches itself, a singular transform, or a length
 * (primitive_size) outside TREE_LENGTH_MIN..MAX in some frame.
 * Both fill *error. ERR_MEMORY does not.
 */
enum err tape_compile(const struct tree *tree, size_t max_nodes,
    struct tape **out, struct tape_error *error);

/* Frees t; NULL does nothing. */
void tape_free(struct tape *t);

/* The derivative order that instruction i delivers when the root is asked for
 * order root_order (0 value, 1 gradient, 2 Hessian). */
static inline int tape_order(const struct insn *i, int root_order)
{
	int order = root_order + (int)i->extra;

	return order > 2 ? 2 : order;
}

#endif
