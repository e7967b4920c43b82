/*
 * Differential geometry of the level set through a point, from the field's jet
 * there (Goldman 2005, "Curvature formulas for implicit curves and surfaces").
 */
#ifndef CORE_SURFACE_H
#define CORE_SURFACE_H

#include "core/jet.h"

/* The outward unit normal -grad f / |grad f|; 0 where the gradient is 0. */
struct vec3 surface_normal(const struct jet *f);

/*
 * Mean curvature (half the divergence of the outward normal: 1/r on a sphere,
 * 1/length) and Gaussian curvature (1/length^2); both 0 where the gradient is
 * 0. Every number is finite.
 */
void surface_curvature(const struct jet *f, double *mean, double *gaussian);

#endif
