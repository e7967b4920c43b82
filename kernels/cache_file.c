#include "kernels/cache_file.h"

#include <assert.h>
#include <dirent.h>
#include <errno.h>
#include <fcntl.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/stat.h>
#include <time.h>
#include <unistd.h>

#define XXH_INLINE_ALL /* no library to link */
#include <xxhash.h>

/*
 * Names: KIND-HASH.blobcache, and part-KIND-HASH-XXXXXX.blobcache.part for one
 * that is being written, mkostemps' six characters in it. The folder may hold
 * other people's files too: no other name is ours.
 */
#define SUFFIX ".blobcache"
#define PART_PREFIX "part-"
#define PART_RANDOM "XXXXXX"
#define PART_SUFFIX SUFFIX ".part"

static const char *const kinds[] = {"table", "figures", "kernels", "note"};

/* Digits of a key's hash in a name: 128 bits. */
#define HASH_DIGITS 32

/* Longest text within a key. */
#define TEXT_MAX 512

/* Seconds after which a part belongs to nobody. */
#define PART_AGE 3600

/* What a file begins with; the key follows, then the content. */
struct header {
	char magic[8];
	uint32_t order;    /* ORDER in the writer's byte order */
	uint32_t version;
	uint64_t key_size, size;
	uint64_t sum[2];   /* over all before it, the key and the content */
};

static const char magic[8] = "blobfld";

#define ORDER 0x01020304u

/* ---- keys ---- */

void cache_key_add(struct cache_key *key, const void *bytes, size_t size)
{
	assert(size <= sizeof key->bytes - key->size);
	memcpy(key->bytes + key->size, bytes, size);
	key->size += size;
}

void cache_key_add_text(struct cache_key *key, const char *text)
{
	size_t length = strnlen(text, TEXT_MAX);

	cache_key_add(key, text, length);
	cache_key_add(key, "", 1);
}

void cache_key_add_int(struct cache_key *key, int64_t value)
{
	cache_key_add(key, &value, sizeof value);
}

void cache_key_add_hash(struct cache_key *key, const void *bytes, size_t size)
{
	XXH128_hash_t hash = XXH3_128bits(bytes, size);

	cache_key_add(key, &hash.low64, sizeof hash.low64);
	cache_key_add(key, &hash.high64, sizeof hash.high64);
}

/* FOLDER/BEFORE KIND-HASH AFTER. False: too long. */
static bool print_path(const char *folder, const char *before,
    const char *kind, const struct cache_key *key, const char *after,
    char path[static PATH_MAX])
{
	XXH128_hash_t hash = XXH3_128bits(key->bytes, key->size);
	int length = snprintf(path, PATH_MAX, "%s/%s%s-%016llx%016llx%s",
	    folder, before, kind, (unsigned long long)hash.high64,
	    (unsigned long long)hash.low64, after);

	return length > 0 && length < PATH_MAX;
}

bool cache_file_path(const char *folder, const char *kind,
    const struct cache_key *key, char path[static PATH_MAX])
{
	return print_path(folder, "", kind, key, SUFFIX, path);
}

/* ... and the template of a part's. */
static bool print_part_path(const char *folder, const char *kind,
    const struct cache_key *key, char path[static PATH_MAX])
{
	return print_path(folder, PART_PREFIX, kind, key,
	    "-" PART_RANDOM PART_SUFFIX, path);
}

/* ---- headers ---- */

static struct header make_header(const struct cache_key *key, size_t size)
{
	struct header header = {.order = ORDER, .version = CACHE_FILE_VERSION,
	    .key_size = key->size, .size = size};

	memcpy(header.magic, magic, sizeof magic);
	return header;
}

/* Over header, key and content. False: no memory. */
static bool sum_up(const struct header *header, const struct cache_key *key,
    const void *content, uint64_t sum[static 2])
{
	XXH3_state_t *state = XXH3_createState();
	XXH128_hash_t hash;

	if (!state)
		return false;
	XXH3_128bits_reset(state);
	XXH3_128bits_update(state, header, offsetof(struct header, sum));
	XXH3_128bits_update(state, key->bytes, key->size);
	XXH3_128bits_update(state, content, header->size);
	hash = XXH3_128bits_digest(state);
	XXH3_freeState(state);
	sum[0] = hash.low64;
	sum[1] = hash.high64;
	return true;
}

/* ---- reading ---- */

static bool read_all(int fd, void *out, size_t size)
{
	unsigned char *at = out;

	while (size > 0) {
		ssize_t n = read(fd, at, size);

		if (n < 0 && errno == EINTR)
			continue;
		if (n <= 0)
			return false;
		at += n;
		size -= (size_t)n;
	}
	return true;
}

static bool is_trusted(const struct stat *info)
{
	return (info->st_uid == geteuid() || info->st_uid == 0) &&
	    (info->st_mode & (S_IWGRP | S_IWOTH)) == 0;
}

/* Header and key are what they should be, and the file as long as they say. */
static bool check_head(struct cache_file *file, const struct stat *info)
{
	const struct cache_key *key = file->key;
	struct header header, want;
	unsigned char bytes[CACHE_KEY_MAX];
	size_t rest;

	if (!S_ISREG(info->st_mode) || !is_trusted(info) ||
	    !read_all(file->fd, &header, sizeof header) ||
	    header.key_size != key->size ||
	    !read_all(file->fd, bytes, key->size) ||
	    memcmp(bytes, key->bytes, key->size) != 0)
		return false;
	rest = (size_t)info->st_size - sizeof header - key->size;
	want = make_header(key, rest);
	if (memcmp(&header, &want, offsetof(struct header, sum)) != 0)
		return false;
	memcpy(file->sum, header.sum, sizeof file->sum);
	file->size = rest;
	return true;
}

enum err cache_file_open(const char *folder, const char *kind,
    const struct cache_key *key, struct cache_file *out)
{
	struct cache_file file = {.key = key};
	char path[PATH_MAX];
	struct stat info;

	if (!cache_file_path(folder, kind, key, path))
		return ERR_NOT_FOUND;
	/* Not blocking: a pipe of that name would wait for its writer. */
	file.fd = open(path, O_RDONLY | O_CLOEXEC | O_NOFOLLOW | O_NONBLOCK);
	if (file.fd < 0)
		return errno == ENOENT ? ERR_NOT_FOUND : ERR_INVALID;
	if (fstat(file.fd, &info) != 0 || !check_head(&file, &info)) {
		close(file.fd);
		return ERR_INVALID;
	}
	*out = file;
	return ERR_OK;
}

enum err cache_file_read(struct cache_file *file, void *content)
{
	struct header header = make_header(file->key, file->size);
	enum err err = ERR_INVALID;
	uint64_t sum[2];

	if (read_all(file->fd, content, file->size)) {
		if (!sum_up(&header, file->key, content, sum))
			err = ERR_MEMORY;
		else if (memcmp(sum, file->sum, sizeof sum) == 0)
			err = ERR_OK;
	}
	if (err == ERR_OK)
		futimens(file->fd, NULL); /* else it looks older than it is */
	close(file->fd);
	return err;
}

void cache_file_close(struct cache_file *file)
{
	close(file->fd);
}

double cache_file_age(const char *folder, const char *kind,
    const struct cache_key *key)
{
	struct cache_file file;
	struct timespec now;
	struct stat info;
	double age = -1.0;

	if (cache_file_open(folder, kind, key, &file) != ERR_OK)
		return -1.0;
	clock_gettime(CLOCK_REALTIME, &now);
	if (fstat(file.fd, &info) == 0)
		age = difftime(now.tv_sec, info.st_mtim.tv_sec);
	close(file.fd);
	return age < 0.0 ? -1.0 : age;
}

void cache_file_touch(const char *folder, const char *kind,
    const struct cache_key *key)
{
	char path[PATH_MAX];

	if (cache_file_path(folder, kind, key, path))
		utimensat(AT_FDCWD, path, NULL, AT_SYMLINK_NOFOLLOW);
}

/* ---- writing ---- */

static bool write_all(int fd, const void *bytes, size_t size)
{
	const unsigned char *at = bytes;

	while (size > 0) {
		ssize_t n = write(fd, at, size);

		if (n < 0 && errno == EINTR)
			continue;
		if (n < 0)
			return false;
		at += n;
		size -= (size_t)n;
	}
	return true;
}

/* Closes fd in any case; close() tells of a full disk too. */
static bool fill(int fd, const struct header *header,
    const struct cache_key *key, const void *content)
{
	bool done = write_all(fd, header, sizeof *header) &&
	    write_all(fd, key->bytes, key->size) &&
	    write_all(fd, content, header->size);
	int saved = errno;

	if (close(fd) != 0)
		return false;
	errno = saved;
	return done;
}

enum err cache_file_write(const char *folder, const char *kind,
    const struct cache_key *key, const void *content, size_t size)
{
	struct header header = make_header(key, size);
	char path[PATH_MAX], part[PATH_MAX];
	int fd, saved;

	if (!cache_file_path(folder, kind, key, path) ||
	    !print_part_path(folder, kind, key, part)) {
		errno = ENAMETOOLONG;
		return ERR_IO;
	}
	if (!sum_up(&header, key, content, header.sum))
		return ERR_MEMORY;
	fd = mkostemps(part, (int)strlen(PART_SUFFIX), O_CLOEXEC);
	if (fd < 0)
		return ERR_IO;
	if (fill(fd, &header, key, content) && rename(part, path) == 0)
		return ERR_OK;
	saved = errno;
	unlink(part);
	errno = saved;
	return ERR_IO;
}

/* ---- the folder ---- */

struct found {
	char name[NAME_MAX + 1];
	struct timespec used;
	size_t size;
};

enum name {
	NAME_FOREIGN,
	NAME_FILE,
	NAME_PART
};

/* Moves *at past text, if it begins so. */
static bool skip(const char **at, const char *text)
{
	size_t length = strlen(text);

	if (strncmp(*at, text, length) != 0)
		return false;
	*at += length;
	return true;
}

/* ... past a kind and a hyphen. */
static bool skip_kind(const char **at)
{
	for (size_t i = 0; i < sizeof kinds / sizeof *kinds; i++) {
		const char *after = *at;

		if (skip(&after, kinds[i]) && skip(&after, "-")) {
			*at = after;
			return true;
		}
	}
	return false;
}

/* ... past exactly count characters of a set. */
static bool skip_some(const char **at, const char *set, size_t count)
{
	if (strspn(*at, set) != count)
		return false;
	*at += count;
	return true;
}

static enum name classify(const char *name)
{
	static const char hex[] = "0123456789abcdef";
	static const char random[] = "0123456789abcdefghijklmnopqrstuvwxyz"
	    "ABCDEFGHIJKLMNOPQRSTUVWXYZ";
	bool is_part = skip(&name, PART_PREFIX);

	if (!skip_kind(&name) || !skip_some(&name, hex, HASH_DIGITS))
		return NAME_FOREIGN;
	if (!is_part)
		return strcmp(name, SUFFIX) == 0 ? NAME_FILE : NAME_FOREIGN;
	return skip(&name, "-") &&
	    skip_some(&name, random, strlen(PART_RANDOM)) &&
	    strcmp(name, PART_SUFFIX) == 0 ? NAME_PART : NAME_FOREIGN;
}

static int compare_used(const void *a, const void *b)
{
	const struct timespec *x = &((const struct found *)a)->used;
	const struct timespec *y = &((const struct found *)b)->used;

	if (x->tv_sec != y->tv_sec)
		return x->tv_sec < y->tv_sec ? -1 : 1;
	return (x->tv_nsec > y->tv_nsec) - (x->tv_nsec < y->tv_nsec);
}

/* Looks at one name: removes an old part, adds a file to the list. False: no
 * memory. */
static bool note(int folder, const char *name, struct found **list,
    size_t *count)
{
	enum name what = classify(name);
	struct found *longer;
	struct stat info;

	if (what == NAME_FOREIGN ||
	    fstatat(folder, name, &info, AT_SYMLINK_NOFOLLOW) != 0 ||
	    !S_ISREG(info.st_mode) || info.st_uid != geteuid())
		return true;
	if (what == NAME_PART) {
		if (time(NULL) - info.st_mtime > PART_AGE)
			unlinkat(folder, name, 0);
		return true;
	}
	longer = realloc(*list, (*count + 1) * sizeof **list);
	if (!longer)
		return false;
	*list = longer;
	longer += (*count)++;
	snprintf(longer->name, sizeof longer->name, "%s", name);
	longer->used = info.st_mtim;
	longer->size = (size_t)info.st_size;
	return true;
}

void cache_trim(const char *folder, size_t most)
{
	DIR *dir = opendir(folder);
	struct found *list = NULL;
	size_t count = 0, total = 0;
	struct dirent *entry;

	if (!dir)
		return;
	while ((entry = readdir(dir)) != NULL &&
	    note(dirfd(dir), entry->d_name, &list, &count))
		;
	for (size_t i = 0; i < count; i++)
		total += list[i].size;
	if (total > most)
		qsort(list, count, sizeof *list, compare_used);
	for (size_t i = 0; i < count && total > most; i++) {
		unlinkat(dirfd(dir), list[i].name, 0);
		total -= list[i].size;
	}
	free(list);
	closedir(dir);
}

/* Makes the folders above path, and it. */
static bool make_folders(char *path)
{
	for (char *at = path + 1; *at != '\0'; at++) {
		if (*at != '/')
			continue;
		*at = '\0';
		if (mkdir(path, 0700) != 0 && errno != EEXIST)
			return false;
		*at = '/';
	}
	return mkdir(path, 0700) == 0 || errno == EEXIST;
}

enum err cache_prepare(const char *folder, bool *is_read_only)
{
	char path[CACHE_FOLDER_MAX];
	struct stat info;

	if (strlen(folder) >= CACHE_FOLDER_MAX) {
		errno = ENAMETOOLONG;
		return ERR_IO;
	}
	snprintf(path, sizeof path, "%s", folder);
	/* One that is there need not lie where folders can be made. */
	if (stat(folder, &info) != 0 && (*is_read_only ||
	    !make_folders(path) || stat(folder, &info) != 0))
		return ERR_IO;
	if (!S_ISDIR(info.st_mode)) {
		errno = ENOTDIR;
		return ERR_IO;
	}
	if (!is_trusted(&info))
		return ERR_INVALID;
	if (access(folder, W_OK) != 0)
		*is_read_only = true;
	return access(folder, R_OK | X_OK) == 0 ? ERR_OK : ERR_IO;
}
