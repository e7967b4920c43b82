/*
 * Temporary folders for tests, in $TMPDIR or /tmp.
 */
#ifndef TESTS_SUPPORT_FOLDER_H
#define TESTS_SUPPORT_FOLDER_H

#include <limits.h>

/* Makes an empty one, of mode 0700; fails the running test if it cannot. */
void folder_make(char path[static PATH_MAX]);

/* Removes it with all that is in it. */
void folder_remove(const char *path);

/* Calls each for every file in it; how many there are. each may be NULL. */
int folder_each(const char *path, void (*each)(void *ctx, const char *file),
    void *ctx);

/* How many of its files have names that begin so. */
int folder_count(const char *path, const char *prefix);

/* The path of the first one whose name begins so; fails if there is none. */
void folder_find(const char *path, const char *prefix,
    char file[static PATH_MAX]);

#endif
