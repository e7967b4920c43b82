#include "tests/support/fail_alloc.h"

#include <errno.h>
#include <stddef.h>
#include <stdio.h>
#include <stdlib.h>

#include "tests/support/sanitized.h"

static _Thread_local long due; /* allocations until the failing one */
static _Thread_local long live;
static _Thread_local bool happened;

void fail_alloc_set(long n)
{
	due = n;
	live = 0;
	happened = false;
}

bool fail_alloc_happened(void)
{
	return happened;
}

long fail_alloc_live(void)
{
	return live;
}

#if SANITIZED || !defined(__GLIBC__)

bool fail_alloc_available(void)
{
	printf("skipped: no allocation can be made to fail in this build\n");
	return false;
}

#else

/* glibc's own allocator, under names that cannot be replaced. */
void *__libc_malloc(size_t size);
void *__libc_calloc(size_t count, size_t size);
void *__libc_realloc(void *old, size_t size);
void __libc_free(void *p);

bool fail_alloc_available(void)
{
	return true;
}

static bool fails_now(void)
{
	if (due == 0 || --due > 0)
		return false;
	happened = true;
	errno = ENOMEM;
	return true;
}

static void *counted(void *p)
{
	if (p)
		live++;
	return p;
}

void *malloc(size_t size)
{
	return fails_now() ? NULL : counted(__libc_malloc(size));
}

void *calloc(size_t count, size_t size)
{
	return fails_now() ? NULL : counted(__libc_calloc(count, size));
}

void *realloc(void *old, size_t size)
{
	if (fails_now())
		return NULL;
	if (!old)
		return counted(__libc_realloc(NULL, size));
	return __libc_realloc(old, size);
}

void free(void *p)
{
	if (p)
		live--;
	__libc_free(p);
}

#endif
