/*
 * Boxes against the evaluator: nothing may be outside of one, and climbing
 * towards each of a primitive's faces must end at it.
 */
#include <stdarg.h>
#include <stddef.h>
#include <setjmp.h>
#include <stdint.h>
#include <cmocka.h>

#include <math.h>
#include <stdbool.h>
#include <stdlib.h>

#include "core/bounds.h"
#include "core/classic.h"
#include "core/evaluate.h"
#include "core/tape.h"
#include "core/tree.h"
#include "core/volume.h"
#include "tests/support/near.h"
#include "tests/support/random_tree.h"
#include "tests/support/sanitized.h"

#define PI 3.14159265358979323846
#define MAX_NODES 4096

/* Trees and the like are tried fewer times under a sanitizer. */
#define TIMES(n) (SANITIZED ? (n) / 8 : (n))

static struct tape *compile(const struct node *root)
{
	const struct tree tree = {root, TREE_NULL_GRADIENT};
	struct tape_error error;
	struct tape *tape;

	assert_int_equal(tape_compile(&tree, MAX_NODES, &tape, &error), ERR_OK);
	return tape;
}

static double value_at(const struct tape *tape, struct vec3 p)
{
	struct jet jet;

	evaluate(tape, p, 0, &jet);
	return jet.value;
}

static double coordinate(struct vec3 p, int i)
{
	return i == 0 ? p.x : i == 1 ? p.y : p.z;
}

static struct vec3 random_vec3(struct random_stream *r, double reach)
{
	double x = random_in(r, -reach, reach), y = random_in(r, -reach, reach);

	return vec3(x, y, random_in(r, -reach, reach));
}

static bool holds(const struct bounds *b, struct vec3 p)
{
	return p.x >= b->min.x && p.x <= b->max.x && p.y >= b->min.y &&
	    p.y <= b->max.y && p.z >= b->min.z && p.z <= b->max.z;
}

static void assert_holds(const struct bounds *b, struct vec3 p, double value,
    unsigned long which)
{
	if (value > 0.0 && !holds(b, p))
		fail_msg("%lu: the field is %g at (%.17g, %.17g, %.17g), "
		    "outside of (%.17g, %.17g, %.17g) to (%.17g, %.17g, %.17g)",
		    which, value, p.x, p.y, p.z, b->min.x, b->min.y, b->min.z,
		    b->max.x, b->max.y, b->max.z);
}

/* p moved towards face i of sign for as far as the field is not 0, in steps
 * that halve. */
static struct vec3 rise(const struct tape *tape, struct vec3 p, int i,
    double sign)
{
	const struct vec3 up = vec3(i == 0 ? sign : 0.0, i == 1 ? sign : 0.0,
	    i == 2 ? sign : 0.0);

	for (double step = 0.5; step > 1e-7;) {
		struct vec3 next = vec3_axpy(step, up, p);

		if (value_at(tape, next) > 0.0)
			p = next;
		else
			step *= 0.5;
	}
	return p;
}

/*
 * Where a climb from p, where the field is not 0, towards face i of sign ends:
 * it rises to the rim, looks beside it for where the field is larger, and so
 * on.
 */
static struct vec3 climb(const struct tape *tape, struct random_stream *r,
    struct vec3 p, int i, double sign, int rounds)
{
	for (int n = 0; n < rounds; n++) {
		p = rise(tape, p, i, sign);
		for (double reach = 0.5; reach > 1e-4; reach *= 0.6) {
			struct vec3 d = random_vec3(r, reach);
			struct vec3 next = vec3_add(p, vec3(i == 0 ? 0.0 : d.x,
			    i == 1 ? 0.0 : d.y, i == 2 ? 0.0 : d.z));

			if (value_at(tape, next) > value_at(tape, p))
				p = next;
		}
	}
	return rise(tape, p, i, sign);
}

/* A point of the support within b and near the origin; false: none found. */
static bool find(const struct tape *tape, struct random_stream *r,
    const struct bounds *b, struct vec3 *out)
{
	for (int n = 0; n < 4000 && !bounds_is_empty(b); n++) {
		*out = vec3(
		    random_in(r, fmax(b->min.x, -5.0), fmin(b->max.x, 5.0)),
		    random_in(r, fmax(b->min.y, -5.0), fmin(b->max.y, 5.0)),
		    random_in(r, fmax(b->min.z, -5.0), fmin(b->max.z, 5.0)));
		if (value_at(tape, *out) > 0.0)
			return true;
	}
	return false;
}

/* The least distance of what is climbed to from face i, in tries, or until it
 * is under near. */
static double gap(const struct tape *tape, struct random_stream *r,
    const struct bounds *b, int i, double sign, int tries, double near)
{
	double face = coordinate(sign > 0.0 ? b->max : b->min, i);
	double least = INFINITY;
	struct vec3 p;

	for (int n = 0; n < tries && least > near; n++) {
		if (!find(tape, r, b, &p))
			return NAN;
		p = climb(tape, r, p, i, sign, near > 0.0 ? 12 : 3);
		assert_holds(b, p, value_at(tape, p), (unsigned long)n);
		least = fmin(least, sign * (face - coordinate(p, i)));
	}
	return least;
}

static struct node primitive_node(struct primitive p)
{
	return (struct node){.type = NODE_PRIMITIVE, .primitive = p};
}

static void test_primitives_reach_every_face_of_their_boxes(void **state)
{
	struct random_stream r = {1};

	(void)state;
	for (int n = 0; n < TIMES(96); n++) {
		struct node node = primitive_node(random_primitive(&r, n % 2,
		    !(n % 2)));
		struct bounds b = bounds_of_node(&node);
		struct tape *tape = compile(&node);

		for (int face = 0; face < 6; face++) {
			double sign = face % 2 ? 1.0 : -1.0;

			if (isinf(coordinate(sign > 0.0 ? b.max : b.min,
			    face / 2)))
				continue;
			/* Some climbs end at a lesser peak. */
			assert_near(gap(tape, &r, &b, face / 2, sign, 20,
			    1e-3), 0.0, 1e-3);
		}
		tape_free(tape);
	}
}

static void assert_box(struct bounds b, struct vec3 min, struct vec3 max)
{
	assert_near(b.min.x, min.x, 1e-12);
	assert_near(b.min.y, min.y, 1e-12);
	assert_near(b.min.z, min.z, 1e-12);
	assert_near(b.max.x, max.x, 1e-12);
	assert_near(b.max.y, max.y, 1e-12);
	assert_near(b.max.z, max.z, 1e-12);
}

/* R of exponent 3 and radius 1. */
static double soft_reach(void)
{
	return 1.0 / sqrt(1.0 - cbrt(0.5));
}

static void test_boxes_of_round_shapes_are_tight(void **state)
{
	double r = soft_reach(), s = sqrt(0.5);
	struct node disc = primitive_node((struct primitive){
	    .type = PRIMITIVE_DISC, .a = {1.0, 0.0, 0.0},
	    .normal = {0.0, 3.0, 3.0}, .major = 2.0, .radius = {1.0},
	    .exponent = 3.0, .weight = 1.0});
	struct node cylinder = primitive_node((struct primitive){
	    .type = PRIMITIVE_CYLINDER, .b = {0.0, 0.0, 4.0}, .radius = {1.0},
	    .falloff = 0.5});
	struct node torus = primitive_node((struct primitive){
	    .type = PRIMITIVE_TORUS, .normal = {0.0, -1e-200, 0.0},
	    .major = 2.0, .minor = 0.5, .falloff = 0.25});
	struct node cone = primitive_node((struct primitive){
	    .type = PRIMITIVE_CONE, .b = {3.0, 0.0, 0.0}, .radius = {1.0, 0.0},
	    .falloff = 0.5});

	(void)state;
	assert_box(bounds_of_node(&disc),
	    vec3(-1.0 - r, -2.0 * s - r, -2.0 * s - r),
	    vec3(3.0 + r, 2.0 * s + r, 2.0 * s + r));
	assert_box(bounds_of_node(&cylinder), vec3(-1.5, -1.5, -0.5),
	    vec3(1.5, 1.5, 4.5));
	assert_box(bounds_of_node(&torus), vec3(-2.75, -0.75, -2.75),
	    vec3(2.75, 0.75, 2.75));
	assert_box(bounds_of_node(&cone), vec3(-0.5, -1.5, -1.5),
	    vec3(3.5, 1.5, 1.5));
}

static void test_a_segment_of_two_radii_is_a_frustum_and_half_balls(
    void **state)
{
	double r = soft_reach(), w = sqrt(1.0 - 0.36);
	struct node node = primitive_node((struct primitive){
	    .type = PRIMITIVE_SEGMENT, .b = {3.0, 4.0, 0.0},
	    .radius = {2.0, 0.5}, .exponent = 3.0, .weight = 1.0});

	(void)state;
	/* The thick end's half ball looks down; its rim is its top. */
	assert_box(bounds_of_node(&node), vec3(-2.0 * r, -2.0 * r, -2.0 * r),
	    vec3(fmax(3.0 + 0.5 * r, 2.0 * r * w),
	    fmax(4.0 + 0.5 * r, 2.0 * r * 0.6), 2.0 * r));
}

static void test_planes_are_bounded_on_one_side_of_an_axis(void **state)
{
	struct node node = primitive_node((struct primitive){
	    .type = PRIMITIVE_PLANE, .a = {5.0, 5.0, 1.0},
	    .normal = {0.0, 0.0, -2.0}, .falloff = 0.5});
	struct bounds b = bounds_of_node(&node);

	(void)state;
	assert_near(b.min.z, 0.5, 1e-12);
	assert_true(isinf(b.max.z) && isinf(b.min.x) && isinf(b.max.y));
	assert_false(bounds_is_finite(&b));
	assert_false(bounds_is_empty(&b));
	node.primitive.normal.x = 1e-9;
	b = bounds_of_node(&node);
	assert_true(isinf(b.min.z));
	/* Scaled and mirrored: infinity stays on its side. */
	node.primitive.normal.x = 0.0;
	node.has_transform = true;
	node.transform = affine_identity();
	node.transform.a[2][2] = -2.0;
	b = bounds_of_node(&node);
	assert_near(b.max.z, -1.0, 1e-12);
	assert_true(isinf(b.min.z) && isinf(b.min.y) && isinf(b.max.x));
}

static void test_weightless_fields_are_empty(void **state)
{
	struct node node = primitive_node((struct primitive){
	    .type = PRIMITIVE_POINT, .radius = {1.0}, .exponent = 3.0});
	struct bounds b = bounds_of_node(&node);

	(void)state;
	assert_true(bounds_is_empty(&b));
	node.has_transform = true;
	node.transform = affine_identity();
	node.transform.a[0][1] = -3.0;
	b = bounds_of_node(&node);
	assert_true(bounds_is_empty(&b));
}

static struct node ball(double x, double radius)
{
	return primitive_node((struct primitive){.type = PRIMITIVE_SPHERE,
	    .a = {x, 0.0, 0.0}, .radius = {radius}, .falloff = 0.5});
}

static struct node composition(enum node_type type, struct node **children,
    size_t count)
{
	return (struct node){.type = type, .sharp = true, .n = 2.0,
	    .children = children, .child_count = count};
}

static void test_compositions_join_and_cut(void **state)
{
	struct node a = ball(0.0, 1.0), b = ball(2.0, 1.0);
	struct node far = ball(9.0, 1.0), *children[] = {&a, &b, &far};
	struct node node = composition(NODE_UNION, children, 2);
	const enum node_type joining[] = {NODE_UNION, NODE_SUM, NODE_RICCI,
	    NODE_CONVOLUTION};
	struct bounds box;

	(void)state;
	for (int i = 0; i < 4; i++) {
		node.type = joining[i];
		assert_box(bounds_of_node(&node), vec3(-1.5, -1.5, -1.5),
		    vec3(3.5, 1.5, 1.5));
	}
	node.type = NODE_INTERSECTION;
	assert_box(bounds_of_node(&node), vec3(0.5, -1.5, -1.5),
	    vec3(1.5, 1.5, 1.5));
	node.type = NODE_DIFFERENCE;
	assert_box(bounds_of_node(&node), vec3(-1.5, -1.5, -1.5),
	    vec3(1.5, 1.5, 1.5));
	node.type = NODE_INTERSECTION;
	node.child_count = 3;
	box = bounds_of_node(&node);
	assert_true(bounds_is_empty(&box));
}

/* What is empty neither moves nor grows what it is joined with. */
static void test_empty_children_add_nothing(void **state)
{
	struct node a = ball(0.0, 1.0), far = ball(9.0, 1.0), near = ball(1.0,
	    1.0);
	struct node *apart[] = {&a, &far};
	struct node none = composition(NODE_INTERSECTION, apart, 2);
	struct node *children[] = {&none, &near};
	struct node node = composition(NODE_UNION, children, 2);

	(void)state;
	assert_box(bounds_of_node(&node), vec3(-0.5, -1.5, -1.5),
	    vec3(2.5, 1.5, 1.5));
}

static void test_refs_have_their_targets_boxes(void **state)
{
	struct node a = ball(1.0, 1.0);
	struct node ref = {.type = NODE_REF, .target = &a,
	    .has_transform = true, .transform = affine_identity()};

	(void)state;
	a.has_transform = true;
	a.transform = affine_identity();
	a.transform.t[0] = 1.0;
	ref.transform.a[0][0] = 2.0;
	assert_box(bounds_of_node(&ref), vec3(1.0, -1.5, -1.5),
	    vec3(7.0, 1.5, 1.5));
}

static void test_random_trees_stay_within_their_boxes(void **state)
{
	enum { POINTS = 256 };
	float xyz[3 * POINTS];
	int bounded = 0;

	(void)state;
	for (unsigned long seed = 1; seed <= TIMES(400); seed++) {
		const struct random_tree_options options = {.seed = seed,
		    .only_soft = seed % 4 == 0};
		struct random_tree *t = random_tree_create(&options);
		const struct node *root = random_tree_get(t)->root;
		struct bounds b = bounds_of_node(root);
		struct tape *tape = compile(root);

		bounded += bounds_is_finite(&b);
		random_tree_points(t, tape, seed, POINTS, xyz);
		for (int i = 0; i < POINTS; i++) {
			struct vec3 p = vec3(xyz[3 * i], xyz[3 * i + 1],
			    xyz[3 * i + 2]);

			assert_holds(&b, p, value_at(tape, p), seed);
		}
		tape_free(tape);
		random_tree_free(t);
	}
	/* Not by being infinite. */
	assert_true(bounded > TIMES(400) / 4);
}

/* Bounded random trees: walks to their rims stay inside. */
static void test_random_trees_cannot_be_climbed_out_of(void **state)
{
	struct random_stream r = {7};

	(void)state;
	for (unsigned long seed = 1; seed <= TIMES(80); seed++) {
		const struct random_tree_options options = {.seed = seed,
		    .only_soft = true, .max_primitives = 6};
		struct random_tree *t = random_tree_create(&options);
		const struct node *root = random_tree_get(t)->root;
		struct bounds b = bounds_of_node(root);
		struct tape *tape = compile(root);

		for (int face = 0; face < 6; face++)
			gap(tape, &r, &b, face / 2, face % 2 ? 1.0 : -1.0, 1,
			    0.0);
		tape_free(tape);
		random_tree_free(t);
	}
}

/* A child of a warp: off its axis, or along it, or beyond its range. */
static struct node warped_child(struct random_stream *r)
{
	struct node node = primitive_node(random_primitive(r, random_below(r,
	    2), false));

	while (node.primitive.type == PRIMITIVE_PLANE)
		node.primitive = random_primitive(r, true, false);
	node.has_transform = random_below(r, 2);
	node.transform = affine_identity();
	for (int i = 0; i < 3; i++) {
		node.transform.a[i][i] = random_in(r, 0.3, 2.0);
		node.transform.t[i] = random_in(r, -1.0, 1.0);
	}
	return node;
}

static struct warp random_warp(struct random_stream *r, unsigned type)
{
	static const struct vec3 axes[] = {{1.0, 0.0, 0.0}, {0.0, -1.0, 0.0},
	    {0.0, 0.0, 1.0}};
	int axis = random_below(r, 6);
	struct warp w = {.type = type, .center = random_vec3(r, 0.5),
	    .has_range = type != WARP_TWIST || random_below(r, 2)};

	w.axis = axis < 3 ? axes[axis] : random_vec3(r, 1.0);
	w.direction = axis < 3 ? axes[(axis + 1) % 3]
	    : vec3_cross(w.axis, random_vec3(r, 1.0));
	w.from = random_in(r, -1.5, 0.5);
	w.to = w.from + random_in(r, 0.5, 2.5);
	w.rate = type == WARP_BEND ? random_in(r, -1.0, 1.0) * 2.0 * PI /
	    (w.to - w.from) : random_in(r, -4.0, 4.0);
	w.scale = exp2(random_in(r, -2.0, 2.0));
	return w;
}

static void check_warps(unsigned type, int times)
{
	struct random_stream r = {11 + type};

	for (int n = 0; n < times; n++) {
		struct node child = warped_child(&r), *children[] = {&child};
		struct node node = {.type = NODE_WARP, .children = children,
		    .child_count = 1, .warp = random_warp(&r, type)};
		struct bounds b = bounds_of_node(&node);
		struct tape *tape = compile(&node);

		/* A bend leaves nothing of what lies beyond its centre. */
		assert_true(bounds_is_finite(&b) || bounds_is_empty(&b));
		for (int i = 0; i < 200; i++) {
			struct vec3 p = random_vec3(&r, 6.0);

			assert_holds(&b, p, value_at(tape, p),
			    (unsigned long)n);
		}
		for (int face = 0; face < 6; face++)
			gap(tape, &r, &b, face / 2, face % 2 ? 1.0 : -1.0, 2,
			    0.0);
		tape_free(tape);
	}
}

static void test_twists_stay_within_their_boxes(void **state)
{
	(void)state;
	check_warps(WARP_TWIST, TIMES(200));
}

static void test_tapers_stay_within_their_boxes(void **state)
{
	(void)state;
	check_warps(WARP_TAPER, TIMES(200));
}

static void test_bends_stay_within_their_boxes(void **state)
{
	(void)state;
	check_warps(WARP_BEND, TIMES(400));
}

/* Small boxes about the ends of bends of a full turn, where W is mixed. */
static void test_rounded_ends_of_bends_stay_within_their_boxes(void **state)
{
	struct random_stream r = {5};

	(void)state;
	for (int n = 0; n < TIMES(80); n++) {
		struct node child = primitive_node((struct primitive){
		    .type = PRIMITIVE_BOX, .a = {random_in(&r, -1.0, 0.3), 0.0,
		    2.0 * random_below(&r, 2) + random_in(&r, -0.3, 0.3)},
		    .half_size = {0.01, 0.01, random_in(&r, 0.01, 0.1)},
		    .falloff = 1e-3}), *children[] = {&child};
		struct node node = {.type = NODE_WARP, .children = children,
		    .child_count = 1, .warp = {.type = WARP_BEND,
		    .axis = {0.0, 0.0, 1.0}, .direction = {1.0, 0.0, 0.0},
		    .rate = random_in(&r, 0.7, 1.0) * (n % 2 ? PI : -PI),
		    .has_range = true, .to = 2.0}};
		struct bounds b = bounds_of_node(&node);
		struct tape *tape = compile(&node);

		for (int face = 0; face < 6; face++)
			gap(tape, &r, &b, face / 2, face % 2 ? 1.0 : -1.0, 2,
			    0.0);
		tape_free(tape);
	}
}

/* A box of falloff f about the axis from 0 to 4. */
static struct node rod(double f)
{
	return primitive_node((struct primitive){.type = PRIMITIVE_BOX,
	    .a = {0.0, 0.0, 2.0}, .half_size = {0.2 - f, 0.2 - f, 2.0 - f},
	    .falloff = f});
}

static void test_a_bent_rod_has_a_box_near_it(void **state)
{
	struct node child = rod(0.1), *children[] = {&child};
	struct node node = {.type = NODE_WARP, .children = children,
	    .child_count = 1, .warp = {.type = WARP_BEND,
	    .axis = {0.0, 0.0, 1.0}, .direction = {1.0, 0.0, 0.0},
	    .rate = PI / 4.0, .has_range = true, .from = 0.0, .to = 4.0}};
	struct bounds b = bounds_of_node(&node);
	double r = 4.0 / PI;

	(void)state;
	/* Half a turn of radius r. What the rounded ends and the slabs add was
	 * measured as 3.4e-4. */
	assert_near(b.min.x, -0.2, 1e-3);
	assert_near(b.max.x, 2.0 * r + 0.2, 1e-3);
	assert_near(b.min.y, -0.2, 1e-12);
	assert_near(b.max.z, r + 0.2, 1e-3);
	assert_near(b.min.z, 0.0, 1e-3);
}

static void test_a_bend_of_rate_0_changes_nothing(void **state)
{
	struct node child = rod(0.1), *children[] = {&child};
	struct node node = {.type = NODE_WARP, .children = children,
	    .child_count = 1, .warp = {.type = WARP_BEND,
	    .axis = {0.0, 0.0, 1.0}, .direction = {1.0, 0.0, 0.0},
	    .has_range = true, .from = 0.5, .to = 3.0}};

	(void)state;
	assert_box(bounds_of_node(&node), vec3(-0.2, -0.2, 0.0),
	    vec3(0.2, 0.2, 4.0));
	node.warp.rate = 1e-12;
	assert_near(bounds_of_node(&node).max.x, 0.2, 1e-9);
}

static void test_tapers_scale_by_what_the_child_meets(void **state)
{
	struct node child = rod(0.1), *children[] = {&child};
	struct node node = {.type = NODE_WARP, .children = children,
	    .child_count = 1, .warp = {.type = WARP_TAPER,
	    .axis = {0.0, 0.0, 1.0}, .scale = 3.0, .has_range = true,
	    .from = 1.0, .to = 2.0}};

	(void)state;
	assert_box(bounds_of_node(&node), vec3(-0.6, -0.6, 0.0),
	    vec3(0.6, 0.6, 4.0));
	node.warp.from = 5.0;
	node.warp.to = 6.0;
	assert_box(bounds_of_node(&node), vec3(-0.2, -0.2, 0.0),
	    vec3(0.2, 0.2, 4.0));
}

static void test_a_twisted_plane_stays_on_its_side(void **state)
{
	struct node child = primitive_node((struct primitive){
	    .type = PRIMITIVE_PLANE, .normal = {0.0, 0.0, 1.0},
	    .falloff = 0.5}), *children[] = {&child};
	struct node node = {.type = NODE_WARP, .children = children,
	    .child_count = 1, .warp = {.type = WARP_TWIST,
	    .axis = {0.0, 0.0, 1.0}, .rate = 1.0}};
	struct bounds b = bounds_of_node(&node);

	(void)state;
	assert_near(b.max.z, 0.5, 1e-12);
	assert_true(isinf(b.min.z) && isinf(b.max.x) && isinf(b.min.y));
}

static void test_classic_operators_with_a_field_everywhere_have_none(
    void **state)
{
	struct node a = ball(0.0, 1.0), b = ball(2.0, 1.0);
	struct node *children[] = {&a, &b};
	struct node node = composition(NODE_UNION, children, 2);
	const struct classic ricci = {CLASSIC_RICCI, {2.0}};
	/* a0, a1, a2 of Eq. 5: its displacement is everywhere. */
	const struct classic r_blend = {CLASSIC_R_BLEND, {0.5, 1.0, 1.0}};
	struct bounds box;

	(void)state;
	node.sharp = false;
	node.classic = &ricci;
	box = bounds_of_node(&node);
	assert_true(bounds_is_finite(&box));
	node.classic = &r_blend;
	box = bounds_of_node(&node);
	assert_true(isinf(box.min.x) && isinf(box.max.z));
	/* One child: there is nothing to compose. */
	node.child_count = 1;
	box = bounds_of_node(&node);
	assert_true(bounds_is_finite(&box));
}

static void test_volumes_reach_two_spacings_beyond_a_field(void **state)
{
	const size_t count[3] = {4, 5, 6};
	float samples[4 * 5 * 6];
	struct node node = primitive_node((struct primitive){
	    .type = PRIMITIVE_VOLUME});
	struct random_stream r = {3};
	struct tape *tape;
	struct bounds b;

	(void)state;
	for (int i = 0; i < 120; i++)
		samples[i] = 1.0f;
	assert_int_equal(volume_create(samples, count, vec3(-1.0, -1.0, -1.0),
	    vec3(1.0, 1.0, 1.0), false, &node.primitive.volume), ERR_OK);
	b = bounds_of_node(&node);
	assert_box(b, vec3(-1.0 - 4.0 / 3.0, -2.0, -1.8),
	    vec3(1.0 + 4.0 / 3.0, 2.0, 1.8));
	tape = compile(&node);
	for (int i = 0; i < 20000; i++) {
		struct vec3 p = random_vec3(&r, 2.5);

		assert_holds(&b, p, value_at(tape, p), (unsigned long)i);
	}
	tape_free(tape);
	node.primitive.volume->is_distance = true;
	assert_box(bounds_of_node(&node), vec3(-1.0, -1.0, -1.0),
	    vec3(1.0, 1.0, 1.0));
	volume_release(node.primitive.volume);
}

int main(void)
{
	const struct CMUnitTest tests[] = {
		cmocka_unit_test(
		    test_primitives_reach_every_face_of_their_boxes),
		cmocka_unit_test(test_boxes_of_round_shapes_are_tight),
		cmocka_unit_test(
		    test_a_segment_of_two_radii_is_a_frustum_and_half_balls),
		cmocka_unit_test(
		    test_planes_are_bounded_on_one_side_of_an_axis),
		cmocka_unit_test(test_weightless_fields_are_empty),
		cmocka_unit_test(test_compositions_join_and_cut),
		cmocka_unit_test(test_empty_children_add_nothing),
		cmocka_unit_test(test_refs_have_their_targets_boxes),
		cmocka_unit_test(test_random_trees_stay_within_their_boxes),
		cmocka_unit_test(test_random_trees_cannot_be_climbed_out_of),
		cmocka_unit_test(test_twists_stay_within_their_boxes),
		cmocka_unit_test(test_tapers_stay_within_their_boxes),
		cmocka_unit_test(test_bends_stay_within_their_boxes),
		cmocka_unit_test(
		    test_rounded_ends_of_bends_stay_within_their_boxes),
		cmocka_unit_test(test_a_bent_rod_has_a_box_near_it),
		cmocka_unit_test(test_a_bend_of_rate_0_changes_nothing),
		cmocka_unit_test(test_tapers_scale_by_what_the_child_meets),
		cmocka_unit_test(test_a_twisted_plane_stays_on_its_side),
		cmocka_unit_test(
		    test_classic_operators_with_a_field_everywhere_have_none),
		cmocka_unit_test(
		    test_volumes_reach_two_spacings_beyond_a_field),
	};

	return cmocka_run_group_tests(tests, NULL, NULL);
}
