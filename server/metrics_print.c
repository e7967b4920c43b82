#include <stdio.h>
#include <stdlib.h>

#include "server/metrics_internal.h"
#include "server/routes.h"

static const char *const stages[METRICS_STAGE_COUNT] = {
	[METRICS_PARSE] = "parse",
	[METRICS_QUEUE] = "queue",
	[METRICS_UPLOAD] = "upload",
	[METRICS_KERNEL] = "kernel",
	[METRICS_DOWNLOAD] = "download",
	[METRICS_PRINT] = "print",
	[METRICS_COMMIT] = "commit",
};

static unsigned long read_count(const atomic_ulong *counter)
{
	return atomic_load_explicit(counter, memory_order_relaxed);
}

/* An endpoint is a route's pattern: a path as it was sent would make a series of
 * its own. */
static const char *pattern_of(const struct metrics *m, size_t i)
{
	return i < m->route_count ? m->routes[i].pattern : "other";
}

static const char *method_of(const struct metrics *m, size_t i)
{
	return i < m->route_count ? m->routes[i].method : "other";
}

/* Whether it has been asked for yet: the others' series are left out. */
static bool is_used(const struct metrics_histogram *h)
{
	for (size_t i = 0; i <= METRICS_BOUNDS; i++)
		if (read_count(&h->buckets[i]) > 0)
			return true;
	return false;
}

/* ---- requests ---- */

static void print_status(struct metrics_page *p, const char *pattern,
    size_t method, size_t status, unsigned long count)
{
	char text[16];

	if (count == 0)
		return;
	if (status == METRICS_STATUSES - 1)
		snprintf(text, sizeof text, "other");
	else if (metrics_statuses[status] == 0)
		snprintf(text, sizeof text, "none");
	else
		snprintf(text, sizeof text, "%u", metrics_statuses[status]);
	metrics_page_sample(p, "", (struct metrics_label[]){
		{"endpoint", pattern}, {"method", metrics_methods[method]},
		{"status", text}, {NULL, NULL}}, (double)count);
}

static void print_requests(struct metrics_page *p, const struct metrics *m)
{
	metrics_page_family(p, "blobfield_http_requests_total", "counter",
	    "Requests that are over, by the pattern of their path, method and "
	    "status; none: the connection ended before there was an answer.");
	for (size_t i = 0; i <= m->route_count; i++)
		for (size_t k = 0; k < METRICS_METHODS; k++)
			for (size_t s = 0; s < METRICS_STATUSES; s++)
				print_status(p, pattern_of(m, i), k, s,
				    read_count(&m->endpoints[i].
				    requests[k][s]));
}

static void print_bytes(struct metrics_page *p, const struct metrics *m,
    bool is_in)
{
	for (size_t i = 0; i <= m->route_count; i++) {
		const struct metrics_endpoint *e = m->endpoints + i;

		if (is_used(&e->duration))
			metrics_page_sample(p, "", (struct metrics_label[]){
				{"endpoint", pattern_of(m, i)},
				{"method", method_of(m, i)}, {NULL, NULL}},
			    (double)read_count(is_in ? &e->bytes_in :
			    &e->bytes_out));
	}
}

static void print_all_bytes(struct metrics_page *p, const struct metrics *m)
{
	metrics_page_family(p, "blobfield_http_request_bytes_total", "counter",
	    "Bytes of requests' bodies.");
	print_bytes(p, m, true);
	metrics_page_family(p, "blobfield_http_response_bytes_total", "counter",
	    "Bytes of answers' bodies.");
	print_bytes(p, m, false);
}

/* ---- histograms ---- */

/* labels: method and endpoint are first, `le` is put behind them and stage. */
static void print_histogram(struct metrics_page *p,
    const struct metrics_histogram *h, const char *pattern,
    const char *method, const char *stage)
{
	struct metrics_label labels[METRICS_LABELS] = {
		{"endpoint", pattern}, {"method", method}};
	struct metrics_label *le = labels + 2;
	unsigned long sum = 0;
	char bound[32];

	if (stage != NULL)
		*le++ = (struct metrics_label){"stage", stage};
	*le = (struct metrics_label){"le", bound};
	for (size_t i = 0; i < METRICS_BOUNDS; i++) {
		sum += read_count(&h->buckets[i]);
		snprintf(bound, sizeof bound, "%g", metrics_bounds[i]);
		metrics_page_sample(p, "_bucket", labels, (double)sum);
	}
	sum += read_count(&h->buckets[METRICS_BOUNDS]);
	snprintf(bound, sizeof bound, "+Inf");
	metrics_page_sample(p, "_bucket", labels, (double)sum);
	*le = (struct metrics_label){NULL, NULL};
	metrics_page_sample(p, "_sum", labels,
	    1e-9 * (double)read_count(&h->nanoseconds));
	metrics_page_sample(p, "_count", labels, (double)sum);
}

static void print_durations(struct metrics_page *p, const struct metrics *m)
{
	metrics_page_family(p, "blobfield_http_request_duration_seconds",
	    "histogram", "From a request's first line to its answer's end.");
	for (size_t i = 0; i <= m->route_count; i++)
		if (is_used(&m->endpoints[i].duration))
			print_histogram(p, &m->endpoints[i].duration,
			    pattern_of(m, i), method_of(m, i), NULL);
}

static void print_stages(struct metrics_page *p, const struct metrics *m)
{
	metrics_page_family(p, "blobfield_stage_duration_seconds", "histogram",
	    "What requests' time went to: parse, queue, upload, kernel and "
	    "download (for all the launches of one request together), print, "
	    "commit.");
	for (size_t i = 0; i <= m->route_count; i++)
		for (size_t k = 0; k < METRICS_STAGE_COUNT; k++)
			if (is_used(&m->endpoints[i].stages[k]))
				print_histogram(p, &m->endpoints[i].stages[k],
				    pattern_of(m, i), method_of(m, i),
				    stages[k]);
}

/* ---- all ---- */

/* With zeros: a rate needs where it began. */
static void print_problems(struct metrics_page *p, const struct metrics *m)
{
	metrics_page_family(p, "blobfield_problems_total", "counter",
	    "Requests answered with a problem, by its type's last part.");
	for (int i = 0; i < PROBLEM_COUNT; i++)
		metrics_page_sample(p, "", (struct metrics_label[]){
			{"reason", problem_kind((enum problem)i)->slug},
			{NULL, NULL}}, (double)read_count(&m->problems[i]));
}

char *metrics_print(struct metrics *m, struct server *server, size_t *length)
{
	struct metrics_page p = {0};

	print_requests(&p, m);
	print_durations(&p, m);
	print_all_bytes(&p, m);
	print_stages(&p, m);
	print_problems(&p, m);
	if (server != NULL)
		metrics_print_gauges(&p, server);
	if (p.has_failed) {
		free(p.text);
		return NULL;
	}
	*length = p.length;
	return p.text;
}
