/*
 * Meshes of whatever values at corners: closed 2-manifolds, always.
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

#include "core/mesh.h"
#include "core/mesh_loops.h"
#include "core/output.h"
#include "core/range.h"
#include "core/tape.h"
#include "core/tree.h"
#include "tests/support/random_tree.h"
#include "tests/support/sanitized.h"

/* ---- a sampler of noise ---- */

/* Values and gradients that depend on nothing but the bits of the point, of a
 * few kinds. */
struct noise {
	struct sampler sampler;
	uint64_t seed;
	int kind;
};

static uint64_t mix(uint64_t x)
{
	struct random_stream r = {x};

	return random_bits(&r);
}

static double unit(uint64_t bits)
{
	return (double)(bits >> 11) * 0x1p-53;
}

static float value_at(const struct noise *n, const float p[3])
{
	uint32_t bits[3];
	uint64_t h = n->seed;
	double v;

	memcpy(bits, p, sizeof bits);
	for (int k = 0; k < 3; k++)
		h = mix(h ^ bits[k]);
	v = unit(h);
	switch (n->kind) {
	case 0: /* anything */
		return (float)v;
	case 1: /* two values, so that products are equal */
		return v < 0.5 ? 0.0f : 1.0f;
	case 2: /* often iso itself */
		return (float)(floor(v * 3.0) * 0.5);
	case 3: /* seldom inside */
		return v < 0.15 ? 1.0f : (float)(0.49 * v);
	default: /* seldom outside */
		return v < 0.15 ? 0.0f : (float)(0.5 + v);
	}
}

static enum err sample_noise(struct sampler *sampler, const float *points,
    size_t count, unsigned outputs, float *rows)
{
	const struct noise *n = (const struct noise *)sampler;

	for (size_t i = 0; i < count; i++) {
		const float *p = points + 3 * i;

		if (outputs & OUTPUT_VALUE)
			*rows++ = value_at(n, p);
		if (outputs & OUTPUT_GRADIENT)
			for (int k = 0; k < 3; k++)
				*rows++ = (float)(unit(mix(n->seed + (uint64_t)k +
				    (uint64_t)(value_at(n, p) * 1e6f))) - 0.5);
		if (outputs & OUTPUT_COLOR)
			for (int k = 0; k < 3; k++)
				*rows++ = 0.5f;
	}
	return ERR_OK;
}

/* ---- ranges that begin somewhere ---- */

struct model {
	struct node node;
	struct tape *tape;
	struct range_tape *ranges;
};

static struct model *model_create(double radius)
{
	struct model *m = calloc(1, sizeof *m);
	struct tree tree = {&m->node, TREE_NULL_GRADIENT};
	struct tape_error error;

	m->node = (struct node){.type = NODE_PRIMITIVE,
	    .primitive = {.type = PRIMITIVE_POINT, .radius = {radius},
	    .exponent = 3.0, .weight = 1.0}};
	assert_int_equal(tape_compile(&tree, 10, &m->tape, &error), ERR_OK);
	assert_int_equal(range_tape_create(m->tape, &m->ranges), ERR_OK);
	return m;
}

static void model_free(struct model *m)
{
	range_tape_free(m->ranges);
	tape_free(m->tape);
	free(m);
}

static int setup(void **state)
{
	*state = model_create(4.0);
	return 0;
}

static int teardown(void **state)
{
	model_free(*state);
	return 0;
}

/* ---- checks ---- */

static int compare_positions(const void *a, const void *b)
{
	return memcmp(a, b, 3 * sizeof(float));
}

/* Vertices at the same place as another. */
static size_t count_twins(const struct mesh *m)
{
	size_t n = m->figures.vertices, twins = 0;
	float *p = malloc((3 * n + 1) * sizeof *p);

	memcpy(p, m->positions, 3 * n * sizeof *p);
	qsort(p, n, 3 * sizeof *p, compare_positions);
	for (size_t i = 1; i < n; i++)
		twins += memcmp(p + 3 * i, p + 3 * (i - 1),
		    3 * sizeof *p) == 0;
	free(p);
	return twins;
}

static void check_closed(const struct mesh *m, const char *what, uint64_t seed)
{
	size_t edges, vertices, twins = count_twins(m);

	assert_int_equal(mesh_check(m, &edges, &vertices), ERR_OK);
	if (edges != 0 || vertices != 0 || twins != 0)
		fail_msg("%s %lu: %zu edges, %zu vertices, %zu twins of %zu",
		    what, (unsigned long)seed, edges, vertices, twins,
		    m->figures.vertices);
	assert_int_equal(m->figures.euler % 2, 0);
	for (size_t i = 0; i < 3 * m->figures.vertices; i++)
		assert_true(isfinite(m->positions[i]));
}

#define SEEDS (SANITIZED ? 300 : 3000)

static void test_noise_is_closed_and_manifold(void **state)
{
	const struct model *model = *state;
	size_t vertices = 0;

	for (uint64_t seed = 0; seed < SEEDS; seed++) {
		struct noise noise = {{sample_noise, NULL}, mix(seed),
		    (int)(seed % 5)};
		double n = 1.0 + (double)(seed / 5 % 9);
		struct mesh_options o = {.min = vec3(0.0, 0.0, 0.0),
		    .max = vec3(n, 3.0, 1.0 + (double)(seed / 5 % 4)),
		    .edge = 1.0, .iso = 0.5, .features = seed % 2,
		    .normals = true};
		struct mesh *m;

		assert_int_equal(mesh_build(model->ranges, &o, &noise.sampler,
		    &m), ERR_OK);
		check_closed(m, "seed", seed);
		vertices += m->figures.vertices;
		mesh_free(m);
	}
	printf("measured: %zu vertices of noise\n", vertices);
}

/* Cells of eight steps of float32's, the shortest: 2^-20 of the coordinates. */
static void test_noise_of_short_cells_is_closed(void **state)
{
	struct model *model = model_create(1e7);
	size_t vertices = 0;

	(void)state;
	for (uint64_t seed = 0; seed < SEEDS / 10; seed++) {
		struct noise noise = {{sample_noise, NULL}, mix(seed),
		    (int)(seed % 5)};
		double size = 1.0 + (double)(seed / 5 % 6);
		double far = seed / 30 % 2 ? 0x1p20 : 0x1.fffp20;
		double edge = far * 0x1p-20;
		struct mesh_options o = {
		    .min = vec3(far - size * edge, -far, 0.0),
		    .max = vec3(far, 3.0 * edge - far, 4.0 * edge),
		    .edge = edge, .iso = 0.5, .features = seed % 2};
		struct mesh *m;

		assert_int_equal(mesh_build(model->ranges, &o, &noise.sampler,
		    &m), ERR_OK);
		assert_int_equal(m->figures.counts[0], size);
		check_closed(m, "short", seed);
		vertices += m->figures.vertices;
		mesh_free(m);
	}
	printf("measured: %zu vertices of short cells\n", vertices);
	assert_true(vertices > SEEDS);
	model_free(model);
}

/* A sampler that gives a point another value every time. */
static enum err sample_fickle(struct sampler *sampler, const float *points,
    size_t count, unsigned outputs, float *rows)
{
	struct noise *n = (struct noise *)sampler;

	n->seed++;
	return sample_noise(sampler, points, count, outputs, rows);
}

static void test_fickle_samplers_do_no_harm(void **state)
{
	const struct model *model = *state;

	for (uint64_t seed = 0; seed < 200; seed++) {
		struct noise noise = {{sample_fickle, NULL}, mix(seed), 0};
		struct mesh_options o = {.min = vec3(0.0, 0.0, 0.0),
		    .max = vec3(9.0, 7.0, 40.0), .edge = 1.0, .iso = 0.5,
		    .features = true};
		struct mesh *m;

		assert_int_equal(mesh_build(model->ranges, &o, &noise.sampler,
		    &m), ERR_OK);
		check_closed(m, "fickle", seed);
		mesh_free(m);
	}
}

/* Every case of corners inside and diagonals joined. */
static void test_loops_are_rings_of_three_and_more(void **state)
{
	(void)state;
	for (unsigned inside = 0; inside < 256; inside++)
		for (unsigned joined = 0; joined < 64; joined++) {
			struct mesh_loops l;
			unsigned lengths[MESH_LOOPS_MAX] = {0};

			mesh_loops_make(inside, joined, &l);
			assert_true(l.count <= MESH_LOOPS_MAX);
			for (unsigned e = 0; e < 12; e++) {
				bool crossed =
				    (inside >> mesh_loops_begin(e) ^
				    inside >> mesh_loops_end(e)) & 1;

				assert_int_equal(l.of[e] != MESH_LOOPS_NONE,
				    crossed);
				if (crossed)
					lengths[l.of[e]]++;
			}
			for (unsigned k = 0; k < l.count; k++)
				assert_true(lengths[k] >= 3);
		}
}

int main(void)
{
	const struct CMUnitTest tests[] = {
		cmocka_unit_test(test_noise_is_closed_and_manifold),
		cmocka_unit_test(test_noise_of_short_cells_is_closed),
		cmocka_unit_test(test_fickle_samplers_do_no_harm),
		cmocka_unit_test(test_loops_are_rings_of_three_and_more),
	};

	return cmocka_run_group_tests(tests, setup, teardown);
}
