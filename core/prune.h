/*
 * The part of a tape that is alive in a box: what is 0 throughout the box is
 * left out, and with it the orders of derivatives that only it asked for.
 *
 * An operand that is 0 is dropped where the composition then gives the other one
 * (unions, sums, Ricci's) or 0 (intersections, differences' first operand);
 * elsewhere it becomes OP_ZERO. Whatever is left stands in the tape's order, so
 * that at points of the box it gives, but for the sign of zeros, bit for bit the
 * values, gradients and Hessians that the whole tape gives. FRAME and COLOR stay
 * where the one that was last kept is another instruction.
 *
 * Not so colours: of an operand that is 0 a composition takes a share too, of
 * 1e-6 over a sum or a square of the other's value (core/evaluate.h). Where they
 * are asked for, the whole tape must be walked.
 *
 * Not so, either, where the only operand left has the value 0 and a gradient: on
 * the rim of CLASSIC_POWER_DIFFERENCE, or where a power with an exponent over 6
 * underflows. There the whole tape may give the dropped operand's derivatives, 0.
 */
#ifndef CORE_PRUNE_H
#define CORE_PRUNE_H

#include <stdbool.h>
#include <stddef.h>

#include "core/err.h"
#include "core/opcode.h"
#include "core/tape.h"

/*
 * A list of instructions with their boxes: a whole tape's, or what pruning has
 * left of one. Parameters and operators are the tape's.
 */
struct prune_list {
	struct insn *insns;
	struct tape_box *boxes;
	size_t count;
	const struct prune_index *index; /* of these very instructions, or NULL */
};

struct prune_index;

/*
 * Makes pruning list faster, in time less than a tenth of what it otherwise
 * takes where hardly anything is alive: boxes of what is summed or united in a
 * row, as vectors read them. list must stay as it is; list->index is not set.
 * *out is the caller's. ERR_MEMORY.
 */
enum err prune_index_create(const struct prune_list *list,
    struct prune_index **out);

/* Frees x; NULL does nothing. */
void prune_index_free(struct prune_index *x);

size_t prune_index_bytes(const struct prune_index *x);

/* A pruned list is at most so much longer than what it was made of. */
#define PRUNE_ROOM 1

/*
 * Prunes from to box and writes out, whose arrays have room for from->count +
 * PRUNE_ROOM. is_constant[i]: whether operator i's opening is constant
 * (opening_is_constant), so that it asks nothing of its operands. from may be a
 * tape's own arrays or an earlier result for a box about this one. The
 * result always pushes one jet: of a dead tape a single OP_ZERO is left.
 * box is of points within POINT_REACH. Nothing can fail. OP_POINT's index stays
 * as it is, 0 where OP_SUM is dropped: tape_count_runs counts the result's runs.
 */
void prune(const struct prune_list *from, const struct tape_box *box,
    const bool *is_constant, struct prune_list *out);

/* prune in two steps, for lists that are pruned again: what is left, with the
 * orders that it had, and the orders that are needed of it. */
void prune_operands(const struct prune_list *from, const struct tape_box *box,
    struct prune_list *out);
void prune_orders(struct prune_list *list, const bool *is_constant);

#endif
