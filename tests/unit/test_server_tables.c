/*
 * The tables' side of loading: what the device thread has in hand stays, and
 * what does not fit does not keep others waiting.
 */
#include <stdarg.h>
#include <stddef.h>
#include <setjmp.h>
#include <stdint.h>
#include <cmocka.h>

#include <stdlib.h>
#include <unistd.h>

#include "core/table.h"
#include "server/table_cache.h"
#include "server/tables.h"
#include "tests/support/folder.h"

static void changed(void *ctx)
{
	(void)ctx;
}

static struct operator operator_of(double k, int resolution)
{
	return (struct operator){.family = FAMILY_UNION,
	    .profile = profile_bulge(k), .layout = LAYOUT_WARPED,
	    .resolution = resolution, .draft = true};
}

/* Plays the device thread: the next one built, of any claim. */
static struct table_entry *await_built(struct tables *t,
    const struct table **table, enum table_claim *claim)
{
	struct table_entry *entry = NULL;

	for (int i = 0; i < 60000 && entry == NULL; i++) {
		entry = tables_next_built(t, TABLE_SPARE, table, claim);
		if (entry == NULL)
			usleep(1000);
	}
	assert_non_null(entry);
	return entry;
}

static struct tables *start_with(struct table_cache *cache)
{
	struct tables *t;

	assert_int_equal(tables_create(LAYOUT_WARPED, &t), ERR_OK);
	assert_int_equal(tables_start(t, false, cache, changed, NULL), ERR_OK);
	for (int i = 0; i < 4; i++) {
		const struct table *table;
		enum table_claim claim;

		tables_loaded(t, await_built(t, &table, &claim), i);
	}
	return t;
}

static struct tables *start(void)
{
	return start_with(NULL);
}

static void acquire(struct tables *t, double k, int resolution,
    struct table_entry **entry, struct table_entry **draft)
{
	struct operator op = operator_of(k, resolution);

	assert_int_equal(tables_acquire(t, &op, entry), ERR_OK);
	assert_int_equal(tables_acquire_draft(t, &op, draft), ERR_OK);
}

static void test_a_table_being_uploaded_stays_when_its_wish_is_dropped(
    void **state)
{
	struct tables *t = start();
	struct table_entry *entries[7], *drafts[7], *chosen[7] = {0}, *e;
	struct table_choice one = {.entries = entries, .drafts = drafts,
	    .count = 1, .chosen = chosen};
	struct table_choice six = {.entries = entries + 1,
	    .drafts = drafts + 1, .count = 6, .chosen = chosen + 1};
	const struct table *table;
	enum table_claim claim;

	(void)state;
	for (int i = 0; i < 7; i++)
		acquire(t, 0.1 + 0.05 * i, 24, &entries[i], &drafts[i]);
	tables_choose(t, &one);
	while ((e = await_built(t, &table, &claim)) != entries[0])
		tables_loaded(t, e, 5);
	assert_int_equal(claim, TABLE_WISHED);
	tables_choose(t, &six);
	tables_unask(t, chosen, 1);
	tables_release(t, entries[0]);
	assert_int_equal(table->resolution, 24);
	assert_true(table->first[0] == table->first[0]);
	tables_put_back(t, e, claim);
	tables_unask(t, chosen + 1, 6);
	tables_stop(t);
	tables_free(t);
}

static void give(struct tables *t, double k, int resolution)
{
	struct operator op = operator_of(k, resolution);
	struct table_report report;
	struct table *table;

	assert_int_equal(table_create(op.family, &op.profile, op.layout,
	    op.resolution, &table), ERR_OK);
	table_build(table, 0, op.resolution);
	assert_int_equal(tables_give(t, &op, table, 0.0, &report), ERR_OK);
}

static void test_what_does_not_fit_is_passed_over_until_there_is_room(
    void **state)
{
	struct tables *t = start();
	const struct table_entry *evicted;
	struct table_entry *newer, *older;
	const struct table *table;
	enum table_claim claim;
	int slot;

	(void)state;
	give(t, 0.3, 17);
	give(t, 0.4, 18);
	newer = await_built(t, &table, &claim);
	assert_int_equal(table->resolution, 18);
	tables_put_back(t, newer, claim);
	older = await_built(t, &table, &claim);
	assert_int_equal(table->resolution, 17);
	tables_put_back(t, older, claim);
	assert_null(tables_next_built(t, TABLE_SPARE, &table, &claim));
	assert_true(tables_evict(t, TABLE_WISHED, &evicted, &slot));
	assert_ptr_equal(await_built(t, &table, &claim), newer);
	tables_loaded(t, newer, slot);
	assert_ptr_equal(tables_next_built(t, TABLE_SPARE, &table, &claim),
	    older);
	tables_loaded(t, older, 6);
	tables_stop(t);
	tables_free(t);
}

/* Has t make the table of op resident. */
static void load(struct tables *t, const struct operator *op,
    struct table_entry **entry)
{
	struct table_entry *chosen;
	struct table_choice choice = {.entries = entry, .count = 1,
	    .chosen = &chosen};
	const struct table *table;
	enum table_claim claim;

	assert_int_equal(tables_acquire(t, op, entry), ERR_OK);
	tables_choose(t, &choice);
	assert_ptr_equal(await_built(t, &table, &claim), *entry);
	tables_loaded(t, *entry, 7);
	tables_unask(t, &chosen, 1);
}

/* Five: the built-in ones and op's. */
static void test_tables_are_kept_and_found_again(void **state)
{
	struct operator op = operator_of(0.35, 24), moving = operator_of(0.36, 24);
	struct table_cache *cache;
	struct table_entry *entries[2];
	char folder[PATH_MAX];
	struct tables *t;

	(void)state;
	op.draft = false;
	folder_make(folder);
	assert_int_equal(table_cache_create(folder, (size_t)1 << 30, false,
	    &cache),
	    ERR_OK);
	t = start_with(cache);
	load(t, &op, &entries[0]);
	load(t, &moving, &entries[1]);
	tables_measure(t);
	for (int i = 0; i < 3000 && folder_count(folder, "figures-") < 5; i++)
		usleep(10000);
	tables_stop(t);
	tables_release(t, entries[0]);
	tables_release(t, entries[1]);
	tables_free(t);
	assert_int_equal(folder_count(folder, "table-"), 5);

	/* Loaded, none is written again. */
	t = start_with(cache);
	load(t, &op, &entries[0]);
	tables_measure(t);
	for (int i = 0; i < 2; i++) {
		struct table_report *list;
		size_t count;

		assert_int_equal(tables_report(t, &list, &count), ERR_OK);
		assert_int_equal(count, 5);
		for (size_t n = 0; n < count; n++) {
			assert_int_equal(list[n].state, TABLE_RESIDENT);
			assert_true(list[n].build_seconds > 0.0);
		}
		free(list);
		usleep(50000);
	}
	tables_stop(t);
	tables_release(t, entries[0]);
	tables_free(t);
	assert_int_equal(folder_count(folder, ""), 10);
	table_cache_free(cache);
	folder_remove(folder);
}

int main(void)
{
	const struct CMUnitTest tests[] = {
		cmocka_unit_test(
		test_a_table_being_uploaded_stays_when_its_wish_is_dropped),
		cmocka_unit_test(
		test_what_does_not_fit_is_passed_over_until_there_is_room),
		cmocka_unit_test(test_tables_are_kept_and_found_again),
	};

	return cmocka_run_group_tests(tests, NULL, NULL);
}
