#include "core/project.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "core/output.h"
#include "core/vec3.h"

/* Points that are on their way together. */
#define CHUNK ((size_t)1 << 17)

/* Evaluations a point takes at most: what comes to rest on a crease would go on
 * for ever. */
#define TRIES 96

/* As close as this, times 1 + iso, is there. */
#define CLOSE 1e-5

/* World units: as far as points may be from each other, about. */
#define LONGEST 1e9

/* A step shortened by so much is none. */
#define SHORTEST 1e-12

#define OUTPUTS (OUTPUT_VALUE | OUTPUT_GRADIENT)
#define COLUMNS 4

/* Of positions, relative: half the spacing of float32. */
#define ROUNDING 6e-8

enum state {
	SEEKING,   /* by Newton's steps */
	BRACKETED, /* between two points of different sign */
	ENDED
};

/* A place, and f - iso and the gradient there. */
struct place {
	float at[3];
	double over;
	float gradient[3];
};

struct walk {
	enum state state;
	struct place here, far;  /* far: if bracketed */
	float to[3];             /* what is asked for */
	double scale;            /* of the next step */
	double weight[2];        /* of here and far, Illinois' */
	bool moved_far;          /* the end that moved last */
	int tries;
};

struct projector {
	double iso, max_distance, close;
	const float *points;
	struct walk *walks;
	size_t count;
	size_t *active;          /* indices of walks that go on */
	size_t active_count;
	float *asked, *rows;
};

static struct vec3 vec3_of(const float v[static 3])
{
	return (struct vec3){v[0], v[1], v[2]};
}

static bool is_same(const float a[static 3], const float b[static 3])
{
	return a[0] == b[0] && a[1] == b[1] && a[2] == b[2];
}

static void copy3(float to[static 3], const float from[static 3])
{
	memcpy(to, from, 3 * sizeof *to);
}

/* ---- where to look next ---- */

/*
 * The length of Newton's step where f = value: |f - iso| / |grad f|, and below
 * iso, with h = f^(1/3), (h(iso) - h(f)) / |grad h|, h' = h / 3f.
 */
static double newton_length(double value, double iso, double slope)
{
	double root;

	if (value <= 0.0 || value >= iso)
		return fabs(value - iso) / slope;
	root = cbrt(value);
	return (cbrt(iso) - root) * 3.0 * root * root / slope;
}

/* How near to iso float32 can be expected to come at w->here. */
static double resolution(const struct walk *w)
{
	const struct vec3 at = vec3_of(w->here.at);
	const double reach = fabs(at.x) + fabs(at.y) + fabs(at.z);

	return 2.0 * ROUNDING * reach *
	    vec3_norm(vec3_of(w->here.gradient));
}

/* Sets w->to to a step from w->here; ends w where there is none. */
static void seek(const struct projector *j, struct walk *w, size_t index)
{
	const struct vec3 at = vec3_of(w->here.at);
	const struct vec3 gradient = vec3_of(w->here.gradient);
	const struct vec3 from = vec3_of(j->points + 3 * index);
	const double slope = vec3_norm(gradient);
	const double left = j->max_distance -
	    vec3_norm(vec3_sub(at, from));
	double length;
	struct vec3 to;

	w->state = ENDED;
	if (!(slope > 0.0) || w->scale < SHORTEST || !(left > 0.0))
		return;
	length = w->scale * fmin(newton_length(w->here.over + j->iso, j->iso,
	    slope), fmin(0.5 * left, LONGEST));
	to = vec3_axpy((w->here.over < 0.0 ? length : -length) / slope,
	    gradient, at);
	w->to[0] = (float)to.x;
	w->to[1] = (float)to.y;
	w->to[2] = (float)to.z;
	if (!is_same(w->to, w->here.at))
		w->state = SEEKING;
}

/* Sets w->to between its ends by the Illinois rule (Dowell, Jarratt 1971), or
 * halfway where the far end is flat; ends w where nothing is between. */
static void halve(struct walk *w)
{
	const double near = fabs(w->here.over) * w->weight[0];
	const double far = fabs(w->far.over) * w->weight[1];
	const bool is_flat = vec3_norm(vec3_of(w->far.gradient)) == 0.0;
	double part = near / (near + far);

	if (is_flat || !(part > 0.01 && part < 0.99) || w->tries % 6 == 5)
		part = 0.5;
	for (int i = 0; i < 3; i++)
		w->to[i] = (float)(w->here.at[i] + part *
		    ((double)w->far.at[i] - w->here.at[i]));
	if (is_same(w->to, w->here.at) || is_same(w->to, w->far.at))
		for (int i = 0; i < 3; i++)
			w->to[i] = (float)(0.5 * ((double)w->here.at[i] +
			    w->far.at[i]));
	if (is_same(w->to, w->here.at) || is_same(w->to, w->far.at))
		w->state = ENDED;
}

/* The next of w, whose last answer has been taken. */
static void plan(const struct projector *j, struct walk *w, size_t index)
{
	if (fabs(w->here.over) <= j->close || ++w->tries > TRIES)
		w->state = ENDED;
	else if (w->state == BRACKETED)
		halve(w);
	else if (w->state == SEEKING)
		seek(j, w, index);
}

/* ---- what was found ---- */

static void take_seeking(struct walk *w, const struct place *found)
{
	if ((found->over < 0.0) != (w->here.over < 0.0)) {
		w->far = *found;
		w->weight[0] = w->weight[1] = 1.0;
		w->state = BRACKETED;
	} else if (fabs(found->over) < fabs(w->here.over)) {
		w->here = *found;
		w->scale = 1.0;
	} else {
		w->scale *= 0.5;
	}
}

static void take_bracketed(struct walk *w, const struct place *found)
{
	const bool is_far = (found->over < 0.0) == (w->far.over < 0.0);

	if (is_far)
		w->far = *found;
	else
		w->here = *found;
	w->weight[is_far] = 1.0;
	if (w->moved_far == is_far)
		w->weight[!is_far] *= 0.5;
	w->moved_far = is_far;
}

static void take(const struct projector *j, struct walk *w, const float *row)
{
	struct place found = {.over = row[0] - j->iso};

	copy3(found.at, w->to);
	copy3(found.gradient, row + 1);
	if (w->tries == 0 || fabs(found.over) <= j->close)
		w->here = found;
	else if (w->state == BRACKETED)
		take_bracketed(w, &found);
	else
		take_seeking(w, &found);
}

static void conclude(const struct projector *j, const struct walk *w,
    size_t index, double first_over, struct projection *out)
{
	const bool is_bracketed = w->far.over != 0.0 &&
	    (w->far.over < 0.0) != (w->here.over < 0.0);
	const struct place *best = is_bracketed &&
	    fabs(w->far.over) < fabs(w->here.over) ? &w->far : &w->here;
	const struct vec3 gradient = vec3_of(best->gradient);
	const double slope = vec3_norm(gradient);
	const double distance = vec3_norm(vec3_sub(vec3_of(best->at),
	    vec3_of(j->points + 3 * index)));

	*out = (struct projection){
		.converged = is_bracketed || fabs(best->over) <=
		    fmax(j->close, resolution(w)),
		.distance = (float)(first_over < 0.0 ? distance : -distance),
		.value = (float)(best->over + j->iso),
	};
	copy3(out->position, best->at);
	if (slope > 0.0) {
		out->normal[0] = (float)(-gradient.x / slope);
		out->normal[1] = (float)(-gradient.y / slope);
		out->normal[2] = (float)(-gradient.z / slope);
	}
}

/* ---- all of them ---- */

/* Asks for what every walk that goes on wants to know. */
static enum err ask(struct projector *j, struct sampler *sampler)
{
	for (size_t i = 0; i < j->active_count; i++)
		copy3(j->asked + 3 * i, j->walks[j->active[i]].to);
	return sampler->sample(sampler, j->asked, j->active_count, OUTPUTS,
	    j->rows);
}

/* Takes the answers, and leaves those active that have not ended. */
static void advance(struct projector *j)
{
	size_t left = 0;

	for (size_t i = 0; i < j->active_count; i++) {
		struct walk *w = &j->walks[j->active[i]];

		take(j, w, j->rows + COLUMNS * i);
		plan(j, w, j->active[i]);
		if (w->state != ENDED)
			j->active[left++] = j->active[i];
	}
	j->active_count = left;
}

static void begin(struct projector *j)
{
	for (size_t i = 0; i < j->count; i++) {
		j->walks[i] = (struct walk){.state = SEEKING, .scale = 1.0};
		copy3(j->walks[i].to, j->points + 3 * i);
		j->active[i] = i;
	}
	j->active_count = j->count;
}

/* Whether f was under iso where each began, as -1 or 1, in its distance. */
static void note_sides(const struct projector *j, struct projection *out)
{
	for (size_t i = 0; i < j->count; i++)
		out[i].distance = j->rows[COLUMNS * i] < j->iso ? -1.0f : 1.0f;
}

static enum err project_chunk(struct projector *j, struct sampler *sampler,
    double before, double share, struct projection *out)
{
	enum err err = ERR_OK;

	begin(j);
	for (int round = 0; j->active_count > 0 && err == ERR_OK; round++) {
		const double part = 1.0 - (double)j->active_count /
		    (double)j->count;

		if (!sampler_goes_on(sampler, "points", before + share * part))
			return ERR_CANCELLED;
		err = ask(j, sampler);
		if (err != ERR_OK)
			return err;
		if (round == 0)
			note_sides(j, out);
		advance(j);
	}
	for (size_t i = 0; i < j->count; i++)
		conclude(j, &j->walks[i], i, out[i].distance, &out[i]);
	return ERR_OK;
}

enum err project(double iso, double max_distance, const float *points,
    size_t count, struct sampler *sampler, struct projection *out)
{
	const size_t room = count < CHUNK ? count : CHUNK;
	struct projector j = {
		.iso = iso,
		.max_distance = max_distance,
		.close = CLOSE * (1.0 + iso),
		.walks = malloc((room + 1) * sizeof *j.walks),
		.active = malloc((room + 1) * sizeof *j.active),
		.asked = malloc((room + 1) * 3 * sizeof *j.asked),
		.rows = malloc((room + 1) * COLUMNS * sizeof *j.rows),
	};
	enum err err = j.walks != NULL && j.active != NULL &&
	    j.asked != NULL && j.rows != NULL ? ERR_OK : ERR_MEMORY;

	for (size_t first = 0; first < count && err == ERR_OK;
	    first += room) {
		j.points = points + 3 * first;
		j.count = count - first < room ? count - first : room;
		err = project_chunk(&j, sampler, (double)first /
		    (double)count, (double)j.count / (double)count,
		    out + first);
	}
	free(j.rows);
	free(j.asked);
	free(j.active);
	free(j.walks);
	return err;
}
