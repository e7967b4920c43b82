/*
 * Tokens: what the file may say, who is found, and rates with debts.
 */
#include <stdarg.h>
#include <stddef.h>
#include <setjmp.h>
#include <stdint.h>
#include <cmocka.h>

#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "proto/fault.h"
#include "server/clock.h"
#include "server/token.h"
#include "tests/support/near.h"

/* SHA-256 of "abc" (FIPS 180-2, appendix B.1) and of "" . */
#define ABC "ba7816bf8f01cfea414140de5dae2223b00361a396177a9cb410ff61f20015ad"
#define NOTHING \
	"e3b0c44298fc1c149afbf4c8996fb92427ae41e4649b934ca495991b7852b855"

#define FILE_OF(entries) "{\"tokens\": [" entries "]}"
#define CI "{\"name\": \"ci\", \"role\": \"write\", \"sha256\": \"" ABC "\"}"

static struct token_table *read_table(const char *text,
    const struct token_table *old)
{
	struct faults faults = {0};
	struct token_table *table;
	enum err err = token_table_read(text, strlen(text), old, &table,
	    &faults);

	if (err != ERR_OK)
		fail_msg("%s: %s", faults.list[0].pointer,
		    faults.list[0].detail);
	return table;
}

/* text is refused at that place, for that reason. */
static void assert_wrong(const char *text, enum err err, const char *pointer,
    const char *says)
{
	struct faults faults = {0};
	struct token_table *table = NULL;

	assert_int_equal(token_table_read(text, strlen(text), NULL, &table,
	    &faults), err);
	assert_null(table);
	assert_true(faults.count > 0);
	assert_string_equal(faults.list[0].pointer, pointer);
	if (strstr(faults.list[0].detail, says) == NULL)
		fail_msg("'%s' is not in '%s'", says, faults.list[0].detail);
}

/* ---- rates ---- */

static void test_bucket_without_rate_is_never_empty(void **state)
{
	struct bucket b = {0};

	(void)state;
	bucket_set_rate(&b, 0.0, 1.0);
	bucket_take(&b, 1e300, 1.0);
	assert_near(bucket_wait(&b, 1.0), 0.0, 0.0);
}

static void test_bucket_gives_a_second_at_once(void **state)
{
	struct bucket b = {0};

	(void)state;
	bucket_set_rate(&b, 5.0, 100.0);
	for (int i = 0; i < 5; i++) {
		assert_near(bucket_wait(&b, 100.0), 0.0, 0.0);
		bucket_take(&b, 1.0, 100.0);
	}
	assert_true(bucket_wait(&b, 100.0) > 0.0);
	/* a fifth of a second later there is one */
	assert_near(bucket_wait(&b, 100.2), 0.0, 0.0);
}

static void test_bucket_debt_is_waited_for(void **state)
{
	struct bucket b = {0};

	(void)state;
	bucket_set_rate(&b, 10.0, 0.0);
	bucket_take(&b, 110.0, 0.0);
	/* (110 - 10) / 10 s */
	assert_near(bucket_wait(&b, 0.0), 10.0, 0.0);
	assert_near(bucket_wait(&b, 4.0), 6.0, 0.0);
	assert_near(bucket_wait(&b, 10.5), 0.0, 0.0);
}

static void test_bucket_holds_no_more_than_a_second(void **state)
{
	struct bucket b = {0};

	(void)state;
	bucket_set_rate(&b, 10.0, 0.0);
	bucket_take(&b, 15.0, 1e6);
	assert_near(bucket_wait(&b, 1e6), 0.5, 0.0);
}

static void test_bucket_slower_than_one_a_second_still_gives_one(void **state)
{
	struct bucket b = {0};

	(void)state;
	bucket_set_rate(&b, 0.1, 0.0);
	assert_near(bucket_wait(&b, 0.0), 0.0, 0.0);
	bucket_take(&b, 1.0, 0.0);
	assert_true(bucket_wait(&b, 0.0) > 0.0);
	/* On average one in ten seconds: 1.5 owed are there after 15 s. */
	bucket_take(&b, 1.5, 0.0);
	assert_near(bucket_wait(&b, 0.0), 15.0, 1e-12);
}

static void test_bucket_debt_ends_at_a_minute(void **state)
{
	struct bucket b = {0};

	(void)state;
	bucket_set_rate(&b, 1e4, 0.0);
	/* 8e6 points of a document of 32768 nodes: 4.7 days. */
	bucket_take(&b, 4.1e9, 0.0);
	assert_near(bucket_wait(&b, 0.0), BUCKET_DEBT_SECONDS, 0.0);
	bucket_take(&b, 4.1e9, 1.0);
	assert_near(bucket_wait(&b, 1.0), BUCKET_DEBT_SECONDS, 0.0);
	assert_near(bucket_wait(&b, 61.0), 0.0, 1e-3);
}

static void test_bucket_of_an_hour_and_a_half_keeps_to_it(void **state)
{
	struct bucket b = {0};

	(void)state;
	/* One in 5400 s: each is waited for in full. */
	bucket_set_rate(&b, 1.0 / 5400.0, 0.0);
	bucket_take(&b, 1.0, 0.0);
	bucket_take(&b, 1.0, 0.0);
	assert_near(bucket_wait(&b, 0.0), 5400.0, 1e-9);
	assert_false(bucket_is_beyond(&b, 1.0));
}

static void test_bucket_says_what_is_beyond_it(void **state)
{
	struct bucket b = {0};

	(void)state;
	assert_false(bucket_is_beyond(&b, 1e300));
	bucket_set_rate(&b, 100.0, 0.0);
	assert_false(bucket_is_beyond(&b, 360000.0));
	assert_true(bucket_is_beyond(&b, 360001.0));
}

static void test_bucket_clock_that_goes_back_gives_nothing(void **state)
{
	struct bucket b = {0};

	(void)state;
	bucket_set_rate(&b, 10.0, 5.0);
	bucket_take(&b, 20.0, 5.0);
	assert_near(bucket_wait(&b, 4.0), 1.0, 0.0);
	assert_near(bucket_wait(&b, 5.5), 0.5, 1e-12);
}

/* Rates as a file may have them, and a clock that stands, or leaps by 30 years. */
static void test_bucket_extremes_stay_finite(void **state)
{
	static const double rates[] = {5e-324, 1e-300, 1e-9, 1.0, 1e15};
	static const double times[] = {0.0, 0.0, 1e-9, 1e9, 1e9};

	(void)state;
	for (size_t i = 0; i < sizeof rates / sizeof *rates; i++) {
		struct bucket b = {0};

		bucket_set_rate(&b, rates[i], 0.0);
		for (size_t k = 0; k < sizeof times / sizeof *times; k++) {
			double wait = bucket_wait(&b, times[k]);

			assert_true(wait >= 0.0 && !isnan(wait));
			bucket_take(&b, 1e300, times[k]);
			assert_true(isfinite(b.level));
			assert_true(bucket_wait(&b, times[k]) > 0.0);
			/* A minute's, or one, is what is waited for. */
			assert_true(bucket_wait(&b, times[k]) <=
			    fmax(60.0, 1.0 / rates[i]) * (1.0 + 1e-12));
		}
		/* After a leap there is a second's, not a year's. */
		bucket_wait(&b, 2e9);
		assert_true(b.level <= fmax(rates[i], 1.0));
	}
}

static void test_bucket_average_is_the_rate(void **state)
{
	struct bucket b = {0};
	double taken = 0.0;

	(void)state;
	bucket_set_rate(&b, 1000.0, 0.0);
	/* Whatever is asked for, whenever it goes: 100 s. */
	for (int i = 0; i < 10000; i++) {
		const double now = 0.01 * i, amount = 1.0 + i * 37 % 900;

		if (bucket_wait(&b, now) > 0.0)
			continue;
		bucket_take(&b, amount, now);
		taken += amount;
	}
	print_message("measured: %.0f taken in 100 s of 1000 a second\n",
	    taken);
	/* A second's at the beginning, and the last one's debt. */
	assert_true(taken >= 100e3 && taken <= 100e3 + 1000.0 + 900.0);
}

/* ---- the file ---- */

static void test_file_is_read(void **state)
{
	struct token_table *t = read_table(FILE_OF(
	    "{\"name\": \"a.b-c_1\", \"role\": \"admin\", \"sha256\": \"" ABC
	    "\", \"limits\": {\"requests_per_second\": 0.5, "
	    "\"points_per_second\": 1e6, \"bytes_per_second\": 7, "
	    "\"scenes\": 0, \"volume_bytes\": 1e15}}, {\"name\": "
	    "\"anonymous\", \"role\": \"read\"}"), NULL);

	(void)state;
	assert_int_equal(t->count, 2);
	assert_string_equal(t->tokens[0].name, "a.b-c_1");
	assert_int_equal(t->tokens[0].role, ROLE_ADMIN);
	assert_near(t->tokens[0].rates[TOKEN_REQUESTS], 0.5, 0.0);
	assert_near(t->tokens[0].rates[TOKEN_POINTS], 1e6, 0.0);
	assert_near(t->tokens[0].rates[TOKEN_BYTES], 7.0, 0.0);
	assert_int_equal(t->tokens[0].scenes, 0);
	assert_true(t->tokens[0].volume_bytes == 1000000000000000);
	assert_ptr_equal(t->anonymous, &t->tokens[1]);
	assert_int_equal(t->anonymous->role, ROLE_READ);
	assert_true(t->anonymous->scenes == SIZE_MAX);
	assert_true(t->anonymous->volume_bytes == SIZE_MAX);
	token_table_release(t);
}

static void test_file_without_entries_lets_nobody_in(void **state)
{
	struct token_table *t = read_table(FILE_OF(""), NULL);

	(void)state;
	assert_int_equal(t->count, 0);
	assert_null(token_find(t, "abc", 3));
	assert_null(t->anonymous);
	token_table_release(t);
}

static void test_file_faults_have_places(void **state)
{
	static const struct {
		const char *text;
		enum err err;
		const char *pointer, *says;
	} cases[] = {
		{"", ERR_SYNTAX, "", "line 1"},
		{"{\"tokens\": [}", ERR_SYNTAX, "/tokens/0", "line 1, column"},
		{"[]", ERR_INVALID, "", "must be an object"},
		{"{}", ERR_INVALID, "", "needs a member 'tokens'"},
		{"{\"tokens\": {}}", ERR_INVALID, "/tokens", "an array"},
		{"{\"tokens\": [], \"token\": 1}", ERR_INVALID, "/token",
		    "not known"},
		{FILE_OF("1"), ERR_INVALID, "/tokens/0", "an object"},
		{FILE_OF("{\"role\": \"read\", \"sha256\": \"" ABC "\"}"),
		    ERR_INVALID, "/tokens/0", "needs a member 'name'"},
		{FILE_OF("{\"name\": \"a b\", \"role\": \"read\", \"sha256\": "
		    "\"" ABC "\"}"), ERR_INVALID, "/tokens/0/name", "A-Z"},
		{FILE_OF("{\"name\": \"a\", \"role\": \"root\", \"sha256\": \""
		    ABC "\"}"), ERR_INVALID, "/tokens/0/role", "\"admin\""},
		{FILE_OF("{\"name\": \"a\", \"role\": \"none\", \"sha256\": \""
		    ABC "\"}"), ERR_INVALID, "/tokens/0/role", "\"admin\""},
		{FILE_OF("{\"name\": \"a\", \"role\": \"read\"}"),
		    ERR_INVALID, "/tokens/0", "sha256"},
		{FILE_OF("{\"name\": \"a\", \"role\": \"read\", \"sha256\": "
		    "\"bf_secret\"}"), ERR_INVALID, "/tokens/0/sha256", "64"},
		{FILE_OF("{\"name\": \"anonymous\", \"role\": \"admin\"}"),
		    ERR_INVALID, "/tokens/0/role", "cannot be"},
		{FILE_OF("{\"name\": \"anonymous\", \"role\": \"read\", "
		    "\"sha256\": \"" ABC "\"}"), ERR_INVALID,
		    "/tokens/0/sha256", "no secret"},
		{FILE_OF("{\"name\": \"a\", \"role\": \"read\", \"sha256\": \""
		    ABC "\", \"limit\": {}}"), ERR_INVALID, "/tokens/0/limit",
		    "not known"},
		{FILE_OF("{\"name\": \"a\", \"role\": \"read\", \"sha256\": \""
		    ABC "\", \"limits\": {\"points\": 1}}"), ERR_INVALID,
		    "/tokens/0/limits/points", "not known"},
		{FILE_OF("{\"name\": \"a\", \"role\": \"read\", \"sha256\": \""
		    ABC "\", \"limits\": {\"points_per_second\": 0}}"),
		    ERR_INVALID, "/tokens/0/limits/points_per_second",
		    "above 0"},
		{FILE_OF("{\"name\": \"a\", \"role\": \"read\", \"sha256\": \""
		    ABC "\", \"limits\": {\"bytes_per_second\": 1e999}}"),
		    ERR_INVALID, "/tokens/0/limits/bytes_per_second",
		    "at most"},
		{FILE_OF("{\"name\": \"a\", \"role\": \"read\", \"sha256\": \""
		    ABC "\", \"limits\": {\"scenes\": 1.5}}"), ERR_INVALID,
		    "/tokens/0/limits/scenes", "whole"},
		{FILE_OF("{\"name\": \"a\", \"role\": \"read\", \"sha256\": \""
		    ABC "\", \"limits\": {\"volume_bytes\": -1}}"),
		    ERR_INVALID, "/tokens/0/limits/volume_bytes", "whole"},
		{FILE_OF("{\"name\": \"a\", \"role\": \"read\", \"sha256\": \""
		    ABC "\", \"limits\": {\"volume_bytes\": 2e15}}"),
		    ERR_INVALID, "/tokens/0/limits/volume_bytes", "1e+15"},
		{FILE_OF(CI ", {\"name\": \"ci\", \"role\": \"read\", "
		    "\"sha256\": \"" NOTHING "\"}"), ERR_INVALID,
		    "/tokens/1", "the name of entry 0"},
		{FILE_OF(CI ", {\"name\": \"b\", \"role\": \"read\", "
		    "\"sha256\": \"" ABC "\"}"), ERR_INVALID, "/tokens/1",
		    "the secret of entry 0"},
	};

	(void)state;
	for (size_t i = 0; i < sizeof cases / sizeof *cases; i++)
		assert_wrong(cases[i].text, cases[i].err, cases[i].pointer,
		    cases[i].says);
}

static void test_file_with_too_many_entries_is_refused(void **state)
{
	const size_t size = (TOKENS_MAX + 1) * 8 + 100;
	char *text = malloc(size);
	size_t n;

	(void)state;
	assert_non_null(text);
	n = (size_t)snprintf(text, size, "{\"tokens\": [");
	for (int i = 0; i <= TOKENS_MAX; i++)
		n += (size_t)snprintf(text + n, size - n, "%s{}",
		    i > 0 ? "," : "");
	snprintf(text + n, size - n, "]}");
	assert_wrong(text, ERR_LIMIT, "/tokens", "1024");
	free(text);
}

/* ---- who is found ---- */

static void test_find_by_sha256_of_the_secret(void **state)
{
	struct token_table *t = read_table(FILE_OF(
	    "{\"name\": \"anonymous\", \"role\": \"read\"}," CI), NULL);

	(void)state;
	assert_ptr_equal(token_find(t, "abc", 3), &t->tokens[1]);
	assert_null(token_find(t, "abd", 3));
	assert_null(token_find(t, "ab", 2));
	assert_null(token_find(t, "", 0));
	assert_null(token_find(t, ABC, strlen(ABC)));
	token_table_release(t);
}

static void test_find_among_many_finds_each(void **state)
{
	enum {COUNT = 200};
	char *text = malloc(COUNT * 160 + 32);
	uint8_t hash[TOKEN_HASH_BYTES];
	struct token_table *t;
	char name[16];
	int n = sprintf(text, "{\"tokens\": [");

	(void)state;
	for (int i = 0; i < COUNT; i++) {
		sprintf(name, "t%d", i);
		token_hash(name, strlen(name), hash);
		n += sprintf(text + n, "%s{\"name\": \"%s\", \"role\": "
		    "\"read\", \"sha256\": \"", i > 0 ? "," : "", name);
		for (int k = 0; k < TOKEN_HASH_BYTES; k++)
			n += sprintf(text + n, "%02X", hash[k]);
		n += sprintf(text + n, "\"}");
	}
	sprintf(text + n, "]}");
	t = read_table(text, NULL);
	for (int i = 0; i < COUNT; i++) {
		sprintf(name, "t%d", i);
		assert_ptr_equal(token_find(t, name, strlen(name)),
		    &t->tokens[i]);
	}
	token_table_release(t);
	free(text);
}

static double find_seconds(const struct token_table *t, const char *secret)
{
	double best = 1e9;

	for (int k = 0; k < 200; k++) {
		const double begin = clock_seconds();

		for (int i = 0; i < 20; i++)
			token_find(t, secret, strlen(secret));
		if (clock_seconds() - begin < best)
			best = clock_seconds() - begin;
	}
	return best / 20;
}

static void test_find_takes_as_long_for_known_and_unknown(void **state)
{
	char *text = malloc(1000 * 160 + 32);
	struct token_table *t;
	double first, last, none;
	int n = sprintf(text, "{\"tokens\": [" CI);

	(void)state;
	for (int i = 0; i < 998; i++)
		n += sprintf(text + n, ",{\"name\": \"t%d\", \"role\": "
		    "\"read\", \"sha256\": \"%064d\"}", i, i + 1);
	sprintf(text + n, ",{\"name\": \"last\", \"role\": \"read\", "
	    "\"sha256\": \"cb8379ac2098aa165029e3938a51da0bcecfc008fd6795f401"
	    "178647f96c5b34\"}]}"); /* of "def" */
	t = read_table(text, NULL);
	assert_non_null(token_find(t, "def", 3));
	first = find_seconds(t, "abc");
	last = find_seconds(t, "def");
	none = find_seconds(t, "xyz");
	print_message("measured: of 1000 tokens the first %.2f us, the last "
	    "%.2f us, none %.2f us\n", 1e6 * first, 1e6 * last, 1e6 * none);
	/* Equal to 1 % where nothing else runs; a comparison that ended at the
	 * first would differ by a factor of 50. */
	assert_true(first < 2.0 * none && none < 2.0 * first);
	assert_true(last < 2.0 * none && none < 2.0 * last);
	token_table_release(t);
	free(text);
}

/* ---- reading anew ---- */

#define LIMITED(rate) "{\"name\": \"ci\", \"role\": \"write\", \"sha256\": \"" \
	ABC "\", \"limits\": {\"points_per_second\": " rate "}}"

static void test_reload_keeps_what_was_used(void **state)
{
	struct token_table *old = read_table(FILE_OF(LIMITED("100")), NULL);
	struct token_table *t;
	double now = clock_seconds();

	(void)state;
	assert_near(token_try(old->tokens, TOKEN_POINTS, 5e3, now), 0.0, 0.0);
	t = read_table(FILE_OF("{\"name\": \"new\", \"role\": \"read\", "
	    "\"sha256\": \"" NOTHING "\"}," LIMITED("1000")), old);
	token_table_release(old);
	now = clock_seconds();
	/* 5000 - 100 owed, at 1000 a second; less the time since. */
	assert_near(token_try(&t->tokens[1], TOKEN_POINTS, 1.0, now), 4.9,
	    0.5);
	assert_near(t->tokens[1].use->taken[TOKEN_POINTS], 5e3, 0.0);
	assert_near(t->tokens[1].use->refused, 1.0, 0.0);
	token_table_release(t);
}

static void test_reload_lets_holders_of_the_old_table_go_on(void **state)
{
	struct token_table *old = read_table(FILE_OF(CI), NULL);
	const struct token *token = token_find(old, "abc", 3);
	struct token_table *t;

	(void)state;
	token_table_hold(token->table);
	t = read_table(FILE_OF(""), old);
	token_table_release(old); /* who reloads lets go */
	assert_string_equal(token->name, "ci");
	token_take(token, TOKEN_BYTES, 10.0, clock_seconds());
	token_table_release(token->table);
	token_table_release(t);
}

static void test_reload_of_a_wrong_file_changes_nothing(void **state)
{
	struct token_table *old = read_table(FILE_OF(LIMITED("100")), NULL);
	struct faults faults = {0};
	struct token_table *t = NULL;
	static const char text[] = FILE_OF(LIMITED("5") ", 1");

	(void)state;
	assert_int_equal(token_table_read(text, strlen(text), old, &t,
	    &faults), ERR_INVALID);
	assert_null(t);
	assert_near(old->tokens[0].use->buckets[TOKEN_POINTS].rate, 100.0,
	    0.0);
	assert_int_equal(atomic_load(&old->tokens[0].use->holders), 1);
	token_table_release(old);
}

/* ---- guests ---- */

#define ANONYMOUS(more) "{\"name\": \"anonymous\", \"role\": \"read\"" more "}"

static const struct token *guest_of(const struct token_table *t, int host)
{
	const uint8_t address[TOKEN_ADDRESS_BYTES] = {[10] = 0xff, 0xff,
	    10, 0, (uint8_t)(host >> 8), (uint8_t)host};

	return token_guest(t, address);
}

static void test_guests_do_not_pay_for_each_other(void **state)
{
	struct token_table *t = read_table(FILE_OF(ANONYMOUS(
	    ", \"limits\": {\"points_per_second\": 100}")), NULL);
	const double now = clock_seconds();
	int waiting = 0;

	(void)state;
	assert_near(token_try(guest_of(t, 0), TOKEN_POINTS, 1e5, now), 0.0,
	    0.0);
	assert_near(token_try(guest_of(t, 0), TOKEN_POINTS, 1.0, now), 60.0,
	    0.0);
	for (int i = 1; i <= 100; i++)
		waiting += token_try(guest_of(t, i), TOKEN_POINTS, 1.0, now) >
		    0.0;
	/* Each has the place of the first by a chance of 1/1024; that more than
	 * 3 of 100 do, by 4e-6. */
	assert_true(waiting <= 3);
	/* In sum they are the entry's. */
	assert_near(t->anonymous->use->taken[TOKEN_POINTS], 1e5 + 100 -
	    waiting, 0.0);
	assert_near(t->anonymous->use->refused, 1.0 + waiting, 0.0);
	assert_true(token_is_anonymous(guest_of(t, 7)));
	assert_true(token_is_anonymous(t->anonymous));
	assert_string_equal(guest_of(t, 7)->name, "anonymous");
	token_table_release(t);
}

static void test_guests_are_remembered_by_the_next_table(void **state)
{
	static const char text[] = FILE_OF(ANONYMOUS(
	    ", \"limits\": {\"points_per_second\": 100}"));
	struct token_table *old = read_table(text, NULL), *t;
	const double now = clock_seconds();

	(void)state;
	assert_near(token_try(guest_of(old, 0), TOKEN_POINTS, 1e5, now), 0.0,
	    0.0);
	t = read_table(text, old);
	token_table_release(old);
	/* Less what has passed since. */
	assert_near(token_try(guest_of(t, 0), TOKEN_POINTS, 1.0, now), 60.0,
	    1.0);
	token_table_release(t);
}

static void test_guests_without_limits_are_the_entry(void **state)
{
	struct token_table *t = read_table(FILE_OF(ANONYMOUS("")), NULL);

	(void)state;
	assert_ptr_equal(guest_of(t, 1), t->anonymous);
	token_table_release(t);
	t = read_table(FILE_OF(CI), NULL);
	assert_null(guest_of(t, 1));
	assert_false(token_is_anonymous(t->tokens));
	token_table_release(t);
}

int main(void)
{
	const struct CMUnitTest tests[] = {
		cmocka_unit_test(test_bucket_without_rate_is_never_empty),
		cmocka_unit_test(test_bucket_gives_a_second_at_once),
		cmocka_unit_test(test_bucket_debt_is_waited_for),
		cmocka_unit_test(test_bucket_holds_no_more_than_a_second),
		cmocka_unit_test(
		    test_bucket_slower_than_one_a_second_still_gives_one),
		cmocka_unit_test(test_bucket_debt_ends_at_a_minute),
		cmocka_unit_test(test_bucket_of_an_hour_and_a_half_keeps_to_it),
		cmocka_unit_test(test_bucket_says_what_is_beyond_it),
		cmocka_unit_test(test_bucket_clock_that_goes_back_gives_nothing),
		cmocka_unit_test(test_bucket_extremes_stay_finite),
		cmocka_unit_test(test_bucket_average_is_the_rate),
		cmocka_unit_test(test_file_is_read),
		cmocka_unit_test(test_file_without_entries_lets_nobody_in),
		cmocka_unit_test(test_file_faults_have_places),
		cmocka_unit_test(test_file_with_too_many_entries_is_refused),
		cmocka_unit_test(test_find_by_sha256_of_the_secret),
		cmocka_unit_test(test_find_among_many_finds_each),
		cmocka_unit_test(test_find_takes_as_long_for_known_and_unknown),
		cmocka_unit_test(test_reload_keeps_what_was_used),
		cmocka_unit_test(
		    test_reload_lets_holders_of_the_old_table_go_on),
		cmocka_unit_test(test_guests_do_not_pay_for_each_other),
		cmocka_unit_test(test_guests_are_remembered_by_the_next_table),
		cmocka_unit_test(test_guests_without_limits_are_the_entry),
		cmocka_unit_test(test_reload_of_a_wrong_file_changes_nothing),
	};

	return cmocka_run_group_tests(tests, NULL, NULL);
}
