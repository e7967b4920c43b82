/*
 * Files that are compiled into the daemon: the previewer, the contract.
 */
#ifndef SERVER_ASSET_H
#define SERVER_ASSET_H

#include <stdbool.h>
#include <stddef.h>

#include "proto/request.h"

struct asset {
	const char *name;      /* "index.html", "app.js", "openapi.json" */
	enum media_type type;
	const char *data;
	size_t length;
	const char *etag;      /* of data */
};

/* The asset of that name in *out; false if there is none. Any thread. */
bool asset_find(const char *name, struct asset *out);

#endif
