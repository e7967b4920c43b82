#include "core/picture_color.h"

#include <math.h>
#include <stddef.h>

static double clamp(double x, double least, double most)
{
	return fmin(fmax(x, least), most);
}

double picture_encode(double linear)
{
	linear = clamp(linear, 0.0, 1.0);
	return linear <= 0.0031308 ? 12.92 * linear :
	    1.055 * pow(linear, 1.0 / 2.4) - 0.055;
}

double picture_decode(double encoded)
{
	encoded = clamp(encoded, 0.0, 1.0);
	return encoded <= 0.04045 ? encoded / 12.92 :
	    pow((encoded + 0.055) / 1.055, 2.4);
}

void picture_put(struct vec3 linear, uint8_t rgb[static 3])
{
	rgb[0] = (uint8_t)(255.0 * picture_encode(linear.x) + 0.5);
	rgb[1] = (uint8_t)(255.0 * picture_encode(linear.y) + 0.5);
	rgb[2] = (uint8_t)(255.0 * picture_encode(linear.z) + 0.5);
}

struct vec3 picture_hex(unsigned rgb)
{
	return vec3(picture_decode((rgb >> 16 & 255) / 255.0),
	    picture_decode((rgb >> 8 & 255) / 255.0),
	    picture_decode((rgb & 255) / 255.0));
}

/* m v, rows of m one after the other. */
static struct vec3 apply(const double m[static 9], struct vec3 v)
{
	return vec3(m[0] * v.x + m[1] * v.y + m[2] * v.z,
	    m[3] * v.x + m[4] * v.y + m[5] * v.z,
	    m[6] * v.x + m[7] * v.y + m[8] * v.z);
}

/* Oklab's: linear sRGB to the cones' answers, their cube roots to lightness and
 * two opponent colours; and the inverses. */
static struct vec3 to_lab(struct vec3 c)
{
	static const double cones[9] = {
		0.4122214708, 0.5363325363, 0.0514459929,
		0.2119034982, 0.6806995451, 0.1073969566,
		0.0883024619, 0.2817188376, 0.6299787005,
	};
	static const double lab[9] = {
		0.2104542553, 0.7936177850, -0.0040720468,
		1.9779984951, -2.4285922050, 0.4505937099,
		0.0259040371, 0.7827717662, -0.8086757660,
	};
	const struct vec3 lms = apply(cones, c);

	return apply(lab, vec3(cbrt(lms.x), cbrt(lms.y), cbrt(lms.z)));
}

static struct vec3 from_lab(struct vec3 lab)
{
	static const double roots[9] = {
		1.0, 0.3963377774, 0.2158037573,
		1.0, -0.1055613458, -0.0638541728,
		1.0, -0.0894841775, -1.2914855480,
	};
	static const double rgb[9] = {
		4.0767416621, -3.3077115913, 0.2309699292,
		-1.2684380046, 2.6097574011, -0.3413193965,
		-0.0041960863, -0.7034186147, 1.7076147010,
	};
	const struct vec3 r = apply(roots, lab);

	return apply(rgb, vec3(r.x * r.x * r.x, r.y * r.y * r.y,
	    r.z * r.z * r.z));
}

struct vec3 picture_mix(struct vec3 a, struct vec3 b, double t)
{
	const struct vec3 from = to_lab(a), to = to_lab(b);
	const struct vec3 c = from_lab(vec3_axpy(clamp(t, 0.0, 1.0),
	    vec3_sub(to, from), from));

	return vec3(clamp(c.x, 0.0, 1.0), clamp(c.y, 0.0, 1.0),
	    clamp(c.z, 0.0, 1.0));
}

/* Between count colours in even steps. */
static struct vec3 ramp(const unsigned *colors, size_t count, double t)
{
	const double at = clamp(t, 0.0, 1.0) * (double)(count - 1);
	const size_t i = at < (double)(count - 1) ? (size_t)at : count - 2;

	return picture_mix(picture_hex(colors[i]), picture_hex(colors[i + 1]),
	    at - (double)i);
}

struct vec3 picture_viridis(double t)
{
	static const unsigned colors[] = {0x440154, 0x472d7b, 0x3b528b,
	    0x2c728e, 0x21918c, 0x28ae80, 0x5ec962, 0xaddc30, 0xfde725};

	return ramp(colors, sizeof colors / sizeof *colors, t);
}

struct vec3 picture_diverging(double t)
{
	static const unsigned colors[] = {0x1f4aa8, 0x6f9fe0, 0xf2f0ed,
	    0xe8876a, 0xa8201f};

	return ramp(colors, sizeof colors / sizeof *colors, 0.5 * (t + 1.0));
}
