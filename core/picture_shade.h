/*
 * How a surface looks from where a ray came. Internal to picture*.c.
 */
#ifndef CORE_PICTURE_SHADE_H
#define CORE_PICTURE_SHADE_H

#include "core/picture.h"
#include "core/vec3.h"

/* A camera's directions, unit. */
struct picture_view {
	struct vec3 right, up, forward;
};

/* Steps of a map from numbers to colours. */
#define PICTURE_MAP 256

/* How all of a picture is shaded. */
struct picture_look {
	enum picture_shading shading;
	struct picture_view view;
	double size;        /* of the surface: half its box's longest edge */
	struct vec3 map[PICTURE_MAP]; /* of shadings that use one */
};

/* Makes look's map; the rest is set. */
void picture_look_init(struct picture_look *look);

/* What the surface is like at a place. */
struct picture_place {
	struct vec3 ray;    /* unit, from the eye */
	struct vec3 normal; /* unit, outward, or 0 */
	struct vec3 color;  /* linear */
	double mean_curvature;
	double steepness;   /* of f */
};

/* The outputs (core/output.h) that a shading asks for. */
unsigned picture_outputs(enum picture_shading shading);

/* The place that row, of those outputs, tells of. */
struct picture_place picture_place(enum picture_shading shading,
    const float *row, struct vec3 ray);

/* Its light, linear. */
struct vec3 picture_shade(const struct picture_look *look,
    const struct picture_place *place);

#endif
