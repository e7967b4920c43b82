/*
 * Bodies of mesh requests.
 */
#include <stdarg.h>
#include <stddef.h>
#include <setjmp.h>
#include <stdint.h>
#include <cmocka.h>

#include <string.h>

#include "proto/fault.h"
#include "proto/mesh_request.h"
#include "tests/support/fail_alloc.h"
#include "tests/support/near.h"

static struct mesh_request parse(const char *text)
{
	struct faults faults = {0};
	struct mesh_request request;
	enum err err = mesh_request_parse(text, strlen(text), &request,
	    &faults);

	if (err != ERR_OK)
		print_error("%s: %s\n", faults.list[0].pointer,
		    faults.list[0].detail);
	assert_int_equal(err, ERR_OK);
	return request;
}

static void test_an_empty_body_gives_the_defaults(void **state)
{
	const struct mesh_request r = parse("{}");

	(void)state;
	assert_false(r.has_bounds);
	assert_int_equal(r.resolution, 64);
	assert_near(r.iso, 0.5, 0.0);
	assert_true(r.features);
	assert_true(r.normals);
	assert_true(r.colors);
	assert_false(r.has_format);
}

static void test_every_member_is_read(void **state)
{
	const struct mesh_request r = parse("{\"bounds\":{\"min\":[-1,-2,-3],"
	    "\"max\":[4,5,6.5]},\"resolution\":1024,\"iso\":0.25,\"features\":"
	    "false,\"normals\":false,\"colors\":false,\"format\":\"stl\"}");

	(void)state;
	assert_true(r.has_bounds);
	assert_near(r.min.x, -1.0, 0.0);
	assert_near(r.min.z, -3.0, 0.0);
	assert_near(r.max.y, 5.0, 0.0);
	assert_near(r.max.z, 6.5, 0.0);
	assert_int_equal(r.resolution, 1024);
	assert_near(r.iso, 0.25, 0.0);
	assert_false(r.features);
	assert_false(r.normals);
	assert_false(r.colors);
	assert_true(r.has_format);
	assert_int_equal(r.format, MEDIA_STL);
}

static void test_an_edge_length_stands_for_a_resolution(void **state)
{
	const struct mesh_request r = parse("{\"edge_length\":0.125}");

	(void)state;
	assert_int_equal(r.resolution, 0);
	assert_near(r.edge_length, 0.125, 0.0);
}

static void test_formats_have_names(void **state)
{
	static const struct {
		const char *name;
		enum media_type type;
	} cases[] = {{"glb", MEDIA_GLB}, {"ply", MEDIA_PLY},
	    {"stl", MEDIA_STL}, {"obj", MEDIA_OBJ}, {"json", MEDIA_JSON}};
	enum media_type type;

	(void)state;
	for (size_t i = 0; i < sizeof cases / sizeof *cases; i++) {
		assert_true(mesh_request_format(cases[i].name, &type));
		assert_int_equal(type, cases[i].type);
	}
	assert_false(mesh_request_format("", &type));
	assert_false(mesh_request_format("GLB", &type));
	assert_false(mesh_request_format("gltf", &type));
}

static void test_what_is_wrong_is_said_where_it_is(void **state)
{
	static const struct {
		const char *text, *pointer;
		enum err err;
	} cases[] = {
		{"", "", ERR_SYNTAX},
		{"{", "", ERR_SYNTAX},
		{"{\"iso\":1,\"iso\":1}", "/iso", ERR_SYNTAX},
		{"[]", "", ERR_INVALID},
		{"{\"resolution\":1}", "/resolution", ERR_INVALID},
		{"{\"resolution\":1025}", "/resolution", ERR_INVALID},
		{"{\"resolution\":2.5}", "/resolution", ERR_INVALID},
		{"{\"resolution\":\"64\"}", "/resolution", ERR_INVALID},
		{"{\"resolution\":1e999}", "/resolution", ERR_INVALID},
		{"{\"edge_length\":0}", "/edge_length", ERR_INVALID},
		{"{\"edge_length\":-1}", "/edge_length", ERR_INVALID},
		{"{\"edge_length\":1,\"resolution\":64}", "/edge_length",
		    ERR_INVALID},
		{"{\"iso\":0}", "/iso", ERR_INVALID},
		{"{\"iso\":1001}", "/iso", ERR_INVALID},
		{"{\"iso\":null}", "/iso", ERR_INVALID},
		{"{\"features\":1}", "/features", ERR_INVALID},
		{"{\"normals\":\"yes\"}", "/normals", ERR_INVALID},
		{"{\"colors\":null}", "/colors", ERR_INVALID},
		{"{\"format\":\"fbx\"}", "/format", ERR_INVALID},
		{"{\"format\":2}", "/format", ERR_INVALID},
		{"{\"bounds\":[]}", "/bounds", ERR_INVALID},
		{"{\"bounds\":{\"min\":[0,0,0]}}", "/bounds", ERR_INVALID},
		{"{\"bounds\":{\"min\":[0,0,0],\"max\":[1,1,1],\"mid\":0}}",
		    "/bounds/mid", ERR_INVALID},
		{"{\"bounds\":{\"min\":[0,0,0],\"max\":[1,1]}}",
		    "/bounds/max", ERR_INVALID},
		{"{\"bounds\":{\"min\":[0,0,2e9],\"max\":[1,1,1]}}",
		    "/bounds/min/2", ERR_INVALID},
		{"{\"bounds\":{\"min\":[0,0,0],\"max\":[1,0,1]}}",
		    "/bounds/max/1", ERR_INVALID},
		{"{\"bounds\":{\"min\":[0,0,0],\"max\":[1,1,-1]}}",
		    "/bounds/max/2", ERR_INVALID},
		{"{\"resolutoin\":64}", "/resolutoin", ERR_INVALID},
	};

	(void)state;
	for (size_t i = 0; i < sizeof cases / sizeof *cases; i++) {
		struct faults faults = {0};
		struct mesh_request r = {.iso = 7.0};
		enum err err = mesh_request_parse(cases[i].text,
		    strlen(cases[i].text), &r, &faults);

		if (err != cases[i].err)
			fail_msg("%s: error %d", cases[i].text, err);
		assert_true(faults.count >= 1);
		assert_string_equal(faults.list[0].pointer, cases[i].pointer);
		assert_near(r.iso, 7.0, 0.0);
	}
}

static void test_every_fault_is_said_at_once(void **state)
{
	static const char text[] = "{\"resolution\":0,\"iso\":-1,\"format\":"
	    "\"x\",\"features\":3,\"bounds\":{\"min\":7,\"max\":[0]},"
	    "\"more\":1}";
	struct mesh_request r;
	struct faults faults = {0};

	(void)state;
	assert_int_equal(mesh_request_parse(text, strlen(text), &r, &faults),
	    ERR_INVALID);
	assert_int_equal(faults.count, 7);
}

static void test_parsing_without_memory(void **state)
{
	static const char text[] = "{\"format\":\"ply\",\"iso\":0.5}";
	enum err err = ERR_MEMORY;

	(void)state;
	if (!fail_alloc_available())
		skip();
	for (long n = 1; err == ERR_MEMORY && n < 1000; n++) {
		struct faults faults = {0};
		struct mesh_request r;

		fail_alloc_set(n);
		err = mesh_request_parse(text, sizeof text - 1, &r, &faults);
		assert_int_equal(fail_alloc_live(), 0);
	}
	fail_alloc_set(0);
	assert_int_equal(err, ERR_OK);
}

int main(void)
{
	const struct CMUnitTest tests[] = {
		cmocka_unit_test(test_an_empty_body_gives_the_defaults),
		cmocka_unit_test(test_every_member_is_read),
		cmocka_unit_test(test_an_edge_length_stands_for_a_resolution),
		cmocka_unit_test(test_formats_have_names),
		cmocka_unit_test(test_what_is_wrong_is_said_where_it_is),
		cmocka_unit_test(test_every_fault_is_said_at_once),
		cmocka_unit_test(test_parsing_without_memory),
	};

	return cmocka_run_group_tests_name("mesh request", tests, NULL, NULL);
}
