/*
 * What the parts of the configuration share: the table of options, values from
 * and to text, and where each has come from.
 */
#ifndef SERVER_CONFIG_INTERNAL_H
#define SERVER_CONFIG_INTERNAL_H

#include <stdbool.h>
#include <stddef.h>

#include "server/config.h"

/* Room for a value's text, of any kind, and what is wrong with one. */
#define CONFIG_VALUE_MAX (CONFIG_ORIGINS_MAX + 512)
#define CONFIG_WHY_MAX 160

enum config_kind {
	CONFIG_LISTEN, /* char [], host and port */
	CONFIG_BYTES,  /* size_t, printed with k, M or G */
	CONFIG_NUMBER, /* size_t */
	CONFIG_WIDTH,  /* int: a power of two; 0: not set */
	CONFIG_TEXT,   /* char []; "": not set */
	CONFIG_URL,    /* the same; a password in it is not printed */
	CONFIG_CHOICE, /* enum: an index of names */
	CONFIG_SWITCH, /* bool; `yes` says what "yes" sets it to */
	CONFIG_PRESET, /* "yes" sets the option of the same offset to preset,
	                * "no" to its default */
	CONFIG_DEED,   /* bool; a flag only: something to do instead */
	CONFIG_TOKEN,  /* NAME:ROLE; a flag only */
	CONFIG_PATH    /* --config; a flag, or BLOBFIELDD_CONFIG */
};

struct config_option {
	const char *name;
	const char *argument; /* what stands for it in the help; NULL: none */
	enum config_kind kind;
	size_t offset, size;  /* in struct config */
	size_t least, most;   /* of numbers; most 0: any */
	const char *const *names; /* of choices, NULL at the end */
	const char *preset;
	bool yes;
	const char *help;
};

/* NULL-named at the end. */
extern const struct config_option config_options[];

#define CONFIG_OPTIONS_MAX 64

/* Whether files and the environment may have it. */
bool config_option_is_kept(const struct config_option *option);

/* The option of that name, of so many characters, or NULL. */
const struct config_option *config_option_find(const char *name,
    size_t length);

/* The option whose name is most like name, or NULL. */
const struct config_option *config_option_like(const char *name);

/* Later ones beat earlier ones. */
enum config_rank {
	CONFIG_OF_DEFAULT,
	CONFIG_OF_FILE,
	CONFIG_OF_ENVIRONMENT,
	CONFIG_OF_FLAG
};

struct config_origin {
	enum config_rank rank;
	int line;                           /* of the file */
	const struct config_option *option; /* as which it was given */
};

/* While it is put together. */
struct config_reading {
	struct config *config;
	struct config defaults;
	const char *path; /* of the file, or NULL */
	struct config_origin origins[CONFIG_OPTIONS_MAX]; /* by option */
};

/* Where option's value has come from; those of one offset share it. */
struct config_origin *config_origin_of(struct config_reading *reading,
    const struct config_option *option);

/*
 * Sets option to what value says, unless something of a higher rank has.
 * False: it is wrong; why then has what it must be.
 */
bool config_set(struct config_reading *reading, struct config_origin origin,
    const char *value, char why[static CONFIG_WHY_MAX]);

/* Reads all of the file at reading->path. False: it is wrong, and said. */
bool config_file_read(struct config_reading *reading);

/* "yes" or "no"; true, false, on, off, 1 and 0 will do. */
bool config_value_is(const char *text, bool *out);

/* text to option's place in *config; not for CONFIG_PRESET. False with why. */
bool config_value_read(const struct config_option *option, const char *text,
    struct config *config, char why[static CONFIG_WHY_MAX]);

/* The reverse. False: it is not set, and text is "". */
bool config_value_print(const struct config_option *option,
    const struct config *config, char text[static CONFIG_VALUE_MAX]);

/* Whether url has a password; text gets it without. */
bool config_value_hide(const char *url, char text[static CONFIG_VALUE_MAX]);

/* Reads all BLOBFIELDD_ variables. False: one is wrong, and said. */
bool config_environment_read(struct config_reading *reading);

/* Logs what names there are that no option has. No error: an orchestrator may
 * set some for a service of our name. */
void config_environment_warn(void);

/* The environment's name of option. */
void config_variable(const struct config_option *option,
    char name[static CONFIG_NAME_MAX]);

/* Prints all of it to stdout, as a file. */
void config_print(struct config_reading *reading);

#endif
