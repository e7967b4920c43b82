/*
 * Boundaries of the blend region (SPEC section 1; Gourmel et al. 2013,
 * Eq. 17 to 20), with second derivatives. T = tan(theta) in [0, 1].
 */
#ifndef CORE_BOUNDARY_H
#define CORE_BOUNDARY_H

/* A boundary's value and partial derivatives in f and T. */
struct boundary_jet {
	double k;
	double kf, kt;
	double kff, kft, ktt;
};

/*
 * phi: [0,2] -> [0,1], inverse of x + eta(x) (Eq. 20); clamped outside. out:
 * phi, phi', phi''. Solved to 1e-15 by safeguarded Newton steps.
 */
void boundary_phi(double u, double out[static 3]);

/*
 * phi's jet at u where phi is known, given eta's jet (profile_eta): rising,
 * from x = phi(u) and eta at x, for u <= 1; falling, from eta at phi(2 - u), for
 * u >= 1. boundary_phi is these after solving.
 */
void boundary_phi_rising(double x, const double eta[static 3],
    double out[static 3]);
void boundary_phi_falling(const double eta[static 3], double out[static 3]);

/* k(f) of the union family, f >= 0 (Eq. 17, 18). */
void boundary_union(double f, double T, struct boundary_jet *out);

/*
 * m(C) of the intersection family: (1 - T/2) phi(4C) below 1/2, and
 * 1 - k(1 - C) from there to 1; C is clamped to [0, 1].
 */
void boundary_intersection(double C, double T, struct boundary_jet *out);

/*
 * The same below 1/2, with phi's jet already known, at u = 2(2f - T)/(1 - T)
 * for the union (NULL where f <= T/2), at 4C for the intersection.
 */
void boundary_union_by_phi(double f, double T, const double *phi,
    struct boundary_jet *out);
void boundary_intersection_by_phi(double T, const double phi[static 3],
    struct boundary_jet *out);

#endif
