#include "server/pace.h"

#include <math.h>

/* A size twice another's is as good where it takes at most this times as long;
 * and what it is taken for until it has been tried, of long tapes. */
#define DOUBLE_GOOD 1.4
#define DOUBLE_GUESS 1.3

/* Such a piece may take this times what the least takes in any case, if that
 * takes no longer than so many seconds. */
#define LONGEST_OF_LEAST 1.5
#define LEAST_AT_MOST 0.1

/* One launch may have been held up: no more of its time counts, half with what
 * was known. */
#define RISE_MOST 2.0

/* Launches of smaller sizes after which a time is forgotten, so that a size is
 * tried again whose one launch was held up. */
#define AGE_MOST 64

static size_t size_of(int k)
{
	return PACE_LEAST << k;
}

/* The greatest size that is not above so many points. */
static int index_of(size_t points)
{
	int k = 0;

	while (k + 1 < PACE_SIZES && size_of(k + 1) <= points)
		k++;
	return k;
}

/* Larger sizes than k, that is: what smaller ones take stays known, to compare
 * with. */
static void grow_old(struct pace *p, int k)
{
	for (int i = k + 1; i < PACE_SIZES; i++)
		if (p->seconds[i] > 0.0f && ++p->age[i] > AGE_MOST)
			p->seconds[i] = 0.0f;
}

void pace_learn(struct pace *p, size_t points, double seconds, bool gains)
{
	int k = index_of(points);
	double share = (double)size_of(k) / (double)points;
	double before = (double)p->seconds[k], now;

	if (points < PACE_LEAST || !(seconds > 0.0))
		return;
	now = seconds * (gains ? pow(share, log2(DOUBLE_GUESS)) : share);
	if (before > 0.0)
		now = 0.5 * (before + fmin(now, RISE_MOST * before));
	p->seconds[k] = (float)now;
	p->age[k] = 0;
	grow_old(p, k);
}

/*
 * Seconds of a launch of size k; known: the greatest size that is. Between two
 * that are known, each size takes as many times what the one below does; below
 * the least, half of what the next does.
 */
static double guess(const struct pace *p, int k, int known)
{
	int low = k, high = k;

	if (k > known)
		return guess(p, known, known) * pow(DOUBLE_GUESS, k - known);
	while (p->seconds[high] <= 0.0f)
		high++;
	while (low >= 0 && p->seconds[low] <= 0.0f)
		low--;
	if (low < 0)
		return (double)p->seconds[high] / (double)(1u << (high - k));
	if (low == high)
		return (double)p->seconds[k];
	return (double)p->seconds[low] * pow((double)p->seconds[high] /
	    (double)p->seconds[low], (double)(k - low) / (high - low));
}

/* Points that take so long by the time of size k, in whole PACE_LEAST. */
static size_t part_of(const struct pace *p, int k, int known, double seconds)
{
	double share = fmin(seconds / guess(p, k, known), 2.0);
	size_t points = (size_t)(share * (double)size_of(k));

	return points - points % PACE_LEAST;
}

/* The size from k on that takes hardly longer, as far as one may wait. */
static int stretch(const struct pace *p, int k, int top, int known,
    double longest)
{
	longest = fmax(longest, LONGEST_OF_LEAST *
	    fmin(guess(p, 0, known), LEAST_AT_MOST));
	while (k < top && guess(p, k + 1, known) <= longest &&
	    guess(p, k + 1, known) <= DOUBLE_GOOD * guess(p, k, known))
		k++;
	return k;
}

size_t pace_points(const struct pace *p, double seconds, double longest,
    size_t first)
{
	int known = PACE_SIZES - 1, top, k = 0;
	size_t points;

	while (known >= 0 && p->seconds[known] <= 0.0f)
		known--;
	if (known < 0)
		return first < PACE_LEAST ? PACE_LEAST : first > PACE_MOST
		    ? PACE_MOST : first - first % PACE_LEAST;
	/* One size at a time is tried. */
	top = known + 1 < PACE_SIZES ? known + 1 : known;
	while (k < top && guess(p, k + 1, known) <= seconds)
		k++;
	if (longest > 0.0)
		return size_of(stretch(p, k, top, known, longest));
	points = k < top ? part_of(p, k, known, seconds) : 0;
	return points > size_of(k) ? points : size_of(k);
}
