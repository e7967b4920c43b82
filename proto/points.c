#include "proto/points.h"

#include <math.h>
#include <stdint.h>
#include <stdlib.h>

#include "proto/fault.h"
#include "proto/npy.h"
#include "proto/points_binary.h"

void points_fini(struct points *points)
{
	free(points->xyz);
	*points = (struct points){0};
}

enum err points_too_many(size_t max_points, struct faults *faults)
{
	faults_add(faults, "", "more than %zu points", max_points);
	return ERR_LIMIT;
}

static enum err not_finite(const float *xyz, size_t n, struct faults *faults)
{
	size_t i;

	for (i = 0; i < n; i++) {
		if (!isfinite(xyz[i]))
			faults_add(faults, "",
			    "point %zu: %c is not finite as float32", i / 3,
			    "xyz"[i % 3]);
	}
	return ERR_INVALID;
}

enum err points_load(const unsigned char *data, size_t count, bool is_double,
    struct points *out, struct faults *faults)
{
	struct points points = {.count = count};
	enum err err;

	if (count == 0) {
		*out = points;
		return ERR_OK;
	}
	if (count > SIZE_MAX / (3 * sizeof *points.xyz))
		return ERR_MEMORY;
	points.xyz = malloc(3 * count * sizeof *points.xyz);
	if (!points.xyz)
		return ERR_MEMORY;
	if (npy_floats(data, 3 * count, is_double, points.xyz)) {
		err = not_finite(points.xyz, 3 * count, faults);
		goto fail;
	}
	*out = points;
	return ERR_OK;

fail:
	points_fini(&points);
	return err;
}

enum err points_from_octets(const void *data, size_t length,
    size_t max_points, struct points *out, struct faults *faults)
{
	const size_t point = 3 * sizeof(float);

	if (length % point) {
		faults_add(faults, "", "%zu bytes are no whole number of points "
		    "of %zu bytes each", length, point);
		return ERR_SYNTAX;
	}
	if (length / point > max_points)
		return points_too_many(max_points, faults);
	return points_load(data, length / point, false, out, faults);
}
