#include "tests/support/near.h"

#include <math.h>
#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>

#include <cmocka.h>

void near_check(double value, double expected, double tolerance,
    const char *name, const char *file, int line)
{
	if (fabs(value - expected) <= tolerance)
		return;
	print_error("%s = %.17g, not %.17g: off by %.3g, over %.3g\n", name,
	    value, expected, fabs(value - expected), tolerance);
	_fail(file, line);
}
