/*
 * Pruned lists against the whole tape: the same numbers at every point of the
 * box that they were pruned to.
 */
#include <stdarg.h>
#include <stddef.h>
#include <setjmp.h>
#include <stdint.h>
#include <cmocka.h>

#include <math.h>
#include <stdbool.h>
#include <stdlib.h>
#include <string.h>

#include "core/evaluate.h"
#include "core/prune.h"
#include "core/tape.h"
#include "core/tree.h"
#include "tests/support/near.h"
#include "tests/support/random_tree.h"
#include "tests/support/sanitized.h"

#define MAX_NODES 4096

/* Trees are tried fewer times under a sanitizer. */
#define TIMES(n) (SANITIZED ? (n) / 8 : (n))

static struct tape *compile(const struct node *root)
{
	const struct tree tree = {root, TREE_NULL_GRADIENT};
	struct tape_error error;
	struct tape *tape;

	assert_int_equal(tape_compile(&tree, MAX_NODES, &tape, &error), ERR_OK);
	return tape;
}

/* A tape, what was pruned of it, and what pruning needs. */
struct pruned {
	struct tape *tape;
	struct tape part; /* the tape with the list's instructions */
	struct prune_list list;
	bool *is_constant;
};

static struct prune_list list_create(size_t count)
{
	count += PRUNE_ROOM;
	return (struct prune_list){
	    .insns = malloc(count * sizeof(struct insn)),
	    .boxes = malloc(count * sizeof(struct tape_box))};
}

static void list_free(struct prune_list *list)
{
	free(list->insns);
	free(list->boxes);
}

static struct pruned pruned_create(struct tape *tape)
{
	struct pruned p = {.tape = tape, .part = *tape,
	    .list = list_create(tape->insn_count),
	    .is_constant = calloc(tape->operator_count + 1, sizeof(bool))};

	for (size_t i = 0; i < tape->operator_count; i++)
		p.is_constant[i] =
		    opening_is_constant(&tape->operators[i].opening);
	return p;
}

static void pruned_free(struct pruned *p)
{
	list_free(&p->list);
	free(p->is_constant);
	tape_free(p->tape);
}

static struct prune_list whole_of(const struct tape *tape)
{
	return (struct prune_list){.insns = tape->insns, .boxes = tape->boxes,
	    .count = tape->insn_count};
}

static void prune_to(struct pruned *p, const struct tape_box *box)
{
	const struct prune_list whole = whole_of(p->tape);

	prune(&whole, box, p->is_constant, &p->list);
	p->part.insns = p->list.insns;
	p->part.insn_count = p->list.count;
}

static bool same(double a, double b)
{
	a += 0.0; /* the signs of zeros are of no account */
	b += 0.0;
	return memcmp(&a, &b, sizeof(a)) == 0;
}

static bool same_vectors(struct vec3 a, struct vec3 b)
{
	return same(a.x, b.x) && same(a.y, b.y) && same(a.z, b.z);
}

static bool same_jets(const struct jet *a, const struct jet *b)
{
	return same(a->value, b->value) &&
	    same_vectors(a->gradient, b->gradient) &&
	    same(a->hessian.xx, b->hessian.xx) &&
	    same(a->hessian.yy, b->hessian.yy) &&
	    same(a->hessian.zz, b->hessian.zz) &&
	    same(a->hessian.xy, b->hessian.xy) &&
	    same(a->hessian.xz, b->hessian.xz) &&
	    same(a->hessian.yz, b->hessian.yz);
}

static void assert_same(const struct pruned *p, struct vec3 x,
    unsigned long which)
{
	for (int order = 0; order <= 2; order++) {
		struct jet whole, part;

		evaluate(p->tape, x, order, &whole);
		evaluate(&p->part, x, order, &part);
		if (!same_jets(&whole, &part))
			fail_msg("%lu: of order %d at (%.9g, %.9g, %.9g) the "
			    "part is %.17g (%.17g ...), the whole %.17g "
			    "(%.17g ...)", which, order, x.x, x.y, x.z,
			    part.value, part.gradient.x, whole.value,
			    whole.gradient.x);
	}
}

/* Jets that instructions take and give. */
static int balance(unsigned op)
{
	return op >= OP_MAX ? -1 : op >= OP_PRIMITIVES;
}

/* What tape_compile would make: orders suffice, the stack ends with one jet,
 * every warp is left, every primitive has its frame. */
static void assert_sound(const struct pruned *p)
{
	unsigned extra[TAPE_STACK_MAX + 1];
	int depth = 0, warps = 0;
	bool is_framed = true;

	assert_true(p->list.count <= p->tape->insn_count + PRUNE_ROOM);
	for (size_t i = 0; i < p->list.count; i++) {
		const struct insn *insn = p->list.insns + i;
		bool by_angle = insn->op >= OP_UNION &&
		    !p->is_constant[insn->index];
		unsigned least = insn->extra + by_angle;

		if (insn->op == OP_FRAME || insn->op == OP_COLOR) {
			assert_true(i + 1 < p->list.count);
			is_framed |= insn->op == OP_FRAME;
			continue;
		}
		warps += (insn->op == OP_ENTER) - (insn->op == OP_LEAVE);
		assert_true(warps >= 0 && warps <= TAPE_WARPS_MAX);
		if (insn->op == OP_ENTER || insn->op == OP_LEAVE)
			is_framed = false;
		if (balance(insn->op) > 0)
			assert_true(is_framed || insn->op == OP_ZERO);
		if (balance(insn->op) < 0) {
			assert_true(depth >= 2);
			assert_int_equal(extra[depth - 1], least < 2 ? least
			    : 2);
			assert_int_equal(extra[depth - 2], extra[depth - 1]);
		} else if (insn->op == OP_CARRY || insn->op == OP_LEAVE) {
			assert_int_equal(extra[depth - 1], insn->extra);
		}
		depth += balance(insn->op);
		assert_true(insn->op == OP_ENTER || depth >= 1);
		assert_true(depth <= (int)p->tape->stack_depth);
		if (depth > 0 && insn->op != OP_ENTER)
			extra[depth - 1] = insn->extra;
	}
	assert_int_equal(depth, 1);
	assert_int_equal(warps, 0);
	assert_int_equal(p->list.insns[p->list.count - 1].extra, 0);
}

static struct tape_box box_about(struct vec3 p, struct random_stream *r)
{
	double reach = exp2(random_in(r, -8.0, 1.5));
	const double c[3] = {p.x, p.y, p.z};
	struct tape_box box;

	for (int i = 0; i < 3; i++) {
		box.min[i] = (float)(c[i] - reach * random_in(r, 0.1, 1.0));
		box.max[i] = (float)(c[i] + reach * random_in(r, 0.1, 1.0));
	}
	return box;
}

/* Uniform in the box, or at a corner of it. */
static struct vec3 point_in(const struct tape_box *box,
    struct random_stream *r)
{
	bool corner = random_below(r, 4) == 0;
	double x[3];

	for (int i = 0; i < 3; i++)
		x[i] = corner ? (random_below(r, 2) ? box->min : box->max)[i]
		    : random_in(r, box->min[i], box->max[i]);
	return vec3(x[0], x[1], x[2]);
}

/* Boxes about points that matter to random trees; the mean length of what is
 * left of a tape over the whole's. */
static double check_trees(const struct random_tree_options *like, int trees)
{
	enum { BOXES = 12, POINTS = 6 };
	struct random_stream r = {like->seed};
	float xyz[3 * BOXES];
	double left = 0.0;

	for (int n = 0; n < trees; n++) {
		struct random_tree_options options = *like;
		struct random_tree *t;
		struct pruned p;

		options.seed = like->seed + (uint64_t)n;
		t = random_tree_create(&options);
		p = pruned_create(compile(random_tree_get(t)->root));
		random_tree_points(t, p.tape, options.seed, BOXES, xyz);
		for (int i = 0; i < BOXES; i++) {
			struct vec3 c = vec3(xyz[3 * i], xyz[3 * i + 1],
			    xyz[3 * i + 2]);
			struct tape_box box = box_about(c, &r);

			prune_to(&p, &box);
			assert_sound(&p);
			left += (double)p.list.count /
			    (double)p.tape->insn_count;
			for (int k = 0; k < POINTS; k++)
				assert_same(&p, point_in(&box, &r),
				    (unsigned long)options.seed);
		}
		pruned_free(&p);
		random_tree_free(t);
	}
	return left / (trees * BOXES);
}

static void test_prune_of_random_trees_changes_no_number(void **state)
{
	(void)state;
	/* 0.65 is left */
	assert_true(check_trees(&(struct random_tree_options){.seed = 1},
	    TIMES(100)) < 0.75);
}

static void test_prune_of_the_whole_language_changes_no_number(void **state)
{
	(void)state;
	/* 0.83 is left */
	assert_true(check_trees(&(struct random_tree_options){.seed = 1001,
	    .whole = true}, TIMES(120)) < 0.9);
}

/* ---- single trees ---- */

static struct operator camel;

static int make_camel(void **state)
{
	(void)state;
	camel.profile = profile_smooth();
	return opening_named("camel", &camel.opening) ? 0 : -1;
}

/* A ball that ends at 1 from (x, 0, 0). */
static struct node ball(double x)
{
	return (struct node){.type = NODE_PRIMITIVE, .primitive = {
	    .type = PRIMITIVE_SPHERE, .a = {x, 0.0, 0.0}, .radius = {0.5},
	    .falloff = 0.5}};
}

static struct node composition(enum node_type type, struct node **children,
    size_t count)
{
	return (struct node){.type = type, .children = children,
	    .child_count = count, .n = 2.0, .op = &camel};
}

/* About (x, 0, 0). */
static struct tape_box box_at(float x)
{
	return (struct tape_box){{x - 0.1f, -0.1f, -0.1f},
	    {x + 0.1f, 0.1f, 0.1f}};
}

/* Prunes root to a box about x, and compares opcodes, given up to OP_COUNT. */
static struct pruned prune_at(const struct node *root, float x,
    const unsigned *ops)
{
	struct pruned p = pruned_create(compile(root));
	struct tape_box box = box_at(x);
	size_t i;

	prune_to(&p, &box);
	for (i = 0; ops[i] != OP_COUNT; i++) {
		assert_true(i < p.list.count);
		assert_int_equal(p.list.insns[i].op, ops[i]);
	}
	assert_int_equal(p.list.count, i);
	assert_sound(&p);
	assert_same(&p, vec3(x, 0.05, 0.0), 0);
	return p;
}

static void check_at(const struct node *root, float x, const unsigned *ops)
{
	struct pruned p = prune_at(root, x, ops);

	pruned_free(&p);
}

static void test_prune_of_a_dead_tape_leaves_zero(void **state)
{
	struct node a = ball(0.0), b = ball(3.0), *children[] = {&a, &b};
	struct node sum = composition(NODE_SUM, children, 2);
	struct node meet = composition(NODE_INTERSECTION, children, 2);

	(void)state;
	check_at(&sum, 9.0f, (unsigned[]){OP_ZERO, OP_COUNT});
	check_at(&meet, 0.0f, (unsigned[]){OP_ZERO, OP_COUNT});
}

static void test_prune_asks_no_derivatives_for_what_is_gone(void **state)
{
	struct node a = ball(0.0), b = ball(1.0), c = ball(9.0);
	struct node *children[] = {&a, &b, &c};
	struct node join = composition(NODE_UNION, children, 3);
	struct pruned p;

	(void)state;
	p = prune_at(&join, 0.5f, (unsigned[]){OP_SPHERE, OP_SPHERE, OP_UNION,
	    OP_COUNT});
	assert_int_equal(p.tape->insns[0].extra, 2);
	assert_int_equal(p.list.insns[0].extra, 1);
	assert_int_equal(p.list.insns[2].extra, 0);
	pruned_free(&p);
	p = prune_at(&join, 9.0f, (unsigned[]){OP_SPHERE, OP_COUNT});
	assert_int_equal(p.list.insns[0].extra, 0);
	pruned_free(&p);
}

static void test_prune_keeps_a_difference_from_nothing(void **state)
{
	struct node a = ball(0.0), b = ball(3.0), *children[] = {&a, &b};
	struct node minus = composition(NODE_DIFFERENCE, children, 2);

	(void)state;
	check_at(&minus, 0.0f, (unsigned[]){OP_SPHERE, OP_ZERO, OP_DIFFERENCE,
	    OP_COUNT});
	check_at(&minus, 3.0f, (unsigned[]){OP_ZERO, OP_COUNT});
	minus.sharp = true;
	check_at(&minus, 0.0f, (unsigned[]){OP_SPHERE, OP_ZERO, OP_MINUS,
	    OP_COUNT});
}

/* The deeper second operand is on the tape first, and 0 stays in its place. */
static void test_prune_puts_zero_before_a_swapped_operand(void **state)
{
	struct node a = ball(0.0), b = ball(3.0), c = ball(3.5);
	struct node *pair[] = {&b, &c};
	struct node join = composition(NODE_SUM, pair, 2);
	struct node *children[] = {&a, &join};
	struct node minus = composition(NODE_DIFFERENCE, children, 2);

	(void)state;
	check_at(&minus, 0.0f, (unsigned[]){OP_ZERO, OP_SPHERE,
	    OP_DIFFERENCE_SWAPPED, OP_COUNT});
}

static void test_prune_gives_what_is_left_its_frame_and_color(void **state)
{
	struct node n[3], *children[] = {n, n + 1, n + 2};
	struct node sum = composition(NODE_SUM, children, 3);

	(void)state;
	for (int i = 0; i < 3; i++) {
		n[i] = ball(0.0);
		n[i].has_transform = true;
		n[i].transform = affine_identity();
		n[i].transform.t[0] = 0.25 + 3.0 * (i / 2);
		n[i].has_color = true;
		n[i].color = vec3(0.5 * i, 0.0, 1.0);
	}
	check_at(&sum, 3.0f, (unsigned[]){OP_FRAME, OP_COLOR, OP_SPHERE,
	    OP_COUNT});
	/* the second has the first one's frame */
	check_at(&sum, 0.0f, (unsigned[]){OP_FRAME, OP_COLOR, OP_SPHERE,
	    OP_COLOR, OP_SPHERE, OP_SUM, OP_COUNT});
}

/* An intersection that comes to nothing takes its frames with it. */
static void test_prune_restores_the_frame_before_what_it_cuts(void **state)
{
	struct node a = ball(0.0), b = ball(0.0), c = ball(0.0), d = ball(0.0);
	struct node *pair[] = {&b, &c}, *children[] = {&a, &d};
	struct node meet = composition(NODE_INTERSECTION, pair, 2);
	struct node first = composition(NODE_SUM, children, 2);
	struct node *all[] = {&first, &meet, &d};
	struct node sum = composition(NODE_SUM, all, 3);

	(void)state;
	a.has_transform = b.has_transform = c.has_transform = true;
	a.transform = b.transform = c.transform = affine_identity();
	a.transform.t[0] = 0.25;
	b.transform.t[0] = 0.5;
	c.transform.t[0] = 5.0;
	check_at(&sum, 0.0f, (unsigned[]){OP_FRAME, OP_SPHERE, OP_FRAME,
	    OP_SPHERE, OP_SUM, OP_FRAME, OP_SPHERE, OP_SUM, OP_COUNT});
}

static void test_prune_drops_a_warp_with_its_child(void **state)
{
	struct node a = ball(0.0), b = ball(5.0), *below[] = {&b};
	struct node warp = {.type = NODE_WARP, .children = below,
	    .child_count = 1, .warp = {.type = WARP_TWIST,
	    .axis = {1.0, 0.0, 0.0}, .rate = 1.0}};
	struct node *children[] = {&a, &warp};
	struct node sum = composition(NODE_SUM, children, 2);

	(void)state;
	check_at(&sum, 0.0f, (unsigned[]){OP_SPHERE, OP_COUNT});
	check_at(&sum, 5.0f, (unsigned[]){OP_ENTER, OP_FRAME, OP_SPHERE,
	    OP_LEAVE, OP_COUNT});
}

/* To a box, and what is left to a box in it: as to the second at once. */
static void test_prune_of_what_is_left_is_pruning_at_once(void **state)
{
	struct random_stream r = {3};

	(void)state;
	for (uint64_t seed = 1; seed <= TIMES(100); seed++) {
		struct random_tree *t = random_tree_create(
		    &(struct random_tree_options){.seed = seed,
		    .whole = true});
		struct pruned p = pruned_create(compile(
		    random_tree_get(t)->root));
		struct prune_list twice = list_create(p.tape->insn_count);
		struct tape_box outer = box_about(vec3(0.0, 0.0, 0.0), &r);
		struct tape_box inner = outer;

		for (int i = 0; i < 3; i++)
			inner.max[i] = 0.5f * (outer.min[i] + outer.max[i]);
		prune_to(&p, &outer);
		prune(&p.list, &inner, p.is_constant, &twice);
		prune_to(&p, &inner);
		assert_int_equal(twice.count, p.list.count);
		for (size_t i = 0; i < twice.count; i++) {
			assert_int_equal(twice.insns[i].op, p.list.insns[i].op);
			assert_int_equal(twice.insns[i].extra,
			    p.list.insns[i].extra);
			assert_int_equal(twice.insns[i].param,
			    p.list.insns[i].param);
		}
		list_free(&twice);
		pruned_free(&p);
		random_tree_free(t);
	}
}

/* Everywhere nothing is dropped. */
static void test_prune_to_all_of_space_leaves_the_tape(void **state)
{
	const struct tape_box all = {{-INFINITY, -INFINITY, -INFINITY},
	    {INFINITY, INFINITY, INFINITY}};

	(void)state;
	for (uint64_t seed = 1; seed <= TIMES(100); seed++) {
		struct random_tree *t = random_tree_create(
		    &(struct random_tree_options){.seed = seed,
		    .whole = true});
		struct pruned p = pruned_create(compile(
		    random_tree_get(t)->root));

		prune_to(&p, &all);
		assert_int_equal(p.list.count, p.tape->insn_count);
		for (size_t i = 0; i < p.list.count; i++)
			assert_memory_equal(p.list.insns + i,
			    p.tape->insns + i, sizeof(struct insn));
		pruned_free(&p);
		random_tree_free(t);
	}
}

/* ---- an index ---- */

#define CHILDREN 300

/* Of balls in frames and colours of their own, and in between smaller
 * compositions that make ends of chains. */
static void make_children(struct node *nodes, struct node **children,
    struct random_stream *r)
{
	for (int i = 0; i < CHILDREN; i++) {
		struct node *n = nodes + i;

		*n = ball(random_in(r, -20.0, 20.0));
		children[i] = n;
		if (random_below(r, 4) == 0) {
			n->has_transform = true;
			n->transform = affine_identity();
			n->transform.t[0] = random_below(r, 3);
		}
		if (random_below(r, 4) == 0) {
			n->has_color = true;
			n->color = vec3(0.25 * random_below(r, 4), 0.0, 1.0);
		}
		if (i >= 2 && random_below(r, 70) == 0)
			*n = composition(NODE_INTERSECTION, children + i - 2, 2);
	}
}

static void test_prune_with_an_index_leaves_the_same(void **state)
{
	static struct node nodes[CHILDREN];
	static struct node *children[CHILDREN];
	struct random_stream r = {6};

	(void)state;
	for (int times = 0; times < TIMES(400); times++) {
		struct node root = composition(times % 2 ? NODE_SUM :
		    NODE_UNION, children, CHILDREN);
		struct tape_box box = box_at((float)random_in(&r, -21.0, 21.0));
		struct prune_list whole, quick;
		struct prune_index *index;
		struct pruned p;

		make_children(nodes, children, &r);
		p = pruned_create(compile(&root));
		whole = whole_of(p.tape);
		quick = list_create(whole.count);
		assert_int_equal(prune_index_create(&whole, &index), ERR_OK);
		assert_true(prune_index_bytes(index) > 200 * sizeof(box));
		box.max[0] += (float)random_in(&r, 0.0, 8.0);
		prune_to(&p, &box);
		whole.index = index;
		prune(&whole, &box, p.is_constant, &quick);
		assert_int_equal(quick.count, p.list.count);
		assert_memory_equal(quick.insns, p.list.insns,
		    quick.count * sizeof(*quick.insns));
		assert_memory_equal(quick.boxes, p.list.boxes,
		    quick.count * sizeof(*quick.boxes));
		prune_index_free(index);
		list_free(&quick);
		pruned_free(&p);
	}
	prune_index_free(NULL);
}

/* ---- pairs of points and sums ---- */

static struct node point(double x)
{
	return (struct node){.type = NODE_PRIMITIVE, .primitive = {
	    .type = PRIMITIVE_POINT, .a = {x, 0.0, 0.0}, .radius = {0.5},
	    .exponent = 3.0, .weight = 1.0}};
}

#define SUM_LEAVES 24

/* Sums within sums, of points along the x axis. */
struct sums {
	struct node nodes[2 * SUM_LEAVES];
	struct node *children[2 * SUM_LEAVES];
	size_t node_count, child_count;
};

/* Of so many points. */
static struct node *grow_sums(struct sums *s, size_t leaves,
    struct random_stream *r)
{
	struct node *node = s->nodes + s->node_count++, *parts[3];
	size_t count = leaves < 3 ? leaves : 3, left = leaves;

	if (leaves == 1) {
		*node = point(random_in(r, -2.0, 2.0));
		return node;
	}
	for (size_t k = 0; k < count; k++) {
		size_t most = left - (count - 1 - k);
		size_t n = k + 1 == count ? left :
		    1 + (size_t)random_below(r, (int)most);

		parts[k] = grow_sums(s, n, r);
		left -= n;
	}
	*node = composition(NODE_SUM, s->children + s->child_count, count);
	memcpy(s->children + s->child_count, parts, count * sizeof(*parts));
	s->child_count += count;
	return node;
}

/* The field at (x, 0, 0) as an interpreter has it that rounds a pair once: of
 * made-up points, 0 where theirs are. */
static float fused_sum(const struct prune_list *list, const double *params,
    double x)
{
	float stack[TAPE_STACK_MAX];
	size_t top = 0;

	for (size_t i = 0; i < list->count; i++) {
		const struct insn *insn = list->insns + i;
		const double *p = params + insn->param;
		bool alive = insn->op == OP_POINT &&
		    fabs(p[0] - x) * sqrt(p[3]) < 1.0;
		float a = alive ? 1.0f + (float)fabs(p[0]) : 0.0f;
		const float b = 0.7f;

		if (insn->op == OP_SUM) {
			top--;
			stack[top - 1] += stack[top];
		} else if (insn->index > 0) {
			assert_int_equal(list->insns[i + 1].op, OP_SUM);
			stack[top - 1] = fmaf(a, b, stack[top - 1]);
			i++;
		} else {
			stack[top++] = a * b;
		}
	}
	assert_int_equal(top, 1);
	return stack[0];
}

static void test_prune_parts_no_pair_and_makes_none(void **state)
{
	struct random_stream r = {5};

	(void)state;
	for (int times = 0; times < TIMES(4000); times++) {
		struct sums s = {.node_count = 0};
		struct node *root = grow_sums(&s, SUM_LEAVES, &r);
		struct pruned p = pruned_create(compile(root));
		const struct prune_list whole = whole_of(p.tape);
		struct prune_list twice = list_create(p.tape->insn_count);
		struct tape_box box = box_at((float)random_in(&r, -2.0,
		    2.0)), wide = box;
		double x = (double)(0.5f * (box.min[0] + box.max[0]));
		float value = fused_sum(&whole, p.tape->params, x);

		wide.max[0] += 0.5f;
		prune_operands(&whole, &wide, &p.list);
		prune_operands(&p.list, &box, &twice);
		tape_count_runs(p.list.insns, p.list.count);
		tape_count_runs(twice.insns, twice.count);
		assert_true(fused_sum(&p.list, p.tape->params, x) == value);
		assert_true(fused_sum(&twice, p.tape->params, x) == value);
		list_free(&twice);
		pruned_free(&p);
	}
}

int main(void)
{
	const struct CMUnitTest tests[] = {
		cmocka_unit_test(test_prune_of_random_trees_changes_no_number),
		cmocka_unit_test(
		    test_prune_of_the_whole_language_changes_no_number),
		cmocka_unit_test(test_prune_of_a_dead_tape_leaves_zero),
		cmocka_unit_test(
		    test_prune_asks_no_derivatives_for_what_is_gone),
		cmocka_unit_test(test_prune_keeps_a_difference_from_nothing),
		cmocka_unit_test(
		    test_prune_puts_zero_before_a_swapped_operand),
		cmocka_unit_test(
		    test_prune_gives_what_is_left_its_frame_and_color),
		cmocka_unit_test(
		    test_prune_restores_the_frame_before_what_it_cuts),
		cmocka_unit_test(test_prune_drops_a_warp_with_its_child),
		cmocka_unit_test(
		    test_prune_of_what_is_left_is_pruning_at_once),
		cmocka_unit_test(test_prune_to_all_of_space_leaves_the_tape),
		cmocka_unit_test(test_prune_with_an_index_leaves_the_same),
		cmocka_unit_test(test_prune_parts_no_pair_and_makes_none),
	};

	return cmocka_run_group_tests(tests, make_camel, NULL);
}
