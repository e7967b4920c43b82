#include "server/config.h"

#include <assert.h>
#include <ctype.h>
#include <errno.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "core/table.h"
#include "kernels/cache_file.h"

struct option {
	const char *name;
	const char *argument; /* what stands for it in the help; NULL: none */
	/* Reads value into *config; false, with a reason in *why, if it cannot. */
	bool (*read)(const char *value, struct config *config,
	    const char **why);
	const char *help;
};

/* "64M" to bytes: a whole number with an optional k, M or G. */
static bool read_size(const char *text, size_t *out, const char **why)
{
	static const char suffixes[] = "kMG";
	unsigned long long n;
	unsigned shift = 0;
	char *end;

	*why = "a whole number above 0, with k, M or G after it if you like";
	if (!isdigit((unsigned char)text[0]))
		return false;
	errno = 0;
	n = strtoull(text, &end, 10);
	if (*end != '\0') {
		const char *at = strchr(suffixes, *end == 'K' ? 'k' : *end);

		if (at == NULL || end[1] != '\0')
			return false;
		shift = 10 * (unsigned)(at - suffixes + 1);
	}
	if (errno != 0 || n == 0 || n > (SIZE_MAX >> 1) >> shift)
		return false;
	*out = (size_t)n << shift;
	return true;
}

static bool read_listen(const char *value, struct config *config,
    const char **why)
{
	const char *colon = strrchr(value, ':');
	const char *host = value;
	size_t length;
	char *end;

	*why = "HOST:PORT, such as 127.0.0.1:7878, [::1]:7878 or 127.0.0.1:0";
	if (colon == NULL || !isdigit((unsigned char)colon[1]))
		return false;
	length = (size_t)(colon - value);
	if (host[0] == '[' && length > 2 && host[length - 1] == ']') {
		host++;
		length -= 2;
	} else if (memchr(host, ':', length) != NULL) {
		return false;
	}
	if (length == 0 || length >= sizeof config->host)
		return false;
	if (strtoul(colon + 1, &end, 10) > 65535 || *end != '\0' ||
	    strlen(colon + 1) >= sizeof config->port)
		return false;
	memcpy(config->host, host, length);
	config->host[length] = '\0';
	strcpy(config->port, colon + 1);
	return true;
}

static bool read_max_body(const char *value, struct config *config,
    const char **why)
{
	return read_size(value, &config->max_body, why);
}

static bool read_max_points(const char *value, struct config *config,
    const char **why)
{
	return read_size(value, &config->max_points, why);
}

static bool read_max_nodes(const char *value, struct config *config,
    const char **why)
{
	return read_size(value, &config->max_nodes, why);
}

static bool read_max_scenes(const char *value, struct config *config,
    const char **why)
{
	return read_size(value, &config->max_scenes, why);
}

static bool read_scene_memory(const char *value, struct config *config,
    const char **why)
{
	return read_size(value, &config->scene_memory, why);
}

static bool read_queue(const char *value, struct config *config,
    const char **why)
{
	return read_size(value, &config->queue, why);
}

/* Each is a thread. */
#define TASKS_MOST 64

static bool read_tasks(const char *value, struct config *config,
    const char **why)
{
	size_t tasks;

	if (!read_size(value, &tasks, why) || tasks > TASKS_MOST) {
		*why = "a whole number from 1 to 64";
		return false;
	}
	config->tasks = tasks;
	return true;
}

static bool read_device(const char *value, struct config *config,
    const char **why)
{
	(void)why;
	config->device.select = value;
	return true;
}

static bool read_width(const char *value, struct config *config,
    const char **why)
{
	size_t width;

	if (!read_size(value, &width, why) || width > 16 ||
	    (width & (width - 1)) != 0) {
		*why = "1, 2, 4, 8 or 16";
		return false;
	}
	config->device.width = (int)width;
	return true;
}

/* The index of value in names, or -1. */
static int find_name(const char *value, const char *const *names, int count)
{
	for (int i = 0; i < count; i++) {
		if (strcmp(value, names[i]) == 0)
			return i;
	}
	return -1;
}

static bool read_tables(const char *value, struct config *config,
    const char **why)
{
	static const char *const names[] = {"auto", "buffer", "image"};
	int i = find_name(value, names, 3);

	*why = "auto, buffer or image";
	if (i < 0)
		return false;
	config->device.tables = (enum device_tables)i;
	return true;
}

static bool read_table_memory(const char *value, struct config *config,
    const char **why)
{
	return read_size(value, &config->device.table_bytes, why);
}

static bool read_volume_memory(const char *value, struct config *config,
    const char **why)
{
	return read_size(value, &config->device.volume_bytes, why);
}

/* The device has room for the same. */
static_assert(sizeof ((struct config *)0)->cache == CACHE_FOLDER_MAX,
    "one size for the cache's name");

static bool read_cache(const char *value, struct config *config,
    const char **why)
{
	*why = "a folder's name, not too long";
	if (value[0] == '\0' || strlen(value) >= sizeof config->cache)
		return false;
	strcpy(config->cache, value);
	return true;
}

static bool read_no_cache(const char *value, struct config *config,
    const char **why)
{
	(void)value, (void)why;
	config->cache[0] = '\0';
	return true;
}

static bool read_cache_size(const char *value, struct config *config,
    const char **why)
{
	return read_size(value, &config->cache_size, why);
}

static bool read_fill_cache(const char *value, struct config *config,
    const char **why)
{
	(void)value, (void)why;
	config->fill_cache = true;
	return true;
}

static bool read_layout(const char *value, struct config *config,
    const char **why)
{
	static const char *const names[] = {"warped", "uniform"};
	int i = find_name(value, names, 2);

	*why = "warped or uniform";
	if (i < 0)
		return false;
	config->layout = (enum table_layout)i;
	return true;
}

static bool read_list_devices(const char *value, struct config *config,
    const char **why)
{
	(void)value, (void)why;
	config->list_devices = true;
	return true;
}

static bool read_no_measure(const char *value, struct config *config,
    const char **why)
{
	(void)value, (void)why;
	config->measure = false;
	return true;
}

static bool read_log_level(const char *value, struct config *config,
    const char **why)
{
	*why = "error, warning, info or debug";
	return log_level_named(value, &config->log_level);
}

static bool read_quiet(const char *value, struct config *config,
    const char **why)
{
	(void)value, (void)why;
	config->log_level = LOG_WARNING;
	return true;
}

static const struct option options[] = {
	{"listen", "HOST:PORT", read_listen,
	    "where to listen (127.0.0.1:7878); port 0 picks a free one"},
	{"max-body", "BYTES", read_max_body, "largest request body (128M)"},
	{"max-points", "N", read_max_points,
	    "most points in one evaluation (8000000)"},
	{"max-nodes", "N", read_max_nodes,
	    "most nodes in one document, references expanded (32768)"},
	{"max-scenes", "N", read_max_scenes, "most scenes kept (1024)"},
	{"scene-memory", "BYTES", read_scene_memory,
	    "most memory for the scenes kept (1G)"},
	{"queue", "N", read_queue, "most evaluations waiting (256)"},
	{"tasks", "N", read_tasks,
	    "most meshes, pictures and the like made at a time (2)"},
	{"device", "SELECT", read_device,
	    "OpenCL device: an index of --list-devices or part of a name"},
	{"width", "N", read_width,
	    "points a work-item: 1, 2, 4, 8 or 16 (the device's own choice)"},
	{"tables", "HOW", read_tables,
	    "operator tables as: auto, buffer or image (auto)"},
	{"table-memory", "BYTES", read_table_memory,
	    "most device memory for operator tables (256M)"},
	{"volume-memory", "BYTES", read_volume_memory,
	    "most memory for volumes, also on the device (256M)"},
	{"layout", "LAYOUT", read_layout,
	    "table layout for operators: warped or uniform (warped)"},
	{"cache", "DIR", read_cache,
	    "where tables and kernels are kept (~/.cache/blobfield)"},
	{"no-cache", NULL, read_no_cache, "keep nothing from start to start"},
	{"cache-size", "BYTES", read_cache_size, "most bytes kept there (1G)"},
	{"fill-cache", NULL, read_fill_cache,
	    "put the device's kernels there and exit"},
	{"list-devices", NULL, read_list_devices,
	    "list the OpenCL devices and exit"},
	{"no-measure", NULL, read_no_measure,
	    "do not measure the tables' errors in the background"},
	{"log-level", "LEVEL", read_log_level,
	    "error, warning, info or debug (info)"},
	{"quiet", NULL, read_quiet, "the same as --log-level warning"},
};

#define OPTION_COUNT (sizeof options / sizeof *options)

static void print_help(void)
{
	printf("Usage: blobfieldd [option]...\n\n"
	    "Evaluates Blob-tree documents on an OpenCL device, over HTTP.\n\n");
	for (size_t i = 0; i < OPTION_COUNT; i++) {
		char left[64];

		snprintf(left, sizeof left, "--%s%s%s", options[i].name,
		    options[i].argument ? " " : "",
		    options[i].argument ? options[i].argument : "");
		printf("  %-24s %s\n", left, options[i].help);
	}
	printf("  %-24s %s\n  %-24s %s\n", "--version", "print the version",
	    "--help", "print this");
}

static bool complain(const char *argument, const char *what, const char *why)
{
	fprintf(stderr, "blobfieldd: %s: %s%s\n"
	    "Try 'blobfieldd --help'.\n", argument, what, why);
	return false;
}

/* The option that argument (after "--") names, up to '=' or its end. */
static const struct option *find_option(const char *argument)
{
	size_t length = strcspn(argument, "=");

	for (size_t i = 0; i < OPTION_COUNT; i++) {
		if (strlen(options[i].name) == length &&
		    memcmp(options[i].name, argument, length) == 0)
			return &options[i];
	}
	return NULL;
}

/* Reads the option at argv[*i], and moves *i past it. */
static bool read_option(int argc, char **argv, int *i, struct config *config)
{
	const char *argument = argv[(*i)++];
	const struct option *option = NULL;
	const char *value = strchr(argument, '=');
	const char *why = "";

	if (strncmp(argument, "--", 2) == 0)
		option = find_option(argument + 2);
	if (option == NULL)
		return complain(argument, "unknown option", "");
	if (option->argument == NULL && value != NULL)
		return complain(argument, "takes no value", "");
	if (option->argument != NULL && value == NULL && *i >= argc)
		return complain(argument, "needs ", option->argument);
	if (option->argument != NULL)
		value = value != NULL ? value + 1 : argv[(*i)++];
	if (!option->read(value, config, &why))
		return complain(argument, "must be ", why);
	return true;
}

/*
 * The XDG Base Directory Specification's: $XDG_CACHE_HOME counts if it is
 * absolute. Without a home there is no cache.
 */
static void set_default_cache(struct config *config)
{
	const char *cache = getenv("XDG_CACHE_HOME"), *home = getenv("HOME");
	int length = 0;

	if (cache != NULL && cache[0] == '/')
		length = snprintf(config->cache, sizeof config->cache,
		    "%s/blobfield", cache);
	else if (home != NULL && home[0] == '/')
		length = snprintf(config->cache, sizeof config->cache,
		    "%s/.cache/blobfield", home);
	if (length >= (int)sizeof config->cache)
		config->cache[0] = '\0';
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
		.layout = LAYOUT_WARPED,
		.measure = true,
		.log_level = LOG_INFO,
	};
	config->device.table_bytes = (size_t)256 << 20;
	config->device.volume_bytes = (size_t)256 << 20;
	config->cache_size = (size_t)1 << 30;
	set_default_cache(config);
}

enum config_outcome config_parse(int argc, char **argv, struct config *out)
{
	set_defaults(out);
	for (int i = 1; i < argc;) {
		if (strcmp(argv[i], "--help") == 0) {
			print_help();
			return CONFIG_DONE;
		}
		if (strcmp(argv[i], "--version") == 0) {
			printf("blobfieldd %s\n", BLOBFIELD_VERSION);
			return CONFIG_DONE;
		}
		if (!read_option(argc, argv, &i, out))
			return CONFIG_BAD;
	}
	return CONFIG_RUN;
}
