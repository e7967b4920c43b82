#include "core/picture.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "core/output.h"
#include "core/picture_color.h"
#include "core/picture_shade.h"
#include "core/raycast.h"
#include "core/tape.h"

/* Pixels go in squares of this edge, so that rays next to each other go through
 * the same parts of the model. */
#define SQUARE 16

/* Rays in hand at a time, at least one square's. */
#define BATCH ((size_t)1 << 17)

/* Of a batch's time, what its rays take, about. */
#define RAYS_PART 0.85

/* Rays' tolerance: this part of a pixel at the surface's distance; but no less
 * than this part of the surface's size. */
#define PIXEL_PART 0.05
#define SIZE_PART 1e-5

/* Of a framed surface, more than it needs. */
#define MARGIN 1.06

#define DEFAULT_FOV 0.6

/* ---- cameras ---- */

/* A corner of extent, by i's bits; where there is none, or no end, a unit
 * cube's. */
static struct vec3 corner(const struct tape_box *extent, int i)
{
	double c[3];

	for (int k = 0; k < 3; k++) {
		const double least = extent->min[k], most = extent->max[k];
		const bool is_usable = isfinite(least) && isfinite(most) &&
		    least <= most;

		c[k] = i >> k & 1 ? (is_usable ? most : 1.0) :
		    (is_usable ? least : -1.0);
	}
	return vec3(c[0], c[1], c[2]);
}

static struct picture_view view_of(const struct picture_camera *camera)
{
	struct picture_view view;
	struct vec3 right;

	view.forward = vec3_unit(vec3_sub(camera->target, camera->eye));
	right = vec3_cross(view.forward, camera->up);
	if (vec3_norm(right) < 1e-9 * vec3_norm(camera->up))
		right = vec3_cross(view.forward, vec3(0.0, 1.0, 0.0));
	if (!(vec3_norm(right) > 1e-9))
		right = vec3_cross(view.forward, vec3(1.0, 0.0, 0.0));
	view.right = vec3_unit(right);
	view.up = vec3_cross(view.right, view.forward);
	return view;
}

/* How far from target a camera must be for corner c, relative to it, to be
 * within its view: |x| <= (d + z) tan. */
static double distance_for(const struct picture_view *view, struct vec3 c,
    double tan_x, double tan_y)
{
	const double z = vec3_dot(c, view->forward);

	return fmax(fabs(vec3_dot(c, view->right)) / tan_x,
	    fabs(vec3_dot(c, view->up)) / tan_y) - z;
}

struct picture_camera picture_frame(const struct tape_box *extent,
    size_t width, size_t height)
{
	const struct vec3 from = {1.0, -2.0, 0.9};
	const double tan_y = tan(0.5 * DEFAULT_FOV);
	const double tan_x = tan_y * (double)width / (double)height;
	struct picture_camera camera = {
		.target = vec3_scale(0.5, vec3_add(corner(extent, 0),
		    corner(extent, 7))),
		.up = {0.0, 0.0, 1.0},
		.fov = DEFAULT_FOV,
	};
	struct picture_view view;
	double distance = 1e-6;

	camera.eye = vec3_add(camera.target, from);
	view = view_of(&camera);
	for (int i = 0; i < 8; i++)
		distance = fmax(distance, distance_for(&view,
		    vec3_sub(corner(extent, i), camera.target), tan_x,
		    tan_y));
	distance *= MARGIN;
	camera.eye = vec3_axpy(-distance, view.forward, camera.target);
	camera.view_height = 2.0 * distance * tan_y;
	return camera;
}

/* ---- rays ---- */

/* A picture being made. */
struct job {
	const struct range_tape *tape;
	const struct picture_render *options;
	struct picture_look look;
	double tan_x, tan_y;        /* half the view, per unit of distance */
	double half_x, half_y;      /* half the view, orthographic */
	double tolerance;
	int grid;                   /* rays a pixel along an edge */
	size_t across, squares;
	/* of a batch */
	float *rays;
	uint32_t *pixels;           /* samples rays each, one after the other */
	struct ray_hit *hits;
	float *places, *rows;
	size_t count, pixel_count;
	/* of all */
	struct raycaster *caster;
	uint8_t *rgba;
};

/* A ray through (x, y) of the picture, each from -1 to 1. */
static void put_ray(const struct job *j, double x, double y, float *ray)
{
	const struct picture_camera *camera = &j->options->camera;
	struct vec3 origin = camera->eye, d = j->look.view.forward;

	if (camera->orthographic) {
		origin = vec3_axpy(x * j->half_x, j->look.view.right,
		    vec3_axpy(y * j->half_y, j->look.view.up, origin));
	} else {
		d = vec3_unit(vec3_axpy(x * j->tan_x, j->look.view.right,
		    vec3_axpy(y * j->tan_y, j->look.view.up, d)));
	}
	ray[0] = (float)origin.x;
	ray[1] = (float)origin.y;
	ray[2] = (float)origin.z;
	ray[3] = (float)d.x;
	ray[4] = (float)d.y;
	ray[5] = (float)d.z;
}

/* All rays of a pixel, on a grid within it. */
static void add_pixel(struct job *j, size_t px, size_t py)
{
	const struct picture_render *o = j->options;

	for (int i = 0; i < j->grid * j->grid; i++) {
		const double x = (double)px + (i % j->grid + 0.5) / j->grid;
		const double y = (double)py + (i / j->grid + 0.5) / j->grid;

		put_ray(j, 2.0 * x / (double)o->width - 1.0,
		    1.0 - 2.0 * y / (double)o->height,
		    j->rays + RAY_FLOATS * j->count++);
	}
	j->pixels[j->pixel_count++] = (uint32_t)(py * o->width + px);
}

static void add_square(struct job *j, size_t square)
{
	const size_t left = square % j->across * SQUARE;
	const size_t top = square / j->across * SQUARE;

	for (size_t y = top; y < top + SQUARE && y < j->options->height; y++) {
		for (size_t x = left; x < left + SQUARE &&
		    x < j->options->width; x++)
			add_pixel(j, x, y);
	}
}

/* ---- light ---- */

/* light: the sum of a pixel's rays' linear colours, and how many hit. */
static void put_pixel(const struct picture_render *o, const double *light,
    uint8_t rgba[static 4])
{
	const double part = light[3] / (double)o->samples;
	struct vec3 c = {light[0], light[1], light[2]};

	if (o->has_background) {
		c = vec3_axpy(1.0 - part, o->background,
		    vec3_scale(1.0 / o->samples, c));
		rgba[3] = 255;
	} else {
		/* Straight alpha: the colour is that of what was hit. */
		c = vec3_scale(light[3] > 0.0 ? 1.0 / light[3] : 0.0, c);
		rgba[3] = (uint8_t)(255.0 * part + 0.5);
	}
	picture_put(c, rgba);
}

/* Of ray i, which hit where row says. */
static void add_light(const struct job *j, size_t i, const float *row,
    double light[static 4])
{
	const float *d = j->rays + RAY_FLOATS * i + 3;
	const struct picture_place place = picture_place(j->options->shading,
	    row, (struct vec3){d[0], d[1], d[2]});
	const struct vec3 c = picture_shade(&j->look, &place);

	light[0] += fmin(c.x, 1.0);
	light[1] += fmin(c.y, 1.0);
	light[2] += fmin(c.z, 1.0);
	light[3] += 1.0;
}

/* With what was found at the hits, in their order, all pixels in hand. */
static void put_pixels(const struct job *j, int columns)
{
	const size_t samples = (size_t)j->options->samples;
	const float *row = j->rows;

	for (size_t p = 0; p < j->pixel_count; p++) {
		double light[4] = {0.0};

		for (size_t i = p * samples; i < (p + 1) * samples; i++) {
			if (!j->hits[i].hit)
				continue;
			add_light(j, i, row, light);
			row += columns;
		}
		put_pixel(j->options, light, j->rgba + 4 * j->pixels[p]);
	}
}

static enum err shade(struct job *j, struct sampler *sampler)
{
	const unsigned outputs = picture_outputs(j->options->shading);
	size_t n = 0;
	enum err err = ERR_OK;

	for (size_t i = 0; i < j->count; i++) {
		if (j->hits[i].hit)
			memcpy(j->places + 3 * n++, j->hits[i].position,
			    3 * sizeof *j->places);
	}
	if (n > 0)
		err = sampler->sample(sampler, j->places, n, outputs, j->rows);
	if (err == ERR_OK)
		put_pixels(j, output_row_floats(outputs));
	return err;
}

/* ---- batches ---- */

/* A sampler that tells another of a part of all there is to do. */
struct part_sampler {
	struct sampler sampler; /* the first member */
	struct sampler *inner;
	double from, length;
};

static enum err sample_part(struct sampler *s, const float *points,
    size_t count, unsigned outputs, float *rows)
{
	struct part_sampler *part = (struct part_sampler *)s;

	return part->inner->sample(part->inner, points, count, outputs, rows);
}

static bool go_on_part(struct sampler *s, const char *stage, double done)
{
	struct part_sampler *part = (struct part_sampler *)s;

	return sampler_goes_on(part->inner, stage,
	    part->from + part->length * done);
}

/* Casts the rays in hand and puts their pixels. from, length: of all. */
static enum err run_batch(struct job *j, struct sampler *sampler, double from,
    double length)
{
	struct part_sampler part = {{sample_part, go_on_part}, sampler, from,
	    RAYS_PART * length};
	enum err err = raycaster_run(j->caster, j->rays, j->count,
	    &part.sampler, j->hits);

	if (err != ERR_OK)
		return err;
	if (!sampler_goes_on(sampler, "shading", from + RAYS_PART * length))
		return ERR_CANCELLED;
	err = shade(j, sampler);
	j->count = j->pixel_count = 0;
	return err;
}

static enum err run_all(struct job *j, struct sampler *sampler, size_t room)
{
	const size_t square_rays = SQUARE * SQUARE *
	    (size_t)j->options->samples;
	enum err err = ERR_OK;
	double from = 0.0;

	for (size_t s = 0; s < j->squares && err == ERR_OK; s++) {
		const double to = (double)(s + 1) / (double)j->squares;

		add_square(j, s);
		if (s + 1 < j->squares && j->count + square_rays <= room)
			continue;
		err = run_batch(j, sampler, from, to - from);
		from = to;
	}
	return err;
}

/* ---- a picture ---- */

static double size_of(const struct tape_box *extent)
{
	const struct vec3 d = vec3_sub(corner(extent, 7), corner(extent, 0));

	return fmax(0.5 * fmax(d.x, fmax(d.y, d.z)), 1e-9);
}

static void init(struct job *j)
{
	const struct picture_render *o = j->options;
	const struct picture_camera *camera = &o->camera;
	const double aspect = (double)o->width / (double)o->height;
	const double away = vec3_norm(vec3_sub(camera->target, camera->eye));
	double pixel;

	j->look.shading = o->shading;
	j->look.view = view_of(camera);
	j->tan_y = tan(0.5 * camera->fov);
	j->tan_x = aspect * j->tan_y;
	j->half_y = 0.5 * camera->view_height;
	j->half_x = aspect * j->half_y;
	j->look.size = size_of(o->extent);
	picture_look_init(&j->look);
	pixel = 2.0 / (double)o->height *
	    (camera->orthographic ? j->half_y : away * j->tan_y);
	j->tolerance = fmin(fmax(PIXEL_PART * pixel, SIZE_PART * j->look.size),
	    0.01 * j->look.size);
	j->grid = (int)lround(sqrt(o->samples));
	j->across = (o->width + SQUARE - 1) / SQUARE;
	j->squares = j->across * ((o->height + SQUARE - 1) / SQUARE);
}

static enum err make(struct job *j, struct sampler *sampler)
{
	const struct picture_render *o = j->options;
	const size_t columns = (size_t)output_row_floats(
	    picture_outputs(o->shading));
	const size_t room = BATCH;
	enum err err = raycaster_create(j->tape, &(struct raycast_options){
		.iso = o->iso,
		.tolerance = j->tolerance,
		.max_distance = INFINITY,
		.extent = o->extent,
	}, &j->caster);

	if (err != ERR_OK)
		return err;
	j->rays = malloc(room * RAY_FLOATS * sizeof *j->rays);
	j->pixels = malloc(room * sizeof *j->pixels);
	j->hits = malloc(room * sizeof *j->hits);
	j->places = malloc(room * 3 * sizeof *j->places);
	j->rows = malloc(room * columns * sizeof *j->rows);
	if (j->rays == NULL || j->pixels == NULL || j->hits == NULL ||
	    j->places == NULL || j->rows == NULL)
		return ERR_MEMORY;
	return run_all(j, sampler, room);
}

enum err picture_render(const struct range_tape *tape,
    const struct picture_render *options, struct sampler *sampler,
    uint8_t *rgba)
{
	struct job j = {.tape = tape, .options = options, .rgba = rgba};
	enum err err;

	init(&j);
	err = make(&j, sampler);
	raycaster_free(j.caster);
	free(j.rows);
	free(j.places);
	free(j.hits);
	free(j.pixels);
	free(j.rays);
	return err;
}
