#include "proto/grid_npy.h"

#include <math.h>
#include <stdio.h>
#include <stdlib.h>

#include "core/volume.h"
#include "proto/fault.h"
#include "proto/npy.h"

void grid_fini(struct grid *grid)
{
	free(grid->samples);
	*grid = (struct grid){0};
}

/* The shape to count, and the samples that makes to *total. */
static enum err check_shape(const struct npy *npy, size_t count[static 3],
    size_t *total, struct faults *faults)
{
	*total = 1;
	if (npy->axes != 3) {
		faults_add(faults, "", "shape must be (nx, ny, nz), of 3 axes, "
		    "not %zu", npy->axes);
		return ERR_INVALID;
	}
	for (int i = 0; i < 3; i++) {
		if (npy->shape[i] < VOLUME_AXIS_MIN ||
		    npy->shape[i] > VOLUME_AXIS_MAX) {
			faults_add(faults, "", "shape: axis %c has %llu "
			    "samples, not %d to %d", "xyz"[i],
			    (unsigned long long)npy->shape[i],
			    VOLUME_AXIS_MIN, VOLUME_AXIS_MAX);
			return ERR_INVALID;
		}
		count[i] = (size_t)npy->shape[i];
		*total *= count[i]; /* at most 2^36 */
	}
	if (*total > VOLUME_SAMPLES_MAX) {
		faults_add(faults, "", "shape: more than %zu samples",
		    VOLUME_SAMPLES_MAX);
		return ERR_LIMIT;
	}
	return ERR_OK;
}

static enum err check_length(const struct npy *npy, size_t total,
    struct faults *faults)
{
	size_t size = npy->is_double ? sizeof(double) : sizeof(float);

	if (npy->length == total * size)
		return ERR_OK;
	faults_add(faults, "", "%zu bytes follow the header, which says %zu "
	    "samples of %zu bytes", npy->length, total, size);
	return ERR_SYNTAX;
}

/* Lines along x, the fastest in the file, to a grid with z fastest. */
static void load_fortran(const struct npy *npy, const size_t count[static 3],
    float *out)
{
	size_t size = npy->is_double ? sizeof(double) : sizeof(float);
	const unsigned char *at = npy->data;
	float line[VOLUME_AXIS_MAX];

	for (size_t k = 0; k < count[2]; k++)
		for (size_t j = 0; j < count[1]; j++) {
			npy_floats(at, count[0], npy->is_double, line);
			at += count[0] * size;
			for (size_t i = 0; i < count[0]; i++)
				out[(i * count[1] + j) * count[2] + k] =
				    line[i];
		}
}

static void refuse_sample(const struct grid *grid, size_t at,
    struct faults *faults)
{
	size_t k = at % grid->count[2], row = at / grid->count[2];
	size_t j = row % grid->count[1], i = row / grid->count[1];
	char pointer[80];

	snprintf(pointer, sizeof pointer, "/%zu/%zu/%zu", i, j, k);
	if (!isfinite(grid->samples[at]))
		faults_add(faults, pointer, "sample [%zu, %zu, %zu] is not "
		    "finite as float32", i, j, k);
	else
		faults_add(faults, pointer, "sample [%zu, %zu, %zu] is %g; its "
		    "size must be at most %g", i, j, k,
		    (double)grid->samples[at], (double)VOLUME_SAMPLE_MAX);
}

static enum err check_samples(const struct grid *grid, size_t total,
    struct faults *faults)
{
	enum err err = ERR_OK;

	for (size_t i = 0; i < total; i++)
		if (!(fabsf(grid->samples[i]) <= VOLUME_SAMPLE_MAX)) {
			if (faults->count < FAULT_MAX)
				refuse_sample(grid, i, faults);
			else
				faults->count++;
			err = ERR_INVALID;
		}
	return err;
}

enum err grid_from_npy(const void *data, size_t length, struct grid *out,
    struct faults *faults)
{
	struct grid grid = {0};
	struct npy npy;
	size_t total;
	enum err err;

	err = npy_read(data, length, &npy, faults);
	if (!err)
		err = check_shape(&npy, grid.count, &total, faults);
	if (!err)
		err = check_length(&npy, total, faults);
	if (err)
		return err;
	grid.samples = malloc(total * sizeof *grid.samples);
	if (grid.samples == NULL)
		return ERR_MEMORY;
	if (npy.is_fortran)
		load_fortran(&npy, grid.count, grid.samples);
	else
		npy_floats(npy.data, total, npy.is_double, grid.samples);
	err = check_samples(&grid, total, faults);
	if (err) {
		grid_fini(&grid);
		return err;
	}
	*out = grid;
	return ERR_OK;
}
