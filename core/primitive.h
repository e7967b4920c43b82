/*
 * Primitive fields: soft objects and solids (SPEC section 2), with exact first
 * and second derivatives.
 */
#ifndef CORE_PRIMITIVE_H
#define CORE_PRIMITIVE_H

#include "core/jet.h"
#include "core/opcode.h"
#include "core/vec3.h"

struct volume;

/* The most parameters one primitive has on a tape. */
#define PRIMITIVE_PARAMS_MAX 16

enum primitive_type {
	PRIMITIVE_POINT,
	PRIMITIVE_SEGMENT,
	PRIMITIVE_TRIANGLE,
	PRIMITIVE_DISC,
	PRIMITIVE_CIRCLE,
	PRIMITIVE_SPHERE,
	PRIMITIVE_BOX,
	PRIMITIVE_CYLINDER,
	PRIMITIVE_CAPSULE,
	PRIMITIVE_CONE,
	PRIMITIVE_TORUS,
	PRIMITIVE_PLANE,
	PRIMITIVE_CAUCHY_POINT,    /* elements of convolution surfaces: */
	PRIMITIVE_CAUCHY_SEGMENT,  /* core/convolution.h */
	PRIMITIVE_CAUCHY_TRIANGLE,
	PRIMITIVE_VOLUME,          /* core/volume.h */
	PRIMITIVE_COUNT
};

/*
 * A primitive as a document writes it. Which members count depends on type;
 * the others are ignored. Directions need not be unit vectors, but not null.
 */
struct primitive {
	enum primitive_type type;
	/* Points: a is also a centre, or a plane's point. */
	struct vec3 a, b, c;
	/* disc, circle, plane: normal; torus: axis. */
	struct vec3 normal;
	/* box */
	struct vec3 half_size;
	double rounding;
	/* Soft objects: where f = 0.5; segment: radii at a and b. Solids: the
	 * sphere's, cylinder's, capsule's radius in radius[0], the cone's radii. */
	double radius[2];
	double major, minor;     /* torus; major: also disc_radius, ring_radius */
	double exponent, weight; /* soft objects: n >= 3, weight >= 0 */
	double falloff;          /* solids: > 0; volume: > 0 if it holds signed
	                          * distances, 0 if fields */
	double s;                /* cauchy: the kernel's 1/width; radius[0]: where
	                          * an endless segment's field is 0.5 */
	struct volume *volume;   /* volume: what it samples */
};

/* The opcode that evaluates a primitive of this type. */
OPCODE_UINT primitive_opcode(enum primitive_type type);

/*
 * Writes p's tape parameters, in the order core/opcode.h gives, to params, and
 * returns how many. p has been checked: sizes positive and finite. A segment,
 * cylinder, capsule or cone whose ends coincide (are within 1e-12) gets an
 * arbitrary axis and length 0, and a segment then the radius at a; a triangle
 * may be degenerate.
 */
int primitive_prepare(const struct primitive *p,
    double params[static PRIMITIVE_PARAMS_MAX]);

/*
 * The length over which p's field falls: the least support radius R of a soft
 * object, a solid's falloff, a convolution's 1/s; a volume's falloff, or its
 * least spacing. Greater than 0. In the primitive's frame.
 */
double primitive_size(const struct primitive *p);

/*
 * The field of a primitive opcode but OP_VOLUME (volume_eval) at x (within
 * POINT_REACH), with derivatives up to order (0, 1, 2; those beyond are 0).
 * Every number is finite. But for convolutions (core/convolution.h): from the
 * rim of the support outwards, and from a solid's depth falloff inwards, all
 * derivatives are exactly 0.
 *
 * Where the distance has no derivative (medial axes, a ring's axis, a solid's
 * edges) the gradient is that of one of the sides, or their mean. Beside such
 * a place the Hessian grows as 1/distance from it; the distance is held above
 * AXIS_GUARD times: the falloff, at an edge or a vertex seen from outside; the
 * radius, at the axis or centre of a shape of revolution (the minor radius at
 * a torus's core).
 */
void primitive_eval(OPCODE_UINT op, const double *params, struct vec3 x,
    int order, struct jet *out);

/*
 * A solid's field from its signed distance and the distance's derivatives;
 * inv_fall is 1/falloff. *out is 0 before; derivatives beyond order stay so.
 */
void primitive_solid(const struct jet *distance, double inv_fall, int order,
    struct jet *out);

#endif
