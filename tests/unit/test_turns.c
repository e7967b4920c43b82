/*
 * Whose turn it is among those that wait.
 */
#include <stdarg.h>
#include <stddef.h>
#include <setjmp.h>
#include <stdint.h>
#include <cmocka.h>

#include <stdio.h>
#include <string.h>

#include "server/turns.h"

#define MOST 64

/* What waits, each by a letter of its asker. */
struct fixture {
	struct turns turns;
	struct turn list[MOST];
	int count;
};

static void add(struct fixture *f, char asker, unsigned long cost)
{
	struct turn *turn = &f->list[f->count++];

	snprintf(turn->asker, sizeof turn->asker, "token %c", asker);
	turns_add(&f->turns, turn, cost);
}

static char letter(const struct turn *turn)
{
	return turn->asker[strlen("token ")];
}

/* Serves count of them; their askers to out. */
static void serve(struct fixture *f, int count, char *out)
{
	for (int i = 0; i < count; i++)
		*out++ = letter(turns_serve(&f->turns, &f->turns.first));
	*out = '\0';
}

static void add_all(struct fixture *f, const char *askers)
{
	for (; *askers != '\0'; askers++)
		add(f, *askers, 1);
}

static void test_one_asker_is_served_in_order(void **state)
{
	struct fixture f = {.count = 0};

	(void)state;
	add_all(&f, "aaa");
	for (int i = 0; i < 3; i++)
		assert_ptr_equal(turns_serve(&f.turns, &f.turns.first),
		    &f.list[i]);
	assert_null(f.turns.first);
	assert_int_equal(f.turns.count, 0);
}

static void test_who_comes_later_does_not_wait_for_all_of_another(void **state)
{
	struct fixture f = {.count = 0};
	char order[MOST];

	(void)state;
	add_all(&f, "aaaaaa");
	serve(&f, 2, order);
	add_all(&f, "bb");
	serve(&f, 6, order);
	assert_string_equal(order, "baba" "aa");
}

static void test_askers_take_turns(void **state)
{
	struct fixture f = {.count = 0};
	char order[MOST];

	(void)state;
	add_all(&f, "aaaabbbcc");
	serve(&f, 9, order);
	assert_string_equal(order, "abcabcaba");
}

/* Who has been idle has saved nothing up. */
static void test_idling_earns_nothing(void **state)
{
	struct fixture f = {.count = 0};
	char order[MOST];

	(void)state;
	add_all(&f, "aaaaaaaa");
	serve(&f, 6, order);
	add_all(&f, "bbbb");
	serve(&f, 6, order);
	assert_string_equal(order, "bababb");
}

static void test_turns_are_by_cost(void **state)
{
	struct fixture f = {.count = 0};
	char order[MOST];

	(void)state;
	add(&f, 'a', 4);
	add(&f, 'a', 4);
	for (int i = 0; i < 6; i++)
		add(&f, 'b', 1);
	serve(&f, 8, order);
	assert_string_equal(order, "abbbb" "abb");
}

/* A thread that takes some alone does not make others wait longer. */
static void test_passing_others_by_does_not_move_the_time(void **state)
{
	struct fixture f = {.count = 0};
	char order[MOST];
	struct turn **at = &f.turns.first;

	(void)state;
	add_all(&f, "aaaa");
	for (int i = 0; i < 3; i++)
		at = &(*at)->next;
	assert_ptr_equal(turns_serve(&f.turns, at), &f.list[3]);
	add_all(&f, "b");
	serve(&f, 4, order);
	assert_string_equal(order, "abaa");
}

static void test_what_is_dropped_is_gone(void **state)
{
	struct fixture f = {.count = 0};
	char order[MOST];

	(void)state;
	add_all(&f, "aab");
	assert_int_equal(turns_count_of(&f.turns, "token a"), 2);
	assert_ptr_equal(turns_drop(&f.turns, &f.turns.first), &f.list[0]);
	assert_int_equal(turns_count_of(&f.turns, "token a"), 1);
	assert_int_equal(turns_count_of(&f.turns, "token c"), 0);
	assert_int_equal(f.turns.count, 2);
	serve(&f, 2, order);
	assert_string_equal(order, "ba");
}

int main(void)
{
	const struct CMUnitTest tests[] = {
		cmocka_unit_test(test_one_asker_is_served_in_order),
		cmocka_unit_test(
		    test_who_comes_later_does_not_wait_for_all_of_another),
		cmocka_unit_test(test_askers_take_turns),
		cmocka_unit_test(test_idling_earns_nothing),
		cmocka_unit_test(test_turns_are_by_cost),
		cmocka_unit_test(test_passing_others_by_does_not_move_the_time),
		cmocka_unit_test(test_what_is_dropped_is_gone),
	};

	return cmocka_run_group_tests(tests, NULL, NULL);
}
