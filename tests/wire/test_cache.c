/*
 * What the daemon keeps from one start to the next. Each case has a cache of
 * its own.
 */
#include <stdarg.h>
#include <stddef.h>
#include <setjmp.h>
#include <stdint.h>
#include <cmocka.h>

#include <fcntl.h>
#include <signal.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/stat.h>
#include <unistd.h>

#include "tests/support/daemon.h"
#include "tests/support/folder.h"
#include "tests/support/http.h"

#define OUTPUT_MAX 16384

/* Every built-in table: unions and a difference of either profile. */
static const char body[] = "{\"scene\":{\"format\":\"blobfield/1\",\"root\":"
    "{\"type\":\"difference\",\"operator\":\"contact\",\"children\":["
    "{\"type\":\"union\",\"operator\":\"contact\",\"children\":["
    "{\"type\":\"intersection\",\"operator\":\"camel\",\"children\":["
    "{\"type\":\"union\",\"operator\":\"camel\",\"children\":["
    "{\"type\":\"point\",\"center\":[0,0,0],\"radius\":1},"
    "{\"type\":\"point\",\"center\":[0.8,0.3,0],\"radius\":1}]},"
    "{\"type\":\"point\",\"center\":[0.4,0,0.2],\"radius\":1.2}]},"
    "{\"type\":\"point\",\"center\":[1.2,0,0.1],\"radius\":0.8}]},"
    "{\"type\":\"point\",\"center\":[0.3,0.9,0],\"radius\":0.5}]}},"
    "\"outputs\":[\"value\",\"gradient\",\"hessian\"],"
    "\"points\":[[0,0,0],[0.4,0.2,0.1],[0.9,0.3,-0.2],[1.3,0.2,0.3],"
    "[0.3,0.6,0.1],[-0.4,0.1,0.5],[0.7,-0.4,0.2],[0.1,0.55,-0.3]]}";

static void start(struct daemon *d, const char *const *arguments)
{
	daemon_start(d, arguments);
	daemon_await_ready(d);
}

static void stop(struct daemon *d)
{
	assert_int_equal(daemon_stop(d, SIGTERM), 0);
}

/* The answer to body; free it. */
static char *answer(const struct daemon *d)
{
	struct http_reply reply;
	char *text;

	http_json(d->url, NULL, "/v1/eval", body, &reply);
	assert_int_equal(reply.status, 200);
	text = strdup(reply.body);
	assert_non_null(text);
	http_reply_fini(&reply);
	return text;
}

/* What is known of the tables, how long they took to build included. */
static char *list(const struct daemon *d)
{
	struct http_reply reply;
	char *text;

	http_get(d->url, "/v1/operators", &reply);
	assert_int_equal(reply.status, 200);
	text = strdup(reply.body);
	assert_non_null(text);
	http_reply_fini(&reply);
	return text;
}

static void await_files(const char *folder, const char *prefix, int count)
{
	for (int i = 0; i < 6000 && folder_count(folder, prefix) < count; i++)
		usleep(20000);
	assert_int_equal(folder_count(folder, prefix), count);
}

/* Starts a daemon on folder and stops it once its tables are there. */
static void fill(const char *folder)
{
	const char *const arguments[] = {"--no-measure", "--cache", folder,
	    NULL};
	struct daemon d;

	start(&d, arguments);
	await_files(folder, "figures-", 4);
	assert_int_equal(folder_count(folder, "table-"), 4);
	stop(&d);
}

/* Starts a daemon whose log goes to a file; how many lines of it say what. */
static int count_in_log(const char *const *arguments, const char *what)
{
	static char text[OUTPUT_MAX];
	char name[PATH_MAX];
	struct daemon d;
	int count = 0, saved, fd;
	ssize_t length;

	folder_make(name);
	fd = open(name, O_TMPFILE | O_RDWR, 0600);
	assert_true(fd >= 0);
	folder_remove(name);
	saved = dup(STDERR_FILENO);
	dup2(fd, STDERR_FILENO);
	daemon_start(&d, arguments);
	dup2(saved, STDERR_FILENO);
	close(saved);
	daemon_await_ready(&d);
	stop(&d);
	length = pread(fd, text, sizeof text - 1, 0);
	assert_true(length >= 0);
	text[length] = '\0';
	close(fd);
	for (const char *at = text; (at = strstr(at, what)) != NULL; at++)
		count++;
	return count;
}

static void test_a_second_start_loads_and_answers_the_same(void **state)
{
	char folder[PATH_MAX], *first, *second, *tables, *later;
	const char *const quiet[] = {"--no-measure", "--cache", folder, NULL};
	const char *const loud[] = {"--no-measure", "--cache", folder,
	    "--log-level", "info", NULL};
	struct daemon d;

	(void)state;
	folder_make(folder);
	start(&d, quiet);
	first = answer(&d);
	tables = list(&d);
	await_files(folder, "figures-", 4);
	stop(&d);

	assert_int_equal(count_in_log(loud, "from the cache in"), 4);
	start(&d, quiet);
	second = answer(&d);
	later = list(&d);
	assert_string_equal(second, first);
	assert_string_equal(later, tables);
	stop(&d);
	free(first);
	free(second);
	free(tables);
	free(later);
	folder_remove(folder);
}

static void damage(void *ctx, const char *path)
{
	int *count = ctx, fd = open(path, O_RDWR);
	struct stat info;
	char byte;

	assert_true(fd >= 0);
	assert_int_equal(fstat(fd, &info), 0);
	switch ((*count)++ % 3) {
	case 0:
		assert_int_equal(pread(fd, &byte, 1, info.st_size / 2), 1);
		byte ^= 1;
		assert_int_equal(pwrite(fd, &byte, 1, info.st_size / 2), 1);
		break;
	case 1:
		assert_int_equal(ftruncate(fd, info.st_size / 2), 0);
		break;
	case 2:
		assert_int_equal(ftruncate(fd, 0), 0);
		break;
	}
	close(fd);
}

static void test_what_is_damaged_is_built_and_replaced(void **state)
{
	char folder[PATH_MAX];
	const char *const arguments[] = {"--no-measure", "--cache", folder,
	    "--log-level", "info", NULL};
	int count = 0;

	(void)state;
	folder_make(folder);
	fill(folder);
	folder_each(folder, damage, &count);
	assert_true(count >= 8);
	assert_int_equal(count_in_log(arguments, "from the cache in"), 0);
	fill(folder);
	assert_int_equal(count_in_log(arguments, "from the cache in"), 4);
	folder_remove(folder);
}

static void test_two_daemons_share_a_cache(void **state)
{
	char folder[PATH_MAX], *first, *second;
	const char *const arguments[] = {"--no-measure", "--cache", folder,
	    NULL};
	struct daemon a, b;

	(void)state;
	folder_make(folder);
	daemon_start(&a, arguments);
	daemon_start(&b, arguments);
	daemon_await_ready(&a);
	daemon_await_ready(&b);
	first = answer(&a);
	second = answer(&b);
	assert_string_equal(first, second);
	await_files(folder, "figures-", 4);
	stop(&a);
	stop(&b);
	free(first);
	free(second);
	assert_int_equal(folder_count(folder, "table-"), 4);
	folder_remove(folder);
}

static void test_a_cache_that_cannot_be_is_a_warning(void **state)
{
	static const char *const arguments[] = {"--no-measure", "--cache",
	    "/dev/null/cache", NULL};

	(void)state;
	assert_int_equal(count_in_log(arguments,
	    "cache /dev/null/cache: Not a directory; going on without"), 1);
}

static void test_no_cache_keeps_nothing(void **state)
{
	char folder[PATH_MAX];
	const char *const arguments[] = {"--no-measure", "--cache", folder,
	    "--no-cache", NULL};
	struct daemon d;

	(void)state;
	folder_make(folder);
	start(&d, arguments);
	usleep(300000);
	stop(&d);
	assert_int_equal(folder_count(folder, ""), 0);
	folder_remove(folder);
}

/* Points singly: those kernels compile soonest, 13 s if PoCL has none. */
static void test_kernels_come_out_of_a_filled_cache(void **state)
{
	char folder[PATH_MAX], output[OUTPUT_MAX];
	const char *const filling[] = {"--width", "1", "--cache", folder,
	    "--fill-cache", NULL};
	const char *const arguments[] = {"--width", "1", "--cache", folder,
	    "--no-measure", "--log-level", "info", NULL};

	(void)state;
	folder_make(folder);
	assert_int_equal(daemon_run(filling, output, sizeof output), 0);
	assert_int_equal(folder_count(folder, "kernels-"), 2);
	assert_int_equal(count_in_log(arguments, "kernels from the cache"), 1);
	folder_each(folder, damage, &(int){1});
	assert_int_equal(count_in_log(arguments, "kernels from the cache"), 0);
	folder_remove(folder);
}

int main(void)
{
	const struct CMUnitTest tests[] = {
		cmocka_unit_test(
		    test_a_second_start_loads_and_answers_the_same),
		cmocka_unit_test(test_what_is_damaged_is_built_and_replaced),
		cmocka_unit_test(test_two_daemons_share_a_cache),
		cmocka_unit_test(test_a_cache_that_cannot_be_is_a_warning),
		cmocka_unit_test(test_no_cache_keeps_nothing),
		cmocka_unit_test(test_kernels_come_out_of_a_filled_cache),
	};

	return cmocka_run_group_tests(tests, NULL, NULL);
}
