/*
 * The order of a batch's points along a Morton curve, and the boxes of the tiles
 * that it makes.
 */
#ifndef CORE_TILES_ORDER_H
#define CORE_TILES_ORDER_H

#include <stddef.h>
#include <stdint.h>

#include "core/err.h"
#include "core/tape.h"

struct tiles_crew;

/* The most cells of the curve, 2^this, and the most along one axis. */
#define TILES_ORDER_BITS 18
#define TILES_ORDER_AXIS_BITS 12

/* A point on its way: its coordinates, its index, its cell. */
struct tiles_order_point {
	float x[3];
	uint32_t index;
};

/* Working memory, kept between batches. All zero is ready for use. */
struct tiles_order {
	struct tiles_order_point *points; /* bucket by bucket */
	uint32_t *keys;                   /* cells, of points as they come */
	uint32_t *bucket_keys;            /* and bucket by bucket */
	size_t point_max;
	uint32_t cells[3][1 << TILES_ORDER_AXIS_BITS]; /* an axis's part of keys */
};

void tiles_order_fini(struct tiles_order *o);

size_t tiles_order_bytes(const struct tiles_order *o);

/*
 * Sorts count points by where they are in within, a finite box, those of one cell
 * as they come; what is outside counts as on its faces. Writes their indices to
 * order, count of them, and the box of every TILE_POINTS of them to boxes.
 * The order does not depend on crew, which may be NULL. ERR_MEMORY.
 */
enum err tiles_order_sort(struct tiles_order *o, const float *points,
    size_t count, const struct tape_box *within,
    const struct tiles_crew *crew, uint32_t *order, struct tape_box *boxes);

/* a becomes the box about a and b. */
static inline void tape_box_grow(struct tape_box *a, const struct tape_box *b)
{
	for (int i = 0; i < 3; i++) {
		a->min[i] = b->min[i] < a->min[i] ? b->min[i] : a->min[i];
		a->max[i] = b->max[i] > a->max[i] ? b->max[i] : a->max[i];
	}
}

#endif
