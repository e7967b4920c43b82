#include "server/config.h"

#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "server/config_internal.h"
#include "server/log.h"

/* ---- one value ---- */

struct config_origin *config_origin_of(struct config_reading *reading,
    const struct config_option *option)
{
	const struct config_option *o;

	for (o = config_options; o->size == 0 || o->offset != option->offset;)
		o++;
	return &reading->origins[o - config_options];
}

/* yes: what it stands for; no: what there would be without. */
static bool set_preset(struct config_reading *reading,
    const struct config_option *option, const char *value, char *why)
{
	const struct config_option *of = &config_options[
	    config_origin_of(reading, option) - reading->origins];
	char *place = (char *)reading->config + option->offset;
	bool is;

	strcpy(why, "yes or no");
	if (!config_value_is(value, &is))
		return false;
	if (is && option->preset[0] != '\0')
		return config_value_read(of, option->preset, reading->config,
		    why);
	if (is)
		place[0] = '\0';
	else
		memmove(place, (char *)&reading->defaults + option->offset,
		    option->size);
	return true;
}

bool config_set(struct config_reading *reading, struct config_origin origin,
    const char *value, char why[static CONFIG_WHY_MAX])
{
	const struct config_option *option = origin.option;
	struct config_reading checked;
	struct config_origin *now;

	if (!config_option_is_kept(option))
		return config_value_read(option, value, reading->config, why);
	now = config_origin_of(reading, option);
	if (now->rank > origin.rank) {
		/* Wrong is wrong, also where it does not count. */
		checked = *reading;
		checked.config = &checked.defaults;
		reading = &checked;
	} else {
		*now = origin;
	}
	return option->kind == CONFIG_PRESET ?
	    set_preset(reading, option, value, why) :
	    config_value_read(option, value, reading->config, why);
}

/* ---- defaults ---- */

/* The first folder of a list by colons; false if it is not absolute. */
static bool default_of_manager(const char *variable, char *out, size_t size)
{
	const char *folders = getenv(variable);
	int length;

	if (folders == NULL || folders[0] != '/')
		return false;
	length = snprintf(out, size, "%.*s", (int)strcspn(folders, ":"),
	    folders);
	return length < (int)size;
}

/*
 * The XDG Base Directory Specification's: the variable counts if it is
 * absolute; else it is below the home. False: there is none.
 */
static bool default_of_user(const char *variable, const char *below, char *out,
    size_t size)
{
	const char *folder = getenv(variable), *home = getenv("HOME");
	int length = (int)size;

	if (folder != NULL && folder[0] == '/')
		length = snprintf(out, size, "%s/blobfield", folder);
	else if (home != NULL && home[0] == '/')
		length = snprintf(out, size, "%s/%s/blobfield", home, below);
	return length < (int)size;
}

/* Without a home there is no cache, and nothing is kept. */
static void set_default_folders(struct config *config)
{
	if (!default_of_manager("CACHE_DIRECTORY", config->cache,
	    sizeof config->cache) &&
	    !default_of_user("XDG_CACHE_HOME", ".cache", config->cache,
	    sizeof config->cache))
		config->cache[0] = '\0';
	if (!default_of_manager("STATE_DIRECTORY", config->data,
	    sizeof config->data) &&
	    !default_of_user("XDG_DATA_HOME", ".local/share", config->data,
	    sizeof config->data))
		strcpy(config->data, ":memory:");
}

static void set_defaults(struct config *config)
{
	*config = (struct config){
		.host = "127.0.0.1",
		.port = "7878",
		.max_body = (size_t)128 << 20,
		.max_points = 8000000,
		.max_nodes = 32768,
		.max_scenes = 1024,
		.scene_memory = (size_t)1 << 30,
		.queue = 256,
		.tasks = 2,
		.history = 16,
		.history_bytes = (size_t)64 << 20,
		.max_listeners = 1024,
		.max_connections = 4096,
		.max_connections_per_address = 1024,
		.request_time = 60,
		.work_time = 300,
		.drain_time = 60,
		.layout = LAYOUT_WARPED,
		.measure = true,
		.log_level = LOG_INFO,
		.cache_size = (size_t)1 << 30,
		.device.table_bytes = (size_t)256 << 20,
		.device.volume_bytes = (size_t)256 << 20,
	};
	set_default_folders(config);
}

/* ---- flags ---- */

static void print_pair(const char *left, const char *help)
{
	/* What is longer than its column has a line of its own. */
	if (strlen(left) > 24)
		printf("  %s\n  %-24s %s\n", left, "", help);
	else
		printf("  %-24s %s\n", left, help);
}

static void print_help(void)
{
	const struct config_option *o;

	printf("Usage: blobfieldd [option]...\n\n"
	    "Evaluates Blob-tree documents on an OpenCL device, over HTTP.\n\n");
	for (o = config_options; o->name != NULL; o++) {
		char left[64];

		snprintf(left, sizeof left, "--%s%s%s", o->name,
		    o->argument ? " " : "", o->argument ? o->argument : "");
		print_pair(left, o->help);
	}
	print_pair("--version", "print the version");
	print_pair("--help", "print this");
	printf("\nEach is also a variable, such as BLOBFIELDD_MAX_BODY=64M, and "
	    "a line of\n--config's file, such as max-body = 64M. Flags come "
	    "before variables,\nvariables before the file.\n");
}

static bool complain(const char *argument, const char *what, const char *why)
{
	fprintf(stderr, "blobfieldd: %s: %s%s\n"
	    "Try 'blobfieldd --help'.\n", argument, what, why);
	return false;
}

static bool complain_of_flag(const char *argument)
{
	const struct config_option *like = NULL;
	char name[CONFIG_NAME_MAX];

	if (strncmp(argument, "--", 2) == 0) {
		snprintf(name, sizeof name, "%.*s",
		    (int)strcspn(argument + 2, "="), argument + 2);
		like = config_option_like(name);
	}
	if (like == NULL)
		return complain(argument, "unknown option", "");
	fprintf(stderr, "blobfieldd: %s: unknown option; did you mean --%s?\n",
	    argument, like->name);
	return false;
}

static bool complain_of_value(const struct config_option *option,
    const char *value, const char *why)
{
	fprintf(stderr, "blobfieldd: --%s: must be %s, not '%.64s'\n"
	    "Try 'blobfieldd --help'.\n", option->name, why, value);
	return false;
}

static bool set_flag(struct config_reading *reading,
    const struct config_option *option, const char *value)
{
	struct config_origin origin = {CONFIG_OF_FLAG, 0, option};
	char why[CONFIG_WHY_MAX];

	if (option->kind == CONFIG_PATH)
		reading->path = value;
	else if (!config_set(reading, origin, value, why))
		return complain_of_value(option, value, why);
	return true;
}

/* Reads the option at argv[*i], and moves *i past it. */
static bool read_flag(struct config_reading *reading, int argc, char **argv,
    int *i)
{
	const char *argument = argv[(*i)++];
	const struct config_option *option = NULL;
	const char *value = strchr(argument, '=');

	if (strncmp(argument, "--", 2) == 0)
		option = config_option_find(argument + 2,
		    strcspn(argument + 2, "="));
	if (option == NULL)
		return complain_of_flag(argument);
	if (value != NULL)
		return set_flag(reading, option, value + 1);
	if (option->argument == NULL)
		return set_flag(reading, option, "yes");
	if (*i >= argc)
		return complain(argument, "needs ", option->argument);
	return set_flag(reading, option, argv[(*i)++]);
}

static enum config_outcome read_flags(struct config_reading *reading, int argc,
    char **argv)
{
	for (int i = 1; i < argc;) {
		if (strcmp(argv[i], "--help") == 0) {
			print_help();
			return CONFIG_DONE;
		}
		if (strcmp(argv[i], "--version") == 0) {
			printf("blobfieldd %s\n", BLOBFIELD_VERSION);
			return CONFIG_DONE;
		}
		if (!read_flag(reading, argc, argv, &i))
			return CONFIG_BAD;
	}
	return CONFIG_RUN;
}

/* ---- all of it ---- */

/* What is set and does not count. */
static void warn_of_idle(struct config_reading *reading)
{
	const struct config_option *data = config_option_find("data", 4);

	if (reading->config->store[0] != '\0' &&
	    config_origin_of(reading, data)->rank != CONFIG_OF_DEFAULT)
		log_write(LOG_WARNING, "data = %s is not used: there is a "
		    "store", reading->config->data);
}

static bool is_consistent(const struct config *config)
{
	bool has_cert = config->tls_cert[0] != '\0';

	if (has_cert != (config->tls_key[0] != '\0')) {
		fprintf(stderr, "blobfieldd: %s is set, and %s is not: HTTPS "
		    "needs both\n", has_cert ? "tls-cert" : "tls-key",
		    has_cert ? "tls-key" : "tls-cert");
		return false;
	}
	return true;
}

static enum config_outcome read_all(struct config_reading *reading, int argc,
    char **argv)
{
	enum config_outcome outcome = read_flags(reading, argc, argv);

	if (outcome != CONFIG_RUN)
		return outcome;
	if (!config_environment_read(reading))
		return CONFIG_BAD;
	if (reading->path != NULL && !config_file_read(reading))
		return CONFIG_BAD;
	return is_consistent(reading->config) ? CONFIG_RUN : CONFIG_BAD;
}

enum config_outcome config_parse(int argc, char **argv, struct config *out)
{
	struct config_reading reading = {.config = out};
	enum config_outcome outcome;

	set_defaults(&reading.defaults);
	*out = reading.defaults;
	outcome = read_all(&reading, argc, argv);
	if (outcome != CONFIG_RUN)
		return outcome;
	out->device.select = out->device_name[0] != '\0' ? out->device_name :
	    NULL;
	log_set_level(out->log_level);
	log_set_format(out->log_format);
	config_environment_warn();
	if (out->print_config) {
		config_print(&reading);
		return CONFIG_DONE;
	}
	warn_of_idle(&reading);
	return CONFIG_RUN;
}
