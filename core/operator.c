/*
 * Both families are one problem. Let "near" be the field that g falls back to
 * (the larger for the union, the smaller for the intersection), "far" the
 * other, and k the family's boundary. g is the C at which
 *   x = (far - k(C))/(C - k(C)),  y = (near - k(C))/(C - k(C))
 * lies on the silhouette, y = B(x). y - B(x) is positive at C = near and falls
 * monotonically to the C at which k(C) = far, where x = 0 and y < 1.
 *
 * k needs phi, an inverse. Instead of solving for C, and for phi at each step,
 * the search runs along phi's own argument: u = t + eta(t) and phi(u) = t are
 * both explicit in t, and since (t, 1 - eta(t)) is symmetric about the
 * diagonal, in s = 1 - eta(t) as well, which stays well-conditioned where t
 * does not. The curve C -> k(C) thus falls into arcs, explicit in a parameter.
 *
 * For the intersection above 1/2, m(C) = 1 - k(1 - C), so that g =
 * 1 - union(1 - f1, 1 - f2) there.
 */
#include "core/operator.h"

#include <math.h>
#include <stddef.h>

#include "core/boundary.h"

#define QUARTER_PI 0.78539816339744830962

/* Fields below this are not blended: it changes g by no more than this, and
 * g'', which grows as 1/f, stays finite. */
#define FIELD_MIN 1e-20

/* |dG/dC| is held above this, and so first derivatives below its inverse: only
 * the fold of bulge with K over 0.99 comes near, where they have no bound. */
#define STEEPEST 1e-2

/* phi(0) unclamped, -eta(0): where an arc in t or s begins. */
#define ARC_START -2.6e-7

enum arc {
	ARC_LINEAR, /* union, C <= T/2: the parameter is C itself */
	ARC_T,      /* the parameter is t = phi(u), u <= 1 */
	ARC_S,      /* the parameter is s = 1 - eta(t), u >= 1 */
	ARC_CONST   /* union, C >= 1/2: the parameter is C, k = T/2 */
};

struct problem {
	enum operator_family family;
	const struct profile *profile;
	double T;
	double near, far;
};

/* A point of the curve C -> k(C), with derivatives along the arc. */
struct arc_point {
	double C, k, C1, k1;
};

/* Where g is: C and k(C), and where on which arc. */
struct root {
	enum arc arc;
	double q, C, k;
};

static void arc_eval(const struct problem *p, enum arc arc, double q,
    struct arc_point *out)
{
	double T = p->T, s = 8.0 * T / ((1.0 + T) * (1.0 + T));
	double eta[3], u, u1, t, t1, lambda;

	if (arc == ARC_CONST) {
		*out = (struct arc_point){q, T / 2, 1.0, 0.0};
		return;
	}
	if (arc == ARC_LINEAR) {
		*out = (struct arc_point){q, s * q * q, 1.0, 2.0 * s * q};
		return;
	}
	profile_eta(q, eta);
	u = q + eta[0];
	u1 = 1.0 + eta[1];
	t = q;
	t1 = 1.0;
	if (arc == ARC_S) {
		/* t = 1 - eta(s), eta(t) = 1 - s */
		u = 2.0 - u;
		u1 = -u1;
		t = 1.0 - eta[0];
		t1 = -eta[1];
	}
	if (p->family == FAMILY_INTERSECTION) {
		*out = (struct arc_point){u / 4, (1.0 - T / 2) * t, u1 / 4,
		    (1.0 - T / 2) * t1};
		return;
	}
	lambda = T / 2 + (1.0 - T) / 4 * t;
	out->C = T / 2 + (1.0 - T) / 4 * u;
	out->C1 = (1.0 - T) / 4 * u1;
	out->k = s * lambda * lambda;
	out->k1 = 2.0 * s * lambda * (1.0 - T) / 4 * t1;
}

/* y - B(x) at a point of an arc, and its derivative along the arc. */
static double residual(const struct problem *p, const struct arc_point *a,
    double *slope)
{
	double d = a->C - a->k, x = (p->far - a->k) / d, y = (p->near - a->k) / d;
	double d1 = a->C1 - a->k1;
	double x1 = (-a->k1 - x * d1) / d, y1 = (-a->k1 - y * d1) / d;
	struct profile_jet b;

	profile_eval(p->profile, x, &b);
	*slope = y1 - b.slope * x1;
	return y - b.y;
}

static double residual_at(const struct problem *p, enum arc arc, double q)
{
	struct arc_point a;
	double slope;

	arc_eval(p, arc, q, &a);
	return residual(p, &a, &slope);
}

/*
 * The root between q = inside (residual >= 0) and q = outside (<= 0), by
 * Newton's steps from start, halving the bracket instead whenever a step would
 * leave it or is more than half the one before. Both ends close in, so it
 * always ends.
 */
static void solve(const struct problem *p, enum arc arc, double inside,
    double outside, double start, struct root *out)
{
	double q = start, last = fabs(outside - inside), f, slope, next;
	struct arc_point a;

	for (int i = 0; i < 200; i++) {
		arc_eval(p, arc, q, &a);
		f = residual(p, &a, &slope);
		if (f > 0.0)
			inside = q;
		else
			outside = q;
		next = q - f / slope;
		if (fabs(next - q) <= 1e-16 || fabs(inside - outside) <= 1e-16)
			break;
		if (!(next >= fmin(inside, outside) &&
		    next <= fmax(inside, outside)) || fabs(next - q) > 0.5 * last)
			next = inside + 0.5 * (outside - inside);
		last = fabs(next - q);
		q = next;
		/* Newton's next step would be about the square of this one. */
		if (last <= 1e-10 && last < 1e-3 * fabs(inside - outside)) {
			arc_eval(p, arc, q, &a);
			break;
		}
	}
	*out = (struct root){arc, q, a.C, a.k};
}

/* phi(1): the arcs in t and s meet where u = 1. */
static double at_most_diagonal(double u)
{
	return u < PROFILE_DIAGONAL ? u : PROFILE_DIAGONAL;
}

/*
 * Along the arcs in t and s, of which u = t + eta(t) is given where C is the
 * near field (below 0 if that lies before the arcs). eta is small: u is close
 * to t, and 2 - u to s, and a start need not be more.
 */
static void solve_union_curved(const struct problem *p, double u_near,
    struct root *out)
{
	if (u_near < 1.0 && residual_at(p, ARC_T, PROFILE_DIAGONAL) <= 0.0)
		solve(p, ARC_T, ARC_START, PROFILE_DIAGONAL,
		    at_most_diagonal(fmax(u_near, ARC_START)), out);
	else
		solve(p, ARC_S, PROFILE_DIAGONAL, ARC_START,
		    at_most_diagonal(2.0 - u_near), out);
}

static void solve_union(const struct problem *p, struct root *out)
{
	double T = p->T, least = fmax(p->near, 0.5);

	if (p->near >= 0.5 || residual_at(p, ARC_CONST, 0.5) >= 0.0) {
		/* The silhouette keeps outside x + y = 1. */
		solve(p, ARC_CONST, least, 2.0 * (p->near + p->far), least, out);
		return;
	}
	if (p->near < T / 2 && residual_at(p, ARC_LINEAR, T / 2) <= 0.0) {
		solve(p, ARC_LINEAR, p->near, T / 2, p->near, out);
		return;
	}
	solve_union_curved(p, 2.0 * (2.0 * p->near - T) / (1.0 - T), out);
}

/* Only for g < 1/2. u runs down from near to where m(C) = far (x = 0). */
static void solve_intersection(const struct problem *p, struct root *out)
{
	double t_far = p->far / (1.0 - p->T / 2), eta[3];
	double u_near = fmin(4.0 * p->near, 2.0), outside;

	if (t_far < PROFILE_DIAGONAL && (u_near <= 1.0 ||
	    residual_at(p, ARC_T, PROFILE_DIAGONAL) >= 0.0)) {
		solve(p, ARC_T, PROFILE_DIAGONAL, t_far,
		    at_most_diagonal(fmax(u_near, t_far)), out);
		return;
	}
	/* In s = 1 - eta(t), which falls as C rises. */
	outside = PROFILE_DIAGONAL;
	if (t_far > PROFILE_DIAGONAL && t_far < 1.0) {
		profile_eta(t_far, eta);
		outside = 1.0 - eta[0];
	}
	solve(p, ARC_S, ARC_START, outside, fmin(2.0 - u_near, outside), out);
}

/* The boundary's jet at a root; on the arcs phi is known without solving. */
static void boundary_at(const struct problem *p, const struct root *root,
    struct boundary_jet *out)
{
	double eta[3], phi[3];

	if (root->arc == ARC_CONST || root->arc == ARC_LINEAR) {
		boundary_union(root->C, p->T, out);
		return;
	}
	profile_eta(root->q, eta);
	if (root->arc == ARC_T)
		boundary_phi_rising(root->q, eta, phi);
	else
		boundary_phi_falling(eta, phi);
	if (p->family == FAMILY_UNION)
		boundary_union_by_phi(root->C, p->T, phi, out);
	else
		boundary_intersection_by_phi(p->T, phi, out);
}

/*
 * Derivatives at the root, by the implicit function theorem. With P = near - k,
 * p = far - k, D = C - k, the condition is G = P - D B(p/D) = 0, and
 *   G_i  = P_i - B' p_i + (x B' - B) D_i
 *   G_ij = -(B''/D) q_i q_j - S k_ij,  q = p_i - x D_i,
 *   S    = 1 - B' - B + x B'
 * over the variables near, far, T, C. Then C_i = -G_i/G_C and C_ij =
 * -(G_ij + G_iC C_j + G_jC C_i + G_CC C_i C_j)/G_C.
 */
static void differentiate(const struct problem *problem,
    const struct root *root, int order, struct operator_jet *out)
{
	double D = root->C - root->k, x = (problem->far - root->k) / D;
	double G[4], q[4], GG[4][4], d[3], S;
	struct boundary_jet b;
	struct profile_jet B;

	boundary_at(problem, root, &b);
	profile_eval(problem->profile, x, &B);
	S = 1.0 - B.slope - B.y + x * B.slope;
	G[0] = 1.0;
	G[1] = -B.slope;
	G[2] = -b.kt * S;
	G[3] = -b.kf * S + x * B.slope - B.y;
	/* On the fold of bulge with K = 1 the silhouette runs along the ray. */
	if (fabs(G[3]) < STEEPEST)
		G[3] = copysign(STEEPEST, G[3]);
	for (int i = 0; i < 3; i++)
		d[i] = -G[i] / G[3];
	out->g1 = d[0];
	out->g2 = d[1];
	out->gt = d[2];
	if (order < 2)
		return;
	q[0] = 0.0;
	q[1] = 1.0;
	q[2] = -b.kt * (1.0 - x);
	q[3] = -b.kf * (1.0 - x) - x;
	for (int i = 0; i < 4; i++)
		for (int j = 0; j < 4; j++)
			GG[i][j] = -B.bend / D * q[i] * q[j];
	GG[2][2] -= S * b.ktt;
	GG[2][3] -= S * b.kft;
	GG[3][3] -= S * b.kff;
#define SECOND(i, j) (-(GG[i][j] + GG[i][3] * d[j] + GG[j][3] * d[i] + \
    GG[3][3] * d[i] * d[j]) / G[3])
	out->g11 = SECOND(0, 0);
	out->g12 = SECOND(0, 1);
	out->g22 = SECOND(1, 1);
	out->g1t = SECOND(0, 2);
	out->g2t = SECOND(1, 2);
	out->gtt = SECOND(2, 2);
#undef SECOND
}

/* g where the problem's region is entered; derivatives are in (near, far, T). */
static void blend(const struct problem *p, int order, struct operator_jet *out)
{
	struct root root;

	if (p->family == FAMILY_UNION) {
		solve_union(p, &root);
		out->g = fmax(root.C, p->near);
	} else {
		solve_intersection(p, &root);
		out->g = fmin(root.C, p->near);
	}
	if (order > 0)
		differentiate(p, &root, order, out);
}

/* From derivatives in T = tan(theta) to theta: T' = 1 + T^2, T'' = 2 T T'. */
static void to_theta(double T, int order, struct operator_jet *j)
{
	double T1 = 1.0 + T * T;

	if (order > 1)
		j->gtt = j->gtt * T1 * T1 + j->gt * 2.0 * T * T1;
	j->gt *= T1;
	j->g1t *= T1;
	j->g2t *= T1;
}

static void swap_fields(struct operator_jet *j)
{
	double g1 = j->g1, g11 = j->g11, g1t = j->g1t;

	j->g1 = j->g2;
	j->g2 = g1;
	j->g11 = j->g22;
	j->g22 = g11;
	j->g1t = j->g2t;
	j->g2t = g1t;
}

/* The union of near >= far > 0, or near if far is below the boundary. */
static void unite(struct problem *p, int order, struct operator_jet *out)
{
	struct boundary_jet k;

	boundary_union(p->near, p->T, &k);
	if (p->far > k.k)
		blend(p, order, out);
}

/*
 * The intersection of near <= far. At or above 1/2 it is the complement of a
 * union, whose derivatives in the complements change sign.
 */
static void intersect(struct problem *p, int order, struct operator_jet *out)
{
	struct boundary_jet m;
	struct problem u;

	boundary_intersection(p->near, p->T, &m);
	if (p->far >= m.k || p->near >= 1.0)
		return;
	u = (struct problem){FAMILY_UNION, p->profile, p->T, 1.0 - p->near,
	    1.0 - p->far};
	if (p->near < 0.5 || residual_at(&u, ARC_CONST, 0.5) > 0.0) {
		blend(p, order, out);
		return;
	}
	blend(&u, order, out);
	out->g = 1.0 - out->g;
	out->gt = -out->gt;
	out->g11 = -out->g11;
	out->g12 = -out->g12;
	out->g22 = -out->g22;
	out->gtt = -out->gtt;
}

void operator_eval(enum operator_family family, const struct profile *profile,
    double f1, double f2, double theta, int order, struct operator_jet *out)
{
	double t = theta < 0.0 ? 0.0 : theta > QUARTER_PI ? QUARTER_PI : theta;
	bool second_is_near = family == FAMILY_UNION ? f2 > f1 : f2 < f1;
	struct problem p = {family, profile, fmin(tan(t), 1.0),
	    second_is_near ? f2 : f1, second_is_near ? f1 : f2};

	*out = (struct operator_jet){.g = p.near, .g1 = order > 0 ? 1.0 : 0.0};
	if (fmin(f1, f2) >= FIELD_MIN) {
		if (family == FAMILY_UNION)
			unite(&p, order, out);
		else
			intersect(&p, order, out);
	}
	to_theta(p.T, order, out);
	if (second_is_near)
		swap_fields(out);
}

const char *operator_family_name(enum operator_family family)
{
	static const char *const names[FAMILY_COUNT] = {"union", "intersection"};

	return names[family];
}

const char *operator_layout_name(enum table_layout layout)
{
	static const char *const names[LAYOUT_COUNT] = {"warped", "uniform"};

	return names[layout];
}
