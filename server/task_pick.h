/*
 * Which nodes of a task's scene make its surface at points (core/pick.h). A
 * scene keeps no tree, so that its document is read once more for it.
 */
#ifndef SERVER_TASK_PICK_H
#define SERVER_TASK_PICK_H

#include "core/err.h"

struct task;
struct task_picks;

/* *out is the caller's, for task_picks_free. ERR_MEMORY; ERR_NOT_FOUND: the
 * document cannot be read any more. */
enum err task_picks_create(struct task *task, struct task_picks **out);

/* NULL does nothing. */
void task_picks_free(struct task_picks *picks);

/* The leaf at a point: its ordinal in *leaf, its JSON pointer, which lives as
 * long as picks, in *pointer. ERR_MEMORY. */
enum err task_pick(struct task_picks *picks, const float point[static 3],
    float *leaf, const char **pointer);

#endif
