/*
 * Points in NumPy's .npy (proto/npy.h).
 */
#include <string.h>

#include "proto/fault.h"
#include "proto/npy.h"
#include "proto/points.h"
#include "proto/points_binary.h"

static enum err refuse(struct faults *faults, const char *why)
{
	faults_add(faults, "", "%s", why);
	return ERR_INVALID;
}

static size_t point_bytes(const struct npy *npy)
{
	return 3 * (npy->is_double ? sizeof(double) : sizeof(float));
}

enum err points_npy_check(const struct npy *npy, size_t max_points,
    struct faults *faults)
{
	if (npy->is_fortran)
		return refuse(faults, "fortran_order must be False: use "
		    "numpy.ascontiguousarray");
	if (npy->axes != 2 || npy->shape[1] != 3)
		return refuse(faults, "shape must be (N, 3)");
	if (npy->shape[0] > max_points)
		return points_too_many(max_points, faults);
	return ERR_OK;
}

enum err points_npy_check_length(const struct npy *npy, size_t length,
    struct faults *faults)
{
	const size_t point = point_bytes(npy);

	if (length % point == 0 && length / point == npy->shape[0])
		return ERR_OK;
	faults_add(faults, "", "%zu bytes follow the header, which says "
	    "%llu points of %zu bytes", length,
	    (unsigned long long)npy->shape[0], point);
	return ERR_SYNTAX;
}

size_t points_npy_header(const unsigned char *data, size_t length)
{
	static const char magic[] = "\x93NUMPY";
	const size_t known = length < sizeof magic - 1 ? length :
	    sizeof magic - 1;
	size_t size;

	if (memcmp(data, magic, known) != 0 ||
	    (length > 6 && (data[6] < 1 || data[6] > 3)) ||
	    (length > 7 && data[7] != 0))
		return 0;
	if (length < 10 || (data[6] > 1 && length < 12))
		return SIZE_MAX;
	size = (size_t)data[8] | (size_t)data[9] << 8;
	return data[6] == 1 ? 10 + size : 12 + (size | (size_t)data[10] << 16 |
	    (size_t)data[11] << 24);
}

enum err points_from_npy(const void *data, size_t length, size_t max_points,
    struct points *out, struct faults *faults)
{
	struct npy npy;
	enum err err;

	err = npy_read(data, length, &npy, faults);
	if (!err)
		err = points_npy_check(&npy, max_points, faults);
	if (!err)
		err = points_npy_check_length(&npy, npy.length, faults);
	return err ? err : points_load(npy.data, (size_t)npy.shape[0],
	    npy.is_double, out, faults);
}
