/*
 * The native evaluator's primitives: kernels/primitive.cl's formulas, without
 * its limits. Each returns the lanes where its field is not 0; where there are
 * none, *out is left as it was.
 */
#ifndef TESTS_BENCH_NATIVE_PRIMITIVE_H
#define TESTS_BENCH_NATIVE_PRIMITIVE_H

#include "core/opcode.h"
#include "tests/bench/native_lanes.h"

#define TINY 1e-18f
#define SLIVER 1e-4f

INLINE real inverse(real x)
{
	return choose(gt(x, all(TINY)), over(x), all(0.0f));
}

INLINE struct vec unit(struct vec v, real *norm)
{
	*norm = root(dot(v, v));
	return scale(inverse(*norm), v);
}

/* b^k, b >= 0 */
INLINE real power(real b, float k)
{
	real p = b;

	if (k == (float)(int)k && k <= 16.0f) {
		for (float i = 1.0f; i < k; i += 1.0f)
			p *= b;
		return p;
	}
	for (int l = 0; l < LANES; l++)
		p[l] = powf(b[l], k);
	return p;
}

/* f = weight b^n, b = 1 - S, from S and its derivatives, where S < 1. */
INLINE mask soft(const struct jet *s, float n, float weight, int order,
    struct jet *out)
{
	real b = real_max(1.0f - s->f, all(0.0f));
	real p = weight * power(b, n - 2.0f), f1 = -n * p * b;
	mask in = gt(b, all(0.0f));

	out->f = p * b * b;
	if (order >= 1)
		out->g = scale(f1, s->g);
	if (order >= 2)
		out->h = sym_square(n * (n - 1.0f) * p, s->g,
		    sym_scale(f1, s->h));
	return in;
}

INLINE mask outside(real s)
{
	return not(lt(s, all(1.0f)));
}

INLINE mask none(void)
{
	return from_bits(0);
}

INLINE mask point(const float *p, struct vec x, int order, struct jet *out)
{
	struct vec e = sub(x, vec_all(p));
	float inv_r2 = p[3];
	struct jet s = {.f = dot(e, e) * inv_r2};
	real b, wb, f1;

	if (!any(lt(s.f, all(1.0f))))
		return none();
	if (p[4] != 3.0f) {
		s.g = scale(all(2.0f * inv_r2), e);
		s.h = sym_one(all(2.0f * inv_r2));
		return soft(&s, p[4], p[5], order, out);
	}
	b = real_max(1.0f - s.f, all(0.0f));
	wb = p[5] * b;
	f1 = (-6.0f * inv_r2) * b * wb;
	out->f = wb * b * b;
	if (order >= 1)
		out->g = scale(f1, e);
	if (order >= 2)
		out->h = sym_square(24.0f * inv_r2 * inv_r2 * wb, e,
		    sym_one(f1));
	return gt(b, all(0.0f));
}

/* Where along a segment from e's origin by u is nearest; e from there. */
INLINE mask slide(struct vec u, float length, struct vec *e, real *t)
{
	real along = dot(u, *e);

	*t = clamp(along, 0.0f, length);
	*e = axpy(-*t, u, *e);
	return both(gt(along, all(0.0f)), lt(along, all(length)));
}

INLINE mask segment(const float *p, struct vec x, int order, struct jet *out)
{
	struct vec u = vec_all(p + 3), e = sub(x, vec_all(p));
	real zero = all(0.0f), t, r, inv_r2, k, sk;
	mask between = slide(u, p[6], &e, &t);
	struct jet s;

	r = real_max(p[7] + p[8] * t, all(1e-7f * p[7]));
	inv_r2 = over(r * r);
	s.f = dot(e, e) * inv_r2;
	if (!any(lt(s.f, all(1.0f))))
		return none();
	if (order >= 1) {
		k = choose(between, p[8] * over(r), zero);
		sk = s.f * k;
		s.g = axpy(-2.0f * sk, u, scale(2.0f * inv_r2, e));
	}
	if (order >= 2) {
		s.h = sym_square(6.0f * sk * k -
		    choose(between, 2.0f * inv_r2, zero), u,
		    sym_one(2.0f * inv_r2));
		if (p[8] != 0.0f)
			s.h = sym_product(scale(-4.0f * k * inv_r2, e), u, s.h);
	}
	return soft(&s, p[9], p[10], order, out);
}

/* The Hessian of |e|^2/2 is along v v^T + isotropic I. */
struct foot {
	struct vec e, v;
	real along, isotropic, square;
};

struct float3 {
	float x, y, z;
};

INLINE struct float3 minus3(const float *a, const float *b)
{
	return (struct float3){a[0] - b[0], a[1] - b[1], a[2] - b[2]};
}

INLINE float dot3(struct float3 a, struct float3 b)
{
	return a.x * b.x + a.y * b.y + a.z * b.z;
}

INLINE struct float3 cross3(struct float3 a, struct float3 b)
{
	return (struct float3){a.y * b.z - a.z * b.y, a.z * b.x - a.x * b.z,
		a.x * b.y - a.y * b.x};
}

INLINE struct float3 unit3(struct float3 v, float *norm)
{
	float s;

	*norm = sqrtf(dot3(v, v));
	s = *norm > TINY ? 1.0f / *norm : 0.0f;
	return (struct float3){s * v.x, s * v.y, s * v.z};
}

INLINE struct vec vec3_all(struct float3 v)
{
	return vec(all(v.x), all(v.y), all(v.z));
}

INLINE struct foot foot_select(mask m, struct foot yes, struct foot no)
{
	return (struct foot){vec_select(m, yes.e, no.e),
		vec_select(m, yes.v, no.v), choose(m, yes.along, no.along),
		choose(m, yes.isotropic, no.isotropic),
		choose(m, yes.square, no.square)};
}

INLINE struct foot edge_foot(struct vec e, struct float3 along, float length)
{
	struct foot f = {.v = vec3_all(along), .isotropic = all(1.0f)};
	real t;
	mask between = slide(f.v, length, &e, &t);

	f.e = e;
	f.along = choose(between, all(-1.0f), all(0.0f));
	f.square = dot(e, e);
	return f;
}

INLINE struct foot nearer(struct foot f, struct foot g)
{
	return foot_select(lt(f.square, g.square), f, g);
}

INLINE mask beside(struct float3 n, struct float3 u, struct vec e)
{
	return gt(dot(vec3_all(cross3(n, u)), e), all(0.0f));
}

INLINE mask triangle(const float *p, struct vec x, int order, struct jet *out)
{
	float lab, lbc, lca, sine, norm, inv_r2 = p[9], d;
	struct float3 ab = unit3(minus3(p + 3, p), &lab);
	struct float3 bc = unit3(minus3(p + 6, p + 3), &lbc);
	struct float3 ca = unit3(minus3(p, p + 6), &lca);
	struct float3 n = unit3(cross3(ca, ab), &sine);
	struct vec ea = sub(x, vec_all(p)), eb = sub(x, vec_all(p + 3));
	struct vec ec = sub(x, vec_all(p + 6));
	struct foot f = nearer(nearer(edge_foot(ec, ca, lca),
	    edge_foot(eb, bc, lbc)), edge_foot(ea, ab, lab));
	struct jet s;

	if (sine > SLIVER) {
		struct foot face;

		d = dot3(n, ab);
		n = unit3((struct float3){n.x - d * ab.x, n.y - d * ab.y,
		    n.z - d * ab.z}, &norm);
		face.v = vec3_all(n);
		face.e = scale(dot(face.v, ea), face.v);
		face.along = all(1.0f);
		face.isotropic = all(0.0f);
		face.square = dot(face.e, face.e);
		f = foot_select(both(both(beside(n, ab, ea),
		    beside(n, bc, eb)), beside(n, ca, ec)), face, f);
	}
	s.f = f.square * inv_r2;
	if (!any(lt(s.f, all(1.0f))))
		return none();
	s.g = scale(all(2.0f * inv_r2), f.e);
	if (order >= 2)
		s.h = sym_scale(all(2.0f * inv_r2), sym_square(f.along, f.v,
		    sym_one(f.isotropic)));
	return soft(&s, p[10], p[11], order, out);
}

/* z along u, rho away from it along e. */
struct cylindrical {
	real rho, z, inv_rho;
	struct vec e, u;
};

INLINE struct cylindrical about_axis(const float *centre, const float *axis,
    struct vec x, float size)
{
	struct vec d = sub(x, vec_all(centre));
	struct cylindrical c = {.u = vec_all(axis)};

	c.z = dot(c.u, d);
	c.e = axpy(-c.z, c.u, d);
	c.rho = root(dot(c.e, c.e));
	c.inv_rho = over(real_max(c.rho, all(AXIS_GUARD * size)));
	c.e = scale(c.inv_rho, c.e);
	return c;
}

/* A function of (rho, z), and d/drho over rho. */
struct planar {
	real f, r, z, rr, rz, zz, r_over_rho;
};

INLINE struct planar planar_select(mask m, struct planar yes,
    struct planar no)
{
	return (struct planar){choose(m, yes.f, no.f), choose(m, yes.r, no.r),
		choose(m, yes.z, no.z), choose(m, yes.rr, no.rr),
		choose(m, yes.rz, no.rz), choose(m, yes.zz, no.zz),
		choose(m, yes.r_over_rho, no.r_over_rho)};
}

INLINE void revolve(const struct planar *f, const struct cylindrical *c,
    int order, struct jet *out)
{
	out->f = f->f;
	if (order >= 1)
		out->g = axpy(f->r, c->e, scale(f->z, c->u));
	if (order < 2)
		return;
	out->h = sym_square(f->rr - f->r_over_rho, c->e,
	    sym_one(f->r_over_rho));
	out->h = sym_square(f->zz - f->r_over_rho, c->u, out->h);
	out->h = sym_product(scale(f->rz, c->e), c->u, out->h);
}

/* A soft object of revolution: a from the skeleton, radial where it grows with
 * rho. */
INLINE mask ring(real a, mask radial, const float *p,
    const struct cylindrical *c, int order, struct jet *out)
{
	real two = all(2.0f * p[0]), zero = all(0.0f);
	struct planar f = {(a * a + c->z * c->z) * p[0], two * a, two * c->z,
		choose(radial, two, zero), zero, two, two * a * c->inv_rho};
	struct jet s;

	if (!any(lt(f.f, all(1.0f))))
		return none();
	revolve(&f, c, order, &s);
	return soft(&s, p[1], p[2], order, out);
}

INLINE mask disc(const float *p, struct vec x, int order, struct jet *out)
{
	struct cylindrical c = about_axis(p, p + 3, x, p[6]);
	real a = c.rho - p[6];

	return ring(real_max(a, all(0.0f)), gt(a, all(0.0f)), p + 7, &c,
	    order, out);
}

INLINE mask circle(const float *p, struct vec x, int order, struct jet *out)
{
	struct cylindrical c = about_axis(p, p + 3, x, p[6]);

	return ring(c.rho - p[6], not(none()), p + 7, &c, order, out);
}

/* (1-t)^3 (8 + 9t + 3t^2)/16 of a distance within the falloff. */
INLINE mask solid(const struct jet *d, float inv_fall, int order,
    struct jet *out)
{
	real t = clamp(d->f * inv_fall, -1.0f, 1.0f);
	real w = 1.0f - t, flat = w * (1.0f + t), f1;

	out->f = w * w * w * (8.0f + t * (9.0f + 3.0f * t)) * 0.0625f;
	f1 = -0.9375f * inv_fall * flat * flat;
	if (order >= 1)
		out->g = scale(f1, d->g);
	if (order >= 2)
		out->h = sym_square(3.75f * inv_fall * inv_fall * t * flat,
		    d->g, sym_scale(f1, d->h));
	return lt(t, all(1.0f));
}

INLINE int is_far(real distance, float inv_fall)
{
	return !any(lt(distance * inv_fall, all(1.0f)));
}

/* Of |e| less radius, e measured from an axis along u where axial is 1. */
INLINE mask round_solid(struct vec e, float radius, struct vec u, real axial,
    float inv_fall, int order, struct jet *out)
{
	struct jet d;
	real length;

	d.g = unit(e, &length);
	d.f = length - radius;
	if (is_far(d.f, inv_fall))
		return none();
	if (order >= 2) {
		d.h = sym_square(all(-1.0f), d.g, sym_one(all(1.0f)));
		d.h = sym_scale(over(real_max(length,
		    all(AXIS_GUARD * radius))), sym_square(-axial, u, d.h));
	}
	return solid(&d, inv_fall, order, out);
}

INLINE mask sphere(const float *p, struct vec x, int order, struct jet *out)
{
	struct vec e = sub(x, vec_all(p));

	return round_solid(e, p[3], e, all(0.0f), p[4], order, out);
}

INLINE mask capsule(const float *p, struct vec x, int order, struct jet *out)
{
	struct vec u = vec_all(p + 3), e = sub(x, vec_all(p));
	real t;
	mask between = slide(u, p[6], &e, &t);

	return round_solid(e, p[7], u, choose(between, all(1.0f), all(0.0f)),
	    p[8], order, out);
}

INLINE real sign_of(real x)
{
	return choose(lt(x, all(0.0f)), all(-1.0f), all(1.0f));
}

INLINE struct sym box_hessian(struct vec o, struct vec g, real inv,
    struct vec side)
{
	real xx = g.x * g.x, yy = g.y * g.y, zz = g.z * g.z, zero = all(0.0f);

	return sym(choose(gt(o.x, zero), inv * (yy + zz), zero),
	    choose(gt(o.y, zero), inv * (xx + zz), zero),
	    choose(gt(o.z, zero), inv * (xx + yy), zero),
	    -inv * g.x * g.y * side.x * side.y,
	    -inv * g.x * g.z * side.x * side.z,
	    -inv * g.y * g.z * side.y * side.z);
}

INLINE mask box(const float *p, struct vec x, int order, struct jet *out)
{
	struct vec d = sub(x, vec_all(p)), o, g, q;
	struct vec side = vec(sign_of(d.x), sign_of(d.y), sign_of(d.z));
	real zero = all(0.0f), length, most;
	mask mx, my, beyond;
	struct jet jet;

	q = vec(d.x * side.x - p[3], d.y * side.y - p[4],
	    d.z * side.z - p[5]);
	o = vec(real_max(q.x, zero), real_max(q.y, zero),
	    real_max(q.z, zero));
	g = unit(o, &length);
	beyond = gt(length, all(TINY));
	most = real_max(q.x, real_max(q.y, q.z));
	jet.f = choose(beyond, length, most) - p[6];
	if (is_far(jet.f, p[7]))
		return none();
	mx = ge(q.x, most);
	my = both(not(mx), ge(q.y, most));
	jet.g = vec_select(beyond,
	    vec(g.x * side.x, g.y * side.y, g.z * side.z),
	    vec(choose(mx, side.x, zero), choose(my, side.y, zero),
	    choose(either(mx, my), zero, side.z)));
	if (order >= 2)
		jet.h = box_hessian(o, g, over(real_max(length,
		    all(AXIS_GUARD / p[7]))), side);
	return solid(&jet, p[7], order, out);
}

INLINE struct planar corner_distance(real a, real z, real v, float guard,
    const struct cylindrical *c)
{
	real length = root(a * a + z * z), unguarded = inverse(length);
	real inv = over(real_max(length, all(guard)));
	real r = a * unguarded, s = z * unguarded;

	return (struct planar){length, r, s, inv * s * s, -inv * r * s,
		inv * r * r, inv * (1.0f - v * c->inv_rho)};
}

INLINE struct planar line_distance(real distance, real r, real z,
    const struct cylindrical *c)
{
	real zero = all(0.0f);

	return (struct planar){distance, r, z, zero, zero, zero,
		r * c->inv_rho};
}

INLINE mask revolved(const struct planar *f, const struct cylindrical *c,
    float inv_fall, int order, struct jet *out)
{
	struct jet d;

	if (is_far(f->f, inv_fall))
		return none();
	revolve(f, c, order, &d);
	return solid(&d, inv_fall, order, out);
}

INLINE mask cylinder(const float *p, struct vec x, int order, struct jet *out)
{
	struct cylindrical c = about_axis(p, p + 3, x, p[7]);
	real side = sign_of(c.z), zero = all(0.0f), one = all(1.0f);
	real q = c.rho - p[7], w = c.z * side - p[6];
	mask lateral = ge(q, w), corner = both(gt(q, zero), gt(w, zero));
	struct planar f = line_distance(choose(lateral, q, w),
	    choose(lateral, one, zero), choose(lateral, zero, side), &c);

	if (any(corner))
		f = planar_select(corner, corner_distance(q, w * side,
		    all(p[7]), AXIS_GUARD / p[8], &c), f);
	return revolved(&f, &c, p[8], order, out);
}

INLINE mask cone(const float *p, struct vec x, int order, struct jet *out)
{
	float length = p[6], ra = p[7], rb = p[8];
	float wide = ra - rb, slant = sqrtf(length * length + wide * wide);
	float m = slant > 0.0f ? -wide / slant : 0.0f;
	float h = slant > 0.0f ? length / slant : 1.0f;
	struct cylindrical c = about_axis(p, p + 3, x, ra > rb ? ra : rb);
	real zero = all(0.0f), one = all(1.0f), a = c.rho - ra;
	real under = -c.z, over_top = c.z - length;
	real off = h * a - m * c.z, along = m * a + h * c.z;
	mask inside = both(both(le(off, zero), le(under, zero)),
	    le(over_top, zero));
	mask side = either(both(inside, both(ge(off, under),
	    ge(off, over_top))), both(both(not(inside), gt(off, zero)),
	    both(ge(along, zero), le(along, all(slant)))));
	mask bottom = both(not(side), either(both(inside, ge(under, over_top)),
	    both(not(inside), both(gt(under, zero), lt(c.rho, all(ra))))));
	mask top = both(not(either(side, bottom)), either(inside,
	    both(gt(over_top, zero), lt(c.rho, all(rb)))));
	mask low = lt(along, all(0.5f * slant));
	mask line = either(side, either(bottom, top));
	struct planar f = line_distance(
	    choose(side, off, choose(bottom, under, over_top)),
	    choose(side, all(h), zero),
	    choose(side, all(-m), choose(bottom, -one, one)), &c);

	if (any(not(line)))
		f = planar_select(line, f, corner_distance(
		    choose(low, a, c.rho - rb), choose(low, c.z, over_top),
		    choose(low, all(ra), all(rb)), AXIS_GUARD / p[9], &c));
	return revolved(&f, &c, p[9], order, out);
}

INLINE mask torus(const float *p, struct vec x, int order, struct jet *out)
{
	struct cylindrical c = about_axis(p, p + 3, x, p[6]);
	struct planar f = corner_distance(c.rho - p[6], c.z, all(p[6]),
	    AXIS_GUARD * p[7], &c);

	f.f -= p[7];
	return revolved(&f, &c, p[8], order, out);
}

INLINE mask plane(const float *p, struct vec x, int order, struct jet *out)
{
	struct jet d = {.g = vec_all(p + 3), .h = sym_one(all(0.0f))};

	d.f = dot(d.g, sub(x, vec_all(p)));
	if (is_far(d.f, p[6]))
		return none();
	return solid(&d, p[6], order, out);
}

#endif
