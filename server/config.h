/*
 * The daemon's configuration: what flags say, else the environment, else a file,
 * else defaults. One table of options (server/config.c) has all four, the help,
 * and --print-config.
 */
#ifndef SERVER_CONFIG_H
#define SERVER_CONFIG_H

#include <stdbool.h>
#include <stddef.h>

#include "core/operator.h"
#include "kernels/cache_file.h"
#include "kernels/device.h"
#include "server/log.h"

#define CONFIG_PATH_MAX 1024
#define CONFIG_ORIGINS_MAX 2048
#define CONFIG_NAME_MAX 256

struct config {
	char host[256];           /* without brackets */
	char port[8];             /* "0" picks one */
	size_t max_body;          /* bytes of one request's body */
	size_t max_points;        /* of one evaluation */
	size_t max_nodes;         /* of one document, references expanded */
	size_t max_scenes;
	size_t scene_memory;      /* bytes of all scenes: texts and tapes */
	size_t queue;             /* evaluations waiting at most */
	size_t tasks;             /* meshes, pictures, rays at a time */
	char data[CONFIG_PATH_MAX];  /* folder of the scenes, or ":memory:" */
	char store[CONFIG_PATH_MAX]; /* redis://…, instead; or "" */
	size_t history;           /* revisions of a scene that are kept */
	size_t history_bytes;     /* of those but the present one, at most */
	size_t max_listeners;     /* to scenes' events */
	char tokens[CONFIG_PATH_MAX];   /* file; "": everybody may everything */
	char cors[CONFIG_ORIGINS_MAX];  /* origins, by commas; "*": any; or "" */
	char hosts[CONFIG_ORIGINS_MAX]; /* names, by commas; "*": any; or "" */
	bool insecure;            /* a public address without tokens */
	char tls_cert[CONFIG_PATH_MAX], tls_key[CONFIG_PATH_MAX]; /* or "" */
	size_t max_connections, max_connections_per_address;
	size_t request_time;      /* seconds for a request's head, and its body
	                           * besides what its size gives */
	size_t work_time;         /* seconds that an evaluation may take of the
	                           * device, a task of it and its thread's
	                           * processor; 0: any */
	size_t drain_time;        /* seconds, at most */
	size_t drain_delay;       /* seconds between not ready and the drain */
	char device_name[CONFIG_NAME_MAX]; /* or "" */
	struct device_options device; /* select points to the member above,
	                               * cache to the one below: main's */
	char cache[CACHE_FOLDER_MAX]; /* a folder; "": nothing is kept */
	size_t cache_size;        /* bytes of what is kept there */
	bool cache_read_only;     /* nothing is written there */
	bool fill_cache;          /* with the device's kernels, and nothing else */
	enum table_layout layout; /* for operators that do not say */
	bool measure;             /* tables' errors, in the background */
	bool list_devices;        /* and nothing else */
	enum log_level log_level;
	enum log_format log_format;
	bool print_config;        /* and nothing else */
	const char *make_token[2]; /* name, role: and nothing else; or NULL */
	char token[CONFIG_NAME_MAX]; /* ... where they are */
};

enum config_outcome {
	CONFIG_RUN,  /* go on */
	CONFIG_DONE, /* --help, --version, --print-config: printed; exit 0 */
	CONFIG_BAD   /* the reason is on stderr: exit 2 */
};

/*
 * Fills *out, which must not move after it, from
 * - arguments: --x V, --x=V; of those that take none also --x=yes, --x=no;
 * - the environment: BLOBFIELDD_X, "yes" or "no" for those that take none; what
 *   is empty counts as not set, and unknown names are warned of;
 * - the file of --config, else of BLOBFIELDD_CONFIG: lines x = V, where # begins
 *   a comment, and V may be in double quotes, with \" and \\ inside;
 * - defaults: folders that a service manager names ($STATE_DIRECTORY,
 *   $CACHE_DIRECTORY), else those of the XDG Base Directory Specification.
 * The first of these that has an option decides. What is wrong anywhere is an
 * error that names the place. Sets up the log's level and format.
 */
enum config_outcome config_parse(int argc, char **argv, struct config *out);

#endif
