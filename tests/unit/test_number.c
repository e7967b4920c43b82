#include <stdarg.h>
#include <stddef.h>
#include <setjmp.h>
#include <stdint.h>
#include <cmocka.h>

#include <math.h>
#include <stdbool.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "proto/number.h"

#define COUNT(array) (sizeof(array) / sizeof *(array))

static uint64_t state = 88172645463325252u;

/* Marsaglia's xorshift, 2003 */
static uint64_t draw(void)
{
	state ^= state << 13;
	state ^= state >> 7;
	state ^= state << 17;
	return state;
}

static float float_of(uint32_t bits)
{
	float f;

	memcpy(&f, &bits, sizeof f);
	return f;
}

static size_t print(float f, char out[static 32])
{
	const size_t n = number_print_float(f, out);

	assert_in_range(n, 1, NUMBER_FLOAT_MAX);
	out[n] = '\0';
	return n;
}

static int parse(const char *text, double *out, size_t *at)
{
	const char *p = text;
	const int failed = number_parse(&p, text + strlen(text), out);

	*at = (size_t)(p - text);
	return failed;
}

static void check_value(const char *text, double expected)
{
	double value = -1.0;
	size_t at;

	if (parse(text, &value, &at))
		fail_msg("'%s' is refused at %zu", text, at);
	if (value != expected || signbit(value) != signbit(expected))
		fail_msg("'%s' is %.17g, not %.17g", text, value, expected);
	assert_int_equal(at, strlen(text));
}

static void test_parse_plain_numbers(void **unused)
{
	(void)unused;
	check_value("0", 0.0);
	check_value("-0", -0.0);
	check_value("7", 7.0);
	check_value("-12.5", -12.5);
	check_value("1e3", 1000.0);
	check_value("1E+3", 1000.0);
	check_value("25e-2", 0.25);
	check_value("0.000", 0.0);
	check_value("0e99999999999999999999", 0.0);
	check_value("123456789012345678", 123456789012345678.0);
}

static void test_parse_hard_cases(void **unused)
{
	(void)unused;
	/* Middles between doubles, and their neighbours. */
	check_value("9007199254740993", 9007199254740992.0);
	check_value("9007199254740993.0000000000000000000000001",
	    9007199254740994.0);
	check_value("9007199254740995", 9007199254740996.0);
	check_value("2.2250738585072011e-308", 2.2250738585072011e-308);
	check_value("2.2250738585072014e-308", 0x1p-1022);
	check_value("4.9e-324", 0x1p-1074);
	check_value("2.4703282292062327e-324", 0.0);
	check_value("2.4703282292062328e-324", 0x1p-1074);
	check_value("1.7976931348623157e308", 0x1.fffffffffffffp1023);
	check_value("1e999", HUGE_VAL);
	check_value("-1e999", -HUGE_VAL);
	check_value("1e999999999999999999999999", HUGE_VAL);
	check_value("1e-999999999999999999999999", 0.0);
	check_value("18446744073709551615e-27", 18446744073709551615e-27);
	check_value("9999999999999999999e27", 9999999999999999999e27);
}

static void test_parse_any_number_of_digits(void **unused)
{
	enum { ZEROS = 120000 };
	char *text = malloc(2 * ZEROS + 64);
	double value;
	size_t at;

	(void)unused;
	assert_non_null(text);
	memset(text, '0', ZEROS + 2);
	text[1] = '.';
	strcpy(text + ZEROS + 2, "15e120001");
	assert_int_equal(parse(text, &value, &at), 0);
	assert_true(value == 1.5);
	memset(text, '9', ZEROS);
	strcpy(text + ZEROS, "e-120000");
	assert_int_equal(parse(text, &value, &at), 0);
	assert_true(value == 1.0);
	/* A digit far behind decides a tie. */
	strcpy(text, "9007199254740993.");
	memset(text + 17, '0', 2000);
	strcpy(text + 2017, "1");
	assert_int_equal(parse(text, &value, &at), 0);
	assert_true(value == 9007199254740994.0);
	free(text);
}

static void test_parse_refuses_what_json_does_not_allow(void **unused)
{
	static const struct {
		const char *text;
		size_t at;
	} cases[] = {
		{"", 0}, {"+1", 0}, {"-", 1}, {".5", 0}, {"-.5", 1}, {"1.", 2},
		{"1.e5", 2}, {"1e", 2}, {"1e+", 3}, {"01", 1}, {"-00", 2},
		{"NaN", 0}, {"Infinity", 0}, {"-inf", 1}, {" 1", 0}, {"e5", 0},
	};
	double value;
	size_t i, at;

	(void)unused;
	for (i = 0; i < COUNT(cases); i++) {
		if (parse(cases[i].text, &value, &at) != -1 ||
		    at != cases[i].at)
			fail_msg("'%s' ends at %zu", cases[i].text, at);
	}
}

static void test_parse_stops_behind_the_number(void **unused)
{
	double value;
	size_t at;

	(void)unused;
	assert_int_equal(parse("0x10", &value, &at), 0);
	assert_int_equal(at, 1);
	assert_int_equal(parse("1.5,2", &value, &at), 0);
	assert_int_equal(at, 3);
	assert_int_equal(parse("1e5e5", &value, &at), 0);
	assert_int_equal(at, 3);
}

static void test_parse_never_reads_past_end(void **unused)
{
	static const char text[] = {'-', '1', '2', '.', '5', 'e', '+', '7'};
	const char *p;
	double value;
	size_t n;

	(void)unused;
	/* The sanitizer sees a byte too many. */
	for (n = 0; n <= sizeof text; n++) {
		char *copy = malloc(n ? n : 1);

		assert_non_null(copy);
		memcpy(copy, text, n);
		p = copy;
		if (number_parse(&p, copy + n, &value) == 0)
			assert_true(n == 2 || n == 3 || n == 5 || n == 8);
		assert_true(p <= copy + n);
		free(copy);
	}
}

/* One random number's text, of one of four kinds. */
static void random_text(char out[static 80])
{
	const uint64_t r = draw();
	const double unit = (double)(r >> 11) * 0x1p-52 - 1.0;
	double any;

	memcpy(&any, &r, sizeof any);
	switch (draw() % 4) {
	case 0:
		snprintf(out, 80, "%.17g", isfinite(any) ? any : 1.0);
		break;
	case 1:
		snprintf(out, 80, "%.17g", unit);
		break;
	case 2:
		snprintf(out, 80, "%.*e", (int)(draw() % 24),
		    unit * pow(10.0, (double)(draw() % 60) - 30.0));
		break;
	default:
		snprintf(out, 80, "%llu.%llue%d",
		    (unsigned long long)(r >> draw() % 64),
		    (unsigned long long)(draw() >> draw() % 64),
		    (int)(draw() % 80) - 40);
	}
}

static void test_parse_equals_strtod(void **unused)
{
	char text[80];
	int i;

	(void)unused;
	for (i = 0; i < 400000; i++) {
		random_text(text);
		check_value(text, strtod(text, NULL));
	}
}

static void test_print_known_numbers(void **unused)
{
	static const struct {
		float f;
		const char *text;
	} cases[] = {
		{0.0f, "0"}, {-0.0f, "0"}, {1.0f, "1"}, {-1.0f, "-1"},
		{0.1f, "0.1"}, {0.5f, "0.5"}, {100.0f, "100"},
		{3.4028235e38f, "3.4028235e38"}, {-1e-45f, "-1e-45"},
		{1.17549435e-38f, "1.1754944e-38"}, {1e-5f, "0.00001"},
		{9.9999e-6f, "9.9999e-6"}, {1.2345678e-5f, "0.000012345678"},
		{123456792.0f, "123456790"}, {999999936.0f, "999999940"},
		{1e9f, "1e9"}, {1.5e10f, "1.5e10"}, {16777216.0f, "16777216"},
		{8388608.5f, "8388608"}, {0.3f, "0.3"}, {33554432.0f, "33554432"},
		{-0.000012345679f, "-0.000012345679"}, {0x1p-149f, "1e-45"},
		{9.5367431640625e-7f, "9.536743e-7"},
	};
	char text[32];
	size_t i;

	(void)unused;
	for (i = 0; i < COUNT(cases); i++) {
		print(cases[i].f, text);
		assert_string_equal(text, cases[i].text);
	}
}

/* Fewest digits that %.Ne needs to read back. */
static int digits_needed(float f)
{
	char text[32];
	int n;

	for (n = 1; n < 9; n++) {
		snprintf(text, sizeof text, "%.*e", n - 1, (double)f);
		if (strtof(text, NULL) == f)
			break;
	}
	return n;
}

static int digits_printed(const char *text)
{
	const char *end = text + strcspn(text, "e");
	int n = 0, zeros = 0;

	for (; text < end; text++) {
		if (*text < '0' || *text > '9' || (!n && *text == '0'))
			continue;
		n++;
		zeros = *text == '0' ? zeros + 1 : 0;
	}
	return n - zeros;
}

static void check_round_trip(float f)
{
	char text[32];
	double back;
	size_t at;

	print(f, text);
	if (parse(text, &back, &at) || text[at] || (float)back != f ||
	    strtof(text, NULL) != f)
		fail_msg("%a prints as %s", (double)f, text);
}

static void test_print_every_exponent_reads_back(void **unused)
{
	uint32_t exponent, i;

	(void)unused;
	for (exponent = 0; exponent < 255; exponent++) {
		for (i = 0; i < 256; i++) {
			check_round_trip(float_of(exponent << 23 | i));
			check_round_trip(float_of(exponent << 23 |
			    (0x7fffffu - i)));
			check_round_trip(float_of((uint32_t)draw() << 31 |
			    exponent << 23 | (uint32_t)(draw() & 0x7fffff)));
		}
	}
}

static void test_print_is_shortest_and_nearest(void **unused)
{
	char text[32], nearest[32];
	uint32_t bits;
	float f;
	int i, n;

	(void)unused;
	for (i = 0; i < 1000000; i++) {
		bits = (uint32_t)draw();
		/* Half of them where most values lie, in [2^-10, 2^6). */
		if (i & 1)
			bits = (bits & 0x807fffffu) |
			    (117u + bits % 16) << 23;
		f = float_of(bits);
		if (!isfinite(f) || f == 0.0f)
			continue;
		print(f, text);
		n = digits_needed(f);
		if (strtof(text, NULL) != f || digits_printed(text) != n)
			fail_msg("%a prints as %s, not in %d digits",
			    (double)f, text, n);
		/* printf's is the nearest of that many digits; when it reads
		 * back, ours may be as near, but not further. */
		snprintf(nearest, sizeof nearest, "%.*e", n - 1, (double)f);
		if (fabsl(strtold(text, NULL) - (long double)f) >
		    fabsl(strtold(nearest, NULL) - (long double)f))
			fail_msg("%s is nearer than %s", nearest, text);
	}
}

int main(void)
{
	const struct CMUnitTest tests[] = {
		cmocka_unit_test(test_parse_plain_numbers),
		cmocka_unit_test(test_parse_hard_cases),
		cmocka_unit_test(test_parse_any_number_of_digits),
		cmocka_unit_test(test_parse_refuses_what_json_does_not_allow),
		cmocka_unit_test(test_parse_stops_behind_the_number),
		cmocka_unit_test(test_parse_never_reads_past_end),
		cmocka_unit_test(test_parse_equals_strtod),
		cmocka_unit_test(test_print_known_numbers),
		cmocka_unit_test(test_print_every_exponent_reads_back),
		cmocka_unit_test(test_print_is_shortest_and_nearest),
	};

	return cmocka_run_group_tests(tests, NULL, NULL);
}
