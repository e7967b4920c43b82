/*
 * Points in NumPy's .npy (proto/npy.h).
 */
#include "proto/fault.h"
#include "proto/npy.h"
#include "proto/points.h"
#include "proto/points_binary.h"

static enum err refuse(struct faults *faults, const char *why)
{
	faults_add(faults, "", "%s", why);
	return ERR_INVALID;
}

enum err points_from_npy(const void *data, size_t length, size_t max_points,
    struct points *out, struct faults *faults)
{
	struct npy npy;
	enum err err;
	size_t point;

	err = npy_read(data, length, &npy, faults);
	if (err)
		return err;
	if (npy.is_fortran)
		return refuse(faults, "fortran_order must be False: use "
		    "numpy.ascontiguousarray");
	if (npy.axes != 2 || npy.shape[1] != 3)
		return refuse(faults, "shape must be (N, 3)");
	if (npy.shape[0] > max_points)
		return points_too_many(max_points, faults);
	point = 3 * (npy.is_double ? sizeof(double) : sizeof(float));
	if (npy.length % point || npy.length / point != npy.shape[0]) {
		faults_add(faults, "", "%zu bytes follow the header, which says "
		    "%llu points of %zu bytes", npy.length,
		    (unsigned long long)npy.shape[0], point);
		return ERR_SYNTAX;
	}
	return points_load(npy.data, (size_t)npy.shape[0], npy.is_double, out,
	    faults);
}
