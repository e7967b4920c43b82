/*
 * A rate with a debt: what flows in at so much a second, up to what one second
 * gives (at least 1), and may be taken as long as anything is left, even more
 * than that; what has been taken too much must flow in before the next, but never
 * more than a minute's: nobody is locked out for hours by one request. So the
 * rate holds on average as long as none takes more than BUCKET_DEBT_SECONDS of
 * it. What alone asks for more than BUCKET_ALONE_SECONDS is for the caller to
 * refuse, as it can see that before.
 *
 * now is clock_seconds throughout, and may go back a little between threads.
 * Not locked.
 */
#ifndef SERVER_BUCKET_H
#define SERVER_BUCKET_H

#include <stdbool.h>

#define BUCKET_DEBT_SECONDS 60.0
#define BUCKET_ALONE_SECONDS 3600.0

/* Start with {0}: no rate, anything goes. */
struct bucket {
	double rate;  /* a second; 0: any */
	double level; /* what is left; negative: owed */
	double when;  /* ... at that time */
};

/* rate: finite, 0 for none. What has been taken stays taken; a bucket that had
 * no rate begins full. */
void bucket_set_rate(struct bucket *b, double rate, double now);

/* Seconds until something may be taken: 0 for now. */
double bucket_wait(struct bucket *b, double now);

/* Whether amount is more than is to be taken at once. */
bool bucket_is_beyond(const struct bucket *b, double amount);

/* Takes amount >= 0, whatever is left. */
void bucket_take(struct bucket *b, double amount, double now);

#endif
