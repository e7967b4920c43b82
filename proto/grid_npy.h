/*
 * Regular grids of samples in (core/volume.h), as NumPy's .npy.
 */
#ifndef PROTO_GRID_NPY_H
#define PROTO_GRID_NPY_H

#include <stddef.h>

#include "core/err.h"

struct faults;

/* Samples, the last axis fastest, all finite and within VOLUME_SAMPLE_MAX.
 * Start with {0}; grid_fini frees. */
struct grid {
	float *samples;  /* count[0] * count[1] * count[2], malloc'd */
	size_t count[3]; /* along x, y, z: each within VOLUME_AXIS_*, their
	                  * product within VOLUME_SAMPLES_MAX */
};
void grid_fini(struct grid *grid);

/*
 * An array of shape (nx, ny, nz), '<f4' or '<f8', in C or Fortran order.
 * ERR_SYNTAX: no npy file, or one shorter or longer than it says; ERR_INVALID:
 * it holds something else, or a sample is not finite or too large; ERR_LIMIT:
 * too many samples; ERR_MEMORY. Each but the last adds a fault, or one for each
 * wrong sample, whose pointer is "/i/j/k"; others' is "".
 */
enum err grid_from_npy(const void *data, size_t length, struct grid *out,
    struct faults *faults);

#endif
