/*
 * POST /v1/scenes/{id}/mesh: what comes is read here by a parser of its own,
 * and is closed, of the genus expected, and on the surface.
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
#include <unistd.h>

#include <cjson/cJSON.h>

#include "core/vec3.h"
#include "tests/support/daemon.h"
#include "tests/support/http.h"
#include "tests/support/near.h"

#define PI 3.14159265358979323846

#define DOCUMENT(root) "{\"format\":\"blobfield/1\",\"name\":\"test\"," \
	"\"root\":" root "}"
#define BALL(x, more) "{\"type\":\"sphere\",\"center\":[" x ",0,0]," \
	"\"radius\":1,\"falloff\":0.5" more "}"

/* Two balls that share a lens, whose rim is a circle about X. */
#define LENS "{\"type\":\"intersection\",\"operator\":\"sharp\"," \
	"\"children\":[" BALL("-0.5", "") "," BALL("0.5", "") "]}"

static const struct {
	const char *path, *document;
} scenes[] = {
	{"/v1/scenes/ball", DOCUMENT(BALL("0", ""))},
	{"/v1/scenes/far", DOCUMENT(BALL("10000", ""))},
	{"/v1/scenes/red", DOCUMENT(BALL("0", ",\"material\":{\"color\":"
	    "[1,0.25,0]}"))},
	{"/v1/scenes/two", DOCUMENT("{\"type\":\"union\",\"children\":["
	    BALL("0", "") "," BALL("5", "") "]}")},
	{"/v1/scenes/torus", DOCUMENT("{\"type\":\"torus\",\"center\":"
	    "[0,0,0],\"axis\":[0,0,1],\"major\":2,\"minor\":0.5,"
	    "\"falloff\":0.25}")},
	{"/v1/scenes/lens", DOCUMENT(LENS)},
	{"/v1/scenes/plane", DOCUMENT("{\"type\":\"plane\",\"point\":[0,0,0],"
	    "\"normal\":[0,0,1],\"falloff\":0.25}")},
	{"/v1/scenes/nothing", DOCUMENT("{\"type\":\"intersection\","
	    "\"children\":[" BALL("0", "") "," BALL("7", "") "]}")},
};

static void put(const char *url, const char *path, const char *document)
{
	struct http_reply reply;

	http_json(url, "PUT", path, document, &reply);
	if (reply.status != 201)
		fail_msg("%s: %s", path, reply.body);
	http_reply_fini(&reply);
}

static void put_file(const char *url, const char *path, const char *file)
{
	char text[8192];
	FILE *f = fopen(file, "rb");
	size_t n;

	if (f == NULL)
		fail_msg("no %s", file);
	n = fread(text, 1, sizeof text - 1, f);
	fclose(f);
	text[n] = '\0';
	put(url, path, text);
}

static int setup(void **state)
{
	const struct daemon *d;

	daemon_setup(state);
	d = *state;
	for (size_t i = 0; i < sizeof scenes / sizeof *scenes; i++)
		put(d->url, scenes[i].path, scenes[i].document);
	put_file(d->url, "/v1/scenes/letter", "clients/curl/letter-a.json");
	return 0;
}

/* A mesh of scene, with one more header or NULL. */
static void ask(void **state, const char *scene, const char *query,
    const char *body, const char *header, struct http_reply *reply)
{
	const struct daemon *d = *state;
	char path[128];

	snprintf(path, sizeof path, "/v1/scenes/%s/mesh%s", scene, query);
	http_do(d->url, &(struct http_request){
		.path = path,
		.body = body,
		.length = strlen(body),
		.headers = {"Content-Type: application/json", header},
	}, reply);
}

static void assert_fine(const struct http_reply *reply)
{
	if (reply->status != 200)
		fail_msg("%ld: %s", reply->status, reply->body);
}

/* ---- figures ---- */

static cJSON *figures(void **state, const char *scene, const char *body)
{
	struct http_reply reply;
	cJSON *json;

	ask(state, scene, "?format=json", body, NULL, &reply);
	assert_fine(&reply);
	json = cJSON_Parse(reply.body);
	assert_non_null(json);
	http_reply_fini(&reply);
	return json;
}

static double number(const cJSON *json, const char *name)
{
	const cJSON *value = cJSON_GetObjectItemCaseSensitive(json, name);

	if (!cJSON_IsNumber(value))
		fail_msg("no number %s", name);
	return value->valuedouble;
}

static double element(const cJSON *json, const char *name, int i)
{
	const cJSON *value = cJSON_GetArrayItem(
	    cJSON_GetObjectItemCaseSensitive(json, name), i);

	if (!cJSON_IsNumber(value))
		fail_msg("no number %s[%d]", name, i);
	return value->valuedouble;
}

/* ---- a parser of GLB ---- */

struct surface {
	struct http_reply reply;
	cJSON *gltf;
	const char *binary;
	size_t vertices, triangles;
	const float *positions, *normals, *colors; /* or NULL */
	const uint32_t *indices;
};

static uint32_t word(const char *at)
{
	uint32_t value;

	memcpy(&value, at, sizeof value);
	return value;
}

/* Where an accessor's elements are; how many in *count. */
static const void *accessor(const struct surface *s, int index, size_t *count)
{
	const cJSON *item = cJSON_GetArrayItem(cJSON_GetObjectItem(s->gltf,
	    "accessors"), index);
	const cJSON *view = cJSON_GetArrayItem(cJSON_GetObjectItem(s->gltf,
	    "bufferViews"), (int)number(item, "bufferView"));

	*count = (size_t)number(item, "count");
	return s->binary + (size_t)number(view, "byteOffset");
}

static const float *attribute(struct surface *s, const cJSON *primitive,
    const char *name)
{
	const cJSON *index = cJSON_GetObjectItem(cJSON_GetObjectItem(primitive,
	    "attributes"), name);
	size_t count;
	const float *data;

	if (index == NULL)
		return NULL;
	data = accessor(s, index->valueint, &count);
	if (s->vertices == 0)
		s->vertices = count;
	assert_int_equal(s->vertices, count);
	return data;
}

static void parse(struct surface *s)
{
	const char *data = s->reply.body;
	const size_t text = word(data + 12);
	const cJSON *primitive;

	assert_memory_equal(data, "glTF", 4);
	assert_int_equal(word(data + 8), s->reply.length);
	s->gltf = cJSON_ParseWithLength(data + 20, text);
	assert_non_null(s->gltf);
	if (cJSON_GetObjectItem(s->gltf, "meshes") == NULL)
		return;
	s->binary = data + 28 + text;
	primitive = cJSON_GetArrayItem(cJSON_GetObjectItem(cJSON_GetArrayItem(
	    cJSON_GetObjectItem(s->gltf, "meshes"), 0), "primitives"), 0);
	s->positions = attribute(s, primitive, "POSITION");
	s->normals = attribute(s, primitive, "NORMAL");
	s->colors = attribute(s, primitive, "COLOR_0");
	s->indices = accessor(s, (int)number(primitive, "indices"),
	    &s->triangles);
	s->triangles /= 3;
}

static void surface_get(void **state, const char *scene, const char *body,
    struct surface *s)
{
	*s = (struct surface){.vertices = 0};
	ask(state, scene, "", body, NULL, &s->reply);
	assert_fine(&s->reply);
	parse(s);
}

static void surface_fini(struct surface *s)
{
	cJSON_Delete(s->gltf);
	http_reply_fini(&s->reply);
}

static const float *corner(const struct surface *s, size_t triangle, int i)
{
	return s->positions + 3 * (size_t)s->indices[3 * triangle + (size_t)i];
}

static struct vec3 point(const float *p)
{
	return vec3(p[0], p[1], p[2]);
}

/* By the divergence theorem: triple products over 6. */
static double volume(const struct surface *s)
{
	double sum = 0.0;

	for (size_t i = 0; i < s->triangles; i++) {
		const float *a = corner(s, i, 0), *b = corner(s, i, 1);
		const float *c = corner(s, i, 2);

		sum += vec3_dot(point(a), vec3_cross(point(b), point(c)));
	}
	return sum / 6.0;
}

/* ---- closed, and a manifold ---- */

static int compare_keys(const void *a, const void *b)
{
	const uint64_t x = *(const uint64_t *)a, y = *(const uint64_t *)b;

	return (x > y) - (x < y);
}

/* Directed edges, sorted, for free; from is the upper half. */
static uint64_t *list_edges(const struct surface *s)
{
	const size_t count = 3 * s->triangles;
	uint64_t *edges = malloc((count + 1) * sizeof *edges);

	assert_non_null(edges);
	for (size_t i = 0; i < count; i++) {
		const size_t next = i % 3 == 2 ? i - 2 : i + 1;

		assert_true(s->indices[i] < s->vertices);
		edges[i] = (uint64_t)s->indices[i] << 32 | s->indices[next];
	}
	qsort(edges, count, sizeof *edges, compare_keys);
	return edges;
}

/* Every edge is passed once in each direction: closed, and of one side. */
static void assert_closed(const struct surface *s)
{
	const size_t count = 3 * s->triangles;
	uint64_t *edges = list_edges(s);

	for (size_t i = 0; i < count; i++) {
		const uint64_t back = edges[i] << 32 | edges[i] >> 32;

		if (i > 0 && edges[i] == edges[i - 1])
			fail_msg("edge %zu comes twice", i);
		if (bsearch(&back, edges, count, sizeof *edges, compare_keys)
		    == NULL)
			fail_msg("edge %zu has one side", i);
	}
	free(edges);
}

static uint32_t find(uint32_t *parent, uint32_t i)
{
	while (parent[i] != i)
		i = parent[i] = parent[parent[i]];
	return i;
}

/* How many parts hang together; no vertex is unused. */
static long components(const struct surface *s)
{
	uint32_t *parent = malloc((s->vertices + 1) * sizeof *parent);
	long count = 0;

	assert_non_null(parent);
	for (size_t i = 0; i < s->vertices; i++)
		parent[i] = (uint32_t)i;
	for (size_t i = 0; i < 3 * s->triangles; i++)
		parent[find(parent, s->indices[i])] = find(parent,
		    s->indices[i % 3 == 2 ? i - 2 : i + 1]);
	for (size_t i = 0; i < s->vertices; i++)
		count += parent[i] == i;
	free(parent);
	return count;
}

/* V - E + F = 2 (components - genus), and a closed mesh has 3 F / 2 edges. */
static long genus(const struct surface *s)
{
	return components(s) - ((long)s->vertices - (long)s->triangles / 2) / 2;
}

/* The figures that came with the mesh, of which some are found anew. */
static void assert_figures(const struct surface *s)
{
	const cJSON *f = cJSON_GetObjectItem(cJSON_GetObjectItem(
	    cJSON_GetObjectItem(s->gltf, "asset"), "extras"), "blobfield");
	char expected[128], value[128];

	assert_int_equal(number(f, "vertices"), s->vertices);
	assert_int_equal(number(f, "triangles"), s->triangles);
	assert_int_equal(number(f, "components"), components(s));
	assert_int_equal(number(f, "genus"), genus(s));
	assert_near(number(f, "volume"), volume(s), 1e-4 * fabs(volume(s)));
	snprintf(expected, sizeof expected, "vertices=%zu, triangles=%zu, "
	    "genus=%ld", s->vertices, s->triangles, genus(s));
	assert_string_equal(http_header(&s->reply, "Blobfield-Mesh", value,
	    sizeof value), expected);
}

static void assert_shape(void **state, const char *scene, const char *body,
    long expected_components, long expected_genus)
{
	struct surface s;

	surface_get(state, scene, body, &s);
	assert_true(s.triangles > 100);
	assert_closed(&s);
	assert_int_equal(components(&s), expected_components);
	assert_int_equal(genus(&s), expected_genus);
	assert_figures(&s);
	surface_fini(&s);
}

static void test_the_letter_has_a_hole(void **state)
{
	assert_shape(state, "letter", "{}", 1, 1);
	assert_shape(state, "letter", "{\"resolution\":100,\"features\":"
	    "false}", 1, 1);
}

static void test_meshes_are_closed_and_of_the_genus_expected(void **state)
{
	assert_shape(state, "ball", "{}", 1, 0);
	assert_shape(state, "torus", "{}", 1, 1);
	assert_shape(state, "two", "{}", 2, 0);
	assert_shape(state, "lens", "{}", 1, 0);
	assert_shape(state, "torus", "{\"resolution\":24}", 1, 1);
}

/* ---- where the surface is ---- */

/* Values and gradients at the vertices, for http_reply_fini. */
static void eval_at(void **state, const char *scene, const struct surface *s,
    struct http_reply *reply)
{
	const struct daemon *d = *state;
	char path[96];

	snprintf(path, sizeof path, "/v1/scenes/%s/eval?outputs=value,normal",
	    scene);
	http_do(d->url, &(struct http_request){
		.path = path,
		.body = s->positions,
		.length = 12 * s->vertices,
		.headers = {"Content-Type: application/octet-stream",
		    "Accept: application/octet-stream"},
	}, reply);
	assert_fine(reply);
	assert_int_equal(reply->length, 16 * s->vertices);
}

/* least: of the cosine between a vertex's normal and the field's there. */
static void assert_on_surface(void **state, const char *scene,
    const char *body, double least)
{
	struct http_reply reply;
	struct surface s;
	double worst = 0.0, turned = 1.0;
	size_t off = 0;
	float row[4];

	surface_get(state, scene, body, &s);
	assert_non_null(s.normals);
	eval_at(state, scene, &s, &reply);
	for (size_t i = 0; i < s.vertices; i++) {
		const float *n = s.normals + 3 * i;

		memcpy(row, reply.body + sizeof row * i, sizeof row);
		worst = fmax(worst, fabs(row[0] - 0.5));
		off += fabs(row[0] - 0.5) > 1e-4;
		turned = fmin(turned, row[1] * n[0] + row[2] * n[1] +
		    row[3] * n[2]);
	}
	/* Measured: 7.2e-5. */
	assert_near(worst, 0.0, 3e-4);
	assert_true(off * 200 <= s.vertices);
	assert_true(turned > least);
	http_reply_fini(&reply);
	surface_fini(&s);
}

static void test_vertices_and_normals_are_the_surfaces(void **state)
{
	/* Measured: 1 - 2e-7, both being the same gradient's in float32; at a
	 * feature, where the field's turns, 0.976. */
	assert_on_surface(state, "letter", "{\"features\":false}", 1.0 - 1e-5);
	assert_on_surface(state, "torus", "{\"features\":false}", 1.0 - 1e-5);
	assert_on_surface(state, "letter", "{}", 0.9);
}

/* The torus about Z, of radii 2 and 0.5: 2 pi^2 R r^2. Triangles inscribed in
 * a circle of radius r by steps h lose h^2 / (6 r^2) of its area at most. */
static void test_volumes_converge(void **state)
{
	const double exact = 2.0 * PI * PI * 2.0 * 0.25;
	cJSON *coarse = figures(state, "torus", "{\"edge_length\":0.2}");
	cJSON *fine = figures(state, "torus", "{\"edge_length\":0.1}");
	const double errors[2] = {fabs(number(coarse, "volume") - exact),
	    fabs(number(fine, "volume") - exact)};

	print_message("measured: torus, volume off by %.2e, at half the "
	    "cells' size %.2e, of %.4f\n", errors[0], errors[1], exact);
	assert_near(errors[0] / exact, 0.0, 0.027);
	assert_true(errors[1] < errors[0] / 3.0);
	cJSON_Delete(coarse);
	cJSON_Delete(fine);
}

static void test_iso_chooses_the_level(void **state)
{
	cJSON *inner = figures(state, "ball", "{\"iso\":0.75}");
	cJSON *outer = figures(state, "ball", "{\"iso\":0.25}");
	cJSON *middle = figures(state, "ball", "{\"iso\":0.5}");

	assert_true(number(inner, "volume") < number(middle, "volume"));
	assert_true(number(middle, "volume") < number(outer, "volume"));
	/* r = 1: 4.18879; inscribed in it by steps of 1/32 and a little. */
	assert_near(number(middle, "volume"), 4.0 / 3.0 * PI, 0.01);
	cJSON_Delete(inner);
	cJSON_Delete(outer);
	cJSON_Delete(middle);
}

static void test_colours_are_the_materials(void **state)
{
	struct surface s;

	surface_get(state, "red", "{\"resolution\":16}", &s);
	assert_non_null(s.colors);
	for (size_t i = 0; i < s.vertices; i++) {
		assert_near(s.colors[3 * i], 1.0, 1e-6);
		assert_near(s.colors[3 * i + 1], 0.25, 1e-6);
		assert_near(s.colors[3 * i + 2], 0.0, 1e-6);
	}
	surface_fini(&s);
}

static void test_normals_and_colours_may_be_left_out(void **state)
{
	struct surface s;

	surface_get(state, "red", "{\"normals\":false,\"colors\":false,"
	    "\"resolution\":16}", &s);
	assert_null(s.normals);
	assert_null(s.colors);
	assert_closed(&s);
	surface_fini(&s);
}

/* The lens's rim is the circle of radius sqrt(1 - 1/4) in the plane x = 0. How
 * far out the vertices there come. */
static double rim(void **state, const char *body, double *sharp)
{
	const cJSON *f;
	struct surface s;
	double most = 0.0;

	surface_get(state, "lens", body, &s);
	f = cJSON_GetObjectItem(cJSON_GetObjectItem(cJSON_GetObjectItem(s.gltf,
	    "asset"), "extras"), "blobfield");
	*sharp = number(f, "sharp_vertices");
	for (size_t i = 0; i < s.vertices; i++)
		most = fmax(most, hypot(s.positions[3 * i + 1],
		    s.positions[3 * i + 2]));
	surface_fini(&s);
	return most;
}

static void test_features_keep_sharp_edges(void **state)
{
	const double exact = sqrt(0.75);
	double sharp, none;
	const double with = rim(state, "{\"resolution\":32}", &sharp);
	const double without = rim(state, "{\"resolution\":32,\"features\":"
	    "false}", &none);

	print_message("measured: a rim of radius %.5f is at %.5f with "
	    "features, at %.5f without\n", exact, with, without);
	/* A cell is 0.054. */
	assert_near(with, exact, 1e-3);
	assert_true(with > without);
	assert_true(sharp > 32.0);
	assert_near(none, 0.0, 0.0);
}

/* ---- bounds ---- */

/* Half a ball: its cap lies in the plane x = 0, where the box ends. */
static void test_what_bounds_cut_is_capped(void **state)
{
	static const char body[] = "{\"bounds\":{\"min\":[0,-2,-2],\"max\":"
	    "[2,2,2]},\"edge_length\":0.125}";
	struct surface s;
	double least = 9.0;
	size_t on_cap = 0;

	surface_get(state, "ball", body, &s);
	assert_closed(&s);
	assert_int_equal(components(&s), 1);
	assert_int_equal(genus(&s), 0);
	assert_figures(&s);
	for (size_t i = 0; i < s.vertices; i++) {
		least = fmin(least, s.positions[3 * i]);
		on_cap += fabs(s.positions[3 * i]) < 1e-6;
	}
	assert_near(least, 0.0, 1e-6);
	assert_true(on_cap > 50);
	/* Half of 4.18879, inscribed. */
	assert_near(volume(&s), 2.0 / 3.0 * PI, 0.03);
	surface_fini(&s);
}

static void test_a_box_inside_gives_the_box(void **state)
{
	static const char body[] = "{\"bounds\":{\"min\":[-0.25,-0.25,-0.25],"
	    "\"max\":[0.25,0.25,0.25]},\"resolution\":8}";
	struct surface s;

	surface_get(state, "ball", body, &s);
	assert_closed(&s);
	assert_int_equal(genus(&s), 0);
	assert_near(volume(&s), 0.125, 1e-6);
	surface_fini(&s);
}

/* Caps are at the bounds even where these are nearer to each other than a cell
 * is long. */
static void test_a_slice_is_as_thick_as_its_bounds(void **state)
{
	cJSON *json = figures(state, "ball", "{\"bounds\":{\"min\":[-1,-1,0],"
	    "\"max\":[1,1,0.1]},\"resolution\":16}");

	/* pi (h - h^3 / 3), less what a polygon of 50 sides lacks. */
	assert_near(number(json, "volume"), PI * (0.1 - 1e-3 / 3.0), 0.01);
	assert_near(element(json, "min", 2), 0.0, 0.0);
	assert_near(element(json, "max", 2), 0.1, 1e-8);
	assert_near(number(json, "edge_length"), 0.125, 1e-12);
	cJSON_Delete(json);
}

/* How far from the unit sphere about (x, 0, 0) vertices are. */
static double off_sphere(void **state, const char *scene, const char *body,
    double x)
{
	struct surface s;
	double most = 0.0;

	surface_get(state, scene, body, &s);
	assert_closed(&s);
	assert_true(s.vertices >= 8);
	for (size_t i = 0; i < s.vertices; i++)
		most = fmax(most, fabs(vec3_norm(vec3_sub(point(s.positions +
		    3 * i), vec3(x, 0.0, 0.0))) - 1.0));
	surface_fini(&s);
	return most;
}

static void test_vertices_are_on_the_surface_whatever_cells_are(void **state)
{
	assert_near(off_sphere(state, "ball", "{\"resolution\":2}", 0.0), 0.0,
	    2e-4);
	assert_near(off_sphere(state, "ball", "{\"resolution\":1024,"
	    "\"bounds\":{\"min\":[-1e9,-1e9,-1e9],\"max\":[1e9,1e9,1e9]}}",
	    0.0), 0.0, 2e-4);
	/* Float32's steps are 9.8e-4 there. */
	assert_near(off_sphere(state, "far", "{}", 10000.0), 0.0, 2.5e-3);
}

static void test_a_plane_wants_bounds(void **state)
{
	struct http_reply reply;
	struct surface s;

	ask(state, "plane", "", "{}", NULL, &reply);
	assert_int_equal(reply.status, 422);
	assert_non_null(strstr(reply.body, "\"pointer\":\"/bounds\""));
	assert_non_null(strstr(reply.body, "/problems/invalid"));
	http_reply_fini(&reply);
	surface_get(state, "plane", "{\"bounds\":{\"min\":[-1,-1,-1],\"max\":"
	    "[1,1,1]},\"resolution\":16}", &s);
	assert_closed(&s);
	assert_near(volume(&s), 4.0, 1e-4);
	surface_fini(&s);
}

static void test_no_surface_gives_an_empty_mesh(void **state)
{
	struct surface s;
	cJSON *json;
	struct http_reply reply;

	surface_get(state, "nothing", "{}", &s);
	assert_int_equal(s.vertices, 0);
	assert_int_equal(cJSON_GetArraySize(cJSON_GetObjectItem(s.gltf,
	    "scenes")), 1);
	surface_fini(&s);
	surface_get(state, "ball", "{\"bounds\":{\"min\":[5,5,5],\"max\":"
	    "[6,6,6]}}", &s);
	assert_int_equal(s.vertices, 0);
	surface_fini(&s);
	json = figures(state, "nothing", "{}");
	assert_int_equal(number(json, "triangles"), 0);
	assert_true(cJSON_IsNull(cJSON_GetObjectItem(json, "min")));
	cJSON_Delete(json);
	ask(state, "nothing", "?format=stl", "{}", NULL, &reply);
	assert_fine(&reply);
	assert_int_equal(reply.length, 84);
	http_reply_fini(&reply);
}

/* ---- the work, the formats ---- */

static void test_cells_without_surface_are_not_looked_at(void **state)
{
	cJSON *json = figures(state, "letter", "{\"resolution\":64}");
	double cells = 1.0, points = 1.0, longest = 0.0;

	for (int i = 0; i < 3; i++) {
		const double n = element(json, "resolution", i);

		cells *= n;
		points *= n + 1.0;
		longest = fmax(longest, n);
	}
	assert_int_equal(number(json, "cells"), cells);
	assert_int_equal(number(json, "full_points"), points);
	assert_near(longest, 64.0, 1.0);
	assert_true(number(json, "cells_evaluated") < 0.5 * cells);
	assert_true(number(json, "points") > 0.0);
	assert_near(number(json, "largest_error"), 0.0, 3e-4);
	assert_true(cJSON_IsNumber(cJSON_GetObjectItem(cJSON_GetObjectItem(
	    json, "seconds"), "cells")));
	cJSON_Delete(json);
}

static void test_the_same_request_gives_the_same_bytes(void **state)
{
	struct http_reply first, second;

	ask(state, "letter", "", "{\"resolution\":40}", NULL, &first);
	ask(state, "letter", "", "{\"resolution\":40}", NULL, &second);
	assert_fine(&first);
	assert_int_equal(first.length, second.length);
	assert_memory_equal(first.body, second.body, first.length);
	http_reply_fini(&first);
	http_reply_fini(&second);
}

/* Which type comes, whose body begins so. */
static void assert_type(void **state, const char *query, const char *body,
    const char *header, const char *type, const char *begin)
{
	struct http_reply reply;
	char value[64], counts[128];
	size_t vertices, triangles;

	ask(state, "ball", query, body, header, &reply);
	assert_fine(&reply);
	assert_string_equal(http_header(&reply, "Content-Type", value,
	    sizeof value), type);
	assert_memory_equal(reply.body, begin, strlen(begin));
	http_header(&reply, "Blobfield-Mesh", counts, sizeof counts);
	assert_int_equal(sscanf(counts, "vertices=%zu, triangles=%zu, genus=0",
	    &vertices, &triangles), 2);
	assert_int_equal(triangles, 2 * vertices - 4);
	if (strcmp(type, "model/stl") == 0)
		assert_int_equal(reply.length, 84 + 50 * triangles);
	http_reply_fini(&reply);
}

#define GLB "model/gltf-binary"

static void test_formats_are_chosen_by_body_query_and_accept(void **state)
{
	assert_type(state, "", "{\"resolution\":8}", NULL, GLB, "glTF");
	assert_type(state, "", "{\"resolution\":8}", "Accept: model/stl",
	    "model/stl", "blobfield test");
	assert_type(state, "", "{\"resolution\":8}",
	    "Accept: application/x-ply;q=0.5, model/obj", "model/obj", "# ");
	assert_type(state, "", "{\"resolution\":8}", "Accept: model/*", GLB,
	    "glTF");
	/* As curl --json says; figures are asked for by name. */
	assert_type(state, "", "{\"resolution\":8}",
	    "Accept: application/json", GLB, "glTF");
	assert_type(state, "?format=json", "{\"resolution\":8}", NULL,
	    "application/json", "{");
	assert_type(state, "?format=ply", "{\"resolution\":8}",
	    "Accept: model/stl", "application/x-ply", "ply\n");
	assert_type(state, "?format=ply", "{\"resolution\":8,\"format\":"
	    "\"obj\"}", "Accept: model/stl", "model/obj", "# ");
	assert_type(state, "", "{\"resolution\":8,\"format\":\"glb\"}",
	    "Accept: image/png", GLB, "glTF");
}

static void test_other_formats_are_refused(void **state)
{
	struct http_reply reply;

	ask(state, "ball", "?format=fbx", "{}", NULL, &reply);
	assert_int_equal(reply.status, 422);
	assert_non_null(strstr(reply.body, "\"pointer\":\"?format\""));
	http_reply_fini(&reply);
}

/* How many lines of text begin so. */
static size_t count_lines(const char *text, const char *begin)
{
	const size_t n = strlen(begin);
	size_t count = 0;

	for (; text != NULL; text = strchr(text, '\n')) {
		text += *text == '\n';
		count += strncmp(text, begin, n) == 0;
		if (*text == '\0')
			break;
	}
	return count;
}

static void test_files_have_all_vertices(void **state)
{
	struct http_reply obj, ply;
	char counts[128], line[64];
	size_t vertices, triangles;
	const char *body;

	ask(state, "letter", "?format=obj", "{\"resolution\":20}", NULL, &obj);
	ask(state, "letter", "?format=ply", "{\"resolution\":20}", NULL, &ply);
	http_header(&obj, "Blobfield-Mesh", counts, sizeof counts);
	assert_int_equal(sscanf(counts, "vertices=%zu, triangles=%zu",
	    &vertices, &triangles), 2);
	assert_int_equal(count_lines(obj.body, "v "), vertices);
	assert_int_equal(count_lines(obj.body, "vn "), vertices);
	assert_int_equal(count_lines(obj.body, "f "), triangles);
	snprintf(line, sizeof line, "element vertex %zu\n", vertices);
	assert_non_null(strstr(ply.body, line));
	body = strstr(ply.body, "end_header\n");
	assert_non_null(body);
	assert_int_equal(ply.length - (size_t)(body + 11 - ply.body),
	    27 * vertices + 13 * triangles);
	http_reply_fini(&obj);
	http_reply_fini(&ply);
}

/* ---- errors ---- */

static void assert_refused(void **state, const char *scene, const char *body,
    long status, const char *pointer)
{
	struct http_reply reply;
	char named[128];

	ask(state, scene, "", body, NULL, &reply);
	if (reply.status != status)
		fail_msg("%s: %ld, not %ld: %s", body, reply.status, status,
		    reply.body);
	snprintf(named, sizeof named, "\"pointer\":\"%s\"", pointer);
	if (strstr(reply.body, named) == NULL)
		fail_msg("%s: no %s in %s", body, named, reply.body);
	http_reply_fini(&reply);
}

static void test_bad_requests_are_told_where(void **state)
{
	assert_refused(state, "ball", "", 400, "");
	assert_refused(state, "ball", "{\"resolution\":", 400, "/resolution");
	assert_refused(state, "ball", "[]", 422, "");
	assert_refused(state, "ball", "{\"resolution\":1}", 422,
	    "/resolution");
	assert_refused(state, "ball", "{\"resolution\":2000}", 422,
	    "/resolution");
	assert_refused(state, "ball", "{\"bounds\":{\"min\":[0,0,0],\"max\":"
	    "[1,0,1]}}", 422, "/bounds/max/1");
	assert_refused(state, "ball", "{\"size\":7}", 422, "/size");
	/* More cells than may be; cells longer than the surface; cells below
	 * what float32 resolves. */
	assert_refused(state, "ball", "{\"edge_length\":100}", 422,
	    "/edge_length");
	assert_refused(state, "ball", "{\"edge_length\":1e-4}", 422,
	    "/edge_length");
	assert_refused(state, "ball", "{\"bounds\":{\"min\":[1e8,0,0],\"max\":"
	    "[1.00000001e8,1,1]},\"resolution\":64}", 422, "/resolution");
}

static void test_too_short_cells_are_no_limit(void **state)
{
	struct http_reply reply;

	ask(state, "far", "", "{\"resolution\":400}", NULL, &reply);
	assert_int_equal(reply.status, 422);
	assert_non_null(strstr(reply.body, "/problems/invalid"));
	assert_non_null(strstr(reply.body, "0.00954 or longer"));
	http_reply_fini(&reply);
}

static void test_too_many_cells_are_a_limit(void **state)
{
	struct http_reply reply;

	ask(state, "ball", "", "{\"edge_length\":1e-4}", NULL, &reply);
	assert_non_null(strstr(reply.body, "/problems/limit"));
	http_reply_fini(&reply);
}

static void test_meshes_are_of_a_scene_and_its_revision(void **state)
{
	const struct daemon *d = *state;
	struct http_reply reply;
	char tag[64], condition[128], used[64];

	ask(state, "nobody", "", "{}", NULL, &reply);
	assert_int_equal(reply.status, 404);
	http_reply_fini(&reply);
	ask(state, "ball", "", "{}", "If-Match: \"other\"", &reply);
	assert_int_equal(reply.status, 412);
	http_reply_fini(&reply);
	http_get(d->url, "/v1/scenes/ball", &reply);
	http_header(&reply, "ETag", tag, sizeof tag);
	http_reply_fini(&reply);
	snprintf(condition, sizeof condition, "If-Match: %s", tag);
	ask(state, "ball", "", "{\"resolution\":8}", condition, &reply);
	assert_fine(&reply);
	assert_string_equal(http_header(&reply, "ETag", used, sizeof used),
	    tag);
	http_reply_fini(&reply);
	http_do(d->url, &(struct http_request){
		.path = "/v1/scenes/ball/mesh",
		.body = "{}",
		.length = 2,
		.headers = {"Content-Type: text/plain"},
	}, &reply);
	assert_int_equal(reply.status, 415);
	http_reply_fini(&reply);
}

static void test_deadlines_end_the_work(void **state)
{
	struct http_reply reply;

	ask(state, "letter", "?deadline=0.02", "{\"resolution\":1000}", NULL,
	    &reply);
	assert_int_equal(reply.status, 504);
	http_reply_fini(&reply);
}

/* ---- progress, and hanging up ---- */

/* The status of /v1/progress/hung, once it is that or 10 s have passed. */
static long await_progress(const struct daemon *d, long status)
{
	struct http_reply reply;

	for (int i = 0; i < 3000; i++) {
		http_get(d->url, "/v1/progress/hung", &reply);
		if (reply.status == 200)
			assert_non_null(strstr(reply.body, "\"stage\""));
		http_reply_fini(&reply);
		if (reply.status == status)
			break;
		usleep(10000);
	}
	return reply.status;
}

static void test_hanging_up_ends_the_work(void **state)
{
	static const char request[] = "POST /v1/scenes/letter/mesh"
	    "?progress=hung HTTP/1.1\r\nHost: localhost\r\nContent-Type: "
	    "application/json\r\nContent-Length: 19\r\n\r\n"
	    "{\"resolution\":1024}";
	const struct daemon *d = *state;
	const int fd = http_connect(d->port);

	assert_int_equal(write(fd, request, sizeof request - 1),
	    sizeof request - 1);
	assert_int_equal(await_progress(d, 200), 200);
	close(fd);
	assert_int_equal(await_progress(d, 404), 404);
}

int main(void)
{
	const struct CMUnitTest tests[] = {
		cmocka_unit_test(test_the_letter_has_a_hole),
		cmocka_unit_test(
		    test_meshes_are_closed_and_of_the_genus_expected),
		cmocka_unit_test(test_vertices_and_normals_are_the_surfaces),
		cmocka_unit_test(test_volumes_converge),
		cmocka_unit_test(test_iso_chooses_the_level),
		cmocka_unit_test(test_colours_are_the_materials),
		cmocka_unit_test(test_normals_and_colours_may_be_left_out),
		cmocka_unit_test(test_features_keep_sharp_edges),
		cmocka_unit_test(test_what_bounds_cut_is_capped),
		cmocka_unit_test(test_a_box_inside_gives_the_box),
		cmocka_unit_test(test_a_slice_is_as_thick_as_its_bounds),
		cmocka_unit_test(
		    test_vertices_are_on_the_surface_whatever_cells_are),
		cmocka_unit_test(test_a_plane_wants_bounds),
		cmocka_unit_test(test_no_surface_gives_an_empty_mesh),
		cmocka_unit_test(
		    test_cells_without_surface_are_not_looked_at),
		cmocka_unit_test(test_the_same_request_gives_the_same_bytes),
		cmocka_unit_test(
		    test_formats_are_chosen_by_body_query_and_accept),
		cmocka_unit_test(test_other_formats_are_refused),
		cmocka_unit_test(test_files_have_all_vertices),
		cmocka_unit_test(test_bad_requests_are_told_where),
		cmocka_unit_test(test_too_short_cells_are_no_limit),
		cmocka_unit_test(test_too_many_cells_are_a_limit),
		cmocka_unit_test(test_meshes_are_of_a_scene_and_its_revision),
		cmocka_unit_test(test_deadlines_end_the_work),
		cmocka_unit_test(test_hanging_up_ends_the_work),
	};

	return cmocka_run_group_tests(tests, setup, daemon_teardown);
}
