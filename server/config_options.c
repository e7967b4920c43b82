/*
 * The table of options, and names that are nearly one's.
 */
#include <assert.h>
#include <string.h>

#include "kernels/cache_file.h"
#include "proto/text.h"
#include "server/config_internal.h"

/* Seconds that a delay or a wait may last: a day. */
#define SECONDS_MOST 86400

/* The most slips of a name that is still taken for another. */
#define SLIPS_MAX 3

/* The device has room for the same; and choices are read as ints. */
static_assert(sizeof ((struct config *)0)->cache == CACHE_FOLDER_MAX,
    "one size for the cache's name");
static_assert(sizeof(enum table_layout) == sizeof(int) &&
    sizeof(enum device_tables) == sizeof(int) &&
    sizeof(enum log_level) == sizeof(int) &&
    sizeof(enum log_format) == sizeof(int), "enums as large as int");

/* In the order of their enums. */
static const char *const tables_names[] = {"auto", "buffer", "image", NULL};
static const char *const layout_names[] = {"warped", "uniform", NULL};
static const char *const level_names[] = {"error", "warning", "info", "debug",
    NULL};
static const char *const format_names[] = {"text", "json", NULL};

#define AT(member) .offset = offsetof(struct config, member), \
    .size = sizeof ((struct config *)0)->member
#define BYTES(member) .kind = CONFIG_BYTES, AT(member), .least = 1
#define NUMBER(member) .kind = CONFIG_NUMBER, AT(member), .least = 1
#define TEXT(member) .kind = CONFIG_TEXT, AT(member)
#define CHOICE(member, list) .kind = CONFIG_CHOICE, AT(member), .names = list
#define SWITCH(member, value) .kind = CONFIG_SWITCH, AT(member), .yes = value
#define PRESET(member, text) .kind = CONFIG_PRESET, AT(member), .preset = text
#define DEED(member) .kind = CONFIG_DEED, AT(member), .yes = true

const struct config_option config_options[] = {
	{"config", "FILE", .kind = CONFIG_PATH,
	    .help = "read options from FILE, lines of the form option = value"},
	{"listen", "HOST:PORT", .kind = CONFIG_LISTEN, AT(host),
	    .help = "where to listen (127.0.0.1:7878); port 0 picks a free one"},
	{"max-body", "BYTES", BYTES(max_body),
	    .help = "largest request body (128M)"},
	{"max-points", "N", NUMBER(max_points),
	    .help = "most points in one evaluation (8000000)"},
	{"max-nodes", "N", NUMBER(max_nodes),
	    .help = "most nodes in one document, references expanded (32768)"},
	{"max-scenes", "N", NUMBER(max_scenes),
	    .help = "most scenes kept (1024)"},
	{"scene-memory", "BYTES", BYTES(scene_memory),
	    .help = "most memory for the scenes kept (1G)"},
	{"queue", "N", NUMBER(queue),
	    .help = "most evaluations waiting (256)"},
	/* Each is a thread. */
	{"tasks", "N", NUMBER(tasks), .most = 64,
	    .help = "most meshes, pictures and the like made at a time (2)"},
	{"work-time", "SECONDS", .kind = CONFIG_NUMBER, AT(work_time),
	    .most = SECONDS_MOST,
	    .help = "most time for one evaluation, mesh or the like; 0: any "
	    "(300)"},
	{"data", "DIR", TEXT(data),
	    .help = "where scenes are kept, or :memory: "
	    "(~/.local/share/blobfield)"},
	{"store", "URL", .kind = CONFIG_URL, AT(store),
	    .help = "keep scenes in Redis, shared with other daemons: "
	    "redis://HOST"},
	{"history", "N", NUMBER(history),
	    .help = "revisions of a scene that are kept (16)"},
	{"history-bytes", "BYTES", BYTES(history_bytes),
	    .help = "... and the most bytes of all but the present one (64M)"},
	{"max-listeners", "N", NUMBER(max_listeners),
	    .help = "most listeners to scenes' events (1024)"},
	{"tokens", "FILE", TEXT(tokens), .help = "who may do what"},
	{"make-token", "NAME:ROLE", .kind = CONFIG_TOKEN,
	    .help = "make a token for that file and exit"},
	{"insecure", NULL, SWITCH(insecure, true),
	    .help = "serve a public address without tokens"},
	{"hosts", "NAMES", TEXT(hosts),
	    .help = "names that it may be asked by, by commas; or * (without "
	    "tokens: localhost)"},
	{"cors-origin", "ORIGINS", TEXT(cors),
	    .help = "web pages' origins that may ask, by commas; or *"},
	{"tls-cert", "FILE", TEXT(tls_cert),
	    .help = "serve HTTPS: certificate, PEM"},
	{"tls-key", "FILE", TEXT(tls_key), .help = "... and its key"},
	{"max-connections", "N", NUMBER(max_connections),
	    .help = "most connections (4096)"},
	{"max-connections-per-address", "N",
	    NUMBER(max_connections_per_address),
	    .help = "... from one address (1024)"},
	{"request-time", "SECONDS", NUMBER(request_time), .most = SECONDS_MOST,
	    .help = "most time for a request to arrive, longer the larger it "
	    "is (60)"},
	{"drain-time", "SECONDS", NUMBER(drain_time), .most = SECONDS_MOST,
	    .help = "most time to finish what runs when told to stop (60)"},
	{"drain-delay", "SECONDS", .kind = CONFIG_NUMBER, AT(drain_delay),
	    .most = SECONDS_MOST,
	    .help = "... and before it: go on, but as not ready (0)"},
	{"device", "SELECT", TEXT(device_name),
	    .help = "OpenCL device: an index of --list-devices or part of a "
	    "name"},
	{"width", "N", .kind = CONFIG_WIDTH, AT(device.width),
	    .help = "points a work-item: 1, 2, 4, 8 or 16 (the device's own "
	    "choice)"},
	{"tables", "HOW", CHOICE(device.tables, tables_names),
	    .help = "operator tables as: auto, buffer or image (auto)"},
	{"table-memory", "BYTES", BYTES(device.table_bytes),
	    .help = "most device memory for operator tables (256M)"},
	{"volume-memory", "BYTES", BYTES(device.volume_bytes),
	    .help = "most memory for volumes, also on the device (256M)"},
	{"layout", "LAYOUT", CHOICE(layout, layout_names),
	    .help = "table layout for operators: warped or uniform (warped)"},
	{"cache", "DIR", TEXT(cache),
	    .help = "where tables and kernels are kept (~/.cache/blobfield)"},
	{"no-cache", NULL, PRESET(cache, ""),
	    .help = "keep nothing from start to start"},
	{"cache-size", "BYTES", BYTES(cache_size),
	    .help = "most bytes kept there (1G)"},
	{"cache-read-only", NULL, SWITCH(cache_read_only, true),
	    .help = "write nothing there"},
	{"fill-cache", NULL, DEED(fill_cache),
	    .help = "put the device's kernels there and exit"},
	{"list-devices", NULL, DEED(list_devices),
	    .help = "list the OpenCL devices and exit"},
	{"no-measure", NULL, SWITCH(measure, false),
	    .help = "do not measure the tables' errors in the background"},
	{"log-level", "LEVEL", CHOICE(log_level, level_names),
	    .help = "error, warning, info or debug (info)"},
	{"log-format", "FORMAT", CHOICE(log_format, format_names),
	    .help = "text or json (text)"},
	{"quiet", NULL, PRESET(log_level, "warning"),
	    .help = "the same as --log-level warning"},
	{"print-config", NULL, DEED(print_config),
	    .help = "print the configuration in use, as a file, and exit"},
	{.name = NULL},
};

static_assert(sizeof config_options / sizeof *config_options <=
    CONFIG_OPTIONS_MAX, "room for every option's origin");

bool config_option_is_kept(const struct config_option *option)
{
	return option->kind != CONFIG_DEED && option->kind != CONFIG_TOKEN &&
	    option->kind != CONFIG_PATH;
}

const struct config_option *config_option_find(const char *name,
    size_t length)
{
	const struct config_option *o;

	for (o = config_options; o->name != NULL; o++) {
		if (strlen(o->name) == length &&
		    memcmp(o->name, name, length) == 0)
			return o;
	}
	return NULL;
}

const struct config_option *config_option_like(const char *name)
{
	const struct config_option *o, *best = NULL;
	int least = SLIPS_MAX + 1;

	for (o = config_options; o->name != NULL; o++) {
		int slips = text_distance(name, o->name);

		if (slips < least && slips < (int)strlen(o->name)) {
			least = slips;
			best = o;
		}
	}
	return best;
}
