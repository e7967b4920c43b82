/*
 * Operator tables kept in a cache folder (kernels/cache_file.h) from one start
 * to the next, with what is known of them. A table's key is all that
 * table_build looks at, TABLE_VERSION and the forms of numbers; one that is
 * read is verified besides (table_verify).
 *
 * Threads: functions are safe from any thread.
 */
#ifndef SERVER_TABLE_CACHE_H
#define SERVER_TABLE_CACHE_H

#include <stdbool.h>
#include <stddef.h>

#include "core/err.h"
#include "core/table.h"

struct table_cache;

/* What is known of a table. */
struct table_figures {
	double build_seconds;
	bool is_measured;
	struct table_error error; /* if it is */
};

/* A cache in an existing folder, of most bytes or less; is_read_only: which is
 * never written, so that what is stored is not. ERR_MEMORY. */
enum err table_cache_create(const char *folder, size_t most,
    bool is_read_only, struct table_cache **out);

/* NULL does nothing. */
void table_cache_free(struct table_cache *c);

/*
 * The table of op, if it is there; figures without is_measured if it has not
 * been measured. ERR_NOT_FOUND, also if it is damaged, which the log then says.
 */
enum err table_cache_load(struct table_cache *c, const struct operator *op,
    struct table **out, struct table_figures *figures);

/*
 * Writes table and what is known of it; removes what was used longest ago to
 * hold the limit. Takes 10 ms or much longer, as the disk does. What goes wrong
 * is logged the first time.
 */
void table_cache_store(struct table_cache *c, const struct table *table,
    const struct table_figures *figures);

/* Only what is known of it. */
void table_cache_store_figures(struct table_cache *c,
    const struct operator *op, const struct table_figures *figures);

/* Counts op's table as used just now, if it is there. */
void table_cache_touch(struct table_cache *c, const struct operator *op);

#endif
