/*
 * Nodes: which fields each type has, and what they may hold (SPEC section 2).
 * document.schema.json says the same.
 */
#include <math.h>

#include <cjson/cJSON.h>

#include "proto/document_reader.h"
#include "proto/text.h"

#define EXPONENT_DEFAULT 3.0
#define RICCI_MAX 1000.0

#define AT(member) offsetof(struct item, node.member)
#define COORDINATES .least = -TREE_COORDINATE_MAX, .most = TREE_COORDINATE_MAX
#define LENGTHS .least = TREE_LENGTH_MIN, .most = TREE_LENGTH_MAX

#define KEPT(name_, member) \
	{.name = name_, .read = field_keep, .offset = offsetof(struct item, member)}
#define CHILDREN \
	{.name = "children", .read = field_keep, \
	    .offset = offsetof(struct item, children), .required = true}
#define POSITION(name_, member) \
	{.name = name_, .read = field_vec3, .offset = AT(primitive.member), \
	    .required = true, COORDINATES}
#define DIRECTION(name_) \
	{.name = name_, .read = field_direction, \
	    .offset = AT(primitive.normal), .required = true, COORDINATES}
#define LENGTH(name_, member) \
	{.name = name_, .read = field_number, .offset = AT(primitive.member), \
	    .required = true, LENGTHS}
#define RADIUS LENGTH("radius", radius[0])
#define FALLOFF LENGTH("falloff", falloff)
#define SOFT \
	{.name = "exponent", .read = field_number, \
	    .offset = AT(primitive.exponent), .least = 3.0, .most = 100.0, \
	    .has_fallback = true, .fallback = EXPONENT_DEFAULT}, \
	{.name = "weight", .read = field_number, \
	    .offset = AT(primitive.weight), .most = 1e6, \
	    .has_fallback = true, .fallback = 1.0}

static const struct field common_fields[] = {
	{.name = "type"},
	{.name = "id", .read = field_id, .offset = AT(id)},
	KEPT("translation", translation), KEPT("rotation", rotation),
	KEPT("scale", scale), KEPT("matrix", matrix),
};

static const struct field point_fields[] = {
	POSITION("center", a), RADIUS, SOFT,
};

/* The first two are told apart by their bits in check_segment. */
static const struct field segment_fields[] = {
	{.name = "radius", .read = field_number,
	    .offset = AT(primitive.radius[0]), LENGTHS},
	{.name = "radii", .read = field_pair,
	    .offset = AT(primitive.radius), LENGTHS},
	POSITION("a", a), POSITION("b", b), SOFT,
};

static const struct field triangle_fields[] = {
	POSITION("a", a), POSITION("b", b), POSITION("c", c), RADIUS, SOFT,
};

static const struct field disc_fields[] = {
	POSITION("center", a), DIRECTION("normal"),
	LENGTH("disc_radius", major), RADIUS, SOFT,
};

static const struct field circle_fields[] = {
	POSITION("center", a), DIRECTION("normal"),
	LENGTH("ring_radius", major), RADIUS, SOFT,
};

static const struct field sphere_fields[] = {
	POSITION("center", a), RADIUS, FALLOFF,
};

static const struct field box_fields[] = {
	POSITION("center", a),
	{.name = "half_size", .read = field_vec3,
	    .offset = AT(primitive.half_size), .required = true, LENGTHS},
	{.name = "rounding", .read = field_number,
	    .offset = AT(primitive.rounding), .most = TREE_LENGTH_MAX},
	FALLOFF,
};

static const struct field rod_fields[] = {
	POSITION("a", a), POSITION("b", b), RADIUS, FALLOFF,
};

/* One end of a cone may be its apex. */
static void read_cone_radii(struct reader *r, const struct json_place *at,
    const struct cJSON *value, const struct field *field, void *base)
{
	double radii[2], *out = (double *)((char *)base + field->offset);
	struct json_place place = json_element(at, 0);

	if (!field_numbers(r, at, value, 2, field->least, field->most, radii))
		return;
	if (radii[0] == 0.0 && radii[1] == 0.0) {
		reader_fault(r, at, "must not both be 0");
		return;
	}
	for (; place.index < 2; place.index++) {
		out[place.index] = radii[place.index];
		if (radii[place.index] > 0.0 &&
		    radii[place.index] < TREE_LENGTH_MIN)
			reader_fault(r, &place, "must be 0 or at least %g",
			    TREE_LENGTH_MIN);
	}
}

static const struct field cone_fields[] = {
	POSITION("a", a), POSITION("b", b),
	{.name = "radii", .read = read_cone_radii,
	    .offset = AT(primitive.radius), .required = true,
	    .most = TREE_LENGTH_MAX},
	FALLOFF,
};

static const struct field torus_fields[] = {
	POSITION("center", a), DIRECTION("axis"), LENGTH("major", major),
	LENGTH("minor", minor), FALLOFF,
};

static const struct field plane_fields[] = {
	POSITION("point", a), DIRECTION("normal"), FALLOFF,
};

static const struct field blend_fields[] = {
	CHILDREN,
	KEPT("operator", operator),
};

static const struct field sum_fields[] = {
	CHILDREN,
};

static const struct field ricci_fields[] = {
	CHILDREN,
	{.name = "n", .read = field_number, .offset = AT(n), .required = true,
	    .least = 1.0, .most = RICCI_MAX},
};

static const struct field ref_fields[] = {
	{.name = "ref", .read = field_id, .offset = offsetof(struct item, ref),
	    .required = true},
};

static void check_segment(struct reader *r, const struct json_place *at,
    const struct cJSON *object, unsigned seen, void *base)
{
	struct item *item = base;

	(void)object;
	switch (seen & 3) {
	case 0:
		reader_fault(r, at, "needs 'radius' or 'radii'");
		break;
	case 1:
		item->node.primitive.radius[1] = item->node.primitive.radius[0];
		break;
	case 3:
		reader_fault(r, at, "has both 'radius' and 'radii'");
		break;
	}
}

static void check_box(struct reader *r, const struct json_place *at,
    const struct cJSON *object, unsigned seen, void *base)
{
	const struct json_place place = json_member(at, "rounding");
	const struct primitive *p = &((struct item *)base)->node.primitive;
	const double most = fmin(p->half_size.x,
	    fmin(p->half_size.y, p->half_size.z));

	(void)object;
	(void)seen;
	if (most > 0.0 && p->rounding > most)
		reader_fault(r, &place, "must not exceed the least half_size, "
		    "%.10g", most);
}

static void read_children(struct reader *r, const struct json_place *at,
    const struct cJSON *object, unsigned seen, void *base)
{
	const struct json_place place = json_member(at, "children");
	struct json_place child = json_element(&place, 0);
	const cJSON *value = ((struct item *)base)->children, *element;
	struct node *node = &((struct item *)base)->node;
	size_t count;

	(void)object;
	(void)seen;
	if (!value)
		return;
	if (!cJSON_IsArray(value) || !value->child) {
		reader_fault(r, &place, "must be an array of 1 or more nodes");
		return;
	}
	count = (size_t)cJSON_GetArraySize(value);
	if (count > r->limits->max_nodes - r->item_count) {
		reader_limit(r, &place, "more than %zu nodes",
		    r->limits->max_nodes);
		return;
	}
	node->children = reader_alloc(r, count, sizeof *node->children);
	if (!node->children)
		return;
	node->child_count = count;
	cJSON_ArrayForEach(element, value) {
		node->children[child.index] = node_read(r, &child, element,
		    node, child.index);
		child.index++;
		if (!reader_goes_on(r))
			return;
	}
}

static void read_blend(struct reader *r, const struct json_place *at,
    const struct cJSON *object, unsigned seen, void *base)
{
	const struct json_place place = json_member(at, "operator");
	struct item *item = base;

	item->node.op = operator_read(r, &place, item->operator);
	item->node.sharp = !item->node.op;
	read_children(r, at, object, seen, base);
}

/* A primitive's tag is its enum primitive_type, another's what COMPOSITE adds
 * to its enum node_type. */
#define COMPOSITE 100

#define PRIMITIVE(name_, table, type, ...) \
	{.name = name_, .fields = FIELD_SET(table), .tag = type, __VA_ARGS__}
#define OTHER(name_, table, type, ...) \
	{.name = name_, .fields = FIELD_SET(table), \
	    .tag = COMPOSITE + type, __VA_ARGS__}

static const struct variant nodes[] = {
	PRIMITIVE("point", point_fields, PRIMITIVE_POINT, .check = NULL),
	PRIMITIVE("segment", segment_fields, PRIMITIVE_SEGMENT,
	    .check = check_segment),
	PRIMITIVE("triangle", triangle_fields, PRIMITIVE_TRIANGLE,
	    .check = NULL),
	PRIMITIVE("disc", disc_fields, PRIMITIVE_DISC, .check = NULL),
	PRIMITIVE("circle", circle_fields, PRIMITIVE_CIRCLE, .check = NULL),
	PRIMITIVE("sphere", sphere_fields, PRIMITIVE_SPHERE, .check = NULL),
	PRIMITIVE("box", box_fields, PRIMITIVE_BOX, .check = check_box),
	PRIMITIVE("cylinder", rod_fields, PRIMITIVE_CYLINDER, .check = NULL),
	PRIMITIVE("capsule", rod_fields, PRIMITIVE_CAPSULE, .check = NULL),
	PRIMITIVE("cone", cone_fields, PRIMITIVE_CONE, .check = NULL),
	PRIMITIVE("torus", torus_fields, PRIMITIVE_TORUS, .check = NULL),
	PRIMITIVE("plane", plane_fields, PRIMITIVE_PLANE, .check = NULL),
	OTHER("union", blend_fields, NODE_UNION, .check = read_blend),
	OTHER("intersection", blend_fields, NODE_INTERSECTION,
	    .check = read_blend),
	OTHER("difference", blend_fields, NODE_DIFFERENCE,
	    .check = read_blend),
	OTHER("sum", sum_fields, NODE_SUM, .check = read_children),
	OTHER("ricci", ricci_fields, NODE_RICCI, .check = read_children),
	OTHER("ref", ref_fields, NODE_REF, .check = NULL),
};

#define NODE_VARIANTS (sizeof nodes / sizeof *nodes)

static bool is_to_come(const struct cJSON *type)
{
	static const char *const names[] = {"convolution", "twist", "taper",
	    "bend"};
	size_t i;

	for (i = 0; cJSON_IsString(type) &&
	    i < sizeof names / sizeof *names; i++) {
		if (text_equal(type->valuestring, names[i]))
			return true;
	}
	return false;
}

static const struct variant *node_variant(struct reader *r,
    const struct json_place *at, const struct cJSON *value)
{
	const struct json_place place = json_member(at, "type");
	const cJSON *type = cJSON_GetObjectItemCaseSensitive(value, "type");

	if (!is_to_come(type))
		return field_variant(r, at, value, nodes, NODE_VARIANTS,
		    "node");
	reader_fault(r, &place, "'%s' is not supported yet",
	    type->valuestring);
	return NULL;
}

static struct item *add_item(struct reader *r, const struct json_place *at)
{
	struct item *item;

	if (r->item_count == r->limits->max_nodes) {
		reader_limit(r, at, "more than %zu nodes",
		    r->limits->max_nodes);
		return NULL;
	}
	item = reader_alloc(r, 1, sizeof *item);
	if (!item)
		return NULL;
	r->item_count++;
	return item;
}

/* Before its children, which come after it in the document. */
static void list_if_named(struct reader *r, struct item *item)
{
	if (!item->node.id && !item->ref)
		return;
	*r->tail = item;
	r->tail = &item->next;
	r->named_count++;
}

static void read_fields(struct reader *r, const struct json_place *at,
    const struct cJSON *value, const struct variant *variant,
    struct item *item)
{
	static const struct field_set common = FIELD_SET(common_fields);
	const struct field_set sets[] = {variant->fields, common};
	unsigned seen;

	if (variant->tag < COMPOSITE)
		item->node.primitive.type = (enum primitive_type)variant->tag;
	else
		item->node.type = (enum node_type)(variant->tag - COMPOSITE);
	seen = field_read_object(r, at, value, sets, 2, item);
	if (!reader_goes_on(r))
		return;
	list_if_named(r, item);
	transform_read(r, at, item);
	if (variant->check)
		variant->check(r, at, value, seen, item);
}

struct node *node_read(struct reader *r, const struct json_place *at,
    const struct cJSON *value, const struct node *parent, size_t index)
{
	const struct variant *variant = node_variant(r, at, value);
	struct item *item;

	if (!variant) {
		r->skipped = true;
		return NULL;
	}
	if (r->depth == DOCUMENT_DEPTH_MAX) {
		reader_limit(r, at, "nodes nest more than %d deep",
		    DOCUMENT_DEPTH_MAX);
		return NULL;
	}
	item = add_item(r, at);
	if (!item)
		return NULL;
	item->node.type = NODE_PRIMITIVE;
	item->node.parent = parent;
	item->node.index = index;
	r->depth++;
	read_fields(r, at, value, variant, item);
	r->depth--;
	return &item->node;
}
