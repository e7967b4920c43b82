/*
 * Pictures and slices over the wire.
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

#include <png.h>

#include "core/evaluate.h"
#include "core/tape.h"
#include "proto/document.h"
#include "proto/fault.h"
#include "tests/support/daemon.h"
#include "tests/support/http.h"
#include "tests/support/near.h"

#define PI 3.14159265358979323846

#define BALL "{\"format\":\"blobfield/1\",\"root\":{\"type\":\"point\"," \
	"\"center\":[1,0,0],\"radius\":1,\"material\":{\"color\":[0,0,1]}}}"
#define BLEND "{\"format\":\"blobfield/1\",\"root\":{\"type\":\"union\"," \
	"\"operator\":\"blend\",\"children\":[" \
	"{\"type\":\"segment\",\"a\":[-2,0,0],\"b\":[2,0,0],\"radius\":0.4}," \
	"{\"type\":\"point\",\"center\":[0,0,0.5],\"radius\":0.9}]}}"
#define PLANE "{\"format\":\"blobfield/1\",\"root\":{\"type\":\"plane\"," \
	"\"point\":[0,0,0],\"normal\":[0,0,1],\"falloff\":0.5}}"

/* A picture as it came: pixels as sRGB with alpha. */
struct picture {
	unsigned width, height;
	uint8_t *rgba;
};

static void put(const char *url, const char *path, const char *document)
{
	struct http_reply reply;

	http_json(url, "PUT", path, document, &reply);
	assert_true(reply.status == 200 || reply.status == 201);
	http_reply_fini(&reply);
}

static long post(const char *url, const char *path, const char *body,
    const char *accept, struct http_reply *reply)
{
	http_do(url, &(struct http_request){
		.path = path,
		.body = body,
		.length = strlen(body),
		.headers = {"Content-Type: application/json", accept},
	}, reply);
	return reply->status;
}

static struct picture get(const char *url, const char *path, const char *body)
{
	png_image image = {.version = PNG_IMAGE_VERSION};
	struct http_reply reply;
	struct picture p;
	char type[64];

	assert_int_equal(post(url, path, body, NULL, &reply), 200);
	assert_string_equal(http_header(&reply, "Content-Type", type,
	    sizeof type), "image/png");
	assert_int_equal(png_image_begin_read_from_memory(&image, reply.body,
	    reply.length), 1);
	image.format = PNG_FORMAT_RGBA;
	p = (struct picture){image.width, image.height,
	    malloc(PNG_IMAGE_SIZE(image))};
	assert_int_equal(png_image_finish_read(&image, NULL, p.rgba, 0, NULL),
	    1);
	http_reply_fini(&reply);
	return p;
}

static const uint8_t *pixel(const struct picture *p, unsigned x, unsigned y)
{
	return p->rgba + 4 * (p->width * y + x);
}

static void test_a_ball_is_rendered(void **state)
{
	const struct daemon *d = *state;
	struct picture p;
	double area = 0.0;

	put(d->url, "/v1/scenes/ball", BALL);
	p = get(d->url, "/v1/scenes/ball/render", "{\"width\":120,"
	    "\"height\":80,\"camera\":{\"eye\":[1,-5,0],\"target\":[1,0,0],"
	    "\"projection\":\"orthographic\",\"view_height\":4}}");
	assert_int_equal(p.width, 120);
	assert_int_equal(p.height, 80);
	for (unsigned i = 0; i < p.width * p.height; i++)
		area += p.rgba[4 * i + 3] / 255.0;
	/* 20 pixels a unit */
	assert_near(area, PI * 400.0, 6.0);
	assert_int_equal(pixel(&p, 60, 40)[3], 255);
	assert_true(pixel(&p, 55, 35)[2] > 150);
	assert_true(pixel(&p, 55, 35)[0] < 120);
	free(p.rgba);
	p = get(d->url, "/v1/scenes/ball/render", "{\"width\":64,"
	    "\"height\":64,\"shading\":\"normal\",\"samples\":1,"
	    "\"camera\":{\"eye\":[1,-5,0],\"target\":[1,0,0]}}");
	assert_near(pixel(&p, 32, 32)[1], 0.0, 1.0);
	free(p.rgba);
}

static void test_the_default_camera_frames_it(void **state)
{
	const struct daemon *d = *state;
	struct picture p;
	size_t inside = 0;

	put(d->url, "/v1/scenes/blend", BLEND);
	p = get(d->url, "/v1/scenes/blend/render", "{\"width\":96,"
	    "\"height\":64,\"background\":[1,1,1],\"shading\":\"zebra\"}");
	for (unsigned i = 0; i < p.width * p.height; i++) {
		const unsigned x = i % p.width, y = i / p.width;
		const bool is_rim = x == 0 || y == 0 || x + 1 == p.width ||
		    y + 1 == p.height;

		assert_int_equal(p.rgba[4 * i + 3], 255);
		if (is_rim)
			assert_int_equal(p.rgba[4 * i], 255);
		inside += p.rgba[4 * i] < 250;
	}
	/* It fills a good part of it. */
	assert_true(inside > p.width * p.height / 12);
	free(p.rgba);
}

static void test_other_shadings(void **state)
{
	static const char *const names[] = {"curvature", "field"};
	const struct daemon *d = *state;
	char body[128];

	put(d->url, "/v1/scenes/ball", BALL);
	for (int i = 0; i < 2; i++) {
		struct picture p;

		snprintf(body, sizeof body, "{\"width\":32,\"height\":32,"
		    "\"shading\":\"%s\"}", names[i]);
		p = get(d->url, "/v1/scenes/ball/render", body);
		assert_int_equal(pixel(&p, 16, 16)[3], 255);
		free(p.rgba);
	}
}

static void test_nothing_is_an_empty_picture(void **state)
{
	const struct daemon *d = *state;
	struct picture p;

	put(d->url, "/v1/scenes/none", "{\"format\":\"blobfield/1\",\"root\":{"
	    "\"type\":\"point\",\"center\":[0,0,0],\"radius\":1,"
	    "\"weight\":0.2}}");
	p = get(d->url, "/v1/scenes/none/render", "{\"width\":9,"
	    "\"height\":9}");
	for (unsigned i = 0; i < 81; i++)
		assert_int_equal(p.rgba[4 * i + 3], 0);
	free(p.rgba);
	p = get(d->url, "/v1/scenes/none/slice", "{\"width\":9,"
	    "\"height\":9}");
	assert_int_equal(p.width, 9);
	free(p.rgba);
}

static void refused(const char *url, const char *path, const char *body,
    const char *what)
{
	struct http_reply reply;

	assert_int_equal(post(url, path, body, NULL, &reply), 422);
	if (strstr(reply.body, what) == NULL)
		fail_msg("%s: %s", body, reply.body);
	http_reply_fini(&reply);
}

static void test_what_has_no_end_must_be_framed(void **state)
{
	const struct daemon *d = *state;
	struct picture p;

	put(d->url, "/v1/scenes/plane", PLANE);
	refused(d->url, "/v1/scenes/plane/render", "{}", "\"/camera\"");
	refused(d->url, "/v1/scenes/plane/slice", "{}", "\"/center\"");
	refused(d->url, "/v1/scenes/plane/slice", "{\"center\":[0,0,0]}",
	    "\"/extent\"");
	p = get(d->url, "/v1/scenes/plane/render", "{\"width\":16,"
	    "\"height\":16,\"camera\":{\"eye\":[0,-3,3],"
	    "\"target\":[0,0,0]}}");
	assert_int_equal(pixel(&p, 8, 12)[3], 255);
	free(p.rgba);
}

static void test_wrong_members_are_named(void **state)
{
	const struct daemon *d = *state;

	put(d->url, "/v1/scenes/ball", BALL);
	refused(d->url, "/v1/scenes/ball/render", "{\"width\":5000}",
	    "\"/width\"");
	refused(d->url, "/v1/scenes/ball/render", "{\"shading\":\"x\"}",
	    "\"/shading\"");
	refused(d->url, "/v1/scenes/ball/render", "{\"width\":4096,"
	    "\"height\":4096}", "/problems/limit");
	refused(d->url, "/v1/scenes/ball/slice", "{\"normal\":[0,0,1],"
	    "\"up\":[0,0,1]}", "\"/up\"");
	refused(d->url, "/v1/scenes/ball/slice", "{\"output\":\"normal\"}",
	    "\"/output\"");
	refused(d->url, "/v1/scenes/ball/slice?outputs=gradient", "{}",
	    "\"?outputs\"");
	refused(d->url, "/v1/scenes/ball/slice?outputs=all", "{}",
	    "\"?outputs\"");
}

/* ---- slices ---- */

static double ball_value(double x, double y, double z)
{
	const double b = 1.0 - (x * x + y * y + z * z) * (1.0 - cbrt(0.5));

	return b > 0.0 ? b * b * b : 0.0;
}

static void test_a_slice_as_numbers(void **state)
{
	const struct daemon *d = *state;
	struct http_reply reply;
	const float *rows;

	put(d->url, "/v1/scenes/ball", BALL);
	assert_int_equal(post(d->url, "/v1/scenes/ball/slice?outputs=value,"
	    "gradient", "{\"width\":6,\"height\":4,\"extent\":3,"
	    "\"center\":[1,0.2,0]}", "Accept: application/x-npy", &reply),
	    200);
	assert_non_null(strstr(reply.body + 10, "'shape': (4, 6, 4)"));
	assert_int_equal(reply.length, 128 + 4 * 6 * 4 * sizeof(float));
	rows = (const float *)(const void *)(reply.body + 128);
	for (int j = 0; j < 4; j++) {
		for (int i = 0; i < 6; i++) {
			const double x = 0.5 * (i + 0.5 - 3.0);
			const double z = 0.5 * (2.0 - (j + 0.5));

			assert_near(rows[4 * (6 * j + i)], ball_value(x, 0.2,
			    z), 1e-6);
			/* towards the middle */
			assert_true(rows[4 * (6 * j + i) + 1] * x <= 0.0);
			assert_true(rows[4 * (6 * j + i) + 3] * z <= 0.0);
		}
	}
	http_reply_fini(&reply);
	assert_int_equal(post(d->url, "/v1/scenes/ball/slice", "{\"width\":3,"
	    "\"height\":2,\"output\":\"value\"}",
	    "Accept: application/x-npy", &reply), 200);
	assert_non_null(strstr(reply.body + 10, "'shape': (2, 3)"));
	http_reply_fini(&reply);
}

/* Seen from above, x goes right and y up. */
static void test_a_slice_from_above(void **state)
{
	const struct daemon *d = *state;
	struct http_reply reply;
	const float *rows;

	put(d->url, "/v1/scenes/ball", BALL);
	assert_int_equal(post(d->url, "/v1/scenes/ball/slice", "{\"width\":2,"
	    "\"height\":2,\"extent\":2,\"center\":[1.3,0.2,0],"
	    "\"normal\":[0,0,1]}", "Accept: application/x-npy", &reply), 200);
	rows = (const float *)(const void *)(reply.body + 128);
	assert_near(rows[0], ball_value(-0.2, 0.7, 0.0), 1e-6);
	assert_near(rows[1], ball_value(0.8, 0.7, 0.0), 1e-6);
	assert_near(rows[2], ball_value(-0.2, -0.3, 0.0), 1e-6);
	assert_near(rows[3], ball_value(0.8, -0.3, 0.0), 1e-6);
	http_reply_fini(&reply);
}

static void test_a_slice_as_a_picture(void **state)
{
	const struct daemon *d = *state;
	struct picture p;

	put(d->url, "/v1/scenes/ball", BALL);
	p = get(d->url, "/v1/scenes/ball/slice", "{\"width\":200,"
	    "\"height\":200,\"extent\":4,\"center\":[1,0,0],\"levels\":[]}");
	/* warm inside, cold outside, dark at radius 50 */
	assert_true(pixel(&p, 100, 80)[0] > pixel(&p, 100, 80)[2] + 50);
	assert_true(pixel(&p, 100, 40)[2] > pixel(&p, 100, 40)[0] + 10);
	assert_true(pixel(&p, 100, 49)[0] < 100 || pixel(&p, 100, 50)[0] <
	    100);
	assert_int_equal(pixel(&p, 0, 0)[3], 255);
	free(p.rgba);
	/* By default the surface is in the middle, and all of it. */
	p = get(d->url, "/v1/scenes/ball/slice", "{\"width\":100,"
	    "\"height\":100}");
	assert_true(pixel(&p, 50, 50)[0] > pixel(&p, 50, 50)[2] + 50);
	assert_true(pixel(&p, 1, 50)[2] > pixel(&p, 1, 50)[0]);
	assert_true(pixel(&p, 98, 50)[2] > pixel(&p, 98, 50)[0]);
	free(p.rgba);
}

int main(void)
{
	const struct CMUnitTest tests[] = {
		cmocka_unit_test(test_a_ball_is_rendered),
		cmocka_unit_test(test_the_default_camera_frames_it),
		cmocka_unit_test(test_other_shadings),
		cmocka_unit_test(test_nothing_is_an_empty_picture),
		cmocka_unit_test(test_what_has_no_end_must_be_framed),
		cmocka_unit_test(test_wrong_members_are_named),
		cmocka_unit_test(test_a_slice_as_numbers),
		cmocka_unit_test(test_a_slice_from_above),
		cmocka_unit_test(test_a_slice_as_a_picture),
	};

	return cmocka_run_group_tests(tests, daemon_setup, daemon_teardown);
}
