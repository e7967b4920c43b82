/*
 * Batches cut into tiles of neighbouring points, each with the part of a tape
 * that is alive about its points (core/prune.h). Points are sorted along a
 * Morton curve where that makes tiles smaller; boxes of ever more tiles form the
 * hierarchy by which tapes are pruned, coarse boxes first.
 */
#ifndef CORE_TILES_H
#define CORE_TILES_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#include "core/err.h"
#include "core/tile.h"

struct tape;
struct tiles;
struct tiles_work;

/* Runs task(ctx, i) for each i < count, perhaps several at once, and returns
 * when all have ended. */
struct tiles_crew {
	void (*run)(void *self, void (*task)(void *ctx, size_t i), void *ctx,
	    size_t count);
	void *self;
	size_t hands; /* tasks that can run at once */
};

/* Where the result goes: the caller's arrays, which a device may read. */
struct tiles_out {
	uint32_t *order;    /* indices of points, TILE_POINTS for each tile; those
	                     * beyond count repeat one */
	struct tile *tiles;
	struct insn *insns; /* of all tiles that have an own part */
	size_t insns_max;   /* room; tiles that find none get the whole tape */
	/* filled in: */
	size_t tile_count;  /* of count points: tiles_count(count) */
	size_t insn_count;  /* used of insns */
};

static inline size_t tiles_count(size_t points)
{
	return (points + TILE_POINTS - 1) / TILE_POINTS;
}

/*
 * What tiles of tape need to know, a copy; the tape may be freed afterwards.
 * speed (> 0): how many times as fast as the processor that culls the device
 * evaluates: 1 if it is that processor. *out is the caller's; any number of
 * threads may use it. ERR_MEMORY.
 */
enum err tiles_create(const struct tape *tape, double speed,
    struct tiles **out);

/* Frees t; NULL does nothing. */
void tiles_free(struct tiles *t);

/* Bytes it takes, about. */
size_t tiles_bytes(const struct tiles *t);

/*
 * Working memory of one tiles_build at a time, of whatever tapes; it grows to
 * what the largest has needed: 24 bytes a point that is sorted, three lists of
 * the tape's length a hand. ERR_MEMORY. Free: NULL does nothing.
 */
enum err tiles_work_create(struct tiles_work **out);
void tiles_work_free(struct tiles_work *w);

/* Whether culling may pay for a batch of so many points: not for tapes that
 * cost little, nor where hardly a box is bounded. */
bool tiles_pay(const struct tiles *t, size_t count);

/* Whether it pays for these points: a sample of them tells. */
bool tiles_help(const struct tiles *t, const float *points, size_t count);

/*
 * Orders count (> 0) points (xyz, finite, world units) and cuts them into
 * tiles. With is_culled false: order as given, every tile the whole tape.
 * crew NULL: one after the other. ERR_MEMORY.
 */
enum err tiles_build(const struct tiles *t, struct tiles_work *work,
    const float *points, size_t count, bool is_culled,
    const struct tiles_crew *crew, struct tiles_out *out);

#endif
