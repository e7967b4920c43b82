/*
 * What /metrics tells, in Prometheus's text format: counters and histograms
 * counted here, gauges read from the daemon's parts when asked. Safe from any
 * thread, without locks.
 */
#ifndef SERVER_METRICS_H
#define SERVER_METRICS_H

#include <stdbool.h>
#include <stddef.h>

#include "core/err.h"
#include "server/problem.h"

struct device_times;
struct exchange;
struct metrics;
struct server;

/* Stages of a request, each a histogram of seconds, by endpoint. */
enum metrics_stage {
	METRICS_PARSE,    /* body to points and documents */
	METRICS_QUEUE,    /* from submitted to begun on the device; of tasks, all
	                   * their evaluations' and for a thread */
	METRICS_UPLOAD,   /* struct device_times's, and loading the tape; of all
	                   * launches together */
	METRICS_KERNEL,
	METRICS_DOWNLOAD,
	METRICS_PRINT,    /* rows to the answer's text */
	METRICS_COMMIT,   /* a change of a scene, until it is kept */
	METRICS_STAGE_COUNT
};

enum err metrics_create(struct metrics **out);
void metrics_free(struct metrics *m);

/* An exchange is over: counts it by route, method and status, its duration, its
 * bytes in and out; and its problem, if it was answered with one. */
void metrics_count_exchange(struct metrics *m, const struct exchange *x,
    double seconds);

/* One stage of x's request took so many seconds. x may be NULL: of no
 * endpoint. m may be NULL: nothing. */
void metrics_observe(struct metrics *m, const struct exchange *x,
    enum metrics_stage stage, double seconds);

/* The three of the device. */
void metrics_observe_device(struct metrics *m, const struct exchange *x,
    const struct device_times *times);

/* A request was refused that way, without metrics_count_exchange. */
void metrics_count_refusal(struct metrics *m, enum problem problem);

/* All of it, malloc'd, with gauges of server's parts; NULL: no memory. */
char *metrics_print(struct metrics *m, struct server *server, size_t *length);

#endif
