#include "core/boundary.h"

#include <math.h>
#include <stddef.h>

#include "core/profile.h"

/*
 * (x, 1 - eta(x)) is symmetric about the diagonal, so that phi(2 - u) =
 * 1 - eta(phi(u)): only u <= 1 is solved, where phi <= phi(1) and eta' <= 1.
 * eta is convex there; Newton's steps from the right descend to the root
 * without passing it.
 */
static double phi_lower(double u, double eta[static 3])
{
	double x = u < PROFILE_DIAGONAL ? u : PROFILE_DIAGONAL, step;

	for (int i = 0; i < 30; i++) {
		profile_eta(x, eta);
		step = (x + eta[0] - u) / (1.0 + eta[1]);
		x -= step;
		/* The error after a step is under 10 times its square. */
		if (fabs(step) <= 1e-9)
			break;
	}
	return x;
}

/* With x = phi(u): x' = 1/(1 + eta'), x'' = -eta'' x'^3. */
void boundary_phi_rising(double x, const double eta[static 3],
    double out[static 3])
{
	out[0] = x > 0.0 ? x : 0.0;
	out[1] = 1.0 / (1.0 + eta[1]);
	out[2] = -eta[2] * out[1] * out[1] * out[1];
}

/* With x = phi(2 - u): phi(u) = 1 - eta(x), so phi' = eta' x'. */
void boundary_phi_falling(const double eta[static 3], double out[static 3])
{
	double slope = 1.0 / (1.0 + eta[1]);

	out[0] = 1.0 - eta[0];
	out[1] = eta[1] * slope;
	out[2] = -eta[2] * slope * slope * slope;
}

void boundary_phi(double u, double out[static 3])
{
	double eta[3], x;

	u = u < 0.0 ? 0.0 : u > 2.0 ? 2.0 : u;
	x = phi_lower(u <= 1.0 ? u : 2.0 - u, eta);
	profile_eta(x, eta);
	if (u <= 1.0)
		boundary_phi_rising(x, eta, out);
	else
		boundary_phi_falling(eta, out);
}

/*
 * lambda(f) and its derivatives (Eq. 18), into the members of a boundary_jet,
 * from phi at u; phi NULL: f is at most T/2.
 */
static void lambda_eval(double f, double T, const double *phi,
    struct boundary_jet *out)
{
	double q = 1.0 - T, u, ut;

	*out = (struct boundary_jet){.k = f, .kf = 1.0};
	if (!phi)
		return;
	/* u = 2 (2f - T)/(1 - T): u_f = 4/q, u_T = (u - 2)/q, u_fT = 4/q^2,
	 * u_TT = 2 (u - 2)/q^2 */
	u = 2.0 * (2.0 * f - T) / q;
	ut = (u - 2.0) / q;
	/* lambda = q phi/4 + T/2 */
	out->k = q / 4 * phi[0] + T / 2;
	out->kf = phi[1];
	out->kt = -phi[0] / 4 + q / 4 * phi[1] * ut + 0.5;
	out->kff = 4.0 / q * phi[2];
	out->kft = phi[2] * ut;
	out->ktt = q / 4 * phi[2] * ut * ut;
}

/*
 * k = s lambda^2 with s = 8 T/(1 + T)^2; s' = 8 (1 - T)/(1 + T)^3,
 * s'' = 16 (T - 2)/(1 + T)^4.
 */
void boundary_union_by_phi(double f, double T, const double *phi,
    struct boundary_jet *out)
{
	double p = 1.0 + T, s, s1, s2;
	struct boundary_jet l;

	s = 8.0 * T / (p * p);
	s1 = 8.0 * (1.0 - T) / (p * p * p);
	s2 = 16.0 * (T - 2.0) / (p * p * p * p);
	lambda_eval(f, T, phi, &l);
	out->k = s * l.k * l.k;
	out->kf = 2.0 * s * l.k * l.kf;
	out->kt = s1 * l.k * l.k + 2.0 * s * l.k * l.kt;
	out->kff = 2.0 * s * (l.kf * l.kf + l.k * l.kff);
	out->kft = 2.0 * s1 * l.k * l.kf + 2.0 * s * (l.kt * l.kf + l.k * l.kft);
	out->ktt = s2 * l.k * l.k + 4.0 * s1 * l.k * l.kt +
	    2.0 * s * (l.kt * l.kt + l.k * l.ktt);
}

void boundary_union(double f, double T, struct boundary_jet *out)
{
	double phi[3];

	if (f >= 0.5) {
		*out = (struct boundary_jet){.k = T / 2, .kt = 0.5};
		return;
	}
	if (f <= T / 2 || T >= 1.0) {
		boundary_union_by_phi(f, T, NULL, out);
		return;
	}
	boundary_phi(2.0 * (2.0 * f - T) / (1.0 - T), phi);
	boundary_union_by_phi(f, T, phi, out);
}

void boundary_intersection_by_phi(double T, const double phi[static 3],
    struct boundary_jet *out)
{
	double a = 1.0 - T / 2;

	*out = (struct boundary_jet){.k = a * phi[0], .kf = 4.0 * a * phi[1],
	    .kt = -phi[0] / 2, .kff = 16.0 * a * phi[2], .kft = -2.0 * phi[1]};
}

void boundary_intersection(double C, double T, struct boundary_jet *out)
{
	struct boundary_jet k;
	double phi[3];

	C = C < 0.0 ? 0.0 : C > 1.0 ? 1.0 : C;
	if (C < 0.5) {
		boundary_phi(4.0 * C, phi);
		boundary_intersection_by_phi(T, phi, out);
		return;
	}
	boundary_union(1.0 - C, T, &k);
	*out = (struct boundary_jet){.k = 1.0 - k.k, .kf = k.kf, .kt = -k.kt,
	    .kff = -k.kff, .kft = k.kft, .ktt = -k.ktt};
}
