/*
 * NumPy's .npy: "\x93NUMPY", a version, the length of a header, the header (a
 * Python dict with 'descr', 'fortran_order' and 'shape'), then the numbers.
 */
#ifndef PROTO_NPY_H
#define PROTO_NPY_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#include "core/err.h"

struct faults;

/* Axes that are kept; more are only counted. */
#define NPY_AXES 4

/* What a file says it holds, and what follows its header. */
struct npy {
	bool is_double;             /* '<f8', else '<f4' */
	bool is_fortran;            /* the first axis runs fastest */
	size_t axes;
	uint64_t shape[NPY_AXES];
	const unsigned char *data;  /* in the file */
	size_t length;              /* bytes; not compared with shape */
};

/*
 * Reads the header of a file of format 1.0 to 3.0. ERR_SYNTAX: it is none;
 * ERR_INVALID: of other numbers than '<f4' or '<f8'. Both add a fault, whose
 * pointer is "".
 */
enum err npy_read(const void *file, size_t length, struct npy *out,
    struct faults *faults);

/* count little-endian numbers of data to out; how many of them are not finite
 * as float32. */
size_t npy_floats(const unsigned char *data, size_t count, bool is_double,
    float *out);

#endif
