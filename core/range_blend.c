/*
 * Compositions over a patch. g(f1, f2, theta) rises with both fields, and falls
 * (intersections: rises) with theta: with x, y the far and the near field's
 * place on the silhouette, dC/dk = 1 - (x + y) / |...|, and every silhouette
 * lies outside of x + y = 1. So that its bounds are g of the operands' bounds
 * at the least and the largest opening; those come from
 *   C = k(C) + |(f1 - k(C), f2 - k(C))| / s(direction),
 * whose right side falls as C rises: from a C that is too small it gives one
 * too large, and so on by turns, ever nearer.
 */
#include "core/range_parts.h"

#include <math.h>
#include <stddef.h>

#include "core/boundary.h"
#include "core/classic.h"
#include "core/operator.h"
#include "core/table.h"

/* Of g, what tables of phi and of silhouettes err: measured 3.1e-5, and 1.7e-3
 * beside the fold of a bulge. */
#define TABLE_ERROR 1e-4
#define FOLD_ERROR 2e-3

/* No field is larger, for classic operators. */
#define FIELD_MAX 1e18

static double dmax(double a, double b)
{
	return a > b ? a : b;
}

static double dmin(double a, double b)
{
	return a < b ? a : b;
}

void range_phi_table(double *out)
{
	for (int i = 0; i <= RANGE_PHI; i++) {
		double phi[3];

		boundary_phi(2.0 * i / RANGE_PHI, phi);
		out[i] = phi[0];
	}
}

static double phi_at(const double *table, double u)
{
	double x = dmin(dmax(u, 0.0), 2.0) * (RANGE_PHI / 2.0);
	int i = (int)dmin(x, RANGE_PHI - 1.0);

	return table[i] + (x - i) * (table[i + 1] - table[i]);
}

/* |(x, y)| where the silhouette meets x = r y, by halving: x - r B(x) rises. */
static double radius_at(const struct profile *profile, double r)
{
	double least = 0.0, most = 1.0, x;
	struct profile_jet b;

	for (int i = 0; i < 60; i++) {
		x = 0.5 * (least + most);
		profile_eval(profile, x, &b);
		if (x < r * b.y)
			least = x;
		else
			most = x;
	}
	profile_eval(profile, least, &b);
	return hypot(least, b.y);
}

/* The largest first derivative, by trying; it is largest at silhouettes that
 * are steep. */
static double steepest(const struct operator *op)
{
	double most = 1.0;
	const int n = 24;

	for (int i = 0; i <= 4; i++)
		for (int j = 0; j < n; j++)
			for (int k = 0; k <= j; k++) {
				struct operator_jet g;

				operator_eval(op->family, &op->profile,
				    (j + 0.5) / n, (k + 0.25) / n,
				    atan(i / 4.0), 1, &g);
				most = dmax(most, dmax(fabs(g.g1),
				    fabs(g.g2)));
			}
	return 1.25 * most;
}

/* Whether B rises anywhere on its half. */
static bool folds(const struct profile *profile)
{
	struct profile_jet last, b;

	profile_eval(profile, 0.0, &last);
	for (int i = 1; i <= 256; i++) {
		profile_eval(profile, i / 256.0, &b);
		if (i / 256.0 > b.y)
			return false;
		if (b.y > last.y + 1e-9)
			return true;
		last = b;
	}
	return false;
}

/*
 * What a device's table errs at most: as was measured with 16 nodes (the paper's
 * layout: 1.9e-2, 1.1e-1 with a bulge of K = 1; warped: 8.7e-4 and 5.9e-3), and
 * less in proportion with more. RANGE_MARGIN has room for TABLE_KNOWN of it.
 */
#define TABLE_KNOWN 1e-3

static double table_error(const struct operator *op, bool folds)
{
	double n = op->resolution > 0 ? op->resolution :
	    table_resolution(op->layout);
	double error = op->layout == LAYOUT_UNIFORM ? folds ? 0.11 : 0.019 :
	    folds ? 6e-3 : 9e-4;

	return dmax(error * 16.0 / n - TABLE_KNOWN, 0.0);
}

void range_operator_init(const struct operator *op,
    struct range_operator *out)
{
	const struct opening *o = &op->opening;

	out->is_union = op->family == FAMILY_UNION;
	out->least = tan(opening_least(o));
	out->most = dmin(1.0, tan(dmax(o->theta[0], dmax(o->theta[1],
	    o->theta[2]))));
	for (int i = 0; i <= RANGE_RAYS; i++)
		out->radius[i] = radius_at(&op->profile,
		    i / (double)RANGE_RAYS);
	out->inmost = 1.0;
	for (int i = 0; i <= RANGE_RAYS; i++)
		out->inmost = dmin(out->inmost, out->radius[i]);
	out->folds = folds(&op->profile);
	out->error = (out->folds ? FOLD_ERROR : TABLE_ERROR) +
	    table_error(op, out->folds);
	out->slope = steepest(op);
}

/* s of the direction (far, near), far <= near. */
static double radius(const struct range_operator *op, double far, double near)
{
	double r = near > 0.0 ? dmin(far / near, 1.0) * RANGE_RAYS : 0.0;
	int i = (int)dmin(dmax(r, 0.0), RANGE_RAYS - 1.0);

	return op->radius[i] + (r - i) * (op->radius[i + 1] - op->radius[i]);
}

/* k(f) of the union, m(f) of the intersection. */
static double union_boundary(const double *phi, double f, double T)
{
	double lambda = f, s = 2.0 / (1.0 + T);

	if (f >= 0.5)
		return 0.5 * T;
	if (f > 0.5 * T)
		lambda = 0.5 * T + 0.25 * (1.0 - T) *
		    phi_at(phi, 2.0 * (2.0 * f - T) / (1.0 - T));
	/* (T/2) (4 lambda / (1 + T))^2 */
	return 2.0 * T * s * s * lambda * lambda;
}

static double intersection_boundary(const double *phi, double f, double T)
{
	if (f < 0.5)
		return (1.0 - 0.5 * T) * phi_at(phi, 4.0 * f);
	return 1.0 - union_boundary(phi, 1.0 - f, T);
}

/*
 * One pair of field values: near is what g falls back to, the larger for a
 * union. s: the silhouette's distance from the origin; 0: as it is there.
 */
struct problem {
	const struct range_operator *op;
	const double *phi;
	double near, far, T, s;
};

static double boundary_of(const struct problem *p, double C)
{
	return p->op->is_union ? union_boundary(p->phi, C, p->T) :
	    intersection_boundary(p->phi, C, p->T);
}

/* The right side, of k = k(C). */
static double follow(const struct problem *p, double C)
{
	double k = boundary_of(p, C), sign = p->op->is_union ? 1.0 : -1.0;
	double x = sign * (p->far - k), y = sign * (p->near - k), s = p->s;

	if (!(x > 0.0))
		return p->near;
	if (s == 0.0)
		s = radius(p->op, x, y);
	C = k + sign * sqrt(x * x + y * y) / s;
	return sign > 0.0 ? dmax(C, p->near) : dmax(dmin(C, p->near), 0.0);
}

/* Steps, and how near is near enough. */
#define STEPS 8
#define NEAR_ENOUGH 2e-4

/* C's bounds, by halving what is left. */
static struct range solve(const struct problem *p)
{
	double C = p->near, next;
	struct range r;

	if (p->op->is_union ? p->far <= 0.0 : p->near <= 0.0 || p->near >= 1.0)
		return (struct range){C, C};
	next = follow(p, C);
	r = (struct range){dmin(C, next), dmax(C, next)};
	if (p->op->is_union && C >= 0.5) /* k is the same from there on */
		return (struct range){next, next};
	for (int i = 0; i < STEPS && r.most - r.least > NEAR_ENOUGH; i++) {
		C = 0.5 * (r.least + r.most);
		next = follow(p, C);
		r.least = dmax(r.least, dmin(C, next));
		r.most = dmin(r.most, dmax(C, next));
	}
	return r;
}

/* Of near and far values, of openings, and of silhouettes: those of the
 * direction, or any of the problem's. */
static double bound(const struct range_operator *op, const double *phi,
    double a, double b, bool upper, double s)
{
	bool unites = op->is_union;
	struct problem p = {op, phi, unites ? dmax(a, b) : dmin(a, b),
	    unites ? dmin(a, b) : dmax(a, b),
	    unites == upper ? op->least : op->most, s};
	struct range r = solve(&p);

	return upper ? r.most : r.least;
}

/* The least and the most of op->radius between r1 and r2. */
static struct range radii(const struct range_operator *op, double r1,
    double r2)
{
	int first = (int)(dmin(dmax(r1, 0.0), 1.0) * RANGE_RAYS);
	int last = (int)ceil(dmin(dmax(r2, 0.0), 1.0) * RANGE_RAYS);
	struct range out = {op->radius[first], op->radius[first]};

	for (int i = first + 1; i <= last; i++) {
		out.least = dmin(out.least, op->radius[i]);
		out.most = dmax(out.most, op->radius[i]);
	}
	return out;
}

static double ratio(double x, double y)
{
	return x <= 0.0 ? 0.0 : x >= y ? 1.0 : x / y;
}

/*
 * Where a silhouette folds g falls with the far field, beside the diagonal. But
 * C = k + |f - k|/s with a given s, but at least near, rises with both fields,
 * and falls with k and s as long as s <= sqrt(2): what s may be, between the
 * directions that there may be, is enough.
 */
static struct range directions(const struct range_operator *op,
    const double *phi, const struct held *a, const struct held *b)
{
	double x1 = dmin(a->least, b->least), x2 = dmin(a->most, b->most);
	double y1 = dmax(a->least, b->least), y2 = dmax(a->most, b->most);
	double k1, k2;

	if (op->is_union) {
		k1 = union_boundary(phi, y1, op->least);
		k2 = 0.5 * op->most;
		return radii(op, ratio(x1 - k2, y2 - k2),
		    ratio(x2 - k1, y1 - k1));
	}
	k1 = intersection_boundary(phi, bound(op, phi, a->least, b->least,
	    false, op->inmost), op->most);
	k2 = intersection_boundary(phi, x2, op->least);
	return radii(op, ratio(k1 - y2, k1 - x1), ratio(k2 - y1, k2 - x2));
}

/* Whether nothing is blended: the far field is beyond the boundary. */
static bool is_apart(const struct range_operator *op, const double *phi,
    const struct held *a, const struct held *b)
{
	if (op->is_union)
		return dmin(a->most, b->most) <= union_boundary(phi,
		    dmax(a->least, b->least), op->least) - op->error ||
		    a->most <= 0.0 || b->most <= 0.0;
	return dmax(a->least, b->least) >= intersection_boundary(phi,
	    dmin(dmin(a->most, b->most), 1.0), op->least) + op->error;
}

void range_compose(const struct range_operator *op, const double *phi,
    const struct held *a, const struct held *b, struct held *out)
{
	struct range s = {0.0, 0.0};

	if (is_apart(op, phi, a, b)) {
		(op->is_union ? range_max : range_min)(a, b, out);
		return;
	}
	if (op->folds)
		s = directions(op, phi, a, b);
	out->least = bound(op, phi, a->least, b->least, false,
	    op->is_union ? s.most : s.least);
	out->most = bound(op, phi, a->most, b->most, true,
	    op->is_union ? s.least : s.most);
	if (op->is_union) {
		out->least = dmax(out->least - op->error,
		    dmax(a->least, b->least));
		if (out->most > dmax(a->most, b->most))
			out->most += op->error;
	} else {
		if (out->least < dmin(a->least, b->least))
			out->least = dmax(out->least - op->error, 0.0);
		out->most = dmin(out->most + op->error,
		    dmin(a->most, b->most));
	}
	out->is_angled = a->is_angled || b->is_angled || op->least < op->most;
	out->fall = op->slope * (dmin(a->fall, 0.0) + dmin(b->fall, 0.0));
	out->rise = op->slope * (dmax(a->rise, 0.0) + dmax(b->rise, 0.0));
	if (op->folds) {
		double most = dmax(out->rise, -out->fall);

		out->fall = -most;
		out->rise = most;
	}
}

static double classic(OPCODE_UINT type, const double *params, double a,
    double b)
{
	struct operator_jet g;

	classic_eval(type, params, dmin(a, FIELD_MAX), dmin(b, FIELD_MAX), 0,
	    &g);
	return g.g;
}

static double least_square(double a, double b)
{
	return a <= 0.0 && b >= 0.0 ? 0.0 : dmin(a * a, b * b);
}

/*
 * R_BLEND is R_CLEAN, which is monotone, and half of a0/(1 + (F1/a1)^2 +
 * (F2/a2)^2) of its own operands. params: of either family.
 */
static void r_blend(const double *params, const struct held *a,
    const struct held *b, struct held *out)
{
	double sign = params[0] == CLASSIC_UNION ? 1.0 : -1.0, w1, w2, d1, d2;
	double x1 = (2.0 * a->least - 1.0) * params[2];
	double x2 = (2.0 * a->most - 1.0) * params[2];
	double y1 = (2.0 * b->least - 1.0) * params[3];
	double y2 = (2.0 * b->most - 1.0) * params[3];

	w1 = 1.0 + least_square(x1, x2) + least_square(y1, y2);
	w2 = 1.0 + dmax(x1 * x1, x2 * x2) + dmax(y1 * y1, y2 * y2);
	/* F of f2 held at 1, which is within these */
	if (params[0] == CLASSIC_DIFFERENCE)
		w1 = 1.0;
	d1 = sign * 0.5 * params[1] / w1;
	d2 = sign * 0.5 * params[1] / w2;
	out->least += dmin(d1, d2);
	out->most += dmax(d1, d2);
}

/*
 * How steep at most: arcs that join the axes' directions, and powers' means, are
 * at most 1 in either field; R-functions 2, and what is displaced adds 2 a0 a/(1
 * + a^2)^2 of F/a; powers are steepest where both fields are largest.
 */
static double classic_slope(OPCODE_UINT type, const double *params, double a,
    double b)
{
	struct operator_jet g;

	switch (type) {
	case CLASSIC_R_CLEAN:
		return 2.0;
	case CLASSIC_R_BLEND:
		return 2.0 + 0.66 * fabs(params[1]) *
		    dmax(params[2], params[3]);
	case CLASSIC_SUPER_ELLIPTIC:
		return params[3] * dmax(params[1] *
		    pow(1.0 + params[1], params[3] - 1.0), params[2] *
		    pow(1.0 + params[2], params[3] - 1.0));
	case CLASSIC_POWER_DIFFERENCE:
		classic_eval(type, params, dmin(a + 1e9, FIELD_MAX),
		    dmin(b, FIELD_MAX), 1, &g);
		return dmax(1.0, fabs(g.g2));
	}
	return 1.0;
}

void range_classic(OPCODE_UINT type, const double *params,
    const struct held *a, const struct held *b, struct held *out)
{
	bool falls = params[0] == CLASSIC_DIFFERENCE;
	double clean[CLASSIC_PARAMS_MAX] = {params[0]};
	const double *p = type == CLASSIC_R_BLEND ? clean : params;
	OPCODE_UINT as = type == CLASSIC_R_BLEND ? CLASSIC_R_CLEAN : type;
	struct held f2;
	double slope;

	*out = (struct held){
	    classic(as, p, a->least, falls ? b->most : b->least),
	    classic(as, p, a->most, falls ? b->least : b->most), 0.0, 0.0,
	    a->is_angled || b->is_angled};
	slope = classic_slope(type, params, a->most, b->most);
	f2 = falls ? (struct held){.fall = -b->rise, .rise = -b->fall} : *b;
	out->fall = slope * (dmin(a->fall, 0.0) + dmin(f2.fall, 0.0));
	out->rise = slope * (dmax(a->rise, 0.0) + dmax(f2.rise, 0.0));
	if (type == CLASSIC_R_BLEND) {
		/* what was cut at 0 may be anything below */
		if (out->least <= 0.0)
			out->least = -INFINITY;
		r_blend(params, a, b, out);
		out->least = dmax(out->least, 0.0);
		out->most = dmax(out->most, 0.0);
		/* what is displaced may fall as either field rises */
		out->rise = dmax(out->rise, -out->fall);
		out->rise = dmax(out->rise, slope * (dmax(-a->fall, 0.0) +
		    dmax(-f2.fall, 0.0)));
		out->fall = -out->rise;
	}
}
