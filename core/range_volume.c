/*
 * Volumes over a patch: a spline's values lie between the least and the most of
 * the coefficients that its pieces there mix, with weights of 0 or more that sum
 * to 1; and its derivative along an axis is the same kind of mixture of their
 * differences.
 */
#include "core/range_parts.h"

#include <math.h>
#include <stdlib.h>

#include "core/volume.h"

#define LEVELS 12

/* Coefficients, or blocks of them, of an axis that are looked at. */
#define FEW 6

struct range_volume {
	const struct volume *volume;
	size_t count[LEVELS][3];
	struct { float least, most; } *blocks[LEVELS]; /* [0]: not there */
	int levels;
	double steepest[3]; /* of slopes along each axis */
};

static void merge(struct range_volume *r, int level, size_t i, size_t j,
    size_t k)
{
	const size_t *n = r->count[level - 1];
	const struct volume *v = r->volume;
	float least = INFINITY, most = -INFINITY;

	for (size_t x = 2 * i; x < n[0] && x < 2 * i + 2; x++)
		for (size_t y = 2 * j; y < n[1] && y < 2 * j + 2; y++)
			for (size_t z = 2 * k; z < n[2] && z < 2 * k + 2; z++) {
				size_t at = (x * n[1] + y) * n[2] + z;

				least = fminf(least, level == 1 ?
				    v->coefficients[at] :
				    r->blocks[level - 1][at].least);
				most = fmaxf(most, level == 1 ?
				    v->coefficients[at] :
				    r->blocks[level - 1][at].most);
			}
	n = r->count[level];
	r->blocks[level][(i * n[1] + j) * n[2] + k].least = least;
	r->blocks[level][(i * n[1] + j) * n[2] + k].most = most;
}

static enum err add_level(struct range_volume *r, int level)
{
	size_t *n = r->count[level];

	for (int i = 0; i < 3; i++)
		n[i] = (r->count[level - 1][i] + 1) / 2;
	r->blocks[level] = malloc(n[0] * n[1] * n[2] *
	    sizeof *r->blocks[level]);
	if (r->blocks[level] == NULL)
		return ERR_MEMORY;
	r->levels = level + 1;
	for (size_t i = 0; i < n[0]; i++)
		for (size_t j = 0; j < n[1]; j++)
			for (size_t k = 0; k < n[2]; k++)
				merge(r, level, i, j, k);
	return ERR_OK;
}

/* Coefficients that count over a patch; beyond the grid they are as volume.h
 * says. */
struct touched {
	long first[3], last[3];
	bool beyond[3];
};

/* The size of the most that neighbours along axis differ by. */
static double steepest(const struct volume *v, const struct touched *t,
    int axis)
{
	const size_t *n = v->count;
	const float *c = v->coefficients;
	const size_t step = axis == 2 ? 1 : axis == 1 ? n[2] : n[1] * n[2];
	float most = 0.0f;

	for (long i = t->first[0]; i <= t->last[0] - (axis == 0); i++)
		for (long j = t->first[1]; j <= t->last[1] - (axis == 1); j++)
			for (long k = t->first[2]; k <= t->last[2] - (axis == 2);
			    k++) {
				size_t at = ((size_t)i * n[1] + (size_t)j) *
				    n[2] + (size_t)k;
				float d = fabsf(c[at + step] - c[at]);

				most = d > most ? d : most;
			}
	return most;
}

enum err range_volume_create(const struct volume *v, struct range_volume **out)
{
	struct range_volume *r = calloc(1, sizeof *r);
	struct touched all = {{0, 0, 0}, {0, 0, 0}, {false, false, false}};
	size_t most = 0;

	if (r == NULL)
		return ERR_MEMORY;
	r->volume = v;
	for (int i = 0; i < 3; i++)
		all.last[i] = (long)v->count[i] - 1;
	for (int i = 0; i < 3; i++)
		r->steepest[i] = steepest(v, &all, i);
	r->levels = 1;
	for (int i = 0; i < 3; i++)
		r->count[0][i] = v->count[i];
	do {
		if (add_level(r, r->levels) != ERR_OK) {
			range_volume_free(r);
			return ERR_MEMORY;
		}
		most = 0;
		for (int i = 0; i < 3; i++)
			if (r->count[r->levels - 1][i] > most)
				most = r->count[r->levels - 1][i];
	} while (most > FEW - 2 && r->levels < LEVELS);
	*out = r;
	return ERR_OK;
}

void range_volume_free(struct range_volume *r)
{
	if (r == NULL)
		return;
	for (int i = 0; i < LEVELS; i++)
		free(r->blocks[i]);
	free(r);
}

static struct range hull_of(const struct range_volume *r,
    const struct touched *t, int level)
{
	const size_t *n = r->count[level];
	const float *c = r->volume->coefficients;
	struct range out = {INFINITY, -INFINITY};

	for (long i = t->first[0] >> level; i <= t->last[0] >> level; i++)
		for (long j = t->first[1] >> level; j <= t->last[1] >> level;
		    j++)
			for (long k = t->first[2] >> level;
			    k <= t->last[2] >> level; k++) {
				size_t at = ((size_t)i * n[1] + (size_t)j) *
				    n[2] + (size_t)k;

				out.least = fmin(out.least, level == 0 ? c[at] :
				    r->blocks[level][at].least);
				out.most = fmax(out.most, level == 0 ? c[at] :
				    r->blocks[level][at].most);
			}
	return out;
}

/* Between which numbers the spline is. */
static struct range spline_hull(const struct range_volume *r,
    const struct touched *t, bool natural)
{
	struct range out;
	int level = 0;

	for (int i = 0; i < 3; i++)
		while (level + 1 < r->levels &&
		    (t->last[i] >> level) - (t->first[i] >> level) >= FEW)
			level++;
	out = hull_of(r, t, level);
	for (int i = 0; i < 3; i++) {
		if (!t->beyond[i])
			continue;
		/* c_{-1} = 2 c_0 - c_1, or 0 */
		out = natural ? (struct range){2.0 * out.least - out.most,
		    2.0 * out.most - out.least} :
		    (struct range){fmin(out.least, 0.0), fmax(out.most, 0.0)};
	}
	return out;
}

/*
 * How steep the spline is along axis, over a spacing. Beyond a field's grid are
 * zeros; what goes on beyond one of distances, c_{-1} = 2 c_0 - c_1, has the same
 * slope across the face and up to three times it along the face.
 */
static double slope_of(const struct range_volume *r, const struct touched *t,
    int axis, bool natural, const struct range *hull)
{
	double out = r->steepest[axis];
	bool few = true;

	for (int i = 0; i < 3; i++)
		few &= t->last[i] - t->first[i] < FEW;
	if (few)
		out = steepest(r->volume, t, axis);
	for (int i = 0; natural && i < 3; i++)
		if (i != axis && t->beyond[i])
			out *= 3.0;
	if (!natural && t->beyond[axis])
		out = fmax(out, fmax(fabs(hull->least), fabs(hull->most)));
	return out;
}

/* By way of the value in the middle, and of the steepest slopes about it. */
static void by_slope(const struct range_volume *r, const double *params,
    const struct patch *s, const struct touched *t, const struct range *hull,
    struct held *out)
{
	bool natural = params[9] > 0.0;
	double scale = natural ? 15.0 / 16.0 * params[9] : 1.0;
	double change = 0.0, slope = 0.0;
	struct jet f;

	for (int i = 0; i < 3; i++) {
		double most = scale * params[3 + i] *
		    slope_of(r, t, i, natural, hull);

		change += most * s->h[i];
		slope += most * most;
	}
	slope = s->n == 1 ? change : sqrt(slope) * s->speed;
	out->fall = -slope;
	out->rise = slope;
	volume_eval(r->volume, params, s->c, 0, &f);
	out->least = fmax(out->least, f.value - change);
	out->most = fmin(out->most, f.value + change);
}

void range_volume_eval(const struct range_volume *r, const double *params,
    const struct patch *s, struct held *out)
{
	const double c[3] = {s->c.x, s->c.y, s->c.z};
	bool natural = params[9] > 0.0, leaves = false;
	double beyond = natural ? 0.0 : 2.0;
	struct touched t;
	struct range hull;

	*out = (struct held){0};
	for (int i = 0; i < 3; i++) {
		double n = params[6 + i];
		double u = (c[i] - params[i]) * params[3 + i];
		double by = s->h[i] * params[3 + i] + 1e-9 * (1.0 + fabs(u));
		double first = floor(u - by) - 1.0, last = floor(u + by) + 2.0;

		if (u + by < -beyond || u - by > n - 1.0 + beyond)
			return;
		leaves |= u - by < -beyond || u + by > n - 1.0 + beyond;
		t.beyond[i] = first < 0.0 || last > n - 1.0;
		t.first[i] = (long)fmax(fmin(first, n - 1.0), 0.0);
		t.last[i] = (long)fmin(fmax(last, 0.0), n - 1.0);
		/* 2 c_0 - c_1 takes part with two of them */
		if (t.beyond[i] && t.first[i] == t.last[i])
			t.first[i] > 0 ? t.first[i]-- : t.last[i]++;
	}
	hull = spline_hull(r, &t, natural);
	if (natural) {
		out->least = range_falloff(hull.most, params[9]);
		out->most = range_falloff(hull.least, params[9]);
	} else {
		out->least = fmax(hull.least, 0.0);
		out->most = fmax(hull.most, 0.0);
	}
	if (leaves)
		out->least = 0.0;
	by_slope(r, params, s, &t, &hull, out);
}
