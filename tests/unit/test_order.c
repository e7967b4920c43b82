/*
 * Bodies that order tables.
 */
#include <stdarg.h>
#include <stddef.h>
#include <setjmp.h>
#include <stdint.h>
#include <cmocka.h>

#include <string.h>

#include "core/table.h"
#include "proto/fault.h"
#include "proto/order.h"
#include "tests/support/near.h"

static struct order parse(const char *text)
{
	struct faults faults = {0};
	struct order order;
	enum err err = order_parse(text, strlen(text), LAYOUT_WARPED, &order,
	    &faults);

	if (err != ERR_OK)
		print_error("%s: %s\n", faults.list[0].pointer,
		    faults.list[0].detail);
	assert_int_equal(err, ERR_OK);
	return order;
}

static void test_an_empty_order_is_of_the_default_table(void **state)
{
	const struct profile smooth = profile_smooth();
	const struct order order = parse("{}");

	(void)state;
	assert_int_equal(order.op.family, FAMILY_UNION);
	assert_int_equal(order.op.layout, LAYOUT_WARPED);
	assert_int_equal(order.op.resolution, TABLE_RESOLUTION_WARPED);
	assert_true(profile_equal(&order.op.profile, &smooth));
	assert_near(order.max_error, 0.0, 0.0);
}

static void test_every_member_is_read(void **state)
{
	const struct profile bulge = profile_bulge(0.25);
	struct order order = parse("{\"family\":\"intersection\",\"layout\":"
	    "\"uniform\",\"resolution\":33,\"profile\":{\"type\":\"bulge\","
	    "\"k\":0.25}}");

	(void)state;
	assert_int_equal(order.op.family, FAMILY_INTERSECTION);
	assert_int_equal(order.op.layout, LAYOUT_UNIFORM);
	assert_int_equal(order.op.resolution, 33);
	assert_true(profile_equal(&order.op.profile, &bulge));
	order = parse("{\"layout\":\"uniform\"}");
	assert_int_equal(order.op.resolution, TABLE_RESOLUTION_UNIFORM);
	order = parse("{\"family\":\"union\",\"max_error\":1e-4}");
	assert_int_equal(order.op.resolution, 0);
	assert_near(order.max_error, 1e-4, 0.0);
}

static void test_samples_are_read(void **state)
{
	const struct order order = parse("{\"profile\":{\"type\":\"samples\","
	    "\"points\":[[0,1],[0.5,0.95],[0.8,0.8]]}}");

	(void)state;
	assert_int_equal(order.op.profile.type, PROFILE_SAMPLES);
	assert_int_equal(order.op.profile.count, 3);
}

static void test_what_is_wrong_is_said_where_it_is(void **state)
{
	static const struct {
		const char *text, *pointer;
		enum err err;
	} cases[] = {
		{"", "", ERR_SYNTAX},
		{"{\"layout\":\"warped\",\"layout\":\"warped\"}", "/layout",
		    ERR_SYNTAX},
		{"7", "", ERR_INVALID},
		{"{\"family\":\"difference\"}", "/family", ERR_INVALID},
		{"{\"family\":1}", "/family", ERR_INVALID},
		{"{\"layout\":\"grid\"}", "/layout", ERR_INVALID},
		{"{\"profile\":\"camel\"}", "/profile", ERR_INVALID},
		{"{\"profile\":{\"type\":\"bulge\",\"k\":2}}", "/profile/k",
		    ERR_INVALID},
		{"{\"profile\":{\"type\":\"samples\",\"points\":[[0,1],[1,0],"
		    "[2]]}}", "/profile/points/2", ERR_INVALID},
		{"{\"resolution\":7}", "/resolution", ERR_INVALID},
		{"{\"resolution\":129}", "/resolution", ERR_INVALID},
		{"{\"resolution\":20.5}", "/resolution", ERR_INVALID},
		{"{\"max_error\":0}", "/max_error", ERR_INVALID},
		{"{\"max_error\":1e-8}", "/max_error", ERR_INVALID},
		{"{\"max_error\":1.5}", "/max_error", ERR_INVALID},
		{"{\"max_error\":\"1e-3\"}", "/max_error", ERR_INVALID},
		{"{\"max_error\":1e-3,\"resolution\":32}", "/max_error",
		    ERR_INVALID},
		{"{\"opening\":\"camel\"}", "/opening", ERR_INVALID},
		{"{\"draft\":true}", "/draft", ERR_INVALID},
	};

	(void)state;
	for (size_t i = 0; i < sizeof cases / sizeof *cases; i++) {
		struct faults faults = {0};
		struct order order = {.max_error = 7.0};

		assert_int_equal(order_parse(cases[i].text,
		    strlen(cases[i].text), LAYOUT_WARPED, &order, &faults),
		    cases[i].err);
		assert_true(faults.count >= 1);
		assert_string_equal(faults.list[0].pointer, cases[i].pointer);
		assert_near(order.max_error, 7.0, 0.0);
	}
}

static void test_every_fault_is_said_at_once(void **state)
{
	static const char text[] = "{\"family\":\"x\",\"profile\":\"y\","
	    "\"layout\":\"z\",\"resolution\":1,\"maxerror\":1}";
	struct faults faults = {0};
	struct order order;

	(void)state;
	assert_int_equal(order_parse(text, strlen(text), LAYOUT_WARPED, &order,
	    &faults), ERR_INVALID);
	assert_int_equal(faults.count, 5);
}

int main(void)
{
	const struct CMUnitTest tests[] = {
		cmocka_unit_test(test_an_empty_order_is_of_the_default_table),
		cmocka_unit_test(test_every_member_is_read),
		cmocka_unit_test(test_samples_are_read),
		cmocka_unit_test(test_what_is_wrong_is_said_where_it_is),
		cmocka_unit_test(test_every_fault_is_said_at_once),
	};

	return cmocka_run_group_tests_name("order", tests, NULL, NULL);
}
