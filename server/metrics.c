/*
 * Counters are atomics that nobody waits for: a request costs about twenty
 * additions. What is read while others count may be a request apart from what
 * is beside it; no series ever goes back.
 */
#include "server/metrics.h"

#include <stdlib.h>
#include <string.h>
#include <time.h>

#include "kernels/device.h"
#include "server/exchange.h"
#include "server/metrics_internal.h"
#include "server/routes.h"

const double metrics_bounds[METRICS_BOUNDS] = {
	1e-5, 2e-5, 5e-5, 1e-4, 2e-4, 5e-4, 1e-3, 2e-3, 5e-3, 1e-2, 2e-2, 5e-2,
	0.1, 0.2, 0.5, 1.0, 2.0, 5.0, 10.0, 20.0, 50.0, 100.0,
};

const char *const metrics_methods[METRICS_METHODS] = {
	"GET", "HEAD", "POST", "PUT", "PATCH", "DELETE", "OPTIONS", "other",
};

/* What the daemon answers with; the last entry is all others. */
const unsigned metrics_statuses[METRICS_STATUSES] = {
	0, 200, 201, 202, 204, 206, 304, 400, 401, 403, 404, 405, 406, 408, 409,
	411, 412, 413, 414, 415, 417, 422, 428, 429, 431, 500, 501, 503, 504,
	505, 507, 999,
};

enum err metrics_create(struct metrics **out)
{
	struct metrics *m = calloc(1, sizeof *m);
	struct timespec now;

	if (m == NULL)
		return ERR_MEMORY;
	clock_gettime(CLOCK_REALTIME, &now);
	m->started = (double)now.tv_sec + 1e-3 *
	    (double)(now.tv_nsec / 1000000);
	m->routes = route_list(&m->route_count);
	m->endpoints = calloc(m->route_count + 1, sizeof *m->endpoints);
	if (m->endpoints == NULL) {
		free(m);
		return ERR_MEMORY;
	}
	*out = m;
	return ERR_OK;
}

void metrics_free(struct metrics *m)
{
	if (m == NULL)
		return;
	free(m->endpoints);
	free(m);
}

/* ---- counting ---- */

static void add(atomic_ulong *counter, unsigned long n)
{
	atomic_fetch_add_explicit(counter, n, memory_order_relaxed);
}

/* The bucket of what is no more than its bound. */
static size_t find_bucket(double seconds)
{
	size_t low = 0, high = METRICS_BOUNDS;

	while (low < high) {
		size_t middle = (low + high) / 2;

		if (seconds <= metrics_bounds[middle])
			high = middle;
		else
			low = middle + 1;
	}
	return low;
}

/* A clock that was read on two threads may seem to go back; NaN counts as 0. */
static void observe(struct metrics_histogram *h, double seconds)
{
	if (!(seconds > 0.0))
		seconds = 0.0;
	add(&h->buckets[find_bucket(seconds)], 1);
	add(&h->nanoseconds, (unsigned long)(1e9 * (seconds < 1e6 ? seconds :
	    1e6)));
}

static struct metrics_endpoint *endpoint_of(struct metrics *m,
    const struct exchange *x)
{
	return m->endpoints + (x != NULL && x->route != NULL ?
	    (size_t)(x->route - m->routes) : m->route_count);
}

static size_t method_index(const char *method)
{
	size_t i = 0;

	while (i < METRICS_METHODS - 1 &&
	    (method == NULL || strcmp(method, metrics_methods[i]) != 0))
		i++;
	return i;
}

static size_t status_index(unsigned status)
{
	size_t i = 0;

	while (i < METRICS_STATUSES - 1 && metrics_statuses[i] != status)
		i++;
	return i;
}

void metrics_count_exchange(struct metrics *m, const struct exchange *x,
    double seconds)
{
	struct metrics_endpoint *e;

	if (m == NULL)
		return;
	e = endpoint_of(m, x);
	add(&e->requests[method_index(x->method)][status_index(x->status)], 1);
	add(&e->bytes_in, x->body_seen);
	add(&e->bytes_out, x->answer_length);
	observe(&e->duration, seconds);
	if (x->problem < PROBLEM_COUNT)
		add(&m->problems[x->problem], 1);
}

void metrics_observe(struct metrics *m, const struct exchange *x,
    enum metrics_stage stage, double seconds)
{
	if (m != NULL)
		observe(&endpoint_of(m, x)->stages[stage], seconds);
}

void metrics_observe_device(struct metrics *m, const struct exchange *x,
    const struct device_times *times)
{
	metrics_observe(m, x, METRICS_UPLOAD, times->upload);
	metrics_observe(m, x, METRICS_KERNEL, times->kernel);
	metrics_observe(m, x, METRICS_DOWNLOAD, times->download);
}

void metrics_count_refusal(struct metrics *m, enum problem problem)
{
	if (m != NULL && problem < PROBLEM_COUNT)
		add(&m->problems[problem], 1);
}
