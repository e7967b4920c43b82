#include "tests/support/redis.h"

#include <stdarg.h>
#include <stddef.h>
#include <setjmp.h>
#include <stdint.h>
#include <cmocka.h>

#include <fcntl.h>
#include <signal.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/prctl.h>
#include <sys/wait.h>
#include <unistd.h>

#include "tests/support/folder.h"

bool redis_is_installed(void)
{
	return system("command -v redis-server redis-cli >/dev/null") == 0;
}

static void run_server(const struct redis *r)
{
	int log;

	/* A failed test must not leave one behind. */
	prctl(PR_SET_PDEATHSIG, SIGKILL);
	if (chdir(r->folder) != 0)
		_exit(127);
	log = open("log", O_WRONLY | O_CREAT | O_APPEND, 0600);
	dup2(log, STDOUT_FILENO);
	dup2(log, STDERR_FILENO);
	execlp("redis-server", "redis-server", "--port", "0", "--unixsocket",
	    r->path, "--appendonly", "yes", "--appendfsync", "always",
	    "--save", "", (char *)NULL);
	_exit(127);
}

void redis_start_again(struct redis *r)
{
	char answer[64] = "";

	unlink(r->path);
	r->pid = fork();
	assert_true(r->pid >= 0);
	if (r->pid == 0)
		run_server(r);
	for (int i = 0; i < 3000; i++) {
		if (redis_cli(r, "ping", answer, sizeof answer) == 0 &&
		    strstr(answer, "PONG") != NULL)
			return;
		usleep(10000);
	}
	fail_msg("redis-server does not answer: %s", answer);
}

void redis_start(struct redis *r)
{
	folder_make(r->folder);
	snprintf(r->path, sizeof r->path, "%s/socket", r->folder);
	snprintf(r->url, sizeof r->url, "redis+unix://%s", r->path);
	redis_start_again(r);
}

void redis_signal(struct redis *r, int signal_number)
{
	kill(r->pid, signal_number);
	if (signal_number != SIGKILL)
		return;
	waitpid(r->pid, NULL, 0);
	r->pid = 0;
}

int redis_cli(const struct redis *r, const char *words, char *out, int size)
{
	char command[PATH_MAX + 512], rest[256];
	size_t length = 0;
	FILE *stream;

	snprintf(command, sizeof command, "redis-cli -s %s %s 2>&1", r->path,
	    words);
	stream = popen(command, "r");
	assert_non_null(stream);
	if (out != NULL) {
		length = fread(out, 1, (size_t)size - 1, stream);
		out[length] = '\0';
	}
	while (fread(rest, 1, sizeof rest, stream) > 0)
		;
	return pclose(stream);
}

void redis_stop(struct redis *r)
{
	if (r->pid > 0) {
		kill(r->pid, SIGCONT);
		redis_signal(r, SIGKILL);
	}
	folder_remove(r->folder);
}
