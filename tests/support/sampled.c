#include "tests/support/sampled.h"

#include <setjmp.h>
#include <stdarg.h>
#include <stdint.h>
#include <stdlib.h>

#include <cmocka.h>

#include "core/volume.h"

static void bump(double x, double b[static 3])
{
	double w = 1.0 - x * x, w4 = w * w * w * w;

	b[0] = b[1] = b[2] = 0.0;
	if (w <= 0.0)
		return;
	b[0] = w4 * w * w;
	b[1] = -12.0 * x * w4 * w;
	b[2] = w4 * (120.0 * x * x - 12.0 * w);
}

void sampled_bump(struct vec3 p, struct jet *out)
{
	double x[3], y[3], z[3];

	bump(p.x, x);
	bump(p.y, y);
	bump(p.z, z);
	out->value = x[0] * y[0] * z[0];
	out->gradient = vec3(x[1] * y[0] * z[0], x[0] * y[1] * z[0],
	    x[0] * y[0] * z[1]);
	out->hessian = (struct sym3){x[2] * y[0] * z[0], x[0] * y[2] * z[0],
	    x[0] * y[0] * z[2], x[1] * y[1] * z[0], x[1] * y[0] * z[1],
	    x[0] * y[1] * z[1]};
}

void sampled_sphere(struct vec3 p, struct jet *out)
{
	double length = vec3_norm(p);

	out->value = length - 0.6;
	out->gradient = vec3_scale(1.0 / length, p);
	out->hessian = sym3_scale(1.0 / length, sym3_axpy(-1.0,
	    sym3_square(out->gradient), sym3_identity(1.0)));
}

struct volume *sampled_volume(sampled_field *f, const size_t count[static 3],
    struct vec3 min, struct vec3 max, bool is_distance)
{
	float *samples = malloc(count[0] * count[1] * count[2] *
	    sizeof *samples);
	struct vec3 h = vec3_sub(max, min);
	struct volume *v;
	struct jet jet;
	float *at = samples;

	assert_non_null(samples);
	for (size_t i = 0; i < count[0]; i++)
		for (size_t j = 0; j < count[1]; j++)
			for (size_t k = 0; k < count[2]; k++) {
				f(vec3(min.x + h.x * (double)i /
				    (double)(count[0] - 1),
				    min.y + h.y * (double)j /
				    (double)(count[1] - 1),
				    min.z + h.z * (double)k /
				    (double)(count[2] - 1)), &jet);
				*at++ = (float)jet.value;
			}
	assert_int_equal(volume_create(samples, count, min, max, is_distance,
	    &v), ERR_OK);
	free(samples);
	return v;
}

struct volume *sampled_cube(sampled_field *f, size_t n, bool is_distance)
{
	return sampled_volume(f, (size_t[3]){n, n, n}, vec3(-1.0, -1.0, -1.0),
	    vec3(1.0, 1.0, 1.0), is_distance);
}
