#include "core/picture_shade.h"

#include <math.h>

#include "core/output.h"
#include "core/picture_color.h"

/* Stripes that a sphere's reflection has from its middle to its rim, about. */
#define STRIPES 5.0

unsigned picture_outputs(enum picture_shading shading)
{
	static const unsigned outputs[SHADING_COUNT] = {
		[SHADING_LIT] = OUTPUT_COLOR | OUTPUT_NORMAL,
		[SHADING_NORMAL] = OUTPUT_NORMAL,
		[SHADING_ZEBRA] = OUTPUT_NORMAL,
		[SHADING_CURVATURE] = OUTPUT_NORMAL | OUTPUT_CURVATURE,
		[SHADING_FIELD] = OUTPUT_GRADIENT | OUTPUT_NORMAL,
	};

	return outputs[shading];
}

static struct vec3 take3(const float **at)
{
	const float *v = *at;

	*at += 3;
	return (struct vec3){v[0], v[1], v[2]};
}

struct picture_place picture_place(enum picture_shading shading,
    const float *row, struct vec3 ray)
{
	struct picture_place p = {.ray = ray};

	/* In the order of core/output.h. */
	if (shading == SHADING_FIELD)
		p.steepness = vec3_norm(take3(&row));
	if (shading == SHADING_LIT)
		p.color = take3(&row);
	p.normal = take3(&row);
	if (shading == SHADING_CURVATURE)
		p.mean_curvature = row[0];
	return p;
}

/* The normal on the side that is seen: from within a hollow, its inside. */
static struct vec3 seen_normal(const struct picture_place *p)
{
	return vec3_dot(p->normal, p->ray) > 0.0 ?
	    vec3_scale(-1.0, p->normal) : p->normal;
}

static struct vec3 direction(const struct picture_view *view, double right,
    double up, double back)
{
	return vec3_unit(vec3_axpy(-back, view->forward, vec3_axpy(up,
	    view->up, vec3_scale(right, view->right))));
}

/* Lambert's law, a little around the terminator, so that it is soft. */
static double diffuse(struct vec3 normal, struct vec3 light)
{
	const double wrap = 0.15;
	const double cosine = (vec3_dot(normal, light) + wrap) / (1.0 + wrap);

	return cosine > 0.0 ? cosine : 0.0;
}

/* Blinn 1977. */
static double gloss(struct vec3 normal, struct vec3 light, struct vec3 ray)
{
	const struct vec3 middle = vec3_sub(light, ray);
	const double length = vec3_norm(middle);
	const double cosine = length > 0.0 ?
	    vec3_dot(normal, middle) / length : 0.0;

	return cosine > 0.0 ? pow(cosine, 48.0) : 0.0;
}

/* A main light from the camera's upper left, a weak one from its right, and
 * light from all around, more of it from above. */
static struct vec3 lit(const struct picture_view *view,
    const struct picture_place *p)
{
	const struct vec3 key = direction(view, -0.7, 0.8, 0.65);
	const struct vec3 fill = direction(view, 0.9, 0.1, 0.5);
	const struct vec3 n = seen_normal(p);
	const double ambient = 0.13 + 0.07 * vec3_dot(n, view->up);
	const double light = ambient + 0.85 * diffuse(n, key) +
	    0.12 * diffuse(n, fill);
	const double shine = 0.22 * gloss(n, key, p->ray);

	return vec3_add(vec3_scale(light, p->color),
	    vec3(shine, shine, shine));
}

/* Half light from where the eye is: shows the form and keeps the colour. */
static struct vec3 head_lit(const struct picture_place *p, struct vec3 color)
{
	const double cosine = fabs(vec3_dot(p->normal, p->ray));

	return vec3_scale(0.5 + 0.5 * cosine, color);
}

/* As sRGB numbers, so that the file has (n + 1) / 2. */
static struct vec3 normal_color(const struct picture_place *p)
{
	return vec3(picture_decode(0.5 * (p->normal.x + 1.0)),
	    picture_decode(0.5 * (p->normal.y + 1.0)),
	    picture_decode(0.5 * (p->normal.z + 1.0)));
}

/*
 * Reflections of a room with straight lamps in even steps of the angle above
 * the camera's level: stripes are as smooth as the normals, and break where
 * those do.
 */
static struct vec3 zebra(const struct picture_view *view,
    const struct picture_place *p)
{
	const struct vec3 n = seen_normal(p);
	const struct vec3 reflected = vec3_axpy(-2.0 * vec3_dot(n, p->ray), n,
	    p->ray);
	const double level = vec3_dot(reflected, view->up);
	const double angle = asin(fmin(fmax(level, -1.0), 1.0));
	const double wave = sin(2.0 * STRIPES * angle);
	const double part = fmin(fmax(0.5 + 4.0 * wave, 0.0), 1.0);
	const double light = 0.02 + 0.88 * part;

	return head_lit(p, vec3(light, light, light));
}

void picture_look_init(struct picture_look *look)
{
	for (int i = 0; i < PICTURE_MAP; i++) {
		const double t = (double)i / (PICTURE_MAP - 1);

		if (look->shading == SHADING_CURVATURE)
			look->map[i] = picture_diverging(2.0 * t - 1.0);
		else if (look->shading == SHADING_FIELD)
			look->map[i] = picture_viridis(t);
	}
}

/* look's map at t in [0, 1]. */
static struct vec3 mapped(const struct picture_look *look, double t)
{
	return look->map[(int)(t * (PICTURE_MAP - 1) + 0.5)];
}

struct vec3 picture_shade(const struct picture_look *look,
    const struct picture_place *place)
{
	const double bend = place->mean_curvature * look->size;
	const double steep = place->steepness * look->size;

	switch (look->shading) {
	case SHADING_NORMAL:
		return normal_color(place);
	case SHADING_ZEBRA:
		return zebra(&look->view, place);
	case SHADING_CURVATURE:
		return head_lit(place, mapped(look,
		    0.5 + 0.5 * bend / (4.0 + fabs(bend))));
	case SHADING_FIELD:
		return head_lit(place, mapped(look, steep / (steep + 2.0)));
	default:
		return lit(&look->view, place);
	}
}
