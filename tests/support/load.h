/*
 * A closed-loop HTTP load: many keep-alive connections from one thread, each
 * with one request under way at a time; and single exchanges, timed. For the
 * bench and the soak, where the client must cost little.
 */
#ifndef TESTS_SUPPORT_LOAD_H
#define TESTS_SUPPORT_LOAD_H

#include <stdbool.h>
#include <stddef.h>

/* A request as it goes over the wire. */
struct load_request {
	char *bytes; /* malloc'd */
	size_t length;
};

/* "METHOD path HTTP/1.1" with these headers (lines ending in \r\n, or "") and
 * this body. Never fails: aborts when out of memory. */
struct load_request load_request_make(const char *method, const char *path,
    const char *headers, const void *body, size_t length);
void load_request_fini(struct load_request *request);

struct load_options {
	int port;                /* of 127.0.0.1 */
	size_t connections;
	const struct load_request *requests; /* connection i sends number */
	size_t request_count;                /* i % request_count, always */
	size_t total;            /* answers to get; 0: as many as seconds allow */
	double seconds;          /* 0: no bound */
	const bool *stop;        /* read with atomics between answers; or NULL */
};

struct load_result {
	double *seconds;         /* of each answer, in the order they ended;
	                          * malloc'd, load_result_fini */
	size_t count;
	size_t failures;         /* answers other than 2xx, or none */
	size_t fewest, most;     /* answers of one connection */
	double elapsed;
};

/* Runs the load. 0, or -1 when no connection could be made. */
int load_run(const struct load_options *options, struct load_result *out);
void load_result_fini(struct load_result *result);

/* The p-th quantile (0 to 1) of count numbers, which are sorted. */
double load_quantile(double *values, size_t count, double p);

/* One answer, its body counted and, if keep, kept. */
struct load_answer {
	int status;
	size_t length;
	char *body;       /* malloc'd, or NULL */
	double first, last; /* seconds from the start to its first and last byte */
	char timing[160]; /* the Server-Timing header, or "" */
};

/* Sends request on fd (connected, blocking) and reads its answer. -1: the
 * connection broke, or it was no HTTP. */
int load_exchange(int fd, const struct load_request *request, bool keep,
    struct load_answer *out);

/* A connected, blocking socket with TCP_NODELAY; -1. */
int load_connect(int port);

/*
 * Whether what took so many seconds is within bound, which is what it may take on
 * a machine that does nothing else: four times as much is let pass, and as many
 * times more as more threads want to run than there are processors. For what would
 * take much longer, or for ever, if it were wrong.
 */
bool load_is_soon(double seconds, double bound);

#endif
