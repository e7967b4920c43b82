#include "core/primitive.h"

#include <assert.h>
#include <math.h>
#include <stdbool.h>
#include <stddef.h>

#include "core/convolution.h"
#include "core/volume.h"

/*
 * A segment's radius that changes along it enters the derivatives as
 * R'/R, 1/length; held under this, so that no float32 square overflows.
 */
#define STEEPEST 1e12

/* Below this ratio of |ab x ac| to |ab| |ac| a triangle is its three edges. */
#define SLIVER 1e-6

/* A shape's size counts as at least this in the guard of its axis. */
#define LEAST_SIZE 1e-9

static double dmax(double a, double b)
{
	return a > b ? a : b;
}

static double dmin(double a, double b)
{
	return a < b ? a : b;
}

static double clamp(double x, double least, double most)
{
	return dmin(dmax(x, least), most);
}

/* v / |v|, or 0. */
static struct vec3 unit(struct vec3 v)
{
	double norm = vec3_norm(v);

	return vec3_scale(norm > 0.0 ? 1.0 / norm : 0.0, v);
}

/* I - v v^T */
static struct sym3 across(struct vec3 v)
{
	return sym3_axpy(-1.0, sym3_square(v), sym3_identity(1.0));
}

/*
 * Soft objects. Each finds S = d^2/R^2 with derivatives; soft() makes
 * f = weight (1 - S)^n of it.
 */
static void soft(const struct jet *s, double n, double weight, int order,
    struct jet *out)
{
	double b = 1.0 - s->value;
	double p, f1, f2;

	if (!(b > 0.0))
		return;
	p = weight * exp((n - 2.0) * log1p(-s->value));
	out->value = p * b * b;
	if (order < 1)
		return;
	f1 = -n * p * b;
	out->gradient = vec3_scale(f1, s->gradient);
	if (order < 2)
		return;
	f2 = n * (n - 1.0) * p;
	out->hessian = sym3_axpy(f2, sym3_square(s->gradient),
	    sym3_scale(f1, s->hessian));
}

static void point(const double *p, struct vec3 x, int order, struct jet *out)
{
	struct vec3 e = vec3_sub(x, vec3_get(p));
	double inv_r2 = p[3];
	struct jet s = {
	    .value = vec3_dot(e, e) * inv_r2,
	    .gradient = vec3_scale(2.0 * inv_r2, e),
	    .hessian = sym3_identity(2.0 * inv_r2)};

	soft(&s, p[4], p[5], order, out);
}

static void segment(const double *p, struct vec3 x, int order, struct jet *out)
{
	struct vec3 u = vec3_get(p + 3), e = vec3_sub(x, vec3_get(p));
	double along = vec3_dot(u, e);
	bool between = along > 0.0 && along < p[6];
	double t = clamp(along, 0.0, p[6]);
	/* The far end's radius may be lost in rounding, but not to 0. */
	double r = dmax(p[7] + p[8] * t, 1e-15 * p[7]);
	double inv_r2 = 1.0 / (r * r);
	double k = between ? clamp(p[8] / r, -STEEPEST, STEEPEST) : 0.0;
	struct jet s;

	e = vec3_axpy(-t, u, e);
	s.value = vec3_dot(e, e) * inv_r2;
	s.gradient = vec3_axpy(-2.0 * s.value * k, u,
	    vec3_scale(2.0 * inv_r2, e));
	s.hessian = sym3_identity(2.0 * inv_r2);
	/* S = |e|^2/R^2 with de/dx = I - u u^T, dR/dx = R k u */
	s.hessian = sym3_axpy(6.0 * s.value * k * k -
	    (between ? 2.0 * inv_r2 : 0.0), sym3_square(u), s.hessian);
	s.hessian = sym3_axpy(-4.0 * k * inv_r2, sym3_product(e, u), s.hessian);
	soft(&s, p[9], p[10], order, out);
}

/*
 * From a triangle's nearest point to x: e. The Hessian of |e|^2/2 is
 * along v v^T + isotropic I.
 */
struct foot {
	struct vec3 e, v;
	double along, isotropic;
};

static struct foot edge_foot(struct vec3 a, struct vec3 b, struct vec3 x)
{
	struct vec3 ab = vec3_sub(b, a), u = unit(ab), e = vec3_sub(x, a);
	double length = vec3_norm(ab), along = vec3_dot(u, e);
	bool between = along > 0.0 && along < length;

	e = vec3_axpy(-clamp(along, 0.0, length), u, e);
	return (struct foot){e, u, between ? -1.0 : 0.0, 1.0};
}

/* Whether x lies over the triangle, on the inner side of every edge. */
static bool over(const struct vec3 corner[static 3], struct vec3 n,
    struct vec3 x)
{
	for (int i = 0; i < 3; i++) {
		struct vec3 a = corner[i], b = corner[(i + 1) % 3];
		struct vec3 inward = vec3_cross(n, vec3_sub(b, a));

		if (!(vec3_dot(inward, vec3_sub(x, a)) > 0.0))
			return false;
	}
	return true;
}

static struct foot triangle_foot(const struct vec3 corner[static 3],
    struct vec3 x)
{
	struct vec3 n = vec3_cross(unit(vec3_sub(corner[1], corner[0])),
	    unit(vec3_sub(corner[2], corner[0])));
	struct foot best;

	if (vec3_norm(n) > SLIVER && over(corner, n, x)) {
		n = unit(n);
		return (struct foot){vec3_scale(vec3_dot(n,
		    vec3_sub(x, corner[0])), n), n, 1.0, 0.0};
	}
	best = edge_foot(corner[0], corner[1], x);
	for (int i = 1; i < 3; i++) {
		struct foot foot = edge_foot(corner[i], corner[(i + 1) % 3], x);

		if (vec3_dot(foot.e, foot.e) < vec3_dot(best.e, best.e))
			best = foot;
	}
	return best;
}

static void triangle(const double *p, struct vec3 x, int order,
    struct jet *out)
{
	struct vec3 corner[3] = {vec3_get(p), vec3_get(p + 3), vec3_get(p + 6)};
	struct foot foot = triangle_foot(corner, x);
	double inv_r2 = p[9];
	struct jet s = {
	    .value = vec3_dot(foot.e, foot.e) * inv_r2,
	    .gradient = vec3_scale(2.0 * inv_r2, foot.e),
	    .hessian = sym3_scale(2.0 * inv_r2, sym3_axpy(foot.along,
		sym3_square(foot.v), sym3_identity(foot.isotropic)))};

	soft(&s, p[10], p[11], order, out);
}

/*
 * Shapes of revolution. A point's coordinates about the axis: z along u, rho
 * away from it along the unit vector e (0 on the axis itself).
 */
struct cylindrical {
	double rho, z;
	double inv_rho; /* bounded: AXIS_GUARD */
	struct vec3 e, u;
};

/* size: the radius to which AXIS_GUARD is relative. */
static struct cylindrical about_axis(struct vec3 c, struct vec3 u,
    struct vec3 x, double size)
{
	struct vec3 d = vec3_sub(x, c);
	double z = vec3_dot(u, d);
	struct vec3 radial = vec3_axpy(-z, u, d);
	double rho = vec3_norm(radial);
	double guard = AXIS_GUARD * dmax(size, LEAST_SIZE);

	return (struct cylindrical){rho, z, 1.0 / dmax(rho, guard),
	    unit(radial), u};
}

/* A function of (rho, z) with its derivatives, and d/drho over rho. */
struct planar {
	double value;
	double r, z;
	double rr, rz, zz;
	double r_over_rho;
};

/*
 * The function in space: grad = f_r e + f_z u,
 * H = f_rr ee^T + f_rz (ue^T + eu^T) + f_zz uu^T + f_r/rho (I - uu^T - ee^T).
 */
static struct jet revolve(const struct planar *f, const struct cylindrical *c)
{
	struct jet out = {.value = f->value};

	out.gradient = vec3_axpy(f->r, c->e, vec3_scale(f->z, c->u));
	out.hessian = sym3_identity(f->r_over_rho);
	out.hessian = sym3_axpy(f->rr - f->r_over_rho, sym3_square(c->e),
	    out.hessian);
	out.hessian = sym3_axpy(f->zz - f->r_over_rho, sym3_square(c->u),
	    out.hessian);
	out.hessian = sym3_axpy(f->rz, sym3_product(c->e, c->u), out.hessian);
	return out;
}

/* S of a skeleton point at distance a from the axis, as seen in (rho, z). */
static struct jet ring(double a, bool radial, double inv_r2,
    const struct cylindrical *c)
{
	struct planar s = {
	    .value = (a * a + c->z * c->z) * inv_r2,
	    .r = 2.0 * inv_r2 * a,
	    .z = 2.0 * inv_r2 * c->z,
	    .rr = radial ? 2.0 * inv_r2 : 0.0,
	    .zz = 2.0 * inv_r2,
	    .r_over_rho = 2.0 * inv_r2 * a * c->inv_rho};

	return revolve(&s, c);
}

static void disc(const double *p, struct vec3 x, int order, struct jet *out)
{
	struct cylindrical c = about_axis(vec3_get(p), vec3_get(p + 3), x,
	    p[6]);
	bool beyond = c.rho > p[6];
	struct jet s = ring(beyond ? c.rho - p[6] : 0.0, beyond, p[7], &c);

	soft(&s, p[8], p[9], order, out);
}

static void circle(const double *p, struct vec3 x, int order, struct jet *out)
{
	struct cylindrical c = about_axis(vec3_get(p), vec3_get(p + 3), x,
	    p[6]);
	struct jet s = ring(c.rho - p[6], true, p[7], &c);

	soft(&s, p[8], p[9], order, out);
}

/*
 * Solids. Each finds the signed distance with derivatives; this makes
 * f(t) = 1/2 - 15/16 t + 5/8 t^3 - 3/16 t^5 of it, t = distance/falloff, in
 * the factored form (1-t)^3 (8 + 9t + 3t^2) / 16.
 */
void primitive_solid(const struct jet *d, double inv_fall, int order,
    struct jet *out)
{
	double t = clamp(d->value * inv_fall, -1.0, 1.0);
	double w = 1.0 - t, flat = w * (1.0 + t);
	double f1, f2;

	out->value = w * w * w * (8.0 + t * (9.0 + 3.0 * t)) / 16.0;
	if (order < 1 || flat == 0.0)
		return;
	f1 = -15.0 / 16.0 * flat * flat * inv_fall;
	out->gradient = vec3_scale(f1, d->gradient);
	if (order < 2)
		return;
	f2 = 15.0 / 4.0 * t * flat * inv_fall * inv_fall;
	out->hessian = sym3_axpy(f2, sym3_square(d->gradient),
	    sym3_scale(f1, d->hessian));
}

/* Distance |e| less radius; size bounds 1/|e| in the Hessian. */
static struct jet round_distance(struct vec3 e, double radius, double size)
{
	double length = vec3_norm(e);
	struct vec3 g = unit(e);

	return (struct jet){length - radius, g,
	    sym3_scale(1.0 / dmax(length, AXIS_GUARD * size), across(g))};
}

static void sphere(const double *p, struct vec3 x, int order, struct jet *out)
{
	struct jet d = round_distance(vec3_sub(x, vec3_get(p)), p[3], p[3]);

	primitive_solid(&d, p[4], order, out);
}

static void capsule(const double *p, struct vec3 x, int order, struct jet *out)
{
	struct vec3 u = vec3_get(p + 3), e = vec3_sub(x, vec3_get(p));
	double along = vec3_dot(u, e), length = p[6], radius = p[7], rho;
	bool between = along > 0.0 && along < length;
	struct jet d;

	e = vec3_axpy(-clamp(along, 0.0, length), u, e);
	d = round_distance(e, radius, radius);
	if (between) {
		rho = dmax(vec3_norm(e), AXIS_GUARD * radius);
		d.hessian = sym3_axpy(-1.0 / rho, sym3_square(u), d.hessian);
	}
	primitive_solid(&d, p[8], order, out);
}

static double sign(double x)
{
	return x < 0.0 ? -1.0 : 1.0;
}

/* Inside: the nearest face's distance, the largest of q. */
static struct jet box_inside(struct vec3 q, struct vec3 side)
{
	if (q.x >= q.y && q.x >= q.z)
		return (struct jet){.value = q.x, .gradient = {side.x, 0.0, 0.0}};
	if (q.y >= q.z)
		return (struct jet){.value = q.y, .gradient = {0.0, side.y, 0.0}};
	return (struct jet){.value = q.z, .gradient = {0.0, 0.0, side.z}};
}

/*
 * Outside: |o|, o the positive parts of q. With g = o/|o| and k the third
 * axis, H_ii = (g_j^2 + g_k^2)/|o|, or 0 where o_i = 0; H_ij = -g_i g_j/|o|.
 * This form is exactly 0 off a face.
 */
static struct jet box_outside(struct vec3 o, struct vec3 side, double guard)
{
	double length = vec3_norm(o);
	double inv = 1.0 / dmax(length, guard);
	struct vec3 g = unit(o);
	struct jet d = {.value = length};

	d.gradient = vec3(g.x * side.x, g.y * side.y, g.z * side.z);
	d.hessian = sym3_scale(-inv, sym3_square(d.gradient));
	d.hessian.xx = o.x > 0.0 ? inv * (g.y * g.y + g.z * g.z) : 0.0;
	d.hessian.yy = o.y > 0.0 ? inv * (g.x * g.x + g.z * g.z) : 0.0;
	d.hessian.zz = o.z > 0.0 ? inv * (g.x * g.x + g.y * g.y) : 0.0;
	return d;
}

static void box(const double *p, struct vec3 x, int order, struct jet *out)
{
	struct vec3 d = vec3_sub(x, vec3_get(p));
	struct vec3 q = vec3(fabs(d.x) - p[3], fabs(d.y) - p[4],
	    fabs(d.z) - p[5]);
	struct vec3 o = vec3(dmax(q.x, 0.0), dmax(q.y, 0.0), dmax(q.z, 0.0));
	struct vec3 side = vec3(sign(d.x), sign(d.y), sign(d.z));
	struct jet distance = vec3_norm(o) > 0.0 ?
	    box_outside(o, side, AXIS_GUARD / p[7]) : box_inside(q, side);

	distance.value -= p[6];
	primitive_solid(&distance, p[7], order, out);
}

/*
 * Distance to a point of the half-plane at radius v from the axis, from (a, z)
 * beside it. guard bounds 1/distance in the second derivatives.
 */
static struct planar corner_distance(double a, double z, double v,
    double guard, const struct cylindrical *c)
{
	double length = sqrt(a * a + z * z);
	double inv = 1.0 / dmax(length, guard);
	double r = length > 0.0 ? a / length : 0.0;
	double s = length > 0.0 ? z / length : 0.0;

	/* f_r/rho = (rho - v)/(rho length), also right at v = 0 on the axis */
	return (struct planar){length, r, s, inv * s * s, -inv * r * s,
	    inv * r * r, inv * (1.0 - v * c->inv_rho)};
}

/* Distance to a straight line of the half-plane, outward normal (r, z). */
static struct planar line_distance(double distance, double r, double z,
    const struct cylindrical *c)
{
	return (struct planar){.value = distance, .r = r, .z = z,
	    .r_over_rho = r * c->inv_rho};
}

static void cylinder(const double *p, struct vec3 x, int order,
    struct jet *out)
{
	struct cylindrical c = about_axis(vec3_get(p), vec3_get(p + 3), x,
	    p[7]);
	double side = sign(c.z), q = c.rho - p[7], w = fabs(c.z) - p[6];
	struct planar f;
	struct jet d;

	if (q > 0.0 && w > 0.0)
		f = corner_distance(q, w * side, p[7], AXIS_GUARD / p[8], &c);
	else if (q >= w)
		f = line_distance(q, 1.0, 0.0, &c);
	else
		f = line_distance(w, 0.0, side, &c);
	d = revolve(&f, &c);
	primitive_solid(&d, p[8], order, out);
}

/*
 * Signed distance to the cone's profile: a convex polygon with corners (0,0),
 * (ra,0), (rb,length), (0,length), of which the edge on the axis is no border.
 */
static struct planar cone_profile(double length, double ra, double rb,
    double guard, const struct cylindrical *c)
{
	double slant = sqrt(length * length + (ra - rb) * (ra - rb));
	/* The side's direction (m, h); its outward normal is (h, -m). */
	double m = slant > 0.0 ? (rb - ra) / slant : 0.0;
	double h = slant > 0.0 ? length / slant : 1.0;
	double a = c->rho - ra, over_top = c->z - length;
	double off = h * a - m * c->z, along = m * a + h * c->z;
	bool inside = off <= 0.0 && c->z >= 0.0 && over_top <= 0.0;

	if (inside ? off >= -c->z && off >= over_top :
	    off > 0.0 && along >= 0.0 && along <= slant)
		return line_distance(off, h, -m, c);
	if (inside ? -c->z >= over_top : c->z < 0.0 && c->rho < ra)
		return line_distance(-c->z, 0.0, -1.0, c);
	if (inside || (over_top > 0.0 && c->rho < rb))
		return line_distance(over_top, 0.0, 1.0, c);
	if (along < 0.5 * slant)
		return corner_distance(a, c->z, ra, guard, c);
	return corner_distance(c->rho - rb, over_top, rb, guard, c);
}

static void cone(const double *p, struct vec3 x, int order, struct jet *out)
{
	struct cylindrical c = about_axis(vec3_get(p), vec3_get(p + 3), x,
	    dmax(p[7], p[8]));
	struct planar f = cone_profile(p[6], p[7], p[8], AXIS_GUARD / p[9], &c);
	struct jet d = revolve(&f, &c);

	primitive_solid(&d, p[9], order, out);
}

static void torus(const double *p, struct vec3 x, int order, struct jet *out)
{
	struct cylindrical c = about_axis(vec3_get(p), vec3_get(p + 3), x,
	    p[6]);
	struct planar f = corner_distance(c.rho - p[6], c.z, p[6],
	    AXIS_GUARD * p[7], &c);
	struct jet d;

	f.value -= p[7];
	d = revolve(&f, &c);
	primitive_solid(&d, p[8], order, out);
}

static void plane(const double *p, struct vec3 x, int order, struct jet *out)
{
	struct vec3 u = vec3_get(p + 3);
	struct jet d = {.value = vec3_dot(u, vec3_sub(x, vec3_get(p))),
	    .gradient = u};

	primitive_solid(&d, p[6], order, out);
}

/* A direction of any non-zero length, also one whose square underflows. */
static struct vec3 direction(struct vec3 v)
{
	double most = dmax(fabs(v.x), dmax(fabs(v.y), fabs(v.z)));

	return unit(vec3(v.x / most, v.y / most, v.z / most));
}

/* R^2 over r^2: f(r) = 1/2 at (1 - r^2/R^2)^n = 1/2. */
static double support_ratio(double n)
{
	return -1.0 / expm1(-log(2.0) / n);
}

/* 1/R^2, n, weight from params + at; the count of parameters. */
static int put_soft(const struct primitive *p, double *params, int at)
{
	double r = p->radius[0];

	params[at] = 1.0 / (r * r * support_ratio(p->exponent));
	params[at + 1] = p->exponent;
	params[at + 2] = p->weight;
	return at + 3;
}

/* The unit vector from a to b and their distance; arbitrary and 0 if they
 * coincide. */
static void put_axis(const struct primitive *p, double *u, double *length)
{
	struct vec3 ab = vec3_sub(p->b, p->a);
	double norm = vec3_norm(ab);
	bool apart = norm > 1e-12;

	vec3_put(u, apart ? vec3_scale(1.0 / norm, ab) : vec3(0.0, 0.0, 1.0));
	*length = apart ? norm : 0.0;
}

static int put_point(const struct primitive *p, double *params)
{
	vec3_put(params, p->a);
	return put_soft(p, params, 3);
}

static int put_segment(const struct primitive *p, double *params)
{
	double grow = sqrt(support_ratio(p->exponent)), length;

	vec3_put(params, p->a);
	put_axis(p, params + 3, &length);
	params[6] = length;
	params[7] = grow * p->radius[0];
	params[8] = length > 0.0 ?
	    grow * (p->radius[1] - p->radius[0]) / length : 0.0;
	params[9] = p->exponent;
	params[10] = p->weight;
	return 11;
}

static int put_triangle(const struct primitive *p, double *params)
{
	vec3_put(params, p->a);
	vec3_put(params + 3, p->b);
	vec3_put(params + 6, p->c);
	return put_soft(p, params, 9);
}

static int put_ring(const struct primitive *p, double *params)
{
	vec3_put(params, p->a);
	vec3_put(params + 3, direction(p->normal));
	params[6] = p->major;
	return put_soft(p, params, 7);
}

static int put_sphere(const struct primitive *p, double *params)
{
	vec3_put(params, p->a);
	params[3] = p->radius[0];
	params[4] = 1.0 / p->falloff;
	return 5;
}

static int put_box(const struct primitive *p, double *params)
{
	double r = p->rounding;

	vec3_put(params, p->a);
	vec3_put(params + 3, vec3(p->half_size.x - r, p->half_size.y - r,
	    p->half_size.z - r));
	params[6] = r;
	params[7] = 1.0 / p->falloff;
	return 8;
}

static int put_cylinder(const struct primitive *p, double *params)
{
	double length;

	vec3_put(params, vec3_scale(0.5, vec3_add(p->a, p->b)));
	put_axis(p, params + 3, &length);
	params[6] = 0.5 * length;
	params[7] = p->radius[0];
	params[8] = 1.0 / p->falloff;
	return 9;
}

static int put_capsule(const struct primitive *p, double *params)
{
	vec3_put(params, p->a);
	put_axis(p, params + 3, params + 6);
	params[7] = p->radius[0];
	params[8] = 1.0 / p->falloff;
	return 9;
}

static int put_cone(const struct primitive *p, double *params)
{
	vec3_put(params, p->a);
	put_axis(p, params + 3, params + 6);
	params[7] = p->radius[0];
	params[8] = p->radius[1];
	params[9] = 1.0 / p->falloff;
	return 10;
}

static int put_torus(const struct primitive *p, double *params)
{
	vec3_put(params, p->a);
	vec3_put(params + 3, direction(p->normal));
	params[6] = p->major;
	params[7] = p->minor;
	params[8] = 1.0 / p->falloff;
	return 9;
}

static int put_plane(const struct primitive *p, double *params)
{
	vec3_put(params, p->a);
	vec3_put(params + 3, direction(p->normal));
	params[6] = 1.0 / p->falloff;
	return 7;
}

static int put_volume(const struct primitive *p, double *params)
{
	return volume_prepare(p->volume, p->falloff, params);
}

static const struct {
	OPCODE_UINT op;
	int (*put)(const struct primitive *p, double *params);
} types[PRIMITIVE_COUNT] = {
	[PRIMITIVE_POINT] = {OP_POINT, put_point},
	[PRIMITIVE_SEGMENT] = {OP_SEGMENT, put_segment},
	[PRIMITIVE_TRIANGLE] = {OP_TRIANGLE, put_triangle},
	[PRIMITIVE_DISC] = {OP_DISC, put_ring},
	[PRIMITIVE_CIRCLE] = {OP_CIRCLE, put_ring},
	[PRIMITIVE_SPHERE] = {OP_SPHERE, put_sphere},
	[PRIMITIVE_BOX] = {OP_BOX, put_box},
	[PRIMITIVE_CYLINDER] = {OP_CYLINDER, put_cylinder},
	[PRIMITIVE_CAPSULE] = {OP_CAPSULE, put_capsule},
	[PRIMITIVE_CONE] = {OP_CONE, put_cone},
	[PRIMITIVE_TORUS] = {OP_TORUS, put_torus},
	[PRIMITIVE_PLANE] = {OP_PLANE, put_plane},
	[PRIMITIVE_CAUCHY_POINT] = {OP_CAUCHY_POINT, cauchy_prepare},
	[PRIMITIVE_CAUCHY_SEGMENT] = {OP_CAUCHY_SEGMENT, cauchy_prepare},
	[PRIMITIVE_CAUCHY_TRIANGLE] = {OP_CAUCHY_TRIANGLE, cauchy_prepare},
	[PRIMITIVE_VOLUME] = {OP_VOLUME, put_volume},
};

OPCODE_UINT primitive_opcode(enum primitive_type type)
{
	return types[type].op;
}

int primitive_prepare(const struct primitive *p,
    double params[static PRIMITIVE_PARAMS_MAX])
{
	return types[p->type].put(p, params);
}

static bool is_soft(enum primitive_type type)
{
	return type <= PRIMITIVE_CIRCLE;
}

static bool is_cauchy(enum primitive_type type)
{
	return type >= PRIMITIVE_CAUCHY_POINT &&
	    type <= PRIMITIVE_CAUCHY_TRIANGLE;
}

double primitive_size(const struct primitive *p)
{
	double r = p->radius[0];

	if (p->type == PRIMITIVE_VOLUME && !p->volume->is_distance)
		return volume_spacing(p->volume);
	if (is_cauchy(p->type))
		return 1.0 / p->s;
	if (!is_soft(p->type))
		return p->falloff;
	if (p->type == PRIMITIVE_SEGMENT)
		r = dmin(r, p->radius[1]);
	return r * sqrt(support_ratio(p->exponent));
}

static void (*const shapes[OP_COUNT])(const double *params, struct vec3 x,
    int order, struct jet *out) = {
	[OP_POINT] = point,
	[OP_SEGMENT] = segment,
	[OP_TRIANGLE] = triangle,
	[OP_DISC] = disc,
	[OP_CIRCLE] = circle,
	[OP_SPHERE] = sphere,
	[OP_BOX] = box,
	[OP_CYLINDER] = cylinder,
	[OP_CAPSULE] = capsule,
	[OP_CONE] = cone,
	[OP_TORUS] = torus,
	[OP_PLANE] = plane,
};

void primitive_eval(OPCODE_UINT op, const double *params, struct vec3 x,
    int order, struct jet *out)
{
	*out = (struct jet){0};
	if (op >= OP_CAUCHY_POINT && op <= OP_CAUCHY_TRIANGLE) {
		cauchy_eval(op, params, x, order, out);
		return;
	}
	assert(op < OP_COUNT && shapes[op] != NULL);
	shapes[op](params, x, order, out);
}
