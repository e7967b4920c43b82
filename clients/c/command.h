/*
 * The blobfield command: what its files share. Each subcommand is a function
 * that returns the exit status.
 */
#ifndef CLIENTS_C_COMMAND_H
#define CLIENTS_C_COMMAND_H

#include <stdbool.h>
#include <stddef.h>
#include <stdio.h>

#include "clients/c/blobfield.h"
#include "clients/c/options.h"

/* Exit statuses. */
enum {
	COMMAND_DONE = 0,
	COMMAND_REFUSED = 1,     /* the daemon has: a document, an argument */
	COMMAND_USAGE = 2,
	COMMAND_UNREACHABLE = 3, /* no daemon, or the connection was cut */
	COMMAND_FILE = 4,        /* a file cannot be read, understood, written */
	COMMAND_INTERRUPTED = 130
};

/* What all subcommands have. */
struct session {
	struct blobfield *client;
	const char *name;      /* of the subcommand */
	bool quiet, progress;

	/* The document that was sent, for errors to be found in it. */
	const char *source;    /* its file's name; NULL: there is none */
	struct blobfield_bytes text;

	char id[BLOBFIELD_ID_MAX]; /* the scene */
	bool is_temporary;     /* the scene is to be forgotten */
};

struct command {
	const char *name, *arguments, *summary;
	const char *about;     /* paragraphs of its help */
	/* Reads its options and runs; session->client is made by
	 * command_start. */
	int (*run)(struct session *s, const struct command *self, int argc,
	    char **argv);
};

/* Text to stderr, behind "blobfield NAME: ", unless s is NULL. */
void command_say(const struct session *s, const char *text, ...)
    __attribute__((format(printf, 2, 3)));

/*
 * Reads the common options and those of rules (up to a rule without a name),
 * and makes the client. argv is left with the other arguments, of which there
 * must be least to most; *count is how many. Prints the help or what is wrong,
 * and returns false with *status, where that is all.
 */
bool command_start(struct session *s, const struct command *self,
    const struct options_rule *rules, int argc, char **argv, int least,
    int most, int *count, int *status);

/* Says what the last call came to, with places in the document if it has
 * sent that; the exit status. */
int command_fail(struct session *s, bool sent_document);

/* Whether text is what ids are made of; says if not. */
bool command_is_id(const struct session *s, const char *text);

/* ---- command_file.c ---- */

/* A whole file, "-": stdin. false: said why. The caller frees out. */
bool command_read(const struct session *s, const char *path,
    struct blobfield_bytes *out);

/* NULL or "-": stdout. The file is replaced only once all is written. */
bool command_write(const struct session *s, const char *path,
    const void *data, size_t size);

/* Whether path ends so, in letters of any case; extension has its dot. */
bool command_has_extension(const char *path, const char *extension);

/* ---- command_scene.c ---- */

/*
 * Makes s->id the scene that argument means: a document in a file, or "-" on
 * stdin, which is kept for the time of the command, or else the id of a kept
 * one. Returns the exit status, 0 if all is well.
 */
int command_open_scene(struct session *s, const char *argument);

/* Forgets what command_open_scene has kept. */
void command_close_scene(struct session *s);

/* ---- command_rows.c ---- */

/* A table of float32. Start with {0}. */
struct rows {
	float *data;
	size_t count, columns;
	const int *counts; /* 3: the rows are those of a grid; NULL: a list */
};

void rows_fini(struct rows *rows);

/* Numbers, separated by commas, of one more row. false: they are not columns
 * of them, or no memory. */
bool rows_add(struct rows *rows, const char *text);

/*
 * Adds those of a file, "-": stdin: npy of shape (N, columns), raw float32
 * (.f32), or text, a row a line, numbers separated by commas, semicolons, or
 * blanks; '#' begins a comment, a first line of words is passed over. false:
 * said why.
 */
bool rows_read(const struct session *s, struct rows *rows, const char *path);

/*
 * Writes a and b side by side, by path's extension: .csv, which stdout gets,
 * .json, or without a: .npy (of a grid's shape, if b is one), .f32. names: of all columns, separated by commas.
 */
bool rows_write(const struct session *s, const char *path,
    const struct rows *a, const struct rows *b, const char *names);

/* ---- command_place.c ---- */

/*
 * Where in text what pointer points to begins, or, where there is no such
 * thing, the nearest that it is in: line and column from 1. false: text is no
 * JSON as far as that.
 */
bool place_find(const char *text, size_t size, const char *pointer,
    size_t *line, size_t *column);

/* ---- command_progress.c ---- */

/* Has a bar drawn on stderr while the client waits, if that is a terminal or
 * the user wants one, and erased by progress_end. */
void progress_begin(struct session *s);
void progress_end(struct session *s);

/* For work of several calls: how much of it is behind the present one, and up
 * to where that goes, 0 to 1. */
void progress_part(double from, double to);

/* ---- subcommands ---- */

int command_eval(struct session *s, const struct command *self, int argc,
    char **argv);
int command_grid(struct session *s, const struct command *self, int argc,
    char **argv);
int command_raycast(struct session *s, const struct command *self, int argc,
    char **argv);
int command_project(struct session *s, const struct command *self, int argc,
    char **argv);
int command_mesh(struct session *s, const struct command *self, int argc,
    char **argv);
int command_render(struct session *s, const struct command *self, int argc,
    char **argv);
int command_slice(struct session *s, const struct command *self, int argc,
    char **argv);
int command_put(struct session *s, const struct command *self, int argc,
    char **argv);
int command_get(struct session *s, const struct command *self, int argc,
    char **argv);
int command_scenes(struct session *s, const struct command *self, int argc,
    char **argv);
int command_delete(struct session *s, const struct command *self, int argc,
    char **argv);
int command_bounds(struct session *s, const struct command *self, int argc,
    char **argv);
int command_info(struct session *s, const struct command *self, int argc,
    char **argv);
int command_patch(struct session *s, const struct command *self, int argc,
    char **argv);
int command_revisions(struct session *s, const struct command *self, int argc,
    char **argv);
int command_events(struct session *s, const struct command *self, int argc,
    char **argv);
int command_watch(struct session *s, const struct command *self, int argc,
    char **argv);

#endif
