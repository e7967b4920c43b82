/*
 * How long a program's launches take, by their size. Sorted into tiles, more
 * points take less time each: with a long tape 65,536 may take hardly longer
 * than 4,096. So times are kept for each size rather than for a point.
 */
#ifndef SERVER_PACE_H
#define SERVER_PACE_H

#include <stdbool.h>
#include <stddef.h>

/* Sizes that are told apart: PACE_LEAST points, twice as many ... */
#define PACE_SIZES 9
#define PACE_LEAST ((size_t)4096)
#define PACE_MOST (PACE_LEAST << (PACE_SIZES - 1))

/* Zeroed: nothing is known. */
struct pace {
	float seconds[PACE_SIZES]; /* of a launch of that size; 0: not known */
	unsigned char age[PACE_SIZES]; /* launches of smaller sizes since */
};

/* A launch of so many points took so long; fewer than PACE_LEAST say nothing.
 * gains: of a program of which more points take less time each. */
void pace_learn(struct pace *p, size_t points, double seconds, bool gains);

/*
 * The size of a piece, PACE_LEAST to PACE_MOST, that takes about so many
 * seconds; or, where a larger one takes hardly longer than a smaller, which is
 * tried, up to `longest` (0: nothing larger is tried). first: points to begin
 * with, while nothing is known.
 */
size_t pace_points(const struct pace *p, double seconds, double longest,
    size_t first);

#endif
