/*
 * Meshes as files: what was written is read back.
 */
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

#include <cjson/cJSON.h>

#include "core/mesh.h"
#include "proto/mesh_file.h"
#include "tests/support/fail_alloc.h"
#include "tests/support/near.h"

#define PI 3.14159265358979323846

/* A torus of radii 2 and 0.5 about Z. */
#define AROUND 24
#define ACROSS 12
#define VERTICES (AROUND * ACROSS)
#define TRIANGLES (2 * VERTICES)

typedef enum err writer(const struct mesh *m, const char *name, char **data,
    size_t *length);

struct torus {
	float positions[3 * VERTICES], normals[3 * VERTICES];
	float colors[3 * VERTICES];
	uint32_t triangles[3 * TRIANGLES];
	struct mesh mesh;
};

static void set3(float *at, double x, double y, double z)
{
	at[0] = (float)x;
	at[1] = (float)y;
	at[2] = (float)z;
}

static void make_vertex(struct torus *t, int i, int j)
{
	const double u = 2.0 * PI * i / AROUND, v = 2.0 * PI * j / ACROSS;
	const double r = 2.0 + 0.5 * cos(v);
	const size_t at = 3 * (size_t)(i * ACROSS + j);

	set3(t->positions + at, r * cos(u), r * sin(u), 0.5 * sin(v));
	set3(t->normals + at, cos(v) * cos(u), cos(v) * sin(u), sin(v));
	set3(t->colors + at, (double)i / AROUND, (double)j / ACROSS, 0.25);
}

static void make_square(struct torus *t, int i, int j)
{
	const uint32_t i1 = (uint32_t)((i + 1) % AROUND);
	const uint32_t j1 = (uint32_t)((j + 1) % ACROSS);
	const uint32_t a = (uint32_t)(i * ACROSS + j);
	const uint32_t b = i1 * ACROSS + (uint32_t)j;
	const uint32_t c = i1 * ACROSS + j1, d = (uint32_t)i * ACROSS + j1;
	const uint32_t corners[6] = {a, b, c, a, c, d};

	memcpy(t->triangles + 6 * (size_t)(i * ACROSS + j), corners,
	    sizeof corners);
}

static void make_torus(struct torus *t)
{
	for (int i = 0; i < AROUND; i++) {
		for (int j = 0; j < ACROSS; j++) {
			make_vertex(t, i, j);
			make_square(t, i, j);
		}
	}
	t->mesh = (struct mesh){
		.positions = t->positions,
		.normals = t->normals,
		.colors = t->colors,
		.triangles = t->triangles,
		.figures = {
			.vertices = VERTICES,
			.triangles = TRIANGLES,
			.components = 1,
			.euler = 0,
			.genus = 1,
			.area = 39.25,
			.volume = 9.75,
			.min = {-2.5, -2.5, -0.5},
			.max = {2.5, 2.5, 0.5},
			.counts = {50, 50, 10},
			.edge = 0.1,
			.cells = 25000,
			.cells_evaluated = 1200,
			.points = 4000,
			.full_points = 28611,
			.sharp_vertices = 3,
			.largest_error = 1e-5,
		},
	};
}

static struct torus torus;

static int make(void **state)
{
	(void)state;
	make_torus(&torus);
	return 0;
}

static char *write_as(writer *write, const struct mesh *m, const char *name,
    size_t *length)
{
	char *data = NULL;

	assert_int_equal(write(m, name, &data, length), ERR_OK);
	assert_non_null(data);
	return data;
}

static uint32_t read_u32(const char *at)
{
	const unsigned char *p = (const unsigned char *)at;

	return p[0] | (uint32_t)p[1] << 8 | (uint32_t)p[2] << 16 |
	    (uint32_t)p[3] << 24;
}

static float read_float(const char *at)
{
	const uint32_t bits = read_u32(at);
	float value;

	memcpy(&value, &bits, sizeof value);
	return value;
}

static void assert_floats(const char *at, const float *expected, size_t count)
{
	for (size_t i = 0; i < count; i++)
		if (read_float(at + 4 * i) != expected[i])
			fail_msg("float %zu is %.9g, not %.9g", i,
			    read_float(at + 4 * i), expected[i]);
}

static const cJSON *member(const cJSON *json, const char *name)
{
	const cJSON *value = cJSON_GetObjectItemCaseSensitive(json, name);

	if (value == NULL)
		fail_msg("there is no %s", name);
	return value;
}

static double number(const cJSON *json, const char *name)
{
	assert_true(cJSON_IsNumber(member(json, name)));
	return member(json, name)->valuedouble;
}

static const cJSON *element(const cJSON *json, const char *name, int i)
{
	const cJSON *value = cJSON_GetArrayItem(member(json, name), i);

	if (value == NULL)
		fail_msg("there is no %s[%d]", name, i);
	return value;
}

/* ---- GLB ---- */

/* The scene of a file, for cJSON_Delete; its buffer in *binary, or NULL. */
static cJSON *read_glb(const char *data, size_t length, const char **binary,
    size_t *binary_length)
{
	const size_t text = read_u32(data + 12);
	const char *end;
	cJSON *json;

	assert_memory_equal(data, "glTF", 4);
	assert_int_equal(read_u32(data + 4), 2);
	assert_int_equal(read_u32(data + 8), length);
	assert_int_equal(text % 4, 0);
	assert_memory_equal(data + 16, "JSON", 4);
	json = cJSON_ParseWithLengthOpts(data + 20, text, &end, 0);
	assert_non_null(json);
	for (; end < data + 20 + text; end++)
		assert_int_equal(*end, ' ');
	*binary = NULL;
	*binary_length = 0;
	if (length == 20 + text)
		return json;
	*binary_length = read_u32(data + 20 + text);
	assert_int_equal(*binary_length % 4, 0);
	assert_memory_equal(data + 24 + text, "BIN", 4);
	*binary = data + 28 + text;
	assert_int_equal(length, 28 + text + *binary_length);
	return json;
}

/* Where the accessor's elements are; they are of count and type. */
static const char *accessor(const cJSON *gltf, const char *binary, int index,
    double count, const char *type, int component)
{
	const cJSON *item = element(gltf, "accessors", index);
	const cJSON *view = element(gltf, "bufferViews", (int)number(item,
	    "bufferView"));

	assert_near(number(item, "count"), count, 0.0);
	assert_string_equal(member(item, "type")->valuestring, type);
	assert_int_equal(number(item, "componentType"), component);
	assert_int_equal(number(view, "buffer"), 0);
	assert_near(number(view, "byteLength"), count * (strcmp(type, "VEC3")
	    == 0 ? 12 : 4), 0.0);
	return binary + (size_t)number(view, "byteOffset");
}

static void test_glb_has_what_the_mesh_has(void **state)
{
	const char *binary;
	size_t length, bytes;
	char *data = write_as(mesh_file_glb, &torus.mesh, "Ring", &length);
	cJSON *gltf = read_glb(data, length, &binary, &bytes);
	const cJSON *primitive, *attributes;

	(void)state;
	primitive = element(element(gltf, "meshes", 0), "primitives", 0);
	attributes = member(primitive, "attributes");
	assert_int_equal(number(element(gltf, "buffers", 0), "byteLength"),
	    bytes);
	assert_int_equal(bytes, 36 * VERTICES + 12 * TRIANGLES);
	assert_floats(accessor(gltf, binary, (int)number(attributes,
	    "POSITION"), VERTICES, "VEC3", 5126), torus.positions,
	    3 * VERTICES);
	assert_floats(accessor(gltf, binary, (int)number(attributes, "NORMAL"),
	    VERTICES, "VEC3", 5126), torus.normals, 3 * VERTICES);
	assert_floats(accessor(gltf, binary, (int)number(attributes,
	    "COLOR_0"), VERTICES, "VEC3", 5126), torus.colors, 3 * VERTICES);
	assert_memory_equal(accessor(gltf, binary, (int)number(primitive,
	    "indices"), 3 * TRIANGLES, "SCALAR", 5125), torus.triangles,
	    sizeof torus.triangles);
	cJSON_Delete(gltf);
	free(data);
}

static void test_glb_says_the_extent_exactly(void **state)
{
	const char *binary;
	size_t length, bytes;
	char *data = write_as(mesh_file_glb, &torus.mesh, "", &length);
	cJSON *gltf = read_glb(data, length, &binary, &bytes);
	const cJSON *positions = element(gltf, "accessors", 0);
	float least[3] = {9, 9, 9}, most[3] = {-9, -9, -9};

	(void)state;
	for (size_t i = 0; i < 3 * VERTICES; i++) {
		least[i % 3] = fminf(least[i % 3], torus.positions[i]);
		most[i % 3] = fmaxf(most[i % 3], torus.positions[i]);
	}
	for (int i = 0; i < 3; i++) {
		assert_near(element(positions, "min", i)->valuedouble,
		    least[i], 0.0);
		assert_near(element(positions, "max", i)->valuedouble, most[i],
		    0.0);
	}
	cJSON_Delete(gltf);
	free(data);
}

static void test_glb_turns_z_up_to_y_up(void **state)
{
	const char *binary;
	size_t length, bytes;
	char *data = write_as(mesh_file_glb, &torus.mesh, "", &length);
	cJSON *gltf = read_glb(data, length, &binary, &bytes);
	const cJSON *node = element(gltf, "nodes", 0);
	const double x = element(node, "rotation", 0)->valuedouble;
	const double w = element(node, "rotation", 3)->valuedouble;

	(void)state;
	/* Of (0, 0, 1), for a turn (x, 0, 0, w): (0, -2 x w, w^2 - x^2). */
	assert_near(-2.0 * x * w, 1.0, 1e-15);
	assert_near(w * w - x * x, 0.0, 1e-15);
	assert_near(element(node, "rotation", 1)->valuedouble, 0.0, 0.0);
	assert_near(element(node, "rotation", 2)->valuedouble, 0.0, 0.0);
	cJSON_Delete(gltf);
	free(data);
}

static void test_glb_carries_names_and_figures(void **state)
{
	static const char name[] = "a \"Ring\" \xc3\xa4";
	const char *binary;
	size_t length, bytes;
	char *data = write_as(mesh_file_glb, &torus.mesh, name, &length);
	cJSON *gltf = read_glb(data, length, &binary, &bytes);
	const cJSON *extras = member(member(gltf, "asset"), "extras");

	(void)state;
	assert_string_equal(member(element(gltf, "nodes", 0), "name")->
	    valuestring, name);
	assert_string_equal(member(member(gltf, "asset"), "version")->
	    valuestring, "2.0");
	assert_int_equal(number(member(extras, "blobfield"), "genus"), 1);
	assert_true(cJSON_IsFalse(member(element(gltf, "materials", 0),
	    "doubleSided")));
	cJSON_Delete(gltf);
	free(data);
}

static void test_glb_leaves_out_what_is_not_there(void **state)
{
	struct mesh bare = torus.mesh;
	const char *binary;
	size_t length, bytes;
	cJSON *gltf;
	char *data;

	(void)state;
	bare.normals = bare.colors = NULL;
	data = write_as(mesh_file_glb, &bare, "", &length);
	gltf = read_glb(data, length, &binary, &bytes);
	assert_int_equal(bytes, 12 * VERTICES + 12 * TRIANGLES);
	assert_int_equal(cJSON_GetArraySize(member(gltf, "accessors")), 2);
	assert_null(cJSON_GetObjectItem(element(gltf, "nodes", 0), "name"));
	cJSON_Delete(gltf);
	free(data);
}

static void test_an_empty_glb_has_a_scene_alone(void **state)
{
	const struct mesh nothing = {0};
	const char *binary;
	size_t length, bytes;
	char *data = write_as(mesh_file_glb, &nothing, "none", &length);
	cJSON *gltf = read_glb(data, length, &binary, &bytes);

	(void)state;
	assert_null(binary);
	assert_int_equal(number(gltf, "scene"), 0);
	assert_int_equal(cJSON_GetArraySize(member(gltf, "scenes")), 1);
	/* Empty lists are not allowed. */
	assert_null(cJSON_GetObjectItem(gltf, "nodes"));
	assert_null(cJSON_GetObjectItem(gltf, "meshes"));
	assert_null(cJSON_GetObjectItem(gltf, "buffers"));
	cJSON_Delete(gltf);
	free(data);
}

/* ---- PLY ---- */

/* Behind line, which must be the next one. */
static const char *expect_line(const char *at, const char *line)
{
	const size_t n = strlen(line);

	if (strncmp(at, line, n) != 0 || at[n] != '\n')
		fail_msg("not '%s' but '%.40s'", line, at);
	return at + n + 1;
}

static const char *expect_lines(const char *at, const char *const *lines)
{
	for (; *lines != NULL; lines++)
		at = expect_line(at, *lines);
	return at;
}

/* IEC 61966-2-1, the other way round. */
static double srgb_decode(int byte)
{
	const double c = byte / 255.0;

	return c <= 0.04045 ? c / 12.92 : pow((c + 0.055) / 1.055, 2.4);
}

static const char *check_ply_vertex(const char *at, size_t i)
{
	assert_floats(at, torus.positions + 3 * i, 3);
	assert_floats(at + 12, torus.normals + 3 * i, 3);
	for (size_t k = 0; k < 3; k++)
		/* Half a step of 1/255, where the curve is steepest: 0.0045. */
		assert_near(srgb_decode((unsigned char)at[24 + k]),
		    torus.colors[3 * i + k], 0.0046);
	return at + 27;
}

static void test_ply_has_what_the_mesh_has(void **state)
{
	static const char *const lines[] = {"ply",
	    "format binary_little_endian 1.0",
	    "comment made by blobfield; Z is up, colours are sRGB",
	    "comment two?lines", "element vertex 288", "property float x",
	    "property float y", "property float z", "property float nx",
	    "property float ny", "property float nz", "property uchar red",
	    "property uchar green", "property uchar blue",
	    "element face 576", "property list uchar int vertex_indices",
	    "end_header", NULL};
	size_t length;
	char *data = write_as(mesh_file_ply, &torus.mesh, "two\nlines",
	    &length);
	const char *at = expect_lines(data, lines);

	(void)state;
	for (size_t i = 0; i < VERTICES; i++)
		at = check_ply_vertex(at, i);
	for (size_t i = 0; i < TRIANGLES; i++) {
		assert_int_equal(*at++, 3);
		for (size_t k = 0; k < 3; k++, at += 4)
			assert_int_equal(read_u32(at),
			    torus.triangles[3 * i + k]);
	}
	assert_ptr_equal(at, data + length);
	free(data);
}

static void test_ply_colours_are_srgb(void **state)
{
	/* The ends, the linear part (9.88), a middle; beyond the range. */
	static float colors[6] = {0.0f, 1.0f, 0.003f, 0.21404114f, 1.5f,
	    -0.5f};
	static const unsigned char expected[6] = {0, 255, 10, 128, 255, 0};
	static float positions[6];
	struct mesh m = {.positions = positions, .colors = colors};
	size_t length;
	char *data;

	(void)state;
	m.figures.vertices = 2;
	data = write_as(mesh_file_ply, &m, "", &length);
	assert_memory_equal(data + length - 3, expected + 3, 3);
	assert_memory_equal(data + length - 18, expected, 3);
	free(data);
}

static void test_an_empty_ply_has_no_elements(void **state)
{
	const struct mesh nothing = {0};
	size_t length;
	char *data = write_as(mesh_file_ply, &nothing, "", &length);
	static const char *const lines[] = {"ply",
	    "format binary_little_endian 1.0",
	    "comment made by blobfield; Z is up, colours are sRGB",
	    "element vertex 0", "property float x", "property float y",
	    "property float z", "element face 0",
	    "property list uchar int vertex_indices", "end_header", NULL};

	(void)state;
	assert_ptr_equal(expect_lines(data, lines), data + length);
	free(data);
}

/* ---- STL ---- */

static void test_stl_has_every_facet(void **state)
{
	size_t length;
	char *data = write_as(mesh_file_stl, &torus.mesh, "Ring", &length);
	const char *at = data + 84;

	(void)state;
	assert_int_equal(length, 84 + 50 * TRIANGLES);
	assert_string_equal(data, "blobfield Ring");
	assert_int_equal(read_u32(data + 80), TRIANGLES);
	for (size_t i = 0; i < TRIANGLES; i++, at += 50) {
		for (size_t k = 0; k < 3; k++)
			assert_floats(at + 12 + 12 * k, torus.positions +
			    3 * torus.triangles[3 * i + k], 3);
		assert_int_equal(at[48], 0);
		assert_int_equal(at[49], 0);
	}
	free(data);
}

/* The facets of the torus lean from its normals by its steps' half angles,
 * 15 and 7.5 degrees: cos 20 at least. */
static void test_stl_normals_point_out(void **state)
{
	size_t length;
	char *data = write_as(mesh_file_stl, &torus.mesh, "", &length);
	const char *at = data + 84;
	float n[3];
	double dot, norm;

	(void)state;
	for (size_t i = 0; i < TRIANGLES; i++, at += 50) {
		const float *outward = torus.normals +
		    3 * torus.triangles[3 * i];

		dot = norm = 0.0;
		for (int k = 0; k < 3; k++) {
			n[k] = read_float(at + 4 * k);
			dot += n[k] * outward[k];
			norm += n[k] * n[k];
		}
		assert_near(norm, 1.0, 1e-6);
		assert_true(dot > 0.93);
	}
	free(data);
}

static void test_stl_of_a_facet_without_area_has_no_normal(void **state)
{
	static float positions[9] = {1, 2, 3, 2, 4, 6, 3, 6, 9};
	static uint32_t triangle[3] = {0, 1, 2};
	struct mesh m = {.positions = positions, .triangles = triangle};
	static const float zero[3];
	size_t length;
	char *data;

	(void)state;
	m.figures.vertices = 3;
	m.figures.triangles = 1;
	data = write_as(mesh_file_stl, &m, "", &length);
	assert_floats(data + 84, zero, 3);
	free(data);
}

static void test_stl_never_begins_like_text_and_cuts_long_names(void **state)
{
	char name[200], *data;
	size_t length;

	(void)state;
	memset(name, 'x', sizeof name - 1);
	name[sizeof name - 1] = '\0';
	data = write_as(mesh_file_stl, &torus.mesh, name, &length);
	assert_memory_not_equal(data, "solid", 5);
	assert_int_equal(read_u32(data + 80), TRIANGLES);
	free(data);
}

/* ---- OBJ ---- */

/* Behind " x y z", which are bit for bit the numbers expected. */
static const char *expect_numbers(const char *at, const float *expected)
{
	for (int i = 0; i < 3; i++) {
		char *end;

		assert_int_equal(*at, ' ');
		if (strtof(at, &end) != expected[i])
			fail_msg("%.20s is not %.9g", at, expected[i]);
		at = end;
	}
	return at;
}

static const char *behind_line(const char *at)
{
	while (*at != '\n')
		at++;
	return at + 1;
}

static const char *expect_char(const char *at, char c)
{
	if (*at != c)
		fail_msg("'%c' before '%.20s'", c, at);
	return at + 1;
}

static void test_obj_has_what_the_mesh_has(void **state)
{
	size_t length;
	char *data = write_as(mesh_file_obj, &torus.mesh, "my ring", &length);
	const char *at = behind_line(data);
	char line[80];

	(void)state;
	at = expect_line(at, "o my ring");
	for (size_t i = 0; i < VERTICES; i++) {
		at = expect_char(at, 'v');
		at = expect_numbers(at, torus.positions + 3 * i);
		at = expect_numbers(at, torus.colors + 3 * i);
		at = expect_char(at, '\n');
	}
	for (size_t i = 0; i < VERTICES; i++) {
		at = expect_char(expect_char(at, 'v'), 'n');
		at = expect_numbers(at, torus.normals + 3 * i);
		at = expect_char(at, '\n');
	}
	for (size_t i = 0; i < TRIANGLES; i++) {
		const uint32_t *t = torus.triangles + 3 * i;

		snprintf(line, sizeof line, "f %u//%u %u//%u %u//%u", t[0] + 1,
		    t[0] + 1, t[1] + 1, t[1] + 1, t[2] + 1, t[2] + 1);
		at = expect_line(at, line);
	}
	assert_ptr_equal(at, data + length);
	free(data);
}

static void test_obj_without_normals_has_bare_faces(void **state)
{
	struct mesh bare = torus.mesh;
	size_t length;
	char *data, *face;

	(void)state;
	bare.normals = bare.colors = NULL;
	data = write_as(mesh_file_obj, &bare, "", &length);
	data[length - 1] = '\0';
	assert_null(strstr(data, "vn"));
	assert_null(strstr(data, "//"));
	face = strstr(data, "\nf ");
	assert_non_null(face);
	assert_memory_equal(face, "\nf 1 13 14\n", 11);
	free(data);
}

static void test_an_empty_obj_has_no_elements(void **state)
{
	const struct mesh nothing = {0};
	size_t length;
	char *data = write_as(mesh_file_obj, &nothing, "", &length);
	const char *at = behind_line(data);

	(void)state;
	assert_ptr_equal(expect_line(at, "o model"), data + length);
	free(data);
}

/* ---- figures, and failures ---- */

static void test_figures_are_named(void **state)
{
	cJSON *json = mesh_figures_json(&torus.mesh.figures);

	(void)state;
	assert_non_null(json);
	assert_int_equal(number(json, "vertices"), VERTICES);
	assert_int_equal(number(json, "triangles"), TRIANGLES);
	assert_int_equal(number(json, "components"), 1);
	assert_int_equal(number(json, "euler"), 0);
	assert_int_equal(number(json, "genus"), 1);
	assert_near(number(json, "area"), 39.25, 0.0);
	assert_near(number(json, "volume"), 9.75, 0.0);
	assert_near(element(json, "min", 2)->valuedouble, -0.5, 0.0);
	assert_near(element(json, "max", 0)->valuedouble, 2.5, 0.0);
	assert_int_equal(element(json, "resolution", 2)->valuedouble, 10);
	assert_near(number(json, "edge_length"), 0.1, 0.0);
	assert_int_equal(number(json, "cells"), 25000);
	assert_int_equal(number(json, "cells_evaluated"), 1200);
	assert_int_equal(number(json, "points"), 4000);
	assert_int_equal(number(json, "full_points"), 28611);
	assert_near(number(json, "largest_error"), 1e-5, 0.0);
	assert_int_equal(number(json, "sharp_vertices"), 3);
	cJSON_Delete(json);
}

static void test_figures_of_nothing_have_no_corners(void **state)
{
	const struct mesh_figures nothing = {0};
	cJSON *json = mesh_figures_json(&nothing);

	(void)state;
	assert_non_null(json);
	assert_true(cJSON_IsNull(member(json, "min")));
	assert_true(cJSON_IsNull(member(json, "max")));
	assert_int_equal(number(json, "vertices"), 0);
	cJSON_Delete(json);
}

static void test_the_same_mesh_gives_the_same_bytes(void **state)
{
	static writer *const writers[] = {mesh_file_glb, mesh_file_ply,
	    mesh_file_stl, mesh_file_obj};
	size_t first_length, second_length;

	(void)state;
	for (int i = 0; i < 4; i++) {
		char *first = write_as(writers[i], &torus.mesh, "n",
		    &first_length);
		char *second = write_as(writers[i], &torus.mesh, "n",
		    &second_length);

		assert_int_equal(first_length, second_length);
		assert_memory_equal(first, second, first_length);
		free(first);
		free(second);
	}
}

/* Every allocation of write fails once; nothing leaks or is handed out. */
static void fail_each(writer *write)
{
	enum err err = ERR_MEMORY;
	size_t length;
	char *data;

	for (long n = 1; err == ERR_MEMORY && n < 100000; n++) {
		data = NULL;
		fail_alloc_set(n);
		err = write(&torus.mesh, "Ring", &data, &length);
		if (!fail_alloc_happened())
			assert_int_equal(err, ERR_OK);
		if (err == ERR_MEMORY)
			assert_null(data);
		free(data);
		assert_int_equal(fail_alloc_live(), 0);
	}
	fail_alloc_set(0);
	assert_int_equal(err, ERR_OK);
}

static void test_files_without_memory(void **state)
{
	static writer *const writers[] = {mesh_file_glb, mesh_file_ply,
	    mesh_file_stl, mesh_file_obj};

	(void)state;
	if (!fail_alloc_available())
		skip();
	for (int i = 0; i < 4; i++)
		fail_each(writers[i]);
}

static void test_figures_without_memory(void **state)
{
	cJSON *json = NULL;

	(void)state;
	if (!fail_alloc_available())
		skip();
	for (long n = 1; json == NULL && n < 1000; n++) {
		fail_alloc_set(n);
		json = mesh_figures_json(&torus.mesh.figures);
		assert_int_equal(json == NULL, fail_alloc_happened());
		if (json == NULL)
			assert_int_equal(fail_alloc_live(), 0);
	}
	fail_alloc_set(0);
	assert_non_null(json);
	cJSON_Delete(json);
}

static void test_a_mesh_too_large_is_refused(void **state)
{
	struct mesh huge = torus.mesh;
	size_t length = 7;
	char *data = NULL;

	(void)state;
	huge.figures.triangles = UINT32_MAX / 50 + 1;
	assert_int_equal(mesh_file_stl(&huge, "", &data, &length), ERR_LIMIT);
	huge.figures.triangles = INT32_MAX / 13 + 1;
	assert_int_equal(mesh_file_ply(&huge, "", &data, &length), ERR_LIMIT);
	huge.figures.triangles = UINT32_MAX / 12;
	assert_int_equal(mesh_file_glb(&huge, "", &data, &length), ERR_LIMIT);
	assert_null(data);
	assert_int_equal(length, 7);
}

int main(void)
{
	const struct CMUnitTest tests[] = {
		cmocka_unit_test(test_glb_has_what_the_mesh_has),
		cmocka_unit_test(test_glb_says_the_extent_exactly),
		cmocka_unit_test(test_glb_turns_z_up_to_y_up),
		cmocka_unit_test(test_glb_carries_names_and_figures),
		cmocka_unit_test(test_glb_leaves_out_what_is_not_there),
		cmocka_unit_test(test_an_empty_glb_has_a_scene_alone),
		cmocka_unit_test(test_ply_has_what_the_mesh_has),
		cmocka_unit_test(test_ply_colours_are_srgb),
		cmocka_unit_test(test_an_empty_ply_has_no_elements),
		cmocka_unit_test(test_stl_has_every_facet),
		cmocka_unit_test(test_stl_normals_point_out),
		cmocka_unit_test(
		    test_stl_of_a_facet_without_area_has_no_normal),
		cmocka_unit_test(
		    test_stl_never_begins_like_text_and_cuts_long_names),
		cmocka_unit_test(test_obj_has_what_the_mesh_has),
		cmocka_unit_test(test_obj_without_normals_has_bare_faces),
		cmocka_unit_test(test_an_empty_obj_has_no_elements),
		cmocka_unit_test(test_figures_are_named),
		cmocka_unit_test(test_figures_of_nothing_have_no_corners),
		cmocka_unit_test(test_the_same_mesh_gives_the_same_bytes),
		cmocka_unit_test(test_files_without_memory),
		cmocka_unit_test(test_figures_without_memory),
		cmocka_unit_test(test_a_mesh_too_large_is_refused),
	};

	return cmocka_run_group_tests_name("mesh file", tests, make, NULL);
}
