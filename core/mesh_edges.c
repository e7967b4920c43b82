/*
 * Where the surface crosses edges, and its normals there: a bracketed search
 * along every edge, all at once, so that samples come in batches. From the line
 * between the ends' values Newton's steps by the gradients that are needed
 * anyway; where these leave the bracket, or are many, safeguarded regula falsi
 * (Illinois: Dowell, Jarratt 1971), at last halving.
 */
#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "core/mesh_work.h"
#include "core/output.h"

/* An edge is done when Newton's step is shorter than this part of it: what is
 * left then is of this number's square. */
#define STEP_DONE 3e-4

/* After the first sample, also when it is shorter than this, and ends within so
 * much of the parabola's root: the field bends little and has no kink there. */
#define STEP_SMOOTH 0.03
#define STEP_AGREED 1e-3

/* Or when its bracket is, or is two neighbours of float32's numbers. */
#define BRACKET_DONE 1e-6

/* Steps at most; the first are Newton's, halvings are taken from the tenth on. */
#define STEPS_MAX 40
#define STEPS_FAST 10
#define STEPS_NEWTON 4

/* How close to an end of its bracket a step may go, of its length. */
#define MARGIN 1e-4

/* An edge that is worked on. Parts of the edge; values less iso. */
struct search {
	uint32_t crossing;
	uint8_t axis, steps;
	int8_t kept;    /* which end the last steps have left alone: -1, 1, 0 */
	float corner[3], last; /* its first corner; the last one's coordinate */
	float x;        /* coordinate that is sampled */
	double t[2], f[2]; /* the bracket */
};

struct edges {
	struct mesh_work *w;
	struct search *open;
	size_t count, done;
};

/* Part of the edge of what is sampled, as float32 has rounded it. */
static double part(const struct search *s)
{
	double base = s->corner[s->axis];

	return ((double)s->x - base) / ((double)s->last - base);
}

static void aim(struct search *s, double t)
{
	double base = s->corner[s->axis];

	s->x = (float)(base + t * ((double)s->last - base));
}

static double within(const struct search *s, double t)
{
	double low = s->t[0], high = s->t[1], room = MARGIN * (high - low);

	if (!(t > low + room))
		return low + room;
	return t < high - room ? t : high - room;
}

static double false_position(const struct search *s)
{
	double d = s->f[1] - s->f[0];

	return d == 0.0 ? 0.5 * (s->t[0] + s->t[1]) :
	    s->t[0] - s->f[0] * ((s->t[1] - s->t[0]) / d);
}

/* The root within the bracket of the inverse parabola through its ends and
 * (t, f), where that is between them in value. */
static double parabola(const struct search *s, double t, double f)
{
	double a = s->f[0], b = s->f[1];

	if ((f - a) * (b - f) <= 0.0)
		return false_position(s);
	return s->t[0] * (f * b) / ((a - f) * (a - b)) +
	    t * (a * b) / ((f - a) * (f - b)) +
	    s->t[1] * (a * f) / ((b - a) * (b - f));
}

static void narrow(struct search *s, double t, double f)
{
	int end = (f >= 0.0) == (s->f[1] >= 0.0); /* which is replaced */
	int8_t kept = end ? -1 : 1;

	s->t[end] = t;
	s->f[end] = f;
	if (s->kept == kept)
		s->f[1 - end] *= 0.5;
	s->kept = kept;
}

static bool is_done(const struct cells_grid *grid, const struct search *s)
{
	return s->t[1] - s->t[0] < fmax(BRACKET_DONE,
	    1.01 * grid->grains[s->axis]) || s->steps >= STEPS_MAX;
}

static void finish(struct edges *e, const struct search *s, double t,
    const float *gradient)
{
	struct mesh_crossing *c = e->w->crossings + s->crossing;
	struct vec3 g = vec3(gradient[0], gradient[1], gradient[2]);
	double outward = c->ends[0] >= c->ends[1] ? 1.0 : -1.0;

	c->at = (float)t;
	if (vec3_norm(g) > 0.0) {
		g = vec3_scale(-1.0, vec3_unit(g));
	} else {
		g = vec3(0.0, 0.0, 0.0);
		((double *)&g)[s->axis] = outward;
	}
	c->normal[0] = (float)g.x;
	c->normal[1] = (float)g.y;
	c->normal[2] = (float)g.z;
	e->done++;
}

/* Whether Newton's step from t to newton, f being the value at t, ends the
 * search; the bracket is still that of the step before. */
static bool is_near(const struct cells_grid *grid, const struct search *s,
    double t, double f, double newton)
{
	double step = fabs(newton - t);

	return step < fmax(STEP_DONE, 0.5 * grid->grains[s->axis]) ||
	    (s->steps == 0 && step < STEP_SMOOTH &&
	    fabs(parabola(s, t, f) - newton) < STEP_AGREED);
}

static void aim_next(struct search *s, double newton)
{
	double middle = 0.5 * (s->t[0] + s->t[1]);

	if (s->steps >= STEPS_FAST)
		aim(s, middle);
	else if (s->steps <= STEPS_NEWTON && newton > s->t[0] &&
	    newton < s->t[1])
		aim(s, within(s, newton));
	else
		aim(s, within(s, false_position(s)));
}

/* Takes a sample, value and gradient; whether the edge is done. */
static bool step(struct edges *e, struct search *s, const float row[4])
{
	double t = part(s), f = (double)row[0] - e->w->grid.iso;
	double slope = (double)row[1 + s->axis] *
	    ((double)s->last - s->corner[s->axis]);
	double newton = slope != 0.0 ? t - f / slope : INFINITY;
	bool fits = is_near(&e->w->grid, s, t, f, newton);

	narrow(s, t, f);
	s->steps++;
	fits = fits && newton >= s->t[0] && newton <= s->t[1];
	if (f == 0.0 || fits || is_done(&e->w->grid, s)) {
		finish(e, s, fits ? newton : t, row + 1);
		return true;
	}
	aim_next(s, newton);
	return false;
}

static void put_point(const struct search *s, float *p)
{
	memcpy(p, s->corner, sizeof s->corner);
	p[s->axis] = s->x;
}

static enum err run(struct edges *e)
{
	struct mesh_work *w = e->w;
	size_t count = e->count, left = 0;
	enum err err;

	if (!sampler_goes_on(w->sampler, "edges",
	    0.4 + 0.2 * (double)e->done / (double)(w->crossing_count + 1)))
		return ERR_CANCELLED;
	for (size_t i = 0; i < count; i++)
		put_point(e->open + i, w->points + 3 * i);
	err = mesh_sample(w, count, OUTPUT_VALUE | OUTPUT_GRADIENT);
	if (err != ERR_OK)
		return err;
	for (size_t i = 0; i < count; i++)
		if (!step(e, e->open + i, w->rows + 4 * i))
			e->open[left++] = e->open[i];
	e->count = left;
	return ERR_OK;
}

/* The search of a crossing, from the line between its ends. */
static struct search begin(const struct mesh_work *w, size_t crossing,
    const size_t corner[static 3], unsigned a)
{
	const struct mesh_crossing *c = w->crossings + crossing;
	struct search s = {.crossing = (uint32_t)crossing, .axis = (uint8_t)a,
	    .last = cells_corner(&w->grid, (int)a, corner[a] + 1),
	    .t = {0.0, 1.0}, .f = {(double)c->ends[0] - w->grid.iso,
	    (double)c->ends[1] - w->grid.iso}};

	for (int k = 0; k < 3; k++)
		s.corner[k] = cells_corner(&w->grid, k, corner[k]);
	aim(&s, within(&s, false_position(&s)));
	return s;
}

static void set_cap(struct mesh_crossing *c, unsigned a)
{
	memset(c->normal, 0, sizeof c->normal);
	c->normal[a] = c->ends[0] >= c->ends[1] ? 1.0f : -1.0f;
	c->at = 0.5f;
}

/* Edges that are worked on at a time. */
#define OPEN_MAX (MESH_BATCH / 2)

static enum err cross_block(struct edges *e, const struct mesh_block *b)
{
	struct mesh_work *w = e->w;
	size_t crossing = b->first_crossing[0];
	size_t corner[3];
	enum err err = ERR_OK;

	for (unsigned a = 0; a < 3; a++)
		for (uint64_t bits = b->edges[a]; bits != 0 && err == ERR_OK;
		    bits &= bits - 1, crossing++) {
			mesh_corner_of(b, (unsigned)__builtin_ctzll(bits),
			    corner);
			if (mesh_is_cap(&w->grid, corner, a)) {
				set_cap(w->crossings + crossing, a);
				e->done++;
				continue;
			}
			e->open[e->count++] = begin(w, crossing, corner, a);
			while (e->count == OPEN_MAX && err == ERR_OK)
				err = run(e);
		}
	return err;
}

enum err mesh_find_crossings(struct mesh_work *w)
{
	struct edges e = {w, malloc(OPEN_MAX * sizeof *e.open), 0, 0};
	enum err err = e.open == NULL ? ERR_MEMORY : ERR_OK;

	for (size_t i = 0; i < w->block_count && err == ERR_OK; i++)
		err = cross_block(&e, w->blocks + i);
	while (e.count > 0 && err == ERR_OK)
		err = run(&e);
	free(e.open);
	return err;
}
