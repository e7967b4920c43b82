/*
 * What every handler can reach: the daemon's parts.
 */
#ifndef SERVER_SERVER_H
#define SERVER_SERVER_H

#include <stdatomic.h>

struct access;
struct config;
struct events;
struct http;
struct metrics;
struct orders;
struct readers;
struct scene_store;
struct scheduler;
struct tables;
struct tasks;
struct tls;
struct volume_store;

struct server {
	const struct config *config;
	struct metrics *metrics;
	struct access *access;
	struct tls *tls;      /* NULL: plain HTTP */
	struct events *events;
	struct tables *tables;
	struct orders *orders;
	struct scheduler *scheduler;
	struct scene_store *scenes;
	struct volume_store *volumes;
	struct tasks *tasks;
	struct readers *readers; /* NULL: all is handled where it comes */
	struct http *http;
	double started;       /* clock_seconds */
	atomic_bool draining; /* no new work; connections close after an answer */
	_Atomic double closed; /* clock_seconds: work that arrives later is
	                       * refused; 0: none is */
};

#endif
