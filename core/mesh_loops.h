/*
 * How a level set passes through a cell: the closed curves in which it meets
 * the cell's faces, from which of the eight corners are inside and, of faces
 * with two diagonal ones inside, whether those are joined.
 *
 * Corner c is at (c & 1, c >> 1 & 1, c >> 2). Edge 4 a + u + 2 v runs along
 * axis a from the corner at u, v of the axes after it (a + 1, a + 2 mod 3). Face
 * 2 a + s is the lower (s = 0) or upper one across axis a.
 */
#ifndef CORE_MESH_LOOPS_H
#define CORE_MESH_LOOPS_H

#include <stdbool.h>
#include <stdint.h>

#define MESH_LOOPS_NONE 0xff
#define MESH_LOOPS_MAX 4

struct mesh_loops {
	uint8_t of[12]; /* an edge's curve, or MESH_LOOPS_NONE */
	uint8_t count;  /* of curves */
};

/* What follows from the corners alone, for each of the 256 cases. */
struct mesh_cases {
	struct mesh_loops loops[256]; /* no diagonal corners joined */
	uint8_t ambiguous[256];       /* bit f: face f has diagonal ones */
};

void mesh_cases_init(struct mesh_cases *cases);

/* The curves of corners inside (bit c: corner c) where diagonal ones are joined
 * within the faces of joined (bit f; of no account for other faces). */
void mesh_loops_make(unsigned inside, unsigned joined,
    struct mesh_loops *out);

/* The same by the table, if need be to *room. */
static inline const struct mesh_loops *mesh_loops_get(
    const struct mesh_cases *cases, unsigned inside, unsigned joined,
    struct mesh_loops *room)
{
	if ((joined & cases->ambiguous[inside]) == 0)
		return cases->loops + inside;
	mesh_loops_make(inside, joined, room);
	return room;
}

/* Corner k of four about face f, in order about it. */
unsigned mesh_loops_corner(unsigned f, unsigned k);

/* Edge k of four about face f: from its corner k to the next. */
unsigned mesh_loops_edge(unsigned f, unsigned k);

/* The two edges that segment k (0 or 1) within the ambiguous face f joins. The
 * cell beyond has the same two with its face's number for f. */
void mesh_loops_segment(unsigned inside, unsigned joined, unsigned f,
    unsigned k, unsigned edges[static 2]);

/* The corners that an edge joins. */
static inline unsigned mesh_loops_begin(unsigned edge)
{
	unsigned a = edge / 4, u = (a + 1) % 3, v = (a + 2) % 3;

	return (edge & 1) << u | (edge >> 1 & 1) << v;
}

static inline unsigned mesh_loops_end(unsigned edge)
{
	return mesh_loops_begin(edge) | 1u << edge / 4;
}

#endif
