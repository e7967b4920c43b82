/*
 * A batch goes through four steps: boxes of its tiles as the points come; if
 * sorting would make them smaller, an order and new boxes; boxes of boxes; and
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
 * What a composition or a primitive costs a tile, in units of a point's with
 * its sum (0.4 ns a point), and what sorting and gathering cost: 20 ns a point.
 */
#define COST_PLAIN 0.5
#define COST_BLEND 8.0
#define COST_SORT 40.0

/* Tapes shorter than this are not culled: some 16 primitives. */
#define LEAST_INSNS 32

/* A list of a hand's, or the whole tape, and where it went, if it did. */
struct part {
	struct prune_list list;
	struct tile tile;
	bool is_out;
};

/* Working memory of one piece of work at a time. */
struct hand {
	struct insn *insns;
	struct tape_box *boxes;
	size_t max, used;
	atomic_flag is_taken;
};

struct tiles {
	struct prune_list whole;
	bool *is_constant;
	double *params;
	size_t operator_count, param_count;
	size_t bounded, primitives; /* those with a finite box; all of them */
	struct tape_box about;      /* the bounded ones */
	float span[3];              /* their mean extent */
	double cost;                /* of a primitive with its composition */
	struct hand **hands;
	size_t hand_count;
	struct tape_box *boxes;     /* of tiles, of FAN of these ... */
	size_t box_max;
	struct prune_list near;     /* room for what is left about a batch */
	struct tiles_order order;
};

/* One batch. */
struct build {
	struct tiles *tiles;
	const float *points;
	size_t count;
	const struct tiles_crew *crew;
	struct tiles_out *out;
	struct tape_box *levels[LEVELS];
	size_t counts[LEVELS];
	size_t top;       /* the level that is pruned from root */
	struct part root; /* the whole tape, or what is left about the batch */
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

static void survey(struct tiles *t)
{
	double cost = 0.0;

	t->about = nowhere;
	for (size_t i = 0; i < t->whole.count; i++) {
		unsigned op = t->whole.insns[i].op;
		const struct tape_box *b = t->whole.boxes + i;

		if (op >= OP_PRIMITIVES)
			cost += op >= OP_RICCI ? COST_BLEND : COST_PLAIN;
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
	t->cost = cost / (double)t->primitives;
}

/* A copy of count things of size bytes; NULL: no memory. */
static void *copy(const void *from, size_t count, size_t size)
{
	void *to = malloc(count ? count * size : 1);

	if (to && count)
		memcpy(to, from, count * size);
	return to;
}

static struct hand *hand_create(const struct tiles *t)
{
	struct hand *h = calloc(1, sizeof(*h));

	if (!h)
		return NULL;
	atomic_flag_clear(&h->is_taken);
	h->max = HAND_LISTS * (t->whole.count + PRUNE_ROOM);
	h->insns = malloc(h->max * sizeof(*h->insns));
	h->boxes = malloc(h->max * sizeof(*h->boxes));
	if (h->insns && h->boxes)
		return h;
	free(h->insns);
	free(h->boxes);
	free(h);
	return NULL;
}

static enum err reserve_hands(struct tiles *t, size_t count)
{
	struct hand **grown;

	if (count <= t->hand_count)
		return ERR_OK;
	grown = realloc(t->hands, count * sizeof(*grown));
	if (!grown)
		return ERR_MEMORY;
	t->hands = grown;
	for (; t->hand_count < count; t->hand_count++) {
		t->hands[t->hand_count] = hand_create(t);
		if (!t->hands[t->hand_count])
			return ERR_MEMORY;
	}
	return ERR_OK;
}

enum err tiles_create(const struct tape *tape, struct tiles **out)
{
	struct tiles *t = calloc(1, sizeof(*t));
	size_t count = tape->insn_count;

	if (!t)
		return ERR_MEMORY;
	t->whole.count = count;
	t->whole.insns = copy(tape->insns, count, sizeof(*t->whole.insns));
	t->whole.boxes = copy(tape->boxes, count, sizeof(*t->whole.boxes));
	t->params = copy(tape->params, tape->param_count, sizeof(*t->params));
	t->param_count = tape->param_count;
	t->operator_count = tape->operator_count;
	t->is_constant = calloc(tape->operator_count + 1, sizeof(bool));
	t->near.insns = malloc((count + PRUNE_ROOM) * sizeof(struct insn));
	t->near.boxes = malloc((count + PRUNE_ROOM) * sizeof(struct tape_box));
	if (!t->whole.insns || !t->whole.boxes || !t->params ||
	    !t->is_constant || !t->near.insns || !t->near.boxes ||
	    reserve_hands(t, 1) != ERR_OK) {
		tiles_free(t);
		return ERR_MEMORY;
	}
	for (size_t i = 0; i < tape->operator_count; i++)
		t->is_constant[i] =
		    opening_is_constant(&tape->operators[i].opening);
	survey(t);
	*out = t;
	return ERR_OK;
}

void tiles_free(struct tiles *t)
{
	if (!t)
		return;
	for (size_t i = 0; i < t->hand_count; i++) {
		free(t->hands[i]->insns);
		free(t->hands[i]->boxes);
		free(t->hands[i]);
	}
	free(t->hands);
	tiles_order_fini(&t->order);
	free(t->whole.insns);
	free(t->whole.boxes);
	free(t->near.insns);
	free(t->near.boxes);
	free(t->params);
	free(t->is_constant);
	free(t->boxes);
	free(t);
}

size_t tiles_bytes(const struct tiles *t)
{
	const size_t each = sizeof(struct insn) + sizeof(struct tape_box);
	size_t bytes = sizeof(*t) + 2 * each * t->whole.count +
	    t->param_count * sizeof(double) + t->operator_count +
	    t->box_max * sizeof(struct tape_box) + tiles_order_bytes(&t->order);

	for (size_t i = 0; i < t->hand_count; i++)
		bytes += each * t->hands[i]->max;
	return bytes;
}

bool tiles_pay(const struct tiles *t, size_t count)
{
	return count > 0 && t->whole.count >= LEAST_INSNS &&
	    2 * t->bounded >= t->primitives;
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
static struct hand *take_hand(struct tiles *t)
{
	for (size_t i = 0;; i = i + 1 < t->hand_count ? i + 1 : 0)
		if (!atomic_flag_test_and_set_explicit(&t->hands[i]->is_taken,
		    memory_order_acquire))
			return t->hands[i];
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

/* Boxes of a piece's tiles, of points as they come. */
static void box_piece(void *ctx, size_t piece)
{
	struct build *b = ctx;
	size_t end = (piece + 1) * PIECE_TILES;

	end = end < b->counts[0] ? end : b->counts[0];
	for (size_t i = piece * PIECE_TILES; i < end; i++) {
		size_t n = b->count - TILE_POINTS * i;

		box_points(b->points + 3 * TILE_POINTS * i,
		    n < TILE_POINTS ? n : TILE_POINTS, b->levels[0] + i);
	}
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
	struct tiles *t = b->tiles;
	size_t total = 0, first = 0;

	b->counts[0] = tiles_count(b->count);
	for (b->top = 0;; b->top++) {
		total += b->counts[b->top];
		if (b->counts[b->top] <= TOP || b->top + 1 == LEVELS)
			break;
		b->counts[b->top + 1] = (b->counts[b->top] + FAN - 1) / FAN;
	}
	if (total > t->box_max) {
		free(t->boxes);
		t->box_max = 0;
		t->boxes = malloc(total * sizeof(*t->boxes));
		if (!t->boxes)
			return ERR_MEMORY;
		t->box_max = total;
	}
	for (size_t k = 0; k <= b->top; k++) {
		b->levels[k] = t->boxes + first;
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
 * have in common: false if there is none. */
static bool survey_tiles(const struct build *b, struct tape_box *common,
    double *mean)
{
	const struct tape_box *about = &b->tiles->about;
	struct tape_box all = nowhere;
	double sum = 0.0;

	for (size_t i = 0; i < b->counts[0]; i++) {
		const struct tape_box *box = b->levels[0] + i;
		float extent[3];

		tape_box_grow(&all, box);
		for (int a = 0; a < 3; a++)
			extent[a] = box->max[a] - box->min[a];
		sum += meetings(b->tiles, extent);
	}
	*mean = sum / (double)b->counts[0];
	for (int a = 0; a < 3; a++) {
		common->min[a] = all.min[a] > about->min[a] ? all.min[a]
		    : about->min[a];
		common->max[a] = all.max[a] < about->max[a] ? all.max[a]
		    : about->max[a];
	}
	return is_finite(common);
}

/* Of tiles of points spread evenly over within and sorted: they are made by
 * halving its longest side, and half as long again. */
static double sorted_meetings(const struct build *b,
    const struct tape_box *within)
{
	float extent[3];

	for (int a = 0; a < 3; a++)
		extent[a] = 1.5f * (within->max[a] - within->min[a]);
	for (size_t n = b->counts[0]; n > 1; n /= 2) {
		int a = extent[0] >= extent[1] ? 0 : 1;

		if (extent[2] > extent[a])
			a = 2;
		extent[a] *= 0.5f;
	}
	return meetings(b->tiles, extent);
}

/* The order, by which boxes are those of tiles. */
static enum err sort(struct build *b)
{
	struct tape_box common;
	double mean;

	if (survey_tiles(b, &common, &mean) &&
	    (mean - sorted_meetings(b, &common)) * b->tiles->cost >= COST_SORT)
		return tiles_order_sort(&b->tiles->order, b->points, b->count,
		    &common, b->crew, b->out->order, b->levels[0]);
	leave_order(b);
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
	tape_mark_runs(list->insns, list->count, t->params);
	memcpy(b->out->insns + first, list->insns,
	    list->count * sizeof(*list->insns));
	part->tile = (struct tile){(uint32_t)first, (uint32_t)list->count};
	return part->tile;
}

/* Box i of a level, and all below it, from what is left of the tape about it. */
static void descend(struct build *b, struct hand *h, size_t level, size_t i,
    struct part *from)
{
	struct part own = {.list = {h->insns + h->used, h->boxes + h->used, 0}};
	size_t before = h->used, end = FAN * (i + 1);

	if (level == 0 && is_everywhere(b->levels[0] + i)) {
		b->out->tiles[i] = (struct tile){0, 0};
		return;
	}
	if (h->used + from->list.count + PRUNE_ROOM <= h->max) {
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
	struct hand *h = take_hand(b->tiles);
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
	struct tiles *t = b->tiles;
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
	prune_operands(&t->whole, &all, &t->near);
	if (t->near.count >= t->whole.count)
		return;
	b->root = (struct part){.list = t->near};
	put(b, &b->root);
}

enum err tiles_build(struct tiles *t, const float *points, size_t count,
    bool is_culled, const struct tiles_crew *crew, struct tiles_out *out)
{
	struct build b = {.tiles = t, .points = points, .count = count,
	    .crew = crew, .out = out};
	enum err ret = reserve_hands(t, crew ? crew->hands : 1);

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
	box_tiles(&b);
	ret = sort(&b);
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
