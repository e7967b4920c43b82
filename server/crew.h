/*
 * One task on every core.
 */
#ifndef SERVER_CREW_H
#define SERVER_CREW_H

#include <stdbool.h>
#include <stddef.h>

/*
 * Calls piece(ctx, i) once for each i below count, on all cores, the calling
 * thread included, whose priority the others inherit; each i that is begun is
 * finished. Begins no more once a call returned false. Returns whether all
 * returned true.
 */
bool crew_run(size_t count, bool (*piece)(void *ctx, size_t i), void *ctx);

#endif
