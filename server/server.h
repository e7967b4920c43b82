/*
 * What every handler can reach: the daemon's parts.
 */
#ifndef SERVER_SERVER_H
#define SERVER_SERVER_H

#include <stdatomic.h>

struct config;
struct http;
struct orders;
struct scene_store;
struct scheduler;
struct tables;
struct tasks;
struct volume_store;

struct server {
	const struct config *config;
	struct tables *tables;
	struct orders *orders;
	struct scheduler *scheduler;
	struct scene_store *scenes;
	struct volume_store *volumes;
	struct tasks *tasks;
	struct http *http;
	double started;       /* clock_seconds */
	atomic_bool draining; /* no new work; connections close after an answer */
};

#endif
