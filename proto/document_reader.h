/*
 * How documents are read: tables of fields, one table an object's type, and
 * functions that read one field's value each. Internal to document*.c and
 * import*.c; order.c and opening_request.c read their bodies by it.
 */
#ifndef PROTO_DOCUMENT_READER_H
#define PROTO_DOCUMENT_READER_H

#include <stdbool.h>
#include <stddef.h>

#include "core/operator.h"
#include "core/tree.h"
#include "proto/arena.h"
#include "proto/document.h"
#include "proto/json.h"

/* A node, and what reading it must remember. The node comes first. */
struct item {
	struct node node;
	const char *ref;   /* REF: the id it names */
	struct item *next; /* of those with an id or a ref, in their order */
	/* Members that are read after the others; NULL: missing. */
	const struct cJSON *children, *child, *elements, *operator;
	const struct cJSON *translation, *rotation, *scale, *matrix;
};

/* A volume that the document holds. */
struct volume_list {
	struct volume_list *next;
	struct volume *volume;
};

/* What a composition's "operator" says: one of the three. */
struct chosen {
	bool sharp;
	const struct operator *op;
	const struct classic *classic;
};

struct named_operator {
	const char *name;
	struct chosen chosen;
};

enum built_in {
	BUILT_IN_SHARP,
	BUILT_IN_CLEAN,
	BUILT_IN_BLEND,
	BUILT_IN_CAMEL,
	BUILT_IN_ORGANIC,
	BUILT_IN_CONTACT,
	BUILT_IN_COUNT
};

/* One document being read. */
struct reader {
	struct arena *arena;
	const struct document_limits *limits;
	struct faults *faults;
	/* ERR_MEMORY and ERR_LIMIT end reading at once, ERR_INVALID does not. */
	enum err err;
	size_t depth;
	bool skipped; /* a node of a wrong type, with all below it */
	size_t item_count;
	struct volume_list *volumes; /* held for the document */
	struct item *first, **tail; /* of named_count with an id or a ref */
	size_t named_count;
	struct named_operator *operators; /* by name */
	size_t operator_count;
	/* Made when first used; the sharp one stays NULL. */
	const struct operator *built_in[BUILT_IN_COUNT];
};

/* Whether reading goes on. */
static inline bool reader_goes_on(const struct reader *r)
{
	return r->err == ERR_OK || r->err == ERR_INVALID;
}

/* Records a fault: ERR_INVALID, if nothing worse happened. */
void reader_fault(struct reader *r, const struct json_place *at,
    const char *detail, ...) __attribute__((format(printf, 3, 4)));

/* The same for ERR_LIMIT, which ends reading. */
void reader_limit(struct reader *r, const struct json_place *at,
    const char *detail, ...) __attribute__((format(printf, 3, 4)));

/* Takes memory from the reader's arena; NULL ends reading with ERR_MEMORY. */
void *reader_alloc(struct reader *r, size_t count, size_t size);

/* One member that an object may have. */
struct field {
	const char *name;
	/* Reads the value into base + offset; NULL: it is read elsewhere. */
	void (*read)(struct reader *r, const struct json_place *at,
	    const struct cJSON *value, const struct field *field, void *base);
	size_t offset;
	bool required;
	bool has_fallback;
	double least, most; /* of each number */
	double fallback;    /* of a number that is missing */
};

struct field_set {
	const struct field *fields;
	size_t count;
};

#define FIELD_SET(table) {(table), sizeof(table) / sizeof *(table)}

/* An object whose "type" says which fields it has. */
struct variant {
	const char *name;
	struct field_set fields;
	int tag;                  /* what the user of the table makes of it */
	/* Checks what no single field can; may be NULL. seen: bit i is field i. */
	void (*check)(struct reader *r, const struct json_place *at,
	    const struct cJSON *object, unsigned seen, void *base);
};

/*
 * Reads object's members by the given sets, one after the other; unknown,
 * repeated and missing ones are faults. Returns which fields of the first set
 * were there, as bits.
 */
unsigned field_read_object(struct reader *r, const struct json_place *at,
    const struct cJSON *object, const struct field_set *sets,
    size_t set_count, void *base);

/* The variant that object's "type" names, or NULL and a fault. what: "node"
 * or the like, for the sentence. */
const struct variant *field_variant(struct reader *r,
    const struct json_place *at, const struct cJSON *object,
    const struct variant *variants, size_t count, const char *what);

/* Whether value is an array of count numbers, each in least..most; else a
 * fault. */
bool field_numbers(struct reader *r, const struct json_place *at,
    const struct cJSON *value, size_t count, double least, double most,
    double *out);

/* Whether value is a number in least..most; else a fault. */
bool field_is_number(struct reader *r, const struct json_place *at,
    const struct cJSON *value, double least, double most);

/* Whether text may be an id. */
bool field_is_id(const char *text);

/* For struct field.read: what each expects and writes. */
/* anything: const struct cJSON *, to be read later */
void field_keep(struct reader *r, const struct json_place *at,
    const struct cJSON *value, const struct field *field, void *base);
/* a number: double */
void field_number(struct reader *r, const struct json_place *at,
    const struct cJSON *value, const struct field *field, void *base);
/* two numbers: double[2] */
void field_pair(struct reader *r, const struct json_place *at,
    const struct cJSON *value, const struct field *field, void *base);
/* three numbers: struct vec3 */
void field_vec3(struct reader *r, const struct json_place *at,
    const struct cJSON *value, const struct field *field, void *base);
/* three numbers, not all 0: struct vec3 of length 1 */
void field_direction(struct reader *r, const struct json_place *at,
    const struct cJSON *value, const struct field *field, void *base);
/* an id: const char *, in the arena */
void field_id(struct reader *r, const struct json_place *at,
    const struct cJSON *value, const struct field *field, void *base);

/*
 * document_operator.c: the value of a composition's "operator" (NULL if it has
 * none), in the arena, where one name has one struct. node: the composition's
 * type. False after a fault, where *out may have none of the three. And the
 * document's "operators" into the reader.
 */
bool operator_read(struct reader *r, const struct json_place *at,
    const struct cJSON *value, enum node_type node, struct chosen *out);
void operator_read_all(struct reader *r, const struct json_place *at,
    const struct cJSON *value);

/* document_transform.c: item's "translation", "rotation", "scale" and
 * "matrix" into its node. */
void transform_read(struct reader *r, const struct json_place *at,
    struct item *item);

/* document_node.c: a node and all below it, or NULL. */
struct node *node_read(struct reader *r, const struct json_place *at,
    const struct cJSON *value, const struct node *parent, size_t index);

/* document_convolution.c: item's "elements" into its children. */
void convolution_read(struct reader *r, const struct json_place *at,
    const struct cJSON *object, unsigned seen, void *base);

/* Adds count new nodes to the document, below parent: NULL after a fault, at
 * `at` if they are too many. */
struct item *reader_add_items(struct reader *r, const struct json_place *at,
    const struct node *parent, size_t count);

/* document_ref.c: finds what refs mean. root: the root node's place. */
void ref_resolve(struct reader *r, const struct json_place *root);

/* Records a fault at a node, or at its member if that is not NULL. */
void ref_fault(struct reader *r, const struct json_place *root,
    const struct node *node, const char *member, const char *detail);

#endif
