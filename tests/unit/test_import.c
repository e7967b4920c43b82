/*
 * Imported documents against the library's own formulas, written here a second
 * time from its source (value() of each class) and evaluated on its JSON.
 */
#include <stdarg.h>
#include <stddef.h>
#include <setjmp.h>
#include <stdint.h>
#include <cmocka.h>

#include <math.h>
#include <stdbool.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include <cjson/cJSON.h>

#include "core/evaluate.h"
#include "core/tape.h"
#include "proto/arena.h"
#include "proto/document.h"
#include "proto/import.h"
#include "proto/json.h"
#include "tests/support/fail_alloc.h"
#include "tests/support/near.h"
#include "tests/support/random_tree.h"

#define COUNT(array) (sizeof(array) / sizeof *(array))

/* Of values up to 1, or else of themselves: measured 3.2e-15 over all cases. */
#define TOLERANCE 1e-13

static const struct document_limits limits = {
	.max_nodes = 1000,
	.layout = LAYOUT_WARPED,
};

/* ---- the library, on its JSON ---- */

struct box {
	double min[3], max[3];
};

static double number(const cJSON *object, const char *name)
{
	return cJSON_GetNumberValue(
	    cJSON_GetObjectItemCaseSensitive(object, name));
}

static const cJSON *member(const cJSON *object, const char *name)
{
	return cJSON_GetObjectItemCaseSensitive(object, name);
}

static bool is_type(const cJSON *node, const char *type)
{
	return strcmp(cJSON_GetStringValue(member(node, "type")), type) == 0;
}

static struct vec3 position(const cJSON *p)
{
	return vec3(number(p, "x"), number(p, "y"), number(p, "z"));
}

static void box_add_ball(struct box *box, struct vec3 p, double reach)
{
	const double c[3] = {p.x, p.y, p.z};

	for (int i = 0; i < 3; i++) {
		box->min[i] = fmin(box->min[i], c[i] - reach);
		box->max[i] = fmax(box->max[i], c[i] + reach);
	}
}

/* What SDFNode wraps. */
static const cJSON *distance_of(const cJSON *root)
{
	const cJSON *d = member(root, "sdfRoot");

	return d && member(d, "children") ? member(d, "children")->child : d;
}

/* prepareForEval's aabb; *inner: before a ScaleNode enlarges it. */
static void find_box(const cJSON *node, struct box *box, struct box *inner)
{
	const double s[3] = {number(node, "scale_x"), number(node, "scale_y"),
	    number(node, "scale_z")};
	struct box other;
	const cJSON *child;

	for (int i = 0; i < 3; i++) {
		box->min[i] = INFINITY;
		box->max[i] = -INFINITY;
	}
	cJSON_ArrayForEach(child, member(node, "v"))
		box_add_ball(box, position(member(child, "position")),
		    2.0 * number(child, "thickness"));
	if (is_type(node, "SDFRootNode")) {
		const double scale = number(member(node, "f"), "scale");

		child = distance_of(node);
		if (is_type(child, "SDFSphere")) {
			box_add_ball(box, position(member(child, "p")),
			    number(child, "r") + scale);
		} else {
			box_add_ball(box, position(member(child, "p1")),
			    number(child, "r1") + scale);
			box_add_ball(box, position(member(child, "p2")),
			    number(child, "r2") + scale);
		}
	}
	cJSON_ArrayForEach(child, member(node, "children")) {
		find_box(child, &other, NULL);
		for (int i = 0; i < 3; i++) {
			box->min[i] = fmin(box->min[i], other.min[i]);
			box->max[i] = fmax(box->max[i], other.max[i]);
		}
		if (is_type(node, "Node"))
			break;
	}
	if (inner)
		*inner = *box;
	for (int i = 0; is_type(node, "ScaleNode") && i < 3; i++) {
		const double by = (box->max[i] - box->min[i]) * (s[i] - 1.0);

		box->min[i] -= by;
		box->max[i] += by;
	}
}

static bool contains(const struct box *box, struct vec3 p)
{
	return p.x >= box->min[0] && p.x <= box->max[0] &&
	    p.y >= box->min[1] && p.y <= box->max[1] &&
	    p.z >= box->min[2] && p.z <= box->max[2];
}

static struct vec3 middle(const struct box *box)
{
	return vec3((box->min[0] + box->max[0]) * 0.5,
	    (box->min[1] + box->max[1]) * 0.5,
	    (box->min[2] + box->max[2]) * 0.5);
}

/* ScalisMath.Poly6Eval(r) Poly6NF0D */
static double poly6(double r)
{
	const double x = 1.0 - 0.25 * r * r;

	return x > 0.0 ? x * x * x / (0.75 * 0.75 * 0.75) : 0.0;
}

/* The distance to the segment. */
static double segment_distance(struct vec3 a, struct vec3 b, struct vec3 p)
{
	const struct vec3 d = vec3_sub(b, a), v = vec3_sub(p, a);
	const double sqr = vec3_dot(d, d);
	const double t = sqr > 0.0 ?
	    fmin(fmax(vec3_dot(v, d) / sqr, 0.0), 1.0) : 1.0;

	return vec3_norm(vec3_axpy(-t, d, v));
}

static double triangle_distance(const struct vec3 *v, struct vec3 p)
{
	const struct vec3 n = vec3_cross(vec3_sub(v[1], v[0]),
	    vec3_sub(v[2], v[0]));
	double least = INFINITY;
	bool within = true;

	for (int i = 0; i < 3; i++) {
		const struct vec3 a = v[i], b = v[(i + 1) % 3];

		least = fmin(least, segment_distance(a, b, p));
		within = within && vec3_dot(n, vec3_cross(vec3_sub(b, a),
		    vec3_sub(p, a))) > 0.0;
	}
	return within ? fabs(vec3_dot(n, vec3_sub(p, v[0]))) / vec3_norm(n) :
	    least;
}

static double scalis(const cJSON *node, struct vec3 p)
{
	const cJSON *density = member(node, "density"), *child;
	double t = 0.0, d;
	struct vec3 v[3];
	int n = 0;

	cJSON_ArrayForEach(child, member(node, "v")) {
		v[n++] = position(member(child, "position"));
		t = fmax(t, number(child, "thickness"));
	}
	d = n == 1 ? vec3_norm(vec3_sub(p, v[0])) :
	    n == 2 ? segment_distance(v[0], v[1], p) : triangle_distance(v, p);
	return (density ? density->valuedouble : 1.0) * poly6(d / t);
}

static double sdf(const cJSON *node, struct vec3 p)
{
	const double scale = number(member(node, "f"), "scale");
	const cJSON *child = distance_of(node);
	double d, x;

	d = is_type(child, "SDFSphere") ?
	    vec3_norm(vec3_sub(p, position(member(child, "p")))) -
	    number(child, "r") :
	    segment_distance(position(member(child, "p1")),
	    position(member(child, "p2")), p) - number(child, "r1");
	x = d / (2.0 * scale) + 0.5;
	return poly6(2.0 * fmax(x, 0.0));
}

static double value(const cJSON *node, struct vec3 p, bool cut);

/* (sum v^n)^(1/n), from the largest, so that no power underflows. */
static double ricci(const cJSON *node, struct vec3 p, bool cut)
{
	const double n = number(node, "ricci_n");
	const cJSON *child;
	double most = 0.0, sum = 0.0;

	cJSON_ArrayForEach(child, member(node, "children"))
		most = fmax(most, value(child, p, cut));
	cJSON_ArrayForEach(child, member(node, "children"))
		sum += most > 0.0 ? pow(value(child, p, cut) / most, n) : 0.0;
	return most * pow(sum, 1.0 / n);
}

static double extreme(const cJSON *node, struct vec3 p, bool cut)
{
	const double sign = is_type(node, "MinNode") ? -1.0 : 1.0;
	double most = -INFINITY;
	const cJSON *child;

	cJSON_ArrayForEach(child, member(node, "children"))
		most = fmax(most, sign * value(child, p, cut));
	return isfinite(most) ? sign * most : 0.0;
}

static double difference(const cJSON *node, struct vec3 p, bool cut)
{
	const cJSON *first = member(node, "children")->child;
	const double f0 = value(first, p, cut), f1 = value(first->next, p, cut);

	return fmax(0.0, f0 - pow(f1, number(node, "alpha")));
}

/* three.js's makeRotationAxis(axis x Y, acos(axis.y)), row by row. */
static void rotation_to_y(struct vec3 axis, double m[3][3])
{
	const double angle = acos(axis.y), c = cos(angle), s = sin(angle);
	struct vec3 u = vec3(-axis.z, 0.0, axis.x);
	const double norm = vec3_norm(u), t = 1.0 - c;
	const double rows[3][3] = {
		{t * u.x * u.x / (norm * norm) + c, -s * u.z / norm,
		    t * u.x * u.z / (norm * norm)},
		{s * u.z / norm, c, -s * u.x / norm},
		{t * u.x * u.z / (norm * norm), s * u.x / norm,
		    t * u.z * u.z / (norm * norm) + c},
	};

	for (int i = 0; i < 9; i++)
		m[i / 3][i % 3] = !(fabs(angle) > 0.0001) ? i % 4 == 0 :
		    norm > 0.0 ? rows[i / 3][i % 3] : (i % 4 == 0) * c;
}

/* m v, or with inverse m's inverse v: m is a rotation, or a scaling, so that
 * this is its transpose over the square of any row. */
static struct vec3 turn(double m[3][3], bool inverse, struct vec3 v)
{
	const struct vec3 rows[3] = {
		vec3(m[0][0], inverse ? m[1][0] : m[0][1],
		    inverse ? m[2][0] : m[0][2]),
		vec3(inverse ? m[0][1] : m[1][0], m[1][1],
		    inverse ? m[2][1] : m[1][2]),
		vec3(inverse ? m[0][2] : m[2][0],
		    inverse ? m[1][2] : m[2][1], m[2][2]),
	};
	const double over = inverse ? vec3_dot(rows[0], rows[0]) : 1.0;

	return vec3_scale(1.0 / over, vec3(vec3_dot(rows[0], v),
	    vec3_dot(rows[1], v), vec3_dot(rows[2], v)));
}

static double twist(const cJSON *node, struct vec3 p, const struct box *inner,
    bool cut)
{
	/* Of older versions it has neither amount nor axis. */
	const bool is_old = !member(node, "twist_amount");
	const double amount = is_old ? 1.0 : number(node, "twist_amount");
	const struct vec3 c = middle(inner);
	const cJSON *list = member(node, "children");
	double m[3][3], phi;
	struct vec3 t;

	rotation_to_y(is_old ? vec3(0.0, 1.0, 0.0) :
	    vec3(number(node, "axis_x"), number(node, "axis_y"),
	    number(node, "axis_z")), m);
	t = turn(m, false, vec3_sub(p, c));
	phi = amount * t.y;
	t = vec3(cos(phi) * t.x - sin(phi) * t.z, t.y,
	    sin(phi) * t.x + cos(phi) * t.z);
	return value(cJSON_GetArrayItem(list, cJSON_GetArraySize(list) - 1),
	    vec3_add(turn(m, true, t), c), cut);
}

static double scaled(const cJSON *node, struct vec3 p, const struct box *inner,
    bool cut)
{
	const struct vec3 c = middle(inner);
	const cJSON *list = member(node, "children");

	return value(cJSON_GetArrayItem(list, cJSON_GetArraySize(list) - 1),
	    vec3((p.x - c.x) / number(node, "scale_x") + c.x,
	    (p.y - c.y) / number(node, "scale_y") + c.y,
	    (p.z - c.z) / number(node, "scale_z") + c.z), cut);
}

/* cut: with the library's boxes, outside which it takes everything for 0. */
static double value(const cJSON *node, struct vec3 p, bool cut)
{
	struct box box, inner;

	find_box(node, &box, &inner);
	if (cut && !contains(&box, p))
		return 0.0;
	if (member(node, "v"))
		return scalis(node, p);
	if (is_type(node, "SDFRootNode"))
		return sdf(node, p);
	if (is_type(node, "RicciNode") || is_type(node, "RootNode"))
		return ricci(node, p, cut);
	if (is_type(node, "MinNode") || is_type(node, "MaxNode"))
		return extreme(node, p, cut);
	if (is_type(node, "Node"))
		return difference(node, p, cut);
	if (member(node, "children")->child == NULL)
		return 0.0;
	return is_type(node, "TwistNode") ? twist(node, p, &inner, cut) :
	    scaled(node, p, &inner, cut);
}

/* ---- importing ---- */

/* malloc'd text with " for '. */
static char *quote(const char *text)
{
	char *copy = strdup(text), *p;

	assert_non_null(copy);
	for (p = copy; *p; p++) {
		if (*p == '\'')
			*p = '"';
	}
	return copy;
}

static enum err import(const char *text, struct imported *out,
    struct faults *faults)
{
	char *quoted = quote(text);
	enum err err;

	*faults = (struct faults){0};
	err = import_blobtree(quoted, strlen(quoted), &limits, out, faults);
	free(quoted);
	return err;
}

static void import_well(const char *text, struct imported *out)
{
	struct faults faults;
	enum err err = import(text, out, &faults);

	if (err != ERR_OK)
		print_message("%s: %s\nin %s\n", faults.list[0].pointer,
		    faults.list[0].detail, text);
	assert_int_equal(err, ERR_OK);
	assert_int_equal(faults.count, 0);
}

static struct document *import_document(const char *text)
{
	struct imported imported;
	struct document *document;
	struct faults faults = {0};

	import_well(text, &imported);
	assert_int_equal(document_parse(imported.document, imported.length,
	    &limits, &document, &faults), ERR_OK);
	import_fini(&imported);
	return document;
}

static double measured;

/* At `count` random points, the field is factor times the library's. */
static void check_field(const char *text, double factor, bool cut, int count)
{
	char *quoted = quote(text);
	cJSON *json = cJSON_Parse(quoted);
	struct document *document = import_document(text);
	struct random_stream r = {strlen(text)};
	int inside = 0;

	assert_non_null(json);
	for (int i = 0; i < count; i++) {
		const struct vec3 p = vec3(random_in(&r, -2.5, 2.5),
		    random_in(&r, -2.5, 2.5), random_in(&r, -2.5, 2.5));
		const double expected = factor * value(json, p, cut);
		struct jet jet;

		evaluate(document_tape(document), p, 0, &jet);
		assert_near(jet.value, expected,
		    TOLERANCE * fmax(expected, 1.0));
		measured = fmax(measured, fabs(jet.value - expected) /
		    fmax(expected, 1.0));
		inside += expected > 0.0;
	}
	/* A test of zeros tests nothing. */
	if (count >= 100)
		assert_true(inside > count / 50);
	document_free(document);
	cJSON_Delete(json);
	free(quoted);
}

#define MATERIAL "{'color':'#aaaaaa','roughness':0,'metalness':0," \
	"'emissive':'#000000'}"
#define VERTEX(x, y, z, t) "{'position':{'x':" x ",'y':" y ",'z':" z "}," \
	"'thickness':" t "}"
#define POINT(x, y, z, t, density) \
	"{'type':'ScalisPoint','materials':[" MATERIAL "],'v':[" \
	VERTEX(x, y, z, t) "],'volType':'dist','density':" density "}"
#define SEGMENT(a, b, kind) \
	"{'type':'ScalisSegment','materials':[" MATERIAL "," MATERIAL "]," \
	"'v':[" a "," b "],'volType':'" kind "','density':1.25}"
#define TRIANGLE(a, b, c, kind) \
	"{'type':'ScalisTriangle','materials':[" MATERIAL "," MATERIAL "," \
	MATERIAL "],'v':[" a "," b "," c "],'volType':'" kind "'}"
#define SDF(scale, root) "{'type':'SDFRootNode','materials':[" MATERIAL \
	"],'f':{'type':'Poly6DistanceFunctor','scale':" scale "}," \
	"'sdfRoot':" root "}"
#define SPHERE(r) "{'type':'SDFSphere','p':{'x':0.3,'y':-0.2,'z':0.1},'r':" \
	r "}"
#define CAPSULE(r1, r2) "{'type':'SDFCapsule','p1':{'x':-0.7,'y':0.1," \
	"'z':-0.3},'r1':" r1 ",'p2':{'x':0.9,'y':0.4,'z':0.2},'r2':" r2 "}"
#define RICCI(n, children) "{'type':'RicciNode','children':[" children \
	"],'ricci_n':" n "}"
#define ROOT(children) "{'type':'RootNode','children':[" children \
	"],'ricci_n':64,'iso':1}"
#define DIFFERENCE(alpha, a, b) "{'type':'Node','children':[" a "," b \
	"],'alpha':" alpha "}"
#define SCALE(x, y, z, children) "{'type':'ScaleNode','children':[" children \
	"],'scale_x':" x ",'scale_y':" y ",'scale_z':" z "}"
#define TWIST(amount, x, y, z, children) "{'type':'TwistNode','children':[" \
	children "],'twist_amount':" amount ",'axis_x':" x ",'axis_y':" y \
	",'axis_z':" z "}"
#define LEFT POINT("-0.4", "0.1", "0.2", "0.6", "1")
#define RIGHT POINT("0.5", "-0.1", "0", "0.7", "1.5")
#define BAR SEGMENT(VERTEX("-0.8", "0.2", "-0.1", "0.4"), \
	VERTEX("0.7", "-0.3", "0.5", "0.4"), "dist")

static void test_points_have_the_library_s_field(void **state)
{
	(void)state;
	check_field(POINT("0.25", "-0.5", "1", "0.9", "1"), 0.5, true, 1000);
	check_field(POINT("0", "0", "0", "1.1", "3.7"), 0.5, true, 1000);
	check_field(ROOT(POINT("0", "0", "0", "1.1", "0.3")), 0.5, true, 1000);
}

/* Its surface is where its thickness says, and ours there. */
static void test_a_point_s_surface_is_at_its_thickness(void **state)
{
	struct document *document = import_document(
	    ROOT(POINT("0", "0", "0", "0.8", "1")));
	struct jet jet;

	(void)state;
	evaluate(document_tape(document), vec3(0.0, 0.8, 0.0), 0, &jet);
	assert_near(jet.value, 0.5, 1e-15); /* 1.1e-16 */
	document_free(document);
}

static void test_segments_of_equal_thickness_have_the_field(void **state)
{
	(void)state;
	check_field(BAR, 0.5, true, 1000);
	/* Without length: a point as thick as the thicker end. */
	check_field(SEGMENT(VERTEX("0.1", "0", "0", "0.9"),
	    VERTEX("0.1", "0", "0", "0.9"), "dist"), 0.5, true, 1000);
	check_field(SEGMENT(VERTEX("0.1", "0", "0", "0.4"),
	    VERTEX("0.1", "0", "0", "0.9"), "dist"), 0.5, true, 1000);
}

static void test_triangles_of_equal_thickness_have_the_field(void **state)
{
	(void)state;
	check_field(TRIANGLE(VERTEX("-0.8", "0.2", "-0.1", "0.4"),
	    VERTEX("0.7", "-0.3", "0.5", "0.4"), VERTEX("0", "1", "0.2",
	    "0.4"), "dist"), 0.5, true, 2000);
	/* On a line. */
	check_field(TRIANGLE(VERTEX("-1", "0", "0", "0.4"),
	    VERTEX("1", "0", "0", "0.4"), VERTEX("0.5", "0", "0", "0.4"),
	    "dist"), 0.5, true, 2000);
}

static void test_distances_at_their_functor_s_scale_have_the_field(
    void **state)
{
	(void)state;
	check_field(SDF("0.75", SPHERE("0.75")), 0.5, true, 1000);
	check_field(SDF("0.6", CAPSULE("0.6", "0.6")), 0.5, true, 1000);
	check_field(SDF("0.6", "{'type':'Node','children':["
	    CAPSULE("0.6", "0.6") "]}"), 0.5, true, 1000);
	check_field(SDF("0.75", "{'type':'SDFNode','children':["
	    SPHERE("0.75") "]}"), 0.5, true, 1000);
}

static void test_riccis_have_the_field(void **state)
{
	(void)state;
	check_field(ROOT(LEFT "," RIGHT "," BAR), 0.5, true, 1000);
	check_field(RICCI("1", LEFT "," RIGHT), 0.5, true, 1000);
	check_field(RICCI("2.5", LEFT "," BAR "," RIGHT), 0.5, true, 1000);
	check_field(RICCI("1000", LEFT "," RIGHT), 0.5, true, 1000);
}

/* The library's own way, with powers that underflow, is 9e-6 off at most. */
static void test_root_differs_by_what_its_powers_lose(void **state)
{
	struct document *document = import_document(ROOT(LEFT "," RIGHT));
	double most = 0.0;

	(void)state;
	for (int i = 0; i < 4000; i++) {
		const struct vec3 p = vec3(-1.8 + 1e-3 * i, 0.1, 0.2);
		const double f[2] = {poly6(fabs(p.x + 0.4) / 0.6), 1.5 *
		    poly6(vec3_norm(vec3_sub(p, vec3(0.5, -0.1, 0.0))) / 0.7)};
		double sum = 0.0;
		struct jet jet;

		for (int k = 0; k < 2; k++)
			sum += f[k] * pow(f[k], 63.0);
		evaluate(document_tape(document), p, 0, &jet);
		most = fmax(most, fabs(jet.value -
		    0.5 * pow(sum, 1.0 / 64.0)));
	}
	print_message("measured: imported roots differ by up to %.1e\n", most);
	assert_true(most < 9e-6);
	document_free(document);
}

static void test_min_and_max_have_the_field(void **state)
{
	(void)state;
	check_field("{'type':'MinNode','children':[" LEFT "," RIGHT "," BAR
	    "]}", 0.5, true, 1000);
	check_field("{'type':'MaxNode','children':[" LEFT "," RIGHT "," BAR
	    "]}", 0.5, true, 1000);
}

static void test_differences_have_the_field(void **state)
{
	(void)state;
	check_field(DIFFERENCE("1", RIGHT, BAR), 0.5, true, 1000);
	check_field(DIFFERENCE("2", RIGHT, BAR), 0.5, true, 1000);
	check_field(DIFFERENCE("5.5", BAR, LEFT), 0.5, true, 1000);
}

static void test_alpha_of_0_is_1(void **state)
{
	struct imported zero, one;

	(void)state;
	import_well(DIFFERENCE("0", RIGHT, BAR), &zero);
	import_well(DIFFERENCE("1", RIGHT, BAR), &one);
	assert_string_equal(zero.document, one.document);
	import_fini(&zero);
	import_fini(&one);
}

static void test_scales_have_the_field(void **state)
{
	(void)state;
	check_field(SCALE("1.5", "1", "2", LEFT), 0.5, true, 1000);
	check_field(SCALE("1.1", "1.2", "1.3", RICCI("2", LEFT "," BAR)), 0.5,
	    true, 1000);
	check_field(SCALE("1.5", "1", "1", SCALE("1", "1.5", "1", RICCI("3",
	    LEFT "," RIGHT))), 0.5, true, 1000);
	/* About the middle of all children, of which the last counts. */
	check_field(SCALE("1.5", "1.5", "1.5", LEFT "," RIGHT), 0.5, true,
	    1000);
}

static void test_shrinking_is_whole(void **state)
{
	(void)state;
	check_field(SCALE("0.6", "1", "0.7", RICCI("2", LEFT "," BAR)), 0.5,
	    false, 2000);
}

static void test_twists_have_the_field(void **state)
{
	(void)state;
	check_field(TWIST("1.5", "0", "1", "0", BAR), 0.5, false, 1000);
	check_field(TWIST("-2.5", "1", "0", "0", RICCI("2", LEFT "," BAR)),
	    0.5, false, 1000);
	check_field(TWIST("1.2", "0.48", "0.6", "0.64", RICCI("2", RIGHT ","
	    BAR)), 0.5, false, 1000);
	check_field(TWIST("1.2", "0", "0", "-1", RICCI("2", RIGHT "," BAR)),
	    0.5, false, 1000);
	check_field("{'type':'TwistNode','children':[" BAR "]}", 0.5, false,
	    1000);
}

/* What the library makes of them, whatever was meant. */
static void test_odd_twist_axes_are_taken_as_the_library_does(void **state)
{
	(void)state;
	check_field(TWIST("1.5", "0", "-1", "0", BAR), 0.5, false, 1000);
	check_field(TWIST("1.5", "0", "0.5", "0", BAR), 0.5, false, 1000);
	check_field(TWIST("1.5", "3", "0.5", "-4", BAR), 0.5, false, 1000);
	check_field(TWIST("1.5", "2", "0", "0", BAR), 0.5, false, 1000);
	check_field(TWIST("1.5", "1", "2", "1", BAR), 0.5, false, 1000);
	check_field(TWIST("1.5", "0.00005", "1", "0", BAR), 0.5, false, 1000);
}

/* Within its child's box the library twists, too. */
static void test_a_twist_within_its_box_is_the_library_s(void **state)
{
	static const char text[] = TWIST("1.5", "0", "1", "0", BAR);
	struct document *document = import_document(text);
	char *quoted = quote(text);
	cJSON *json = cJSON_Parse(quoted);
	struct random_stream r = {7};
	struct box box;
	struct jet jet;

	(void)state;
	find_box(json, &box, NULL);
	for (int i = 0; i < 1000; i++) {
		const struct vec3 p = vec3(
		    random_in(&r, box.min[0], box.max[0]),
		    random_in(&r, box.min[1], box.max[1]),
		    random_in(&r, box.min[2], box.max[2]));

		evaluate(document_tape(document), p, 0, &jet);
		assert_near(jet.value, 0.5 * value(json, p, true), TOLERANCE);
	}
	document_free(document);
	cJSON_Delete(json);
	free(quoted);
}

#define ISO_ROOT(iso, n, children) "{'type':'RootNode','children':[" children \
	"],'ricci_n':" n ",'iso':" iso "}"

/* f / (2 iso), also through a difference, which is not homogeneous. */
static void test_iso_is_where_the_surface_is(void **state)
{
	(void)state;
	check_field(ISO_ROOT("1.25", "64", LEFT "," RIGHT), 0.4, true, 1000);
	check_field(ISO_ROOT("0.25", "2", DIFFERENCE("3", RIGHT, BAR) ","
	    LEFT), 2.0, true, 1000);
	check_field(ISO_ROOT("0.8", "2", DIFFERENCE("3", RIGHT,
	    DIFFERENCE("2", BAR, LEFT))), 0.625, true, 1000);
}

static void test_nodes_without_children_are_0(void **state)
{
	static const char *const nodes[] = {ROOT(""), RICCI("2", ""),
	    "{'type':'MinNode','children':[]}",
	    "{'type':'MaxNode','children':[]}", SCALE("2", "2", "2", ""),
	    TWIST("1", "0", "1", "0", ""), ROOT(SCALE("2", "2", "2", ""))};

	(void)state;
	for (size_t i = 0; i < COUNT(nodes); i++)
		check_field(nodes[i], 0.5, false, 50);
	check_field(ROOT(LEFT "," SCALE("2", "2", "2", "")), 0.5, true, 1000);
}

/* ---- random documents ---- */

struct draft {
	char text[1 << 16];
	size_t length;
	struct random_stream r;
	bool cut; /* neither twists nor shrinking */
};

static void put(struct draft *d, const char *format, ...)
    __attribute__((format(printf, 2, 3)));
static void put(struct draft *d, const char *format, ...)
{
	va_list ap;
	int n;

	va_start(ap, format);
	n = vsnprintf(d->text + d->length, sizeof d->text - d->length, format,
	    ap);
	va_end(ap);
	d->length += (size_t)n;
	assert_true(d->length < sizeof d->text);
}

static double any(struct draft *d, double least, double most)
{
	return random_in(&d->r, least, most);
}

static void put_scalis(struct draft *d)
{
	static const char *const names[] = {"Point", "Segment", "Triangle"};
	const int n = random_below(&d->r, 3);
	const double thickness = any(d, 0.3, 0.8);

	put(d, "{'type':'Scalis%s','volType':'dist','materials':[", names[n]);
	for (int i = 0; i <= n; i++)
		put(d, "%s" MATERIAL, i ? "," : "");
	put(d, "],'v':[");
	for (int i = 0; i <= n; i++) {
		put(d, "%s{'thickness':%.17g,'position':{'x':%.17g,",
		    i ? "," : "", thickness, any(d, -1.2, 1.2));
		put(d, "'y':%.17g,'z':%.17g}}", any(d, -1.2, 1.2),
		    any(d, -1.2, 1.2));
	}
	put(d, "]");
	if (n < 2)
		put(d, ",'density':%.17g", any(d, 0.6, 1.6));
	put(d, "}");
}

static void put_sdf(struct draft *d)
{
	const double s = any(d, 0.3, 0.8), x = any(d, -1.0, 1.0);

	if (random_below(&d->r, 2))
		put(d, SDF("%.17g", "{'type':'SDFSphere','p':{'x':%.17g,"
		    "'y':0.2,'z':%.17g},'r':%.17g}"), s, x, any(d, -1.0, 1.0),
		    s);
	else
		put(d, SDF("%.17g", "{'type':'SDFCapsule','p1':{'x':%.17g,"
		    "'y':0.2,'z':%.17g},'p2':{'x':0.1,'y':%.17g,'z':-0.2},"
		    "'r1':%.17g,'r2':%.17g}"), s, x, any(d, -1.0, 1.0),
		    any(d, -1.0, 1.0), s, s);
}

static void put_node(struct draft *d, int depth);

static void put_list(struct draft *d, int count, int depth)
{
	put(d, "'children':[");
	for (int i = 0; i < count; i++) {
		if (i > 0)
			put(d, ",");
		put_node(d, depth);
	}
	put(d, "]");
}

static void put_deformed(struct draft *d, int depth, bool twisted)
{
	const double least = d->cut ? 1.0 : 0.5;
	double a = any(d, 0.0, 6.28), c = any(d, -1.0, 1.0);

	put(d, "{'type':'%s',", twisted ? "TwistNode" : "ScaleNode");
	put_list(d, 1, depth);
	if (twisted)
		put(d, ",'twist_amount':%.17g,'axis_x':%.17g,'axis_y':%.17g,"
		    "'axis_z':%.17g}", any(d, -2.0, 2.0),
		    sqrt(1.0 - c * c) * cos(a), c, sqrt(1.0 - c * c) * sin(a));
	else
		put(d, ",'scale_x':%.17g,'scale_y':%.17g,'scale_z':%.17g}",
		    any(d, least, 2.0), any(d, least, 2.0), any(d, least, 2.0));
}

static void put_node(struct draft *d, int depth)
{
	const int kind = depth == 0 ? random_below(&d->r, 3) :
	    3 + random_below(&d->r, 6);

	if (kind < 2) {
		put_scalis(d);
	} else if (kind == 2) {
		put_sdf(d);
	} else if (kind <= 4) {
		put(d, "{'type':'RicciNode','ricci_n':%.17g,",
		    any(d, 1.0, 8.0));
		put_list(d, 2 + random_below(&d->r, 3), depth - 1);
		put(d, "}");
	} else if (kind == 5) {
		put(d, "{'type':'%s',", random_below(&d->r, 2) ? "MaxNode" :
		    "MinNode");
		put_list(d, 2, depth - 1);
		put(d, "}");
	} else if (kind == 6) {
		put(d, "{'type':'Node','alpha':%.17g,", any(d, 1.0, 6.0));
		put_list(d, 2, depth - 1);
		put(d, "}");
	} else {
		put_deformed(d, depth - 1, kind == 7 && !d->cut);
	}
}

static void check_random(bool cut)
{
	struct draft *d = malloc(sizeof *d);

	assert_non_null(d);
	for (unsigned i = 0; i < 40; i++) {
		d->length = 0;
		d->r.state = 100 + i;
		d->cut = cut;
		put(d, "{'type':'RootNode','ricci_n':64,'iso':1,");
		put_list(d, 3, 1 + (int)(i % 3));
		put(d, "}");
		check_field(d->text, 0.5, cut, 60);
	}
	free(d);
}

static void test_random_trees_have_the_field(void **state)
{
	(void)state;
	check_random(true);
	check_random(false);
	print_message("measured: imported fields differ by up to %.1e\n",
	    measured);
}

/* ---- numbers ---- */

static void test_numbers_read_back_exactly(void **state)
{
	static const double numbers[] = {0.1 + 0.2, 1.0 / 3.0, 1e-300,
	    123456.78901234567, -2.2250738585072014e-308, 4.35, 0.1,
	    9.8765432109876543e8, 1.0000000000000002, 5e-324};
	char text[1024];
	struct imported imported;
	struct document *document;
	struct faults faults = {0};

	(void)state;
	for (size_t i = 0; i < COUNT(numbers); i++) {
		snprintf(text, sizeof text, POINT("%.17g", "0", "0", "1", "1"),
		    numbers[i]);
		import_well(text, &imported);
		assert_int_equal(document_parse(imported.document,
		    imported.length, &limits, &document, &faults), ERR_OK);
		assert_true(document_tree(document)->root->primitive.a.x ==
		    numbers[i]);
		document_free(document);
		import_fini(&imported);
	}
}

/* ---- materials ---- */

#define PAINTED(a, b) "{'type':'ScalisSegment','volType':'dist'," \
	"'density':1,'v':[" VERTEX("0", "0", "0", "1") "," \
	VERTEX("1", "0", "0", "1") "],'materials':[" a "," b "]}"

static struct vec3 color_of(const char *text)
{
	struct document *document = import_document(text);
	const struct node *root = document_tree(document)->root;
	const struct vec3 color = root->color;

	assert_true(root->has_color);
	document_free(document);
	return color;
}

static void check_color(const char *color, double r, double g, double b)
{
	char text[1024];
	struct vec3 c;

	snprintf(text, sizeof text, PAINTED("{'color':%s}", "{'color':%s}"),
	    color, color);
	c = color_of(text);
	assert_near(c.x, r, 1e-15);
	assert_near(c.y, g, 1e-15);
	assert_near(c.z, b, 1e-15);
}

/* sRGB of IEC 61966-2-1: 0xaa is ((170/255 + 0.055) / 1.055)^2.4. */
static void test_colors_become_linear(void **state)
{
	(void)state;
	check_color("'#aaaaaa'", 0.40197777983219579, 0.40197777983219579,
	    0.40197777983219579);
	check_color("'#FF0080'", 1.0, 0.0, 0.21586050011389926);
	check_color("'#f08'", 1.0, 0.0, 0.24620132670783548);
	check_color("'#0a0000'", 10.0 / 255.0 / 12.92, 0.0, 0.0);
	check_color("16711680", 1.0, 0.0, 0.0);
	check_color("0", 0.0, 0.0, 0.0);
}

static void test_vertices_colors_are_averaged_with_a_warning(void **state)
{
	static const char text[] = PAINTED("{'color':'#ff0000'}",
	    "{'color':'#0000ff'}");
	const struct vec3 c = color_of(text);
	struct imported imported;

	(void)state;
	assert_near(c.x, 0.5, 0.0);
	assert_near(c.y, 0.0, 0.0);
	assert_near(c.z, 0.5, 0.0);
	import_well(text, &imported);
	assert_int_equal(imported.warnings.count, 1);
	assert_string_equal(imported.warnings.list[0].pointer, "/materials");
	import_fini(&imported);
}

static void test_other_members_of_materials_are_warned_of(void **state)
{
	struct imported imported;

	(void)state;
	import_well(ROOT(PAINTED("{'color':'#fff','roughness':0.5}",
	    "{'color':'#fff','metalness':1,'emissive':'#010000'}")),
	    &imported);
	assert_int_equal(imported.warnings.count, 3);
	assert_string_equal(imported.warnings.list[0].pointer,
	    "/children/0/materials/0/roughness");
	assert_string_equal(imported.warnings.list[1].pointer,
	    "/children/0/materials/1/metalness");
	assert_string_equal(imported.warnings.list[2].pointer,
	    "/children/0/materials/1/emissive");
	import_fini(&imported);
}

static void test_no_materials_is_the_library_s_default(void **state)
{
	const struct vec3 c = color_of("{'type':'SDFRootNode','f':{'type':"
	    "'Poly6DistanceFunctor','scale':1},'children':[" SPHERE("1") "]}");

	(void)state;
	assert_near(c.x, 0.40197777983219579, 1e-15);
}

/* ---- warnings ---- */

static void check_warning(const char *text, const char *pointer,
    const char *part)
{
	struct imported imported;

	import_well(text, &imported);
	assert_int_equal(imported.warnings.count, 1);
	assert_string_equal(imported.warnings.list[0].pointer, pointer);
	assert_non_null(strstr(imported.warnings.list[0].detail, part));
	import_fini(&imported);
}

static void test_what_is_taken_otherwise_is_warned_of(void **state)
{
	struct imported imported;

	(void)state;
	import_well(ROOT(LEFT "," BAR), &imported);
	assert_int_equal(imported.warnings.count, 0);
	import_fini(&imported);
	check_warning(ROOT("{'type':'MaxNode','children':[" LEFT "]}"),
	    "/children/0", "MaxNode");
	check_warning(SCALE("1", "0.9", "1", LEFT), "", "ScaleNode");
	check_warning(SCALE("1", "1", "1", LEFT "," BAR), "/children",
	    "only the last of its 2");
	check_warning(TWIST("1", "0", "1", "0", LEFT), "", "TwistNode");
	check_warning(TWIST("0", "0", "-1", "0", LEFT), "", "no unit vector");
	check_warning(ISO_ROOT("2", "64", LEFT), "/iso", "would have 1");
	check_warning(ISO_ROOT("1", "3", LEFT), "/ricci_n", "would have 64");
}

static void test_answer_has_document_and_warnings(void **state)
{
	struct imported imported;
	char *text;
	size_t length;
	cJSON *json;
	const cJSON *warning;

	(void)state;
	import_well(ROOT(TWIST("1", "0", "1", "0", LEFT)), &imported);
	assert_int_equal(import_answer(&imported, &text, &length), ERR_OK);
	json = cJSON_ParseWithLength(text, length);
	assert_non_null(json);
	assert_string_equal(cJSON_GetStringValue(member(member(json,
	    "document"), "format")), "blobfield/1");
	warning = member(json, "warnings")->child;
	assert_string_equal(cJSON_GetStringValue(member(warning, "pointer")),
	    "/children/0");
	assert_null(warning->next);
	assert_null(member(json, "warning_count"));
	cJSON_Delete(json);
	free(text);
	import_fini(&imported);
}

static void test_many_warnings_are_counted(void **state)
{
	struct draft *d = malloc(sizeof *d);
	struct imported imported;
	char *text;
	size_t length;
	cJSON *json;

	(void)state;
	assert_non_null(d);
	d->length = 0;
	put(d, "{'type':'RicciNode','ricci_n':2,'children':[");
	for (int i = 0; i < 20; i++)
		put(d, "%s" TWIST("1", "0", "1", "0", LEFT), i ? "," : "");
	put(d, "]}");
	import_well(d->text, &imported);
	assert_int_equal(import_answer(&imported, &text, &length), ERR_OK);
	json = cJSON_ParseWithLength(text, length);
	assert_int_equal(cJSON_GetArraySize(member(json, "warnings")), 16);
	assert_near(number(json, "warning_count"), 20.0, 0.0);
	cJSON_Delete(json);
	free(text);
	import_fini(&imported);
	free(d);
}

/* ---- refusals ---- */

static void check_refused(const char *text, const char *pointer,
    const char *part)
{
	struct imported imported;
	struct faults faults;
	enum err err = import(text, &imported, &faults);

	if (err != ERR_INVALID || !strstr(faults.list[0].detail, part) ||
	    strcmp(faults.list[0].pointer, pointer) != 0)
		print_message("%s\n%s: %s\n", text, faults.list[0].pointer,
		    faults.list[0].detail);
	assert_int_equal(err, ERR_INVALID);
	assert_string_equal(faults.list[0].pointer, pointer);
	assert_non_null(strstr(faults.list[0].detail, part));
}

static void test_what_has_no_equal_is_refused_by_name(void **state)
{
	static const struct {
		const char *text, *pointer, *part;
	} cases[] = {
		{ROOT(SEGMENT(VERTEX("0", "0", "0", "0.5"),
		    VERTEX("1", "0", "0", "0.4"), "dist")), "/children/0/v",
		    "ScalisSegment"},
		{ROOT(SEGMENT(VERTEX("0", "0", "0", "0.5"),
		    VERTEX("1", "0", "0", "0.5"), "convol")),
		    "/children/0/volType", "ScalisSegment of volType"},
		{TRIANGLE(VERTEX("0", "0", "0", "0.5"),
		    VERTEX("1", "0", "0", "0.5"), VERTEX("0", "1", "0", "0.6"),
		    "dist"), "/v", "ScalisTriangle"},
		{TRIANGLE(VERTEX("0", "0", "0", "0.5"),
		    VERTEX("1", "0", "0", "0.5"), VERTEX("0", "1", "0", "0.5"),
		    "convol"), "/volType", "ScalisTriangle of volType"},
		{ROOT(SDF("1", SPHERE("0.5"))), "/children/0/sdfRoot",
		    "SDFSphere"},
		{SDF("1", "{'type':'Node','children':[" SPHERE("2") "]}"),
		    "/sdfRoot/children/0", "SDFSphere"},
		{SDF("1", CAPSULE("1", "0.5")), "/sdfRoot", "SDFCapsule"},
		{SDF("1", CAPSULE("0.5", "0.5")), "/sdfRoot", "SDFCapsule"},
		{SDF("1", "{'type':'SDFCapsule','p1':{'x':0,'y':0,'z':0},"
		    "'p2':{'x':0,'y':0,'z':0},'r1':1,'r2':1}"), "/sdfRoot",
		    "SDFCapsule without length"},
		{SDF("1", "{'type':'SDFPoint','p':{'x':0,'y':0,'z':0},"
		    "'acc':1}"), "/sdfRoot", "SDFPoint"},
		{SDF("1", "{'type':'SDFSegment','p1':{'x':0,'y':0,'z':0},"
		    "'p2':{'x':1,'y':0,'z':0},'acc':1}"), "/sdfRoot",
		    "SDFSegment"},
		{SDF("1", "{'type':'SDFNode','children':[{'type':'SDFNode',"
		    "'children':[" SPHERE("1") "]}]}"),
		    "/sdfRoot/children/0", "SDFNode within"},
		{SDF("1", "{'type':'SDFNode','children':[]}"),
		    "/sdfRoot/children", "must have 1 distances"},
		{SPHERE("1"), "", "SDFSphere can only be below"},
		{"{'type':'SDFRootNode','f':{'type':'DistanceFunctor'},"
		    "'sdfRoot':" SPHERE("1") "}", "/f/type",
		    "'DistanceFunctor'"},
		{ROOT(ROOT(LEFT)), "/children/0", "RootNode"},
		{ROOT("{'type':'BlobNode','children':[]}"),
		    "/children/0/type", "unknown node type 'BlobNode'"},
	};

	(void)state;
	for (size_t i = 0; i < COUNT(cases); i++)
		check_refused(cases[i].text, cases[i].pointer, cases[i].part);
}

static void test_what_is_wrong_is_said_where(void **state)
{
	static const struct {
		const char *text, *pointer, *part;
	} cases[] = {
		{"[]", "", "must be an object"},
		{"{}", "", "'type' is missing"},
		{"{'type':3}", "/type", "must be a string"},
		{"{'type':'Node','children':[" LEFT "," LEFT "]}", "",
		    "'alpha' is missing"},
		{DIFFERENCE("-1", LEFT, RIGHT), "/alpha", "between 1 and 100"},
		{DIFFERENCE("null", LEFT, RIGHT), "/alpha", "not null"},
		{"{'type':'Node','alpha':1,'children':[" LEFT "]}",
		    "/children", "must have 2 nodes, not 1"},
		{RICCI("0.5", LEFT), "/ricci_n", "between 1 and 1000"},
		{RICCI("1e400", LEFT), "/ricci_n", "too large"},
		{ISO_ROOT("0", "64", LEFT), "/iso", "between"},
		{"{'type':'MinNode','children':3}", "/children",
		    "must be an array of nodes"},
		{ROOT("7"), "/children/0", "must be an object, not a number"},
		{SCALE("0", "1", "1", LEFT), "/scale_x", "between"},
		{SCALE("1", "-1", "1", LEFT), "/scale_y", "between"},
		{SCALE("1e9", "1", "1", POINT("1e9", "0", "0", "1", "1")), "",
		    "ScaleNode moves"},
		{TWIST("'1'", "0", "1", "0", LEFT), "/twist_amount",
		    "must be a number"},
		{POINT("1e10", "0", "0", "1", "1"), "/v/0/position/x",
		    "between"},
		{POINT("0", "0", "0", "0", "1"), "/v/0/thickness", "between"},
		{POINT("0", "0", "0", "1", "-1"), "/density", "between"},
		{POINT("0", "0", "0", "1", "1e6"), "", "weight"},
		{PAINTED("{'color':'red'}", "{'color':'#fff'}"),
		    "/materials/0/color", "rrggbb"},
		{PAINTED("{'color':0.5}", "{'color':'#fff'}"),
		    "/materials/0/color", "whole number"},
		{PAINTED("{'colour':0}", "{'color':'#fff'}"),
		    "/materials/0/colour", "did you mean 'color'?"},
		{PAINTED("1", "{'color':'#fff'}"), "/materials/0",
		    "must be an object"},
		{"{'type':'ScalisPoint','volType':'dist','density':1,'v':[],"
		    "'materials':[" MATERIAL "]}", "/v", "must have 1"},
		{"{'type':'ScalisPoint','volType':'dist','density':1,'v':[3],"
		    "'materials':[" MATERIAL "]}", "/v/0", "a vertex must be"},
		{"{'type':'ScalisPoint','volType':'round','density':1,'v':["
		    VERTEX("0", "0", "0", "1") "],'materials':[" MATERIAL
		    "]}", "/volType", "\"dist\" or \"convol\""},
		/* Fine by itself; scaled, beyond what fall-offs may be. */
		{SCALE("1e9", "1e9", "1e9", POINT("0", "0", "0", "9", "1")),
		    "", "it is refused at /root"},
	};

	(void)state;
	for (size_t i = 0; i < COUNT(cases); i++)
		check_refused(cases[i].text, cases[i].pointer, cases[i].part);
}

static void test_every_refusal_is_listed(void **state)
{
	struct imported imported;
	struct faults faults;

	(void)state;
	assert_int_equal(import(ROOT(SDF("1", SPHERE("0.5")) "," LEFT ","
	    SDF("1", CAPSULE("1", "2"))), &imported, &faults), ERR_INVALID);
	assert_int_equal(faults.count, 2);
	assert_string_equal(faults.list[0].pointer, "/children/0/sdfRoot");
	assert_string_equal(faults.list[1].pointer, "/children/2/sdfRoot");
}

static void test_what_is_not_json_is_a_syntax_error(void **state)
{
	struct imported imported;
	struct faults faults;

	(void)state;
	assert_int_equal(import("", &imported, &faults), ERR_SYNTAX);
	assert_int_equal(import("{'type':'RootNode',}", &imported, &faults),
	    ERR_SYNTAX);
	assert_int_equal(import("{'type':1,'type':2}", &imported, &faults),
	    ERR_SYNTAX);
}

static enum err import_nested(int depth)
{
	struct draft *d = malloc(sizeof *d);
	struct imported imported = {0};
	struct faults faults;
	enum err err;

	assert_non_null(d);
	d->length = 0;
	for (int i = 1; i < depth; i++)
		put(d, "{'type':'MinNode','children':[");
	put(d, LEFT);
	for (int i = 1; i < depth; i++)
		put(d, "]}");
	err = import(d->text, &imported, &faults);
	import_fini(&imported);
	free(d);
	return err;
}

static void test_depth_is_limited_as_a_document_s(void **state)
{
	(void)state;
	assert_int_equal(import_nested(DOCUMENT_DEPTH_MAX), ERR_OK);
	assert_int_equal(import_nested(DOCUMENT_DEPTH_MAX + 1), ERR_LIMIT);
}

static void test_nodes_are_limited_as_a_document_s(void **state)
{
	static const char text[] = ROOT(LEFT "," RIGHT "," BAR);
	struct document_limits few = limits;
	struct imported imported;
	struct faults faults = {0};
	char *quoted = quote(text);

	(void)state;
	few.max_nodes = 4;
	assert_int_equal(import_blobtree(quoted, strlen(quoted), &few,
	    &imported, &faults), ERR_OK);
	import_fini(&imported);
	few.max_nodes = 3;
	assert_int_equal(import_blobtree(quoted, strlen(quoted), &few,
	    &imported, &faults), ERR_LIMIT);
	assert_string_equal(faults.list[0].pointer, "/children/2");
	free(quoted);
}

static void test_every_failing_allocation_is_survived(void **state)
{
	static const char text[] = ROOT(TWIST("1", "0", "1", "0", LEFT) ","
	    SDF("1", SPHERE("1")));
	char *quoted = quote(text), *answer;
	struct imported imported;
	struct faults faults = {0};
	size_t length;
	enum err err;
	long n = 0;

	(void)state;
	if (!fail_alloc_available()) {
		free(quoted);
		skip();
	}
	do {
		fail_alloc_set(++n);
		err = import_blobtree(quoted, strlen(quoted), &limits,
		    &imported, &faults);
		if (err == ERR_OK) {
			err = import_answer(&imported, &answer, &length);
			if (err == ERR_OK)
				free(answer);
			import_fini(&imported);
		}
		assert_int_equal(err, fail_alloc_happened() ? ERR_MEMORY :
		    ERR_OK);
		assert_int_equal(fail_alloc_live(), 0);
	} while (err != ERR_OK);
	fail_alloc_set(0);
	assert_true(n > 5);
	free(quoted);
}

int main(void)
{
	static const struct CMUnitTest tests[] = {
		cmocka_unit_test(test_points_have_the_library_s_field),
		cmocka_unit_test(test_a_point_s_surface_is_at_its_thickness),
		cmocka_unit_test(
		    test_segments_of_equal_thickness_have_the_field),
		cmocka_unit_test(
		    test_triangles_of_equal_thickness_have_the_field),
		cmocka_unit_test(
		    test_distances_at_their_functor_s_scale_have_the_field),
		cmocka_unit_test(test_riccis_have_the_field),
		cmocka_unit_test(test_root_differs_by_what_its_powers_lose),
		cmocka_unit_test(test_min_and_max_have_the_field),
		cmocka_unit_test(test_differences_have_the_field),
		cmocka_unit_test(test_alpha_of_0_is_1),
		cmocka_unit_test(test_scales_have_the_field),
		cmocka_unit_test(test_shrinking_is_whole),
		cmocka_unit_test(test_twists_have_the_field),
		cmocka_unit_test(
		    test_odd_twist_axes_are_taken_as_the_library_does),
		cmocka_unit_test(test_a_twist_within_its_box_is_the_library_s),
		cmocka_unit_test(test_iso_is_where_the_surface_is),
		cmocka_unit_test(test_nodes_without_children_are_0),
		cmocka_unit_test(test_random_trees_have_the_field),
		cmocka_unit_test(test_numbers_read_back_exactly),
		cmocka_unit_test(test_colors_become_linear),
		cmocka_unit_test(
		    test_vertices_colors_are_averaged_with_a_warning),
		cmocka_unit_test(test_other_members_of_materials_are_warned_of),
		cmocka_unit_test(test_no_materials_is_the_library_s_default),
		cmocka_unit_test(test_what_is_taken_otherwise_is_warned_of),
		cmocka_unit_test(test_answer_has_document_and_warnings),
		cmocka_unit_test(test_many_warnings_are_counted),
		cmocka_unit_test(test_what_has_no_equal_is_refused_by_name),
		cmocka_unit_test(test_what_is_wrong_is_said_where),
		cmocka_unit_test(test_every_refusal_is_listed),
		cmocka_unit_test(test_what_is_not_json_is_a_syntax_error),
		cmocka_unit_test(test_depth_is_limited_as_a_document_s),
		cmocka_unit_test(test_nodes_are_limited_as_a_document_s),
		cmocka_unit_test(test_every_failing_allocation_is_survived),
	};

	return cmocka_run_group_tests(tests, NULL, NULL);
}
