/*
 * Boxes are found bottom up by interval arithmetic on each coordinate. Each
 * step's own rounding, and the evaluator's, is covered by widening.
 */
#include "core/bounds.h"

#include <stddef.h>

#include "core/classic.h"
#include "core/operator.h"
#include "core/tree.h"
#include "core/volume.h"

/* Widens every bound by this times the numbers that it is made of: some 20
 * roundings. */
#define ROUNDING 4e-15

/* As struct bounds, for loops; every empty one is `nothing`. */
struct box {
	double least[3], most[3];
};

static const struct box everything = {
	{-INFINITY, -INFINITY, -INFINITY}, {INFINITY, INFINITY, INFINITY}};
static const struct box nothing = {
	{INFINITY, INFINITY, INFINITY}, {-INFINITY, -INFINITY, -INFINITY}};

static bool is_nothing(const struct box *b)
{
	return !(b->least[0] <= b->most[0] && b->least[1] <= b->most[1] &&
	    b->least[2] <= b->most[2]);
}

static struct box hull(const struct box *a, const struct box *b)
{
	struct box out;

	for (int i = 0; i < 3; i++) {
		out.least[i] = fmin(a->least[i], b->least[i]);
		out.most[i] = fmax(a->most[i], b->most[i]);
	}
	return out;
}

static struct box meet(const struct box *a, const struct box *b)
{
	struct box out;

	for (int i = 0; i < 3; i++) {
		out.least[i] = fmax(a->least[i], b->least[i]);
		out.most[i] = fmin(a->most[i], b->most[i]);
	}
	return is_nothing(&out) ? nothing : out;
}

/* ---- primitives ---- */

/* c - below to c + above, each rounded outwards. */
static struct box about(const double *c, const double *below,
    const double *above)
{
	struct box out;

	for (int i = 0; i < 3; i++) {
		out.least[i] = c[i] - below[i] -
		    ROUNDING * (fabs(c[i]) + below[i]);
		out.most[i] = c[i] + above[i] +
		    ROUNDING * (fabs(c[i]) + above[i]);
	}
	return out;
}

static struct box about_evenly(const double *c, double reach)
{
	const double by[3] = {reach, reach, reach};

	return about(c, by, by);
}

/*
 * Half the box of a disc across the unit vector u, grown by a ball: radius
 * sqrt(1 - u_i^2) + grow, with 1 - u_i^2 from the other two components, which
 * are exact where u is all but an axis.
 */
static void disc_reach(const double *u, double radius, double grow,
    double out[static 3])
{
	for (int i = 0; i < 3; i++) {
		double j = u[(i + 1) % 3], k = u[(i + 2) % 3];

		out[i] = radius * sqrt(j * j + k * k) + grow;
	}
}

static void along(const double *a, const double *u, double t,
    double out[static 3])
{
	for (int i = 0; i < 3; i++)
		out[i] = a[i] + t * u[i];
}

static double support(double inv_r2)
{
	return 1.0 / sqrt(inv_r2);
}

static struct box point_box(const double *p)
{
	return about_evenly(p, support(p[3]));
}

/* The end of a segment's support at c: a disc, and the half of a ball that
 * lies on outward's side of it. */
static struct box end_box(const double *c, const double *u, double outward,
    double radius)
{
	double across[3], below[3], above[3];

	disc_reach(u, radius, 0.0, across);
	for (int i = 0; i < 3; i++) {
		below[i] = outward * u[i] <= 0.0 ? radius : across[i];
		above[i] = outward * u[i] >= 0.0 ? radius : across[i];
	}
	return about(c, below, above);
}

/*
 * The radius goes with the foot of the perpendicular, so that between the ends
 * the support is a frustum, whose box is that of its two discs.
 */
static struct box segment_box(const double *p)
{
	struct box a = end_box(p, p + 3, -1.0, p[7]), b;
	double end[3];

	along(p, p + 3, p[6], end);
	b = end_box(end, p + 3, 1.0, p[7] + p[8] * p[6]);
	return hull(&a, &b);
}

static struct box triangle_box(const double *p)
{
	double r = support(p[9]);
	struct box a = about_evenly(p, r), b = about_evenly(p + 3, r);
	struct box c = about_evenly(p + 6, r), ab = hull(&a, &b);

	return hull(&ab, &c);
}

/* A circle's, and so a disc's. */
static struct box ring_box(const double *p)
{
	double reach[3];

	disc_reach(p + 3, p[6], support(p[7]), reach);
	return about(p, reach, reach);
}

static struct box sphere_box(const double *p)
{
	return about_evenly(p, p[3] + 1.0 / p[4]);
}

static struct box box_box(const double *p)
{
	double reach[3];

	for (int i = 0; i < 3; i++)
		reach[i] = p[3 + i] + p[6] + 1.0 / p[7];
	return about(p, reach, reach);
}

static struct box cylinder_box(const double *p)
{
	double reach[3];

	disc_reach(p + 3, p[7], 1.0 / p[8], reach);
	for (int i = 0; i < 3; i++)
		reach[i] += p[6] * fabs(p[3 + i]);
	return about(p, reach, reach);
}

static struct box capsule_box(const double *p)
{
	double end[3], reach = p[7] + 1.0 / p[8];
	struct box a = about_evenly(p, reach), b;

	along(p, p + 3, p[6], end);
	b = about_evenly(end, reach);
	return hull(&a, &b);
}

static struct box cone_box(const double *p)
{
	double end[3], reach[3];
	struct box a, b;

	disc_reach(p + 3, p[7], 1.0 / p[9], reach);
	a = about(p, reach, reach);
	along(p, p + 3, p[6], end);
	disc_reach(p + 3, p[8], 1.0 / p[9], reach);
	b = about(end, reach, reach);
	return hull(&a, &b);
}

static struct box torus_box(const double *p)
{
	double reach[3];

	disc_reach(p + 3, p[6], p[7] + 1.0 / p[8], reach);
	return about(p, reach, reach);
}

/* Bounded on one side if its normal is an axis. */
static struct box plane_box(const double *p)
{
	struct box out = everything, side = about_evenly(p, 1.0 / p[6]);
	const double *u = p + 3;

	for (int i = 0; i < 3; i++) {
		if (u[(i + 1) % 3] != 0.0 || u[(i + 2) % 3] != 0.0)
			continue;
		if (u[i] > 0.0)
			out.most[i] = side.most[i];
		else
			out.least[i] = side.least[i];
	}
	return out;
}

static struct box (*const shapes[PRIMITIVE_COUNT])(const double *params) = {
	[PRIMITIVE_POINT] = point_box,
	[PRIMITIVE_SEGMENT] = segment_box,
	[PRIMITIVE_TRIANGLE] = triangle_box,
	[PRIMITIVE_DISC] = ring_box,
	[PRIMITIVE_CIRCLE] = ring_box,
	[PRIMITIVE_SPHERE] = sphere_box,
	[PRIMITIVE_BOX] = box_box,
	[PRIMITIVE_CYLINDER] = cylinder_box,
	[PRIMITIVE_CAPSULE] = capsule_box,
	[PRIMITIVE_CONE] = cone_box,
	[PRIMITIVE_TORUS] = torus_box,
	[PRIMITIVE_PLANE] = plane_box,
};

/* The samples' box, and two spacings about it if they are a field's. */
static struct box volume_box(const struct volume *v)
{
	const double least[3] = {v->min.x, v->min.y, v->min.z};
	const double most[3] = {v->max.x, v->max.y, v->max.z};
	struct box out;

	for (int i = 0; i < 3; i++) {
		double margin = v->is_distance ? 0.0 : 2.0 *
		    (most[i] - least[i]) / (double)(v->count[i] - 1);

		margin += ROUNDING * (fabs(least[i]) + fabs(most[i]) + margin);
		out.least[i] = least[i] - margin;
		out.most[i] = most[i] + margin;
	}
	return out;
}

static struct box primitive_box(const struct primitive *p)
{
	double params[PRIMITIVE_PARAMS_MAX];

	if (p->type == PRIMITIVE_VOLUME)
		return volume_box(p->volume);
	if (shapes[p->type] == NULL)
		return everything;
	if (p->type <= PRIMITIVE_CIRCLE && p->weight == 0.0)
		return nothing;
	primitive_prepare(p, params);
	return shapes[p->type](params);
}

/* ---- transforms ---- */

/* b's image under m: each coordinate is linear in each of b's. */
static struct box map(const struct affine *m, const struct box *b)
{
	struct box out;

	if (is_nothing(b))
		return nothing;
	for (int i = 0; i < 3; i++) {
		double least = m->t[i], most = m->t[i];
		double below = fabs(m->t[i]), above = below;

		for (int j = 0; j < 3; j++) {
			double a = m->a[i][j];
			double from = a >= 0.0 ? b->least[j] : b->most[j];
			double to = a >= 0.0 ? b->most[j] : b->least[j];

			if (a == 0.0)
				continue; /* also of what is infinite */
			least += a * from;
			most += a * to;
			below += fabs(a * from);
			above += fabs(a * to);
		}
		out.least[i] = least - ROUNDING * below;
		out.most[i] = most + ROUNDING * above;
	}
	return out;
}

/* ---- compositions ---- */

/* Whether node's classic operator is 0 where both of its operands are. */
static bool keeps_zero(const struct node *node)
{
	int family = node->type == NODE_UNION ? CLASSIC_UNION
	    : node->type == NODE_INTERSECTION ? CLASSIC_INTERSECTION
	    : CLASSIC_DIFFERENCE;
	double params[CLASSIC_PARAMS_MAX];
	struct operator_jet g;

	classic_prepare(node->classic, family, params);
	classic_eval(node->classic->type, params, 0.0, 0.0, 0, &g);
	return !(g.g > 0.0);
}

static struct box node_box(const struct node *node);

static struct box fold(const struct node *node,
    struct box (*pair)(const struct box *a, const struct box *b))
{
	struct box out = node_box(node->children[0]);

	for (size_t i = 1; i < node->child_count; i++) {
		struct box next = node_box(node->children[i]);

		out = pair(&out, &next);
	}
	return out;
}

/* Of whose fields only that about them is known: 0 of 0 and 0, or not. */
static struct box classic_box(const struct node *node)
{
	if (node->child_count > 1 && !keeps_zero(node))
		return everything;
	if (node->classic->type == CLASSIC_POWER_DIFFERENCE)
		return node_box(node->children[0]);
	return fold(node, hull);
}

static struct box composition_box(const struct node *node)
{
	if (node->classic != NULL)
		return classic_box(node);
	if (node->type == NODE_INTERSECTION)
		return fold(node, meet);
	if (node->type == NODE_DIFFERENCE)
		return node_box(node->children[0]);
	return fold(node, hull);
}

/* ---- warps: the box of what W takes into the child's box ---- */

struct span {
	double least, most;
};

static struct span span_of(double a, double b)
{
	return (struct span){fmin(a, b), fmax(a, b)};
}

static struct span span_with(struct span s, double x)
{
	return (struct span){fmin(s.least, x), fmax(s.most, x)};
}

/* Of numbers that are finite. */
static struct span span_product(struct span a, struct span b)
{
	struct span out = span_of(a.least * b.least, a.most * b.most);

	out = span_with(out, a.least * b.most);
	return span_with(out, a.most * b.least);
}

/* Scaled by least and by most, both positive; infinite ends stay so. */
static struct span span_scaled(struct span s, double least, double most)
{
	return (struct span){s.least * (s.least < 0.0 ? most : least),
	    s.most * (s.most > 0.0 ? most : least)};
}

/* A box in a warp's own coordinates: along e1, e2 and the axis. */
struct warp_box {
	struct span x, y, z;
};

/* From the warp's coordinates to its frame: origin at the range's start. A
 * bend's e1 is where it bends to. Exact for axes of the frame. */
static struct affine warp_frame(const struct warp *w)
{
	struct vec3 u = vec3_unit(w->axis), across = w->direction, e1, e2, o;

	if (w->type != WARP_BEND)
		across = fabs(u.x) <= fabs(u.y) && fabs(u.x) <= fabs(u.z)
		    ? vec3(1.0, 0.0, 0.0) : fabs(u.y) <= fabs(u.z)
		    ? vec3(0.0, 1.0, 0.0) : vec3(0.0, 0.0, 1.0);
	across = vec3_unit(across);
	for (int i = 0; i < 2; i++) /* twice, against rounding */
		across = vec3_unit(vec3_axpy(-vec3_dot(u, across), u, across));
	e1 = across;
	e2 = vec3_cross(u, e1);
	o = vec3_axpy(w->has_range || w->type != WARP_TWIST ? w->from : 0.0, u,
	    w->center);
	return (struct affine){
	    .a = {{e1.x, e2.x, u.x}, {e1.y, e2.y, u.y}, {e1.z, e2.z, u.z}},
	    .t = {o.x, o.y, o.z}};
}

/* Turned by any angle: the cylinder about the axis. */
static void twist_box(const struct warp *w, struct warp_box *b)
{
	double x = fmax(fabs(b->x.least), fabs(b->x.most));
	double y = fmax(fabs(b->y.least), fabs(b->y.most));
	double radius = hypot(x, y);

	(void)w;
	b->x = b->y = (struct span){-radius, radius};
}

/* The factor of the cross-section at z from the range's start; monotonic. */
static double taper_factor(const struct warp *w, double z)
{
	double length = w->to - w->from, params[WARP_PARAMS_MAX];
	struct warp plain = {.type = WARP_TAPER, .axis = {0.0, 0.0, 1.0},
	    .to = length, .scale = w->scale};
	struct warp_jet jet;

	/* Beyond the rounded ends it is constant. */
	z = fmax(-length, fmin(2.0 * length, z));
	warp_prepare(&plain, params);
	warp_eval(WARP_TAPER, params, vec3(1.0, 0.0, z), 0, &jet);
	return 1.0 / jet.point.x;
}

static void taper_box(const struct warp *w, struct warp_box *b)
{
	struct span k = span_of(taper_factor(w, b->z.least),
	    taper_factor(w, b->z.most));

	b->x = span_scaled(b->x, k.least, k.most);
	b->y = span_scaled(b->y, k.least, k.most);
}

/*
 * A bend seen from the arc's start: the point at (x, y) off the axis and along
 * it goes to (X, Z) = (x cos(ky) + V(y), (1 - kx) S(y)) as long as it is on the
 * arc, S(y) = sin(ky)/k, V(y) = (1 - cos(ky))/k and 1 - kx >= 0; beyond the
 * end at y = L it goes straight on. Over an eighth of the range's length L at
 * either side of an end W itself is mixed of the two (core/warp.c), w of the
 * straight one: with r the distance from the centre over 1/|k|, e the end, d
 * the arc's length from it and q = 1 - w (1 - cos(kd)),
 *   x = (1 - r q)/k,   y - e = ((1 - w) + w r sinc(kd)) d,
 * so that r and d are known within what w and q may be.
 */
#define BEND_MIXED (0.5 * WARP_ROUNDED)

/* Above this angle of the mixed piece no bound is sought: the whole bend's is
 * then 11 rad, more than the turn that documents may have. */
#define BEND_MIXED_MAX 1.4

/* A piece's boxes are found slab by slab: so many at most, and so many of a
 * radian's turn. */
#define BEND_SLABS 16
#define BEND_SLABS_RADIAN 40.0

#define PI 3.14159265358979323846

static double sinc(double x)
{
	return fabs(x) < 1e-4 ? 1.0 - x * x / 6.0 : sin(x) / x;
}

static double versine(double k, double y)
{
	return 0.5 * k * y * y * sinc(0.5 * k * y) * sinc(0.5 * k * y);
}

/* Whether s holds phase + 2 pi n for some n. */
static bool passes(struct span s, double phase)
{
	return floor((s.most - phase) / (2.0 * PI)) >=
	    ceil((s.least - phase) / (2.0 * PI));
}

/* Grows a box in (X, Z) by another. */
static void grow(struct warp_box *b, struct span x, struct span z)
{
	b->x.least = fmin(b->x.least, x.least);
	b->x.most = fmax(b->x.most, x.most);
	b->z.least = fmin(b->z.least, z.least);
	b->z.most = fmax(b->z.most, z.most);
}

/* One slab of the arc, at y along it and x off it; r = 1 - kx. */
static void bend_slab(double k, struct span y, struct span x, struct span r,
    struct warp_box *out)
{
	struct span angle = span_of(k * y.least, k * y.most);
	struct span c = span_of(cos(angle.least), cos(angle.most));
	struct span s = span_of(y.least * sinc(k * y.least),
	    y.most * sinc(k * y.most));
	struct span v = span_of(versine(k, y.least), versine(k, y.most));
	struct span off;

	if (passes(angle, 0.0)) {
		c = span_with(c, 1.0);
		v = span_with(v, 0.0);
	}
	if (passes(angle, PI)) {
		c = span_with(c, -1.0);
		v = span_with(v, 2.0 / k);
	}
	if (passes(angle, 0.5 * PI))
		s = span_with(s, 1.0 / k);
	if (passes(angle, -0.5 * PI))
		s = span_with(s, -1.0 / k);
	off = span_product(x, c);
	grow(out, (struct span){off.least + v.least, off.most + v.most},
	    span_product(r, s));
}

/* A piece of the arc over y, at most half a turn from its middle; what would
 * lie beyond its centre is nowhere. */
static void bend_piece(double k, double length, struct span y, struct span x,
    struct warp_box *out)
{
	double turn = PI / fabs(k);
	struct span r;

	y.least = fmax(y.least, 0.5 * length - turn);
	y.most = fmin(y.most, 0.5 * length + turn);
	if (k > 0.0)
		x.most = fmin(x.most, 1.0 / k);
	else if (k < 0.0)
		x.least = fmax(x.least, 1.0 / k);
	if (!(y.least <= y.most && x.least <= x.most))
		return;
	r = span_of(fmax(0.0, 1.0 - k * x.least), fmax(0.0, 1.0 - k * x.most));
	bend_slab(k, y, x, r, out);
}

static int slab_count(double k, struct span s)
{
	double count = ceil(fabs(k) * (s.most - s.least) * BEND_SLABS_RADIAN);

	return (int)fmax(1.0, fmin(count, BEND_SLABS));
}

/* Slab i of count of s. */
static struct span slab(struct span s, int i, int count)
{
	double step = (s.most - s.least) / count;

	return (struct span){s.least + i * step, i + 1 < count ?
	    s.least + (i + 1) * step : s.most};
}

/* What is on the arc, and on nothing else. */
static void bend_arc(double k, double length, const struct warp_box *b,
    struct warp_box *out)
{
	struct span y = {fmax(b->z.least, BEND_MIXED * length),
	    fmin(b->z.most, (1.0 - BEND_MIXED) * length)};
	int count = y.least <= y.most ? slab_count(k, y) : 0;

	for (int i = 0; i < count; i++)
		bend_piece(k, length, slab(y, i, count), b->x, out);
}

/* w at d beyond the end, in lengths of the mixed piece's half. */
static double mixed_share(double d)
{
	double t = fmax(0.0, fmin(1.0, 0.5 * (d + 1.0)));

	return t * t * t * (t * (6.0 * t - 15.0) + 10.0);
}

/* The slab of the mixed piece about end, 0 or L, at d from it. */
static void bend_mixed_slab(double k, double length, double end,
    struct span d, const struct warp_box *b, struct warp_box *out)
{
	double reach = BEND_MIXED * length;
	double far = fmax(fabs(d.least), fabs(d.most));
	double w = mixed_share((end > 0.0 ? d.most : -d.least) / reach);
	double q = 1.0 - w * k * versine(k, far), past = w * versine(k, far);
	struct span x = b->x;

	/* (1 - r)/k at r = (1 - kx)/q */
	if (k > 0.0)
		x.least = fmin(x.least, (x.least - past) / q);
	else
		x.most = fmax(x.most, (x.most - past) / q);
	bend_piece(k, length, (struct span){end + d.least, end + d.most}, x,
	    out);
}

static void bend_mixed(double k, double length, double end,
    const struct warp_box *b, struct warp_box *out)
{
	double reach = BEND_MIXED * length, angle = k * reach;
	double r0 = 1.0 - k * b->x.least, r1 = 1.0 - k * b->x.most;
	double most = fmax(1.0, fmax(r0, r1) / cos(angle));
	double least = fmax(1e-9, fmin(1.0, fmin(r0, r1) * sinc(angle)));
	struct span d = {b->z.least - end, b->z.most - end};
	int count;

	/* y - e is d times a factor in [least, most] */
	d.least = fmax(d.least / (d.least < 0.0 ? least : most), -reach);
	d.most = fmin(d.most / (d.most > 0.0 ? least : most), reach);
	count = d.least <= d.most ? slab_count(k, d) : 0;
	for (int i = 0; i < count; i++)
		bend_mixed_slab(k, length, end, slab(d, i, count), b, out);
}

/* Beyond the end at L, turned by kL, where it goes straight on. */
static void bend_straight(double k, double length, const struct warp_box *b,
    struct warp_box *out)
{
	double c = cos(k * length), s = sin(k * length);
	double x = versine(k, length), z = length * sinc(k * length);
	struct span y = {fmax(b->z.least, length) - length,
	    b->z.most - length};

	if (!(y.least <= y.most))
		return;
	for (int i = 0; i < 4; i++) {
		double off = i & 1 ? b->x.least : b->x.most;
		double on = i & 2 ? y.least : y.most;
		double at_x = x + c * off + s * on, at_z = z + c * on - s * off;

		grow(out, span_of(at_x, at_x), span_of(at_z, at_z));
	}
}

static void bend_box(const struct warp *w, struct warp_box *b)
{
	double k = w->rate, length = w->to - w->from;
	double size = fmax(fabs(b->x.least), fabs(b->x.most)) + length +
	    fmax(fabs(b->z.least), fabs(b->z.most));
	struct warp_box out = {{INFINITY, -INFINITY}, b->y,
	    {INFINITY, -INFINITY}};

	if (!isfinite(size) || fabs(k * length) * BEND_MIXED > BEND_MIXED_MAX) {
		b->x = b->z = (struct span){-INFINITY, INFINITY};
		return;
	}
	if (b->z.least <= 0.0)
		grow(&out, b->x, (struct span){b->z.least,
		    fmin(b->z.most, 0.0)});
	bend_mixed(k, length, 0.0, b, &out);
	bend_arc(k, length, b, &out);
	bend_mixed(k, length, length, b, &out);
	bend_straight(k, length, b, &out);
	*b = out;
	b->x.least -= ROUNDING * size;
	b->x.most += ROUNDING * size;
	b->z.least -= ROUNDING * size;
	b->z.most += ROUNDING * size;
}

/* What W takes into b, in the frame of the warp. */
static struct box warped(const struct warp *w, const struct box *child)
{
	static void (*const types[WARP_TYPE_COUNT])(const struct warp *w,
	    struct warp_box *b) = {
		[WARP_TWIST] = twist_box, [WARP_TAPER] = taper_box,
		[WARP_BEND] = bend_box,
	};
	struct affine frame = warp_frame(w), inverse = frame;
	struct box b = *child;
	struct warp_box own;

	if (is_nothing(&b) || !affine_invert(&frame, &inverse))
		return b;
	b = map(&inverse, &b);
	own = (struct warp_box){{b.least[0], b.most[0]},
	    {b.least[1], b.most[1]}, {b.least[2], b.most[2]}};
	types[w->type](w, &own);
	b = (struct box){{own.x.least, own.y.least, own.z.least},
	    {own.x.most, own.y.most, own.z.most}};
	return map(&frame, &b);
}

static struct box warp_box(const struct node *node)
{
	struct box b = node_box(node->children[0]);

	return warped(&node->warp, &b);
}

/* ---- nodes ---- */

/* In node's parent's frame. */
static struct box node_box(const struct node *node)
{
	struct box b;

	if (node->type == NODE_PRIMITIVE)
		b = primitive_box(&node->primitive);
	else if (node->type == NODE_REF)
		b = node_box(node->target);
	else if (node->type == NODE_WARP)
		b = warp_box(node);
	else
		b = composition_box(node);
	return node->has_transform ? map(&node->transform, &b) : b;
}

static struct bounds bounds_of(const struct box *b)
{
	return (struct bounds){{b->least[0], b->least[1], b->least[2]},
	    {b->most[0], b->most[1], b->most[2]}};
}

static struct box box_of(const struct bounds *b)
{
	const struct box out = {{b->min.x, b->min.y, b->min.z},
	    {b->max.x, b->max.y, b->max.z}};

	return is_nothing(&out) ? nothing : out;
}

struct bounds bounds_of_node(const struct node *node)
{
	struct box b = node_box(node);

	return bounds_of(&b);
}

struct bounds bounds_of_primitive(const struct primitive *p)
{
	struct box b = primitive_box(p);

	return bounds_of(&b);
}

struct bounds bounds_map(const struct affine *m, const struct bounds *b)
{
	struct box in = box_of(b), out = map(m, &in);

	return bounds_of(&out);
}

struct bounds bounds_unwarp(const struct warp *w, const struct bounds *b)
{
	struct box in = box_of(b), out = warped(w, &in);

	return bounds_of(&out);
}

bool bounds_is_empty(const struct bounds *b)
{
	return !(b->min.x <= b->max.x && b->min.y <= b->max.y &&
	    b->min.z <= b->max.z);
}

bool bounds_is_finite(const struct bounds *b)
{
	return isfinite(b->min.x) && isfinite(b->min.y) &&
	    isfinite(b->min.z) && isfinite(b->max.x) && isfinite(b->max.y) &&
	    isfinite(b->max.z);
}
