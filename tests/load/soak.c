/*
 * Months of small requests in a bounded run: `make soak`. In rounds, each over
 * new connections, small evaluations in every media type, one-shot evaluations,
 * refusals' neighbours (scenes written, read and deleted) go to one daemon; after
 * each round its memory and descriptors are read. The first fifth of the rounds
 * is warming up; from then on memory may grow by 2 % and descriptors not at
 * all, or the exit status is 1.
 */
#include <dirent.h>
#include <math.h>
#include <signal.h>
#include <stdbool.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <unistd.h>

#include "tests/support/daemon.h"
#include "tests/support/load.h"

#define REQUESTS 1000000
#define ROUNDS 20
#define CONNECTIONS 32
#define KINDS 10
#define GROWTH_MOST 0.02

static const char document[] = "{\"format\":\"blobfield/1\",\"root\":{"
    "\"type\":\"union\",\"operator\":\"camel\",\"children\":["
    "{\"type\":\"segment\",\"a\":[-1,0,0],\"b\":[0,0,2.6],\"radius\":0.2},"
    "{\"type\":\"segment\",\"a\":[1,0,0],\"b\":[0,0,2.6],\"radius\":0.2},"
    "{\"type\":\"sphere\",\"center\":[0,0,1],\"radius\":0.5,"
    "\"falloff\":0.5}]}}";
static const char points[] = "{\"points\":[[0,0,1],[0.5,0,1.3],[1,0,0]]}";
static const char outputs[] = "{\"points\":[0,0,1,0.5,0,1.3],"
    "\"outputs\":[\"value\",\"hessian\",\"curvature\"]}";
static const char json[] = "Content-Type: application/json\r\n";
static const char octets[] = "Content-Type: application/octet-stream\r\n"
    "Accept: application/octet-stream\r\n";

static long resident_kb(pid_t pid)
{
	char path[64], line[256];
	long kb = -1;
	FILE *file;

	snprintf(path, sizeof(path), "/proc/%d/status", (int)pid);
	file = fopen(path, "r");
	while (file && fgets(line, sizeof(line), file))
		if (sscanf(line, "VmRSS: %ld", &kb) == 1)
			break;
	if (file)
		fclose(file);
	return kb;
}

static long descriptors(pid_t pid)
{
	char path[64];
	long count = 0;
	DIR *dir;

	snprintf(path, sizeof(path), "/proc/%d/fd", (int)pid);
	dir = opendir(path);
	while (dir && readdir(dir))
		count++;
	if (dir)
		closedir(dir);
	return count - 2; /* . and .. */
}

static void make_requests(struct load_request r[static KINDS])
{
	static float xyz[256 * 3];
	char one_shot[1024];

	for (int i = 0; i < 256 * 3; i++)
		xyz[i] = (float)(i % 29) * 0.1f - 1.0f;
	snprintf(one_shot, sizeof(one_shot), "{\"scene\":%s,"
	    "\"points\":[[0,0,1]]}", document);
	r[0] = load_request_make("POST", "/v1/scenes/a/eval", octets, xyz,
	    12);
	r[1] = load_request_make("POST", "/v1/scenes/a/eval", octets, xyz,
	    sizeof(xyz));
	r[2] = load_request_make("POST", "/v1/scenes/a/eval", json, points,
	    strlen(points));
	r[3] = load_request_make("POST", "/v1/scenes/a/eval", json, outputs,
	    strlen(outputs));
	r[4] = load_request_make("POST", "/v1/eval", json, one_shot,
	    strlen(one_shot));
	r[5] = load_request_make("PUT", "/v1/scenes/b", json, document,
	    strlen(document));
	r[6] = load_request_make("GET", "/v1/scenes/a", "", "", 0);
	r[7] = load_request_make("GET", "/v1/info", "", "", 0);
	r[8] = load_request_make("POST", "/v1/scenes/a/eval?priority=bulk",
	    octets, xyz, sizeof(xyz));
	r[9] = load_request_make("GET", "/v1/scenes/a/bounds", "", "", 0);
}

static bool put_scene(int port)
{
	struct load_request put = load_request_make("PUT", "/v1/scenes/a",
	    json, document, strlen(document));
	struct load_answer answer = {0};
	int fd = load_connect(port);
	bool good = fd >= 0 && load_exchange(fd, &put, false, &answer) == 0 &&
	    answer.status / 100 == 2;

	if (fd >= 0)
		close(fd);
	load_request_fini(&put);
	return good;
}

/* One round; its failures, or -1. */
static long run_round(struct daemon *d, const struct load_request *requests,
    size_t total)
{
	struct load_options options = {.port = d->port,
		.connections = CONNECTIONS, .requests = requests,
		.request_count = KINDS, .total = total};
	struct load_result result;
	long failures;

	if (load_run(&options, &result))
		return -1;
	failures = (long)result.failures;
	printf("%8zu answers, %7.0f a second, p50 %4.0f us, p99 %5.0f us",
	    result.count, (double)result.count / result.elapsed,
	    1e6 * load_quantile(result.seconds, result.count, 0.5),
	    1e6 * load_quantile(result.seconds, result.count, 0.99));
	load_result_fini(&result);
	return failures;
}

static int soak(struct daemon *d, const struct load_request *requests,
    size_t total)
{
	long kb = 0, first_kb = 0, first_fds = 0, fds = 0, failures = 0;

	for (int i = 0; i < ROUNDS; i++) {
		long failed = run_round(d, requests, total / ROUNDS);

		if (failed < 0)
			return 1;
		failures += failed;
		usleep(200000); /* for connections to be closed */
		kb = resident_kb(d->pid);
		fds = descriptors(d->pid);
		if (i == ROUNDS / 5) {
			first_kb = kb;
			first_fds = fds;
		}
		printf(", %ld kB, %ld descriptors, %ld failed\n", kb, fds,
		    failed);
		fflush(stdout);
	}
	printf("memory from %ld to %ld kB (%+.2f %%), descriptors from %ld to "
	    "%ld, %ld failures\n", first_kb, kb, 100.0 *
	    (double)(kb - first_kb) / (double)first_kb, first_fds, fds,
	    failures);
	return failures > 0 || fds > first_fds ||
	    (double)(kb - first_kb) > GROWTH_MOST * (double)first_kb;
}

int main(int argc, char **argv)
{
	size_t total = argc > 1 ? strtoul(argv[1], NULL, 10) : REQUESTS;
	static const char *const arguments[] = {"--no-measure", NULL};
	struct load_request requests[KINDS];
	struct daemon d;
	int bad = 1;

	daemon_start(&d, arguments);
	daemon_await_ready(&d);
	make_requests(requests);
	if (put_scene(d.port))
		bad = soak(&d, requests, total);
	for (int i = 0; i < KINDS; i++)
		load_request_fini(requests + i);
	if (daemon_stop(&d, SIGTERM))
		bad = 1;
	puts(bad ? "FAILED" : "good");
	return bad;
}
