/*
 * A device that is lost: OpenCL calls of the real daemon fail
 * (tests/fault/fail_cl.c). Who was being served gets a 503, others wait, and
 * right values come again without a restart.
 */
#include <stdarg.h>
#include <stddef.h>
#include <setjmp.h>
#include <stdint.h>
#include <cmocka.h>

#include <fcntl.h>
#include <limits.h>
#include <math.h>
#include <pthread.h>
#include <signal.h>
#include <stdatomic.h>
#include <stdbool.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/mman.h>
#include <time.h>
#include <unistd.h>

#include <CL/cl.h>

#include "tests/fault/fault.h"
#include "tests/support/daemon.h"
#include "tests/support/folder.h"
#include "tests/support/http.h"
#include "tests/support/load.h"
#include "tests/support/sanitized.h"

#define ALL 1000000000UL /* calls */

/* Without any table. */
static const char plain[] = "{\"scene\":{\"format\":\"blobfield/1\",\"root\":"
    "{\"type\":\"union\",\"operator\":\"sharp\",\"children\":["
    "{\"type\":\"point\",\"center\":[0,0,0],\"radius\":1},"
    "{\"type\":\"point\",\"center\":[1,0,0],\"radius\":1}]}},"
    "\"points\":[[0,0,0],[0.5,0,0.2]]}";

/* With a built-in table, which goes with the device. */
static const char body[] = "{\"scene\":{\"format\":\"blobfield/1\",\"root\":"
    "{\"type\":\"union\",\"operator\":\"camel\",\"children\":["
    "{\"type\":\"segment\",\"a\":[-1,0,0],\"b\":[0,0,2.6],\"radius\":0.2},"
    "{\"type\":\"segment\",\"a\":[1,0,0],\"b\":[0,0,2.6],\"radius\":0.2}]}},"
    "\"points\":[[0,0,2.4],[0.5,0,1.2],[-1,0,0.1],[0.2,0.1,2.0]]}";

struct bed {
	struct daemon daemon;
	struct fault_control *control;
	char folder[PATH_MAX], path[PATH_MAX + 16];
	char *right; /* the answer */
};

static double now(void)
{
	struct timespec t;

	clock_gettime(CLOCK_MONOTONIC, &t);
	return (double)t.tv_sec + 1e-9 * (double)t.tv_nsec;
}

/* Calls first to last from now on fail. */
static void arm(struct bed *bed, unsigned long first, unsigned long last,
    int code)
{
	struct fault_control *c = bed->control;

	atomic_store(&c->kind, FAULT_KINDS);
	atomic_store(&c->failed, 0);
	atomic_store(&c->calls[FAULT_CL], 0);
	atomic_store(&c->first, first);
	atomic_store(&c->last, last);
	atomic_store(&c->code, code);
	atomic_store(&c->kind, FAULT_CL);
}

static void disarm(struct bed *bed)
{
	atomic_store(&bed->control->kind, FAULT_KINDS);
}

static void make_control(struct bed *bed)
{
	int fd;

	folder_make(bed->folder);
	snprintf(bed->path, sizeof bed->path, "%s/control", bed->folder);
	fd = open(bed->path, O_RDWR | O_CREAT | O_EXCL, 0600);
	assert_true(fd >= 0);
	assert_int_equal(ftruncate(fd, sizeof *bed->control), 0);
	bed->control = mmap(NULL, sizeof *bed->control,
	    PROT_READ | PROT_WRITE, MAP_SHARED, fd, 0);
	assert_ptr_not_equal(bed->control, MAP_FAILED);
	close(fd);
	disarm(bed);
}

/* The library, two folders above the test program's. */
static void preload(struct bed *bed)
{
	char self[PATH_MAX], path[PATH_MAX + 32];
	ssize_t length = readlink("/proc/self/exe", self, sizeof self - 1);

	assert_true(length > 0);
	self[length] = '\0';
	for (int i = 0; i < 2; i++)
		*strrchr(self, '/') = '\0';
	snprintf(path, sizeof path, "%s/fault/fail_cl.so", self);
	assert_int_equal(access(path, R_OK), 0);
	setenv("FAULT_CONTROL", bed->path, 1);
	setenv("LD_PRELOAD", path, 1);
}

static long ask(struct bed *bed, struct http_reply *reply)
{
	http_json(bed->daemon.url, NULL, "/v1/eval", body, reply);
	return reply->status;
}

static bool is_right(struct bed *bed, const struct http_reply *reply)
{
	return reply->status == 200 && strcmp(reply->body, bed->right) == 0;
}

static long get(struct bed *bed, const char *path)
{
	struct http_reply reply;

	http_get(bed->daemon.url, path, &reply);
	http_reply_fini(&reply);
	return reply.status;
}

/* Tables come out of a cache. */
static void start(struct bed *bed)
{
	char cache[PATH_MAX + 16];
	const char *const arguments[] = {"--no-measure", "--cache", cache,
		NULL};

	snprintf(cache, sizeof cache, "%s/cache", bed->folder);
	daemon_start(&bed->daemon, arguments);
}

static int set_up(void **state)
{
	struct bed *bed = calloc(1, sizeof *bed);
	struct http_reply reply;

	*state = bed;
	if (SANITIZED || getenv("BLOBFIELD_PROXY") != NULL)
		return 0;
	make_control(bed);
	preload(bed);
	start(bed);
	unsetenv("LD_PRELOAD");
	daemon_await_ready(&bed->daemon);
	assert_int_equal(ask(bed, &reply), 200);
	bed->right = strdup(reply.body);
	http_reply_fini(&reply);
	return 0;
}

static int tear_down(void **state)
{
	struct bed *bed = *state;
	int status = 0;

	if (bed->control != NULL) {
		disarm(bed);
		status = daemon_stop(&bed->daemon, SIGTERM);
		munmap(bed->control, sizeof *bed->control);
		folder_remove(bed->folder);
	}
	free(bed->right);
	free(bed);
	return status;
}

/* All built-in tables are there again: no call is made but for requests. */
static void await_tables(struct bed *bed)
{
	static const char resident[] = "\"resident\"";
	int count = 0;

	for (int i = 0; i < 3000 && count < 4; i++) {
		struct http_reply reply;

		usleep(10000);
		http_get(bed->daemon.url, "/v1/operators", &reply);
		count = 0;
		for (const char *at = reply.body; (at = strstr(at, resident))
		    != NULL; at += sizeof resident)
			count++;
		http_reply_fini(&reply);
	}
	assert_true(count >= 4);
}

static struct bed *begin(void **state)
{
	struct bed *bed = *state;

	if (bed->control == NULL) {
		printf("skipped: not with a sanitizer or a proxy\n");
		skip();
	}
	daemon_await_ready(&bed->daemon);
	await_tables(bed);
	return bed;
}

static void assert_lost(const struct http_reply *reply)
{
	char after[16];

	assert_int_equal(reply->status, 503);
	assert_non_null(strstr(reply->body, "/problems/device-lost"));
	http_header(reply, "Retry-After", after, sizeof after);
	assert_string_equal(after, "2");
}

static void test_a_lost_device_is_opened_anew(void **state)
{
	struct bed *bed = begin(state);
	static const int codes[] = {CL_DEVICE_NOT_AVAILABLE,
		CL_OUT_OF_RESOURCES, CL_INVALID_COMMAND_QUEUE,
		CL_INVALID_CONTEXT};
	double longest = 0.0, shortest = 0.0;

	for (int i = 0; i < 4; i++) {
		struct http_reply reply;
		double at;

		/* The first call of a launch that is no look at an argument. */
		arm(bed, 17, 17, codes[i]);
		ask(bed, &reply);
		at = now();
		assert_lost(&reply);
		assert_int_equal(atomic_load(&bed->control->failed), 1);
		http_reply_fini(&reply);
		/* This waits for the device, */
		http_json(bed->daemon.url, NULL, "/v1/eval", plain, &reply);
		assert_int_equal(reply.status, 200);
		http_reply_fini(&reply);
		shortest = fmax(shortest, now() - at);
		/* ... and this for its table, too. */
		ask(bed, &reply);
		longest = fmax(longest, now() - at);
		assert_true(is_right(bed, &reply));
		http_reply_fini(&reply);
	}
	printf("measured: from the loss to the next right answer at most %.2f "
	    "s, of a scene with a table %.2f s\n", shortest,
	    longest);
}

/* Many at once: all are answered, right or 503, none waits for ever. */
struct crowd {
	struct bed *bed;
	atomic_int right, lost, wrong;
	atomic_bool stop;
};

static void *be_one(void *arg)
{
	struct crowd *c = arg;

	while (!atomic_load(&c->stop)) {
		struct http_reply reply;
		bool lost;

		ask(c->bed, &reply);
		lost = reply.status == 503 &&
		    strstr(reply.body, "/problems/device-lost") != NULL;
		if (is_right(c->bed, &reply))
			atomic_fetch_add(&c->right, 1);
		else
			atomic_fetch_add(lost ? &c->lost : &c->wrong, 1);
		if (!lost && !is_right(c->bed, &reply))
			fprintf(stderr, "%ld %s\n", reply.status, reply.body);
		http_reply_fini(&reply);
	}
	return NULL;
}

/* Until a hundred more have been right. */
static void await_more(struct crowd *c)
{
	int begin = atomic_load(&c->right);
	double end = now() + 20.0;

	while (atomic_load(&c->right) < begin + 100) {
		assert_true(now() < end);
		usleep(10000);
	}
}

static void test_a_crowd_is_served_again_and_again(void **state)
{
	struct crowd c = {.bed = begin(state)};
	pthread_t threads[8];

	for (int i = 0; i < 8; i++)
		assert_int_equal(pthread_create(&threads[i], NULL, be_one,
		    &c), 0);
	for (int i = 0; i < 4; i++) {
		await_more(&c);
		arm(c.bed, 23, 23, CL_DEVICE_NOT_AVAILABLE);
	}
	await_more(&c);
	atomic_store(&c.stop, true);
	for (int i = 0; i < 8; i++)
		pthread_join(threads[i], NULL);
	printf("measured: 8 clients, 4 losses: %d right, %d lost, %d wrong\n",
	    atomic_load(&c.right), atomic_load(&c.lost),
	    atomic_load(&c.wrong));
	assert_int_equal(atomic_load(&c.wrong), 0);
	assert_true(atomic_load(&c.lost) >= 1); /* or it was nobody's table */
}

static void *ask_once(void *arg)
{
	struct bed *bed = arg;
	struct http_reply reply;
	bool right;

	ask(bed, &reply);
	right = is_right(bed, &reply);
	http_reply_fini(&reply);
	return right ? bed : NULL;
}

/* Every call fails for a while. */
static void test_jobs_wait_for_a_device_that_stays_away(void **state)
{
	struct bed *bed = begin(state);
	struct http_reply reply;
	pthread_t thread;
	void *right;

	arm(bed, 1, ALL, CL_DEVICE_NOT_AVAILABLE);
	ask(bed, &reply);
	assert_lost(&reply);
	http_reply_fini(&reply);
	assert_int_equal(pthread_create(&thread, NULL, ask_once, bed), 0);
	usleep(1000000);
	assert_int_equal(get(bed, "/readyz"), 503);
	assert_int_equal(get(bed, "/healthz"), 200);
	assert_int_equal(get(bed, "/v1/scenes"), 200);
	disarm(bed);
	pthread_join(thread, &right);
	assert_non_null(right);
	assert_int_equal(get(bed, "/readyz"), 200);
}

static void test_a_deadline_holds_while_the_device_is_away(void **state)
{
	struct bed *bed = begin(state);
	struct http_reply reply;
	double at;

	arm(bed, 1, ALL, CL_DEVICE_NOT_AVAILABLE);
	ask(bed, &reply);
	assert_lost(&reply);
	http_reply_fini(&reply);
	at = now();
	http_json(bed->daemon.url, NULL, "/v1/eval?deadline=0.3", body,
	    &reply);
	assert_int_equal(reply.status, 504);
	http_reply_fini(&reply);
	assert_true(load_is_soon(now() - at, 1.0));
	disarm(bed);
	ask(bed, &reply);
	assert_true(is_right(bed, &reply));
	http_reply_fini(&reply);
}

/* A device without memory is none the worse for it. */
static void test_no_device_memory_is_no_loss(void **state)
{
	struct bed *bed = begin(state);
	struct http_reply reply;
	double at = now();
	char after[16];

	arm(bed, 1, ALL, CL_MEM_OBJECT_ALLOCATION_FAILURE);
	ask(bed, &reply);
	assert_int_equal(reply.status, 503);
	assert_non_null(strstr(reply.body, "/problems/out-of-memory"));
	http_header(&reply, "Retry-After", after, sizeof after);
	assert_true(after[0] != '\0');
	http_reply_fini(&reply);
	assert_int_equal(get(bed, "/readyz"), 200);
	disarm(bed);
	ask(bed, &reply);
	assert_true(is_right(bed, &reply));
	http_reply_fini(&reply);
	assert_true(load_is_soon(now() - at, 0.5));
}

static void test_a_daemon_without_a_device_stops_when_told(void **state)
{
	struct bed *bed = begin(state);
	struct http_reply reply;

	arm(bed, 1, ALL, CL_DEVICE_NOT_AVAILABLE);
	ask(bed, &reply);
	assert_lost(&reply);
	http_reply_fini(&reply);
	/* tear_down's SIGTERM is to end it with 0, soon */
	atomic_store(&bed->control->kind, FAULT_CL);
	assert_int_equal(daemon_stop(&bed->daemon, SIGTERM), 0);
	munmap(bed->control, sizeof *bed->control);
	folder_remove(bed->folder);
	bed->control = NULL;
}

int main(void)
{
	const struct CMUnitTest tests[] = {
		cmocka_unit_test(test_a_lost_device_is_opened_anew),
		cmocka_unit_test(test_a_crowd_is_served_again_and_again),
		cmocka_unit_test(test_jobs_wait_for_a_device_that_stays_away),
		cmocka_unit_test(
		    test_a_deadline_holds_while_the_device_is_away),
		cmocka_unit_test(test_no_device_memory_is_no_loss),
		cmocka_unit_test(
		    test_a_daemon_without_a_device_stops_when_told),
	};

	return cmocka_run_group_tests(tests, set_up, tear_down);
}
