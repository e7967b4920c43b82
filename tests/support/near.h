/*
 * Comparison of float64 numbers (cmocka 1.1's own compares as float32).
 */
#ifndef TESTS_SUPPORT_NEAR_H
#define TESTS_SUPPORT_NEAR_H

/* Fails the running test, with both numbers in full digits, unless
 * |value - expected| <= tolerance; a NaN always fails. */
#define assert_near(value, expected, tolerance) \
	near_check((value), (expected), (tolerance), #value, __FILE__, __LINE__)

void near_check(double value, double expected, double tolerance,
    const char *name, const char *file, int line);

#endif
