/*
 * Colours of pictures: sRGB (IEC 61966-2-1) and back, and maps from numbers to
 * colours. Internal to picture*.c.
 */
#ifndef CORE_PICTURE_COLOR_H
#define CORE_PICTURE_COLOR_H

#include <stdint.h>

#include "core/vec3.h"

/* A part of linear light in [0, 1] (cut to it) to sRGB's number in [0, 1], and
 * back. */
double picture_encode(double linear);
double picture_decode(double encoded);

/* The same for three, to bytes. */
void picture_put(struct vec3 linear, uint8_t rgb[static 3]);

/* Linear light of an sRGB colour 0xrrggbb. */
struct vec3 picture_hex(unsigned rgb);

/* From a to b, linear light, as t goes from 0 to 1 (cut to it), in even steps
 * to the eye: along a line in Oklab (Ottosson 2020). */
struct vec3 picture_mix(struct vec3 a, struct vec3 b, double t);

/* Smith and van der Walt's viridis at t in [0, 1] (cut to it); linear light. */
struct vec3 picture_viridis(double t);

/* Blue (-1), white (0), red (1); linear light. */
struct vec3 picture_diverging(double t);

#endif
