/*
 * Reference values: the files of tests/golden, float64, columns named in the first
 * line. Tests run from the top of the tree.
 */
#ifndef TESTS_SUPPORT_GOLDEN_H
#define TESTS_SUPPORT_GOLDEN_H

#define GOLDEN_COLUMNS_MAX 8

/*
 * Calls row for each line of tests/golden/<name>.csv with its numbers; returns
 * how many lines there were. Fails the running test if the file is missing or
 * a line has other than columns numbers.
 */
int golden_each(const char *name, int columns,
    void (*row)(void *ctx, const double *values), void *ctx);

#endif
