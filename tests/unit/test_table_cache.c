/*
 * Tables on disk: what comes back is what was built, bit for bit; whatever has
 * happened to the file, it is that or nothing.
 */
#include <stdarg.h>
#include <stddef.h>
#include <setjmp.h>
#include <stdint.h>
#include <cmocka.h>

#include <errno.h>
#include <fcntl.h>
#include <math.h>
#include <signal.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/resource.h>
#include <sys/stat.h>
#include <sys/wait.h>
#include <time.h>
#include <unistd.h>

#include "core/table.h"
#include "kernels/cache_file.h"
#include "server/log.h"
#include "server/table_cache.h"
#include "tests/support/folder.h"

#define NODES 17
#define MOST ((size_t)1 << 30)

/* What every test has: a folder, a cache in it, an operator and its table. */
struct place {
	char folder[PATH_MAX];
	struct table_cache *cache;
	struct operator op;
	struct table *table;
};

static const struct table_figures figures = {.build_seconds = 0.25,
	.is_measured = true,
	.error = {.count = 7, .max = {1e-3}, .mean = {1e-5}, .p99 = {1e-4}}};

static struct table *build(const struct operator *op)
{
	struct table *table;

	assert_int_equal(table_create(op->family, &op->profile, op->layout,
	    op->resolution, &table), ERR_OK);
	table_build(table, 0, op->resolution);
	return table;
}

static int setup(void **state)
{
	struct place *p = calloc(1, sizeof *p);

	assert_non_null(p);
	folder_make(p->folder);
	assert_int_equal(table_cache_create(p->folder, MOST, false,
	    &p->cache), ERR_OK);
	p->op = (struct operator){.family = FAMILY_UNION,
	    .profile = profile_bulge(0.7), .layout = LAYOUT_WARPED,
	    .resolution = NODES};
	p->table = build(&p->op);
	*state = p;
	return 0;
}

static int teardown(void **state)
{
	struct place *p = *state;

	table_cache_free(p->cache);
	table_free(p->table);
	folder_remove(p->folder);
	free(p);
	return 0;
}

static bool is_same(const struct table *a, const struct table *b)
{
	return a->resolution == b->resolution && a->family == b->family &&
	    profile_equal(&a->profile, &b->profile) &&
	    memcmp(a->first, b->first, table_bytes(a)) == 0;
}

/* Whether the cache gives op's table; it must then be the one built. */
static bool loads(struct place *p)
{
	struct table_figures got;
	struct table *table = NULL;
	enum err err = table_cache_load(p->cache, &p->op, &table, &got);

	if (err != ERR_OK) {
		assert_int_equal(err, ERR_NOT_FOUND);
		assert_null(table);
		return false;
	}
	assert_true(is_same(table, p->table));
	table_free(table);
	return true;
}

static void store(struct place *p)
{
	table_cache_store(p->cache, p->table, &figures);
	assert_true(loads(p));
}

/* All bytes of a file, malloc'd. */
static unsigned char *slurp(const char *path, size_t *size)
{
	FILE *file = fopen(path, "rb");
	unsigned char *bytes;

	assert_non_null(file);
	fseek(file, 0, SEEK_END);
	*size = (size_t)ftell(file);
	rewind(file);
	bytes = malloc(*size + 64);
	assert_non_null(bytes);
	assert_int_equal(fread(bytes, 1, *size, file), *size);
	fclose(file);
	return bytes;
}

static void spill(const char *path, const void *bytes, size_t size)
{
	FILE *file = fopen(path, "wb");

	assert_non_null(file);
	assert_int_equal(fwrite(bytes, 1, size, file), size);
	assert_int_equal(fclose(file), 0);
}

static void test_what_is_loaded_is_what_was_built(void **state)
{
	static const double curve[][2] = {{0, 1}, {0.3, 0.99}, {0.6, 0.9},
	    {0.8, 0.8}};
	struct place *p = *state;
	struct profile profiles[4] = {profile_smooth(), profile_circle(),
	    profile_bulge(0.8)};
	const char *why;
	int index, count = 0;

	assert_int_equal(profile_from_samples(curve, 4, &profiles[3], &why,
	    &index), ERR_OK);
	for (int i = 0; i < 16; i++) {
		table_free(p->table);
		p->op.profile = profiles[i / 4];
		p->op.family = (enum operator_family)(i % 2);
		p->op.layout = (enum table_layout)(i / 2 % 2);
		p->table = build(&p->op);
		assert_false(loads(p)); /* none is another one */
		store(p);
		count++;
	}
	assert_int_equal(folder_count(p->folder, "table-"), count);
}

static void test_figures_come_back(void **state)
{
	struct place *p = *state;
	struct table_figures got, later = figures;
	struct table *table;

	store(p);
	assert_int_equal(table_cache_load(p->cache, &p->op, &table, &got),
	    ERR_OK);
	table_free(table);
	assert_true(got.is_measured);
	assert_memory_equal(&got.error, &figures.error, sizeof got.error);
	assert_true(got.build_seconds == figures.build_seconds);
	later.is_measured = false;
	later.build_seconds = 3.0;
	table_cache_store_figures(p->cache, &p->op, &later);
	assert_int_equal(table_cache_load(p->cache, &p->op, &table, &got),
	    ERR_OK);
	table_free(table);
	assert_false(got.is_measured);
	assert_true(got.build_seconds == 3.0);
}

static void test_damaged_figures_do_not_count(void **state)
{
	struct place *p = *state;
	struct table_figures got;
	struct table *table;
	unsigned char *bytes;
	char path[PATH_MAX];
	size_t size;

	store(p);
	folder_find(p->folder, "figures-", path);
	bytes = slurp(path, &size);
	for (size_t i = 0; i < size; i++) {
		bytes[i] ^= 1;
		spill(path, bytes, size);
		assert_int_equal(table_cache_load(p->cache, &p->op, &table,
		    &got), ERR_OK);
		table_free(table);
		assert_false(got.is_measured);
		bytes[i] ^= 1;
	}
	free(bytes);
}

static void test_another_key_finds_nothing(void **state)
{
	struct place *p = *state;
	const struct operator op = p->op;

	store(p);
	p->op.profile.k = nextafter(op.profile.k, 1.0);
	assert_false(loads(p));
	p->op = op;
	p->op.resolution++;
	assert_false(loads(p));
	p->op = op;
	p->op.family = FAMILY_INTERSECTION;
	assert_false(loads(p));
	p->op = op;
	p->op.layout = LAYOUT_UNIFORM;
	assert_false(loads(p));
	p->op = op;
	p->op.profile = profile_circle();
	assert_false(loads(p));
	p->op = op;
	assert_true(loads(p));
}

/* The file of one table in the place of another's. */
static void test_a_file_in_anothers_place_is_ignored(void **state)
{
	struct place *p = *state, *other;
	char mine[PATH_MAX], theirs[PATH_MAX];
	void *made;

	store(p);
	setup(&made);
	other = made;
	table_free(other->table);
	other->op.profile.k = 0.6;
	other->table = build(&other->op);
	store(other);
	folder_find(p->folder, "table-", mine);
	folder_find(other->folder, "table-", theirs);
	assert_int_equal(rename(theirs, mine), 0);
	teardown(&made);
	assert_false(loads(p));
	store(p);
}

/* Every byte of the head and the key, and bytes all over the content. */
static void test_a_flipped_bit_is_found_and_mended(void **state)
{
	struct place *p = *state;
	unsigned char *bytes;
	char path[PATH_MAX];
	size_t size;
	int fd;

	store(p);
	folder_find(p->folder, "table-", path);
	bytes = slurp(path, &size);
	fd = open(path, O_WRONLY);
	assert_true(fd >= 0);
	for (size_t i = 0; i < size; i += i < 256 || i > size - 32 ? 1 : 4001) {
		unsigned char wrong = bytes[i] ^ (unsigned char)(1u << i % 8);

		assert_int_equal(pwrite(fd, &wrong, 1, (off_t)i), 1);
		assert_false(loads(p));
		assert_int_equal(pwrite(fd, bytes + i, 1, (off_t)i), 1);
	}
	assert_true(loads(p));
	assert_int_equal(pwrite(fd, "x", 1, 100), 1);
	close(fd);
	store(p); /* replaces it */
	free(bytes);
}

static void test_no_other_length_counts(void **state)
{
	struct place *p = *state;
	unsigned char *bytes;
	char path[PATH_MAX];
	size_t size;

	store(p);
	folder_find(p->folder, "table-", path);
	bytes = slurp(path, &size);
	memset(bytes + size, 0, 64);
	for (size_t i = 0; i < size; i += i < 256 ? 1 : 16001) {
		spill(path, bytes, i);
		assert_false(loads(p));
	}
	spill(path, bytes, size - 1);
	assert_false(loads(p));
	for (size_t i = 1; i <= 64; i++) {
		spill(path, bytes, size + i);
		assert_false(loads(p));
	}
	spill(path, bytes, size);
	assert_true(loads(p));
	free(bytes);
}

static void test_only_a_file_of_ones_own_counts(void **state)
{
	struct place *p = *state;
	char path[PATH_MAX], real[PATH_MAX + 8];

	store(p);
	folder_find(p->folder, "table-", path);
	chmod(path, 0620);
	assert_false(loads(p));
	chmod(path, 0602);
	assert_false(loads(p));
	chmod(path, 0400);
	assert_true(loads(p));
	if (geteuid() == 0) {
		assert_int_equal(chown(path, 12345, (gid_t)-1), 0);
		assert_false(loads(p));
		assert_int_equal(chown(path, 0, (gid_t)-1), 0);
	}
	snprintf(real, sizeof real, "%s.real", path);
	assert_int_equal(rename(path, real), 0);
	assert_int_equal(symlink(real, path), 0);
	assert_false(loads(p));
	assert_int_equal(unlink(path), 0);
	assert_int_equal(mkfifo(path, 0600), 0); /* must not wait for a writer */
	assert_false(loads(p));
	assert_int_equal(unlink(path), 0);
	assert_int_equal(mkdir(path, 0700), 0);
	assert_false(loads(p));
}

/* With a checksum that holds: another library's mathematics, a bug. */
static void test_what_build_would_not_give_is_ignored(void **state)
{
	struct place *p = *state;
	size_t floats = table_bytes(p->table) / sizeof(float);
	struct table *wrong = build(&p->op);
	struct table_figures got;
	struct table *table;

	wrong->first[floats / 3] = NAN;
	table_cache_store(p->cache, wrong, &figures);
	assert_false(loads(p));
	wrong->first[floats / 3] = 0.5f;
	wrong->first[floats - 1] = INFINITY;
	table_cache_store(p->cache, wrong, &figures);
	assert_false(loads(p));
	/* The last bit of every number, as another libm might have it. */
	memcpy(wrong->first, p->table->first, table_bytes(wrong));
	for (size_t i = 0; i < floats; i++)
		wrong->first[i] = nextafterf(wrong->first[i], 2.0f);
	table_cache_store(p->cache, wrong, &figures);
	assert_int_equal(table_cache_load(p->cache, &p->op, &table, &got),
	    ERR_NOT_FOUND);
	table_free(wrong);
	store(p);
}

static void test_what_was_used_longest_ago_goes_first(void **state)
{
	struct place *p = *state;
	size_t room = 3 * (table_bytes(p->table) + 2000);
	struct operator ops[4];

	table_cache_free(p->cache);
	assert_int_equal(table_cache_create(p->folder, room, false,
	    &p->cache), ERR_OK);
	for (int i = 0; i < 4; i++) {
		table_free(p->table);
		p->op.profile.k = 0.2 + 0.1 * i;
		ops[i] = p->op;
		p->table = build(&p->op);
		store(p);
		usleep(20000); /* file systems' clocks tick in 4 or 10 ms */
		if (i == 2)
			table_cache_touch(p->cache, &ops[0]);
		usleep(20000);
	}
	assert_int_equal(folder_count(p->folder, "table-"), 3);
	p->op = ops[1];
	assert_false(loads(p));
	table_free(p->table);
	p->op = ops[0];
	p->table = build(&p->op);
	assert_true(loads(p));
}

/* A file of that name, used so long ago. */
static void put(const struct place *p, const char *name, time_t age)
{
	const time_t then = time(NULL) - age;
	const struct timespec times[2] = {{.tv_sec = then}, {.tv_sec = then}};
	char path[PATH_MAX + NAME_MAX + 2];

	snprintf(path, sizeof path, "%s/%s", p->folder, name);
	spill(path, "text", 4);
	assert_int_equal(utimensat(AT_FDCWD, path, times, 0), 0);
}

#define HASH "0123456789abcdef0123456789abcdef"

/* Folders for downloads have such. */
static void test_other_peoples_files_are_left_alone(void **state)
{
	static const char *const names[] = {"notes.txt", "ab12Cd.part",
	    "firefox-download.iso.part", "x.part", ".part", ".blobcache",
	    "mine.blobcache", "table.blobcache", "table-.blobcache",
	    "table-0123.blobcache", "table-" HASH "0.blobcache",
	    "table-0123456789ABCDEF0123456789ABCDEF.blobcache",
	    "table-" HASH ".blobcache.part", "table-" HASH ".blobcache~",
	    "table-" HASH, "tables-" HASH ".blobcache", "-" HASH ".blobcache",
	    "my-table-" HASH ".blobcache", "part-table-" HASH ".blobcache",
	    "part-table-" HASH ".blobcache.part",
	    "part-table-" HASH "-abc12.blobcache.part",
	    "part-table-" HASH "-abc12_.blobcache.part",
	    "part-table-" HASH "-abc1234.blobcache.part",
	    "part-table-" HASH "-abc123.blobcache",
	    "part-other-" HASH "-abc123.blobcache.part"};
	const int count = sizeof names / sizeof *names;
	struct place *p = *state;

	for (int i = 0; i < count; i++)
		put(p, names[i], 1000000);
	cache_trim(p->folder, 0);
	table_cache_store(p->cache, p->table, &figures);
	for (int i = 0; i < count; i++) {
		char path[PATH_MAX + NAME_MAX + 2];

		snprintf(path, sizeof path, "%s/%s", p->folder, names[i]);
		assert_int_equal(access(path, F_OK), 0);
	}
}

static void test_a_link_or_anothers_file_is_left_alone(void **state)
{
	struct place *p = *state;
	char path[PATH_MAX + NAME_MAX + 2], real[PATH_MAX + 8];

	put(p, "real", 1000000);
	snprintf(real, sizeof real, "%s/real", p->folder);
	snprintf(path, sizeof path, "%s/table-" HASH ".blobcache", p->folder);
	assert_int_equal(symlink(real, path), 0);
	cache_trim(p->folder, 0);
	assert_int_equal(folder_count(p->folder, ""), 2);
	assert_int_equal(unlink(path), 0);
	if (geteuid() != 0)
		return;
	put(p, "table-" HASH ".blobcache", 1000000);
	assert_int_equal(chown(path, 12345, (gid_t)-1), 0);
	cache_trim(p->folder, 0);
	assert_int_equal(folder_count(p->folder, ""), 2);
}

static void test_old_parts_of_ones_own_are_removed(void **state)
{
	struct place *p = *state;

	put(p, "part-table-" HASH "-abCD12.blobcache.part", 4000);
	put(p, "part-figures-" HASH "-abCD12.blobcache.part", 4000);
	put(p, "part-kernels-" HASH "-abCD12.blobcache.part", 4000);
	put(p, "part-note-" HASH "-abCD12.blobcache.part", 4000);
	put(p, "part-table-" HASH "-abCD13.blobcache.part", 3000);
	cache_trim(p->folder, MOST);
	assert_int_equal(folder_count(p->folder, ""), 1);
	assert_int_equal(folder_count(p->folder, "part-table-"), 1);
}

/* What a writer that is killed leaves is what cache_trim takes for a part. */
static void test_a_killed_writers_part_is_removed(void **state)
{
	struct place *p = *state;
	struct cache_key key = {0};
	char path[PATH_MAX];
	int status;
	pid_t pid = fork();

	assert_true(pid >= 0);
	if (pid == 0) {
		struct rlimit most = {65536, 65536};

		signal(SIGXFSZ, SIG_DFL); /* ends it within a write */
		setrlimit(RLIMIT_FSIZE, &most);
		cache_file_write(p->folder, "table", &key, p->table->first,
		    table_bytes(p->table));
		_exit(0);
	}
	assert_int_equal(waitpid(pid, &status, 0), pid);
	assert_true(WIFSIGNALED(status));
	assert_int_equal(folder_count(p->folder, ""), 1);
	folder_find(p->folder, "part-table-", path);
	put(p, strrchr(path, '/') + 1, 4000);
	cache_trim(p->folder, MOST);
	assert_int_equal(folder_count(p->folder, ""), 0);
}

static void test_the_age_of_a_file(void **state)
{
	struct place *p = *state;
	struct cache_key key = {0}, other = {0};
	const time_t now = time(NULL);
	struct timespec then[2] = {{.tv_sec = now - 100000},
	    {.tv_sec = now - 100000}};
	char path[PATH_MAX];
	double age;

	cache_key_add_text(&key, "what");
	cache_key_add_text(&other, "what else");
	assert_true(cache_file_age(p->folder, "note", &key) == -1.0);
	assert_int_equal(cache_file_write(p->folder, "note", &key, "", 0),
	    ERR_OK);
	age = cache_file_age(p->folder, "note", &key);
	assert_true(age >= 0.0 && age < 60.0);
	assert_true(cache_file_age(p->folder, "note", &other) == -1.0);
	assert_true(cache_file_age(p->folder, "table", &key) == -1.0);
	folder_find(p->folder, "note-", path);
	utimensat(AT_FDCWD, path, then, 0);
	age = cache_file_age(p->folder, "note", &key);
	assert_true(age >= 100000.0 && age < 100060.0);
	then[1].tv_sec = now + 100000;
	utimensat(AT_FDCWD, path, then, 0);
	assert_true(cache_file_age(p->folder, "note", &key) == -1.0);
	spill(path, "", 0);
	assert_true(cache_file_age(p->folder, "note", &key) == -1.0);
	cache_trim(p->folder, 0);
	assert_int_equal(folder_count(p->folder, "note-"), 1); /* it is empty */
}

static void test_a_folder_that_is_gone_is_no_failure(void **state)
{
	struct place *p = *state;

	folder_remove(p->folder);
	assert_false(loads(p));
	table_cache_store(p->cache, p->table, &figures);
	table_cache_store(p->cache, p->table, &figures);
	table_cache_touch(p->cache, &p->op);
	assert_false(loads(p));
	assert_int_equal(mkdir(p->folder, 0700), 0);
	store(p);
}

static void test_a_full_disk_leaves_nothing_behind(void **state)
{
	struct place *p = *state;
	struct cache_key key = {0};
	int status;
	pid_t pid = fork();

	assert_true(pid >= 0);
	if (pid == 0) {
		struct rlimit most = {65536, 65536};

		signal(SIGXFSZ, SIG_IGN);
		setrlimit(RLIMIT_FSIZE, &most);
		table_cache_store(p->cache, p->table, &figures);
		_exit(cache_file_write(p->folder, "table", &key, p->table->first,
		    table_bytes(p->table)) == ERR_IO ? 0 : 1);
	}
	assert_int_equal(waitpid(pid, &status, 0), pid);
	assert_int_equal(status, 0);
	assert_false(loads(p));
	assert_int_equal(folder_count(p->folder, "table"), 0);
	assert_int_equal(folder_count(p->folder, ""),
	    folder_count(p->folder, "figures-"));
}

/* Writers, and readers that see a whole table or none. */
static void test_several_processes_at_once(void **state)
{
	struct place *p = *state;
	pid_t pids[4];

	for (int i = 0; i < 4; i++) {
		pids[i] = fork();
		assert_true(pids[i] >= 0);
		if (pids[i] == 0) {
			for (int n = 0; n < 20; n++) {
				struct table_figures got;
				struct table *table = NULL;

				table_cache_store(p->cache, p->table, &figures);
				if (table_cache_load(p->cache, &p->op, &table,
				    &got) != ERR_OK || !is_same(table, p->table))
					_exit(1);
				table_free(table);
			}
			_exit(0);
		}
	}
	for (int i = 0; i < 4; i++) {
		int status;

		assert_int_equal(waitpid(pids[i], &status, 0), pids[i]);
		assert_int_equal(status, 0);
	}
	assert_int_equal(folder_count(p->folder, ""), 2);
}

static void test_a_folder_is_made_for_its_user_alone(void **state)
{
	struct place *p = *state;
	char path[PATH_MAX + 32];
	bool is_read_only = false;
	struct stat info;

	snprintf(path, sizeof path, "%s/a/b/c", p->folder);
	assert_int_equal(cache_prepare(path, &is_read_only), ERR_OK);
	assert_int_equal(cache_prepare(path, &is_read_only), ERR_OK);
	assert_int_equal(stat(path, &info), 0);
	assert_int_equal(info.st_mode & 0777, 0700);
	chmod(path, 0755);
	assert_int_equal(cache_prepare(path, &is_read_only), ERR_OK);
	chmod(path, 0775);
	assert_int_equal(cache_prepare(path, &is_read_only), ERR_INVALID);
	chmod(path, 0757);
	assert_int_equal(cache_prepare(path, &is_read_only), ERR_INVALID);
	if (geteuid() == 0) {
		chmod(path, 0700);
		assert_int_equal(chown(path, 12345, (gid_t)-1), 0);
		assert_int_equal(cache_prepare(path, &is_read_only), ERR_INVALID);
	}
	snprintf(path, sizeof path, "%s/file", p->folder);
	spill(path, "", 0);
	assert_int_equal(cache_prepare(path, &is_read_only), ERR_IO);
	snprintf(path, sizeof path, "%s/file/below", p->folder);
	assert_int_equal(cache_prepare(path, &is_read_only), ERR_IO);
	memset(path, '/', CACHE_FOLDER_MAX); /* the root, at length */
	path[CACHE_FOLDER_MAX] = '\0';
	assert_int_equal(cache_prepare(path, &is_read_only), ERR_IO);
	assert_int_equal(errno, ENAMETOOLONG);
}

/* What is there is read, and nothing else happens. */
static void test_a_cache_that_is_only_read(void **state)
{
	struct place *p = *state;
	bool is_read_only = true;
	char path[PATH_MAX + 32];

	store(p);
	table_cache_free(p->cache);
	/* Of 1 byte: all there is would be deleted. */
	assert_int_equal(table_cache_create(p->folder, 1, true, &p->cache),
	    ERR_OK);
	assert_int_equal(folder_count(p->folder, ""), 2);
	assert_true(loads(p));
	p->op.resolution = NODES + 1;
	table_free(p->table);
	p->table = build(&p->op);
	table_cache_store(p->cache, p->table, &figures);
	table_cache_store_figures(p->cache, &p->op, &figures);
	table_cache_touch(p->cache, &p->op);
	assert_false(loads(p));
	assert_int_equal(folder_count(p->folder, ""), 2);
	snprintf(path, sizeof path, "%s/a", p->folder);
	assert_int_equal(cache_prepare(path, &is_read_only), ERR_IO);
	assert_int_equal(cache_prepare(p->folder, &is_read_only), ERR_OK);
	assert_int_equal(folder_count(p->folder, ""), 2);
}

#define CASE(name) cmocka_unit_test_setup_teardown(name, setup, teardown)

int main(void)
{
	const struct CMUnitTest tests[] = {
		CASE(test_what_is_loaded_is_what_was_built),
		CASE(test_figures_come_back),
		CASE(test_damaged_figures_do_not_count),
		CASE(test_another_key_finds_nothing),
		CASE(test_a_file_in_anothers_place_is_ignored),
		CASE(test_a_flipped_bit_is_found_and_mended),
		CASE(test_no_other_length_counts),
		CASE(test_only_a_file_of_ones_own_counts),
		CASE(test_what_build_would_not_give_is_ignored),
		CASE(test_what_was_used_longest_ago_goes_first),
		CASE(test_other_peoples_files_are_left_alone),
		CASE(test_a_link_or_anothers_file_is_left_alone),
		CASE(test_old_parts_of_ones_own_are_removed),
		CASE(test_a_killed_writers_part_is_removed),
		CASE(test_the_age_of_a_file),
		CASE(test_a_folder_that_is_gone_is_no_failure),
		CASE(test_a_full_disk_leaves_nothing_behind),
		CASE(test_several_processes_at_once),
		CASE(test_a_folder_is_made_for_its_user_alone),
		CASE(test_a_cache_that_is_only_read),
	};

	log_set_level(LOG_ERROR);
	return cmocka_run_group_tests(tests, NULL, NULL);
}
