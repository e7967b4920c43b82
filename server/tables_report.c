/*
 * What tables there are, for people.
 */
#include "server/tables_internal.h"

#include <stdlib.h>

struct table_report tables_report_entry(const struct table_entry *entry)
{
	return (struct table_report){
		.number = entry->number,
		.family = entry->key.family,
		.profile = entry->key.profile,
		.layout = entry->key.layout,
		.resolution = entry->key.resolution,
		.draft = entry->is_draft,
		.state = entry->state,
		.bytes = entry->bytes,
		.build_seconds = entry->build_seconds,
		.measured = entry->measured && entry->error.count > 0,
		.error = entry->error,
	};
}

/* Reports every entry to out (NULL: none); how many there are. Locked. */
static size_t report_all(const struct tables *t, struct table_report *out)
{
	size_t n = 0;

	for (size_t i = 0; i < BUCKET_COUNT; i++) {
		for (const struct table_entry *e = t->buckets[i]; e != NULL;
		    e = e->chain, n++) {
			if (out != NULL)
				out[n] = tables_report_entry(e);
		}
	}
	return n;
}

static int compare_reports(const void *a, const void *b)
{
	const struct table_report *x = a, *y = b;

	return x->number < y->number ? -1 : x->number > y->number;
}

enum err tables_report(struct tables *t, struct table_report **out,
    size_t *count)
{
	struct table_report *list;
	size_t n;

	pthread_mutex_lock(&t->lock);
	n = report_all(t, NULL);
	list = malloc(sizeof *list * (n > 0 ? n : 1));
	if (list != NULL)
		report_all(t, list);
	pthread_mutex_unlock(&t->lock);
	if (list == NULL)
		return ERR_MEMORY;
	qsort(list, n, sizeof *list, compare_reports);
	*out = list;
	*count = n;
	return ERR_OK;
}
