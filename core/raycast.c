/*
 * Rays are many and go along one model, so that what is known of a part of space
 * is kept (core/raycast_field.h). From a box that may hold some of the surface a
 * ray cuts a piece; its ends are sampled, and then
 *   - a piece whose range does not hold iso is passed over;
 *   - one along which the field only rises, or only falls, crosses iso as its
 *     ends say: once or not at all;
 *   - one whose ends are on the same side, further from iso than the steepest
 *     slopes could bring them, is passed over;
 *   - one no longer than tolerance is what its ends say;
 *   - any other is cut into parts, the first one first.
 * A crossing is closed in on by false position (Illinois). All rays go side by
 * side, so that each round is one batch of samples.
 *
 * The slopes are those of core/range.h's intervals, which leave out how a blend
 * changes as its angle does. Where that takes part a piece is cut once more than
 * needed, into parts no longer than half of the least thing there; slopes count
 * as what the samples about it show, and as much again as these differ; and
 * nothing is passed over but by slopes of either sign.
 */
#include "core/raycast.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "core/output.h"
#include "core/range.h"
#include "core/range_parts.h"
#include "core/raycast_field.h"
#include "core/tape.h"

/* Rays that are on their way at a time. */
#define FLIGHT 8192

/* Parts of a piece that is cut: few, but of a ray that has gone many rounds
 * more, for the sake of fewer. It does not depend on other rays, so that no
 * answer does. */
#define PARTS 2
#define PARTS_MORE 4
#define PARTS_MANY 8
#define ROUNDS_FEW 4
#define ROUNDS_SOME 8

/* Pieces that a ray may have before it. */
#define PIECES 64

#define SAMPLES (PARTS_MANY - 1)

/* Slopes of devices' fields, tables and all, beside those of the exact one. */
#define SLOPE_SLACK 1.02

/* Parts of a piece whose slopes are to be seen, and how long it may be, in sizes
 * of the least primitive. */
#define PARTS_ANGLED 4
#define ANGLED_LENGTH 0.5

/* How steeply a changing angle may bring a field back, over its steepest slope.
 * Of 16,824 rays at 701 random trees one missed a dip without it, which 0.25
 * would have found. */
#define ANGLED_SLOPE 0.5

/* ---- rays ---- */

/* A piece of a ray, and what the field is at its ends: v = f - iso. */
struct piece {
	double a, b;
	float va, vb; /* NaN: not known */
	float fall, rise; /* slopes that samples about it show; NaN: none */
};

enum ray_state {
	RAY_WALKS,  /* wants its next piece */
	RAY_ENDS,   /* has asked for the top piece's ends */
	RAY_CUTS,   /* has asked for what is between its parts */
	RAY_CLOSES, /* has asked for a place nearer to the crossing */
	RAY_DONE
};

struct ray {
	double o[3], d[3]; /* d: a unit vector */
	double inv[3];     /* 1/d, where d is not 0 */
	double t, end;     /* where the next piece begins; nothing is beyond */
	double far;        /* the origin's largest coordinate */
	const struct cell *cell; /* the pieces' */
	struct piece *pieces;    /* PIECES; the last is the next */
	int state, count, parts;
	int asked_count;
	double asked[SAMPLES]; /* what was asked for */
	/* closing in */
	double a, b;
	float va, vb;
	double weight_a, weight_b; /* of Illinois: va, vb or halves of them */
	int rounds; /* of cuts; then of closing in */
	size_t index;
};

struct raycaster {
	struct field field;
	struct tape_box extent;
	struct raycast_options options;
	bool is_empty; /* extent is */
	/* of a run */
	struct sampler *sampler;
	struct ray *rays;     /* FLIGHT */
	struct piece *pieces; /* theirs */
	int flying;
	float *points, *values;
	const float *input;
	size_t count, next, done, asked;
	struct ray_hit *hits;
};

/* As fmax and fmin, inline; of numbers. */
static double larger(double a, double b)
{
	return a > b ? a : b;
}

static double smaller(double a, double b)
{
	return a < b ? a : b;
}

static void place(const struct ray *r, double t, double p[static 3])
{
	for (int i = 0; i < 3; i++)
		p[i] = r->o[i] + t * r->d[i];
}

static struct vec3 place_at(const struct ray *r, double t)
{
	double p[3];

	place(r, t, p);
	return vec3(p[0], p[1], p[2]);
}

/* Where the ray leaves the box, from t on. */
static double leaves(const struct ray *r, const double *least,
    const double *most)
{
	double out = INFINITY;

	for (int i = 0; i < 3; i++) {
		double t;

		if (r->d[i] == 0.0)
			continue;
		t = ((r->d[i] > 0.0 ? most[i] : least[i]) - r->o[i]) *
		    r->inv[i];
		if (t < out)
			out = t;
	}
	return out;
}

static double enters(const struct ray *r, const double *least,
    const double *most, bool *misses)
{
	double out = 0.0;

	for (int i = 0; i < 3; i++) {
		double t;

		if (r->d[i] == 0.0) {
			*misses |= r->o[i] < least[i] || r->o[i] > most[i];
			continue;
		}
		t = ((r->d[i] > 0.0 ? least[i] : most[i]) - r->o[i]) *
		    r->inv[i];
		if (t > out)
			out = t;
	}
	return out;
}

/* What of the ray is looked at: what is within extent, and its own reach. */
static void clip(const struct raycaster *c, struct ray *r)
{
	const double reach = field_reach(&c->extent, r->far);
	double least[3], most[3];
	bool misses = false;

	for (int i = 0; i < 3; i++) {
		least[i] = fmax(c->extent.min[i], -reach);
		most[i] = fmin(c->extent.max[i], reach);
	}
	r->t = enters(r, least, most, &misses);
	r->end = fmin(leaves(r, least, most), c->options.max_distance);
	if (misses || !(r->t <= r->end))
		r->state = RAY_DONE;
}

/* Takes up the next ray; one that misses everything is done. */
static void start(struct raycaster *c, struct ray *r)
{
	const float *in = c->input + c->next * RAY_FLOATS;
	double most = 0.0, norm = 0.0;

	r->index = c->next++;
	r->state = RAY_WALKS;
	r->count = r->asked_count = r->rounds = 0;
	r->far = 0.0;
	r->vb = NAN;
	for (int i = 0; i < 3; i++)
		most = fmax(most, fabs((double)in[3 + i]));
	for (int i = 0; i < 3; i++) {
		r->o[i] = in[i];
		r->far = fmax(r->far, fabs(r->o[i]));
		r->d[i] = in[3 + i] / most;
		norm += r->d[i] * r->d[i];
	}
	for (int i = 0; i < 3; i++) {
		r->d[i] /= sqrt(norm);
		r->inv[i] = 1.0 / r->d[i];
	}
	clip(c, r);
}

static void ask(struct ray *r, double t)
{
	r->asked[r->asked_count++] = t;
}

/* Finds the next box that may hold some of the surface: the ray's next piece. */
static enum err walk_on(struct raycaster *c, struct ray *r)
{
	const double least = 1e-3 * c->options.tolerance;

	while (r->t < r->end) {
		/* a little on, so as not to stop at a box's side */
		double step = larger(least, 1e-15 * (fabs(r->t) + r->far));
		double p[3], exit;
		const struct cell *cell;
		enum err err;

		place(r, r->t + step, p);
		err = field_find(&c->field, p, r->d, &cell);
		if (err)
			return err;
		exit = smaller(leaves(r, cell->min, cell->max), r->end);
		exit = larger(exit, r->t + step);
		if (cell->state == CELL_EMPTY) {
			r->t = exit;
			r->vb = NAN;
			continue;
		}
		r->cell = cell;
		r->pieces[0] = (struct piece){r->t, smaller(exit, r->end), r->vb,
		    NAN, NAN, NAN};
		r->count = 1;
		r->t = exit;
		return ERR_OK;
	}
	r->state = RAY_DONE;
	return ERR_OK;
}

/* Slopes along a piece, per unit of length, and as the samples show them. */
static void widen(const struct piece *p, struct held *held)
{
	double slack = SLOPE_SLACK * 2.0 / (p->b - p->a), more;

	held->fall *= slack;
	held->rise *= slack;
	if (!held->is_angled)
		return;
	more = (double)p->rise - p->fall;
	held->fall = fmin(held->fall, p->fall - more);
	held->rise = fmax(held->rise, p->rise + more);
}

/* Whether a piece's slopes cannot be known yet. */
static bool is_unseen(const struct ray *r, const struct held *held)
{
	const struct piece *p = r->pieces + r->count - 1;

	return held->is_angled && (isnan(p->fall) || p->b - p->a >
	    ANGLED_LENGTH * r->cell->least);
}

/* Whether a piece whose ends are on one side may be on the other between. */
static bool may_cross(const struct piece *p, const struct held *held)
{
	double va = p->va, vb = p->vb, length = p->b - p->a;
	double up = va > 0.0 ? -held->fall : held->rise;
	double down = va > 0.0 ? held->rise : -held->fall;

	/* as steep as can be from the one, back to the other as steeply */
	va = fabs(va);
	vb = fabs(vb);
	if (!(up > 0.0) || !(down > 0.0))
		return false;
	if (isinf(up) || isinf(down))
		return true;
	return va / up + vb / down < length;
}

static void close_in(struct ray *r, const struct piece *p)
{
	r->a = p->a;
	r->b = p->b;
	r->va = p->va;
	r->vb = p->vb;
	r->weight_a = p->va;
	r->weight_b = p->vb;
	r->rounds = 0;
	r->state = RAY_CLOSES;
}

static bool inside(float v)
{
	return v > 0.0f;
}

static void pop(struct ray *r)
{
	r->count--;
	r->vb = r->pieces[r->count].vb;
}

/* Asks for the places between parts of the top piece, at least so many. */
static void cut(struct ray *r, int least)
{
	const struct piece *p = r->pieces + r->count - 1;
	const int wanted = r->rounds < ROUNDS_FEW ? PARTS :
	    r->rounds < ROUNDS_SOME ? PARTS_MORE : PARTS_MANY;
	const int parts = wanted > least ? wanted : least;

	r->parts = r->count + parts <= PIECES ? parts : 2;
	for (int i = 1; i < r->parts; i++)
		ask(r, p->a + (p->b - p->a) * i / r->parts);
	r->rounds++;
	r->state = RAY_CUTS;
}

/* No two places of the ray that are nearer to each other than this, between a
 * and b, differ as float32. */
static double resolution(const struct ray *r, double a, double b)
{
	double most = 0.0;

	for (int i = 0; i < 3; i++)
		most = larger(most, larger(fabs(r->o[i] + a * r->d[i]),
		    fabs(r->o[i] + b * r->d[i])));
	return 6e-8 * most + 1e-37;
}

/* Whether a piece is what its ends say: it is short, or there is no room for its
 * parts, which are shorter than any other's then. */
static bool is_short(const struct raycaster *c, const struct ray *r)
{
	const struct piece *p = r->pieces + r->count - 1;
	double length = p->b - p->a;

	return length <= c->options.tolerance || r->count + 2 > PIECES ||
	    length <= resolution(r, p->a, p->b);
}

static void ask_ends(struct ray *r, const struct piece *p)
{
	if (isnan(p->va))
		ask(r, p->a);
	if (isnan(p->vb))
		ask(r, p->b);
	r->state = RAY_ENDS;
}

/* By slopes, with the top piece's ends known: what is done with it. */
static void judge_slopes(struct ray *r, struct held *held)
{
	const struct piece *p = r->pieces + r->count - 1;
	const bool changes = inside(p->va) != inside(p->vb);
	bool straight;

	widen(p, held);
	straight = held->fall >= 0.0 || held->rise <= 0.0;
	if (held->is_angled && !changes) {
		double most = ANGLED_SLOPE * fmax(-held->fall, held->rise);

		held->fall = fmin(held->fall, -most);
		held->rise = fmax(held->rise, most);
		straight = false;
	}
	if (changes && straight)
		close_in(r, p);
	else if (!changes && (straight || !may_cross(p, held)))
		pop(r);
	else
		cut(r, PARTS);
}

/* What is to be done with the top piece: it is gone, or has asked. */
static void judge(struct raycaster *c, struct ray *r)
{
	const struct piece *p = r->pieces + r->count - 1;
	const double iso = c->options.iso;
	const double margin = RANGE_MARGIN * fmax(1.0, iso);
	const bool is_known = !isnan(p->va) && !isnan(p->vb);
	const bool changes = is_known && inside(p->va) != inside(p->vb);
	const bool is_last = is_known && is_short(c, r);
	struct held held;

	if (is_last && !changes) {
		pop(r);
		return;
	}
	range_stretch(c->field.tape, &r->cell->list, place_at(r, p->a),
	    place_at(r, p->b), &held);
	if (held.most + margin < iso || held.least - margin > iso)
		pop(r);
	else if (!is_known)
		ask_ends(r, p);
	else if (is_last)
		close_in(r, p);
	else if (is_unseen(r, &held))
		cut(r, PARTS_ANGLED);
	else
		judge_slopes(r, &held);
}

/* Done: at the end of the bracket that is nearer to iso. */
static void hit(struct raycaster *c, struct ray *r)
{
	double t = fabsf(r->va) <= fabsf(r->vb) ? r->a : r->b;
	struct ray_hit *h = c->hits + r->index;
	double p[3];

	place(r, t, p);
	*h = (struct ray_hit){true, (float)t, {(float)p[0], (float)p[1],
	    (float)p[2]}};
	r->state = RAY_DONE;
}

/* What a float32 is rounded by beside iso. */
static float least_value(const struct raycaster *c)
{
	return (float)(6e-8 * c->options.iso);
}

#define ROUNDS 60

/* Asks for the next place of a bracket, or is done. */
static void narrow(struct raycaster *c, struct ray *r)
{
	double t, width = r->b - r->a;

	if (width <= resolution(r, r->a, r->b) || r->rounds >= ROUNDS ||
	    fminf(fabsf(r->va), fabsf(r->vb)) <= least_value(c)) {
		hit(c, r);
		return;
	}
	t = r->a + width * (r->weight_a / (r->weight_a - r->weight_b));
	/* every fourth by halves: no bracket takes long */
	if (r->rounds % 4 == 3 || !(t > r->a && t < r->b))
		t = r->a + 0.5 * width;
	ask(r, t);
	r->rounds++;
}

static void took_ends(struct ray *r, const float *values)
{
	struct piece *p = r->pieces + r->count - 1;

	if (isnan(p->va))
		p->va = *values++;
	if (isnan(p->vb))
		p->vb = *values;
	r->state = RAY_WALKS;
}

/* What the slopes from sample to sample show of part i: its own, and those of
 * the parts beside it. */
static void show_slopes(const struct piece *parts, int n, int i,
    struct piece *out)
{
	double least = INFINITY, most = -INFINITY;

	for (int k = i > 0 ? i - 1 : 0; k <= i + 1 && k < n; k++) {
		const struct piece *p = parts + k;
		double slope = ((double)p->vb - p->va) / (p->b - p->a);

		least = fmin(least, slope);
		most = fmax(most, slope);
	}
	out->fall = (float)least;
	out->rise = (float)most;
}

static void took_cuts(struct ray *r, const float *values)
{
	struct piece whole = r->pieces[--r->count], parts[PARTS_MANY];
	int n = r->parts;

	for (int i = 0; i < n; i++)
		parts[i] = (struct piece){
		    i == 0 ? whole.a : r->asked[i - 1],
		    i == n - 1 ? whole.b : r->asked[i],
		    i == 0 ? whole.va : values[i - 1],
		    i == n - 1 ? whole.vb : values[i], NAN, NAN};
	for (int i = n - 1; i >= 0; i--) {
		struct piece *p = r->pieces + r->count++;

		*p = parts[i];
		show_slopes(parts, n, i, p);
	}
	r->state = RAY_WALKS;
}

static void took_closer(struct ray *r, const float *values)
{
	float v = values[0];

	if (inside(v) == inside(r->va)) {
		r->a = r->asked[0];
		/* the other end has stayed: half of it */
		if (r->weight_a == r->va)
			r->weight_b = r->rounds > 1 && r->weight_b == r->vb ?
			    0.5 * r->weight_b : r->weight_b;
		r->va = v;
		r->weight_a = v;
	} else {
		r->b = r->asked[0];
		if (r->weight_b == r->vb)
			r->weight_a = r->rounds > 1 && r->weight_a == r->va ?
			    0.5 * r->weight_a : r->weight_a;
		r->vb = v;
		r->weight_b = v;
	}
}

/* With the answers to what it asked for, on to what it asks for next. */
static enum err advance(struct raycaster *c, struct ray *r, const float *values)
{
	int state = r->state;
	enum err err;

	if (r->asked_count > 0) {
		if (state == RAY_ENDS)
			took_ends(r, values);
		else if (state == RAY_CUTS)
			took_cuts(r, values);
		else if (state == RAY_CLOSES)
			took_closer(r, values);
	}
	r->asked_count = 0;
	while (r->state == RAY_WALKS) {
		if (r->count == 0) {
			err = walk_on(c, r);
			if (err)
				return err;
			if (r->state == RAY_DONE)
				break;
		}
		judge(c, r);
	}
	if (r->state == RAY_CLOSES)
		narrow(c, r);
	return ERR_OK;
}

/* ---- all of them ---- */

/* Rays that are begun, or end, between two looks at whether to go on. */
#define ASK_EVERY 1024

static bool goes_on(struct raycaster *c)
{
	c->asked = c->next;
	return sampler_goes_on(c->sampler, "rays",
	    (double)c->done / (double)c->count);
}

/* The last ray takes its place: with its pieces. */
static void drop(struct raycaster *c, struct ray *r)
{
	struct ray *last = c->rays + --c->flying;
	struct piece *pieces = r->pieces;

	if (r == last)
		return;
	*r = *last;
	last->pieces = pieces;
}

/* Takes rays up until one asks for something, which stays in r; where there are
 * no more r is DONE. */
static enum err take_up(struct raycaster *c, struct ray *r)
{
	r->state = RAY_DONE;
	while (r->state == RAY_DONE && c->next < c->count) {
		enum err err;

		if (c->next - c->asked >= ASK_EVERY && !goes_on(c))
			return ERR_CANCELLED;
		start(c, r);
		err = advance(c, r, NULL);
		if (err)
			return err;
		c->done += r->state == RAY_DONE;
	}
	return ERR_OK;
}

/* Puts rays in flight until one asks for something in each place, or there are
 * no more. */
static enum err refill(struct raycaster *c)
{
	enum err err = ERR_OK;

	for (int i = 0; i < c->flying && err == ERR_OK;) {
		struct ray *r = c->rays + i;

		if (r->state == RAY_DONE) {
			c->done++;
			err = take_up(c, r);
		}
		if (r->state == RAY_DONE)
			drop(c, r);
		else
			i++;
	}
	while (err == ERR_OK && c->flying < FLIGHT && c->next < c->count) {
		struct ray *r = c->rays + c->flying;

		err = take_up(c, r);
		c->flying += r->state != RAY_DONE;
	}
	return err;
}

/* One batch of samples. */
static enum err take_samples(struct raycaster *c, size_t *out)
{
	size_t n = 0;
	enum err err;

	for (int i = 0; i < c->flying; i++) {
		const struct ray *r = c->rays + i;

		for (int k = 0; k < r->asked_count; k++) {
			double p[3];

			place(r, r->asked[k], p);
			for (int j = 0; j < 3; j++)
				c->points[3 * n + (size_t)j] = (float)p[j];
			n++;
		}
	}
	*out = n;
	if (n == 0)
		return ERR_OK;
	err = c->sampler->sample(c->sampler, c->points, n, OUTPUT_VALUE,
	    c->values);
	for (size_t i = 0; i < n && err == ERR_OK; i++)
		c->values[i] -= (float)c->options.iso;
	return err;
}

static enum err run(struct raycaster *c)
{
	enum err err = refill(c);

	while (err == ERR_OK && c->flying > 0) {
		const float *values = c->values;
		size_t n;

		if (!goes_on(c))
			return ERR_CANCELLED;
		err = take_samples(c, &n);
		for (int i = 0; i < c->flying && err == ERR_OK; i++) {
			struct ray *r = c->rays + i;
			int taken = r->asked_count;

			err = advance(c, r, values);
			values += taken;
		}
		if (err == ERR_OK)
			err = refill(c);
	}
	return err;
}

/* ---- life ---- */

void raycaster_free(struct raycaster *c)
{
	if (c == NULL)
		return;
	field_fini(&c->field);
	free(c->rays);
	free(c->pieces);
	free(c->points);
	free(c->values);
	free(c);
}

static enum err make_room(struct raycaster *c)
{
	c->rays = malloc(FLIGHT * sizeof *c->rays);
	c->pieces = malloc(FLIGHT * PIECES * sizeof *c->pieces);
	c->points = malloc(FLIGHT * SAMPLES * 3 * sizeof *c->points);
	c->values = malloc(FLIGHT * SAMPLES * sizeof *c->values);
	if (c->rays == NULL || c->pieces == NULL || c->points == NULL ||
	    c->values == NULL)
		return ERR_MEMORY;
	for (int i = 0; i < FLIGHT; i++)
		c->rays[i].pieces = c->pieces + i * PIECES;
	return ERR_OK;
}

enum err raycaster_create(const struct range_tape *tape,
    const struct raycast_options *options, struct raycaster **out)
{
	struct raycaster *c = calloc(1, sizeof *c);
	enum err err;

	if (c == NULL)
		return ERR_MEMORY;
	c->extent = *options->extent;
	c->options = *options;
	c->options.extent = &c->extent;
	for (int i = 0; i < 3; i++)
		c->is_empty |= c->extent.min[i] > c->extent.max[i];
	if (c->is_empty) {
		*out = c;
		return ERR_OK;
	}
	err = field_init(&c->field, tape, options->iso, &c->extent);
	if (err) {
		free(c);
		return err;
	}
	err = make_room(c);
	if (err) {
		raycaster_free(c);
		return err;
	}
	*out = c;
	return ERR_OK;
}

enum err raycaster_run(struct raycaster *c, const float *rays, size_t count,
    struct sampler *sampler, struct ray_hit *hits)
{
	for (size_t i = 0; i < count; i++)
		hits[i] = (struct ray_hit){0};
	if (c->is_empty || count == 0)
		return ERR_OK;
	c->sampler = sampler;
	c->input = rays;
	c->count = count;
	c->hits = hits;
	c->next = c->done = c->asked = 0;
	c->flying = 0;
	return run(c);
}

enum err raycast(const struct range_tape *tape,
    const struct raycast_options *options, const float *rays, size_t count,
    struct sampler *sampler, struct ray_hit *hits)
{
	struct raycaster *c;
	enum err err = raycaster_create(tape, options, &c);

	if (err)
		return err;
	err = raycaster_run(c, rays, count, sampler, hits);
	raycaster_free(c);
	return err;
}
