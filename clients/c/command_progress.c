#include <math.h>
#include <string.h>
#include <time.h>
#include <unistd.h>

#include "clients/c/command.h"

#define BAR 30

/* Seconds before a bar shows: most work is over by then. */
#define PATIENCE 0.4

static struct {
	bool is_drawn;
	double begun, last;
	double from, to;
} bar;

static double now(void)
{
	struct timespec time;

	clock_gettime(CLOCK_MONOTONIC, &time);
	return (double)time.tv_sec + 1e-9 * (double)time.tv_nsec;
}

static int draw(void *ctx, const char *stage, double done)
{
	const double t = now();
	char cells[BAR + 1];
	double whole;
	int full;

	(void)ctx;
	if (t - bar.begun < PATIENCE || t - bar.last < 0.1)
		return 0;
	whole = bar.from + (bar.to - bar.from) * fmin(fmax(done, 0.0), 1.0);
	full = (int)(whole * BAR);
	memset(cells, '#', (size_t)full);
	memset(cells + full, '-', (size_t)(BAR - full));
	cells[BAR] = '\0';
	fprintf(stderr, "\r%-9s [%s] %3d %%\033[K", *stage != '\0' ? stage :
	    "working", cells, (int)(100.0 * whole));
	fflush(stderr);
	bar.is_drawn = true;
	bar.last = t;
	return 0;
}

void progress_part(double from, double to)
{
	bar.from = from;
	bar.to = to;
}

void progress_begin(struct session *s)
{
	if (s->quiet || (!s->progress && !isatty(STDERR_FILENO)))
		return;
	bar.begun = now();
	bar.last = 0.0;
	progress_part(0.0, 1.0);
	blobfield_set_progress(s->client, draw, NULL);
}

void progress_end(struct session *s)
{
	blobfield_set_progress(s->client, NULL, NULL);
	if (bar.is_drawn)
		fprintf(stderr, "\r\033[K");
	bar.is_drawn = false;
}
