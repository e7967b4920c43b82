/*
 * The parts of core/range.h: what its files share, and nobody else needs.
 */
#ifndef CORE_RANGE_PARTS_H
#define CORE_RANGE_PARTS_H

#include <stdbool.h>

#include "core/opcode.h"
#include "core/range.h"
#include "core/vec3.h"

struct operator;
struct volume;

/*
 * The points that a range is sought over: c + t1 v1 + ... + tn vn with every
 * |t| <= 1. A box has three v, a stretch of a ray one: affine maps keep either
 * what it is.
 */
struct patch {
	struct vec3 c, v[3];
	int n;
	double h[3]; /* half the edges of its box about c */
	double r;    /* none of them is further from c */
	double speed; /* none moves faster, as t1 (n > 1: the world's point) does
	               * with speed 1; 0: slopes are not asked for */
	bool is_box;  /* nothing but its box, along the axes */
};

/* Fills in h and r of c, v and n; of one v, speed. */
void patch_finish(struct patch *s);

/* How far g.(x - c) goes from 0 over s. */
static inline double patch_across(const struct patch *s, struct vec3 g)
{
	double sum = fabs(vec3_dot(g, s->v[0]));

	for (int i = 1; i < s->n; i++)
		sum += fabs(vec3_dot(g, s->v[i]));
	return sum;
}

/*
 * A field over a patch: its values, and between which slopes it rises; of a
 * patch of one v df/dt, of others as much as speed allows (a Lipschitz bound).
 */
struct held {
	double least, most;
	double fall, rise;
	bool is_angled; /* a blend takes part in it whose angle changes: slopes
	                 * leave that out */
};

/*
 * list's field along the stretch from a to b of a ray, t = -1 to 1, without
 * RANGE_MARGIN.
 */
void range_stretch(const struct range_tape *r, const struct prune_list *list,
    struct vec3 a, struct vec3 b, struct held *out);

/* Over how much of its frame's lengths a primitive's field falls: the least R,
 * the falloff, 1/s, or a volume's least spacing. */
double range_size(const struct range_tape *r, const struct insn *insn);

/* How much a frame (OP_FRAME, OP_ENTER) stretches lengths at most. */
double range_stretching(const struct range_tape *r, const struct insn *insn);

/* A primitive's. */
void range_primitive(OPCODE_UINT op, const double *params,
    const struct patch *s, struct held *out);

/* What is kept of a volume for ranges: the least and the most coefficient of
 * blocks of 2, 4, 8 ... along each axis. */
struct range_volume;

enum err range_volume_create(const struct volume *v,
    struct range_volume **out);
void range_volume_free(struct range_volume *r);
void range_volume_eval(const struct range_volume *r, const double *params,
    const struct patch *s, struct held *out);

/* A solid's field at signed distance d, and df/dd. */
double range_falloff(double d, double inv_fall);
double range_falloff_slope(double d, double inv_fall);

/* s through a warp: a box about W(s), of three v. */
void range_warp(OPCODE_UINT type, const double *params, const struct patch *s,
    struct patch *out);

/* phi (core/boundary.h) and a profile's distance from the origin, as tables. */
#define RANGE_PHI 512
#define RANGE_RAYS 64

struct range_operator {
	bool is_union;
	double least, most;           /* tan(theta) */
	double slope;                 /* no first derivative is larger in size */
	bool folds;                   /* some are negative */
	double inmost;                /* the least radius, 1 at most */
	double error;                 /* of a device's coarse table, beyond what
	                               * RANGE_MARGIN is for */
	double radius[RANGE_RAYS + 1]; /* of the silhouette where x = r y, r from
	                               * 0 to 1 */
};

/* Tables of phi, for all operators: RANGE_PHI + 1 numbers. */
void range_phi_table(double *out);

void range_operator_init(const struct operator *op,
    struct range_operator *out);

/* The composition of a and b, for every angle. */
void range_compose(const struct range_operator *op, const double *phi,
    const struct held *a, const struct held *b, struct held *out);

/* max(a, b) and min(a, b). */
void range_max(const struct held *a, const struct held *b, struct held *out);
void range_min(const struct held *a, const struct held *b, struct held *out);

/* A classic operator's, core/classic.h. */
void range_classic(OPCODE_UINT type, const double *params,
    const struct held *a, const struct held *b, struct held *out);

#endif
