/*
 * Compiles Blob-trees to tapes, in two walks over the expanded tree: the first
 * measures every node (expanded size, stack, lengths) and finds what is
 * wrong, the second writes instructions.
 *
 * The order of operands is Sethi and Ullman's (1970): of two, the one that
 * needs more stack goes first, so 2^d leaves need at most d + 1 jets.
 */
#include "core/tape.h"

#include <math.h>
#include <stdarg.h>
#include <stdbool.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "core/classic.h"
#include "core/support.h"
#include "core/tree.h"
#include "core/volume.h"

/* The shortest and the longest fall-off of the fields below a node. */
struct extent {
	double least, most;
};

/*
 * One expanded node as the first walk leaves it. The list is in preorder: a
 * node's first child, or its target, has the next place.
 */
struct measure {
	size_t last;           /* its last child's place */
	size_t previous, next; /* places of the siblings beside it */
	unsigned need;         /* stack it takes */
	unsigned before;       /* stack the fold of the siblings before takes */
	double most;           /* extent.most in its own frame */
};

/* Of a hash table of the tape's operators, with open addressing. */
struct slot {
	uint64_t hash;
	size_t number; /* index in tape->operators + 1; 0: free */
};

/* The way from the root to a node, through refs. */
struct path {
	const struct path *up;
	const struct node *node;
	size_t depth;
	unsigned warps; /* on the way, node included */
};

struct compiler {
	struct tape *tape;
	struct tape_error *error;
	double null_gradient;
	size_t max_nodes;
	struct measure *measures;
	size_t measure_count, measure_max;
	struct slot *slots; /* slot_count of them, a power of two, or none */
	size_t slot_count;
	size_t insn_max, box_max, param_max, operator_max, volume_max;
	bool framed;         /* the point is that of the last FRAME, */
	struct affine frame; /* which set this */
	struct vec3 color;   /* that the last COLOR set */
	size_t stack;        /* jets held at this point of the tape */
};

/* Where a node is written to: the base (the world, or the nearest warp's
 * image of it) seen from its parent's frame and the other way round, that warp,
 * the angle-dependent compositions above it, and the colour that it inherits. */
struct place {
	struct affine frame, outward;
	const struct support_warp *warp;
	unsigned extra;
	struct vec3 color;
};

/* Makes room for count more elements of size bytes after the first used. */
static enum err reserve(void *array, size_t *max, size_t used, size_t count,
    size_t size)
{
	void *old, *grown;
	size_t wanted = *max ? *max : 16;

	if (used + count <= *max)
		return ERR_OK;
	while (wanted < used + count)
		wanted *= 2;
	memcpy(&old, array, sizeof(old));
	grown = realloc(old, wanted * size);
	if (!grown)
		return ERR_MEMORY;
	memcpy(array, &grown, sizeof(grown));
	*max = wanted;
	return ERR_OK;
}

__attribute__((format(printf, 4, 5)))
static enum err refuse(struct compiler *c, enum err err,
    const struct node *node, const char *format, ...)
{
	va_list args;

	c->error->node = node;
	va_start(args, format);
	vsnprintf(c->error->detail, sizeof(c->error->detail), format, args);
	va_end(args);
	return err;
}

static enum err check_extent(struct compiler *c, const struct node *node,
    const struct extent *e, const char *where)
{
	if (e->least >= TREE_LENGTH_MIN && e->most <= TREE_LENGTH_MAX)
		return ERR_OK;
	return refuse(c, ERR_INVALID, node,
	    "in %s frame its field falls over lengths %.3g to %.3g, "
	    "which must lie in %g to %g", where, e->least, e->most,
	    TREE_LENGTH_MIN, TREE_LENGTH_MAX);
}

/* node's extent in its own frame to that in its parent's. */
static enum err leave_frame(struct compiler *c, const struct node *node,
    struct extent *e)
{
	double least, most;

	if (!node->has_transform)
		return ERR_OK;
	affine_stretch(&node->transform, &least, &most);
	if (least == 0.0)
		return refuse(c, ERR_INVALID, node,
		    "its transform is singular");
	e->least *= least;
	e->most *= most;
	return check_extent(c, node, e, "its parent's");
}

/* A ref may not lead to a node that it is itself below. */
static enum err check_cycle(struct compiler *c, const struct path *path)
{
	const struct node *target = path->node->target;

	for (const struct path *p = path; p; p = p->up)
		if (p->node == target)
			return refuse(c, ERR_INVALID, path->node,
			    "refers to itself through \"%s\"",
			    target->id ? target->id : "");
	return ERR_OK;
}

/* A volume's falloff fits what it samples. */
static enum err check_volume(struct compiler *c, const struct node *node)
{
	const struct volume *v = node->primitive.volume;
	double falloff = node->primitive.falloff;

	if (!v->is_distance && falloff != 0.0)
		return refuse(c, ERR_INVALID, node,
		    "its volume holds field values, which take no falloff");
	if (!v->is_distance)
		return ERR_OK;
	if (!(falloff > 0.0))
		return refuse(c, ERR_INVALID, node,
		    "its volume holds distances, which need a falloff");
	if (v->least_edge < falloff)
		return refuse(c, ERR_INVALID, node,
		    "its volume's edge comes within %.6g of the surface, less "
		    "than its falloff %.6g", v->least_edge, falloff);
	return ERR_OK;
}

static enum err begin_measure(struct compiler *c, const struct path *path)
{
	enum err ret;

	if (c->measure_count == c->max_nodes)
		return refuse(c, ERR_LIMIT, path->node,
		    "more than %zu nodes, counting each as often as refs "
		    "instance it", c->max_nodes);
	if (path->depth > TAPE_NESTING_MAX)
		return refuse(c, ERR_LIMIT, path->node,
		    "nested more than %d deep, following refs",
		    TAPE_NESTING_MAX);
	if (path->warps > TAPE_WARPS_MAX)
		return refuse(c, ERR_LIMIT, path->node,
		    "more than %d warps within each other, following refs",
		    TAPE_WARPS_MAX);
	ret = reserve(&c->measures, &c->measure_max, c->measure_count, 1,
	    sizeof(*c->measures));
	if (ret == ERR_OK)
		c->measures[c->measure_count++] = (struct measure){0};
	return ret;
}

static enum err measure_node(struct compiler *c, const struct node *node,
    const struct path *up, struct extent *e);

/* The stack for two operands, the deeper of them first. */
static unsigned pair_need(unsigned a, unsigned b)
{
	return a == b ? a + 1 : a > b ? a : b;
}

static enum err measure_children(struct compiler *c, const struct path *path,
    size_t place, struct extent *e)
{
	const struct node *node = path->node;
	size_t previous = 0;
	unsigned need = 0;

	*e = (struct extent){INFINITY, 0.0};
	for (size_t i = 0; i < node->child_count; i++) {
		size_t child = c->measure_count;
		struct extent below;
		enum err ret = measure_node(c, node->children[i], path, &below);
		struct measure *m = c->measures + child;

		if (ret != ERR_OK)
			return ret;
		if (i)
			c->measures[previous].next = child;
		m->previous = previous;
		m->before = need;
		need = i ? pair_need(need, m->need) : m->need;
		previous = child;
		e->least = fmin(e->least, below.least);
		e->most = fmax(e->most, below.most);
	}
	c->measures[place].last = previous;
	c->measures[place].need = need;
	return ERR_OK;
}

static enum err measure_primitive(struct compiler *c,
    const struct node *node, size_t place, struct extent *e)
{
	enum err ret = ERR_OK;

	if (node->primitive.type == PRIMITIVE_VOLUME)
		ret = check_volume(c, node);
	if (ret != ERR_OK)
		return ret;
	e->least = e->most = primitive_size(&node->primitive);
	c->measures[place].need = 1;
	return ERR_OK;
}

/* The one node that a ref or a warp has below. */
static enum err measure_below(struct compiler *c, const struct path *path,
    const struct node *below, size_t place, struct extent *e)
{
	enum err ret = measure_node(c, below, path, e);

	if (ret == ERR_OK)
		c->measures[place].need = c->measures[place + 1].need;
	return ret;
}

/* A warp takes points to its child's space: lengths there over its stretch. */
static enum err measure_warp(struct compiler *c, const struct path *path,
    size_t place, struct extent *e)
{
	const struct node *node = path->node;
	double least, most;
	enum err ret = measure_below(c, path, node->children[0], place, e);

	if (ret != ERR_OK)
		return ret;
	warp_stretch(&node->warp, &least, &most);
	e->least /= most;
	e->most /= least;
	return ERR_OK;
}

/* Measures node and all below it; *e: in its parent's frame. */
static enum err measure_node(struct compiler *c, const struct node *node,
    const struct path *up, struct extent *e)
{
	struct path path = {up, node, up ? up->depth + 1 : 1,
	    (up ? up->warps : 0) + (node->type == NODE_WARP)};
	size_t place = c->measure_count;
	enum err ret = begin_measure(c, &path);

	if (ret != ERR_OK)
		return ret;
	switch (node->type) {
	case NODE_PRIMITIVE:
		ret = measure_primitive(c, node, place, e);
		break;
	case NODE_REF:
		ret = check_cycle(c, &path);
		if (ret == ERR_OK)
			ret = measure_below(c, &path, node->target, place, e);
		break;
	case NODE_WARP:
		ret = measure_warp(c, &path, place, e);
		break;
	default:
		ret = measure_children(c, &path, place, e);
	}
	if (ret == ERR_OK)
		ret = check_extent(c, node, e, "its own");
	if (ret != ERR_OK)
		return ret;
	c->measures[place].most = e->most;
	return leave_frame(c, node, e);
}

/* Appends an instruction with its parameters. */
static enum err emit(struct compiler *c, unsigned op, unsigned extra,
    const double *params, size_t param_count, size_t index)
{
	struct tape *t = c->tape;
	enum err ret;

	if (t->param_count + param_count > UINT32_MAX)
		return refuse(c, ERR_LIMIT, NULL, "too many parameters");
	ret = reserve(&t->insns, &c->insn_max, t->insn_count, 1,
	    sizeof(*t->insns));
	if (ret == ERR_OK)
		ret = reserve(&t->boxes, &c->box_max, t->insn_count, 1,
		    sizeof(*t->boxes));
	if (ret == ERR_OK)
		ret = reserve(&t->params, &c->param_max, t->param_count,
		    param_count, sizeof(*t->params));
	if (ret != ERR_OK)
		return ret;
	t->insns[t->insn_count++] = (struct insn){
	    .op = op, .extra = extra < 2 ? extra : 2,
	    .param = param_count ? (OPCODE_UINT)t->param_count : 0,
	    .index = (OPCODE_UINT)index};
	if (param_count)
		memcpy(t->params + t->param_count, params,
		    param_count * sizeof(*params));
	t->param_count += param_count;
	return ERR_OK;
}

static bool affine_equal(const struct affine *a, const struct affine *b)
{
	for (int i = 0; i < 3; i++) {
		if (a->t[i] != b->t[i])
			return false;
		for (int j = 0; j < 3; j++)
			if (a->a[i][j] != b->a[i][j])
				return false;
	}
	return true;
}

#define FRAME_PARAMS 12

static void put_frame(const struct affine *frame,
    double params[static FRAME_PARAMS])
{
	memcpy(params, frame->a, sizeof(frame->a));
	memcpy(params + 9, frame->t, sizeof(frame->t));
}

static enum err emit_frame(struct compiler *c, const struct place *place)
{
	double params[FRAME_PARAMS];

	if (c->framed && affine_equal(&c->frame, &place->frame))
		return ERR_OK;
	c->frame = place->frame;
	c->framed = true;
	put_frame(&c->frame, params);
	return emit(c, OP_FRAME, place->extra, params, FRAME_PARAMS, 0);
}

static enum err emit_color(struct compiler *c, const struct place *place)
{
	const double rgb[3] = {place->color.x, place->color.y, place->color.z};

	if (c->color.x == rgb[0] && c->color.y == rgb[1] &&
	    c->color.z == rgb[2])
		return ERR_OK;
	c->color = place->color;
	return emit(c, OP_COLOR, place->extra, rgb, 3, 0);
}

/* After a node whose frame is not its parent's; moving it changes nothing. */
static enum err emit_carry(struct compiler *c, const struct affine *inverse,
    unsigned extra)
{
	struct affine moved = affine_identity();

	memcpy(moved.t, inverse->t, sizeof(moved.t));
	if (affine_equal(inverse, &moved))
		return ERR_OK;
	return emit(c, OP_CARRY, extra, &inverse->a[0][0], 9, 0);
}

static void push_jet(struct compiler *c)
{
	c->stack++;
	if (c->tape->stack_depth < c->stack)
		c->tape->stack_depth = c->stack;
}

/* The tape's index for v, which is held if it is new. */
static enum err intern_volume(struct compiler *c, struct volume *v,
    size_t *index)
{
	struct tape *t = c->tape;
	enum err ret;

	for (size_t i = t->volume_count; i-- > 0; )
		if (t->volumes[i] == v) {
			*index = i;
			return ERR_OK;
		}
	ret = reserve(&t->volumes, &c->volume_max, t->volume_count, 1,
	    sizeof(struct volume *));
	if (ret != ERR_OK)
		return ret;
	*index = t->volume_count;
	t->volumes[t->volume_count++] = volume_hold(v);
	return ERR_OK;
}

static enum err emit_primitive(struct compiler *c, const struct node *node,
    const struct place *place)
{
	double params[PRIMITIVE_PARAMS_MAX];
	int count = primitive_prepare(&node->primitive, params);
	size_t index = 0;
	enum err ret = emit_frame(c, place);

	if (ret == ERR_OK)
		ret = emit_color(c, place);
	if (ret == ERR_OK && node->primitive.type == PRIMITIVE_VOLUME)
		ret = intern_volume(c, node->primitive.volume, &index);
	if (ret != ERR_OK)
		return ret;
	c->tape->primitive_count++;
	push_jet(c);
	ret = emit(c, primitive_opcode(node->primitive.type), place->extra,
	    params, (size_t)count, index);
	if (ret == ERR_OK)
		c->tape->boxes[c->tape->insn_count - 1] =
		    support_box(&node->primitive, &place->frame,
		    &place->outward, place->warp);
	return ret;
}

static uint64_t hash_numbers(uint64_t hash, const double *numbers,
    size_t count)
{
	for (size_t i = 0; i < count; i++) {
		double n = numbers[i] + 0.0; /* -0 equals 0 */
		uint64_t bits;

		memcpy(&bits, &n, sizeof(bits));
		/* splitmix64's finaliser (Steele et al. 2014) */
		hash = (hash ^ bits) + 0x9e3779b97f4a7c15u;
		hash = (hash ^ (hash >> 30)) * 0xbf58476d1ce4e5b9u;
		hash ^= hash >> 27;
	}
	return hash;
}

static uint64_t hash_operator(const struct operator *op,
    enum operator_family family)
{
	const double kinds[6] = {family, op->layout, op->resolution,
	    op->draft, op->profile.type, op->profile.type == PROFILE_BULGE
	    ? op->profile.k : 0.0};
	uint64_t hash = hash_numbers(0, kinds, 6);

	hash = hash_numbers(hash, op->opening.alpha, 3);
	hash = hash_numbers(hash, op->opening.theta, 3);
	hash = hash_numbers(hash, op->opening.w, 2);
	if (op->profile.type == PROFILE_SAMPLES) {
		size_t count = (size_t)op->profile.count;

		hash = hash_numbers(hash, op->profile.x, count);
		hash = hash_numbers(hash, op->profile.y, count);
	}
	return hash;
}

/* a is of the tape; b's family is given. */
static bool operator_equal(const struct operator *a, const struct operator *b,
    enum operator_family family)
{
	return a->family == family && a->layout == b->layout &&
	    a->resolution == b->resolution && a->draft == b->draft &&
	    opening_equal(&a->opening, &b->opening) &&
	    profile_equal(&a->profile, &b->profile);
}

/* The first free slot from hash's own on. */
static struct slot *free_slot(struct slot *slots, size_t count, uint64_t hash)
{
	size_t i = hash & (count - 1);

	while (slots[i].number)
		i = (i + 1) & (count - 1);
	return slots + i;
}

/* Makes room for one more operator, with half of the slots free. */
static enum err grow_slots(struct compiler *c)
{
	size_t count = c->slot_count ? 2 * c->slot_count : 16;
	struct slot *grown;

	if (2 * (c->tape->operator_count + 1) <= c->slot_count)
		return ERR_OK;
	grown = calloc(count, sizeof(*grown));
	if (!grown)
		return ERR_MEMORY;
	for (size_t i = 0; i < c->slot_count; i++)
		if (c->slots[i].number)
			*free_slot(grown, count, c->slots[i].hash) = c->slots[i];
	free(c->slots);
	c->slots = grown;
	c->slot_count = count;
	return ERR_OK;
}

/* Adds op, which is new; its index is the last. */
static enum err add_operator(struct compiler *c, const struct operator *op,
    enum operator_family family, uint64_t hash)
{
	struct tape *t = c->tape;
	size_t i = t->operator_count;
	enum err ret = reserve(&t->operators, &c->operator_max, i, 1,
	    sizeof(*t->operators));

	if (ret == ERR_OK)
		ret = grow_slots(c);
	if (ret != ERR_OK)
		return ret;
	t->operators[i] = *op;
	t->operators[i].family = family;
	*free_slot(c->slots, c->slot_count, hash) = (struct slot){hash, i + 1};
	t->operator_count++;
	return ERR_OK;
}

/* The tape's index for op as one of family, which is added if it is new. */
static enum err intern_operator(struct compiler *c, const struct operator *op,
    enum operator_family family, size_t *index)
{
	struct tape *t = c->tape;
	uint64_t hash = hash_operator(op, family);
	size_t mask = c->slot_count - 1;

	for (size_t i = hash & mask; c->slot_count && c->slots[i].number;
	    i = (i + 1) & mask) {
		*index = c->slots[i].number - 1;
		if (c->slots[i].hash == hash &&
		    operator_equal(t->operators + *index, op, family))
			return ERR_OK;
	}
	*index = t->operator_count;
	return add_operator(c, op, family, hash);
}

/* What one composition node emits between its operands. */
struct fold {
	unsigned op, op_swapped;
	size_t index;
	double params[CLASSIC_PARAMS_MAX];
	size_t param_count;
	unsigned steps; /* orders each pair asks of its operands: 0 or 1 */
};

static void prepare_classic(const struct node *node, struct fold *out)
{
	int family = node->type == NODE_UNION ? CLASSIC_UNION
	    : node->type == NODE_INTERSECTION ? CLASSIC_INTERSECTION
	    : CLASSIC_DIFFERENCE;

	*out = (struct fold){.op = OP_CLASSIC, .op_swapped = OP_CLASSIC_SWAPPED,
	    .index = node->classic->type, .param_count = CLASSIC_PARAMS_MAX};
	classic_prepare(node->classic, family, out->params);
}

static enum err prepare_fold(struct compiler *c, const struct node *node,
    size_t place, struct fold *out)
{
	static const struct {
		unsigned sharp, blended;
	} ops[NODE_TYPE_COUNT] = {
		[NODE_UNION] = {OP_MAX, OP_UNION},
		[NODE_INTERSECTION] = {OP_MIN, OP_INTERSECTION},
		[NODE_DIFFERENCE] = {OP_MINUS, OP_DIFFERENCE},
		[NODE_SUM] = {OP_SUM, OP_SUM},
		[NODE_RICCI] = {OP_RICCI, OP_RICCI},
		[NODE_CONVOLUTION] = {OP_SUM, OP_SUM},
	};
	bool arithmetic = node->type == NODE_SUM ||
	    node->type == NODE_RICCI || node->type == NODE_CONVOLUTION;
	bool sharp = arithmetic || node->sharp;

	if (!sharp && node->classic) {
		prepare_classic(node, out);
		return ERR_OK;
	}
	*out = (struct fold){.op = sharp ? ops[node->type].sharp
	    : ops[node->type].blended};
	/* the others are symmetric */
	out->op_swapped = out->op == OP_MINUS ? OP_MINUS_SWAPPED
	    : out->op == OP_DIFFERENCE ? OP_DIFFERENCE_SWAPPED : out->op;
	if (node->type == NODE_RICCI) {
		out->params[0] = node->n;
		out->param_count = 1;
	}
	if (sharp || node->child_count < 2)
		return ERR_OK;
	out->params[0] = c->null_gradient / c->measures[place].most;
	out->param_count = 1;
	out->steps = opening_is_constant(&node->op->opening) ? 0 : 1;
	return intern_operator(c, node->op, node->type == NODE_UNION
	    ? FAMILY_UNION : FAMILY_INTERSECTION, &out->index);
}

static enum err emit_node(struct compiler *c, const struct node *node,
    size_t place, const struct place *parent);

static enum err emit_pair(struct compiler *c, const struct fold *fold,
    bool swapped, unsigned extra)
{
	c->stack--;
	return emit(c, swapped ? fold->op_swapped : fold->op, extra,
	    fold->params, fold->param_count, fold->index);
}

/* Child i of node, whose fold is given, with m its measures' place. */
static enum err emit_child(struct compiler *c, const struct node *node,
    size_t i, size_t m, const struct place *at, const struct fold *fold)
{
	struct place below = *at;

	/* pairs above it: c0 and c1 are both below all of them */
	below.extra += fold->steps * (unsigned)(node->child_count - (i ? i : 1));
	return emit_node(c, node->children[i], m, &below);
}

/* A child that goes before the fold of its earlier siblings. */
static bool goes_first(const struct measure *child)
{
	return child->need > child->before;
}

/*
 * The fold ((c0, c1), c2) ... with, at every pair, the deeper operand first:
 * the children deeper than the fold before them come out last to first (c0
 * always), then the pairs from the innermost, each after its child if that is
 * still due.
 */
static enum err emit_children(struct compiler *c, const struct node *node,
    size_t place, const struct place *at)
{
	size_t count = node->child_count, m = c->measures[place].last;
	struct fold fold;
	enum err ret = prepare_fold(c, node, place, &fold);

	for (size_t i = count; i-- > 0 && ret == ERR_OK;
	    m = c->measures[m].previous)
		if (goes_first(c->measures + m))
			ret = emit_child(c, node, i, m, at, &fold);
	m = c->measures[place + 1].next;
	for (size_t i = 1; i < count && ret == ERR_OK;
	    i++, m = c->measures[m].next) {
		bool swapped = goes_first(c->measures + m);

		if (!swapped)
			ret = emit_child(c, node, i, m, at, &fold);
		if (ret == ERR_OK)
			ret = emit_pair(c, &fold, swapped, at->extra +
			    fold.steps * (unsigned)(count - 1 - i));
	}
	return ret;
}

/* ENTER, the child on a base of its own, LEAVE. */
static enum err emit_warp(struct compiler *c, const struct node *node,
    size_t place, const struct place *at)
{
	const struct support_warp warp = {&node->warp, at->frame, at->outward,
	    at->warp};
	struct place below = *at;
	double params[FRAME_PARAMS + WARP_PARAMS_MAX];
	const size_t count = FRAME_PARAMS + WARP_PARAMS_MAX;
	enum err ret;

	put_frame(&at->frame, params);
	warp_prepare(&node->warp, params + FRAME_PARAMS);
	ret = emit(c, OP_ENTER, at->extra, params, count, node->warp.type);
	if (ret != ERR_OK)
		return ret;
	below.frame = below.outward = affine_identity();
	below.warp = &warp;
	c->framed = false;
	ret = emit_node(c, node->children[0], place + 1, &below);
	if (ret != ERR_OK)
		return ret;
	c->framed = false;
	return emit(c, OP_LEAVE, at->extra, params, count, node->warp.type);
}

static enum err emit_node(struct compiler *c, const struct node *node,
    size_t place, const struct place *parent)
{
	struct place at = *parent;
	struct affine inverse;
	enum err ret;

	if (node->has_color)
		at.color = node->color;
	if (node->has_transform) {
		affine_invert(&node->transform, &inverse);
		at.frame = affine_compose(&inverse, &parent->frame);
		at.outward = affine_compose(&parent->outward, &node->transform);
	}
	if (node->type == NODE_PRIMITIVE)
		ret = emit_primitive(c, node, &at);
	else if (node->type == NODE_REF)
		ret = emit_node(c, node->target, place + 1, &at);
	else if (node->type == NODE_WARP)
		ret = emit_warp(c, node, place, &at);
	else
		ret = emit_children(c, node, place, &at);
	if (ret == ERR_OK && node->has_transform)
		ret = emit_carry(c, &inverse, at.extra);
	return ret;
}

static enum err compile(struct compiler *c, const struct tree *tree)
{
	const double gray = TREE_COLOR_DEFAULT;
	struct place world = {.frame = affine_identity(),
	    .outward = affine_identity(), .color = {gray, gray, gray}};
	struct extent e;
	enum err ret = measure_node(c, tree->root, NULL, &e);

	if (ret != ERR_OK)
		return ret;
	if (c->measures[0].need > TAPE_STACK_MAX)
		return refuse(c, ERR_LIMIT, tree->root,
		    "needs a stack of more than %d fields", TAPE_STACK_MAX);
	c->framed = true;
	c->frame = world.frame;
	c->color = world.color;
	c->tape->node_count = c->measure_count;
	ret = emit_node(c, tree->root, 0, &world);
	if (ret != ERR_OK)
		return ret;
	support_compose(c->tape);
	tape_mark_runs(c->tape->insns, c->tape->insn_count, c->tape->params);
	return ERR_OK;
}

enum err tape_compile(const struct tree *tree, size_t max_nodes,
    struct tape **out, struct tape_error *error)
{
	struct compiler c = {.error = error, .max_nodes = max_nodes,
	    .null_gradient = tree->null_gradient};
	enum err ret = ERR_MEMORY;

	c.tape = calloc(1, sizeof(*c.tape));
	if (c.tape)
		ret = compile(&c, tree);
	free(c.measures);
	free(c.slots);
	if (ret != ERR_OK) {
		tape_free(c.tape);
		return ret;
	}
	*out = c.tape;
	return ERR_OK;
}

/* Where the exponent is among OP_POINT's parameters. */
#define POINT_EXPONENT 4

void tape_mark_runs(struct insn *insns, size_t count, const double *params)
{
	for (size_t i = 0; i < count; i++)
		if (insns[i].op == OP_POINT)
			insns[i].index =
			    params[insns[i].param + POINT_EXPONENT] == 3.0;
	tape_count_runs(insns, count);
}

void tape_count_runs(struct insn *insns, size_t count)
{
	for (size_t i = count; i-- > 0;) {
		if (insns[i].op != OP_POINT || insns[i].index == 0)
			continue;
		insns[i].index = 0;
		if (i + 1 == count || insns[i + 1].op != OP_SUM)
			continue;
		insns[i].index = 1;
		if (i + 2 < count && insns[i + 2].op == OP_POINT)
			insns[i].index += insns[i + 2].index;
	}
}

void tape_free(struct tape *t)
{
	if (!t)
		return;
	for (size_t i = 0; i < t->volume_count; i++)
		volume_release(t->volumes[i]);
	free(t->volumes);
	free(t->insns);
	free(t->boxes);
	free(t->params);
	free(t->operators);
	free(t);
}
