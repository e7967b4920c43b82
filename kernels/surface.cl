/*
 * Normal and curvature from a jet, as core/surface.c has them in float64. The
 * jet is within its limits.
 */

/* |H|/|grad f| is held within this, so that no product of two overflows. */
#define LIMIT_CURVATURE 1e18f

/*
 * The norm of v, also where its square would over- or underflow, and *unit =
 * v/|v|. Both 0 where v is; under 1e-37, which 1/v would overflow for, v counts
 * as that.
 */
static real surface_normalize(struct vec3r v, struct vec3r *unit)
{
	real most = real_max(fabs(v.x), real_max(fabs(v.y), fabs(v.z))), norm;
	mask null = most < REAL(1e-37f);

	most = SELECT(most, REAL(1.0f), null);
	v = vec3r(v.x / most, v.y / most, v.z / most);
	norm = SELECT(sqrt(vec3r_dot(v, v)), REAL(1.0f), null);
	*unit = vec3r_scale(SELECT(1.0f / norm, REAL(0.0f), null), v);
	return SELECT(norm * most, REAL(0.0f), null);
}

/* The outward unit normal; 0 where the gradient is. */
static inline struct vec3r surface_normal(const struct jetr *f)
{
	struct vec3r inward;

	surface_normalize(f->gradient, &inward);
	return vec3r_scale(REAL(-1.0f), inward);
}

/*
 * In a tangent frame (Duff et al. 2017), of the shape operator -(ti . h tj), h
 * = H/|grad f|, whose trace is twice the mean curvature and whose determinant
 * the Gaussian.
 */
static void surface_curvature(const struct jetr *f, real *mean,
    real *gaussian)
{
	struct vec3r n, t1, t2;
	real norm = surface_normalize(f->gradient, &n);
	real scale = SELECT(REAL(0.0f), 1.0f / norm, norm > REAL(0.0f));
	struct sym3r h = sym3r_limit(sym3r_scale(scale, f->hessian),
	    LIMIT_CURVATURE);
	real side = SELECT(REAL(1.0f), REAL(-1.0f), n.z < REAL(0.0f));
	real a = -1.0f / (side + n.z), b = n.x * n.y * a;
	real s11, s12, s22;

	t1 = vec3r(1.0f + side * n.x * n.x * a, side * b, -side * n.x);
	t2 = vec3r(b, side + n.y * n.y * a, -n.y);
	s11 = -vec3r_dot(t1, sym3r_apply(h, t1));
	s12 = -vec3r_dot(t1, sym3r_apply(h, t2));
	s22 = -vec3r_dot(t2, sym3r_apply(h, t2));
	*mean = 0.5f * (s11 + s22);
	*gaussian = s11 * s22 - s12 * s12;
}
