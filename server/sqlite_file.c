#include "server/sqlite_file.h"

#include <errno.h>
#include <fcntl.h>
#include <inttypes.h>
#include <stdio.h>
#include <string.h>
#include <sys/file.h>
#include <sys/stat.h>
#include <unistd.h>

#include "server/log.h"

/* "blbf": PRAGMA application_id */
#define APPLICATION_ID 0x626c6266

/* What a mended file is to be called in the advice. */
#define NAME "scenes.sqlite"

/* In the lock file, once the folder has had scenes. */
static const char mark[] = "This folder keeps blobfield's scenes: " NAME "\n";

/* The schema, step by step: the first brings an empty file to version 1. */
static const char *const steps[] = {
	"CREATE TABLE scene (id TEXT PRIMARY KEY NOT NULL,"
	" owner TEXT NOT NULL) WITHOUT ROWID;"
	"CREATE TABLE revision (seq INTEGER PRIMARY KEY AUTOINCREMENT,"
	" scene TEXT NOT NULL REFERENCES scene (id) ON DELETE CASCADE,"
	" etag TEXT NOT NULL, time REAL NOT NULL, nodes INTEGER NOT NULL,"
	" text BLOB NOT NULL);"
	"CREATE INDEX revision_of_scene ON revision (scene, seq);",

	"CREATE TABLE volume (id TEXT PRIMARY KEY NOT NULL,"
	" length INTEGER NOT NULL, is_forgotten INTEGER NOT NULL)"
	" WITHOUT ROWID;"
	"CREATE TABLE volume_piece (volume TEXT NOT NULL REFERENCES"
	" volume (id) ON DELETE CASCADE, number INTEGER NOT NULL,"
	" data BLOB NOT NULL, PRIMARY KEY (volume, number));",

	/* Of all its revisions' texts: not to be summed up at each change. */
	"ALTER TABLE scene ADD COLUMN bytes INTEGER NOT NULL DEFAULT 0;"
	"UPDATE scene SET bytes = (SELECT coalesce(sum(length(text)), 0)"
	" FROM revision WHERE scene = scene.id);",

	"ALTER TABLE volume ADD COLUMN owner TEXT NOT NULL DEFAULT '';",
};

#define VERSION ((int)(sizeof steps / sizeof steps[0]))

/* ---- SQL ---- */

int sqlite_file_run(struct sqlite_file *file, const char *sql)
{
	return sqlite3_exec(file->db, sql, NULL, NULL, NULL);
}

int sqlite_file_number(struct sqlite_file *file, const char *sql,
    sqlite3_int64 *out)
{
	sqlite3_stmt *statement;
	int code = sqlite3_prepare_v2(file->db, sql, -1, &statement, NULL);

	if (code != SQLITE_OK)
		return code;
	code = sqlite3_step(statement);
	if (code == SQLITE_ROW)
		*out = sqlite3_column_int64(statement, 0);
	sqlite3_finalize(statement);
	return code == SQLITE_ROW ? SQLITE_OK : code;
}

/* ---- the folder ---- */

/* Makes path and what is above it, each for the user alone. */
static bool make_folders(const char *path)
{
	char part[SQLITE_FILE_PATH_MAX];

	for (size_t i = 1; path[i - 1] != '\0'; i++) {
		if (path[i] != '/' && path[i] != '\0')
			continue;
		memcpy(part, path, i);
		part[i] = '\0';
		if (mkdir(part, 0700) != 0 && errno != EEXIST)
			return false;
	}
	return true;
}

static enum err check_folder(const char *folder)
{
	struct stat info;

	if (!make_folders(folder) || stat(folder, &info) != 0) {
		log_write(LOG_ERROR, "%s: %s; scenes are kept there: make it "
		    "writable, or name another folder by --data (:memory: "
		    "keeps none)", folder, strerror(errno));
		return ERR_IO;
	}
	if (!S_ISDIR(info.st_mode)) {
		log_write(LOG_ERROR, "%s: is no folder; --data names one",
		    folder);
		return ERR_IO;
	}
	if ((info.st_mode & 022) != 0)
		log_write(LOG_WARNING, "%s: others may write there; chmod 700 "
		    "it", folder);
	return ERR_OK;
}

static enum err lock_folder(struct sqlite_file *file)
{
	char path[SQLITE_FILE_PATH_MAX + 8];

	snprintf(path, sizeof path, "%s/lock", file->folder);
	file->lock = open(path, O_RDWR | O_CREAT | O_CLOEXEC, 0600);
	if (file->lock < 0) {
		log_write(LOG_ERROR, "%s: %s; make the folder writable, or "
		    "name another by --data", path, strerror(errno));
		return ERR_IO;
	}
	if (flock(file->lock, LOCK_EX | LOCK_NB) == 0)
		return ERR_OK;
	if (errno != EWOULDBLOCK) {
		log_write(LOG_ERROR, "%s: cannot be locked: %s", path,
		    strerror(errno));
		return ERR_IO;
	}
	log_write(LOG_ERROR, "%s: another daemon uses this folder; stop it, or "
	    "name another folder by --data", file->folder);
	return ERR_BUSY;
}

/* Whether the folder has had a file. */
static bool is_marked(const struct sqlite_file *file)
{
	struct stat info;

	return fstat(file->lock, &info) == 0 && info.st_size > 0;
}

/* Files are there for good once their folder is written. */
static bool sync_folder(const char *folder)
{
	int fd = open(folder, O_RDONLY | O_DIRECTORY | O_CLOEXEC);
	bool is_done = fd >= 0 && fsync(fd) == 0;

	if (fd >= 0)
		close(fd);
	return is_done;
}

/* Only then may a missing file be told from one that never was. */
static enum err mark_folder(struct sqlite_file *file)
{
	if (is_marked(file))
		return ERR_OK;
	if (sync_folder(file->folder) &&
	    pwrite(file->lock, mark, sizeof mark - 1, 0) ==
	    (ssize_t)sizeof mark - 1 && fsync(file->lock) == 0)
		return ERR_OK;
	log_write(LOG_ERROR, "%s: %s", file->folder, strerror(errno));
	return ERR_IO;
}

/* ---- the file before it is opened ---- */

/* SQLite would make a new one, without a word, where one is missing or empty. */
static enum err check_presence(const struct sqlite_file *file)
{
	char wal[SQLITE_FILE_PATH_MAX + 8];
	struct stat info;
	bool is_there = stat(file->path, &info) == 0 && info.st_size > 0;

	snprintf(wal, sizeof wal, "%s-wal", file->path);
	if (is_there || (!is_marked(file) && (stat(wal, &info) != 0 ||
	    info.st_size == 0)))
		return ERR_OK;
	log_write(file->is_quiet ? LOG_DEBUG : LOG_ERROR,
	    "%s: is missing or empty, but its folder has kept "
	    "scenes; put the file back (or a copy of it), or, to begin with no "
	    "scenes, remove %s/lock and %s", file->path, file->folder, wal);
	return ERR_INVALID;
}

/* What to do about a damaged file. */
static enum err refuse(const struct sqlite_file *file, const char *what)
{
	log_write(LOG_ERROR, "%s: is damaged: %s. It has been left as it is. "
	    "Put a copy from before in its place (with its -wal and -shm files "
	    "removed); or save what can be with sqlite3's .recover or .dump, "
	    "as OPERATIONS.md says; or name another folder by --data", file->path,
	    what);
	return ERR_INVALID;
}

/* Whether the file has the length that its head says; where there is a log, that
 * may have the rest. (SQLite file format, section 1.3: page size, page count.) */
static enum err check_length(const struct sqlite_file *file)
{
	char wal[SQLITE_FILE_PATH_MAX + 8], what[80];
	unsigned char head[100];
	struct stat info, wal_info;
	uint64_t size, pages;
	int fd;

	snprintf(wal, sizeof wal, "%s-wal", file->path);
	if (stat(file->path, &info) != 0 || info.st_size == 0 ||
	    (stat(wal, &wal_info) == 0 && wal_info.st_size > 0))
		return ERR_OK;
	fd = open(file->path, O_RDONLY | O_CLOEXEC);
	memset(head, 0, sizeof head);
	if (fd >= 0 && pread(fd, head, sizeof head, 0) < 0)
		memset(head, 0, sizeof head);
	if (fd >= 0)
		close(fd);
	size = (uint64_t)head[16] << 8 | head[17];
	size = size == 1 ? 65536 : size;
	pages = (uint64_t)head[28] << 24 | (uint64_t)head[29] << 16 |
	    (uint64_t)head[30] << 8 | head[31];
	/* What is no page size is not cut but overwritten: SQLite will say. */
	if ((size & (size - 1)) != 0 || size < 512 ||
	    (uint64_t)info.st_size >= size * pages)
		return ERR_OK;
	snprintf(what, sizeof what, "it is cut, at %" PRIu64 " of %" PRIu64
	    " bytes", (uint64_t)info.st_size, size * pages);
	return refuse(file, what);
}

/* ---- opening ---- */

static enum err judge_code(const struct sqlite_file *file, int code)
{
	switch (code & 0xff) {
	case SQLITE_CORRUPT:
	case SQLITE_NOTADB:
	case SQLITE_ERROR:
	case SQLITE_FORMAT:
		return refuse(file, sqlite3_errmsg(file->db));
	case SQLITE_NOMEM:
		return ERR_MEMORY;
	case SQLITE_BUSY:
	case SQLITE_LOCKED:
		log_write(LOG_ERROR, "%s: another program uses it: %s",
		    file->path, sqlite3_errmsg(file->db));
		return ERR_BUSY;
	default:
		log_write(file->is_quiet ? LOG_DEBUG : LOG_ERROR,
		    "%s: %s (code %d, errno %d); is the disk "
		    "full, or read-only? --data names another folder",
		    file->path, sqlite3_errmsg(file->db),
		    sqlite3_extended_errcode(file->db),
		    sqlite3_system_errno(file->db));
		return ERR_IO;
	}
}

static enum err check_soundness(struct sqlite_file *file)
{
	sqlite3_stmt *statement;
	enum err err = ERR_OK;
	int code = sqlite3_prepare_v2(file->db, "PRAGMA quick_check(1)", -1,
	    &statement, NULL);

	if (code != SQLITE_OK)
		return judge_code(file, code);
	code = sqlite3_step(statement);
	if (code != SQLITE_ROW)
		err = judge_code(file, code);
	else if (strcmp((const char *)sqlite3_column_text(statement, 0),
	    "ok") != 0)
		err = refuse(file,
		    (const char *)sqlite3_column_text(statement, 0));
	sqlite3_finalize(statement);
	return err;
}

/* One step of the schema, wholly or not at all. */
static int migrate(struct sqlite_file *file, int step)
{
	char version[64];
	int code;

	snprintf(version, sizeof version, "PRAGMA user_version=%d", step + 1);
	code = sqlite_file_run(file, "BEGIN IMMEDIATE");
	if (code == SQLITE_OK)
		code = sqlite_file_run(file, steps[step]);
	if (code == SQLITE_OK)
		code = sqlite_file_run(file, version);
	if (code == SQLITE_OK)
		code = sqlite_file_run(file, "COMMIT");
	if (code != SQLITE_OK)
		sqlite_file_run(file, "ROLLBACK");
	return code;
}

/* Whether the file is one of ours, and of what version: 0, a new one. */
static enum err read_version(struct sqlite_file *file, int *version)
{
	sqlite3_int64 id = 0, kept = 0, tables = 0;
	int code = sqlite_file_number(file, "PRAGMA application_id", &id);

	if (code == SQLITE_OK)
		code = sqlite_file_number(file, "PRAGMA user_version", &kept);
	if (code == SQLITE_OK)
		code = sqlite_file_number(file,
		    "SELECT count(*) FROM sqlite_master", &tables);
	if (code != SQLITE_OK)
		return judge_code(file, code);
	if (kept < 0)
		return refuse(file, "its version is below 0");
	*version = (int)kept;
	if (id == APPLICATION_ID || (id == 0 && kept == 0 && tables == 0))
		return ERR_OK;
	log_write(LOG_ERROR, "%s: is another program's file; name another "
	    "folder by --data", file->path);
	return ERR_INVALID;
}

static enum err bring_up_to_date(struct sqlite_file *file)
{
	int version = 0;
	enum err err = read_version(file, &version);
	int code = SQLITE_OK;

	if (err != ERR_OK)
		return err;
	if (version > VERSION) {
		log_write(LOG_ERROR, "%s: is of version %d; this daemon knows "
		    "up to %d: start the newer one again, or name another "
		    "folder by --data", file->path, version, VERSION);
		return ERR_INVALID;
	}
	if (version == 0) {
		char sql[64];

		snprintf(sql, sizeof sql, "PRAGMA application_id=%d",
		    APPLICATION_ID);
		code = sqlite_file_run(file, sql);
	}
	for (int i = version; i < VERSION && code == SQLITE_OK; i++)
		code = migrate(file, i);
	if (code == SQLITE_OK && version > 0 && version < VERSION)
		log_write(LOG_INFO, "%s: brought from version %d to %d",
		    file->path, version, VERSION);
	return code == SQLITE_OK ? ERR_OK : judge_code(file, code);
}

static enum err set_up(struct sqlite_file *file)
{
	/* The WAL is cut after a large volume has gone through it. */
	int code = sqlite_file_run(file, "PRAGMA journal_mode=WAL;"
	    "PRAGMA synchronous=FULL; PRAGMA foreign_keys=ON;"
	    "PRAGMA wal_autocheckpoint=1000;"
	    "PRAGMA journal_size_limit=16777216;"
	    "PRAGMA cell_size_check=ON; PRAGMA trusted_schema=OFF");

	return code == SQLITE_OK ? ERR_OK : judge_code(file, code);
}

static void note_place(struct sqlite_file *file)
{
	struct stat info = {0};

	stat(file->path, &info);
	file->device = info.st_dev;
	file->inode = info.st_ino;
}

bool sqlite_file_is_in_place(const struct sqlite_file *file)
{
	struct stat info;

	return file->folder[0] == '\0' || (stat(file->path, &info) == 0 &&
	    info.st_dev == file->device && info.st_ino == file->inode);
}

static enum err open_db(struct sqlite_file *file)
{
	int code = sqlite3_open_v2(file->path, &file->db,
	    SQLITE_OPEN_READWRITE | SQLITE_OPEN_CREATE | SQLITE_OPEN_NOMUTEX,
	    NULL);

	if (code != SQLITE_OK)
		return judge_code(file, code);
	note_place(file);
	sqlite3_extended_result_codes(file->db, 1);
	/* Somebody makes a copy, or looks at it. */
	sqlite3_busy_timeout(file->db, SQLITE_FILE_BUSY_MS);
	return set_up(file);
}

/* The file is made before SQLite does, for its owner alone; SQLite gives the
 * files beside it the same mode. */
static void make_file(const struct sqlite_file *file)
{
	int fd = open(file->path, O_RDWR | O_CREAT | O_CLOEXEC, 0600);

	if (fd >= 0)
		close(fd);
}

static enum err open_in_folder(struct sqlite_file *file)
{
	enum err err = check_folder(file->folder);

	if (err == ERR_OK)
		err = lock_folder(file);
	if (err == ERR_OK)
		err = check_presence(file);
	if (err == ERR_OK)
		err = check_length(file);
	if (err != ERR_OK)
		return err;
	make_file(file);
	err = open_db(file);
	if (err == ERR_OK)
		err = check_soundness(file);
	if (err == ERR_OK)
		err = bring_up_to_date(file);
	return err == ERR_OK ? mark_folder(file) : err;
}

enum err sqlite_file_open(const char *folder, struct sqlite_file *out)
{
	enum err err;

	*out = (struct sqlite_file){.lock = -1};
	if (strcmp(folder, ":memory:") == 0) {
		strcpy(out->path, folder);
		err = open_db(out);
		return err == ERR_OK ? bring_up_to_date(out) : err;
	}
	snprintf(out->folder, sizeof out->folder, "%s", folder);
	if ((size_t)snprintf(out->path, sizeof out->path, "%s/" NAME,
	    folder) >= sizeof out->path) {
		log_write(LOG_ERROR, "--data: the folder's name is too long");
		return ERR_IO;
	}
	return open_in_folder(out);
}

enum err sqlite_file_reopen(struct sqlite_file *file)
{
	enum err err;

	/* A log that is there now is the other file's. */
	if (file->db != NULL && !sqlite_file_is_in_place(file))
		sqlite3_db_config(file->db, SQLITE_DBCONFIG_NO_CKPT_ON_CLOSE,
		    1, NULL);
	sqlite3_close(file->db);
	file->db = NULL;
	file->is_quiet = true;
	err = check_presence(file);
	return err == ERR_OK ? open_db(file) : err;
}

int sqlite_file_open_reader(const struct sqlite_file *file, sqlite3 **out)
{
	int code = sqlite3_open_v2(file->path, out,
	    SQLITE_OPEN_READONLY | SQLITE_OPEN_NOMUTEX, NULL);

	if (code != SQLITE_OK)
		return code;
	sqlite3_extended_result_codes(*out, 1);
	sqlite3_busy_timeout(*out, SQLITE_FILE_BUSY_MS);
	return sqlite3_exec(*out, "PRAGMA cell_size_check=ON;"
	    "PRAGMA trusted_schema=OFF", NULL, NULL, NULL);
}

void sqlite_file_close(struct sqlite_file *file)
{
	sqlite3_close(file->db);
	file->db = NULL;
	if (file->lock >= 0)
		close(file->lock);
	file->lock = -1;
}
