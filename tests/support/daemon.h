/*
 * The real daemon as a child process, for wire tests.
 */
#ifndef TESTS_SUPPORT_DAEMON_H
#define TESTS_SUPPORT_DAEMON_H

#include <sys/types.h>

#define DAEMON_URL_MAX 256

struct daemon {
	pid_t pid;
	int out;                  /* its stdout */
	char url[DAEMON_URL_MAX]; /* "http://127.0.0.1:PORT" */
	int port;
	pid_t proxy;              /* before it; 0: none */
	int proxy_out;
};

/*
 * Starts $BLOBFIELDD, else the blobfieldd two folders above the test program,
 * with --no-cache --data :memory: --listen 127.0.0.1:0 --quiet and arguments (NULL-terminated; NULL:
 * none), and reads the address off its first line. Fails the running test if
 * that takes longer than a minute. If BLOBFIELD_PROXY is set in the environment,
 * "$BLOBFIELD_PROXY URL" is started before it, and d has that one's address:
 * the last word of its first line.
 */
void daemon_start(struct daemon *d, const char *const *arguments);

/* Waits until /readyz answers 200; fails the running test after 5 minutes, or if
 * the daemon has ended. */
void daemon_await_ready(struct daemon *d);

/* Sends signal_number and waits for the end; returns its exit status, or -1 if it
 * was killed or has not ended after two minutes. A proxy is then ended, too, by
 * SIGTERM; its status is returned if the daemon's is 0. */
int daemon_stop(struct daemon *d, int signal_number);

/*
 * For cmocka groups: one ready daemon, without background measuring, shared by
 * all tests of the program as *state; stopped with SIGTERM, which must give 0.
 */
int daemon_setup(void **state);
int daemon_teardown(void **state);

/* Runs the daemon to its end with arguments; returns its exit status. Its
 * stdout and stderr, cut to size, go to output. */
int daemon_run(const char *const *arguments, char *output, int size);

#endif
