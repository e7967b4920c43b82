/*
 * The box about a level set: boxes that may hold some of it are kept in one
 * pool, and for each face of the box about them the one that reaches furthest
 * is halved along its longest edge, until that one is small; then no part of
 * the surface is further out than its face, and that is near it. What pruning
 * leaves of the tape goes from a box to its halves.
 */
#include "core/range.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "core/sampler.h"
#include "core/tape.h"

/* Boxes that are held, all in all. */
#define LEAVES_MAX 16384

/*
 * What is spent, in instructions of some 40 ns, on ranges; and how often is
 * asked whether to go on: every millisecond. When it is used up the faces stay
 * where they are known to suffice.
 */
#define BUDGET 3e6
#define ASK_EVERY 2.5e4

/* Bytes of lists: when they are used up boxes have their ancestors'. */
#define LISTS_MAX ((size_t)32 << 20)

/* At first a side's outer part is cut off if there is nothing in it: from this
 * part of the way from the middle on. */
static const double trims[] = {1.0 / 32.0, 0.25, 0.6, 0.8, 0.9};

#define FACES 6

/* A list that leaves share. */
struct shared {
	struct prune_list list;
	double cost;
	size_t bytes;
	int users;
};

struct leaf {
	struct tape_box box;
	struct shared *list; /* NULL: halved, not a leaf any more */
};

struct heap {
	int *leaves;
	int count;
};

struct search {
	const struct range_tape *tape;
	double iso;
	struct sampler *sampler;
	double spent, asked; /* when it was last asked */
	size_t bytes;
	struct shared whole; /* the tape */
	struct prune_list part;
	struct leaf *leaves;
	int count;
	struct heap heaps[FACES]; /* min x, max x, min y ... */
};

/* ---- lists ---- */

/* Instructions' ranges' times, over the common one's. */
static double cost_of(const struct prune_list *list)
{
	static const unsigned char more[OP_COUNT] = {
		[OP_CAUCHY_POINT] = 1, [OP_CAUCHY_SEGMENT] = 2,
		[OP_CAUCHY_TRIANGLE] = 3, [OP_VOLUME] = 7, [OP_ENTER] = 7,
		[OP_TRIANGLE] = 3, [OP_CONE] = 2, [OP_CYLINDER] = 2,
		[OP_CLASSIC] = 3, [OP_CLASSIC_SWAPPED] = 3, [OP_RICCI] = 3,
		[OP_UNION] = 5, [OP_INTERSECTION] = 5, [OP_DIFFERENCE] = 5,
		[OP_DIFFERENCE_SWAPPED] = 5,
	};
	double cost = 0.0;

	for (size_t i = 0; i < list->count; i++)
		cost += 1.0 + more[list->insns[i].op];
	return cost;
}

static void release(struct search *s, struct shared *l)
{
	if (l == NULL || --l->users > 0)
		return;
	s->bytes -= l->bytes;
	range_list_free(&l->list);
	free(l);
}

/* What s->part is for a leaf whose parent's list is from: its own, if that is
 * enough shorter. The caller's to release. */
static enum err share(struct search *s, struct shared *from, double cost,
    struct shared **out)
{
	struct shared *l;
	enum err err;

	if (s->part.count * 4 > from->list.count * 3 || s->bytes > LISTS_MAX) {
		from->users++;
		*out = from;
		return ERR_OK;
	}
	l = calloc(1, sizeof *l);
	if (l == NULL)
		return ERR_MEMORY;
	err = range_list_create(&s->part, &l->list);
	if (err) {
		free(l);
		return err;
	}
	l->list.count = s->part.count;
	memcpy(l->list.insns, s->part.insns,
	    s->part.count * sizeof *l->list.insns);
	memcpy(l->list.boxes, s->part.boxes,
	    s->part.count * sizeof *l->list.boxes);
	l->cost = cost;
	l->users = 1;
	l->bytes = (s->part.count + PRUNE_ROOM) *
	    (sizeof *l->list.insns + sizeof *l->list.boxes);
	s->bytes += l->bytes;
	*out = l;
	return ERR_OK;
}

/* ---- ranges ---- */

static bool is_spent(const struct search *s)
{
	return s->spent >= BUDGET || s->count + 2 > LEAVES_MAX;
}

static bool goes_on(struct search *s)
{
	if (s->sampler == NULL || s->spent - s->asked < ASK_EVERY)
		return true;
	s->asked = s->spent;
	return sampler_goes_on(s->sampler, "extent",
	    fmin(s->spent / BUDGET, 1.0));
}

/* Whether box, of a leaf of list, may hold some; s->part is what is left there,
 * and *cost its own. */
static bool may_hold(struct search *s, const struct prune_list *list,
    const struct tape_box *box, double *cost)
{
	struct range range;

	range_prune(s->tape, list, box, &s->part);
	*cost = cost_of(&s->part);
	/* measured: pruning takes an eighth of an instruction's range, or, by
	 * an index, less; and a box 25 of them itself */
	s->spent += 25.0 + *cost + 0.125 * (double)list->count;
	range = range_eval(s->tape, &s->part, box);
	return range.least <= s->iso && range.most >= s->iso;
}

/* ---- leaves ---- */

static double size_of(const struct tape_box *b)
{
	double size = 0.0;

	for (int i = 0; i < 3; i++)
		size = fmax(size, (double)b->max[i] - b->min[i]);
	return size;
}

static float reach_of(const struct tape_box *b, int face)
{
	return face % 2 ? b->max[face / 2] : -b->min[face / 2];
}

/* Whether a comes before b: it reaches further, or as far and is smaller. */
static bool before(const struct search *s, int face, int a, int b)
{
	const struct tape_box *p = &s->leaves[a].box, *q = &s->leaves[b].box;
	float x = reach_of(p, face), y = reach_of(q, face);

	return x > y || (x == y && size_of(p) < size_of(q));
}

static void push(struct search *s, int face, int leaf)
{
	struct heap *h = s->heaps + face;
	int i = h->count++;

	while (i > 0 && before(s, face, leaf, h->leaves[(i - 1) / 2])) {
		h->leaves[i] = h->leaves[(i - 1) / 2];
		i = (i - 1) / 2;
	}
	h->leaves[i] = leaf;
}

static void pop(struct search *s, int face)
{
	struct heap *h = s->heaps + face;
	int last = h->leaves[--h->count], i = 0, child;

	while ((child = 2 * i + 1) < h->count) {
		if (child + 1 < h->count && before(s, face,
		    h->leaves[child + 1], h->leaves[child]))
			child++;
		if (!before(s, face, h->leaves[child], last))
			break;
		h->leaves[i] = h->leaves[child];
		i = child;
	}
	h->leaves[i] = last;
}

/* list passes to the leaf. */
static void add_leaf(struct search *s, const struct tape_box *box,
    struct shared *list)
{
	s->leaves[s->count] = (struct leaf){*box, list};
	for (int face = 0; face < FACES; face++)
		push(s, face, s->count);
	s->count++;
}

/* The leaf that reaches furthest, or -1: there is none. */
static int furthest(struct search *s, int face)
{
	struct heap *h = s->heaps + face;

	while (h->count > 0 && s->leaves[h->leaves[0]].list == NULL)
		pop(s, face);
	return h->count > 0 ? h->leaves[0] : -1;
}

/* Halves a leaf along its longest edge: what of it may hold some stays. */
static enum err halve(struct search *s, int at)
{
	struct leaf *leaf = s->leaves + at;
	const struct tape_box box = leaf->box;
	struct shared *list = leaf->list, *own;
	enum err err = ERR_OK;
	float middle;
	double cost;
	int axis = 0;

	for (int i = 1; i < 3; i++)
		if (box.max[i] - box.min[i] > box.max[axis] - box.min[axis])
			axis = i;
	middle = 0.5f * box.min[axis] + 0.5f * box.max[axis];
	leaf->list = NULL;
	for (int side = 0; side < 2 && err == ERR_OK; side++) {
		struct tape_box half = box;

		*(side ? half.min + axis : half.max + axis) = middle;
		if (!may_hold(s, &list->list, &half, &cost))
			continue;
		err = share(s, list, cost, &own);
		if (err == ERR_OK)
			add_leaf(s, &half, own);
	}
	release(s, list);
	return err;
}

/* ---- the box ---- */

/* Cuts off one side of box beyond part of the way from its middle, if there is
 * nothing. */
static bool trim(struct search *s, const struct prune_list *list, int face,
    double part, struct tape_box *box)
{
	const int axis = face / 2;
	const double least = box->min[axis], most = box->max[axis];
	const float at = (float)(0.5 * (least + most) +
	    (face % 2 ? 0.5 : -0.5) * part * (most - least));
	struct tape_box slab = *box;
	double cost;

	if (!(at > box->min[axis] && at < box->max[axis]))
		return false;
	*(face % 2 ? slab.min + axis : slab.max + axis) = at;
	if (may_hold(s, list, &slab, &cost))
		return false;
	*(face % 2 ? box->max + axis : box->min + axis) = at;
	return true;
}

/* Cuts all sides while that goes well: a domain may be much larger than what is
 * in it. */
static enum err trim_all(struct search *s, const struct prune_list *list,
    struct tape_box *box)
{
	const size_t steps = sizeof trims / sizeof trims[0];

	for (size_t i = 0; i < steps;) {
		bool has_cut = false;

		for (int face = 0; face < FACES && !is_spent(s); face++) {
			has_cut |= trim(s, list, face, trims[i], box);
			if (!goes_on(s))
				return ERR_CANCELLED;
		}
		i += !has_cut;
	}
	return ERR_OK;
}

/* The box about all leaves; false: there are none. */
static bool bound(struct search *s, struct tape_box *out)
{
	for (int face = 0; face < FACES; face++) {
		int at = furthest(s, face);

		if (at < 0)
			return false;
		if (face % 2)
			out->max[face / 2] = s->leaves[at].box.max[face / 2];
		else
			out->min[face / 2] = s->leaves[at].box.min[face / 2];
	}
	return true;
}

/* Halves leaves at the faces, one of each in turn. */
static enum err refine(struct search *s, double slack)
{
	struct tape_box box;
	bool has_halved = true;

	while (has_halved) {
		has_halved = false;
		for (int face = 0; face < FACES; face++) {
			enum err err;
			int at;

			if (is_spent(s) || !bound(s, &box))
				return ERR_OK;
			at = furthest(s, face);
			if (size_of(&s->leaves[at].box) <=
			    slack * size_of(&box))
				continue;
			err = goes_on(s) ? halve(s, at) : ERR_CANCELLED;
			if (err)
				return err;
			has_halved = true;
		}
	}
	return ERR_OK;
}

static enum err find(struct search *s, const struct tape_box *domain,
    double slack, struct tape_box *out)
{
	static const struct tape_box nothing = {
		{INFINITY, INFINITY, INFINITY},
		{-INFINITY, -INFINITY, -INFINITY}};
	struct tape_box box = *domain;
	enum err err = trim_all(s, &s->whole.list, &box);

	if (err)
		return err;
	s->whole.users++;
	add_leaf(s, &box, &s->whole);
	err = refine(s, slack);
	if (err == ERR_OK && !bound(s, out))
		*out = nothing;
	return err;
}

static void search_fini(struct search *s)
{
	for (int i = 0; i < s->count; i++)
		if (s->leaves[i].list != NULL)
			release(s, s->leaves[i].list);
	for (int i = 0; i < FACES; i++)
		free(s->heaps[i].leaves);
	free(s->leaves);
	range_list_free(&s->part);
}

static enum err search_init(struct search *s)
{
	enum err err;

	/* one user is s: it is not released */
	s->whole = (struct shared){.list = range_whole(s->tape), .users = 1};
	err = range_list_create(&s->whole.list, &s->part);
	if (err)
		return err;
	s->leaves = malloc(LEAVES_MAX * sizeof *s->leaves);
	if (s->leaves == NULL)
		err = ERR_MEMORY;
	for (int i = 0; i < FACES; i++) {
		s->heaps[i].leaves = malloc(LEAVES_MAX * sizeof(int));
		if (s->heaps[i].leaves == NULL)
			err = ERR_MEMORY;
	}
	if (err)
		search_fini(s);
	return err;
}

enum err range_extent(const struct range_tape *r, double iso,
    const struct tape_box *domain, double slack, struct sampler *sampler,
    struct tape_box *out)
{
	struct search s = {.tape = r, .iso = iso, .sampler = sampler};
	enum err err = search_init(&s);

	if (err)
		return err;
	err = find(&s, domain, slack, out);
	search_fini(&s);
	return err;
}
