#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "core/picture.h"
#include "core/picture_color.h"

/* Colours of the field come from so many steps each side of iso. */
#define STEPS 256

/* Widths of lines, pixels; how dark they are. */
#define LINE_WIDTH 1.1
#define ISO_WIDTH 2.6
#define LINE_PART 0.45
#define ISO_PART 0.95

/* Lines nearer to each other than this, pixels, fade. */
#define CROWDED 3.0

void picture_slice_points(const struct picture_slice *options, float *points)
{
	const double middle_x = 0.5 * (double)options->width;
	const double middle_y = 0.5 * (double)options->height;

	for (size_t j = 0; j < options->height; j++) {
		const double y = (middle_y - ((double)j + 0.5)) *
		    options->pixel;
		const struct vec3 row = vec3_axpy(y, options->up,
		    options->center);

		for (size_t i = 0; i < options->width; i++, points += 3) {
			const double x = ((double)i + 0.5 - middle_x) *
			    options->pixel;
			const struct vec3 p = vec3_axpy(x, options->right,
			    row);

			points[0] = (float)p.x;
			points[1] = (float)p.y;
			points[2] = (float)p.z;
		}
	}
}

/* Colours outwards from nothing to iso and inwards from there on, as they are
 * and as they are written: most pixels have no line. */
struct palette {
	struct vec3 field[2 * STEPS];
	uint8_t rgb[2 * STEPS][3];
	struct vec3 line, iso_line;
};

/* Pale and cold outside, warm inside; both get stronger inwards. */
static void make_palette(struct palette *p)
{
	const struct vec3 nothing = picture_hex(0xf8fafc);
	const struct vec3 outside = picture_hex(0x8fbcdf);
	const struct vec3 skin = picture_hex(0xfde2b3);
	const struct vec3 flesh = picture_hex(0xee8a4a);
	const struct vec3 core = picture_hex(0xa12a2e);

	for (int i = 0; i < STEPS; i++) {
		const double t = (double)i / (STEPS - 1);

		p->field[i] = picture_mix(nothing, outside, t);
		p->field[STEPS + i] = t < 0.5 ?
		    picture_mix(skin, flesh, 2.0 * t) :
		    picture_mix(flesh, core, 2.0 * t - 1.0);
	}
	for (int i = 0; i < 2 * STEPS; i++)
		picture_put(p->field[i], p->rgb[i]);
	p->line = picture_hex(0x1c2b3a);
	p->iso_line = picture_hex(0x0b0f14);
}

/* Which of the palette's colours the field has. */
static int field_color(double value, double iso)
{
	const double t = value < iso ? value / iso :
	    tanh(value / iso - 1.0);
	const int i = (int)(fmin(fmax(t, 0.0), 1.0) * (STEPS - 1) + 0.5);

	return value < iso ? i : STEPS + i;
}

static int ascending(const void *a, const void *b)
{
	const double x = *(const double *)a, y = *(const double *)b;

	return (x > y) - (x < y);
}

/* How much of a pixel a line of so many pixels' width covers whose middle is so
 * many away. */
static double covered(double away, double width)
{
	return fmin(fmax(0.5 * width + 0.5 - away, 0.0), 1.0);
}

/* Of the lines at levels (ascending): how much they darken a pixel where f is
 * value and changes by slope within a pixel. */
static double lines(const double *levels, size_t count, double value,
    double slope)
{
	size_t low = 0, high = count;
	double away = INFINITY, gap = INFINITY;

	while (low < high) {
		const size_t middle = (low + high) / 2;

		if (levels[middle] < value)
			low = middle + 1;
		else
			high = middle;
	}
	if (low < count)
		away = levels[low] - value;
	if (low > 0)
		away = fmin(away, value - levels[low - 1]);
	if (low > 0 && low < count)
		gap = (levels[low] - levels[low - 1]) / slope;
	return covered(away / slope, LINE_WIDTH) * LINE_PART *
	    fmin(gap / CROWDED, 1.0);
}

static struct vec3 blend(struct vec3 a, struct vec3 b, double part)
{
	return vec3_axpy(part, vec3_sub(b, a), a);
}

static void paint_pixel(const struct picture_slice *o,
    const struct palette *p, const double *levels, const float row[static 4],
    uint8_t rgba[static 4])
{
	const struct vec3 g = {row[1], row[2], row[3]};
	const double slope = o->pixel * hypot(vec3_dot(g, o->right),
	    vec3_dot(g, o->up));
	const int i = field_color(row[0], o->iso);
	double thin = 0.0, thick = 0.0;

	rgba[3] = 255;
	if (slope > 0.0) {
		thin = lines(levels, o->level_count, row[0], slope);
		thick = ISO_PART * covered(fabs(row[0] - o->iso) / slope,
		    ISO_WIDTH);
	}
	if (thin > 0.0 || thick > 0.0)
		picture_put(blend(blend(p->field[i], p->line, thin),
		    p->iso_line, thick), rgba);
	else
		memcpy(rgba, p->rgb[i], sizeof p->rgb[i]);
}

void picture_slice_paint(const struct picture_slice *options,
    const float *rows, uint8_t *rgba)
{
	const size_t pixels = options->width * options->height;
	double levels[PICTURE_LEVELS_MAX];
	struct palette palette;

	make_palette(&palette);
	memcpy(levels, options->levels, options->level_count * sizeof *levels);
	qsort(levels, options->level_count, sizeof *levels, ascending);
	for (size_t i = 0; i < pixels; i++)
		paint_pixel(options, &palette, levels, rows + 4 * i,
		    rgba + 4 * i);
}
