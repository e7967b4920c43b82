/*
 * What a kernel needs to know of one operator of a tape: where its table and
 * its opening's samples lie. Compiles as C11 and as OpenCL C.
 */
#ifndef CORE_DESCRIPTOR_H
#define CORE_DESCRIPTOR_H

#ifdef __OPENCL_C_VERSION__
#define DESCRIPTOR_UINT uint
#else
#include <assert.h>
#include <stdint.h>
#define DESCRIPTOR_UINT uint32_t
#endif

/* Values of the members family, profile and layout: those of the enums of
 * core/operator.h and core/profile.h, which a C file asserts. */
#define DESCRIPTOR_UNION 0
#define DESCRIPTOR_INTERSECTION 1
#define DESCRIPTOR_SMOOTH 0
#define DESCRIPTOR_BULGE 1
#define DESCRIPTOR_CIRCLE 2
#define DESCRIPTOR_SAMPLES 3
#define DESCRIPTOR_WARPED 0
#define DESCRIPTOR_UNIFORM 1

/* Nodes of tables that lie in images: two tables of at most this many nodes
 * an axis lie side by side along each axis of a slice. */
#define DESCRIPTOR_TILE 64

struct operator_desc {
	DESCRIPTOR_UINT family;      /* DESCRIPTOR_UNION ... */
	DESCRIPTOR_UINT profile;     /* DESCRIPTOR_SMOOTH ... */
	DESCRIPTOR_UINT layout;      /* DESCRIPTOR_WARPED ... */
	DESCRIPTOR_UINT resolution;  /* the table's nodes an axis, N */
	DESCRIPTOR_UINT is_constant; /* the opening: theta is the same at every
	                              * angle, no gradient is needed */
	float theta_least;           /* where a gradient is null */
	float theta;                 /* if is_constant; equals theta_least */
	/*
	 * Buffers: where the table's parts begin, in floats. Images: first is
	 * the table's first slice; second's bit 0 says that the table lies in
	 * the upper half along x, bit 1 along y.
	 */
	DESCRIPTOR_UINT first;
	DESCRIPTOR_UINT second;
	DESCRIPTOR_UINT silhouette;  /* in floats, within `curves` */
	DESCRIPTOR_UINT silhouette_count; /* nodes of CURVE_NODE floats */
	DESCRIPTOR_UINT opening;     /* in floats, within `openings` */
	DESCRIPTOR_UINT opening_count; /* nodes, regular in cos(alpha) */
};

#ifndef __OPENCL_C_VERSION__
static_assert(sizeof(struct operator_desc) == 52,
    "struct operator_desc is shared with the device");
#endif

#endif
