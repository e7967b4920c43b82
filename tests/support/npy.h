/*
 * Files in NumPy's .npy, for tests.
 */
#ifndef TESTS_SUPPORT_NPY_H
#define TESTS_SUPPORT_NPY_H

#include <stddef.h>

/* What may come before the numbers, at most. */
#define NPY_HEAD_MAX 192

/*
 * A file of format 1.0: descr ("<f4"), fortran_order ("False"), shape
 * ("(2, 3)") and bytes of data; its length to *length. For free.
 */
char *npy_file(const char *descr, const char *fortran_order,
    const char *shape, const void *data, size_t bytes, size_t *length);

#endif
