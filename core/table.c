#include "core/table.h"

#include <math.h>
#include <stdint.h>
#include <stdlib.h>
#include <string.h>

#include "core/boundary.h"
#include "core/curve.h"

#define QUARTER_PI 0.78539816339744830962

/* Nodes keep this far inside the ends of their coordinates, where near, D or
 * 1 - T vanish and the limit is what is wanted. */
#define MARGIN 1e-6

/* Where a blend is: near and far in place of f1 and f2. */
struct spot {
	double near, far, T;
	double depth; /* D = near - k(near) */
};

enum err table_create(enum operator_family family,
    const struct profile *profile, enum table_layout layout, int resolution,
    struct table **out)
{
	size_t n = (size_t)resolution;
	struct table *t = calloc(1, sizeof(*t));

	if (!t)
		return ERR_MEMORY;
	t->family = family;
	t->profile = *profile;
	t->layout = layout;
	t->resolution = resolution;
	t->node_count = n * n * n;
	t->first = malloc(table_bytes(t));
	if (!t->first) {
		table_free(t);
		return ERR_MEMORY;
	}
	t->second = t->first + t->node_count * TABLE_FIRST;
	t->curves = t->second + t->node_count * TABLE_SECOND;
	*out = t;
	return ERR_OK;
}

void table_free(struct table *t)
{
	if (!t)
		return;
	free(t->first);
	free(t);
}

size_t table_bytes_first(const struct table *t)
{
	return t->node_count * TABLE_FIRST * sizeof(float);
}

size_t table_bytes(const struct table *t)
{
	return (t->node_count * (TABLE_FIRST + TABLE_SECOND) +
	    2 * TABLE_CURVE_NODES * CURVE_NODE) * sizeof(float);
}

static double boundary(const struct table *t, double near, double T)
{
	struct boundary_jet k;

	if (t->family == FAMILY_UNION)
		boundary_union(near, T, &k);
	else
		boundary_intersection(near, T, &k);
	return k.k;
}

/* (1 - (1-u)^2)/2 and its inverse: [0,1] <-> [0,1/2], dense towards 1/2. */
static double near_of(double u)
{
	return 0.5 * u * (2.0 - u);
}

static double near_to(double near)
{
	return 2.0 * near / (1.0 + sqrt(fmax(0.0, 1.0 - 2.0 * near)));
}

static double field_of(enum operator_family family, double u)
{
	if (family == FAMILY_UNION)
		return near_of(u);
	return u <= 0.5 ? near_of(2.0 * u) : 1.0 - near_of(2.0 - 2.0 * u);
}

static double field_to(enum operator_family family, double near)
{
	if (family == FAMILY_UNION)
		return near_to(near);
	return near <= 0.5 ? 0.5 * near_to(near) :
	    1.0 - 0.5 * near_to(1.0 - near);
}

/* The node's place, kept off the ends and off the line near = 1/2, which the
 * regions' corners touch. */
static void place_node(const struct table *t, int it, int iu, int iv,
    struct spot *out)
{
	double last = t->resolution - 1, v = iv / last, z = it / last;
	double near = field_of(t->family, iu / last);
	double most = t->family == FAMILY_UNION ? 0.5 : 1.0;

	near = fmin(fmax(near, MARGIN), most - MARGIN);
	if (fabs(near - 0.5) < MARGIN)
		near = 0.5 - MARGIN;
	out->near = near;
	out->T = fmin(z * (2.0 - z), 1.0 - MARGIN);
	out->depth = near - boundary(t, near, out->T);
	out->far = near - out->depth * (1.0 - v) * (1.0 - v);
	if (iv == t->resolution - 1)
		out->far = near;
}

/* E of table_shape.h */
static double theta_scale(enum operator_family family, double near)
{
	return family == FAMILY_UNION ? near : near * (1.0 - near);
}

static void fill_warped(const struct table *t, int it, int iu, int iv,
    float first[static TABLE_FIRST], float second[static TABLE_SECOND])
{
	struct operator_jet j;
	struct spot s;
	double d, e;

	place_node(t, it, iu, iv, &s);
	d = s.depth;
	e = theta_scale(t->family, s.near);
	operator_eval(t->family, &t->profile, s.near, s.far, atan(s.T), 2, &j);
	first[0] = (float)((j.g - s.near) / d);
	first[1] = (float)j.g1;
	first[2] = (float)j.g2;
	first[3] = (float)(j.gt / e);
	second[0] = (float)(d * j.g11);
	second[1] = (float)(d * j.g12);
	second[2] = (float)(d * j.g22);
	second[3] = (float)j.g1t;
	second[4] = (float)j.g2t;
	second[5] = (float)(j.gtt / e);
	second[6] = second[7] = 0.0f;
}

static void fill_uniform(const struct table *t, int it, int iu, int iv,
    float first[static TABLE_FIRST], float second[static TABLE_SECOND])
{
	double last = t->resolution - 1;
	struct operator_jet j;

	operator_eval(t->family, &t->profile, iv / last, iu / last,
	    QUARTER_PI * it / last, 2, &j);
	first[0] = (float)j.g;
	first[1] = (float)j.g1;
	first[2] = (float)j.g2;
	first[3] = (float)j.gt;
	second[0] = (float)j.g11;
	second[1] = (float)j.g12;
	second[2] = (float)j.g22;
	second[3] = (float)j.g1t;
	second[4] = (float)j.g2t;
	second[5] = (float)j.gtt;
	second[6] = second[7] = 0.0f;
}

/*
 * sigma(r) is the union of 1 and r at theta = 0, where k = 0. Over v, with
 * s = 1 - v and r = 1 - s^2, its slope is 2 s sigma', which stays finite.
 */
static void fill_curve(const struct table *t, int i,
    float phi[static CURVE_NODE], float sigma[static CURVE_NODE])
{
	double x = (double)i / (TABLE_CURVE_NODES - 1), p[3], s = 1.0 - x;
	struct operator_jet j;

	boundary_phi(2.0 * x, p);
	operator_eval(FAMILY_UNION, &t->profile, 1.0, 1.0 - s * s, 0.0, 2, &j);
	for (int k = 0; k < 3; k++)
		phi[k] = (float)p[k];
	sigma[0] = (float)j.g;
	sigma[1] = (float)(2.0 * s * j.g2);
	sigma[2] = (float)(4.0 * s * s * j.g22 - 2.0 * j.g2);
	phi[3] = sigma[3] = 0.0f;
}

/* Node number i. */
static void fill_node(const struct table *t, size_t i,
    float first[static TABLE_FIRST], float second[static TABLE_SECOND])
{
	size_t n = (size_t)t->resolution;
	int it = (int)(i / (n * n)), iu = (int)(i / n % n), iv = (int)(i % n);

	if (t->layout == LAYOUT_WARPED)
		fill_warped(t, it, iu, iv, first, second);
	else
		fill_uniform(t, it, iu, iv, first, second);
}

void table_build(struct table *t, int first, int last)
{
	size_t slice = (size_t)t->resolution * (size_t)t->resolution;

	for (int i = 0; first == 0 && i < TABLE_CURVE_NODES; i++)
		fill_curve(t, i, t->curves + CURVE_NODE * (TABLE_PHI + i),
		    t->curves + CURVE_NODE * (TABLE_SIGMA + i));
	for (size_t i = (size_t)first * slice; i < (size_t)last * slice; i++)
		fill_node(t, i, t->first + i * TABLE_FIRST,
		    t->second + i * TABLE_SECOND);
}

/*
 * Whether none of x is Inf or NaN, whose exponents are all ones: one more in
 * that place overflows into the sign's. By the piece, which compilers turn into
 * vectors.
 */
static bool are_finite(const float *x, size_t count)
{
	enum { PIECE = 64 };
	uint32_t bits[PIECE], over = 0;

	for (; count >= PIECE; x += PIECE, count -= PIECE) {
		memcpy(bits, x, sizeof(bits));
		for (int k = 0; k < PIECE; k++)
			over |= (bits[k] & 0x7fffffff) + 0x00800000;
	}
	memcpy(bits, x, count * sizeof(*x));
	for (size_t k = 0; k < count; k++)
		over |= (bits[k] & 0x7fffffff) + 0x00800000;
	return (over & 0x80000000) == 0;
}

static bool is_node(const struct table *t, size_t i)
{
	float first[TABLE_FIRST], second[TABLE_SECOND];

	fill_node(t, i, first, second);
	return memcmp(first, t->first + i * TABLE_FIRST, sizeof(first)) == 0 &&
	    memcmp(second, t->second + i * TABLE_SECOND, sizeof(second)) == 0;
}

static bool is_curve(const struct table *t, int i)
{
	float phi[CURVE_NODE], sigma[CURVE_NODE];

	fill_curve(t, i, phi, sigma);
	return memcmp(phi, t->curves + CURVE_NODE * (TABLE_PHI + i),
	    sizeof(phi)) == 0 && memcmp(sigma, t->curves + CURVE_NODE *
	    (TABLE_SIGMA + i), sizeof(sigma)) == 0;
}

bool table_verify(const struct table *t, int count)
{
	/* By the golden section: as evenly spread as can be, whatever count. */
	static const double step = 0.61803398874989484820;

	if (!are_finite(t->first, table_bytes(t) / sizeof(float)))
		return false;
	for (int i = 0; i < count; i++) {
		double part = fmod(step * (i + 1), 1.0);

		if (!is_node(t, (size_t)(part * (double)t->node_count)) ||
		    !is_curve(t, (int)(part * TABLE_CURVE_NODES)))
			return false;
	}
	return true;
}

/* A cell and the place in it, from a coordinate in [0, 1]. */
static int cell_of(double x, int nodes, double *part)
{
	double at = fmin(fmax(x, 0.0), 1.0) * (nodes - 1);
	int i = (int)at;

	if (i > nodes - 2)
		i = nodes - 2;
	*part = at - i;
	return i;
}

/*
 * Both planes v = iv and iv + 1 of a part, linear in u and z, into low and
 * high: count floats each, of stride floats a node.
 */
static void gather(const struct table *t, const float *part, int count,
    int stride, const int cell[static 3], const double at[static 3],
    double *low, double *high)
{
	size_t n = (size_t)t->resolution;

	for (int k = 0; k < count; k++)
		low[k] = high[k] = 0.0;
	for (int c = 0; c < 4; c++) {
		int du = c & 1, dt = c >> 1;
		double w = (du ? at[1] : 1.0 - at[1]) * (dt ? at[2] : 1.0 - at[2]);
		size_t i = ((size_t)(cell[2] + dt) * n + (size_t)(cell[1] + du)) * n
		    + (size_t)cell[0];
		const float *p = part + i * (size_t)stride;

		for (int k = 0; k < count; k++) {
			low[k] += w * p[k];
			high[k] += w * p[k + stride];
		}
	}
}

static double lerp(double a, double b, double x)
{
	return a + x * (b - a);
}

/* Value and two derivatives of one of t's curves at x in [0, 1]. */
static void lookup_curve(const struct table *t, int curve, double length,
    double x, double out[static 3])
{
	curve_lookup(t->curves + CURVE_NODE * curve, TABLE_CURVE_NODES, length,
	    x, out);
}

/* From derivatives in T = tan(theta) to theta. */
static void to_theta(double T, struct operator_jet *j)
{
	double T1 = 1.0 + T * T;

	j->gtt = j->gtt * T1 * T1 + j->gt * 2.0 * T * T1;
	j->gt *= T1;
	j->g1t *= T1;
	j->g2t *= T1;
}

/* sigma and its derivatives in r = b/a, by way of v. */
static void lookup_sigma(const struct table *t, double r, double out[static 3])
{
	double s = sqrt(fmax(0.0, 1.0 - r)), at[3];

	lookup_curve(t, TABLE_SIGMA, 1.0, 1.0 - s, at);
	out[0] = at[0];
	if (s < TABLE_FOLD_FIRST) {
		s = TABLE_FOLD_FIRST;
		lookup_curve(t, TABLE_SIGMA, 1.0, 1.0 - s, at);
	}
	out[1] = at[1] / (2.0 * s);
	if (s < TABLE_FOLD_SECOND) {
		s = TABLE_FOLD_SECOND;
		lookup_curve(t, TABLE_SIGMA, 1.0, 1.0 - s, at);
	}
	out[2] = (at[2] + at[1] / s) / (4.0 * s * s);
}

/*
 * g = T/2 + a sigma(r), r = b/a, homogeneous of degree 1 in a and b, each of
 * which moves by -1/2 with T. False, and *out untouched, if g < 1/2, where this is not
 * the operator.
 */
static bool closed_form(const struct table *t, const struct spot *p,
    struct operator_jet *out)
{
	double a = p->near - p->T / 2, r = (p->far - p->T / 2) / a, s[3], g, c;

	if (!(a > 0.0 && r > 0.0))
		return false;
	lookup_sigma(t, r, s);
	g = p->T / 2 + a * s[0];
	if (g < 0.5)
		return false;
	c = s[2] / a;
	*out = (struct operator_jet){.g = g, .g1 = s[0] - r * s[1], .g2 = s[1],
	    .g11 = r * r * c, .g12 = -r * c, .g22 = c};
	out->gt = 0.5 * (1.0 - out->g1 - out->g2);
	out->g1t = -0.5 * (out->g11 + out->g12);
	out->g2t = -0.5 * (out->g12 + out->g22);
	out->gtt = 0.25 * (out->g11 + 2.0 * out->g12 + out->g22);
	to_theta(p->T, out);
	return true;
}

static void lookup_cells(const struct table *t, const struct spot *p,
    struct operator_jet *out)
{
	double v1 = sqrt(fmax(0.0, (p->near - p->far) / p->depth)); /* 1 - v */
	double a[TABLE_SECOND], b[TABLE_SECOND], at[3], h, x;
	double e = theta_scale(t->family, p->near);
	int n = t->resolution, cell[3];

	cell[0] = cell_of(1.0 - v1, n, &at[0]);
	cell[1] = cell_of(field_to(t->family, p->near), n, &at[1]);
	cell[2] = cell_of(1.0 - sqrt(1.0 - p->T), n, &at[2]);
	x = at[0];
	gather(t, t->first, TABLE_FIRST, TABLE_FIRST, cell, at, a, b);
	/* dq/dv = gf dw/dv with dw/dv = 2 (1 - v), per cell of width h. */
	h = 1.0 / (n - 1);
	out->g = p->near + p->depth * curve_hermite(a[0], b[0],
	    2.0 * (1.0 - cell[0] * h) * h * a[2],
	    2.0 * (1.0 - (cell[0] + 1) * h) * h * b[2], x);
	out->g1 = lerp(a[1], b[1], x);
	out->g2 = lerp(a[2], b[2], x);
	out->gt = e * lerp(a[3], b[3], x);
	gather(t, t->second, 6, TABLE_SECOND, cell, at, a, b);
	out->g11 = lerp(a[0], b[0], x) / p->depth;
	out->g12 = lerp(a[1], b[1], x) / p->depth;
	out->g22 = lerp(a[2], b[2], x) / p->depth;
	out->g1t = lerp(a[3], b[3], x);
	out->g2t = lerp(a[4], b[4], x);
	out->gtt = e * lerp(a[5], b[5], x);
}

/* k or m at near, from the curve of phi, as a device does. */
static double lookup_boundary(const struct table *t, double near, double T)
{
	double c = near, l, u, phi[3];

	if (t->family == FAMILY_INTERSECTION) {
		if (near < 0.5) {
			lookup_curve(t, TABLE_PHI, 2.0, 2.0 * near, phi);
			return (1.0 - T / 2) * phi[0];
		}
		c = 1.0 - near;
	}
	l = fmin(c, 0.5);
	if (l > T / 2 && T < 1.0) {
		u = 2.0 * (2.0 * l - T) / (1.0 - T);
		lookup_curve(t, TABLE_PHI, 2.0, u / 2, phi);
		l = (1.0 - T) / 4 * phi[0] + T / 2;
	}
	l = c >= 0.5 ? T / 2 : 8.0 * T * l * l / ((1.0 + T) * (1.0 + T));
	return t->family == FAMILY_UNION ? l : 1.0 - l;
}

static void lookup_warped(const struct table *t, struct spot *p,
    struct operator_jet *out)
{
	bool is_union = t->family == FAMILY_UNION;

	if (!is_union && p->near >= 1.0)
		return;
	p->depth = p->near - lookup_boundary(t, p->near, p->T);
	if (is_union ? p->near - p->far >= p->depth :
	    p->near - p->far <= p->depth)
		return;
	if (is_union && closed_form(t, p, out))
		return;
	if (is_union && p->near >= 0.5)
		return;
	if (fabs(p->depth) < TABLE_DEPTH_MIN)
		p->depth = copysign(TABLE_DEPTH_MIN, p->depth);
	lookup_cells(t, p, out);
}

static void lookup_uniform(const struct table *t, double f1, double f2,
    double theta, struct operator_jet *out)
{
	double a[TABLE_SECOND], b[TABLE_SECOND], at[3];
	int cell[3];

	cell[0] = cell_of(f1, t->resolution, &at[0]);
	cell[1] = cell_of(f2, t->resolution, &at[1]);
	cell[2] = cell_of(theta / QUARTER_PI, t->resolution, &at[2]);
	gather(t, t->first, TABLE_FIRST, TABLE_FIRST, cell, at, a, b);
	for (int k = 0; k < TABLE_FIRST; k++)
		a[k] = lerp(a[k], b[k], at[0]);
	*out = (struct operator_jet){.g = a[0], .g1 = a[1], .g2 = a[2],
	    .gt = a[3]};
	gather(t, t->second, 6, TABLE_SECOND, cell, at, a, b);
	for (int k = 0; k < 6; k++)
		a[k] = lerp(a[k], b[k], at[0]);
	out->g11 = a[0];
	out->g12 = a[1];
	out->g22 = a[2];
	out->g1t = a[3];
	out->g2t = a[4];
	out->gtt = a[5];
}

static void swap(double *a, double *b)
{
	double c = *a;

	*a = *b;
	*b = c;
}

void table_lookup(const struct table *t, double f1, double f2, double theta,
    int order, struct operator_jet *out)
{
	bool second_is_near = t->family == FAMILY_UNION ? f2 > f1 : f2 < f1;
	struct spot p = {second_is_near ? f2 : f1, second_is_near ? f1 : f2,
	    fmin(tan(fmin(fmax(theta, 0.0), QUARTER_PI)), 1.0), 0.0};

	*out = (struct operator_jet){.g = p.near, .g1 = 1.0};
	if (t->layout == LAYOUT_UNIFORM && fmax(f1, f2) <= 1.0) {
		lookup_uniform(t, f1, f2, theta, out);
		second_is_near = false;
	} else if (t->layout == LAYOUT_WARPED || t->family == FAMILY_UNION) {
		lookup_warped(t, &p, out);
	}
	if (second_is_near) {
		swap(&out->g1, &out->g2);
		swap(&out->g11, &out->g22);
		swap(&out->g1t, &out->g2t);
	}
	if (order < 2)
		out->g11 = out->g12 = out->g22 = out->g1t = out->g2t =
		    out->gtt = 0.0;
	if (order < 1)
		out->g1 = out->g2 = out->gt = 0.0;
}

/*
 * Point i of the sample: the R3 sequence (M. Roberts 2018), whose steps are
 * powers of 1/rho, rho^4 = rho + 1, taken mod 1.
 */
static void sample_point(size_t i, double out[static 3])
{
	static const double rho = 1.22074408460575947536;
	double step = 1.0, whole;

	for (int k = 0; k < 3; k++) {
		step /= rho;
		out[k] = modf(0.5 + step * (double)(i + 1), &whole);
	}
	out[2] *= QUARTER_PI;
}

void table_measure(const struct table *t, size_t first, size_t last,
    float *errors, size_t stride)
{
	for (size_t i = first; i < last; i++) {
		struct operator_jet got, want;
		const double *a = &got.g, *b = &want.g;
		double f[3];

		sample_point(i, f);
		table_lookup(t, f[0], f[1], f[2], 2, &got);
		operator_eval(t->family, &t->profile, f[0], f[1], f[2], 2, &want);
		for (size_t k = 0; k < TABLE_QUANTITIES; k++)
			errors[k * stride + i] = (float)fabs(a[k] - b[k]);
	}
}

void table_sample(enum operator_family family, const struct profile *profile,
    size_t first, size_t last, double *g)
{
	for (size_t i = first; i < last; i++) {
		struct operator_jet j;
		double f[3];

		sample_point(i, f);
		operator_eval(family, profile, f[0], f[1], f[2], 0, &j);
		g[i] = j.g;
	}
}

double table_measure_g(const struct table *t, size_t first, size_t last,
    const double *exact, double *sum)
{
	double most = 0.0;

	for (size_t i = first; i < last; i++) {
		struct operator_jet j;
		double f[3], error;

		sample_point(i, f);
		table_lookup(t, f[0], f[1], f[2], 0, &j);
		error = fabs(j.g - exact[i]);
		most = fmax(most, error);
		*sum += error;
	}
	return most;
}

/* Hoare's selection: x[rank] ends where sorting would put it. */
static float select_rank(float *x, size_t count, size_t rank)
{
	size_t low = 0, high = count - 1;

	while (low < high) {
		float pivot = x[low + (high - low) / 2];
		size_t i = low, j = high;

		for (;;) {
			while (x[i] < pivot)
				i++;
			while (x[j] > pivot)
				j--;
			if (i >= j)
				break;
			float swapped = x[i];

			x[i++] = x[j];
			x[j--] = swapped;
		}
		if (rank <= j)
			high = j;
		else
			low = j + 1;
	}
	return x[rank];
}

void table_error_summarise(float *errors, size_t stride, size_t count,
    struct table_error *out)
{
	*out = (struct table_error){.count = count};
	for (size_t k = 0; k < TABLE_QUANTITIES && count > 0; k++) {
		float *column = errors + k * stride;
		double sum = 0.0;

		for (size_t i = 0; i < count; i++) {
			sum += column[i];
			out->max[k] = fmax(out->max[k], column[i]);
		}
		out->mean[k] = sum / (double)count;
		out->p99[k] = select_rank(column, count, (count - 1) * 99 / 100);
	}
}
