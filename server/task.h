/*
 * Work on a scene that takes many evaluations: meshes, pictures, rays. A small
 * pool of threads does it, one task a thread, while the exchange waits; the
 * device is asked through the scheduler, so that tasks take turns with
 * everybody's evaluations. Clients take turns, a task each: who has many that wait
 * keeps another one waiting for no more than one of them, besides those that run.
 *
 * Threads: work() runs on a thread of the pool, which must not touch the
 * exchange; answer() on the HTTP thread, once, after it; free() on whichever
 * lets go last, exactly once, whether or not work was ever called.
 *
 * What is large is best printed in work(), for answer() to hand over: HTTP's
 * threads serve others meanwhile.
 */
#ifndef SERVER_TASK_H
#define SERVER_TASK_H

#include <stdbool.h>
#include <stddef.h>

#include "core/err.h"
#include "core/sampler.h"

struct cJSON;
struct exchange;
struct scene;
struct server;
struct task;
struct tasks;

/* Tasks waiting at most. */
#define TASKS_WAITING 64

/* Those of one client (a token, or an address without one): the last quarter of
 * the places is for who has none. What is of this machine where there are no
 * tokens, which nobody tells apart, may have all. */
#define TASKS_WAITING_OF_ONE (TASKS_WAITING - TASKS_WAITING / 4)
#define TASK_TOKEN_MAX 64

/* Bytes that requests of tasks and their answers, until they have left, may
 * take together; but one alone always may. */
#define TASKS_HELD_MAX ((size_t)1 << 30)

struct task_kind {
	enum err (*work)(struct task *task, void *ctx);
	void (*answer)(struct exchange *x, void *ctx); /* of what succeeded */
	void (*free)(void *ctx);
	/* Bytes of memory that ctx has: of the request, before work(); of the
	 * answer, after it. NULL: hardly any. */
	size_t (*bytes)(const void *ctx);
	/* Whether ctx's request is of little work, for which somebody waits:
	 * such tasks have a thread of their own. NULL: never. */
	bool (*is_small)(const void *ctx);
};

struct tasks_stats {
	size_t waiting, running;
	unsigned long completed; /* ended in any way; of these: */
	unsigned long expired;   /* past their deadline */
	unsigned long abandoned; /* clients had gone */
	size_t held_bytes;       /* of requests and answers */
};

/* Starts threads (> 0) that do tasks, and one more for small ones alone.
 * ERR_MEMORY, ERR_IO. */
enum err tasks_create(size_t threads, struct tasks **out);

/* Refuses new ones. */
void tasks_drain(struct tasks *t);
bool tasks_are_idle(struct tasks *t);

/* Has what runs give up, answers what waits with ERR_CANCELLED, ends the
 * threads. Before the scheduler stops. */
void tasks_stop(struct tasks *t);

/* After tasks_stop, and once no exchange is left; NULL does nothing. */
void tasks_free(struct tasks *t);

void tasks_get_stats(struct tasks *t, struct tasks_stats *out);

/*
 * For a handler, whose body has been read and is released here: checks
 * ?deadline and ?progress, and has x wait for kind's work on scene (a
 * reference, taken over), or answers it; either way ctx is the task's now. ETag
 * is added to the answer, and Server-Timing.
 */
void task_begin(struct exchange *x, struct scene *scene,
    const struct task_kind *kind, void *ctx);

/*
 * For work(): the scene; a sampler of it; its tape's ranges (the first call
 * makes them; ERR_MEMORY); and a box about its surface f = iso (finite where
 * the surface is shown to end, though the support may not; infinite coordinates
 * where it is not; min > max where there is no surface).
 */
const struct scene *task_scene(const struct task *task);
struct server *task_server(const struct task *task);
struct sampler *task_sampler(struct task *task);
struct range_tape;
enum err task_ranges(struct task *task, const struct range_tape **out);
struct tape_box;
enum err task_extent(struct task *task, double iso, struct tape_box *out);

/* What the sampler is told of as done from 0 to 1 is, from here on, the task's
 * from `from` to `to`. */
void task_set_part(struct task *task, double from, double to);

/* For work() that ends with ERR_INVALID or ERR_LIMIT: why, at which place. */
void task_fault(struct task *task, const char *pointer, const char *detail,
    ...) __attribute__((format(printf, 3, 4)));

/* What the task called token is doing, for GET /v1/progress/{id}; of several of
 * that name the one that came last. NULL if there is none. */
struct cJSON *tasks_progress(struct tasks *t, const char *token);

#endif
