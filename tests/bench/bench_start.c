/*
 * How long the daemon takes from its exec to the first 200 from /readyz: with
 * nothing kept, neither its own cache nor the OpenCL library's; and warm, with
 * kernels and tables in its cache.
 *
 *   /true  starting a program that does nothing, and its end
 */
#include <arpa/inet.h>
#include <errno.h>
#include <ftw.h>
#include <limits.h>
#include <netinet/in.h>
#include <signal.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/socket.h>
#include <sys/wait.h>
#include <unistd.h>

#include "tests/bench/bench.h"
#include "tests/bench/report.h"

/* A start that takes longer has failed. */
#define SECONDS_MAX 120.0

/* How often the daemon is asked, in us: each answer takes from its start. */
#define ASK_US 1000

/* Tables are stored once so long, in us, no file has been added, of at most so
 * many such times. */
#define STILL_US 1500000
#define STILL_TIMES 20

struct start {
	char daemon[PATH_MAX + 16];
	char folder[64]; /* of both caches */
	char cache[80], kernels[80];
};

/* $BLOBFIELDD, else two folders above the bench. */
static void find_daemon(struct start *s)
{
	const char *given = getenv("BLOBFIELDD");
	char self[PATH_MAX];
	ssize_t length = readlink("/proc/self/exe", self, sizeof(self) - 1);

	if (given) {
		snprintf(s->daemon, sizeof(s->daemon), "%s", given);
		return;
	}
	if (length <= 0)
		abort();
	self[length] = '\0';
	for (int i = 0; i < 3; i++)
		*strrchr(self, '/') = '\0';
	snprintf(s->daemon, sizeof(s->daemon), "%s/blobfieldd", self);
}

static int remove_one(const char *path, const struct stat *status, int type,
    struct FTW *place)
{
	(void)status;
	(void)type;
	(void)place;
	return remove(path);
}

static void make_folder(struct start *s)
{
	snprintf(s->folder, sizeof(s->folder), "%s/bench-XXXXXX", P_tmpdir);
	if (!mkdtemp(s->folder))
		abort();
	snprintf(s->cache, sizeof(s->cache), "%s/cache", s->folder);
	snprintf(s->kernels, sizeof(s->kernels), "%s/kernels", s->folder);
}

static void remove_folder(struct start *s)
{
	nftw(s->folder, remove_one, 16, FTW_DEPTH | FTW_PHYS);
}

/* Kernels are stored by a process of their own. */
static void fill_cache(const struct start *s)
{
	pid_t pid = fork();

	if (pid < 0)
		abort();
	if (pid == 0) {
		setenv("POCL_CACHE_DIR", s->kernels, 1);
		execl(s->daemon, s->daemon, "--fill-cache", "--quiet",
		    "--data", ":memory:", "--cache", s->cache, (char *)NULL);
		_exit(127);
	}
	waitpid(pid, NULL, 0);
}

static size_t file_count;

static int count_one(const char *path, const struct stat *status, int type,
    struct FTW *place)
{
	(void)path;
	(void)status;
	(void)place;
	file_count += type == FTW_F;
	return 0;
}

/* Waits until the running daemon stores no more. */
static void await_tables(const struct start *s)
{
	size_t before = SIZE_MAX;

	for (int i = 0; i < STILL_TIMES; i++) {
		file_count = 0;
		nftw(s->cache, count_one, 16, FTW_PHYS);
		if (file_count == before)
			return;
		before = file_count;
		usleep(STILL_US);
	}
}

static pid_t start_daemon(const struct start *s, int out)
{
	pid_t pid = fork();

	if (pid < 0)
		abort();
	if (pid == 0) {
		setenv("POCL_CACHE_DIR", s->kernels, 1);
		dup2(out, STDOUT_FILENO);
		execl(s->daemon, s->daemon, "--listen", "127.0.0.1:0",
		    "--quiet", "--no-measure", "--data", ":memory:", "--cache", s->cache,
		    (char *)NULL);
		_exit(127);
	}
	return pid;
}

/* The port that the daemon's first line names; 0: it has ended. */
static int read_port(int fd)
{
	char line[256], *colon;
	size_t length = 0;

	while (length < sizeof(line) - 1 && read(fd, line + length, 1) == 1 &&
	    line[length] != '\n')
		length++;
	line[length] = '\0';
	colon = strrchr(line, ':');
	return colon ? atoi(colon + 1) : 0;
}

/* Whether /readyz gives 200. */
static bool is_ready(int port)
{
	static const char request[] =
	    "GET /readyz HTTP/1.1\r\nHost: localhost\r\nConnection: close\r\n\r\n";
	static const char wanted[] = "HTTP/1.1 200";
	struct sockaddr_in to = {.sin_family = AF_INET,
		.sin_port = htons((uint16_t)port),
		.sin_addr.s_addr = htonl(INADDR_LOOPBACK)};
	int fd = socket(AF_INET, SOCK_STREAM, 0);
	char answer[sizeof(wanted)] = "";
	bool ready = false;

	if (fd < 0)
		abort();
	if (connect(fd, (struct sockaddr *)&to, sizeof(to)) == 0 &&
	    send(fd, request, sizeof(request) - 1, MSG_NOSIGNAL) ==
	    (ssize_t)sizeof(request) - 1 &&
	    recv(fd, answer, sizeof(wanted) - 1, MSG_WAITALL) ==
	    (ssize_t)sizeof(wanted) - 1)
		ready = memcmp(answer, wanted, sizeof(wanted) - 1) == 0;
	close(fd);
	return ready;
}

/* Seconds to readiness; the daemon has ended again, once its tables are stored
 * if these are waited for. Below 0: it would not start. */
static double run_daemon(const struct start *s, bool waits)
{
	double begin = bench_now(), took = -1.0;
	int ends[2], port;
	pid_t pid;

	if (pipe(ends))
		abort();
	pid = start_daemon(s, ends[1]);
	close(ends[1]);
	port = read_port(ends[0]);
	while (port > 0 && took < 0.0 && bench_now() - begin < SECONDS_MAX) {
		if (is_ready(port))
			took = bench_now() - begin;
		else
			usleep(ASK_US);
	}
	if (waits && took >= 0.0)
		await_tables(s);
	kill(pid, SIGTERM);
	waitpid(pid, NULL, 0);
	close(ends[0]);
	return took;
}

static double run_cold(void *ctx)
{
	struct start *s = ctx;
	double took;

	remove_folder(s);
	make_folder(s);
	took = run_daemon(s, false);
	return took;
}

static double run_warm(void *ctx)
{
	return run_daemon(ctx, false);
}

static double run_true(void *ctx)
{
	double begin = bench_now();
	pid_t pid = fork();

	(void)ctx;
	if (pid < 0)
		abort();
	if (pid == 0) {
		execlp("true", "true", (char *)NULL);
		_exit(127);
	}
	waitpid(pid, NULL, 0);
	return bench_now() - begin;
}

void bench_start(bool quick)
{
	struct race_runner list[] = {
		{.name = "warm", .run = run_warm},
		{.name = "true", .run = run_true}};
	struct race_runner cold = {.name = "cold", .run = run_cold};
	struct start s = {.folder = ""};
	int n = quick ? 3 : 9;

	find_daemon(&s);
	make_folder(&s);
	cold.seconds[0] = cold.median = run_cold(&s);
	if (cold.median < 0.0) {
		report_note("start", "skipped: the daemon does not start with "
		    "--cache");
		remove_folder(&s);
		return;
	}
	fill_cache(&s);
	run_daemon(&s, true);
	race(list, 2, n, &s);
	race_report(&cold, 1, 1, "start", "to readiness, nothing kept", "ms",
	    false, 1e3);
	race_report(list, 2, n, "start", "to readiness, warm", "ms", false,
	    1e3);
	remove_folder(&s);
}
