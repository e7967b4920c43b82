#include "server/pace.h"

#include <math.h>

/* A size twice another's is as good where it takes at most this times as long;
 * and what it is taken for until it has been tried, of long tapes. */
#define DOUBLE_GOOD 1.4
#define DOUBLE_GUESS 1.3

/* Such a piece may take this times what the least takes in any case. */
#define LONGEST_OF_LEAST 1.5

/* One launch may have been held up: it does not raise a time further at once. */
#define RISE_MOST 2.0

/* Launches of other sizes after which a time is forgotten, so that a size is
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

static void grow_old(struct pace *p, int but)
{
	for (int i = 0; i < PACE_SIZES; i++) {
		if (i == but || p->seconds[i] <= 0.0f)
			continue;
		if (++p->age[i] > AGE_MOST)
			p->seconds[i] = 0.0f;
	}
}

void pace_learn(struct pace *p, size_t points, double seconds)
{
	int k = index_of(points);
	double now = seconds * (double)size_of(k) / (double)points;
	double before = (double)p->seconds[k];

	if (points < PACE_LEAST || !(seconds > 0.0))
		return;
	if (before > 0.0)
		now = 0.5 * (before + fmin(now, RISE_MOST * before));
	p->seconds[k] = (float)now;
	p->age[k] = 0;
	grow_old(p, k);
}

/* Seconds of a launch of size k; known: the greatest size that is. */
static double guess(const struct pace *p, int k, int known)
{
	int i = k;

	if (k > known)
		return guess(p, known, known) * pow(DOUBLE_GUESS, k - known);
	while (p->seconds[i] <= 0.0f)
		i++;
	return (double)p->seconds[i] / (double)(1u << (i - k));
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
	longest = fmax(longest, LONGEST_OF_LEAST * guess(p, 0, known));
	while (k < top && guess(p, k + 1, known) <= longest &&
	    guess(p, k + 1, known) <= DOUBLE_GOOD * guess(p, k, known))
		k++;
	return k;
}

size_t pace_points(const struct pace *p, double seconds, double longest,
    size_t first)
{
	int known = PACE_SIZES - 1, top, k = 0, longer;
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
	longer = longest > 0.0 ? stretch(p, k, top, known, longest) : k;
	points = size_of(longer);
	if (longer == k && k < top)
		points = part_of(p, k, known, seconds);
	return points > size_of(k) ? points : size_of(k);
}
