#include <stdarg.h>
#include <stddef.h>
#include <setjmp.h>
#include <stdint.h>
#include <cmocka.h>

#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "proto/fault.h"
#include "proto/points.h"
#include "tests/support/fail_alloc.h"

#define COUNT(array) (sizeof(array) / sizeof *(array))
#define MAX_POINTS 5

/* Scans a copy of text that ends where the text does, for the sanitizer. */
static enum err scan(const char *text, struct points *points, size_t *at,
    struct faults *faults)
{
	const size_t length = strlen(text);
	char *copy = malloc(length ? length : 1);
	const char *p = copy;
	enum err err;

	assert_non_null(copy);
	memcpy(copy, text, length);
	*faults = (struct faults){0};
	*points = (struct points){0};
	err = points_from_json(&p, copy + length, "/points", MAX_POINTS,
	    points, faults);
	*at = (size_t)(p - copy);
	free(copy);
	return err;
}

static void test_json_shapes(void **unused)
{
	static const struct {
		const char *text;
		size_t count;
		bool flat;
	} cases[] = {
		{"[]", 0, false}, {"[ ]", 0, false},
		{"[[1,2,3]]", 1, false}, {"[1,2,3]", 1, true},
		{"[[1,2,3],[4,5,6]]", 2, false}, {"[1,2,3,4,5,6]", 2, true},
		{" [ [ 1 , 2 , 3 ] ,\n\t[ 4e0 , 5.0 , 60E-1 ] ]", 2, false},
		{"\r\n[ 1 ,2, 3 , 4,5 ,6 ]", 2, true},
		{"[[1,2,3],[4,5,6],[7,8,9],[10,11,12],[13,14,15]]", 5, false},
	};
	struct points points;
	struct faults faults;
	size_t i, k, at;

	(void)unused;
	for (i = 0; i < COUNT(cases); i++) {
		assert_int_equal(scan(cases[i].text, &points, &at, &faults),
		    ERR_OK);
		assert_int_equal(at, strlen(cases[i].text));
		assert_int_equal(points.count, cases[i].count);
		assert_int_equal(points.flat, cases[i].flat);
		for (k = 0; k < 3 * points.count; k++)
			assert_true(points.xyz[k] == (float)(k + 1));
		points_fini(&points);
		assert_null(points.xyz);
	}
}

static void test_json_stops_behind_the_array(void **unused)
{
	struct points points;
	struct faults faults;
	size_t at;

	(void)unused;
	assert_int_equal(scan("[[1,2,3]] , 5", &points, &at, &faults), ERR_OK);
	assert_int_equal(at, 9);
	points_fini(&points);
}

static void test_json_numbers_are_the_nearest_floats(void **unused)
{
	struct points points;
	struct faults faults;
	size_t at;

	(void)unused;
	assert_int_equal(scan("[0.1,-1e-46,3.4028235e38]", &points, &at,
	    &faults), ERR_OK);
	assert_true(points.xyz[0] == 0.1f);
	assert_true(points.xyz[1] == 0.0f);
	assert_true(points.xyz[2] == 3.4028235e38f);
	points_fini(&points);
}

static const struct {
	const char *text;
	enum err err;
	const char *pointer, *words;
	size_t at;
} wrong[] = {
	{"", ERR_SYNTAX, "/points", "expected '[', but the text ends", 0},
	{"7", ERR_INVALID, "/points", "must be an array of points", 0},
	{"{}", ERR_INVALID, "/points", "must be an array of points", 0},
	{"null", ERR_INVALID, "/points", "must be an array of points", 0},
	{"]", ERR_SYNTAX, "/points", "expected '['", 0},
	{"[", ERR_SYNTAX, "/points", "expected a point or a number", 1},
	{"[,]", ERR_SYNTAX, "/points", "expected a point", 1},
	{"[\"a\"]", ERR_INVALID, "/points", "must hold points", 1},
	{"[[1,2,3]", ERR_SYNTAX, "/points", "expected ',' or ']'", 8},
	{"[[1,2,3],]", ERR_SYNTAX, "/points/1", "expected '['", 9},
	{"[[1,2,3] [", ERR_SYNTAX, "/points", "column 10", 9},
	{"[[]]", ERR_INVALID, "/points/0", "point 0 has fewer than 3", 3},
	{"[[1,2,3],[1,2]]", ERR_INVALID, "/points/1", "point 1 has fewer", 14},
	{"[[1,2,3,4]]", ERR_INVALID, "/points/0", "point 0 has more than 3", 8},
	{"[[1,2,3],4]", ERR_INVALID, "/points/1", "array of 3 numbers", 9},
	{"[1,2,[3]]", ERR_INVALID, "/points/2", "must be a number", 5},
	{"[[1,2,[3]]]", ERR_INVALID, "/points/0/2", "must be a number", 6},
	{"[[1,\"2\",3]]", ERR_INVALID, "/points/0/1", "must be a number", 4},
	{"[[1,null,3]]", ERR_INVALID, "/points/0/1", "must be a number", 4},
	{"[[1,NaN,3]]", ERR_SYNTAX, "/points/0/1", "expected a number", 4},
	{"[[1,Infinity,3]]", ERR_SYNTAX, "/points/0/1", "expected a number", 4},
	{"[[1,01,3]]", ERR_SYNTAX, "/points/0/1", "not a JSON number", 5},
	{"[[1,+1,3]]", ERR_SYNTAX, "/points/0/1", "expected a number", 4},
	{"[[1,2.,3]]", ERR_SYNTAX, "/points/0/1", "not a JSON number", 6},
	{"[[1,2 3]]", ERR_SYNTAX, "/points/0", "expected ',' or ']'", 6},
	{"[[1,2,3;", ERR_SYNTAX, "/points/0", "expected ',' or ']'", 7},
	{"[[1,2,3],[1,2,1e39]]", ERR_INVALID, "/points/1/2",
	    "point 1: z is not finite", 18},
	{"[[1e999,2,3]]", ERR_INVALID, "/points/0/0",
	    "point 0: x is not finite", 7},
	{"[1,2,3,4,-1e39,6]", ERR_INVALID, "/points/4",
	    "point 1: y is not finite", 14},
	{"[1,2,3,4]", ERR_INVALID, "/points", "multiple of 3, not 4", 9},
	{"[1,2]", ERR_INVALID, "/points", "multiple of 3, not 2", 5},
	{"[1,2,3,]", ERR_SYNTAX, "/points/3", "expected a number", 7},
	{"[1,2,3,4,5,6,7,8,9,1,2,3,4,5,6,7", ERR_LIMIT, "/points",
	    "more than 5 points", 31},
	{"[[1,2,3],[1,2,3],[1,2,3],[1,2,3],[1,2,3],[", ERR_LIMIT, "/points",
	    "more than 5 points", 42},
	{"[\n[1,2,3],\n[4,x", ERR_SYNTAX, "/points/1/1", "line 3, column 4", 14},
};

static void test_json_is_refused_where_it_is_wrong(void **unused)
{
	struct points points;
	struct faults faults;
	enum err err;
	size_t i, at;

	(void)unused;
	for (i = 0; i < COUNT(wrong); i++) {
		err = scan(wrong[i].text, &points, &at, &faults);
		if (err != wrong[i].err || at != wrong[i].at ||
		    faults.count != 1 || points.xyz ||
		    strcmp(faults.list[0].pointer, wrong[i].pointer) != 0 ||
		    !strstr(faults.list[0].detail, wrong[i].words))
			fail_msg("%s: %s at %zu, %s: %s", wrong[i].text,
			    err_message(err), at, faults.list[0].pointer,
			    faults.list[0].detail);
	}
}

/* n points as JSON, each [i, i, i] + 0.5. */
static char *many(size_t n)
{
	char *text = malloc(n * 40 + 8), *p;
	size_t i;

	assert_non_null(text);
	p = text;
	*p++ = '[';
	for (i = 0; i < n; i++)
		p += sprintf(p, "%s[%zu.5,%zu.5,%zu.5]", i ? "," : "", i, i,
		    i);
	strcpy(p, "]");
	return text;
}

static void test_json_grows_to_any_size(void **unused)
{
	enum { N = 30000 };
	char *text = many(N);
	const char *p = text;
	struct faults faults = {0};
	struct points points = {0};
	size_t i;

	(void)unused;
	assert_int_equal(points_from_json(&p, text + strlen(text), "", N,
	    &points, &faults), ERR_OK);
	assert_int_equal(points.count, N);
	for (i = 0; i < 3 * N; i++)
		assert_true(points.xyz[i] == (float)(i / 3) + 0.5f);
	points_fini(&points);
	free(text);
}

static void test_json_allocations_may_fail(void **unused)
{
	char *text = many(5000);
	struct faults faults = {0};
	struct points points = {0};
	const char *p;
	enum err err;
	long n;

	(void)unused;
	if (!fail_alloc_available()) {
		free(text);
		skip();
	}
	for (n = 1;; n++) {
		p = text;
		fail_alloc_set(n);
		err = points_from_json(&p, text + strlen(text), "", 5000,
		    &points, &faults);
		if (!fail_alloc_happened())
			break;
		/* Shrinking may fail; then the points stay as they are. */
		if (err == ERR_OK)
			points_fini(&points);
		else
			assert_int_equal(err, ERR_MEMORY);
		assert_int_equal(fail_alloc_live(), 0);
	}
	assert_int_equal(err, ERR_OK);
	points_fini(&points);
	assert_int_equal(fail_alloc_live(), 0);
	fail_alloc_set(0);
	assert_true(n > 1);
	free(text);
}

static void test_octets(void **unused)
{
	static const unsigned char data[] = {0, 0, 0x80, 0x3f, 0, 0, 0, 0xc0,
	    0, 0, 0, 0x3f, 0, 0, 0, 0, 0, 0, 0, 0x80, 1, 0, 0, 0};
	struct faults faults = {0};
	struct points points;

	(void)unused;
	assert_int_equal(points_from_octets(data, sizeof data, 2, &points,
	    &faults), ERR_OK);
	assert_int_equal(points.count, 2);
	assert_false(points.flat);
	assert_true(points.xyz[0] == 1.0f && points.xyz[1] == -2.0f);
	assert_true(points.xyz[2] == 0.5f && points.xyz[5] == 0x1p-149f);
	points_fini(&points);
	assert_int_equal(points_from_octets(data, 0, 2, &points, &faults),
	    ERR_OK);
	assert_int_equal(points.count, 0);
	assert_null(points.xyz);
	assert_int_equal(points_from_octets(data, 13, 2, &points, &faults),
	    ERR_SYNTAX);
	assert_string_equal(faults.list[0].detail,
	    "13 bytes are no whole number of points of 12 bytes each");
	assert_int_equal(points_from_octets(data, 24, 1, &points, &faults),
	    ERR_LIMIT);
	assert_string_equal(faults.list[1].detail, "more than 1 points");
}

static void test_octets_that_are_not_finite(void **unused)
{
	const float values[9] = {0, 0, 0, 0, 0, NAN, -INFINITY, 0, 0};
	struct faults faults = {0};
	struct points points = {0};

	(void)unused;
	assert_int_equal(points_from_octets(values, sizeof values, 9, &points,
	    &faults), ERR_INVALID);
	assert_null(points.xyz);
	assert_int_equal(faults.count, 2);
	assert_string_equal(faults.list[0].detail,
	    "point 1: z is not finite as float32");
	assert_string_equal(faults.list[1].detail,
	    "point 2: x is not finite as float32");
}

/* An npy file: version, header, then bytes of data. */
static size_t make_npy(int version, const char *header, const void *data,
    size_t bytes, char out[static 1024])
{
	const size_t length = strlen(header);
	size_t n = 0;

	memcpy(out, "\x93NUMPY", 6);
	out[6] = (char)version;
	out[7] = 0;
	out[8] = (char)(length & 0xff);
	out[9] = (char)(length >> 8);
	n = 10;
	if (version > 1) {
		out[10] = out[11] = 0;
		n = 12;
	}
	memcpy(out + n, header, length);
	memcpy(out + n + length, data, bytes);
	return n + length + bytes;
}

#define HEADER(descr, order, shape) \
	"{'descr': " descr ", 'fortran_order': " order ", 'shape': " shape ", }"

static const float two[6] = {1, 2, 3, 4, 5, 6};

static enum err read_npy(int version, const char *header, const void *data,
    size_t bytes, struct points *points, struct faults *faults)
{
	char file[1024], *copy;
	const size_t n = make_npy(version, header, data, bytes, file);
	enum err err;

	copy = malloc(n);
	assert_non_null(copy);
	memcpy(copy, file, n);
	*points = (struct points){0};
	*faults = (struct faults){0};
	err = points_from_npy(copy, n, MAX_POINTS, points, faults);
	free(copy);
	return err;
}

static void check_two(const struct points *points)
{
	size_t i;

	assert_int_equal(points->count, 2);
	assert_false(points->flat);
	for (i = 0; i < 6; i++)
		assert_true(points->xyz[i] == two[i]);
}

static void test_npy_versions_and_spellings(void **unused)
{
	static const char *const headers[] = {
		HEADER("'<f4'", "False", "(2, 3)"),
		HEADER("'<f4'", "False", "(2, 3)") "                     \n",
		"{\"shape\":(2,3),\"fortran_order\":False,\"descr\":\"<f4\"}",
		" {'shape' : ( 2 , 3 , ) , 'descr':'<f4','fortran_order':\tFalse}\n",
	};
	struct points points;
	struct faults faults;
	size_t i;
	int version;

	(void)unused;
	for (version = 1; version <= 3; version++) {
		for (i = 0; i < COUNT(headers); i++) {
			assert_int_equal(read_npy(version, headers[i], two,
			    sizeof two, &points, &faults), ERR_OK);
			check_two(&points);
			points_fini(&points);
		}
	}
}

static void test_npy_doubles(void **unused)
{
	const double good[6] = {1, 2, 3, 4, 5, 6};
	const double large[3] = {1, 1e39, 3};
	struct points points;
	struct faults faults;

	(void)unused;
	assert_int_equal(read_npy(1, HEADER("'<f8'", "False", "(2, 3)"), good,
	    sizeof good, &points, &faults), ERR_OK);
	check_two(&points);
	points_fini(&points);
	assert_int_equal(read_npy(1, HEADER("'<f8'", "False", "(1, 3)"), large,
	    sizeof large, &points, &faults), ERR_INVALID);
	assert_string_equal(faults.list[0].detail,
	    "point 0: y is not finite as float32");
}

static void test_npy_empty(void **unused)
{
	struct points points;
	struct faults faults;

	(void)unused;
	assert_int_equal(read_npy(1, HEADER("'<f4'", "False", "(0, 3)"), two, 0,
	    &points, &faults), ERR_OK);
	assert_int_equal(points.count, 0);
	assert_null(points.xyz);
}

static const struct {
	int version;
	const char *header;
	size_t bytes;
	enum err err;
	const char *words;
} bad_npy[] = {
	{1, HEADER("'>f4'", "False", "(2, 3)"), 24, ERR_INVALID, "descr"},
	{1, HEADER("'<i4'", "False", "(2, 3)"), 24, ERR_INVALID, "descr"},
	{1, HEADER("'|O'", "False", "(2, 3)"), 24, ERR_INVALID, "descr"},
	{1, HEADER("'<f4'", "True", "(2, 3)"), 24, ERR_INVALID, "fortran"},
	{1, HEADER("'<f4'", "False", "(6,)"), 24, ERR_INVALID, "(N, 3)"},
	{1, HEADER("'<f4'", "False", "()"), 4, ERR_INVALID, "(N, 3)"},
	{1, HEADER("'<f4'", "False", "(3,)"), 12, ERR_INVALID, "(N, 3)"},
	{1, HEADER("'<f4'", "False", "(3, 2)"), 24, ERR_INVALID, "(N, 3)"},
	{1, HEADER("'<f4'", "False", "(1, 2, 3)"), 24, ERR_INVALID, "(N, 3)"},
	{1, HEADER("'<f4'", "False", "(2, 3, 1)"), 24, ERR_INVALID, "(N, 3)"},
	{1, HEADER("'<f4'", "False", "(6, 3)"), 24, ERR_LIMIT, "more than 5"},
	{1, HEADER("'<f4'", "False", "(2, 3)"), 23, ERR_SYNTAX, "23 bytes"},
	{1, HEADER("'<f4'", "False", "(1, 3)"), 24, ERR_SYNTAX, "1 points"},
	{1, HEADER("'<f8'", "False", "(2, 3)"), 24, ERR_SYNTAX, "24 bytes"},
	{1, HEADER("'<f4'", "Maybe", "(2, 3)"), 24, ERR_SYNTAX, "header"},
	{1, HEADER("[('x', '<f4')]", "False", "(2, 3)"), 24, ERR_SYNTAX,
	    "header"},
	{1, HEADER("'<f4'", "False", "(-2, 3)"), 24, ERR_SYNTAX, "header"},
	{1, HEADER("'<f4'", "False", "(99999999999999999999999, 3)"), 24,
	    ERR_SYNTAX, "header"},
	{1, HEADER("'<f4'", "False", "(6148914691236517206, 3)"), 24, ERR_LIMIT,
	    "more than"},
	{1, "{'descr': '<f4', 'shape': (2, 3)}", 24, ERR_SYNTAX, "header"},
	{1, "{'descr': '<f4', 'fortran_order': False, 'shape': (2, 3)", 24,
	    ERR_SYNTAX, "header"},
	{1, "{'descr': '<f4", 0, ERR_SYNTAX, "header"},
	{1, "{'a': 1}", 0, ERR_SYNTAX, "header"},
	{1, "", 0, ERR_SYNTAX, "header"},
	{1, HEADER("'<f4'", "False", "(2, 3)") "x", 24, ERR_SYNTAX, "header"},
	{0, HEADER("'<f4'", "False", "(2, 3)"), 24, ERR_SYNTAX, "not an npy"},
	{4, HEADER("'<f4'", "False", "(2, 3)"), 24, ERR_SYNTAX, "not an npy"},
};

static void test_npy_is_refused(void **unused)
{
	struct points points;
	struct faults faults;
	enum err err;
	size_t i;

	(void)unused;
	for (i = 0; i < COUNT(bad_npy); i++) {
		err = read_npy(bad_npy[i].version, bad_npy[i].header, two,
		    bad_npy[i].bytes, &points, &faults);
		if (err != bad_npy[i].err || faults.count != 1 ||
		    !strstr(faults.list[0].detail, bad_npy[i].words))
			fail_msg("%s: %s, %s", bad_npy[i].header,
			    err_message(err), faults.list[0].detail);
	}
}

static void test_npy_cut_anywhere_is_refused(void **unused)
{
	char file[1024], *copy;
	const size_t length = make_npy(2, HEADER("'<f4'", "False", "(2, 3)"),
	    two, sizeof two, file);
	struct points points;
	struct faults faults = {0};
	size_t n;

	(void)unused;
	for (n = 0; n < length; n++) {
		copy = malloc(n ? n : 1);
		assert_non_null(copy);
		memcpy(copy, file, n);
		assert_int_equal(points_from_npy(copy, n, MAX_POINTS, &points,
		    &faults), ERR_SYNTAX);
		free(copy);
	}
	assert_int_equal(points_from_npy(file, length + 1, MAX_POINTS, &points,
	    &faults), ERR_SYNTAX);
}

int main(void)
{
	const struct CMUnitTest tests[] = {
		cmocka_unit_test(test_json_shapes),
		cmocka_unit_test(test_json_stops_behind_the_array),
		cmocka_unit_test(test_json_numbers_are_the_nearest_floats),
		cmocka_unit_test(test_json_is_refused_where_it_is_wrong),
		cmocka_unit_test(test_json_grows_to_any_size),
		cmocka_unit_test(test_json_allocations_may_fail),
		cmocka_unit_test(test_octets),
		cmocka_unit_test(test_octets_that_are_not_finite),
		cmocka_unit_test(test_npy_versions_and_spellings),
		cmocka_unit_test(test_npy_doubles),
		cmocka_unit_test(test_npy_empty),
		cmocka_unit_test(test_npy_is_refused),
		cmocka_unit_test(test_npy_cut_anywhere_is_refused),
	};

	return cmocka_run_group_tests(tests, NULL, NULL);
}
