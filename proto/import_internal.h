/*
 * How documents of three-js-blobtree are read. Internal to import*.c.
 */
#ifndef PROTO_IMPORT_INTERNAL_H
#define PROTO_IMPORT_INTERNAL_H

#include <stddef.h>

#include "proto/document_reader.h"
#include "proto/import.h"

/* Vertices of a primitive, at most. */
#define IMPORT_VERTICES_MAX 3

/* Text that grows. */
struct import_text {
	char *bytes; /* malloc'd; NULL while there are none */
	size_t length, size;
	bool failed; /* out of memory: bytes are of no use */
};

void import_put(struct import_text *text, const char *string);
/* The same for length bytes. */
void import_put_bytes(struct import_text *text, const char *bytes,
    size_t length);
/* The shortest of 15 to 17 digits that reads back as number, finite. */
void import_put_number(struct import_text *text, double number);
/* [x,y,z] */
void import_put_vec3(struct import_text *text, struct vec3 v);

/*
 * The library's bounding boxes, computed as it does, since it scales and
 * twists about their middles. Empty where max < min.
 */
struct import_box {
	struct vec3 min, max;
};

struct import_box import_box_empty(void);
struct import_box import_box_about(struct vec3 p, double reach);
void import_box_add(struct import_box *box, const struct import_box *other);

/* A document being imported. */
struct importing {
	struct reader r;
	struct import_text text;
	struct faults *warnings;
};

/*
 * A node of the library's being read: what its fields say, by their names in
 * the JSON. A node's function (struct variant.check) writes what it becomes to
 * m's text, with factor times the library's field, and its box to box.
 */
struct import_node {
	struct importing *m;
	double factor;
	struct import_box box;
	const struct cJSON *children, *v, *vol_type, *materials, *f, *sdf_root;
	double ricci_n, iso, alpha, density, amount;
	struct vec3 scale, axis;
};

/* import.c: says at a place what the import does with it. */
void import_warn(struct importing *m, const struct json_place *at,
    const char *detail, ...) __attribute__((format(printf, 3, 4)));

/* import.c: whether value is an array of count elements (`what`); else a
 * fault. */
bool import_is_array(struct reader *r, const struct json_place *at,
    const struct cJSON *value, int count, const char *what);

/* import_material.c: ,"material":{...} from count materials, those of a
 * primitive's vertices, at `at`; may be NULL: the library's default. */
void import_material(struct importing *m, const struct json_place *at,
    const struct cJSON *materials, int count);

/* import_primitive.c: struct variant.check of ... */
void import_scalis_point(struct reader *r, const struct json_place *at,
    const struct cJSON *object, unsigned seen, void *base);
void import_scalis_segment(struct reader *r, const struct json_place *at,
    const struct cJSON *object, unsigned seen, void *base);
void import_scalis_triangle(struct reader *r, const struct json_place *at,
    const struct cJSON *object, unsigned seen, void *base);
void import_sdf_root(struct reader *r, const struct json_place *at,
    const struct cJSON *object, unsigned seen, void *base);

#endif
