/*
 * Makes the nth allocation fail, and counts what is not freed. Replaces malloc
 * and its like in every program it is linked into; until told otherwise they
 * only pass on to libc. Each thread has its own count, so that others' work
 * is left alone.
 */
#ifndef TESTS_SUPPORT_FAIL_ALLOC_H
#define TESTS_SUPPORT_FAIL_ALLOC_H

#include <stdbool.h>

/* False under a sanitizer, whose own allocator is in the way; says so for the
 * test, which is to skip itself. */
bool fail_alloc_available(void);

/* The nth allocation of this thread from now on fails, once (1: the next); 0:
 * none. Also begins the count of live ones anew. */
void fail_alloc_set(long n);

/* Whether that allocation has been asked for since. */
bool fail_alloc_happened(void);

/* This thread's allocations less its frees since fail_alloc_set. */
long fail_alloc_live(void);

#endif
