/*
 * What rays (core/raycast.h) know of parts of space: a tree of boxes, each with
 * what pruning leaves of the tape there, made as rays come by and kept; nobody
 * else needs it.
 */
#ifndef CORE_RAYCAST_FIELD_H
#define CORE_RAYCAST_FIELD_H

#include <stdbool.h>
#include <stddef.h>

#include "core/err.h"
#include "core/prune.h"

struct range_tape;
struct tape_box;

enum cell_state {
	CELL_NEW,
	CELL_EMPTY, /* none of the surface is in it */
	CELL_LEAF,
	CELL_SPLIT
};

struct cell {
	double min[3], max[3];
	struct prune_list list; /* own_list: its own, else an ancestor's */
	double least; /* the size of the list's least primitive */
	int children; /* the first of eight */
	bool own_list;
	unsigned char state, depth;
};

struct field {
	const struct range_tape *tape;
	double iso;
	struct prune_list whole, part;
	struct cell **chunks;
	int count, deep;
	size_t bytes; /* of cells and lists: no more than 128 MiB and a bit */
};

/* The boxes are within extent; that of what has no end is as large as
 * field_reach lets it be. ERR_MEMORY. */
enum err field_init(struct field *f, const struct range_tape *tape, double iso,
    const struct tape_box *extent);
void field_fini(struct field *f);

/* How far is looked from a place whose largest coordinate is far. */
double field_reach(const struct tape_box *extent, double far);

/* The box that holds p, EMPTY or LEAF: of two that meet there, the one that
 * lies towards direction. It stays where it is. ERR_MEMORY. */
enum err field_find(struct field *f, const double p[static 3],
    const double direction[static 3], const struct cell **out);

#endif
