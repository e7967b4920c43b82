/*
 * Points and trees made to break an evaluator: a million of them, half of the
 * whole language, for every output. Nothing but finite numbers may come back,
 * no field below 0, no colour but a mix of colours, no normal but a unit
 * vector or 0.
 */
#include <float.h>
#include <math.h>
#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include <cmocka.h>

#include "core/classic.h"
#include "core/convolution.h"
#include "core/evaluate.h"
#include "core/output.h"
#include "core/table.h"
#include "core/tape.h"
#include "core/tree.h"
#include "core/volume.h"
#include "kernels/device_internal.h"
#include "tests/support/random_tree.h"

#define TREES 250
#define POINTS 2000
#define CHILDREN_MAX 4
#define OPERATORS 12
#define ROW OUTPUT_ROW_MAX
#define WARPS_MAX 8

static struct device *device;
static struct operator operators[OPERATORS];
static int slots[OPERATORS];

/* A tree of two levels, warps between, with its nodes within. */
struct hostile {
	bool whole; /* of all of the language */
	struct tree tree;
	struct node nodes[1 + CHILDREN_MAX * (1 + CHILDREN_MAX) + WARPS_MAX];
	struct node *children[1 + CHILDREN_MAX][CHILDREN_MAX];
	struct node *warped[WARPS_MAX];
	struct classic classics[1 + CHILDREN_MAX];
	struct volume *volume; /* NULL until used */
	double scale;          /* of the volume */
	int count, warp_count, classic_count;
};

static double pick(struct random_stream *r, const double *from, int count)
{
	return from[random_below(r, count)];
}

/* Scales from one end of what a tree may hold to the other. */
static double random_scale(struct random_stream *r)
{
	static const double scales[] = {1e-9, 1e-6, 1e-3, 1.0, 1.0, 1.0, 1e3,
		1e6, 1e8};

	return pick(r, scales, 9);
}

static struct vec3 scaled(double s, struct vec3 v)
{
	return vec3_scale(s, v);
}

/* A random primitive at a scale, sometimes heavier than 1 or of no weight. */
static struct primitive hostile_primitive(struct random_stream *r, double s)
{
	static const double weights[] = {1.0, 1.0, 1.0, 3.0, 1e3, 0.0, 1e-6};
	static const double exponents[] = {3.0, 3.0, 3.5, 4.0, 16.0, 17.0, 64.0};
	struct primitive p = random_primitive(r, false, false);

	p.a = scaled(s, p.a);
	p.b = scaled(s, p.b);
	p.c = scaled(s, p.c);
	p.half_size = scaled(s, p.half_size);
	p.rounding *= s;
	p.radius[0] *= s;
	p.radius[1] *= s;
	p.major *= s;
	p.minor *= s;
	p.falloff *= s;
	p.weight = pick(r, weights, 7);
	p.exponent = pick(r, exponents, 7);
	return p;
}

/* Samples without pattern, which no distances have, over a cube. */
static struct volume *hostile_volume(struct random_stream *r, double s)
{
	static const double values[] = {0.0, 0.0, 0.5, 1.0, 1e-6, 1e6};
	const size_t count[3] = {4, 5, 6};
	bool distance = random_below(r, 2);
	float samples[4 * 5 * 6];
	struct volume *v = NULL;

	for (int i = 0; i < 4 * 5 * 6; i++)
		samples[i] = (float)(distance ? s * random_in(r, -1.0, 2.0) :
		    pick(r, values, 6));
	assert_int_equal(volume_create(samples, count, vec3(-s, -s, -s),
	    vec3(s, s, s), distance, &v), ERR_OK);
	return v;
}

/* Makes of p an element of a convolution, or a volume. */
static void make_whole(struct random_stream *r, struct hostile *h, double s,
    struct primitive *p)
{
	static const double widths[] = {1e-2, 1.0, 1.0, 1e2};

	if (random_below(r, 3)) {
		p->type = (enum primitive_type)(PRIMITIVE_CAUCHY_POINT +
		    random_below(r, 3));
		p->s = cauchy_default_s(p->radius[0]) * pick(r, widths, 4);
		return;
	}
	if (!h->volume) {
		h->volume = hostile_volume(r, s);
		h->scale = s;
	}
	p->type = PRIMITIVE_VOLUME;
	p->volume = h->volume;
	p->falloff = h->volume->is_distance ? 0.3 * h->scale : 0.0;
}

/* An operator without angles, at the ends of what its parameters may be. */
static const struct classic *make_classic(struct random_stream *r,
    struct hostile *h, enum node_type type)
{
	static const double ends[CLASSIC_TYPE_COUNT][3][2] = {
		[CLASSIC_SUPER_ELLIPTIC] = {{0.2, 1.0}, {0.2, 1.0}, {1.0, 8.0}},
		[CLASSIC_R_BLEND] = {{-10.0, 10.0}, {0.01, 100.0},
			{0.01, 100.0}},
		[CLASSIC_FUNCTIONAL] = {{0.001, 2.0}},
		[CLASSIC_RICCI] = {{1.0, 1000.0}},
		[CLASSIC_BARTHE_OPENING] = {{0.0, 0.785398}, {0.0, 0.785398}},
		[CLASSIC_INTERPOLATION] = {{0.0, 1.0}},
		[CLASSIC_POWER_DIFFERENCE] = {{1.0, 100.0}},
	};
	const int family = type == NODE_UNION ? CLASSIC_UNION :
	    type == NODE_INTERSECTION ? CLASSIC_INTERSECTION :
	    CLASSIC_DIFFERENCE;
	struct classic *c = h->classics + h->classic_count++;

	do
		c->type = (unsigned)random_below(r, CLASSIC_TYPE_COUNT);
	while (!classic_has_family(c->type, family));
	for (int k = 0; k < 3; k++) {
		const double *end = ends[c->type][k];

		c->p[k] = random_below(r, 3) ? end[random_below(r, 2)] :
		    random_in(r, end[0], end[1]);
	}
	return c;
}

/* A warp by little or by far too much, of a range about the origin. */
static struct warp hostile_warp(struct random_stream *r, double s)
{
	static const double rates[] = {0.0, 1e-9, 0.1, 1.0, 3.0, 1e3, 1e9};
	static const double factors[] = {1e-3, 1e-3, 0.5, 1.0, 2.0, 1e3, 1e3};
	struct warp w = {.type = (unsigned)random_below(r, WARP_TYPE_COUNT)};

	w.axis = vec3(random_in(r, -1.0, 1.0), random_in(r, -1.0, 1.0), 1.0);
	w.direction = vec3(1.0, random_in(r, -1.0, 1.0), 0.0);
	w.center = scaled(s, w.direction);
	w.has_range = w.type != WARP_TWIST || random_below(r, 2);
	w.from = s * random_in(r, -1.0, 0.5);
	w.to = w.from + s * (random_below(r, 4) ? random_in(r, 0.1, 1.0) : 1.0);
	w.scale = pick(r, factors, 7);
	w.rate = fmin(pick(r, rates, 7) / s, 1e9);
	if (w.type == WARP_BEND) /* to a full turn */
		w.rate = fmin(w.rate, 6.28 / (w.to - w.from));
	if (random_below(r, 2))
		w.rate = -w.rate;
	return w;
}

static struct node *new_node(struct hostile *h, enum node_type type,
    struct node *parent, size_t index)
{
	struct node *n = h->nodes + h->count++;

	*n = (struct node){.type = type, .parent = parent, .index = index};
	return n;
}

/* A composition of any kind over the children array given. */
static void make_composition(struct random_stream *r, struct hostile *h,
    struct node *n, struct node **children)
{
	static const enum node_type types[] = {NODE_UNION, NODE_UNION,
		NODE_INTERSECTION, NODE_DIFFERENCE, NODE_SUM, NODE_RICCI};
	static const double powers[] = {1.0, 2.0, 7.5, 100.0};
	int family;

	n->type = types[random_below(r, 6)];
	n->children = children;
	n->n = pick(r, powers, 4);
	n->sharp = random_below(r, 8) == 0;
	if (h->whole && n->type <= NODE_DIFFERENCE && !n->sharp &&
	    random_below(r, 2)) {
		n->classic = make_classic(r, h, n->type);
		return;
	}
	family = n->type == NODE_UNION ? FAMILY_UNION : FAMILY_INTERSECTION;
	do
		n->op = operators + random_below(r, OPERATORS);
	while (n->op->family != (enum operator_family)family);
}

/* Half of the transforms shear, mirror or stretch by a lot. */
static void make_transform(struct random_stream *r, struct node *n)
{
	static const double stretches[] = {-1.0, 1.0, 1e-3, 1e3, 0.5};
	const double t[3] = {0.0, 0.0, 0.0};
	double q[4], s[3], norm = 0.0;

	if (random_below(r, 3))
		return;
	for (int k = 0; k < 4; k++) {
		q[k] = random_in(r, -1.0, 1.0);
		norm += q[k] * q[k];
	}
	for (int k = 0; k < 4; k++)
		q[k] /= sqrt(norm);
	for (int k = 0; k < 3; k++)
		s[k] = pick(r, stretches, 5);
	n->has_transform = true;
	n->transform = affine_from_trs(t, q, s);
}

/* Children of one composition: some are copies, so that fields coincide and
 * the angles between them are 0, and mirror images, where it is pi. */
static void make_leaves(struct random_stream *r, struct hostile *h,
    struct node *parent, double scale)
{
	struct primitive last = hostile_primitive(r, scale);

	parent->child_count = (size_t)(2 + random_below(r, CHILDREN_MAX - 1));
	for (size_t i = 0; i < parent->child_count; i++) {
		struct node *n = new_node(h, NODE_PRIMITIVE, parent, i);

		if (random_below(r, 3)) {
			last = hostile_primitive(r, scale);
			if (h->whole && random_below(r, 3) == 0)
				make_whole(r, h, scale, &last);
		}
		n->primitive = last;
		if (h->whole && random_below(r, 2)) {
			n->has_color = true;
			n->color = vec3(random_in(r, 0.0, 1.0), 0.0, 1.0);
		}
		make_transform(r, n);
		parent->children[i] = n;
	}
}

/* Child i of the root: n, or, of the whole language, n within warps. */
static void add_child(struct random_stream *r, struct hostile *h,
    struct node *root, size_t i, struct node *n, double scale)
{
	struct node **place = root->children + i, *parent = root;

	while (h->whole && h->warp_count < WARPS_MAX && random_below(r, 2)) {
		struct node *warp = new_node(h, NODE_WARP, parent, i);

		warp->warp = hostile_warp(r, scale);
		warp->children = h->warped + h->warp_count++;
		warp->child_count = 1;
		*place = warp;
		place = warp->children;
		parent = warp;
		i = 0;
	}
	n->parent = parent;
	n->index = i;
	*place = n;
}

static void make_hostile(uint64_t seed, bool whole, struct hostile *h)
{
	struct random_stream r = {seed};
	double scale = random_scale(&r);
	struct node *root;

	memset(h, 0, sizeof(*h));
	h->whole = whole;
	root = new_node(h, NODE_UNION, NULL, 0);
	h->tree = (struct tree){.root = root, .null_gradient = TREE_NULL_GRADIENT};
	make_composition(&r, h, root, h->children[0]);
	root->child_count = (size_t)(2 + random_below(&r, 2));
	for (size_t i = 0; i < root->child_count; i++) {
		struct node *n = new_node(h, NODE_UNION, root, i);

		make_composition(&r, h, n, h->children[1 + i]);
		make_leaves(&r, h, n, random_below(&r, 4) ? scale :
		    random_scale(&r));
		add_child(&r, h, root, i, n, scale);
	}
}

/* A point of a primitive that matters: a centre, an axis, an end. */
static struct vec3 anchor(struct random_stream *r, const struct primitive *p)
{
	struct vec3 mid = vec3_scale(0.5, vec3_add(p->a, p->b));

	switch (random_below(r, 6)) {
	case 0:
		return p->b;
	case 1:
		return p->c;
	case 2:
		return mid;
	case 3:
		return vec3_add(p->a, p->half_size);
	default:
		return p->a;
	}
}

static double random_sign(struct random_stream *r)
{
	return random_below(r, 2) ? 1.0 : -1.0;
}

/* Offsets along axes at the lengths where something happens, and next to. */
static double offset(struct random_stream *r, const struct primitive *p)
{
	const double lengths[] = {0.0, 0.0, p->radius[0], p->radius[1],
		p->major, p->minor, p->falloff, p->half_size.x, p->rounding,
		/* the support of exponent 3 */
		p->radius[0] / sqrt(1.0 - pow(0.5, 1.0 / 3.0)),
		1e-30, 1e-12, 1e-3};
	static const double nudges[] = {1.0, 1.0, 1.0 + 1e-6, 1.0 - 1e-6};

	return random_sign(r) * pick(r, lengths, 13) * pick(r, nudges, 4);
}

static struct vec3 far_point(struct random_stream *r)
{
	static const double far[] = {3e38, -3e38, 1e30, 1e20, -1e15, 1e12, 1e10,
		0.0, 1.0, 1e-38, 1e-45};

	return vec3(pick(r, far, 11), pick(r, far, 11), pick(r, far, 11));
}

static void make_points(uint64_t seed, const struct hostile *h, float *xyz)
{
	struct random_stream r = {~seed};

	for (int i = 0; i < POINTS; i++) {
		const struct node *n = h->nodes + random_below(&r, h->count);
		struct vec3 p = far_point(&r);

		if (n->type == NODE_PRIMITIVE && random_below(&r, 8)) {
			const struct primitive *q = &n->primitive;

			p = vec3_add(anchor(&r, q), vec3(offset(&r, q),
			    offset(&r, q), offset(&r, q)));
			if (n->has_transform)
				p = affine_point(&n->transform, p);
		}
		xyz[3 * i] = (float)fmax(-FLT_MAX, fmin(FLT_MAX, p.x));
		xyz[3 * i + 1] = (float)fmax(-FLT_MAX, fmin(FLT_MAX, p.y));
		xyz[3 * i + 2] = (float)fmax(-FLT_MAX, fmin(FLT_MAX, p.z));
	}
}

static struct operator make_operator(int i)
{
	static const char *const openings[] = {"camel", "organic", "contact"};
	struct operator op = {.layout = LAYOUT_WARPED, .resolution = 16};
	bool found = true;

	op.family = i < OPERATORS / 2 ? FAMILY_UNION : FAMILY_INTERSECTION;
	op.profile = i % 3 == 0 ? profile_smooth() : i % 3 == 1 ?
	    profile_bulge(0.95) : profile_circle();
	switch (i % (OPERATORS / 2)) {
	case 0:
		op.opening = opening_constant(0.0);
		break;
	case 1:
		op.opening = opening_constant(atan(1.0));
		break;
	case 2:
		/* Jumps at both ends, and the steepest of slopes between. */
		op.opening = (struct opening){{1.5, 1.5, 1.6},
			{atan(1.0), 0.0, atan(1.0)}, {8.0, 8.0}};
		break;
	default:
		found = opening_named(openings[i % 3], &op.opening);
		break;
	}
	assert_true(found);
	return op;
}

static int setup(void **state)
{
	struct device_options options = {0};
	struct device_failure failure = {0};
	struct table *table;

	(void)state;
	assert_int_equal(device_open(&options, &device, &failure), ERR_OK);
	for (int i = 0; i < OPERATORS; i++) {
		operators[i] = make_operator(i);
		assert_int_equal(table_create(operators[i].family,
		    &operators[i].profile, LAYOUT_WARPED, 16, &table), ERR_OK);
		table_build(table, 0, 16);
		assert_int_equal(device_load_table(device, table, slots + i),
		    ERR_OK);
		table_free(table);
	}
	return 0;
}

static int teardown(void **state)
{
	(void)state;
	device_close(device);
	return 0;
}

static int slot_of(const struct operator *op)
{
	for (int i = 0; i < OPERATORS; i++)
		if (op->family == operators[i].family &&
		    profile_equal(&op->profile, &operators[i].profile))
			return slots[i];
	fail();
	return -1;
}

/* What one tree's rows add up to. */
struct tally {
	size_t trees, numbers, broken, extreme, negative, colors, normals;
	size_t culled; /* rows that are others where the tape is culled */
	double most_gradient, most_hessian;
};

static bool is_color(const float *c)
{
	return c[0] >= 0.0f && c[0] <= 1.0f && c[1] >= 0.0f && c[1] <= 1.0f &&
	    c[2] >= 0.0f && c[2] <= 1.0f;
}

static bool is_normal(const float *n)
{
	double norm = vec3_norm(vec3(n[0], n[1], n[2]));

	return norm == 0.0 || fabs(norm - 1.0) < 1e-6;
}

static void add_row(const float *row, struct tally *t)
{
	t->negative += !(row[0] >= 0.0f);
	t->colors += !is_color(row + 10);
	t->normals += !is_normal(row + 13);
	for (int k = 0; k < ROW; k++) {
		double x = fabs((double)row[k]);

		t->numbers++;
		t->broken += !isfinite(row[k]);
		t->extreme += x >= FLT_MAX;
		if (k > 0 && k < 4)
			t->most_gradient = fmax(t->most_gradient, x);
		else if (k >= 4 && k < 10)
			t->most_hessian = fmax(t->most_hessian, x);
	}
}

/* The same, culled and in two parts that go together; without colours, of which
 * nothing is culled. rows: with them. */
static void run_culled(struct device_tape *t, const float *xyz,
    const float *rows, struct tally *tally)
{
	static float got[POINTS * ROW];
	unsigned outputs = OUTPUT_ALL & ~OUTPUT_COLOR;
	const size_t stride = (size_t)output_row_floats(outputs);
	const struct device_part parts[2] = {{xyz, 777, got},
		{xyz + 3 * 777, POINTS - 777, got + 777 * stride}};

	device->culling = DEVICE_CULLING_ALWAYS;
	assert_int_equal(device_evaluate_parts(device, t, parts, 2, outputs),
	    ERR_OK);
	device->culling = DEVICE_CULLING_PAYS;
	for (size_t i = 0; i < POINTS; i++) {
		const float *row = got + i * stride;
		float all[ROW];

		memcpy(all, row, 10 * sizeof(*all));
		memcpy(all + 10, rows + i * ROW + 10, 3 * sizeof(*all));
		memcpy(all + 13, row + 10, 5 * sizeof(*all));
		add_row(all, tally);
		tally->culled += memcmp(all, rows + i * ROW, sizeof(all)) != 0;
	}
}

/* False if the tree is beyond what tape_compile accepts. */
static bool run(uint64_t seed, const struct hostile *h, struct tally *t)
{
	static float xyz[POINTS * 3], rows[POINTS * ROW];
	int of[1 + 4 * (1 + CHILDREN_MAX)];
	struct device_tape *loaded;
	struct tape_error error;
	struct tape *tape;
	enum err err = tape_compile(&h->tree, 100, &tape, &error);

	if (err == ERR_INVALID)
		return false;
	assert_int_equal(err, ERR_OK);
	for (size_t i = 0; i < tape->operator_count; i++)
		of[i] = slot_of(tape->operators + i);
	assert_int_equal(device_load_tape(device, tape, of, &loaded), ERR_OK);
	make_points(seed, h, xyz);
	assert_int_equal(device_evaluate(device, loaded, xyz, POINTS,
	    OUTPUT_ALL, rows, NULL, NULL), ERR_OK);
	for (size_t i = 0; i < POINTS; i++)
		add_row(rows + i * ROW, t);
	run_culled(loaded, xyz, rows, t);
	t->trees++;
	device_drop_tape(device, loaded);
	tape_free(tape);
	return true;
}

static void run_trees(bool whole)
{
	struct tally t = {0};
	struct hostile *h = malloc(sizeof(*h));
	uint64_t seed = 0;

	assert_non_null(h);
	while (t.trees < TREES) {
		assert_true(seed < 20 * TREES);
		make_hostile(++seed, whole, h);
		run(seed, h, &t);
		volume_release(h->volume);
	}
	free(h);
	printf("measured: %zu points of %zu trees (of %d made): %zu not finite, "
	    "%zu at the limit of float32, %zu fields under 0; gradients to "
	    "%.1e, Hessians to %.1e\n", t.numbers / ROW, t.trees, (int)seed,
	    t.broken, t.extreme, t.negative, t.most_gradient, t.most_hessian);
	printf("measured: %zu rows differ where the tape is culled\n",
	    t.culled);
	assert_int_equal(t.culled, 0);
	assert_true(t.numbers >= 500000u * ROW);
	assert_int_equal(t.broken, 0);
	assert_int_equal(t.negative, 0);
	assert_int_equal(t.colors, 0);
	assert_int_equal(t.normals, 0);
	/* The last clamp of all is not needed for any of these. */
	assert_int_equal(t.extreme, 0);
}

static void test_adversarial_half_a_million_points_are_finite(void **state)
{
	(void)state;
	run_trees(false);
}

static void test_adversarial_whole_language_is_finite(void **state)
{
	(void)state;
	run_trees(true);
}

int main(void)
{
	const struct CMUnitTest tests[] = {
		cmocka_unit_test(
		    test_adversarial_half_a_million_points_are_finite),
		cmocka_unit_test(test_adversarial_whole_language_is_finite),
	};

	return cmocka_run_group_tests(tests, setup, teardown);
}
