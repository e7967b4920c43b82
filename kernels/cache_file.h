/*
 * Files of a cache folder: what was costly to make, kept from one start to the
 * next. A file holds its key, which is everything that can change its content,
 * and a checksum (XXH3, 128 bits) over all of it. The name is made of the kind
 * ("table", "figures", "kernels", "note") and the key's hash; a folder may hold
 * other files, which stay as they are. A checksum tells damage, not malice: a
 * file counts only if it is the user's own and others may not write it.
 *
 * A file is written beside its place and renamed, so that readers and several
 * writers see whole files; it is not flushed to the disk, since one that a
 * crash has spoilt is found to be. Safe from any thread and process.
 */
#ifndef KERNELS_CACHE_FILE_H
#define KERNELS_CACHE_FILE_H

#include <limits.h>
#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#include "core/err.h"

/* Raised whenever what is written here changes. */
#define CACHE_FILE_VERSION 1

/* Room for a folder's name, of everybody who keeps one. */
#define CACHE_FOLDER_MAX 1024

/* The most bytes of a key. */
#define CACHE_KEY_MAX 4096

/* Grows as members are added; too much is a bug. Start with {0}. */
struct cache_key {
	size_t size;
	unsigned char bytes[CACHE_KEY_MAX];
};
void cache_key_add(struct cache_key *key, const void *bytes, size_t size);

/* With its end, so that no two lists of texts are alike; cut to 512 bytes. */
void cache_key_add_text(struct cache_key *key, const char *text);
void cache_key_add_int(struct cache_key *key, int64_t value);

/* 128 bits that stand for text of any length in a key. */
void cache_key_add_hash(struct cache_key *key, const void *bytes, size_t size);

/* One that has been opened. */
struct cache_file {
	int fd;
	size_t size;     /* bytes of content */
	uint64_t sum[2]; /* over key and content */
	const struct cache_key *key;
};

/*
 * Opens the file of a kind ("table") and key in folder and checks all but its
 * content. ERR_NOT_FOUND: there is none. ERR_INVALID: there is, but it is
 * damaged, of another version or key, or not the user's own.
 */
enum err cache_file_open(const char *folder, const char *kind,
    const struct cache_key *key, struct cache_file *out);

/* Reads all of the content, file->size bytes, and checks it: ERR_INVALID,
 * ERR_IO. Marks the file as used just now. Closes it in any case. */
enum err cache_file_read(struct cache_file *file, void *content);

/* Instead of reading it. */
void cache_file_close(struct cache_file *file);

/* Writes or replaces a file. ERR_IO, with errno; ERR_MEMORY. */
enum err cache_file_write(const char *folder, const char *kind,
    const struct cache_key *key, const void *content, size_t size);

/* Whole seconds since the file was written, or marked as used. -1: there is
 * none that cache_file_open takes, or it is of a time to come. */
double cache_file_age(const char *folder, const char *kind,
    const struct cache_key *key);

/* Marks the file as used just now, if it is there. */
void cache_file_touch(const char *folder, const char *kind,
    const struct cache_key *key);

/* Where a file lies. False: the path would be too long. */
bool cache_file_path(const char *folder, const char *kind,
    const struct cache_key *key, char path[static PATH_MAX]);

/*
 * Removes the files used longest ago until those left take most bytes or less,
 * and what writers that were killed have left an hour ago or earlier. Touches
 * plain files of the user's own with a cache file's whole name, and no others.
 */
void cache_trim(const char *folder, size_t most);

/*
 * Makes folder, and those above it, if they are missing, for the user alone.
 * ERR_IO, with errno; ERR_INVALID: it is neither the user's own nor root's, or
 * others may write it (that they may read it, as with mode 0755, is no harm).
 * *is_read_only: it is not to be written, nor made; set if it cannot be.
 */
enum err cache_prepare(const char *folder, bool *is_read_only);

#endif
