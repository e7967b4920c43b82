#include "core/volume.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "core/primitive.h"

/* Lines of samples that are solved together, so that memory is read in runs. */
#define LINES 16

/* OP_VOLUME's parameters (core/opcode.h). */
#define PARAM_MIN 0
#define PARAM_INVERSE 3
#define PARAM_COUNT 6
#define PARAM_FALL 9
#define PARAMS 10

/* Names volumes, and nothing else depends on it. */
static atomic_uint_fast64_t serials;

/* ---- coefficients ---- */

/* The lines along one axis of a grid, and the work space to solve them. */
struct lines {
	size_t count, stride; /* samples of a line, and between them */
	double *pivot;        /* count */
	double *value;        /* count * LINES */
};

/*
 * A sample is s_i = (c_{i-1} + 4 c_i + c_{i+1}) / 6. Beyond the ends c = 0, or,
 * for natural ends, c_{-1} = 2 c_0 - c_1, so that s_0 = c_0. Elimination leaves
 * c_i = value_i - pivot_i c_{i+1}, with pivot_i = 1 / (4 - pivot_{i-1}).
 */
static void set_pivots(struct lines *l, bool natural)
{
	double before = 0.0;

	for (size_t i = 0; i < l->count; i++) {
		bool is_end = i == 0 || i + 1 == l->count;

		before = natural && is_end ? 0.0 : 1.0 / (4.0 - before);
		l->pivot[i] = before;
	}
}

/* Solves `many` lines, which begin at at, at + step, ... */
static void solve(const struct lines *l, bool natural, float *at, size_t step,
    size_t many)
{
	for (size_t i = 0; i < l->count; i++) {
		double *value = l->value + i * LINES;
		double pivot = l->pivot[i];

		for (size_t k = 0; k < many; k++) {
			double s = at[i * l->stride + k * step];
			double before = i > 0 ? (value - LINES)[k] : 0.0;

			value[k] = natural && pivot == 0.0 ? s :
			    (6.0 * s - before) * pivot;
		}
	}
	for (size_t i = l->count; i-- > 0; ) {
		double *value = l->value + i * LINES;

		for (size_t k = 0; k < many; k++) {
			if (i + 1 < l->count)
				value[k] -= l->pivot[i] * value[k + LINES];
			at[i * l->stride + k * step] = (float)value[k];
		}
	}
}

/* The same for `many` lines, any number. */
static void solve_all(const struct lines *l, bool natural, float *at,
    size_t step, size_t many)
{
	for (size_t k = 0; k < many; k += LINES)
		solve(l, natural, at + k * step, step,
		    many - k < LINES ? many - k : LINES);
}

/* Samples to coefficients, in place: along z, y, x. */
static enum err find_coefficients(struct volume *v)
{
	size_t nx = v->count[0], ny = v->count[1], nz = v->count[2];
	size_t most = nx > ny ? nx : ny;
	struct lines l = {0};

	most = most > nz ? most : nz;
	l.pivot = malloc(most * (1 + LINES) * sizeof *l.pivot);
	if (l.pivot == NULL)
		return ERR_MEMORY;
	l.value = l.pivot + most;
	l.count = nz;
	l.stride = 1;
	set_pivots(&l, v->is_distance);
	solve_all(&l, v->is_distance, v->coefficients, nz, nx * ny);
	l.count = ny;
	l.stride = nz;
	set_pivots(&l, v->is_distance);
	for (size_t i = 0; i < nx; i++)
		solve_all(&l, v->is_distance, v->coefficients + i * ny * nz, 1,
		    nz);
	l.count = nx;
	l.stride = ny * nz;
	set_pivots(&l, v->is_distance);
	solve_all(&l, v->is_distance, v->coefficients, 1, ny * nz);
	free(l.pivot);
	return ERR_OK;
}

/*
 * With natural ends the spline on a face mixes that face's coefficients, by
 * weights of 0 or more that sum to 1: none is below the least of them.
 */
static double find_least_edge(const struct volume *v)
{
	const size_t *n = v->count;
	const float *c = v->coefficients;
	double least = INFINITY;

	for (size_t i = 0; i < n[0]; i++)
		for (size_t j = 0; j < n[1]; j++) {
			bool edge = i == 0 || i + 1 == n[0] || j == 0 ||
			    j + 1 == n[1];
			size_t step = edge ? 1 : n[2] - 1;

			for (size_t k = 0; k < n[2]; k += step)
				least = fmin(least,
				    c[(i * n[1] + j) * n[2] + k]);
		}
	return least;
}

/* ---- life ---- */

static void volume_free(struct volume *v)
{
	free(v->coefficients);
	free(v);
}

enum err volume_create(const float *samples, const size_t count[static 3],
    struct vec3 min, struct vec3 max, bool is_distance, struct volume **out)
{
	struct volume *v = calloc(1, sizeof *v);
	size_t total = count[0] * count[1] * count[2];

	if (v == NULL)
		return ERR_MEMORY;
	atomic_init(&v->refs, 1);
	memcpy(v->count, count, sizeof v->count);
	v->min = min;
	v->max = max;
	v->is_distance = is_distance;
	v->coefficients = malloc(total * sizeof *v->coefficients);
	if (v->coefficients == NULL)
		goto fail;
	memcpy(v->coefficients, samples, total * sizeof *samples);
	if (find_coefficients(v) != ERR_OK)
		goto fail;
	v->least_edge = is_distance ? find_least_edge(v) : 0.0;
	v->serial = atomic_fetch_add(&serials, 1) + 1;
	*out = v;
	return ERR_OK;
fail:
	volume_free(v);
	return ERR_MEMORY;
}

struct volume *volume_hold(struct volume *v)
{
	atomic_fetch_add(&v->refs, 1);
	return v;
}

void volume_release(struct volume *v)
{
	if (v != NULL && atomic_fetch_sub(&v->refs, 1) == 1)
		volume_free(v);
}

size_t volume_bytes(const struct volume *v)
{
	return sizeof *v + v->count[0] * v->count[1] * v->count[2] *
	    sizeof *v->coefficients;
}

static struct vec3 spacing(const struct volume *v)
{
	return vec3((v->max.x - v->min.x) / (double)(v->count[0] - 1),
	    (v->max.y - v->min.y) / (double)(v->count[1] - 1),
	    (v->max.z - v->min.z) / (double)(v->count[2] - 1));
}

double volume_spacing(const struct volume *v)
{
	struct vec3 h = spacing(v);

	return fmin(h.x, fmin(h.y, h.z));
}

int volume_prepare(const struct volume *v, double falloff, double *params)
{
	struct vec3 h = spacing(v);

	params[PARAM_MIN] = v->min.x;
	params[PARAM_MIN + 1] = v->min.y;
	params[PARAM_MIN + 2] = v->min.z;
	params[PARAM_INVERSE] = 1.0 / h.x;
	params[PARAM_INVERSE + 1] = 1.0 / h.y;
	params[PARAM_INVERSE + 2] = 1.0 / h.z;
	for (int i = 0; i < 3; i++)
		params[PARAM_COUNT + i] = (double)v->count[i];
	params[PARAM_FALL] = v->is_distance ? 1.0 / falloff : 0.0;
	return PARAMS;
}

/* ---- evaluation ---- */

/* What four coefficients of an axis, from first on, weigh: in the value, and
 * in its first and second derivatives. */
struct weights {
	size_t first;
	double w[3][4];
};

/* The uniform cubic B-spline's four pieces at t in [0, 1], with derivatives. */
static void pieces(double t, double w[static 3][4])
{
	double s = 1.0 - t;

	w[0][0] = s * s * s / 6.0;
	w[0][1] = (t * t * (3.0 * t - 6.0) + 4.0) / 6.0;
	w[0][2] = (s * s * (3.0 * s - 6.0) + 4.0) / 6.0;
	w[0][3] = t * t * t / 6.0;
	w[1][0] = -0.5 * s * s;
	w[1][1] = t * (1.5 * t - 2.0);
	w[1][2] = s * (2.0 - 1.5 * s);
	w[1][3] = 0.5 * t * t;
	w[2][0] = s;
	w[2][1] = 3.0 * t - 2.0;
	w[2][2] = 3.0 * s - 2.0;
	w[2][3] = t;
}

/*
 * The weights at u, in spacings from the first of n coefficients. The four are
 * always within the grid: those beyond it are 0 and left out, or, with natural
 * ends, are c_{-1} = 2 c_0 - c_1 and c_n = 2 c_{n-1} - c_{n-2}.
 */
static void weigh(double u, double inverse, double n, bool natural,
    struct weights *out)
{
	double cell = fmin(floor(u), natural ? n - 2.0 : n);
	double first = fmin(fmax(cell - 1.0, 0.0), n - 4.0);
	int shift = (int)(cell - 1.0 - first);
	double w[3][4], scale = 1.0;

	pieces(u - cell, w);
	*out = (struct weights){.first = (size_t)first};
	for (int d = 0; d < 3; d++, scale *= inverse)
		for (int k = 0; k < 4; k++) {
			double *to = out->w[d];
			double part = scale * w[d][k];

			if (k + shift >= 0 && k + shift < 4) {
				to[k + shift] += part;
			} else if (natural) {
				to[k == 0 ? 0 : 3] += 2.0 * part;
				to[k == 0 ? 1 : 2] -= part;
			}
		}
}

/* The spline, with all derivatives. */
static void spline(const struct volume *v, const struct weights *x,
    const struct weights *y, const struct weights *z, struct jet *out)
{
	*out = (struct jet){0};
	for (size_t i = 0; i < 4; i++)
		for (size_t j = 0; j < 4; j++) {
			const float *c = v->coefficients +
			    ((x->first + i) * v->count[1] + y->first + j) *
			    v->count[2] + z->first;
			double r[3] = {0.0, 0.0, 0.0};
			const double wx[3] = {x->w[0][i], x->w[1][i],
			    x->w[2][i]};
			const double wy[3] = {y->w[0][j], y->w[1][j],
			    y->w[2][j]};

			for (int d = 0; d < 3; d++)
				for (int k = 0; k < 4; k++)
					r[d] += z->w[d][k] * c[k];
			out->value += wx[0] * wy[0] * r[0];
			out->gradient.x += wx[1] * wy[0] * r[0];
			out->gradient.y += wx[0] * wy[1] * r[0];
			out->gradient.z += wx[0] * wy[0] * r[1];
			out->hessian.xx += wx[2] * wy[0] * r[0];
			out->hessian.yy += wx[0] * wy[2] * r[0];
			out->hessian.zz += wx[0] * wy[0] * r[2];
			out->hessian.xy += wx[1] * wy[1] * r[0];
			out->hessian.xz += wx[1] * wy[0] * r[1];
			out->hessian.yz += wx[0] * wy[1] * r[1];
		}
}

/* Whether the point is where the volume has anything to say: within the box,
 * or for fields also nearer than two spacings. */
static bool is_near(const double u[static 3], const double *count,
    bool natural)
{
	double beyond = natural ? 0.0 : 2.0;

	for (int i = 0; i < 3; i++)
		if (!(u[i] >= -beyond && u[i] <= count[i] - 1.0 + beyond))
			return false;
	return true;
}

static void cut(const struct jet *f, int order, struct jet *out)
{
	out->value = f->value;
	if (order >= 1)
		out->gradient = f->gradient;
	if (order >= 2)
		out->hessian = f->hessian;
}

void volume_eval(const struct volume *v, const double *params, struct vec3 x,
    int order, struct jet *out)
{
	const double *inverse = params + PARAM_INVERSE;
	const double *count = params + PARAM_COUNT;
	const double u[3] = {
		(x.x - params[PARAM_MIN]) * inverse[0],
		(x.y - params[PARAM_MIN + 1]) * inverse[1],
		(x.z - params[PARAM_MIN + 2]) * inverse[2],
	};
	bool natural = params[PARAM_FALL] > 0.0;
	struct weights w[3];
	struct jet f;

	*out = (struct jet){0};
	if (!is_near(u, count, natural))
		return;
	for (int i = 0; i < 3; i++)
		weigh(u[i], inverse[i], count[i], natural, w + i);
	spline(v, w, w + 1, w + 2, &f);
	if (natural)
		primitive_solid(&f, params[PARAM_FALL], order, out);
	else if (f.value > 0.0)
		cut(&f, order, out);
}
