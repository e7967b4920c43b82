#include <stdarg.h>
#include <stddef.h>
#include <setjmp.h>
#include <stdint.h>
#include <cmocka.h>

#include <math.h>
#include <stdbool.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "core/classic.h"
#include "core/evaluate.h"
#include "core/tape.h"
#include "core/tree.h"
#include "core/volume.h"
#include "tests/support/fail_alloc.h"
#include "tests/support/near.h"
#include "tests/support/random_tree.h"

#define MAX_NODES 4096
#define PI 3.14159265358979323846

/* A soft point of support radius 1, for (1 - d^2)^3. */
static struct node point(double x)
{
	return (struct node){.type = NODE_PRIMITIVE, .primitive = {
	    .type = PRIMITIVE_POINT, .a = {x, 0.0, 0.0},
	    .radius = {sqrt(1.0 - cbrt(0.5)), 0.0}, .exponent = 3.0,
	    .weight = 1.0}};
}

/* The camel operator of every composition that is given no other. */
static struct operator camel;

static int make_camel(void **state)
{
	(void)state;
	camel.profile = profile_smooth();
	return opening_named("camel", &camel.opening) ? 0 : -1;
}

static struct operator with_opening(struct opening opening)
{
	struct operator op = camel;

	op.opening = opening;
	return op;
}

static struct node composition(enum node_type type, struct node **children,
    size_t count)
{
	return (struct node){.type = type, .children = children,
	    .child_count = count, .n = 2.0, .op = &camel};
}

static struct node reference(const struct node *target)
{
	return (struct node){.type = NODE_REF, .target = target};
}

static void move(struct node *node, double x)
{
	node->has_transform = true;
	node->transform = affine_identity();
	node->transform.t[0] = x;
}

/* A quarter turn about z and a scale. */
static void turn(struct node *node, double scale)
{
	const double t[3] = {0.0, 0.0, 0.0}, s[3] = {scale, scale, scale};
	const double q[4] = {0.0, 0.0, sqrt(0.5), sqrt(0.5)};

	node->has_transform = true;
	node->transform = affine_from_trs(t, q, s);
}

static struct tape *compile(const struct node *root)
{
	struct tree tree = {root, TREE_NULL_GRADIENT};
	struct tape *tape;
	struct tape_error error;

	assert_int_equal(tape_compile(&tree, MAX_NODES, &tape, &error), ERR_OK);
	return tape;
}

/* Asserts opcodes, given up to OP_COUNT. */
static void assert_ops(const struct tape *tape, const unsigned *ops)
{
	size_t i;

	for (i = 0; ops[i] != OP_COUNT; i++) {
		assert_true(i < tape->insn_count);
		assert_int_equal(tape->insns[i].op, ops[i]);
	}
	assert_int_equal(tape->insn_count, i);
}

static void assert_extras(const struct tape *tape, const unsigned *extras)
{
	for (size_t i = 0; i < tape->insn_count; i++)
		assert_int_equal(tape->insns[i].extra, extras[i]);
}

static void test_tape_primitive_is_one_instruction(void **state)
{
	struct node p = point(0.25);
	struct tape *t = compile(&p);

	(void)state;
	assert_ops(t, (unsigned[]){OP_POINT, OP_COUNT});
	assert_int_equal(t->stack_depth, 1);
	assert_int_equal(t->node_count, 1);
	assert_int_equal(t->primitive_count, 1);
	assert_int_equal(t->operator_count, 0);
	assert_int_equal(t->param_count, 6);
	assert_true(t->params[0] == 0.25);
	tape_free(t);
}

static void test_tape_free_of_null_does_nothing(void **state)
{
	(void)state;
	tape_free(NULL);
}

static void test_tape_folds_left_to_right(void **state)
{
	struct node a = point(1), b = point(2), c = point(3);
	struct node root = composition(NODE_UNION,
	    (struct node *[]){&a, &b, &c}, 3);
	struct tape *t = compile(&root);

	(void)state;
	assert_ops(t, (unsigned[]){OP_POINT, OP_POINT, OP_UNION, OP_POINT,
	    OP_UNION, OP_COUNT});
	assert_extras(t, (unsigned[]){2, 2, 1, 1, 0});
	assert_true(t->params[t->insns[0].param] == 1.0);
	assert_true(t->params[t->insns[1].param] == 2.0);
	assert_true(t->params[t->insns[3].param] == 3.0);
	assert_int_equal(t->stack_depth, 2);
	tape_free(t);
}

static void test_tape_orders_are_what_the_root_asks_and_extra(void **state)
{
	struct insn insn = {.extra = 1};

	(void)state;
	assert_int_equal(tape_order(&insn, 0), 1);
	assert_int_equal(tape_order(&insn, 1), 2);
	assert_int_equal(tape_order(&insn, 2), 2);
}

static void test_tape_extra_stops_at_two(void **state)
{
	struct node a = point(1);
	struct node root = composition(NODE_UNION,
	    (struct node *[]){&a, &a, &a, &a}, 4);
	struct tape *t = compile(&root);

	(void)state;
	assert_extras(t, (unsigned[]){2, 2, 2, 2, 1, 1, 0});
	tape_free(t);
}

static void test_tape_constant_opening_asks_no_more(void **state)
{
	struct node a = point(1);
	struct node inner = composition(NODE_UNION,
	    (struct node *[]){&a, &a, &a}, 3);
	struct node root = composition(NODE_UNION,
	    (struct node *[]){&inner, &a}, 2);
	struct operator clean = with_opening(opening_constant(PI / 4));
	struct tape *t;

	(void)state;
	inner.op = &clean;
	t = compile(&root);
	assert_extras(t, (unsigned[]){1, 1, 1, 1, 1, 1, 0});
	tape_free(t);
}

static void test_tape_sharp_sum_and_ricci_ask_no_more(void **state)
{
	struct node a = point(1);
	struct node sum = composition(NODE_SUM, (struct node *[]){&a, &a}, 2);
	struct node ricci = composition(NODE_RICCI,
	    (struct node *[]){&sum, &a}, 2);
	struct node min = composition(NODE_INTERSECTION,
	    (struct node *[]){&ricci, &a}, 2);
	struct node max = composition(NODE_UNION,
	    (struct node *[]){&min, &a}, 2);
	struct tape *t;

	(void)state;
	min.sharp = max.sharp = true;
	t = compile(&max);
	assert_ops(t, (unsigned[]){OP_POINT, OP_POINT, OP_SUM, OP_POINT, OP_RICCI,
	    OP_POINT, OP_MIN, OP_POINT, OP_MAX, OP_COUNT});
	assert_extras(t, (unsigned[]){0, 0, 0, 0, 0, 0, 0, 0, 0});
	assert_true(t->params[t->insns[4].param] == 2.0);
	assert_int_equal(t->operator_count, 0);
	tape_free(t);
}

static void test_tape_single_child_is_the_composition(void **state)
{
	struct node a = point(1);
	struct node inner = composition(NODE_DIFFERENCE,
	    (struct node *[]){&a}, 1);
	struct node root = composition(NODE_UNION, (struct node *[]){&inner}, 1);
	struct tape *t = compile(&root);

	(void)state;
	assert_ops(t, (unsigned[]){OP_POINT, OP_COUNT});
	assert_extras(t, (unsigned[]){0});
	assert_int_equal(t->operator_count, 0);
	assert_int_equal(t->node_count, 3);
	tape_free(t);
}

static void test_tape_deeper_operand_goes_first(void **state)
{
	struct node a = point(1), b = point(2);
	struct node pair = composition(NODE_SUM, (struct node *[]){&b, &b}, 2);
	struct node blend = composition(NODE_DIFFERENCE,
	    (struct node *[]){&a, &pair}, 2);
	struct node sharp = composition(NODE_DIFFERENCE,
	    (struct node *[]){&a, &blend}, 2);
	struct tape *t;

	(void)state;
	sharp.sharp = true;
	t = compile(&sharp);
	assert_ops(t, (unsigned[]){OP_POINT, OP_POINT, OP_SUM, OP_POINT,
	    OP_DIFFERENCE_SWAPPED, OP_POINT, OP_MINUS_SWAPPED, OP_COUNT});
	assert_extras(t, (unsigned[]){1, 1, 1, 1, 0, 0, 0});
	assert_int_equal(t->stack_depth, 2);
	tape_free(t);
}

/* ((a - b) - (c + c)) - d: only the middle child is due early. */
static void test_tape_deeper_child_goes_before_its_siblings_fold(void **state)
{
	struct node a = point(1), b = point(2), c = point(3), d = point(4);
	struct node pair = composition(NODE_SUM, (struct node *[]){&c, &c}, 2);
	struct node deep = composition(NODE_SUM,
	    (struct node *[]){&pair, &pair}, 2);
	struct node root = composition(NODE_DIFFERENCE,
	    (struct node *[]){&a, &b, &deep, &d}, 4);
	struct operator blend = with_opening(opening_constant(0.0));
	struct tape *t;

	(void)state;
	root.op = &blend;
	t = compile(&root);
	assert_ops(t, (unsigned[]){OP_POINT, OP_POINT, OP_SUM, OP_POINT, OP_POINT,
	    OP_SUM, OP_SUM, OP_POINT, OP_POINT, OP_DIFFERENCE,
	    OP_DIFFERENCE_SWAPPED, OP_POINT, OP_DIFFERENCE, OP_COUNT});
	assert_true(t->params[t->insns[7].param] == 1.0);
	assert_true(t->params[t->insns[8].param] == 2.0);
	assert_int_equal(t->stack_depth, 3);
	tape_free(t);
}

#define LEAVES 1000

struct forest {
	struct node leaf;
	struct node nodes[LEAVES];
	struct node *children[LEAVES][2];
};

static struct forest *plant(void)
{
	struct forest *f = calloc(1, sizeof(*f));

	assert_non_null(f);
	f->leaf = point(0.0);
	for (size_t i = 0; i < LEAVES; i++)
		f->nodes[i] = composition(NODE_SUM, f->children[i], 2);
	return f;
}

static void test_tape_chains_need_two_jets_on_either_side(void **state)
{
	struct forest *f = plant();

	(void)state;
	for (size_t side = 0; side < 2; side++) {
		struct tape *t;

		for (size_t i = 0; i < 200; i++) {
			f->children[i][side] = i < 199 ? f->nodes + i + 1
			    : &f->leaf;
			f->children[i][1 - side] = &f->leaf;
		}
		t = compile(f->nodes);
		assert_int_equal(t->primitive_count, 201);
		assert_int_equal(t->stack_depth, 2);
		tape_free(t);
	}
	free(f);
}

static void test_tape_balanced_thousand_leaves_need_log_jets(void **state)
{
	struct forest *f = plant();
	struct tape *t;

	(void)state;
	/* A heap of 999 pairs: 1000 leaves. */
	for (size_t i = 0; i < LEAVES - 1; i++)
		for (size_t j = 0; j < 2; j++) {
			size_t child = 2 * i + 1 + j;

			f->children[i][j] = child < LEAVES - 1
			    ? f->nodes + child : &f->leaf;
		}
	t = compile(f->nodes);
	assert_int_equal(t->primitive_count, LEAVES);
	/* 1 + floor(log2(1000)) */
	assert_int_equal(t->stack_depth, 10);
	tape_free(t);
	free(f);
}

static void test_tape_translation_has_frame_and_no_carry(void **state)
{
	struct node a = point(0), b = point(0);
	struct node root = composition(NODE_SUM,
	    (struct node *[]){&a, &b, &a}, 3);
	struct tape *t;

	(void)state;
	move(&a, 3.0);
	t = compile(&root);
	/* back to the world for b, then there again */
	assert_ops(t, (unsigned[]){OP_FRAME, OP_POINT, OP_FRAME, OP_POINT, OP_SUM,
	    OP_FRAME, OP_POINT, OP_SUM, OP_COUNT});
	assert_true(t->params[t->insns[0].param + 9] == -3.0);
	assert_true(t->params[t->insns[2].param + 9] == 0.0);
	assert_true(t->params[t->insns[2].param + 4] == 1.0);
	tape_free(t);
}

static void test_tape_siblings_share_a_frame(void **state)
{
	struct node a = point(0), b = point(1);
	struct node root = composition(NODE_UNION, (struct node *[]){&a, &b}, 2);
	struct tape *t;

	(void)state;
	turn(&root, 2.0);
	t = compile(&root);
	assert_ops(t, (unsigned[]){OP_FRAME, OP_POINT, OP_POINT, OP_UNION,
	    OP_CARRY, OP_COUNT});
	assert_extras(t, (unsigned[]){1, 1, 1, 0, 0});
	tape_free(t);
}

static void test_tape_frames_compose_and_carries_do_not(void **state)
{
	/* inverse of a quarter turn about z and a scale by 2 */
	const double half_back[9] = {0, 0.5, 0, -0.5, 0, 0, 0, 0, 0.5};
	struct node a = point(0);
	struct node mid = composition(NODE_SUM, (struct node *[]){&a}, 1);
	struct node root = composition(NODE_SUM, (struct node *[]){&mid}, 1);
	struct tape *t;
	const double *frame;

	(void)state;
	turn(&a, 2.0);
	move(&mid, 1.0);
	turn(&root, 2.0);
	t = compile(&root);
	assert_ops(t, (unsigned[]){OP_FRAME, OP_POINT, OP_CARRY, OP_CARRY,
	    OP_COUNT});
	frame = t->params + t->insns[0].param;
	/* two quarter turns: x -> -x/4; the move lies between them */
	assert_near(frame[0], -0.25, 1e-15);
	assert_near(frame[4], -0.25, 1e-15);
	assert_near(frame[8], 0.25, 1e-15);
	assert_near(frame[10], 0.5, 1e-15);
	for (int c = 2; c <= 3; c++)
		for (int i = 0; i < 9; i++)
			assert_near(t->params[t->insns[c].param + i],
			    half_back[i], 1e-15);
	tape_free(t);
}

static void test_tape_ref_instances_target_with_both_transforms(void **state)
{
	struct node a = point(0), ref = reference(&a);
	struct node root = composition(NODE_SUM, (struct node *[]){&a, &ref}, 2);
	struct tape *t;

	(void)state;
	move(&a, 1.0);
	turn(&ref, 2.0);
	t = compile(&root);
	assert_ops(t, (unsigned[]){OP_FRAME, OP_POINT, OP_FRAME, OP_POINT,
	    OP_CARRY, OP_SUM, OP_COUNT});
	/* p -> turned back, halved, then moved by -1 */
	assert_near(t->params[t->insns[2].param + 1], 0.5, 1e-15);
	assert_near(t->params[t->insns[2].param + 9], -1.0, 1e-15);
	assert_int_equal(t->node_count, 4);
	assert_int_equal(t->primitive_count, 2);
	tape_free(t);
}

static void test_tape_operators_are_shared(void **state)
{
	struct node a = point(0), n[5], *pair[2] = {&a, &a};
	struct operator equal = camel, other = camel;
	struct node root;
	struct tape *t;

	(void)state;
	for (int i = 0; i < 5; i++)
		n[i] = composition(i == 1 ? NODE_INTERSECTION : i == 2
		    ? NODE_DIFFERENCE : NODE_UNION, pair, 2);
	equal.opening.theta[1] = -0.0; /* equal to 0 */
	n[3].op = &equal;
	other.opening.theta[1] = 0.1;
	n[4].op = &other;
	root = composition(NODE_UNION, (struct node *[]){n, n + 1, n + 2,
	    n + 3, n + 4}, 5);
	t = compile(&root);
	/* camel union, camel intersection, and the changed one */
	assert_int_equal(t->operator_count, 3);
	for (size_t i = 0; i < t->insn_count; i++) {
		const struct insn *insn = t->insns + i;
		enum operator_family family = insn->op == OP_UNION
		    ? FAMILY_UNION : FAMILY_INTERSECTION;

		if (insn->op >= OP_UNION)
			assert_int_equal(t->operators[insn->index].family,
			    family);
	}
	tape_free(t);
}

/* More of them than the compiler has room for at first, each met twice. */
static void test_tape_many_operators_keep_their_indices(void **state)
{
	enum { COUNT = 100 };
	static struct operator ops[COUNT];
	struct node a = point(0), n[2 * COUNT], *pair[2] = {&a, &a};
	struct node *children[2 * COUNT], root;
	struct tape *t;
	size_t seen = 0;

	(void)state;
	for (int i = 0; i < 2 * COUNT; i++) {
		ops[i % COUNT] = with_opening(opening_constant(i % COUNT / 200.0));
		n[i] = composition(NODE_UNION, pair, 2);
		n[i].op = ops + i % COUNT;
		children[i] = n + i;
	}
	root = composition(NODE_SUM, children, 2 * COUNT);
	t = compile(&root);
	assert_int_equal(t->operator_count, COUNT);
	for (size_t i = 0; i < t->insn_count; i++) {
		if (t->insns[i].op != OP_UNION)
			continue;
		assert_true(t->operators[t->insns[i].index].opening.theta[0] ==
		    (double)(seen++ % COUNT) / 200.0);
	}
	assert_int_equal(seen, 2 * COUNT);
	tape_free(t);
}

static void test_tape_table_layouts_are_different_operators(void **state)
{
	struct node a = point(0);
	struct node inner = composition(NODE_UNION,
	    (struct node *[]){&a, &a}, 2);
	struct node root = composition(NODE_UNION,
	    (struct node *[]){&inner, &a}, 2);
	struct operator uniform = camel;
	struct tape *t;

	(void)state;
	uniform.layout = LAYOUT_UNIFORM;
	inner.op = &uniform;
	t = compile(&root);
	assert_int_equal(t->operator_count, 2);
	tape_free(t);
}

/* null_gradient over the longest fall-off, in the composition's own frame. */
static void test_tape_null_gradient_scales_with_the_fields(void **state)
{
	struct node a = point(0), b = point(0);
	struct node root = composition(NODE_UNION, (struct node *[]){&a, &b}, 2);
	struct tape *t;

	(void)state;
	turn(&b, 4.0);
	turn(&root, 100.0); /* outside its frame */
	t = compile(&root);
	assert_int_equal(t->insns[t->insn_count - 2].op, OP_UNION);
	assert_near(t->params[t->insns[t->insn_count - 2].param],
	    TREE_NULL_GRADIENT / 4.0, 1e-15);
	tape_free(t);
}

static void test_tape_nested_turns_do_not_stretch(void **state)
{
	enum { DEPTH = 60 };
	struct node a = point(0), n[DEPTH];
	struct node *children[DEPTH][1], *pair[2] = {n, &a};
	struct node root = composition(NODE_UNION, pair, 2);
	struct tape *t;

	(void)state;
	for (int i = 0; i < DEPTH; i++) {
		children[i][0] = i + 1 < DEPTH ? n + i + 1 : &a;
		n[i] = composition(NODE_SUM, children[i], 1);
		turn(n + i, 1.0);
	}
	t = compile(&root);
	assert_near(t->params[t->insns[t->insn_count - 1].param],
	    TREE_NULL_GRADIENT, 1e-12);
	tape_free(t);
}

/* Compiling root must fail so, naming node, leaving the result alone. */
static void assert_refused(const struct node *root, size_t max_nodes,
    enum err expected, const struct node *node, const char *word)
{
	struct tree tree = {root, TREE_NULL_GRADIENT};
	struct tape *tape = (struct tape *)&tree;
	struct tape_error error = {NULL, ""};

	assert_int_equal(tape_compile(&tree, max_nodes, &tape, &error), expected);
	assert_ptr_equal(tape, &tree);
	assert_ptr_equal(error.node, node);
	if (!strstr(error.detail, word))
		fail_msg("\"%s\" lacks \"%s\"", error.detail, word);
}

static void test_tape_refuses_a_ref_to_its_ancestor(void **state)
{
	struct node a = point(0), ref, root;

	(void)state;
	root = composition(NODE_UNION, (struct node *[]){&a, &ref}, 2);
	root.id = "body";
	ref = reference(&root);
	assert_refused(&root, MAX_NODES, ERR_INVALID, &ref,
	    "refers to itself through \"body\"");
}

static void test_tape_refuses_a_ref_to_itself(void **state)
{
	struct node a = point(0), ref, root;

	(void)state;
	ref = reference(&ref);
	ref.id = "me";
	root = composition(NODE_UNION, (struct node *[]){&a, &ref}, 2);
	assert_refused(&root, MAX_NODES, ERR_INVALID, &ref, "\"me\"");
}

static void test_tape_refuses_refs_that_meet(void **state)
{
	struct node left, right, to_left, to_right, root;

	(void)state;
	to_left = reference(&left);
	to_right = reference(&right);
	left = composition(NODE_SUM, (struct node *[]){&to_right}, 1);
	right = composition(NODE_SUM, (struct node *[]){&to_left}, 1);
	left.id = "left";
	right.id = "right";
	root = composition(NODE_SUM, (struct node *[]){&left, &right}, 2);
	assert_refused(&root, MAX_NODES, ERR_INVALID, &to_left, "\"left\"");
}

static void test_tape_node_limit_counts_expanded_nodes(void **state)
{
	struct node a = point(0), ref = reference(&a), root;
	struct tree tree = {&root, TREE_NULL_GRADIENT};
	struct tape_error error;
	struct tape *t;

	(void)state;
	root = composition(NODE_SUM, (struct node *[]){&a, &ref}, 2);
	assert_refused(&root, 3, ERR_LIMIT, &a, "3 nodes");
	assert_int_equal(tape_compile(&tree, 4, &t, &error), ERR_OK);
	tape_free(t);
}

/* 10 sums of 10 refs each to the one before: 10^10 leaves. Ends at once. */
static void test_tape_billion_laughs_fail_fast(void **state)
{
	struct node a = point(0), sums[10], refs[10][10], root;
	struct node *children[10][10], *all[10];
	struct tree tree = {&root, TREE_NULL_GRADIENT};
	struct tape_error error;
	struct tape *t;

	(void)state;
	for (int i = 0; i < 10; i++) {
		for (int j = 0; j < 10; j++) {
			refs[i][j] = i ? reference(sums + i - 1) : a;
			children[i][j] = refs[i] + j;
		}
		sums[i] = composition(NODE_SUM, children[i], 10);
		all[9 - i] = sums + i;
	}
	root = composition(NODE_SUM, all, 10);
	assert_int_equal(tape_compile(&tree, 100000, &t, &error), ERR_LIMIT);
}

static void test_tape_refuses_nesting_beyond_its_limit(void **state)
{
	enum { DEPTH = TAPE_NESTING_MAX };
	struct node a = point(0), n[DEPTH];
	struct node *children[DEPTH][1];
	struct tape *t;

	(void)state;
	for (int i = 0; i < DEPTH; i++) {
		children[i][0] = i + 1 < DEPTH ? n + i + 1 : &a;
		n[i] = composition(NODE_SUM, children[i], 1);
	}
	assert_refused(n, MAX_NODES, ERR_LIMIT, &a, "nested");
	t = compile(n + 1);
	assert_int_equal(t->node_count, DEPTH);
	tape_free(t);
}

static void test_tape_refuses_singular_transforms(void **state)
{
	struct node a = point(0), b = point(1);
	struct node root = composition(NODE_UNION, (struct node *[]){&a, &b}, 2);

	(void)state;
	move(&b, 0.0);
	b.transform.a[1][1] = 0.0;
	assert_refused(&root, MAX_NODES, ERR_INVALID, &b, "singular");
}

static void test_tape_refuses_lengths_out_of_range(void **state)
{
	struct node a = point(0), b = point(1);
	struct node mid = composition(NODE_UNION, (struct node *[]){&a, &b}, 2);
	struct node root = composition(NODE_UNION, (struct node *[]){&mid}, 1);

	(void)state;
	turn(&mid, 1e5);
	turn(&root, 1e5);
	assert_refused(&root, MAX_NODES, ERR_INVALID, &root, "parent's");
	turn(&mid, 1e-5);
	turn(&root, 1e-5);
	assert_refused(&root, MAX_NODES, ERR_INVALID, &root, "parent's");
	/* back in range by the time the world sees it */
	turn(&mid, 1e-10);
	turn(&root, 1e10);
	assert_refused(&root, MAX_NODES, ERR_INVALID, &mid, "parent's");
	/* one axis is enough */
	turn(&mid, 1.0);
	turn(&root, 1.0);
	root.transform.a[2][2] = 1e-10;
	assert_refused(&root, MAX_NODES, ERR_INVALID, &root, "parent's");
	root.transform.a[2][2] = 1e100;
	assert_refused(&root, MAX_NODES, ERR_INVALID, &root, "parent's");
	root.has_transform = false;
	a.primitive.radius[0] = 1e-10;
	assert_refused(&root, MAX_NODES, ERR_INVALID, &a, "own");
}

static void test_tape_accepts_lengths_at_the_limits(void **state)
{
	struct node a = point(0), b = point(1);
	struct node root = composition(NODE_UNION, (struct node *[]){&a, &b}, 2);

	(void)state;
	turn(&a, 0.999e9);
	turn(&b, 1.001e-9);
	tape_free(compile(&root));
}

/* How an instruction leaves the stack, the warps and the frame. */
struct progress {
	size_t stack, warps;
	bool framed;
};

static void step(const struct tape *t, const struct insn *insn,
    struct progress *s)
{
	assert_true(insn->op < OP_COUNT && insn->extra <= 2);
	assert_true(insn->param <= t->param_count);
	switch (insn->op) {
	case OP_FRAME:
		s->framed = true;
		return;
	case OP_CARRY:
		assert_true(s->stack >= 1);
		return;
	case OP_COLOR:
		return;
	case OP_ENTER:
		assert_true(s->warps++ < TAPE_WARPS_MAX);
		s->framed = false;
		return;
	case OP_LEAVE:
		assert_true(s->warps-- > 0 && s->stack >= 1);
		s->framed = false;
		return;
	case OP_VOLUME:
		assert_true(insn->index < t->volume_count);
		break;
	case OP_CLASSIC:
	case OP_CLASSIC_SWAPPED:
		assert_true(insn->index < CLASSIC_TYPE_COUNT);
		break;
	}
	if (insn->op >= OP_UNION)
		assert_true(insn->index < t->operator_count);
	if (insn->op >= OP_MAX) {
		assert_true(s->stack >= 2);
		s->stack--;
	} else {
		assert_true(s->framed);
		s->stack++;
	}
}

/* Every jet a tape pushes and pops, every index it holds in range, every warp
 * left, and no primitive at a point that a warp has left behind. */
static void assert_sound(const struct tape *t)
{
	struct progress s = {.framed = true};
	size_t most = 0, primitives = 0;

	for (size_t i = 0; i < t->insn_count; i++) {
		const struct insn *insn = t->insns + i;

		step(t, insn, &s);
		primitives += insn->op >= OP_PRIMITIVES && insn->op < OP_MAX;
		most = s.stack > most ? s.stack : most;
	}
	assert_int_equal(s.stack, 1);
	assert_int_equal(s.warps, 0);
	assert_int_equal(t->insns[t->insn_count - 1].extra, 0);
	assert_int_equal(most, t->stack_depth);
	assert_int_equal(primitives, t->primitive_count);
	assert_true(t->stack_depth <= 1 + log2((double)primitives));
}

static struct node warped(const struct warp *w, struct node **child)
{
	return (struct node){.type = NODE_WARP, .warp = *w, .children = child,
	    .child_count = 1};
}

static const struct warp quarter_twist = {.type = WARP_TWIST,
    .axis = {0.0, 0.0, 1.0}, .center = {5.0, 0.0, 0.0}, .rate = PI / 2};

static void test_tape_warp_encloses_its_child(void **state)
{
	struct node a = point(1), *child[1] = {&a};
	struct node w = warped(&quarter_twist, child);
	double params[WARP_PARAMS_MAX];
	struct tape *t = compile(&w);
	const double *enter = t->params + t->insns[0].param;
	const double *leave = t->params + t->insns[3].param;

	(void)state;
	assert_ops(t, (unsigned[]){OP_ENTER, OP_FRAME, OP_POINT, OP_LEAVE,
	    OP_COUNT});
	warp_prepare(&quarter_twist, params);
	for (int i = 0; i < 12; i++)
		assert_true(enter[i] == (i == 0 || i == 4 || i == 8));
	for (int i = 0; i < WARP_PARAMS_MAX; i++)
		assert_true(enter[12 + i] == params[i]);
	for (int i = 0; i < 12 + WARP_PARAMS_MAX; i++)
		assert_true(leave[i] == enter[i]);
	assert_int_equal(t->insns[0].index, WARP_TWIST);
	assert_int_equal(t->insns[3].index, WARP_TWIST);
	assert_int_equal(t->stack_depth, 1);
	assert_int_equal(t->node_count, 2);
	assert_sound(t);
	tape_free(t);
}

/* ENTER sees the warp's frame; frames below start anew; CARRY comes last. */
static void test_tape_warp_has_frames_of_its_own_base(void **state)
{
	struct node a = point(0), *child[1] = {&a};
	struct node w = warped(&quarter_twist, child);
	struct tape *t;

	(void)state;
	move(&a, 3.0);
	turn(&w, 2.0);
	t = compile(&w);
	assert_ops(t, (unsigned[]){OP_ENTER, OP_FRAME, OP_POINT, OP_LEAVE,
	    OP_CARRY, OP_COUNT});
	assert_near(t->params[t->insns[0].param + 1], 0.5, 1e-15);
	assert_near(t->params[t->insns[1].param], 1.0, 0.0);
	assert_near(t->params[t->insns[1].param + 9], -3.0, 0.0);
	tape_free(t);
}

/* The point is set anew on either side of a warp, once for siblings. */
static void test_tape_warps_siblings_get_their_frames(void **state)
{
	struct node a = point(0), b = point(1), *inner[2] = {&a, &b};
	struct node sum = composition(NODE_SUM, inner, 2), *child[1] = {&sum};
	struct node w = warped(&quarter_twist, child);
	struct node root = composition(NODE_SUM,
	    (struct node *[]){&a, &w, &b, &a}, 4);
	struct tape *t = compile(&root);

	(void)state;
	assert_ops(t, (unsigned[]){OP_ENTER, OP_FRAME, OP_POINT, OP_POINT,
	    OP_SUM, OP_LEAVE, OP_FRAME, OP_POINT, OP_SUM, OP_POINT, OP_SUM,
	    OP_POINT, OP_SUM, OP_COUNT});
	assert_sound(t);
	tape_free(t);
}

static void test_tape_warp_asks_what_its_parents_ask(void **state)
{
	struct node a = point(0), b = point(1), *child[1] = {&a};
	struct node w = warped(&quarter_twist, child);
	struct node root = composition(NODE_UNION, (struct node *[]){&w, &b}, 2);
	struct tape *t = compile(&root);

	(void)state;
	assert_ops(t, (unsigned[]){OP_ENTER, OP_FRAME, OP_POINT, OP_LEAVE,
	    OP_FRAME, OP_POINT, OP_UNION, OP_COUNT});
	assert_extras(t, (unsigned[]){1, 1, 1, 1, 1, 1, 0});
	tape_free(t);
}

static void test_tape_ref_instances_warps_and_is_one_below_them(void **state)
{
	struct node a = point(0), to_a = reference(&a), *child[1] = {&to_a};
	struct node w = warped(&quarter_twist, child), to_w = reference(&w);
	struct node root = composition(NODE_SUM,
	    (struct node *[]){&a, &w, &to_w}, 3);
	struct tape *t;

	(void)state;
	turn(&to_a, 2.0);
	t = compile(&root);
	assert_ops(t, (unsigned[]){OP_POINT,
	    OP_ENTER, OP_FRAME, OP_POINT, OP_CARRY, OP_LEAVE, OP_SUM,
	    OP_ENTER, OP_FRAME, OP_POINT, OP_CARRY, OP_LEAVE, OP_SUM,
	    OP_COUNT});
	assert_int_equal(t->node_count, 1 + 1 + 3 + 4);
	tape_free(t);
}

/* A taper to four times the width makes its child's fall-off four times
 * longer; to a quarter, only the least of them shorter. */
static void test_tape_taper_stretches_lengths(void **state)
{
	struct warp taper = {.type = WARP_TAPER, .axis = {1.0, 0.0, 0.0},
	    .has_range = true, .to = 1.0, .scale = 4.0};
	struct node a = point(0), *child[1] = {&a};
	struct node w = warped(&taper, child);
	struct node root = composition(NODE_UNION, (struct node *[]){&w, &w}, 2);
	struct tape *t = compile(&root);

	(void)state;
	assert_near(t->params[t->insns[t->insn_count - 1].param],
	    TREE_NULL_GRADIENT / 4.0, 1e-15);
	tape_free(t);
	w.warp.scale = 0.25;
	t = compile(&root);
	assert_near(t->params[t->insns[t->insn_count - 1].param],
	    TREE_NULL_GRADIENT, 1e-15);
	tape_free(t);
}

static void test_tape_convolution_sums_its_elements(void **state)
{
	struct node a = {.type = NODE_PRIMITIVE, .primitive = {
	    .type = PRIMITIVE_CAUCHY_POINT, .radius = {0.5, 0.0},
	    .weight = 1.0, .s = 2.0}}, b = a, c = a;
	struct node root;
	struct tape *t;

	(void)state;
	b.primitive.type = PRIMITIVE_CAUCHY_SEGMENT;
	b.primitive.b = vec3(1.0, 0.0, 0.0);
	c.primitive.type = PRIMITIVE_CAUCHY_TRIANGLE;
	c.primitive.b = vec3(1.0, 0.0, 0.0);
	c.primitive.c = vec3(0.0, 1.0, 0.0);
	root = composition(NODE_CONVOLUTION, (struct node *[]){&a, &b, &c}, 3);
	root.op = NULL;
	t = compile(&root);
	assert_ops(t, (unsigned[]){OP_CAUCHY_POINT, OP_CAUCHY_SEGMENT, OP_SUM,
	    OP_CAUCHY_TRIANGLE, OP_SUM, OP_COUNT});
	assert_extras(t, (unsigned[]){0, 0, 0, 0, 0});
	assert_int_equal(t->operator_count, 0);
	tape_free(t);
}

static struct node colored(struct node node, double red)
{
	node.has_color = true;
	node.color = vec3(red, 0.25, 0.0);
	return node;
}

/* Asserts the red of the tape's COLORs, given up to a negative one. */
static void assert_reds(const struct tape *t, const double *reds)
{
	size_t k = 0;

	for (size_t i = 0; i < t->insn_count; i++) {
		if (t->insns[i].op != OP_COLOR)
			continue;
		assert_true(t->params[t->insns[i].param] == reds[k]);
		k++;
	}
	assert_true(reds[k] < 0.0);
}

static void test_tape_color_is_inherited_and_set_once(void **state)
{
	struct node a = point(0), b = colored(point(1), 0.5), c = point(2);
	struct node mid = composition(NODE_SUM, (struct node *[]){&a, &c}, 2);
	struct node root = composition(NODE_SUM,
	    (struct node *[]){&mid, &a, &b, &a}, 4);
	struct tape *t = compile(&root);

	(void)state;
	assert_ops(t, (unsigned[]){OP_POINT, OP_POINT, OP_SUM, OP_POINT, OP_SUM,
	    OP_COLOR, OP_POINT, OP_SUM, OP_COLOR, OP_POINT, OP_SUM, OP_COUNT});
	assert_reds(t, (double[]){0.5, TREE_COLOR_DEFAULT, -1.0});
	tape_free(t);
	root = colored(root, 0.125);
	mid = colored(mid, 0.25);
	t = compile(&root);
	assert_reds(t, (double[]){0.25, 0.125, 0.5, 0.125, -1.0});
	tape_free(t);
}

/* An instance has the colour where it is, unless its target says. */
static void test_tape_color_of_refs(void **state)
{
	struct node a = point(0), b = colored(point(1), 0.5);
	struct node to_a = reference(&a), to_b = reference(&b);
	struct node inside, all[3], root;
	struct tape *t;

	(void)state;
	inside = colored(composition(NODE_SUM, (struct node *[]){&a}, 1), 0.75);
	all[0] = colored(to_a, 0.125);
	all[1] = colored(to_b, 0.125);
	all[2] = reference(&inside);
	root = composition(NODE_SUM,
	    (struct node *[]){all, all + 1, all + 2}, 3);
	t = compile(&root);
	assert_reds(t, (double[]){0.125, 0.5, 0.75, -1.0});
	tape_free(t);
	/* what is above a target's own place does not go with it */
	root = colored(composition(NODE_SUM, (struct node *[]){&inside, &to_a},
	    2), 0.0625);
	t = compile(&root);
	assert_reds(t, (double[]){0.75, 0.0625, -1.0});
	tape_free(t);
}

static void test_tape_classic_has_its_type_and_family(void **state)
{
	static const enum node_type nodes[] = {NODE_UNION, NODE_INTERSECTION,
	    NODE_DIFFERENCE};
	static const int families[] = {CLASSIC_UNION, CLASSIC_INTERSECTION,
	    CLASSIC_DIFFERENCE};
	struct classic ricci = {CLASSIC_RICCI, {2.5}};
	struct node a = point(0), b = point(1);
	struct node pair = composition(NODE_SUM, (struct node *[]){&b, &b}, 2);

	(void)state;
	for (int i = 0; i < 3; i++) {
		struct node root = composition(nodes[i],
		    (struct node *[]){&a, &pair, &b}, 3);
		double params[CLASSIC_PARAMS_MAX];
		struct tape *t;

		root.op = NULL;
		root.classic = &ricci;
		t = compile(&root);
		assert_ops(t, (unsigned[]){OP_POINT, OP_POINT, OP_SUM, OP_POINT,
		    OP_CLASSIC_SWAPPED, OP_POINT, OP_CLASSIC, OP_COUNT});
		assert_extras(t, (unsigned[]){0, 0, 0, 0, 0, 0, 0});
		classic_prepare(&ricci, families[i], params);
		for (size_t k = 4; k <= 6; k += 2) {
			assert_int_equal(t->insns[k].index, CLASSIC_RICCI);
			assert_memory_equal(t->params + t->insns[k].param,
			    params, sizeof(params));
		}
		assert_int_equal(t->operator_count, 0);
		tape_free(t);
	}
}

/* A volume of 4 samples an axis about the origin. */
static struct volume *volume(bool is_distance, float value)
{
	const size_t count[3] = {4, 4, 4};
	float samples[64];
	struct volume *v;

	for (int i = 0; i < 64; i++)
		samples[i] = value;
	assert_int_equal(volume_create(samples, count, vec3(-1.0, -1.0, -1.0),
	    vec3(1.0, 1.0, 1.0), is_distance, &v), ERR_OK);
	return v;
}

static struct node sampled(struct volume *v, double falloff)
{
	return (struct node){.type = NODE_PRIMITIVE, .primitive = {
	    .type = PRIMITIVE_VOLUME, .volume = v, .falloff = falloff}};
}

static void test_tape_volumes_are_shared_and_held(void **state)
{
	struct volume *one = volume(false, 0.5f), *other = volume(false, 0.5f);
	struct node a = sampled(one, 0.0), b = sampled(other, 0.0), c = a;
	struct node root = composition(NODE_SUM,
	    (struct node *[]){&a, &b, &c}, 3);
	struct tape *t = compile(&root);

	(void)state;
	assert_ops(t, (unsigned[]){OP_VOLUME, OP_VOLUME, OP_SUM, OP_VOLUME,
	    OP_SUM, OP_COUNT});
	assert_int_equal(t->volume_count, 2);
	assert_ptr_equal(t->volumes[t->insns[0].index], one);
	assert_ptr_equal(t->volumes[t->insns[1].index], other);
	assert_int_equal(t->insns[3].index, t->insns[0].index);
	assert_int_equal(atomic_load(&one->refs), 2);
	assert_int_equal(atomic_load(&other->refs), 2);
	volume_release(other); /* the tape's remains */
	assert_int_equal(atomic_load(&other->refs), 1);
	tape_free(t);
	assert_int_equal(atomic_load(&one->refs), 1);
	volume_release(one);
}

static void test_tape_draft_operators_are_different_operators(void **state)
{
	struct node a = point(0);
	struct node inner = composition(NODE_UNION,
	    (struct node *[]){&a, &a}, 2);
	struct node root = composition(NODE_UNION,
	    (struct node *[]){&inner, &a}, 2);
	struct operator draft = camel;
	struct tape *t;

	(void)state;
	draft.draft = true;
	inner.op = &draft;
	t = compile(&root);
	assert_int_equal(t->operator_count, 2);
	assert_true(t->operators[0].draft != t->operators[1].draft);
	tape_free(t);
}

static void test_tape_refuses_volumes_whose_falloff_does_not_fit(
    void **state)
{
	struct volume *field = volume(false, 0.5f), *near = volume(true, 0.25f);
	struct node a = sampled(field, 0.1);

	(void)state;
	assert_refused(&a, MAX_NODES, ERR_INVALID, &a, "no falloff");
	a = sampled(near, 0.0);
	assert_refused(&a, MAX_NODES, ERR_INVALID, &a, "need a falloff");
	a = sampled(near, 0.26);
	assert_refused(&a, MAX_NODES, ERR_INVALID, &a,
	    "within 0.25 of the surface");
	a = sampled(near, 0.24);
	tape_free(compile(&a));
	volume_release(field);
	volume_release(near);
}

/* Warps within each other, each through a ref. */
static void test_tape_refuses_too_many_warps(void **state)
{
	enum { DEPTH = TAPE_WARPS_MAX + 1 };
	struct node a = point(0), n[DEPTH], refs[DEPTH], *children[DEPTH][1];
	struct tape *t;

	(void)state;
	for (int i = 0; i < DEPTH; i++) {
		children[i][0] = i ? refs + i : &a;
		refs[i] = reference(i ? n + i - 1 : &a);
		n[i] = warped(&quarter_twist, children[i]);
	}
	assert_refused(n + DEPTH - 1, MAX_NODES, ERR_LIMIT, n, "8 warps");
	t = compile(n + DEPTH - 2);
	assert_sound(t);
	tape_free(t);
}

static void test_tape_refuses_a_warp_of_itself(void **state)
{
	struct node ref, *child[1] = {&ref};
	struct node w = warped(&quarter_twist, child);

	(void)state;
	ref = reference(&w);
	w.id = "turned";
	assert_refused(&w, MAX_NODES, ERR_INVALID, &ref, "\"turned\"");
}

static void test_tape_refuses_lengths_that_a_taper_takes_out_of_range(
    void **state)
{
	struct warp taper = {.type = WARP_TAPER, .axis = {1.0, 0.0, 0.0},
	    .has_range = true, .to = 1.0, .scale = 1e-9};
	struct node a = point(0), *child[1] = {&a};
	struct node w = warped(&taper, child);

	(void)state;
	a.primitive.radius[0] *= 0.5;
	assert_refused(&w, MAX_NODES, ERR_INVALID, &w, "own");
}

static void test_tape_of_random_trees_is_sound(void **state)
{
	bool seen[OP_COUNT] = {false};

	(void)state;
	for (uint64_t seed = 0; seed < 300; seed++) {
		struct random_tree *r = random_tree_create(
		    &(struct random_tree_options){.seed = seed,
		    .whole = true});
		struct tape_error error;
		struct tape *t;

		assert_int_equal(tape_compile(random_tree_get(r), MAX_NODES, &t,
		    &error), ERR_OK);
		assert_sound(t);
		for (size_t i = 0; i < t->insn_count; i++)
			seen[t->insns[i].op] = true;
		tape_free(t);
		random_tree_free(r);
	}
	/* OP_ZERO is for pruned ones */
	for (int op = 0; op < OP_COUNT; op++)
		assert_true(seen[op] || op == OP_ZERO);
}

static void test_tape_marks_runs_of_points(void **state)
{
	struct node a = point(0.0), b = point(1.0), c = point(2.0);
	struct node d = point(3.0), *children[] = {&a, &b, &c, &d};
	struct node sum = composition(NODE_SUM, children, 4);
	struct tape *t;

	(void)state;
	t = compile(&sum);
	assert_ops(t, (unsigned[]){OP_POINT, OP_POINT, OP_SUM, OP_POINT,
	    OP_SUM, OP_POINT, OP_SUM, OP_COUNT});
	assert_int_equal(t->insns[0].index, 0);
	assert_int_equal(t->insns[1].index, 3);
	assert_int_equal(t->insns[3].index, 2);
	assert_int_equal(t->insns[5].index, 1);
	tape_free(t);

	c.primitive.exponent = 4.0;
	t = compile(&sum);
	assert_int_equal(t->insns[1].index, 1);
	assert_int_equal(t->insns[3].index, 0);
	assert_int_equal(t->insns[5].index, 1);
	tape_free(t);
}

static void test_tape_counts_runs_of_what_is_left(void **state)
{
	/* pairs, but for the first and the fourth point, which has become one */
	struct insn insns[] = {{.op = OP_POINT, .index = 1},
	    {.op = OP_POINT, .index = 1}, {.op = OP_SUM},
	    {.op = OP_POINT, .index = 7}, {.op = OP_SUM},
	    {.op = OP_POINT, .index = 0}, {.op = OP_SUM},
	    {.op = OP_POINT, .index = 1}, {.op = OP_SUM}};

	(void)state;
	tape_count_runs(insns, sizeof(insns) / sizeof(*insns));
	assert_int_equal(insns[0].index, 0);
	assert_int_equal(insns[1].index, 2);
	assert_int_equal(insns[3].index, 1);
	assert_int_equal(insns[5].index, 0);
	assert_int_equal(insns[7].index, 1);
}

static struct tape_box box_of(const struct tape *t, size_t i)
{
	assert_true(i < t->insn_count);
	return t->boxes[i];
}

static void assert_box(struct tape_box b, double least, double most)
{
	/* along x; boxes are widened by 1e-6 times their numbers, thrice */
	assert_near(b.min[0], least, 1e-5 * fmax(1.0, fabs(least)));
	assert_near(b.max[0], most, 1e-5 * fmax(1.0, fabs(most)));
	assert_true(b.min[0] < least && b.max[0] > most);
}

static void test_tape_boxes_follow_transforms_and_compositions(void **state)
{
	struct node a = point(0.0), b = point(1.5), *children[] = {&a, &b};
	struct node both = composition(NODE_UNION, children, 2);
	struct node minus = composition(NODE_DIFFERENCE, children, 2);
	struct node meet = composition(NODE_INTERSECTION, children, 2);
	struct tape *t;

	(void)state;
	move(&both, 10.0);
	t = compile(&both);
	assert_ops(t, (unsigned[]){OP_FRAME, OP_POINT, OP_POINT, OP_UNION,
	    OP_COUNT});
	assert_box(box_of(t, 1), 9.0, 11.0);
	assert_box(box_of(t, 2), 10.5, 12.5);
	assert_box(box_of(t, 3), 9.0, 12.5);
	tape_free(t);
	t = compile(&minus);
	assert_box(box_of(t, 2), -1.0, 1.0);
	tape_free(t);
	t = compile(&meet);
	assert_box(box_of(t, 2), 0.5, 1.0);
	tape_free(t);
	b.primitive.a.x = 3.0;
	t = compile(&meet);
	assert_true(box_of(t, 2).min[0] > box_of(t, 2).max[0]);
	tape_free(t);
}

/* The way to a primitive of a tape: its warps, its frame. */
struct way {
	const struct insn *warps[TAPE_WARPS_MAX];
	size_t warp_count;
	const struct insn *frame; /* NULL: the base's */
};

static void follow(struct way *w, const struct insn *insn)
{
	if (insn->op == OP_FRAME)
		w->frame = insn;
	else if (insn->op == OP_ENTER)
		w->warps[w->warp_count++] = insn;
	else if (insn->op == OP_LEAVE)
		w->warp_count--;
	if (insn->op == OP_ENTER || insn->op == OP_LEAVE)
		w->frame = NULL;
}

/* The value of a primitive alone. */
static double value_alone(const struct tape *t, const struct way *w,
    const struct insn *primitive, struct vec3 p)
{
	struct insn insns[2 * TAPE_WARPS_MAX + 2];
	struct tape alone = *t;
	struct jet jet;
	size_t n = 0;

	for (size_t i = 0; i < w->warp_count; i++)
		insns[n++] = *w->warps[i];
	if (w->frame)
		insns[n++] = *w->frame;
	insns[n++] = *primitive;
	for (size_t i = w->warp_count; i-- > 0;) {
		insns[n] = *w->warps[i];
		insns[n++].op = OP_LEAVE;
	}
	alone.insns = insns;
	alone.insn_count = n;
	evaluate(&alone, p, 0, &jet);
	return jet.value;
}

/* A point beyond a face of b, by a part of its size or hardly. */
static struct vec3 point_outside(const struct tape_box *b,
    struct random_stream *r)
{
	double x[3], off = exp2(random_in(r, -24.0, 1.0));
	int face = random_below(r, 6), axis = face / 2;

	for (int i = 0; i < 3; i++)
		x[i] = random_in(r, fmax(b->min[i], -20.0f),
		    fmin(b->max[i], 20.0f));
	x[axis] = face % 2 ? b->max[axis] + off : b->min[axis] - off;
	for (int i = 0; i < 3; i++)
		x[i] = isfinite(x[i]) ? x[i] : 0.0;
	return vec3(x[0], x[1], x[2]);
}

static bool is_outside(const struct tape_box *b, struct vec3 p)
{
	return p.x < b->min[0] || p.x > b->max[0] || p.y < b->min[1] ||
	    p.y > b->max[1] || p.z < b->min[2] || p.z > b->max[2];
}

static void test_tape_primitives_are_0_outside_their_boxes(void **state)
{
	enum { TREES = 250, POINTS = 24 };
	struct random_stream r = {5};
	int tried = 0, bounded = 0, primitives = 0;

	(void)state;
	for (uint64_t seed = 0; seed < TREES; seed++) {
		struct random_tree *tree = random_tree_create(
		    &(struct random_tree_options){.seed = seed,
		    .whole = seed % 2});
		struct tape *t = compile(random_tree_get(tree)->root);
		struct way way = {.warp_count = 0};

		for (size_t i = 0; i < t->insn_count; i++) {
			const struct insn *insn = t->insns + i;
			const struct tape_box *b = t->boxes + i;

			follow(&way, insn);
			if (insn->op < OP_PRIMITIVES || insn->op >= OP_MAX)
				continue;
			primitives++;
			bounded += isfinite(b->min[0]) && isfinite(b->max[2]);
			for (int k = 0; k < POINTS; k++) {
				struct vec3 p = point_outside(b, &r);

				if (!is_outside(b, p))
					continue;
				tried++;
				assert_true(value_alone(t, &way, insn, p) ==
				    0.0);
			}
		}
		tape_free(t);
		random_tree_free(tree);
	}
	assert_true(tried > 20 * bounded);
	assert_true(2 * bounded > primitives);
}

/* Compiles tree with the first, the second ... allocation failing, until none
 * does; how many there are. */
static long fail_every_allocation(const struct tree *tree)
{
	struct tape_error error;
	enum err err;
	long n = 0;

	do {
		struct tape *t = NULL;

		fail_alloc_set(++n);
		err = tape_compile(tree, MAX_NODES, &t, &error);
		if (err == ERR_OK)
			tape_free(t);
		else
			assert_null(t);
		assert_int_equal(fail_alloc_live(), 0);
		assert_int_equal(err, fail_alloc_happened() ? ERR_MEMORY
		    : ERR_OK);
	} while (err != ERR_OK);
	fail_alloc_set(0);
	return n;
}

static void test_tape_survives_every_failing_allocation(void **state)
{
	struct random_tree *r;

	(void)state;
	if (!fail_alloc_available())
		skip();
	r = random_tree_create(&(struct random_tree_options){.seed = 7,
	    .whole = true});
	/* the tape, and at least one growth of each of six lists */
	assert_true(fail_every_allocation(random_tree_get(r)) > 7);
	random_tree_free(r);
}

/* More volumes than there is room for at first, some of them held already when
 * an allocation fails. */
static void test_tape_lets_go_of_volumes_when_an_allocation_fails(
    void **state)
{
	enum { COUNT = 40 };
	struct volume *v[COUNT];
	struct node n[COUNT], *children[COUNT];
	struct node root = composition(NODE_SUM, children, COUNT);
	struct tree tree = {&root, TREE_NULL_GRADIENT};

	(void)state;
	if (!fail_alloc_available())
		skip();
	for (int i = 0; i < COUNT; i++) {
		v[i] = volume(false, 0.5f);
		n[i] = sampled(v[i], 0.0);
		children[i] = n + i;
	}
	assert_true(fail_every_allocation(&tree) > 8);
	for (int i = 0; i < COUNT; i++) {
		assert_int_equal(atomic_load(&v[i]->refs), 1);
		volume_release(v[i]);
	}
}

int main(void)
{
	const struct CMUnitTest tests[] = {
		cmocka_unit_test(test_tape_primitive_is_one_instruction),
		cmocka_unit_test(test_tape_free_of_null_does_nothing),
		cmocka_unit_test(test_tape_folds_left_to_right),
		cmocka_unit_test(
		    test_tape_orders_are_what_the_root_asks_and_extra),
		cmocka_unit_test(test_tape_extra_stops_at_two),
		cmocka_unit_test(test_tape_constant_opening_asks_no_more),
		cmocka_unit_test(test_tape_sharp_sum_and_ricci_ask_no_more),
		cmocka_unit_test(test_tape_single_child_is_the_composition),
		cmocka_unit_test(test_tape_deeper_operand_goes_first),
		cmocka_unit_test(
		    test_tape_deeper_child_goes_before_its_siblings_fold),
		cmocka_unit_test(test_tape_chains_need_two_jets_on_either_side),
		cmocka_unit_test(
		    test_tape_balanced_thousand_leaves_need_log_jets),
		cmocka_unit_test(test_tape_translation_has_frame_and_no_carry),
		cmocka_unit_test(test_tape_siblings_share_a_frame),
		cmocka_unit_test(test_tape_frames_compose_and_carries_do_not),
		cmocka_unit_test(
		    test_tape_ref_instances_target_with_both_transforms),
		cmocka_unit_test(test_tape_operators_are_shared),
		cmocka_unit_test(test_tape_many_operators_keep_their_indices),
		cmocka_unit_test(
		    test_tape_table_layouts_are_different_operators),
		cmocka_unit_test(test_tape_null_gradient_scales_with_the_fields),
		cmocka_unit_test(test_tape_nested_turns_do_not_stretch),
		cmocka_unit_test(test_tape_refuses_a_ref_to_its_ancestor),
		cmocka_unit_test(test_tape_refuses_a_ref_to_itself),
		cmocka_unit_test(test_tape_refuses_refs_that_meet),
		cmocka_unit_test(test_tape_node_limit_counts_expanded_nodes),
		cmocka_unit_test(test_tape_billion_laughs_fail_fast),
		cmocka_unit_test(test_tape_refuses_nesting_beyond_its_limit),
		cmocka_unit_test(test_tape_refuses_singular_transforms),
		cmocka_unit_test(test_tape_refuses_lengths_out_of_range),
		cmocka_unit_test(test_tape_accepts_lengths_at_the_limits),
		cmocka_unit_test(test_tape_warp_encloses_its_child),
		cmocka_unit_test(test_tape_warp_has_frames_of_its_own_base),
		cmocka_unit_test(test_tape_warps_siblings_get_their_frames),
		cmocka_unit_test(test_tape_warp_asks_what_its_parents_ask),
		cmocka_unit_test(
		    test_tape_ref_instances_warps_and_is_one_below_them),
		cmocka_unit_test(test_tape_taper_stretches_lengths),
		cmocka_unit_test(test_tape_convolution_sums_its_elements),
		cmocka_unit_test(test_tape_color_is_inherited_and_set_once),
		cmocka_unit_test(test_tape_color_of_refs),
		cmocka_unit_test(test_tape_classic_has_its_type_and_family),
		cmocka_unit_test(test_tape_volumes_are_shared_and_held),
		cmocka_unit_test(
		    test_tape_draft_operators_are_different_operators),
		cmocka_unit_test(
		    test_tape_refuses_volumes_whose_falloff_does_not_fit),
		cmocka_unit_test(test_tape_refuses_too_many_warps),
		cmocka_unit_test(test_tape_refuses_a_warp_of_itself),
		cmocka_unit_test(
		    test_tape_refuses_lengths_that_a_taper_takes_out_of_range),
		cmocka_unit_test(test_tape_of_random_trees_is_sound),
		cmocka_unit_test(test_tape_marks_runs_of_points),
		cmocka_unit_test(test_tape_counts_runs_of_what_is_left),
		cmocka_unit_test(
		    test_tape_boxes_follow_transforms_and_compositions),
		cmocka_unit_test(
		    test_tape_primitives_are_0_outside_their_boxes),
		cmocka_unit_test(test_tape_survives_every_failing_allocation),
		cmocka_unit_test(
		    test_tape_lets_go_of_volumes_when_an_allocation_fails),
	};

	return cmocka_run_group_tests_name("tape", tests, make_camel, NULL);
}
