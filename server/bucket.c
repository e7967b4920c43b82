#include "server/bucket.h"

#include <math.h>

static double capacity(const struct bucket *b)
{
	return fmax(b->rate, 1.0);
}

static void flow(struct bucket *b, double now)
{
	if (now <= b->when)
		return;
	b->level = fmin(b->level + b->rate * (now - b->when), capacity(b));
	b->when = now;
}

void bucket_set_rate(struct bucket *b, double rate, double now)
{
	const bool had_none = b->rate == 0.0;

	flow(b, now);
	b->rate = rate;
	b->when = now;
	if (had_none || b->level > capacity(b))
		b->level = capacity(b);
}

double bucket_wait(struct bucket *b, double now)
{
	if (b->rate == 0.0)
		return 0.0;
	flow(b, now);
	/* At 0 exactly, nothing is left, but soon there will be. */
	return b->level > 0.0 ? 0.0 : fmax(-b->level / b->rate, 1e-3);
}

bool bucket_is_beyond(const struct bucket *b, double amount)
{
	return b->rate > 0.0 && amount > fmax(BUCKET_ALONE_SECONDS * b->rate,
	    capacity(b));
}

void bucket_take(struct bucket *b, double amount, double now)
{
	if (b->rate == 0.0)
		return;
	flow(b, now);
	/* One, of a rate below one a minute, is waited for in full. */
	b->level = fmax(b->level - amount, -fmax(BUCKET_DEBT_SECONDS *
	    b->rate, 1.0));
}
