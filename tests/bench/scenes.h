/*
 * The scenes of the bench, documents written by code and parsed like any other,
 * and the points that they are evaluated at.
 */
#ifndef TESTS_BENCH_SCENES_H
#define TESTS_BENCH_SCENES_H

#include <stddef.h>

struct document;
struct tape;

struct scene {
	char name[48];
	char *text;
	size_t length;
	struct document *document;
	const struct tape *tape; /* the document's */
	double low[3], high[3];  /* the box of its points */
};

/* Children of one composition: how they are written in a document. */
#define SCENE_SUM "\"type\":\"sum\""
#define SCENE_CAMEL "\"type\":\"union\",\"operator\":\"camel\""

/*
 * count soft objects of type point under one composition, in the box
 * [-1, 1]^3, so sized that whatever the count about four are not 0 at a point.
 * kind: "sum" or "camel".
 */
void scene_points(struct scene *s, const char *kind, int count);

/* A balanced binary tree of count primitives of eleven types, composed in
 * eight ways. */
void scene_mixed(struct scene *s, int count);

/* Three segments under camel: the letter A. */
void scene_letter(struct scene *s);

/* The document in the file at path. */
void scene_file(struct scene *s, const char *path);

void scene_fini(struct scene *s);

/* Orders of a batch's points. */
enum scene_order {
	SCENE_GRID,     /* a grid, x fastest */
	SCENE_SHUFFLED, /* the same points in any order */
	SCENE_RANDOM    /* uniform in the box */
};

/* "coherent", "random", "random" */
const char *scene_order_name(enum scene_order order);

/* count points, xyz. */
void scene_place(const struct scene *s, enum scene_order order, size_t count,
    float *xyz);

#endif
