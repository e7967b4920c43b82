/*
 * Crossings of edges as planes (a point and a normal each), and the point that is
 * least far from them.
 */
#ifndef CORE_MESH_PLANES_H
#define CORE_MESH_PLANES_H

#include <stdbool.h>

struct mesh_cell;
struct mesh_near;
struct mesh_work;

/* Those of one curve, or of a cell and those beside it. */
#define MESH_PLANES_MAX (7 * 12)

struct mesh_planes {
	double p[MESH_PLANES_MAX][3], n[MESH_PLANES_MAX][3]; /* n: unit */
	bool is_cap[MESH_PLANES_MAX];
	int axis[MESH_PLANES_MAX]; /* of the edge */
	int count, caps;
};

/* Adds the crossing of a cell's edge (core/mesh_loops.h); near: the cell's block
 * with those further on. */
void mesh_planes_add(const struct mesh_work *w, const struct mesh_near *near,
    const struct mesh_cell *cell, unsigned edge, struct mesh_planes *l);

/* The mean of the points, of those on the surface if there are any. */
void mesh_planes_middle(const struct mesh_planes *l, double x[static 3]);

/* The mean normal, unit; the first one's where they cancel. */
void mesh_planes_normal(const struct mesh_planes *l, float normal[static 3]);

/* That of an edge or corner: every plane counts once, however many crossings it
 * has. */
void mesh_planes_crease(const struct mesh_planes *l, float normal[static 3]);

/*
 * Whether normals differ so little from their mean, normal, that the planes
 * determine no other direction. Then *height is how high the surface is above x,
 * the points' mean: of a quadratic one the mean of the tangent planes' heights is
 * as far above it as that of the points, 0, is below, so half of it.
 */
bool mesh_planes_are_flat(const struct mesh_planes *l,
    const double x[static 3], const float normal[static 3],
    double *height);

/* Whether x is within most of all planes. */
bool mesh_planes_are_near(const struct mesh_planes *l,
    const double x[static 3], double most);

/*
 * From x on to the point of least squared distances, along the axes that are
 * free and in those directions only that the planes determine; how many these
 * are. mean: the planes' normal.
 */
int mesh_planes_solve(const struct mesh_planes *l,
    const bool is_free[static 3], const float mean[static 3],
    double x[static 3]);

#endif
