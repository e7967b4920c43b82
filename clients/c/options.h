/*
 * Options of a command line, by a table: "--name value", "--name=value",
 * "-n value", "-nvalue"; "--" ends them.
 */
#ifndef CLIENTS_C_OPTIONS_H
#define CLIENTS_C_OPTIONS_H

#include <stdbool.h>
#include <stddef.h>
#include <stdio.h>

#define OPTIONS_LIST_MAX 64

enum options_kind {
	OPTIONS_FLAG,   /* out: bool, set to true */
	OPTIONS_TEXT,   /* const char * */
	OPTIONS_WHOLE,  /* int, above 0 */
	OPTIONS_NUMBER, /* double, finite */
	OPTIONS_VECTOR, /* struct options_vector: x,y,z */
	OPTIONS_LIST    /* struct options_list: may come several times */
};

struct options_vector {
	bool is_there;
	double v[3];
};

struct options_list {
	size_t count;
	const char *texts[OPTIONS_LIST_MAX];
};

struct options_rule {
	const char *name;     /* without its dashes; NULL ends a table */
	char letter;          /* 0: none */
	enum options_kind kind;
	void *out;
	const char *argument; /* for the help; NULL for flags */
	const char *help;
};

/*
 * Reads the options in argv, which *count arguments are left in, in their
 * order. Tables: two, of which the second may be NULL. false: message, cut to
 * size, says what is wrong.
 */
bool options_read(const struct options_rule *rules,
    const struct options_rule *more, int argc, char **argv, int *count,
    char *message, size_t size);

/* A line or more for each rule. */
void options_help(FILE *out, const struct options_rule *rules);

/* x,y,z; false: it is not that. */
bool options_vector(const char *text, double out[static 3]);

#endif
