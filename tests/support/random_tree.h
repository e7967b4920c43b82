/*
 * Random valid Blob-trees and points that matter to them, for tests of the
 * evaluators. The same options always give the same tree and points.
 */
#ifndef TESTS_SUPPORT_RANDOM_TREE_H
#define TESTS_SUPPORT_RANDOM_TREE_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#include "core/operator.h"

struct random_tree;
struct tape;
struct tree;

/* A stream of random numbers (splitmix64); start with any seed. */
struct random_stream {
	uint64_t state;
};
uint64_t random_bits(struct random_stream *r);
/* Uniform in [least, most). */
double random_in(struct random_stream *r, double least, double most);
/* Uniform in 0..count-1. */
int random_below(struct random_stream *r, int count);

#define RANDOM_TREE_PRIMITIVES_MAX 64

/* Warps within each other, refs followed. */
#define RANDOM_TREE_WARPS_MAX 3

enum random_profile {
	RANDOM_PROFILE_ANY, /* any of the following */
	RANDOM_PROFILE_SMOOTH,
	RANDOM_PROFILE_BULGE, /* K = 0.8 */
	RANDOM_PROFILE_BULGE_SLIGHT, /* K = 0.3 */
	RANDOM_PROFILE_CIRCLE,
	RANDOM_PROFILE_SAMPLES,
	RANDOM_PROFILE_COUNT
};

/*
 * Zero gives trees of primitives, transforms, refs and compositions by every
 * gradient-based operator, sum and ricci. whole adds the rest of the language,
 * but for what no_* leaves out: warps, up to RANDOM_TREE_WARPS_MAX within each
 * other; operators without angles; convolutions and volumes among the leaves;
 * colours at any node.
 */
struct random_tree_options {
	uint64_t seed;
	int max_primitives; /* after expanding refs; 0: 40 */
	int max_depth;      /* of compositions; 0: 6 */
	/*
	 * 0: any compositions. Else exactly this many with an opening that
	 * depends on the angle, each an operand of the next, the root the last;
	 * other compositions are sums, riccis, sharp ones and constant openings;
	 * no refs. max_primitives > nested, max_depth >= nested.
	 */
	int nested;
	bool only_soft, only_solids;
	bool no_transforms, no_refs, no_sharp;
	bool whole;
	bool no_warps, no_classic, no_convolution, no_volumes, no_materials;
	enum random_profile profile; /* not ANY: of custom openings, all that is
	                              * left then of operators */
	enum table_layout layout;    /* of every operator, at its default size */
};

/* Never NULL; aborts when out of memory. */
struct random_tree *random_tree_create(const struct random_tree_options *o);
void random_tree_free(struct random_tree *t);

/* Lives as long as t. */
const struct tree *random_tree_get(const struct random_tree *t);

/*
 * count points, xyz: a quarter each uniform over a box about the primitives,
 * near a primitive (where warps take it), near one where the field is not 0
 * (where that is soon found), near the iso-surface (likewise). tape is t's.
 */
void random_tree_points(const struct random_tree *t, const struct tape *tape,
    uint64_t seed, size_t count, float *xyz);

/* One primitive of a random type, overlapping [-1, 1]^3. */
struct primitive random_primitive(struct random_stream *r, bool soft,
    bool solid);

/* A profile of the fixed set; not ANY. */
struct profile random_profile_make(enum random_profile profile);

#endif
