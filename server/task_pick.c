#include "server/task_pick.h"

#include <stdint.h>
#include <stdlib.h>
#include <string.h>

#include "core/pick.h"
#include "proto/document.h"
#include "proto/fault.h"
#include "server/config.h"
#include "server/limits.h"
#include "server/scene_store.h"
#include "server/server.h"
#include "server/task.h"

/* Chains of leaves by their address. */
#define BUCKETS 1024

/* A leaf that was met. */
struct met {
	const struct node *node;
	float ordinal;
	char *pointer;
	struct met *next;
};

struct task_picks {
	struct document *document;
	struct picker *picker;
	struct met *buckets[BUCKETS];
};

enum err task_picks_create(struct task *task, struct task_picks **out)
{
	const struct scene *scene = task_scene(task);
	const struct document_limits limits = limits_kept(task_server(task));
	struct task_picks *picks = calloc(1, sizeof *picks);
	struct faults faults = {0};
	enum err err;

	if (picks == NULL)
		return ERR_MEMORY;
	err = document_parse(scene->text, scene->length, &limits,
	    &picks->document, &faults);
	if (err == ERR_OK)
		err = picker_create(document_tree(picks->document),
		    limits.max_nodes, &picks->picker);
	if (err == ERR_OK) {
		*out = picks;
		return ERR_OK;
	}
	task_picks_free(picks);
	return err == ERR_MEMORY ? err : ERR_NOT_FOUND;
}

void task_picks_free(struct task_picks *picks)
{
	if (picks == NULL)
		return;
	for (size_t i = 0; i < BUCKETS; i++) {
		struct met *next;

		for (struct met *m = picks->buckets[i]; m != NULL; m = next) {
			next = m->next;
			free(m->pointer);
			free(m);
		}
	}
	picker_free(picks->picker);
	document_free(picks->document);
	free(picks);
}

/* A leaf met for the first time; NULL: out of memory. */
static struct met *meet(struct task_picks *picks, const struct node *node)
{
	char pointer[PICK_POINTER_MAX];
	struct met *m = malloc(sizeof *m);

	if (m == NULL)
		return NULL;
	pick_pointer(node, pointer);
	m->node = node;
	m->ordinal = (float)pick_ordinal(document_tree(picks->document), node);
	m->pointer = strdup(pointer);
	m->next = NULL;
	if (m->pointer != NULL)
		return m;
	free(m);
	return NULL;
}

static struct met *find(struct task_picks *picks, const struct node *node)
{
	struct met **at = &picks->buckets[((uintptr_t)node >> 6) % BUCKETS];

	while (*at != NULL && (*at)->node != node)
		at = &(*at)->next;
	if (*at == NULL)
		*at = meet(picks, node);
	return *at;
}

enum err task_pick(struct task_picks *picks, const float point[static 3],
    float *leaf, const char **pointer)
{
	const struct node *node;
	const struct met *m;
	enum err err = picker_leaf(picks->picker, (struct vec3){point[0],
	    point[1], point[2]}, &node);

	if (err != ERR_OK)
		return err;
	m = find(picks, node);
	if (m == NULL)
		return ERR_MEMORY;
	*leaf = m->ordinal;
	*pointer = m->pointer;
	return ERR_OK;
}
