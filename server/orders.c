/*
 * Who owns: a queued job is on the list, which the lock guards; the searcher
 * takes one off and alone works on it, without the lock. Who completes:
 * finish(), once the job is off the list.
 */
#include "server/orders.h"

#include <assert.h>
#include <math.h>
#include <pthread.h>
#include <stdatomic.h>
#include <stdlib.h>
#include <sys/resource.h>

#include "core/curve.h"
#include "core/table.h"
#include "server/clock.h"
#include "server/crew.h"
#include "server/log.h"

/* Of the searcher: evaluations and tables that are waited for go first, but
 * it gets a tenth of a busy core. */
#define ORDERS_NICE 10

/* Resolutions in a row that do not hold an error end the way down. */
#define COARSER_TRIES 4

/* Points looked at in one step: some milliseconds, so that neither who hung up
 * nor a shutdown is noticed late. */
#define PIECE 2000
#define PIECE_COUNT (TABLE_SAMPLE / PIECE)

static_assert(TABLE_SAMPLE % PIECE == 0, "pieces fill the sample");

struct orders {
	struct tables *tables;
	int resolution_most;
	pthread_t thread;
	bool is_started;
	pthread_mutex_t lock; /* guards the list and draining */
	pthread_cond_t wake;
	struct order_job *first, **last;
	size_t count;
	bool stopping;
	atomic_bool draining;
	/* searcher only: */
	double *exact;           /* g at the sample's points; NULL at first */
	struct operator sampled; /* whose, if that has been completed */
	bool is_sampled;
};

/* What the searcher works on. */
struct search {
	struct orders *orders;
	struct order_job *job;
	struct table *table;  /* tried now */
	double bound;         /* of its error, beyond which it need not be known */
	double seconds;       /* its building took */
	double max[PIECE_COUNT], sum[PIECE_COUNT];
};

/* The table that was found. */
struct found {
	struct table *table;
	double max, mean, seconds;
};

int orders_resolution_most(size_t bytes)
{
	const size_t node = (TABLE_FIRST + TABLE_SECOND) * sizeof(float);
	const size_t curves = 2 * TABLE_CURVE_NODES * CURVE_NODE *
	    sizeof(float);
	size_t n = TABLE_RESOLUTION_MAX;

	while (n > TABLE_RESOLUTION_MIN && n * n * n * node + curves > bytes)
		n--;
	return (int)n;
}

/* ---- trying one resolution ---- */

static bool goes_on(const struct search *search)
{
	return !atomic_load(&search->orders->draining) &&
	    search->job->wanted(search->job->ctx);
}

static bool sample_piece(void *ctx, size_t i)
{
	const struct search *search = ctx;
	const struct operator *op = &search->job->order.op;

	table_sample(op->family, &op->profile, i * PIECE, (i + 1) * PIECE,
	    search->orders->exact);
	return goes_on(search);
}

static bool build_piece(void *ctx, size_t i)
{
	const struct search *search = ctx;

	table_build(search->table, (int)i, (int)i + 1);
	return goes_on(search);
}

static bool measure_piece(void *ctx, size_t i)
{
	struct search *search = ctx;

	search->sum[i] = 0.0;
	search->max[i] = table_measure_g(search->table, i * PIECE,
	    (i + 1) * PIECE, search->orders->exact, &search->sum[i]);
	return search->max[i] <= search->bound && goes_on(search);
}

static enum err build(struct search *search, int resolution)
{
	const struct operator *op = &search->job->order.op;
	double begin = clock_seconds();
	enum err err = table_create(op->family, &op->profile, op->layout,
	    resolution, &search->table);

	if (err == ERR_OK && !crew_run((size_t)resolution, build_piece,
	    search))
		err = ERR_CANCELLED;
	search->seconds = clock_seconds() - begin;
	return err;
}

/*
 * Builds a table and measures it into *found, in place of a coarser or finer
 * one; or says in *holds that its error is larger than bound.
 */
static enum err try(struct search *search, int resolution, double bound,
    bool *holds, struct found *found)
{
	double max = 0.0, sum = 0.0;
	enum err err = build(search, resolution);

	search->bound = bound;
	*holds = err == ERR_OK && crew_run(PIECE_COUNT, measure_piece, search);
	if (err == ERR_OK && !*holds && !goes_on(search))
		err = ERR_CANCELLED;
	if (err != ERR_OK || !*holds) {
		table_free(search->table);
		search->table = NULL;
		return err;
	}
	for (int i = 0; i < PIECE_COUNT; i++) {
		max = fmax(max, search->max[i]);
		sum += search->sum[i];
	}
	table_free(found->table);
	*found = (struct found){search->table, max, sum / TABLE_SAMPLE,
	    search->seconds};
	search->table = NULL;
	return ERR_OK;
}

/* ---- searching ---- */

/*
 * Bisection ends where the error first comes within the bound if it falls with
 * the resolution. It does not quite (even resolutions of the uniform layout are
 * worse than the odd ones before them): from there it goes on downwards, until
 * COARSER_TRIES in a row do not hold.
 */
static enum err step_down(struct search *search, struct found *found)
{
	double bound = search->job->order.max_error;
	int failed = 0, n = found->table->resolution - 1;
	enum err err = ERR_OK;
	bool holds;

	for (; err == ERR_OK && n >= TABLE_RESOLUTION_MIN &&
	    failed < COARSER_TRIES; n--) {
		err = try(search, n, bound, &holds, found);
		failed = holds ? 0 : failed + 1;
	}
	return err;
}

/*
 * A table whose error is within the order's, close to the coarsest there is.
 * The finest one is tried second, since a bound that it does not hold is not
 * worth six tries more. ERR_LIMIT: it does not; *found is that one all the
 * same.
 */
static enum err bisect(struct search *search, struct found *found)
{
	double bound = search->job->order.max_error;
	int low = TABLE_RESOLUTION_MIN;
	int high = search->orders->resolution_most; /* holds, once tried */
	bool holds, high_tried = false;
	enum err err = ERR_OK;

	while (err == ERR_OK && low < high) {
		int middle = (low + high) / 2;

		err = try(search, middle, bound, &holds, found);
		if (err != ERR_OK)
			break;
		if (holds) {
			high = middle;
			high_tried = true;
			continue;
		}
		low = middle + 1;
		if (!high_tried) {
			err = try(search, high, INFINITY, &holds, found);
			high_tried = true;
			if (err == ERR_OK && found->max > bound)
				return ERR_LIMIT;
		}
	}
	if (err == ERR_OK && !high_tried)
		err = try(search, high, INFINITY, &holds, found);
	if (err == ERR_OK && found->max > bound)
		err = ERR_LIMIT;
	return err == ERR_OK && found->table != NULL ?
	    step_down(search, found) : err;
}

/* Has the exact values there, which often are, from an order before. */
static enum err sample(struct search *search)
{
	const struct operator *op = &search->job->order.op;
	struct orders *o = search->orders;

	if (o->is_sampled && o->sampled.family == op->family &&
	    profile_equal(&o->sampled.profile, &op->profile))
		return ERR_OK;
	if (o->exact == NULL)
		o->exact = malloc(sizeof *o->exact * TABLE_SAMPLE);
	if (o->exact == NULL)
		return ERR_MEMORY;
	o->sampled = *op;
	o->is_sampled = crew_run(PIECE_COUNT, sample_piece, search);
	return o->is_sampled ? ERR_OK : ERR_CANCELLED;
}

static enum err find(struct search *search, struct found *found)
{
	int resolution = search->job->order.op.resolution;
	enum err err = sample(search);
	bool holds;

	if (err != ERR_OK)
		return err;
	err = resolution == 0 ? bisect(search, found) :
	    try(search, resolution, INFINITY, &holds, found);
	/* No table has an error that is not a number: a fault of ours. */
	return err == ERR_OK && found->table == NULL ? ERR_INVALID : err;
}

static void log_found(const struct order_job *job, double seconds)
{
	const struct operator *op = &job->order.op;

	log_write(LOG_INFO, "order %s %s %s within %g: %s%d, max %.2g mean "
	    "%.2g in %.0f ms", operator_family_name(op->family),
	    profile_name(op->profile.type), operator_layout_name(op->layout),
	    job->order.max_error, job->result == ERR_OK ? "" : "not even ",
	    job->resolution, job->max, job->mean, 1e3 * seconds);
}

/* Leaves job with its result. */
static void execute(struct orders *o, struct order_job *job)
{
	struct search *search = calloc(1, sizeof *search);
	struct found found = {.table = NULL};
	double begin = clock_seconds();
	struct operator op = job->order.op;
	enum err err = ERR_MEMORY;

	if (search != NULL) {
		search->orders = o;
		search->job = job;
		err = find(search, &found);
		free(search);
	}
	if (found.table != NULL) {
		job->resolution = op.resolution = found.table->resolution;
		job->max = found.max;
		job->mean = found.mean;
	}
	job->result = err;
	if (err == ERR_OK)
		job->result = tables_give(o->tables, &op, found.table,
		    found.seconds, &job->report);
	else
		table_free(found.table);
	if (err == ERR_OK || err == ERR_LIMIT)
		log_found(job, clock_seconds() - begin);
}

/* ---- the queue ---- */

static void finish(struct order_job *job, enum err result)
{
	job->result = result;
	job->done(job->ctx);
}

/* Takes all jobs, or those that nobody waits for, off the list. Locked. */
static struct order_job *take_all(struct orders *o, bool unwanted_only)
{
	struct order_job **link = &o->first, *list = NULL;

	while (*link != NULL) {
		struct order_job *job = *link;

		if (unwanted_only && job->wanted(job->ctx)) {
			link = &job->next;
			continue;
		}
		*link = job->next;
		job->next = list;
		list = job;
		o->count--;
	}
	o->last = link;
	return list;
}

static void cancel(struct order_job *list)
{
	while (list != NULL) {
		struct order_job *job = list;

		list = job->next;
		finish(job, ERR_CANCELLED);
	}
}

/* Waits for the next job; NULL: stopping. Locked. */
static struct order_job *await(struct orders *o)
{
	struct order_job *job;

	while (o->first == NULL && !o->stopping)
		pthread_cond_wait(&o->wake, &o->lock);
	job = o->first;
	if (job == NULL)
		return NULL;
	o->first = job->next;
	if (o->first == NULL)
		o->last = &o->first;
	o->count--;
	return job;
}

static void *searcher_main(void *arg)
{
	struct orders *o = arg;
	struct order_job *job;

	/* Linux has a nice value for each thread. */
	setpriority(PRIO_PROCESS, 0, ORDERS_NICE);
	for (;;) {
		pthread_mutex_lock(&o->lock);
		job = await(o);
		pthread_mutex_unlock(&o->lock);
		if (job == NULL)
			return NULL;
		execute(o, job);
		finish(job, job->result);
	}
}

enum err orders_create(struct tables *tables, size_t table_bytes_most,
    struct orders **out)
{
	struct orders *o = calloc(1, sizeof *o);

	if (o == NULL)
		return ERR_MEMORY;
	o->tables = tables;
	o->resolution_most = orders_resolution_most(table_bytes_most);
	o->last = &o->first;
	pthread_mutex_init(&o->lock, NULL);
	pthread_cond_init(&o->wake, NULL);
	if (pthread_create(&o->thread, NULL, searcher_main, o) != 0) {
		orders_free(o);
		return ERR_IO;
	}
	o->is_started = true;
	*out = o;
	return ERR_OK;
}

enum err orders_submit(struct orders *o, struct order_job *job)
{
	struct order_job *gone = NULL;
	enum err err = ERR_OK;

	pthread_mutex_lock(&o->lock);
	if (o->count >= ORDERS_MAX)
		gone = take_all(o, true);
	if (atomic_load(&o->draining))
		err = ERR_CANCELLED;
	else if (o->count >= ORDERS_MAX)
		err = ERR_BUSY;
	if (err == ERR_OK) {
		job->next = NULL;
		*o->last = job;
		o->last = &job->next;
		o->count++;
		job->park(job->ctx);
		pthread_cond_signal(&o->wake);
	}
	pthread_mutex_unlock(&o->lock);
	cancel(gone);
	return err;
}

void orders_drain(struct orders *o)
{
	struct order_job *list;

	pthread_mutex_lock(&o->lock);
	atomic_store(&o->draining, true);
	list = take_all(o, false);
	pthread_mutex_unlock(&o->lock);
	cancel(list);
}

void orders_stop(struct orders *o)
{
	orders_drain(o);
	pthread_mutex_lock(&o->lock);
	o->stopping = true;
	pthread_cond_signal(&o->wake);
	pthread_mutex_unlock(&o->lock);
	if (o->is_started)
		pthread_join(o->thread, NULL);
}

void orders_free(struct orders *o)
{
	if (o == NULL)
		return;
	pthread_cond_destroy(&o->wake);
	pthread_mutex_destroy(&o->lock);
	free(o->exact);
	free(o);
}
