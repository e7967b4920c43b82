/*
 * Orders of operator tables: each is built, and its error in g measured; where
 * the order says how large that may be, the coarsest table that holds it is
 * searched for (Gourmel et al. 2013, section 5: "binary search ... to obtain
 * a given error bound").
 *
 * Threads: functions are safe from any thread. One thread searches, on all
 * cores, at lesser priority than evaluations; each order submitted is completed
 * exactly once, by a call of its done(), after which it is the submitter's
 * again.
 */
#ifndef SERVER_ORDERS_H
#define SERVER_ORDERS_H

#include <stdbool.h>
#include <stddef.h>

#include "core/err.h"
#include "proto/order.h"
#include "server/tables.h"

struct orders;

/* Waiting at most, beside the one that is being searched for. */
#define ORDERS_MAX 8

/* One order. Zeroed by the caller, then: */
struct order_job {
	/* set before orders_submit */
	struct order order;
	void (*park)(void *ctx); /* accepted: called before anything else may be */
	void (*done)(void *ctx);
	bool (*wanted)(void *ctx); /* any thread: is anybody still waiting? */
	void *ctx;
	/* set before done() */
	enum err result;         /* ERR_LIMIT: no table holds max_error;
	                          * ERR_CANCELLED, ERR_MEMORY */
	int resolution;          /* of the table; ERR_LIMIT: of the best one */
	double max, mean;        /* its error in g over TABLE_SAMPLE points */
	struct table_report report; /* ERR_OK: of the table, now */
	/* the searcher's own */
	struct order_job *next;
};

/*
 * Starts the thread; tables outlive it. table_bytes_most: no larger table is
 * searched for. ERR_MEMORY, ERR_IO.
 */
enum err orders_create(struct tables *tables, size_t table_bytes_most,
    struct orders **out);

/*
 * Queues job. ERR_BUSY: the queue is full; ERR_CANCELLED: draining. Either way
 * nothing of job's has been called.
 */
enum err orders_submit(struct orders *o, struct order_job *job);

/* Refuses new orders from now on, and gives up those there are, soon. */
void orders_drain(struct orders *o);

/* The same, then ends the thread. orders_submit remains valid. */
void orders_stop(struct orders *o);

/* After orders_stop; NULL does nothing. */
void orders_free(struct orders *o);

/* The finest resolution whose table takes at most bytes; at least
 * TABLE_RESOLUTION_MIN. */
int orders_resolution_most(size_t bytes);

#endif
