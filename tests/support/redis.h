/*
 * A redis-server of the test's own, in a temporary folder, on a socket there.
 */
#ifndef TESTS_SUPPORT_REDIS_H
#define TESTS_SUPPORT_REDIS_H

#include <limits.h>
#include <stdbool.h>
#include <sys/types.h>

struct redis {
	pid_t pid;               /* 0: it does not run */
	char folder[PATH_MAX];
	char path[PATH_MAX + 16]; /* of the socket */
	char url[PATH_MAX + 32];  /* redis+unix://… */
};

/* Whether there are redis-server and redis-cli. */
bool redis_is_installed(void);

/* Starts one that keeps every write, as server/deploy/redis.conf says, and waits
 * until it answers. Fails the running test if it does not. */
void redis_start(struct redis *r);

/* Starts it again in the same folder, after redis_signal(r, SIGKILL). */
void redis_start_again(struct redis *r);

/* Sends it a signal; waits for its end if that is SIGKILL. */
void redis_signal(struct redis *r, int signal_number);

/* Runs redis-cli with words, as a shell would take them; what it prints, cut to
 * size, to out (NULL: nowhere). Returns its exit status. */
int redis_cli(const struct redis *r, const char *words, char *out, int size);

/* Ends it and removes the folder. */
void redis_stop(struct redis *r);

#endif
