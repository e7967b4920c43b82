#include "core/mesh_loops.h"

#include <string.h>

/* The corners of a face, (u, v) of the axes across it, in order about it. */
static const unsigned char around[4][2] = {{0, 0}, {1, 0}, {1, 1}, {0, 1}};

unsigned mesh_loops_corner(unsigned f, unsigned k)
{
	unsigned a = f / 2, u = (a + 1) % 3, v = (a + 2) % 3;

	return (f & 1) << a | (unsigned)around[k][0] << u |
	    (unsigned)around[k][1] << v;
}

/* The edge between two corners that differ in one axis. */
static unsigned edge_between(unsigned c, unsigned d)
{
	unsigned a = (c ^ d) >> 1; /* 1, 2, 4: 0, 1, 2 */
	unsigned low = c & d, u = (a + 1) % 3, v = (a + 2) % 3;

	return 4 * a + (low >> u & 1) + 2 * (low >> v & 1);
}

unsigned mesh_loops_edge(unsigned f, unsigned k)
{
	return edge_between(mesh_loops_corner(f, k),
	    mesh_loops_corner(f, (k + 1) % 4));
}

/* Which corners of face f are inside: bit k for its corner k. */
static unsigned face_of(unsigned inside, unsigned f)
{
	unsigned bits = 0;

	for (unsigned k = 0; k < 4; k++)
		bits |= (inside >> mesh_loops_corner(f, k) & 1) << k;
	return bits;
}

static bool is_ambiguous(unsigned face)
{
	return face == 5 || face == 10;
}

/* partner[e][a]: the edge that a segment of the curve joins edge e with, in the
 * one of its two faces that lies across axis a. */
struct segments {
	uint8_t partner[12][3];
};

static void join(struct segments *s, unsigned f, unsigned k, unsigned l)
{
	unsigned e = mesh_loops_edge(f, k), d = mesh_loops_edge(f, l);

	s->partner[e][f / 2] = (uint8_t)d;
	s->partner[d][f / 2] = (uint8_t)e;
}

/*
 * Where the segments of an ambiguous face begin: they join its edges first and
 * first + 1, first + 2 and first + 3, and so cut off its corners first + 1 and
 * first + 3. Joined corners inside leave those outside cut off.
 */
static unsigned first_of(unsigned face, bool joined)
{
	bool odd_inside = face == 10;

	return odd_inside != joined ? 0 : 3;
}

void mesh_loops_segment(unsigned inside, unsigned joined, unsigned f,
    unsigned k, unsigned edges[static 2])
{
	unsigned first = first_of(face_of(inside, f), joined >> f & 1) + 2 * k;

	edges[0] = mesh_loops_edge(f, first % 4);
	edges[1] = mesh_loops_edge(f, (first + 1) % 4);
}

static void join_face(struct segments *s, unsigned f, unsigned face,
    bool joined)
{
	unsigned ends[4], n = 0;

	if (is_ambiguous(face)) {
		unsigned first = first_of(face, joined);

		join(s, f, first, (first + 1) % 4);
		join(s, f, (first + 2) % 4, (first + 3) % 4);
		return;
	}
	for (unsigned k = 0; k < 4; k++)
		if ((face >> k ^ face >> (k + 1) % 4) & 1)
			ends[n++] = k;
	if (n == 2)
		join(s, f, ends[0], ends[1]);
}

/* Follows the curve from edge e, entering across its first face. */
static void follow(const struct segments *s, unsigned e, uint8_t loop,
    struct mesh_loops *out)
{
	unsigned across = (e / 4 + 1) % 3;

	while (out->of[e] == MESH_LOOPS_NONE) {
		unsigned next = s->partner[e][across];

		out->of[e] = loop;
		/* An edge along a lies in the faces across the other two. */
		across = 3 - next / 4 - across;
		e = next;
	}
}

void mesh_loops_make(unsigned inside, unsigned joined,
    struct mesh_loops *out)
{
	struct segments s;

	memset(out->of, MESH_LOOPS_NONE, sizeof out->of);
	out->count = 0;
	for (unsigned f = 0; f < 6; f++)
		join_face(&s, f, face_of(inside, f), joined >> f & 1);
	for (unsigned e = 0; e < 12; e++) {
		bool crossed = (inside >> mesh_loops_begin(e) ^
		    inside >> mesh_loops_end(e)) & 1;

		if (crossed && out->of[e] == MESH_LOOPS_NONE)
			follow(&s, e, out->count++, out);
	}
}

void mesh_cases_init(struct mesh_cases *cases)
{
	for (unsigned inside = 0; inside < 256; inside++) {
		mesh_loops_make(inside, 0, cases->loops + inside);
		cases->ambiguous[inside] = 0;
		for (unsigned f = 0; f < 6; f++)
			if (is_ambiguous(face_of(inside, f)))
				cases->ambiguous[inside] |= (uint8_t)(1 << f);
	}
}
