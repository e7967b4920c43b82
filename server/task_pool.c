/*
 * The pool's threads. Who owns: the lock guards the lists and figures; a task
 * is in the list of those that live from task_submit until its work has ended,
 * and of those that wait until a thread takes it. One thread more, the watch, looks
 * after those that wait: whose client has gone, or whose deadline has passed.
 * Exactly one thread ends a task: who took it out of the list of waiting ones.
 */
#include <math.h>
#include <stddef.h>
#include <stdlib.h>
#include <string.h>
#include <time.h>

#include <cjson/cJSON.h>

#include "server/clock.h"
#include "server/exchange.h"
#include "server/task_internal.h"

/* Seconds between looks at those that wait, at most. */
#define WATCH_SECONDS 0.25

struct tasks {
	pthread_t *threads;
	size_t thread_count;
	pthread_t watch;
	bool has_watch;
	atomic_bool stopping;
	pthread_mutex_t lock;    /* guards the rest */
	pthread_cond_t work;     /* something waits, or stopping */
	pthread_cond_t look;     /* the same, for the watch */
	struct turns waiting;
	struct task *newest;     /* that live */
	struct tasks_stats stats;
	bool draining;
	bool has_small;          /* a thread has taken to small ones */
};

bool task_pool_is_stopping(const struct tasks *t)
{
	return atomic_load(&t->stopping);
}

/* ---- lists; locked ---- */

static struct task *task_of(struct turn *turn)
{
	return (struct task *)((char *)turn - offsetof(struct task, turn));
}

static void enter(struct tasks *t, struct task *task)
{
	turns_add(&t->waiting, &task->turn, 1);
	task->older = t->newest;
	if (t->newest != NULL)
		t->newest->newer = task;
	t->newest = task;
	t->stats.waiting++;
}

static void forget(struct tasks *t, struct task *task)
{
	if (task->newer != NULL)
		task->newer->older = task->older;
	else
		t->newest = task->older;
	if (task->older != NULL)
		task->older->newer = task->newer;
}

/* task ends with err: it counts no more. */
static void count_out(struct tasks *t, struct task *task, enum err err)
{
	forget(t, task);
	t->stats.completed++;
	t->stats.expired += err == ERR_DEADLINE;
	t->stats.abandoned += err == ERR_CANCELLED &&
	    !atomic_load(&t->stopping);
}

/* ---- threads ---- */

static enum err work_on(struct task *task)
{
	enum err err, verdict;

	err = task_verdict(task);
	if (err == ERR_OK)
		err = task->kind->work(task, task->ctx);
	if (err != ERR_CANCELLED)
		return err;
	/* Whoever sees that it is to be given up says no more than that. */
	verdict = task_verdict(task);
	return verdict != ERR_OK ? verdict : err;
}

/* The first of those that wait, or the first small one; or the end of the list:
 * there is none. Only the thread of small ones passes large ones by, so that
 * these are not starved however many small ones come. Locked. */
static struct turn **next_turn(struct tasks *t, bool small_only)
{
	struct turn **at = &t->waiting.first;

	while (small_only && *at != NULL && !task_of(*at)->is_small)
		at = &(*at)->next;
	return at;
}

/* Waits for a task: NULL once stopping. Locked. */
static struct task *await(struct tasks *t, bool small_only)
{
	struct turn **at = next_turn(t, small_only);

	while (*at == NULL && !atomic_load(&t->stopping)) {
		pthread_cond_wait(&t->work, &t->lock);
		at = next_turn(t, small_only);
	}
	if (atomic_load(&t->stopping))
		return NULL;
	t->stats.running++;
	t->stats.waiting--;
	return task_of(turns_serve(&t->waiting, at));
}

static void *thread_main(void *arg)
{
	struct tasks *t = arg;
	bool small_only;
	struct task *task;

	pthread_mutex_lock(&t->lock);
	small_only = !t->has_small;
	t->has_small = true;
	while ((task = await(t, small_only)) != NULL) {
		enum err err;

		pthread_mutex_unlock(&t->lock);
		task->started = clock_seconds();
		task->thread_started = clock_thread_seconds();
		err = work_on(task);
		pthread_mutex_lock(&t->lock);
		t->stats.running--;
		count_out(t, task, err);
		pthread_mutex_unlock(&t->lock);
		task_end(task, err);
		pthread_mutex_lock(&t->lock);
	}
	pthread_mutex_unlock(&t->lock);
	return NULL;
}

/* Takes out those that wait for nothing, as a list. Locked. */
static struct task *pick_vain(struct tasks *t)
{
	struct turn **at = &t->waiting.first;
	struct task *vain = NULL;

	while (*at != NULL) {
		struct task *task = task_of(*at);
		enum err err = task_verdict(task);

		if (err == ERR_OK) {
			at = &task->turn.next;
			continue;
		}
		turns_drop(&t->waiting, at);
		t->stats.waiting--;
		count_out(t, task, err);
		task->result = err;
		task->next_vain = vain;
		vain = task;
	}
	return vain;
}

static void end_all(struct task *list)
{
	while (list != NULL) {
		struct task *task = list;

		list = task->next_vain;
		task_end(task, task->result);
	}
}

/* When to look at those that wait again. Locked. */
static struct timespec next_look(const struct tasks *t)
{
	double seconds = WATCH_SECONDS;
	struct timespec until;

	for (struct turn *turn = t->waiting.first; turn != NULL;
	    turn = turn->next) {
		const struct task *task = task_of(turn);

		if (task->deadline > 0.0)
			seconds = fmin(seconds, task->deadline -
			    clock_seconds());
	}
	clock_gettime(CLOCK_MONOTONIC, &until);
	/* Rather after a deadline than before it. */
	until.tv_nsec += (long)(1e9 * fmax(seconds, 0.0)) + 100000;
	until.tv_sec += until.tv_nsec / 1000000000;
	until.tv_nsec %= 1000000000;
	return until;
}

static void *watch_main(void *arg)
{
	struct tasks *t = arg;

	pthread_mutex_lock(&t->lock);
	while (!atomic_load(&t->stopping)) {
		struct task *vain = pick_vain(t);
		struct timespec until = next_look(t);

		if (vain != NULL) {
			pthread_mutex_unlock(&t->lock);
			end_all(vain);
			pthread_mutex_lock(&t->lock);
		} else if (t->waiting.first != NULL) {
			pthread_cond_timedwait(&t->look, &t->lock, &until);
		} else {
			pthread_cond_wait(&t->look, &t->lock);
		}
	}
	pthread_mutex_unlock(&t->lock);
	return NULL;
}

/* ---- other threads ---- */

/* Whether there is a place for one more of task's asker. Locked. */
static bool has_place(const struct tasks *t, const struct task *task)
{
	const char *asker = task->turn.asker;

	return t->waiting.count < TASKS_WAITING_OF_ONE ||
	    (t->waiting.count < TASKS_WAITING && (asker[0] == '\0' ||
	    turns_count_of(&t->waiting, asker) == 0));
}

enum err task_submit(struct task *task)
{
	struct tasks *t = task->pool;
	enum err err = ERR_OK;

	pthread_mutex_lock(&t->lock);
	if (t->draining)
		err = ERR_CANCELLED;
	else if (!has_place(t, task) || (t->stats.held_bytes > 0 &&
	    t->stats.held_bytes + task->held > TASKS_HELD_MAX))
		err = ERR_BUSY;
	if (err == ERR_OK) {
		t->stats.held_bytes += task->held;
		exchange_wait(task->x);
		enter(t, task);
		pthread_cond_broadcast(&t->work); /* it may be for one alone */
		pthread_cond_signal(&t->look);
	}
	pthread_mutex_unlock(&t->lock);
	return err;
}

void task_holds(struct task *task, size_t bytes)
{
	struct tasks *t = task->pool;

	pthread_mutex_lock(&t->lock);
	t->stats.held_bytes += bytes - task->held;
	task->held = bytes;
	pthread_mutex_unlock(&t->lock);
}

struct cJSON *tasks_progress(struct tasks *t, const char *token)
{
	struct task *task;
	cJSON *json = NULL;

	pthread_mutex_lock(&t->lock);
	task = t->newest;
	while (task != NULL && strcmp(task->token, token) != 0)
		task = task->older;
	if (task != NULL) {
		json = cJSON_CreateObject();
		pthread_mutex_lock(&task->lock);
		cJSON_AddStringToObject(json, "stage", task->stage);
		cJSON_AddNumberToObject(json, "done", task->done);
		pthread_mutex_unlock(&task->lock);
	}
	pthread_mutex_unlock(&t->lock);
	return json;
}

void tasks_get_stats(struct tasks *t, struct tasks_stats *out)
{
	pthread_mutex_lock(&t->lock);
	*out = t->stats;
	pthread_mutex_unlock(&t->lock);
}

static void init_look(pthread_cond_t *look)
{
	pthread_condattr_t attributes;

	pthread_condattr_init(&attributes);
	pthread_condattr_setclock(&attributes, CLOCK_MONOTONIC);
	pthread_cond_init(look, &attributes);
	pthread_condattr_destroy(&attributes);
}

static enum err start(struct tasks *t, size_t threads)
{
	t->threads = calloc(threads, sizeof *t->threads);
	if (t->threads == NULL)
		return ERR_MEMORY;
	for (; t->thread_count < threads; t->thread_count++) {
		if (pthread_create(&t->threads[t->thread_count], NULL,
		    thread_main, t) != 0)
			return ERR_IO;
	}
	t->has_watch = pthread_create(&t->watch, NULL, watch_main, t) == 0;
	return t->has_watch ? ERR_OK : ERR_IO;
}

enum err tasks_create(size_t threads, struct tasks **out)
{
	struct tasks *t = calloc(1, sizeof *t);
	enum err err;

	if (t == NULL)
		return ERR_MEMORY;
	pthread_mutex_init(&t->lock, NULL);
	pthread_cond_init(&t->work, NULL);
	init_look(&t->look);
	err = start(t, threads + 1);
	if (err != ERR_OK) {
		tasks_stop(t);
		tasks_free(t);
		return err;
	}
	*out = t;
	return ERR_OK;
}

void tasks_drain(struct tasks *t)
{
	pthread_mutex_lock(&t->lock);
	t->draining = true;
	pthread_mutex_unlock(&t->lock);
}

bool tasks_are_idle(struct tasks *t)
{
	bool idle;

	pthread_mutex_lock(&t->lock);
	idle = t->stats.waiting + t->stats.running == 0;
	pthread_mutex_unlock(&t->lock);
	return idle;
}

void tasks_stop(struct tasks *t)
{
	struct task *left;

	pthread_mutex_lock(&t->lock);
	t->draining = true;
	atomic_store(&t->stopping, true);
	pthread_cond_broadcast(&t->work);
	pthread_cond_broadcast(&t->look);
	pthread_mutex_unlock(&t->lock);
	while (t->thread_count > 0)
		pthread_join(t->threads[--t->thread_count], NULL);
	if (t->has_watch)
		pthread_join(t->watch, NULL);
	t->has_watch = false;
	pthread_mutex_lock(&t->lock);
	left = pick_vain(t); /* all of them, by now */
	pthread_mutex_unlock(&t->lock);
	end_all(left);
}

void tasks_free(struct tasks *t)
{
	if (t == NULL)
		return;
	pthread_cond_destroy(&t->look);
	pthread_cond_destroy(&t->work);
	pthread_mutex_destroy(&t->lock);
	free(t->threads);
	free(t);
}
