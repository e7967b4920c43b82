#include <stdarg.h>
#include <stddef.h>
#include <setjmp.h>
#include <stdint.h>
#include <cmocka.h>

#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include <cjson/cJSON.h>

#include "core/output.h"
#include "proto/answer.h"
#include "proto/fault.h"
#include "proto/points.h"
#include "tests/support/fail_alloc.h"

static const float rows[20] = {
	0.5f, 1, -2, 0.25f, 1, 2, 3, 4, 5, 6,
	0.1f, 0, -0.0f, 1e-7f, -1, -2, -3, -4, -5, -6,
};

static void check_json(size_t count, unsigned outputs, unsigned flags,
    const char *expected)
{
	size_t length;
	char *text;

	assert_int_equal(answer_json(rows, count, outputs, flags, &text,
	    &length), ERR_OK);
	assert_int_equal(length, strlen(expected));
	assert_memory_equal(text, expected, length);
	free(text);
}

static void test_json_nested(void **unused)
{
	(void)unused;
	check_json(2, OUTPUT_VALUE | OUTPUT_GRADIENT | OUTPUT_HESSIAN, 0,
	    "{\"count\":2,\"value\":[0.5,0.1],"
	    "\"gradient\":[[1,-2,0.25],[0,0,1e-7]],"
	    "\"hessian\":[[1,2,3,4,5,6],[-1,-2,-3,-4,-5,-6]]}");
}

static void test_json_flat(void **unused)
{
	(void)unused;
	check_json(2, OUTPUT_VALUE | OUTPUT_GRADIENT | OUTPUT_HESSIAN,
	    ANSWER_FLAT,
	    "{\"count\":2,\"value\":[0.5,0.1],"
	    "\"gradient\":[1,-2,0.25,0,0,1e-7],"
	    "\"hessian\":[1,2,3,4,5,6,-1,-2,-3,-4,-5,-6]}");
}

static void test_json_says_that_it_is_a_draft(void **unused)
{
	(void)unused;
	check_json(2, OUTPUT_VALUE, ANSWER_DRAFT,
	    "{\"count\":2,\"draft\":true,\"value\":[0.5,1]}");
}

static void test_json_of_one_output(void **unused)
{
	(void)unused;
	check_json(3, OUTPUT_VALUE, 0,
	    "{\"count\":3,\"value\":[0.5,1,-2]}");
	check_json(2, OUTPUT_GRADIENT, 0,
	    "{\"count\":2,\"gradient\":[[0.5,1,-2],[0.25,1,2]]}");
}

static void test_json_of_no_points(void **unused)
{
	static const char expected[] =
	    "{\"count\":0,\"value\":[],\"gradient\":[]}";
	size_t length;
	char *text;

	(void)unused;
	assert_int_equal(answer_json(NULL, 0, OUTPUT_VALUE | OUTPUT_GRADIENT,
	    0, &text, &length), ERR_OK);
	assert_int_equal(length, sizeof expected - 1);
	assert_memory_equal(text, expected, length);
	free(text);
}

static void test_json_of_the_longest_numbers_fits(void **unused)
{
	enum { N = 1000 };
	float *longest = malloc(N * 10 * sizeof *longest);
	size_t length;
	char *text;
	int i;

	(void)unused;
	assert_non_null(longest);
	for (i = 0; i < N * 10; i++)
		longest[i] = -1.00000016e-5f;
	assert_int_equal(answer_json(longest, N, OUTPUT_VALUE |
	    OUTPUT_GRADIENT | OUTPUT_HESSIAN, 0, &text, &length), ERR_OK);
	assert_true(length > (size_t)N * 10 * 15);
	assert_int_equal(text[length - 1], '}');
	free(text);
	free(longest);
}

static void test_json_too_large_is_out_of_memory(void **unused)
{
	size_t length;
	char *text;

	(void)unused;
	assert_int_equal(answer_json(rows, SIZE_MAX / 20, OUTPUT_VALUE, 0,
	    &text, &length), ERR_MEMORY);
}

static void test_npy_header(void **unused)
{
	static const char expected[] = "\x93NUMPY\x01\x00\x76\x00{'descr': "
	    "'<f4', 'fortran_order': False, 'shape': (12, 4), }";
	char header[ANSWER_NPY_HEADER_MAX];
	size_t length, i;

	(void)unused;
	length = answer_npy_header(12, 4, header);
	assert_int_equal(length, 128);
	assert_memory_equal(header, expected, sizeof expected - 1);
	for (i = sizeof expected - 1; i < 127; i++)
		assert_int_equal(header[i], ' ');
	assert_int_equal(header[127], '\n');
	assert_int_equal(answer_npy_header(SIZE_MAX, 10, header), 128);
}

static void test_json_of_a_grid_has_its_counts(void **unused)
{
	static const size_t counts[] = {2, 1, 1};
	static const char expected[] = "{\"count\":2,\"draft\":true,"
	    "\"counts\":[2,1,1],\"gradient\":[0.5,1,-2,0.25,1,2]}";
	size_t length;
	char *text;

	(void)unused;
	assert_int_equal(answer_grid_json(rows, counts, OUTPUT_GRADIENT,
	    ANSWER_FLAT | ANSWER_DRAFT, &text, &length), ERR_OK);
	assert_int_equal(length, sizeof expected - 1);
	assert_memory_equal(text, expected, length);
	free(text);
}

static void check_grid_header(const size_t counts[3], int columns,
    const char *shape)
{
	char header[ANSWER_NPY_HEADER_MAX], expected[128];

	snprintf(expected, sizeof expected, "{'descr': '<f4', "
	    "'fortran_order': False, 'shape': %s, }", shape);
	assert_int_equal(answer_grid_npy_header(counts, columns, header), 128);
	assert_memory_equal(header + 10, expected, strlen(expected));
	assert_int_equal(header[127], '\n');
}

static void test_npy_header_of_a_grid(void **unused)
{
	static const size_t counts[] = {3, 1, 2};
	static const size_t most[] = {100000000, 100000000, 100000000};

	(void)unused;
	check_grid_header(counts, 1, "(3, 1, 2)");
	check_grid_header(counts, 4, "(3, 1, 2, 4)");
	check_grid_header(most, 18, "(100000000, 100000000, 100000000, 18)");
}

static void test_npy_header_is_read_back(void **unused)
{
	char file[ANSWER_NPY_HEADER_MAX + 24];
	const float xyz[6] = {1, 2, 3, 4, 5, 6};
	struct points points = {0};
	struct faults faults = {0};
	size_t n = answer_npy_header(2, 3, file);

	(void)unused;
	memcpy(file + n, xyz, sizeof xyz);
	assert_int_equal(points_from_npy(file, n + sizeof xyz, 2, &points,
	    &faults), ERR_OK);
	assert_int_equal(points.count, 2);
	assert_true(points.xyz[5] == 6);
	points_fini(&points);
}

static void check_problem(const char *detail, const struct faults *faults,
    const char *expected)
{
	size_t length;
	char *text = answer_problem(422, "document", "Wrong document", detail,
	    faults, &length);

	assert_non_null(text);
	assert_int_equal(length, strlen(expected));
	assert_string_equal(text, expected);
	free(text);
}

static void test_problems(void **unused)
{
	struct faults faults = {0};

	(void)unused;
	check_problem("why", NULL, "{\"type\":\"/problems/document\","
	    "\"title\":\"Wrong document\",\"status\":422,\"detail\":\"why\"}");
	check_problem(NULL, &faults, "{\"type\":\"/problems/document\","
	    "\"title\":\"Wrong document\",\"status\":422}");
	faults_add(&faults, "/a", "is %d", 7);
	faults_add(&faults, "", "a \"quote\"\n\xff\\");
	check_problem("bad \xc3 \x01", &faults,
	    "{\"type\":\"/problems/document\","
	    "\"title\":\"Wrong document\",\"status\":422,"
	    "\"detail\":\"bad ? ?\",\"errors\":["
	    "{\"pointer\":\"/a\",\"detail\":\"is 7\"},"
	    "{\"pointer\":\"\",\"detail\":\"a \\\"quote\\\"??\\\\\"}]}");
}

static void test_problems_count_the_faults_left_out(void **unused)
{
	struct faults faults = {0};
	size_t length;
	char *text;
	cJSON *json;
	int i;

	(void)unused;
	for (i = 0; i < FAULT_MAX + 3; i++)
		faults_add(&faults, "/x", "fault %d", i);
	text = answer_problem(400, "s", "t", "d", &faults, &length);
	assert_non_null(text);
	json = cJSON_Parse(text);
	assert_int_equal(cJSON_GetArraySize(cJSON_GetObjectItem(json,
	    "errors")), FAULT_MAX);
	assert_int_equal(cJSON_GetObjectItem(json, "error_count")->valueint,
	    FAULT_MAX + 3);
	cJSON_Delete(json);
	free(text);
}

static void test_faults_are_bounded_and_clean(void **unused)
{
	struct faults faults = {0};
	char text[3 * 600 + 1];
	size_t i;

	(void)unused;
	for (i = 0; i + 1 < sizeof text; i++)
		text[i] = "\xe2\x82\xac"[i % 3];
	text[i] = '\0';
	faults_add(&faults, text, "%s", text);
	/* Whole characters, cut in the middle and at the end. */
	assert_in_range(strlen(faults.list[0].pointer), FAULT_POINTER_MAX - 6,
	    FAULT_POINTER_MAX - 1);
	assert_null(strchr(faults.list[0].pointer, '?'));
	assert_non_null(strstr(faults.list[0].pointer,
	    "\xe2\x82\xac...\xe2\x82\xac"));
	assert_in_range(strlen(faults.list[0].detail), FAULT_DETAIL_MAX - 6,
	    FAULT_DETAIL_MAX - 1);
	assert_null(strchr(faults.list[0].detail, '?'));
	assert_string_equal(faults.list[0].detail +
	    strlen(faults.list[0].detail) - 6, "\xe2\x82\xac...");
}

static void test_every_allocation_may_fail(void **unused)
{
	struct faults faults = {0};
	size_t length;
	char *text;
	long n;

	(void)unused;
	if (!fail_alloc_available())
		skip();
	faults_add(&faults, "/a", "b");
	for (n = 1;; n++) {
		fail_alloc_set(n);
		text = answer_problem(400, "s", "t", "d", &faults, &length);
		if (!fail_alloc_happened())
			break;
		/* Shrinking the text may fail; then it stays as it is. */
		free(text);
		assert_int_equal(fail_alloc_live(), 0);
	}
	free(text);
	assert_int_equal(fail_alloc_live(), 0);
	assert_true(n > 10);
	fail_alloc_set(1);
	assert_int_equal(answer_json(rows, 1, OUTPUT_VALUE, ANSWER_FLAT, &text,
	    &length), ERR_MEMORY);
	fail_alloc_set(2);
	assert_int_equal(answer_json(rows, 1, OUTPUT_VALUE, ANSWER_FLAT, &text,
	    &length), ERR_OK);
	fail_alloc_set(0);
	assert_memory_equal(text, "{\"count\":1,\"value\":[0.5]}", length);
	free(text);
}

int main(void)
{
	const struct CMUnitTest tests[] = {
		cmocka_unit_test(test_json_nested),
		cmocka_unit_test(test_json_flat),
		cmocka_unit_test(test_json_says_that_it_is_a_draft),
		cmocka_unit_test(test_json_of_one_output),
		cmocka_unit_test(test_json_of_no_points),
		cmocka_unit_test(test_json_of_the_longest_numbers_fits),
		cmocka_unit_test(test_json_too_large_is_out_of_memory),
		cmocka_unit_test(test_npy_header),
		cmocka_unit_test(test_json_of_a_grid_has_its_counts),
		cmocka_unit_test(test_npy_header_of_a_grid),
		cmocka_unit_test(test_npy_header_is_read_back),
		cmocka_unit_test(test_problems),
		cmocka_unit_test(test_problems_count_the_faults_left_out),
		cmocka_unit_test(test_faults_are_bounded_and_clean),
		cmocka_unit_test(test_every_allocation_may_fail),
	};

	return cmocka_run_group_tests(tests, NULL, NULL);
}
