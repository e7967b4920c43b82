/*
 * Two counting sorts: first by the high bits of keys into buckets that fit a
 * core's cache, each point with its coordinates, so that everything after is
 * near; then every bucket by the low bits.
 */
#include "core/tiles_order.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "core/tiles.h"

/* Points a cell has on average at most, and the least points of a run, which is
 * one piece of work. */
#define CELL_POINTS 8
#define RUN_POINTS 16384
#define RUNS_MAX 16

/* Cells of a bucket, and buckets, at most: with 1e6 points 32 buckets of 512 KiB
 * are written to in 0.6 of the time that 256 take, for the pages in use. */
#define LOW_BITS 12
#define HIGH_BITS (TILES_ORDER_BITS - LOW_BITS)

static const struct tape_box nowhere = {
	{INFINITY, INFINITY, INFINITY}, {-INFINITY, -INFINITY, -INFINITY}};

/* The box of what a bucket has of its first tile and of its last, where these
 * are not its own. */
struct ends {
	struct tape_box first, last;
};

/* One batch. */
struct sort {
	struct tiles_order *o;
	const float *points;
	size_t count, runs, buckets, pieces;
	unsigned bits[3], low_bits;
	float least[3], scale[3];
	uint32_t counts[RUNS_MAX][1 << HIGH_BITS]; /* places, later */
	size_t begins[(1 << HIGH_BITS) + 1];       /* of buckets */
	struct ends ends[1 << HIGH_BITS];
	uint32_t *order;
	struct tape_box *boxes;
};

void tiles_order_fini(struct tiles_order *o)
{
	free(o->points);
	free(o->keys);
	free(o->bucket_keys);
}

size_t tiles_order_bytes(const struct tiles_order *o)
{
	return o->point_max * (sizeof(*o->points) + sizeof(*o->keys) +
	    sizeof(*o->bucket_keys));
}

static enum err reserve(struct tiles_order *o, size_t count)
{
	if (count <= o->point_max)
		return ERR_OK;
	tiles_order_fini(o);
	o->point_max = 0;
	o->points = malloc(count * sizeof(*o->points));
	o->keys = malloc(count * sizeof(*o->keys));
	o->bucket_keys = malloc(count * sizeof(*o->bucket_keys));
	if (!o->points || !o->keys || !o->bucket_keys)
		return ERR_MEMORY;
	o->point_max = count;
	return ERR_OK;
}

/* Halves the cells along axis a: their next bit, by which the key's is set. */
static void halve(struct sort *s, int a, uint32_t bit)
{
	uint32_t *cells = s->o->cells[a];

	for (size_t i = (size_t)1 << s->bits[a]; i-- > 0;) {
		cells[2 * i + 1] = cells[i] | bit;
		cells[2 * i] = cells[i];
	}
	s->bits[a]++;
}

/*
 * Halves the axis along which cells are longest, as long as there are bits: the
 * first halving has the highest. cells[axis][i] has the bits of the i-th slab of
 * the axis.
 */
static void lay_out(struct sort *s, const struct tape_box *within,
    unsigned bits)
{
	float length[3];

	for (int a = 0; a < 3; a++) {
		length[a] = within->max[a] - within->min[a];
		s->least[a] = within->min[a];
		s->o->cells[a][0] = 0;
	}
	while (bits > 0) {
		int a = length[0] >= length[1] ? 0 : 1;

		a = length[2] > length[a] ? 2 : a;
		if (!(length[a] > 0.0f) ||
		    s->bits[a] == TILES_ORDER_AXIS_BITS)
			break;
		halve(s, a, 1u << --bits);
		length[a] *= 0.5f;
	}
	/* length is a slab's now */
	for (int a = 0; a < 3; a++)
		s->scale[a] = length[a] > 0.0f ? 1.0f / length[a] : 0.0f;
}

static size_t run_begin(const struct sort *s, size_t run)
{
	return s->count / s->runs * run +
	    (run < s->count % s->runs ? run : s->count % s->runs);
}

/* The slab of x along axis a, of which most is the last. */
static inline uint32_t slab(const struct sort *s, int a, float x, float most)
{
	float at = (x - s->least[a]) * s->scale[a];

	at = at > 0.0f ? at : 0.0f; /* also if it is not a number */
	return s->o->cells[a][(int)(at < most ? at : most)];
}

/* Keys of a run's points, and how many there are of each bucket. */
static void count_run(void *ctx, size_t run)
{
	struct sort *s = ctx;
	uint32_t *keys = s->o->keys, counts[1 << HIGH_BITS] = {0};
	size_t end = run_begin(s, run + 1);
	unsigned low_bits = s->low_bits;
	float most[3];

	for (int a = 0; a < 3; a++)
		most[a] = (float)((1u << s->bits[a]) - 1);
	for (size_t i = run_begin(s, run); i < end; i++) {
		const float *p = s->points + 3 * i;
		uint32_t key = slab(s, 0, p[0], most[0]) |
		    slab(s, 1, p[1], most[1]) | slab(s, 2, p[2], most[2]);

		keys[i] = key;
		counts[key >> low_bits]++;
	}
	memcpy(s->counts[run], counts, s->buckets * sizeof(*counts));
}

/* Counts become places: those of a bucket in the order of the runs. */
static void sum_counts(struct sort *s)
{
	uint32_t place = 0;

	for (size_t i = 0; i < s->buckets; i++) {
		s->begins[i] = place;
		for (size_t run = 0; run < s->runs; run++) {
			uint32_t n = s->counts[run][i];

			s->counts[run][i] = place;
			place += n;
		}
	}
	s->begins[s->buckets] = place;
}

static void place_run(void *ctx, size_t run)
{
	struct sort *s = ctx;
	struct tiles_order *o = s->o;
	uint32_t *places = s->counts[run];
	size_t end = run_begin(s, run + 1);

	for (size_t i = run_begin(s, run); i < end; i++) {
		const float *p = s->points + 3 * i;
		uint32_t place = places[o->keys[i] >> s->low_bits]++;

		o->points[place] = (struct tiles_order_point){
		    {p[0], p[1], p[2]}, (uint32_t)i};
		o->bucket_keys[place] = o->keys[i];
	}
}

/* Sorts a bucket by the low bits of its keys: places of its points, from its
 * first, to sorted. */
static void sort_bucket(const struct sort *s, size_t begin, size_t count,
    uint32_t *sorted)
{
	const uint32_t *keys = s->o->bucket_keys + begin;
	const uint32_t low = (1u << s->low_bits) - 1;
	uint32_t places[1 << LOW_BITS], place = 0;

	memset(places, 0, (low + 1) * sizeof(*places));
	for (size_t i = 0; i < count; i++)
		places[keys[i] & low]++;
	for (size_t cell = 0; cell <= low; cell++) {
		uint32_t n = places[cell];

		places[cell] = place;
		place += n;
	}
	for (size_t i = 0; i < count; i++)
		sorted[places[keys[i] & low]++] = (uint32_t)i;
}

/* Writes the indices of count points, by their places, and their box. */
static void write_tile(const struct tiles_order_point *points,
    const uint32_t *sorted, size_t count, uint32_t *order,
    struct tape_box *out)
{
	struct tape_box b = nowhere;

	for (size_t i = 0; i < count; i++) {
		const struct tiles_order_point *p = points + sorted[i];
		const float x = p->x[0], y = p->x[1], z = p->x[2];

		order[i] = p->index;
		b.min[0] = x < b.min[0] ? x : b.min[0];
		b.min[1] = y < b.min[1] ? y : b.min[1];
		b.min[2] = z < b.min[2] ? z : b.min[2];
		b.max[0] = x > b.max[0] ? x : b.max[0];
		b.max[1] = y > b.max[1] ? y : b.max[1];
		b.max[2] = z > b.max[2] ? z : b.max[2];
	}
	*out = b;
}

/* Points begin to end of the order, of bucket i: tile by tile. */
static void write_bucket(struct sort *s, size_t i, const uint32_t *sorted)
{
	size_t begin = s->begins[i], end = s->begins[i + 1];

	for (size_t at = begin; at < end;) {
		size_t next = (at / TILE_POINTS + 1) * TILE_POINTS;
		struct tape_box *box = s->boxes + at / TILE_POINTS;

		if (next > end)
			box = &s->ends[i].last;
		else if (at % TILE_POINTS)
			box = &s->ends[i].first;
		next = next < end ? next : end;
		write_tile(s->o->points + begin, sorted + (at - begin),
		    next - at, s->order + at, box);
		at = next;
	}
}

/* The keys as they came are of no use any more: their memory is for places. */
static void finish_piece(void *ctx, size_t piece)
{
	struct sort *s = ctx;
	size_t end = s->buckets * (piece + 1) / s->pieces;

	for (size_t i = s->buckets * piece / s->pieces; i < end; i++) {
		size_t begin = s->begins[i];
		uint32_t *sorted = s->o->keys + begin;

		s->ends[i] = (struct ends){nowhere, nowhere};
		if (begin == s->begins[i + 1])
			continue;
		sort_bucket(s, begin, s->begins[i + 1] - begin, sorted);
		write_bucket(s, i, sorted);
	}
}

/* Boxes of the tiles that lie in more than one bucket, or end the order. */
static void join_ends(struct sort *s)
{
	for (size_t i = 0; i < s->buckets; i++) {
		size_t begin = s->begins[i], end = s->begins[i + 1];

		if (begin == end)
			continue;
		if (end % TILE_POINTS) {
			struct tape_box *box = s->boxes + end / TILE_POINTS;

			if (begin / TILE_POINTS < end / TILE_POINTS ||
			    begin % TILE_POINTS == 0)
				*box = nowhere;
			tape_box_grow(box, &s->ends[i].last);
		}
		if (begin % TILE_POINTS)
			tape_box_grow(s->boxes + begin / TILE_POINTS,
			    &s->ends[i].first);
	}
}

static void run_all(const struct tiles_crew *crew,
    void (*task)(void *ctx, size_t i), struct sort *s, size_t count)
{
	if (crew && count > 1) {
		crew->run(crew->self, task, s, count);
		return;
	}
	for (size_t i = 0; i < count; i++)
		task(s, i);
}

static size_t at_most(size_t a, size_t b)
{
	return a < b ? a : b;
}

enum err tiles_order_sort(struct tiles_order *o, const float *points,
    size_t count, const struct tape_box *within,
    const struct tiles_crew *crew, uint32_t *order, struct tape_box *boxes)
{
	struct sort s;
	unsigned bits = 0;
	enum err ret = reserve(o, count);

	if (ret != ERR_OK)
		return ret;
	while (bits < TILES_ORDER_BITS && count >> bits > CELL_POINTS)
		bits++;
	s.o = o;
	s.points = points;
	s.count = count;
	s.runs = at_most(count / RUN_POINTS + 1, RUNS_MAX);
	s.low_bits = bits < LOW_BITS ? bits : LOW_BITS;
	s.buckets = (size_t)1 << (bits - s.low_bits);
	s.pieces = at_most(s.buckets, s.runs);
	s.order = order;
	s.boxes = boxes;
	memset(s.bits, 0, sizeof(s.bits));
	lay_out(&s, within, bits);
	run_all(crew, count_run, &s, s.runs);
	sum_counts(&s);
	run_all(crew, place_run, &s, s.runs);
	run_all(crew, finish_piece, &s, s.pieces);
	join_ends(&s);
	return ERR_OK;
}
