/*
 * A strict reader of Prometheus's text format 0.0.4, for tests.
 */
#ifndef TESTS_SUPPORT_EXPOSITION_H
#define TESTS_SUPPORT_EXPOSITION_H

#include <stddef.h>

struct exposition;

/*
 * Reads length bytes of text, which are copied; fails the running test, with the
 * line, unless: every family has one HELP, one TYPE and then, with no other
 * family between, its samples; counters' names end in _total and nothing else's
 * does; names and labels are well-formed, and escaped; no series comes twice; no
 * counter is negative; and each histogram's buckets rise, in their bounds and
 * their counts, to +Inf, which has what _count says. For exposition_free.
 */
struct exposition *exposition_read(const char *text, size_t length);
void exposition_free(struct exposition *e);

/* The value of a series, as it is written, name{label="value",…}; NaN if there is
 * none. */
double exposition_value(const struct exposition *e, const char *series);

/* How many series there are. */
size_t exposition_count(const struct exposition *e);

#endif
