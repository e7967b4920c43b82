/*
 * Which primitive a point of a surface is taken for, and what it is called.
 */
#include <stdarg.h>
#include <stddef.h>
#include <setjmp.h>
#include <stdint.h>
#include <cmocka.h>

#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "core/pick.h"
#include "core/tree.h"
#include "proto/document.h"
#include "proto/fault.h"
#include "tests/support/random_tree.h"

#define MAX_NODES 1000

/* Of a document's root in which ' stands for ". */
static struct document *parse(const char *root)
{
	const struct document_limits limits = {.max_nodes = MAX_NODES};
	size_t size = strlen(root) + 100;
	char *text = malloc(size);
	struct document *d = NULL;
	struct faults faults = {0};

	snprintf(text, size, "{'format':'blobfield/1','root':%s}", root);
	for (char *c = text; *c; c++)
		if (*c == '\'')
			*c = '"';
	if (document_parse(text, strlen(text), &limits, &d, &faults) != ERR_OK)
		fail_msg("%s: %s", faults.list[0].pointer,
		    faults.list[0].detail);
	free(text);
	return d;
}

static void check(const struct document *d, struct vec3 p,
    const char *pointer, size_t ordinal)
{
	const struct tree *tree = document_tree(d);
	char found[PICK_POINTER_MAX];
	const struct node *leaf;

	assert_int_equal(pick_leaf(tree, MAX_NODES, p, &leaf), ERR_OK);
	assert_int_equal(leaf->type, NODE_PRIMITIVE);
	pick_pointer(leaf, found);
	assert_string_equal(found, pointer);
	assert_int_equal(pick_ordinal(tree, leaf), ordinal);
}

#define POINT(x) "{'type':'point','center':[" #x ",0,0],'radius':1}"
#define BALL(x, r) "{'type':'sphere','center':[" #x ",0,0],'radius':" #r \
    ",'falloff':0.5}"

static void test_a_primitive_is_the_root(void **state)
{
	struct document *d = parse(POINT(0));

	(void)state;
	check(d, vec3(1.0, 0.0, 0.0), "/root", 0);
	check(d, vec3(100.0, 0.0, 0.0), "/root", 0);
	document_free(d);
}

static void test_unions_go_to_the_largest_value(void **state)
{
	struct document *d = parse("{'type':'union','children':["
	    POINT(0) "," POINT(1.5) "," POINT(3) "]}");

	(void)state;
	check(d, vec3(0.1, 0.0, 0.0), "/root/children/0", 0);
	check(d, vec3(1.2, 0.0, 0.0), "/root/children/1", 1);
	check(d, vec3(2.9, 0.0, 0.0), "/root/children/2", 2);
	/* nothing is there */
	check(d, vec3(0.0, 50.0, 0.0), "/root/children/0", 0);
	document_free(d);
}

static void test_intersections_go_to_the_least_value(void **state)
{
	struct document *d = parse("{'type':'intersection','children':["
	    POINT(0) "," POINT(0.5) "]}");

	(void)state;
	check(d, vec3(1.0, 0.0, 0.0), "/root/children/0", 0);
	check(d, vec3(-0.5, 0.0, 0.0), "/root/children/1", 1);
	check(d, vec3(9.0, 0.0, 0.0), "/root/children/0", 0);
	document_free(d);
}

static void test_differences_go_to_what_cuts(void **state)
{
	struct document *d = parse("{'type':'difference','operator':'sharp',"
	    "'children':[" BALL(0, 2) "," BALL(2, 1) "," BALL(-2, 1) "]}");

	(void)state;
	check(d, vec3(0.0, 2.0, 0.0), "/root/children/0", 0);
	check(d, vec3(1.01, 0.0, 0.0), "/root/children/1", 1);
	check(d, vec3(-1.01, 0.0, 0.0), "/root/children/2", 2);
	document_free(d);
}

static void test_transforms_warps_and_refs_are_followed(void **state)
{
	struct document *d = parse("{'type':'union','children':["
	    "{'type':'union','id':'pair','translation':[0,0,5],'children':["
	    POINT(0) "," POINT(2) "]},"
	    "{'type':'ref','ref':'pair','translation':[10,0,0],"
	    "'rotation':[0,0,0.7071067811865476,0.7071067811865476]},"
	    "{'type':'twist','axis':[0,0,1],'rate':1.5707963267948966,"
	    "'child':{'type':'union','children':[" POINT(2) "," POINT(-2)
	    "]}}]}");

	(void)state;
	check(d, vec3(0.0, 0.0, 5.9), "/root/children/0/children/0", 0);
	check(d, vec3(2.0, 0.0, 5.9), "/root/children/0/children/1", 1);
	/* the second of the pair, turned from x to y and moved to x = 10 */
	check(d, vec3(10.0, 2.0, 5.9), "/root/children/0/children/1", 1);
	check(d, vec3(10.0, 0.0, 5.9), "/root/children/0/children/0", 0);
	/* a quarter of a turn at z = 1: x = 2 is at y = 2 there */
	check(d, vec3(0.0, 2.0, 1.0), "/root/children/2/child/children/0", 2);
	check(d, vec3(0.0, -2.0, 1.0), "/root/children/2/child/children/1", 3);
	document_free(d);
}

static void test_convolutions_go_to_an_element(void **state)
{
	struct document *d = parse("{'type':'convolution','kernel':'cauchy',"
	    "'radius':0.3,'elements':[{'segment':[[0,0,0],[1,0,0]]},"
	    "{'segment':[[1,0,0],[1,2,0]]}]}");

	(void)state;
	check(d, vec3(0.2, 0.3, 0.0), "/root/elements/0", 0);
	check(d, vec3(1.2, 1.7, 0.0), "/root/elements/1", 1);
	document_free(d);
}

static void test_too_many_nodes_are_refused(void **state)
{
	struct document *d = parse("{'type':'union','children':["
	    "{'type':'union','children':[" POINT(0) "," POINT(1) "]},"
	    POINT(2) "]}");
	const struct node *leaf = NULL;

	(void)state;
	assert_int_equal(pick_leaf(document_tree(d), 2, vec3(0, 0, 0), &leaf),
	    ERR_LIMIT);
	assert_null(leaf);
	document_free(d);
}

/* Of any tree, and the same from a picker that has been asked before. */
static void test_random_trees_have_a_leaf_everywhere(void **state)
{
	(void)state;
	for (uint64_t seed = 1; seed <= 60; seed++) {
		const struct random_tree_options options = {.seed = seed,
		    .whole = seed % 2};
		struct random_tree *t = random_tree_create(&options);
		const struct tree *tree = random_tree_get(t);
		struct random_stream r = {seed};
		struct picker *picker;

		assert_int_equal(picker_create(tree, MAX_NODES, &picker),
		    ERR_OK);
		for (int i = 0; i < 20; i++) {
			struct vec3 p = {random_in(&r, -2.0, 2.0),
			    random_in(&r, -2.0, 2.0), random_in(&r, -2.0, 2.0)};
			const struct node *leaf, *again;

			assert_int_equal(picker_leaf(picker, p, &leaf),
			    ERR_OK);
			assert_int_equal(leaf->type, NODE_PRIMITIVE);
			assert_int_equal(pick_leaf(tree, MAX_NODES, p, &again),
			    ERR_OK);
			assert_ptr_equal(leaf, again);
		}
		picker_free(picker);
		random_tree_free(t);
	}
}

int main(void)
{
	const struct CMUnitTest tests[] = {
		cmocka_unit_test(test_a_primitive_is_the_root),
		cmocka_unit_test(test_unions_go_to_the_largest_value),
		cmocka_unit_test(test_intersections_go_to_the_least_value),
		cmocka_unit_test(test_differences_go_to_what_cuts),
		cmocka_unit_test(test_transforms_warps_and_refs_are_followed),
		cmocka_unit_test(test_convolutions_go_to_an_element),
		cmocka_unit_test(test_too_many_nodes_are_refused),
		cmocka_unit_test(test_random_trees_have_a_leaf_everywhere),
	};

	return cmocka_run_group_tests(tests, NULL, NULL);
}
