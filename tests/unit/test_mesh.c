/*
 * Meshes of the float64 evaluator's fields: closed, of the right genus, area
 * and volume, on the surface, with edges and corners where they are.
 */
#include <stdarg.h>
#include <stddef.h>
#include <setjmp.h>
#include <stdint.h>
#include <cmocka.h>

#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "core/evaluate.h"
#include "core/mesh.h"
#include "core/output.h"
#include "core/range.h"
#include "core/tape.h"
#include "core/tree.h"
#include "proto/document.h"
#include "proto/fault.h"
#include "tests/support/fail_alloc.h"
#include "tests/support/near.h"
#include "tests/support/random_tree.h"
#include "tests/support/sanitized.h"

#define PI 3.14159265358979323846

/* ---- the evaluator as a sampler ---- */

struct truth {
	struct sampler sampler;
	const struct tape *tape;
	size_t points;   /* sampled */
	size_t fail_at;  /* the call that fails, from 1 on; 0: none */
	size_t stop_at;  /* the question that is answered with no; 0: none */
	size_t calls, asked;
};

static enum err sample(struct sampler *sampler, const float *points,
    size_t count, unsigned outputs, float *rows)
{
	struct truth *t = (struct truth *)sampler;

	t->points += count;
	if (++t->calls == t->fail_at)
		return ERR_DEVICE;
	for (size_t i = 0; i < count; i++, points += 3) {
		struct vec3 p = vec3(points[0], points[1], points[2]), c;
		struct jet j;

		evaluate(t->tape, p, output_order(outputs), &j);
		if (outputs & OUTPUT_VALUE)
			*rows++ = (float)j.value;
		if (outputs & OUTPUT_GRADIENT) {
			*rows++ = (float)j.gradient.x;
			*rows++ = (float)j.gradient.y;
			*rows++ = (float)j.gradient.z;
		}
		if (outputs & OUTPUT_COLOR) {
			evaluate_color(t->tape, p, &c);
			*rows++ = (float)c.x;
			*rows++ = (float)c.y;
			*rows++ = (float)c.z;
		}
	}
	return ERR_OK;
}

static bool go_on(struct sampler *sampler, const char *stage, double done)
{
	struct truth *t = (struct truth *)sampler;

	assert_non_null(stage);
	assert_true(done >= 0.0 && done <= 1.0);
	return ++t->asked != t->stop_at;
}

static struct truth truth_of(const struct tape *tape)
{
	return (struct truth){.sampler = {sample, go_on}, .tape = tape};
}

/* ---- models ---- */

struct model {
	struct document *document;
	const struct tape *tape;
	struct range_tape *ranges;
};

static struct model model_make(const char *root)
{
	struct document_limits limits = {.max_nodes = 100,
	    .layout = LAYOUT_WARPED};
	struct faults faults = {0};
	struct model m;
	char text[4096];

	snprintf(text, sizeof text, "{\"format\": \"blobfield/1\","
	    " \"root\": %s}", root);
	if (document_parse(text, strlen(text), &limits, &m.document, &faults))
		fail_msg("%s: %s", faults.list[0].pointer,
		    faults.list[0].detail);
	m.tape = document_tape(m.document);
	assert_int_equal(range_tape_create(m.tape, &m.ranges), ERR_OK);
	return m;
}

static void model_free(struct model *m)
{
	range_tape_free(m->ranges);
	document_free(m->document);
}

/* Cells along the longest side of the box within reach of 0 on all sides. */
static struct mesh_options options_of(double reach, double cells)
{
	/* Off the middle: symmetric models would else have their edges on the
	 * grid's planes. */
	return (struct mesh_options){
	    .min = vec3(-reach, -1.013 * reach, -1.007 * reach),
	    .max = vec3(1.003 * reach, 0.991 * reach, 1.011 * reach),
	    .edge = 2.0 * reach / cells, .iso = 0.5, .features = true,
	    .normals = true, .colors = true};
}

static int compare_positions(const void *a, const void *b)
{
	return memcmp(a, b, 3 * sizeof(float));
}

static size_t count_twins(const struct mesh *m)
{
	size_t n = m->figures.vertices, twins = 0;
	float *p = malloc((3 * n + 1) * sizeof *p);

	memcpy(p, m->positions, 3 * n * sizeof *p);
	qsort(p, n, 3 * sizeof *p, compare_positions);
	for (size_t i = 1; i < n; i++)
		twins += memcmp(p + 3 * i, p + 3 * (i - 1),
		    3 * sizeof *p) == 0;
	free(p);
	return twins;
}

/* What must hold of any mesh. */
static void check(const struct mesh *m)
{
	const struct mesh_figures *f = &m->figures;
	size_t edges, vertices;

	assert_int_equal(mesh_check(m, &edges, &vertices), ERR_OK);
	assert_int_equal(edges, 0);
	assert_int_equal(vertices, 0);
	assert_int_equal(count_twins(m), 0);
	assert_int_equal(f->euler, (long)f->vertices -
	    (long)(3 * f->triangles / 2) + (long)f->triangles);
	for (size_t i = 0; i < 3 * f->vertices; i++) {
		assert_true(isfinite(m->positions[i]));
		if (m->colors != NULL)
			assert_true(m->colors[i] >= 0.0f &&
			    m->colors[i] <= 1.0f);
	}
	for (size_t i = 0; i < f->vertices && m->normals != NULL; i++) {
		const float *n = m->normals + 3 * i;

		assert_near(n[0] * n[0] + n[1] * n[1] + n[2] * n[2], 1.0,
		    1e-5);
	}
}

static struct mesh *mesh_of(const struct model *model,
    const struct mesh_options *options)
{
	struct truth truth = truth_of(model->tape);
	struct mesh *m = NULL;

	assert_int_equal(mesh_build(model->ranges, options, &truth.sampler,
	    &m), ERR_OK);
	assert_int_equal(m->figures.points, truth.points);
	check(m);
	return m;
}

/* ---- smooth surfaces ---- */

/* How far figures are from the truth at cells and at twice as many: of second
 * order, at least 3.2 times nearer. */
static void check_converges(const char *root, double area, double volume,
    long genus, double reach, const char *name)
{
	struct model model = model_make(root);
	double before[2] = {0.0, 0.0};

	for (int cells = 24; cells <= 48; cells *= 2) {
		struct mesh_options o = options_of(reach, cells);
		struct mesh *m = mesh_of(&model, &o);
		double off[2] = {fabs(m->figures.area / area - 1.0),
		    fabs(m->figures.volume / volume - 1.0)};

		assert_int_equal(m->figures.genus, genus);
		assert_int_equal(m->figures.components, 1);
		printf("measured: %s, %d cells: area off by %.2e, volume %.2e,"
		    " largest error %.1e\n", name, cells, off[0], off[1],
		    m->figures.largest_error);
		for (int k = 0; k < 2; k++) {
			if (cells > 24)
				assert_true(off[k] < before[k] / 3.2);
			before[k] = off[k];
		}
		mesh_free(m);
	}
	model_free(&model);
}

static void test_sphere_converges(void **state)
{
	(void)state;
	check_converges("{\"type\": \"sphere\", \"center\": [0, 0, 0],"
	    " \"radius\": 1, \"falloff\": 0.5}", 4.0 * PI, 4.0 / 3.0 * PI, 0,
	    1.2, "sphere");
}

static void test_torus_converges(void **state)
{
	(void)state;
	check_converges("{\"type\": \"torus\", \"center\": [0, 0, 0],"
	    " \"axis\": [1, 2, 3], \"major\": 1, \"minor\": 0.4,"
	    " \"falloff\": 0.3}", 4.0 * PI * PI * 0.4, 2.0 * PI * PI * 0.16, 1,
	    1.5, "torus");
}

static void test_genus_of_figure_eight_is_two(void **state)
{
	struct model model = model_make("{\"type\": \"union\","
	    " \"operator\": \"camel\", \"children\": ["
	    "{\"type\": \"circle\", \"center\": [-1, 0, 0],"
	    " \"normal\": [0, 0, 1], \"ring_radius\": 0.8, \"radius\": 0.25},"
	    "{\"type\": \"circle\", \"center\": [1, 0, 0],"
	    " \"normal\": [0, 0, 1], \"ring_radius\": 0.8, \"radius\": 0.25}]}");

	(void)state;
	for (int cells = 20; cells <= 60; cells += 20) {
		struct mesh_options o = options_of(2.2, cells);
		struct mesh *m = mesh_of(&model, &o);

		assert_int_equal(m->figures.components, 1);
		assert_int_equal(m->figures.genus, 2);
		mesh_free(m);
	}
	model_free(&model);
}

static void test_normals_point_outward(void **state)
{
	struct model model = model_make("{\"type\": \"point\","
	    " \"center\": [0, 0, 0], \"radius\": 1}");
	struct mesh_options o = options_of(1.2, 30);
	struct mesh *m = mesh_of(&model, &o);
	double worst = 0.0;

	(void)state;
	for (size_t i = 0; i < m->figures.vertices; i++) {
		const float *p = m->positions + 3 * i, *n = m->normals + 3 * i;
		double r = sqrt((double)p[0] * p[0] + (double)p[1] * p[1] +
		    (double)p[2] * p[2]);

		worst = fmax(worst, fabs(r - 1.0));
		for (int k = 0; k < 3; k++)
			assert_near(n[k], p[k] / r, 1e-5);
	}
	printf("measured: radius off by %.1e\n", worst);
	assert_near(worst, 0.0, 5e-5); /* 2.4e-5: vertices keep off faces */
	assert_true(m->figures.largest_error < 1e-4);
	mesh_free(m);
	model_free(&model);
}

static void test_coarse_ball_has_no_edges(void **state)
{
	struct model model = model_make("{\"type\": \"point\","
	    " \"center\": [0, 0, 0], \"radius\": 1}");

	(void)state;
	for (int cells = 4; cells <= 12; cells++) {
		struct mesh_options o = options_of(1.2, cells);
		struct mesh *m = mesh_of(&model, &o);
		double worst = 0.0;

		for (size_t i = 0; i < m->figures.vertices; i++) {
			const float *p = m->positions + 3 * i;

			worst = fmax(worst, 1.0 - vec3_dot(vec3_unit(vec3(p[0],
			    p[1], p[2])), vec3(m->normals[3 * i],
			    m->normals[3 * i + 1], m->normals[3 * i + 2])));
		}
		printf("measured: %d cells: %zu sharp vertices, normals off by"
		    " %.1e\n", cells, m->figures.sharp_vertices, worst);
		assert_int_equal(m->figures.sharp_vertices, 0);
		assert_near(worst, 0.0, 1e-6);
		mesh_free(m);
	}
	model_free(&model);
}

/* ---- edges and corners ---- */

static const char box[] = "{\"type\": \"box\", \"center\": [0, 0, 0],"
    " \"half_size\": [1, 0.7, 0.5], \"falloff\": 0.3,"
    /* 0.7 about (1, 2, 3) */
    " \"rotation\": [0.09164330, 0.18328661, 0.27492991, 0.93937271]}";

/* Distance of the nearest vertex. */
static double nearest(const struct mesh *m, struct vec3 to)
{
	double least = INFINITY;

	for (size_t i = 0; i < m->figures.vertices; i++) {
		const float *p = m->positions + 3 * i;

		least = fmin(least, vec3_norm(vec3_sub(to,
		    vec3(p[0], p[1], p[2]))));
	}
	return least;
}

/* p turned about axis by angle (Rodrigues). */
static struct vec3 turned(struct vec3 p, struct vec3 axis, double angle)
{
	struct vec3 k = vec3_unit(axis);
	double c = cos(angle), s = sin(angle);

	return vec3_add(vec3_scale(c, p), vec3_add(
	    vec3_scale(s, vec3_cross(k, p)),
	    vec3_scale((1.0 - c) * vec3_dot(k, p), k)));
}

/* The farthest that any of the box's corners is from a vertex, in cells. */
static double corners_off(const struct mesh *m)
{
	double most = 0.0;

	for (int c = 0; c < 8; c++) {
		struct vec3 corner = turned(vec3(c & 1 ? 1.0 : -1.0,
		    c & 2 ? 0.7 : -0.7, c & 4 ? 0.5 : -0.5),
		    vec3(1.0, 2.0, 3.0), 0.7);

		most = fmax(most, nearest(m, corner));
	}
	return most / m->figures.edge;
}

static void test_box_keeps_its_corners(void **state)
{
	struct model model = model_make(box);
	struct mesh_options o = options_of(1.5, 24);
	struct mesh *m = mesh_of(&model, &o);
	double off = corners_off(m);

	(void)state;
	printf("measured: corners off by %.1e cells, volume by %.1e,"
	    " %zu sharp vertices\n", off, m->figures.volume / 2.8 - 1.0,
	    m->figures.sharp_vertices);
	assert_near(off, 0.0, 1e-4);             /* 1.1e-6 */
	assert_near(m->figures.volume, 2.8, 1.4e-3); /* 5.6e-4 */
	assert_true(m->figures.sharp_vertices > 80);
	mesh_free(m);
	o.features = false;
	m = mesh_of(&model, &o);
	off = corners_off(m);
	printf("measured: without features by %.2f cells\n", off);
	assert_true(off > 0.3); /* 0.88 */
	assert_int_equal(m->figures.sharp_vertices, 0);
	mesh_free(m);
	model_free(&model);
}


/* Where two unit spheres at +-0.6 along x meet: a circle of radius 0.8. The
 * farthest that points of it are from a vertex across the circle, in cells. */
static double crease_off(const struct mesh *m)
{
	double most = 0.0;

	for (int i = 0; i < 64; i++) {
		double angle = 2.0 * PI * (i + 0.5) / 64, least = INFINITY;
		struct vec3 d = vec3(0.0, cos(angle), sin(angle));

		/* Of vertices near the angle, how near the circle. */
		for (size_t k = 0; k < m->figures.vertices; k++) {
			const float *p = m->positions + 3 * k;
			double r = sqrt((double)p[1] * p[1] +
			    (double)p[2] * p[2]);

			if (vec3_dot(d, vec3(0.0, p[1], p[2])) > 0.99 * r)
				least = fmin(least, hypot(p[0], r - 0.8));
		}
		most = fmax(most, least);
	}
	return most / m->figures.edge;
}

#define TWO_SPHERES "\"children\": [{\"type\": \"sphere\"," \
	" \"center\": [-0.6, 0, 0], \"radius\": 1, \"falloff\": 0.4}," \
	" {\"type\": \"sphere\", \"center\": [0.6, 0, 0], \"radius\": 1," \
	" \"falloff\": 0.4}]}"

static void check_crease(const char *type, const char *operator, double volume)
{
	char root[512];
	struct model model;
	struct mesh_options o = options_of(1.7, 32);
	struct mesh *m;
	double off;

	snprintf(root, sizeof root, "{\"type\": \"%s\", \"operator\": \"%s\","
	    TWO_SPHERES, type, operator);
	model = model_make(root);
	m = mesh_of(&model, &o);
	off = crease_off(m);
	printf("measured: %s %s: crease off by %.1e cells, volume by %.1e, %zu"
	    " sharp vertices, largest error %.1e\n", operator, type, off,
	    m->figures.volume / volume - 1.0, m->figures.sharp_vertices,
	    m->figures.largest_error);
	assert_near(off, 0.0, 0.06);                    /* 0.032 */
	assert_near(m->figures.volume / volume, 1.0, 0.015); /* 0.0086 */
	mesh_free(m);
	o.features = false;
	m = mesh_of(&model, &o);
	off = crease_off(m);
	printf("measured: without features off by %.2f cells\n", off);
	assert_true(off > 0.15); /* 0.29 */
	mesh_free(m);
	model_free(&model);
}

static void test_creases_are_kept(void **state)
{
	/* A cap of height 0.4. */
	const double ball = 4.0 / 3.0 * PI, cap = PI * 0.16 * (1.0 - 0.4 / 3.0);

	(void)state;
	check_crease("union", "sharp", 2.0 * (ball - cap));
	check_crease("union", "clean", 2.0 * (ball - cap));
	check_crease("intersection", "sharp", 2.0 * cap);
	check_crease("difference", "sharp", ball - 2.0 * cap);
	check_crease("difference", "clean", ball - 2.0 * cap);
}

/* ---- bounds ---- */

static const char ball[] = "{\"type\": \"sphere\", \"center\": [0, 0, 0],"
    " \"radius\": 1, \"falloff\": 0.5}";

static void test_half_space_is_capped(void **state)
{
	struct model model = model_make("{\"type\": \"plane\","
	    " \"point\": [0, 0, 0.3], \"normal\": [1, 2, 5],"
	    " \"falloff\": 0.5}");
	struct mesh_options o = {.min = vec3(-1.0, -1.0, -1.0),
	    .max = vec3(1.0, 1.0, 1.0), .edge = 0.1, .iso = 0.5,
	    .features = true, .normals = true};
	struct mesh *m = mesh_of(&model, &o);

	(void)state;
	/* The plane meets the axis of the box at 0.3. */
	printf("measured: volume off by %.1e, area by %.1e\n",
	    m->figures.volume - 4.0 * 1.3, m->figures.area -
	    (4.0 + 8.0 * 1.3 + 4.0 * sqrt(30.0) / 5.0));
	assert_near(m->figures.volume, 4.0 * 1.3, 1e-5); /* 2.8e-6 */
	assert_near(m->figures.area,
	    4.0 + 8.0 * 1.3 + 4.0 * sqrt(30.0) / 5.0, 3e-5); /* 8.4e-6 */
	assert_int_equal(m->figures.genus, 0);
	assert_near(m->figures.min.x, -1.0, 1e-6);
	assert_near(m->figures.max.y, 1.0, 1e-6);
	assert_near(m->figures.min.z, -1.0, 1e-6);
	assert_near(nearest(m, vec3(-1.0, -1.0, -1.0)), 0.0, 1e-6);
	assert_near(m->figures.largest_error, 0.0, 1e-4);
	mesh_free(m);
	model_free(&model);
}

static void test_ball_cut_by_bounds_is_capped(void **state)
{
	struct model model = model_make(ball);
	struct mesh_options o = {.min = vec3(-0.5, -1.2, -1.2),
	    .max = vec3(1.2, 0.4, 1.2), .edge = 0.05, .iso = 0.5,
	    .features = true, .normals = true};
	struct mesh *m = mesh_of(&model, &o);

	(void)state;
	assert_int_equal(m->figures.genus, 0);
	assert_int_equal(m->figures.components, 1);
	assert_near(m->figures.min.x, -0.5, 1e-6);
	assert_near(m->figures.max.y, 0.4, 1e-6);
	mesh_free(m);
	model_free(&model);
}

static void test_nothing_inside_is_an_empty_mesh(void **state)
{
	struct model model = model_make(ball);
	struct mesh_options o = {.min = vec3(2.0, 2.0, 2.0),
	    .max = vec3(3.0, 3.0, 3.0), .edge = 0.1, .iso = 0.5,
	    .normals = true, .colors = true};
	struct mesh *m = mesh_of(&model, &o);

	(void)state;
	assert_int_equal(m->figures.vertices, 0);
	assert_int_equal(m->figures.triangles, 0);
	assert_int_equal(m->figures.genus, 0);
	assert_int_equal(m->figures.full_points, 1331);
	mesh_free(m);
	model_free(&model);
}

static void test_all_inside_is_a_box(void **state)
{
	struct model model = model_make(ball);
	struct mesh_options o = {.min = vec3(-0.3, -0.2, -0.1),
	    .max = vec3(0.3, 0.2, 0.1), .edge = 0.05, .iso = 0.5,
	    .features = true, .normals = true};
	struct mesh *m = mesh_of(&model, &o);

	(void)state;
	assert_near(m->figures.volume, 0.6 * 0.4 * 0.2, 1e-6);
	assert_int_equal(m->figures.genus, 0);
	assert_near(m->figures.largest_error, 0.0, 0.0);
	mesh_free(m);
	model_free(&model);
}

static void test_one_cell_is_enough(void **state)
{
	struct model model = model_make(ball);
	struct mesh_options o = {.min = vec3(-0.1, -0.1, -0.1),
	    .max = vec3(0.1, 0.1, 0.1), .edge = 5.0, .iso = 0.5};
	struct mesh *m;

	(void)state;
	o.edge = 0.2;
	m = mesh_of(&model, &o);
	assert_int_equal(m->figures.vertices, 26);
	assert_null(m->normals);
	assert_null(m->colors);
	mesh_free(m);
	model_free(&model);
}

static void test_thin_parts_stay_manifold(void **state)
{
	/* Thinner than a tenth of a cell, at an angle. */
	struct model model = model_make("{\"type\": \"union\","
	    " \"operator\": \"sharp\", \"children\": [{\"type\": \"capsule\","
	    " \"a\": [-1, -0.9, -0.7], \"b\": [1, 0.8, 0.9],"
	    " \"radius\": 0.004, \"falloff\": 0.01}, {\"type\": \"disc\","
	    " \"center\": [0, 0, 0], \"normal\": [1, 2, 9],"
	    " \"disc_radius\": 0.9, \"radius\": 0.004}]}");
	struct mesh_options o = options_of(1.2, 50);
	struct mesh *m = mesh_of(&model, &o);

	(void)state;
	printf("measured: %zu parts of thin ones\n", m->figures.components);
	mesh_free(m);
	model_free(&model);
}

/* ---- any trees ---- */

#define TREES (SANITIZED ? 5 : 25)

static void test_random_trees_are_closed(void **state)
{
	size_t vertices = 0;

	(void)state;
	for (uint64_t seed = 0; seed < TREES; seed++) {
		struct random_tree_options options = {.seed = seed,
		    .max_primitives = 12, .whole = seed % 2};
		struct random_tree *t = random_tree_create(&options);
		struct tape_error error;
		struct model model;
		struct tape *tape;
		struct mesh_options o = options_of(1.5, 20);
		struct mesh *m;

		assert_int_equal(tape_compile(random_tree_get(t), 1000, &tape,
		    &error), ERR_OK);
		model.tape = tape;
		assert_int_equal(range_tape_create(tape, &model.ranges),
		    ERR_OK);
		m = mesh_of(&model, &o);
		vertices += m->figures.vertices;
		mesh_free(m);
		range_tape_free(model.ranges);
		tape_free(tape);
		random_tree_free(t);
	}
	printf("measured: %zu vertices of %d trees\n", vertices, TREES);
	assert_true(vertices > 1000);
}

/* ---- colours ---- */

static void test_colors_are_the_fields(void **state)
{
	struct model model = model_make("{\"type\": \"union\","
	    " \"operator\": \"camel\", \"children\": [{\"type\": \"point\","
	    " \"center\": [-0.5, 0, 0], \"radius\": 0.5,"
	    " \"material\": {\"color\": [1, 0, 0]}}, {\"type\": \"point\","
	    " \"center\": [0.5, 0, 0], \"radius\": 0.5,"
	    " \"material\": {\"color\": [0, 0, 1]}}]}");
	struct mesh_options o = options_of(1.2, 20);
	struct mesh *m = mesh_of(&model, &o);

	(void)state;
	for (size_t i = 0; i < m->figures.vertices; i++) {
		const float *p = m->positions + 3 * i;
		struct vec3 c;

		evaluate_color(model.tape, vec3(p[0], p[1], p[2]), &c);
		assert_near(m->colors[3 * i], c.x, 1e-6);
		assert_near(m->colors[3 * i + 2], c.z, 1e-6);
	}
	mesh_free(m);
	model_free(&model);
}

static void test_no_materials_make_gray(void **state)
{
	struct model model = model_make(ball);
	struct mesh_options o = options_of(1.2, 10);
	struct mesh *m = mesh_of(&model, &o);

	(void)state;
	for (size_t i = 0; i < 3 * m->figures.vertices; i++)
		assert_near(m->colors[i], TREE_COLOR_DEFAULT, 1e-7);
	mesh_free(m);
	model_free(&model);
}

/* ---- figures ---- */

static void test_points_follow_the_surface(void **state)
{
	struct model model = model_make(ball);
	struct mesh_options o = options_of(1.2, 128);
	struct mesh *m = mesh_of(&model, &o);
	const struct mesh_figures *f = &m->figures;

	(void)state;
	printf("measured: %zu points of %zu, a %.1fth; %zu cells of %zu;"
	    " %zu vertices\n", f->points, f->full_points,
	    (double)f->full_points / (double)f->points, f->cells_evaluated,
	    f->cells, f->vertices);
	assert_true(f->points < f->full_points / 4); /* 4.9 */
	mesh_free(m);
	model_free(&model);
}

/* What is said of the vertices must not be less than what is true. */
static void check_error(const char *root, double reach)
{
	struct model model = model_make(root);

	for (int cells = 10; cells <= 40; cells += 5) {
		struct mesh_options o = options_of(reach, cells);
		struct mesh *m = mesh_of(&model, &o);
		double worst = 0.0;

		for (size_t i = 0; i < m->figures.vertices; i++) {
			const float *p = m->positions + 3 * i;
			struct jet j;

			evaluate(model.tape, vec3(p[0], p[1], p[2]), 0, &j);
			worst = fmax(worst, fabs(j.value - o.iso));
		}
		printf("measured: %d cells: largest error %.2e, said %.2e\n",
		    cells, worst, m->figures.largest_error);
		/* values are float32 */
		assert_true(worst <= m->figures.largest_error + 1e-6);
		mesh_free(m);
	}
	model_free(&model);
}

static void test_largest_error_is_not_too_small(void **state)
{
	(void)state;
	check_error("{\"type\": \"union\", \"operator\": \"camel\","
	    " \"children\": [{\"type\": \"circle\", \"center\": [-1, 0, 0],"
	    " \"normal\": [0, 0, 1], \"ring_radius\": 0.8, \"radius\": 0.25},"
	    "{\"type\": \"point\", \"center\": [1, 0, 0], \"radius\": 0.7}]}",
	    2.2);
	check_error("{\"type\": \"union\", \"operator\": \"organic\","
	    " \"children\": [{\"type\": \"segment\", \"a\": [-1, 0, 0],"
	    " \"b\": [1, 0.2, 0], \"radius\": 0.3}, {\"type\": \"segment\","
	    " \"a\": [0, -1, 0.2], \"b\": [0.1, 1, 0.1],"
	    " \"radius\": 0.2}]}", 1.6);
}

static void test_components_are_counted(void **state)
{
	struct model model = model_make("{\"type\": \"union\","
	    " \"operator\": \"sharp\", \"children\": ["
	    "{\"type\": \"sphere\", \"center\": [-0.6, 0, 0],"
	    " \"radius\": 0.3, \"falloff\": 0.2},"
	    "{\"type\": \"torus\", \"center\": [0.5, 0, 0],"
	    " \"axis\": [0, 0, 1], \"major\": 0.4, \"minor\": 0.1,"
	    " \"falloff\": 0.1}]}");
	struct mesh_options o = options_of(1.2, 40);
	struct mesh *m = mesh_of(&model, &o);

	(void)state;
	assert_int_equal(m->figures.components, 2);
	assert_int_equal(m->figures.euler, 2);
	assert_int_equal(m->figures.genus, 1);
	mesh_free(m);
	model_free(&model);
}

/* A tetrahedron, or two. */
static size_t faults_of(const uint32_t *triangles, size_t count,
    size_t vertices, size_t *vertex_faults)
{
	float positions[24] = {0};
	uint32_t copy[24];
	struct mesh m = {.positions = positions, .triangles = copy,
	    .figures = {.vertices = vertices, .triangles = count}};
	size_t edges;

	memcpy(copy, triangles, 3 * count * sizeof *copy);
	assert_int_equal(mesh_check(&m, &edges, vertex_faults), ERR_OK);
	return edges;
}

static void test_check_finds_faults(void **state)
{
	static const uint32_t whole[] = {0, 2, 1, 0, 1, 3, 1, 2, 3, 2, 0, 3};
	static const uint32_t turned_one[] = {0, 1, 2, 0, 1, 3, 1, 2, 3, 2, 0,
	    3};
	static const uint32_t pinched[] = {0, 2, 1, 0, 1, 3, 1, 2, 3, 2, 0, 3,
	    0, 5, 4, 0, 4, 6, 4, 5, 6, 5, 0, 6};
	static const uint32_t doubled[] = {0, 2, 1, 0, 1, 3, 1, 2, 3, 2, 0, 3,
	    0, 4, 1, 0, 1, 5, 1, 4, 5, 4, 0, 5};
	static const uint32_t flat[] = {0, 0, 1};
	size_t vertices;

	(void)state;
	assert_int_equal(faults_of(whole, 4, 4, &vertices), 0);
	assert_int_equal(vertices, 0);
	/* A hole: three edges, three vertices. */
	assert_int_equal(faults_of(whole, 3, 4, &vertices), 3);
	assert_int_equal(vertices, 3);
	assert_int_equal(faults_of(turned_one, 4, 4, &vertices), 3);
	assert_true(vertices > 0);
	/* Two tetrahedra with a vertex in common, with an edge. */
	assert_int_equal(faults_of(pinched, 8, 7, &vertices), 0);
	assert_int_equal(vertices, 1);
	assert_int_equal(faults_of(doubled, 8, 6, &vertices), 1);
	assert_true(vertices > 0);
	/* A vertex of no triangle; one that there is not; one used twice. */
	assert_int_equal(faults_of(whole, 4, 5, &vertices), 0);
	assert_int_equal(vertices, 1);
	assert_true(faults_of(whole, 4, 3, &vertices) > 0);
	assert_true(faults_of(flat, 1, 2, &vertices) > 0);
}

/* ---- small and large cells ---- */

/* The farthest that a vertex is from the unit sphere about center. */
static double sphere_off(const struct mesh *m, struct vec3 center)
{
	double most = 0.0;

	for (size_t i = 0; i < m->figures.vertices; i++) {
		const float *p = m->positions + 3 * i;

		most = fmax(most, fabs(vec3_norm(vec3_sub(vec3(p[0], p[1],
		    p[2]), center)) - 1.0));
	}
	return most;
}

/* A cap of height h of the unit ball, of a box that is flatter than a cell. */
static void test_caps_are_at_the_bounds(void **state)
{
	struct model model = model_make(ball);
	struct mesh_options o = {.min = vec3(-1.5, -1.5, 0.0),
	    .max = vec3(1.5, 1.5, 0.1), .edge = 0.1, .iso = 0.5,
	    .features = true, .normals = true};
	struct mesh *m;

	(void)state;
	for (int i = 0; i < 2; i++, o.edge *= 10.0 / 3.0) {
		m = mesh_of(&model, &o);
		printf("measured: slice, cells of %.2f: volume off by %.1e\n",
		    o.edge, m->figures.volume / (PI * (0.1 - 1e-3 / 3)) - 1.0);
		assert_near(m->figures.min.z, 0.0, 0.0);
		assert_near(m->figures.max.z, 0.1, 1e-8);
		/* 5.3e-4, 4.4e-3. */
		assert_near(m->figures.volume, PI * (0.1 - 1e-3 / 3),
		    i == 0 ? 2e-3 : 0.01);
		assert_near(m->figures.largest_error, 0.0, 1e-4);
		mesh_free(m);
	}
	model_free(&model);
}

static void test_flat_things_are_not_missed(void **state)
{
	struct model model = model_make("{\"type\": \"box\", \"center\":"
	    " [0, 0, 0], \"half_size\": [1, 1, 0.01], \"falloff\": 0.05}");
	struct mesh_options o = {.min = vec3(-1.002, -1.002, -0.012),
	    .max = vec3(1.002, 1.002, 0.012), .edge = 0.1, .iso = 0.5,
	    .counts_least = 4, .features = true};
	struct mesh *m = mesh_of(&model, &o);

	(void)state;
	printf("measured: plate, volume off by %.1e\n",
	    m->figures.volume / 0.08 - 1.0);
	assert_int_equal(m->figures.counts[2], 4);
	assert_near(m->figures.volume, 0.08, 1e-3);
	mesh_free(m);
	model_free(&model);
}

/* Far from the origin, where a cell has ever fewer of float32's numbers. */
static void test_far_balls_are_balls(void **state)
{
	(void)state;
	for (double x = 1e3; x < 3e4; x *= 5.0) {
		char root[256];
		struct model model;
		struct mesh_options o = {.min = vec3(x - 1.01, -1.01, -1.01),
		    .max = vec3(x + 1.01, 1.01, 1.01), .edge = 2.02 / 64,
		    .iso = 0.5, .features = true, .normals = true};
		struct mesh *m;

		snprintf(root, sizeof root, "{\"type\": \"sphere\","
		    " \"center\": [%.9g, 0, 0], \"radius\": 1,"
		    " \"falloff\": 0.5}", x);
		model = model_make(root);
		m = mesh_of(&model, &o);
		printf("measured: at %g: off by %.1e, volume by %.1e\n", x,
		    sphere_off(m, vec3(x, 0.0, 0.0)),
		    m->figures.volume / (4.0 / 3.0 * PI) - 1.0);
		assert_int_equal(m->figures.genus, 0);
		assert_int_equal(m->figures.components, 1);
		/* 1.1 of its steps: vertices keep one off faces. */
		assert_near(sphere_off(m, vec3(x, 0.0, 0.0)), 0.0,
		    1e-4 + 1.5 * 0x1p-23 * x);
		mesh_free(m);
		model_free(&model);
	}
}

/* Whatever the cells' size, vertices are on the surface. */
static void test_vertices_of_huge_cells_are_on_the_surface(void **state)
{
	struct model model = model_make(ball);

	(void)state;
	for (double reach = 1.001; reach < 2e9; reach *= 11.0) {
		struct mesh_options o = {.min = vec3(-reach, -reach, -reach),
		    .max = vec3(reach, reach, reach), .edge = reach,
		    .iso = 0.5, .features = true, .normals = true};
		struct mesh *m = mesh_of(&model, &o);

		assert_int_equal(m->figures.vertices, 8);
		assert_near(sphere_off(m, vec3(0.0, 0.0, 0.0)), 0.0, 1e-4);
		mesh_free(m);
	}
	model_free(&model);
}

/* ---- ends ---- */

static void test_limits(void **state)
{
	struct model model = model_make(ball);
	struct truth truth = truth_of(model.tape);
	struct mesh_options o = {.min = vec3(-1.0, -1.0, -1.0),
	    .max = vec3(1.0, 1.0, 1.0), .edge = 2.0 / 1025.0, .iso = 0.5};
	struct mesh *m = NULL;

	(void)state;
	assert_int_equal(mesh_build(model.ranges, &o, &truth.sampler, &m),
	    ERR_LIMIT);
	/* Cells of float32's steps. */
	o.min = vec3(1e6, 1e6, 1e6);
	o.max = vec3(1e6 + 1.0, 1e6 + 1.0, 1e6 + 1.0);
	o.edge = 0.1;
	assert_int_equal(mesh_build(model.ranges, &o, &truth.sampler, &m),
	    ERR_INVALID);
	assert_null(m);
	model_free(&model);
}

static void test_sampling_that_fails_is_passed_on(void **state)
{
	struct model model = model_make(ball);
	struct mesh_options o = options_of(1.2, 20);
	struct truth truth = truth_of(model.tape);
	struct mesh *m = NULL;
	size_t calls;

	(void)state;
	o.colors = true;
	assert_int_equal(mesh_build(model.ranges, &o, &truth.sampler, &m),
	    ERR_OK);
	mesh_free(m);
	m = NULL;
	calls = truth.calls;
	for (size_t i = 1; i <= calls; i++) {
		truth = truth_of(model.tape);
		truth.fail_at = i;
		assert_int_equal(mesh_build(model.ranges, &o, &truth.sampler,
		    &m), ERR_DEVICE);
		assert_null(m);
	}
	model_free(&model);
}

static void test_cancelled_at_any_question(void **state)
{
	struct model model = model_make(ball);
	struct mesh_options o = options_of(1.2, 20);
	struct truth truth = truth_of(model.tape);
	struct mesh *m = NULL;
	size_t asked;

	(void)state;
	assert_int_equal(mesh_build(model.ranges, &o, &truth.sampler, &m),
	    ERR_OK);
	mesh_free(m);
	m = NULL;
	asked = truth.asked;
	assert_true(asked >= 4);
	for (size_t i = 1; i <= asked; i++) {
		truth = truth_of(model.tape);
		truth.stop_at = i;
		assert_int_equal(mesh_build(model.ranges, &o, &truth.sampler,
		    &m), ERR_CANCELLED);
		assert_null(m);
	}
	model_free(&model);
}

static void test_every_allocation_may_fail(void **state)
{
	struct mesh_options o = options_of(1.5, 12);
	struct model model;
	struct truth truth;
	struct mesh *m = NULL;
	long n = 1;

	(void)state;
	if (!fail_alloc_available())
		skip();
	model = model_make(box);
	truth = truth_of(model.tape);
	for (;; n++) {
		enum err err;
		bool happened;

		fail_alloc_set(n);
		err = mesh_build(model.ranges, &o, &truth.sampler, &m);
		happened = fail_alloc_happened();
		if (!happened) {
			assert_int_equal(err, ERR_OK);
			mesh_free(m);
			assert_int_equal(fail_alloc_live(), 0);
			break;
		}
		if (err == ERR_OK) { /* qsort does without */
			mesh_free(m);
			m = NULL;
			continue;
		}
		assert_int_equal(err, ERR_MEMORY);
		assert_int_equal(fail_alloc_live(), 0);
		assert_null(m);
	}
	fail_alloc_set(0);
	assert_true(n > 15);
	model_free(&model);
}

int main(void)
{
	const struct CMUnitTest tests[] = {
		cmocka_unit_test(test_sphere_converges),
		cmocka_unit_test(test_torus_converges),
		cmocka_unit_test(test_genus_of_figure_eight_is_two),
		cmocka_unit_test(test_normals_point_outward),
		cmocka_unit_test(test_coarse_ball_has_no_edges),
		cmocka_unit_test(test_box_keeps_its_corners),
		cmocka_unit_test(test_creases_are_kept),
		cmocka_unit_test(test_half_space_is_capped),
		cmocka_unit_test(test_ball_cut_by_bounds_is_capped),
		cmocka_unit_test(test_nothing_inside_is_an_empty_mesh),
		cmocka_unit_test(test_all_inside_is_a_box),
		cmocka_unit_test(test_one_cell_is_enough),
		cmocka_unit_test(test_thin_parts_stay_manifold),
		cmocka_unit_test(test_random_trees_are_closed),
		cmocka_unit_test(test_colors_are_the_fields),
		cmocka_unit_test(test_no_materials_make_gray),
		cmocka_unit_test(test_points_follow_the_surface),
		cmocka_unit_test(test_largest_error_is_not_too_small),
		cmocka_unit_test(test_components_are_counted),
		cmocka_unit_test(test_check_finds_faults),
		cmocka_unit_test(test_caps_are_at_the_bounds),
		cmocka_unit_test(test_flat_things_are_not_missed),
		cmocka_unit_test(test_far_balls_are_balls),
		cmocka_unit_test(
		    test_vertices_of_huge_cells_are_on_the_surface),
		cmocka_unit_test(test_limits),
		cmocka_unit_test(test_sampling_that_fails_is_passed_on),
		cmocka_unit_test(test_cancelled_at_any_question),
		cmocka_unit_test(test_every_allocation_may_fail),
	};

	return cmocka_run_group_tests(tests, NULL, NULL);
}
