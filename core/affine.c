#include "core/affine.h"

#include <math.h>

struct affine affine_identity(void)
{
	return (struct affine){
	    .a = {{1.0, 0.0, 0.0}, {0.0, 1.0, 0.0}, {0.0, 0.0, 1.0}}};
}

struct affine affine_from_trs(const double t[static 3],
    const double q[static 4], const double s[static 3])
{
	double x = q[0], y = q[1], z = q[2], w = q[3];
	/* 2 / |q|^2: a rotation even where q is a unit only to a few digits. */
	double k = 2.0 / (x * x + y * y + z * z + w * w);
	double r[3][3] = {
	    {1.0 - k * (y * y + z * z), k * (x * y - w * z), k * (x * z + w * y)},
	    {k * (x * y + w * z), 1.0 - k * (x * x + z * z), k * (y * z - w * x)},
	    {k * (x * z - w * y), k * (y * z + w * x), 1.0 - k * (x * x + y * y)}};
	struct affine m;

	for (int i = 0; i < 3; i++) {
		for (int j = 0; j < 3; j++)
			m.a[i][j] = r[i][j] * s[j];
		m.t[i] = t[i];
	}
	return m;
}

struct affine affine_compose(const struct affine *outer,
    const struct affine *inner)
{
	struct affine m;

	for (int i = 0; i < 3; i++) {
		const double *row = outer->a[i];

		for (int j = 0; j < 3; j++)
			m.a[i][j] = row[0] * inner->a[0][j] +
			    row[1] * inner->a[1][j] + row[2] * inner->a[2][j];
		m.t[i] = row[0] * inner->t[0] + row[1] * inner->t[1] +
		    row[2] * inner->t[2] + outer->t[i];
	}
	return m;
}

static struct vec3 column(const struct affine *m, int j)
{
	return vec3(m->a[0][j], m->a[1][j], m->a[2][j]);
}

static void set_row(struct affine *m, int i, struct vec3 row)
{
	m->a[i][0] = row.x;
	m->a[i][1] = row.y;
	m->a[i][2] = row.z;
}

static bool is_finite(const struct affine *m)
{
	for (int i = 0; i < 3; i++) {
		for (int j = 0; j < 3; j++)
			if (!isfinite(m->a[i][j]))
				return false;
		if (!isfinite(m->t[i]))
			return false;
	}
	return true;
}

bool affine_invert(const struct affine *m, struct affine *out)
{
	struct vec3 a = column(m, 0), b = column(m, 1), c = column(m, 2);
	double la = vec3_norm(a), lb = vec3_norm(b), lc = vec3_norm(c);
	struct vec3 ua = vec3_scale(1.0 / la, a);
	struct vec3 ub = vec3_scale(1.0 / lb, b);
	struct vec3 uc = vec3_scale(1.0 / lc, c);
	/* The determinant of unit columns: det / (la lb lc). NaN fails too. */
	double det = vec3_dot(ua, vec3_cross(ub, uc));
	struct affine inverse;
	struct vec3 t;

	if (!(fabs(det) >= 1e-12))
		return false;
	/* Rows of the inverse: b x c / det and so on, without overflow. */
	set_row(&inverse, 0, vec3_scale(1.0 / (det * la), vec3_cross(ub, uc)));
	set_row(&inverse, 1, vec3_scale(1.0 / (det * lb), vec3_cross(uc, ua)));
	set_row(&inverse, 2, vec3_scale(1.0 / (det * lc), vec3_cross(ua, ub)));
	inverse.t[0] = inverse.t[1] = inverse.t[2] = 0.0;
	t = affine_point(&inverse, vec3(m->t[0], m->t[1], m->t[2]));
	inverse.t[0] = -t.x;
	inverse.t[1] = -t.y;
	inverse.t[2] = -t.z;
	if (!is_finite(&inverse))
		return false;
	*out = inverse;
	return true;
}

struct vec3 affine_point(const struct affine *m, struct vec3 p)
{
	return vec3(
	    m->a[0][0] * p.x + m->a[0][1] * p.y + m->a[0][2] * p.z + m->t[0],
	    m->a[1][0] * p.x + m->a[1][1] * p.y + m->a[1][2] * p.z + m->t[1],
	    m->a[2][0] * p.x + m->a[2][1] * p.y + m->a[2][2] * p.z + m->t[2]);
}

struct vec3 affine_pull_gradient(const double a[static 3][3], struct vec3 g)
{
	return vec3(a[0][0] * g.x + a[1][0] * g.y + a[2][0] * g.z,
	    a[0][1] * g.x + a[1][1] * g.y + a[2][1] * g.z,
	    a[0][2] * g.x + a[1][2] * g.y + a[2][2] * g.z);
}

struct sym3 affine_pull_hessian(const double a[static 3][3], struct sym3 h)
{
	struct vec3 u = vec3(a[0][0], a[1][0], a[2][0]);
	struct vec3 v = vec3(a[0][1], a[1][1], a[2][1]);
	struct vec3 w = vec3(a[0][2], a[1][2], a[2][2]);
	struct vec3 hu = sym3_apply(h, u);
	struct vec3 hv = sym3_apply(h, v);
	struct vec3 hw = sym3_apply(h, w);

	return (struct sym3){vec3_dot(u, hu), vec3_dot(v, hv), vec3_dot(w, hw),
	    vec3_dot(u, hv), vec3_dot(u, hw), vec3_dot(v, hw)};
}

/*
 * The largest singular value of m's linear part A: the root of A^T A's largest
 * eigenvalue, by the trigonometric solution of its characteristic cubic.
 */
static double largest_stretch(const struct affine *m)
{
	double b[3][3], q, p, p2, r;

	for (int i = 0; i < 3; i++)
		for (int j = 0; j < 3; j++)
			b[i][j] = vec3_dot(column(m, i), column(m, j));
	/* (A^T A)/q - 1 has trace 0. */
	q = (b[0][0] + b[1][1] + b[2][2]) / 3.0;
	for (int i = 0; i < 3; i++)
		for (int j = 0; j < 3; j++)
			b[i][j] = (i == j ? b[i][j] - q : b[i][j]) / q;
	p2 = b[0][0] * b[0][0] + b[1][1] * b[1][1] + b[2][2] * b[2][2] +
	    2.0 * (b[0][1] * b[0][1] + b[0][2] * b[0][2] + b[1][2] * b[1][2]);
	if (p2 < 1e-24)
		return sqrt(q);
	p = sqrt(p2 / 6.0);
	r = b[0][0] * (b[1][1] * b[2][2] - b[1][2] * b[1][2]) -
	    b[0][1] * (b[0][1] * b[2][2] - b[1][2] * b[0][2]) +
	    b[0][2] * (b[0][1] * b[1][2] - b[1][1] * b[0][2]);
	r = fmax(-1.0, fmin(1.0, r / (2.0 * p * p * p)));
	return sqrt(q * (1.0 + 2.0 * p * cos(acos(r) / 3.0)));
}

void affine_stretch(const struct affine *m, double *least, double *most)
{
	struct affine inverse;

	*most = largest_stretch(m);
	*least = affine_invert(m, &inverse) ? 1.0 / largest_stretch(&inverse)
	    : 0.0;
}
