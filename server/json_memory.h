/*
 * Whether cJSON has had the memory it wanted: its functions that add to a tree
 * say so one by one, and a tree that lacks members still prints.
 */
#ifndef SERVER_JSON_MEMORY_H
#define SERVER_JSON_MEMORY_H

#include <stdbool.h>

/* Has cJSON's allocations looked after, before threads use it. */
void json_memory_watch(void);

/* Whether one of this thread has failed since the last call. */
bool json_memory_was_short(void);

#endif
