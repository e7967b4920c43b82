/*
 * Pictures (core/picture.h) by the float64 evaluator, and their files.
 */
#include <stdarg.h>
#include <stddef.h>
#include <setjmp.h>
#include <stdint.h>
#include <cmocka.h>

#include <math.h>
#include <stdlib.h>
#include <string.h>

#include <png.h>

#include "core/evaluate.h"
#include "core/output.h"
#include "core/picture.h"
#include "core/picture_color.h"
#include "core/range.h"
#include "core/surface.h"
#include "core/tape.h"
#include "proto/document.h"
#include "proto/fault.h"
#include "proto/png_file.h"
#include "tests/support/fail_alloc.h"
#include "tests/support/near.h"

#define PI 3.14159265358979323846

#define POINT "{\"format\":\"blobfield/1\",\"root\":{\"type\":\"point\"," \
	"\"center\":[0,0,0],\"radius\":1,\"material\":{\"color\":[1,0,0]}}}"

#define SIZE 64

struct truth {
	struct sampler sampler; /* the first member */
	const struct tape *tape;
	bool is_cancelled;
	double done;
};

static float *put3(float *row, struct vec3 v)
{
	row[0] = (float)v.x;
	row[1] = (float)v.y;
	row[2] = (float)v.z;
	return row + 3;
}

static enum err sample(struct sampler *s, const float *points, size_t count,
    unsigned outputs, float *rows)
{
	struct truth *t = (struct truth *)s;

	assert_false(outputs & OUTPUT_HESSIAN);
	for (size_t i = 0; i < count; i++) {
		const struct vec3 p = {points[3 * i], points[3 * i + 1],
		    points[3 * i + 2]};
		double mean, gaussian;
		struct vec3 color;
		struct jet f;

		evaluate(t->tape, p, 2, &f);
		evaluate_color(t->tape, p, &color);
		surface_curvature(&f, &mean, &gaussian);
		if (outputs & OUTPUT_VALUE)
			*rows++ = (float)f.value;
		if (outputs & OUTPUT_GRADIENT)
			rows = put3(rows, f.gradient);
		if (outputs & OUTPUT_COLOR)
			rows = put3(rows, color);
		if (outputs & OUTPUT_NORMAL)
			rows = put3(rows, surface_normal(&f));
		if (outputs & OUTPUT_CURVATURE) {
			*rows++ = (float)mean;
			*rows++ = (float)gaussian;
		}
	}
	return ERR_OK;
}

static bool go_on(struct sampler *s, const char *stage, double done)
{
	struct truth *t = (struct truth *)s;

	(void)stage;
	assert_true(done >= 0.0 && done <= 1.0);
	t->done = done;
	return !t->is_cancelled;
}

static const struct tape_box ball = {{-1, -1, -1}, {1, 1, 1}};

/* A ball of radius 1 before a camera on the y axis. */
static const struct picture_render front = {
	.width = SIZE, .height = SIZE, .samples = 4, .iso = 0.5,
	.camera = {.eye = {0, -5, 0}, .target = {0, 0, 0}, .up = {0, 0, 1},
	    .orthographic = true, .view_height = 4.0, .fov = 0.6},
	.extent = &ball,
};

static enum err render(const struct picture_render *options, uint8_t *rgba,
    bool is_cancelled)
{
	const struct document_limits limits = {.max_nodes = 100};
	struct faults faults = {0};
	struct range_tape *ranges;
	struct document *d;
	struct truth t = {{sample, go_on}, NULL, is_cancelled, 0.0};
	enum err err;

	assert_int_equal(document_parse(POINT, strlen(POINT), &limits, &d,
	    &faults), ERR_OK);
	t.tape = document_tape(d);
	assert_int_equal(range_tape_create(t.tape, &ranges), ERR_OK);
	err = picture_render(ranges, options, &t.sampler, rgba);
	range_tape_free(ranges);
	document_free(d);
	return err;
}

static const uint8_t *pixel(const uint8_t *rgba, int x, int y)
{
	return rgba + 4 * (SIZE * y + x);
}

/* ---- colours ---- */

static void test_srgb_and_back(void **state)
{
	uint8_t rgb[3];

	(void)state;
	for (int i = 0; i < 256; i++) {
		picture_put(picture_hex((unsigned)i << 16 | (unsigned)i << 8 |
		    (unsigned)(255 - i)), rgb);
		assert_int_equal(rgb[0], i);
		assert_int_equal(rgb[2], 255 - i);
	}
	/* IEC 61966-2-1: half of the light is 188. */
	picture_put(vec3(0.5, -1.0, 2.0), rgb);
	assert_int_equal(rgb[0], 188);
	assert_int_equal(rgb[1], 0);
	assert_int_equal(rgb[2], 255);
}

static void test_mixing_in_oklab_keeps_the_ends(void **state)
{
	const struct vec3 a = picture_hex(0x112244), b = picture_hex(0xffaa00);

	(void)state;
	/* The matrices have ten digits. */
	assert_near(picture_mix(a, b, 0.0).x, a.x, 1e-6);
	assert_near(picture_mix(a, b, 1.0).y, b.y, 1e-6);
	assert_near(picture_mix(a, b, 7.0).y, b.y, 1e-6);
	assert_near(picture_viridis(0.0).x, picture_hex(0x440154).x, 1e-6);
	assert_near(picture_viridis(1.0).x, picture_hex(0xfde725).x, 1e-6);
	assert_true(picture_diverging(1.0).x > picture_diverging(1.0).z);
	assert_true(picture_diverging(-1.0).x < picture_diverging(-1.0).z);
}

/* ---- render ---- */

static void test_a_ball_is_a_disc(void **state)
{
	static uint8_t rgba[4 * SIZE * SIZE];
	double area = 0.0;

	(void)state;
	assert_int_equal(render(&front, rgba, false), ERR_OK);
	for (int i = 0; i < SIZE * SIZE; i++)
		area += rgba[4 * i + 3] / 255.0;
	/* 16 pixels a unit; the rim's 100 pixels are right to a quarter each,
	 * with either sign */
	assert_near(area, PI * 256.0, 4.0);
	assert_int_equal(pixel(rgba, 0, 0)[3], 0);
	assert_int_equal(pixel(rgba, 32, 32)[3], 255);
	/* red, and lit */
	assert_true(pixel(rgba, 28, 28)[0] > 180);
	assert_true(pixel(rgba, 28, 28)[1] < 140);
	/* from the upper left */
	assert_true(pixel(rgba, 24, 24)[0] > pixel(rgba, 42, 42)[0] + 30);
}

static void test_normals_are_colours(void **state)
{
	static uint8_t rgba[4 * SIZE * SIZE];
	struct picture_render o = front;

	(void)state;
	o.shading = SHADING_NORMAL;
	assert_int_equal(render(&o, rgba, false), ERR_OK);
	/* Pixel 47.5 is at x = 31/32 of right (x), up (z). */
	assert_near(pixel(rgba, 32, 32)[1], 0.0, 1.0);
	assert_near(pixel(rgba, 32, 32)[0], 255.0 * 0.5 * (1.0 + 1.0 / 32),
	    1.0);
	assert_near(pixel(rgba, 40, 32)[0], 255.0 * 0.5 * (1.0 + 17.0 / 32),
	    1.5);
	assert_near(pixel(rgba, 32, 20)[2], 255.0 * 0.5 * (1.0 + 23.0 / 32),
	    1.5);
}

static void test_a_background_is_mixed_in(void **state)
{
	static uint8_t rgba[4 * SIZE * SIZE];
	struct picture_render o = front;

	(void)state;
	o.has_background = true;
	o.background = vec3(0.0, 0.5, 1.0);
	assert_int_equal(render(&o, rgba, false), ERR_OK);
	assert_int_equal(pixel(rgba, 0, 0)[0], 0);
	assert_int_equal(pixel(rgba, 0, 0)[1], 188);
	assert_int_equal(pixel(rgba, 0, 0)[2], 255);
	for (int i = 0; i < SIZE * SIZE; i++)
		assert_int_equal(rgba[4 * i + 3], 255);
}

static void test_every_shading_fills_the_disc(void **state)
{
	static uint8_t rgba[4 * SIZE * SIZE];
	struct picture_render o = front;

	(void)state;
	o.samples = 1;
	for (int i = 0; i < SHADING_COUNT; i++) {
		o.shading = (enum picture_shading)i;
		assert_int_equal(render(&o, rgba, false), ERR_OK);
		assert_int_equal(pixel(rgba, 32, 32)[3], 255);
	}
	/* A ball is convex: red; and as steep everywhere. */
	o.shading = SHADING_CURVATURE;
	assert_int_equal(render(&o, rgba, false), ERR_OK);
	assert_true(pixel(rgba, 32, 32)[0] > pixel(rgba, 32, 32)[2] + 10);
}

/* By a perspective camera a ball of radius r at distance d is seen under the
 * angle asin(r / d). */
static void test_a_perspective_ball(void **state)
{
	static uint8_t rgba[4 * SIZE * SIZE];
	struct picture_render o = front;
	const double radius = tan(asin(0.2)) / tan(0.3) * 32.0;
	double area = 0.0;

	(void)state;
	o.camera.orthographic = false;
	assert_int_equal(render(&o, rgba, false), ERR_OK);
	for (int i = 0; i < SIZE * SIZE; i++)
		area += rgba[4 * i + 3] / 255.0;
	assert_near(area, PI * radius * radius, 4.0);
}

static void test_framing_holds_the_box(void **state)
{
	static const struct tape_box boxes[] = {
		{{-1, -1, -1}, {1, 1, 1}}, {{5, 5, 5}, {5.1f, 9, 5.2f}},
		{{0, 0, 0}, {0, 0, 1000}}, {{1, 1, 1}, {-1, -1, -1}},
		{{-1, -1, -INFINITY}, {1, 1, INFINITY}},
	};

	(void)state;
	for (size_t i = 0; i < sizeof boxes / sizeof *boxes; i++) {
		struct picture_camera c = picture_frame(&boxes[i], 300, 200);
		struct vec3 forward = vec3_unit(vec3_sub(c.target, c.eye));

		assert_true(isfinite(c.eye.x) && isfinite(c.eye.z));
		assert_near(forward.x, -1.0 / sqrt(5.81), 1e-9);
		for (int k = 0; i < 3 && k < 8; k++) {
			const float *const ends[2] = {boxes[i].min,
			    boxes[i].max};
			struct vec3 p = vec3_sub(vec3(ends[k & 1][0],
			    ends[k >> 1 & 1][1], ends[k >> 2][2]), c.eye);
			double z = vec3_dot(p, forward);
			double side = vec3_norm(vec3_axpy(-z, forward, p));

			assert_true(z > 0.0);
			assert_true(side / z < tan(0.3) * hypot(1.0, 1.5));
		}
	}
}

static void test_a_view_along_up_is_fine(void **state)
{
	static uint8_t rgba[4 * SIZE * SIZE];
	struct picture_render o = front;

	(void)state;
	o.camera.eye = vec3(0.0, 0.0, 5.0);
	assert_int_equal(render(&o, rgba, false), ERR_OK);
	assert_int_equal(pixel(rgba, 32, 32)[3], 255);
}

static void test_render_is_cancelled(void **state)
{
	static uint8_t rgba[4 * SIZE * SIZE];

	(void)state;
	assert_int_equal(render(&front, rgba, true), ERR_CANCELLED);
}

/* ---- slices ---- */

static const struct picture_slice plane = {
	.width = 4, .height = 2, .center = {1, 2, 3}, .right = {1, 0, 0},
	.up = {0, 0, 1}, .pixel = 0.5, .iso = 0.5,
	.levels = {0.75, 0.25}, .level_count = 2,
};

static void test_slice_points_are_pixels_middles(void **state)
{
	float points[3 * 8];

	(void)state;
	picture_slice_points(&plane, points);
	assert_near(points[0], 1.0 - 0.75, 0.0);
	assert_near(points[1], 2.0, 0.0);
	assert_near(points[2], 3.25, 0.0);
	assert_near(points[3 * 7], 1.75, 0.0);
	assert_near(points[3 * 7 + 2], 2.75, 0.0);
}

static void paint_one(double value, double slope, uint8_t rgba[static 4])
{
	struct picture_slice o = plane;
	const float row[4] = {(float)value, (float)slope, 100.0f, 0.0f};

	/* The gradient across the plane does not count. */
	o.width = o.height = 1;
	picture_slice_paint(&o, row, rgba);
}

static void test_slice_colours_and_lines(void **state)
{
	uint8_t c[4], line[4], iso[4];

	(void)state;
	paint_one(0.4, 0.0, c);
	assert_true(c[2] > c[0] + 20);
	paint_one(0.9, 0.0, c);
	assert_true(c[0] > c[2] + 60);
	assert_int_equal(c[3], 255);
	paint_one(0.5, 0.1, iso);
	paint_one(0.25, 0.1, line);
	assert_true(iso[0] < 80 && iso[1] < 80);
	assert_true(line[0] > 60 && line[0] < 220);
	/* A pixel and a half from iso, 0.05 a pixel: out of its line. */
	paint_one(0.5 + 0.05 * 2.0, 0.1, c);
	assert_true(c[0] > 200);
	/* Between, the edge is soft. */
	paint_one(0.5 + 0.05 * 1.4, 0.1, c);
	assert_true(c[0] > iso[0] + 20 && c[0] < 240);
}

/* ---- files ---- */

static void round_trip(const uint8_t *rgba, size_t width, size_t height,
    bool has_alpha)
{
	png_image image = {.version = PNG_IMAGE_VERSION};
	uint8_t *back = malloc(4 * width * height);
	size_t length;
	char *file;

	assert_int_equal(png_write(rgba, width, height, &file, &length),
	    ERR_OK);
	assert_int_equal(png_image_begin_read_from_memory(&image, file,
	    length), 1);
	assert_int_equal(image.width, width);
	assert_int_equal(image.height, height);
	assert_int_equal((image.format & PNG_FORMAT_FLAG_ALPHA) != 0,
	    has_alpha);
	image.format = PNG_FORMAT_RGBA;
	assert_int_equal(png_image_finish_read(&image, NULL, back, 0, NULL),
	    1);
	assert_memory_equal(back, rgba, 4 * width * height);
	free(back);
	free(file);
}

static void test_files_hold_the_pixels(void **state)
{
	uint8_t rgba[4 * 7 * 5];

	(void)state;
	for (size_t i = 0; i < sizeof rgba; i++)
		rgba[i] = (uint8_t)(i * 37);
	round_trip(rgba, 7, 5, true);
	for (size_t i = 3; i < sizeof rgba; i += 4)
		rgba[i] = 255;
	round_trip(rgba, 7, 5, false);
	round_trip(rgba, 1, 1, false);
}

static void test_files_without_memory(void **state)
{
	static uint8_t rgba[4 * 32 * 32];
	enum err err = ERR_MEMORY;
	size_t length;
	char *file;

	(void)state;
	if (!fail_alloc_available())
		skip();
	for (long n = 1; err != ERR_OK; n++) {
		fail_alloc_set(n);
		err = png_write(rgba, 32, 32, &file, &length);
		if (err == ERR_OK)
			free(file);
		assert_int_equal(fail_alloc_live(), 0);
	}
	fail_alloc_set(0);
}

static void test_render_without_memory(void **state)
{
	static uint8_t rgba[4 * SIZE * SIZE];
	const struct document_limits limits = {.max_nodes = 100};
	struct picture_render o = front;
	struct faults faults = {0};
	struct range_tape *ranges;
	struct document *d;
	struct truth t = {{sample, go_on}, NULL, false, 0.0};
	enum err err = ERR_MEMORY;

	(void)state;
	if (!fail_alloc_available())
		skip();
	assert_int_equal(document_parse(POINT, strlen(POINT), &limits, &d,
	    &faults), ERR_OK);
	t.tape = document_tape(d);
	assert_int_equal(range_tape_create(t.tape, &ranges), ERR_OK);
	o.width = o.height = 4;
	for (long n = 1; err != ERR_OK; n++) {
		fail_alloc_set(n);
		err = picture_render(ranges, &o, &t.sampler, rgba);
		assert_int_equal(fail_alloc_live(), 0);
		assert_int_equal(err, fail_alloc_happened() ? ERR_MEMORY :
		    ERR_OK);
	}
	fail_alloc_set(0);
	range_tape_free(ranges);
	document_free(d);
}

int main(void)
{
	const struct CMUnitTest tests[] = {
		cmocka_unit_test(test_srgb_and_back),
		cmocka_unit_test(test_mixing_in_oklab_keeps_the_ends),
		cmocka_unit_test(test_a_ball_is_a_disc),
		cmocka_unit_test(test_normals_are_colours),
		cmocka_unit_test(test_a_background_is_mixed_in),
		cmocka_unit_test(test_every_shading_fills_the_disc),
		cmocka_unit_test(test_a_perspective_ball),
		cmocka_unit_test(test_framing_holds_the_box),
		cmocka_unit_test(test_a_view_along_up_is_fine),
		cmocka_unit_test(test_render_is_cancelled),
		cmocka_unit_test(test_slice_points_are_pixels_middles),
		cmocka_unit_test(test_slice_colours_and_lines),
		cmocka_unit_test(test_files_hold_the_pixels),
		cmocka_unit_test(test_files_without_memory),
		cmocka_unit_test(test_render_without_memory),
	};

	return cmocka_run_group_tests(tests, NULL, NULL);
}
