/*
 * Goldman's formulas (2005, section 4) in a tangent frame.
 * With t1 and t2 unit vectors across the normal and h = H/|grad f|, the shape
 * operator's matrix is -(ti . h tj): its trace is twice the mean curvature, its
 * determinant the Gaussian.
 */
#include "core/surface.h"

/* |H|/|grad f| is held within this, so that no product of two overflows. */
#define CURVATURE_MAX 1e150

/* The norm of v, also where its square over- or underflows, and *unit =
 * v/|v|; 0 and untouched where v is 0. */
static double normalize(struct vec3 v, struct vec3 *unit)
{
	double most = fmax(fabs(v.x), fmax(fabs(v.y), fabs(v.z))), norm;

	if (!(most > 0.0))
		return 0.0;
	v = vec3(v.x / most, v.y / most, v.z / most);
	norm = vec3_norm(v);
	*unit = vec3_scale(1.0 / norm, v);
	return norm * most;
}

struct vec3 surface_normal(const struct jet *f)
{
	struct vec3 inward = vec3(0.0, 0.0, 0.0);

	normalize(f->gradient, &inward);
	return vec3(0.0 - inward.x, 0.0 - inward.y, 0.0 - inward.z);
}

/* Two unit vectors across the unit vector n (Duff et al. 2017). */
static void tangents(struct vec3 n, struct vec3 *t1, struct vec3 *t2)
{
	double side = n.z < 0.0 ? -1.0 : 1.0;
	double a = -1.0 / (side + n.z), b = n.x * n.y * a;

	*t1 = vec3(1.0 + side * n.x * n.x * a, side * b, -side * n.x);
	*t2 = vec3(b, side + n.y * n.y * a, -n.y);
}

static double largest(const struct sym3 *h)
{
	return fmax(fmax(fmax(fabs(h->xx), fabs(h->yy)), fabs(h->zz)),
	    fmax(fmax(fabs(h->xy), fabs(h->xz)), fabs(h->yz)));
}

void surface_curvature(const struct jet *f, double *mean, double *gaussian)
{
	double size = largest(&f->hessian), norm, scale, s11, s12, s22;
	struct vec3 n, t1, t2;
	struct sym3 h;

	*mean = *gaussian = 0.0;
	norm = normalize(f->gradient, &n);
	if (norm == 0.0 || size == 0.0)
		return;
	h = (struct sym3){f->hessian.xx / size, f->hessian.yy / size,
	    f->hessian.zz / size, f->hessian.xy / size, f->hessian.xz / size,
	    f->hessian.yz / size};
	scale = -fmin(size / norm, CURVATURE_MAX);
	tangents(n, &t1, &t2);
	s11 = scale * vec3_dot(t1, sym3_apply(h, t1));
	s12 = scale * vec3_dot(t1, sym3_apply(h, t2));
	s22 = scale * vec3_dot(t2, sym3_apply(h, t2));
	*mean = 0.5 * (s11 + s22);
	*gaussian = s11 * s22 - s12 * s12;
}
