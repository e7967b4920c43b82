/*
 * The library's primitives: SCALIS (its src/blobtree/scalis) and signed
 * distances (its src/blobtree/sdf).
 *
 * Both end in the kernel k(x) = (1 - x^2)^3 / k0, 0 beyond x = 1, k0 = (1 -
 * 1/4)^3 (ScalisMath.Poly6NF0D, Poly6DistanceFunctor): a soft object of
 * exponent 3 and weight 1/k0.
 *   SCALIS "dist"     x = d / (2 t), t the thickness
 *   distances         x = (d / s + 1) / 2, 0 if negative, s the functor's scale
 * Distances to a ball or capsule of radius r are l - r, l to the centre or the
 * segment. So x = l / (2 s) if r = s, and only then: otherwise the field has a
 * plateau, or a cusp, about the skeleton.
 */
#include <math.h>

#include <cjson/cJSON.h>

#include "proto/import_internal.h"
#include "proto/text.h"

#define KERNEL_AT_HALF 0.421875 /* k0 */
#define SUPPORT 2.0             /* R / t */
#define WEIGHT_MAX 1e6          /* a document's */
/* So that both R and radius are lengths that a document may have. */
#define THICKNESS_MIN (4.0 * TREE_LENGTH_MIN)
#define THICKNESS_MAX (TREE_LENGTH_MAX / 4.0)

#define AT(struct_, member) offsetof(struct struct_, member)
#define COORDINATES .least = -TREE_COORDINATE_MAX, .most = TREE_COORDINATE_MAX
#define THICKNESSES .least = THICKNESS_MIN, .most = THICKNESS_MAX

struct vertex {
	struct vec3 p;
	double thickness;
};

static const struct field vec3_fields[] = {
	{.name = "x", .read = field_number, .offset = AT(vec3, x),
	    .required = true, COORDINATES},
	{.name = "y", .read = field_number, .offset = AT(vec3, y),
	    .required = true, COORDINATES},
	{.name = "z", .read = field_number, .offset = AT(vec3, z),
	    .required = true, COORDINATES},
};

/* {x, y, z} */
static void read_vec3(struct reader *r, const struct json_place *at,
    const struct cJSON *value, const struct field *field, void *base)
{
	static const struct field_set set = FIELD_SET(vec3_fields);

	if (cJSON_IsObject(value))
		field_read_object(r, at, value, &set, 1,
		    (char *)base + field->offset);
	else
		reader_fault(r, at, "must be an object {x, y, z}, not %s",
		    json_kind(value));
}

static const struct field vertex_fields[] = {
	{.name = "position", .read = read_vec3, .offset = AT(vertex, p),
	    .required = true},
	{.name = "thickness", .read = field_number,
	    .offset = AT(vertex, thickness), .required = true, THICKNESSES},
};

static void read_vertices(struct reader *r, const struct json_place *at,
    const struct cJSON *v, int count, struct vertex *out)
{
	static const struct field_set set = FIELD_SET(vertex_fields);
	struct json_place place = json_element(at, 0);
	const cJSON *value;

	if (!import_is_array(r, at, v, count, "vertices"))
		return;
	cJSON_ArrayForEach(value, v) {
		if (cJSON_IsObject(value))
			field_read_object(r, &place, value, &set, 1,
			    out + place.index);
		else
			reader_fault(r, &place, "a vertex must be an object, "
			    "not %s", json_kind(value));
		place.index++;
	}
}

/* What is left of a soft object: its radius, where 1 - r^2/R^2 is the cube root
 * of 1/2, weight, material, and brace. */
static void put_rest(struct import_node *node, const struct json_place *at,
    double support, double density, int materials)
{
	const struct json_place place = json_member(at, "materials");
	struct importing *m = node->m;
	const double weight = density * node->factor / KERNEL_AT_HALF;

	if (!(weight <= WEIGHT_MAX))
		reader_fault(&m->r, at, "would need a weight of %.6g, more "
		    "than %g", weight, WEIGHT_MAX);
	import_put(&m->text, ",\"radius\":");
	import_put_number(&m->text, support * sqrt(1.0 - 1.0 / cbrt(2.0)));
	import_put(&m->text, ",\"weight\":");
	import_put_number(&m->text, weight);
	import_material(m, &place, node->materials, materials);
	import_put(&m->text, "}");
}

static void put_vec3_member(struct importing *m, const char *name,
    struct vec3 v)
{
	import_put(&m->text, name);
	import_put_vec3(&m->text, v);
}

static void put_point(struct import_node *node, const struct json_place *at,
    struct vec3 p, double support, double density, int materials)
{
	put_vec3_member(node->m, "{\"type\":\"point\",\"center\":", p);
	put_rest(node, at, support, density, materials);
}

static void put_segment(struct import_node *node, const struct json_place *at,
    const struct vec3 *p, double support, double density, int materials)
{
	put_vec3_member(node->m, "{\"type\":\"segment\",\"a\":", p[0]);
	put_vec3_member(node->m, ",\"b\":", p[1]);
	put_rest(node, at, support, density, materials);
}

/* Vertices about which the field is 0 beyond SUPPORT thicknesses. */
static void read_scalis(struct import_node *node, const struct json_place *at,
    int count, struct vertex *out)
{
	const struct json_place place = json_member(at, "v");
	struct import_box box;
	int i;

	read_vertices(&node->m->r, &place, node->v, count, out);
	for (i = 0; i < count; i++) {
		box = import_box_about(out[i].p, SUPPORT * out[i].thickness);
		import_box_add(&node->box, &box);
	}
}

/* Whether a volType is "dist"; a fault if it is not, unless either will do. */
static bool check_vol_type(struct import_node *node,
    const struct json_place *at, const char *name, bool either)
{
	const struct json_place place = json_member(at, "volType");
	const cJSON *type = node->vol_type;
	const bool is_string = cJSON_IsString(type);

	if (is_string && text_equal(type->valuestring, "dist"))
		return true;
	if (!is_string || !text_equal(type->valuestring, "convol"))
		reader_fault(&node->m->r, &place,
		    "must be \"dist\" or \"convol\"");
	else if (!either)
		reader_fault(&node->m->r, &place, "%s of volType \"convol\", a "
		    "homothetic convolution, has no exact equal here: only "
		    "\"dist\" has", name);
	return either;
}

void import_scalis_point(struct reader *r, const struct json_place *at,
    const struct cJSON *object, unsigned seen, void *base)
{
	struct import_node *node = base;
	struct vertex v = {0};

	(void)r;
	(void)object;
	(void)seen;
	read_scalis(node, at, 1, &v);
	check_vol_type(node, at, "ScalisPoint", true);
	put_point(node, at, v.p, SUPPORT * v.thickness, node->density, 1);
}

void import_scalis_segment(struct reader *r, const struct json_place *at,
    const struct cJSON *object, unsigned seen, void *base)
{
	const struct json_place place = json_member(at, "v");
	struct import_node *node = base;
	struct vertex v[2] = {0};
	const struct vec3 *a = &v[0].p, *b = &v[1].p;
	bool is_point;

	(void)object;
	(void)seen;
	read_scalis(node, at, 2, v);
	is_point = a->x == b->x && a->y == b->y && a->z == b->z;
	if (check_vol_type(node, at, "ScalisSegment", false) && !is_point &&
	    v[0].thickness != v[1].thickness)
		reader_fault(r, &place, "ScalisSegment with thicknesses %.10g "
		    "and %.10g has no exact equal here: its field falls along "
		    "cones. Equal thicknesses have one", v[0].thickness,
		    v[1].thickness);
	/* Without length, the thicker end is the library's nearest. */
	if (is_point)
		put_point(node, at, *a, SUPPORT *
		    fmax(v[0].thickness, v[1].thickness), node->density, 2);
	else
		put_segment(node, at, (struct vec3[]){*a, *b},
		    SUPPORT * v[0].thickness, node->density, 2);
}

void import_scalis_triangle(struct reader *r, const struct json_place *at,
    const struct cJSON *object, unsigned seen, void *base)
{
	const struct json_place place = json_member(at, "v");
	struct import_node *node = base;
	struct vertex v[3] = {0};

	(void)object;
	(void)seen;
	read_scalis(node, at, 3, v);
	if (check_vol_type(node, at, "ScalisTriangle", false) &&
	    (v[0].thickness != v[1].thickness ||
	    v[0].thickness != v[2].thickness))
		reader_fault(r, &place, "ScalisTriangle with thicknesses "
		    "%.10g, %.10g and %.10g has no exact equal here. Equal "
		    "ones have one", v[0].thickness, v[1].thickness,
		    v[2].thickness);
	put_vec3_member(node->m, "{\"type\":\"triangle\",\"a\":", v[0].p);
	put_vec3_member(node->m, ",\"b\":", v[1].p);
	put_vec3_member(node->m, ",\"c\":", v[2].p);
	put_rest(node, at, SUPPORT * v[0].thickness, 1.0, 3);
}

/* ---- signed distances ---- */

/* A distance being read, of which p holds count points. */
struct distance {
	struct import_node *root;
	double scale; /* its functor's */
	struct vec3 p[2];
	double r[2];
	bool is_wrapped; /* in an SDFNode */
};

#define RADIUS_OF(name_, i) \
	{.name = name_, .read = field_number, \
	    .offset = AT(distance, r) + (i) * sizeof(double), \
	    .required = true, .most = TREE_LENGTH_MAX}
#define POSITION_OF(name_, i) \
	{.name = name_, .read = read_vec3, \
	    .offset = AT(distance, p) + (i) * sizeof(struct vec3), \
	    .required = true}
#define TYPE {.name = "type"}
#define ACCURACY {.name = "acc"} /* of the library's meshes */

static const struct field sphere_fields[] = {
	TYPE, POSITION_OF("p", 0), RADIUS_OF("r", 0),
};

static const struct field capsule_fields[] = {
	TYPE, POSITION_OF("p1", 0), POSITION_OF("p2", 1), RADIUS_OF("r1", 0),
	RADIUS_OF("r2", 1),
};

static const struct field sdf_point_fields[] = {
	TYPE, ACCURACY, POSITION_OF("p", 0),
};

static const struct field sdf_segment_fields[] = {
	TYPE, ACCURACY, POSITION_OF("p1", 0), POSITION_OF("p2", 1),
};

static const struct field sdf_node_fields[] = {
	TYPE, {.name = "children", .required = true},
};

static void add_ball(struct distance *d, int i)
{
	const struct import_box box = import_box_about(d->p[i],
	    d->r[i] + d->scale);

	import_box_add(&d->root->box, &box);
}

static void import_sphere(struct reader *r, const struct json_place *at,
    const struct cJSON *object, unsigned seen, void *base)
{
	struct distance *d = base;

	(void)object;
	(void)seen;
	if (d->r[0] != d->scale)
		reader_fault(r, at, "SDFSphere of radius %.10g under a functor "
		    "of scale %.10g has no exact equal here: only where they "
		    "are the same", d->r[0], d->scale);
	add_ball(d, 0);
	put_vec3_member(d->root->m, "{\"type\":\"point\",\"center\":", d->p[0]);
}

static void import_capsule(struct reader *r, const struct json_place *at,
    const struct cJSON *object, unsigned seen, void *base)
{
	struct distance *d = base;
	const struct vec3 *a = &d->p[0], *b = &d->p[1];

	(void)object;
	(void)seen;
	if (d->r[0] != d->scale || d->r[1] != d->scale)
		reader_fault(r, at, "SDFCapsule of radii %.10g and %.10g under "
		    "a functor of scale %.10g has no exact equal here: only "
		    "where they are the same", d->r[0], d->r[1], d->scale);
	else if (a->x == b->x && a->y == b->y && a->z == b->z)
		reader_fault(r, at, "SDFCapsule without length: the library's "
		    "field of it is not a number");
	add_ball(d, 0);
	add_ball(d, 1);
	put_vec3_member(d->root->m, "{\"type\":\"segment\",\"a\":", *a);
	put_vec3_member(d->root->m, ",\"b\":", *b);
}

static void refuse(struct reader *r, const struct json_place *at,
    const struct cJSON *object, unsigned seen, void *base)
{
	const cJSON *type = cJSON_GetObjectItemCaseSensitive(object, "type");

	(void)seen;
	(void)base;
	reader_fault(r, at, "%s has no exact equal here: its field has a cusp "
	    "at its skeleton", type->valuestring);
}

static void read_distance(struct reader *r, const struct json_place *at,
    const struct cJSON *value, struct distance *d);

/* The library's wrapper of the one distance there may be. */
static void import_sdf_node(struct reader *r, const struct json_place *at,
    const struct cJSON *object, unsigned seen, void *base)
{
	const struct json_place children = json_member(at, "children");
	const struct json_place place = json_element(&children, 0);
	const cJSON *value = cJSON_GetObjectItemCaseSensitive(object,
	    "children");
	struct distance *d = base;

	(void)seen;
	if (d->is_wrapped)
		reader_fault(r, at, "an SDFNode within another: the library "
		    "cannot evaluate it");
	if (d->is_wrapped || !value ||
	    !import_is_array(r, &children, value, 1, "distances"))
		return;
	d->is_wrapped = true;
	read_distance(r, &place, value->child, d);
}

#define DISTANCE(name_, table, check_) \
	{.name = name_, .fields = FIELD_SET(table), .check = check_}

/* The library's SDFNode calls itself "Node" in some versions. */
static const struct variant distances[] = {
	DISTANCE("SDFSphere", sphere_fields, import_sphere),
	DISTANCE("SDFCapsule", capsule_fields, import_capsule),
	DISTANCE("SDFPoint", sdf_point_fields, refuse),
	DISTANCE("SDFSegment", sdf_segment_fields, refuse),
	DISTANCE("SDFNode", sdf_node_fields, import_sdf_node),
	DISTANCE("Node", sdf_node_fields, import_sdf_node),
};

static void read_distance(struct reader *r, const struct json_place *at,
    const struct cJSON *value, struct distance *d)
{
	const struct variant *variant = field_variant(r, at, value, distances,
	    sizeof distances / sizeof *distances, "distance");
	unsigned seen;

	if (!variant)
		return;
	seen = field_read_object(r, at, value, &variant->fields, 1, d);
	if (reader_goes_on(r))
		variant->check(r, at, value, seen, d);
}

struct functor {
	double scale;
};

static const struct field functor_fields[] = {
	TYPE,
	{.name = "scale", .read = field_number, .offset = AT(functor, scale),
	    .required = true, THICKNESSES},
};

static const struct variant functors[] = {
	{.name = "Poly6DistanceFunctor", .fields = FIELD_SET(functor_fields)},
};

static void read_functor(struct reader *r, const struct json_place *at,
    const struct cJSON *value, struct functor *out)
{
	const struct variant *variant = field_variant(r, at, value, functors, 1,
	    "functor");

	if (variant)
		field_read_object(r, at, value, &variant->fields, 1, out);
}

/* Early versions have the distance in `children`. */
static void read_root(struct import_node *node, const struct json_place *at,
    struct distance *d)
{
	const struct json_place root = json_member(at, "sdfRoot");
	const struct json_place children = json_member(at, "children");
	const struct json_place child = json_element(&children, 0);
	struct reader *r = &node->m->r;

	if (node->sdf_root)
		read_distance(r, &root, node->sdf_root, d);
	else if (!node->children)
		reader_fault(r, at, "required field 'sdfRoot' is missing");
	else if (import_is_array(r, &children, node->children, 1, "distances"))
		read_distance(r, &child, node->children->child, d);
}

void import_sdf_root(struct reader *r, const struct json_place *at,
    const struct cJSON *object, unsigned seen, void *base)
{
	const struct json_place f = json_member(at, "f");
	struct import_node *node = base;
	struct functor functor = {0};
	struct distance d = {.root = node};

	(void)object;
	(void)seen;
	if (!node->f)
		return;
	read_functor(r, &f, node->f, &functor);
	if (!reader_goes_on(r) || functor.scale == 0.0)
		return;
	d.scale = functor.scale;
	read_root(node, at, &d);
	put_rest(node, at, SUPPORT * d.scale, 1.0, 1);
}
