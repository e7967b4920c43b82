/*
 * Grids of samples: what is accepted is within its limits, and as a volume of
 * either kind gives finite fields. The first byte chooses where.
 */
#include <math.h>
#include <stddef.h>
#include <stdint.h>
#include <stdlib.h>

#include "core/primitive.h"
#include "core/volume.h"
#include "proto/fault.h"
#include "proto/grid_npy.h"

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size);

static void demand(int fine)
{
	if (!fine)
		abort();
}

static void check_finite(const struct jet *f)
{
	demand(isfinite(f->value) && f->value >= 0.0);
	demand(isfinite(vec3_norm(f->gradient)));
	demand(isfinite(f->hessian.xx + f->hessian.yy + f->hessian.zz +
	    f->hessian.xy + f->hessian.xz + f->hessian.yz));
}

static void check_volume(const struct grid *grid, bool is_distance,
    double along)
{
	double params[PRIMITIVE_PARAMS_MAX];
	struct volume *v;
	struct jet f;

	demand(volume_create(grid->samples, grid->count, vec3(0.0, 0.0, 0.0),
	    vec3(1.0, 2.0, 1e-3), is_distance, &v) == ERR_OK);
	demand(volume_prepare(v, is_distance ? 0.1 : 0.0, params) <=
	    PRIMITIVE_PARAMS_MAX);
	for (int i = -2; i < 12; i++) {
		double t = 0.1 * (i + along);

		volume_eval(v, params, vec3(t, 2.0 * t * t, 1e-3 * (1.0 - t)),
		    2, &f);
		check_finite(&f);
	}
	volume_release(v);
}

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size)
{
	struct faults faults = {0};
	struct grid grid = {0};
	enum err err;

	if (size == 0)
		return 0;
	err = grid_from_npy(data + 1, size - 1, &grid, &faults);
	demand((err == ERR_OK) == (faults.count == 0));
	demand((err == ERR_OK) == (grid.samples != NULL));
	if (err != ERR_OK)
		return 0;
	for (int i = 0; i < 3; i++)
		demand(grid.count[i] >= VOLUME_AXIS_MIN &&
		    grid.count[i] <= VOLUME_AXIS_MAX);
	check_volume(&grid, false, data[0] / 256.0);
	check_volume(&grid, true, data[0] / 256.0);
	grid_fini(&grid);
	return 0;
}
