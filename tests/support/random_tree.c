#include "tests/support/random_tree.h"

#include <assert.h>
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "core/classic.h"
#include "core/convolution.h"
#include "core/evaluate.h"
#include "core/table.h"
#include "core/tape.h"
#include "core/tree.h"
#include "core/volume.h"

#define PI 3.14159265358979323846

/* Room for 64 primitives and the compositions, single ones too, above. */
#define NODES_MAX 512

/* A way out through affine maps and warps, the outermost first: a map leads
 * out to each warp's outside, to_last to within the last, or to the world. */
struct way {
	const struct warp *warps[RANDOM_TREE_WARPS_MAX];
	struct affine from[RANDOM_TREE_WARPS_MAX];
	int warp_count;
	struct affine to_last;
};

/* A primitive, and how it lies in the world. */
struct anchor {
	const struct primitive *primitive;
	struct way way;
};

/* Fields on a grid: a smooth one, and a ball's distance. */
enum {
	VOLUME_FIELD,
	VOLUME_BALL,
	VOLUME_KINDS
};

struct random_tree {
	struct random_tree_options options;
	struct random_stream stream;
	struct tree tree;
	struct node nodes[NODES_MAX];
	struct operator operators[NODES_MAX]; /* of each node, if it has one */
	struct classic classics[NODES_MAX];   /* likewise */
	struct volume *volumes[VOLUME_KINDS]; /* NULL until used */
	int warps_open;                       /* above the node being made */
	struct node *children[NODES_MAX];
	char ids[NODES_MAX][16];
	int primitives[NODES_MAX]; /* below each node, refs expanded */
	int finished[NODES_MAX];   /* nodes whose subtree is complete */
	int node_count, child_count, finished_count;
	struct anchor anchors[RANDOM_TREE_PRIMITIVES_MAX];
	int anchor_count;
	struct vec3 least, most; /* of the box that points are taken from */
};

uint64_t random_bits(struct random_stream *r)
{
	uint64_t z = r->state += 0x9e3779b97f4a7c15u;

	z = (z ^ (z >> 30)) * 0xbf58476d1ce4e5b9u;
	z = (z ^ (z >> 27)) * 0x94d049bb133111ebu;
	return z ^ (z >> 31);
}

double random_in(struct random_stream *r, double least, double most)
{
	return least + (most - least) * ((double)(random_bits(r) >> 11) *
	    0x1p-53);
}

int random_below(struct random_stream *r, int count)
{
	return (int)(random_bits(r) % (uint64_t)count);
}

static bool chance(struct random_stream *r, double p)
{
	return random_in(r, 0.0, 1.0) < p;
}

static struct vec3 random_vec3(struct random_stream *r, double reach)
{
	double x = random_in(r, -reach, reach), y = random_in(r, -reach, reach);

	return vec3(x, y, random_in(r, -reach, reach));
}

/* Uniform over directions, by rejection; length in [0.1, 1]. */
static struct vec3 random_direction(struct random_stream *r)
{
	for (;;) {
		struct vec3 v = random_vec3(r, 1.0);
		double norm = vec3_norm(v);

		if (norm > 0.1 && norm <= 1.0)
			return v;
	}
}

struct primitive random_primitive(struct random_stream *r, bool soft,
    bool solid)
{
	int first = soft ? PRIMITIVE_POINT : solid ? PRIMITIVE_SPHERE : 0;
	int last = soft ? PRIMITIVE_CIRCLE : PRIMITIVE_PLANE;
	struct primitive p = {
	    .type = (enum primitive_type)(first + random_below(r,
	    last - first + 1))};

	p.a = random_vec3(r, 0.8);
	p.b = random_vec3(r, 0.8);
	p.c = random_vec3(r, 0.8);
	p.normal = random_direction(r);
	p.half_size = vec3(random_in(r, 0.15, 0.7), random_in(r, 0.15, 0.7),
	    random_in(r, 0.15, 0.7));
	p.rounding = chance(r, 0.5) ? random_in(r, 0.0, 0.14) : 0.0;
	p.radius[0] = random_in(r, 0.15, 0.6);
	p.radius[1] = chance(r, 0.5) ? random_in(r, 0.15, 0.6) : p.radius[0];
	p.major = random_in(r, 0.3, 0.8);
	p.minor = random_in(r, 0.1, 0.29);
	p.exponent = chance(r, 0.6) ? 3.0 : random_in(r, 3.0, 6.0);
	p.weight = chance(r, 0.7) ? 1.0 : random_in(r, 0.5, 2.0);
	p.falloff = random_in(r, 0.1, 0.8);
	return p;
}

/* x^2.5 + y^2.5 = 1, from (0,1) to the diagonal. */
static struct profile sampled_profile(void)
{
	double xy[9][2];
	const char *why;
	int index;
	struct profile p;
	enum err err;

	for (int i = 0; i < 9; i++) {
		xy[i][0] = i / 8.0 * pow(0.5, 0.4);
		xy[i][1] = pow(1.0 - pow(xy[i][0], 2.5), 0.4);
	}
	err = profile_from_samples((const double (*)[2])xy, 9, &p, &why, &index);
	if (err != ERR_OK)
		abort();
	return p;
}

struct profile random_profile_make(enum random_profile profile)
{
	switch (profile) {
	case RANDOM_PROFILE_BULGE:
		return profile_bulge(0.8);
	case RANDOM_PROFILE_BULGE_SLIGHT:
		return profile_bulge(0.3);
	case RANDOM_PROFILE_CIRCLE:
		return profile_circle();
	case RANDOM_PROFILE_SAMPLES:
		return sampled_profile();
	default:
		return profile_smooth();
	}
}

/* Any but a constant one; its intervals are at least 0.1 rad wide. */
static struct opening random_opening(struct random_stream *r)
{
	struct opening o;

	o.alpha[0] = chance(r, 0.3) ? 0.0 : random_in(r, 0.0, 1.0);
	o.alpha[1] = random_in(r, o.alpha[0] + 0.1, PI - 0.2);
	o.alpha[2] = chance(r, 0.3) ? PI : random_in(r, o.alpha[1] + 0.1, PI);
	for (int i = 0; i < 3; i++)
		o.theta[i] = random_in(r, 0.0, PI / 4);
	o.w[0] = random_in(r, 0.5, 3.0);
	o.w[1] = random_in(r, 0.5, 3.0);
	return o;
}

/* clean or blend: no angle; else camel, organic, contact, or a custom one. */
static void set_operator(struct random_tree *t, struct node *node, bool angle)
{
	static const char *const names[] = {"camel", "organic", "contact"};
	struct operator *op = t->operators + (node - t->nodes);
	struct random_stream *r = &t->stream;
	enum random_profile profile = t->options.profile;
	int name = random_below(r, 5);

	node->op = op;
	op->layout = t->options.layout;
	op->resolution = op->layout == LAYOUT_WARPED ? TABLE_RESOLUTION_WARPED
	    : TABLE_RESOLUTION_UNIFORM;
	op->profile = profile_smooth();
	if (!angle) {
		op->opening = opening_constant(chance(r, 0.5) ? PI / 4 : 0.0);
		if (profile != RANDOM_PROFILE_ANY)
			op->profile = random_profile_make(profile);
	} else if (name < 3 && profile == RANDOM_PROFILE_ANY) {
		opening_named(names[name], &op->opening);
		if (name == 2)
			op->profile = profile_bulge(0.8);
	} else {
		op->opening = random_opening(r);
		if (profile == RANDOM_PROFILE_ANY)
			profile = (enum random_profile)(1 +
			    random_below(r, RANDOM_PROFILE_COUNT - 1));
		op->profile = random_profile_make(profile);
	}
}

/* Any that a composition of type may have, with moderate parameters. */
static void set_classic(struct random_tree *t, struct node *node)
{
	struct classic *c = t->classics + (node - t->nodes);
	struct random_stream *r = &t->stream;
	const int family = node->type == NODE_UNION ? CLASSIC_UNION
	    : node->type == NODE_INTERSECTION ? CLASSIC_INTERSECTION
	    : CLASSIC_DIFFERENCE;

	do
		c->type = (unsigned)random_below(r, CLASSIC_TYPE_COUNT);
	while (!classic_has_family(c->type, family));
	switch (c->type) {
	case CLASSIC_SUPER_ELLIPTIC: /* r1, r2, t */
		c->p[0] = random_in(r, 0.3, 1.0);
		c->p[1] = random_in(r, 0.3, 1.0);
		c->p[2] = random_in(r, 2.0, 4.0);
		break;
	case CLASSIC_R_BLEND: /* a0, a1, a2 */
		c->p[0] = random_in(r, -0.3, 0.3);
		c->p[1] = random_in(r, 0.3, 1.0);
		c->p[2] = random_in(r, 0.3, 1.0);
		break;
	case CLASSIC_FUNCTIONAL: /* d */
		c->p[0] = random_in(r, 0.2, 1.0);
		break;
	case CLASSIC_RICCI: /* n */
		c->p[0] = random_in(r, 1.0, 8.0);
		break;
	case CLASSIC_BARTHE_OPENING: /* theta1, theta2 */
		c->p[0] = random_in(r, 0.0, 0.7);
		c->p[1] = random_in(r, 0.0, 0.7);
		break;
	case CLASSIC_INTERPOLATION: /* h */
		c->p[0] = random_in(r, 0.0, 1.0);
		break;
	case CLASSIC_POWER_DIFFERENCE: /* alpha */
		c->p[0] = random_in(r, 1.0, 6.0);
		break;
	}
	node->classic = c;
}

static double random_scale(struct random_stream *r)
{
	double s = exp2(random_in(r, -1.0, 1.0));

	return chance(r, 0.05) ? -s : s;
}

static void set_transform(struct random_tree *t, struct node *node)
{
	struct random_stream *r = &t->stream;
	struct affine shear = affine_identity();
	double shift[3], q[4], s[3];
	struct vec3 axis;
	double angle = random_in(r, 0.0, PI);

	if (t->options.no_transforms || chance(r, 0.65))
		return;
	node->has_transform = true;
	axis = random_direction(r);
	axis = vec3_scale(sin(angle) / vec3_norm(axis), axis);
	q[0] = axis.x;
	q[1] = axis.y;
	q[2] = axis.z;
	q[3] = cos(angle);
	for (int i = 0; i < 3; i++) {
		shift[i] = random_in(r, -0.3, 0.3);
		s[i] = i > 0 && chance(r, 0.3) ? s[0] : random_scale(r);
	}
	node->transform = affine_identity();
	if (chance(r, 0.2))
		memcpy(node->transform.t, shift, sizeof(shift));
	else
		node->transform = affine_from_trs(shift, q, s);
	if (chance(r, 0.2)) {
		/* what only a matrix can say */
		shear.a[0][1] = random_in(r, -0.5, 0.5);
		node->transform = affine_compose(&shear, &node->transform);
	}
}

static struct node *begin_node(struct random_tree *t, enum node_type type)
{
	int i = t->node_count++;
	struct node *node = t->nodes + i;

	assert(i < NODES_MAX);
	snprintf(t->ids[i], sizeof(t->ids[i]), "n%d", i);
	node->id = t->ids[i];
	node->type = type;
	set_transform(t, node);
	if (t->options.whole && !t->options.no_materials &&
	    chance(&t->stream, 0.3)) {
		node->has_color = true;
		node->color = vec3(random_in(&t->stream, 0.0, 1.0),
		    random_in(&t->stream, 0.0, 1.0),
		    random_in(&t->stream, 0.0, 1.0));
	}
	return node;
}

static int *primitives_below(struct random_tree *t, const struct node *node)
{
	return t->primitives + (node - t->nodes);
}

static struct node *finish_node(struct random_tree *t, struct node *node,
    int primitives)
{
	*primitives_below(t, node) = primitives;
	t->finished[t->finished_count++] = (int)(node - t->nodes);
	return node;
}

/* Warps within each other from node down. */
static int warps_below(const struct node *node)
{
	int most = node->type == NODE_REF ? warps_below(node->target) : 0;

	for (size_t i = 0; i < node->child_count; i++) {
		int below = warps_below(node->children[i]);

		most = below > most ? below : most;
	}
	return most + (node->type == NODE_WARP);
}

/* A finished node with no more than budget primitives, or NULL. */
static struct node *random_target(struct random_tree *t, int budget)
{
	struct node *target;

	if (t->finished_count == 0 || t->options.no_refs || t->options.nested)
		return NULL;
	target = t->nodes + t->finished[random_below(&t->stream,
	    t->finished_count)];
	if (t->warps_open + warps_below(target) > RANDOM_TREE_WARPS_MAX)
		return NULL;
	return *primitives_below(t, target) <= budget ? target : NULL;
}

/* Takes count places for node's children. */
static void reserve_children(struct random_tree *t, struct node *node,
    int count)
{
	node->children = t->children + t->child_count;
	node->child_count = (size_t)count;
	t->child_count += count;
}

static void set_child(struct node *node, int i, struct node *child)
{
	child->parent = node;
	child->index = (size_t)i;
	node->children[i] = child;
}

/* One to three elements of one radius and kernel. */
static struct node *random_convolution(struct random_tree *t, int budget)
{
	struct random_stream *r = &t->stream;
	struct node *node = begin_node(t, NODE_CONVOLUTION);
	double radius = random_in(r, 0.15, 0.4);
	double s = cauchy_default_s(radius) * random_in(r, 0.7, 1.5);
	int count = 1 + random_below(r, budget < 3 ? budget : 3);

	reserve_children(t, node, count);
	for (int i = 0; i < count; i++) {
		struct node *child = t->nodes + t->node_count++;

		assert(t->node_count <= NODES_MAX);
		child->type = NODE_PRIMITIVE;
		child->primitive = random_primitive(r, false, false);
		child->primitive.type = (enum primitive_type)(
		    PRIMITIVE_CAUCHY_POINT + random_below(r, 3));
		child->primitive.radius[0] = child->primitive.radius[1] = radius;
		child->primitive.s = s;
		child->primitive.weight = random_in(r, 0.5, 1.5);
		child->primitive.falloff = radius;
		set_child(node, i, child);
	}
	return finish_node(t, node, count);
}

/* x in [-1, 1]^3: a smooth field, 0 on the box; the distance to a ball. */
static double sampled(int kind, double x, double y, double z)
{
	double r = sqrt(x * x + y * y + z * z);

	if (kind == VOLUME_BALL)
		return r - 0.45;
	return fmax(0.0, (1.0 - x * x) * (1.0 - y * y) * (1.0 - z * z)) *
	    (0.8 + 0.3 * sin(3.0 * x + 2.0 * y - z));
}

static struct volume *make_volume(int kind)
{
	static const size_t count[3] = {18, 20, 22};
	static float samples[18 * 20 * 22];
	struct volume *v;
	float *to = samples;

	for (size_t i = 0; i < count[0]; i++)
		for (size_t j = 0; j < count[1]; j++)
			for (size_t k = 0; k < count[2]; k++)
				*to++ = (float)sampled(kind,
				    2.0 * (double)i / 17.0 - 1.0,
				    2.0 * (double)j / 19.0 - 1.0,
				    2.0 * (double)k / 21.0 - 1.0);
	if (volume_create(samples, count, vec3(-1.0, -1.0, -1.0),
	    vec3(1.0, 1.0, 1.0), kind == VOLUME_BALL, &v))
		abort();
	return v;
}

static struct node *random_volume(struct random_tree *t)
{
	struct random_stream *r = &t->stream;
	struct node *node = begin_node(t, NODE_PRIMITIVE);
	int kind = random_below(r, VOLUME_KINDS);
	struct primitive *p = &node->primitive;

	if (!t->volumes[kind])
		t->volumes[kind] = make_volume(kind);
	*p = (struct primitive){.type = PRIMITIVE_VOLUME,
		.volume = t->volumes[kind], .radius = {0.6, 0.6}};
	if (kind == VOLUME_BALL)
		p->falloff = random_in(r, 0.15, 0.4);
	return finish_node(t, node, 1);
}

/* What only the whole language has, or NULL. */
static struct node *random_whole_leaf(struct random_tree *t, int budget)
{
	const struct random_tree_options *o = &t->options;

	if (!o->whole || o->only_soft || o->only_solids)
		return NULL;
	if (!o->no_convolution && chance(&t->stream, 0.12))
		return random_convolution(t, budget);
	if (!o->no_volumes && chance(&t->stream, 0.08))
		return random_volume(t);
	return NULL;
}

static struct node *random_leaf(struct random_tree *t, int budget)
{
	struct node *own = random_whole_leaf(t, budget);
	struct node *target = !own && chance(&t->stream, 0.15)
	    ? random_target(t, budget) : NULL;
	struct node *node;

	if (own)
		return own;
	node = begin_node(t, target ? NODE_REF : NODE_PRIMITIVE);
	if (target) {
		node->target = target;
		return finish_node(t, node, *primitives_below(t, target));
	}
	node->primitive = random_primitive(&t->stream, t->options.only_soft,
	    t->options.only_solids);
	return finish_node(t, node, 1);
}

static struct node *random_node(struct random_tree *t, int budget, int depth,
    int nested);

/* Children that share budget, one of them with nested - 1 below it. */
static int add_children(struct random_tree *t, struct node *node, int count,
    int budget, int depth, int nested)
{
	int deep = nested > 1 ? random_below(&t->stream, count) : -1, used = 0;

	reserve_children(t, node, count);
	for (int i = 0; i < count; i++) {
		int kept = count - 1 - i + (i < deep ? nested - 1 : 0);
		int most = budget - used - kept;
		int below = i == deep ? nested - 1 : nested < 0 ? -1 : 0;
		int share = below > 0 ? most
		    : 1 + random_below(&t->stream, most);
		struct node *child = random_node(t, share, depth - 1, below);

		set_child(node, i, child);
		used += *primitives_below(t, child);
	}
	return used;
}

/* Of lengths and rates that leave space, within about 1.5 of the origin, mostly
 * unfolded. */
static struct warp random_warp(struct random_stream *r)
{
	struct warp w = {.type = (unsigned)random_below(r, WARP_TYPE_COUNT)};
	double sign = chance(r, 0.5) ? -1.0 : 1.0;

	w.axis = random_direction(r);
	do
		w.direction = random_direction(r);
	while (vec3_norm(vec3_cross(w.axis, w.direction)) < 0.05);
	w.center = random_vec3(r, 0.3);
	w.has_range = w.type != WARP_TWIST || chance(r, 0.6);
	w.from = random_in(r, -1.2, -0.3);
	w.to = random_in(r, 0.3, 1.2);
	w.scale = exp2(random_in(r, -1.0, 1.0));
	w.rate = sign * (w.type == WARP_BEND ? random_in(r, 0.1, 0.5)
	    : random_in(r, 0.1, 1.5));
	return w;
}

static struct node *random_warped(struct random_tree *t, int budget, int depth,
    int nested)
{
	struct node *node = begin_node(t, NODE_WARP), *child;

	node->warp = random_warp(&t->stream);
	reserve_children(t, node, 1);
	t->warps_open++;
	child = random_node(t, budget, depth - 1, nested);
	t->warps_open--;
	set_child(node, 0, child);
	return finish_node(t, node, *primitives_below(t, child));
}

static enum node_type random_type(struct random_stream *r, bool angle)
{
	static const enum node_type types[] = {NODE_UNION, NODE_UNION,
	    NODE_INTERSECTION, NODE_DIFFERENCE, NODE_SUM, NODE_RICCI};

	return types[random_below(r, angle ? 4 : 6)];
}

/* nested: as the option, for what is left; -1: any compositions. */
static struct node *random_composition(struct random_tree *t, int budget,
    int depth, int nested)
{
	struct random_stream *r = &t->stream;
	enum node_type type = random_type(r, nested > 0);
	int most = budget < 4 ? budget : 4;
	int count = nested > 0 ? 2 : most < 2 ? 1 : 2 + random_below(r, most - 1);
	struct node *node = begin_node(t, type);
	bool angle = nested > 0 || (nested < 0 && chance(r, 0.75));

	if (type == NODE_RICCI)
		node->n = chance(r, 0.5) ? 2.0 : random_in(r, 1.0, 8.0);
	else if (type != NODE_SUM && nested <= 0 && !t->options.no_sharp &&
	    chance(r, 0.2))
		node->sharp = true;
	else if (type != NODE_SUM && nested <= 0 && t->options.whole &&
	    !t->options.no_classic && chance(r, 0.25))
		set_classic(t, node);
	else if (type != NODE_SUM)
		set_operator(t, node, angle);
	return finish_node(t, node, add_children(t, node, count, budget, depth,
	    nested));
}

static struct node *random_node(struct random_tree *t, int budget, int depth,
    int nested)
{
	bool leaf = budget == 1 ? chance(&t->stream, 0.95)
	    : chance(&t->stream, 0.25);

	if (t->options.whole && !t->options.no_warps && depth > 0 &&
	    t->warps_open < 2 && chance(&t->stream, 0.15))
		return random_warped(t, budget, depth, nested);
	if (nested <= 0 && (depth <= 0 || leaf))
		return random_leaf(t, budget);
	return random_composition(t, budget, depth, nested);
}

/* About where p's field lies, in its own frame. */
static struct vec3 near_primitive(struct random_stream *r,
    const struct primitive *p, double *reach)
{
	double u = random_in(r, 0.0, 1.0), v = random_in(r, 0.0, 1.0 - u);
	struct vec3 ab = vec3_sub(p->b, p->a), ac = vec3_sub(p->c, p->a);
	struct vec3 x = p->a;

	*reach = fmax(p->radius[0], p->radius[1]);
	switch (p->type) {
	case PRIMITIVE_TRIANGLE:
	case PRIMITIVE_CAUCHY_TRIANGLE:
		x = vec3_axpy(u, ab, vec3_axpy(v, ac, x));
		break;
	case PRIMITIVE_SEGMENT:
	case PRIMITIVE_CAUCHY_SEGMENT:
	case PRIMITIVE_CYLINDER:
	case PRIMITIVE_CAPSULE:
	case PRIMITIVE_CONE:
		x = vec3_axpy(u, ab, x);
		break;
	case PRIMITIVE_BOX:
		*reach = vec3_norm(p->half_size);
		break;
	case PRIMITIVE_DISC:
	case PRIMITIVE_CIRCLE:
		*reach += p->major;
		break;
	case PRIMITIVE_TORUS:
		*reach = p->major + p->minor;
		break;
	default:
		break;
	}
	/* 2.2: a support is 1/sqrt(1 - 2^(-1/3)) of a soft radius. */
	*reach = p->type >= PRIMITIVE_SPHERE ? *reach + p->falloff
	    : 2.2 * *reach;
	return x;
}

/* About where w takes x to: the p with W(p) = x, by Newton's iteration. */
static struct vec3 unwarp(const struct warp *w, struct vec3 x)
{
	double params[WARP_PARAMS_MAX];
	struct vec3 p = x;
	struct warp_jet at;

	warp_prepare(w, params);
	for (int i = 0; i < 20; i++) {
		struct affine step = affine_identity(), back;

		warp_eval(w->type, params, p, 1, &at);
		memcpy(step.a, at.jacobian, sizeof(step.a));
		if (!affine_invert(&step, &back))
			break;
		p = vec3_add(p, affine_point(&back, vec3_sub(x, at.point)));
	}
	return vec3_norm(vec3_sub(p, x)) < 10.0 ? p : x;
}

/* x, of the innermost frame, in the world. */
static struct vec3 walk_out(const struct way *way, struct vec3 x)
{
	x = affine_point(&way->to_last, x);
	for (int i = way->warp_count; i-- > 0;)
		x = affine_point(way->from + i, unwarp(way->warps[i], x));
	return x;
}

/* A point in the world near anchor's primitive. */
static struct vec3 near_anchor(struct random_stream *r,
    const struct anchor *anchor)
{
	double reach;
	struct vec3 x = near_primitive(r, anchor->primitive, &reach);
	double s = reach * random_in(r, 0.0, 1.0);

	x = vec3_axpy(s, random_direction(r), x);
	return walk_out(&anchor->way, x);
}

static void enter_warp(struct way *way, const struct warp *warp)
{
	int i = way->warp_count++;

	assert(i < RANDOM_TREE_WARPS_MAX);
	way->warps[i] = warp;
	way->from[i] = way->to_last;
	way->to_last = affine_identity();
}

static void add_anchors(struct random_tree *t, const struct node *node,
    struct way way)
{
	if (node->has_transform)
		way.to_last = affine_compose(&way.to_last, &node->transform);
	if (node->type == NODE_PRIMITIVE)
		t->anchors[t->anchor_count++] = (struct anchor){
		    &node->primitive, way};
	if (node->type == NODE_REF)
		add_anchors(t, node->target, way);
	if (node->type == NODE_WARP)
		enter_warp(&way, &node->warp);
	for (size_t i = 0; i < node->child_count; i++)
		add_anchors(t, node->children[i], way);
}

static void find_box(struct random_tree *t)
{
	t->least = vec3(INFINITY, INFINITY, INFINITY);
	t->most = vec3(-INFINITY, -INFINITY, -INFINITY);
	for (int i = 0; i < 64 * t->anchor_count; i++) {
		struct vec3 p = near_anchor(&t->stream, t->anchors + i / 64);

		t->least = vec3(fmin(p.x, t->least.x), fmin(p.y, t->least.y),
		    fmin(p.z, t->least.z));
		t->most = vec3(fmax(p.x, t->most.x), fmax(p.y, t->most.y),
		    fmax(p.z, t->most.z));
	}
}

struct random_tree *random_tree_create(const struct random_tree_options *o)
{
	struct random_tree *t = calloc(1, sizeof(*t));

	if (!t)
		abort();
	t->options = *o;
	t->stream.state = o->seed;
	if (t->options.max_primitives == 0)
		t->options.max_primitives = 40;
	if (t->options.max_depth == 0)
		t->options.max_depth = 6;
	assert(t->options.max_primitives <= RANDOM_TREE_PRIMITIVES_MAX);
	assert(t->options.max_primitives > o->nested);
	t->tree.root = t->options.max_primitives == 1 ? random_leaf(t, 1)
	    : random_composition(t, t->options.max_primitives,
	    t->options.max_depth, o->nested ? o->nested : -1);
	t->tree.null_gradient = TREE_NULL_GRADIENT;
	add_anchors(t, t->tree.root,
	    (struct way){.to_last = affine_identity()});
	find_box(t);
	return t;
}

void random_tree_free(struct random_tree *t)
{
	for (int i = 0; t && i < VOLUME_KINDS; i++)
		volume_release(t->volumes[i]);
	free(t);
}

const struct tree *random_tree_get(const struct random_tree *t)
{
	return &t->tree;
}

static double value_at(const struct tape *tape, struct vec3 p)
{
	struct jet jet;

	evaluate(tape, p, 0, &jet);
	return jet.value;
}

static struct vec3 near_any(const struct random_tree *t,
    struct random_stream *r)
{
	return near_anchor(r, t->anchors + random_below(r, t->anchor_count));
}

/* Whether one of a few tries near primitives has a value above level. */
static bool find_above(const struct random_tree *t, const struct tape *tape,
    struct random_stream *r, double level, struct vec3 *out)
{
	for (int i = 0; i < 8; i++) {
		*out = near_any(t, r);
		if (value_at(tape, *out) > level)
			return true;
	}
	return false;
}

/* Within about a hundredth of a random chord of the iso-surface. */
static struct vec3 near_surface(const struct random_tree *t,
    const struct tape *tape, struct random_stream *r)
{
	struct vec3 inside, outside, middle;

	if (!find_above(t, tape, r, 0.5, &inside))
		return inside;
	outside = near_any(t, r);
	for (int i = 0; i < 6; i++) {
		middle = vec3_scale(0.5, vec3_add(inside, outside));
		if (value_at(tape, middle) > 0.5)
			inside = middle;
		else
			outside = middle;
	}
	return vec3_axpy(random_in(r, 0.0, 1.0), vec3_sub(outside, inside),
	    inside);
}

void random_tree_points(const struct random_tree *t, const struct tape *tape,
    uint64_t seed, size_t count, float *xyz)
{
	struct random_stream r = {seed};

	for (size_t i = 0; i < count; i++) {
		struct vec3 p;

		if (i % 4 == 0)
			p = vec3(random_in(&r, t->least.x, t->most.x),
			    random_in(&r, t->least.y, t->most.y),
			    random_in(&r, t->least.z, t->most.z));
		else if (i % 4 == 1)
			p = near_any(t, &r);
		else if (i % 4 == 2)
			find_above(t, tape, &r, 0.0, &p);
		else
			p = near_surface(t, tape, &r);
		xyz[3 * i] = (float)p.x;
		xyz[3 * i + 1] = (float)p.y;
		xyz[3 * i + 2] = (float)p.z;
	}
}
