/*
 * The process that puts the device's kernels into the cache: this program once
 * more, with --fill-cache, because it takes a core half a minute and compilers
 * cannot be interrupted. It dies when its daemon does, however that is, and
 * holds none of its descriptors. What it says to stderr is logged if it fails.
 *
 * A failure is noted in the cache: no daemon tries those kernels on that device
 * again for a day.
 *
 * Threads: all by one, which must live as long as the daemon.
 */
#ifndef SERVER_FILLER_H
#define SERVER_FILLER_H

#include <stdbool.h>
#include <sys/types.h>

struct device_info;

/* Start with argv, the daemon's own; with cache, a folder or NULL; and {0}. */
struct filler {
	char **argv;
	const char *cache;
	bool has_begun; /* or will not */
	pid_t pid;      /* 0: none runs */
	int said;       /* while one runs: a file that is its stderr */
};

/* Starts the process, once, if it is needed; notices its end. Does not wait;
 * call it every now and then. device: the one that is open. */
void filler_tend(struct filler *f, const struct device_info *device);

/* Ends the process, if it runs. */
void filler_stop(struct filler *f);

#endif
