#include "core/mesh_planes.h"

#include <math.h>
#include <string.h>

#include "core/mesh_work.h"
#include "core/vec3.h"

/*
 * A direction counts as determined where its part of the planes' quadric is at
 * least this of the largest: for two planes tan^2 of half the angle between
 * them, 16 degrees.
 */
#define RANK_LEAST 0.02

/* Normals this near to their mean, by the cosine, determine no other direction:
 * cos^2 (1 + RANK_LEAST) > 1. */
#define FLAT_UP 0.9905

/* Normals of one plane, by their cosine. */
#define SAME 0.95

void mesh_planes_add(const struct mesh_work *w,
    const struct mesh_near *near, const struct mesh_cell *cell, unsigned edge,
    struct mesh_planes *l)
{
	const struct mesh_block *b = w->blocks + cell->block;
	const struct mesh_crossing *c = w->crossings +
	    mesh_cell_crossing(near, cell->local, edge);
	unsigned a = edge / 4;
	size_t corner[3];

	mesh_corner_of(b, cell->local, corner);
	corner[(a + 1) % 3] += edge & 1;
	corner[(a + 2) % 3] += edge >> 1 & 1;
	mesh_on_edge(&w->grid, corner, a, c->at, l->p[l->count]);
	for (int k = 0; k < 3; k++)
		l->n[l->count][k] = c->normal[k];
	l->is_cap[l->count] = mesh_is_cap(&w->grid, corner, a);
	l->caps += l->is_cap[l->count];
	l->axis[l->count] = (int)a;
	l->count++;
}

void mesh_planes_middle(const struct mesh_planes *l, double x[static 3])
{
	bool all = l->caps == l->count;
	double part = 1.0 / (all ? l->count : l->count - l->caps);

	x[0] = x[1] = x[2] = 0.0;
	for (int i = 0; i < l->count; i++)
		if (all || !l->is_cap[i])
			for (int k = 0; k < 3; k++)
				x[k] += part * l->p[i][k];
}

void mesh_planes_normal(const struct mesh_planes *l, float normal[static 3])
{
	struct vec3 n = vec3(0.0, 0.0, 0.0);

	for (int i = 0; i < l->count; i++)
		n = vec3_add(n, vec3_get(l->n[i]));
	n = vec3_norm(n) > 1e-6 ? vec3_unit(n) : vec3_get(l->n[0]);
	normal[0] = (float)n.x;
	normal[1] = (float)n.y;
	normal[2] = (float)n.z;
}

void mesh_planes_crease(const struct mesh_planes *l, float normal[static 3])
{
	struct vec3 sum = vec3(0.0, 0.0, 0.0);

	for (int i = 0; i < l->count; i++) {
		struct vec3 n = vec3_get(l->n[i]);
		int same = 0;

		for (int k = 0; k < l->count; k++)
			same += vec3_dot(n, vec3_get(l->n[k])) > SAME;
		sum = vec3_add(sum, vec3_scale(1.0 / fmax(same, 1), n));
	}
	if (!(vec3_norm(sum) > 1e-6)) {
		mesh_planes_normal(l, normal);
		return;
	}
	sum = vec3_unit(sum);
	normal[0] = (float)sum.x;
	normal[1] = (float)sum.y;
	normal[2] = (float)sum.z;
}

bool mesh_planes_are_flat(const struct mesh_planes *l,
    const double x[static 3], const float normal[static 3],
    double *height)
{
	double sum = 0.0;

	for (int i = 0; i < l->count; i++) {
		double above = 0.0, up = 0.0;

		for (int k = 0; k < 3; k++) {
			above += l->n[i][k] * (l->p[i][k] - x[k]);
			up += l->n[i][k] * normal[k];
		}
		if (!(up >= FLAT_UP))
			return false;
		sum += above / up;
	}
	*height = 0.5 * sum / l->count;
	return true;
}

bool mesh_planes_are_near(const struct mesh_planes *l,
    const double x[static 3], double most)
{
	for (int i = 0; i < l->count; i++)
		if (fabs(l->n[i][0] * (x[0] - l->p[i][0]) +
		    l->n[i][1] * (x[1] - l->p[i][1]) +
		    l->n[i][2] * (x[2] - l->p[i][2])) > most)
			return false;
	return true;
}

/* One Jacobi rotation, of columns p and q, that makes a's element there 0. */
static void rotate(double a[static 9], double v[static 9], int p, int q)
{
	double apq = a[3 * p + q], theta, t, c, s;

	if (apq == 0.0)
		return;
	theta = (a[4 * q] - a[4 * p]) / (2.0 * apq);
	t = (theta >= 0.0 ? 1.0 : -1.0) /
	    (fabs(theta) + sqrt(theta * theta + 1.0));
	c = 1.0 / sqrt(t * t + 1.0);
	s = t * c;
	for (int i = 0; i < 3; i++) {
		double x = a[3 * i + p], y = a[3 * i + q];
		double vx = v[3 * i + p], vy = v[3 * i + q];

		a[3 * i + p] = c * x - s * y;
		a[3 * i + q] = s * x + c * y;
		v[3 * i + p] = c * vx - s * vy;
		v[3 * i + q] = s * vx + c * vy;
	}
	for (int i = 0; i < 3; i++) {
		double x = a[3 * p + i], y = a[3 * q + i];

		a[3 * p + i] = c * x - s * y;
		a[3 * q + i] = s * x + c * y;
	}
}

/* Makes a (symmetric) diagonal, its eigenvalues; unit vectors to the columns of
 * v. Cyclic Jacobi rotations: three to five sweeps. */
static void eigen(double a[static 9], double v[static 9])
{
	memset(v, 0, 9 * sizeof *v);
	v[0] = v[4] = v[8] = 1.0;
	for (int sweep = 0; sweep < 12; sweep++) {
		double off = fabs(a[1]) + fabs(a[2]) + fabs(a[5]);

		if (off <= 1e-14 * (a[0] + a[4] + a[8]))
			return;
		rotate(a, v, 0, 1);
		rotate(a, v, 0, 2);
		rotate(a, v, 1, 2);
	}
}

/* Planes' quadric about a point: x' a x - 2 b x. */
struct quadric {
	double a[9], b[3];
};

static void sum_planes(const struct mesh_planes *l,
    const bool is_free[static 3], const double x[static 3],
    struct quadric *out)
{
	*out = (struct quadric){{0}, {0}};
	for (int i = 0; i < l->count; i++) {
		double n[3], d = 0.0;

		for (int k = 0; k < 3; k++) {
			n[k] = is_free[k] ? l->n[i][k] : 0.0;
			d += n[k] * (l->p[i][k] - x[k]);
		}
		for (int k = 0; k < 3; k++) {
			out->a[4 * k] += n[k] * n[k];
			out->b[k] += n[k] * d;
		}
		out->a[1] += n[0] * n[1];
		out->a[2] += n[0] * n[2];
		out->a[5] += n[1] * n[2];
	}
	out->a[3] = out->a[1];
	out->a[6] = out->a[2];
	out->a[7] = out->a[5];
}

/*
 * The step where the planes' mean normal m is all that they determine: the
 * greatest eigenvalue is at least m' a m, the others together at most what that
 * leaves of the trace. Saves most cells the eigenvectors.
 */
static bool solve_flat(const struct quadric *q, const double m[static 3],
    double step[static 3])
{
	double along = 0.0, trace = q->a[0] + q->a[4] + q->a[8];

	for (int k = 0; k < 9; k++)
		along += m[k / 3] * q->a[k] * m[k % 3];
	if (!(trace - along <= RANK_LEAST * along) || !(along > 0.0))
		return false;
	for (int k = 0; k < 3; k++)
		step[k] = m[k] * (m[0] * q->b[0] + m[1] * q->b[1] +
		    m[2] * q->b[2]) / along;
	return true;
}

/* The step, and how many directions are determined. */
static int solve_sharp(struct quadric *q, double step[static 3])
{
	double v[9], most;
	int rank = 0;

	eigen(q->a, v);
	most = fmax(q->a[0], fmax(q->a[4], q->a[8]));
	step[0] = step[1] = step[2] = 0.0;
	for (int i = 0; i < 3; i++) {
		double along = v[i] * q->b[0] + v[3 + i] * q->b[1] +
		    v[6 + i] * q->b[2];

		if (!(q->a[4 * i] > RANK_LEAST * most))
			continue;
		rank++;
		for (int k = 0; k < 3; k++)
			step[k] += v[3 * k + i] * (along / q->a[4 * i]);
	}
	return rank;
}

int mesh_planes_solve(const struct mesh_planes *l,
    const bool is_free[static 3], const float mean[static 3],
    double x[static 3])
{
	double m[3], step[3], norm2 = 0.0;
	struct quadric q;
	int rank = 1;

	sum_planes(l, is_free, x, &q);
	for (int k = 0; k < 3; k++) {
		m[k] = is_free[k] ? mean[k] : 0.0;
		norm2 += m[k] * m[k];
	}
	for (int k = 0; k < 3 && norm2 > 0.0; k++)
		m[k] /= sqrt(norm2);
	if (!solve_flat(&q, m, step))
		rank = solve_sharp(&q, step);
	for (int k = 0; k < 3; k++)
		x[k] += is_free[k] ? step[k] : 0.0;
	return rank;
}
