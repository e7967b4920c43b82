/*
 * Bodies about rays, projections, pictures and slices.
 */
#include <stdarg.h>
#include <stddef.h>
#include <setjmp.h>
#include <stdint.h>
#include <cmocka.h>

#include <math.h>
#include <stdlib.h>
#include <string.h>

#include <cjson/cJSON.h>

#include "core/output.h"
#include "core/project.h"
#include "proto/fault.h"
#include "proto/geometry_answer.h"
#include "proto/geometry_request.h"
#include "tests/support/fail_alloc.h"
#include "tests/support/near.h"
#include "tests/support/npy.h"

#define COUNT(array) (sizeof(array) / sizeof *(array))
#define RAYS_MAX 4

static struct faults faults;

static enum err parse_rays(const char *text, struct raycast_request *out)
{
	*out = (struct raycast_request){.terms = geometry_defaults()};
	faults = (struct faults){0};
	return raycast_request_parse(text, strlen(text), MEDIA_JSON, RAYS_MAX,
	    out, &faults);
}

static enum err parse_points(const char *text, struct project_request *out)
{
	*out = (struct project_request){.terms = geometry_defaults()};
	faults = (struct faults){0};
	return project_request_parse(text, strlen(text), MEDIA_JSON, RAYS_MAX,
	    out, &faults);
}

static enum err parse_render(const char *text, struct render_request *out)
{
	faults = (struct faults){0};
	return render_request_parse(text, strlen(text), 8000000, out, &faults);
}

static enum err parse_slice(const char *text, struct slice_request *out)
{
	faults = (struct faults){0};
	return slice_request_parse(text, strlen(text), 8000000, out, &faults);
}

/* ---- rays ---- */

static void test_rays_nested_and_flat(void **state)
{
	static const float expected[12] = {1, 2, 3, 0, 0, -1, 4, 5, 6, 1e-3f,
	    0, 0};
	struct raycast_request r;

	(void)state;
	assert_int_equal(parse_rays("{\"rays\":[[1,2,3,0,0,-1], "
	    "[4,5,6,1e-3,0,0]],\"iso\":0.25,\"tolerance\":0.01,"
	    "\"max_distance\":7}", &r), ERR_OK);
	assert_int_equal(r.rays.count, 2);
	assert_false(r.rays.flat);
	assert_memory_equal(r.rays.numbers, expected, sizeof expected);
	assert_near(r.terms.iso, 0.25, 0.0);
	assert_near(r.terms.tolerance, 0.01, 0.0);
	assert_near(r.terms.max_distance, 7.0, 0.0);
	raycast_request_fini(&r);
	assert_int_equal(parse_rays(" { \"rays\" : [ 1 ,2,3,0,0,-1,4,5,6,"
	    "1e-3,0,0 ] } ", &r), ERR_OK);
	assert_int_equal(r.rays.count, 2);
	assert_true(r.rays.flat);
	assert_memory_equal(r.rays.numbers, expected, sizeof expected);
	assert_near(r.terms.iso, 0.5, 0.0);
	assert_true(isinf(r.terms.max_distance));
	raycast_request_fini(&r);
	assert_int_equal(parse_rays("{\"rays\":[]}", &r), ERR_OK);
	assert_int_equal(r.rays.count, 0);
	raycast_request_fini(&r);
}

static void test_wrong_rays_are_named(void **state)
{
	static const struct {
		const char *text;
		enum err err;
		const char *pointer;
	} cases[] = {
		{"", ERR_SYNTAX, ""},
		{"[]", ERR_INVALID, ""},
		{"{}", ERR_INVALID, ""},
		{"{\"rays\":1}", ERR_INVALID, "/rays"},
		{"{\"rays\":[1]}", ERR_INVALID, "/rays"},
		{"{\"rays\":[[1,2,3]]}", ERR_INVALID, "/rays/0"},
		{"{\"rays\":[[1,2,3,4,5,6],[1,2,3,4,5,6,7]]}", ERR_INVALID,
		    "/rays/1"},
		{"{\"rays\":[[1,2,3,4,5,6],[1,2,\"3\",4,5,6]]}", ERR_INVALID,
		    "/rays/1"},
		{"{\"rays\":[[1,2,3,4,5,6],7]}", ERR_INVALID, "/rays/1"},
		{"{\"rays\":[[]]}", ERR_INVALID, "/rays/0"},
		{"{\"rays\":[[0,0,0,0,0,0]]}", ERR_INVALID, "/rays/0"},
		{"{\"rays\":[[0,0,0,0,0,-0.0]]}", ERR_INVALID, "/rays/0"},
		{"{\"rays\":[[0,0,0,0,0,1e-60]]}", ERR_INVALID, "/rays/0"},
		{"{\"rays\":[[1e39,0,0,0,0,1]]}", ERR_INVALID, "/rays/0"},
		{"{\"rays\":[[2e9,0,0,0,0,1]]}", ERR_INVALID, "/rays/0"},
		{"{\"rays\":[[1,2,3,4,5,6],[1,2,3,4,5,6],[1,2,3,4,5,6],"
		    "[1,2,3,4,5,6],[1,2,3,4,5,6]]}", ERR_LIMIT, "/rays"},
		{"{\"rays\":[[1,2,3,4,5,6]", ERR_SYNTAX, "/rays"},
		{"{\"rays\":[[1,2,3,4,5,06]]}", ERR_SYNTAX, "/rays"},
		{"{\"rays\":[[1,2,3,4,5,6]],\"rays\":[]}", ERR_SYNTAX,
		    "/rays"},
		{"{\"rays\":[],\"iso\":1,\"iso\":1}", ERR_SYNTAX, "/iso"},
		{"{\"rays\":[],\"iso\":0}", ERR_INVALID, "/iso"},
		{"{\"rays\":[],\"iso\":\"a\"}", ERR_INVALID, "/iso"},
		{"{\"rays\":[],\"max_distance\":0}", ERR_INVALID,
		    "/max_distance"},
		{"{\"rays\":[],\"tolerance\":-1}", ERR_INVALID,
		    "/tolerance"},
		{"{\"rays\":[],\"ray\":-1}", ERR_INVALID, "/ray"},
	};
	struct raycast_request r;

	(void)state;
	for (size_t i = 0; i < COUNT(cases); i++) {
		enum err err = parse_rays(cases[i].text, &r);

		if (err != cases[i].err || faults.count == 0 ||
		    strcmp(faults.list[0].pointer, cases[i].pointer) != 0)
			fail_msg("%s: %d at '%s' (%s)", cases[i].text, err,
			    faults.list[0].pointer, faults.list[0].detail);
	}
}

static void test_all_wrong_rays_are_told(void **state)
{
	struct raycast_request r;

	(void)state;
	assert_int_equal(parse_rays("{\"rays\":[[0,0,0,0,0,0],[0,0,0,0,0,1],"
	    "[0,0,0,0,0,0]],\"iso\":-1}", &r), ERR_INVALID);
	assert_int_equal(faults.count, 3);
	assert_string_equal(faults.list[1].pointer, "/rays/2");
	assert_string_equal(faults.list[2].pointer, "/iso");
}

static void test_rays_as_numbers(void **state)
{
	static const float rays[12] = {1, 2, 3, 0, 0, -1, 4, 5, 6, 1, 0, 0};
	static const double doubles[6] = {1, 2, 3, 0, 0, -1};
	struct raycast_request r = {.terms = geometry_defaults()};
	size_t length;
	char *file;

	(void)state;
	faults = (struct faults){0};
	assert_int_equal(raycast_request_parse((const char *)rays,
	    sizeof rays, MEDIA_OCTETS, RAYS_MAX, &r, &faults), ERR_OK);
	assert_int_equal(r.rays.count, 2);
	assert_memory_equal(r.rays.numbers, rays, sizeof rays);
	raycast_request_fini(&r);
	assert_int_equal(raycast_request_parse((const char *)rays, 25,
	    MEDIA_OCTETS, RAYS_MAX, &r, &faults), ERR_SYNTAX);
	assert_int_equal(raycast_request_parse((const char *)rays,
	    sizeof rays, MEDIA_OCTETS, 1, &r, &faults), ERR_LIMIT);
	file = npy_file("<f8", "False", "(1, 6)", doubles, sizeof doubles,
	    &length);
	assert_int_equal(raycast_request_parse(file, length, MEDIA_NPY,
	    RAYS_MAX, &r, &faults), ERR_OK);
	assert_int_equal(r.rays.count, 1);
	assert_memory_equal(r.rays.numbers, rays, 24);
	raycast_request_fini(&r);
	assert_int_equal(raycast_request_parse(file, length - 1, MEDIA_NPY,
	    RAYS_MAX, &r, &faults), ERR_SYNTAX);
	free(file);
	file = npy_file("<f4", "False", "(4, 3)", rays, sizeof rays, &length);
	assert_int_equal(raycast_request_parse(file, length, MEDIA_NPY,
	    RAYS_MAX, &r, &faults), ERR_INVALID);
	free(file);
}

static void test_query_of_rays(void **state)
{
	struct geometry_terms terms = geometry_defaults();

	(void)state;
	faults = (struct faults){0};
	assert_true(geometry_query("0.25", NULL, "1e-3", &terms, &faults));
	assert_near(terms.iso, 0.25, 0.0);
	assert_near(terms.tolerance, 1e-3, 0.0);
	assert_true(isinf(terms.max_distance));
	assert_false(geometry_query("", "x", "-1", &terms, &faults));
	assert_int_equal(faults.count, 3);
	assert_string_equal(faults.list[0].pointer, "?iso");
	assert_string_equal(faults.list[1].pointer, "?max_distance");
	assert_string_equal(faults.list[2].pointer, "?tolerance");
}

/* ---- projections ---- */

static void test_points_to_project(void **state)
{
	struct project_request r;

	(void)state;
	assert_int_equal(parse_points("{\"iso\":1,\"points\":[[1,2,3]]}", &r),
	    ERR_OK);
	assert_int_equal(r.points.count, 1);
	assert_near(r.terms.iso, 1.0, 0.0);
	project_request_fini(&r);
	assert_int_equal(parse_points("{\"points\":[[1,2,3],[1,-2e9,3]]}",
	    &r), ERR_INVALID);
	assert_string_equal(faults.list[0].pointer, "/points/1");
	assert_int_equal(parse_points("{\"points\":[[1,2]],\"tolerance\":1}",
	    &r), ERR_INVALID);
	assert_int_equal(faults.count, 2);
	assert_string_equal(faults.list[0].pointer, "/points/0");
	assert_string_equal(faults.list[1].pointer, "/tolerance");
}

/* ---- pictures ---- */

static void test_render_defaults(void **state)
{
	struct render_request r;

	(void)state;
	assert_int_equal(parse_render("{}", &r), ERR_OK);
	assert_int_equal(r.picture.width, 640);
	assert_int_equal(r.picture.height, 480);
	assert_int_equal(r.picture.samples, 4);
	assert_int_equal(r.picture.shading, SHADING_LIT);
	assert_false(r.has_camera);
	assert_false(r.picture.has_background);
	assert_near(r.picture.iso, 0.5, 0.0);
}

static void test_render_all_members(void **state)
{
	struct render_request r;

	(void)state;
	assert_int_equal(parse_render("{\"width\":4096,\"height\":1,"
	    "\"camera\":{\"eye\":[0,-3,4],\"target\":[0,0,0],\"up\":[0,3,0],"
	    "\"fov\":1,\"projection\":\"orthographic\"},\"shading\":"
	    "\"curvature\",\"background\":[0,0.5,1],\"samples\":9,"
	    "\"iso\":2}", &r), ERR_OK);
	assert_true(r.has_camera);
	assert_true(r.picture.camera.orthographic);
	assert_near(r.picture.camera.up.y, 1.0, 0.0);
	assert_near(r.picture.camera.view_height, 10.0 * tan(0.5), 1e-12);
	assert_int_equal(r.picture.shading, SHADING_CURVATURE);
	assert_true(r.picture.has_background);
	assert_near(r.picture.background.z, 1.0, 0.0);
	assert_int_equal(r.picture.samples, 9);
	assert_int_equal(parse_render("{\"background\":null}", &r), ERR_OK);
	assert_false(r.picture.has_background);
}

static void test_wrong_pictures_are_named(void **state)
{
	static const struct {
		const char *text;
		enum err err;
		const char *pointer;
	} cases[] = {
		{"", ERR_SYNTAX, ""},
		{"3", ERR_INVALID, ""},
		{"{\"width\":0}", ERR_INVALID, "/width"},
		{"{\"width\":4097}", ERR_INVALID, "/width"},
		{"{\"height\":1.5}", ERR_INVALID, "/height"},
		{"{\"height\":\"9\"}", ERR_INVALID, "/height"},
		{"{\"camera\":7}", ERR_INVALID, "/camera"},
		{"{\"camera\":{\"eye\":[0,0,0]}}", ERR_INVALID, "/camera"},
		{"{\"camera\":{\"eye\":[0,0,0],\"target\":[0,0,0]}}",
		    ERR_INVALID, "/camera/target"},
		{"{\"camera\":{\"eye\":[0,0,0],\"target\":[0,0,1],"
		    "\"up\":[0,0,0]}}", ERR_INVALID, "/camera/up"},
		{"{\"camera\":{\"eye\":[0,0,0],\"target\":[0,0,1],"
		    "\"fov\":4}}", ERR_INVALID, "/camera/fov"},
		{"{\"camera\":{\"eye\":[0,0,1e10],\"target\":[0,0,1]}}",
		    ERR_INVALID, "/camera/eye/2"},
		{"{\"camera\":{\"eye\":[0,0,0],\"target\":[0,0,1],"
		    "\"projection\":\"flat\"}}", ERR_INVALID,
		    "/camera/projection"},
		{"{\"shading\":\"flat\"}", ERR_INVALID, "/shading"},
		{"{\"shading\":1}", ERR_INVALID, "/shading"},
		{"{\"background\":[0,0,2]}", ERR_INVALID, "/background/2"},
		{"{\"background\":\"red\"}", ERR_INVALID, "/background"},
		{"{\"samples\":2}", ERR_INVALID, "/samples"},
		{"{\"samples\":16,\"width\":4096,\"height\":4096}", ERR_LIMIT,
		    ""},
		{"{\"colour\":2}", ERR_INVALID, "/colour"},
	};
	struct render_request r;

	(void)state;
	for (size_t i = 0; i < COUNT(cases); i++) {
		enum err err = parse_render(cases[i].text, &r);

		if (err != cases[i].err || faults.count == 0 ||
		    strcmp(faults.list[0].pointer, cases[i].pointer) != 0)
			fail_msg("%s: %d at '%s' (%s)", cases[i].text, err,
			    faults.list[0].pointer, faults.list[0].detail);
	}
}

static void test_slices(void **state)
{
	struct slice_request r;

	(void)state;
	assert_int_equal(parse_slice("{}", &r), ERR_OK);
	assert_int_equal(r.width, 512);
	assert_false(r.has_center);
	assert_false(r.has_extent);
	assert_near(r.normal.y, -1.0, 0.0);
	assert_near(r.levels[3], 0.4, 1e-15);
	assert_int_equal(r.output, 0);
	assert_int_equal(parse_slice("{\"normal\":[0,0,3],\"levels\":[3,1],"
	    "\"extent\":4,\"center\":[1,2,3],\"output\":\"curvature\"}", &r),
	    ERR_OK);
	assert_near(r.up.y, 1.0, 0.0);
	assert_int_equal(r.level_count, 2);
	assert_near(r.levels[0], 3.0, 0.0);
	assert_true(r.has_center);
	assert_near(r.extent, 4.0, 0.0);
	assert_int_equal(r.output, OUTPUT_CURVATURE);
	assert_int_equal(parse_slice("{\"levels\":[]}", &r), ERR_OK);
	assert_int_equal(r.level_count, 0);
}

static void test_wrong_slices_are_named(void **state)
{
	static const struct {
		const char *text;
		enum err err;
		const char *pointer;
	} cases[] = {
		{"[]", ERR_INVALID, ""},
		{"{\"normal\":[0,0,0]}", ERR_INVALID, "/normal"},
		{"{\"normal\":[0,0,1],\"up\":[0,0,-5]}", ERR_INVALID, "/up"},
		{"{\"extent\":0}", ERR_INVALID, "/extent"},
		{"{\"center\":[0,0]}", ERR_INVALID, "/center"},
		{"{\"levels\":3}", ERR_INVALID, "/levels"},
		{"{\"levels\":{}}", ERR_INVALID, "/levels"},
		{"{\"levels\":{\"step\":0}}", ERR_INVALID, "/levels/step"},
		{"{\"levels\":[1,null]}", ERR_INVALID, "/levels/1"},
		{"{\"output\":\"all\"}", ERR_INVALID, "/output"},
		{"{\"width\":4096,\"height\":4096}", ERR_LIMIT, ""},
	};
	struct slice_request r;

	(void)state;
	for (size_t i = 0; i < COUNT(cases); i++) {
		enum err err = parse_slice(cases[i].text, &r);

		if (err != cases[i].err || faults.count == 0 ||
		    strcmp(faults.list[0].pointer, cases[i].pointer) != 0)
			fail_msg("%s: %d at '%s' (%s)", cases[i].text, err,
			    faults.list[0].pointer, faults.list[0].detail);
	}
}

/* ---- answers ---- */

static cJSON *rays_json(bool is_flat)
{
	static const float rows[2 * RAY_COLUMNS] = {
		1, 2.5f, 1, 2, 3, 0.5f, 0, 0, -2, 0.25f, 0.5f, 1, 7,
		0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, -1,
	};
	static const char *const nodes[2] = {"/root", NULL};
	size_t length;
	cJSON *json;
	char *text;

	assert_int_equal(raycast_answer_json(rows, 2, nodes, is_flat, &text,
	    &length), ERR_OK);
	json = cJSON_ParseWithLength(text, length);
	assert_non_null(json);
	free(text);
	return json;
}

static void test_answer_of_rays(void **state)
{
	cJSON *json = rays_json(false), *item;
	char *text;

	(void)state;
	text = cJSON_PrintUnformatted(json);
	assert_string_equal(text, "{\"count\":2,\"hit\":[true,false],"
	    "\"distance\":[2.5,null],\"position\":[[1,2,3],null],"
	    "\"value\":[0.5,null],\"gradient\":[[0,0,-2],null],"
	    "\"normal\":[[0,0,1],null],\"color\":[[0.25,0.5,1],null],"
	    "\"node\":[\"/root\",null]}");
	free(text);
	cJSON_Delete(json);
	json = rays_json(true);
	item = cJSON_GetObjectItem(json, "normal");
	assert_int_equal(cJSON_GetArraySize(item), 6);
	assert_true(cJSON_IsNull(cJSON_GetArrayItem(item, 5)));
	cJSON_Delete(json);
}

static void test_answer_of_projections(void **state)
{
	static const float rows[PROJECTION_FLOATS] = {1, 1, 2, 3, -0.5f, 0.5f,
	    0, 1, 0};
	size_t length;
	char *text;

	(void)state;
	assert_int_equal(project_answer_json(rows, 1, false, &text, &length),
	    ERR_OK);
	assert_int_equal(length, strlen("{\"count\":1,\"converged\":[true],"
	    "\"position\":[[1,2,3]],\"distance\":[-0.5],\"value\":[0.5],"
	    "\"normal\":[[0,1,0]]}"));
	assert_memory_equal(text, "{\"count\":1,\"converged\":[true],"
	    "\"position\":[[1,2,3]],\"distance\":[-0.5],\"value\":[0.5],"
	    "\"normal\":[[0,1,0]]}", length);
	free(text);
	assert_int_equal(project_answer_json(rows, 0, false, &text, &length),
	    ERR_OK);
	assert_memory_equal(text, "{\"count\":0,\"converged\":[],", 26);
	free(text);
}

static void test_requests_without_memory(void **state)
{
	static const char text[] = "{\"iso\":1,\"rays\":[[1,2,3,4,5,6]]}";
	struct raycast_request r;
	enum err err = ERR_MEMORY;

	(void)state;
	if (!fail_alloc_available())
		skip();
	for (long n = 1; err != ERR_OK; n++) {
		fail_alloc_set(n);
		err = parse_rays(text, &r);
		if (err == ERR_OK)
			raycast_request_fini(&r);
		assert_int_equal(fail_alloc_live(), 0);
		assert_int_equal(err, fail_alloc_happened() ? ERR_MEMORY :
		    ERR_OK);
	}
	fail_alloc_set(0);
}

int main(void)
{
	const struct CMUnitTest tests[] = {
		cmocka_unit_test(test_rays_nested_and_flat),
		cmocka_unit_test(test_wrong_rays_are_named),
		cmocka_unit_test(test_all_wrong_rays_are_told),
		cmocka_unit_test(test_rays_as_numbers),
		cmocka_unit_test(test_query_of_rays),
		cmocka_unit_test(test_points_to_project),
		cmocka_unit_test(test_render_defaults),
		cmocka_unit_test(test_render_all_members),
		cmocka_unit_test(test_wrong_pictures_are_named),
		cmocka_unit_test(test_slices),
		cmocka_unit_test(test_wrong_slices_are_named),
		cmocka_unit_test(test_answer_of_rays),
		cmocka_unit_test(test_answer_of_projections),
		cmocka_unit_test(test_requests_without_memory),
	};

	return cmocka_run_group_tests(tests, NULL, NULL);
}
