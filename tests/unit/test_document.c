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

#include "core/classic.h"
#include "core/evaluate.h"
#include "core/table.h"
#include "core/tape.h"
#include "proto/arena.h"
#include "proto/document.h"
#include "proto/fault.h"
#include "proto/json.h"
#include "tests/support/fail_alloc.h"

#define COUNT(array) (sizeof(array) / sizeof *(array))
#define PI 3.14159265358979323846

/* A whole document around a root, written with ' for ". */
#define DOC(root) "{'format':'blobfield/1','root':" root "}"
#define SPHERE "{'type':'sphere','center':[0,0,0],'radius':1,'falloff':1}"
#define POINT "{'type':'point','center':[0,0,0],'radius':1}"

static const struct document_limits limits = {.max_nodes = 1000,
    .layout = LAYOUT_WARPED};

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

static enum err parse(const char *text, struct document **out,
    struct faults *faults)
{
	char *quoted = quote(text);
	enum err err;

	*faults = (struct faults){0};
	err = document_parse(quoted, strlen(quoted), &limits, out, faults);
	free(quoted);
	return err;
}

static struct document *parse_well(const char *text)
{
	struct document *document;
	struct faults faults;

	if (parse(text, &document, &faults) != ERR_OK)
		fail_msg("%s\n%s: %s", text, faults.list[0].pointer,
		    faults.list[0].detail);
	assert_int_equal(faults.count, 0);
	assert_non_null(document_tape(document));
	return document;
}

/* Parses text, and finds a fault at pointer whose detail has these words. */
static void check_refused(const char *text, enum err expected,
    const char *pointer, const char *words)
{
	struct document *document = NULL;
	struct faults faults;
	enum err err = parse(text, &document, &faults);
	size_t i;

	if (err != expected)
		fail_msg("%s\ngives %s (%s: %s)", text, err_message(err),
		    faults.list[0].pointer, faults.list[0].detail);
	assert_null(document);
	for (i = 0; i < faults.count && i < FAULT_MAX; i++) {
		if (strcmp(faults.list[i].pointer, pointer) == 0 &&
		    strstr(faults.list[i].detail, words))
			return;
	}
	fail_msg("%s\ngives %zu, first %s: %s", text, faults.count,
	    faults.list[0].pointer, faults.list[0].detail);
}

static const struct primitive *root_primitive(const struct document *d)
{
	return &document_tree(d)->root->primitive;
}

static void check_vec3(struct vec3 v, double x, double y, double z)
{
	assert_true(fabs(v.x - x) < 1e-15 && fabs(v.y - y) < 1e-15 &&
	    fabs(v.z - z) < 1e-15);
}

#define EXAMPLE(material) \
	"{'format': 'blobfield/1', 'name': 'letter A'," \
	" 'operators': {'joint': {'profile': {'type': 'bulge', 'k': 0.8}," \
	" 'opening': {'alpha': [0, 1.5708, 3.1416]," \
	" 'theta': [0.7854, 0, 0.7854], 'w': [1, 1]}}}," \
	" 'root': {'type': 'union', 'operator': 'camel', 'id': 'body'," \
	" 'children': [{'type': 'segment', 'id': 'leg', 'a': [-1,0,0]," \
	" 'b': [0,0,2], 'radius': 0.25" material "}," \
	" {'type': 'segment', 'a': [1,0,0], 'b': [0,0,2]," \
	" 'radius': 0.25}]}}"

static void test_example_of_the_specification(void **unused)
{
	struct document *d = parse_well(
	    EXAMPLE(", 'material': {'color': [0.8,0.2,0.1]}"));
	const struct node *root = document_tree(d)->root, *leg;
	struct opening camel;

	(void)unused;
	assert_string_equal(document_name(d), "letter A");
	assert_true(document_tree(d)->null_gradient == TREE_NULL_GRADIENT);
	assert_int_equal(root->type, NODE_UNION);
	assert_string_equal(root->id, "body");
	assert_null(root->parent);
	assert_false(root->sharp);
	assert_true(opening_named("camel", &camel));
	assert_true(opening_equal(&root->op->opening, &camel));
	assert_int_equal(root->op->profile.type, PROFILE_SMOOTH);
	assert_int_equal(root->child_count, 2);
	leg = root->children[0];
	assert_string_equal(leg->id, "leg");
	assert_ptr_equal(leg->parent, root);
	assert_int_equal(root->children[1]->index, 1);
	assert_int_equal(leg->primitive.type, PRIMITIVE_SEGMENT);
	check_vec3(leg->primitive.a, -1, 0, 0);
	check_vec3(leg->primitive.b, 0, 0, 2);
	assert_true(leg->primitive.radius[0] == 0.25);
	assert_true(leg->primitive.radius[1] == 0.25);
	assert_true(leg->primitive.exponent == 3.0);
	assert_true(leg->primitive.weight == 1.0);
	assert_true(leg->has_color && !root->has_color);
	check_vec3(leg->color, 0.8, 0.2, 0.1);
	assert_int_equal(document_tape(d)->node_count, 3);
	document_free(d);
}

static void test_every_soft_object(void **unused)
{
	const struct primitive *p;
	struct document *d;

	(void)unused;
	d = parse_well(DOC("{'type':'point','center':[1,2,3],'radius':0.5,"
	    "'exponent':4,'weight':-0}"));
	p = root_primitive(d);
	assert_int_equal(p->type, PRIMITIVE_POINT);
	check_vec3(p->a, 1, 2, 3);
	assert_true(p->radius[0] == 0.5 && p->exponent == 4 && p->weight == 0);
	document_free(d);
	d = parse_well(DOC("{'type':'segment','a':[1,2,3],'b':[4,5,6],"
	    "'radii':[0.5,0.75],'exponent':100,'weight':1e6}"));
	p = root_primitive(d);
	assert_int_equal(p->type, PRIMITIVE_SEGMENT);
	check_vec3(p->b, 4, 5, 6);
	assert_true(p->radius[0] == 0.5 && p->radius[1] == 0.75);
	assert_true(p->exponent == 100 && p->weight == 1e6);
	document_free(d);
	d = parse_well(DOC("{'type':'triangle','a':[1,2,3],'b':[4,5,6],"
	    "'c':[7,8,9],'radius':2}"));
	p = root_primitive(d);
	assert_int_equal(p->type, PRIMITIVE_TRIANGLE);
	check_vec3(p->c, 7, 8, 9);
	assert_true(p->radius[0] == 2 && p->exponent == 3 && p->weight == 1);
	document_free(d);
	d = parse_well(DOC("{'type':'disc','center':[1,2,3],'normal':[0,0,-5],"
	    "'disc_radius':3,'radius':2}"));
	p = root_primitive(d);
	assert_int_equal(p->type, PRIMITIVE_DISC);
	check_vec3(p->normal, 0, 0, -1);
	assert_true(p->major == 3 && p->radius[0] == 2);
	document_free(d);
	d = parse_well(DOC("{'type':'circle','center':[1,2,3],"
	    "'normal':[3e-300,0,4e-300],'ring_radius':3,'radius':2}"));
	p = root_primitive(d);
	assert_int_equal(p->type, PRIMITIVE_CIRCLE);
	check_vec3(p->normal, 0.6, 0, 0.8);
	assert_true(p->major == 3);
	document_free(d);
}

static void test_every_solid(void **unused)
{
	const struct primitive *p;
	struct document *d;

	(void)unused;
	d = parse_well(DOC("{'type':'sphere','center':[1,2,3],'radius':2,"
	    "'falloff':0.5}"));
	p = root_primitive(d);
	assert_int_equal(p->type, PRIMITIVE_SPHERE);
	assert_true(p->radius[0] == 2 && p->falloff == 0.5);
	document_free(d);
	d = parse_well(DOC("{'type':'box','center':[1,2,3],"
	    "'half_size':[1,2,3],'rounding':1,'falloff':0.5}"));
	p = root_primitive(d);
	assert_int_equal(p->type, PRIMITIVE_BOX);
	check_vec3(p->half_size, 1, 2, 3);
	assert_true(p->rounding == 1);
	document_free(d);
	d = parse_well(DOC("{'type':'box','center':[1,2,3],"
	    "'half_size':[1,2,3],'falloff':0.5}"));
	assert_true(root_primitive(d)->rounding == 0);
	document_free(d);
	d = parse_well(DOC("{'type':'cylinder','a':[1,2,3],'b':[4,5,6],"
	    "'radius':2,'falloff':0.5}"));
	assert_int_equal(root_primitive(d)->type, PRIMITIVE_CYLINDER);
	document_free(d);
	d = parse_well(DOC("{'type':'capsule','a':[1,2,3],'b':[4,5,6],"
	    "'radius':2,'falloff':0.5}"));
	assert_int_equal(root_primitive(d)->type, PRIMITIVE_CAPSULE);
	document_free(d);
	d = parse_well(DOC("{'type':'cone','a':[1,2,3],'b':[4,5,6],"
	    "'radii':[2,0],'falloff':0.5}"));
	p = root_primitive(d);
	assert_int_equal(p->type, PRIMITIVE_CONE);
	assert_true(p->radius[0] == 2 && p->radius[1] == 0);
	document_free(d);
	d = parse_well(DOC("{'type':'torus','center':[1,2,3],'axis':[0,2,0],"
	    "'major':2,'minor':0.25,'falloff':0.5}"));
	p = root_primitive(d);
	assert_int_equal(p->type, PRIMITIVE_TORUS);
	check_vec3(p->normal, 0, 1, 0);
	assert_true(p->major == 2 && p->minor == 0.25);
	document_free(d);
	d = parse_well(DOC("{'type':'plane','point':[1,2,3],'normal':[2,0,0],"
	    "'falloff':0.5}"));
	p = root_primitive(d);
	assert_int_equal(p->type, PRIMITIVE_PLANE);
	check_vec3(p->a, 1, 2, 3);
	check_vec3(p->normal, 1, 0, 0);
	document_free(d);
}

static void test_every_composition(void **unused)
{
	static const struct {
		const char *text;
		enum node_type type;
		enum operator_family family;
	} cases[] = {
		{DOC("{'type':'union','children':[" SPHERE "," POINT "]}"),
		    NODE_UNION, FAMILY_UNION},
		{DOC("{'type':'intersection','children':[" SPHERE "," SPHERE
		    "]}"), NODE_INTERSECTION, FAMILY_INTERSECTION},
		{DOC("{'type':'difference','operator':'blend',"
		    "'children':[" SPHERE "," SPHERE "," SPHERE "]}"),
		    NODE_DIFFERENCE, FAMILY_INTERSECTION},
		{DOC("{'type':'sum','children':[" SPHERE "]}"), NODE_SUM,
		    FAMILY_COUNT},
		{DOC("{'type':'ricci','n':2.5,'children':[" SPHERE "]}"),
		    NODE_RICCI, FAMILY_COUNT},
	};
	const struct node *root;
	const struct tape *tape;
	struct document *d;
	size_t i;

	(void)unused;
	for (i = 0; i < COUNT(cases); i++) {
		d = parse_well(cases[i].text);
		root = document_tree(d)->root;
		assert_int_equal(root->type, cases[i].type);
		tape = document_tape(d);
		assert_int_equal(tape->operator_count, root->op ? 1 : 0);
		assert_int_equal(root->op ? tape->operators[0].family :
		    FAMILY_COUNT, cases[i].family);
		if (root->type == NODE_RICCI)
			assert_true(root->n == 2.5);
		document_free(d);
	}
}

/* The operator of a union whose "operator" is text, as the tape has it; sharp:
 * that of no name. */
static struct operator with_operator(const char *text)
{
	char buffer[8192];
	struct document *d;
	struct operator op = {.family = FAMILY_COUNT};

	snprintf(buffer, sizeof buffer, "{'format':'blobfield/1','operators':"
	    "{'mine':{'profile':'circle','opening':{'theta':0.25}}},"
	    "'root':{'type':'union'%s%s,'children':[" POINT "," POINT "]}}",
	    *text ? ",'operator':" : "", text);
	d = parse_well(buffer);
	if (document_tape(d)->operator_count)
		op = document_tape(d)->operators[0];
	document_free(d);
	return op;
}

static void test_named_operators(void **unused)
{
	static const char *const named[] = {"camel", "organic", "contact"};
	struct opening opening;
	struct operator n;
	char text[32];
	size_t i;

	(void)unused;
	n = with_operator("");
	assert_int_equal(n.profile.type, PROFILE_SMOOTH);
	assert_true(opening_is_constant(&n.opening));
	assert_true(n.opening.theta[0] == PI / 4);
	assert_int_equal(n.layout, LAYOUT_WARPED);
	assert_int_equal(n.resolution, TABLE_RESOLUTION_WARPED);
	assert_true(with_operator("'clean'").opening.theta[1] == PI / 4);
	n = with_operator("'blend'");
	assert_true(opening_is_constant(&n.opening));
	assert_true(n.opening.theta[0] == 0);
	assert_int_equal(with_operator("'sharp'").family, FAMILY_COUNT);
	for (i = 0; i < COUNT(named); i++) {
		snprintf(text, sizeof text, "'%s'", named[i]);
		n = with_operator(text);
		assert_true(opening_named(named[i], &opening));
		assert_true(opening_equal(&n.opening, &opening));
		assert_int_equal(n.profile.type, i == 2 ? PROFILE_BULGE :
		    PROFILE_SMOOTH);
	}
	assert_true(n.profile.k == 0.8);
	n = with_operator("'mine'");
	assert_int_equal(n.profile.type, PROFILE_CIRCLE);
	assert_true(opening_is_constant(&n.opening));
	assert_true(n.opening.theta[2] == 0.25);
	assert_int_equal(n.family, FAMILY_UNION);
}

static void test_nodes_share_the_operators_of_a_name(void **unused)
{
	struct document *d = parse_well("{'format':'blobfield/1','operators':"
	    "{'b':{'opening':'camel'},'a':{}},'root':{'type':'sum','children':["
	    "{'type':'union','operator':'b','children':[" POINT "]},"
	    "{'type':'difference','operator':'b','children':[" POINT "]},"
	    "{'type':'union','operator':'camel','children':[" POINT "]},"
	    "{'type':'difference','operator':'camel','children':[" POINT "]},"
	    "{'type':'union','operator':'a','children':[" POINT "]}," POINT
	    "]}}");
	struct node **children = document_tree(d)->root->children;

	(void)unused;
	assert_ptr_equal(children[0]->op, children[1]->op);
	assert_ptr_equal(children[2]->op, children[3]->op);
	assert_ptr_not_equal(children[0]->op, children[2]->op);
	assert_true(opening_equal(&children[0]->op->opening,
	    &children[2]->op->opening));
	assert_true(opening_is_constant(&children[4]->op->opening));
	assert_null(children[5]->op);
	assert_null(document_tree(d)->root->op);
	document_free(d);
}

static void test_inline_operators(void **unused)
{
	struct operator n;

	(void)unused;
	n = with_operator("{}");
	assert_int_equal(n.profile.type, PROFILE_SMOOTH);
	assert_true(n.opening.theta[0] == PI / 4);
	n = with_operator("{'profile':{'type':'bulge'},'layout':'uniform'}");
	assert_true(n.profile.type == PROFILE_BULGE &&
	    n.profile.k == 0.8);
	assert_int_equal(n.layout, LAYOUT_UNIFORM);
	assert_int_equal(n.resolution, TABLE_RESOLUTION_UNIFORM);
	n = with_operator("{'resolution':8,'layout':'uniform',"
	    "'profile':{'k':0,'type':'bulge'},'opening':'contact'}");
	assert_int_equal(n.resolution, 8);
	assert_true(n.profile.k == 0);
	assert_true(n.opening.w[1] == 0.7);
	n = with_operator("{'opening':{'alpha':[0.5,1,2],"
	    "'theta':[0.1,0.2,0.3]}}");
	assert_true(n.opening.alpha[1] == 1 && n.opening.theta[2] == 0.3);
	assert_true(n.opening.w[0] == 1 && n.opening.w[1] == 1);
	n = with_operator("{'profile':{'type':'samples','points':"
	    "[[0,1],[0.4,0.98],[0.7,0.9],[0.85,0.85]]}}");
	assert_int_equal(n.profile.type, PROFILE_SAMPLES);
	assert_int_equal(n.profile.count, 4);
	assert_int_equal(with_operator("{'profile':'bulge'}").profile.type,
	    PROFILE_BULGE);
}

static void test_rounded_angles_are_drawn_into_range(void **unused)
{
	struct operator n = with_operator("{'opening':{'alpha':[-0.0005,1,3.1416],"
	    "'theta':[0.7854,0.7860,0],'w':[2,3]}}");

	(void)unused;
	assert_true(n.opening.alpha[0] == 0);
	assert_true(n.opening.alpha[2] == PI);
	assert_true(n.opening.theta[0] == PI / 4);
	assert_true(n.opening.theta[1] == PI / 4);
	assert_true(n.opening.w[0] == 2 && n.opening.w[1] == 3);
	n = with_operator("{'opening':{'theta':0.7857}}");
	assert_true(n.opening.theta[1] == PI / 4);
}

static void test_transforms(void **unused)
{
	struct document *d;
	const struct affine *m;
	struct vec3 p;

	(void)unused;
	d = parse_well(DOC(SPHERE));
	assert_false(document_tree(d)->root->has_transform);
	document_free(d);
	d = parse_well(DOC("{'type':'point','center':[0,0,0],'radius':1,"
	    "'translation':[1,2,3],'rotation':[0,0,0.70711,0.70711],"
	    "'scale':[2,-3,4]}"));
	assert_true(document_tree(d)->root->has_transform);
	/* x scaled by 2, turned by a quarter about z, moved */
	m = &document_tree(d)->root->transform;
	p = affine_point(m, vec3(1, 0, 0));
	assert_true(fabs(p.x - 1) < 1e-12 && fabs(p.y - 4) < 1e-12 && p.z == 3);
	document_free(d);
	d = parse_well(DOC("{'type':'point','center':[0,0,0],'radius':1,"
	    "'scale':2}"));
	p = affine_point(&document_tree(d)->root->transform, vec3(1, 1, 1));
	assert_true(p.x == 2 && p.y == 2 && p.z == 2);
	document_free(d);
	d = parse_well(DOC("{'type':'point','center':[0,0,0],'radius':1,"
	    "'matrix':[1,2,3,0, 0,5,6,0, 0,0,9,0, 10,11,12,1]}"));
	p = affine_point(&document_tree(d)->root->transform, vec3(1, 0, 0));
	check_vec3(p, 11, 13, 15);
	document_free(d);
}

static void test_refs(void **unused)
{
	struct document *d = parse_well(DOC("{'type':'union','children':["
	    "{'type':'ref','ref':'b','translation':[1,0,0]},"
	    "{'type':'point','id':'b','center':[0,0,0],'radius':1},"
	    "{'type':'ref','ref':'b','id':'b2'}]}"));
	const struct node *root = document_tree(d)->root;

	(void)unused;
	assert_int_equal(root->children[0]->type, NODE_REF);
	assert_ptr_equal(root->children[0]->target, root->children[1]);
	assert_ptr_equal(root->children[2]->target, root->children[1]);
	assert_string_equal(root->children[2]->id, "b2");
	document_free(d);
}

static void test_top_level_settings(void **unused)
{
	struct document *d = parse_well("{'root':" SPHERE ",'format':"
	    "'blobfield/1','null_gradient':0.25,'operators':{}}");

	(void)unused;
	assert_true(document_tree(d)->null_gradient == 0.25);
	assert_string_equal(document_name(d), "");
	document_free(d);
	document_free(NULL);
}

static void test_layout_defaults_to_the_limits(void **unused)
{
	const struct document_limits uniform = {.max_nodes = 10,
	    .layout = LAYOUT_UNIFORM};
	char *text = quote(DOC("{'type':'union','children':[" SPHERE "]}"));
	struct faults faults = {0};
	struct document *d;

	(void)unused;
	assert_int_equal(document_parse(text, strlen(text), &uniform, &d,
	    &faults), ERR_OK);
	assert_int_equal(document_tree(d)->root->op->layout, LAYOUT_UNIFORM);
	assert_int_equal(document_tree(d)->root->op->resolution,
	    TABLE_RESOLUTION_UNIFORM);
	document_free(d);
	free(text);
}

static void test_tape_can_be_taken(void **unused)
{
	struct document *d = parse_well(DOC(POINT));
	struct tape *tape = document_take_tape(d);
	struct jet jet;

	(void)unused;
	assert_null(document_tape(d));
	document_free(d);
	evaluate(tape, vec3(0, 0, 0), 0, &jet);
	assert_true(fabs(jet.value - 1.0) < 1e-12);
	tape_free(tape);
}

#define NODE(type, rest) DOC("{'type':'" type "'," rest "}")
#define UNION(rest) DOC("{'type':'union'," rest ",'children':[" POINT "]}")
#define PLACED(rest) \
	DOC("{'type':'point','center':[0,0,0],'radius':1," rest "}")

static const struct {
	const char *text, *pointer, *words;
} wrong[] = {
	/* the top level */
	{"[]", "", "a document must be an object, not an array"},
	{"{}", "", "'format' is missing"},
	{"{}", "", "'root' is missing"},
	{"{'format':'blobfield/2','root':" SPHERE "}", "/format",
	    "must be \"blobfield/1\""},
	{"{'format':1,'root':" SPHERE "}", "/format", "must be"},
	{"{'format':'blobfield/1','rot':" SPHERE "}", "/rot",
	    "unknown field 'rot'; did you mean 'root'?"},
	{"{'format':'blobfield/1','x':1,'root':" SPHERE "}", "/x",
	    "unknown field 'x'"},
	{"{'format':'blobfield/1','name':3,'root':" SPHERE "}", "/name",
	    "must be a string, not a number"},
	{"{'format':'blobfield/1','null_gradient':0,'root':" SPHERE "}",
	    "/null_gradient", "must be between 1e-06 and 1, not 0"},
	{"{'format':'blobfield/1','null_gradient':1.5,'root':" SPHERE "}",
	    "/null_gradient", "between"},
	{DOC("[]"), "/root", "a node must be an object, not an array"},
	{DOC("null"), "/root", "not null"},
	{DOC("{}"), "/root", "'type' is missing"},
	{DOC("{'type':7}"), "/root/type", "must be a string"},
	{DOC("{'type':'spere'}"), "/root/type",
	    "unknown node type 'spere'; did you mean 'sphere'?"},
	{DOC("{'type':'teapot'}"), "/root/type", "unknown node type 'teapot'"},
	/* fields of primitives */
	{NODE("point", "'center':[0,0,0],'raduis':1"), "/root/raduis",
	    "unknown field 'raduis'; did you mean 'radius'?"},
	{NODE("point", "'center':[0,0,0]"), "/root", "'radius' is missing"},
	{NODE("point", "'radius':1"), "/root", "'center' is missing"},
	{NODE("point", "'center':[0,0],'radius':1"), "/root/center",
	    "must have 3 numbers, not 2"},
	{NODE("point", "'center':{},'radius':1"), "/root/center",
	    "must be an array of 3 numbers, not an object"},
	{NODE("point", "'center':[0,'a',0],'radius':1"), "/root/center/1",
	    "must be a number, not a string"},
	{NODE("point", "'center':[0,0,2e9],'radius':1"), "/root/center/2",
	    "between -1000000000 and 1000000000"},
	{NODE("point", "'center':[0,0,1e999],'radius':1"), "/root/center/2",
	    "too large"},
	{NODE("point", "'center':[0,0,-1e999],'radius':1"), "/root/center/2",
	    "too large"},
	{NODE("point", "'center':[0,0,0],'radius':0"), "/root/radius",
	    "between 1e-09 and"},
	{NODE("point", "'center':[0,0,0],'radius':-1"), "/root/radius",
	    "not -1"},
	{NODE("point", "'center':[0,0,0],'radius':true"), "/root/radius",
	    "must be a number, not a boolean"},
	{PLACED("'exponent':2.5"), "/root/exponent", "between 3 and 100"},
	{PLACED("'exponent':101"), "/root/exponent", "between"},
	{PLACED("'weight':-1"), "/root/weight", "between 0 and 1000000"},
	{PLACED("'weight':2e6"), "/root/weight", "between"},
	{PLACED("'falloff':1"), "/root/falloff", "unknown field 'falloff'"},
	{NODE("segment", "'a':[0,0,0],'b':[1,0,0]"), "/root",
	    "needs 'radius' or 'radii'"},
	{NODE("segment", "'a':[0,0,0],'b':[1,0,0],'radius':1,'radii':[1,2]"),
	    "/root", "has both"},
	{NODE("segment", "'a':[0,0,0],'b':[1,0,0],'radii':[1,0]"),
	    "/root/radii/1", "between"},
	{NODE("segment", "'a':[0,0,0],'radius':1"), "/root", "'b' is missing"},
	{NODE("triangle", "'a':[0,0,0],'b':[1,0,0],'radius':1"), "/root",
	    "'c' is missing"},
	{NODE("disc", "'center':[0,0,0],'normal':[0,0,0],'disc_radius':1,"
	    "'radius':1"), "/root/normal", "null vector"},
	{NODE("disc", "'center':[0,0,0],'normal':[0,0,1],'disc_radius':0,"
	    "'radius':1"), "/root/disc_radius", "between"},
	{NODE("circle", "'center':[0,0,0],'normal':[0,0,1],'radius':1"),
	    "/root", "'ring_radius' is missing"},
	{NODE("sphere", "'center':[0,0,0],'radius':1"), "/root",
	    "'falloff' is missing"},
	{NODE("sphere", "'center':[0,0,0],'radius':1,'falloff':0"),
	    "/root/falloff", "between"},
	{NODE("box", "'center':[0,0,0],'half_size':[1,0,1],'falloff':1"),
	    "/root/half_size/1", "between"},
	{NODE("box", "'center':[0,0,0],'half_size':[1,2,3],'rounding':1.5,"
	    "'falloff':1"), "/root/rounding", "least half_size, 1"},
	{NODE("box", "'center':[0,0,0],'half_size':[1,2,3],'rounding':-1,"
	    "'falloff':1"), "/root/rounding", "between 0"},
	{NODE("cylinder", "'a':[0,0,0],'b':[1,0,0],'falloff':1"), "/root",
	    "'radius' is missing"},
	{NODE("capsule", "'a':[0,0,0],'b':[1,0,0],'falloff':1,'radius':[]"),
	    "/root/radius", "must be a number, not an array"},
	{NODE("cone", "'a':[0,0,0],'b':[1,0,0],'radii':[0,0],'falloff':1"),
	    "/root/radii", "must not both be 0"},
	{NODE("cone", "'a':[0,0,0],'b':[1,0,0],'radii':[1,-1],'falloff':1"),
	    "/root/radii/1", "between"},
	{NODE("cone", "'a':[0,0,0],'b':[1,0,0],'radii':[1,1e-10],"
	    "'falloff':1"), "/root/radii/1", "0 or at least"},
	{NODE("torus", "'center':[0,0,0],'axis':[0,0,1],'major':1,'minor':0,"
	    "'falloff':1"), "/root/minor", "between"},
	{NODE("torus", "'center':[0,0,0],'normal':[0,0,1],'major':1,"
	    "'minor':1,'falloff':1"), "/root/normal", "unknown field"},
	{NODE("plane", "'point':[0,0,0],'falloff':1"), "/root",
	    "'normal' is missing"},
	/* compositions */
	{DOC("{'type':'union'}"), "/root", "'children' is missing"},
	{DOC("{'type':'union','children':[]}"), "/root/children",
	    "1 or more nodes"},
	{DOC("{'type':'sum','children':{}}"), "/root/children",
	    "1 or more nodes"},
	{DOC("{'type':'sum','operator':'clean','children':[" POINT "]}"),
	    "/root/operator", "unknown field"},
	{DOC("{'type':'sum','children':[" POINT ",3]}"), "/root/children/1",
	    "must be an object, not a number"},
	{DOC("{'type':'ricci','children':[" POINT "]}"), "/root",
	    "'n' is missing"},
	{DOC("{'type':'ricci','n':0.5,'children':[" POINT "]}"), "/root/n",
	    "between 1 and 1000"},
	{DOC("{'type':'sum','children':[{'type':'sum','children':["
	    "{'type':'point','center':[0,0,0],'radius':1,'a/b~c':0}]}]}"),
	    "/root/children/0/children/0/a~1b~0c", "unknown field 'a/b~c'"},
	/* operators */
	{UNION("'operator':'joint'"), "/root/operator",
	    "unknown operator 'joint'"},
	{UNION("'operator':3"), "/root/operator", "a name or an object"},
	{UNION("'operator':{'profil':'smooth'}"), "/root/operator/profil",
	    "did you mean 'profile'?"},
	{UNION("'operator':{'profile':'wavy'}"), "/root/operator/profile",
	    "unknown profile 'wavy'"},
	{UNION("'operator':{'profile':3}"), "/root/operator/profile",
	    "must be an object"},
	{UNION("'operator':{'profile':{'type':'bulge','k':1.5}}"),
	    "/root/operator/profile/k", "between 0 and 1"},
	{UNION("'operator':{'profile':{'type':'smooth','k':0.5}}"),
	    "/root/operator/profile/k", "unknown field"},
	{UNION("'operator':{'profile':{'type':'samples'}}"),
	    "/root/operator/profile", "'points' is missing"},
	{UNION("'operator':{'profile':{'type':'samples','points':[[0,1]]}}"),
	    "/root/operator/profile/points", "3 to 64"},
	{UNION("'operator':{'profile':{'type':'samples','points':"
	    "[[0,1],[0.5,0.99],[0.4,0.9],[0.8,0.8]]}}"),
	    "/root/operator/profile/points/2", ""},
	{UNION("'operator':{'profile':{'type':'samples','points':"
	    "[[0,1],[0.5],[1,0]]}}"),
	    "/root/operator/profile/points/1", "must have 2 numbers"},
	{UNION("'operator':{'opening':'wide'}"), "/root/operator/opening",
	    "unknown opening 'wide'"},
	{UNION("'operator':{'opening':[]}"), "/root/operator/opening",
	    "not an array"},
	{UNION("'operator':{'opening':{}}"), "/root/operator/opening",
	    "'theta' is missing"},
	{UNION("'operator':{'opening':{'theta':[0,0,0]}}"),
	    "/root/operator/opening", "'alpha' is missing"},
	{UNION("'operator':{'opening':{'theta':0.8}}"),
	    "/root/operator/opening/theta", "between"},
	{UNION("'operator':{'opening':{'theta':[0,0,0],'alpha':[0,2,1]}}"),
	    "/root/operator/opening/alpha/2", "alpha0 <= alpha1"},
	{UNION("'operator':{'opening':{'theta':[0,0,0],'alpha':[0,2,3.2]}}"),
	    "/root/operator/opening/alpha/2", "between"},
	{UNION("'operator':{'opening':{'theta':[0,0,0],'alpha':[0,1,2],"
	    "'w':[1,0]}}"), "/root/operator/opening/w/1", "between"},
	{UNION("'operator':{'opening':{'theta':[0,0,0],'alpha':[0,1,1.009]}}"),
	    "/root/operator/opening/alpha/2", "at least 0.01"},
	{UNION("'operator':{'layout':'paper'}"), "/root/operator/layout",
	    "\"warped\" or \"uniform\""},
	{UNION("'operator':{'resolution':7}"), "/root/operator/resolution",
	    "between 8 and 128"},
	{UNION("'operator':{'resolution':16.5}"), "/root/operator/resolution",
	    "whole number"},
	{"{'format':'blobfield/1','operators':[],'root':" SPHERE "}",
	    "/operators", "must be an object, not an array"},
	{"{'format':'blobfield/1','operators':{'camel':{}},'root':" SPHERE "}",
	    "/operators/camel", "built-in"},
	{"{'format':'blobfield/1','operators':{'a b':{}},'root':" SPHERE "}",
	    "/operators/a b", "characters"},
	{"{'format':'blobfield/1','operators':{'x':'camel'},'root':" SPHERE
	    "}", "/operators/x", "must be an object, not a string"},
	/* ids and refs */
	{PLACED("'id':''"), "/root/id", "1 to 64"},
	{PLACED("'id':'a b'"), "/root/id", "1 to 64"},
	{PLACED("'id':5"), "/root/id", "must be a string"},
	{PLACED("'id':'0123456789012345678901234567890123456789"
	    "0123456789012345678901234'"), "/root/id", "1 to 64"},
	{DOC("{'type':'sum','children':[{'type':'point','id':'x','center':"
	    "[0,0,0],'radius':1},{'type':'point','id':'x','center':[0,0,0],"
	    "'radius':1}]}"), "/root/children/1/id", "has this id already"},
	{DOC("{'type':'sum','id':'r','children':[{'type':'ref','ref':'q'}]}"),
	    "/root/children/0/ref", "no node has this id"},
	{DOC("{'type':'ref'}"), "/root", "'ref' is missing"},
	{DOC("{'type':'sum','id':'r','children':[{'type':'sum','children':["
	    "{'type':'ref','ref':'r'}]}]}"), "/root/children/0/children/0", ""},
	{DOC("{'type':'ref','id':'r','ref':'r'}"), "/root", ""},
	{DOC("{'type':'sum','children':[{'type':'ref','id':'a','ref':'b'},"
	    "{'type':'ref','id':'b','ref':'a'}]}"), "/root/children/1", ""},
	/* transforms */
	{PLACED("'translation':[0,0]"), "/root/translation", "3 numbers"},
	{PLACED("'translation':[0,0,1e10]"), "/root/translation/2", "between"},
	{PLACED("'rotation':[0,0,0]"), "/root/rotation", "4 numbers"},
	{PLACED("'rotation':[0,0,0,1.01]"), "/root/rotation",
	    "unit quaternion (x y z w); its length is 1.01"},
	{PLACED("'scale':0"), "/root/scale", "must not be 0"},
	{PLACED("'scale':'big'"), "/root/scale", "a number or an array"},
	{PLACED("'scale':[1,1]"), "/root/scale", "3 numbers"},
	{PLACED("'scale':[1,1e-10,1]"), "/root/scale/1", "must not be 0"},
	{PLACED("'matrix':[1,0,0,0,0,1,0,0,0,0,1,0,0,0,0]"), "/root/matrix",
	    "must have 16 numbers, not 15"},
	{PLACED("'matrix':[1,0,0,0.5,0,1,0,0,0,0,1,0,0,0,0,1]"),
	    "/root/matrix", "affine"},
	{PLACED("'matrix':[1,0,0,0,0,1,0,0,0,0,1,0,0,0,0,2]"),
	    "/root/matrix", "affine"},
	{PLACED("'matrix':[1,0,0,0,2,0,0,0,0,0,1,0,0,0,0,1]"),
	    "/root/matrix", "invertible"},
	{PLACED("'matrix':[1,0,0,0,0,1,0,0,0,0,1,0,0,0,0,1],'scale':1"),
	    "/root/matrix", "excludes"},
	/* lengths in other frames, which only compiling finds */
	{DOC("{'type':'point','center':[0,0,0],'radius':1e-9,'scale':1e-9}"),
	    "/root", "must lie in"},
	{DOC("{'type':'sum','scale':1e6,'children':[{'type':'point','center':"
	    "[0,0,0],'radius':1e3,'scale':1e6}]}"), "/root/children/0",
	    "must lie in"},
};

static void test_wrong_documents_are_refused_where_they_are_wrong(void **unused)
{
	size_t i;

	(void)unused;
	for (i = 0; i < COUNT(wrong); i++)
		check_refused(wrong[i].text, ERR_INVALID, wrong[i].pointer,
		    wrong[i].words);
}

static void test_all_faults_are_collected(void **unused)
{
	struct document *d;
	struct faults faults;

	(void)unused;
	assert_int_equal(parse("{'format':'x','nam':1,'root':{'type':'sum',"
	    "'children':[{'type':'point','center':[0,'q',1e999],'radius':-1,"
	    "'id':'?'},{'type':'nil'},{'type':'box'}]}}", &d, &faults),
	    ERR_INVALID);
	/* format, nam; q, 1e999, radius, id; nil; box lacks three */
	assert_int_equal(faults.count, 10);
	assert_string_equal(faults.list[0].pointer, "/format");
	assert_string_equal(faults.list[3].pointer,
	    "/root/children/0/center/2");
	assert_string_equal(faults.list[6].pointer, "/root/children/1/type");
}

static void test_more_faults_than_are_kept_are_counted(void **unused)
{
	char text[4096] = "{'format':'blobfield/1','root':{'type':'sum',"
	    "'children':[0";
	struct document *d;
	struct faults faults;
	int i;

	(void)unused;
	for (i = 1; i < 40; i++)
		strcat(text, ",0");
	strcat(text, "]}}");
	assert_int_equal(parse(text, &d, &faults), ERR_INVALID);
	assert_int_equal(faults.count, 40);
	assert_string_equal(faults.list[FAULT_MAX - 1].pointer,
	    "/root/children/15");
}

static const struct {
	const char *text, *pointer, *words;
} malformed[] = {
	{"", "", "line 1, column 1 (byte 0): expected a value, but the text"},
	{"  ", "", "(byte 2)"},
	{"nul", "", "expected a value"},
	{"{", "", "expected a string, but the text ends"},
	{"{'a'}", "/a", "expected ':'"},
	{"{'a':1,}", "", "expected a string"},
	{"{'a':1 'b':2}", "", "line 1, column 8 (byte 7): expected ',' or '}'"},
	{"[1,2", "", "expected ',' or ']', but the text ends"},
	{"[1,]", "/1", "expected a value"},
	{"[\n1,\n 02]", "/1", "line 3, column 3 (byte 7): not a JSON number"},
	{"[+1]", "/0", "expected a value"},
	{"[.5]", "/0", "expected a value"},
	{"[NaN]", "/0", "expected a value"},
	{"['\\x']", "/0", "unknown escape"},
	{"['\\u12g4']", "/0", "\\u escape"},
	{"['\\ud800']", "/0", "\\u escape"},
	{"['\\ud800\\u0041']", "/0", "\\u escape"},
	{"['\\udc00']", "/0", "\\u escape"},
	{"['\\u0000']", "/0", "NUL"},
	{"['a\tb']", "/0", "control character"},
	{"['\xff']", "/0", "not UTF-8"},
	{"['\xc0\xaf']", "/0", "not UTF-8"},
	{"['\xed\xa0\x80']", "/0", "not UTF-8"},
	{"['\xf4\x90\x80\x80']", "/0", "not UTF-8"},
	{"['\xe2\x82", "/0", "not UTF-8"},
	{"['abc", "/0", "expected '\"', but the text ends"},
	{"{} {}", "", "something follows the value"},
	{"\xef\xbb\xbf{}", "", "expected a value"},
	{"\v{}", "", "expected a value"},
	{"{'root':1,'root':2}", "/root", "twice"},
	{DOC("{'type':'point','center':[0,0,0],'radius':1,'radius':1}"),
	    "/root/radius", "twice"},
	{"{'a':1,'b':1,'c':1,'d':1,'e':1,'f':1,'g':1,'h':1,'i':1,'j':1,'k':1,"
	    "'l':1,'m':1,'n':1,'o':1,'p':1,'q':1,'\\u0063':1}", "/c", "twice"},
	{DOC("{'type':'point','id':'a\\u0000b'}"), "/root/id", "NUL"},
};

static void test_malformed_json_is_refused_with_its_place(void **unused)
{
	size_t i;

	(void)unused;
	for (i = 0; i < COUNT(malformed); i++)
		check_refused(malformed[i].text, ERR_SYNTAX,
		    malformed[i].pointer, malformed[i].words);
}

static void test_a_member_twice_is_told_at_the_end_of_its_object(void **unused)
{
	static const char text[] = "{\"root\":1,\"root\":2}";
	struct faults faults = {0};
	struct document *d;

	(void)unused;
	assert_int_equal(document_parse(text, sizeof text - 1, &limits, &d,
	    &faults), ERR_SYNTAX);
	assert_string_equal(faults.list[0].detail, "line 1, column 20 (byte "
	    "19): the object that ends here has this member twice");
}

static void test_operators_of_its_own_are_known(void **unused)
{
	static const char *const texts[] = {
		"{\"format\":\"blobfield/1\",\"root\":{\"type\":\"point\","
		    "\"center\":[0,0,0],\"radius\":1}}",
		"{\"format\":\"blobfield/1\",\"operators\":{},\"root\":"
		    "{\"type\":\"point\",\"center\":[0,0,0],\"radius\":1}}",
		"{\"format\":\"blobfield/1\",\"operators\":{\"a\":{}},"
		    "\"root\":{\"type\":\"point\",\"center\":[0,0,0],"
		    "\"radius\":1}}",
	};
	struct faults faults = {0};
	struct document *d;
	int i;

	(void)unused;
	for (i = 0; i < 3; i++) {
		assert_int_equal(document_parse(texts[i], strlen(texts[i]),
		    &limits, &d, &faults), ERR_OK);
		assert_int_equal(document_has_operators(d), i == 2);
		document_free(d);
	}
}

static void test_a_nul_byte_is_malformed(void **unused)
{
	static const char text[] = "{\"format\":\"blob\0field/1\"}";
	struct faults faults = {0};
	struct document *d;

	(void)unused;
	assert_int_equal(document_parse(text, sizeof text - 1, &limits, &d,
	    &faults), ERR_SYNTAX);
	assert_int_equal(document_parse("{}\0", 3, &limits, &d, &faults),
	    ERR_SYNTAX);
}

static void test_strings_are_decoded(void **unused)
{
	static const char text[] = "[\"a\\\"\\\\\\/\\b\\f\\n\\r\\t\\u0041"
	    "\\u00e9\\u20AC\\ud83d\\ude00 \xc3\xa9\", -1.5e3, true, false,"
	    " null, {}, []]";
	struct faults faults = {0};
	struct arena arena = {0};
	cJSON *json;

	(void)unused;
	assert_int_equal(json_parse(text, sizeof text - 1, 100, &arena, &json,
	    &faults), ERR_OK);
	assert_string_equal(cJSON_GetArrayItem(json, 0)->valuestring,
	    "a\"\\/\b\f\n\r\tA\xc3\xa9\xe2\x82\xac\xf0\x9f\x98\x80 \xc3\xa9");
	assert_true(cJSON_GetArrayItem(json, 1)->valuedouble == -1500.0);
	assert_true(cJSON_IsTrue(cJSON_GetArrayItem(json, 2)));
	assert_true(cJSON_IsFalse(cJSON_GetArrayItem(json, 3)));
	assert_true(cJSON_IsNull(cJSON_GetArrayItem(json, 4)));
	assert_true(cJSON_IsObject(cJSON_GetArrayItem(json, 5)));
	assert_int_equal(cJSON_GetArraySize(json), 7);
	arena_fini(&arena);
}

/* depth sums around a point. */
static char *nest(int depth)
{
	static const char open[] = "{'type':'sum','children':[";
	char *text = malloc((size_t)depth * (sizeof open + 2) + 256), *p;
	int i;

	assert_non_null(text);
	p = stpcpy(text, "{'format':'blobfield/1','root':");
	for (i = 0; i < depth; i++)
		p = stpcpy(p, open);
	p = stpcpy(p, POINT);
	for (i = 0; i < depth; i++)
		p = stpcpy(p, "]}");
	stpcpy(p, "}");
	return text;
}

static void test_nesting_is_bounded(void **unused)
{
	char *text = nest(DOCUMENT_DEPTH_MAX - 1), pointer[1024] = "/root";
	struct faults faults = {0};
	struct document *d;
	int i;

	(void)unused;
	document_free(parse_well(text));
	free(text);
	for (i = 0; i < DOCUMENT_DEPTH_MAX; i++)
		strcat(pointer, "/children/0");
	text = nest(DOCUMENT_DEPTH_MAX);
	assert_int_equal(parse(text, &d, &faults), ERR_LIMIT);
	free(text);
	assert_int_equal(faults.count, 1);
	/* Cut in the middle: it begins and ends as the whole does. */
	assert_memory_equal(faults.list[0].pointer, pointer, 100);
	assert_non_null(strstr(faults.list[0].pointer, "..."));
	assert_string_equal(faults.list[0].detail,
	    "nodes nest more than 64 deep");
	text = nest(100000);
	assert_int_equal(parse(text, &d, &faults), ERR_LIMIT);
	free(text);
}

static void test_deep_json_is_bounded(void **unused)
{
	const size_t n = 1000000;
	char *text = malloc(n);
	struct faults faults = {0};
	struct document *d;

	(void)unused;
	assert_non_null(text);
	memset(text, '[', n);
	assert_int_equal(document_parse(text, n, &limits, &d, &faults),
	    ERR_LIMIT);
	assert_string_equal(faults.list[0].detail,
	    "nested more than 144 deep");
	free(text);
}

static void test_nodes_are_bounded(void **unused)
{
	const struct document_limits three = {.max_nodes = 3,
	    .layout = LAYOUT_WARPED};
	char *fits = quote(DOC("{'type':'sum','children':[" POINT "," POINT
	    "]}"));
	char *over = quote(DOC("{'type':'sum','children':[" POINT "," POINT ","
	    POINT "]}"));
	struct faults faults = {0};
	struct document *d;

	(void)unused;
	assert_int_equal(document_parse(fits, strlen(fits), &three, &d,
	    &faults), ERR_OK);
	document_free(d);
	assert_int_equal(document_parse(over, strlen(over), &three, &d,
	    &faults), ERR_LIMIT);
	assert_string_equal(faults.list[0].pointer, "/root/children");
	assert_string_equal(faults.list[0].detail, "more than 3 nodes");
	free(fits);
	free(over);
}

static void test_expanding_refs_is_bounded(void **unused)
{
	char text[8192] = "{'format':'blobfield/1','root':{'type':'sum',"
	    "'children':[{'type':'point','id':'l0','center':[0,0,0],"
	    "'radius':1}";
	char level[256];
	int i;

	(void)unused;
	/* Each level is two of the one before: 2^40 nodes. */
	for (i = 1; i <= 40; i++) {
		snprintf(level, sizeof level, ",{'type':'sum','id':'l%d',"
		    "'children':[{'type':'ref','ref':'l%d'},"
		    "{'type':'ref','ref':'l%d'}]}", i, i - 1, i - 1);
		strcat(text, level);
	}
	strcat(text, "]}}");
	{
		struct document *d;
		struct faults faults;

		assert_int_equal(parse(text, &d, &faults), ERR_LIMIT);
		assert_int_equal(faults.count, 1);
		assert_memory_equal(faults.list[0].pointer, "/root/children/",
		    15);
	}
}

static void test_huge_arrays_are_bounded(void **unused)
{
	const size_t n = 400000;
	char *text = malloc(2 * n + 64), *p;
	struct faults faults = {0};
	struct document *d;
	size_t i;

	(void)unused;
	assert_non_null(text);
	p = text + sprintf(text, "{\"x\":[0");
	for (i = 0; i < n - 10; i++) {
		*p++ = ',';
		*p++ = '0';
	}
	strcpy(p, "]}");
	assert_int_equal(document_parse(text, strlen(text), &limits, &d,
	    &faults), ERR_LIMIT);
	assert_string_equal(faults.list[0].detail, "too many JSON values");
	free(text);
}

static void test_too_many_operators_are_refused(void **unused)
{
	char *text = malloc(16384), name[32];
	int i;

	(void)unused;
	assert_non_null(text);
	strcpy(text, "{'format':'blobfield/1','root':" POINT ",'operators':{");
	for (i = 0; i <= DOCUMENT_OPERATORS_MAX; i++) {
		snprintf(name, sizeof name, "%s'o%d':{}", i ? "," : "", i);
		strcat(text, name);
	}
	strcat(text, "}}");
	check_refused(text, ERR_LIMIT, "/operators", "more than 256");
	free(text);
}

static void test_long_and_odd_names_make_clean_faults(void **unused)
{
	char text[4096] = "{'format':'blobfield/1','root':" POINT ",'";
	struct document *d;
	struct faults faults;
	size_t n = strlen(text), i;

	(void)unused;
	for (i = 0; i < 1000; i++, n += 2)
		memcpy(text + n, "\xc3\xa9", 3);
	strcat(text, "':1,'\\n\\u007f%s%n':2}");
	assert_int_equal(parse(text, &d, &faults), ERR_INVALID);
	assert_int_equal(faults.count, 2);
	assert_true(strlen(faults.list[0].pointer) < 70);
	assert_non_null(strstr(faults.list[0].pointer, "\xc3\xa9...\xc3\xa9"));
	assert_string_equal(faults.list[1].pointer, "/??%s%n");
	assert_string_equal(faults.list[1].detail, "unknown field '??%s%n'");
}

static void test_a_name_has_a_greatest_length(void **unused)
{
	char text[1024] = "{'format':'blobfield/1','root':" POINT ",'name':'";
	size_t n = strlen(text);

	(void)unused;
	memset(text + n, 'x', 256);
	strcpy(text + n + 256, "'}");
	document_free(parse_well(text));
	strcpy(text + n + 256, "x'}");
	check_refused(text, ERR_INVALID, "/name", "at most 256 bytes");
}

static void test_prefix_goes_before_pointers(void **unused)
{
	cJSON *json = cJSON_Parse("{\"format\":\"blobfield/1\",\"root\":3}");
	struct faults faults = {0};
	struct document *d;

	(void)unused;
	assert_int_equal(document_from_json(json, "/scene", &limits, &d,
	    &faults), ERR_INVALID);
	assert_string_equal(faults.list[0].pointer, "/scene/root");
	cJSON_Delete(json);
}

static void test_duplicates_in_parsed_json_are_faults(void **unused)
{
	cJSON *json = cJSON_Parse("{\"format\":\"blobfield/1\","
	    "\"root\":{\"type\":\"point\",\"radius\":1,\"radius\":2,"
	    "\"center\":[0,0,0]}}");
	struct faults faults = {0};
	struct document *d;

	(void)unused;
	assert_int_equal(document_from_json(json, "", &limits, &d, &faults),
	    ERR_INVALID);
	assert_string_equal(faults.list[0].pointer, "/root/radius");
	assert_string_equal(faults.list[0].detail, "given twice");
	cJSON_Delete(json);
}

/* %.*s: a name, whose length moves all that is allocated after it. */
#define RICH \
	"{'format':'blobfield/1','name':'%.*s','operators':{'o':{'profile':" \
	"{'type':'bulge'},'opening':'camel'}},'root':{'type':'union'," \
	"'operator':'o','children':[{'type':'ref','ref':'p','scale':2}," \
	"{'type':'point','id':'p','center':[0,0,0],'radius':1}," \
	"{'type':'difference','children':[" SPHERE "," SPHERE "]}]}}"

/* Parses text again and again, the nth allocation failing; the last n. */
static long fail_each_allocation(const char *text)
{
	struct faults faults = {0};
	struct document *d;
	enum err err;
	long n;

	for (n = 1;; n++) {
		d = NULL;
		fail_alloc_set(n);
		err = document_parse(text, strlen(text), &limits, &d, &faults);
		if (!fail_alloc_happened())
			break;
		assert_int_equal(fail_alloc_live(), 0);
		assert_int_equal(err, ERR_MEMORY);
		assert_null(d);
	}
	document_free(d);
	assert_int_equal(fail_alloc_live(), 0);
	fail_alloc_set(0);
	assert_int_equal(err, ERR_OK);
	assert_int_equal(faults.count, 0);
	return n;
}

/* An arena's blocks are filled at other places with every length of name. */
static void test_every_allocation_may_fail(void **unused)
{
	char name[256], buffer[1024], *text;
	int length;

	(void)unused;
	if (!fail_alloc_available())
		skip();
	memset(name, 'n', sizeof name);
	for (length = 0; length < 256; length += 16) {
		snprintf(buffer, sizeof buffer, RICH, length, name);
		text = quote(buffer);
		assert_true(fail_each_allocation(text) > 10);
		free(text);
	}
}

/* The schema's text, as JSON in the arena. */
static cJSON *read_schema(struct arena *arena)
{
	FILE *file = fopen("proto/document.schema.json", "r");
	struct faults faults = {0};
	static char text[1 << 17];
	cJSON *schema;
	size_t n;

	assert_non_null(file);
	n = fread(text, 1, sizeof text, file);
	fclose(file);
	assert_in_range(n, 1, sizeof text - 1);
	assert_int_equal(json_parse(text, n, 100000, arena, &schema,
	    &faults), ERR_OK);
	return schema;
}

/* Whether a node of this type may have the field, by the parser. */
static bool parser_knows(const char *type, const char *field)
{
	char text[256];
	struct document *d = NULL;
	struct faults faults;
	size_t i;

	snprintf(text, sizeof text, DOC("{'type':'%s','%s':null}"), type,
	    field);
	assert_int_equal(parse(text, &d, &faults), ERR_INVALID);
	for (i = 0; i < faults.count && i < FAULT_MAX; i++) {
		if (strstr(faults.list[i].detail, "unknown field"))
			return false;
	}
	return true;
}

static void test_schema_and_parser_know_the_same_fields(void **unused)
{
	static const char *const fields[] = {"id", "translation", "rotation",
	    "scale", "matrix", "center", "radius", "radii", "exponent",
	    "weight", "a", "b", "c", "normal", "disc_radius", "ring_radius",
	    "falloff", "half_size", "rounding", "axis", "major", "minor",
	    "point", "children", "operator", "n", "ref", "child", "k",
	    "material", "volume", "kernel", "s", "elements", "center", "rate",
	    "from", "to", "direction", "factor", "color"};
	struct arena arena = {0};
	cJSON *schema = read_schema(&arena);
	const cJSON *defs = cJSON_GetObjectItemCaseSensitive(schema, "$defs");
	const cJSON *def, *properties, *property;
	size_t i, types = 0;

	(void)unused;
	cJSON_ArrayForEach(def, defs) {
		if (strncmp(def->string, "node_", 5) != 0)
			continue;
		types++;
		properties = cJSON_GetObjectItemCaseSensitive(def,
		    "properties");
		cJSON_ArrayForEach(property, properties) {
			if (strcmp(property->string, "type") != 0 &&
			    !parser_knows(def->string + 5, property->string))
				fail_msg("%s has no '%s'", def->string,
				    property->string);
		}
		for (i = 0; i < COUNT(fields); i++) {
			if (!cJSON_GetObjectItemCaseSensitive(properties,
			    fields[i]) &&
			    parser_knows(def->string + 5, fields[i]))
				fail_msg("schema: %s lacks '%s'", def->string,
				    fields[i]);
		}
	}
	assert_int_equal(types, 23);
	arena_fini(&arena);
}

/* --- operators without angles ------------------------------------------------ */

/* Checks the classic operator of a node of that type whose "operator" is
 * text: its type, and its own numbers. */
static void check_classic(const char *node, const char *text, unsigned type,
    double p0, double p1, double p2)
{
	char buffer[1024];
	struct document *d;
	const struct node *root;

	snprintf(buffer, sizeof buffer, DOC("{'type':'%s','operator':%s,"
	    "'children':[" POINT "," POINT "]}"), node, text);
	d = parse_well(buffer);
	root = document_tree(d)->root;
	assert_non_null(root->classic);
	assert_null(root->op);
	assert_false(root->sharp);
	assert_int_equal(root->classic->type, type);
	assert_true(root->classic->p[0] == p0);
	assert_true(root->classic->p[1] == p1);
	assert_true(root->classic->p[2] == p2);
	assert_int_equal(document_tape(d)->operator_count, 0);
	document_free(d);
}

static void test_operators_without_angles(void **unused)
{
	(void)unused;
	check_classic("union", "{'type':'super-elliptic'}",
	    CLASSIC_SUPER_ELLIPTIC, 0.5, 0.5, 2);
	check_classic("difference", "{'r2':0.25,'type':'super-elliptic','t':8,"
	    "'r1':1}", CLASSIC_SUPER_ELLIPTIC, 1, 0.25, 8);
	check_classic("union", "{'type':'r-blend'}", CLASSIC_R_BLEND, 0.2, 0.5,
	    0.5);
	check_classic("intersection", "{'type':'r-blend','a0':-1,'a1':2,"
	    "'a2':3}", CLASSIC_R_BLEND, -1, 2, 3);
	check_classic("union", "{'type':'functional'}", CLASSIC_FUNCTIONAL, 0.5,
	    0, 0);
	check_classic("union", "{'type':'functional','d':2}",
	    CLASSIC_FUNCTIONAL, 2, 0, 0);
	check_classic("union", "{'type':'r-clean'}", CLASSIC_R_CLEAN, 0, 0, 0);
	check_classic("difference", "{'type':'barthe-clean'}",
	    CLASSIC_BARTHE_CLEAN, 0, 0, 0);
	check_classic("union", "{'type':'ricci'}", CLASSIC_RICCI, 2, 0, 0);
	check_classic("union", "{'type':'ricci','n':1}", CLASSIC_RICCI, 1, 0,
	    0);
	check_classic("union", "{'type':'interpolation','h':1}",
	    CLASSIC_INTERPOLATION, 1, 0, 0);
	check_classic("difference", "{'type':'power-difference','alpha':2.5}",
	    CLASSIC_POWER_DIFFERENCE, 2.5, 0, 0);
	check_classic("difference", "{'type':'power-difference'}",
	    CLASSIC_POWER_DIFFERENCE, 1, 0, 0);
}

static void test_boundary_lines_have_one_angle_or_two(void **unused)
{
	(void)unused;
	check_classic("union", "{'type':'barthe-opening'}",
	    CLASSIC_BARTHE_OPENING, PI / 8, PI / 8, 0);
	check_classic("union", "{'type':'barthe-opening','theta':0.25}",
	    CLASSIC_BARTHE_OPENING, 0.25, 0.25, 0);
	check_classic("union", "{'type':'barthe-opening','theta':[0.25,0.5]}",
	    CLASSIC_BARTHE_OPENING, 0.25, 0.5, 0);
	check_classic("union", "{'type':'barthe-opening','theta':"
	    "[-0.0005,0.7854]}", CLASSIC_BARTHE_OPENING, 0, PI / 4, 0);
}

static void test_operators_without_angles_can_be_named(void **unused)
{
	struct document *d = parse_well("{'format':'blobfield/1','operators':"
	    "{'cut':{'type':'power-difference'},'join':{'type':'r-clean'},"
	    "'soft':{'type':'gradient','opening':'camel'}},'root':{'type':"
	    "'union','operator':'join','children':[{'type':'difference',"
	    "'operator':'cut','children':[" POINT "," POINT "]},"
	    "{'type':'union','operator':'soft','children':[" POINT "," POINT
	    "]},{'type':'difference','operator':'join','children':[" POINT ","
	    POINT "]}]}}");
	const struct node *root = document_tree(d)->root;

	(void)unused;
	assert_int_equal(root->classic->type, CLASSIC_R_CLEAN);
	assert_int_equal(root->children[0]->classic->type,
	    CLASSIC_POWER_DIFFERENCE);
	assert_null(root->children[1]->classic);
	assert_false(opening_is_constant(&root->children[1]->op->opening));
	assert_ptr_equal(root->children[2]->classic, root->classic);
	assert_true(document_has_operators(d));
	document_free(d);
}

/* From the document to the field: the point's centre, and far away. */
static void test_operators_without_angles_are_evaluated(void **unused)
{
	struct document *d = parse_well(DOC("{'type':'union','operator':"
	    "{'type':'ricci','n':2},'children':[" POINT ",{'type':'point',"
	    "'center':[0,0,0],'radius':1,'weight':0.75}]}"));
	struct jet jet;

	(void)unused;
	evaluate(document_tape(d), vec3(0, 0, 0), 0, &jet);
	assert_true(fabs(jet.value - 1.25) < 1e-15);
	document_free(d);
	d = parse_well(DOC("{'type':'difference','operator':{'type':"
	    "'power-difference','alpha':2},'children':[" POINT ",{'type':"
	    "'point','center':[0,0,0],'radius':1,'weight':0.25}]}"));
	evaluate(document_tape(d), vec3(0, 0, 0), 0, &jet);
	assert_true(fabs(jet.value - 0.875) < 1e-15);
	document_free(d);
}

static void test_operators_without_angles_want_memory(void **unused)
{
	static const char wanted[] =
	    "{'format':'blobfield/1','operators':{'cut':"
	    "{'type':'power-difference'},'join':{'type':'barthe-opening'}},"
	    "'root':{'type':'union','operator':'join','children':[{'type':"
	    "'difference','operator':'cut','children':[" POINT "," POINT "]},"
	    "{'type':'union','operator':{'type':'ricci'},'children':[" POINT
	    "," POINT "]}]}}";
	char *text;

	(void)unused;
	if (!fail_alloc_available())
		skip();
	text = quote(wanted);
	assert_true(fail_each_allocation(text) > 3);
	free(text);
}

static void test_drafts_are_asked_for(void **unused)
{
	(void)unused;
	assert_false(with_operator("{}").draft);
	assert_false(with_operator("{'draft':false}").draft);
	assert_true(with_operator("{'type':'gradient','draft':true}").draft);
	assert_false(with_operator("'camel'").draft);
}

static void test_wrong_operator_objects_are_refused(void **unused)
{
	static const struct {
		const char *text, *pointer, *words;
	} cases[] = {
		{UNION("'operator':{'type':'rici'}"), "/root/operator/type",
		    "unknown operator type 'rici'; did you mean 'ricci'?"},
		{UNION("'operator':{'type':'sharp'}"), "/root/operator/type",
		    "unknown operator type 'sharp'"},
		{UNION("'operator':{'type':null}"), "/root/operator/type",
		    "must be a string"},
		{UNION("'operator':{'type':'ricci','n':0.5}"),
		    "/root/operator/n", "between 1 and 1000"},
		{UNION("'operator':{'type':'ricci','profile':'smooth'}"),
		    "/root/operator/profile", "unknown field"},
		{UNION("'operator':{'n':2}"), "/root/operator/n",
		    "unknown field"},
		{UNION("'operator':{'type':'r-clean','a0':1}"),
		    "/root/operator/a0", "unknown field"},
		{UNION("'operator':{'type':'barthe-opening','theta':0.8}"),
		    "/root/operator/theta", "between"},
		{UNION("'operator':{'type':'barthe-opening','theta':[0.1]}"),
		    "/root/operator/theta", "must have 2 numbers"},
		{UNION("'operator':{'type':'barthe-opening','theta':[0.1,-1]}"),
		    "/root/operator/theta/1", "between"},
		{UNION("'operator':{'type':'barthe-opening','theta':'wide'}"),
		    "/root/operator/theta", "must be a number"},
		{UNION("'operator':{'draft':1}"), "/root/operator/draft",
		    "must be true or false, not a number"},
		{UNION("'operator':{'type':'ricci','draft':true}"),
		    "/root/operator/draft", "unknown field"},
		{UNION("'operator':{'type':'power-difference'}"),
		    "/root/operator", "a power-difference operator is for a "
		    "difference alone"},
		{DOC("{'type':'intersection','operator':{'type':"
		    "'power-difference'},'children':[" POINT "]}"),
		    "/root/operator", "for a difference alone"},
		{"{'format':'blobfield/1','operators':{'cut':{'type':"
		    "'power-difference'}},'root':{'type':'union','operator':"
		    "'cut','children':[" POINT "]}}", "/root/operator",
		    "for a difference alone"},
		{"{'format':'blobfield/1','operators':{'x':{'type':'ricci',"
		    "'n':'2'}},'root':" POINT "}", "/operators/x/n",
		    "must be a number"},
	};

	(void)unused;
	for (size_t i = 0; i < COUNT(cases); i++)
		check_refused(cases[i].text, ERR_INVALID, cases[i].pointer,
		    cases[i].words);
}

/* Parses a difference whose operator of that type (- for the schema's _) has
 * the member: the first fault's detail, or "". */
static void operator_fault(const char *type, const char *member,
    const char *value, char out[static FAULT_DETAIL_MAX])
{
	char text[512], dashed[64], *dash;
	struct document *d = NULL;
	struct faults faults;

	snprintf(dashed, sizeof dashed, "%s", type);
	while ((dash = strchr(dashed, '_')))
		*dash = '-';
	snprintf(text, sizeof text, DOC("{'type':'difference','operator':"
	    "{'type':'%s','%s':%s},'children':[" POINT "]}"), dashed, member,
	    value);
	out[0] = '\0';
	if (parse(text, &d, &faults) != ERR_OK)
		snprintf(out, FAULT_DETAIL_MAX, "%s", faults.list[0].detail);
	document_free(d);
}

/* Ends of a number's range are allowed, and what is beyond is not. */
static void check_range(const char *type, const cJSON *property)
{
	static const char *const ends[] = {"minimum", "maximum"};

	for (int i = 0; i < 2; i++) {
		const double end = cJSON_GetObjectItemCaseSensitive(property,
		    ends[i])->valuedouble;
		char value[64], fault[FAULT_DETAIL_MAX];

		snprintf(value, sizeof value, "%.17g", end);
		operator_fault(type, property->string, value, fault);
		assert_string_equal(fault, "");
		snprintf(value, sizeof value, "%.17g", end + (i ? 0.01 :
		    -0.001));
		operator_fault(type, property->string, value, fault);
		assert_non_null(strstr(fault, "must be between"));
	}
}

static void test_schema_and_parser_know_the_same_operators(void **unused)
{
	static const char *const members[] = {"profile", "opening", "layout",
	    "resolution", "draft", "r1", "r2", "t", "a0", "a1", "a2", "d", "n",
	    "theta", "h", "alpha", "k", "w"};
	struct arena arena = {0};
	const cJSON *defs = cJSON_GetObjectItemCaseSensitive(
	    read_schema(&arena), "$defs");
	const cJSON *def, *properties, *property;
	char fault[FAULT_DETAIL_MAX];
	size_t types = 0, ranges = 0;

	(void)unused;
	cJSON_ArrayForEach(def, defs) {
		const char *type = def->string + 9;

		if (strncmp(def->string, "operator_", 9) != 0)
			continue;
		types++;
		properties = cJSON_GetObjectItemCaseSensitive(def,
		    "properties");
		for (size_t i = 0; i < COUNT(members); i++) {
			operator_fault(type, members[i], "null", fault);
			property = cJSON_GetObjectItemCaseSensitive(properties,
			    members[i]);
			assert_int_equal(!property, !!strstr(fault,
			    "unknown field"));
			if (!property || !cJSON_HasObjectItem(property,
			    "minimum"))
				continue;
			check_range(type, property);
			ranges++;
		}
	}
	assert_int_equal(types, 10);
	assert_int_equal(ranges, 11);
	arena_fini(&arena);
}

int main(void)
{
	const struct CMUnitTest tests[] = {
		cmocka_unit_test(test_example_of_the_specification),
		cmocka_unit_test(test_every_soft_object),
		cmocka_unit_test(test_every_solid),
		cmocka_unit_test(test_every_composition),
		cmocka_unit_test(test_named_operators),
		cmocka_unit_test(test_nodes_share_the_operators_of_a_name),
		cmocka_unit_test(test_inline_operators),
		cmocka_unit_test(test_rounded_angles_are_drawn_into_range),
		cmocka_unit_test(test_transforms),
		cmocka_unit_test(test_refs),
		cmocka_unit_test(test_top_level_settings),
		cmocka_unit_test(test_layout_defaults_to_the_limits),
		cmocka_unit_test(test_tape_can_be_taken),
		cmocka_unit_test(
		    test_wrong_documents_are_refused_where_they_are_wrong),
		cmocka_unit_test(test_all_faults_are_collected),
		cmocka_unit_test(test_more_faults_than_are_kept_are_counted),
		cmocka_unit_test(test_malformed_json_is_refused_with_its_place),
		cmocka_unit_test(
		    test_a_member_twice_is_told_at_the_end_of_its_object),
		cmocka_unit_test(test_operators_of_its_own_are_known),
		cmocka_unit_test(test_a_nul_byte_is_malformed),
		cmocka_unit_test(test_strings_are_decoded),
		cmocka_unit_test(test_nesting_is_bounded),
		cmocka_unit_test(test_deep_json_is_bounded),
		cmocka_unit_test(test_nodes_are_bounded),
		cmocka_unit_test(test_expanding_refs_is_bounded),
		cmocka_unit_test(test_huge_arrays_are_bounded),
		cmocka_unit_test(test_too_many_operators_are_refused),
		cmocka_unit_test(test_long_and_odd_names_make_clean_faults),
		cmocka_unit_test(test_a_name_has_a_greatest_length),
		cmocka_unit_test(test_prefix_goes_before_pointers),
		cmocka_unit_test(test_duplicates_in_parsed_json_are_faults),
		cmocka_unit_test(test_every_allocation_may_fail),
		cmocka_unit_test(test_schema_and_parser_know_the_same_fields),
		cmocka_unit_test(test_operators_without_angles),
		cmocka_unit_test(test_boundary_lines_have_one_angle_or_two),
		cmocka_unit_test(test_operators_without_angles_can_be_named),
		cmocka_unit_test(test_operators_without_angles_are_evaluated),
		cmocka_unit_test(test_operators_without_angles_want_memory),
		cmocka_unit_test(test_drafts_are_asked_for),
		cmocka_unit_test(test_wrong_operator_objects_are_refused),
		cmocka_unit_test(
		    test_schema_and_parser_know_the_same_operators),
	};

	return cmocka_run_group_tests(tests, NULL, NULL);
}
