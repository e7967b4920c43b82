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
#define TAPER_MIN 1e-3
#define TAPER_MAX 1e3
#define TURN 6.283185307179586
/* As of an opening's angles: 6.2832 means a full turn. */
#define ANGLE_SLACK 1e-3
/* Sine of the least angle between a bend's axis and its direction. */
#define PARALLEL 1e-3

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

#define COLOR \
	{.name = "color", .read = field_vec3, .offset = AT(color), \
	    .required = true, .most = 1.0}

static const struct field material_fields[] = {
	COLOR,
};

static void read_material(struct reader *r, const struct json_place *at,
    const struct cJSON *value, const struct field *field, void *base)
{
	static const struct field_set set = FIELD_SET(material_fields);
	struct item *item = base;

	(void)field;
	if (!cJSON_IsObject(value)) {
		reader_fault(r, at, "must be an object, not %s",
		    json_kind(value));
		return;
	}
	item->node.has_color = true;
	field_read_object(r, at, value, &set, 1, item);
}

static const struct field common_fields[] = {
	{.name = "type"},
	{.name = "material", .read = read_material},
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

static void read_kernel(struct reader *r, const struct json_place *at,
    const struct cJSON *value, const struct field *field, void *base)
{
	(void)field;
	(void)base;
	if (!cJSON_IsString(value) ||
	    !text_equal(value->valuestring, "cauchy"))
		reader_fault(r, at, "must be \"cauchy\"");
}

/* The volume of that id, which the document holds from now on. */
static void read_volume(struct reader *r, const struct json_place *at,
    const struct cJSON *value, const struct field *field, void *base)
{
	struct volume_list *entry;
	struct item *item = base;
	struct volume *volume = NULL;

	(void)field;
	if (!cJSON_IsString(value)) {
		reader_fault(r, at, "must be a string, not %s",
		    json_kind(value));
		return;
	}
	entry = reader_alloc(r, 1, sizeof *entry);
	if (!entry)
		return;
	if (r->limits->volume)
		volume = r->limits->volume(r->limits->volume_ctx,
		    value->valuestring);
	if (!volume) {
		reader_fault(r, at, "there is no volume '%.64s'",
		    value->valuestring);
		return;
	}
	*entry = (struct volume_list){r->volumes, volume};
	r->volumes = entry;
	item->node.primitive.volume = volume;
}

static const struct field volume_fields[] = {
	{.name = "volume", .read = read_volume, .required = true},
	{.name = "falloff", .read = field_number,
	    .offset = AT(primitive.falloff), LENGTHS},
};

static const struct field convolution_fields[] = {
	{.name = "s", .read = field_number, .offset = AT(primitive.s),
	    LENGTHS},
	{.name = "kernel", .read = read_kernel},
	RADIUS,
	{.name = "elements", .read = field_keep,
	    .offset = offsetof(struct item, elements), .required = true},
};

#define CHILD \
	{.name = "child", .read = field_keep, \
	    .offset = offsetof(struct item, child), .required = true}
#define WARP_AXIS \
	{.name = "axis", .read = field_direction, .offset = AT(warp.axis), \
	    .required = true, COORDINATES}, \
	{.name = "center", .read = field_vec3, .offset = AT(warp.center), \
	    COORDINATES}
#define WARP_RATE \
	{.name = "rate", .read = field_number, .offset = AT(warp.rate), \
	    .required = true, COORDINATES}
#define WARP_RANGE(required_) \
	{.name = "from", .read = field_number, .offset = AT(warp.from), \
	    .required = required_, COORDINATES}, \
	{.name = "to", .read = field_number, .offset = AT(warp.to), \
	    .required = required_, COORDINATES}

/* The first two are told apart by their bits in check_twist. */
static const struct field twist_fields[] = {
	WARP_RANGE(false), WARP_AXIS, WARP_RATE, CHILD,
};

static const struct field taper_fields[] = {
	WARP_RANGE(true), WARP_AXIS,
	/* Not "scale", which every node has. */
	{.name = "factor", .read = field_number, .offset = AT(warp.scale),
	    .required = true, .least = TAPER_MIN, .most = TAPER_MAX},
	CHILD,
};

static const struct field bend_fields[] = {
	WARP_RANGE(true), WARP_AXIS, WARP_RATE,
	{.name = "direction", .read = field_direction,
	    .offset = AT(warp.direction), .required = true, COORDINATES},
	CHILD,
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

static void read_child(struct reader *r, const struct json_place *at,
    struct item *item)
{
	const struct json_place place = json_member(at, "child");
	struct node *node = &item->node;

	if (!item->child)
		return;
	node->children = reader_alloc(r, 1, sizeof *node->children);
	if (!node->children)
		return;
	node->child_count = 1;
	node->children[0] = node_read(r, &place, item->child, node, 0);
}

/* from < to, if they were there. */
static void check_range(struct reader *r, const struct json_place *at,
    unsigned seen, struct warp *w)
{
	const struct json_place place = json_member(at, "to");

	w->has_range = (seen & 3) == 3;
	if (w->has_range && !(w->to - w->from >= TREE_LENGTH_MIN))
		reader_fault(r, &place, "must exceed 'from' by at least %g",
		    TREE_LENGTH_MIN);
}

static void check_twist(struct reader *r, const struct json_place *at,
    const struct cJSON *object, unsigned seen, void *base)
{
	struct item *item = base;

	(void)object;
	item->node.warp.type = WARP_TWIST;
	if ((seen & 3) == 1 || (seen & 3) == 2)
		reader_fault(r, at, "needs both 'from' and 'to', or neither");
	check_range(r, at, seen, &item->node.warp);
	read_child(r, at, item);
}

static void check_taper(struct reader *r, const struct json_place *at,
    const struct cJSON *object, unsigned seen, void *base)
{
	struct item *item = base;

	(void)object;
	item->node.warp.type = WARP_TAPER;
	check_range(r, at, seen, &item->node.warp);
	read_child(r, at, item);
}

static void check_bend(struct reader *r, const struct json_place *at,
    const struct cJSON *object, unsigned seen, void *base)
{
	const struct json_place rate = json_member(at, "rate");
	const struct json_place direction = json_member(at, "direction");
	struct item *item = base;
	struct warp *w = &item->node.warp;
	const double angle = w->rate * (w->to - w->from);

	(void)object;
	w->type = WARP_BEND;
	check_range(r, at, seen, w);
	if (!(fabs(angle) <= TURN + ANGLE_SLACK))
		reader_fault(r, &rate, "bends by %.6g radians from 'from' to "
		    "'to', more than a full turn", angle);
	if (vec3_norm(w->direction) > 0.0 && vec3_norm(w->axis) > 0.0 &&
	    vec3_norm(vec3_cross(w->direction, w->axis)) < PARALLEL)
		reader_fault(r, &direction, "must not be parallel to 'axis'");
	read_child(r, at, item);
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
	struct chosen chosen;

	operator_read(r, &place, item->operator, item->node.type, &chosen);
	item->node.sharp = chosen.sharp;
	item->node.op = chosen.op;
	item->node.classic = chosen.classic;
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
	PRIMITIVE("volume", volume_fields, PRIMITIVE_VOLUME, .check = NULL),
	OTHER("union", blend_fields, NODE_UNION, .check = read_blend),
	OTHER("intersection", blend_fields, NODE_INTERSECTION,
	    .check = read_blend),
	OTHER("difference", blend_fields, NODE_DIFFERENCE,
	    .check = read_blend),
	OTHER("sum", sum_fields, NODE_SUM, .check = read_children),
	OTHER("ricci", ricci_fields, NODE_RICCI, .check = read_children),
	OTHER("convolution", convolution_fields, NODE_CONVOLUTION,
	    .check = convolution_read),
	OTHER("twist", twist_fields, NODE_WARP, .check = check_twist),
	OTHER("taper", taper_fields, NODE_WARP, .check = check_taper),
	OTHER("bend", bend_fields, NODE_WARP, .check = check_bend),
	OTHER("ref", ref_fields, NODE_REF, .check = NULL),
};

#define NODE_VARIANTS (sizeof nodes / sizeof *nodes)

struct item *reader_add_items(struct reader *r, const struct json_place *at,
    const struct node *parent, size_t count)
{
	struct item *items;

	if (count > r->limits->max_nodes - r->item_count) {
		reader_limit(r, at, "more than %zu nodes",
		    r->limits->max_nodes);
		return NULL;
	}
	items = reader_alloc(r, count, sizeof *items);
	if (!items)
		return NULL;
	r->item_count += count;
	for (size_t i = 0; i < count; i++) {
		items[i].node.type = NODE_PRIMITIVE;
		items[i].node.parent = parent;
		items[i].node.index = i;
	}
	return items;
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
	const struct variant *variant = field_variant(r, at, value, nodes,
	    NODE_VARIANTS, "node");
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
	item = reader_add_items(r, at, parent, 1);
	if (!item)
		return NULL;
	item->node.index = index;
	r->depth++;
	read_fields(r, at, value, variant, item);
	r->depth--;
	return &item->node;
}
