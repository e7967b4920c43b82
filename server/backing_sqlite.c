/*
 * Scenes kept in one SQLite file. A change is kept when its transaction is in
 * the write-ahead log, and that on the disk (synchronous=FULL).
 *
 * A commit that fails leaves open whether it will be found there later: the log's
 * last pages may or may not have arrived. So the file is closed, which cuts the
 * log to what is known to be kept, and opened again; what is there then decides.
 * While it cannot be opened nothing is changed, and when it can, and has another
 * last seq than was known, everything is read anew.
 *
 * Older revisions are read by a connection of their own (WAL: neither waits for
 * the other), which is closed whenever the file is closed to find out what it
 * has: only the last to close it cuts the log. What is kept in memory has but one
 * connection, which is lent for as long as a text takes to be copied.
 */
#include "server/backing.h"

#include <limits.h>
#include <pthread.h>
#include <stdatomic.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <time.h>

#include "server/etag.h"
#include "server/log.h"
#include "server/sqlite_file.h"

/* Of volumes, a row. */
#define PIECE ((size_t)1 << 20)

enum query {
	PUT_SCENE,
	PUT_REVISION,
	NEWEST_OVER,
	OLDEST,
	CUT,
	SET_BYTES,
	DELETE_SCENE,
	MARK_VOLUME,
	PUT_VOLUME,
	PUT_PIECE,
	FORGET_VOLUME,
	DELETE_VOLUME,
	QUERY_COUNT
};

static const char *const sql[QUERY_COUNT] = {
	[PUT_SCENE] = "INSERT INTO scene (id, owner, bytes)"
	    " VALUES (?1, ?2, ?3) ON CONFLICT (id) DO UPDATE SET owner = ?2,"
	    " bytes = bytes + ?3 RETURNING bytes",
	[PUT_REVISION] = "INSERT INTO revision (scene, etag, time, nodes, text)"
	    " VALUES (?1, ?2, ?3, ?4, ?5)",
	[NEWEST_OVER] = "SELECT seq FROM revision WHERE scene = ?1"
	    " ORDER BY seq DESC LIMIT 1 OFFSET ?2",
	[OLDEST] = "SELECT seq, length(text) FROM revision"
	    " WHERE scene = ?1 AND seq < ?2 ORDER BY seq",
	[CUT] = "DELETE FROM revision WHERE scene = ?1 AND seq <= ?2",
	[SET_BYTES] = "UPDATE scene SET bytes = ?2 WHERE id = ?1",
	[DELETE_SCENE] = "DELETE FROM scene WHERE id = ?1",
	[MARK_VOLUME] = "UPDATE volume SET is_forgotten = ?3, owner = CASE"
	    " is_forgotten WHEN 0 THEN owner ELSE ?4 END"
	    " WHERE id = ?1 AND length = ?2 RETURNING owner",
	[PUT_VOLUME] = "INSERT INTO volume (id, length, is_forgotten,"
	    " owner) VALUES (?1, ?2, ?3, ?4)",
	[PUT_PIECE] = "INSERT INTO volume_piece (volume, number, data)"
	    " VALUES (?1, ?2, ?3)",
	[FORGET_VOLUME] = "UPDATE volume SET is_forgotten = 1 WHERE id = ?1",
	[DELETE_VOLUME] = "DELETE FROM volume WHERE id = ?1",
};

static const char read_sql[] = "SELECT seq, time, nodes, text FROM revision"
    " WHERE scene = ?1 AND etag = ?2 ORDER BY seq DESC LIMIT 1";

struct backing_sqlite {
	struct backing base;
	struct backing_options options;

	/* Guards file and queries: the writer's, lent to the reader only if they
	 * are in memory. */
	pthread_mutex_t using;
	struct sqlite_file file;
	sqlite3_stmt *queries[QUERY_COUNT];
	sqlite3_int64 last; /* seq that is known to be kept */
	bool is_closed;     /* a failure has closed the file */
	bool is_replaced;   /* and it was another one */
	bool is_another;    /* when it was opened last, it was another one */
	bool is_in_doubt;   /* whether the last transaction is kept */

	/* Guards what follows, and is held while the file is opened anew. */
	pthread_mutex_t reading;
	sqlite3 *reader;        /* NULL: to be opened */
	sqlite3_stmt *read;     /* of it, or, in memory, of file */
	bool is_gone;           /* the file is not open */

	atomic_bool is_well;
};

static struct backing_sqlite *self(struct backing *b)
{
	return (struct backing_sqlite *)b;
}

/* ---- queries ---- */

static void drop_queries(struct backing_sqlite *s)
{
	for (int i = 0; i < QUERY_COUNT; i++) {
		sqlite3_finalize(s->queries[i]);
		s->queries[i] = NULL;
	}
}

/* The query, ready to be bound; NULL: it cannot be. */
static sqlite3_stmt *query(struct backing_sqlite *s, enum query which)
{
	if (s->queries[which] == NULL)
		sqlite3_prepare_v3(s->file.db, sql[which], -1,
		    SQLITE_PREPARE_PERSISTENT, &s->queries[which], NULL);
	return s->queries[which];
}

static void bind_text(sqlite3_stmt *q, int at, const char *text)
{
	sqlite3_bind_text(q, at, text, -1, SQLITE_STATIC);
}

/* Of a query without rows; NULL fails. */
static int finish(struct backing_sqlite *s, sqlite3_stmt *q)
{
	int code;

	if (q == NULL)
		return sqlite3_errcode(s->file.db);
	code = sqlite3_step(q);
	sqlite3_reset(q);
	sqlite3_clear_bindings(q);
	return code == SQLITE_DONE ? SQLITE_OK : code;
}

/* Of one that may have a row: its first column, or 0. NULL fails. */
static int number_of(struct backing_sqlite *s, sqlite3_stmt *q,
    sqlite3_int64 *out)
{
	int code;

	*out = 0;
	if (q == NULL)
		return sqlite3_errcode(s->file.db);
	code = sqlite3_step(q);
	if (code == SQLITE_ROW)
		*out = sqlite3_column_int64(q, 0);
	sqlite3_reset(q);
	sqlite3_clear_bindings(q);
	return code == SQLITE_ROW || code == SQLITE_DONE ? SQLITE_OK : code;
}

/* One that only takes an id. */
static int run_on(struct backing_sqlite *s, enum query which, const char *id)
{
	sqlite3_stmt *q = query(s, which);

	if (q != NULL)
		bind_text(q, 1, id);
	return finish(s, q);
}

static int last_seq(struct backing_sqlite *s, sqlite3_int64 *out)
{
	*out = 0;
	return sqlite_file_number(&s->file, "SELECT coalesce(max(seq), 0) "
	    "FROM sqlite_sequence WHERE name = 'revision'", out);
}

/* ---- failures ---- */

static void complain(struct backing_sqlite *s, const char *what)
{
	if (!atomic_exchange(&s->is_well, false))
		return;
	log_write(LOG_ERROR, "%s: %s: %s (code %d, errno %d); changes are "
	    "refused until it can be written", s->file.path, what,
	    sqlite3_errmsg(s->file.db), sqlite3_extended_errcode(s->file.db),
	    sqlite3_system_errno(s->file.db));
}

static void recover(struct backing_sqlite *s)
{
	if (!atomic_exchange(&s->is_well, true))
		log_write(LOG_INFO, "%s: can be written again", s->file.path);
}

static void drop_reader(struct backing_sqlite *s)
{
	sqlite3_finalize(s->read);
	sqlite3_close(s->reader);
	s->read = NULL;
	s->reader = NULL;
}

/* Has the file open. ERR_UNAVAILABLE; *is_other: it does not end where it was
 * known to. Nobody reads meanwhile. */
static enum err reopen_alone(struct backing_sqlite *s, bool *is_other)
{
	bool is_replaced = s->is_replaced || (s->file.db != NULL &&
	    !sqlite_file_is_in_place(&s->file));
	sqlite3_int64 last;

	s->is_closed = true;
	s->is_replaced = is_replaced;
	drop_queries(s);
	if (s->file.folder[0] == '\0')
		return ERR_UNAVAILABLE; /* memory cannot be opened again */
	if (sqlite_file_reopen(&s->file) != ERR_OK ||
	    last_seq(s, &last) != SQLITE_OK) {
		drop_queries(s);
		sqlite3_close(s->file.db);
		s->file.db = NULL;
		return ERR_UNAVAILABLE;
	}
	s->is_closed = s->is_replaced = false;
	s->is_another = is_replaced;
	*is_other = last != s->last || is_replaced;
	s->last = last;
	return ERR_OK;
}

static enum err reopen(struct backing_sqlite *s, bool *is_other)
{
	enum err err;

	pthread_mutex_lock(&s->reading);
	drop_reader(s);
	err = reopen_alone(s, is_other);
	s->is_gone = err != ERR_OK;
	pthread_mutex_unlock(&s->reading);
	return err;
}

static void note_replaced(struct backing_sqlite *s)
{
	if (atomic_exchange(&s->is_well, false))
		log_write(LOG_ERROR, "%s: was removed or replaced; changes are "
		    "refused until it can be read", s->file.path);
}

/* Before anything is done: what an earlier failure has closed is opened. */
static enum err be_open(struct backing_sqlite *s)
{
	bool is_other = false;
	enum err err;

	if (!s->is_closed && sqlite_file_is_in_place(&s->file))
		return ERR_OK;
	if (!s->is_closed)
		note_replaced(s);
	err = reopen(s, &is_other);
	if (err != ERR_OK || !is_other)
		return err;
	s->options.lost(s->options.changed.ctx);
	return ERR_UNAVAILABLE;
}

static int begin(struct backing_sqlite *s)
{
	return sqlite_file_run(&s->file, "BEGIN IMMEDIATE");
}

static void roll_back(struct backing_sqlite *s)
{
	if (sqlite3_get_autocommit(s->file.db) == 0)
		sqlite_file_run(&s->file, "ROLLBACK");
}

/* What passes by itself; after anything else the connection may be spoilt (a
 * file of the log that could not be opened). */
static bool passes(int code)
{
	switch (code & 0xff) {
	case SQLITE_BUSY:
	case SQLITE_FULL:
	case SQLITE_NOMEM:
		return true;
	default:
		return false;
	}
}

/*
 * Ends a transaction in which everything went as code says, and after which the
 * last seq is to be last. Whether it is kept, is found out.
 */
static enum err end(struct backing_sqlite *s, int code, sqlite3_int64 last)
{
	bool is_other = false;

	s->is_in_doubt = false;
	if (code != SQLITE_OK) {
		complain(s, "cannot be written");
		roll_back(s);
		if (s->file.folder[0] != '\0' && !passes(code))
			s->is_closed = true;
		return code == SQLITE_NOMEM ? ERR_MEMORY : ERR_UNAVAILABLE;
	}
	code = sqlite_file_run(&s->file, "COMMIT");
	if (code == SQLITE_OK) {
		s->last = last;
		recover(s);
		return ERR_OK;
	}
	complain(s, "a change could not be kept");
	roll_back(s);
	if (s->file.folder[0] == '\0' || (code & 0xff) == SQLITE_BUSY)
		return ERR_UNAVAILABLE;
	s->is_in_doubt = true;
	if (reopen(s, &is_other) != ERR_OK || !is_other)
		return ERR_UNAVAILABLE;
	if (s->last == last && !s->is_another)
		return ERR_OK;
	/* Nothing that is known is of this file; nor is it to be repeated. */
	s->is_in_doubt = false;
	s->options.lost(s->options.changed.ctx);
	return ERR_UNAVAILABLE;
}

/* ---- writing ---- */

/* *bytes: of all its revisions, r too. */
static int put_scene(struct backing_sqlite *s,
    const struct backing_revision *r, sqlite3_int64 *bytes)
{
	sqlite3_stmt *q = query(s, PUT_SCENE);

	if (q != NULL) {
		bind_text(q, 1, r->id);
		bind_text(q, 2, r->owner);
		sqlite3_bind_int64(q, 3, (sqlite3_int64)r->length);
	}
	return number_of(s, q, bytes);
}

static int put_revision(struct backing_sqlite *s,
    const struct backing_revision *r)
{
	sqlite3_stmt *q = query(s, PUT_REVISION);

	if (q != NULL) {
		bind_text(q, 1, r->id);
		bind_text(q, 2, r->etag);
		sqlite3_bind_double(q, 3, r->time);
		sqlite3_bind_int64(q, 4, (sqlite3_int64)r->nodes);
		sqlite3_bind_blob64(q, 5, r->text != NULL ? r->text : "",
		    r->length, SQLITE_STATIC);
	}
	return finish(s, q);
}

/* ---- what is kept of a scene's past ---- */

/* A scene, and what all but its newest revision take. */
struct past {
	const char *id;
	sqlite3_int64 newest;    /* its seq */
	sqlite3_int64 bytes, newest_bytes;
	sqlite3_int64 cut;       /* seq of what goes, and all before it; or 0 */
};

/* The newest revision that is one too many. */
static int find_over(struct backing_sqlite *s, const char *id,
    sqlite3_int64 *out)
{
	sqlite3_stmt *q = query(s, NEWEST_OVER);

	if (q != NULL) {
		bind_text(q, 1, id);
		sqlite3_bind_int64(q, 2, (sqlite3_int64)s->options.history);
	}
	return number_of(s, q, out);
}

static bool is_too_much(const struct backing_sqlite *s, sqlite3_int64 bytes)
{
	return s->options.history_bytes > 0 && bytes > 0 &&
	    (uint64_t)bytes > s->options.history_bytes;
}

/* From the oldest on, until as few and as little are left as may be. */
static int find_cut(struct backing_sqlite *s, struct past *p)
{
	sqlite3_int64 over = 0;
	int code = find_over(s, p->id, &over);
	sqlite3_stmt *q;

	if (code != SQLITE_OK || (over == 0 && !is_too_much(s, p->bytes)))
		return code;
	q = query(s, OLDEST);
	if (q == NULL)
		return sqlite3_errcode(s->file.db);
	bind_text(q, 1, p->id);
	sqlite3_bind_int64(q, 2, p->newest);
	while ((code = sqlite3_step(q)) == SQLITE_ROW) {
		sqlite3_int64 seq = sqlite3_column_int64(q, 0);

		if (seq > over && !is_too_much(s, p->bytes))
			break;
		p->bytes -= sqlite3_column_int64(q, 1);
		p->cut = seq;
	}
	sqlite3_reset(q);
	sqlite3_clear_bindings(q);
	return code == SQLITE_ROW || code == SQLITE_DONE ? SQLITE_OK : code;
}

static int run_with(struct backing_sqlite *s, enum query which, const char *id,
    sqlite3_int64 number)
{
	sqlite3_stmt *q = query(s, which);

	if (q != NULL) {
		bind_text(q, 1, id);
		sqlite3_bind_int64(q, 2, number);
	}
	return finish(s, q);
}

/* In the transaction that made it too much. */
static int trim(struct backing_sqlite *s, struct past *p)
{
	int code = find_cut(s, p);

	if (code != SQLITE_OK || p->cut == 0)
		return code;
	code = run_with(s, CUT, p->id, p->cut);
	return code == SQLITE_OK ? run_with(s, SET_BYTES, p->id,
	    p->bytes + p->newest_bytes) : code;
}

/* A deletion takes a seq, too: that of a revision which goes with the scene. */
static int write_one(struct backing_sqlite *s, struct backing_write *w)
{
	struct backing_revision *r = &w->revision;
	struct past past = {.id = r->id,
	    .newest_bytes = (sqlite3_int64)r->length};
	int code = SQLITE_OK;

	if (r->text != NULL)
		code = put_scene(s, r, &past.bytes);
	if (code == SQLITE_OK)
		code = put_revision(s, r);
	if (code != SQLITE_OK)
		return code;
	past.bytes -= past.newest_bytes;
	past.newest = sqlite3_last_insert_rowid(s->file.db);
	r->seq.major = (uint64_t)past.newest;
	r->seq.minor = 0;
	return r->text != NULL ? trim(s, &past) :
	    run_on(s, DELETE_SCENE, r->id);
}

/* ---- what was kept under other bounds ---- */

/* Scenes whose past is to be trimmed, or whose sum is not what it was. */
struct pasts {
	struct past *list;
	size_t count;
};

static void free_pasts(struct pasts *pasts)
{
	for (size_t i = 0; i < pasts->count; i++)
		free((char *)pasts->list[i].id);
	free(pasts->list);
}

/* The row of: scene, newest seq, bytes of all, how many, of the newest, the
 * scene's sum. */
static int note_past(struct backing_sqlite *s, struct pasts *pasts,
    sqlite3_stmt *q)
{
	const char *id = (const char *)sqlite3_column_text(q, 0);
	const sqlite3_int64 all = sqlite3_column_int64(q, 2);
	struct past *grown, p = {.newest = sqlite3_column_int64(q, 1),
	    .newest_bytes = sqlite3_column_int64(q, 4)};

	p.bytes = all - p.newest_bytes;
	if (sqlite3_column_int64(q, 5) == all && sqlite3_column_int64(q, 3) <=
	    (sqlite3_int64)s->options.history && !is_too_much(s, p.bytes))
		return SQLITE_OK;
	grown = realloc(pasts->list, (pasts->count + 1) * sizeof *grown);
	if (grown == NULL)
		return SQLITE_NOMEM;
	pasts->list = grown;
	p.id = id != NULL ? strdup(id) : NULL;
	if (p.id == NULL)
		return SQLITE_NOMEM;
	grown[pasts->count++] = p;
	return SQLITE_OK;
}

/* In the order of the index, so that texts are neither read nor sorted. */
static int find_pasts(struct backing_sqlite *s, struct pasts *pasts)
{
	sqlite3_stmt *q;
	int code = sqlite3_prepare_v2(s->file.db, "SELECT scene, newest, bytes,"
	    " count, (SELECT length(text) FROM revision WHERE seq = newest),"
	    " (SELECT bytes FROM scene WHERE id = scene) FROM (SELECT scene,"
	    " max(seq) AS newest, sum(length(text)) AS bytes, count(*) AS count"
	    " FROM revision INDEXED BY revision_of_scene GROUP BY scene)", -1,
	    &q, NULL);

	if (code != SQLITE_OK)
		return code;
	while ((code = sqlite3_step(q)) == SQLITE_ROW) {
		code = note_past(s, pasts, q);
		if (code != SQLITE_OK)
			break;
	}
	sqlite3_finalize(q);
	return code == SQLITE_DONE ? SQLITE_OK : code;
}

/* Where it cannot be done, it is at each scene's next change. If the file turns out
 * to be another one, end() has said that what was loaded is lost. */
static void trim_all(struct backing_sqlite *s)
{
	struct pasts pasts = {NULL, 0};
	int code = find_pasts(s, &pasts);

	if (code == SQLITE_OK && pasts.count > 0) {
		code = begin(s);
		for (size_t i = 0; i < pasts.count && code == SQLITE_OK; i++) {
			struct past *p = pasts.list + i;

			code = run_with(s, SET_BYTES, p->id, p->bytes +
			    p->newest_bytes);
			if (code == SQLITE_OK)
				code = trim(s, p);
		}
		end(s, code, s->last);
	}
	free_pasts(&pasts);
}

/* ---- committing ---- */

/* Seconds since 1970, whole milliseconds: as they are told. */
static double now(void)
{
	struct timespec t;

	clock_gettime(CLOCK_REALTIME, &t);
	return (double)t.tv_sec + (double)(t.tv_nsec / 1000000) / 1e3;
}

/* Whether it can be written, without a change. */
static enum err probe(struct backing_sqlite *s)
{
	sqlite3_int64 version = 0;
	char text[64];
	int code = sqlite_file_number(&s->file, "PRAGMA user_version",
	    &version);

	snprintf(text, sizeof text, "PRAGMA user_version=%d", (int)version);
	if (code == SQLITE_OK)
		code = begin(s);
	if (code == SQLITE_OK)
		code = sqlite_file_run(&s->file, text);
	return end(s, code, s->last);
}

static enum err commit_all(struct backing_sqlite *s,
    struct backing_write *writes, size_t count)
{
	sqlite3_int64 last = s->last;
	double time = now();
	enum err err = be_open(s);
	int code;

	if (err != ERR_OK)
		return err;
	if (count == 0)
		return probe(s);
	code = begin(s);
	for (size_t i = 0; i < count && code == SQLITE_OK; i++) {
		writes[i].revision.time = time;
		writes[i].result = ERR_OK;
		code = write_one(s, writes + i);
		last = (sqlite3_int64)writes[i].revision.seq.major;
	}
	return end(s, code, last);
}

static enum err commit(struct backing *b, struct backing_write *writes,
    size_t count)
{
	struct backing_sqlite *s = self(b);
	enum err err;

	pthread_mutex_lock(&s->using);
	err = commit_all(s, writes, count);
	pthread_mutex_unlock(&s->using);
	return err;
}

/* ---- reading ---- */

/* A text that is not what was kept is damage that SQLite does not see. */
static bool is_what_it_was(const struct backing_revision *r)
{
	char etag[ETAG_SIZE];

	etag_of(r->text, r->length, etag);
	return strcmp(etag, r->etag) == 0;
}

static enum err refuse(const struct backing_sqlite *s, const char *what,
    const char *id)
{
	log_write(LOG_ERROR, "%s: is damaged: %s '%s' is not what was kept. It "
	    "has been left as it is. Put a copy from before in its place (with "
	    "its -wal and -shm files removed), or name another folder by "
	    "--data", s->file.path, what, id);
	return ERR_INVALID;
}

/* The row of: id, owner, seq, etag, time, nodes, text or NULL, length */
static struct backing_revision row_of(sqlite3_stmt *q)
{
	const void *text = sqlite3_column_blob(q, 6);

	return (struct backing_revision){
		.id = (const char *)sqlite3_column_text(q, 0),
		.owner = (const char *)sqlite3_column_text(q, 1),
		.seq = {(uint64_t)sqlite3_column_int64(q, 2), 0},
		.etag = (const char *)sqlite3_column_text(q, 3),
		.time = sqlite3_column_double(q, 4),
		.nodes = (size_t)sqlite3_column_int64(q, 5),
		.text = text != NULL ? text : "",
		.length = (size_t)sqlite3_column_int64(q, 7),
		.is_past = sqlite3_column_type(q, 6) == SQLITE_NULL,
	};
}

static enum err load_revision(struct backing_sqlite *s, sqlite3_stmt *q,
    const struct backing_reader *reader)
{
	struct backing_revision r = row_of(q);

	if (r.id == NULL)
		return ERR_MEMORY;
	/* A scene without a revision, or with another text. */
	if (sqlite3_column_type(q, 2) == SQLITE_NULL ||
	    (!r.is_past && r.etag != NULL && !is_what_it_was(&r)))
		return refuse(s, "scene", r.id);
	if (r.owner == NULL || r.etag == NULL)
		return ERR_MEMORY;
	return reader->revision(reader->ctx, &r);
}

/* What a failing step of db comes to. */
static enum err read_failure_of(const struct backing_sqlite *s, sqlite3 *db,
    int code)
{
	if (code == SQLITE_DONE || code == SQLITE_OK)
		return ERR_OK;
	if (code == SQLITE_NOMEM)
		return ERR_MEMORY;
	log_write(LOG_ERROR, "%s: cannot be read: %s", s->file.path,
	    sqlite3_errmsg(db));
	return (code & 0xff) == SQLITE_CORRUPT ? ERR_INVALID :
	    ERR_UNAVAILABLE;
}

static enum err read_failure(struct backing_sqlite *s, int code)
{
	return read_failure_of(s, s->file.db, code);
}

/* Texts of the newest of each scene only. */
static enum err load_revisions(struct backing_sqlite *s,
    const struct backing_reader *reader)
{
	sqlite3_stmt *q;
	enum err err = ERR_OK;
	int code = sqlite3_prepare_v2(s->file.db, "SELECT s.id, s.owner, "
	    "r.seq, r.etag, r.time, r.nodes, CASE WHEN r.seq = (SELECT max(seq)"
	    " FROM revision WHERE scene = s.id) THEN r.text END, "
	    "length(r.text) FROM scene s LEFT JOIN revision r "
	    "ON r.scene = s.id ORDER BY s.id, r.seq", -1, &q, NULL);

	if (code != SQLITE_OK)
		return read_failure(s, code);
	while (err == ERR_OK && (code = sqlite3_step(q)) == SQLITE_ROW)
		err = load_revision(s, q, reader);
	if (err == ERR_OK)
		err = read_failure(s, code);
	sqlite3_finalize(q);
	return err;
}

/* Revisions are not there without their scenes. */
static enum err check_scenes(struct backing_sqlite *s)
{
	sqlite3_stmt *q;
	enum err err;
	int code = sqlite3_prepare_v2(s->file.db, "SELECT scene FROM revision "
	    "WHERE scene NOT IN (SELECT id FROM scene) LIMIT 1", -1, &q,
	    NULL);

	if (code != SQLITE_OK)
		return read_failure(s, code);
	code = sqlite3_step(q);
	err = code == SQLITE_ROW ? refuse(s, "scene",
	    (const char *)sqlite3_column_text(q, 0)) : read_failure(s, code);
	sqlite3_finalize(q);
	return err;
}

/* The pieces of volume id, length bytes, one after another. */
static enum err read_pieces(struct backing_sqlite *s, const char *id,
    char *data, size_t length)
{
	size_t at = 0;
	sqlite3_stmt *q;
	int code = sqlite3_prepare_v2(s->file.db, "SELECT data FROM "
	    "volume_piece WHERE volume = ?1 ORDER BY number", -1, &q, NULL);

	if (code != SQLITE_OK)
		return read_failure(s, code);
	bind_text(q, 1, id);
	while ((code = sqlite3_step(q)) == SQLITE_ROW) {
		const void *piece = sqlite3_column_blob(q, 0);
		size_t size = (size_t)sqlite3_column_bytes(q, 0);

		if (size > length - at || piece == NULL)
			break;
		memcpy(data + at, piece, size);
		at += size;
	}
	sqlite3_finalize(q);
	if (code == SQLITE_ROW || (code == SQLITE_DONE && at != length))
		return refuse(s, "volume", id);
	return read_failure(s, code);
}

static enum err load_volume(struct backing_sqlite *s, sqlite3_stmt *q,
    const struct backing_reader *reader)
{
	struct backing_volume v = {
		.id = (const char *)sqlite3_column_text(q, 0),
		.length = (size_t)sqlite3_column_int64(q, 1),
		.is_forgotten = sqlite3_column_int(q, 2) != 0,
		.owner = (const char *)sqlite3_column_text(q, 4),
	};
	bool is_refused;
	char *data;
	enum err err;

	if (v.id != NULL && sqlite3_column_int64(q, 1) !=
	    sqlite3_column_int64(q, 3))
		return refuse(s, "volume", v.id);
	data = malloc(v.length + 1);
	if (v.id == NULL || v.owner == NULL || data == NULL) {
		free(data);
		return ERR_MEMORY;
	}
	err = read_pieces(s, v.id, data, v.length);
	is_refused = err != ERR_OK;
	v.data = data;
	if (err == ERR_OK)
		err = reader->volume(reader->ctx, &v);
	free(data);
	return err == ERR_INVALID && !is_refused ? refuse(s, "volume", v.id) :
	    err;
}

static enum err load_volumes(struct backing_sqlite *s,
    const struct backing_reader *reader)
{
	sqlite3_stmt *q;
	enum err err = ERR_OK;
	int code = sqlite3_prepare_v2(s->file.db,
	    "SELECT id, length, is_forgotten, (SELECT coalesce(sum(length("
	    "data)), 0) FROM volume_piece WHERE volume = id), owner FROM "
	    "volume", -1,
	    &q, NULL);

	if (code != SQLITE_OK)
		return read_failure(s, code);
	while (err == ERR_OK && (code = sqlite3_step(q)) == SQLITE_ROW)
		err = load_volume(s, q, reader);
	if (err == ERR_OK)
		err = read_failure(s, code);
	sqlite3_finalize(q);
	return err;
}

static enum err load(struct backing *b, const struct backing_reader *reader)
{
	struct backing_sqlite *s = self(b);
	enum err err;

	pthread_mutex_lock(&s->using);
	err = be_open(s);
	if (err == ERR_OK)
		err = load_volumes(s, reader);
	if (err == ERR_OK)
		err = check_scenes(s);
	if (err == ERR_OK)
		err = load_revisions(s, reader);
	if (err == ERR_OK)
		trim_all(s);
	pthread_mutex_unlock(&s->using);
	return err;
}

/* ---- older revisions, on the reader's thread ---- */

/* The connection to read by, s->reading held; ERR_UNAVAILABLE: none. */
static enum err be_readable(struct backing_sqlite *s, sqlite3 **out)
{
	const bool is_in_memory = s->file.folder[0] == '\0';
	int code = SQLITE_OK;

	*out = NULL;
	if (s->is_gone)
		return ERR_UNAVAILABLE;
	if (!sqlite_file_is_in_place(&s->file)) {
		note_replaced(s);
		return ERR_UNAVAILABLE;
	}
	if (!is_in_memory && s->reader == NULL)
		code = sqlite_file_open_reader(&s->file, &s->reader);
	*out = is_in_memory ? s->file.db : s->reader;
	if (code == SQLITE_OK && s->read == NULL)
		code = sqlite3_prepare_v3(*out, read_sql, -1,
		    SQLITE_PREPARE_PERSISTENT, &s->read, NULL);
	return read_failure_of(s, *out, code);
}

/* What read's row has, its text copied: malloc'd, for free. */
static enum err copy_row(sqlite3_stmt *q, struct backing_revision *out,
    char **text)
{
	const void *data = sqlite3_column_blob(q, 3);

	out->seq.major = (uint64_t)sqlite3_column_int64(q, 0);
	out->time = sqlite3_column_double(q, 1);
	out->nodes = (size_t)sqlite3_column_int64(q, 2);
	out->length = (size_t)sqlite3_column_bytes(q, 3);
	*text = data != NULL ? malloc(out->length + 1) : NULL;
	if (*text == NULL)
		return ERR_MEMORY;
	memcpy(*text, data, out->length);
	out->text = *text;
	return ERR_OK;
}

/* Under both locks, or that of reading alone. Of a failure nothing is left that
 * the next one would trip over. */
static enum err read_row(struct backing_sqlite *s,
    struct backing_revision *out, char **text)
{
	sqlite3 *db;
	enum err err = be_readable(s, &db);
	int code;

	if (err != ERR_OK) {
		drop_reader(s);
		return err;
	}
	bind_text(s->read, 1, out->id);
	bind_text(s->read, 2, out->etag);
	code = sqlite3_step(s->read);
	if (code == SQLITE_ROW)
		err = copy_row(s->read, out, text);
	else
		err = code == SQLITE_DONE ? ERR_NOT_FOUND :
		    read_failure_of(s, db, code);
	sqlite3_reset(s->read);
	sqlite3_clear_bindings(s->read);
	if (code != SQLITE_ROW && code != SQLITE_DONE)
		drop_reader(s);
	return err;
}

static enum err read_one(struct backing *b, const char *id, const char *etag,
    const struct backing_reader *reader)
{
	struct backing_sqlite *s = self(b);
	struct backing_revision r = {.id = id, .etag = etag, .owner = ""};
	const bool is_in_memory = s->file.folder[0] == '\0';
	char *text = NULL;
	enum err err;

	/* In the order in which reopen takes them. */
	if (is_in_memory)
		pthread_mutex_lock(&s->using);
	pthread_mutex_lock(&s->reading);
	err = read_row(s, &r, &text);
	pthread_mutex_unlock(&s->reading);
	if (is_in_memory)
		pthread_mutex_unlock(&s->using);
	if (err == ERR_OK)
		err = is_what_it_was(&r) ? reader->revision(reader->ctx, &r) :
		    refuse(s, "a revision of scene", id);
	free(text);
	return err;
}

/* ---- volumes ---- */

static int put_piece(struct backing_sqlite *s, const struct backing_volume *v,
    size_t at)
{
	sqlite3_stmt *q = query(s, PUT_PIECE);
	size_t size = v->length - at < PIECE ? v->length - at : PIECE;

	if (q != NULL) {
		bind_text(q, 1, v->id);
		sqlite3_bind_int64(q, 2, (sqlite3_int64)(at / PIECE));
		sqlite3_bind_blob64(q, 3, (const char *)v->data + at, size,
		    SQLITE_STATIC);
	}
	return finish(s, q);
}

static sqlite3_stmt *query_for(struct backing_sqlite *s, enum query which,
    const struct backing_volume *v)
{
	sqlite3_stmt *q = query(s, which);

	if (q != NULL) {
		bind_text(q, 1, v->id);
		sqlite3_bind_int64(q, 2, (sqlite3_int64)v->length);
		sqlite3_bind_int(q, 3, v->is_forgotten);
		bind_text(q, 4, v->owner != NULL ? v->owner : "");
	}
	return q;
}

static void note_kept_owner(const struct backing_volume *v, const char *owner)
{
	if (v->kept_owner != NULL)
		snprintf(v->kept_owner, TOKEN_NAME_MAX + 1, "%s",
		    owner != NULL ? owner : "");
}

/* One that is there is v's, or stays whose it was. */
static int mark_volume(struct backing_sqlite *s,
    const struct backing_volume *v, bool *there)
{
	sqlite3_stmt *q = query_for(s, MARK_VOLUME, v);
	int code;

	if (q == NULL)
		return sqlite3_errcode(s->file.db);
	code = sqlite3_step(q);
	*there = code == SQLITE_ROW;
	note_kept_owner(v, *there ? (const char *)sqlite3_column_text(q, 0) :
	    v->owner);
	sqlite3_reset(q);
	sqlite3_clear_bindings(q);
	return code == SQLITE_ROW || code == SQLITE_DONE ? SQLITE_OK : code;
}

/* One that is there is not written again: its id is that of its content. */
static int put_pieces(struct backing_sqlite *s,
    const struct backing_volume *v)
{
	bool there = false;
	int code = mark_volume(s, v, &there);

	if (code != SQLITE_OK || there)
		return code;
	code = finish(s, query_for(s, PUT_VOLUME, v));
	for (size_t at = 0; at < v->length && code == SQLITE_OK; at += PIECE)
		code = put_piece(s, v, at);
	return code;
}

/* Cuts the log, unless somebody reads the file: then it is cut later. */
static void cut_log(struct backing_sqlite *s)
{
	sqlite3_busy_timeout(s->file.db, 0);
	sqlite_file_run(&s->file, "PRAGMA wal_checkpoint(TRUNCATE)");
	sqlite3_busy_timeout(s->file.db, SQLITE_FILE_BUSY_MS);
}

/* A change of a volume has no seq by which to see whether it was kept; but to make
 * it once more does no harm. */
static bool is_to_be_repeated(const struct backing_sqlite *s, enum err err)
{
	return err == ERR_UNAVAILABLE && s->is_in_doubt && !s->is_closed;
}

static enum err try_put_volume(struct backing_sqlite *s,
    const struct backing_volume *v)
{
	int code = begin(s);

	if (code == SQLITE_OK)
		code = put_pieces(s, v);
	return end(s, code, s->last);
}

static enum err put_volume(struct backing *b, const struct backing_volume *v)
{
	struct backing_sqlite *s = self(b);
	enum err err;

	pthread_mutex_lock(&s->using);
	err = be_open(s);
	if (err == ERR_OK) {
		err = try_put_volume(s, v);
		if (is_to_be_repeated(s, err))
			err = try_put_volume(s, v);
	}
	/* The log is not to keep the volume's length until the next one. */
	if (err == ERR_OK && v->length > PIECE)
		cut_log(s);
	pthread_mutex_unlock(&s->using);
	return err;
}

static enum err try_run_on(struct backing_sqlite *s, enum query which,
    const char *id)
{
	int code = begin(s);

	if (code == SQLITE_OK)
		code = run_on(s, which, id);
	return end(s, code, s->last);
}

static enum err forget_volume(struct backing *b, const char *id, bool is_gone)
{
	const enum query which = is_gone ? DELETE_VOLUME : FORGET_VOLUME;
	struct backing_sqlite *s = self(b);
	enum err err;

	pthread_mutex_lock(&s->using);
	err = be_open(s);
	if (err == ERR_OK) {
		err = try_run_on(s, which, id);
		if (is_to_be_repeated(s, err))
			err = try_run_on(s, which, id);
	}
	pthread_mutex_unlock(&s->using);
	return err;
}

/* ---- life ---- */

static bool is_well(struct backing *b)
{
	return atomic_load(&self(b)->is_well);
}

static void close_it(struct backing *b)
{
	struct backing_sqlite *s = self(b);

	/* The last to close the file cuts its log: that can write. */
	drop_reader(s);
	drop_queries(s);
	sqlite_file_close(&s->file);
	pthread_mutex_destroy(&s->using);
	pthread_mutex_destroy(&s->reading);
	free(s);
}

static const struct backing_ops ops = {
	.load = load,
	.commit = commit,
	.read = read_one,
	.put_volume = put_volume,
	.forget_volume = forget_volume,
	.is_well = is_well,
	.free = close_it,
};

enum err backing_open_sqlite(const char *folder,
    const struct backing_options *options, struct backing **out)
{
	struct backing_sqlite *s = calloc(1, sizeof *s);
	enum err err;
	int code;

	if (s == NULL)
		return ERR_MEMORY;
	s->base.ops = &ops;
	s->options = *options;
	if (s->options.history > INT_MAX)
		s->options.history = INT_MAX; /* and no negative number */
	pthread_mutex_init(&s->using, NULL);
	pthread_mutex_init(&s->reading, NULL);
	atomic_init(&s->is_well, true);
	err = sqlite_file_open(folder, &s->file);
	if (err == ERR_OK) {
		code = last_seq(s, &s->last);
		err = code == SQLITE_OK ? ERR_OK : read_failure(s, code);
	}
	if (err != ERR_OK) {
		close_it(&s->base);
		return err;
	}
	*out = &s->base;
	return ERR_OK;
}
