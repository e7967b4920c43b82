/*
 * A second-order jet of a scalar field at a point: what an evaluation carries
 * up the Blob-tree (SPEC section 1, "Gradient").
 */
#ifndef CORE_JET_H
#define CORE_JET_H

#include "core/sym3.h"
#include "core/vec3.h"

struct jet {
	double value;         /* f >= 0 */
	struct vec3 gradient; /* df/dp, 1 / length of the frame it is in */
	struct sym3 hessian;  /* d2f/dp2, 1 / length^2 */
};

#endif
