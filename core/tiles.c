/*
 * A batch goes through four steps: a sample of it tells whether to sort; an
 * order and boxes of its tiles, or these as the points come; boxes of boxes; and
 * pruning, from the coarsest boxes down to tiles. Each is cut into pieces that a
 * crew may take; working memory that a piece needs is one of as many hands' as
 * the crew has.
 */
#include "core/tiles.h"

#include <math.h>
#include <stdatomic.h>
#include <stdlib.h>
#include <string.h>

#include "core/prune.h"
#include "core/tape.h"
#include "core/tiles_order.h"

/* Boxes that one is about, and how many of the coarsest there may be: each of
 * these is pruned from the whole tape. */
#define FAN 8
#define TOP 32
#define LEVELS 10

/* The batch's own box is pruned to first if it is to leave less than this. */
#define NEAR_SHARE 0.6

/* Tiles whose boxes are one piece of work. */
#define PIECE_TILES 512

/* Lists that a hand has room for, of the whole tape's length. */
#define HAND_LISTS 3

/*
 * What things cost a point, in ns of a core's time (Xeon, AVX-512): primitives
 * and compositions wherever they are, compositions with tables more where both
 * operands are alive; sorting, and gathering what is sorted; pruning, for every
 * primitive that is left; a tile; and, once for each of the coarsest boxes, every
 * primitive of the tape.
 */
#define COST_PAIR 0.4
#define COST_POINT 0.7
#define COST_PRIMITIVE 2.0
#define COST_PLAIN 0.5
#define COST_BLEND 0.8
#define COST_BLEND_ALIVE 8.0
#define COST_SORT 35.0
#define COST_PRUNE 0.2
#define COST_TILE 3.0
#define COST_SCAN 1.0

/* What is left must cost less than this of the whole tape. */
#define WORTH 0.85

/* So many tiles, at most, tell what a batch's are like. */
#define SAMPLE 256

/* Tapes that cost less than this are not culled: some 16 points under a sum. */
#define LEAST_COST 6.5

/* A list of a hand's, or the whole tape, and where it went, if it did. */
struct part {
	struct prune_list list;
	struct tile tile;
	bool is_out;
};

struct tiles {
	struct prune_list whole;
	struct prune_index *index; /* of whole */
	bool *is_constant;
	size_t operator_count;
	size_t bounded, primitives; /* those with a finite box; all of them */
	struct tape_box about;      /* the bounded ones */
	float span[3];              /* their mean extent */
	double cost, alive_cost;    /* of a primitive with its composition; and
	                             * what it costs more where it is alive */
};

/* Arrays that have room for lists. */
struct room {
	struct insn *insns;
	struct tape_box *boxes;
	size_t max;
};

/* Working memory of one piece of work at a time. */
struct hand {
	struct room room;
	size_t used;
	atomic_flag is_taken;
};

struct tiles_work {
	struct hand **hands;
	size_t hand_count;
	struct tape_box *boxes;     /* of tiles, of FAN of these ... */
	size_t box_max;
	struct room near;           /* for what is left about a batch */
	struct tiles_order order;
};

/* One batch. */
struct build {
	const struct tiles *tiles;
	struct tiles_work *work;
	const float *points;
	size_t count;
	const struct tiles_crew *crew;
	struct tiles_out *out;
	struct tape_box *levels[LEVELS];
	size_t counts[LEVELS];
	size_t top;       /* the level that is pruned from root */
	struct part root; /* the whole tape, or what is left about the batch */
	double mean;      /* primitives that tiles meet in the order given */
	struct tape_box common; /* of points and primitives; may be empty */
	_Atomic size_t used;
};

static const struct tape_box nowhere = {
	{INFINITY, INFINITY, INFINITY}, {-INFINITY, -INFINITY, -INFINITY}};

/* Of tiles with a point out of POINT_REACH, which get the whole tape. */
static const struct tape_box everywhere = {
	{-INFINITY, -INFINITY, -INFINITY}, {INFINITY, INFINITY, INFINITY}};

static bool is_everywhere(const struct tape_box *b)
{
	return isinf(b->max[0]) && b->max[0] > 0.0f;
}

static bool is_finite(const struct tape_box *b)
{
	bool finite = true;

	for (int i = 0; i < 3; i++)
		finite = finite && isfinite(b->min[i]) && isfinite(b->max[i]) &&
		    b->min[i] <= b->max[i];
	return finite;
}

/* ---- what is known of a tape ---- */

/* A pair's is its point's and its sum's. */
static double insn_cost(const struct insn *insn)
{
	if (insn->op >= OP_RICCI)
		return COST_BLEND;
	if (insn->op == OP_POINT && insn->index > 0)
		return COST_PAIR - COST_PLAIN;
	if (insn->op < OP_PRIMITIVES || insn->op >= OP_MAX)
		return COST_PLAIN;
	return insn->op == OP_POINT ? COST_POINT : COST_PRIMITIVE;
}

static void survey(struct tiles *t, double speed)
{
	double cost = 0.0, alive_cost = 0.0;

	t->about = nowhere;
	for (size_t i = 0; i < t->whole.count; i++) {
		unsigned op = t->whole.insns[i].op;
		const struct tape_box *b = t->whole.boxes + i;

		cost += insn_cost(t->whole.insns + i);
		alive_cost += op >= OP_RICCI ? COST_BLEND_ALIVE : 0.0;
		if (op < OP_PRIMITIVES || op >= OP_MAX)
			continue;
		t->primitives++;
		if (!is_finite(b))
			continue;
		t->bounded++;
		tape_box_grow(&t->about, b);
		for (int a = 0; a < 3; a++)
			t->span[a] += b->max[a] - b->min[a];
	}
	for (int a = 0; a < 3 && t->bounded; a++)
		t->span[a] /= (float)t->bounded;
	t->cost = cost / (speed * (double)t->primitives);
	t->alive_cost = alive_cost / (speed * (double)t->primitives);
}

/* A copy of count things of size bytes; NULL: no memory. */
static void *copy(const void *from, size_t count, size_t size)
{
	void *to = malloc(count ? count * size : 1);

	if (to && count)
		memcpy(to, from, count * size);
	return to;
}

/* Room for count instructions in all. */
static enum err reserve_room(struct room *r, size_t count)
{
	struct insn *insns;
	struct tape_box *boxes;

	if (count <= r->max)
		return ERR_OK;
	insns = realloc(r->insns, count * sizeof(*insns));
	if (insns)
		r->insns = insns;
	boxes = realloc(r->boxes, count * sizeof(*boxes));
	if (boxes)
		r->boxes = boxes;
	if (!insns || !boxes)
		return ERR_MEMORY;
	r->max = count;
	return ERR_OK;
}

static void free_room(struct room *r)
{
	free(r->insns);
	free(r->boxes);
}

static enum err add_hand(struct tiles_work *w)
{
	struct hand **grown = realloc(w->hands,
	    (w->hand_count + 1) * sizeof(*grown));

	if (!grown)
		return ERR_MEMORY;
	w->hands = grown;
	grown[w->hand_count] = calloc(1, sizeof(**grown));
	if (!grown[w->hand_count])
		return ERR_MEMORY;
	atomic_flag_clear(&grown[w->hand_count++]->is_taken);
	return ERR_OK;
}

/* So many hands, and room, for t. */
static enum err reserve_work(struct tiles_work *w, const struct tiles *t,
    size_t count)
{
	size_t list = t->whole.count + PRUNE_ROOM;
	enum err ret = reserve_room(&w->near, list);

	while (ret == ERR_OK && w->hand_count < count)
		ret = add_hand(w);
	for (size_t i = 0; ret == ERR_OK && i < w->hand_count; i++)
		ret = reserve_room(&w->hands[i]->room, HAND_LISTS * list);
	return ret;
}

enum err tiles_work_create(struct tiles_work **out)
{
	struct tiles_work *w = calloc(1, sizeof(*w));

	if (!w)
		return ERR_MEMORY;
	*out = w;
	return ERR_OK;
}

void tiles_work_free(struct tiles_work *w)
{
	if (!w)
		return;
	for (size_t i = 0; i < w->hand_count; i++) {
		free_room(&w->hands[i]->room);
		free(w->hands[i]);
	}
	free(w->hands);
	free(w->boxes);
	free_room(&w->near);
	tiles_order_fini(&w->order);
	free(w);
}

enum err tiles_create(const struct tape *tape, double speed,
    struct tiles **out)
{
	struct tiles *t = calloc(1, sizeof(*t));
	size_t count = tape->insn_count;

	if (!t)
		return ERR_MEMORY;
	t->whole.count = count;
	t->whole.insns = copy(tape->insns, count, sizeof(*t->whole.insns));
	t->whole.boxes = copy(tape->boxes, count, sizeof(*t->whole.boxes));
	t->operator_count = tape->operator_count;
	t->is_constant = calloc(tape->operator_count + 1, sizeof(bool));
	if (!t->whole.insns || !t->whole.boxes || !t->is_constant ||
	    prune_index_create(&t->whole, &t->index) != ERR_OK) {
		tiles_free(t);
		return ERR_MEMORY;
	}
	t->whole.index = t->index;
	for (size_t i = 0; i < tape->operator_count; i++)
		t->is_constant[i] =
		    opening_is_constant(&tape->operators[i].opening);
	survey(t, speed);
	*out = t;
	return ERR_OK;
}

void tiles_free(struct tiles *t)
{
	if (!t)
		return;
	prune_index_free(t->index);
	free(t->whole.insns);
	free(t->whole.boxes);
	free(t->is_constant);
	free(t);
}

size_t tiles_bytes(const struct tiles *t)
{
	const size_t each = sizeof(struct insn) + sizeof(struct tape_box);

	return sizeof(*t) + prune_index_bytes(t->index) +
	    each * t->whole.count + t->operator_count;
}

bool tiles_pay(const struct tiles *t, size_t count)
{
	return count > 0 && 2 * t->bounded >= t->primitives &&
	    (t->cost + t->alive_cost) * (double)t->primitives >= LEAST_COST;
}

/* ---- pieces of work ---- */

static void run(const struct tiles_crew *crew,
    void (*task)(void *ctx, size_t i), struct build *b, size_t count)
{
	if (crew && count > 1) {
		crew->run(crew->self, task, b, count);
		return;
	}
	for (size_t i = 0; i < count; i++)
		task(b, i);
}

/* One that is free: there are as many as pieces at once. */
static struct hand *take_hand(struct tiles_work *w)
{
	for (size_t i = 0;; i = i + 1 < w->hand_count ? i + 1 : 0)
		if (!atomic_flag_test_and_set_explicit(&w->hands[i]->is_taken,
		    memory_order_acquire))
			return w->hands[i];
}

static void give_hand(struct hand *h)
{
	atomic_flag_clear_explicit(&h->is_taken, memory_order_release);
}

/* ---- boxes ---- */

/* Four numbers at once. */
typedef float lanes __attribute__((vector_size(16)));
typedef int32_t lane_masks __attribute__((vector_size(16)));

static inline lanes pick(lanes no, lanes yes, lane_masks m)
{
	return (lanes)(((lane_masks)yes & m) | ((lane_masks)no & ~m));
}

/* The box of a whole tile: four points are three times four numbers, the same
 * coordinate every third. */
static void box_whole(const float *points, struct tape_box *out)
{
	lanes least[3], most[3], p;

	memcpy(least, points, sizeof(least));
	memcpy(most, points, sizeof(most));
	for (size_t i = 12; i < 3 * TILE_POINTS; i += 12)
		for (size_t k = 0; k < 3; k++) {
			memcpy(&p, points + i + 4 * k, sizeof(p));
			least[k] = pick(least[k], p, p < least[k]);
			most[k] = pick(most[k], p, p > most[k]);
		}
	*out = nowhere;
	for (size_t i = 0; i < 12; i++) {
		float low = least[i / 4][i % 4], high = most[i / 4][i % 4];

		out->min[i % 3] = fminf(out->min[i % 3], low);
		out->max[i % 3] = fmaxf(out->max[i % 3], high);
	}
}

static void box_points(const float *points, size_t count,
    struct tape_box *out)
{
	if (count == TILE_POINTS) {
		box_whole(points, out);
		return;
	}
	*out = nowhere;
	for (size_t i = 0; i < count; i++) {
		const float *p = points + 3 * i;

		tape_box_grow(out, &(struct tape_box){{p[0], p[1], p[2]},
		    {p[0], p[1], p[2]}});
	}
}

/* Of tile i of the points as they come. */
static void box_tile(const struct build *b, size_t i, struct tape_box *out)
{
	size_t n = b->count - TILE_POINTS * i;

	box_points(b->points + 3 * TILE_POINTS * i,
	    n < TILE_POINTS ? n : TILE_POINTS, out);
}

/* Boxes of a piece's tiles. */
static void box_piece(void *ctx, size_t piece)
{
	struct build *b = ctx;
	size_t end = (piece + 1) * PIECE_TILES;

	end = end < b->counts[0] ? end : b->counts[0];
	for (size_t i = piece * PIECE_TILES; i < end; i++)
		box_tile(b, i, b->levels[0] + i);
}

static void box_tiles(struct build *b)
{
	run(b->crew, box_piece, b,
	    (b->counts[0] + PIECE_TILES - 1) / PIECE_TILES);
}

/* The order of points as they come; the last fills its tile. */
static void leave_order(const struct build *b)
{
	for (size_t i = 0; i < b->count; i++)
		b->out->order[i] = (uint32_t)i;
}

static void pad_order(const struct build *b)
{
	size_t end = b->counts[0] * TILE_POINTS;
	uint32_t last = b->out->order[b->count - 1];

	for (size_t i = b->count; i < end; i++)
		b->out->order[i] = last;
}

static void mark_far_tiles(const struct build *b)
{
	const float reach = POINT_REACH;

	for (size_t i = 0; i < b->counts[0]; i++) {
		struct tape_box *box = b->levels[0] + i;
		bool is_near = true;

		for (int a = 0; a < 3; a++)
			is_near &= box->min[a] >= -reach &&
			    box->max[a] <= reach;
		if (!is_near)
			*box = everywhere;
	}
}

/* Levels of boxes, until there are few of the coarsest. */
static enum err reserve_boxes(struct build *b)
{
	struct tiles_work *w = b->work;
	size_t total = 0, first = 0;

	b->counts[0] = tiles_count(b->count);
	for (b->top = 0;; b->top++) {
		total += b->counts[b->top];
		if (b->counts[b->top] <= TOP || b->top + 1 == LEVELS)
			break;
		b->counts[b->top + 1] = (b->counts[b->top] + FAN - 1) / FAN;
	}
	if (total > w->box_max) {
		free(w->boxes);
		w->box_max = 0;
		w->boxes = malloc(total * sizeof(*w->boxes));
		if (!w->boxes)
			return ERR_MEMORY;
		w->box_max = total;
	}
	for (size_t k = 0; k <= b->top; k++) {
		b->levels[k] = w->boxes + first;
		first += b->counts[k];
	}
	return ERR_OK;
}

static void box_levels(struct build *b)
{
	for (size_t k = 1; k <= b->top; k++)
		for (size_t i = 0; i < b->counts[k]; i++) {
			size_t end = FAN * (i + 1);

			b->levels[k][i] = nowhere;
			end = end < b->counts[k - 1] ? end : b->counts[k - 1];
			for (size_t j = FAN * i; j < end; j++)
				if (!is_everywhere(b->levels[k - 1] + j))
					tape_box_grow(b->levels[k] + i,
					    b->levels[k - 1] + j);
		}
}

/* ---- whether to sort ---- */

/* How many bounded primitives a box of these extents meets, if they are spread
 * evenly. */
static double meetings(const struct tiles *t, const float extent[static 3])
{
	double n = (double)t->bounded;

	for (int a = 0; a < 3; a++) {
		double length = t->about.max[a] - t->about.min[a];
		double part = (extent[a] + t->span[a]) / length;

		n *= part < 1.0 ? part : 1.0;
	}
	return n;
}

/* Of tiles as they are, on average; and the box that points and primitives
 * have in common, if there is one. */
static void survey_tiles(struct build *b)
{
	const struct tape_box *about = &b->tiles->about;
	size_t tiles = tiles_count(b->count);
	size_t n = tiles < 4 ? tiles : 4 + (tiles - 4) / 16;
	struct tape_box all = nowhere, box;
	double sum = 0.0;

	n = n < SAMPLE ? n : SAMPLE;
	for (size_t i = 0; i < n; i++) {
		float extent[3];

		box_tile(b, i * tiles / n, &box);
		tape_box_grow(&all, &box);
		for (int a = 0; a < 3; a++)
			extent[a] = box.max[a] - box.min[a];
		sum += meetings(b->tiles, extent);
	}
	b->mean = sum / (double)n;
	for (int a = 0; a < 3; a++) {
		b->common.min[a] = all.min[a] > about->min[a] ? all.min[a]
		    : about->min[a];
		b->common.max[a] = all.max[a] < about->max[a] ? all.max[a]
		    : about->max[a];
	}
}

/* Of tiles of points spread evenly over within and sorted: they are made by
 * halving its longest side, and half as long again. */
static double sorted_meetings(const struct build *b,
    const struct tape_box *within)
{
	float extent[3];

	for (int a = 0; a < 3; a++)
		extent[a] = 1.5f * (within->max[a] - within->min[a]);
	for (size_t n = tiles_count(b->count); n > 1; n /= 2) {
		int a = extent[0] >= extent[1] ? 0 : 1;

		if (extent[2] > extent[a])
			a = 2;
		extent[a] *= 0.5f;
	}
	return meetings(b->tiles, extent);
}

/* What a batch may walk. */
enum way {
	WAY_WHOLE, /* the whole tape, in the order given */
	WAY_GIVEN, /* what is left of it about tiles in that order */
	WAY_SORTED,
	WAYS
};

/* What each way costs a point. In the order given, tiles meet mean primitives. */
static void weigh(struct build *b, double costs[static WAYS])
{
	const struct tiles *t = b->tiles;
	double all = (double)t->primitives, free = all - (double)t->bounded;
	double each = t->cost + t->alive_cost + COST_PRUNE;
	size_t tiles = tiles_count(b->count);
	double once = COST_TILE + (double)(tiles < TOP ? tiles : TOP) * all *
	    COST_SCAN / (double)b->count;

	survey_tiles(b);
	costs[WAY_WHOLE] = all * t->cost + (b->mean + free) * t->alive_cost;
	costs[WAY_GIVEN] = once + (b->mean + free) * each;
	costs[WAY_SORTED] = INFINITY;
	if (is_finite(&b->common))
		costs[WAY_SORTED] = COST_SORT + once + each *
		    (sorted_meetings(b, &b->common) + free);
}

bool tiles_help(const struct tiles *t, const float *points, size_t count)
{
	struct build b = {.tiles = t, .points = points,
	    .count = count};
	double costs[WAYS];

	if (!tiles_pay(t, count))
		return false;
	weigh(&b, costs);
	return fmin(costs[WAY_GIVEN], costs[WAY_SORTED]) <
	    WORTH * costs[WAY_WHOLE];
}

/* ---- the order ---- */

/* Order and boxes of tiles. */
static enum err arrange(struct build *b)
{
	double costs[WAYS];

	weigh(b, costs);
	if (costs[WAY_SORTED] < costs[WAY_GIVEN])
		return tiles_order_sort(&b->work->order, b->points, b->count,
		    &b->common, b->crew, b->out->order, b->levels[0]);
	leave_order(b);
	box_tiles(b);
	return ERR_OK;
}

/* ---- pruning ---- */

/* Room for count instructions of the result; false: there is none. */
static bool claim(struct build *b, size_t count, size_t *first)
{
	size_t used = atomic_load_explicit(&b->used, memory_order_relaxed);

	do {
		if (count > b->out->insns_max - used)
			return false;
	} while (!atomic_compare_exchange_weak_explicit(&b->used, &used,
	    used + count, memory_order_relaxed, memory_order_relaxed));
	*first = used;
	return true;
}

/* Where part's list is in the result: it is written there when it is first
 * asked for. */
static struct tile put(struct build *b, struct part *part)
{
	const struct tiles *t = b->tiles;
	struct prune_list *list = &part->list;
	size_t first;

	if (part->is_out)
		return part->tile;
	part->is_out = true;
	part->tile = (struct tile){0, 0};
	if (!claim(b, list->count, &first))
		return part->tile;
	prune_orders(list, t->is_constant);
	tape_count_runs(list->insns, list->count);
	memcpy(b->out->insns + first, list->insns,
	    list->count * sizeof(*list->insns));
	part->tile = (struct tile){(uint32_t)first, (uint32_t)list->count};
	return part->tile;
}

/* Box i of a level, and all below it, from what is left of the tape about it. */
static void descend(struct build *b, struct hand *h, size_t level, size_t i,
    struct part *from)
{
	struct part own = {.list = {.insns = h->room.insns + h->used,
	    .boxes = h->room.boxes + h->used}};
	size_t before = h->used, end = FAN * (i + 1);

	if (level == 0 && is_everywhere(b->levels[0] + i)) {
		b->out->tiles[i] = (struct tile){0, 0};
		return;
	}
	if (h->used + from->list.count + PRUNE_ROOM <= h->room.max) {
		prune_operands(&from->list, b->levels[level] + i, &own.list);
		h->used += own.list.count;
		if (own.list.count < from->list.count)
			from = &own;
	}
	if (level == 0) {
		b->out->tiles[i] = put(b, from);
	} else {
		if (end > b->counts[level - 1])
			end = b->counts[level - 1];
		for (size_t j = FAN * i; j < end; j++)
			descend(b, h, level - 1, j, from);
	}
	h->used = before;
}

static void descend_top(void *ctx, size_t i)
{
	struct build *b = ctx;
	struct hand *h = take_hand(b->work);
	struct part root = b->root;

	h->used = 0;
	descend(b, h, b->top, i, &root);
	give_hand(h);
}

/*
 * What the coarsest boxes are pruned from: if several of them are about but a
 * part of the primitives, what is left about that. It is put out at once, so that
 * all may share it.
 */
static void prune_root(struct build *b)
{
	const struct tiles *t = b->tiles;
	struct prune_list near = {.insns = b->work->near.insns,
		.boxes = b->work->near.boxes};
	struct tape_box all = nowhere;
	float extent[3];

	b->root = (struct part){.list = t->whole, .is_out = true};
	for (size_t i = 0; i < b->counts[b->top]; i++)
		if (!is_everywhere(b->levels[b->top] + i))
			tape_box_grow(&all, b->levels[b->top] + i);
	for (int a = 0; a < 3; a++)
		extent[a] = all.max[a] - all.min[a];
	if (b->counts[b->top] < 2 || !is_finite(&all) ||
	    meetings(t, extent) > NEAR_SHARE * (double)t->bounded)
		return;
	prune_operands(&t->whole, &all, &near);
	if (near.count >= t->whole.count)
		return;
	b->root = (struct part){.list = near};
	put(b, &b->root);
}

enum err tiles_build(const struct tiles *t, struct tiles_work *work,
    const float *points, size_t count, bool is_culled,
    const struct tiles_crew *crew, struct tiles_out *out)
{
	struct build b = {.tiles = t, .work = work, .points = points,
	    .count = count, .crew = crew, .out = out};
	enum err ret = reserve_work(work, t, crew ? crew->hands : 1);

	if (ret == ERR_OK)
		ret = reserve_boxes(&b);
	if (ret != ERR_OK)
		return ret;
	out->tile_count = b.counts[0];
	out->insn_count = 0;
	if (!is_culled) {
		leave_order(&b);
		pad_order(&b);
		memset(out->tiles, 0, b.counts[0] * sizeof(*out->tiles));
		return ERR_OK;
	}
	ret = arrange(&b);
	if (ret != ERR_OK)
		return ret;
	pad_order(&b);
	mark_far_tiles(&b);
	box_levels(&b);
	prune_root(&b);
	run(crew, descend_top, &b, b.counts[b.top]);
	out->insn_count = b.used;
	return ERR_OK;
}
