/*
 * The elements of convolution surfaces: each is a primitive of its own below
 * the convolution's node.
 */
#include <cjson/cJSON.h>

#include "core/convolution.h"
#include "proto/document_reader.h"

#define WEIGHT_MAX 1e6
/* What s times the radius may be; cauchy_default_s makes it 0.77. Far outside,
 * the kernel is a spike, or flat, and float32 loses it. */
#define SHARPNESS_MIN 0.01
#define SHARPNESS_MAX 100.0

#define AT(member) offsetof(struct item, node.primitive.member)
#define COORDINATES .least = -TREE_COORDINATE_MAX, .most = TREE_COORDINATE_MAX

/* An array of `corners` positions into a, b, c. */
static bool read_corners(struct reader *r, const struct json_place *at,
    const struct cJSON *value, int corners, struct primitive *p)
{
	struct vec3 *const to[3] = {&p->a, &p->b, &p->c};
	struct json_place place = json_element(at, 0);
	const cJSON *corner;
	double v[3];

	if (!cJSON_IsArray(value) || cJSON_GetArraySize(value) != corners) {
		reader_fault(r, at, "must be an array of %d positions",
		    corners);
		return false;
	}
	cJSON_ArrayForEach(corner, value) {
		if (field_numbers(r, &place, corner, 3, -TREE_COORDINATE_MAX,
		    TREE_COORDINATE_MAX, v))
			*to[place.index] = vec3(v[0], v[1], v[2]);
		place.index++;
	}
	return true;
}

static void read_segment(struct reader *r, const struct json_place *at,
    const struct cJSON *value, const struct field *field, void *base)
{
	(void)field;
	read_corners(r, at, value, 2, &((struct item *)base)->node.primitive);
}

static void read_triangle(struct reader *r, const struct json_place *at,
    const struct cJSON *value, const struct field *field, void *base)
{
	(void)field;
	read_corners(r, at, value, 3, &((struct item *)base)->node.primitive);
}

/* The first three are told apart by their bits in read_element. */
static const struct field element_fields[] = {
	{.name = "point", .read = field_vec3, .offset = AT(a), COORDINATES},
	{.name = "segment", .read = read_segment},
	{.name = "triangle", .read = read_triangle},
	{.name = "weight", .read = field_number, .offset = AT(weight),
	    .most = WEIGHT_MAX, .has_fallback = true, .fallback = 1.0},
};

static void read_element(struct reader *r, const struct json_place *at,
    const struct cJSON *value, const struct primitive *whole,
    struct item *item)
{
	static const struct field_set set = FIELD_SET(element_fields);
	static const enum primitive_type types[] = {
		[1] = PRIMITIVE_CAUCHY_POINT,
		[2] = PRIMITIVE_CAUCHY_SEGMENT,
		[4] = PRIMITIVE_CAUCHY_TRIANGLE,
	};
	unsigned which;

	if (!cJSON_IsObject(value)) {
		reader_fault(r, at, "an element must be an object, not %s",
		    json_kind(value));
		return;
	}
	item->node.primitive.s = whole->s;
	item->node.primitive.radius[0] = whole->radius[0];
	which = field_read_object(r, at, value, &set, 1, item) & 7;
	if (which == 1 || which == 2 || which == 4)
		item->node.primitive.type = types[which];
	else
		reader_fault(r, at, "needs one of 'point', 'segment' and "
		    "'triangle'");
}

static void read_elements(struct reader *r, const struct json_place *at,
    const struct cJSON *value, struct node *node)
{
	const size_t count = (size_t)cJSON_GetArraySize(value);
	struct json_place place = json_element(at, 0);
	struct item *items = reader_add_items(r, at, node, count);
	const cJSON *element;

	if (!items)
		return;
	node->children = reader_alloc(r, count, sizeof *node->children);
	if (!node->children)
		return;
	node->child_count = count;
	cJSON_ArrayForEach(element, value) {
		struct item *item = items + place.index;

		node->children[place.index] = &item->node;
		read_element(r, &place, element, &node->primitive, item);
		place.index++;
		if (!reader_goes_on(r))
			return;
	}
}

void convolution_read(struct reader *r, const struct json_place *at,
    const struct cJSON *object, unsigned seen, void *base)
{
	const struct json_place elements = json_member(at, "elements");
	const struct json_place s = json_member(at, "s");
	struct item *item = base;
	struct primitive *p = &item->node.primitive;
	double sharpness;

	(void)object;
	if (!(seen & 1) && p->radius[0] > 0.0)
		p->s = cauchy_default_s(p->radius[0]);
	sharpness = p->s * p->radius[0];
	if (sharpness > 0.0 &&
	    (sharpness < SHARPNESS_MIN || sharpness > SHARPNESS_MAX))
		reader_fault(r, &s, "times the radius must be between %g and "
		    "%g, not %.6g", SHARPNESS_MIN, SHARPNESS_MAX, sharpness);
	if (!item->elements)
		return;
	if (!cJSON_IsArray(item->elements) || !item->elements->child)
		reader_fault(r, &elements,
		    "must be an array of 1 or more elements");
	else
		read_elements(r, &elements, item->elements, &item->node);
}
