#include "tests/support/npy.h"

#include <setjmp.h>
#include <stdarg.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include <cmocka.h>

char *npy_file(const char *descr, const char *fortran_order,
    const char *shape, const void *data, size_t bytes, size_t *length)
{
	char *file = malloc(NPY_HEAD_MAX + bytes);
	size_t head;

	assert_non_null(file);
	head = (size_t)snprintf(file + 10, NPY_HEAD_MAX - 10, "{'descr': '%s', "
	    "'fortran_order': %s, 'shape': %s, }\n", descr, fortran_order,
	    shape);
	assert_true(head < NPY_HEAD_MAX - 10);
	memcpy(file, "\x93NUMPY\x01\x00", 8);
	file[8] = (char)(head & 255);
	file[9] = (char)(head >> 8);
	if (bytes > 0)
		memcpy(file + 10 + head, data, bytes);
	*length = 10 + head + bytes;
	return file;
}
