#include <stdarg.h>
#include <stddef.h>
#include <setjmp.h>
#include <stdint.h>
#include <cmocka.h>

#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "core/output.h"
#include "proto/answer.h"
#include "proto/answer_stream.h"
#include "tests/support/fail_alloc.h"

#define FLAGS_ALL (ANSWER_FLAT | ANSWER_DRAFT)

static uint64_t state = 88172645463325252u;

/* Marsaglia's xorshift, 2003 */
static uint64_t draw(void)
{
	state ^= state << 13;
	state ^= state >> 7;
	state ^= state << 17;
	return state;
}

/* n floats of all sizes; some are the longest there are as text. */
static float *random_floats(size_t n)
{
	float *floats = malloc((n ? n : 1) * sizeof *floats);
	uint32_t bits;
	size_t i;

	assert_non_null(floats);
	for (i = 0; i < n; i++) {
		bits = (uint32_t)draw();
		memcpy(&floats[i], &bits, sizeof bits);
		if (draw() % 3 == 0 || !isfinite(floats[i]))
			floats[i] = -1.00000016e-5f;
	}
	return floats;
}

/* Reads it all with pieces of size, or random ones if size is 0, and compares
 * it with expected. */
static void check_pieces(const float *rows, size_t count, unsigned outputs,
    unsigned flags, size_t size, const char *expected, size_t length)
{
	struct answer_stream *s;
	char piece[1024];
	size_t at = 0, n, room;

	assert_int_equal(answer_stream_create(rows, count, outputs, flags, &s),
	    ERR_OK);
	do {
		room = size ? size : ANSWER_STREAM_LEAST + draw() % 700;
		memset(piece, '#', sizeof piece);
		n = answer_stream_read(s, piece, room);
		assert_in_range(n, 0, room);
		assert_in_range(at + n, 0, length);
		assert_memory_equal(piece, expected + at, n);
		/* Nothing is written behind the room. */
		assert_int_equal(piece[room], '#');
		at += n;
	} while (n);
	assert_int_equal(at, length);
	assert_int_equal(answer_stream_read(s, piece, sizeof piece), 0);
	answer_stream_free(s);
}

static void check(size_t count, unsigned outputs, unsigned flags)
{
	float *rows = random_floats(count *
	    (size_t)output_row_floats(outputs));
	size_t length;
	char *text;

	assert_int_equal(answer_json(rows, count, outputs, flags, &text,
	    &length), ERR_OK);
	check_pieces(rows, count, outputs, flags, ANSWER_STREAM_LEAST, text,
	    length);
	check_pieces(rows, count, outputs, flags, 0, text, length);
	check_pieces(rows, count, outputs, flags, 1023, text, length);
	free(text);
	free(rows);
}

static void test_pieces_of_a_grid_are_the_whole(void **unused)
{
	static const size_t counts[] = {1, 3, 4};
	float *rows = random_floats(12 * 4);
	struct answer_stream *s;
	char piece[ANSWER_STREAM_LEAST];
	size_t length, n, at = 0;
	char *text;

	(void)unused;
	assert_int_equal(answer_grid_json(rows, counts, OUTPUT_VALUE |
	    OUTPUT_GRADIENT, 0, &text, &length), ERR_OK);
	assert_int_equal(answer_stream_create(rows, 12, OUTPUT_VALUE |
	    OUTPUT_GRADIENT, 0, &s), ERR_OK);
	answer_stream_set_counts(s, counts);
	while ((n = answer_stream_read(s, piece, sizeof piece)) > 0) {
		assert_in_range(at + n, 0, length);
		assert_memory_equal(piece, text + at, n);
		at += n;
	}
	assert_int_equal(at, length);
	answer_stream_free(s);
	free(text);
	free(rows);
}

static void test_pieces_are_the_whole_for_all_outputs_and_flags(void **unused)
{
	unsigned outputs, flags;

	(void)unused;
	for (outputs = 1; outputs <= OUTPUT_ALL; outputs++) {
		for (flags = 0; flags <= FLAGS_ALL; flags++) {
			check(0, outputs, flags);
			check(1, outputs, flags);
			check(2 + draw() % 40, outputs, flags);
		}
	}
}

static void test_pieces_of_many_rows(void **unused)
{
	(void)unused;
	check(20000, OUTPUT_VALUE | OUTPUT_GRADIENT, 0);
	check(3000, OUTPUT_ALL, ANSWER_FLAT);
}

static void test_no_rows_and_no_stream(void **unused)
{
	static const char expected[] = "{\"count\":0,\"draft\":true,"
	    "\"hessian\":[]}";

	(void)unused;
	check_pieces(NULL, 0, OUTPUT_HESSIAN, ANSWER_DRAFT, 256, expected,
	    sizeof expected - 1);
	answer_stream_free(NULL);
}

static void test_every_allocation_may_fail(void **unused)
{
	const float row[4] = {0.5f, 1, 2, 3};
	struct answer_stream *s = NULL;
	char piece[256];
	long n;

	(void)unused;
	if (!fail_alloc_available())
		skip();
	for (n = 1;; n++) {
		fail_alloc_set(n);
		if (answer_stream_create(row, 1, OUTPUT_VALUE |
		    OUTPUT_GRADIENT, 0, &s) == ERR_OK)
			break;
		assert_null(s);
		assert_int_equal(fail_alloc_live(), 0);
	}
	/* Reading takes no memory. */
	fail_alloc_set(1);
	while (answer_stream_read(s, piece, sizeof piece))
		;
	assert_false(fail_alloc_happened());
	fail_alloc_set(0);
	answer_stream_free(s);
	assert_true(n > 1);
}

int main(void)
{
	const struct CMUnitTest tests[] = {
		cmocka_unit_test(
		    test_pieces_are_the_whole_for_all_outputs_and_flags),
		cmocka_unit_test(test_pieces_of_a_grid_are_the_whole),
		cmocka_unit_test(test_pieces_of_many_rows),
		cmocka_unit_test(test_no_rows_and_no_stream),
		cmocka_unit_test(test_every_allocation_may_fail),
	};

	return cmocka_run_group_tests(tests, NULL, NULL);
}
