/*
 * The daemon's command line.
 */
#ifndef SERVER_CONFIG_H
#define SERVER_CONFIG_H

#include <stdbool.h>
#include <stddef.h>

#include "core/operator.h"
#include "kernels/cache_file.h"
#include "kernels/device.h"
#include "server/log.h"

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
	struct device_options device; /* select points into argv, cache to
	                               * the member below */
	char cache[CACHE_FOLDER_MAX]; /* a folder; "": nothing is kept */
	size_t cache_size;        /* bytes of what is kept there */
	bool fill_cache;          /* with the device's kernels, and nothing else */
	enum table_layout layout; /* for operators that do not say */
	bool measure;             /* tables' errors, in the background */
	bool list_devices;        /* and nothing else */
	enum log_level log_level;
};

enum config_outcome {
	CONFIG_RUN,  /* go on */
	CONFIG_DONE, /* --help or --version has been printed: exit 0 */
	CONFIG_BAD   /* the reason is on stderr: exit 2 */
};

/* Fills *out from defaults and arguments, of the forms --x V and --x=V. */
enum config_outcome config_parse(int argc, char **argv, struct config *out);

#endif
