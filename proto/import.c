/*
 * three-js-blobtree's nodes (its src/blobtree) and what becomes of them: each
 * is one node of the document, so that both are equally deep.
 */
#include "proto/import.h"

#include <math.h>
#include <stdarg.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include <cjson/cJSON.h>

#include "proto/fault.h"
#include "proto/import_internal.h"

#define ISO 0.5 /* ours */
#define ROOT_RICCI 64.0
#define ROOT_ISO 1.0
/* What documents may have. */
#define RICCI_MAX 1000.0
#define ALPHA_MIN 1.0
#define ALPHA_MAX 100.0
/* The library takes an axis within this angle of Y for Y. */
#define TWIST_ANGLE_MIN 0.0001
/* An axis this far from a unit vector is worth a word. */
#define AXIS_SLACK 1e-6

#define AT(member) offsetof(struct import_node, member)
#define COORDINATES .least = -TREE_COORDINATE_MAX, .most = TREE_COORDINATE_MAX

static void read_node(struct importing *m, const struct json_place *at,
    const struct cJSON *value, double factor, struct import_box *box);

/* ---- the library's boxes ---- */

struct import_box import_box_empty(void)
{
	return (struct import_box){
		vec3(INFINITY, INFINITY, INFINITY),
		vec3(-INFINITY, -INFINITY, -INFINITY),
	};
}

struct import_box import_box_about(struct vec3 p, double reach)
{
	return (struct import_box){
		vec3(p.x - reach, p.y - reach, p.z - reach),
		vec3(p.x + reach, p.y + reach, p.z + reach),
	};
}

void import_box_add(struct import_box *box, const struct import_box *other)
{
	box->min = vec3(fmin(box->min.x, other->min.x),
	    fmin(box->min.y, other->min.y), fmin(box->min.z, other->min.z));
	box->max = vec3(fmax(box->max.x, other->max.x),
	    fmax(box->max.y, other->max.y), fmax(box->max.z, other->max.z));
}

static bool box_is_empty(const struct import_box *box)
{
	return box->max.x < box->min.x || box->max.y < box->min.y ||
	    box->max.z < box->min.z;
}

static struct vec3 box_middle(const struct import_box *box)
{
	return box_is_empty(box) ? vec3(0.0, 0.0, 0.0) :
	    vec3_scale(0.5, vec3_add(box->min, box->max));
}

/* As ScaleNode does: by (scale - 1) sizes on each side. */
static void box_expand(struct import_box *box, struct vec3 scale)
{
	const struct vec3 size = box_is_empty(box) ? vec3(0.0, 0.0, 0.0) :
	    vec3_sub(box->max, box->min);
	const struct vec3 by = vec3(size.x * (scale.x - 1.0),
	    size.y * (scale.y - 1.0), size.z * (scale.z - 1.0));

	box->min = vec3_sub(box->min, by);
	box->max = vec3_add(box->max, by);
}

/* ---- what all nodes share ---- */

void import_warn(struct importing *m, const struct json_place *at,
    const char *detail, ...)
{
	char sentence[FAULT_DETAIL_MAX + 64];
	va_list ap;

	va_start(ap, detail);
	if (vsnprintf(sentence, sizeof sentence, detail, ap) < 0)
		sentence[0] = '\0';
	va_end(ap);
	json_fault(m->warnings, at, "%s", sentence);
}

bool import_is_array(struct reader *r, const struct json_place *at,
    const struct cJSON *value, int count, const char *what)
{
	if (!cJSON_IsArray(value)) {
		reader_fault(r, at, "must be an array of %d %s, not %s", count,
		    what, json_kind(value));
		return false;
	}
	if (cJSON_GetArraySize(value) != count) {
		reader_fault(r, at, "must have %d %s, not %d", count, what,
		    cJSON_GetArraySize(value));
		return false;
	}
	return true;
}

/* What is 0 everywhere. */
static void put_nothing(struct importing *m)
{
	import_put(&m->text, "{\"type\":\"point\",\"center\":[0,0,0],"
	    "\"radius\":1,\"weight\":0}");
}

/* Whether node has an array for children; else a fault. */
static bool has_children(const struct import_node *node,
    const struct json_place *at)
{
	const struct json_place place = json_member(at, "children");

	if (!node->children)
		return false;
	if (cJSON_IsArray(node->children))
		return true;
	reader_fault(&node->m->r, &place, "must be an array of nodes, not %s",
	    json_kind(node->children));
	return false;
}

/* All children, in brackets; nothing where there are none. */
static void put_children(struct import_node *node, const struct json_place *at)
{
	const struct json_place place = json_member(at, "children");
	struct json_place child = json_element(&place, 0);
	struct import_box box;
	const cJSON *value;

	import_put(&node->m->text, ",\"children\":[");
	if (has_children(node, at) && !node->children->child)
		put_nothing(node->m);
	cJSON_ArrayForEach(value, node->children) {
		if (child.index > 0)
			import_put(&node->m->text, ",");
		read_node(node->m, &child, value, node->factor, &box);
		import_box_add(&node->box, &box);
		child.index++;
		if (!reader_goes_on(&node->m->r))
			return;
	}
	import_put(&node->m->text, "]");
}

/* The last child, which alone counts in nodes that deform. */
static void put_last_child(struct import_node *node,
    const struct json_place *at, const char *name)
{
	const struct json_place place = json_member(at, "children");
	struct json_place child = json_element(&place, 0);
	struct import_text *text = &node->m->text;
	const size_t start = text->length;
	struct import_box box;
	const cJSON *value;

	if (has_children(node, at) && !node->children->child)
		put_nothing(node->m);
	cJSON_ArrayForEach(value, node->children) {
		text->length = start;
		read_node(node->m, &child, value, node->factor, &box);
		import_box_add(&node->box, &box);
		child.index++;
		if (!reader_goes_on(&node->m->r))
			return;
	}
	if (child.index > 1)
		import_warn(node->m, &place, "%s: only the last of its %zu "
		    "children is there, as in the library's evaluation", name,
		    child.index);
}

/* ---- nodes ---- */

static void put_ricci(struct import_node *node, const struct json_place *at)
{
	import_put(&node->m->text, "{\"type\":\"ricci\",\"n\":");
	import_put_number(&node->m->text, node->ricci_n);
	put_children(node, at);
	import_put(&node->m->text, "}");
}

static void import_ricci(struct reader *r, const struct json_place *at,
    const struct cJSON *object, unsigned seen, void *base)
{
	(void)r;
	(void)object;
	(void)seen;
	put_ricci(base, at);
}

/* The library writes iso and ricci_n, but reads neither. */
static void warn_unread(struct importing *m, const struct json_place *at,
    const char *name, double value, double fixed)
{
	const struct json_place place = json_member(at, name);

	if (value != fixed)
		import_warn(m, &place, "taken as it is written; the library, "
		    "reading this, would have %g", fixed);
}

static void import_root(struct reader *r, const struct json_place *at,
    const struct cJSON *object, unsigned seen, void *base)
{
	struct import_node *node = base;

	(void)object;
	(void)seen;
	if (r->depth > 1) {
		reader_fault(r, at, "a RootNode can only be the root");
		return;
	}
	warn_unread(node->m, at, "iso", node->iso, ROOT_ISO);
	warn_unread(node->m, at, "ricci_n", node->ricci_n, ROOT_RICCI);
	node->factor = ISO / node->iso;
	put_ricci(node, at);
}

static void import_min(struct reader *r, const struct json_place *at,
    const struct cJSON *object, unsigned seen, void *base)
{
	struct import_node *node = base;

	(void)r;
	(void)object;
	(void)seen;
	import_put(&node->m->text,
	    "{\"type\":\"intersection\",\"operator\":\"sharp\"");
	put_children(node, at);
	import_put(&node->m->text, "}");
}

static void import_max(struct reader *r, const struct json_place *at,
    const struct cJSON *object, unsigned seen, void *base)
{
	struct import_node *node = base;

	(void)r;
	(void)object;
	(void)seen;
	import_warn(node->m, at, "MaxNode: the maximum, as documented; the "
	    "library's own evaluation of it begins at the greatest number and "
	    "stays there");
	import_put(&node->m->text,
	    "{\"type\":\"union\",\"operator\":\"sharp\"");
	put_children(node, at);
	import_put(&node->m->text, "}");
}

/*
 * f0 - f1^alpha, 0 if negative; DifferenceNode calls itself "Node". Ours is
 * F0 - (2 F1)^alpha / 2, so with F0 = factor f0 it is factor times theirs if
 * 2 F1 = (2 factor)^(1/alpha) f1.
 */
static void import_difference(struct reader *r, const struct json_place *at,
    const struct cJSON *object, unsigned seen, void *base)
{
	const struct json_place place = json_member(at, "children");
	const struct json_place first = json_element(&place, 0);
	const struct json_place second = json_element(&place, 1);
	struct import_node *node = base;
	struct import_text *text = &node->m->text;
	struct import_box box;

	(void)object;
	(void)seen;
	if (!node->children ||
	    !import_is_array(r, &place, node->children, 2, "nodes"))
		return;
	if (node->alpha == 0.0)
		node->alpha = 1.0;
	import_put(text, "{\"type\":\"difference\",\"operator\":"
	    "{\"type\":\"power-difference\",\"alpha\":");
	import_put_number(text, node->alpha);
	import_put(text, "},\"children\":[");
	read_node(node->m, &first, node->children->child, node->factor,
	    &node->box);
	if (!reader_goes_on(r))
		return;
	import_put(text, ",");
	read_node(node->m, &second, node->children->child->next,
	    0.5 * pow(2.0 * node->factor, 1.0 / node->alpha), &box);
	import_put(text, "]}");
}

/* Whether a position fits into a document; else a fault at a node. */
static bool check_position(struct reader *r, const struct json_place *at,
    struct vec3 p, const char *what)
{
	if (fabs(p.x) <= TREE_COORDINATE_MAX &&
	    fabs(p.y) <= TREE_COORDINATE_MAX &&
	    fabs(p.z) <= TREE_COORDINATE_MAX)
		return true;
	reader_fault(r, at, "%s beyond %g of the origin", what,
	    TREE_COORDINATE_MAX);
	return false;
}

/* About the middle c of the children's box: x -> s x + (c - s c). */
static void import_scale(struct reader *r, const struct json_place *at,
    const struct cJSON *object, unsigned seen, void *base)
{
	struct import_node *node = base;
	struct import_text *text = &node->m->text;
	const struct vec3 s = node->scale;
	struct vec3 c, move;

	(void)object;
	(void)seen;
	import_put(text, "{\"type\":\"union\",\"operator\":\"sharp\","
	    "\"children\":[");
	put_last_child(node, at, "ScaleNode");
	c = box_middle(&node->box);
	move = vec3(c.x - s.x * c.x, c.y - s.y * c.y, c.z - s.z * c.z);
	check_position(r, at, move, "ScaleNode moves its child");
	box_expand(&node->box, s);
	if (s.x < 1.0 || s.y < 1.0 || s.z < 1.0)
		import_warn(node->m, at, "ScaleNode of less than 1: whole "
		    "here; the library's evaluation cuts it off by a box that "
		    "it shrinks too far");
	import_put(text, "],\"translation\":");
	import_put_vec3(text, move);
	import_put(text, ",\"scale\":");
	import_put_vec3(text, s);
	import_put(text, "}");
}

/*
 * The axis that the library twists about, a unit vector, where the node says
 * `axis`: the one that its rotation by acos(axis.y) about axis x Y takes to Y.
 * That is axis, if it is a unit vector. Where axis x Y = 0 the rotation has no
 * axis, and its matrix is that of a scaling by axis.y: the twist is about Y,
 * and as many times faster (backwards for -Y).
 */
static struct vec3 twist_axis(struct vec3 axis, double *rate)
{
	const double side = hypot(axis.x, axis.z);
	const double angle = fabs(axis.y) <= 1.0 ? acos(axis.y) : 0.0;

	if (fabs(angle) <= TWIST_ANGLE_MIN)
		return vec3(0.0, 1.0, 0.0);
	if (side == 0.0) {
		*rate *= axis.y;
		return vec3(0.0, 1.0, 0.0);
	}
	return vec3(sin(angle) * axis.x / side, cos(angle),
	    sin(angle) * axis.z / side);
}

static void warn_twist(struct importing *m, const struct json_place *at,
    struct vec3 axis, struct vec3 used, double rate)
{
	if (rate != 0.0)
		import_warn(m, at, "TwistNode: whole here; the library's "
		    "evaluation cuts it off by its child's box, which is not "
		    "twisted");
	if (vec3_norm(vec3_sub(axis, used)) > AXIS_SLACK)
		import_warn(m, at, "TwistNode: its axis is no unit vector, or "
		    "-Y; taken as the library does, about [%.10g, %.10g, "
		    "%.10g] at the rate %.10g", used.x, used.y, used.z, rate);
}

/*
 * The library turns p by amount times its height along the axis, from x to z
 * where Y is the axis: right-handed that is backwards, as in core/warp.h.
 */
static void import_twist(struct reader *r, const struct json_place *at,
    const struct cJSON *object, unsigned seen, void *base)
{
	struct import_node *node = base;
	struct import_text *text = &node->m->text;
	double rate = node->amount;
	const struct vec3 axis = twist_axis(node->axis, &rate);
	struct vec3 center;

	(void)object;
	(void)seen;
	import_put(text, "{\"type\":\"twist\",\"child\":");
	put_last_child(node, at, "TwistNode");
	center = box_middle(&node->box);
	check_position(r, at, center, "TwistNode has its centre");
	if (!(fabs(rate) <= TREE_COORDINATE_MAX))
		reader_fault(r, at, "TwistNode at a rate of %.10g", rate);
	warn_twist(node->m, at, node->axis, axis, rate);
	import_put(text, ",\"axis\":");
	import_put_vec3(text, axis);
	import_put(text, ",\"center\":");
	import_put_vec3(text, center);
	import_put(text, ",\"rate\":");
	import_put_number(text, rate);
	import_put(text, "}");
}

static void refuse_distance(struct reader *r, const struct json_place *at,
    const struct cJSON *object, unsigned seen, void *base)
{
	const cJSON *type = cJSON_GetObjectItemCaseSensitive(object, "type");

	(void)seen;
	(void)base;
	reader_fault(r, at, "%s can only be below an SDFRootNode",
	    type->valuestring);
}

/* ---- the table ---- */

#define TYPE {.name = "type"}
#define KEPT(name_, member, required_) \
	{.name = name_, .read = field_keep, .offset = AT(member), \
	    .required = required_}
#define CHILDREN KEPT("children", children, true)
#define NUMBER(name_, member, ...) \
	{.name = name_, .read = field_number, .offset = AT(member), __VA_ARGS__}
#define SCALE(name_, member) \
	NUMBER(name_, member, .required = true, .least = TREE_LENGTH_MIN, \
	    .most = TREE_LENGTH_MAX)
#define AXIS(name_, member, fallback_) \
	NUMBER(name_, member, .has_fallback = true, .fallback = fallback_, \
	    COORDINATES)
#define RICCI .least = 1.0, .most = RICCI_MAX
#define SCALIS TYPE, KEPT("v", v, true), \
	KEPT("volType", vol_type, true), KEPT("materials", materials, true)
#define DENSITY NUMBER("density", density, .required = true, \
    .most = TREE_LENGTH_MAX)

static const struct field root_fields[] = {
	TYPE, CHILDREN,
	NUMBER("ricci_n", ricci_n, .has_fallback = true,
	    .fallback = ROOT_RICCI, RICCI),
	NUMBER("iso", iso, .has_fallback = true, .fallback = ROOT_ISO,
	    .least = TREE_LENGTH_MIN, .most = TREE_LENGTH_MAX),
};

static const struct field ricci_fields[] = {
	TYPE, CHILDREN, NUMBER("ricci_n", ricci_n, .required = true, RICCI),
};

static const struct field extreme_fields[] = {
	TYPE, CHILDREN,
};

/* alpha 0 means the default, 1. */
static void read_alpha(struct reader *r, const struct json_place *at,
    const struct cJSON *value, const struct field *field, void *base)
{
	if (!cJSON_IsNumber(value) || value->valuedouble != 0.0)
		field_number(r, at, value, field, base);
}

static const struct field difference_fields[] = {
	TYPE, CHILDREN,
	{.name = "alpha", .read = read_alpha, .offset = AT(alpha),
	    .required = true, .least = ALPHA_MIN, .most = ALPHA_MAX},
};

static const struct field scale_fields[] = {
	TYPE, CHILDREN, SCALE("scale_x", scale.x), SCALE("scale_y", scale.y),
	SCALE("scale_z", scale.z),
};

/* Versions of the library before it was TypeScript write the children alone,
 * and read what its constructor sets. */
static const struct field twist_fields[] = {
	TYPE, CHILDREN, AXIS("axis_x", axis.x, 0.0),
	AXIS("axis_y", axis.y, 1.0), AXIS("axis_z", axis.z, 0.0),
	NUMBER("twist_amount", amount, .has_fallback = true, .fallback = 1.0,
	    COORDINATES),
};

static const struct field scalis_fields[] = {
	SCALIS, DENSITY,
};

static const struct field triangle_fields[] = {
	SCALIS,
};

static const struct field sdf_root_fields[] = {
	TYPE, KEPT("f", f, true), KEPT("sdfRoot", sdf_root, false),
	KEPT("children", children, false), KEPT("materials", materials, false),
};

#define NODE(name_, table, check_) \
	{.name = name_, .fields = FIELD_SET(table), .check = check_}
/* Whose fields are of no interest. */
#define REFUSED(name_) {.name = name_, .check = refuse_distance}

static const struct variant nodes[] = {
	NODE("RootNode", root_fields, import_root),
	NODE("RicciNode", ricci_fields, import_ricci),
	NODE("MinNode", extreme_fields, import_min),
	NODE("MaxNode", extreme_fields, import_max),
	NODE("Node", difference_fields, import_difference),
	NODE("DifferenceNode", difference_fields, import_difference),
	NODE("ScaleNode", scale_fields, import_scale),
	NODE("TwistNode", twist_fields, import_twist),
	NODE("ScalisPoint", scalis_fields, import_scalis_point),
	NODE("ScalisSegment", scalis_fields, import_scalis_segment),
	NODE("ScalisTriangle", triangle_fields, import_scalis_triangle),
	NODE("SDFRootNode", sdf_root_fields, import_sdf_root),
	REFUSED("SDFNode"),
	REFUSED("SDFSphere"),
	REFUSED("SDFCapsule"),
	REFUSED("SDFPoint"),
	REFUSED("SDFSegment"),
};

static void read_fields(struct importing *m, const struct json_place *at,
    const struct cJSON *value, const struct variant *variant,
    struct import_node *node)
{
	unsigned seen = 0;

	if (variant->fields.count > 0)
		seen = field_read_object(&m->r, at, value, &variant->fields, 1,
		    node);
	if (reader_goes_on(&m->r))
		variant->check(&m->r, at, value, seen, node);
}

/* A node and all below it, into m's text and its box. */
static void read_node(struct importing *m, const struct json_place *at,
    const struct cJSON *value, double factor, struct import_box *box)
{
	const struct variant *variant = field_variant(&m->r, at, value, nodes,
	    sizeof nodes / sizeof *nodes, "node");
	struct import_node node = {.m = m, .factor = factor,
	    .box = import_box_empty()};

	*box = node.box;
	if (!variant)
		return;
	if (m->r.depth == DOCUMENT_DEPTH_MAX) {
		reader_limit(&m->r, at, "nodes nest more than %d deep",
		    DOCUMENT_DEPTH_MAX);
		return;
	}
	if (m->r.item_count++ == m->r.limits->max_nodes) {
		reader_limit(&m->r, at, "more than %zu nodes",
		    m->r.limits->max_nodes);
		return;
	}
	m->r.depth++;
	read_fields(m, at, value, variant, &node);
	m->r.depth--;
	*box = node.box;
	if (m->text.failed)
		m->r.err = ERR_MEMORY;
}

/* Whether a document is what it should be; it may still have a fall-off out of
 * range in some frame, or too many warps within each other. */
static enum err check_document(struct importing *m)
{
	struct document *document;
	struct faults faults = {0};
	enum err err;

	err = document_parse(m->text.bytes, m->text.length, m->r.limits,
	    &document, &faults);
	if (err == ERR_OK)
		document_free(document);
	else if (faults.count > 0)
		faults_add(m->r.faults, "", "imported, it is refused at %s: %s",
		    faults.list[0].pointer, faults.list[0].detail);
	return err;
}

static enum err import_json(struct importing *m, const struct cJSON *json)
{
	const struct json_place at = json_root("");
	struct import_box box;

	import_put(&m->text, "{\"format\":\"blobfield/1\",\"root\":");
	read_node(m, &at, json, ISO, &box);
	import_put(&m->text, "}");
	if (m->r.err == ERR_OK && m->text.failed)
		m->r.err = ERR_MEMORY;
	return m->r.err == ERR_OK ? check_document(m) : m->r.err;
}

enum err import_blobtree(const char *text, size_t length,
    const struct document_limits *limits, struct imported *out,
    struct faults *faults)
{
	struct arena arena = {0};
	struct faults warnings = {0};
	struct importing m = {
		.r = {.arena = &arena, .limits = limits, .faults = faults},
		.warnings = &warnings,
	};
	cJSON *json;
	enum err err;

	err = json_parse(text, length, document_values_max(limits), &arena,
	    &json, faults);
	if (!err)
		err = import_json(&m, json);
	arena_fini(&arena);
	if (err) {
		free(m.text.bytes);
		return err;
	}
	*out = (struct imported){m.text.bytes, m.text.length, warnings};
	return ERR_OK;
}

void import_fini(struct imported *imported)
{
	free(imported->document);
	*imported = (struct imported){0};
}

/* A string of clean text (faults_add), quoted. */
static void put_string(struct import_text *text, const char *string)
{
	size_t plain;

	import_put(text, "\"");
	while (*string) {
		plain = strcspn(string, "\"\\");
		import_put_bytes(text, string, plain);
		string += plain;
		if (*string) {
			import_put(text, "\\");
			import_put_bytes(text, string++, 1);
		}
	}
	import_put(text, "\"");
}

static void put_warnings(struct import_text *text,
    const struct faults *warnings)
{
	char count[48];
	size_t i;

	import_put(text, ",\"warnings\":[");
	for (i = 0; i < warnings->count && i < FAULT_MAX; i++) {
		import_put(text, i > 0 ? ",{\"pointer\":" : "{\"pointer\":");
		put_string(text, warnings->list[i].pointer);
		import_put(text, ",\"detail\":");
		put_string(text, warnings->list[i].detail);
		import_put(text, "}");
	}
	import_put(text, "]");
	if (warnings->count <= FAULT_MAX)
		return;
	snprintf(count, sizeof count, ",\"warning_count\":%zu",
	    warnings->count);
	import_put(text, count);
}

enum err import_answer(const struct imported *imported, char **out,
    size_t *length)
{
	struct import_text text = {0};

	import_put(&text, "{\"document\":");
	import_put_bytes(&text, imported->document, imported->length);
	put_warnings(&text, &imported->warnings);
	import_put(&text, "}");
	if (text.failed) {
		free(text.bytes);
		return ERR_MEMORY;
	}
	*out = text.bytes;
	*length = text.length;
	return ERR_OK;
}
