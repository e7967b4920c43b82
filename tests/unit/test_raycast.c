/*
 * Rays against surfaces that are known, or densely sampled along the ray, with
 * the float64 evaluator for a sampler.
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
#include <time.h>

#include "core/evaluate.h"
#include "core/output.h"
#include "core/range.h"
#include "core/raycast.h"
#include "core/tape.h"
#include "core/tree.h"
#include "tests/support/fail_alloc.h"
#include "tests/support/near.h"
#include "tests/support/random_tree.h"
#include "tests/support/sanitized.h"

#define MAX_NODES 100000
#define TIMES(n) (SANITIZED ? (n) / 8 : (n))
#define PI 3.14159265358979323846

/* ---- a model, and rays at it ---- */

struct exact {
	struct sampler sampler;
	const struct tape *tape;
	size_t samples, batches;
	double seconds;
	size_t patience; /* batches until it gives up; 0: never */
};

static double seconds(void)
{
	struct timespec t;

	clock_gettime(CLOCK_PROCESS_CPUTIME_ID, &t);
	return (double)t.tv_sec + 1e-9 * (double)t.tv_nsec;
}

static enum err sample(struct sampler *s, const float *points, size_t count,
    unsigned outputs, float *rows)
{
	struct exact *e = (struct exact *)s;

	assert_int_equal(outputs, OUTPUT_VALUE);
	e->seconds -= seconds();
	for (size_t i = 0; i < count; i++) {
		const float *p = points + 3 * i;
		struct jet f;

		assert_true(isfinite(p[0]) && isfinite(p[1]) && isfinite(p[2]));
		evaluate(e->tape, vec3(p[0], p[1], p[2]), 0, &f);
		rows[i] = (float)f.value;
	}
	e->seconds += seconds();
	e->samples += count;
	e->batches++;
	return e->patience > 0 && e->batches >= e->patience ? ERR_CANCELLED :
	    ERR_OK;
}

struct model {
	struct tape *tape;
	struct range_tape *ranges;
	struct tape_box extent;
	struct raycast_options options;
	struct exact exact;
};

static void model_init(struct model *m, const struct node *root)
{
	const struct tree tree = {root, TREE_NULL_GRADIENT};
	const struct tape_box domain = {{-50.0f, -50.0f, -50.0f},
	    {50.0f, 50.0f, 50.0f}};
	struct tape_error error;
	double size = 0.0;

	memset(m, 0, sizeof *m);
	assert_int_equal(tape_compile(&tree, MAX_NODES, &m->tape, &error),
	    ERR_OK);
	assert_int_equal(range_tape_create(m->tape, &m->ranges), ERR_OK);
	assert_int_equal(range_extent(m->ranges, 0.5, &domain, 0.02,
	    NULL, &m->extent), ERR_OK);
	for (int i = 0; i < 3; i++)
		size = fmax(size, (double)m->extent.max[i] - m->extent.min[i]);
	m->options = (struct raycast_options){.iso = 0.5,
	    .tolerance = 1e-5 * fmax(size, 1e-3), .max_distance = INFINITY,
	    .extent = &m->extent};
	m->exact = (struct exact){.sampler = {.sample = sample},
	    .tape = m->tape};
}

static void model_fini(struct model *m)
{
	range_tape_free(m->ranges);
	tape_free(m->tape);
}

static struct ray_hit *cast(struct model *m, const float *rays, size_t count)
{
	struct ray_hit *hits = malloc((count + 1) * sizeof *hits);

	assert_int_equal(raycast(m->ranges, &m->options, rays, count,
	    &m->exact.sampler, hits), ERR_OK);
	return hits;
}

static double value_at(const struct model *m, struct vec3 p)
{
	struct jet f;

	evaluate(m->tape, p, 0, &f);
	return f.value;
}

static struct vec3 random_vec3(struct random_stream *r, double reach)
{
	double x = random_in(r, -reach, reach), y = random_in(r, -reach, reach);

	return vec3(x, y, random_in(r, -reach, reach));
}

static struct vec3 random_unit(struct random_stream *r)
{
	for (;;) {
		struct vec3 v = random_vec3(r, 1.0);
		double n = vec3_norm(v);

		if (n > 0.1 && n <= 1.0)
			return vec3_scale(1.0 / n, v);
	}
}

static void put_ray(float *ray, struct vec3 o, struct vec3 d)
{
	const double all[6] = {o.x, o.y, o.z, d.x, d.y, d.z};

	for (int i = 0; i < 6; i++)
		ray[i] = (float)all[i];
}

static struct vec3 origin_of(const float *ray)
{
	return vec3(ray[0], ray[1], ray[2]);
}

static struct vec3 direction_of(const float *ray)
{
	return vec3_unit(vec3(ray[3], ray[4], ray[5]));
}

static struct node primitive_node(struct primitive p)
{
	return (struct node){.type = NODE_PRIMITIVE, .primitive = p};
}

static struct node ball(double x, double radius)
{
	return primitive_node((struct primitive){.type = PRIMITIVE_SPHERE,
	    .a = {x, 0.0, 0.0}, .radius = {radius}, .falloff = 0.3 * radius});
}

/* The camera's: width x height rays from (1, -2, 0.9) times distance. */
static float *picture_rays(const struct tape_box *box, int width, int height)
{
	float *rays = malloc((size_t)width * (size_t)height * RAY_FLOATS *
	    sizeof *rays);
	struct vec3 low = {box->min[0], box->min[1], box->min[2]};
	struct vec3 high = {box->max[0], box->max[1], box->max[2]};
	struct vec3 c = vec3_scale(0.5, vec3_add(low, high));
	double size = vec3_norm(vec3_sub(high, low));
	struct vec3 back = vec3_unit(vec3(1.0, -2.0, 0.9));
	struct vec3 eye = vec3_axpy(1.7 * size, back, c);
	struct vec3 right = vec3_unit(vec3_cross(vec3(0.0, 0.0, 1.0), back));
	struct vec3 up = vec3_cross(back, right);

	for (int j = 0; j < height; j++)
		for (int i = 0; i < width; i++) {
			double x = ((i + 0.5) / width - 0.5) * 0.62 *
			    width / height;
			double y = (0.5 - (j + 0.5) / height) * 0.62;
			struct vec3 d = vec3_axpy(x, right, vec3_axpy(y, up,
			    vec3_scale(-1.0, back)));

			put_ray(rays + (j * width + i) * RAY_FLOATS, eye, d);
		}
	return rays;
}

/* ---- known surfaces ---- */

static void test_rays_meet_a_sphere_where_it_is(void **state)
{
	enum { COUNT = 4000 };
	struct node node = ball(0.2, 0.7);
	struct random_stream r = {1};
	float rays[COUNT * RAY_FLOATS];
	double worst = 0.0;
	struct ray_hit *hits;
	struct model m;
	int met = 0;

	(void)state;
	model_init(&m, &node);
	for (int i = 0; i < COUNT; i++)
		put_ray(rays + i * RAY_FLOATS, random_vec3(&r, 2.0),
		    vec3_scale(exp2(random_in(&r, -60.0, 60.0)),
		    random_unit(&r)));
	hits = cast(&m, rays, COUNT);
	for (int i = 0; i < COUNT; i++) {
		struct vec3 o = origin_of(rays + i * RAY_FLOATS);
		struct vec3 d = direction_of(rays + i * RAY_FLOATS);
		struct vec3 e = vec3_sub(o, vec3(0.2, 0.0, 0.0));
		double b = vec3_dot(e, d), c = vec3_dot(e, e) - 0.49;
		double root = b * b - c, t;

		t = root < 0.0 ? -1.0 : c > 0.0 ? -b - sqrt(root) :
		    -b + sqrt(root);
		if (fabs(root) < 1e-9)
			continue; /* grazes */
		assert_int_equal(hits[i].hit, root > 0.0 && t > 0.0);
		if (!hits[i].hit)
			continue;
		met++;
		worst = fmax(worst, fabs(hits[i].distance - t) *
		    fmin(1.0, sqrt(root)));
	}
	printf("measured: %d of %d rays meet it; off by %.1e at most; %.1f "
	    "samples a ray\n", met, COUNT, worst,
	    (double)m.exact.samples / COUNT);
	assert_true(worst < 1e-5);
	free(hits);
	model_fini(&m);
}

/* A torus' signed distance, its axis z. */
static double torus_distance(struct vec3 p, double major, double minor)
{
	double off = hypot(p.x, p.y) - major;

	return hypot(off, p.z) - minor;
}

/* By steps no longer than the distance there can be no crossing. */
static double torus_first(struct vec3 o, struct vec3 d, double end)
{
	double t = 0.0, f = torus_distance(o, 1.0, 0.3);
	bool inside = f < 0.0;

	while (t < end) {
		double next = t + fmax(fabs(f), 1e-7);

		f = torus_distance(vec3_axpy(next, d, o), 1.0, 0.3);
		if ((f < 0.0) != inside)
			return 0.5 * (t + next);
		t = next;
	}
	return -1.0;
}

static void test_rays_meet_a_torus_where_it_is(void **state)
{
	enum { COUNT = 3000 };
	struct node node = primitive_node((struct primitive){
	    .type = PRIMITIVE_TORUS, .normal = {0.0, 0.0, 1.0}, .major = 1.0,
	    .minor = 0.3, .falloff = 0.2});
	struct random_stream r = {7};
	float rays[COUNT * RAY_FLOATS];
	struct ray_hit *hits;
	double worst = 0.0;
	struct model m;
	int met = 0, apart = 0;

	(void)state;
	model_init(&m, &node);
	for (int i = 0; i < COUNT; i++) {
		struct vec3 o = random_vec3(&r, 2.0);

		put_ray(rays + i * RAY_FLOATS, o, vec3_sub(random_vec3(&r,
		    1.0), o));
	}
	hits = cast(&m, rays, COUNT);
	for (int i = 0; i < COUNT; i++) {
		struct vec3 o = origin_of(rays + i * RAY_FLOATS);
		struct vec3 d = direction_of(rays + i * RAY_FLOATS);
		double t = torus_first(o, d, 6.0);

		if (hits[i].hit)
			worst = fmax(worst, fabs(torus_distance(
			    vec3(hits[i].position[0], hits[i].position[1],
			    hits[i].position[2]), 1.0, 0.3)));
		apart += hits[i].hit != (t >= 0.0) ||
		    (t >= 0.0 && fabs(t - hits[i].distance) > 1e-3);
		met += hits[i].hit;
	}
	printf("measured: %d of %d rays meet it; off the surface by %.1e at "
	    "most; %d elsewhere\n", met, COUNT, worst, apart);
	/* float32's coordinates are as coarse as that */
	assert_true(worst < 1e-6);
	assert_true(apart <= 1); /* which graze */
	free(hits);
	model_fini(&m);
}

/* ---- what is thin ---- */

#define THIN 1e-4

static void test_no_ray_tunnels_through_a_thin_shell(void **state)
{
	enum { COUNT = 20000 };
	struct node outer = ball(0.0, 0.5), inner = ball(0.0, 0.5 - THIN);
	struct node *children[] = {&outer, &inner};
	struct operator clean = {.family = FAMILY_INTERSECTION,
	    .profile = profile_smooth(), .opening = opening_constant(PI / 4)};
	struct random_stream r = {3};
	float *rays = malloc(COUNT * RAY_FLOATS * sizeof *rays);

	(void)state;
	for (int smooth = 0; smooth < 2; smooth++) {
		struct node node = {.type = NODE_DIFFERENCE,
		    .sharp = !smooth, .op = smooth ? &clean : NULL,
		    .children = children, .child_count = 2};
		struct ray_hit *hits;
		int through = 0, inside = 0;
		double worst = 0.0;
		struct model m;

		model_init(&m, &node);
		for (int i = 0; i < COUNT; i++) {
			struct vec3 target = vec3_scale(0.5 *
			    random_in(&r, 0.0, 0.9999), random_unit(&r));
			struct vec3 o = i % 4 == 0 ? vec3_scale(0.4,
			    random_unit(&r)) : vec3_scale(random_in(&r, 0.6,
			    3.0), random_unit(&r));

			inside += i % 4 == 0;
			put_ray(rays + i * RAY_FLOATS, o,
			    i % 4 == 0 ? random_unit(&r) :
			    vec3_sub(target, o));
		}
		hits = cast(&m, rays, COUNT);
		for (int i = 0; i < COUNT; i++) {
			double radius = i % 4 == 0 ? 0.5 - THIN : 0.5;
			const float *p = hits[i].position;

			if (!hits[i].hit) {
				through++;
				continue;
			}
			worst = fmax(worst, fabs(vec3_norm(vec3(p[0], p[1],
			    p[2])) - radius));
		}
		printf("measured: %d rays at a shell as thick as %.0e of its "
		    "size (%s), %d from within: %d tunnel, off by %.1e at most; "
		    "%.1f samples a ray\n", COUNT, THIN, smooth ? "clean" :
		    "sharp", inside, through, worst,
		    (double)m.exact.samples / COUNT);
		assert_int_equal(through, 0);
		assert_true(worst < 1e-5);
		free(hits);
		model_fini(&m);
	}
	free(rays);
}

static struct node plate(double z, double thickness)
{
	return primitive_node((struct primitive){.type = PRIMITIVE_BOX,
	    .a = {0.0, 0.0, z}, .half_size = {0.5, 0.5, 0.5 * thickness},
	    .falloff = 0.1});
}

/* Two plates of thickness 0.2 with a gap of THIN at z = 0, seen from above, from
 * within the upper one, and from the gap. */
static void test_gaps_and_plates_are_found(void **state)
{
	enum { COUNT = 6000 };
	struct node plates[3] = {plate(0.1 + 0.5 * THIN, 0.2),
	    plate(-0.1 - 0.5 * THIN, 0.2), plate(0.7, THIN)};
	struct node *children[] = {plates, plates + 1, plates + 2};
	struct node node = {.type = NODE_UNION, .sharp = true,
	    .children = children, .child_count = 3};
	static float rays[COUNT * RAY_FLOATS];
	struct random_stream r = {5};
	double expected[3] = {0.7 + 0.5 * THIN, 0.5 * THIN, -0.5 * THIN};
	const double from[3] = {1.0, 0.1, 0.0};
	struct ray_hit *hits;
	double worst = 0.0;
	struct model m;

	(void)state;
	model_init(&m, &node);
	for (int i = 0; i < COUNT; i++) {
		struct vec3 o = {random_in(&r, -0.4, 0.4),
		    random_in(&r, -0.4, 0.4), from[i % 3]};
		struct vec3 d = {random_in(&r, -0.1, 0.1),
		    random_in(&r, -0.1, 0.1), -1.0};

		if (i % 2 == 0)
			d.x = d.y = 0.0;
		put_ray(rays + i * RAY_FLOATS, o, d);
	}
	hits = cast(&m, rays, COUNT);
	for (int i = 0; i < COUNT; i++) {
		assert_true(hits[i].hit);
		worst = fmax(worst, fabs(hits[i].position[2] -
		    expected[i % 3]));
	}
	printf("measured: off by %.1e at most\n", worst);
	assert_true(worst < 1e-6);
	free(hits);
	model_fini(&m);
}

/* ---- odd rays ---- */

static void test_rays_along_faces_edges_and_through_corners(void **state)
{
	struct node node = primitive_node((struct primitive){
	    .type = PRIMITIVE_BOX, .half_size = {0.5, 0.5, 0.5},
	    .falloff = 0.25});
	const float rays[][RAY_FLOATS] = {
		{-2.0f, 0.0f, 0.0f, 1.0f, 0.0f, 0.0f},
		{2.0f, 0.1f, 0.2f, -1e-30f, 0.0f, 0.0f},
		{0.1f, 0.1f, -2.0f, 0.0f, 0.0f, 1e30f},
		{-1.0f, -1.0f, -1.0f, 1.0f, 1.0f, 1.0f},
		{0.0f, 0.0f, 0.0f, 0.0f, -3.0f, 0.0f},
		{-2.0f, 0.0f, 0.6f, 1.0f, 0.0f, 0.0f},
		{-2.0f, 0.0f, 0.0f, -1.0f, 0.0f, 0.0f},
		{-2.0f, 0.5f, 0.0f, 1.0f, 0.0f, 0.0f},
		{-2.0f, 0.5f, 0.5f, 1.0f, 0.0f, 0.0f},
		{0.0f, 0.0f, 0.5f, 1.0f, 0.0f, 0.0f},
		{0.0f, 0.0f, 0.5f, 0.0f, 0.0f, -1.0f},
	};
	const double expected[] = {1.5, 1.5, 1.5, sqrt(0.75), 0.5, -1.0, -1.0};
	const size_t count = sizeof rays / sizeof rays[0];
	struct ray_hit *hits;
	struct model m;

	(void)state;
	model_init(&m, &node);
	hits = cast(&m, rays[0], count);
	for (size_t i = 0; i < 7; i++) {
		assert_int_equal(hits[i].hit, expected[i] > 0.0);
		assert_near(hits[i].distance, fmax(expected[i], 0.0), 1e-6);
	}
	/* On the surface itself either answer is right, but is one. */
	for (size_t i = 7; i < count; i++)
		assert_true(isfinite(hits[i].distance));
	free(hits);
	m.options.max_distance = 1.4;
	hits = cast(&m, rays[0], count);
	assert_false(hits[0].hit);
	assert_true(hits[4].hit);
	free(hits);
	model_fini(&m);
}

static void test_planes_are_met_however_far(void **state)
{
	struct node node = primitive_node((struct primitive){
	    .type = PRIMITIVE_PLANE, .a = {0.0, 0.0, 1.0},
	    .normal = {0.0, 0.0, 1.0}, .falloff = 0.5});
	const struct tape_box everything = {
	    {-INFINITY, -INFINITY, -INFINITY}, {INFINITY, INFINITY, INFINITY}};
	const float rays[][RAY_FLOATS] = {
		{0.0f, 0.0f, 5.0f, 0.0f, 0.0f, -1.0f},
		{0.0f, 0.0f, 5.0f, 1.0f, 0.0f, -0.01f},
		{0.0f, 0.0f, 5.0f, 1.0f, 0.0f, 0.01f},
		{0.0f, 0.0f, -5.0f, 0.0f, 1.0f, 1.0f},
	};
	const double expected[] = {4.0, 400.0 * sqrt(1.0001), -1.0,
	    6.0 * sqrt(2.0)};
	struct ray_hit *hits;
	struct model m;

	(void)state;
	model_init(&m, &node);
	m.options.extent = &everything;
	m.options.tolerance = 1e-4;
	hits = cast(&m, rays[0], 4);
	for (int i = 0; i < 4; i++) {
		assert_int_equal(hits[i].hit, expected[i] > 0.0);
		assert_near(hits[i].distance, fmax(expected[i], 0.0),
		    1e-5 * fabs(expected[i]));
	}
	free(hits);
	model_fini(&m);
}

/* What is looked at is each ray's own: not more, nor coarser, for one far away
 * beside it. */
static void test_answers_do_not_depend_on_other_rays(void **state)
{
	struct node nodes[2] = {primitive_node((struct primitive){
	    .type = PRIMITIVE_PLANE, .a = {0.0, 0.0, 1.0},
	    .normal = {0.0, 0.0, 1.0}, .falloff = 0.5}), ball(0.3, 1.2)};
	struct node *children[] = {nodes, nodes + 1};
	struct node node = {.type = NODE_UNION, .sharp = true,
	    .children = children, .child_count = 2};
	const struct tape_box everything = {
	    {-INFINITY, -INFINITY, -INFINITY}, {INFINITY, INFINITY, INFINITY}};
	const float rays[][RAY_FLOATS] = {
		{0.0f, 0.0f, 5.0f, 0.1f, 0.0f, -1.0f},
		/* met at 4e4, beyond the reach of 5e3; then within it */
		{0.0f, 0.0f, 5.0f, 1.0f, 0.0f, -1e-4f},
		{100.0f, 0.0f, 5.0f, 1.0f, 0.0f, -1e-4f},
		{1e6f, 0.0f, 5.0f, 1.0f, 0.0f, -1e-4f},
	};
	const bool expected[] = {true, false, true, true};
	struct ray_hit *all, *one;
	struct model m;

	(void)state;
	model_init(&m, &node);
	m.options.extent = &everything;
	m.options.tolerance = 1e-4;
	all = cast(&m, rays[0], 4);
	for (int i = 0; i < 4; i++) {
		one = cast(&m, rays[i], 1);
		assert_int_equal(one->hit, expected[i]);
		assert_memory_equal(one->position, all[i].position,
		    sizeof one->position);
		free(one);
	}
	free(all);
	model_fini(&m);
}

/* One raycaster, one batch after another of any size: the same bits. */
static void test_batches_do_not_change_answers(void **state)
{
	enum { WIDTH = 40, HEIGHT = 30, COUNT = WIDTH * HEIGHT };
	int met = 0;

	(void)state;
	for (uint64_t seed = 1; seed <= TIMES(16); seed++) {
		struct random_tree *t = random_tree_create(
		    &(struct random_tree_options){.seed = seed,
		    .whole = seed % 2, .max_primitives = 8});
		struct ray_hit *all, hits[COUNT];
		struct raycaster *caster;
		struct model m;
		float *rays;

		model_init(&m, random_tree_get(t)->root);
		rays = picture_rays(&m.extent, WIDTH, HEIGHT);
		all = cast(&m, rays, COUNT);
		assert_int_equal(raycaster_create(m.ranges, &m.options,
		    &caster), ERR_OK);
		for (size_t i = 0, n = 1; i < COUNT; i += n, n = 2 * n + 1) {
			n = n < COUNT - i ? n : COUNT - i;
			assert_int_equal(raycaster_run(caster,
			    rays + i * RAY_FLOATS, n, &m.exact.sampler,
			    hits + i), ERR_OK);
		}
		for (int i = 0; i < COUNT; i++) {
			assert_int_equal(hits[i].hit, all[i].hit);
			assert_memory_equal(hits[i].position, all[i].position,
			    sizeof hits[i].position);
			met += all[i].hit;
		}
		raycaster_free(caster);
		free(rays);
		free(all);
		model_fini(&m);
		random_tree_free(t);
	}
	printf("measured: %d hits, the same in both\n", met);
	assert_true(met > TIMES(1000));
}

/* No finer than float32, and no endless walk. */
static void test_tiny_tolerances_end(void **state)
{
	enum { COUNT = 50 };
	struct node outer = ball(0.0, 0.5), inner = ball(0.0, 0.4999999);
	struct node *children[] = {&outer, &inner};
	struct node node = {.type = NODE_DIFFERENCE, .sharp = true,
	    .children = children, .child_count = 2};
	float rays[COUNT * RAY_FLOATS];
	struct random_stream r = {9};
	struct ray_hit *hits;
	struct model m;

	(void)state;
	model_init(&m, &node);
	m.options.tolerance = 1e-30;
	for (int i = 0; i < COUNT; i++)
		put_ray(rays + i * RAY_FLOATS, vec3(m.extent.min[0], 0.0, 0.0),
		    i == 0 ? vec3(1.0, 0.0, 0.0) : random_unit(&r));
	hits = cast(&m, rays, COUNT);
	printf("measured: %.1f samples a ray\n",
	    (double)m.exact.samples / COUNT);
	free(hits);
	model_fini(&m);
}

static void test_an_empty_extent_has_no_hits(void **state)
{
	struct node node = ball(0.0, 1.0);
	const float ray[RAY_FLOATS] = {-3.0f, 0.0f, 0.0f, 1.0f, 0.0f, 0.0f};
	struct ray_hit *hits;
	struct model m;

	(void)state;
	model_init(&m, &node);
	m.extent = (struct tape_box){{1.0f, 1.0f, 1.0f}, {-1.0f, -1.0f, -1.0f}};
	hits = cast(&m, ray, 1);
	assert_false(hits[0].hit);
	assert_int_equal(m.exact.samples, 0);
	free(hits);
	hits = cast(&m, ray, 0);
	free(hits);
	model_fini(&m);
}

static bool give_up(struct sampler *s, const char *stage, double done)
{
	(void)s;
	assert_string_equal(stage, "rays");
	assert_true(done >= 0.0 && done <= 1.0);
	return false;
}

static void test_errors_of_samplers_end_it(void **state)
{
	struct node node = ball(0.0, 1.0);
	const float ray[RAY_FLOATS] = {-3.0f, 0.0f, 0.0f, 1.0f, 0.0f, 0.0f};
	struct ray_hit hit;
	struct model m;

	(void)state;
	model_init(&m, &node);
	m.exact.patience = 2;
	assert_int_equal(raycast(m.ranges, &m.options, ray, 1,
	    &m.exact.sampler, &hit), ERR_CANCELLED);
	m.exact.patience = 0;
	m.exact.sampler.go_on = give_up;
	assert_int_equal(raycast(m.ranges, &m.options, ray, 1,
	    &m.exact.sampler, &hit), ERR_CANCELLED);
	model_fini(&m);
}

static void test_every_failed_allocation_is_told(void **state)
{
	struct node nodes[2] = {ball(0.0, 1.0), ball(0.5, 1.0)};
	struct node *children[] = {nodes, nodes + 1};
	struct node node = {.type = NODE_UNION, .sharp = true,
	    .children = children, .child_count = 2};
	const float ray[RAY_FLOATS] = {-3.0f, 0.0f, 0.0f, 1.0f, 0.0f, 0.0f};
	struct ray_hit hit;
	struct model m;
	int failed = 0;

	(void)state;
	if (!fail_alloc_available())
		skip();
	model_init(&m, &node);
	for (long n = 1;; n++) {
		enum err err;

		fail_alloc_set(n);
		err = raycast(m.ranges, &m.options, ray, 1, &m.exact.sampler,
		    &hit);
		assert_int_equal(fail_alloc_live(), 0);
		if (!fail_alloc_happened())
			break;
		assert_int_equal(err, ERR_MEMORY);
		failed++;
	}
	fail_alloc_set(0);
	assert_true(failed > 4);
	model_fini(&m);
}

/* ---- first crossings of random trees ---- */

/* The first sign change among dense samples, or -1. */
static double dense_first(const struct model *m, const float *ray, double end,
    double step)
{
	struct vec3 o = origin_of(ray), d = direction_of(ray);
	bool inside = value_at(m, o) > 0.5;

	for (double t = step; t < end; t += step)
		if ((value_at(m, vec3_axpy(t, d, o)) > 0.5) != inside)
			return t;
	return -1.0;
}

static void test_first_crossings_are_those_of_dense_samples(void **state)
{
	enum { COUNT = 24 };
	int checked = 0, met = 0, wrong = 0;
	size_t samples = 0;

	(void)state;
	for (uint64_t seed = 1; seed <= TIMES(60); seed++) {
		const struct random_tree_options options = {.seed = seed,
		    .whole = seed % 2, .max_primitives = 3 + (int)(seed % 12)};
		struct random_tree *t = random_tree_create(&options);
		struct random_stream r = {seed};
		float points[3 * COUNT], rays[COUNT * RAY_FLOATS];
		struct ray_hit *hits;
		struct model m;

		model_init(&m, random_tree_get(t)->root);
		random_tree_points(t, m.tape, seed, COUNT, points);
		for (int i = 0; i < COUNT; i++) {
			struct vec3 d = random_unit(&r);
			struct vec3 p = {points[3 * i], points[3 * i + 1],
			    points[3 * i + 2]};

			put_ray(rays + i * RAY_FLOATS, vec3_axpy(-2.0, d, p),
			    d);
		}
		hits = cast(&m, rays, COUNT);
		for (int i = 0; i < COUNT; i++) {
			const double step = 2.5e-3;
			double t1 = dense_first(&m, rays + i * RAY_FLOATS, 5.0,
			    step);

			checked++;
			if (hits[i].hit && hits[i].distance < 5.0)
				met++;
			if (t1 >= 0.0 && (!hits[i].hit ||
			    hits[i].distance > t1 + 1e-3)) {
				wrong++;
				printf("seed %d ray %d: %g, but samples %g\n",
				    (int)seed, i, hits[i].hit ?
				    (double)hits[i].distance : -1.0, t1);
			}
		}
		samples += m.exact.samples;
		free(hits);
		model_fini(&m);
		random_tree_free(t);
	}
	printf("measured: %d rays, %d meet something, %d later than dense "
	    "samples; %.1f samples a ray\n", checked, met, wrong,
	    (double)samples / checked);
	assert_int_equal(wrong, 0);
}

/* ---- time ---- */

static struct node soft_segment(struct vec3 a, struct vec3 b, double radius)
{
	return primitive_node((struct primitive){.type = PRIMITIVE_SEGMENT,
	    .a = a, .b = b, .radius = {radius, radius}, .exponent = 3.0,
	    .weight = 1.0});
}

/* A picture of root: time, and how much of it the samples are. */
static void time_picture(const struct node *root, const char *name, int width)
{
	const int height = width * 3 / 4;
	const size_t count = (size_t)(width * height);
	struct ray_hit *hits;
	double all, rays_time;
	struct model m;
	float *rays;
	size_t met = 0;

	model_init(&m, root);
	rays = picture_rays(&m.extent, width, height);
	all = seconds();
	hits = cast(&m, rays, count);
	all = seconds() - all;
	for (size_t i = 0; i < count; i++)
		met += hits[i].hit;
	rays_time = all - m.exact.seconds;
	printf("measured: %s, %zu rays of a picture, %zu of which meet it: "
	    "%.2f s (%.2f us a ray), and %.2f s for %zu samples in %zu "
	    "batches\n", name, count, met, rays_time,
	    1e6 * rays_time / (double)count, m.exact.seconds, m.exact.samples,
	    m.exact.batches);
	assert_true(met > count / 50);
	free(rays);
	free(hits);
	model_fini(&m);
}

static void test_time_of_the_letter_A(void **state)
{
	struct operator camel = {.family = FAMILY_UNION,
	    .profile = profile_smooth()};
	struct node legs[3] = {
		soft_segment(vec3(-1.0, 0.0, 0.0), vec3(0.0, 0.0, 2.0), 0.25),
		soft_segment(vec3(1.0, 0.0, 0.0), vec3(0.0, 0.0, 2.0), 0.25),
		soft_segment(vec3(-0.6, 0.0, 0.8), vec3(0.6, 0.0, 0.8), 0.2)};
	struct node *children[] = {legs, legs + 1, legs + 2};
	struct node root = {.type = NODE_UNION, .op = &camel,
	    .children = children, .child_count = 3};

	(void)state;
	opening_named("camel", &camel.opening);
	time_picture(&root, "the letter A", SANITIZED ? 80 : 320);
}

static void test_time_of_a_thousand_points(void **state)
{
	enum { COUNT = 1000 };
	struct operator camel = {.family = FAMILY_UNION,
	    .profile = profile_smooth()};
	static struct node points[COUNT], *children[COUNT];
	struct random_stream r = {COUNT};
	struct node root = {.type = NODE_UNION, .op = &camel,
	    .children = children, .child_count = COUNT};

	(void)state;
	if (SANITIZED)
		skip();
	opening_named("camel", &camel.opening);
	for (int i = 0; i < COUNT; i++) {
		points[i] = primitive_node((struct primitive){
		    .type = PRIMITIVE_POINT, .a = random_vec3(&r, 1.0),
		    .radius = {0.08}, .exponent = 3.0, .weight = 1.0});
		children[i] = points + i;
	}
	time_picture(&root, "a camel union of 1,000 points", 80);
}

int main(void)
{
	const struct CMUnitTest tests[] = {
		cmocka_unit_test(test_rays_meet_a_sphere_where_it_is),
		cmocka_unit_test(test_rays_meet_a_torus_where_it_is),
		cmocka_unit_test(test_no_ray_tunnels_through_a_thin_shell),
		cmocka_unit_test(test_gaps_and_plates_are_found),
		cmocka_unit_test(
		    test_rays_along_faces_edges_and_through_corners),
		cmocka_unit_test(test_planes_are_met_however_far),
		cmocka_unit_test(test_answers_do_not_depend_on_other_rays),
		cmocka_unit_test(test_batches_do_not_change_answers),
		cmocka_unit_test(test_tiny_tolerances_end),
		cmocka_unit_test(test_an_empty_extent_has_no_hits),
		cmocka_unit_test(test_errors_of_samplers_end_it),
		cmocka_unit_test(test_every_failed_allocation_is_told),
		cmocka_unit_test(
		    test_first_crossings_are_those_of_dense_samples),
		cmocka_unit_test(test_time_of_the_letter_A),
		cmocka_unit_test(test_time_of_a_thousand_points),
	};

	return cmocka_run_group_tests(tests, NULL, NULL);
}
