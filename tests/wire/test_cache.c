/*
 * What the daemon keeps from one start to the next. Each case has a cache of
 * its own.
 */
#include <stdarg.h>
#include <stddef.h>
#include <setjmp.h>
#include <stdint.h>
#include <cmocka.h>

#include <ctype.h>
#include <dirent.h>
#include <fcntl.h>
#include <poll.h>
#include <signal.h>
#include <stdbool.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/stat.h>
#include <sys/wait.h>
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

/* Starts a daemon whose log goes to a file, which it returns. */
static int start_logged(struct daemon *d, const char *const *arguments)
{
	char name[PATH_MAX];
	int saved, fd;

	folder_make(name);
	fd = open(name, O_TMPFILE | O_RDWR | O_CLOEXEC, 0600);
	assert_true(fd >= 0);
	folder_remove(name);
	saved = dup(STDERR_FILENO);
	dup2(fd, STDERR_FILENO);
	daemon_start(d, arguments);
	dup2(saved, STDERR_FILENO);
	close(saved);
	return fd;
}

/* How many lines of a log say what. */
static int count_lines(int fd, const char *what)
{
	static char text[OUTPUT_MAX];
	ssize_t length = pread(fd, text, sizeof text - 1, 0);
	int count = 0;

	assert_true(length >= 0);
	text[length] = '\0';
	for (const char *at = text; (at = strstr(at, what)) != NULL; at++)
		count++;
	return count;
}

static void await_line(int fd, const char *what)
{
	for (int i = 0; i < 6000 && count_lines(fd, what) == 0; i++)
		usleep(20000);
	assert_int_equal(count_lines(fd, what), 1);
}

/* Stops a daemon of start_logged; a bad end shows what it logged. */
static void stop_logged(struct daemon *d, int log)
{
	static char text[OUTPUT_MAX];
	int status = daemon_stop(d, SIGTERM);
	ssize_t length = status != 0 ? pread(log, text, sizeof text, 0) : 0;

	if (length > 0)
		fprintf(stderr, "its log:\n%.*s\n", (int)length, text);
	assert_int_equal(status, 0);
}

/* Starts a daemon and stops it; how many lines of its log say what. */
static int count_in_log(const char *const *arguments, const char *what)
{
	struct daemon d;
	int fd = start_logged(&d, arguments), count;

	daemon_await_ready(&d);
	stop_logged(&d, fd);
	count = count_lines(fd, what);
	close(fd);
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

#define FILES_MAX 16

struct files {
	char paths[FILES_MAX][PATH_MAX];
	int count;
};

static void add_file(void *ctx, const char *path)
{
	struct files *files = ctx;

	assert_true(files->count < FILES_MAX);
	snprintf(files->paths[files->count++], PATH_MAX, "%s", path);
}

static int compare_paths(const void *a, const void *b)
{
	return strcmp(a, b);
}

static void damage(const char *path, int how)
{
	int fd = open(path, O_RDWR);
	struct stat info;
	char byte;

	assert_true(fd >= 0);
	assert_int_equal(fstat(fd, &info), 0);
	/* A killed writer's part may be empty. */
	switch (info.st_size > 0 ? how % 3 : 2) {
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

/* Every file, in the order of their names one in each way; how many. */
static int damage_all(const char *folder)
{
	struct files *files = calloc(1, sizeof *files);
	int count;

	assert_non_null(files);
	folder_each(folder, add_file, files);
	count = files->count;
	qsort(files->paths, (size_t)count, sizeof *files->paths,
	    compare_paths);
	for (int i = 0; i < count; i++)
		damage(files->paths[i], i);
	free(files);
	return count;
}

/* Tables are written in the background, at no time that could be waited for:
 * starts daemons that live ever longer until one has found them all. How many
 * the last one found. */
static int await_replaced(const char *const *arguments)
{
	int found = 0;

	for (useconds_t i = 1; i <= 10 && found < 4; i++) {
		struct daemon d;

		start(&d, arguments);
		usleep(i * 500000);
		stop(&d);
		found = count_in_log(arguments, "from the cache in");
	}
	return found;
}

static void test_what_is_damaged_is_built_and_replaced(void **state)
{
	char folder[PATH_MAX];
	const char *const arguments[] = {"--no-measure", "--cache", folder,
	    "--log-level", "info", NULL};

	(void)state;
	folder_make(folder);
	fill(folder);
	assert_true(damage_all(folder) >= 8);
	assert_int_equal(count_in_log(arguments, "from the cache in"), 0);
	assert_int_equal(await_replaced(arguments), 4);
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

/* ---- the process that fills ---- */

/* The parent of a process; 0: it is gone, or a zombie. */
static pid_t parent_of(const char *pid)
{
	char path[PATH_MAX], text[512], state;
	const char *at;
	int parent;
	FILE *file;

	snprintf(path, sizeof path, "/proc/%s/stat", pid);
	file = fopen(path, "r");
	if (file == NULL)
		return 0;
	text[fread(text, 1, sizeof text - 1, file)] = '\0';
	fclose(file);
	at = strrchr(text, ')'); /* its name may hold anything */
	return at != NULL && sscanf(at, ") %c %d", &state, &parent) == 2 &&
	    state != 'Z' ? parent : 0;
}

/* Whether a process has ended, waited for or not. */
static bool is_gone(pid_t pid)
{
	char name[16];

	snprintf(name, sizeof name, "%d", (int)pid);
	return parent_of(name) == 0;
}

/* A child of parent, or 0. */
static pid_t find_child(pid_t parent)
{
	DIR *dir = opendir("/proc");
	struct dirent *entry;
	pid_t child = 0;

	assert_non_null(dir);
	while (child == 0 && (entry = readdir(dir)) != NULL) {
		if (isdigit((unsigned char)entry->d_name[0]) &&
		    parent_of(entry->d_name) == parent)
			child = (pid_t)strtol(entry->d_name, NULL, 10);
	}
	closedir(dir);
	return child;
}

/* It begins 10 s after the daemon. */
static pid_t await_child(pid_t parent)
{
	pid_t child = 0;

	for (int i = 0; i < 6000 && child == 0; i++) {
		usleep(20000);
		child = find_child(parent);
	}
	assert_true(child > 0);
	return child;
}

/* Whether nobody holds the other end of a daemon's stdout soon. */
static bool ends_soon(int fd)
{
	struct pollfd poll_fd = {.fd = fd, .events = POLLIN};
	char rest[256];

	while (poll(&poll_fd, 1, 5000) == 1) {
		if (read(fd, rest, sizeof rest) <= 0)
			return true;
	}
	return false;
}

/* Kills the daemon while its child fills folder. */
static void kill_midway(struct daemon *d, const char *folder)
{
	char path[64], name[PATH_MAX];
	pid_t child = await_child(d->pid);
	ssize_t length;
	int status;

	usleep(200000);
	snprintf(path, sizeof path, "/proc/%d/fd/1", (int)child);
	length = readlink(path, name, sizeof name - 1);
	assert_true(length > 0);
	name[length] = '\0';
	assert_string_equal(name, "/dev/null");
	assert_int_equal(folder_count(folder, "kernels-"), 0);
	kill(d->pid, SIGKILL);
	assert_int_equal(waitpid(d->pid, &status, 0), d->pid);
	assert_true(ends_soon(d->out));
	close(d->out);
	for (int i = 0; i < 3000 && !is_gone(child); i++)
		usleep(10000);
	assert_true(is_gone(child));
	assert_int_equal(folder_count(folder, "kernels-"), 0);
	assert_int_equal(folder_count(folder, "note-"), 0);
}

/* A daemon trusts its folder when it starts; what fills it, later. */
static void test_a_fill_that_fails_is_not_tried_again(void **state)
{
	char folder[PATH_MAX];
	const char *const arguments[] = {"--width", "1", "--cache", folder,
	    "--no-measure", "--log-level", "info", NULL};
	struct daemon d;
	int log;

	(void)state;
	folder_make(folder);
	log = start_logged(&d, arguments);
	assert_int_equal(chmod(folder, 0777), 0);
	await_line(log, "the cache could not be filled");
	assert_int_equal(count_lines(log, "there is no cache to fill"), 1);
	await_files(folder, "note-", 1);
	stop_logged(&d, log);
	close(log);

	assert_int_equal(chmod(folder, 0700), 0);
	log = start_logged(&d, arguments);
	await_line(log, "has failed within a day");
	stop_logged(&d, log);
	close(log);
	assert_int_equal(folder_count(folder, "kernels-"), 0);
	folder_remove(folder);
}

/* Starts a daemon that finds nothing in PoCL's cache either: from a full one
 * kernels are stored too soon to be killed in between. */
static void start_cold(struct daemon *d, const char *const *arguments,
    const char *pocl)
{
	const char *before = getenv("POCL_CACHE_DIR");
	char *saved = before != NULL ? strdup(before) : NULL;

	setenv("POCL_CACHE_DIR", pocl, 1);
	daemon_start(d, arguments);
	if (saved != NULL)
		setenv("POCL_CACHE_DIR", saved, 1);
	else
		unsetenv("POCL_CACHE_DIR");
	free(saved);
	daemon_await_ready(d); /* PoCL has children too, when it links */
}

/* What fills the cache is killed with its daemon; the next start is good, and
 * fills it. Points singly: those kernels compile soonest, 13 s if PoCL has
 * none. */
static void test_the_daemon_fills_its_cache(void **state)
{
	char folder[PATH_MAX], pocl[PATH_MAX], output[OUTPUT_MAX];
	const char *const arguments[] = {"--width", "1", "--cache", folder,
	    "--no-measure", "--log-level", "info", NULL};
	const char *const quiet[] = {"--width", "1", "--cache", folder,
	    "--no-measure", NULL};
	const char *const filling[] = {"--width", "1", "--cache", folder,
	    "--fill-cache", NULL};
	struct daemon d;
	int log;

	(void)state;
	folder_make(folder);
	folder_make(pocl);
	start_cold(&d, quiet, pocl);
	kill_midway(&d, folder);
	folder_remove(pocl);

	log = start_logged(&d, arguments);
	await_line(log, "kernels are in the cache");
	stop_logged(&d, log);
	close(log);
	assert_int_equal(folder_count(folder, "kernels-"), 2);
	assert_int_equal(folder_count(folder, "note-"), 0);
	assert_int_equal(count_in_log(arguments, "kernels from the cache"), 1);
	assert_int_equal(daemon_run(filling, output, sizeof output), 0);
	damage_all(folder);
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
		cmocka_unit_test(test_a_fill_that_fails_is_not_tried_again),
		cmocka_unit_test(test_the_daemon_fills_its_cache),
	};

	return cmocka_run_group_tests(tests, NULL, NULL);
}
