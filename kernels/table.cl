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

	return x * (945.0f - s * (105.0f - s)) *
	    lanes_inverse(945.0f - s * (420.0f - 15.0f * s));
}

/* The union's boundary at c <= 1/2, T = tan(theta). */
static real table_boundary_union(__global const float *curves, real c, real T)
{
	real below = T * 0.5f, lambda, scale;
	mask curved = (c > below) & (T < REAL(1.0f));

	lambda = c;
	if (ANY(curved)) {
		lambda = curve_value(curves, TABLE_CURVE_NODES, 2.0f,
		    (2.0f * c - T) * lanes_inverse(real_max(1.0f - T, REAL(1e-7f))));
		lambda = SELECT(c, (1.0f - T) * 0.25f * lambda + below,
		    curved);
	}
	scale = lambda * lanes_inverse(1.0f + T);
	return 8.0f * T * scale * scale;
}

/* near - k(near), the depth of the blend region; below 0 for intersections. */
static real table_depth(__global const float *curves, uint family, real near,
    real T)
{
	real half_t = 0.5f * T, c, k, phi;

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
		phi = curve_value(curves, TABLE_CURVE_NODES, 2.0f, 2.0f * near);
		k = SELECT(k, (1.0f - half_t) * phi - near, near < 0.5f);
	}
	return -k;
}

/* The coordinate u of a table's node at near <= 1/2. */
static inline real table_coordinate(real near)
{
	return 2.0f * near * lanes_inverse(1.0f +
	    sqrt(real_max(1.0f - 2.0f * near, REAL(0.0f))));
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
	out[1] = at[1] * (0.5f * lanes_inverse(s));
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
	real r, s[3], g, c, gn, gnn, gnf, T1, inv_a;

	if (!ANY(closed))
		return closed;
	a = SELECT(REAL(1.0f), a, closed);
	inv_a = lanes_inverse(a);
	r = SELECT(REAL(0.0f), b * inv_a, closed);
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
	c = s[2] * inv_a;
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

/*
 * The six second derivatives of the active lanes, of nodes of the second part:
 * the first three are stored times d, gtt over e.
 */
static inline void table_second(const real n[8], mask active, real inv_d,
    real e, struct opjet *out)
{
	out->g11 = SELECT(out->g11, n[0] * inv_d, active);
	out->g12 = SELECT(out->g12, n[1] * inv_d, active);
	out->g22 = SELECT(out->g22, n[2] * inv_d, active);
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
	real inv_d = lanes_inverse(d);
	real x = 1.0f - sqrt(real_clamp((near - far) * inv_d, REAL(0.0f),
	    REAL(1.0f)));
	real y = table_coordinate(SELECT(near, 1.0f - near, near > 0.5f));
	real z = 1.0f - sqrt(1.0f - T), n[16], part, e = near;

	if (desc->family == DESCRIPTOR_INTERSECTION) {
		y = SELECT(0.5f * y, 1.0f - 0.5f * y, near > 0.5f);
		e = near * (1.0f - near);
	}
	x *= last;
	y *= last;
	z *= last;
	fetch_cells(TABLE_PASS, desc, active, x, y, z, order, n);
	part = x - real_min(floor(x), REAL(last - 1.0f));
	out->g = SELECT(out->g, near + d * table_q(n, part, x - part, last),
	    active);
	if (order < 1)
		return;
	out->g1 = SELECT(out->g1, n[1] + part * (n[5] - n[1]), active);
	out->g2 = SELECT(out->g2, n[2] + part * (n[6] - n[2]), active);
	out->gt = SELECT(out->gt, e * (n[3] + part * (n[7] - n[3])), active);
	if (order > 1)
		table_second(n + 8, active, inv_d, e, out);
}

/* Where g is not its near field, and what the tests for that have found. */
struct region {
	real near, far, theta;
	mask swapped; /* near is f2 */
	mask grid;    /* lanes of the paper's grid */
	mask blend;   /* lanes to look up, grid's too */
	real T, depth; /* elsewhere than in grid */
};

/*
 * Lanes wanted at f1, f2 >= 0 and theta in [0, pi/4]. A lane that is not in
 * blend is near's, or where it is not wanted either, nothing's.
 */
static void operator_region(__global const float *curves,
    __global const struct operator_desc *desc, mask wanted, real f1, real f2,
    real theta, struct region *r)
{
	int is_union = desc->family == DESCRIPTOR_UNION;
	real span;

	r->swapped = is_union ? f2 > f1 : f2 < f1;
	r->near = SELECT(f1, f2, r->swapped);
	r->far = SELECT(f2, f1, r->swapped);
	r->theta = theta;
	r->grid = INT(0);
	if (desc->layout == DESCRIPTOR_UNIFORM) {
		r->grid = wanted & (f1 <= REAL(1.0f)) & (f2 <= REAL(1.0f));
		wanted = wanted & !r->grid;
		r->blend = r->grid;
		if (!is_union || !ANY(wanted))
			return;
	}
	r->T = real_min(table_tan(theta), REAL(1.0f));
	r->depth = table_depth(curves + desc->silhouette, desc->family,
	    r->near, r->T);
	span = r->near - r->far;
	if (is_union)
		r->blend = r->grid | (wanted & (span < r->depth));
	else
		r->blend = wanted & (span > r->depth) &
		    (r->near < REAL(1.0f));
}

/* By the warped layout and the closed form; 1 and 2 are near and far. */
static void table_blend(TABLE_ARGS, __global const struct operator_desc *desc,
    const struct region *r, int order, struct opjet *out)
{
	mask blend = r->blend & !r->grid;

	if (!ANY(blend))
		return;
	if (desc->family == DESCRIPTOR_UNION)
		blend = blend & !table_closed(curves + desc->silhouette +
		    CURVE_NODE * TABLE_SIGMA, blend, r->near, r->far, r->T,
		    order, out) & (r->near < REAL(0.5f));
	if (desc->layout == DESCRIPTOR_WARPED && ANY(blend))
		table_cells(TABLE_PASS, desc, blend, r->near, r->far, r->T,
		    r->depth, order, out);
}

/* Lanes of the paper's grid; 1 and 2 are f1 and f2. */
static void table_uniform(TABLE_ARGS, __global const struct operator_desc *desc,
    const struct region *r, int order, struct opjet *out)
{
	float last = (float)(desc->resolution - 1u);
	real x = last * SELECT(r->near, r->far, r->swapped);
	real y = last * SELECT(r->far, r->near, r->swapped);
	real z = r->theta * (last / QUARTER_PI), n[16], part;

	if (order < 2) {
		fetch_first(TABLE_PASS, desc, r->grid, x, y, z, n);
	} else {
		fetch_cells(TABLE_PASS, desc, r->grid, x, y, z, order, n);
		part = x - real_min(floor(x), REAL(last - 1.0f));
		for (int k = 0; k < 4; k++)
			n[k] += part * (n[k + 4] - n[k]);
		table_second(n + 8, r->grid, REAL(1.0f), REAL(1.0f), out);
	}
	out->g = SELECT(out->g, n[0], r->grid);
	out->g1 = SELECT(out->g1, n[1], r->grid);
	out->g2 = SELECT(out->g2, n[2], r->grid);
	out->gt = SELECT(out->gt, n[3], r->grid);
}

static inline void table_swap(real *a, real *b, mask m)
{
	real c = *a;

	*a = SELECT(c, *b, m);
	*b = SELECT(*b, c, m);
}

/*
 * g and its derivatives up to order in a region; those beyond order are not to
 * be read. Outside the region it is near.
 */
static void operator_lookup(TABLE_ARGS,
    __global const struct operator_desc *desc, const struct region *r,
    int order, struct opjet *out)
{
	const real zero = REAL(0.0f);
	struct opjet j = {r->near, REAL(1.0f), zero, zero, zero, zero, zero,
		zero, zero, zero};

	if (desc->layout == DESCRIPTOR_WARPED ||
	    desc->family == DESCRIPTOR_UNION)
		table_blend(TABLE_PASS, desc, r, order, &j);
	if (order > 0)
		table_swap(&j.g1, &j.g2, r->swapped);
	if (order > 1) {
		table_swap(&j.g11, &j.g22, r->swapped);
		table_swap(&j.g1t, &j.g2t, r->swapped);
	}
	if (ANY(r->grid))
		table_uniform(TABLE_PASS, desc, r, order, &j);
	*out = j;
}
