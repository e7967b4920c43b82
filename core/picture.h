/*
 * Pictures of a field: its surface from a camera, or a plane through it.
 */
#ifndef CORE_PICTURE_H
#define CORE_PICTURE_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#include "core/err.h"
#include "core/sampler.h"
#include "core/vec3.h"

struct range_tape;
struct tape_box;

#define PICTURE_SIZE_MAX 4096
#define PICTURE_LEVELS_MAX 256
/* Rays of a picture: 3840 x 2160 of 4 a pixel, and some. */
#define PICTURE_RAYS_MAX 50000000

enum picture_shading {
	SHADING_LIT,
	SHADING_NORMAL,
	SHADING_ZEBRA,
	SHADING_CURVATURE,
	SHADING_FIELD,
	SHADING_COUNT
};

struct picture_camera {
	struct vec3 eye, target;
	struct vec3 up;     /* along the view: another is taken */
	bool orthographic;
	double fov;         /* vertical, radians, of perspective */
	double view_height; /* world units, of orthographic */
};

/* A camera from (1, -2, 0.9) that frames extent (finite). */
struct picture_camera picture_frame(const struct tape_box *extent,
    size_t width, size_t height);

struct picture_render {
	size_t width, height;   /* 1 to PICTURE_SIZE_MAX */
	struct picture_camera camera;
	enum picture_shading shading;
	bool has_background;    /* else transparent */
	struct vec3 background; /* linear RGB */
	int samples;            /* rays a pixel: 1, 4, 9, 16 */
	double iso;
	const struct tape_box *extent; /* of the surface */
};

/* width * height pixels, sRGB with alpha, first row at the top. Stages "rays",
 * "shading". Errors as raycast. */
enum err picture_render(const struct range_tape *tape,
    const struct picture_render *options, struct sampler *sampler,
    uint8_t *rgba);

struct picture_slice {
	size_t width, height;
	struct vec3 center, right, up; /* right, up: unit, orthogonal */
	double pixel;                  /* world units */
	double iso;
	double levels[PICTURE_LEVELS_MAX];
	size_t level_count;
};

/* The pixels' places, 3 * width * height floats, rows from the top. */
void picture_slice_points(const struct picture_slice *options, float *points);

/* Colours of values and gradients (rows of 4: value, gradient) at those places:
 * the field, with lines at the levels, a thick one at iso. */
void picture_slice_paint(const struct picture_slice *options,
    const float *rows, uint8_t *rgba);

#endif
