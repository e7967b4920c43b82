/*
 * Float64 3-vectors by value; all inline so that the evaluator's inner loops
 * need no link-time optimisation.
 */
#ifndef CORE_VEC3_H
#define CORE_VEC3_H

#include <math.h>

struct vec3 {
	double x, y, z;
};

static inline struct vec3 vec3(double x, double y, double z)
{
	return (struct vec3){x, y, z};
}

static inline struct vec3 vec3_add(struct vec3 a, struct vec3 b)
{
	return vec3(a.x + b.x, a.y + b.y, a.z + b.z);
}

static inline struct vec3 vec3_sub(struct vec3 a, struct vec3 b)
{
	return vec3(a.x - b.x, a.y - b.y, a.z - b.z);
}

static inline struct vec3 vec3_scale(double s, struct vec3 a)
{
	return vec3(s * a.x, s * a.y, s * a.z);
}

/* a + s b */
static inline struct vec3 vec3_axpy(double s, struct vec3 b, struct vec3 a)
{
	return vec3(a.x + s * b.x, a.y + s * b.y, a.z + s * b.z);
}

static inline double vec3_dot(struct vec3 a, struct vec3 b)
{
	return a.x * b.x + a.y * b.y + a.z * b.z;
}

static inline struct vec3 vec3_cross(struct vec3 a, struct vec3 b)
{
	return vec3(a.y * b.z - a.z * b.y, a.z * b.x - a.x * b.z,
	    a.x * b.y - a.y * b.x);
}

static inline double vec3_norm(struct vec3 a)
{
	return sqrt(vec3_dot(a, a));
}

/* a / |a| for any a but 0, however large or small. */
static inline struct vec3 vec3_unit(struct vec3 a)
{
	double most = fmax(fabs(a.x), fmax(fabs(a.y), fabs(a.z)));

	a = vec3(a.x / most, a.y / most, a.z / most);
	return vec3_scale(1.0 / vec3_norm(a), a);
}

/* Three numbers in a row. */
static inline struct vec3 vec3_get(const double *p)
{
	return vec3(p[0], p[1], p[2]);
}

static inline void vec3_put(double *p, struct vec3 a)
{
	p[0] = a.x;
	p[1] = a.y;
	p[2] = a.z;
}

#endif
