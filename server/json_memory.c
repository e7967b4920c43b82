#include "server/json_memory.h"

#include <stdlib.h>

#include <cjson/cJSON.h>

static _Thread_local bool was_short;

static void *allocate(size_t size)
{
	void *p = malloc(size);

	if (p == NULL)
		was_short = true;
	return p;
}

void json_memory_watch(void)
{
	cJSON_InitHooks(&(cJSON_Hooks){.malloc_fn = allocate, .free_fn = free});
}

bool json_memory_was_short(void)
{
	bool was = was_short;

	was_short = false;
	return was;
}
