#include "server/surface.h"

#include <math.h>
#include <pthread.h>
#include <stdbool.h>
#include <stdlib.h>

#include "core/range.h"
#include "core/sampler.h"
#include "core/tape.h"

/* Where a support without an end is cut: a surface that is not shown to end
 * before that is taken for endless. World units, or so many times the largest
 * coordinate of what ends. */
#define REACH 1e5f

/* As range_extent. */
#define SLACK 0.01

struct surface {
	const struct tape *tape;
	pthread_mutex_t lock;    /* guards the rest */
	struct range_tape *ranges; /* NULL: not yet */
	bool has_extent;
	double iso;              /* extent's */
	struct tape_box extent;
};

enum err surface_create(const struct tape *tape, struct surface **out)
{
	struct surface *s = calloc(1, sizeof *s);

	if (s == NULL)
		return ERR_MEMORY;
	s->tape = tape;
	pthread_mutex_init(&s->lock, NULL);
	*out = s;
	return ERR_OK;
}

void surface_free(struct surface *s)
{
	if (s == NULL)
		return;
	range_tape_free(s->ranges);
	pthread_mutex_destroy(&s->lock);
	free(s);
}

/* The support's box: that of what the tape ends with. */
static struct tape_box support(const struct tape *tape)
{
	const struct tape_box all = {
		{-INFINITY, -INFINITY, -INFINITY},
		{INFINITY, INFINITY, INFINITY},
	};

	return tape->boxes != NULL ? tape->boxes[tape->insn_count - 1] : all;
}

static float reach_of(const struct tape_box *box)
{
	float most = 1.0f;

	for (int i = 0; i < 3; i++) {
		if (isfinite(box->min[i]))
			most = fmaxf(most, fabsf(box->min[i]));
		if (isfinite(box->max[i]))
			most = fmaxf(most, fabsf(box->max[i]));
	}
	return REACH * most;
}

static bool is_empty(const struct tape_box *box)
{
	return box->min[0] > box->max[0] || box->min[1] > box->max[1] ||
	    box->min[2] > box->max[2];
}

static struct tape_box cut(const struct tape_box *box, float reach)
{
	struct tape_box out;

	for (int i = 0; i < 3; i++) {
		out.min[i] = fmaxf(box->min[i], -reach);
		out.max[i] = fminf(box->max[i], reach);
	}
	return out;
}

/* Coordinates of found that are where all was cut go to its own. */
static void uncut(const struct tape_box *all, float reach,
    struct tape_box *found)
{
	for (int i = 0; i < 3; i++) {
		if (all->min[i] < -reach && found->min[i] <= -0.9f * reach)
			found->min[i] = all->min[i];
		if (all->max[i] > reach && found->max[i] >= 0.9f * reach)
			found->max[i] = all->max[i];
	}
}

static enum err find_extent(const struct range_tape *ranges,
    const struct tape *tape, double iso, struct sampler *sampler,
    struct tape_box *out)
{
	const struct tape_box all = support(tape);
	const float reach = reach_of(&all);
	const struct tape_box domain = cut(&all, reach);
	struct tape_box found = domain;
	enum err err = is_empty(&domain) ? ERR_OK :
	    range_extent(ranges, iso, &domain, SLACK, sampler, &found);

	if (err != ERR_OK)
		return err;
	if (!is_empty(&found))
		uncut(&all, reach, &found);
	*out = found;
	return ERR_OK;
}

enum err surface_ranges(struct surface *s, const struct range_tape **out)
{
	struct range_tape *made;
	enum err err;

	pthread_mutex_lock(&s->lock);
	*out = s->ranges;
	pthread_mutex_unlock(&s->lock);
	if (*out != NULL)
		return ERR_OK;
	err = range_tape_create(s->tape, &made);
	if (err != ERR_OK)
		return err;
	pthread_mutex_lock(&s->lock);
	if (s->ranges == NULL) {
		s->ranges = made;
		made = NULL;
	}
	*out = s->ranges;
	pthread_mutex_unlock(&s->lock);
	range_tape_free(made); /* another was first */
	return ERR_OK;
}

bool surface_knows(struct surface *s, double iso, struct tape_box *out)
{
	bool knows;

	pthread_mutex_lock(&s->lock);
	knows = s->has_extent && s->iso == iso;
	if (knows)
		*out = s->extent;
	pthread_mutex_unlock(&s->lock);
	return knows;
}

enum err surface_extent(struct surface *s, double iso, struct sampler *sampler,
    struct tape_box *out)
{
	const struct range_tape *ranges;
	enum err err;

	if (surface_knows(s, iso, out))
		return ERR_OK;
	err = surface_ranges(s, &ranges);
	if (err == ERR_OK)
		err = find_extent(ranges, s->tape, iso, sampler, out);
	if (err != ERR_OK)
		return err;
	pthread_mutex_lock(&s->lock);
	s->extent = *out;
	s->iso = iso;
	s->has_extent = true;
	pthread_mutex_unlock(&s->lock);
	return ERR_OK;
}
