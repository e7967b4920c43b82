#include <stdarg.h>
#include <stddef.h>
#include <setjmp.h>
#include <stdint.h>
#include <cmocka.h>

#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "core/output.h"
#include "proto/document.h"
#include "proto/fault.h"
#include "proto/request.h"
#include "tests/support/fail_alloc.h"

#define COUNT(array) (sizeof(array) / sizeof *(array))
#define BOTH (OUTPUT_VALUE | OUTPUT_GRADIENT)
#define SCENE "{'format':'blobfield/1','root':{'type':'point'," \
	"'center':[0,0,0],'radius':1}}"

static const struct document_limits limits = {.max_nodes = 100,
    .layout = LAYOUT_WARPED};

static void test_media_names(void **unused)
{
	(void)unused;
	assert_string_equal(media_name(MEDIA_JSON), "application/json");
	assert_string_equal(media_name(MEDIA_OCTETS),
	    "application/octet-stream");
	assert_string_equal(media_name(MEDIA_NPY), "application/x-npy");
	assert_string_equal(media_name(MEDIA_PROBLEM),
	    "application/problem+json");
}

static void test_content_types(void **unused)
{
	static const struct {
		const char *value;
		int type; /* -1: refused */
	} cases[] = {
		{NULL, -1}, {"", -1}, {"  ", -1},
		{"application/json", MEDIA_JSON},
		{" Application/JSON ", MEDIA_JSON},
		{"application/json; charset=utf-8", MEDIA_JSON},
		{"application/json;charset=\"UTF-8\"", MEDIA_JSON},
		{"application/json ; a=\"x;\\\"y\" ; charset=utf-8", MEDIA_JSON},
		{"application/json;", MEDIA_JSON},
		{"application/octet-stream", MEDIA_OCTETS},
		{"application/x-npy", MEDIA_NPY},
		{"application/json; charset=latin1", -1},
		{"application/json; charset=\"", -1},
		{"application/json garbage", -1},
		{"application/jso", -1}, {"application/jsonx", -1},
		{"application/problem+json", -1}, {"text/plain", -1},
		{"*/*", -1}, {"application", -1}, {";", -1},
		{"application/x-www-form-urlencoded", -1},
	};
	enum media_type type;
	bool fine;
	size_t i;

	(void)unused;
	for (i = 0; i < COUNT(cases); i++) {
		fine = media_from_content_type(cases[i].value, &type);
		if (fine != (cases[i].type >= 0) ||
		    (fine && (int)type != cases[i].type))
			fail_msg("%s", cases[i].value);
	}
}

static void test_accept(void **unused)
{
	static const struct {
		const char *value;
		int type;
	} cases[] = {
		{NULL, MEDIA_JSON}, {"", MEDIA_JSON}, {"*/*", MEDIA_JSON},
		{"application/*", MEDIA_JSON},
		{"application/json", MEDIA_JSON},
		{"application/x-npy", MEDIA_NPY},
		{"APPLICATION/X-NPY", MEDIA_NPY},
		{"application/octet-stream, */*", MEDIA_JSON},
		{"application/octet-stream, */*;q=0.5", MEDIA_OCTETS},
		{"application/x-npy, application/octet-stream", MEDIA_OCTETS},
		{"application/octet-stream;q=0.2,application/x-npy;q=0.3",
		    MEDIA_NPY},
		{"application/json;q=0,*/*", MEDIA_OCTETS},
		{"application/json;q=0, application/octet-stream;q=0.000, */*",
		    MEDIA_NPY},
		{"*/*;q=0.1, application/json;q=0.05", MEDIA_OCTETS},
		{"text/html,application/xhtml+xml,*/*;q=0.8", MEDIA_JSON},
		{"application/json;charset=utf-8", MEDIA_JSON},
		{"application/json; q = 1", -1},
		{",, application/x-npy ,", MEDIA_NPY},
		{"application/json;q=2, application/x-npy;q=0.1", MEDIA_NPY},
		{"text/html", -1}, {"application/json;q=0", -1},
		{"*/*;q=0", -1}, {"text/*", -1}, {"application", -1},
		{"application/jso*", -1},
	};
	enum media_type type;
	bool fine;
	size_t i;

	(void)unused;
	for (i = 0; i < COUNT(cases); i++) {
		fine = media_from_accept(cases[i].value, &type);
		if (fine != (cases[i].type >= 0) ||
		    (fine && (int)type != cases[i].type))
			fail_msg("%s: %d", cases[i].value,
			    fine ? (int)type : -1);
	}
}

static void test_outputs_as_a_list(void **unused)
{
	static const struct {
		const char *value;
		unsigned outputs; /* 0: refused */
		const char *words;
	} cases[] = {
		{NULL, BOTH, ""},
		{"value", OUTPUT_VALUE, ""},
		{"gradient,value", BOTH, ""},
		{" value , hessian ", OUTPUT_VALUE | OUTPUT_HESSIAN, ""},
		{"hessian,gradient,value", BOTH | OUTPUT_HESSIAN, ""},
		{"", 0, "unknown output ''"},
		{"value,", 0, "unknown output ''"},
		{"values", 0, "unknown output 'values'"},
		{"value,value", 0, "'value' is given twice"},
		{"value gradient", 0, "separated by commas"},
		{"color,normal,curvature", OUTPUT_COLOR | OUTPUT_NORMAL |
		    OUTPUT_CURVATURE, NULL},
	};
	struct faults faults;
	unsigned outputs;
	enum err err;
	size_t i;

	(void)unused;
	for (i = 0; i < COUNT(cases); i++) {
		faults = (struct faults){0};
		outputs = 0;
		err = outputs_from_list(cases[i].value, "/x", &outputs,
		    &faults);
		assert_int_equal(outputs, cases[i].outputs);
		assert_int_equal(err, outputs ? ERR_OK : ERR_INVALID);
		if (outputs)
			continue;
		assert_string_equal(faults.list[0].pointer, "/x");
		if (!strstr(faults.list[0].detail, cases[i].words))
			fail_msg("%s: %s", cases[i].value,
			    faults.list[0].detail);
	}
}

/* Parses text, with " for '; it does not end in NUL. */
static enum err parse(const char *text, bool with_scene,
    struct eval_request *request, struct faults *faults)
{
	const size_t length = strlen(text);
	char *copy = malloc(length ? length : 1);
	enum err err;
	size_t i;

	assert_non_null(copy);
	for (i = 0; i < length; i++)
		copy[i] = text[i] == '\'' ? '"' : text[i];
	*request = (struct eval_request){0};
	*faults = (struct faults){0};
	err = eval_request_parse(copy, length, with_scene, OUTPUT_VALUE,
	    &limits, 3, request, faults);
	free(copy);
	return err;
}

static void test_bodies(void **unused)
{
	static const struct {
		const char *text;
		bool with_scene;
		size_t count;
		unsigned outputs;
	} cases[] = {
		{"{'points':[]}", false, 0, OUTPUT_VALUE},
		{" {\n'outputs' : ['gradient'] , 'points' : [1,2,3] } ", false,
		    1, OUTPUT_GRADIENT},
		{"{'points':[[1,2,3],[1,2,3]],'outputs':['hessian','value']}",
		    false, 2, OUTPUT_HESSIAN | OUTPUT_VALUE},
		{"{'scene':" SCENE ",'points':[[1,2,3]]}", true, 1,
		    OUTPUT_VALUE},
		{"{'points':[[1,2,3]],'outputs':['value'],'scene':" SCENE "}",
		    true, 1, OUTPUT_VALUE},
		{"{'\\u0070oints':[]}", false, 0, OUTPUT_VALUE},
	};
	struct eval_request request;
	struct faults faults;
	size_t i;

	(void)unused;
	for (i = 0; i < COUNT(cases); i++) {
		if (parse(cases[i].text, cases[i].with_scene, &request,
		    &faults) != ERR_OK)
			fail_msg("%s: %s", cases[i].text,
			    faults.list[0].detail);
		assert_int_equal(request.points.count, cases[i].count);
		assert_int_equal(request.outputs, cases[i].outputs);
		assert_int_equal(request.document != NULL,
		    cases[i].with_scene);
		eval_request_fini(&request);
		assert_null(request.document);
	}
}

static const struct {
	const char *text;
	bool with_scene;
	enum err err;
	const char *pointer, *words;
} wrong[] = {
	{"", false, ERR_SYNTAX, "", "expected a value"},
	{"[]", false, ERR_INVALID, "", "must be an object, not an array"},
	{"3", false, ERR_INVALID, "", "must be an object, not a number"},
	{"{}", false, ERR_INVALID, "", "'points' is missing"},
	{"{}", true, ERR_INVALID, "", "'scene' is missing"},
	{"{'points'", false, ERR_SYNTAX, "/points", "expected ':'"},
	{"{'points':[1,2,3]", false, ERR_SYNTAX, "", "expected ',' or '}'"},
	{"{'points':[1,2,3],}", false, ERR_SYNTAX, "", "expected a string"},
	{"{'points':[]} x", false, ERR_SYNTAX, "",
	    "line 1, column 15 (byte 14): something follows"},
	{"{'points':[],'points':[]}", false, ERR_SYNTAX, "/points", "twice"},
	{"{'outputs':['value'],'points':[],'outputs':['value']}", false,
	    ERR_SYNTAX, "/outputs", "twice"},
	{"{'scene':1,'scene':1}", true, ERR_SYNTAX, "/scene", "twice"},
	{"{'points':[],'points':", false, ERR_SYNTAX, "/points",
	    "(byte 22): this member comes twice"},
	{"{'points':[],\n'outputs':[tru]}", false, ERR_SYNTAX, "/outputs/0",
	    "line 2, column 12"},
	{"{\n'points':[1,2,x]}", false, ERR_SYNTAX, "/points/2",
	    "line 2, column 15"},
	{"{'points':[1,2,1e39]}", false, ERR_INVALID, "/points/2",
	    "point 0: z is not finite"},
	{"{'points':[[1,2]]}", false, ERR_INVALID, "/points/0", "fewer"},
	{"{'points':[1,2,3,1,2,3,1,2,3,1,2,3]}", false, ERR_LIMIT, "/points",
	    "more than 3 points"},
	{"{'points':[],'outputs':[]}", false, ERR_INVALID, "/outputs",
	    "1 or more"},
	{"{'points':[],'outputs':'value'}", false, ERR_INVALID, "/outputs",
	    "1 or more"},
	{"{'points':[],'outputs':['value',3]}", false, ERR_INVALID,
	    "/outputs/1", "must be a string, not a number"},
	{"{'points':[],'outputs':['normals']}", false, ERR_INVALID,
	    "/outputs/0", "unknown output 'normals'"},
	{"{'points':[],'outputs':['value','value']}", false, ERR_INVALID,
	    "/outputs/1", "twice"},
	{"{'points':[],'colour':{}}", false, ERR_INVALID, "/colour",
	    "unknown field 'colour'"},
	{"{'points':[],'scene':{}}", false, ERR_INVALID, "/scene",
	    "the URL names"},
	{"{'points':[],'scene':{}}", true, ERR_INVALID, "/scene",
	    "'root' is missing"},
	{"{'points':[],'scene':7}", true, ERR_INVALID, "/scene",
	    "not a number"},
	{"{'points':[],'scene':{'format':'blobfield/1','root':{'type':"
	    "'point','radius':-1,'center':[0,0,0]}}}", true, ERR_INVALID,
	    "/scene/root/radius", "between"},
};

static void test_wrong_bodies_are_refused(void **unused)
{
	struct eval_request request;
	struct faults faults;
	enum err err;
	size_t i, k;

	(void)unused;
	for (i = 0; i < COUNT(wrong); i++) {
		err = parse(wrong[i].text, wrong[i].with_scene, &request,
		    &faults);
		for (k = 0; k < faults.count && k < FAULT_MAX; k++) {
			if (strcmp(faults.list[k].pointer,
			    wrong[i].pointer) == 0 &&
			    strstr(faults.list[k].detail, wrong[i].words))
				break;
		}
		if (err != wrong[i].err || k == faults.count ||
		    request.document || request.points.xyz)
			fail_msg("%s: %s, %s: %s", wrong[i].text,
			    err_message(err), faults.list[0].pointer,
			    faults.list[0].detail);
	}
}

static void test_faults_of_all_members_are_collected(void **unused)
{
	struct eval_request request;
	struct faults faults;

	(void)unused;
	assert_int_equal(parse("{'a':1,'scene':{'format':2,'root':3},"
	    "'outputs':['x']}", true, &request, &faults), ERR_INVALID);
	/* a, x, points is missing, format, root */
	assert_int_equal(faults.count, 5);
}

static void test_wrong_points_do_not_hide_other_faults(void **unused)
{
	static const char *const points[] = {"'many'", "{'x':[{}],'y':null}",
	    "[[1,2]]", "[1,2,3,4]", "[[1,2,1e39],[4,\"[\",6],{'a':{}}, [ ]]",
	    "[[1,null,3],[true,false,-0.5e1]]", "-1"};
	struct eval_request request;
	struct faults faults;
	char text[256];
	size_t i;

	(void)unused;
	for (i = 0; i < COUNT(points); i++) {
		snprintf(text, sizeof text, "{'points': %s ,'scene':{"
		    "'format':2,'root':3},'outputs':['x']}", points[i]);
		assert_int_equal(parse(text, true, &request, &faults),
		    ERR_INVALID);
		/* points, x, format, root */
		assert_int_equal(faults.count, 4);
		assert_int_equal(strncmp(faults.list[0].pointer, "/points", 7),
		    0);
		assert_string_equal(faults.list[3].pointer, "/scene/root");
	}
}

static void test_wrong_points_are_still_read_as_json(void **unused)
{
	static const struct {
		const char *points, *words;
	} cases[] = {
		{"[[1e39,2,3],[4,x]]", "column 26 (byte 25): expected a value"},
		{"[[1e39,2,3],[4,01]]", "(byte 26): not a JSON number"},
		{"[[1e39,2,3],{'a'}]", "expected ':'"},
		{"[[1e39,2,3],{'a':1,}]", "expected a string"},
		{"[[1e39,2,3],{'a':1]", "expected ',' or '}'"},
		{"[[1e39,2,3],'\\q']", "unknown escape"},
		{"[[1e39,2,3],nul]", "expected a value"},
		{"[[1e39,2,3],", "expected a value, but the text ends"},
	};
	struct eval_request request;
	struct faults faults;
	char text[256];
	size_t i;

	(void)unused;
	for (i = 0; i < COUNT(cases); i++) {
		snprintf(text, sizeof text, "{'points':%s", cases[i].points);
		assert_int_equal(parse(text, false, &request, &faults),
		    ERR_SYNTAX);
		assert_int_equal(faults.count, 2);
		assert_string_equal(faults.list[0].pointer, "/points/0/0");
		if (!strstr(faults.list[1].detail, cases[i].words))
			fail_msg("%s: %s", text, faults.list[1].detail);
	}
}

static void test_wrong_points_may_not_be_nested_for_ever(void **unused)
{
	const size_t depth = 100000;
	char *text = malloc(depth + 16);
	struct eval_request request = {0};
	struct faults faults = {0};

	(void)unused;
	assert_non_null(text);
	strcpy(text, "{\"points\":[1,");
	memset(text + 13, '[', depth);
	assert_int_equal(eval_request_parse(text, 13 + depth, false,
	    OUTPUT_VALUE, &limits, 3, &request, &faults), ERR_LIMIT);
	assert_int_equal(faults.count, 2);
	free(text);
}

static void test_unknown_members_are_bounded(void **unused)
{
	const size_t n = 300000;
	char *text = malloc(n);
	struct eval_request request = {0};
	struct faults faults = {0};
	size_t i;

	(void)unused;
	assert_non_null(text);
	i = (size_t)sprintf(text, "{\"x\":[");
	for (; i + 1 < n; i += 2)
		memcpy(text + i, "0,", 2);
	assert_int_equal(eval_request_parse(text, i, false, OUTPUT_VALUE,
	    &limits, 3, &request, &faults), ERR_LIMIT);
	free(text);
}

/* Parses text again and again, the nth allocation failing; the last n. */
static long fail_each_allocation(const char *text)
{
	struct eval_request request = {0};
	struct faults faults = {0};
	enum err err;
	long n;

	for (n = 1;; n++) {
		fail_alloc_set(n);
		err = eval_request_parse(text, strlen(text), true, BOTH,
		    &limits, 3, &request, &faults);
		if (!fail_alloc_happened())
			break;
		/* Shrinking the points may fail; then they stay as they are. */
		if (err == ERR_OK)
			eval_request_fini(&request);
		else
			assert_int_equal(err, ERR_MEMORY);
		assert_int_equal(fail_alloc_live(), 0);
		assert_null(request.document);
	}
	eval_request_fini(&request);
	assert_int_equal(fail_alloc_live(), 0);
	fail_alloc_set(0);
	assert_int_equal(faults.count, 0);
	return n;
}

/* An arena's blocks are filled at other places with every length of name. */
static void test_every_allocation_may_fail(void **unused)
{
	char text[1024], name[256], *p;
	int length;

	(void)unused;
	if (!fail_alloc_available())
		skip();
	memset(name, 'n', sizeof name);
	for (length = 0; length < 256; length += 16) {
		snprintf(text, sizeof text, "{'scene':{'name':'%.*s',"
		    "'format':'blobfield/1','root':{'type':'point',"
		    "'center':[0,0,0],'radius':1}},'points':[[1,2,3]],"
		    "'outputs':['value']}", length, name);
		for (p = text; *p; p++) {
			if (*p == '\'')
				*p = '"';
		}
		assert_true(fail_each_allocation(text) > 8);
	}
}

int main(void)
{
	const struct CMUnitTest tests[] = {
		cmocka_unit_test(test_media_names),
		cmocka_unit_test(test_content_types),
		cmocka_unit_test(test_accept),
		cmocka_unit_test(test_outputs_as_a_list),
		cmocka_unit_test(test_bodies),
		cmocka_unit_test(test_wrong_bodies_are_refused),
		cmocka_unit_test(test_faults_of_all_members_are_collected),
		cmocka_unit_test(test_wrong_points_do_not_hide_other_faults),
		cmocka_unit_test(test_wrong_points_are_still_read_as_json),
		cmocka_unit_test(test_wrong_points_may_not_be_nested_for_ever),
		cmocka_unit_test(test_unknown_members_are_bounded),
		cmocka_unit_test(test_every_allocation_may_fail),
	};

	return cmocka_run_group_tests(tests, NULL, NULL);
}
