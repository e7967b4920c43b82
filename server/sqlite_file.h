/*
 * The file that scenes are kept in: its folder, its lock, its schema, and whether
 * it is sound. Used by backing_sqlite.c only.
 */
#ifndef SERVER_SQLITE_FILE_H
#define SERVER_SQLITE_FILE_H

#include <stdbool.h>
#include <sys/types.h>

#include <sqlite3.h>

#include "core/err.h"

#define SQLITE_FILE_PATH_MAX 1200

/* How long to wait for another program that looks at the file. */
#define SQLITE_FILE_BUSY_MS 2000

struct sqlite_file {
	char folder[SQLITE_FILE_PATH_MAX]; /* "": in memory */
	char path[SQLITE_FILE_PATH_MAX];   /* ":memory:" */
	int lock;                          /* descriptor, or -1 */
	sqlite3 *db;                       /* NULL: closed */
	bool is_quiet;                     /* what fails has been told */
	dev_t device;                      /* of the file that is open */
	ino_t inode;
};

/*
 * Makes the folder if it is missing, locks it, opens the file in it, or makes it
 * if the folder never had one; checks it and brings it up to date. As
 * backing_open_sqlite; what is wrong is logged. *out is for sqlite_file_close,
 * also on failure.
 */
enum err sqlite_file_open(const char *folder, struct sqlite_file *out);

/* Closes and opens the file again, the folder stays locked. ERR_IO; ERR_INVALID */
enum err sqlite_file_reopen(struct sqlite_file *file);

/* Whether the file that is open is the one that the path names: it was not
 * removed, or replaced by a copy. */
bool sqlite_file_is_in_place(const struct sqlite_file *file);

/* A second connection to the file that is open, by which it can only be read; its
 * own thread's. An SQLite code; *out is to be closed also on failure, and before
 * the file is. */
int sqlite_file_open_reader(const struct sqlite_file *file, sqlite3 **out);

/* Closes what is open. */
void sqlite_file_close(struct sqlite_file *file);

/* Runs SQL without results; an SQLite code. */
int sqlite_file_run(struct sqlite_file *file, const char *sql);

/* A whole number that SQL gives. */
int sqlite_file_number(struct sqlite_file *file, const char *sql,
    sqlite3_int64 *out);

#endif
