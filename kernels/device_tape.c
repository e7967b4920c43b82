#include "kernels/device_internal.h"

#include <float.h>
#include <stdlib.h>
#include <string.h>

#include "core/classic.h"
#include "core/convolution.h"
#include "core/curve.h"
#include "core/opening_table.h"
#include "core/tape.h"
#include "core/tiles.h"
#include "core/volume.h"
#include "core/warp.h"

#define OPENING_FLOATS (OPENING_TABLE_COUNT * CURVE_NODE)

/*
 * What a GPU is taken to evaluate faster than a core that culls. 50 points under
 * camel take an H100 2.4 ns a point, cores 530 (core/tiles.c); 16 cores that
 * culled made the whole batch take 1.4 to 1.8 times as long.
 */
#define GPU_SPEED 128.0

/* Parameters an opcode reads (core/opcode.h). */
static const unsigned char param_counts[OP_COUNT] = {
	[OP_FRAME] = 12, [OP_CARRY] = 9,
	[OP_POINT] = 6, [OP_SEGMENT] = 11, [OP_TRIANGLE] = 12, [OP_DISC] = 10,
	[OP_CIRCLE] = 10, [OP_SPHERE] = 5, [OP_BOX] = 8, [OP_CYLINDER] = 9,
	[OP_CAPSULE] = 9, [OP_CONE] = 10, [OP_TORUS] = 9, [OP_PLANE] = 7,
	[OP_COLOR] = 3, [OP_ENTER] = 12 + WARP_PARAMS_MAX,
	[OP_LEAVE] = 12 + WARP_PARAMS_MAX,
	[OP_CAUCHY_POINT] = 5, [OP_CAUCHY_SEGMENT] = 9,
	[OP_CAUCHY_TRIANGLE] = CAUCHY_TRIANGLE_PARAMS, [OP_VOLUME] = 10,
	[OP_CLASSIC] = CLASSIC_PARAMS_MAX,
	[OP_CLASSIC_SWAPPED] = CLASSIC_PARAMS_MAX,
	[OP_RICCI] = 1, [OP_UNION] = 1, [OP_INTERSECTION] = 1,
	[OP_DIFFERENCE] = 1, [OP_DIFFERENCE_SWAPPED] = 1,
};

/* Jets an instruction takes off the stack and puts on it. */
static void stack_use(uint32_t op, size_t *takes, size_t *puts)
{
	bool replaces = op == OP_CARRY || op == OP_LEAVE;

	*takes = op >= OP_MAX ? 2 : replaces;
	*puts = op >= OP_PRIMITIVES || replaces;
}

/* How many things of its kind an opcode's index may name. */
static size_t index_count(const struct tape *tape, uint32_t op)
{
	if (op >= OP_UNION)
		return tape->operator_count;
	if (op >= OP_CLASSIC)
		return CLASSIC_TYPE_COUNT;
	if (op == OP_VOLUME)
		return tape->volume_count;
	return op == OP_ENTER || op == OP_LEAVE ? WARP_TYPE_COUNT : SIZE_MAX;
}

static const char *insn_fault(const struct tape *tape, const struct insn *insn)
{
	if (insn->op >= OP_COUNT)
		return "has an unknown opcode";
	if (insn->op == OP_ZERO)
		return "is left by pruning only";
	if (insn->extra > 2)
		return "asks for too high an order";
	/* The interpreter reads one even where the opcode has none. */
	if (insn->param >= tape->param_count ||
	    tape->param_count - insn->param < param_counts[insn->op])
		return "reads parameters beyond the last";
	if (insn->index >= index_count(tape, insn->op))
		return "uses an operator, a warp or a volume that is not there";
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

/* What a tape's check keeps of the instructions before. */
struct walk {
	unsigned extra[TAPE_STACK_MAX]; /* of each jet on the stack */
	size_t depth;
	uint32_t warps[TAPE_WARPS_MAX]; /* the types of those entered */
	size_t entered;
};

/* Follows one instruction over the stack of jets. */
static const char *walk_jets(struct walk *w, const struct tape *tape,
    const struct insn *insn)
{
	size_t takes, puts;

	stack_use(insn->op, &takes, &puts);
	if (w->depth < takes)
		return "finds too few jets on the stack";
	if (w->depth - takes + puts > TAPE_STACK_MAX)
		return "finds the stack full";
	for (size_t k = 0; k < takes; k++)
		if (w->extra[w->depth - 1 - k] < operand_extra(tape, insn))
			return "needs more derivatives than its operands have";
	w->depth += puts - takes;
	if (puts > 0)
		w->extra[w->depth - 1] = insn->extra;
	return NULL;
}

/* And over the warps entered. */
static const char *walk_warps(struct walk *w, const struct insn *insn)
{
	if (insn->op == OP_ENTER) {
		if (w->entered == TAPE_WARPS_MAX)
			return "enters too many warps";
		w->warps[w->entered++] = insn->index;
	} else if (insn->op == OP_LEAVE) {
		if (w->entered == 0 || w->warps[--w->entered] != insn->index)
			return "leaves a warp that it is not in";
	}
	return NULL;
}

/*
 * Whether the run that instruction i says it begins is one. *known: instructions
 * before it are in a run that was found to be one.
 */
static const char *run_fault(const struct tape *tape, size_t i, size_t *known)
{
	size_t pairs = tape->insns[i].index, k = i < *known ? (*known - i) / 2 : 0;

	if (tape->insns[i].op != OP_POINT || pairs == 0)
		return NULL;
	if (pairs > (tape->insn_count - i) / 2)
		return "begins a run beyond the last";
	for (; k < pairs; k++) {
		const struct insn *insn = tape->insns + i + 2 * k;

		if (insn->op != OP_POINT || insn[1].op != OP_SUM ||
		    insn->extra != tape->insns[i].extra ||
		    insn->param >= tape->param_count ||
		    tape->param_count - insn->param < 6 ||
		    (float)tape->params[insn->param + 4] != 3.0f)
			return "begins a run of other things than points";
	}
	if (i + 2 * pairs > *known)
		*known = i + 2 * pairs;
	return NULL;
}

/*
 * A kernel checks nothing, and one access out of bounds would kill the
 * process: so every tape is checked, though tape_compile makes only good ones.
 */
static enum err check(struct device *d, const struct tape *tape)
{
	struct walk w = {.depth = 0};
	size_t known = 0;

	for (size_t i = 0; i < tape->insn_count; i++) {
		const char *fault = insn_fault(tape, tape->insns + i);

		if (!fault)
			fault = run_fault(tape, i, &known);
		if (!fault)
			fault = walk_jets(&w, tape, tape->insns + i);
		if (!fault)
			fault = walk_warps(&w, tape->insns + i);
		if (fault)
			return device_refuse(&d->failure, ERR_INVALID,
			    "instruction %zu of the tape %s", i, fault);
	}
	if (w.depth != 1 || w.entered != 0)
		return device_refuse(&d->failure, ERR_INVALID,
		    "the tape leaves %zu jets on the stack, not 1, and is in "
		    "%zu warps", w.depth, w.entered);
	if (tape->insn_count > UINT32_MAX || tape->param_count > UINT32_MAX)
		return device_refuse(&d->failure, ERR_INVALID,
		    "the tape is longer than 32 bits can count");
	return ERR_OK;
}

/* Whether DEVICE_PLAIN knows an instruction, or may pass it over. */
static bool is_plain(uint32_t op)
{
	return op <= OP_COLOR || (op >= OP_POINT && op <= OP_PLANE) ||
	    (op >= OP_MAX && op <= OP_RICCI) || op >= OP_UNION;
}

static bool all_plain(const struct tape *tape)
{
	for (size_t i = 0; i < tape->insn_count; i++)
		if (!is_plain(tape->insns[i].op))
			return false;
	return true;
}

static bool suits(const struct device_slot *slot, const struct operator *op)
{
	return slot->desc.family == (uint32_t)op->family &&
	    slot->desc.layout == (uint32_t)op->layout &&
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

/* A buffer with a copy of size bytes, of at least 16, which t is said to
 * take. */
static enum err create(struct device *d, struct device_tape *t,
    const void *from, size_t size, cl_mem *out)
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
	t->bytes += size;
	return ERR_OK;
}

/* The parameters in float32; beyond its range, at its end. */
static enum err create_params(struct device *d, const struct tape *tape,
    struct device_tape *t)
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
	err = create(d, t, params, size, &t->params);
	free(params);
	return err;
}

static int compare_openings(const void *a, const void *b)
{
	const struct operator *const *x = a, *const *y = b;

	return opening_compare(&(*x)->opening, &(*y)->opening);
}

/*
 * Samples the openings that depend on the angle into floats, equal ones once;
 * sorted has room for the tape's operators.
 */
static size_t sample_openings(const struct tape *tape,
    const struct operator **sorted, struct operator_desc *descs, float *floats)
{
	size_t count = tape->operator_count, used = 0;

	for (size_t i = 0; i < count; i++)
		sorted[i] = tape->operators + i;
	qsort(sorted, count, sizeof(*sorted), compare_openings);
	for (size_t i = 0; i < count; i++) {
		const struct opening *o = &sorted[i]->opening;
		struct operator_desc *desc = descs + (sorted[i] -
		    tape->operators);
		bool is_new = i == 0 ||
		    !opening_equal(o, &sorted[i - 1]->opening);

		desc->is_constant = opening_is_constant(o);
		desc->theta_least = (float)opening_least(o);
		desc->theta = desc->theta_least;
		desc->opening_count = OPENING_TABLE_COUNT;
		if (desc->is_constant)
			continue;
		if (is_new) {
			opening_table_build(o, OPENING_TABLE_COUNT,
			    floats + used);
			used += OPENING_FLOATS;
		}
		desc->opening = (uint32_t)(used - OPENING_FLOATS);
	}
	return used;
}

static enum err create_operators(struct device *d, const struct tape *tape,
    const int *slots, struct device_tape *t)
{
	size_t count = tape->operator_count;
	struct operator_desc *descs = calloc(count + 1, sizeof(*descs));
	float *floats = malloc((count + 1) * OPENING_FLOATS * sizeof(*floats));
	const struct operator **sorted = calloc(count + 1, sizeof(*sorted));
	enum err err = ERR_OK;
	size_t used;

	if (!descs || !floats || !sorted) {
		err = device_out_of_memory(&d->failure);
		goto out;
	}
	for (size_t i = 0; i < count; i++)
		descs[i] = d->tables.slots[slots[i]].desc;
	used = sample_openings(tape, sorted, descs, floats);
	err = create(d, t, descs, count * sizeof(*descs), &t->descs);
	if (!err)
		err = create(d, t, floats, used * sizeof(*floats),
		    &t->openings);
out:
	free(sorted);
	free(floats);
	free(descs);
	return err;
}

/* Has every volume of the tape on the device, and lists where. */
static enum err create_volumes(struct device *d, const struct tape *tape,
    struct device_tape *t)
{
	size_t count = tape->volume_count;
	uint32_t *firsts = calloc(count + 1, sizeof(*firsts));
	enum err err = ERR_OK;

	t->volume_serials = calloc(count + 1, sizeof(*t->volume_serials));
	if (!firsts || !t->volume_serials)
		err = device_out_of_memory(&d->failure);
	for (size_t i = 0; !err && i < count; i++) {
		err = device_volume_hold(d, tape->volumes[i], firsts + i);
		if (!err)
			t->volume_serials[t->volume_count++] =
			    tape->volumes[i]->serial;
	}
	if (!err)
		err = create(d, t, firsts, count * sizeof(*firsts),
		    &t->volumes);
	free(firsts);
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
	t->is_plain = all_plain(tape);
	err = create(d, t, tape->insns,
	    tape->insn_count * sizeof(*tape->insns), &t->insns);
	if (!err)
		err = create_params(d, tape, t);
	if (!err)
		err = create_operators(d, tape, slots, t);
	if (!err)
		err = create_volumes(d, tape, t);
	if (!err && d->culling != DEVICE_CULLING_NEVER && tape->boxes &&
	    tiles_create(tape, d->info.is_gpu ? GPU_SPEED : 1.0,
	    &t->tiles) != ERR_OK)
		err = device_out_of_memory(&d->failure);
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
	if (!t)
		return;
	for (size_t i = 0; i < t->volume_count; i++)
		device_volume_release(d, t->volume_serials[i]);
	free(t->volume_serials);
	tiles_free(t->tiles);
	release(t->volumes);
	release(t->insns);
	release(t->params);
	release(t->descs);
	release(t->openings);
	free(t);
}

size_t device_tape_bytes(const struct device_tape *t)
{
	return sizeof(*t) + t->bytes + (t->tiles ? tiles_bytes(t->tiles) : 0);
}
