#include <stdarg.h>
#include <stddef.h>
#include <setjmp.h>
#include <stdint.h>
#include <cmocka.h>

#include <math.h>
#include <stdbool.h>

#include "core/evaluate.h"
#include "core/locate.h"
#include "core/opening.h"
#include "core/tape.h"
#include "core/tree.h"
#include "tests/support/fail_alloc.h"
#include "tests/support/near.h"
#include "tests/support/random_tree.h"

#define PI 3.14159265358979323846
#define MAX_NODES 64

static struct vec3 random_vec3(struct random_stream *r, double reach)
{
	double x = random_in(r, -reach, reach), y = random_in(r, -reach, reach);

	return vec3(x, y, random_in(r, -reach, reach));
}

static double value_at(const struct node *root, struct vec3 p)
{
	const struct tree tree = {root, TREE_NULL_GRADIENT};
	struct tape_error error;
	struct tape *tape;
	struct jet jet;

	assert_int_equal(tape_compile(&tree, MAX_NODES, &tape, &error), ERR_OK);
	evaluate(tape, p, 0, &jet);
	tape_free(tape);
	return jet.value;
}

/* A soft point with radius 1 at (x, y, 0). */
static struct node blob(double x, double y)
{
	return (struct node){.type = NODE_PRIMITIVE, .primitive = {
	    .type = PRIMITIVE_POINT, .a = {x, y, 0.0}, .radius = {1.0},
	    .exponent = 3.0, .weight = 1.0}};
}

static void adopt(struct node *parent)
{
	for (size_t i = 0; i < parent->child_count; i++) {
		parent->children[i]->parent = parent;
		parent->children[i]->index = i;
	}
}

static struct node join(struct node **children, size_t count,
    const struct operator *op)
{
	return (struct node){.type = NODE_UNION, .id = "u", .op = op,
	    .sharp = op == NULL, .children = children, .child_count = count};
}

static struct operator operator_of(struct opening opening)
{
	return (struct operator){.profile = profile_smooth(),
	    .opening = opening};
}

static struct operator camel(void)
{
	struct opening opening;

	assert_true(opening_named("camel", &opening));
	return operator_of(opening);
}

static struct affine random_transform(struct random_stream *r)
{
	const struct vec3 t = random_vec3(r, 0.5), q = random_vec3(r, 1.0);

	return affine_from_trs((double[3]){t.x, t.y, t.z},
	    (double[4]){q.x, q.y, q.z, 1.0},
	    (double[3]){random_in(r, 0.5, 2.0), random_in(r, 0.5, 2.0),
	    random_in(r, -2.0, -0.5)});
}

/* A twist of a bend of a blob, each with a transform: the blob's own field
 * where locate_point says is the field of the whole. */
static void test_points_pass_transforms_and_warps(void **state)
{
	struct random_stream r = {1};
	int inside = 0;

	(void)state;
	for (int n = 0; n < 200; n++) {
		struct node leaf = blob(0.2, 0.1), plain = leaf;
		struct node *leaves[] = {&leaf};
		struct node bend = {.type = NODE_WARP, .children = leaves,
		    .child_count = 1, .warp = {.type = WARP_BEND,
		    .axis = {0.0, 1.0, 0.0}, .direction = {0.0, 0.0, 1.0},
		    .rate = 1.0, .has_range = true, .from = -1.0, .to = 1.0}};
		struct node *bends[] = {&bend};
		struct node twist = {.type = NODE_WARP, .children = bends,
		    .child_count = 1, .warp = {.type = WARP_TWIST,
		    .axis = {1.0, 0.0, 0.0}, .rate = 2.0}};
		struct node *const chain[] = {&leaf, &bend, &twist};
		struct vec3 p = random_vec3(&r, 2.0);

		adopt(&bend);
		adopt(&twist);
		for (int i = 0; i < 3; i++) {
			chain[i]->has_transform = true;
			chain[i]->transform = random_transform(&r);
		}
		inside += value_at(&twist, p) > 0.0;
		/* The same operations: measured 0. */
		assert_near(value_at(&plain, locate_point(&leaf, p)),
		    value_at(&twist, p), 1e-12);
	}
	assert_true(inside > 50);
}

static void test_children_are_seen_in_the_nodes_own_frame(void **state)
{
	struct random_stream r = {2};
	struct node a = blob(0.0, 0.0), *children[] = {&a};
	struct node node = join(children, 1, NULL);
	struct jet jet, plus, minus;
	const double h = 1e-5;
	struct vec3 p;

	(void)state;
	a.has_transform = node.has_transform = true;
	a.transform = random_transform(&r);
	node.transform = random_transform(&r);
	adopt(&node);
	p = locate_point(&node, vec3(0.3, 0.2, -0.1));
	assert_int_equal(locate_child(&node, 0, 1e-2, MAX_NODES, p, 1, &jet),
	    ERR_OK);
	assert_near(jet.value, value_at(&node, vec3(0.3, 0.2, -0.1)), 1e-14);
	assert_true(jet.value > 0.1 && vec3_norm(jet.gradient) > 0.1);
	locate_child(&node, 0, 1e-2, MAX_NODES, vec3(p.x + h, p.y, p.z), 0,
	    &plus);
	locate_child(&node, 0, 1e-2, MAX_NODES, vec3(p.x - h, p.y, p.z), 0,
	    &minus);
	/* Measured 5e-12. */
	assert_near((plus.value - minus.value) / (2.0 * h), jet.gradient.x,
	    1e-9);
}

static void test_nodes_are_found_by_id(void **state)
{
	struct node a = blob(0.0, 0.0), b = blob(1.0, 0.0);
	struct node *children[] = {&a, &b};
	struct node node = join(children, 2, NULL);
	const struct tree tree = {.root = &node};

	(void)state;
	b.id = "b";
	assert_ptr_equal(locate_node(&tree, "b"), &b);
	assert_ptr_equal(locate_node(&tree, "u"), &node);
	assert_null(locate_node(&tree, "a"));
}

/* The point of a's surface at angle phi from the x axis. */
static struct vec3 on_surface(const struct node *a, double phi)
{
	const struct vec3 c = a->primitive.a;

	return vec3(c.x + cos(phi), c.y + sin(phi), c.z);
}

/*
 * Along a's surface towards b: before the click, where b is less, the union is
 * a alone; beyond it, it is blended.
 */
static void test_a_blend_of_that_angle_ends_at_the_click(void **state)
{
	struct node a = blob(0.0, 0.0), b = blob(2.0, 0.0);
	struct node *children[] = {&a, &b};
	struct operator op;
	struct node node = join(children, 2, &op);
	struct locate_blend blend;

	(void)state;
	op = camel();
	adopt(&node);
	for (double phi = 0.35; phi < 0.7; phi += 0.05) {
		struct vec3 out = on_surface(&a, phi + 1e-6);
		struct vec3 in = on_surface(&a, phi - 5e-2);
		double least = value_at(&a, out), more;

		op = camel();
		assert_int_equal(locate_blend(&node, NULL, 1e-2, MAX_NODES,
		    on_surface(&a, phi), &blend), ERR_OK);
		assert_near(blend.values[0], 0.5, 1e-12);
		assert_true(blend.values[1] > 0.01 && blend.values[1] < 0.5);
		assert_near(tan(blend.theta), 2.0 * blend.values[1], 1e-12);
		op = operator_of(opening_constant(blend.theta));
		assert_near(value_at(&node, out), least, 1e-12);
		more = value_at(&node, in) - fmax(value_at(&a, in),
		    value_at(&b, in));
		/* The union leaves the larger field infinitely flat. */
		assert_true(more > 1e-9);
		/* Opened a little less far, it does reach the click. */
		op = operator_of(opening_constant(0.9 * blend.theta));
		assert_true(value_at(&node, on_surface(&a, phi)) > 0.5 + 1e-6);
	}
}

static void test_the_formula_is_the_boundary_at_the_iso_value(void **state)
{
	const struct profile smooth = profile_smooth();
	struct operator_jet g;

	(void)state;
	for (double f2 = 0.02; f2 < 0.5; f2 += 0.02) {
		double theta = atan(2.0 * f2);

		operator_eval(FAMILY_UNION, &smooth, 0.5, f2 - 1e-9, theta, 0,
		    &g);
		assert_near(g.g, 0.5, 0.0);
		operator_eval(FAMILY_UNION, &smooth, 0.5, f2 + 0.05 * (0.5 -
		    f2), theta, 0, &g);
		assert_true(g.g > 0.5);
	}
}

static void test_the_two_largest_children_blend(void **state)
{
	struct node a = blob(2.2, 0.0), b = blob(0.0, 0.0), c = blob(9.0, 0.0);
	struct node d = blob(1.7, 0.0);
	struct node *children[] = {&a, &b, &c, &d};
	struct node node = join(children, 4, NULL);
	const size_t given[2] = {0, 1}, turned[2] = {1, 0};
	struct locate_blend blend;
	struct vec3 p = vec3(0.8, 0.0, 0.0);

	(void)state;
	adopt(&node);
	assert_int_equal(locate_blend(&node, NULL, 1e-2, MAX_NODES, p, &blend),
	    ERR_OK);
	assert_int_equal(blend.children[0], 1);
	assert_int_equal(blend.children[1], 3);
	assert_near(blend.values[0], value_at(&b, p), 0.0);
	assert_near(blend.values[1], value_at(&d, p), 0.0);
	locate_blend(&node, given, 1e-2, MAX_NODES, p, &blend);
	assert_int_equal(blend.children[0], 1);
	assert_int_equal(blend.children[1], 0);
	assert_near(blend.values[1], value_at(&a, p), 0.0);
	locate_blend(&node, turned, 1e-2, MAX_NODES, p, &blend);
	assert_int_equal(blend.children[0], 1);
	/* Equal ones stay in their order. */
	p = vec3(50.0, 0.0, 0.0);
	locate_blend(&node, NULL, 1e-2, MAX_NODES, p, &blend);
	assert_int_equal(blend.children[0], 0);
	assert_int_equal(blend.children[1], 1);
	assert_near(blend.theta, 0.0, 0.0);
}

static void test_alpha_names_the_parameter_to_set(void **state)
{
	static const struct {
		double x, y, alpha;
		int parameter;
	} cases[] = {
		/* seen from (0, 0, 0) beside blob (1, 0): the other at */
		{0.0, 1.2, PI / 2, 1}, {1.2, 0.0, 0.0, 0}, {-1.2, 0.0, PI, 2},
		{0.0, -1.2, PI / 2, 1},
	};
	struct operator op = camel();

	(void)state;
	for (size_t i = 0; i < sizeof cases / sizeof *cases; i++) {
		struct node a = blob(1.0, 0.0);
		struct node b = blob(cases[i].x, cases[i].y);
		struct node *children[] = {&a, &b};
		struct node node = join(children, 2, &op);
		struct locate_blend blend;

		adopt(&node);
		assert_int_equal(locate_blend(&node, NULL, 1e-2, MAX_NODES,
		    vec3(0.0, 0.0, 0.0), &blend), ERR_OK);
		assert_true(blend.has_alpha);
		assert_near(blend.alpha, cases[i].alpha, 1e-12);
		assert_int_equal(blend.parameter, cases[i].parameter);
		node.op = NULL;
		node.sharp = true;
		locate_blend(&node, NULL, 1e-2, MAX_NODES, vec3(0.0, 0.0, 0.0),
		    &blend);
		assert_true(blend.has_alpha);
		assert_int_equal(blend.parameter, -1);
	}
}

static void test_parameter_of_jumps_and_of_constant_openings(void **state)
{
	struct node a = blob(1.0, 0.0), b = blob(0.0, 1.2);
	struct node *children[] = {&a, &b};
	struct operator op = camel();
	struct node node = join(children, 2, &op);
	struct locate_blend blend;

	(void)state;
	adopt(&node);
	op.opening.alpha[1] = op.opening.alpha[2] = 1.0;
	locate_blend(&node, NULL, 1e-2, MAX_NODES, vec3(0.0, 0.0, 0.0), &blend);
	assert_int_equal(blend.parameter, 2);
	op.opening.alpha[0] = op.opening.alpha[1] = 2.0;
	op.opening.alpha[2] = PI;
	locate_blend(&node, NULL, 1e-2, MAX_NODES, vec3(0.0, 0.0, 0.0), &blend);
	assert_int_equal(blend.parameter, 0);
	op.opening = opening_constant(0.2);
	locate_blend(&node, NULL, 1e-2, MAX_NODES, vec3(0.0, 0.0, 0.0), &blend);
	assert_int_equal(blend.parameter, LOCATE_CONSTANT);
}

/* A node's frame may be sheared: the angle is the one that it blends by. */
static void test_alpha_is_of_the_nodes_own_frame(void **state)
{
	struct node a = blob(1.0, 0.0), b = blob(0.0, 1.2);
	struct node *children[] = {&a, &b};
	struct node node = join(children, 2, NULL);
	struct locate_blend blend;

	(void)state;
	adopt(&node);
	node.has_transform = true;
	node.transform = affine_identity();
	node.transform.a[0][1] = 0.7;
	node.transform.t[2] = 3.0;
	locate_blend(&node, NULL, 1e-2, MAX_NODES, vec3(0.0, 0.0, 3.0), &blend);
	assert_near(blend.alpha, PI / 2, 1e-12);
}

static void test_null_gradients_have_no_alpha(void **state)
{
	struct node a = blob(0.0, 0.0), b = blob(9.0, 0.0);
	struct node *children[] = {&a, &b};
	struct operator op = camel();
	struct node node = join(children, 2, &op);
	struct locate_blend blend;

	(void)state;
	adopt(&node);
	locate_blend(&node, NULL, 1e-2, MAX_NODES, vec3(1.0, 0.0, 0.0), &blend);
	assert_false(blend.has_alpha);
	assert_int_equal(blend.parameter, -1);
	assert_near(blend.theta, 0.0, 0.0);
}

static void test_theta_stays_under_a_quarter_of_pi(void **state)
{
	struct node a = blob(0.0, 0.0), b = blob(0.5, 0.0);
	struct node *children[] = {&a, &b};
	struct node node = join(children, 2, NULL);
	struct locate_blend blend;

	(void)state;
	adopt(&node);
	locate_blend(&node, NULL, 1e-2, MAX_NODES, vec3(0.2, 0.0, 0.0), &blend);
	assert_true(blend.values[1] > 0.5);
	assert_near(blend.theta, PI / 4, 1e-15);
}

static void test_failures_are_told_and_leak_nothing(void **state)
{
	struct node a = blob(0.0, 0.0), b = blob(0.5, 0.0);
	struct node *children[] = {&a, &b};
	struct node node = join(children, 2, NULL);
	struct locate_blend blend = {.theta = -1.0};
	enum err err = ERR_MEMORY;

	(void)state;
	adopt(&node);
	assert_int_equal(locate_blend(&node, NULL, 1e-2, 0, vec3(0.0, 0.0,
	    0.0), &blend), ERR_LIMIT);
	assert_near(blend.theta, -1.0, 0.0);
	if (!fail_alloc_available())
		skip();
	for (long n = 1; err == ERR_MEMORY && n < 1000; n++) {
		fail_alloc_set(n);
		err = locate_blend(&node, NULL, 1e-2, MAX_NODES,
		    vec3(0.0, 0.0, 0.0), &blend);
		assert_true(err == ERR_OK || fail_alloc_happened());
		assert_int_equal(fail_alloc_live(), 0);
	}
	fail_alloc_set(0);
	assert_int_equal(err, ERR_OK);
}

int main(void)
{
	const struct CMUnitTest tests[] = {
		cmocka_unit_test(test_points_pass_transforms_and_warps),
		cmocka_unit_test(
		    test_children_are_seen_in_the_nodes_own_frame),
		cmocka_unit_test(test_nodes_are_found_by_id),
		cmocka_unit_test(test_a_blend_of_that_angle_ends_at_the_click),
		cmocka_unit_test(
		    test_the_formula_is_the_boundary_at_the_iso_value),
		cmocka_unit_test(test_the_two_largest_children_blend),
		cmocka_unit_test(test_alpha_names_the_parameter_to_set),
		cmocka_unit_test(
		    test_parameter_of_jumps_and_of_constant_openings),
		cmocka_unit_test(test_alpha_is_of_the_nodes_own_frame),
		cmocka_unit_test(test_null_gradients_have_no_alpha),
		cmocka_unit_test(test_theta_stays_under_a_quarter_of_pi),
		cmocka_unit_test(test_failures_are_told_and_leak_nothing),
	};

	return cmocka_run_group_tests(tests, NULL, NULL);
}
