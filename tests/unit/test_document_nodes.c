/*
 * Nodes beyond primitives and compositions: convolution surfaces, warps,
 * volumes, and materials on any of them.
 */
#include <stdarg.h>
#include <stddef.h>
#include <setjmp.h>
#include <stdint.h>
#include <cmocka.h>

#include <math.h>
#include <stdbool.h>
#include <stdlib.h>
#include <string.h>

#include "core/convolution.h"
#include "core/tape.h"
#include "core/volume.h"
#include "proto/document.h"
#include "proto/fault.h"
#include "tests/support/near.h"

#define COUNT(array) (sizeof(array) / sizeof *(array))
#define DOC(root) "{'format':'blobfield/1','root':" root "}"
#define POINT "{'type':'point','center':[0,0,0],'radius':1}"
#define CONVOLUTION(elements) \
	DOC("{'type':'convolution','radius':2,'elements':[" elements "]}")
#define WARP(type, fields) \
	DOC("{'type':'" type "','axis':[0,0,2]," fields ",'child':" POINT "}")
#define PLACE "{'point':[1,2,3]}"

/* The volume called "v", if it is asked for. */
static struct volume *find_volume(void *ctx, const char *id)
{
	struct volume *volume = ctx;

	return strcmp(id, "v") == 0 ? volume_hold(volume) : NULL;
}

static enum err parse(const char *text, struct volume *volume,
    struct document **out, struct faults *faults)
{
	const struct document_limits limits = {.max_nodes = 10,
	    .layout = LAYOUT_WARPED,
	    .volume = volume ? find_volume : NULL, .volume_ctx = volume};
	char *quoted = strdup(text), *p;
	enum err err;

	assert_non_null(quoted);
	for (p = quoted; *p; p++) {
		if (*p == '\'')
			*p = '"';
	}
	*faults = (struct faults){0};
	err = document_parse(quoted, strlen(quoted), &limits, out, faults);
	free(quoted);
	return err;
}

static struct document *parse_well(const char *text, struct volume *volume)
{
	struct document *d = NULL;
	struct faults faults;

	if (parse(text, volume, &d, &faults) != ERR_OK)
		fail_msg("%s\n%s: %s", text, faults.list[0].pointer,
		    faults.list[0].detail);
	return d;
}

static struct volume *make_volume(bool is_distance)
{
	static const float samples[64] = {1};
	const size_t count[3] = {4, 4, 4};
	struct volume *v;

	assert_int_equal(volume_create(samples, count, vec3(0, 0, 0),
	    vec3(1, 1, 1), is_distance, &v), ERR_OK);
	return v;
}

static void test_convolution_elements_are_primitives_below_it(void **unused)
{
	struct document *d = parse_well(CONVOLUTION(PLACE
	    ",{'segment':[[0,0,0],[0,0,1]],'weight':0.5},"
	    "{'triangle':[[0,0,0],[1,0,0],[0,1,0]]}"), NULL);
	const struct node *root = document_tree(d)->root;
	const struct primitive *p = &root->children[1]->primitive;

	(void)unused;
	assert_int_equal(root->type, NODE_CONVOLUTION);
	assert_int_equal(root->child_count, 3);
	assert_ptr_equal(root->children[2]->parent, root);
	assert_int_equal(root->children[2]->index, 2);
	assert_int_equal(root->children[0]->primitive.type,
	    PRIMITIVE_CAUCHY_POINT);
	assert_near(root->children[0]->primitive.a.z, 3.0, 0.0);
	assert_int_equal(p->type, PRIMITIVE_CAUCHY_SEGMENT);
	assert_near(p->b.z, 1.0, 0.0);
	assert_near(p->weight, 0.5, 0.0);
	assert_near(p->radius[0], 2.0, 0.0);
	assert_near(p->s, cauchy_default_s(2.0), 0.0);
	assert_int_equal(root->children[2]->primitive.type,
	    PRIMITIVE_CAUCHY_TRIANGLE);
	assert_near(root->children[2]->primitive.c.y, 1.0, 0.0);
	assert_int_equal(document_tape(d)->node_count, 4);
	document_free(d);
}

static void test_warps_keep_their_numbers(void **unused)
{
	struct document *d = parse_well(WARP("twist", "'rate':-2"), NULL);
	const struct warp *w = &document_tree(d)->root->warp;

	(void)unused;
	assert_int_equal(document_tree(d)->root->type, NODE_WARP);
	assert_int_equal(w->type, WARP_TWIST);
	assert_near(w->axis.z, 1.0, 0.0);
	assert_near(w->rate, -2.0, 0.0);
	assert_false(w->has_range);
	document_free(d);
	d = parse_well(WARP("taper", "'from':-1,'to':2,'factor':0.5,"
	    "'center':[1,2,3]"), NULL);
	w = &document_tree(d)->root->warp;
	assert_int_equal(w->type, WARP_TAPER);
	assert_true(w->has_range && w->from == -1.0 && w->to == 2.0);
	assert_near(w->scale, 0.5, 0.0);
	assert_near(w->center.y, 2.0, 0.0);
	document_free(d);
	d = parse_well(WARP("bend", "'direction':[3,0,4],'from':0,"
	    "'to':3.1416,'rate':-2"), NULL);
	w = &document_tree(d)->root->warp;
	assert_int_equal(w->type, WARP_BEND);
	assert_near(w->direction.x, 0.6, 1e-15);
	assert_int_equal(document_tree(d)->root->child_count, 1);
	assert_ptr_equal(document_tree(d)->root->children[0]->parent,
	    document_tree(d)->root);
	document_free(d);
}

static void test_any_node_may_have_a_material(void **unused)
{
	static const char *const texts[] = {
		DOC("{'type':'union','children':[" POINT "],"
		    "'material':{'color':[0,0.5,1]}}"),
		DOC("{'type':'convolution','radius':2,'elements':[" PLACE "],"
		    "'material':{'color':[0,0.5,1]}}"),
		WARP("twist", "'rate':1,'material':{'color':[0,0.5,1]}"),
	};

	(void)unused;
	for (size_t i = 0; i < COUNT(texts); i++) {
		struct document *d = parse_well(texts[i], NULL);
		const struct node *root = document_tree(d)->root;

		assert_true(root->has_color);
		assert_near(root->color.y, 0.5, 0.0);
		assert_false(root->children[0]->has_color);
		document_free(d);
	}
}

static void test_document_holds_its_volumes(void **unused)
{
	struct volume *v = make_volume(false);
	struct document *d = parse_well(DOC("{'type':'sum','children':["
	    "{'type':'volume','volume':'v'},{'type':'volume','volume':'v'}]}"),
	    v);

	(void)unused;
	assert_true(atomic_load(&v->refs) > 1);
	assert_ptr_equal(document_tree(d)->root->children[0]->primitive.volume,
	    v);
	assert_int_equal(document_tape(d)->volume_count, 1);
	document_free(d);
	assert_int_equal(atomic_load(&v->refs), 1);
	volume_release(v);
}

static void test_refused_documents_let_go_of_volumes(void **unused)
{
	struct volume *v = make_volume(false);
	struct document *d = NULL;
	struct faults faults;

	(void)unused;
	assert_int_equal(parse(DOC("{'type':'sum','children':["
	    "{'type':'volume','volume':'v'},{'type':'volume','volume':'w'}]}"),
	    v, &d, &faults), ERR_INVALID);
	assert_string_equal(faults.list[0].pointer, "/root/children/1/volume");
	assert_string_equal(faults.list[0].detail, "there is no volume 'w'");
	assert_int_equal(atomic_load(&v->refs), 1);
	volume_release(v);
}

static void test_falloff_belongs_to_distances_alone(void **unused)
{
	struct volume *fields = make_volume(false);
	struct volume *distances = make_volume(true);
	struct document *d = NULL;
	struct faults faults;

	(void)unused;
	assert_int_equal(parse(DOC("{'type':'volume','volume':'v',"
	    "'falloff':0.1}"), fields, &d, &faults), ERR_INVALID);
	assert_string_equal(faults.list[0].pointer, "/root");
	assert_int_equal(parse(DOC("{'type':'volume','volume':'v'}"),
	    distances, &d, &faults), ERR_INVALID);
	assert_string_equal(faults.list[0].pointer, "/root");
	volume_release(fields);
	volume_release(distances);
}

static void test_wrong_nodes_are_refused_where_they_are_wrong(void **unused)
{
	static const struct {
		const char *text, *pointer, *words;
	} cases[] = {
		{CONVOLUTION(""), "/root/elements", "1 or more elements"},
		{CONVOLUTION("{}"), "/root/elements/0",
		    "needs one of 'point', 'segment' and 'triangle'"},
		{CONVOLUTION("{'weight':2}"), "/root/elements/0", "needs one"},
		{CONVOLUTION("{'point':[0,0,0],'segment':[[0,0,0],[0,0,1]]}"),
		    "/root/elements/0", "needs one"},
		{CONVOLUTION("[0]"), "/root/elements/0", "must be an object"},
		{CONVOLUTION(PLACE ",{'segment':[[0,0,0]]}"),
		    "/root/elements/1/segment", "2 positions"},
		{CONVOLUTION("{'triangle':[[0,0,0],[0,0],[0,0,1]]}"),
		    "/root/elements/0/triangle/1", "3 numbers, not 2"},
		{CONVOLUTION("{'point':[0,0,0],'weight':-1}"),
		    "/root/elements/0/weight", "between"},
		{CONVOLUTION("{'point':[0,0,0],'wieght':1}"),
		    "/root/elements/0/wieght", "did you mean 'weight'?"},
		{CONVOLUTION(PLACE "," PLACE "," PLACE "," PLACE "," PLACE ","
		    PLACE "," PLACE "," PLACE "," PLACE "," PLACE),
		    "/root/elements", "more than 10 nodes"},
		{DOC("{'type':'convolution','radius':2,'s':1000,'elements':["
		    PLACE "]}"), "/root/s", "between 0.01 and 100, not 2000"},
		{DOC("{'type':'convolution','radius':2,'kernel':'gauss',"
		    "'elements':[" PLACE "]}"), "/root/kernel", "cauchy"},
		{DOC("{'type':'convolution','elements':[" PLACE "]}"), "/root",
		    "'radius' is missing"},
		{DOC("{'type':'twist','axis':[0,0,1],'rate':1}"), "/root",
		    "'child' is missing"},
		{DOC("{'type':'twist','axis':[0,0,0],'rate':1,'child':" POINT
		    "}"), "/root/axis", "null vector"},
		{WARP("twist", "'rate':1,'from':0"), "/root",
		    "both 'from' and 'to'"},
		{WARP("twist", "'rate':1,'from':1,'to':1"), "/root/to",
		    "must exceed 'from'"},
		{WARP("taper", "'from':0,'to':1,'factor':0"), "/root/factor",
		    "between 0.001 and 1000"},
		{WARP("taper", "'from':0,'factor':1"), "/root",
		    "'to' is missing"},
		{WARP("bend", "'direction':[0,0,-3],'from':0,'to':1,'rate':1"),
		    "/root/direction", "parallel"},
		{WARP("bend", "'direction':[1,0,0],'from':0,'to':2,'rate':4"),
		    "/root/rate", "bends by 8 radians"},
		{DOC("{'type':'twist','axis':[0,0,1],'rate':1,'child':"
		    "{'type':'twist','axis':[0,0,1],'rate':1,'child':"
		    "{'type':'spere'}}}"), "/root/child/child/type",
		    "did you mean 'sphere'?"},
		{DOC("{'type':'twist','axis':[0,0,1],'rate':1,'child':"
		    "{'type':'ref','ref':'x'}}"), "/root/child/ref",
		    "no node has this id"},
		{DOC("{'type':'volume','volume':'v'}"), "/root/volume",
		    "there is no volume 'v'"},
		{DOC("{'type':'volume','volume':7}"), "/root/volume",
		    "must be a string"},
		{DOC("{'type':'point','center':[0,0,0],'radius':1,"
		    "'material':{'color':[0,0,2]}}"), "/root/material/color/2",
		    "between 0 and 1"},
		{DOC("{'type':'point','center':[0,0,0],'radius':1,"
		    "'material':{}}"), "/root/material", "'color' is missing"},
		{DOC("{'type':'point','center':[0,0,0],'radius':1,"
		    "'material':'red'}"), "/root/material",
		    "must be an object, not a string"},
	};

	(void)unused;
	for (size_t i = 0; i < COUNT(cases); i++) {
		struct document *d = NULL;
		struct faults faults;
		size_t k = 0;

		if (parse(cases[i].text, NULL, &d, &faults) == ERR_OK)
			fail_msg("taken: %s", cases[i].text);
		while (k < faults.count &&
		    (strcmp(faults.list[k].pointer, cases[i].pointer) != 0 ||
		    !strstr(faults.list[k].detail, cases[i].words)))
			k++;
		if (k == faults.count)
			fail_msg("%s\ngives %s: %s", cases[i].text,
			    faults.list[0].pointer, faults.list[0].detail);
	}
}

static void test_faults_of_the_tape_point_through_warps(void **unused)
{
	struct document *d = NULL;
	struct faults faults;

	(void)unused;
	assert_int_equal(parse(DOC("{'type':'taper','axis':[0,0,1],'from':0,"
	    "'to':1,'factor':1,'child':{'type':'sum','children':[" POINT ","
	    "{'type':'point','center':[0,0,0],'radius':1e8,'scale':1e9}]}}"),
	    NULL, &d, &faults), ERR_INVALID);
	assert_string_equal(faults.list[0].pointer, "/root/child/children/1");
}

int main(void)
{
	const struct CMUnitTest tests[] = {
		cmocka_unit_test(
		    test_convolution_elements_are_primitives_below_it),
		cmocka_unit_test(test_warps_keep_their_numbers),
		cmocka_unit_test(test_any_node_may_have_a_material),
		cmocka_unit_test(test_document_holds_its_volumes),
		cmocka_unit_test(test_refused_documents_let_go_of_volumes),
		cmocka_unit_test(test_falloff_belongs_to_distances_alone),
		cmocka_unit_test(
		    test_wrong_nodes_are_refused_where_they_are_wrong),
		cmocka_unit_test(test_faults_of_the_tape_point_through_warps),
	};

	return cmocka_run_group_tests(tests, NULL, NULL);
}
