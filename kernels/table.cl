/*
 * Operators by table: g(f1, f2, theta) and its derivatives, as core/table.c
 * has them in float64 (core/table_shape.h says what a table holds).
 */

struct opjet {
	real g, g1, g2, gt, g11, g12, g22, g1t, g2t, gtt;
};

#define QUARTER_PI 0.785398163f

/* tan on [0, pi/4] by Lambert's continued fraction, to 1e-7. */
static inline real table_tan(real x)
{
	real s = x * x;

	return x * (945.0f - s * (105.0f - s)) /
	    (945.0f - s * (420.0f - 15.0f * s));
}

/* The union's boundary at c <= 1/2, T = tan(theta). */
static real table_boundary_union(__global const float *curves, real c, real T)
{
	real below = T * 0.5f, phi[3], lambda, scale;
	mask curved = (c > below) & (T < REAL(1.0f));

	lambda = c;
	if (ANY(curved)) {
		curve_lookup(curves, TABLE_CURVE_NODES, 2.0f, (2.0f * c - T) /
		    real_max(1.0f - T, REAL(1e-7f)), phi);
		lambda = SELECT(c, (1.0f - T) * 0.25f * phi[0] + below, curved);
	}
	scale = lambda / (1.0f + T);
	return 8.0f * T * scale * scale;
}

/* near - k(near), the depth of the blend region; below 0 for intersections. */
static real table_depth(__global const float *curves, uint family, real near,
    real T)
{
	real half_t = 0.5f * T, c, k, phi[3];

	if (family == DESCRIPTOR_UNION) {
		if (ALL(near >= REAL(0.5f)))
			return near - half_t;
		c = real_min(near, REAL(0.5f));
		k = table_boundary_union(curves, c, T);
		return near - SELECT(k, half_t, near >= 0.5f);
	}
	/* Above 1/2, 1 - near lies at the same depth of the union's region. */
	c = real_max(1.0f - near, REAL(0.0f));
	k = c - table_boundary_union(curves, real_min(c, REAL(0.5f)), T);
	if (ANY(near < REAL(0.5f))) {
		curve_lookup(curves, TABLE_CURVE_NODES, 2.0f, 2.0f * near,
		    phi);
		k = SELECT(k, (1.0f - half_t) * phi[0] - near, near < 0.5f);
	}
	return -k;
}

/* The coordinate u of a table's node at near <= 1/2. */
static inline real table_coordinate(real near)
{
	return 2.0f * near /
	    (1.0f + sqrt(real_max(1.0f - 2.0f * near, REAL(0.0f))));
}

/* sigma and its derivatives in r, up to order, by way of v: sqrt(1 - r) = 1 - v. */
static void table_sigma(__global const float *sigma, real r, int order,
    real out[3])
{
	real s = sqrt(real_max(1.0f - r, REAL(0.0f))), at[3];

	curve_lookup(sigma, TABLE_CURVE_NODES, 1.0f, 1.0f - s, at);
	out[0] = at[0];
	out[1] = out[2] = REAL(0.0f);
	if (order < 1)
		return;
	if (ANY(s < REAL(TABLE_FOLD_FIRST))) {
		s = real_max(s, REAL(TABLE_FOLD_FIRST));
		curve_lookup(sigma, TABLE_CURVE_NODES, 1.0f, 1.0f - s, at);
	}
	out[1] = at[1] / (2.0f * s);
	if (order < 2)
		return;
	if (ANY(s < REAL(TABLE_FOLD_SECOND))) {
		s = real_max(s, REAL(TABLE_FOLD_SECOND));
		curve_lookup(sigma, TABLE_CURVE_NODES, 1.0f, 1.0f - s, at);
	}
	out[2] = (at[2] + at[1] / s) / (4.0f * s * s);
}

/*
 * The union's closed form at C >= 1/2: writes the lanes of out where it holds,
 * and returns them. Only points outside x + y = 1 there can be.
 */
static mask table_closed(__global const float *sigma, mask blend, real near,
    real far, real T, int order, struct opjet *out)
{
	real half_t = 0.5f * T, a = near - half_t, b = far - half_t;
	mask closed = blend & (b > REAL(0.0f)) &
	    (a + b >= 0.49f * (1.0f - T));
	real r, s[3], g, c, gn, gnn, gnf, T1;

	if (!ANY(closed))
		return closed;
	r = SELECT(REAL(0.0f), b / a, closed);
	table_sigma(sigma, r, order, s);
	g = half_t + a * s[0];
	closed = closed & (g >= REAL(0.5f));
	out->g = SELECT(out->g, g, closed);
	if (order < 1)
		return closed;
	gn = s[0] - r * s[1];
	T1 = 1.0f + T * T;
	out->g1 = SELECT(out->g1, gn, closed);
	out->g2 = SELECT(out->g2, s[1], closed);
	out->gt = SELECT(out->gt, 0.5f * T1 * (1.0f - gn - s[1]), closed);
	if (order < 2)
		return closed;
	c = s[2] / SELECT(REAL(1.0f), a, closed);
	gnf = -r * c;
	gnn = r * r * c;
	out->g11 = SELECT(out->g11, gnn, closed);
	out->g12 = SELECT(out->g12, gnf, closed);
	out->g22 = SELECT(out->g22, c, closed);
	out->g1t = SELECT(out->g1t, -0.5f * T1 * (gnn + gnf), closed);
	out->g2t = SELECT(out->g2t, -0.5f * T1 * (gnf + c), closed);
	out->gtt = SELECT(out->gtt, T1 * T1 * 0.25f * (gnn + 2.0f * gnf + c) +
	    T * T1 * (1.0f - gn - s[1]), closed);
	return closed;
}

/* The six second derivatives of the active lanes; the first three are stored
 * times d, gtt over e. */
static void table_second(TABLE_ARGS, __global const struct operator_desc *desc,
    mask active, real x, real y, real z, real d, real e, struct opjet *out)
{
	real n[8];

	fetch_second(TABLE_PASS, desc, active, x, y, z, n);
	d = 1.0f / d;
	out->g11 = SELECT(out->g11, n[0] * d, active);
	out->g12 = SELECT(out->g12, n[1] * d, active);
	out->g22 = SELECT(out->g22, n[2] * d, active);
	out->g1t = SELECT(out->g1t, n[3], active);
	out->g2t = SELECT(out->g2t, n[4], active);
	out->gtt = SELECT(out->gtt, n[5] * e, active);
}

/*
 * q at t between the nodes i and i + 1 of last + 1, of which edge holds q, gn,
 * gf, gt each: the cubic whose slopes dq/dv are 2 (1 - v) gf.
 */
static inline real table_q(const real edge[8], real t, real i, float last)
{
	real h = REAL(2.0f / last), left = 1.0f - i * (1.0f / last);

	return curve_hermite(edge[0], edge[4], h * left * edge[2],
	    h * (left - 1.0f / last) * edge[6], t);
}

/* The active lanes from the table's cells, with near and far for 1 and 2. */
static void table_cells(TABLE_ARGS, __global const struct operator_desc *desc,
    mask active, real near, real far, real T, real depth, int order,
    struct opjet *out)
{
	float last = (float)(desc->resolution - 1u);
	real sign = SELECT(REAL(1.0f), REAL(-1.0f), depth < 0.0f);
	real d = sign * real_max(sign * depth, REAL(TABLE_DEPTH_MIN));
	real x = 1.0f - sqrt(real_clamp((near - far) / d, REAL(0.0f),
	    REAL(1.0f)));
	real y = table_coordinate(SELECT(near, 1.0f - near, near > 0.5f));
	real z = 1.0f - sqrt(1.0f - T), n[8], part, e = near;

	if (desc->family == DESCRIPTOR_INTERSECTION) {
		y = SELECT(0.5f * y, 1.0f - 0.5f * y, near > 0.5f);
		e = near * (1.0f - near);
	}
	x *= last;
	y *= last;
	z *= last;
	fetch_edge(TABLE_PASS, desc, active, x, y, z, n);
	part = x - real_min(floor(x), REAL(last - 1.0f));
	out->g = SELECT(out->g, near + d * table_q(n, part, x - part, last),
	    active);
	if (order < 1)
		return;
	out->g1 = SELECT(out->g1, n[1] + part * (n[5] - n[1]), active);
	out->g2 = SELECT(out->g2, n[2] + part * (n[6] - n[2]), active);
	out->gt = SELECT(out->gt, e * (n[3] + part * (n[7] - n[3])), active);
	if (order > 1)
		table_second(TABLE_PASS, desc, active, x, y, z, d, e, out);
}

/* Where the warped layout and the closed form apply; 1 and 2 are near and far. */
static void table_blend(TABLE_ARGS, __global const struct operator_desc *desc,
    mask wanted, real near, real far, real theta, int order,
    struct opjet *out)
{
	__global const float *curves_of = curves + desc->silhouette;
	real T = real_min(table_tan(theta), REAL(1.0f));
	real depth = table_depth(curves_of, desc->family, near, T);
	mask blend;

	if (desc->family == DESCRIPTOR_UNION) {
		blend = wanted & (near - far < depth);
		blend = blend & !table_closed(curves_of +
		    CURVE_NODE * TABLE_SIGMA, blend, near, far, T, order, out)
		    & (near < REAL(0.5f));
	} else {
		blend = wanted & (near - far > depth) & (near < REAL(1.0f));
	}
	if (desc->layout == DESCRIPTOR_WARPED && ANY(blend))
		table_cells(TABLE_PASS, desc, blend, near, far, T, depth,
		    order, out);
}

/* Lanes within [0, 1]^2, from the paper's grid; 1 and 2 are f1 and f2. */
static mask table_uniform(TABLE_ARGS, __global const struct operator_desc *desc,
    real f1, real f2, real theta, int order, struct opjet *out)
{
	float last = (float)(desc->resolution - 1u);
	mask within = (f1 <= REAL(1.0f)) & (f2 <= REAL(1.0f));
	real x = f1 * last, y = f2 * last, z = theta * (last / QUARTER_PI), n[4];

	fetch_first(TABLE_PASS, desc, within, x, y, z, n);
	out->g = SELECT(out->g, n[0], within);
	if (order < 1)
		return within;
	out->g1 = SELECT(out->g1, n[1], within);
	out->g2 = SELECT(out->g2, n[2], within);
	out->gt = SELECT(out->gt, n[3], within);
	if (order > 1)
		table_second(TABLE_PASS, desc, within, x, y, z, REAL(1.0f),
		    REAL(1.0f), out);
	return within;
}

static inline void table_swap(real *a, real *b, mask m)
{
	real c = *a;

	*a = SELECT(c, *b, m);
	*b = SELECT(*b, c, m);
}

/*
 * g and its derivatives up to order at f1, f2 >= 0 and theta in [0, pi/4];
 * those beyond order are not to be read.
 */
static void operator_lookup(TABLE_ARGS,
    __global const struct operator_desc *desc, real f1, real f2, real theta,
    int order, struct opjet *out)
{
	int is_union = desc->family == DESCRIPTOR_UNION;
	mask swapped = is_union ? f2 > f1 : f2 < f1, within = INT(0);
	real near = SELECT(f1, f2, swapped), far = SELECT(f2, f1, swapped);
	const real zero = REAL(0.0f);
	struct opjet j = {near, REAL(1.0f), zero, zero, zero, zero, zero, zero,
		zero, zero};

	if (desc->layout == DESCRIPTOR_UNIFORM) {
		within = table_uniform(TABLE_PASS, desc, f1, f2, theta, order,
		    &j);
		swapped = swapped & !within;
	}
	if (desc->layout == DESCRIPTOR_WARPED || is_union)
		table_blend(TABLE_PASS, desc, !within, near, far, theta, order,
		    &j);
	if (order > 0)
		table_swap(&j.g1, &j.g2, swapped);
	if (order > 1) {
		table_swap(&j.g11, &j.g22, swapped);
		table_swap(&j.g1t, &j.g2t, swapped);
	}
	*out = j;
}
