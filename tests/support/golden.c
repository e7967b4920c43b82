#include "tests/support/golden.h"

#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>

#include <cmocka.h>

int golden_each(const char *name, int columns,
    void (*row)(void *ctx, const double *values), void *ctx)
{
	double values[GOLDEN_COLUMNS_MAX];
	char path[128], line[512];
	int rows = 0;
	FILE *f;

	snprintf(path, sizeof(path), "tests/golden/%s.csv", name);
	f = fopen(path, "r");
	assert_non_null(f);
	assert_non_null(fgets(line, sizeof(line), f));
	while (fgets(line, sizeof(line), f)) {
		char *at = line, *end;

		for (int i = 0; i < columns; i++) {
			values[i] = strtod(at, &end);
			assert_ptr_not_equal(at, end);
			at = end + (*end == ',');
		}
		assert_int_equal(*at, '\n');
		row(ctx, values);
		rows++;
	}
	fclose(f);
	return rows;
}
