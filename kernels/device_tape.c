#include "kernels/device_internal.h"

#include <float.h>
#include <stdlib.h>
#include <string.h>

#include "core/curve.h"
#include "core/opening_table.h"
#include "core/tape.h"

#define OPENING_FLOATS (OPENING_TABLE_COUNT * CURVE_NODE)

/* Parameters an opcode reads (core/opcode.h). */
static const unsigned char param_counts[OP_COUNT] = {
	[OP_FRAME] = 12, [OP_CARRY] = 9,
	[OP_POINT] = 6, [OP_SEGMENT] = 11, [OP_TRIANGLE] = 12, [OP_DISC] = 10,
	[OP_CIRCLE] = 10, [OP_SPHERE] = 5, [OP_BOX] = 8, [OP_CYLINDER] = 9,
	[OP_CAPSULE] = 9, [OP_CONE] = 10, [OP_TORUS] = 9, [OP_PLANE] = 7,
	[OP_RICCI] = 1, [OP_UNION] = 1, [OP_INTERSECTION] = 1,
	[OP_DIFFERENCE] = 1, [OP_DIFFERENCE_SWAPPED] = 1,
};

/* Jets an instruction takes off the stack and puts on it. */
static void stack_use(uint32_t op, size_t *takes, size_t *puts)
{
	*takes = op >= OP_MAX ? 2 : op == OP_CARRY ? 1 : 0;
	*puts = op == OP_FRAME ? 0 : 1;
}

static const char *insn_fault(const struct tape *tape, const struct insn *insn)
{
	if (insn->op >= OP_COUNT)
		return "has an unknown opcode";
	if (insn->extra > 2)
		return "asks for too high an order";
	/* The interpreter reads one even where the opcode has none. */
	if (insn->param >= tape->param_count ||
	    tape->param_count - insn->param < param_counts[insn->op])
		return "reads parameters beyond the last";
	if (insn->op >= OP_UNION && insn->index >= tape->operator_count)
		return "uses an operator that is not there";
	return NULL;
}

/* The orders beyond the root's that instruction insn needs of its operands. */
static unsigned operand_extra(const struct tape *tape, const struct insn *insn)
{
	bool by_angle = insn->op >= OP_UNION &&
	    !opening_is_constant(&tape->operators[insn->index].opening);
	unsigned extra = insn->extra + by_angle;

	return extra > 2 ? 2 : extra;
}

/*
 * A kernel checks nothing, and one access out of bounds would kill the
 * process: so every tape is checked, though tape_compile makes only good ones.
 */
static enum err check(struct device *d, const struct tape *tape)
{
	unsigned extra[TAPE_STACK_MAX];
	size_t depth = 0, takes, puts;

	for (size_t i = 0; i < tape->insn_count; i++) {
		const char *fault = insn_fault(tape, tape->insns + i);

		if (!fault) {
			stack_use(tape->insns[i].op, &takes, &puts);
			if (depth < takes)
				fault = "finds too few jets on the stack";
			else if (depth - takes + puts > TAPE_STACK_MAX)
				fault = "finds the stack full";
			for (size_t k = 0; !fault && k < takes; k++)
				if (extra[depth - 1 - k] <
				    operand_extra(tape, tape->insns + i))
					fault = "needs more derivatives than "
					    "its operands have";
		}
		if (fault)
			return device_refuse(&d->failure, ERR_INVALID,
			    "instruction %zu of the tape %s", i, fault);
		depth += puts - takes;
		if (puts > 0)
			extra[depth - 1] = tape->insns[i].extra;
	}
	if (depth != 1)
		return device_refuse(&d->failure, ERR_INVALID,
		    "the tape leaves %zu jets on the stack, not 1", depth);
	if (tape->insn_count > UINT32_MAX || tape->param_count > UINT32_MAX)
		return device_refuse(&d->failure, ERR_INVALID,
		    "the tape is longer than 32 bits can count");
	return ERR_OK;
}

static bool suits(const struct device_slot *slot, const struct operator *op)
{
	return slot->desc.family == (uint32_t)op->family &&
	    slot->desc.layout == (uint32_t)op->layout &&
	    slot->desc.resolution == (uint32_t)op->resolution &&
	    profile_equal(&slot->profile, &op->profile);
}

static enum err check_slots(struct device *d, const struct tape *tape,
    const int *slots)
{
	const struct device_store *t = &d->tables;

	for (size_t i = 0; i < tape->operator_count; i++) {
		const struct operator *op = tape->operators + i;

		if (slots[i] < 0 || (size_t)slots[i] >= t->slot_count ||
		    !t->slots[slots[i]].used)
			return device_refuse(&d->failure, ERR_INVALID,
			    "operator %zu of the tape has no resident table",
			    i);
		if (!suits(&t->slots[slots[i]], op))
			return device_refuse(&d->failure, ERR_INVALID,
			    "operator %zu of the tape has another operator's "
			    "table", i);
	}
	return ERR_OK;
}

/* A buffer with a copy of size bytes, of at least 16. */
static enum err create(struct device *d, const void *from, size_t size,
    cl_mem *out)
{
	static const char nothing[16];
	cl_int code;

	if (size == 0) {
		from = nothing;
		size = sizeof(nothing);
	}
	/* The pointer is only read: CL_MEM_COPY_HOST_PTR. */
	*out = clCreateBuffer(d->context, CL_MEM_READ_ONLY |
	    CL_MEM_COPY_HOST_PTR, size, (void *)(uintptr_t)from, &code);
	if (!*out)
		return device_fail(&d->failure, "clCreateBuffer for a tape",
		    code);
	return ERR_OK;
}

/* The parameters in float32; beyond its range, at its end. */
static enum err create_params(struct device *d, const struct tape *tape,
    cl_mem *out)
{
	size_t size = tape->param_count * sizeof(float);
	float *params = malloc(size ? size : 1);
	enum err err;

	if (!params)
		return device_out_of_memory(&d->failure);
	for (size_t i = 0; i < tape->param_count; i++) {
		double p = tape->params[i];

		params[i] = (float)(p > FLT_MAX ? FLT_MAX :
		    p > -FLT_MAX ? p : -FLT_MAX);
	}
	err = create(d, params, size, out);
	free(params);
	return err;
}

/* The first operator of the tape with the same opening as operator i. */
static size_t first_alike(const struct tape *tape, size_t i)
{
	size_t k = 0;

	while (!opening_equal(&tape->operators[k].opening,
	    &tape->operators[i].opening))
		k++;
	return k;
}

/* Samples the distinct openings that depend on the angle, into floats. */
static size_t sample_openings(const struct tape *tape,
    struct operator_desc *descs, float *floats)
{
	size_t used = 0;

	for (size_t i = 0; i < tape->operator_count; i++) {
		const struct opening *o = &tape->operators[i].opening;
		size_t k = first_alike(tape, i);

		descs[i].is_constant = opening_is_constant(o);
		descs[i].theta_least = (float)opening_least(o);
		descs[i].theta = descs[i].theta_least;
		descs[i].opening_count = OPENING_TABLE_COUNT;
		if (descs[i].is_constant)
			continue;
		if (k < i) {
			descs[i].opening = descs[k].opening;
			continue;
		}
		descs[i].opening = (uint32_t)used;
		opening_table_build(o, OPENING_TABLE_COUNT, floats + used);
		used += OPENING_FLOATS;
	}
	return used;
}

static enum err create_operators(struct device *d, const struct tape *tape,
    const int *slots, struct device_tape *t)
{
	size_t count = tape->operator_count;
	struct operator_desc *descs = calloc(count + 1, sizeof(*descs));
	float *floats = malloc((count + 1) * OPENING_FLOATS * sizeof(*floats));
	enum err err = ERR_OK;
	size_t used;

	if (!descs || !floats) {
		err = device_out_of_memory(&d->failure);
		goto out;
	}
	for (size_t i = 0; i < count; i++)
		descs[i] = d->tables.slots[slots[i]].desc;
	used = sample_openings(tape, descs, floats);
	err = create(d, descs, count * sizeof(*descs), &t->descs);
	if (!err)
		err = create(d, floats, used * sizeof(*floats), &t->openings);
out:
	free(floats);
	free(descs);
	return err;
}

enum err device_load_tape(struct device *d, const struct tape *tape,
    const int *slots, struct device_tape **out)
{
	struct device_tape *t = NULL;
	enum err err = check(d, tape);

	if (err)
		return err;
	err = check_slots(d, tape, slots);
	if (err)
		return err;
	t = calloc(1, sizeof(*t));
	if (!t)
		return device_out_of_memory(&d->failure);
	t->insn_count = (uint32_t)tape->insn_count;
	err = create(d, tape->insns, tape->insn_count * sizeof(*tape->insns),
	    &t->insns);
	if (!err)
		err = create_params(d, tape, &t->params);
	if (!err)
		err = create_operators(d, tape, slots, t);
	if (err) {
		device_drop_tape(d, t);
		return err;
	}
	*out = t;
	return ERR_OK;
}

static void release(cl_mem buffer)
{
	if (buffer)
		clReleaseMemObject(buffer);
}

void device_drop_tape(struct device *d, struct device_tape *t)
{
	(void)d;
	if (!t)
		return;
	release(t->insns);
	release(t->params);
	release(t->descs);
	release(t->openings);
	free(t);
}
