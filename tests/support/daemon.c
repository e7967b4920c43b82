#include "tests/support/daemon.h"

#include <stdarg.h>
#include <stddef.h>
#include <setjmp.h>
#include <stdint.h>
#include <cmocka.h>

#include <limits.h>
#include <poll.h>
#include <signal.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/prctl.h>
#include <sys/wait.h>
#include <unistd.h>

#include "tests/support/http.h"

#define ARGUMENTS_MAX 32

static const char *binary(void)
{
	static char path[PATH_MAX + 16];
	const char *given = getenv("BLOBFIELDD");
	char self[PATH_MAX];
	ssize_t length = readlink("/proc/self/exe", self, sizeof self - 1);

	if (given != NULL)
		return given;
	assert_true(length > 0);
	self[length] = '\0';
	for (int i = 0; i < 3; i++)
		*strrchr(self, '/') = '\0';
	snprintf(path, sizeof path, "%s/blobfieldd", self);
	return path;
}

/* The tables that tests/run.sh has built for all; or none. Nothing, where the
 * test says itself. */
static const char *const *cache_arguments(const char *const *arguments)
{
	static const char *shared[] = {"--cache", NULL, "--cache-read-only",
	    NULL};
	static const char *const none[] = {"--no-cache", NULL};

	for (; arguments != NULL && *arguments != NULL; arguments++)
		if (strcmp(*arguments, "--cache") == 0)
			return none + 1;
	shared[1] = getenv("BLOBFIELD_TEST_CACHE");
	return shared[1] != NULL ? shared : none;
}

/* Starts the daemon with out (and err, if not -1) as its streams. Tests neither
 * use nor change what the user's own daemon keeps, nor depend on what an
 * earlier run has kept: arguments may name a cache, or none. */
static pid_t spawn(const char *const *arguments, int out, int err)
{
	const char *argv[ARGUMENTS_MAX] = {binary(), "--no-measure", "--data",
	    ":memory:"};
	const char *const *cache = cache_arguments(arguments);
	int count = 4;
	pid_t pid;

	while (*cache != NULL)
		argv[count++] = *cache++;
	while (arguments != NULL && *arguments != NULL &&
	    count < ARGUMENTS_MAX - 1)
		argv[count++] = *arguments++;
	pid = fork();
	assert_true(pid >= 0);
	if (pid == 0) {
		/* A failed test must not leave one behind. */
		prctl(PR_SET_PDEATHSIG, SIGKILL);
		/* Not as nohup would have it, which the daemon minds. */
		signal(SIGHUP, SIG_DFL);
		dup2(out, STDOUT_FILENO);
		if (err >= 0)
			dup2(err, STDERR_FILENO);
		execv(argv[0], (char *const *)(size_t)argv);
		_exit(127);
	}
	return pid;
}

/* One line without its newline; false if none comes in time. */
static int read_line(int fd, char *line, int size, int timeout_ms)
{
	struct pollfd poll_fd = {.fd = fd, .events = POLLIN};
	int length = 0;

	while (length < size - 1 && poll(&poll_fd, 1, timeout_ms) == 1 &&
	    read(fd, line + length, 1) == 1) {
		if (line[length] == '\n') {
			line[length] = '\0';
			return 1;
		}
		length++;
	}
	line[length] = '\0';
	return 0;
}

/* The URL that is the last word of the first line from d's proxy. */
static void read_proxy_url(struct daemon *d)
{
	char line[256];
	const char *url;

	if (!read_line(d->proxy_out, line, sizeof line, 30000) ||
	    (url = strstr(line, "http://")) == NULL)
		fail_msg("the proxy's first line is '%s'", line);
	snprintf(d->url, sizeof d->url, "%s", url);
}

static void start_proxy(struct daemon *d)
{
	int ends[2];

	assert_int_equal(pipe(ends), 0);
	d->proxy = fork();
	assert_true(d->proxy >= 0);
	if (d->proxy == 0) {
		prctl(PR_SET_PDEATHSIG, SIGTERM);
		dup2(ends[1], STDOUT_FILENO);
		execl("/bin/sh", "sh", "-c", "exec $BLOBFIELD_PROXY \"$0\"",
		    d->url, (char *)NULL);
		_exit(127);
	}
	close(ends[1]);
	d->proxy_out = ends[0];
	read_proxy_url(d);
}

void daemon_start(struct daemon *d, const char *const *arguments)
{
	static const char prefix[] = "blobfieldd listening on ";
	const char *all[ARGUMENTS_MAX] = {"--listen", "127.0.0.1:0",
	    "--quiet"};
	int count = 3;
	char line[256];
	int ends[2];

	while (arguments != NULL && *arguments != NULL &&
	    count < ARGUMENTS_MAX - 1)
		all[count++] = *arguments++;
	assert_int_equal(pipe(ends), 0);
	d->pid = spawn(all, ends[1], -1);
	close(ends[1]);
	d->out = ends[0];
	if (!read_line(d->out, line, sizeof line, 60000) ||
	    strncmp(line, prefix, strlen(prefix)) != 0)
		fail_msg("the daemon's first line is '%s'", line);
	snprintf(d->url, sizeof d->url, "%s", line + strlen(prefix));
	d->proxy = 0;
	if (getenv("BLOBFIELD_PROXY") != NULL)
		start_proxy(d);
	assert_int_equal(sscanf(d->url, "http://127.0.0.1:%d", &d->port), 1);
	assert_true(d->port > 0);
}

/* It is still to be waited for. */
static int has_ended(pid_t pid)
{
	siginfo_t info = {.si_pid = 0};

	return waitid(P_PID, (id_t)pid, &info, WEXITED | WNOHANG |
	    WNOWAIT) == 0 && info.si_pid == pid;
}

void daemon_await_ready(struct daemon *d)
{
	for (int i = 0; i < 6000; i++) {
		struct http_reply reply;

		http_get(d->url, "/readyz", &reply);
		http_reply_fini(&reply);
		if (reply.status == 200)
			return;
		if (has_ended(d->pid))
			break;
		usleep(50000);
	}
	fail_msg("the daemon %s", has_ended(d->pid) ? "has ended" :
	    "does not get ready");
}

/* The exit status that waitpid's says, or -1, told why. */
static int status_of(int status)
{
	if (WIFEXITED(status))
		return WEXITSTATUS(status);
	fprintf(stderr, "the daemon ended by signal %d\n", WTERMSIG(status));
	return -1;
}

/* The exit status of pid, or -1; waits for so long. */
static int await_end(pid_t pid, int seconds)
{
	int status;

	for (int i = 0; i < seconds * 100; i++) {
		if (waitpid(pid, &status, WNOHANG) == pid)
			return status_of(status);
		usleep(10000);
	}
	fprintf(stderr, "the daemon does not end\n");
	kill(pid, SIGKILL);
	waitpid(pid, &status, 0);
	return -1;
}

static int stop_proxy(struct daemon *d)
{
	if (d->proxy == 0)
		return 0;
	kill(d->proxy, SIGTERM);
	close(d->proxy_out);
	return await_end(d->proxy, 30);
}

int daemon_stop(struct daemon *d, int signal_number)
{
	int status, proxy_status;

	kill(d->pid, signal_number);
	status = await_end(d->pid, 120);
	close(d->out);
	proxy_status = stop_proxy(d);
	return status != 0 ? status : proxy_status;
}

int daemon_run(const char *const *arguments, char *output, int size)
{
	int ends[2], length = 0;
	ssize_t n;
	pid_t pid;

	assert_int_equal(pipe(ends), 0);
	pid = spawn(arguments, ends[1], ends[1]);
	close(ends[1]);
	while ((n = read(ends[0], output + length,
	    (size_t)(size - 1 - length))) > 0)
		length += (int)n;
	output[length] = '\0';
	close(ends[0]);
	return await_end(pid, 60);
}

int daemon_setup(void **state)
{
	static const char *const arguments[] = {"--no-measure", NULL};
	struct daemon *d = calloc(1, sizeof *d);

	assert_non_null(d);
	daemon_start(d, arguments);
	daemon_await_ready(d);
	*state = d;
	return 0;
}

int daemon_teardown(void **state)
{
	int status = daemon_stop(*state, SIGTERM);

	free(*state);
	if (status != 0)
		print_error("the daemon ended with status %d\n", status);
	return status;
}
