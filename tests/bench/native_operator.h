/*
 * The native evaluator's gradient-based composition: kernels/compose.cl and
 * table.cl, in an order that leaves for the end what most lanes can do without.
 * The angle is found first; then the boundary; where no lane lies within it
 * that is all. Only then the angle's derivatives and the table.
 */
#ifndef TESTS_BENCH_NATIVE_OPERATOR_H
#define TESTS_BENCH_NATIVE_OPERATOR_H

#include "core/curve.h"
#include "core/opening_table.h"
#include "core/table_shape.h"
#include "tests/bench/native_internal.h"
#include "tests/bench/native_primitive.h"

#define QUARTER_PI 0.785398163f

struct partials {
	real g, g1, g2, gt, g11, g12, g22, g1t, g2t, gtt;
};

INLINE real native_hermite(real a, real b, real a1, real b1, real x)
{
	real rise = b - a, s = 1.0f - x;

	return a + x * (rise + s * (s * (a1 - rise) - x * (b1 - rise)));
}

/* Value and first derivatives, as many as wanted, at x in [0, 1]. */
INLINE void curve(const float *samples, int count, float length, real x,
    int derivatives, real out[3])
{
	float steps = (float)(count - 1), step = length / steps;
	real u = clamp(x, 0.0f, 1.0f) * steps, t, a1, b1, a2, b2, a, b;
	whole i = truncate(real_min(u, all(steps - 1.0f)));

	t = u - to_real(i);
	i = i * CURVE_NODE;
	a = gather(samples, i);
	a1 = gather(samples + 1, i);
	b = gather(samples + CURVE_NODE, i);
	b1 = gather(samples + CURVE_NODE + 1, i);
	out[0] = native_hermite(a, b, step * a1, step * b1, t);
	if (derivatives < 1)
		return;
	a2 = gather(samples + 2, i);
	b2 = gather(samples + CURVE_NODE + 2, i);
	out[1] = native_hermite(a1, b1, step * a2, step * b2, t);
	out[2] = a2 + t * (b2 - a2);
}

INLINE real tangent(real x)
{
	real s = x * x;

	return real_min(x * (945.0f - s * (105.0f - s)) *
	    over(945.0f - s * (420.0f - 15.0f * s)), all(1.0f));
}

INLINE real boundary_union(const struct native_operator *o, real c, real T)
{
	real below = T * 0.5f, lambda = c, s, phi[3];
	mask curved = both(gt(c, below), lt(T, all(1.0f)));

	if (any(curved)) {
		curve(o->phi, TABLE_CURVE_NODES, 2.0f, (2.0f * c - T) *
		    over(real_max(1.0f - T, all(1e-7f))), 0, phi);
		lambda = choose(curved, (1.0f - T) * 0.25f * phi[0] + below, c);
	}
	s = lambda * over(1.0f + T);
	return 8.0f * T * s * s;
}

INLINE real blend_depth(const struct native_operator *o, real near, real T)
{
	real half_t = 0.5f * T, c, k, phi[3];
	mask low = lt(near, all(0.5f));

	if (o->is_union) {
		if (!any(low))
			return near - half_t;
		c = real_min(near, all(0.5f));
		return near - choose(low, boundary_union(o, c, T), half_t);
	}
	c = real_max(1.0f - near, all(0.0f));
	k = c - boundary_union(o, real_min(c, all(0.5f)), T);
	if (any(low)) {
		curve(o->phi, TABLE_CURVE_NODES, 2.0f, 2.0f * near, 0, phi);
		k = choose(low, (1.0f - half_t) * phi[0] - near, k);
	}
	return -k;
}

INLINE void sigma(const float *samples, real r, int order, real out[3])
{
	real s = root(real_max(1.0f - r, all(0.0f))), at[3], inv;

	curve(samples, TABLE_CURVE_NODES, 1.0f, 1.0f - s, order, at);
	out[0] = at[0];
	if (order < 1)
		return;
	if (any(lt(s, all(TABLE_FOLD_FIRST)))) {
		s = real_max(s, all(TABLE_FOLD_FIRST));
		curve(samples, TABLE_CURVE_NODES, 1.0f, 1.0f - s, 1, at);
	}
	inv = over(s);
	out[1] = 0.5f * at[1] * inv;
	if (order < 2)
		return;
	if (any(lt(s, all(TABLE_FOLD_SECOND)))) {
		s = real_max(s, all(TABLE_FOLD_SECOND));
		curve(samples, TABLE_CURVE_NODES, 1.0f, 1.0f - s, 1, at);
		inv = over(s);
	}
	out[2] = (at[2] + at[1] * inv) * 0.25f * inv * inv;
}

/* The union's closed form at C >= 1/2. */
INLINE mask closed_form(const struct native_operator *o, mask blend, real near,
    real far, real T, int order, struct partials *out)
{
	real half_t = 0.5f * T, a = near - half_t, b = far - half_t;
	mask m = both(both(blend, gt(b, all(0.0f))),
	    ge(a + b, 0.49f * (1.0f - T)));
	real r, s[3], g, c, gn, T1, inv_a;

	if (!any(m))
		return m;
	inv_a = over(choose(m, a, all(1.0f)));
	r = choose(m, b * inv_a, all(0.0f));
	sigma(o->sigma, r, order, s);
	g = half_t + a * s[0];
	m = both(m, ge(g, all(0.5f)));
	out->g = choose(m, g, out->g);
	if (order < 1)
		return m;
	gn = s[0] - r * s[1];
	T1 = 1.0f + T * T;
	out->g1 = choose(m, gn, out->g1);
	out->g2 = choose(m, s[1], out->g2);
	out->gt = choose(m, 0.5f * T1 * (1.0f - gn - s[1]), out->gt);
	if (order < 2)
		return m;
	c = s[2] * inv_a;
	out->g11 = choose(m, r * r * c, out->g11);
	out->g12 = choose(m, -r * c, out->g12);
	out->g22 = choose(m, c, out->g22);
	out->g1t = choose(m, -0.5f * T1 * (r * r - r) * c, out->g1t);
	out->g2t = choose(m, -0.5f * T1 * (1.0f - r) * c, out->g2t);
	out->gtt = choose(m, T1 * T1 * 0.25f * (1.0f - r) * (1.0f - r) * c +
	    T * T1 * (1.0f - gn - s[1]), out->gtt);
	return m;
}

/* The edge along x of a cell, interpolated in y and z: 8 floats. */
INLINE eight fetch_edge(const float *at, int stride_y, int stride_z, float y,
    float z)
{
	eight a, b, c, d;

	memcpy(&a, at, sizeof(a));
	memcpy(&b, at + stride_y, sizeof(b));
	memcpy(&c, at + stride_z, sizeof(c));
	memcpy(&d, at + stride_z + stride_y, sizeof(d));
	a += y * (b - a);
	c += y * (d - c);
	return a + z * (c - a);
}

/* A node's second part, interpolated in x, y and z. */
INLINE eight fetch_second(const float *at, int n, float x, float y, float z)
{
	eight a = fetch_edge(at, 8 * n, 8 * n * n, y, z);
	eight b = fetch_edge(at + 8, 8 * n, 8 * n * n, y, z);

	return a + x * (b - a);
}

/* The lanes of m from the table's cells. */
INLINE void cells(const struct native_operator *o, mask m, real near, real far,
    real T, real depth, int order, struct partials *out)
{
	int n = o->resolution;
	float last = (float)(n - 1), h = 2.0f / last;
	float px[LANES], py[LANES], pz[LANES];
	int32_t node[LANES];
	eight rows[LANES], second[LANES];
	real sign = choose(lt(depth, all(0.0f)), all(-1.0f), all(1.0f));
	real d = sign * real_max(sign * depth, all(TABLE_DEPTH_MIN));
	real inv_d = over(d), c[8], left, e = near, x, y, z, t;
	mask high = gt(near, all(0.5f));
	whole i, j, k;

	x = 1.0f - root(clamp((near - far) * inv_d, 0.0f, 1.0f));
	t = choose(high, 1.0f - near, near);
	y = 2.0f * t * over(1.0f +
	    root(real_max(1.0f - 2.0f * t, all(0.0f))));
	z = 1.0f - root(1.0f - T);
	if (!o->is_union) {
		y = choose(high, 1.0f - 0.5f * y, 0.5f * y);
		e = near * (1.0f - near);
	}
	x = clamp(x * last, 0.0f, last);
	y = clamp(y * last, 0.0f, last);
	z = clamp(z * last, 0.0f, last);
	i = truncate(real_min(x, all(last - 1.0f)));
	j = truncate(real_min(y, all(last - 1.0f)));
	k = truncate(real_min(z, all(last - 1.0f)));
	left = to_real(i);
	x -= left;
	store(px, x);
	store(py, y - to_real(j));
	store(pz, z - to_real(k));
	i = (k * n + j) * n + i;
	memcpy(node, &i, sizeof(node));
	for (unsigned b = bits(m); b; b &= b - 1) {
		int l = __builtin_ctz(b);

		rows[l] = fetch_edge(o->first + 4 * node[l], 4 * n, 4 * n * n,
		    py[l], pz[l]);
		if (order > 1)
			second[l] = fetch_second(o->second + 8 * node[l], n,
			    px[l], py[l], pz[l]);
	}
	transpose(rows, c);
	left = 1.0f - left * (1.0f / last);
	out->g = choose(m, near + d * native_hermite(c[0], c[4],
	    h * left * c[2], h * (left - 1.0f / last) * c[6], x), out->g);
	if (order < 1)
		return;
	out->g1 = choose(m, c[1] + x * (c[5] - c[1]), out->g1);
	out->g2 = choose(m, c[2] + x * (c[6] - c[2]), out->g2);
	out->gt = choose(m, e * (c[3] + x * (c[7] - c[3])), out->gt);
	if (order < 2)
		return;
	transpose(second, c);
	out->g11 = choose(m, c[0] * inv_d, out->g11);
	out->g12 = choose(m, c[1] * inv_d, out->g12);
	out->g22 = choose(m, c[2] * inv_d, out->g22);
	out->g1t = choose(m, c[3], out->g1t);
	out->g2t = choose(m, c[4], out->g2t);
	out->gtt = choose(m, c[5] * e, out->gtt);
}

/* --- the angle ------------------------------------------------------------ */

struct heading {
	struct vec n;
	real inverse, share, slope;
};

INLINE struct heading heading(struct vec g, float null_gradient)
{
	float inv = 1.0f / null_gradient;
	real norm = root(dot(g, g)), s = real_min(norm * inv, all(1.0f));
	struct heading h;

	h.inverse = over(real_max(norm, all(1e-18f)));
	h.n = scale(h.inverse, g);
	h.share = s * s * s * (s * (s * 6.0f - 15.0f) + 10.0f);
	h.slope = 30.0f * inv * s * s * (1.0f - s) * (1.0f - s);
	return h;
}

/* What is known of the angle before its derivatives. */
struct angle {
	struct heading u, v;
	real c, share, theta, rise, slope, bend;
};

INLINE void find_angle(const struct native_operator *o, float null_gradient,
    const struct jet *a, const struct jet *b, int order, struct angle *out)
{
	real at[3];

	out->u = heading(a->g, null_gradient);
	out->v = heading(b->g, null_gradient);
	out->share = out->u.share * out->v.share;
	out->c = clamp(dot(out->u.n, out->v.n), -1.0f, 1.0f);
	curve(o->opening, OPENING_TABLE_COUNT, 2.0f, 0.5f * (out->c + 1.0f),
	    order, at);
	out->rise = clamp(at[0], 0.0f, QUARTER_PI) - o->theta_least;
	out->theta = o->theta_least + out->rise * out->share;
	if (order >= 1) {
		out->slope = at[1];
		out->bend = at[2];
	}
}

/* r + s (h k + k h) */
INLINE struct sym anticommutator(real s, struct sym h, struct sym k,
    struct sym r)
{
	struct vec hx = vec(h.xx, h.xy, h.xz), kx = vec(k.xx, k.xy, k.xz);
	struct vec hy = vec(h.xy, h.yy, h.yz), ky = vec(k.xy, k.yy, k.yz);
	struct vec hz = vec(h.xz, h.yz, h.zz), kz = vec(k.xz, k.yz, k.zz);

	return sym_axpy(s, sym(2.0f * dot(hx, kx), 2.0f * dot(hy, ky),
	    2.0f * dot(hz, kz), dot(hx, ky) + dot(kx, hy),
	    dot(hx, kz) + dot(kx, hz), dot(hy, kz) + dot(ky, hz)), r);
}

/* r + s h^2 */
INLINE struct sym square(real s, struct sym h, struct sym r)
{
	struct vec x = vec(h.xx, h.xy, h.xz), y = vec(h.xy, h.yy, h.yz);
	struct vec z = vec(h.xz, h.yz, h.zz);

	return sym_axpy(s, sym(dot(x, x), dot(y, y), dot(z, z), dot(x, y),
	    dot(x, z), dot(y, z)), r);
}

/* The Hessian of the cosine, without third derivatives. */
INLINE struct sym cosine_bend(const struct jet *a, const struct jet *b,
    const struct angle *t, struct vec grad_c)
{
	struct sym h = sym_scale(t->u.inverse, a->h);
	struct sym k = sym_scale(t->v.inverse, b->h), r = sym_one(all(0.0f));
	struct vec p = apply(h, t->u.n), q = apply(k, t->v.n);

	/* h k + k h - c (h^2 + k^2), in two products */
	r = anticommutator(all(1.0f), h, sym_axpy(-0.5f * t->c, h, k), r);
	r = square(-t->c, k, r);
	r = sym_product(scale(all(-1.0f), add(p, q)), grad_c, r);
	return sym_square(t->c, sub(p, q), r);
}

/* Adds what theta brings to the result's derivatives. */
INLINE void turn(const struct jet *a, const struct jet *b,
    const struct partials *o, const struct angle *t, int order,
    struct jet *out)
{
	struct vec p = apply(a->h, axpy(-t->c, t->u.n, t->v.n));
	struct vec q = apply(b->h, axpy(-t->c, t->v.n, t->u.n));
	struct vec cosine = axpy(t->u.inverse, p, scale(t->v.inverse, q));
	struct vec theta = scale(t->share * t->slope, cosine);

	/* grad |grad f| = H n, where a gradient is nearly null */
	if (any(lt(t->share, all(1.0f)))) {
		theta = axpy(t->rise * t->u.slope * t->v.share,
		    apply(a->h, t->u.n), theta);
		theta = axpy(t->rise * t->v.slope * t->u.share,
		    apply(b->h, t->v.n), theta);
	}
	out->g = axpy(o->gt, theta, out->g);
	if (order < 2)
		return;
	out->h = sym_axpy(o->gt * t->share * t->slope,
	    cosine_bend(a, b, t, cosine), out->h);
	out->h = sym_square(o->gt * t->share * t->bend, cosine, out->h);
	out->h = sym_product(axpy(o->g2t, b->g, scale(o->g1t, a->g)), theta,
	    out->h);
	out->h = sym_square(o->gtt, theta, out->h);
}

INLINE void chain(const struct jet *a, const struct jet *b,
    const struct partials *o, int order, struct jet *out)
{
	out->f = real_max(o->g, all(0.0f));
	if (order >= 1)
		out->g = axpy(o->g2, b->g, scale(o->g1, a->g));
	if (order < 2)
		return;
	out->h = sym_axpy(o->g2, b->h, sym_scale(o->g1, a->h));
	out->h = sym_square(o->g11, a->g, out->h);
	out->h = sym_square(o->g22, b->g, out->h);
	out->h = sym_product(scale(o->g12, a->g), b->g, out->h);
}

INLINE void swap(mask m, real *a, real *b)
{
	real x = *a;

	*a = choose(m, *b, x);
	*b = choose(m, x, *b);
}

/* The composition where neither operand is 0 in every lane; order is the
 * result's. */
INLINE void blend(const struct native_operator *o, float null_gradient,
    const struct jet *a, const struct jet *b, int order, struct jet *out)
{
	const real zero = all(0.0f);
	mask swapped = o->is_union ? gt(b->f, a->f) : lt(b->f, a->f), m;
	real near = choose(swapped, b->f, a->f);
	real far = choose(swapped, a->f, b->f), T, depth;
	struct partials j = {near, all(1.0f), zero, zero, zero, zero, zero,
		zero, zero, zero};
	struct angle t = {.theta = all(o->theta)};

	if (!o->is_constant)
		find_angle(o, null_gradient, a, b, order, &t);
	T = tangent(t.theta);
	depth = blend_depth(o, near, T);
	m = o->is_union ? both(lt(near - far, depth), gt(far, zero)) :
	    both(gt(near - far, depth), both(gt(near, zero),
	    lt(near, all(1.0f))));
	if (!any(m)) {
		out->f = near;
		if (order >= 1)
			out->g = vec_select(swapped, b->g, a->g);
		if (order >= 2)
			out->h = sym_select(swapped, b->h, a->h);
		return;
	}
	if (o->is_union) {
		mask c = closed_form(o, m, near, far, T, order, &j);

		m = both(both(m, not(c)), lt(near, all(0.5f)));
	}
	if (any(m))
		cells(o, m, near, far, T, depth, order, &j);
	if (order > 0)
		swap(swapped, &j.g1, &j.g2);
	if (order > 1) {
		swap(swapped, &j.g11, &j.g22);
		swap(swapped, &j.g1t, &j.g2t);
	}
	chain(a, b, &j, order, out);
	if (!o->is_constant && order > 0)
		turn(a, b, &j, &t, order, out);
}

#endif
