/*
 * Patches: the examples of RFC 6902, RFC 6901 and RFC 7396, errors and where
 * they are, bounds, numbers as they are spelt, random edits against a model
 * that edits cJSON's own trees, and allocations that fail.
 */
#include <stdarg.h>
#include <stddef.h>
#include <setjmp.h>
#include <stdint.h>
#include <cmocka.h>

#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <time.h>

#include <cjson/cJSON.h>

#include "proto/arena.h"
#include "proto/fault.h"
#include "proto/json.h"
#include "proto/json_patch.h"
#include "proto/json_print.h"
#include "tests/support/fail_alloc.h"
#include "tests/support/random_tree.h"
#include "tests/support/sanitized.h"

#define COUNT(array) (sizeof(array) / sizeof *(array))
#define VALUES_MOST 100000
#define BYTES_MOST ((size_t)1 << 20)
#define POINTER_MAX 200

struct outcome {
	enum err err;
	char *text; /* with a NUL */
	struct faults faults;
};

static struct outcome patch_bounded(const char *text, const char *patch,
    bool is_merge, size_t values_most, size_t bytes_most)
{
	struct outcome o = {ERR_OK, NULL, {0}};
	struct json_patch p = {NULL, is_merge, values_most, bytes_most};
	struct arena arena = {0};
	cJSON *read;
	char *out;
	size_t length;

	o.err = json_patch_read(patch, strlen(patch), 2 * VALUES_MOST, &arena,
	    &read, &o.faults);
	if (!o.err) {
		p.patch = read;
		o.err = json_patch_text(&p, text, strlen(text), &out, &length,
		    &o.faults);
	}
	if (!o.err) {
		o.text = realloc(out, length + 1);
		o.text[length] = '\0';
	}
	arena_fini(&arena);
	return o;
}

static struct outcome patch_text(const char *text, const char *patch,
    bool is_merge)
{
	return patch_bounded(text, patch, is_merge, VALUES_MOST, BYTES_MOST);
}

/* A case: its result, or an error and what is said of which place. */
struct example {
	const char *text, *patch, *result;
	enum err err;
	const char *pointer, *says;
};

/* The end of one that has a result. */
#define FINE ERR_OK, NULL, NULL

static void check(const struct example *e, bool is_merge)
{
	struct outcome o = patch_text(e->text, e->patch, is_merge);
	const struct fault *fault = &o.faults.list[0];

	if (o.err != e->err)
		fail_msg("%s with %s: error %d, not %d (%s: %s)", e->text,
		    e->patch, o.err, e->err, fault->pointer, fault->detail);
	if (e->result) {
		assert_string_equal(o.text, e->result);
	} else {
		assert_int_equal(o.faults.count, 1);
		assert_string_equal(fault->pointer, e->pointer);
		if (!strstr(fault->detail, e->says))
			fail_msg("%s: '%s' does not say '%s'", e->patch,
			    fault->detail, e->says);
	}
	free(o.text);
}

static void check_all(const struct example *examples, size_t count,
    bool is_merge)
{
	for (size_t i = 0; i < count; i++)
		check(&examples[i], is_merge);
}

/* RFC 6902, appendix A, by number. */
static void test_examples_of_rfc_6902(void **unused)
{
	static const struct example examples[] = {
		/* A.1, A.2 */
		{"{\"foo\":\"bar\"}",
		    "[{\"op\":\"add\",\"path\":\"/baz\",\"value\":\"qux\"}]",
		    "{\"foo\":\"bar\",\"baz\":\"qux\"}", FINE},
		{"{\"foo\":[\"bar\",\"baz\"]}",
		    "[{\"op\":\"add\",\"path\":\"/foo/1\",\"value\":\"qux\"}]",
		    "{\"foo\":[\"bar\",\"qux\",\"baz\"]}", FINE},
		/* A.3, A.4, A.5 */
		{"{\"baz\":\"qux\",\"foo\":\"bar\"}",
		    "[{\"op\":\"remove\",\"path\":\"/baz\"}]",
		    "{\"foo\":\"bar\"}", FINE},
		{"{\"foo\":[\"bar\",\"qux\",\"baz\"]}",
		    "[{\"op\":\"remove\",\"path\":\"/foo/1\"}]",
		    "{\"foo\":[\"bar\",\"baz\"]}", FINE},
		{"{\"baz\":\"qux\",\"foo\":\"bar\"}",
		    "[{\"op\":\"replace\",\"path\":\"/baz\",\"value\":\"boo\"}]",
		    "{\"baz\":\"boo\",\"foo\":\"bar\"}", FINE},
		/* A.6, A.7 */
		{"{\"foo\":{\"bar\":\"baz\",\"waldo\":\"fred\"},"
		    "\"qux\":{\"corge\":\"grault\"}}",
		    "[{\"op\":\"move\",\"from\":\"/foo/waldo\","
		    "\"path\":\"/qux/thud\"}]",
		    "{\"foo\":{\"bar\":\"baz\"},"
		    "\"qux\":{\"corge\":\"grault\",\"thud\":\"fred\"}}", FINE},
		{"{\"foo\":[\"all\",\"grass\",\"cows\",\"eat\"]}",
		    "[{\"op\":\"move\",\"from\":\"/foo/1\",\"path\":\"/foo/3\"}]",
		    "{\"foo\":[\"all\",\"cows\",\"eat\",\"grass\"]}", FINE},
		/* A.8, A.9 */
		{"{\"baz\":\"qux\",\"foo\":[\"a\",2,\"c\"]}",
		    "[{\"op\":\"test\",\"path\":\"/baz\",\"value\":\"qux\"},"
		    "{\"op\":\"test\",\"path\":\"/foo/1\",\"value\":2}]",
		    "{\"baz\":\"qux\",\"foo\":[\"a\",2,\"c\"]}", FINE},
		{"{\"baz\":\"qux\"}",
		    "[{\"op\":\"test\",\"path\":\"/baz\",\"value\":\"bar\"}]",
		    NULL, ERR_CONFLICT, "/0/value",
		    "there is \"qux\", not \"bar\""},
		/* A.10, A.11 */
		{"{\"foo\":\"bar\"}",
		    "[{\"op\":\"add\",\"path\":\"/child\","
		    "\"value\":{\"grandchild\":{}}}]",
		    "{\"foo\":\"bar\",\"child\":{\"grandchild\":{}}}", FINE},
		{"{\"foo\":\"bar\"}",
		    "[{\"op\":\"add\",\"path\":\"/baz\",\"value\":\"qux\","
		    "\"xyz\":123}]",
		    "{\"foo\":\"bar\",\"baz\":\"qux\"}", FINE},
		/* A.12, A.13 */
		{"{\"foo\":\"bar\"}",
		    "[{\"op\":\"add\",\"path\":\"/baz/bat\",\"value\":\"qux\"}]",
		    NULL, ERR_INVALID, "/0/path", "no 'baz' in the document"},
		{"{\"foo\":\"bar\"}",
		    "[{\"op\":\"add\",\"path\":\"/baz\",\"value\":\"qux\","
		    "\"op\":\"remove\"}]",
		    NULL, ERR_SYNTAX, "/0/op", "twice"},
		/* A.14, A.15, A.16 */
		{"{\"/\":9,\"~1\":10}",
		    "[{\"op\":\"test\",\"path\":\"/~01\",\"value\":10}]",
		    "{\"/\":9,\"~1\":10}", FINE},
		{"{\"/\":9,\"~1\":10}",
		    "[{\"op\":\"test\",\"path\":\"/~01\",\"value\":\"10\"}]",
		    NULL, ERR_CONFLICT, "/0/value", "there is 10, not \"10\""},
		{"{\"foo\":[\"bar\"]}",
		    "[{\"op\":\"add\",\"path\":\"/foo/-\","
		    "\"value\":[\"abc\",\"def\"]}]",
		    "{\"foo\":[\"bar\",[\"abc\",\"def\"]]}", FINE},
	};

	(void)unused;
	check_all(examples, COUNT(examples), false);
}

/* RFC 6901, section 5: what each pointer leads to. */
static void test_pointers_of_rfc_6901(void **unused)
{
	static const char document[] = "{\"foo\":[\"bar\",\"baz\"],\"\":0,"
	    "\"a/b\":1,\"c%d\":2,\"e^f\":3,\"g|h\":4,\"i\\\\j\":5,"
	    "\"k\\\"l\":6,\" \":7,\"m~n\":8}";
	static const char *const cases[][2] = {
		{"", document}, {"/foo", "[\"bar\",\"baz\"]"},
		{"/foo/0", "\"bar\""}, {"/", "0"}, {"/a~1b", "1"},
		{"/c%d", "2"}, {"/e^f", "3"}, {"/g|h", "4"}, {"/i\\\\j", "5"},
		{"/k\\\"l", "6"}, {"/ ", "7"}, {"/m~0n", "8"},
	};
	char patch[400];
	struct outcome o;

	(void)unused;
	for (size_t i = 0; i < COUNT(cases); i++) {
		snprintf(patch, sizeof patch, "[{\"op\":\"test\",\"path\":"
		    "\"%s\",\"value\":%s}]", cases[i][0], cases[i][1]);
		o = patch_text(document, patch, false);
		assert_int_equal(o.err, ERR_OK);
		free(o.text);
	}
}

/* RFC 7396, appendix A, in its order. */
static void test_examples_of_rfc_7396(void **unused)
{
	static const struct example examples[] = {
		{"{\"a\":\"b\"}", "{\"a\":\"c\"}", "{\"a\":\"c\"}", FINE},
		{"{\"a\":\"b\"}", "{\"b\":\"c\"}", "{\"a\":\"b\",\"b\":\"c\"}", FINE},
		{"{\"a\":\"b\"}", "{\"a\":null}", "{}", FINE},
		{"{\"a\":\"b\",\"b\":\"c\"}", "{\"a\":null}", "{\"b\":\"c\"}", FINE},
		{"{\"a\":[\"b\"]}", "{\"a\":\"c\"}", "{\"a\":\"c\"}", FINE},
		{"{\"a\":\"c\"}", "{\"a\":[\"b\"]}", "{\"a\":[\"b\"]}", FINE},
		{"{\"a\":{\"b\":\"c\"}}", "{\"a\":{\"b\":\"d\",\"c\":null}}",
		    "{\"a\":{\"b\":\"d\"}}", FINE},
		{"{\"a\":[{\"b\":\"c\"}]}", "{\"a\":[1]}", "{\"a\":[1]}", FINE},
		{"[\"a\",\"b\"]", "[\"c\",\"d\"]", "[\"c\",\"d\"]", FINE},
		{"{\"a\":\"b\"}", "[\"c\"]", "[\"c\"]", FINE},
		{"{\"a\":\"foo\"}", "null", "null", FINE},
		{"{\"a\":\"foo\"}", "\"bar\"", "\"bar\"", FINE},
		{"{\"e\":null}", "{\"a\":1}", "{\"e\":null,\"a\":1}", FINE},
		{"[1,2]", "{\"a\":\"b\",\"c\":null}", "{\"a\":\"b\"}", FINE},
		{"{}", "{\"a\":{\"bb\":{\"ccc\":null}}}",
		    "{\"a\":{\"bb\":{}}}", FINE},
		/* section 3's */
		{"{\"title\":\"Goodbye!\",\"author\":{\"givenName\":\"John\","
		    "\"familyName\":\"Doe\"},\"tags\":[\"example\","
		    "\"sample\"],\"content\":\"This will be unchanged\"}",
		    "{\"title\":\"Hello!\",\"phoneNumber\":\"+01-123\","
		    "\"author\":{\"familyName\":null},\"tags\":[\"example\"]}",
		    "{\"title\":\"Hello!\",\"author\":{\"givenName\":"
		    "\"John\"},\"tags\":[\"example\"],\"content\":"
		    "\"This will be unchanged\",\"phoneNumber\":\"+01-123\"}", FINE},
	};

	(void)unused;
	check_all(examples, COUNT(examples), true);
}

static void test_the_whole_document_is_a_place(void **unused)
{
	static const struct example examples[] = {
		{"{\"a\":1}", "[{\"op\":\"replace\",\"path\":\"\",\"value\":[2]}]",
		    "[2]", FINE},
		{"{\"a\":1}", "[{\"op\":\"add\",\"path\":\"\",\"value\":3}]",
		    "3", FINE},
		{"{\"a\":{\"b\":1}}",
		    "[{\"op\":\"move\",\"from\":\"/a\",\"path\":\"\"}]",
		    "{\"b\":1}", FINE},
		{"{\"a\":{\"b\":1}}",
		    "[{\"op\":\"copy\",\"from\":\"/a/b\",\"path\":\"\"}]", "1", FINE},
		{"{\"a\":1}", "[{\"op\":\"copy\",\"from\":\"\",\"path\":\"/b\"}]",
		    "{\"a\":1,\"b\":{\"a\":1}}", FINE},
		{"{\"a\":1}", "[{\"op\":\"move\",\"from\":\"\",\"path\":\"\"}]",
		    "{\"a\":1}", FINE},
		{"{\"a\":1}", "[{\"op\":\"remove\",\"path\":\"\"}]", NULL,
		    ERR_INVALID, "/0/path", "cannot be removed"},
		{"{\"a\":1}", "[{\"op\":\"move\",\"from\":\"\",\"path\":\"/b\"}]",
		    NULL, ERR_INVALID, "/0/path", "into itself"},
	};

	(void)unused;
	check_all(examples, COUNT(examples), false);
}

static void test_equality_is_of_values(void **unused)
{
	static const struct example examples[] = {
		{"{\"a\":1}",
		    "[{\"op\":\"test\",\"path\":\"/a\",\"value\":1.0}]",
		    "{\"a\":1}", FINE},
		{"{\"a\":100}",
		    "[{\"op\":\"test\",\"path\":\"/a\",\"value\":1e2}]",
		    "{\"a\":100}", FINE},
		{"{\"a\":{\"x\":[1,{}],\"y\":null}}",
		    "[{\"op\":\"test\",\"path\":\"/a\",\"value\":"
		    "{\"y\":null,\"x\":[1,{}]}}]",
		    "{\"a\":{\"x\":[1,{}],\"y\":null}}", FINE},
		{"{\"a\":[1,2]}",
		    "[{\"op\":\"test\",\"path\":\"/a\",\"value\":[2,1]}]",
		    NULL, ERR_CONFLICT, "/0/value", "there is [1,2]"},
		{"{\"a\":{\"x\":1}}",
		    "[{\"op\":\"test\",\"path\":\"/a\",\"value\":"
		    "{\"x\":1,\"y\":1}}]",
		    NULL, ERR_CONFLICT, "/0/value", "failed"},
		{"{\"a\":true}",
		    "[{\"op\":\"test\",\"path\":\"/a\",\"value\":false}]",
		    NULL, ERR_CONFLICT, "/0/value", "there is true, not false"},
		{"{\"a\":0}",
		    "[{\"op\":\"test\",\"path\":\"/a\",\"value\":null}]",
		    NULL, ERR_CONFLICT, "/0/value", "failed"},
		{"{\"a\":0.30000000000000004}",
		    "[{\"op\":\"test\",\"path\":\"/a\",\"value\":0.3}]",
		    NULL, ERR_CONFLICT, "/0/value", "failed"},
		{"{\"a\":0}",
		    "[{\"op\":\"test\",\"path\":\"/b\",\"value\":null}]",
		    NULL, ERR_CONFLICT, "/0/path", "no 'b'"},
	};

	(void)unused;
	check_all(examples, COUNT(examples), false);
}

static void test_errors_name_the_place_in_the_patch(void **unused)
{
	static const struct example examples[] = {
		{"{}", "{\"a\":1}", NULL, ERR_INVALID, "", "merge-patch"},
		{"{}", "[1]", NULL, ERR_INVALID, "/0", "not a number"},
		{"{}", "[{\"path\":\"/a\"}]", NULL, ERR_INVALID, "/0",
		    "no \"op\""},
		{"{}", "[{\"op\":1}]", NULL, ERR_INVALID, "/0/op", "string"},
		{"{}", "[{\"op\":\"ad\",\"path\":\"/a\",\"value\":1}]", NULL,
		    ERR_INVALID, "/0/op", "did you mean 'add'?"},
		{"{}", "[{\"op\":\"frobnicate\"}]", NULL, ERR_INVALID, "/0/op",
		    "there are add, remove"},
		{"{}", "[{\"op\":\"add\",\"value\":1}]", NULL, ERR_INVALID,
		    "/0", "no \"path\""},
		{"{}", "[{\"op\":\"add\",\"path\":\"/a\"}]", NULL, ERR_INVALID,
		    "/0", "no \"value\""},
		{"{\"a\":1}", "[{\"op\":\"move\",\"path\":\"/a\"}]", NULL,
		    ERR_INVALID, "/0", "no \"from\""},
		{"{}", "[{\"op\":\"add\",\"path\":7,\"value\":1}]", NULL,
		    ERR_INVALID, "/0/path", "not a number"},
		{"{}", "[{\"op\":\"add\",\"path\":\"a\",\"value\":1}]", NULL,
		    ERR_INVALID, "/0/path", "begins with '/'"},
		{"{}", "[{\"op\":\"add\",\"path\":\"/a~2\",\"value\":1}]", NULL,
		    ERR_INVALID, "/0/path", "'~'"},
		{"{}", "[{\"op\":\"add\",\"path\":\"/a~\",\"value\":1}]", NULL,
		    ERR_INVALID, "/0/path", "'~'"},
		{"{\"a\":[1,2,3]}",
		    "[{\"op\":\"test\",\"path\":\"/a/0\",\"value\":1},"
		    "{\"op\":\"remove\",\"path\":\"/a/0\"},"
		    "{\"op\":\"remove\",\"path\":\"/a/2\"}]", NULL,
		    ERR_INVALID, "/2/path", "no element 2 in '/a', which has 2"},
		{"{\"a\":[1]}", "[{\"op\":\"remove\",\"path\":\"/a/-\"}]", NULL,
		    ERR_INVALID, "/0/path", "no element - in '/a', which "
		    "has 1; - is for"},
		{"{\"a\":[1]}", "[{\"op\":\"remove\",\"path\":\"/a/00\"}]",
		    NULL, ERR_INVALID, "/0/path", "'00' is no index"},
		{"{\"a\":[1]}", "[{\"op\":\"remove\",\"path\":\"/a/+0\"}]",
		    NULL, ERR_INVALID, "/0/path", "'+0' is no index"},
		{"{\"a\":[1]}", "[{\"op\":\"remove\",\"path\":\"/a/\"}]",
		    NULL, ERR_INVALID, "/0/path", "'' is no index"},
		{"{\"a\":[1]}",
		    "[{\"op\":\"remove\",\"path\":\"/a/18446744073709551616\"}]",
		    NULL, ERR_INVALID, "/0/path", "no element 1844"},
		{"{\"a\":[1]}",
		    "[{\"op\":\"add\",\"path\":\"/a/2\",\"value\":1}]", NULL,
		    ERR_INVALID, "/0/path", "'/a' has 1 elements"},
		{"{\"a\":\"b\"}",
		    "[{\"op\":\"add\",\"path\":\"/a/b\",\"value\":1}]", NULL,
		    ERR_INVALID, "/0/path", "'/a' is a string"},
		{"{\"a\":{\"b\":{}}}",
		    "[{\"op\":\"move\",\"from\":\"/a\",\"path\":\"/a/b/c\"}]",
		    NULL, ERR_INVALID, "/0/path", "into itself"},
		{"{\"a\":1}", "[{\"op\":\"replace\",\"path\":\"/b\","
		    "\"value\":1}]", NULL, ERR_INVALID, "/0/path", "no 'b'"},
		{"{\"a\":1}", "[{\"op\":\"copy\",\"from\":\"/b\","
		    "\"path\":\"/c\"}]", NULL, ERR_INVALID, "/0/from",
		    "no 'b'"},
	};

	(void)unused;
	check_all(examples, COUNT(examples), false);
}

/* A name that only begins like another one is another one's. */
static void test_moves_beside_itself(void **unused)
{
	static const struct example examples[] = {
		{"{\"a\":1,\"ab\":{}}",
		    "[{\"op\":\"move\",\"from\":\"/a\",\"path\":\"/ab/c\"}]",
		    "{\"ab\":{\"c\":1}}", FINE},
		{"[0,1,2]", "[{\"op\":\"move\",\"from\":\"/2\",\"path\":\"/0\"}]",
		    "[2,0,1]", FINE},
		{"[0,1,2]", "[{\"op\":\"move\",\"from\":\"/0\",\"path\":\"/-\"}]",
		    "[1,2,0]", FINE},
		{"[0,1,2]", "[{\"op\":\"move\",\"from\":\"/0\",\"path\":\"/3\"}]",
		    NULL, ERR_INVALID, "/0/path", "has 2 elements"},
		{"[[0],1]", "[{\"op\":\"move\",\"from\":\"/1\",\"path\":\"/0/0\"}]",
		    "[[1,0]]", FINE},
		{"{\"a\":1,\"b\":2}",
		    "[{\"op\":\"move\",\"from\":\"/a\",\"path\":\"/b\"}]",
		    "{\"b\":1}", FINE},
	};

	(void)unused;
	check_all(examples, COUNT(examples), false);
}

static void test_numbers_stay_as_they_are_spelt(void **unused)
{
	static const char numbers[] = "0.30000000000000004,0.1,1.50,-0,"
	    "123456789012345678901234567890,1e400,-1E+400,5e-324,"
	    "0.1000000000000000055511151231257827,9007199254740993";
	char text[600], patch[600], expected[900];
	struct outcome o;

	(void)unused;
	snprintf(text, sizeof text, " {\"1\" : [ %s ],\n \"2\\\"9\": 7 }",
	    numbers);
	snprintf(patch, sizeof patch, "[{\"op\":\"add\",\"path\":\"/new\","
	    "\"value\":[%s]},{\"op\":\"copy\",\"from\":\"/1/4\",\"path\":"
	    "\"/copy\"}]", numbers);
	snprintf(expected, sizeof expected, "{\"1\":[%s],\"2\\\"9\":7,"
	    "\"new\":[%s],\"copy\":123456789012345678901234567890}", numbers,
	    numbers);
	o = patch_text(text, patch, false);
	assert_int_equal(o.err, ERR_OK);
	assert_string_equal(o.text, expected);
	free(o.text);
	o = patch_text(text, "{\"1\":-0.0e0}", true);
	assert_string_equal(o.text, "{\"1\":-0.0e0,\"2\\\"9\":7}");
	free(o.text);
	/* What is beyond a double is not equal because both are infinite. */
	o = patch_text("[1e400]", "[{\"op\":\"test\",\"path\":\"/0\","
	    "\"value\":1e500}]", false);
	assert_int_equal(o.err, ERR_CONFLICT);
}

/* Numbers that nobody has spelt: every double reads back. */
static void test_printed_doubles_read_back(void **unused)
{
	struct random_stream r = {7};
	char *text, copy[64];
	size_t length;

	(void)unused;
	for (int i = 0; i < 200000; i++) {
		uint64_t bits = random_bits(&r);
		cJSON number = {.type = cJSON_Number};
		double back;

		memcpy(&number.valuedouble, &bits, sizeof bits);
		if ((bits >> 52 & 0x7ff) == 0x7ff)
			continue;
		assert_int_equal(json_print(&number, 64, &text, &length),
		    ERR_OK);
		memcpy(copy, text, length);
		copy[length] = '\0';
		back = strtod(copy, NULL);
		assert_memory_equal(&back, &number.valuedouble, sizeof back);
		free(text);
	}
}

static void test_strings_survive(void **unused)
{
	static const char text[] = "{\"\\u0001\\b\\f\\n\\r\\t\\\"\\\\\":"
	    "\"\\u001f\xc3\xa9\xf0\x9f\x98\x80\"}";
	struct outcome o = patch_text(text, "{\"x\":1}", true);

	(void)unused;
	assert_string_equal(o.text, "{\"\\u0001\\b\\f\\n\\r\\t\\\"\\\\\":"
	    "\"\\u001f\xc3\xa9\xf0\x9f\x98\x80\",\"x\":1}");
	free(o.text);
}

/* The very same bytes, white space included. */
static void test_what_changes_nothing_keeps_the_text(void **unused)
{
	static const char text[] = "{ \"a\": [1, 2.0],\n  \"b\": {} }\n";
	static const char *const patches[] = {"[]",
	    "[{\"op\":\"replace\",\"path\":\"/a/1\",\"value\":2}]",
	    "[{\"op\":\"add\",\"path\":\"/c\",\"value\":2},"
	    "{\"op\":\"remove\",\"path\":\"/c\"}]",
	    "{}", "{\"c\":null}", "{\"b\":{}}", "{\"a\":[1,2]}"};

	(void)unused;
	for (size_t i = 0; i < COUNT(patches); i++) {
		struct outcome o = patch_text(text, patches[i],
		    patches[i][0] == '{');

		assert_string_equal(o.text, text);
		free(o.text);
	}
}

static void test_a_failed_patch_changes_nothing(void **unused)
{
	static const char text[] = "{\"a\":[1,2]}", patch[] =
	    "[{\"op\":\"remove\",\"path\":\"/a/0\"},{\"op\":\"add\","
	    "\"path\":\"/b\",\"value\":1},{\"op\":\"remove\","
	    "\"path\":\"/c\"}]";
	struct faults faults = {0};
	struct arena arena = {0};
	cJSON *tree, *before, *json;
	char *printed;
	size_t length;

	(void)unused;
	assert_int_equal(json_parse(text, strlen(text), 100, &arena, &tree,
	    &faults), ERR_OK);
	assert_int_equal(json_parse(patch, strlen(patch), 100, &arena, &json,
	    &faults), ERR_OK);
	before = tree;
	assert_int_equal(json_patch_apply(&tree, json, 100, &arena, &faults),
	    ERR_INVALID);
	assert_ptr_equal(tree, before);
	assert_int_equal(json_print(tree, 100, &printed, &length), ERR_OK);
	assert_int_equal(length, strlen(text));
	assert_memory_equal(printed, text, length);
	free(printed);
	arena_fini(&arena);
}

/* ---- bounds ---- */

static char *repeat(const char *before, const char *one, size_t count,
    const char *after)
{
	const size_t n = strlen(one), head = strlen(before);
	char *text = malloc(head + count * n + strlen(after) + 1);

	strcpy(text, before);
	for (size_t i = 0; i < count; i++)
		memcpy(text + head + i * n, one, n);
	strcpy(text + head + count * n, after);
	return text;
}

static void assert_limit(const char *text, const char *patch, bool is_merge,
    const char *says)
{
	struct outcome o = patch_text(text, patch, is_merge);

	assert_int_equal(o.err, ERR_LIMIT);
	if (!strstr(o.faults.list[0].detail, says))
		fail_msg("'%s' does not say '%s'", o.faults.list[0].detail,
		    says);
}

/* 60 doublings of a document would be 10^18 values. */
static void test_copies_of_copies_end(void **unused)
{
	char *patch = repeat("[{\"op\":\"add\",\"path\":\"/-\",\"value\":0}",
	    ",{\"op\":\"copy\",\"from\":\"\",\"path\":\"/-\"}", 60, "]");
	struct outcome o;

	(void)unused;
	assert_limit("[]", patch, false, "more than 100000 JSON values");
	free(patch);
	/* What is removed makes room again. */
	patch = repeat("[{\"op\":\"test\",\"path\":\"\",\"value\":[[1,2,3]]}",
	    ",{\"op\":\"copy\",\"from\":\"/0\",\"path\":\"/-\"},{\"op\":"
	    "\"remove\",\"path\":\"/0\"}", 500, "]");
	o = patch_bounded("[[1,2,3]]", patch, false, 9, BYTES_MOST);
	assert_int_equal(o.err, ERR_OK);
	assert_string_equal(o.text, "[[1,2,3]]");
	free(o.text);
	o = patch_bounded("[[1,2,3]]", patch, false, 8, BYTES_MOST);
	assert_int_equal(o.err, ERR_LIMIT);
	free(patch);
}

static void test_a_long_string_copied_often_ends(void **unused)
{
	char *text = repeat("[\"", "x", 100000, "\"]");
	char *patch = repeat("[{\"op\":\"copy\",\"from\":\"/0\",\"path\":"
	    "\"/-\"}", ",{\"op\":\"copy\",\"from\":\"/0\",\"path\":\"/-\"}",
	    4000, "]");

	(void)unused;
	assert_limit(text, patch, false, "more than 1048576 bytes");
	free(text);
	free(patch);
}

/* Deep into deep adds up, again and again. */
static void test_depth_is_bounded(void **unused)
{
	char *deep = repeat("", "[", 100, ""), *path = repeat("\"", "/0", 99,
	    "\""), *patch, *all;

	(void)unused;
	all = repeat(deep, "]", 100, "");
	assert_true(asprintf(&patch, "[{\"op\":\"copy\",\"from\":\"\","
	    "\"path\":%.*s/0\"}]", (int)strlen(path) - 1, path) > 0);
	assert_limit(all, patch, false, "nested more than 144 deep");
	free(patch);
	assert_true(asprintf(&patch, "[{\"op\":\"add\",\"path\":\"\",\"value\":"
	    "[%s,%s]},{\"op\":\"move\",\"from\":\"/1\",\"path\":\"/0%.*s/0\"}]",
	    all, all, (int)strlen(path) - 2, path + 1) > 0);
	assert_limit("[]", patch, false, "nested more than 144 deep");
	free(patch);
	free(all);
	free(deep);
	free(path);
}

static void test_too_many_operations(void **unused)
{
	char *patch = repeat("[1", ",1", JSON_PATCH_OPERATIONS_MAX, "]");

	(void)unused;
	assert_limit("[]", patch, false, "4097 operations");
	free(patch);
}

static double seconds(void)
{
	struct timespec t;

	clock_gettime(CLOCK_PROCESS_CPUTIME_ID, &t);
	return (double)t.tv_sec + 1e-9 * (double)t.tv_nsec;
}

/* Returns the time it took. */
static double time_patch(const char *what, const char *text,
    const char *patch, enum err expected)
{
	double begin = seconds();
	struct outcome o = patch_text(text, patch, false);

	begin = seconds() - begin;
	printf("measured: %s: %.0f ms\n", what, 1e3 * begin);
	assert_int_equal(o.err, expected);
	free(o.text);
	return begin;
}

/*
 * The most work there is for a patch: the limit of steps, spent in walks through
 * long lists, in comparisons, in copies, and in names that are nearly alike.
 */
static void test_work_is_bounded(void **unused)
{
	char *text = repeat("[[0", ",0", 99990, "],0]");
	char *patch, *name, *long_name;
	double worst = 0.0, t;

	(void)unused;
	patch = repeat("[{\"op\":\"add\",\"path\":\"/0/-\",\"value\":1}",
	    ",{\"op\":\"remove\",\"path\":\"/0/99990\"},{\"op\":\"add\","
	    "\"path\":\"/0/-\",\"value\":1}", 2047, "]");
	t = time_patch("4095 operations at the end of 100,000", text, patch,
	    ERR_OK);
	worst = t > worst ? t : worst;
	free(patch);
	patch = repeat("[{\"op\":\"add\",\"path\":\"/1\",\"value\":1}",
	    ",{\"op\":\"replace\",\"path\":\"/0/50000\",\"value\":1}", 4095,
	    "]");
	t = time_patch("4096 in the middle of 100,000", text, patch,
	    ERR_LIMIT);
	worst = t > worst ? t : worst;
	free(patch);
	patch = repeat("[{\"op\":\"remove\",\"path\":\"/1\"}",
	    ",{\"op\":\"test\",\"path\":\"/0\",\"value\":[]},"
	    "{\"op\":\"add\",\"path\":\"\",\"value\":0}", 1, "]");
	t = time_patch("a test", text, patch, ERR_CONFLICT);
	free(patch);
	patch = repeat("[{\"op\":\"replace\",\"path\":\"\",\"value\":[[],0]},"
	    "{\"op\":\"add\",\"path\":\"/0\",\"value\":[0]}",
	    ",{\"op\":\"test\",\"path\":\"\",\"value\":[[0],[],0]}", 4000,
	    "]");
	t = time_patch("4,000 tests", text, patch, ERR_OK);
	worst = t > worst ? t : worst;
	free(patch);
	free(text);
	text = repeat("[[0", ",0", 49000, "],0]");
	patch = repeat("[{\"op\":\"copy\",\"from\":\"/0\",\"path\":\"/1\"}",
	    ",{\"op\":\"copy\",\"from\":\"/0\",\"path\":\"/1\"},"
	    "{\"op\":\"remove\",\"path\":\"/1\"}", 2000, "]");
	t = time_patch("4,000 copies and removals of 49,000", text, patch,
	    ERR_LIMIT);
	worst = t > worst ? t : worst;
	free(patch);
	free(text);
	long_name = repeat("", "n", 9000, "");
	text = repeat("{\"a\":0", "", 0, "");
	name = malloc(12000 * 100);
	strcpy(name, text);
	for (int i = 0; i < 100; i++)
		sprintf(name + strlen(name), ",\"%s%d\":0", long_name, i);
	strcat(name, "}");
	free(text);
	assert_true(asprintf(&text, ",{\"op\":\"test\",\"path\":\"/%s99\","
	    "\"value\":0}", long_name) > 0);
	patch = repeat("[{\"op\":\"remove\",\"path\":\"/a\"}", text, 4095,
	    "]");
	t = time_patch("names of 9,000 bytes that are nearly alike", name,
	    patch, ERR_OK);
	worst = t > worst ? t : worst;
	free(patch);
	free(name);
	free(text);
	free(long_name);
	printf("measured: the longest %.0f ms\n", 1e3 * worst);
	/* 270 ms measured, on a machine that does other work, too. */
	assert_true(SANITIZED || worst < 5.0);
}

/* ---- random edits against a model ---- */

static const char *const random_names[] = {"a", "b/c", "~d", "", "0", "-",
    "\xc3\xa9", "a~1"};

static cJSON *random_value(struct random_stream *r, int depth)
{
	cJSON *value;
	int kind = random_below(r, depth > 0 ? 7 : 5);

	switch (kind) {
	case 0:
		return cJSON_CreateNull();
	case 1:
		return cJSON_CreateBool(random_below(r, 2));
	case 2:
	case 3:
		return cJSON_CreateNumber(random_below(r, 10));
	case 4:
		return cJSON_CreateString(random_names[random_below(r, 8)]);
	default:
		value = kind == 5 ? cJSON_CreateArray() : cJSON_CreateObject();
		break;
	}
	for (int n = random_below(r, 5); n > 0; n--) {
		const char *name = random_names[random_below(r, 8)];

		if (kind == 5)
			cJSON_AddItemToArray(value, random_value(r,
			    depth - 1));
		else if (!cJSON_GetObjectItemCaseSensitive(value, name))
			cJSON_AddItemToObject(value, name,
			    random_value(r, depth - 1));
	}
	return value;
}

struct listed {
	cJSON *value, *parent;
	char pointer[POINTER_MAX];
};
struct list {
	struct listed items[2000];
	int count;
};

static void append_name(char *pointer, const char *name)
{
	char *out = pointer + strlen(pointer);

	*out++ = '/';
	for (; *name; name++) {
		if (*name == '~' || *name == '/') {
			*out++ = '~';
			*out++ = *name == '~' ? '0' : '1';
		} else {
			*out++ = *name;
		}
	}
	*out = '\0';
}

static void list_values(struct list *list, cJSON *value, cJSON *parent,
    const char *pointer)
{
	char next[POINTER_MAX + 32];
	int index = 0;

	if (list->count == 2000 || strlen(pointer) >= POINTER_MAX - 16)
		return;
	list->items[list->count] = (struct listed){value, parent, ""};
	strcpy(list->items[list->count++].pointer, pointer);
	for (cJSON *c = value->child; c; c = c->next, index++) {
		char number[16];

		snprintf(number, sizeof number, "%d", index);
		strcpy(next, pointer);
		append_name(next, cJSON_IsArray(value) ? number : c->string);
		list_values(list, c, value, next);
	}
}

static struct listed *pick(struct list *list, struct random_stream *r,
    cJSON *root)
{
	list->count = 0;
	list_values(list, root, NULL, "");
	return &list->items[random_below(r, list->count)];
}

/* As cJSON_InsertItemInArray, which in 1.7.15 loses what is put in the middle. */
static void insert(cJSON *array, int at, cJSON *value)
{
	cJSON *rest = cJSON_CreateArray();

	while (cJSON_GetArraySize(array) > at)
		cJSON_AddItemToArray(rest, cJSON_DetachItemFromArray(array,
		    at));
	cJSON_AddItemToArray(array, value);
	while (rest->child)
		cJSON_AddItemToArray(array, cJSON_DetachItemFromArray(rest,
		    0));
	cJSON_Delete(rest);
}

/* Adds value somewhere, or drops it where there is no place; its pointer. */
static bool add_somewhere(struct list *list, struct random_stream *r,
    cJSON **root, cJSON *value, char pointer[static POINTER_MAX])
{
	struct listed *in = pick(list, r, *root);
	const char *name = random_names[random_below(r, 8)];
	char index[16];
	int count, at;

	if (random_below(r, 40) == 0) {
		pointer[0] = '\0';
		cJSON_Delete(*root);
		*root = value;
		return true;
	}
	strcpy(pointer, in->pointer);
	if (cJSON_IsObject(in->value)) {
		append_name(pointer, name);
		if (cJSON_GetObjectItemCaseSensitive(in->value, name))
			cJSON_ReplaceItemInObjectCaseSensitive(in->value, name,
			    value);
		else
			cJSON_AddItemToObject(in->value, name, value);
		return true;
	}
	if (!cJSON_IsArray(in->value)) {
		cJSON_Delete(value);
		return false;
	}
	count = cJSON_GetArraySize(in->value);
	at = random_below(r, count + 1);
	snprintf(index, sizeof index, "%d", at);
	append_name(pointer, at == count && random_below(r, 2) ? "-" : index);
	insert(in->value, at, value);
	return true;
}

static cJSON *operation(cJSON *patch, const char *op, const char *path)
{
	cJSON *json = cJSON_CreateObject();

	cJSON_AddStringToObject(json, "op", op);
	cJSON_AddStringToObject(json, "path", path);
	cJSON_AddItemToArray(patch, json);
	return json;
}

static void edit_add(struct list *list, struct random_stream *r,
    cJSON **root, cJSON *patch)
{
	cJSON *value = random_value(r, 2), *copy = cJSON_Duplicate(value, 1);
	char pointer[POINTER_MAX];

	if (add_somewhere(list, r, root, value, pointer))
		cJSON_AddItemToObject(operation(patch, "add", pointer),
		    "value", copy);
	else
		cJSON_Delete(copy);
}

static void edit_copy(struct list *list, struct random_stream *r,
    cJSON **root, cJSON *patch)
{
	struct listed from = *pick(list, r, *root);
	cJSON *copy = cJSON_Duplicate(from.value, 1);
	char pointer[POINTER_MAX];

	if (add_somewhere(list, r, root, copy, pointer))
		cJSON_AddStringToObject(operation(patch, "copy", pointer),
		    "from", from.pointer);
}

static void edit_move(struct list *list, struct random_stream *r,
    cJSON **root, cJSON *patch)
{
	struct listed from = *pick(list, r, *root);
	const size_t n = strlen(from.pointer);
	cJSON *copy, *from_copy;
	char pointer[POINTER_MAX];

	if (!from.parent)
		return;
	copy = cJSON_Duplicate(from.value, 1);
	from_copy = cJSON_Duplicate(from.value, 1);
	cJSON_Delete(cJSON_DetachItemViaPointer(from.parent, from.value));
	if (!add_somewhere(list, r, root, copy, pointer)) {
		operation(patch, "remove", from.pointer);
	} else if (strncmp(pointer, from.pointer, n) == 0 &&
	    pointer[n] == '/') {
		/* Into what has taken its place: no move can say that. */
		operation(patch, "remove", from.pointer);
		cJSON_AddItemToObject(operation(patch, "add", pointer),
		    "value", cJSON_Duplicate(from_copy, 1));
	} else {
		cJSON_AddStringToObject(operation(patch, "move", pointer),
		    "from", from.pointer);
	}
	cJSON_Delete(from_copy);
}

static void edit_here(struct list *list, struct random_stream *r,
    cJSON **root, cJSON *patch, int kind)
{
	struct listed at = *pick(list, r, *root);
	cJSON *value;

	if (kind == 0) {
		cJSON_AddItemToObject(operation(patch, "test", at.pointer),
		    "value", cJSON_Duplicate(at.value, 1));
	} else if (!at.parent) {
		return;
	} else if (kind == 1) {
		operation(patch, "remove", at.pointer);
		cJSON_Delete(cJSON_DetachItemViaPointer(at.parent, at.value));
	} else {
		value = random_value(r, 2);
		cJSON_AddItemToObject(operation(patch, "replace", at.pointer),
		    "value", cJSON_Duplicate(value, 1));
		if (cJSON_IsArray(at.parent))
			cJSON_ReplaceItemViaPointer(at.parent, at.value,
			    value);
		else
			cJSON_ReplaceItemInObjectCaseSensitive(at.parent,
			    at.value->string, value);
	}
}

static void edit(struct list *list, struct random_stream *r, cJSON **root,
    cJSON *patch)
{
	const int kind = random_below(r, 7);

	list->count = 0;
	list_values(list, *root, NULL, "");
	if (kind < 3 || list->count > 300)
		edit_here(list, r, root, patch, list->count > 300 ? 1 : kind);
	else if (kind < 5)
		edit_add(list, r, root, patch);
	else if (kind == 5)
		edit_copy(list, r, root, patch);
	else
		edit_move(list, r, root, patch);
}

static void check_random(struct list *list, struct random_stream *r)
{
	cJSON *root = random_value(r, 4), *patch = cJSON_CreateArray();
	char *text = cJSON_PrintUnformatted(root), *edits, *expected;
	cJSON *result;
	struct outcome o;

	for (int n = 1 + random_below(r, 30); n > 0; n--)
		edit(list, r, &root, patch);
	edits = cJSON_PrintUnformatted(patch);
	expected = cJSON_PrintUnformatted(root);
	o = patch_text(text, edits, false);
	if (o.err)
		fail_msg("%s with %s: %s: %s", text, edits,
		    o.faults.list[0].pointer, o.faults.list[0].detail);
	result = cJSON_Parse(o.text);
	if (!cJSON_Compare(result, root, 1))
		fail_msg("%s with %s: %s, not %s", text, edits, o.text,
		    expected);
	cJSON_Delete(result);
	cJSON_Delete(root);
	cJSON_Delete(patch);
	free(text);
	free(edits);
	free(expected);
	free(o.text);
}

static void test_random_edits_against_a_model(void **unused)
{
	struct list *list = malloc(sizeof *list);
	struct random_stream r = {1};

	(void)unused;
	for (int i = 0; i < (SANITIZED ? 500 : 5000); i++)
		check_random(list, &r);
	free(list);
}

/* RFC 7396, section 2, as it is written there. */
static cJSON *model_merge(cJSON *target, const cJSON *patch)
{
	if (!cJSON_IsObject(patch)) {
		cJSON_Delete(target);
		return cJSON_Duplicate(patch, 1);
	}
	if (!cJSON_IsObject(target)) {
		cJSON_Delete(target);
		target = cJSON_CreateObject();
	}
	for (const cJSON *m = patch->child; m; m = m->next) {
		cJSON *old = cJSON_GetObjectItemCaseSensitive(target,
		    m->string);
		cJSON *copy = old ? cJSON_Duplicate(old, 1) : NULL;

		if (cJSON_IsNull(m)) {
			cJSON_DeleteItemFromObjectCaseSensitive(target,
			    m->string);
			cJSON_Delete(copy);
		} else if (old) {
			cJSON_ReplaceItemInObjectCaseSensitive(target,
			    m->string, model_merge(copy, m));
		} else {
			cJSON_AddItemToObject(target, m->string,
			    model_merge(NULL, m));
		}
	}
	return target;
}

static void test_random_merges_against_the_rfcs_text(void **unused)
{
	struct random_stream r = {2};

	(void)unused;
	for (int i = 0; i < 5000; i++) {
		cJSON *root = random_value(&r, 4), *patch = random_value(&r, 4);
		char *text = cJSON_PrintUnformatted(root);
		char *edits = cJSON_PrintUnformatted(patch);
		struct outcome o = patch_text(text, edits, true);
		cJSON *result = cJSON_Parse(o.text);

		root = model_merge(root, patch);
		if (!cJSON_Compare(root, result, 1))
			fail_msg("%s with %s: %s", text, edits, o.text);
		cJSON_Delete(root);
		cJSON_Delete(patch);
		cJSON_Delete(result);
		free(text);
		free(edits);
		free(o.text);
	}
}

/* Spoilt patches: an error with a place, or a result; nothing else. */
static void test_spoilt_patches(void **unused)
{
	static const char text[] = "{\"a\":[1,{\"b\":2},[3]],\"c\":{\"d\":{}}}";
	static const char patch[] = "[{\"op\":\"move\",\"from\":\"/a/1/b\","
	    "\"path\":\"/c/d/e\"},{\"op\":\"copy\",\"from\":\"/a\",\"path\":"
	    "\"/a/-\"},{\"op\":\"remove\",\"path\":\"/a/0\"},{\"op\":\"test\","
	    "\"path\":\"/c\",\"value\":{\"d\":{\"e\":2}}},{\"op\":\"add\","
	    "\"path\":\"\",\"value\":[]}]";
	static const char bytes[] = "/~019-abc{}[]\",:opmv";
	struct random_stream r = {3};
	char spoilt[sizeof patch];

	(void)unused;
	for (int i = 0; i < 100000; i++) {
		struct outcome o;

		strcpy(spoilt, patch);
		for (int n = 1 + random_below(&r, 3); n > 0; n--)
			spoilt[random_below(&r, sizeof patch - 1)] =
			    bytes[random_below(&r, sizeof bytes - 1)];
		o = patch_text(text, spoilt, false);
		assert_true(o.err == ERR_OK || (o.err == ERR_SYNTAX ||
		    o.err == ERR_INVALID || o.err == ERR_CONFLICT));
		assert_true((o.err == ERR_OK) == (o.faults.count == 0));
		free(o.text);
	}
}

static void test_every_allocation_may_fail(void **unused)
{
	static const char patch[] = "[{\"op\":\"test\",\"path\":\"/a\","
	    "\"value\":[1]},{\"op\":\"copy\",\"from\":\"/a\",\"path\":\"/b\"},"
	    "{\"op\":\"move\",\"from\":\"/b\",\"path\":\"/a/0\"},{\"op\":"
	    "\"add\",\"path\":\"/c~1\",\"value\":{}}]";
	struct faults faults = {0};
	struct json_patch p = {NULL, false, 1000, 1000000};
	struct arena arena = {0};
	char *text, *out;
	cJSON *read;
	size_t length;
	enum err err;
	long n;

	(void)unused;
	if (!fail_alloc_available())
		skip();
	text = repeat("{\"a\":[1],\"long\":\"", "long", 1000, "\"}");
	assert_int_equal(json_patch_read(patch, strlen(patch), 1000, &arena,
	    &read, &faults), ERR_OK);
	p.patch = read;
	for (n = 1;; n++) {
		out = NULL;
		fail_alloc_set(n);
		err = json_patch_text(&p, text, strlen(text), &out, &length,
		    &faults);
		if (!fail_alloc_happened())
			break;
		assert_int_equal(err, ERR_MEMORY);
		assert_null(out);
		assert_int_equal(fail_alloc_live(), 0);
	}
	fail_alloc_set(0);
	assert_int_equal(err, ERR_OK);
	assert_true(n > 5);
	free(out);
	free(text);
	arena_fini(&arena);
}

int main(void)
{
	const struct CMUnitTest tests[] = {
		cmocka_unit_test(test_examples_of_rfc_6902),
		cmocka_unit_test(test_pointers_of_rfc_6901),
		cmocka_unit_test(test_examples_of_rfc_7396),
		cmocka_unit_test(test_the_whole_document_is_a_place),
		cmocka_unit_test(test_equality_is_of_values),
		cmocka_unit_test(test_errors_name_the_place_in_the_patch),
		cmocka_unit_test(test_moves_beside_itself),
		cmocka_unit_test(test_numbers_stay_as_they_are_spelt),
		cmocka_unit_test(test_printed_doubles_read_back),
		cmocka_unit_test(test_strings_survive),
		cmocka_unit_test(test_what_changes_nothing_keeps_the_text),
		cmocka_unit_test(test_a_failed_patch_changes_nothing),
		cmocka_unit_test(test_copies_of_copies_end),
		cmocka_unit_test(test_a_long_string_copied_often_ends),
		cmocka_unit_test(test_depth_is_bounded),
		cmocka_unit_test(test_too_many_operations),
		cmocka_unit_test(test_work_is_bounded),
		cmocka_unit_test(test_random_edits_against_a_model),
		cmocka_unit_test(test_random_merges_against_the_rfcs_text),
		cmocka_unit_test(test_spoilt_patches),
		cmocka_unit_test(test_every_allocation_may_fail),
	};

	return cmocka_run_group_tests(tests, NULL, NULL);
}
