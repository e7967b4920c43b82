/*
 * The configuration: flags, environment, file, defaults, and printing it.
 */
#include <stdarg.h>
#include <stddef.h>
#include <setjmp.h>
#include <stdint.h>
#include <cmocka.h>

#include <fcntl.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <unistd.h>

#include "server/config_internal.h"
#include "tests/support/folder.h"

#define ARGUMENTS_MAX 16
#define OUTPUT_MAX 32768

struct test {
	char folder[PATH_MAX];
	char path[PATH_MAX + 16]; /* of a file there */
	char output[OUTPUT_MAX];         /* of the last parse: both streams */
	struct config config;
};

static int set_up(void **state)
{
	struct test *t = calloc(1, sizeof *t);

	assert_non_null(t);
	folder_make(t->folder);
	snprintf(t->path, sizeof t->path, "%s/conf", t->folder);
	setenv("HOME", "/home/somebody", 1);
	unsetenv("XDG_CACHE_HOME");
	unsetenv("XDG_DATA_HOME");
	*state = t;
	return 0;
}

static int tear_down(void **state)
{
	struct test *t = *state;

	folder_remove(t->folder);
	free(t);
	return 0;
}

static void write_file(struct test *t, const char *text)
{
	FILE *file = fopen(t->path, "w");

	assert_non_null(file);
	fputs(text, file);
	assert_int_equal(fclose(file), 0);
}

/* Both streams into a file of the folder, from now on. */
static void redirect(struct test *t, int saved[static 2])
{
	char path[PATH_MAX + 16];
	int fd;

	snprintf(path, sizeof path, "%s/output", t->folder);
	fd = open(path, O_CREAT | O_TRUNC | O_RDWR, 0600);
	assert_true(fd >= 0);
	fflush(stdout);
	for (int i = 0; i < 2; i++) {
		saved[i] = dup(STDOUT_FILENO + i);
		dup2(fd, STDOUT_FILENO + i);
	}
	close(fd);
}

static void restore(struct test *t, const int saved[static 2])
{
	ssize_t length;

	fflush(stdout);
	length = pread(STDOUT_FILENO, t->output, sizeof t->output - 1, 0);
	t->output[length > 0 ? length : 0] = '\0';
	for (int i = 0; i < 2; i++) {
		dup2(saved[i], STDOUT_FILENO + i);
		close(saved[i]);
	}
}

static enum config_outcome parse_all(struct test *t, const char *const *more)
{
	char *argv[ARGUMENTS_MAX + 1] = {(char *)(size_t)"blobfieldd"};
	enum config_outcome outcome;
	int argc = 1, saved[2];

	while (*more != NULL && argc < ARGUMENTS_MAX)
		argv[argc++] = (char *)(size_t)*more++;
	redirect(t, saved);
	outcome = config_parse(argc, argv, &t->config);
	restore(t, saved);
	return outcome;
}

#define parse(t, ...) parse_all(t, (const char *const []){__VA_ARGS__, NULL})
#define parse_nothing(t) parse_all(t, (const char *const []){NULL})

/* text as a file is wrong, and said to be so in these words. */
static void assert_file_is_wrong(struct test *t, const char *text,
    const char *words)
{
	char all[PATH_MAX + 1024];

	write_file(t, text);
	assert_int_equal(parse(t, "--config", t->path), CONFIG_BAD);
	snprintf(all, sizeof all, "blobfieldd: %s:%s\n", t->path, words);
	assert_string_equal(t->output, all);
}

static void test_without_anything_there_are_defaults(void **state)
{
	struct test *t = *state;

	assert_int_equal(parse_nothing(t), CONFIG_RUN);
	assert_string_equal(t->output, "");
	assert_string_equal(t->config.host, "127.0.0.1");
	assert_string_equal(t->config.port, "7878");
	assert_int_equal(t->config.max_body, 128 << 20);
	assert_string_equal(t->config.cache, "/home/somebody/.cache/blobfield");
	assert_string_equal(t->config.data,
	    "/home/somebody/.local/share/blobfield");
	assert_null(t->config.device.select);
	assert_true(t->config.measure);
	assert_false(t->config.insecure);
	assert_int_equal(t->config.drain_delay, 0);
}

/* An option in each place, what the text gives there, and the values. */
static const struct layer {
	const char *line, *variable, *value, *flag;
	size_t of_file, of_variable, of_flag, offset;
} layers[] = {
	{"max-body = 1M", "BLOBFIELDD_MAX_BODY", "2k", "--max-body=3",
	    1 << 20, 2 << 10, 3, offsetof(struct config, max_body)},
	{"history=4", "BLOBFIELDD_HISTORY", "5", "--history=6",
	    4, 5, 6, offsetof(struct config, history)},
	{"history-bytes=4k", "BLOBFIELDD_HISTORY_BYTES", "5",
	    "--history-bytes=6M", 4 << 10, 5, 6 << 20,
	    offsetof(struct config, history_bytes)},
	{"\tdrain-delay\t=\t7 # s", "BLOBFIELDD_DRAIN_DELAY", "0",
	    "--drain-delay=9", 7, 0, 9, offsetof(struct config, drain_delay)},
	{"table-memory = \"1G\"", "BLOBFIELDD_TABLE_MEMORY", "1M",
	    "--table-memory=1k", 1 << 30, 1 << 20, 1 << 10,
	    offsetof(struct config, device.table_bytes)},
};

static void test_flags_beat_variables_and_these_the_file(void **state)
{
	struct test *t = *state;

	for (size_t i = 0; i < sizeof layers / sizeof *layers; i++) {
		const struct layer *l = &layers[i];
		const size_t *value = (const void *)((char *)&t->config +
		    l->offset);

		write_file(t, l->line);
		assert_int_equal(parse(t, "--config", t->path), CONFIG_RUN);
		assert_int_equal(*value, l->of_file);
		setenv(l->variable, l->value, 1);
		assert_int_equal(parse(t, "--config", t->path), CONFIG_RUN);
		assert_int_equal(*value, l->of_variable);
		assert_int_equal(parse(t, l->flag, "--config", t->path),
		    CONFIG_RUN);
		assert_int_equal(*value, l->of_flag);
		unsetenv(l->variable);
	}
}

static void test_other_kinds_have_layers_too(void **state)
{
	struct test *t = *state;

	write_file(t, "listen = [::1]:1\nlayout = uniform\nwidth = 4\n"
	    "insecure = yes\nno-measure = yes\nquiet = yes\ndevice = one\n"
	    "no-cache = yes\n");
	assert_int_equal(parse(t, "--config", t->path), CONFIG_RUN);
	assert_string_equal(t->config.host, "::1");
	assert_int_equal(t->config.layout, LAYOUT_UNIFORM);
	assert_int_equal(t->config.device.width, 4);
	assert_true(t->config.insecure);
	assert_false(t->config.measure);
	assert_int_equal(t->config.log_level, LOG_WARNING);
	assert_string_equal(t->config.device.select, "one");
	assert_string_equal(t->config.cache, "");
	assert_int_equal(parse(t, "--config", t->path, "--listen", "a:2",
	    "--layout=warped", "--width=8", "--insecure=no", "--no-measure=no",
	    "--log-level", "debug", "--device", "two", "--cache=c"),
	    CONFIG_RUN);
	assert_string_equal(t->config.host, "a");
	assert_int_equal(t->config.layout, LAYOUT_WARPED);
	assert_int_equal(t->config.device.width, 8);
	assert_false(t->config.insecure);
	assert_true(t->config.measure);
	assert_int_equal(t->config.log_level, LOG_DEBUG);
	assert_string_equal(t->config.device.select, "two");
	assert_string_equal(t->config.cache, "c");
	assert_int_equal(parse(t, "--config", t->path, "--no-cache=no",
	    "--quiet=no"), CONFIG_RUN);
	assert_string_equal(t->config.cache, "/home/somebody/.cache/blobfield");
	assert_int_equal(t->config.log_level, LOG_INFO);
}

static void test_of_one_layer_the_last_counts(void **state)
{
	struct test *t = *state;

	assert_int_equal(parse(t, "--data=a", "--no-cache", "--data", "b",
	    "--cache", "c"), CONFIG_RUN);
	assert_string_equal(t->config.data, "b");
	assert_string_equal(t->config.cache, "c");
}

static void test_the_file_may_be_named_by_a_variable(void **state)
{
	struct test *t = *state;

	write_file(t, "history = 3\r\n\r\n# the end");
	setenv("BLOBFIELDD_CONFIG", t->path, 1);
	assert_int_equal(parse_nothing(t), CONFIG_RUN);
	assert_int_equal(t->config.history, 3);
	assert_int_equal(parse(t, "--config=/nowhere"), CONFIG_BAD);
	assert_string_equal(t->output, "blobfieldd: cannot read /nowhere: "
	    "No such file or directory\n");
	assert_int_equal(parse(t, "--config", t->folder), CONFIG_BAD);
	assert_non_null(strstr(t->output, "Is a directory"));
	unsetenv("BLOBFIELDD_CONFIG");
}

static void test_quotes_and_comments(void **state)
{
	struct test *t = *state;

	write_file(t, "data = \"a # \\\"b\\\\ \" # c\ntokens=x#y #z\n"
	    "cache = two words\t# and a comment\n");
	assert_int_equal(parse(t, "--config", t->path), CONFIG_RUN);
	assert_string_equal(t->config.data, "a # \"b\\ ");
	assert_string_equal(t->config.tokens, "x#y");
	assert_string_equal(t->config.cache, "two words");
}

static void test_what_is_wrong_in_a_file_is_said_with_its_line(void **state)
{
	struct test *t = *state;

	assert_file_is_wrong(t, "\n#\nmax-bodi = 3\n",
	    "3: unknown option 'max-bodi'; did you mean 'max-body'?");
	assert_file_is_wrong(t, "completely-else = 3\n",
	    "1: unknown option 'completely-else'");
	assert_file_is_wrong(t, "max-body = 3x\n", "1: max-body must be a "
	    "whole number above 0, with k, M or G after it if you like, not "
	    "'3x'");
	assert_file_is_wrong(t, "tasks = 65\n",
	    "1: tasks must be a whole number from 1 to 64, not '65'");
	assert_file_is_wrong(t, "log-level = loud\n", "1: log-level must be "
	    "error, warning, info or debug, not 'loud'");
	assert_file_is_wrong(t, "insecure = perhaps\n",
	    "1: insecure must be yes or no, not 'perhaps'");
	assert_file_is_wrong(t, "listen 3\n", "1: must be of the form "
	    "option = value, or begin with #");
	assert_file_is_wrong(t, "= 3\n", "1: must be of the form "
	    "option = value, or begin with #");
	assert_file_is_wrong(t, "data = \"x\n", "1: the quote is not closed");
	assert_file_is_wrong(t, "data = \"x\" y\n",
	    "1: after the closing quote may only come a comment");
	assert_file_is_wrong(t, "data = \"\\n\"\n",
	    "1: after \\ in quotes must come \" or \\");
	assert_file_is_wrong(t, "history = 1\ndata = x\nhistory = 2\n",
	    "3: 'history' is also in line 1");
	assert_file_is_wrong(t, "list-devices = yes\n",
	    "1: 'list-devices' is for the command line");
	assert_file_is_wrong(t, "data =\n", "1: data must be a text of 1 to "
	    "1023 bytes, without control characters, not ''");
}

static void test_a_byte_0_in_a_file_is_wrong(void **state)
{
	struct test *t = *state;
	FILE *file = fopen(t->path, "w");

	assert_non_null(file);
	fwrite("history\0= 1\n", 12, 1, file);
	fclose(file);
	assert_int_equal(parse(t, "--config", t->path), CONFIG_BAD);
	assert_non_null(strstr(t->output, ":1: a byte of value 0\n"));
}

/* Wrong is wrong, also where it does not count. */
static void test_a_wrong_value_is_wrong_under_a_flag_too(void **state)
{
	struct test *t = *state;

	assert_file_is_wrong(t, "history = x\n", "1: history must be a whole "
	    "number above 0, with k, M or G after it if you like, not 'x'");
	assert_int_equal(parse(t, "--history=2", "--config", t->path),
	    CONFIG_BAD);
}

static void test_flags_that_are_wrong(void **state)
{
	struct test *t = *state;

	assert_int_equal(parse(t, "--lisen=3"), CONFIG_BAD);
	assert_string_equal(t->output, "blobfieldd: --lisen=3: unknown option; "
	    "did you mean --listen?\n");
	assert_int_equal(parse(t, "x"), CONFIG_BAD);
	assert_non_null(strstr(t->output, "x: unknown option\nTry 'blobfieldd "
	    "--help'.\n"));
	assert_int_equal(parse(t, "--data"), CONFIG_BAD);
	assert_non_null(strstr(t->output, "--data: needs DIR\n"));
	assert_int_equal(parse(t, "--work-time=86401"), CONFIG_BAD);
	assert_int_equal(parse(t, "--work-time=0"), CONFIG_RUN);
	assert_int_equal(t->config.work_time, 0);
	assert_int_equal(parse(t, "--drain-time=86401"), CONFIG_BAD);
	assert_string_equal(t->output, "blobfieldd: --drain-time: must be a "
	    "whole number from 1 to 86400, not '86401'\nTry 'blobfieldd "
	    "--help'.\n");
	assert_int_equal(parse(t, "--log-level", "loud"), CONFIG_BAD);
	assert_non_null(strstr(t->output, "--log-level: must be error, warning, "
	    "info or debug, not 'loud'\n"));
	assert_int_equal(parse(t, "--max-body=9999999999G"), CONFIG_BAD);
	assert_non_null(strstr(t->output, "must be 9223372036854775807 at "
	    "most, not '9999999999G'"));
	assert_int_equal(parse(t, "--queue=99999999999999999999"), CONFIG_BAD);
	assert_non_null(strstr(t->output, "at most, not '9999999999999999999"));
	assert_int_equal(parse(t, "--tasks=99999999999999999999"), CONFIG_BAD);
	assert_non_null(strstr(t->output, "from 1 to 64, not '9999"));
}

static void test_a_suffix_is_one_letter(void **state)
{
	static const char *const wrong[] = {"1MB", "1m", "1MiB", "1Mb", "1mb"};
	struct test *t = *state;

	for (size_t i = 0; i < sizeof wrong / sizeof *wrong; i++) {
		assert_int_equal(parse(t, "--max-body", wrong[i]), CONFIG_BAD);
		assert_non_null(strstr(t->output, "must be written as 1M, "
		    "not '1"));
	}
	assert_int_equal(parse(t, "--max-body", "2kB"), CONFIG_BAD);
	assert_non_null(strstr(t->output, "written as 2k, not '2kB'"));
	assert_int_equal(parse(t, "--max-body", "2B"), CONFIG_BAD);
	assert_non_null(strstr(t->output, "with k, M or G"));
	assert_int_equal(parse(t, "--max-body", "0"), CONFIG_BAD);
	assert_non_null(strstr(t->output, "above 0"));
	assert_int_equal(parse(t, "--max-body", "2K"), CONFIG_RUN);
	assert_int_equal(t->config.max_body, 2048);
}

static void test_a_byte_order_mark_is_skipped(void **state)
{
	struct test *t = *state;

	write_file(t, "\xef\xbb\xbfhistory = 3\n");
	assert_int_equal(parse(t, "--config", t->path), CONFIG_RUN);
	assert_int_equal(t->config.history, 3);
	write_file(t, "\xef\xbb\xbf");
	assert_int_equal(parse(t, "--config", t->path), CONFIG_RUN);
}

static void test_data_beside_a_store_is_warned_of(void **state)
{
	struct test *t = *state;

	assert_int_equal(parse(t, "--store=redis://h", "--data=d"), CONFIG_RUN);
	assert_non_null(strstr(t->output, "data = d is not used: there is a "
	    "store\n"));
	assert_int_equal(parse(t, "--store=redis://h"), CONFIG_RUN);
	assert_string_equal(t->output, "");
	assert_int_equal(parse(t, "--data=d"), CONFIG_RUN);
	assert_string_equal(t->output, "");
}

static void test_variables_that_are_wrong(void **state)
{
	struct test *t = *state;

	setenv("BLOBFIELDD_WIDTH", "3", 1);
	assert_int_equal(parse_nothing(t), CONFIG_BAD);
	assert_string_equal(t->output, "blobfieldd: BLOBFIELDD_WIDTH: must be "
	    "1, 2, 4, 8 or 16, not '3'\n");
	unsetenv("BLOBFIELDD_WIDTH");
}

static void test_unknown_variables_are_warned_of(void **state)
{
	struct test *t = *state;

	setenv("BLOBFIELDD_MAX_BDY", "3", 1);
	setenv("BLOBFIELDD_PORT_7878_TCP_ADDR", "x", 1);
	setenv("BLOBFIELDD_STORE", "", 1); /* as if it were not there */
	assert_int_equal(parse_nothing(t), CONFIG_RUN);
	assert_non_null(strstr(t->output, "BLOBFIELDD_MAX_BDY is no option; did "
	    "you mean BLOBFIELDD_MAX_BODY?"));
	assert_non_null(strstr(t->output, "BLOBFIELDD_PORT_7878_TCP_ADDR is no "
	    "option"));
	assert_null(strstr(t->output, "STORE"));
	unsetenv("BLOBFIELDD_MAX_BDY");
	unsetenv("BLOBFIELDD_PORT_7878_TCP_ADDR");
	unsetenv("BLOBFIELDD_STORE");
}

static void test_a_certificate_needs_its_key(void **state)
{
	struct test *t = *state;

	assert_int_equal(parse(t, "--tls-cert=a"), CONFIG_BAD);
	assert_string_equal(t->output, "blobfieldd: tls-cert is set, and "
	    "tls-key is not: HTTPS needs both\n");
	write_file(t, "tls-key = b\n");
	assert_int_equal(parse(t, "--tls-cert=a", "--config", t->path),
	    CONFIG_RUN);
}

static void test_a_token_has_a_name_and_a_role(void **state)
{
	struct test *t = *state;

	assert_int_equal(parse(t, "--make-token=a:b:admin"), CONFIG_RUN);
	assert_string_equal(t->config.make_token[0], "a:b");
	assert_string_equal(t->config.make_token[1], "admin");
	assert_int_equal(parse(t, "--make-token=a"), CONFIG_BAD);
	assert_int_equal(parse(t, "--make-token=:read"), CONFIG_BAD);
	assert_int_equal(parse(t, "--make-token=a:red"), CONFIG_BAD);
	assert_non_null(strstr(t->output, "NAME:ROLE, the role read, evaluate, "
	    "write or admin, not 'a:red'\n"));
}

static void test_folders_of_a_service_manager(void **state)
{
	struct test *t = *state;

	setenv("STATE_DIRECTORY", "/var/lib/b:/var/lib/c", 1);
	setenv("CACHE_DIRECTORY", "/var/cache/b", 1);
	assert_int_equal(parse_nothing(t), CONFIG_RUN);
	assert_string_equal(t->config.data, "/var/lib/b");
	assert_string_equal(t->config.cache, "/var/cache/b");
	unsetenv("STATE_DIRECTORY");
	unsetenv("CACHE_DIRECTORY");
	unsetenv("HOME");
	assert_int_equal(parse_nothing(t), CONFIG_RUN);
	assert_string_equal(t->config.data, ":memory:");
	assert_string_equal(t->config.cache, "");
}

/* Where a line of the output begins, as a copy of it. */
static const char *line_of(const struct test *t, const char *name)
{
	static char line[1024];
	char begin[64];
	const char *at;

	snprintf(begin, sizeof begin, "\n%s = ", name);
	at = strstr(t->output, begin);
	if (at == NULL)
		fail_msg("no line for %s in\n%s", name, t->output);
	snprintf(line, sizeof line, "%.*s", (int)strcspn(at + 1, "\n"), at + 1);
	return line;
}

static void assert_line(const struct test *t, const char *name,
    const char *value, const char *origin)
{
	char want[1024], left[512];

	snprintf(left, sizeof left, "%s = %s", name, value);
	snprintf(want, sizeof want, "%-40s # %s", left, origin);
	assert_string_equal(line_of(t, name), want);
}

static void test_what_is_printed_says_where_it_is_from(void **state)
{
	struct test *t = *state;
	char place[PATH_MAX + 32];

	write_file(t, "\nhistory = 3\nmax-body = 64M\n");
	setenv("BLOBFIELDD_MAX_POINTS", "1000", 1);
	assert_int_equal(parse(t, "--config", t->path, "--quiet",
	    "--print-config", "--cache-size", "1000000", "--no-cache",
	    "--store=redis://me:pass/w@rd@host:1/0", "--data=/x"),
	    CONFIG_DONE);
	unsetenv("BLOBFIELDD_MAX_POINTS");
	snprintf(place, sizeof place, "%s:2", t->path);
	assert_line(t, "history", "3", place);
	snprintf(place, sizeof place, "%s:3", t->path);
	assert_line(t, "max-body", "64M", place);
	assert_line(t, "max-points", "1000",
	    "environment: BLOBFIELDD_MAX_POINTS");
	assert_line(t, "log-level", "warning", "flag: --quiet");
	assert_line(t, "cache-size", "1000000", "flag: --cache-size");
	assert_line(t, "no-cache", "yes", "flag: --no-cache");
	assert_line(t, "listen", "127.0.0.1:7878", "default");
	assert_line(t, "volume-memory", "256M", "default");
	assert_line(t, "#store", "redis://me:***@host:1/0",
	    "flag: --store; put its password in");
	assert_line(t, "data", "/x", "flag: --data; not used: there is a store");
	assert_line(t, "#width", "", "default");
	assert_null(strstr(t->output, "pass/"));
	assert_null(strstr(t->output, "rd@"));
}

/* But for pointers, which are the members'. */
static void assert_same(const struct config *a, const struct config *b)
{
	char one[CONFIG_VALUE_MAX], other[CONFIG_VALUE_MAX];
	const struct config_option *o;

	for (o = config_options; o->name != NULL; o++) {
		assert_int_equal(config_value_print(o, a, one),
		    config_value_print(o, b, other));
		assert_string_equal(one, other);
	}
}

static void test_what_is_printed_reads_back_the_same(void **state)
{
	struct test *t = *state;
	struct config first;

	assert_int_equal(parse(t, "--print-config", "--listen=[::1]:0",
	    "--data= a # \"b\\ ", "--tokens=/x\\y", "--no-measure",
	    "--log-format=json", "--tables=image", "--width=16",
	    "--cors-origin=*", "--max-body=12345", "--no-cache",
	    "--store=redis://host", "--insecure", "--layout=uniform"),
	    CONFIG_DONE);
	first = t->config;
	write_file(t, t->output);
	assert_int_equal(parse(t, "--config", t->path), CONFIG_RUN);
	assert_same(&t->config, &first);
	assert_string_equal(t->config.data, " a # \"b\\ ");
	assert_string_equal(t->config.cache, "");
}

/* Each option is in the help, and each default there is the default. */
static void test_the_help_has_the_defaults(void **state)
{
	struct test *t = *state;
	const struct config_option *o;

	assert_int_equal(parse_nothing(t), CONFIG_RUN);
	for (o = config_options; o->name != NULL; o++) {
		char value[CONFIG_VALUE_MAX], shown[CONFIG_VALUE_MAX + 2];

		assert_non_null(o->help);
		if ((o->kind != CONFIG_NUMBER && o->kind != CONFIG_BYTES &&
		    o->kind != CONFIG_CHOICE && o->kind != CONFIG_LISTEN) ||
		    !config_value_print(o, &t->config, value))
			continue;
		snprintf(shown, sizeof shown, "(%s)", value);
		if (strstr(o->help, shown) == NULL)
			fail_msg("the help of %s lacks %s", o->name, shown);
	}
}

int main(void)
{
	const struct CMUnitTest tests[] = {
		cmocka_unit_test(test_without_anything_there_are_defaults),
		cmocka_unit_test(test_flags_beat_variables_and_these_the_file),
		cmocka_unit_test(test_other_kinds_have_layers_too),
		cmocka_unit_test(test_of_one_layer_the_last_counts),
		cmocka_unit_test(test_the_file_may_be_named_by_a_variable),
		cmocka_unit_test(test_quotes_and_comments),
		cmocka_unit_test(
		    test_what_is_wrong_in_a_file_is_said_with_its_line),
		cmocka_unit_test(test_a_byte_0_in_a_file_is_wrong),
		cmocka_unit_test(test_a_wrong_value_is_wrong_under_a_flag_too),
		cmocka_unit_test(test_flags_that_are_wrong),
		cmocka_unit_test(test_a_suffix_is_one_letter),
		cmocka_unit_test(test_a_byte_order_mark_is_skipped),
		cmocka_unit_test(test_data_beside_a_store_is_warned_of),
		cmocka_unit_test(test_variables_that_are_wrong),
		cmocka_unit_test(test_unknown_variables_are_warned_of),
		cmocka_unit_test(test_a_certificate_needs_its_key),
		cmocka_unit_test(test_a_token_has_a_name_and_a_role),
		cmocka_unit_test(
		    test_what_is_printed_says_where_it_is_from),
		cmocka_unit_test(test_what_is_printed_reads_back_the_same),
		cmocka_unit_test(test_the_help_has_the_defaults),
		/* The last: it takes the home away. */
		cmocka_unit_test(test_folders_of_a_service_manager),
	};

	return cmocka_run_group_tests(tests, set_up, tear_down);
}
